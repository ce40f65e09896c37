"""Input columns of the effects that act as forces, each for a total of 1 N, and what 1 of its unit is worth in N.

They are on the components of all nodes, also of those that supports hold. A column's unit must not decide how much of
it a reduced basis knows: pascals and newtons are reduced as equals.
"""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import SceneError
from fenics_rom.fem.nodes import Nodes, patch_area, patch_columns, shape_functions
from fenics_rom.mechanics.tendon import measure_segments, unit_tension_forces
from fenics_rom.scene.scene import Scene
from fenics_rom.system.body import Unknowns

Columns = dict[str, Array]
MIN_PIECE_SHARE = 1e-9  # of a piece of a tendon in its length


def actuators_of(scene: Scene, nodes: Nodes, unknowns: Unknowns) -> tuple[Columns, dict[str, float]]:
    """Columns (3 N, columns) and units of actuators: the scene's own, pressures (Pa) and tendons (N)."""
    columns = {
        name: patch_columns(nodes, patch, unknowns, f"actuators.{name}") for name, patch in scene.actuators.items()
    }
    units: dict[str, float] = {}
    for name, pressure in scene.effects.pressure.items():
        where = f"effects.pressure.{name}"
        columns[name] = patch_columns(nodes, pressure.patch("normal"), unknowns, where)
        units[name] = patch_area(nodes, pressure, where)
    for name, tendon in scene.effects.tendon.items():
        where, units[name] = f"effects.tendon.{name}", 1.0
        columns[name] = _cable(nodes, np.array(tendon.points), where)
        _refuse_nothing(columns[name], unknowns, where)
    return columns, units


def loads_of(
    scene: Scene, nodes: Nodes, weight: Array, translations: Array, unknowns: Unknowns
) -> tuple[Columns, dict[str, float]]:
    """Columns (3 N, columns) and units of loads with signals of their own, in the order of `load_columns`.

    Gravity in multiples of its acceleration, base motions (m/s²), prescribed forces (N); `weight` (N,), kg, is what
    weighs at each node, and `translations` (3 N, 3), kg, is M times unit translations.
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
    for name, tendon in scene.effects.tendon.items() if scene.effects.tendon_friction is not None else ():
        points, where = np.array(tendon.points), f"effects.tendon.{name}"
        for number in range(1, len(points) - 1):  # friction at a guide changes the tension from there to the anchor
            columns[f"{name}-guide-{number}"] = _cable(nodes, points[: number + 1], where)
            units[f"{name}-guide-{number}"] = 1.0
    return columns, units


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
