"""Laws of rubber in the tests that laboratories make, against what is printed of them, and where they give way."""

import numpy as np
import pytest

from fenics_rom.mechanics.hyperelastic import energy_density, stress
from fenics_rom.mechanics.isochoric import isochoric_terms
from fenics_rom.mechanics.rubber_tests import TESTS, check_stable, nominal_stress, stable_stretches

STRETCH = np.array([0.4, 0.8, 1.0, 1.5, 2.5, 4.0])
LAWS = ("mooney_rivlin 2 1", "yeoh 1 0.3 0.01", "ogden 1 4 -0.2 -3", "gent 97.2", "arruda_boyce 5.1")


@pytest.mark.parametrize(
    ("law", "test", "expected"),
    [
        ("mooney_rivlin 2 1", "uniaxial", lambda x: (2 + 1 / x) * (x - x**-2) / 3),
        ("mooney_rivlin 2 1", "planar", lambda x: x - x**-3),
        ("mooney_rivlin 2 1", "equibiaxial", lambda x: (2 + x**2) * (x - x**-5) / 3),
        ("ogden 1 3 1 -1", "uniaxial", lambda x: (x**2 - x**-2.5 + x**-2 - x**-0.5) / 1),
        ("gent 30", "uniaxial", lambda x: 30 / (33 - x**2 - 2 / x) * (x - x**-2)),
        ("gent 30", "planar", lambda x: 30 / (32 - x**2 - x**-2) * (x - x**-3)),
    ],
)
def test_nominal_stresses_are_what_is_printed(law, test, expected):
    scale = sum(2 * term.k * term.β**2 for term in isochoric_terms(law) if term.n == 1)
    assert scale == pytest.approx(1, rel=1e-14)  # stresses are over the modulus at rest
    found = nominal_stress(isochoric_terms(law), test, STRETCH)
    np.testing.assert_allclose(found, expected(STRETCH), rtol=1e-12, atol=1e-14)


def test_arruda_and_boyce_follow_the_inverse_langevin_function():
    """P = μ/3 √N/λc L⁻¹(λc/√N) (λ - λ⁻²), λc² = I1/3, whose series these five terms are the first of."""
    stretch, locking = np.array([1.2, 1.5, 2.0]), 6.0
    first = stretch**2 + 2 / stretch
    y = np.sqrt(first / 3) / locking
    x = 3 * y  # L(x) = y by Newton's method
    for _ in range(50):
        x -= (1 / np.tanh(x) - 1 / x - y) / (1 / x**2 - 1 / np.sinh(x) ** 2)
    whole = x / y * (stretch - stretch**-2)
    at_rest = nominal_stress(isochoric_terms(f"arruda_boyce {locking}"), "uniaxial", stretch)
    x0, y0 = 3 / locking, 1 / locking
    for _ in range(50):
        x0 -= (1 / np.tanh(x0) - 1 / x0 - y0) / (1 / x0**2 - 1 / np.sinh(x0) ** 2)
    np.testing.assert_allclose(at_rest, whole / (x0 / y0), rtol=5 * y.max() ** 10)  # the next term


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("test", TESTS)
def test_they_are_of_the_law_that_bodies_have(law, test):
    """The stress of points at these stretches, with the pressure that leaves the third side free."""
    sides = STRETCH[:, None] ** np.array(TESTS[test])
    E, one = np.zeros((6, len(STRETCH))), np.ones(len(STRETCH))
    E[:3] = (sides.T**2 - 1) / 2
    kirchhoff = sides.T**2 * stress(law, E, 2 * one, one)[:3]
    expected = (kirchhoff[0] - kirchhoff[2]) / STRETCH
    found = nominal_stress(isochoric_terms(law), test, STRETCH)
    np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-13)


@pytest.mark.parametrize("law", ["yeoh 1 -0.05", "mooney_rivlin 1 -0.3", "ogden 1 2 -0.1 4", "gent 30"])
@pytest.mark.parametrize("test", TESTS)
def test_a_law_is_stable_where_small_changes_take_work(law, test):
    """Against differences of its energy: before the end the least curvature is above 0, beyond it below."""
    ends, limits = stable_stretches(law, test, 0.2, 5.0), (0.2, 5.0)
    for stretch, side in zip(ends, (-1, 1), strict=True):
        a = np.log(stretch) * np.array(TESTS[test])
        beyond = np.abs(a).max() < 0.99 * np.log(limits[1])
        assert least_curvature(law, 0.97 * a) > 0
        assert not beyond or least_curvature(law, 1.03 * a) < 0
        assert side * (stretch - 1) > 0
    assert law != "yeoh 1 -0.05" or ends[1] < 5


def least_curvature(law, a, t=1e-4):
    def energy(one, two):
        logs = a + np.array([one, two, -one - two])
        E = np.zeros((6, 1))
        E[:3, 0] = np.expm1(2 * logs) / 2
        return energy_density(law, E, 2 * np.ones(1), np.ones(1))[0]

    middle = energy(0, 0)
    first, second = ((energy(*t * e) - 2 * middle + energy(*-t * e)) / t**2 for e in np.eye(2))
    mixed = (energy(t, t) - energy(t, -t) - energy(-t, t) + energy(-t, -t)) / (4 * t**2)
    return np.linalg.eigvalsh([[first, mixed], [mixed, second]])[0]


def test_a_law_that_gives_way_is_refused_with_the_stretch():
    check_stable("yeoh 1 -0.05", 0.8, 1.3)
    with pytest.raises(ValueError, match=r"uniaxial test it is not stable beyond a stretch of 2\.56.* from 0\.4 to 3"):
        check_stable("yeoh 1 -0.05", 0.4, 3.0)
