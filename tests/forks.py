"""Bodies with two prongs that touch one another."""

import numpy as np
from bodies import box_arrays, scene_text, write_arrays

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
    every = np.sort(cells[:, [(1, 2, 3), (0, 2, 3), (0, 1, 3), (0, 1, 2)]].reshape(-1, 3), axis=1)
    faces, count = np.unique(every, axis=0, return_counts=True)
    skin = faces[count == 1]
    x, z = points[skin, 0], points[skin, 2]
    return {
        "skin": skin,
        "left": skin[np.isclose(x, 0).all(axis=1)],
        "inside": skin[np.isclose(np.abs(z), GAP / 2).all(axis=1)],
        "above": skin[np.isclose(z, HIGH + GAP / 2).all(axis=1)],
        "below": skin[np.isclose(z, -HIGH - GAP / 2).all(axis=1)],
    }


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
