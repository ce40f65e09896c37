"""Contact inside a step: laws that hold to round-off, closed forms of impact and friction, and the energy account."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fenics_rom.errors import SceneError, StepError
from fenics_rom.mechanics import contact_solver
from fenics_rom.mechanics.braking import Braking
from fenics_rom.mechanics.complementarity import solve
from fenics_rom.mechanics.complementarity.solution import ADVICE
from fenics_rom.mechanics.contact import ContactLaw, ContactResidual, ObstacleMotion, PointMotion
from fenics_rom.mechanics.contact_pairs import Settled
from fenics_rom.mechanics.contact_search import ContactSearch
from fenics_rom.mechanics.contact_solver import ContactSolver
from fenics_rom.mechanics.make_contact_solver import make_contact_solver
from fenics_rom.mechanics.obstacles import Box, Capsule, HalfSpace, Sphere
from fenics_rom.mechanics.points_operator import moved_by

G = 9.81  # m/s²
FLOOR = HalfSpace((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
WALL = HalfSpace((1.0, 0.0, 0.0), (-1.0, 0.0, 0.0))
seeds = st.integers(0, 2**32 - 1)


class Points:
    """Point masses, between springs or not, stepped by passive midpoint integration with contact."""

    def __init__(
        self, points, obstacles, law, h, *, mass=1.0, K=None, D=None, force=(0.0, 0.0, 0.0), v=(0.0, 0.0, 0.0)
    ):
        points = np.atleast_2d(np.array(points, dtype=float))
        n = points.size
        self.M = np.diag(np.repeat(np.broadcast_to(mass, len(points)), 3))
        self.K, self.D = (np.zeros((n, n)) if m is None else m for m in (K, D))
        self.contact, self.h = make_contact_solver(points, obstacles, law), h
        self.points, self.offsets = points, np.zeros((len(obstacles), 3))
        self.force, self.v = (np.array(np.broadcast_to(a, points.shape)).ravel() for a in (force, v))
        self.x, self.work, self.heat = np.zeros(n), 0.0, 0.0
        self.accounts, self.resolution = [], None
        W = np.linalg.inv(2 / h * self.M + self.D + h / 2 * self.K)
        self.W = (W + W.T) / 2

    def step(self, w=0.0, quasi_static=False):
        h, end = self.h, self.offsets + self.h * np.broadcast_to(w, self.offsets.shape)
        free = self.W @ (self.force + 2 / h * self.M @ self.v - self.K @ self.x)
        x, v, free = (a.reshape(-1, 3) for a in (self.x, self.v, free))
        motion = ObstacleMotion(self.offsets, end, (end - self.offsets) / h)
        self.resolution = self.contact.solve(PointMotion(x, v, free), self.W, h, motion, quasi_static)
        mid = free.ravel()
        if self.resolution is not None:
            mid = mid + self.W @ self.resolution.forces.ravel()
            account = self.resolution.work(mid.reshape(-1, 3), h)
            self.accounts.append(account)
            total = h * self.resolution.forces.ravel() @ mid
            scale = h * np.abs(self.resolution.forces).max() * np.abs(mid).max() + max(map(abs, account))
            assert abs(account.supplied - account.contact - account.friction - total) <= 1e-13 * scale
        self.work += h * self.force @ mid
        self.heat += h * mid @ self.D @ mid
        self.x, self.v, self.offsets = self.x + h * mid, 2 * mid - self.v, end
        return self

    @property
    def position(self):
        return self.points + self.x.reshape(-1, 3)

    @property
    def velocity(self):
        return self.v.reshape(-1, 3)

    @property
    def energy(self):
        return (self.v @ self.M @ self.v + self.x @ self.K @ self.x) / 2

    @property
    def gap(self):
        return self.contact.gaps(self.x.reshape(-1, 3), self.offsets).min()

    def sums(self):
        return np.sum(self.accounts, axis=0) if self.accounts else np.zeros(4)


def chain(P, k):
    """Stiffness (3P, 3P) of springs in all directions from each point to the next."""
    d = np.diff(np.eye(P), axis=0)
    return np.kron(k * d.T @ d, np.eye(3))


@pytest.mark.parametrize("e", [0.25, 0.5, 0.9, 1.0])
def test_an_impact_gives_back_its_part_of_the_speed(e):
    """n·v⁺ = -e n·v to round-off, whatever the step and wherever in the step the surface is; none enters it."""
    for h in (1e-4, 3e-3, 5e-2):
        for way in np.linspace(1.5, 4.5, 13):
            ball = Points([0, 0, way * 2.0 * h], [FLOOR], ContactLaw(restitution=e), h, v=(0.3, 0.0, -2.0))
            while ball.resolution is None:
                ball.step()
            np.testing.assert_allclose(ball.velocity[0], [0.3, 0.0, 2.0 * e], atol=1e-15)
            assert -1e-15 <= ball.gap <= (1 + e / 2) * 2.0 * h


def test_an_impact_without_restitution_ends_on_the_surface():
    """In two steps, whatever they are and wherever in the first one the surface is; no nearer than that on the way."""
    for h in (1e-4, 3e-3, 5e-2):
        for way in np.linspace(1.5, 4.5, 13):
            ball = Points([0, 0, way * 2.0 * h], [FLOOR], ContactLaw(), h, v=(0.3, 0.0, -2.0))
            while ball.resolution is None:
                ball.step()
            assert ball.gap >= -1e-15
            ball.step()
            np.testing.assert_allclose(ball.velocity[0], [0.3, 0.0, 0.0], atol=1e-14)
            assert ball.gap == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize("e", [0.0, 0.3, 0.7, 0.95])
@pytest.mark.parametrize("h", [1e-3, 1e-2, 5e-2])
def test_a_net_that_has_fallen_rests_on_the_floor(h, e):
    """Springs press some points back within the step in which they bounce: none gets in, and forces end as they are."""
    fallen = [[0.0, 0.0, 0.05], [0.1, 0.0, 0.051], [0.2, 0.0, 0.056]]
    net = Points(fallen, [FLOOR], ContactLaw(restitution=e), h, K=chain(3, 300.0), D=chain(3, 3.0), force=(0, 0, -G))
    forces, inside = [], 1e-11 * h  # m: forces are found to 1e-12 of speeds of 1 m/s
    for _ in range(round(3.0 / h) + 200):
        net.step()
        assert net.gap >= -inside
        forces.append(np.zeros((3, 3)) if net.resolution is None else net.resolution.forces)
        assert not net.accounts or net.accounts[-1].contact >= -1e-13
    assert np.abs(net.position[:, 2]).max() <= inside
    weights = (net.K @ net.x).reshape(3, 3) + np.array([0.0, 0.0, G])
    np.testing.assert_allclose(forces[-5:], np.tile(weights, (5, 1, 1)), atol=1e-8 * G)


@pytest.mark.parametrize("e", [0.3, 0.7, 1.0])
def test_rebound_height(e):
    """e² of the height dropped from, to the way of a step."""
    h, height = 1e-4, 0.5
    ball = Points([0, 0, height], [FLOOR], ContactLaw(restitution=e), h, force=(0, 0, -G))
    while not ball.accounts:
        ball.step()
    while ball.velocity[0, 2] > 0:
        ball.step()
    assert ball.position[0, 2] == pytest.approx(e**2 * height, abs=2 * h * np.sqrt(2 * G * height))


def test_lossless_bounces_keep_the_energy():
    """e = 1, no friction: 20,000 steps in a box with a ball in it lose nothing."""
    walls = [HalfSpace(s * a, -s * a) for a in np.eye(3) for s in (1.0, -1.0)]
    ball = Points([0.6, 0.1, -0.2], [*walls, Sphere((0, 0, 0), 0.3)], ContactLaw(restitution=1.0), 7e-3, v=(1, 2, -0.7))
    before = ball.energy
    for _ in range(20_000):
        ball.step()
    assert len(ball.accounts) > 100
    assert ball.energy == pytest.approx(before, rel=1e-12)
    assert ball.gap > -1e-14


def test_sliding_distance():
    """v0²/(2 μ g) to O(h), and then rest."""
    for h in (1e-2, 1e-3):
        block = Points(
            [0, 0, 0], [FLOOR], ContactLaw(friction=0.4), h, mass=3.0, force=(0, 0, -3 * G), v=(1.2, 0.9, 0.0)
        )
        for _ in range(int(1.0 / h)):
            block.step()
        way = np.array([0.8, 0.6, 0.0]) * 1.5**2 / (2 * 0.4 * G)
        np.testing.assert_allclose(block.position[0], way, atol=1.5 * h)
        assert np.abs(block.v).max() <= 1e-15
        assert block.sums()[2] == pytest.approx(1.5 * 1.5**2, rel=1e-13)  # all of the kinetic energy


@pytest.mark.parametrize("h", [1e-5, 1e-3, 5e-2])
@pytest.mark.parametrize("law", [ContactLaw(friction=0.5), ContactLaw(friction=0.5, restitution=0.6), ContactLaw()])
def test_rest_is_rest(h, law):
    """Under gravity, let fall from one step's way, in the end nothing moves at all."""
    P = 4
    body = Points(
        np.column_stack([np.arange(P), np.zeros(P), np.full(P, 0.5 * G * h**2)]),
        [FLOOR], law, h, K=chain(P, 1e3), D=chain(P, 3.0), force=(0, 0, -G),
    )  # fmt: skip
    for _ in range(600):
        body.step()
    assert np.abs(body.v).max() <= 1e-11 * G * h  # springs of 1e3: some eps of what they pull
    # Places are up to P - 1, and forces are found to 1e-12 of speeds.
    assert body.gap >= -10 * np.finfo(float).eps * P - 1e-11 * G * h**2
    before = body.x.copy()
    for _ in range(20):
        body.step()
    assert np.abs(body.x - before).max() <= 2e-11 * G * h**2


