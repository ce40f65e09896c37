"""A rollout is stepping: the same trajectory, account and switches, to round-off."""

import copy
import gc
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_energy_laws import random_rom

import fenics_rom as fr
from fenics_rom.errors import StepError
from fenics_rom.runtime.rollout import MAX_BLOCK_STEPS, find_constant_intervals

ROUND_OFF = 1e-12


def stepped(simulator, inputs, contact, dt, every):
    """The same by hand: displacement of the output "tip" after every so many steps."""
    read = []
    for k, u in enumerate(inputs):
        simulator.switch(contact[k])
        simulator.dt = dt[k]
        simulator.step(u)
        if (k + 1) % every == 0:
            read.append(simulator.displacement("tip"))
    return np.array(read)


def assert_same(one, other):
    """Two simulators, to round-off of their states."""
    assert (one.contact, one.dt, one.steps) == (other.contact, other.dt, other.steps)
    assert one.time == pytest.approx(other.time, rel=1e-14)
    energy = max(one.energy, one.ledger.supplied)
    for (a, _), (b, _) in zip(one.ledger.sums, other.ledger.sums, strict=True):
        assert a == pytest.approx(b, abs=ROUND_OFF * energy)
    ω = np.sqrt(one.rom.contact_models[one.contact].eigenvalues)
    (q, r), (q2, r2) = one.state, other.state
    assert np.linalg.norm([ω * (q - q2), r - r2]) <= ROUND_OFF * np.sqrt(2 * energy)


