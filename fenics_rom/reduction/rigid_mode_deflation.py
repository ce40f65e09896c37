"""A body that is not wholly held as its elastic rest, so that no method needs to know of rigid motions.

With R (K R = 0, RᵀMR = I) and P = I - R RᵀM, displacements x = R s + P x and velocities split M-orthogonally. The
elastic rest has the same M, D and K, loads PᵀB and outputs PᵀC, and solves whose solutions have no part in R. What is
reduced of it gets R back, exactly, in every contact mode.
"""

from contextlib import closing
from dataclasses import fields, replace
from typing import Any

import numpy as np
import scipy.linalg

from fenics_rom.errors import SceneError
from fenics_rom.rom.rom import ContactModel, Rom
from fenics_rom.system.protocols import NO_DOFS, Array, Factor
from fenics_rom.system.rigid_modes import choose_fixed_dofs, free_rows
from fenics_rom.system.system import System

NO_LOAD = 1e-12  # share of a column that may strain the body and is round-off
DENSE_SHARE = 3  # beyond a third of all eigenpairs, LAPACK is the better eigensolver


def elastic_part(system: System) -> System:
    """What strains of a body: the system itself where that is all."""
    if not system.rigid.shape[1]:
        return system
    algebra = ElasticAlgebra(system)
    kept = {field.name: getattr(system, field.name) for field in fields(system)}
    balanced = {
        kind: {name: algebra.balanced(B) for name, B in kept[kind].items()}
        for kind in ("contacts", "actuators", "loads", "outputs")
    }
    return _Elastic(**{**kept, **balanced, "algebra": algebra})


class _Elastic(System):
    """An elastic part, whose loads are in balance wherever they come from."""

    def at_nodes(self, nodes: Array) -> Array:
        """As in System."""
        columns: Array = self.algebra.balanced(super().at_nodes(nodes))  # type: ignore[attr-defined]
        return columns


def require_loads(system: System) -> None:
    """Refuses contact modes of an elastic part whose inputs strain nothing.

    Raises:
        SceneError: the first of them.
    """
    for name in system.contacts:
        if not np.any(system.algebra.inner(B := system.forces(name), B)):
            raise SceneError(
                f"contact mode {name!r}: its inputs move the body without straining it, so there is nothing that they "
                "ask to be kept; give them to an actuator, beside a contact that strains it"
            )


def with_rigid(rom: Rom, system: System) -> Rom:
    """The ROM of the whole body: R before the basis of its elastic rest, in every contact mode.

    Args:
        rom: of the elastic part.
        system: the whole, which every rank has its rows of.
    """
    R, algebra = system.rigid, system.algebra
    rigid = R.shape[1]
    if not rigid:
        return rom
    dragged = None
    if system.rayleigh is None:  # dampers may couple rigid and elastic motions
        DR = system.damping @ R
        dragged = np.hstack([algebra.inner(R, DR), algebra.inner(DR, rom.basis[algebra.rows()])])
    moves = algebra.gather(np.ascontiguousarray(R))
    modes = {}
    for name, mode in rom.contact_models.items():
        modes[name] = replace(
            mode,
            eigenvalues=np.concatenate([np.zeros(rigid), mode.eigenvalues]),
            damping=_damping(mode, rigid, system.rayleigh, dragged),
            inputs=np.vstack([algebra.inner(R, system.input_matrix(name)), mode.inputs]),
            coordinates=scipy.linalg.block_diag(np.eye(rigid), mode.coordinates),
            directions=scipy.linalg.block_diag(np.eye(rigid), mode.directions),
        )
    return replace(
        rom,
        contact_models=modes,
        basis=np.hstack([moves, rom.basis]),
        stiffness=np.concatenate([np.zeros(rigid), rom.stiffness]),
        outputs={name: np.hstack([algebra.inner(system.outputs[name], R), C]) for name, C in rom.outputs.items()},
    )


def _damping(mode: ContactModel, rigid: int, rayleigh: tuple[float, float] | None, dragged: Array | None) -> Array:
    """[R, W]ᵀ D [R, W], from that of W and [RᵀDR, RᵀDQ]."""
    if dragged is None:
        assert rayleigh is not None
        return np.concatenate([np.full(rigid, rayleigh[0]), mode.damping])
    rows = np.hstack([dragged[:, :rigid], dragged[:, rigid:] @ mode.coordinates])
    D = np.block([[rows], [rows[:, rigid:].T, mode.damping]])
    return (D + D.T) / 2


