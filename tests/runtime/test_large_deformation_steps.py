import copy
import pickle
import warnings
from dataclasses import replace

import numpy as np
import pytest
from soft_box import soft_box
from soft_rom import SOFT_BOX, in_frame, linear, refuse_few_parts, soft_rom, swing

import fenics_rom as fr
from fenics_rom.compilation import numpy_alone
from fenics_rom.errors import FenicsRomWarning, SceneError, StepError
from fenics_rom.mechanics.environment import NOTHING, Guide, Load
from fenics_rom.mechanics.hyperelastic import moduli, strain, stress
from fenics_rom.mechanics.step import FINITE_STRAIN_STEPPERS, StepInput
from fenics_rom.mechanics.tendon import turning_angles
from fenics_rom.mechanics.viscoelasticity import PronySeries
from fenics_rom.scene.file import parse_scene

LAWS = ("st_venant_kirchhoff", "neo_hookean")
ONE_LAW = pytest.mark.parametrize("law", [LAWS[0], pytest.param(LAWS[1], marks=pytest.mark.slow)])


@pytest.fixture(scope="module")
def roms():
    return {law: soft_rom(law) for law in LAWS}


@pytest.fixture(scope="module")
def undamped():
    return {law: soft_rom(law, alpha=0.0, beta=0.0) for law in LAWS}


def imbalance(simulator):
    """Of the energy account, as a share of what was supplied."""
    ledger = simulator.ledger
    gone = ledger.dissipated + ledger.lost_in_switching + ledger.numerical
    return abs(simulator.energy - ledger.supplied + gone) / ledger.supplied


def apart(one, other):
    """Of the states of two simulators of one basis, relative."""
    a, b = np.concatenate(one.state), np.concatenate(other.state)
    return np.linalg.norm(a - b) / np.linalg.norm(b)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("stepper", FINITE_STRAIN_STEPPERS)
@pytest.mark.parametrize("damped", [True, False])
def test_energy_balances_at_any_step(roms, undamped, law, stepper, damped):
    rom = (roms if damped else undamped)[law]
    for h in (1e-4, 2e-3, 2e-2):
        simulator = swing(rom, h, stepper, duration=16 * h if h < 1e-3 else 0.32)
        assert imbalance(simulator) < 1e-10


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
def test_the_linearly_implicit_step_never_creates_energy(roms, undamped, law):
    for rom in (roms[law], undamped[law]):
        rng = np.random.default_rng(1)
        simulator = fr.Simulator(rom, 1e-3, stepper="linearly-implicit")
        scale = 1e-6 if law == "st_venant_kirchhoff" else rom.deformation.shear @ rom.deformation.weights / 10  # J
        for _ in range(300):
            simulator.dt = 10 ** rng.uniform(-6, 1)
            simulator.switch(rng.choice(list(rom.contact_models)))
            simulator.step(rng.standard_normal(5) * 10 ** rng.uniform(-3, 5) * (rng.random() < 0.3) * [1, 1, 1, 1, 0.1])
            scale = max(scale, simulator.energy, simulator.ledger.supplied)
            ledger = simulator.ledger
            assert abs(simulator.energy - ledger.supplied + ledger.dissipated) <= 1e-10 * scale
            assert ledger.dissipated >= -1e-12 * scale


@pytest.mark.parametrize("exponent", range(1, 24))
@pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
def test_overflow_is_told_as_a_step_that_is_not_taken(roms, exponent):
    """And of nothing less is there a warning of NumPy's: not of a push, a pressure or a state of any size."""
    size = 10.0 ** (exponent if exponent < 12 else 25 * (exponent - 11))
    rng = np.random.default_rng(exponent)
    for h in (1e-3, 1.0):
        body, told = fr.Simulator(roms[LAWS[0]], h, stepper="linearly-implicit"), []
        for _ in range(30):
            body.step(0.1 * rng.standard_normal(5))
            before = body.save()
            try:
                body.step(size * rng.standard_normal(5))
                body.step(np.zeros(5))
                body.state = 1e-3 * size * rng.standard_normal((2, body.rom.deformation.order))
                body.step(size * rng.standard_normal(5))
            except StepError as error:
                told.append(str(error))
            body.restore(before)
        assert all("step overflows" in text for text in told)
        assert size > 1e6 or not told


