"""Compiled steps of bodies in moving frames: NumPy's motion, account and wrench; exact laws; rollouts are steps."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_moving_frame import CLAMPED, FLOOR, FORCE, GRAVITY, reduced

import fenics_rom as fr
from fenics_rom.compilation import compiled, numpy_alone
from fenics_rom.mechanics import frame_motion
from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.mechanics.frame_motion import quaternion_of_vector
from fenics_rom.reduction.moving_frame import inertia_constants
from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.rom.rom import check_rom

pytestmark = [
    pytest.mark.skipif(not compiled(), reason="numba is not installed, or turned off"),
    pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning"),
]
SAME = 1e-10  # of the largest number, after 100 steps: round-off of steps that end at 1e-15 of the velocities
EXACT = 1e-12  # of the energy or the work: ten times what 100 steps of these bodies leave
DT, STEPS = 2e-3, 100  # s
seeds = st.integers(0, 2**32 - 1)


def random_body(seed, carried):
    """A ROM of points with random masses, random vectors that strain them, and inputs that turn with its frame."""
    random = np.random.default_rng(seed)
    points, m, p = random.integers(5, 9), random.integers(1, 7), random.integers(1, 4)
    mass, X = random.uniform(0.1, 1.0, points), random.uniform(-0.2, 0.2, (points, 3))
    M, turns = np.kron(np.diag(mass), np.eye(3)), np.cross((X - mass @ X / mass.sum())[:, None], np.eye(3))
    rigid = np.hstack([np.tile(np.eye(3), (points, 1)), turns.transpose(0, 2, 1).reshape(-1, 3)])[
        :, : 0 if carried else 6
    ]
    spanned = np.sqrt(M) @ np.hstack([rigid, random.standard_normal((3 * points, m))])
    V = np.linalg.qr(spanned)[0][:, rigid.shape[1] :] / np.sqrt(mass).repeat(3)[:, None]
    κ, A = np.sort(10 ** random.uniform(2, 4, m)), 0.3 * random.standard_normal((m, m))
    frame = inertia_constants(X, M, V, carried=carried)
    if random.random() < 0.3:  # as with detail = "quasi-rigid"
        nothing = {name: 0 * getattr(frame, name) for name in ("inertia1", "inertia2", "coupling")}
        frame = replace(frame, **nothing)
    frame = replace(
        frame,
        wrenches={"skin": random.standard_normal((6, p))},
        torque_modes={"skin": random.standard_normal((p, 3, m))},
        output_points={"all": X},
    )
    D = 1e-3 * κ if random.random() < 0.5 else (A @ A.T + (A @ A.T).T) / 2
    model = ContactModel(κ, D, random.standard_normal((m, p)), np.eye(m), np.eye(m), np.empty(0))
    return check_rom(
        fr.Rom(
            name="random",
            switching="energy",
            contact_models={"skin": model},
            actuators={},
            basis=V,
            stiffness=κ,
            outputs={"all": V},
            free=np.arange(3 * points),
            nodes=X,
            triangles=np.array([[0, 1, 2]]),
            node_mass=np.empty(0),
            moving_frame=frame,
            environment=fr.Environment(frame="moving", effects={"inertia": "", "damping": ""}),
        )
    )


def both(rom, dt=DT, **named):
    """A body that takes compiled steps, and one of NumPy."""
    body = fr.Simulator(rom, dt, **named)
    assert body.takes_compiled_steps
    with numpy_alone():
        return body, fr.Simulator(rom, dt, **named)


def turned_by(state, t, h):
    """The quaternion after a turn by t, in world axes, whose rate a base has in the middle of a step."""
    return frame_motion.composed(tuple(quaternion_of_vector(h * t)), tuple(state.rotation))


def history(body, seed, size=0.3):
    """Random inputs, and random twists of a base with poses that fit them."""
    random = np.random.default_rng(seed)
    base, bases = body.pose, []
    for _ in range(STEPS):
        v, ω = random.uniform(-1, 1, 3), random.uniform(-6, 6, 3)
        v, ω = 0.9 * base.velocity + 0.1 * v, 0.9 * base.angular_velocity + 0.1 * ω
        position = base.position + body.dt * (v + base.velocity) / 2
        rotation = np.array(turned_by(base, (ω + base.angular_velocity) / 2, body.dt))
        bases.append(base := BaseState(position, rotation, v, ω))
    inputs = size * random.standard_normal((STEPS, body.inputs))
    return inputs, bases if body.is_carried else [None] * STEPS


def start(body, seed):
    """Puts a free body on its way."""
    if not body.is_carried:
        random = np.random.default_rng(seed)
        velocity, turning = random.uniform(-1, 1, (2, 3))
        body.place(body.pose._replace(velocity=velocity, angular_velocity=6 * turning))


def told(body):
    """All that there is to read after a step."""
    sums = np.array([total for total, _ in body.ledger.sums])
    parts = [*body.state, body.displacement("all" if "all" in body.rom.outputs else None).ravel(), *body.pose]
    parts += [*body.momentum, sums, [body.energy]]
    return [np.asarray(part) for part in (parts if body.base_wrench is None else [*parts, *body.base_wrench])]


def assert_same(one, other):
    for a, b in zip(told(one), told(other), strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=SAME * max(1.0, np.abs(b).max(initial=0.0)))
    assert one.integrator.diagnostics() == other.integrator.diagnostics()


@pytest.mark.parametrize("carried", [False, True], ids=["free", "carried"])
@given(seeds)
@settings(deadline=None, max_examples=30)
def test_motion_account_and_wrench_are_those_of_numpy(carried, seed):
    bodies = both(random_body(seed, carried))
    for body in bodies:
        start(body, seed)
    first = bodies[0].energy
    inputs, bases = history(bodies[0], seed)
    for body in bodies:
        for u, base in zip(inputs, bases, strict=True):
            body.step(u, base=base)
    assert_same(*bodies)
    body = bodies[0]
    account = body.ledger
    scale = max(first, body.energy, abs(account.supplied), account.dissipated)
    assert abs(body.energy - first - account.supplied + account.dissipated) <= EXACT * scale


@given(seeds)
@settings(deadline=None, max_examples=30)
def test_momenta_of_a_free_body_stay(seed):
    body = fr.Simulator(random_body(seed, carried=False), DT)
    start(body, seed)
    random = np.random.default_rng(seed)
    body.state = 1e-2 * random.standard_normal((2, len(body.state[0])))
    before = body.momentum
    body.rollout(np.zeros((STEPS, body.inputs)))
    for now, was in zip(body.momentum, before, strict=True):
        np.testing.assert_allclose(now, was, rtol=0, atol=1e-14 * max(1.0, np.abs(was).max()))


@pytest.mark.parametrize("every", [1, 7])
@pytest.mark.parametrize("carried", [False, True], ids=["free", "carried"])
@given(seeds)
@settings(deadline=None, max_examples=15)
def test_rollouts_are_steps(every, carried, seed):
    rom = random_body(seed, carried)
    one, other, listed = (fr.Simulator(rom, DT) for _ in range(3))
    for body in (one, other, listed):
        start(body, seed)
    inputs, bases = history(one, seed)
    rows, read = (BaseState(*map(np.array, zip(*bases, strict=True))) if carried else None), []
    for k, (u, base) in enumerate(zip(inputs, bases, strict=True)):
        one.step(u, base=base)
        if (k + 1) % every == 0:
            read.append(one.displacement("all"))
    rolled = other.rollout(inputs, base=rows, every=every)["all"]
    listed.rollout(inputs, base=bases if carried else None)
    np.testing.assert_allclose(rolled, read, rtol=0, atol=SAME)
    assert one.steps == other.steps == STEPS
    assert_same(other, one)
    assert_same(listed, one)


@pytest.fixture(scope="module")
def pulled(tmp_path_factory):
    """A free beam that falls, and is pulled at one end along the axes of space."""
    return reduced(tmp_path_factory.mktemp("pulled"), **GRAVITY, **FORCE)


@pytest.fixture(scope="module")
def carried(tmp_path_factory):
    """The same, held by a base."""
    return reduced(tmp_path_factory.mktemp("carried"), **CLAMPED, **GRAVITY, **FORCE)


@pytest.mark.parametrize("detail", ["full", "quasi-rigid"])
@pytest.mark.parametrize("name", ["pulled", "carried"])
def test_weight_and_forces_in_space_are_those_of_numpy(request, name, detail):
    bodies = both(request.getfixturevalue(name), detail=detail)
    inputs, bases = history(bodies[0], 3, size=1e-2)
    for body in bodies:
        start(body, 3)
        for u, base in zip(inputs, bases, strict=True):
            body.step(u, base=base)
    assert_same(*bodies)


@pytest.mark.parametrize("name", ["pulled", "carried"])
def test_a_restored_state_goes_on_to_the_bit(request, name):
    rom = request.getfixturevalue(name)
    body, other = fr.Simulator(rom, DT), fr.Simulator(rom, DT)
    inputs, bases = history(body, 5, size=1e-2)
    for k, (u, base) in enumerate(zip(inputs, bases, strict=True)):
        if k == STEPS // 2:
            other.restore(pickle.loads(pickle.dumps(body.save())))
        body.dt = DT if k % 3 else DT / 2
        body.step(u, base=base)
        if k >= STEPS // 2:
            other.dt = body.dt
            other.step(u, base=base)
    for one, same in zip(told(body), told(other), strict=True):
        np.testing.assert_array_equal(one, same)


def test_a_path_is_the_same_in_steps_and_at_all_times_together(carried):
    def pose(t):
        return [0.1 * np.sin(5 * t), 0.0, 0.05 * t], quaternion_of_vector([0.0, np.sin(3 * t), 0.2 * t])

    times = np.linspace(0.0, 0.15, 16)
    path = fr.BasePath(times, *map(np.array, zip(*map(pose, times), strict=True)))
    asked = np.array([-0.1, 0.0, 0.01, 0.033, 0.15, 0.2])
    for rows, one_by_one in zip(path.along(asked), zip(*map(path, asked), strict=True), strict=True):
        np.testing.assert_allclose(rows, one_by_one, rtol=0, atol=2e-14)
    one, other = (fr.Simulator(carried, DT, signals={"base_path": path}) for _ in range(2))
    for _ in range(STEPS):
        one.step(np.zeros(one.inputs))
    other.rollout(np.zeros((STEPS, other.inputs)))
    assert_same(other, one)


def test_what_compiled_steps_do_not_take_numpy_refuses(pulled, carried):
    """A turn that is too far, of either; and what leaves the finite numbers."""
    for rom in (pulled, carried):
        body = fr.Simulator(rom, 0.5)
        start(body, 1)
        body.place(body.pose._replace(angular_velocity=np.array([0.0, 5.0, 0.0])))
        for take, inputs in ((body.step, np.zeros(body.inputs)), (body.rollout, np.zeros((3, body.inputs)))):
            before = told(body)
            with pytest.raises(fr.StepError, match="would turn by"):
                take(inputs)
            for one, same in zip(told(body), before, strict=True):
                np.testing.assert_array_equal(one, same)
        body = fr.Simulator(rom, DT)
        with pytest.raises(fr.StepError, match=r"so large|far from its shape"):
            body.step(np.full(body.inputs, 1e200))
        assert body.steps == 0


def test_forces_that_turn_a_body_beyond_all_numbers_are_refused():
    for body in both(random_body(3, carried=False)):
        with pytest.raises(fr.StepError, match="iterations diverge; a smaller dt, or less force, is the cure"):
            body.step(np.full(body.inputs, 1e60))
        np.testing.assert_array_equal(body.pose.rotation, [1.0, 0.0, 0.0, 0.0])


def test_what_is_bent_too_far_is_told_as_numpy_does(carried):
    bodies = both(carried)
    for body in bodies:
        body.state = np.eye(len(body.state[0]))[0] * 5e-2, 0 * body.state[1]
        body.step(np.zeros(body.inputs))
    assert_same(*bodies)
    assert any("bent by up to" in message for message in bodies[0].integrator.diagnostics())


@pytest.mark.parametrize("friction", [0.0, 0.4])
def test_a_beam_that_tumbles_on_a_floor_does_as_with_numpy(tmp_path, friction):
    """Sweeps of a step in NumPy ask compiled loops for forces, and pass on what they decided."""
    surfaces = "".join(f'[contacts.{name}]\nsurface = "{name}"\n' for name in ("left", "right"))
    rom = reduced(tmp_path, contacts=surfaces, effects=f"{FLOOR}\nfriction = {{ coefficient = {friction} }}")
    one = fr.Simulator(rom, 1e-3)
    with numpy_alone():
        other = fr.Simulator(rom, 1e-3)
    for body in (one, other):
        body.place(body.pose._replace(velocity=np.array([0.5, 0.1, -0.2]), angular_velocity=np.array([0.5, 2.0, 0.3])))
        for _ in range(STEPS):
            body.step(np.zeros(body.inputs))
    assert type(one.integrator.interface.solver) is not type(other.integrator.interface.solver)
    assert one.ledger.contact > 0.1 * one.energy
    np.testing.assert_allclose(one.displacement(), other.displacement(), rtol=0, atol=1e-9)
    np.testing.assert_allclose(one.contact_forces(), other.contact_forces(), rtol=0, atol=1e-6)
