"""Prisms, pyramids and meshes of several shapes: cut into tetrahedra, with their curved sides, groups and data."""

import json
import subprocess
import sys
from functools import cache

import gmsh
import numpy as np
import pytest
from bodies import assembled, sparse
from bricks import KINDS, hexahedra, msh, write_bricks
from scipy.sparse.linalg import eigsh
from test_hexahedra import numbers, write_xdmf
from test_mesh import write_gmsh

from fenics_rom.errors import MeshError
from fenics_rom.fem.cell_points import cell_volumes, checked_nodes
from fenics_rom.fem.facets import surface_area, volume_within_surface
from fenics_rom.fem.mesh import read_mesh
from fenics_rom.scene.foreign_process import VTK_CELLS, VTK_FACES

SQUARE = np.array([(0, 0), (1, 0), (1, 1), (0, 1)])
# Numbers of nodes: of cells as they have them besides their corners none, on edges, and on quadrilaterals, too
ORDERS = {
    "straight": {"tetrahedron": 4, "pyramid": 5, "prism": 6, "hexahedron": 8, "triangle": 3, "quadrilateral": 4},
    "serendipity": {"tetrahedron": 10, "pyramid": 13, "prism": 15, "hexahedron": 20, "triangle": 6, "quadrilateral": 8},
    "complete": {"tetrahedron": 10, "pyramid": 14, "prism": 18, "hexahedron": 27, "triangle": 6, "quadrilateral": 9},
}
VOLUME = 3 + 1 / 3
SHAPES_OF_ROW = "hexahedron", "pyramid", "prism", "tetrahedron"
VTK_TYPES = {(3, size): kind for size, kind in VTK_CELLS.items()}
VTK_TYPES |= {(2, size): kind for of in VTK_FACES.values() for size, kind in of.items()}


def above(corners, height):
    return np.column_stack([corners, np.full(len(corners), height)])


def row_of_shapes():
    """Corners of cells, and of faces by the names of surfaces, in Gmsh's order.

    Along x a cube, a cube of six pyramids and one of two prisms, on which are two tetrahedra.
    """
    bottom, top = (above(SQUARE, z) for z in (0.0, 1.0))
    cells = {"hexahedron": [np.vstack([bottom, top])], "pyramid": [], "prism": [], "tetrahedron": []}
    for around in ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)):
        face = np.add(np.vstack([bottom, top])[list(around)][::-1], [1, 0, 0])
        cells["pyramid"].append(np.vstack([face, [1.5, 0.5, 0.5]]))
    for half in (SQUARE[[0, 1, 2]], SQUARE[[0, 2, 3]]):
        low, high = (np.add(above(half, z), [2, 0, 0]) for z in (0.0, 1.0))
        cells["prism"].append(np.vstack([low, high]))
        cells["tetrahedron"].append(np.vstack([high, [2.5, 0.5, 2.0]]))
    floor = [np.add(bottom, [k, 0, 0]) for k in (0, 1)], [cell[[0, 1, 2]] for cell in cells["prism"]]
    left = [np.vstack([bottom[[0, 3]], top[[3, 0]]])]
    faces = {("floor", "quadrilateral"): floor[0], ("floor", "triangle"): floor[1], ("left", "quadrilateral"): left}
    return cells, faces


def bent(points):
    """A quadratic map that leaves volumes as they are, and areas where x = 0."""
    x, y, z = points.T
    return np.column_stack([x, y + 0.05 * x**2, z + 0.03 * x * y + 0.02 * y**2])


@cache
def nodes_of_vtk():
    """By the type of cells, from a process of its own: VTK would take symbols of dolfinx' for its own."""
    types = list(VTK_TYPES.values())
    script = f"""import json
from vtkmodules.vtkCommonDataModel import vtkGenericCell
found, cell = {{}}, vtkGenericCell()
for kind in {types}:
    cell.SetCellType(kind)
    found[kind] = [cell.GetParametricCoords()[k] for k in range(3 * cell.GetNumberOfPoints())]
print(json.dumps(found))"""
    return json.loads(subprocess.run([sys.executable, "-c", script], capture_output=True, check=True).stdout)


def reference_nodes(size, dimension, program):
    """Where a program has the nodes of a cell of so many, or of a face, in its reference cell."""
    if program == "vtk":
        places = np.array(nodes_of_vtk()[str(VTK_TYPES[dimension, size])]).reshape(size, 3)
        if size in (5, 13):  # whose coordinates run from 0 to 1 at every height
            places[:, :2] *= 1 - places[:, 2:]
        return places
    gmsh.initialize([], readConfigFiles=False)
    _, dimensions, _, _, local, _ = gmsh.model.mesh.getElementProperties(KINDS[dimension, size])
    gmsh.finalize()
    return np.reshape(local, (size, dimensions))


