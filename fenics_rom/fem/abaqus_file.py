"""Abaqus' input files: nodes, tetrahedra, and sets as groups.

What holds for elements of order two, `edges`, is as in `foreign_process.read_arrays`.

Not by meshio, whose reader (5.3.5, its last release, of January 2024) passes over *Surface and sets that *Node names
(its issue 1527), puts parts and moved instances on one another, and does not say in which line a mistake is.
"""

import re
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fenics_rom.errors import MeshError, shown, unknown
from fenics_rom.fem.file_cells import edges_of
from fenics_rom.fem.mesh_arrays import MeshArrays
from fenics_rom.fem.mesh_quality import CELL_FACES

TETRAHEDRA = r"C3D(4|10)[A-Z]*"  # and the number of their nodes
SOLIDS = r"(?:C3D|CC3D|DC3D|AC3D|SC)(\d+)[A-Z]*"
TRIANGLES = {r"(CPS|CPE|CAX|M3D|SFM3D|R3D|DS|S)3[A-Z]*|STRI3": 3, r"(CPS|CPE|CAX|M3D|SFM3D|DS)6[A-Z]*|STRI65": 6}
FACES = {"S1": (0, 1, 2), "S2": (0, 3, 1), "S3": (1, 3, 2), "S4": (2, 3, 0)}  # of tetrahedra
ONE_FILE, GLOBALLY = "put all into one file", "write coordinates in the global system"
UNREAD = {
    "INCLUDE": ONE_FILE,
    "SYSTEM": GLOBALLY,
    "ELGEN": "write the elements out",
    "ELCOPY": "write the elements out",
}
UNREAD |= dict.fromkeys(("NGEN", "NFILL", "NCOPY", "NMAP"), "write the nodes out")
CLOSED = "PART", "INSTANCE", "ASSEMBLY", "STEP"  # which *End PART, and so on, follows
MOST_GENERATED = 10_000_000  # numbers that a line of a set may stand for


