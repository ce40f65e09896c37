"""Many bodies that bend far against single ones, and the exact laws for each of them."""

from copy import copy
from dataclasses import replace

import numpy as np
import pytest
from soft_rom import soft_rom

import fenics_rom as fr
from fenics_rom.errors import StepError

SIZE, LAWS = 5, ("st_venant_kirchhoff", "neo_hookean")
ROUND_OFF = 1e-11  # of the largest state after some 100 steps: rounding that stiff modes and tangents carry on


@pytest.fixture(scope="module")
def rom():
    return soft_rom()


@pytest.fixture(scope="module")
def other_rom():
    return soft_rom("neo_hookean")


def loads(random, strength=1.0):
    """A push on the tip, a pressure and a tension for every body."""
    u = np.zeros((SIZE, 5))
    u[:, 2:] = strength * random.standard_normal((SIZE, 3)) * [0.2, 30.0, 1.0]
    u[:, 4] = np.abs(u[:, 4])
    return u


def assert_follows(batch, bodies):
    for part, found in enumerate(batch.state()):
        exact = np.array([body.state[part] for body in bodies])
        assert np.abs(found - exact).max() <= ROUND_OFF * np.abs(exact).max()


@pytest.mark.parametrize("law", LAWS)
def test_bodies_of_a_batch_bend_as_single_ones(rom, other_rom, law):
    rom = rom if law == LAWS[0] else other_rom
    random, h = np.random.default_rng(0), 2e-3
    batch = fr.Batch(rom, SIZE, h, ledger=True)
    bodies = [fr.Simulator(rom, h, stepper="linearly-implicit") for _ in range(SIZE)]
    for step in range(120):
        if step == 40:
            batch.switch("middle", [0, 2])
            for body in (bodies[0], bodies[2]):
                body.switch("middle")
        if step == 70:
            batch.dt = 1e-3
            for body in bodies:
                body.dt = 1e-3
        if step == 90:
            batch.reset([1])
            bodies[1].reset()
        u = loads(random)
        batch.step(u)
        for body, given in zip(bodies, u, strict=True):
            body.step(given)
    assert_follows(batch, bodies)
    tips = np.array([body.displacement("tip") for body in bodies])
    assert np.abs(tips).max() > 5e-3
    np.testing.assert_allclose(batch.displacement("tip"), tips, atol=1e-12)
    for found, name in ((batch.energy, "energy"), (batch.supplied, "supplied"), (batch.dissipated, "dissipated")):
        exact = [body.energy if name == "energy" else getattr(body.ledger, name) for body in bodies]
        kept = [0, 2, 3] if name != "energy" else slice(None)  # accounts of the others begin elsewhere
        np.testing.assert_allclose(found[kept], np.array(exact)[kept], rtol=1e-9)
    assert not batch.beyond_training.any()
    other = fr.Batch(rom, SIZE, 1e-3)
    other.switch(batch.contact)
    for each in (other, batch):
        each.set_state(*batch.state())
        each.step(u)
    for part, expected in zip(batch.state(), other.state(), strict=True):
        np.testing.assert_array_equal(part, expected)


@pytest.mark.parametrize(("law", "damped"), [(LAWS[0], True), (LAWS[0], False), (LAWS[1], True)])
def test_account_of_every_body_closes_at_any_step(law, damped):
    random = np.random.default_rng(1)
    rom = soft_rom(law) if damped else soft_rom(law, alpha=0.0, beta=0.0)
    batch = fr.Batch(rom, SIZE, 1e-3, ledger=True)
    least = 1e-6 if law == LAWS[0] else rom.deformation.shear @ rom.deformation.weights / 10  # J
    scale, dissipated = np.full(SIZE, least), np.zeros(SIZE)
    for _ in range(60):
        batch.dt = 10 ** random.uniform(-5, 0)
        batch.step(loads(random, 10 ** random.uniform(-2, 2)) * (random.random() < 0.5))
        scale = np.maximum(scale, np.maximum(batch.energy, np.abs(batch.supplied)))
        assert (np.abs(batch.energy - batch.supplied + batch.dissipated) <= 1e-10 * scale).all()
        assert (batch.dissipated >= -1e-12 * scale).all()
        dissipated = batch.dissipated
    assert dissipated.max() > 1e-6 or not damped


def test_a_body_that_diverges_does_not_stop_the_others(rom):
    random = np.random.default_rng(2)
    batch = fr.Batch(rom, SIZE, 4e-3, ledger=True)
    for _ in range(5):
        batch.step(loads(random))
    far, u = [part.copy() for part in batch.state()], loads(random)
    far[0][3] = 1.9e74 * np.minimum(1.0, 1e3 / np.sqrt(rom.stiffness))
    batch.set_state(*far)
    other = copy(batch)
    other.reset([3])
    before = [*batch.state(), batch.time, batch.supplied, batch.mismatch]
    with pytest.raises(StepError, match="step 5, body 3"):
        batch.step(u)
    for part, kept in zip([*batch.state(), batch.time, batch.supplied, batch.mismatch], before, strict=True):
        np.testing.assert_array_equal(part, kept)
    assert batch.step(u, on_error="hold").tolist() == [3]
    other.step(u)
    anew = copy(batch)
    assert anew.step(u, on_error="reset").tolist() == [3]
    assert not np.any([anew.time[3], anew.supplied[3], *anew.state(3)[0][0]])
    others = [0, 1, 2, 4]
    for part, kept, expected in zip(batch.state(), before, other.state(), strict=False):
        np.testing.assert_array_equal(part[3], kept[3])
        np.testing.assert_array_equal(part[others], expected[others])
    assert batch.time[3] < batch.time[0]
    batch.reset([3])
    u[1] = np.nan
    follows = copy(batch)
    assert batch.step(u, on_error="hold").tolist() == [1]
    batch.reset([0, 2, 3, 4])
    follows.reset([0, 2, 3, 4])
    for each in (batch, follows):
        each.step(np.zeros(5))
    for part, expected in zip(batch.state(), follows.state(), strict=True):
        np.testing.assert_array_equal(part, expected)


def test_far_bodies_and_long_steps_are_told(rom):
    batch = fr.Batch(rom, 2, 2e-3)
    for _ in range(60):
        batch.step([[0, 0, 0.05, 0, 0], [0, 0, 500.0, 0, 0]])
    assert batch.beyond_training.tolist() == [False, True]
    assert batch.mismatch[1] > batch.mismatch[0] >= 0
    batch.reset([1])
    assert not batch.beyond_training.any()


def test_bodies_of_several_damping_ratios_are_stepped_one_after_another(rom):
    viscosity = rom.deformation.viscosity * np.linspace(1, 2, len(rom.deformation.weights))
    rom = replace(rom, deformation=replace(rom.deformation, viscosity=viscosity))
    batch, body = fr.Batch(rom, 2, 1e-3), fr.Simulator(rom, 1e-3)
    assert batch.stepping.endswith("several damping ratios")
    for _ in range(5):
        batch.step([0.0, 0.0, 0.05, 0.0, 0.0])
        body.step([0.0, 0.0, 0.05, 0.0, 0.0])
    np.testing.assert_array_equal(batch.state()[0][1], body.state[0])
