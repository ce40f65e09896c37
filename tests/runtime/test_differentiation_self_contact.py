"""Gradients through contact of a body with itself, held or in a moving frame, against central differences."""

import numpy as np
import pytest
from forks import CLAMPED, GAP, LONG, ROPE, cleft
from test_self_contact import CARRIED, LARGE, RUBS, rom_of, turning

import fenics_rom as fr

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
H, STEPS = 1e-3, 25
READ = {"outputs.tip": f"points = [[{LONG}, -0.01, 0.011]]"}
OWN = 'self_contact = ["inside"]\n'
PIN = 'obstacles.pin = { shape = "sphere", center = [0.09, 0.0, 0.016], radius = 0.004 }\n'
FREE, CARRIED = {"frame": "moving", "supports": None}, {"frame": "moving", **CARRIED}
CASES = {  # parts of the scene
    "rubs, beside a ball": {"contact": OWN + PIN, **RUBS},
    "bounces": {"contact": f"{OWN}restitution = 0.5\n", **RUBS},
    "springs": {"contact": f'{OWN}method = "penalty"\nstiffness = 1e3\ndamping = 0.1\n', **RUBS},
    "bare": {"contact": f"{OWN}residual_compliance = false\n"},
    "large": {**LARGE, **RUBS},
    "large, Newton": {**LARGE, **RUBS},
    "no inertia": {"effects": None, **RUBS},
    "free, rubs": {**FREE, **RUBS},
    "free, bare": {**FREE, "contact": f"{OWN}residual_compliance = false\n"},
    "carried, rubs": {**CARRIED, **RUBS},
    "free, large": {**FREE, **LARGE, **RUBS},
}


def uneven():
    """A cleft whose nodes are not opposite to one another: where they are, pairs are at a kink."""
    points, cells, faces = cleft((5, 2, 3), 1)
    low = np.isclose(points[:, 2], -GAP / 2)
    points[low & (points[:, 0] > 0.2 * LONG + 1e-6) & (points[:, 0] < LONG - 1e-6), 0] += 6e-3
    points[low & (np.abs(points[:, 1]) < 1e-6), 1] += 3e-3
    return points, cells, faces


def squares(outputs, energies):
    weights = 1e3 * np.linspace(1.0, 2.0, len(energies))
    return 1e6 * (outputs["tip"] ** 2).sum() + weights @ energies, {"tip": 2e6 * outputs["tip"]}, weights


def body_of(rom, stepper):
    """A simulator, on a base that turns where one carries it."""
    is_carried = rom.moving_frame is not None and rom.moving_frame.carried
    return fr.Simulator(rom, H, stepper=stepper, signals={"base_path": turning} if is_carried else {})


def run(rom, u, stepper):
    """The objective, by steps; and in how many there were forces."""
    body, read, energies, touched = body_of(rom, stepper), [], [], 0
    for row in u:
        body.step(row)
        read.append(body.displacement("tip"))
        energies.append(body.energy)
        touched += body.contact_forces().any()
    return squares({"tip": np.array(read)}, np.array(energies))[0], touched


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if "large" in name else name for name in CASES]
)
def test_gradient_goes_through_contact_of_a_body_with_itself(tmp_path, name):
    rom = rom_of(tmp_path, uneven(), order=8, **CLAMPED | ROPE | READ | CASES[name])
    random, stepper = np.random.default_rng(0), "newton" if "Newton" in name else None
    body = body_of(rom, stepper)
    p = body.inputs
    u = 0.01 * random.standard_normal((STEPS, p)).cumsum(axis=0)
    u[:, -1] += 3.0
    gradient, δ = fr.differentiate(body, u, squares), random.standard_normal((STEPS, p))
    value, touched = run(rom, u, stepper)
    assert gradient.value == pytest.approx(value, rel=1e-12)
    assert touched > 5
    difference = (run(rom, u + 1e-5 * δ, stepper)[0] - run(rom, u - 1e-5 * δ, stepper)[0]) / 2e-5
    assert (gradient.inputs * δ).sum() == pytest.approx(difference, rel=1e-6)
