"""M, D, K and the inputs are sums of parts, exactly; and so are their derivatives."""

import tomllib

import numpy as np
import pytest
from bodies import box_arrays, box_surfaces, dense, write_arrays
from measuring import TRUTH, box_mesh, scene_of

import fenics_rom as fr
from fenics_rom.identification.affine import AffineSystem
from fenics_rom.identification.parameters import (
    directions_at,
    parameters_of,
    scene_with,
    select_parameters,
    values_at,
    values_of,
)
from fenics_rom.scene.file import parse_scene

EFFECTS = """
gravity = { acceleration = [0.0, 1.0, -9.81] }
[effects.springs.bed]
surface = "front"
stiffness = 50.0
[effects.base_motion.quake]
direction = [0, 1, 1]
acceleration = 0.5
[effects.prescribed.push]
surface = "top"
force = [0.0, 2.0, 0.0]
[effects.pressure.air]
surface = "back"
"""


def two_materials(folder):
    points, cells = box_arrays((1.0, 0.4, 0.3), (3, 1, 1), shake=0.2)
    halves = {"inner": np.arange(6), "outer": np.arange(6, len(cells))}
    mesh = write_arrays(folder / "two.msh", points, cells, box_surfaces(points, cells), halves)
    text = f"""
[mesh]
file = "{mesh}"
[materials.soft]
young = 2e4
poisson = 0.35
density = 1200.0
cells = "inner"
[materials.hard]
young = 9e5
poisson = 0.1
density = 2500.0
cells = "outer"
[supports]
clamped = ["left"]
[contacts.right]
surface = "right"
[outputs.tip]
points = [[1.0, 0.0, 0.3]]
[effects]
inertia = {{}}
[effects.damping]
alpha = 2.0
beta = 5e-3
materials.hard = {{ alpha = 7.0, beta = 1e-4 }}
[effects.damping.dashpots.oil]
surface = "right"
coefficient = 3.0
"""
    return parse_scene(text + EFFECTS[EFFECTS.index("[effects.springs") :])


def one_material(folder):
    return scene_of(box_mesh(folder), TRUTH, EFFECTS)


@pytest.mark.parametrize("make", [one_material, two_materials])
def test_matrices_and_inputs_are_those_assembled_at_any_values(tmp_path, make):
    scene = make(tmp_path)
    affine = AffineSystem(scene)
    size = affine.plain.size
    parts = affine.parts(np.eye(size))
    parameters, rng = select_parameters(scene, None, moving=True), np.random.default_rng(0)
    assert len(parameters) == (5 if make is one_material else 10)
    for _ in range(3):
        θ = values_at(values_of(scene), parameters, rng.uniform(-0.8, 0.8, len(parameters)))
        system, found = fr.assemble(scene_with(scene, θ)), parts.at(θ)
        for A, name in ((found.mass, "mass"), (found.damping, "damping"), (found.stiffness, "stiffness")):
            wanted = dense(getattr(system, name), size)
            assert np.abs(A - wanted).max() <= 1e-12 * np.abs(wanted).max(), name
        for name in scene.contacts:
            wanted = system.input_matrix(name)
            assert (
                np.abs(parts.input_matrix(name, θ) - wanted).max(axis=0) <= 1e-12 * np.abs(wanted).max(axis=0)
            ).all()


@pytest.mark.parametrize("make", [one_material, two_materials])
def test_derivatives_are_those_of_differences(tmp_path, make):
    scene = make(tmp_path)
    affine = AffineSystem(scene)
    parts = affine.parts(np.eye(affine.plain.size))
    parameters, start = select_parameters(scene, None, moving=True), values_of(scene)
    q = np.random.default_rng(1).uniform(-0.3, 0.3, len(parameters))
    directions, h = directions_at(start, parameters, q), 1e-4
    for k, dθ in enumerate(directions):
        step = h * np.eye(len(q))[k]
        ends = [parts.at(values_at(start, parameters, at)) for at in (q + step, q - step)]
        along = parts.along(values_at(start, parameters, q), dθ)
        for name in ("mass", "damping", "stiffness"):
            after, before = (getattr(end, name) for end in ends)
            difference = (after - before) / (2 * h)
            assert np.abs(getattr(along, name) - difference).max() <= 1e-6 * np.abs(after).max(), name


def test_a_scene_with_its_own_values_is_itself(tmp_path):
    scene = two_materials(tmp_path)
    same = scene_with(scene, values_of(scene))
    assert same.materials == scene.materials
    assert same.effects == scene.effects


def test_parameters_of_several_materials_are_named_and_found_in_the_scene_file(tmp_path):
    scene = two_materials(tmp_path)
    parameters = parameters_of(scene)
    own = ("soft.young", "soft.poisson", "soft.density", "hard.young", "hard.poisson", "hard.density")
    assert list(parameters) == [*own, "alpha", "hard.alpha", "beta", "hard.beta"]
    for parameter in parameters.values():
        holder = tomllib.loads(scene.text)
        for key in parameter.path:
            holder = holder[key]
        assert holder == parameter.start
    assert [p.name for p in select_parameters(scene, None, moving=False)] == [
        name for name in own if "density" not in name
    ]
