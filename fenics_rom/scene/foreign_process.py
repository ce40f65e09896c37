"""A process of its own that lets Gmsh or VTK read a mesh file and writes arrays to standard output.

They crash on some damaged files; here they take nobody with them. It is started by `foreign_file`, as a script, so that
it needs NumPy and Gmsh or VTK only.
"""

import io
import os
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

BASE_MEMORY = 2**30  # bytes of address space that Gmsh may take for any file, of which it takes a fifth by itself
VTK_MEMORY = 2**32  # and VTK, of which it takes a fifth
MEMORY_PER_BYTE = 50  # and for each byte of the file, of which they take five to ten
# Numbers of kinds of cells, and of their faces, by the number of their nodes.
GMSH_CELLS = {4: 4, 10: 11, 5: 7, 13: 19, 14: 14, 6: 6, 15: 18, 18: 13, 8: 5, 20: 17, 27: 12}
VTK_CELLS = {4: 10, 10: 24, 5: 14, 13: 27, 6: 13, 15: 26, 18: 32, 8: 12, 20: 25, 27: 29}
GMSH_FACES = {3: {3: 2, 6: 9}, 4: {4: 3, 8: 16, 9: 10}}  # by the number of their corners
VTK_FACES = {3: {3: 5, 6: 22}, 4: {4: 9, 8: 23, 9: 28}}
# Which of Gmsh's nodes are VTK's, after the corners.
PYRAMID, PRISM = (5, 8, 10, 6, 7, 9, 11, 12), (6, 9, 7, 12, 14, 13, 8, 10, 11)
HEXAHEDRON = 8, 11, 13, 9, 16, 18, 19, 17, 10, 12, 14, 15
FROM_GMSH = {10: (4, 5, 6, 7, 9, 8), 13: PYRAMID, 14: (*PYRAMID, 13), 15: PRISM, 18: (*PRISM, 15, 17, 16)}
FROM_GMSH |= {20: HEXAHEDRON, 27: (*HEXAHEDRON, 22, 23, 21, 24, 20, 25, 26)}
AROUND = 48  # triangles around a round face of a STEP file


def main() -> None:
    """Reads the file that the command line names, or its surface, or ends with a message."""
    file, *words = sys.argv[1:]
    base = BASE_MEMORY if program_of(Path(file)) == "Gmsh" else VTK_MEMORY
    lower_limit("RLIMIT_AS", base + MEMORY_PER_BYTE * Path(file).stat().st_size)  # sizes in a file may lie
    answer(lambda: read_surface(file) if words == ["surface"] else read_arrays(file))


def answer(find: Callable[[], dict[str, Any]]) -> None:
    """Writes arrays that are found to standard output, or ends with a message."""
    lower_limit("RLIMIT_CORE", 0)  # a crash leaves nothing behind
    with os.fdopen(os.dup(1), "wb") as output:
        os.dup2(2, 1)  # what libraries print is no part of the arrays
        try:
            arrays = find()
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
        others: names of the kinds of cells that fill a volume and are not read.
        sizes: numbers of nodes of the other kinds, each of which has cells{size}: (size C,) node tags in VTK's order.
        numbers: (C,) of the cells of all these, one kind after the other.
        dimensions, tags, names: of the physical groups of faces (2) or cells (3), of VTK of the values of each array of
            whole numbers; empty names where there are none. Group k has `group{k}`: numbers of its cells, or node tags
            of the corners of its triangles, one after the other; and those of its quadrilaterals,
            `quadrilaterals{k}`.
        vectors: of VTK, names of cell data of three numbers; those of array k are `vector{k}`, (3 C,).
    """
    return _read_vtk(file) if program_of(Path(file)) == "VTK" else _read_gmsh(file)


def gmsh_package() -> Any:
    """Gmsh, which says nothing by itself."""
    import gmsh

    gmsh.initialize([], readConfigFiles=False)
    gmsh.option.setNumber("General.Terminal", 0)
    return gmsh


def _read_gmsh(file: str) -> dict[str, Any]:
    gmsh = gmsh_package()
    gmsh.merge(file)
    mesh = gmsh.model.mesh

    tags, coordinates, _ = mesh.getNodes()
    held = mesh.getElementTypes(3)
    sizes = [size for size, kind in GMSH_CELLS.items() if kind in held]
    every = {size: mesh.getElementsByType(GMSH_CELLS[size]) for size in sizes}

    def corners(kinds: dict[int, int], count: int, entity: int) -> Any:
        """Node tags of the corners of faces."""
        found = [mesh.getElementsByType(kind, entity)[1].reshape(-1, size) for size, kind in kinds.items()]
        return np.concatenate([nodes[:, :count].ravel() for nodes in found])

    groups = [group for group in gmsh.model.getPhysicalGroups() if group[0] in (2, 3)]
    members = {f"cells{size}": in_vtk_order(nodes.reshape(-1, size)).ravel() for size, (_, nodes) in every.items()}
    none = np.empty(0, np.uint64)
    for k, (dimension, tag) in enumerate(groups):
        entities = gmsh.model.getEntitiesForPhysicalGroup(dimension, tag)
        if dimension == 3:
            of = [mesh.getElementsByType(GMSH_CELLS[size], entity)[0] for size in sizes for entity in entities]
            members[f"group{k}"] = np.concatenate([none, *of])
        else:
            for count, name in ((3, "group"), (4, "quadrilaterals")):
                of = [corners(GMSH_FACES[count], count, entity) for entity in entities]
                members[f"{name}{k}"] = np.concatenate([none, *of])
    others = [mesh.getElementProperties(kind)[0] for kind in held if kind not in GMSH_CELLS.values()]
    return members | {
        "nodes": tags,
        "points": coordinates,
        "others": np.array(others, dtype=str),
        "sizes": np.array(sizes, dtype=int),
        "numbers": np.concatenate([none, *(numbers for numbers, _ in every.values())]),
        "dimensions": np.array([dimension for dimension, _ in groups], dtype=int),
        "tags": np.array([tag for _, tag in groups], dtype=int),
        "names": np.array([gmsh.model.getPhysicalName(*group) for group in groups], dtype=str),
    }


def in_vtk_order(cells: np.ndarray) -> np.ndarray:
    """Nodes (C, any) of Gmsh's cells."""
    after = FROM_GMSH.get(cells.shape[1], ())
    return cells[:, [*range(cells.shape[1] - len(after)), *after]]


