"""Bodies that deform largely in a moving frame: what they are trained with, and the constants of their frame."""

import re
import warnings

import numpy as np
import pytest
from bodies import assembled, box_arrays, dense, scene_text, write_arrays

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning, SceneError, StructureError
from fenics_rom.fem.simulator import FullOrderSimulator
from fenics_rom.io.stages import Stages
from fenics_rom.mechanics.active_environment import ActiveEnvironment
from fenics_rom.mechanics.frame_motion import rotation_matrix
from fenics_rom.reduction.common_basis import CommonBasis
from fenics_rom.reduction.hyperreduction.frame_loads import KINDS, FrameLoads, framed
from fenics_rom.reduction.hyperreduction.training import plan_runs
from fenics_rom.reduction.hyperreduction.training_loads import forces_at_rest, load_extremes
from fenics_rom.reduction.moving_frame import inertia_constants
from fenics_rom.reduction.problem import ReductionProblem
from fenics_rom.reduction.rigid_mode_deflation import elastic_part
from fenics_rom.rom.deformation import ReducedRim
from fenics_rom.scene.file import parse_scene

LENGTHS, BRICKS, ORDER = (0.3, 0.02, 0.02), (3, 1, 1), 6
SOFT = "young = 5e5\npoisson = 0.4\ndensity = 1100.0"
EFFECTS = """inertia = {}
large_deformation = {}
damping = { alpha = 1.0, beta = 5e-3 }
gravity = { acceleration = [0.0, 0.0, -9.81] }
[effects.pressure.air]
surface = "right"
[effects.pressure.skin]
surface = "top"
[effects.tendon.rope]
points = [[0.01, 0.01, 0.018], [0.29, 0.01, 0.018]]
[effects.prescribed.breeze]
surface = "right"
force = [0.0, 0.002, 0.0]
"""
RUN = 'dt = 0.02\nduration = 0.5\n[[run.load]]\nactuator = "rope"\nforce = [0.5]'
CONSTANTS = ("mass", "first_moment", "moment_modes", "inertia0", "inertia1", "inertia2", "coupling0", "coupling")
TURNED = np.array([0.8, 0.0, 0.6, 0.0])  # about y


@pytest.fixture(scope="module")
def mesh(tmp_path_factory):
    return write_arrays(tmp_path_factory.mktemp("frame") / "beam.msh", *box_arrays(LENGTHS, BRICKS))


def scene(mesh, effects=EFFECTS, tables=None, head='frame = "moving"\n', **parts):
    contacts = '[contacts.tip]\nsurface = "right"\nforce = "resultant"'
    parts = {"material": SOFT, "run": RUN, "contacts": contacts} | parts
    return parse_scene(head + scene_text(mesh, effects=effects, **parts), tables=tables or {})


def reduced(system, **choices):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FenicsRomWarning)
        return fr.reduce(system, **{"order": ORDER} | choices)


@pytest.fixture(scope="module")
def carried(mesh):
    return fr.assemble(scene(mesh))


@pytest.fixture(scope="module")
def rom(carried):
    return reduced(carried)


def problem_of(system):
    asked = {"order": ORDER, "tolerance": 1e-4, "switching": "energy", "weighting": "mass", "lyapunov": "krylov"}
    return ReductionProblem(
        system=system,
        factor=system.algebra.factor((1.0, system.stiffness)),
        space=CommonBasis(system),
        contacts=tuple(system.contacts),
        share=0.999,
        stages=Stages(),
        messages=[],
        **asked,
    )


def check_constants(rom, mesh, **parts):
    """Those of its basis, by the mass of all nodes; nothing that stress adds, as the potential has it."""
    whole = assembled(mesh, material=SOFT, supports=None)
    vectors = np.zeros((whole.size, len(rom.stiffness) - rom.rigid))
    vectors[rom.free] = rom.basis[:, rom.rigid :]
    frame = rom.moving_frame
    expected = inertia_constants(whole.body.nodes, dense(whole.mass, whole.size), vectors, origin=frame.origin, **parts)
    for name in CONSTANTS:
        scale = np.abs(getattr(expected, name)).max(initial=1e-3)
        np.testing.assert_allclose(getattr(frame, name), getattr(expected, name), atol=1e-11 * scale, err_msg=name)
    assert frame.stiffening is None
    assert not any("stiffen" in told for told in rom.warnings)


