"""Contact forces as they were found, and what counts as found."""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError

# Residuals are shares of the velocities that the forces have to stop.
CONVERGENCE_TOLERANCE = 1e-12  # near what round-off leaves
NEGLIGIBLE_RESIDUAL = 1e-9  # as good as solved
STAGNATION_RESIDUAL = NEGLIGIBLE_RESIDUAL / 100  # where an iteration that no longer halves it has met round-off
ADVICE = "; a smaller dt, less friction or the penalty variant (stiffness) may help"  # where no forces are found
WEDGED = (
    "; a point is wedged between obstacles: where these close on it, and friction is more than the tangent of half the "
    "angle between them, there are none at any dt; less friction or the penalty variant (stiffness) helps"
)
TOO_STIFF = (
    "; the body moves these points in {} independent ways, of the {} that forces push them in, so that there may be "
    "none at any dt: residual compliance of its contact (effects.contact), a larger order, less friction or the "
    "penalty variant (stiffness) helps"
)
HARDLY_MOVED = 1e-4  # of the mean velocity by a force: what others are that a body does not allow
LARGEST_RESIDUAL = 1e-3  # accepted, and told, where no method gets further: there may be no solution at all
PROXIMAL_COMPLIANCE = 1e-9  # added to a system, in parts of each pair's own
NEWTON_ITERATIONS = 12  # where they suffice they are rarely more than five
REGULAR_SHARE = 0.4  # ρ in parts of each pair's stiffness, where W is regular
_CALM = 8  # steps without a correction, after which forces are told from fewer steps
_MOST_LACKED = 8  # steps from which is told what forces will lack
_MOST_WEAR = 256  # of an inverse, see KeptLaw.worn


def largest(values: Array) -> float:
    """The largest of some numbers, not a number where one is none; three times as fast as `max` of a short array."""
    value: float = values.item(values.argmax())
    return value


def is_none(flags: Array) -> bool:
    """Whether of some booleans none is true; twice as fast as `any`."""
    return b"\x01" not in flags.tobytes()


def statuses_of(length: Array, cone: Array) -> bytes:
    """Of each pair whether it slips, and whether it is closed, from |z_t| and μ z_n (C,); see `frictional`."""
    closed = cone > 0
    return (closed & (length > cone)).tobytes() + closed.tobytes()


class KeptLaw(NamedTuple):
    """Coulomb's law as it was linearised in an earlier step, in axes that last when normals turn (see Frames)."""

    statuses: bytes  # of each pair whether it was open, stuck or slipped
    inverse: Array | None  # (3C, 3C), of where they were the same twice, N s/m: `Linearisation.inverse`
    q: Array  # of the last step (3, C), m/s
    forces: Array  # which were found for it (3, C), N
    lacking: Array | float = 0.0  # what they will lack by the inverse and the q of the next time step (3, C), N
    lacked: tuple[Array, ...] = ()  # what they did in the last steps, the last one first
    calm: int = 0  # steps since one was corrected, or was told from fewer of these
    wear: int = 0  # of the inverse

    def worn(self, corrections: int) -> int:
        """`wear` after a step with so many: one more hardly pays to find the inverse anew, several do."""
        return self.wear + (1 + 4 * (corrections - 1) ** 3 if corrections else 0)

    @property
    def is_worn(self) -> bool:
        """Whether the inverse is to be found anew."""
        return self.wear >= _MOST_WEAR

    def foreseen(self, lacking: Array, was_corrected: bool) -> tuple[Array, tuple[Array, ...], int]:
        """`lacking`, `lacked` and `calm` after a step that has lacked so much.

        Polynomials through every other step go on: of lower degrees as long as that is right, as they add less
        round-off, which is tried every few steps.
        """
        if not (was_corrected or self.lacked):
            return lacking, (), 0
        calm, most = (0, _MOST_LACKED) if was_corrected else (self.calm + 1, len(self.lacked))
        if calm > _CALM:
            calm, most = 0, max(most - 2, 0)
        lacked = (lacking, *self.lacked)[:most]
        if len(lacked) < 4:
            return lacking, lacked, calm
        if len(lacked) < 6:
            return 2 * lacked[1] - lacked[3], lacked, calm
        if len(lacked) < 8:
            return 3 * (lacked[1] - lacked[3]) + lacked[5], lacked, calm
        return 4 * (lacked[1] + lacked[5]) - 6 * lacked[3] - lacked[7], lacked, calm


class Solution(NamedTuple):
    """Contact forces."""

    forces: Array  # (3, C), N, exactly in their cones
    velocities: Array  # u (3, C), m/s, to round-off
    iterations: int  # of all methods together
    residual: float = 0.0  # what is left to solve, as a share of the velocities that the forces have to stop
    kept: KeptLaw | None = None  # to begin the next step's search with, if the same pairs take part


def check_residual(residual: float, pairs: int, iterations: int) -> None:
    """Refuses forces that leave too much.

    Raises:
        StepError: with the residual.
    """
    if not residual <= LARGEST_RESIDUAL:
        raise StepError(
            f"contact of {pairs} pairs: no forces found that stop them: after {iterations} iterations the residual is "
            f"{residual:.1e} of the velocities, at most {LARGEST_RESIDUAL:.0e}{ADVICE}"
        )


def advice_of(W: Array, is_wedged: bool) -> str:
    """What may help where no forces are found of pairs of this operator (3C, 3C), some of one point if wedged."""
    if is_wedged:
        return WEDGED
    if not np.isfinite(W).all():
        return ADVICE
    λ = np.linalg.eigvalsh(W)
    rank = int((λ > HARDLY_MOVED * λ.mean()).sum())
    return ADVICE if rank == len(λ) else TOO_STIFF.format(rank, len(λ))
