"""Bodies among obstacles that turn and are driven: carried, fed and struck; in files, batches and at full order."""

import copy
import pickle

import numpy as np
import pytest
from bodies import box_arrays, write_arrays
from triangle_meshes import groove, write_stl
from turning import NOTHING, csv_of, path_of, spin

import fenics_rom as fr
from fenics_rom.compilation import compiled
from fenics_rom.errors import SceneError, StepError
from fenics_rom.mechanics.frame_motion import quaternion_of_vector
from fenics_rom.mechanics.obstacle_poses import distance_from
from fenics_rom.scene.file import parse_scene

CLOSES_TO = 1e-12  # of the largest energy or work seen
SIDE = 0.02  # m, of a soft cube
FREE = """
frame = "moving"
[mesh]
file = "cube.msh"
[material]
young = 1e5
poisson = 0.3
density = 500.0
[contacts.skin]
near = { point = [0, 0, 0], radius = 1.0 }
[outputs.top]
points = [[0.02, 0.02, 0.02]]
[effects]
inertia = {}
damping = { alpha = 0.0, beta = 1e-3 }
gravity = { acceleration = [0, 0, -9.81] }
friction = { coefficient = 0.6 }
[effects.contact.obstacles.thing]
"""
HELD = FREE.replace('frame = "moving"', "").replace("[contacts", '[supports]\nclamped = ["left"]\n[contacts')
TABLE = 'shape = "box"\ncenter = [0, 0, -0.01]\nsize = [0.5, 0.5, 0.02]\n'
VEE = 'shape = "mesh"\nfile = "vee.stl"\nposition = [0, 0, -0.03]\n'
CAM = 'shape = "box"\ncenter = [0.04, 0.01, 0.01]\nsize = [0.03, 0.01, 0.04]\n'
AXIS = np.array([-0.06, 0.0, 0.0])
pytestmark = pytest.mark.filterwarnings("ignore:.*surface is|the time step is long")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("turning")
    write_arrays(folder / "cube.msh", *box_arrays((SIDE, SIDE, SIDE), (2, 2, 2)))
    write_stl(folder / "vee.stl", groove(), 1.0)
    (folder / "spin.csv").write_text(csv_of(path_of(spin([0.04, 0.01, 0.01], [0, 1, 0], 8.0), 0.4)))
    return folder


def rom_of(folder, text, order=6):
    return fr.reduce(fr.assemble(parse_scene(text, folder=folder)), order=order)


@pytest.fixture(scope="module")
def free(folder):
    return rom_of(folder, f"{FREE}{TABLE}motion = {{ origin = [-0.06, 0, 0] }}")


@pytest.fixture(scope="module")
def struck(folder):
    """A held cube, and a cam that turns against it by a table."""
    text = (
        f'{HELD}{CAM}motion = {{ table = "spin.csv", origin = [0.04, 0.01, 0.01] }}\n[run]\ndt = 2e-3\nduration = 0.4\n'
    )
    system = fr.assemble(parse_scene(text + "snapshots = 40", folder=folder))
    return system, fr.reduce(system, order=system.elastic_size, method="modal")


def check_account(body, start=0.0):
    """Stored energy is what it was at first, less what went and with what came, of which obstacles have their own."""
    ledger = body.ledger
    left = body.energy - start + ledger.dissipated + ledger.numerical - ledger.supplied
    assert abs(left) <= CLOSES_TO * max(abs(body.energy), abs(ledger.supplied), abs(ledger.dissipated), abs(start))
    assert min(ledger.contact, ledger.friction) >= -1e-12 * abs(ledger.supplied)


@pytest.mark.parametrize("h", [5e-3, 1e-2])
def test_a_table_that_turns_carries_what_lies_on_it(folder, h):
    """Half a turn and more: it stays where it was on the table, and has the energy that the table gave."""
    bottom = FREE.replace("near = { point = [0, 0, 0], radius = 1.0 }", 'surface = "bottom"')
    free, rate = rom_of(folder, f"{bottom}{TABLE}motion = {{ origin = [-0.06, 0, 0] }}"), 6.0
    body = fr.Simulator(free, h, signals={"thing": spin(AXIS, [0, 0, 1], rate)})
    start = body.displacement() + free.nodes
    while body.time < 0.799:
        body.step()
    centre, at_first = (places.mean(axis=0) - AXIS for places in (free.nodes + body.displacement(), start))
    angle = np.angle(complex(*centre[:2]) / complex(*at_first[:2]) / np.exp(1j * rate * (0.8 - 0.15)))
    assert abs(np.hypot(*centre[:2]) - np.hypot(*at_first[:2])) < 2e-5 + 3 * h**2
    assert abs(angle) < 12 * h**2 + 1e-4
    ω_v = rate * np.hypot(*at_first[:2])
    mass = 500.0 * SIDE**3
    kinetic = mass / 2 * ω_v**2 + mass * SIDE**2 / 12 * rate**2
    assert body.ledger.obstacles == pytest.approx(kinetic, rel=5e-3)
    check_account(body)


