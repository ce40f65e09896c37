"""Rotations of a moving frame, and the identities that its step stands on."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fenics_rom.mechanics.frame_motion import (
    cayley,
    cross_matrix,
    quaternion_of,
    quaternion_of_vector,
    rotation_matrix,
    turned,
)

EPS = 2.0**-52
NUMBERS = st.tuples(*[st.floats(-3, 3)] * 3)


@given(NUMBERS)
def test_rotations_are_those_of_scipy(turn):
    q, expected = quaternion_of_vector(turn), Rotation.from_rotvec(turn)
    R = rotation_matrix(q)
    assert np.abs(R - expected.as_matrix()).max() <= 10 * EPS
    assert np.abs(rotation_matrix(quaternion_of(R)) - R).max() <= 10 * EPS


@pytest.mark.parametrize("axis", np.eye(3))
def test_half_turns_have_a_quaternion(axis):
    R = rotation_matrix(quaternion_of_vector(np.pi * axis))
    assert np.abs(rotation_matrix(quaternion_of(R)) - R).max() <= 10 * EPS


@given(NUMBERS, NUMBERS, NUMBERS, NUMBERS, st.floats(1e-4, 0.5))
def test_step_of_a_turning_point_is_exact(turn, ω, u, û, h):
    u, û, ω = map(np.array, (u, û, ω))
    q = quaternion_of_vector(turn)
    R, R_end = rotation_matrix(q), rotation_matrix(turned(q, h * ω))
    assert np.abs(R_end - R @ cayley(h * ω)).max() <= 10 * EPS
    middle, end = R @ (np.eye(3) + h / 2 * cross_matrix(ω)), u + h * û
    arm = (R @ u + R_end @ end) / 2
    moved = h * np.cross(middle @ ω, arm) + h * middle @ û
    assert np.abs(R_end @ end - R @ u - moved).max() <= 1e-14  # of numbers of some units
    assert np.abs((R + R_end) / 2 @ middle.T - np.eye(3)).max() <= 10 * EPS
