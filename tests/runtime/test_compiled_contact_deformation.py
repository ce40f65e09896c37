"""Compiled steps of bodies that deform largely among obstacles: NumPy's forces, motion and account."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from soft_rom import soft_rom

import fenics_rom as fr
from fenics_rom.compilation import compiled, numpy_alone
from fenics_rom.errors import StepError
from fenics_rom.mechanics.compiled.contact_law import OTHERWISE
from fenics_rom.mechanics.viscoelasticity import PronySeries
from fenics_rom.runtime.compiled import held_step, held_steps
from fenics_rom.runtime.steppers import compiled_held
from fenics_rom.runtime.steppers.held import HeldBody

pytestmark = [
    pytest.mark.skipif(not compiled(), reason="numba is not installed, or turned off"),
    pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning"),
]

STEPS, DT = 200, 2e-3
LAWS = "st_venant_kirchhoff", "neo_hookean"


def both(rom, **given):
    """A compiled body, and one of NumPy."""
    body = fr.Simulator(rom, DT, stepper="linearly-implicit", **given)
    assert body.integrator.kernel._compiled is not None
    with numpy_alone():
        return body, fr.Simulator(rom, DT, stepper="linearly-implicit", **given)


def history(seed, width):
    """The tip is pushed onto the floor, along it and off it, with some air and a tension: (STEPS, width)."""
    rng, t = np.random.default_rng(seed), DT * np.arange(STEPS)
    forces = np.zeros((STEPS, width))
    forces[:, :3] = np.stack([0.05 * np.sin(50 * t), 0.05 * np.cos(20 * t), 0.1 * np.sin(30 * t) - 0.1], axis=1)
    forces[:, :3] *= rng.uniform(0.5, 1.5, 3)
    forces[:, -2:] = rng.uniform(0, [300.0, 0.3]) * np.sin(10 * t)[:, None] ** 2
    return forces


def random_rom(law, seed):
    """Some body of a few shapes, of which two to six points can be touched; every third one yields at none."""
    rng = np.random.default_rng(seed)
    order, reach = int(rng.integers(6, 15)), rng.choice([0.3, 0.25, 0.2])
    rom = soft_rom(law, order=order, beta=rng.uniform(1e-3, 4e-3), contact=True, touched_from=reach)
    return replace(rom, residual_compliance=None) if seed % 3 == 2 else rom


def in_one_mode(rom):
    """Without the other contact mode, so that obstacles do not ask for it."""
    return replace(rom, contact_models={"tip": rom.contact_models["tip"]})


def assert_account_closes(body):
    account = body.ledger
    size = max(body.energy, abs(account.supplied), account.dissipated)
    assert abs(body.energy - account.supplied + account.dissipated + account.lost_in_switching) <= 1e-12 * size
    assert min(account.contact, account.friction) >= -1e-12 * size


def statuses(f):
    """What points (P, 3) do: open, stick, slip."""
    touches, slides = f[:, 2] > 0, np.hypot(f[:, 0], f[:, 1]) > (0.4 - 1e-9) * f[:, 2]
    return (touches.astype(int) + (touches & slides)).tolist()


@pytest.mark.parametrize(
    ("law", "series"), [*((law, None) for law in LAWS), (LAWS[1], PronySeries((0.5, 0.3), (0.03, 2e-4)))]
)
@pytest.mark.parametrize("seed", range(3))
def test_motion_forces_and_account_are_those_of_numpy(law, series, seed):
    """From the same state every eighth step on, so that what is compared is what steps do."""
    rom = random_rom(law, seed)
    one, other = both(replace(rom, environment=replace(rom.environment, viscoelasticity=series)))
    touched = 0
    for k, u in enumerate(history(seed, one.inputs)):
        if k % 8 == 0:
            other.restore(one.save())
        for body in (one, other):
            body.step(u)
        forces, expected = one.contact_forces(), other.contact_forces()
        np.testing.assert_allclose(forces, expected, atol=1e-9 * np.abs(expected).max(), rtol=0)
        assert statuses(forces) == statuses(expected)
        states = [np.concatenate(body.state) for body in (one, other)]
        np.testing.assert_allclose(*states, atol=1e-10 * np.abs(states[1]).max(), rtol=0)
        touched += forces.any()
    assert 0.05 * STEPS < touched < 0.9 * STEPS
    sums = np.array([[total for total, _ in body.ledger.sums] for body in (one, other)])
    np.testing.assert_allclose(*sums, atol=1e-9 * np.abs(sums).max(), rtol=0)
    notes = [body.integrator.kernel.notes for body in (one, other)]
    assert notes[0].keys() == notes[1].keys()
    for name, value in notes[0].items():
        assert value == pytest.approx(notes[1][name], rel=1e-7, abs=1e-12), name
    for body in (one, other):
        assert_account_closes(body)


@pytest.mark.parametrize("law", LAWS)
def test_a_restored_state_goes_on_to_the_bit(law):
    rom = soft_rom(law, order=8, contact=True)
    body, other = (fr.Simulator(rom, DT, stepper="linearly-implicit") for _ in range(2))
    forces = history(3, body.inputs)
    for u in forces[:100]:
        body.step(u)
    other.restore(pickle.loads(pickle.dumps(body.save())))
    for u in forces[100:]:
        body.step(u)
        other.step(u)
    assert body.contact_forces().any()
    np.testing.assert_array_equal(np.concatenate(body.state), np.concatenate(other.state))
    assert body.ledger.sums == other.ledger.sums


def test_an_obstacle_that_moves_does_the_work_that_numpy_says():
    bodies = both(soft_rom(order=8, contact=True), signals={"floor": lambda t: [0.0, 0.0, 6e-3 * np.sin(40 * t)]})
    for u in history(4, bodies[0].inputs):
        for body in bodies:
            body.step(u)
    one, other = bodies
    assert abs(other.ledger.obstacles) > 1e-6
    assert one.ledger.obstacles == pytest.approx(other.ledger.obstacles, rel=1e-7)
    assert_account_closes(one)


def test_numpy_takes_steps_whose_forces_loops_do_not_find(monkeypatch):
    """From their beginning, whatever loops have made of what strains carry; and steps may be taken back."""
    rom = soft_rom("neo_hookean", order=8, contact=True)
    one, other = both(rom)
    take, given_up = compiled_held.take_step, [0]

    def give_up(*given):
        given_up[0] += 1
        *others, among, pull = given
        step = take(*others, among._replace(beyond=among.beyond.copy()), pull)
        return step._replace(status=OTHERWISE)

    for k, u in enumerate(history(5, one.inputs)):
        with monkeypatch.context() as patch:
            if k % 3 == 0:
                patch.setattr(compiled_held, "take_step", give_up)
            for body in (one, other):
                if k % 5 == 0:
                    body.step(-u)
                    body.integrator.rollback()
                body.step(u)
    assert given_up[0] > STEPS // 3
    states = [np.concatenate(body.state) for body in (one, other)]
    np.testing.assert_allclose(*states, atol=1e-8 * np.abs(states[1]).max(), rtol=0)
    assert_account_closes(one)


def test_a_step_that_is_refused_changes_nothing(monkeypatch):
    def refuse(*_):
        raise StepError("none")

    body = fr.Simulator(soft_rom(order=6, contact=True), DT, stepper="linearly-implicit")
    forces = history(6, body.inputs)
    for u in forces[:100]:
        body.step(u)
    before = np.concatenate([*body.state, body.contact_forces().ravel()])
    with pytest.raises(StepError):
        body.step(np.full(body.inputs, 1e300))
    with monkeypatch.context() as patch:
        patch.setattr(HeldBody, "step", refuse)
        with pytest.raises(StepError):
            body.step(forces[100])
    np.testing.assert_array_equal(np.concatenate([*body.state, body.contact_forces().ravel()]), before)
    body.step(forces[100])
    assert_account_closes(body)


@pytest.mark.parametrize("law", LAWS)
def test_rollouts_are_steps(law):
    """State, forces and notes to the bit, also of a run whose loops find no forces of some steps."""
    rom = in_one_mode(random_rom(law, 1))
    body, rolled = (fr.Simulator(rom, DT, stepper="linearly-implicit") for _ in range(2))
    forces, read, touched = history(7, body.inputs), [], 0
    for k, u in enumerate(forces, start=1):
        body.step(u)
        touched += body.contact_forces().any()
        if k % 7 == 0:
            read.append(body.displacement("tip"))
    assert touched > STEPS // 10
    tip = rolled.rollout(forces, every=7)["tip"]
    np.testing.assert_allclose(tip, read, atol=1e-12 * np.abs(read).max(), rtol=0)
    for name in ("state", "contact_forces"):
        one, other = (getattr(each, name) for each in (body, rolled))
        np.testing.assert_array_equal(*((one(), other()) if callable(one) else (one, other)))
    assert rolled.integrator.kernel.notes == pytest.approx(body.integrator.kernel.notes, rel=1e-12)
    assert_account_closes(rolled)
    sums = np.array([[total for total, _ in each.ledger.sums] for each in (body, rolled)])
    np.testing.assert_allclose(*sums, atol=1e-12 * np.abs(sums).max(), rtol=0)
    assert rolled.time == pytest.approx(body.time)
    body.step(forces[0])
    rolled.step(forces[0])
    np.testing.assert_array_equal(np.concatenate(body.state), np.concatenate(rolled.state))


def test_a_rollout_goes_on_where_loops_find_no_forces(monkeypatch):
    """The step is taken by itself, from where the one before led; loops take those after it."""
    rom, take = in_one_mode(soft_rom("neo_hookean", order=8, contact=True)), compiled_held.take_step
    bodies = [fr.Simulator(rom, DT, stepper="linearly-implicit") for _ in range(2)]
    forces, calls = history(8, bodies[0].inputs), []

    def give_up(body, u, halves, pushed, memory, *others):
        calls.append(u)
        if len(calls) % 30 == 0:
            memory.numbers[:] = np.nan
            return held_step.NOT_TAKEN
        return take(body, u, halves, pushed, memory, *others)

    bodies[0].rollout(forces)
    with monkeypatch.context() as patch:
        patch.setattr(held_steps, "take_step", give_up)
        patch.setattr(compiled_held, "take_steps", held_steps.take_steps.py_func)
        bodies[1].rollout(forces)
    assert len(calls) > 150
    np.testing.assert_array_equal(*(np.concatenate(body.state) for body in bodies))
    assert_account_closes(bodies[1])


def test_a_rollout_that_overflows_names_its_step_and_changes_nothing():
    body = fr.Simulator(in_one_mode(soft_rom(order=6, contact=True)), DT, stepper="linearly-implicit")
    forces = history(6, body.inputs)
    body.rollout(forces[:50])
    before = np.concatenate([*body.state, body.contact_forces().ravel()])
    forces[90] = 1e300
    with pytest.raises(StepError, match="step 90"):
        body.rollout(forces[50:])
    np.testing.assert_array_equal(np.concatenate([*body.state, body.contact_forces().ravel()]), before)
    assert_account_closes(body)
