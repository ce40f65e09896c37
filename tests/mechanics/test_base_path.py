"""The path of a rigid base: twists are the rates of its poses, rows are met, and what no base can do is told."""

from dataclasses import replace

import numpy as np
import pytest

import fenics_rom as fr
from fenics_rom.errors import StepError
from fenics_rom.mechanics.base_fit import misfit
from fenics_rom.mechanics.base_path import (
    BasePath,
    BaseState,
    checked_base,
    given_base,
    quaternion_product,
    rotation_vectors,
)
from fenics_rom.mechanics.frame_geometry import Geometry
from fenics_rom.mechanics.frame_motion import ZERO, rotation_of

RADIUS, SWING = 0.1, 0.3  # m, s: a quarter turn about y from rest to rest


def swing(rows, end=SWING):
    """A smooth swing, sampled: angle and its rate are known at every time."""
    t = np.linspace(0.0, end, rows)
    s = t / SWING
    angle = np.pi / 2 * (10 * s**3 - 15 * s**4 + 6 * s**5)
    rate = np.pi / 2 / SWING * 30 * s**2 * (1 - s) ** 2
    zero = np.zeros(rows)
    return BasePath(
        times=t,
        positions=RADIUS * np.column_stack([np.cos(angle), zero, -np.sin(angle)]),
        rotations=np.column_stack([np.cos(angle / 2), zero, np.sin(angle / 2), zero]),
        velocities=RADIUS * rate[:, None] * np.column_stack([-np.sin(angle), zero, -np.cos(angle)]),
        angular_velocities=np.column_stack([zero, rate, zero]),
    )


def alone(path):
    return replace(path, velocities=None, angular_velocities=None)


@pytest.fixture
def tumbling():
    """Rows of any kind: a random walk of poses, with any twists, and quaternions of either sign."""
    rng = np.random.default_rng(1)
    rotations = np.array([[1.0, 0.0, 0.0, 0.0]])
    for axis in rng.normal(size=(7, 3)):
        turn = np.concatenate([[2.0], axis / np.linalg.norm(axis)])
        rotations = np.vstack([rotations, -quaternion_product(turn / np.linalg.norm(turn), rotations[-1])])
    times = np.cumsum(rng.uniform(0.1, 1.0, 8))
    return BasePath(times, rng.normal(size=(8, 3)), rotations, rng.normal(size=(8, 3)), rng.normal(size=(8, 3)))


@pytest.mark.parametrize("spline", [False, True])
def test_twists_are_the_rates_of_poses_everywhere(tumbling, spline):
    path = alone(tumbling) if spline else tumbling
    d = 1e-6
    inside = (path.times[:-1, None] + np.diff(path.times)[:, None] * [0.1, 0.5, 0.8]).ravel()
    for time in inside:
        before, now, after = path(time - d), path(time), path(time + d)
        turn = quaternion_product(after.rotation, before.rotation * [1, -1, -1, -1])
        np.testing.assert_allclose((after.position - before.position) / (2 * d), now.velocity, atol=1e-7)  # d² f'''
        np.testing.assert_allclose(rotation_vectors(turn) / (2 * d), now.angular_velocity, atol=1e-7)
        assert abs(np.linalg.norm(now.rotation) - 1) < 1e-15


def test_rows_are_met_and_beyond_them_the_base_stands(tumbling):
    for k, time in enumerate(tumbling.times):
        position, rotation, velocity, angular_velocity = tumbling(time)
        np.testing.assert_allclose(position, tumbling.positions[k], atol=1e-15)
        assert abs(abs(rotation @ tumbling.rotations[k]) - 1) < 1e-14
        np.testing.assert_allclose(velocity, tumbling.velocities[k], atol=1e-13)
        np.testing.assert_allclose(angular_velocity, tumbling.angular_velocities[k], atol=1e-13)
    for time, k in ((tumbling.times[0] - 1, 0), (tumbling.times[-1] + 1, -1)):
        assert not np.any([tumbling(time).velocity, tumbling(time).angular_velocity])
        np.testing.assert_allclose(tumbling(time).position, tumbling.positions[k], atol=1e-15)


@pytest.mark.parametrize("spline", [False, True])
def test_smooth_swing_is_met_to_third_order_in_its_rates(spline):
    fine, errors = swing(1201), []
    for rows in (13, 25, 49):
        path = alone(swing(rows)) if spline else swing(rows)
        errors.append(
            max(
                np.abs(path(time).angular_velocity - rate).max()
                for time, rate in zip(fine.times, fine.angular_velocities, strict=True)
            )
        )
    assert np.all(np.diff(np.log2(errors)) < -2.7), errors
    assert errors[-1] < 1e-3


def test_spline_through_poses_has_no_kinks_in_its_rates(tumbling):
    path, d = alone(tumbling), 1e-6
    for time in path.times[1:-1]:  # 5e-3: rates of rates are of size 100 here
        left, right = ((path(time + side * d).velocity - path(time).velocity) / (side * d) for side in (-1, 1))
        np.testing.assert_allclose(left, right, atol=5e-3)


def along_x(times, way, turns=None):
    """Poses on a line, m, which turn about z, rad."""
    half = np.zeros(len(times)) if turns is None else np.array(turns) / 2
    rows = np.zeros(len(times))
    quaternions = np.stack([np.cos(half), rows, rows, np.sin(half)], axis=1)
    return BasePath(np.array(times), np.stack([np.array(way), rows, rows], axis=1), quaternions)


