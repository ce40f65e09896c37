"""Compiled steps of worlds with joints are those of NumPy: motion, forces, impulses after steps, accounts."""

from contextlib import nullcontext

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_compiled_world import both, each, told, without
from test_rigid_motion import GROUND
from test_soft_motion import CLAMPED, TOUCHED, momenta, reduced
from test_surface_joints import RIGID as STIFF

import fenics_rom as fr
from fenics_rom.compilation import compiled, jit
from fenics_rom.mechanics.frame_motion import quaternion_of_vector
from fenics_rom.world.compiled import joints as compiled_joints
from fenics_rom.world.drives import Drive, Motor
from fenics_rom.world.joints import SurfaceJoint, ball, hinge, weld
from fenics_rom.world.shapes import Box

pytestmark = [
    pytest.mark.skipif(not compiled(), reason="numba is not installed, or turned off"),
    pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning"),
]
EPS = float(np.finfo(float).eps)
LOOSE = {"supports": 'rigid = ["right"]'}
factor_of, solve_held = map(jit, (compiled_joints.factor_of, compiled_joints.solve_held))


@given(st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=50)
def test_what_is_held_twice_is_left_out_as_by_a_pseudo_inverse(seed):
    """Of matrices M A Mᵀ that are not quite symmetric, with fewer columns than rows."""
    random = np.random.default_rng(seed)
    n, rank = random.integers(1, 12), random.integers(1, 9)
    M, A = random.normal(size=(n, rank)), random.normal(size=(rank, rank))
    matrix = M @ (A @ A.T + np.eye(rank) + 1e-3 * (A - A.T)) @ M.T
    b, x = matrix @ random.normal(size=n), np.empty(n)
    factor = factor_of(matrix.copy(), 1e-9)
    solve_held(factor, b, x)
    values = np.linalg.svd(matrix, compute_uv=False)
    assert factor.rank == min(n, rank)
    expected = np.linalg.pinv(matrix, rcond=1e-9) @ b
    condition = values[0] / values[min(n, rank) - 1]
    np.testing.assert_allclose(x, expected, atol=1e3 * EPS * condition**2 * np.abs(expected).max())


def forces_of(world):
    """Of all joints, N."""
    return np.concatenate([np.empty(0), *(world.joint_forces(name).ravel() for name in world.joints)])


def assert_same(worlds):
    """Motion, forces, accounts, and forces of joints beside the largest."""
    np.testing.assert_allclose(told(worlds[0]), told(worlds[1]), atol=1e-8)
    ours, theirs = map(forces_of, worlds)
    np.testing.assert_allclose(ours, theirs, atol=1e-9 * max(np.abs(theirs).max(initial=0.0), 1e-3))
    assert worlds[0].touching == worlds[1].touching
    ours, theirs = (world.ledger for world in worlds)
    turnover = max(worlds[0].energy, abs(ours.supplied))
    np.testing.assert_allclose(ours.numerical, theirs.numerical, atol=1e-10 * turnover)  # what sweeps leave of u


def swung(time):
    """How an arm swings."""
    angle = np.array([0.0, 0.6 * np.sin(7 * time), 0.0])
    rate = np.array([0.0, 4.2 * np.cos(7 * time), 0.0])
    return fr.BaseState(np.zeros(3), quaternion_of_vector(angle), np.zeros(3), rate)


def links(random, count, fastened):
    """Links with joints of all kinds between neighbours, some of which hold something twice; the first on an arm."""
    kinds = [
        lambda one, other, at: ball(one, other, at),
        lambda one, other, at: hinge(one, other, at, 0.03 * random.normal(size=3)),
        lambda one, other, at: weld(one, other, at, 0.03),
    ]
    bodies, joints = {"arm": fr.RigidBody(Box((0.02, 0.02, 0.02)), motion=swung)} if fastened else {}, []
    for k in range(count):
        given = {"mass": random.uniform(0.02, 0.3), "position": (0.1 * k + 0.05, 0, 0)}
        if not fastened:
            given |= {"velocity": random.normal(size=3), "angular_velocity": random.normal(size=3)}
        bodies[f"link{k}"] = fr.RigidBody(Box((0.08, 0.03, 0.02)), **given)
        if k or fastened:
            before = f"link{k - 1}" if k else "arm"
            joints.append(kinds[random.integers(3)](before, f"link{k}", (0.1 * k, 0, 0)))
    gravity = (0, 0, -9.81) if fastened else (0, 0, 0)
    return fr.World(bodies, 2e-3, joints=joints, gravity=gravity, apart=[list(bodies)])


