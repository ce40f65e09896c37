"""Patches and outputs: forces add up, shapes are read exactly, and what cannot be is said in one line."""

import numpy as np
import pytest
from bodies import assembled, box_arrays, box_surfaces, write_arrays

import fenics_rom as fr
from fenics_rom.errors import MeshError, SceneError
from fenics_rom.fem.mesh import read_mesh
from fenics_rom.fem.nodes import canonical_nodes

LENGTHS, BRICKS = (1.0, 0.4, 0.3), (4, 3, 3)
CLAMPED_SHARE = LENGTHS[0] / BRICKS[0] / 2  # of a force on a long side, per unit length: the clamped row's half brick
DEGREES = pytest.mark.parametrize("degree", [1, 2])


@pytest.fixture(scope="module")
def mesh(tmp_path_factory):
    """A shaken box with groups that overlap, that touch the clamp, and that are no part of the boundary."""
    points, cells = box_arrays(LENGTHS, BRICKS, shake=0.2)
    faces = box_surfaces(points, cells)
    x, y = np.moveaxis(points[faces["top"]].mean(axis=1)[:, :2], 1, 0)
    faces |= {
        "front third": faces["top"][y < 0.13],
        "rest": faces["top"][y > 0.13],
        "two thirds": faces["top"][x > 0.25],
        "edge": np.concatenate([faces["right"], faces["top"]]),
        "inside": cells[:3, [1, 2, 3]],
    }
    return write_arrays(tmp_path_factory.mktemp("nodes") / "box.msh", points, cells, faces)


def with_patches(mesh, degree=1, /, **contacts):
    """Contact columns of patches given as (surface, force)."""
    text = "\n".join(f'[contacts.{n}]\nsurface = "{surface}"\nforce = "{f}"' for n, (surface, f) in contacts.items())
    return assembled(mesh, degree=degree, contacts=text)


def resultant(system, columns):
    """Sum of the nodal forces of each column, (columns, 3)."""
    return np.stack([columns[system.body.free % 3 == axis].sum(axis=0) for axis in range(3)], axis=1)


def moment(system, columns):
    """Sum of x × f of each column, (columns, 3)."""
    forces = np.zeros((3 * len(system.body.nodes), columns.shape[1]))
    forces[system.body.free] = columns
    return np.cross(system.body.nodes[:, :, None], forces.reshape(-1, 3, columns.shape[1]), axis=1).sum(axis=0).T


@DEGREES
def test_resultant_is_one_newton_at_the_middle_of_the_patch(mesh, degree):
    system = with_patches(mesh, degree, right=("right", "resultant"))
    columns = system.contacts["right"]
    np.testing.assert_allclose(resultant(system, columns), np.eye(3), atol=1e-14)
    middle = np.array([1.0, 0.2, 0.15])
    np.testing.assert_allclose(moment(system, columns), np.cross(middle, np.eye(3)), atol=1e-14)


@DEGREES
@pytest.mark.parametrize(("face", "inward"), [("right", [-1, 0, 0]), ("top", [0, 0, -1]), ("front", [0, 1, 0])])
def test_normal_force_of_a_flat_face_points_inward(mesh, degree, face, inward):
    system = with_patches(mesh, degree, face=(face, "normal"), all=(face, "resultant"))
    columns = system.contacts["face"]
    assert columns.shape == (system.size, 1)
    np.testing.assert_allclose(columns[:, 0], system.contacts["all"] @ inward, atol=1e-15)


def test_normal_force_of_a_bent_patch_is_its_projection(mesh):
    """Pressure on two faces: each takes its share of the area, along its own normal."""
    system = with_patches(mesh, bent=("edge", "normal"), one=("right", "normal"), two=("top", "normal"))
    right, top = LENGTHS[1] * LENGTHS[2], LENGTHS[0] * LENGTHS[1]
    expected = (right * system.contacts["one"] + top * system.contacts["two"]) / (right + top)
    np.testing.assert_allclose(system.contacts["bent"], expected, atol=1e-15)