def test_constants_are_those_of_the_shared_basis(rom, mesh):
    check_constants(rom, mesh, carried=True)
    assert rom.moving_frame.order == rom.deformation.order == ORDER


def test_rom_keeps_the_inputs_of_its_scene(carried, rom):
    """Without those that stand for the frame in training."""
    assert rom.loads == {"gravity": 1, "breeze": 3}
    for name, model in rom.contact_models.items():
        B = carried.input_matrix(name)
        np.testing.assert_allclose(model.inputs, rom.basis.T @ B, atol=1e-13 * np.abs(model.inputs).max())


def test_it_is_the_same_on_file(rom, tmp_path):
    fr.write_rom(tmp_path / "rom.h5", rom)
    again = fr.read_rom(tmp_path / "rom.h5")
    assert again == rom
    assert again.identity == rom.identity
    np.testing.assert_array_equal(again.deformation.trained.spins, rom.deformation.trained.spins)
    with pytest.raises(StructureError, match="a ROM with large deformation cannot be truncated"):
        fr.truncate(rom, 2)


def followers(system, x):
    """Force and torque about the frame's origin of what follows the body, on the nodes that move."""
    y = (system.body.nodes.ravel() - np.tile(system.moving_frame.origin, len(system.body.nodes)))[system.body.free] + x
    forces = system.deformation.follower(x)
    return {
        name: np.concatenate([f.reshape(-1, 3).sum(axis=0), np.cross(y.reshape(-1, 3), f.reshape(-1, 3)).sum(axis=0)])
        for name, f in forces.items()
    }


@pytest.mark.parametrize("degree", [1, 2])
def test_rim_of_a_pressure_says_its_wrench_however_far_it_bends(mesh, degree):
    """Against the forces on all nodes; at rest it is what the frame has."""
    system = fr.assemble(
        scene(
            mesh,
            degree=degree,
            supports=None,
            effects=EFFECTS.replace("large_deformation = {}", "") + "[effects.large_deformation]\n",
            **{"effects.pressure.closed": "near = { point = [0, 0, 0], radius = 1e3 }"},
        )
    )
    body, X = system.deformation, system.body.nodes
    q = 0.03 * np.random.default_rng(0).normal(size=X.size)
    for name in ("air", "skin", "closed"):
        points, pieces, shapes, piece_shapes = body.rims[name]
        rim = ReducedRim(points, pieces, shapes.T, piece_shapes.T)
        for x in (0 * q, q):
            expected = followers(system, x)[name]
            np.testing.assert_allclose(rim.wrench(x, system.moving_frame.origin), expected, atol=1e-13)


def swing(rate=4.0):
    """Rows of a base that swings about an axis askew, and goes up, with twists."""
    t, axis = np.linspace(0.0, 0.5, 26), np.array([0.6, 0.0, 0.8])
    angle, up = 0.5 * np.sin(rate * t), 0.1 * t**2
    turned = np.column_stack([np.cos(angle / 2), np.sin(angle / 2)[:, None] * axis])
    rows = np.zeros((len(t), 14))
    rows[:, 0], rows[:, 3], rows[:, 4:8], rows[:, 10] = t, up, turned, 0.2 * t
    rows[:, 11:] = 0.5 * rate * np.cos(rate * t)[:, None] * axis
    return rows


PATH = '[effects.base_path]\ntable = "path.csv"\n'


