"""Compiled steps of held bodies that deform largely: NumPy's motion and account, whatever is done in between."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from soft_rom import soft_rom

import fenics_rom as fr
from fenics_rom.compilation import compiled, jit, numpy_alone
from fenics_rom.errors import StepError
from fenics_rom.mechanics.viscoelasticity import PronySeries
from fenics_rom.runtime.compiled import strain_tables

pytestmark = pytest.mark.skipif(not compiled(), reason="numba is not installed, or turned off")

STEPS, DT = 100, 2e-3
LAWS = "st_venant_kirchhoff", "neo_hookean"


def both(rom, dt=DT, stepper="linearly-implicit"):
    """A compiled body, and one of NumPy."""
    body = fr.Simulator(rom, dt, stepper=stepper)
    assert body.integrator.kernel._compiled is not None
    with numpy_alone():
        return body, fr.Simulator(rom, dt, stepper=stepper)


def history(seed, width, size=1.0):
    """Pushes, a pressure and a tension that change every few steps: (STEPS, width)."""
    rng = np.random.default_rng(seed)
    scales = np.array([*[0.2] * (width - 2), 2000.0, 2.0])
    forces = rng.standard_normal((-(-STEPS // 7), width)) * scales * (rng.random((-(-STEPS // 7), width)) < 0.7)
    forces[:, -2:] = np.abs(forces[:, -2:])
    return size * np.repeat(forces, 7, axis=0)[:STEPS]


def random_rom(law, seed):
    """Some body of a few shapes."""
    rng = np.random.default_rng(seed)
    rom = soft_rom(law, order=int(rng.integers(5, 15)), alpha=rng.uniform(0, 2), beta=rng.uniform(1e-3, 4e-3))
    A = rng.standard_normal((rom.deformation.order, 2))
    return replace(rom, deformation=replace(rom.deformation, springs=1e3 * (seed % 2) * A @ A.T))


def assert_account_closes(body):
    account = body.ledger
    left = body.energy - account.supplied + account.dissipated + account.lost_in_switching
    assert abs(left) <= 1e-12 * max(body.energy, abs(account.supplied), account.dissipated)


def close(one, other, share=1e-10):
    np.testing.assert_allclose(one, other, atol=share * np.abs(other).max(), rtol=0)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
def test_motion_and_account_are_those_of_numpy(law, seed):
    """Of random orders and dampings, every other body on springs."""
    one, other = both(random_rom(law, seed))
    for k, u in enumerate(history(seed, one.inputs, 10 ** np.random.default_rng(seed).uniform(-1, 0.3))):
        for body in (one, other):
            if k == 60:
                body.switch("middle")
            body.step(u)
    close(np.concatenate(one.state), np.concatenate(other.state))
    close(*(np.array([total for total, _ in body.ledger.sums]) for body in (one, other)))
    for body in (one, other):
        assert_account_closes(body)
    notes = one.integrator.kernel.notes, other.integrator.kernel.notes
    assert notes[0].keys() == notes[1].keys()
    for name, value in notes[0].items():
        assert value == pytest.approx(notes[1][name], rel=1e-9, abs=1e-12), name


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("seed", range(2))
@pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
def test_under_loads_far_beyond_training_each_step_is_numpys(law, seed):
    """Strains go off those of the shape there, and the least difference grows soon: so both go on from one state."""
    one, other = both(random_rom(law, seed))
    most = 0
    for k, u in enumerate(history(seed, one.inputs, 20.0)):
        if k % 2 == 0:
            other.restore(one.save())
        for body in (one, other):
            body.step(u)
        close(np.concatenate(one.state), np.concatenate(other.state), share=1e-8)
        most = max(most, len(one.integrator.kernel.elastic.carried.strained))
    assert most or law != LAWS[0], "strains went with the shape"
    assert_account_closes(one)


@pytest.mark.parametrize("law", LAWS)
def test_a_restored_state_goes_on_to_the_bit(law):
    rom = soft_rom(law, order=8)
    body, other = fr.Simulator(rom, DT, stepper="linearly-implicit"), fr.Simulator(rom, DT, stepper="linearly-implicit")
    forces = history(3, body.inputs)
    for u in forces[:50]:
        body.step(u)
    other.restore(pickle.loads(pickle.dumps(body.save())))
    for u in forces[50:]:
        body.step(u)
        other.step(u)
    np.testing.assert_array_equal(np.concatenate(body.state), np.concatenate(other.state))
    assert body.ledger.sums == other.ledger.sums


def test_numpy_and_loops_take_turns():
    """Steps that are taken back, and those that NumPy takes, hand on what loops need, and the other way round."""
    rom = soft_rom(order=8)
    one, other = both(rom)
    loops = one.integrator.kernel._compiled
    for k, u in enumerate(history(5, one.inputs)):
        one.integrator.kernel._compiled = loops if k % 3 else None
        for body in (one, other):
            if k % 5 == 0:
                body.step(10 * u)
                body.integrator.rollback()
            body.step(u)
    close(np.concatenate(one.state), np.concatenate(other.state))
    assert_account_closes(one)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
def test_a_material_that_relaxes_moves_as_in_numpy(law):
    """By branches slower and faster than a step; also what they carry along, and after steps that are taken back."""
    rom = random_rom(law, 1)
    rom = replace(rom, environment=replace(rom.environment, viscoelasticity=PronySeries((0.5, 0.3), (0.03, 2e-4))))
    one, other = both(rom)
    for k, u in enumerate(history(7, one.inputs)):
        for body in (one, other):
            if k % 9 == 4:
                body.step(5 * u)
                body.integrator.rollback()
            body.step(u)
    for a, b in zip(told(one), told(other), strict=True):
        close(a, b)
    assert_account_closes(one)
    assert one.integrator.kernel.branches.state.any()
    rolled = fr.Simulator(rom, DT, stepper="linearly-implicit")
    rolled.rollout(history(7, one.inputs)[:20])
    again = fr.Simulator(rom, DT, stepper="linearly-implicit")
    for u in history(7, one.inputs)[:20]:
        again.step(u)
    for a, b in zip(told(rolled)[:2], told(again)[:2], strict=True):
        np.testing.assert_array_equal(a, b)


def told(body):
    """State, what is carried along beside it, and energies."""
    sums = [body.energy, body.ledger.supplied, body.ledger.dissipated]
    return np.concatenate(body.state), body.integrator.kernel.auxiliary, np.array(sums)


def test_a_step_that_overflows_is_refused_and_changes_nothing():
    body = fr.Simulator(soft_rom(order=5), DT, stepper="linearly-implicit")
    body.step(np.ones(body.inputs) * 1e-2)
    before = np.concatenate(body.state)
    with pytest.raises(StepError):
        body.step(np.full(body.inputs, 1e300))
    np.testing.assert_array_equal(np.concatenate(body.state), before)
    body.step(np.ones(body.inputs) * 1e-2)
    assert_account_closes(body)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
def test_rollouts_are_steps_to_the_bit(law):
    """Also where strains go off those of the shape, with a switch, and steps of another length."""
    body, rolled = (fr.Simulator(random_rom(law, 1), DT, stepper="linearly-implicit") for _ in range(2))
    forces, read = history(9, body.inputs, 4.0), []
    for k, u in enumerate(forces):
        if k == 40:
            body.switch("middle")
        if k == 70:
            body.dt = DT / 2
        body.step(u)
        read.append(body.displacement("tip"))
    modes, sizes = np.repeat(["tip", "middle"], [40, STEPS - 40]), np.repeat([DT, DT / 2], [70, STEPS - 70])
    tip = rolled.rollout(forces, contact=modes, dt=sizes)["tip"]
    np.testing.assert_allclose(tip, read, atol=1e-12 * np.abs(read).max(), rtol=0)
    np.testing.assert_array_equal(np.concatenate(body.state), np.concatenate(rolled.state))
    assert rolled.integrator.kernel.notes == pytest.approx(body.integrator.kernel.notes, rel=1e-12)
    assert_account_closes(rolled)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
def test_what_is_noted_of_a_run_is_that_of_numpy(law):
    """Loads, strains and distances beyond training; and what a step that is taken back had noted is not."""
    one, other = both(random_rom(law, 0))
    for k, u in enumerate(history(3, one.inputs, 3.0)):
        for body in (one, other):
            body.step(u)
            if k == 50:
                before = dict(body.integrator.kernel.notes)
                body.step(30 * u)
                body.integrator.rollback()
                assert body.integrator.kernel.notes == before
    notes, expected = (body.integrator.kernel.notes for body in (one, other))
    assert notes.keys() == expected.keys()
    for name, value in expected.items():
        assert abs(notes[name] - value) <= 1e-8 * abs(value) + 1e-12, name
    assert one.warnings == other.warnings


def test_a_folded_table_times_vectors_is_the_symmetric_matrix_times_them():
    """To the round-off of sums in any order, ten times; for one vector and for two, also as Python takes it."""
    random = np.random.default_rng(0)
    for n in (1, 8, 29, 66):
        half = random.standard_normal((n, n))
        matrix = half + half.T
        table, N = strain_tables.folded(matrix), strain_tables.padded(n)
        x, found = np.zeros((2, N)), np.empty((2, N))
        x[:, :n] = random.standard_normal((2, n))
        bound = 10 * n * np.finfo(float).eps * np.abs(x).max() * np.abs(matrix).sum(axis=0).max()
        jit(strain_tables.read)(table, x, found)
        np.testing.assert_allclose(found[:, :n], x[:, :n] @ matrix, atol=bound, rtol=0)
        jit(strain_tables.read)(table, x[0], found[0])
        np.testing.assert_allclose(found[0, :n], x[0, :n] @ matrix, atol=bound, rtol=0)
        strain_tables.read(table, x, found)
        np.testing.assert_allclose(found[:, :n], x[:, :n] @ matrix, atol=bound, rtol=0)
