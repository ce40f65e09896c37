"""Makes drop.msh: a soft ring of 8 cm, 4 mm thick and 16 mm wide, that touches z = 0 at its lowest point.

    python meshes/drop.py

A quarter of it, in front of y = 0 and right of x = 0, is bricks of six tetrahedra each; the rest are its mirror images,
so that a ring that falls straight bounces straight.
"""

from itertools import permutations
from pathlib import Path

import gmsh
import numpy as np

RADIUS, THICKNESS, WIDTH = 0.040, 0.004, 0.016  # m
AROUND, ACROSS = 40, 4  # bricks; both even

Array = np.ndarray


def quarter() -> Array:
    """Tetrahedra (T, 4, 3) as steps around, across and inwards, each brick cut along its diagonal (Kuhn)."""
    corners = np.array([np.cumsum([np.zeros(3), *np.eye(3)[list(order)]], axis=0) for order in permutations(range(3))])
    first = np.stack(np.meshgrid(range(AROUND // 2), range(ACROSS // 2), [0], indexing="ij"), axis=-1).reshape(-1, 3)
    return (first[:, None, None] + corners).reshape(-1, 4, 3).astype(int)


def ring() -> tuple[Array, Array]:
    """Nodes (N, 3), m, and tetrahedra (T, 4)."""
    part = quarter()
    both = np.concatenate([part, part * [1, -1, 1]])
    whole = np.concatenate([both, both * [-1, 1, 1]]) % [AROUND, AROUND, AROUND]
    grid, cells = np.unique(whole.reshape(-1, 3), axis=0, return_inverse=True)
    i, j, k = grid.T
    j = np.where(j > ACROSS, j - AROUND, j)  # steps to the left are negative
    angle, r = 2 * np.pi * i / AROUND, RADIUS - THICKNESS * k
    nodes = np.stack([r * np.sin(angle), j * WIDTH / ACROSS, RADIUS - r * np.cos(angle)], axis=1)
    cells = cells.reshape(-1, 4)
    inverted = np.linalg.det(nodes[cells[:, 1:]] - nodes[cells[:, :1]]) < 0
    cells[inverted] = cells[inverted][:, [1, 0, 2, 3]]
    return nodes, cells


def write(path: Path) -> None:
    """Writes the mesh."""
    nodes, cells = ring()
    gmsh.initialize([], readConfigFiles=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("Mesh.MshFileVersion", 4.1)
        volume = gmsh.model.addDiscreteEntity(3)
        gmsh.model.mesh.addNodes(3, volume, np.arange(1, len(nodes) + 1), nodes.round(12).ravel())
        gmsh.model.mesh.addElementsByType(volume, 4, np.arange(1, len(cells) + 1), (cells + 1).ravel())
        gmsh.model.setPhysicalName(3, gmsh.model.addPhysicalGroup(3, [volume]), "body")
        gmsh.write(str(path))
    finally:
        gmsh.finalize()


if __name__ == "__main__":
    write(Path(__file__).with_suffix(".msh"))
