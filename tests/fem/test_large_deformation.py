"""Large deformation at full order: what holds to round-off, and what the elastica, dolfinx and the linear model say."""

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
import ufl
from bodies import acted_on, box_arrays, box_surfaces, write_arrays
from dolfinx import fem
from dolfinx.fem.petsc import assemble_vector
from mpi4py import MPI
from scipy.integrate import solve_bvp

import fenics_rom as fr
from fenics_rom.cli.main import main
from fenics_rom.errors import FenicsRomWarning, SolverError, StepError
from fenics_rom.fem.body_matrices import dolfinx_nodes
from fenics_rom.fem.dolfinx_compat import create_cells, vector_space
from fenics_rom.fem.finite_strain.model import ExternalForce
from fenics_rom.fem.finite_strain.newton import NotConvergedError
from fenics_rom.fem.finite_strain.predictor import Predictor
from fenics_rom.fem.finite_strain.residuals import MidpointResidual, QuasiStaticResidual, StepStart
from fenics_rom.fem.mesh import read_mesh
from fenics_rom.fem.nodes import canonical_nodes
from fenics_rom.mechanics.active_environment import ActiveEnvironment
from fenics_rom.mechanics.hyperelastic import strain
from fenics_rom.mechanics.isochoric import LAWS
from fenics_rom.mechanics.step import StepInput

RIGHT = '[contacts.right]\nsurface = "right"'
TIP = {"outputs.tip": 'surface = "right"'}
SOFT = "young = 1e6\npoisson = 0.35\ndensity = 1000.0"
ROUND_OFF = 1e-10  # of scale, as the account must close
BOTH_LAWS = pytest.mark.parametrize("law", LAWS)
ONE_LAW = pytest.mark.parametrize("law", [LAWS[0], pytest.param(LAWS[1], marks=pytest.mark.slow)])


def large(law):
    return f'large_deformation = {{ material = "{law}" }}\n'


@pytest.fixture(scope="module")
def beam(tmp_path_factory):
    """A beam that bends easily."""
    mesh = box_arrays((0.5, 0.05, 0.05), (5, 1, 1), shake=0.2)
    return write_arrays(tmp_path_factory.mktemp("beam") / "beam.msh", *mesh)


@pytest.fixture(scope="module")
def hollow(tmp_path_factory):
    """A cube of 0.3 m with a chamber in its middle."""
    points, cells = box_arrays((0.3, 0.3, 0.3), (3, 3, 3), shake=0.2)
    cells = cells[np.arange(len(cells)) % 27 != 13]
    faces = np.sort(cells[:, [(1, 2, 3), (0, 2, 3), (0, 1, 3), (0, 1, 2)]].reshape(-1, 3), axis=1)
    unique, count = np.unique(faces, axis=0, return_counts=True)
    skin, outer = unique[count == 1], box_surfaces(points, cells)
    known = np.unique(np.sort(np.concatenate(list(outer.values())), axis=1), axis=0)
    inner = skin[~(skin[:, None] == known).all(axis=2).any(axis=1)]
    return write_arrays(tmp_path_factory.mktemp("hollow") / "hollow.msh", points, cells, outer | {"chamber": inner})


def assembled(mesh, effects, **parts):
    return fr.assemble(acted_on(mesh, effects, **({"contacts": RIGHT, "material": SOFT} | TIP | parts)))


def unbalanced(body, begun=0.0):
    """What the account does not explain of the stored energy, J."""
    return abs(body.energy - begun - body.ledger.supplied + body.ledger.dissipated)


def motion_of(system, start, load, h):
    """The equation of a step of motion."""
    return MidpointResidual(system.deformation.model, start, load, h, system.deformation.stepper(h)._matrix)


def start_at(system, x, v=None):
    """The start of a step at local rows x."""
    return StepStart.at(system.deformation.model, x, np.zeros_like(x) if v is None else v)


def state(system, size, seed=0):
    return size * np.random.default_rng(seed).standard_normal((system.size, 1))


# --- forces ----------------------------------------------------------------------------------------------------------


RUBBER = {  # in principal stretches, as UFL writes them without eigenvalues
    "mooney_rivlin": lambda C: 2 / 3 * (ufl.tr(C) - 3) + 1 / 3 * (ufl.tr(ufl.inv(C)) - 3),
    "yeoh": lambda C: (ufl.tr(C) - 3) + 0.3 * (ufl.tr(C) - 3) ** 2 - 0.01 * (ufl.tr(C) - 3) ** 3,
    "ogden": lambda C: (ufl.tr(C * C) - 3) / 4 + 0.1 * (ufl.tr(ufl.inv(C)) - 3),
    "gent": lambda C: -15 * ufl.ln(1 - (ufl.tr(C) - 3) / 30),
}


