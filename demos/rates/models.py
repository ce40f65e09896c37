"""What rates.py steps: reduced cylinders, models of any order, the bare products of a step, and the full order."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from cylinder import CONTACT, SCENE, mesh, places
from petsc4py import PETSc

import fenics_rom as fr
from fenics_rom.fem.petsc_matrix import combination
from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.rom.midpoint_map import matrices
from fenics_rom.rom.rom import Rom, check_rom, diagonalized_span
from fenics_rom.scene.file import parse_scene

Array = np.ndarray

STEP = 1e-3  # s
FORCE = 0.01  # N; bends the cylinder by about a millimetre
OUTPUT = "point"  # three numbers

WATCHED = f"""
[outputs.{OUTPUT}]
points = [[0.3, 0.0, 0.0075]]   # m
"""


def cylinder(file: Path, factor: float, contacts: int) -> fr.System:
    """The paper's cylinder, clamped at both ends, with one point to be watched."""
    if not file.exists():
        mesh(file, factor)
    text = SCENE.format(file=file.name) + WATCHED
    for name, (x, y, z) in places(contacts).items():
        text += CONTACT.format(name=name, x=x, y=y, z=z)
    return fr.assemble(parse_scene(text, folder=file.parent, source="cylinder"))


def synthetic(order: int) -> Rom:
    """A ROM of a random basis: stiffness over six decades, proportional damping, one contact mode, one point."""
    random = np.random.default_rng(order)
    size = order + 6
    κ = np.sort(10 ** random.uniform(2, 8, size))
    γ, C = diagonalized_span(κ, np.linalg.qr(random.standard_normal((size, order)))[0])
    mode = ContactModel(γ, 1 + 2e-3 * γ, random.standard_normal((order, 3)), C, np.eye(order), np.ones(order))
    return check_rom(
        Rom(
            name=f"synthetic, order {order}",
            switching="energy",
            contact_models={"only": mode},
            actuators={},
            basis=np.eye(size),
            stiffness=κ,
            outputs={OUTPUT: random.standard_normal((3, size))},
            free=np.arange(size),
            nodes=np.empty((0, 3)),
            triangles=np.empty((0, 3), dtype=int),
            node_mass=np.empty(0),
        )
    )


def midpoint(mode: ContactModel, inputs: Array) -> Array:
    """[ω q, r] (2m,) after steps from rest: the midpoint rule anew, in extended precision. Diagonal damping only."""
    γ, d, G = (part.astype(np.longdouble) for part in (mode.eigenvalues, mode.damping, mode.inputs))
    h = np.longdouble(STEP)
    q, r = np.zeros_like(γ), np.zeros_like(γ)
    for push in inputs @ G.T:
        v = (push + 2 / h * r - γ * q) / (2 / h + d + h / 2 * γ)
        q, r = q + h * v, 2 * v - r
    return np.concatenate([np.sqrt(γ) * q, r])


class BareProduct:
    """Nothing but one product of the (2m, 2m + p) matrix of a step, into an array that is there."""

    def __init__(self, mode: ContactModel):
        self._map = matrices(mode, STEP)[0]
        self._given, self.state = np.zeros(self._map.shape[1]), np.zeros(len(self._map))

    def run(self, inputs: Sequence[Array]) -> None:
        """The product, once for each input, without so much as taking over state and input."""
        dot, A, z, o = np.dot, self._map, self._given, self.state
        for _ in inputs:
            dot(A, z, out=o)

    def steps(self, inputs: Sequence[Array]) -> None:
        """The same, with state and input taken over: for the error."""
        for u in inputs:
            self._given[:] = np.concatenate([self.state, u])
            np.dot(self._map, self._given, out=self.state)


class BareFourCalls:
    """The step where damping is diagonal, written out: a real 2 x 2 map for each eigenvalue, and the push."""

    def __init__(self, mode: ContactModel):
        m, after = mode.order, matrices(mode, STEP)[0]
        parts = after[:, : 2 * m].reshape(2, m, 2, m)
        self._maps = np.ascontiguousarray(np.einsum("akbk->bak", parts))  # from e and r, to e and r
        self._push, self._pushed = after[:, 2 * m :].copy(), np.empty(2 * m)
        self._state, self._terms = np.zeros((2, m)), np.empty((2, 2, m))

    @property
    def state(self) -> Array:
        """[ω q, r] (2m,)."""
        return self._state.ravel()

    def run(self, inputs: Sequence[Array]) -> None:
        """Steps, with nothing checked."""
        multiply, add, dot = np.multiply, np.add, np.dot
        maps, push, terms, state, pushed = self._maps, self._push, self._terms, self._state, self._pushed
        columns, shaped = state[:, None], pushed.reshape(2, -1)
        from_e, from_r = terms
        for u in inputs:
            multiply(maps, columns, out=terms)
            add(from_e, from_r, out=state)
            dot(push, u, out=pushed)
            add(state, shaped, out=state)


