"""What contact points (P,) do in a step, and forces f on them, as they yield beyond the basis, too."""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.contact_adjoint import ContactAdjoint
from fenics_rom.runtime.steppers.residual_maps import ResidualMaps
from fenics_rom.runtime.steppers.slopes import Slopes

Blocks = tuple[Array, Array, Array]


class Touch(NamedTuple):
    """Slopes with k numbers of a place and as many of velocities, through what the points yield.

    The residual part sees R*ᵀ f, and has part in what points are at the start, y, go by in the step, û, and went by, u.
    """

    contact: ContactAdjoint  # how the forces were found
    residual: ResidualMaps | None
    turned: Array  # R* (3, 3)
    start: Array  # R
    place: Array  # of the displacement d (3P, k)
    by_forces: Array  # ∂(Sᵀ f)/∂f (k, 3P)
    # Of the velocities ŝ in the step, and κ, told as those at its start, (3P, k); of what may touch itself in a moving
    # frame also of places in the middle.
    motions: tuple[Slopes, ...]
    by_yielding: tuple[Array, ...]  # of these with f (3P, 3P)
    blocks: tuple[Blocks, ...]  # of these with y, û and u, (P, 3, 3)
    push: Slopes | None = None  # of Sᵀ f where f stays; None: it stays, too
    push_rows: tuple[Array, Array] | None = None  # of Sᵀ f with y and û, (k, 3P)
    seen: Slopes | None = None  # of R*ᵀ f where f stays (3P, k)

    def seen_back(self, seen_: Array) -> tuple[Array | float, Array | float, Array, Array | float]:
        """What is owed to the place and x, (k,), to f, (3P,), and to a base, by what f is to the residual part."""
        of_place, of_x, of_end = 0.0, 0.0, 0.0
        if self.seen is not None:
            of_place, of_x = seen_ @ self.seen.place, seen_ @ self.seen.x
            of_end = seen_ @ self.seen.end if len(self.seen.end) else 0.0
        return of_place, of_x, seen_.reshape(-1, 3).dot(self.turned.T).ravel(), of_end

    def rows_back(self, d_: Array, motions_: list[Array]) -> Array:
        """What is owed to the residual's rows (n, 3P), by displacements and motions (3P,) of the points."""
        assert self.residual is not None
        of_y, of_û, of_u = (
            sum(_back(each, owed) for each, owed in zip(blocks, motions_, strict=True))
            for blocks in zip(*self.blocks, strict=True)
        )
        rows_ = np.multiply.outer(self.residual.yielding, of_û)
        rows_[1] += d_.reshape(-1, 3).dot(self.start).ravel() + of_y
        rows_[3] += of_u
        return rows_

    def rows_of_push(self, y: Array) -> Array | float:
        """The same by Sᵀ f, which is owed y (k,)."""
        if self.residual is None or self.push_rows is None:
            return 0.0
        by_place, by_mean = self.push_rows
        rows_ = np.multiply.outer(self.residual.yielding, y @ by_mean)
        rows_[1] += y @ by_place
        return rows_


def of_world(operator: Array, turned: Array) -> Array:
    """An operator (n, 3P) on forces as the frame sees them, R*ᵀ f, on those in world axes."""
    whole: Array = operator.reshape(len(operator), -1, 3).dot(turned.T).reshape(operator.shape)
    return whole


def _back(blocks: Array, owed: Array) -> Array:
    """Of (P, 3, 3), transposed, (3P,)."""
    back: Array = np.einsum("pij,pi->pj", blocks, owed.reshape(-1, 3)).ravel()
    return back
