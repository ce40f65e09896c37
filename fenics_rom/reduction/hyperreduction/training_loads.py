"""How large the loads of a scene get, and which of them together: what a reduction is to know of."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import count

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import SceneError
from fenics_rom.mechanics.active_environment import ActiveEnvironment
from fenics_rom.mechanics.contact import ObstacleMotion
from fenics_rom.mechanics.environment import Environment, Run
from fenics_rom.mechanics.load_history import LoadHistory
from fenics_rom.mechanics.step import StepInput
from fenics_rom.reduction.hyperreduction.frame_loads import FrameLoads, FrameRange
from fenics_rom.reduction.problem import ReductionProblem
from fenics_rom.scene.scene import Scene
from fenics_rom.system.system import System

SMOOTHING_PERIODS = 0.25  # slowest periods that loads are averaged over: what acts for less moves the body by less
HISTORY_SAMPLES = 24  # of the load history, among which the worst is looked for
MAX_SINGLE_LOADS, FRAME_LOADS = 6, 6  # that are tried alone, and so many more where a base moves
NO_OBSTACLES = ObstacleMotion(*np.zeros((3, 0, 3)))
RANDOM_PUSH_SHARE = 0.5  # of a contact force that is given to a random direction


@dataclass(frozen=True)
class LoadExtremes:
    """How large they get in the scene's load history, in the order of the input."""

    resting: Array  # (c,) actuators and loads: what is always there
    extremes: Array  # (2, c) the rest, least and most
    pushes: dict[str, Array]  # (columns,) by contact mode, of its largest force
    inputs: dict[
        str, float
    ]  # of each actuator and load of the scene its largest size, however short; forces of strokes
    smoothing_time: float  # that all but these were averaged over, s
    worst: tuple[str, Array]  # contact mode and input, less what is always there, that move the body farthest at rest
    frame_loads: FrameLoads | None = None  # of a body whose frame moves
    frame: FrameRange | None = None  # how far that moves
    wrenches: tuple[str, ...] = ()  # contact modes that are pushed by a force and a torque

    @property
    def count(self) -> int:
        """Number of loads and contact modes."""
        return int(self.extremes.any(axis=0).sum()) + len(self.pushes)

    def passing(self, u: Array) -> Array:
        """An input without what is always there."""
        return u - self.whole(np.zeros(len(u)))

    def whole(self, target: Array, share: float = 1.0) -> Array:
        """An input with what is always there, and a share of a target."""
        always = np.zeros(len(target))
        always[len(target) - len(self.resting) :] = self.resting
        return always + share * target


def scene_with_run(system: System) -> tuple[Scene, Run]:
    """The scene and its load history, which say how far the body is to be trained to deform; SceneError without."""
    scene = system.scene
    if scene is None or scene.run is None:
        where = scene.source if scene else "a system of matrices"
        raise SceneError(f"{where}: has no [run], whose loads say how far the body is to be trained to deform")
    return scene, scene.run


def touches_itself(environment: Environment) -> bool:
    """Whether a body touches itself in training, too: that of a moving frame does not."""
    return bool(environment.self_contact) and not environment.is_moving


def training_environment(environment: Environment) -> Environment:
    """What acts in training beside inputs: no obstacles, as pushes stand for these."""
    law = environment.contact_law if touches_itself(environment) else None
    return replace(environment, obstacles={}, contact_law=law)


def step_input(environment: Environment, u: Array) -> StepInput:
    """An input (p,) of a step of training."""
    return StepInput(u, NO_OBSTACLES if touches_itself(environment) else None)


def without_valves(problem: ReductionProblem) -> ReductionProblem:
    """The problem with the pressures of supplies in place of valves: those of chambers are no larger."""
    scene = problem.system.scene
    if scene is None or "valve" not in scene.environment.controls.values():
        return problem
    given = {
        name: replace(pressure, control="pressure", gas=None, valve=None) if pressure.control == "valve" else pressure
        for name, pressure in scene.effects.pressure.items()
    }
    scene = replace(scene, effects=replace(scene.effects, pressure=given))
    return replace(problem, system=replace(problem.system, scene=scene))


