"""Gmsh's MSH format 2.2 of a mesh with its groups."""

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from fenics_rom.errors import MeshError
from fenics_rom.fem.mesh import Mesh
from fenics_rom.io.atomic_write import write_whole

TRIANGLE, TETRAHEDRON = 2, 4  # Gmsh's numbers of them


def write_msh(path: Path, mesh: Mesh) -> None:
    """Writes a mesh; groups whose name is a number are written as that number without a name.

    Elements are written once for each group that they are in, as the format asks.

    Raises:
        MeshError: a name has quotation marks.
        FileError: the file cannot be written.
    """
    names, elements = list[str](), list[str]()
    rest = np.setdiff1d(np.arange(len(mesh.cells)), np.concatenate([[], *mesh.regions.values()]))
    regions = {name: mesh.cells[rows] for name, rows in mesh.regions.items()} | {"0": mesh.cells[rest]}
    for dimension, kind, groups in ((2, TRIANGLE, mesh.surfaces), (3, TETRAHEDRON, regions)):
        for entity, (tag, name, corners) in enumerate(_numbered(groups), 1):
            if '"' in name:
                raise MeshError(f"{path}: group {name!r}: quotation marks are not allowed in its name")
            if name:
                names.append(f'{dimension} {tag} "{name}"')
            head = f"{kind} 2 {tag} {entity}"
            elements += [f"{head} {' '.join(map(str, nodes))}" for nodes in (corners + 1).tolist()]
    nodes = [f"{k} {x!r} {y!r} {z!r}" for k, (x, y, z) in enumerate(mesh.points.tolist(), 1)]
    sections = {
        "PhysicalNames": names,
        "Nodes": nodes,
        "Elements": [f"{k} {element}" for k, element in enumerate(elements, 1)],
    }
    text = "".join(
        "\n".join([f"${section}", str(len(lines)), *lines, f"$End{section}", ""]) for section, lines in sections.items()
    )
    write_whole(path, f"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n{text}".encode())


def _numbered(groups: Mapping[str, np.ndarray]) -> Iterator[tuple[int, str, np.ndarray]]:
    """Number, name and elements of each group."""
    following = max([0, *(int(name) for name in groups if name.isdecimal())])
    for name, corners in groups.items():
        if name.isdecimal():
            yield int(name), "", corners
        else:
            following += 1
            yield following, name, corners
