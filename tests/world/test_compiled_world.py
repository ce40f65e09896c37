"""Compiled steps of worlds are those of NumPy: the same law of all pairs, the same bodies, the same runs."""

from contextlib import contextmanager, nullcontext
from functools import partial
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from in_blocks import in_blocks, made_as_a_whole, whole_part
from test_soft_motion import CLAMPED, LIES, TOUCHED, momenta, reduced
from test_soft_parts import ROPE

import fenics_rom as fr
from fenics_rom.compilation import compiled, jit, numpy_alone
from fenics_rom.mechanics import kept_rows
from fenics_rom.mechanics.braking import SWINGS, Braking
from fenics_rom.mechanics.compiled import contact_law
from fenics_rom.mechanics.compiled.contact_law import FOUND, NOTHING, OTHERWISE, Law, pairs_from
from fenics_rom.mechanics.compiled.coulomb import frame_along
from fenics_rom.mechanics.compiled.newton import in_one_piece
from fenics_rom.mechanics.frame_motion import quaternion_of_vector
from fenics_rom.mechanics.placed_surface import PlacedSurface
from fenics_rom.mechanics.rounded_surface import rounding_of
from fenics_rom.rom import block_rows
from fenics_rom.runtime.steppers import residual_motion
from fenics_rom.world.bodies import NO_POINTS, NO_ROWS, Points
from fenics_rom.world.collision.soft_surfaces import soft_on_soft
from fenics_rom.world.compiled import rigid_bodies
from fenics_rom.world.contact_step import Pairs, _Asked, _law
from fenics_rom.world.guide import Guide
from fenics_rom.world.joints import ball
from fenics_rom.world.rigid import Rigid
from fenics_rom.world.shapes import Box, Capsule, HalfSpace, Sphere

pytestmark = [
    pytest.mark.skipif(not compiled(), reason="numba is not installed, or turned off"),
    pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning"),
]
H, EPS = 2e-3, float(np.finfo(float).eps)
attempt, look_at_answers = map(jit, (rigid_bodies.attempt, rigid_bodies.look_at_answers))
add_answers, inverse_with = map(jit, (rigid_bodies.add_answers, rigid_bodies.inverse_with))
take_back = jit(rigid_bodies.take_back)
seeds = st.integers(0, 2**32 - 1)


def units(random, count):
    vectors = random.normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1)[:, None]


@given(seeds)
@settings(deadline=None, max_examples=100)
def test_the_law_of_pairs_is_that_of_numpy(seed):
    """W is not quite symmetric, as where bodies turn; each pair has a friction of its own, some have none."""
    random = np.random.default_rng(seed)
    C = random.integers(1, 12)
    A = random.normal(size=(3 * C, 3 * C))
    W = A @ A.T / (3 * C) + 0.3 * np.eye(3 * C)
    W = 1e-3 * (W + 1e-3 * (A - A.T))
    normals, free, sliding = units(random, C), *random.normal(size=(2, C, 3))
    friction = random.choice([0.0, 0.3, 0.8], C)
    sliding -= (normals * sliding).sum(axis=1)[:, None] * normals
    sliding *= (friction > 0)[:, None] * random.choice([0.0, 1.0])
    level, target = random.normal(size=C), -np.abs(random.normal(size=C))
    start = random.uniform(0, 300, (C, 3))
    swung = random.integers(0, SWINGS + 3, C)
    asked = _Asked(level, target[:, None] * normals, sliding, Braking(sliding.T.copy(), swung), np.zeros(C, dtype=bool))
    none = np.zeros(C, dtype=bool)
    asked_pairs = Pairs((), *np.zeros((2, C, 3)), normals, np.zeros(C), friction, np.zeros(C), *[none] * 5)
    expected = _law(asked_pairs, Guide(W, ~none), free, start, asked)
    pairs = pairs_from(start, friction)
    pairs.axes[:, 0], pairs.level[:], pairs.helped[:] = normals, level, False
    for axes in pairs.axes:
        frame_along(axes)
    pairs.free[:], pairs.relative[:] = (np.einsum("cij,cj->ci", pairs.axes, of) for of in (free, 2 * sliding))
    pairs.target[:] = pairs.relative / 2
    pairs.target[:, 0] = target
    pairs.chosen[:] = pairs.free[:, 0] < level
    law = Law(H, 0.0, float(friction.max()), 0.0, 0.0, False, SWINGS, np.inf)
    inverse = np.linalg.inv(W.T) if random.random() < 0.5 else np.empty((0, 0))
    known = in_one_piece(inverse)
    status = jit(contact_law.find_forces)(law, np.ascontiguousarray(W.T), known, C, swung, pairs).status
    if status == OTHERWISE:
        assert asked.braking.swinging is not None
        return
    assert status in (FOUND, NOTHING)
    found = pairs.forces if status == FOUND else 0 * pairs.forces
    stopped = max(np.abs(free - target[:, None] * normals - sliding).max(), 1e-3)
    np.testing.assert_array_equal(pairs.chosen, asked.chosen)
    np.testing.assert_array_equal(pairs.helped, none if asked.braking.helped is None else asked.braking.helped)
    np.testing.assert_allclose((found - expected).ravel() @ W.T, 0.0, atol=1e-9 * stopped)