@pytest.mark.parametrize("μ", [0.3, 0.8])
def test_incline(μ):
    """Below the angle of friction it stays, above it slides with g (sin θ - μ cos θ), exactly."""
    h = 2e-3
    for tilt in (-0.01, 0.01):
        θ = np.arctan(μ) + tilt
        block = Points(
            [[0, 0, 0], [1, 0, 0]], [FLOOR], ContactLaw(friction=μ), h, K=chain(2, 1e4),
            force=(G * np.sin(θ), 0.0, -G * np.cos(θ)),
        )  # fmt: skip
        for _ in range(100):
            block.step()
        speed = 0.0 if tilt < 0 else 100 * h * G * (np.sin(θ) - μ * np.cos(θ))
        np.testing.assert_allclose(block.velocity, [[speed, 0, 0]] * 2, atol=1e-13)


def test_a_conveyor_takes_along_what_lies_on_it():
    """It slips until it has the belt's speed; half of what the belt supplies is heat."""
    h = 1e-3
    block = Points([0, 0, 0], [FLOOR], ContactLaw(friction=0.5), h, mass=2.0, force=(0, 0, -2 * G))
    for _ in range(500):
        block.step(w=(0.7, 0.0, 0.0))
    np.testing.assert_allclose(block.velocity, [[0.7, 0.0, 0.0]], atol=1e-14)
    supplied, impact, friction, _ = block.sums()
    assert supplied == pytest.approx(2.0 * 0.7**2, rel=1e-12)
    assert friction == pytest.approx(0.5 * 2.0 * 0.7**2, rel=1e-12)
    assert abs(impact) < 1e-15


