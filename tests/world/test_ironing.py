"""Ironing: a block is pressed on a soft slab and dragged over it; what it feels does not jump from step to step."""

from functools import partial

import numpy as np
import pytest
from soft_blocks import block_system, pressed

import fenics_rom as fr
from fenics_rom.world.shapes import Sphere

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
THICK, PRESSED, RAMP = 0.025, 1e-3, 0.1  # of the slab, m; m within s
SPEED, RISE, SLIDE, ABOVE = 0.1, 0.05, 0.015, 5.0  # m/s, reached within s; m; m, where what carries the block is
DT, FRICTION, ORDER = 1e-3, 0.3, 30


@pytest.mark.parametrize(("bow", "slab", "iron"), [(0.0, (16, 7, 3), (5, 5, 3)), (10.0, (16, 7, 3), (6, 5, 3))])
def test_nothing_jumps_as_points_pass_from_one_element_to_another(tmp_path, bow, slab, iron):
    """A flat block, whose edges press themselves in, and a round one: 0.16 and 0.25 % of the force in a step.

    A step is 1.3 % of an element. With normals of flat triangles it is 1.0 and 0.5 %.
    """
    low = block_system(tmp_path, (0.12, 0.05, THICK), slab, (0, 0, 0), "top", "bottom", "fixed", 1e5, 0.3)
    up = block_system(tmp_path, (0.03, 0.03, 0.02), iron, (0.02, 0.01, THICK), "bottom", "top", "moving", 1e6, 0.3, bow)
    hand = fr.RigidBody(
        Sphere(0.01), motion=partial(pressed, depth=PRESSED, ramp=RAMP, above=ABOVE, speed=SPEED, rise=RISE)
    )
    bodies = {
        "hand": hand,
        "low": fr.SoftBody(fr.reduce(low, order=ORDER)),
        "up": fr.SoftBody(fr.reduce(up, order=ORDER), on="hand", position=(0, 0, -ABOVE)),
    }
    world, forces = fr.World(bodies, DT, friction=FRICTION), []
    for _ in range(round((RAMP + RISE + SLIDE / SPEED) / DT)):
        world.step()
        forces.append(-world.force_between("low", "up"))
    gone = world.ledger
    left = world.energy - gone.supplied + gone.dissipated + gone.numerical + gone.lost_in_switching
    assert abs(left) <= 1e-13 * gone.supplied
    slides = np.array(forces)[round((RAMP + 2 * RISE) / DT) :]
    jumps = np.linalg.norm(np.diff(slides, axis=0), axis=1) / np.linalg.norm(slides[1:], axis=1)
    assert jumps.max() < 0.005
    normal, along = slides[:, 2], -slides[:, 0]
    assert np.abs(normal / normal.mean() - 1).max() < 0.05
    np.testing.assert_allclose(along / normal, FRICTION, rtol=0.1)  # and what the block pushes before it
