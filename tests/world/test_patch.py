"""The patch test of soft on soft: uniform pressure through a flat interface of two meshes that do not match."""

from functools import partial

import numpy as np
import pytest
from soft_blocks import block_system, pressed

import fenics_rom as fr
from fenics_rom.world.shapes import Sphere

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
SIDE, THICK, YOUNG, PRESSED = 0.1, 0.05, 1e5, 1e-4  # m, m, Pa, m
DT, RAMP, STEPS = 1e-3, 0.1, 250  # s, s
ABOVE = 5.0  # m, where what moves the upper block is


def block(folder, bricks, touches, held, bottom, frame):
    """A block that does not widen (ν = 0), in all modes."""
    system = block_system(folder, (SIDE, SIDE, THICK), bricks, (0, 0, bottom), touches, held, frame, YOUNG, 0.0)
    return fr.reduce(system, order=system.elastic_size, method="modal")


@pytest.mark.parametrize(("lower", "upper", "bound"), [((5, 4, 2), (4, 3, 2), 0.006), ((6, 6, 2), (3, 2, 2), 0.03)])
def test_a_uniform_pressure_passes_an_interface_of_two_meshes(tmp_path, lower, upper, bound):
    """Points of both sides: 0.2 % of what is pressed, and 1 % where one mesh is twice as fine; the mean to 1e-4."""
    low = block(tmp_path, lower, "top", "bottom", 0.0, "fixed")
    up = block(tmp_path, upper, "bottom", "top", THICK, "moving")
    hand = fr.RigidBody(Sphere(0.01), motion=partial(pressed, depth=PRESSED, ramp=RAMP, above=ABOVE))
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
    force = YOUNG * PRESSED / (2 * THICK) * SIDE**2
    assert -world.force_between("low", "up")[2] == pytest.approx(force, rel=1e-3)
