"""A mesh file as plain arrays: points, cells, named surfaces and regions.

Groups may overlap (a contact patch on a clamp, one patch inside another), which tags of one value per facet could
not hold. Everything here runs on one rank.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from fenics_rom.errors import MeshError, check_known
from fenics_rom.fem.abaqus_file import read_abaqus
from fenics_rom.fem.cell_kinds import TETRAHEDRON, CellKind, halves
from fenics_rom.fem.cell_overlaps import describe_overlaps
from fenics_rom.fem.file_cells import ALLOWED, computable
from fenics_rom.fem.mesh_arrays import NO_EDGES, MeshArrays
from fenics_rom.fem.mesh_gaps import describe_gaps
from fenics_rom.fem.mesh_quality import check_filling, straight_volumes
from fenics_rom.fem.msh_sections import check_sections
from fenics_rom.fem.xdmf_file import read_xdmf
from fenics_rom.scene import foreign_file

FLAT = 1e-12  # volume of a cell that has none, of the cube of its longest edge
SURFACES = (".stl", ".step", ".stp")  # what Gmsh can fill


@dataclass(frozen=True)
class Mesh:
    """Cells of one kind."""

    points: np.ndarray  # (N, 3), m
    cells: np.ndarray  # (C, V), positively oriented
    surfaces: Mapping[str, np.ndarray]  # triangles of each named surface, (F, 3) each; quadrilaterals as `halves`
    regions: Mapping[str, np.ndarray]  # cells of each named region, as rows of `cells`
    source: str  # file name for messages
    edges: np.ndarray = field(
        default_factory=lambda: NO_EDGES
    )  # (E, 3) of second-order cells: two ends, and the node between
    notes: tuple[str, ...] = ()  # what the user should know of the file
    vectors: Mapping[str, np.ndarray] = field(default_factory=dict)  # cell data of three numbers, (C, 3) each
    kind: CellKind = TETRAHEDRON

    @property
    def bend(self) -> float:
        """By how much nodes on edges of second-order cells are off their middles at most, m."""
        ends, middles = self.points[self.edges[:, :2]], self.points[self.edges[:, 2]]
        return float(np.linalg.norm(middles - ends.mean(axis=1), axis=1).max(initial=0.0))

    def surface(self, name: str) -> np.ndarray:
        """Triangles of a named surface; refuses one that is not there, or empty."""
        return self._group("surface", name, self.surfaces)

    def region(self, name: str) -> np.ndarray:
        """Cells of a named region; refuses one that is not there, or empty."""
        return self._group("region", name, self.regions)

    def _group(self, kind: str, name: str, groups: Mapping[str, np.ndarray]) -> np.ndarray:
        if not self.surfaces and not self.regions:
            raise MeshError(
                f"{self.source}: no {kind} {name!r}; there is none: the file has no physical groups; name surfaces and "
                "volumes where the mesh is made (in Gmsh: Physical Surface, Physical Volume)"
            )
        check_known(kind, name, groups, MeshError, f"{self.source}: ")
        if len(groups[name]) == 0:
            raise MeshError(f"{self.source}: {kind} {name!r} is empty")
        return groups[name]


def read_mesh(file: Path, groups: Mapping[str, int] | None, scale: float = 1.0) -> Mesh:
    """Reads a mesh of tetrahedra or hexahedra.

    Args:
        file: path; `.msh` of Gmsh with physical groups, `.inp` of Abaqus with sets, `.vtk` or `.vtu` with cell data of
            whole numbers, or `.xdmf` as dolfinx and meshio write it.
        groups: names for tags that have none in the file (XDMF and VTK hold tag values only). In XDMF, tags written
            under a name of their own are also a group of that name. None: each tag is a group of that number.
        scale: metres that a unit of its coordinates is worth.

    Raises:
        MeshError: the file is missing, unreadable, or holds no usable cells, or some that overlap.
    """
    try:
        if not file.is_file():
            raise MeshError(f"mesh file {file}: not found")
    except OSError as error:  # a name that is too long
        raise MeshError(f"mesh file {file}: {error.strerror}") from error
    readers = {".msh": _read_gmsh, ".inp": _read_inp, ".vtk": _read_vtk, ".vtu": _read_vtk, ".xdmf": read_xdmf}
    if file.suffix not in readers:
        filled = f"; fenics-rom mesh {file.name} -o part.msh --size LENGTH fills it" if file.suffix in SURFACES else ""
        raise MeshError(f"mesh file {file}: use a file that ends in {', '.join(readers)}{filled}")
    try:
        found = readers[file.suffix](file, groups)
    except OSError as error:
        raise MeshError(f"mesh file {file}: cannot be read: {error.strerror or error}") from error
    return checked_mesh(found, file, scale)


def checked_mesh(found: MeshArrays, file: Path, scale: float = 1.0) -> Mesh:
    """The mesh of what was found, with what the user should know of it.

    Args:
        found: points and cells in the unit of the file.
        file: where it was found, for messages.
        scale: metres that a unit of it is worth.

    Raises:
        MeshError: there are no usable cells, or some overlap their neighbours.
    """
    check_cells(found, file)
    points, kind = scale * found.points, found.kind
    cells, regions, kept = _deduplicate(oriented(points, found.cells, kind), found.regions)
    vectors = {name: values[kept] for name, values in found.vectors.items()}
    parts = kind.tetrahedra(cells)
    faces = check_filling(points, parts, f"mesh file {file}")
    notes = (
        *found.notes,
        *describe_gaps(found, points, parts, faces),
        *describe_overlaps(points, oriented(points, parts), faces, file.name),
    )
    return Mesh(points, cells, found.surfaces, regions, str(file), found.edges, notes, vectors, kind)


def oriented(points: np.ndarray, cells: np.ndarray, kind: CellKind = TETRAHEDRON) -> np.ndarray:
    """The cells with positive volumes; of the others the mirror images."""
    inverted, cells = straight_volumes(points, cells, kind) < 0, cells.copy()
    cells[inverted] = cells[inverted][:, kind.mirror]
    return cells


def check_cells(found: MeshArrays, file: Path) -> None:
    """Refuses none at all, and cells without volume or with a node twice; MeshError says which."""
    points, cells = found.points, found.cells
    if len(cells) == 0:
        raise MeshError(
            f"mesh file {file}: holds no tetrahedra or hexahedra; a surface alone is no body, and shells are not "
            "computed: mesh the volume"
        )
    if not np.isfinite(points).all():
        raise MeshError(f"mesh file {file}: coordinates that are not finite")
    ends = points[cells[:, found.kind.edges]]
    longest = np.linalg.norm(ends[:, :, 0] - ends[:, :, 1], axis=2).max(axis=1)
    flat = np.abs(straight_volumes(points, cells, found.kind)) <= FLAT * longest**3
    if flat.any():
        raise MeshError(
            f"mesh file {file}: {flat.sum()} of {len(cells)} cells have no volume, e.g. cell {flat.argmax()}"
        )
    collapsed = (np.diff(np.sort(cells, axis=1), axis=1) == 0).any(axis=1)
    if collapsed.any():
        raise MeshError(
            f"mesh file {file}: {collapsed.sum()} of {len(cells)} cells have a node twice, e.g. cell "
            f"{collapsed.argmax()}; hexahedra that are collapsed to prisms are not computed: mesh with tetrahedra there"
        )


def _deduplicate(
    cells: np.ndarray, regions: Mapping[str, np.ndarray]
) -> tuple[np.ndarray, dict[str, np.ndarray], np.ndarray]:
    """MSH 2 files repeat a cell for each physical group that it is in; mass and stiffness must count it once.

    The cells, regions of these, and which of the file they are.
    """
    _, first, representative = np.unique(np.sort(cells, axis=1), axis=0, return_index=True, return_inverse=True)
    unique_rows = np.sort(first)
    row = np.searchsorted(unique_rows, first[representative.ravel()])
    return cells[unique_rows], {name: np.unique(row[rows]) for name, rows in regions.items()}, unique_rows


def _read_gmsh(file: Path, groups: Mapping[str, int] | None) -> MeshArrays:
    content = file.read_bytes()
    if not content.startswith((b"$MeshFormat", b"$Comments")):  # Gmsh takes it for a script, and runs it
        raise MeshError(f"mesh file {file}: is not in Gmsh's MSH format, version 2 or 4")
    check_sections(content, f"mesh file {file}")
    return _from_arrays(foreign_file.read_arrays(file), file, groups)


def _read_vtk(file: Path, groups: Mapping[str, int] | None) -> MeshArrays:
    return _from_arrays(foreign_file.read_arrays(file), file, groups)


def _read_inp(file: Path, groups: Mapping[str, int] | None) -> MeshArrays:
    return read_abaqus(file)


def _from_arrays(arrays: Mapping[str, np.ndarray], file: Path, groups: Mapping[str, int] | None) -> MeshArrays:
    if len(arrays["nodes"]) == 0:
        raise MeshError(f"mesh file {file}: holds no nodes")
    order = np.argsort(arrays["nodes"])
    points, tags = arrays["points"].reshape(-1, 3)[order], arrays["nodes"][order]
    if len(arrays["others"]):
        raise MeshError(f"mesh file {file}: holds {', '.join(sorted(arrays['others']))}; use {ALLOWED}")

    def positions(wanted: np.ndarray, among: np.ndarray, what: str) -> np.ndarray:
        rows = np.searchsorted(among, wanted)  # tags may be anything, in any order
        is_held = rows < len(among)
        is_held[is_held] = among[rows[is_held]] == wanted[is_held]
        if not is_held.all():
            lacking = wanted[~is_held]
            raise MeshError(
                f"mesh file {file}: names {what} that it does not hold: {len(np.unique(lacking))}, e.g. {lacking[0]}"
            )
        return rows

    held = [positions(arrays[f"cells{size}"].reshape(-1, size), tags, "nodes") for size in arrays["sizes"]]
    made = computable(points, held, file)
    by_number = np.argsort(arrays["numbers"])
    every_tag = {int(tag): str(tag) for tag in arrays["tags"]}
    named = every_tag if groups is None else {tag: name for name, tag in groups.items()}
    surfaces: dict[str, np.ndarray] = {}
    regions: dict[str, np.ndarray] = {}
    found = [*zip(arrays["dimensions"], arrays["tags"], map(str, arrays["names"]), strict=True)]
    several = {int(tag) for dimension, tag, _ in found if sum(one[:2] == (dimension, tag) for one in found) > 1}
    if several & named.keys():
        raise MeshError(f"mesh file {file}: tag {min(several & named.keys())} is in several arrays of cell data")
    for k, (dimension, tag, in_file) in enumerate(found):
        name, members = in_file or named.get(int(tag)), arrays[f"group{k}"]
        if not name:
            continue
        if dimension == 2:
            for around in (members.reshape(-1, 3), arrays[f"quadrilaterals{k}"].reshape(-1, 4)):
                triangles = halves(positions(around, tags, "nodes")).reshape(-1, 3)
                surfaces[name] = np.concatenate([surfaces.get(name, triangles[:0]), triangles])
        else:
            rows = made.rows(by_number[positions(members, arrays["numbers"][by_number], "cells")])
            regions[name] = np.concatenate([regions.get(name, rows[:0]), rows])
    names = map(str, arrays.get("vectors", ()))
    vectors = {name: arrays[f"vector{k}"].reshape(-1, 3)[made.origin] for k, name in enumerate(names)}
    return made.arrays(surfaces, regions, vectors)
