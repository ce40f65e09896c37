"""Batches of held bodies that deform largely, compiled: each body is a single one, to the bit."""

import pickle
from copy import copy
from dataclasses import replace

import numpy as np
import pytest
from soft_rom import soft_rom

import fenics_rom as fr
from fenics_rom.compilation import compiled, numpy_alone
from fenics_rom.errors import StepError
from fenics_rom.mechanics.viscoelasticity import PronySeries
from fenics_rom.runtime import compiled_bending
from fenics_rom.runtime.compiled import held_bodies, held_step
from fenics_rom.runtime.steppers.held import HeldBody
from fenics_rom.runtime.steppers.selection import longest_linearly_implicit_step

pytestmark = [
    pytest.mark.skipif(not compiled(), reason="numba is not installed, or turned off"),
    pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning"),
]

SIZE, STEPS, DT = 40, 150, 2e-3
LAWS = "st_venant_kirchhoff", "neo_hookean", "relaxing"
CASES = [*((law, contact) for law in LAWS for contact in (False, True)), ("stroke", False), ("newton", True)]


def rom_of(law, contact):
    material = law if law in LAWS[:2] else "neo_hookean"
    rom = soft_rom(material, order=9, contact=contact, touched_from=0.25)
    if law in ("stroke", "newton"):
        rom = replace(rom, environment=replace(rom.environment, controls={"cable": "length"}))
    if law in ("relaxing", "newton"):
        series = PronySeries((0.5, 0.3), (0.03, 2e-4))
        rom = replace(rom, environment=replace(rom.environment, viscoelasticity=series))
    return replace(rom, contact_models={"tip": rom.contact_models["tip"]}) if contact else rom


def history(width, *, by_stroke=False):
    """Forces at the tip, air and tensions, or strokes, of each body others: (STEPS, SIZE, width)."""
    rng, t = np.random.default_rng(1), DT * np.arange(STEPS)[:, None]
    forces = np.zeros((STEPS, SIZE, width))
    size, rate = rng.uniform(0.5, 1.5, (3, SIZE)), rng.uniform(20, 40, (3, SIZE))
    forces[:, :, 0], forces[:, :, 1] = 0.05 * size[0] * np.sin(rate[0] * t), 0.05 * size[1] * np.sin(rate[1] * t)
    forces[:, :, 2] = 0.1 * size[2] * (np.sin(rate[2] * t) - 1)
    forces[:, :, -2:] = rng.uniform(0, [300.0, 0.3], (SIZE, 2)) * np.sin(10 * t[:, :, None]) ** 2
    forces[:, :, -1] *= 0.01 if by_stroke else 1.0
    return forces


def single(rom, dt=DT):
    body = fr.Simulator(rom, dt)
    assert body.integrator.kernel.is_compiled
    return body


def assert_same(bodies, k, body):
    np.testing.assert_array_equal([part[k] for part in bodies.state()], body.state)
    if body.integrator.interface is not None:
        np.testing.assert_array_equal(bodies.point_forces[k], body.contact_forces())
        np.testing.assert_array_equal(bodies.contact_force("floor")[k], body.obstacle_forces()[0])
    assert {name: forces[k] for name, forces in bodies.reactions.items()} == body.reactions
    assert bodies.time[k] == body.time
    assert bodies.energy[k] == pytest.approx(body.energy, rel=1e-13)
    assert bodies.mismatch[k] == pytest.approx(body.mismatch or 0.0, rel=1e-12, abs=1e-14)
    for one, other in (bodies.displacement("tip")[k], body.displacement("tip")), (bodies.shape(k), body.displacement()):
        np.testing.assert_allclose(one, other, atol=1e-13 * np.abs(other).max(), rtol=0)
    account = body.ledger
    sums = account.supplied, account.dissipated, account.obstacles, account.contact + account.friction
    read = bodies.supplied, bodies.dissipated, bodies.supplied_by_obstacles, bodies.dissipated_in_contact
    np.testing.assert_allclose([each[k] for each in read], sums, atol=1e-12 * np.abs(sums).max(), rtol=0)


@pytest.mark.parametrize(("law", "contact"), CASES)
def test_bodies_are_single_ones_to_the_bit(law, contact):
    """More than one thread takes at once; one sits a step out, one begins anew, one switches, and dt changes."""
    rom, by_stroke = rom_of(law, contact), law in ("stroke", "newton")
    dt = 1.2 * longest_linearly_implicit_step(rom) if law == "newton" else DT
    size = SIZE if dt == DT else 10  # Newton's steps take longer
    bodies, singles = fr.Batch(rom, size, dt, ledger=True), [single(rom, dt) for _ in range(4)]
    assert bodies.stepping == "compiled"
    assert (singles[0].stepper == "newton") == (law == "newton")
    pulled = False
    for step, u in enumerate(history(bodies.inputs, by_stroke=by_stroke)[:, :size]):
        if step == 60:
            u[1] = np.nan
            bodies.reset([2])
            singles[2].reset()
        if step == 80 and not contact:
            bodies.switch("middle", [3])
            singles[3].switch("middle")
        if step == 110:
            bodies.dt = dt / 2 if dt == DT else 0.9 * dt
        held = bodies.step(u, on_error="hold")
        pulled = pulled or (by_stroke and bodies.reactions["cable"].any())
        assert held.tolist() == ([1] if step == 60 else [])
        for k, body in enumerate(singles):
            body.dt = bodies.dt
            if k not in held:
                body.step(u[k])
    assert not contact or bodies.point_forces.any()
    assert pulled == by_stroke
    for k, body in enumerate(singles):
        assert_same(bodies, k, body)


