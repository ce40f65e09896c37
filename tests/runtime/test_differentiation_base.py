"""Gradients with the path of a base that carries the body: its poses and twists, each on its own or together."""

from dataclasses import replace

import numpy as np
import pytest
import test_differentiation_parts as bent
from gradient_checks import AGREES, squares
from soft_rom import soft_rom
from test_differentiation_frames import LAWS, STILL, TIED, H, lowered, reduced, still, swung
from test_differentiation_frames import along as pushed
from test_moving_parts import KINDS, in_frame

import fenics_rom as fr
from fenics_rom.errors import StepError
from fenics_rom.mechanics.base_path import BaseState, quaternion_product
from fenics_rom.mechanics.frame_motion import quaternion_of_vector, rotation_matrix, turned
from fenics_rom.mechanics.step import FINITE_STRAIN_STEPPERS

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
HELD = 'clamped = ["left"]'


def moved(base, by):
    """A base with its pose and twist changed by (4, 3), along the axes of space."""
    rotation = quaternion_product(quaternion_of_vector(by[1]), base.rotation)
    return BaseState(base.position + by[0], rotation, base.velocity + by[2], base.angular_velocity + by[3])


def followed(base, twists):
    """The bases whose poses follow twists (n + 1, 6) in their own axes, from that of one."""

    def with_twist(position, rotation, twist):
        R = rotation_matrix(rotation)
        return BaseState(position, np.array(rotation), R @ twist[:3], R @ twist[3:])

    bases = [with_twist(base.position, base.rotation, twists[0])]
    for v, ω in (twists[1:] + twists[:-1]).reshape(-1, 2, 3) / 2:
        (position, rotation, *_), twist = bases[-1], twists[len(bases)]
        position = position + H * rotation_matrix(rotation) @ (v + H / 2 * np.cross(ω, v))
        bases.append(with_twist(position, turned(rotation, H * ω), twist))
    return bases


def run(make, u, start, bases):
    """J of a body that goes with a base, and its gradient."""

    def put():
        body = make()
        body.place(bases[0])
        body.state = start
        return body

    body, read, energies = put(), [], []
    for row, base in zip(u, bases[1:], strict=True):
        body.step(row, base=base)
        read.append(body.displacement("tip"))
        energies.append(body.energy)
    value = squares({"tip": np.array(read)}, np.array(energies))[0]
    return value, lambda: fr.differentiate(put(), u, squares, base=bases[1:])


def check_poses(make, path, u, start, size=1.0):
    """Poses and twists at the start and at the end of each step, each on its own."""
    bases, random, ε = [path(H * k) for k in range(len(u) + 1)], np.random.default_rng(0), 1e-4
    value, differentiate = run(make, u, start, bases)
    gradient, found = differentiate(), []
    assert gradient.value == pytest.approx(value, rel=1e-12)
    for place, name in enumerate(BaseState._fields):
        along = np.zeros((len(bases), 4, 3))
        along[:, place] = size * (1e-2, 1e-1, 1e-1, 1.0)[place] * random.standard_normal((len(bases), 3))
        ahead, back = (run(make, u, start, list(map(moved, bases, sign * ε * along)))[0] for sign in (1, -1))
        owed = gradient.pose[name] * along[0, place], gradient.base[name] * along[1:, place]
        found.append((owed[0].sum() + owed[1].sum(), (ahead - back) / (2 * ε)))
    for owed, difference in found:
        assert owed == pytest.approx(difference, rel=AGREES, abs=AGREES * max(abs(each) for each, _ in found))


def check_twists(make, path, u, start, size=1.0, *, touches=True):
    """Twists, which poses follow, so that what touches goes on touching."""
    bases, random, ε = [path(H * k) for k in range(len(u) + 1)], np.random.default_rng(0), 1e-3
    twists = np.array([np.concatenate(base[2:]).reshape(2, 3) @ rotation_matrix(base.rotation) for base in bases])
    twists, sizes = twists.reshape(-1, 6), size * np.repeat((1e-3, 1e-2), 3)
    gradient = run(make, u, start, followed(bases[0], twists))[1]()
    assert gradient.kinks == ()
    found = []
    for part in (slice(3), slice(3, 6)):
        along = np.zeros(twists.shape)
        along[:, part] = sizes[part] * random.standard_normal((len(twists), 3))
        ahead, back = (run(make, u, start, followed(bases[0], twists + sign * ε * along))[0] for sign in (1, -1))
        found.append(((gradient.twists * along).sum(), (ahead - back) / (2 * ε)))
    for owed, difference in found:
        assert owed == pytest.approx(difference, rel=AGREES, abs=AGREES * max(abs(each) for each, _ in found))
    body = make()
    body.place(bases[0])
    body.state = start
    touched = 0
    for row, base in zip(u, followed(bases[0], twists)[1:], strict=True):
        body.step(row, base=base)
        touched += len(body.contact_coordinates) > 0 and body.contact_forces().any()
    assert touched >= 3 or not touches


