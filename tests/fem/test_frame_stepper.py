"""Full-order steps in a moving frame: exact laws at any step, closed forms, and the run of a scene."""

from contextlib import closing

import numpy as np
import pytest
from bodies import box_arrays, scene_text, write_arrays

import fenics_rom as fr
from fenics_rom.errors import StepError
from fenics_rom.fem.simulator import FullOrderSimulator
from fenics_rom.mechanics.frame_motion import rotation_matrix
from fenics_rom.scene.file import parse_scene

LENGTHS = (0.3, 0.03, 0.02)
FORCES = """inertia = {}
[effects.gravity]
acceleration = [0.0, 0.0, -9.81]
[effects.prescribed.push]
point = [0.3, 0.03, 0.02]
force = [1e-3, 2e-3, 0.0]
[effects.prescribed.beside]
point = [0.02, 0.01, 0.01]  # where a base, if there is one, bears most of it
force = [3e-3, 1e-3, 2e-3]
[effects.tendon.rope]
points = [[0.01, 0.015, 0.015], [0.15, 0.015, 0.015], [0.29, 0.015, 0.015]]
[effects.pressure.air]
surface = "top"
[effects.damping]
beta = 1e-3
[effects.point_masses.knob]
point = [0.02, 0.01, 0.01]  # where a base, if there is one, bears some of it
mass = 0.02
[effects.rigid_parts.camera]
surface = "right"
mass = 0.05
center = [0.32, 0.02, 0.01]
inertia = [2e-5, 1e-5, 2e-5]
"""
TIES = """
[effects.springs.bed]  # of which a base, if there is one, holds an end
surface = "bottom"
stiffness = 20.0
[effects.damping.dashpots.oil]
surface = "right"
coefficient = 0.05
"""


@pytest.fixture(scope="module")
def mesh(tmp_path_factory):
    return write_arrays(tmp_path_factory.mktemp("frame") / "beam.msh", *box_arrays(LENGTHS, (4, 1, 1)))


def moving(mesh, effects="inertia = {}", **parts):
    """A scene whose frame moves, of a soft beam."""
    tip = {"outputs.tip": "points = [[0.3, 0.015, 0.01]]"}
    parts = {"material": "young = 5e5\npoisson = 0.4\ndensity = 1100.0", **tip, **parts}
    return parse_scene('frame = "moving"\n' + scene_text(mesh, effects=effects, **parts))


def tumbling(turns=(3.0, 4.0, 5.0)):
    return fr.BaseState(np.ones(3), np.array([0.8, 0.6, 0.0, 0.0]), np.array([0.1, 0.2, 0.3]), np.array(turns))


def shaken(time):
    """A base on some path; its twists are not quite those of its poses, which no law minds."""
    angle, rate = 0.5 * np.sin(3 * time), 1.5 * np.cos(3 * time)
    rotation = np.array([np.cos(angle), 0.6 * np.sin(angle), 0.0, 0.8 * np.sin(angle)])
    position = np.array([0.1 * np.sin(4 * time), 0.05 * time**2, 0.0])
    velocity = np.array([0.4 * np.cos(4 * time), 0.1 * time, 0.0])
    return fr.BaseState(position, rotation, velocity, 2 * rate * np.array([0.6, 0.0, 0.8]))


