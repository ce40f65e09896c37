"""Moving frames of scenes and of anyone's matrices: mass by hand, stiffening by the textbook, and what is refused."""

import numpy as np
import pytest
import scipy.sparse
from bodies import assembled, box_arrays, dense, scene_text, sparse, write_arrays

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning, StructureError
from fenics_rom.mechanics.voigt import VOIGT_INDEX
from fenics_rom.reduction.moving_frame import inertia_constants
from fenics_rom.scene.file import parse_scene

LENGTHS, DENSITY = (1.0, 0.4, 0.3), 1000.0
MASSES = """inertia = {}
damping = { alpha = 1.0, beta = 1e-3 }
[effects.point_masses.knob]
point = [0.05, 0.1, 0.1]  # close to a base, which holds some of its nodes
mass = 30.0
[effects.point_masses.plate]
surface = "top"
mass = 20.0
[effects.rigid_parts.camera]
surface = "right"
mass = 40.0
center = [1.2, 0.3, 0.1]
inertia = [1.0, 2.0, 1.5]"""
CONSTANTS = ("mass", "first_moment", "moment_modes", "inertia0", "inertia1", "inertia2", "coupling0", "coupling")


@pytest.fixture(scope="module")
def mesh(tmp_path_factory):
    return write_arrays(tmp_path_factory.mktemp("frame") / "box.msh", *box_arrays(LENGTHS, (3, 2, 1), shake=0.2))


def moving(mesh, **parts):
    """The system of a scene whose frame moves."""
    return fr.assemble(parse_scene('frame = "moving"\n' + scene_text(mesh, **parts)))


@pytest.fixture(scope="module")
def free(mesh):
    return moving(mesh, supports=None)


def check_constants(rom, X, M, *, carried):
    """Those of a ROM's frame are what NumPy makes of all nodes X (N, 3) and their mass (3N, 3N)."""
    frame, Qe = rom.moving_frame, np.zeros((X.size, len(rom.stiffness) - rom.rigid))
    Qe[rom.free] = rom.basis[:, rom.rigid :]
    expected = inertia_constants(X, M, Qe, carried=carried, origin=frame.origin)
    for name in CONSTANTS:
        scale = np.abs(getattr(expected, name)).max(initial=1.0)
        np.testing.assert_allclose(getattr(frame, name), getattr(expected, name), atol=1e-12 * scale, err_msg=name)


@pytest.mark.parametrize("degree", [1, 2])
def test_constants_of_a_scene_are_those_of_all_its_nodes(mesh, degree):
    """Of a free box and of one that its left side carries, whose nodes have mass, too: M of the whole, by NumPy."""
    whole = assembled(mesh, degree=degree, supports=None)
    M, X = dense(whole.mass, whole.size), whole.body.nodes
    for supports in (None, 'clamped = ["left"]'):
        rom = fr.reduce(moving(mesh, degree=degree, supports=supports), order=6)
        frame, carried = rom.moving_frame, supports is not None
        check_constants(rom, X, M, carried=carried)
        np.testing.assert_allclose(frame.origin, np.zeros(3) if carried else np.array(LENGTHS) / 2, atol=1e-14)
        assert frame.mass == pytest.approx(DENSITY * np.prod(LENGTHS), rel=1e-12)
        from_origin = np.array(LENGTHS) / 2 - frame.origin
        of_box = frame.mass * (np.sum(np.square(LENGTHS)) * np.eye(3) - np.diag(np.square(LENGTHS))) / 12
        steiner = frame.mass * (from_origin @ from_origin * np.eye(3) - np.outer(from_origin, from_origin))
        np.testing.assert_allclose(frame.inertia0[VOIGT_INDEX], of_box + steiner, atol=1e-10)


def test_torques_of_inputs_are_those_of_forces_on_nodes(mesh):
    """On the shape at rest and on another one; of a tendon, which acts within the body, none by its shape."""
    rope = "inertia = {}\n[effects.tendon.rope]\npoints = [[0.1, 0.2, 0.2], [0.9, 0.2, 0.2]]"
    parts = {"effects": rope, "supports": None, "outputs.tip": "points = [[1.0, 0.2, 0.1]]"}
    system = moving(mesh, actuators='push = { surface = "right" }', **parts)
    rom = fr.reduce(system, order=6, method="modal")
    frame, X, q = rom.moving_frame, system.body.nodes - rom.moving_frame.origin, np.random.default_rng(0).normal(size=6)
    for name in rom.contact_models:
        B = system.input_matrix(name).reshape(len(X), 3, -1)
        moved = (rom.basis[:, rom.rigid :] @ np.resize(q, len(rom.stiffness) - rom.rigid)).reshape(-1, 3)
        torque = np.cross(X[:, :, None], B, axis=1).sum(axis=0)
        by_shape = np.cross(moved[:, :, None], B, axis=1).sum(axis=0)
        by_shape[:, -1] = 0.0
        np.testing.assert_allclose(frame.wrenches[name], np.concatenate([B.sum(axis=0), torque]), atol=1e-13)
        modes = frame.torque_modes[name] @ np.resize(q, len(rom.stiffness) - rom.rigid)
        np.testing.assert_allclose(modes.T, by_shape, atol=1e-13 * np.abs(by_shape).max())
    np.testing.assert_allclose(frame.output_points["tip"], [[1.0, 0.2, 0.1]], atol=1e-15)


