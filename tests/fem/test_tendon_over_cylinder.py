"""A cable that turns by a right angle over a cylinder in a soft block: Euler's and Eytelwein's law, to and fro."""

import numpy as np
import pytest
from bodies import acted_on, box_arrays, box_surfaces, write_arrays

import fenics_rom as fr
from fenics_rom.fem.simulator import FullOrderSimulator

MU, GUIDES, THICK = 0.5, 9, 0.02
ARC = np.linspace(0.0, np.pi / 2, GUIDES)
OVER = np.stack([0.03 + 0.06 * np.cos(ARC), 0.03 + 0.06 * np.sin(ARC)], axis=1)
PLANE = np.vstack([[0.09, 0.01], OVER, [0.01, 0.09]])  # straight pieces are tangents, so that it turns by 90° in all
POINTS = np.column_stack([PLANE, np.full(len(PLANE), THICK / 2)]).tolist()
ROPE = f"[effects.tendon.rope]\npoints = {POINTS}\n"
RUBS = f"tendon_friction = {{ coefficient = {MU} }}\n"
LARGE = 'large_deformation = { material = "neo_hookean" }\n'
MOVING = "inertia = {}\ndamping = { beta = 1e-3 }\n"
PULL = {"tension": 30.0, "length": 2e-3}  # N, m
BLOCK = {
    "material": "young = 1e6\npoisson = 0.3\ndensity = 1000.0",
    "contacts": '[contacts.right]\nsurface = "right"',
    "outputs.path": f"points = {POINTS}",
}


@pytest.fixture(scope="module")
def models(tmp_path_factory):
    mesh = write_arrays(tmp_path_factory.mktemp("block") / "block.msh", *box_arrays((0.1, 0.1, THICK), (4, 4, 1)))
    made = {}

    def make(effects, control):
        if (effects, control) not in made:
            run = f'dt = 1e-3\nduration = 0.02\n[[run.load]]\nactuator = "rope"\nforce = [{1.5 * PULL[control]}]'
            scene = acted_on(mesh, f'{effects}{RUBS}{ROPE}control = "{control}"\n', **BLOCK, run=run)
            system = fr.assemble(scene)
            large = LARGE in effects
            rom = fr.reduce(system, order=12 if large else 60, method=f"modal{'+derivatives' * large}")
            made[effects, control] = system, rom
        return made[effects, control]

    return make


def forces_of(body, control, T):
    """Tensions from where the cable is pulled to its anchor, N; T where it is given."""
    stepper = body.stepper if isinstance(body, FullOrderSimulator) else body.save().stepper
    at_guides = np.asarray(stepper.reactions)[len(body.reactions) :]
    T = body.reactions["rope"] if control == "length" else T
    return T + np.concatenate([[0.0], np.cumsum(at_guides[::-1])])


def run(body, control, large):
    """To and fro: after each step tensions from where it is pulled to the anchor, N, and by how much it turns, rad."""
    there = np.sin(np.linspace(0, np.pi, 25))[1:-1]
    seen, scale, lost = [], 0.0, [0.0]
    for share in there:
        pulled = share * PULL[control]
        body.step(np.array([0.0, 0.0, 0.0, pulled]))
        pieces = np.diff(np.array(POINTS) + large * body.displacement("path"), axis=0)
        pieces /= np.linalg.norm(pieces, axis=1)[:, None]
        angle = 2 * np.arcsin(np.linalg.norm(np.diff(pieces, axis=0), axis=1) / 2).sum()
        seen.append((forces_of(body, control, pulled), angle))
        ledger = body.ledger
        scale = max(scale, body.energy, abs(ledger.supplied), ledger.dissipated)
        assert abs(body.energy - ledger.supplied + ledger.dissipated + ledger.numerical) <= 1e-12 * scale
        lost.append(ledger.dissipated)
    assert np.diff(lost).min() >= -1e-12 * scale
    assert lost[-1] > 0.01 * scale
    return seen


@pytest.mark.parametrize("control", PULL)
@pytest.mark.parametrize("effects", ["", LARGE, MOVING], ids=["small", "large", "moving"])
@pytest.mark.parametrize("model", ["full", "reduced"])
def test_a_cable_over_a_cylinder_has_e_to_the_mu_theta(models, model, effects, control):
    """Pulled in it loses e^-μθ, let out it gains as much; between both it sticks somewhere, within the cone."""
    system, rom = models(effects, control)
    large = LARGE in effects
    body = fr.Simulator(rom, 1e-2) if model == "reduced" else FullOrderSimulator(system, 1e-2, system.scene.environment)
    seen = run(body, control, large)
    ratios = np.array([tensions[-1] / tensions[0] for tensions, _ in seen])
    capstan = np.exp(MU * np.array([angle for _, angle in seen]))
    lost, gained = ratios * capstan, ratios / capstan
    assert np.count_nonzero(np.abs(lost - 1) <= 1e-6) >= 2
    assert np.count_nonzero(np.abs(gained - 1) <= 1e-6) >= 1
    assert np.count_nonzero((lost > 1 + 1e-3) & (gained < 1 - 1e-3)) >= 4
    assert lost.min() >= 1 - 1e-9
    assert gained.max() <= 1 + 1e-9
    assert large or capstan == pytest.approx(np.exp(MU * np.pi / 2), rel=1e-12)
    assert not large or np.abs(capstan / np.exp(MU * np.pi / 2) - 1).max() > 1e-3


# --- both ends ------------------------------------------------------------------------------------------------------

REEL = "box = { corners = [[0.08, -0.05, 0], [0.1, -0.03, 0.02]] }\n"
HOLD = 1e3  # N/m, of a spring at the reel, so that it has an equilibrium
LED = [[0.09, -0.04, THICK / 2], *POINTS]


