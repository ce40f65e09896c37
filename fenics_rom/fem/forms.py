"""Variational forms to System: assembled by dolfinx, constrained degrees of freedom eliminated."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem.petsc import assemble_vector, set_bc
from dolfinx.mesh import CellType
from petsc4py import PETSc

from fenics_rom.errors import StructureError
from fenics_rom.fem.body_matrices import assemble_form, dolfinx_nodes, node_masses
from fenics_rom.fem.dolfinx_compat import cell_nodes, input_nodes, quiet_compiler, vector_space
from fenics_rom.fem.mesh import Mesh, oriented
from fenics_rom.fem.mesh_quality import check_filling, radius_ratios
from fenics_rom.fem.nodes import canonical_nodes
from fenics_rom.fem.petsc_algebra import PetscAlgebra, require_real
from fenics_rom.fem.petsc_matrix import PetscMatrix
from fenics_rom.fem.restriction import rows_here, set_rigid_modes
from fenics_rom.fem.rigid_modes import rigid_motions
from fenics_rom.fem.user_matrices import refuse_together
from fenics_rom.mechanics.body_facts import quality_of
from fenics_rom.system.body import Body, Unknowns
from fenics_rom.system.rayleigh_damping import check_damping_choice
from fenics_rom.system.rigid_modes import mass_orthonormal, without_energy
from fenics_rom.system.system import System

ARITY = {1: "a linear form: one test function", 2: "a bilinear form: a trial and a test function"}
UNCONSTRAINED = np.finfo(float).max  # stands where no Dirichlet condition has put its value


@dataclass(frozen=True)
class _FreeRows:
    """The unconstrained degrees of freedom in the order of the system.

    Attributes:
        index_set: those of this rank, as global dolfinx numbers.
        body: nodes and surface, where there are any.
        local_nodes: (N here, 3) coordinates of the nodes of this rank, m, where all of them are free in all components.
        motions: (rows here, ρ) rigid motions that the constraints leave, where there are nodes.
    """

    index_set: PETSc.IS
    body: Body | None = None
    local_nodes: np.ndarray | None = None
    motions: np.ndarray | None = None

    def take_matrix(self, matrix: PETSc.Mat) -> PETSc.Mat:
        """These rows and columns; the whole matrix is given back."""
        reduced = matrix.createSubMatrix(self.index_set, self.index_set)
        matrix.destroy()
        return reduced

    def column(self, form: Any) -> np.ndarray:
        """These rows of a linear form, (rows here,)."""
        vector = assemble_vector(fem.form(form))
        vector.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        part = vector.getSubVector(self.index_set)
        rows = part.array_r.copy()
        vector.restoreSubVector(self.index_set, part)
        vector.destroy()
        return rows


def assemble_forms(
    *,
    mass: Any,
    stiffness: Any,
    contacts: Mapping[str, Any],
    damping: Any = None,
    rayleigh: tuple[float, float] | None = None,
    actuators: Mapping[str, Any] | None = None,
    outputs: Mapping[str, Any] | None = None,
    bcs: Sequence[Any] = (),
) -> System:
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

    Example:
        >>> import ufl
        >>> from dolfinx import mesh
        >>> from mpi4py import MPI
        >>> from fenics_rom.fem.dolfinx_compat import vector_space
        >>> box = mesh.create_box(MPI.COMM_WORLD, [[0, 0, 0], [1, 1, 1]], [2, 2, 2])
        >>> V = vector_space(box, 1)
        >>> u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
        >>> stiffness = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx + ufl.inner(u, v) * ufl.ds
        >>> forms = {"mass": ufl.inner(u, v) * ufl.dx, "stiffness": stiffness, "contacts": {"top": [v[2] * ufl.ds]}}
        >>> fr.assemble_forms(**forms, rayleigh=(1.0, 1e-3)).size
        81
    """
    require_real(PETSc.ScalarType)
    check_damping_choice(damping, rayleigh)
    if not isinstance(mass, ufl.Form) or len(mass.arguments()) != 2:
        raise StructureError(f"mass is no UFL form with two arguments; use {ARITY[2]}")
    space = mass.arguments()[0].ufl_function_space()
    bilinear = {"mass": mass, "stiffness": stiffness} | ({} if damping is None else {"damping": damping})
    linear = {
        kind: {name: _as_list(forms, f"{kind}[{name!r}]") for name, forms in given.items()}
        for kind, given in {"contacts": contacts, "actuators": actuators or {}, "outputs": outputs or {}}.items()
    }
    for name, form in bilinear.items():
        _check_form(name, form, 2, space)
    for kind, given in linear.items():
        for name, forms in given.items():
            for k, form in enumerate(forms):
                _check_form(f"{kind}[{name!r}][{k}]", form, 1, space)

    with quiet_compiler():
        matrices = {name: assemble_form(form) for name, form in bilinear.items()}
        rows = _free_rows(space, _constrained(space, bcs), matrices["mass"])
        columns = {
            kind: {name: np.stack([*map(rows.column, forms)], axis=1) for name, forms in given.items()}
            for kind, given in linear.items()
        }
    for name, C in columns["outputs"].items():
        if rows.body is not None and C.shape[1] % 3:
            raise StructureError(
                f"outputs[{name!r}] has {C.shape[1]} forms; on a body with nodes an output is displacements of "
                "points: use three forms (x, y, z) for each"
            )
    reduced = {name: rows.take_matrix(matrix) for name, matrix in matrices.items()}
    if rows.local_nodes is not None:
        set_rigid_modes(reduced["stiffness"], rows.local_nodes)
    parts: dict[str, Any] = {**reduced, **columns, "rigid": _rigid(rows, reduced), "body": rows.body}
    system = System(**parts, rayleigh=rayleigh)
    for matrix in reduced.values():  # the system has copies, and PETSc forgets nothing by itself
        matrix.destroy()
    return system