@ONE_LAW
def test_both_steps_are_of_second_order(roms, law):
    rom = roms[law]
    exact = swing(rom, 2.5e-4, "newton", force=0.1)
    for stepper in FINITE_STRAIN_STEPPERS:
        errors = [apart(swing(rom, h, stepper, force=0.1), exact) for h in (8e-3, 4e-3, 2e-3)]
        assert 3.4 < errors[0] / errors[1] < 4.6
        assert 3.4 < errors[1] / errors[2] < 4.6


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("stepper", FINITE_STRAIN_STEPPERS)
def test_small_loads_give_the_linear_model_to_second_order(roms, law, stepper):
    rom = roms[law]
    bent, straight = (swing(each, 4e-3, how, force=2e-3) for each, how in ((rom, stepper), (linear(rom), None)))
    less, reference = (swing(each, 4e-3, how, force=1e-3) for each, how in ((rom, stepper), (linear(rom), None)))

    def gap(one, other):
        return np.linalg.norm(one.state[0] - other.state[0])

    assert gap(bent, straight) < 0.05 * np.linalg.norm(straight.state[0])
    assert gap(bent, straight) / gap(less, reference) >= 3.8
    assert bent.displacement("tip").shape == (1, 3)


def test_a_switch_changes_inputs_alone(roms):
    simulator = swing(roms["neo_hookean"], 4e-3, None)
    before = simulator.state, simulator.energy
    simulator.switch("middle")
    assert simulator.contact == "middle"
    np.testing.assert_array_equal(simulator.state, before[0])
    assert simulator.energy == before[1]
    assert simulator.ledger.lost_in_switching == 0
    other = copy.deepcopy(simulator)
    other.switch("tip")
    for each in (simulator, other):
        each.step([0.0, 0.0, 0.1, 0.0, 0.0])
    assert apart(simulator, other) > 1e-6


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("stepper", FINITE_STRAIN_STEPPERS)
def test_what_was_saved_comes_back_to_the_bit(roms, law, stepper):
    simulator = swing(roms[law], 4e-3, stepper, duration=0.08)
    copies = [pickle.loads(pickle.dumps(simulator)), copy.copy(simulator)]
    saved = simulator.save()
    for _ in range(5):
        simulator.step([0.0, 0.1, 0.0, 50.0, 0.1])
    after = simulator.state, simulator.energy, simulator.ledger.sums
    simulator.restore(saved)
    for each in (simulator, *copies):
        for _ in range(5):
            each.step([0.0, 0.1, 0.0, 50.0, 0.1])
        np.testing.assert_array_equal(each.state, after[0])
        assert (each.energy, each.ledger.sums) == after[1:]


def test_a_snapshot_of_other_points_is_refused(roms):
    simulator = fr.Simulator(roms["neo_hookean"], 4e-3)
    snapshot = simulator.save()
    other = snapshot.stepper._replace(auxiliary=snapshot.stepper.auxiliary[6:])
    with pytest.raises(StepError, match="another ROM"):
        simulator.restore(replace(snapshot, stepper=other))


@pytest.mark.parametrize("law", LAWS)
def test_set_states_and_resets_begin_anew(roms, law):
    simulator = swing(roms[law], 4e-3, "linearly-implicit", duration=0.08)
    q, r = simulator.state
    other = fr.Simulator(roms[law], 4e-3, stepper="newton")
    other.state = simulator.state = q, r
    assert simulator.energy == pytest.approx(other.energy, rel=1e-10)
    simulator.reset()
    assert simulator.energy == pytest.approx(0.0, abs=1e-15)
    assert not np.concatenate(simulator.state).any()


@pytest.mark.parametrize("stepper", FINITE_STRAIN_STEPPERS)
def test_a_force_beyond_the_numbers_leaves_the_state_as_it_was(roms, stepper):
    simulator = swing(roms["st_venant_kirchhoff"], 4e-3, stepper, duration=0.08)
    before, energy = simulator.state, simulator.energy
    with pytest.raises(StepError):
        simulator.step([1e200, 0.0, 0.0, 0.0, 0.0])
    np.testing.assert_array_equal(simulator.state, before)
    assert simulator.energy == energy


