"""Whole faces meet obstacles that turn, and beside them a body may touch itself."""

import warnings

import numpy as np
import pytest
from forks import CLAMPED
from pads import RUBS, UP, L, R, depth_of, pad_scene, shape
from pinned_clamp import FACES, clamp_scene, left_of, rises
from turning import NOTHING, spin

import fenics_rom as fr
from fenics_rom.mechanics.frame_motion import quaternion_of_vector, rotation_matrix

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
X, Y = 1.3 * L, 1.55 * L  # between nodes
MIDDLE = [X, Y, L + 1e-4 * L + R]
AT_REST = {"effects": "", "effects.damping": None}
LARGE = {
    "effects.large_deformation": 'material = "st_venant_kirchhoff"',
    "run": "dt = 1e-3\nduration = 0.01",
    "[run.load]": 'actuator = "rope"\nforce = [2.0]',
}


def turning(kind):
    """A pin that poses move about its middle."""
    return f"{shape(kind, X, Y, 1e-4 * L).removesuffix(' }')}, motion = {{ origin = {MIDDLE} }} }}"


def rom_of(scene, order=10):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return fr.reduce(fr.assemble(scene), order=order)


@pytest.mark.parametrize("friction", [{}, RUBS], ids=["smooth", "rubs"])
@pytest.mark.parametrize(
    ("kind", "axis", "rate"),
    [("ball", [0, 1, 0], 20.0), ("rod", [0, 0, 1], 10.0), ("peg", [0, 0.6, 0.8], 3.0), ("edge", [0, 1, 0], 3.0)],
)
def test_what_turns_between_nodes_stays_outside(tmp_path, kind, axis, rate, friction):
    """A pad is pressed on it: its account closes with the work of what turns."""
    rom = rom_of(pad_scene(tmp_path, turning(kind), **UP, **friction))
    body, scale, left, deepest = fr.Simulator(rom, 1e-3, signals={"pin": spin(MIDDLE, axis, rate, 0.02)}), 0.0, 0.0, 0.0
    for _ in range(60):
        body.step()
        scale, left = max(scale, body.energy, abs(body.ledger.supplied)), max(left, left_of(body))
        deepest = max(deepest, depth_of(body.integrator, body.environment.state.offsets))
    assert body.contact_forces("pin")[2] < -0.1
    assert body.integrator.contact.carriers.weights.max(axis=1).min() < 0.99
    assert deepest <= 1e-8 * R
    assert left <= 1e-13 * scale
    assert body.ledger.contact >= 0
    assert body.ledger.friction >= -1e-12 * scale
    assert friction or abs(body.ledger.friction) <= 1e-12 * scale


def test_a_smooth_ball_that_spins_pushes_as_one_that_rests(tmp_path):
    """To 1e-5 of the force, as places of the middle of a step are off by (h ω)²/8 of a way; and it does no work."""
    rom = rom_of(pad_scene(tmp_path, turning("ball"), **UP))
    spins, rests = (
        fr.Simulator(rom, 1e-3, signals={"pin": spin(MIDDLE, [0, 0.6, 0.8], rate, 0.02)}) for rate in (30.0, 0.0)
    )
    for _ in range(60):
        spins.step()
        rests.step()
    np.testing.assert_allclose(spins.contact_forces("pin"), rests.contact_forces("pin"), rtol=0, atol=3e-6)
    assert abs(spins.ledger.obstacles) <= 1e-7 * spins.ledger.supplied


@pytest.mark.parametrize("parts", [AT_REST, {}], ids=["at rest", "inert"])
def test_what_turns_with_a_carried_body_pushes_as_where_nothing_turns(tmp_path, parts):
    """A pin is pressed into a pad, and both turn at 2 rad/s: by the force that both have at rest.

    Forces act along the normals of the middle of a step. Without inertia they are those to 7e-5, which is 0.03 h ω.
    With it, the turn itself strains the pad.
    """
    rate, axis = 2.0, np.array([0.6, 0.0, 0.8])
    still = rom_of(pad_scene(tmp_path, turning("rod"), **parts))
    moved = {"effects.base_path": "origin = [0.0, 0.0, 0.0]"}
    carried = rom_of(pad_scene(tmp_path, turning("rod"), None, "moving", **moved, **parts))

    def down(time):
        return np.array([0.0, 0.0, -0.03 * L * min(time / 0.03, 1.0)]), np.array([0.0, 0.0, -L * (time < 0.03)])

    def base(time):
        return fr.BaseState(NOTHING, quaternion_of_vector(rate * time * axis), NOTHING, rate * axis)

    def alone(time):
        shift, speed = down(time)
        return fr.BaseState(MIDDLE + shift, np.array([1.0, 0.0, 0.0, 0.0]), speed, NOTHING)

    def with_it(time):
        turned, (shift, speed) = base(time).rotation, down(time)
        place = rotation_matrix(turned).dot(MIDDLE + shift)
        velocity = rotation_matrix(turned).dot(speed) + np.cross(rate * axis, place)
        return fr.BaseState(place, turned, velocity, rate * axis)

    one = fr.Simulator(still, 1e-3, signals={"pin": alone})
    other = fr.Simulator(carried, 1e-3, signals={"pin": with_it, "base_path": base})
    begun = other.energy
    for step in range(40):
        one.step()
        other.step()
        force = one.contact_forces("pin")
        seen = rotation_matrix(quaternion_of_vector(rate * (step + 0.5) * 1e-3 * axis)).T.dot(
            other.contact_forces("pin")
        )
        assert np.abs(seen - force).max() <= (3e-4 if parts else 1e-3)
    assert force[2] < -1.0
    assert left_of(other, begun) <= 1e-12 * max(abs(other.ledger.supplied), other.energy)


