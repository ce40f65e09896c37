"""Compiled steps among obstacles: NumPy's motion and account; rollouts are steps; a restored state goes on."""

import pickle

import numpy as np
import pytest
from bodies import acted_on
from landing_box import BALL, BODY, CASES, DT, PARTS, ROUGH, history, landing_mesh, landing_roms, stepped

import fenics_rom as fr
from fenics_rom.compilation import compiled, jit, numpy_alone
from fenics_rom.errors import StepError
from fenics_rom.mechanics.compiled import contact_law
from fenics_rom.mechanics.compiled.contact_law import OTHERWISE
from fenics_rom.mechanics.compiled.obstacle_motion import Beside
from fenics_rom.mechanics.compiled_contact import CompiledContact
from fenics_rom.runtime import compiled_bodies
from fenics_rom.runtime.compiled import touching
from fenics_rom.runtime.steppers.contact_midpoint import ContactMidpoint

pytestmark = [
    pytest.mark.skipif(not compiled(), reason="numba is not installed, or turned off"),
    pytest.mark.filterwarnings("ignore:the surface is", "ignore:.*contact points leave"),
]


@pytest.fixture(scope="module")
def mesh(tmp_path_factory):
    return landing_mesh(tmp_path_factory.mktemp("landing"))


@pytest.fixture(scope="module")
def roms(mesh):
    return landing_roms(mesh)


def both(rom, **given):
    """A compiled body, and one of NumPy."""
    body = fr.Simulator(rom, DT, **given)
    assert isinstance(body.integrator.interface.solver, CompiledContact)
    assert body.integrator.kernel.compiled_step is not None
    with numpy_alone():
        return body, fr.Simulator(rom, DT, **given)


def assert_account_closes(body):
    account = body.ledger
    size = max(body.energy, abs(account.supplied), account.dissipated)
    left = body.energy - account.supplied + account.dissipated + account.lost_in_switching
    assert abs(left) <= 1e-12 * size
    assert min(account.contact, account.friction) >= -1e-12 * size


@pytest.mark.parametrize("case", CASES)
def test_motion_and_account_are_those_of_numpy(roms, case):
    """The box lands, is pushed until it slides, stops, is lifted off and lands again."""
    bodies, seen = both(roms[case]), []
    for u in history(1, roughness=0.02):
        for body in bodies:
            body.step(u)
        seen.append([(body.displacement("corner"), body.contact_forces()) for body in bodies])
    by_body = [[np.array(part) for part in zip(*of_body, strict=True)] for of_body in zip(*seen, strict=True)]
    for one, other in zip(*by_body, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-7 * np.abs(other).max(), rtol=0)
    sums = np.array([[total for total, _ in body.ledger.sums] for body in bodies])
    np.testing.assert_allclose(*sums, atol=1e-7 * np.abs(sums).max(), rtol=0)
    for body in bodies:
        assert_account_closes(body)


@pytest.mark.parametrize("case", CASES)
def test_rollouts_are_steps(roms, case):
    forces = history(2, roughness=0.02)
    body, read, _ = stepped(roms[case], forces, 7)
    rolled = fr.Simulator(roms[case], DT)
    corner = rolled.rollout(forces, every=7)["corner"]
    np.testing.assert_allclose(corner, read, atol=1e-12 * np.abs(read).max(), rtol=0)
    for name in ("state", "contact_forces"):
        one, other = (getattr(each, name) for each in (body, rolled))
        if callable(one):
            one, other = one(), other()
        np.testing.assert_array_equal(one, other)
    assert_account_closes(rolled)
    sums = np.array([[total for total, _ in each.ledger.sums] for each in (body, rolled)])
    np.testing.assert_allclose(*sums, atol=1e-12 * np.abs(sums).max(), rtol=0)