def slowest_period(problem: ReductionProblem) -> float:
    """Time that the slowest motion takes, s: its period, or as much longer as it is damped more than critically."""
    system = problem.system
    γ, v = system.algebra.eigenpairs(system.mass, system.stiffness, 1, problem.factor)
    ω = float(np.sqrt(γ[0]))
    ζ = float(system.algebra.inner(v, system.damping @ v)[0, 0]) / (2 * ω)
    return 2 * np.pi / ω * max(1.0, ζ)


def load_extremes(problem: ReductionProblem, period: float) -> LoadExtremes:
    """From the scene's own history, smoothed over a part of the slowest period (s; 0 without inertia).

    Raises:
        SceneError: the scene has no load history, or one in which nothing acts that could be trained with.
    """
    system = problem.system
    scene, run = scene_with_run(system)
    is_framed = system.moving_frame is not None
    frame = FrameLoads(system, ActiveEnvironment(scene.environment)) if is_framed else None
    signals = list(scene_history(system, scene, frame))
    shared = sum(system.widths.values())
    acting = np.array([u[len(u) - shared :] for _, u in signals])
    constant = (acting == acting[0]).all(axis=0)
    of_loads = np.arange(shared) >= sum(B.shape[1] for B in system.actuators.values())
    resting = np.where(constant & of_loads, acting[0], 0.0)
    if (acting == resting).all() and not any(u[: len(u) - shared].any() for _, u in signals):
        resting = np.zeros(shared)  # what is always there is all there is: it comes as the run begins
    inputs = _largest(system, scene, acting)
    width = max(1, min(len(signals), round(SMOOTHING_PERIODS * period / run.dt)))
    whole, acting = acting, _averages(acting - resting, width)
    pushing = {}
    for name, B in system.contacts.items():
        forces = np.array([u[: B.shape[1]] if name == contact else np.zeros(B.shape[1]) for contact, u in signals])
        pushing[name] = _averages(forces, width)
    extremes = np.array([np.minimum(acting.min(axis=0), 0.0), np.maximum(acting.max(axis=0), 0.0)])
    far = None
    if frame is not None:
        resting, extremes, far = frame.widened(resting, extremes, whole)
    pushes = {name: forces[np.linalg.norm(forces, axis=1).argmax()] for name, forces in pushing.items()}
    flies = frame is not None and frame.is_free
    if frame is not None and flies and scene.effects.contact is not None:
        pushes = {name: push if push.any() else frame.stopping(push, period) for name, push in pushes.items()}
    spins = far is not None and far.spins.any()
    if not (spins or extremes.any() or any(push.any() for push in pushes.values())):
        raise SceneError(f"{scene.source}: run: nothing acts, so there is nothing to train with")
    is_alone = touches_itself(scene.environment) and not scene.environment.obstacles
    # Else nothing pushes where the scene does not.
    if not is_alone and (not flies or scene.effects.contact is not None):
        pushes = _completed(problem, extremes, pushes)
    worst = _worst(problem, acting, pushing)
    wrenches = tuple(name for name, patch in scene.contacts.items() if patch.force == "wrench")
    return LoadExtremes(resting, extremes, pushes, inputs, SMOOTHING_PERIODS * period, worst, frame, far, wrenches)


