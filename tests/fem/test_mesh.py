"""Mesh files: the same body from every format, and one line about what cannot be used."""

import gmsh
import h5py
import numpy as np
import pytest
from bodies import assembled, box_arrays, box_surfaces, dense, scene_text, write_arrays, write_box
from dolfinx.io import XDMFFile
from dolfinx.mesh import locate_entities, locate_entities_boundary, meshtags
from mpi4py import MPI

import fenics_rom as fr
from fenics_rom.errors import MeshError
from fenics_rom.fem.dolfinx_compat import create_cells
from fenics_rom.fem.mesh import read_mesh
from fenics_rom.fem.partition import bisect_cells
from fenics_rom.scene.file import parse_scene

LENGTHS = (1.0, 0.4, 0.3)
TAGS = {"left": 1, "right": 2, "top": 3}
GROUPS = "\n".join(f"{name} = {tag}" for name, tag in TAGS.items()) + "\nsoft = 4\nstiff = 5"
TWO_MATERIALS = {
    "material": None,
    "materials.soft": 'young = 1e6\npoisson = 0.3\ndensity = 1000\ncells = "soft"',
    "materials.stiff": 'young = 5e6\npoisson = 0.1\ndensity = 3000\ncells = "stiff"',
    "reduction": "order = 8",
}


def regions_of(points, cells):
    x = points[cells].mean(axis=1)[:, 0]
    return {"soft": np.flatnonzero(x < 0.5), "stiff": np.flatnonzero(x > 0.5)}


def write_xdmf(path, points, cells, twice=False):
    """As a user of dolfinx writes it: the mesh, facet tags and cell tags."""
    domain = create_cells(MPI.COMM_SELF, cells, points)
    ends = {"left": (0, 0.0), "right": (0, 1.0), "top": (2, 0.3)}
    facets, values = [], []
    for name, (axis, end) in ends.items():
        found = locate_entities_boundary(domain, 2, lambda x, axis=axis, end=end: np.isclose(x[axis], end))
        facets, values = [*facets, *found], [*values, *[TAGS[name]] * len(found)]
    cell_values = np.full(len(cells), 5, dtype=np.int32)
    cell_values[locate_entities(domain, 3, lambda x: x[0] <= 0.5 + 1e-9)] = 4
    order = np.argsort(facets)
    surfaces = meshtags(domain, 2, np.array(facets, dtype=np.int32)[order], np.array(values, dtype=np.int32)[order])
    regions = meshtags(domain, 3, np.arange(len(cells), dtype=np.int32), cell_values)
    surfaces.name, regions.name = "surfaces", "regions"
    domain.topology.create_connectivity(2, 3)
    with XDMFFile(MPI.COMM_SELF, str(path), "w") as file:
        file.write_mesh(domain)
        for tags in (surfaces, regions):
            write_tags(file, tags, domain)
        if twice:
            surfaces.name = "others"
            write_tags(file, surfaces, domain)
    return path


def write_tags(file, tags, domain):
    try:
        file.write_meshtags(tags, domain.geometry)
    except TypeError:  # dolfinx 0.5
        file.write_meshtags(tags)


