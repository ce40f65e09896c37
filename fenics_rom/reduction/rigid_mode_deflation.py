"""A body that is not wholly held as its elastic rest, so that no method needs to know of rigid motions.

With R (K R = 0, RᵀMR = I) and P = I - R RᵀM, displacements x = R s + P x and velocities split M-orthogonally. The
elastic rest has the same M, D and K, loads PᵀB and outputs PᵀC, and solves whose solutions have no part in R. What is
reduced of it gets R back, exactly, in every contact mode.
"""

import math
from contextlib import closing
from dataclasses import replace
from typing import Any

import numpy as np
import scipy.linalg
from numpy import ndarray as Array

from fenics_rom.errors import SceneError
from fenics_rom.mechanics.readings import projected
from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.rom.rom import Rom
from fenics_rom.system.columns import column_dots
from fenics_rom.system.protocols import DENSE_SHARE, EXACT, NO_DOFS, USUAL_COLUMNS, Factor
from fenics_rom.system.rigid_modes import choose_fixed_dofs, free_rows
from fenics_rom.system.system import System

LOAD_ROUND_OFF = 1e-12  # share of a column that may strain the body and is round-off


def elastic_part(system: System) -> System:
    """What strains of a body: the system itself where that is all."""
    if not system.rigid.shape[1]:
        return system
    algebra = ElasticAlgebra(system)
    given = vars(system) | {"algebra": algebra}
    for kind in ("contacts", "actuators", "loads", "outputs"):
        given[kind] = {name: algebra.balanced(B) for name, B in given[kind].items()}
    frame = system.moving_frame
    if frame is not None and frame.tie_forces is not None:
        given["moving_frame"] = replace(frame, tie_forces=algebra.balanced(frame.tie_forces))
    return _ElasticSystem(**given)


def first_frequency(system: System) -> float:
    """The lowest at which a body oscillates, Hz; every rank must call it."""
    elastic = elastic_part(system)
    γ, _ = elastic.algebra.eigenpairs(elastic.mass, elastic.stiffness, 1)
    return math.sqrt(γ[0]) / math.tau


class _ElasticSystem(System):
    """An elastic part, whose loads are in balance wherever they come from."""

    def at_nodes(self, nodes: Array) -> Array:
        """As in System."""
        columns: Array = self.algebra.balanced(super().at_nodes(nodes))  # type: ignore[attr-defined]
        return columns


def require_loads(system: System) -> None:
    """Refuses (SceneError) contact modes of an elastic part whose inputs strain nothing."""
    for name in system.contacts:
        blocks = (system.forces(name, some) for some in system.force_blocks(name))
        if not any(column_dots(system.algebra, B, B).any() for B in blocks):
            raise SceneError(
                f"contact mode {name!r}: its inputs move the body without straining it, so there is nothing that they "
                "ask to be kept; give them to an actuator, beside a contact that strains it"
            )


def with_rigid_modes(rom: Rom, system: System) -> Rom:
    """The ROM of the whole body, `system`, from that of its elastic part: R comes first in every contact mode."""
    R, algebra = system.rigid, system.algebra
    rigid = R.shape[1]
    if not rigid:
        return rom
    coupled = None
    if system.rayleigh is None:  # dampers may couple rigid and elastic motions
        DR = system.damping @ R
        coupled = np.hstack([algebra.inner(R, DR), algebra.inner(DR, rom.basis[algebra.rows()])])
    basis = np.hstack([algebra.gather(np.ascontiguousarray(R)), rom.basis])
    return replace(
        rom,
        contact_models={
            name: replace(
                model,
                eigenvalues=np.concatenate([np.zeros(rigid), model.eigenvalues]),
                damping=_damping(model, rigid, system.rayleigh, coupled),
                inputs=np.vstack([algebra.inner(R, system.input_matrix(name)), model.inputs]),
                coordinates=scipy.linalg.block_diag(np.eye(rigid), model.coordinates),
                directions=scipy.linalg.block_diag(np.eye(rigid), model.directions),
            )
            for name, model in rom.contact_models.items()
        },
        basis=basis,
        readings={name: projected(reading, basis) for name, reading in system.readings.items()},
        stiffness=np.concatenate([np.zeros(rigid), rom.stiffness]),
        outputs={name: np.hstack([algebra.inner(system.outputs[name], R), C]) for name, C in rom.outputs.items()},
    )


