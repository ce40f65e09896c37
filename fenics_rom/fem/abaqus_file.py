"""Abaqus' input files: nodes, tetrahedra, and sets as groups.

What holds for elements of order two, `edges`, is as in `foreign_process.read_arrays`.

Not by meshio, whose reader (5.3.5, its last release, of January 2024) passes over *Surface and sets that *Node names
(its issue 1527), puts parts and moved instances on one another, and does not say in which line a mistake is.
"""

import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from fenics_rom.errors import MeshError
from fenics_rom.fem.foreign_process import edges_of
from fenics_rom.fem.mesh_quality import CELL_FACES

TETRAHEDRA = {r"C3D4[A-Z]*": 4, r"C3D10[A-Z]*": 10}  # and their nodes
TRIANGLES = {r"(CPS|CPE|CAX|M3D|SFM3D|R3D|DS|S)3[A-Z]*|STRI3": 3, r"(CPS|CPE|CAX|M3D|SFM3D|DS)6[A-Z]*|STRI65": 6}
SOLID = r"(C3D|CC3D|DC3D|AC3D|SC)\d+[A-Z]*"  # what is neither solid nor a triangle is not of the body
FACES = {"S1": (0, 1, 2), "S2": (0, 3, 1), "S3": (1, 3, 2), "S4": (2, 3, 0)}  # of tetrahedra


class AbaqusFile:
    """What an input file holds, by the numbers that it has there.

    Args:
        file: path of an `.inp` file of one part, as Abaqus/CAE or other programs write it.

    Raises:
        MeshError: it cannot be read, has several parts, or one that an assembly moves; with the line.
    """

    def __init__(self, file: Path):
        self.file = file
        self.nodes: dict[int, list[float]] = {}
        self.cells: dict[int, list[int]] = {}  # tetrahedra, of 4 or 10 nodes
        self.triangles: dict[int, list[int]] = {}
        self.node_sets: dict[str, list[int]] = {}
        self.element_sets: dict[str, list[int]] = {}
        self.surfaces: dict[str, list[tuple[str, str]]] = {}  # sets or elements, and their faces
        self.solids: dict[int, tuple[str, list[int]]] = {}  # kind and nodes of all, tetrahedra among them
        self._read()

    def _read(self) -> None:
        keyword, options, parts = "", dict[str, str](), 0
        for number, line in _joined(self.file):
            try:
                if line.startswith("*"):
                    keyword, options = _heading(line)
                    parts += keyword == "PART"
                    if parts > 1 or keyword == "INCLUDE":
                        raise ValueError("several parts" if parts > 1 else "*Include: put all into one file")
                else:
                    self._take(keyword, options, [word.strip() for word in line.rstrip(",").split(",")])
            except (ValueError, IndexError, KeyError) as error:
                raise MeshError(
                    f"mesh file {self.file}, line {number}: cannot be read as Abaqus' input, of one part that stays "
                    f"where it is: {error}"
                ) from error

    def _take(self, keyword: str, options: dict[str, str], words: list[str]) -> None:
        if keyword == "NODE":
            node = int(words[0])
            self.nodes[node] = [*map(float, words[1:4])]
            if len(self.nodes[node]) != 3:
                raise ValueError(f"node {node} has {len(words) - 1} coordinates")
            self._put(self.node_sets, options.get("NSET"), [node])
        elif keyword == "ELEMENT":
            kind, element = options["TYPE"].upper(), int(words[0])
            nodes = [*map(int, words[1:])]
            self._put(self.element_sets, options.get("ELSET"), [element])
            if re.fullmatch(SOLID, kind):
                self.solids[element] = kind, nodes
            for kinds, members in ((TETRAHEDRA, self.cells), (TRIANGLES, self.triangles)):
                for pattern, count in kinds.items():
                    if re.fullmatch(pattern, kind):
                        if len(nodes) != count:
                            raise ValueError(f"element {element} of type {kind} has {len(nodes)} nodes")
                        members[element] = nodes
        elif keyword in ("NSET", "ELSET"):
            sets = self.node_sets if keyword == "NSET" else self.element_sets
            self._put(sets, options[keyword], _members(words, sets, "GENERATE" in options))
        elif keyword == "SURFACE" and options.get("TYPE", "ELEMENT").upper() == "ELEMENT":
            self.surfaces.setdefault(options["NAME"], []).append((words[0], words[1].upper()))
        elif keyword == "INSTANCE" and any(float(word) for word in words):
            raise ValueError("an instance is moved")

    @staticmethod
    def _put(sets: dict[str, list[int]], name: str | None, members: list[int]) -> None:
        if name is not None:
            sets.setdefault(_known(name, sets), []).extend(members)

    def tetrahedra_of(self, name: str) -> list[int]:
        """Numbers of the tetrahedra of a set, or of the one with this number."""
        members = [int(name)] if name.isdecimal() else self.element_sets[_known(name, self.element_sets)]
        return [element for element in members if element in self.cells]


