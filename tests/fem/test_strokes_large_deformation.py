"""Tendons of given length and chambers of given volume in bodies that deform largely, at full order."""

import numpy as np
import pytest
from bodies import acted_on, box_arrays, write_arrays

import fenics_rom as fr
from fenics_rom.fem.simulator import FullOrderSimulator

SOFT = {
    "material": "young = 1e6\npoisson = 0.35\ndensity = 1000.0",
    "contacts": '[contacts.bottom]\nsurface = "bottom"',
    "outputs.tip": 'surface = "right"',
}
MOVING = "inertia = {}\ndamping = { beta = 2e-3 }\n"
ROPE = "[effects.tendon.rope]\npoints = [[0.0, 0.025, 0.04], [0.2, 0.025, 0.05], [0.5, 0.025, 0.04]]\n"
AIR = '[effects.pressure.air]\nsurface = "top"\n'
LENGTH, VOLUME = 'control = "length"\n', 'control = "volume"\n'
FLOOR = '[effects.contact.obstacles.floor]\nshape = "half-space"\npoint = [0, 0, -0.0005]\nnormal = [0, 0, 1]\n'
FRICTION = "friction = { coefficient = 0.4 }\n"


@pytest.fixture(scope="module")
def beam(tmp_path_factory):
    mesh = box_arrays((0.5, 0.05, 0.05), (4, 1, 1), shake=0.2)
    return write_arrays(tmp_path_factory.mktemp("beam") / "beam.msh", *mesh)


def body_of(beam, effects, h, law="st_venant_kirchhoff"):
    large = f'large_deformation = {{ material = "{law}" }}\n' if law else ""
    system = fr.assemble(acted_on(beam, large + effects, **SOFT))
    return FullOrderSimulator(system, h, system.scene.environment)


def take(body, inputs):
    """A step, with nothing at the contact mode where that is an input."""
    follows = body.environment.environment.switches_itself
    body.step(np.array([*([] if follows else [0.0] * 3), *inputs]))


def strokes_of(body, u=None):
    """Of air and rope, where the body is."""
    u = body.displacement() if u is None else u
    return np.array([load.stroke(u) for load in body.system.deformation.model.followers.values()])


def rates_of(body, u, v):
    """Of the strokes, at displacements (N, 3) and velocities (N, 3)."""
    return np.array([(load.force(u) * v).sum() for load in body.system.deformation.model.followers.values()])


@pytest.mark.parametrize(
    ("law", "moves", "touches"),
    [("st_venant_kirchhoff", True, True), ("neo_hookean", True, False), ("neo_hookean", False, True)],
)
def test_strokes_are_given_to_bodies_that_turn(beam, law, moves, touches):
    """The account closes, taut and slack; strokes move as they are to; as inputs the forces found do the same."""
    around = MOVING * moves + FRICTION * (moves and touches) + AIR + ROPE + FLOOR * touches
    h = 5e-3 if moves else 1.0
    by_stroke = around.replace("[0.5, 0.025, 0.04]]\n", "[0.5, 0.025, 0.04]]\n" + LENGTH)
    by_stroke = by_stroke.replace('"top"\n', '"top"\n' + VOLUME)
    body, other = (body_of(beam, effects, h, law) for effects in (by_stroke, around))
    scale, furthest, tensions, touched, u, v = 0.0, 0.0, [], 0, body.displacement(), body.velocity()
    for step in range(1, 25):
        given = np.array([2e-6 * np.sin(step / 6), 3e-3 * np.sin(step / 5.5)])
        before = strokes_of(body)
        take(body, given)
        ledger, reactions = body.ledger, body.reactions
        scale = max(scale, body.energy, abs(ledger.supplied), ledger.dissipated)
        assert abs(body.energy - ledger.supplied + ledger.dissipated + ledger.numerical) <= 1e-11 * scale
        after = body.displacement()
        if moves:
            asked = 2 / 3 * (given - before) / h + rates_of(body, u, v) / 3
            met = rates_of(body, (u + after) / 2, (after - u) / h)
        else:
            asked, met = given - before, strokes_of(body) - before
        round_off = 1e-9 * (np.abs(asked) + np.abs(before) / h)
        missed = met - asked
        assert (missed >= -round_off).all()
        assert missed[0] <= round_off[0]
        assert missed[1] <= round_off[1] or reactions["rope"] == 0.0
        take(other, reactions.values())
        u, v = after, body.velocity()
        furthest = max(furthest, np.abs(u).max())
        assert np.abs(other.displacement() - u).max() <= 1e-8 * furthest
        tensions.append(reactions["rope"])
        touched += body.obstacle_forces().any()
    assert min(tensions) == 0.0 < max(tensions)
    assert touched > 3 or not touches
    assert furthest > 3e-3