def test_frame_is_among_the_loads_of_training(mesh):
    """-M (a - g + α × X + ω × (ω × X)) on the nodes, by the mass of all of them, and forces in world axes that turn."""
    system = fr.assemble(scene(mesh, EFFECTS + PATH, {"path.csv": swing()}))
    held = framed(problem_of(system)).system
    active = ActiveEnvironment(system.scene.environment)
    time, dt = 0.15, 0.01
    u = FrameLoads(held, active).seen(active.loads_at(time), time, dt)
    columns = np.hstack([held.units[name] * B for name, B in held.loads.items()])
    start, middle, end = (active.base_at(t) for t in (time, time + dt / 2, time + dt))
    R = rotation_matrix(middle.rotation)
    a = R.T @ ((end.velocity - start.velocity) / dt + [0.0, 0.0, 9.81])
    α, ω = R.T @ (end.angular_velocity - start.angular_velocity) / dt, R.T @ middle.angular_velocity
    whole = assembled(mesh, material=SOFT, supports=None)
    X = whole.body.nodes
    felt = a + np.cross(α, X) + np.cross(ω, np.cross(ω, X))
    expected = -(whole.mass @ felt.reshape(-1, 1))[system.body.free, 0]
    expected += system.unit_forces("rope")[:, 0] * 0 + system.loads["breeze"] @ (R.T @ [0.0, 0.002, 0.0])
    np.testing.assert_allclose(columns @ u, expected, atol=1e-13 * np.abs(expected).max())
    assert np.linalg.norm(α) > 1.0


def test_training_goes_as_far_as_the_path(mesh):
    """As it is felt in steps of the run, along and about the base's own axes; and as far as the user says."""
    system = fr.assemble(scene(mesh, EFFECTS + PATH, {"path.csv": swing()}))
    trained = reduced(system, method="modal+derivatives").deformation.trained
    np.testing.assert_allclose(trained.spins, [1.2, 0.0, 1.6], atol=0.01)
    np.testing.assert_allclose(trained.angular_accelerations, [0.6 * 8, 0.0, 0.8 * 8], atol=0.2)
    assert 9.81 < trained.accelerations[2] < 0.2 + 9.81 + 0.01
    assert trained.inputs["gravity"] == 1.0
    further = EFFECTS.replace("large_deformation = {}", "") + PATH
    further += "[effects.large_deformation.training]\nspins = [0.0, 7.0, 0.0]\naccelerations = [30.0, 0.0, 0.0]"
    system = fr.assemble(scene(mesh, further, {"path.csv": swing()}))
    trained = reduced(system, method="modal+derivatives").deformation.trained
    np.testing.assert_allclose(trained.spins, [1.2, 7.0, 1.6], atol=0.01)
    assert trained.accelerations[0] == 30.0


def test_motions_that_nobody_says_are_told(rom):
    """1 g along each axis beside the weight from all sides; turning and spins that put 1 g on the end of the beam."""
    trained, far = rom.deformation.trained, np.linalg.norm(LENGTHS)
    np.testing.assert_allclose(trained.accelerations, np.full(3, 2 * 9.81))
    np.testing.assert_allclose(trained.angular_accelerations, np.full(3, 9.81 / far), rtol=1e-12)
    np.testing.assert_allclose(trained.spins, np.full(3, np.sqrt(9.81 / far)), rtol=1e-12)
    (told,) = (told for told in rom.warnings if told.startswith("training: "))
    assert "the scene does not say how the base moves, so it was trained with accelerations of 9.81 m/s2" in told


def test_loads_that_turn_come_from_all_sides_where_no_path_is_known(mesh):
    """Weight and forces in world axes; without inertia nothing else of a base strains the body."""
    still = EFFECTS.replace("inertia = {}\n", "").replace("damping = { alpha = 1.0, beta = 5e-3 }\n", "")
    system = fr.assemble(scene(mesh, still))
    held = framed(problem_of(system))
    assert [name for name in held.system.loads if name in KINDS] == [KINDS[0]]
    loads = load_extremes(held, 0.0)
    at = {
        name: slice(end - B.shape[1], end)
        for (name, B), end in zip(
            (held.system.actuators | held.system.loads).items(),
            np.cumsum(list(held.system.widths.values())),
            strict=True,
        )
    }
    for name, most in (("breeze", 0.002), (KINDS[0], 9.81)):
        np.testing.assert_allclose(loads.extremes[:, at[name]], np.outer([-most, most], np.ones(3)))
    assert not loads.resting.any()
    trained = reduced(system, method="modal+derivatives").deformation.trained
    np.testing.assert_array_equal(trained.spins, np.zeros(3))


def test_drawn_spins_are_of_one_axis(carried):
    held = framed(problem_of(carried))
    frame = load_extremes(held, 1.0).frame_loads
    drawn = frame.consistent(np.arange(1.0, 1 + sum(held.system.widths.values())), np.random.default_rng(0))
    squares, mixed = drawn[-6:-3], drawn[-3:]
    np.testing.assert_allclose(mixed**2, 4 * squares[[1, 0, 0]] * squares[[2, 2, 1]])