def random_bodies(random, count):
    bodies = []
    for _ in range(count):
        box = Box(random.uniform(0.05, 0.2, 3))
        mass, inertia = box.inertia(1000.0)
        pose = fr.BaseState(
            random.normal(size=3), quaternion_of_vector(random.normal(size=3)), *random.normal(size=(2, 3))
        )
        bodies.append(Rigid(box, mass, inertia, pose, random.normal(size=3)))
        bodies[-1].take({"force": random.normal(size=3), "torque": 1e-2 * random.normal(size=3)})
        bodies[-1].begin(H)
    return bodies


@given(seeds)
@settings(deadline=None, max_examples=50)
def test_rigid_bodies_answer_as_in_numpy(seed):
    random = np.random.default_rng(seed)
    bodies, C, n = random_bodies(random, 3), 7, 9  # contacts, then joints
    ends = np.array([random.choice([-1, 0, 1, 2], 2, replace=False) for _ in range(n)])
    places = np.array([bodies[max(end)]._p for end in ends]) + random.uniform(-0.1, 0.1, (n, 3))
    forces, arms = random.normal(size=(n, 3)), random.uniform(-0.1, 0.1, (n, 2, 3))
    stacked = rigid_bodies.RigidBodies(
        np.array([body.mass for body in bodies]),
        np.array([body.inertia for body in bodies]),
        np.array([body.begun[0] for body in bodies]),
        *(np.array([body.begun[k] for body in bodies]) for k in (1, 2)),
    )
    in_turn = np.empty(0, dtype=int), np.arange(3)
    pushed = rigid_bodies.Pushed(C, ends, places, arms, np.linalg.inv(stacked.inertia), np.zeros(n, bool), *in_turn)
    tries, u, W = np.empty((3, 4, 3)), np.zeros((n, 3)), np.zeros((3 * n, 3 * n))
    fastest = attempt(stacked, H, pushed, forces, tries, u)
    maps, answers = np.empty((3, 6, 3 * n)), np.empty((3, 6, 6))
    look_at_answers(stacked, H, pushed, tries, maps, answers)
    add_answers(maps, answers, C, np.zeros(W.shape), W)
    expected, expected_W, speeds = np.zeros((n, 3)), np.zeros(W.shape), []
    for number, body in enumerate(bodies):
        rows, sides = np.nonzero(ends == number)
        signs = np.where(sides == 0, 1.0, -1.0)[:, None]
        held = arms[rows, sides][rows >= C]
        points = Points(np.empty((len(rows), 0), int), np.empty((len(rows), 0)), held, NO_POINTS.follows, NO_ROWS)
        velocities = body.attempt(points, places[rows], signs * forces[rows])
        expected[rows] += signs * velocities
        speeds.append(np.abs(velocities).max(initial=0.0))
        axes, sign = (3 * rows[:, None] + np.arange(3)).ravel(), np.repeat(signs, 3)
        expected_W[axes[:, None], axes] += sign[:, None] * body.delassus(points, places[rows]) * sign
        for known, of in zip(body._try[:4], tries[number], strict=True):
            np.testing.assert_allclose(of, known, atol=1e4 * EPS * max(1.0, np.abs(known).max()))
    np.testing.assert_allclose(u, expected, atol=1e3 * EPS * max(speeds))
    np.testing.assert_allclose(fastest, max(speeds), rtol=1e3 * EPS)
    of_contacts, k = W[: 3 * C, : 3 * C], 3 * C
    A = random.normal(size=of_contacts.shape)
    own = 1e-2 * (A @ A.T + np.eye(k))
    inverse = inverse_with(np.linalg.inv(own), maps[:, :, :k].copy(), answers)
    condition = np.linalg.cond(own + of_contacts) * np.linalg.cond(own)
    whole = inverse.whole - inverse.left.T @ inverse.right
    np.testing.assert_allclose(whole @ (own + of_contacts), np.eye(k), atol=1e3 * EPS * condition)
    moved, back = (W.T @ forces.ravel()).reshape(-1, 3), np.zeros((n, 3))
    take_back(maps, answers, C, forces, back)
    np.testing.assert_allclose(-back, moved, atol=1e3 * EPS * np.abs(moved).max())
    np.testing.assert_allclose(W.T, expected_W, atol=1e3 * EPS * np.abs(expected_W).max())


