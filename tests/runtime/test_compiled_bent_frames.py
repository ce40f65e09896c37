"""Compiled steps of bodies in moving frames that deform largely: NumPy's motion, account and wrench."""

import pickle
import warnings
from dataclasses import replace

import numpy as np
import pytest
from bodies import box_arrays, scene_text, write_arrays
from soft_rom import in_frame, soft_rom
from test_compiled_frames import assert_same, both, history, start, told

import fenics_rom as fr
from fenics_rom.compilation import compiled
from fenics_rom.errors import StepError
from fenics_rom.mechanics.viscoelasticity import PronySeries
from fenics_rom.scene.file import parse_scene

pytestmark = [
    pytest.mark.skipif(not compiled(), reason="numba is not installed, or turned off"),
    pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning"),
]
LAWS = "st_venant_kirchhoff", "neo_hookean"
FRAMES = pytest.param("free", marks=pytest.mark.slow), "carried"  # each takes half a minute to compile
DT, STEPS = 1e-3, 60  # s
SCALES = {"rope": 0.05, "air": 40.0}  # N and Pa
EFFECTS = {
    "damping": "alpha = 0.5\nbeta = 2e-4",
    "inertia": "",
    "gravity": "acceleration = [0.0, 0.0, -9.81]",
    "prescribed.push": "point = [0.3, 0.03, 0.02]\nforce = [1e-3, 0.0, 2e-3]",
    "tendon.rope": "points = [[0.0, 0.015, 0.004], [0.15, 0.015, 0.002], [0.3, 0.015, 0.004]]",
    "pressure.air": 'surface = "top"',  # which is open
}
TOUCHED = {
    "contact": "",
    "friction": "coefficient = 0.4",
    "contact.obstacles.floor": 'shape = "half-space"\npoint = [0.0, 0.0, -4e-4]\nnormal = [0.0, 0.0, 1.0]',
}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """ROMs of a beam by frame and law, and whether a floor is below it."""
    mesh, roms = (
        write_arrays(tmp_path_factory.mktemp("bent") / "box.msh", *box_arrays((0.3, 0.03, 0.02), (6, 1, 1))),
        {},
    )

    def rom(frame, law, touched=False):
        if (frame, law, touched) not in roms:
            effects = {**EFFECTS, "large_deformation": f'material = "{law}"', **(TOUCHED if touched else {})}
            text = scene_text(
                mesh,
                material="young = 5e5\npoisson = 0.4\ndensity = 1100.0",
                supports=None if frame == "free" else 'clamped = ["left"]',
                contacts='[contacts.bottom]\nsurface = "bottom"\n',
                effects="",
                run='dt = 1e-3\nduration = 2e-3\n[[run.load]]\nactuator = "rope"\nforce = [0.1]',
                **{"outputs.all": "points = [[0.3, 0.03, 0.02]]"},
                **{f"effects.{name}": of for name, of in effects.items()},
            )
            system = fr.assemble(parse_scene(f'frame = "moving"\n{text}'))
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                roms[frame, law, touched] = fr.reduce(system, order=6, method="modal+derivatives")
        return roms[frame, law, touched]

    return rom


