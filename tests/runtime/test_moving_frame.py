"""Bodies that turn as far as they like: exact laws, order of accuracy, a rigid top, a base that carries them."""

import copy
import pickle
import re
import warnings
from dataclasses import replace

import numpy as np
import pytest
from bodies import box_arrays, scene_text, write_arrays
from scipy.integrate import solve_ivp

import fenics_rom as fr
from fenics_rom.errors import StepError
from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.mechanics.complementarity import NEGLIGIBLE_RESIDUAL
from fenics_rom.mechanics.contact import ContactLaw
from fenics_rom.mechanics.frame_motion import ZERO, cross_matrix, quaternion_of_vector, rotation_matrix, turned
from fenics_rom.runtime.steppers.inertia import definite_up_to, turn_of_top
from fenics_rom.scene.file import parse_scene

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
LEFT = NEGLIGIBLE_RESIDUAL / 10  # of the work, by forces that are found to this of velocities, ten points at a time
UNTURNED = np.array([1.0, 0.0, 0.0, 0.0])
GRAVITY = {"effects.gravity": "acceleration = [0.0, 0.0, -9.81]"}
FORCE = {"effects.prescribed.pull": 'surface = "right"\nforce = [0.01, -0.02, 0.03]'}


def reduced(folder, *, frame="moving", young="5e5", size=(0.3, 0.03, 0.02), order=10, supports=None, **parts):
    """A ROM of a box, free or held at its left end by a base."""
    mesh = write_arrays(folder / "box.msh", *box_arrays(size, (6, 1, 1)))
    material = f"young = {young}\npoisson = 0.4\ndensity = 1100.0"
    text = scene_text(mesh, supports=supports, material=material, damping="alpha = 0.5, beta = 2e-4", **parts)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return fr.reduce(fr.assemble(parse_scene(f'frame = "{frame}"\n{text}')), order=order)


@pytest.fixture(scope="module")
def free(tmp_path_factory):
    """A free beam that nothing acts on."""
    return reduced(tmp_path_factory.mktemp("free"))


@pytest.fixture(scope="module")
def pulled(tmp_path_factory):
    """A free beam that falls, and is pulled at one end."""
    return reduced(tmp_path_factory.mktemp("pulled"), **GRAVITY, **FORCE)


CLAMPED = {"supports": 'clamped = ["left"]'}


@pytest.fixture(scope="module")
def carried(tmp_path_factory):
    """The same, held by a base."""
    return reduced(tmp_path_factory.mktemp("carried"), **CLAMPED, **GRAVITY, **FORCE)


def undamped(rom):
    """What acts without damping."""
    return fr.Environment(**{**vars(rom.environment), "effects": {"inertia": ""}})


def thrown(body, spin, velocity=(0.1, 0.2, 0.3), seed=0, amplitude=1e-3):
    """A body that turns, flies and oscillates."""
    random = np.random.default_rng(seed)
    m = len(body.state[0])
    ω = np.sqrt(body.rom.contact_models[body.contact].eigenvalues)
    body.state = amplitude * random.standard_normal(m) / ω, amplitude * random.standard_normal(m)
    body.place(body.pose._replace(velocity=np.array(velocity), angular_velocity=np.array(spin)))
    return body


def ride(body, steps, seed=0, shortest=-4.0, longest=-1.0, u=None):
    """Steps of random length; the largest gaps of the account, of both momenta, and the largest energy or work."""
    random = np.random.default_rng(seed)
    start, (P, L) = body.energy, body.momentum
    gaps, scale = np.zeros(3), start
    for _ in range(steps):
        body.dt = 10 ** random.uniform(shortest, longest)
        body.step(np.zeros(body.inputs) if u is None else u(random))
        account = body.ledger
        energy = body.energy - start - account.supplied + account.dissipated + account.lost_in_switching
        now = [abs(energy), *(np.abs(a - b).max() for a, b in zip(body.momentum, (P, L), strict=True))]
        gaps = np.maximum(gaps, now)
        scale = max(scale, body.energy, abs(account.supplied), account.dissipated)
    return gaps, scale


FLOOR = """inertia = {}
damping = { alpha = 0.0, beta = 2e-5 }
gravity = { acceleration = [0.0, 0.0, -9.81] }
contact.obstacles.floor = { shape = "half-space", point = [0.0, 0.0, -0.03], normal = [0.0, 0.0, 1.0] }"""


