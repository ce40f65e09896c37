"""Residual compliance of a ROM's contact points, from the factor of K that is there; see rom.residual_compliance.

There may be thousands of columns K⁻¹Sᵀ of contact points: never more than some are there at once, and of all of them
their rows at the points and what these sum to are kept.
"""

from collections.abc import Iterator, Mapping
from contextlib import closing
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import scipy.linalg
import scipy.sparse as sp
from numpy import ndarray as Array
from scipy.sparse.linalg import eigsh

from fenics_rom.mechanics.points_operator import columns_of
from fenics_rom.mechanics.readings import OfDisplacement
from fenics_rom.reduction.block_compression import compressed
from fenics_rom.reduction.common_basis import significant_eigenpairs
from fenics_rom.reduction.problem import ReductionProblem
from fenics_rom.reduction.projection import RetainedBasis, joint_span
from fenics_rom.rom.midpoint_map import compliance
from fenics_rom.rom.residual_compliance import ResidualCompliance
from fenics_rom.rom.residual_part import inverse_of_lower, residual_part, strained_points
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.steppers.residual_motion import relaxation
from fenics_rom.system.columns import column_dots
from fenics_rom.system.system import System

COLUMNS_AT_ONCE = 96  # of solves
KEPT = 1e-6  # of the largest eigenvalue of the residual compliance: smaller ones are raised to it
LEAST = 1e-12  # of the static compliance: a residual compliance that small is as good as none, and raised to it
UNSEEN = 1e-4  # of the displacements under forces on contact points, in mass: what the shared basis may lack
MOST_ROWS = 900  # 3P, of points whose shapes are made M-orthogonal, and kept: both are too much with thousands
LEFT_OUT = 1e-5  # singular values of blocks, of the mean residual compliance of a point along an axis
MOST_SHAPES = 300  # that the shared basis holds for it: a body whose whole skin may touch would want all its unknowns
OVERSAMPLING = 20  # random combinations beside so many, from which the shapes with most mass are found
UNTOLD = 1e-3  # of the same of nodes that nothing can touch, beyond which the user is told
POINTS_COMPARED = 8  # of which the Delassus operator is compared with the full model's


def has_residual_compliance(problem: ReductionProblem) -> bool:
    """Whether contact points keep what the basis lacks."""
    return problem.switching != "oblique" and may_keep_compliance(problem.system)


def may_keep_compliance(system: System) -> bool:
    """Whether contact points of a system are to: those of a scene with contact, unless it says otherwise."""
    scene = system.scene
    if scene is None or not system.contact_points:
        return False
    return scene.environment.contact_law is not None and scene.environment.residual_compliance


class PointRows:
    """S, sparse: what contact points are of displacements, and Sᵀ of forces on them, N."""

    def __init__(self, system: System):
        points = system.points_of_contact()
        point, node, weight = points.weights()
        of_nodes = sp.csr_matrix((weight, (point, node)), shape=(len(points.coordinates), len(system.body.nodes)))
        moving = system.body.unknowns.matrix[:, system.algebra.rows()]
        self._rows = (sp.kron(of_nodes, sp.identity(3)) @ moving).tocsr()
        self._total = system.algebra.total
        self.count = self._rows.shape[0]  # 3P
        self.untouched = np.asarray(abs(self._rows).sum(axis=0)).ravel() == 0  # (rows here,)

    def at(self, shapes: Array) -> Array:
        """S x of displacements (rows here, c), (3P, c)."""
        moved: Array = self._total(self._rows @ shapes)
        return moved

    def forces(self, combined: Array) -> Array:
        """Sᵀ f of forces (3P, c), (rows here, c)."""
        spread: Array = self._rows.T @ combined
        return np.ascontiguousarray(spread)

    def columns(self, some: slice | Array) -> Array:
        """Some columns of Sᵀ, (rows here, c)."""
        return np.ascontiguousarray(self._rows[some].toarray().T)


