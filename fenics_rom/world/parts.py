"""What each body has to do with the pairs of a step, put together of its contacts and joints."""

from collections.abc import Sequence

import numpy as np
from numpy import ndarray as Array

from fenics_rom.world.bodies import NO_POINTS, NO_ROWS, Body, Part, Points
from fenics_rom.world.collision.contacts import Contacts, Spots, widened

End = tuple[Array, float, Points]  # of pairs on a body: which, with which sign, and where


def points_of(spots: Spots, follows: bool = False) -> Points:
    """Of contacts on a body; follows: as of Points."""
    return Points(spots.nodes, spots.weights, np.empty((0, 3)), np.full(len(spots.arms), follows))


def relative_points(found: Contacts) -> Points:
    """Of a body that touches itself: what its first points do less what its second ones do."""
    nodes = np.hstack([found.first.nodes, found.second.nodes])
    weights = np.hstack([found.first.weights, -found.second.weights])
    return Points(nodes, weights, np.empty((0, 3)), np.zeros(len(nodes), dtype=bool))


def part_of(body: Body, ends: list[End]) -> Part:
    """Of a body in several meetings and joints."""
    owned, sides, points = zip(*(ends or [(NO_ROWS, 1.0, NO_POINTS)]), strict=True)
    pairs = np.concatenate(owned)
    signs = np.concatenate([np.full((len(own), 1), sign) for own, sign in zip(owned, sides, strict=True)])
    first, last = (int(pairs[0]), int(pairs[-1])) if len(pairs) else (0, -1)
    in_one_piece = last - first == len(pairs) - 1
    rows = slice(first, last + 1) if in_one_piece else pairs
    return Part(body, pairs, rows, signs, len(set(sides)) == 1, _concatenated(points))


def _concatenated(points: Sequence[Points]) -> Points:
    """Points of a body in several meetings and joints."""
    wide = max(part.nodes.shape[1] for part in points)
    starts = np.cumsum([0, *(len(part.nodes) for part in points)])
    nodes, weights = zip(*(widened(part.nodes, part.weights, wide) for part in points), strict=True)
    arms, follows = [part.arms for part in points], [part.follows for part in points]
    couples = [part.couples + start for part, start in zip(points, starts[:-1], strict=True)]
    tells = [part.tells + start for part, start in zip(points, starts[:-1], strict=True)]
    return Points(*map(np.concatenate, (nodes, weights, arms, follows, couples, tells)))
