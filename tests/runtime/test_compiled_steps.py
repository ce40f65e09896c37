"""Compiled steps among obstacles: NumPy's motion and account; rollouts are steps; a restored state goes on."""

import pickle

import numpy as np
import pytest
from bodies import acted_on
from landing_box import BALL, BODY, CASES, DT, PARTS, ROUGH, history, landing_mesh, landing_roms, stepped

import fenics_rom as fr
from fenics_rom.compilation import compiled, numpy_alone
from fenics_rom.mechanics.compiled_contact import CompiledContact

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
