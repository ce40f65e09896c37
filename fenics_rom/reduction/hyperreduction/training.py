"""Method "trained": what a body does in full-order runs, and the directions of its small motions.

Each begins at rest, lets loads grow to a target within half of the slowest period, so that the body overshoots, holds
them, lets go and swings: what the scene does at its worst moment, then actuators, loads and contact modes one by one,
and together. A contact mode that the scene never pushes is pushed by as much as undoes there what the other loads do:
obstacles do no more. A free body among no obstacles has the history of the scene, with random shares of its loads, as
how it spins comes of all that was before; so has a body that touches itself, as how it lies on itself does, too. Its
surfaces touch in training. Where the full model does not follow, the loads of a run are lowered.
"""

from collections import defaultdict
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import SolverError
from fenics_rom.mechanics.active_environment import ActiveEnvironment
from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.mechanics.environment import Environment
from fenics_rom.mechanics.frame_motion import rotation_matrix
from fenics_rom.mechanics.slack import SlackWatch
from fenics_rom.reduction.checkpoint import Checkpoint
from fenics_rom.reduction.hyperreduction.frame_loads import KINDS, FrameLoads
from fenics_rom.reduction.hyperreduction.training_loads import (
    LoadExtremes,
    in_longer_steps,
    load_extremes,
    scene_history,
    scene_with_run,
    slowest_period,
    step_input,
    touches_itself,
    training_environment,
    training_targets,
)
from fenics_rom.reduction.methods.balanced import balanced
from fenics_rom.reduction.methods.static import static
from fenics_rom.reduction.problem import RankedBasis, ReductionProblem
from fenics_rom.scene.scene import Scene
from fenics_rom.system.system import System

MIN_RUNS, MAX_RUNS, MAX_FRAMED_RUNS = 10, 14, 20  # the last where a base moves
STEPS_PER_PERIOD = 60  # of the slowest motion; no more, if the scene's are shorter
STATIC_STEPS = 10  # of a load that grows without inertia
SNAPSHOTS = 50  # of each run
MAX_HISTORY_STEPS = 400  # that the scene's own load history has in training
GROWING_PERIODS, HOLDING_PERIODS, RUN_PERIODS = 0.5, 0.75, 2.5  # slowest periods that loads grow, are held, runs take
VARIED = 0.5, 1.1  # of each load, in runs that are as the scene's own
LOWERING, LEAST_SHARE = 0.7, 0.1  # of the loads of a run that the full model does not follow, and what is too little
SMALL_MOTION_WEIGHT = 0.03  # of a run's that the directions of small motions of a contact mode have together


