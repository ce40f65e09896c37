"""A pad whose top meets obstacles that are smaller than its mesh."""

import numpy as np
from bodies import box_arrays, scene_text, skin_of, write_arrays

from fenics_rom.scene.file import parse_scene

L = 0.01  # m, of a brick of the mesh
R = 0.05 * L  # of pins
UP = {"effects.gravity": "acceleration = [0.0, 0.0, 1000.0]"}  # presses the top on what is above it
RUBS = {"effects.friction": "coefficient = 0.4"}


def pad(bricks=(4, 4, 1), moved=None):
    """Points, tetrahedra and faces of a pad; `moved`: where the node of its top that is nearest is put, (2,), m."""
    points, cells = box_arrays(tuple(n * L for n in bricks), bricks)
    height = bricks[2] * L
    if moved is not None:
        top = np.isclose(points[:, 2], height).nonzero()[0]
        points[top[np.linalg.norm(points[top, :2] - moved, axis=1).argmin()], :2] = moved
    skin = skin_of(cells)
    x, z = points[skin, 0], points[skin, 2]
    ends = {"top": np.isclose(z, height), "bottom": np.isclose(z, 0), "left": np.isclose(x, 0)}
    return points, cells, {"skin": skin} | {name: skin[at.all(axis=1)] for name, at in ends.items()}


def pad_text(folder, obstacle, mesh=None, frame="fixed", points="faces", **parts):
    """The text of a scene of a pad under an obstacle; `parts` as of `scene_text`."""
    file = write_arrays(folder / "pad.msh", *(mesh or pad()))
    given = {
        "material": "young = 1e5\npoisson = 0.3\ndensity = 1000.0",
        "damping": "beta = 2e-3",
        "contacts": '[contacts.top]\nsurface = "top"',
        "supports": 'clamped = ["bottom"]',
        "effects.contact": f'points = "{points}"\n{obstacle}',
    }
    return f'frame = "{frame}"\n{scene_text(file, **given | parts)}'


def pad_scene(*given, **parts):
    """The scene of `pad_text`."""
    return parse_scene(pad_text(*given, **parts))


def shape(kind, x, y, above, height=L):
    """An obstacle so far above a place of the top, m, by its kind."""
    low, wide = height + above, 2 * R
    described = {
        "ball": f'shape = "sphere", center = [{x}, {y}, {low + R}], radius = {R}',
        "rod": f'shape = "capsule", start = [{x - L}, {y - 0.7 * L}, {low + R}], end = [{x + 1.1 * L}, '
        f"{y + 0.8 * L}, {low + R}], radius = {R}",
        "peg": f'shape = "box", center = [{x}, {y}, {low + R}], size = [{wide}, {wide}, {wide}]',
        "edge": f'shape = "box", center = [{x}, {y}, {low + L / np.sqrt(2)}], size = [{2.2 * L}, {L}, {L}], '
        f"rotation = [{np.pi / 4}, 0.0, 0.0]",
    }
    return f"obstacles.pin = {{ {described[kind]} }}"


def depth_of(stepper, offset):
    """How deep an obstacle that is displaced by (3,), or posed, is in faces and contact points, m."""
    solver, offsets = stepper.interface.solver, np.reshape(offset, (1, -1))
    moved = stepper.point_displacement()
    places = solver.near(moved, offsets)[0]
    return -min(places.gaps.min(initial=0.0), solver.gaps(moved, offsets).min())
