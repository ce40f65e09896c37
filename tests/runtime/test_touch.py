"""A sense of touch in motion: forces, torque and slip are those of contact, and sensors show them as they say."""

import pickle
import warnings
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure
from pads import RUBS, UP, L, pad, pad_scene, pad_text
from turning import csv_of, path_of, spin

import fenics_rom as fr
from fenics_rom.cli.display import print_trajectory
from fenics_rom.compilation import compiled
from fenics_rom.errors import StepError
from fenics_rom.fem.simulator import FullOrderSimulator
from fenics_rom.scene.file import parse_scene
from fenics_rom.visualization.plots.runs import run_panels
from fenics_rom.visualization.viewer.live_page import error_words

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
FRICTION, FOUND = 0.4, 1e-9  # of velocities that contact stops, to which its forces are found
ROUND_OFF = 1e-12  # of sums of some 100 numbers, of their sizes
DT, STEPS = 1e-3, 40
TOUCH = 'quantity = "touch"\nsurface = "top"\ntaxels = { rows = 4, columns = 5 }\n'
RATE, DELAY, COUNTED = 100.0, 0.005, 0.01  # Hz, s, N
SENSOR = f"sensor = {{ rate = {RATE}, delay = {DELAY}, force_step = {COUNTED}, pressure_noise = 20.0 }}"
NOISE = 0.5  # N
TRAINED = "dt = 2e-3\nduration = 0.02\nload = []"
SENSES = {
    "outputs.pad": TOUCH + "point = [0.01, 0.02, 0.03]",
    "outputs.late": TOUCH + SENSOR,
    "outputs.noisy": TOUCH + f"sensor = {{ force_noise = {NOISE}, seed = 3 }}",
}
PRESSED, SPEED = 0.02, np.array([15 * L, 0.0, -2 * L])  # s, when the ball sets off to the side, and m/s


def pin(t):
    """Displacement of the ball, m: down, and later to the side, too."""
    return [SPEED[0] * max(0.0, t - PRESSED), 0.0, SPEED[2] * t]


SIGNALS = {"pin": pin}


def system_of(folder, points="nodes", frame="fixed", **parts):
    x, y, radius = {"nodes": (1.9, 2.05, 20.0), "surface": (1.3, 1.55, 0.5), "faces": (1.3, 1.55, 0.05)}[points]
    center = [x * L, y * L, (1.0001 + radius) * L]
    ball = f'obstacles.pin = {{ shape = "sphere", center = {center}, radius = {radius * L} }}'
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return fr.assemble(pad_scene(folder, ball, None, frame, points, **UP | RUBS | SENSES | parts))


@pytest.fixture(scope="module")
def system(tmp_path_factory):
    return system_of(tmp_path_factory.mktemp("touch"), run=f"dt = {DT}\nduration = {DT * STEPS}\nload = []")


@pytest.fixture(scope="module")
def rom(system):
    return fr.reduce(system, order=10)


@pytest.fixture(scope="module")
def finer(system):
    return fr.reduce(system, order=40)


def check_forces(body, reading, places, origin):
    """Force, torque and taxels against the forces on nodes, and where these are."""
    felt, contact = body.touch("pad"), body.nodal_contact
    size = np.abs(contact.forces).max()
    np.testing.assert_allclose(felt.force, contact.forces.sum(axis=0), atol=ROUND_OFF * size)
    arms = places[contact.nodes] - origin
    np.testing.assert_allclose(felt.torque, np.cross(arms, contact.forces).sum(axis=0), atol=ROUND_OFF * size)
    pressed = felt.pressures.ravel() @ reading.map.areas
    assert pressed == pytest.approx(contact.pressing.sum(), rel=ROUND_OFF)
    return felt


