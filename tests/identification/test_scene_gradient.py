"""Gradients with material and damping of a scene: against differences of its model, and of the full order."""

from dataclasses import replace

import numpy as np
import pytest
from measuring import RUN, TRUTH, box_mesh, scene_of

import fenics_rom as fr
from fenics_rom.errors import SceneError, StepError
from fenics_rom.identification.affine import AffineSystem
from fenics_rom.identification.experiment import run_experiment
from fenics_rom.identification.parameters import select_parameters, values_of
from fenics_rom.identification.reduced_model import ReducedModel
from fenics_rom.identification.scene_gradient import gradient_of
from fenics_rom.identification.tilt import tilted
from fenics_rom.scene.effects import Gravity

LOADS = "gravity = { acceleration = [0.0, 0.0, -0.1] }"
SHORT = RUN.replace("duration = 0.6", "duration = 0.3")
ROWS = {"tip": 6, "side": 3}


@pytest.fixture(scope="module", params=[(3, 1, 1), (6, 3, 2)], ids=["on all displacements", "reduced"])
def scene(request, tmp_path_factory):
    return scene_of(box_mesh(tmp_path_factory.mktemp("mesh"), request.param), TRUTH, LOADS, run=SHORT)


def squares(outputs, energies):
    weights = np.linspace(1.0, 2.0, len(energies))
    value = sum((rows**2).sum() for rows in outputs.values()) + 10 * weights @ energies
    return value, {name: 2 * rows for name, rows in outputs.items()}, 10 * weights


def directions(scene):
    """A hundredth of the value of each parameter."""
    θ, along = values_of(scene), []
    for parameter in select_parameters(scene, None, moving=True):
        along.append(np.zeros_like(θ))
        along[-1][list(parameter.rows), parameter.column] = 0.01 * parameter.start
    return θ, along


def test_gradient_of_a_model_agrees_with_differences(scene):
    affine, (θ, along) = AffineSystem(scene), directions(scene)
    experiment, model = run_experiment(scene, affine.plain, []), ReducedModel(affine.parts(np.eye(affine.plain.size)))

    def value(θ):
        return gradient_of(model, experiment, θ, [], squares, ROWS)[0]

    J, slopes = gradient_of(model, experiment, θ, along, squares, ROWS)
    for slope, δ in zip(slopes, along, strict=True):
        near = [value(θ + s * 0.02 * δ) for s in (-2, -1, 1, 2)]
        assert (near[0] - 8 * near[1] + 8 * near[2] - near[3]) / 0.24 == pytest.approx(slope, rel=1e-8)
    together = sum(along)
    left = [abs(value(θ + ε * together) - J - ε * slopes.sum()) for ε in (0.1, 0.05)]
    assert 1.9 < np.log2(left[0] / left[1]) < 2.1


def test_gradient_is_that_of_the_full_order(scene):
    gradient = fr.differentiate_scene(scene, squares)

    def value(name, change):
        damping, materials = scene.effects.damping, scene.materials
        if name in ("alpha", "beta"):
            damping = replace(damping, **{name: getattr(damping, name) * change})
        else:
            materials = {n: replace(m, **{name: getattr(m, name) * change}) for n, m in materials.items()}
        run = fr.simulate(replace(scene, materials=materials, effects=replace(scene.effects, damping=damping)))
        return squares({n: rows[1:] for n, rows in run.outputs.items()}, run.energy[1:])[0]

    assert gradient.value == pytest.approx(value("young", 1.0), rel=1e-8)
    for name, start in TRUTH.items():
        difference = (value(name, 1.0005) - value(name, 0.9995)) / (1e-3 * start)
        assert gradient.derivatives[name] == pytest.approx(difference, rel=1e-4)  # ν of the reduced one: 4e-5


def test_gradient_with_gravitys_direction_is_that_of_the_full_order(scene):
    gradient, g = fr.differentiate_scene(scene, squares, parameters=["tilt"]), np.array([0.0, 0.0, -0.1])

    def value(tilt):
        gravity = Gravity(tuple(tilted(g, np.array(tilt)).tolist()))
        run = fr.simulate(replace(scene, effects=replace(scene.effects, gravity=gravity)))
        return squares({n: rows[1:] for n, rows in run.outputs.items()}, run.energy[1:])[0]

    differences = [(value(h) - value([-angle for angle in h])) / 0.02 for h in ([0.01, 0.0], [0.0, 0.01])]
    assert list(gradient.derivatives.values()) == pytest.approx(differences, rel=1e-4)


def test_what_cannot_be_differentiated_is_refused(scene):
    with pytest.raises(SceneError, match=r"no parameter 'yung'; .* did you mean 'young'"):
        fr.differentiate_scene(scene, squares, parameters=["yung"])
    with pytest.raises(StepError, match="no output 'top'"):
        fr.differentiate_scene(scene, squares, outputs=["top"])
    with pytest.raises(SceneError, match="use a scene with inertia"):
        fr.differentiate_scene(replace(scene, run=None), squares)