class _Beyond(NamedTuple):
    """Shapes X = (K⁻¹ - W diag(1/γ) Wᵀ) Sᵀ, in which contact points yield beyond a basis W."""

    problem: ReductionProblem
    rows: PointRows
    W: Array  # (rows here, k)
    C: Array  # diag(1/γ) WᵀSᵀ (k, 3P)

    def shapes(self, forces: Array) -> tuple[Array, Array]:
        """K⁻¹Sᵀ f and X f of forces (3P, c), (rows here, c) each."""
        static = self.problem.factor.solve(self.rows.forces(forces))
        return static, static - self.W @ (self.C @ forces)

    def pulled(self, loads: Array) -> Array:
        """Xᵀ of loads (rows here, c), (3P, c)."""
        within = self.C.T @ self.problem.system.algebra.inner(self.W, loads)
        return self.rows.at(self.problem.factor.solve(loads)) - within

    def mass_of(self, shapes: Array) -> float:
        """Sum of xᵀMx over columns."""
        return float(column_dots(self.problem.system.algebra, shapes, self.problem.system.mass @ shapes).sum())


def contact_shapes(problem: ReductionProblem, retained: Mapping[str, RetainedBasis]) -> Array:
    """Coordinates (k, s) of the shapes with most mass in which contact points yield beyond what contact modes keep.

    The shared basis is to hold them, so that a run can tell how the body yields around its contact points: all but
    UNSEEN, or MOST_SHAPES of them. Of more points than that they are found by random combinations, drawn closer by the
    operator once (Halko, Martinsson & Tropp 2011), and what outputs and readings tell is made exact at rest, by the
    shapes under forces there (K is symmetric: what loads C move at S is what loads S move at C).
    """
    if not has_residual_compliance(problem):
        return np.empty((problem.space.size, 0))
    system, space = problem.system, problem.space
    inner, M = system.algebra.inner, system.mass
    with problem.stages("residual compliance"):
        kept, rows = space.subspace(joint_span(problem, retained)), PointRows(system)
        W = space.basis @ kept.coordinates
        beyond = _Beyond(problem, rows, W, rows.at(W).T / kept.eigenvalues[:, None])
        samples, forces = 1, np.eye(rows.count)
        if rows.count > MOST_SHAPES + OVERSAMPLING:
            samples = MOST_SHAPES + OVERSAMPLING
            forces = np.random.default_rng(0).standard_normal((rows.count, samples))
        static, shapes = beyond.shapes(forces)
        whole, lacking = beyond.mass_of(static) / samples, beyond.mass_of(shapes) / samples
        if samples > 1:
            _, shapes = beyond.shapes(np.linalg.qr(beyond.pulled(M @ shapes))[0])
        w, E = significant_eigenpairs(inner(shapes, M @ shapes))
        missing = np.sqrt(np.maximum(lacking - np.cumsum(np.append(0.0, w)), 0.0) / whole)  # where so many are taken
        suffice = missing <= UNSEEN
        count = min(int(suffice.argmax()) if suffice.any() else len(w), MOST_SHAPES)
        shapes = shapes @ E[:, :count]
        if samples > 1:
            shapes = np.hstack([shapes, problem.factor.solve(_told(system))])
        return space.add(shapes)


def _told(system: System) -> Array:
    """Columns (rows here, c) of outputs and readings that are linear; none where there are too many."""
    operators = [reading.operator for reading in system.readings.values() if isinstance(reading, OfDisplacement)]
    rows = system.algebra.rows()
    columns = [*system.outputs.values(), *(np.asarray(sp.csr_matrix(A)[:, rows].toarray()).T for A in operators)]
    told = np.hstack([np.empty((system.local_size, 0)), *columns])
    return told if told.shape[1] <= MOST_SHAPES else told[:, :0]


