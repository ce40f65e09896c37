"""How far a body may turn in a step."""

from fenics_rom.errors import StepError
from fenics_rom.mechanics.frame_motion import Vector, dot

LARGEST_TURN = 1.5  # rad in a step, h |ω|: beyond it there may be no step, or another one than that of the body


def check_turn(h: float, ω: Vector, body: str = "the body") -> None:
    """A StepError where a step of h s would turn the body too far."""
    speed = dot(ω, ω) ** 0.5
    if not h * speed <= LARGEST_TURN:
        raise StepError(
            f"{body} would turn by {h * speed:.3g} rad in a step of {h:g} s: at most {LARGEST_TURN:g} rad, that "
            f"is, at {speed:.3g} rad/s, a dt of at most {LARGEST_TURN / speed:.2g} s"
        )
