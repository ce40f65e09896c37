"""The error model of a ROM (rom.error_model), by solves with D and K; no Gram matrices, which lose half the digits."""

from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import SceneError, SolverError
from fenics_rom.reduction.common_basis import orthonormalize_against, split_like
from fenics_rom.reduction.problem import ReductionProblem
from fenics_rom.reduction.residual_compliance import PointRows
from fenics_rom.rom.error_model import ErrorModel, untold_errors
from fenics_rom.rom.rom import Rom
from fenics_rom.system.columns import column_dots, probe_columns
from fenics_rom.system.protocols import EXACT, Algebra, Factor
from fenics_rom.system.system import System

FURTHER = 20  # eigenvectors of the finer model beside the shared basis
NEW = 1e-2  # of the length of an eigenvector in mass, which the shared basis may lack before it is worth a direction
NEW_STILL = 0.5  # of a unit vector that is orthogonalised again: less is left of round-off
UNRESISTED = 1e-7  # of the damping of other motions: rigid ones are not damped then
COLUMNS_AT_ONCE = 32  # that are orthogonalised against others by one product
UNSOLVED = 1e-6  # largest accepted |D D⁻¹f - f| / |f|
UNDAMPED = "errors: no damping, no bound: {}; use a body whose damping resists all that strains it"


def check_errors_known(system: System) -> None:
    """A SceneError where a body's errors cannot be known."""
    moving, scene = system.moving_frame is not None, system.scene
    reason = "a moving frame" if moving else ""
    if not reason and scene is not None:
        reason = untold_errors(scene.environment, deforms=system.deformation is not None)
    if reason:
        raise SceneError(
            f"errors: a run with {reason} does not know its error; use a body of small strains with inertia in "
            "a fixed frame, on which inputs, loads and obstacles act"
        )


def is_touched(system: System) -> bool:
    """Whether obstacles may touch the body in its scene, so that its runs have estimates alone."""
    return system.scene is not None and system.scene.environment.contact_law is not None


def with_error_model(
    problem: ReductionProblem, rom: Rom, whole: System, finer: tuple[Array, Array] | None = None
) -> Rom:
    """The ROM with what its runs need to know their errors; `rom` and `whole` are of all motions, rigid ones too.

    `finer`: basis and eigenvalues of the finer model, as of `finer_basis`; None: those.

    Raises:
        SceneError: damping does not resist all that strains a body that no obstacle touches.
    """
    elastic, rigid, inner = problem.system, rom.rigid, whole.algebra.inner
    with problem.stages("error model"):
        E, γ = finer or finer_basis(problem, rom, whole, rom.basis[whole.algebra.rows()])
        ME, KE = whole.mass @ E, whole.stiffness @ E
        KE[:, :rigid] = 0.0
        B = {name: whole.input_matrix(name) for name in rom.contact_models}
        G = {name: inner(E, columns) for name, columns in B.items()}
        columns = [*(B[name] - ME @ G[name] for name in B), KE - γ * ME]
        if whole.rayleigh is not None:
            α, β = whole.rayleigh
            damping = α + β * γ
        else:
            DE = whole.damping @ E
            damping = inner(E, DE)
            damping = (damping + damping.T) / 2
            columns.append(DE - ME @ damping)
        residuals = np.hstack(columns)
        residuals -= ME @ inner(E, residuals)  # once more, for what round-off left
        is_bounded = True
        try:
            with _damping_factor(problem, whole, rom.stiffness[rigid]) as factor:
                triangle = _triangle(elastic.algebra, factor, residuals)
        except SceneError:
            if not is_touched(whole):
                raise
            triangle, is_bounded = np.empty((0, residuals.shape[1])), False  # estimates need no damping
        *of_inputs, stiffness = split_like(triangle, columns)[: len(B) + 1]
        resisted = β * stiffness if whole.rayleigh is not None else split_like(triangle, columns)[-1]
        compliances = {
            name: column_dots(elastic.algebra, C, problem.factor.solve(C)) for name, C in elastic.outputs.items()
        }
        model = ErrorModel(
            eigenvalues=γ,
            damping=damping,
            inputs=G,
            coordinates=inner(ME, rom.basis[whole.algebra.rows()]),
            outputs={name: inner(C, E) for name, C in whole.outputs.items()},
            residual_inputs=dict(zip(B, of_inputs, strict=True)) if is_bounded else {},
            residual_damping=resisted,
            residual_stiffness=stiffness,
            output_compliances={name: np.sqrt(of) for name, of in compliances.items()},
            point_inputs=PointRows(whole).at(E).T if whole.contact_points else None,
        )
    return replace(rom, error_model=model, stages=problem.stages.done)