@pytest.fixture(scope="module")
def held(tmp_path_factory):
    return reduced(tmp_path_factory.mktemp("held"), frame="fixed", **CLAMPED, **TOUCHED)


def beam_and_boxes(rom):
    """Two boxes, the first of their pairs, land on a beam, turning, and slide; one flies by, and a table is below."""
    size = (0.05, 0.05, 0.04)
    bodies = {
        "table": fr.RigidBody(
            Box((0.4, 0.4, 0.02)), motion=lambda time: LIES._replace(position=np.array([0.15, 0.015, -0.05]))
        ),
        "low": fr.RigidBody(Box(size), mass=0.03, position=(0.2, 0.02, 0.045), velocity=(0.3, 0.0, -0.2)),
        "high": fr.RigidBody(
            Box(size),
            mass=0.02,
            position=(0.25, 0.01, 0.1),
            velocity=(-0.2, 0.1, 0.0),
            angular_velocity=(2.0, 3.0, 1.0),
        ),
        "beam": fr.SoftBody(rom),
        "away": fr.RigidBody(Box(size), mass=0.02, position=(5.0, 0.0, 0.0)),
    }
    return fr.World(bodies, dt=1e-3, gravity=(0, 0, -9.81), friction=0.4, restitution=0.2)


def told(world):
    """Numbers of a world."""
    of_bodies = [np.concatenate([*map(np.ravel, world.pose(name))]) for name in world.names]
    account = world.ledger
    forces = [world.force_between(*pair) for pair in combinations(world.names, 2)]
    for pair in combinations(world.names, 2):
        places, pushes = world.contact_forces(*pair)
        forces.append(pushes.sum(axis=0))
        assert places.shape == pushes.shape
        np.testing.assert_array_equal(world.contact_forces(*pair[::-1])[1], -pushes)
    numbers = [world.energy, account.dissipated, account.supplied, account.contact, account.friction]
    return np.concatenate([*of_bodies, *(np.ravel(of) for of in told_of_soft(world)), *forces, numbers])


def told_of_soft(world):
    for name, record in world.bodies.items():
        if isinstance(record, fr.SoftBody):
            body = world.simulator(name)
            yield from (*body.state, body.contact_forces(), [world.account(name).obstacles])
            yield from body.base_wrench or ()
            yield from body.nodal_contact[1:]
            yield body.integrator.reactions


def assert_closes(world, start, steps):
    """The account does, but for round-off of each step."""
    account = world.ledger
    gap = world.energy - start - account.supplied + account.dissipated + account.lost_in_switching + account.numerical
    assert abs(gap) < 10 * steps * EPS * max(start, world.energy, abs(account.supplied), account.dissipated)


