"""Some of the bodies along the last axis: as NumPy's indexing has it, and laid out as the whole."""

import numpy as np
import pytest

from fenics_rom.mechanics.body_axis import add, in_one_piece, put, taken

SOME = np.array([3, 4, 5]), np.array([6, 0, 2]), np.array([], int), np.array([4])


@pytest.mark.parametrize("bodies", SOME)
def test_bodies_are_taken_put_and_added_to_as_by_indices(bodies):
    part = np.random.default_rng(0).standard_normal((2, 3, 7))
    expected, values = part.copy(), np.random.default_rng(1).standard_normal((2, 3, len(bodies)))
    for places in (bodies, in_one_piece(bodies)):
        np.testing.assert_array_equal(taken(part, places), part[..., bodies])
    assert taken(part, bodies).flags.c_contiguous
    expected[..., bodies] = values
    for places in (bodies, in_one_piece(bodies)):
        whole = part.copy()
        put(whole, places, values)
        np.testing.assert_array_equal(whole, expected)
        add(whole, places, values)
        np.testing.assert_array_equal(whole[..., bodies], 2 * values)


def test_only_bodies_in_a_row_are_one_piece():
    assert in_one_piece(np.array([3, 4, 5])) == slice(3, 6)
    assert in_one_piece(np.array([7])) == slice(7, 8)
    for bodies in (np.array([3, 5]), np.array([5, 4]), np.array([4, 3, 5, 6]), np.array([], int)):
        assert in_one_piece(bodies) is bodies


def test_nothing_is_put_into_a_copy():
    with pytest.raises(AssertionError):
        put(np.zeros((3, 4))[:, ::2], np.array([1]), np.ones((3, 1)))
