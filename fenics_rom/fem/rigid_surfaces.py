"""Surfaces that move as rigid bodies do: which of their nodes lead, and what the others do.

Where turns are small six components lead, and the others follow them linearly. Where they are large, all components of
three nodes of a flat surface lead, or of four of any other, and the others follow them as in an affine motion,

    x_i = Σ_a w_ia x_a,   Σ_a w_ia = 1,

which is linear, too. Between each two leaders there is a bar whose length stays, three bars or six: the affine motions
that keep these lengths are the rigid ones.
"""

from itertools import combinations

import numpy as np
import scipy.linalg

from fenics_rom.errors import SceneError
from fenics_rom.fem.nodes import Nodes
from fenics_rom.fem.places import patch_nodes
from fenics_rom.scene.scene import Scene
from fenics_rom.system.rigid_modes import rigid_fields

FLAT = 1e-6  # of its size: as near to a plane as that, which is what single precision leaves, is in it
SHALLOW = 1e-3  # of its size: what is nearer to a plane, and not in it, is not told from its mirror image


def rigid_nodes(scene: Scene, nodes: Nodes) -> dict[str, np.ndarray]:
    """Nodes (s,) of each rigid surface of a scene, by its place in the file.

    Raises:
        MeshError, SceneError: a place that does not exist.
    """
    places = {f"{scene.source}: supports.rigid[{k}]": place for k, place in enumerate(scene.rigid)}
    return {where: patch_nodes(nodes, place, where) for where, place in places.items()}


def bars_of(scene: Scene, nodes: Nodes) -> dict[str, list[int]]:
    """The two ends of each of the bars that keep surfaces rigid where turns are large, by name."""
    bars: dict[str, list[int]] = {}
    if scene.effects.large_deformation is None:
        return bars
    for k, (where, numbers) in enumerate(rigid_nodes(scene, nodes).items(), start=1):
        leading = numbers[leaders(nodes.coordinates[numbers], where)].tolist()
        bars |= {f"rigid-{k}-bar-{b}": list(ends) for b, ends in enumerate(combinations(leading, 2), start=1)}
    return bars


def rigid_ties(places: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What components of nodes that move as a rigid body follow, of small motions.

    Args:
        places: (s, 3), not on one line, m.

    Returns:
        The components (3 s - 6,) that follow, the six that lead, and the weights (3 s - 6, 6) of these: six that tell
        the motion best, by pivoting, so that no weight is large.
    """
    motions = rigid_fields(places, np.ones(len(places)))
    leading = np.sort(scipy.linalg.qr(motions.T, mode="r", pivoting=True)[1][:6])
    components = np.setdiff1d(np.arange(len(motions)), leading)
    return components, leading, np.linalg.solve(motions[leading].T, motions[components].T).T


def affine_ties(places: np.ndarray, leading: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """As `rigid_ties`, of affine motions that some of the nodes lead (3 or 4,): the others' components follow."""
    followers = np.setdiff1d(np.arange(len(places)), leading)
    coordinates = np.hstack([np.ones((len(places), 1)), places - places.mean(axis=0)])
    weights = np.linalg.lstsq(coordinates[leading].T, coordinates[followers].T, rcond=None)[0].T
    axes = np.arange(3)
    components, leads = ((3 * numbers[:, None] + axes).ravel() for numbers in (followers, leading))
    return components, leads, np.kron(weights, np.eye(3))


def leaders(places: np.ndarray, where: str) -> np.ndarray:
    """Three nodes that tell the affine motions of a flat surface best, or four of any other, ascending.

    Args:
        places: (s, 3), not on one line, m.
        where: they are, for messages.

    Raises:
        SceneError: they are neither flat nor clearly curved.
    """
    arms = places - places.mean(axis=0)
    sizes = np.linalg.svd(arms, compute_uv=False)
    depth = sizes[2] / sizes[0]
    if FLAT < depth < SHALLOW:
        raise SceneError(
            f"{where}: the surface is flat but for {depth:.1e} of its size, too little to tell it from its mirror "
            f"image when it turns; use one that is flat to {FLAT:g}, or curved by "
            f"{SHALLOW:g} and more"
        )
    motions = np.hstack([np.full((len(places), 1), sizes[0] / np.sqrt(len(places))), arms])
    return np.sort(scipy.linalg.qr(motions.T, mode="r", pivoting=True)[1][: 4 if depth > FLAT else 3])
