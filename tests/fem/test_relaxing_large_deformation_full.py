"""Large deformation at full order of a material that relaxes: closed forms, the account, and the reduced model."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from bodies import acted_on, box_arrays, dense, write_arrays

import fenics_rom as fr
from fenics_rom.fem.finite_strain.model import ExternalForce
from fenics_rom.fem.finite_strain.residuals import MidpointResidual, StepStart
from fenics_rom.fem.simulator import FullOrderSimulator
from fenics_rom.mechanics.active_environment import ActiveEnvironment
from fenics_rom.mechanics.isochoric import LAWS
from fenics_rom.mechanics.step import StepInput
from fenics_rom.mechanics.viscoelasticity import MaxwellBranches, PronySeries
from fenics_rom.reduction.hyperreduction import training
from fenics_rom.rom.deformation import ReducedDeformation

SERIES = PronySeries((0.8, 0.4), (5e-3, 0.1))
BRANCHES = "[effects.viscoelasticity]\nratios = [0.8, 0.4]\ntimes = [5e-3, 0.1]\n"
DAMPED = "inertia = {}\ndamping = { alpha = 1.0, beta = 2e-3 }\n"
PARTS = {
    "material": "young = 1e6\npoisson = 0.35\ndensity = 1000.0",
    "contacts": '[contacts.right]\nsurface = "right"',
    "outputs.tip": 'surface = "right"',
}
LOAD = "dt = 5e-3\nduration = 0.25\nload = [{ contact = 'right', force = [0.0, 2.0, 12.0] }]"
CLOSES_TO = 1e-10  # of the largest energy or work seen, as in test_large_deformation.py
BOTH_LAWS = pytest.mark.parametrize("law", LAWS)

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")


@pytest.fixture(scope="module")
def beam(tmp_path_factory):
    mesh = box_arrays((0.4, 0.05, 0.05), (4, 1, 1), shake=0.1)
    return write_arrays(tmp_path_factory.mktemp("relaxing") / "beam.msh", *mesh)


def large(law):
    return f'large_deformation = {{ material = "{law}" }}\n'


def assembled(mesh, effects, **parts):
    return fr.assemble(acted_on(mesh, effects, **(PARTS | parts)))


def stepper_of(system, dt):
    return system.deformation.stepper(dt, ActiveEnvironment(system.scene.environment))


def gap(body):
    """What the account does not explain of the stored energy, J."""
    return abs(body.energy - body.ledger.supplied + body.ledger.dissipated)


@BOTH_LAWS
def test_tangent_is_the_change_of_the_residual(beam, law):
    system, random = assembled(beam, DAMPED + large(law)), np.random.default_rng(1)
    model, h = system.deformation.model, 0.02
    points = 6 * len(model.points.weights)
    x, v, force, at, dv = np.array([4e-3, 0.1, 1.0, 0.3, 1.0])[:, None, None] * random.standard_normal(
        (5, system.size, 1)
    )
    branches = MaxwellBranches(SERIES, 2, points)
    branches.set_time_step(h)
    branches.resume(np.vstack([0.05, 1e5] * 2) * random.standard_normal((4, points)))
    matrix = system.deformation.stepper(h)._matrix
    start = StepStart.at(model, x, v)
    equation = MidpointResidual(model, start, ExternalForce(force, ()), h, matrix, branches)
    ahead, behind = equation.evaluate(at + 1e-6 * dv).residual, equation.evaluate(at - 1e-6 * dv).residual
    found = equation.apply_tangent(equation.evaluate(at), dv)
    np.testing.assert_allclose(found, (behind - ahead) / 2e-6, atol=1e-6 * np.abs(found).max())
    elastic = MidpointResidual(model, start, ExternalForce(force, ()), h, matrix)
    assert np.abs(elastic.apply_tangent(elastic.evaluate(at), dv) - found).max() > 0.05 * np.abs(found).max()


@BOTH_LAWS
def test_account_closes_over_rough_steps(beam, law):
    system, random, scale = assembled(beam, DAMPED + large(law) + BRANCHES), np.random.default_rng(0), 0.0
    body = stepper_of(system, 1e-3)
    for step in range(40):
        dissipated = body.ledger.dissipated
        body.set_time_step(10 ** random.uniform(-4, -1.5))
        body.step(StepInput(np.array([3.0, 3.0, 12.0]) * random.standard_normal(3) * (step < 30)))
        scale = max(scale, body.energy, abs(body.ledger.supplied), body.ledger.dissipated)
        assert gap(body) <= CLOSES_TO * scale
        assert body.ledger.dissipated >= dissipated
    assert body.ledger.dissipated > 0.3 * scale
    body.close()


def whole(system):
    """The reduced model with all modes and all points, by LAPACK."""
    K, M = (dense(matrix, system.size) for matrix in (system.stiffness, system.mass))
    γ, W = scipy.linalg.eigh(K, M)
    n, body = system.size, system.deformation
    rom = fr.reduce(system, order=4, method="modal+derivatives")
    model = rom.contact_models["right"]
    damping = W.T @ dense(system.damping, n) @ W
    model = replace(
        model,
        eigenvalues=γ,
        damping=np.diag(damping),
        inputs=W.T @ system.input_matrix("right"),
        coordinates=np.eye(n),
        directions=np.eye(n),
    )
    external = W.T @ (body.external_damping @ W)
    deformation = ReducedDeformation(
        law=body.law,
        gradients=body.gradients(W),
        weights=body.weights,
        first_lame=body.first_lame,
        shear=body.shear,
        viscosity=body.viscosity,
        external_damping=(external + external.T) / 2,
        springs=np.zeros((n, n)),
        training_radius=1.0,
        points_of=len(body.weights),
        cubature_error=0.0,
    )
    outputs = {"tip": system.outputs["tip"].T @ W}
    return replace(
        rom,
        contact_models={"right": model},
        basis=W,
        stiffness=γ,
        outputs=outputs,
        deformation=deformation,
        residual_compliance=None,
    )


@BOTH_LAWS
def test_reduced_model_of_all_modes_and_points_is_the_full_one(beam, law):
    """Newton's steps to what both leave of the residual; the linearly implicit one to second order."""
    system = assembled(beam, DAMPED + large(law) + BRANCHES, run=LOAD)
    rom = whole(system)
    full, newton = stepper_of(system, 5e-3), fr.Simulator(rom, 5e-3, stepper="newton")
    implicit, furthest = fr.Simulator(rom, 5e-3, stepper="linearly-implicit"), 0.0
    for step in range(40):
        u = np.array([0.0, 2.0, 12.0]) * (step < 25)
        full.step(StepInput(u))
        for body in (newton, implicit):
            body.step(u)
        x, furthest = full.displacement("tip"), max(furthest, np.abs(full.displacement("tip")).max())
        np.testing.assert_allclose(newton.displacement("tip"), x, atol=1e-8 * furthest)
    assert furthest > 0.05
    assert newton.energy == pytest.approx(full.energy, rel=1e-7)
    assert newton.ledger.dissipated == pytest.approx(full.ledger.dissipated, rel=1e-8)
    assert np.abs(implicit.displacement("tip") - x).max() < 0.02 * furthest
    full.close()