@pytest.fixture(scope="module")
def falling(tmp_path_factory):
    """A free beam above a floor."""
    surfaces = "".join(f'[contacts.{name}]\nsurface = "{name}"\n' for name in ("left", "right"))
    return reduced(tmp_path_factory.mktemp("falling"), contacts=surfaces, effects=FLOOR)


@pytest.fixture(scope="module")
def hard(tmp_path_factory):
    """The same of a stiffer material."""
    surfaces = "".join(f'[contacts.{name}]\nsurface = "{name}"\n' for name in ("left", "right"))
    return reduced(tmp_path_factory.mktemp("hard"), contacts=surfaces, effects=FLOOR, young="1e8")


@pytest.mark.parametrize("seed", [7, 19, 23, 28, 30])
def test_a_beam_that_hits_a_floor_at_50_m_per_s_is_stopped(hard, seed):
    """Contact bends it far from how it would fly: sweeps shrink what they change all the same."""
    rng = np.random.default_rng(seed)
    q = np.array([1.0, *(0.1 * rng.standard_normal(3))])
    velocity = 50 * (direction := rng.standard_normal(3)) / np.linalg.norm(direction)
    velocity[2] = -abs(velocity[2])
    body = fr.Simulator(hard, 5e-4)
    position = np.add(body.pose.position, [0.0, 0.0, 0.03])
    body.place(BaseState(position, q / np.linalg.norm(q), velocity, 3 * rng.standard_normal(3)))
    start = body.energy
    for _ in range(20):
        body.step(np.zeros(body.inputs))
    account = body.ledger
    assert account.contact > 0.05 * start
    balance = body.energy - start - account.supplied + account.dissipated + account.lost_in_switching
    assert abs(balance) <= LEFT * start