@pytest.mark.parametrize(
    ("shape", "seed", "points"),
    [(TABLE, 0, "nodes"), (VEE, 1, "nodes"), ("plane", 2, "nodes"), (VEE, 0, "faces")],
    ids=["box", "groove", "half-space", "faces on a groove"],
)
def test_random_drops_on_what_turns_end_outside(folder, shape, seed, points):
    """At 1 to 10 ms, turned about any axis at up to 10 rad/s and shaken: no point is inside after any step."""
    text = 'shape = "half-space"\npoint = [0, 0, -0.005]\nnormal = [0, 0, 1]\n' if shape == "plane" else shape
    free = FREE.replace("[effects.contact", f'[effects.contact]\npoints = "{points}"\n[effects.contact')
    rom = rom_of(folder, f"{free}{text}motion = {{}}")
    rng, touched = np.random.default_rng(seed), 0
    away = fr.BaseState(np.array([0, 0, -1.0]), np.array([1.0, 0, 0, 0]), NOTHING, NOTHING)
    body = fr.Simulator(rom, 1e-3, signals={"thing": away})
    thing = rom.environment.obstacles["thing"].shape
    for _ in range(3):
        axis, rate, amplitude = rng.normal(size=3), rng.uniform(1, 10), rng.uniform(0, 0.01, 3)
        turns = spin(NOTHING, axis / np.linalg.norm(axis), rate, ramp=0.1)

        def motion(time, turns=turns, amplitude=amplitude):
            return turns(time)._replace(
                position=amplitude * (1 - np.cos(20 * time)), velocity=20 * amplitude * np.sin(20 * time)
            )

        body.dt = float(10.0 ** rng.uniform(-3, -2))
        body.set_signal("thing", motion)
        body.begin_anew()
        attitude = rng.normal(size=4)
        place = np.array([*rng.uniform(-0.02, 0.02, 2), 0.045])
        body.place(fr.BaseState(place, attitude / np.linalg.norm(attitude), NOTHING, rng.normal(size=3)))
        start = body.energy
        for _ in range(int(0.3 / body.dt)):
            body.step()
            touched += body.integrator.contact is not None
            there = body.environment.state.offsets[0]
            assert distance_from(thing, rom.nodes + body.displacement(), there)[0].min() > -1e-11
        check_account(body, start)
    assert touched > 20


def test_a_cam_strikes_alike_reduced_and_at_full_order(struck):
    """With all modes; both accounts close with the work of the cam, most of which goes into the cube's contact."""
    runs = [fr.simulate(model) for model in struck]
    for run in runs:
        assert run.balance_error < CLOSES_TO
        assert run.contact_account["obstacles"][-1] > 0
        turned = run.obstacle_motion["thing"]
        assert turned.shape == (40, 7)
        gaps = [
            distance_from(run.obstacles["thing"], run.nodes + shape, there)[0].min()
            for shape, there in zip(run.snapshots, turned, strict=True)
        ]
        assert min(gaps) > -1e-11
    (full, reduced), scale = runs, np.abs(runs[0].outputs["top"]).max()
    assert scale > 1e-4
    np.testing.assert_allclose(reduced.outputs["top"], full.outputs["top"], atol=1e-6 * scale)
    work = full.contact_account["obstacles"]
    np.testing.assert_allclose(reduced.contact_account["obstacles"], work, atol=1e-6 * work.max())


@pytest.mark.parametrize("without", ["inertia", "rigidity"])
def test_springs_and_equilibria_keep_their_account(folder, without):
    """The same cam, against springs at all points, or a cube without inertia."""
    text = f'{HELD}{CAM}motion = {{ table = "spin.csv", origin = [0.04, 0.01, 0.01] }}'
    if without == "inertia":
        text = text.replace("inertia = {}\ndamping = { alpha = 0.0, beta = 1e-3 }\n", "")
    else:
        law = '[effects.contact]\nmethod = "penalty"\nstiffness = 2e3\n'
        text = text.replace("[effects.contact.obstacles", f"{law}[effects.contact.obstacles")
    body = fr.Simulator(rom_of(folder, text, order=12), 2e-3)
    touched = 0
    for _ in range(200):
        body.step()
        touched += body.integrator.contact is not None
    assert touched > 10
    assert body.ledger.obstacles > 0
    check_account(body)