@dataclass(frozen=True)
class Run:
    """A full-order run that starts at rest."""

    title: str  # its loads, for messages
    steps: tuple[tuple[str, Array], ...]  # contact mode and input of each
    dt: float | None  # s; None where every step is an equilibrium
    start: BaseState | None = None  # of a free body: where its frame begins, and how it spins
    share: float = 1.0  # of the loads that it was planned with

    @property
    def contacts(self) -> tuple[str, ...]:
        """The contact modes that it is in, one after another."""
        return tuple(dict.fromkeys(contact for contact, _ in self.steps))

    @property
    def numbers(self) -> Array:
        """Its time step, 0 where it has none, and all inputs; of a free body where it begins, too."""
        return np.concatenate([[self.dt or 0.0], *(u for _, u in self.steps), *(self.start or ())])

    def lowered(self, loads: LoadExtremes, share: float) -> "Run":
        """The run under a share of its loads, with all of what is always there."""
        if share == 1.0:
            return self
        steps = ((contact, loads.whole(loads.passing(u), share)) for contact, u in self.steps)
        return replace(self, steps=tuple(steps), share=share)

    def varied(self, loads: LoadExtremes, shares: Array, start: BaseState | None = None) -> "Run":
        """The run with shares of its pushes and of each of its loads (1 + c,); of a free body one begins otherwise."""

        def shared(u: Array) -> Array:
            pushes = np.full(len(u) - len(loads.resting), shares[0])
            return loads.whole(np.concatenate([pushes, shares[1:]]) * loads.passing(u))

        steps = tuple((contact, shared(u)) for contact, u in self.steps)
        return replace(self, title=f"{self.title}, varied", steps=steps, start=start)

    def snapshot_steps(self) -> range:
        """The steps after which the shape is kept."""
        return range(0, len(self.steps), -(-len(self.steps) // SNAPSHOTS))


@dataclass(frozen=True)
class TrainingData:
    """What a basis and its points are chosen from."""

    columns: Array  # (rows here, any) whose leading singular vectors are the basis, each weighted by what it matters
    shapes: Array  # (rows here, any) for whose forces points are chosen, m
    loads: LoadExtremes  # that they are of
    overshoot: float = 1.0  # how much further runs go than these shapes
    held_out: tuple[tuple[Run, Array], ...] = ()  # runs that nothing was chosen from, and the shapes (rows here, s)


def trained(problem: ReductionProblem, checkpoint: Checkpoint) -> TrainingData:
    """From full-order runs under the scene's loads, and the linear reductions of the contact modes."""
    loads, training, held_out = plan_runs(problem)
    runs, shapes, seen = _simulated(problem, loads, [*training, *held_out], checkpoint)
    if loads.frame is not None and is_free(problem.system):
        loads = replace(loads, frame=replace(loads.frame, spins=seen[:3]))
    trained_shapes, validated = shapes[: len(training)], zip(runs, shapes, strict=True)
    dynamic = training[0].dt is not None
    small = weighted_small_motions(problem, dict((balanced if dynamic else static)(problem)))
    columns = np.hstack([weighted_snapshots(problem, trained_shapes), small])
    reached, last = _reached(problem.system, loads, runs), tuple(validated)[len(training) :]
    found = dict(zip(_acting_strokes(problem.system), seen[3:].tolist(), strict=False))
    reached = replace(reached, inputs=reached.inputs | found)
    if (embedded := problem.system.embedded) is not None:
        watch, fields = SlackWatch(embedded.pushes), problem.system.algebra.gather(np.hstack(trained_shapes))
        for field in problem.system.body.unknowns.expand(fields).reshape(-1, 3, fields.shape[1]).transpose(2, 0, 1):
            watch.look(field)
        problem.messages.extend(watch.messages(in_training=True))
    return TrainingData(columns, np.hstack(trained_shapes), reached, held_out=last)


def _simulated(
    problem: ReductionProblem, loads: LoadExtremes, planned: list[Run], checkpoint: Checkpoint
) -> tuple[list[Run], list[Array], Array]:
    """The runs, under loads that the full model can follow, and the shapes (rows here, s) of each.

    Of free bodies these are in their frames. The last is what was seen at most: spins (3,) of these frames, rad/s, and
    forces of actuators whose strokes are given, N or Pa.
    """
    system, body = problem.system, problem.deformation
    runs: list[Run] = []
    shapes: list[Array] = []
    seen = np.zeros(3 + len(_acting_strokes(system)))
    environment = scene_with_run(system)[0].environment
    relaxing = f"{environment.viscoelasticity}; " if environment.viscoelasticity else ""
    if touches_itself(environment):
        relaxing += f"{environment.contact_law}, {environment.self_contact}; "
    if is_free(system):
        made = body.stepper_in_frame(1.0, _acting(system), ledger=False)
    else:
        made = body.stepper(1.0, _acting(system), ledger=False, system=_inputs_of(system))
    with problem.stages("training runs"), closing(made) as stepper:
        keys = [(f"{body.law}; {relaxing}{', '.join(run.contacts)}", run.numbers) for run in planned]
        earlier = [checkpoint.restored_run(k, *key, system.algebra.rows()) for k, key in enumerate(keys)]
        done = sum(run is not None for run in earlier)
        problem.stages.report("training runs", done, len(planned))
        for number, (run, restored) in enumerate(zip(planned, earlier, strict=True)):
            name = f"training run {number + 1} of {len(planned)}"
            share, snapshots, most = restored or _followed(stepper, run, loads, environment, name)
            seen = np.maximum(seen, most) if len(most) == len(seen) else seen
            if restored is None:
                checkpoint.keep_run(number, *keys[number], share, system.algebra.gather(snapshots), most)
                done += 1
                problem.stages.report("training runs", done, len(planned))
            if share < 1:
                problem.messages.append(
                    f"{name} ({run.title}) was lowered to {share:.2g} of its loads, as the full model does not follow "
                    "more: no more of them is known to the reduced model, either"
                )
            runs.append(run.lowered(loads, share))
            shapes.append(snapshots)
    return runs, shapes, seen


def _followed(
    stepper: Any, run: Run, loads: LoadExtremes, environment: Environment, name: str
) -> tuple[float, Array, Array]:
    """The share of a run's loads that the full model follows, its shapes (rows here, s) and what else is seen then."""
    share, failure = 1.0, None
    while share >= LEAST_SHARE:
        try:
            return share, *_shapes(stepper, run.lowered(loads, share), environment, name)
        except SolverError as error:
            failure, share = failure or error, LOWERING * share
    assert failure is not None
    raise failure


def _reached(system: System, loads: LoadExtremes, runs: list[Run]) -> LoadExtremes:
    """The extremes, of which each is lowered as much as the largest that any run was to have of it."""
    if all(run.share == 1.0 for run in runs):
        return loads
    sizes: dict[tuple[str, str], list[tuple[float, float]]] = defaultdict(list)  # of a load in a run, and as planned
    for run in runs:
        for contact, u in run.steps:
            widths = [system.contacts[contact].shape[1], *system.widths.values()]
            push, *inputs = np.split(loads.passing(u), np.cumsum(widths)[:-1])
            names = [("push", contact), *(("input", name) for name in system.widths)]
            for name, part in zip(names, (push, *inputs), strict=True):
                if size := float(np.linalg.norm(part)):
                    sizes[name].append((size, size / run.share))

    def lowered(kind: str, name: str) -> float:
        acted = np.array(sizes.get((kind, name), [(1.0, 1.0)]))
        return float(acted[:, 0].max() / acted[:, 1].max())

    frame = loads.frame and loads.frame.lowered({name: lowered("input", name) for name in KINDS})
    return replace(
        loads,
        frame=frame,
        inputs={name: lowered("input", name) * size for name, size in loads.inputs.items()},
        pushes={name: lowered("push", name) * push for name, push in loads.pushes.items()},
    )


def _inputs_of(system: System) -> System | None:
    """The system whose inputs training has, where these are not those that its deformation was made of."""
    return None if system.moving_frame is None else system


def is_free(system: System) -> bool:
    """Whether nothing holds the body, nor carries it."""
    return system.moving_frame is not None and not system.moving_frame.carried


def _acting_strokes(system: System) -> list[str]:
    """Actuators whose strokes are given, in the order of the system."""
    controls = scene_with_run(system)[0].environment.controls
    return [name for name in system.actuators if name in controls]


def _acting(system: System) -> ActiveEnvironment | None:
    """What acts in a run beside its inputs, if anything does: what is given as strokes, rubs, or relaxes."""
    scene, _ = scene_with_run(system)
    acting = training_environment(scene.environment)
    found = acting.finds_forces or acting.contact_law is not None
    return ActiveEnvironment(acting) if found or acting.viscoelasticity or acting.is_moving else None


def _shapes(stepper: Any, run: Run, environment: Environment, name: str) -> tuple[Array, Array]:
    """The shapes (rows here, s) of a run, from rest, of a free body in its frame; and what was seen at most."""
    zero = np.zeros(stepper.x.size)
    stepper.set_state(zero, zero)
    if run.start is not None:
        stepper.place(run.start)
    if run.dt is not None:
        stepper.set_time_step(run.dt)
    snapshot_steps, shapes, spins = set(run.snapshot_steps()), [], np.zeros(3)
    forces = np.zeros(0 if stepper.actuators is None else len(stepper.actuators.names))
    try:
        for step, (contact, u) in enumerate(run.steps):
            stepper.switch(contact)
            inputs = step_input(environment, u)
            if run.dt is None:
                stepper.equilibrium(inputs)
            else:
                stepper.step(inputs)
            if step in snapshot_steps:
                shapes.append((stepper.x if run.start is None else stepper.strained)[:, 0].copy())
            if len(forces):
                forces = np.maximum(forces, np.abs(stepper.reactions[: len(forces)]))
            if run.start is not None:
                pose = stepper.pose
                spins = np.maximum(spins, np.abs(pose.angular_velocity @ rotation_matrix(pose.rotation)))
    except SolverError as error:
        raise SolverError(
            f"{name} ({run.title}) does not converge in step {step + 1} of {len(run.steps)}: {error}; its loads are as "
            f"large as in the scene's [run], and {LEAST_SHARE:g} of them is too much, too: lower those"
        ) from error
    return np.column_stack(shapes), np.concatenate([spins, forces])


def plan_runs(problem: ReductionProblem) -> tuple[LoadExtremes, list[Run], list[Run]]:
    """The loads, training runs under them, and held-out ones to validate with."""
    system = problem.system
    scene, scene_run = scene_with_run(system)
    moves = scene.effects.inertia is not None
    period = slowest_period(problem) if moves else 0.0
    dt = max(scene_run.dt, period / STEPS_PER_PERIOD) if moves else None
    loads = load_extremes(problem, period)
    number = min(MAX_RUNS if loads.frame is None else MAX_FRAMED_RUNS, max(MIN_RUNS, 2 * loads.count))
    frame, random, kinds = loads.frame_loads, np.random.default_rng(2), len(loads.resting) + 1
    if touches_itself(scene.environment):
        history = _own_history(system, scene, frame, scene_run.dt, dt)
        more = min(MAX_RUNS, 2 * int(loads.extremes.any(axis=0).sum()))
        shares = [np.full(kinds, VARIED[1]), *random.uniform(*VARIED, (more, kinds))]
        return loads, [history.varied(loads, of) for of in shares], [history]
    own = None if scene.effects.contact is not None else _own_history(system, scene, frame, scene_run.dt, dt)
    if frame is None or not frame.is_free:
        targets = islice(training_targets(loads), number + 1)
        runs = [_grown_and_released(system, loads, *target, dt, period, None) for target in targets]
        return loads, runs[:-1], [*runs[-1:], *([] if own is None else [own])]
    starts = frame.starts(number + 1)
    if own is None:
        flights = zip(training_targets(loads), starts, strict=False)
        runs = [_grown_and_released(system, loads, *target, dt, period, start) for target, start in flights]
        return loads, runs[:-1], runs[-1:]
    runs = [own.varied(loads, random.uniform(*VARIED, kinds), start) for start in starts]
    return loads, [own, *runs[:-1]], runs[-1:]


def _own_history(system: System, scene: Scene, frame: FrameLoads | None, h: float, dt: float | None) -> Run:
    """The scene's own load history, of steps h; all of it, if steps of up to dt (s) reach that far."""
    history, stride = list(scene_history(system, scene, frame)), 1
    if dt is not None:
        stride = min(-(-len(history) // MAX_HISTORY_STEPS), max(1, int(dt / h)))
    steps = tuple(islice(in_longer_steps(history, stride), MAX_HISTORY_STEPS))
    start = None if frame is None else frame.start_of_run()
    return Run("the scene's own load history", steps, None if dt is None else stride * h, start)


def _grown_and_released(
    system: System,
    loads: LoadExtremes,
    contact: str,
    target: Array,
    dt: float | None,
    period: float,
    start: BaseState | None,
) -> Run:
    """The run of a target: grow, hold, let go, swing; without inertia, grow alone."""
    shares: Array = np.arange(1, STATIC_STEPS + 1) / STATIC_STEPS
    if dt is not None:
        time = (np.arange(round(RUN_PERIODS * period / dt)) + 0.5) * dt / period
        shares = np.where(time < GROWING_PERIODS + HOLDING_PERIODS, np.minimum(time / GROWING_PERIODS, 1.0), 0.0)
    names = [f"{contact}[{k}]" for k in range(len(target) - len(loads.resting))]
    names += [name if width == 1 else f"{name}[{k}]" for name, width in system.widths.items() for k in range(width)]
    title = ", ".join(f"{name} {value:.3g}" for name, value in zip(names, loads.whole(target), strict=True) if value)
    return Run(title, tuple((contact, loads.whole(target, share)) for share in shares), dt, start)


def weighted_snapshots(problem: ReductionProblem, runs: list[Array]) -> Array:
    """The shapes of all runs, each run as important as any other: it may be of a load that moves the body little."""
    inner, M = problem.system.algebra.inner, problem.system.mass
    return np.hstack([shapes / (np.sqrt(np.trace(inner(shapes, M @ shapes))) or 1.0) for shapes in runs])


def weighted_small_motions(problem: ReductionProblem, bases: Mapping[str, RankedBasis]) -> Array:
    """The directions of linear contact modes, weighted by their singular values: so that small loads stay right."""
    columns = []
    for name, ranked in bases.items():
        m = problem.order_of(name) or len(ranked.singular_values)
        T = problem.space.basis[:, : len(ranked.coordinates)] @ ranked.coordinates[:, :m]
        T = T / np.sqrt(np.diag(problem.system.algebra.inner(T, problem.system.mass @ T)))
        σ = ranked.singular_values[: T.shape[1]]
        columns.append(SMALL_MOTION_WEIGHT * T * σ / np.linalg.norm(σ))
    return np.hstack(columns)
