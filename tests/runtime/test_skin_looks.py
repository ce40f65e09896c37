"""What comes through the skin is told, with the same depth at full order, reduced, in rollouts and in batches."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from bodies import acted_on, scene_text, write_box

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning, SceneError, StepError
from fenics_rom.runtime import batch_skin
from fenics_rom.scene.file import parse_scene

DT = 1e-3
OBSTACLES = """
inertia = {}
damping = { alpha = 20.0, beta = 1e-3 }
contact.obstacles.floor = { shape = "half-space", point = [0, 0, -1e-2], normal = [0, 0, 1] }
contact.obstacles.ball = { shape = "sphere", center = [0.55, 0.2, 0.5], radius = 0.17 }
"""
RUN = {"run": f"dt = {DT}\nduration = 0.05"}
BELOW = '[contacts.bottom]\nsurface = "bottom"'
TOLD = (
    r"obstacle 'ball' is (\S+) mm inside the body at \[.*\] m on surface 'top', at t = .* no contact points.*"
    r": name surface 'top' in a contact mode \(there is bottom\)"
)


def down(t):
    """To 0.12 m below the top of the box, 0.3 m, within 40 ms."""
    return [0.0, 0.0, -0.15 * min(1.0, t / 0.04)]


@pytest.fixture(scope="module")
def system(box_file):
    """A box that a ball can come into from above, as only what is below is touched."""
    return fr.assemble(
        acted_on(box_file, OBSTACLES, contacts=BELOW, **{"outputs.tip": "points = [[1, 0.4, 0.3]]"}, **RUN)
    )


@pytest.fixture(scope="module")
def rom(system):
    return fr.reduce(system, order=12)


def run(body, steps):
    for _ in range(steps):
        body.step(np.zeros(body.inputs))


def depth_of(message):
    return float(message.partition("up to ")[2].split()[0])


def test_a_body_and_its_full_order_are_told_alike(system, rom):
    with pytest.warns(FenicsRomWarning, match=TOLD) as full_warnings:
        full = fr.simulate(system, signals={"ball": down})
    with pytest.warns(FenicsRomWarning, match=TOLD) as warned:
        reduced = fr.simulate(rom, signals={"ball": down})
    assert len(full_warnings) == len(warned) == 1
    for each in (full, reduced):
        (message,) = each.warnings
        assert depth_of(message) == pytest.approx(120.0, abs=1e-3)


def test_looks_change_no_bit_of_the_motion(rom):
    with warnings.catch_warnings(action="ignore", category=FenicsRomWarning):
        inside = fr.simulate(rom, signals={"ball": down})
    away = fr.simulate(rom)
    np.testing.assert_array_equal(inside.snapshots, away.snapshots)
    np.testing.assert_array_equal(inside.energy, away.energy)
    assert not away.warnings


def test_it_is_told_once_and_kept_as_other_warnings_are(rom):
    body = fr.Simulator(rom, DT, signals={"ball": down})
    with pytest.warns(FenicsRomWarning, match=TOLD):
        run(body, 100)
    saved, (message,) = body.save(), body.warnings
    body.reset()
    assert not body.warnings
    body.restore(saved)  # and warns no more
    body.step()
    assert body.warnings == (message,)


def test_a_rollout_looks_too(rom, tmp_path):
    fr.write_rom(tmp_path / "rom.h5", rom)  # which knows names of surfaces, too
    body = fr.Simulator(fr.read_rom(tmp_path / "rom.h5"), DT, signals={"ball": down})
    with pytest.warns(FenicsRomWarning, match=TOLD):
        body.rollout(np.zeros((300, body.inputs)))
    assert depth_of(body.warnings[0]) == pytest.approx(120.0, abs=1e-3)


def test_each_body_of_a_batch_tells_how_deep(rom, monkeypatch):
    monkeypatch.setattr(batch_skin, "BODY_STEPS", 64)
    bodies = fr.Batch(rom, 4, DT)
    bodies.place_obstacle("ball", [0.0, 0.0, -0.15], [1, 3])
    with pytest.warns(FenicsRomWarning, match=TOLD) as warned:
        run(bodies, batch_skin.QUICK * batch_skin.BODY_STEPS + 4)
    assert len(warned) == 1
    np.testing.assert_allclose(bodies.through_skin, [0.0, 0.12, 0.0, 0.12], atol=1e-6)
    bodies.place_obstacle("ball", [0.0, 0.0, 0.0], [1])
    bodies.reset([1])
    np.testing.assert_allclose(bodies.through_skin, [0.0, 0.0, 0.0, 0.12], atol=1e-6)


def test_who_begins_inside_is_refused_wherever_it_begins(box_file, system, rom):
    low = OBSTACLES.replace("0.5]", "0.4]")
    with pytest.raises(SceneError, match=r"'ball' is 0.07 m inside the body .* no contact points"):
        fr.reduce(fr.assemble(scene := acted_on(box_file, low, contacts=BELOW, **RUN)), order=12)
    said = r"start outside of all obstacles .*'ball' is 0\.07 m inside the body"
    assert "no run can begin so" in fr.assemble(scene).warnings[0]
    with pytest.raises(StepError, match=said):
        fr.simulate(scene)
    for make in (fr.Simulator, lambda rom, dt, **more: fr.Batch(rom, 2, dt, **more)):
        with pytest.raises(StepError, match=said):
            make(rom, DT, signals={"ball": [0.0, 0.0, -0.1]})


def test_springs_are_no_holes(box_file):
    """Pressed flat on its contact surface, the skin is as deep as its points are, and that is told of neither."""
    soft = OBSTACLES.replace("inertia = {}", 'inertia = {}\ncontact.method = "penalty"\ncontact.stiffness = 50.0')
    scene = acted_on(
        box_file, soft + "gravity = { acceleration = [0, 0, -9.81] }", contacts=BELOW, supports=None, **RUN
    )
    with warnings.catch_warnings(action="ignore", category=FenicsRomWarning):
        rom = fr.reduce(fr.assemble(scene), order=12)
    body = fr.Simulator(rom, 1e-2)
    for _ in range(200):
        body.step()
    assert not [message for message in body.warnings if "inside the body" in message]
    there = body.contact_coordinates + body.integrator.point_displacement()
    assert there[:, 2].min() < -0.05  # though they are deep


def test_a_body_that_turns_is_looked_at_where_it_is(box_file):
    """Free, with its uncovered side towards the floor."""
    scene = parse_scene(f'frame = "moving"\n{scene_text(box_file, effects=OBSTACLES, contacts=BELOW, supports=None)}')
    signals = {"ball": [0.0, 0.0, 1.0]}  # out of the way
    body = fr.Simulator(fr.reduce(fr.assemble(scene), order=12), DT, signals=signals)
    rolled = np.array([np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0])  # about x by 90 degrees: what is below is beside now
    centre = np.array([0.5, 0.2, 0.19 + 1e-3])
    falls = fr.BaseState(centre, rolled, np.array([0.0, 0.0, -2.0]), np.zeros(3))
    body.place(falls)  # 1 mm above the floor
    with pytest.warns(FenicsRomWarning, match=r"'floor' is .* mm inside the body .* no contact points"):
        run(body, 40)
    body.reset()
    assert not body.warnings


RADIUS = 5e-3
PLATE = f"""
inertia = {{}}
damping = {{ alpha = 20.0, beta = 1e-5 }}
contact.obstacles.ball = {{ shape = "sphere", center = [0.09, 0.11, 0.05], radius = {RADIUS} }}
"""


def crosses(t):
    """At rest for 10 ms, then 0.1 m down at 20 m/s; which takes 50 steps of 0.1 ms, or five of 1 ms."""
    return [0.0, 0.0, -min(0.1, max(0.0, 20.0 * (t - 0.0101)))]


@pytest.fixture(scope="module")
def plates(tmp_path_factory):
    """A plate 2 mm thick that is touched at its right end alone, at full order and reduced, by steps."""
    mesh = write_box(tmp_path_factory.mktemp("plate") / "plate.msh", (0.2, 0.2, 0.002), (4, 4, 1))
    right = '[contacts.right]\nsurface = "right"'
    with warnings.catch_warnings(action="ignore", category=FenicsRomWarning):
        runs = {dt: {"run": f"dt = {dt}\nduration = {duration}"} for dt, duration in ((1e-3, 0.03), (1e-4, 0.0173))}
        full = {dt: fr.assemble(acted_on(mesh, PLATE, contacts=right, **run)) for dt, run in runs.items()}
        return {dt: (system, fr.reduce(system, order=8)) for dt, system in full.items()}


@pytest.mark.parametrize("dt", [1e-3, 1e-4])
def test_what_flies_through_a_thin_plate_is_told(plates, dt):
    """Between two looks at what rests, and between two steps."""
    system, rom = plates[dt]
    steps, signals = round(0.0173 / dt), {"ball": crosses}
    body, rolled = (fr.Simulator(rom, dt, signals=signals) for _ in range(2))
    many = fr.Batch(rom, 3, dt, signals=signals)
    runs = {
        "full order": lambda: fr.simulate(system, signals=signals),
        "reduced": lambda: fr.simulate(rom, signals=signals),
        "steps": lambda: run(body, steps),
        "rollout": lambda: rolled.rollout(np.zeros((steps, rolled.inputs))),
        "batch": lambda: run(many, steps + 4),
    }
    for go in runs.values():
        with pytest.warns(FenicsRomWarning, match=TOLD.replace("bottom", "right")) as warned:
            go()
        (message,) = [str(each.message) for each in warned]
        assert 0.5 * RADIUS <= 1e-3 * float(message.partition(" is ")[2].split()[0]) <= RADIUS + 2e-3
    assert (many.through_skin > 0.5 * RADIUS).all()


def test_what_flies_through_right_after_the_start_is_told_by_batches(plates):
    """In five steps after the first one, before who moved far is asked for the second time."""
    many = fr.Batch(plates[1e-3][1], 3, 1e-3, signals={"ball": lambda t: crosses(t + 9e-3)})
    with pytest.warns(FenicsRomWarning, match=TOLD.replace("bottom", "right")):
        run(many, 20)
    assert (many.through_skin > 0.5 * RADIUS).all()


def test_a_body_that_is_put_elsewhere_did_not_go_through_what_is_between(plates):
    body = fr.Simulator(plates[1e-3][1], 1e-3)
    body.step()
    low = body.save()
    low = replace(low, obstacles=low.obstacles._replace(offsets=np.array([[0.0, 0.0, -0.1]])))
    body.set_signal("ball", [0.0, 0.0, -0.1])
    body.restore(low)
    run(body, 100)  # without a warning, which would be an error here
    assert not [message for message in body.warnings if "inside the body" in message]