def test_a_top_at_rest_is_turned_by_a_torque():
    """2/h I ω̂ + ω̂ × I ω̂ = τ, where there is no rotation yet to compare corrections with."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        (xx, yy, zz), h, τ = rng.uniform(1.0, 1.9, 3), 10 ** rng.uniform(-5, -1), rng.standard_normal(3)
        ω̂, left = turn_of_top((xx, yy, zz, 0.0, 0.0, 0.0), ZERO, tuple(τ), ZERO, ZERO, h)
        L = np.array([xx, yy, zz]) * ω̂
        assert left == 0.0
        np.testing.assert_allclose(2 / h * L + np.cross(ω̂, L), τ, rtol=0, atol=1e-14)


@pytest.mark.parametrize("detail", ["full", "quasi-rigid"])
@pytest.mark.parametrize("steps", [1000, pytest.param(30_000, marks=pytest.mark.slow)])
def test_free_body_keeps_energy_and_both_momenta(free, steps, detail):
    body = thrown(fr.Simulator(free, 1e-3, scene=undamped(free), detail=detail), (3.0, -4.0, 2.0))
    (P, L), (energy, linear, angular) = body.momentum, ride(body, steps)[0]
    assert energy <= 1e-12 * body.energy
    assert linear <= 1e-13 * np.linalg.norm(P)
    assert angular <= 1e-13 * np.linalg.norm(L)


@pytest.mark.parametrize("dense", [False, True])
@pytest.mark.parametrize("name", ["pulled", "carried"])
def test_account_of_a_driven_body_closes(request, name, dense):
    """Under gravity, a prescribed force, inputs, damping, and where a base moves as it likes."""
    rom = request.getfixturevalue(name)
    if dense:
        rom = with_dense_damping(rom)
    light = {"gravity": 0.01}  # or its work would hide all other
    body = thrown(fr.Simulator(rom, 1e-3, signals=light), (1.0, 2.0, -1.0), amplitude=1e-2)
    random = np.random.default_rng(1)
    start, gap, scale = body.energy, 0.0, 0.0
    base = body.pose
    for _ in range(500):
        body.dt = 10 ** random.uniform(-4, -1.3)
        base = some_way_on(base, body.dt, random)
        body.step(0.02 * random.standard_normal(body.inputs), base=base if name == "carried" else None)
        account = body.ledger
        gap = max(gap, abs(body.energy - start - account.supplied + account.dissipated))
        scale = max(scale, body.energy, abs(account.supplied), account.dissipated)
    assert gap <= 1e-12 * scale
    assert body.ledger.dissipated > 1e-4 * scale


def with_dense_damping(rom):
    """The same with damping that couples all coordinates."""
    random, models = np.random.default_rng(2), {}
    for name, model in rom.contact_models.items():
        ρ, m = rom.rigid, model.order
        root = random.standard_normal((m - ρ, m - ρ))
        D = np.zeros((m, m))
        D[ρ:, ρ:] = root @ root.T / m
        models[name] = replace(model, damping=D)
    return replace(rom, contact_models=models)


def some_way_on(base, h, random):
    """A base after h s of random accelerations, its pose where its twists lead it."""
    R = rotation_matrix(base.rotation)
    velocity = 0.9 * base.velocity + h**0.5 * random.standard_normal(3)
    spin = 0.9 * base.angular_velocity + 2 * h**0.5 * random.standard_normal(3)
    rotation = base.rotation
    for _ in range(50):  # R⁺ depends on the twist in its own axes
        ω̂ = (base.angular_velocity @ R + spin @ rotation_matrix(rotation)) / 2
        rotation = np.array(turned(base.rotation, h * ω̂))
    v̂ = (base.velocity @ R + velocity @ rotation_matrix(rotation)) / 2
    middle = R @ (np.eye(3) + h / 2 * cross_matrix(ω̂))
    return BaseState(base.position + h * middle @ v̂, rotation, velocity, spin)


def test_linear_momentum_grows_by_the_forces_and_angular_momentum_by_their_torque(pulled):
    """In free fall, with a force at the end of the moved body."""
    body = thrown(fr.Simulator(pulled, 1e-3), (1.0, 2.0, -1.0), amplitude=1e-2)
    mass, force = pulled.moving_frame.mass, np.array([0.01, -0.02, 0.03])
    random = np.random.default_rng(3)
    for _ in range(100):
        h = body.dt = 10 ** random.uniform(-4, -2)
        P, L = body.momentum
        body.step(np.zeros(body.inputs))
        P_end, L_end = body.momentum
        np.testing.assert_allclose(P_end - P, h * (force + mass * np.array([0, 0, -9.81])), rtol=1e-10)
        assert np.abs(L_end - L).max() <= h * np.linalg.norm(force) * 0.16  # half the length of the beam, bent


def test_base_at_rest_leaves_the_clamped_body_as_it_is(carried, tmp_path):
    """The same steps as in a fixed frame, to round-off."""
    fixed = reduced(tmp_path, frame="fixed", **CLAMPED, **GRAVITY, **FORCE)
    bodies = [fr.Simulator(rom, 1e-3) for rom in (fixed, carried)]
    random = np.random.default_rng(4)
    for _ in range(300):
        u, h = 0.1 * random.standard_normal(bodies[0].inputs), 10 ** random.uniform(-4, -1)
        for body in bodies:
            body.dt = h
            body.step(u)
    (shape, still), (moved, there) = ((body.displacement(), body.energy) for body in bodies)
    assert np.abs(shape - moved).max() <= 1e-12 * np.abs(shape).max()
    assert abs(still - there) <= 1e-12 * still


def test_momenta_grow_by_what_the_base_does(carried):
    """Where nothing else acts: by its force, and by its torque about the frame's origin, which goes on meanwhile."""
    body = thrown(fr.Simulator(carried, 1e-3, signals={"gravity": 0.0, "pull": np.zeros(3)}), (1.0, 2.0, -1.0))
    random, base = np.random.default_rng(10), body.pose
    for _ in range(50):
        h = body.dt = 10 ** random.uniform(-4, -2)
        before, base = base, some_way_on(base, h, random)
        P, L = body.momentum
        body.step(np.zeros(3), base=base)
        P_end, L_end = body.momentum
        force, torque = body.base_wrench
        R, R_end = rotation_matrix(before.rotation), rotation_matrix(base.rotation)
        carried_off = np.cross(before.velocity @ R + base.velocity @ R_end, P @ R + P_end @ R_end) / 4
        scale = np.linalg.norm(P) + np.linalg.norm(L) + h * np.linalg.norm(force)
        np.testing.assert_allclose(P_end - P, h * force, rtol=0, atol=1e-14 * scale)
        np.testing.assert_allclose(L_end - L, h * (torque - (R + R_end) / 2 @ carried_off), rtol=0, atol=1e-14 * scale)


