"""Meshes of other programs are those of Gmsh: .vtk, .vtu, .inp, cells of order two, surfaces that are filled."""

import re

import gmsh
import numpy as np
import pytest
from bodies import assembled, box_arrays, box_surfaces, scene_text, write_arrays
from test_mesh import write_gmsh

import fenics_rom as fr
from fenics_rom.errors import MeshError, SceneError
from fenics_rom.fem import filling
from fenics_rom.fem.filling import fill_surface
from fenics_rom.fem.mesh import read_mesh
from fenics_rom.fem.mesh_quality import CELL_FACES, signed_volumes
from fenics_rom.scene.file import parse_scene

LENGTHS, BRICKS = (0.3, 0.1, 0.1), (2, 1, 1)
GROUPS = {"left": 1, "right": 2, "soft": 3, "hard": 4}
EDGES = [(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)]  # of VTK's and Abaqus' cells of ten nodes


@pytest.fixture(scope="module")
def box():
    points, cells = box_arrays(LENGTHS, BRICKS)
    surfaces = {name: triangles for name, triangles in box_surfaces(points, cells).items() if name in GROUPS}
    near = points[cells].mean(axis=1)[:, 0] < 0.15
    return points, cells, surfaces, {"soft": np.flatnonzero(near), "hard": np.flatnonzero(~near)}


def second_order(points, cells):
    """Points and cells of ten nodes."""
    ends = np.sort(cells[:, EDGES].reshape(-1, 2), axis=1)
    edges, row = np.unique(ends, axis=0, return_inverse=True)
    return np.vstack([points, points[edges].mean(axis=1)]), np.hstack([cells, len(points) + row.reshape(-1, 6)])


def lines(rows):
    return "\n".join(" ".join(map(str, row)) for row in rows)


def vtk_cells(points, cells, surfaces, regions):
    """All cells with VTK's numbers of their kinds and their tags."""
    tags = np.concatenate([np.full(len(rows), GROUPS[name]) for name, rows in regions.items()])
    tets = cells[np.concatenate(list(regions.values()))]
    faces = np.concatenate(list(surfaces.values()))
    of_faces = np.concatenate([np.full(len(rows), GROUPS[name]) for name, rows in surfaces.items()])
    kinds = [10 if cells.shape[1] == 4 else 24] * len(tets) + [5] * len(faces)
    return [*tets.tolist(), *faces.tolist()], kinds, [*tags.tolist(), *of_faces.tolist()]


def write_vtk(path, points, cells, surfaces, regions):
    every, kinds, tags = vtk_cells(points, cells, surfaces, regions)
    path.write_text(
        "# vtk DataFile Version 3.0\nbox\nASCII\nDATASET UNSTRUCTURED_GRID\n"
        f"POINTS {len(points)} double\n{lines(points.tolist())}\n"
        f"CELLS {len(every)} {sum(len(cell) + 1 for cell in every)}\n{lines([len(cell), *cell] for cell in every)}\n"
        f"CELL_TYPES {len(every)}\n{lines([[*kinds]])}\n"
        f"CELL_DATA {len(every)}\nSCALARS part int 1\nLOOKUP_TABLE default\n{lines([tags])}\n"
    )


def write_vtu(path, points, cells, surfaces, regions, more=""):
    every, kinds, tags = vtk_cells(points, cells, surfaces, regions)

    def array(name, kind, values, count=1):
        return (
            f'<DataArray type="{kind}" Name="{name}" NumberOfComponents="{count}" format="ascii">{values}</DataArray>'
        )

    path.write_text(
        '<VTKFile type="UnstructuredGrid" version="0.1" byte_order="LittleEndian"><UnstructuredGrid>'
        f'<Piece NumberOfPoints="{len(points)}" NumberOfCells="{len(every)}">'
        f"<Points>{array('Points', 'Float64', lines(points.tolist()), 3)}</Points>"
        f"<Cells>{array('connectivity', 'Int64', lines(every))}"
        f"{array('offsets', 'Int64', lines([np.cumsum([len(cell) for cell in every])]))}"
        f"{array('types', 'UInt8', lines([kinds]))}</Cells>"
        f"<CellData>{array('part', 'Int32', lines([tags]))}{more}</CellData>"
        "</Piece></UnstructuredGrid></VTKFile>"
    )


def face_lines(cells, triangles):
    """Lines of *Surface: elements and their faces, S1 to S4 as Abaqus counts them."""
    wanted = {tuple(sorted(t)) for t in triangles.tolist()}
    number = {frozenset(face): f"S{s}" for s, face in enumerate([(0, 1, 2), (0, 1, 3), (1, 2, 3), (0, 2, 3)], 1)}
    found = [
        f"{100 + k}, {number[frozenset(face)]}"
        for k, cell in enumerate(cells[:, :4])
        for face in map(tuple, CELL_FACES.tolist())
        if tuple(sorted(cell[list(face)].tolist())) in wanted
    ]
    assert len(found) == len(wanted)
    return "\n".join(found)


