"""At full order a body touches itself as it does in all modes, on any number of ranks; reduced models come near it."""

import numpy as np
import pytest
from forks import CLAMPED, LEVEL, LONG, ROPE, THICK, cleft, fork_scene, fork_text, oval, pressed
from ranks import simulate_on_ranks

import fenics_rom as fr
from fenics_rom.fem.simulator import FullOrderSimulator

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
RUBS = {"effects.friction": "coefficient = 0.3"}
LARGE = {"effects.large_deformation": 'material = "st_venant_kirchhoff"'}
STEPS = 80


def press(body, stepper, inputs):
    """Forces of a body on itself (n,), N, and how deep it went in itself, m, under inputs (n, p), with its account."""
    forces, deepest, start, scale = np.zeros(len(inputs)), 0.0, body.energy, 0.0
    own = stepper.interface.solver.surface
    for step, u in enumerate(inputs):
        body.step(u)
        contact, gone = stepper.contact, body.ledger
        if contact is not None:
            forces[step] = (contact.pair_forces * contact.normals).sum()
        places = stepper.interface.points.coordinates + stepper.point_displacement()
        deepest = min(deepest, own.near(places, 0.0).gaps.min(initial=0.0))
        scale = max(scale, body.energy)
        lost = gone.dissipated + gone.lost_in_switching + gone.numerical
        assert abs(body.energy - start - gone.supplied + lost) <= 1e-12 * scale
    return forces, -deepest


def test_a_clamp_closes_as_in_all_modes_and_nearly_so_in_thirty(tmp_path):
    """Pressed from above and below, with friction."""
    system = fr.assemble(fork_scene(tmp_path, cleft((10, 2, 5), 1), **CLAMPED, **RUBS, **pressed("above", "below")))
    inputs = np.minimum(100.0 * np.arange(STEPS), 3000.0)[:, None] * np.ones(2)
    full = FullOrderSimulator(system, 1e-3, system.scene.environment)
    expected, deepest = press(full, full.stepper, inputs)
    assert full.stepper.contact.touching >= 15
    assert deepest <= 1e-3 * LONG
    for order, bound in ((system.elastic_size, 1e-8), (30, 0.05)):
        method = {"method": "modal"} if order > 30 else {}
        body = fr.Simulator(fr.reduce(system, order=order, **method), 1e-3)
        found, deep = press(body, body.integrator, inputs)
        assert np.linalg.norm(found - expected) <= bound * np.linalg.norm(expected)
        assert deep <= 1e-3 * LONG


@pytest.mark.parametrize("parts", [{}, LARGE], ids=["small", "large"])
def test_a_ring_between_plates_closes(tmp_path, parts):
    """On the lower one it is glued; the upper one comes down until the inside is on itself, and passes its force on."""
    top = LEVEL + THICK
    plate = f'obstacles.plate = {{ shape = "half-space", point = [0.0, 0.0, {top}], normal = [0.0, 0.0, -1.0] }}'
    modes = {"contacts": '[contacts.inside]\nsurface = "inside"\n[contacts.head]\nsurface = "head"'}
    contact = f'self_contact = ["inside"]\n{plate}'
    scene = fork_scene(tmp_path, oval(24), "fixed", contact, supports='clamped = ["foot"]', **modes, **RUBS, **parts)
    system, pushes = fr.assemble(scene), {}
    bodies = {"full": FullOrderSimulator(system, 2e-3, scene.environment, {"plate": comes_down})}
    if not parts:
        bodies["reduced"] = fr.Simulator(fr.reduce(system, order=10), 2e-3, signals={"plate": comes_down})
    for name, body in bodies.items():
        stepper = body.stepper if name == "full" else body.integrator
        points, found = stepper.interface.points.coordinates, []
        for _ in range(82):
            body.step(np.empty(0))
            contact = stepper.contact
            within = (contact.pair_forces * contact.normals).sum(axis=1)[contact.pairs >= len(points)].sum()
            found.append([-contact.by_obstacle[0, 2], within])
        pushes[name], gone = np.array(found), body.ledger
        left = body.energy - gone.supplied + gone.dissipated + gone.lost_in_switching + gone.numerical
        assert abs(left) <= 1e-12 * gone.supplied
        assert stepper.interface.solver.surface.near(points + stepper.point_displacement(), 0.0).gaps.min() >= -1e-4
        assert found[70][1] == 0.0
        assert found[-1][0] > 10 * found[70][0]  # N on the plate, 2 mm later
        assert found[-1][1] > 0.9 * found[-1][0]
    if not parts:
        off = np.linalg.norm(pushes["reduced"] - pushes["full"], axis=0) / np.linalg.norm(pushes["full"], axis=0)
        assert (off <= 0.01).all()  # 2e-4


def comes_down(time):
    return np.array([0.0, 0.0, -0.1 * time])


@pytest.mark.parametrize(("frame", "parts"), [("moving", {}), ("moving", LARGE)], ids=["small", "large"])
def test_a_free_one_keeps_its_momenta(tmp_path, frame, parts):
    """It spins while a rope closes it; of large strains to what Newton's method leaves of the forces."""
    scene = fork_scene(tmp_path, cleft((3, 1, 3), 1), frame, supports=None, **ROPE, **RUBS, **parts)
    body = FullOrderSimulator(fr.assemble(scene), 1e-3, scene.environment)
    body.stepper.place(body.pose._replace(angular_velocity=np.array([3.0, -5.0, 8.0])))
    (P_begun, L_begun), touched = body.momentum, 0
    for _ in range(40):
        body.step(np.array([2.0]))
        touched = max(touched, 0 if body.stepper.contact is None else body.stepper.contact.touching)
    (P, L), scale = body.momentum, np.abs(L_begun).max()
    assert touched >= 2
    np.testing.assert_allclose(P, P_begun, rtol=0, atol=1e-11 * scale / LONG)
    np.testing.assert_allclose(L, L_begun, rtol=0, atol=(1e-10 if parts else 1e-11) * scale)


def test_large_strains_close_their_account(tmp_path):
    scene = fork_scene(tmp_path, cleft((3, 1, 3), 1), **CLAMPED, **ROPE, **RUBS, **LARGE)
    body = FullOrderSimulator(fr.assemble(scene), 1e-3, scene.environment)
    press(body, body.stepper, np.full((40, 1), 2.0))
    assert body.stepper.contact.touching >= 2


@pytest.mark.ranks
@pytest.mark.slow
def test_two_ranks_do_as_one(tmp_path):
    """Of small and of large strains."""
    run = 'dt = 1e-3\nduration = 0.03\nload = [{ actuator = "rope", force = [2.0] }]'
    parts = {**CLAMPED, **ROPE, **RUBS, "outputs.tip": 'surface = "above"', "run": run}
    for name, others in (("small", {}), ("large", LARGE)):
        (tmp_path / f"{name}.toml").write_text(fork_text(tmp_path, cleft((3, 1, 3), 1), **parts, **others))
    simulate_on_ranks(tmp_path, "small", "large")
    for name in ("small", "large"):
        one, other = (fr.read_trajectory(tmp_path / f"{name}-{ranks}.h5") for ranks in (1, 2))
        assert one.contact_account["contact"][-1] > 0
        scale = np.abs(one.outputs["tip"]).max()
        assert np.abs(other.outputs["tip"] - one.outputs["tip"]).max() <= 1e-8 * scale
        assert np.abs(other.energy - one.energy).max() <= 1e-8 * one.energy.max()
        assert max(one.balance_error, other.balance_error) <= 1e-10
