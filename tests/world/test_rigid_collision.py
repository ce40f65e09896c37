"""Rigid shapes against one another: gaps and normals against whether shapes overlap, found by linear programming."""

import numpy as np
import pytest
from scipy.optimize import linprog, minimize_scalar
from scipy.spatial.transform import Rotation

from fenics_rom.errors import SceneError
from fenics_rom.world.collision.contacts import PlacedShape
from fenics_rom.world.collision.find import find_contacts
from fenics_rom.world.shapes import Box, Capsule, Cylinder, HalfSpace, Hull, Sphere

FLAT = {
    "box": Box((0.2, 0.3, 0.4)),
    "wedge": Hull([[0, 0, 0], [0.4, 0, 0], [0, 0.3, 0], [0, 0, 0.3], [0.4, 0, 0.3]]),
    "pebble": Hull(np.random.default_rng(5).standard_normal((20, 3)) * 0.15),
}
ROUND = {"sphere": Sphere(0.15), "capsule": Capsule(0.1, 0.25), "cylinder": Cylinder(0.12, 0.3)}
GROUND = PlacedShape(HalfSpace(), np.zeros(3), np.eye(3))


def placed(shape, position, turn=None):
    rotation = np.eye(3) if turn is None else Rotation.from_rotvec(turn).as_matrix()
    return PlacedShape(shape, np.array(position, dtype=float), rotation)


def near_one_another(first, second, rng):
    """Two shapes at random, overlapping a little or apart by a little."""
    direction = rng.standard_normal(3)
    direction *= rng.uniform(0.45, 0.75) * (first.radius_around + second.radius_around) / np.linalg.norm(direction)
    return placed(first, direction, rng.standard_normal(3)), placed(second, np.zeros(3), rng.standard_normal(3))


def overlap(a, b):
    """Whether two polytopes have a point in common."""
    first, second = (p.shape.vertices @ p.rotation.T + p.position for p in (a, b))
    equal = np.block(
        [
            [first.T, -second.T],
            [np.ones((1, len(first))), np.zeros((1, len(second)))],
            [np.zeros((1, len(first))), np.ones((1, len(second)))],
        ]
    )
    return linprog(np.zeros(equal.shape[1]), A_eq=equal, b_eq=[0, 0, 0, 1, 1]).status == 0


@pytest.mark.parametrize("first", FLAT)
@pytest.mark.parametrize("second", FLAT)
def test_moved_along_the_normal_by_the_gap_flat_shapes_just_touch(first, second):
    rng = np.random.default_rng(7)
    met = 0
    for _ in range(16):
        a, b = near_one_another(FLAT[first], FLAT[second], rng)
        found = find_contacts(a, b, 0.02)
        if not len(found.gaps):
            continue
        met += 1
        assert len(found.gaps) <= 8
        np.testing.assert_allclose(np.linalg.norm(found.normals, axis=1), 1.0, rtol=1e-13)
        deepest = found.gaps.argmin()
        touching = found.gaps[deepest] * found.normals[deepest]
        slack = 3e-4 * 0.3 * found.normals[deepest]  # where an axis is preferred, the gap may be too low by 2e-4
        assert not overlap(a._replace(position=a.position - touching + slack), b)
        assert overlap(a._replace(position=a.position - touching - slack), b)
        # the pairs are half way between the surfaces
        for spots, each, side in ((found.first, a, 1), (found.second, b, -1)):
            surface = spots.arms + side * found.gaps[:, None] / 2 * found.normals
            local = (surface - each.position) @ each.rotation
            assert np.abs(each.shape.distance(local)[0]).max() < 2e-2
        back = find_contacts(b, a, 0.02)
        assert back.gaps.min() == pytest.approx(found.gaps.min(), abs=1e-4)
    assert met >= 5