def row(order, of=bent, program="gmsh"):
    """Points, and cells and faces by names as `msh` takes them; nodes are where reference cells have them."""
    cells, faces = row_of_shapes()
    places, groups = {}, {2: {}, 3: {}}
    every = [((name, name), rows, 3) for name, rows in cells.items()] + [(key, rows, 2) for key, rows in faces.items()]
    for (name, shape), rows, dimension in every:
        size = min(ORDERS[order][shape], 13) if (shape, program) == ("pyramid", "vtk") else ORDERS[order][shape]
        local = np.column_stack([np.ones(size), reference_nodes(size, dimension, program)])
        for corners in rows:  # cells are affine
            nodes = local @ np.linalg.lstsq(local[: len(corners)], corners, rcond=None)[0]
            cell = [places.setdefault(tuple(node.round(9) + 0.0), len(places)) for node in nodes]
            groups[dimension].setdefault(f"{name} of {shape}" if name == "floor" else name, []).append(cell)
    shuffled = np.random.default_rng(3).permutation(len(places))  # the least node of a cell is anywhere
    points = np.empty((len(places), 3))
    points[shuffled] = of(np.array([*places]))
    return points, {dim: {name: shuffled[rows] for name, rows in group.items()} for dim, group in groups.items()}


def read_row(folder, points, groups):
    (folder / "row.msh").write_text(msh(points, groups))
    return read_mesh(folder / "row.msh", {})


@pytest.mark.parametrize("order", ORDERS)
def test_volumes_surfaces_and_groups_are_kept(tmp_path, order):
    """To round-off, bent, too, as the map is quadratic: the volume, areas, the volume within the surface."""
    of = np.asarray if order == "straight" else bent
    mesh = read_row(tmp_path, *row(order, of))
    assert mesh.notes == (
        "6 pyramids and 2 prisms and 1 hexahedron were cut into 24 tetrahedra: cells are computed if all are "
        "tetrahedra, or all hexahedra",
    )
    sizes = {name: len(mesh.region(name)) for name in mesh.regions}
    assert sizes == {"hexahedron": 6, "pyramid": 12, "prism": 6, "tetrahedron": 2}
    nodes = checked_nodes(mesh, 2)
    assert nodes.is_curved == (order != "straight")
    volumes = cell_volumes(nodes)
    for name, volume in {"hexahedron": 1, "pyramid": 1, "prism": 1, "tetrahedron": 1 / 3}.items():
        assert abs(volumes[mesh.region(name)].sum() / volume - 1) <= 1e-14
    assert abs(volume_within_surface(nodes, nodes.surface, np.array([1.0, 2.0, 3.0])) / VOLUME - 1) <= 1e-13
    ends, middles = nodes.coordinates[nodes.edges].transpose(1, 0, 2), nodes.coordinates[-len(nodes.edges) :]
    if order == "straight":
        assert np.abs(middles - ends.mean(axis=0)).max() <= 1e-15
    else:
        x, y, z = ends.transpose(2, 0, 1)
        at_rest = np.stack([x, y - 0.05 * x**2, z], axis=-1)
        at_rest[..., 2] -= 0.03 * at_rest[..., 0] * at_rest[..., 1] + 0.02 * at_rest[..., 1] ** 2
        assert np.abs(middles - bent(at_rest.mean(axis=0))).max() <= 1e-14
    floor = [nodes.vertices(mesh.surface(f"floor of {shape}")) for shape in ("quadrilateral", "triangle")]
    assert [len(triangles) for triangles in floor] == [4, 2]
    assert abs(surface_area(nodes, nodes.vertices(mesh.surface("left"))) - 1) <= 1e-14
    if order == "straight":
        assert abs(surface_area(nodes, np.vstack(floor)) - 3) <= 1e-14


@pytest.mark.parametrize("order", ORDERS)
def test_the_same_cells_come_from_vtk(tmp_path, order):
    """With the tags of cells and faces, and directions of cells."""
    of = np.asarray if order == "straight" else bent
    points, groups = row(order, of, program="vtk")
    cells = [cell for name in SHAPES_OF_ROW for cell in groups[3][name].tolist()]
    faces = [face for rows in groups[2].values() for face in rows.tolist()]
    tags = [k for k, name in enumerate(SHAPES_OF_ROW, start=1) for _ in groups[3][name]] + [9] * len(faces)
    types = [VTK_TYPES[dim, len(nodes)] for dim, rows in ((3, cells), (2, faces)) for nodes in rows]
    rows = "\n".join(" ".join(map(str, [len(nodes), *nodes])) for nodes in cells + faces)
    of_cells = "\n".join(f"{tag} 0 0" for tag in tags)
    (tmp_path / "row.vtk").write_text(
        f"# vtk DataFile Version 3.0\nb\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS {len(points)} double\n"
        f"{numbers(points)}\nCELLS {len(types)} {len(rows.split())}\n{rows}\n"
        f"CELL_TYPES {len(types)}\n{numbers(types)}\n"
        f"CELL_DATA {len(types)}\nSCALARS part int 1\nLOOKUP_TABLE default\n{numbers(tags)}\n"
        f"VECTORS along double\n{of_cells}\n"
    )
    names = {name: k for k, name in enumerate(SHAPES_OF_ROW, start=1)} | {"faces": 9}
    mesh = read_mesh(tmp_path / "row.vtk", names)
    other = read_row(tmp_path, *row(order, of))
    one, two = (checked_nodes(each, 2) for each in (mesh, other))
    for name in SHAPES_OF_ROW:
        np.testing.assert_allclose(
            [cell_volumes(of)[each.region(name)].sum() for of, each in ((one, mesh), (two, other))],
            1 / 3 if name == "tetrahedron" else 1.0,
            rtol=1e-13,
        )
        assert (mesh.vectors["along"][mesh.region(name), 0] == names[name]).all()
    assert len(mesh.surface("faces")) == 4 + 2 + 2
    sets = [np.unique(of.coordinates.round(9) + 0.0, axis=0) for of in (one, two)]
    assert np.abs(sets[0] - sets[1]).max() <= 1e-9


