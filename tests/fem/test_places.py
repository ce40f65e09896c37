"""Places: what each picks of triangles, nodes and cells, how they combine, and that nothing picked is told."""

import numpy as np
import pytest
from bodies import box_arrays, box_surfaces, scene_text, write_arrays

from fenics_rom.errors import FenicsRomError, MeshError, SceneError
from fenics_rom.fem.body_matrices import material_of_cells
from fenics_rom.fem.mesh import read_mesh
from fenics_rom.fem.named_places import survey_places
from fenics_rom.fem.nodes import canonical_nodes
from fenics_rom.fem.outputs import output_rows
from fenics_rom.fem.places import held_nodes, patch_nodes, patch_triangles
from fenics_rom.fem.supports import unknowns_of
from fenics_rom.scene.file import parse_scene

LENGTHS, BRICKS = (1.0, 0.4, 0.3), (5, 4, 3)
WHOLE_EDGE = "along = { points = [[0, 0, 0], [1, 0, 0]] }"
RIM = "along = { points = [[0, 0, 0], [1, 0, 0], [1, 0.4, 0], [0, 0.4, 0], [0, 0, 0]] }"
FLAT_BOX = "box = { corners = [[0.6, 1, 0.3], [-1, -1, 0.3]] }"
DOWN = "facing = { direction = [0, 0, -2] }"


@pytest.fixture(scope="module")
def mesh(tmp_path_factory):
    points, cells = box_arrays(LENGTHS, BRICKS)
    surfaces = box_surfaces(points, cells) | {"inside": cells[30:33, [1, 2, 3]]}
    regions = {"body": np.arange(len(cells)), "half": np.flatnonzero(points[cells].mean(axis=1)[:, 0] < 0.5)}
    return write_arrays(tmp_path_factory.mktemp("places") / "box.msh", points, cells, surfaces, regions)


def scene_of(mesh, place="surface = 'right'", held="", degree=2, **parts):
    parts = {"supports": 'clamped = ["left"]', "outputs.there": place} | parts
    return parse_scene(scene_text(mesh, degree=degree, **parts) + held)


def nodes_of(scene):
    return canonical_nodes(read_mesh(scene.mesh_file, {}), scene.degree)


def of_output(scene):
    nodes = nodes_of(scene)
    return nodes, nodes.coordinates[patch_triangles(nodes, scene.outputs["there"], "outputs.there")]


PICKS = {  # of the centroids of triangles
    'surface = "top"': lambda c: np.isclose(c[:, 2], 0.3),
    "near = { point = [1, 0.2, 0.15], radius = 0.15 }": lambda c: np.linalg.norm(c - [1, 0.2, 0.15], axis=1) <= 0.15,
    "plane = { point = [9, 9, 0], normal = [0, 0, 3] }": lambda c: np.isclose(c[:, 2], 0),
    DOWN: lambda c: np.isclose(c[:, 2], 0),
    FLAT_BOX: lambda c: np.isclose(c[:, 2], 0.3) & (c[:, 0] <= 0.6),
    "along = { points = [[0, 0, 0], [1, 0, 0]], radius = 0.06 }": lambda c: np.linalg.norm(c[:, 1:], axis=1) <= 0.06,
    "inner = false": lambda c: np.isfinite(c[:, 0]),
    f'all = ["top", {{ {FLAT_BOX} }}]': lambda c: np.isclose(c[:, 2], 0.3) & (c[:, 0] <= 0.6),
    f'any = ["left", {{ {DOWN} }}]': lambda c: np.isclose(c[:, 2], 0) | np.isclose(c[:, 0], 0),
    'none = ["left", { any = ["right", "top"] }]': lambda c: (
        ~np.isclose(c[:, 0], 0) & ~np.isclose(c[:, 0], 1) & ~np.isclose(c[:, 2], 0.3)
    ),
}


@pytest.mark.parametrize(("place", "is_in"), PICKS.items(), ids=PICKS)
def test_places_pick_the_triangles_whose_centroids_are_there(mesh, place, is_in):
    nodes, picked = of_output(scene_of(mesh, place))
    everything = nodes.coordinates[nodes.surface]
    expected = everything[is_in(everything.mean(axis=1))]
    assert len(expected) > 0
    np.testing.assert_array_equal(picked, expected)


def test_a_combination_is_read_as_the_surface_that_it_makes(mesh):
    rows = []
    for place in ('surface = "top"', f'any = ["top", {{ all = ["top", {{ {FLAT_BOX} }}] }}]'):
        scene = scene_of(mesh, place)
        nodes = nodes_of(scene)
        rows.append(output_rows(nodes, scene.outputs["there"], unknowns_of(scene, nodes), "outputs.there"))
    np.testing.assert_array_equal(*rows)