def test_a_piston_does_work():
    """A floor that rises pushes a weight at its own speed; the impact, e = 0, takes half of the impulse's work."""
    h = 1e-3
    weight = Points([0, 0, 0], [FLOOR], ContactLaw(), h, mass=2.0, force=(0, 0, -2 * G))
    for _ in range(100):
        weight.step(w=(0.0, 0.0, 0.3))
    np.testing.assert_allclose(weight.velocity, [[0, 0, 0.3]], atol=1e-14)
    supplied, impact, friction, _ = weight.sums()
    assert weight.energy - weight.work == pytest.approx(supplied - impact, rel=1e-12)
    assert impact == pytest.approx(0.5 * (2 * 0.3 + 2 * G * h) * 0.3, rel=1e-12)
    assert friction == pytest.approx(0.0, abs=1e-15)


def test_corner_of_floor_and_wall():
    """A ball pushed into a corner touches both, each with its own force."""
    h = 1e-3
    ball = Points([0.9, 0, 0.1], [FLOOR, WALL], ContactLaw(friction=0.2), h, force=(5.0, 0.0, -G), v=(1.0, 0.2, 0.0))
    for _ in range(2000):
        ball.step()
    assert np.abs(ball.v).max() < 1e-14
    assert ball.position[0, 0] <= 1
    assert ball.position[0, 2] >= 0
    assert ball.resolution.touching == 2
    floor, wall = ball.resolution.by_obstacle
    np.testing.assert_allclose(floor + wall, [-5.0, 0.0, G], atol=1e-11)
    assert floor[2] > 0 > wall[0]
    np.testing.assert_allclose(ball.resolution.forces, [floor + wall])


def scene(rng, law):
    """A net of points of very different masses and springs among obstacles of all kinds."""
    P = int(rng.integers(1, 7))
    points = rng.uniform((-0.4, -0.4, 0.6), (0.4, 0.4, 1.4), (P, 3))
    shapes = [FLOOR, WALL, Sphere((-0.5, 0.0, 0.0), 0.4), Capsule((-1, 0.6, 0.2), (1, 0.6, 0.2), 0.15),
              Box((0.2, -0.6, 0.0), (0.5, 0.5, 0.8), (0.2, 0.1, 0.5))]  # fmt: skip
    obstacles = [shapes[i] for i in rng.permutation(5)[: rng.integers(1, 4)]]
    B = rng.standard_normal((3 * P, 3 * P))
    k = 10.0 ** rng.uniform(0, 6)
    return Points(
        points, obstacles, law, 10.0 ** rng.uniform(-4, -1.3), mass=10.0 ** rng.uniform(-3, 3, P), K=k * B @ B.T / P,
        D=0.01 * B.T @ B if rng.random() < 0.5 else None,
        force=rng.uniform(-10, 10, (P, 3)), v=rng.uniform(-3, 3, (P, 3)),
    )  # fmt: skip


def goes_on(body, w):
    """Whether forces were found in a step; one for which there are none leaves everything as it was."""
    try:
        body.step(w)
    except StepError:
        return False
    return True


@given(seed=seeds, e=st.sampled_from([0.0, 0.4, 1.0]), μ=st.sampled_from([0.0, 0.2, 0.7]))
@settings(max_examples=60, deadline=None)
def test_energy_law_in_random_scenes(seed, e, μ):
    """E⁺ - E = work + supplied - contact - friction - heat at every step, and contact never gives any.

    In a step the sum of contact and friction counts: an impact of one point may push another along the floor. Masses
    and springs may be so different that the net's own inverse, not contact, loses six digits.
    """
    rng = np.random.default_rng(seed)
    body = scene(rng, ContactLaw(restitution=e, friction=μ))
    w = rng.uniform(-1, 1, body.offsets.shape) * (rng.random() < 0.5)
    for _ in range(60):
        before, work, heat, booked = body.energy, body.work, body.heat, len(body.accounts)
        if not goes_on(body, w):
            assert (body.energy, body.work, body.heat) == (before, work, heat)
            return
        supplied, impact, friction = body.accounts[-1][:3] if len(body.accounts) > booked else (0.0, 0.0, 0.0)
        change = (body.work - work) - (body.heat - heat) + supplied - impact - friction
        scale = max(body.energy, before, abs(supplied), abs(body.work - work))
        assert abs(body.energy - before - change) <= 1e-9 * scale
        assert impact >= -1e-9 * scale
        assert friction >= -1e-9 * scale