def test_a_box_on_a_box_has_the_corners_of_the_common_area():
    """Turned by an eighth about the vertical the common area of two squares is an octagon, else a rectangle."""
    size = (0.2, 0.2, 0.2)
    below = placed(Box(size), (0, 0, 0))
    octagon = find_contacts(placed(Box(size), (0, 0, 0.199), (0, 0, np.pi / 4)), below, 1e-3)
    assert len(octagon.gaps) == 8
    np.testing.assert_allclose(octagon.gaps, -1e-3, atol=1e-14)
    np.testing.assert_allclose(octagon.normals, [[0, 0, 1]] * 8, atol=1e-14)
    reach = 0.1 * np.sqrt(1 + (np.sqrt(2) - 1) ** 2)
    np.testing.assert_allclose(np.linalg.norm(octagon.first.arms[:, :2], axis=1), reach, rtol=1e-12)
    beside = find_contacts(placed(Box(size), (0.15, 0.02, 0.2005)), below, 1e-3)
    assert {tuple(p) for p in np.round(beside.first.arms, 9)} == {
        (x, y, 0.10025) for x in (0.05, 0.1) for y in (-0.08, 0.1)
    }
    np.testing.assert_array_equal(beside.first.arms, beside.second.arms)


def test_edges_that_cross_meet_in_one_point():
    """Two beams laid crosswise on their edges."""
    beam = Box((1.0, 0.1, 0.1))
    height = np.sqrt(2) * 0.1
    above = Rotation.from_euler("xz", [np.pi / 4, np.pi / 2 - 0.2]).as_rotvec()
    found = find_contacts(
        placed(beam, (0.03, 0.02, height - 1e-3), above), placed(beam, (0, 0, 0), (np.pi / 4, 0, 0)), 0
    )
    np.testing.assert_allclose(found.gaps, [-1e-3], rtol=1e-9)
    np.testing.assert_allclose(found.normals, [[0, 0, 1]], atol=1e-12)
    np.testing.assert_allclose(found.first.arms[0, 1:], [0, height / 2 - 5e-4], atol=1e-12)


@pytest.mark.parametrize("shape", [*FLAT, *ROUND])
def test_features_stay_when_bodies_move_a_little(shape):
    kinds = {**FLAT, **ROUND}
    for other in (*kinds.values(), HalfSpace()):
        rng = np.random.default_rng(11)
        a, b = near_one_another(kinds[shape], kinds["box"], rng)
        b = b._replace(shape=other)
        if isinstance(other, HalfSpace):
            a = a._replace(position=0.5 * kinds[shape].radius_around * b.rotation[:, 2])
        for _ in range(5):
            before = find_contacts(a, b, 0.05)
            step = 1e-9 * rng.standard_normal(3)
            moved = a._replace(position=a.position + step, rotation=Rotation.from_rotvec(step).as_matrix() @ a.rotation)
            after = find_contacts(moved, b, 0.05)
            np.testing.assert_array_equal(after.first.feature, before.first.feature)
            np.testing.assert_allclose(after.gaps, before.gaps, atol=1e-7)
            assert len(np.unique(before.first.feature)) == len(before.gaps)


@pytest.mark.parametrize("first", ["sphere", "capsule"])
@pytest.mark.parametrize("second", [*FLAT, *ROUND])
def test_round_shapes_are_as_near_as_points_of_their_axes(first, second):
    rng = np.random.default_rng(13)
    for _ in range(4):
        a, b = near_one_another(ROUND[first], {**FLAT, **ROUND}[second], rng)
        half = getattr(a.shape, "length", 0.0) / 2

        def distance(z, a=a, b=b):
            point = a.position + z * a.rotation[:, 2]
            return b.shape.distance(((point - b.position) @ b.rotation)[None])[0][0]

        nearest = (
            distance(minimize_scalar(distance, bounds=(-half, half), options={"xatol": 1e-9}).x)
            if half
            else distance(0)
        )
        found = find_contacts(a, b, 1.0)
        if nearest > 0:  # else the axis itself is inside, and the nearest face decides
            assert found.gaps.min() == pytest.approx(
                min(nearest, distance(half), distance(-half)) - a.shape.radius, abs=1e-7
            )
        k = found.gaps.argmin()
        touching = a._replace(position=a.position - found.gaps[k] * found.normals[k])
        if found.gaps[k] > -a.shape.radius / 2:
            assert find_contacts(touching, b, 1.0).gaps.min() == pytest.approx(0.0, abs=1e-6)


