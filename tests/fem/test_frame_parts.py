"""Full-order bodies in moving frames, of any parts: what is pulled by strokes, rubs, relaxes and touches."""

import numpy as np
import pytest
from bodies import box_arrays, scene_text, write_arrays

import fenics_rom as fr
from fenics_rom.fem.simulator import FullOrderSimulator
from fenics_rom.scene.file import parse_scene

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")

LENGTHS = (0.3, 0.03, 0.02)
GUIDED = "points = [[0.0, 0.015, 0.0], [0.15, 0.015, 0.004], [0.3, 0.015, 0.0]]"
FLOOR = 'shape = "half-space"\npoint = [0.0, 0.0, -0.002]\nnormal = [0.0, 0.0, 1.0]'
PARTS = {
    "stroke": {"tendon.rope": f'{GUIDED}\ncontrol = "length"'},
    "guides": {"tendon.rope": GUIDED, "tendon_friction": "coefficient = 0.3"},
    "volume": {"pressure.air": 'surface = "top"\ncontrol = "volume"'},
    "relaxing": {"viscoelasticity": "ratios = [0.5, 0.3]\ntimes = [0.02, 0.2]", "tendon.rope": GUIDED},
    "touched": {
        "tendon.rope": f'{GUIDED}\ncontrol = "length"',
        "tendon_friction": "coefficient = 0.2",
        "viscoelasticity": "ratios = [0.5]\ntimes = [0.05]",
        "springs.bed": 'surface = "top"\nstiffness = 8.0',
        "friction": "coefficient = 0.4",
        "contact.obstacles.floor": FLOOR,
    },
}
AMPLITUDE = {"stroke": 1e-3, "guides": 2.0, "volume": 1e-7, "relaxing": 2.0, "touched": 1e-3}
GRAVITY = {"gravity": "acceleration = [0.0, 0.0, -9.81]"}
CARRIED = 'clamped = ["left"]'


def system_of(folder, parts, supports):
    mesh = write_arrays(folder / "beam.msh", *box_arrays(LENGTHS, (4, 1, 1)))
    named = {f"effects.{name}": text for name, text in (GRAVITY | parts).items()}
    text = scene_text(
        mesh,
        supports=supports,
        material="young = 5e5\npoisson = 0.4\ndensity = 1100.0",
        damping="alpha = 0.5, beta = 2e-4",
        contacts='[contacts.bottom]\nsurface = "bottom"',
        **named,
    )
    return fr.assemble(parse_scene(f'frame = "moving"\n{text}'))


def swung(time):
    """A base that swings about an oblique axis."""
    angle, rate, axis = 0.12 * np.sin(12 * time), 1.44 * np.cos(12 * time), np.array([0.0, 0.8, 0.6])
    rotation = np.array([np.cos(angle / 2), *(np.sin(angle / 2) * axis)])
    return fr.BaseState(np.array([0.0, 0.01 * time, 0.0]), rotation, np.array([0.0, 0.01, 0.0]), rate * axis)


def tumbling(origin):
    q = np.array([1.0, 0.05, 0.02, 0.0])
    return fr.BaseState(
        np.add(origin, [0.0, 0.0, 0.008]), q / np.linalg.norm(q), np.array([0.2, 0.1, -0.3]), np.array([1.0, 2.0, 2.0])
    )


CASES = [(name, supports) for name in PARTS for supports in (None, CARRIED) if (name, supports) != ("volume", None)]


@pytest.mark.parametrize(("name", "supports"), CASES)
def test_reduced_in_all_modes_is_full_order(tmp_path, name, supports):
    """Two programs of the same parts: shapes, forces that are found, the base's wrench; and their accounts close."""
    system, dt = system_of(tmp_path, PARTS[name], supports), 2e-3
    rom = fr.reduce(system, order=system.elastic_size, method="modal")
    signals = {"base_path": swung} if supports else {}
    full, reduced = (
        FullOrderSimulator(system, dt, system.scene.environment, signals),
        fr.Simulator(rom, dt, signals=signals),
    )
    start = swung(0.0) if supports else tumbling(system.moving_frame.origin)
    full.stepper.place(start)
    reduced.place(start)
    before, turnover, touched = full.energy, 0.0, 0
    near = 5e-8 if name == "touched" else 1e-12  # m: contact and strokes are found by turns, to 1e-9 of forces
    columns = system.contacts["bottom"].shape[1] * ("floor" not in full.environment.obstacles)
    for step in range(30):
        u = np.array([*np.zeros(columns), AMPLITUDE[name] * np.sin((step + 1) * dt / 0.03) ** 2])
        for body in (full, reduced):
            body.step(u)
        turnover = max(turnover, abs(full.energy), abs(full.ledger.supplied))
        touched += bool(full.obstacle_forces().any())
        np.testing.assert_allclose(reduced.displacement(), full.displacement(), rtol=0, atol=near)
    assert np.abs(full.stepper.shape).max() > 1e-4
    assert (touched > 5) == (name == "touched")
    stiff = 0.2 * near / dt**2  # N: what moves 0.2 kg by so little in a step
    for actuator, found in full.reactions.items():
        assert abs(reduced.reactions[actuator] - found) <= stiff + 1e-10 * abs(found)
    if supports:  # forces turn with it, by twists that fit its poses to 1e-7
        size = np.abs(full.base_wrench).max()
        np.testing.assert_allclose(reduced.base_wrench, full.base_wrench, rtol=0, atol=stiff + 1e-6 * size)
    account = full.ledger
    assert account.dissipated > 1e-6
    assert abs(full.energy - before - account.supplied + account.dissipated) <= 1e-12 * turnover
