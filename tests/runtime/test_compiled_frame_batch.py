"""Batches of bodies in frames that move, compiled: each body is a single one, to the bit."""

import pickle
from copy import copy
from dataclasses import replace

import numpy as np
import pytest
from soft_rom import in_frame, soft_rom
from test_compiled_frame_contact import LAWS, bases_of, bodies, under  # noqa: F401  # a fixture
from test_compiled_frames import history, random_body
from test_moving_frame import CLAMPED, reduced

import fenics_rom as fr
from fenics_rom.compilation import compiled, numpy_alone
from fenics_rom.errors import StepError
from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.mechanics.viscoelasticity import PronySeries
from fenics_rom.runtime import compiled_frames
from fenics_rom.runtime.frames_state import OF_LAW
from fenics_rom.runtime.steppers.carried_frame import CarriedFrame

pytestmark = [
    pytest.mark.skipif(not compiled(), reason="numba is not installed, or turned off"),
    pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning"),
]
SIZE, STEPS, DT = 40, 60, 1e-3  # more than one thread takes at once
KINDS = "free", "carried"


def bent(law, *, contact=False, relaxes=False):
    """A soft box of large deformation on a base."""
    rom = in_frame(soft_rom(law, order=6, contact=contact, touched_from=0.25))
    points = {name: rom.nodes[[-1]] for name in rom.outputs}
    rom = replace(rom, moving_frame=replace(rom.moving_frame, output_points=points), outputs=tip_of(rom))
    if relaxes:
        series = PronySeries((0.5, 0.3), (0.03, 2e-4))
        rom = replace(rom, environment=replace(rom.environment, viscoelasticity=series))
    return replace(rom, contact_models={"tip": rom.contact_models["tip"]}) if contact else rom


def tip_of(rom):
    return {name: rows[:3] for name, rows in rom.outputs.items()}


def single(rom):
    return fr.Simulator(rom, DT, stepper=None if rom.deformation is None else "linearly-implicit")


def together(states):
    """States of some bodies, one after another again and again; None of free ones."""
    if states[0] is None:
        return None
    return BaseState(*(np.array([each[k % len(states)] for k in range(SIZE)]) for each in zip(*states, strict=True)))


def thrown(body, k):
    """Where a free body begins."""
    velocity, turning = np.random.default_rng(k).uniform(-1, 1, (2, 3))
    return body.pose._replace(velocity=0.5 * velocity, angular_velocity=4 * turning)


def inputs_of(rom, size=1.0):
    """Random inputs of each body: (STEPS, SIZE, p)."""
    width = max(rom.contacts.values()) + sum(rom.actuators.values())
    scales = size * np.full(width, 0.3)
    if rom.actuators:
        scales[-2:] = 200.0, 0.2
    u = np.random.default_rng(1).standard_normal((STEPS, SIZE, width)) * scales
    return np.abs(u) if rom.actuators else u


def assert_same(batch, k, body, within=0.0):
    """To the bit, or within a share of the largest number."""

    def alike(found, expected):
        largest = np.abs(expected).max(initial=0.0)
        np.testing.assert_allclose(found, expected, rtol=0, atol=within * largest)

    alike([part[k] for part in batch.state()], body.state)
    if body.integrator.interface is not None:
        alike(batch.point_forces[k], body.contact_forces())
        alike(batch.contact_force("floor")[k], body.contact_forces("floor"))
        assert batch.through_skin[k] == pytest.approx(body.through_skin)
    assert batch.time[k] == body.time
    assert batch.energy[k] == pytest.approx(body.energy, rel=within, abs=0)
    for found, expected in zip(batch.base, body.pose, strict=True):
        np.testing.assert_allclose(found[k], expected, rtol=1e-13, atol=max(1e-14, within))
    if body.base_wrench is not None:
        alike([part[k] for part in batch.base_wrench], body.base_wrench)
    assert batch.mismatch[k] == pytest.approx(body.mismatch or 0.0, rel=max(1e-12, within), abs=max(1e-14, within))
    output = next(iter(body.rom.outputs))
    pairs = [(batch.displacement(output)[k], body.displacement(output)), (batch.shape(k), body.displacement())]
    for found, expected in (*pairs, (batch.velocity(output)[k], body.velocity(output))):
        np.testing.assert_allclose(found, expected, atol=max(1e-13, within) * max(1.0, np.abs(expected).max()), rtol=0)
    account = body.ledger
    sums = account.supplied, account.dissipated, account.obstacles, account.contact + account.friction
    read = batch.supplied, batch.dissipated, batch.supplied_by_obstacles, batch.dissipated_in_contact
    np.testing.assert_allclose([each[k] for each in read], sums, atol=max(1e-12, within) * np.abs(sums).max(), rtol=0)


