"""A body that deforms largely, of a material that relaxes: closed forms, the energy account, and the linear effect."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from soft_rom import linear, refuse_few_parts, soft_rom, swing

import fenics_rom as fr
from fenics_rom.errors import StepError
from fenics_rom.mechanics.step import FINITE_STRAIN_STEPPERS
from fenics_rom.mechanics.viscoelasticity import PronySeries

LAWS = ("st_venant_kirchhoff", "neo_hookean")
SERIES = PronySeries((0.8, 0.4), (5e-3, 0.1))
STEPPERS = pytest.mark.parametrize("stepper", FINITE_STRAIN_STEPPERS)
CLOSES_TO = 1e-10  # of the largest energy or work seen, as in test_large_deformation_steps.py

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")


def relaxing(rom, series=SERIES):
    """The same, of a material that relaxes."""
    return replace(rom, environment=replace(rom.environment, viscoelasticity=series))


@pytest.fixture(scope="module")
def roms():
    return {law: relaxing(soft_rom(law)) for law in LAWS}


def gap(body):
    """What the account does not explain of the stored energy, J."""
    account = body.ledger
    return abs(body.energy - account.supplied + account.dissipated + account.lost_in_switching)


# --- a bar that is stretched by half ---------------------------------------------------------------------------------

LENGTH, AREA, YOUNG, DRAG = 0.2, 1e-4, 1e6, 60.0  # m, m², Pa, 1/s
MASS = 1000.0 * AREA * LENGTH / 3  # kg, that its end moves like


@pytest.fixture(scope="module")
def bar():
    """A bar of ν = 0 whose end moves by u along it, with u x/L everywhere: one point, one displacement q = u √m."""
    rom = soft_rom(order=1, alpha=0.0, beta=0.0)
    along = np.zeros((3, 3, 1, 1))
    along[0, 0] = 1 / (LENGTH * math.sqrt(MASS))
    γ = np.array([YOUNG * AREA / LENGTH / MASS])
    body = replace(
        rom.deformation,
        gradients=along,
        weights=np.array([AREA * LENGTH]),
        first_lame=np.zeros(1),
        shear=np.array([YOUNG / 2]),
        viscosity=np.zeros(1),
        external_damping=np.array([[DRAG]]),
        springs=np.zeros((1, 1)),
        training_radius=math.sqrt(MASS) * LENGTH,
        pressures={},
        tendons={},
    )
    model = next(iter(rom.contact_models.values()))
    inputs = np.zeros((1, model.inputs.shape[1]))
    inputs[0, 2] = 1 / math.sqrt(MASS)
    model = replace(model, eigenvalues=γ, damping=np.array([DRAG]), inputs=inputs)
    return relaxing(replace(rom, stiffness=γ, contact_models={"tip": model}, deformation=body))


def stretch_of(bar, force, t):
    """u (m) at t (s) under a force (N) that is put on within 20 ms, and the branches' strains, by an ODE solver.

    m u'' = F - m d u' - A λ Y (E + Σ g w), λ = 1 + u/L, E = ½ (λ² - 1), w' = λ λ' - w/τ.
    """
    g, τ = np.array(SERIES.ratios), np.array(SERIES.times)

    def rate(time, y):
        u, v, *w = y
        λ = 1 + u / LENGTH
        pulled = AREA * λ * YOUNG * ((λ**2 - 1) / 2 + g @ w)
        return [v, (force * min(time / 0.02, 1.0) - pulled) / MASS - DRAG * v, *(λ * v / LENGTH - np.array(w) / τ)]

    first = solve_ivp(rate, (0.0, 0.02), np.zeros(4), rtol=1e-11, atol=1e-13, method="DOP853").y[:, -1]
    return solve_ivp(rate, (0.02, t), first, rtol=1e-11, atol=1e-13, method="DOP853").y[:, -1]


@STEPPERS
def test_bar_creeps_to_half_its_length_more_as_its_equations_say(bar, stepper):
    """Of second order, the strains of the branches as well."""
    force, t = 103.0, 0.1
    u, _, *w = stretch_of(bar, force, t)
    assert 0.45 < u / LENGTH < 0.55
    assert abs(w[1]) > 0.1  # the slow branch still holds
    errors = []
    for h in (1e-3, 5e-4):
        body = fr.Simulator(bar, h, stepper=stepper)
        for step in range(round(t / h)):
            body.step([0.0, 0.0, force * min((step + 0.5) * h / 0.02, 1.0), 0.0, 0.0])
        errors.append(abs(body.state[0][0] / math.sqrt(MASS) - u))
        assert gap(body) <= CLOSES_TO * body.ledger.supplied
    assert errors[0] < 2e-3 * u
    assert 3.4 < errors[0] / errors[1] < 4.6


# --- a body of twelve modes ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("law", LAWS)
@STEPPERS
def test_account_closes_over_rough_steps(roms, law, stepper):
    body, random, scale = fr.Simulator(roms[law], 1e-3, stepper=stepper), np.random.default_rng(1), 0.0
    for _ in range(150):
        if random.random() < 0.2:
            body.switch(random.choice(list(roms[law].contact_models)))
        body.dt = 10 ** random.uniform(-5, -2)
        dissipated = body.ledger.dissipated
        body.step(random.standard_normal(5) * [0.1, 0.1, 0.1, 100.0, 0.1])
        scale = max(scale, body.energy, abs(body.ledger.supplied), body.ledger.dissipated)
        assert gap(body) <= CLOSES_TO * scale
        if stepper == "newton":  # the other gives strains back of what was dissipated before
            assert body.ledger.dissipated >= dissipated
    assert body.ledger.dissipated > 0.1 * scale


@pytest.mark.parametrize("law", LAWS)
def test_steppers_agree_to_second_order(roms, law):
    """With branches that are slower and faster than the steps are long."""
    fast = relaxing(roms[law], PronySeries((0.8, 0.4), (1e-3, 0.1)))
    for rom, least in ((roms[law], 3.4), (fast, 2.5)):
        apart = []
        for h in (4e-3, 2e-3):
            (one, other) = (np.concatenate(swing(rom, h, how, force=0.1).state) for how in FINITE_STRAIN_STEPPERS)
            apart.append(np.linalg.norm(other - one) / np.linalg.norm(one))
        assert apart[1] < 5e-3
        assert apart[0] / apart[1] > least


@pytest.mark.parametrize("law", LAWS)
@STEPPERS
def test_small_loads_give_the_linear_effect_to_second_order(roms, law, stepper):
    gaps = []
    for force in (2e-3, 1e-3):
        bent = swing(roms[law], 4e-3, stepper, force=force)
        straight = swing(linear(roms[law]), 4e-3, None, force=force)
        gaps.append(np.linalg.norm(bent.state[0] - straight.state[0]))
        assert abs(bent.ledger.dissipated - straight.ledger.dissipated) < 0.02 * straight.ledger.dissipated
    assert gaps[0] < 0.05 * np.linalg.norm(straight.state[0])
    assert gaps[0] / gaps[1] >= 3.8


def test_what_relaxes_is_stiffer_at_first_and_ends_where_the_elastic_body_does():
    rom = soft_rom(beta=0.02)
    ends, first = [], []
    for each in (rom, relaxing(rom, PronySeries((3.0,), (0.02,)))):
        body = fr.Simulator(each, 4e-3)
        for step in range(800):
            body.step([0.0, 0.0, 0.05, 0.0, 0.0])
            if step == 5:
                first.append(body.displacement("tip")[0, 2])
        ends.append(body.displacement("tip")[0, 2])
    assert first[1] < 0.9 * first[0]
    assert ends[1] == pytest.approx(ends[0], rel=1e-4)


@pytest.mark.parametrize("law", LAWS)
@STEPPERS
def test_saved_state_goes_on_to_the_bit(roms, law, stepper):
    body = swing(roms[law], 4e-3, stepper, duration=0.08)
    saved, ends = body.save(), []
    assert saved.stepper.auxiliary.size > 0
    for simulator in (body, fr.Simulator(roms[law], 4e-3, stepper=stepper)):
        simulator.restore(saved)
        for _ in range(5):
            simulator.step([0.0, 0.1, 0.0, 50.0, 0.1])
        ends.append((simulator.energy, *np.concatenate(simulator.state)))
    assert ends[0] == ends[1]


@STEPPERS
def test_step_that_is_taken_back_leaves_all_as_it_was(roms, stepper):
    body = swing(roms[LAWS[0]], 4e-3, stepper, duration=0.08)
    energy, before = body.energy, body.save().stepper.auxiliary
    with pytest.raises(StepError):
        body.step([0.0, 0.0, 1e200, 0.0, 0.0])
    assert body.energy == energy
    assert (body.save().stepper.auxiliary == before).all()


def test_parts_of_a_step_are_steps(roms, monkeypatch):
    """Where Newton's iteration does not solve a step whole, branches relax part by part, and come back as one."""
    u, rom = [0.0, 0.0, 0.1, 0.0, 0.0], roms[LAWS[0]]
    fine, body = (fr.Simulator(rom, h, stepper="newton") for h in (1e-3, 4e-3))
    refused = refuse_few_parts(monkeypatch, 4, longer_than=2e-3)
    for _ in range(10):
        body.step(u)
        for _ in range(4):
            fine.step(u)
    assert set(refused) == {1, 2}
    np.testing.assert_allclose(body.state[0], fine.state[0], atol=1e-9 * np.abs(fine.state[0]).max())
    assert body.energy == pytest.approx(fine.energy, rel=1e-9)
    assert gap(body) <= CLOSES_TO * body.ledger.supplied
    before = body.save().stepper.auxiliary
    body._stepper.kernel.step(np.array(u))
    body._stepper.kernel.rollback()
    assert (body.save().stepper.auxiliary == before).all()