def test_shapes_that_have_kinetic_energy_for_sure_are_as_far_as_they_say():
    """Where one thing alone takes from inertia the bound is the very edge; else it is on the safe side."""
    I0 = np.array([1.0, 2.0, 3.0, 0.0, 0.0, 0.0])
    none = {"inertia1": np.zeros((6, 2)), "inertia2": np.zeros((6, 2, 2)), "coupling": np.zeros((3, 2, 2))}
    bent, turned = none["inertia1"].copy(), none["coupling"].copy()
    bent[1, 0], turned[2, 0, 1], turned[2, 1, 0] = -4.0, 0.5, -0.5  # 2 - 4 e, and 3 - e²/4
    assert definite_up_to(I0, **none) == np.inf
    assert definite_up_to(I0, **none | {"inertia1": bent}) == pytest.approx(0.25)
    assert definite_up_to(I0, **none | {"coupling": turned}) == pytest.approx(12.0)
    random = np.random.default_rng(11)
    I1, I2, G = (random.standard_normal(shape) for shape in ((6, 4), (6, 4, 4), (3, 4, 4)))
    I2, G = I2 + I2.transpose(0, 2, 1), G - G.transpose(0, 2, 1)
    largest = definite_up_to(I0, I1, I2, G)
    for _ in range(200):
        e = random.standard_normal(4)
        e *= np.sqrt(largest) / np.linalg.norm(e)
        b = G @ e
        assert np.linalg.eigvalsh((I0 + I1 @ e + e @ I2 @ e)[[[0, 5, 4], [5, 1, 3], [4, 3, 2]]] - b @ b.T)[0] >= 0


def after_a_tenth(rom, h, carried):
    """Node positions, and the torque of the base, of a body that is thrown, or swung."""
    body = thrown(fr.Simulator(rom, h), (0.0, 0.0, 0.0) if carried else (2.0, 3.0, -1.0), (0.0, 0.0, 0.0))
    torque = np.zeros(3)
    for step in range(round(0.1 / h)):
        t = (step + 1) * h
        angle, rate = 0.3 * (1 - np.cos(8 * t)), 2.4 * np.sin(8 * t)
        there = BaseState(body.pose.position, quaternion_of_vector((0, angle, 0)), np.zeros(3), np.array((0, rate, 0)))
        body.step(np.zeros(body.inputs), base=there if carried else None)
        torque += h * body.base_wrench[1] if carried else 0.0
    return body.displacement(), torque


@pytest.mark.parametrize("name", ["pulled", "carried"])
def test_steps_are_of_second_order(request, name):
    rom = request.getfixturevalue(name)
    runs = [after_a_tenth(rom, 1e-3 / 2**k, name == "carried") for k in (0, 1, 4)]
    for part in range(1 + (name == "carried")):
        coarse, fine = (np.linalg.norm(run[part] - runs[-1][part]) for run in runs[:-1])
        assert 1.9 <= np.log2(coarse / fine) <= 2.1


@pytest.mark.parametrize(
    ("restitution", "friction", "yields", "fixed"),
    [(0.0, 0.0, True, True), (1.0, 0.0, False, False), (0.5, 0.4, True, False), (0.0, 0.4, False, True)],
)
def test_a_beam_that_tumbles_onto_a_floor_closes_its_account(falling, restitution, friction, yields, fixed):
    """Contact adds no energy in any step; where nothing touches or rubs, horizontal momentum stays."""
    law = ContactLaw(restitution=restitution, friction=friction)
    rom = replace(falling, environment=replace(falling.environment, contact_law=law, residual_compliance=yields))
    body = thrown(fr.Simulator(rom, 1e-3), (0.5, 3.0, 1.0))
    random = np.random.default_rng(5)
    start, (P, _), gap, touched = body.energy, body.momentum, 0.0, 0
    for _ in range(150):
        if not fixed:
            body.dt = 10 ** random.uniform(-4, -2.3)
        before = body.ledger.contact, body.ledger.friction
        body.step(np.zeros(body.inputs))
        body._stepper.kernel.step(np.zeros(body._stepper.model.inputs.shape[1]))  # away from the floor,
        body._stepper.rollback()  # and taken back: what the step before owes stays owed
        account = body.ledger
        assert account.contact - before[0] >= -LEFT * max(start, account.supplied)
        assert account.friction - before[1] >= -LEFT * max(start, account.supplied)
        assert account.lost_in_switching >= -1e-13 if yields else abs(account.lost_in_switching) <= 1e-12
        kept = account.supplied - account.dissipated - account.lost_in_switching
        gap = max(gap, abs(body.energy - start - kept))
        touched += body.contact_forces().any()
    assert touched > 5
    assert gap <= 1e-12 * account.supplied
    if not friction:
        assert np.abs(body.momentum[0] - P)[:2].max() <= 1e-12 * np.linalg.norm(P)
        assert account.contact > 0 if restitution < 1 else account.contact <= 10 * LEFT * max(start, account.supplied)


