"""What a caller of the simulator sees."""

import copy
import math
import pickle
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from test_energy_laws import random_rom

import fenics_rom as fr
from fenics_rom.errors import StepError
from fenics_rom.mechanics.energy_ledger import EnergyLedger
from fenics_rom.runtime.steppers.midpoint import LARGEST_FUSED_ORDER


def pushed(rom, **choice):
    simulator = fr.Simulator(rom, dt=1e-3, **choice)
    for _ in range(50):
        simulator.step([0.0, 0.0, 0.5])
    return simulator


def test_starts_at_rest_in_the_first_contact_mode(plate_rom):
    simulator = fr.Simulator(plate_rom, dt=1e-3)
    assert (simulator.contact, simulator.time, simulator.energy) == ("tip_left", 0.0, 0.0)
    assert not simulator.displacement().any()


def test_static_force_ends_in_static_equilibrium(plate_system, plate_rom):
    """Against a full-order solve of K x = B u."""
    simulator = fr.Simulator(plate_rom, dt=0.02)
    for _ in range(5000):
        simulator.step([0.0, 0.0, 0.5])
    factor = plate_system.algebra.factor((1.0, plate_system.stiffness))
    x = factor.solve(plate_system.contacts["tip_left"] @ [[0.0], [0.0], [0.5]])
    exact = np.zeros(3 * len(plate_rom.nodes))
    exact[plate_rom.free] = x[:, 0]
    assert np.abs(simulator.displacement().ravel() - exact).max() <= 1e-4 * np.abs(exact).max()


def test_named_output_is_the_shape_at_its_nodes(plate_rom):
    simulator = pushed(plate_rom)
    corners = [np.linalg.norm(plate_rom.nodes - p, axis=1).argmin() for p in ([0.5, 0.2, 0.01], [0.5, 0, 0.01])]
    for read in (simulator.displacement, simulator.velocity):
        assert read("tip").shape == (2, 3)
        np.testing.assert_allclose(read("tip"), read()[corners], rtol=1e-9, atol=1e-15)


def test_velocity_is_the_rate_of_displacement(plate_rom):
    simulator = pushed(plate_rom)
    simulator.dt = 1e-6
    before, slow = simulator.displacement(), simulator.velocity()
    simulator.step([0.0, 0.0, 0.5])
    mean = (slow + simulator.velocity()) / 2
    np.testing.assert_allclose((simulator.displacement() - before) / 1e-6, mean, atol=1e-6 * np.abs(mean).max())


@pytest.mark.parametrize(
    "u",
    [
        "abc",
        [0, "a", 0],
        [0, 0, 1j],
        [[0], [1, 2], 3],
        None,
        [0.0, 0.0],
        [0.0] * 4,
        [[0.0, 0.0, 1.0]],
        [0.0, np.nan, 0.0],
        [np.inf, 0.0, 0.0],
        [1e308, 1e308, 1e308],
    ],
)
def test_bad_input_leaves_the_state_as_it_was(plate_rom, u):
    simulator = pushed(plate_rom)
    before = (*simulator.state, simulator.energy, simulator.time, simulator.ledger.sums)
    with pytest.raises(StepError):
        simulator.step(u)
    after = (*simulator.state, simulator.energy, simulator.time, simulator.ledger.sums)
    for old, new in zip(before, after, strict=True):
        np.testing.assert_equal(new, old)


@pytest.mark.parametrize("dimensions", [1, 2])
@pytest.mark.parametrize("newton", [np.nan, np.inf, 1e308])
def test_bad_input_of_a_large_model_leaves_the_state_as_it_was(dimensions, newton):
    m = LARGEST_FUSED_ORDER[dimensions] + 1
    rom = random_rom(np.random.default_rng(0), m, [m], 4, dense=dimensions == 2)
    simulator = fr.Simulator(rom, dt=1e-3)
    simulator.step([1.0, 1.0])
    before = everything(simulator)
    with pytest.raises(StepError, match=r"step 1: .* step overflows"):
        simulator.step([newton, newton])
    assert everything(simulator) == before