@pytest.mark.parametrize(
    ("law", "degree", "integration"),
    [
        ("st_venant_kirchhoff", 1, "full"),
        ("neo_hookean", 2, "full"),
        ("neo_hookean", 2, "selective"),
        ("mooney_rivlin 2 1", 2, "full"),
        ("yeoh 1 0.3 -0.01", 2, "selective"),
        ("ogden 1 4 -0.2 -2", 2, "full"),
        ("gent 30", 1, "full"),
    ],
)
def test_elastic_force_is_what_dolfinx_makes_of_the_energy(beam, law, degree, integration):
    material, *constants = law.split()
    effects = f"large_deformation = {{ material = '{material}', constants = [{', '.join(constants)}] }}\n"
    system = assembled(beam, effects, degree=degree, integration=integration)
    x = state(system, 2e-3)
    model = system.deformation.model
    mesh = read_mesh(system.scene.mesh_file, {})
    nodes = canonical_nodes(mesh, degree)
    space = vector_space(create_cells(MPI.COMM_WORLD, mesh.cells, mesh.points), degree)
    u, place = fem.Function(space), dolfinx_nodes(space, nodes)
    u.x.array.reshape(-1, 3)[place] = model.nodal_field(x)
    λ, μ = model.material.first_lame.max(), model.material.shear.max()
    F = ufl.Identity(3) + ufl.grad(u)
    C = F.T * F
    E, lnJ = (C - ufl.Identity(3)) / 2, ufl.ln(ufl.det(C)) / 2
    W = λ / 2 * ufl.tr(E) ** 2 + μ * ufl.inner(E, E)
    if law == "neo_hookean":
        W = μ * (ufl.tr(E) - lnJ) + λ / 2 * lnJ**2
    dx, middle = (ufl.dx(metadata={"quadrature_degree": exact}) for exact in (2 * (degree - 1), 1))
    potential = W * dx
    if material in RUBBER:
        isochoric, κ = RUBBER[material](C * ufl.exp(-2 / 3 * lnJ)), λ + 2 / 3 * μ
        scale = {"mooney_rivlin": 2, "yeoh": 2, "ogden": 2.2, "gent": 1}[
            material
        ]  # the shear modulus of these constants
        U = (ufl.det(C) - 1 - 2 * lnJ) / 4
        potential = (μ / scale * isochoric + κ * U) * dx
        if integration == "selective":
            potential = (μ / scale * isochoric + 2 / 3 * μ * U) * dx + λ * U * middle
    elif integration == "selective":
        potential = μ * (ufl.tr(E) - lnJ) * dx + λ / 2 * lnJ**2 * middle
    force = assemble_vector(fem.form(ufl.derivative(potential, u, ufl.TestFunction(space))))
    expected = force.array.reshape(-1, 3)[place].ravel()[model.components]
    found = (
        QuasiStaticResidual(model, start_at(system, x), ExternalForce(0 * x, ()), 1.0, 0 * x)
        .evaluate(0 * x)
        .internal_force[:, 0]
    )
    np.testing.assert_allclose(found, expected, atol=1e-11 * np.abs(expected).max())
    energy = fem.assemble_scalar(fem.form(potential))
    assert model.elastic_energy(strain(model.points.gradients(model.nodal_field(x)))) == pytest.approx(
        energy, rel=1e-10
    )


@BOTH_LAWS
@pytest.mark.parametrize(("degree", "integration"), [(1, "full"), (2, "full"), (2, "selective")])
def test_at_rest_the_tangent_is_the_linear_stiffness(beam, law, degree, integration):
    springs = '[effects.springs.ground]\nsurface = "right"\nstiffness = 50.0'
    system = assembled(beam, f"inertia = {{}}\n{large(law)}{springs}", degree=degree, integration=integration)
    model, zero, dx = system.deformation.model, np.zeros((system.size, 1)), state(system, 1.0)
    equation = QuasiStaticResidual(model, start_at(system, zero), ExternalForce(zero, ()), 1.0, zero)
    expected = system.stiffness @ dx
    np.testing.assert_allclose(
        equation.apply_tangent(equation.evaluate(zero), dx), expected, atol=1e-12 * np.abs(expected).max()
    )