@pytest.mark.parametrize(("stiffness", "damping", "friction"), [(50.0, 0.0, 0.0), (500.0, 0.5, 0.4)])
def test_springs_of_a_floor_give_back_no_more_than_they_took(falling, stiffness, damping, friction):
    """The penalty law in a moving frame: the account closes, and less dashpots take and friction rub, energy stays."""
    law = ContactLaw(stiffness=stiffness, damping=damping, friction=friction)
    rom = replace(falling, environment=replace(falling.environment, contact_law=law, residual_compliance=False))
    body = thrown(fr.Simulator(rom, 1e-3), (0.5, 3.0, 1.0))
    random = np.random.default_rng(9)
    start, gap, most, touched, rubbed = body.energy, 0.0, 0.0, 0, 0.0
    for _ in range(200):
        body.dt = 10 ** random.uniform(-4, -2.3)
        body.step(np.zeros(body.inputs))
        account, scale = body.ledger, max(start, body.ledger.supplied)
        gap = max(gap, abs(body.energy - start - account.supplied + account.dissipated + account.lost_in_switching))
        assert account.contact >= -1e-12 * scale  # springs hold it, or dashpots took it
        assert account.friction - rubbed >= -1e-12 * scale
        most, touched, rubbed = max(most, account.contact), touched + body.contact_forces().any(), account.friction
    assert touched > 5
    assert most > 1e-3 * scale
    assert (rubbed > 0) == (friction > 0)
    assert gap <= 1e-12 * scale


def test_a_beam_rests_on_springs_with_its_weight(tmp_path):
    """On a floor that yields, in a moving frame: as deep as k P points hold its weight."""
    rom = reduced(tmp_path, effects=FLOOR, contacts='[contacts.bottom]\nsurface = "bottom"', young="5e7")
    law, points = ContactLaw(stiffness=100.0, damping=5.0), fr.Simulator(rom, 1e-2).contact_coordinates
    rom = replace(rom, environment=replace(rom.environment, contact_law=law, residual_compliance=False))
    body = fr.Simulator(rom, 1e-2)
    for _ in range(300):
        body.step()
    weight = 9.81 * rom.moving_frame.mass
    assert body.contact_forces()[:, 2].sum() == pytest.approx(weight, rel=1e-3)
    deep = -0.03 - (points + body._stepper.point_displacement())[:, 2]
    assert deep.mean() == pytest.approx(weight / 100.0 / len(points), rel=1e-2)


def test_forces_that_do_not_settle_stay_passive(tmp_path):
    """A bar that lands flat and rubs, on few modes that do not tell all forces apart."""
    rom = reduced(tmp_path, effects=FLOOR, contacts='[contacts.bottom]\nsurface = "bottom"')
    law = ContactLaw(friction=0.5)
    rom = replace(rom, environment=replace(rom.environment, contact_law=law, residual_compliance=False))
    body = thrown(fr.Simulator(rom, 1e-3), (0.5, 0.2, 3.0), (0.3, 0.1, 0.0))
    start = body.energy
    for _ in range(120):
        before = body.ledger.contact, body.ledger.friction
        body.step()
        account = body.ledger
        assert account.contact - before[0] >= -LEFT * max(start, account.supplied)
        assert account.friction - before[1] >= -LEFT * max(start, account.supplied)
    assert body.contact_forces().any()
    assert abs(body.energy - start - account.supplied + account.dissipated) <= 1e-12 * account.supplied