@pytest.mark.parametrize("dt", [0.0, -1e-3, np.nan, np.inf, "1", None])
def test_bad_step_size_is_refused(plate_rom, dt):
    with pytest.raises(StepError, match="use a finite number > 0"):
        fr.Simulator(plate_rom, dt=dt)


def test_unknown_names_are_refused_with_a_hint(plate_rom):
    simulator = fr.Simulator(plate_rom, dt=1e-3)
    with pytest.raises(StepError, match="did you mean 'tip_left'"):
        simulator.switch("tip_lft")
    with pytest.raises(StepError, match="no output 'tup'; there is tip"):
        simulator.displacement("tup")
    with pytest.raises(StepError, match="shape"):
        simulator.state = [0.0], [0.0]


def test_switch_to_the_active_mode_changes_no_bit(plate_rom):
    simulator = pushed(plate_rom)
    before = simulator.state
    simulator.switch("tip_left")
    np.testing.assert_array_equal(simulator.state, before)


def test_ledger_off_changes_no_bit_of_the_motion(plate_rom):
    with_ledger, without = pushed(plate_rom), pushed(plate_rom, ledger=False)
    np.testing.assert_array_equal(with_ledger.state, without.state)
    assert without.ledger is None


def test_a_rom_is_only_read(plate_rom):
    """Two simulators of one ROM do not meet."""
    alone = pushed(plate_rom).state
    other = fr.Simulator(plate_rom, dt=1e-3)
    other.switch("middle")
    other.step([1.0, 1.0, 1.0])
    np.testing.assert_array_equal(pushed(plate_rom).state, alone)


def test_run_of_the_scene_is_stepping_by_hand(plate_rom):
    run = fr.simulate(plate_rom)
    simulator = pushed(plate_rom)
    assert run.steps == 3000
    np.testing.assert_allclose(run.outputs["tip"][50], simulator.displacement("tip"), rtol=1e-12)
    assert run.energy[50] == pytest.approx(simulator.energy, rel=1e-13)  # squares summed in another order
    assert run.balance_error <= 5e-12  # 3,000 steps, each eps or so, of one sign
    assert run.snapshot_times[-1] == run.times[-1] == pytest.approx(3.0)


def restless(rom, steps=100, seed=0, **choice):
    """A simulator that has seen switches, step sizes and forces."""
    random = np.random.default_rng(seed)
    simulator = fr.Simulator(rom, dt=1e-3, **choice)
    for _ in range(steps):
        simulator.switch(("tip_left", "middle")[random.integers(2)])
        simulator.dt = 10 ** random.uniform(-4, -2)
        simulator.step(random.standard_normal(simulator.inputs))
    return simulator


def everything(simulator):
    snapshot = simulator.save()
    return (
        snapshot.contact,
        snapshot.dt,
        simulator.steps,
        simulator.time,
        snapshot.stepper.state.tobytes(),
        snapshot.sums,
    )


@pytest.mark.parametrize("ledger", [True, False])
def test_saved_states_come_back_to_the_bit(plate_rom, ledger):
    simulator = restless(plate_rom, ledger=ledger)
    snapshot, before = pickle.loads(pickle.dumps(simulator.save())), everything(simulator)
    random = np.random.default_rng(1)
    pushes = random.standard_normal((50, 3))

    def go_on(simulator):
        for k, u in enumerate(pushes):
            simulator.switch(("tip_left", "middle")[k // 7 % 2])
            simulator.step(u)
        return everything(simulator)

    after = go_on(simulator)
    simulator.restore(snapshot)
    assert everything(simulator) == before
    assert go_on(simulator) == after
    fresh = fr.Simulator(plate_rom, dt=1.0, ledger=ledger)
    fresh.restore(snapshot)
    assert go_on(fresh) == after


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, lambda s: pickle.loads(pickle.dumps(s))])
def test_a_copy_goes_its_own_way(plate_rom, copied):
    simulator = restless(plate_rom)
    twin = copied(simulator)
    assert everything(twin) == everything(simulator)
    before = everything(simulator)
    twin.step([1.0, 0.0, 0.0])
    assert everything(simulator) == before
    simulator.step([1.0, 0.0, 0.0])
    assert everything(twin) == everything(simulator)


