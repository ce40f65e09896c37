"""Equilibria of bodies that deform largely: published shapes from the whole load at once, and where a body buckles."""

import re

import numpy as np
import pytest
from bodies import acted_on, box_arrays, box_surfaces, write_arrays
from random_loads import outcomes

import fenics_rom as fr
from fenics_rom.errors import SolverError
from fenics_rom.fem.finite_strain.model import ExternalForce
from fenics_rom.fem.finite_strain.residuals import QuasiStaticResidual
from fenics_rom.fem.petsc_matrix import PetscMatrix
from fenics_rom.fem.simulator import FullOrderSimulator
from fenics_rom.mechanics.active_environment import ActiveEnvironment
from fenics_rom.mechanics.isochoric import LAWS
from fenics_rom.mechanics.step import StepInput

MAX_ITERATIONS = 25
RIGHT = '[contacts.right]\nsurface = "right"'


def assembled(mesh, young, poisson, *, law="st_venant_kirchhoff", density=1.0, effects="", degree=2, **parts):
    material = f"young = {young}\npoisson = {poisson}\ndensity = {density}"
    effects = f'large_deformation = {{ material = "{law}" }}\n{effects}'
    parts = {"outputs.tip": 'surface = "right"'} | parts
    return fr.assemble(acted_on(mesh, effects, contacts=RIGHT, degree=degree, material=material, **parts))


def tip_at_rest(system, *inputs):
    """Where the tip comes to under a load that is put on at once, and what found it."""
    body = system.deformation.stepper(1.0)
    body.equilibrium(StepInput(np.array(inputs)))
    tip = body.displacement("tip").mean(axis=0)
    body.close()
    assert body.finest == 1.0
    assert body.newton <= MAX_ITERATIONS
    assert body.negative_pivots == 0
    assert not body.diagnostics()
    return tip


def princeton_beam(folder, bricks):
    """Of aluminium, loaded across both axes of its section (Dowell & Traybar, 1975); its tip of beam theory.

    See Bauchau et al., Multibody System Dynamics 37 (2016).
    """
    mesh = write_arrays(folder / "princeton.msh", *box_arrays((0.508, 0.0123777, 0.0032024), bricks))
    force, β = 13.345, np.radians(45)
    tip = tip_at_rest(assembled(mesh, 71.7e9, 0.31), 0.0, -force * np.cos(β), force * np.sin(β))
    return tip[1:], np.array([-15.186e-3, 156.467e-3])


def curved_cantilever(folder, bricks):
    """An eighth of a circle under a load across its plane (Bathe & Bolourchi, 1979); its tip of a spectral element."""
    points, cells = box_arrays((np.pi / 4, 1.0, 1.0), bricks)
    radius = 99.5 + points[:, 1]
    bent = np.column_stack([radius * np.sin(points[:, 0]), radius * np.cos(points[:, 0]), points[:, 2]])
    mesh = write_arrays(folder / "curved.msh", bent, cells, box_surfaces(points, cells))
    return tip_at_rest(assembled(mesh, 1e7, 0.0), 0.0, 0.0, 600.0), np.array([-23.65, -13.72, 53.58])


def heavy_cantilever(folder, bricks):
    """0.12 kg with 0.2 kg at the tip: FL³/3EI + qL⁴/8EI."""
    length, width, height, g = 0.9, 0.07, 0.055, 9.81
    mesh = write_arrays(folder / "heavy.msh", *box_arrays((length, width, height), bricks))
    density, weight = 0.12 / (length * width * height), f"gravity = {{ acceleration = [0, 0, {-g}] }}"
    system = assembled(mesh, 8e6, 0.25, density=density, effects=weight)
    return tip_at_rest(system, 0.0, 0.0, -0.2 * g, 1.0)[2:], np.array([-75.2e-3])


@pytest.mark.parametrize(
    ("case", "bricks", "allowed"),
    [(princeton_beam, (40, 2, 1), 0.01), (curved_cantilever, (16, 1, 1), 0.01), (heavy_cantilever, (24, 2, 2), 0.015)],
)
def test_published_shapes_come_from_the_whole_load_at_once(tmp_path, case, bricks, allowed):
    tip, published = case(tmp_path, bricks)
    assert np.linalg.norm(tip) == pytest.approx(np.linalg.norm(published), rel=allowed)


@pytest.mark.parametrize(("law", "degree"), [("st_venant_kirchhoff", 2), ("neo_hookean", 1)])
def test_factored_matrix_is_the_tangent(tmp_path, law, degree):
    """All of it, and of a pressure the symmetric part, also where some components of a node alone are held."""
    mesh = write_arrays(tmp_path / "beam.msh", *box_arrays((0.5, 0.1, 0.1), (4, 1, 1)))
    held = {"supports": 'clamped = ["left"]\n[[supports.held]]\nsurface = "top"\nnormal = [0.0, 0.0, 1.0]'}
    springs = (
        '[effects.springs.s]\nsurface = "right"\nstiffness = 10.0\n[effects.pressure.air]\nsurface = "front"\n'
        "[effects.tendon.cable]\npoints = [[0.01, 0.05, 0.05], [0.3, 0.03, 0.05], [0.49, 0.05, 0.06]]"
    )
    system = assembled(mesh, 1e6, 0.3, law=law, degree=degree, effects=springs, **held)
    body, random = system.deformation.stepper(1.0), np.random.default_rng(0)
    zero, dx = np.zeros((system.size, 1)), random.standard_normal((system.size, 1))
    model, x = system.deformation.model, 4e-3 * random.standard_normal((system.size, 1))
    for pressure in (0.0, 3e4):
        load = ExternalForce(zero, ((pressure, model.followers["air"]), (50.0, model.followers["cable"])))
        equation = QuasiStaticResidual(model, body._start, load, 0.5, zero)
        trial = equation.evaluate(x)
        matrix = PetscMatrix(body._matrix.consistent(trial.stresses, load.stiffness(trial.u)))
        found, expected = matrix @ dx, equation.apply_tangent(trial, dx) / equation.h
        matrix.destroy()
        if pressure:
            assert float(np.vdot(dx, found)) == pytest.approx(float(np.vdot(dx, expected)), rel=1e-12)
        else:
            np.testing.assert_allclose(found, expected, atol=1e-12 * np.abs(expected).max())
    body.close()


