"""Files that lie: counts that do not hold, nodes without cells, cells that are missing."""

import re

import numpy as np
import pytest
from bodies import assembled, box_arrays, box_surfaces, write_arrays
from test_foreign_meshes import second_order, write_inp, write_vtk, write_vtu

from fenics_rom.errors import MeshError
from fenics_rom.fem.mesh import oriented, read_mesh
from fenics_rom.fem.mesh_gaps import closed_surfaces
from fenics_rom.fem.mesh_quality import faces_of, signed_volumes

LENGTHS, BRICKS = (0.8, 0.4, 0.3), (4, 3, 3)
MSH = [(2.2, False), (2.2, True), (4.1, False), (4.1, True)]  # versions, and whether binary


@pytest.fixture(scope="module")
def box():
    points, cells = box_arrays(LENGTHS, BRICKS, shake=0.2)
    return points, oriented(points, cells)


def with_count(content, section, count, version, binary):
    """The same file, which says another number of nodes or elements."""
    start = content.index(b"$%b\n" % section) + len(section) + 2
    if binary and version > 4:
        return content[: start + 8] + count.to_bytes(8, "little") + content[start + 16 :]
    end = content.index(b"\n", start)
    head = content[start:end].split()
    head[0 if version < 4 else 1] = b"%d" % count
    return content[:start] + b" ".join(head) + content[end:]


@pytest.mark.parametrize(("version", "binary"), MSH)
def test_counts_of_gmsh_that_do_not_hold_are_refused_with_both_numbers(box, tmp_path, version, binary):
    file = write_arrays(tmp_path / "box.msh", *box, version=version, binary=binary)
    content = file.read_bytes()
    elements = len(box[1]) + sum(len(triangles) for triangles in box_surfaces(*box).values())
    for section, count, held in (
        (b"Elements", 150, elements),
        (b"Elements", 9999, elements),
        (b"Nodes", 99, len(box[0])),
    ):
        file.write_bytes(with_count(content, section, count, version, binary))
        what = section.decode()
        with pytest.raises(MeshError, match=rf"\${what} says {count} {what.lower()} and holds {held}: "):
            read_mesh(file, {})
    file.write_bytes(content[: content.index(b"$EndNodes") - 40])
    with pytest.raises(MeshError, match=r"ends within \$Nodes: it was cut"):
        read_mesh(file, {})


def test_layout_of_gmsh_files_does_not_matter(box, tmp_path):
    file = write_arrays(tmp_path / "box.msh", *box, version=2.2)
    cells = read_mesh(file, {}).cells
    text = file.read_text()
    for other in (text.replace("\n", "\r\n"), text.replace("$Nodes", "$Comments\n$ a\n$EndComments\n$Nodes") + "\n\n"):
        file.write_bytes(other.encode())
        np.testing.assert_array_equal(read_mesh(file, {}).cells, cells)


def test_vtk_that_is_cut_or_miscounted_is_refused(box, tmp_path):
    """At any place, and in XML, whose surplus of cells VTK itself passes over."""
    arrays = *box, {"left": box_surfaces(*box)["left"]}, {"soft": np.arange(len(box[1]))}
    write_vtk(tmp_path / "box.vtk", *arrays)
    content = (tmp_path / "box.vtk").read_text()
    for end in (content.index("CELLS") - 1, content.index("CELL_TYPES"), len(content) - 20, 70):
        (tmp_path / "cut.vtk").write_text(content[:end])
        with pytest.raises(MeshError, match=r"VTK cannot read it: it is damaged, cut, or|holds no (tetrahedra|nodes)"):
            read_mesh(tmp_path / "cut.vtk", {})
    write_vtu(tmp_path / "box.vtu", *arrays)
    content = (tmp_path / "box.vtu").read_text()
    count = len(box[1]) + len(arrays[2]["left"])
    offsets = re.search(r'Name="offsets"[^>]*>([^<]*)<', content)[1]
    for other, said in (
        (content.replace(f'OfCells="{count}"', 'OfCells="5"'), f"it says 5 cells and holds {count}"),
        (content.replace(offsets, offsets.replace("4 8 ", "4 9 ")), "2 cells of type 10 do not have 4 nodes"),
        (content.replace("\n0 ", "\n999 ", 1), "names nodes that it does not hold: 1, e.g. 999"),
    ):
        assert other != content
        (tmp_path / "other.vtu").write_text(other)
        with pytest.raises(MeshError, match=said):
            read_mesh(tmp_path / "other.vtu", {})