class AbaqusFile:
    """What an input file holds, by the numbers that it has there.

    An element goes on in the next line until it has the nodes of its kind, whether or not its last line ends with a
    comma. Coordinates that are left out are 0. Of what is defined twice the last counts.

    Args:
        file: path of an `.inp` file of one part, as Abaqus/CAE, CalculiX or other programs write it.

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
        self._left_out: Counter[str] = Counter()  # elements that are not of a body, by their kind
        self._redefined: dict[str, list[int]] = {"node": [], "element": []}  # otherwise than before
        self._elements: set[int] = set()  # numbers of all
        self._kind = ""  # of the elements of this block
        self._count: int | None = None  # of their nodes; None: of what is not of a body, an element a line
        self._begun: list[str] = []  # words of an element that lacks nodes
        self._instance: str | None = None  # of the part
        self._open_parts: list[str] = []  # of those that are CLOSED
        self._named: dict[str, list[tuple[int, str]]] = {"node": [], "element": []}  # numbers, and sets that name them
        self._shorter = ""  # the last line, where it lacks a line end and values that the one before has
        self._is_in_assembly = False  # and not in an instance: numbers are not the part's
        self._read()

    @property
    def notes(self) -> tuple[str, ...]:
        """What to say of a file that can be read."""
        said = [
            f"{len(numbers)} {what}s are defined twice, not alike, e.g. {what} {numbers[0]}: the last definition counts"
            for what, numbers in self._redefined.items()
            if numbers
        ]
        if self._left_out:
            kinds = ", ".join(f"{count} {kind}" for kind, count in self._left_out.items())
            said.append(f"elements that are neither solids nor triangles were left out: {kinds}")
        signs = [f"*{part.capitalize()} has no *End {part.capitalize()}" for part in self._open_parts]
        for what, known in (("node", self.nodes), ("element", self._elements)):
            lacking = {number: name for number, name in self._named[what] if number not in known}
            if lacking:
                number, name = next(iter(lacking.items()))
                signs.append(f"sets name {len(lacking)} {what}s that are not there, e.g. {what} {number} in {name!r}")
        if self._shorter:
            signs.append(f"its last line, {shown(self._shorter)}, has no end and fewer values than the one before")
        if signs:
            there = f"{len(self.nodes)} nodes and {len(self.cells)} tetrahedra"
            said.append(f"the file seems to be cut, as {'; '.join(signs)}: the body is of the {there} that it holds")
        return tuple(said)

    def _read(self) -> None:
        keyword, options, parts, first, line, before, last = "", dict[str, str](), 0, 0, "", "", ""
        for number, line in _lines(self.file):
            first = first if self._begun else number
            try:
                if line.startswith("*"):
                    self._refuse_unfinished()
                    keyword, options = _heading(line)
                    parts += keyword == "PART"
                    if parts > 1:
                        raise ValueError("several parts")
                    self._open(keyword, options)
                else:
                    self._take(keyword, options, _words(line), line.endswith(","))
                before, last = last, "" if line.startswith("*") else line
            except (ValueError, IndexError) as error:
                self._refuse(first, error)
        if keyword == "NODE" and line.count(",") < before.count(",") and not _has_line_end(self.file):
            self._shorter = line
        try:
            self._refuse_unfinished()
        except ValueError as error:
            self._refuse(first, error)

    def _refuse(self, line: int, error: Exception) -> None:
        reason = "values are missing" if isinstance(error, IndexError) else error
        raise MeshError(
            f"mesh file {self.file}, line {line}: cannot be read as Abaqus' input, of one part that stays where it is: "
            f"{reason}"
        ) from error

    def _refuse_unfinished(self) -> None:
        if self._begun:
            raise ValueError(f"element {self._begun[0]} has {len(self._begun) - 1} nodes, and none follow")

    def _open(self, keyword: str, options: Mapping[str, str]) -> None:
        """What a heading says without its lines."""
        said = f"*{keyword.capitalize()}"
        if keyword in UNREAD:
            raise ValueError(f"{said} is not read; {UNREAD[keyword]}")
        if keyword in ("NODE", "ELEMENT", "NSET", "ELSET", "SURFACE") and "INPUT" in options:
            raise ValueError(f"{said}, input={options['INPUT']} is not read; {ONE_FILE}")
        if keyword == "NODE" and options.get("SYSTEM", "R").upper() != "R":
            raise ValueError(f"{said}, system={options['SYSTEM']} is not read; {GLOBALLY}")
        for of, needed in (("ELEMENT", "TYPE"), ("NSET", "NSET"), ("ELSET", "ELSET"), ("SURFACE", "NAME")):
            if keyword == of and not options.get(needed):
                raise ValueError(f"{said} has no {needed.lower()}=")
        if keyword == "ELEMENT":
            self._kind = options["TYPE"].upper()
            self._count = _node_count(self._kind)
        if keyword in CLOSED:
            self._open_parts.append(keyword)
        if keyword.startswith("END ") and keyword[4:] in self._open_parts:
            self._open_parts.remove(keyword[4:])
        if keyword == "INSTANCE":
            if self._instance is not None:
                raise ValueError("several instances")
            self._instance = options.get("NAME", "")
        if keyword in ("ASSEMBLY", "INSTANCE", "END INSTANCE", "END ASSEMBLY"):
            self._is_in_assembly = keyword in ("ASSEMBLY", "END INSTANCE")
        if keyword == "NSET" and "ELSET" in options:
            elements = self.element_sets[_known(options["ELSET"], self.element_sets)]
            of_elements = [node for element in elements for node in self._nodes_of(element)]
            self._put(self.node_sets, options["NSET"], of_elements)

    def _nodes_of(self, element: int) -> list[int]:
        return self.solids[element][1] if element in self.solids else self.triangles.get(element, [])

    def _take(self, keyword: str, options: Mapping[str, str], words: list[str], goes_on: bool) -> None:
        """One line of data."""
        if keyword in ("NODE", "ELEMENT") and self._is_in_assembly:
            return  # reference points and what hangs on them, numbered by themselves
        if keyword == "NODE":
            node, place = _whole(words[0]), [*map(_real, words[1:4]), 0.0, 0.0, 0.0][:3]
            if self.nodes.get(node, place) != place:
                self._redefined["node"].append(node)
            self.nodes[node] = place
            self._put(self.node_sets, options.get("NSET"), [node])
        elif keyword == "ELEMENT":
            self._begun += words
            if not goes_on or self._count is None or len(self._begun) > self._count:
                words, self._begun = self._begun, []
                self._take_element(words, options.get("ELSET"))
        elif keyword in ("NSET", "ELSET"):
            sets = self.node_sets if keyword == "NSET" else self.element_sets
            is_of_part = not self._is_in_assembly or "INSTANCE" in options
            if is_of_part and "GENERATE" not in options:
                numbers = [int(word) for word in map(self._without_instance, words) if word.isdecimal()]
                self._named["node" if keyword == "NSET" else "element"] += [
                    (each, options[keyword]) for each in numbers
                ]
            self._put(sets, options[keyword], self._members(words, sets, "GENERATE" in options, is_of_part))
        elif keyword == "SURFACE" and options.get("TYPE", "ELEMENT").upper() == "ELEMENT":
            of, face = self._without_instance(words[0]), words[1].upper()
            self.surfaces.setdefault(options["NAME"], []).append((of, face))
            if of.isdecimal():
                self._named["element"].append((int(of), options["NAME"]))
        elif keyword == "SURFACE" and options["TYPE"].upper() == "NODE":
            members = self._members(words[:1], self.node_sets, False, not self._is_in_assembly)
            self._put(self.node_sets, options["NAME"], members)
        elif keyword == "INSTANCE" and any(map(_real, words)):
            raise ValueError("an instance is moved")

    def _take_element(self, words: list[str], name: str | None) -> None:
        if words[0].isdecimal():
            self._elements.add(int(words[0]))
        if self._count is None:
            self._left_out[self._kind] += 1
            return
        if len(words) - 1 != self._count:
            raise ValueError(
                f"element {words[0]} of type {self._kind} has {len(words) - 1} nodes; it must have {self._count}"
            )
        element, *nodes = map(_whole, words)
        is_triangle = not re.fullmatch(SOLIDS, self._kind)
        tables: list[dict[int, Any]] = [self.cells, self.triangles, self.solids]
        before = [table.pop(element, None) for table in tables]
        if is_triangle:
            self.triangles[element] = nodes
        else:
            self.solids[element] = self._kind, nodes
            if re.fullmatch(TETRAHEDRA, self._kind):
                self.cells[element] = nodes
        if any(before) and before != [table.get(element) for table in tables]:
            self._redefined["element"].append(element)
        self._put(self.element_sets, name, [element])

    def _members(self, words: list[str], sets: Mapping[str, list[int]], generated: bool, is_of_part: bool) -> list[int]:
        """Numbers that a line of a set names, by themselves, by other sets, or as a range."""
        if generated:
            bounds = [*map(_whole, words), 1]
            if len(bounds) not in (3, 4) or bounds[2] == 0:
                raise ValueError("generate takes a first, last and perhaps a step > 0")
            numbers = range(bounds[0], bounds[1] + 1, bounds[2])
            if len(numbers) > MOST_GENERATED:
                raise ValueError(f"{len(numbers)} numbers are generated; use at most {MOST_GENERATED}")
            return [*numbers] if is_of_part else []
        members: list[int] = []
        for word in words:
            name = self._without_instance(word)
            if name.isdecimal():
                members += [int(name)] if is_of_part or name != word else []
            else:
                members += sets[_known(name, sets)]
        return members

    def _without_instance(self, name: str) -> str:
        """An assembly says `Part-1-1.top` of what the part calls `top`."""
        instance, _, rest = name.rpartition(".")
        return rest if instance and instance.upper() == (self._instance or "").upper() else name

    @staticmethod
    def _put(sets: dict[str, list[int]], name: str | None, members: list[int]) -> None:
        if name is not None:
            sets.setdefault(_first_written(name, sets), []).extend(members)

    def tetrahedra_of(self, name: str) -> list[int]:
        """Numbers of the tetrahedra of a set, or of the one with this number; ValueError where there is none."""
        members = [int(name)] if name.isdecimal() else self.element_sets[_known(name, self.element_sets)]
        return [element for element in members if element in self.cells]


def _node_count(kind: str) -> int | None:
    """Nodes of a solid or triangle; None of what is not of a body."""
    solid = re.fullmatch(SOLIDS, kind)
    return int(solid[1]) if solid else next((n for kinds, n in TRIANGLES.items() if re.fullmatch(kinds, kind)), None)


def solid_shape(kind: str) -> int | None:
    """Number of corners of a kind of solid, whose nodes they are the first of; None: of another shape."""
    found = re.match(r"C3D(\d+)", kind)
    return {4: 4, 10: 4, 6: 6, 15: 6, 8: 8, 20: 8}.get(int(found[1])) if found else None


def _lines(file: Path) -> Iterator[tuple[int, str]]:
    """Lines with their numbers, without comments; headings that end with a comma with the options that follow."""
    heading, first = "", 0
    for number, line in enumerate(file.read_text(errors="replace").splitlines(), 1):
        text = line.strip()
        if not text or text.startswith("**"):
            continue
        if heading and text[0].isalpha():  # options, as data begins with a number or follows no comma
            heading += text
        else:
            if heading:
                yield first, heading
            heading, first = (text, number) if text.startswith("*") else ("", 0)
            if not heading:
                yield number, text
        if heading and not heading.endswith(","):
            yield first, heading
            heading = ""
    if heading:
        yield first, heading


def _has_line_end(file: Path) -> bool:
    return file.read_bytes()[-1:] in (b"\n", b"\r", b"")


def _heading(line: str) -> tuple[str, dict[str, str]]:
    """Keyword and options of a line such as `*Elset, elset=top, generate`."""
    keyword, *options = (word.strip() for word in line[1:].rstrip(",").split(","))
    pairs = (option.partition("=") for option in options)
    return " ".join(keyword.upper().split()), {key.strip().upper(): value.strip().strip('"') for key, _, value in pairs}


def _words(line: str) -> list[str]:
    """What stands between commas, less what is empty at the end."""
    words = [word.strip() for word in line.split(",")]
    while len(words) > 1 and not words[-1]:
        words.pop()
    return words


def _whole(word: str) -> int:
    if not word.isdecimal():
        raise ValueError(f"{shown(word)} is no whole number; numbers are apart by commas")
    return int(word)


def _real(word: str) -> float:
    """Of a word as Fortran writes it, too; nothing at all is 0."""
    try:
        return float(word.upper().replace("D", "E")) if word else 0.0
    except ValueError:
        raise ValueError(f"{shown(word)} is no number; numbers are apart by commas") from None


def _first_written(name: str, sets: Mapping[str, list[int]]) -> str:
    """A name as it was written first: capitals are no matter to Abaqus."""
    return next((known for known in sets if known.upper() == name.upper()), name)


def _known(name: str, sets: Mapping[str, list[int]]) -> str:
    """The same of a set that must be there; ValueError where it is not."""
    known = _first_written(name, sets)
    if known not in sets:
        raise ValueError(unknown("set", name, sets))
    return known


def read_abaqus(file: Path) -> MeshArrays:
    """What is in an input file.

    Sets of tetrahedra are regions; surfaces of elements, sets of triangles, and sets of nodes that hold whole faces of
    the boundary are surfaces.

    Raises:
        MeshError: as `AbaqusFile`; it has solids that are no tetrahedra, or names what it does not hold.
    """
    content = AbaqusFile(file)
    refused = Counter(kind for element, (kind, _) in content.solids.items() if element not in content.cells)
    if refused:
        kinds = ", ".join(f"{count} {kind}" for kind, count in refused.items())
        others = "hexahedra are read from .msh, .vtk, .vtu and .xdmf"
        raise MeshError(f"mesh file {file}: holds {kinds}; use tetrahedra: C3D4, C3D10; {others}")
    row_of = {node: row for row, node in enumerate(content.nodes)}
    cell_of = {element: row for row, element in enumerate(content.cells)}

    def rows(elements: Mapping[int, list[int]], corners: int) -> np.ndarray:
        found = [[row_of.get(node, -1) for node in nodes[:corners]] for nodes in elements.values()]
        array = np.array(found, dtype=np.int64).reshape(-1, corners)
        if (array < 0).any():
            lacking = (array < 0).any(axis=1)
            element, nodes = [*elements.items()][int(lacking.argmax())]
            raise MeshError(
                f"mesh file {file}: names nodes that it does not hold: {lacking.sum()} of {len(array)} elements do, "
                f"e.g. element {element} names node {next(node for node in nodes if node not in row_of)}"
            )
        return array

    cells = rows(content.cells, 4)
    second = rows({element: nodes for element, nodes in content.cells.items() if len(nodes) == 10}, 10)
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
        triangles = {element: content.triangles[element] for element in members if element in content.triangles}
        if solids:
            regions[name] = np.unique(solids)
        if triangles:
            surfaces[name] = rows(triangles, 3)
    for name, parts in content.surfaces.items():
        unknown_face = next((face for _, face in parts if face not in FACES), None)
        try:
            if unknown_face is not None:
                raise ValueError(f"face {shown(unknown_face)}; use one of {', '.join(FACES)}")
            named = [(cell_of[e], FACES[face]) for of, face in parts for e in content.tetrahedra_of(of)]
        except ValueError as error:
            raise MeshError(f"mesh file {file}: surface {name!r} is of {error}") from error
        if named:
            surfaces[name] = np.array([cells[row][list(face)] for row, face in named])
    points = np.array([*content.nodes.values()], dtype=float).reshape(-1, 3)
    return MeshArrays(points, cells, surfaces, regions, edges_of(second), content.notes)
