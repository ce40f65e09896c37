"""Contact at full order in a moving frame: exact laws, the reduced body in all its modes, and how errors fall."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import box_arrays, scene_text, write_arrays

import fenics_rom as fr
from fenics_rom.errors import StepError
from fenics_rom.fem import full_order_body
from fenics_rom.fem.simulator import FullOrderSimulator
from fenics_rom.fem.solved_rows import SolvedRows
from fenics_rom.mechanics.complementarity import NEGLIGIBLE_RESIDUAL
from fenics_rom.mechanics.contact import ContactLaw
from fenics_rom.scene.file import parse_scene

LEFT = NEGLIGIBLE_RESIDUAL  # of the work, by forces that are found to this of velocities
GRAVITY = np.array([0.0, 0.0, -9.81])
FLOOR = """inertia = {}
damping = { beta = 1e-3 }
gravity = { acceleration = [0.0, 0.0, -9.81] }
friction = { coefficient = 0.5 }
contact.obstacles.floor = { shape = "half-space", point = [0.0, 0.0, -0.02], normal = [0.0, 0.0, 1.0] }"""
TIES = 'springs.bed = { surface = "top", stiffness = 8.0 }\n'
SURFACES = '[contacts.bottom]\nsurface = "bottom"\n[contacts.right]\nsurface = "right"'
CARRIED = 'clamped = ["left"]'


@pytest.fixture(scope="module")
def mesh(tmp_path_factory):
    return write_arrays(tmp_path_factory.mktemp("frame") / "beam.msh", *box_arrays((0.3, 0.03, 0.02), (4, 1, 1)))


def scene_of(mesh, supports=None, young=5e5, frame="moving", **parts):
    material = f"young = {young}\npoisson = 0.4\ndensity = 1100.0"
    effects = FLOOR if supports is None else FLOOR + "\nbase_path = { origin = [0.0, 0.015, 0.01] }"
    parts = {"material": material, "effects": effects, "contacts": SURFACES, "supports": supports} | parts
    return parse_scene(f'frame = "{frame}"\n' + scene_text(mesh, **parts))


@pytest.fixture(scope="module")
def systems(mesh):
    return {supports: fr.assemble(scene_of(mesh, supports)) for supports in (None, CARRIED)}


def swung(time):
    """A base that swings about y."""
    angle, rate = 0.12 * np.sin(12 * time), 1.44 * np.cos(12 * time)
    rotation = np.array([np.cos(angle / 2), 0.0, np.sin(angle / 2), 0.0])
    return fr.BaseState(np.array([0.0, 0.015, 0.01]), rotation, np.zeros(3), np.array([0.0, rate, 0.0]))


def lowered(time):
    """One that is lowered, faster and faster."""
    position, velocity = [0.0, 0.015, 0.01 - 15 * time**2], [0.0, 0.0, -30 * time]
    return fr.BaseState(np.array(position), np.array([1.0, 0.0, 0.0, 0.0]), np.array(velocity), np.zeros(3))


def thrown(origin):
    """A beam that tumbles towards the floor."""
    q = np.array([1.0, 0.05, 0.1, 0.0])
    turns = np.array([1.0, 4.0, 2.0])
    return fr.BaseState(np.add(origin, [0.0, 0.0, 0.015]), q / np.linalg.norm(q), np.array([0.2, 0.1, -0.5]), turns)


def begun(system, dt, law=None, path=swung):
    """The body at the start of its motion, at full order, under a contact law if not the scene's."""
    environment = system.scene.environment
    environment = environment if law is None else replace(environment, contact_law=law)
    signals = {"base_path": path} if system.moving_frame.carried else {}
    body = FullOrderSimulator(system, dt, environment, signals)
    if not system.moving_frame.carried:
        body.stepper.place(thrown(system.moving_frame.origin))
    return body