@BOTH_LAWS
@pytest.mark.parametrize("kind", ["midpoint", "equilibrium"])
@pytest.mark.parametrize("degree", [1, 2])
def test_tangent_is_the_change_of_the_residual(hollow, law, kind, degree):
    """Of all that there is: springs, dashpots, viscosity, pressure and a tendon."""
    effects = (
        f"inertia = {{}}\n{large(law)}"
        'damping = { alpha = 2.0, beta = 1e-2, dashpots = { d = { surface = "top", coefficient = 3.0 } } }\n'
        '[effects.springs.ground]\nsurface = "right"\nstiffness = 50.0\n[effects.pressure.air]\nsurface = "chamber"\n'
        "[effects.tendon.cable]\npoints = [[0.01, 0.05, 0.05], [0.15, 0.04, 0.05], [0.29, 0.05, 0.06]]"
    )
    system = assembled(hollow, effects, degree=degree)
    model = system.deformation.model
    x, v, dv = state(system, 4e-3, 1), state(system, 0.1, 2), state(system, 1.0, 3)
    load = ExternalForce(state(system, 1.0, 4), ((2e4, model.followers["air"]), (50.0, model.followers["cable"])))
    start, h = start_at(system, x, v), 0.02
    equation = (
        motion_of(system, start, load, h) if kind == "midpoint" else QuasiStaticResidual(model, start, load, h, 0 * x)
    )
    at = state(system, 0.3, 5)
    ahead, behind = equation.evaluate(at + 1e-6 * dv).residual, equation.evaluate(at - 1e-6 * dv).residual
    found = equation.apply_tangent(equation.evaluate(at), dv)
    np.testing.assert_allclose(found, (behind - ahead) / 2e-6, atol=1e-6 * np.abs(found).max())


@pytest.mark.parametrize("degree", [1, 2])
def test_pressure_is_the_slope_of_the_volume_and_a_tendon_that_of_its_length(hollow, degree):
    effects = (
        f'inertia = {{}}\n{large("neo_hookean")}[effects.pressure.air]\nsurface = "chamber"\n'
        "[effects.tendon.cable]\npoints = [[0.01, 0.05, 0.05], [0.15, 0.04, 0.05], [0.29, 0.05, 0.06]]"
    )
    system = assembled(hollow, effects, degree=degree)
    body, x, dx = system.deformation, state(system, 0.01, 1)[:, 0], state(system, 1.0, 2)[:, 0]
    for name, columns in body.follower(0 * x).items():  # at rest they are what they are in the linear model
        expected = system.units[name] * system.actuators[name]
        np.testing.assert_allclose(columns, expected, atol=1e-12 * np.abs(expected).max())
    points, shapes = body.tendons["cable"]

    def length(x):
        return np.linalg.norm(np.diff(points + (shapes.T @ x).reshape(-1, 3), axis=0), axis=1).sum()

    assert body.follower(x)["cable"][:, 0] @ dx == pytest.approx(
        -(length(x + 1e-6 * dx) - length(x - 1e-6 * dx)) / 2e-6, rel=1e-7
    )
    air = body.model.followers["air"]
    volume = volume_of(system, air)
    change = (volume(x + 1e-6 * dx) - volume(x - 1e-6 * dx)) / 2e-6
    assert body.follower(x)["air"][:, 0] @ dx == pytest.approx(change, rel=1e-6)
    closed = air.force(body.model.nodal_field(x[:, None]))
    np.testing.assert_allclose(closed.sum(axis=0), 0, atol=1e-14)  # a closed surface pushes nothing as a whole
    assert volume(0 * x) == pytest.approx(0.1**3, rel=0.5)


def volume_of(system, air):
    """Volume of the chamber at local rows x, m³: ∫ y·(y_ξ × y_η) over the moved surface is -3 times it."""
    model = system.deformation.model

    def volume(x):
        y = system.body.nodes + model.nodal_field(x[:, None])
        return -(air.force(y - system.body.nodes) * -y).sum() / 3

    return volume


# --- steps -----------------------------------------------------------------------------------------------------------

UNDAMPED = ""
DAMPED = 'damping = { alpha = 1.0, beta = 5e-3, dashpots = { d = { surface = "top", coefficient = 2.0 } } }\n'
SPRUNG = '[effects.springs.s]\nsurface = "right"\nstiffness = 10.0\n'


@ONE_LAW
@pytest.mark.parametrize("others", [UNDAMPED, DAMPED + SPRUNG], ids=["undamped", "damped"])
@pytest.mark.parametrize("h", [pytest.param(5e-3, marks=pytest.mark.slow), 0.03])
def test_energy_balance(beam, law, others, h):
    system = assembled(beam, f"inertia = {{}}\n{large(law)}{others}", degree=2)
    body, most, furthest = system.deformation.stepper(h), 0.0, 0.0
    for step in range(25):
        body.step(StepInput(np.array([3.0, 0.0, 12.0]) * (step < 15)))
        most, furthest = max(most, body.energy), max(furthest, np.abs(body.displacement("tip")).max())
        assert unbalanced(body) <= ROUND_OFF * most
    assert furthest > 0.15
    assert body.ledger.dissipated > 0.1 * body.ledger.supplied if others else body.ledger.dissipated == 0
    assert body.parted == 0
    body.close()