def with_residual_compliance(problem: ReductionProblem, rom: Rom) -> Rom:
    """The ROM (of the elastic part) with the residual compliance of its contact points, where its scene wants it."""
    if not has_residual_compliance(problem):
        return rom
    system = problem.system
    with problem.stages("residual compliance"):
        rows, κ = PointRows(system), rom.stiffness
        Q = rom.basis[system.algebra.rows()]
        SQ = rows.at(Q)
        static, mass, heat, untold = _summed(_Beyond(problem, rows, Q, (SQ / κ).T))
        compared, largest = static[:, _columns_compared(rows.count)].copy(), float(np.diag(static).max())
        blocks, left_out = None, 0.0
        if rows.count > MOST_ROWS:
            yields = float(np.mean(np.diag(static) - np.einsum("ij,ij->i", SQ / κ, SQ)))
            least = max(LEFT_OUT * yields, LEAST * largest)
            blocks, left_out = compressed(static, system.points_of_contact().coordinates, least)
        lacking = static  # in place, as there may be no room for more
        lacking -= (SQ / κ) @ SQ.T
        _make_symmetric(lacking)
        floor = max(KEPT * _largest_eigenvalue(lacking), LEAST * largest)
        if system.rayleigh is not None:
            β = system.rayleigh[1]
        else:  # D is not β K in the residual shapes: what dissipates as much in all of them together
            β = heat / (float(np.trace(lacking)) + floor * len(lacking))
        factor, τ = _orthogonal_shapes(lacking, mass, floor, None if blocks is None else blocks.values.size)
        del static, lacking, mass
        if factor is not None:
            blocks, left_out = None, 0.0
        residual = ResidualCompliance(factor, τ, floor + left_out, damping=max(float(β), 0.0), static=blocks)
        residual = _compared(problem, rom, residual, rows, SQ, compared)
    if untold > UNTOLD:
        problem.messages.append(
            f"contact: of the shapes in which {rows.count // 3} contact points yield the shared basis holds the "
            f"{MOST_SHAPES} largest: where nothing can touch the body, nodes close to a force are shown to "
            f"{untold:.1g} of how far forces on single points move the body; forces, contact points and outputs "
            "are not concerned"
        )
    return replace(rom, residual_compliance=residual, warnings=tuple(problem.messages))


class _Sums(NamedTuple):
    """What is kept of all shapes X beyond a basis."""

    static: Array  # S K⁻¹Sᵀ (3P, 3P), m/N
    mass: Array  # XᵀMX (3P, 3P), kg m²/N²
    heat: float  # trace of XᵀDX
    untold: float  # of nodes that nothing can touch, as a share of all displacements, in mass


def _summed(beyond: _Beyond) -> _Sums:
    """Block by block, with a second solve for the mass: XᵀMX is what loads M X move at the points."""
    problem, rows, Q, C = beyond
    system, count = problem.system, rows.count
    static, mass, heat, hidden, whole = np.empty((count, count)), np.empty((count, count)), 0.0, 0.0, 0.0
    for columns in _blocks(count):
        solved = problem.factor.solve(rows.columns(columns))
        X = solved - Q @ C[:, columns]
        MX = system.mass @ X
        static[:, columns], mass[:, columns] = rows.at(solved), beyond.pulled(MX)
        if system.rayleigh is None:
            heat += float(column_dots(system.algebra, X, system.damping @ X).sum())
        hidden += float(column_dots(system.algebra, X[rows.untouched], MX[rows.untouched]).sum())
        whole += beyond.mass_of(solved)
    _make_symmetric(mass)
    return _Sums(static, mass, heat, float(np.sqrt(max(hidden, 0.0) / whole)))


def _blocks(count: int) -> Iterator[slice]:
    """Some columns at once."""
    return (slice(first, min(first + COLUMNS_AT_ONCE, count)) for first in range(0, count, COLUMNS_AT_ONCE))


def _make_symmetric(A: Array) -> None:
    """Has A be (A + Aᵀ)/2, block by block, as there may be no room for another one."""
    for rows in _blocks(len(A)):
        rest = slice(rows.start, None)
        mean = (A[rows, rest] + A[rest, rows].T) / 2
        A[rows, rest], A[rest, rows] = mean, mean.T