@pytest.mark.parametrize(
    ("seeds", "refused"),
    [((904, 2842, 11015), []), ((4848,), [4848]), pytest.param(range(2000, 3000), [2501], marks=pytest.mark.slow)],
    ids=["wedged", "squeezed", "many"],
)
def test_hardly_a_random_scene_is_without_forces(seeds, refused):
    """Of 12,000 four are: two obstacles squeeze a point out of a wedge that friction holds it in, and it says so.

    For one of them Coulomb's law is proved to have no solution, by a test below.

    Where obstacles that do not close on it hold a point in a wedge, it need not stick to both as it did before; nor are
    forces found to less than round-off.
    """
    stopped = {}
    for seed in seeds:
        rng = np.random.default_rng(seed)
        body = scene(rng, ContactLaw(restitution=(0.0, 0.4, 1.0)[seed % 3], friction=(0.0, 0.2, 0.7)[seed // 3 % 3]))
        w = rng.uniform(-1, 1, body.offsets.shape) * (rng.random() < 0.5)
        try:
            for _ in range(60):
                body.step(w)
        except StepError as error:
            stopped[seed] = str(error)
        assert body.contact.search.residual.steps == 0
    assert list(stopped) == refused
    assert all("wedged" in message for message in stopped.values())


@pytest.mark.parametrize("h", [1e-5, 1e-3, 1e-1])
@pytest.mark.parametrize("degrees", [10, 30])
def test_a_wedge_that_closes_lets_go_of_a_point_below_the_angle_of_friction_alone(degrees, h):
    """Out of a wedge of twice α, whose sides come with w, a point slips at w/sin α if μ < tan α.

    Beyond, both forces together, 2 λ (sin α - μ cos α) outwards, would draw it in: whatever the step, there are none.
    """
    α, speed = math.radians(degrees), 0.3
    normals = np.array([[math.sin(α), 0.0, side * math.cos(α)] for side in (1.0, -1.0)])
    planes = [HalfSpace((0.0, 0.0, 0.0), tuple(n)) for n in normals]

    def squeezed(friction):
        return Points((0.0, 0.0, 0.0), planes, ContactLaw(friction=friction), h, mass=2.0).step(speed * normals)

    slips = squeezed(0.99 * math.tan(α)).velocity[0]
    np.testing.assert_allclose(slips, [speed / math.sin(α), 0.0, 0.0], rtol=1e-9, atol=1e-9)
    with pytest.raises(StepError, match=r"wedged between obstacles.* at any dt; less friction or the penalty") as told:
        squeezed(1.01 * math.tan(α))
    assert "smaller dt" not in str(told.value)


def is_without_forces(operator, in_frames, μ):
    """Whether there is a proof that pairs A and B of one point have none.

    With forces F on it u = W F + q. Neither A nor B alone will do: without forces both close, and all forces in the
    cone of one press against the other. With both, n·u = 0 of each and u_A - u_B = q_A - q_B leave one number open,
    u_A = u_0 + s t along the edge t of the wedge. It tells both directions d of slip; so F is in the cone of two
    vectors n - μ d(s), and W F = r(s) = u_A - q_A. Where some p has p·(n - μ d) < 0 for both and p·W⁻¹ r > 0, there is
    no F. That is so between two s if it is at both, as p·n >= 0 and d is on the arc between those of both, and r on the
    line; and beyond the last with p = ±t.
    """
    q, (A, B) = operator.frames.in_space(in_frames), operator.frames.axes[:, :, 0]
    W = operator.operator.matrix.reshape(2, 3, 2, 3).swapaxes(1, 2)
    assert all(np.array_equal(W[0, 0], part) for part in (W[0, 1], W[1, 1]))
    inverse, cos, apart = np.linalg.inv(W[0, 0]), A.dot(B), q[0] - q[1]
    stiffness, sin = np.linalg.norm(inverse, 2), math.sqrt(1 - cos**2)
    np.testing.assert_allclose(W[0, 0], W[0, 0, 0, 0] * np.eye(3), atol=1e-4 * W[0, 0, 0, 0])
    alone = cos + μ * sin < -0.01 and (in_frames[0] < 0).all()
    slides_on_both = min(abs(B.dot(apart)), abs(A.dot(apart))) > 0.01 * np.linalg.norm(q[0])  # whatever s
    edge, out = np.cross(A, B) / sin, (A + B) / np.linalg.norm(A + B)
    s, φ = np.linspace(-2, 2, 81), np.linspace(-math.pi / 2, math.pi / 2, 37)
    p = np.outer(np.cos(φ), out) + np.outer(np.sin(φ), edge)
    slips = np.linalg.solve([A, B, edge], [0.0, B.dot(apart), 0.0]) + np.outer(s, edge)
    refuted = True
    for n, u in ((A, slips), (B, slips - apart)):
        refuted = refuted & ((n - μ * u / np.linalg.norm(u, axis=1)[:, None]) @ p.T < 0)
    r = slips - q[0]
    refuted &= r @ inverse @ p.T > 2e-3 * stiffness * np.linalg.norm(r, axis=1)[:, None]
    between = (refuted[1:] & refuted[:-1]).any(axis=1).all()
    return alone and slides_on_both and between and refuted[0, 0] and refuted[-1, -1]


def test_coulombs_law_has_no_solution_where_a_random_scene_is_refused(monkeypatch):
    """Neither with the c_t of before the step nor without; with less friction there is no such proof, and a step."""
    problems, find = [], contact_solver.solve

    def noting(operator, q, *others):
        problems.append((operator, q))
        return find(operator, q, *others)

    monkeypatch.setattr(contact_solver, "solve", noting)
    rng = np.random.default_rng(9751)
    body = scene(rng, ContactLaw(friction=0.7))
    w = rng.uniform(-1, 1, body.offsets.shape) * (rng.random() < 0.5)
    for _ in range(60):
        problems.clear()
        if not goes_on(body, w):
            break
    assert len(problems) == 2
    assert all(is_without_forces(*problem, 0.7) for problem in problems)
    assert not is_without_forces(*problems[1], 0.3)
    body.contact.law = ContactLaw(friction=0.3)
    assert goes_on(body, w)


@given(seed=seeds, e=st.sampled_from([0.0, 0.4, 1.0]))
@settings(max_examples=40, deadline=None)
def test_nothing_enters_an_obstacle_by_more_than_it_may(seed, e):
    """(1 - e)/2 of a step's motion, if obstacles move at constant speeds and the body begins far enough away."""
    rng = np.random.default_rng(seed)
    body = scene(rng, ContactLaw(restitution=e, friction=0.3))
    w = rng.uniform(-0.5, 0.5, body.offsets.shape) * (rng.random() < 0.5)

    def motion():
        return body.h * (np.linalg.norm(body.velocity, axis=1).max() + np.linalg.norm(w, axis=1).max())

    longest = motion()
    if body.gap < longest / 2:
        return
    for _ in range(80):
        if not goes_on(body, w):
            return
        longest = max(longest, motion())
        assert body.gap >= -(1 - e) / 2 * longest - 1e-9 * max(1.0, np.abs(body.x).max())
    assert np.isfinite(body.energy)


@pytest.mark.parametrize("h", [1e-5, 1e-3, 5e-2])
@pytest.mark.parametrize("ratio", [1e-6, 1e6])
def test_unequal_masses_and_springs_stay_bounded(h, ratio):
    """Two points with masses 1 : 1e6 on springs 1 : 1e6 thrown on the floor never have more energy than at first."""
    body = Points(
        [[0, 0, h], [0.5, 0, 2 * h]], [FLOOR], ContactLaw(friction=0.5, restitution=0.5), h, mass=[1.0, ratio],
        K=chain(2, ratio), v=[[1, 0, -1], [0, 0.5, -2]],
    )  # fmt: skip
    energies = [body.energy]
    for _ in range(300):
        energies.append(body.step().energy)
    assert np.diff(energies).max() <= 1e-12 * energies[0]
    assert body.gap >= -1e-12


@given(seed=seeds)
@settings(max_examples=20, deadline=None)
def test_quasi_static_contact_closes_gaps_and_no_more(seed):
    rng = np.random.default_rng(seed)
    body = scene(rng, ContactLaw(friction=0.3, restitution=0.5))
    for _ in range(30):
        start = np.minimum(body.contact.gaps(body.x.reshape(-1, 3), body.offsets), 0.0)
        body.step(quasi_static=True)
        after = body.contact.gaps(body.x.reshape(-1, 3), body.offsets)
        assert (after - start).min() >= -1e-9 * max(1.0, np.abs(body.x).max())
        body.v[:] = 0


def test_a_gap_closes_quasi_statically_within_one_step():
    body = Points([0, 0, 0.1], [FLOOR], ContactLaw(restitution=1.0, friction=0.5), 0.1, force=(0.1, 0.0, -100.0))
    body.step(quasi_static=True)
    assert body.position[0, 2] == pytest.approx(0.0, abs=1e-15)
    assert body.position[0, 0] == pytest.approx(0.0, abs=1e-15)


def test_a_point_inside_is_held_but_not_pushed_out_quasi_statically():
    body = Points([0, 0, -0.1], [FLOOR], ContactLaw(), 0.1, force=(0.0, 0.0, -100.0))
    body.step(quasi_static=True)
    assert body.position[0, 2] == pytest.approx(-0.1, abs=1e-15)


def test_what_slides_steadily_is_solved_at_once(numpy_alone):
    """The last forces are kept, and are the solution of the next step."""
    body = Points(
        np.eye(3) * [1, 1, 0], [FLOOR, WALL], ContactLaw(friction=0.3), 1e-3, K=chain(3, 1e4), force=(0, 0, -G),
        v=(0, -5, 0),
    )  # fmt: skip
    for _ in range(10):
        body.step()
    assert body.resolution.iterations == 0
    np.testing.assert_array_equal(body.contact.search.forces[:3], body.resolution.forces)


@pytest.mark.parametrize("damping", [0.0, 50.0])
def test_penalty_springs_are_indented_by_force_over_stiffness(damping):
    k, h = 2e4, 1e-3
    body = Points([0, 0, 0], [FLOOR], ContactLaw(stiffness=k, damping=damping, friction=0.3), h, force=(0.5, 0.0, -G))
    body.D[:] = np.diag([0.0, 0.0, 60.0])
    body.W = np.linalg.inv(2 / h * body.M + body.D)
    for _ in range(3000):
        body.step()
    assert body.position[0, 2] == pytest.approx(-G / k, rel=1e-9)
    assert np.abs(body.v).max() < 1e-12
    np.testing.assert_allclose(body.resolution.forces, [[-0.5, 0.0, G]], rtol=1e-9, atol=1e-9)


def test_penalty_keeps_its_springs_energy_in_the_account():
    """Undamped and deep enough that it does not leave within the steps: contact is ½ k g² to round-off, to and fro."""
    k, h = 1e3, 1e-3
    body = Points([0, 0, -0.05], [FLOOR], ContactLaw(stiffness=k), h, force=(0, 0, -G))
    for _ in range(15):
        before = body.position[0, 2]
        body.step()
        stored = k / 2 * (body.position[0, 2] ** 2 - before**2)
        assert body.accounts[-1].contact == pytest.approx(stored, rel=1e-9, abs=1e-15)
    assert body.energy == pytest.approx(body.work - body.sums()[1], rel=1e-12)


def test_springs_take_no_less_than_they_store():
    """Of balls that are thrown at a floor from anywhere, with any springs, dashpots and steps: what they have stays."""
    rng = np.random.default_rng(0)
    for _ in range(60):
        h, k, d = 10 ** rng.uniform(-4, -1), 10 ** rng.uniform(1, 7), rng.choice([0.0, 10 ** rng.uniform(0, 3)])
        ball = Points([0, 0, rng.uniform(0, 0.3)], [FLOOR], ContactLaw(stiffness=k, damping=d), h, v=(0.2, 0, -2.0))
        whole = ball.energy
        for _ in range(30):
            ball.step()
            stored = k / 2 * min(ball.position[0, 2], 0.0) ** 2
            assert ball.energy + stored <= whole * (1 + 1e-12)  # it had grown 4,310-fold in a step
            whole = ball.energy + stored


def test_springs_hold_what_would_go_through_an_obstacle():
    """In no step does a ball get deeper into a plate than half of its thickness, however soft springs are."""
    plate, rng, held = Box((0.0, 0.0, 0.0), (9.0, 9.0, 0.02)), np.random.default_rng(1), 0
    for _ in range(60):
        h, k, side = 10 ** rng.uniform(-4, -1), 10 ** rng.uniform(1, 7), rng.choice([-1, 1])
        law, begun = ContactLaw(stiffness=k), [0, 0, side * rng.uniform(0.01, 0.3)]
        ball = Points(begun, [plate], law, h, v=(0.0, 0.0, -2.0 * side), force=(0.0, 0.0, -G * side))
        for _ in range(40):
            ball.step()
            assert side * ball.position[0, 2] >= -1e-15
        is_held = ball.contact.search.held.springs > 0
        assert is_held == ("springs of contact would have let" in ball.contact.search.messages[1])
        held += is_held
    assert 10 < held < 50


def test_check_start_tells_where_and_how_deep():
    contact = ContactSolver([[0, 0, 1.0], [0, 0, 0.2]], [FLOOR, Sphere((0, 0, 0), 0.5)], ContactLaw())
    offsets, names = np.zeros((2, 3)), ["floor", "ball"]
    with pytest.raises(StepError, match=r"0\.3 m inside 'ball' is the point at \[0\.0, 0\.0, 0\.2\]"):
        contact.check_start(np.zeros((2, 3)), offsets, names)
    contact.check_start(np.zeros((2, 3)), np.tile([0, 0, -1.0], (2, 1)), names)
    contact.check_start(np.array([[0, 0, 0.0], [0, 0, 0.3 - 1e-10]]), offsets, names)


def test_gaps_are_the_smallest_to_any_obstacle():
    contact = ContactSolver([[0, 0, 1.0], [0, 0, 2.0]], [FLOOR, Sphere((0, 0, 3.0), 0.5)], ContactLaw())
    np.testing.assert_allclose(contact.gaps(np.zeros((2, 3)), np.zeros((2, 3))), [1.0, 0.5])
    np.testing.assert_allclose(contact.gaps(np.zeros((2, 3)), np.array([[0, 0, 0.9], [0, 0, 0]])), [0.1, 0.5])


def test_out_of_reach_is_nothing():
    body = Points([0, 0, 10.0], [FLOOR, WALL], ContactLaw(friction=0.5), 1e-3, v=(1, 1, -1))
    assert body.step().resolution is None


@pytest.mark.parametrize(("freedoms", "advice"), [(1e-6, "in 2 independent ways, of the 3 "), (1e-2, "a smaller dt")])
def test_where_no_forces_are_found_it_says_what_of_a_body_is_too_stiff(freedoms, advice, monkeypatch):
    """A smaller dt makes no body move the other way."""
    monkeypatch.setattr(contact_solver, "solve", refuse)
    points, still = PointMotion(*np.zeros((3, 1, 3))), ObstacleMotion(*np.zeros((3, 1, 3)))
    solver = ContactSolver(np.zeros((1, 3)), [FLOOR], ContactLaw(friction=0.5))
    with pytest.raises(StepError, match=advice):
        solver.solve(points._replace(free_velocity=-np.ones((1, 3))), np.diag([1.0, freedoms, 1.0]), 1e-3, still)


@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_what_stops_by_itself_needs_no_forces(friction):
    """Also where that is so to the last bit, in a step that follows one in which it was pushed."""
    body = Points([0, 0, 0.0], [FLOOR], ContactLaw(friction=friction), 0.5)
    braked, forces = ((-1.0, 0, 2.0), (0.5, 0, -1.0)), []
    for force, v in (((0, 0, -1.0), (0.0, 0, -1.0)), ((0, 0, -1.0), (0.0, 0, -1.0)), braked, braked):
        body.force, body.v, body.x = np.array(force), np.array(v), np.zeros(3)
        forces.append(body.step().resolution.forces.any())
    assert forces == [True, True, False, False]
    assert not body.v.any()


def refuse(*args):
    raise StepError("contact: none" + ADVICE)


@given(seed=seeds, e=st.sampled_from([0.0, 0.5, 1.0]), share=st.floats(0.3, 1), quasi_static=st.booleans())
@settings(max_examples=150, deadline=None)
def test_what_is_due_is_never_out_of_reach(seed, e, share, quasi_static):
    """Also where all moves along a diagonal, which the bound allows for, and what was pushed meets another speed."""
    rng = np.random.default_rng(seed)
    h, n = 10.0 ** rng.uniform(-4, -1), rng.choice([-1.0, 1.0], 3) / math.sqrt(3)
    free, v, w, w_before = along = rng.standard_normal(4) * 10.0 ** rng.uniform(-2, [2, 1, 1, 1])
    gap = share * h * (2 * abs(free - w) + abs(v) / 2 + max(abs(w), abs(w_before)))
    motion = ObstacleMotion(np.zeros((1, 3)), h * w * n[None], w_before * n[None])
    points = PointMotion(np.zeros((1, 3)), v * n[None], free * n[None])
    far, floor = h * 10 * np.abs(along).sum(), HalfSpace((0.0, 0.0, 0.0), n)
    solver, apart = (ContactSolver(d * n[None], [floor], ContactLaw(e, 0.3)) for d in (gap, far))
    solver.search = ContactSearch(np.ones((1, 3)))
    if solver.solve(points, np.eye(3), h, motion, quasi_static) is not None:
        assert len(solver.within_reach(points, h, motion))
    assert not len(apart.within_reach(points, h, motion))


def test_asked_again_in_a_step_the_law_is_the_same():
    """An iteration asks again and again: what it has pushed so far was not pushed in the step before."""
    solver = ContactSolver(np.zeros((1, 3)), [FLOOR], ContactLaw())
    rises = ObstacleMotion(np.zeros((1, 3)), np.array([[0.0, 0.0, 1e-3]]), np.zeros((1, 3)))  # from rest, at 1 m/s
    still = PointMotion(*np.zeros((3, 1, 3)))
    asked = [solver.solve(still, np.eye(3), 1e-3, rises) for _ in range(3)]
    for found in asked:
        np.testing.assert_allclose(found.forces, [[0.0, 0.0, 0.5]], atol=1e-12)


def test_a_force_of_round_off_has_pushed_nothing():
    """What keeps touching an obstacle that accelerates is asked for another speed; round-off is other on each CPU."""
    still, rises = np.zeros((2, 3)), ObstacleMotion(np.zeros((1, 3)), np.array([[0.0, 0.0, 1e-3]]), np.zeros((1, 3)))
    found = []
    for least in (0.0, 1e-11, 1.0):
        solver = ContactSolver(np.zeros((2, 3)), [FLOOR], ContactLaw())
        solver.search = ContactSearch(np.array([[0.0, 0.0, 240.0], [0.0, 0.0, least]]))
        found.append(solver.solve(PointMotion(still, still, still), np.eye(6), 1e-3, rises).forces[:, 2])
    np.testing.assert_allclose(found, [[0.75, 0.5], [0.75, 0.5], [0.75, 0.75]], atol=1e-12)


def test_a_failed_search_changes_nothing(monkeypatch, numpy_alone):
    """After an error the same step comes out as if there had been none."""

    def fails(*arguments):
        raise StepError("no")

    law, points = ContactLaw(friction=0.5), [[0, 0, 0], [1, 0, 0]]
    first, second = (Points(points, [FLOOR], law, 1e-3, force=(1, 0, -G), v=(1, 0, 0)) for _ in range(2))
    for body in (first, second):
        body.step()
    with monkeypatch.context() as patch:
        patch.setattr(contact_solver, "solve", fails)
        with pytest.raises(StepError, match="no"):
            first.step()
    np.testing.assert_array_equal(first.step().x, second.step().x)
    assert first.resolution.iterations == second.resolution.iterations


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"restitution": 1.1}, r"restitution: use a number in \[0, 1\]"),
        ({"restitution": float("nan")}, "restitution"),
        ({"friction": -0.1}, "friction: use a finite number >= 0"),
        ({"stiffness": 0.0}, "stiffness: use a finite number > 0"),
        ({"damping": 1.0}, "damping acts beside a stiffness"),
        ({"stiffness": 1.0, "restitution": 0.5}, "restitution belongs to the rigid law"),
    ],
)
def test_laws_out_of_range_are_refused(arguments, says):
    with pytest.raises(SceneError, match=says):
        ContactLaw(**arguments)