FLOWN = 'dt = 0.01\nduration = 0.3\ninitial = { spin = [0.0, 0.0, 3.0] }\n[[run.load]]\ncontact = "tip"\n'
FLOWN += "stop = 0.1\nforce = [0.0, 1.0, 3.0]"


@pytest.fixture(scope="module")
def free(mesh):
    return fr.assemble(scene(mesh, supports=None, run=FLOWN))


@pytest.fixture(scope="module", params=["trained", "modal+derivatives"])
def free_rom(free, request):
    return reduced(free, method=request.param)


def test_free_body_is_reduced_without_its_motion_as_a_whole(free, free_rom, mesh, tmp_path):
    """M-orthogonal to it, which comes first; what deforms is of the rest, and all of it is kept in the file."""
    check_constants(free_rom, mesh, carried=False)
    R, W = free_rom.basis[:, :6], free_rom.basis[:, 6:]
    assert (free_rom.rigid, free_rom.deformation.order, free_rom.moving_frame.order) == (6, ORDER, ORDER)
    np.testing.assert_allclose(R.T @ (free.mass @ W), 0.0, atol=1e-12)
    np.testing.assert_allclose(W.T @ (free.mass @ W), np.eye(ORDER), atol=1e-12)
    for name, model in free_rom.contact_models.items():
        np.testing.assert_allclose(model.inputs[6:], W.T @ free.input_matrix(name), atol=1e-12)
    assert list(free_rom.loads) == list(free.loads)
    fr.write_rom(tmp_path / "rom.h5", free_rom)
    assert fr.read_rom(tmp_path / "rom.h5") == free_rom


def test_free_body_is_trained_with_the_spins_that_it_begins_with(free_rom):
    """And those that loads give it; accelerations strain nothing. Those of modal derivatives are of any axis."""
    trained = free_rom.deformation.trained
    assert trained.accelerations is None
    assert trained.angular_accelerations is None
    assert (trained.spins >= 3.0).all() if free_rom.method != "trained" else trained.spins[2] >= 3.0
    assert not any(told.startswith("training: ") for told in free_rom.warnings)


def test_a_free_body_is_trained_with_all_of_its_history_and_shares_of_its_loads(mesh):
    """Of 1,000 steps in 334 of the threefold, and nothing else, as nothing touches it; impulses are the scene's."""
    run = FLOWN.replace("dt = 0.01", "dt = 2e-4").replace("duration = 0.3", "duration = 0.2")
    system = fr.assemble(scene(mesh, supports=None, run=run))
    loads, training, (held_out,) = plan_runs(framed(problem_of(elastic_part(system))))
    own, *others = training
    assert own.title == "the scene's own load history"
    assert own.dt == pytest.approx(6e-4)
    assert [len(run.steps) for run in (own, *others, held_out)] == [334] * (len(training) + 1)
    impulses = np.array([run.dt * sum(u[:3] for _, u in run.steps) for run in (own, *others, held_out)])
    np.testing.assert_allclose(impulses[0], [0.0, 0.1, 0.3], atol=1e-12)
    shares = impulses[:, 2] / 0.3
    np.testing.assert_allclose(impulses, np.outer(shares, impulses[0]), atol=1e-12)
    assert np.ptp(shares) > 0.2
    assert 0.5 <= shares.min() < shares.max() <= 1.1
    assert own.start.angular_velocity[2] == 3.0
    assert loads.pushes["tip"][2] > 2.0


def test_basis_of_a_free_body_holds_its_run(free, free_rom):
    """Shapes in the frame of a full-order run, projected: a basis of six is off by a few per cent of the largest."""
    rom = free_rom
    W, body = rom.basis[:, rom.rigid :], FullOrderSimulator(free, 0.01, free.scene.environment)
    body.stepper.place(free.scene.run.initial.pose(free.moving_frame.origin))
    missed, whole = [], []
    for step in range(20):
        body.step(np.array([0.0, 1.0, 3.0, 0.0, 0.0, 0.0]) * (step < 10))
        q = body.stepper.strained
        left = q - W @ (W.T @ (free.mass @ q))
        missed.append(np.sqrt((left.T @ (free.mass @ left)).item()))
        whole.append(np.sqrt((q.T @ (free.mass @ q)).item()))
    assert max(missed) <= 0.05 * max(whole)
    assert np.abs(body.stepper.shape).max() > 4e-3


