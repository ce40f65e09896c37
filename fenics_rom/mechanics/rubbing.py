"""What friction does at contact points: tangential forces, what they may be at most, and how fast contact slips.

Of a pair with the normal n, the force f on the body and the velocity v relative to what it touches, in the middle of
the step: λ = n·f, t = f - λ n, s = v - (n·v) n, and |t| <= μ λ. A pair slides where |t| = μ λ.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.contact import ContactSolution

AT_LIMIT = 1e-6  # of μ λ: by so much less |t| is the limit, to which forces are found


class Rubbing(NamedTuple):
    """Of all pairs at the contact points of a body, as parts that belong to points as forces do."""

    tangential: Array  # Σ t (P, 3), N
    limits: Array  # Σ μ λ (P,), N
    slipping: Array  # Σ λ s (P, 3), N m/s
    sliding: Array  # Σ λ (P,) of the pairs that slide, N


class PairPlaces(NamedTuple):
    """Where some pairs are on a body, and which side of them it is."""

    nodes: Array  # (C, c) contact points that carry each
    weights: Array  # (C, c) of these
    sign: float  # 1 where forces and velocities are its own, -1 where they are those of what it touches


def rubbing_at(
    count: int, places: Iterable[PairPlaces], normals: Array, forces: Array, velocities: Array, μ: Array | float
) -> Rubbing:
    """Of C pairs on a body of so many contact points.

    Args:
        count: P.
        places: where they are; a body that touches itself has both ends of each.
        normals, forces, velocities: (C, 3) of the pairs; the body's where the sign of a place is 1.
        μ: of each, (C,), or of all.
    """
    λ = (normals * forces).sum(axis=1)
    t, s = forces - λ[:, None] * normals, velocities - (normals * velocities).sum(axis=1)[:, None] * normals
    slides = np.linalg.norm(t, axis=1) >= (1 - AT_LIMIT) * μ * λ
    found = nothing_rubs(count)
    for nodes, weights, sign in places:
        for sums, of_pairs in zip(found, (sign * t, μ * λ, sign * λ[:, None] * s, λ * slides), strict=True):
            np.add.at(sums, nodes, _spread(weights, of_pairs))
    return found


def nothing_rubs(count: int) -> Rubbing:
    """At so many contact points."""
    return Rubbing(np.zeros((count, 3)), np.zeros(count), np.zeros((count, 3)), np.zeros(count))


def _spread(weights: Array, of_pairs: Array) -> Array:
    """Values (C, ...) by weights (C, c), (C, c, ...)."""
    spread: Array = weights.reshape(*weights.shape, *(1,) * (of_pairs.ndim - 1)) * of_pairs[:, None]
    return spread


def rubbing_of(contact: ContactSolution, velocities: Array, μ: float) -> Rubbing:
    """Of contact in a step in which contact points moved by velocities (P, 3), m/s, in its middle."""
    count = len(velocities)
    own = (contact.pairs % count)[:, None]
    nodes, weights = (own, np.ones(own.shape)) if contact.carriers is None else contact.carriers
    places = [PairPlaces(nodes, weights, 1.0)]
    if contact.opposite is not None:
        places.append(PairPlaces(contact.opposite.nodes, contact.opposite.weights, -1.0))
    return rubbing_at(count, places, contact.normals, contact.pair_forces, contact.relative(velocities), μ)