def test_vtk_is_read_for_what_it_is(box, tmp_path):
    arrays = *box, {"left": box_surfaces(*box)["left"]}, {"soft": np.arange(len(box[1]))}
    write_vtu(tmp_path / "xml.vtk", *arrays)
    write_vtk(tmp_path / "legacy.vtu", *arrays)
    for name in ("xml.vtk", "legacy.vtu"):
        np.testing.assert_array_equal(read_mesh(tmp_path / name, {}).cells, box[1])


def write_xdmf(path, points, cells, tags, shape="Tetrahedron"):
    """As meshio writes it: tags with the cells, all numbers in one file."""

    def item(array, kind):
        text, shape = (" ".join(map(str, numbers)) for numbers in (array.ravel().tolist(), array.shape))
        return f'<DataItem NumberType="{kind}" Dimensions="{shape}" Format="XML">{text}</DataItem>'

    path.write_text(
        f'<Xdmf Version="3.0"><Domain><Grid Name="Grid"><Geometry GeometryType="XYZ">{item(points, "Float")}</Geometry>'
        f'<Topology TopologyType="{shape}" NumberOfElements="{len(cells)}">{item(cells, "Int")}</Topology>'
        f'<Attribute Name="part" AttributeType="Scalar" Center="Cell">{item(tags, "Int")}</Attribute>'
        "</Grid></Domain></Xdmf>"
    )
    return path.read_text()


@pytest.mark.parametrize("order", [1, 2])
def test_xdmf_of_meshio_is_the_same_mesh_and_its_mistakes_are_told(box, tmp_path, order):
    points, cells = box if order == 1 else second_order(*box)
    file, tags = tmp_path / "box.xdmf", (box[0][box[1]].mean(axis=1)[:, 0] > 0.4).astype(int)
    text = write_xdmf(file, points, cells, tags, "Tetrahedron" if order == 1 else "Tetrahedron_10")
    mesh = read_mesh(file, {"far": 1})
    np.testing.assert_array_equal(mesh.cells, box[1])
    np.testing.assert_array_equal(mesh.region("far"), np.flatnonzero(tags))
    assert (mesh.bend <= 1e-16, mesh.notes) == (True, ())
    for other, said in (
        (text.replace(f'OfElements="{len(cells)}"', 'OfElements="5"'), f"it says 5 elements and holds {len(cells)}"),
        (text.replace('Format="XML">0 ', 'Format="XML">999 ', 1), "nodes that it does not hold: 1, e.g. 999"),
        (
            text.replace(f'Dimensions="{len(cells)}"', 'Dimensions="7"'),
            rf"it says \(7,\) numbers and holds {len(cells)}",
        ),
        (text.replace('Format="XML"', 'Format="Binary"'), "format BINARY are not read; use HDF or XML"),
        (text[:-200], "cannot be read as XDMF"),
    ):
        assert other != text
        file.write_text(other)
        with pytest.raises(MeshError, match=said):
            read_mesh(file, {})


# Nodes and faces without cells


def test_file_that_was_cut_between_cells_is_told_by_its_nodes(box, tmp_path):
    points, cells = box
    kept = cells[points[cells].mean(axis=1)[:, 0].argsort(kind="stable")][: int(0.8 * len(cells))]
    lost = np.setdiff1d(np.arange(len(points)), kept)
    write_inp(
        tmp_path / "cut.inp",
        points,
        kept,
        {"left": np.empty((0, 3), int), "right": np.empty((0, 3), int)},
        {"soft": np.arange(9), "hard": np.arange(9, 20)},
    )
    (told,) = (note for note in read_mesh(tmp_path / "cut.inp", {}).notes if "no cell" in note)
    assert told.startswith(f"{len(lost)} of {len(points)} nodes belong to no cell, e.g. the one at [")
    assert str(points[lost[0]].round(6).tolist()) in told
    left = {"left": box_surfaces(*box)["left"][:2]}
    file, contact = write_arrays(tmp_path / "cut.msh", points, kept, left), "[contacts.c]\nfacing.direction = [0, 0, 1]"
    warnings = assembled(file, contacts=contact).warnings
    assert told in warnings


