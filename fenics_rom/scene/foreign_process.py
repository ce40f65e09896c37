"""A process of its own that lets Gmsh or VTK read a mesh file, or Gmsh mesh one, and writes arrays to standard output.

They crash on some damaged files; here they take nobody with them. It is started by `foreign_file`, as a script, so that
it needs NumPy and Gmsh or VTK only.
"""

import io
import os
import re
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

BASE_MEMORY = 2**30  # bytes of address space that Gmsh may take for any file, of which it takes a fifth by itself
VTK_MEMORY = 2**32  # and VTK, of which it takes a fifth
MEMORY_PER_BYTE = 50  # and for each byte of the file, of which they take five to ten
# Nodes of second-order cells between two corners, in the order of VTK and of Abaqus, each as (corner, corner, node).
# The middle of a face is between both pairs of its opposite corners, that of a hexahedron between all four.
CENTRE = np.array([(0, 6, 26), (1, 7, 26), (2, 4, 26), (3, 5, 26)])
VTK_EDGES = [(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)]
VTK_DIAGONALS = [(0, 7), (4, 3), (1, 6), (2, 5), (0, 5), (1, 4), (3, 6), (2, 7), (0, 2), (3, 1), (4, 6), (5, 7)]
TETRAHEDRON_10 = np.array([(0, 1, 4), (1, 2, 5), (0, 2, 6), (0, 3, 7), (1, 3, 8), (2, 3, 9)])
HEXAHEDRON_20 = np.column_stack([VTK_EDGES, np.arange(8, 20)])
HEXAHEDRON_27 = np.concatenate([HEXAHEDRON_20, np.column_stack([VTK_DIAGONALS, np.arange(40, 52) // 2]), CENTRE])
GMSH_EDGES = [(0, 1), (0, 3), (0, 4), (1, 2), (1, 5), (2, 3), (2, 6), (3, 7), (4, 5), (4, 7), (5, 6), (6, 7)]
GMSH_DIAGONALS = [(0, 2), (3, 1), (0, 5), (1, 4), (0, 7), (4, 3), (1, 6), (2, 5), (2, 7), (3, 6), (4, 6), (5, 7)]
GMSH_10 = np.array([(0, 1, 4), (1, 2, 5), (0, 2, 6), (0, 3, 7), (1, 3, 9), (2, 3, 8)])
GMSH_20 = np.column_stack([GMSH_EDGES, np.arange(8, 20)])
GMSH_27 = np.concatenate([GMSH_20, np.column_stack([GMSH_DIAGONALS, np.arange(40, 52) // 2]), CENTRE])
# By the number of corners: numbers of the kinds of cells, and of those of their faces, with their nodes.
GMSH_KINDS = {4: ({4: 4, 11: 10}, {2: 3, 9: 6}), 8: ({5: 8, 17: 20, 12: 27}, {3: 4, 16: 8, 10: 9})}
VTK_KINDS = {4: ({10: 4, 24: 10}, {5: 3, 22: 6}), 8: ({12: 8, 25: 20, 29: 27}, {9: 4, 23: 8, 28: 9})}
GMSH_MIDDLES = {11: GMSH_10, 17: GMSH_20, 12: GMSH_27}
VTK_MIDDLES = {24: TETRAHEDRON_10, 25: HEXAHEDRON_20, 29: HEXAHEDRON_27}
AROUND = 48  # triangles around a round face of a STEP file
FEATURE_ANGLE = np.radians(40.0)  # between triangles of a surface; beyond it an edge stays an edge


def main() -> None:
    """Reads the file that the command line names, or its surface, or fills it with cells of a size.

    Or it ends with a message.
    """
    file, *words = sys.argv[1:]
    lower_limit("RLIMIT_CORE", 0)  # a crash leaves nothing behind
    if words == ["surface"] or not words:  # sizes in a file may lie
        base = BASE_MEMORY if program_of(Path(file)) == "Gmsh" else VTK_MEMORY
        lower_limit("RLIMIT_AS", base + MEMORY_PER_BYTE * Path(file).stat().st_size)
    with os.fdopen(os.dup(1), "wb") as output:
        os.dup2(2, 1)  # what libraries print is no part of the arrays
        try:
            if words == ["surface"]:
                arrays = read_surface(file)
            else:
                arrays = fill_surface(file, float(words[0]), words[1:] == ["glue"]) if words else read_arrays(file)
        except ModuleNotFoundError as error:
            sys.exit(f'it needs {error.name}, which this Python lacks: pip install "fenics-rom[view]"')
        except Exception as error:  # Gmsh's own, and what Python says of names that are no text
            sys.exit(" ".join(str(error).split()))
        content = io.BytesIO()
        np.savez(content, **arrays)
        output.write(content.getbuffer())


def lower_limit(name: str, limit: int) -> None:
    """Lowers a limit of this process; Windows has none."""
    try:
        import resource
    except ModuleNotFoundError:
        return
    what = getattr(resource, name)
    soft, hard = (limit if old == resource.RLIM_INFINITY else min(limit, old) for old in resource.getrlimit(what))
    resource.setrlimit(what, (soft, hard))


def program_of(file: Path) -> str:
    """Which of the two reads a file."""
    return "VTK" if file.suffix.lower() in (".vtk", ".vtp", ".vtu") else "Gmsh"


def read_arrays(file: str) -> dict[str, Any]:
    """What is in a file of cells.

    Returns:
        nodes: (N,) tags, in any order.
        points: (3 N,) of the nodes, m.
        kinds: names of the kinds of cells that fill a volume: "tetrahedron", "hexahedron", others as the program says.
        numbers: (C,) of the hexahedra, where there are any, else of the tetrahedra.
        cells: (V C,) node tags of their corners, in VTK's order.
        edges: (3 E,) node tags of the edges of second-order ones: both ends and the node between them.
        dimensions, tags, names: of the physical groups of faces (2) or cells (3), of VTK of the values of each array of
            whole numbers; empty names where there are none. Group k has `group{k}`: node tags of the corners of its
            faces, one after the other, or numbers of its cells.
        vectors: of VTK, names of cell data of three numbers; those of array k are `vector{k}`, (3 C,).
    """
    return _read_vtk(file) if program_of(Path(file)) == "VTK" else _read_gmsh(file)


def _gmsh() -> Any:
    import gmsh

    gmsh.initialize([], readConfigFiles=False)
    gmsh.option.setNumber("General.Terminal", 0)
    return gmsh


def _read_gmsh(file: str) -> dict[str, Any]:
    gmsh = _gmsh()
    gmsh.merge(file)
    mesh = gmsh.model.mesh

    def elements(kinds: dict[int, int], entity: int = -1) -> tuple[Any, Any]:
        """Numbers, and node tags of the corners."""
        found = [(mesh.getElementsByType(kind, entity), count) for kind, count in kinds.items()]
        nodes = [nodes.reshape(-1, count)[:, : min(kinds.values())].ravel() for (_, nodes), count in found]
        return np.concatenate([numbers for (numbers, _), _ in found]), np.concatenate(nodes)

    tags, coordinates, _ = mesh.getNodes()
    held = mesh.getElementTypes(3)
    solids, faces = GMSH_KINDS[8 if set(held) & GMSH_KINDS[8][0].keys() else 4]
    numbers, cells = elements(solids)
    groups = [group for group in gmsh.model.getPhysicalGroups() if group[0] in (2, 3)]
    members = {}
    for k, (dimension, tag) in enumerate(groups):
        entities = gmsh.model.getEntitiesForPhysicalGroup(dimension, tag)
        parts = [elements(faces if dimension == 2 else solids, e)[3 - dimension] for e in entities]
        members[f"group{k}"] = np.concatenate([np.empty(0, np.uint64), *parts])
    middles = [
        edges_of(mesh.getElementsByType(kind)[1].reshape(-1, count), GMSH_MIDDLES[kind])
        for kind, count in solids.items()
        if kind in GMSH_MIDDLES
    ]
    return members | {
        "nodes": tags,
        "points": coordinates,
        "kinds": np.array([_name(kind, GMSH_KINDS) or mesh.getElementProperties(kind)[0] for kind in held], dtype=str),
        "numbers": numbers,
        "cells": cells,
        "edges": np.concatenate(middles).ravel(),
        "dimensions": np.array([dimension for dimension, _ in groups], dtype=int),
        "tags": np.array([tag for _, tag in groups], dtype=int),
        "names": np.array([gmsh.model.getPhysicalName(*group) for group in groups], dtype=str),
    }


def edges_of(nodes: np.ndarray, middles: np.ndarray) -> np.ndarray:
    """Both ends and the node between, (M C, 3), of the nodes (C, any) of cells; which of them these are, (M, 3)."""
    return nodes[:, middles].reshape(-1, 3)


def _name(kind: int, kinds: dict[int, tuple[dict[int, int], dict[int, int]]]) -> str:
    """Of a kind of cells by its number; empty of those that are not read."""
    return {4: "tetrahedron", 8: "hexahedron"}.get(next((n for n, of in kinds.items() if kind in of[0]), 0), "")


def _read_vtk(file: str) -> dict[str, Any]:
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkCommonDataModel import vtkCellTypes, vtkUnstructuredGrid

    grid = _vtk_data(file)
    if not isinstance(grid, vtkUnstructuredGrid):
        raise ValueError(f"it holds {grid.GetClassName()}; allowed is an unstructured grid of tetrahedra or hexahedra")
    count, data = grid.GetNumberOfCells(), grid.GetCellData()
    kinds = np.array([grid.GetCellType(k) for k in range(count)], dtype=int)
    starts = vtk_to_numpy(grid.GetCells().GetOffsetsArray()) if count else np.empty(0, int)
    nodes = vtk_to_numpy(grid.GetCells().GetConnectivityArray()) if count else np.empty(0, int)
    solids, faces = VTK_KINDS[8 if np.isin(kinds, list(VTK_KINDS[8][0])).any() else 4]
    for kind, number in (solids | faces).items():
        has_others = (np.diff(starts) != number) & (kinds == kind)
        if has_others.any():
            raise ValueError(f"{has_others.sum()} cells of type {kind} do not have {number} nodes")

    def corners(of: np.ndarray, number: int) -> np.ndarray:
        return nodes[starts[of][:, None] + np.arange(number)]

    of_volume, of_surface = (np.flatnonzero(np.isin(kinds, list(k))) for k in (solids, faces))
    middles = [
        edges_of(corners(np.flatnonzero(kinds == kind), number), VTK_MIDDLES[kind])
        for kind, number in solids.items()
        if kind in VTK_MIDDLES
    ]
    solid = [int(kind) for kind in np.unique(kinds) if vtkCellTypes.GetDimension(int(kind)) == 3]
    groups: list[tuple[int, int]] = []
    arrays = [array for k in range(data.GetNumberOfArrays()) if (array := data.GetArray(k)) is not None]
    vectors = [array for array in arrays if array.GetNumberOfComponents() == 3]
    members = {f"vector{k}": vtk_to_numpy(of)[of_volume].astype(float).ravel() for k, of in enumerate(vectors)}
    for array in arrays:
        if array.GetNumberOfComponents() != 1 or array.GetDataTypeAsString() in ("float", "double"):
            continue
        values = vtk_to_numpy(array)
        for dimension, cells in ((2, of_surface), (3, of_volume)):
            for tag in np.unique(values[cells]):
                of = cells[values[cells] == tag]
                members[f"group{len(groups)}"] = corners(of, min(faces.values())).ravel() if dimension == 2 else of
                groups.append((dimension, int(tag)))
    return members | {
        "nodes": np.arange(grid.GetNumberOfPoints()),
        "points": vtk_to_numpy(grid.GetPoints().GetData()).astype(float).ravel() if grid.GetPoints() else np.empty(0),
        "kinds": np.array([_vtk_kind(kind) for kind in solid], dtype=str),
        "numbers": of_volume,
        "cells": corners(of_volume, min(solids.values())).ravel(),
        "edges": np.concatenate(middles).ravel(),
        "dimensions": np.array([dimension for dimension, _ in groups], dtype=int),
        "tags": np.array([tag for _, tag in groups], dtype=int),
        "names": np.array([""] * len(groups), dtype=str),
        "vectors": np.array([array.GetName() or "" for array in vectors], dtype=str),
    }


def _vtk_data(file: str) -> Any:
    """What VTK reads of a file; ValueError of one that is damaged."""
    from vtkmodules.vtkCommonCore import vtkOutputWindow, vtkStringOutputWindow
    from vtkmodules.vtkIOLegacy import vtkGenericDataObjectReader
    from vtkmodules.vtkIOXML import vtkXMLGenericDataObjectReader

    window = vtkStringOutputWindow()  # where the readers in a reader tell their errors, which it keeps for itself
    vtkOutputWindow.SetInstance(window)
    with Path(file).open("rb") as stream:  # of either ending
        is_xml = stream.read(4096).lstrip(b"\xef\xbb\xbf \t\r\n").startswith((b"<?xml", b"<VTKFile", b"<!--"))
    reader = vtkXMLGenericDataObjectReader() if is_xml else vtkGenericDataObjectReader()
    reader.SetFileName(file)
    reader.Update()
    grid = reader.GetOutputDataObject(0)
    error = re.search(r"ERROR: In [^\n]*\n[^\n]*?\): ([^\n]*)", window.GetOutput())
    if error is not None or grid is None:
        raise ValueError(f"it is damaged, cut, or in no format of VTK's{f' ({error[1].strip()})' if error else ''}")
    if is_xml:
        _check_count_of_cells(file)
    return grid


def _check_count_of_cells(file: str) -> None:
    """Refuses XML with more cells in text than it says, which VTK passes over."""
    try:
        pieces = [*ElementTree.parse(file).iter("Piece")]
    except ElementTree.ParseError:  # of binary data at its end
        return
    for piece in pieces:
        types = piece.find("Cells/DataArray[@Name='types'][@format='ascii']")
        told, held = piece.get("NumberOfCells"), len((types.text or "").split()) if types is not None else None
        if held is not None and told != str(held):
            raise ValueError(f"it says {told} cells and holds {held}: it was cut or changed")


def _vtk_kind(kind: int) -> str:
    from vtkmodules.vtkCommonDataModel import vtkCellTypes

    return _name(kind, VTK_KINDS) or str(vtkCellTypes.GetClassNameFromTypeId(kind)).removeprefix("vtk")


def read_surface(file: str) -> dict[str, Any]:
    """Points (3 N,) and triangles (3 T,), outward: of a file of VTK, or around the solids of a STEP file, m."""
    return _vtk_surface(file) if program_of(Path(file)) == "VTK" else _step_surface(file)


def _vtk_surface(file: str) -> dict[str, Any]:
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkCommonDataModel import vtkPointSet
    from vtkmodules.vtkFiltersCore import vtkTriangleFilter
    from vtkmodules.vtkFiltersGeometry import vtkGeometryFilter

    data = _vtk_data(file)
    if not isinstance(data, vtkPointSet):
        raise ValueError(f"it holds {data.GetClassName()}; allowed are polygons, or an unstructured grid")
    outer, split = vtkGeometryFilter(), vtkTriangleFilter()
    outer.SetInputData(data)
    split.SetInputConnection(outer.GetOutputPort())
    split.PassVertsOff()
    split.PassLinesOff()
    split.Update()
    found = split.GetOutput()
    if not found.GetNumberOfCells():
        return {"points": np.empty(0), "triangles": np.empty(0, int)}
    triangles = vtk_to_numpy(found.GetPolys().GetConnectivityArray())
    return {"points": vtk_to_numpy(found.GetPoints().GetData()).astype(float).ravel(), "triangles": triangles}


def _step_surface(file: str) -> dict[str, Any]:
    gmsh = _gmsh()
    gmsh.option.setString("Geometry.OCCTargetUnit", "M")
    gmsh.model.occ.importShapes(file)
    gmsh.model.occ.synchronize()
    solids, mesh = gmsh.model.getEntities(3), gmsh.model.mesh
    if not solids:
        raise ValueError("it holds no solid, only surfaces")
    gmsh.option.setNumber("Mesh.MeshSizeFromCurvature", AROUND)
    mesh.generate(2)
    tags, points, _ = mesh.getNodes()
    order = np.argsort(tags)
    points, triangles = points.reshape(-1, 3)[order], []
    for solid in solids:
        faces = (mesh.getElementsByType(2, face)[1] for _, face in gmsh.model.getBoundary([solid], oriented=False))
        patches = [np.searchsorted(tags[order], corners).reshape(-1, 3) for corners in faces]
        triangles.append(_turned_outward(points, patches))
    return {"points": points.ravel(), "triangles": np.concatenate(triangles).ravel()}


def _turned_outward(points: np.ndarray, patches: list[np.ndarray]) -> np.ndarray:
    """Triangles (T, 3) around a solid, of patches (t, 3) that are each turned one way, in or out.

    Two patches go along the border that they share in opposite ways. Of the shells of one solid the largest is outside.
    """
    borders = [_border(patch) for patch in patches]
    beside: dict[tuple[int, int], list[int]] = {}
    for number, border in enumerate(borders):
        for side in border:
            beside.setdefault(side, []).append(number)
    turns, shells = [0] * len(patches), []
    for first in range(len(patches)):
        if turns[first]:
            continue
        turns[first], waiting, shell = 1, [first], [first]
        while waiting:
            patch = waiting.pop()
            for side, way in borders[patch].items():
                for other in beside[side]:
                    if not turns[other]:
                        turns[other] = -turns[patch] * way * borders[other][side]
                        waiting.append(other)
                        shell.append(other)
        shells.append(np.concatenate([patches[k] if turns[k] > 0 else patches[k][:, ::-1] for k in shell]))
    a, b, c = ([points[shell[:, k]] for shell in shells] for k in range(3))
    volumes = [float((x * np.cross(y, z)).sum()) for x, y, z in zip(a, b, c, strict=True)]
    outside = int(np.abs(volumes).argmax())
    signs = [volume if k == outside else -volume for k, volume in enumerate(volumes)]
    return np.concatenate([shell if sign > 0 else shell[:, ::-1] for shell, sign in zip(shells, signs, strict=True)])


def _border(triangles: np.ndarray) -> dict[tuple[int, int], int]:
    """Sides (low, high) that one of the triangles (t, 3) has alone: 1 where it goes from low to high, else -1."""
    sides = np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2).reshape(-1, 2)
    unique, row, count = np.unique(np.sort(sides, axis=1), axis=0, return_index=True, return_counts=True)
    alone, ways = unique[count == 1], np.where(sides[row, 0] < sides[row, 1], 1, -1)[count == 1]
    return {(int(low), int(high)): int(way) for (low, high), way in zip(alone, ways, strict=True)}


def fill_surface(file: str, size: float, glue: bool) -> dict[str, Any]:
    """Points (3 N,) and cells (4 C,) of tetrahedra of a size that fill a closed surface, or what a STEP file holds.

    Solids that are to be glued are divided where they meet.
    """
    gmsh = _gmsh()
    gmsh.option.setString("Geometry.OCCTargetUnit", "M")
    mesh = gmsh.model.mesh
    if file.lower().endswith(".stl"):
        gmsh.merge(file)
        _check_closed(mesh)
        mesh.classifySurfaces(FEATURE_ANGLE, True, True, np.pi)
        mesh.createGeometry()
        loop = gmsh.model.geo.addSurfaceLoop([tag for _, tag in gmsh.model.getEntities(2)])
        gmsh.model.geo.addVolume([loop])
        gmsh.model.geo.synchronize()
    else:
        gmsh.model.occ.importShapes(file)
        solids = gmsh.model.occ.getEntities(3)
        if glue and len(solids) > 1:
            gmsh.model.occ.fragment(solids[:1], solids[1:])
        gmsh.model.occ.synchronize()
    if not gmsh.model.getEntities(3):
        raise ValueError("it holds no solid, only surfaces")
    for option in ("Mesh.MeshSizeMin", "Mesh.MeshSizeMax"):
        gmsh.option.setNumber(option, size)
    try:
        mesh.generate(3)
    except Exception as error:  # Gmsh's own
        if "intersect" not in str(error):
            raise
        raise ValueError(f"its surface intersects itself ({error})") from error
    tags, points, _ = mesh.getNodes()
    order = np.argsort(tags)
    cells = np.searchsorted(tags[order], mesh.getElementsByType(4)[1])
    return {"points": points.reshape(-1, 3)[order].ravel(), "cells": cells}


def _check_closed(mesh: Any) -> None:
    """Refuses a surface with edges that are not between two triangles."""
    nodes, points, _ = mesh.getNodes()
    triangles = mesh.getElementsByType(2)[1].reshape(-1, 3)
    if not len(triangles):
        raise ValueError("it holds no triangles")
    sides = np.sort(triangles[:, [[0, 1], [1, 2], [0, 2]]].reshape(-1, 2), axis=1)
    edges, count = np.unique(sides, axis=0, return_counts=True)
    loose = edges[count != 2]
    if len(loose):
        at = points.reshape(-1, 3)[nodes == loose[0, 0]][0]
        raise ValueError(
            f"its surface is not closed: {len(loose)} of {len(edges)} edges are not between two triangles, e.g. one at "
            f"{at.round(9).tolist()}"
        )


if __name__ == "__main__":
    main()
