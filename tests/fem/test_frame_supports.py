"""Rollers, planes of symmetry and rigid surfaces of bodies in moving frames: what supports tie goes with its base."""

import numpy as np
import pytest
from bodies import box_arrays, scene_text, write_arrays

import fenics_rom as fr
from fenics_rom.fem.simulator import FullOrderSimulator
from fenics_rom.scene.file import parse_scene

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")

ROLLER = '[[supports.held]]\nsurface = "front"\nnormal = '
SUPPORTS = {
    "along an axis": f'clamped = ["left"]\n{ROLLER}[0, 1, 0]',
    "oblique": f'clamped = ["left"]\n{ROLLER}[0.5, 1, 0.2]',
    "rigid end": 'clamped = ["left"]\nrigid = ["right"]',
    "rigid ends of what flies": 'rigid = ["left", "right"]',
}
FORCES = {
    "gravity": "acceleration = [0.0, 0.0, -9.81]",
    "tendon.rope": "points = [[0.0, 0.015, 0.0], [0.15, 0.015, 0.004], [0.3, 0.015, 0.0]]",
    "prescribed.push": "point = [0.3, 0.03, 0.02]\nforce = [1e-3, 2e-3, 1e-2]",
    "prescribed.beside": "point = [0.2, 0.0, 0.01]\nforce = [3e-3, 2e-2, 2e-3]",  # on the roller
}
FLOOR = {
    "friction": "coefficient = 0.4",
    "contact.obstacles.floor": 'shape = "half-space"\npoint = [0.0, 0.0, -0.002]\nnormal = [0.0, 0.0, 1.0]',
}


def system_of(folder, supports, effects, frame="moving", inertia=True):
    mesh = write_arrays(folder / "beam.msh", *box_arrays((0.3, 0.03, 0.02), (4, 1, 1)))
    text = scene_text(
        mesh,
        supports=supports,
        material="young = 5e5\npoisson = 0.4\ndensity = 1100.0",
        damping="alpha = 0.5, beta = 2e-4",
        contacts='[contacts.bottom]\nsurface = "bottom"',
        **({} if inertia else {"effects": None}),
        **{f"effects.{name}": text for name, text in effects.items()},
    )
    return fr.assemble(parse_scene(f'frame = "{frame}"\n{text}'))


def swung(time):
    """A base that swings about an oblique axis."""
    angle, rate, axis = 0.12 * np.sin(12 * time), 1.44 * np.cos(12 * time), np.array([0.0, 0.8, 0.6])
    rotation = np.array([np.cos(angle / 2), *(np.sin(angle / 2) * axis)])
    return fr.BaseState(np.array([0.0, 0.01 * time, 0.0]), rotation, np.array([0.0, 0.01, 0.0]), rate * axis)


def bodies_of(system, dt=2e-3, stepper=None):
    """At full order, and reduced in all modes."""
    carried = system.moving_frame.carried
    rom = fr.reduce(system, order=system.elastic_size, method="modal")
    signals = {"base_path": swung} if carried else {}
    bodies = FullOrderSimulator(system, dt, system.scene.environment, signals), fr.Simulator(rom, dt, signals=signals)
    if not carried:
        q = np.array([0.8, 0.6, 0.0, 0.0])
        start = fr.BaseState(np.array([0.0, 0.1, 0.2]), q, np.array([0.2, 0.1, -0.3]), np.array([3.0, 4.0, 5.0]))
        bodies[0].stepper.place(start)
        bodies[1].place(start)
    return bodies


@pytest.mark.parametrize("touches", [False, True])
@pytest.mark.parametrize("name", SUPPORTS)
def test_reduced_in_all_modes_is_full_order(tmp_path, name, touches):
    """Shapes, momenta and the base's wrench, with what is tied where it is to be; the account closes."""
    if touches and "flies" in name:
        pytest.skip("it flies far from the floor")
    system = system_of(tmp_path, SUPPORTS[name], FORCES | (FLOOR if touches else {}))
    full, reduced = bodies_of(system)
    start, turnover, touched = full.energy, 0.0, 0
    columns = np.zeros(system.contacts["bottom"].shape[1] * (not touches))
    for step in range(25):
        for body in (full, reduced):
            body.step(np.array([*columns, 2.0 * np.sin(0.1 * step) ** 2]))
        turnover = max(turnover, abs(full.energy), abs(full.ledger.supplied))
        touched += bool(full.obstacle_forces().any())
        near = 1e-8 if touches else 1e-12
        np.testing.assert_allclose(reduced.displacement(), full.displacement(), rtol=0, atol=near)
    assert (touched > 5) == touches
    shape, nodes = full.stepper.shape, system.body.nodes
    assert np.abs(shape).max() > 1e-4
    if "oblique" in name or "axis" in name:
        normal = np.array([0.5, 1.0, 0.2] if name == "oblique" else [0.0, 1.0, 0.0])
        assert np.abs(shape[nodes[:, 1] == 0.0] @ normal).max() <= 1e-15
    else:
        right = nodes[:, 0] == nodes[:, 0].max()
        fields = np.concatenate([np.ones((right.sum(), 1)), nodes[right]], axis=1)
        left = shape[right] - fields @ np.linalg.lstsq(fields, shape[right], rcond=None)[0]
        assert np.abs(left).max() <= 1e-12 * np.abs(shape).max()
    for ours, others in zip(reduced.momentum, full.momentum, strict=True):
        np.testing.assert_allclose(ours, others, rtol=0, atol=1e-6 if touches else 1e-11)
    if full.base_wrench is not None:
        size = np.abs(full.base_wrench).max()
        np.testing.assert_allclose(
            reduced.base_wrench, full.base_wrench, rtol=0, atol=(1e-3 if touches else 1e-6) * size
        )
    account = full.ledger
    assert account.dissipated > 1e-9
    assert abs(full.energy - start - account.supplied + account.dissipated) <= 1e-12 * turnover


@pytest.mark.parametrize("inertia", [True, False])
@pytest.mark.parametrize("large", [False, True])
@pytest.mark.parametrize("name", [name for name in SUPPORTS if "flies" not in name])
def test_on_a_base_that_stands_it_is_a_held_body(tmp_path, name, large, inertia):
    """Of the same supports, reduced and at full order, among an obstacle."""
    if large and name != "along an axis":
        pytest.skip("supports of large deformation hold along an axis")
    effects = FORCES | FLOOR | ({"large_deformation": ""} if large else {})
    full = []
    for frame in ("moving", "fixed"):
        system = system_of(tmp_path, SUPPORTS[name], effects, frame, inertia)
        full.append(FullOrderSimulator(system, 2e-3, system.scene.environment))
    for step in range(20):
        for body in full:
            body.step(np.array([2.0 * np.sin(0.1 * step) ** 2]))
    assert full[0].obstacle_forces().any()
    scale = np.abs(full[1].stepper.shape).max()
    assert np.abs(full[0].stepper.shape - full[1].stepper.shape).max() <= 1e-8 * scale


def test_what_flies_with_rigid_ends_keeps_its_momenta(tmp_path):
    system = system_of(tmp_path, SUPPORTS["rigid ends of what flies"], {})
    full, reduced = bodies_of(system, 5e-3)
    for body in (full, reduced):
        momenta = body.momentum
        for _ in range(30):
            body.step(np.zeros(system.contacts["bottom"].shape[1]))
        for before, after in zip(momenta, body.momentum, strict=True):
            np.testing.assert_allclose(after, before, rtol=0, atol=1e-13 * np.linalg.norm(before))
    np.testing.assert_allclose(reduced.displacement(), full.displacement(), rtol=0, atol=1e-12)
