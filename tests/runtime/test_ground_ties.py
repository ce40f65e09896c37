"""Springs and dashpots between the ground and bodies whose frame moves: forces of nodes, exact laws, closed forms."""

import numpy as np
import pytest
from bodies import box_arrays, scene_text, write_arrays
from gradient_checks import check_gradient
from test_differentiation_frames import along, still, swung
from test_moving_frame import LEFT, some_way_on

import fenics_rom as fr
from fenics_rom.errors import StepError
from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.mechanics.frame_motion import ZERO, quaternion_of_vector, rotation_matrix
from fenics_rom.runtime.steppers.pushed_step import PushedPoints, PushedStep
from fenics_rom.scene.file import parse_scene

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
TIES = """inertia = {}
[effects.springs.bed]
surface = "bottom"
stiffness = 6.0
[effects.springs.side]  # of which a base, if there is one, holds an end
surface = "back"
stiffness = 4.0
[effects.damping]
beta = 1e-3
[effects.damping.dashpots.oil]
surface = "left"
coefficient = 0.05
[effects.damping.dashpots.pad]
surface = "right"
coefficient = 0.02
"""
GRAVITY = "[effects.gravity]\nacceleration = [0.0, 0.0, -9.81]\n"
FLOOR = (
    "[effects.friction]\ncoefficient = 0.3\n"
    '[effects.contact.obstacles.floor]\nshape = "half-space"\npoint = [0.0, 0.0, -0.005]\nnormal = [0.0, 0.0, 1.0]\n'
)
FREE, CARRIED = None, 'clamped = ["left"]'


def scene_of(folder, effects=TIES, supports=FREE, size=(0.3, 0.03, 0.02), bricks=(4, 1, 1), young="5e5", **parts):
    mesh = write_arrays(folder / "box.msh", *box_arrays(size, bricks))
    material = f"young = {young}\npoisson = 0.4\ndensity = 1100.0"
    parts = {"outputs.tip": "points = [[0.3, 0.015, 0.01]]"} | parts
    return parse_scene(
        'frame = "moving"\n' + scene_text(mesh, supports=supports, effects=effects, material=material, **parts)
    )


@pytest.fixture(scope="module")
def tied(tmp_path_factory):
    """System and ROM of a beam on springs and dashpots, free and carried."""
    found = {}
    for supports in (FREE, CARRIED):
        system = fr.assemble(scene_of(tmp_path_factory.mktemp("tied"), TIES + GRAVITY, supports))
        found[supports] = system, fr.reduce(system, order=8)
    return found


@pytest.fixture(scope="module")
def touching(tmp_path_factory):
    """ROMs of the same above a floor."""
    floor = TIES + GRAVITY + FLOOR
    return {
        supports: fr.reduce(fr.assemble(scene_of(tmp_path_factory.mktemp("floor"), floor, supports)), order=8)
        for supports in (FREE, CARRIED)
    }


def tumbling(body, turns=(3.0, 4.0, 5.0)):
    """A body that is far from where it was at rest, turned, and moves."""
    body.place(BaseState(np.array([0.1, 0.2, 0.05]), np.array([0.8, 0.6, 0.0, 0.0]), np.array([0.1, 0.2, 0.3]), turns))
    return body


@pytest.mark.parametrize("supports", [FREE, CARRIED])
def test_momenta_change_by_the_forces_of_all_nodes(tied, supports):
    """-S (d + d⁺)/2 - D (d⁺ - d)/h of where nodes are, at their places midway; beside weight and the base's wrench."""
    (system, rom), random = tied[supports], np.random.default_rng(0)
    S, D, X = system.moving_frame.springs, system.moving_frame.dashpots, system.body.nodes
    body = tumbling(fr.Simulator(rom, 1e-2))
    base, mass = body.pose, rom.moving_frame.mass
    for _ in range(10):
        h = body.dt = 10 ** random.uniform(-3, -1.7)
        (P, L), d, before, moment = body.momentum, body.displacement(), body.pose, moment_of(body)
        if supports is FREE:
            body.step(np.zeros(body.inputs))
        else:
            base = some_way_on(base, h, random)
            body.step(np.zeros(body.inputs), base=base)
        (P_end, L_end), d_end, after = body.momentum, body.displacement(), body.pose
        forces = -S @ (d + d_end) / 2 - D @ (d_end - d) / h
        arms = X + (d + d_end) / 2 - (before.position + after.position) / 2
        weight = np.array([0.0, 0.0, -9.81])
        force, torque = forces.sum(axis=0) + mass * weight, np.cross(arms, forces).sum(axis=0)
        torque += np.cross((moment + moment_of(body)) / 2, weight)
        if supports is FREE:
            change = P_end - P, L_end - L
        else:  # about an origin that moves: d/dt of R L is the torque less v × P
            force, torque = force + body.base_wrench[0], torque + body.base_wrench[1]
            R, R_end = rotation_matrix(before.rotation), rotation_matrix(after.rotation)
            v̂, P̂ = before.velocity @ R + after.velocity @ R_end, P @ R + P_end @ R_end
            change = P_end - P, L_end - L + h / 8 * (R + R_end) @ np.cross(v̂, P̂)
        for impulse, changed in zip((h * force, h * torque), change, strict=True):
            np.testing.assert_allclose(changed, impulse, rtol=0, atol=1e-14 * max(1.0, np.abs(impulse).max() / 1e-2))