def _largest(system: System, scene: Scene, acting: Array) -> dict[str, float]:
    """Size of each actuator and load of the scene, at most, from the inputs (steps, c) of a system."""
    parts = np.split(acting, np.cumsum(list(system.widths.values()))[:-1], axis=1)
    inputs = dict(zip(system.widths, parts, strict=False))
    if system.moving_frame is not None:
        active, run = ActiveEnvironment(scene.environment), scene.environment.run
        assert run is not None
        steps = np.arange(round(run.duration / run.dt)) + (0.5 if scene.environment.has_inertia else 1.0)
        loads = np.array([active.loads_at(step * run.dt) for step in steps])
        split = np.split(loads, np.cumsum(list(active.columns.values()))[:-1], axis=1)
        inputs = {name: inputs[name] for name in system.actuators} | dict(zip(active.columns, split, strict=False))
    return {name: float(np.linalg.norm(u, axis=1).max()) for name, u in inputs.items()}


def _worst(problem: ReductionProblem, acting: Array, pushing: dict[str, Array]) -> tuple[str, Array]:
    """Of some moments of a history the one whose forces would move the body farthest, if they stayed."""
    system = problem.system
    moments = np.unique(np.linspace(0, len(acting) - 1, HISTORY_SAMPLES).astype(int))
    candidates = []
    for k in moments:
        name = max(pushing, key=lambda name: float(np.linalg.norm(pushing[name][k])))
        candidates.append((name, np.concatenate([pushing[name][k], acting[k]])))
    shapes = problem.factor.solve(forces_at_rest(problem, candidates))
    return candidates[int(np.diag(system.algebra.inner(shapes, system.mass @ shapes)).argmax())]


def scene_history(system: System, scene: Scene, frame: FrameLoads | None = None) -> Iterator[tuple[str, Array]]:
    """Contact mode and whole input of each step of the scene's load history; obstacles push nothing.

    Of a body whose frame moves, what that does is among the inputs.
    """
    environment = scene.environment
    active = ActiveEnvironment(environment)
    columns = {name: B.shape[1] for name, B in system.contacts.items()}
    history = LoadHistory(environment, columns, {name: B.shape[1] for name, B in system.actuators.items()})
    for step, (contact, u) in enumerate(history):
        pushed = np.zeros(columns[contact]) if history.automatic else np.empty(0)
        late = 0.5 if environment.has_inertia else 1.0
        loads = active.loads_at((step + late) * history.dt)
        yield (
            contact,
            np.concatenate([pushed, u, loads if frame is None else frame.seen(loads, step * history.dt, history.dt)]),
        )


def in_longer_steps(history: Sequence[tuple[str, Array]], stride: int) -> Iterator[tuple[str, Array]]:
    """The same in steps that are as long as so many of it: means, in the contact mode that each begins with."""
    for first in range(0, len(history), stride):
        contact = history[first][0]
        yield contact, np.mean([u for name, u in history[first : first + stride] if name == contact], axis=0)


def single_inputs(extremes: Array) -> list[Array]:
    """Inputs (c,) of which one alone is not 0: the least and the most of each (2, c)."""
    return [np.where(np.arange(len(row)) == k, row, 0.0) for row in extremes for k in np.flatnonzero(row)]


def forces_at_rest(problem: ReductionProblem, inputs: Sequence[tuple[str, Array]]) -> Array:
    """Forces (rows here, any), N, of contact modes with inputs, in which strokes are what small forces lead to.

    Forces t of strokes s = Cᵀx at rest, C their columns: CᵀK⁻¹C t = s - CᵀK⁻¹f, f all other forces; no tendon pushes.
    """
    system, inner = problem.system, problem.system.algebra.inner
    controls = {} if system.scene is None else system.scene.environment.controls
    ends = np.cumsum([0, *system.widths.values()]).tolist()
    places = [end for name, end in zip(system.widths, ends, strict=False) if name in controls]
    pulls = np.array([control == "length" for name, control in controls.items() if name in system.widths])
    found = [np.empty((system.local_size, 0))]
    for name, u in inputs:
        B, first = system.input_matrix(name), len(u) - sum(system.widths.values())
        at = first + np.array(places, dtype=int)
        others, C = u.copy(), B[:, at]
        others[at] = 0.0
        force = B @ others
        if len(at):
            moved = problem.factor.solve(np.column_stack([C, force]))
            t = np.linalg.lstsq(inner(C, moved[:, :-1]), u[at] - inner(C, moved[:, -1:])[:, 0], rcond=1e-12)[0]
            force = force + C @ np.where(pulls, np.maximum(t, 0.0), t)
        found.append(force[:, None])
    return np.hstack(found)