@pytest.mark.parametrize(
    ("frame", "parts"),
    [
        ("fixed", CLAMPED),
        ("moving", {"supports": None}),
        ("fixed", {**CLAMPED, **AT_REST}),
        pytest.param("fixed", CLAMPED | LARGE, marks=pytest.mark.slow),
    ],
    ids=["held", "free", "at rest", "large"],
)
def test_a_clamp_closes_on_itself_above_a_pin_that_turns(tmp_path, frame, parts):
    """The account closes, nothing gets in, and a free clamp has the momentum that the pin gave it."""
    rom = rom_of(clamp_scene(tmp_path, frame, **parts))
    body, scale, left, deepest, given = fr.Simulator(rom, 1e-3), 0.0, 0.0, 0.0, np.zeros(3)
    begun, solver, met = body.momentum, body.integrator.interface.solver, set()
    for _ in range(40):
        body.step(rope=2.0)
        scale, left = max(scale, body.energy, abs(body.ledger.supplied)), max(left, left_of(body))
        given += 1e-3 * body.contact_forces("pin")
        if (contact := body.integrator.contact) is not None:
            met |= set(contact.pairs // len(solver.points))
        if frame == "fixed":
            deepest = max(deepest, depth_of(body.integrator, body.environment.state.offsets))
    assert met == {0, 1}
    assert left <= 1e-12 * scale
    assert deepest <= 1e-8 * R
    np.testing.assert_allclose(body.contact_forces().sum(axis=0), body.contact_forces("pin"), atol=1e-12)
    if frame == "moving":
        assert given[2] > 1e-4
        np.testing.assert_allclose(body.momentum[0] - begun[0], given, rtol=0, atol=1e-12 * given[2])


@pytest.mark.parametrize("alone", ["itself", "pin"])
def test_what_is_not_touched_changes_nothing(tmp_path, alone):
    """Beside faces that no pin reaches a clamp touches itself as without them, and where it is open the other way."""
    contact = {"itself": 'self_contact = ["inside"]\n', "pin": 'points = "faces"\n'}[alone]
    both, one = (rom_of(clamp_scene(tmp_path, "fixed", text, **CLAMPED)) for text in (FACES, contact))
    motion = {"itself": lambda time: rises(0.0), "pin": rises}[alone]
    bodies = [fr.Simulator(rom, 1e-3, signals={"pin": motion}) for rom in (both, one)]
    for _ in range(60 if alone == "itself" else 26):
        for body in bodies:
            body.step(rope=2.0 if alone == "itself" else 0.0)
    assert bodies[1].integrator.contact is not None
    scale = np.abs(bodies[1].displacement()).max()
    np.testing.assert_allclose(bodies[0].displacement(), bodies[1].displacement(), rtol=0, atol=1e-10 * scale)


def test_files_copies_and_batches_go_as_steps_do(tmp_path):
    rom = rom_of(clamp_scene(tmp_path, **CLAMPED, **{"outputs.tip": 'surface = "above"'}))
    fr.write_rom(tmp_path / "clamp.h5", rom)
    body, other, batch = (
        fr.Simulator(rom, 1e-3),
        fr.Simulator(fr.read_rom(tmp_path / "clamp.h5"), 1e-3),
        fr.Batch(rom, 2, 1e-3),
    )
    u = np.zeros((30, body.inputs))
    u[:, -1] = 2.0
    for step in u:
        body.step(step)
        batch.step(np.tile(step, (2, 1)))
    other.rollout(u)
    assert body.integrator.contact.touching >= 2
    np.testing.assert_array_equal(other.displacement(), body.displacement())
    np.testing.assert_array_equal(batch.displacement("tip")[1], body.displacement("tip"))
