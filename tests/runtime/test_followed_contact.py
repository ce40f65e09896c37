"""Contact steps in which all pairs do what they did before take no search, and lead where a search leads."""

from types import SimpleNamespace

import numpy as np
import pytest
from bodies import acted_on, box_arrays, write_arrays

import fenics_rom as fr
from fenics_rom.mechanics import contact_solver
from fenics_rom.mechanics.complementarity import Frames
from fenics_rom.mechanics.complementarity.solution import CONVERGENCE_TOLERANCE
from fenics_rom.mechanics.contact import ContactLaw, ObstacleMotion, PointMotion
from fenics_rom.mechanics.contact_adjoint import ContactAdjoint
from fenics_rom.mechanics.contact_search import ContactSearch
from fenics_rom.mechanics.contact_solver import ContactSolver
from fenics_rom.mechanics.obstacles import HalfSpace, Sphere
from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.runtime.steppers.contact_midpoint import ContactMidpoint
from fenics_rom.runtime.steppers.followed_points import LinearBody, PairsBegun
from fenics_rom.runtime.steppers.steady_pairs import SteadyPairs

NUMPY = pytest.mark.usefixtures("numpy_alone")  # compiled steps search instead
LENGTHS, ORDER, STEPS = (0.3, 0.2, 0.1), 8, 240
FLOOR = '[effects.contact.obstacles.floor]\nshape = "half-space"\npoint = [0, 0, -1e-4]\nnormal = [0, 0, 1]\n'
BALL = '[effects.contact.obstacles.ball]\nshape = "sphere"\ncenter = [0.15, 0.1, -0.5001]\nradius = 0.5\n'
BIG_BALL = BALL.replace("-0.5001", "-20.0001").replace("radius = 0.5", "radius = 20")
WALL = '[effects.contact.obstacles.wall]\nshape = "half-space"\npoint = [0.3001, 0, 0]\nnormal = [-1, 0, 0]\n'
GRAVITY = "gravity = { acceleration = [0, 0, -9.81] }\n"
BODY = "inertia = {}\ndamping = { alpha = 5.0, beta = 2e-3 }\n" + GRAVITY
DAMPED = BODY.replace("alpha = 5.0, beta = 2e-3", "alpha = 100.0, beta = 1e-2")
PUSH = "[effects.prescribed.push]\nsurface = 'top'\n[effects.contact]\nLAW\n"
SPRINGS = 'method = "penalty"\nstiffness = 2e4\ndamping = 5.0'
ROUGH = "[effects.friction]\ncoefficient = 0.4\n"
PARTS = {"outputs": "", "contacts": '[contacts.bottom]\nsurface = "bottom"', "supports": None}

pytestmark = [pytest.mark.filterwarnings("ignore:the surface is", "ignore:.*contact points leave"), NUMPY]


@pytest.fixture(scope="module")
def mesh(tmp_path_factory):
    return write_arrays(tmp_path_factory.mktemp("followed") / "box.msh", *box_arrays(LENGTHS, (3, 2, 1), shake=0.2))


@pytest.fixture(scope="module")
def roms(mesh):
    """By restitution or springs, obstacles and friction."""

    def rom(law, obstacles, rough, body=BODY, parts=PARTS):
        law = law if law == SPRINGS else f"restitution = {law}"
        effects = body + PUSH.replace("LAW", law) + obstacles + (ROUGH if rough else "")
        return fr.reduce(fr.assemble(acted_on(mesh, effects, **parts)), order=ORDER)

    held = GRAVITY, {**PARTS, "supports": 'clamped = ["left"]'}

    cases = {
        "floor": (0.0, FLOOR, True),
        "smooth": (0.5, FLOOR, False),
        "ball": (0.0, BALL, True),
        "smooth ball": (0.0, BALL, False),
        "big ball": (0.0, BIG_BALL, True, DAMPED),
        "shaken": (0.5, BALL, True),
        "corner": (0.0, FLOOR + WALL, True),
        "ball and wall": (0.3, BALL + WALL, True),
        "springs": (SPRINGS, FLOOR, True),
        "resting": (0.0, FLOOR, True, *held),
        "resting on a ball": (0.0, BALL, True, *held),
    }
    return {name: rom(*case) for name, case in cases.items()}


