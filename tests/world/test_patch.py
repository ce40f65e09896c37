"""The patch test of soft on soft: uniform pressure through a flat interface of two meshes that do not match."""

import numpy as np
import pytest
from bodies import box_arrays, scene_text, write_arrays

import fenics_rom as fr
from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.scene.file import parse_scene
from fenics_rom.world.shapes import Sphere

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
SIDE, THICK, YOUNG, PRESSED = 0.1, 0.05, 1e5, 1e-4  # m, m, Pa, m
FAR = 'shape = "half-space"\npoint = [0.0, 0.0, -10.0]\nnormal = [0.0, 0.0, 1.0]'
DT, RAMP, STEPS = 1e-3, 0.1, 250  # s, s
ABOVE = 5.0  # m, where what moves the upper block is


def block(folder, bricks, touches, held, bottom, frame):
    """A block that does not widen (ν = 0), whose nodes at the interface are shaken within it, in all modes."""
    points, cells = box_arrays((SIDE, SIDE, THICK), bricks)
    inner = ((points[:, :2] > 1e-9) & (points[:, :2] < SIDE - 1e-9)).all(axis=1)
    shake = np.random.default_rng(bricks[0]).uniform(-0.15, 0.15, (inner.sum(), 2))
    points[inner, :2] += SIDE * shake / np.array(bricks[:2])
    points[:, 2] += bottom
    text = scene_text(
        write_arrays(folder / f"{touches}.msh", points, cells),
        material=f"young = {YOUNG}\npoisson = 0.0\ndensity = 1000.0",
        damping="alpha = 100.0, beta = 2e-3",
        supports=f'clamped = ["{held}"]',
        contacts=f'[contacts.face]\nsurface = "{touches}"',
        **{"effects.contact": "", "effects.contact.obstacles.far": FAR},
    )
    system = fr.assemble(parse_scene(f'frame = "{frame}"\n{text}'))
    return fr.reduce(system, order=system.elastic_size, method="modal")


def lowered(t):
    """What carries the upper block goes down within RAMP, smoothly, and stays."""
    s = min(t / RAMP, 1.0)
    x, v = PRESSED * s * s * (3 - 2 * s), PRESSED * 6 * s * (1 - s) / RAMP
    return BaseState(np.array([0, 0, ABOVE - x]), np.array([1.0, 0, 0, 0]), np.array([0, 0, -v]), np.zeros(3))


@pytest.mark.parametrize(("lower", "upper", "bound"), [((5, 4, 2), (4, 3, 2), 0.006), ((6, 6, 2), (3, 2, 2), 0.03)])
def test_a_uniform_pressure_passes_an_interface_of_two_meshes(tmp_path, lower, upper, bound):
    """Points of both sides: 0.2 % of what is pressed, and 1 % where one mesh is twice as fine; the mean to 1e-4."""
    low = block(tmp_path, lower, "top", "bottom", 0.0, "fixed")
    up = block(tmp_path, upper, "bottom", "top", THICK, "moving")
    hand = fr.RigidBody(Sphere(0.01), motion=lowered)
    bodies = {"hand": hand, "low": fr.SoftBody(low), "up": fr.SoftBody(up, on="hand", position=(0, 0, -ABOVE))}
    world = fr.World(bodies, DT)
    for _ in range(STEPS):
        world.step()
    assert world.touching >= len(up.contact_models["face"].contact_points)
    for name, rom in (("low", low), ("up", up)):
        exact = np.zeros((len(rom.nodes), 3))
        exact[:, 2] = -PRESSED * rom.nodes[:, 2] / (2 * THICK)
        off = world.simulator(name).displacement() - exact
        assert np.abs(off).max() <= bound * PRESSED
    pressed = YOUNG * PRESSED / (2 * THICK) * SIDE**2
    assert -world.force_between("low", "up")[2] == pytest.approx(pressed, rel=1e-3)