@pytest.mark.parametrize("case", CASES)
def test_a_restored_state_goes_on_to_the_bit(roms, case):
    body, other, forces = fr.Simulator(roms[case], DT), fr.Simulator(roms[case], DT), history(3, roughness=0.02)
    for u in forces[:350]:
        body.step(u)
    other.restore(pickle.loads(pickle.dumps(body.save())))
    for u in forces[350:]:
        body.step(u)
        other.step(u)
    np.testing.assert_array_equal(np.concatenate(body.state), np.concatenate(other.state))
    assert body.ledger.sums == other.ledger.sums


def test_an_obstacle_that_moves_does_the_work_that_numpy_says(roms):
    lifts = {"floor": lambda t: [2e-3 * np.sin(40 * t), 0.0, 1e-3 * np.sin(60 * t)]}
    bodies = both(roms["floor"], signals=lifts)
    for u in history(4):
        for body in bodies:
            body.step(u)
    one, other = bodies
    assert abs(other.ledger.obstacles) > 1e-3
    assert one.ledger.obstacles == pytest.approx(other.ledger.obstacles, rel=1e-7)
    np.testing.assert_allclose(one.displacement(), other.displacement(), atol=1e-7 * np.abs(other.displacement()).max())
    assert_account_closes(one)


def test_many_points_of_which_few_touch(mesh):
    """The operator of the points that touch alone, and what they do to all others."""
    ball = BALL.replace("0.15, 0.1, -5.0001", "0.1, 0.1, -0.0801").replace("radius = 5.0", "radius = 0.08")
    scene = acted_on(mesh, BODY + "[effects.contact]\n" + ball + ROUGH, **PARTS)
    rom = fr.reduce(fr.assemble(scene), order=10)
    bodies, most = both(rom), 0
    for u in history(5)[:60]:
        for body in bodies:
            body.step(u)
        most = max(most, int((bodies[0].contact_forces()[:, 2] > 0).sum()))
    one, other = (body.displacement() for body in bodies)
    assert 0 < most < len(bodies[0].contact_forces()) / 2
    np.testing.assert_allclose(one, other, atol=1e-7 * np.abs(other).max(), rtol=0)


@pytest.mark.parametrize("case", CASES)
def test_bodies_of_a_batch_are_single_ones_to_the_bit(roms, case):
    """More than one thread takes at once; one sits a step out, one begins anew, and all take other steps in the end."""
    size, rom = 40, roms[case]
    bodies, singles = fr.Batch(rom, size, DT, ledger=True), [fr.Simulator(rom, DT) for _ in range(3)]
    assert bodies.stepping == "compiled"
    forces = np.stack([history(seed % 3, roughness=0.02)[:250] for seed in range(size)], axis=1)
    for step, u in enumerate(forces):
        if step == 100:
            u[1] = np.nan
            bodies.reset([2])
            singles[2].reset()
        if step == 200:
            bodies.dt = DT / 2
        held = bodies.step(u, on_error="hold")
        assert held.tolist() == ([1] if step == 100 else [])
        for k, single in enumerate(singles):
            single.dt = bodies.dt
            if k not in held:
                single.step(u[k])
    for k, single in enumerate(singles):
        np.testing.assert_array_equal([part[k] for part in bodies.state()], single.state)
        np.testing.assert_array_equal(bodies.point_forces[k], single.contact_forces())
        for number, name in enumerate(rom.environment.obstacles):
            np.testing.assert_array_equal(bodies.contact_force(name)[k], single.obstacle_forces()[number])
        assert bodies.time[k] == single.time
        shape = single.displacement()
        np.testing.assert_allclose(bodies.shape(k), shape, atol=1e-13 * np.abs(shape).max(), rtol=0)
        account = single.ledger
        sums = account.supplied, account.dissipated, account.obstacles, account.contact + account.friction
        read = bodies.supplied, bodies.dissipated, bodies.supplied_by_obstacles, bodies.dissipated_in_contact
        np.testing.assert_allclose([each[k] for each in read], sums, atol=1e-12 * np.abs(sums).max(), rtol=0)


