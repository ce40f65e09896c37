"""What an effect does."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Law:
    """An effect in the equation of motion and in the energy account."""

    force: str  # in the equation of motion
    stores: str = "nothing"  # its part in the energy account, here and in the next two
    dissipates: str = "nothing"
    supplies: str = "nothing"
    needs: tuple[str, ...] = ()  # effects without which it means nothing
    online: bool = True  # whether a reduced run can do without what the ROM was made with
    # parameters that a reduced run may have different from those that the ROM was made with
    changing: tuple[str, ...] = ()
