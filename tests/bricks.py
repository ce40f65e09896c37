"""Boxes of hexahedra, with inner points shaken: cells are no boxes, and their edges bend where nodes are between."""

import sys
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "demos" / "hard_cases"))
from boxes import KINDS as KINDS
from boxes import hexahedra, msh


def shaken_bricks(lengths, bricks, nodes, shake=0.1):
    """Points, cells of so many nodes and faces of the six sides, in Gmsh's order; inner points moved by that share."""
    points, cells, faces = hexahedra(bricks, nodes)
    inner = ((points > 0) & (points < 1)).all(axis=1)
    moved = np.random.default_rng(0).uniform(-shake, shake, points.shape) / np.array(bricks)
    return (points + inner[:, None] * moved) * np.array(lengths), cells, faces


def write_bricks(path, points, cells, faces):
    """A `.msh` file of them."""
    path.write_text(msh(points, {2: faces, 3: {"body": cells}}))
    return path