@pytest.mark.parametrize("law", LAWS)
def test_strains_that_are_not_those_of_the_shape_come_back_too(undamped, law):
    """After a step that was refused, and where a run goes on from a state that was saved."""
    simulator, u = swing(undamped[law], 1e-3, "linearly-implicit", duration=0.004), [0.0, 0.1, 0.0, 50.0, 0.1]
    while not len(simulator._stepper.kernel.elastic._carried.strained) and simulator.steps < 10:
        simulator.step(u)
    assert len(simulator._stepper.kernel.elastic._carried.strained)
    saved = simulator.save()
    with pytest.raises(StepError):
        simulator.step([1e200, 0.0, 0.0, 0.0, 0.0])
    other = fr.Simulator(undamped[law], 1e-3, stepper="linearly-implicit")
    other.restore(saved)
    for each in (simulator, other):
        each.step(u)
    np.testing.assert_array_equal(simulator.state, other.state)
    assert simulator.energy == other.energy
    assert imbalance(simulator) < 1e-10


@pytest.mark.parametrize("law", LAWS)
def test_what_a_step_finds_of_the_next_one_serves_no_other_step(roms, law):
    """Neither one after a step that was refused, nor one of another size."""
    simulator, u = swing(roms[law], 4e-3, "linearly-implicit", duration=0.08), [0.0, 0.1, 0.0, 50.0, 0.1]
    simulator.save()
    other = copy.copy(simulator)
    for each in (simulator, other):
        each.step(u)
    with pytest.raises(StepError):
        simulator.step([1e200, 0.0, 0.0, 0.0, 0.0])
    for each in (simulator, other):
        each.step(u)
    np.testing.assert_array_equal(simulator.state, other.state)
    anew = copy.copy(simulator)  # which knows nothing of its next step
    for each in (simulator, anew):
        each.dt = 1e-3
        each.step(u)
    assert apart(simulator, anew) <= 1e-12


@pytest.mark.parametrize("law", LAWS)
def test_followers_pull_where_the_body_is(roms, law):
    rom = roms[law]
    bent = swing(rom, 4e-3, "newton", force=0.3)
    q, t = bent.state[0], 1e-6
    tendon = rom.deformation.tendons["cable"]

    def length(q):
        return np.linalg.norm(np.diff(tendon.points + (tendon.shapes @ q).reshape(-1, 3), axis=0), axis=1).sum()

    slope = [(length(q + t * e) - length(q - t * e)) / (2 * t) for e in np.eye(len(q))]
    np.testing.assert_allclose(tendon.force(q), np.negative(slope), rtol=1e-6, atol=1e-8)
    for u in ([0, 0, 0, 30.0, 0], [0, 0, 0, 0, 1.0]):
        finals = [fr.Simulator(rom, 2e-3, stepper=stepper) for stepper in FINITE_STRAIN_STEPPERS]
        for each in finals:
            for _ in range(60):
                each.step(u)
            assert imbalance(each) < 1e-10
        assert apart(*finals) < 5e-3
        straight = fr.Simulator(linear(rom), 2e-3)
        for _ in range(60):
            straight.step(u)
        assert apart(straight, finals[0]) > 0.01  # it is the turned force that makes the difference


def test_a_pressure_comes_in_one_step_as_in_many():
    """On the way the walls are pushed by a part of the pressure, not by all of it against dead forces."""
    rom = soft_rom("neo_hookean", inertia=False)
    one, many = fr.Simulator(rom, 1.0), fr.Simulator(rom, 1.0)
    one.step(air=3e4)
    for pressure in (5e3, 1e4, 2e4, 3e4):
        many.step(air=pressure)
    assert np.abs(one.displacement()).max() > 0.18
    assert np.abs(one.displacement() - many.displacement()).max() <= 1e-10


@ONE_LAW
def test_without_inertia_every_step_is_an_equilibrium(law):
    rom = soft_rom(law, inertia=False)
    simulator = fr.Simulator(rom, 0.1)
    assert simulator.stepper == "equilibrium"
    for share in np.linspace(0.1, 1.0, 10):
        simulator.step([0.0, 0.0, 0.3 * share, 0.0, 0.5 * share])
        q, body = simulator.state[0], rom.deformation
        loads = rom.contact_models["tip"].inputs[:, 2] * 0.3 * share + body.tendons["cable"].force(q) * 0.5 * share
        assert np.abs(body.force(q) - loads).max() < 1e-9 * np.abs(loads).max()
    assert imbalance(simulator) < 1e-10
    assert simulator.ledger.dissipated == 0
    finer = fr.Simulator(rom, 0.05)
    for share in np.linspace(0.05, 1.0, 20):
        finer.step([0.0, 0.0, 0.3 * share, 0.0, 0.5 * share])
    missed = [abs(each.ledger.numerical) for each in (simulator, finer)]  # of the work: that of a chord of the path
    assert 1.9 <= np.log2(missed[0] / missed[1]) <= 2.1
    assert missed[0] <= 1e-2 * simulator.ledger.supplied
    settled = fr.Simulator(soft_rom(law, alpha=60.0), 5e-3)
    for _ in range(2000):
        settled.step([0.0, 0.0, 0.3, 0.0, 0.5])
    assert np.linalg.norm(settled.state[0] - q) < 1e-6 * np.linalg.norm(q)
    at_once = fr.Simulator(rom, 0.1)
    at_once.step([0.0, 0.0, 0.3, 0.0, 0.5])
    assert np.linalg.norm(at_once.state[0] - q) < 1e-8 * np.linalg.norm(q)