def solid_shape(kind: str) -> int | None:
    """Number of corners of a kind of solid, whose nodes they are the first of; None: of another shape."""
    found = re.match(r"C3D(\d+)", kind)
    return {4: 4, 10: 4, 6: 6, 15: 6, 8: 8, 20: 8}.get(int(found[1])) if found else None


def _joined(file: Path) -> Iterator[tuple[int, str]]:
    """Lines with their numbers, those that end with a comma with what follows; without comments."""
    begun, first = "", 0
    for number, line in enumerate(file.read_text(errors="replace").splitlines(), 1):
        text = line.strip()
        if not text or text.startswith("**"):
            continue
        if begun and text.startswith("*"):
            yield first, begun
            begun = ""
        first = first if begun else number
        begun += text
        if not text.endswith(","):
            yield first, begun
            begun = ""
    if begun:
        yield first, begun


def _heading(line: str) -> tuple[str, dict[str, str]]:
    """Keyword and options of a line such as `*Elset, elset=top, generate`."""
    keyword, *options = (word.strip() for word in line[1:].rstrip(",").split(","))
    pairs = (option.partition("=") for option in options)
    return keyword.upper(), {key.strip().upper(): value.strip().strip('"') for key, _, value in pairs}


def _known(name: str, sets: dict[str, list[int]]) -> str:
    """A name as it was written first: capitals are no matter to Abaqus."""
    return next((known for known in sets if known.upper() == name.upper()), name)


def _members(words: list[str], sets: dict[str, list[int]], generated: bool) -> list[int]:
    if generated:
        first, last, *step = map(int, words)
        return [*range(first, last + 1, *step)]
    members: list[int] = []
    for word in words:
        members += [int(word)] if word.isdecimal() else sets[_known(word, sets)]
    return members


def read_abaqus(file: Path):  # type: ignore[no-untyped-def]
    """Points, cells, surfaces, regions and second-order edges of an input file.

    Sets of tetrahedra are regions; surfaces of elements, sets of triangles, and sets of nodes that hold whole faces of
    the boundary are surfaces.

    Raises:
        MeshError: as `AbaqusFile`; it has solids that are no tetrahedra, or names what it does not hold.
    """
    content = AbaqusFile(file)
    refused = Counter(kind for element, (kind, _) in content.solids.items() if element not in content.cells)
    if refused:
        kinds = ", ".join(f"{count} {kind}" for kind, count in refused.items())
        raise MeshError(f"mesh file {file}: holds {kinds}; allowed are tetrahedra: C3D4, C3D10")
    row_of = {node: row for row, node in enumerate(content.nodes)}
    cell_of = {element: row for row, element in enumerate(content.cells)}

    def rows(elements: list[list[int]], corners: int) -> np.ndarray:
        found = [[row_of.get(node, -1) for node in nodes[:corners]] for nodes in elements]
        array = np.array(found, dtype=np.int64).reshape(-1, corners)
        if (array < 0).any():
            raise MeshError(f"mesh file {file}: names nodes that it does not hold")
        return array

    cells = rows([*content.cells.values()], 4)
    second = rows([nodes for nodes in content.cells.values() if len(nodes) == 10], 10)
    faces = cells[:, CELL_FACES].reshape(-1, 3)
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    boundary = faces[first[count == 1]]
    surfaces: dict[str, np.ndarray] = {}
    regions: dict[str, np.ndarray] = {}
    for name, nodes in content.node_sets.items():
        inside = np.isin(boundary, [row_of[node] for node in nodes if node in row_of]).all(axis=1)
        if inside.any():
            surfaces[name] = boundary[inside]
    for name, members in content.element_sets.items():
        solids = [cell_of[element] for element in members if element in cell_of]
        triangles = [content.triangles[element] for element in members if element in content.triangles]
        if solids:
            regions[name] = np.unique(solids)
        if triangles:
            surfaces[name] = rows(triangles, 3)
    for name, parts in content.surfaces.items():
        try:
            named = [(cell_of[e], FACES[face]) for of, face in parts for e in content.tetrahedra_of(of)]
        except KeyError as error:
            raise MeshError(f"mesh file {file}: surface {name!r} is of {error}, which is no set or face") from error
        if named:
            surfaces[name] = np.array([cells[row][list(face)] for row, face in named])
    points = np.array([*content.nodes.values()], dtype=float).reshape(-1, 3)
    return points, cells, surfaces, regions, edges_of(second[:, :4], second[:, 4:])
