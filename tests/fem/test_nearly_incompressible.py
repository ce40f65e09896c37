"""Rubber: laws with constants, and changes of volume in the middle of cells, so that nothing locks."""

import numpy as np
import pytest
from bodies import assembled, box_arrays, write_arrays
from scipy.optimize import brentq

import fenics_rom as fr
from fenics_rom.mechanics.step import StepInput

SHEAR, POISSON = 1e5, 0.499
YOUNG = 2 * SHEAR * (1 + POISSON)
RUBBER = f"young = {YOUNG}\npoisson = {POISSON}\ndensity = 1000.0"
SLIDING = "\n".join(
    f'[[supports.held]]\nsurface = "{surface}"\nnormal = {normal}'
    for surface, normal in [("left", [1.0, 0.0, 0.0]), ("front", [0.0, 1.0, 0.0]), ("bottom", [0.0, 0.0, 1.0])]
)
TIP = '[contacts.right]\nsurface = "right"\nforce = "resultant"'


def silicone(mesh, effects, contacts, **parts):
    return assembled(
        mesh, effects=effects, degree=2, integration="selective", material=RUBBER, contacts=contacts, **parts
    )


def volume(system, u):
    """Share of its volume at rest, of displacements (N, 3)."""
    points = system.deformation.model.points
    F = np.moveaxis(points.gradients(u), 2, 0) + np.eye(3)
    middle = system.deformation.shear == 0
    weights = np.where(middle, 0.0, points.weights)
    return float(weights @ np.linalg.det(F) / points.weights[middle].sum())


ISOCHORIC = {  # W/μ of the stretches a and twice b of C̄
    "mooney_rivlin": lambda a, b: (a**2 + 2 * b**2 - 3) / 3 + (a**-2 + 2 * b**-2 - 3) / 6,
    "yeoh": lambda a, b: (a**2 + 2 * b**2 - 3) / 2 + (a**2 + 2 * b**2 - 3) ** 2 / 20,
    "ogden": lambda a, b: ((a**3 + 2 * b**3 - 3) / 3 + (a**-2 + 2 * b**-2 - 3) / 10) / 1.7,
}


@pytest.mark.parametrize(
    ("law", "constants"),
    [
        ("yeoh", [1.0, 0.1]),
        pytest.param("mooney_rivlin", [2.0, 1.0], marks=pytest.mark.slow),
        pytest.param("ogden", [1.0, 3.0, -0.2, -2.0], marks=pytest.mark.slow),
    ],
)
def test_a_cube_that_is_pressed_to_half_its_height_is_the_closed_form(tmp_path, law, constants):
    """Between plates without friction: the derivative of W by its height λ, where that by its width w is zero."""
    side, bulk, d = 0.02, SHEAR * (2 * POISSON / (1 - 2 * POISSON) + 2 / 3), 1e-5

    def energy(λ, w):
        J = λ * w**2
        return SHEAR * ISOCHORIC[law](λ / np.cbrt(J), w / np.cbrt(J)) + bulk / 4 * (J**2 - 1 - 2 * np.log(J))

    width = brentq(lambda w: energy(0.5, w + d) - energy(0.5, w - d), 1.2, 1.6, xtol=1e-14)
    force = side**2 * (energy(0.5 + d, width) - energy(0.5 - d, width)) / (2 * d)
    mesh = write_arrays(tmp_path / "cube.msh", *box_arrays((side, side, side), (1, 1, 1)))
    effects = f"large_deformation = {{ material = '{law}', constants = {constants} }}"
    contacts = f'[contacts.top]\nsurface = "top"\nforce = "resultant"\n{SLIDING}'
    system = silicone(mesh, effects, contacts, supports=None)
    body = system.deformation.stepper(1.0)
    body.equilibrium(StepInput(np.array([0.0, 0.0, force])))
    u = system.deformation.model.nodal_field(body.x)
    body.close()
    assert u[:, 2].min() == pytest.approx(-side / 2, rel=1e-6)  # of differences of the energy
    assert u[:, 0].max() == pytest.approx((width - 1) * side, rel=1e-6)
    assert volume(system, u) == pytest.approx(0.5 * width**2, rel=1e-6)
    assert abs(volume(system, u) - 1) < 0.01


@pytest.mark.parametrize(
    ("law", "damping", "warns"),
    [
        ("neo_hookean", "viscoelasticity = { ratios = [0.5], times = [0.1] }", True),
        ("neo_hookean", "damping = { beta = 1e-3 }", False),
        ("st_venant_kirchhoff", "viscoelasticity = { ratios = [0.5], times = [0.1] }", False),
    ],
)
def test_branches_that_resist_more_than_is_asked_for_are_told(tmp_path, law, damping, warns):
    mesh = write_arrays(tmp_path / "bar.msh", *box_arrays((0.1, 0.02, 0.02), (2, 1, 1)))
    effects = f"inertia = {{}}\n{damping}\nlarge_deformation = {{ material = '{law}' }}"
    said = [text for text in silicone(mesh, effects, TIP).warnings if "resist by a tenth more" in text]
    assert bool(said) == warns
    assert not warns or "strained by 0.82 %" in said[0]


def test_bending_does_not_lock(tmp_path):
    """FL³/3EI + FL/κGA of a cantilever, which on the same mesh is too stiff by a tenth by full integration."""
    (length, side), force = (0.1, 0.02), 0.01
    mesh = write_arrays(tmp_path / "bar.msh", *box_arrays((length, side, side), (10, 2, 2)))
    sag = force * length**3 / (YOUNG * side**4 / 4) + force * length / (5 / 6 * SHEAR * side**2)
    found = {}
    for integration in ("full", "selective"):
        parts = {"effects": "inertia = {}", "outputs.tip": 'surface = "right"', "material": RUBBER, "contacts": TIP}
        system = assembled(mesh, degree=2, integration=integration, **parts)
        factor = system.algebra.factor((1.0, system.stiffness))
        found[integration] = (system.outputs["tip"].T @ factor.solve(system.contacts["right"][:, [2]] * force))[2, 0]
        factor.close()
        assert ("selective" in "".join(system.warnings)) == (integration == "full")
    assert found["selective"] == pytest.approx(sag, rel=0.03)
    assert found["full"] < 0.9 * sag


@pytest.mark.slow
def test_a_reduced_body_keeps_its_volume(tmp_path):
    """At the order of a linear one it goes where the whole body goes, and neither changes its volume by 1 %."""
    mesh = write_arrays(tmp_path / "bar.msh", *box_arrays((0.1, 0.02, 0.02), (5, 1, 1)))
    run = 'dt = 0.01\nduration = 0.1\n[[run.load]]\ncontact = "right"\nforce = [0.0, 0.0, 0.2]'
    parts = {"outputs.tip": 'surface = "right"', "reduction": "order = 12", "run": run}
    system = silicone(mesh, 'large_deformation = { material = "yeoh", constants = [1.0, 0.1] }', TIP, **parts)
    rom = fr.reduce(system)
    runs = [fr.simulate(rom), fr.simulate(system)]
    reduced, full = (run.outputs["tip"][-1].ravel() for run in runs)
    assert full[2] > 0.015
    assert np.linalg.norm(reduced - full) < 0.02 * np.linalg.norm(full)
    for run in runs:
        assert abs(volume(system, run.snapshots[-1].reshape(-1, 3)) - 1) < 0.01
    assert rom.deformation.validation_error < 0.02