def write_inp(path, points, cells, surfaces, regions):
    """Sets of nodes and of elements, a surface of faces, numbers with gaps, and what a body does not have."""
    named = [f"{10 * k + 7}, {', '.join(map(repr, point))}" for k, point in enumerate(points.tolist())]
    elements = [f"{100 + k}, {', '.join(str(10 * n + 7) for n in cell)}" for k, cell in enumerate(cells.tolist())]
    elements = [re.sub(r"^((?:[^,]*,){6})", r"\1\n", text) for text in elements]  # ten nodes go on in the next line
    left = sorted({10 * n + 7 for n in surfaces["left"].ravel().tolist()})
    soft, hard = regions["soft"] + 100, regions["hard"] + 100
    path.write_text(
        "*Heading\n a box, made by hand\n** a comment\n*Part, name=PART-1\n*Node\n"
        + "\n".join(named)
        + f"\n*ELEMENT, type=C3D{cells.shape[1]}, ELSET=all\n"
        + "\n".join(elements)
        + "\n*Element, type=SPRING1\n900, 7\n*Nset, nset=Left\n"
        + ",\n".join(map(str, left))
        + f"\n*Elset, elset=first, generate\n {soft[0]}, {soft[0]}, 1\n*Elset, elset=soft\nFIRST, "
        + ", ".join(map(str, soft[1:]))
        + "\n*Elset, elset=hard\n"
        + ", ".join(map(str, hard))
        + "\n*Surface, type=ELEMENT, name=right\n"
        + face_lines(cells, surfaces["right"])
        + "\n*End Part\n*Assembly, name=A\n*Instance, name=I, part=PART-1\n*End Instance\n*End Assembly\n"
    )


WRITERS = {".vtk": write_vtk, ".vtu": write_vtu, ".inp": write_inp}


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("ending", WRITERS)
def test_the_same_mesh_comes_from_any_format(box, tmp_path, ending, order):
    points, cells, surfaces, regions = box
    written = (points, cells) if order == 1 else second_order(points, cells)
    WRITERS[ending](tmp_path / f"box{ending}", *written, surfaces, regions)
    mesh = read_mesh(tmp_path / f"box{ending}", GROUPS)
    assert mesh.bend <= 1e-16

    def places(rows):
        return sorted(mesh_points[row].round(12).tolist() for row in rows)

    for group in ("soft", "hard"):
        mesh_points = mesh.points[mesh.cells].mean(axis=1)
        here = places(mesh.region(group))
        mesh_points = points[cells].mean(axis=1)
        assert here == places(regions[group])
    for group, given in (("left", surfaces["left"]), ("right", surfaces["right"])):
        name = "Left" if (ending, group) == (".inp", "left") else group
        mesh_points = mesh.points[mesh.surface(name)].mean(axis=1)
        here = places(range(len(mesh_points)))
        mesh_points = points[given].mean(axis=1)
        assert here == places(range(len(mesh_points)))


def second_order_of(add):
    def make():
        add()
        gmsh.model.occ.synchronize()
        gmsh.model.mesh.generate(3)
        gmsh.model.mesh.setOrder(2)

    return make


def test_cells_of_order_two_are_made_straight_and_curved_ones_told(tmp_path):
    write_gmsh(tmp_path / "box.msh", second_order_of(lambda: gmsh.model.occ.addBox(0, 0, 0, 1, 1, 1)))
    assert read_mesh(tmp_path / "box.msh", {}).bend <= 1e-15
    write_gmsh(tmp_path / "ball.msh", second_order_of(lambda: gmsh.model.occ.addSphere(0, 0, 0, 0.1)))
    mesh = read_mesh(tmp_path / "ball.msh", {})
    faces = np.sort(mesh.cells[:, CELL_FACES].reshape(-1, 3), axis=1)
    outer, count = np.unique(faces, axis=0, return_counts=True)
    ends = mesh.points[outer[count == 1][:, [[0, 1], [1, 2], [0, 2]]].reshape(-1, 2)]
    chord = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).max()
    assert mesh.bend == pytest.approx(0.1 - np.sqrt(0.1**2 - chord**2 / 4), rel=0.01)
    tip = "[contacts.tip]\nfacing = { direction = [1, 0, 0], angle = 1.0 }"
    scene = parse_scene(scene_text(tmp_path / "ball.msh", supports=None, contacts=tip))
    assert any("cells were made straight, as mesh.degree is 1" in warning for warning in fr.assemble(scene).warnings)


