"""Compiled steps in moving frames with strokes, guides, gas and valves: NumPy's motion, forces and account."""

import warnings
from functools import partial

import numpy as np
import pytest
from bodies import hollow_box, scene_text
from test_compiled_frames import history, start

import fenics_rom as fr
from fenics_rom.compilation import compiled, numpy_alone
from fenics_rom.scene.file import parse_scene

pytestmark = [
    pytest.mark.skipif(not compiled(), reason="numba is not installed, or turned off"),
    pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning"),
]
SMALL, LARGE = "", 'material = "st_venant_kirchhoff"'
slow = partial(pytest.param, marks=pytest.mark.slow)  # each takes half a minute to compile
KINDS = pytest.mark.parametrize(
    ("frame", "law"),
    [
        pytest.param("carried", SMALL, id="carried, small"),
        slow("carried", LARGE, id="carried, large"),
        slow("free", SMALL, id="free, small"),
        slow("free", LARGE, id="free, large"),
    ],
)
DT, STEPS = 1e-3, 60  # s
GUIDED = "[[0.0, 0.015, 0.004], [0.025, 0.015, {middle}], [0.05, 0.015, 0.004]]"
EFFECTS = {
    "damping": "alpha = 0.5\nbeta = 2e-4",
    "inertia": "",
    "gravity": "acceleration = [0.0, 0.0, -9.81]",
    "tendon_friction": "coefficient = 0.3",
    "tendon.rope": f'points = {GUIDED.format(middle=0.002)}\ncontrol = "length"',
    "tendon.wire": f"points = {GUIDED.format(middle=0.007)}",
    "pressure.air": 'surface = "chamber"\ncontrol = "gas"\ngas = { exponent = 1.4 }',
    "pressure.supply": "near = { point = [0, 0, 0], radius = 1.0 }\n"
    'control = "valve"\ngas = { volume = 1e-4 }\nvalve = { area = 1e-7 }',  # a bag around it
}
SIZES = {"rope": 2e-5, "wire": 0.1, "air": 1e-7, "supply": 1e3}  # m, N, m³ and Pa


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """ROMs of a box with a chamber by frame and law."""
    mesh, roms = hollow_box(tmp_path_factory.mktemp("hollow")), {}

    def rom(frame, law):
        if (frame, law) not in roms:
            effects = EFFECTS | ({"large_deformation": law} if law else {})
            text = scene_text(
                mesh,
                material="young = 5e5\npoisson = 0.4\ndensity = 1100.0",
                supports=None if frame == "free" else 'clamped = ["left"]',
                contacts='[contacts.right]\nsurface = "right"\n',
                effects="",
                run='dt = 1e-3\nduration = 2e-3\n[[run.load]]\nactuator = "wire"\nforce = [0.1]',
                **{f"effects.{name}": of for name, of in effects.items()},
            )
            system = fr.assemble(parse_scene(f'frame = "moving"\n{text}'))
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                roms[frame, law] = fr.reduce(system, order=6, method="modal+derivatives" if law else "modal")
        return roms[frame, law]

    return rom


def both(rom):
    """A body whose steps compiled functions take, which counts those that they do not, and one of NumPy."""
    named = {"stepper": "linearly-implicit"} if rom.deformation is not None else {}
    body, refused = fr.Simulator(rom, DT, **named), [0]
    loops = body.integrator.kernel._compiled
    take = loops.take

    def counted(*given):
        taken = take(*given)
        refused[0] += taken is None
        return taken

    loops.take = counted
    with numpy_alone():
        return body, fr.Simulator(rom, DT, **named), refused


