"""Bodies that go by more than they are thick in a step do not pass one another; steps that are cut are told."""

import numpy as np
import pytest
from bodies import box_arrays, scene_text, write_arrays
from forks import CLAMPED, GAP, LONG, cleft, facing, fork_scene

import fenics_rom as fr
from fenics_rom.compilation import numpy_alone
from fenics_rom.mechanics.frame_motion import quaternion_of_vector, rotation_matrix
from fenics_rom.scene.file import parse_scene
from fenics_rom.world import fast_motion
from fenics_rom.world.shapes import Box, Capsule, HalfSpace, Sphere

DT, SPEED, PLATE = 1e-2, 50.0, (0.4, 0.4, 1e-3)  # s, m/s, m: half a metre in a step, 500 times as much as the plate
CLOSES_TO = 1e-12
SHAPES = {"ball": Sphere(0.01), "box": Box((0.02, 0.02, 0.02)), "rod": Capsule(0.01, 0.02)}
CUT = "steps were cut"
SKIPPED = {"up": 1, "low": -1}  # sides of soft bodies that face away from the other one


def resting(position=(0.0, 0.0, 0.0)):
    """A pose that is still."""
    return fr.BaseState(np.array(position), np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(3))


def thrown(shape, height, plate, speed=SPEED, dt=DT):
    """A world in which something is thrown down on a plate, from above or below it."""
    side = np.sign(height)
    body = fr.RigidBody(shape, mass=0.01, position=(0.0, 0.0, height), velocity=(0.0, 0.0, -side * speed))
    return fr.World({"plate": plate, "body": body}, dt=dt, friction=0.3)


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("is_driven", [True, False])
@pytest.mark.parametrize("shape", SHAPES)
def test_what_is_thrown_at_a_plate_does_not_pass_it(shape, is_driven, side):
    """Momentum and energy of a free plate and what hits it stay, but for what the impact takes."""
    for height in np.random.default_rng(0).uniform(0.05, 2.0, 6):
        plate = fr.RigidBody(Box(PLATE), **({"motion": resting()} if is_driven else {"mass": 1.0}))
        world = thrown(SHAPES[shape], side * height, plate)
        begun = world.energy
        for _ in range(8):
            world.step()
            apart = world.pose("body").position[2] - world.pose("plate").position[2]
            assert side * apart > 0.01
            assert abs(world.energy - begun + world.ledger.dissipated) < CLOSES_TO * begun
            assert world.ledger.dissipated > -CLOSES_TO * begun
            if not is_driven:
                momentum = sum(m * world.pose(name).velocity for name, m in (("body", 0.01), ("plate", 1.0)))
                np.testing.assert_allclose(momentum, [0, 0, -side * 0.01 * SPEED], atol=1e-12 * SPEED)
        assert world.steps == 8
        assert world.time == pytest.approx(8 * DT, rel=1e-14)
        assert world.dt == DT
        (told,) = (text for text in world.warnings if CUT in text)
        assert 0.25e-3 / SPEED < float(told.split()[-2]) < 0.02 / SPEED


def test_a_thin_blade_that_turns_hits_a_ball():
    """It turns by 0.8 rad in a step: at 0.15 m from its axis it goes by 6 times what both are thick."""

    def motion(time):
        return fr.BaseState(
            np.zeros(3), quaternion_of_vector(np.array([0, 80.0 * time, 0])), np.zeros(3), np.array([0, 80.0, 0])
        )

    for angle in np.linspace(0.3, 2.8, 6):
        where = 0.15 * np.array([-np.cos(angle), 0.0, np.sin(angle)])
        bodies = {
            "blade": fr.RigidBody(Box((0.4, 0.1, 1e-3)), motion=motion),
            "ball": fr.RigidBody(Sphere(0.01), mass=0.01, position=tuple(where)),
        }
        world = fr.World(bodies, dt=DT)
        for _ in range(5):
            world.step()
            if np.linalg.norm(world.pose("ball").velocity) > 0:
                break
        speed = np.linalg.norm(world.pose("ball").velocity)
        assert speed > 0.9 * 80 * 0.15
        assert any(CUT in text for text in world.warnings)


def test_what_is_not_fast_is_not_cut(monkeypatch):
    """It moves as if nobody looked, to the bit; nor is what meets only what has no thickness to go through."""

    def moved(shapes, steps=60):
        bodies = {"ground": fr.RigidBody(HalfSpace(), motion=resting())}
        for k, shape in enumerate(shapes):
            place = (0.005 * k, 0.0, 0.03 + 0.05 * k)
            bodies[f"b{k}"] = fr.RigidBody(shape, mass=0.1, position=place, angular_velocity=(1.0, 2.0, 0.0))
        world = fr.World(bodies, dt=2e-3, gravity=(0, 0, -9.81), friction=0.4)
        for _ in range(steps):
            world.step()
        assert not any(CUT in text for text in world.warnings)
        return np.concatenate([np.concatenate(world.pose(name)) for name in bodies])

    looked = moved(SHAPES.values())
    monkeypatch.setattr(fast_motion.CutWorld, "_advance", lambda world, inputs, most: world._take_steps(inputs, most))
    np.testing.assert_array_equal(moved(SHAPES.values()), looked)
    monkeypatch.undo()
    bodies = {"ground": fr.RigidBody(HalfSpace(), motion=resting())}
    bodies["ball"] = fr.RigidBody(Sphere(0.01), mass=1.0, position=(0, 0, 1.0), velocity=(0, 0, -50))
    world = fr.World(bodies, DT)
    world.step()
    assert not world._fast