def test_triangles_of_missing_cells_are_told(box, tmp_path):
    points, cells = box
    surfaces = box_surfaces(points, cells)
    corner = np.flatnonzero(np.isin(np.sort(cells, axis=1), surfaces["right"][0]).sum(axis=1) == 3)
    file = write_arrays(
        tmp_path / "box.msh", points, np.delete(cells, corner, axis=0), surfaces | {"tool": np.array([[0, 20, 50]])}
    )
    told = read_mesh(file, {}).notes[0]
    assert told.startswith(f"surface 'right': 1 of its {len(surfaces['right'])} triangles are no faces of cells, e.g.")


# Holes


def told_of_hole(points, cells, tmp_path):
    """How many holes, and volume, triangles and place of one of them."""
    notes = read_mesh(write_arrays(tmp_path / "hole.msh", points, cells), {}).notes
    (told,) = (note for note in notes if "holes" in note)
    found = re.match(r"(\d+) holes inside .* one of ([-0-9.e]+) m³, of (\d+) triangles, around \[(.*)\]: unless", told)
    return int(found[1]), float(found[2]), int(found[3]), np.array(found[4].split(", "), dtype=float)


@pytest.mark.parametrize("touches", [0, 1, 2])
def test_cell_that_is_missing_inside_is_told_with_its_place_and_volume(box, tmp_path, touches):
    """Also one that the surface of the body meets at a vertex or an edge."""
    points, cells = box
    faces = faces_of(points, cells)
    on_surface = np.isin(cells, faces.outside).sum(axis=1)
    edges = {frozenset(pair) for a, b, c in faces.outside.tolist() for pair in ((a, b), (b, c), (c, a))}
    chosen = next(
        k
        for k in np.flatnonzero(on_surface == touches)
        if touches < 2 or frozenset(cells[k][np.isin(cells[k], faces.outside)].tolist()) in edges
    )
    count, volume, triangles, place = told_of_hole(points, np.delete(cells, chosen, axis=0), tmp_path)
    assert (count, triangles) == (1, 4)
    assert volume == pytest.approx(signed_volumes(points, cells)[chosen], rel=6e-3)  # three digits are told
    np.testing.assert_allclose(place, points[cells[chosen]].mean(axis=0), atol=1e-6)


def test_cell_that_is_missing_between_two_edges_of_the_surface_is_told(tmp_path):
    """It leaves no hole, and in so coarse a mesh no node without cells."""
    points, cells = box_arrays((1.0, 1.0, 1.0), (1, 1, 1))
    wedge = np.delete(cells, [0, 3], axis=0)  # of six around a diagonal, two apart
    told = read_mesh(write_arrays(tmp_path / "wedges.msh", points, wedge, {"all": np.empty((0, 3), int)}), {}).notes[0]
    assert told.startswith("1 edges of the surface are between more than two triangles, e.g. the one around [0.5, 0.5,")


def test_holes_of_few_cells_are_told_and_chambers_are_not(box, tmp_path):
    points, cells = box
    inside = np.flatnonzero(~np.isin(cells, faces_of(points, cells).outside).any(axis=1))
    x = points[cells[inside]].mean(axis=1)[:, 0]
    assert len(inside) == 12  # two bricks
    one, two = inside[x < 0.4], inside
    volumes = signed_volumes(points, cells)
    count, volume, triangles, _ = told_of_hole(points, np.delete(cells, one, axis=0), tmp_path)
    assert (count, triangles) == (1, 12)
    assert volume == pytest.approx(volumes[one].sum(), rel=6e-3)
    chamber = np.delete(cells, two, axis=0)
    assert read_mesh(write_arrays(tmp_path / "chamber.msh", points, chamber, box_surfaces(*box)), {}).notes[1:] == ()
    _, enclosed, triangles = closed_surfaces(points, faces_of(points, chamber))
    np.testing.assert_allclose(np.sort(enclosed), [-volumes[two].sum(), np.prod(LENGTHS)], rtol=1e-12)
    assert np.sort(triangles)[0] == 20


def test_whole_body_is_not_talked_about(box, tmp_path):
    assert read_mesh(write_arrays(tmp_path / "box.msh", *box), {}).notes == ()