def test_an_obstacle_that_comes_from_afar_meets_a_batch_as_it_meets_a_single_body(roms):
    """To the bit, though a batch asks nothing of obstacles while they are out of reach."""
    rising = {"floor": lambda t: [0.0, 0.0, min(3.0 * t - 0.05, 1e-3)]}  # m
    bodies, single = fr.Batch(roms["floor"], 2, DT, signals=rising), fr.Simulator(roms["floor"], DT, signals=rising)
    touches = []
    for u in history(2)[:100]:
        bodies.step(u)
        single.step(u)
        touches.append(bool(single.contact_forces().any()))
        np.testing.assert_array_equal(bodies.point_forces[1], single.contact_forces())
    assert not touches[5]
    assert any(touches)
    np.testing.assert_array_equal([part[1] for part in bodies.state()], single.state)


def test_a_body_whose_forces_loops_do_not_find_steps_as_a_single_one(roms, monkeypatch):
    """To the bit; and a step that is refused changes nothing, of those bodies either that have taken it."""
    bodies, forces = fr.Batch(roms["floor"], 3, DT, ledger=True), history(1, roughness=0.02)
    single, find = fr.Simulator(roms["floor"], DT), compiled_bodies.step_bodies

    def give_up(body, law, friction, shapes, some, *others):
        find(body, law, friction, shapes, some[some != 1], *others)
        others[-1].status[1] = OTHERWISE

    def refuse(*_):
        raise StepError("none")

    monkeypatch.setattr(compiled_bodies, "step_bodies", give_up)
    for u in forces[:250]:
        bodies.step(u)
        single.step(u)
    for k in range(3):
        np.testing.assert_array_equal([part[k] for part in bodies.state()], single.state)
        np.testing.assert_array_equal(bodies.point_forces[k], single.contact_forces())
    assert bodies.dissipated[1] == pytest.approx(single.ledger.dissipated, rel=1e-12)
    with monkeypatch.context() as patch:
        patch.setattr(ContactMidpoint, "step", refuse)
        before = *bodies.state(), bodies.time, bodies.point_forces, bodies.energy, bodies.dissipated
        with pytest.raises(StepError, match=r"step 250, body 1: none; all bodies were left as they were"):
            bodies.step(forces[250])
    after = *bodies.state(), bodies.time, bodies.point_forces, bodies.energy, bodies.dissipated
    for one, other in zip(before, after, strict=True):
        np.testing.assert_array_equal(one, other)
    for u in forces[250:300]:
        bodies.step(u)
        single.step(u)
    np.testing.assert_array_equal(bodies.state()[0][0], single.state[0])


def test_pairs_that_are_not_asked_take_no_part():
    """Two points near a floor at a speed; what holds the first one back sends the other one down (a lever)."""
    left_out, fastest_of, ask = map(jit, (touching.are_left_out, touching.fastest_of, contact_law.ask))
    speed, lever = 0.3, 2.0  # m/s; velocity of the other one, of what is stopped
    W, beside = np.zeros((6, 6)), Beside(np.zeros((1, 3)), np.zeros((1, 3)), np.zeros((0, 3)))
    W[[2, 2, 5, 5], [2, 5, 2, 5]] = 1.0, -lever, -lever, lever**2 + 0.1
    law = contact_law.Law(DT, 0.0, 0.0, -1 / DT, 0.0, False, 10, np.inf)
    free, f = np.array([[0, 0, -speed]] * 2), np.array([0, 0, speed, 0, 0, 0])  # f stops the first one
    seen = set()
    for gap in np.linspace(1e-6, 20 * DT * speed, 200):
        pairs, gaps = contact_law.pairs_from(np.zeros((2, 3)), 0.0), np.array([0.0, gap])
        pairs.axes[:, 0] = 0, 0, 1
        found = touching.StepContact(pairs, gaps, np.zeros((4, 6)), f)
        is_left_out = left_out(fastest_of(W, f, np.ones(10)), DT, 2.5 * DT * speed, 1e-9, found)
        ask(law, gaps, free, free, beside, np.zeros((2, 3)), np.empty(0), pairs, np.inf)
        assert not (is_left_out and free[1, 2] + (W @ f)[5] < pairs.level[1])
        seen.add(is_left_out)
    assert seen == {True, False}