def moment_of(body):
    """Σ m (x - p) in world axes."""
    frame, q = body.rom.moving_frame, body.state[0]
    C = body.rom.contact_models[body.contact].coordinates[body.rom.rigid :, body.rom.rigid :]
    return rotation_matrix(body.pose.rotation) @ (frame.first_moment + frame.moment_modes @ C @ q[-C.shape[1] :])


@pytest.mark.parametrize("supports", [FREE, CARRIED])
@pytest.mark.parametrize("floor", [False, True])
def test_account_of_a_tied_body_closes_at_any_step(tied, touching, supports, floor):
    """With what springs store and dashpots dissipate, under weight and inputs, in the air and on a floor."""
    rom = touching[supports] if floor else tied[supports][1]
    body, random = fr.Simulator(rom, 1e-3, signals={"gravity": 0.3}), np.random.default_rng(1)
    if floor:
        body.place(body.pose._replace(velocity=np.array([0.1, 0.0, -0.3]), angular_velocity=np.array([0.3, 1.0, 0.2])))
        if supports is CARRIED:
            body.place(body.pose._replace(velocity=np.zeros(3), angular_velocity=np.zeros(3)))
    else:
        tumbling(body)
    start, scale, base, gap = body.energy, body.energy, body.pose, 0.0
    for step in range(150):
        body.dt = h = 10 ** random.uniform(-4, -2)
        if supports is FREE:
            body.step(0.02 * random.standard_normal(body.inputs))
        else:
            sunk = base._replace(velocity=np.array([0.0, 0.0, -0.05 * (step < 75)]), angular_velocity=np.zeros(3))
            base = sunk._replace(position=base.position + h * sunk.velocity) if floor else some_way_on(base, h, random)
            body.step(0.02 * random.standard_normal(body.inputs), base=base)
        account = body.ledger
        gap = max(gap, abs(body.energy - start - account.supplied + account.dissipated + account.lost_in_switching))
        scale = max(scale, body.energy, abs(account.supplied), account.dissipated)
    assert gap <= (LEFT if floor else 1e-12) * scale
    assert body.ledger.dissipated > 1e-2 * scale
    assert not floor or body.ledger.contact > 1e-6 * scale


def test_slopes_of_a_tied_step_are_what_differences_say(tied):
    body = tumbling(fr.Simulator(tied[FREE][1], 2e-2))
    kernel = body._stepper.kernel
    body.step(np.full(body.inputs, 0.01))
    x = kernel.begin_step(np.zeros(kernel._loads.width)) + 0.3 * np.random.default_rng(0).standard_normal(11)
    steps, whole = 1e-4 * np.eye(len(x)), kernel.slopes(x)
    by_x = -np.linalg.solve(whole[:3, :3], whole[:3, 3:])  # of v̂, which is what the forces say
    J = whole[3:, 3:] + whole[3:, :3] @ by_x
    slopes = [(kernel._residual(x + e, None) - kernel._residual(x - e, None)) / 2e-4 for e in steps]
    np.testing.assert_allclose(J, np.transpose(slopes), rtol=0, atol=1e-8 * np.abs(J).max())
    ends = [[kernel.translation(kernel.geometry(y), ZERO, y) for y in (x + e, x - e)] for e in steps]
    slopes = [(end - start) / 2e-4 for end, start in ends]
    np.testing.assert_allclose(by_x, np.transpose(slopes), rtol=0, atol=1e-8 * np.abs(by_x).max())


