"""Surfaces of soft bodies that joints hold: welded ones against dense algebra, and what may go wrong."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from bodies import box_arrays, dense, scene_text, write_arrays
from test_soft_motion import CLAMPED, TOUCHED, assembled_beam, momenta, reduced, ride

import fenics_rom as fr
from fenics_rom.errors import SceneError
from fenics_rom.mechanics.frame_geometry import crossed
from fenics_rom.mechanics.frame_motion import cayley, rotation_matrix
from fenics_rom.mechanics.triangles import nearest_on_triangles
from fenics_rom.trajectory.elastic_part import deformation
from fenics_rom.world.joints import Joint, SurfaceJoint
from fenics_rom.world.shapes import Box
from fenics_rom.world.surfaces import area_shares, carried

LENGTHS = np.array((0.3, 0.03, 0.02))
WRENCH = '[contacts.right]\nsurface = "right"\nforce = "wrench"\n[contacts.top]\nsurface = "top"'
RIGID = {"supports": 'clamped = ["left"]\nrigid = ["right"]', "contacts": WRENCH}
TIP = LENGTHS * (1, 0.5, 0.5)
SIZE = np.array((0.06, 0.05, 0.04))


@pytest.fixture(scope="module")
def stiff(tmp_path_factory):
    """A held beam whose end is rigid: at full order, and reduced in all modes."""
    system = assembled_beam(tmp_path_factory.mktemp("stiff"), frame="fixed", **RIGID, **TOUCHED)
    return system, fr.reduce(system, order=system.elastic_size, method="modal")


def block(**given):
    return fr.RigidBody(Box(tuple(SIZE)), density=500, position=TIP + np.array((SIZE[0] / 2, 0.004, 0.003)), **given)


def glued_mass(system):
    """M of the mesh with the mass of the block, and that of the block at the surface (6, 6)."""
    mass, inertia = block().mass_and_inertia()
    A = crossed((block().position - TIP)[None])[0]  # velocities of the block's centre where the surface turns
    glued = np.block([[mass * np.eye(3), mass * A], [mass * A.T, inertia + mass * A.T @ A]])
    B = system.contacts["right"]
    return dense(system.mass, system.size) + B @ glued @ B.T, glued


@pytest.mark.parametrize("dt", [1e-3, 5e-3])
def test_a_box_that_is_welded_to_a_rigid_surface_is_a_mass_that_is_glued_to_the_mesh(stiff, dt):
    """All displacements of the mesh under a force on the box, but for what turning changes: as its square."""
    system, rom = stiff
    a, B = block().position - TIP, system.contacts["right"]
    D, K = (dense(part, system.size) for part in (system.damping, system.stiffness))
    M, _ = glued_mass(system)
    force = np.array((0.3, -0.5, 1.0))
    errors = []
    for scale in (1e-5, 1e-4):
        world = fr.World({"beam": fr.SoftBody(rom), "box": block()}, dt, joints=[SurfaceJoint("beam", "box", "right")])
        f = B @ np.concatenate([scale * force, np.cross(a, scale * force)])
        x, v = np.zeros(system.size), np.zeros(system.size)
        step = np.linalg.inv(2 / dt * M + D + dt / 2 * K)
        worst = 0.0
        for _ in range(40):
            world.step({"box": {"force": scale * force}})
            middle = step @ (f + 2 / dt * M @ v - K @ x)
            x, v = x + dt * middle, 2 * middle - v
            exact = system.body.unknowns.expand(x).reshape(-1, 3)
            worst = max(worst, np.abs(world.simulator("beam").displacement() - exact).max() / np.abs(exact).max())
            moved = world.pose("box").position - block().position
            turn = 2 * world.pose("box").rotation[1:]
            np.testing.assert_allclose(moved, (B.T @ x)[:3] + np.cross((B.T @ x)[3:], a), rtol=0, atol=3e-3 * scale)
            np.testing.assert_allclose(turn, (B.T @ x)[3:], rtol=0, atol=1e-2 * scale)
        errors.append(worst)
    assert errors[1] < 1e-5
    assert errors[1] == pytest.approx(10 * errors[0], rel=1e-2)  # by 5e-5 of it: nothing else is left


def test_a_box_that_comes_with_a_velocity_hands_it_on(stiff):
    """By the impulse of a mass that is glued to the mesh; between two steps both ends of a weld move alike."""
    system, rom = stiff
    M, glued = glued_mass(system)
    v, B = np.array((0.1, -0.2, 0.3)), system.contacts["right"]
    a = block().position - TIP
    mesh = np.linalg.solve(M, B @ glued @ np.concatenate([v, np.zeros(3)]))
    world = fr.World(
        {"beam": fr.SoftBody(rom), "box": block(velocity=v)}, 1e-3, joints=[SurfaceJoint("beam", "box", "right")]
    )
    then, mass = B.T @ mesh, block().mass_and_inertia()[0]
    velocity, turning = world.velocity("box")
    np.testing.assert_allclose(turning, then[3:], rtol=0, atol=1e-9 * np.abs(then).max())
    np.testing.assert_allclose(velocity, then[:3] + np.cross(then[3:], a), rtol=0, atol=1e-9 * np.abs(v).max())
    lost = mass * v @ v / 2 - mesh @ M @ mesh / 2
    assert world.ledger.dissipated == pytest.approx(lost, rel=1e-9)
    face = np.flatnonzero(rom.nodes[:, 0] > LENGTHS[0] - 1e-9)
    for _ in range(20):
        world.step()
        nodes = world.simulator("beam").velocity()[face]
        velocity, turning = world.velocity("box")
        on_box = velocity + np.cross(turning, rotation_matrix(world.pose("box").rotation) @ (TIP - block().position))
        np.testing.assert_allclose(nodes.mean(axis=0), on_box, rtol=0, atol=1e-12)
    assert world.energy + world.ledger.dissipated == pytest.approx(mass * v @ v / 2, rel=1e-12)


def test_a_welded_box_stays_on_a_rigid_surface_that_goes_round_in_circles(stiff):
    """By 0.2 rad each way: to round-off at its place, and turned as the surface is but for the cube of that."""
    world = fr.World(
        {"beam": fr.SoftBody(stiff[1]), "box": block()}, 2e-3, joints=[SurfaceJoint("beam", "box", "right")]
    )
    beam, face = world.simulator("beam"), np.flatnonzero(stiff[1].nodes[:, 0] > LENGTHS[0] - 1e-9)
    arms, turned, gap, supplied = stiff[1].nodes[face] - TIP, 0.0, 0.0, 0.0
    for step in range(300):
        phase = 2 * np.pi * 1.5 * (step + 0.5) * world.dt
        world.step({"box": {"force": 0.2 * np.array((0, np.cos(phase), np.sin(phase)))}})
        gone = world.ledger
        gap = max(gap, abs(world.energy - gone.supplied + gone.dissipated + gone.numerical + gone.lost_in_switching))
        supplied = max(supplied, gone.supplied)
        moved = beam.displacement()[face].ravel()
        motions = np.concatenate([np.broadcast_to(np.eye(3), (len(arms), 3, 3)), crossed(arms)], axis=2)
        motion = np.linalg.lstsq(motions.reshape(-1, 6), moved, rcond=None)[0]
        turned = max(turned, np.linalg.norm(motion[3:]))
        pose = world.pose("box")
        R = rotation_matrix(pose.rotation)
        np.testing.assert_allclose(pose.position + R @ (TIP - block().position), TIP + motion[:3], rtol=0, atol=1e-11)
        off = cayley(motion[3:]).T @ R
        assert np.abs(off - off.T).max() < 0.01
    assert 0.15 < turned < 0.25
    assert gap < 1e-12 * supplied
    assert world.sweeps <= 4
    np.testing.assert_array_equal(world.force_between("beam", "box"), world.joint_forces(0)[0])
    assert np.abs(world.joint_forces(0)[1]).max() > 1e-4


@pytest.fixture(scope="module")
def soft(tmp_path_factory):
    return reduced(tmp_path_factory.mktemp("soft"), frame="moving", **TOUCHED)


def test_the_surface_of_a_beam_that_flies_is_welded_by_its_name(soft):
    """As by a joint of its points, to the last bit."""
    places = soft.nodes - soft.moving_frame.origin
    face = places[places[:, 0] > places[:, 0].max() - 1e-9]
    box = fr.RigidBody(Box((0.06,) * 3), density=500, position=(face[0, 0] + 0.03, 0, 0), angular_velocity=(0, 2, 1))
    poses = []
    for joint in (SurfaceJoint("beam", "box", "right"), Joint("beam", "box", tuple(map(tuple, face.tolist())))):
        world = fr.World({"beam": fr.SoftBody(soft), "box": box}, 2e-3, joints=[joint])
        ride(world, 20)
        poses.append(np.concatenate(world.pose("box")))
    np.testing.assert_array_equal(*poses)


@pytest.mark.parametrize("kind", ["ball", "hinge"])
def test_a_box_swings_on_the_surface_of_a_beam(tmp_path, kind):
    """What is held is the mean place of the surface, or a line in it; nothing else holds the box, and all is kept."""
    rom = reduced(tmp_path, frame="fixed", **CLAMPED, **TOUCHED)
    axis = (0.0, 1.0, 0.0) if kind == "hinge" else None
    box = fr.RigidBody(Box(tuple(SIZE)), density=500, position=TIP + np.array((0.03, 0, -0.01)))
    joint = SurfaceJoint("beam", "box", "right", kind, axis)
    world = fr.World({"beam": fr.SoftBody(rom), "box": box}, 1e-3, gravity=(0, 0, -9.81), joints=[joint])
    beam, face = world.simulator("beam"), np.flatnonzero(rom.nodes[:, 0] > LENGTHS[0] - 1e-9)
    gap, _ = ride(world, 150)
    assert gap < 1e-13
    pose, ends = world.pose("box"), beam.places()[np.searchsorted(beam.contact_points, face)]
    R, corners = rotation_matrix(pose.rotation), rom.nodes[face]
    assert np.abs(2 * pose.rotation[2]) > 0.3  # it has fallen, about y
    among = np.array([np.searchsorted(face, triangle) for triangle in rom.triangles if np.isin(triangle, face).all()])
    shares = area_shares(corners, among)
    np.testing.assert_allclose(shares @ corners, TIP, rtol=0, atol=1e-15)
    for at in ((0, 0, 0),) if kind == "ball" else ((0, 0.015, 0), (0, -0.015, 0)):
        weights, off = carried(corners, shares, TIP + at)
        assert off < 1e-15
        on_box = pose.position + R @ (TIP + at - box.position)
        np.testing.assert_allclose(weights @ ends, on_box, rtol=0, atol=1e-12)


@pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
def test_a_box_is_welded_to_a_beam_that_an_arm_swings(tmp_path):
    """It strikes a wall; the account closes, both ends of the weld move alike, and its force does not alternate."""
    rom = reduced(tmp_path, frame="moving", **CLAMPED, **TOUCHED)

    def swung(time):
        angle, rate = 0.3 * np.sin(6 * time), 1.8 * np.cos(6 * time)
        turned = np.array((np.cos(angle / 2), 0, np.sin(angle / 2), 0))
        return fr.BaseState(np.array((0, 0, 0.05 * time)), turned, np.array((0, 0, 0.05)), np.array((0, rate, 0)))

    lies = fr.BaseState(np.array((0.4, 0, -0.08)), np.array((1.0, 0, 0, 0)), np.zeros(3), np.zeros(3))
    bodies = {
        "arm": fr.RigidBody(Box((1e-3,) * 3), motion=swung),
        "beam": fr.SoftBody(rom, on="arm"),
        "box": fr.RigidBody(Box((0.06,) * 3), density=300, position=(0.33, 0, 0)),
        "wall": fr.RigidBody(Box((0.1, 0.3, 0.02)), motion=lies),
    }
    joints, apart = [SurfaceJoint("beam", "box", "right")], [("arm", "beam", "box")]
    world = fr.World(bodies, 1e-3, gravity=(0, 0, -9.81), friction=0.4, joints=joints, apart=apart)
    start, touched, forces = world.energy - world.ledger.supplied + world.ledger.dissipated, 0, []
    for _ in range(250):
        world.step()
        gone = world.ledger
        left = world.energy - start - gone.supplied + gone.dissipated + gone.numerical + gone.lost_in_switching
        assert abs(left) < 1e-13
        touched = max(touched, world.touching)
        forces.append(world.force_between("beam", "box"))
        beam, pose = world.simulator("beam"), world.pose("box")
    assert touched >= 1
    face = np.searchsorted(beam.contact_points, rom.contact_models["right"].contact_points)
    on_box = pose.velocity + np.cross(pose.angular_velocity, beam.places()[face] - pose.position)
    np.testing.assert_allclose(beam._kernel.basis_velocities[face], on_box, rtol=0, atol=1e-5)  # as 12 modes let it
    jumps = np.abs(np.diff(forces, axis=0)).max(axis=1)
    assert np.median(jumps) < 0.05 * np.abs(forces).max()


def test_the_surface_of_a_beam_goes_where_a_driven_body_takes_it(stiff):
    """Rigid or not; and one that is welded to the world stays."""
    up = np.array((0, 0, 2e-3))
    still = fr.BaseState(TIP + np.array((0.03, 0, 0)), np.array((1.0, 0, 0, 0)), np.zeros(3), np.zeros(3))
    carrier = fr.RigidBody(
        Box((0.06,) * 3), motion=lambda t: still._replace(position=still.position + t * up, velocity=up)
    )
    world = fr.World(
        {"beam": fr.SoftBody(stiff[1]), "arm": carrier}, 1e-3, joints=[SurfaceJoint("beam", "arm", "right")]
    )
    held = fr.World({"beam": fr.SoftBody(stiff[1])}, 1e-3, joints=[SurfaceJoint("beam", "world", "right")])
    for _ in range(30):
        world.step()
        held.step()
    face = stiff[1].nodes[:, 0] > LENGTHS[0] - 1e-9
    moved = world.simulator("beam").displacement()[face]
    np.testing.assert_allclose(moved, np.tile(30e-3 * up, (len(moved), 1)), rtol=0, atol=1e-14)
    assert not held.simulator("beam").displacement().any()


def test_two_beams_that_fly_are_welded_where_their_nodes_do_not_meet(soft):
    """The end of one on the top of the other: its nodes stay on triangles of that, and momenta and the account stay."""
    half = np.sqrt(0.5)
    across = fr.SoftBody(soft, position=(LENGTHS[0] / 2 + LENGTHS[2] / 2, 0, 0), rotation=(half, 0, -half, 0))
    thrown = fr.SoftBody(soft, velocity=(0, 0.1, 0.2), angular_velocity=(0.5, 0, 1))
    bodies = {"a": thrown, "b": across, "box": fr.RigidBody(Box((0.01,) * 3), density=1, position=(9, 0, 0))}
    world = fr.World(bodies, 1e-3, joints=[SurfaceJoint("a", "b", "right")])
    start = momenta(world)
    gap, _ = ride(world, 40)
    assert gap < 1e-13
    for now, then in zip(momenta(world), start, strict=True):
        assert np.abs(now - then).max() < 1e-14
    a, b = world.simulator("a"), world.simulator("b")
    nodes = a.contact_coordinates - soft.moving_frame.origin
    face = nodes[:, 0] > nodes[:, 0].max() - 1e-9
    corners = b.places()[b.contact_triangles]
    for place in a.places()[face]:
        _, there = nearest_on_triangles(np.broadcast_to(place, (len(corners), 3)), corners)
        assert np.linalg.norm(there - place, axis=1).min() < 1e-13
    assert np.linalg.norm(world.force_between("a", "b")) > 1e-3


WORLD = """
gravity = [0, 0, -9.81]
[bodies.beam]
scene = "beam.toml"
[bodies.box]
shape = "box"
size = [0.06, 0.05, 0.04]
density = 500
position = [0.33, 0.015, 0.01]
[[joints]]
kind = "weld"
first = "beam"
surface = "right"
second = "box"
[run]
dt = 2e-3
duration = 0.1
"""


def test_a_world_file_welds_a_surface_by_its_name(tmp_path):
    """Its run has the force of the weld: in the end, after some swings are damped, nearly the weight."""
    mesh = write_arrays(tmp_path / "beam.msh", *box_arrays((0.3, 0.03, 0.02), (6, 1, 1)))
    parts = RIGID | TOUCHED | {"material": "young = 5e7\npoisson = 0.4\ndensity = 1100.0"}
    (tmp_path / "beam.toml").write_text(scene_text(mesh, damping="alpha = 200.0, beta = 1e-3", **parts))
    (tmp_path / "world.toml").write_text(WORLD)
    run = fr.simulate(fr.read_world(tmp_path / "world.toml"))
    assert run.balance_error < 1e-12
    force = run.forces["beam-box"]
    assert not force[0].any()
    assert force[-1, 2] == pytest.approx(-500 * 0.06 * 0.05 * 0.04 * 9.81, rel=0.01)
    beam, strained = run.bodies["beam"].nodes, deformation(run, run.snapshots)
    np.testing.assert_array_equal(strained[:, beam], run.snapshots[:, beam])  # it is held: all that moves strains it
    (tmp_path / "world.toml").write_text(WORLD.replace('"right"', '"left"'))
    with pytest.raises(fr.SceneError, match=r"world.toml: joint of 'beam' and 'box': no contact mode 'left'"):
        fr.simulate(fr.read_world(tmp_path / "world.toml"))


@pytest.mark.parametrize(
    ("joint", "said"),
    [
        (("beam", "box", "rihgt"), "joint of 'beam' and 'box': no contact mode 'rihgt'.*did you mean 'right'"),
        (("box", "beam", "right"), "surface 'right': use one of a soft body, which comes first"),
        (("beam", "box", "right", "hinge", (0, 1, 0)), "surface 'right' is rigid, which no hinge holds"),
        (("beam", "box", "top", "hinge", (0, 0, 1)), "its axis leaves surface 'top', by 0.1"),
        (("beam", "box", "right", "glue"), "no kind of joint 'glue'; there is ball, hinge, weld"),
        (("beam", "box", "right", "hinge"), "a hinge has an axis, and no other joint"),
        (("beam", "box", "right", "hinge", (0, 0, 0)), "use a vector of any length but 0"),
        (("beam", "beam", "right"), "'beam' with itself"),
    ],
)
def test_surface_joints_that_cannot_be_are_refused(stiff, joint, said):
    with pytest.raises(fr.SceneError, match=said):
        fr.World({"beam": fr.SoftBody(stiff[1]), "box": block()}, 1e-3, joints=[SurfaceJoint(*joint)])


def test_a_soft_body_is_mounted_on_a_link_of_a_robot_by_its_file(soft, tmp_path):
    """It goes with the link, which motors turn; the force at the mount is in the account, which closes."""
    pytest.importorskip("mujoco")
    for name in ("arm.urdf", "plate.obj"):
        shutil.copy(Path(__file__).parents[1] / "data" / "robots" / name, tmp_path)
    fr.write_rom(tmp_path / "beam.h5", soft)
    file = tmp_path / "world.toml"
    text = """
        [bodies.arm]
        robot = "arm.urdf"
        motors.all = { kind = "position", gain = 300.0, damping = 20.0 }
        [bodies.beam]
        rom = "beam.h5"
        on = "arm.tool"
        surface = "right"
        position = [0.0, 0.0, 0.2]
        rotation = [0.0, 1.5707963267948966, 0.0]
        [run]
        dt = 2e-3
        duration = 1.0
    """
    file.write_text(text)
    world = fr.make_world(fr.read_world(file))
    start = world.energy
    nodes = np.flatnonzero(soft.nodes[:, 0] > soft.nodes[:, 0].max() - 1e-9)

    def place():
        hand = world.pose("arm.hand")
        return (world.simulator("beam").node_places()[nodes].mean(axis=0) - hand.position) @ rotation_matrix(
            hand.rotation
        )

    begun, beam = place(), world.pose("beam").position
    for _ in range(15):
        world.step({"arm.j2": {"target": 0.3}})
    assert np.abs(world.pose("beam").position - beam).max() > 1e-3
    assert np.abs(place() - begun).max() < 1e-4  # the mean of nodes, where the weld holds areas
    assert np.abs(world.joint_forces("beam.mount")).max() > 0
    ledger = world.ledger
    gap = world.energy - start - ledger.supplied + ledger.dissipated + ledger.numerical
    assert gap == pytest.approx(0, abs=1e-13)
    assert abs(ledger.numerical) < 1e-10 * ledger.supplied
    file.write_text(text.replace("arm.tool", "arm.tol"))
    with pytest.raises(SceneError, match="no link 'tol'"):
        fr.make_world(fr.read_world(file))
