"""A closed surface filled with tetrahedra, in the process of `foreign_process`: by Gmsh, or by fTetWild."""

import re
import time
from typing import Any

import numpy as np

from fenics_rom.scene.foreign_process import BASE_MEMORY, lower_limit

CELL = 6 * 2**0.5  # a cube in regular tetrahedra of its edges' length
DEFAULT_CELLS, MOST_CELLS = 5000, 2e7  # about as many where no size is given; Gmsh takes an hour for as many
OFF = 1e-3  # of the body's diagonal, that fTetWild's surface may be off
STUCK, MIN_MESHING_RATE = 10.0, 2e3  # s, and cells a second, that Gmsh may take to fill a surface
MEMORY_PER_CELL = 10_000  # bytes that it may take then
FLAT = 0.01  # of the volume of a regular cell of its longest edge
THROUGH = re.compile("(?i)intersect|overlapping facets|No elements in volume")  # what Gmsh says of such surfaces
FEATURE_ANGLE = np.radians(40.0)  # between triangles of a surface; beyond it an edge stays an edge


def fill_surface(gmsh: Any, file: str, size: float | None, what: str) -> dict[str, Any]:
    """Points (3 N,) and cells (4 C,) of tetrahedra that fill a closed surface, or what a STEP file holds.

    Solids are divided where they meet where `what` is "glue".

    Returns:
        points, cells, size: of the cells, and flat: how many are nearly so.
    """
    gmsh.option.setString("Geometry.OCCTargetUnit", "M")
    mesh, is_stl = gmsh.model.mesh, file.lower().endswith(".stl")
    if is_stl:
        _, size, count = _closed_surface(gmsh, file, size)
        lower_limit("RLIMIT_CPU", time.process_time() + STUCK + count / MIN_MESHING_RATE)  # through itself, it may hang
        lower_limit("RLIMIT_AS", BASE_MEMORY + MEMORY_PER_CELL * count)
        mesh.classifySurfaces(FEATURE_ANGLE, True, True, np.pi)
        mesh.createGeometry()
        loop = gmsh.model.geo.addSurfaceLoop([tag for _, tag in gmsh.model.getEntities(2)])
        gmsh.model.geo.addVolume([loop])
        gmsh.model.geo.synchronize()
    else:
        gmsh.model.occ.importShapes(file)
        solids = gmsh.model.occ.getEntities(3)
        if what == "glue" and len(solids) > 1:
            gmsh.model.occ.fragment(solids[:1], solids[1:])
        gmsh.model.occ.synchronize()
        if not gmsh.model.getEntities(3):
            raise ValueError("it holds no solid, only surfaces")
        volume = sum(gmsh.model.occ.getMass(3, tag) for _, tag in gmsh.model.getEntities(3))
        size, _ = _checked_size(gmsh, size, volume)
    for option in ("Mesh.MeshSizeMin", "Mesh.MeshSizeMax"):
        gmsh.option.setNumber(option, size)
    try:
        mesh.generate(3)
    except Exception as error:  # Gmsh's own
        if not THROUGH.search(str(error)):
            raise
        raise ValueError("its surface intersects itself") from error
    tags, points, _ = mesh.getNodes()
    order = np.argsort(tags)
    points, cells = points.reshape(-1, 3)[order], np.searchsorted(tags[order], mesh.getElementsByType(4)[1])
    flat = np.array(_flat(points[cells.reshape(-1, 4)]))
    return {"points": points.ravel(), "cells": cells, "size": np.array(size), "flat": flat}


def follow_surface(gmsh: Any, file: str, size: float | None) -> dict[str, Any]:
    """The same by fTetWild of any closed surface, to within a distance; it may intersect itself."""
    corners, size, _ = _closed_surface(gmsh, file, size)
    from pytetwild import tetrahedralize

    vertices, triangles = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    points, cells = tetrahedralize(
        vertices, triangles.reshape(-1, 3).astype(np.int32), edge_length_abs=size, epsilon=OFF, num_threads=1
    )
    within = np.array(OFF * np.linalg.norm(np.ptp(vertices, axis=0)))
    return {"points": points.ravel(), "cells": cells.ravel(), "size": np.array(size), "within": within}


def _checked_size(gmsh: Any, size: float | None, volume: float) -> tuple[float, float]:
    """Size of the cells, and how many there will be."""
    size = (CELL * volume / DEFAULT_CELLS) ** (1 / 3) if size is None else size
    if (count := CELL * volume / size**3) > MOST_CELLS:
        low, high = np.reshape(gmsh.model.getBoundingBox(-1, -1), (2, 3))
        lengths = " x ".join(f"{length:.4g}" for length in high - low)
        raise ValueError(
            f"cells of {size:.3g} would be some {count:.0e} in a body of {lengths}; allowed are {MOST_CELLS:.0e}: "
            "give a larger size, or the scale 1e-3 where the file is in mm"
        )
    return size, count


def _flat(corners: np.ndarray) -> int:
    """How many cells (C, 4, 3) have next to no volume beside their edges."""
    edges = np.linalg.norm(corners[:, [0, 0, 0, 1, 1, 2]] - corners[:, [1, 2, 3, 2, 3, 3]], axis=2)
    volumes = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6
    return int((CELL * volumes < FLAT * edges.max(axis=1) ** 3).sum())


def _closed_surface(gmsh: Any, file: str, size: float | None) -> tuple[np.ndarray, float, float]:
    """Triangles (T, 3, 3) of an STL file, and of the cells that are to fill it the size and how many there will be.

    One with edges that are not between two triangles is refused.
    """
    gmsh.merge(file)
    nodes, points, _ = gmsh.model.mesh.getNodes()
    triangles = gmsh.model.mesh.getElementsByType(2)[1].reshape(-1, 3)
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
    order = np.argsort(nodes)
    corners: np.ndarray = points.reshape(-1, 3)[order][np.searchsorted(nodes, triangles, sorter=order)]
    a, b, c = corners.transpose(1, 0, 2)
    return corners, *_checked_size(gmsh, size, abs(float((a * np.cross(b, c)).sum())) / 6)