@pytest.mark.parametrize("moves", [True, False], ids=["moving", "resting"])
@pytest.mark.parametrize("rubs", ["", "tendon_friction = { coefficient = 0.5 }\n"], ids=["slides", "rubs"])
def test_small_strokes_are_the_linear_bodys(beam, moves, rubs):
    effects = MOVING * moves + rubs + AIR + VOLUME + ROPE + LENGTH
    bodies = [body_of(beam, effects, 5e-3, law) for law in ("neo_hookean", None)]
    for step in range(1, 11):
        for body in bodies:
            take(body, [1e-10 * step, 3e-7 * np.sin(step / 4)])
    one, other = bodies
    assert np.abs(one.displacement() - other.displacement()).max() <= 1e-4 * np.abs(other.displacement()).max()
    assert list(one.reactions.values()) == pytest.approx(list(other.reactions.values()), rel=1e-3)


def test_steps_are_cut_and_taken_back_with_their_strokes(beam):
    """A step too large for Newton's method is taken in parts, on whose way the strokes change evenly."""
    body = body_of(beam, AIR + VOLUME + ROPE + LENGTH, 1.0)
    take(body, [1e-6, 2e-3])
    before, reactions = body.displacement(), body.reactions
    take(body, [-3e-5, 4e-2])
    assert body.stepper.parted
    np.testing.assert_allclose(strokes_of(body), [-3e-5, 4e-2], rtol=1e-7)
    body.stepper.rollback()
    np.testing.assert_array_equal(body.displacement(), before)
    assert body.reactions == reactions


@pytest.mark.parametrize("control", ["", LENGTH], ids=["tension", "length"])
@pytest.mark.parametrize("moves", [True, False], ids=["moving", "resting"])
def test_guides_take_what_the_capstan_says_of_the_moved_body(beam, moves, control):
    """Pulled from rest the tension falls by exp(-μ α) of the bent cable; only guides dissipate, without damping."""
    effects = "inertia = {}\n" * moves + "tendon_friction = { coefficient = 1.5 }\n" + ROPE + control
    body = body_of(beam, effects, 5e-3, "neo_hookean")
    rope = body.system.deformation.model.followers["rope"]
    scale, dissipated, at_rest = 0.0, [0.0], rope.angles(0 * body.displacement())
    for step in range(1, 21):
        share, u = (1 - np.cos(step / 5)) / 2, body.displacement()
        take(body, [share * (5e-3 if control else 40.0)])
        ledger, z, middle = body.ledger, body.stepper.reactions, (u + body.displacement()) / 2
        scale = max(scale, body.energy, abs(ledger.supplied), ledger.dissipated)
        assert abs(body.energy - ledger.supplied + ledger.dissipated + ledger.numerical) <= 1e-11 * scale
        dissipated.append(ledger.dissipated)
        T, at_guide = z if control else (share * 40.0, *z)
        angle = rope.angles(middle if moves else body.displacement())[0]
        if step == 8 or (not moves and step < 8):
            assert at_guide == pytest.approx(T * np.expm1(-1.5 * angle), rel=1e-8)
            assert abs(angle / at_rest[0] - 1) > 0.03 or step < 8
    assert np.diff(dissipated).min() >= -1e-12 * scale
    assert dissipated[-1] > 0.005 * scale
