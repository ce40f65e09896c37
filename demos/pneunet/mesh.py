"""The mesh of half a PneuNet: bricks between planes, each of six tetrahedra, of two materials.

    python demos/pneunet/mesh.py    # writes demos/pneunet/pneunet.msh

x goes along the finger, z from the layer that hardly stretches to the tops of the chambers; y = 0 is the plane of
symmetry. Every length is in mm, as in the file.
"""

import itertools
import sys
from pathlib import Path

import gmsh
import numpy as np
from numpy import ndarray as Array

HERE = Path(__file__).parent
CHAMBERS, FACING, INSIDE, GAP = 5, 1.0, 15.0, 0.5  # number; along x walls that face one another, chambers, gaps
PITCH, WALL = 2 * FACING + INSIDE + GAP, 4.0  # of all other walls
ROOT, HALF_WIDTH, LAYER, CHANNEL, ROOF, MIDDLE, HEIGHT = 10.0, 8.0, 2.5, 4.5, 7.5, 14.0, 25.0  # heights from z = 0
TETRAHEDRON, TRIANGLE = 4, 2  # of Gmsh
SIDES = ((0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3))  # of a tetrahedron, from outside


def planes(chambers: int) -> tuple[Array, Array, Array]:
    """Between which the bricks are."""
    ends = np.cumsum([0.0, FACING, INSIDE, FACING])
    x = np.array([0.0, *(ROOT + k * PITCH + end for k in range(chambers) for end in ends)])
    x[-1] += WALL - FACING  # the tip
    y, z = [0.0, HALF_WIDTH - WALL, HALF_WIDTH], [0.0, LAYER, CHANNEL, ROOF, MIDDLE, HEIGHT - WALL, HEIGHT]
    return x, np.array(y), np.array(z)


def kind(place: Array, length: float) -> str:
    """What is there: "solid", "chamber" (or the channel that joins them), "gap" between chambers, or "outside"."""
    x, y, z = place
    if not (0 < x < length and abs(y) < HALF_WIDTH and 0 < z < HEIGHT):
        return "outside"
    along = (x - ROOT) % PITCH  # from where the chamber begins
    if x > ROOT and y < HALF_WIDTH - WALL and z > LAYER:
        is_channel = z < CHANNEL and ROOT + FACING < x < length - WALL
        if is_channel or (z < HEIGHT - WALL and FACING < along < FACING + INSIDE):
            return "chamber"
    is_gap = ROOT < x < length - WALL and z > ROOF and along > PITCH - GAP
    return "gap" if is_gap else "solid"


def tetrahedra(chambers: int) -> tuple[Array, Array]:
    """Nodes (n, 3), and corners (c, 4) of the cells; bricks that share a side are mirrored at it (Kuhn, 1960)."""
    grid = planes(chambers)
    sizes, found = [len(along) for along in grid], []
    for at in itertools.product(*(range(size - 1) for size in sizes)):
        middle = np.array([along[k : k + 2].mean() for along, k in zip(grid, at, strict=True)])
        if kind(middle, grid[0][-1]) != "solid":
            continue
        for axes in itertools.permutations(range(3)):
            steps = np.vstack([np.zeros(3, dtype=int), np.eye(3, dtype=int)[list(axes)].cumsum(axis=0)])
            corners = np.where(np.array(at) % 2, 1 - steps, steps) + at
            turned = np.linalg.det(np.diff(corners, axis=0)) < 0
            found.append(np.ravel_multi_index(corners[[0, 2, 1, 3] if turned else [0, 1, 2, 3]].T, sizes))
    used, cells = np.unique(found, return_inverse=True)
    every = np.stack(np.meshgrid(*grid, indexing="ij"), axis=-1).reshape(-1, 3)
    return every[used], cells.reshape(-1, 4)


def surfaces(nodes: Array, cells: Array) -> dict[str, Array]:
    """Corners (t, 3) of the triangles of the surfaces that are named."""
    sides = cells[:, SIDES].reshape(-1, 3)
    _, first, count = np.unique(np.sort(sides, axis=1), axis=0, return_index=True, return_counts=True)
    outside = sides[first[count == 1]]
    corners = nodes[outside]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    before = np.array([kind(place, nodes[:, 0].max()) for place in corners.mean(axis=1) + 0.1 * normals])
    thin = (corners[:, :, 1] < HALF_WIDTH - WALL + 0.1) & (corners[:, :, 2] < HEIGHT - WALL + 0.1)
    return {
        "middle": outside[np.isclose(corners[:, :, 1], 0.0).all(axis=1)],
        "chamber": outside[before == "chamber"],
        "walls": outside[(before == "gap") & (np.abs(normals[:, 0]) > 0.5) & thin.all(axis=1)],
    }


def write(file: Path, chambers: int = CHAMBERS) -> None:
    """Writes the mesh in Gmsh's format."""
    nodes, cells = tetrahedra(chambers)
    of_layer = nodes[cells].mean(axis=1)[:, 2] < LAYER
    volumes = {"silicone": cells[~of_layer], "layer": cells[of_layer]}
    gmsh.initialize([], readConfigFiles=False)
    gmsh.option.setNumber("General.Terminal", 0)
    try:
        tag = 0
        for dimension, cell, groups in ((3, TETRAHEDRON, volumes), (2, TRIANGLE, surfaces(nodes, cells))):
            for name, corners in groups.items():
                tag += 1
                gmsh.model.addDiscreteEntity(dimension, tag)
                if tag == 1:
                    gmsh.model.mesh.addNodes(dimension, tag, np.arange(1, len(nodes) + 1), nodes.ravel())
                gmsh.model.mesh.addElementsByType(tag, cell, [], corners.ravel() + 1)
                gmsh.model.setPhysicalName(dimension, gmsh.model.addPhysicalGroup(dimension, [tag]), name)
        gmsh.option.setNumber("Mesh.MshFileVersion", 4.1)
        gmsh.option.setNumber("Mesh.Binary", 1)
        gmsh.write(str(file))
    finally:
        gmsh.finalize()


if __name__ == "__main__":
    write(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "pneunet.msh")