@BOTH_LAWS
def test_energy_balance_with_pressure_tendon_and_gravity(hollow, law):
    effects = (
        f"inertia = {{}}\n{large(law)}gravity = {{ acceleration = [0, 0, -9.81] }}\ndamping = {{ beta = 2e-3 }}\n"
        '[effects.pressure.air]\nsurface = "chamber"\n[effects.base_motion.shake]\ndirection = [0, 1, 0]\n'
        "acceleration = 3.0\n"
        "[effects.tendon.cable]\npoints = [[0.01, 0.05, 0.05], [0.15, 0.04, 0.05], [0.29, 0.05, 0.06]]"
    )
    system = assembled(hollow, effects)
    body, most = system.deformation.stepper(5e-3), 0.0
    for step in range(15):
        body.step(StepInput(np.array([0, 0, 0, 3e5 if step % 2 else 2e5, 1e3, 1.0, 3.0])))
        most = max(most, body.energy)
        assert unbalanced(body) <= ROUND_OFF * most
    assert most > 0.1
    body.close()


def test_pressure_does_the_work_of_its_volume_to_second_order(hollow):
    """p ΔV of a closed chamber: the force at the midpoint integrates it along the step to h² of the step."""
    system = assembled(hollow, f'inertia = {{}}\n{large("neo_hookean")}[effects.pressure.air]\nsurface = "chamber"')
    volume, lack = volume_of(system, system.deformation.model.followers["air"]), []
    for steps in (10, 20):
        body = system.deformation.stepper(0.015 / steps)
        for _ in range(steps):
            body.step(StepInput(np.array([0, 0, 0, 3e5])))
        gained = volume(body.x[:, 0]) - volume(0 * body.x[:, 0])
        lack.append(body.ledger.supplied / (3e5 * gained) - 1)
        body.close()
    assert gained > 0.05 * volume(0 * body.x[:, 0])
    assert abs(lack[1]) < 1e-3
    assert lack[0] / lack[1] == pytest.approx(4, rel=0.3)


@pytest.mark.parametrize("law", LAWS)
def test_small_loads_differ_from_linear_ones_in_second_order(beam, law):
    others, run = "inertia = {}\ndamping = { alpha = 1.0, beta = 5e-3 }\n", {"run": "dt = 5e-3\nduration = 0.1"}
    off = []
    for force in (0.2, 0.1):
        pushed = f'[effects.prescribed.push]\nsurface = "right"\nforce = [{force}, 0.0, {force}]'
        tips = [
            fr.simulate(assembled(beam, f"{others}{effect}{pushed}", **run)).outputs["tip"]
            for effect in ("", large(law))
        ]
        off.append(np.abs(tips[1] - tips[0]).max() / force**2)
    assert off[0] * 0.1**2 < 0.02 * np.abs(tips[0]).max()
    assert off[0] == pytest.approx(off[1], rel=0.05)


@pytest.mark.slow
def test_order_two_in_time(beam):
    system = assembled(beam, f"inertia = {{}}\n{large('neo_hookean')}damping = {{ alpha = 1.0, beta = 5e-3 }}")

    def end(steps):
        body = system.deformation.stepper(0.16 / steps)
        for step in range(steps):
            t = (step + 0.5) / steps
            body.step(StepInput(np.array([0.0, 3.0, 10.0]) * np.sin(np.pi * t) ** 2))
        x = body.x.copy()
        body.close()
        return x

    fine = end(320)
    errors = [np.linalg.norm(end(steps) - fine) for steps in (20, 40, 80)]
    for coarse, finer in pairwise(errors):
        assert coarse / finer == pytest.approx(4, rel=0.15)


def test_smooth_motion_is_foreseen(beam, monkeypatch):
    """A cubic through the last velocities, and a factor of a shape ahead, save work; the motion is the same."""
    evaluate, forces = MidpointResidual.evaluate, []
    monkeypatch.setattr(MidpointResidual, "evaluate", lambda *given: forces.append(1) or evaluate(*given))
    body = assembled(beam, f"inertia = {{}}\n{large(LAWS[0])}").deformation.stepper(2e-3)

    def run():
        body.set_state(0 * body.x, 0 * body.x)
        forces.clear()
        for step in range(40):
            body.step(StepInput(np.array([0.0, 0.0, 10 * np.sin(0.05 * step) ** 2])))
        return len(forces), body.x

    work, x = run()
    monkeypatch.setattr(Predictor, "is_smooth", property(lambda self: False, lambda self, smooth: None), raising=False)
    more, same = run()
    assert work < 0.9 * more
    assert np.abs(x - same).max() <= 1e-9 * np.abs(x).max()


# --- rotations, inversion ---------------------------------------------------------------------------------------------


