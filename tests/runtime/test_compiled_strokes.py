"""Compiled steps of bodies that deform largely by strokes of cables: NumPy's motion, forces and account."""

import pickle
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from soft_rom import soft_rom

import fenics_rom as fr
from fenics_rom.compilation import compiled, numpy_alone
from fenics_rom.rom.deformation import ReducedTendon
from fenics_rom.runtime.compiled import held_touch
from fenics_rom.runtime.compiled.strokes import Pull, end_pull, find_held

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


@pytest.mark.parametrize(
    ("law", "cables"), [("st_venant_kirchhoff", 1), ("neo_hookean", 1), ("st_venant_kirchhoff", 2)]
)
def test_strokes_among_obstacles_are_those_of_numpy(law, cables, monkeypatch):
    """From the same state every eighth step on: forces of contact and cables, motion and account.

    Loops take nearly all steps of a single cable, and those in which two cables are taut.
    """
    rom = soft_rom(law, order=9, contact=True)
    rom = pulled(rom, "cable") if cables == 1 else pulled(with_two_cables(rom), "air", "cable")
    one, other = both(rom)
    t, inputs, touched, tense, refused = DT * np.arange(2 * STEPS), np.zeros((2 * STEPS, one.inputs)), 0, 0, [0]
    push, strokes = (0.1, 3e-3 * np.sin(35 * t)) if cables == 1 else (0.15, 1e-3 + 7e-4 * np.sin(35 * t))
    inputs[:, :3] = np.stack([0.05 * np.sin(50 * t), 0.05 * np.cos(20 * t), push * np.sin(30 * t) - push], axis=1)
    inputs[:, -cables:] = strokes[:, None]
    loops = one.integrator.kernel.loops
    take = loops.take

    def counted(*given):
        taken = take(*given)
        refused[0] += taken is None
        return taken

    monkeypatch.setattr(loops, "take", counted)
    for k, u in enumerate(inputs):
        if k % 8 == 0:
            other.restore(one.save())
        for body in (one, other):
            body.step(u)
        pairs = [[body.contact_forces().ravel(), np.array(list(body.reactions.values()))] for body in (one, other)]
        for found, expected in zip(*pairs, strict=True):
            np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max(initial=1e-3), rtol=0)
        states = [np.concatenate(body.state) for body in (one, other)]
        np.testing.assert_allclose(*states, atol=1e-10 * np.abs(states[1]).max(), rtol=0)
        touched, tense = touched + pairs[0][0].any(), tense + (pairs[0][1] > 0).all()
    assert STEPS // 5 < touched < 2 * STEPS
    assert STEPS // 10 < tense < 2 * STEPS
    assert refused[0] <= (STEPS // 20 if cables == 1 else 2 * STEPS - tense)
    assert_account_closes(one)
    sums = np.array([[total for total, _ in body.ledger.sums] for body in (one, other)])
    np.testing.assert_allclose(*sums, atol=1e-9 * np.abs(sums).max(), rtol=0)


def test_rollouts_of_strokes_among_obstacles_are_steps():
    rom = pulled(soft_rom(order=8, contact=True), "cable")
    rom = replace(rom, contact_models={"tip": rom.contact_models["tip"]})  # so that obstacles ask for no other
    body, rolled = both(rom)[0], both(rom)[0]
    t, inputs = DT * np.arange(STEPS), np.zeros((STEPS, body.inputs))
    inputs[:, 2], inputs[:, -1] = 0.1 * np.sin(30 * t) - 0.1, 3e-3 * np.sin(35 * t)
    for u in inputs:
        body.step(u)
    rolled.rollout(inputs)
    for one, same in ((body.state, rolled.state), (body.contact_forces(), rolled.contact_forces())):
        np.testing.assert_array_equal(one, same)
    assert body.reactions == rolled.reactions
    assert_account_closes(rolled)


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


@pytest.mark.parametrize("contact", [False, True])
def test_two_cables_pull_and_one_of_them_or_both_are_slack(contact, monkeypatch):
    """Loops take all steps; with contact from the same state every eighth step on."""
    rom = with_two_cables(soft_rom(order=8, contact=contact))
    one, other = both(pulled(rom, "air", "cable"))

    def in_numpy(u, obstacles, parts):
        raise AssertionError

    monkeypatch.setattr(one.integrator.kernel, "_in_parts", in_numpy)
    slack, touched = [0, 0, 0], 0
    for k, u in enumerate(history(1, one)):
        u[-2:] = 2e-5 * k, 2e-5 * k + 2e-4 * np.sin(k / 9)
        if contact:
            u[:3], u[-2:] = [0.0, 0.0, -1.0 * (k % 40 > 20)], [1e-5 * k, 3e-4 * np.sin(k / 9)]
            if k % 8 == 0:
                other.restore(one.save())
        for body in (one, other):
            body.step(u)
        slack[list(one.reactions.values()).count(0.0)] += 1
        touched += contact and one.contact_forces().any()
        largest = max(other.reactions.values())
        for name, force in other.reactions.items():
            assert one.reactions[name] == pytest.approx(force, rel=1e-7, abs=max(1e-9, 1e-9 * largest)), name
    assert slack[1] > 0
    assert contact or slack[0] > 0
    assert (touched > STEPS // 10) == contact
    if not contact:
        assert_alike(one, other)
    states = [np.concatenate(body.state) for body in (one, other)]
    np.testing.assert_allclose(*states, atol=1e-9 * np.abs(states[1]).max(), rtol=0)
    assert_account_closes(one)


def test_cables_that_hold_and_slack_ones_fulfil_all_conditions():
    """In Python, of random cables of which several may be let go at once, and some of them hold again."""
    rng, found, again, n, m = np.random.default_rng(0), 0, 0, 4, 6
    for _ in range(200):
        lines, targets, v = (rng.standard_normal(shape) for shape in ((n, m), n, m))
        none, z, W = np.empty((0, 3, m)), np.zeros(n), np.zeros((n, n))
        fixed = np.arange(n), np.full(n, -1), np.zeros(n + 1, int), none[:, :, 0], none, np.zeros(n), none, np.empty(0)
        pull = Pull(*fixed, np.zeros(n), targets, z, lines, lines.copy(), W, np.ones(n))
        assert find_held(pull, v)
        first, motion = z >= 0, SimpleNamespace(velocity=v.copy(), force=np.zeros(m))
        if not held_touch.pull_alone(pull, motion.velocity):
            continue
        end_pull(pull, motion.force)
        found, again = found + 1, again + ((z > 0) & ~first).any()
        longer = lines @ motion.velocity - targets
        scale = np.abs(targets).max() + np.abs(lines).max() * np.abs(motion.velocity).max()
        assert z.min() >= 0
        assert longer.min() >= -1e-11 * scale
        assert np.abs(z * longer).max() <= 1e-11 * scale * max(1.0, z.max())
        np.testing.assert_allclose(motion.force, z @ lines, rtol=0, atol=1e-13 * max(1.0, z.max()))
    assert found > 150
    assert again > 10


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


@pytest.mark.parametrize(("names", "contact"), [(["air"], False), (["air", "cable"], False), (["air", "cable"], True)])
def test_volumes_are_those_of_numpy(names, contact):
    """Of a chamber that is to swell and shrink, by itself and beside a cable."""
    rom, touched = soft_rom(order=7, contact=contact), 0
    strokes = {name: "volume" if name == "air" else "length" for name in names}
    one, other = both(replace(rom, environment=replace(rom.environment, controls=strokes)))
    t, inputs, pressures = DT * np.arange(STEPS), np.zeros((STEPS, one.inputs)), []
    inputs[:, -2], inputs[:, -1] = 2e-8 * np.sin(40 * t), 1e-3 * t if "cable" in names else 0.0
    inputs[:, 2] = -2.0 * np.sin(20 * t) if contact else 0.0
    for k, u in enumerate(inputs):
        if k % 8 == 0:
            other.restore(one.save())
        for body in (one, other):
            body.step(u)
        found, expected = ([*body.reactions.values()] for body in (one, other))
        np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-9 * max(map(abs, expected)))
        states = [np.concatenate(body.state) for body in (one, other)]
        np.testing.assert_allclose(*states, atol=1e-9 * np.abs(states[1]).max(), rtol=0)
        pressures.append(one.reactions["air"])
        touched += contact and one.contact_forces().any()
    assert min(pressures) < 0 < max(pressures)
    assert (touched > STEPS // 10) == contact
    assert_account_closes(one)
