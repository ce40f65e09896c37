"""Compiled steps of held bodies that deform largely and touch themselves: NumPy's forces, motion and account."""

import numpy as np
import pytest
from forks import CLAMPED, LONG, ROPE, cleft
from test_self_contact import LARGE, RUBS, rom_of

import fenics_rom as fr
from fenics_rom.compilation import compiled, jit, numpy_alone
from fenics_rom.mechanics.compiled.contact_law import OTHERWISE, pairs_from
from fenics_rom.runtime.compiled import held_own
from fenics_rom.runtime.steppers import compiled_held

pytestmark = [
    pytest.mark.skipif(not compiled(), reason="numba is not installed, or turned off"),
    pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning"),
]

DT, STEPS = 1e-3, 60
NEO = LARGE | {"effects.large_deformation": 'material = "neo_hookean"'}


@pytest.fixture(scope="module")
def rom(tmp_path_factory):
    return rom_of(tmp_path_factory.mktemp("large"), cleft((6, 1, 3), 1), order=8, **CLAMPED, **ROPE, **RUBS, **NEO)


def body_of(rom):
    return fr.Simulator(rom, DT, stepper="linearly-implicit")


def in_numpy(rom):
    with numpy_alone():
        return body_of(rom)


@pytest.fixture
def statuses(monkeypatch):
    """Of steps that loops are asked for, one by one."""
    seen, take = [], compiled_held.take_step

    def noting(*given):
        seen.append(take(*given))
        return seen[-1]

    monkeypatch.setattr(compiled_held, "take_step", noting)
    return seen


def assert_accounts_close(body):
    account = body.ledger
    size = max(body.energy, abs(account.supplied))
    assert abs(body.energy - account.supplied + account.dissipated + account.numerical) <= 1e-12 * size
    assert min(account.contact, account.friction) >= -1e-13 * size


@pytest.mark.parametrize(
    ("large", "contact", "rubs"), [(NEO, "", RUBS), (LARGE, "restitution = 0.5", {})], ids=["rubs", "bounces"]
)
def test_steps_are_those_of_numpy(tmp_path, statuses, large, contact, rubs):
    law = f'self_contact = ["inside"]\n{contact}'
    rom = rom_of(tmp_path, cleft((3, 1, 3), 1), contact=law, **CLAMPED, **ROPE, **rubs, **large)
    body, other, largest, touched = body_of(rom), in_numpy(rom), 1e-3, 0
    for _ in range(STEPS):
        body.step(rope=2.0)
        other.step(rope=2.0)
        largest = max(largest, np.abs(other.contact_forces()).max())
        np.testing.assert_allclose(body.contact_forces(), other.contact_forces(), rtol=0, atol=1e-8 * largest)
        one, two = body.integrator.contact, other.integrator.contact
        assert (one is None) == (two is None)
        if one is not None:
            touched += 1
            np.testing.assert_array_equal(one.pairs, two.pairs)
            np.testing.assert_array_equal(one.opposite.nodes, two.opposite.nodes)
            np.testing.assert_allclose(one.opposite.weights, two.opposite.weights, rtol=0, atol=1e-7)
    assert touched >= 20
    assert len(statuses) == STEPS
    assert OTHERWISE not in [step.status for step in statuses]
    np.testing.assert_allclose(body.displacement(), other.displacement(), rtol=0, atol=1e-9 * LONG)
    for name in ("supplied", "dissipated", "contact", "friction"):
        one, two = getattr(body.ledger, name), getattr(other.ledger, name)
        assert abs(one - two) <= 1e-8 * body.ledger.supplied
    assert_accounts_close(body)


def test_rollouts_are_steps_to_the_bit(rom):
    stepped, rolled = body_of(rom), body_of(rom)
    u = np.zeros((STEPS, stepped.inputs))
    u[:, -1] = 2.0
    for each in u:
        stepped.step(each)
    rolled.rollout(u[:45])
    for each in u[45:]:
        rolled.step(each)
    np.testing.assert_array_equal(rolled.displacement(), stepped.displacement())
    np.testing.assert_array_equal(rolled.contact_forces(), stepped.contact_forces())
    np.testing.assert_array_equal(
        rolled.integrator.contact.opposite.weights, stepped.integrator.contact.opposite.weights
    )
    assert stepped.integrator.contact is not None
    assert_accounts_close(rolled)


def test_numpy_takes_steps_in_which_points_would_go_through_themselves(rom, statuses):
    body, other = body_of(rom), in_numpy(rom)
    for step in range(30):
        force = min(60.0, 6.0 * step)
        body.step(rope=force)
        other.step(rope=force)
    assert OTHERWISE in [step.status for step in statuses]
    np.testing.assert_allclose(body.displacement(), other.displacement(), rtol=0, atol=1e-7 * LONG)
    assert_accounts_close(body)


def test_pairs_that_forces_bring_in_are_chosen():
    """Pairs of two points each, which approach one another as fast as forces on others let them."""
    rng, C, P = np.random.default_rng(1), 12, 7
    pairs = pairs_from(np.zeros((C, 3)), 0.4)
    pairs.axes[:] = np.linalg.qr(rng.standard_normal((C, 3, 3)))[0]
    pairs.free[:], pairs.level[:] = rng.standard_normal((C, 3)), -0.5
    nodes, maps, moved = rng.integers(0, P, (C, 4)), rng.standard_normal((C, 4, 3, 3)), rng.standard_normal((P, 3))
    pairs.chosen[:] = begun = pairs.free[:, 0] < pairs.level
    outwards = pairs.free[:, 0] + np.einsum("ci,ckij,ckj->c", pairs.axes[:, 0], maps, moved[nodes])
    choose = jit(held_own.choose_missed)
    assert choose(pairs, nodes, maps, moved.ravel())
    np.testing.assert_array_equal(pairs.chosen, begun | (outwards < pairs.level))
    assert 0 < (pairs.chosen & ~begun).sum() < (~begun).sum()
    assert not choose(pairs, nodes, maps, moved.ravel())


def test_gradients_are_those_of_numpy(rom):
    def gradient(body):
        u = np.zeros((35, body.inputs))
        u[:, -1] = 2.0
        for each in u[:20]:
            body.step(each)
        return fr.differentiate(body, u[20:], lambda _, energies: (energies.sum(), {}, np.ones(len(energies)))).inputs

    one, two = gradient(body_of(rom)), gradient(in_numpy(rom))
    np.testing.assert_allclose(one, two, rtol=0, atol=1e-7 * np.abs(two).max())


def test_bodies_of_a_batch_are_single_ones(rom):
    bodies, single = fr.Batch(rom, size=2, dt=DT), fr.Simulator(rom, DT)
    for _ in range(20):
        u = np.zeros((2, single.inputs))
        u[:, -1] = 2.0, 0.5
        bodies.step(u)
        single.step(u[0])
    assert bodies.stepping.startswith("one after another")
    assert bodies.energy[0] == single.energy