def test_a_bar_that_lands_flat_and_rubs_settles(tmp_path):
    """On few modes, which do not tell the forces of 14 points apart: they are found to 1e-5 in the worst of steps."""
    rom = reduced(tmp_path, effects=FLOOR, contacts='[contacts.bottom]\nsurface = "bottom"')
    random = np.random.default_rng(8)
    for dt, friction in ((1e-3, 0.5), (1e-2, 0.2)):
        env = replace(rom.environment, contact_law=ContactLaw(friction=friction), residual_compliance=False)
        body = thrown(fr.Simulator(replace(rom, environment=env), dt), random.uniform(-1, 1, 3) * (0.3, 0.1, 3.0))
        down = body.pose.position - (0.0, 0.0, 0.0285)
        body.place(body.pose._replace(position=down, velocity=np.array((0.2, 0.1, -0.3))))
        start = scale = body.energy
        for _ in range(30):
            before = body.ledger.contact, body.ledger.friction
            body.step()
            account = body.ledger
            scale = max(scale, abs(account.supplied), account.dissipated)
            assert account.contact - before[0] >= -LEFT * scale
            assert account.friction - before[1] >= -LEFT * scale
        assert account.friction > 0
        assert body._stepper.interface.solver.search.residual.residual <= 1e-5  # of what the floor stops
        assert abs(body.energy - start - account.supplied + account.dissipated) <= 1e-12 * scale


def test_obstacles_push_a_carried_body(tmp_path):
    """A floor that rises against a beam that a base swings: the account closes, and the base feels the push."""
    rom = reduced(tmp_path, effects=FLOOR, contacts='[contacts.right]\nsurface = "right"', **CLAMPED)
    body = fr.Simulator(rom, 1e-3, signals={"floor": lambda t: [0.0, 0.0, 0.05 * t]})
    start, gap, pushed = body.energy, 0.0, False
    random, t, origin = np.random.default_rng(6), 0.0, body.pose.position
    for _ in range(300):
        body.dt = 10 ** random.uniform(-4, -2.5)
        t += body.dt
        angle, rate = 0.3 * (1 - np.cos(8 * t)), 2.4 * np.sin(8 * t)
        spin = np.array((0.0, rate, 0.0))
        body.step(np.zeros(body.inputs), base=BaseState(origin, quaternion_of_vector((0, angle, 0)), 0 * spin, spin))
        account = body.ledger
        gap = max(gap, abs(body.energy - start - account.supplied + account.dissipated))
        assert account.contact >= -1e-13
        pushed |= bool(body.contact_forces().any())
    assert pushed
    assert account.obstacles != 0
    assert gap <= 1e-12 * max(abs(account.supplied), body.energy)


def test_switching_in_mid_flight_changes_nothing(free):
    """A thousand times: no energy, no momentum, no node moves."""
    body = thrown(fr.Simulator(free, 1e-3, scene=undamped(free)), (3.0, -4.0, 2.0), amplitude=3e-3)
    random, (P, L), energy = np.random.default_rng(7), body.momentum, body.energy
    largest = 0.0
    for _ in range(1000):
        for _ in range(random.integers(0, 3)):
            body.step(np.zeros(body.inputs))
        before, shape = body.energy, body.displacement()
        body.switch("top" if body.contact == "right" else "right")
        largest = max(largest, body.energy / before - 1)
        assert np.abs(body.displacement() - shape).max() <= 1e-14
    assert largest <= 1e-13
    assert abs(body.energy - energy) <= 1e-12 * energy
    assert np.abs(body.momentum[0] - P).max() <= 1e-12 * np.linalg.norm(P)
    assert np.abs(body.momentum[1] - L).max() <= 1e-12 * np.linalg.norm(L)
    assert len(body.state[0]) == free.contact_models["right"].order - 6 + 2