def test_batches_copies_and_rollouts_are_the_same_steps(struck):
    rom = struck[1]
    single, bodies = fr.Simulator(rom, 2e-3), fr.Batch(rom, 2, 2e-3)
    assert bodies.stepping == "compiled" if compiled() else "an obstacle that turns" in bodies.stepping
    u, rolled = np.zeros((120, single.inputs)), fr.Simulator(rom, 2e-3)
    for k in range(120):
        single.step(u[k])
        bodies.step(u[:2])
        if k == 50:
            saved, twin, thawed = single.save(), copy.copy(single), pickle.loads(pickle.dumps(single))
    assert single.integrator.contact is not None
    shape = single.displacement("top")
    for read in (bodies.displacement("top")[1], rolled.rollout(u)["top"][-1]):
        np.testing.assert_allclose(read, shape, rtol=0, atol=1e-13 * np.abs(shape).max())
    single.restore(saved)
    for body in (single, twin, thawed):
        for k in range(51, 120):
            body.step(u[k])
        np.testing.assert_array_equal(body.displacement("top"), shape)


def test_motions_travel_with_scenes_models_and_runs(struck, tmp_path):
    system, rom = struck
    scene = system.scene
    again = parse_scene(scene.text, tables=scene.tables)
    fr.write_rom(tmp_path / "cube.h5", rom)
    run = fr.simulate(fr.read_rom(tmp_path / "cube.h5"))
    fr.write_trajectory(tmp_path / "run.h5", run)
    read = fr.read_trajectory(tmp_path / "run.h5")
    np.testing.assert_array_equal(read.obstacle_motion["thing"], run.obstacle_motion["thing"])
    for environment in (again.environment, fr.read_rom(tmp_path / "cube.h5").environment):
        motion, known = environment.obstacles["thing"].motion, scene.environment.obstacles["thing"].motion
        assert motion.origin == known.origin == (0.04, 0.01, 0.01)
        np.testing.assert_array_equal(motion.path.rotations, known.path.rotations)


def test_what_jumps_is_told(free):
    """By a function whose poses do not fit its twists, or that turns too far in a step."""
    still = spin(AXIS, [0, 0, 1], 0.0)
    body = fr.Simulator(
        free, 1e-3, signals={"thing": lambda t: still(t)._replace(position=AXIS - [0, 0, 0.01 * (t > 0.01)])}
    )
    for _ in range(20):
        body.step()
    assert any("obstacle 'thing': in a step it went 0.01 m and turned 0 rad" in told for told in body.warnings)
    turned = still(0.0)._replace(rotation=quaternion_of_vector([0.0, 0.0, 3.0]))
    body.set_signal("thing", turned)
    with pytest.raises(StepError, match="an obstacle is told to turn by 3 rad in a step"):
        body.step()


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ('motion = { table = "spin.csv" }\ntable = "spin.csv"', "obstacles.thing: give table or motion, not both"),
        ('motion = { tabel = "spin.csv" }', "obstacles.thing.motion: no key 'tabel'"),
        ('motion = { table = "jump.csv" }', "motion.table: the base turns by 3 rad from 0 s to 1 s"),
        ('motion = { table = "stop.csv" }\n[run]\ndt = 1e-3\nduration = 2.0', "motion.table: the base jumps at 1 s"),
        ('motion = { table = "none.csv" }', "none.csv"),
        ("motion = { origin = [0, 0] }", "motion.origin"),
    ],
)
def test_scenes_refuse_motions_that_are_none(folder, given, says):
    turned = [fr.BaseState(NOTHING, quaternion_of_vector([0, 0, a]), NOTHING, NOTHING) for a in (0.0, 3.0)]
    jump = fr.BasePath(np.array([0.0, 1.0]), *(np.array(part) for part in zip(*turned, strict=True)))
    (folder / "jump.csv").write_text(csv_of(jump))
    (folder / "stop.csv").write_text(csv_of(path_of(spin(NOTHING, [0, 0, 1], 2.0), 1.0)))
    with pytest.raises(SceneError, match=says):
        parse_scene(f"{FREE}{TABLE}{given}", folder=folder)


def test_signals_of_the_wrong_kind_are_refused(free, folder):
    with pytest.raises(SceneError, match="'thing' has no table; give a function of time"):
        fr.Simulator(free, 1e-3)
    with pytest.raises(StepError, match=r"thing = .*use a BaseState"):
        fr.Simulator(free, 1e-3, signals={"thing": np.zeros(3)})
    shifted = rom_of(folder, FREE + TABLE)
    with pytest.raises(StepError, match="thing: poses are given, but the scene gives this obstacle no motion"):
        fr.Simulator(shifted, 1e-3, signals={"thing": spin(AXIS, [0, 0, 1], 1.0)(0.0)})