@pytest.mark.parametrize("every", [1, 2, 7, 64, 65, 150])
def test_rollout_is_stepping_through_switches_and_step_sizes(plate_rom, every):
    steps = 203
    inputs = np.random.default_rng(every).standard_normal((steps, 3))
    contact = [("tip_left", "middle")[k // 50 % 2] for k in range(steps)]
    dt = [(1e-3, 2e-3, 5e-4)[k // 71 % 3] for k in range(steps)]
    hand, rollout = fr.Simulator(plate_rom, dt=1e-3), fr.Simulator(plate_rom, dt=1e-3)
    read = stepped(hand, inputs, contact, dt, every)
    tip = rollout.rollout(inputs, contact=contact, dt=dt, every=every)["tip"]
    assert tip.shape == (steps // every, 2, 3)
    np.testing.assert_allclose(tip, read, atol=1e-11 * np.abs(read).max(), rtol=0)
    assert_same(hand, rollout)


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    dense=st.booleans(),
    pieces=st.lists(
        st.tuples(st.integers(0, 1), st.floats(-6, -1), st.integers(0, 2 * MAX_BLOCK_STEPS + 3), st.integers(1, 9)),
        max_size=5,
    ),
)
def test_account_closes_and_a_rollout_is_stepping_for_any_rom(seed, dense, pieces):
    random = np.random.default_rng(seed)
    rom = random_rom(random, 12, random.integers(1, 13, 2), 5, dense)
    rollout = fr.Simulator(rom, dt=1e-3)
    rollout.state = random.standard_normal((2, rom.contact_models["mode0"].order))
    hand, start = copy.copy(rollout), rollout.energy
    for mode, decade, steps, every in pieces:
        inputs, contact, dt = random.standard_normal((steps, 2)), f"mode{mode}", 10**decade
        rollout.rollout(inputs, contact=contact, dt=dt, every=every)
        for u in inputs:
            hand.dt = dt
            hand.switch(contact)
            hand.step(u)
        account = rollout.ledger
        gap = rollout.energy - start - account.supplied + account.dissipated + account.lost_in_switching
        scale = max(start, rollout.energy, abs(account.supplied), account.dissipated)
        assert abs(gap) <= ROUND_OFF * scale
        assert account.dissipated >= -ROUND_OFF * scale
        if steps:
            ω = np.sqrt(rom.contact_models[contact].eigenvalues)
            gaps = [a - b for a, b in zip(rollout.state, hand.state, strict=True)]
            assert np.linalg.norm([ω * gaps[0], gaps[1]]) <= ROUND_OFF * np.sqrt(2 * scale)
            assert rollout.time == pytest.approx(hand.time, rel=1e-13)


def test_rollout_without_ledger_or_outputs(plate_rom):
    inputs = np.random.default_rng(0).standard_normal((300, 3))
    one, other = fr.Simulator(plate_rom, dt=1e-3), fr.Simulator(plate_rom, dt=1e-3, ledger=False)
    one.rollout(inputs)
    assert other.rollout(inputs, outputs=[]) == {}
    assert other.ledger is None
    assert fr.Simulator(plate_rom, dt=1e-3).rollout(inputs, every=2 * MAX_BLOCK_STEPS, outputs=[]) == {}
    np.testing.assert_allclose(one.state, other.state, rtol=1e-9, atol=1e-13)
    assert one.rollout(np.empty((0, 3)))["tip"].shape == (0, 2, 3)
    assert one.steps == 300


def test_bad_rollouts_leave_everything_as_it_was(plate_rom):
    simulator = fr.Simulator(plate_rom, dt=1e-3)
    good = np.random.default_rng(0).standard_normal((200, 3))
    simulator.rollout(good)
    before, nan, huge = simulator.save(), good.copy(), good.copy()
    nan[120, 1], huge[150:] = np.nan, 1e308
    for message, inputs, choice in (
        ("step 320: input .* is not finite", nan, {}),
        ("steps overflow", huge, {"contact": ["tip_left"] * 100 + ["middle"] * 100}),
        ("use \\(steps, 3\\) numbers in N", good[:, :2], {}),
        ("use \\(steps, 3\\) numbers in N", good[0], {}),
        ("no contact mode 'tup'", good, {"contact": "tup"}),
        ("no contact mode 'tup'", good, {"contact": ["middle"] * 199 + ["tup"]}),
        ("contact: use one for all 200 steps, or one for each", good, {"contact": ["middle"] * 3}),
        ("dt = -1.0: use a finite number > 0", good, {"dt": [1e-3] * 100 + [-1.0] * 100}),
        ("dt: use one for all 200 steps, or one for each", good, {"dt": [1e-3, 2e-3]}),
        ("no output 'tup'", good, {"outputs": ["tup"]}),
        ("every = 0", good, {"every": 0}),
        ("every = 2.5", good, {"every": 2.5}),
    ):
        with pytest.raises(StepError, match=message):
            simulator.rollout(inputs, **choice)
        after = simulator.save()
        np.testing.assert_array_equal(after.stepper.state, before.stepper.state)
        assert (after.contact, after.dt, after.steps, after.sums) == (
            before.contact, before.dt, before.steps, before.sums,
        )  # fmt: skip


def test_contact_modes_of_different_widths_are_refused_together(box_system):
    rom = fr.reduce(box_system, order=5)
    simulator = fr.Simulator(rom, dt=1e-3)
    wide, narrow = np.zeros((10, simulator.inputs)), np.zeros((10, simulator.inputs - 1))
    simulator.rollout(wide)
    with pytest.raises(StepError, match="step 10: inputs of contact mode"):
        simulator.rollout(narrow)


def test_spans_are_the_steps_between_changes():
    assert find_constant_intervals(0, "a", 1.0) == []
    assert find_constant_intervals(4, "a", 1.0) == [(0, 4, "a", 1.0)]
    changing = find_constant_intervals(4, ["a", "a", "b", "b"], [1.0, 2.0, 2.0, 2.0])
    assert changing == [(0, 1, "a", 1.0), (1, 2, "a", 2.0), (2, 4, "b", 2.0)]


def test_step_sizes_that_never_come_back_do_not_pile_up(plate_rom):
    simulator = fr.Simulator(plate_rom, dt=1e-3)
    for k in range(100):
        simulator.rollout(np.zeros((2, 3)), dt=1e-3 + 1e-6 * k)
    assert len(simulator._rollout._propagators) <= 32


def test_rollouts_leave_no_more_behind_the_more_of_them_there_are(plate_rom):
    """Not so much as a name that Python keeps of each call: these came to 30 kB after some hundred rollouts."""
    body, inputs, held = fr.Simulator(plate_rom, 1e-3), np.zeros((8, 3)), []
    tracemalloc.start()
    try:
        for _ in range(2):
            for _ in range(200):
                body.rollout(inputs)
            gc.collect()
            held.append(tracemalloc.get_traced_memory()[0])
    finally:
        tracemalloc.stop()
    assert held[1] - held[0] < 2048
