"""What is kept of a run: the same as stepping by hand and reading after each step, at a fraction of the cost."""

import cProfile
import pstats
import tracemalloc
import warnings
from dataclasses import replace

import numpy as np
import pytest
from bodies import acted_on

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning, SceneError
from fenics_rom.mechanics.load_history import LoadHistory
from fenics_rom.mechanics.signals import Signal

KEPT = ("times", "contact", "energy", "supplied", "dissipated", "lost_in_switching")
RUN = """dt = 1e-3
duration = 0.3
snapshots = 7
[[run.load]]
contact = "right"
stop = 0.0503
force = [0.0, 0.0, 2.0]
[[run.load]]
contact = "top"
start = 0.1
stop = 0.2
force = { table = "push.csv" }
[[run.load]]
actuator = "pull"
start = 0.08
stop = 0.25
force = [3.0]"""
PULL = {"actuators.pull": 'surface = "back"\nforce = "normal"', "outputs.tip": "points = [[1.0, 0.4, 0.3]]"}
GRAVITY = "gravity = { acceleration = [0, 0, -9.81] }\n"


@pytest.fixture(scope="module", params=["", GRAVITY], ids=["inputs alone", "gravity"])
def rom(request, box_file, tmp_path_factory):
    """A box that is pushed here and there; its steps are taken by a kernel that holds the last ones."""
    run = RUN.replace('{ table = "push.csv" }', "[1.0, 0.0, -1.0]")
    scene = acted_on(box_file, f"inertia = {{}}\ndamping = {{ beta = 1e-4 }}\n{request.param}", run=run, **PULL)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FenicsRomWarning)
        return fr.reduce(fr.assemble(scene), order=12)


def swelling(rom):
    """The same with a force that is a table."""
    run = rom.environment.run
    table = Signal(np.array([[0.0, 0.0, 0.0], [2.0, 1.0, -1.0]]), np.array([0.1, 0.2]))
    loads = [replace(load, signal=table) if load.contact == "top" else load for load in run.loads]
    return replace(rom, environment=replace(rom.environment, run=replace(run, loads=tuple(loads))))


def longer(rom, steps):
    run = rom.environment.run
    return replace(rom, environment=replace(rom.environment, run=replace(run, duration=steps * run.dt)))


def close(one, other, rtol=1e-12):
    np.testing.assert_allclose(one, other, rtol=rtol, atol=rtol * np.abs(other).max(initial=1e-300))


@pytest.mark.parametrize("change", [lambda rom: rom, swelling])
def test_a_run_is_what_is_read_after_every_step(rom, change):
    """To round-off: the sums of 300 steps are the same, added in another order."""
    rom = change(rom)
    run, body = fr.simulate(rom), fr.Simulator(rom, 1e-3)
    assert body.steps_in_blocks
    read = {name: [] for name in (*KEPT, "tip")}
    shapes = {}
    history = LoadHistory(rom.environment, rom.contacts, rom.actuators)
    for step in range(301):
        if step:
            time = (step - 0.5) * 1e-3
            contact, u = history.at(time, body.contact)
            body.switch(contact)
            body.step(u)
        now = body.time, run.contacts.index(body.contact), body.energy, *(s for s, _ in body.ledger.sums[:3])
        for name, value in zip(KEPT, now, strict=True):
            read[name].append(value)
        read["tip"].append(body.displacement("tip"))
        shapes[step] = body.displacement(), body.velocity()
    assert set(read["contact"]) == {0, 1}
    assert read["lost_in_switching"][-1] > 0
    for name in KEPT:
        close(getattr(run, name), read[name])
    close(run.outputs["tip"], read["tip"])
    steps = np.round(run.snapshot_times / 1e-3).astype(int)
    close(run.snapshots, [shapes[step][0] for step in steps])
    close(run.velocities, [shapes[step][1] for step in steps])


@pytest.mark.parametrize("every", [2, 7, 32, 33, 299, 1000])
def test_every_keeps_some_instants_and_the_last(rom, every, tmp_path):
    whole, run = fr.simulate(rom), fr.simulate(rom, every=every)
    kept = np.union1d(np.arange(0, 301, every), 300)
    for name in KEPT:
        np.testing.assert_array_equal(getattr(run, name), getattr(whole, name)[kept])
    np.testing.assert_array_equal(run.outputs["tip"], whole.outputs["tip"][kept])
    np.testing.assert_array_equal(run.snapshots, whole.snapshots)
    assert run.steps == whole.steps == 300
    assert fr.compare(run, whole)["energy"].largest == 0.0
    fr.write_trajectory(tmp_path / "run.h5", run)
    again = fr.read_trajectory(tmp_path / "run.h5")
    assert (again.steps, len(again.times)) == (300, len(kept))


def test_the_scene_says_it_and_files_keep_it(box_file, tmp_path):
    scene = acted_on(box_file, GRAVITY, run=RUN.partition("[[")[0] + "every = 50", **PULL)
    system = fr.assemble(scene)
    rom = fr.reduce(system)
    fr.write_rom(tmp_path / "rom.h5", rom)
    reduced, full = fr.simulate(fr.read_rom(tmp_path / "rom.h5")), fr.simulate(system)
    assert len(reduced.times) == len(full.times) == 7
    assert (reduced.steps, full.steps) == (300, 300)
    assert fr.compare(reduced, full)["energy"].relative < 1e-9
    np.testing.assert_array_equal(fr.simulate(system, every=100).energy, full.energy[::2])


@pytest.mark.parametrize("every", [0, -1, 1.5, "2"])
def test_other_numbers_are_refused(rom, every):
    with pytest.raises(SceneError, match="use a whole number of steps, from 1 to 10,000,000"):
        fr.simulate(rom, every=every)


def test_a_run_that_ends_at_another_time_is_told(rom):
    """By steps that do not fit its duration; not by digits that were left out of a step."""
    told = [text for text in fr.simulate(rom, dt=0.07).warnings if "the run ends" in text]
    duration = rom.environment.run.duration
    steps = round(duration / 0.07)
    assert [f"the run ends at {0.07 * steps:.9g} s, after {steps} steps of 0.07 s, and not at" in text for text in told]
    dt = float(told[0].split("with dt = ")[1].split(" s ")[0])
    for fits in (dt, duration / 7, round(duration / 7, 9)):
        assert not any("the run ends" in text for text in fr.simulate(rom, dt=fits).warnings)


def test_recording_costs_a_few_calls_a_step_however_long_the_run(rom):
    """One by one it would cost a hundred; bodies on which something acts take more to step."""

    def calls(steps):
        profile = cProfile.Profile()
        profile.runcall(fr.simulate, longer(rom, steps))
        return pstats.Stats(profile).total_calls

    first, second, third = calls(1000), calls(2000), calls(4000)
    assert (second - first) / 1000 < (15 if rom.environment.is_plain else 45)
    assert third - second == pytest.approx(2 * (second - first), rel=0.1)


def test_memory_grows_with_what_is_kept_alone(rom):
    def peak(steps, **choice):
        tracemalloc.start()
        fr.simulate(longer(rom, steps), **choice)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return peak

    fr.simulate(rom)
    first, second, third = peak(1000), peak(4000), peak(7000)
    assert third - second < 1.2 * (second - first)
    assert peak(7000, every=100) < first