@pytest.mark.parametrize("law", ["ogden 0.7 1.5 0.3 -2.0", "yeoh 1.0 0.1 0.02"])
@pytest.mark.parametrize("stepper", ["equilibrium", "newton", "newton in a frame"])
@pytest.mark.parametrize("load", [1e-8, 1e-10])
def test_hardly_any_load_bends_a_body_as_little(law, stepper, load):
    """Stresses are differences there, with the round-off of strains of 1, and no longer that of what they are."""
    rom = soft_rom("neo_hookean", inertia=stepper != "equilibrium", contact=True)
    rom = replace(rom, deformation=replace(rom.deformation, law=law))
    rom = in_frame(rom) if stepper.endswith("frame") else rom
    known = replace(rom, deformation=replace(rom.deformation, law="st_venant_kirchhoff"))  # as good as linear
    bodies = [fr.Simulator(each, 0.05, stepper=None if stepper == "equilibrium" else "newton") for each in (rom, known)]
    for share in (0.3, 0.7, 1.0):
        for body in bodies:
            body.step([0.0, 0.0, share * load, 0.0, 0.0])
    q, expected = (body.state[0] for body in bodies)
    missed = rom.deformation.tangent(0 * q) @ (q - expected)
    assert np.abs(missed).max() <= rom.deformation.round_off.max()


@pytest.mark.parametrize("stepper", [*FINITE_STRAIN_STEPPERS, None])
def test_contact_never_adds_energy_and_lets_nothing_in(stepper):
    rom = soft_rom(contact=True, inertia=stepper is not None)
    simulator = fr.Simulator(rom, 2e-3, stepper=stepper)
    lowest, last = 0.0, 0.0
    for step in range(300):
        simulator.step([0.0, 0.05, -0.15 if step < 200 else 0.1, 0.0, 0.0])
        tip = simulator.displacement()[rom.contact_models["tip"].contact_points]
        lowest = min(lowest, tip[:, 2].min())
        assert simulator.ledger.contact >= -1e-14
        assert simulator.ledger.friction >= last - 1e-14
        last = simulator.ledger.friction
    assert -0.0082 < lowest < -0.0079
    assert imbalance(simulator) < 1e-9
    if stepper:
        assert simulator.ledger.contact > 0
        assert last > 0


def pushed_about(rom, stepper, seed, steps, scene=None):
    """Steps of any length over a floor that moves, with switches; largest gap of the account, as a share of the scale.

    Contact and friction only take.
    """
    rng = np.random.default_rng(seed)
    a, b = rng.uniform(1, 30, 2)
    floor = {"floor": lambda t: [0.02 * np.sin(b * t), 0.0, 0.02 * np.sin(a * t) ** 2]}
    body = fr.Simulator(rom, 1e-3, scene=scene, stepper=stepper, signals=floor)
    gap = scale = contact = friction = touched = 0.0
    for _ in range(steps):
        body.dt = 10 ** rng.uniform(-6, -1)
        body.switch(rng.choice(list(rom.contact_models)))
        body.step([0.1 * rng.standard_normal(), 0.0, -0.1 * rng.random(), 50 * rng.random(), rng.random() / 2])
        ledger = body.ledger
        scale = max(scale, body.energy, abs(ledger.supplied), ledger.dissipated)
        gap = max(gap, abs(body.energy - ledger.supplied + ledger.dissipated + ledger.numerical))
        # Work of 1e-12 of force times velocity is no work to the law (WORK_ROUND_OFF): ten times that.
        assert ledger.contact >= contact - 1e-11 * scale
        assert ledger.friction >= friction - 1e-11 * scale
        contact, friction, touched = ledger.contact, ledger.friction, touched + body.contact_forces().any()
    assert touched > 3
    return body, gap / scale


