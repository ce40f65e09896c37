"""Bodies in moving frames made of any parts: what strains little or much, relaxes, is pulled, rubs and touches."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from bodies import box_arrays, scene_text, write_arrays
from soft_rom import in_frame, soft_rom

import fenics_rom as fr
from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.mechanics.frame_motion import quaternion_of_vector
from fenics_rom.mechanics.step import FINITE_STRAIN_STEPPERS
from fenics_rom.mechanics.viscoelasticity import PronySeries
from fenics_rom.runtime.steppers.kept_newton import KeptNewton
from fenics_rom.scene.file import parse_scene

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")

LAWS = ("st_venant_kirchhoff", "neo_hookean")
ROPE = "points = [[0.0, 0.015, 0.0], [0.15, 0.015, 0.004], [0.3, 0.015, 0.0]]"
FLOOR = 'shape = "half-space"\npoint = [0.0, 0.0, -0.004]\nnormal = [0.0, 0.0, 1.0]'
BASE = {"gravity": "acceleration = [0.0, 0.0, -9.81]"}
PARTS = {
    "stroke": {"tendon.rope": f'{ROPE}\ncontrol = "length"'},
    "guides": {"tendon.rope": ROPE, "tendon_friction": "coefficient = 0.3"},
    "volume": {"pressure.air": 'surface = "top"\ncontrol = "volume"'},
    "gas": {"pressure.air": 'surface = "top"\ncontrol = "gas"\ngas = { exponent = 1.4, volume = 1e-5 }'},
    "relaxing": {"viscoelasticity": "ratios = [0.5, 0.3]\ntimes = [0.02, 0.2]", "tendon.rope": ROPE},
    "touched": {
        "tendon.rope": f'{ROPE}\ncontrol = "length"',
        "viscoelasticity": "ratios = [0.5]\ntimes = [0.05]",
        "contact.obstacles.floor": FLOOR,
    },
}
AMPLITUDE = {"stroke": 1e-3, "guides": 2.0, "volume": 1e-7, "gas": 1e-6, "relaxing": 2.0, "touched": 1e-3}


def small(folder, parts, frame, supports='clamped = ["left"]'):
    """A ROM of a beam of small strains."""
    mesh = write_arrays(folder / "box.msh", *box_arrays((0.3, 0.03, 0.02), (6, 1, 1)))
    named = {f"effects.{name}": text for name, text in (BASE | PARTS[parts]).items()}
    text = scene_text(
        mesh,
        supports=supports,
        damping="alpha = 0.5, beta = 2e-4",
        contacts='[contacts.bottom]\nsurface = "bottom"\n[contacts.right]\nsurface = "right"',
        **named,
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return fr.reduce(fr.assemble(parse_scene(f'frame = "{frame}"\n{text}')), order=8)


def pulled(body, steps, amplitude, dt=2e-3):
    """Displacements under an actuator that comes and goes, and by how much the account misses."""
    actuator, start, path = next(iter(body.rom.actuators)), body.energy, []
    for k in range(steps):
        body.step(**{actuator: amplitude * np.sin(k * dt / 0.03) ** 2})
        path.append(body.displacement().ravel())
    account = body.ledger
    gone = account.dissipated + account.lost_in_switching + account.numerical
    return np.array(path), abs(body.energy - start - account.supplied + gone) / (abs(account.supplied) + body.energy)


@pytest.mark.parametrize("parts", PARTS)
def test_a_carried_body_whose_base_stands_is_a_held_one(tmp_path, parts):
    """Of the same parts, to what forces of contact and guides are found with; both accounts close."""
    paths = []
    for frame in ("fixed", "moving"):
        path, missed = pulled(fr.Simulator(small(tmp_path, parts, frame), 2e-3), 150, AMPLITUDE[parts])
        assert missed <= 1e-12
        paths.append(path)
    assert np.abs(paths[1] - paths[0]).max() <= 1e-9 * np.abs(paths[0]).max()


@pytest.mark.parametrize(
    "parts", [name for name in PARTS if name not in ("volume", "gas")]
)  # which a body encloses alone
def test_a_free_body_of_parts_keeps_its_account_and_momentum(tmp_path, parts):
    """Actuators and branches act within the body: they turn nothing. Steps of different lengths, no obstacle."""
    parts_of = dict(PARTS[parts])
    parts_of.pop("contact.obstacles.floor", None)
    mesh_parts = {**PARTS, parts: parts_of}[parts]
    named = {f"effects.{name}": text for name, text in mesh_parts.items()}
    mesh = write_arrays(tmp_path / "box.msh", *box_arrays((0.3, 0.03, 0.02), (6, 1, 1)))
    text = scene_text(mesh, supports=None, damping="alpha = 0.5, beta = 2e-4", **named)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        rom = fr.reduce(fr.assemble(parse_scene(f'frame = "moving"\n{text}')), order=8)
    body, random = fr.Simulator(rom, 1e-3), np.random.default_rng(0)
    body.place(body.pose._replace(velocity=np.array([0.1, 0.2, 0.3]), angular_velocity=np.array([3.0, -2.0, 5.0])))
    start, (P, L), turnover = body.energy, body.momentum, 0.0
    for _ in range(150):
        body.dt = random.uniform(1e-3, 1.5e-3)  # strokes that are met at steps of any length would shake the body
        body.step(**{next(iter(rom.actuators)): AMPLITUDE[parts] * np.sin((body.time + body.dt) / 0.05) ** 2})
        turnover = max(turnover, body.energy, abs(body.ledger.supplied), body.ledger.dissipated)
    account = body.ledger
    assert abs(body.energy - start - account.supplied + account.dissipated) <= 1e-11 * turnover
    moved = [np.abs(now - before).max() for now, before in zip(body.momentum, (P, L), strict=True)]
    assert max(moved) <= 1e-12 * max(np.abs(P).max(), np.abs(L).max())


def relaxing(rom):
    """The same of a material that relaxes."""
    return replace(rom, environment=replace(rom.environment, viscoelasticity=PronySeries((0.5,), (0.03,))))


def by_stroke(rom):
    """The same pulled by the stroke of its cable."""
    return replace(rom, environment=replace(rom.environment, controls={"cable": "length"}))


KINDS = {"plain": lambda rom: rom, "relaxing": relaxing, "stroke": by_stroke}


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("stepper", FINITE_STRAIN_STEPPERS)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("contact", [False, True])
def test_a_body_that_bends_far_on_a_base_that_stands_is_a_held_one(law, stepper, kind, contact):
    """By both steps; Newton's ends where forces of points, of 1e-12 of the largest, are round-off."""
    rom = KINDS[kind](soft_rom(law, order=8, contact=contact))
    if contact:
        rom = replace(rom, residual_compliance=None)
    paths = []
    for each in (rom, in_frame(rom)):
        body, path = fr.Simulator(each, 2e-3, stepper=stepper), []
        for k in range(60):
            cable = (2e-3 if kind == "stroke" else 1.0) * np.sin(k / 20) ** 2
            body.step([0.0, 0.0, -0.05 * (k < 20), 0.0, cable])
            path.append(body.displacement().ravel())
        account = body.ledger
        gone = account.dissipated + account.lost_in_switching + account.numerical
        assert abs(body.energy - account.supplied + gone) <= 1e-10 * (abs(account.supplied) + body.energy)
        paths.append(np.array(path))
    assert np.abs(paths[1] - paths[0]).max() <= (1e-9 if contact else 1e-10) * np.abs(paths[0]).max()


