"""Full-order runs that show a reduction how a body deforms under the loads of its scene.

Each begins at rest, lets loads grow to a target within half of the slowest period, so that the body overshoots, holds
them, lets go and swings: what the scene does at its worst moment, then actuators, loads and contact modes one by one,
and together. A contact mode that the scene never pushes is pushed by as much as undoes there what the other loads do:
obstacles do no more.
"""

from dataclasses import dataclass
from itertools import islice

import numpy as np

from fenics_rom.reduction.hyperreduction.training_loads import (
    LoadExtremes,
    load_extremes,
    scene_history,
    scene_with_run,
    slowest_period,
    training_targets,
)
from fenics_rom.reduction.problem import ReductionProblem
from fenics_rom.scene.scene import Scene
from fenics_rom.system.protocols import Array
from fenics_rom.system.system import System

MIN_RUNS, MAX_RUNS = 10, 14
STEPS_PER_PERIOD = 60  # of the slowest motion; no more, if the scene's are shorter
STATIC_STEPS = 10  # of a load that grows without inertia
SNAPSHOTS = 50  # of each run
MAX_HISTORY_STEPS = 400  # of the scene's own load history
GROWING_PERIODS, HOLDING_PERIODS, RUN_PERIODS = 0.5, 0.75, 2.5  # slowest periods that loads grow, are held, runs take


@dataclass(frozen=True)
class Run:
    """A full-order run that starts at rest.

    Attributes:
        title: its loads, for messages.
        steps: contact mode and input of each.
        dt: s; None where every step is an equilibrium.
    """

    title: str
    steps: tuple[tuple[str, Array], ...]
    dt: float | None

    def snapshot_steps(self) -> range:
        """The steps after which the shape is kept."""
        return range(0, len(self.steps), -(-len(self.steps) // SNAPSHOTS))


def plan_runs(problem: ReductionProblem) -> tuple[list[Run], list[Run]]:
    """Training runs, and held-out ones to validate with.

    Raises:
        SceneError: the scene has no load history, or one in which nothing acts.
    """
    system = problem.system
    scene = scene_with_run(system)
    assert scene.run is not None
    moves = scene.effects.inertia is not None
    period = slowest_period(problem) if moves else 0.0
    dt = max(scene.run.dt, period / STEPS_PER_PERIOD) if moves else None
    loads = load_extremes(problem, period)
    number = min(MAX_RUNS, max(MIN_RUNS, 2 * loads.count))
    runs = [
        _grown_and_released(system, loads, contact, u, dt, period)
        for contact, u in islice(training_targets(loads), number + 1)
    ]
    held_out = runs[-1:]
    if scene.effects.contact is None:  # where obstacles do not stop the body, it would go too far without them
        held_out.append(_of_scene(system, scene, dt))
    return runs[:-1], held_out


def _grown_and_released(
    system: System, loads: LoadExtremes, contact: str, target: Array, dt: float | None, period: float
) -> Run:
    """The run of a target: grow, hold, let go, swing; without inertia, grow alone."""
    shares: Array = np.arange(1, STATIC_STEPS + 1) / STATIC_STEPS
    if dt is not None:
        time = (np.arange(round(RUN_PERIODS * period / dt)) + 0.5) * dt / period
        shares = np.where(time < GROWING_PERIODS + HOLDING_PERIODS, np.minimum(time / GROWING_PERIODS, 1.0), 0.0)
    names = [f"{contact}[{k}]" for k in range(len(target) - len(loads.resting))]
    names += [name if width == 1 else f"{name}[{k}]" for name, width in system.widths.items() for k in range(width)]
    title = ", ".join(f"{name} {value:.3g}" for name, value in zip(names, loads.whole(target), strict=True) if value)
    return Run(title, tuple((contact, loads.whole(target, share)) for share in shares), dt)


def _of_scene(system: System, scene: Scene, dt: float | None) -> Run:
    """The beginning of the scene's own history."""
    assert scene.run is not None
    steps = tuple(islice(scene_history(system, scene), MAX_HISTORY_STEPS))
    return Run("the scene's own load history", steps, None if dt is None else scene.run.dt)
