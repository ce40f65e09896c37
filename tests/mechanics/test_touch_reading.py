"""A sense of touch on its own: what it makes of forces on nodes, wherever the surface is."""

import numpy as np
import pytest

from fenics_rom.mechanics.contact_points import ContactPoints
from fenics_rom.mechanics.frame_motion import rotation_matrix
from fenics_rom.mechanics.readable_body import ReadableBody
from fenics_rom.mechanics.rubbing import Rubbing
from fenics_rom.mechanics.sensor import Sensor
from fenics_rom.mechanics.touch import TaxelMap, TouchReading, unpacked

ROUND_OFF = 1e-13  # of sums of ten numbers, of their sizes
GRID = np.array([1, 4])
N = 5  # nodes of a row, of which there are two
NODES = np.array([[0.1 * k, 0.1 * j, 0.0] for j in range(2) for k in range(N)])
FACETS = np.array([facet for k in range(N - 1) for facet in ([k, k + 1, N + k], [k + 1, N + k + 1, N + k])])  # a strip
ORIGIN = np.array([0.3, -0.2, 0.5])
FELT = np.arange(2 * N)
PRESSING = np.array([2.0, 1.0, 0, 0, 3.0, 2.0, 0, 0, 0, 0.5])  # N: two patches, at the ends
FORCES = np.array([0.1, 0.2, 1.0]) * PRESSING[:, None]
μ = 0.5


def reading(sensor=None):
    taxels = TaxelMap(GRID, np.full(4, 0.01), np.zeros((4, 3)), *(np.empty(0, int),) * 3, np.empty(0))
    areas, own = np.full(len(FACETS), 0.005), np.minimum(FELT % N, 3)
    return TouchReading(FELT, FACETS, areas, NODES, ORIGIN, 3, taxels, FELT, own, np.ones(2 * N), sensor or Sensor())


def body(R, moved):
    """Of the strip, turned and moved, with all that pushes it."""
    points = ContactPoints({"all": FELT}, {"all": FELT}, NODES)
    t = FORCES - PRESSING[:, None] * [0, 0, 1]
    rubbing = Rubbing(t @ R.T, μ * PRESSING, (PRESSING[:, None] * [3e-3, 0, 0]) @ R.T, PRESSING * (FELT < N))
    return ReadableBody(
        None,
        lambda: np.empty(0),
        lambda name: 0.0,
        points,
        PRESSING,
        FORCES @ R.T,
        lambda: rubbing,
        lambda: NODES @ R.T + moved,
    )


def test_it_turns_with_its_surface():
    """Forces and torques turn, also those about a point beside the surface; all else is the same."""
    R = rotation_matrix(np.array([0.8, 0.36, -0.48, 0.0]))
    sense = reading()
    felt, turned = (
        unpacked(sense.read(body(*where)), GRID) for where in ((np.eye(3), np.zeros(3)), (R, np.array([1.0, 2.0, 3.0])))
    )
    size = np.abs(FORCES).max()
    np.testing.assert_allclose(felt.torque, np.cross(NODES - ORIGIN, FORCES).sum(axis=0), atol=ROUND_OFF * size)
    np.testing.assert_allclose(turned.force, R @ felt.force, atol=ROUND_OFF * size)
    np.testing.assert_allclose(turned.torque, R @ felt.torque, atol=10 * ROUND_OFF * size)
    np.testing.assert_allclose(turned.patches.slip, felt.patches.slip @ R.T, atol=ROUND_OFF)
    for name in ("centre", "normal_force", "area", "touching", "pressures"):
        np.testing.assert_array_equal(getattr(turned, name), getattr(felt, name))


def test_patches_are_what_is_connected_and_are_told_by_their_force():
    felt = unpacked(reading().read(body(np.eye(3), np.zeros(3))), GRID)
    assert felt.touching == 2
    np.testing.assert_allclose(felt.patches.normal_force, [5.0, 3.5, 0.0])
    np.testing.assert_allclose(felt.patches.centre[:2, 0], [0.02, 0.4], atol=ROUND_OFF)
    np.testing.assert_allclose(felt.patches.slip[:2], [[3e-3, 0, 0]] * 2, atol=ROUND_OFF)
    margin = 1 - np.hypot(0.1, 0.2) / μ
    np.testing.assert_allclose(felt.patches.margin, [margin, margin, 1.0], rtol=ROUND_OFF)
    np.testing.assert_allclose(felt.patches.sliding, [3 / 5, 3 / 3.5, 0.0], rtol=ROUND_OFF)
    np.testing.assert_allclose(felt.area, felt.patches.area.sum())
    np.testing.assert_allclose(felt.pressures, [[400.0, 100.0, 0.0, 350.0]], rtol=ROUND_OFF)


def test_it_feels_nothing_where_nothing_touches():
    felt = unpacked(reading().untouched, GRID)
    np.testing.assert_allclose(felt.centre, [0.2, 0.05, 0.0], atol=ROUND_OFF)
    assert not any(np.any(part) for part in (felt.force, felt.torque, felt.pressures, felt.touching, felt.area))
    assert felt.patches.margin.tolist() == [1.0] * 3


@pytest.mark.parametrize("step", [0.0, 30.0])
def test_a_sensor_adds_noise_counts_in_steps_and_adds_its_taxels_up(step):
    sensor = Sensor(pressure_noise=10.0, pressure_step=step, seed=5)
    sense, felt = reading(sensor), reading().read(body(np.eye(3), np.zeros(3)))
    seen = [unpacked(sensor.look(felt, sense.map.areas, number, 0), GRID) for number in (1, 1, 2)]
    np.testing.assert_array_equal(seen[0].pressures, seen[1].pressures)
    assert (seen[0].pressures != seen[2].pressures).any()
    assert seen[0].normal_force == pytest.approx(seen[0].pressures.ravel() @ sense.map.areas)
    if step:
        np.testing.assert_array_equal(seen[0].pressures % step, 0.0)
    np.testing.assert_array_equal(seen[0].force, unpacked(felt, GRID).force)
