"""Scene to System: linear elasticity by dolfinx, clamped nodes eliminated, in canonical order."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem.petsc import assemble_matrix
from mpi4py import MPI
from petsc4py import PETSc

from fenics_rom.errors import MeshError, SceneError, check_known, check_type, exactly
from fenics_rom.fem.attached_masses import attached_masses
from fenics_rom.fem.contact_points import contact_points_of, points_between
from fenics_rom.fem.dolfinx_compat import (
    cell_constants,
    cell_dofs,
    cell_nodes,
    create_tetrahedra,
    input_nodes,
    quiet_compiler,
    vector_space,
)
from fenics_rom.fem.finite_strain.assemble import assemble_deformation
from fenics_rom.fem.loads import actuators_of, loads_of
from fenics_rom.fem.mesh import Mesh, read_mesh
from fenics_rom.fem.mesh_quality import radius_ratios
from fenics_rom.fem.moving_frame import assemble_frame, frame_origin, mass_times
from fenics_rom.fem.nodes import CELL_EDGES, Nodes, canonical_nodes, patch_columns, patch_nodes
from fenics_rom.fem.outputs import output_rows
from fenics_rom.fem.petsc_algebra import PetscAlgebra, require_real
from fenics_rom.fem.petsc_matrix import PetscMatrix, ZeroMatrix, combination
from fenics_rom.fem.ranks import run_on_rank_0
from fenics_rom.fem.readings import readings_of
from fenics_rom.fem.restriction import restrict_matrices
from fenics_rom.fem.rigid_modes import rigid_motions
from fenics_rom.fem.springs import dashpots_of, springs_of, with_attached
from fenics_rom.fem.supports import unknowns_of
from fenics_rom.io.stages import Stages
from fenics_rom.mechanics.body_facts import implausible, quality_of
from fenics_rom.mechanics.hyperelastic import strain_of_excess_damping
from fenics_rom.mechanics.obstacles import smallest_radius
from fenics_rom.scene.scene import Scene
from fenics_rom.system.body import Body, Unknowns
from fenics_rom.system.moving_frame import check_motions
from fenics_rom.system.rigid_modes import mass_orthonormal, without_energy
from fenics_rom.system.system import System

SMALL_STRAIN = 0.05  # what bends a body far strains it by, at least
STRAIGHT = 1e-6  # share of the body's length that the middle of an edge may be off, as files hold few digits


def assemble(scene: Scene, comm: Any = None) -> System:
    """Assembles the full-order model of a scene; every rank of `comm` must call it.

    Args:
        scene: what to assemble.
        comm: an mpi4py communicator, MPI.COMM_WORLD where None.

    Raises:
        MeshError: the mesh cannot be used or lacks a group.
        SceneError: the scene asks for something this body does not have.
        SolverError: PETSc is a complex-valued build.

    Example:
        >>> fr.assemble(fr.read_scene("plate.toml")).size  # unknowns
        180
    """
    check_type("assemble", scene, Scene, "fr.read_scene(file)")
    require_real(PETSc.ScalarType)
    comm = MPI.COMM_WORLD if comm is None else comm
    stages = Stages(lambda value: comm.allreduce(value, MPI.MAX))
    with stages("assembly"):
        system = _system(scene, comm)
    return replace(system, stages=stages.done)


def _system(scene: Scene, comm: Any) -> System:
    mesh = run_on_rank_0(comm, lambda: read_mesh(scene.mesh_file, scene.mesh_groups, scene.mesh_scale))
    nodes = run_on_rank_0(comm, lambda: canonical_nodes(mesh, scene.degree))
    unknowns = unknowns_of(scene, nodes)
    if unknowns.weights is not None and scene.effects.large_deformation is not None:
        raise SceneError(
            f"{scene.source}: supports.held: with large deformation the normal of a roller or plane of symmetry is "
            "allowed along an axis only; turn the mesh"
        )
    material, effects = _material_of_cells(scene, mesh), scene.effects
    young = {"material" if m.cells is None else f"materials.{name}": m.young for name, m in scene.materials.items()}
    is_proportional = not (effects.damped.materials or effects.damped.dashpots)

    matrices = _matrices(comm, mesh, nodes, scene, material, unknowns)
    algebra = PetscAlgebra(comm, matrices.mass.mat.getOwnershipRange())
    rows = algebra.rows()
    actuators, actuator_units = actuators_of(scene, nodes, unknowns)
    loads, load_units = loads_of(scene, nodes, matrices.weight, matrices.translations, unknowns)
    motions = mass_orthonormal(matrices.mass, rigid_motions(nodes, matrices.node_mass, unknowns)[rows], algebra)
    rigid = without_energy(matrices.mass, matrices.stiffness, motions, algebra)
    system = System(
        mass=matrices.mass,
        damping=matrices.damping,
        stiffness=matrices.stiffness,
        contacts={
            name: unknowns.restrict(patch_columns(nodes, patch, unknowns, f"contacts.{name}"))[rows]
            for name, patch in scene.contacts.items()
        },
        actuators={name: unknowns.restrict(columns)[rows] for name, columns in actuators.items()},
        loads={name: unknowns.restrict(columns)[rows] for name, columns in loads.items()},
        units=actuator_units | load_units,
        contact_points=contact_points_of(scene, nodes, unknowns),
        outputs={
            name: output_rows(nodes, output, unknowns, f"outputs.{name}")[rows]
            for name, output in scene.outputs.items()
        },
        readings=readings_of(scene, nodes, material, unknowns),
        algebra=algebra,
        rayleigh=(effects.damped.alpha, effects.damped.beta) if is_proportional else None,
        rigid=rigid,
        body=Body(
            nodes.coordinates,
            nodes.drawn_triangles(),
            unknowns,
            matrices.node_mass,
            {name: patch_nodes(nodes, patch, f"contacts.{name}") for name, patch in scene.contacts.items()},
            quality_of(radius_ratios(nodes.coordinates, nodes.cells)),
            points_between(scene, nodes, unknowns),
            matrices.weight,
        ),
        scene=scene,
        warnings=(*_warnings(scene, mesh, rigid), *implausible(nodes.coordinates, matrices.node_mass.sum(), young)),
    )
    system = replace(system, warnings=(*system.warnings, *_obstacles_too_small(system)))
    if matrices.frame_masses is not None:
        shared = {name: system.units.get(name, 1.0) * columns for name, columns in (actuators | loads).items()}
        frame = assemble_frame(scene, nodes, unknowns, material[:, :2], matrices.frame_masses, shared, algebra)
        check_motions(rigid.shape[1], frame.carried, f'{scene.source}: frame = "moving": ')
        system = replace(system, moving_frame=frame)
    if effects.large_deformation is None:
        return system

    def cell_properties(cells: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return material[cells, 0], material[cells, 1], _damping_of_cells(scene, mesh)[cells, 1]

    D, K = matrices.external_damping, matrices.spring
    return replace(system, deformation=assemble_deformation(system, nodes, cell_properties, D, K))


def _warnings(scene: Scene, mesh: Mesh, rigid: np.ndarray) -> Iterator[str]:
    """Of elements that lock, and of supports: whoever clamps a body may not know that some of it still moves freely."""
    if mesh.straightened > STRAIGHT * np.ptp(mesh.points, axis=0).max():
        yield (
            f"curved edges of second-order cells were made straight: nodes on them are up to {mesh.straightened:.3g} m "
            "off; a finer mesh follows the curve"
        )
    stiffest = max(material.poisson for material in scene.materials.values())
    if scene.degree == 1 and stiffest > 0.45:
        yield (
            f"Poisson's ratio {exactly(stiffest)} on degree 1 tetrahedra: they lock (too stiff, in bending most of "
            "all); mesh.degree = 2 is the cure"
        )
    if scene.degree == 2 and scene.integration == "full" and stiffest > 0.49:
        yield (
            f"Poisson's ratio {exactly(stiffest)} on degree 2 tetrahedra: they are too stiff, and their pressure "
            'oscillates; mesh.integration = "selective" is the cure'
        )
    yield from _overdamped(scene)
    if (scene.clamped or scene.held) and rigid.shape[1]:
        yield f"supports leave {rigid.shape[1]} rigid motions: the body, or a part of it, is not wholly held"


def _overdamped(scene: Scene) -> Iterator[str]:
    """Of materials whose viscosity resists what it takes for changes of volume, where their elasticity has none."""
    effects = scene.effects
    if effects.large_deformation is None or effects.large_deformation.law == "st_venant_kirchhoff":
        return
    for name, material in scene.materials.items():
        damping = effects.damped.materials.get(name, effects.damped)
        strain = strain_of_excess_damping(material.poisson)
        if strain < SMALL_STRAIN and (damping.beta or effects.viscoelasticity is not None):
            yield (
                f"materials.{name}: with Poisson's ratio {exactly(material.poisson)} it is damped by a tenth more than "
                f"effects say where it is strained by {100 * strain:.2g} %, and by the strain's square, as damping "
                "acts on Green's strain; st_venant_kirchhoff as large_deformation.material is free of it"
            )


def _obstacles_too_small(system: System) -> list[str]:
    """What to say of obstacles that pass between contact points, or did before there were more of them."""
    if not system.contact_points or system.scene is None:
        return []
    body = system.body
    if body.points_between is not None:
        return [
            f"contact: {len(body.points_between.nodes)} points between nodes can be touched, as an obstacle fits in "
            "there; what it presses in is narrower than an element: a finer mesh at the contact surface shows it"
        ]
    radii = {name: smallest_radius(of.shape) for name, of in system.scene.environment.obstacles.items()}
    passing = system.points_of_contact().describe_passing(radii, body.triangles, body.nodes)
    return [passing] if passing else []


def _material_of_cells(scene: Scene, mesh: Mesh) -> np.ndarray:
    """λ, μ (Pa) and ρ (kg/m3) of every cell of the mesh file, (C, 3)."""
    values = np.full((len(mesh.cells), 3), np.nan)
    for name, m in scene.materials.items():
        cells = slice(None) if m.cells is None else mesh.region(m.cells)
        if not np.isnan(values[cells]).all():
            raise SceneError(f"{scene.source}: materials.{name}: some cells of {m.cells!r} already have a material")
        shear = m.young / (2 * (1 + m.poisson))
        values[cells] = 2 * shear * m.poisson / (1 - 2 * m.poisson), shear, m.density
    unassigned = np.isnan(values[:, 0])
    if unassigned.any():
        raise SceneError(f"{scene.source}: materials: {unassigned.sum()} of {len(unassigned)} cells have no material")
    return values


@dataclass(frozen=True)
class _Matrices:
    """What dolfinx and surfaces make of a scene.

    Attributes:
        mass, damping, stiffness: on the unknowns.
        node_mass: (N,) as in Body.
        weight: (N,) kg, what weighs at each node: ∫ρ of its shape function, and what is fixed to the body.
        translations: (3 N, 3) kg, M times unit translations: as the weight, but for weights on threads.
        external_damping, spring: for large deformation, what of D and K does not strain the body; None: nothing.
        frame_masses: for a moving frame, as `assemble_frame` takes them; None: it does not move.
    """

    mass: PetscMatrix
    damping: PetscMatrix | ZeroMatrix
    stiffness: PetscMatrix
    node_mass: np.ndarray
    weight: np.ndarray
    translations: np.ndarray
    external_damping: PetscMatrix | None
    spring: PetscMatrix | None
    frame_masses: tuple[np.ndarray, ...] | None


@quiet_compiler()
def _matrices(comm: Any, mesh: Mesh, nodes: Nodes, scene: Scene, material: np.ndarray, unknowns: Unknowns) -> _Matrices:
    root = comm.rank == 0
    domain = create_tetrahedra(
        comm, mesh.cells if root else np.empty((0, 4)), mesh.points if root else np.empty((0, 3))
    )
    space = vector_space(domain, scene.degree)
    λ, μ, ρ = (_cell_function(domain, column) for column in material.T)

    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    ε_u, ε_v = ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))
    stress = λ * ufl.tr(ε_u) * ufl.Identity(3) + 2 * μ * ε_u
    inertia, elasticity = ρ * ufl.inner(u, v), ufl.inner(stress, ε_v)
    selective = scene.integration == "selective"
    if selective:  # as QuadraturePoints
        elasticity, dilation = 2 * μ * ufl.inner(ε_u, ε_v), λ * ufl.tr(ε_u) * ufl.tr(ε_v)
    middle = ufl.dx(metadata={"quadrature_degree": 1})
    forms = {"mass": inertia * ufl.dx, "stiffness": elasticity * ufl.dx}
    if selective:
        forms["stiffness"] += dilation * middle
    if scene.effects.damped.materials:
        α, β = (_cell_function(domain, column) for column in _damping_of_cells(scene, mesh).T)
        forms["damping"] = (α * inertia + β * elasticity) * ufl.dx
        if selective:
            forms["damping"] += β * dilation * middle
        if scene.effects.large_deformation is not None:
            forms["external_damping"] = α * inertia * ufl.dx
    full = {name: assemble_form(form) for name, form in forms.items()}

    dolfinx_number = dolfinx_nodes(space, scene.degree, nodes)
    node_mass, translated = node_masses(full["mass"], dolfinx_number)
    frame_masses = None
    if scene.environment.is_moving:
        origin = frame_origin(scene, nodes, unknowns, translated)
        frame_masses = translated, mass_times(full["mass"], nodes.coordinates - origin, dolfinx_number), origin
    reduced = restrict_matrices(full, unknowns, dolfinx_number, nodes.coordinates)
    α, β = scene.effects.damped.alpha, scene.effects.damped.beta
    springs, dashpots = springs_of(scene, nodes), dashpots_of(scene, nodes)
    damped_springs = β * springs if β and springs is not None else None
    fixed, weight = attached_masses(scene, nodes)
    mass, stiffness = (
        with_attached(reduced["mass"], fixed, unknowns),
        with_attached(reduced["stiffness"], springs, unknowns),
    )

    def total(*terms: tuple[float, PetscMatrix]) -> PetscMatrix | None:
        present = [(coefficient, matrix) for coefficient, matrix in terms if coefficient]
        return PetscMatrix(combination(*present)) if present else None

    def added(to: PetscMatrix | None, surfaces: Any) -> PetscMatrix | None:
        if surfaces is None:
            return to
        return with_attached(PetscMatrix(combination((0.0, mass))) if to is None else to, surfaces, unknowns)

    if "damping" in reduced:  # K has the springs in it already, what is damped by material has not
        damping = added(added(reduced["damping"], damped_springs), dashpots)
    else:
        damping = added(total((α, mass), (β, stiffness)), dashpots)
    external_damping = spring = None
    if scene.effects.large_deformation is not None:
        external_damping = added(reduced.get("external_damping") or total((α, mass)), damped_springs)
        external_damping, spring = added(external_damping, dashpots), added(None, springs)
    whole = mass, damping or ZeroMatrix(), stiffness
    unit = np.eye(3)
    translations = np.kron(translated[:, None], unit)
    if fixed is not None:
        translations += fixed @ np.tile(unit, (len(translated), 1))
    loaded = node_mass, translated + weight, translations
    return _Matrices(*whole, *loaded, external_damping, spring, frame_masses)


def _damping_of_cells(scene: Scene, mesh: Mesh) -> np.ndarray:
    """α (1/s) and β (s) of every cell of the mesh file, (C, 2)."""
    rayleigh = scene.effects.damped
    values = np.tile([rayleigh.alpha, rayleigh.beta], (len(mesh.cells), 1))
    for name, of_material in scene.effects.damped.materials.items():
        check_known("material", name, scene.materials, SceneError, f"{scene.source}: effects.damping.materials: ")
        cells = scene.materials[name].cells
        values[slice(None) if cells is None else mesh.region(cells)] = of_material.alpha, of_material.beta
    return values


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


def dolfinx_nodes(space: Any, degree: int, nodes: Nodes) -> np.ndarray:
    """Global dolfinx number of every canonical node."""
    domain, dofs = space.mesh, cell_dofs(space)
    index_map = space.dofmap.index_map
    points = input_nodes(domain)[cell_nodes(domain)]
    keys = np.full((index_map.size_local + index_map.num_ghosts, 2), -1, dtype=np.int64)
    keys[dofs[:, :4].ravel(), 0] = points.ravel()
    if degree == 2:
        keys[dofs[:, 4:].ravel()] = np.sort(points[:, CELL_EDGES], axis=2).reshape(-1, 2)
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
