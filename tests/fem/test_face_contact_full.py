"""At full order a pin is kept out between nodes as in all modes, of small and large strains, on any number of ranks."""

import numpy as np
import pytest
from forks import CLAMPED
from pads import RUBS, UP, L, R, depth_of, pad_scene, pad_text, shape
from pinned_clamp import clamp_scene, clamp_text, left_of, rises
from ranks import simulate_on_ranks

import fenics_rom as fr
from fenics_rom.fem.simulator import FullOrderSimulator

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
LARGE = {"effects.large_deformation": 'material = "st_venant_kirchhoff"'}
X, Y = 1.3 * L, 1.55 * L  # between nodes
SPRINGS = '\nmethod = "penalty"\nstiffness = 1e3\ndamping = 0.1\n'
ROD = shape("rod", X, Y, 1e-4 * L)


def press(body, stepper, steps, bound):
    """Forces (steps, 3) on a body, N, whose account closes to a bound, and how deep a pin is in it in the end, m."""
    forces, scale = np.zeros((steps, 3)), 0.0
    for step in range(steps):
        body.step(np.zeros(0))
        contact, gone = stepper.contact, body.ledger
        if contact is not None:
            forces[step] = contact.by_obstacle[0]
        scale = max(scale, gone.supplied)
        lost = gone.dissipated + gone.lost_in_switching + gone.numerical
        assert abs(body.energy - gone.supplied + lost) <= bound * scale
    return forces, depth_of(stepper, np.zeros(3))


@pytest.mark.parametrize(
    ("springs", "parts"), [("", {}), ("", LARGE), (SPRINGS, {})], ids=["small", "large", "springs"]
)
def test_a_rod_between_nodes_stays_outside(tmp_path, springs, parts):
    """Of small strains with the forces of the model of all modes; of large ones to what Newton's method leaves.

    Springs let it in.
    """
    scene = pad_scene(tmp_path, ROD + springs, **UP, **RUBS, **parts)
    system = fr.assemble(scene)
    full = FullOrderSimulator(system, 1e-3, scene.environment)
    expected, depth = press(full, full.stepper, 40, 1e-11 if parts else 1e-13)
    assert expected[-1, 2] < -0.1
    assert (depth > 1e-2 * R) if springs else (depth <= 1e-9 * R)
    if not parts:
        body = fr.Simulator(fr.reduce(system, order=system.elastic_size, method="modal"), 1e-3)
        forces = np.zeros_like(expected)
        for step in range(40):
            body.step()
            forces[step] = body.contact_forces("pin")
        assert np.linalg.norm(forces - expected) <= 1e-8 * np.linalg.norm(expected)


def test_a_pin_turns_below_a_clamp_that_closes_as_in_all_modes(tmp_path):
    """At full order its forces are those of the model of all modes; both accounts close."""
    scene = clamp_scene(tmp_path, **CLAMPED)
    system = fr.assemble(scene)
    full = FullOrderSimulator(system, 1e-3, scene.environment, signals={"pin": rises})
    body = fr.Simulator(fr.reduce(system, order=system.elastic_size, method="modal"), 1e-3, signals={"pin": rises})
    forces = np.zeros((2, 70, 3))
    for step in range(70):
        body.step(rope=2.0)
        full.step(np.array([2.0]))
        forces[0, step] = body.contact_forces("pin")
        if full.stepper.contact is not None:
            forces[1, step] = full.stepper.contact.by_obstacle[0]
    assert set(full.stepper.contact.pairs // len(full.stepper.interface.points.coordinates)) == {0, 1}
    assert forces[1, -1, 2] > 0.1
    assert np.linalg.norm(forces[0] - forces[1]) <= 1e-8 * np.linalg.norm(forces[1])
    for each in (body, full):
        assert left_of(each) <= 1e-12 * each.ledger.supplied


@pytest.mark.ranks
@pytest.mark.slow
def test_two_ranks_do_as_one(tmp_path):
    """Of small and of large strains, and of a clamp that closes beside a pin that turns."""
    parts = {**UP, **RUBS, "outputs.top": 'surface = "top"', "run": "dt = 1e-3\nduration = 0.02"}
    for name, others in (("small", {}), ("large", LARGE)):
        (tmp_path / f"{name}.toml").write_text(pad_text(tmp_path, ROD, **parts, **others))
    run = 'dt = 1e-3\nduration = 0.06\n[[run.load]]\nactuator = "rope"\nforce = [2.0]'
    inside = {"outputs.top": 'surface = "inside"', "run": run}
    (tmp_path / "clamp.toml").write_text(clamp_text(tmp_path, **CLAMPED, **inside))
    names = "small", "large", "clamp"
    simulate_on_ranks(tmp_path, *names)
    for name in names:
        one, other = (fr.read_trajectory(tmp_path / f"{name}-{ranks}.h5") for ranks in (1, 2))
        assert np.abs(one.forces["pin"]).max() > 0.05
        scale = np.abs(one.outputs["top"]).max()
        assert np.abs(other.outputs["top"] - one.outputs["top"]).max() <= 1e-8 * scale
        assert max(one.balance_error, other.balance_error) <= 1e-10