HELD = {  # of the places of nodes
    WHOLE_EDGE: lambda x: np.isclose(x[:, 1], 0) & np.isclose(x[:, 2], 0),
    "along = { points = [[0.4, 0, 0], [0.8, 0, 0]] }": lambda x: (
        np.isclose(x[:, 1], 0) & np.isclose(x[:, 2], 0) & (np.abs(x[:, 0] - 0.6) < 0.2001)
    ),
    RIM: lambda x: np.isclose(x[:, 2], 0) & ((np.abs(x[:, 0] - 0.5) > 0.499) | (np.abs(x[:, 1] - 0.2) > 0.199)),
    "box = { corners = [[0.3, 0.1, 0.1], [0.7, 0.3, 0.2]] }": lambda x: (  # inside the body, too
        (np.abs(x - [0.5, 0.2, 0.15]) <= np.array([0.2, 0.1, 0.05]) + 1e-6).all(axis=1)
    ),
    f"any = [{{ {DOWN} }}, {{ {WHOLE_EDGE} }}]": lambda x: np.isclose(x[:, 2], 0),
    'all = ["left", { plane = { point = [0, 0, 0], normal = [0, 0, 1] } }]': lambda x: (  # where two faces meet
        np.isclose(x[:, 0], 0) & np.isclose(x[:, 2], 0)
    ),
    'none = [{ box = { corners = [[0, 0, 0], [0.95, 1, 1]] } }]': lambda x: x[:, 0] > 0.95,
    "point = [1, 0.4, 0.3]": lambda x: np.isclose(x, LENGTHS).all(axis=1),
}  # fmt: skip


@pytest.mark.parametrize(("place", "is_in"), HELD.items(), ids=HELD)
def test_supports_hold_the_nodes_that_are_there(mesh, place, is_in):
    scene = scene_of(mesh, held=f"\n[[supports.held]]\n{place}")
    nodes = nodes_of(scene)
    held = held_nodes(nodes, scene.held[0], "supports.held[0]")
    np.testing.assert_array_equal(held, np.flatnonzero(is_in(nodes.coordinates)))
    assert 0 < len(held) < len(nodes.coordinates) / 2


def test_supports_near_a_point_hold_the_nodes_of_triangles(mesh):
    near = "near = { point = [1, 0, 0], radius = 0.15 }"
    scene = scene_of(mesh, near, f"\n[[supports.held]]\n{near}")
    nodes = nodes_of(scene)
    held = held_nodes(nodes, scene.held[0], "")
    np.testing.assert_array_equal(held, patch_nodes(nodes, scene.outputs["there"], ""))
    assert np.linalg.norm(nodes.coordinates[held] - [1, 0, 0], axis=1).max() > 0.15


def test_one_line_holds_what_an_entry_for_each_node_does(mesh):
    """The lower edges of a plate, as of NAFEMS' FV52, which took an entry for each node."""
    one = scene_of(mesh, held=f"\n[[supports.held]]\n{RIM}\nnormal = [0, 0, 1]")
    nodes = nodes_of(one)
    each = "".join(
        f"\n[[supports.held]]\npoint = {nodes.coordinates[node].tolist()}\nnormal = [0, 0, 1]"
        for node in held_nodes(nodes, one.held[0], "")
    )
    expected = unknowns_of(scene_of(mesh, held=each), nodes)
    np.testing.assert_array_equal(unknowns_of(one, nodes).free, expected.free)


def test_clamped_and_rigid_are_names_or_places(mesh):
    by_name = scene_of(mesh, supports='clamped = ["left", "inside"]\nrigid = ["right"]')
    place = "{ plane = { point = [1, 0, 0], normal = [1, 0, 0] } }"
    text = f'clamped = [{{ any = ["left"] }}, {{ surface = "inside" }}]\nrigid = [{place}]'
    by_place, nodes = scene_of(mesh, supports=text), nodes_of(by_name)
    first, second = (unknowns_of(scene, nodes) for scene in (by_name, by_place))
    np.testing.assert_array_equal(first.free, second.free)
    np.testing.assert_array_equal(first.weights.toarray(), second.weights.toarray())
    assert '"clamped": ["inside", "left"]' in by_name.environment.built_in["supports"]  # as ROMs before have it


SOFT = "young = 1.0\npoisson = 0.3\ndensity = 1.0"
STIFF = SOFT.replace("1.0", "2.0", 1)


@pytest.mark.parametrize(
    ("place", "is_in"),
    [
        ("box = { corners = [[0, 0, 0], [0.5, 1, 1]] }", lambda c: c[:, 0] <= 0.5),
        ('all = ["half", { none = [{ near = { point = [0, 0, 0], radius = 0.3 } }] }]',
         lambda c: (c[:, 0] < 0.5) & (np.linalg.norm(c, axis=1) > 0.3)),
        ("along = { points = [[0, 0, 0], [1, 0.4, 0.3]], radius = 0.1 }",
         lambda c: np.linalg.norm(np.cross(c, np.array(LENGTHS) / np.linalg.norm(LENGTHS)), axis=1) <= 0.1),
    ],
)  # fmt: skip
def test_materials_are_of_the_cells_whose_centroids_are_there(mesh, place, is_in):
    two = {
        "material": None,
        "materials.stiff": f"{place}\n{STIFF}",
        "materials.soft": f"none = [{{ {place} }}]\n{SOFT}",
    }
    scene = scene_of(mesh, **two)
    points = read_mesh(mesh, {})
    stiff = is_in(points.points[points.cells].mean(axis=1))
    moduli = material_of_cells(scene, points)[:, 1] * 2 * 1.3
    np.testing.assert_allclose(moduli, np.where(stiff, 2.0, 1.0), rtol=1e-14)
    assert stiff.any()
    assert not stiff.all()
    shared = scene_of(mesh, **(two | {"materials.soft": f'cells = "body"\n{SOFT}'}))
    with pytest.raises(SceneError, match=f"materials.soft: {stiff.sum()} of its cells already have a material"):
        material_of_cells(shared, points)