@pytest.fixture(scope="module")
def reeled(tmp_path_factory):
    """The block, and beside it a cube that the other end of the cable is fixed to, and that a support moves."""
    block, reel = box_arrays((0.1, 0.1, THICK), (4, 4, 1)), box_arrays((0.01, 0.01, 0.01), (1, 1, 1))
    points = np.vstack([block[0], reel[0] + [0.085, -0.045, 0.005]])
    cells = np.vstack([block[1], reel[1] + len(block[0])])
    mesh = write_arrays(tmp_path_factory.mktemp("reel") / "reel.msh", points, cells, box_surfaces(*block))
    made = {}

    def make(effects, control, by="displacement"):
        if (effects, control, by) not in made:
            acting = RUBS
            if by == "displacement":
                acting += f"[effects.springs.reel]\n{REEL}stiffness = {HOLD}\n"
            acting += f'[effects.driven_support.reel]\n{REEL}direction = [0, -1, 0]\ncontrol = "{by}"\n'
            acting += f'[effects.tendon.rope]\npoints = {LED}\ncontrol = "{control}"\n'
            loads = (("rope", PULL[control]), ("reel", 3e-3))
            run = "".join(f'[[run.load]]\nactuator = "{name}"\nforce = [{most}]\n' for name, most in loads)
            places = BLOCK | {"outputs.path": f"points = {LED}"}
            scene = acted_on(mesh, effects + acting, **places, run=f"dt = 1e-3\nduration = 0.02\n{run}")
            system, large = fr.assemble(scene), LARGE in effects
            rom = fr.reduce(system, order=14 if large else 60, method=f"modal{'+derivatives' * large}")
            made[effects, control, by] = system, rom
        return made[effects, control, by]

    return make


@pytest.mark.parametrize("control", PULL)
@pytest.mark.parametrize("effects", ["", LARGE], ids=["small", "large"])
@pytest.mark.parametrize("model", ["full", "reduced"])
def test_a_cable_is_pulled_at_one_end_and_paid_out_at_the_other(reeled, model, effects, control):
    """As the cable runs, what moves the far end is pulled by e^-μθ of the near end's tension, or by e^μθ of it."""
    system, rom = reeled(effects, control)
    large, scale, ratios, lost = LARGE in effects, 0.0, [], [0.0]
    body = fr.Simulator(rom, 1e-2) if model == "reduced" else FullOrderSimulator(system, 1e-2, system.scene.environment)
    for step in range(1, 24):
        drawn, to_and_fro = min(1.0, step / 4), 3e-3 * np.sin(max(0, step - 4) / 3)
        pulled = 6.0 * drawn if control == "tension" else 1.5e-3 * drawn - to_and_fro
        body.step(np.array([0.0, 0.0, 0.0, pulled, to_and_fro]))
        pieces = np.diff(np.array(LED) + large * body.displacement("path"), axis=0)
        pieces /= np.linalg.norm(pieces, axis=1)[:, None]
        angle = 2 * np.arcsin(np.linalg.norm(np.diff(pieces, axis=0), axis=1) / 2).sum()
        near = body.reactions["rope"] if control == "length" else pulled
        far = (body.reactions["reel"] - HOLD * to_and_fro) / pieces[0, 1]  # of the force on the reel, along its motion
        assert far == pytest.approx(forces_of(body, control, pulled)[-1], rel=1e-6)
        ratios.append((far / near * np.exp(MU * angle), far / near / np.exp(MU * angle)))
        ledger = body.ledger
        scale = max(scale, body.energy, abs(ledger.supplied), ledger.dissipated)
        assert abs(body.energy - ledger.supplied + ledger.dissipated + ledger.numerical) <= 1e-12 * scale
        lost.append(ledger.dissipated)
    forwards, backwards = np.array(ratios).T
    assert forwards.min() >= 1 - 1e-6
    assert backwards.max() <= 1 + 1e-6
    assert np.count_nonzero(np.abs(forwards - 1) <= 1e-6) >= 4
    assert np.count_nonzero(np.abs(backwards - 1) <= 1e-6) >= 2
    assert np.diff(lost).min() >= -1e-12 * scale
    assert lost[-1] > 0.1 * scale


@pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
@pytest.mark.parametrize("model", ["full", "reduced"])
def test_a_cable_whose_ends_are_pulled_by_forces_sticks_or_runs(reeled, model):
    """Within the cone it comes to rest between both tensions; beyond it runs, and holds the far end by e^-μθ."""
    system, rom = reeled(MOVING, "tension", "force")
    h, scale = 2e-3, 0.0
    body = fr.Simulator(rom, h) if model == "reduced" else FullOrderSimulator(system, h, system.scene.environment)
    for step in range(1, 151):
        pull, far = 10.0 * min(1.0, step / 40), (12.0 if step <= 120 else 4.0) * min(1.0, step / 40)
        before = body.displacement("path")[0, 1]
        body.step(np.array([0.0, 0.0, 0.0, pull, far]))
        ledger = body.ledger
        scale = max(scale, body.energy, abs(ledger.supplied), ledger.dissipated)
        assert abs(body.energy - ledger.supplied + ledger.dissipated + ledger.numerical) <= 1e-12 * scale
        if step == 120:
            assert forces_of(body, "tension", pull)[-1] == pytest.approx(far, rel=1e-4)
            assert abs(body.displacement("path")[0, 1] - before) <= 1e-6
    assert forces_of(body, "tension", pull)[-1] == pytest.approx(pull * np.exp(-MU * np.pi / 2), rel=1e-6)
    assert body.displacement("path")[0, 1] > 0.05