# --- surfaces that are filled ----------------------------------------------------------------------------------------


def write_stl(path, triangles):
    loops = ("".join(f"vertex {x!r} {y!r} {z!r}\n" for x, y, z in corners) for corners in triangles.tolist())
    facets = "".join(f"facet normal 0 0 0\nouter loop\n{loop}endloop\nendfacet\n" for loop in loops)
    path.write_text(f"solid box\n{facets}endsolid box\n")


@pytest.fixture(scope="module")
def skin():
    """Triangles of a box, mm."""
    points, cells = box_arrays((30.0, 10.0, 10.0), (3, 1, 1))
    return points[np.concatenate(list(box_surfaces(points, cells).values()))]


def test_closed_surface_is_filled_from_the_command_line(skin, tmp_path, monkeypatch, capsys):
    from fenics_rom.cli.main import main

    monkeypatch.chdir(tmp_path)
    write_stl(tmp_path / "part.stl", skin)
    with pytest.raises(SystemExit) as ended:
        main(["mesh", "part.stl", "-o", "part.msh", "--size", "6e-3", "--scale", "1e-3"])
    told = capsys.readouterr().out
    assert ended.value.code == 0
    assert "0.03 x 0.01 x 0.01 m" in told
    assert "radius ratio 3 r/R from" in told
    mesh = read_mesh(tmp_path / "part.msh", {})
    volumes = signed_volumes(mesh.points, mesh.cells)
    assert volumes.sum() == pytest.approx(3e-6, rel=1e-12)
    assert len(mesh.region("body")) == len(volumes) > 20


def test_bodies_of_step_files_are_filled_in_metres(tmp_path):
    def plate():
        gmsh.model.occ.addBox(0, 0, 0, 30, 10, 10)  # mm, as such files say
        gmsh.model.occ.synchronize()

    write_gmsh(tmp_path / "part.step", plate)
    mesh = fill_surface(tmp_path / "part.step", tmp_path / "part.msh", 6e-3)
    assert signed_volumes(mesh.points, mesh.cells).sum() == pytest.approx(3e-6, rel=1e-9)
    assert len(read_mesh(tmp_path / "part.msh", {}).region("body")) == len(mesh.cells)
    with pytest.raises(MeshError, match=r"part\.step: says its unit; a scale is for \.stl"):
        fill_surface(tmp_path / "part.step", tmp_path / "part.msh", 6e-3, scale=1e-3)


def test_surfaces_that_cannot_be_filled_are_told(skin, tmp_path, monkeypatch):
    monkeypatch.setattr(filling, "find_spec", lambda name: None)  # without fTetWild
    write_stl(tmp_path / "open.stl", skin[1:])
    (tmp_path / "empty.stl").write_text("solid nothing\nendsolid nothing\n")
    write_stl(tmp_path / "through.stl", np.concatenate([skin, skin + np.array([25.0, 5.1, 5.2])]))
    (tmp_path / "garbage.step").write_bytes(bytes(range(256)))
    for name, said in {
        "open.stl": r"surface is not closed: 3 of 42 edges are not between two triangles, e.g. one at \[",
        "empty.stl": r"empty\.stl: holds no triangles",
        "through.stl": "its surface goes through itself at [0-9]+ places",
        "garbage.step": "Gmsh cannot fill it",
        "none.stl": "not found",
        "box.obj": r"use a file that ends in \.stl, \.step, \.stp",
    }.items():
        with pytest.raises(MeshError, match=said):
            fill_surface(tmp_path / name, tmp_path / "out.msh", 5.0)
        assert not (tmp_path / "out.msh").exists()


# --- pieces of the surface without names -----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def file(box, tmp_path_factory):
    return write_arrays(tmp_path_factory.mktemp("box") / "box.msh", *box[:2])


@pytest.mark.parametrize(
    "place",
    [
        "plane = { point = [0.3, 5.0, 0.0], normal = [2, 0, 0] }",
        "plane = { point = [0.301, 0.0, 0.0], normal = [-1, 0, 0], distance = 2e-3 }",
        "facing = { direction = [3, 0.1, 0] }",
    ],
)
def test_pieces_are_found_by_where_they_lie_and_look(file, place):
    contacts = f'[contacts.named]\nsurface = "right"\n[contacts.found]\n{place}'
    held = {"supports": None, "contacts": contacts}
    text = "[[supports.held]]\nplane = { point = [0, 0, 0], normal = [1, 0, 0] }\n" + scene_text(file, **held)
    system, clamped = fr.assemble(parse_scene(text)), assembled(file)
    np.testing.assert_array_equal(system.contacts["found"], system.contacts["named"])
    np.testing.assert_array_equal(system.body.free, clamped.body.free)