@pytest.mark.parametrize("series", [None, PronySeries((0.8, 0.4), (5e-3, 0.1))], ids=["elastic", "relaxing"])
@pytest.mark.parametrize(("stepper", "parts"), [("linearly-implicit", 1), ("newton", 1), ("newton", 4), (None, 1)])
@pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
def test_account_closes_where_contact_points_yield_beyond_the_basis(monkeypatch, stepper, parts, series):
    """Steps from 1e-6 to 0.1 s, cut or not; what was saved, and what was taken back, goes on to the bit."""
    refuse_few_parts(monkeypatch, parts)
    rom = soft_rom(contact=True, inertia=stepper is not None)
    rom = replace(rom, environment=replace(rom.environment, viscoelasticity=series))
    body, gap = pushed_about(rom, stepper, 2, 100 if stepper else 30)
    assert gap <= 1e-11
    kernel, saved, carried = body._stepper.kernel, body.save(), body._stepper.kernel.auxiliary.copy()
    with pytest.raises(StepError):
        body.step([1e200, 0.0, 0.0, 0.0, 0.0])
    np.testing.assert_array_equal(kernel.auxiliary, carried)
    runs = []
    for _ in range(2):
        body.restore(saved)
        for _ in range(3):
            carried = kernel.auxiliary.copy()
            body.step([0.0, 0.0, -0.1, 0.0, 0.0])
        runs.append((body.energy, *kernel.auxiliary))
    np.testing.assert_array_equal(*runs)
    body._stepper.rollback()
    np.testing.assert_array_equal(kernel.auxiliary, carried)


@pytest.mark.parametrize("stepper", [*FINITE_STRAIN_STEPPERS, None])
@pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
def test_switched_off_or_not_there_residual_compliance_changes_no_bit(stepper):
    rom = soft_rom(contact=True, inertia=stepper is not None)
    off = replace(rom.environment, residual_compliance=False)
    bare, steps = replace(rom, residual_compliance=None), 40 if stepper else 12
    on, one, other = (pushed_about(r, stepper, 2, steps, e)[0] for r, e in ((rom, None), (rom, off), (bare, None)))
    assert apart(on, one) > 1e-6
    np.testing.assert_array_equal(*(np.concatenate(run.state) for run in (one, other)))
    assert one.ledger.sums == other.ledger.sums
    assert one.energy == other.energy


def bent_shapes():
    """Equilibria (n, 8) of the whole box under forces up to 1.5 N at its tip, which turns by up to 42 degrees."""
    fine, shapes = soft_box(*SOFT_BOX).deformation.stepper(1.0), []
    for force in np.linspace(0.0, 1.5, 9)[1:]:
        fine.equilibrium(StepInput(np.array([0.0, 0.0, force, 0.0, 0.0])))
        shapes.append(fine.x[:, 0])
    return np.column_stack(shapes)


def test_delassus_operator_of_a_bent_body_is_nearer_the_full_one():
    """Straight, and where the tip has turned by 24 and 42 degrees; R is that of the shape at rest."""
    h, shapes, system = 5e-3, bent_shapes(), soft_box(*SOFT_BOX)
    full, M = system.deformation, system.mass.toarray()
    rom = soft_rom(order=10, contact=True, bent=np.linalg.svd(shapes, full_matrices=False)[0][:, :5])
    touched = rom.contact_models["tip"].contact_points
    Sᵀ = np.eye(system.size)[:, np.searchsorted(full.free, (3 * touched[:, None] + np.arange(3)).ravel())]
    for x, nearer in ((0 * shapes[:, 0], 0.3), (shapes[:, 3], 0.45), (shapes[:, 7], 0.6)):
        q = rom.basis.T @ (M @ x)
        H = full.gradients(rom.basis @ q[:, None])[..., 0]
        E, F = strain(H), H + np.eye(3)[:, :, None]
        D, S = (of(rom.deformation.law, E, full.first_lame, full.shear) for of in (moduli, stress))
        K, viscous = (full.tangent(F, F, D, stresses).toarray() for stresses in (S, 0 * S))
        W = Sᵀ.T @ np.linalg.solve((2 / h + 1.0) * M + 2e-3 * viscous + h / 2 * K, Sᵀ)
        errors = []
        for scene in (None, replace(rom.environment, residual_compliance=False)):
            kernel = fr.Simulator(rom, h, scene=scene, stepper="newton")._stepper.kernel
            kernel.elastic.open(q, 0 * q)
            kernel._take_slope(kernel.elastic, h, np.zeros((len(q), len(q))))
            errors.append(np.linalg.norm(kernel._delassus - W) / np.linalg.norm(W))
        assert errors[0] < nearer * errors[1]


