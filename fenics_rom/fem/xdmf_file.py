"""XDMF files as dolfinx and meshio write them: one mesh of cells of one type, and its tags as groups.

Not by dolfinx, which a cell of a node that is not there ends by a signal, and which passes over tags of what is no face
of its cells.
"""

from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import h5py
import numpy as np

from fenics_rom.errors import MeshError
from fenics_rom.fem.cell_kinds import halves
from fenics_rom.fem.file_cells import SHAPES, computable
from fenics_rom.fem.mesh_arrays import MeshArrays

# Nodes of cells by their type, in VTK's order.
CELLS = {"tetrahedron": 4, "tetrahedron_10": 10, "tet_10": 10, "pyramid": 5, "pyramid_13": 13}
CELLS |= {"wedge": 6, "wedge_15": 15, "wedge_18": 18}
CELLS |= {"hexahedron": 8, "hexahedron_20": 20, "hex_20": 20, "hexahedron_27": 27, "hex_27": 27}
TRIANGLES = {"triangle": 3, "triangle_6": 6, "tri_6": 6}
FACES = TRIANGLES | {"quadrilateral": 4, "quadrilateral_8": 8, "quad_8": 8, "quadrilateral_9": 9, "quad_9": 9}


def read_xdmf(file: Path, groups: Mapping[str, int] | None) -> MeshArrays:
    """What is in an XDMF file: the mesh of its first grid, the tags of that and of other grids.

    Args:
        file: its path; arrays are in it, or in HDF5 files beside it.
        groups: as in `mesh.read_mesh`.

    Raises:
        MeshError: it cannot be read, its arrays are not as long as it says, or its cells are neither.
    """
    try:
        return _read(file, groups)
    except (ElementTree.ParseError, OSError, KeyError, ValueError) as error:
        raise MeshError(f"mesh file {file}: cannot be read as XDMF: {error}") from error


def _read(file: Path, groups: Mapping[str, int] | None) -> MeshArrays:
    grids = [grid for grid in ElementTree.parse(file).getroot().iter("Grid") if grid.find("Topology") is not None]
    if not grids:
        raise ValueError("it has no grid with a topology")
    shape = _shape(grids[0])
    if shape not in CELLS:
        raise MeshError(f"mesh file {file}: holds cells of type {shape}; use {', '.join(CELLS)}")
    points = _array(grids[0].find("Geometry/DataItem"), file.parent).astype(float)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"its nodes have the shape {points.shape}; use three coordinates each")
    cells = _elements(grids[0], file.parent, len(points))
    corners, made = SHAPES[cells.shape[1]].corners, computable(points, [cells], file)
    surfaces: dict[str, np.ndarray] = {}
    regions: dict[str, np.ndarray] = {}
    vectors: dict[str, np.ndarray] = {}
    for grid in grids:
        if _shape(grid) not in CELLS | FACES:
            continue
        elements = cells if grid is grids[0] else _elements(grid, file.parent, len(points))
        for attribute in grid.iterfind("Attribute[@Center='Cell']"):
            name, values = grid.get("Name", ""), _array(attribute.find("DataItem"), file.parent)
            if grid is grids[0] and values.shape == (len(cells), 3):
                vectors[attribute.get("Name", "")] = values.astype(float)[made.origin]
                continue
            values = values.ravel()
            if not np.issubdtype(values.dtype, np.integer):
                continue  # a field
            if len(values) != len(elements):
                raise ValueError(f"tags {name!r} are {len(values)} of {len(elements)} elements")
            named = {str(value): int(value) for value in np.unique(values)} if groups is None else groups
            parts = {group: values == value for group, value in named.items() if (values == value).any()}
            if grid is not grids[0]:
                parts = {name: np.ones(len(values), dtype=bool)} | parts
            is_surface = _shape(grid) in FACES
            for group, chosen in parts.items():
                if group in (surfaces if is_surface else regions):
                    raise MeshError(f"mesh file {file}: group {group!r} is in {name!r} and in other tags before it")
                if is_surface:
                    surfaces[group] = halves(elements[chosen][:, : 3 if _shape(grid) in TRIANGLES else 4]).reshape(
                        -1, 3
                    )
                else:
                    regions[group] = made.rows(_rows(elements[chosen][:, :corners], cells[:, :corners], name))
    return made.arrays(surfaces, regions, vectors)


def _shape(grid: Element) -> str:
    topology = grid.find("Topology")
    assert topology is not None
    return (topology.get("TopologyType") or topology.get("Type") or "").lower()


def _elements(grid: Element, folder: Path, nodes: int) -> np.ndarray:
    """Nodes of the elements of a grid, which must be there and be as many as it says."""
    topology = grid.find("Topology")
    assert topology is not None
    elements = _array(topology.find("DataItem"), folder).astype(np.int64)
    told, length = topology.get("NumberOfElements"), (CELLS | FACES)[_shape(grid)]
    if elements.ndim != 2 or elements.shape[1] != length:
        raise ValueError(f"its {_shape(grid)}s have the shape {elements.shape}; use {length} nodes each")
    if told is not None and told.split() != [str(len(elements))]:
        raise ValueError(f"it says {told} elements and holds {len(elements)}")
    lacking = elements[(elements < 0) | (elements >= nodes)]
    if len(lacking):
        raise ValueError(f"it names nodes that it does not hold: {len(np.unique(lacking))}, e.g. {lacking[0]}")
    return elements


def _array(item: Element | None, folder: Path) -> np.ndarray:
    """Numbers of a data item, in the shape that it says."""
    if item is None:
        raise ValueError("it lacks a data item")
    text, form = (item.text or "").strip(), item.get("Format", "XML").upper()
    shape = tuple(map(int, item.get("Dimensions", "").split()))
    if form == "HDF":
        name, _, path = text.rpartition(":")
        with h5py.File(folder / name, "r") as h5:
            data = h5[path]
            if data.shape != shape:
                raise ValueError(f"it says that {path} has the shape {shape}, and {name} holds {data.shape}")
            return np.asarray(data[()])
    if form == "XML" and len(item) == 0:
        numbers = np.array(text.split(), dtype=float)
        if numbers.size != np.prod(shape):
            raise ValueError(f"it says {shape} numbers and holds {numbers.size}")
        return (numbers if item.get("NumberType", "Float") == "Float" else numbers.astype(np.int64)).reshape(shape)
    raise ValueError(f"data in format {form} are not read; use HDF or XML")


def _rows(elements: np.ndarray, cells: np.ndarray, name: str) -> np.ndarray:
    """Which cells elements are, by their nodes."""
    both = np.sort(np.concatenate([cells, elements]), axis=1)
    _, first, number = np.unique(both, axis=0, return_index=True, return_inverse=True)
    rows = first[number.ravel()[len(cells) :]]
    if (rows >= len(cells)).any():
        raise ValueError(
            f"{(rows >= len(cells)).sum()} of {len(rows)} elements with tags {name!r} are no cells of its mesh"
        )
    return rows
