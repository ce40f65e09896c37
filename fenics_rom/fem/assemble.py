"""Scene to System: linear elasticity by dolfinx, clamped nodes eliminated, in canonical order."""

from dataclasses import replace
from typing import Any

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from fenics_rom.errors import SceneError, check_type
from fenics_rom.fem.assembly_warnings import obstacles_inside, obstacles_too_small, warnings_of
from fenics_rom.fem.body_matrices import BodyMatrices, body_matrices, damping_of_cells, material_of_cells
from fenics_rom.fem.cell_kinds import TETRAHEDRON
from fenics_rom.fem.cell_points import checked_nodes
from fenics_rom.fem.closed_chambers import chambers_of
from fenics_rom.fem.contact_points import contact_points_of, points_between
from fenics_rom.fem.embedded_forces import embedded_forces
from fenics_rom.fem.finite_strain.assemble import assemble_deformation
from fenics_rom.fem.loads import actuators_of, contact_columns, loads_of
from fenics_rom.fem.mesh import Mesh, read_mesh
from fenics_rom.fem.mesh_quality import cell_ratios
from fenics_rom.fem.moving_frame import assemble_frame
from fenics_rom.fem.named_places import named_surfaces
from fenics_rom.fem.nodes import Nodes
from fenics_rom.fem.outputs import output_rows
from fenics_rom.fem.petsc_algebra import PetscAlgebra, require_real
from fenics_rom.fem.places import patch_nodes
from fenics_rom.fem.ranks import run_on_rank_0
from fenics_rom.fem.reactions import asks_for_reactions, reactions_of
from fenics_rom.fem.readings import readings_of
from fenics_rom.fem.rigid_modes import rigid_motions
from fenics_rom.fem.rigid_surfaces import bars_of
from fenics_rom.fem.supports import check_drives, of_whole_nodes, unknowns_of
from fenics_rom.fem.taxels import unreached
from fenics_rom.io.stages import Stages
from fenics_rom.mechanics.body_facts import implausible, quality_of
from fenics_rom.scene.places import given_piece
from fenics_rom.scene.scene import Scene
from fenics_rom.system.body import Body, Unknowns
from fenics_rom.system.moving_frame import WholeNodes, check_motions, with_ties
from fenics_rom.system.rigid_modes import mass_orthonormal, without_energy
from fenics_rom.system.system import System


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
    nodes = run_on_rank_0(comm, lambda: checked_nodes(mesh, scene.degree))
    if scene.integration == "selective" and scene.degree == 1 and mesh.kind is TETRAHEDRON:
        raise SceneError(
            f"{scene.source}: mesh.integration = 'selective': use it with mesh.degree = 2, or of hexahedra, where "
            "cells do not change volume evenly"
        )
    unknowns = unknowns_of(scene, nodes)
    check_drives(scene, nodes)
    scene = replace(scene, bars=tuple(bars_of(scene, nodes)), chambers=chambers_of(scene, nodes, unknowns))
    material, moving = material_of_cells(scene, mesh), scene.environment.is_moving
    mesh_of = comm, mesh, nodes, material
    system, matrices, shared = _with_unknowns(scene, mesh_of, unknowns, unknowns)
    if asks_for_reactions(scene):
        all_components = Unknowns(unknowns.components, np.arange(unknowns.components))
        of_all = _with_unknowns(scene, mesh_of, unknowns, all_components)[1:]
        read = {**system.readings, **reactions_of(scene, nodes, unknowns, system, of_all)}
        system = replace(system, readings={name: read[name] for name in scene.readings})
    said = (*obstacles_too_small(system), *obstacles_inside(system))
    system = replace(system, warnings=(*system.warnings, *said))
    if moving and matrices.frame_masses is not None:
        whole = of_whole_nodes(unknowns)
        is_whole = np.array_equal(whole.free, unknowns.free)
        nodal = system if is_whole else _with_unknowns(scene, mesh_of, unknowns, whole)[0]
        of_body = scene, nodes, unknowns, whole, material[:, :2]
        frame = assemble_frame(*of_body, matrices.frame_masses, shared, nodal.algebra)
        frame = with_ties(frame, *matrices.ties, nodes.coordinates, unknowns, system.algebra)
        check_motions(system.rigid.shape[1], frame.carried, f'{scene.source}: frame = "moving": ')
        if not is_whole:
            held = WholeNodes(nodal, system.algebra, unknowns.matrix[whole.free[nodal.algebra.rows()]])
            nodal = replace(nodal, rigid=held.expand(system.rigid), moving_frame=frame)
            frame = replace(frame, whole=replace(held, system=nodal))
        system = replace(system, moving_frame=frame)
    if scene.effects.large_deformation is None:
        return system

    of_cells = material[:, :2], damping_of_cells(scene, mesh)[:, 1]
    return replace(system, deformation=assemble_deformation(system, nodes, *of_cells, *matrices.external))