def test_both_steppers_agree_in_contact():
    rom = soft_rom(contact=True)
    runs = [fr.Simulator(rom, 5e-4, stepper=stepper) for stepper in FINITE_STRAIN_STEPPERS]
    for each in runs:
        pushed = []
        for _ in range(400):
            each.step([0.0, 0.0, -0.15, 0.0, 0.0])
            pushed.append(np.linalg.norm(each.contact_forces("floor")))
        assert max(pushed) > 0.01
    (one, _), (other, _) = (each.state for each in runs)
    assert np.linalg.norm(one - other) < 0.01 * np.linalg.norm(other)  # velocities jump in impacts


def test_the_stepper_follows_from_the_step_and_says_why(roms):
    rom = roms["st_venant_kirchhoff"]
    short, long = fr.Simulator(rom, 1e-3), fr.Simulator(rom, 0.5)
    assert (short.stepper, long.stepper) == ("linearly-implicit", "newton")
    assert "steps in a period" in short.stepping
    period = 2 * np.pi / np.sqrt(rom.contact_models["tip"].eigenvalues[0])
    assert fr.Simulator(rom, period / 8.1).stepper == "linearly-implicit"
    assert fr.Simulator(rom, period / 7.9).stepper == "newton"
    assert fr.Simulator(linear(rom), 1e-3).stepper == "midpoint"
    assert fr.Simulator(rom, 1e-3, stepper="newton").stepper == "newton"


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("controls", [{}, {"cable": "length"}], ids=["tension", "stroke"])
def test_linearly_implicit_steps_are_as_exact_as_newtons_from_eight_in_a_period_on(roms, law, controls):
    """What the choice rests on: they are exact enough for the more steps that they make in the same time."""
    rom = replace(roms[law], environment=replace(roms[law].environment, controls=controls))
    period = 2 * np.pi / np.sqrt(rom.contact_models["tip"].eigenvalues[0])
    largest = 5e-3 if controls else 2.0

    def end(stepper, steps):
        body = fr.Simulator(rom, period / steps, stepper=stepper)
        for step in range(2 * steps):
            at = (step + (1.0 if controls else 0.5)) / (2 * steps)  # strokes are those at the end of a step
            body.step([0.0, 0.0, 0.0, 0.0, largest * np.sin(np.pi * at / 2) ** 2])
        return body.displacement("tip")[0]

    exact = end("newton", 256)
    for steps in (8, 16):
        newton, implicit = (np.linalg.norm(end(stepper, steps) - exact) for stepper in FINITE_STRAIN_STEPPERS)
        assert implicit < 4 * max(newton, 0.02 * np.linalg.norm(exact))


def test_newton_knows_how_a_cable_turns_that_pulls_by_its_stroke(roms):
    """Whole steps of a tenth of the slowest period take few iterations, as the tangent has the cable's tension."""
    rom = roms["neo_hookean"]
    rom = replace(rom, environment=replace(rom.environment, controls={"cable": "length"}))
    with numpy_alone():  # whose slopes can be counted
        body = fr.Simulator(rom, 0.1 * 2 * np.pi / np.sqrt(rom.contact_models["tip"].eigenvalues[0]), stepper="newton")
    kernel, tangents = body._stepper.kernel, []
    found = kernel._take_slope
    kernel._take_slope = lambda *given: tangents.append(1) or found(*given)
    for step in range(30):
        body.step([0.0, 0.0, 0.0, 0.0, 8e-3 * np.sin(np.pi * (step + 1) / 60) ** 2])
    assert kernel.notes["cut"] == 0
    assert len(tangents) <= 60
    assert imbalance(body) < 1e-10