def test_tension_of_a_cable_that_is_held_relaxes_by_the_series(beam):
    """T(t) = T(∞) (1 + Σ g e^(-t/τ)) of St. Venant-Kirchhoff, in the shape that it keeps; T(∞) of the elastic body."""
    cable = (
        "[effects.tendon.cable]\npoints = [[0.02, 0.02, 0.04], [0.2, 0.02, 0.045], [0.38, 0.02, 0.04]]\n"
        'control = "length"\n'
    )
    slow = BRANCHES.replace("5e-3, 0.1", "0.2, 1.0")
    moving = assembled(
        beam, f"inertia = {{}}\n{large(LAWS[0])}damping = {{ alpha = 20.0, beta = 5e-3 }}\n{slow}{cable}"
    )
    still = assembled(beam, large(LAWS[0]) + cable)
    pulled, dt = np.array([0.0, 0.0, 0.0, 0.02]), 4e-3
    rest = FullOrderSimulator(still, 1.0, still.scene.environment)
    rest.step(pulled)
    body, found = FullOrderSimulator(moving, dt, moving.scene.environment), []
    for _ in range(200):
        body.step(pulled)
        found.append(body.reactions["cable"])
    t = dt * np.arange(200)  # from the middle of the step that pulls to the middle of each
    expected = rest.reactions["cable"] * (1 + 0.8 * np.exp(-t / 0.2) + 0.4 * np.exp(-t / 1.0))
    found, expected = (np.convolve(T, [0.5, 0.5], "valid") for T in (found, expected))  # a stroke that jumps rings on
    np.testing.assert_allclose(found[75:], expected[75:], rtol=6e-3)
    assert np.abs(rest.displacement("tip")).max() > 0.03
    for each in (body, rest):
        each.close()


def test_small_loads_give_the_linear_effect(beam):
    gaps = []
    for size in (0.02, 0.01):
        bent, straight = (
            FullOrderSimulator(system, 5e-3, system.scene.environment)
            for system in (assembled(beam, DAMPED + kind + BRANCHES) for kind in (large(LAWS[1]), ""))
        )
        for step in range(30):
            for body in (bent, straight):
                body.step(np.array([0.0, 3 * size, size]) * (step < 20))
        gaps.append(np.abs(bent.displacement("tip") - straight.displacement("tip")).max())
        assert bent.ledger.dissipated == pytest.approx(straight.ledger.dissipated, rel=0.01)
        size_of_motion = np.abs(straight.displacement("tip")).max()
        for body in (bent, straight):
            body.close()
    assert gaps[1] < 0.01 * size_of_motion
    assert gaps[0] / gaps[1] > 3.8


@pytest.mark.slow
def test_training_knows_that_the_material_relaxes(beam, monkeypatch):
    """What is trained and validated with relaxes, so that its error is not that of an elastic body."""
    monkeypatch.setattr(training, "MIN_RUNS", 3)
    monkeypatch.setattr(training, "MAX_RUNS", 3)
    system = assembled(beam, DAMPED + large(LAWS[1]) + BRANCHES, run=LOAD)
    rom = fr.reduce(system, order=10)
    assert rom.deformation.validation_error < 0.02
    full, part = (fr.simulate(what, dt=5e-3) for what in (system, rom))
    scale = np.abs(full.outputs["tip"]).max()
    assert np.abs(part.outputs["tip"] - full.outputs["tip"]).max() < 0.02 * scale
    elastic = replace(rom, environment=replace(rom.environment, viscoelasticity=None))
    assert np.abs(fr.simulate(elastic, dt=5e-3).outputs["tip"] - full.outputs["tip"]).max() > 0.1 * scale
