"""What a surface of triangles has to be, to be an obstacle: each refusal says where, and how deep or how many."""

from collections.abc import Collection, Mapping
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import SceneError
from fenics_rom.mechanics.triangle_surface import TriangleSurface
from fenics_rom.mechanics.triangles import nearest_on_triangles

MOST_TRIANGLES = 2_000_000
FLATTEST = 1e-12  # height of a triangle over its longest side, from which on it has a normal
TOUCHING = 1e-9  # of the size: so far surfaces may be in one another by round-off of files
_ONES = np.ones(3)


def check_arrays(vertices: Array, triangles: Array) -> None:
    """A SceneError unless vertices (V, 3) are finite, and triangles (T, 3) between them have areas."""
    if vertices.ndim != 2 or vertices.shape[1] != 3 or triangles.ndim != 2 or triangles.shape[1] != 3:
        raise SceneError(f"mesh: use vertices (V, 3) and triangles (T, 3) (got {vertices.shape}, {triangles.shape})")
    if not 0 < len(triangles) <= MOST_TRIANGLES:
        raise SceneError(f"mesh: triangles: use 1 to {MOST_TRIANGLES:,} (got {len(triangles):,})")
    if not np.isfinite(vertices).all():
        row = int((~np.isfinite(vertices)).any(axis=1).argmax())
        raise SceneError(f"mesh: vertices: use finite numbers (got vertex {row} at {vertices[row].tolist()})")
    if triangles.min() < 0 or triangles.max() >= len(vertices):
        raise SceneError(f"mesh: triangles: use rows 0 to {len(vertices) - 1} of the vertices")
    corners = vertices[triangles]
    sides = np.roll(corners, -1, axis=1) - corners
    areas, squares = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1), np.square(sides).sum(axis=2)
    if (flat := ~(areas > FLATTEST * squares.max(axis=1))).any():
        row = int(flat.argmax())
        raise SceneError(
            f"mesh: {flat.sum()} of {len(triangles)} triangles have no area, e.g. triangle {row} at "
            f"{_place(corners[row].mean(axis=0))}; use others"
        )


def check_solid(surface: TriangleSurface, may_be_open: bool) -> None:
    """A SceneError unless a surface has one side outside: it is closed, or may be open, and does not meet itself."""
    _check_sides(surface)
    if not (may_be_open or surface.is_closed):
        borders = surface.edges[surface.beside[:, 1] < 0]
        raise SceneError(
            f"mesh: is not closed: {len(borders)} of {len(surface.edges)} edges have a triangle on one side alone, "
            f"e.g. one at {_place(surface.vertices[borders[0]].mean(axis=0))}; use a closed surface, or with "
            "open = true one all behind which is solid"
        )
    if surface.is_closed and surface.volume <= 0:
        raise SceneError(
            f"mesh: is turned inside out, as it encloses {surface.volume:.3g} m3; use triangles whose corners "
            "go counterclockwise, seen from outside"
        )
    _check_crossings(surface)


def _check_sides(surface: TriangleSurface) -> None:
    """Refuses edges of more than two triangles, and neighbours that are turned opposite ways."""
    triangles = surface.triangles
    sides = np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2).reshape(-1, 2)
    for pairs, what in (
        (np.sort(sides, axis=1), "edges have more than two triangles"),
        (sides, "edges lie between triangles that are turned opposite ways"),
    ):
        found, count = np.unique(pairs, axis=0, return_counts=True)
        wrong = found[count > (2 if what.startswith("edges have") else 1)]
        if len(wrong):
            raise SceneError(
                f"mesh: {len(wrong)} {what}, e.g. one at {_place(surface.vertices[wrong[0]].mean(axis=0))}; use "
                "a surface with one outside"
            )


def _check_crossings(surface: TriangleSurface) -> None:
    """Refuses a surface whose edges go through its triangles."""
    found = crossings(surface)
    if found is not None:
        raise SceneError(
            f"mesh: goes through itself at {found.places} places, by {found.depth:.3g} m at {_place(found.place)}; "
            "use a surface that does not meet itself"
        )


def check_apart(nodes: Array, triangles: Array, surfaces: Mapping[str, Array], names: Collection[str]) -> None:
    """Checks that a body with some surfaces that touch themselves does not go through itself at rest.

    Args:
        nodes: of the body, (N, 3), m.
        triangles: of its surface, (F, 3).
        surfaces: nodes of named surfaces, (any,) each.
        names: of those that touch themselves; without any nothing is checked.

    Raises:
        SceneError: it does; it says which surfaces, where, and how deep.
    """
    if not names:
        return
    surface = TriangleSurface(nodes, triangles)
    found = crossings(surface)
    if found is None:
        return
    heights, _ = surface.planes(np.repeat(found.number, 2), nodes[found.edge])
    inner = found.edge[heights.argmin()]
    others = (triangles != inner).all(axis=1).nonzero()[0]
    feet = nearest_on_triangles(np.broadcast_to(nodes[inner], (len(others), 3)), nodes[triangles[others]])[1]
    depths = np.linalg.norm(nodes[inner] - feet, axis=1)
    depths[((nodes[inner] - feet) * surface.normals[others]).dot(_ONES) >= 0] = np.inf
    nearest = depths.argmin()

    def name_of(rows: Array) -> str:
        on = (f"surface {name!r}" for name in names if np.isin(rows, surfaces[name]).all())
        return next(on, "the rest of the surface")

    raise SceneError(
        f"effects.contact.self_contact: {name_of(inner)} begins {depths[nearest]:.3g} m inside "
        f"{name_of(triangles[others[nearest]])}, at {_place(nodes[inner])} m: use a body that does not go "
        "through itself at rest"
    )


class Crossings(NamedTuple):
    """Where edges of a surface go through its triangles."""

    places: int  # how many
    depth: float  # of the deepest, m
    place: Array  # (3,) where it is, m
    edge: Array  # (2,) its vertices
    number: int  # of the triangle


def crossings(surface: TriangleSurface) -> Crossings | None:
    """The places where a surface goes through itself by more than round-off; None: it does not."""
    ends = surface.vertices[surface.edges]
    edge, triangle, depth, at = surface.pierced(ends[:, 0], ends[:, 1])
    apart = (surface.triangles[triangle][:, :, None] != surface.edges[edge][:, None]).all(axis=(1, 2))
    wrong = (apart & (depth > TOUCHING * surface.size)).nonzero()[0]
    if not len(wrong):
        return None
    deepest = wrong[depth[wrong].argmax()]
    return Crossings(
        len(wrong), float(depth[deepest]), at[deepest], surface.edges[edge[deepest]], int(triangle[deepest])
    )


def _place(x: Array) -> list[float]:
    return [float(f"{value:.4g}") for value in x.tolist()]
