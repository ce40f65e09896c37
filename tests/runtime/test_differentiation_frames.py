"""Gradients of bodies that a base carries, however it moves; what moves in its frame otherwise is refused by name."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from bodies import box_arrays, scene_text, write_arrays
from gradient_checks import check_gradient, squares

import fenics_rom as fr
from fenics_rom.errors import StructureError
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
FLOOR = {"effects.contact.obstacles.floor": 'shape = "half-space"\npoint = [0, 0, -1]\nnormal = [0, 0, 1]'}


def reduced(folder, supports, **parts):
    """A ROM of a box in a moving frame."""
    mesh = write_arrays(folder / "box.msh", *box_arrays((0.3, 0.03, 0.02), (6, 1, 1)))
    material = "young = 5e5\npoisson = 0.4\ndensity = 1100.0"
    text = scene_text(mesh, supports=supports, material=material, damping="alpha = 0.5, beta = 2e-4", **LOADS | parts)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return fr.reduce(fr.assemble(parse_scene(f'frame = "moving"\n{text}')), order=8)


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


def along(rom, base):
    """Inputs, state and directions, and how a body is put there."""
    random, order = np.random.default_rng(0), 8

    def body(q, r):
        body = fr.Simulator(rom, H, signals={"base_path": base})
        body.state = q, r
        return body

    u = random.standard_normal((STEPS, body(np.zeros(order), np.zeros(order)).inputs))
    ω = np.sqrt(next(iter(rom.contact_models.values())).eigenvalues)
    start = 1e-2 * random.standard_normal(order) / ω, 1e-2 * random.standard_normal(order)
    sizes = (u.std(axis=0), *map(np.abs, start))
    directions = [size * random.standard_normal(part.shape) for size, part in zip(sizes, (u, *start), strict=True)]
    return body, u, start, directions


@pytest.mark.parametrize("base", [swung, still])
def test_gradient_of_a_carried_body_agrees_with_differences(carried, base):
    check_gradient(*along(carried, base))


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


def test_what_moves_in_its_frame_otherwise_is_refused_by_name(tmp_path):
    free = fr.Simulator(reduced(tmp_path, None), H)
    with pytest.raises(StructureError, match="a free body in a moving frame: its steps are not differentiated"):
        fr.differentiate(free, np.zeros((3, free.inputs)), squares)
    touched = fr.Simulator(reduced(tmp_path, 'clamped = ["left"]', **FLOOR), H)
    with pytest.raises(StructureError, match="contact in a moving frame: its steps are not differentiated"):
        fr.differentiate(touched, np.zeros((3, touched.inputs)), squares)
