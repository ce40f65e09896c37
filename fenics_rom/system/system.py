"""The full-order model: M, D, K and the input matrices, whoever assembled them.

The reduction sees a system only through M @ X, D @ X, K @ X, solves, Xᵀ Y summed over the ranks, and eigenpairs.
Blocks of vectors are NumPy arrays that hold the rows of this rank; the rows of the ranks follow one another.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite
from typing import Any, Protocol

import numpy as np

from fenics_rom.errors import SolverError, StructureError
from fenics_rom.io.stages import Stage
from fenics_rom.scene.scene import Scene
from fenics_rom.system.rigid_modes import check_rigid, fixed_dofs, hint, is_singular, mass_orthonormal

Array = np.ndarray
PROPORTIONAL = 1e-12  # share of D that may be neither M nor K where it counts as α M + β K
MATRICES = ("mass", "damping", "stiffness")
COLUMNS = ("contacts", "actuators", "outputs")
NONE = np.empty(0, dtype=int)


def by_parts(operation: Callable[[Array], Array], block: Array) -> Array:
    """What a real linear operation makes of complex columns (any, k): their parts side by side, one operation."""
    both, count = operation(np.hstack([block.real, block.imag])), block.shape[1]
    return both[:, :count] + 1j * both[:, count:]


class Operator(Protocol):
    """A symmetric n × n matrix."""

    def __matmul__(self, block: Array) -> Array:
        """Product with a real or complex block, (rows here, k) to (rows here, k)."""


class Factor(Protocol):
    """Solves with a symmetric matrix, again and again: a kept factorisation, or an iterative solver.

    Attributes:
        notice: what the user should know of how it solves; empty where there is nothing to say.
    """

    notice: str

    def solve(self, block: Array) -> Array:
        """Solution for a real or complex block of right-hand sides, (rows here, k) to (rows here, k)."""

    def close(self) -> None:
        """Gives the memory back."""


class Algebra(Protocol):
    """What the ranks do together."""

    def inner(self, left: Array, right: Array) -> Array:
        """leftᵀ right, summed over the ranks; the same bits on every rank."""

    def gather(self, block: Array) -> Array:
        """All rows of a block, on every rank."""

    def rows(self) -> slice:
        """Which rows are held here."""

    def factor(self, *terms: tuple[complex, Any], solver: str = "auto", fixed_dofs: Array = NONE) -> Factor:
        """Factorisation of a sum of coefficient times operator; complex as soon as one coefficient is.

        The degrees of freedom `fixed_dofs` are held where they are; only with real coefficients.
        """

    def eigenpairs(self, mass: Any, stiffness: Any, count: int, factor: Any = None) -> tuple[Array, Array]:
        """The lowest eigenvalues γ (count,) of K v = γ M v, and M-orthonormal eigenvectors (rows here, count).

        A kept `factor` of K saves another one.
        """


class Deformation(Protocol):
    """How a full-order body deforms largely: a potential ∫ W(E) in place of ½ xᵀ K x, and what steps it."""

    @property
    def law(self) -> str:
        """Of the material, one of `hyperelastic.LAWS`."""

    @property
    def weights(self) -> Array:
        """Volumes that the quadrature points of this rank stand for, (P here,), m³."""

    @property
    def first_lame(self) -> Array:
        """λ there, (P here,), Pa."""

    @property
    def shear(self) -> Array:
        """μ there, (P here,), Pa."""

    @property
    def viscosity(self) -> Array:
        """β there, (P here,), s: of the stress β (λ tr(Ė) I + 2μ Ė)."""

    @property
    def spring(self) -> Operator | None:
        """K_s of springs to ground, N/m; None: no springs."""

    @property
    def external_damping(self) -> Operator | None:
        """D_c, damping that does not strain: α M and dashpots, N s/m; None: nothing."""

    @property
    def tendons(self) -> Mapping[str, tuple[Array, Array]]:
        """Points (K, 3), m, and shapes (rows here, 3K): the moved points are points + (shapesᵀ x).reshape(K, 3)."""

    def gradients(self, columns: Array) -> Array:
        """Displacement gradients [i, j] = ∂u_i/∂X_j of columns (rows here, k) at the points, (3, 3, P here, k)."""

    def force(self, x: Array) -> Array:
        """∂/∂x of ∫ W(E), (rows here,), N, at a displacement (rows here,), m."""

    def stepper(self, dt: float, environment: Any = None, *, ledger: bool = True) -> Any:
        """What steps the body at full order from rest, see mechanics.step.Stepper."""

    def follower(self, x: Array) -> dict[str, Array]:
        """Force (rows here, 1) of 1 Pa or 1 N of each pressure and tendon at a displacement (rows here,), m."""


@dataclass(frozen=True)
class Body:
    """Where the degrees of freedom are: canonical nodes, the same on every rank.

    Attributes:
        nodes: (N, 3), m.
        triangles: (F, 3), outward surface triangles between nodes.
        free: (n,), which of the 3 N displacement components are free, ascending.
        node_mass: (N,), kg; the diagonal of M scaled to the mass of the body (Hinton, Rock & Zienkiewicz 1976).
        contact_surfaces: nodes (any,) of the surface of each contact mode.
    """

    nodes: Array
    triangles: Array
    free: Array
    node_mass: Array
    contact_surfaces: Mapping[str, Array] = field(default_factory=dict)


@dataclass(frozen=True, init=False)
class System:
    """M v̇ + D v + K x = B_i u_i, dx/dt = v, y = Cᵀ x.

    `assemble` makes one from a scene, `from_forms` from variational forms, `read_system` from files. Anyone's SciPy,
    NumPy or PETSc matrices make one, too:

        System(mass=M, damping=D, stiffness=K, contacts={"tip": B}, outputs={"tip": C})
        System(mass=M, rayleigh=(α, β), stiffness=K, contacts={"tip": B})  # D = α M + β K

    With SciPy or NumPy matrices B and C are arrays or sparse matrices (n, columns), or vectors (n,). With PETSc
    matrices they are such blocks of the rows of this rank, PETSc matrices with the same rows, or lists of PETSc
    vectors; then all ranks of the matrices' communicator make the system together.

    A body that moves freely has a singular K: `rigid` are columns that span its null space, given like those of a
    contact mode.

    Attributes:
        mass, damping, stiffness: symmetric; M positive definite, D positive semi-definite, K positive definite but for
            the rigid motions. kg, N s/m, N/m.
        contacts: contact columns of each contact mode, (rows here, columns).
        actuators: columns of each actuator, which every contact mode has after its own, (rows here, columns).
        loads: columns of each load that acts by a history of its own, after the actuators', (rows here, columns).
        units: for those actuators and loads that are effects, what their columns are to be multiplied by for an input
            of 1 (Pa, N, ...): the columns may have any length, which says how much of them a basis is to know.
        contact_points: nodes of each contact mode at which obstacles can touch it, (P,) each; the contact modes that
            have some are reduced for forces at each of them, too.
        outputs: C of each named output, (rows here, 3 points); any number of columns where there is no mesh.
        algebra: solves, sums and eigenpairs for these matrices.
        rayleigh: (α, β) where D = α M + β K, else None. 1/s, s.
        rigid: R (rows here, ρ), RᵀMR = I, what spans the null space of K; no columns where the body is held. kg^-1/2.
        body: nodes and surface; without nodes where there is no mesh.
        scene: the scene it was assembled from, if it was.
        deformation: of a body that deforms largely, beyond what these matrices say; None: linear.
        warnings: what the user should know about this model.
        stages: what making it spent its time on.

    Example:
        >>> M, K = np.eye(3), np.array([[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 2.0]])
        >>> fr.System(mass=M, damping=0.01 * K, stiffness=K, contacts={"left": [1.0, 0.0, 0.0]}).size
        3
    """

    mass: Operator
    damping: Operator
    stiffness: Operator
    contacts: Mapping[str, Array]
    actuators: Mapping[str, Array]
    loads: Mapping[str, Array]
    units: Mapping[str, float]
    contact_points: Mapping[str, Array]
    outputs: Mapping[str, Array]
    algebra: Algebra
    rayleigh: tuple[float, float] | None
    rigid: Array
    body: Body
    scene: Scene | None
    deformation: Deformation | None
    warnings: tuple[str, ...]
    stages: tuple[Stage, ...]

    def __init__(
        self,
        *,
        mass: Any,
        stiffness: Any,
        contacts: Mapping[str, Any],
        damping: Any = None,
        actuators: Mapping[str, Any] | None = None,
        loads: Mapping[str, Array] | None = None,
        units: Mapping[str, float] | None = None,
        contact_points: Mapping[str, Array] | None = None,
        outputs: Mapping[str, Any] | None = None,
        algebra: Algebra | None = None,
        rayleigh: tuple[float, float] | None = None,
        rigid: Any = None,
        body: Body | None = None,
        scene: Scene | None = None,
        deformation: Deformation | None = None,
        warnings: tuple[str, ...] = (),
        stages: tuple[Stage, ...] = (),
    ):
        """Takes what `assemble` has put together as it is (then `algebra` is given), and checks anything else.

        Raises:
            StructureError: matrices or columns that do not fit or lack structure, with the measured number.
        """
        given = {name: value for name, value in locals().items() if name != "self"}
        given |= {name: given[name] or {} for name in ("actuators", "loads", "units", "contact_points", "outputs")}
        if not contacts:
            raise StructureError("contacts: at least one contact mode is needed")
        if algebra is None:
            given |= _checked(given)
        elif rigid is None:
            here = algebra.rows()
            given["rigid"] = np.empty((here.stop - here.start, 0))
        for name in self.__dataclass_fields__:
            object.__setattr__(self, name, given[name])

    @classmethod
    def from_forms(
        cls,
        *,
        mass: Any,
        stiffness: Any,
        contacts: Mapping[str, Any],
        damping: Any = None,
        rayleigh: tuple[float, float] | None = None,
        actuators: Mapping[str, Any] | None = None,
        outputs: Mapping[str, Any] | None = None,
        bcs: Sequence[Any] = (),
    ) -> "System":
        """The system of variational forms in dolfinx, on any function space; every rank of the mesh must call it.

        Displacements in 3D (Lagrange of degree 1 or 2 on straight tetrahedra) get nodes and a surface, so that they
        can be drawn, and rows that do not depend on the number of ranks. Any other space (2D, scalar, mixed) is a
        model without a mesh, with its rows in dolfinx's order.

        Args:
            mass, stiffness: bilinear UFL forms of one space, symmetric and positive definite under the `bcs`; stiffness
                but for the rigid motions of displacements in 3D, which are found.
            contacts: linear UFL forms of each contact mode, one per input: the work of a unit input on a test function.
            damping: bilinear UFL form, symmetric and positive semi-definite.
            rayleigh: instead of `damping`: (α, β) of D = α M + β K, 1/s and s.
            actuators: linear UFL forms of each actuator, which every contact mode has after its own.
            outputs: linear UFL forms of each output, functionals of the displacement; where there are nodes, three
                for each point.
            bcs: Dirichlet conditions of value zero; their degrees of freedom are eliminated.

        Raises:
            StructureError: forms that do not fit together or lack structure, or a boundary value other than zero.
        """
        from fenics_rom.fem.forms import system_of_forms

        return system_of_forms(
            mass=mass,
            stiffness=stiffness,
            contacts=contacts,
            damping=damping,
            rayleigh=rayleigh,
            actuators=actuators or {},
            outputs=outputs or {},
            bcs=bcs,
        )

    @property
    def size(self) -> int:
        """Number n of free displacement degrees of freedom."""
        return len(self.body.free)

    @property
    def widths(self) -> dict[str, int]:
        """Number of columns of each actuator and load, which every contact mode has after its own."""
        return {name: columns.shape[1] for name, columns in {**self.actuators, **self.loads}.items()}

    def input_matrix(self, contact: str) -> Array:
        """B_i: the contact columns, then those of actuators and loads, (rows here, p_i), in the units of the inputs."""
        units = [self.units.get(name, 1.0) for name in (*self.actuators, *self.loads)]
        shared = [unit * B for unit, B in zip(units, (*self.actuators.values(), *self.loads.values()), strict=True)]
        return np.hstack([self.contacts[contact], *shared])

    def forces(self, contact: str) -> Array:
        """All that can act in a contact mode, (rows here, any): what its basis has to know.

        The contact columns, actuators and loads, and where obstacles can touch it a force on each component of a node.
        """
        parts = [self.contacts[contact], *self.actuators.values(), *self.loads.values()]
        if contact in self.contact_points:
            parts.append(self.at_nodes(self.contact_points[contact]))
        return np.hstack(parts)

    def at_nodes(self, nodes: Array) -> Array:
        """Unit forces on the free components of nodes (P,), a column each, (rows here, at most 3 P)."""
        row = np.searchsorted(self.body.free, (3 * nodes[:, None] + np.arange(3)).ravel())
        here = self.algebra.rows()
        columns = np.zeros((here.stop - here.start, len(row)))
        local = (here.start <= row) & (row < here.stop)
        columns[row[local] - here.start, np.flatnonzero(local)] = 1.0
        return columns

    @property
    def elastic_size(self) -> int:
        """Number of displacements that strain: n less the rigid motions."""
        return self.size - self.rigid.shape[1]


def unmeshed(size: int) -> Body:
    """The body of a model without a mesh."""
    return Body(np.empty((0, 3)), np.empty((0, 3), dtype=int), np.arange(size), np.empty(0))


def check_damping_choice(damping: Any, rayleigh: tuple[float, float] | None) -> None:
    """Refuses both or none of a damping matrix and (α, β), and an (α, β) that could drive.

    Raises:
        StructureError: what was given, and what is allowed.
    """
    if (damping is None) == (rayleigh is None):
        raise StructureError(
            f"{'neither' if damping is None else 'both'} damping {'nor' if damping is None else 'and'} rayleigh given; "
            "allowed is one of them"
        )
    if rayleigh is not None and not (len(rayleigh) == 2 and all(isfinite(c) and c >= 0 for c in rayleigh)):
        raise StructureError(f"rayleigh = {rayleigh}: allowed are two finite numbers (α, β) from 0, in 1/s and s")


def is_petsc(value: Any) -> bool:
    """Whether it is an object of petsc4py, which need not be installed for this."""
    return any(kind.__module__.partition(".")[0] == "petsc4py" for kind in type(value).__mro__)


def _checked(given: Mapping[str, Any]) -> dict[str, Any]:
    """Anyone's matrices and columns as fields of a system, measured."""
    check_damping_choice(given["damping"], given["rayleigh"])
    if any(is_petsc(given[name]) for name in MATRICES):
        from fenics_rom.fem.user_matrices import checked_parts

        parts = checked_parts(given)
    else:
        parts = _checked_here(given)
    return parts | {"body": given["body"] or parts["body"]}


