"""A factor that turns with the body: the tangent of the turned body exactly, fewer factors, and the same motion."""

import numpy as np
import pytest
from bodies import acted_on, box_arrays, write_arrays

import fenics_rom as fr
from fenics_rom.fem.direct import PetscFactor
from fenics_rom.fem.finite_strain.residuals import MidpointResidual
from fenics_rom.fem.finite_strain.secants import Secants
from fenics_rom.fem.finite_strain.stresses import IDENTITY
from fenics_rom.fem.finite_strain.tangent_matrix import TangentCoefficients
from fenics_rom.fem.finite_strain.turned_factor import TurnedFactor
from fenics_rom.fem.petsc_matrix import PetscMatrix
from fenics_rom.mechanics.step import StepInput

PLANE = '\n[[supports.held]]\nsurface = "bottom"\nnormal = [0.0, 0.0, 1.0]'
PARTS = {
    "contacts": '[contacts.right]\nsurface = "right"',
    "material": "young = 1e6\npoisson = 0.35\ndensity = 1000.0",
    "effects": 'inertia = {}\nlarge_deformation = { material = "neo_hookean" }\n',
}


@pytest.fixture(scope="module")
def beam(tmp_path_factory):
    mesh = box_arrays((0.4, 0.05, 0.05), (4, 1, 1), shake=0.1)
    return write_arrays(tmp_path_factory.mktemp("turned") / "beam.msh", *mesh)


def assembled(mesh, **parts):
    return fr.assemble(acted_on(mesh, **(PARTS | parts)))


@pytest.mark.parametrize("supports", [None, PLANE], ids=["free", "on a plane"])
def test_factor_of_a_turned_body_is_the_turned_factor(beam, supports):
    system = assembled(beam, supports=supports)
    body, random = system.deformation.stepper(1e-3), np.random.default_rng(0)
    c, s = np.cos(0.7), np.sin(0.7)
    R, points = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]), body._model.points
    H = 0.1 * random.standard_normal((3, 3, len(points.weights)))
    H[:2, 2] = H[2, :2] = 0.0  # so that the plane stays one
    turned = np.einsum("ij,jkp->ikp", R, IDENTITY + H) - IDENTITY
    coefficients = TangentCoefficients(2e3, 1.0, stiffness=5e-4, viscosity=1.0)
    matrix = PetscFactor(body._matrix.definite(H, coefficients), one_by_one=True)
    factor = TurnedFactor(matrix, points, H, body._model.components)
    factor.turn(turned)
    b = random.standard_normal((system.size, 2))
    A = PetscMatrix(body._matrix.definite(turned, coefficients))
    np.testing.assert_allclose(A @ factor.solve(b), b, atol=1e-10)
    factor.turn(H)
    assert np.abs(A @ factor.solve(b) - b).max() > 1e-2
    factor.close()
    A.destroy()
    body.close()


def swung(system, steps=40):
    """Where a beam ends whose tip is pushed to and fro, and iterations and factors on the way."""
    body, iterations = system.deformation.stepper(0.01), 0
    for step in range(steps):
        body.step(StepInput(np.array([0.0, 0.0, 10 * np.sin(0.2 * step) ** 2])))
        iterations += body.newton + body.products
    x = body.x.copy()
    body.close()
    return x, iterations, body.factors


def test_factor_that_turns_saves_work(beam, monkeypatch):
    """So do the secants of the steps before, and secants; none of them changes the motion."""
    system = assembled(beam)
    x, iterations, factors = swung(system)
    begin = Secants.begin
    for owner, name, less, share in (
        (TurnedFactor, "turn", lambda self, H: None, 0.75),
        (Secants, "begin", lambda self: (self.forget(), begin(self)), 0.99),
        (Secants, "direction", lambda self, answer: answer, 0.7),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(owner, name, less)
            same, more, others = swung(system)
        assert np.abs(x - same).max() <= 1e-9 * np.abs(x).max()
        assert iterations <= share * more, name
        assert factors <= others


def test_motion_is_that_of_plain_newton(beam):
    """Whole steps with the dense consistent tangent, from the velocity before, to round-off."""
    system, h = assembled(beam), 2e-3
    body = system.deformation.stepper(h)
    plain = system.deformation.stepper(h)
    for step in range(10):
        push = StepInput(np.array([0.0, 0.0, 20 * np.sin(0.3 * step) ** 2]))
        body.step(push)
        equation = MidpointResidual(plain._model, plain._start, plain._load(push.u)[0], h, plain._matrix)
        v = plain.v
        for _ in range(8):
            trial = equation.evaluate(v)
            J = np.hstack([equation.apply_tangent(trial, column[:, None]) for column in np.eye(system.size)])
            v = v + np.linalg.solve(J, trial.residual)
        plain.set_state(plain.x + h * v, 2 * v - plain.v)
    assert np.abs(body.x).max() > 5e-3
    assert np.abs(body.x - plain.x).max() <= 1e-9 * np.abs(plain.x).max()
    body.close()
    plain.close()