def _rigid(rows: _FreeRows, matrices: Mapping[str, PETSc.Mat]) -> np.ndarray | None:
    """Those motions that the stiffness does not see, either; None where there are none."""
    if rows.motions is None:
        return None
    M, K = (PetscMatrix(matrices[name]) for name in ("mass", "stiffness"))
    algebra = PetscAlgebra(M.mat.comm.tompi4py(), M.mat.getOwnershipRange())
    rigid = without_energy(M, K, mass_orthonormal(M, rows.motions, algebra), algebra)
    return rigid if rigid.shape[1] else None


def _as_list(forms: Any, where: str) -> list[Any]:
    """Forms, one per column; one alone is one column."""
    listed = [forms] if isinstance(forms, ufl.Form) else list(forms)
    if not listed:
        raise StructureError(f"{where} has no forms; use one for each column, at least one")
    return listed


def _check_form(where: str, form: Any, arity: int, space: Any) -> None:
    if not isinstance(form, ufl.Form):
        raise StructureError(f"{where} is a {type(form).__name__}; use a UFL form")
    arguments = form.arguments()
    if len(arguments) != arity:
        raise StructureError(f"{where} has {len(arguments)} argument{'s' * (len(arguments) != 1)}; use {ARITY[arity]}")
    if any(argument.ufl_function_space() != space for argument in arguments):
        raise StructureError(f"{where} is of another function space than mass")


def _constrained(space: Any, bcs: Sequence[Any]) -> np.ndarray:
    """Which of the degrees of freedom that this rank owns have a Dirichlet condition, (rows here,)."""
    for k, bc in enumerate(bcs):
        if not hasattr(bc, "function_space"):
            raise StructureError(f"bcs[{k}] is a {type(bc).__name__}; use Dirichlet conditions of dolfinx")
        if not space._cpp_object.contains(bc.function_space):
            raise StructureError(f"bcs[{k}] is of another function space than mass")
    dofs = space.dofmap
    values = PETSc.Vec().createMPI((dofs.index_map.size_local * dofs.index_map_bs, None), comm=space.mesh.comm)
    values.set(UNCONSTRAINED)
    set_bc(values, list(bcs))
    fixed = values.array_r != UNCONSTRAINED
    nonzero = np.flatnonzero(fixed & (values.array_r != 0))
    refuse_together(
        space.mesh.comm,
        f"bcs: a Dirichlet condition has the value {values.array_r[nonzero[0]]:g}; use 0: the body hangs on it"
        if len(nonzero)
        else "",
    )
    values.destroy()
    return fixed


def _free_rows(space: Any, constrained: np.ndarray, mass: PETSc.Mat) -> _FreeRows:
    """What is left of the degrees of freedom, and in which order."""
    comm = space.mesh.comm
    if comm.allreduce(int((~constrained).sum())) == 0:
        raise StructureError("bcs: every degree of freedom is constrained")
    degree = _displacement_degree(space)
    if degree is None:
        rows = mass.getOwnershipRange()[0] + np.flatnonzero(~constrained)
        return _FreeRows(PETSc.IS().createGeneral(rows.astype(PETSc.IntType), comm=comm))
    nodes = canonical_nodes(_mesh(space.mesh), degree)
    dolfinx_number = dolfinx_nodes(space, nodes)
    is_free = ~np.concatenate(comm.allgather(constrained)).reshape(-1, 3)[dolfinx_number]
    free = np.flatnonzero(is_free)
    node_mass = node_masses(mass, dolfinx_number)[0]
    unknowns = Unknowns(is_free.size, free)
    cells = quality_of(radius_ratios(nodes.coordinates, nodes.cells))
    body = Body(nodes.coordinates, nodes.drawn_triangles(), unknowns, node_mass, cells=cells)
    whole_nodes = bool((is_free.all(axis=1) == is_free.any(axis=1)).all())
    local_dofs, index_set = rows_here(comm, free.reshape(-1, 3) if whole_nodes else free, dolfinx_number)
    motions = rigid_motions(nodes, node_mass, unknowns)[np.isin(free, local_dofs)]
    return _FreeRows(index_set, body, nodes.coordinates[local_dofs[::3] // 3] if whole_nodes else None, motions)


def _displacement_degree(space: Any) -> int | None:
    """1 or 2 where the space is Lagrange displacements on straight tetrahedra, else None."""
    domain = space.mesh
    if domain.topology.cell_type != CellType.tetrahedron or cell_nodes(domain).shape[1] != 4:
        return None
    for degree in (1, 2):
        if space.ufl_element() == vector_space(domain, degree).ufl_element():
            return degree
    return None


def _mesh(domain: Any) -> Mesh:
    """All tetrahedra of a distributed mesh, on every rank, in an order that does not depend on the ranks."""
    original = input_nodes(domain)
    owned = domain.topology.index_map(3).size_local
    parts = domain.comm.allgather((original, domain.geometry.x, original[cell_nodes(domain)[:owned]]))
    points = np.zeros((max(numbers.max(initial=-1) for numbers, _, _ in parts) + 1, 3))
    for numbers, coordinates, _ in parts:
        points[numbers] = coordinates
    cells = np.sort(np.concatenate([cells for *_, cells in parts]), axis=1)
    cells = oriented(points, cells[np.lexsort(cells.T[::-1])])
    check_filling(points, cells, "the mesh of the forms")
    return Mesh(points, cells, {}, {}, "the mesh of the forms")
