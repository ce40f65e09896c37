"""A material that creeps and relaxes: closed forms, the energy account, and what the full model does."""

import math
import warnings
from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from bodies import acted_on, box_arrays, dense, write_arrays

import fenics_rom as fr
from fenics_rom.compilation import numpy_alone
from fenics_rom.errors import FenicsRomWarning, FileError, SceneError, StepError
from fenics_rom.fem.simulator import FullOrderSimulator
from fenics_rom.mechanics.viscoelasticity import PronySeries
from fenics_rom.reduction.frequency_response import full_responses
from fenics_rom.runtime.steppers.contact_interface import ContactInterface

SERIES = PronySeries((0.5, 0.3), (2e-3, 0.1))
BRANCHES = "[effects.viscoelasticity]\nratios = [0.5, 0.3]\ntimes = [2e-3, 0.1]\n"
FLOOR = """
[effects.contact.obstacles.floor]
shape = "half-space"
point = [0, 0, -2e-3]
normal = [0, 0, 1]
[effects.friction]
coefficient = 0.3
"""
PARTS = {
    "outputs.tip": "points = [[0.4, 0.2, 0.1]]",
    "contacts": '[contacts.bottom]\nsurface = "bottom"\n[contacts.right]\nsurface = "right"',
}
WEIGHT = "[effects.gravity]\nacceleration = [0, 0, -9.81]\n"
CLOSES_TO = 1e-12  # of the largest energy or work seen, as in test_energy_laws.py

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")


@pytest.fixture(scope="module")
def mesh(tmp_path_factory):
    return write_arrays(tmp_path_factory.mktemp("relaxing") / "box.msh", *box_arrays((0.4, 0.2, 0.1), (3, 2, 1)))


def effects(rest="", damping="alpha = 0.5, beta = 1e-4", branches=BRANCHES):
    return f"inertia = {{}}\ndamping = {{ {damping} }}\n{branches}{rest}"


def system_of(mesh, text, **parts):
    return fr.assemble(acted_on(mesh, text, **(PARTS | parts)))


def reduced(system, order=None, **choices):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FenicsRomWarning)
        return fr.reduce(system, order=system.size if order is None else order, **choices)


@pytest.fixture(scope="module")
def soft(mesh):
    """The box without contact."""
    return system_of(mesh, effects())


@pytest.fixture(scope="module")
def rom(soft):
    return reduced(soft, 8)


@pytest.fixture(scope="module")
def touched(mesh):
    """The box above a floor."""
    return system_of(mesh, effects(WEIGHT + FLOOR))


def exact(rom, contact, force, t):
    """q (m,) under a constant force (m,) from rest, by the exponential of q' = r, r' = G u - ..., w' = r - w/τ."""
    model = rom.contact_models[contact]
    (m, γ), D, N = (model.order, model.eigenvalues), model.damping, len(SERIES.times)
    A = np.zeros(((2 + N) * m + 1,) * 2)
    q, r, *w, _one = (slice(k * m, (k + 1) * m) for k in range(3 + N))
    A[q, r], A[r, q], A[r, r], A[r, -1] = np.eye(m), -np.diag(γ), -(np.diag(D) if D.ndim == 1 else D), force
    for g, τ, part in zip(SERIES.ratios, SERIES.times, w, strict=True):
        A[r, part], A[part, r], A[part, part] = -g * np.diag(γ), np.eye(m), -np.eye(m) / τ
    return scipy.linalg.expm(A * t)[q, -1]


def test_series_is_that_of_a_standard_solid():
    """One branch: storage and loss moduli 1 + g ω²τ²/(1 + ω²τ²) and g ωτ/(1 + ω²τ²)."""
    one, ω = PronySeries((0.7,), (0.02,)), 30.0
    x = ω * 0.02
    assert one.modulus(ω) == pytest.approx(complex(1 + 0.7 * x**2 / (1 + x**2), 0.7 * x / (1 + x**2)), rel=1e-15)
    assert one.modulus(0.0) == 1.0
    assert abs(one.modulus(1e9) - 1.7) < 1e-7


def test_creep_is_of_second_order(rom):
    """Against the exponential of the same equations: the error falls by four where steps are halved."""
    force, t = np.array([0.0, 0.0, 3.0]), 0.02
    reference = exact(rom, "right", rom.contact_models["right"].inputs @ force, t)
    errors = []
    for steps in (800, 1600):
        body = fr.Simulator(rom, t / steps)
        body.switch("right")
        for _ in range(steps):
            body.step(force)
        errors.append(np.linalg.norm(body.state[0] - reference) / np.linalg.norm(reference))
    assert errors[1] < 2e-3
    assert math.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.1)


