import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fenics_rom.certification.search import SAFETY, search

RANDOM = np.random.default_rng(3).random((4000, 3))


def strike(x):
    """Force, pressure and energy of a mass on a spring, over speed, mass and stiffness."""
    v, m, k = 0.5 + x[0], 0.4 + 0.4 * x[1], 7e4 + 2e4 * x[2]
    return np.array([v * np.sqrt(m * k), (v * np.sqrt(m * k)) ** 0.7, m * v**2 / 2])


@pytest.mark.parametrize("tolerance", [0.3, 0.1, 0.02])
def test_the_bound_is_above_all_values_and_within_the_tolerance(tolerance):
    cover = search(strike, 3, tolerance, 2000)
    largest = np.array([strike(x) for x in RANDOM]).max(axis=0)
    assert (largest <= cover.bound).all()
    assert (cover.bound <= (1 + tolerance) * cover.largest).all()
    assert len(cover.middles) <= {0.3: 15, 0.1: 30, 0.02: 120}[tolerance]


def test_a_corner_above_its_box_makes_slopes_larger():
    cover, ends = search(lambda x: np.array([1 + x[0] ** 8]), 1, 0.1, 3), np.array([[0.0], [1.0]])
    assert cover.at_most[2] < 2
    assert cover.fitted(ends, 1 + ends**8).at_most[2] == pytest.approx(2, rel=1e-14)
    assert cover.fitted(ends, np.ones((2, 1))).bound == cover.bound
    assert cover.fitted(np.empty((0, 1)), np.empty((0, 1))).bound == cover.bound


def test_boxes_cover_the_ranges_once():
    cover = search(strike, 3, 0.05, 2000)
    assert cover.widths.prod(axis=1).sum() == pytest.approx(1, abs=1e-12)
    inside = np.abs(RANDOM[:, None] - cover.middles) <= cover.widths / 2
    assert (inside.all(axis=2).sum(axis=1) == 1).all()


@settings(max_examples=50, deadline=None)
@given(
    st.lists(st.floats(0.5, 1), min_size=2, max_size=2),
    st.lists(st.floats(-0.5, 0.5), min_size=2, max_size=2),
    st.integers(0, 5),
)
def test_no_function_that_bends_a_little_is_above_its_bound(slopes, bends, bend):
    """Of quadratic functions, whose slopes between thirds are at least two thirds of the largest there are."""
    linear, square = np.array(slopes), np.array(bends)

    def values(x):
        return np.array([3 + linear @ x + square @ (x - 0.2 * bend) ** 2 / 4])

    cover = search(values, 2, 0.05, 200)
    grid = np.stack(np.meshgrid(*[np.linspace(0, 1, 41)] * 2), axis=-1).reshape(-1, 2)
    assert max(values(x)[0] for x in grid) <= cover.bound[0] * (1 + 1e-12)


def test_the_search_ends_after_its_runs():
    cover = search(lambda x: np.array([np.sin(40 * x[0]) + 2]), 1, 1e-3, 20)
    assert 20 <= len(cover.middles) <= 22
    assert cover.bound[0] > 3  # and says that more is possible


def test_what_is_the_same_everywhere_takes_a_run_for_each_end():
    cover = search(lambda x: np.array([2.0, 0.0]), 2, 0.1, 100)
    assert len(cover.middles) == 5
    assert cover.bound.tolist() == [2.0, 0.0]
    assert SAFETY > 1
