"""What the full order says of an experiment: the last word on a fit, and what its reduced model may be made of."""

from contextlib import closing
from dataclasses import dataclass

import numpy as np
from numpy import ndarray as Array

from fenics_rom.fem.simulate import simulate
from fenics_rom.identification.experiment import Experiment
from fenics_rom.io.progress import Report
from fenics_rom.mechanics.readings import MarkerReading
from fenics_rom.mechanics.step import StepInput
from fenics_rom.system.system import System


@dataclass(frozen=True)
class FullOrderAnswer:
    """Of one scene, at its values."""

    run: Array  # markers at all step ends, (steps + 1, n), m
    rest: Array  # markers in all equilibria, (R, n), m
    shapes: Array  # in the run, and then in all equilibria, (rows here, s + R), m
    warnings: tuple[str, ...]  # what the user should know

    def predictions(self, experiment: Experiment, θ: Array) -> Array:
        """Of all values of the experiment, (N,), m; θ has the clocks."""
        return experiment.predictions(self.run, self.rest, θ)


def answer_of(system: System, experiment: Experiment, report: Report) -> FullOrderAnswer:
    """What a system says; every rank must call it, and gets it. Errors are those of `simulate`."""
    columns = experiment.marker_columns(system)
    run, shapes, messages = np.zeros((1, len(experiment.markers))), columns[:, :0], system.warnings
    if experiment.steps:
        record = simulate(system, every=1, report=report)
        seen = {**record.outputs, **{name: series.values[:, None] for name, series in record.readings.items()}}
        run = np.stack([seen[m.output][:, m.point, m.axis] for m in experiment.markers], axis=1)
        fields = record.snapshots.reshape(len(record.snapshots), -1)
        shapes, messages = fields[:, system.body.free].T[system.algebra.rows()], record.warnings
    at_rest = equilibria_of(system, experiment)
    resting = system.algebra.inner(at_rest, columns)
    if system.deformation is not None:
        fields = system.algebra.gather(at_rest)
        for k, marker in enumerate(experiment.markers):
            reading = system.readings.get(marker.output)
            if isinstance(reading, MarkerReading):
                resting[:, k] = reading.turned((reading.operator @ fields).T.reshape(-1, 3, 3))[:, marker.axis]
    return FullOrderAnswer(run, resting, np.hstack([shapes, at_rest]), messages)


def equilibria_of(system: System, experiment: Experiment) -> Array:
    """Shapes (rows here, R) of an experiment's equilibria, m."""
    if not experiment.equilibria:
        return experiment.marker_columns(system)[:, :0]
    if system.deformation is None:
        forces = sum(system.input_matrix(name) @ u.T for name, u in experiment.rest_inputs.items())
        with closing(system.algebra.factor((1.0, system.stiffness))) as factor:
            return factor.solve(forces)
    shapes = []
    with closing(system.deformation.stepper(1.0, ledger=False)) as stepper:
        for row in range(experiment.equilibria):
            name, u = next(
                ((name, u[row]) for name, u in experiment.rest_inputs.items() if u[row].any()),
                next((name, u[row]) for name, u in experiment.rest_inputs.items()),
            )
            stepper.set_state(*np.zeros((2, stepper.x.size)))
            stepper.switch(name)
            stepper.equilibrium(StepInput(u))
            shapes.append(stepper.x[:, 0].copy())
    return np.column_stack(shapes)
