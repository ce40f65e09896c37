"""Viscosity that resists J'/J, of points beside tables: what it is at a shape, and what is owed back."""

import numpy as np
import pytest
from soft_rom import soft_rom

from fenics_rom.mechanics.hyperelastic import strain, volume_viscosity
from fenics_rom.rom.volume_viscosity import VolumeViscosity


@pytest.fixture(scope="module")
def body():
    return soft_rom("neo_hookean", order=5).deformation


@pytest.fixture
def drawn(body):
    """A shape, two velocities, and by how much strains of 0.1 are larger than those of a unit of a mode."""
    size = 0.1 / np.abs(body.gradients).max()
    return size * np.random.default_rng(3).standard_normal((3, 5)), size


def slopes(function, x, size):
    return np.array([(function(x + d) - function(x - d)) / (2e-6 * size) for d in 1e-6 * size * np.eye(len(x))])


def test_forces_and_stresses_are_those_of_the_law(body, drawn):
    (q, v, y), _ = drawn
    H = body.displacement_gradients(q)
    rates = body.strain_rates(H) @ v
    S = body.weights * body.viscosity * volume_viscosity(strain(H), rates, body.material.dilating)
    force, volumes = body.resultant(H, S), VolumeViscosity.of(body)
    around = volumes.around(q)
    for found, expected in (
        (around.stress(v), S),
        (around.force(v), force),
        (around.matrix @ v, force),
        (volumes.around(np.stack([y, q], axis=1)).forces(np.stack([q, v], axis=1))[:, 1], force),
        (volumes.around(np.stack([y, q], axis=1)).matrices[1], around.matrix),
    ):
        assert np.abs(found - expected).max() <= 1e-12 * np.abs(expected).max()


def test_what_is_owed_to_the_shape_and_to_rates_is_the_slope(body, drawn):
    (q, v, y), size = drawn
    volumes, rng = VolumeViscosity.of(body), np.random.default_rng(4)
    around, W, M = volumes.around(q), rng.standard_normal((5, 5)), rng.standard_normal((6, len(body.weights)))
    by_q, by_v = around.stress_back(M, v)
    for found, function, at in (
        (around.form_back(y, v), lambda q: y @ volumes.around(q).matrix @ v, q),
        (around.matrix_back(W + W.T), lambda q: np.sum((W + W.T) * volumes.around(q).matrix), q),
        (by_q, lambda q: np.sum(M * volumes.around(q).stress(v)), q),
        (by_v, lambda v: np.sum(M * around.stress(v)), v),
    ):
        expected = slopes(function, at, size)
        assert np.abs(found - expected).max() <= 1e-7 * np.abs(expected).max()
