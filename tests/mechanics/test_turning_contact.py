"""Contact of points with obstacles that turn, in single steps: nothing gets in, is gained, or is dragged along."""

import math

import numpy as np
import pytest
from triangle_meshes import blob, groove

from fenics_rom.errors import StepError
from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.mechanics.contact import ContactLaw, ObstacleMotion, PointMotion
from fenics_rom.mechanics.contact_solver import ContactSolver
from fenics_rom.mechanics.frame_motion import quaternion_of_vector, rotation_matrix
from fenics_rom.mechanics.make_contact_solver import make_contact_solver
from fenics_rom.mechanics.obstacle_poses import between, distance_from, mean_twists, placed, pose_row, state_of
from fenics_rom.mechanics.obstacles import Box, Capsule, HalfSpace, Sphere

SHAPES = {
    "half-space": HalfSpace((0.0, 0.0, -0.02), (0.1, 0.0, 1.0)),
    "sphere": Sphere((0.01, 0.0, 0.0), 0.05),
    "capsule": Capsule((-0.05, 0.0, 0.0), (0.05, 0.01, 0.0), 0.03),
    "box": Box((0.0, 0.01, 0.0), (0.1, 0.06, 0.04), (0.2, 0.0, 0.1)),
    "blade": Box((0.0, 0.0, 0.0), (0.1, 0.06, 0.002)),
    "mesh": blob(3, 0.2, 0.05, 1),
    "groove": groove(),
}
ROUND_OFF = 1e-13  # m, of places of 0.1 m


def row(position, turn):
    """A pose by a position and a rotation vector."""
    return np.concatenate([position, quaternion_of_vector(turn)])


def moving(start, end, dt, before=None):
    return ObstacleMotion(start[None], end[None], mean_twists(start[None], end[None], dt) if before is None else before)


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_no_point_enters_what_turns_and_contact_gains_nothing(name, friction):
    """Points beside an obstacle that turns by up to 0.5 rad in a step, toward it or past it.

    What obstacles supply and contact dissipates adds up to the work on the points; friction is in its cone.
    """
    rng, shape, h, touched = np.random.default_rng(7), SHAPES[name], 5e-3, 0
    for k in range(30):
        start = row(rng.uniform(-0.02, 0.02, 3), rng.normal(size=3))
        end = row(start[:3] + rng.uniform(-5e-3, 5e-3, 3), rng.uniform(-0.3, 0.3, 3))
        turns = rng.uniform(0.0, 0.15) if k % 3 else 0.0
        end[3:] = between(start[None], row(start[:3], rng.normal(size=3))[None], turns)[0, 3:]
        within = 0.01 if name == "groove" else 0.1  # m: there both its sides are near
        points = placed(rng.uniform(-within, within, (60, 3)), start)
        gaps = distance_from(shape, points, start)[0]
        points = points[(gaps > 0) & (gaps < 0.02)]
        if not len(points):
            continue
        motion = PointMotion(np.zeros_like(points), *rng.normal(size=(2, *points.shape)))
        solver = make_contact_solver(points, [shape], ContactLaw(friction=friction))
        contact = solver.solve(motion, np.eye(3 * len(points)), h, moving(start, end, h))
        v̂ = motion.free_velocity + (0.0 if contact is None else contact.forces)
        assert distance_from(shape, points + h * v̂, end)[0].min() > -ROUND_OFF
        if contact is None:
            continue
        touched += 1
        work = contact.work(v̂, h)
        scale = h * np.abs(contact.forces).max() * np.abs(v̂).max() * len(points)
        assert min(work.contact, work.friction) >= -1e-9 * scale
        assert work.supplied - work.contact - work.friction == pytest.approx(h * (contact.forces * v̂).sum(), abs=1e-12)
        pressing = (contact.pair_forces * contact.normals).sum(axis=1)
        rubbing = np.linalg.norm(contact.pair_forces - pressing[:, None] * contact.normals, axis=1)
        assert pressing.min() >= -1e-9 * np.abs(pressing).max()
        assert (rubbing <= friction * pressing + 1e-7 * pressing.max()).all()
    assert touched > 5


@pytest.mark.parametrize("h", [1e-3, 1e-2])
def test_a_roller_that_spins_pushes_nothing_aside(h):
    """Its axis stays: without friction a point that lies on it is pushed along its radius, and no work is done.

    The normal at the end of what was touched at the start would drag it by ω h of what presses it.
    """
    roller, ω = Capsule((0.0, -1.0, 0.0), (0.0, 1.0, 0.0), 0.05), 10.0
    start, end = row(np.zeros(3), np.array([0.0, 0.3, 0.0])), row(np.zeros(3), np.array([0.0, 0.3 + ω * h, 0.0]))
    points = 0.05 * np.array([[math.sin(a), 0.0, math.cos(a)] for a in (-0.3, 0.0, 0.5)])
    free = -points / 0.05
    solver = ContactSolver(points, [roller], ContactLaw())
    contact = solver.solve(PointMotion(np.zeros((3, 3)), np.zeros((3, 3)), free), np.eye(9), h, moving(start, end, h))
    np.testing.assert_allclose(contact.forces, -free, atol=1e-12)
    assert abs(contact.work(np.zeros((3, 3)), h).supplied) < 1e-12