def pushes(rng, weight):
    """Forces that hold for some steps each: down, aside up to what makes the body slide, and sometimes up."""
    held = rng.uniform(-1, 1, (STEPS // 20, 3)) * weight * [0.4, 0.4, 1.0] - [0, 0, 0.3 * weight]
    return lambda t: held[min(round(t / 1e-3 - 0.5) // 20, len(held) - 1)]


def shakes(rng, weight):
    """Forces that swing: friction that has turned the motion round within a step would help."""
    rates, begin = rng.uniform(50, 900, 3), rng.uniform(0, 6, 3)
    size = weight * np.array([*rng.uniform(0.1, 1.0, 2), 0.4])
    return lambda t: size * np.sin(rates * t + begin) - [0, 0, 0.75 * weight]


def run(rom, signals):
    """States and accounts after each step, and how many steps took no search."""
    body, ways = fr.Simulator(rom, 1e-3, signals=signals), []
    solver = body.integrator.interface.solver
    for _ in range(STEPS):
        body.step()
        ways.append((np.concatenate(body.state), [total[0] for total in body.ledger.sums], solver.follows))
    states, sums, followed = zip(*ways, strict=True)
    scale = max(body.energy, np.abs(sums).max())
    spent = body.ledger.dissipated + body.ledger.numerical
    assert abs(body.energy - body.ledger.supplied + spent) <= 1e-12 * scale
    return np.array(states), np.array(sums), np.count_nonzero(followed)


def search_always(changed):
    """Has no step follow the one before."""
    changed.setattr(contact_solver, "follow_contact", lambda *_: None)
    changed.setattr(ContactMidpoint, "_follow_pairs", lambda *_: None)


SEVERAL_RUNS = ["floor", "smooth", "ball", "shaken"]
ONE_RUN = ["smooth ball", "corner", "ball and wall", "springs", "resting", "resting on a ball"]
MOVED = {"carried": ("floor", "floor"), "rolled": ("ball", "ball"), "lifted": ("ball and wall", "ball")}
MOTION = {
    "carried": lambda t: [0.05 * t, 0, 0],
    "rolled": lambda t: [0.02 * np.sin(9 * t), 0, 3e-3 * np.sin(6 * t)],
    "lifted": lambda t: [0, 0, 0.01 * t],
}


@pytest.mark.parametrize("case", [*SEVERAL_RUNS, *ONE_RUN, *MOVED])
def test_steps_that_are_followed_lead_where_searches_lead(roms, case, monkeypatch):
    """To 1e-9, where a search itself is exact to 1e-12 of the velocities; accounts, which add up, to ten times that."""
    name, moved = MOVED.get(case, (case, None))
    rom, followed = roms[name], []
    for seed in range(4 if case in SEVERAL_RUNS else 1):
        signals = {"push": (shakes if case == "shaken" else pushes)(np.random.default_rng(seed), 20.0)}
        if moved is not None:
            signals[moved] = MOTION[case]
        states, sums, count = run(rom, signals)
        with monkeypatch.context() as without:
            search_always(without)
            searched, sums_searched, none = run(rom, signals)
        assert none == 0
        followed.append(count)
        np.testing.assert_allclose(states, searched, atol=1e-9 * np.abs(searched).max(), rtol=0)
        np.testing.assert_allclose(sums, sums_searched, atol=1e-8 * np.abs(sums_searched).max(), rtol=0)
    assert min(followed) > STEPS / 8


STEADY = {"floor": [0.3, 0.1, -5], "smooth": [2, 0, -20], "ball": [2, 0, -20], "smooth ball": [0, 0, -20]}


@pytest.mark.parametrize("case", STEADY)
def test_steady_contact_takes_a_first_look_alone(roms, case, monkeypatch):
    """Neither a search nor any other way to follow, once all has settled."""
    body, others = fr.Simulator(roms[case], 1e-3, signals={"push": STEADY[case]}), []
    follow = contact_solver.follow_contact
    monkeypatch.setattr(contact_solver, "follow_contact", lambda *given: others.append(body.steps) or follow(*given))
    for _ in range(3 * STEPS):
        body.step()
    assert body.integrator.interface.solver.follows
    assert others[0] < STEPS
    assert others[-1] < 2 * STEPS


@pytest.mark.parametrize("push", [[0.3, 0.1, -20], [8, 0, -20], [0.3, 0.1, 30]], ids=["stays", "slides", "leaves"])
def test_where_points_stay_a_ball_is_as_flat_as_its_tangent_planes(roms, push, monkeypatch):
    """To where searches lead, also once they go on, and to the bit after a restart."""
    signals, ways, planes = {"push": [0.3, 0.1, -20]}, [], []
    body = fr.Simulator(roms["big ball"], 1e-3, signals=signals)
    for _ in range(2 * STEPS):
        body.step()
    start, fresh = body.save(), fr.Simulator(roms["big ball"], 1e-3, signals=signals)
    assert start.stepper.search.planes is not None
    for each in (body, fresh, body):
        with monkeypatch.context() as changed:
            if len(ways) == 2:
                search_always(changed)
            each.restore(start)
            each.set_signal("push", push)
            states = []
            for _ in range(STEPS // 2):
                each.step()
                states.append(np.concatenate([*each.state, each.contact_forces().ravel()]))
        ways.append(np.array(states))
        planes.append(each.integrator.interface.solver.search.planes)
    assert (planes[0] is start.stepper.search.planes) == (push == signals["push"])
    assert np.array_equal(ways[0], ways[1])
    np.testing.assert_allclose(ways[0], ways[2], atol=1e-9 * np.abs(ways[2]).max(), rtol=0)


def test_points_that_went_are_no_more_at_tangent_planes(roms):
    """Were they, a body that slides steadily would go on along these, and not around the ball."""
    body = fr.Simulator(roms["big ball"], 1e-3, signals={"push": [0.3, 0.1, -20]})
    for _ in range(2 * STEPS):
        body.step()
    points, u = body.integrator.kernel._at_planes, np.zeros(body.model.inputs.shape[1])
    assert points.begin(u) is not None
    while points.begin(u) is not None:
        body.integrator.rigid_displacement[0] += 1e-15
    counts = []
    for _ in range(3):
        body.step()
        search = body.integrator.interface.solver.search
        assert search.planes is None
        counts.append(search.unturned)
    assert counts == [0, 1, 2], "else planes would be made anew in every other step"


@pytest.mark.parametrize("obstacle", [HalfSpace([0, 0, 0], [0, 0, 1]), Sphere([0.5, 0, -100.0], 100.0)])
def test_a_first_look_misses_no_point_that_forces_on_others_push_down(obstacle):
    """A see-saw: two of its points are pressed on the ground, and what holds them brings down the third."""
    arms = np.array([-1.0, -0.8, 1.0])
    W = 0.01 * np.eye(9)
    W[2::3, 2::3] += 1 + 2 * np.outer(arms, arms)
    points, h, still = np.array([[0, 0, 0], [1, 0, 0], [3, 0, 0]], dtype=float), 1e-3, np.zeros((1, 3))
    gaps, normals = obstacle.distance(points)
    points += (np.array([0, 0, 1e-3]) - gaps)[:, None] * normals
    solver, still = ContactSolver(points, [obstacle], ContactLaw(friction=0.5)), ObstacleMotion(still, still, still)

    def motion(speed):
        return PointMotion(0 * points, 0 * points, np.array([[0.01, 0, -4], [0.01, 0, -4], [0, 0, speed]]))

    def looked_at(speed):
        gaps, normals = obstacle.distance(points)
        frames, none, (key, kept) = Frames(normals), np.empty(0), solver.search.laws[0]
        n, (free,) = frames.lasting_normals, frames.to_lasting_axes(motion(speed).free_velocity)
        outwards, still_yet = free[0] if n is None else (free * n).sum(axis=0), np.zeros(3)
        level, target, _ = solver.rule(h).asks(gaps, gaps.min(), None, still_yet, outwards)
        margin, moves = outwards - level, np.vstack([free, 0 * free])
        if n is None:
            moves[0] += gaps / h / 2
        if n is not None:
            moves = np.vstack([n, still_yet, target, margin, moves])
        begun = PairsBegun(frames, margin, moves, -gaps / h if n is None else None, None)
        model = ContactModel(none, none, np.empty((0, 0)), np.empty((0, 0)), np.empty((0, 0)), none)
        residual = SimpleNamespace(part=SimpleNamespace(operator=np.zeros((9, 9))))
        body = LinearBody(model, h, none, np.empty((9, 0)), W, residual, none, none)
        targets = target, -gaps / h / 2 - target
        of_points = SimpleNamespace(
            body=body, solver=solver, share=0.5, pushed=np.empty((0, 9)), flat_targets=lambda: targets
        )
        chosen = np.frombuffer(key, dtype=bool)
        return SteadyPairs(of_points, key, *solver.operator_of(W, chosen, key), begun).step(begun, kept)

    for _ in range(6):
        contact = solver.solve(motion(2.0), W, h, still)
    assert solver.follows
    assert contact.pairs.tolist() == [0, 1]
    brought_down = (W @ contact.forces.ravel())[8]
    assert brought_down < -0.5
    border = -0.5 - brought_down  # at -0.5 m/s it comes as near in this step as it can be stopped in the next
    assert looked_at(border + 0.01).active.tolist() == [0, 1]
    assert looked_at(border + 0.01).missed is None
    assert looked_at(border - 0.01).missed.tolist() == [False, False, True]
    assert solver.solve(motion(border - 0.01), W, h, still).pairs.tolist() == [0, 1, 2]


@pytest.mark.parametrize(("case", "least"), [("big ball", 100), ("ball and wall", 10)])
def test_where_forces_bring_others_too_near_a_step_need_not_search(roms, case, least, monkeypatch):
    """As a body slides some points rise but for forces on others: they touch by these alone."""
    missed, searched, states, solve = [], [], [], contact_solver.solve
    beside = ContactSearch.beside
    monkeypatch.setattr(ContactSearch, "beside", lambda *given: missed.append(body.steps) or beside(*given))
    monkeypatch.setattr(contact_solver, "solve", lambda *given: searched.append(body.steps) or solve(*given))
    for searches in (False, True):
        with monkeypatch.context() as changed:
            if searches:
                search_always(changed)
            body = fr.Simulator(roms[case], 1e-3, signals={"push": [20.0, 5.0, -50.0]})
            for _ in range(STEPS):
                body.step()
            states.append(np.concatenate(body.state))
        if not searches:
            assert len(missed) >= least
            assert len(set(missed) - set(searched)) >= least / 2
    np.testing.assert_allclose(*states, atol=1e-9 * np.abs(states[1]).max(), rtol=0)


@pytest.mark.parametrize("case", ["floor", "smooth", "ball"])
def test_followed_steps_of_a_restored_body_are_the_same_to_the_bit(roms, case):
    """What is kept besides to take them faster says nothing that the state does not."""
    signals, ways = {"push": pushes(np.random.default_rng(0), 20.0)}, []
    body = fr.Simulator(roms[case], 1e-3, signals=signals)
    for _ in range(STEPS // 4):
        body.step()
    start, fresh = body.save(), fr.Simulator(roms[case], 1e-3, signals=signals)
    for each in (body, fresh, body):
        each.restore(start)
        states = []
        for _ in range(STEPS // 2):
            each.step()
            states.append(np.concatenate([*each.state, each.contact_forces().ravel()]))
        ways.append([np.array(states), each.ledger.sums])
    for states, sums in ways[1:]:
        assert np.array_equal(states, ways[0][0])
        assert sums == ways[0][1]


def test_inputs_that_are_seen_through_a_view_are_those_of_now(roms):
    """What a step is given is kept where nothing changes: not where only who looks cannot change it."""
    bodies, states = [fr.Simulator(roms["floor"], 1e-3, signals={"push": [0.3, 0.1, -5]}) for _ in range(2)], []
    u = np.zeros(bodies[0].inputs)
    view = u.view()
    view.flags.writeable = False
    for force in np.random.default_rng(0).standard_normal((20, len(u))):
        u[:] = force
        bodies[0].step(view)
        bodies[1].step(force)
        states.append([np.concatenate(body.state) for body in bodies])
    assert len(u)
    assert all(np.array_equal(*pair) for pair in states)


def test_what_a_followed_step_found_is_told_as_that_of_a_search(roms, monkeypatch):
    """What those who differentiate ask for: the pairs, how their forces were found, and the adjoint.

    Of springs, as round-off tells which way points go that the rigid law has stopped, and what is derived goes by that.
    """
    rom, told = roms["springs"], []
    for searches in (False, True):
        with monkeypatch.context() as changed:
            if searches:
                search_always(changed)
            body = fr.Simulator(rom, 1e-3, signals={"push": lambda t: [2.0, 0.0, -20.0]})
            for _ in range(100):
                body.step()
            solver = body.integrator.interface.solver
            asked, found = solver.last_step()
            φ = np.random.default_rng(0).normal(size=solver.points.shape)
            told.append([found.forces, found.velocities, found.problem.q, asked.free])
            told[-1] += list(ContactAdjoint.of(solver, found).pull_back(φ)[:3])
    nothing = CONVERGENCE_TOLERANCE * np.abs(found.problem.q).max()  # up to that velocities are stopped
    for one, other in zip(*told, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-8 * np.abs(other).max() + nothing, rtol=0)
