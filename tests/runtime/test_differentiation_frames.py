"""Gradients of bodies that turn as far as they like: free, or carried by a base however it moves; with contact."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from bodies import box_arrays, scene_text, write_arrays
from gradient_checks import check_gradient, squares
from turning import spin

import fenics_rom as fr
from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.mechanics.frame_motion import quaternion_of_vector
from fenics_rom.scene.file import parse_scene

H, STEPS = 2e-3, 40
pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
LOADS = {
    "effects.gravity": "acceleration = [0.0, 0.0, -9.81]",
    "effects.prescribed.pull": 'surface = "right"\nforce = [0.01, -0.02, 0.03]',
    "effects.tendon.rope": "points = [[0.0, 0.01, 0.01], [0.15, 0.02, 0.0], [0.3, 0.01, 0.01]]",
    "outputs.tip": "points = [[0.3, 0.0, 0.0], [0.3, 0.03, 0.02]]",
}


def reduced(folder, supports, method=None, **parts):
    """A ROM of a box in a moving frame."""
    mesh = write_arrays(folder / "box.msh", *box_arrays((0.3, 0.03, 0.02), (6, 1, 1)))
    material = "young = 5e5\npoisson = 0.4\ndensity = 1100.0"
    text = scene_text(mesh, supports=supports, material=material, damping="alpha = 0.5, beta = 2e-4", **LOADS | parts)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return fr.reduce(fr.assemble(parse_scene(f'frame = "moving"\n{text}')), order=8, method=method)


@pytest.fixture(scope="module")
def carried(tmp_path_factory):
    return reduced(tmp_path_factory.mktemp("carried"), 'clamped = ["left"]')


def swung(time):
    """A base that goes and turns, with twists of its own."""
    rotation = quaternion_of_vector((0.5 * np.sin(9 * time), 0.3 * time, 0.8 * np.sin(5 * time)))
    velocity = np.array([0.4 * np.cos(8 * time), 0.2, -0.3 * np.sin(7 * time)])
    spin = np.array([4.5 * np.cos(9 * time), 0.3, 4.0 * np.cos(5 * time)])
    return BaseState(np.array([0.05 * np.sin(8 * time), 0.2 * time, 0.0]), np.array(rotation), velocity, spin)


def still(time):
    """A base that stands, turned."""
    return BaseState(np.zeros(3), np.array(quaternion_of_vector((0.3, 1.0, 0.2))), np.zeros(3), np.zeros(3))


def thrown(position, turn, velocity, spin):
    """The pose of a free body, moved by a vector each from where it is thrown, and as it flies then."""
    rotation = quaternion_of_vector(turn)
    velocity, spin = np.array([0.05, 0.02, -0.2]) + velocity, np.array([0.3, -0.2, 1.5]) + spin
    return BaseState(np.array([0.15, 0.015, 0.0105]) + position, np.array(rotation), velocity, spin)


def along(rom, base=None, size=1.0, steps=STEPS):
    """Inputs, start and directions, and how a body is put there: carried by a base, or thrown."""
    random, signals = np.random.default_rng(0), {} if base is None else {"base_path": base}
    if rom.environment.turns_obstacles:
        signals["floor"] = TURNS
    at_rest = fr.Simulator(rom, H, signals=signals)
    order, ω = at_rest.model.order, np.sqrt(at_rest.model.eigenvalues)

    def body(q, r, *pose):
        body = fr.Simulator(rom, H, signals=signals)
        body.state = q, r
        if pose:
            body.place(thrown(*pose))
        return body

    u = size * random.standard_normal((steps, at_rest.inputs))
    start = 1e-2 * size * random.standard_normal(order) / ω, 1e-2 * size * random.standard_normal(order)
    if not rom.environment.has_inertia:
        start = 0 * start[0], 0 * start[1]
    sizes = (u.std(axis=0), *map(np.abs, start))
    directions = [size * random.standard_normal(part.shape) for size, part in zip(sizes, (u, *start), strict=True)]
    if base is None:
        start += tuple(np.zeros((4, 3)))
        directions += list(np.array([0.01, 0.1, 0.1, 0.3])[:, None] * size * random.standard_normal((4, 3)))
    return body, u, start, directions


@pytest.mark.parametrize("base", [swung, still])
def test_gradient_of_a_carried_body_agrees_with_differences(carried, base):
    check_gradient(*along(carried, base))


def test_gradient_without_inertia_agrees_with_differences(tmp_path):
    """On a base that moves, which turns the loads."""
    rom = reduced(tmp_path, 'clamped = ["left"]', effects=None)
    check_gradient(*along(rom, swung))


def test_stiffness_and_damping_of_a_carried_body(carried):
    body, u, start, _ = along(carried, swung)
    gradient, random = fr.differentiate(body(*start), u, squares), np.random.default_rng(1)
    for name, slopes in (("eigenvalues", gradient.eigenvalues), ("damping", gradient.damping)):
        values = {contact: getattr(model, name) for contact, model in carried.contact_models.items()}
        δ = {contact: value * random.uniform(0.5, 1.5, value.shape) for contact, value in values.items()}

        def value(ε, name=name, values=values, δ=δ):
            models = {
                contact: replace(model, **{name: values[contact] + ε * δ[contact]})
                for contact, model in carried.contact_models.items()
            }
            changed = fr.Simulator(replace(carried, contact_models=models), H, signals={"base_path": swung})
            changed.state = start
            return fr.differentiate(changed, u, squares).value

        slope = sum((slopes[contact] * along).sum() for contact, along in δ.items())
        assert slope == pytest.approx((value(1e-5) - value(-1e-5)) / 2e-5, rel=1e-6)


@pytest.fixture(scope="module")
def free(tmp_path_factory):
    return reduced(tmp_path_factory.mktemp("free"), None)


def test_gradient_of_a_free_body_agrees_with_differences(free):
    """Also with how it was thrown; it turns by 90 degrees."""
    check_gradient(*along(free))


FLOOR = 'shape = "half-space"\npoint = [0.0, 0.0, -0.001]\nnormal = [0.0, 0.1, 1.0]'
BALL = 'shape = "sphere"\ncenter = [0.3, 0.0, -0.1005]\nradius = 0.1'
AXIS = [0.28, 0.05, -0.12]
LAWS = {
    "floor": ({}, FLOOR),
    "rough ball": ({"effects.friction": "coefficient = 0.3"}, BALL),
    "bounces": ({"effects.friction": "coefficient = 0.3", "effects.contact": "restitution = 0.5"}, FLOOR),
    "bare": ({"effects.friction": "coefficient = 0.3", "effects.contact": "residual_compliance = false"}, FLOOR),
    "springs": ({"effects.contact": "method = 'penalty'\nstiffness = 20.0"}, BALL),
    "turns": ({"effects.friction": "coefficient = 0.3"}, f"{BALL}\nmotion = {{ origin = {AXIS} }}"),
}
TURNS = spin(AXIS, [0.3, 0.8, 0.5], 2.0, ramp=0.02)


def lowered(time):
    """A base that lowers its body onto what is there, and draws and turns it."""
    rotation = quaternion_of_vector((0.0, 0.3 * time, 0.1 * time))
    velocity = np.array([0.1, 0.0, -0.15])
    return BaseState(time * velocity, np.array(rotation), velocity, np.array([0.0, 0.3, 0.1]))


@pytest.mark.parametrize("supports", [None, 'clamped = ["left"]'], ids=["free", "carried"])
@pytest.mark.parametrize("law", LAWS)
def test_gradient_goes_through_contact_of_what_turns(tmp_path, supports, law):
    """Sticking, sliding and bouncing, on points that move with the frame, and what they yield beyond the basis."""
    effects, obstacle = LAWS[law]
    rom = reduced(tmp_path, supports, **{"effects.contact.obstacles.floor": obstacle} | effects)
    at, u, start, directions = along(rom, None if supports is None else lowered, size=0.02, steps=14)
    body, touched = at(*start), 0
    for row in u:
        body.step(row)
        touched += body.contact_forces().any()
    assert touched >= 3
    check_gradient(at, u, start, directions, ε=1e-3)


TIED = {"effects.springs.bed": 'surface = "right"\nstiffness = 20.0'}
STILL = {name: {"effects.contact.obstacles.floor": obstacle} | effects for name, (effects, obstacle) in LAWS.items()}
STILL |= {"tied": TIED, "tied on a floor": TIED | STILL["floor"]}
del STILL["bounces"]


@pytest.mark.parametrize("parts", STILL)
def test_gradient_without_inertia_goes_through_contact_and_springs_to_the_ground(tmp_path, parts):
    """On a base that draws, lowers and turns the body."""
    rom = reduced(tmp_path, 'clamped = ["left"]', effects=None, **STILL[parts])
    at, u, start, directions = along(rom, lowered, size=0.02, steps=14)
    body, touched = at(*start), 0
    for row in u:
        body.step(row)
        touched += len(body.contact_coordinates) and body.contact_forces().any()
    assert touched >= 3 or parts == "tied"
    gradient = check_gradient(at, u, start, directions, ε=1e-3)
    if parts in ("bare", "tied"):
        check_stiffness(rom, u, gradient)


def check_stiffness(rom, u, gradient):
    """Derivatives with γ of a body without residual compliance."""
    random = np.random.default_rng(1)
    δ = {name: model.eigenvalues * random.uniform(0.5, 1.5, model.order) for name, model in rom.contact_models.items()}

    def value(ε):
        models = {
            name: replace(model, eigenvalues=model.eigenvalues + ε * δ[name])
            for name, model in rom.contact_models.items()
        }
        body = fr.Simulator(replace(rom, contact_models=models), H, signals={"base_path": lowered})
        return fr.differentiate(body, u, squares).value

    slope = sum((gradient.eigenvalues[contact] * along).sum() for contact, along in δ.items())
    assert slope == pytest.approx((value(1e-5) - value(-1e-5)) / 2e-5, rel=1e-6)