def _with_unknowns(
    scene: Scene, mesh_of: tuple[Any, Mesh, Nodes, np.ndarray], unknowns: Unknowns, kept: Unknowns
) -> tuple[System, BodyMatrices, dict[str, np.ndarray]]:
    """The system of unknowns that are kept, its matrices, and what actuators and loads do to all nodes, (3 N, any).

    Args:
        scene: of the system.
        mesh_of: the ranks, the mesh, its nodes, and the material of its cells.
        unknowns: that supports leave.
        kept: these, or more.
    """
    (comm, mesh, nodes, material), effects = mesh_of, scene.effects
    young = {
        "material" if given_piece(m) is None else f"materials.{name}": m.young for name, m in scene.materials.items()
    }
    tied = effects.damped.dashpots and not scene.environment.is_moving  # where a frame moves they are not in D
    is_proportional = not (effects.damped.materials or tied)
    matrices = body_matrices(comm, mesh, nodes, scene, material, kept)
    algebra = PetscAlgebra(comm, matrices.mass.mat.getOwnershipRange())
    rows = algebra.rows()
    actuators, actuator_units = actuators_of(scene, nodes, unknowns)
    loads, load_units = loads_of(scene, nodes, matrices.weight, matrices.translations, material[:, :2], unknowns)
    motions = mass_orthonormal(matrices.mass, rigid_motions(nodes, matrices.node_mass, kept)[rows], algebra)
    rigid = without_energy(matrices.mass, matrices.stiffness, motions, algebra)
    readings = readings_of(scene, nodes, material, kept)
    system = System(
        mass=matrices.mass,
        damping=matrices.damping,
        stiffness=matrices.stiffness,
        contacts={name: kept.restrict(contact_columns(scene, nodes, unknowns, name))[rows] for name in scene.contacts},
        actuators={name: kept.restrict(columns)[rows] for name, columns in actuators.items()},
        loads={name: kept.restrict(columns)[rows] for name, columns in loads.items()},
        units=actuator_units | load_units,
        contact_points=contact_points_of(scene, nodes, unknowns),
        outputs={
            name: output_rows(nodes, output, kept, f"outputs.{name}")[rows] for name, output in scene.outputs.items()
        },
        readings=readings,
        algebra=algebra,
        rayleigh=(effects.damped.alpha, effects.damped.beta) if is_proportional else None,
        springs=None if effects.large_deformation is not None else matrices.external[1],
        rigid=rigid,
        body=Body(
            nodes.coordinates,
            nodes.drawn_triangles(),
            kept,
            matrices.node_mass,
            {name: patch_nodes(nodes, patch, f"contacts.{name}") for name, patch in scene.contacts.items()},
            quality_of(cell_ratios(nodes.coordinates, nodes.cells, nodes.kind)),
            points_between(scene, nodes, unknowns),
            matrices.weight,
            named_surfaces(scene, nodes) if scene.environment.contact_law is not None else {},
        ),
        scene=scene,
        embedded=embedded_forces(scene, nodes),
        warnings=(
            *warnings_of(scene, mesh, rigid),
            *unreached(readings, scene, nodes, kept),
            *implausible(nodes.coordinates, matrices.node_mass.sum(), young),
        ),
    )
    units = actuator_units | load_units
    return system, matrices, {name: units.get(name, 1.0) * columns for name, columns in (actuators | loads).items()}
