"""A process of its own that lets Gmsh read a .msh file, and writes what it finds to standard output.

Gmsh crashes on some damaged files; here it takes nobody with it. It is started by `gmsh_file`, as a script, so that it
needs NumPy and Gmsh only.
"""

import io
import os
import resource
import sys
from pathlib import Path
from typing import Any

import numpy as np

BASE_MEMORY = 2**30  # bytes of address space that Gmsh may take for any file, of which it takes a fifth by itself
MEMORY_PER_BYTE = 50  # and for each byte of the file, of which it takes five to ten
TRIANGLE, TETRAHEDRON = 2, 4  # Gmsh's numbers of the straight ones


def main() -> None:
    """Reads the file that the command line names; ends with a message where Gmsh does."""
    lower_limit(resource.RLIMIT_CORE, 0)  # a crash leaves nothing behind
    size = Path(sys.argv[1]).stat().st_size
    lower_limit(resource.RLIMIT_AS, BASE_MEMORY + MEMORY_PER_BYTE * size)  # sizes in a file may lie
    with os.fdopen(os.dup(1), "wb") as output:
        os.dup2(2, 1)  # what libraries print is no part of the arrays
        try:
            arrays = read_arrays(sys.argv[1])
        except Exception as error:  # Gmsh's own, and what Python says of names that are no text
            sys.exit(" ".join(str(error).split()))
        content = io.BytesIO()
        np.savez(content, **arrays)
        output.write(content.getbuffer())


def lower_limit(what: int, limit: int) -> None:
    """Lowers a limit of this process."""
    soft, hard = (limit if old == resource.RLIM_INFINITY else min(limit, old) for old in resource.getrlimit(what))
    resource.setrlimit(what, (soft, hard))


def read_arrays(file: str) -> dict[str, Any]:
    """What Gmsh finds in a file.

    Returns:
        nodes: (N,) tags, in any order.
        points: (3 N,) of the nodes, m.
        kinds: names of the kinds of cells.
        numbers: (C,) of the straight tetrahedra.
        cells: (4 C,) node tags of them.
        dimensions, tags, names: of the physical groups of triangles (2) or tetrahedra (3); empty names where there are
            none. Group k has `group{k}`: node tags of its triangles, one after the other, or numbers of its cells.
    """
    import gmsh

    gmsh.initialize([], readConfigFiles=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.merge(file)
    mesh = gmsh.model.mesh
    tags, coordinates, _ = mesh.getNodes()
    numbers, nodes = mesh.getElementsByType(TETRAHEDRON)
    groups = [(dimension, tag) for dimension, tag in gmsh.model.getPhysicalGroups() if dimension in (2, 3)]
    members = {}
    for k, (dimension, tag) in enumerate(groups):
        entities = gmsh.model.getEntitiesForPhysicalGroup(dimension, tag)
        elements = [mesh.getElementsByType(TRIANGLE if dimension == 2 else TETRAHEDRON, e) for e in entities]
        members[f"group{k}"] = np.concatenate([np.empty(0, np.uint64), *(e[3 - dimension] for e in elements)])
    return members | {
        "nodes": tags,
        "points": coordinates,
        "kinds": np.array([mesh.getElementProperties(kind)[0] for kind in mesh.getElementTypes(3)], dtype=str),
        "numbers": numbers,
        "cells": nodes,
        "dimensions": np.array([dimension for dimension, _ in groups], dtype=int),
        "tags": np.array([tag for _, tag in groups], dtype=int),
        "names": np.array([gmsh.model.getPhysicalName(*group) for group in groups], dtype=str),
    }


if __name__ == "__main__":
    main()
