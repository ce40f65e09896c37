"""Soft blocks that lie on one another, whose meshes do not match."""

import numpy as np
from bodies import box_arrays, box_surfaces, scene_text, write_arrays

import fenics_rom as fr
from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.scene.file import parse_scene

FAR = 'shape = "half-space"\npoint = [0.0, 0.0, -10.0]\nnormal = [0.0, 0.0, 1.0]'


def block_system(folder, size, bricks, at, touches, held, frame, young, poisson, bow=0.0):
    """A block whose nodes between others of its top and bottom are shaken within these.

    Args:
        size, at: of its edges, and where its lowest corner is, m.
        touches, held: which face touches, and which is held.
        bow: curvature of its bottom along x, 1/m, by which its ends are higher.
    """
    points, cells = box_arrays(size, bricks)
    surfaces, size = box_surfaces(points, cells), np.array(size)
    inner = ((points[:, :2] > 1e-9) & (points[:, :2] < size[:2] - 1e-9)).all(axis=1)
    shake = np.random.default_rng(bricks[0]).uniform(-0.15, 0.15, (inner.sum(), 2))
    points[inner, :2] += size[:2] * shake / np.array(bricks[:2])
    points[:, 2] += bow / 2 * (points[:, 0] - size[0] / 2) ** 2 * (1 - points[:, 2] / size[2])
    text = scene_text(
        write_arrays(folder / f"{touches}.msh", points + at, cells, surfaces),
        material=f"young = {young}\npoisson = {poisson}\ndensity = 1000.0",
        damping="alpha = 100.0, beta = 2e-3",
        supports=f'clamped = ["{held}"]',
        contacts=f'[contacts.face]\nsurface = "{touches}"',
        **{"effects.contact": "", "effects.contact.obstacles.far": FAR},
    )
    return fr.assemble(parse_scene(f'frame = "{frame}"\n{text}'))


def pressed(t, depth, ramp, above, speed=0.0, rise=1.0):
    """What carries a block: down by a depth, m, within a ramp, s, smoothly; then aside by a speed, m/s, that rises.

    above: m, where it is when it begins.
    """
    s, aside = min(t / ramp, 1.0), max(0.0, t - ramp)
    x, v = depth * s * s * (3 - 2 * s), depth * 6 * s * (1 - s) / ramp
    gone = speed * (aside**2 / (2 * rise) if aside < rise else aside - rise / 2)
    velocity = np.array([speed * min(aside / rise, 1.0), 0.0, -v])
    return BaseState(np.array([gone, 0.0, above - x]), np.array([1.0, 0, 0, 0]), velocity, np.zeros(3))