def whip(t):
    """A base that turns to and fro and goes along."""
    θ, ω = 0.6 * (1 - np.cos(4 * t)), 2.4 * np.sin(4 * t)
    rotation = quaternion_of_vector(np.array([0.0, θ, 0.0]))
    return BaseState(
        np.array([0.05 * np.sin(3 * t), 0.0, 0.0]),
        rotation,
        np.array([0.15 * np.cos(3 * t), 0, 0]),
        np.array([0, ω, 0]),
    )


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("kind", ["plain", "relaxing"])
def test_both_steps_of_a_whipped_body_meet_and_its_account_closes(law, kind):
    """At 1 ms they differ by less than a tenth of how far half of the step moves either; base work is booked."""
    rom, ends = in_frame(KINDS[kind](soft_rom(law, order=8))), {}
    for stepper in FINITE_STRAIN_STEPPERS:
        for dt in (2e-3, 1e-3):
            body = fr.Simulator(rom, dt, stepper=stepper)
            body.place(whip(0.0))
            start = body.energy
            for k in range(round(0.3 / dt)):
                body.step([0.0, 0.0, 0.02, 0.0, 0.3], base=whip((k + 1) * dt))
            account = body.ledger
            missed = body.energy - start - account.supplied + account.dissipated
            assert abs(missed) <= 1e-10 * (abs(account.supplied) + body.energy)
            ends[stepper, dt] = body.displacement().ravel()
    first, second = FINITE_STRAIN_STEPPERS
    halved = max(np.abs(ends[s, 2e-3] - ends[s, 1e-3]).max() for s in FINITE_STRAIN_STEPPERS)
    assert np.abs(ends[first, 1e-3] - ends[second, 1e-3]).max() <= halved


def test_small_motions_of_a_body_that_bends_far_are_those_of_small_strains():
    """In a frame that turns, without geometric stiffening the two differ by second order in the motion."""
    soft = soft_rom(order=8)
    large, linear = in_frame(soft), replace(in_frame(soft), deformation=None)
    gaps = []
    for share in (1e-3, 5e-4):
        ends = []
        for rom in (large, linear):
            body = fr.Simulator(rom, 1e-3)
            for _ in range(100):
                body.step([0.0, 0.0, 0.05 * share, 0.0, 0.0])
            ends.append(body.displacement().ravel())
        gaps.append(np.abs(ends[0] - ends[1]).max() / share)
    assert gaps[1] <= 0.6 * gaps[0]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("stepper", FINITE_STRAIN_STEPPERS)
def test_a_saved_state_of_parts_goes_on_to_the_bit(kind, stepper):
    rom = in_frame(KINDS[kind](soft_rom(LAWS[1], order=8)))
    body = fr.Simulator(rom, 1e-3, stepper=stepper)

    def go(steps):
        for k in range(steps):
            body.step([0.0, 0.0, 0.02, 0.0, 1e-3 * k], base=whip(body.time + body.dt))
        return np.concatenate(body.state)

    go(20)
    saved, after = body.save(), go(20)
    body.restore(saved)
    np.testing.assert_array_equal(go(20), after)


def test_newton_ends_at_the_round_off_of_forces_and_not_before():
    """What is left beside velocities is 1e-9 here, as of a bent body that all but rests; a poor Jacobian is no such."""
    noise = np.random.default_rng(0)

    def solved(slope, size):
        x = np.array([2.0])
        left = KeptNewton().solve(
            x,
            lambda x: x**3 - 1 + size * noise.standard_normal(1),
            lambda x: slope(x).reshape(1, 1),
            lambda change: abs(float(change[0])),
            lambda x: abs(float(x[0])),
        )
        return left, abs(x[0] - 1)

    left, error = solved(lambda x: 3 * x**2, 3e-9)
    assert left == 0
    assert error < 1e-8
    assert solved(lambda x: 3 * x**2, 1e-6)[0] > 0  # which is no round-off
    assert solved(lambda x: 9 * x**2, 0.0)[1] < 1e-9  # shrinks by a third of what is left
