"""What a joint holds of a surface of a soft body."""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import SceneError, check_known
from fenics_rom.world.bodies import Points
from fenics_rom.world.soft import CLOSED, Soft
from fenics_rom.world.surfaces import hold_surface, is_rigid, soft_points


def surface_points(
    body: Soft, surface: str, kind: str, axis: Array | None, whole: bool, where: str
) -> tuple[Array, Points]:
    """Holds the surface of a contact mode of a body, which goes to that.

    Args:
        body: a soft one.
        surface: name of the contact mode.
        kind: "ball", "hinge" or "weld".
        axis: of a hinge.
        whole: whether a weld may hold it as a whole.
        where: what errors begin with.

    Returns:
        Where it begins (j, 3), m, and the points of the body.

    Raises:
        SceneError: there is no such surface, or it cannot be held so.
    """
    check_known("contact mode", surface, body.rom.contact_models, SceneError, where)
    body.switch(surface)
    numbers = body.rom.contact_models[surface].contact_points
    nodes = np.searchsorted(body.contact_points, numbers)
    rigid = is_rigid(body.contact_coordinates[nodes], body.rom.rows_of(numbers))
    if rigid and kind == "hinge":
        raise SceneError(
            f"{where}cannot be closed: surface {surface!r} is rigid, which no hinge holds; weld a rigid body to it, "
            "and hinge that"
        )
    row = np.full(len(body.contact_coordinates), -1)
    row[nodes] = np.arange(len(nodes))
    among = row[body.contact_triangles]
    triangles = among[(among >= 0).all(axis=1)]
    yields = body.yields and not rigid
    whole = whole and not yields
    held = hold_surface(kind, axis, body.places()[nodes], triangles, whole, yields)
    if held.gap > CLOSED * body.size:
        raise SceneError(
            f"{where}cannot be closed: its axis leaves surface {surface!r}, by {held.gap:.3g} m; allowed is one in it, "
            "or a rigid body that is welded to it, and hinged"
        )
    return held.places, soft_points(nodes[held.nodes], held.weights)._replace(couples=held.couples)