def test_what_inputs_do_to_held_nodes_the_base_bears(mesh):
    """All of a force that acts close to the base is in what it exerts, and nothing of a tendon that ends there."""
    parts = {
        "effects": "inertia = {}\n[effects.tendon.rope]\npoints = [[0.02, 0.2, 0.2], [0.9, 0.2, 0.2]]\n"
        "[effects.prescribed.push]\npoint = [0.05, 0.1, 0.1]",
        "actuators": 'side = { surface = "bottom" }',
    }
    rom = fr.reduce(moving(mesh, **parts), order=6, method="modal")
    free = moving(mesh, supports=None, **parts)
    X = free.body.nodes - rom.moving_frame.origin
    for name in rom.contact_models:
        B = free.input_matrix(name).reshape(len(X), 3, -1)
        torque = np.cross(X[:, :, None], B, axis=1).sum(axis=0)
        np.testing.assert_allclose(rom.moving_frame.wrenches[name], [*B.sum(axis=0), *torque], atol=1e-13)


def test_what_is_fixed_to_a_body_is_in_the_inertia_of_its_frame(mesh):
    """M of the whole by NumPy, of a free body and a carried one; mass and moments of the parts as rigid bodies."""
    whole = assembled(mesh, effects=MASSES, supports=None)
    M, X = dense(whole.mass, whole.size), whole.body.nodes
    for supports in (None, 'clamped = ["left"]'):
        rom = fr.reduce(moving(mesh, effects=MASSES, supports=supports), order=6)
        frame, carried = rom.moving_frame, supports is not None
        check_constants(rom, X, M, carried=carried)
    middle, bare = np.array(LENGTHS) / 2, DENSITY * np.prod(LENGTHS)
    # a uniform layer at the top has the moments of its area, whose linear triangles integrate them exactly
    x, y = LENGTHS[:2]
    layer = np.diag([y**2, x**2, x**2 + y**2]) / 12 * 20.0
    box = bare * (np.sum(np.square(LENGTHS)) * np.eye(3) - np.diag(np.square(LENGTHS))) / 12
    parts = [
        (bare, middle, box),
        (30.0, np.array([0.05, 0.1, 0.1]), np.zeros((3, 3))),
        (20.0, np.array([x / 2, y / 2, LENGTHS[2]]), layer),
        (40.0, np.array([1.2, 0.3, 0.1]), np.diag([1.0, 2.0, 1.5])),
    ]
    assert frame.mass == pytest.approx(sum(mass for mass, _, _ in parts), rel=1e-12)
    np.testing.assert_allclose(frame.first_moment, sum(mass * place for mass, place, _ in parts), rtol=1e-12)
    moments = sum(own + mass * (a @ a * np.eye(3) - np.outer(a, a)) for mass, a, own in parts)
    np.testing.assert_allclose(frame.inertia0[VOIGT_INDEX], moments, atol=1e-10)


def test_moving_frame_is_kept_in_the_file(mesh, tmp_path):
    rom = fr.reduce(moving(mesh), order=4)
    fr.write_rom(tmp_path / "rom.h5", rom)
    assert fr.read_rom(tmp_path / "rom.h5") == rom
    assert fr.truncate(rom, 2).moving_frame == rom.moving_frame  # of the shared basis, which stays
    assert fr.reduce(assembled(mesh), order=4).moving_frame is None


def flap(rom, ω, axis):
    """The lowest frequency of a body that spins steadily about an axis, rad/s."""
    frame, κ = rom.moving_frame, rom.stiffness
    zero, unit = np.zeros((len(κ),) * 2), np.eye(len(κ))
    stiffness = np.diag(κ) - ω**2 * (frame.inertia2[axis] - frame.stiffening[axis])
    λ = np.linalg.eigvals(np.block([[zero, unit], [-stiffness, -2 * ω * frame.coupling[axis]]]))
    return np.abs(λ.imag).min()


def test_cantilever_on_a_hub_stiffens_as_in_the_textbook(tmp_path):
    """Ω² = Ω₀² + 1.193 ω² out of the plane of rotation, 0.193 in it (Southwell; Schilhans, 1958); coarse: to 1 %."""
    mesh = write_arrays(tmp_path / "beam.msh", *box_arrays((0.3, 0.006, 0.006), (12, 1, 1)))
    system = moving(mesh, degree=2, material="young = 1e9\npoisson = 0.0\ndensity = 1000.0")
    rom = fr.reduce(system, order=12, method="modal")
    ω = 0.1 * np.sqrt(rom.stiffness[0])
    # bending along z is out of the plane of a rotation about z, bending along y in it: the beam is square
    lowest = [flap(rom, speed, axis=2) ** 2 for speed in (0.0, ω)]
    assert (lowest[1] - lowest[0]) / ω**2 == pytest.approx(0.193, abs=0.01)
    frame, κ = rom.moving_frame, rom.stiffness
    held = np.diag(κ) - ω**2 * (frame.inertia2[2] - frame.stiffening[2])
    assert (np.sort(np.linalg.eigvalsh(held))[1] - κ[1]) / ω**2 == pytest.approx(1.193, rel=0.01)


