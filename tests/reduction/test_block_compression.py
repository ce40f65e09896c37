"""Matrices of points in space by blocks: what is left out, that nothing gets smaller, what does not fit together."""

from dataclasses import replace

import numpy as np
import pytest

from fenics_rom.reduction.block_compression import compressed
from fenics_rom.rom.block_matrix import WHOLE


@pytest.fixture(scope="module")
def skin():
    """Points on a ball (P, 3), and displacements there under forces inside of all space (3P, 3P): Kelvin's solution."""
    places = np.random.default_rng(0).standard_normal((400, 3))
    places /= np.linalg.norm(places, axis=1)[:, None]
    apart = places[:, None] - places
    far = np.sqrt(np.square(apart).sum(axis=-1) + 0.02**2)[..., None, None]  # of forces on small balls
    A = (2.2 + 0.02**2 / far**2) * np.eye(3) + apart[..., :, None] * apart[..., None, :] / far**2
    A = (A / far).swapaxes(1, 2).reshape(1200, 1200)
    return places, (A + A.T) / 2


@pytest.mark.parametrize("tolerance", [1e-2, 1e-4])
def test_what_blocks_leave_out_is_no_more_than_they_tell(skin, tolerance):
    """In the 2-norm, so that what is made up for it makes nothing smaller; the bound is not idle, and room is saved."""
    places, A = skin
    matrix, left_out = compressed(A, places, tolerance)
    whole = matrix.whole()
    assert np.array_equal(whole, whole.T)
    values = np.linalg.eigvalsh(whole - A)
    off = np.abs(values).max()
    assert tolerance / 10 < off <= left_out < 100 * tolerance
    assert np.linalg.eigvalsh(whole + left_out * np.eye(len(A)) - A)[0] >= -1e-12 * np.abs(A).max()
    assert matrix.values.size < 0.5 * A.size
    assert matrix.mistake() == ""
    ranks = matrix.blocks[:, 4]
    assert (ranks == WHOLE).any()
    assert (ranks >= 0).any()


def test_what_several_blocks_leave_out_at_a_point_adds_up():
    """Four groups in a row, of which the last is tied to each other one by 1: √3 is missed, and 1 + √2 told."""
    places = np.zeros((64, 3))
    places[:, 0] = 10 * np.repeat(np.arange(4), 16) + np.tile(np.linspace(0, 1, 16), 4)
    groups = np.kron(np.eye(4), np.full((48, 1), 48**-0.5))
    E = groups[:, :3].sum(axis=1)[:, None] * groups[:, 3]
    E += E.T
    matrix, left_out = compressed(2 * np.eye(192) + E, places, 1.5)
    np.testing.assert_allclose(matrix.whole(), 2 * np.eye(192), rtol=0, atol=1e-15)
    assert np.linalg.eigvalsh(E)[-1] == pytest.approx(3**0.5)
    assert left_out == pytest.approx(1 + 2**0.5)


def test_of_what_may_not_be_left_out_every_number_is_kept(skin):
    places, A = skin
    matrix, left_out = compressed(A, places, 0.0)
    assert np.array_equal(matrix.whole(), A)
    assert left_out == 0.0
    assert matrix.values.size < 0.6 * A.size


def test_what_does_not_fit_together_is_told(skin):
    places, A = skin
    matrix, _ = compressed(A, places, 1e-2)
    blocks, twice = matrix.blocks, matrix.order.copy()
    twice[0] = twice[1]
    beyond = blocks.copy()
    beyond[-1, 3] += 400
    for broken, said in (
        (replace(matrix, order=twice), "order is none of 400 points"),
        (replace(matrix, blocks=beyond), "blocks are not of 400 points in a row"),
        (replace(matrix, values=matrix.values[:-1]), f"values are {len(matrix.values) - 1}, and blocks have"),
        (replace(matrix, blocks=blocks[:0], values=matrix.values[:0]), "blocks do not have each pair of points once"),
    ):
        assert broken.mistake().startswith(said)