def rubbed(h=2e-3, friction=0.5, P=4):
    """Points on a floor that move apart, and that dampers stop within a step: friction that stops them would help."""
    across = np.array([[1.0, 0.3, 0.0], [-0.7, 0.5, 0.0], [0.2, -1.0, 0.0], [-0.4, 0.1, 0.0]])
    body = Points(
        np.column_stack([np.arange(P), np.zeros(P), np.zeros(P)]), [FLOOR], ContactLaw(friction=friction), h,
        K=chain(P, 1e3), D=chain(P, 4e3), force=(0, 0, -G),
    )  # fmt: skip
    body.x = 2e-3 * (np.arange(P)[:, None] * [1.0, 0.4, 0.0]).ravel()  # springs pull, too
    body.v = 0.2 * across.ravel()
    return body


@pytest.mark.parametrize("friction", [0.5, 5.0])
def test_forces_of_what_sticks_come_to_rest(friction):
    """Points that stick swing to and fro no more, nor do forces; nothing creeps, and friction gives no energy."""
    body, forces, moved = rubbed(friction=friction), [], []
    for _ in range(400):
        before = body.x.copy()
        body.step()
        moved.append(np.abs(body.x - before).max())
        forces.append(body.resolution.forces.copy())
        assert body.accounts[-1].friction >= -1e-12 * body.energy
    assert np.abs(forces[1] - forces[0]).max() > 0.05 * G
    assert np.abs(forces[-1] - forces[-2]).max() <= 1e-9 * G
    assert np.abs(forces[-1][:, :2]).max() > 1e-3 * G
    assert max(moved[-10:]) <= 1e-16
    assert np.abs(body.v).max() <= 1e-9 * G * 2e-3


