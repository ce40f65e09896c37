"""Method "trained": what a body does in full-order runs, and the directions of its small motions."""

from contextlib import closing
from dataclasses import dataclass
from typing import Any

import numpy as np

from fenics_rom.errors import SolverError
from fenics_rom.mechanics.step import StepInput
from fenics_rom.reduction.checkpoint import Checkpoint
from fenics_rom.reduction.hyperreduction.basis import weighted_small_motions, weighted_snapshots
from fenics_rom.reduction.hyperreduction.training_runs import Run, plan_runs
from fenics_rom.reduction.methods.balanced import balanced
from fenics_rom.reduction.methods.static import static
from fenics_rom.reduction.problem import ReductionProblem
from fenics_rom.system.protocols import Array


@dataclass(frozen=True)
class TrainingData:
    """What a basis and its points are chosen from.

    Attributes:
        columns: (rows here, any) whose leading singular vectors are the basis, each weighted by what it matters.
        shapes: (rows here, any) for whose forces points are chosen, m.
        held_out: runs that nothing was chosen from, and the shapes (rows here, s) in each.
    """

    columns: Array
    shapes: Array
    held_out: tuple[tuple[Run, Array], ...] = ()


def trained(problem: ReductionProblem, checkpoint: Checkpoint) -> TrainingData:
    """From full-order runs under the scene's loads, and the linear reductions of the contact modes.

    Raises:
        SceneError: the scene has no loads to train with.
        SolverError: a run does not converge.
        FileError: a checkpoint of something else, or one that cannot be written.
    """
    training, held_out = plan_runs(problem)
    shapes = _simulated(problem, [*training, *held_out], checkpoint)
    trained_shapes, held_out_shapes = shapes[: len(training)], shapes[len(training) :]
    dynamic = training[0].dt is not None
    small = weighted_small_motions(problem, dict((balanced if dynamic else static)(problem)))
    columns = np.hstack([weighted_snapshots(problem, trained_shapes), small])
    return TrainingData(columns, np.hstack(trained_shapes), tuple(zip(held_out, held_out_shapes, strict=True)))


def _simulated(problem: ReductionProblem, runs: list[Run], checkpoint: Checkpoint) -> list[Array]:
    """The shapes (rows here, s) of each run."""
    system, shapes = problem.system, []
    body = system.deformation
    assert body is not None
    with problem.stages("training runs"), closing(body.stepper(1.0, ledger=False)) as stepper:
        for number, run in enumerate(runs):
            problem.stages.report("training runs", number, len(runs))
            key = f"{body.law}; {run.title}; {len(run.steps)} steps of {run.dt} s"
            snapshots = checkpoint.restored_run(number, key, system.algebra.rows())
            if snapshots is None:
                snapshots = _shapes(stepper, run, f"training run {number + 1} of {len(runs)}")
                checkpoint.keep_run(number, key, system.algebra.gather(snapshots))
            shapes.append(snapshots)
    problem.stages.report("training runs", len(runs), len(runs))
    return shapes


def _shapes(stepper: Any, run: Run, name: str) -> Array:
    """The shapes (rows here, s) of a run, from rest."""
    zero = np.zeros(stepper.x.size)
    stepper.set_state(zero, zero)
    if run.dt is not None:
        stepper.set_time_step(run.dt)
    snapshot_steps, shapes = set(run.snapshot_steps()), []
    try:
        for step, (contact, u) in enumerate(run.steps):
            stepper.switch(contact)
            if run.dt is None:
                stepper.equilibrium(StepInput(u))
            else:
                stepper.step(StepInput(u))
            if step in snapshot_steps:
                shapes.append(stepper.x[:, 0].copy())
    except SolverError as error:
        raise SolverError(
            f"{name} ({run.title}) does not converge in step {step + 1} of {len(run.steps)}: {error}; its loads are as "
            "large as in the scene's [run]: lower those"
        ) from error
    return np.column_stack(shapes)
