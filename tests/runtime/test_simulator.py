"""What a caller of the simulator sees."""

import numpy as np
import pytest

import fenics_rom as fr
from fenics_rom.errors import StepError


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
    "u", [[0.0, 0.0], [0.0] * 4, [[0.0, 0.0, 1.0]], [0.0, np.nan, 0.0], [np.inf, 0.0, 0.0], [1e308, 1e308, 1e308]]
)
def test_bad_input_leaves_the_state_as_it_was(plate_rom, u):
    simulator = pushed(plate_rom)
    before = (*simulator.state, simulator.energy, simulator.time, vars(simulator.ledger).copy())
    with pytest.raises(StepError):
        simulator.step(u)
    after = (*simulator.state, simulator.energy, simulator.time, vars(simulator.ledger).copy())
    for old, new in zip(before, after, strict=True):
        np.testing.assert_equal(new, old)


@pytest.mark.parametrize("dt", [0.0, -1e-3, np.nan, np.inf, "1", None])
def test_bad_step_size_is_refused(plate_rom, dt):
    with pytest.raises(StepError, match="allowed is a finite number > 0"):
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
    assert run.energy[50] == simulator.energy
    assert run.balance_error <= 1e-12
    assert run.shape_times[-1] == run.times[-1] == pytest.approx(3.0)
