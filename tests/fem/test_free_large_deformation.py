"""A free body that deforms largely, at full order in its moving frame: exact laws, and what the frame is."""

import numpy as np
import pytest
from bodies import box_arrays, scene_text, write_arrays

import fenics_rom as fr
from fenics_rom.fem.simulator import FullOrderSimulator
from fenics_rom.mechanics.frame_motion import rotation_matrix
from fenics_rom.scene.file import parse_scene

EFFECTS = """inertia = {}
[effects.damping]
alpha = 4.0
beta = 2e-3
[effects.gravity]
acceleration = [0.0, 0.0, -9.81]
[effects.prescribed.push]
point = [0.3, 0.03, 0.02]
"""
TIES = """[effects.springs.bed]
surface = "bottom"
stiffness = 0.05
[effects.damping.dashpots.oil]
surface = "right"
coefficient = 0.003
"""
LARGE = "[effects.large_deformation]\n"


@pytest.fixture(scope="module")
def mesh(tmp_path_factory):
    return write_arrays(tmp_path_factory.mktemp("free") / "beam.msh", *box_arrays((0.3, 0.03, 0.02), (4, 1, 1)))


def assembled(mesh, effects, **parts):
    """A soft beam that nothing holds."""
    parts = {"material": "young = 5e5\npoisson = 0.4\ndensity = 1100.0", "supports": None} | parts
    contacts = '[contacts.tip]\nsurface = "right"\nforce = "wrench"'
    return fr.assemble(
        parse_scene('frame = "moving"\n' + scene_text(mesh, effects=effects, contacts=contacts, **parts))
    )


def thrown(spin=(0.0, 1.0, 2.0)):
    return fr.BaseState(np.ones(3), np.array([0.8, 0.6, 0.0, 0.0]), np.array([0.1, 0.2, 0.3]), np.array(spin))


def run(system, dt, steps, size, signals):
    """Under a force and a torque on the tip, that turn with it, in the first half, and one in world axes."""
    body = FullOrderSimulator(system, dt, system.scene.environment, signals)
    body.stepper.place(thrown())
    u = size * np.array([0.0, 0.02, 0.05, 0.001, 0.0, 0.002])
    for step in range(steps):
        body.step(u if 2 * step < steps else 0 * u)
    return body


@pytest.mark.parametrize("ties", ["", TIES])
def test_small_strains_are_those_of_the_linear_body_in_its_frame(mesh, ties):
    """Two ways to step: in world axes, and in the frame. Shapes differ by what small strains leave out, 1e-4."""
    found = []
    for effects in (EFFECTS + ties, EFFECTS + ties + LARGE):
        signals = {"push": np.array([0.0, 0.002, 0.001])}
        found.append(run(assembled(mesh, effects), 1e-3, 80, 0.02, signals))
    small, large = found
    bent = np.abs(small.stepper.shape).max()
    assert bent > 1e-6
    np.testing.assert_allclose(large.stepper.shape, small.stepper.shape, rtol=0, atol=2e-3 * bent)
    np.testing.assert_allclose(large.displacement(), small.displacement(), rtol=0, atol=1e-7)
    for ours, others in zip((*large.momentum, *large.pose), (*small.momentum, *small.pose), strict=True):
        np.testing.assert_allclose(ours, others, rtol=1e-5, atol=1e-8)
    np.testing.assert_allclose(large.ledger.dissipated, small.ledger.dissipated, rtol=1e-2)