def test_points_of_a_tied_body_answer_forces_by_their_operator(touching):
    """At places of its own and of others, as a world asks: W is what differences of steps say."""
    body = tumbling(fr.Simulator(touching[FREE], 5e-3, signals={"gravity": 0.1}), (20.0, -10.0, 15.0))
    kernel, random = body._stepper.kernel, np.random.default_rng(0)
    nodes, weights = np.array([[0, 1, 2], [3, 3, 3], [1, 1, 1]]), np.tile([0.2, 0.3, 0.5], (3, 1))
    step = PushedStep(kernel, np.zeros(kernel._loads.width))
    step.begin_at(PushedPoints.of(kernel, nodes, weights, np.array([False, True, False])))
    forces, places = random.standard_normal((3, 3)), 0.1 * random.standard_normal((3, 3))
    step.velocities(forces, places)
    W, small = step.operator(), 1e-3 * np.eye(9).reshape(9, 3, 3)
    answers = [step.velocities(forces + s, places) - step.velocities(forces - s, places) for s in small]
    np.testing.assert_allclose(W, np.reshape(answers, (9, 9)).T / 2e-3, rtol=0, atol=1e-8 * np.abs(W).max())


@pytest.fixture(scope="module")
def ball(tmp_path_factory):
    """A stiff cube of 1.1 kg on springs that are stiff, too, and hold it at its bottom."""
    springs = 'inertia = {}\n[effects.springs.bed]\nsurface = "bottom"\nstiffness = 1e5'
    shape = {"size": (0.1, 0.1, 0.1), "bricks": (1, 1, 1), "young": "1e9"}
    return fr.reduce(
        fr.assemble(scene_of(tmp_path_factory.mktemp("ball"), springs, **shape, **{"outputs.tip": None})),
        order=6,
        method="modal+static",
    )


@pytest.mark.parametrize(("turn", "h"), [(3.0, 2e-4), (1.5, 1e-3), (0.05, 1e-2)])
def test_stiff_springs_let_no_body_explode(ball, turn, h):
    """Turned far, and of steps of up to three times what their frequency asks for: no energy comes from nowhere."""
    body = fr.Simulator(ball, h)
    axis = turn * np.array([0.6, 0.0, 0.8])
    body.place(body.pose._replace(rotation=np.array(quaternion_of_vector(axis))))
    start = body.energy
    assert start > 1e5 * 0.03**2 * turn**2 / 10
    for _ in range(200):
        body.step(np.zeros(body.inputs))
        assert abs(body.energy - start) <= 1e-11 * start


def test_a_step_that_turns_a_tied_body_too_far_is_refused_and_undone(ball):
    body = fr.Simulator(ball, 1e-2)
    body.place(body.pose._replace(rotation=np.array(quaternion_of_vector((0.0, 0.0, 3.0)))))
    before = []

    def go_on():
        for _ in range(20):
            before[:] = body.energy, *body.pose
            body.step(np.zeros(body.inputs))

    with pytest.raises(StepError, match=r"a smaller dt, or less force, is the cure|a dt of at most"):
        go_on()
    for ours, kept in zip((body.energy, *body.pose), before, strict=True):
        np.testing.assert_array_equal(ours, kept)


def test_a_block_on_springs_swings_as_a_pendulum_of_them(tmp_path):
    """m z'' = -k z of a block that is spread with springs at both ends alike, by the midpoint rule: z of each step."""
    springs = "".join(f'[effects.springs.{s}]\nsurface = "{s}"\nstiffness = 25.0\n' for s in ("left", "right"))
    oil = "".join(f'[effects.damping.dashpots.{s}]\nsurface = "{s}"\ncoefficient = 0.2\n' for s in ("left", "right"))
    scene = scene_of(tmp_path, f"inertia = {{}}\n{springs}{oil}", bricks=(2, 1, 1), young="1e12")
    body, h = fr.Simulator(fr.reduce(fr.assemble(scene), order=4, method="modal"), 5e-3), 5e-3
    middle = np.array(body.pose.position)
    body.place(body.pose._replace(position=middle + np.array([0.0, 0.0, 0.01])))
    m, k, c, z, v = body.rom.moving_frame.mass, 50.0, 0.4, 0.01, 0.0
    for _ in range(100):
        body.step(np.zeros(body.inputs))
        mean = (2 / h * m * v - k * z) / (2 / h * m + c + h / 2 * k)
        z, v = z + h * mean, 2 * mean - v
        np.testing.assert_allclose(body.pose.position - middle, [0.0, 0.0, z], rtol=0, atol=1e-8)  # as it gives way