class ElasticAlgebra:
    """Sums as in the whole body; solves and eigenpairs in what is M-orthogonal to its rigid motions.

    Args:
        system: the whole body.
    """

    def __init__(self, system: System):
        whole = self.whole = system.algebra
        self._mass, self._size = system.mass, system.size
        self.rigid = system.rigid
        self.mass_times_basis = system.mass @ system.rigid
        self.rows, self.row_offset, self.inner, self.gather = whole.rows, whole.row_offset, whole.inner, whole.gather
        self.broadcast, self.maximum, self.total = whole.broadcast, whole.maximum, whole.total

    def balanced(self, loads: Array) -> Array:
        """Pᵀ f of loads (rows here, any); those that strain nothing but by round-off are zero then."""
        before, rest = self._norms(loads), loads
        for _ in range(2):
            rest = rest - self.mass_times_basis @ self.inner(self.rigid, rest)
        return rest * (self._norms(rest) > NO_LOAD * before)

    def strained(self, shapes: Array) -> Array:
        """P x of displacements (rows here, any)."""
        return shapes - self.rigid @ self.inner(self.mass_times_basis, shapes)

    def factor(self, *terms: tuple[complex, Any], solver: str = "auto", fixed_dofs: Array = NO_DOFS) -> "ElasticFactor":
        """Factor of a sum of coefficient times operator, on the elastic rest.

        K alone is held at as many degrees of freedom as there are rigid motions: loads in balance do not feel them.
        A sum with M is regular as it is.

        Raises:
            SolverError: as that of the whole body.
        """
        regular = any(c != 0 and operator is self._mass for c, operator in terms)
        held = NO_DOFS if regular else choose_fixed_dofs(self.rigid, self.whole)
        return ElasticFactor(self, self.whole.factor(*terms, solver=solver, fixed_dofs=held), held)

    def eigenpairs(self, mass: Any, stiffness: Any, count: int, factor: Any = None) -> tuple[Array, Array]:
        """The lowest γ > 0, ascending, and their M-orthonormal eigenvectors.

        Raises:
            SolverError: not enough of them converged.
        """
        if DENSE_SHARE * count > self._size:
            γ, V = self._all_eigenpairs(mass, stiffness)
            return γ[:count], V[:, :count]
        if factor is None:
            with closing(self.factor((1.0, stiffness))) as own:
                return self.eigenpairs(mass, stiffness, count, own)
        γ, V = self.whole.eigenpairs(mass, stiffness, count, factor)  # in which the rigid ones are at infinity
        return γ, self.strained(V)

    def _all_eigenpairs(self, mass: Any, stiffness: Any) -> tuple[Array, Array]:
        """In the basis that M = L Lᵀ makes orthonormal, of what is orthogonal to LᵀR."""
        identity = np.eye(self._size)[self.rows()]
        M, K, R = (self.gather(np.ascontiguousarray(A)) for A in (mass @ identity, stiffness @ identity, self.rigid))

        def solve() -> tuple[Array, Array]:
            L = np.linalg.cholesky(M)
            elastic = scipy.linalg.null_space(R.T @ L)
            shapes = scipy.linalg.solve_triangular(L, elastic, lower=True, trans="T")
            γ, U = np.linalg.eigh(shapes.T @ K @ shapes)
            return γ, shapes @ U

        γ, V = self.broadcast(solve)
        return γ, self.strained(V[self.rows()])

    def _norms(self, block: Array) -> Array:
        return np.sqrt(np.diag(self.inner(block, block)))


class ElasticFactor:
    """Solutions without rigid motions, whatever part of the load would move the body as a whole.

    With one row and column for each rigid motion, A x + M R λ = f and RᵀM x = 0: x = P A⁻¹ Pᵀ f where A leaves the
    elastic rest to itself, as K, M and proportional damping do, and the projected D for any other.

    Args:
        algebra: of the elastic rest.
        factor: of A; or of K, held.
        held: degrees of freedom at which it is held.
    """

    def __init__(self, algebra: ElasticAlgebra, factor: Factor, held: Array):
        self.notice = factor.notice
        self._algebra, self._factor = algebra, factor
        self._moves = free_rows(algebra, held) if len(held) else None
        if self._moves is None:
            self._reactions = factor.solve(algebra.mass_times_basis)  # A⁻¹MR
            self._masses = algebra.inner(algebra.mass_times_basis, self._reactions)

    def solve(self, block: Array) -> Array:
        """Solution for a real or complex block of right-hand sides, (rows here, k) to (rows here, k)."""
        algebra = self._algebra
        f = block - algebra.mass_times_basis @ algebra.inner(algebra.rigid, block)
        if self._moves is not None:
            return algebra.strained(self._factor.solve(self._moves * f))
        x = self._factor.solve(f)
        x = x - self._reactions @ np.linalg.solve(self._masses, algebra.inner(algebra.mass_times_basis, x))
        return algebra.strained(x)

    def apply(self, right: Any, solution: Any) -> None:
        """Solution for one right-hand side in PETSc vectors."""
        solution.array[:] = self.solve(right.array_r[:, None])[:, 0]

    def close(self) -> None:
        """Gives the memory back."""
        self._factor.close()
