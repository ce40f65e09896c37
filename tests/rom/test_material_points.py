"""Points of one body and of many at once, against the formulas of the reduced body, point by point."""

import numpy as np
import pytest
from soft_rom import soft_rom

from fenics_rom.mechanics.hyperelastic import energy_density, linear_stress
from fenics_rom.rom.material_points import MaterialPoints

BODIES, ROUND_OFF = 7, 1e-10  # relative; of strains that a rotation hides most of


@pytest.fixture(scope="module")
def body():
    return soft_rom("neo_hookean").deformation


def near(found, expected):
    assert np.abs(found - expected).max() <= ROUND_OFF * np.abs(expected).max()


def test_energies_and_forces_of_many_shapes_are_those_of_each(body):
    points, q = MaterialPoints(body), 0.01 * np.random.default_rng(0).standard_normal((body.order, BODIES))
    F, E = points.strains(q)
    left, S = points.beyond_linear(E)
    forces, beyond = points.resultant(F, points.stress(E)), points.resultant(F, S)
    λ, μ = body.weights * body.first_lame, body.weights * body.shear
    for k, shape in enumerate(q.T):
        H, strains = body.displacement_gradients(shape), body.strains(shape)
        near(F.reshape(3, 3, -1, BODIES)[..., k], H + np.eye(3)[:, :, None])
        near(E.reshape(6, -1, BODIES)[..., k], strains)
        near(forces[:, k], body.force(shape) - body.springs @ shape)
        linear = linear_stress(strains, λ, μ)
        near(forces[:, k] - beyond[:, k], body.resultant(H, linear))
        energy = energy_density(body.law, strains, λ, μ)
        assert left[k] == pytest.approx((energy - (linear * strains).sum(axis=0) / 2).sum(), rel=1e-10)
    np.testing.assert_array_equal(points.left(E), left)


def test_one_shape_may_be_given_alone_after_many(body):
    points, q = MaterialPoints(body), 0.01 * np.random.default_rng(1).standard_normal((body.order, BODIES))
    many = points.left(points.strains(q)[1])
    F, E = points.strains(q[:, 0])
    assert points.left(E) == pytest.approx(many[:1], rel=1e-10)
    near(points.resultant(F, points.stress(E))[:, 0], body.force(q[:, 0]) - body.springs @ q[:, 0])


def test_rates_are_the_slopes_of_a_parabola(body):
    points, (q, v) = MaterialPoints(body), 0.01 * np.random.default_rng(3).standard_normal((2, body.order))
    (_, after), (_, before) = points.strains(q + v), points.strains(q - v)
    near(points.rates(points.strains(q)[0], v), (after - before) / 2)


def test_a_shape_and_the_next_one_are_found_together(body):
    points, (q, soon) = MaterialPoints(body), 0.01 * np.random.default_rng(2).standard_normal((2, body.order))
    E, left, F, S = points.with_next(q, soon)
    near(E, body.strains(q))
    assert left == pytest.approx(points.left(points.strains(q)[1])[0], rel=1e-10)
    near(points.resultant(F, S)[:, 0], body.force(soon) - body.springs @ soon)