def test_a_capsule_that_lies_touches_at_both_ends_of_where_it_lies():
    capsule = Capsule(0.1, 1.0)
    along_x = (0, np.pi / 2, 0)
    ground = find_contacts(placed(capsule, (0, 0, 0.0999), along_x), GROUND, 1e-3)
    np.testing.assert_allclose(np.sort(ground.first.arms[:, 0]), [-0.5, 0.5], atol=1e-12)
    np.testing.assert_allclose(ground.gaps, -1e-4, atol=1e-14)
    box = placed(Box((0.6, 0.6, 0.6)), (0, 0, -0.3))
    on_box = find_contacts(placed(capsule, (0.1, 0, 0.0999), along_x), box, 1e-3)
    np.testing.assert_allclose(np.sort(on_box.first.arms[:, 0]), [-0.3, 0.3], atol=0.006)
    np.testing.assert_allclose(on_box.gaps, -1e-4, atol=2e-4)
    across = find_contacts(placed(capsule, (0, 0, 0.2), along_x), placed(capsule, (0, 0, 0), (np.pi / 2, 0, 0)), 1e-3)
    np.testing.assert_allclose(across.gaps, [0.0], atol=1e-9)


def test_a_cylinder_stands_rolls_and_leans():
    cylinder = Cylinder(0.1, 0.4)
    standing = find_contacts(placed(cylinder, (0, 0, 0.2)), GROUND, 1e-3)
    assert len(standing.gaps) == 4
    lying = find_contacts(placed(cylinder, (0, 0, 0.1), (np.pi / 2, 0, 0)), GROUND, 1e-3)
    assert set(np.round(lying.first.arms[:, 1], 12)) == {-0.2, 0.2}
    lean = 0.3
    leaning = find_contacts(placed(cylinder, (0, 0, 0.3), (lean, 0, 0)), GROUND, 0.2)
    lowest = 0.3 - 0.2 * np.cos(lean) - 0.1 * np.sin(lean)
    assert leaning.gaps.min() == pytest.approx(lowest, abs=1e-14)
    on_box = find_contacts(placed(cylinder, (0, 0, 0.2)), placed(Box((1, 1, 1)), (0, 0, -0.5)), 1e-3)
    assert len(on_box.gaps) <= 8
    np.testing.assert_allclose(on_box.gaps, 0, atol=1e-14)
    assert np.ptp(on_box.first.arms[:, 0]) == pytest.approx(0.2, rel=3e-3)


def test_a_cylinder_leans_on_the_deepest_point_of_its_rim_however_it_is_turned():
    """Below its centre by r sin + l/2 cos of its tilt; the place is halfway between it and the ground."""
    radius, length, rng = 0.12, 0.3, np.random.default_rng(3)
    for _ in range(10):
        tilt, height = rng.uniform(0.1, 1.4), 0.25
        turn = Rotation.from_euler("zyz", [*rng.uniform(-3, 3, 1), tilt, *rng.uniform(-3, 3, 1)])
        below = radius * np.sin(tilt) + length / 2 * np.cos(tilt)
        found = find_contacts(placed(Cylinder(radius, length), (0.1, 0.2, height), turn.as_rotvec()), GROUND, 0.2)
        deepest = found.gaps.argmin()
        assert found.gaps[deepest] == pytest.approx(height - below, abs=1e-14)
        assert found.first.arms[deepest, 2] == pytest.approx((height - below) / 2, abs=1e-14)


def test_a_ball_near_another_shape_is_touched_halfway():
    for other in (Sphere(0.2), Box((0.4, 0.4, 0.4))):
        found = find_contacts(placed(Sphere(0.1), (0, 0, 0.36)), placed(other, (0, 0, 0)), 0.1)
        assert found.gaps == pytest.approx([0.06], abs=1e-14)
        np.testing.assert_allclose(found.first.arms, [[0, 0, 0.23]], atol=1e-14)


def test_ground_carries_a_box_at_its_corners_and_has_no_other_ground():
    box = Box((0.2, 0.3, 0.4))
    found = find_contacts(GROUND, placed(box, (1.0, 2.0, 0.199)), 0.01)
    np.testing.assert_allclose(found.gaps, -0.001, atol=1e-14)
    np.testing.assert_allclose(found.normals, [[0, 0, -1]] * 4, atol=1e-14)  # to the first, which is the ground
    assert len(find_contacts(GROUND, placed(box, (1.0, 2.0, 0.3)), 0.01).gaps) == 0
    with pytest.raises(SceneError, match="got two"):
        find_contacts(GROUND, GROUND, 0.01)
