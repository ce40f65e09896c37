"""Points of one body and of many at once, against the formulas of the reduced body, point by point."""

import numpy as np
import pytest
from soft_rom import soft_rom

from fenics_rom.rom.material_points import MaterialPoints

BODIES, ROUND_OFF = 7, 1e-10  # relative; of strains that a rotation hides most of


@pytest.fixture(scope="module")
def body():
    return soft_rom("neo_hookean").deformation


def near(found, expected):
    assert np.abs(found - expected).max() <= ROUND_OFF * np.abs(expected).max()


def test_strains_and_forces_of_many_shapes_are_those_of_each(body):
    points, q = MaterialPoints(body), 0.01 * np.random.default_rng(0).standard_normal((body.order, BODIES))
    F, E = points.strains(q)
    forces = points.resultant(F, points.stress(E))
    for k, shape in enumerate(q.T):
        near(F.reshape(3, 3, -1, BODIES)[..., k], body.displacement_gradients(shape) + np.eye(3)[:, :, None])
        near(E.reshape(6, -1, BODIES)[..., k], body.strains(shape))
        near(forces[:, k], body.force(shape) - body.springs @ shape)


def test_one_shape_may_be_given_alone_after_many(body):
    points, q = MaterialPoints(body), 0.01 * np.random.default_rng(1).standard_normal((body.order, BODIES))
    points.stress(points.strains(q)[1])
    F, E = points.strains(q[:, 0])
    near(points.resultant(F, points.stress(E))[:, 0], body.force(q[:, 0]) - body.springs @ q[:, 0])


def test_rates_are_the_slopes_of_a_parabola(body):
    points, (q, v) = MaterialPoints(body), 0.01 * np.random.default_rng(3).standard_normal((2, body.order))
    (_, after), (_, before) = points.strains(q + v), points.strains(q - v)
    near(points.rates(points.strains(q)[0], v), (after - before) / 2)


def test_energies_and_forces_are_those_of_the_body(body):
    points, q = MaterialPoints(body), 0.01 * np.random.default_rng(2).standard_normal((body.order, BODIES))
    energies, forces = points.energies_and_forces(q)
    for k, shape in enumerate(q.T):
        assert energies[k] == pytest.approx(body.elastic_energy(body.strains(shape)), rel=1e-10)
        near(forces[:, k], body.force(shape) - body.springs @ shape)
    alone = points.energies_and_forces(q[:, 0])
    near(alone[0], energies[:1])
    near(alone[1], forces[:, :1])
