"""A cable that turns by a right angle over a cylinder in a soft block: Euler's and Eytelwein's law, to and fro."""

import numpy as np
import pytest
from bodies import acted_on, box_arrays, write_arrays

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


def run(body, control, large):
    """To and fro: after each step tensions from where it is pulled to the anchor, N, and by how much it turns, rad."""
    there = np.sin(np.linspace(0, np.pi, 25))[1:-1]
    seen, scale, lost = [], 0.0, [0.0]
    for share in there:
        pulled = share * PULL[control]
        body.step(np.array([0.0, 0.0, 0.0, pulled]))
        stepper = body.stepper if isinstance(body, FullOrderSimulator) else body.save().stepper
        z = np.asarray(stepper.reactions)
        T, at_guides = (z[0], z[1:]) if control == "length" else (pulled, z)
        pieces = np.diff(np.array(POINTS) + large * body.displacement("path"), axis=0)
        pieces /= np.linalg.norm(pieces, axis=1)[:, None]
        angle = 2 * np.arcsin(np.linalg.norm(np.diff(pieces, axis=0), axis=1) / 2).sum()
        seen.append((T + np.concatenate([[0.0], np.cumsum(at_guides[::-1])]), angle))
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
