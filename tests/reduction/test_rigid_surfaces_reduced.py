"""Surfaces that stay rigid however far they turn, reduced: as long as they were, passive, and near full order."""

import numpy as np
import pytest
from bodies import box_arrays, box_surfaces, scene_text, write_arrays

import fenics_rom as fr
from fenics_rom.errors import SceneError
from fenics_rom.scene.file import parse_scene

SOFT = "young = 1e6\npoisson = 0.35\ndensity = 1000.0"
PUSH = '[contacts.right]\nsurface = "right"\nforce = "resultant"'
FLOOR = "gravity = { acceleration = [0, 0, -9.81] }\nfriction = { coefficient = 0.3 }\n"
FLOOR += '[effects.contact.obstacles.floor]\nshape = "half-space"\npoint = [0, 0, -0.01]\nnormal = [0, 0, 1]\n'
PULSE = 'dt = 5e-3\nduration = 0.3\n[[run.load]]\ncontact = "right"\nstop = 0.15\nforce = [0.0, 6.0, 36.0]\n'
FREE = PULSE.replace("[0.0, 6.0, 36.0]", "[0.2, 0.6, 2.0]")
RIGID = 5e-9  # of its size: ten times what iterated steps leave
ACCOUNT = 1e-9  # of the largest of what is stored, supplied and dissipated: ten times what they leave
pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")  # of what is not trained


@pytest.fixture(scope="module")
def beam(tmp_path_factory):
    """A beam with a hand, which is part of two of its faces."""
    points, cells = box_arrays((0.5, 0.05, 0.05), (4, 1, 1), shake=0.2)
    surfaces = box_surfaces(points, cells)
    top = surfaces["top"]
    surfaces["hand"] = np.concatenate([surfaces["right"], top[points[top][:, :, 0].min(axis=1) > 0.3]])
    return write_arrays(tmp_path_factory.mktemp("hand") / "beam.msh", points, cells, surfaces)


def system_of(beam, effects="", run=PULSE, head="", kind="inertia = {}\n", supports='clamped = ["left"]\n'):
    kind += "damping = { beta = 2e-3 }\n" if kind else ""
    effects = f"{kind}large_deformation = {{}}\n{effects}"
    parts = {"contacts": PUSH, "material": SOFT, "run": run, "outputs.tip": 'surface = "right"'}
    return fr.assemble(
        parse_scene(head + scene_text(beam, effects=effects, supports=f'{supports}rigid = ["hand"]', **parts))
    )


def rom_of(system, order=20):
    return fr.reduce(system, order=order, method="modal+derivatives")


@pytest.fixture(scope="module")
def rom(beam):
    """Of a load that turns the hand by more than 60 degrees."""
    return rom_of(system_of(beam))


def stretch_of(displacement, rom):
    """Largest change of a distance on the hand, as a share of its size."""
    x, _, z = rom.nodes.T
    on = (x > 0.5 - 1e-9) | ((x > 0.3) & (z > 0.05 - 1e-9))
    before, after = (np.linalg.norm(y[:, None] - y, axis=2) for y in (rom.nodes[on], (rom.nodes + displacement)[on]))
    return np.abs(after - before).max() / before.max()


def turn_of(displacement, rom):
    """Of the end, degrees."""
    end = rom.nodes[:, 0] > 0.5 - 1e-9
    rest, moved = rom.nodes[end], (rom.nodes + displacement)[end]
    normals = [np.cross(*(y[1:] - y[0])[:2]) for y in (rest, moved)]
    return np.degrees(np.arccos(normals[0] @ normals[1] / np.prod(np.linalg.norm(normals, axis=1))))


def run(body, inputs, steps):
    """Steps; the largest stretch and turn, and what the account lacks, as a share."""
    stretched = turned = lacking = scale = 0.0
    for step in range(steps):
        body.step(inputs(step))
        shape = body.displacement()
        ledger = body.ledger
        lack = body.energy - ledger.supplied + ledger.dissipated + ledger.numerical
        scale = max(scale, body.energy, abs(ledger.supplied), ledger.dissipated)
        stretched, lacking = max(stretched, stretch_of(shape, body.rom)), max(lacking, abs(lack))
        turned = max(turned, turn_of(shape, body.rom))
    return stretched, turned, lacking / scale


def pulse(step):
    return [0.0, 6.0, 36.0] if step < 30 else [0.0] * 3


def test_iterated_steps_keep_it_rigid_and_balance_energy(rom):
    body = fr.Simulator(rom, 5e-3, stepper="newton")
    stretched, turned, lacking = run(body, pulse, 60)
    assert turned > 60
    assert stretched <= RIGID
    assert lacking <= ACCOUNT


def test_linearly_implicit_steps_keep_it_as_far_as_they_know_where_they_lead(rom):
    """A half of the step leaves less than a quarter; energy balances all the same."""
    stretched = []
    for h in (2.5e-3, 1.25e-3):
        body = fr.Simulator(rom, h, stepper="linearly-implicit")
        stretch, _, lacking = run(
            body, lambda step, h=h: [0.0, 6.0, 36.0] if step * h < 0.15 else [0.0] * 3, round(0.3 / h)
        )
        stretched.append(stretch)
        assert lacking <= ACCOUNT
    assert stretched[0] <= 1e-3
    assert stretched[1] < stretched[0] / 4