NOTHING = {
    "box = { corners = [[2, 0, 0], [3, 1, 1]] }": (
        r"there.box: no surface triangle has its centroid in it; the nearest is 1 m away, at \[1.0, "
    ),
    WHOLE_EDGE: r"there.along: no surface triangle has its centroid within 1e-06 m of the line; .* is 0.0\d+ m away",
    'all = ["left", "right"]': r"there.all: no surface triangle is in all of its places, which pick 24, 24 of 188",
    'none = [{ any = ["left", { inner = false }] }]': r"there.none: .* in none of its places, which pick 188 of 188",
    'any = ["top", { near = { point = [9, 0, 0], radius = 1 } }]': r"there.any\[1\].near.radius = 1: no surface",
    'any = ["top", "botom"]': r"no surface 'botom'.* did you mean 'bottom'",
    'surface = "inside"': "3 of its 3 triangles are not on the boundary",
    "inner = true": "there.inner: the body has no chamber: the surface has no hollow",
}


@pytest.mark.parametrize(("place", "message"), NOTHING.items(), ids=NOTHING)
def test_a_place_that_picks_nothing_says_what_is_near(mesh, place, message):
    with pytest.raises(FenicsRomError, match=message):
        of_output(scene_of(mesh, place))


def test_supports_and_materials_that_pick_nothing_say_what_is_near(mesh):
    off = "along = { points = [[0, 0, 0.01], [1, 0, 0.01]] }"
    scene = scene_of(mesh, held=f"\n[[supports.held]]\n{off}")
    with pytest.raises(
        SceneError, match=r"held\[0\].along: no node is within 1e-06 m of .* nearest is 0.01 m away, at"
    ):
        unknowns_of(scene, nodes_of(scene))
    scene = scene_of(mesh, material=None, **{"materials.a": f"near = {{ point = [9, 0, 0], radius = 1 }}\n{SOFT}"})
    with pytest.raises(SceneError, match=r"materials.a.near.radius = 1: no cell has its centroid that close"):
        material_of_cells(scene, read_mesh(mesh, {}))


def test_a_survey_counts_and_measures_every_place_and_group(mesh):
    scene = scene_of(
        mesh,
        FLAT_BOX,
        f"\n[[supports.held]]\n{WHOLE_EDGE}",
        effects='inertia = {}\npressure.air = { surface = "top" }',
        material=None,
        **{
            "materials.all": f'any = ["half", {{ none = ["half"] }}]\n{SOFT}',
            "readings.gauge": f'quantity = "strain"\n{DOWN}',
        },
    )
    survey = survey_places(scene)
    places = {place.name: place for place in survey.places}
    assert [*places][:3] == ["supports.clamped[0]", "supports.held[0]", "contacts.right"]
    assert {"contacts.top", "outputs.there", "readings.gauge", "effects.pressure.air", "mesh: half"} < {*places}
    edge, box, everything = (places[name] for name in ("supports.held[0]", "outputs.there", "materials.all"))
    assert (edge.kind, edge.count, edge.size) == ("nodes", 2 * BRICKS[0] + 1, 0)
    np.testing.assert_allclose(edge.corners, [[0, 0, 0], [1, 0, 0]])
    assert (box.kind, box.count, len(box.nodes)) == ("triangles", 3 * 4 * 2, 7 * 9)
    assert box.size == pytest.approx(0.6 * 0.4)
    np.testing.assert_allclose(box.corners, [[0, 0, 0.3], [0.6, 0.4, 0.3]])
    assert (everything.kind, everything.count) == ("cells", np.prod(BRICKS) * 6)
    assert everything.size == pytest.approx(np.prod(LENGTHS))
    assert len(everything.triangles) == len(survey.surface)
    assert places["mesh: inside"].kind == "nodes"
    assert survey.mistakes == ()


def test_a_survey_shows_the_other_places_where_some_pick_nothing(mesh):
    survey = survey_places(scene_of(mesh, "inner = true"))
    assert "contacts.top" in [place.name for place in survey.places]
    assert survey.mistakes == ("outputs.there.inner: the body has no chamber: the surface has no hollow",)


def test_patches_of_a_box_are_those_of_its_surface(mesh):
    nodes = nodes_of(scene_of(mesh))
    whole, by_name = (scene_of(mesh, place).outputs["there"] for place in (DOWN, 'surface = "bottom"'))
    np.testing.assert_array_equal(patch_nodes(nodes, whole, ""), patch_nodes(nodes, by_name, ""))
    with pytest.raises(MeshError, match="no surface 'down'"):
        patch_nodes(nodes, scene_of(mesh, 'surface = "down"').outputs["there"], "")
