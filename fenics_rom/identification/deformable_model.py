"""A model of a few displacements of a body that deforms largely, made of one run at full order.

The basis is a proper orthogonal decomposition, in the mass norm, of the shapes of that run and of what other moduli
would make of them at small strain, with as few points as give the forces on them (ECSW, as in
`reduction.hyperreduction`). At other values θ the moduli of its points, its mass and its damping are others. What it
lacks of the full order where it was made is added to all that it says: so a fit that is repeated where the last one
ended ends where one at full order would.

Derivatives are differences of runs at slightly other values, all at once (`deformable_bodies`).
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy import ndarray as Array

from fenics_rom.identification.affine import AffineDecomposition, AffineSystem, lame_parameters, weight_columns
from fenics_rom.identification.deformable_bodies import DeformableBodies, DeformablePoints
from fenics_rom.identification.experiment import Experiment, interpolate_instants
from fenics_rom.identification.full_order import FullOrderAnswer
from fenics_rom.identification.parameters import FIRST_CLOCK, POISSON, YOUNG
from fenics_rom.mechanics.readings import MarkerReading
from fenics_rom.reduction.balancing import choose_order
from fenics_rom.reduction.common_basis import significant_eigenpairs
from fenics_rom.reduction.hyperreduction.cubature import fit_cubature
from fenics_rom.rom.deformation import ReducedDeformation
from fenics_rom.system.system import System

DIFFERENCE = 1e-4  # of q, to either side: derivatives are off by its square, and by round-off over it

# Of the basis and of the forces of points, finer than for a run: derivatives that resemble each other are to differ.
BASIS_TOLERANCE, CUBATURE_TOLERANCE = 3e-6, 2e-3
# Of ν, of E as a share, and of gravity's direction, that the basis is to follow well.
POISSON_CHANGE, YOUNG_CHANGE, TILT_CHANGE = 0.02, 0.1, 0.1
PRECISION = 1e-8  # of differences of runs whose steps are solved to 1e-12


@dataclass(frozen=True)
class DeformableModel:
    """The scene on a basis W, x = W q, WᵀMW = I where it was made."""

    parts: AffineDecomposition  # on W
    body: ReducedDeformation  # of the values where it was made
    points: DeformablePoints
    readings: Mapping[str, MarkerReading]  # on W, of markers off the surface
    start: Array  # WᵀM of the displacement and velocity that a run begins with beside an equilibrium, (m, 2)
    answer: FullOrderAnswer  # where it was made
    shapes: Array  # Wᵀ M of its shapes, (m, s + R)
    centre: Array  # θ where it was made
    experiment: Experiment  # that was answered

    precision = PRECISION

    @property
    def order(self) -> int:
        """Number m of its displacements."""
        return self.body.order

    def predict(self, experiment: Experiment, θ: Array) -> Array:
        """What it says of all values of an experiment, (N,), m."""
        return self.linearize(experiment, θ, [])[0]

    def linearize(self, experiment: Experiment, θ: Array, directions: Sequence[Array]) -> tuple[Array, Array]:
        """What it says, (N,), m, and how that changes in directions of θ, (N, directions).

        Raises:
            SolverError: it has no such run or equilibrium.
        """
        moving = [dθ for dθ in directions if dθ[:, :FIRST_CLOCK].any()]
        values = [θ, *(θ + side * DIFFERENCE * dθ for side in (1, -1) for dθ in moving)]
        run, rest = self._answers(experiment, values)
        seen, seen_at_rest = (
            run[..., 0] + self._lacking_in_run(len(run), experiment.dt),
            rest[..., 0] + self._lacking[1],
        )
        slopes = np.zeros((len(experiment.measured), len(directions)))
        moved = [
            (plus - minus) / (2 * DIFFERENCE)
            for part in (run, rest)
            for plus, minus in [np.split(part[..., 1:], 2, axis=-1)]
        ]
        along = iter(experiment.predictions(moved[0], moved[1], θ).T)
        for column, dθ in zip(slopes.T, directions, strict=True):
            if dθ[:, :FIRST_CLOCK].any():
                column += next(along)
            column += experiment.clock_slopes(seen, θ, dθ)
        return experiment.predictions(seen, seen_at_rest, θ), slopes

    @cached_property
    def _lacking(self) -> tuple[Array, Array]:
        """What it lacks of the full order where it was made: of the run (steps + 1, n), and at rest (R, n), m."""
        run, rest = self._answers(self.experiment, [self.centre])
        return self.answer.run - run[..., 0], self.answer.rest - rest[..., 0]

    def _lacking_in_run(self, count: int, h: float) -> Array:
        """The former at the ends of steps of h, s, as many as `count` (count, n)."""
        lack, own = self._lacking[0], self.experiment
        if h == own.dt or not own.steps:
            return lack[:count]
        nodes, weights = interpolate_instants(h * np.arange(count), own.dt, own.steps)
        between: Array = np.einsum("tk,tkn->tn", weights, lack[nodes])
        return between

    def _answers(self, experiment: Experiment, values: Sequence[Array]) -> tuple[Array, Array]:
        """Markers at all step ends (steps + 1, n, B) and in all equilibria (R, n, B), at B values of θ."""
        bodies = DeformableBodies(self.parts, self.body, self.points, values)
        run = np.zeros((1, self.order, len(values)))
        if experiment.steps:
            forces = self._forces(experiment.inputs, experiment.steps, values)
            q, r = np.repeat(self.start.T[:, :, None], len(values), axis=2)
            if experiment.start is not None and experiment.start.equilibrium:
                pushed = self._forces(experiment.start.equilibrium, 1, values)[0]
                q = q + bodies.equilibrium(pushed, self.shapes[:, 0] - self.start[:, 0])
            run = bodies.run(forces, q, r, experiment.dt)
        rest = np.zeros((0, self.order, len(values)))
        if count := experiment.equilibria:
            pushes = self._forces(experiment.rest_inputs, count, values)
            guesses = self.shapes.T[-count:]
            rest = np.stack([bodies.equilibrium(*each) for each in zip(pushes, guesses, strict=True)])
        return self._seen(experiment, run), self._seen(experiment, rest)

    def _seen(self, experiment: Experiment, states: Array) -> Array:
        """Markers (T, n, B) of displacements (T, m, B)."""
        seen = np.array([self.parts.outputs[m.output][m.row] for m in experiment.markers]) @ states
        for k, marker in enumerate(experiment.markers):
            reading = self.readings.get(marker.output)
            if reading is not None:
                moved = (reading.operator @ states).swapaxes(1, 2)
                seen[:, k] = reading.turned(moved.reshape(*moved.shape[:2], 3, 3))[..., marker.axis]
        return seen

    def _forces(self, inputs: Mapping[str, Array], count: int, values: Sequence[Array]) -> Array:
        """(count, m, B)."""
        return np.stack([self.parts.forces(inputs, count, θ) for θ in values], axis=2)


def make_deformable_model(
    affine: AffineSystem, system: System, experiment: Experiment, θ: Array, answer: FullOrderAnswer, *, tilting: bool
) -> DeformableModel:
    """The model of a system at values θ, whose gravity may be tilting, from what it answered; every rank must call it.

    Raises:
        SolverError: no positive weights of few points give the forces.
    """
    scene, deformation, inner = system.scene, system.deformation, system.algebra.inner
    assert scene is not None
    assert deformation is not None
    fields = np.zeros((system.local_size, 2)) if experiment.start is None else experiment.start.fields
    columns = np.hstack([answer.shapes, *_changed_shapes(affine, system, θ, answer.shapes, tilting)])
    w, E = significant_eigenpairs(inner(columns, system.mass @ columns))
    m = choose_order(np.sqrt(w), None, BASIS_TOLERANCE)
    W = columns @ (E[:, :m] / np.sqrt(w[:m]))
    γ, U = np.linalg.eigh(inner(W, system.stiffness @ W))
    W = W @ U
    gradients, shapes = deformation.gradients(W), inner(W, system.mass @ answer.shapes)
    cubature = fit_cubature(deformation, system.algebra, gradients, γ, shapes, CUBATURE_TOLERANCE)
    material, dilation, shear = affine.points
    here, parts, whole = cubature.points, affine.parts(W), system.algebra.gather(W)

    def gathered(values: Array) -> Array:
        """Values (K here, ...) of the kept points of all ranks."""
        return system.algebra.gather(np.ascontiguousarray(values))

    return DeformableModel(
        parts=parts,
        body=ReducedDeformation(
            law=deformation.law,
            gradients=np.ascontiguousarray(gathered(gradients[:, :, here].transpose(2, 0, 1, 3)).transpose(1, 2, 0, 3)),
            weights=gathered(cubature.weights * deformation.weights[here]),
            first_lame=gathered(deformation.first_lame[here]),
            shear=gathered(deformation.shear[here]),
            viscosity=gathered(deformation.viscosity[here]),
            external_damping=parts.external_damping(θ),
            springs=parts.springs,
            training_radius=float(np.linalg.norm(shapes, axis=0).max()),
            points_of=int(system.algebra.total(len(deformation.weights))),
            cubature_error=cubature.error,
        ),
        points=DeformablePoints(gathered(material[here]).astype(int), gathered(dilation[here]), gathered(shear[here])),
        readings={
            name: replace(reading, operator=reading.operator @ whole)
            for name, reading in system.readings.items()
            if isinstance(reading, MarkerReading)
        },
        start=inner(W, system.mass @ fields),
        answer=answer,
        shapes=shapes,
        centre=θ,
        experiment=experiment,
    )


def _changed_shapes(affine: AffineSystem, system: System, θ: Array, shapes: Array, tilting: bool) -> Iterator[Array]:
    """How shapes (rows here, s) change with Poisson's ratio of each material and, where there are several, with E.

    That is at small strain, under the forces that hold them: K⁻¹ (K' - K) x of another stiffness K'. And how weight
    changes them where gravity is tilting.
    """
    assert system.scene is not None
    kinds = {POISSON: -POISSON_CHANGE} | ({YOUNG: YOUNG_CHANGE} if len(θ) > 2 else {})
    moduli, gravity = np.array(lame_parameters(θ)), system.scene.effects.gravity
    with closing(system.algebra.factor((1.0, system.stiffness))) as factor:
        for row in range(len(θ) - 1):
            dilated, sheared = affine.strained(row, shapes)
            for column, change in kinds.items():
                other = θ.copy()
                other[row, column] += change * (1.0 if column == POISSON else θ[row, column])
                dλ, dμ = (lame_parameters(other) - moduli)[:, row]
                yield factor.solve(dλ * dilated + dμ * sheared)
        if tilting and gravity is not None:
            yield factor.solve(TILT_CHANGE * np.linalg.norm(gravity.acceleration) * weight_columns(system))