@pytest.mark.parametrize("supports", [None, CARRIED])
def test_reduced_in_all_modes_is_full_order(systems, supports):
    """Two programs of the same sweeps, until round-off has grown: shapes, forces, the wrench of the base."""
    system, dt = systems[supports], 2e-3
    rom = fr.reduce(system, order=system.elastic_size, method="modal")
    signals = {"base_path": swung} if supports else {}
    full, reduced = begun(system, dt), fr.Simulator(rom, dt, signals=signals)
    reduced.place(swung(0.0) if supports else thrown(system.moving_frame.origin))
    touched = 0
    for _ in range(30):
        for body in (full, reduced):
            body.step(np.zeros(0))
        force = full.obstacle_forces()[0]
        touched += bool(force.any())
        np.testing.assert_allclose(reduced.displacement(), full.displacement(), rtol=0, atol=1e-10)
        np.testing.assert_allclose(reduced.contact_forces().sum(axis=0), force, rtol=0, atol=1e-5)
        assert full.contact == reduced.contact
    assert touched > 10
    assert full.ledger.friction > 1e-5
    for ours, others in zip(reduced.momentum, full.momentum, strict=True):
        np.testing.assert_allclose(ours, others, rtol=0, atol=1e-9)
    if supports:
        np.testing.assert_allclose(reduced.base_wrench, full.base_wrench, rtol=0, atol=1e-5)


@pytest.mark.parametrize("supports", [None, CARRIED])
def test_a_tied_body_that_touches_is_the_reduced_one_and_closes_its_account(mesh, supports):
    """On springs and dashpots to the ground, which contact forces push it against."""
    ties = FLOOR.replace("beta = 1e-3", 'beta = 1e-3, dashpots.oil = { surface = "right", coefficient = 0.05 }')
    origin = "base_path = { origin = [0.0, 0.015, 0.01] }" if supports else ""
    system = fr.assemble(scene_of(mesh, supports, effects=f"{ties}\n{TIES}{origin}"))
    rom = fr.reduce(system, order=system.elastic_size, method="modal")
    signals = {"base_path": swung} if supports else {}
    full, reduced = begun(system, 2e-3), fr.Simulator(rom, 2e-3, signals=signals)
    reduced.place(swung(0.0) if supports else thrown(system.moving_frame.origin))
    start, touched, scale = full.energy, 0, full.energy
    for _ in range(25):
        for body in (full, reduced):
            body.step(np.zeros(0))
        force = full.obstacle_forces()[0]
        touched += bool(force.any())
        np.testing.assert_allclose(reduced.displacement(), full.displacement(), rtol=0, atol=1e-10)
        np.testing.assert_allclose(reduced.contact_forces().sum(axis=0), force, rtol=0, atol=1e-5)
        scale = max(scale, full.energy, abs(full.ledger.supplied))
    account = full.ledger
    assert touched > 5
    assert account.contact > 1e-6
    gap = full.energy - start - account.supplied + account.dissipated + account.lost_in_switching
    assert abs(gap) <= LEFT * scale


RESTING = FLOOR.replace("inertia = {}\n", "").replace("damping = { beta = 1e-3 }\n", "")
KINDS = {
    "free": {},
    "carried": {"supports": CARRIED},
    "carried, without inertia": {"supports": CARRIED, "effects": f"{RESTING}\nbase_path = {{}}"},
    "held": {"frame": "fixed", "supports": CARRIED, "effects": FLOOR},
    "held, large": {
        "frame": "fixed",
        "supports": CARRIED,
        "effects": FLOOR + '\nlarge_deformation = { material = "neo_hookean" }',
    },
}