@pytest.mark.parametrize(
    ("ask", "says"),
    [
        (lambda rom: fr.Simulator(rom, 1e-3, stepper="euler"), "stepper"),
        (lambda rom: fr.Simulator(linear(rom), 1e-3, stepper="newton"), "belongs to large deformation"),
        (lambda rom: fr.truncate(rom, 3), "truncated"),
        (lambda rom: fr.Simulator(soft_rom(inertia=False), 0.1, stepper="newton"), "inertia"),
    ],
)
def test_what_cannot_be_is_said(roms, ask, says):
    with pytest.raises(fr.errors.FenicsRomError, match=says):
        ask(roms["st_venant_kirchhoff"])


def test_a_scene_chooses_whether_it_deforms_largely(roms):
    rom = roms["st_venant_kirchhoff"]
    large = parse_scene(rom.scene_text)
    straight = replace(large, effects=replace(large.effects, large_deformation=None))
    assert fr.Simulator(rom, 1e-3, scene=straight).stepper == "midpoint"
    without = replace(linear(rom), environment=straight.environment)
    with pytest.raises(SceneError, match=r"effects.large_deformation: ROM 'soft box' was made without it"):
        fr.Simulator(without, 1e-3, scene=large)


def test_steps_too_long_and_shapes_too_far_are_told_once(undamped):
    rom = undamped["st_venant_kirchhoff"]
    simulator = fr.Simulator(rom, 0.1, stepper="linearly-implicit")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", FenicsRomWarning)
        for step in range(100):
            simulator.step([0.0, 0.0, 3.0 * (step < 30), 0.0, 0.0])
    assert len(caught) <= 1
    assert any("too long" in message for message in simulator.warnings)
    far = fr.Simulator(replace(rom, deformation=replace(rom.deformation, training_radius=1e-3)), 1e-3)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FenicsRomWarning)
        for _ in range(400):
            far.step([0.0, 0.0, 5.0, 0.0, 0.0])
    assert any("times as far" in message for message in far.warnings)


@pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
@pytest.mark.parametrize("damped", [True, False])
def test_newton_cuts_a_step_that_it_cannot_solve(roms, undamped, damped):
    simulator = fr.Simulator((roms if damped else undamped)["neo_hookean"], 0.05, stepper="newton")
    for step in range(12):
        simulator.step([0.0, 0.0, (40.0 if damped else 4.0) * (step < 6), 0.0, 0.0])
    assert imbalance(simulator) < 1e-9
    assert any("cut into parts" in message for message in simulator.warnings)


# --- strokes ---------------------------------------------------------------------------------------------------------


def by_stroke(rom, h, stepper=None):
    """A simulator whose pressure and tendon are given their strokes."""
    environment = replace(rom.environment, controls={"air": "volume", "cable": "length"})
    return fr.Simulator(rom, h, scene=environment, stepper=stepper)


@pytest.mark.filterwarnings("ignore:contact. obstacle .* inside the body")  # it is touched at its tip alone
@ONE_LAW
@pytest.mark.parametrize("stepper", [*FINITE_STRAIN_STEPPERS, None])
@pytest.mark.parametrize("contact", [False, True], ids=["alone", "touching"])
def test_strokes_are_given_to_bodies_that_turn(law, stepper, contact):
    """The account closes, taut and slack; a tendon that turns with the body ends as long as it is given."""
    rom = soft_rom(law, inertia=stepper is not None, contact=contact)
    body, scale, tensions, touched = by_stroke(rom, 2e-3, stepper), 0.0, [], 0
    if contact:
        body.set_signal("floor", lambda t: [0.0, 0.0, min(0.1 * t, 0.012)])
    for step in range(1, 81):
        goal = 2e-3 * np.sin(9 * step / 100) if step < 50 else 1e-3
        body.step([1e-8 * np.sin(6 * step / 200), goal])
        touched += contact and body.contact_forces().any()
        ledger = body.ledger
        scale = max(scale, body.energy, abs(ledger.supplied), ledger.dissipated)
        assert abs(body.energy - ledger.supplied + ledger.dissipated + ledger.numerical) <= 1e-10 * scale
        tensions.append(body.reactions["cable"])
    assert min(tensions) == 0.0 < tensions[-1]
    cable = rom.deformation.tendons["cable"]
    assert cable.stroke(body.state[0]) == pytest.approx(
        goal, rel=1e-10 if stepper is None else 1e-5
    )  # it swings meanwhile
    assert touched > 10 or not contact