def test_momenta_stay_and_the_account_closes_however_far_it_bends(mesh):
    """A material that damps the motion in its frame takes nothing of that as a whole; round-off of a dozen steps."""
    system = assembled(mesh, EFFECTS + LARGE, degree=2)
    body = run(system, 5e-3, 20, 80.0, {"gravity": 0.0, "push": np.zeros(3)})
    assert np.abs(body.stepper.shape).max() > 0.03  # a tenth of its length
    before, energy, booked = body.momentum, body.energy, body.ledger.sums
    lost = body.ledger.dissipated
    for _ in range(12):
        body.step(np.zeros(6))
    for was, now in zip(before, body.momentum, strict=True):
        np.testing.assert_allclose(now, was, rtol=0, atol=1e-11 * np.linalg.norm(was))
    assert body.ledger.dissipated > lost
    assert abs(body.energy - energy + body.ledger.dissipated - lost) <= 1e-11 * energy
    assert booked != body.ledger.sums


def test_frame_has_no_momentum_of_its_own(mesh):
    """Σ M X × Rᵀ(x - p) = 0 and Σ M (x - p) = 0; a shape that is put back is the same, and so is one stepped back."""
    system = assembled(mesh, EFFECTS + LARGE, degree=2)
    body = run(system, 5e-3, 20, 80.0, {"push": np.zeros(3)})
    stepper, frame = body.stepper, system.moving_frame
    pose, R = body.pose, rotation_matrix(body.pose.rotation)
    arms = (body.displacement() + system.body.nodes - pose.position) @ R
    np.testing.assert_allclose(frame.mass_times[:, 0] @ arms, 0.0, atol=1e-15)
    np.testing.assert_allclose(np.cross(frame.mass_times[:, 1:], arms).sum(axis=0), 0.0, atol=1e-15)
    np.testing.assert_allclose(stepper.shape, arms - frame.arms, rtol=0, atol=1e-14)
    there, v, energy = body.displacement(), body.velocity(), body.energy
    stepper.place(pose)
    np.testing.assert_allclose(body.displacement(), there, rtol=0, atol=1e-13)
    np.testing.assert_allclose(body.velocity(), v, rtol=0, atol=1e-12)
    assert body.energy == pytest.approx(energy, rel=1e-12)
    there, energy = body.displacement(), body.energy
    body.step(np.zeros(6))
    stepper.rollback()
    np.testing.assert_array_equal(body.displacement(), there)
    assert body.energy == energy


def test_rigid_body_that_spins_about_a_main_axis_goes_on(mesh):
    """A stiff one, by 2 rad/s for a second and a half turn, thrown and falling."""
    stiff = "young = 5e9\npoisson = 0.4\ndensity = 1100.0"
    system = assembled(mesh, EFFECTS + LARGE, material=stiff)
    body = FullOrderSimulator(system, 1e-2, system.scene.environment, {"push": np.zeros(3)})
    start = fr.BaseState(np.zeros(3), np.array([1.0, 0, 0, 0]), np.array([0.5, 0.0, 1.0]), np.array([0.0, 0.0, 2.0]))
    body.stepper.place(start)
    for _ in range(100):
        body.step(np.zeros(6))
    pose = body.pose
    np.testing.assert_allclose(pose.position, [0.5, 0.0, 1.0 - 9.81 / 2], atol=1e-6)
    np.testing.assert_allclose(pose.rotation, [np.cos(1.0), 0.0, 0.0, np.sin(1.0)], atol=2e-4)  # h² ω³ t/24
    np.testing.assert_allclose(pose.angular_velocity, [0.0, 0.0, 2.0], atol=1e-3)


@pytest.mark.parametrize("ties", ["", TIES])
def test_run_of_a_scene_has_its_frame(mesh, ties):
    text = 'dt = 5e-3\nduration = 0.1\ninitial = { spin = [0, 0, 3] }\n[[run.load]]\ncontact = "tip"\n'
    text += "force = [0, 0, 0.1, 0, 0, 0]"
    system = assembled(mesh, EFFECTS.replace("push]", "push]\nforce = [0.0, 0.0, 0.0]") + ties + LARGE, run=text)
    told = fr.simulate(system)
    assert told.pose.shape == (21, 7)
    assert told.balance_error < 1e-11
    assert "nothing holds the body, which deforms largely" in str(told.stepping) or told.stepping == ""