def test_pressure_of_a_volume_that_is_held_relaxes_by_the_series(mesh):
    """p(t) = p(∞) (1 + Σ g e^(-t/τ)): everything that is elastic has its part of it."""
    chamber = '[effects.pressure.air]\nsurface = "right"\ncontrol = "volume"\n'
    slow = BRANCHES.replace("2e-3, 0.1", "0.2, 1.0")
    rom = reduced(system_of(mesh, effects(chamber, branches=slow)), 1)  # the volume says all of its shape
    body, pressures = fr.Simulator(rom, 2e-3), []
    for _ in range(400):
        body.step([1e-6])
        pressures.append(body.reactions["air"])
    t = np.arange(400) * body.dt  # from the middle of the step that presses to the middle of each
    expected = 1 + 0.5 * np.exp(-t / 0.2) + 0.3 * np.exp(-t / 1.0)
    still = slice(30, None)  # a third of the speed is left in each step after the first
    np.testing.assert_allclose(pressures[still] / expected[still], pressures[-1] / expected[-1], rtol=1e-5)


def test_forced_vibration_has_the_complex_modulus(rom):
    """A mode that is shaken answers with G/(γ M(ω) + iωD - ω²), M = 1 + Σ g iωτ/(1 + iωτ); ω as the step maps it."""
    single = fr.truncate(rom, 1)
    one = single.contact_models["bottom"]
    γ, D = one.eigenvalues[0], float(np.ravel(one.damping)[0])
    body = fr.Simulator(single, 2 * math.pi / 40 / math.sqrt(γ))
    ω = 2 / body.dt * math.tan(math.pi / 40)  # of which a period is 40 steps of the midpoint rule
    G, M = one.inputs[0, 2], SERIES.modulus(ω)
    phases, coordinates = np.exp(2j * math.pi * (np.arange(40) + 0.5) / 40), []
    for period in range(80):
        for phase in phases:
            before = body.state[0]
            body.step([0.0, 0.0, phase.real])
            if period == 79:
                coordinates.append((before + body.state[0])[0] / 2)
    stiffness = G / (2 * np.mean(np.conj(phases) * np.array(coordinates))) - 1j * ω * D + ω**2
    assert stiffness == pytest.approx(γ * M, rel=1e-8)
    assert M.imag / M.real > 0.05  # the loss factor


def rough(body, steps, names, seed=0):
    """Random forces, steps of 1e-6 to 1e-1 s and switches; gap of the account and the largest energy in it, J."""
    random, gap, scale, gain = np.random.default_rng(seed), 0.0, 0.0, 0.0
    for _ in range(steps):
        if len(names) > 1 and random.random() < 0.3:
            before = body.energy
            body.switch(names[random.integers(len(names))])
            gain = max(gain, body.energy - before)
        body.dt = 10 ** random.uniform(-6, -1)
        body.step(random.standard_normal(3) * 10 ** random.uniform(-3, 2))
        account = body.ledger
        gap = max(gap, abs(body.energy - account.supplied + account.dissipated + account.lost_in_switching))
        scale = max(scale, body.energy, abs(account.supplied), account.dissipated)
    return gap, scale, gain


def test_account_closes_over_rough_steps_and_switches(rom):
    gap, scale, gain = rough(fr.Simulator(rom, 1e-3), 2000, list(rom.contact_models))
    assert gap <= CLOSES_TO * scale
    assert gain <= 1e-14 * scale


def test_switch_between_whole_bases_keeps_branches(soft):
    """What all modes hold, those of another contact mode hold, too: nothing is lost, and the run goes on the same."""
    random, rom = np.random.default_rng(3), reduced(soft)
    bodies = fr.Simulator(rom, 1e-3), fr.Simulator(rom, 1e-3)
    for _ in range(15):
        u = random.standard_normal(3)
        for body in bodies:
            body.step(u)
    bodies[1].switch("right")
    for _ in range(15):
        for body in bodies:
            body.step(np.zeros(3))
    assert bodies[1].ledger.lost_in_switching <= 1e-12 * bodies[0].energy
    tips = [body.displacement("tip") for body in bodies]
    np.testing.assert_allclose(tips[1], tips[0], atol=1e-10 * np.abs(tips[0]).max())


