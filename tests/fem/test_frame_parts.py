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


def system_of(folder, parts, supports, frame="moving", inertia=True):
    mesh = write_arrays(folder / "beam.msh", *box_arrays(LENGTHS, (4, 1, 1)))
    named = {f"effects.{name}": text for name, text in (GRAVITY | parts).items()}
    how = {} if inertia else {"effects": None}
    text = scene_text(
        mesh,
        **how,
        supports=supports,
        material="young = 5e5\npoisson = 0.4\ndensity = 1100.0",
        damping="alpha = 0.5, beta = 2e-4",
        contacts='[contacts.bottom]\nsurface = "bottom"',
        **named,
    )
    return fr.assemble(parse_scene(f'frame = "{frame}"\n{text}'))


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


RESTING = {name: dict(parts) for name, parts in PARTS.items() if name != "relaxing"}  # an equilibrium is relaxed
RESTING["touched"].pop("viscoelasticity")
RESTING["tied"] = {"tendon.rope": GUIDED, "springs.bed": 'surface = "top"\nstiffness = 8.0'}


def pulled_at_rest(bodies, name, steps=20, dt=2e-3):
    """How far apart displacements are at most, how often it touches, and by how much the first account misses."""
    first, apart, touched, turnover = bodies[0], 0.0, 0, 0.0
    start = first.energy
    columns = first.system.contacts["bottom"].shape[1] * ("floor" not in first.environment.obstacles)
    for step in range(steps):
        u = np.array([*np.zeros(columns), AMPLITUDE.get(name, 1.0) * np.sin((step + 1) * dt / 0.02) ** 2])
        for body in bodies:
            body.step(u)
        touched += bool(first.obstacle_forces().any())
        turnover = max(turnover, abs(first.energy), abs(first.ledger.supplied))
        apart = max(apart, *(np.abs(body.displacement() - first.displacement()).max() for body in bodies))
    account = first.ledger
    missed = abs(first.energy - start - account.supplied + account.dissipated + account.numerical)
    return apart, touched, missed / turnover


@pytest.mark.parametrize("name", RESTING)
def test_a_body_without_inertia_is_in_balance_wherever_its_base_is(tmp_path, name):
    """Its account closes while the base moves, which bears all forces; on a base that stands it is one that is held."""
    system = system_of(tmp_path, RESTING[name], CARRIED, inertia=False)
    acting, weight = system.scene.environment, 9.81 * system.moving_frame.moments[0, 0]
    rom = fr.reduce(system, order=system.elastic_size, method="modal")
    moved = FullOrderSimulator(system, 2e-3, acting, {"base_path": swung})
    reduced = fr.Simulator(rom, 2e-3, signals={"base_path": swung})
    start = reduced.energy
    apart, touched, missed = pulled_at_rest([moved, reduced], name)
    assert (touched > 5) == (name == "touched")
    assert missed <= 1e-12
    assert apart <= 1e-9 * np.abs(moved.stepper.shape).max()
    np.testing.assert_allclose(reduced.base_wrench, moved.base_wrench, rtol=0, atol=1e-7 * weight)
    np.testing.assert_allclose(reduced.energy, moved.energy, rtol=1e-9)
    account, turnover = reduced.ledger, abs(reduced.ledger.supplied) + reduced.energy
    missed = reduced.energy - start - account.supplied + account.dissipated + account.numerical
    assert abs(missed) <= 1e-12 * turnover
    if system.moving_frame.springs is None and name != "volume":  # a pressure pushes the body as a whole
        others = moved.obstacle_forces().sum(axis=0) - [0.0, 0.0, weight]
        np.testing.assert_allclose(moved.base_wrench[0], -others, rtol=0, atol=1e-10 * weight)
    held = system_of(tmp_path, RESTING[name], CARRIED, "fixed", inertia=False)
    bodies = FullOrderSimulator(system, 2e-3, acting), FullOrderSimulator(held, 2e-3, held.scene.environment)
    apart, _, missed = pulled_at_rest(bodies, name)
    assert missed <= 1e-12
    assert apart <= 1e-9 * np.abs(bodies[0].stepper.shape).max()
