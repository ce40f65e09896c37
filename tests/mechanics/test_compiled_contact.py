"""Contact as it is compiled is that of NumPy: the same distances, the same pairs, the same forces."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from fenics_rom.compilation import compiled, jit
from fenics_rom.mechanics import braking, compiled_contact, contact_pairs, obstacles
from fenics_rom.mechanics.braking import SWINGS
from fenics_rom.mechanics.compiled import contact_law, coulomb, elimination, linearised, newton, shapes, sweeps
from fenics_rom.mechanics.compiled.contact_law import OTHERWISE, Found
from fenics_rom.mechanics.compiled.shapes import shape_rows
from fenics_rom.mechanics.compiled.sweeps import MOST_SWEEPS
from fenics_rom.mechanics.complementarity import solution
from fenics_rom.mechanics.contact import ContactLaw, ObstacleMotion, PointMotion
from fenics_rom.mechanics.contact_search import ContactSearch
from fenics_rom.mechanics.contact_solver import ContactSolver
from fenics_rom.mechanics.make_contact_solver import make_contact_solver
from fenics_rom.mechanics.obstacles import Box, Capsule, HalfSpace, Sphere
from fenics_rom.runtime.compiled import linear_step
from fenics_rom.runtime.steppers import residual_motion

pytestmark = pytest.mark.skipif(not compiled(), reason="numba is not installed, or turned off")
SHAPES = (
    HalfSpace([0.1, -0.2, 0.3], [1, 2, -2]),
    Sphere([0.1, 0.0, -0.1], 0.3),
    Capsule([0, 0, 0], [0.4, -0.2, 0.3], 0.2),
    Box([0.1, 0.2, -0.1], [0.6, 0.9, 1.2], [0.5, -0.4, 0.8]),
)
H, EPS = 1e-3, float(np.finfo(float).eps)
find_by_newton, find_by_sweeps, find_by_steps = map(
    jit, (newton.find_by_newton, sweeps.find_by_sweeps, linearised.find_by_steps)
)
look_at, look_among = map(jit, (coulomb.look_at, coulomb.look_among))
measure, solve = jit(shapes.measure), jit(elimination.solve)
seeds = st.integers(0, 2**32 - 1)


def test_numbers_of_the_law_are_those_of_numpy():
    """They stand twice, as compiled functions are kept by what their own folder says."""
    assert (coulomb.SOLVED, coulomb.STAGNATION) == (solution.CONVERGENCE_TOLERANCE, solution.STAGNATION_RESIDUAL)
    assert (coulomb.REGULAR_SHARE, contact_law.BACK) == (solution.REGULAR_SHARE, contact_pairs.BACK)
    assert contact_law.WORK_ROUND_OFF == braking.WORK_ROUND_OFF
    assert shapes.SHORTEST_DIRECTION == obstacles.SHORTEST_DIRECTION
    assert linear_step.FORGOTTEN == residual_motion.FORGOTTEN
    assert linear_step.NEGLIGIBLE == residual_motion.NEGLIGIBLE


@given(seeds)
@settings(deadline=None)
def test_distances_are_those_of_numpy(seed):
    random = np.random.default_rng(seed)
    points, offsets = random.uniform(-1, 1, (9, 3)), random.uniform(-0.1, 0.1, (len(SHAPES), 3))
    gaps, normals = np.empty(9 * len(SHAPES)), np.empty((9 * len(SHAPES), 3))
    measure(shape_rows(SHAPES), offsets, points, gaps, normals)
    for o, shape in enumerate(SHAPES):
        own = slice(9 * o, 9 * o + 9)
        gap, normal = shape.distance(points - offsets[o])
        np.testing.assert_allclose(gaps[own], gap, atol=50 * EPS, rtol=0)
        np.testing.assert_allclose(normals[own], normal, atol=50 * EPS / np.abs(gap).min(), rtol=0)


def test_inside_and_in_the_middle_distances_are_those_of_numpy():
    """Where there is no direction: at a centre, at the end of an axis, in a box, on its face and its edge."""
    points = [[0.1, 0.0, -0.1], [0.0, 0.0, 0.0], [0.11, 0.2, -0.1], [0.12, 0.25, -0.3]]
    upright = Box([0, 0, 0], [2, 2, 2])
    known_shapes, points = (*SHAPES, upright), np.array([*points, [1.0, 0.3, 0.2], [1.0, 1.0, 0.2], [0.5, -0.9, 0.1]])
    gaps, normals = np.empty(len(points) * len(known_shapes)), np.empty((len(points) * len(known_shapes), 3))
    measure(shape_rows(known_shapes), np.zeros((len(known_shapes), 3)), points, gaps, normals)
    known = [shape.distance(points) for shape in known_shapes]
    np.testing.assert_allclose(gaps, np.concatenate([gap for gap, _ in known]), atol=50 * EPS, rtol=0)
    along = (normals * np.concatenate([normal for _, normal in known])).sum(axis=1)
    exact = np.concatenate([np.abs(gap) > 1e-9 for gap, _ in known])
    np.testing.assert_allclose(along[exact], 1.0, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=50 * EPS)


LAWS = {
    "frictionless": ContactLaw(),
    "friction": ContactLaw(friction=0.6),
    "restitution": ContactLaw(friction=0.3, restitution=0.7),
    "elastic": ContactLaw(restitution=1.0),
    "springs": ContactLaw(friction=0.4, stiffness=2e4, damping=20.0),
}


def problem(random, law, quasi_static):
    """A solver whose points meet two obstacles, one of which moves, and a random step."""
    P = random.integers(1, 12)
    points = random.uniform(-0.2, 0.2, (P, 3)) * [1, 1, 0]
    met = HalfSpace([0, 0, 0], [0, 0, 1]), Sphere([0.3, 0, 0.0], 0.15 if quasi_static else 0.25)
    A = random.normal(size=(3 * P, 3 * P))
    W = 1e-3 * (A @ A.T / (3 * P) + 0.3 * np.eye(3 * P))
    reach = random.uniform(-1e-6, 2e-3, P)[:, None] * [0, 0, 1]
    velocity, free = random.normal(size=(2, P, 3)) * 0.5
    free[:, 2] -= 0.5
    start = np.zeros((2, 3))
    end = np.array([[0, 0, 0], random.normal(size=3) * 2e-4])
    before = np.array([[0, 0, 0], random.normal(size=3) * 0.2])
    return points, met, PointMotion(reach, velocity, free), W, ObstacleMotion(start, end, before)


@pytest.mark.parametrize("quasi_static", [False, True], ids=["dynamic", "at rest"])
@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
@given(seeds)
@example(9_999_999)  # a share of what swings that round-off of forces keeps from being found to less than that
@settings(deadline=None, max_examples=60)
def test_forces_are_those_of_numpy(law, quasi_static, seed):
    random = np.random.default_rng(seed)
    points, met, motion, W, moved = problem(random, law, quasi_static)
    solver, reference = make_contact_solver(points, met, law), ContactSolver(points, met, law)
    assert type(solver) is not type(reference)
    N = 2 * len(points)
    begun = ContactSearch(
        random.uniform(0, 10, (N, 3)) * random.choice([0.0, 1e-12, 1.0], (N, 1)),
        swung=random.integers(0, SWINGS + 2, N) if law.friction else None,
    )
    solver.search = reference.search = begun
    one, other = (each.solve(motion, W, H, moved, quasi_static) for each in (solver, reference))
    assert (one is None) == (other is None)
    if one is None:
        return
    (asked, solved), (asked_there, solved_there) = solver.last_step(), reference.last_step()
    stopped = np.abs(solved_there.problem.q).max()
    if solved_there.is_loose:
        return
    np.testing.assert_array_equal(one.pairs, other.pairs)
    np.testing.assert_allclose(asked.level, asked_there.level, atol=1e-12)
    np.testing.assert_allclose(solved.problem.q, solved_there.problem.q, atol=1e-12)
    stiff = 1 / np.linalg.eigvalsh(W)[0]  # the most force that a velocity takes
    np.testing.assert_allclose(one.pair_forces, other.pair_forces, atol=1e-9 * stopped * stiff, rtol=0)
    np.testing.assert_allclose(solved.velocities, solved_there.velocities, atol=1e-9 * stopped, rtol=0)
    if law.friction:
        assert one.normal_power == pytest.approx(other.normal_power, abs=1e-8 * stopped**2 * stiff)
        swung = [np.zeros(N) if each.search.swung is None else each.search.swung for each in (solver, reference)]
        np.testing.assert_array_equal(*swung)
        if not quasi_static:
            assert asked.braking.share == pytest.approx(asked_there.braking.share, abs=1e-7)


@given(seeds, st.integers(1, 40))
@settings(deadline=None, max_examples=60)
def test_equations_are_solved_whatever_stands_beside_them(seed, n):
    """Their symmetric part is definite, so that elimination without pivots is stable."""
    random = np.random.default_rng(seed)
    root, skew, x = random.normal(size=(n, n)), random.normal(size=(n, n)), random.normal(size=n)
    A = root @ root.T / n + 0.3 * np.eye(n) + 0.5 * (skew - skew.T) / np.sqrt(n)
    rows, right = np.full((-(-n // 4) * 4, -(-n // 8) * 8), np.nan), np.full(n + 3, np.nan)
    rows[:n, :n], right[:n] = A, A @ x
    assert solve(rows, right, n)
    np.testing.assert_allclose(right[:n], x, atol=10 * n * EPS * np.linalg.cond(A) * np.abs(x).max(), rtol=0)
    rows[:n, :n], right[:n] = 0.0, x
    assert not solve(rows, right, n)


@given(seeds)
@settings(deadline=None, max_examples=100)
def test_all_searches_find_the_same_forces(seed):
    """Of points that partly stick, slip and lift off, with some that take no part."""
    random = np.random.default_rng(seed)
    P = int(random.integers(1, 15))
    A, points = random.normal(size=(3 * P, 3 * P)), np.flatnonzero(random.random(P) < 0.8)
    W = 1e-3 * (A @ A.T / (3 * P) + 0.3 * np.eye(3 * P))
    C = len(points)
    if not C:
        return
    normals = random.normal(size=(C, 3))
    axes = np.empty((C, 3, 3))
    for frame, normal in zip(axes, normals, strict=True):
        frame[0] = normal / np.linalg.norm(normal)
        coulomb.frame_along(frame)
    q, μ = random.normal(size=(C, 3)) - [1.0, 0, 0], random.uniform(0.1, 1.0, C)
    given, found, speed = (W, points, axes, q, μ, 0.0), [], np.abs(q).max()
    yielding, among = np.array([coulomb.yielding_of(W, p, 0.0) for p in points]), linearised.room_among(C)
    coulomb.operator_among(W, points, axes, 0.0, among.V)
    for search in (find_by_newton, find_by_sweeps, find_by_steps):
        f, u, moved = random.uniform(0, 1, (C, 3)), np.empty((C, 3)), np.empty(3 * P)
        error, space = look_at(*given, yielding, f, u, moved), np.ones(2000)
        if search is find_by_newton:
            solves, is_found = find_by_newton(
                newton.in_one_piece(np.linalg.inv(W)), *given[1:-1], yielding, f, u, error, space
            )
            assert is_found
            assert solves <= 10
        elif search is find_by_sweeps:
            find_by_sweeps(among.V, q, μ, f, MOST_SWEEPS, space)
        else:  # goes on from where a few sweeps led to
            find_by_sweeps(among.V, q, μ, f, 5, space)
            error = look_among(among.V, q, μ, yielding, f, u)
            steps, is_found = find_by_steps(among, q, μ, yielding, f, u, error, space)
            assert is_found
            assert steps <= 8
        assert look_at(*given, yielding, f, u, moved) <= 1e-11 * speed
        found.append(f)
    apart = np.ptp(found, axis=0).max()
    assert apart <= 1e-9 * speed / np.linalg.eigvalsh(W)[0]


def test_what_swings_is_asked_for_the_share_that_friction_can_stop():
    """That is none where a point is alone, and some where friction brakes another one that slides."""
    law, still = ContactLaw(friction=0.5), ObstacleMotion(*np.zeros((3, 1, 3)))
    motion = np.array([[[0, 0, 0]] * 2, [[1.0, 0, 0], [0.1, 0, 0]], [[-0.2, 0, -1.0], [0.2, 0, -0.1]]])
    for swung, P, is_shared in ((SWINGS - 1, 2, False), (SWINGS, 1, False), (SWINGS, 2, True)):
        forces = []
        for make in (make_contact_solver, ContactSolver):
            solver = make(np.zeros((P, 3)), [HalfSpace([0, 0, 0], [0, 0, 1])], law)
            solver.search = solver.search._replace(swung=np.full(P, swung))
            found = solver.solve(PointMotion(*motion[:, :P]), 1e-3 * np.eye(3 * P), H, still)
            assert found is not None
            forces.append(found.forces)
            assert (0 < solver.last_step()[0].braking.share < 1) is is_shared
        np.testing.assert_allclose(*forces, atol=1e-9 * 1000)  # N, that stop 1 m/s


def test_what_loops_do_not_find_numpy_does(monkeypatch):
    monkeypatch.setattr(compiled_contact, "find_forces", lambda *given: Found(OTHERWISE, 0, 0.0))
    still, forces = ObstacleMotion(*np.zeros((3, 1, 3))), []
    for make in (make_contact_solver, ContactSolver):
        solver = make(np.zeros((1, 3)), [HalfSpace([0, 0, 0], [0, 0, 1])], ContactLaw(friction=0.5))
        motion = PointMotion(*np.array([[[0, 0, 0]], [[1.0, 0, 0]], [[1.0, 0, -1.0]]]))
        forces.append(solver.solve(motion, 1e-3 * np.eye(3), H, still).forces)
    np.testing.assert_array_equal(*forces)