@BOTH_LAWS
def test_rotation_by_a_right_angle_stores_nothing(beam, law):
    system = assembled(beam, f"inertia = {{}}\n{large(law)}", supports=None)
    R = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    x = (system.body.nodes @ R.T - system.body.nodes).ravel()
    body = system.deformation.stepper(1e-2)
    body.set_state(x, 0 * x)
    volume, μ = 0.5 * 0.05**2, system.deformation.shear[0]
    assert abs(body.energy) <= 1e-12 * μ * volume
    assert (
        float(x @ (system.stiffness @ x[:, None])[:, 0]) > 0.1 * μ * volume
    )  # which the linear model takes for strain
    body.close()


def turned(system, angle):
    """Displacement (rows here, 1) of a rotation about the z axis."""
    c, s = np.cos(angle), np.sin(angle)
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    return (system.body.nodes @ R.T - system.body.nodes).reshape(-1, 1)


def test_viscosity_does_not_feel_a_rotation(beam):
    """β K v̂ of the resting shape would brake it."""
    system = assembled(
        beam, f"inertia = {{}}\n{large('neo_hookean')}damping = {{ beta = 1e-2 }}", degree=2, supports=None
    )
    h, x = 1e-2, turned(system, np.pi / 2)
    v = (turned(system, np.pi / 2 + 0.1) - x) / h
    trial = motion_of(system, start_at(system, x, v), ExternalForce(0 * x, ()), h).evaluate(v)
    assert np.abs(trial.internal_force).max() <= 1e-10 * np.abs(system.damping @ v).max()


def test_momentum_and_angular_momentum_of_a_free_body(beam):
    """They stay, whatever vibrates and is damped."""
    system = assembled(beam, f"inertia = {{}}\n{large('neo_hookean')}damping = {{ beta = 2e-3 }}", supports=None)
    body, random = system.deformation.stepper(0.02), np.random.default_rng(0)
    y = system.body.nodes - system.body.nodes.mean(axis=0)
    v = np.cross([1.0, 2.0, 3.0], y) + [0.1, 0.2, 0.3] + 0.3 * random.standard_normal(y.shape)
    body.set_state(np.zeros(v.size), v.ravel())

    def momenta():
        Mv = (system.mass @ body.v).reshape(-1, 3)
        return np.concatenate([Mv.sum(axis=0), np.cross(body.displacement() + y, Mv).sum(axis=0)])

    begun, energy = momenta(), body.energy
    for _ in range(15):
        body.step(StepInput(np.zeros(3)))
    np.testing.assert_allclose(momenta(), begun, atol=ROUND_OFF * np.abs(begun).max())
    assert body.ledger.dissipated > 0.05 * energy
    assert unbalanced(body, energy) <= ROUND_OFF * energy
    body.close()


def test_a_thrown_beam_flies_on_a_parabola(beam):
    """Its centre of mass, exactly, however it turns and bends; and simulate takes a body that nothing holds."""
    v, spin, g, h, steps = np.array([0.5, 0.0, 2.0]), np.array([0.0, 40.0, 15.0]), np.array([0.0, 0.0, -9.81]), 5e-3, 20
    thrown = f"dt = {h}\nduration = {h * steps}\ninitial = {{ velocity = {v.tolist()}, spin = {spin.tolist()} }}"
    effects = f"inertia = {{}}\n{large('neo_hookean')}gravity = {{ acceleration = {g.tolist()} }}"
    system = assembled(beam, effects, supports=None, run=thrown)
    run, mass = fr.simulate(system), system.body.node_mass
    times, centre = run.snapshot_times[:, None], run.snapshots.transpose(0, 2, 1) @ mass / mass.sum()
    np.testing.assert_allclose(centre, times * v + times**2 / 2 * g, atol=1e-12)
    assert np.abs(run.snapshots[-1]).max() > 0.3


@BOTH_LAWS
def test_inverted_elements_give_numbers(beam, law):
    """A body that begins inside out (mirrored) has an energy and can be stepped, or is refused; there is no NaN."""
    system = assembled(beam, f"inertia = {{}}\n{large(law)}damping = {{ beta = 1e-2 }}")
    x = np.zeros((len(system.body.nodes), 3))
    x[:, 1] = -2.2 * system.body.nodes[:, 1] * np.minimum(1, system.body.nodes[:, 0] / 0.05)
    x = x.ravel()[system.body.free]
    body = system.deformation.stepper(1e-3)
    body.set_state(x, 0 * x)
    begun = body.energy
    assert np.isfinite(begun)
    assert body.inverted > 0
    for _ in range(5):
        body.step(StepInput(np.array([0.0, 0.0, 5.0])))
    assert np.isfinite(body.x).all()
    assert unbalanced(body, begun) <= ROUND_OFF * begun
    body.close()