@pytest.mark.parametrize("path", [swung, still])
@pytest.mark.parametrize("parts", [{}, TIED, {"effects.viscoelasticity": "ratios = [0.5]\ntimes = [0.02]"}])
def test_poses_and_twists_of_a_base(tmp_path, path, parts):
    """Turning fast or standing still, with springs to the ground, of a material that relaxes."""
    rom = reduced(tmp_path, HELD, **parts)
    _, u, start, _ = pushed(rom, path, steps=12)
    check_poses(lambda: fr.Simulator(rom, H), path, u, start)
    check_twists(lambda: fr.Simulator(rom, H), path, u, start, 1e2, touches=False)


@pytest.mark.parametrize("parts", [{}, TIED])
def test_poses_without_inertia(tmp_path, parts):
    """Twists play no part, but poses follow them."""
    rom = reduced(tmp_path, HELD, effects=None, **parts)
    _, u, start, _ = pushed(rom, swung, steps=12)
    check_poses(lambda: fr.Simulator(rom, H), swung, u, start)
    check_twists(lambda: fr.Simulator(rom, H), swung, u, start, 1e2, touches=False)


@pytest.mark.parametrize("law", sorted(LAWS.keys() - {"turns"}))
def test_twists_through_contact(tmp_path, law):
    """Sticking, sliding and bouncing."""
    effects, obstacle = LAWS[law]
    rom = reduced(tmp_path, HELD, **{"effects.contact.obstacles.floor": obstacle} | effects)
    _, u, start, _ = pushed(rom, lowered, size=0.02, steps=14)
    check_twists(lambda: fr.Simulator(rom, H), lowered, u, start)


@pytest.mark.parametrize("parts", sorted(STILL.keys() - {"tied", "turns"}))
def test_twists_through_contact_without_inertia(tmp_path, parts):
    rom = reduced(tmp_path, HELD, effects=None, **STILL[parts])
    _, u, start, _ = pushed(rom, lowered, size=0.02, steps=14)
    check_twists(lambda: fr.Simulator(rom, H), lowered, u, start)


def sunk(time):
    """A base that lowers its body three times as fast."""
    base = lowered(3 * time)
    return base._replace(velocity=3 * base.velocity, angular_velocity=3 * base.angular_velocity)


def far(law, kind, **options):
    """A body that deforms largely, on a base."""
    rom = in_frame(KINDS[kind](soft_rom(law, order=8, contact=True, **options)))
    points = {name: np.tile(rom.nodes[-1], (len(rows) // 3, 1)) for name, rows in rom.outputs.items()}
    return replace(rom, moving_frame=replace(rom.moving_frame, output_points=points))


@pytest.mark.parametrize("law", ["st_venant_kirchhoff", "neo_hookean"])
@pytest.mark.parametrize("stepper", FINITE_STRAIN_STEPPERS)
@pytest.mark.parametrize("kind", KINDS)
def test_base_of_a_body_that_bends_far(law, stepper, kind):
    """By both steps, of a material that relaxes or not, by a tension or a stroke."""
    rom = far(law, kind)

    def make():
        return fr.Simulator(rom, H, stepper=stepper)

    _, u, start, _ = bent.along(make, "carried", 2e-3 if kind == "stroke" else 0.5, 1.0)
    check_poses(make, lowered, u, start, 1e-2)
    check_twists(make, sunk, u, start)


@pytest.mark.parametrize("law", ["st_venant_kirchhoff", "neo_hookean"])
def test_base_of_equilibria_of_a_body_that_bends_far(law):
    rom = far(law, "plain", inertia=False)
    _, u, start, _ = bent.along(lambda: fr.Simulator(rom, H), "carried", 0.5, 0.05)
    at_rest = tuple(0 * part for part in start)
    check_poses(lambda: fr.Simulator(rom, H), lowered, u, at_rest, 1e-2)
    check_twists(lambda: fr.Simulator(rom, H), sunk, u, at_rest)


def test_base_that_is_given_in_steps_is_that_of_the_environment(tmp_path):
    """And one is needed for each step."""
    rom = reduced(tmp_path, HELD)
    _, u, _, _ = pushed(rom, swung, steps=5)
    by_path = fr.differentiate(fr.Simulator(rom, H, signals={"base_path": swung}), u, squares)
    bases = [swung(H * (k + 1)) for k in range(5)]
    body = fr.Simulator(rom, H)
    body.place(swung(0.0))
    given = fr.differentiate(body, u, squares, base=bases)
    assert given.base.keys() == given.pose.keys() == set(BaseState._fields)
    assert given.twists.shape == (6, 6)
    for name, slopes in by_path.base.items():
        assert given.base[name] == pytest.approx(slopes, rel=1e-9, abs=1e-12)
    with pytest.raises(StepError, match=r"base: use one for each of 5 steps \(got 4\)"):
        fr.differentiate(body, u, squares, base=bases[1:])