def _damping(model: ContactModel, rigid: int, rayleigh: tuple[float, float] | None, coupled: Array | None) -> Array:
    """[R, W]ᵀ D [R, W], from that of W and [RᵀDR, RᵀDQ]."""
    if coupled is None:
        assert rayleigh is not None
        return np.concatenate([np.full(rigid, rayleigh[0]), model.damping])
    rows = np.hstack([coupled[:, :rigid], coupled[:, rigid:] @ model.coordinates])
    D = np.block([[rows], [rows[:, rigid:].T, model.damping]])
    return (D + D.T) / 2


class ElasticAlgebra:
    """Sums as in the whole body; solves and eigenpairs in what is M-orthogonal to its rigid motions."""

    def __init__(self, system: System):
        whole = self.whole = system.algebra
        self._mass, self._size = system.mass, system.size
        self.rigid = system.rigid
        self.mass_times_rigid = system.mass @ system.rigid
        self.rows, self.row_offset, self.inner, self.gather = whole.rows, whole.row_offset, whole.inner, whole.gather
        self.broadcast, self.maximum, self.total = whole.broadcast, whole.maximum, whole.total

    def balanced(self, loads: Array) -> Array:
        """Pᵀ f of loads (rows here, any); those that strain nothing but by round-off are zero then."""
        balanced = loads
        for _ in range(2):
            balanced = balanced - self.mass_times_rigid @ self.inner(self.rigid, balanced)
        size, given = (np.sqrt(column_dots(self, columns, columns)) for columns in (balanced, loads))
        return balanced * (size > LOAD_ROUND_OFF * given)

    def strained(self, shapes: Array) -> Array:
        """P x of displacements (rows here, any)."""
        return shapes - self.rigid @ self.inner(self.mass_times_rigid, shapes)

    def factor(
        self,
        *terms: tuple[complex, Any],
        solver: str = "auto",
        fixed_dofs: Array = NO_DOFS,
        columns: int = USUAL_COLUMNS,
    ) -> "ElasticFactor":
        """Factor of a sum of coefficient times operator, on the elastic rest.

        K alone is fixed at as many degrees of freedom as there are rigid motions: loads in balance do not feel them.
        A sum with M is regular as it is.
        """
        regular = any(c != 0 and operator is self._mass for c, operator in terms)
        fixed = NO_DOFS if regular else choose_fixed_dofs(self.rigid, self.whole)
        made = self.whole.factor(*terms, solver=solver, fixed_dofs=fixed, columns=columns)
        return ElasticFactor(self, made, fixed)

    def eigenpairs(self, mass: Any, stiffness: Any, count: int, factor: Any = None) -> tuple[Array, Array]:
        """The lowest γ > 0, ascending, and their M-orthonormal eigenvectors."""
        if DENSE_SHARE * count > self._size:
            γ, V = self._all_eigenpairs(mass, stiffness)
            return γ[:count], V[:, :count]
        if factor is None:
            with closing(self.factor((1.0, stiffness))) as made:
                return self.eigenpairs(mass, stiffness, count, made)
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


class ElasticFactor:
    """Solutions without rigid motions, whatever part of the load would move the body as a whole.

    With one row and column for each rigid motion, A x + M R λ = f and RᵀM x = 0: x = P A⁻¹ Pᵀ f where A leaves the
    elastic rest to itself, as K, M and proportional damping do, and the projected D for any other. Of K, some degrees
    of freedom are fixed.
    """

    def __init__(self, algebra: ElasticAlgebra, factor: Factor, fixed: Array):
        self.notice = factor.notice
        self._algebra, self._factor = algebra, factor
        self._free = free_rows(algebra, fixed) if len(fixed) else None
        if self._free is None:
            self._reactions = factor.solve(algebra.mass_times_rigid)  # A⁻¹MR
            self._masses = algebra.inner(algebra.mass_times_rigid, self._reactions)

    def solve(self, block: Array, accuracy: float = EXACT) -> Array:
        """Solution for a real or complex block of right-hand sides, (rows here, k) to (rows here, k)."""
        algebra = self._algebra
        f = block - algebra.mass_times_rigid @ algebra.inner(algebra.rigid, block)
        if self._free is not None:
            return algebra.strained(self._factor.solve(self._free * f, accuracy))
        x = self._factor.solve(f, accuracy)
        x = x - self._reactions @ np.linalg.solve(self._masses, algebra.inner(algebra.mass_times_rigid, x))
        return algebra.strained(x)

    def apply(self, right: Any, solution: Any) -> None:
        """Solution for one right-hand side in PETSc vectors."""
        solution.array[:] = self.solve(right.array_r[:, None])[:, 0]

    def close(self) -> None:
        """Gives the memory back."""
        self._factor.close()
