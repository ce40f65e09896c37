"""Gradients through contact and friction: against central differences and by their Taylor remainder; kinks are told."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from bodies import acted_on, box_arrays, write_arrays
from triangle_meshes import groove
from turning import spin

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning
from fenics_rom.mechanics import braking
from fenics_rom.mechanics.contact import ContactLaw
from fenics_rom.mechanics.environment import STANDS_STILL, MovingObstacle, RigidMotion
from fenics_rom.mechanics.obstacles import Box, Capsule, HalfSpace, Mesh, Sphere
from fenics_rom.runtime.differentiation import taken_steps

H, STEPS = 2e-3, 40
AGREES = 1e-6  # with central differences of 1e-4, relative
PUSH = {"push": (20.0, -6.0, -60.0)}  # N
EFFECTS = """
inertia = {}
damping = { alpha = 0.5, beta = 1e-3 }
[effects.prescribed.push]
surface = "top"
[effects.friction]
coefficient = 0.3
[effects.contact.obstacles.floor]
shape = "half-space"
point = [0, 0, -2e-3]
normal = [0, 0, 1]
[effects.contact.obstacles.ball]
shape = "sphere"
center = [0.41, 0.1, -0.047]
radius = 0.045
[effects.contact.obstacles.rod]
shape = "capsule"
start = [0.3, -0.1, -0.032]
end = [0.3, 0.3, -0.032]
radius = 0.03
[effects.contact.obstacles.block]
shape = "box"
center = [0.42, 0.22, -0.057]
size = [0.1, 0.1, 0.1]
rotation = [0.2, 0.3, 0.0]
"""
PARTS = {
    "outputs.tip": "points = [[0.4, 0.2, 0.1]]",
    "contacts": '[contacts.bottom]\nsurface = "bottom"\n[contacts.right]\nsurface = "right"',
}
FLOOR, ROUND = ("floor",), ("ball", "rod", "block")
MOVES = {"floor": lambda t: (0.01 * np.sin(40 * t), 0.0, 2e-3 * np.sin(60 * t))}
MODES = ["bottom", "right"]
CASES = {  # law, obstacles, residual compliance, signals besides, contact modes
    "floor, friction": (ContactLaw(friction=0.3), FLOOR, True, {}, None),
    "shapes, friction": (ContactLaw(friction=0.3), ROUND, True, {}, None),
    "shapes, friction, stiff points": (ContactLaw(friction=0.3), ROUND, False, {}, None),
    "shapes, smooth": (ContactLaw(), ROUND, True, {}, None),
    "floor, restitution": (ContactLaw(restitution=0.5, friction=0.3), FLOOR, True, {}, None),
    "springs": (ContactLaw(friction=0.3, stiffness=2e4, damping=3.0), ROUND, True, {}, None),
    "floor that moves": (ContactLaw(friction=0.3), FLOOR, True, MOVES, None),
    "switched": (ContactLaw(friction=0.3), ROUND, True, {}, [MODES[step // 9 % 2] for step in range(STEPS)]),
}
QUICK = ["floor, friction", "shapes, friction", "switched"]

pytestmark = pytest.mark.filterwarnings("ignore:the surface is", "ignore:switching", "ignore:.*contact points leave")


def reduced(folder, effects, **parts):
    mesh = write_arrays(folder / "box.msh", *box_arrays((0.4, 0.2, 0.1), (4, 2, 2), 0.2))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FenicsRomWarning)
        return fr.reduce(fr.assemble(acted_on(mesh, effects, **PARTS | parts)), order=8)


@pytest.fixture(scope="module")
def rom(tmp_path_factory):
    return reduced(tmp_path_factory.mktemp("touched"), EFFECTS)


@pytest.fixture(scope="module")
def damped(tmp_path_factory):
    """Points that stick swing: damping stops them within a step."""
    return reduced(tmp_path_factory.mktemp("damped"), EFFECTS.replace("beta = 1e-3", "beta = 2e-2"))


class Case:
    """A body that is pushed against obstacles."""

    def __init__(self, rom, law, obstacles, residual, signals, modes):
        known, self.modes, self.rom = rom.environment, modes, rom
        self.environment = replace(
            known,
            contact_law=law,
            obstacles={name: known.obstacles[name] for name in obstacles},
            residual_compliance=residual,
        )
        if modes is not None:
            self.environment = replace(self.environment, contact_switching="scene")
        self.signals, random = PUSH | signals, np.random.default_rng(0)
        body = self.body()
        self.u = 4.0 * random.standard_normal((STEPS, body.inputs)).cumsum(axis=0)
        self.u[:, 2] -= 40.0
        order = body.model.order
        self.state = 1e-5 * random.standard_normal(order), 1e-4 * random.standard_normal(order)
        self.directions = [random.standard_normal(self.u.shape), *1e-4 * random.standard_normal((2, order))]

    def body(self):
        return fr.Simulator(self.rom, H, scene=self, signals=self.signals)

    def moved(self, ε=0.0, directions=(0, 0, 0)):
        """A body, and inputs, where inputs, q and r are moved by ε along directions."""
        u, q, r = (part + ε * δ for part, δ in zip((self.u, *self.state), directions, strict=True))
        body = self.body()
        body.state = q, r
        return body, u

    def value(self, ε, directions):
        """The objective, by steps of a simulator."""
        body, u = self.moved(ε, directions)
        read, energies = [], []
        for step, row in enumerate(u):
            if self.modes is not None:
                body.switch(self.modes[step])
            body.step(row)
            read.append(body.displacement("tip"))
            energies.append(body.energy)
        return squares({"tip": np.array(read)}, np.array(energies))[0]

    def gradient(self):
        body, u = self.moved()
        return fr.differentiate(body, u, squares, contact=self.modes)


def squares(outputs, energies):
    weights = 100 * np.linspace(1.0, 2.0, len(energies))
    return 1e5 * (outputs["tip"] ** 2).sum() + weights @ energies, {"tip": 2e5 * outputs["tip"]}, weights


@pytest.mark.parametrize(
    "name", [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in CASES]
)
def test_gradient_agrees_with_differences(rom, name):
    check(Case(rom, *CASES[name]))


def test_gradient_goes_through_the_planes_of_a_mesh(rom):
    mesh = Mesh(groove(0.3).vertices, groove(0.3).triangles, (0.37, 0.1, -0.0535))
    among = replace(rom.environment, obstacles={"groove": MovingObstacle(mesh, STANDS_STILL)})
    check(Case(replace(rom, environment=among), ContactLaw(friction=0.3), ["groove"], True, {}, None))


TURNING = {  # law, obstacles, where their axes are
    "plane": (ContactLaw(friction=0.3), FLOOR, [0.2, 0.1, 0.0]),
    "shapes": (ContactLaw(friction=0.3), ROUND, [0.42, 0.1, -0.04]),
    "shapes, restitution": (ContactLaw(restitution=0.5, friction=0.3), ROUND, [0.42, 0.1, -0.04]),
    "shapes, springs": (ContactLaw(friction=0.3, stiffness=2e4, damping=3.0), ROUND, [0.42, 0.1, -0.04]),
}


@pytest.mark.parametrize("name", TURNING)
def test_gradient_goes_through_contact_with_what_turns(rom, name):
    """They turn faster and faster; what pushed before is told the velocities of their material."""
    law, names, origin = TURNING[name]
    case = Case(rom, law, names, True, {}, None)
    motion, turns = RigidMotion(None, origin), spin(origin, [0.3, 0.8, 0.5], 3.0, ramp=0.1)
    obstacles = {each: replace(known, motion=motion) for each, known in case.environment.obstacles.items()}
    case.environment = replace(case.environment, obstacles=obstacles)
    case.signals = case.signals | dict.fromkeys(names, turns)
    check(case)


def check(case, ε=1e-4):
    """A case's gradient, against differences of ε and by its remainder."""
    gradient = case.gradient()
    slopes = (gradient.inputs, *gradient.state)
    assert gradient.kinks == ()
    parts = [(slope * δ).sum() for slope, δ in zip(slopes, case.directions, strict=True)]
    size = max(map(abs, parts))  # one part may be hundreds of times smaller than another
    for place, part in enumerate(parts):
        along = [δ * (number == place) for number, δ in enumerate(case.directions)]
        difference = (case.value(ε, along) - case.value(-ε, along)) / (2 * ε)
        assert part == pytest.approx(difference, rel=AGREES, abs=AGREES * size)
    along = sum(parts)
    assert gradient.value == pytest.approx(case.value(0.0, case.directions), rel=1e-12)
    left = [abs(case.value(ε, case.directions) - gradient.value - ε * along) for ε in (4 * ε, 2 * ε)]
    assert 1.9 < np.log2(left[0] / left[1]) < 2.1