@pytest.mark.parametrize(
    ("place", "said"),
    [
        (
            "plane = { point = [0.5, 0, 0], normal = [1, 0, 0] }",
            r"contacts.c.plane: .*the nearest has a corner 0.2 m off",
        ),
        (
            "facing = { direction = [1, 1, 1], angle = 0.5 }",
            "contacts.c.facing.angle = 0.5: no .*; the nearest is 0.9553",
        ),
        ('surface = "left"\nfacing = { direction = [1, 0, 0] }', "c: give exactly one of surface, near, plane, facing"),
    ],
)
def test_pieces_that_are_not_there_are_told(file, place, said):
    with pytest.raises(SceneError, match=said):
        fr.assemble(parse_scene(scene_text(file, contacts=f"[contacts.c]\n{place}")))


# --- files that cannot be read ---------------------------------------------------------------------------------------

INP = "*Node\n1, 0, 0, 0\n2, 1, 0, 0\n3, 0, 1, 0\n4, 0, 0, 1\n*Element, type=C3D4\n1, 1, 2, 3, 4\n"
BAD = {
    "bricks.inp": (INP + "*Element, type=C3D8R\n2, 1, 2, 3, 4, 1, 2, 3, 4\n", "holds 1 C3D8R; use tetrahedra: C3D4"),
    "quadratic.inp": (INP + f"*Element, type=C3D20\n2{', 1' * 20}\n", "holds 1 C3D20;"),
    "few.inp": (INP + "*Element, type=C3D4\n2, 1, 2, 3\n", "line 9: .*element 2 of type C3D4 has 3 nodes"),
    "word.inp": (INP.replace("0, 1, 0", "0, one, 0"), "line 4: cannot be read as Abaqus' input, .*'one'"),
    "parts.inp": ("*Part, name=A\n*End Part\n*Part, name=B\n", "line 3: .*several parts"),
    "moved.inp": ("*Part, name=A\n*Instance, name=I, part=A\n1.0, 0, 0\n", "line 3: .*an instance is moved"),
    "include.inp": ("*Include, input=other.inp\n", "line 1: .*put all into one file"),
    "set.inp": (INP + "*Surface, name=s\nnone, S1\n", "surface 's' is of no set 'none'; there is none"),
    "node.inp": (INP.replace("1, 1, 2, 3, 4", "1, 1, 2, 3, 9"), "names nodes that it does not hold"),
    "empty.inp": ("", "holds no tetrahedra"),
    "shell.inp": (
        INP.replace("C3D4\n1, 1, 2, 3, 4", "S3\n1, 1, 2, 3"),
        "holds no tetrahedra or hexahedra; a surface alone is no body, and shells are not computed",
    ),
    "empty.vtk": ("", "VTK cannot read it: it is damaged, cut, or in no format of VTK's"),
    "torn.vtu": ('<VTKFile type="UnstructuredGrid"><UnstructuredGrid><Piece', "VTK cannot read it"),
    "poly.vtk": (
        "# vtk DataFile Version 3.0\np\nASCII\nDATASET POLYDATA\nPOINTS 3 double\n0 0 0 1 0 0 0 1 0\n"
        "POLYGONS 1 4\n3 0 1 2\n",
        "it holds vtkPolyData; use an unstructured grid of cells",
    ),
    "voxel.vtk": (
        "# vtk DataFile Version 3.0\nb\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 8 double\n"
        "0 0 0 1 0 0 0 1 0 1 1 0 0 0 1 1 0 1 0 1 1 1 1 1\nCELLS 1 9\n8 0 1 2 3 4 5 6 7\nCELL_TYPES 1\n11\n",
        "holds Voxel; use tetrahedra of 4 or 10 nodes, pyramids of 5, 13 or 14, prisms of 6, 15 or 18",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_files_that_cannot_be_used_are_told_in_one_line(tmp_path, name):
    text, said = BAD[name]
    (tmp_path / name).write_text(text)
    with pytest.raises(MeshError, match=said) as caught:
        read_mesh(tmp_path / name, {})
    assert "\n" not in str(caught.value)


def test_tags_of_two_arrays_that_would_mix_are_refused(box, tmp_path):
    count = sum(len(rows) for rows in box[3].values()) + sum(len(rows) for rows in box[2].values())
    other = f'<DataArray type="Int32" Name="other" format="ascii">{" ".join(["3"] * count)}</DataArray>'
    write_vtu(tmp_path / "box.vtu", *box, other)
    with pytest.raises(MeshError, match="tag 3 is in several arrays of cell data"):
        read_mesh(tmp_path / "box.vtu", {"soft": 3})
