"""Meshes that stand still or are driven, among rigid and soft bodies of a world."""

import numpy as np
import pytest
from bodies import acted_on
from landing_box import BODY, FLOOR, PARTS, landing_mesh
from triangle_meshes import groove, plate, room, write_stl

import fenics_rom as fr
from fenics_rom.errors import SceneError
from fenics_rom.scene.file import parse_scene
from fenics_rom.world.shapes import Box, HalfSpace, Mesh, Sphere

G = 9.81  # m/s²


def mesh_of(obstacle):
    return Mesh(obstacle.vertices, obstacle.triangles, bool(obstacle.open))


def world_of(ground, shape, dt=2e-3, friction=0.4, motion=None, **where):
    bodies = {"ground": fr.RigidBody(ground, motion=motion), "it": fr.RigidBody(shape, mass=0.5, **where)}
    return fr.World(bodies, dt, gravity=(0, 0, -G), friction=friction)


def check_account(world):
    ledger, energy = world.ledger, world.energy
    scale = max(abs(ledger.supplied), abs(ledger.dissipated), energy)
    assert abs(energy - (ledger.supplied - ledger.dissipated)) <= 1e-12 * scale


def test_a_ball_lies_in_a_groove_on_both_its_sides():
    world = world_of(mesh_of(groove(0.5)), Sphere(0.02), position=(0.01, 0.0, 0.05))
    for _ in range(400):
        world.step()
    np.testing.assert_allclose(world.pose("it").position[[0, 2]], (0.0, 0.02 * np.sqrt(1.25)), atol=1e-9)
    np.testing.assert_allclose(world.force_between("it", "ground"), (0, 0, 0.5 * G), atol=1e-6)


def test_a_box_on_triangles_lies_as_on_a_half_space():
    """And slides as far, over several of them."""
    vertices, triangles = plate(12)
    ends = []
    for ground in (Mesh(vertices, triangles, True), HalfSpace()):
        world = world_of(ground, Box((0.06, 0.04, 0.02)), position=(-0.1, 0.01, 0.011), velocity=(0.9, 0.1, 0.0))
        for _ in range(150):
            world.step()
        ends.append(world.pose("it"))
    np.testing.assert_allclose(ends[0].position, ends[1].position, atol=1e-9)
    np.testing.assert_allclose(ends[0].rotation, ends[1].rotation, atol=1e-9)
    assert ends[0].position[0] > -0.1 + 2 * 0.4 / 12


def test_a_ball_that_rolls_into_a_corner_stops_at_its_walls():
    world = world_of(
        mesh_of(room()), Sphere(0.03), friction=0.0, position=(0.1, 0.08, 0.03), velocity=(-1.0, -0.8, 0.0)
    )
    for _ in range(150):
        world.step()
    np.testing.assert_allclose(world.pose("it").position, 0.03, atol=1e-9)


def test_a_mesh_that_turns_carries_what_lies_in_it():
    """A groove turned about its bottom line, by 0.2 rad in a second: the ball rolls, and comes with it."""

    def motion(t):
        half = 0.1 * t
        rotation = np.array([np.cos(half), 0.0, np.sin(half), 0.0])
        return fr.BaseState(np.zeros(3), rotation, np.zeros(3), np.array([0.0, 0.2, 0.0]))

    lift = 0.02 * np.sqrt(1.25)
    world = world_of(mesh_of(groove(0.5)), Sphere(0.02), 5e-3, motion=motion, position=(0.0, 0.0, lift))
    for _ in range(200):
        world.step()
    expected = lift * np.array([np.sin(0.2), 0.0, np.cos(0.2)])
    np.testing.assert_allclose(world.pose("it").position, expected, atol=1e-5)


def test_a_soft_block_falls_into_a_groove(tmp_path):
    scene = acted_on(landing_mesh(tmp_path), BODY + "[effects.contact]\n" + FLOOR, **PARTS)
    rom = fr.reduce(fr.assemble(parse_scene('frame = "moving"\n' + scene.text)), order=8)
    ground = groove(0.3)
    block = fr.SoftBody(rom, position=(0.02, 0.0, 0.11))
    world = fr.World({"ground": fr.RigidBody(mesh_of(ground)), "block": block}, 2e-3, friction=0.3)
    for _ in range(150):
        world.step()
        gaps, _ = ground.distance(world.simulator("block").places())
        assert gaps.min() > -1e-6, "planes are those of the middle of a step, as it is expected"
    check_account(world)
    assert np.linalg.norm(world.force_between("block", "ground")) > 1.0


def test_a_mesh_has_no_mass():
    ground = mesh_of(groove())
    with pytest.raises(SceneError, match="mesh: has no mass; use one that is held"):
        fr.World({"ground": fr.RigidBody(ground, density=100.0)}, 1e-3)


WORLD = """
gravity = [0, 0, -9.81]
[bodies.vee]
shape = "mesh"
file = "vee.stl"
scale = 1e-3
[bodies.ball]
shape = "sphere"
radius = 0.01
density = 500
position = [0.0, 0.0, 0.1]
[run]
dt = 2e-3
duration = 0.02
"""


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (WORLD.replace("vee.stl", "no.stl"), "bodies.vee.file: surface .*no.stl: cannot be read: No such file"),
        (WORLD.replace('file = "vee.stl"\n', ""), "bodies.vee.file: is missing; dimensions of a mesh: file"),
        (WORLD.replace("scale = 1e-3", "scale = 1e-3\nmass = 1.0"), "bodies.vee.mass: means nothing of a mesh"),
        (WORLD.replace("density", "open = true\ndensity"), "bodies.ball.open: a sphere has none; give it to a mesh"),
    ],
)
def test_a_world_file_names_a_mesh(tmp_path, text, says):
    write_stl(tmp_path / "vee.stl", groove(0.5), 1000.0)
    (tmp_path / "good.toml").write_text(WORLD)
    world = fr.make_world(fr.read_world(tmp_path / "good.toml"))
    world.step()
    (tmp_path / "bad.toml").write_text(text)
    with pytest.raises(SceneError, match=says):
        fr.make_world(fr.read_world(tmp_path / "bad.toml"))
