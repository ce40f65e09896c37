"""Telling what goes through the skin of a body: once of each obstacle or body and each part of the skin, in a run."""

import math
import warnings
from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import FenicsRomWarning, StepError
from fenics_rom.mechanics.skin import UNTOUCHED, Intruder, Intrusion, MovedIntruder, Skin
from fenics_rom.mechanics.skin_path import Instant, on_the_way, stride_of

if TYPE_CHECKING:
    from fenics_rom.mechanics.obstacles import Obstacle

FIRST_LOOK, LOOK_INTERVAL = 8, 64  # steps: so that looking at what hardly moves costs a few per cent of stepping
STILL = 0.1  # of the spacing of nodes: what has moved by less since it was looked at is not looked at again


class Told(NamedTuple):
    """Who went through a part of a skin."""

    who: str
    part: str  # as of an Intrusion
    surface: str  # as of an Intrusion, where it was at most
    depth: float  # at most, m
    place: tuple[float, ...]  # where it was at most, m
    time: float  # of the first look that found it, s


def displaced(obstacles: "Mapping[str, Obstacle]", offsets: Array) -> dict[str, MovedIntruder]:
    """Obstacles by name, displaced by (O, 3), m, by who they are."""
    moved = zip(obstacles.items(), offsets, strict=True)
    return {f"obstacle {name!r}": MovedIntruder(shape, offset) for (name, shape), offset in moved}


class SkinWatch:
    """Looks at a skin every so many steps, sooner where things move fast, and keeps what went through it.

    Args:
        skin: of the body.
        name: of the body, to say who is gone into.

    Attributes:
        told: what went through so far.
        next_look: at which step, at the latest.
        room: how far the body and others may move, together, before a look is due, m.
    """

    def __init__(self, skin: Skin, name: str = "the body"):
        self.skin, self._name = skin, name
        self._still = STILL * float(np.median(skin.spacing)) if len(skin.spacing) else 0.0
        self.begin((), 0)

    def begin(self, told: tuple[Told, ...], steps: int) -> None:
        """Goes on from what was told when so many steps were taken."""
        self.told, self.next_look, self.room = told, steps + FIRST_LOOK, 0.0
        self._seen: dict[str, Array] = {}

    def look(self, steps: int, time: float, now: Instant, before: Instant | None, springs: bool = False) -> None:
        """Looks where others are when so many steps were taken, at a time, s, and warns of those not told yet.

        Args:
            steps, time: as above.
            now: where all are.
            before: where they were at the last look; None: what was between does not count.
            springs: as of `Skin.intrusions`.
        """
        self.next_look = steps + (LOOK_INTERVAL if steps >= LOOK_INTERVAL else max(steps, FIRST_LOOK))
        self.room = math.inf
        for who, intruder in now.intruders.items():
            gaps, seen = intruder.distance(now.body.few)[0], self._seen.get(who)
            self.room = min(self.room, max(self.skin.room(gaps), stride_of(self.skin, intruder)))
            *between, _ = way = list(on_the_way(self.skin, who, before, now))
            if not between and seen is not None and np.abs(gaps - seen).max() < self._still:
                continue
            self._seen[who] = gaps
            for body, there in way:
                if self.skin.may_meet(body.few, there.distance(body.few)[0], there):
                    self.note(who, time, self.skin.intrusions(body.whole(), there, springs))

    def note(self, who: str, time: float, found: list[Intrusion]) -> None:
        """Keeps what was found of someone at a time, s; warns of it where it is the first of its kind."""
        for depth, place, part, surface in found:
            known = {(each.who, each.part): each for each in self.told}
            before = known.get((who, part))
            if before is not None and depth <= before.depth:
                continue
            known[who, part] = Told(who, part, surface, depth, _rounded(place), time if before is None else before.time)
            self.told = tuple(known.values())
            if before is None:
                warnings.warn(self._text(known[who, part], "is"), FenicsRomWarning, stacklevel=5)

    @property
    def messages(self) -> tuple[str, ...]:
        """What to say of the run so far."""
        return tuple(self._text(each, "was up to") for each in self.told)

    def _text(self, told: Told, verb: str) -> str:
        when = f"at t = {told.time:.4g} s" if verb == "is" else f"from t = {told.time:.4g} s on"
        return (
            f"contact: {told.who} {verb} {1e3 * told.depth:.3g} mm inside {self._name} at {list(told.place)} m"
            f"{_named(told.surface)}, {when}, {self._cure(told.part, told.surface)}"
        )

    def _cure(self, part: str, surface: str) -> str:
        if part != UNTOUCHED:
            return (
                f"between the contact points of {part!r}: effects.contact.points = 'faces' keeps it out, or a finer "
                "mesh there; in a world 'surface' does"
            )
        there = ", ".join(self.skin.names) or "no contact surface"
        this = f"surface {surface!r}" if surface else "this surface"
        return (
            f"where the surface has no contact points, so that nothing keeps it out: name {this} in a contact mode "
            f"(there is {there}), or keep it from there"
        )

    def check_start(self, places: Array, intruders: Mapping[str, Intruder]) -> None:
        """Checks that nothing is deep in the body whose skin is at places (V, 3), m.

        Raises:
            StepError: something is; it says where, how deep and what to do.
        """
        for who, intruder in intruders.items():
            self.refuse(who, self.skin.intrusions(places, intruder))

    def refuse(self, who: str, found: list[Intrusion]) -> None:
        """A StepError of the first that someone is in at the start, if there is one."""
        for depth, place, part, surface in found:
            raise StepError(
                f"contact: use a start outside of all obstacles and other bodies, but {who} is {depth:.3g} m "
                f"inside {self._name} at {list(_rounded(place))}{_named(surface)}, {self._cure(part, surface)}"
            )


def _named(surface: str) -> str:
    return f" on surface {surface!r}" if surface else ""


def _rounded(place: Array) -> tuple[float, ...]:
    """In four digits of the largest number."""
    scale = 10.0 ** (math.floor(math.log10(max(np.abs(place).max(), np.finfo(float).tiny))) - 3)
    return tuple(float(f"{round(x / scale) * scale:.4g}") + 0.0 for x in place.tolist())