@pytest.mark.parametrize("order", ORDERS)
def test_prisms_come_from_xdmf(tmp_path, order):
    points, groups = row(order, np.asarray if order == "straight" else bent, program="vtk")
    write_xdmf(tmp_path / "row.xdmf", points, groups[3]["prism"], {"right": groups[2]["floor of triangle"]})
    mesh = read_mesh(tmp_path / "row.xdmf", {"floor": 7, "prisms": 8})
    nodes = checked_nodes(mesh, 2)
    assert abs(cell_volumes(nodes).sum() - 1) <= 1e-14
    assert mesh.notes[0].startswith("2 prisms were cut into 6 tetrahedra: ")
    assert [len(mesh.surface("floor")), len(mesh.region("prisms"))] == [2, 6]


def test_what_cannot_be_cut_is_refused(tmp_path):
    points, groups = row("straight")
    twice = groups[3]["prism"].copy()
    twice[1, 4] = twice[1, 5]
    with pytest.raises(MeshError, match=r"1 of 2 prisms have a node twice, e.g. number 1 of them; those are not"):
        read_row(tmp_path, points, {2: groups[2], 3: groups[3] | {"prism": twice}})
    cube, cells, _ = hexahedra((1, 1, 1))
    beyond = np.vstack([cube, [0.5, 0.5, -1.0]])  # nodes are in the order of x, y, z, and the cut is from 0 to 6
    on_face = {"tetrahedron": np.array([[0, 2, 4, 8], [2, 6, 4, 8]])}
    with pytest.raises(
        MeshError, match=r"2 triangles are halves of quadrilaterals, e.g. the one around \[0.333333, 0.3"
    ):
        read_row(tmp_path, beyond, {3: {"hexahedron": cells} | on_face})
    on_face = {"tetrahedron": np.array([[0, 2, 6, 8], [0, 6, 4, 8]])}
    mesh = read_row(tmp_path, beyond, {3: {"hexahedron": cells} | on_face})
    assert abs(cell_volumes(checked_nodes(mesh, 1)).sum() - 4 / 3) <= 1e-14


def test_a_beam_of_prisms_vibrates_as_one_of_hexahedra(tmp_path):
    """A square one, extruded by Gmsh, of quadratic cells; its first frequency is Bernoulli's."""

    def make():
        face = gmsh.model.occ.addRectangle(0, 0, 0, 0.1, 0.1)
        gmsh.model.occ.extrude([(2, face)], 0, 0, 1.0, numElements=[16], recombine=True)
        gmsh.model.occ.synchronize()
        gmsh.option.setNumber("Mesh.MeshSizeMin", 0.06)
        gmsh.model.setPhysicalName(2, gmsh.model.addPhysicalGroup(2, [face]), "left")
        gmsh.model.addPhysicalGroup(3, [1])
        gmsh.model.mesh.generate(3)

    write_gmsh(tmp_path / "prisms.msh", make)
    points, cells, faces = hexahedra((1, 1, 16), 20)
    bricks = write_bricks(tmp_path / "bricks.msh", points * [0.1, 0.1, 1.0], cells, {"left": faces["bottom"]})
    contact = "[contacts.all]\nnear = { point = [0, 0, 1], radius = 1 }"
    frequencies = []
    for file in (tmp_path / "prisms.msh", bricks):
        system = assembled(file, degree=2, contacts=contact)
        λ = eigsh(sparse(system.stiffness), 6, sparse(system.mass), sigma=0.0, return_eigenvectors=False)
        frequencies.append(np.sqrt(np.sort(λ)) / (2 * np.pi))
        assert bool(system.warnings) is (file != bricks)
    of_prisms, of_bricks = frequencies
    assert np.abs(of_prisms / of_bricks - 1).max() <= 4e-3
    bending = 1.8751041**2 / (2 * np.pi) * np.sqrt(1e6 / 1e3 * 0.1**2 / 12)
    assert np.abs(of_prisms[:2] / bending - 1).max() <= 4e-3