def run_both(rom, bases, u, *, changes=True, within=0.0):
    """A batch, and its first bodies alone: one of these sits a step out, one begins anew, one is put, dt changes."""
    batch, law, singles = fr.Batch(rom, SIZE, DT, ledger=True), rom.environment.contact_law, [single(rom)]
    assert batch.stepping == "compiled"
    if law is None:
        singles += [single(rom) for _ in range(2)]
    else:  # each rubs otherwise
        batch.friction = law.friction + np.arange(SIZE) / SIZE
        singles += [single(under(rom, replace(law, friction=μ))) for μ in batch.friction[1:3].tolist()]
    for k, body in enumerate(singles):
        if not body.is_carried:
            pose = thrown(body, k)
            batch.place(pose, [k])
            body.place(pose)
    touched = 0
    for step, row in enumerate(u):
        if changes and step == 20:
            row[1] = np.nan
            batch.reset([2])
            singles[2].reset()
        if changes and step == 30:
            q, r = (part[0] / 2 for part in batch.state())
            batch.set_state(q, r, [0])
            singles[0].state = q, r
        if step == 40:
            batch.dt = DT / 2
        held = batch.step(row, base=together([each[step] for each in bases]), on_error="hold")
        assert held.tolist() == ([1] if changes and step == 20 else [])
        for k, body in enumerate(singles):
            body.dt = batch.dt
            if k not in held:
                body.step(row[k], base=bases[k][step])
        touched += law is not None and batch.point_forces[:3].any()
    for k, body in enumerate(singles):
        assert_same(batch, k, body, within)
    return batch, touched


@pytest.mark.parametrize("kind", KINDS)
def test_bodies_are_single_ones_to_the_bit(kind):
    rom = random_body(3, kind == "carried")
    bases = [history(single(rom), k)[1] for k in range(3)]
    run_both(rom, bases, inputs_of(rom))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("number", [2, 4])  # impacts with friction, and springs
def test_bodies_among_obstacles_are_single_ones(bodies, kind, number):  # noqa: F811
    """To round-off, as NumPy takes some steps of one, with forces that it finds to a tolerance."""
    rom = under(bodies[kind], LAWS[number])
    bases = [bases_of(single(rom), k) for k in range(3)]
    _, touched = run_both(rom, bases, np.zeros((STEPS, *inputs_of(rom).shape[1:])), changes=False, within=1e-10)
    assert touched > STEPS // 6


@pytest.mark.parametrize("relaxes", [False, True])
def test_bodies_that_deform_largely_are_single_ones_to_the_bit(relaxes):
    """With a switch of the contact mode, which all share a basis of."""
    rom = bent("neo_hookean", relaxes=relaxes)
    bases = [history(single(rom), k)[1] for k in range(3)]
    batch, _ = run_both(rom, bases, inputs_of(rom, 0.2))
    body, u = single(rom), inputs_of(rom, 0.2)[:, 0]
    batch.reset([0])
    batch.dt = DT
    for step in range(20):
        if step == 10:
            batch.switch("middle", [0])
            body.switch("middle")
        batch.step(u[step])
        body.step(u[step])
    np.testing.assert_array_equal([part[0] for part in batch.state()], body.state)


@pytest.mark.slow  # each kind takes half a minute to compile
def test_bodies_that_deform_largely_among_obstacles_are_single_ones_to_the_bit():
    rom = bent("st_venant_kirchhoff", contact=True)
    u = inputs_of(rom)
    u[:, :, :3] = [0.0, 0.0, -0.05]
    bases = [[single(rom).pose] * STEPS] * 3
    _, touched = run_both(rom, bases, u, changes=False)
    assert touched > STEPS // 6


def test_steps_that_loops_do_not_take_and_those_that_are_refused(monkeypatch):
    """NumPy takes the first, to round-off; the others change nothing, of those either that took them."""
    rom = bent("neo_hookean")
    batch, body, u = fr.Batch(rom, 3, DT, ledger=True), single(rom), inputs_of(rom, 0.2)[:, :3]
    kind, calls = (False, True, True), []
    step = compiled_frames.LOOPS[kind]

    def give_up(of, room):
        """As where matrices of body 1 are singular, and NumPy is to take its step."""
        if calls:
            step(of, room)
            return
        calls.append(of.some)
        step(of._replace(some=of.some[:1]), room)
        for now, before in batch._bodies._modes[0].returns[OF_LAW:]:
            before[1], now[1] = now[1], np.nan
        of.at[0] = 1
        raise np.linalg.LinAlgError

    def read():
        return *batch.state(), batch.time, batch.energy, batch.dissipated, batch.mismatch, *batch.base_wrench

    for row in u[:10]:
        batch.step(row)
        body.step(row[1])
    monkeypatch.setitem(compiled_frames.LOOPS, kind, give_up)
    taken = CarriedFrame.step

    def by_numpy(kernel, *given):
        kernel._taken_compiled = lambda *_: None
        return taken(kernel, *given)

    with monkeypatch.context() as patch:
        patch.setattr(CarriedFrame, "step", by_numpy)
        batch.step(u[10])
        body.step(u[10, 1])
    del batch._bodies._kernel._taken_compiled, body.integrator.kernel._taken_compiled
    for row in u[11:30]:
        batch.step(row)
        body.step(row[1])
    np.testing.assert_allclose([part[1] for part in batch.state()], body.state, rtol=0, atol=1e-13)
    assert batch.dissipated[1] == pytest.approx(body.ledger.dissipated, rel=1e-12)

    def refuse(*_):
        raise StepError("none")

    calls.clear()
    before = read()
    with monkeypatch.context() as patch:
        patch.setattr(CarriedFrame, "step", refuse)
        with pytest.raises(StepError, match=r"step 30, body 1: none; all bodies were left as they were"):
            batch.step(u[30])
    for found, expected in zip(before, read(), strict=True):
        np.testing.assert_array_equal(found, expected)
    others = [single(rom) for _ in range(3)]
    for row in u[:30]:
        for one, own in zip(others, row, strict=True):
            one.step(own)
    for row in u[30:]:
        batch.step(row)
        others[0].step(row[0])
    np.testing.assert_allclose([part[0] for part in batch.state()], others[0].state, rtol=0, atol=1e-9)  # T is new