def test_friction_stops_as_much_as_it_can_without_doing_work():
    """What swings is asked for the largest share of its stop at which friction does no work, but in its first step."""
    body, shares = rubbed(friction=5.0), []
    for _ in range(100):
        body.step()
        found = body.contact.last_step()[1]
        braking, problem = found.pairs.braking, found.problem
        work = (found.forces[1:] * (found.velocities[1:] + problem.sliding)).sum()
        scale = np.abs(found.forces).max() * np.abs(problem.q).max()
        assert work <= 1e-12 * scale
        shares.append(braking.share)
        if braking.by_share is None:
            continue
        by_share = braking.by_share[:, found.active]
        assert work >= -1e-9 * np.abs(found.forces[1:] * by_share).sum() - 1e-12 * scale
        more, q = problem.sliding + 1e-3 * by_share, problem.q.copy()
        q[1:] -= 1e-3 * by_share
        forces, velocities = solve(problem.operator, q, 5.0, found.forces)[:2]
        assert (forces[1:] * (velocities[1:] + more)).sum() > 1e-12 * scale
    assert shares[:10] == 10 * [0.0]  # until then of what friction would help nothing is asked
    assert sum(0 < share < 1 for share in shares) >= 2
    assert set(shares[-10:]) == {1.0}


@pytest.mark.parametrize("seed", [315, 319, 327])
def test_what_friction_stops_does_not_depend_on_which_pair_is_found_first(seed):
    """Friction is judged by its power on all pairs that take part, also those that only forces on others bring in."""
    random, still = np.random.default_rng(seed), ObstacleMotion(*np.zeros((3, 1, 3)))
    A = random.normal(size=(6, 6))
    W, v = A @ A.T + 0.1 * np.eye(6), random.normal(size=(2, 3)) * [1, 1, 0.1]
    points, found = PointMotion(np.zeros((2, 3)), v, random.normal(size=(2, 3))), []
    for settled in (None, known := Settled(), known):  # the second sweep knows which pairs take part
        known.begin_sweep() if settled else None
        solver = ContactSolver(np.zeros((2, 3)), [FLOOR], ContactLaw(friction=0.8))
        found.append(solver.solve(points, W, 1e-2, still, settled=settled))
    np.testing.assert_allclose(found[0].forces, found[2].forces, atol=1e-9)