def test_what_sticks_goes_where_the_material_goes():
    """On a table that turns by 0.2 rad in a step, and is shifted: to round-off, after one step in which it stops."""
    table, h = HalfSpace((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)), 1e-2
    pose = row(np.array([0.02, 0.0, 0.0]), np.array([0.0, 0.0, 0.4]))
    end = row(np.array([0.03, 0.01, 0.0]), np.array([0.0, 0.0, 0.6]))
    point = np.array([[0.12, 0.05, 0.0]])
    goes = placed((point - pose[:3]) @ rotation_matrix(pose[3:]), end)
    solver = ContactSolver(point, [table], ContactLaw(friction=100.0))
    twist = mean_twists(pose[None], end[None], h)
    at_start = twist[:, :3] + np.cross(twist[:, 3:], point - pose[:3])
    solver.search = solver.search._replace(forces=np.array([[0.0, 0.0, 1.0]]))
    free = np.array([[0.0, 0.0, -1.0]])
    motion = ObstacleMotion(pose[None], end[None], twist)
    contact = solver.solve(PointMotion(np.zeros((1, 3)), at_start, free), np.eye(3), h, motion)
    np.testing.assert_allclose(point + h * (free + contact.forces), goes, atol=1e-14)


def test_a_blade_sweeps_what_is_before_it():
    """Thinner than its way in a step: at the end a point is before it, not behind."""
    blade, h = SHAPES["blade"], 1e-2
    start, end = row(np.zeros(3), np.zeros(3)), row(np.array([0.0, 0.0, 0.01]), np.array([0.0, 0.1, 0.0]))
    points, still = np.array([[0.02, 0.0, 0.0011], [-0.02, 0.01, 0.0015]]), np.zeros((2, 3))
    contact = ContactSolver(points, [blade], ContactLaw()).solve(
        PointMotion(still, still, still), np.eye(6), h, moving(start, end, h)
    )
    there = (points + h * contact.forces - end[:3]) @ rotation_matrix(end[3:])
    assert there[:, 2].min() > 1e-3 - ROUND_OFF, "above its upper face"


def test_a_shift_by_poses_is_a_shift():
    """Without turning, forces are those of an obstacle that is shifted."""
    rng, box, h = np.random.default_rng(1), SHAPES["box"], 2e-3
    points = rng.uniform(-0.1, 0.1, (9000, 3))
    points = points[(box.distance(points)[0] > 0) & (box.distance(points)[0] < 1.5e-3)]
    shifts = np.zeros((1, 3)), np.array([[1e-3, 2e-3, -1e-3]])
    posed = [np.hstack([shift, [[1.0, 0.0, 0.0, 0.0]]]) for shift in shifts]
    moved = [ObstacleMotion(*shifts, np.zeros((1, 3))), ObstacleMotion(*posed, np.zeros((1, 6)))]
    motion = PointMotion(np.zeros_like(points), *rng.normal(size=(2, *points.shape)))
    found = []
    for each in moved:
        solver = ContactSolver(points, [box], ContactLaw(friction=0.4))
        solver.keeps_out = True  # as it does of what turns
        found.append(solver.solve(motion, np.eye(3 * len(points)), h, each))
    near = box.distance(points - shifts[1])[1]  # where the nearest face at the end is that at the start
    same = (near * box.distance(points)[1]).sum(axis=1) > 1 - 1e-12
    np.testing.assert_allclose(found[1].forces[same], found[0].forces[same], atol=1e-9)
    assert (same & found[0].forces.any(axis=1)).sum() > 5


def test_poses_and_states_are_one_another():
    origin = np.array([0.1, 0.2, 0.3])
    state = BaseState(np.array([1.0, 2.0, 3.0]), quaternion_of_vector([0.3, 0.2, 0.1]), np.zeros(3), np.zeros(3))
    pose = pose_row(state, origin)
    np.testing.assert_allclose(placed(origin[None], pose)[0], state.position, atol=1e-15)
    for given, back in zip(state, state_of(pose, origin), strict=True):
        np.testing.assert_allclose(back, given, atol=1e-15)


def test_a_turn_is_not_told_beyond_two_radians():
    start, end = row(np.zeros(3), np.zeros(3)), row(np.zeros(3), np.array([0.0, 0.0, 2.1]))
    with pytest.raises(StepError, match=r"turn by 2\.1 rad in a step of 0\.01 s: at most 2 rad"):
        mean_twists(start[None], end[None], 1e-2)
