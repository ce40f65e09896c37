"""Surfaces of obstacles as triangles, for pictures and for the live view."""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.obstacles import Box, Capsule, HalfSpace, Mesh, Obstacle, Sphere
from fenics_rom.visualization.optional_dependencies import trimesh_package

SPHERE_SUBDIVISIONS = 3  # of an icosahedron: 1,280 triangles
CAPSULE_SEGMENTS = 48  # around its axis, and along


def obstacle_mesh(obstacle: Obstacle, floor_centre: Array, floor_half_edge: float) -> tuple[Array, Array]:
    """The surface of an obstacle that has not moved: vertices (V, 3), m, and triangles (F, 3), outward.

    Of a half-space, which goes on for ever, it is a square of its face, around the point that is nearest to
    `floor_centre` (3,), m, with half an edge as long as `floor_half_edge`, m.
    """
    if isinstance(obstacle, Mesh):
        return obstacle.surface.vertices, obstacle.triangles
    trimesh = trimesh_package()
    if isinstance(obstacle, HalfSpace):
        return _square(obstacle, floor_centre, floor_half_edge)
    if isinstance(obstacle, Sphere):
        ball = trimesh.creation.icosphere(subdivisions=SPHERE_SUBDIVISIONS, radius=obstacle.radius)
        return np.asarray(ball.vertices) + obstacle.center, np.asarray(ball.faces)
    if isinstance(obstacle, Capsule):
        axis, middle = np.subtract(obstacle.end, obstacle.start), np.add(obstacle.start, obstacle.end) / 2
        height, count = float(np.linalg.norm(axis)), [CAPSULE_SEGMENTS, CAPSULE_SEGMENTS]
        rod = trimesh.creation.capsule(height=height, radius=obstacle.radius, count=count)
        centred = np.asarray(rod.vertices) - np.mean(rod.bounds, axis=0)  # wherever trimesh puts it
        turn = trimesh.geometry.align_vectors([0.0, 0.0, 1.0], axis)[:3, :3]
        return centred @ turn.T + middle, np.asarray(rod.faces)
    assert isinstance(obstacle, Box)
    block = trimesh.creation.box(extents=obstacle.size)
    vertices, vector = np.asarray(block.vertices), np.array(obstacle.rotation)
    if vector.any():
        turn = trimesh.transformations.rotation_matrix(np.linalg.norm(vector), vector)[:3, :3]
        vertices = vertices @ turn.T
    return vertices + obstacle.center, np.asarray(block.faces)


def _square(obstacle: HalfSpace, centre: Array, half_edge: float) -> tuple[Array, Array]:
    gap, normals = obstacle.distance(centre[None])
    normal = normals[0]
    across = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    across *= half_edge / np.linalg.norm(across)
    along = np.cross(normal, across)
    corners = np.array([across + along, along - across, -across - along, across - along])
    return centre - gap[0] * normal + corners, np.array([[0, 1, 2], [0, 2, 3]])