@pytest.mark.parametrize("seed", range(4))
def test_chains_do_as_with_numpy(seed):
    """Hung from an arm that swings, or flying; either takes over from the other."""
    fastened = seed % 2 == 0
    worlds = both(lambda: links(np.random.default_rng(seed), 5, fastened))
    random, start, begun = np.random.default_rng(seed), worlds[0].energy, worlds[0].ledger
    before = np.empty(0) if fastened else np.concatenate(momenta(worlds[0]))
    for step in range(80):
        with nullcontext() if random.random() < 0.8 else without(worlds[0]):
            worlds[0].step()
        worlds[1].step()
        if step % 10 == 9:
            assert_same(worlds)
    account = worlds[0].ledger
    assert account.dissipated > begun.dissipated  # by impulses
    turnover = max(start, worlds[0].energy, abs(account.supplied))
    gap = worlds[0].energy - start - account.supplied + begun.supplied + account.numerical
    gap += account.dissipated - begun.dissipated
    assert abs(gap) < 10 * 80 * EPS * turnover
    if not fastened:
        after = np.concatenate(momenta(worlds[0]))
        np.testing.assert_allclose(after, before, atol=10 * 80 * EPS * np.abs(before).max())
    assert worlds[0].compiled_steps > 0.9 * 50


def test_hinged_boxes_that_land_do_as_with_numpy():
    """On an edge, then flat, with friction and a rebound; a hinge is made in flight, and lets go on the ground."""

    def make():
        side = {"density": 500, "angular_velocity": (0.3, 0.4, 0.0)}
        bodies = {"ground": GROUND}
        for name, x in (("a", 0.0), ("b", 0.11)):
            bodies[name] = fr.RigidBody(Box((0.1, 0.1, 0.1)), position=(x, 0, 0.12), **side)
        joint = hinge("a", "b", (0.055, 0, 0.12), (0, 0.1, 0), name="pin", start=0.02, stop=0.16)
        return fr.World(bodies, 2e-3, gravity=(0, 0, -9.81), friction=0.5, restitution=0.3, joints=[joint])

    worlds, touched = both(make), 0
    for step in range(90):
        for world in each(worlds):
            world.step()
        touched += worlds[0].touching * len(worlds[0].joints)
        if step < 60 or step % 10 == 9:
            assert_same(worlds)
    assert touched > 5
    assert worlds[0].compiled_steps > 0.6 * 90


@pytest.fixture(scope="module")
def roms(tmp_path_factory):
    carried = {"effects.base_path": "origin = [0.0, 0.015, 0.01]"}
    return {
        "held": reduced(tmp_path_factory.mktemp("held"), frame="fixed", **CLAMPED, **TOUCHED),
        "carried": reduced(tmp_path_factory.mktemp("carried"), frame="moving", **carried, **CLAMPED, **TOUCHED),
        "free": reduced(tmp_path_factory.mktemp("free"), frame="moving", **TOUCHED),
        "stiff carried": reduced(tmp_path_factory.mktemp("stiff"), frame="moving", **carried, **STIFF, **TOUCHED),
        "stiff free": reduced(tmp_path_factory.mktemp("stiff_free"), frame="moving", **STIFF | LOOSE, **TOUCHED),
    }


def swinging(roms, kind, by, drive=None):
    """A beam that carries a box at a point of its surface, or by its end, on which another one hangs."""

    def motion(time):
        angle, rate = 0.2 * np.sin(20 * time) * np.ones(3), 4 * np.cos(20 * time) * np.ones(3)
        return fr.BaseState(np.zeros(3), quaternion_of_vector(angle), np.zeros(3), rate)

    is_carried = kind.endswith("carried")
    bodies = {"hand": fr.RigidBody(Box((0.02, 0.05, 0.05)), motion=motion)} if is_carried else {}
    bodies["beam"] = fr.SoftBody(roms[kind], **({"on": "hand"} if is_carried else {}))
    places = fr.World(bodies, 1e-3).simulator("beam").places()
    x, y, z = places[np.argmax(places @ [1.0, 0.1, 0.2])].tolist()
    small = {"shape": Box((0.03, 0.03, 0.03)), "mass": 0.02}
    bodies["low"] = fr.RigidBody(**small, position=(x, y, z + 0.02))
    bodies["far"] = fr.RigidBody(**small, position=(x + 0.04, y, z + 0.02), angular_velocity=(0, 3.0, 0))
    held = ball("beam", "low", (x, y, z)) if by == "point" else SurfaceJoint("beam", "low", "right", kind=by)
    joints = [held, hinge("low", "far", (x + 0.02, y, z + 0.02), (0, 0.02, 0), drive)]
    gravity = (0, 0, 0) if kind.endswith("free") else (0, 0, -9.81)
    return fr.World(bodies, 1e-3, joints=joints, gravity=gravity, friction=0.4)


