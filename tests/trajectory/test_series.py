"""Runs keep their inputs and readings by name, reduced and at full order, in memory and in files."""

import re
import warnings
from dataclasses import replace

import numpy as np
import pytest
from bodies import acted_on
from rom_files import put, refusal, same, says, tampered, without

import fenics_rom as fr
from fenics_rom.cli.main import main
from fenics_rom.errors import FenicsRomWarning, StepError
from fenics_rom.trajectory.series import input_series

EFFECTS = """
inertia = {}
damping = { alpha = 1.0, beta = 1e-3 }
gravity = { acceleration = [0.0, 0.0, -2.0] }
[effects.tendon.cable]
points = [[0.0, 0.2, 0.1], [0.5, 0.2, 0.1], [1.0, 0.2, 0.1]]
[effects.pressure.hand]
surface = "top"
[effects.prescribed.wind]
surface = "right"
table = "wind.csv"
[effects.base_motion.quake]
direction = [0, 1, 0]
acceleration = 0.5
[effects.contact]
switching = "scene"
[effects.contact.obstacles.floor]
shape = "half-space"
point = [0, 0, -1e-4]
normal = [0, 0, 1]
"""
READINGS = {
    "readings.cable": 'quantity = "length"\nof = "cable"',
    "readings.sole": 'quantity = "contact_pressure"\nof = "sole"',
    "readings.stress": 'quantity = "von_mises_stress"\nof = "back"',
    "readings.gauge": 'quantity = "strain"\nnear = { point = [0.1, 0.2, 0.3], radius = 0.2 }',
}
RUN = """
dt = 0.01
duration = 0.2
snapshots = 4
load = [
    { actuator = "cable", start = 0.05, force = [2.0] },
    { actuator = "hand", stop = 0.1, force = [20.0] },
    { contact = "sole", stop = 0.1, force = [1.0, 0.0, 0.5] },
]
"""
WIND = np.array([[0.0, 0.1, 0.0, 0.0], [0.1, 0.1, 0.2, 0.0], [0.2, 0.0, 0.2, 0.0]])
STEPS, DT = 20, 0.01


@pytest.fixture(scope="module")
def scene(box_file, tmp_path_factory):
    folder = tmp_path_factory.mktemp("series")
    np.savetxt(folder / "wind.csv", WIND, delimiter=",", header="time,x,y,z", comments="")
    effects = EFFECTS.replace("wind.csv", str(folder / "wind.csv"))
    contacts = '[contacts.sole]\nsurface = "bottom"\n[contacts.right]\nsurface = "right"'
    idle = {"actuators.idle": 'surface = "front"'}  # three columns, before those of tendon and pressure
    return acted_on(box_file, effects, contacts=contacts, run=RUN, **idle, **READINGS)


@pytest.fixture(scope="module")
def system(scene):
    return fr.assemble(scene)


