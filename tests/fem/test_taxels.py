"""Taxels on a surface: what they cover, and whose forces they share."""

import re
import warnings

import numpy as np
import pytest
from bodies import acted_on, box_arrays, write_arrays

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning, SceneError
from fenics_rom.fem.simulator import FullOrderSimulator

# Pressures are of contact forces, which are found to 1e-9 of the velocities that they stop.
EXACT = 1e-6
ROUND_OFF = 1e-13  # of sums of some hundred numbers
YOUNG, HEIGHT, SUNK = 1e6, 0.2, 1e-3
FLOOR = '[effects.contact.obstacles.floor]\nshape = "half-space"\npoint = [0, 0, 0]\nnormal = [0, 0, 1]'
BAR = {
    "material": f"young = {YOUNG}\npoisson = 0.0\ndensity = 1000.0",
    "contacts": '[contacts.sole]\nsurface = "bottom"',
    "supports": 'clamped = ["top"]',
}
DEGREES = pytest.mark.parametrize("degree", [1, 2])


@pytest.fixture(scope="module")
def bar(tmp_path_factory):
    return write_arrays(tmp_path_factory.mktemp("bar") / "bar.msh", *box_arrays((1.0, 0.1, HEIGHT), (4, 1, 2)))


def system_of(bar, touch, degree=1, **parts):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FenicsRomWarning)
        return fr.assemble(acted_on(bar, FLOOR, degree=degree, **BAR | parts, **{"outputs.sole": touch}))


def touch(surface="bottom", further="taxels = { rows = 2, columns = 5 }"):
    return f'quantity = "touch"\nsurface = "{surface}"\n{further}'


@DEGREES
def test_a_block_that_is_pressed_evenly_presses_all_taxels_alike(bar, degree):
    """E d / H everywhere, on the whole surface, and its middle is the centre of pressure; nothing slides on it."""
    system = system_of(bar, touch(), degree)
    body = FullOrderSimulator(system, 1.0, system.scene.environment, {"floor": lambda t: [0.0, 0.0, SUNK * t]})
    assert not body.touch("sole").pressures.any()
    body.step(np.zeros(0))
    felt, pressure = body.touch("sole"), YOUNG * SUNK / HEIGHT
    assert felt.pressures.shape == (2, 5)
    assert np.abs(felt.pressures - pressure).max() <= EXACT * pressure
    np.testing.assert_allclose(felt.force, [0.0, 0.0, 0.1 * pressure], atol=EXACT * pressure)
    np.testing.assert_allclose(felt.torque, 0.0, atol=EXACT * pressure)
    np.testing.assert_allclose(felt.centre, [0.5, 0.05, 0.0], atol=EXACT)
    assert felt.area == pytest.approx(0.1, rel=ROUND_OFF)
    assert felt.touching == 1
    np.testing.assert_allclose(felt.patches.normal_force, [felt.normal_force, 0.0, 0.0, 0.0], rtol=ROUND_OFF)
    assert felt.patches.margin.tolist() == [0.0, 1.0, 1.0, 1.0]  # without friction nothing holds it
    assert np.abs(felt.patches.slip).max() <= EXACT * SUNK


@DEGREES
def test_the_grid_lies_along_the_longer_axis(bar, degree):
    """Columns from the left to the right end; seen from below, rows run against the second axis."""
    taxels = system_of(bar, touch(), degree).readings["sole"].map
    areas, centres = taxels.areas.reshape(2, 5), taxels.centres.reshape(2, 5, 3)
    assert areas.sum() == pytest.approx(0.1, rel=ROUND_OFF)
    np.testing.assert_allclose(areas, 0.01, rtol=0.1)  # to the parts of facets that are counted
    assert (np.diff(centres[..., 0], axis=1) > 0.15).all()
    assert (np.diff(centres[..., 1], axis=0) < -0.04).all()
    shown = taxels.on_triangles(np.ones((2, 5)))
    np.testing.assert_allclose(shown, 1.0, rtol=ROUND_OFF)
    turned = system_of(bar, touch(further="taxels = { rows = 5, columns = 2, along = [0, 1, 0] }"), degree)
    assert (np.diff(turned.readings["sole"].map.centres.reshape(5, 2, 3)[..., 1], axis=1) > 0.04).all()


def test_a_surface_around_a_body_is_unrolled(bar):
    """Of the four long sides of a bar: columns along it, rows about it, so that none is empty."""
    sides = 'none = ["left", "right"]\ntaxels = { rows = 4, columns = 5 }'
    system = system_of(bar, f'quantity = "touch"\n{sides}')
    taxels = system.readings["sole"].map
    assert taxels.areas.sum() == pytest.approx(0.6, rel=ROUND_OFF)
    assert (taxels.areas > 0).all()
    centres = taxels.centres.reshape(4, 5, 3)
    assert (np.diff(centres[..., 0], axis=1) > 0.15).all()
    assert np.ptp(centres[..., 2], axis=0).min() > 0.05


def test_taxels_that_nothing_can_press_are_told(bar):
    """Contact points are on the left half; triangles of 0.25 m reach on to 0.75 m."""
    half = "[contacts.sole]\nbox = { corners = [[0, 0, 0], [0.5, 0.1, 0]] }"
    touched = touch(further="taxels = { rows = 1, columns = 8 }")
    said = "".join(system_of(bar, touched, contacts=half).warnings)
    assert re.search(r"outputs.sole: 2 of 8 taxels have no contact points, .* as the one at \[0.81", said)
    assert "taxels" not in "".join(system_of(bar, touch()).warnings)


def test_a_surface_without_contact_points_is_refused(bar):
    with pytest.raises(SceneError, match=r"outputs.sole: its surface has no contact points; .* sole"):
        system_of(bar, touch("top"))
    with pytest.raises(SceneError, match=r"taxels.along: is normal to the surface"):
        system_of(bar, touch(further="taxels = { rows = 2, columns = 2, along = [0, 0, 1] }"))