def _read_vtk(file: str) -> dict[str, Any]:
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkCommonDataModel import vtkCellTypes, vtkUnstructuredGrid

    grid = _vtk_data(file)
    if not isinstance(grid, vtkUnstructuredGrid):
        raise ValueError(f"it holds {grid.GetClassName()}; use an unstructured grid of cells")
    count, data = grid.GetNumberOfCells(), grid.GetCellData()
    kinds = np.array([grid.GetCellType(k) for k in range(count)], dtype=int)
    starts = vtk_to_numpy(grid.GetCells().GetOffsetsArray()) if count else np.empty(0, int)
    nodes = vtk_to_numpy(grid.GetCells().GetConnectivityArray()) if count else np.empty(0, int)
    by_faces = {kind: size for of in VTK_FACES.values() for size, kind in of.items()}
    for kind, number in ({kind: size for size, kind in VTK_CELLS.items()} | by_faces).items():
        has_others = (np.diff(starts) != number) & (kinds == kind)
        if has_others.any():
            raise ValueError(f"{has_others.sum()} cells of type {kind} do not have {number} nodes")

    def first(of: np.ndarray, number: int) -> np.ndarray:
        return nodes[starts[of][:, None] + np.arange(number)]

    of_size = {size: np.flatnonzero(kinds == kind) for size, kind in VTK_CELLS.items() if (kinds == kind).any()}
    members = {f"cells{size}": first(of, size).ravel() for size, of in of_size.items()}
    of_volume = np.concatenate([np.empty(0, int), *of_size.values()])
    of_faces = {count: np.flatnonzero(np.isin(kinds, list(of.values()))) for count, of in VTK_FACES.items()}
    solid = [int(kind) for kind in np.unique(kinds) if vtkCellTypes.GetDimension(int(kind)) == 3]
    others = [kind for kind in solid if kind not in VTK_CELLS.values()]
    groups: list[tuple[int, int]] = []
    arrays = [array for k in range(data.GetNumberOfArrays()) if (array := data.GetArray(k)) is not None]
    vectors = [array for array in arrays if array.GetNumberOfComponents() == 3]
    members |= {f"vector{k}": vtk_to_numpy(of)[of_volume].astype(float).ravel() for k, of in enumerate(vectors)}
    for array in arrays:
        if array.GetNumberOfComponents() != 1 or array.GetDataTypeAsString() in ("float", "double"):
            continue
        values = vtk_to_numpy(array)
        for dimension, cells in ((2, np.concatenate([*of_faces.values()])), (3, of_volume)):
            for tag in np.unique(values[cells]):
                if dimension == 3:
                    members[f"group{len(groups)}"] = cells[values[cells] == tag]
                else:
                    for count, name in ((3, "group"), (4, "quadrilaterals")):
                        of = of_faces[count][values[of_faces[count]] == tag]
                        members[f"{name}{len(groups)}"] = first(of, count).ravel()
                groups.append((dimension, int(tag)))
    return members | {
        "nodes": np.arange(grid.GetNumberOfPoints()),
        "points": vtk_to_numpy(grid.GetPoints().GetData()).astype(float).ravel() if grid.GetPoints() else np.empty(0),
        "others": np.array(
            [str(vtkCellTypes.GetClassNameFromTypeId(k)).removeprefix("vtk") for k in others], dtype=str
        ),
        "sizes": np.array([*of_size], dtype=int),
        "numbers": of_volume,
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
        raise ValueError(f"it holds {data.GetClassName()}; use polygons, or an unstructured grid")
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
    gmsh = gmsh_package()
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


if __name__ == "__main__":
    main()
