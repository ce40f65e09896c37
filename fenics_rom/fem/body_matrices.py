"""The matrices M, D and K of a scene: linear elasticity by dolfinx, and what is on surfaces, on the unknowns."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse
import ufl
from dolfinx import fem
from dolfinx.fem.petsc import assemble_matrix
from mpi4py import MPI
from petsc4py import PETSc

from fenics_rom.errors import MeshError, SceneError, check_known
from fenics_rom.fem.attached_masses import attached_masses
from fenics_rom.fem.cell_points import quadrature_rule
from fenics_rom.fem.dolfinx_compat import (
    cell_constants,
    cell_dofs,
    cell_nodes,
    create_cells,
    input_nodes,
    quiet_compiler,
    vector_space,
)
from fenics_rom.fem.fibres import fibre_stiffness
from fenics_rom.fem.finite_strain.quadrature import QuadraturePoints
from fenics_rom.fem.mesh import Mesh
from fenics_rom.fem.moving_frame import frame_origin, mass_times
from fenics_rom.fem.nodal_matrix import by_nodes
from fenics_rom.fem.nodes import Nodes
from fenics_rom.fem.petsc_matrix import MatrixSum, PetscMatrix, ZeroMatrix, combination
from fenics_rom.fem.places import cells_of
from fenics_rom.fem.restriction import restrict_matrices
from fenics_rom.fem.springs import dashpots_of, of_components, sliding_springs_of, springs_of, summed, with_attached
from fenics_rom.scene.scene import Scene
from fenics_rom.system.body import Unknowns


@dataclass(frozen=True)
class BodyMatrices:
    """What dolfinx and surfaces make of a scene.

    Attributes:
        mass, damping, stiffness: on the unknowns.
        node_mass: (N,) as in Body.
        weight: (N,) kg, what weighs at each node: ∫ρ of its shape function, and what is fixed to the body.
        translations: (3 N, 3) kg, M times unit translations: as the weight, but for weights on threads.
        external: for large deformation, what of D and K does not strain the body, and what of that D is within a moving
            frame; of a material that relaxes the second, too; None: nothing.
        frame_masses: for a moving frame, as `assemble_frame` takes them; None: it does not move.
        ties: stiffness and damping of a moving frame's springs and dashpots to ground, which are in neither K nor D, of
            all nodes (N, N), N/m and N s/m; None where there are none.
    """

    mass: PetscMatrix
    damping: PetscMatrix | MatrixSum | ZeroMatrix
    stiffness: PetscMatrix
    node_mass: np.ndarray
    weight: np.ndarray
    translations: np.ndarray
    external: tuple[PetscMatrix | None, ...]
    frame_masses: tuple[np.ndarray, ...] | None
    ties: tuple[Any, Any]


@quiet_compiler()
def body_matrices(
    comm: Any, mesh: Mesh, nodes: Nodes, scene: Scene, material: np.ndarray, unknowns: Unknowns
) -> BodyMatrices:
    """The matrices of a scene; every rank must call it.

    Args:
        comm: of the ranks that share the cells.
        mesh: as read, on rank 0.
        nodes: in canonical order.
        scene: whose effects are in the matrices.
        material: of each cell, as of `material_of_cells`.
        unknowns: that supports leave.
    """
    space = displacement_space(comm, nodes)
    rule = quadrature_rule(nodes)
    in_forms = nodes.is_straight  # where one point is the mean over a cell
    full = {name: assemble_form(form) for name, form in _forms(space, scene, mesh, material, rule, in_forms).items()}

    dolfinx_number = dolfinx_nodes(space, nodes)
    node_mass, translated = node_masses(full["mass"], dolfinx_number)
    springs, dashpots = springs_of(scene, nodes), dashpots_of(scene, nodes)
    (fixed, weight), frame_masses, ties = attached_masses(scene, nodes), None, (None, None)
    if scene.environment.is_moving:
        ties = springs, _with_springs(dashpots, springs, scene)
        frame_masses = _frame_masses(scene, nodes, full["mass"], translated, fixed, dolfinx_number)
    reduced = restrict_matrices(full, unknowns, dolfinx_number, nodes.coordinates)
    if scene.integration == "selective" and not in_forms:
        points = QuadraturePoints(nodes, MPI.COMM_SELF, selective=True)
        λ, _ = points.shared_moduli(*(points.of_cells(column) for column in material[:, :2].T))
        of_volume = {"stiffness": λ, "damping": λ * points.of_cells(damping_of_cells(scene, mesh)[:, 1])}
        for name in of_volume.keys() & reduced.keys():
            reduced[name] = with_attached(reduced[name], points.dilation_stiffness(of_volume[name]), unknowns)
    reduced["mass"] = by_nodes(with_attached(reduced["mass"], fixed, unknowns))
    springs, dashpots = summed([of_components(springs), sliding_springs_of(scene, nodes)]), of_components(dashpots)
    on_body = None if scene.environment.is_moving else springs
    reduced["stiffness"] = with_attached(reduced["stiffness"], on_body, unknowns)
    if (of_fibres := fibre_stiffness(scene, nodes, material[:, :2], damping_of_cells(scene, mesh)[:, 1])) is not None:
        reduced["stiffness"] = with_attached(reduced["stiffness"], of_fibres[0], unknowns)
        if "damping" in reduced:
            reduced["damping"] = with_attached(reduced["damping"], of_fibres[1], unknowns)
    damping, external = _dampings(scene, reduced, springs, dashpots, unknowns)
    unit = np.eye(3)
    translations = np.kron(translated[:, None], unit)
    if fixed is not None:
        translations += fixed @ np.tile(unit, (len(translated), 1))
    whole = reduced["mass"], damping or ZeroMatrix(), reduced["stiffness"]
    loaded = node_mass, translated + weight, translations
    return BodyMatrices(*whole, *loaded, external, frame_masses, ties)


def _frame_masses(
    scene: Scene, nodes: Nodes, mass: PETSc.Mat, translated: np.ndarray, fixed: Any, dolfinx_number: np.ndarray
) -> tuple[np.ndarray, ...]:
    """`frame_masses` of M with all degrees of freedom, and of what is fixed to the body."""
    of_nodes = scipy.sparse.csr_matrix((len(translated),) * 2) if fixed is None else fixed[::3, ::3]
    translated = translated + of_nodes @ np.ones(len(translated))
    origin = frame_origin(scene, nodes, translated)
    arms = nodes.coordinates - origin
    return translated, mass_times(mass, arms, dolfinx_number) + of_nodes @ arms, origin


def _forms(
    space: Any, scene: Scene, mesh: Mesh, material: np.ndarray, rule: tuple[int, int, int], dilates: bool
) -> dict[str, Any]:
    """Weak forms of M and K; where materials damp each in its way of D, and what of it strains nothing.

    `rule` as of `quadrature_rule`; `dilates`: whether changes of volume that are integrated selectively are in them.
    """
    of_strain, of_mass, of_dilation = (ufl.dx(metadata={"quadrature_degree": degree}) for degree in rule)
    λ, μ, ρ = (_cell_function(space.mesh, column) for column in material.T)
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    ε_u, ε_v = ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))
    inertia, dilation = ρ * ufl.inner(u, v), λ * ufl.tr(ε_u) * ufl.tr(ε_v)
    stress = λ * ufl.tr(ε_u) * ufl.Identity(3) + 2 * μ * ε_u
    selective = scene.integration == "selective"
    elasticity = 2 * μ * ufl.inner(ε_u, ε_v) if selective else ufl.inner(stress, ε_v)
    forms = {"mass": inertia * of_mass, "stiffness": elasticity * of_strain}
    if selective and dilates:
        forms["stiffness"] += dilation * of_dilation
    if scene.effects.damped.materials:
        α, β = (_cell_function(space.mesh, column) for column in damping_of_cells(scene, mesh).T)
        forms["damping"] = α * inertia * of_mass + β * elasticity * of_strain
        if selective and dilates:
            forms["damping"] += β * dilation * of_dilation
        if scene.effects.large_deformation is not None:
            forms["external_damping"] = α * inertia * of_mass
    return forms


def _with_springs(dashpots: Any, springs: Any, scene: Scene) -> Any:
    """The damping of dashpots and, as springs are damped as the body is, of springs."""
    if springs is None or not scene.effects.damped.beta:
        return dashpots
    of_springs = scene.effects.damped.beta * springs
    return of_springs if dashpots is None else dashpots + of_springs


def _dampings(
    scene: Scene, reduced: dict[str, PetscMatrix], springs: Any, dashpots: Any, unknowns: Unknowns
) -> tuple[PetscMatrix | MatrixSum | None, tuple[PetscMatrix | None, ...]]:
    """D = α M + β K with springs and dashpots; for large deformation also what of D and K does not strain the body.

    That is D with springs and dashpots to the ground, their K, and of a body in a moving frame, which has these in no
    D and K of its own, what of that D is within the frame.
    """
    mass, stiffness, moving = reduced["mass"], reduced["stiffness"], scene.environment.is_moving
    α, β = scene.effects.damped.alpha, scene.effects.damped.beta
    damped_springs = β * springs if β and springs is not None else None

    def total(*terms: tuple[float, PetscMatrix]) -> PetscMatrix | None:
        present = [(coefficient, matrix) for coefficient, matrix in terms if coefficient]
        return PetscMatrix(combination(*present)) if present else None

    proportional = [(coefficient, matrix) for coefficient, matrix in ((α, mass), (β, stiffness)) if coefficient]

    def added(to: PetscMatrix | None, surfaces: Any) -> PetscMatrix | None:
        if surfaces is None:
            return to
        return with_attached(PetscMatrix(combination((0.0, mass))) if to is None else to, surfaces, unknowns)

    of_springs, of_dashpots = (None, None) if moving else (damped_springs, dashpots)
    if "damping" in reduced:  # K has the springs in it already, what is damped by material has not
        damping: PetscMatrix | MatrixSum | None = added(added(reduced["damping"], of_springs), of_dashpots)
    elif of_dashpots is None:
        damping = MatrixSum(*proportional) if proportional else None
    else:
        damping = added(total(*proportional), of_dashpots)
    if scene.effects.large_deformation is None:
        relaxes = scene.effects.viscoelasticity is not None and not moving
        return damping, (None, added(None, springs) if relaxes else None, None)
    external = reduced.get("external_damping") or total((α, mass))
    within = total((1.0, external)) if moving and external is not None else None
    return damping, (added(added(external, damped_springs), dashpots), added(None, springs), within)


def material_of_cells(scene: Scene, mesh: Mesh) -> np.ndarray:
    """λ, μ (Pa) and ρ (kg/m3) of every cell of the mesh file, (C, 3)."""
    values = np.full((len(mesh.cells), 3), np.nan)
    for name, m in scene.materials.items():
        cells = cells_of(scene.materials[name], mesh, f"{scene.source}: materials.{name}")
        if not np.isnan(values[cells]).all():
            shared = np.count_nonzero(~np.isnan(values[cells][:, 0]))
            raise SceneError(f"{scene.source}: materials.{name}: {shared} of its cells already have a material")
        shear = m.young / (2 * (1 + m.poisson))
        values[cells] = 2 * shear * m.poisson / (1 - 2 * m.poisson), shear, m.density
    unassigned = np.isnan(values[:, 0])
    if unassigned.any():
        raise SceneError(f"{scene.source}: materials: {unassigned.sum()} of {len(unassigned)} cells have no material")
    return values


def damping_of_cells(scene: Scene, mesh: Mesh) -> np.ndarray:
    """α (1/s) and β (s) of every cell of the mesh file, (C, 2)."""
    rayleigh = scene.effects.damped
    values = np.tile([rayleigh.alpha, rayleigh.beta], (len(mesh.cells), 1))
    for name, of_material in scene.effects.damped.materials.items():
        check_known("material", name, scene.materials, SceneError, f"{scene.source}: effects.damping.materials: ")
        values[cells_of(scene.materials[name], mesh, f"{scene.source}: materials.{name}")] = (
            of_material.alpha,
            of_material.beta,
        )
    return values


def displacement_space(comm: Any, nodes: Nodes) -> Any:
    """The space of dolfinx whose nodes these are."""
    mesh, degree = nodes.mesh, 2 if nodes.is_curved else 1
    cells, points = (nodes.cell_nodes, nodes.coordinates) if nodes.is_curved else (mesh.cells, mesh.points)
    arrays = (cells, points) if comm.rank == 0 else (cells[:0], points[:0])
    return vector_space(create_cells(comm, *arrays, mesh.kind.name, degree), nodes.degree)


def assemble_form(form: Any) -> PETSc.Mat:
    """The matrix of a bilinear form, with all degrees of freedom."""
    matrix = assemble_matrix(fem.form(form))
    matrix.assemble()
    return matrix


def _cell_function(domain: Any, values: np.ndarray) -> Any:
    function = fem.Function(cell_constants(domain))
    original = np.asarray(domain.topology.original_cell_index, dtype=np.int64)
    dofs = cell_dofs(function.function_space).ravel()
    function.x.array[dofs] = values[original[: len(dofs)]]
    function.x.scatter_forward()
    return function


def dolfinx_nodes(space: Any, nodes: Nodes) -> np.ndarray:
    """Global dolfinx number of every canonical node; the mesh is of the file's points, or of all nodes if curved."""
    domain, dofs = space.mesh, cell_dofs(space)
    index_map = space.dofmap.index_map
    points = input_nodes(domain)[cell_nodes(domain)]
    keys = np.full((index_map.size_local + index_map.num_ghosts, 2), -1, dtype=np.int64)
    if nodes.is_curved:
        keys[dofs.ravel()] = nodes.keys[points.ravel()]
    else:
        vertices = points.shape[1]
        keys[dofs[:, :vertices].ravel(), 0] = points.ravel()
        if nodes.degree == 2:
            keys[dofs[:, vertices:].ravel()] = nodes.kind.middles(points).reshape(-1, 2)
    keys = np.concatenate(domain.comm.allgather(keys[: index_map.size_local]))
    order = np.lexsort((keys[:, 1], keys[:, 0], keys[:, 1] >= 0))
    if not np.array_equal(keys[order], nodes.keys):
        raise MeshError(f"{nodes.mesh.source}: dolfinx numbers other nodes than the mesh file has")
    return order


def node_masses(mass: PETSc.Mat, dolfinx_number: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two masses of each node (N,), kg, whose sums are the body's.

    The diagonal of M, scaled to it; and ∫ρ of each shape function, which is M times a unit translation.
    """
    ones, diagonal = mass.createVecRight(), mass.getDiagonal()
    product = ones.duplicate()
    ones.set(1.0)
    mass.mult(ones, product)
    local = np.stack([vector.array.reshape(-1, 3)[:, 0] for vector in (diagonal, product)], axis=1)
    for vector in (ones, diagonal, product):
        vector.destroy()
    values, translated = np.concatenate(mass.comm.tompi4py().allgather(local))[dolfinx_number].T
    return values * (translated.sum() / values.sum()), translated.copy()