# --- equilibrium ------------------------------------------------------------------------------------------------------


def elastica(load):
    """Tip (x, z) of a cantilever of length 1 under load P L²/EI at its end: θ'' = -load cos θ."""
    solution = solve_bvp(
        lambda _, y: np.stack([y[1], -load * np.cos(y[0]), np.cos(y[0]), np.sin(y[0])]),
        lambda a, b: np.array([a[0], b[1], a[2], a[3]]),
        np.linspace(0, 1, 20),
        np.zeros((4, 20)),
        tol=1e-8,
    )
    return solution.y[2:, -1]


@ONE_LAW
def test_slender_cantilever_is_an_elastica(tmp_path, law):
    thick, young, load = 0.05, 1e6, 3.0
    mesh = write_arrays(tmp_path / "slender.msh", *box_arrays((1.0, thick, thick), (12, 1, 1)))
    material = f"young = {young}\npoisson = 0.0\ndensity = 1000.0"
    body = assembled(mesh, large(law), degree=2, material=material).deformation.stepper(1.0)
    body.equilibrium(StepInput(np.array([0.0, 0.0, load * young * thick**4 / 12])))
    x, z = elastica(load)
    assert z > 0.6
    tip = body.displacement("tip")[0]
    assert tip[2] == pytest.approx(z, rel=0.01)
    assert 1 + tip[0] == pytest.approx(x, rel=0.01)
    body.close()


def test_equilibrium_is_where_damped_motion_ends(hollow):
    effects = (
        f"inertia = {{}}\n{large('neo_hookean')}damping = {{ alpha = 30.0, beta = 1e-2 }}\n"
        '[effects.pressure.air]\nsurface = "chamber"'
    )
    system, u = assembled(hollow, effects), np.array([200.0, 0.0, 900.0, 2e5])
    moving, resting = (system.deformation.stepper(0.05) for _ in range(2))
    for step in range(80):
        moving.step(StepInput(np.sin(np.pi / 2 * min(1, (step + 1) / 60)) ** 2 * u))
    resting.equilibrium(StepInput(u))
    assert np.abs(resting.x).max() > 0.015
    np.testing.assert_allclose(moving.x, resting.x, atol=1e-6 * np.abs(resting.x).max())
    assert not resting.v.any()
    moving.close()
    resting.close()


def test_quasi_static_run(beam):
    """Nothing is dissipated, and what a step misses of the path's work is of second order; the account closes."""
    run = {"run": 'dt = 0.1\nduration = 0.4\n[[run.load]]\ncontact = "right"\nforce = [0.0, 0.0, 2.0]'}
    system = assembled(beam, large("st_venant_kirchhoff"), degree=2, **run)
    record = fr.simulate(system)
    assert record.balance_error <= ROUND_OFF
    assert not record.dissipated.any()
    assert record.outputs["tip"][-1, 0, 2] > 0.03
    assert not any("linear model" in text for text in record.warnings)
    body = system.deformation.stepper(1.0)
    body.equilibrium(StepInput(np.array([0.0, 0.0, 2.0])))
    np.testing.assert_allclose(record.outputs["tip"][-1], body.displacement("tip"), rtol=1e-8)
    body.close()
    missed = []
    for steps in (5, 10):
        body = system.deformation.stepper(1.0)
        for step in range(1, steps + 1):
            body.equilibrium(StepInput(np.array([0.0, 0.0, 2.0 * step / steps])))
        missed.append(abs(body.ledger.numerical))
        assert missed[-1] <= 1e-2 * body.energy
        body.close()
    assert 1.9 <= np.log2(missed[0] / missed[1]) <= 2.1


# --- contact ----------------------------------------------------------------------------------------------------------

FLOOR = (
    '[effects.contact]\nswitching = "scene"\n[effects.contact.obstacles.floor]\nshape = "half-space"\n'
    "point = [0.0, 0.0, -0.03]\nnormal = [0.0, 0.0, 1.0]\n"
)


def dropped(mesh, law, others=""):
    """A beam that is pulled onto a floor, and the simulator of it."""
    effects = f"inertia = {{}}\n{large(law)}damping = {{ beta = 2e-3 }}\n{others}{FLOOR}"
    system = assembled(mesh, effects, contacts='[contacts.right]\nsurface = "bottom"', degree=2)
    around = ActiveEnvironment(system.scene.environment)
    return SimpleNamespace(system=system, around=around, body=system.deformation.stepper(2e-3, around))