def both(make):
    """A world whose steps compiled functions take, and one of NumPy."""
    one = make()
    with numpy_alone():
        return one, make()


def each(worlds):
    """Both, the second where nothing compiles: also what is made anew."""
    yield worlds[0]
    with numpy_alone():
        yield worlds[1]


@pytest.fixture(scope="module")
def relaxing(tmp_path_factory):
    """By branches slower and faster than a step."""
    series = {"effects.viscoelasticity": "ratios = [0.5, 0.3]\ntimes = [0.02, 2e-4]"}
    return reduced(tmp_path_factory.mktemp("relaxing"), frame="fixed", **series, **CLAMPED, **TOUCHED)


@pytest.fixture(scope="module")
def pulled(tmp_path_factory):
    """By the stroke of a rope that rubs at two guides; the material relaxes."""
    rope = {"effects.tendon.rope": f'{ROPE}\ncontrol = "length"', "effects.tendon_friction": "coefficient = 0.3"}
    series = {"effects.viscoelasticity": "ratios = [0.5, 0.3]\ntimes = [0.02, 2e-4]"}
    return reduced(tmp_path_factory.mktemp("pulled"), frame="fixed", **rope, **series, **CLAMPED, **TOUCHED)


@pytest.mark.parametrize("kind", ["held", "relaxing", "pulled"])
def test_a_run_is_that_of_numpy(kind, request):
    """Boxes fall on a beam: 150 steps, most of which compiled functions take."""
    rom = request.getfixturevalue(kind)
    worlds, touching = both(lambda: beam_and_boxes(rom)), 0
    starts, held = [world.energy for world in worlds], 0
    for step in range(150):
        inputs = {"beam": {"rope": 1e-3 * np.sin(0.04 * step) + 2e-4 * np.sin(0.3 * step)}} if kind == "pulled" else {}
        for world in worlds:
            world.step(inputs)
        held += worlds[1].simulator("beam").integrator.reactions.any()
        touching = max(touching, worlds[0].touching)
        np.testing.assert_allclose(told(worlds[0]), told(worlds[1]), atol=1e-8)
    for world, start in zip(worlds, starts, strict=True):
        assert_closes(world, start, 150)
    kernels = [world.simulator("beam").integrator.kernel for world in worlds]
    np.testing.assert_allclose(*(kernel.auxiliary for kernel in kernels), atol=1e-8)
    assert touching > 3
    assert (0.2 * 150 < held < 0.8 * 150) == (kind == "pulled")
    assert worlds[0].compiled_steps > 0.7 * 150


@pytest.fixture(scope="module")
def carried(tmp_path_factory):
    base = {"effects.base_path": "origin = [0.0, 0.015, 0.01]"}
    return reduced(tmp_path_factory.mktemp("carried"), frame="moving", **base, **CLAMPED, **TOUCHED)


def ridden(rom, seed):
    """A world in which a beam on a hand that moves and turns at random carries what lies and falls on it."""
    random = np.random.default_rng(seed)
    (reach, turn), (ω, ν) = random.uniform(-1, 1, (2, 3)), random.uniform(5, 30, (2, 3))

    def motion(time):
        angle, rate = 0.3 * turn * np.sin(ν * time), 0.3 * turn * ν * np.cos(ν * time)
        place, velocity = 5e-3 * reach * np.sin(ω * time), 5e-3 * reach * ω * np.cos(ω * time)
        return fr.BaseState(place, quaternion_of_vector(angle), velocity, rate)

    shape = [Sphere(0.02), Box((0.05, 0.03, 0.04)), Capsule(0.015, 0.03)][random.integers(3)]
    high = 0.011 + {Sphere: 0.02, Box: 0.02, Capsule: 0.03}[type(shape)]
    bodies = {
        "hand": fr.RigidBody(Box((0.02, 0.05, 0.05)), motion=motion),
        "beam": fr.SoftBody(rom, on="hand", position=(0.02, 0.0, 0.0)),
        "rides": fr.RigidBody(shape, mass=0.02, position=(random.uniform(0.15, 0.25), 0.0, high)),
        "falls": fr.RigidBody(Box((0.03, 0.03, 0.03)), mass=0.01, position=(0.1, 0.0, 0.04), velocity=(0.0, 0.0, -0.3)),
        "ground": fr.RigidBody(HalfSpace(), motion=LIES._replace(position=np.array([0.0, 0.0, -0.3]))),
    }
    laws = {"friction": random.choice([0.0, 0.5]), "restitution": random.choice([0.0, 0.4])}
    return fr.World(bodies, dt=1e-3, gravity=(0, 0, -9.81), apart=[("hand", "rides", "falls", "ground")], **laws)