@pytest.mark.parametrize(
    ("kind", "by"),
    [
        *(("held", "point"), ("carried", "point"), ("free", "point"), ("carried", "ball"), ("free", "ball")),
        *(("stiff carried", "weld"), ("stiff free", "weld")),
    ],
)
def test_what_hangs_on_a_soft_body_does_as_with_numpy(roms, kind, by):
    """At a point, by its end in the mean, or by a rigid end, as which it turns. A free body takes no impulses."""
    random, worlds = np.random.default_rng(0), both(lambda: swinging(roms, kind, by))
    start, begun = worlds[0].energy, worlds[0].ledger
    for step in range(60):
        with nullcontext() if random.random() < 0.8 else without(worlds[0]):
            worlds[0].step()
        worlds[1].step()
        if step % 10 == 9:
            assert_same(worlds)
            ours, theirs = (world.force_between("beam", "low") for world in worlds)
            np.testing.assert_allclose(ours, theirs, atol=1e-9 * np.abs(forces_of(worlds[1])).max())
    if by == "weld":
        assert np.abs(worlds[0].joint_forces(0)[1]).max() > 1e-4  # a couple
    account = worlds[0].ledger
    gap = worlds[0].energy - start - account.supplied + begun.supplied + account.numerical
    gap += account.dissipated - begun.dissipated
    turnover = max(start, worlds[0].energy, sum(abs(worlds[0].account(name).supplied) for name in worlds[0].names))
    assert abs(gap) < 10 * 60 * EPS * turnover
    assert account.dissipated > begun.dissipated
    assert worlds[0].compiled_steps > 0.7 * 30


@pytest.mark.parametrize(
    ("kind", "by"), [("held", "point"), ("carried", "ball"), ("free", "ball"), ("stiff free", "weld")]
)
def test_what_a_motor_moves_on_a_soft_body_does_as_with_numpy(roms, kind, by):
    """The same with a hinge that a motor turns: joints are rows then."""
    drive = Drive(friction=1e-4, armature=1e-5, motor=Motor("position", gain=0.05, damping=1e-3, most=5e-3))
    random, worlds = np.random.default_rng(0), both(lambda: swinging(roms, kind, by, drive))
    start, begun = worlds[0].energy, worlds[0].ledger
    for step in range(40):
        inputs = {"joint1": {"target": 0.5 * np.sin(0.2 * step)}}
        with nullcontext() if random.random() < 0.8 else without(worlds[0]):
            worlds[0].step(inputs)
        worlds[1].step(inputs)
        if step % 10 == 9:
            assert_same(worlds)
            ours, theirs = (np.array(world.joint_state("joint1")) for world in worlds)
            np.testing.assert_allclose(ours, theirs, atol=1e-9 * np.abs(theirs).max())
    account = worlds[0].ledger
    gap = worlds[0].energy - start - account.supplied + begun.supplied + account.numerical
    gap += account.dissipated - begun.dissipated
    turnover = max(start, worlds[0].energy, sum(abs(worlds[0].account(name).supplied) for name in worlds[0].names))
    assert abs(gap) < 10 * 40 * EPS * turnover
    assert worlds[0].compiled_steps > 0.7 * 20


def pressed(rom):
    """An arm on a hinge presses a box on a beam that yields: the arm's face turns towards the box, which slides."""
    bodies = {
        "beam": fr.SoftBody(rom),
        "box": fr.RigidBody(Box((0.12, 0.04, 0.03)), mass=0.01, position=(0.22, 0.015, 0.036)),
        "arm": fr.RigidBody(Box((0.1, 0.03, 0.02)), mass=0.02, position=(0.2, 0.015, 0.062)),
    }
    joints = [hinge("arm", "world", (0.15, 0.015, 0.062), (0, 0.02, 0))]
    laws = {"friction": 0.4, "apart": [("beam", "arm")]}
    return fr.World(bodies, 1e-3, gravity=(0, 0, -2.0), joints=joints, **laws)


def test_what_is_let_out_of_a_face_that_turns_is_as_with_numpy(roms):
    """Where it rests in it; that takes energy that contact has dissipated."""
    worlds, taken_back, dissipated = both(lambda: pressed(roms["held"])), 0, 0.0
    start = worlds[0].energy
    for step in range(120):
        for world in each(worlds):
            world.step({"arm": {"torque": [0, 2e-3 + 1e-3 * np.sin(0.04 * step), 0]}})
        assert_same(worlds)
        taken_back += worlds[1].ledger.contact < dissipated
        dissipated = worlds[1].ledger.contact
    assert taken_back > 20
    assert worlds[0].compiled_steps > 0.95 * 120
    account = worlds[0].ledger
    gap = worlds[0].energy - start - account.supplied + account.dissipated + account.numerical
    assert abs(gap) < 10 * 120 * EPS * account.supplied
