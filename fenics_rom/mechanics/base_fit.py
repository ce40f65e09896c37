"""Whether the poses of a base that carries a body fit its twists."""

import math
from typing import TYPE_CHECKING, Protocol

from fenics_rom.mechanics.frame_geometry import Geometry
from fenics_rom.mechanics.frame_motion import Numbers, Rotation, Vector, added, composed, cross, length, rotated, turned

if TYPE_CHECKING:
    from fenics_rom.mechanics.base_path import BaseState

MISFIT = 0.1  # of what the base moves by in a step: so far off may be what its twists say
NEGLIGIBLE = 1e-5  # rad, and of the size of the body: in a step, of paths whose rows have few digits


class Placed(Protocol):
    """A base: where it is, m, and its unit quaternion."""

    @property
    def position(self) -> Numbers:
        """(3,)."""

    @property
    def rotation(self) -> Numbers:
        """(4,)."""


def misfit(start: Placed, end: Placed, turn: Geometry, v̂: Vector, h: float, size: float) -> tuple[float, float]:
    """How far a base went, m, and turned, rad, in a step of h s otherwise than its twists say; 0 where that is little.

    Args:
        start, end: of the step.
        turn: how the frame turns by its twists.
        v̂: mean velocity, in the frame's axes, m/s.
        h: s.
        size: of the body, m.
    """
    (a, b, c), (x, y, z) = start.position, end.position
    ways = turn.before, turn.turn, v̂, h, size
    return misfit_of((x - a, y - b, z - c), start.rotation, end.rotation, *ways)


def misfit_of(
    moved: Vector, start: Numbers, end: Numbers, R: Rotation, t: Vector, v̂: Vector, h: float, size: float
) -> tuple[float, float]:
    """The same of a move, m, and unit quaternions at both ends; R is that at the start, and its twist turns by t."""
    said = rotated(R, added(v̂, 0.5, cross(t, v̂)))
    away = gap(moved, (h * said[0], h * said[1], h * said[2]), NEGLIGIBLE * size)
    turned_by, most = _apart(turned(start, t), end), length(t)
    if turned_by <= NEGLIGIBLE or turned_by <= MISFIT * max(_apart(start, end), most):
        turned_by = 0.0
    return away, turned_by


def told_misfit(start: "BaseState", end: "BaseState", h: float, size: float) -> tuple[float, float]:
    """The same of what is moved by poses in a step of h s, of at most MOST_TURNED: how far they are from its twists."""
    w, x, y, z = start.rotation.tolist()
    cosine, *sines = composed(end.rotation.tolist(), (w, -x, -y, -z))
    sine = length(sines)
    share = 2 * math.atan(sine / cosine) / sine if sine else 0.0
    went, said = (end.position - start.position).tolist(), (h / 2 * (start.velocity + end.velocity)).tolist()
    about = (h / 2 * (start.angular_velocity + end.angular_velocity)).tolist()
    return gap(went, said, NEGLIGIBLE * size), gap([share * part for part in sines], about, NEGLIGIBLE)


def gap(moved: Numbers, said: Numbers, least: float) -> float:
    """By how much a move (3,) is not what was said of it (3,); 0 where that is `least` or little beside them."""
    off = length((moved[0] - said[0], moved[1] - said[1], moved[2] - said[2]))
    return 0.0 if off <= least or off <= MISFIT * max(length(moved), length(said)) else off


def misfit_message(away: float, turned_by: float, *, driven: str = "", obstacle: str = "") -> tuple[str, ...]:
    """What to say of a run in whose steps a base went so far otherwise at most, m and rad; nothing where it did not.

    Or of a rigid body of a world that is `driven`, or of an obstacle, by its name.
    """
    if not (away or turned_by):
        return ()
    means = "the account closes, but the forces are of the twists"
    if driven:
        means = "the account closes; contact is of the poses, but rebounds and bodies on it go by the twists"
    if obstacle:
        means = "the account closes, and contact is of the poses"
    return (
        f"{driven or obstacle or 'base'}: in a step it went {away:.2g} m and turned {turned_by:.2g} rad otherwise than "
        f"its velocities at both ends say: it jumps, or twists and poses do not fit; {means}",
    )


def _apart(a: Numbers, b: Numbers) -> float:
    """The angle between two rotations, rad: a chord of unit quaternions is twice the sine of a quarter of it."""
    (s, t, u, v), (w, x, y, z) = a, b
    sign = math.copysign(1.0, s * w + t * x + u * y + v * z)
    s, t, u, v = s - sign * w, t - sign * x, u - sign * y, v - sign * z
    return 4 * math.asin(min(math.sqrt(s * s + t * t + u * u + v * v) / 2, 1.0))
