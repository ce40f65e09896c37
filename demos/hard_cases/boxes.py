"""Scenes of boxes of tetrahedra, of any number and proportions; boxes of hexahedra."""

import tempfile
from collections.abc import Callable, Mapping
from itertools import permutations
from pathlib import Path

import numpy as np

import fenics_rom as fr
from fenics_rom.scene.file import parse_scene

Array = np.ndarray
Inside = Callable[[Array], Array]  # of points (N, 3), which are in it

# Gmsh's numbers of elements, by their dimension and number of nodes.
KINDS = {(2, 3): 2, (2, 6): 9, (2, 4): 3, (2, 8): 16, (2, 9): 10, (3, 4): 4, (3, 10): 11, (3, 8): 5, (3, 20): 17}
KINDS |= {(3, 27): 12, (3, 6): 6, (3, 15): 18, (3, 18): 13, (3, 5): 7, (3, 13): 19, (3, 14): 14}
LEFT: dict[str, Inside] = {"left": lambda p: p[:, 0] <= p[:, 0].min()}


def brick_cells(bricks: tuple[int, int, int]) -> tuple[Array, Array]:
    """Points of a unit cube (N, 3) and its tetrahedra (C, 4), six in each brick."""
    count = np.array(bricks)
    grid = np.stack(np.meshgrid(*(np.arange(n + 1) for n in bricks), indexing="ij"), axis=-1).reshape(-1, 3)
    along = np.array([(count[1] + 1) * (count[2] + 1), count[2] + 1, 1])
    corner = np.flatnonzero((grid < count).all(axis=1))
    paths = [np.cumsum([0, *along[list(order)]]) for order in permutations(range(3))]
    return grid / count, np.concatenate([corner[:, None] + path for path in paths])


# Corners of Gmsh's hexahedron of 27 nodes in a cube of 2 x 2 x 2, then the middles of its edges and faces, and its own.
CORNERS = np.array([(0, 0, 0), (2, 0, 0), (2, 2, 0), (0, 2, 0), (0, 0, 2), (2, 0, 2), (2, 2, 2), (0, 2, 2)])
EDGES = [(0, 1), (0, 3), (0, 4), (1, 2), (1, 5), (2, 3), (2, 6), (3, 7), (4, 5), (4, 7), (5, 6), (6, 7)]
FACES = [(0, 3, 2, 1), (0, 1, 5, 4), (0, 4, 7, 3), (1, 2, 6, 5), (2, 3, 7, 6), (4, 5, 6, 7)]
SIDES = {"bottom": 0, "front": 1, "left": 2, "right": 3, "back": 4, "top": 5}  # which of the faces


def hexahedra(bricks: tuple[int, int, int], nodes: int = 8) -> tuple[Array, Array, dict[str, Array]]:
    """Points of a unit cube (N, 3), its hexahedra (C, nodes) of 8, 20 or 27 nodes, and the faces of its six sides."""
    count = np.array(bricks)
    middles = [CORNERS[list(corners)].mean(axis=0).astype(int) for corners in (*EDGES, *FACES, range(8))]
    local = np.concatenate([CORNERS, middles])[:nodes]
    size = 2 * count + 1
    along = np.array([size[1] * size[2], size[2], 1])
    first = 2 * np.stack(np.meshgrid(*map(np.arange, count), indexing="ij"), axis=-1).reshape(-1, 3)
    every = (first[:, None] + local) @ along
    used, cells = np.unique(every, return_inverse=True)
    cells, points = cells.reshape(every.shape), np.stack(np.unravel_index(used, size), axis=1) / (2 * count)
    numbers = {8: 4, 20: 8, 27: 9}[nodes]
    faces = {}
    for name, face in SIDES.items():
        around = FACES[face]
        edges = [8 + next(k for k, e in enumerate(EDGES) if set(e) == {around[n - 4], around[n - 3]}) for n in range(4)]
        axis, end = next((a, e) for a in range(3) for e in (0, 2) if (CORNERS[list(around), a] == e).all())
        outer = cells[first[:, axis] == (0 if end == 0 else 2 * count[axis] - 2)]
        faces[name] = outer[:, [*around, *edges, 20 + face][:numbers]]
    return points, cells, faces


