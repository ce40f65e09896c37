"""What the full-order model says of an experiment."""

from contextlib import closing

import numpy as np

from fenics_rom.fem.simulate import simulate
from fenics_rom.identification.experiment import Experiment
from fenics_rom.io.progress import Report
from fenics_rom.system.system import System

Array = np.ndarray


def predict_full_order(system: System, experiment: Experiment, report: Report) -> tuple[Array, tuple[str, ...]]:
    """All values, (N,), m, and what the user should know of the run; every rank must call it.

    Args:
        system: assembled from a scene.
        experiment: what it has to answer.
        report: as of `simulate`.
    """
    run, messages = np.zeros((1, len(experiment.markers))), system.warnings
    if experiment.steps:
        record = simulate(system, report=report)
        run = np.stack([record.outputs[m.output][:, m.point, m.axis] for m in experiment.markers], axis=1)
        messages = record.warnings
    return experiment.predictions(run, _at_rest(system, experiment)), messages


def _at_rest(system: System, experiment: Experiment) -> Array:
    """Markers in all equilibria, (R, n)."""
    if not experiment.equilibria:
        return np.zeros((0, len(experiment.markers)))
    inner = system.algebra.inner
    forces = sum(system.input_matrix(name) @ u.T for name, u in experiment.rest_inputs.items())
    with closing(system.algebra.factor((1.0, system.stiffness))) as factor:
        x = factor.solve(forces)
    columns = np.stack([system.outputs[m.output][:, m.row] for m in experiment.markers], axis=1)
    return inner(x, columns)