@pytest.mark.parametrize(
    ("demo", "law", "count"),
    [
        ("finger/finger", "neo_hookean", 4),
        pytest.param("bending/bending", "st_venant_kirchhoff", 2, marks=pytest.mark.slow),
        pytest.param("robots/trunk", "neo_hookean", 2, marks=pytest.mark.slow),
    ],
)
def test_random_loads_are_followed_or_end_at_a_limit_point_that_is_named(demo, law, count):
    """All 200: python tests/random_loads.py."""
    assert set(outcomes(demo, law, count)) <= {"converged", "limit point"}


def test_a_limit_point_is_named_at_its_load(tmp_path):
    """P = E A λ(1 - λ²)/2 of a St. Venant-Kirchhoff bar between rollers has its largest value where λ² = 1/3."""
    mesh = write_arrays(tmp_path / "bar.msh", *box_arrays((2.0, 1.0, 1.0), (2, 1, 1)))
    sides = {"front": [0.0, 1.0, 0.0], "back": [0.0, 1.0, 0.0], "bottom": [0.0, 0.0, 1.0], "top": [0.0, 0.0, 1.0]}
    rollers = "".join(f'\n[[supports.held]]\nsurface = "{side}"\nnormal = {normal}' for side, normal in sides.items())
    system = assembled(mesh, 1e6, 0.0, degree=1, supports=f'clamped = ["left"]{rollers}')
    body, most, asked = system.deformation.stepper(1.0), 1e6 / 27**0.5, 1.2
    with pytest.raises(SolverError, match="comes to a limit point") as error:
        body.equilibrium(StepInput(np.array([-asked * most, 0.0, 0.0])))
    reached, kept = re.search(r"than the (\S+) of it .* keeps (\S+) of its", str(error.value)).groups()
    assert 1 / asked - 1 / 1024 - 5e-4 <= float(reached) <= 1 / asked + 5e-4
    λ = np.polynomial.Polynomial([asked * float(reached) * 27**-0.5, -0.5, 0, 0.5]).roots().max()
    assert float(kept) == pytest.approx((3 * λ**2 - 1) / (2 * λ**2), abs=0.02)
    body.equilibrium(StepInput(np.array([-0.9 * most, 0.0, 0.0])))
    assert body.negative_pivots == 0
    body.close()


@pytest.mark.parametrize("law", LAWS)
def test_a_column_is_told_to_buckle_at_eulers_load(tmp_path, law):
    """A square one has two directions to go; a load beyond it is followed, and what leads there is put on in parts."""
    length, thick, young = 0.5, 0.025, 1e6
    mesh = write_arrays(tmp_path / "column.msh", *box_arrays((length, thick, thick), (10, 1, 1)))
    euler = np.pi**2 * young * thick**4 / 12 / (2 * length) ** 2
    system, told = assembled(mesh, young, 0.0, law=law), []
    body = system.deformation.stepper(1.0, ActiveEnvironment(system.scene.environment))
    body.report = lambda *progress: told.append(progress)
    body.step(StepInput(np.array([-0.9 * euler, 0.0, 0.0])))
    assert body.negative_pivots == 0
    assert not body.diagnostics()
    stage, iteration, allowed = told[-1]
    assert stage.startswith("equilibrium: load 1, residual ")
    assert iteration <= allowed == MAX_ITERATIONS
    body.step(StepInput(np.array([-1.1 * euler, 0.0, 0.0])))
    assert body.negative_pivots == 2
    message = next(text for text in body.diagnostics() if "buckles" in text)
    reached = re.search(r"at (\S+) to (\S+) of the step", message).groups()
    assert [0.9 + 0.2 * float(share) for share in reached] == pytest.approx([1.0, 1.0], abs=0.01)
    assert "2 negative pivots" in message
    np.testing.assert_allclose(body.ledger.supplied - body.ledger.numerical, body.energy, rtol=1e-9)
    body.rollback()
    assert body.negative_pivots == 0
    assert not any("buckles" in text for text in body.diagnostics())
    body.close()


@pytest.mark.parametrize("young", [5e4, 2e11])
@pytest.mark.parametrize("least", [0.0, 1e-12])
def test_a_load_that_is_let_go_leaves_the_shape_at_rest(tmp_path, young, least):
    """Then no force is left that the last correction could be small against, but those that there were before."""
    mesh = write_arrays(tmp_path / "beam.msh", *box_arrays((0.3, 0.03, 0.02), (4, 1, 1)))
    system = assembled(mesh, young, 0.4, degree=1)
    body = FullOrderSimulator(system, 1.0, system.scene.environment)
    bent = 0.0
    for share in (1.0, 1.0, 0.5, least, 0.0, 1e-9, 0.0):
        body.step(np.array([0.0, 0.0, 4e-7 * share * young]))
        bent = max(bent, np.abs(body.stepper.x).max())
    assert bent > 1e-3
    assert np.abs(body.stepper.x).max() <= 1e-12 * bent
    body.close()
