"""Combinations that data cannot tell, and their names."""

import numpy as np
import pytest

from fenics_rom.identification.parameters import NAMES, Parameter
from fenics_rom.identification.uncertainty import (
    correlations,
    find_unidentifiable,
    interval_half_widths,
    noise_deviation,
)

E, NU, RHO, ALPHA, BETA = (Parameter(name, k, (0,), 0.3, ("material", name)) for k, name in enumerate(NAMES))
RNG = np.random.default_rng(0)


def blind_to(direction):
    """A Jacobian (30, p) that does not see a direction."""
    n = np.array(direction) / np.linalg.norm(direction)
    return RNG.standard_normal((30, len(n))) @ (np.eye(len(n)) - np.outer(n, n))


@pytest.mark.parametrize(
    ("parameters", "direction", "held", "said"),
    [
        ((E, RHO), (0, 1), RHO, "the data do not depend on density"),
        ((E, RHO, ALPHA), (1, 1, 0), RHO, "young and density appear only as their ratio: nothing in the data, such as"),
        ((E, RHO), (-1, 1), RHO, "young and density appear only as their product"),
        ((E, ALPHA, BETA), (0, -1, 3), BETA, "more of alpha and less of beta gives the same data"),
        ((E, ALPHA, BETA), (0, 1, 3), BETA, "more of alpha and beta together gives the same data"),
    ],
)
def test_what_cannot_be_told_at_all_is_named(parameters, direction, held, said):
    found = find_unidentifiable(parameters, blind_to(direction), 0.0)
    assert found.fixed == held
    assert found.reason.startswith(said)


def test_poisson_counts_in_the_width_that_says_nothing():
    found = find_unidentifiable((E, NU), blind_to((1, 1)), 0.0)
    assert "young" in found.reason
    assert "poisson" in found.reason


def test_intervals_are_students_of_the_values_that_parameters_leave_over():
    """Of five values and two parameters: s² = |r|² / 3, and 3.182 standard errors, as tables of t have it."""
    J, residual = np.array([[1.0, 0], [1, 1], [1, 2], [1, 3], [1, 4]]), np.array([0.1, -0.2, 0.0, 0.2, -0.1])
    s = np.sqrt(0.1 / 3)
    assert noise_deviation(residual, 2) == pytest.approx(s, rel=1e-14)
    errors = s * np.sqrt([30 / 50, 5 / 50])  # of a straight line: Σx² and N over N Σx² - (Σx)²
    assert interval_half_widths(residual, J) == pytest.approx(3.182446305 * errors, rel=1e-9)
    assert correlations(J)[0, 1] == pytest.approx(-10 / np.sqrt(5 * 30), rel=1e-13)


def test_poissons_ratio_says_something_in_intervals_twice_as_wide():
    J = np.diag([100.0, 0.6])
    assert find_unidentifiable((E, NU), J, 1.0) is None
    assert find_unidentifiable((E, RHO), J, 1.0).fixed == RHO


def test_what_is_told_is_left_alone_and_what_noise_hides_is_not():
    J = np.diag([100.0, 1.0])
    assert find_unidentifiable((E, RHO), J, 0.0) is None
    assert find_unidentifiable((E, RHO), J, 0.5) is None
    found = find_unidentifiable((E, RHO), J, 1.5)
    assert found.fixed == RHO
    assert found.reason.startswith("the data hardly depend on density; density was left at 0.3 kg/m3")