def _largest_eigenvalue(A: Array) -> float:
    if len(A) <= COLUMNS_AT_ONCE:
        return float(np.linalg.eigvalsh(A)[-1])
    return float(eigsh(A, k=1, which="LA", v0=np.ones(len(A)), return_eigenvectors=False)[0])


def _orthogonal_shapes(R: Array, mass: Array, floor: float, most: int | None) -> tuple[Array | None, Array]:
    """L (3P, r) with R = L Lᵀ but for a rest below a floor, of K-orthogonal shapes, and τ (r,) of these.

    By Cholesky's algorithm with pivoting, whose pivots are forces that suffice for all shapes. These are M-orthogonal,
    too, but of more than MOST_ROWS: what is asked of τ² is their mean, which that does not change. R is overwritten.
    L is None where it would have more numbers than `most`.
    """
    factor, pivots, rank, _ = scipy.linalg.lapack.dpstrf(R.T, lower=True, tol=floor, overwrite_a=True)
    if not rank:
        return np.empty((len(R), 0)), np.empty(0)
    np.copyto(factor, 0.0, where=~np.tri(len(R), dtype=bool))
    some, square = pivots[:rank] - 1, factor[:rank, :rank]
    half = scipy.linalg.solve_triangular(square, mass[some[:, None], some], lower=True)
    L = None
    if most is None or len(R) * rank <= most:
        L = np.empty((len(R), rank))
        L[pivots - 1] = factor[:, :rank]
    if L is None or len(R) > MOST_ROWS:
        τ2 = np.einsum("ij,ij->i", half, inverse_of_lower(square))
        return L, np.sqrt(np.maximum(τ2, 0.0))
    τ2, V = np.linalg.eigh(scipy.linalg.solve_triangular(square, half.T, lower=True))
    return (L @ V)[:, ::-1], np.sqrt(np.maximum(τ2, 0.0))[::-1]


def _columns_compared(count: int) -> Array:
    """Rows of S, of 3P, whose columns of the Delassus operator are compared."""
    points = np.unique(np.linspace(0, count // 3 - 1, POINTS_COMPARED).astype(int))
    columns: Array = (3 * points[:, None] + np.arange(3)).ravel()
    return columns


def _compared(
    problem: ReductionProblem, rom: Rom, residual: ResidualCompliance, rows: PointRows, SQ: Array, static: Array
) -> ResidualCompliance:
    """The same with the errors of the Delassus operators W = S A⁻¹ Sᵀ at the time step of the scene's run.

    static: the columns S K⁻¹Sᵀ that are compared, (3P, c).
    """
    run, system = rom.environment.run, problem.system
    if run is None:
        return residual
    h, has_inertia, series = run.dt, rom.environment.has_inertia, rom.environment.viscoelasticity
    branches = 0.0 if series is None else series.stiffening_time(h)
    columns = _columns_compared(rows.count)
    if has_inertia:
        elastic: tuple[complex, Any] = h / 2 + branches, system.stiffness
        terms: list[tuple[complex, Any]] = [(2 / h, system.mass), (1.0, system.damping), elastic]
        with closing(system.algebra.factor(*terms)) as factor:
            full = rows.at(factor.solve(rows.columns(columns)))
    else:
        full = static / h
    errors, H = {}, strained_points(rom.stiffness, SQ)
    for name, model in rom.contact_models.items():
        S = SQ @ model.coordinates
        A = compliance(model, h, branches)[0] if has_inertia else 1 / (h * model.eigenvalues)
        reduced = S @ (A @ S[columns].T if A.ndim == 2 else A[:, None] * S[columns].T)
        part = residual_part(rom.stiffness, model, H, residual)
        a = relaxation(h, part.time_constant, residual.damping, branches).whole if has_inertia else h
        both = reduced + columns_of(part.operator, columns[::3] // 3) / a
        without, beside = (np.linalg.norm(W - full) / np.linalg.norm(full) for W in (reduced, both))
        errors[name] = float(without), float(beside)
    return replace(residual, dt=h, errors=errors)