def _checked_here(given: Mapping[str, Any]) -> dict[str, Any]:
    """SciPy and NumPy matrices, which each process has all of."""
    from fenics_rom.system.scipy_backend import MatrixAlgebra, checked_block, checked_columns, checked_matrix

    _refuse_what_is_not_for_scipy(given)
    M = checked_matrix(given["mass"], "mass", None, definite=True)
    size = M.shape[0]
    algebra, rayleigh = MatrixAlgebra(size), given["rayleigh"]
    K = checked_matrix(given["stiffness"], "stiffness", size, definite=None)
    R = np.empty((size, 0)) if given["rigid"] is None else checked_block(given["rigid"], "rigid", size)
    R = rigid_columns(M, K, R, algebra)
    _check_definite(K, R, algebra)
    damping = given["damping"] if rayleigh is None else rayleigh[0] * M + rayleigh[1] * K
    D = checked_matrix(damping, "damping", size, definite=False)
    return {
        **{"mass": M, "damping": D, "stiffness": K, "algebra": algebra, "body": unmeshed(size)},
        **{kind: checked_columns(given[kind], kind, size) for kind in COLUMNS},
        "rayleigh": rayleigh or rayleigh_of(M, D, K, algebra, size),
        "rigid": R,
    }


def rigid_columns(M: Operator, K: Operator, columns: Array, algebra: Algebra) -> Array:
    """R of anyone's columns (rows here, ρ), measured.

    Raises:
        StructureError: they depend on each other, or strain the body.
    """
    R = mass_orthonormal(M, columns, algebra)
    check_rigid(M, K, R, algebra)
    return R