@pytest.mark.parametrize("seed", range(6))
def test_what_rides_on_a_carried_body_does_as_with_numpy(carried, seed):
    """Motion, forces, wrench of the base and account; either takes over from the other."""
    random, worlds = np.random.default_rng(seed), both(lambda: ridden(carried, seed))
    start = worlds[0].energy
    for step in range(60):
        with nullcontext() if random.random() < 0.8 else without(worlds[0]):
            worlds[0].step()
        worlds[1].step()
        if step % 5 == 4:
            np.testing.assert_allclose(told(worlds[0]), told(worlds[1]), atol=1e-8)
    assert_closes(worlds[0], start, 60)
    assert worlds[0].compiled_steps > 0.4 * 60


@pytest.fixture(scope="module")
def free(tmp_path_factory):
    return reduced(tmp_path_factory.mktemp("free"), frame="moving", **TOUCHED)


def upside_down(angle):
    """Turned about x, and by twice an angle about z: so that its top looks down."""
    return np.array([0.0, np.cos(angle), np.sin(angle), 0.0])


def flying(rom, random):
    """Two free beams fly and turn into each other, a ball or a box into both, and another box; nothing else acts."""
    shape = [Box((0.05, 0.05, 0.04)), Sphere(0.025)][random.integers(2)]
    bodies = {
        "low": fr.SoftBody(rom, position=(0.0, 0.0, 0.0), angular_velocity=random.uniform(-3, 3, 3)),
        "high": fr.SoftBody(
            rom,
            position=(0.1, 0.01, 0.026),
            rotation=upside_down(random.uniform(-0.4, 0.4)),
            velocity=(0.0, 0.05, -0.4),
            angular_velocity=random.uniform(-3, 3, 3),
        ),
        "flies": fr.RigidBody(
            shape,
            mass=0.05,
            position=(-0.1, 0.0, 0.045),
            velocity=(0.1, 0.0, -0.5),
            angular_velocity=random.uniform(-4, 4, 3),
        ),
        "ahead": fr.RigidBody(Box((0.05, 0.05, 0.02)), mass=0.03, position=(0.2, 0.0, 0.0), velocity=(-0.3, 0.0, 0.0)),
    }
    return fr.World(bodies, dt=1e-3, friction=random.choice([0.0, 0.5]), restitution=random.choice([0.0, 0.4]))


@pytest.mark.parametrize("seed", range(4))
def test_free_bodies_that_meet_do_as_with_numpy(free, seed):
    """Motion, forces and account; momenta stay to round-off, and either takes over from the other."""
    random, worlds = np.random.default_rng(seed), both(lambda: flying(free, np.random.default_rng(seed)))
    start, before, touching = worlds[0].energy, np.concatenate(momenta(worlds[0])), 0
    for step in range(60):
        with nullcontext() if random.random() < 0.8 else without(worlds[0]):
            worlds[0].step()
        worlds[1].step()
        touching = max(touching, worlds[0].touching)
        if step % 5 == 4:
            np.testing.assert_allclose(told(worlds[0]), told(worlds[1]), atol=1e-8)
    gone = worlds[0].ledger
    assert gone.friction + gone.contact > 1e-4 * start
    assert_closes(worlds[0], start, 60)
    np.testing.assert_allclose(np.concatenate(momenta(worlds[0])), before, atol=60 * 10 * EPS * np.abs(before).max())
    assert touching > 1
    assert worlds[0].compiled_steps > 0.5 * 60


