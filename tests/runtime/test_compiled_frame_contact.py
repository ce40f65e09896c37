"""Compiled steps of bodies in moving frames among obstacles: NumPy's forces, motion and account; rollouts are steps."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from test_moving_frame import CLAMPED, reduced

import fenics_rom as fr
from fenics_rom.compilation import compiled, numpy_alone
from fenics_rom.errors import StepError
from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.mechanics.contact import ContactLaw
from fenics_rom.mechanics.frame_motion import quaternion_of_vector
from fenics_rom.runtime.compiled.touched_frame import nothing_taken
from fenics_rom.runtime.steppers import compiled_frame

pytestmark = [
    pytest.mark.skipif(not compiled(), reason="numba is not installed, or turned off"),
    pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning"),
]
DT, STEPS = 1e-3, 160  # s
EFFECTS = """inertia = {}
damping = { alpha = 0.0, beta = 2e-5 }
gravity = { acceleration = [0.0, 0.0, -9.81] }
contact.obstacles.floor = { shape = "half-space", point = [0.0, 0.0, -0.004], normal = [0.0, 0.0, 1.0] }
contact.obstacles.ball = { shape = "sphere", center = [0.2, 0.0, -0.105], radius = 0.1 }"""
LAWS = [
    ContactLaw(),
    ContactLaw(friction=0.4),
    ContactLaw(restitution=0.5, friction=0.4),
    ContactLaw(restitution=1.0),
    ContactLaw(stiffness=500.0, damping=0.5, friction=0.4),
]
KINDS = "free", "carried"


@pytest.fixture(scope="module")
def bodies(tmp_path_factory):
    """A free beam above a floor and a ball, and one that a base holds."""
    surfaces = '[contacts.bottom]\nsurface = "bottom"'
    parts = {"effects": EFFECTS, "contacts": surfaces, "outputs.end": "points = [[0.3, 0.0, 0.0], [0.15, 0.0, 0.0]]"}
    return {
        kind: reduced(tmp_path_factory.mktemp(kind), order=order, **parts, **supports)
        for kind, order, supports in (("free", 10, {}), ("carried", 6, CLAMPED))
    }


def under(rom, law):
    return replace(rom, environment=replace(rom.environment, contact_law=law))


def start(body, seed):
    """Throws a free body; the same way for the same seed."""
    if not body.is_carried:
        random = np.random.default_rng(seed)
        velocity, turning = random.uniform(-0.5, 0.5, 3), random.uniform(-3, 3, 3)
        body.place(body.pose._replace(velocity=velocity, angular_velocity=turning))
    return body


def both(rom, seed, **named):
    """A body that takes compiled steps, and one of NumPy; and for how many steps there were forces, by loops."""
    body = fr.Simulator(rom, DT, **named)
    assert body.takes_compiled_steps
    with numpy_alone():
        other = fr.Simulator(rom, DT, **named)
    return start(body, seed), start(other, seed)


def bases_of(body, seed):
    """A base that goes up and down and swings about, at the end of each step; None of a free body."""
    if not body.is_carried:
        return [None] * STEPS
    at, (a, b, c) = body.pose.position, np.random.default_rng(seed).uniform(0.5, 1.5, 3)
    times = DT * np.arange(1, STEPS + 1)

    def base(t):
        rise, turn, speed = 3e-3 * np.sin(40 * a * t), 0.05 * b * np.sin(30 * t), 1.5 * b * np.cos(30 * t)
        velocity = np.array([0.0, 0.05 * c, 0.12 * a * np.cos(40 * a * t)])
        rotation = quaternion_of_vector([0.0, turn, 0.0])
        return BaseState(at + np.array([0.0, 0.05 * c * t, rise]), rotation, velocity, np.array([0.0, speed, 0.0]))

    return [base(t) for t in times]


def state_of(body):
    return np.concatenate([*body.state, *body.pose, *body.momentum])


def assert_account_closes(body, first):
    account = body.ledger
    size = max(first, body.energy, abs(account.supplied), account.dissipated)
    kept = account.supplied - account.dissipated - account.lost_in_switching
    assert abs(body.energy - first - kept) <= 1e-12 * size
    assert account.friction >= -1e-12 * size


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("number", range(len(LAWS)))
def test_motion_forces_and_account_are_those_of_numpy(bodies, kind, number):
    """From the same state every eighth step on, so that what is compared is what steps do."""
    rom = under(bodies[kind], LAWS[number])
    one, other = both(rom, number)
    first, touched = one.energy, 0
    for k, base in enumerate(bases_of(one, number)):
        if k % 8 == 0:
            other.restore(one.save())
        for body in (one, other):
            body.step(np.zeros(body.inputs), base=base)
        forces, expected = one.contact_forces(), other.contact_forces()
        np.testing.assert_allclose(forces, expected, atol=1e-9 * max(np.abs(expected).max(), 1e-3), rtol=0)
        states = [state_of(body) for body in (one, other)]
        np.testing.assert_allclose(*states, atol=1e-10 * np.abs(states[1]).max(), rtol=0)
        touched += forces.any()
    assert touched > STEPS // 10
    sums = np.array([[total for total, _ in body.ledger.sums] for body in (one, other)])
    np.testing.assert_allclose(*sums, atol=1e-9 * np.abs(sums).max(), rtol=0)
    assert_account_closes(one, first)
    if one.is_carried:
        np.testing.assert_allclose(*map(np.concatenate, (one.base_wrench, other.base_wrench)), rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("kind", KINDS)
def test_an_obstacle_that_moves_does_the_work_that_numpy_says(bodies, kind):
    signals = {"floor": lambda t: [0.0, 0.0, 4e-3 * np.sin(40 * t)]}
    one, other = both(under(bodies[kind], LAWS[1]), 3, signals=signals)
    first = one.energy
    for base in bases_of(one, 3):
        for body in (one, other):
            body.step(np.zeros(body.inputs), base=base)
    assert abs(other.ledger.obstacles) > 1e-5
    assert one.ledger.obstacles == pytest.approx(other.ledger.obstacles, rel=1e-6)
    assert_account_closes(one, first)


@pytest.mark.parametrize("kind", KINDS)
def test_loops_take_nearly_all_steps(bodies, kind, monkeypatch):
    body, taken = start(fr.Simulator(under(bodies[kind], LAWS[2]), DT), 4), []
    loops = body.integrator.kernel._compiled
    take = loops.take
    monkeypatch.setattr(loops, "take", lambda *given: taken.append(take(*given)) or taken[-1])
    for base in bases_of(body, 4):
        body.step(np.zeros(body.inputs), base=base)
    assert len(taken) == STEPS
    assert sum(step is None for step in taken) <= STEPS // 50


@pytest.mark.parametrize("kind", KINDS)
def test_rollouts_are_steps(bodies, kind):
    """State, forces and account, also of outputs that yield beyond the basis."""
    rom = under(bodies[kind], LAWS[2])
    body, rolled = (start(fr.Simulator(rom, DT), 5) for _ in range(2))
    bases, read, touched = bases_of(body, 5), [], 0
    for k, base in enumerate(bases, start=1):
        body.step(np.zeros(body.inputs), base=base)
        touched += body.contact_forces().any()
        if k % 7 == 0:
            read.append(body.displacement("end"))
    assert touched > STEPS // 10
    rows = BaseState(*map(np.array, zip(*bases, strict=True))) if body.is_carried else None
    end = rolled.rollout(np.zeros((STEPS, body.inputs)), base=rows, every=7)["end"]
    np.testing.assert_allclose(end, read, atol=1e-12, rtol=0)
    for one, same in ((state_of(body), state_of(rolled)), (body.contact_forces(), rolled.contact_forces())):
        np.testing.assert_allclose(same, one, rtol=0, atol=1e-12 * np.abs(one).max(initial=1e-3))
    sums = np.array([[total for total, _ in each.ledger.sums] for each in (body, rolled)])
    np.testing.assert_allclose(*sums, atol=1e-12 * np.abs(sums).max(), rtol=0)


@pytest.mark.parametrize("kind", KINDS)
def test_a_restored_state_goes_on_to_the_bit(bodies, kind):
    rom = under(bodies[kind], LAWS[2])
    body, other = (start(fr.Simulator(rom, DT), 6) for _ in range(2))
    for k, base in enumerate(bases_of(body, 6)):
        if k == STEPS // 2:
            other.restore(pickle.loads(pickle.dumps(body.save())))
        body.step(np.zeros(body.inputs), base=base)
        if k >= STEPS // 2:
            other.step(np.zeros(body.inputs), base=base)
    assert body.contact_forces().any() or body.ledger.contact > 0
    np.testing.assert_array_equal(state_of(body), state_of(other))
    assert body.ledger.sums == other.ledger.sums


@pytest.mark.parametrize("kind", KINDS)
def test_numpy_takes_steps_whose_forces_loops_do_not_find(bodies, kind, monkeypatch):
    """From their beginning; and steps may be taken back."""
    one, other = both(under(bodies[kind], LAWS[1]), 7)
    given_up = [0]

    def give_up(*_):
        given_up[0] += 1
        return nothing_taken()

    for k, base in enumerate(bases_of(one, 7)):
        with monkeypatch.context() as patch:
            if k % 3 == 0:
                patch.setitem(compiled_frame.TOUCHED, (one.is_carried, False), give_up)
            for body in (one, other):
                if k % 5 == 0:
                    body.step(np.zeros(body.inputs), base=base)
                    body.integrator.rollback()
                    body.steps -= 1
                body.step(np.zeros(body.inputs), base=base)
    assert given_up[0] > STEPS // 3
    states = [state_of(body) for body in (one, other)]
    np.testing.assert_allclose(*states, atol=1e-8 * np.abs(states[1]).max(), rtol=0)


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_not_finite_changes_nothing(bodies, kind):
    body = start(fr.Simulator(under(bodies[kind], LAWS[1]), DT), 8)
    bases = bases_of(body, 8)
    for base in bases[:60]:
        body.step(np.zeros(body.inputs), base=base)
    before = np.concatenate([state_of(body), body.contact_forces().ravel()])
    with pytest.raises(StepError):
        body.step(np.full(body.inputs, 1e200), base=bases[60])
    np.testing.assert_array_equal(np.concatenate([state_of(body), body.contact_forces().ravel()]), before)