def test_a_stiff_box_is_a_top(tmp_path):
    """Against Euler's equations; thrown about its middle axis it turns over when it should."""
    rom = reduced(tmp_path, young="5e11", size=(0.3, 0.2, 0.1), order=3)
    inertia, frame = np.linalg.eigh(rom.moving_frame.inertia0[[[0, 5, 4], [5, 1, 3], [4, 3, 2]]])
    frame *= np.linalg.det(frame)  # principal axes, ascending
    spin = np.array([0.3, 12.0, 0.3])

    def euler(t, ω):
        return np.cross(inertia * ω, ω) / inertia

    exact = solve_ivp(euler, (0, 1.5), spin, method="DOP853", rtol=1e-12, atol=1e-12, dense_output=True).sol
    assert exact(np.linspace(0, 1.5, 500))[1].min() < -11  # it turns over
    errors = []
    for h in (4e-3, 2e-3):
        body = fr.Simulator(rom, h, scene=undamped(rom))
        body.place(body.pose._replace(angular_velocity=frame @ spin))
        found = []
        for _ in range(round(1.5 / h)):
            body.step(np.zeros(body.inputs))
            found.append(frame.T @ rotation_matrix(body.pose.rotation).T @ body.pose.angular_velocity)
        times, found = h * np.arange(1, len(found) + 1), np.array(found)
        errors.append(np.abs(found - exact(times).T).max())
        turned_over = [
            np.interp(0.0, -along[: along.argmin()], times[: along.argmin()])
            for along in (found[:, 1], exact(times)[1])
        ]
        assert turned_over[0] == pytest.approx(turned_over[1], rel=2 * h)
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (np.abs(orders - 2) <= 0.1).all()


def test_saved_states_go_on_to_the_bit(falling):
    body = thrown(fr.Simulator(falling, 1e-3), (0.5, 3.0, 1.0))
    for _ in range(60):
        body.step(np.zeros(body.inputs))
    body.switch("left" if body.contact == "right" else "right")
    twins = [body, copy.copy(body), pickle.loads(pickle.dumps(body)), fr.Simulator(falling, 1e-3)]
    twins[-1].restore(body.save())
    for _ in range(40):
        for twin in twins:
            twin.step(np.zeros(twin.inputs))
    for twin in twins[1:]:
        assert all(np.array_equal(a, b) for a, b in zip(twin.state + twin.pose, body.state + body.pose, strict=True))
        assert twin.ledger.sums == body.ledger.sums
    body.reset()
    assert not body.state[1].any()
    np.testing.assert_array_equal(body.pose.rotation, UNTURNED)


def test_a_step_that_fails_leaves_everything_as_it_was(pulled):
    body = thrown(fr.Simulator(pulled, 1e-3), (3.0, -4.0, 2.0))
    body.step(np.zeros(body.inputs))
    before = body.save()
    body.dt = 1.0
    with pytest.raises(StepError, match=r"would turn by .* rad in a step of 1 s: at most 1"):
        body.step(np.zeros(body.inputs))
    body.dt = 1e-3
    for u, message in ((np.full(3, np.nan), "step overflows"), (np.zeros(7), "use 3 numbers")):
        with pytest.raises(StepError, match=message):
            body.step(u)
    with pytest.raises(StepError, match="use a body in a moving frame that a rigid base carries"):
        body.step(np.zeros(3), base=body.pose)
    after = body.save()
    assert np.array_equal(after.stepper.state, before.stepper.state)
    assert after.stepper.frame == before.stepper.frame


def test_quasi_rigid_leaves_out_what_shapes_do_to_inertia(pulled):
    """A top beside a body that oscillates in its own frame: the same as full for a body at rest in it, and balanced."""
    body = thrown(fr.Simulator(pulled, 1e-3, detail="quasi-rigid"), (1.0, 2.0, -1.0))
    full = thrown(fr.Simulator(pulled, 1e-3), (1.0, 2.0, -1.0))
    for _ in range(50):
        body.step(np.zeros(3))
        full.step(np.zeros(3))
    account = body.ledger
    assert 0 < np.abs(body.displacement() - full.displacement()).max() < 1e-4
    start = thrown(fr.Simulator(pulled, 1e-3, detail="quasi-rigid"), (1.0, 2.0, -1.0)).energy
    gap = abs(body.energy - start - account.supplied + account.dissipated)
    assert gap <= 1e-12 * max(start, body.energy, abs(account.supplied))
    with pytest.raises(StepError, match="no detail 'rough'; there is full, quasi-rigid"):
        fr.Simulator(pulled, 1e-3, detail="rough")