@pytest.mark.parametrize(
    ("μ", "obstacles", "swing"), [(0.6, FLOOR, (60.0, 1500.0)), (1.0, ROUND, (40.0, 800.0))], ids=["flat", "round"]
)
def test_gradient_goes_through_what_friction_stops_in_part(damped, monkeypatch, μ, obstacles, swing):
    """The share that is asked for is told by friction that does no work: it changes with all that forces do.

    What is shaken so fast swings for fewer steps in a row than are waited for.
    """
    shaken = {"push": lambda t: (20.0 + swing[0] * np.sin(swing[1] * t), -6.0, -60.0)}
    case = Case(damped, ContactLaw(friction=μ), obstacles, True, shaken, None)
    monkeypatch.setattr(braking, "SWINGS", 2)
    shares, (body, inputs) = [], case.moved()
    for row in inputs:
        body.step(row)
        asked = body.integrator.interface.solver.last_step()[0]
        shares.append(asked.braking.share if asked is not None else 1.0)
    assert any(0 < share < 1 for share in shares)
    check(case)


RELAXES = "viscoelasticity = { ratios = [0.6, 0.3], times = [5e-3, 0.05] }\n"
SPRING = 'springs.bed = { surface = "right", stiffness = 3e5 }\n'
RELAXING = {  # parts of the scene, residual compliance
    "yielding points": ({}, True),
    "stiff points": ({}, False),
    "spring, yielding points": ({"effects": SPRING}, True),
    "spring, stiff points": ({"effects": SPRING}, False),
    "loose": ({"supports": None}, True),
}


