from dataclasses import replace

import numpy as np
import pytest
from soft_rom import soft_rom

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning
from fenics_rom.mechanics.step import FINITE_STRAIN_STEPPERS
from fenics_rom.rom import carried_strains
from fenics_rom.rom.carried_strains import MonomialStrains, PointStrains
from fenics_rom.rom.deformation import TrainingRange
from fenics_rom.rom.material_points import MaterialPoints
from fenics_rom.runtime.steppers.training_watch import STRAIN

LAWS = ("st_venant_kirchhoff", "neo_hookean")
ROUND_OFF = 1e-12  # relative; of shapes that a rotation hides most of


@pytest.fixture(scope="module")
def bodies():
    return {law: soft_rom(law) for law in LAWS}


def test_monomials_have_the_energy_forces_and_stiffness_of_all_points(bodies):
    body = bodies[LAWS[0]].deformation
    monomials, points = MonomialStrains(body), PointStrains(body)
    rng = np.random.default_rng(0)
    for _ in range(5):
        q, v, carried = 0.01 * rng.standard_normal((3, body.order))
        one, other = monomials.around(q), points.around(q)
        found = [
            (
                strains.at(carried) @ strains.stressed(strains.at(carried)),
                *near.elastic,
                near.pulled(strains.stressed(strains.at(carried))),
                near.pulled(strains.viscosity * strains.stressed(near.rates(v))),
                near.pulled(strains.stressed(strains.rates(carried, v))),
                near.stiffness(1e-3),
                near.pulled(strains.stressed(near.damped(v, 1e-3, is_elastic=True))),
                near.pulled(strains.stressed(near.damped(v, 1e-3, is_elastic=False))),
                np.array(near.squares(v)),
                strains.geometric(strains.stressed(strains.at(carried))),
                *after_and_next(strains, carried, q, v),
            )
            for strains, near in ((monomials, one), (points, other))
        ]
        for part, expected in zip(*found, strict=True):
            assert np.abs(part - expected).max() <= ROUND_OFF * np.abs(expected).max()


def after_and_next(strains, q, middle, v):
    """Energy at q, forces by what is damped around another shape, elastic and not, and there by the stresses at q."""

    def as_found_alone(found, alone):
        assert np.abs(found - alone).max() <= ROUND_OFF * np.abs(alone).max()
        return found

    stresses, alone = strains.stressed(strains.at(q)), strains.around(middle)
    for is_elastic in (True, False):
        shape, near, damped = strains.with_next(q, middle, v, 1e-3, is_elastic)
        yield as_found_alone(shape.energy, strains.at(q) @ stresses / 2)
        yield as_found_alone(damped, alone.pulled(strains.stressed(alone.damped(v, 1e-3, is_elastic))))
        yield as_found_alone(near.stiffness(0.0), alone.stiffness(0.0))
    near, pulled = shape.around(middle)
    yield as_found_alone(pulled, alone.pulled(stresses))
    yield as_found_alone(near.stiffness(0.0), alone.stiffness(0.0))


def test_stresses_of_rows_are_those_of_each(bodies):
    body = bodies[LAWS[0]].deformation
    for strains in (MonomialStrains(body), PointStrains(body)):
        rows = np.array([strains.at(q) for q in 0.01 * np.random.default_rng(0).standard_normal((3, body.order))])
        for row, found in zip(rows, strains.stressed(rows), strict=True):
            np.testing.assert_allclose(found, strains.stressed(row), rtol=0, atol=ROUND_OFF * np.abs(found).max())


@pytest.mark.parametrize("law", LAWS)
def test_a_step_in_monomials_is_that_in_points(bodies, law, monkeypatch):
    def after(steps):
        simulator = fr.Simulator(bodies[law], 2e-3, stepper=FINITE_STRAIN_STEPPERS[1])
        for _ in range(steps):
            simulator.step([0.0, 0.0, 0.2, 0.0, 0.5])
        return np.concatenate(simulator.state), simulator.energy, simulator.ledger.dissipated

    monomials = [after(steps) for steps in (1, 100)]
    monkeypatch.setattr(carried_strains, "MOST_MODES", 0)
    for found, expected, bound in zip(monomials, [after(steps) for steps in (1, 100)], (1e-12, 1e-10), strict=True):
        assert np.abs(found[0]).max() > 0
        for one, other in zip(found, expected, strict=True):
            assert np.abs(one - other).max() <= bound * np.abs(other).max()


def test_of_strains_beyond_training_none_is_missed(bodies, monkeypatch):
    """The strains of the points are looked at only where they may be beyond training."""
    body = bodies[LAWS[0]].deformation
    asked = []
    strains_of = MaterialPoints.strains
    monkeypatch.setattr(MaterialPoints, "strains", lambda self, q: asked.append(1) or strains_of(self, q))

    def largest(limit):
        trained = TrainingRange({}, {"tip": 1.0}, np.full(len(body.weights), limit), 0.1)
        rom = replace(bodies[LAWS[0]], deformation=replace(body, trained=trained))
        simulator = fr.Simulator(rom, 2e-3, stepper="linearly-implicit")
        told, true = [], 0.0
        for _ in range(100):
            simulator.step([0.0, 0.0, 0.2, 0.0, 0.0])
            E = body.strains(simulator.state[0])
            true = max(true, np.sqrt(((E**2).T / [1, 1, 1, 2, 2, 2]).sum(axis=1).max()))
            told.append(simulator._stepper.kernel.notes[STRAIN])
        return told, true

    with pytest.warns(FenicsRomWarning, match="strain of a kept point"):
        told, true = largest(1e-3)
    assert told[-1] == pytest.approx(true / 1e-3, rel=1e-12)
    asked.clear()
    told, _ = largest(3 * true)
    assert told[-1] == 0
    assert len(asked) < 60