@pytest.mark.parametrize(("points", "degree"), [("nodes", 2), ("surface", 1), ("faces", 1)])
def test_it_feels_the_forces_on_nodes_of_any_contact(tmp_path, points, degree):
    """At full order and reduced; the torque is about the middle of the surface as it is moved."""
    system = system_of(tmp_path, points, degree=degree, **{"outputs.pad": TOUCH})
    reading, touched = system.readings["pad"], 0
    bodies = (
        FullOrderSimulator(system, DT, system.scene.environment, SIGNALS),
        fr.Simulator(fr.reduce(system, order=10), DT, signals=SIGNALS),
    )
    corners = reading.nodes[reading.facets[:, :3]]
    for body in bodies:
        for _ in range(STEPS // 2):
            body.step(np.zeros(0))
            places = system.body.nodes + body.displacement()
            middle = reading.areas @ places[corners].mean(axis=1) / reading.areas.sum()
            touched += check_forces(body, reading, places, middle).touching
    assert touched > 10


@pytest.mark.parametrize("model", ["full", "reduced", "free"])
def test_slip_is_how_points_move_along_what_they_touch(tmp_path, system, rom, model):
    """Of each step the way of the points less that of the ball, along it, weighed by normal forces."""
    if model == "free":
        system = system_of(tmp_path, frame="moving", supports=None)
        body = fr.Simulator(fr.reduce(system, order=6), DT, signals=SIGNALS)
    elif model == "full":
        body = FullOrderSimulator(system, DT, system.scene.environment, SIGNALS)
    else:
        body = fr.Simulator(rom, DT, signals=SIGNALS)
    nodes, slides, sticks = system.points_of_contact().nodes, 0, 0
    for step in range(STEPS):
        before = body.displacement()
        body.step(np.zeros(0))
        contact = (body.stepper if model == "full" else body.integrator).contact
        felt = body.touch("pad")
        if contact is None or felt.touching != 1:
            continue
        n, λ, point = contact.normals, (contact.normals * contact.pair_forces).sum(axis=1), contact.pairs
        way = ((body.displacement() - before) / DT)[nodes[point]] - SPEED * [step >= PRESSED / DT - 0.5, 0, 1]
        along = λ @ (way - (n * way).sum(axis=1)[:, None] * n) / λ.sum()
        np.testing.assert_allclose(felt.patches.slip[0], along, atol=FOUND * np.linalg.norm(SPEED))
        used = np.linalg.norm((contact.pair_forces - λ[:, None] * n).sum(axis=0)) / (FRICTION * λ.sum())
        assert felt.patches.margin[0] == pytest.approx(max(0.0, 1 - used), abs=ROUND_OFF)
        slides, sticks = slides + (felt.patches.sliding[0] > 0.9), sticks + (felt.patches.sliding[0] < 0.1)
    assert model == "free" or (slides and sticks)


def test_a_sensor_looks_at_its_rate_and_shows_it_late(rom):
    """Every number is the rounded one that was felt at the last look before the delay."""
    body, felt, shown = fr.Simulator(rom, DT, signals=SIGNALS), [np.zeros(3)], []
    for _ in range(60):
        body.step()
        felt.append(body.touch("pad").force)
        shown.append(body.touch("late").force)
    every, late = round(1 / RATE / DT), round(DELAY / DT)
    for step, force in enumerate(shown, start=1):
        look = max(0, step - late) // every * every
        expected = COUNTED * np.round(felt[look] / COUNTED)
        np.testing.assert_allclose(force, expected, atol=ROUND_OFF)
    assert np.ptp(shown, axis=0).max() > 10 * COUNTED


def test_noise_is_normal_and_the_same_in_the_same_run(rom):
    """Deviations of 3 x 200 numbers: their mean and size to four standard errors."""
    body, off = fr.Simulator(rom, DT, signals=SIGNALS), []
    for _ in range(200):
        body.step()
        off.append(body.touch("noisy").force - body.touch("pad").force)
    off = np.ravel(off) / NOISE
    assert abs(off.mean()) <= 4 / np.sqrt(len(off))
    assert abs(off.std() - 1) <= 4 / np.sqrt(2 * len(off))
    again = fr.Simulator(rom, DT, signals=SIGNALS)
    again.rollout(np.zeros((200, again.inputs)))
    for name in ("noisy", "late"):
        np.testing.assert_array_equal(again.reading(name), body.reading(name))


def test_a_rollout_leaves_what_steps_leave(rom):
    """Of a ball at rest on which gravity presses the pad: in blocks, as no sensor remembers."""
    alone = replace(rom, readings={"pad": rom.readings["pad"]})
    stepped, rolled = fr.Simulator(alone, DT), fr.Simulator(alone, DT)
    for steps in (5, 60):
        for _ in range(steps):
            stepped.step()
        rolled.rollout(np.zeros((steps, rolled.inputs)))
        for one, other in zip(stepped.touch("pad").patches, rolled.touch("pad").patches, strict=True):
            np.testing.assert_allclose(other, one, rtol=FOUND, atol=FOUND * np.linalg.norm(SPEED))


def test_what_is_felt_and_shown_is_saved_with_the_state(rom):
    body = fr.Simulator(rom, DT, signals=SIGNALS)
    for _ in range(23):
        body.step()
    state, now = body.save(), {name: body.reading(name) for name in rom.readings}
    ahead = []
    for _ in range(20):
        body.step()
        ahead.append([body.reading(name) for name in rom.readings])
    body.restore(state)
    for other in (body, pickle.loads(pickle.dumps(fr.Simulator(rom, DT)))):
        other.restore(state)
        for name, values in now.items():
            np.testing.assert_array_equal(other.reading(name), values)
    for expected in ahead:
        body.step()
        for name, values in zip(rom.readings, expected, strict=True):
            np.testing.assert_array_equal(body.reading(name), values)
    body.reset()
    assert not body.touch("late").force.any()


def test_bodies_of_a_batch_feel_what_single_ones_do_with_noise_of_their_own(rom):
    single, bodies = fr.Simulator(rom, DT, signals=SIGNALS), fr.Batch(rom, size=2, dt=DT, signals=SIGNALS)
    assert bodies.stepping == ("compiled" if compiled() else "one after another, as of a sense of touch")
    slides, late, fast = 0, 0, np.linalg.norm(SPEED)

    def check():
        for part, of_one in zip(bodies.touch("pad").patches, single.touch("pad").patches, strict=True):
            np.testing.assert_allclose(part, [of_one, of_one], rtol=ROUND_OFF, atol=ROUND_OFF * fast)
        for name in ("pad", "late"):
            felt, of_one = bodies.touch(name), single.touch(name)
            np.testing.assert_array_equal(felt.force[0], of_one.force)
            for part, expected in zip(felt[1:6], of_one[1:6], strict=True):
                np.testing.assert_allclose(part[0], expected, rtol=ROUND_OFF, atol=ROUND_OFF)

    for _ in range(45):
        single.step()
        bodies.step(np.zeros((2, bodies.inputs)))
        check()
        slides += single.touch("pad").patches.sliding[0] > 0.9
        late += single.touch("late").force.any()
    assert slides
    assert late
    single.reset()
    bodies.reset([0])
    assert not bodies.touch("late").force[0].any()
    bodies.reset([1])
    for _ in range(12):
        single.step()
        bodies.step(np.zeros((2, bodies.inputs)))
    check()
    noisy = bodies.touch("noisy").force
    np.testing.assert_array_equal(noisy[0], single.touch("noisy").force)
    assert (noisy[0] != noisy[1]).all()
    copied = pickle.loads(pickle.dumps(bodies))
    np.testing.assert_array_equal(copied.touch("noisy").force, noisy)


@pytest.mark.parametrize("kind", ["free", "what turns", "large"])
def test_bodies_of_any_batch_feel_what_single_ones_do(kind, tmp_path):
    """In moving frames, beside an obstacle that turns, and with large deformation: one after another."""
    center = [1.9 * L, 2.05 * L, 21.0001 * L]
    ball, signals, parts = f'shape = "sphere", center = {center}, radius = {20 * L}', SIGNALS, dict(UP | RUBS | SENSES)
    if kind == "what turns":
        (tmp_path / "spin.csv").write_text(csv_of(path_of(spin(center, [0, 1, 0], 3.0, 0.02), 0.1)))
        ball, signals = f'{ball}, motion = {{ table = "spin.csv", origin = {center} }}', {}
    elif kind == "large":
        parts |= {"effects.large_deformation": "", "run": TRAINED}
    else:
        parts |= {"supports": None}
    frame = "moving" if kind == "free" else "fixed"
    text = pad_text(tmp_path, f"obstacles.pin = {{ {ball} }}", pad((2, 2, 1)), frame, "nodes", **parts)
    rom = fr.reduce(fr.assemble(parse_scene(text, folder=tmp_path)), order=4)
    single, bodies = fr.Simulator(rom, DT, signals=signals), fr.Batch(rom, 2, DT, signals=signals)
    assert bodies.stepping == "one after another, as of a sense of touch"
    touched, slid, late = 0, 0, 0
    for _ in range(30):
        single.step()
        bodies.step(np.zeros((2, bodies.inputs)))
        for name in ("pad", "late", "noisy"):
            for part, of_one in zip(bodies.touch(name)[:6], single.touch(name)[:6], strict=True):
                np.testing.assert_array_equal(part[0], of_one)
        felt = single.touch("pad")
        np.testing.assert_array_equal(bodies.touch("pad").force, [felt.force] * 2)
        touched, slid = touched + felt.touching, slid + felt.patches.sliding[0]
        late += single.touch("late").force.any()
    assert touched > 10
    assert late
    assert slid > 1 or kind != "what turns"
    noisy = bodies.touch("noisy").force
    assert (noisy[0] != noisy[1]).all()


def test_errors_of_what_is_felt_are_estimated_beside_a_finer_rom(system, rom, finer, tmp_path, capsys):
    """Of force, torque, centre, area and taxels, at order 10 as at 40; its run, file, print and plots have them."""
    run = fr.simulate(rom, signals=SIGNALS, finer=finer)
    true, felt = fr.simulate(system, signals=SIGNALS).readings["pad"].touch, run.readings["pad"].touch
    told = run.errors["estimate"].readings["pad"].touch
    for part in ("force", "torque", "centre", "normal_force", "area", "pressures"):
        off, stated = (np.abs(of).max() for of in (getattr(true, part) - getattr(felt, part), getattr(told, part)))
        assert off > 0.01 * np.abs(getattr(true, part)).max(), part
        assert 0.67 < stated / off < 1.5, part
    bodies, single = (fr.Batch(rom, 2, DT, signals=SIGNALS, finer=finer), fr.Simulator(rom, DT, finer=finer))
    single.set_signal("pin", pin)  # of both
    for _ in range(STEPS):
        bodies.step(np.zeros(bodies.inputs))
        single.step()
    np.testing.assert_array_equal(bodies.error_estimate.touch("pad").force, [told.force[-1]] * 2)
    np.testing.assert_array_equal(single.error_estimate.touch("noisy").force, told.force[-1])  # as felt, without noise
    np.testing.assert_array_equal(
        single.error_estimate.reading("pad"), run.errors["estimate"].readings["pad"].values[-1]
    )
    fr.write_trajectory(tmp_path / "run.h5", run)
    again = fr.read_trajectory(tmp_path / "run.h5")
    np.testing.assert_array_equal(again.errors["estimate"].readings["late"].touch.area, told.area)
    print_trajectory(again, tmp_path / "run.h5")
    said = " ".join(capsys.readouterr().out.split())
    assert f"error of pad, estimate {np.linalg.norm(told.force, axis=1).max():.3g} N" in said
    assert error_words(single.stated_errors)[0].count(" N") == 3
    reading = run_panels({"run": run})["reading_pad"]
    reading(figure := Figure())
    assert "± estimate" in figure.axes[0].get_legend_handles_labels()[1]


def test_errors_of_what_is_felt_are_told_beside_a_finer_rom_alone(system):
    body = fr.Simulator(fr.reduce(system, order=6, errors=True), DT, signals=SIGNALS)
    with pytest.raises(StepError, match="reading 'pad': errors of readings are differences to a finer ROM beside"):
        body.error_estimate.touch("pad")


def test_what_is_no_sense_of_touch_is_refused(rom):
    body = fr.Simulator(rom, DT, signals=SIGNALS)
    with pytest.raises(StepError, match="no sense of touch 'pat'; there is late, noisy, pad; did you mean 'pad'"):
        body.touch("pat")