@ONE_LAW
def test_contact_obeys_its_law_where_newton_has_converged(beam, law):
    """What pushes ends on the floor in two steps: n·v̂ = min(a/2, (a/2 - g/h)/2, 0); friction is at most μ λ."""
    it = dropped(beam, law, "friction = { coefficient = 0.4 }\n")
    body, most, touched, nodes = it.body, 0.0, 0, it.system.contact_points["right"]
    for _ in range(60):
        before, approach = body.displacement(), body.velocity()[nodes, 2]
        body.step(it.around.step_input(np.array([0.0, 0.0, -20.0]), body.time, body.dt))
        most = max(most, body.energy)
        assert unbalanced(body) <= ROUND_OFF * most
        assert (body.displacement() + it.system.body.nodes)[:, 2].min() >= -0.03 - 1e-9
        if body.contact is None:
            continue
        touched += 1
        λ, across = body.contact.forces[:, 2], np.linalg.norm(body.contact.forces[:, :2], axis=1)
        speed = (body.displacement() - before)[nodes, 2] / body.dt
        pushing = λ > 1e-6 * λ.max()
        gaps = (before + it.system.body.nodes)[nodes, 2] + 0.03
        asked = np.minimum(np.minimum(approach / 2, (approach / 2 - gaps / body.dt) / 2), 0)
        np.testing.assert_allclose(speed[pushing], asked[pushing], atol=1e-7)
        assert (λ >= 0).all()
        assert (across <= 0.4 * λ + 1e-9 * λ.max()).all()
    assert touched > 20
    assert body.ledger.friction > 0
    assert body.ledger.contact >= 0
    body.close()


@BOTH_LAWS
def test_obstacle_may_come_to_a_body_at_rest(beam, law):
    """The contact force is the only one then, and what the residual is small against."""
    it, speed = dropped(beam, law), 1.0
    it.around.set_signal("floor", lambda time: [0.0, 0.0, speed * time])
    body, most, touched = it.body, 0.0, 0
    for _ in range(25):
        inputs = it.around.step_input(np.zeros(3), body.time, body.dt)
        body.step(inputs)
        it.around.commit(inputs, body.dt)
        most, touched = max(most, body.energy), touched + (body.contact is not None)
        assert unbalanced(body) <= ROUND_OFF * most
    assert touched > 5
    assert body.velocity()[:, 2].max() > speed / 2
    body.close()


def test_obstacles_out_of_reach_change_no_bit(beam):
    it = dropped(beam, "st_venant_kirchhoff")
    alone = it.system.deformation.stepper(2e-3)
    for _ in range(5):
        it.body.step(it.around.step_input(np.array([0.0, 0.0, 0.5]), it.body.time, it.body.dt))
        alone.step(StepInput(np.array([0.0, 0.0, 0.5])))
    assert it.body.contact is None
    np.testing.assert_array_equal(it.body.x, alone.x)
    it.body.close()
    alone.close()


# --- what cannot be done ----------------------------------------------------------------------------------------------


def test_steps_that_newton_does_not_solve_are_halved_and_told(beam):
    system = assembled(beam, f"inertia = {{}}\n{large('neo_hookean')}")
    body, most = system.deformation.stepper(0.1), 0.0
    for _ in range(2):
        body.step(StepInput(np.array([0.0, 0.0, 150.0])))
        most = max(most, body.energy)
        assert unbalanced(body) <= ROUND_OFF * most
    assert body.parted > 0
    assert body.finest < 1
    assert any("in parts" in text and f"1/{round(1 / body.finest)} of a step" in text for text in body.diagnostics())
    body.close()


@pytest.mark.parametrize("relaxing", ["", "[effects.viscoelasticity]\nratios = [0.8, 0.4]\ntimes = [5e-3, 0.1]\n"])
def test_parts_of_a_step_are_steps(beam, relaxing):
    """A step of 8 ms of which Newton's method solves no more than a quarter at once is four of 2 ms, or none at all."""
    system, u = assembled(beam, f"inertia = {{}}\n{large('neo_hookean')}{relaxing}"), np.array([0.0, 0.0, 50.0])
    fine, body = (system.deformation.stepper(h, ActiveEnvironment(system.scene.environment)) for h in (2e-3, 8e-3))
    part, reached = body._part, 1.0

    def at_most_a_quarter(done, share, *others):
        if share > 0.25 or done >= reached:
            raise NotConvergedError
        part(done, share, *others)

    body._part = at_most_a_quarter
    for _ in range(2):
        body.step(StepInput(u))
        for _ in range(4):
            fine.step(StepInput(u))
    np.testing.assert_allclose(body.x, fine.x, atol=1e-9 * np.abs(fine.x).max())
    assert body.ledger.supplied == pytest.approx(fine.ledger.supplied, rel=1e-9)
    assert body.energy == pytest.approx(fine.energy, rel=1e-9)
    assert bool(body.ledger.dissipated) == bool(relaxing)
    assert (body.parted, body.finest) == (2, 0.25)
    kept, energy, supplied, reached = body.x.copy(), body.energy, body.ledger.supplied, 0.5
    with pytest.raises(SolverError):
        body.step(StepInput(u))
    np.testing.assert_array_equal(body.x, kept)
    assert (body.energy, body.ledger.supplied, body.time) == (energy, supplied, 16e-3)
    reached = 1.0
    body.step(StepInput(u))
    body.rollback()
    assert body.energy == energy
    fine.close()
    body.close()