def landing(carried, free, seed):
    """A free beam lands on one that a hand carries and moves, a box flies into both, and a table rises below."""
    random = np.random.default_rng(seed)
    reach, turn, ω = random.uniform(-1, 1, 3), random.uniform(-1, 1, 3), random.uniform(5, 30, 3)

    def motion(time):
        angle, rate = 0.2 * turn * np.sin(ω * time), 0.2 * turn * ω * np.cos(ω * time)
        place, velocity = 5e-3 * reach * np.sin(ω * time), 5e-3 * reach * ω * np.cos(ω * time)
        return fr.BaseState(place, quaternion_of_vector(angle), velocity, rate)

    def lowered(time):
        return LIES._replace(position=np.array([0.2, 0.0, -0.1 + 0.1 * time]), velocity=np.array([0.0, 0.0, 0.1]))

    bodies = {
        "hand": fr.RigidBody(Box((0.02, 0.05, 0.05)), motion=motion),
        "beam": fr.SoftBody(carried, on="hand", position=(0.02, 0.0, 0.0)),
        "table": fr.RigidBody(Box((0.5, 0.5, 0.02)), motion=lowered),
        "lands": fr.SoftBody(
            free, position=(0.2, 0.0, 0.027), rotation=upside_down(random.uniform(-0.1, 0.1)), velocity=(0.0, 0.0, -0.5)
        ),
        "box": fr.RigidBody(Box((0.04, 0.04, 0.02)), mass=0.02, position=(0.4, 0.0, 0.0), velocity=(-0.8, 0.0, 0.2)),
    }
    apart = [("hand", "lands"), ("hand", "box"), ("hand", "table"), ("beam", "table")]
    return fr.World(bodies, dt=1e-3, gravity=(0, 0, -9.81), friction=0.4, apart=apart)


@pytest.mark.parametrize("seed", range(3))
def test_a_free_body_on_a_carried_one_does_as_with_numpy(carried, free, seed):
    random, worlds = np.random.default_rng(seed), both(lambda: landing(carried, free, seed))
    start, touching = worlds[0].energy, 0
    for step in range(60):
        with nullcontext() if random.random() < 0.8 else without(worlds[0]):
            worlds[0].step()
        worlds[1].step()
        touching = max(touching, worlds[0].touching)
        if step % 5 == 4:
            np.testing.assert_allclose(told(worlds[0]), told(worlds[1]), atol=1e-8)
    assert_closes(worlds[0], start, 60)
    assert touching > 1
    assert worlds[0].compiled_steps > 0.5 * 60


def test_bodies_that_go_back_to_saved_states_do_as_with_numpy(carried, free):
    worlds = both(lambda: landing(carried, free, 2))
    saved = [{}, {}]
    for step in range(45):
        for world, states in zip(worlds, saved, strict=True):
            for name in ("beam", "lands"):
                if step == 20:
                    states[name] = world.simulator(name).save()
                if step == 30:
                    world.simulator(name).restore(states[name])
            world.step()
        if step % 5 == 4:
            np.testing.assert_allclose(told(worlds[0]), told(worlds[1]), atol=1e-8)


@given(seeds)
@settings(deadline=None, max_examples=50)
def test_surfaces_meet_as_with_numpy(seed):
    """Points of wavy patches near one another, and in one another."""
    random = np.random.default_rng(seed)
    rows = np.arange(36).reshape(6, 6)
    a, b, c, d = (rows[i : 5 + i, j : 5 + j].ravel() for i, j in ((0, 0), (1, 0), (1, 1), (0, 1)))
    triangles = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    flat = np.stack([*np.meshgrid(np.linspace(0, 0.1, 6), np.linspace(0, 0.1, 6), indexing="ij"), np.zeros((6, 6))])
    flat = flat.reshape(3, -1).T
    surfaces = []
    for height, order in ((0.0, [0, 1, 2]), (random.uniform(-0.008, 0.01), [0, 2, 1])):
        places = flat + random.uniform(-0.003, 0.003, flat.shape) + [0.0, 0.0, height]
        rest = flat + random.choice([0.0, 3e-3]) * random.uniform(-1, 1, flat.shape)
        rounding = rounding_of(rest, triangles[:, order]) if random.random() < 0.8 else None
        surfaces.append(PlacedSurface(places, triangles[:, order], np.arange(36), rounding=rounding))
    found = soft_on_soft(*surfaces, 0.006)
    with numpy_alone():
        expected = soft_on_soft(*surfaces, 0.006)
    for side, known in ((found.first, expected.first), (found.second, expected.second)):
        np.testing.assert_array_equal(side.feature, known.feature)
        np.testing.assert_allclose(side.arms, known.arms, atol=1e3 * EPS)
        np.testing.assert_allclose(side.weights, known.weights, atol=1e-9)
    np.testing.assert_allclose(found.gaps, expected.gaps, atol=1e3 * EPS)
    np.testing.assert_allclose(found.normals, expected.normals, atol=1e-9)