def test_copies_go_on_alike_and_bodies_are_put_back():
    """Of copies and of what was pickled, to the bit, and apart from the first."""
    rom = random_body(4, False)
    batch, u = fr.Batch(rom, 3, DT, ledger=True), inputs_of(rom)[:, :3]
    batch.place(thrown(single(rom), 0))
    for row in u[:30]:
        batch.step(row)
    others = [copy(batch), pickle.loads(pickle.dumps(batch))]
    for each in others:
        for row in u[30:]:
            each.step(row)
    before = batch.state()
    for row in u[30:]:
        batch.step(row)
    assert (before[0] != batch.state()[0]).all()
    for each in others:
        np.testing.assert_array_equal(each.state(), batch.state())
        np.testing.assert_array_equal(each.dissipated, batch.dissipated)


def test_bodies_inside_obstacles_stand_still(bodies):  # noqa: F811
    batch = fr.Batch(under(bodies["carried"], LAWS[1]), 3, DT)
    batch.place_obstacle("floor", [0.0, 0.0, 1e-2], [1])
    before = batch.state()[0]
    with pytest.raises(StepError, match=r"body 1 is inside an obstacle.*; all bodies were left as they were"):
        batch.reset()
    pose = batch.base
    with pytest.raises(StepError, match="body 2"):
        batch.place(BaseState(*(part[2] for part in pose))._replace(position=pose.position[2] - [0, 0, 0.1]), [2])
    np.testing.assert_array_equal(batch.state()[0], before)
    np.testing.assert_array_equal(batch.base.position, pose.position)
    batch.reset(on_error="hold")
    assert batch.frozen.tolist() == [False, True, False]
    assert batch.step(np.zeros(batch.inputs)).tolist() == [1]
    assert batch.time.tolist() == [DT, 0.0, DT]


def test_strained_bodies_that_switch_go_on_one_after_another(tmp_path):
    """Until then they are compiled; a body at rest may switch."""
    rom = reduced(tmp_path, order=6, **CLAMPED)
    batch, singles = fr.Batch(rom, 2, DT, ledger=True), [fr.Simulator(rom, DT) for _ in range(2)]
    u, second = 0.1 * np.random.default_rng(0).standard_normal((40, 3)), list(rom.contact_models)[1]
    batch.switch(second, [0])
    singles[0].switch(second)
    for step, row in enumerate(u):
        if step == 20:
            assert batch.stepping == "compiled"
            batch.switch(second, [1])
            singles[1].switch(second)
            assert batch.stepping.startswith("one after another")
        batch.step(row)
        for body in singles:
            body.step(row)
    for k, body in enumerate(singles):
        np.testing.assert_allclose(batch.shape(k), body.displacement(), rtol=0, atol=1e-12)
        assert batch.energy[k] == pytest.approx(body.energy, rel=1e-10)
        assert batch.supplied[k] == pytest.approx(body.ledger.supplied, rel=1e-10)


def test_steps_are_those_of_numpys_batch():
    rom = random_body(3, True)
    with numpy_alone():
        other = fr.Batch(rom, SIZE, DT, ledger=True)
    batch, bases = fr.Batch(rom, SIZE, DT, ledger=True), [history(single(rom), k)[1] for k in range(3)]
    assert (batch.stepping, other.stepping) == ("compiled", "together")
    for step, row in enumerate(inputs_of(rom)):
        for each in (batch, other):
            each.step(row, base=together([of[step] for of in bases]))
    read = (*batch.state(), batch.energy, *batch.base_wrench), (*other.state(), other.energy, *other.base_wrench)
    for one, two in zip(*read, strict=True):
        np.testing.assert_allclose(one, two, atol=1e-9 * np.abs(two).max(), rtol=0)
    np.testing.assert_allclose(batch.base_misfit, other.base_misfit, atol=1e-9)
    assert (batch.beyond_training == other.beyond_training).all()
