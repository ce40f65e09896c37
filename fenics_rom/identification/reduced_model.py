"""A model of a few displacements that answers an experiment at any values θ, with exact derivatives.

It is on a basis of the scene at some values, for what pushes it and what is seen of it. What the markers see counts
like a force on them: with K⁻¹C of the outputs in the basis, what a reduced model says is right to second order, and so
is how that changes with the parameters.

Derivatives of a run are exact step by step. With A = 2/h M + D + h/2 K a step is A v̂ = f + 2/h M v - K x, x⁺ = x + h v̂,
v⁺ = 2 v̂ - v (the paper's (2)-(4)). In a direction of the parameters the same step holds of (dx, dv), pushed by
df - dA v̂ + 2/h dM v - dK x.
"""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import FenicsRomWarning
from fenics_rom.identification.affine import AffineDecomposition, Matrices, weight_columns
from fenics_rom.identification.experiment import Experiment
from fenics_rom.reduction.reduce import reduce
from fenics_rom.system.system import System

BALANCED_TOLERANCE = 1e-4  # share of the sum of σ that is left out
STATIC_TOLERANCE = 1e-14  # and of compliance: nothing
MARKER_CONTACT, TILTED_CONTACT = "the markers", "weight along all axes"  # as contact modes
PRECISION = 1e-13  # of exact derivatives
RANK_TOLERANCE = 1e-10  # share of a unit column that must be new for it to count as a direction


def make_basis(system: System, experiment: Experiment, *, tilting: bool = False) -> Array:
    """Q (rows here, k), QᵀQ = I, of a system at the values that it is to be best at; errors are those of `reduce`.

    It knows weight along all axes where gravity is `tilting`. Every rank must call it.
    """
    marker_columns = experiment.marker_columns(system)
    start, bases = experiment.start, []
    at_rest = {**experiment.rest_inputs, **(start.equilibrium if start else {})}
    with warnings.catch_warnings(action="ignore", category=FenicsRomWarning):  # the final check is of the full model
        for method, inputs, tolerance in (
            ("balanced", experiment.inputs, BALANCED_TOLERANCE),
            ("static", at_rest, STATIC_TOLERANCE),
        ):
            if inputs:
                contacts = {name: system.contacts[name] for name in inputs} | {MARKER_CONTACT: marker_columns}
                if tilting:
                    columns = weight_columns(system)
                    contacts[TILTED_CONTACT] = columns / np.sqrt(np.trace(system.algebra.inner(columns, columns)))
                acting = replace(system, contacts=contacts, contact_points={})
                bases.append(reduce(acting, method=method, tolerance=tolerance, switching="energy").basis)
    if start is not None:
        fields = system.algebra.gather(start.fields)
        bases.append(fields[:, fields.any(axis=0)])
    columns = np.hstack(bases)
    U, s, _ = np.linalg.svd(columns / np.linalg.norm(columns, axis=0), full_matrices=False)
    return U[:, s > RANK_TOLERANCE * s[0]][system.algebra.rows()]