def test_account_closes_among_obstacles_where_points_yield_beyond_the_basis(mesh):
    """Switches project branches, of modes and of what is beyond them, and no point moves."""
    text = effects(
        FLOOR.replace("[effects.contact.ob", '[effects.contact]\nswitching = "scene"\n[effects.contact.ob', 1)
    )
    rom = reduced(system_of(mesh, text), 6)
    assert rom.residual_compliance is not None
    body, random = fr.Simulator(rom, 1e-3), np.random.default_rng(1)
    gap, scale, taken = 0.0, 0.0, 0.0
    for step in range(400):
        body.dt = 10 ** random.uniform(-4, -2)
        if step % 20 == 19:
            before, energy = body._stepper.point_displacement().copy(), body.energy
            body.switch(list(rom.contact_models)[step // 20 % 2])
            assert body.energy <= energy * (1 + 1e-13)
            np.testing.assert_allclose(body._stepper.point_displacement(), before, atol=1e-10 * np.abs(before).max())
        body.step(np.array([1.0, 1.0, -60.0]) * random.standard_normal(3))
        account = body.ledger
        gap = max(gap, abs(body.energy - account.supplied + account.dissipated + account.lost_in_switching))
        scale = max(scale, body.energy, account.dissipated, abs(account.supplied))
        assert account.contact >= taken - 1e-9 * scale  # impacts only take
        taken = account.contact
    assert body.ledger.friction > 0
    assert gap <= CLOSES_TO * scale


def test_points_move_as_contact_was_told(touched, monkeypatch):
    """Free velocity and Delassus operator have the branches of modes and of what is beyond them: free + W f comes."""
    told, solve = [], ContactInterface.solve
    monkeypatch.setattr(ContactInterface, "solve", lambda *given, **more: told.append(given) or solve(*given, **more))
    with numpy_alone():  # loops ask for contact by themselves
        body = fr.Simulator(reduced(touched, 6), 2e-3)
    touches = 0
    for _ in range(150):
        body.step()
        contact = body._stepper.contact
        if contact is not None:
            _, points, W, *_ = told[-1]
            expected = points.free_velocity + (W @ contact.forces.ravel()).reshape(-1, 3)
            found = body._stepper.kernel.touched
            np.testing.assert_allclose(found, expected, atol=1e-10 * np.abs(points.free_velocity).max())
            touches += 1
    assert touches > 10


@pytest.mark.parametrize("dt", [2e-4, 2e-2])
@pytest.mark.parametrize("body", ["soft", "touched"])
def test_reduced_run_with_all_modes_is_the_full_one(request, body, dt):
    system = request.getfixturevalue(body)
    full, part = FullOrderSimulator(system, dt, system.scene.environment), fr.Simulator(reduced(system), dt)
    random, gap, scale = np.random.default_rng(2), 0.0, 0.0
    for _ in range(60 if dt > 1e-3 else 300):
        u = np.array([1.0, 1.0, -40.0]) * random.uniform(0, 1, 3) if body == "soft" else np.empty(0)
        full.step(u)
        part.step(u)
        gap = max(gap, abs(full.energy - full.ledger.supplied + full.ledger.dissipated))
        scale = max(scale, full.energy, full.ledger.dissipated)
    full.close()
    x = full.displacement("tip")
    np.testing.assert_allclose(part.displacement("tip"), x, atol=1e-9 * np.abs(x).max())
    assert gap <= CLOSES_TO * scale
    assert np.abs(part.obstacle_forces()).sum() > 0 or body == "soft"


def test_frequency_responses_are_of_what_relaxes(soft, rom):
    """The validation compares with (K M(ω) + iωD - ω²M)⁻¹ B: of all modes it is round-off."""
    whole = reduced(soft)
    for model in whole.contact_models.values():
        assert model.transfer_errors.max() < 1e-9
    ω = np.array([40.0])
    found = full_responses(soft, rom, ω)["right"]
    K, D, M = (dense(matrix, soft.size) for matrix in (soft.stiffness, soft.damping, soft.mass))
    H = np.linalg.solve(K * SERIES.modulus(40.0) + 40j * D - 1600 * M, soft.contacts["right"])
    assert found.sizes[0] == pytest.approx(math.sqrt(np.vdot(H, M @ H).real), rel=1e-9)
    assert found.errors[0] < 0.05 * found.sizes[0]


def test_saved_state_goes_on_to_the_bit(touched):
    body = fr.Simulator(reduced(touched, 8), 1e-3)
    for _ in range(30):
        body.step()
    saved, ends = body.save(), []
    for _ in range(2):
        body.restore(saved)
        for _ in range(20):
            body.step()
        ends.append((body.energy, *body.energy_coordinates))
    assert ends[0] == ends[1]
    fresh = fr.Simulator(reduced(touched, 8), 1e-3)
    fresh.restore(saved)
    for _ in range(20):
        fresh.step()
    assert ends[0] == (fresh.energy, *fresh.energy_coordinates)


def test_equilibrium_is_relaxed_and_a_state_is_put_in_relaxed(mesh, rom):
    """What has long been where it is has no strain in its branches: it is that of the elastic body."""
    rest = {"run": "dt = 1e-3\nduration = 1e-3\ninitial = { shape = 'equilibrium' }"}
    runs = [
        fr.simulate(fr.assemble(acted_on(mesh, effects(WEIGHT, branches=branches), **(PARTS | rest))))
        for branches in (BRANCHES, "")
    ]
    np.testing.assert_allclose(runs[0].outputs["tip"], runs[1].outputs["tip"], rtol=1e-9)
    body = fr.Simulator(rom, 1e-3)
    q = np.ones(8)
    body.state = q, 0 * q
    assert body.energy == pytest.approx(rom.contact_models[body.contact].eigenvalues.sum() / 2, rel=1e-12)


def test_rollouts_are_steps(rom):
    u = np.random.default_rng(0).standard_normal((50, 3))
    one, many = fr.Simulator(rom, 1e-3), fr.Simulator(rom, 1e-3)
    read = many.rollout(u)["tip"]
    for row in u:
        one.step(row)
    tip = one.displacement("tip")
    np.testing.assert_allclose(read[-1], tip, atol=1e-13 * np.abs(tip).max(), rtol=0)
    np.testing.assert_array_equal(np.concatenate(one.state), np.concatenate(many.state))
    assert one.energy == many.energy


def test_file_holds_the_series(rom, tmp_path):
    fr.write_rom(tmp_path / "soft.h5", rom)
    assert fr.read_rom(tmp_path / "soft.h5").environment.viscoelasticity == SERIES
    assert rom.environment.effects["viscoelasticity"] == "ratios (0.5, 0.3), times (0.002, 0.1) s"


def test_run_may_relax_otherwise_or_not_at_all(mesh, rom):
    """Basis and validation are of the ROM's scene; a run takes the series of its own."""
    stiff = acted_on(mesh, effects(branches=BRANCHES.replace("0.5, 0.3", "5.0, 0.3")), **PARTS)
    elastic = acted_on(mesh, effects(branches=""), **PARTS)
    made_so = reduced(fr.assemble(stiff), 8), reduced(fr.assemble(elastic), 8)

    def tip(rom, scene=None):
        body = fr.Simulator(rom, 1e-3, scene=scene)
        for _ in range(20):
            body.step([0.0, 0.0, 1.0])
        return body.displacement("tip")[0, 2]

    tips = [tip(rom), tip(rom, stiff), tip(rom, elastic)]
    assert tips[1:] == pytest.approx([tip(other) for other in made_so], rel=1e-9)
    assert len({round(value, 9) for value in tips}) == 3


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (effects(branches=BRANCHES.replace("[0.5, 0.3]", "[0.5]")), "ratios are 1, times 2"),
        (effects(branches=BRANCHES.replace("0.3", "-0.3")), "ratios"),
        (effects(branches=BRANCHES.replace("2e-3", "0")), "times"),
        (effects().replace("inertia = {}\n", "").replace("damping = { alpha = 0.5, beta = 1e-4 }", ""), "inertia"),
    ],
)
def test_wrong_series_are_refused(mesh, text, message):
    with pytest.raises(SceneError, match=message):
        acted_on(mesh, text, **PARTS)


def test_file_of_no_relaxing_material_is_refused(rom, tmp_path):
    path = tmp_path / "soft.h5"
    wrong = replace(rom.environment, viscoelasticity=PronySeries((0.5,), (-1.0,)))
    fr.write_rom(path, replace(rom, environment=wrong))
    with pytest.raises(FileError, match="ratios and times must be positive"):
        fr.read_rom(path)


def test_step_that_is_taken_back_leaves_all_as_it_was(rom):
    body = fr.Simulator(rom, 1e-3)
    for _ in range(5):
        body.step([0.0, 0.0, 1.0])
    energy, before = body.energy, body.save().stepper.auxiliary
    with pytest.raises(StepError, match="step overflows"):
        body.step([0.0, 0.0, 1e200])
    assert body.energy == energy
    assert (body.save().stepper.auxiliary == before).all()
