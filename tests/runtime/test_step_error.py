"""The stepper of a run by the error that its steps may have: which one, with what error, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest
from soft_rom import linear, soft_rom

import fenics_rom as fr
from fenics_rom.errors import SceneError
from fenics_rom.mechanics.environment import AppliedLoad
from fenics_rom.mechanics.signals import Signal
from fenics_rom.runtime.step_error import measured_error, stepper_by_error

DURATION, DT = 0.32, 8e-3


@pytest.fixture(scope="module")
def rom():
    """Pulled by its tendon for some two periods, and let go."""
    rom = soft_rom("neo_hookean")
    times = np.linspace(0, DURATION, 200)
    pull = Signal(3.0 * np.sin(np.pi * times / DURATION)[:, None] ** 2, times)
    loads = (AppliedLoad(None, "cable", 0.0, DURATION, pull),)
    run = replace(rom.environment.run, dt=DT, duration=DURATION, loads=loads)
    return replace(rom, environment=replace(rom.environment, run=run))


def true_error(rom, run, exact):
    """Of the tip, beside a run of an eighth of its steps."""
    times = (len(exact.times) - 1) // (len(run.times) - 1)
    tip, other = run.outputs["tip"], exact.outputs["tip"][::times]
    return np.abs(tip - other).max() / np.abs(other).max()


def test_the_error_that_is_measured_is_that_of_a_refined_run(rom):
    """The run is that of the stepper that is named; where none has the error, the dt that is told has it."""
    exact, plain = fr.simulate(rom, dt=DT / 8, stepper="newton"), fr.simulate(rom, stepper="linearly-implicit")
    true = true_error(rom, plain, exact)
    run = fr.simulate(rom, step_error=2 * true)
    assert run.stepping.startswith("linearly-implicit: its steps have an error of ")
    np.testing.assert_array_equal(run.outputs["tip"], plain.outputs["tip"])
    said = float(run.stepping.split("error of ")[1].split()[0])
    assert true / 2 < said < 2 * true  # the one is of the tip, the other of the whole body
    with pytest.raises(SceneError, match=r"steps of 0.008 s have errors of .* linearly-implicit, .* newton") as refused:
        fr.simulate(rom, step_error=said / 4)
    dt = float(str(refused.value).split("dt = ")[1].split()[0])
    assert DT / 3 < dt < DT / 2
    finer = DURATION / np.ceil(DURATION / dt)
    assert fr.simulate(rom, dt=finer, step_error=said / 4).stepping.startswith("linearly-implicit")


def test_what_is_said_follows_from_what_was_measured():
    """Paths of steppers whose errors are C h² and known: shares of the largest displacement, and the dt that does."""
    motion = np.sin(np.linspace(0.1, 3, 50))[:, None] * [3.0, 4.0]

    def path(stepper, parts):
        return motion * (1 + {"linearly-implicit": 0.02, "newton": 0.01}[stepper] / parts**2)

    assert measured_error(path("newton", 1), path("newton", 2)) == pytest.approx(0.01, rel=0.01)
    assert stepper_by_error(0.021, 1.0, path)[0] == "linearly-implicit"
    assert stepper_by_error(0.015, 1.0, path)[0] == "newton"
    with pytest.raises(SceneError, match=r"with linearly-implicit dt = 0\.2 s should do"):  # 0.9 (0.001 / 0.02)^1/2
        stepper_by_error(0.001, 1.0, path)
    assert measured_error(0 * motion, 0 * motion) == 0.0


@pytest.mark.parametrize("given", [0.0, -1e-3, float("nan"), float("inf"), "newton", True])
def test_errors_that_are_none_are_refused(rom, given):
    with pytest.raises(SceneError, match=r"step_error = .*: use a positive number"):
        fr.simulate(rom, step_error=given)


def test_an_error_is_asked_where_there_is_a_choice(rom):
    with pytest.raises(SceneError, match="stepper = 'newton' is given"):
        fr.simulate(rom, step_error=1e-3, stepper="newton")
    with pytest.raises(SceneError, match="large deformation and inertia in a frame that stays; this is none"):
        fr.simulate(linear(rom), step_error=1e-3)