class FullBare:
    """Full-order steps with a kept factor of 2/h M + D + h/2 K: one solve and the products M v and K x, no more.

    Args:
        system: with proportional damping.
        solver: PETSc's name of who factors: "cholmod", "mumps" or "petsc".
        ordering: of PETSc's own factor.
    """

    def __init__(self, system: fr.System, solver: str, ordering: str | None = None):
        α, β = system.rayleigh or (0.0, 0.0)
        M, K, h = system.mass, system.stiffness, STEP
        self._matrix = combination((2 / h + α, M), (h / 2 + β, K))
        self._matrix.setOption(PETSc.Mat.Option.SPD, True)
        self._preconditioner = PETSc.PC().create(self._matrix.comm)  # owns the factor
        self._preconditioner.setOperators(self._matrix)
        self._preconditioner.setType("cholesky")
        self._preconditioner.setFactorSolverType(solver)
        if ordering:
            self._preconditioner.setFactorOrdering(ordering)
        self._preconditioner.setUp()
        self._factor = self._preconditioner.getFactorMatrix()
        # Blocks of three, as of nodes: a quarter faster to multiply by than single numbers.
        self._inertial, self._elastic = (_blocked(combination(term)) for term in ((2 / h, M), (-1.0, K)))
        self._x, self._v, self._mean, self._right = (self._matrix.createVecRight() for _ in range(4))
        self._force = np.zeros(system.size)
        self._push = PETSc.Vec().createWithArray(self._force, comm=self._matrix.comm)
        self._patches: dict[str, tuple[Array, Array]] = {}
        for name in system.contacts:
            B = system.input_matrix(name)
            rows = np.flatnonzero(B.any(axis=1))
            self._patches[name] = rows, B[rows]

    @property
    def x(self) -> Array:
        """Displacement (n,), m; a view."""
        return self._x.array

    def run(self, contact: str, inputs: Sequence[Array]) -> None:
        """Steps under forces on a contact patch."""
        rows, B = self._patches[contact]
        self._force[:] = 0
        for u in inputs:
            self._force[rows] = B @ u
            self._inertial.multAdd(self._v, self._push, self._right)
            self._elastic.multAdd(self._x, self._right, self._right)
            self._factor.solve(self._right, self._mean)
            self._x.axpy(STEP, self._mean)
            self._v.axpby(2.0, -1.0, self._mean)


class FullCarried(FullBare):
    """The same with one product: M v and K x are carried along, and K v̂ is what the solved equation leaves of it.

    That is a fifth faster, and lets round-off pile up; the textbook's step is the other.
    """

    def __init__(self, system: fr.System, solver: str):
        super().__init__(system, solver)
        α, β = system.rayleigh or (0.0, 0.0)
        self._mass, self._kept, self._stiff = _blocked(combination((1.0, system.mass))), 2 / STEP + α, STEP / 2 + β
        self._momentum, self._strain, self._given = (self._matrix.createVecRight() for _ in range(3))  # M v, K x, M v̂

    def run(self, contact: str, inputs: Sequence[Array]) -> None:
        """Steps under forces on a contact patch."""
        rows, B = self._patches[contact]
        self._force[:] = 0
        right, mean, given = self._right, self._mean, self._given
        for u in inputs:
            self._force[rows] = B @ u
            self._momentum.copy(right)
            right.scale(2 / STEP)
            right.axpy(1.0, self._push)
            right.axpy(-1.0, self._strain)
            self._factor.solve(right, mean)
            self._mass.mult(mean, given)
            right.axpy(-self._kept, given)  # (h/2 + β) K v̂
            self._strain.axpy(STEP / self._stiff, right)
            self._momentum.axpby(2.0, -1.0, given)
            self._x.axpy(STEP, mean)
            self._v.axpby(2.0, -1.0, mean)


def _blocked(mat: Any) -> Any:
    return mat.convert("baij") if mat.getBlockSize() == 3 else mat