@pytest.mark.parametrize("kind", list(KINDS))
def test_the_operator_of_many_points_is_solved_where_forces_act(mesh, kind, monkeypatch):
    """It is that of all points, by motion and forces of 40 steps. Before something is near nothing is solved."""
    system, found, rows = fr.assemble(scene_of(mesh, **KINDS[kind])), [], list[SolvedRows]()
    made = SolvedRows.__init__
    monkeypatch.setattr(SolvedRows, "__init__", lambda self, *given: (rows.append(self), made(self, *given))[1])
    for most in (full_order_body.MOST_WHOLE, 0):
        monkeypatch.setattr(full_order_body, "MOST_WHOLE", most)
        environment, told = system.scene.environment, []
        signals = {"base_path": lowered} if environment.is_moving and system.moving_frame.carried else {}
        body = FullOrderSimulator(system, 2e-3, environment, signals)
        if kind == "free":
            body.stepper.place(thrown(system.moving_frame.origin))
        for step in range(40):
            body.step(np.zeros(0))
            if step == 0 and kind in ("carried", "held"):
                assert not any((each.slots >= 0).any() for each in rows)  # as nothing is near
            told.append(np.concatenate([body.displacement().ravel(), body.obstacle_forces().ravel()]))
        found.append(np.array(told))
    assert np.abs(found[0][:, -3:]).max() > 0
    np.testing.assert_allclose(found[1], found[0], rtol=0, atol=1e-9 * np.abs(found[0]).max())
    assert any((each.slots >= 0).any() for each in rows)


