"""Valves of bodies that move: a stiff chamber fills as choked air flows, and all ways to take steps are one."""

import math

import numpy as np
import pytest
from bodies import hollow_box, scene_text

import fenics_rom as fr
from fenics_rom.fem.simulator import FullOrderSimulator
from fenics_rom.mechanics.filling import GAS_CONSTANT, HEATS
from fenics_rom.mechanics.gas import AIR, ATMOSPHERE
from fenics_rom.scene.file import parse_scene
from fenics_rom.world.shapes import Box

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
DT, SUPPLY, AREA, STEPS = 1e-3, 3e5, 1e-7, 12
VALVE = f'surface = "chamber"\ncontrol = "valve"\nvalve = {{ area = {AREA}, discharge = 0.6 }}'
STRAINS = {"small": {}, "large": {"effects.large_deformation": 'material = "neo_hookean"'}}
FRAMES = pytest.mark.parametrize("frame", ["held", "carried", "free"])
STRAINED = pytest.mark.parametrize("strains", STRAINS)


@pytest.fixture(scope="module")
def box(tmp_path_factory):
    return hollow_box(tmp_path_factory.mktemp("hollow"))


def system_of(box, frame, strains, young):
    text = scene_text(
        box,
        supports=None if frame == "free" else 'clamped = ["left"]',
        material=f"young = {young}\npoisson = 0.3\ndensity = 1000.0",
        damping="beta = 1e-3",
        contacts='[contacts.right]\nsurface = "right"',
        **{"effects.pressure.air": VALVE, "effects.gravity": "acceleration = [0.0, 0.0, -9.81]"},
        **STRAINS[strains],
        run=f'dt = {DT}\nduration = {STEPS * DT}\nload = [{{ actuator = "air", force = [{SUPPLY}] }}]',
    )
    return fr.assemble(parse_scene('frame = "moving"\n' * (frame != "held") + text))


def reduced(system):
    method = {} if system.deformation is None else {"method": "modal+derivatives"}
    return fr.reduce(system, order=10, **method)


def missed(body, start, turnover):
    ledger = body.ledger
    gone = ledger.dissipated + ledger.numerical + ledger.lost_in_switching
    return abs(body.energy - start - ledger.supplied + gone) / turnover


def turning(body):
    """Puts a free body where it turns."""
    if body.rom.moving_frame is not None and not body.rom.moving_frame.carried:
        body.place(body.pose._replace(angular_velocity=np.array([3.0, 1.0, 2.0])))


@STRAINED
@FRAMES
@pytest.mark.parametrize("model", ["full", "reduced"])
def test_a_stiff_chamber_fills_as_choked_air_flows(box, frame, strains, model):
    """dV/dt = C A √(R T) p_s/p_a √k (2/(k + 1))^((k + 1)/(2 (k - 1))), constant while choked; p = p_a V/3 cm³."""
    system = system_of(box, frame, strains, 1e10)
    if model == "full":
        body = FullOrderSimulator(system, DT, system.scene.environment)
    else:
        body = fr.Simulator(reduced(system), DT)
        turning(body)
    start, turnover, amounts, pressures = body.energy, 0.0, [], []
    for _ in range(STEPS):
        body.step(np.array([0.0, 0.0, 0.0, SUPPLY]))
        amounts.append(body.gas["air"])
        pressures.append(body.reactions["air"])
        turnover = max(turnover, abs(body.energy), abs(body.ledger.supplied))
        assert missed(body, start, turnover) <= 1e-12
    choked = math.sqrt(HEATS) * (2 / (HEATS + 1)) ** ((HEATS + 1) / (2 * (HEATS - 1)))
    rate = 0.6 * AREA * math.sqrt(GAS_CONSTANT * AIR) * (1 + SUPPLY / ATMOSPHERE) * choked
    np.testing.assert_allclose(amounts, rate * DT * np.arange(1, STEPS + 1), rtol=1e-9)
    np.testing.assert_allclose(pressures, ATMOSPHERE * np.array(amounts) / 3e-6, rtol=1e-4)


@STRAINED
@FRAMES
def test_all_ways_to_take_steps_are_one(box, frame, strains):
    """Of a soft body: rollouts and batches are steps, runs are full order's, and worlds have the same gas."""
    system = system_of(box, frame, strains, 2e6)
    rom = reduced(system)
    single, rolled, batch = fr.Simulator(rom, DT), fr.Simulator(rom, DT), fr.Batch(rom, 2, DT)
    u = np.zeros((STEPS, single.inputs))
    u[:, -1] = SUPPLY
    for row in u:
        single.step(row)
        batch.step(np.array([row, 0 * row]))
    rolled.rollout(u)
    for other in (rolled.energy, batch.energy[0]):
        assert other == pytest.approx(single.energy, rel=1e-13)
    assert rolled.gas["air"] == pytest.approx(single.gas["air"], rel=1e-13)
    assert batch.reactions["air"][0] == pytest.approx(single.reactions["air"], rel=1e-12)
    again = fr.Simulator(rom, DT)
    again.restore(single.save())
    for body in (single, again):
        body.step(u[0])
    assert again.energy == single.energy
    full, run = fr.simulate(system), fr.simulate(rom)
    for trajectory in (full, run):
        assert trajectory.balance_error <= 1e-12
    assert run.reactions["air"][-1] == pytest.approx(full.reactions["air"][-1], rel=5e-3)
    cube = fr.RigidBody(Box((0.02, 0.02, 0.02)), mass=0.01, position=(0.2, 0.0, 0.0))
    bodies, apart = {"soft": fr.SoftBody(rom), "cube": cube}, ()
    if frame == "carried":
        still = fr.BaseState((0, 0, 0), (1, 0, 0, 0), (0, 0, 0), (0, 0, 0))
        bodies |= {"soft": fr.SoftBody(rom, on="hand"), "hand": fr.RigidBody(Box((0.02, 0.02, 0.02)), motion=still)}
        apart = [("soft", "hand")]
    world = fr.World(bodies, DT, apart=apart, gravity=(0, 0, -9.81))
    start, soft = world.energy, world.simulator("soft")
    for row in u:
        world.step({"soft": {"air": row[-1]}})
    account = world.ledger
    size = max(world.energy, abs(account.supplied))
    assert abs(world.energy - start - account.supplied + account.dissipated) <= 1e-12 * size
    assert soft.gas["air"] == pytest.approx(rolled.gas["air"], rel=1e-9)
    assert soft.reactions["air"] == pytest.approx(rolled.reactions["air"], rel=1e-9)