def finer_basis(problem: ReductionProblem, rom: Rom, whole: System, Q: Array) -> tuple[Array, Array]:
    """E (rows here, f), EᵀME = I, EᵀKE = diag(γ), and γ (f,): Q, shapes at rest under inputs, further eigenvectors."""
    system, rigid = problem.system, rom.rigid
    inner, M = whole.algebra.inner, whole.mass
    pushed = np.hstack([*system.contacts.values(), *system.actuators.values(), *system.loads.values()])
    count = min(system.elastic_size, max(mode.order - rigid for mode in rom.contact_models.values()) + FURTHER)
    _, V = system.algebra.eigenpairs(system.mass, system.stiffness, count, problem.factor)
    MQ = M @ Q
    beyond = V - Q @ inner(MQ, V)
    new = np.sqrt(column_dots(whole.algebra, beyond, M @ beyond)) > NEW
    candidates = np.hstack([problem.factor.solve(pushed), V[:, new][:, :FURTHER]])
    U, _ = orthonormalize_against(whole, candidates, Q)
    return ritz_vectors(whole, Q[:, :rigid], np.hstack([Q[:, rigid:], U]))


def ritz_vectors(whole: System, rigid: Array, strained: Array) -> tuple[Array, Array]:
    """E (rows here, f), which begins with rigid motions, and γ (f,), of M-orthonormal columns."""
    K = whole.algebra.inner(strained, whole.stiffness @ strained)
    γ, rotation = np.linalg.eigh((K + K.T) / 2)
    return np.hstack([rigid, strained @ rotation]), np.concatenate([np.zeros(rigid.shape[1]), γ])


@contextmanager
def _damping_factor(problem: ReductionProblem, whole: System, first: float) -> Iterator[Factor]:
    """Solves with D, of loads that leave rigid motions alone where D does not resist these; `first` is the lowest γ."""
    if whole.rayleigh is not None:
        α, β = whole.rayleigh
        if max(α, β) <= 0:
            raise SceneError(UNDAMPED.format("the body has none"))
        if α <= UNRESISTED * β * first:  # then D is β K, or hardly more
            yield _Scaled(problem.factor, 1 / β)
            return
        terms = [(c, A) for c, A in ((α, whole.mass), (β, whole.stiffness)) if c]
        with closing(whole.algebra.factor(*terms)) as factor:
            yield factor
        return
    R, D, z = whole.rigid, whole.damping, probe_columns(whole.algebra, 1)
    free = False
    if R.shape[1]:
        DR, _, Dz, _ = lengths = [np.sqrt(column_dots(whole.algebra, A, A).max()) for A in (D @ R, R, D @ z, z)]
        free = DR / lengths[1] <= UNRESISTED * Dz / lengths[3]
    algebra = problem.system.algebra if free else whole.algebra
    try:
        factor = algebra.factor((1.0, D))
    except SolverError as error:
        raise SceneError(UNDAMPED.format(f"its damping matrix is singular ({error})")) from error
    with closing(factor):
        if free:
            z = problem.system.algebra.balanced(z)  # type: ignore[attr-defined]
        lacking = D @ factor.solve(z) - z
        off = np.sqrt(column_dots(algebra, lacking, lacking) / column_dots(algebra, z, z))[0]
        if not off <= UNSOLVED:
            raise SceneError(UNDAMPED.format(f"its damping matrix is singular (solved to {off:.1e})"))
        yield factor


class _Scaled:
    """Solves with a multiple of a matrix that is factored."""

    notice = ""

    def __init__(self, factor: Factor, scale: float):
        self._factor, self._scale = factor, scale

    def solve(self, block: Array, accuracy: float = EXACT) -> Array:
        """As of Factor."""
        return self._scale * self._factor.solve(block, accuracy)

    def close(self) -> None:
        """Leaves the factor to whoever made it."""


def _triangle(algebra: Algebra, factor: Factor, columns: Array) -> Array:
    """R (s, c) with |columns c|² = |R c|² in the norm of D⁻¹, by Gram-Schmidt twice over; dependent columns add no row.

    Beside each Y there is Z = D⁻¹Y. What is left of a column is new if it stays so when it is made a unit vector and
    orthogonalised once more; else it is what round-off left of one that depends on the others.
    """
    n, count = columns.shape
    Y, Z, s = np.empty((n, count), order="F"), np.empty((n, count), order="F"), 0
    R = np.zeros((count, count))

    def orthogonalized(block: Array) -> tuple[Array, Array]:
        parts = algebra.inner(Z[:, :s], block)
        return block - Y[:, :s] @ parts, parts

    def length(y: Array, z: Array) -> float:
        return float(np.sqrt(np.maximum(algebra.inner(y, z), 0.0))[0, 0])

    for first in range(0, count, COLUMNS_AT_ONCE):
        block = columns[:, first : first + COLUMNS_AT_ONCE]
        before, own = s, slice(first, first + block.shape[1])
        for _ in range(2):
            block, parts = orthogonalized(block)
            R[:before, own] += parts
        for k in range(block.shape[1]):
            y, column = block[:, [k]], first + k
            for _ in range(2):
                y, parts = orthogonalized(y)
                R[:s, column] += parts[:, 0]
            size = length(y, factor.solve(y))
            if size == 0:
                continue
            y, parts = orthogonalized(y / size)
            z = factor.solve(y)
            new = length(y, z)
            if new < NEW_STILL:
                continue
            R[:s, column] += size * parts[:, 0]
            R[s, column] = size * new
            Y[:, [s]], Z[:, [s]], s = y / new, z / new, s + 1
    return R[:s]