@pytest.mark.parametrize("ties", ["", TIES])
@pytest.mark.parametrize("supports", [None, 'clamped = ["left"]'])
def test_energy_and_momenta_balance_at_any_step(mesh, supports, ties):
    """The account closes to the round-off of what was stored and supplied; what nothing acts on keeps its momenta."""
    system = fr.assemble(moving(mesh, FORCES + ties, supports=supports))
    signals = {} if supports is None else {"base_path": shaken}
    body = FullOrderSimulator(system, 1e-3, system.scene.environment, signals)
    if supports is None:
        body.stepper.place(tumbling())
    start, turnover = body.energy, 0.0
    for step in range(20):
        body.stepper.set_time_step((1e-3, 1e-2)[step // 10])
        body.step(np.array([0.0, 0.0, 0.01 * np.sin(step), 0.1, 5.0 * np.cos(step)]))
        turnover = max(turnover, abs(body.energy), abs(body.ledger.supplied))
    assert body.ledger.dissipated > 1e-6
    assert abs(body.energy - start - body.ledger.supplied + body.ledger.dissipated) <= 1e-12 * turnover
    assert (body.base_wrench is None) == (supports is None)


@pytest.mark.parametrize("ties", ["", TIES])
@pytest.mark.parametrize("supports", [None, 'clamped = ["left"]'])
def test_reduced_in_all_modes_is_full_order(mesh, supports, ties):
    """Two programs of the same equations: shapes, momenta and the wrench of the base after steps under all loads."""
    system = fr.assemble(moving(mesh, FORCES + ties, supports=supports))
    rom, signals = fr.reduce(system, order=system.elastic_size, method="modal"), {}
    if supports is not None:
        signals["base_path"] = shaken
    bodies = (
        FullOrderSimulator(system, 2e-3, system.scene.environment, signals),
        fr.Simulator(rom, 2e-3, signals=signals),
    )
    start = tumbling() if supports is None else shaken(0.0)
    bodies[0].stepper.place(start)
    bodies[1].place(start)
    for step in range(15):
        for body in bodies:
            body.step(np.array([0.01, 0.0, 0.02 * np.sin(0.3 * step), 0.1, 5.0 * np.cos(step)]))
    full, reduced = bodies
    assert np.abs(full.stepper.shape).max() > 1e-5
    np.testing.assert_allclose(reduced.displacement(), full.displacement(), rtol=0, atol=1e-12)
    np.testing.assert_allclose(reduced.displacement("tip"), full.displacement("tip"), rtol=0, atol=1e-12)
    np.testing.assert_allclose(reduced.velocity(), full.velocity(), rtol=0, atol=1e-10)
    for ours, others in zip(reduced.momentum, full.momentum, strict=True):
        np.testing.assert_allclose(ours, others, rtol=0, atol=1e-12)
    if supports is not None:
        np.testing.assert_allclose(reduced.base_wrench, full.base_wrench, rtol=0, atol=1e-8)  # momenta over dt


@pytest.mark.parametrize(("turn", "h"), [(1.5, 1e-3), (0.1, 1e-2)])
def test_stiff_springs_let_no_body_explode(tmp_path, turn, h):
    """A stiff cube on springs of ω = 300 rad/s, turned far and in steps beyond what that asks for: energy stays."""
    mesh = write_arrays(tmp_path / "cube.msh", *box_arrays((0.1, 0.1, 0.1), (1, 1, 1)))
    effects = 'inertia = {}\n[effects.springs.bed]\nsurface = "bottom"\nstiffness = 1e5'
    hard = {"material": "young = 1e9\npoisson = 0.4\ndensity = 1100.0", "outputs.tip": "points = [[0.1, 0.05, 0.05]]"}
    system = fr.assemble(moving(mesh, effects, supports=None, **hard))
    body = FullOrderSimulator(system, h, system.scene.environment)
    turned = np.array([np.cos(turn / 2), 0.6 * np.sin(turn / 2), 0.0, 0.8 * np.sin(turn / 2)])
    body.stepper.place(fr.BaseState(system.moving_frame.origin, turned, np.zeros(3), np.zeros(3)))
    start = body.energy
    for _ in range(40):
        body.step(np.zeros(body.stepper.input_matrix.shape[1]))
        assert abs(body.energy - start) <= 1e-11 * start


def test_free_body_keeps_its_momenta_and_gives_back_a_step(mesh):
    system = fr.assemble(moving(mesh, supports=None))
    body = FullOrderSimulator(system, 1e-2, system.scene.environment)
    rng = np.random.default_rng(0)
    body.stepper.set_state(*(size * rng.normal(size=system.size) for size in (1e-4, 1e-2)))
    body.stepper.place(tumbling())
    momenta, energy = body.momentum, body.energy
    for step in range(20):
        body.stepper.set_time_step((1e-2, 1e-3)[step // 10])
        body.step(np.zeros(3))
    for before, after in zip(momenta, body.momentum, strict=True):
        np.testing.assert_allclose(after, before, atol=1e-13 * np.linalg.norm(before))
    assert body.energy == pytest.approx(energy, rel=1e-12)
    before = body.displacement(), body.velocity(), body.energy
    body.step(np.zeros(3))
    body.stepper.rollback()
    for ours, kept in zip((body.displacement(), body.velocity(), body.energy), before, strict=True):
        np.testing.assert_array_equal(ours, kept)


def test_nodes_move_as_their_velocities_say(mesh):
    system = fr.assemble(moving(mesh, supports=None))
    body = FullOrderSimulator(system, 1e-4, system.scene.environment)
    body.stepper.place(tumbling())
    body.step(np.zeros(3))
    velocities, before = body.velocity("tip"), body.displacement("tip")
    body.step(np.zeros(3))
    mean = (velocities + body.velocity("tip")) / 2
    np.testing.assert_allclose((body.displacement("tip") - before) / 1e-4, mean, atol=1e-6)


def test_beam_on_a_hub_is_drawn_out_as_in_the_textbook(tmp_path):
    """u(L) = ρ ω² L³/(3 E), and the hub pulls with m ω² L/2; stiffening takes some of the stretch: ω/ω₁ = 0.02."""
    mesh = write_arrays(tmp_path / "bar.msh", *box_arrays((1.0, 0.1, 0.1), (8, 1, 1)))
    parts = {"outputs.tip": "points = [[1.0, 0.05, 0.05]]", "effects.base_path": "origin = [0.0, 0.05, 0.05]"}
    text = scene_text(
        mesh, degree=2, material="young = 1e6\npoisson = 0.0\ndensity = 1000.0", damping="beta = 0.02", **parts
    )
    scene, ω = parse_scene('frame = "moving"\n' + text), 0.05
    system = fr.assemble(scene)
    origin = system.moving_frame.origin

    def hub(time):
        turn = ω * time / 2
        rotation = np.array([np.cos(turn), 0.0, 0.0, np.sin(turn)])
        return fr.BaseState(origin, rotation, np.zeros(3), np.array([0.0, 0.0, ω]))

    body = FullOrderSimulator(system, 0.2, scene.environment, {"base_path": hub})
    for _ in range(50):
        body.step(np.zeros(3))
    stretch = body.stepper.shape[np.abs(system.body.nodes - [1.0, 0.05, 0.05]).max(axis=1).argmin(), 0]
    assert stretch == pytest.approx(1000 * ω**2 / 3e6, rel=5e-3)
    force = np.linalg.norm(body.base_wrench[0])
    assert force == pytest.approx(10.0 * ω**2 / 2, rel=1e-3)


def test_base_that_stands_still_bears_the_weight(mesh):
    """Turned by 90 degrees about x, of a beam in equilibrium: m g, and m g times the arm of its mass."""
    scene = moving(mesh, "inertia = {}\n[effects.gravity]\nacceleration = [0.0, 0.0, -9.81]")
    system, half = fr.assemble(scene), np.sqrt(0.5)
    pose = fr.BaseState(np.ones(3), np.array([half, half, 0.0, 0.0]), np.zeros(3), np.zeros(3))
    body, frame = (
        FullOrderSimulator(system, 0.1, scene.environment, {"base_path": lambda time: pose}),
        system.moving_frame,
    )
    weight = frame.mass_times[:, :1] * np.array([0.0, -9.81, 0.0])  # in the frame
    with closing(system.algebra.factor((1.0, system.stiffness))) as factor:
        q = factor.solve(weight.reshape(-1, 1))
    body.stepper.set_state(q, np.zeros(system.size))
    body.step(np.zeros(3))
    np.testing.assert_allclose(body.stepper.x, q, atol=1e-12 * np.abs(q).max())
    moment = frame.moments[0, 1:] + frame.mass_times[:, 0] @ q.reshape(-1, 3)
    in_frame = [[0.0, 9.81 * frame.moments[0, 0], 0.0], np.cross(moment, [0.0, 9.81, 0.0])]
    to_world = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    np.testing.assert_allclose(body.base_wrench, in_frame @ to_world.T, atol=1e-10)


def test_a_base_whose_twists_do_not_fit_its_poses_is_told(mesh):
    """With how far, as reduced; one whose do is not."""
    scene = moving(mesh)

    def slides(time, speed):
        velocity = np.array([speed, 0.0, 0.0])
        return fr.BaseState(np.array([time, 0.0, 0.0]), np.array([1.0, 0.0, 0.0, 0.0]), velocity, np.zeros(3))

    for speed, told in ((1.0, ()), (3.0, ("base: in a step it went 0.02 m and turned 0 rad otherwise than",))):
        path = {"base_path": lambda t, v=speed: slides(t, v)}
        body = FullOrderSimulator(fr.assemble(scene), 1e-2, scene.environment, path)
        for _ in range(3):
            body.step(np.zeros(3))
        lines = body.stepper.diagnostics()
        assert len(lines) == len(told)
        assert all(line.startswith(words) for line, words in zip(lines, told, strict=True))


@pytest.mark.parametrize("origin", [None, (0.3, 0.015, 0.01)])
def test_poses_are_of_the_coordinates_of_the_mesh_unless_told(mesh, origin):
    """A base at 0 leaves the body where it is; at a pose (R, p) its nodes at X are at R X + p, or at R (X - o) + p."""
    parts = {} if origin is None else {"effects.base_path": f"origin = {list(origin)}"}
    system = fr.assemble(moving(mesh, **parts))
    rom, o = fr.reduce(system, order=4, method="modal"), np.zeros(3) if origin is None else np.array(origin)
    rotation = np.array([np.cos(0.4), 0.0, np.sin(0.4), 0.0])
    X, held = system.body.nodes, np.isclose(system.body.nodes[:, 0], 0.0)
    for p, q in ((o, np.array([1.0, 0.0, 0.0, 0.0])), (np.array([0.1, 0.2, 0.3]), rotation)):
        still = {"base_path": fr.BaseState(p, q, np.zeros(3), np.zeros(3))}
        expected = (X - o) @ rotation_matrix(q).T + p - X
        for body in (
            FullOrderSimulator(system, 1e-3, system.scene.environment, still),
            fr.Simulator(rom, 1e-3, signals=still),
        ):
            for _ in range(2):
                body.step(np.zeros(3))
                np.testing.assert_allclose(body.displacement()[held], expected[held], rtol=0, atol=1e-15)
                np.testing.assert_allclose(body.displacement(), expected, rtol=0, atol=1e-15)
    for body in (FullOrderSimulator(system, 1e-3, system.scene.environment), fr.Simulator(rom, 1e-3)):
        body.step(np.zeros(3))  # nothing says where the base is: it stands where the mesh is
        np.testing.assert_allclose(body.displacement(), 0 * X, rtol=0, atol=1e-16)


SQUEEZED = """[effects.prescribed.left]
surface = "left"
force = [1.0, 0.0, 0.0]
[effects.prescribed.right]
surface = "right"
force = [-1.0, 0.0, 0.0]
"""


@pytest.mark.parametrize("young", ["5e5", "2e11"])
@pytest.mark.parametrize("squeezed", ["", SQUEEZED])
@pytest.mark.parametrize("speed", [0.0, 50.0])
def test_a_body_that_is_let_go_falls(mesh, speed, squeezed, young):
    """By g t²/2, exactly, in steps of any length: nothing of its turning and bending is there but round-off."""
    effects = "inertia = {}\n[effects.gravity]\nacceleration = [0.0, 0.0, -9.81]\n" + squeezed
    material = f"young = {young}\npoisson = 0.4\ndensity = 1100.0"
    system = fr.assemble(moving(mesh, effects, supports=None, material=material))
    body = FullOrderSimulator(system, 1e-3, system.scene.environment)
    start, velocity, time = system.moving_frame.origin, np.array([speed, 0.0, 0.0]), 0.0
    body.stepper.place(fr.BaseState(start, np.array([1.0, 0.0, 0.0, 0.0]), velocity, np.zeros(3)))
    for dt in (1e-4, 1e-3, 1e-2, 1e-2):
        body.stepper.set_time_step(dt)
        body.step(np.zeros(3))
        time += dt
    fallen = start + velocity * time - [0.0, 0.0, 9.81 * time**2 / 2]
    np.testing.assert_allclose(body.stepper.pose.position, fallen, rtol=0, atol=1e-14 * (1 + speed))
    if not squeezed:  # else the mesh, which is not symmetric, turns a little
        assert np.abs(body.stepper.pose.rotation[1:]).max() <= 1e-12


def test_run_of_a_scene_has_the_frame_in_it(mesh):
    run = "dt = 0.01\nduration = 0.1\nsnapshots = 2\ninitial = { rotation = [0.0, 0.0, 2.0], spin = [0.0, 0.0, 3.0] }"
    trajectory = fr.simulate(moving(mesh, supports=None, run=run))
    assert trajectory.pose.shape == (11, 7)
    np.testing.assert_allclose(trajectory.pose[0, 3:], [np.cos(1.0), 0, 0, np.sin(1.0)], atol=1e-15)
    assert 2 * np.arccos(trajectory.pose[-1, 3]) == pytest.approx(2.0 + 0.3, abs=1e-3)  # drawn out, it slows
    np.testing.assert_allclose(trajectory.momentum[:, 5], trajectory.momentum[0, 5], rtol=1e-13)
    assert trajectory.balance_error <= 1e-12
    assert trajectory.warnings == ()


def flown(system, dt, turns, force, bent=None, steps=8):
    """A body at full order and reduced in all modes, turned by so much a step and bent by a field, after steps.

    What the steps raised is there in place of a body.
    """
    rom = fr.reduce(system, order=system.elastic_size, method="modal")
    full, reduced = FullOrderSimulator(system, dt, system.scene.environment), fr.Simulator(rom, dt)
    if bent is not None:
        x = bent.ravel()[system.body.free]
        full.stepper.set_state(x, 0 * x)
        W = (rom.basis @ next(iter(rom.contact_models.values())).coordinates)[:, -reduced.model.order :]
        q = W.T @ (system.mass @ x[:, None])[:, 0]
        reduced.state = q, 0 * q
    start = fr.BaseState(system.moving_frame.origin, np.array([1.0, 0, 0, 0]), np.zeros(3), np.array(turns) / dt)
    ends = []
    for body, place in ((full, full.stepper.place), (reduced, reduced.place)):
        try:
            place(start)
            for _ in range(steps):
                body.step(force)
            ends.append(body)
        except StepError as error:
            ends.append(str(error).partition(": use")[0])
    return ends


@pytest.mark.filterwarnings("ignore:the surface is")
@pytest.mark.parametrize("young", [5e4, 1e8])
@pytest.mark.parametrize(("dt", "turns"), [(1e-3, (1.0, 0.0, 0.0)), (1e-2, (0.6, 0.0, 0.0)), (1e-2, (0.1, 0.1, 0.0))])
@pytest.mark.parametrize("force", [0.0, 3.0])
def test_what_turns_fast_is_that_of_all_modes(mesh, young, dt, turns, force):
    """By up to 1 rad a step, or by couples that bend a soft beam far."""
    material = f"young = {young}\npoisson = 0.4\ndensity = 1100.0"
    full, reduced = flown(
        fr.assemble(moving(mesh, supports=None, material=material)), dt, turns, force * np.array([0.0, 1.0, -1.0])
    )
    if isinstance(reduced, str):
        assert full == reduced
        return
    size = np.abs(full.displacement()).max()
    np.testing.assert_allclose(reduced.displacement(), full.displacement(), rtol=0, atol=1e-9 * size)


@pytest.mark.parametrize("dt", [1e-4, 1e-3])
def test_a_slender_beam_that_is_let_go_is_that_of_all_modes(tmp_path, dt):
    """1 m long, 2 mm thick, bent by 1 cm: what it bends by is more than its thickness, whose inertia turns it."""
    mesh = write_arrays(tmp_path / "rod.msh", *box_arrays((1.0, 0.002, 0.002), (12, 1, 1)))
    system = fr.assemble(moving(mesh, supports=None, **{"outputs.tip": "points = [[1.0, 0.001, 0.001]]"}))
    ξ, bent = system.body.nodes[:, 0], np.zeros(system.body.nodes.shape)
    bent[:, 2] = 0.01 * (4 * (ξ - 0.5) ** 2 - 1 / 3)
    full, reduced = flown(system, dt, np.zeros(3), np.zeros(3), bent)
    assert np.abs(full.stepper.shape).max() > 5e-3
    np.testing.assert_allclose(reduced.displacement(), full.displacement(), rtol=0, atol=1e-9 * 0.01)


@pytest.mark.filterwarnings("ignore:the surface is")
def test_what_is_too_far_from_its_shape_is_refused_at_any_order(tmp_path):
    mesh = write_arrays(tmp_path / "cube.msh", *box_arrays((0.1, 0.1, 0.1), (1, 1, 1)))
    material = "young = 5e4\npoisson = 0.4\ndensity = 1100.0"
    tip = {"outputs.tip": "points = [[0.1, 0.1, 0.1]]"}
    system = fr.assemble(moving(mesh, supports=None, material=material, **tip))
    full, reduced = flown(system, 1e-3, (1.0, 0.0, 0.0), np.zeros(3), steps=20)
    assert full == reduced
    assert "its kinetic energy is not positive any more" in full


def test_a_step_that_turns_too_far_is_refused(mesh):
    scene = moving(mesh, supports=None)
    body = FullOrderSimulator(fr.assemble(scene), 1.0, scene.environment)
    body.stepper.place(tumbling((0.0, 5.0, 3.0)))
    with pytest.raises(StepError, match=r"would turn by 5.83 rad in a step of 1 s: .* a dt of at most 0.26 s"):
        body.step(np.zeros(3))