def in_order_of_place(system):
    """M and K with the unknowns sorted by where they are, and their contact columns."""
    points = system.body.nodes[system.body.free // 3].round(9)
    order = np.lexsort((system.body.free % 3, *points.T))
    M, K = (dense(matrix, system.size)[np.ix_(order, order)] for matrix in (system.mass, system.stiffness))
    return M, K, np.hstack([columns[order] for columns in system.contacts.values()])


@pytest.fixture(scope="module")
def arrays():
    points, cells = box_arrays(LENGTHS, (4, 2, 2), shake=0.2)
    return points, cells, box_surfaces(points, cells), regions_of(points, cells)


@pytest.fixture(scope="module")
def reference(arrays, tmp_path_factory):
    return assembled(write_arrays(tmp_path_factory.mktemp("reference") / "box.msh", *arrays), **TWO_MATERIALS)


def renumbered(points, cells, surfaces, regions):
    """The same mesh, its nodes in another order, and half of its cells inverted."""
    order = np.random.default_rng(0).permutation(len(points))
    place = np.argsort(order)
    cells = place[cells]
    cells[::2, :2] = cells[::2, 1::-1]
    return points[order], cells, {name: place[surface] for name, surface in surfaces.items()}, regions


def with_orphans(points, cells, surfaces, regions):
    """Nodes of no cell among the others."""
    orphans = np.array([[0.0, 0.0, 0.0], [9.0, 9.0, 9.0]])
    surfaces = {name: surface + 2 for name, surface in surfaces.items()}
    return np.concatenate([orphans, points]), cells + 2, surfaces, regions


@pytest.mark.parametrize("change", [renumbered, with_orphans])
@pytest.mark.parametrize("version", [4.1, 2.2])
def test_numbering_orientation_orphans_and_version_of_the_file_do_not_matter(
    arrays, reference, tmp_path, change, version
):
    points, cells, surfaces, regions = change(*arrays)
    regions = regions | {"all": np.arange(len(cells))}  # a cell in two groups is twice in a file of version 2
    mesh = write_arrays(tmp_path / "other.msh", points, cells, surfaces, regions, version)
    system = assembled(mesh, **TWO_MATERIALS)
    assert np.array_equal(system.body.nodes.max(axis=0), LENGTHS)
    for one, other in zip(in_order_of_place(system), in_order_of_place(reference), strict=True):
        assert np.abs(one - other).max() <= 1e-13 * np.abs(other).max()


def shuffle(path):
    """Renumbers the nodes of an XDMF file, which dolfinx writes in the order in which it will have them again."""
    with h5py.File(path.with_suffix(".h5"), "r+") as file:
        mesh = file["Mesh/mesh"]
        order = np.random.default_rng(0).permutation(len(mesh["geometry"]))
        mesh["geometry"][...] = mesh["geometry"][()][order]
        for part in (mesh, *file["MeshTags"].values()):
            part["topology"][...] = np.argsort(order)[part["topology"][()]]


@pytest.mark.parametrize("shuffled", [False, True])
def test_xdmf_with_tags_is_the_same_body(arrays, reference, tmp_path, shuffled):
    mesh = write_xdmf(tmp_path / "box.xdmf", *arrays[:2])
    if shuffled:
        shuffle(mesh)
    system = assembled(mesh, **{"mesh.groups": GROUPS}, **TWO_MATERIALS)
    for one, other in zip(in_order_of_place(system), in_order_of_place(reference), strict=True):
        assert np.abs(one - other).max() <= 1e-13 * np.abs(other).max()
    one, other = fr.reduce(system), fr.reduce(reference)
    for name, mode in other.contact_models.items():
        σ = one.contact_models[name].hankel_singular_values
        np.testing.assert_allclose(σ[:8], mode.hankel_singular_values[:8], rtol=1e-9)


def test_tags_of_xdmf_are_also_a_group_of_their_own_name(arrays, tmp_path):
    mesh = read_mesh(write_xdmf(tmp_path / "box.xdmf", *arrays[:2]), {"tip": 2})
    faces = arrays[2]
    assert len(mesh.surface("surfaces")) == sum(len(faces[name]) for name in TAGS)
    assert len(mesh.surface("tip")) == len(faces["right"])
    assert len(mesh.region("regions")) == len(arrays[1])


def test_tag_that_could_mean_either_of_two_groups_is_refused(arrays, tmp_path):
    mesh = write_xdmf(tmp_path / "box.xdmf", *arrays[:2], twice=True)
    with pytest.raises(MeshError, match="group 'root' is in 'others' and in other tags before it"):
        read_mesh(mesh, {"root": 1})
    assert len(read_mesh(mesh, {}).surface("others")) == len(read_mesh(mesh, {}).surface("surfaces"))


def test_groups_name_the_tags_that_have_no_name_in_gmsh(arrays, tmp_path):
    mesh = write_arrays(tmp_path / "named.msh", *arrays, version=2.2)
    text = mesh.read_text()
    start, end = text.index("$PhysicalNames"), text.index("$EndPhysicalNames\n") + len("$EndPhysicalNames\n")
    nameless = tmp_path / "nameless.msh"
    nameless.write_text(text[:start] + text[end:])
    with pytest.raises(MeshError, match="no surface 'left'; there is none"):
        read_mesh(nameless, {}).surface("left")
    tag = int(text[start:end].split(' "left"')[0].split()[-1])
    named = read_mesh(nameless, {"root": tag})
    np.testing.assert_array_equal(named.surface("root"), read_mesh(mesh, {}).surface("left"))


def test_two_physical_groups_of_one_name_are_one_group(arrays, tmp_path):
    points, cells, faces, regions = arrays
    mesh = write_arrays(tmp_path / "box.msh", points, cells, {"left": faces["left"], "lefu": faces["right"]}, regions)
    mesh.write_text(mesh.read_text().replace("lefu", "left").replace("stiff", "soft"))
    both = read_mesh(mesh, {})
    assert len(both.surface("left")) == 2 * len(faces["left"])
    assert len(both.region("soft")) == len(cells)


def test_clamp_that_is_no_face_of_the_cells_is_refused(arrays, tmp_path):
    points, cells, faces, regions = arrays
    shell = np.array([[0, 1, len(points)]])  # with a node of no cell
    mesh = write_arrays(tmp_path / "b.msh", np.vstack([points, [9, 9, 9]]), cells, faces | {"shell": shell}, regions)
    with pytest.raises(MeshError, match="surface 'shell': 1 of its 1 triangles are not faces of the cells"):
        assembled(mesh, supports='clamped = ["left", "shell"]')


def write_gmsh(path, make):
    gmsh.initialize([], readConfigFiles=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        make()
        gmsh.write(str(path))
    finally:
        gmsh.finalize()


def surface_only():
    gmsh.model.occ.addBox(0, 0, 0, 1, 1, 1)
    gmsh.model.occ.synchronize()
    gmsh.model.mesh.generate(2)


def second_order():
    gmsh.model.occ.addBox(0, 0, 0, 1, 1, 1)
    gmsh.model.occ.synchronize()
    gmsh.model.mesh.generate(3)
    gmsh.model.mesh.setOrder(2)


def geometry_only():
    gmsh.model.occ.addBox(0, 0, 0, 1, 1, 1)
    gmsh.model.occ.synchronize()


@pytest.mark.parametrize(
    ("make", "message"), [(surface_only, "holds no tetrahedra"), (geometry_only, "holds no nodes")]
)
def test_gmsh_file_without_straight_tetrahedra_is_refused(tmp_path, make, message):
    write_gmsh(tmp_path / "other.msh", make)
    with pytest.raises(MeshError, match=message):
        read_mesh(tmp_path / "other.msh", {})


def test_cell_without_volume_is_refused(arrays, tmp_path):
    points, cells, *_ = arrays
    flat = np.vstack([cells, [0, 1, 2, 0]])
    flat[-1, 3] = flat[-1, 0]
    mesh = write_arrays(tmp_path / "flat.msh", points, flat, arrays[2])
    with pytest.raises(MeshError, match=f"1 of {len(flat)} cells have no volume, e.g. cell {len(cells)}"):
        read_mesh(mesh, {})


def test_empty_group_is_said_to_be_empty(arrays, tmp_path):
    full = write_arrays(tmp_path / "full.msh", *arrays)

    def with_nothing():
        gmsh.merge(str(full))
        gmsh.model.addDiscreteEntity(2, 99)
        gmsh.model.setPhysicalName(2, gmsh.model.addPhysicalGroup(2, [99]), "nothing")

    write_gmsh(tmp_path / "box.msh", with_nothing)
    with pytest.raises(MeshError, match="surface 'nothing' is empty"):
        assembled(tmp_path / "box.msh", supports='clamped = ["nothing"]')


def truncated(path, arrays):
    whole = write_arrays(path.with_suffix(".whole.msh"), *arrays).read_bytes()
    path.write_bytes(whole[: len(whole) // 2])


def not_finite(path, arrays):
    points, cells, faces, regions = arrays
    text = write_arrays(path, points, cells, faces, regions, 2.2).read_text()
    path.write_text(text.replace("\n1 0 0 0\n", "\n1 0 0 nan\n"))


def without_its_h5(path, arrays):
    write_xdmf(path, *arrays[:2])
    path.with_suffix(".h5").unlink()


def surface_xdmf(path, arrays):
    from dolfinx.mesh import create_unit_square

    with XDMFFile(MPI.COMM_SELF, str(path), "w") as file:
        file.write_mesh(create_unit_square(MPI.COMM_SELF, 2, 2))


def mixed(path, arrays):
    path.write_text('<Xdmf><Domain><Grid><Topology TopologyType="Mixed"/></Grid></Domain></Xdmf>')


BAD_FILES = {
    "missing.msh": (lambda path, arrays: None, "not found"),
    "folder.msh": (lambda path, arrays: path.mkdir(), "not found"),
    "part.stl": (
        lambda path, arrays: path.write_text("solid"),
        r"use a file that ends .*; fenics-rom mesh part\.stl -o",
    ),
    "garbage.msh": (lambda path, arrays: path.write_bytes(bytes(range(256))), "is not in Gmsh's MSH format"),
    "empty.msh": (lambda path, arrays: path.touch(), "is not in Gmsh's MSH format"),
    "script.msh": (lambda path, arrays: path.write_text(f'SystemCall "touch {path}.ran";'), "is not in Gmsh's MSH"),
    "future.msh": (lambda path, arrays: path.write_text("$MeshFormat\n9 0 8\n$EndMeshFormat\n"), "version 9"),
    "truncated.msh": (truncated, r"ends within \$Elements: it was cut"),
    "nan.msh": (not_finite, "coordinates that are not finite"),
    "garbage.xdmf": (lambda path, arrays: path.write_bytes(bytes(range(256))), "cannot be read as XDMF"),
    "empty.xdmf": (lambda path, arrays: path.touch(), "cannot be read as XDMF"),
    "other.xdmf": (lambda path, arrays: path.write_text("<html/>"), "cannot be read as XDMF"),
    "torn.xdmf": (without_its_h5, "cannot be read as XDMF"),
    "surface.xdmf": (surface_xdmf, "holds cells of type triangle; use tetrahedron, "),
    "mixed.xdmf": (mixed, "holds cells of type mixed; use tetrahedron, tet"),
}


@pytest.mark.parametrize("name", BAD_FILES)
def test_file_that_cannot_be_used_is_named_in_one_line(arrays, tmp_path, name):
    make, message = BAD_FILES[name]
    make(tmp_path / name, arrays)
    with pytest.raises(MeshError, match=message) as caught:
        fr.assemble(parse_scene(scene_text(tmp_path / name)))
    assert str(tmp_path / name) in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / f"{name}.ran").exists()


def test_boxes_of_gmsh_and_of_these_tests_are_the_same_body(tmp_path):
    """Two generators, one closed form: the compliance of a bar with ν = 0."""
    bar = {"material": "young = 1e6\npoisson = 0.0\ndensity = 1000.0"}
    for mesh in (
        write_box(tmp_path / "gmsh.msh", LENGTHS, (3, 2, 2)),
        write_arrays(tmp_path / "own.msh", *box_arrays(LENGTHS, (3, 2, 2))),
    ):
        system = assembled(mesh, **bar)
        pull = system.contacts["right"][:, 0]
        compliance = pull @ np.linalg.solve(dense(system.stiffness, system.size), pull)
        assert compliance == pytest.approx(1.0 / (1e6 * 0.4 * 0.3), rel=1e-12)


@pytest.mark.parametrize("ranks", [1, 2, 3, 7, 300])
def test_ranks_share_cells_evenly_in_slabs(ranks):
    centres = np.random.default_rng(0).uniform(size=(200, 3)) * (9.0, 1.0, 1.0)
    owner = bisect_cells(centres, ranks)
    counts = np.bincount(owner, minlength=ranks)
    assert counts.max() - counts.min() <= 2
    if ranks <= 7:  # more share slabs
        assert np.all(np.diff(owner[np.argsort(centres[:, 0])]) >= 0)
