"""What of a displacement is not a rigid motion: all that strains a body which turns as far as it likes."""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.trajectory.trajectory import Trajectory


def elastic_part(snapshots: Array, nodes: Array, node_mass: Array) -> Array:
    """Displacements less the rigid motion that is nearest to them by mass, in axes that turn with it.

    Args:
        snapshots: displacements of all nodes, (..., N, 3), m.
        nodes: at rest, (N, 3), m.
        node_mass: (N,), kg.
    """
    return rigid_and_elastic(snapshots, nodes, node_mass)[1]


def rigid_and_elastic(snapshots: Array, nodes: Array, node_mass: Array) -> tuple[Array, Array]:
    """The rotations (..., 3, 3) of these rigid motions (Kabsch, 1976), and the elastic parts (..., N, 3)."""
    share = (node_mass / node_mass.sum())[:, None]
    arms = nodes - (share * nodes).sum(axis=0)
    places = nodes + snapshots
    places = places - (share * places).sum(axis=-2, keepdims=True)
    U, _, Vt = np.linalg.svd(places.swapaxes(-1, -2) @ (share * arms))
    U[..., -1] *= np.sign(np.linalg.det(U @ Vt))[..., None]  # a rotation, no reflection
    R = U @ Vt
    return R, places @ R - arms


def deformation(run: Trajectory, snapshots: Array) -> Array:
    """Of displacements of a run (s, N, 3), m, in world axes: what strains its bodies, each for itself.

    In a frame that stands still it is all.
    """
    if run.pose is None and not run.bodies:
        return snapshots
    strained = np.zeros_like(snapshots)
    pieces = [(body.nodes, body.stands_still) for body in run.bodies.values() if body.kind == "soft"]
    for rows, stands_still in pieces if run.bodies else [(slice(None), False)]:
        if stands_still:
            strained[:, rows] = snapshots[:, rows]
            continue
        R, elastic = rigid_and_elastic(snapshots[:, rows], run.nodes[rows], run.node_mass[rows])
        strained[:, rows] = elastic @ R.swapaxes(1, 2)
    return strained