@pytest.mark.parametrize("law", LAWS)
def test_an_equilibrium_of_a_stroke_is_that_of_its_tension(law):
    """And where all is let go the body is at rest again."""
    rom = soft_rom(law, inertia=False)
    one, other = by_stroke(rom, 1.0), fr.Simulator(rom, 1.0)
    one.step([1e-8, 2e-4])
    other.step(list(one.reactions.values()))
    np.testing.assert_allclose(one.state[0], other.state[0], rtol=0, atol=1e-10 * np.abs(other.state[0]).max())
    other.step([0.0, 0.0])
    assert np.abs(other.state[0]).max() <= 1e-10 * np.abs(one.state[0]).max()


# --- friction at guides ----------------------------------------------------------------------------------------------


MU = 1.0


def rubbing(rom, h, stepper=None, **controls):
    """A simulator whose tendon rubs at its guides."""
    angles = turning_angles(rom.deformation.tendons["cable"].points)
    guides = {f"cable-guide-{k}": Guide("cable", MU, angle) for k, angle in enumerate(angles, start=1)}
    loads = {name: Load(1, NOTHING) for name in guides}
    models = {
        name: replace(model, inputs=np.hstack([model.inputs, np.zeros((model.order, len(guides)))]))
        for name, model in rom.contact_models.items()
    }
    environment = replace(rom.environment, guides=guides, loads=loads, controls=controls)
    rom = replace(rom, contact_models=models, loads=dict.fromkeys(guides, 1), environment=environment)
    return fr.Simulator(rom, h, stepper=stepper)


@pytest.mark.parametrize("controls", [{}, {"cable": "length"}], ids=["tension", "length"])
@pytest.mark.parametrize(("stepper", "contact"), [("newton", False), ("linearly-implicit", True)])
def test_account_closes_where_tendons_of_a_moving_body_rub(stepper, controls, contact):
    """And what guides dissipate of a body without damping is never given back."""
    rom = soft_rom("neo_hookean", alpha=0.0, beta=0.0, contact=contact)
    body, scale, dissipated = rubbing(rom, 2e-3, stepper, **controls), 0.0, [0.0]
    if contact:
        body.set_signal("floor", lambda t: [0.0, 0.0, min(0.1 * t, 0.012)])
    for step in range(1, 51):
        pulled = 1 - np.cos(step / 6) if step < 40 else 0.5
        body.step([*([] if contact else [0.0] * 3), 0.0, 2e-3 * pulled if controls else 5.0 * pulled])
        ledger = body.ledger
        scale = max(scale, body.energy, abs(ledger.supplied), ledger.dissipated)
        assert abs(body.energy - ledger.supplied + ledger.dissipated + ledger.numerical) <= 1e-10 * scale
        dissipated.append(ledger.dissipated)
    if stepper == "newton":  # the other one carries strains along, and gives back what they lost
        assert np.diff(dissipated).min() >= -1e-12 * scale
    assert dissipated[-1] > 0.01 * scale


@pytest.mark.parametrize("controls", [{}, {"cable": "length"}], ids=["tension", "length"])
def test_an_equilibrium_obeys_the_capstan_at_the_angles_of_the_moved_body(controls):
    """Pulled, T exp(-μ Σα) is left behind each guide, where α are of the bent cable; let go a little, it sticks."""
    body = rubbing(soft_rom("neo_hookean", inertia=False), 1.0, **controls)
    tendon, goal = body.rom.deformation.tendons["cable"], 1e-3 if controls else 1.0
    assert turning_angles(tendon.points).max() == 0.0
    for share in (0.25, 0.5, 0.75, 1.0):
        body.step([0.0, 0.0, 0.0, 0.0, share * goal])
        q, z = body.state[0], body.save().stepper.reactions
        T, at_guides = (z[0], z[1:]) if controls else (share * goal, z)
        tensions = T * np.exp(-MU * np.cumsum(tendon.angles(q)[::-1]))
        np.testing.assert_allclose(T + np.cumsum(at_guides[::-1]), tensions, rtol=1e-9)
    assert tendon.angles(q).max() > 2e-3
    lost = body.ledger.dissipated
    assert abs(body.energy - body.ledger.supplied + lost + body.ledger.numerical) <= 1e-10 * body.energy
    assert lost > 0
    if not controls:
        body.step([0.0, 0.0, 0.0, 0.0, (1 - 1e-3) * goal])
        last = tendon.up_to(len(at_guides))
        assert abs(last.stroke(body.state[0]) - last.stroke(q)) <= 1e-8 * last.stroke(q)