def _check_definite(K: Operator, R: Array, algebra: Algebra) -> None:
    from fenics_rom.system.scipy_backend import MatrixFactor, held

    fixed = fixed_dofs(R, algebra)
    try:
        singular = is_singular(K, MatrixFactor(held(K, fixed)), algebra, fixed)
    except SolverError as error:
        raise StructureError(f"stiffness is not positive definite{hint(R)}") from error
    if singular:
        raise StructureError(f"stiffness is not positive definite, but singular to round-off{hint(R)}")


def _refuse_what_is_not_for_scipy(given: Mapping[str, Any]) -> None:
    """NumPy would drop imaginary parts, and take a PETSc vector for something else."""
    columns = {f"{kind}[{name!r}]": value for kind in COLUMNS for name, value in given[kind].items()}
    for name, value in ({name: given[name] for name in (*MATRICES, "rigid")} | columns).items():
        if any(map(is_petsc, value if isinstance(value, list | tuple) else [value])):
            raise StructureError(f"{name} is of PETSc, but the matrices are not")
        if np.iscomplexobj(value):
            raise StructureError(f"{name} is complex; allowed are real numbers")


def rayleigh_of(M: Operator, D: Operator, K: Operator, algebra: Algebra, size: int) -> tuple[float, float] | None:
    """(α, β) of D = α M + β K, or None where D is anything else; told by products with a few vectors."""
    probes = np.random.default_rng(0).standard_normal((size, 4))[algebra.rows()]

    def dot(left: Array, right: Array) -> float:
        return float(np.trace(algebra.inner(left, right)))

    Mz, Dz, Kz = (A @ probes for A in (M, D, K))
    μ, κ = np.sqrt(dot(Mz, Mz)), np.sqrt(dot(Kz, Kz))
    cosine = dot(Mz, Kz) / (μ * κ)
    weights, rest = np.zeros(2), Dz
    for _ in range(2):  # once more for what the normal equations lose to round-off
        projections = [dot(Mz, rest) / μ, dot(Kz, rest) / κ]
        weights += np.linalg.lstsq([[1.0, cosine], [cosine, 1.0]], projections, rcond=None)[0]
        rest = Dz - weights[0] / μ * Mz - weights[1] / κ * Kz
    if dot(rest, rest) > PROPORTIONAL**2 * dot(Dz, Dz):
        return None
    return float(weights[0] / μ), float(weights[1] / κ)