def simulator_arrays(rom):
    return fr.Simulator(rom, dt=1e-3).state


def test_snapshots_of_others_are_refused(plate_system, plate_rom):
    snapshot = restless(plate_rom).save()
    with pytest.raises(ValueError, match="read-only"):
        snapshot.stepper.state[0] = 1.0
    other = fr.Simulator(fr.truncate(plate_rom, 5), dt=1e-3)
    with pytest.raises(StepError, match="of another ROM"):
        other.restore(snapshot)
    with pytest.raises(StepError, match="energy account"):
        fr.Simulator(plate_rom, dt=1e-3, ledger=False).restore(snapshot)
    models = plate_rom.contact_models
    stiffer = {name: replace(model, eigenvalues=1.1 * model.eigenvalues) for name, model in models.items()}
    pushed = {name: replace(model, inputs=-model.inputs) for name, model in models.items()}
    for changed in (stiffer, pushed):  # of the same size
        alike = fr.Simulator(replace(plate_rom, name="alike", contact_models=changed), dt=1e-3)
        before = everything(alike)
        with pytest.raises(StepError, match="is of another ROM, 'plate', than this simulator's, 'alike'"):
            alike.restore(snapshot)
        assert everything(alike) == before
    for wrong in (None, {}, simulator_arrays(plate_rom)):
        with pytest.raises(StepError, match=r"restore: .* was given; use what save\(\) gave"):
            fr.Simulator(plate_rom, dt=1e-3).restore(wrong)


def test_reset_is_a_new_simulator(plate_rom):
    simulator = restless(plate_rom)
    account = simulator.ledger
    simulator.dt = 1e-3
    simulator.reset()
    assert simulator.ledger is account  # who watches it goes on seeing the run's
    fresh = fr.Simulator(plate_rom, dt=1e-3)
    assert everything(simulator) == everything(fresh)
    for body in (simulator, fresh):
        body.step([0.1, 0.2, 0.3])
    assert everything(simulator) == everything(fresh)


@pytest.mark.parametrize("ledger", [True, False])
def test_stepping_leaves_nothing_behind(plate_rom, ledger):
    simulator, u = restless(plate_rom, ledger=ledger), np.array([0.1, 0.2, 0.3])

    def go(steps):
        for step in range(steps):
            if step % 100 == 0:
                simulator.switch(("tip_left", "middle")[step // 100 % 2])
            simulator.step(u)

    simulator.dt = 1e-3
    go(400)
    tracemalloc.start()
    try:
        go(400)
        before, _ = tracemalloc.get_traced_memory()
        go(10_000)
        after, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert after - before < 2000  # a few numbers of Python's own; a single state is 320


def test_a_million_small_works_add_up():
    """Kahan's sums: a plain one is off by some 1e-11 here."""
    ledger = EnergyLedger()
    for _ in range(1_000_000):
        ledger.book(supplied=0.1, dissipated=0.3)
    assert ledger.supplied == pytest.approx(math.fsum([0.1] * 1_000_000), rel=1e-15)
    assert ledger.dissipated == pytest.approx(math.fsum([0.3] * 1_000_000), rel=1e-15)


def test_time_does_not_drift(plate_rom):
    simulator = fr.Simulator(plate_rom, dt=1e-3, ledger=False)
    for _ in range(100_000):
        simulator.step([0.0, 0.0, 0.0])
    simulator.dt = 0.5
    simulator.step([0.0, 0.0, 0.0])
    assert simulator.time == 100.5


@pytest.mark.parametrize(("asked", "runs"), [({}, 1), ({"rate": True}, 2), ({"profile": True}, 2)])
def test_a_run_is_taken_once_and_once_more_for_what_is_measured(plate_rom, monkeypatch, asked, runs):
    steps = []
    step = fr.Simulator.step
    monkeypatch.setattr(fr.Simulator, "step", lambda body, u=(): (steps.append(body), step(body, u)))
    run = fr.simulate(plate_rom, dt=0.01, **asked)
    assert len(steps) == runs * (len(run.times) - 1)
    assert ("seconds" in run.settings) == ("rate" in asked)