def test_a_carried_body_begins_where_its_base_is(carried):
    there = BaseState(np.array([1.0, 2.0, 3.0]), quaternion_of_vector((0, 0, 2.0)), np.ones(3), np.array([0, 0, 1.0]))
    body = fr.Simulator(carried, 1e-3, signals={"base_path": lambda t: there._replace(position=there.position + t)})
    held = np.isclose(carried.nodes[:, 0], 0.0)
    for _ in range(2):
        np.testing.assert_array_equal(body.pose.position, there.position)
        arms = (carried.nodes + body.displacement())[held] - there.position
        expected = there.velocity + np.cross(there.angular_velocity, arms)
        np.testing.assert_allclose(body.velocity()[held], expected, rtol=1e-13)
        body.step()
        np.testing.assert_array_equal(body.pose.position, there.position + 1e-3)
        body.reset()
    with pytest.raises(StepError, match="use `state` and `place`"):
        body.set_shape(np.zeros(carried.nodes.shape))


def test_a_base_that_jumps_is_told(carried):
    body = fr.Simulator(carried, 1e-3)
    body.step()
    assert not body.warnings
    body.step(base=body.pose._replace(position=body.pose.position + 0.02 * np.eye(3)[2]))
    assert "base: in a step it went 0.02 m and turned 0 rad otherwise" in body.warnings[0]
    before = body.pose.position
    with pytest.raises(StepError, match="use 3 numbers"):
        body.step(np.zeros(9), base=body.pose._replace(position=np.zeros(3)))
    body.step()  # the base of the step that failed is forgotten
    np.testing.assert_array_equal(body.pose.position, before)


def test_a_base_that_turns_far_in_a_step_as_its_twists_say_is_not_told(carried):
    body, random = fr.Simulator(carried, 0.05), np.random.default_rng(11)
    base = body.pose._replace(velocity=np.array((1.0, 0.0, 0.0)), angular_velocity=np.array((0.0, 0.0, 12.0)))
    body.place(base)
    for _ in range(4):
        base = some_way_on(base, body.dt, random)
        body.step(base=base)
    assert not [line for line in body.warnings if line.startswith("base:")]


def test_a_base_whose_twist_does_not_fit_its_turn_is_told(carried):
    """With how far; one that turns too fast for a step is refused, and the state stays."""
    body = fr.Simulator(carried, 1e-2)
    body.step(base=body.pose._replace(rotation=quaternion_of_vector((0, 0, 0.2))))
    assert (
        "base: in a step it went 0 m and turned 0.2 rad otherwise than its velocities at both ends say"
        in (body.warnings[0])
    )
    before = body.save().stepper
    with pytest.raises(StepError, match=r"would turn by 2 rad in a step of 0\.01 s: at most 1.5 rad, that is, at 200"):
        body.step(base=body.pose._replace(angular_velocity=np.array([0.0, 200.0, 0.0])))
    after = body.save().stepper
    assert after.frame == before.frame
    np.testing.assert_array_equal(after.state, before.state)


@pytest.mark.parametrize(
    ("spin", "amplitude", "detail", "told"),
    [
        (0.5, 1e-3, "full", None),
        (0.5, 1.0, "full", "bent by up to .* in its frame, .*% of its length"),
        (
            0.5,
            1e-3,
            "quasi-rigid",
            "turned at up to 0.5.* of its first frequency, and detail = 'quasi-rigid' leaves out",
        ),
        (6.0, 1e-3, "full", "does not know how its rotation stiffens it"),
    ],
)
def test_what_a_model_does_not_follow_is_told(free, spin, amplitude, detail, told):
    rom = replace(free, moving_frame=replace(free.moving_frame, stiffening=None))
    body = thrown(fr.Simulator(rom, 1e-3, detail=detail), (0.0, spin, 0.0), amplitude=amplitude)
    for _ in range(3):
        body.step()
    messages = [line for line in body.warnings if line.startswith("moving frame")]
    assert bool(messages) == (told is not None)
    assert told is None or any(re.search(told, message) for message in messages)
    assert copy.copy(body).warnings == body.warnings


def test_snapshots_of_bodies_that_are_free_and_carried_are_told_apart(free, pulled, carried):
    body = fr.Simulator(free, 1e-3)
    body.step({"right": [0.0, 0.1, 0.0]})
    for other in (pulled, carried):
        with pytest.raises(StepError, match="is of another ROM"):
            fr.Simulator(other, 1e-3).restore(body.save())