def _averages(values: Array, width: int) -> Array:
    """Means of that many values that follow one another, (any, c)."""
    sums = np.cumsum(np.vstack([np.zeros((1, values.shape[1])), values]), axis=0)
    return (sums[width:] - sums[:-width]) / width


def _completed(problem: ReductionProblem, extremes: Array, pushes: dict[str, Array]) -> dict[str, Array]:
    """With forces for the contact modes that the history does not push: each undoes what one of the others does."""
    system = problem.system
    blocks = [system.input_matrix(name)[:, : len(push)] @ push for name, push in pushes.items() if push.any()]
    first = next(iter(pushes))
    alone = [(first, np.concatenate([0 * pushes[first], row])) for row in single_inputs(extremes)]
    if not blocks and not alone:
        return pushes
    shapes = problem.factor.solve(np.column_stack([*blocks, *forces_at_rest(problem, alone).T]))
    completed = {}
    for name, push in pushes.items():
        if push.any():
            completed[name] = push
            continue
        mixed = resultants(len(push))
        B = system.contacts[name] @ mixed
        compliance = system.algebra.inner(B, problem.factor.solve(B))
        undoing = -np.linalg.lstsq(compliance, system.algebra.inner(B, shapes), rcond=1e-12)[0]
        completed[name] = mixed @ undoing[:, np.linalg.norm(undoing, axis=0).argmax()]
    return completed


def resultants(columns: int) -> Array:
    """What of a contact mode's input is pushed: forces of many nodes together, along each axis, (columns, any)."""
    if columns <= 3 or columns % 3:
        return np.eye(columns)
    return np.kron(np.full((columns // 3, 1), 3 / columns), np.eye(3))


def training_targets(loads: LoadExtremes) -> Iterator[tuple[str, Array]]:
    """Contact mode and input to grow to, without end: the worst, then loads alone, then random ones together."""
    yield loads.worst
    names = list(loads.pushes)
    single: list[tuple[str, Array]] = []
    no_push = {name: np.zeros(len(push)) for name, push in loads.pushes.items()}
    for k, (least, most) in enumerate(loads.extremes.T):
        if least or most:
            u = np.zeros(loads.extremes.shape[1])
            u[k] = most if most >= -least else least
            single.append((names[0], np.concatenate([no_push[names[0]], u])))
    for name, push in loads.pushes.items():
        if push.any():
            single.append((name, np.concatenate([push, 0 * loads.resting])))
    yield from single[:: -(-len(single) // (MAX_SINGLE_LOADS + FRAME_LOADS * (loads.frame is not None)))]
    random = np.random.default_rng(0)
    for k in count():
        name = names[k % len(names)]
        level = np.sin(np.pi / 2 * random.random(len(loads.resting) + 1)) ** 2  # more often near the ends
        least, most = loads.extremes
        push = loads.pushes[name]
        mixed = resultants(len(push))
        direction = mixed @ random.standard_normal(mixed.shape[1])
        forces = slice(0, 3 if name in loads.wrenches else None)
        direction *= np.linalg.norm(push[forces]) / np.linalg.norm(direction[forces])
        direction[len(push[forces]) :] = push[len(push[forces]) :]  # torques stay: thin bodies spin too fast by others
        pushed = level[-1] * (push + RANDOM_PUSH_SHARE * direction) / np.sqrt(1 + RANDOM_PUSH_SHARE**2)
        shared = least + (most - least) * level[:-1]
        if loads.frame_loads is not None:
            shared = loads.frame_loads.consistent(shared, random)
        yield name, np.concatenate([pushed, shared])
