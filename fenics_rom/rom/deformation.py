"""A reduced body that deforms as far as it likes: the energy of a few of its points, with positive weights.

    Φ(q) = Σ_p ω_p W(E_p(q)) + ½ qᵀ K_s q,   E = ½ (H + Hᵀ + HᵀH),   H = Σ_k q_k ∇W_k

It is a potential like the whole body's, whatever points were kept (ECSW: Farhat, Avery, Chapman & Cortial, 2014), so
what balances energy for the one does for the other.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from functools import cache, cached_property

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StructureError
from fenics_rom.mechanics.fibres import Fibres, check_fibres
from fenics_rom.mechanics.hyperelastic import strain
from fenics_rom.mechanics.isochoric import isochoric_terms
from fenics_rom.mechanics.point_material import PointMaterial
from fenics_rom.mechanics.tendon import cable_length, measure_segments, turning_angles, turning_slopes
from fenics_rom.mechanics.voigt import VOIGT_INDEX, VOIGT_PAIRS
from fenics_rom.rom.content import ByContent

_UNIT = np.eye(3)
NO_POINTS = np.empty(0, dtype=int)
_ROUND_OFF = 8 * np.finfo(float).eps  # of stresses, beside the moduli


@dataclass(frozen=True, eq=False)
class ReducedTendon(ByContent):
    """A cable through points of the body."""

    points: Array  # at rest, (K, 3), m
    shapes: Array  # (3K, m) rows of the basis there

    def force(self, q: Array) -> Array:
        """Of a tension of 1 N, (m,): -∂ℓ/∂q of its length ℓ."""
        at_rest, shapes, pulled, sums = self._segments
        segments = shapes.dot(q)
        segments += at_rest
        segments /= np.sqrt((segments * segments).dot(sums))
        return segments.dot(pulled)

    def slope(self, q: Array) -> Array:
        """∂force/∂q (m, m), symmetric."""
        segments, lengths = measure_segments(self._moved(q))
        directions, moves = segments / lengths, self._segments[1].reshape(*segments.shape, -1)
        across = moves - directions[:, :, None] * np.einsum("ki,kim->km", directions, moves)[:, None]
        stretched = (across / lengths[:, :, None]).reshape(-1, moves.shape[2])
        return -moves.reshape(stretched.shape).T @ stretched

    def stroke(self, q: Array) -> float:
        """By how much it is shorter than at rest, m."""
        return cable_length(self.points) - cable_length(self._moved(q))

    def stroke_slope(self, q: Array) -> Array:
        """∂stroke/∂q (m,)."""
        return self.force(q)

    def angles(self, q: Array) -> Array:
        """By which it turns at each guide (K - 2,), rad."""
        return turning_angles(self._moved(q))

    def angle_slopes(self, q: Array) -> Array:
        """What these change by with q, (K - 2, m)."""
        slopes = turning_slopes(self._moved(q))
        return slopes.reshape(len(slopes), self.shapes.shape[0]) @ self.shapes

    def up_to(self, guide: int) -> "ReducedTendon":
        """From its anchor to a guide, the first of which is 1."""
        return ReducedTendon(self.points[: guide + 1], self.shapes[: 3 * guide + 3])

    @cached_property
    def _segments(self) -> tuple[Array, Array, Array, Array]:
        """Between neighbours: at rest (3 (K - 1),), m, their shapes (3 (K - 1), m), and these the other way.

        And what adds the three numbers of each, in all their places.
        """
        shapes = self.shapes[3:] - self.shapes[:-3]
        sums = np.kron(np.eye(len(self.points) - 1), np.ones((3, 3)))
        return np.diff(self.points, axis=0).ravel(), shapes, -shapes, sums

    def _moved(self, q: Array) -> Array:
        return self.points + (self.shapes @ q).reshape(-1, 3)


@dataclass(frozen=True, eq=False)
class ReducedBar(ByContent):
    """A bar between two points of the body, whose length ℓ stays; see `fem/finite_strain/follower_loads.py`.

    Its stroke s = (ℓ² - |x|²) / 2ℓ is quadratic in q, so that its force in the middle of a step keeps s exactly.
    """

    points: Array  # at rest, (2, 3), m
    shapes: Array  # (6, m) rows of the basis there

    def force(self, q: Array) -> Array:
        """Of a tension of 1 N, (m,): ∂s/∂q."""
        at_rest, slope = self._parts
        return -(at_rest + slope.dot(q))

    def slope(self, q: Array) -> Array:
        """∂force/∂q (m, m), symmetric."""
        return -self._parts[1]

    def stroke(self, q: Array) -> float:
        """s, m."""
        at_rest, slope = self._parts
        return -float(q.dot(at_rest + slope.dot(q) / 2))

    def stroke_slope(self, q: Array) -> Array:
        """∂stroke/∂q (m,)."""
        return self.force(q)

    @cached_property
    def _parts(self) -> tuple[Array, Array]:
        """∂(|x|²/2ℓ)/∂q at rest, (m,), and its slope (m, m)."""
        moves, apart = self.shapes[3:] - self.shapes[:3], self.points[1] - self.points[0]
        length = cable_length(self.points)
        return apart.dot(moves) / length, moves.T.dot(moves) / length


@dataclass(frozen=True, eq=False)
class ReducedRim(ByContent):
    """The edge of a surface under pressure, which says by itself what force and torque the pressure has in all.

    By Stokes' theorem, with y along the edge, its outward side seen counter-clockwise,

        -∫ n dA = -½ ∮ y × dy,        -∫ y × n dA = ½ ∮ |y|² dy

    so that of a closed surface both are 0. Points and pieces are those of an exact quadrature.
    """

    points: Array  # of the edge at rest in world axes, (G, 3), m
    pieces: Array  # dy there, (G, 3), m
    shapes: Array  # (3G, m) rows of the basis at the points
    piece_shapes: Array  # (3G, m) the same of the pieces

    def wrench(self, q: Array, origin: Array) -> Array:
        """Force, N, and torque about an origin (3,), m, of 1 Pa, (6,), in the axes of the frame."""
        y = self.points - origin + (self.shapes @ q).reshape(-1, 3)
        dy = self.pieces + (self.piece_shapes @ q).reshape(-1, 3)
        return np.concatenate([-np.cross(y, dy).sum(axis=0), (y * y).sum(axis=1) @ dy]) / 2

    def wrench_slopes(self, q: Array, origin: Array) -> Array:
        """What these change by with q, (6, m)."""
        y = self.points - origin + (self.shapes @ q).reshape(-1, 3)
        dy = self.pieces + (self.piece_shapes @ q).reshape(-1, 3)
        by_y, by_dy = (shapes.reshape(len(y), 3, -1) for shapes in (self.shapes, self.piece_shapes))
        force = np.cross(by_y, dy[:, :, None], axis=1) + np.cross(y[:, :, None], by_dy, axis=1)
        torque = 2 * np.einsum("gi,gim,gj->gjm", y, by_y, dy) + (y * y).sum(axis=1)[:, None, None] * by_dy
        return np.concatenate([-force.sum(axis=0), torque.sum(axis=0)]) / 2


@dataclass(frozen=True, eq=False)
class TrainingRange(ByContent):
    """How far loads and strains went in the full-order runs that a model was trained and validated with."""

    inputs: Mapping[str, float]  # largest of each actuator and load, in units of the input; of strokes what they took
    pushes: Mapping[str, float]  # largest resultant of the forces on each contact mode, N
    strains: Array  # (P,) largest |E| at each kept point
    smoothing_time: float  # of forces of obstacles, s: what acts for less moves the body by less
    # Of a frame that moves, (3,) along or about each of its axes; None: of a fixed one, or nothing is strained by it.
    accelerations: Array | None = None  # of the base less that of gravity, m/s²
    angular_accelerations: Array | None = None  # rad/s²
    spins: Array | None = None  # rad/s


@dataclass(frozen=True, eq=False)
class ReducedDeformation(ByContent):
    """What a ROM needs beside its linear model where the scene names large_deformation.

    Its basis W is the same for all contact modes, WᵀMW = I. Of pressures it has the force of 1 Pa as a polynomial of q,
    (m, 1 + m + m (m+1)/2): of `monomials(q)`.
    """

    law: str  # of the material, as `hyperelastic` has them
    gradients: Array  # (3, 3, P, m), [i, j] = ∂W_i/∂X_j at the kept points, kg^-1/2/m
    weights: Array  # ω (P,), > 0, m³
    first_lame: Array  # λ (P,), Pa
    shear: Array  # μ (P,), Pa
    viscosity: Array  # β (P,), s: of `PointMaterial.viscous_stress`
    external_damping: Array  # (m, m) damping that does not strain: α M and dashpots, 1/s
    springs: Array  # (m, m) K_s of springs to ground, 1/s²
    training_radius: float  # largest |q| of the states it was trained on, m kg^1/2
    points_of: int  # number of points of the whole body
    cubature_error: float  # of the forces of the kept points on the training states, relative
    validation_error: float | None = None  # of a run that was not trained on, relative, in the mass norm
    pressures: Mapping[str, Array] = field(default_factory=dict)
    tendons: Mapping[str, ReducedTendon] = field(default_factory=dict)
    bars: Mapping[str, ReducedBar] = field(default_factory=dict)  # of surfaces that are rigid
    rims: Mapping[str, ReducedRim] = field(default_factory=dict)  # of pressures on surfaces that are open, and move
    trained: TrainingRange | None = None  # files of earlier formats lack it
    fibres: tuple[Fibres, ...] = ()  # families of the kept points

    @property
    def order(self) -> int:
        """Number m of reduced displacements."""
        return self.gradients.shape[-1]

    @cached_property
    def material(self) -> PointMaterial:
        """Of the kept points."""
        return PointMaterial(self.law, self.first_lame, self.shear, self.fibres)

    def displacement_gradients(self, q: Array) -> Array:
        """H (3, 3, P) at the kept points."""
        return (self._rows @ q).reshape(-1, 3, 3).transpose(2, 1, 0)

    def strains(self, q: Array) -> Array:
        """E (6, P) at the kept points."""
        return strain(self.displacement_gradients(q))

    def energy(self, q: Array, E: Array | None = None) -> float:
        """Φ, J, of a state whose strains E (6, P) may be given."""
        return self.elastic_energy(self.strains(q) if E is None else E) + float(q @ self.springs @ q) / 2

    def elastic_energy(self, E: Array) -> float:
        """Σ ω W(E), J."""
        return float(self.weights @ self.material.energy_density(E))

    def force(self, q: Array) -> Array:
        """∂Φ/∂q (m,)."""
        H = self.displacement_gradients(q)
        S = self.material.stress(strain(H))
        return self.resultant(H, self.weights * S) + self.springs @ q

    def tangent(self, q: Array) -> Array:
        """∂²Φ/∂q² (m, m)."""
        H = self.displacement_gradients(q)
        E = strain(H)
        A = self.strain_rates(H)
        D = self.weights * self.material.moduli(E)
        K = A.reshape(-1, self.order).T @ np.einsum("cdp,dpk->cpk", D, A).reshape(-1, self.order)
        return K + self.geometric(self.weights * self.material.stress(E)) + self.springs

    def resultant(self, H: Array, S: Array) -> Array:
        """Force (m,) of stresses S (6, P), which hold the weights, on the body deformed by H: Σ (F S) : ∇W_k."""
        Fᵀ = H.transpose(2, 1, 0) + _UNIT
        return (S[VOIGT_INDEX].transpose(2, 0, 1) @ Fᵀ).ravel() @ self._rows

    def strain_rates(self, H: Array) -> Array:
        """A = ∂E/∂q (6, P, m) on the body deformed by H."""
        return self.metric_rates(H + _UNIT[:, :, None])

    def metric_rates(self, F: Array) -> Array:
        """½ (Fᵀ∇W_k + ∇W_kᵀF) (6, P, m) of any F (3, 3, P)."""
        P, m = len(self.weights), self.order
        FᵀG = (F.transpose(2, 1, 0) @ self._columns).reshape(P, 3, 3, m)  # F_ij ∂W_i/∂X_l
        A = np.empty((6, P, m))
        for c, (i, j) in enumerate(VOIGT_PAIRS):
            A[c] = FᵀG[:, i, j] if i == j else FᵀG[:, i, j] + FᵀG[:, j, i]
        return A

    def geometric(self, S: Array) -> Array:
        """Σ S_jl ∂W_i/∂X_j ∂W_i/∂X_l (m, m) of stresses S (6, P), which hold the weights."""
        SG = S[VOIGT_INDEX].transpose(2, 0, 1) @ self._rows.reshape(-1, 3, 3 * self.order)
        return self._rows.T @ SG.reshape(-1, self.order)

    def geometric_back(self, N: Array) -> Array:
        """What a matrix N (m, m) times `geometric` owes to the stresses, (6, P)."""
        rows = self._rows.reshape(-1, 3, 3 * self.order)
        both = (self._rows @ N).reshape(rows.shape) @ rows.transpose(0, 2, 1)
        i, j = VOIGT_PAIRS.T
        S: Array = both[:, i, j].T.copy()
        S[3:] += both[:, j[3:], i[3:]].T
        return S

    @cached_property
    def round_off(self) -> Array:
        """Of forces (m,), m/s² kg^1/2, however small the strains: stresses are differences of what strains of 1 do."""
        sizes = np.linalg.norm(self.gradients, axis=(0, 1))
        whole: Array = (self.weights * (self.first_lame + 2 * self.shear)) @ sizes
        return _ROUND_OFF * whole

    @cached_property
    def _rows(self) -> Array:
        """∂W_i/∂X_j as (P j i, m)."""
        return np.ascontiguousarray(self.gradients.transpose(2, 1, 0, 3)).reshape(-1, self.order)

    @cached_property
    def _columns(self) -> Array:
        """∂W_i/∂X_j as (P, i, j m)."""
        return np.ascontiguousarray(self.gradients.transpose(2, 0, 1, 3)).reshape(-1, 3, 3 * self.order)


def resultant(push: Array) -> float:
    """Size of the sum of forces (3 nodes,) on a contact mode, N; of columns that are no such forces, of all."""
    return float(np.linalg.norm(push.reshape(-1, 3).sum(axis=0) if len(push) % 3 == 0 else push))


def monomials(q: Array) -> Array:
    """1, q_i and q_i q_j (i <= j), (1 + m + m (m+1)/2,)."""
    m, (i, j) = len(q), _upper_triangle(len(q))
    η = np.empty(1 + m + len(i))
    η[0], η[1 : m + 1] = 1.0, q
    np.multiply(q.take(i), q.take(j), η[m + 1 :])
    return η


def monomial_slopes(q: Array) -> Array:
    """∂monomials/∂q (1 + m + m (m+1)/2, m)."""
    m, (i, j) = len(q), _upper_triangle(len(q))
    slopes, products = np.zeros((1 + m + len(i), m)), m + 1 + np.arange(len(i))
    slopes[1 : m + 1] = np.eye(m)
    slopes[products, i] = q[j]
    slopes[products, j] += q[i]
    return slopes


@cache
def _upper_triangle(size: int) -> tuple[Array, Array]:
    """Its rows and columns, found once: every iterate of a step under pressure asks for them."""
    return np.triu_indices(size)


def check_deformation(
    body: ReducedDeformation, order: int, actuators: Mapping[str, int], bars: Collection[str]
) -> None:
    """Measures what its energy balance rests on, of a body with bars of these names.

    Raises:
        StructureError: with the measured number.
    """
    try:
        isochoric_terms(body.law)
        check_fibres(body.fibres, len(body.weights))
    except ValueError as error:
        raise StructureError(f"deformation: material {error}") from error
    if body.order != order:
        raise StructureError(f"deformation: has {body.order} displacements, its contact modes {order}")
    bulk = 3 * body.first_lame + 2 * body.shear  # three times the bulk modulus
    bulk = np.delete(bulk, np.concatenate([NO_POINTS, *(family.points for family in body.fibres)]))
    for what, values, strict in (
        ("weights", body.weights, True),
        ("shear moduli", body.shear, False),
        ("bulk moduli", bulk, True),
        ("viscosities", body.viscosity, False),
    ):
        least = values.min(initial=np.inf)
        if not (least > 0 if strict else least >= 0):
            raise StructureError(f"deformation: {what} are not {'positive' if strict else 'non-negative'}: {least:g}")
    for what, matrix in (("external_damping", body.external_damping), ("springs", body.springs)):
        largest = np.abs(matrix).max(initial=0.0)
        if not np.array_equal(matrix, matrix.T):
            raise StructureError(f"deformation: {what} is not symmetric")
        least = np.linalg.eigvalsh(matrix / (largest or 1.0)).min()
        if not least >= -1e-12:
            raise StructureError(f"deformation: {what} is not positive semi-definite, least {least * largest:g}")
    seen = body.trained
    if seen is not None:
        numbers = [*seen.inputs.values(), *seen.pushes.values(), *seen.strains, seen.smoothing_time]
        for of_frame in (seen.accelerations, seen.angular_accelerations, seen.spins):
            numbers += [] if of_frame is None else of_frame.tolist()
        if min(numbers) < 0 or len(seen.strains) != len(body.weights):
            raise StructureError("deformation: what it was trained with is negative, or not of all points")
    if not (body.training_radius > 0 and body.points_of >= len(body.weights) > 0):
        raise StructureError("deformation: has no points, or no states that it was trained on")
    m = body.order
    for name, force in body.pressures.items():
        if actuators.get(name) != 1 or force.shape != (m, 1 + m + m * (m + 1) // 2):
            raise StructureError(f"deformation: pressure {name!r} is no actuator, or has not {m} displacements")
    for name, tendon in body.tendons.items():
        if actuators.get(name) != 1 or tendon.shapes.shape != (tendon.points.size, m):
            raise StructureError(f"deformation: tendon {name!r} is no actuator, or has not {m} displacements")
    if set(body.bars) != set(bars) or any(bar.shapes.shape != (6, m) for bar in body.bars.values()):
        raise StructureError(f"deformation: its bars are not those of its environment, or have not {m} displacements")
    for name, rim in body.rims.items():
        if name not in body.pressures or not rim.shapes.shape == rim.piece_shapes.shape == (rim.points.size, m):
            raise StructureError(f"deformation: the rim of {name!r} is of no pressure, or has not {m} displacements")