@pytest.mark.parametrize("supports", [None, CARRIED])
@pytest.mark.parametrize(
    "law", [ContactLaw(1.0, 0.0), ContactLaw(0.0, 0.5), pytest.param(ContactLaw(0.5, 0.3), marks=pytest.mark.slow)]
)
def test_contact_adds_no_energy_and_the_account_closes(systems, supports, law):
    body = begun(systems[supports], 3e-3, law)
    start = scale = body.energy
    for step in range(30):
        body.stepper.set_time_step((3e-3, 1e-3, 8e-3)[step // 10])
        before = body.ledger.contact, body.ledger.friction
        body.step(np.zeros(0))
        account = body.ledger
        scale = max(scale, abs(account.supplied), account.dissipated)
        assert account.contact - before[0] >= -LEFT * scale
        assert account.friction - before[1] >= -1e-12 * scale
        assert abs(body.energy - start - account.supplied + account.dissipated) <= 1e-11 * scale
    assert account.contact > 1e-4 * scale if law.restitution < 1 else abs(account.contact) <= LEFT * scale
    assert (account.friction > 1e-5 * scale) == (law.friction > 0)
    assert not body.stepper.diagnostics()


@pytest.mark.parametrize("stiffness", [200.0, pytest.param(2e4, marks=pytest.mark.slow)])
def test_springs_of_a_floor_are_in_the_account(systems, stiffness):
    """The penalty law: what soft springs give back was taken; of stiff ones, at this step, the account closes, too."""
    body = begun(systems[None], 1e-3, ContactLaw(stiffness=stiffness, damping=1.0, friction=0.3))
    start, touched = body.energy, 0
    for _ in range(40):
        body.step(np.zeros(0))
        touched += bool(body.obstacle_forces().any())
        account = body.ledger
        scale = max(start, abs(account.supplied), account.dissipated)
        assert account.contact >= -1e-12 * scale or stiffness > 1e3
        assert abs(body.energy - start - account.supplied + account.dissipated) <= 1e-11 * scale
    assert touched > 10


@pytest.mark.parametrize("supports", [None, CARRIED])
def test_momenta_change_by_the_impulses_of_all_forces(systems, supports):
    """P by weight, contact and base; of a free body ℓ about the centre of mass by contact's torque in mid-step."""
    system, h = systems[supports], 2e-3
    body, weight = begun(system, h, path=lowered), system.moving_frame.moments[0, 0] * GRAVITY
    rest = body.stepper.interface.points.coordinates
    most = 0.0
    for _ in range(25):
        (P, L), places, centre = body.momentum, rest + body.stepper.point_displacement(), body.pose.position
        body.step(np.zeros(0))
        contact = body.stepper.contact
        forces = np.zeros(rest.shape) if contact is None else contact.forces
        most = max(most, np.abs(forces).max())
        held = np.zeros(3) if body.base_wrench is None else body.base_wrench[0]
        np.testing.assert_allclose(body.momentum[0] - P, h * (weight + forces.sum(axis=0) + held), atol=1e-13)
        if supports is None:
            arms = (places + rest + body.stepper.point_displacement() - centre - body.pose.position) / 2
            np.testing.assert_allclose(body.momentum[1] - L, h * np.cross(arms, forces).sum(axis=0), atol=1e-13)
    assert most > 0.5


def test_errors_of_a_finger_that_is_swung_on_a_floor_fall_with_the_order(mesh):
    """Forces of the floor, what strains the finger, and what the base feels, against full order at the same step."""
    system = fr.assemble(scene_of(mesh, CARRIED, run="dt = 1e-3\nduration = 0.12\nsnapshots = 25"))
    signals = {"base_path": swung}
    full = fr.simulate(system, signals=signals)
    assert full.balance_error <= 1e-11
    assert full.forces["floor"].any()
    names = "elastic shape", "impulse of floor", "base torque"
    errors = []
    for order in (4, 8, 24):
        differences = fr.compare(fr.simulate(fr.reduce(system, order=order), signals=signals), full)
        errors.append([differences[name].relative for name in names])
    assert (np.diff(errors, axis=0) < 0.1 * np.array(errors[0])).all()  # what slips elsewhere makes
    assert (np.array(errors[2]) < np.array(errors[0]) / 3).all()


def test_a_thrown_body_is_that_of_large_deformation(mesh):
    """Small strains in a moving frame, and large ones in the world: in flight and on the floor, both at full order."""
    run = "dt = 2e-3\nduration = 0.1\nsnapshots = 10\ninitial = { spin = [1.0, 2.0, 3.0], velocity = [0.1, 0.0, -0.3] }"
    parts = {"contacts": SURFACES, "supports": None, "run": run, "effects": FLOOR}
    parts["material"] = "young = 5e6\npoisson = 0.4\ndensity = 1100.0"
    large = FLOOR + '\nlarge_deformation = { material = "st_venant_kirchhoff" }'
    linear = fr.simulate(parse_scene('frame = "moving"\n' + scene_text(mesh, **parts)))
    full = fr.simulate(parse_scene(scene_text(mesh, **parts | {"effects": large})))
    differences = fr.compare(linear, full)
    assert full.forces["floor"].any()
    assert not full.warnings  # of parts: a residual that grows where contact begins is no divergence
    assert max(linear.balance_error, full.balance_error) <= 1e-11
    assert differences["shape"].relative < 0.01
    assert differences["elastic shape"].relative < 0.1
    assert differences["impulse of floor"].relative < 2e-3


def test_a_step_that_is_taken_back_leaves_nothing(systems):
    body = begun(systems[None], 2e-3)
    while not body.obstacle_forces().any():
        body.step(np.zeros(0))
    before = body.displacement(), body.velocity(), body.energy, body.ledger.contact, body.obstacle_forces()
    body.step(np.zeros(0))
    assert np.abs(body.displacement() - before[0]).max() > 1e-6
    body.stepper.rollback()
    after = body.displacement(), body.velocity(), body.energy, body.ledger.contact, body.obstacle_forces()
    for ours, kept in zip(after, before, strict=True):
        np.testing.assert_array_equal(ours, kept)


def test_a_body_that_begins_in_an_obstacle_is_refused(mesh):
    """Where it is placed, not where its mesh is."""
    deep = "dt = 1e-3\nduration = 0.01\ninitial = { rotation = [0.0, 1.0, 0.0] }"
    with pytest.raises(StepError, match=r"use a start outside of all obstacles, but .* inside 'floor'"):
        fr.simulate(scene_of(mesh, run=deep))
