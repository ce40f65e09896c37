"""Stepping in step with the wall clock. No test asks a loaded machine to be fast."""

import dataclasses
import math
import time

import numpy as np
import pytest

import fenics_rom as fr
from fenics_rom.errors import StepError
from fenics_rom.runtime import realtime
from fenics_rom.runtime.realtime import RealTime, run_realtime

PUSH = [0.0, 0.0, 0.5]
pytestmark = pytest.mark.alone


@pytest.fixture
def body(plate_rom):
    return fr.Simulator(plate_rom, dt=1e-3)


def alternating(body):
    """A push that changes its contact every 7 steps."""
    body.switch(("tip_left", "middle")[round(body.time / body.dt) // 7 % 2])
    return PUSH


def test_motion_is_that_of_plain_stepping_bit_for_bit(plate_rom, body):
    plain = fr.Simulator(plate_rom, dt=1e-3)
    for _ in range(50):
        plain.step(alternating(plain))
    run = run_realtime(body, alternating, 0.05)
    assert run.steps == 50
    assert body.time == plain.time == pytest.approx(run.simulated)
    assert body.energy == plain.energy
    assert body.ledger.sums == plain.ledger.sums
    np.testing.assert_array_equal(body.displacement(), plain.displacement())


def test_no_step_runs_ahead_of_the_wall_clock(body):
    start, early = time.perf_counter(), []

    def control(body):
        early.append(body.time - (time.perf_counter() - start))
        return PUSH

    run = run_realtime(body, control, 0.05)
    assert len(early) == 50
    assert max(early) <= 1e-12  # round-off of the clock's own number
    assert run.seconds >= 0.05 - 1e-12


@pytest.mark.parametrize(("duration", "steps"), [(0.03, 30), (0.0304, 30), (0.0306, 31), (1e-9, 0)])
def test_duration_is_kept_to_the_nearest_step(body, duration, steps):
    run = run_realtime(body, lambda body: PUSH, duration)
    assert run.steps == steps
    assert (run.simulated, body.time) == pytest.approx((steps * 1e-3, steps * 1e-3))


def test_a_slow_step_is_missed(body):
    def control(body):
        if abs(body.time - 0.01) < 1e-6:
            time.sleep(5e-3)
        return PUSH

    run = run_realtime(body, control, 0.05)
    assert run.steps == 50
    assert run.missed >= 4  # the slow step, and those that were due meanwhile
    assert run.worst >= 5e-3
    assert run.lateness >= 4e-3
    assert run.seconds >= 0.05 - 1e-12


class Clock:
    """Stands in for the time module: passes by being read, a little, and by sleeping."""

    now = 100.0

    def perf_counter(self):
        self.now += 1e-7
        return self.now

    def sleep(self, seconds):
        assert seconds > 0
        self.now += seconds


def test_after_a_slow_step_the_wall_clock_is_caught_up_with(body, monkeypatch):
    clock, begun = Clock(), []
    monkeypatch.setattr(realtime, "time", clock)

    def control(body):
        begun.append(clock.now - 100)
        clock.now += 5e-3 if len(begun) == 11 else 1e-4
        return PUSH

    run = run_realtime(body, control, 0.02)
    expected = [*range(11), 15, 15.1, 15.2, 15.3, 15.4, *range(16, 20)]  # ms
    np.testing.assert_allclose(np.array(begun) * 1e3, expected, atol=0.01)
    assert (run.steps, run.missed) == (20, 5)
    measured = (run.median, run.worst, run.lateness, run.simulated, run.seconds)
    assert measured == pytest.approx((1e-4, 5e-3, 4e-3, 0.02, 0.02), abs=1e-5)
    assert run.median < run.p999 < run.worst


def test_step_times_are_in_order_and_misses_are_late(body):
    run = run_realtime(body, lambda body: PUSH, 0.1)
    assert 0 < run.median <= run.p999 <= run.worst
    assert 0 <= run.missed <= run.steps
    assert (run.missed == 0) == (run.lateness == 0.0)


def test_control_may_change_the_step_size(body):
    def control(body):
        body.dt = 1e-3 if body.time < 0.0095 else 5e-3
        return PUSH

    run = run_realtime(body, control, 0.03)
    assert run.steps == 10 + 4
    assert body.time == pytest.approx(0.03)
    assert run.seconds >= 0.03 - 1e-12


def test_a_body_that_is_reset_does_not_make_it_wait_or_hurry(body):
    """An episode that starts anew: due times follow the steps, not the body's clock."""

    def control(body):
        if body.time > 0.0095:
            body.reset()
        return PUSH

    run = run_realtime(body, control, 0.03)
    assert run.steps == 30
    assert run.seconds >= 0.03 - 1e-12


def test_none_ends_the_run(body):
    run = run_realtime(body, lambda body: PUSH if body.time < 0.0025 else None, 1e6)
    assert run.steps == 3
    none = run_realtime(body, lambda body: None, 1.0)
    assert (none.steps, none.missed, none.lateness, none.simulated, str(none)) == (0, 0, 0.0, 0.0, "0 steps")
    assert math.isnan(none.median)
    assert math.isnan(none.worst)


def test_what_control_raises_leaves_the_body_as_it_was(plate_rom, body):
    def control(body):
        if body.time > 0.0095:
            raise KeyError("no such button")
        return PUSH

    plain = fr.Simulator(plate_rom, dt=1e-3)
    for _ in range(10):
        plain.step(PUSH)
    with pytest.raises(KeyError):
        run_realtime(body, control, 1.0)
    assert body.time == plain.time
    np.testing.assert_array_equal(body.displacement(), plain.displacement())
    with pytest.raises(StepError):
        run_realtime(body, lambda body: [np.nan, 0.0, 0.0], 1.0)
    assert body.time == plain.time


@pytest.mark.parametrize("duration", [0.0, -1.0, math.nan, math.inf])
def test_bad_duration_is_refused(body, duration):
    with pytest.raises(fr.StepError, match="use a finite number > 0, in s"):
        run_realtime(body, lambda body: PUSH, duration)
    assert body.time == 0.0


def test_prints_as_one_line():
    run = RealTime(1000, 2, 4.1e-6, 9.004e-6, 9.9996e-4, 1e-4, 1.0, 1.0)
    expected = "1000 steps of 1 ms: 2 missed; a step takes 4.1 µs (median), 9 µs (99.9 %), 1 ms (worst)"
    assert str(run) == expected
    assert str(dataclasses.replace(run, steps=2, worst=1.5)).startswith("2 steps of 500 ms")
    assert "1.5 s (worst)" in str(dataclasses.replace(run, worst=1.5))