def test_loose_body_in_a_fixed_frame_is_told_to_take_a_moving_one(mesh):
    loose = fr.assemble(scene(mesh, supports=None, head="", run=FLOWN))
    with pytest.raises(SceneError, match="which no fixed basis follows; take frame = 'moving', or hold it by supports"):
        fr.reduce(loose, order=ORDER)


@pytest.mark.parametrize("head", ["", 'frame = "moving"\n'])
def test_strokes_are_trained_with_the_forces_that_they_take(mesh, head):
    """At rest by K: what they do work along is as given; a tendon that is shortened by others is slack."""
    pulled = EFFECTS.replace("0.018]]", '0.018]]\ncontrol = "length"').replace('"top"', '"top"\ncontrol = "volume"')
    system = fr.assemble(scene(mesh, pulled, head=head, run=RUN.replace("[0.5]", "[1e-3]")))
    problem = problem_of(system)
    u = np.zeros(3 + sum(system.widths.values()))
    u[[4, 5]] = 1e-7, 1e-3
    x = problem.factor.solve(forces_at_rest(problem, [("tip", u)]))
    found = [float((system.unit_forces(name).T @ x).item()) for name in ("skin", "rope")]
    np.testing.assert_allclose(found, [1e-7, 1e-3], rtol=1e-9)
    u[5] = -1e-3
    slack, without = forces_at_rest(problem, [("tip", u)]), system.unit_forces("skin")
    share = (without.T @ slack) / (without.T @ without)
    np.testing.assert_allclose(slack, without * share, atol=1e-9 * np.abs(slack).max())


def test_free_body_among_obstacles_is_pushed_by_its_weight(mesh):
    """And by what stops it within a quarter of its slowest period, where it is thrown."""
    floor = "[effects.contact.obstacles.floor]\nshape = 'half-space'\npoint = [0, 0, -0.1]\nnormal = [0, 0, 1]\n"
    bare = "inertia = {}\nlarge_deformation = {}\ngravity = { acceleration = [0.0, 0.0, -9.81] }\n" + floor
    system = fr.assemble(scene(mesh, bare, supports=None, run="dt = 0.01\nduration = 0.1"))
    pushes = load_extremes(framed(problem_of(elastic_part(system))), 0.5).pushes
    weight = 9.81 * system.moving_frame.moments[0, 0]
    np.testing.assert_allclose(pushes["tip"], [0.0, 0.0, weight], rtol=1e-12)
    run = "dt = 0.01\nduration = 0.1\ninitial = { velocity = [0, 0, -2] }"
    thrown = fr.assemble(scene(mesh, bare, supports=None, run=run))
    pushes = load_extremes(framed(problem_of(elastic_part(thrown))), 0.5).pushes
    np.testing.assert_allclose(pushes["tip"], [0.0, 0.0, weight * (1 + 2 / 9.81 / 0.125)], rtol=1e-12)


def test_a_base_that_does_more_than_in_training_is_told_with_the_number(mesh):
    """Spins, accelerations and turning of a path thrice as fast; its own path is within what it was trained with."""
    system = fr.assemble(scene(mesh, EFFECTS + PATH, {"path.csv": swing()}))
    rom = reduced(system, method="modal+derivatives")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FenicsRomWarning)
        told = " ".join(fr.simulate(rom).warnings)
    assert " of the base" not in told
    assert "spin of the frame" not in told
    rows = swing(12.0)
    faster = fr.BasePath(rows[:, 0], rows[:, 1:4], rows[:, 4:8], rows[:, 8:11], rows[:, 11:])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FenicsRomWarning)
        run = fr.simulate(rom, signals={"base_path": faster})
    assert run.beyond_training
    (told,) = (told for told in run.warnings if told.startswith("beyond what the model was trained on"))
    assert re.search(
        r"the spin of the frame about x reached 3\.5\d? rad/s, 2\.9\d? times the 1\.2 rad/s of training", told
    )
    assert "the angular acceleration of the base about z reached" in told