@pytest.mark.parametrize("name", RELAXING)
def test_gradient_goes_through_switches_of_a_material_that_relaxes(tmp_path, name):
    """Strains of its branches are projected, too; beside a spring that does not relax they are made smaller."""
    parts, residual = RELAXING[name]
    effects = RELAXES + parts.get("effects", "") + EFFECTS
    rom = reduced(tmp_path, effects, supports=parts.get("supports", 'clamped = ["left"]'))
    check(Case(rom, *CASES["switched"][:2], residual, *CASES["switched"][3:]))


def test_gradient_with_damping_goes_through_contact(rom):
    case = Case(rom, *CASES["shapes, friction"])
    D, δ = {}, {}
    for name, model in rom.contact_models.items():
        D[name], δ[name] = model.damping, model.damping * np.random.default_rng(1).uniform(0.5, 1.5, 8)

    def value(ε):
        models = {name: replace(model, damping=D[name] + ε * δ[name]) for name, model in rom.contact_models.items()}
        case.rom = replace(rom, contact_models=models)
        return case.value(0.0, (0, 0, 0))

    slope = sum(along @ δ[name] for name, along in case.gradient().damping.items())
    assert slope == pytest.approx((value(1e-4) - value(-1e-4)) / 2e-4, rel=AGREES)


def test_gradient_with_stiffness_goes_through_contact(rom):
    case = Case(rom, *CASES["shapes, friction, stiff points"])  # as residual compliance changes with stiffness, too
    case.modes, model = ["bottom"] * STEPS, rom.contact_models["bottom"]
    case.environment = replace(case.environment, contact_switching="scene")
    γ, δ = model.eigenvalues, model.eigenvalues * np.random.default_rng(1).uniform(0.5, 1.5, 8)

    def value(ε):
        case.rom = replace(rom, contact_models=rom.contact_models | {"bottom": replace(model, eigenvalues=γ + ε * δ)})
        return case.value(0.0, (0, 0, 0))

    slope = case.gradient().eigenvalues["bottom"] @ δ
    assert slope == pytest.approx((value(1e-5) - value(-1e-5)) / 2e-5, rel=AGREES)


def test_long_runs_are_taken_again_from_where_they_were_saved(rom, monkeypatch):
    case = Case(rom, *CASES["switched"])
    whole = case.gradient()
    monkeypatch.setattr(taken_steps, "MEMORY", 1e4)
    again = case.gradient()
    assert again.value == whole.value
    assert np.array_equal(again.inputs, whole.inputs)


def test_steps_at_a_kink_are_told(rom):
    case = Case(rom, *CASES["floor, friction"])
    floor = replace(case.environment.obstacles["floor"], shape=HalfSpace([0, 0, 0], [0, 0, 1]))
    case.environment = replace(case.environment, obstacles={"floor": floor})
    case.signals, case.u, case.state = {"push": (0.0, 0.0, 0.0)}, 0 * case.u, (0 * case.state[0], 0 * case.state[1])
    with pytest.warns(FenicsRomWarning, match=rf"{STEPS} of {STEPS} steps \(0, 1, 2, 3, 4, ...\) are at a kink"):
        gradient = case.gradient()
    assert gradient.kinks == tuple(range(STEPS))


@pytest.mark.parametrize(
    "shape", [Sphere([0.1, 0, 0], 0.2), Capsule([0, 0, 0], [1, 0.5, 0], 0.2), Box([0, 0, 0], [1, 1, 1], [1, 0, 0])]
)
def test_curvature_of_obstacles_is_what_normals_turn_by(shape):
    points, ε = np.random.default_rng(0).uniform(-2, 2, (50, 3)), 1e-6
    for axis, δ in enumerate(ε * np.eye(3)):
        turned = (shape.distance(points + δ)[1] - shape.distance(points - δ)[1]) / (2 * ε)
        assert shape.curvature(points)[:, :, axis] == pytest.approx(turned, abs=1e-8)


def test_faces_of_boxes_are_flat_however_near_a_point_is():
    box, ways = Box([0.1, 0.2, 0.3], [1, 1, 1], [0.3, -0.5, 0.7]), [0.0, *10.0 ** np.arange(-17, 0)]
    inside = np.array([0.1, 0.2, 0.3]) + 1e-2
    gap, out = box.distance(inside[None])
    points = inside + np.array([way - gap[0] for way in ways])[:, None] * out
    assert (box.curvature(points) == 0).all()