def test_many_steps_in_a_call_are_those_one_by_one():
    worlds = [thrown(SHAPES["ball"], 1.3, fr.RigidBody(Box(PLATE), mass=1.0)) for _ in range(2)]
    worlds[0].step(count=12)
    for _ in range(12):
        worlds[1].step()
    for name in ("body", "plate"):
        for one, other in zip(worlds[0].pose(name), worlds[1].pose(name), strict=True):
            np.testing.assert_array_equal(one, other)
    assert worlds[0].warnings == worlds[1].warnings


@pytest.fixture(scope="module")
def soft(tmp_path_factory):
    """A cube of 10 mm, and a sheet of 1 mm, that are free."""
    folder, roms = tmp_path_factory.mktemp("soft"), {}
    parts = {
        "supports": None,
        "damping": "alpha = 0.0, beta = 1e-4",
        "material": "young = 1e6\npoisson = 0.3\ndensity = 1000.0",
        "contacts": "[contacts.skin]\nnear = { point = [0, 0, 0], radius = 1.0 }",
        "effects.contact": 'obstacles.far = { shape = "half-space", point = [0, 0, -9], normal = [0, 0, 1] }',
    }
    for name, lengths, bricks in (("cube", (0.01, 0.01, 0.01), (2, 2, 2)), ("sheet", (0.04, 0.04, 1e-3), (4, 4, 1))):
        points, cells = box_arrays(lengths, bricks)
        mesh = write_arrays(folder / f"{name}.msh", points - np.array(lengths) / 2, cells)
        system = fr.assemble(parse_scene('frame = "moving"\n' + scene_text(mesh, **parts)))
        roms[name] = fr.reduce(system, order=8)
    return roms


def flung(soft, low, speed=10.0):
    """A soft body above another one, or a plate, that come together by 40 mm in a step of 2 ms."""
    bodies = {
        "plate": lambda: fr.RigidBody(Box((0.1, 0.1, 1e-3)), mass=1.0, velocity=(0.0, 0.0, speed)),
        "still": lambda: fr.RigidBody(Box((0.1, 0.1, 1e-3)), motion=resting()),
        "sheet": lambda: fr.SoftBody(soft["sheet"], velocity=(0.0, 0.0, speed)),
    }
    up = "sheet" if low == "sheet" else "cube"
    above = fr.SoftBody(soft[up], position=(0.003, 0.002, 0.012), velocity=(0.0, 0.0, -speed))
    with numpy_alone():
        return fr.World({"low": bodies[low](), "up": above}, dt=2e-3, friction=0.3)


@pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
@pytest.mark.parametrize("low", ["plate", "still", "sheet"])
def test_a_soft_body_that_is_flung_at_what_is_thin_does_not_pass_it(soft, low):
    """Two sheets had gone through one another by 28 mm in the first step, and the cube half into the plate."""
    world = flung(soft, low)
    begun = world.energy
    momentum = 0.0 if low == "still" else _momentum(world)
    for _ in range(2):
        world.step()
        turned = rotation_matrix(world.pose("low").rotation)  # also as sheets lean
        up, below = (_places(world, name).dot(turned) for name in ("up", "low"))
        apart = up[:, 2] - (below[:, 2] if low == "sheet" else below[:, 2].max())
        assert apart.min() > (-1e-3 if low == "sheet" else -5e-5)  # of sheets 3.6 mm aside, as these bend
        assert up[:, 2].mean() - below[:, 2].mean() > 1e-3
        assert abs(world.energy - begun + world.ledger.dissipated) < CLOSES_TO * begun
        assert world.ledger.dissipated > -CLOSES_TO * begun
        if low != "still":
            np.testing.assert_allclose(_momentum(world), momentum, rtol=0, atol=1e-12)
    assert sum(CUT in text for text in world.warnings) == 1


def _places(world, name):
    """Of what of a body is seen, (any, 3), m."""
    if isinstance(world.bodies[name], fr.SoftBody):
        return world.simulator(name).node_places()[np.sign(world.bodies[name].rom.nodes[:, 2]) != SKIPPED[name]]
    return world.pose(name).position + np.array([[0.0, 0.0, z] for z in (-5e-4, 5e-4)])


def _momentum(world):
    """Of both bodies, kg m/s."""
    whole = np.zeros(3)
    for name, body in world.bodies.items():
        mass = 1.0 if isinstance(body, fr.RigidBody) else body.rom.moving_frame.mass
        whole += mass * world.pose(name).velocity
    return whole


@pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
def test_prongs_that_are_flung_at_one_another_stay_apart(tmp_path):
    """Of one body, by up to 100 mm in a step: they had gone through one another by 88 mm, and came back."""
    system = fr.assemble(fork_scene(tmp_path, cleft((6, 1, 3), 1), **CLAMPED))
    rom = fr.reduce(system, order=12)
    x, ball = rom.nodes, fr.RigidBody(Sphere(0.01), position=(0.0, 0.0, 1.0))
    with numpy_alone():
        world = fr.World({"fork": fr.SoftBody(rom), "ball": ball}, 1e-2, friction=0.4)
    fork, to_tip = world.simulator("fork"), x[:, :1] / LONG
    fork.set_shape(np.zeros_like(x), -5.0 * to_tip * np.sign(x) * [0.0, 0.0, 1.0])
    begun, (lower, upper) = world.energy, facing(x)
    for _ in range(6):
        world.step()
        z = (x + fork.displacement())[:, 2]
        assert (z[upper] - z[lower]).min() > -1e-3 * GAP
        assert abs(world.energy - begun + world.ledger.dissipated) < CLOSES_TO * begun
    assert sum(CUT in text for text in world.warnings) == 1