def moves(body, seed, steps=STEPS):
    """Tensions and pressures that change every few steps, and bases."""
    random = np.random.default_rng(seed)
    sizes = np.abs(random.standard_normal((steps // 5, len(SCALES)))) * [SCALES[name] for name in body.rom.actuators]
    return sizes.repeat(5, axis=0) * (np.arange(steps) % 20 < 15)[:, None], history(body, seed)[1][:steps]


def run(bodies, seed, steps=STEPS):
    """Sets bodies on their way, and steps them."""
    for body in bodies:
        start(body, seed)
    inputs, bases = moves(bodies[0], seed, steps)
    for u, base in zip(inputs, bases, strict=True):
        for body in bodies:
            body.step(u, base=base)


def assert_account_closes(body, first):
    account = body.ledger
    scale = max(first, body.energy, abs(account.supplied), account.dissipated)
    assert abs(body.energy - first - account.supplied + account.dissipated) <= 1e-12 * scale


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("frame", FRAMES)
def test_motion_account_and_wrench_are_those_of_numpy(made, frame, law):
    """With what is noted of a run."""
    bodies = both(made(frame, law), DT, stepper="linearly-implicit")
    for body in bodies:
        start(body, 1)
    first = bodies[0].energy
    run(bodies, 1)
    assert_same(*bodies)
    assert_account_closes(bodies[0], first)
    notes, expected = (body.integrator.kernel.notes for body in bodies)
    assert notes.keys() == expected.keys()
    for name, value in expected.items():
        assert abs(notes[name] - value) <= 1e-8 * abs(value) + 1e-12, name


@pytest.mark.parametrize("law", LAWS)
def test_a_material_that_relaxes_moves_as_in_numpy(law):
    """On a base; with what its branches carry along."""
    rom = soft_rom(law, order=6)
    rom = replace(rom, environment=replace(rom.environment, viscoelasticity=PronySeries((0.5, 0.3), (0.03, 2e-4))))
    bodies = both(in_frame(rom), 2e-3, stepper="linearly-implicit")
    for k in range(STEPS):
        for body in bodies:
            body.step([0.0, 0.1 * np.sin(k / 5), 0.1, 2000.0, 1.0])
    for a, b in zip(*([*body.state, body.integrator.kernel.auxiliary] for body in bodies), strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-10 * np.abs(b).max())
    assert_account_closes(bodies[0], 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("frame", FRAMES)
def test_rollouts_are_steps_and_a_restored_state_goes_on_to_the_bit(made, frame):
    rom = made(frame, LAWS[1])
    body, rolled = (fr.Simulator(rom, DT, stepper="linearly-implicit") for _ in range(2))
    for one in (body, rolled):
        start(one, 2)
    inputs, bases = moves(body, 2)
    for u, base in zip(inputs[:30], bases[:30], strict=True):
        body.step(u, base=base)
    rolled.rollout(inputs[:30], base=bases[:30] if rolled.is_carried else None)
    np.testing.assert_array_equal(np.concatenate(body.state), np.concatenate(rolled.state))
    assert rolled.integrator.kernel.notes == pytest.approx(body.integrator.kernel.notes, rel=1e-12)
    saved = body.save()
    other = pickle.loads(pickle.dumps(body))
    for one in (body, other):
        one.restore(saved)
        for u, base in zip(inputs[30:], bases[30:], strict=True):
            one.step(u, base=base)
    for a, b in zip(told(body), told(other), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("frame", FRAMES)
def test_numpy_and_loops_take_turns(made, frame):
    """Steps that are taken back, those that NumPy takes, and those that overflow, hand on what the others need."""
    one, other = both(made(frame, LAWS[0]), DT, stepper="linearly-implicit")
    loops, (inputs, bases) = one.integrator.kernel._compiled, moves(one, 3)
    take = loops.take
    for k, (u, base) in enumerate(zip(inputs, bases, strict=True)):
        loops.take = take if k % 4 else lambda *given: None
        for body in (one, other):
            if k % 7 == 0:
                body.step(3 * u, base=base)
                body.integrator.rollback()
                body.steps -= 1
            if k == 20:
                with np.errstate(all="ignore"), pytest.raises(StepError):
                    body.step(np.full(body.inputs, 1e300)[-2:], base=base)
            body.step(u, base=base)
    states = [np.concatenate(body.state) for body in (one, other)]
    np.testing.assert_allclose(*states, rtol=0, atol=1e-7 * np.abs(states[1]).max())  # T is found anew at other times


@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("frame", FRAMES)
def test_among_obstacles_motion_and_forces_are_those_of_numpy(made, frame, law):
    """A beam that falls on the floor, or that its base holds over it."""
    bodies = both(made(frame, law, touched=True), DT, stepper="linearly-implicit")
    touching, first = 0, bodies[0].energy
    for k in range(STEPS):
        u = np.array([SCALES[name] for name in bodies[0].rom.actuators]) * (k % 20 < 10)
        for body in bodies:
            body.step(u)
        forces, expected = (body.contact_forces() for body in bodies)
        np.testing.assert_allclose(forces, expected, rtol=0, atol=1e-9 * max(np.abs(expected).max(), 1.0))
        touching += bool(expected.any())
    assert touching > STEPS // 4
    assert_same(*bodies)
    assert_account_closes(bodies[0], first)


@pytest.mark.slow
@pytest.mark.parametrize("frame", FRAMES)
def test_rollouts_among_obstacles_are_steps(made, frame):
    """To the bit, with forces and what is noted; and so are steps after them."""
    rom = made(frame, LAWS[1], touched=True)
    body, rolled = (fr.Simulator(rom, DT, stepper="linearly-implicit") for _ in range(2))
    inputs = np.array([SCALES[name] for name in rom.actuators]) * (np.arange(STEPS) % 20 < 10)[:, None]
    for u in inputs:
        body.step(u)
    calls, kernel = [], rolled.integrator.kernel
    roll = kernel.roll
    kernel.roll = lambda *given: calls.append(len(given[0])) or roll(*given)
    rolled.rollout(inputs[:45])
    assert sum(calls) >= 45 - 2  # all but the first one and the last one
    for u in inputs[45:]:
        rolled.step(u)
    for a, b in zip(body.state, rolled.state, strict=True):
        np.testing.assert_array_equal(a, b)
    assert_same(rolled, body)
    np.testing.assert_array_equal(rolled.contact_forces(), body.contact_forces())
    assert body.contact_forces().any()
    assert rolled.integrator.kernel.notes == pytest.approx(body.integrator.kernel.notes, rel=1e-12)
    sums = np.array([[total for total, _ in one.ledger.sums] for one in (body, rolled)])
    np.testing.assert_allclose(*sums, rtol=0, atol=1e-12 * np.abs(sums).max())


@pytest.mark.parametrize("frame", FRAMES)
def test_bodies_of_a_batch_are_single_ones_to_the_bit(made, frame):
    rom = made(frame, LAWS[0])
    batch, bodies = fr.Batch(rom, 3, DT), [fr.Simulator(rom, DT, stepper="linearly-implicit") for _ in range(3)]
    assert batch.stepping == "compiled"
    for k, body in enumerate(bodies if frame == "free" else []):
        pose = body.pose._replace(velocity=np.ones(3), angular_velocity=np.array([1.0, k, 2.0]))
        body.place(pose)
        batch.place(pose, [k])
    scales = np.array([0.0, 0.0, 0.0, *(SCALES[name] for name in rom.actuators)])
    for u in np.abs(np.random.default_rng(4).standard_normal((20, 3, 5))) * scales:
        batch.step(u)
        for body, own in zip(bodies, u, strict=True):
            body.step(own)
    np.testing.assert_array_equal(batch.state()[0], [body.state[0] for body in bodies])