def own(free, **choices):
    """The same free body of SciPy's matrices."""
    M, K = sparse(free.mass), sparse(free.stiffness)
    given = {"mass": M, "stiffness": K, "rayleigh": (1.0, 1e-3), "contacts": free.contacts}
    return fr.System(**given | choices)


def test_free_body_of_own_matrices_is_found_to_be_one(free):
    """By its nodes, or by what its stiffness does not see; with the constants of the scene's."""
    rom = fr.reduce(free, order=6)
    given = {"nodes": free.body.nodes, "frame": "moving", "geometric_stiffness": None}
    of_matrix = free.moving_frame.geometric_stiffness
    for system in (own(free), own(free, nodes=free.body.nodes)):
        assert system.rigid.shape == (free.size, 6)
        overlap = system.rigid.T @ (free.mass @ free.rigid)
        np.testing.assert_allclose(overlap.T @ overlap, np.eye(6), atol=1e-12)
        np.testing.assert_allclose(fr.reduce(system, order=6).stiffness, rom.stiffness, rtol=1e-9, atol=1e-6)
    known = fr.reduce(own(free, **given | {"geometric_stiffness": of_matrix}), order=6)
    with pytest.warns(FenicsRomWarning, match="the stress of the body is not known, so turning does not stiffen it"):
        unknown = fr.reduce(own(free, **given), order=6)
    assert unknown.moving_frame.stiffening is None
    assert "moving frame" in unknown.warnings[0]
    assert known.environment.is_moving
    for name in (*CONSTANTS, "stiffening"):
        ours, others = getattr(rom.moving_frame, name), getattr(known.moving_frame, name)
        scale = np.abs(ours).max(initial=1e-3)
        np.testing.assert_allclose(np.abs(others), np.abs(ours), atol=1e-8 * scale, err_msg=name)  # vectors have signs


def test_nobody_guesses_which_motions_are_rigid(free):
    """A spring to the ground that holds one of the six motions, as weak as round-off is loud, and one that is not."""
    M, K = dense(free.mass, free.size), dense(free.stiffness, free.size)
    holds = M @ free.rigid[:, :1]
    spring = np.trace(K) / np.trace(M) * holds @ holds.T
    with pytest.raises(StructureError, match=r"stiffness is not .* nobody can tell which .* give nodes, or rigid"):
        own(free, mass=M, stiffness=K + 1e-12 * spring)
    assert own(free, mass=M, stiffness=K + 1e-9 * spring).rigid.shape[1] == 5


@pytest.mark.parametrize(
    ("choices", "message"),
    [
        ({"frame": "moving"}, 'frame = "moving": nodes are needed'),
        ({"frame": "turning"}, "frame 'turning'"),
        ({"nodes": np.zeros((5, 3))}, r"nodes has shape \(5, 3\); use \(\d+, 3\) finite numbers, m"),
        ({"nodes": "shifted"}, "motions of its nodes as a whole it must be: do they stand in the order of its rows"),
        ({"nodes": "given", "frame": "moving", "mass": "lame"}, "mass is not the same for each component of a node"),
        ({"nodes": "given", "outputs": {"tip": np.eye(72)[:, :2]}}, r"outputs\['tip'\] has 2 columns; on a body with"),
        ({"nodes": "given", "mass": "light"}, "mass is not positive definite"),
    ],
)
def test_matrices_that_are_no_body_of_nodes_are_refused(free, choices, message):
    X, M = free.body.nodes, dense(free.mass, free.size)
    light, lame = np.arange(free.size) >= 3, np.tile([1.0, 1.0, 1.5], len(X))
    meant = {"given": X, "shifted": np.roll(X, 1, axis=0)}
    meant |= {name: scale[:, None] * M * scale for name, scale in (("light", light), ("lame", lame))}
    with pytest.raises(StructureError, match=message):
        own(free, **{name: meant.get(word, word) if isinstance(word, str) else word for name, word in choices.items()})


def test_matrices_of_two_rows_a_node_are_refused_by_name():
    K = scipy.sparse.identity(8)
    with pytest.raises(StructureError, match="nodes: the matrices have 8 rows; use three for each node"):
        fr.System(mass=K, stiffness=K, rayleigh=(0, 1e-3), contacts={"tip": np.ones(8)}, nodes=np.zeros((4, 3)))


def test_body_that_is_held_in_part_has_no_moving_frame(mesh):
    with pytest.raises(StructureError, match='frame = "moving": a body that is carried has 3 rigid motions; use'):
        moving(mesh, supports="held = [{ point = [0, 0, 0] }]")
