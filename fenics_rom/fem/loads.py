"""Input columns of the effects that act as forces, each for a total of 1 N, and what 1 of its unit is worth in N.

They are on the components of all nodes, also of those that supports hold. A column's unit must not decide how much of
it a reduced basis knows: pascals and newtons are reduced as equals.
"""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import SceneError
from fenics_rom.fem.cell_points import shape_functions
from fenics_rom.fem.facets import facet_integrals, mean_over
from fenics_rom.fem.nodes import Nodes, rim_edges
from fenics_rom.fem.places import patch_area, patch_nodes, patch_triangles
from fenics_rom.fem.rigid_surfaces import bars_of
from fenics_rom.fem.supports import borne_by_base, support_column
from fenics_rom.fem.temperature import thermal_loads
from fenics_rom.mechanics.gas import GAS_CONTROLS
from fenics_rom.mechanics.surface_points import mean_turning_maps
from fenics_rom.mechanics.tendon import measure_segments, unit_tension_forces
from fenics_rom.scene.effects import Pressure
from fenics_rom.scene.places import Patch
from fenics_rom.scene.scene import Scene
from fenics_rom.system.body import Unknowns

Columns = dict[str, Array]
MIN_PIECE_SHARE = 1e-9  # of a piece of a tendon in its length


def actuators_of(scene: Scene, nodes: Nodes, unknowns: Unknowns) -> tuple[Columns, dict[str, float]]:
    """Columns (3 N, columns) and units of actuators: the scene's, pressures (Pa), tendons and driven supports (N)."""
    columns = {
        name: patch_columns(nodes, patch, unknowns, f"actuators.{name}") for name, patch in scene.actuators.items()
    }
    units: dict[str, float] = {}
    for name, pressure in scene.effects.pressure.items():
        where = f"effects.pressure.{name}"
        columns[name] = patch_columns(nodes, pressure.patch("normal"), unknowns, where)
        is_free = scene.environment.is_moving and not (scene.clamped or scene.held)
        if is_free and pressure.control in ("volume", *GAS_CONTROLS):
            _refuse_open(nodes, pressure, where)
        units[name] = patch_area(nodes, pressure, where)
    for name, tendon in scene.effects.tendon.items():
        where, units[name] = f"effects.tendon.{name}", 1.0
        columns[name] = _cable(nodes, np.array(tendon.points), where)
        _refuse_nothing(columns[name], unknowns, where)
    for name, support in scene.effects.driven_support.items():
        where, units[name] = f"effects.driven_support.{name}", 1.0
        columns[name] = support_column(nodes, support, where)
        _refuse_nothing(columns[name], unknowns, where)
        if scene.environment.is_moving:  # what drives it is on the base
            columns[name] = columns[name] + borne_by_base(nodes, unknowns, columns[name])
    return columns, units


def loads_of(
    scene: Scene, nodes: Nodes, weight: Array, translations: Array, moduli: Array, unknowns: Unknowns
) -> tuple[Columns, dict[str, float]]:
    """Columns (3 N, columns) and units of loads with signals of their own, in the order of `load_columns`.

    Gravity in multiples of its acceleration, base motions (m/s²), prescribed forces (N), multiples of temperatures;
    `weight` (N,), kg, is what weighs at each node, `translations` (3 N, 3), kg, M times unit translations, and `moduli`
    λ and μ of every cell, (C, 2), Pa.
    """
    columns: Columns = {}
    units: dict[str, float] = {}
    mass = float(weight.sum())

    if scene.effects.gravity is not None:
        g = np.array(scene.effects.gravity.acceleration)
        size = float(np.linalg.norm(g))
        if size == 0:
            raise SceneError("effects.gravity.acceleration is zero; leave gravity out instead")
        columns["gravity"] = np.kron(weight / mass, g / size)[:, None]
        units["gravity"] = mass * size
    for name, motion in scene.effects.base_motion.items():
        direction = np.array(motion.direction)
        unit = direction / np.linalg.norm(direction)
        columns[name], units[name] = translations @ -unit[:, None] / mass, mass
    for name, force in scene.effects.prescribed.items():
        where, units[name] = f"effects.prescribed.{name}", 1.0
        if force.point is not None:
            columns[name] = np.kron(shape_functions(nodes, np.array(force.point), where)[:, None], np.eye(3))
            _refuse_nothing(columns[name], unknowns, where)
        else:
            columns[name] = patch_columns(nodes, force.patch("resultant"), unknowns, where)
    for name, forces in thermal_loads(scene, nodes, moduli).items():
        units[name] = float(np.abs(forces).sum())
        columns[name] = forces / units[name]
    for name, tendon in scene.effects.tendon.items() if scene.effects.tendon_friction is not None else ():
        points, where = np.array(tendon.points), f"effects.tendon.{name}"
        for number in range(1, len(points) - 1):  # friction at a guide changes the tension from there to the anchor
            columns[f"{name}-guide-{number}"] = _cable(nodes, points[: number + 1], where)
            units[f"{name}-guide-{number}"] = 1.0
    for name, ends in bars_of(scene, nodes).items():
        pulled = np.zeros_like(nodes.coordinates)
        pulled[ends] = unit_tension_forces(nodes.coordinates[ends])
        columns[name], units[name] = pulled.reshape(-1, 1), 1.0
    return columns, units