@pytest.mark.parametrize(("tried", "last"), [(-1.0, -3.0), (-1.2, -0.5)], ids=["pressed", "apart"])
def test_a_sweep_decides_what_the_last_forces_of_actuators_do(tried, last):
    """A cable that was tried, and would have pushed, says neither what leaves again nor what takes part."""
    still, down, settled = ObstacleMotion(*np.zeros((3, 1, 3))), np.array([[0.0, 0.0, -1.0]]), Settled()

    def force(speed, known):
        """On a point that falls at 1 m/s, 6 mm above the floor in a step of 10 ms, and would go on at a speed."""
        solver = ContactSolver([[0, 0, 6e-3]], [FLOOR], ContactLaw(restitution=0.5))
        points = PointMotion(0 * down, down, -speed * down)
        found = solver.solve(points, np.eye(3), 1e-2, still, settled=known)
        return 0.0 if found is None else found.forces[0, 2]

    expected = max(-0.55 - last, 0.0) if last < -0.55 else 0.0  # of what is pressed, or is not due
    settled.begin_sweep()
    assert force(tried, settled) == pytest.approx(-0.25 - tried)  # of what leaves again
    assert force(last, settled) == pytest.approx(expected)
    settled.begin_sweep()
    assert force(last, settled) == pytest.approx(expected)