@pytest.mark.parametrize("contact", [False, True])
def test_a_state_that_is_set_goes_on_as_that_of_a_single_one(contact):
    rom = rom_of("neo_hookean", contact)
    bodies, body, forces = fr.Batch(rom, 2, DT, ledger=True), single(rom), history(5)[:, :2]
    for u in forces[:30]:
        bodies.step(u)
        body.step(u[1])
    q, r = (part[1] / 2 for part in bodies.state())
    bodies.set_state(q, r, [1])
    body.state = q, r
    for u in forces[30:60]:
        bodies.step(u)
        body.step(u[1])
    np.testing.assert_array_equal([part[1] for part in bodies.state()], body.state)


@pytest.mark.parametrize("contact", [False, True])
def test_steps_that_loops_do_not_take_and_those_that_are_refused(contact, monkeypatch):
    """The first are those of a single body, to the bit; the others change nothing, of those either that took them."""
    rom, forces, take = rom_of("relaxing", contact), history(5), compiled_bending.step_bodies
    bodies, body = fr.Batch(rom, 3, DT, ledger=True), single(rom)

    def spoil(form, u, halves, pushed, memory, *others):
        memory.numbers[:] = memory.relaxed[:] = pushed[:] = np.nan
        return held_step.NOT_TAKEN

    def give_up(form, touch, pull, law, friction, shapes, some, *others):
        given = form, touch, pull, law, friction, shapes
        take(*given, some[some != 1], *others)
        with monkeypatch.context() as patch:
            patch.setattr(held_bodies, "take_step", spoil)
            take.py_func(*given, some[some == 1], *others)

    def refuse(*_):
        raise StepError("none")

    def read():
        forces = (bodies.point_forces,) if contact else ()
        return *bodies.state(), bodies.time, bodies.energy, bodies.dissipated, bodies.mismatch, *forces

    monkeypatch.setattr(compiled_bending, "step_bodies", give_up)
    for u in forces[:100, 0]:
        bodies.step(u)
        body.step(u)
    for k in range(3):
        np.testing.assert_array_equal([part[k] for part in bodies.state()], body.state)
    assert bodies.dissipated[1] == pytest.approx(body.ledger.dissipated, rel=1e-12)
    with monkeypatch.context() as patch:
        patch.setattr(HeldBody, "step", refuse)
        before = read()
        with pytest.raises(StepError, match=r"step 100, body 1: none; all bodies were left as they were"):
            bodies.step(forces[100, 0])
    for one, other in zip(before, read(), strict=True):
        np.testing.assert_array_equal(one, other)
    for u in forces[100:, 0]:
        bodies.step(u)
        body.step(u)
    np.testing.assert_array_equal([part[0] for part in bodies.state()], body.state)


def test_steps_are_those_of_numpys_batch():
    rom, forces = rom_of("st_venant_kirchhoff", False), history(5)
    with numpy_alone():
        others = fr.Batch(rom, SIZE, DT, ledger=True)
    bodies = fr.Batch(rom, SIZE, DT, ledger=True)
    assert (bodies.stepping, others.stepping) == ("compiled", "together")
    for u in forces:
        bodies.step(u)
        others.step(u)
    for one, other in zip((*bodies.state(), bodies.energy), (*others.state(), others.energy), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-9 * np.abs(other).max(), rtol=0)
    assert (bodies.beyond_training == others.beyond_training).all()


@pytest.mark.parametrize("contact", [False, True])
def test_copies_go_on_alike(contact):
    """Of copies and of what was pickled, to the bit, and apart from the first."""
    bodies, forces = fr.Batch(rom_of("relaxing", contact), 3, DT, ledger=True), history(5)[:, :3]
    for u in forces[:60]:
        bodies.step(u)
    others = [copy(bodies), pickle.loads(pickle.dumps(bodies))]
    for each in others:
        for u in forces[60:]:
            each.step(u)
    before = bodies.state()
    for u in forces[60:]:
        bodies.step(u)
    assert (before[0] != bodies.state()[0]).all()
    for each in others:
        np.testing.assert_array_equal(each.state(), bodies.state())
        np.testing.assert_array_equal(each.dissipated, bodies.dissipated)