def test_load_beyond_reach_is_told_with_its_time(beam, tmp_path, capsys):
    push = '[[run.load]]\ncontact = "right"\nstart = 0.1\nforce = [-1e15, 0.0, 0.0]'
    run = {"run": f"dt = 0.1\nduration = 0.3\n{push}"}
    system = assembled(beam, f"inertia = {{}}\n{large('neo_hookean')}", **run)
    with pytest.raises(
        SolverError, match=r"did not converge at t = 0.1 s in contact mode 'right' under.*-1e\+15.*lower"
    ):
        fr.simulate(system)
    body = system.deformation.stepper(0.1)
    body.step(StepInput(np.array([0.0, 0.0, 0.1])))
    kept, supplied = body.x.copy(), body.ledger.supplied
    with pytest.raises(SolverError):
        body.step(StepInput(np.array([-1e15, 0.0, 0.0])))
    np.testing.assert_array_equal(body.x, kept)
    assert (body.ledger.supplied, body.time) == (supplied, 0.1)
    with pytest.raises(StepError, match="3 finite numbers"):
        body.step(StepInput(np.array([np.nan, 0.0, 0.0])))
    body.step(StepInput(np.array([0.0, 0.0, 0.1])))  # and it goes on
    body.close()
    scene = tmp_path / "scene.toml"
    scene.write_text(system.scene.text)
    with pytest.raises(SystemExit, match="1"):
        main(["simulate", str(scene), "-o", str(tmp_path / "run.h5")])
    assert capsys.readouterr().err.count("did not converge") == 1


def test_what_is_turned_inside_out_is_told(beam):
    run = {"run": 'dt = 2e-3\nduration = 0.06\n[[run.load]]\ncontact = "right"\nforce = [-300.0, 0.0, 20.0]'}
    system = assembled(beam, f"inertia = {{}}\n{large('st_venant_kirchhoff')}", **run)
    with pytest.warns(FenicsRomWarning, match="turned inside out"):
        record = fr.simulate(system)
    assert any("inside out" in text for text in record.warnings)
    assert record.balance_error <= ROUND_OFF


def test_materials_may_be_damped_differently(tmp_path):
    """Next to rest it is the linear model with its matrices, material by material."""
    points, cells = box_arrays((0.4, 0.1, 0.1), (4, 1, 1))
    half = points[cells].mean(axis=1)[:, 0] < 0.2
    regions = {"near": np.flatnonzero(half), "far": np.flatnonzero(~half)}
    mesh = write_arrays(tmp_path / "two.msh", points, cells, regions=regions)
    parts = {
        "material": None,
        "materials.near": f'cells = "near"\n{SOFT}',
        "materials.far": 'cells = "far"\nyoung = 4e5\npoisson = 0.2\ndensity = 500.0',
        "run": 'dt = 2e-3\nduration = 0.1\n[[run.load]]\ncontact = "right"\nforce = [0.0, 0.0, 1e-5]',
    }
    damping = (
        "inertia = {}\ndamping = { alpha = 2.0, beta = 1e-3, materials = { far = { alpha = 5.0, beta = 2e-2 } } }\n"
        '[effects.springs.s]\nsurface = "top"\nstiffness = 20.0\n'
    )
    linear, nonlinear = (
        fr.simulate(assembled(mesh, damping.replace("damping", f"{effect}damping", 1), **parts))
        for effect in ("", large("neo_hookean"))
    )
    tip = linear.outputs["tip"]
    np.testing.assert_allclose(nonlinear.outputs["tip"], tip, atol=1e-5 * np.abs(tip).max())
    assert nonlinear.dissipated[-1] == pytest.approx(linear.dissipated[-1], rel=1e-4)


def test_gradients_are_those_of_columns(beam):
    system = assembled(beam, large("st_venant_kirchhoff"), degree=2, supports=None)
    A = np.random.default_rng(0).standard_normal((3, 3, 2))
    fields = np.einsum("ijk,nj->nik", A, system.body.nodes).reshape(-1, 2)
    H = system.deformation.gradients(fields)
    assert H.shape == (3, 3, len(system.deformation.weights), 2)
    np.testing.assert_allclose(H, np.broadcast_to(A[:, :, None], H.shape), atol=1e-12)
    assert system.deformation.weights.sum() == pytest.approx(0.5 * 0.05**2)