def test_each_pair_is_told_to_help_but_once():
    """What has no target any more is not asked again, whatever round-off is left: so the search ends."""
    pairs, friction, slip = np.arange(2), np.array([[1.0, 1.0], [0.0, 0.0]]), np.full((2, 2), 1e-9)

    def helping(targets, slip=slip):
        braking = Braking(np.array(targets), None)
        again = braking.asks_less(pairs, friction, slip, 1e-12, lambda change: (change, change))
        return None if braking.helped is None else braking.helped.tolist(), again, braking.targets.any(axis=0).tolist()

    assert helping([[0.1, 0.1], [0.0, 0.0]]) == ([True, True], True, [False, False])
    assert helping([[0.0, 0.1], [0.0, 0.0]]) == ([False, True], True, [False, False])
    assert helping([[0.0, 0.0], [0.0, 0.0]]) == (None, False, [False, False])
    assert helping([[0.0, 0.1], [0.0, 0.0]], slip - [[0.2], [0.0]]) == (None, False, [False, True])


def test_forces_that_are_off_by_less_than_matters_are_not_told():
    search = ContactResidual().with_step(1e-8)
    assert search == ContactResidual(1, 1e-8)
    assert search.message == ""
    assert "in 2 steps contact forces were not found exactly (the worst leave 1e-05" in search.with_step(1e-5).message


@pytest.mark.parametrize("touched", [0, 1, 5, 20])
def test_what_forces_on_few_points_move_is_what_the_whole_operator_says(touched):
    """To round-off of a sum."""
    random = np.random.default_rng(touched)
    root, forces = random.normal(size=(60, 60)), np.zeros((20, 3))
    W = root @ root.T
    forces[random.permutation(20)[:touched]] = random.normal(size=(touched, 3))
    np.testing.assert_allclose(moved_by(W, forces), W @ forces.ravel(), rtol=0, atol=1e-13 * np.abs(W).sum())