def moves(body, seed):
    """What is given, which changes every few steps, and how a base moves."""
    random, shared = np.random.default_rng(seed), sum(body.rom.actuators.values())
    sizes = np.zeros((STEPS, body.inputs))
    changing = np.abs(random.standard_normal((STEPS // 5, shared))) * [SIZES[name] for name in body.rom.actuators]
    sizes[:, body.inputs - shared :] = changing.repeat(5, axis=0)
    sizes[:, : body.inputs - shared] = 1e-3 * random.standard_normal((STEPS, body.inputs - shared))
    return sizes, history(body, seed)[1][:STEPS]


@KINDS
def test_motion_forces_gas_and_account_are_those_of_numpy(made, frame, law):
    *bodies, refused = both(made(frame, law))
    for body in bodies:
        start(body, 1)
    first, turnover, taut = bodies[0].energy, bodies[0].energy, 0
    for u, base in zip(*moves(bodies[0], 1), strict=True):
        for body in bodies:
            body.step(u, base=base)
        forces = np.array([body.integrator.reactions for body in bodies])
        np.testing.assert_allclose(*forces, rtol=1e-9, atol=1e-9 * np.abs(forces[1]).max())
        taut, turnover = taut + (bodies[0].reactions["rope"] > 0), max(turnover, abs(bodies[0].ledger.supplied))
    one, other = bodies
    for found, expected in zip(*([*body.state, body.displacement()] for body in bodies), strict=True):
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10 * np.abs(expected).max())
    assert one.energy == pytest.approx(other.energy, rel=1e-10)
    assert one.gas == pytest.approx(other.gas, rel=1e-10)
    for pair in zip(one.pose, other.pose, strict=True):
        np.testing.assert_allclose(*pair, rtol=0, atol=1e-10)
    if frame == "carried":
        size = max(np.abs(part).max() for part in other.base_wrench)
        for pair in zip(one.base_wrench, other.base_wrench, strict=True):
            np.testing.assert_allclose(*pair, rtol=0, atol=1e-8 * size)
    account = one.ledger
    assert account.dissipated > 0
    assert abs(one.energy - first - account.supplied + account.dissipated) <= 1e-12 * max(turnover, one.energy)
    sums = np.array([[total for total, _ in body.ledger.sums] for body in bodies])
    np.testing.assert_allclose(*sums, rtol=0, atol=1e-10 * np.abs(sums).max())
    for name, value in other.integrator.kernel.notes.items():
        assert abs(one.integrator.kernel.notes[name] - value) <= 1e-8 * abs(value) + 1e-12, name
    assert refused[0] == 0
    assert 0 < taut < STEPS


@KINDS
def test_gradients_rollouts_and_restored_states_are_those_of_numpy(made, frame, law):
    """A rollout takes single steps; NumPy may take over after a compiled step, and the other way round."""
    one, other, _ = both(made(frame, law))
    u, _ = moves(one, 2)
    slopes = [fr.differentiate(body, u[:8], _height) for body in (one, other)]
    found, expected = (each.inputs for each in slopes)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-7 * np.abs(expected).max())
    rolled, stepped, swapped = (both(made(frame, law))[0] for _ in range(3))
    rolled.rollout(u[:10])
    loops = swapped.integrator.kernel._compiled
    take = loops.take
    for number, each in enumerate(u[:10]):
        loops.take = take if number % 2 else _take_none
        for body in (stepped, swapped):
            body.step(each)
    expected = np.concatenate(stepped.state)
    np.testing.assert_array_equal(np.concatenate(rolled.state), expected)
    # A free body that deforms largely expects a step by the one before, which whoever takes over does not know.
    near = 1e-7 if frame == "free" and law else 1e-10
    np.testing.assert_allclose(np.concatenate(swapped.state), expected, rtol=0, atol=near * np.abs(expected).max())
    again = both(made(frame, law))[0]
    again.restore(stepped.save())
    for body in (again, stepped):
        body.step(u[10])
    np.testing.assert_array_equal(np.concatenate(again.state), np.concatenate(stepped.state))
    assert again.gas == stepped.gas


def _take_none(*_given):
    """In place of what takes compiled steps."""


def _height(outputs, energies):
    """Of all that is stored at the end, and what it changes by."""
    slope = np.zeros_like(energies)
    slope[-1] = 1.0
    return float(energies[-1]), {}, slope