def box(
    lengths: tuple[float, float, float],
    bricks: tuple[int, int, int],
    *,
    degree: int = 1,
    young: float = 1e6,
    poisson: float = 0.3,
    density: float = 1000.0,
    damping: str = "alpha = 1.0, beta = 1e-3",
    clamped: bool = True,
    contacts: Mapping[str, str] | None = None,
    materials: Mapping[str, tuple[Inside, float, float, float]] | None = None,
    copies: int = 1,
    effects: str = "",
) -> fr.System:
    """Assembles a box along x, with its left face clamped.

    Args:
        lengths: m.
        bricks: in each direction.
        degree: of the displacements.
        young, poisson, density: Pa, 1, kg/m3.
        damping: parameters of that effect; empty: none.
        clamped: whether the left face of the first copy is held.
        contacts: by name, the text of their tables; None: the right face, "right", pushed evenly.
        materials: by name, which centroids are in them, and young, poisson and density instead.
        copies: how many of the box there are, side by side in y with gaps between; they have faces "right0", ...
        effects: further effects.
    """
    points, cells = brick_cells(bricks)
    faces = {"left": (0, 0.0), "right": (0, 1.0), "bottom": (2, 0.0), "top": (2, 1.0)}
    outer = outer_triangles(cells)
    places = [points * lengths + [0, 2 * k * lengths[1], 0] for k in range(copies)]
    surfaces = {
        f"{name}{k or ''}": outer[(points[outer, axis] == end).all(axis=1)] + k * len(points)
        for k in range(copies)
        for name, (axis, end) in faces.items()
    }
    all_points = np.concatenate(places)
    all_cells = np.concatenate([cells + k * len(points) for k in range(copies)])
    centroids = all_points[all_cells].mean(axis=1)
    materials = materials or {"body": (lambda p: np.ones(len(p), dtype=bool), young, poisson, density)}
    regions = {name: all_cells[inside(centroids)] for name, (inside, *_) in materials.items()}
    contacts = {"right": 'surface = "right"\nforce = "resultant"'} if contacts is None else contacts

    with tempfile.TemporaryDirectory() as folder:
        mesh = Path(folder) / "boxes.msh"
        mesh.write_text(msh(all_points, {2: surfaces, 3: regions}))
        tables = {"mesh": f'file = "{mesh}"\ndegree = {degree}'}
        tables |= {
            f"materials.{name}": f'cells = "{name}"\nyoung = {E!r}\npoisson = {ν!r}\ndensity = {ρ!r}'
            for name, (_, E, ν, ρ) in materials.items()
        }
        tables |= {"supports": 'clamped = ["left"]'} if clamped else {}
        tables |= {f"contacts.{name}": text for name, text in contacts.items()}
        tables |= {"outputs.tip": 'surface = "right"'}
        tables["effects"] = f"inertia = {{}}\n{f'damping = {{ {damping} }}' if damping else ''}\n{effects}"
        return fr.assemble(parse_scene("\n".join(f"[{heading}]\n{text}" for heading, text in tables.items())))


def outer_triangles(cells: Array) -> Array:
    """Triangles of one cell only."""
    faces = np.sort(cells[:, [(1, 2, 3), (0, 2, 3), (0, 1, 3), (0, 1, 2)]].reshape(-1, 3), axis=1)
    unique, count = np.unique(faces, axis=0, return_counts=True)
    return unique[count == 1]


def msh(points: Array, groups: Mapping[int, Mapping[str, Array]]) -> str:
    """A mesh in Gmsh's format, version 2.

    Args:
        points: (N, 3) m.
        groups: by dimension, 2 or 3, named faces or cells, of as many nodes as they have, in Gmsh's order.
    """
    named = [(dimension, name, cells) for dimension, of in groups.items() for name, cells in of.items()]
    names = [f'{dimension} {tag} "{name}"' for tag, (dimension, name, _) in enumerate(named, start=1)]
    nodes = [f"{k} {x!r} {y!r} {z!r}" for k, (x, y, z) in enumerate(points.tolist(), start=1)]
    elements = [
        f"{KINDS[dimension, len(cell)]} 2 {tag} {tag} {' '.join(map(str, cell))}"
        for tag, (dimension, _, cells) in enumerate(named, start=1)
        for cell in (cells + 1).tolist()
    ]
    numbered = [f"{k} {element}" for k, element in enumerate(elements, start=1)]
    sections = {"PhysicalNames": names, "Nodes": nodes, "Elements": numbered}
    parts = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat"]
    for section, lines in sections.items():
        parts += [f"${section}", str(len(lines)), *lines, f"$End{section}"]
    return "\n".join(parts) + "\n"
