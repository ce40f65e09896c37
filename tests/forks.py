"""Bodies that touch themselves: with two prongs, and an oval ring."""

import numpy as np
from bodies import box_arrays, scene_text, skin_of, write_arrays

from fenics_rom.scene.file import parse_scene

LONG, WIDE, HIGH, GAP = 0.1, 0.02, 0.01, 2e-3  # m, of a prong, and between the two of a fork


def prongs(bricks, upper_alone=False):
    """Points, tetrahedra and faces of two prongs along x, mirrored at z = 0, or of the upper one."""
    points, cells = box_arrays((LONG, WIDE, HIGH), bricks)
    points = points + np.array([0.0, -WIDE / 2, GAP / 2])
    if not upper_alone:
        cells = np.concatenate([cells, cells[:, [0, 1, 3, 2]] + len(points)])
        points = np.concatenate([points, points * [1, 1, -1]])
    return points, cells, faces_of(points, cells)


def cleft(bricks, backs):
    """The same of a block of an odd number of layers, whose middle one is there at its back alone: joined prongs."""
    points, cells = box_arrays((LONG, WIDE, 2 * HIGH + GAP), bricks)
    points[:, 1] -= WIDE / 2
    half = bricks[2] // 2  # layers of each prong
    layer = np.round(points[:, 2] / (2 * HIGH + GAP) * bricks[2])
    points[:, 2] = (
        np.where(layer <= half, -HIGH, GAP) - GAP / 2 + np.where(layer <= half, layer, layer - half - 1) * HIGH / half
    )
    middle = points[cells].mean(axis=1)
    kept = (np.abs(middle[:, 2]) > GAP / 2) | (middle[:, 0] < backs * LONG / bricks[0])
    used, row = np.unique(cells[kept], return_inverse=True)
    points, cells = points[used], row.reshape(-1, 4)
    return points, cells, faces_of(points, cells)


def faces_of(points, cells):
    """Triangles of the whole skin, of the left end, of what faces the plane z = 0, and above and below."""
    skin = skin_of(cells)
    x, z = points[skin, 0], points[skin, 2]
    return {
        "skin": skin,
        "left": skin[np.isclose(x, 0).all(axis=1)],
        "inside": skin[np.isclose(np.abs(z), GAP / 2).all(axis=1)],
        "above": skin[np.isclose(z, HIGH + GAP / 2).all(axis=1)],
        "below": skin[np.isclose(z, -HIGH - GAP / 2).all(axis=1)],
    }


def facing(nodes):
    """Rows of the nodes (N, 3) of the lower prong and of the upper one that face each other, in the same order."""
    inner = np.isclose(np.abs(nodes[:, 2]), GAP / 2) & (nodes[:, 0] > LONG / 5)
    sides = (np.flatnonzero(inner & (nodes[:, 2] * side > 0)) for side in (-1, 1))
    return [rows[np.lexsort(nodes[rows].T[:2])] for rows in sides]


LEVEL, THICK = 8e-3, 2e-3  # m, of an oval ring: how high its inside is above the middle, and how thick it is


def oval(around):
    """Points, tetrahedra and faces of a ring about y, of so many bricks; foot and head are of its outside."""
    grid, cells = box_arrays((1.0, 1.0, 1.0), (around, 1, 2))
    keys = np.round(grid * [around, 1, 2]).astype(int) % [around, 2, 3]  # its ends are one
    _, first, row = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    grid, cells = grid[first], row.ravel()[cells]
    turn, out = 2 * np.pi * (grid[:, 0] - 0.25), THICK * grid[:, 2]
    points = np.stack([(0.02 + out) * np.cos(turn), WIDE * grid[:, 1], (LEVEL + out) * np.sin(turn)], axis=1)
    a, b, c, d = np.moveaxis(points[cells], 1, 0)
    turned = np.einsum("ci,ci->c", np.cross(b - a, c - a), d - a) < 0
    cells[turned] = cells[turned][:, [0, 1, 3, 2]]
    skin = skin_of(cells)
    inside, outside = (skin[np.isclose(grid[skin, 2], side).all(axis=1)] for side in (0.0, 1.0))
    high = points[outside, 2] / (LEVEL + THICK)
    faces = {"foot": outside[(high < -0.9).all(axis=1)], "head": outside[(high > 0).all(axis=1)]}
    return points, cells, {"inside": inside, **faces}


def fork_scene(*given, **parts):
    """The scene of `fork_text`."""
    return parse_scene(fork_text(*given, **parts))


def fork_text(folder, mesh, frame="fixed", contact='self_contact = ["inside"]', **parts):
    """The text of a scene of a body whose inner faces may touch; `parts` as of `scene_text`."""
    file = write_arrays(folder / "fork.msh", *mesh)
    material = "young = 1e6\npoisson = 0.3\ndensity = 1000.0"
    modes = '[contacts.inside]\nsurface = "inside"'
    given = {"material": material, "damping": "beta = 1e-3", "contacts": modes, "effects.contact": contact}
    return f'frame = "{frame}"\n{scene_text(file, **given | parts)}'


def pressed(*names):
    return {f"effects.pressure.{name}": f'surface = "{name}"' for name in names}


ENDS = [[0.9 * LONG, 0.0, side * (HIGH + GAP / 2)] for side in (1, -1)]
ROPE = {"effects.tendon.rope": f"points = {ENDS}"}
CLAMPED = {"supports": 'clamped = ["left"]'}
