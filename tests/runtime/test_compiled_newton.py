"""Compiled steps by Newton's method of held bodies that deform largely: NumPy's motion, forces and account."""

from dataclasses import replace

import numpy as np
import pytest
from soft_rom import soft_rom

import fenics_rom as fr
from fenics_rom.compilation import compiled, numpy_alone
from fenics_rom.mechanics.viscoelasticity import PronySeries

pytestmark = [
    pytest.mark.skipif(not compiled(), reason="numba is not installed, or turned off"),
    pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning"),
]

STEPS, DT = 60, 0.015
LAWS = "st_venant_kirchhoff", "neo_hookean"


def rom_of(law, *, contact=False, by_stroke=False, relaxes=False):
    """On springs, and of two viscosities."""
    rom = soft_rom(law, order=8, contact=contact)
    if contact:
        rom = replace(rom, contact_models={"tip": rom.contact_models["tip"]})  # so that obstacles ask for no other
    series = PronySeries((0.5, 0.3), (0.03, 2e-4)) if relaxes else None
    acting = replace(rom.environment, controls={"cable": "length"} if by_stroke else {}, viscoelasticity=series)
    body = rom.deformation
    A, viscosity = (
        np.random.default_rng(0).standard_normal((8, 2)),
        body.viscosity * np.linspace(0.5, 1, len(body.weights)),
    )
    return replace(rom, environment=acting, deformation=replace(body, springs=30 * A @ A.T, viscosity=viscosity))


def both(rom):
    """A compiled body, and one of NumPy."""
    one = fr.Simulator(rom, DT, stepper="newton")
    with numpy_alone():
        other = fr.Simulator(rom, DT, stepper="newton")
    assert one.integrator.kernel.is_compiled
    assert not other.integrator.kernel.is_compiled
    return one, other


def history(body, *, by_stroke):
    """The tip is pushed to and fro, air swells it, and a cable pulls, to be slack at times: (STEPS, inputs)."""
    t, inputs = DT * np.arange(STEPS), np.zeros((STEPS, body.inputs))
    inputs[:, :3] = np.stack([0.05 * np.sin(50 * t), 0.05 * np.cos(20 * t), 0.12 * np.sin(9 * t) - 0.08], axis=1)
    inputs[:, -2], inputs[:, -1] = 300 * np.sin(5 * t), (3e-3 if by_stroke else 1.0) * np.sin(7 * t)
    return inputs


def assert_account_closes(body):
    account = body.ledger
    left = body.energy - account.supplied + account.dissipated
    assert abs(left) <= 1e-11 * max(body.energy, abs(account.supplied), account.dissipated)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize(
    ("contact", "by_stroke", "relaxes"),
    [(False, False, False), (False, False, True), (False, True, False), (True, False, True), (True, True, False)],
)
def test_steps_are_those_of_numpy(law, contact, by_stroke, relaxes, monkeypatch):
    """From the same state every eighth step on: motion, forces and account; loops take all steps."""
    one, other = both(rom_of(law, contact=contact, by_stroke=by_stroke, relaxes=relaxes))

    def in_numpy(u, obstacles, parts):
        raise AssertionError

    monkeypatch.setattr(one.integrator.kernel, "_in_parts", in_numpy)
    touched, pulled = 0, 0
    for k, u in enumerate(history(one, by_stroke=by_stroke)):
        if k % 8 == 0:
            other.restore(one.save())
        for body in (one, other):
            body.step(u)
        states = [np.concatenate(body.state) for body in (one, other)]
        np.testing.assert_allclose(*states, atol=1e-10 * np.abs(states[1]).max(), rtol=0)
        auxiliary = [body.integrator.kernel.auxiliary for body in (one, other)]
        np.testing.assert_allclose(*auxiliary, atol=1e-9 * np.abs(auxiliary[1]).max(initial=0.0), rtol=0)
        pushed = [body.contact_forces() if contact else np.empty(0) for body in (one, other)]
        found = [np.append([*body.reactions.values()], part) for body, part in zip((one, other), pushed, strict=True)]
        np.testing.assert_allclose(*found, atol=1e-9 * np.abs(found[1]).max(initial=1e-3), rtol=0)
        touched, pulled = touched + pushed[0].any(), pulled + any(one.reactions.values())
    assert (STEPS // 10 < touched < STEPS) == contact
    assert (STEPS // 10 < pulled < STEPS) == by_stroke
    assert not other.integrator.kernel.is_compiled
    assert one.energy == pytest.approx(other.energy, rel=1e-10)
    sums = np.array([[total for total, _ in body.ledger.sums] for body in (one, other)])
    np.testing.assert_allclose(*sums, atol=1e-9 * np.abs(sums).max(), rtol=0)
    assert_account_closes(one)


def test_rollouts_are_steps_and_a_restored_state_goes_on_to_the_bit():
    """With contact and a stroke; also where steps are taken back, and NumPy takes some."""
    rom = rom_of(LAWS[1], contact=True, by_stroke=True)
    body, rolled, restored, turns = (fr.Simulator(rom, DT, stepper="newton") for _ in range(4))
    forces, loops = history(body, by_stroke=True), turns.integrator.kernel.loops
    rolled.rollout(forces)
    touched = 0
    for k, u in enumerate(forces):
        body.step(u)
        touched += body.contact_forces().any()
        if k % 7 == 3:
            restored.step(2 * u)
            restored.integrator.rollback()
        if k == 30:
            restored.restore(restored.save())
        restored.step(u)
        turns.integrator.kernel._compiled = loops if k % 3 else None
        turns.step(u)
    for other in (rolled, restored):
        np.testing.assert_array_equal(np.concatenate(body.state), np.concatenate(other.state))
        np.testing.assert_array_equal(body.contact_forces(), other.contact_forces())
        assert body.reactions == other.reactions
    assert touched > STEPS // 10
    states = [np.concatenate(each.state) for each in (body, turns)]
    np.testing.assert_allclose(*states, atol=1e-6 * np.abs(states[0]).max(), rtol=0)
    assert_account_closes(rolled)
    assert_account_closes(turns)


def test_gradients_are_those_of_numpy():
    def height(outputs, energies):
        slope = np.zeros_like(outputs["tip"])
        slope[-1] = 1.0
        return float(outputs["tip"][-1].sum()), {"tip": slope}, None

    found = []
    for body in both(rom_of(LAWS[1], relaxes=True)):
        gradient = fr.differentiate(body, history(body, by_stroke=False)[:12], height)
        found.append(np.concatenate([gradient.inputs.ravel(), *gradient.state]))
    np.testing.assert_allclose(*found, atol=1e-8 * np.abs(found[1]).max(), rtol=0)
