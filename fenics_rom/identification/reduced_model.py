"""A model of a few displacements that answers an experiment at any values θ, with exact derivatives."""

from collections.abc import Mapping, Sequence

import numpy as np

from fenics_rom.identification.affine import AffineDecomposition
from fenics_rom.identification.experiment import Experiment
from fenics_rom.identification.parameters import DENSITY
from fenics_rom.identification.sensitivities import MidpointPropagator, sensitivity_forces

Array = np.ndarray


class ReducedModel:
    """The scene on a basis Q: x = Q ξ.

    Args:
        parts: of its matrices and inputs on Q.
    """

    def __init__(self, parts: AffineDecomposition):
        self.parts = parts

    @property
    def order(self) -> int:
        """Number k of its displacements."""
        return len(self.parts.springs)

    def predict(self, experiment: Experiment, θ: Array) -> Array:
        """What it says of all values of an experiment, (N,), m."""
        return self.linearize(experiment, θ, [])[0]

    def linearize(self, experiment: Experiment, θ: Array, directions: Sequence[Array]) -> tuple[Array, Array]:
        """What it says, (N,), m, and how that changes in directions of θ, (N, directions)."""
        C = np.array([self.parts.outputs[m.output][m.row] for m in experiment.markers])
        run, run_along = self._moving(experiment, θ, directions)
        rest, rest_along = self._at_rest(experiment, θ, directions)
        value = experiment.predictions((C @ run)[..., 0], (C @ rest)[..., 0])
        return value, experiment.predictions(C @ run_along, C @ rest_along)

    def _moving(self, experiment: Experiment, θ: Array, directions: Sequence[Array]) -> tuple[Array, Array]:
        """ξ at all step ends, (steps + 1, k, 1), and its derivatives, (steps + 1, k, directions)."""
        k, steps, h = self.order, experiment.steps, experiment.dt
        if not steps:
            return np.zeros((1, k, 1)), np.zeros((1, k, len(directions)))
        steady, weighed = self._forces(experiment.inputs, steps)
        propagator = MidpointPropagator(self.parts.at(θ), h)
        states = propagator.run((steady + _weighted(θ, weighed))[:, :, None])
        if not directions:
            return states[:, :k], np.zeros((steps + 1, k, 0))
        pushed = [
            sensitivity_forces(self.parts.along(θ, dθ), h, states[:, :, 0]) + _weighted(dθ, weighed)
            for dθ in directions
        ]
        return states[:, :k], propagator.run(np.stack(pushed, axis=2))[:, :k]

    def _at_rest(self, experiment: Experiment, θ: Array, directions: Sequence[Array]) -> tuple[Array, Array]:
        """ξ in all equilibria, (R, k, 1), and its derivatives, (R, k, directions)."""
        count = experiment.equilibria
        if not count:
            return np.zeros((0, self.order, 1)), np.zeros((0, self.order, len(directions)))
        steady, weighed = self._forces(experiment.rest_inputs, count)
        K = self.parts.at(θ).stiffness
        ξ = np.linalg.solve(K, (steady + _weighted(θ, weighed)).T)
        along = [
            np.linalg.solve(K, _weighted(dθ, weighed).T - self.parts.along(θ, dθ).stiffness @ ξ).T for dθ in directions
        ]
        return ξ.T[:, :, None], np.stack(along, axis=2) if along else np.zeros((count, self.order, 0))

    def _forces(self, inputs: Mapping[str, Array], count: int) -> tuple[Array, Array]:
        """Forces (count, k) that do not depend on θ, and those per density of each material, (m, count, k)."""
        steady = np.zeros((count, self.order))
        weighed = np.zeros((len(self.parts.mass), count, self.order))
        for name, u in inputs.items():
            steady += u @ self.parts.inputs[name].T
            weighed += u @ self.parts.weights[name].transpose(0, 2, 1)
        return steady, weighed


def _weighted(θ: Array, weighed: Array) -> Array:
    """Σ ρ_i times what there is per density of each material."""
    return np.tensordot(θ[:-1, DENSITY], weighed, 1)