@contextmanager
def without(world):
    """A step of NumPy."""
    loops, world._loops = world._loops, None
    if loops.is_ahead:
        world._found = loops.found
        loops.tell_all()
    yield
    world._loops = loops


def test_bodies_that_are_joined_and_let_go_are_those_of_numpy(held):
    worlds = both(lambda: beam_and_boxes(held))
    for step in range(60):
        for world in each(worlds):
            if step == 30:
                world.join(ball("low", "high", world.pose("low").position, name="rope"))
            if step == 40:
                world.release("rope")
            world.step()
        np.testing.assert_allclose(told(worlds[0]), told(worlds[1]), atol=1e-8)
    assert worlds[0].compiled_steps > 0.7 * 60


def test_another_step_and_inputs_are_those_of_numpy(held):
    worlds = both(lambda: beam_and_boxes(held))
    for step in range(40):
        for world in each(worlds):
            world.dt = 1e-3 if step < 20 else 5e-4
            world.step({"low": {"force": [0.1, 0.0, 0.0]}, "away": {"torque": [0.0, 1e-4, 0.0]}} if step % 2 else {})
    np.testing.assert_allclose(told(worlds[0]), told(worlds[1]), atol=1e-8)
    for inputs in ({"nobody": {}}, {"table": {"force": [1.0, 0.0, 0.0]}}, {"low": {"force": [1.0, "x", 0.0]}}):
        before, told_by = told(worlds[0]), []
        for world in each(worlds):
            with pytest.raises(fr.StepError) as caught:
                world.step(inputs)
            told_by.append(str(caught.value))
        assert told_by[0] == told_by[1]
        np.testing.assert_array_equal(told(worlds[0]), before)


def turned_in_time(start, stop):
    """Where a table is, which turns at 1 rad/s, and is told to jump by 3 rad after a time, s."""

    def motion(time):
        angle = time if time < start else time + (3.0 if time < stop else 0.0)
        turn, rate = quaternion_of_vector(np.array([0.0, 0.0, angle])), np.array([0.0, 0.0, 1.0])
        return fr.BaseState(np.array([0.15, 0.015, -0.05]), turn, np.zeros(3), rate)

    return motion


COUNTS = 1, 30, 7, 2, 70, 40


def soft_bodies(world):
    """Their names."""
    return [name for name, body in world.bodies.items() if isinstance(body, fr.SoftBody)]


def pinned(rom):
    """Boxes on a beam, one of which a rope holds for a while."""
    world = beam_and_boxes(rom)
    rope = ball("low", "high", world.pose("low").position, name="rope", start=0.0205, stop=0.061)
    return fr.World(world.bodies, 1e-3, gravity=(0, 0, -9.81), friction=0.4, joints=[rope])


