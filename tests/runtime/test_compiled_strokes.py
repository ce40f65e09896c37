"""Compiled steps of bodies that deform largely by strokes of cables: NumPy's motion, forces and account."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from soft_rom import soft_rom

import fenics_rom as fr
from fenics_rom.compilation import compiled, numpy_alone
from fenics_rom.rom.deformation import ReducedTendon

pytestmark = [
    pytest.mark.skipif(not compiled(), reason="numba is not installed, or turned off"),
    pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning"),
]

STEPS, DT = 100, 2e-3
LAWS = "st_venant_kirchhoff", "neo_hookean"


def pulled(rom, *names):
    """With the strokes of these cables given."""
    return replace(rom, environment=replace(rom.environment, controls=dict.fromkeys(names, "length")))


def with_two_cables(rom):
    """With one along an upper edge in place of the pressure."""
    nodes, rows = rom.nodes, np.zeros((rom.nodes.size, rom.basis.shape[1]))
    rows[rom.free] = rom.basis
    edge = np.flatnonzero((nodes[:, 1] < 1e-6) & (nodes[:, 2] > 0.02 - 1e-6))
    edge = edge[nodes[edge, 0].argsort()]
    upper = ReducedTendon(nodes[edge], rows.reshape(len(nodes), 3, -1)[edge].reshape(3 * len(edge), -1))
    tendons = {"air": upper, **rom.deformation.tendons}
    return replace(rom, deformation=replace(rom.deformation, pressures={}, tendons=tendons))


def both(rom):
    """A compiled body, and one of NumPy."""
    body = fr.Simulator(rom, DT, stepper="linearly-implicit")
    assert body.integrator.kernel.is_compiled
    with numpy_alone():
        return body, fr.Simulator(rom, DT, stepper="linearly-implicit")


def history(seed, body):
    """A cable pulls by up to 6 mm, and is let go until it is slack; the tip is pushed a little: (STEPS, inputs)."""
    rng, t = np.random.default_rng(seed), DT * np.arange(STEPS)
    forces = np.zeros((STEPS, body.inputs))
    forces[:, :3] = 0.02 * rng.standard_normal(3) * np.sin(40 * t)[:, None]
    forces[:, -1] = 6e-3 * np.sin(rng.uniform(30, 45) * t)
    return forces


def assert_account_closes(body):
    account = body.ledger
    size = max(body.energy, abs(account.supplied), account.dissipated)
    assert abs(body.energy - account.supplied + account.dissipated) <= 1e-12 * size


def assert_alike(one, other):
    """The motion of 100 steps, forces, sums and notes."""
    states = [np.concatenate(body.state) for body in (one, other)]
    np.testing.assert_allclose(*states, atol=1e-10 * np.abs(states[1]).max(), rtol=0)
    sums = np.array([[total for total, _ in body.ledger.sums] for body in (one, other)])
    np.testing.assert_allclose(*sums, atol=1e-10 * np.abs(sums).max(), rtol=0)
    notes = [body.integrator.kernel.notes for body in (one, other)]
    for name, value in notes[0].items():
        assert value == pytest.approx(notes[1][name], rel=1e-8, abs=1e-12), name
    assert_account_closes(one)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("seed", range(3))
def test_a_cable_pulls_as_in_numpy_and_is_slack(law, seed):
    rng = np.random.default_rng(seed)
    one, other = both(pulled(soft_rom(law, order=int(rng.integers(5, 15))), "cable"))
    read = []
    for u in history(seed, one):
        for body in (one, other):
            body.step(u)
        read.append([body.reactions["cable"] for body in (one, other)])
    found, expected = np.array(read).T
    np.testing.assert_allclose(found, expected, atol=1e-9 * expected.max(), rtol=0)
    assert 0.1 * STEPS < (found == 0).sum() < 0.9 * STEPS
    assert_alike(one, other)


def test_two_cables_pull_and_numpy_says_which_is_slack():
    one, other = both(pulled(with_two_cables(soft_rom(order=8)), "air", "cable"))
    slack = 0
    for k, u in enumerate(history(1, one)):
        u[-2:] = 2e-5 * k, 2e-5 * k + 2e-4 * np.sin(k / 9)
        for body in (one, other):
            body.step(u)
        slack += 0.0 in one.reactions.values()
        for name, force in other.reactions.items():
            assert one.reactions[name] == pytest.approx(force, rel=1e-7, abs=1e-9), name
    assert 0 < slack < STEPS
    assert_alike(one, other)


@pytest.mark.parametrize("law", LAWS)
def test_rollouts_are_steps_and_a_restored_state_goes_on_to_the_bit(law):
    rom = pulled(soft_rom(law, order=8), "cable")
    body, rolled, restored = (fr.Simulator(rom, DT, stepper="linearly-implicit") for _ in range(3))
    forces = history(2, body)
    rolled.rollout(forces)
    for u in forces:
        body.step(u)
    for k, u in enumerate(forces):
        restored.step(u)
        if k == 50:
            state = pickle.loads(pickle.dumps(restored.save()))
            restored.step(2 * u)
            restored.restore(state)
    np.testing.assert_array_equal(np.concatenate(body.state), np.concatenate(rolled.state))
    assert body.reactions == rolled.reactions
    assert rolled.integrator.kernel.notes == pytest.approx(body.integrator.kernel.notes, rel=1e-12)
    assert_account_closes(rolled)
    again = fr.Simulator(rom, DT, stepper="linearly-implicit")
    for k, u in enumerate(forces):
        again.step(u)
        if k == 50:
            again.save()
    np.testing.assert_array_equal(np.concatenate(again.state), np.concatenate(restored.state))


@pytest.mark.parametrize(("name", "control", "contact"), [("cable", "length", True), ("air", "volume", False)])
def test_what_touches_or_swells_is_numpys(name, control, contact):
    rom = soft_rom(order=5, contact=contact)
    rom = replace(rom, environment=replace(rom.environment, controls={name: control}))
    body = fr.Simulator(rom, DT, stepper="linearly-implicit")
    assert not body.integrator.kernel.is_compiled
    body.rollout(np.zeros((3, body.inputs)))
    assert fr.Batch(rom, 2, DT).stepping != "compiled"
