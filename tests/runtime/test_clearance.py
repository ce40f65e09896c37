"""Bodies out of reach of obstacles: they do not look at them, move as if they did, and notice what comes near."""

import numpy as np
import pytest
from landing_box import DT, WEIGHT, landing_mesh, landing_roms

import fenics_rom as fr
from fenics_rom.compilation import compiled, numpy_alone
from fenics_rom.mechanics.contact_solver import ContactSolver
from fenics_rom.runtime.steppers.clearance import Clearance

pytestmark = pytest.mark.filterwarnings("ignore:the surface is", "ignore:.*contact points leave")
STEPS, LIFTED, MASS = 500, 90, WEIGHT / 9.81  # -, -, kg
WAYS = ["NumPy", pytest.param("compiled", marks=pytest.mark.skipif(not compiled(), reason="numba is not there"))]


@pytest.fixture(scope="module")
def roms(tmp_path_factory):
    return landing_roms(landing_mesh(tmp_path_factory.mktemp("clearance")))


def made(way, rom, **given):
    """A body that steps so."""
    if way == "compiled":
        return fr.Simulator(rom, DT, **given)
    with numpy_alone():
        return fr.Simulator(rom, DT, **given)


def thrown(body, steps=STEPS):
    """Displacements, forces and works of a body that is thrown up, falls and lands, by step."""
    seen = []
    for step in range(steps):
        body.step([0.2 * WEIGHT, 0.0, 2 * WEIGHT] if step < LIFTED else [0.0, 0.0, 0.0])
        seen.append(np.concatenate([body.displacement("corner").ravel(), body.contact_forces().ravel()]))
    return np.array(seen), [total for total, _ in body.ledger.sums]


@pytest.mark.parametrize("case", ["floor", "smooth", "ball", "two"])
def test_steps_out_of_reach_are_those_that_look_to_the_bit(roms, case, monkeypatch):
    looked, look = [], ContactSolver.solve

    def counted(solver, *given, **named):
        looked.append(1)
        return look(solver, *given, **named)

    monkeypatch.setattr(ContactSolver, "solve", counted)
    moved, works = thrown(made("NumPy", roms[case]))
    seldom = len(looked)
    monkeypatch.setattr(Clearance, "is_enough", lambda *_: False)
    looked.clear()
    always, works_of_these = thrown(made("NumPy", roms[case]))
    np.testing.assert_array_equal(moved, always)
    assert works == works_of_these
    touched = always[:, 6:].any(axis=1)
    assert touched[-1]
    assert (~touched).sum() > 200
    assert len(looked) - seldom > 0.7 * (~touched).sum()


@pytest.mark.skipif(not compiled(), reason="numba is not there")
def test_compiled_steps_out_of_reach_are_those_of_numpy(roms):
    (one, works), (other, works_there) = (thrown(made(way, roms["two"])) for way in ("compiled", "NumPy"))
    for part in (slice(6), slice(6, None)):
        np.testing.assert_allclose(one[:, part], other[:, part], atol=1e-9 * np.abs(other[:, part]).max(), rtol=0)
    np.testing.assert_allclose(works, works_there, atol=1e-9 * np.abs(works_there).max(), rtol=0)


@pytest.mark.parametrize("way", WAYS)
def test_a_body_that_is_put_beside_an_obstacle_touches_it(roms, way):
    body = made(way, roms["floor"])
    for _ in range(100):
        body.step([0.0, 0.0, 0.0])
    at_rest, there = body.save(), body.contact_forces()
    assert there[:, 2].sum() == pytest.approx(WEIGHT, rel=0.05)
    thrown(body, 200)
    assert not body.contact_forces().any()
    in_the_air = body.save()
    body.restore(at_rest)
    body.step([0.0, 0.0, 0.0])
    np.testing.assert_allclose(body.contact_forces(), there, atol=1e-3 * there.max())
    body.restore(in_the_air)
    body.step([0.0, 0.0, 0.0])
    assert not body.contact_forces().any()
    assert body.integrator.interface.solver.last_step()[1] is None


@pytest.mark.parametrize("way", WAYS)
def test_an_obstacle_that_comes_is_noticed(roms, way):
    body = made(way, roms["floor"])
    thrown(body, 150)
    assert not body.contact_forces().any()
    body.set_signal("floor", [0.0, 0.0, body.displacement("corner")[0, 2] + 5e-3])  # within this step
    body.step([0.0, 0.0, 0.0])
    assert body.contact_forces()[:, 2].max() > 0


def test_a_faster_step_is_not_taken_for_granted(roms):
    """What is known of the way so far says nothing of a push that comes."""
    body = made("NumPy", roms["floor"])
    thrown(body, 200)
    assert not body.contact_forces().any()
    height = body.displacement("corner")[0, 2]
    for _ in range(3):
        body.step([0.0, 0.0, -2 * MASS * height / DT**2])
    assert body.contact_forces()[:, 2].max() > 0
