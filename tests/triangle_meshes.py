"""Surfaces of triangles for tests, in NumPy alone: vertices (V, 3), m, and triangles (T, 3), outward."""

from pathlib import Path

import numpy as np

from fenics_rom.mechanics.obstacles import Mesh

Array = np.ndarray


def ball(radius: float = 1.0, halvings: int = 2) -> tuple[Array, Array]:
    """An octahedron whose triangles are divided in four so many times, on a sphere: 8 4^halvings triangles."""
    corners = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=float)
    faces = [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]]
    points = corners[np.array(faces)]
    for _ in range(halvings):
        a, b, c = points.transpose(1, 0, 2)
        d, e, f = (a + b) / 2, (b + c) / 2, (c + a) / 2
        points = np.concatenate([np.stack(each, axis=1) for each in ((a, d, f), (d, b, e), (f, e, c), (d, e, f))])
    points = points.reshape(-1, 3) / np.linalg.norm(points.reshape(-1, 3), axis=1)[:, None]
    vertices, rows = np.unique(points.round(12), axis=0, return_inverse=True)
    return radius * vertices, rows.reshape(-1, 3)


def blob(seed: int, roughness: float = 0.3, radius: float = 0.1, halvings: int = 3) -> Mesh:
    """A ball whose vertices are nearer or farther by chance: it goes in and out everywhere."""
    vertices, triangles = ball(radius, halvings)
    factors = 1 + np.random.default_rng(seed).uniform(-roughness, roughness, len(vertices))
    return Mesh(vertices * factors[:, None], triangles)


def prism(profile: Array, length: float) -> tuple[Array, Array]:
    """A polygon (k, 2) in x (to the right) and z (up), counterclockwise, along y; all of it is seen from its first."""
    k = len(profile)
    ends = [np.insert(profile, 1, y, axis=1) for y in (-length / 2, length / 2)]
    row, after = np.arange(k), (np.arange(k) + 1) % k
    fan = np.stack([np.zeros(k - 2, dtype=int), row[1:-1], row[2:]], axis=1)
    sides = np.stack([after, row, row + k, after, row + k, after + k], axis=1)
    return np.concatenate(ends), np.concatenate([sides.reshape(-1, 3), fan, fan[:, ::-1] + k])


def groove(slope: float = 0.5) -> Mesh:
    """A block whose top is a V along y, its bottom line at the origin."""
    profile = np.array([[0, 0], [-0.2, 0.2 * slope], [-0.2, -0.1], [0.2, -0.1], [0.2, 0.2 * slope]], dtype=float)
    return Mesh(*prism(profile, 0.4))


def room() -> Mesh:
    """All but an octant: a block whose corner at the origin, where x, y, z > 0 meet, is cut out."""
    places = np.array([-0.3, 0.0, 0.3])
    solid = np.ones((2, 2, 2), dtype=bool)
    solid[1, 1, 1] = False
    return Mesh(*_blocks(solid, places))


def _blocks(solid: Array, places: Array) -> tuple[Array, Array]:
    """The surface of those blocks of a lattice that are solid."""
    corners = []
    padded = np.pad(solid, 1)
    for cell in np.argwhere(solid):
        for axis in range(3):
            for side in (0, 1):
                beside = cell + 1
                beside[axis] += 2 * side - 1
                if padded[tuple(beside)]:
                    continue
                u, v = np.eye(3, dtype=int)[(axis + 1) % 3], np.eye(3, dtype=int)[(axis + 2) % 3]
                start = cell + side * np.eye(3, dtype=int)[axis]
                loop = np.array([start, start + u, start + u + v, start + v])
                loop = loop if side else loop[::-1]
                corners += [loop[[0, 1, 2]], loop[[0, 2, 3]]]
    points = places[np.concatenate(corners)]
    vertices, rows = np.unique(points, axis=0, return_inverse=True)
    return vertices, rows.reshape(-1, 3)


def plate(squares: int, size: float = 0.4) -> tuple[Array, Array]:
    """A flat square in z = 0, of two triangles in each of its squares, whose inner vertices are moved along it."""
    x, rng = np.linspace(-size / 2, size / 2, squares + 1), np.random.default_rng(0)
    vertices = np.stack([*np.meshgrid(x, x, indexing="ij"), np.zeros((len(x), len(x)))], axis=-1)
    vertices[1:-1, 1:-1, :2] += 0.3 * size / squares * rng.uniform(-1, 1, (squares - 1, squares - 1, 2))
    row = np.arange(len(x) ** 2).reshape(len(x), len(x))
    a, b, c, d = (part.ravel() for part in (row[:-1, :-1], row[1:, :-1], row[1:, 1:], row[:-1, 1:]))
    return vertices.reshape(-1, 3), np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])


def write_stl(file: Path, mesh: Mesh, scale: float = 1.0) -> Path:
    """As text."""
    with file.open("w") as stream:
        stream.write("solid part\n")
        for triangle in scale * mesh.surface.vertices[mesh.triangles]:
            stream.write("facet normal 0 0 0\nouter loop\n")
            stream.writelines("vertex {!r} {!r} {!r}\n".format(*corner) for corner in triangle.tolist())
            stream.write("endloop\nendfacet\n")
        stream.write("endsolid part\n")
    return file
