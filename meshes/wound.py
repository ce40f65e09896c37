"""Makes wound.msh: a tube with a closed end, of curved hexahedra of 20 nodes.

    python meshes/wound.py

Eight bricks around, one through the wall. The lid is one layer, of a square of four bricks in a ring of eight.
"""

import sys
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "demos" / "hard_cases"))

from boxes import hexahedra, msh

INNER, OUTER, LENGTH, ROWS = 6e-3, 8e-3, 0.06, 5  # m
AROUND = 8
CORE = 0.4  # half width of the square in the lid, of the inner radius

Array = np.ndarray


def main() -> None:
    """Writes the mesh."""
    points, cells, faces = tube(ROWS)
    Path(__file__).with_suffix(".msh").write_text(msh(points, {2: faces, 3: {"silicone": cells}}))


def tube(rows: int) -> tuple[Array, Array, dict[str, Array]]:
    """Points (N, 3), m, cells (C, 20), and faces by name: the strip is a quarter of the outside, around the axis x."""
    lid, half = LENGTH - LENGTH / rows, CORE * INNER

    def wall(p: Array) -> Array:
        radius, angle = INNER + (OUTER - INNER) * p[:, 0], 2 * np.pi * p[:, 1]
        return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), LENGTH * p[:, 2]])

    def in_lid(xy: Array, p: Array) -> Array:
        return np.column_stack([xy, lid + (LENGTH - lid) * p[:, 2]])

    def ring(quarter: int, p: Array) -> Array:
        middle = quarter * np.pi / 2
        turned = np.array([[np.cos(middle), np.sin(middle)], [-np.sin(middle), np.cos(middle)]])
        on_square = half * np.column_stack([np.ones(len(p)), 2 * p[:, 1] - 1]) @ turned
        angle = middle + np.pi / 2 * (p[:, 1] - 0.5)
        on_circle = INNER * np.column_stack([np.cos(angle), np.sin(angle)])
        return in_lid((1 - p[:, :1]) * on_square + p[:, :1] * on_circle, p)

    parts = [((1, AROUND, rows), wall), ((2, 2, 1), lambda p: in_lid(half * (2 * p[:, :2] - 1), p))]
    parts += [((1, 2, 1), lambda p, quarter=quarter: ring(quarter, p)) for quarter in range(4)]
    points, cells, faces, first = [], [], [], 0
    for bricks, place in parts:
        of_part, own, sides = hexahedra(bricks, 20)
        points.append(place(of_part))
        cells.append(first + own)
        faces.append({name: first + rows_of for name, rows_of in sides.items()})
        first += len(of_part)
    every = np.vstack(points)
    _, kept, number = np.unique(np.round(every / 1e-8).astype(np.int64), axis=0, return_index=True, return_inverse=True)
    number, outside = number.ravel(), faces[0]["right"]
    towards_x = every[outside[:, :4]].mean(axis=1) @ [1.0, 0.0, 0.0] > OUTER / 2
    named = {"root": faces[0]["bottom"], "outside": outside, "strip": outside[towards_x]}
    named["top"] = np.vstack([of["top"] for of in faces])
    return every[kept], number[np.vstack(cells)], {name: number[rows_of] for name, rows_of in named.items()}


if __name__ == "__main__":
    main()