class ReducedModel:
    """The scene on a basis Q, x = Q ξ, by the parts of its matrices and inputs there.

    Args:
        parts: of the basis.
        start: Qᵀ of the displacement and velocity that a run begins with beside an equilibrium, (k, 2); None: nothing.
    """

    precision = PRECISION

    def __init__(self, parts: AffineDecomposition, start: Array | None = None):
        self.parts = parts
        self._start = np.zeros((self.order, 2)) if start is None else start

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
        seen, seen_at_rest = (C @ run)[..., 0], (C @ rest)[..., 0]
        along = experiment.predictions(C @ run_along, C @ rest_along, θ)
        for column, dθ in zip(along.T, directions, strict=True):
            column += experiment.clock_slopes(seen, θ, dθ)
        return experiment.predictions(seen, seen_at_rest, θ), along

    def _moving(self, experiment: Experiment, θ: Array, directions: Sequence[Array]) -> tuple[Array, Array]:
        """ξ at all step ends, (steps + 1, k, 1), and its derivatives, (steps + 1, k, directions)."""
        k, steps, h = self.order, experiment.steps, experiment.dt
        if not steps:
            return np.zeros((1, k, 1)), np.zeros((1, k, len(directions)))
        states = self.states(experiment, θ)
        if not directions:
            return states[:, :k, None], np.zeros((steps + 1, k, 0))
        pushed = [self.pushes(experiment, θ, dθ, states) for dθ in directions]
        _, first = self._first(experiment, θ, directions)
        propagator = MidpointPropagator(self.parts.at(θ), h)
        return states[:, :k, None], propagator.run(np.stack(pushed, axis=2), first)[:, :k]

    def states(self, experiment: Experiment, θ: Array) -> Array:
        """[ξ, ξ'] of the run at all step ends, (steps + 1, 2 k)."""
        forces = self.parts.forces(experiment.inputs, experiment.steps, θ)
        first, _ = self._first(experiment, θ, [])
        return MidpointPropagator(self.parts.at(θ), experiment.dt).run(forces[:, :, None], first)[:, :, 0]

    def pushes(self, experiment: Experiment, θ: Array, dθ: Array, states: Array) -> Array:
        """What a direction of θ pushes the run with in each step, (steps, k)."""
        pushed = self.parts.forces_along(experiment.inputs, experiment.steps, θ, dθ)
        return sensitivity_forces(self.parts.along(θ, dθ), experiment.dt, states) + pushed

    def _first(self, experiment: Experiment, θ: Array, directions: Sequence[Array]) -> tuple[Array, Array]:
        """ξ and its rate where the run begins, (2 k, 1), and their derivatives, (2 k, directions)."""
        first, along = np.concatenate(self._start.T)[:, None], np.zeros((2 * self.order, len(directions)))
        if experiment.start is not None and experiment.start.equilibrium:
            ξ, ξ_along = self._equilibria(experiment.start.equilibrium, 1, θ, directions)
            first[: self.order] += ξ[0]
            along[: self.order] = ξ_along[0]
        return first, along

    def _at_rest(self, experiment: Experiment, θ: Array, directions: Sequence[Array]) -> tuple[Array, Array]:
        """ξ in all equilibria, (R, k, 1), and its derivatives, (R, k, directions)."""
        return self._equilibria(experiment.rest_inputs, experiment.equilibria, θ, directions)

    def _equilibria(
        self, inputs: Mapping[str, Array], count: int, θ: Array, directions: Sequence[Array]
    ) -> tuple[Array, Array]:
        """ξ (count, k, 1) under inputs (count, p) of contact modes, and its derivatives (count, k, directions)."""
        if not count:
            return np.zeros((0, self.order, 1)), np.zeros((0, self.order, len(directions)))
        K = self.parts.at(θ).stiffness
        ξ = np.linalg.solve(K, self.parts.forces(inputs, count, θ).T)
        along = []
        for dθ in directions:
            pushed = self.parts.forces_along(inputs, count, θ, dθ).T
            along.append(np.linalg.solve(K, pushed - self.parts.along(θ, dθ).stiffness @ ξ).T)
        return ξ.T[:, :, None], np.stack(along, axis=2) if along else np.zeros((count, self.order, 0))


class MidpointPropagator:
    """The step of one model at one step size h, s."""

    def __init__(self, matrices: Matrices, h: float):
        M, K = matrices.mass, matrices.stiffness
        self._h, self._step_operator = h, step_operator(matrices, h)
        v = np.linalg.solve(self._step_operator, np.hstack([-K, 2 / h * M]))
        k = len(M)
        self._after = np.vstack([h * v, 2 * v]) + np.diag(np.repeat([1.0, -1.0], k))

    def run(self, forces: Array, first: Array) -> Array:
        """Displacements and velocities [x, v], (steps + 1, 2 k, c), from the first on, under forces (steps, k, c)."""
        steps, k, c = forces.shape
        pushed = np.linalg.solve(self._step_operator, forces.transpose(1, 0, 2).reshape(k, -1))
        pushed = pushed.reshape(k, steps, c).transpose(1, 0, 2)
        states = np.zeros((steps + 1, 2 * k, c))
        states[0] = first
        states[1:, :k], states[1:, k:] = self._h * pushed, 2 * pushed
        for before, after in pairwise(states):
            after += self._after @ before
        return states


def step_operator(matrices: Matrices, h: float) -> Array:
    """A = 2/h M + D + h/2 K, or its derivative."""
    return 2 / h * matrices.mass + matrices.damping + h / 2 * matrices.stiffness


def sensitivity_forces(along: Matrices, h: float, states: Array) -> Array:
    """-dA v̂ + 2/h dM v - dK x of a run (steps + 1, 2 k), (steps, k): what a change of the matrices pushes with."""
    k = states.shape[1] // 2
    x, v = states[:-1, :k], states[:-1, k:]
    middle = (v + states[1:, k:]) / 2
    return 2 / h * v @ along.mass - x @ along.stiffness - middle @ step_operator(along, h)
