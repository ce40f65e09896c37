"""Compiled steps among obstacles that turn and are driven: NumPy's motion, forces and account."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from soft_rom import in_frame, soft_rom
from test_moving_frame import CLAMPED, reduced
from turning import spin

import fenics_rom as fr
from fenics_rom.compilation import compiled, numpy_alone
from fenics_rom.errors import StepError
from fenics_rom.mechanics.compiled_contact import CompiledContact
from fenics_rom.mechanics.contact import ContactLaw
from fenics_rom.mechanics.environment import MovingObstacle, RigidMotion
from fenics_rom.mechanics.obstacles import Box, Capsule, HalfSpace

pytestmark = [
    pytest.mark.skipif(not compiled(), reason="numba is not installed, or turned off"),
    pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning"),
]
DT, STEPS = 2e-3, 100  # s
EFFECTS = """inertia = {}
damping = { alpha = 0.0, beta = 2e-5 }
gravity = { acceleration = [0.0, 0.0, -9.81] }
friction = { coefficient = 0.4 }
contact.obstacles.floor = { shape = "half-space", point = [0.0, 0.0, -0.004], normal = [0.0, 0.0, 1.0] }"""
SURFACES = {"contacts": '[contacts.bottom]\nsurface = "bottom"', "outputs.end": "points = [[0.3, 0.0, 0.0]]"}
SHAPES = {  # and what turns with them, about an axis through a point
    "table": (HalfSpace([0, 0, -1e-3], [0, 0, 1]), spin([0.1, 0, -1e-3], [0, -0.1, 1], 0.6, ramp=0.1)),
    "cam": (Box([0.25, 0.01, -0.0255], [0.02, 0.04, 0.05]), spin([0.25, 0.01, -0.0255], [0, 1, 0], 6.0, ramp=0.05)),
    "rod": (
        Capsule([0.2, -0.1, -0.017], [0.2, 0.1, -0.017], 0.015),
        spin([0.206, 0, -0.02], [0, 1, 0], 5.0, ramp=0.05),
    ),
}


def among(rom, law=None, **shapes):
    """A body among shapes that turn."""
    still = rom.environment.obstacles["floor"].displacement
    motions = {name: RigidMotion(None, tuple(SHAPES[name][1](0.0).position)) for name in shapes}
    obstacles = {name: MovingObstacle(shape, still, motions[name]) for name, shape in shapes.items()}
    given = {} if law is None else {"contact_law": law}
    return replace(rom, environment=replace(rom.environment, obstacles=obstacles, contact_switching="scene", **given))


KINDS = "held", "free", "carried", "large", "large carried"
LAWS = {
    "rubs": ContactLaw(friction=0.4),
    "bounces": ContactLaw(restitution=0.5, friction=0.4),
    "springs": ContactLaw(stiffness=500.0, damping=0.5, friction=0.4),
}


@pytest.fixture(scope="module")
def bodies(tmp_path_factory):
    """A beam, 0.3 m long, of each kind."""
    parts = {"effects": EFFECTS, "order": 8, **SURFACES}
    made = {
        kind: reduced(tmp_path_factory.mktemp(kind), frame=frame, **parts, **supports)
        for kind, frame, supports in (
            ("held", "fixed", CLAMPED),
            ("free", "moving", {}),
            ("carried", "moving", CLAMPED),
        )
    }
    large = soft_rom(contact=True, touched_from=0.1, order=8)
    return made | {"large": large, "large carried": in_frame(large)}


def both(rom, names):
    """A body that takes compiled steps among these, and one of NumPy."""
    signals = {name: SHAPES[name][1] for name in names}
    body = fr.Simulator(rom, DT, signals=signals)
    with numpy_alone():
        return body, fr.Simulator(rom, DT, signals=signals)


def history(body, steps=STEPS):
    """Inputs (steps, p): a push that comes and goes."""
    rng, p = np.random.default_rng(1), body.inputs
    push = 0.02 * rng.normal(size=p) * np.sin(np.arange(1, steps + 1)[:, None] / 15)
    return push


def check_account(body):
    ledger = body.ledger
    left = body.energy - ledger.supplied + ledger.dissipated + ledger.numerical
    assert abs(left) <= 1e-12 * max(body.energy, ledger.supplied, ledger.dissipated)


MATTERS = [("held", law) for law in LAWS] + [(kind, "rubs") for kind in KINDS[1:]]


@pytest.mark.parametrize("names", [["table"], ["cam", "rod"]], ids="-".join)
@pytest.mark.parametrize(
    ("kind", "law"),
    [
        each if each in MATTERS else pytest.param(*each, marks=pytest.mark.slow)
        for each in itertools.product(KINDS, LAWS)
    ],
)
def test_motion_forces_and_account_are_those_of_numpy(bodies, kind, law, names):
    rom = among(bodies[kind], LAWS[law], **{name: SHAPES[name][0] for name in names})
    (body, other), largest, touched = both(rom, names), 1e-6, 0
    for u in history(body):
        body.step(u)
        other.step(u)
        forces = [each.contact_forces() for each in (body, other)]
        largest = max(largest, np.abs(forces[1]).max())
        np.testing.assert_allclose(*forces, rtol=0, atol=1e-7 * largest)
        touched += np.abs(forces[1]).max() > 0
    assert touched > 10
    assert abs(body.ledger.obstacles) > 1e-6
    np.testing.assert_allclose(body.displacement(), other.displacement(), rtol=0, atol=1e-8 * 0.3)
    sums = np.array([[total for total, _ in each.ledger.sums] for each in (body, other)])
    np.testing.assert_allclose(*sums, rtol=0, atol=1e-7 * np.abs(sums).max())
    check_account(body)


@pytest.mark.parametrize("kind", KINDS)
def test_rollouts_and_batches_are_these_steps(bodies, kind):
    names = ["cam", "rod"]
    rom = among(bodies[kind], LAWS["rubs"], **{name: SHAPES[name][0] for name in names})
    signals = {name: SHAPES[name][1] for name in names}
    body, rolled = (fr.Simulator(rom, DT, signals=signals) for _ in range(2))
    bodies, u = fr.Batch(rom, 2, DT, signals=signals), history(body)
    rolled.rollout(u, outputs=())
    largest = 0.0
    for row in u:
        body.step(row)
        bodies.step(np.array([row, 2 * row]))
        largest = max(largest, np.abs(body.contact_forces()).max())
    assert largest > 0
    is_found_at_once = kind in ("held", "large")  # in sweeps but for round-off
    bound = {"rtol": 0, "atol": 0.0 if is_found_at_once else 1e-10 * largest}
    np.testing.assert_allclose(rolled.contact_forces(), body.contact_forces(), **bound)
    np.testing.assert_allclose(rolled.displacement(), body.displacement(), rtol=0, atol=1e-13)
    for of_roll, of_steps in zip(rolled.environment.state, body.environment.state, strict=True):
        np.testing.assert_array_equal(of_roll, of_steps)
    output = next(iter(rom.outputs))
    assert bodies.stepping == "compiled"
    if is_found_at_once:
        np.testing.assert_allclose(bodies.displacement(output)[0], body.displacement(output), rtol=1e-14)
    sums = np.array([[total for total, _ in each.ledger.sums] for each in (body, rolled)])
    np.testing.assert_allclose(*sums, rtol=0, atol=1e-13 * np.abs(sums).max())
    for each in (body, rolled):
        check_account(each)


@pytest.mark.parametrize("kind", KINDS)
def test_steps_are_those_of_loops(bodies, kind, monkeypatch):
    """NumPy's search for forces is asked in none of them."""
    rom = among(bodies[kind], LAWS["rubs"], cam=SHAPES["cam"][0])
    body = fr.Simulator(rom, DT, signals={"cam": SHAPES["cam"][1]})
    asked = []
    monkeypatch.setattr(CompiledContact, "solve", lambda *given, **named: asked.append(body.steps))
    for u in history(body):
        body.step(u)
    assert not asked
    assert body.ledger.obstacles != 0.0


def test_what_turns_too_far_is_told_by_all(bodies):
    """In steps, rollouts and batches; what was taken before stays."""
    turned = spin([0.25, 0.01, -0.0255], [0, 1, 0], 1500.0, ramp=0.01)  # by 2 rad in a step from 6 ms on
    rom = among(bodies["held"], LAWS["rubs"], cam=SHAPES["cam"][0])
    body, batch = fr.Simulator(rom, DT, signals={"cam": turned}), fr.Batch(rom, 2, DT, signals={"cam": turned})
    u = np.zeros((2, body.inputs))
    with pytest.raises(StepError, match=r"an obstacle is told to turn by 2\.1 rad in a step"):
        body.rollout(np.tile(u[0], (20, 1)))
    assert body.steps == 0
    for _ in range(3):
        batch.step(u)
    with pytest.raises(StepError, match="body 0: an obstacle is told to turn"):
        batch.step(u)
    assert list(batch.step(u, on_error="hold")) == [0, 1]
    assert batch.steps == 4