def test_springs_hold_a_body_at_rest_under_its_weight(tmp_path):
    """They bear m g and nothing moves any more; steps end though velocities are round-off of forces that cancel."""
    hung = 'inertia = {}\n[effects.springs.s]\nsurface = "top"\nstiffness = 100.0\n'
    hung += '[effects.damping.dashpots.d]\nsurface = "top"\ncoefficient = 5.0\n'
    system = fr.assemble(scene_of(tmp_path, hung + GRAVITY + "[effects.damping]\nbeta = 1e-3\n"))
    rom = fr.reduce(system, order=8)
    body = fr.Simulator(rom, 2e-2)
    for _ in range(500):
        body.step(np.zeros(body.inputs))
    assert np.linalg.norm(body.pose.velocity) < 1e-12
    pull = (system.moving_frame.springs @ body.displacement()).sum(axis=0)
    np.testing.assert_allclose(pull, [0.0, 0.0, -9.81 * rom.moving_frame.mass], rtol=0, atol=1e-11)


def test_saved_states_of_tied_bodies_go_on_to_the_bit(touching):
    for rom in touching.values():
        body = fr.Simulator(rom, 1e-3)
        for _ in range(20):
            body.step(np.full(body.inputs, 0.01))
        kept, ends = body.save(), []
        for _ in range(2):
            for _ in range(20):
                body.step(np.full(body.inputs, 0.02))
            ends.append((body.energy, *body.state, *body.pose))
            body.restore(kept)
        for ours, again in zip(*ends, strict=True):
            np.testing.assert_array_equal(ours, again)


def test_switching_of_a_tied_body_changes_nothing(tied):
    body = tumbling(fr.Simulator(tied[FREE][1], 1e-3))
    for _ in range(20):
        body.step(np.full(body.inputs, 0.05))
    energy, shape = body.energy, body.displacement()
    body.switch("top")
    assert body.energy == pytest.approx(energy, rel=1e-13)
    np.testing.assert_allclose(body.displacement(), shape, rtol=0, atol=1e-13)


@pytest.mark.parametrize("detail", ["full", "quasi-rigid"])
def test_tied_bodies_of_a_batch_are_carried_as_single_ones(tied, detail):
    rom, random = tied[CARRIED][1], np.random.default_rng(0)
    batch = fr.Batch(rom, 3, 2e-3, ledger=True, detail=detail)
    bodies = [fr.Simulator(rom, 2e-3, detail=detail) for _ in range(3)]
    bases = [body.pose for body in bodies]
    for _ in range(40):
        batch.dt = 10 ** random.uniform(-4, -2)
        bases = [some_way_on(base, batch.dt, random) for base in bases]
        u = 0.05 * random.standard_normal((3, batch.inputs))
        batch.step(u, base=BaseState(*(np.array(part) for part in zip(*bases, strict=True))))
        for body, base, given in zip(bodies, bases, u, strict=True):
            body.dt = batch.dt
            body.step(given, base=base)
    pairs = [
        (batch.energy, [body.energy for body in bodies]),
        (batch.supplied, [body.ledger.supplied for body in bodies]),
        (batch.dissipated, [body.ledger.dissipated for body in bodies]),
        *zip(batch.base_wrench, zip(*(body.base_wrench for body in bodies), strict=True), strict=True),
        *zip(batch.state(), zip(*(body.state for body in bodies), strict=True), strict=True),
    ]
    for found, single in pairs:
        exact = np.array(single)
        assert np.abs(found - exact).max() <= 1e-11 * np.abs(exact).max()


@pytest.mark.parametrize("base", [swung, still])
def test_gradient_of_a_tied_body_agrees_with_differences(tied, base):
    check_gradient(*along(tied[CARRIED][1], base))


def test_sums_of_ties_are_kept_in_the_file(tied, tmp_path):
    rom = tied[FREE][1]
    fr.write_rom(tmp_path / "rom.h5", rom)
    assert fr.read_rom(tmp_path / "rom.h5") == rom
    assert fr.truncate(rom, 3).moving_frame == rom.moving_frame


def test_a_run_without_damping_has_no_dashpots(tied):
    """The scene of a run may leave effects.damping out, but not springs."""
    rom = tied[FREE][1]
    effects = {name: text for name, text in rom.environment.effects.items() if name != "damping"}
    body = tumbling(fr.Simulator(rom, 1e-3, scene=fr.Environment(**{**vars(rom.environment), "effects": effects})))
    start = body.energy - body.ledger.supplied
    for _ in range(50):
        body.step(np.zeros(body.inputs))
    assert body.ledger.dissipated == 0.0
    assert body.energy - body.ledger.supplied == pytest.approx(start, rel=1e-12)