@DEGREES
def test_nodal_force_has_a_column_for_each_free_displacement_of_the_patch(mesh, degree):
    system = with_patches(mesh, degree, top=("top", "nodal"))
    columns = system.contacts["top"]
    rows = (degree * BRICKS[0]) * (degree * BRICKS[1] + 1)  # the row on the clamp is not free
    assert columns.shape == (system.size, 3 * rows)
    assert set(np.unique(columns)) == {0.0, 1.0}
    moved = system.body.free[columns.any(axis=1)]
    np.testing.assert_allclose(system.body.nodes[moved // 3, 2], LENGTHS[2])
    np.testing.assert_array_equal(columns.sum(axis=0), 1)


@DEGREES
def test_patch_that_touches_the_clamp_gives_the_clamp_its_share(mesh, degree):
    """Degree 1: the hat functions of the clamped row sum to 1 - x/h, half a brick of 1. Degree 2: its mid-sides."""
    system = with_patches(mesh, degree, top=("top", "resultant"))
    share = CLAMPED_SHARE if degree == 1 else CLAMPED_SHARE / 3
    np.testing.assert_allclose(resultant(system, system.contacts["top"]), (1 - share) * np.eye(3), atol=1e-13)


@DEGREES
def test_patches_may_be_separate_overlap_or_nest(mesh, degree):
    """Each facet counts in every group that it is in: parts weigh their areas, whatever else overlaps them."""
    patches = {"whole": "top", "front": "front third", "rest": "rest", "nested": "two thirds"}
    system = with_patches(mesh, degree, **{name: (surface, "resultant") for name, surface in patches.items()})
    whole, front, rest, nested = (system.contacts[name] for name in patches)
    triangles = read_mesh(mesh, {})
    area = {name: len(triangles.surface(name)) for name in patches.values()}  # all triangles of the top are alike
    assert area["top"] == 3 * area["front third"] == 1.5 * area["rest"]
    parts = (area["front third"] * front + area["rest"] * rest) / area["top"]
    np.testing.assert_allclose(whole, parts, atol=1e-15)
    np.testing.assert_allclose(resultant(system, nested), np.eye(3), atol=1e-14)
    assert (np.abs(nested).sum(axis=0) > 0.5).all()


@pytest.mark.parametrize("force", ["resultant", "normal", "nodal"])
def test_patch_that_cannot_move_is_refused(mesh, force):
    with pytest.raises(SceneError, match=r"contacts.held: the whole patch is clamped"):
        with_patches(mesh, held=("left", force))


@pytest.mark.parametrize(
    ("surface", "message"),
    [
        ("tap", "no surface 'tap'; there is .* did you mean 'top'"),
        ("body", "no surface 'body'"),
        ("inside", "3 of its 3 triangles are not on the boundary of the body"),
    ],
)
def test_surface_that_is_none_is_refused(mesh, surface, message):
    with pytest.raises(MeshError, match=message):
        with_patches(mesh, tip=(surface, "resultant"))


def near(mesh, point, radius):
    return assembled(mesh, contacts=f"[contacts.spot]\nnear = {{ point = {point}, radius = {radius} }}")


def test_near_takes_the_surface_triangles_whose_centroids_are_close(mesh):
    point, radius = np.array([1.0, 0.2, 0.15]), 0.11
    system = near(mesh, point.tolist(), radius)
    points, cells = box_arrays(LENGTHS, BRICKS, shake=0.2)
    right = box_surfaces(points, cells)["right"]
    chosen = right[np.linalg.norm(points[right].mean(axis=1) - point, axis=1) <= radius]
    assert 0 < len(chosen) < len(right)
    expected = np.zeros(len(points))
    np.add.at(expected, chosen, 1 / (3 * len(chosen)))  # all triangles of the face are alike
    np.testing.assert_allclose(system.contacts["spot"][system.body.free % 3 == 0, 0], expected[points[:, 0] > 0])


def test_near_that_reaches_nothing_says_how_far_it_is(mesh):
    with pytest.raises(SceneError, match=r"contacts.spot.near.radius = 0.01: .* the nearest is 1 m away"):
        near(mesh, [2.0, 0.2, 0.15], 0.01)


def test_actuators_are_the_last_columns_of_every_contact_mode(box_system):
    pull = box_system.actuators["pull"]
    np.testing.assert_allclose(resultant(box_system, pull), [[0, -1 + 0.125, 0]], atol=1e-14)
    for name, columns in box_system.contacts.items():
        np.testing.assert_array_equal(box_system.input_matrix(name), np.hstack([columns, pull]))


FIELDS = {  # of degree 1 or 2, zero on the clamp
    1: [lambda p: p[:, [0]] * [1.0, -2.0, 0.5]],
    2: [lambda p: p[:, [0]] * p, lambda p: p[:, [0]] * [[1.0, 0.0, -3.0]] + p[:, [0]] ** 2],
}


def output(mesh, degree, text):
    system = assembled(mesh, degree=degree, **{"outputs.tip": text})
    return system, system.outputs["tip"]


@pytest.mark.parametrize(("degree", "field"), [(d, f) for d, fields in FIELDS.items() for f in fields])
def test_points_are_read_exactly_from_fields_that_the_elements_hold(mesh, degree, field):
    points = np.random.default_rng(0).uniform(0, LENGTHS, (20, 3))
    points[:3] = LENGTHS, (0.5, 0.0, 0.3), (0.0, 0.1, 0.1)
    system, rows = output(mesh, degree, f"points = {points.tolist()}")
    x = field(system.body.nodes).ravel()[system.body.free]
    assert rows.shape == (system.size, 60)
    assert np.abs((x @ rows).reshape(-1, 3) - field(points)).max() <= 2e-14


@DEGREES
def test_point_just_outside_is_read_at_the_nearest_cell_and_one_far_outside_is_refused(mesh, degree):
    system, rows = output(mesh, degree, "points = [[1.005, 0.2, 0.15]]")
    x = FIELDS[1][0](system.body.nodes).ravel()[system.body.free]
    np.testing.assert_allclose(x @ rows, [1.0, -2.0, 0.5], rtol=1e-2)
    with pytest.raises(SceneError, match=r"outputs.tip: point \[1.05, 0.2, 0.15\] is 0.05\d* m outside the body"):
        output(mesh, degree, "points = [[1.05, 0.2, 0.15]]")


@DEGREES
def test_output_of_a_surface_is_the_mean_over_it(mesh, degree):
    system, rows = output(mesh, degree, 'surface = "right"')
    field = FIELDS[degree][0]
    x = field(system.body.nodes).ravel()[system.body.free]
    mean = [1.0, -2.0, 0.5] if degree == 1 else [1.0, 0.2, 0.15]
    np.testing.assert_allclose(x @ rows, mean, rtol=1e-13)


@DEGREES
def test_clamp_holds_every_node_of_its_surface_and_no_other(mesh, degree):
    body = with_patches(mesh, degree, right=("right", "resultant")).body
    held = np.setdiff1d(np.arange(3 * len(body.nodes)), body.free)
    np.testing.assert_array_equal(np.unique(held // 3), np.flatnonzero(body.nodes[:, 0] == 0))


@DEGREES
def test_drawn_surface_is_closed_and_points_outward(mesh, degree):
    """The divergence theorem: ∫ x·n dA = 3 V, and the areas are those of the box."""
    body = with_patches(mesh, degree, right=("right", "resultant")).body
    a, b, c = (body.nodes[body.triangles[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a) / 2
    assert np.einsum("ij,ij->", (a + b + c) / 3, normals) == pytest.approx(3 * np.prod(LENGTHS), rel=1e-13)
    area = 2 * (LENGTHS[0] * LENGTHS[1] + LENGTHS[1] * LENGTHS[2] + LENGTHS[2] * LENGTHS[0])
    assert np.linalg.norm(normals, axis=1).sum() == pytest.approx(area, rel=1e-13)


def test_canonical_nodes_are_the_vertices_of_the_file_then_the_middles_of_their_edges(mesh):
    points, _ = box_arrays(LENGTHS, BRICKS, shake=0.2)
    nodes = canonical_nodes(read_mesh(mesh, {}), 2)
    np.testing.assert_allclose(nodes.coordinates[: len(points)], points, atol=1e-15)
    ends = nodes.edges
    assert (ends[:, 0] < ends[:, 1]).all()
    assert (np.diff(ends[:, 0] * len(points) + ends[:, 1]) > 0).all()
    np.testing.assert_allclose(nodes.coordinates[len(points) :], (points[ends[:, 0]] + points[ends[:, 1]]) / 2)


def test_run_reads_the_same_output_as_the_shape_at_that_node(mesh):
    system = assembled(
        mesh,
        degree=2,
        **{
            "outputs.tip": "points = [[1.0, 0.4, 0.3]]",
            "run": 'dt = 0.01\nduration = 0.1\nload = [{ contact = "right", force = [0.0, 1.0, 0.0] }]',
        },
    )
    run = fr.simulate(system)
    corner = np.linalg.norm(run.nodes - LENGTHS, axis=1).argmin()
    np.testing.assert_allclose(run.outputs["tip"][-1, 0], run.snapshots[-1, corner], rtol=1e-12)
    assert np.abs(run.snapshots[-1, corner]).max() > 0