@pytest.mark.parametrize("kind", ["boxes", "ridden", "joined", "free"])
def test_many_steps_are_those_one_by_one(request, kind):
    """To the last bit; accounts are summed otherwise."""
    made = {
        "boxes": lambda: beam_and_boxes(request.getfixturevalue("held")),
        "ridden": lambda: ridden(request.getfixturevalue("carried"), 1),
        "joined": lambda: pinned(request.getfixturevalue("held")),
        "free": lambda: flying(request.getfixturevalue("free"), np.random.default_rng(1)),
    }
    worlds = made[kind](), made[kind]()
    name = {"ridden": "falls", "free": "flies"}.get(kind, "low")
    for count in COUNTS:
        inputs = {name: {"force": [1e-3 * count, 0.0, 0.0]}}
        worlds[0].step(inputs, count)
        for _ in range(count):
            worlds[1].step(inputs)
        for body in worlds[0].names:
            for one, other in zip(worlds[0].pose(body), worlds[1].pose(body), strict=True):
                np.testing.assert_array_equal(one, other)
        np.testing.assert_allclose(told(worlds[0]), told(worlds[1]), atol=1e-13)
        assert worlds[0].joints == worlds[1].joints
    assert worlds[0].warnings == worlds[1].warnings
    peaks = [[world.simulator(body).surface_peak for body in soft_bodies(world)] for world in worlds]
    assert peaks[0] == peaks[1]
    assert peaks[0][0].rotation > 0 or kind in ("joined", "free")  # of others it was looked at
    assert (worlds[0].steps, worlds[0].time, worlds[0].compiled_steps) == (
        worlds[1].steps,
        worlds[1].time,
        worlds[1].compiled_steps,
    )
    assert worlds[0].compiled_steps > 0.5 * sum(COUNTS)


def test_of_many_steps_those_before_a_refused_one_are_taken(held):
    """It leaves all as it was, with what is read of the step before; so does a motion that fails."""
    worlds = beam_and_boxes(held), beam_and_boxes(held)
    for world in worlds:
        world.drive("table", turned_in_time(0.0300001, 1.0))  # before the end of the first part of a step that is cut
    with pytest.raises(fr.StepError, match="told to turn by more than"):
        worlds[0].step({}, 50)
    for _ in range(30):
        worlds[1].step()
    assert worlds[0].steps == 30
    assert worlds[1].touching > 1
    np.testing.assert_allclose(told(worlds[0]), told(worlds[1]), atol=1e-13)
    before = told(worlds[1])
    with pytest.raises(fr.StepError, match="told to turn by more than"):
        worlds[1].step()
    np.testing.assert_array_equal(told(worlds[1]), before)

    def fails(time):
        if time > 0.0405:
            raise ValueError("no more")
        return turned_in_time(1.0, 1.0)(time)

    worlds[0].drive("table", fails)
    with pytest.raises(ValueError, match="no more"):
        worlds[0].step({}, 50)
    assert worlds[0].steps == 40


@pytest.mark.parametrize("room", [256, 8])
@pytest.mark.parametrize("kind", ["held", "free on carried"])
def test_residual_compliance_in_blocks_is_that_of_the_whole(kind, room, held, carried, free, monkeypatch):
    """Steps are compiled once rows of what is near are kept; where there is no room for these they are NumPy's."""
    monkeypatch.setattr(block_rows, "MOST", room)
    monkeypatch.setattr(kept_rows, "AT_ONCE", min(room, kept_rows.AT_ONCE))
    made = [in_blocks(rom) for rom in ((held,) if kind == "held" else (carried, free))]
    make = partial(beam_and_boxes, *made) if kind == "held" else partial(landing, *made, 0)
    with monkeypatch.context() as patch:
        patch.setattr(residual_motion, "residual_part", whole_part)
        whole, expected = make(), []
        for _ in range(70):
            whole.step()
            expected.append(told(whole))
    monkeypatch.setattr(block_rows.BlockRows, "whole", made_as_a_whole)
    world, touching = make(), 0
    start = world.energy
    for known in expected:
        world.step()
        touching = max(touching, world.touching)
        np.testing.assert_allclose(told(world), known, atol=1e-8)
    assert touching > 1
    assert_closes(world, start, 70)
    if room == 256:
        assert world.compiled_steps > 0.7 * 70


@pytest.mark.parametrize("count", [0, -1, 2.5, True, "x", None])
def test_no_other_count_is_allowed(held, count):
    for world in (beam_and_boxes(held), fr.World({"beam": fr.SoftBody(held)}, 1e-3)):
        with pytest.raises(fr.StepError, match=r"count = .*use a whole number of steps > 0"):
            world.step({}, count)
        assert world.steps == 0