def _refuse_open(nodes: Nodes, pressure: Pressure, where: str) -> None:
    """Refuses what a free body is to sweep with an open surface: it does so by every motion as a whole."""
    if len(rim_edges(patch_triangles(nodes, pressure, where))):
        raise SceneError(
            f"{where}.control = {pressure.control!r}: the surface has an opening, so that a free body has no volume "
            "behind it that its motion as a whole would leave; use a closed chamber, or 'pressure'"
        )


def _cable(nodes: Nodes, points: Array, where: str) -> Array:
    """Forces (3 N, 1) of a cable under 1 N: at each end towards its neighbour, at a guide towards both."""
    _, lengths = measure_segments(points)
    if (lengths <= MIN_PIECE_SHARE * lengths.sum()).any():
        raise SceneError(f"{where}.points: two that follow one another are the same point")
    shapes = [shape_functions(nodes, point, f"{where}.points") for point in points]
    return (np.array(shapes).T @ unit_tension_forces(points)).reshape(-1, 1)


def _refuse_nothing(columns: Array, unknowns: Unknowns, where: str) -> None:
    if not np.any(unknowns.restrict(columns)):
        raise SceneError(f"{where}: acts on nothing that can move")


def contact_columns(scene: Scene, nodes: Nodes, unknowns: Unknowns, contact: str) -> Array:
    """Columns of the input matrix of a contact mode, on the components of all nodes, (3 N, columns)."""
    parts = scene.contacts[contact].together or (contact,)
    return np.hstack([patch_columns(nodes, scene.contacts[name], unknowns, f"contacts.{name}") for name in parts])


def patch_columns(nodes: Nodes, patch: Patch, unknowns: Unknowns, where: str) -> Array:
    """Columns of the input matrix of a patch, on the components of all nodes, (3 N, columns).

    Refuses a patch that cannot move; messages call it `where`.
    """
    triangles = patch_triangles(nodes, patch, where)
    if patch.force == "normal":
        columns = _inward_pressure(nodes, triangles).reshape(-1, 1)
    elif patch.force == "resultant":
        columns = np.kron(mean_over(nodes, triangles)[:, None], np.eye(3))
    elif patch.force == "wrench":
        columns = wrench_columns(nodes.coordinates, mean_over(nodes, triangles))
    else:
        touched_nodes = patch_nodes(nodes, patch, where)
        components = np.intersect1d(3 * touched_nodes[:, None] + np.arange(3), unknowns.free)
        columns = np.zeros((3 * len(nodes.coordinates), len(components)))
        columns[components, np.arange(len(components))] = 1.0
    if not np.any(unknowns.restrict(columns)):
        raise SceneError(f"{where}: the whole patch is clamped, so no force on it can move the body")
    return columns


def wrench_columns(coordinates: Array, weights: Array) -> Array:
    """Nodal forces (3 N, 6) of unit forces, and of unit moments about the mean place, of weights (N,) whose sum is 1.

    See mechanics/surface_points.py; moments in N m.
    """
    turning = mean_turning_maps(coordinates - weights @ coordinates, weights)
    return np.hstack([np.kron(weights[:, None], np.eye(3)), turning.swapaxes(1, 2).reshape(-1, 3)])


def _inward_pressure(nodes: Nodes, triangles: Array) -> Array:
    """Nodal forces (N, 3) of a total of 1 N."""
    of = facet_integrals(nodes, triangles)
    force = np.zeros((len(nodes.coordinates), 3))
    np.add.at(force, of.carriers, -of.vectors)
    return force / of.shares.sum()