@pytest.fixture(scope="module")
def rom(system):
    """Of all that is there."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FenicsRomWarning)
        return fr.reduce(system, order=system.size)


@pytest.fixture(scope="module")
def runs(system, rom):
    return {"full": fr.simulate(system), "reduced": fr.simulate(rom)}


@pytest.mark.parametrize("model", ["full", "reduced"])
def test_inputs_are_what_acted_in_each_step(runs, model):
    inputs, middle = runs[model].inputs, (np.arange(STEPS) + 0.5) * DT
    expected = {
        "sole": (np.outer(middle < 0.1, [1.0, 0.0, 0.5]), "N"),
        "hand": (20.0 * (middle < 0.1)[:, None], "Pa"),
        "cable": (2.0 * (middle > 0.05)[:, None], "N"),
        "gravity": (np.ones((STEPS, 1)), "1"),
        "quake": (np.full((STEPS, 1), 0.5), "m/s2"),
        "wind": (np.stack([np.interp(middle, WIND[:, 0], WIND[:, k]) for k in (1, 2, 3)], axis=1), "N"),
    }
    assert set(inputs) == set(expected)  # nothing acts on the mode "right"
    for name, (values, unit) in expected.items():
        assert inputs[name].unit == unit
        assert not inputs[name].values[0].any()
        np.testing.assert_allclose(inputs[name].values[1:], values, rtol=1e-12)


def test_readings_of_a_rom_of_all_displacements_are_those_at_full_order(runs):
    """Both steps are solved to a condition number of some 1e4, and contact to 1e-9."""
    full, reduced = runs["full"].readings, runs["reduced"].readings
    assert list(full) == list(reduced) == ["cable", "sole", "stress", "gauge"]
    for name, reading in full.items():
        moved = reading.values - reading.values[0]
        assert np.abs(moved).max() > 0
        assert reading.values.shape == reduced[name].values.shape
        assert np.abs(reduced[name].values - reading.values).max() <= 1e-6 * np.abs(moved).max(), name
    assert full["gauge"].sizes.shape == full["gauge"].values.shape[:2]


def test_readings_of_a_run_are_those_of_a_simulator(rom, runs):
    body = fr.Simulator(rom, dt=DT)
    run = runs["reduced"]
    pushed, hand, cable = (run.inputs[name].values for name in ("sole", "hand", "cable"))
    u = np.hstack([pushed, np.zeros((STEPS + 1, 3)), hand, cable])
    for step in range(1, STEPS + 1):
        body.step(u[step])
        for name, reading in run.readings.items():
            np.testing.assert_array_equal(reading.values[step], body.reading(name))


def test_readings_of_a_batch_are_those_of_simulators(rom):
    """Bodies in free air, in two contact modes; both find the state to 1e-13 of it."""
    free = replace(rom, environment=replace(rom.environment, contact_law=None, obstacles={}))
    signals = {"gravity": 0.0, "wind": np.zeros(3), "quake": 0.0}
    modes, u = list(rom.contact_models), np.random.default_rng(0).standard_normal((4, 8))
    batch = fr.Batch(free, 4, DT, signals=signals)
    bodies = [fr.Simulator(free, DT, signals=signals) for _ in range(4)]
    batch.switch([modes[k % 2] for k in range(4)])
    for k, body in enumerate(bodies):
        body.switch(modes[k % 2])
    for _ in range(5):
        batch.step(u)
        for body, own in zip(bodies, u, strict=True):
            body.step(own)
    for name in rom.readings:
        values, expected = batch.reading(name), np.array([body.reading(name) for body in bodies])
        assert values.shape == expected.shape
        assert np.abs(values - expected).max() <= 1e-12 * np.abs(expected).max(), name
    with pytest.raises(StepError, match="no reading 'cabel'"):
        batch.reading("cabel")
    with pytest.raises(StepError, match=r"no output 'cable'.*; it is a reading: Simulator\.reading gives it"):
        bodies[0].rollout(np.zeros((1, 8)), outputs=["cable"])


def test_commands_say_what_is_read(rom, runs, tmp_path, capsys):
    fr.write_rom(tmp_path / "rom.h5", rom)
    for name, run in runs.items():
        fr.write_trajectory(tmp_path / f"{name}.h5", run)

    def said(*words):
        with pytest.raises(SystemExit) as ended:
            main([words[0], *(str(tmp_path / file) for file in words[1:])])
        assert not ended.value.code
        return capsys.readouterr().out

    kinds = "cable (length in m), sole (contact pressure in Pa), stress (von Mises stress in Pa), gauge (strain in 1)"
    assert re.search(rf"^  readings +{re.escape(kinds)}$", said("info", "rom.h5"), flags=re.M)
    lengths, out = runs["full"].readings["cable"].values, said("info", "full.h5")
    assert f"  length, {lengths.min():.4g} to {lengths.max():.4g} m\n" in out
    assert re.search(r"^  reading gauge +largest principal strain, 0 to \S+ 1$", out, flags=re.M)
    out = said("compare", "reduced.h5", "full.h5")
    assert re.search(r"^ +reading stress +\S+ +\S+ Pa +\S+ Pa +21$", out, flags=re.M)


def test_contact_pressure_times_area_is_the_force_of_the_obstacle(system, runs):
    run = runs["full"]
    nodes = run.readings["sole"].nodes
    reading = system.readings["sole"]
    area = np.bincount(reading.facets.ravel(), np.repeat(reading.areas / 3, 3))
    pushed = run.readings["sole"].values @ area
    assert pushed.max() > 0.1
    np.testing.assert_allclose(pushed, run.forces["floor"][:, 2], atol=1e-9 * pushed.max())
    assert np.abs(run.nodes[nodes, 2]).max() <= 1e-12


def test_what_a_scene_does_not_read_is_not_kept(plate_rom, tmp_path):
    run = fr.simulate(plate_rom, dt=0.1)
    assert not run.readings
    assert list(run.inputs) == ["tip_left"]


def test_series_are_read_to_the_last_bit(runs, tmp_path):
    fr.write_trajectory(tmp_path / "run.h5", runs["full"])
    assert same(fr.read_trajectory(tmp_path / "run.h5"), runs["full"])


def test_a_contact_mode_with_the_name_of_an_actuator_keeps_its_own_inputs():
    inputs = input_series(
        np.array([0, 0, 1, 1]),
        np.array([[0.0, 0.0], [1.0, 2.0], [3.0, 4.0], [0.0, 5.0]]),  # the last one of the actuator alone
        contacts={"tip": 1, "other": 1},
        actuators={"tip": 1},
        loads={},
        units={"tip": "Pa"},
    )
    assert {name: series.values.ravel().tolist() for name, series in inputs.items()} == {
        "contact-tip": [0, 1, 0, 0],
        "tip": [0, 2, 4, 5],
        "other": [0, 0, 3, 0],
    }
    assert inputs["tip"].unit == "Pa"


LIES = {
    "/inputs/cable has shape (3, 1); use ('S', 'w') with S = 21": put("inputs/cable", np.ones((3, 1))),
    "an input has no unit 'kN'": put("inputs/cable", np.ones((21, 1)), unit="kN"),
    "a reading has no quantity 'lenght'": lambda h5: says(quantity="lenght")(h5["readings/cable"]),
    "/readings/sole/nodes is missing": without("readings/sole/nodes"),
    "/readings/sole/values has unit 'bar', not 'Pa'": put("readings/sole/values", lambda there: there, unit="bar"),
    "/readings/gauge/triangles: use numbers below": put("readings/gauge/triangles", lambda there: there + 10_000),
    "unexpected more in /readings/gauge": put("readings/gauge/more", [1.0]),
}


@pytest.mark.parametrize(("message", "lie"), LIES.items(), ids=LIES)
def test_series_that_are_not_what_they_say_are_refused_with_the_reason(runs, tmp_path, message, lie):
    fr.write_trajectory(tmp_path / "run.h5", replace(runs["full"], warnings=()))
    assert message in refusal(fr.read_trajectory, tampered(tmp_path / "run.h5", lie))