MISTAKES = {
    "its position at 0.75 s is (-1.33, 0, 0) m, and all rows are between": along_x([0, 1, 1.1, 2.0], [0, 0, 1, 1.0]),
    "its rotation at 0.027575 s is (-10.5,": along_x([0, 0.02, 0.0201, 0.05], np.zeros(4), [0, 0, 1.5, 1.5]),
    "length 1.1": replace(swing(13), rotations=1.1 * swing(13).rotations),
    "turns by 3.14 rad from 0 s to 0.3 s": BasePath(
        np.array([0.0, 0.3]), np.zeros((2, 3)), np.array([[1.0, 0, 0, 0], [0, 0, 0, 1.0]])
    ),
    "velocity and position do not fit each other: from 0.1": replace(swing(13), velocities=2 * swing(13).velocities),
    "angular_velocity and rotation do not fit": replace(swing(13), angular_velocities=-swing(13).angular_velocities),
    "jumps at 0.15 s: it stops with velocity (-0.694, 0, -0.694) m/s": swing(13, end=0.15),
    "jumps at 0.15 s: it starts with angular_velocity": replace(
        swing(25),
        times=swing(25).times[12:],
        positions=np.zeros((13, 3)),
        rotations=swing(25).rotations[12:],
        velocities=np.zeros((13, 3)),
        angular_velocities=swing(25).angular_velocities[12:],
    ),
}


@pytest.mark.parametrize(("said", "path"), MISTAKES.items(), ids=range(len(MISTAKES)))
def test_what_no_base_can_do_is_told(said, path):
    assert said in path.mistake(duration=1.0)
    assert len(path.mistake(duration=1.0)) < 320


def test_what_a_base_can_do_is_taken(tumbling):
    assert swing(13).mistake(1.0) == alone(swing(4)).mistake(1.0) == alone(tumbling).mistake(9.0) == ""
    assert swing(13, end=0.15).mistake(0.15) == ""  # the rows cover the run
    still = BasePath(np.arange(2.0), np.full((2, 3), 1e-17), np.array([[1.0, 0, 0, 0]] * 2), *np.zeros((2, 2, 3)))
    assert still.mistake(3.0) == ""
    for phase in np.linspace(0, 6, 25):  # of a swing in four rows, which reaches farther than they do by 0.2 of its way
        times = np.arange(17) / 4
        assert along_x(times, np.sin(2 * np.pi * times + phase)).mistake(4.0) == ""
    assert along_x(np.arange(8.0), [0, 0, 0, 0, 1, 1, 1, 1.0]).mistake(7.0) == ""


def test_what_is_given_in_python_is_checked():
    state = fr.BaseState(np.zeros(3), np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(3))
    assert given_base(lambda time: state)(0.5).rotation.tolist() == [1, 0, 0, 0]
    assert given_base(swing(13))(0.15).velocity.shape == (3,)
    for bad, said in (
        (state._replace(rotation=np.ones(4)), "the rotation has length 2: use a unit quaternion"),
        (state._replace(velocity=np.array([0, 0, np.nan])), "use a BaseState: position"),
        (3.0, "use a BaseState"),
        (None, "use a BaseState"),
    ):
        with pytest.raises(StepError, match=f"base = .*{said}|base: {said}"):
            checked_base(bad, "base")


ROWS = np.array([0.0, 1.0, 2.0]), np.zeros((3, 3)), np.tile([1.0, 0.0, 0.0, 0.0], (3, 1))
TURNED_ROUND = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [1.0, 0.0, 0.0, 0.0]])


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"times": [0.0, 1.0, 0.5]}, "times: use times that increase strictly"),
        ({"times": [0.0, 1.0, 1.0]}, "times: use times that increase strictly"),
        ({"times": [0.0, np.nan, 1.0]}, "times is of shape .*: use finite numbers"),
        ({"positions": np.full((3, 3), np.nan)}, "positions is of shape .*: use finite numbers"),
        ({"rotations": TURNED_ROUND}, "the base turns by 3.14 rad from 0 s to 1 s: use more rows, of at most 2 rad"),
    ],
)
def test_paths_that_are_none_are_refused_in_python(changed, said):
    """As those of files are, before a run begins."""
    path = BasePath(**dict(zip(("times", "positions", "rotations"), ROWS, strict=True)) | changed)
    with pytest.raises(StepError, match=f"palm: {said}"):
        given_base(path, "palm")


@pytest.mark.parametrize("angle", [1e-3, 1.0, 3.0, np.pi])
def test_by_how_much_a_base_turns_otherwise_is_told_in_rad(angle):
    turned = np.array([np.cos(angle / 2), 0.0, np.sin(angle / 2), 0.0])
    start = BaseState(np.zeros(3), ROWS[2][0], np.zeros(3), np.zeros(3))
    end = start._replace(rotation=turned, position=np.array([1.0, 0.0, 0.0]))
    still = Geometry(*(rotation_of(1.0, 0.0, 0.0, 0.0),) * 2, ZERO)
    assert misfit(start, end, still, ZERO, 1e-3, 0.1) == pytest.approx((1.0, angle), rel=1e-12)