def test_files_hold_its_bars_and_no_input_is_added(rom, tmp_path):
    fr.write_rom(tmp_path / "hand.h5", rom)
    again = fr.read_rom(tmp_path / "hand.h5")
    assert again == rom
    assert list(again.deformation.bars) == [f"rigid-1-bar-{k}" for k in range(1, 7)]
    bodies = [fr.Simulator(model, 5e-3, stepper="newton") for model in (rom, again)]
    for body in bodies:
        assert body.inputs == 3
        assert body.reactions == {}
        body.step([0.0, 6.0, 36.0])
    np.testing.assert_array_equal(*(body.displacement() for body in bodies))


def test_gradients_go_through_it(rom):

    def height(inputs):
        body = fr.Simulator(rom, 5e-3, stepper="newton")
        for u in inputs:
            body.step(u)
        return body.displacement("tip")[0, 2]

    inputs = np.array([[0.0, 6.0, 36.0]] * 12)
    body = fr.Simulator(rom, 5e-3, stepper="newton")
    taken = fr.differentiate(
        body, inputs, lambda outputs, energies: (outputs["tip"][-1, 0, 2], {"tip": last_height(outputs)}, None)
    )
    direction, ε = np.random.default_rng(0).standard_normal(inputs.shape), 1e-4
    slope = (height(inputs + ε * direction) - height(inputs - ε * direction)) / (2 * ε)
    assert (taken.inputs * direction).sum() == pytest.approx(slope, rel=1e-6)


def last_height(outputs):
    slopes = np.zeros(outputs["tip"].shape)
    slopes[-1, 0, 2] = 1.0
    return slopes


def test_an_order_that_leaves_nothing_beside_its_bars_is_refused(beam):
    with pytest.raises(SceneError, match=r"order = 6: supports.rigid take 6 of it; use more"):
        rom_of(system_of(beam), order=6)


def test_equilibria_turn_it(beam):
    system = system_of(
        beam, kind="", run='dt = 0.25\nduration = 1.0\n[[run.load]]\ncontact = "right"\nforce = [0.0, 2.0, 16.0]'
    )
    rom, full = rom_of(system), fr.simulate(system)
    body = fr.Simulator(rom, 0.25)
    body.step([0.0, 2.0, 16.0])
    assert turn_of(body.displacement(), rom) > 15
    assert stretch_of(body.displacement(), rom) <= RIGID
    assert fr.compare(fr.simulate(rom), full)["shape"].relative <= 0.02


def test_it_lands_and_rubs(beam):
    """With the residual compliance of contact points, which moves these by themselves, it is rigid but for that."""
    system = system_of(beam, FLOOR, run="dt = 5e-3\nduration = 0.3")
    rom, full = rom_of(system), fr.simulate(system)
    body = fr.Simulator(rom, 5e-3, stepper="newton")
    stretched, _, lacking = run(body, lambda _: [], 60)
    assert body.obstacle_forces().any()
    assert lacking <= ACCOUNT
    assert stretched <= 5e-3
    assert fr.compare(fr.simulate(rom, stepper="newton"), full)["shape"].relative <= 0.05


@pytest.mark.parametrize("supports", ["", 'clamped = ["left"]\n'], ids=["free", "carried"])
def test_a_moving_frame_leaves_it_rigid(beam, supports):
    load = PULSE.replace("[0.0, 6.0, 36.0]", "[0.0, 2.0, 8.0]") if supports else FREE
    system = system_of(beam, head='frame = "moving"\n', supports=supports, run=load)
    rom, full = rom_of(system), fr.simulate(system)
    body = fr.Simulator(rom, 5e-3, stepper="newton")
    for step in range(60):
        body.step(np.array([0.0, 2.0, 8.0] if supports else [0.2, 0.6, 2.0]) * (step < 30))
    assert stretch_of(body.displacement(), rom) <= RIGID
    assert fr.compare(fr.simulate(rom, stepper="newton"), full)["shape"].relative <= 0.02


@pytest.mark.parametrize("stepper", ["newton", "linearly-implicit"])
def test_small_turns_are_those_of_full_order(beam, stepper):
    system = system_of(beam, run=PULSE.replace("[0.0, 6.0, 36.0]", "[0.0, 2.0, 8.0]"))
    assert fr.compare(fr.simulate(rom_of(system), stepper=stepper), fr.simulate(system))["shape"].relative <= 0.02


@pytest.mark.slow
def test_a_model_that_is_trained_follows_large_turns(beam):
    system = system_of(beam)
    rom = fr.reduce(system, order=20)
    assert rom.deformation.validation_error <= 0.02  # 0.0034 is measured
    assert fr.compare(fr.simulate(rom, stepper="newton"), fr.simulate(system))["shape"].relative <= 0.02  # 0.0033
