"""What temperatures do: strains that are held back, and the forces of these on all nodes."""

import numpy as np
from mpi4py import MPI
from numpy import ndarray as Array

from fenics_rom.errors import SceneError
from fenics_rom.fem.fibres import point_material, quadrature_points
from fenics_rom.fem.mesh import Mesh
from fenics_rom.fem.nodes import Nodes
from fenics_rom.fem.places import cells_of
from fenics_rom.mechanics.voigt import VOIGT_INDEX
from fenics_rom.scene.expression import evaluated
from fenics_rom.scene.scene import Scene


def thermal_loads(scene: Scene, nodes: Nodes, moduli: Array) -> dict[str, Array]:
    """Forces (3 N, 1), N, of each temperature of a scene with an amplitude of 1; every rank has the whole.

    ∫ C : α T I : ∇δ, also on components that supports hold. What is embedded in the body does not expand.

    Args:
        scene: what acts.
        nodes: of its mesh.
        moduli: λ and μ of every cell, (C, 2), Pa.

    Raises:
        MeshError, SceneError: a place does not exist, a temperature is no number, or strains nothing.
    """
    if not scene.effects.temperature:
        return {}
    points = quadrature_points(scene, nodes, MPI.COMM_SELF)
    material, places = point_material(scene, nodes, points, moduli), points.strain_places
    cells = points.of_cells(points.cells)[: len(places)]
    loads = {}
    for name, strains in thermal_strains(scene, nodes.mesh, cells, places).items():
        θ = np.zeros((6, len(points.weights)))
        θ[:3, : len(places)] = strains
        forces = points.internal_force(material.linear_stress(θ)[VOIGT_INDEX])
        if not forces.any():
            raise SceneError(
                f"{scene.source}: effects.temperature.{name}: strains nothing: its field is 0 in all cells whose "
                "material has an expansion; use a field that is not"
            )
        loads[name] = forces.reshape(-1, 1)
    return loads


def thermal_strains(scene: Scene, mesh: Mesh, cells: Array, places: Array) -> dict[str, Array]:
    """α T (P,) of each temperature with an amplitude of 1, in cells (P,) at places (P, 3), m.

    Raises:
        MeshError, SceneError: a place does not exist, or a temperature is no number.
    """
    strains, expansion = dict[str, Array](), np.zeros(len(mesh.cells))
    for name, material in scene.materials.items() if scene.effects.temperature else ():
        expansion[cells_of(material, mesh, f"{scene.source}: materials.{name}")] = material.expansion or 0.0
    for name, temperature in scene.effects.temperature.items():
        where = f"{scene.source}: effects.temperature.{name}"
        is_there, T = np.zeros(len(mesh.cells), dtype=bool), evaluated(temperature.field, places)
        is_there[cells_of(temperature, mesh, where)] = True
        α = np.where(is_there, expansion, 0.0)[cells]
        if not np.isfinite(T[α != 0]).all():
            bad = places[(α != 0) & ~np.isfinite(T)][0]
            raise SceneError(f"{where}.field = {temperature.field!r}: is no number at {bad.round(6).tolist()}")
        strains[name] = α * np.where(α != 0, T, 0.0)
    return strains
