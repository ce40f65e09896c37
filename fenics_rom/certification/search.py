"""The largest values of several functions over a box, and what they can be at most anywhere in it.

Lipschitz optimisation by boxes (Piyavskii, 1972; Jones, Perttunen & Stuckman, 1993). Each box is looked at in its
middle c. Where a function changes along coordinate k by at most L_k for the whole range, it is in a box of widths w_k
(shares of the ranges) at most

    f(c) + Σ_k L_k w_k / 2

A box is cut into three along one coordinate, so that its middle stays one: two runs more. The slopes are those that
were seen between such neighbours, times SAFETY: an assumption, which is stated with the result.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray as Array

SAFETY = 1.5  # times the largest slope that was seen
NARROWEST = 3.0**-4  # of a range: peaks jump a little from one to the next, which is no slope
Values = Callable[[Array], Array]  # of a point (d,) of the box [0, 1]^d, (q,)


@dataclass(frozen=True)
class Cover:
    """Boxes that cover [0, 1]^d, with what is known of q functions in them.

    Attributes:
        middles: (n, d) where they were looked at.
        widths: (n, d) of the boxes.
        values: (n, q) there.
        quotients: (d, q) largest changes that were seen between neighbours along each coordinate, for a whole range.
    """

    middles: Array
    widths: Array
    values: Array
    quotients: Array

    @property
    def slopes(self) -> Array:
        """(d, q) that are taken for the largest there are."""
        return SAFETY * self.quotients

    @property
    def at_most(self) -> Array:
        """(n, q) what the functions can be in each box."""
        return self.values + self.widths @ self.slopes / 2

    @property
    def largest(self) -> Array:
        """(q,) that were found."""
        return self.values.max(axis=0)

    @property
    def bound(self) -> Array:
        """(q,) what the functions can be anywhere."""
        return self.at_most.max(axis=0)

    def fitted(self, points: Array, values: Array) -> "Cover":
        """The same, with slopes so much larger that the functions can be as they are, (k, q), in corners (k, d)."""
        boxes = (np.abs(points[:, None] - self.middles) / self.widths).max(axis=2).argmin(axis=1)
        rises, found = (self.at_most - self.values)[boxes], values - self.values[boxes]
        factors = np.divide(found, rises, out=np.ones_like(found), where=rises > 0)
        return replace(self, quotients=self.quotients * factors.max(axis=0, initial=1.0))


def search(values: Values, dimension: int, tolerance: float, most: int) -> Cover:
    """Cuts boxes until no function can be larger anywhere than `tolerance` allows, or after about `most` points.

    Args:
        values: asked once at each point.
        dimension: d, of the box; 0 is one point.
        tolerance: share of the largest that was found by which the bound may be above it.
        most: points; the last cut may bring two more.
    """
    middle = np.full(dimension, 0.5)
    cover = Cover(middle[None], np.ones((1, dimension)), values(middle)[None], np.zeros((dimension, 1)))
    for along in range(dimension):  # so that each slope was seen
        cover = _cut(cover, values, 0, along)
    while len(cover.middles) < most:
        over = cover.at_most / np.where(cover.largest > 0, cover.largest, np.inf) - 1
        parts = (cover.slopes.max(axis=1) * cover.widths) * (cover.widths > NARROWEST)
        worst = np.where(parts.any(axis=1), over.max(axis=1), 0)
        box = int(worst.argmax())
        if worst[box] <= tolerance:
            break
        function = int(over[box].argmax())
        parts = cover.slopes[:, function] * cover.widths[box] * (cover.widths[box] > NARROWEST)
        cover = _cut(cover, values, box, int((parts if parts.any() else cover.widths[box]).argmax()))
    return cover


def _cut(cover: Cover, values: Values, box: int, along: int) -> Cover:
    """Cuts a box into three along a coordinate."""
    widths = cover.widths.copy()
    widths[box, along] /= 3
    step = np.zeros(widths.shape[1])
    step[along] = widths[box, along]
    points = np.array([cover.middles[box] - step, cover.middles[box] + step])
    found = np.array([values(point) for point in points])
    quotients = np.broadcast_to(cover.quotients, (len(step), found.shape[1])).copy()
    seen = np.abs(found - cover.values[box]).max(axis=0) / step[along]
    quotients[along] = np.maximum(quotients[along], seen)
    return Cover(
        np.concatenate([cover.middles, points]),
        np.concatenate([widths, widths[[box, box]]]),
        np.concatenate([cover.values, found]),
        quotients,
    )
