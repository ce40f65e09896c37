"""Surfaces cut into bands: every piece lies between its two levels, and together they are the surface."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fenics_rom.visualization.viewer.contours import Contours

BANDS = 7


def cross(corners):
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


@given(st.integers(0, 2**32 - 1), st.sampled_from(["any", "whole numbers", "one"]))
def test_bands_are_the_surface_between_their_levels(seed, kind):
    rng = np.random.default_rng(seed)
    triangles = np.array([[0, 1, 2], [0, 2, 3], [3, 2, 4], [1, 5, 2]])
    places = rng.standard_normal((6, 3))
    levels = rng.uniform(0, BANDS, 6)
    if kind != "any":
        levels = np.round(levels) if kind == "whole numbers" else np.full(6, levels[0])
    bands = Contours(triangles, BANDS).cut(levels)
    parts = bands.parts(bands.places(places))
    assert len(parts) == BANDS + 1
    assert not len(parts[BANDS][1])
    whole = sum(cross(corners[faces]).sum(axis=0) for corners, faces in parts)
    # Areas with their directions: a piece turned over, missing or there twice would change the sum.
    np.testing.assert_allclose(whole, cross(places[triangles]).sum(axis=0), atol=1e-12 * np.abs(places).max() ** 2)
    area = sum(np.linalg.norm(cross(corners[faces]), axis=1).sum() for corners, faces in parts)
    assert area == pytest.approx(np.linalg.norm(cross(places[triangles]), axis=1).sum(), rel=1e-12)
    level = (1 - bands.weight) * levels[bands.first] + bands.weight * levels[bands.second]
    for k, (begin, end) in enumerate(zip(bands.corner_ends[:-2], bands.corner_ends[1:-1], strict=True)):
        assert (level[begin:end] >= k - 1e-12).all()
        assert (level[begin:end] <= k + 1 + 1e-12).all()


def test_pieces_share_corners_and_chosen_triangles_are_left_whole():
    triangles, levels = np.array([[0, 1, 2], [2, 1, 3]]), np.array([0.0, 2.0, 2.0, 4.0])
    corners, faces = Contours(triangles, 4).cut(levels).parts(np.zeros((100, 3)))[0]
    assert (len(corners), len(faces)) == (3, 1)
    bands = Contours(triangles, 4).cut(levels, np.array([1]))
    *cut, (corners, faces) = bands.parts(bands.places(np.eye(4, 3)))
    assert len(faces) == 1
    np.testing.assert_array_equal(corners[faces[0]], np.eye(4, 3)[triangles[1]])
    assert [len(faces) for _, faces in cut] == [1, 2, 0, 0]
