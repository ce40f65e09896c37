"""What goes through the skins of the soft bodies of a world, where contact does not keep it out."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.placed_surface import PlacedSurface
from fenics_rom.mechanics.skin import BESIDE, BETWEEN, Intrusion, Skin
from fenics_rom.mechanics.skin_path import CHECK_INTERVAL, MOST_PLACES, QUICK, Instant, Placement, moved_between
from fenics_rom.mechanics.skin_watch import SkinWatch
from fenics_rom.runtime.skin_looks import Mark, SkinPlaces
from fenics_rom.runtime.steppers.contact_interface import skin_of
from fenics_rom.world.collision.contacts import PlacedShape
from fenics_rom.world.collision.soft_surfaces import soft_on_soft
from fenics_rom.world.driven import Driven
from fenics_rom.world.make_bodies import AnyBody
from fenics_rom.world.meetings import Meeting
from fenics_rom.world.rigid import Rigid
from fenics_rom.world.soft import Soft

_Way = tuple[Array, float]  # of a body as a whole, (3,), and how far its points went beside that, m

CALM = 4  # times as many again, while none goes far relative to another one, and
NOT_FAR = 1 / 8  # of how far it could go before it is looked at


class _Watched(NamedTuple):
    """A soft body."""

    body: Soft
    watch: SkinWatch  # by rigid bodies and soft ones
    places: SkinPlaces


class _Since(NamedTuple):
    """Where bodies were at the last look."""

    soft: Mapping[str, Mark]
    rigid: Mapping[str, PlacedShape]  # those that may get into soft ones


class WorldSkins:
    """Looks at the skins of soft bodies every so many steps, sooner where bodies move fast.

    Args:
        bodies: all of them, by name, where they begin.
        meetings: those that may touch.
    """

    def __init__(self, bodies: Mapping[str, AnyBody], meetings: Sequence[Meeting]):
        self._watched = dict[str, _Watched]()
        for name, body in bodies.items():
            if isinstance(body, Soft) and body.touches and len(body.rom.triangles):
                skin = skin_of(body.rom)
                self._watched[name] = _Watched(body, SkinWatch(skin, f"body {name!r}"), SkinPlaces(body, skin))
        self._into = dict[tuple[str, str], Meeting]()  # of a soft body and a rigid one
        self._between = dict[tuple[str, str], Meeting]()  # of two soft ones
        self._rigid = dict[str, Rigid | Driven]()
        for meeting in (each for each in meetings if each.own is None):
            one, other = sorted(meeting.names, key=lambda name: (name not in self._watched, name))
            if other in self._watched:
                self._between[one, other] = meeting
            elif one in self._watched and not isinstance(body := bodies[other], Soft):
                self._into[one, other], self._rigid[other] = meeting, body
        self._joined = {pair for pair, meeting in self._meetings if not meeting.is_on}
        self._next_look = min((each.watch.next_look for each in self._watched.values()), default=0)
        self._since, self._looked, self._slowness, self._are_calm = self._now(), 0, 1, False
        self._soft_room = 0.0  # how far soft bodies may move before they are looked at, m
        self._check_start()

    @property
    def _meetings(self) -> list[tuple[tuple[str, str], Meeting]]:
        return [*self._into.items(), *self._between.items()]

    @property
    def messages(self) -> tuple[str, ...]:
        """What to say of the run so far."""
        return tuple(message for each in self._watched.values() for message in each.watch.messages)

    def asks(self, steps: int, are_quick: bool) -> bool:
        """Whether `is_due` is to be asked, when so many steps were taken: more rarely where they are quick."""
        self._slowness = (CALM if self._are_calm else 1) * QUICK if are_quick else 1
        return bool(self._watched) and (self._is_time(steps) or steps % (self._slowness * CHECK_INTERVAL) == 0)

    def steps_to_ask(self, steps: int, most: int) -> int:
        """In how many compiled steps `asks` is true next, or so many at most; `steps` were taken so far."""
        ahead = 1
        while ahead < most and not self.asks(steps + ahead, True):
            ahead += 1
        return ahead

    def _is_time(self, steps: int) -> bool:
        return steps >= self._looked + self._slowness * (self._next_look - self._looked)

    def is_due(self, steps: int) -> bool:
        """Whether to look, when so many steps were taken: after enough of them, or as something may have gone in."""
        if self._is_time(steps):
            return True
        ways = {name: _way(body.lies(), self._since.rigid[name]) for name, body in self._rigid.items()}
        ways |= {name: each.places.way(self._since.soft[name]) for name, each in self._watched.items()}
        rooms = {pair: self._watched[pair[0]].watch.room for pair in self._into}
        rooms |= dict.fromkeys(self._between, self._soft_room)
        went = [(_apart(ways[one], ways[other]), room) for (one, other), room in rooms.items()]
        self._are_calm = not any(apart > NOT_FAR * room for apart, room in went)
        return any(apart > room for apart, room in went)

    def look(self, steps: int, time: float) -> None:
        """Looks where bodies are when so many steps were taken, at a time, s."""
        before, self._since, self._looked = self._since, self._now(), steps
        self._soft_room = math.inf
        self._let_go()
        for name, each in self._watched.items():
            met = [other for one, other in self._into if one == name and self._meet((one, other))]
            then, now = ({f"body {other!r}": of.rigid[other] for other in met} for of in (before, self._since))
            was = Instant(_placement(each, before.soft[name]), then)
            each.watch.look(steps, time, Instant(_placement(each), now), was)
            self._next_look = each.watch.next_look
        for pair in self._between:
            if self._meet(pair):
                self._look_at_soft(pair, before.soft, time)

    def _now(self) -> _Since:
        marks = {name: each.places.mark() for name, each in self._watched.items()}
        return _Since(marks, {name: body.lies() for name, body in self._rigid.items()})

    def _meet(self, pair: tuple[str, str]) -> bool:
        """Whether they touch: what is joined does not, nor what was let go and is still in one another."""
        return (self._into.get(pair) or self._between[pair]).is_on and pair not in self._joined

    def _let_go(self) -> None:
        """Takes note of who is joined, and who of those let go has come out of the other one."""
        for pair, meeting in self._meetings:
            if not meeting.is_on:
                self._joined.add(pair)
            elif pair in self._joined and not self._is_in(pair):
                self._joined.remove(pair)

    def _is_in(self, pair: tuple[str, str]) -> bool:
        if pair in self._between:
            return bool(self._in_each_other(pair, self._placements(pair)))
        each = self._watched[pair[0]]
        return bool(each.watch.skin.intrusions(_placement(each).whole(), self._rigid[pair[1]].lies()))

    def _placements(self, pair: tuple[str, str]) -> list[Placement]:
        return [_placement(self._watched[name]) for name in pair]

    def _look_at_soft(self, pair: tuple[str, str], before: Mapping[str, Mark], time: float) -> None:
        """Looks at where two soft bodies are, and at where they were since the last look."""
        now, then = self._placements(pair), [_placement(self._watched[name], before[name]) for name in pair]
        one, two = (self._watched[name].watch.skin for name in pair)
        stride = _spacing(one, two)
        self._soft_room = min(self._soft_room, max(stride, one.room_beside(two, *(each.few for each in now))))
        ways = list(zip(then, now, strict=True))
        went = sum(moved_between(Instant(start, {}), Instant(end, {})) for start, end in ways)
        places = min(max(1, math.ceil(went / stride)), MOST_PLACES)
        for share in (number / places for number in range(1, places + 1)):
            there = [end.after(start, share) if share < 1 else end for start, end in ways]
            for into, who, found in self._in_each_other(pair, there):
                into.watch.note(f"body {who!r}", time, found)

    def _in_each_other(
        self, pair: tuple[str, str], there: Sequence[Placement]
    ) -> list[tuple[_Watched, str, list[Intrusion]]]:
        """Of two soft bodies the one that is in the other, which, and how deep; of both the deeper one."""
        skins, (a, b) = [self._watched[name].watch.skin for name in pair], [each.whole() for each in there]
        if (a.min(axis=0) > b.max(axis=0)).any() or (b.min(axis=0) > a.max(axis=0)).any():
            return []
        found = _deepest(skins[1], b, skins[0], a), _deepest(skins[0], a, skins[1], b)
        depths = [max((each.depth for each in of), default=0.0) for of in found]
        into = int(depths[1] >= depths[0])
        return [(self._watched[pair[into]], pair[1 - into], found[into])] if found[into] else []

    def _check_start(self) -> None:
        for name, other in self._into:
            each, there = self._watched[name], self._rigid[other]
            if each.body.carrier is there:  # what carries a body may begin in it, where it is held
                each.watch.skin.leave_out(there.lies().distance(_placement(each).whole())[0])
        for name, other in filter(self._meet, self._into):
            each, there = self._watched[name], self._rigid[other]
            each.watch.check_start(_placement(each).whole(), {f"body {other!r}": there.lies()})
        for pair in filter(self._meet, self._between):
            for into, who, found in self._in_each_other(pair, self._placements(pair)):
                into.watch.refuse(f"body {who!r}", found)


def _way(now: PlacedShape, before: PlacedShape) -> _Way:
    """How a rigid body went, and how far, at most, its points beside that."""
    whole = now.position - before.position
    return whole, now.moved(before) - math.sqrt(whole.dot(whole))


def _apart(one: _Way, other: _Way) -> float:
    """How far, at most, points of two bodies went relative to one another, m."""
    whole = one[0] - other[0]
    return math.sqrt(whole.dot(whole)) + one[1] + other[1]


def _placement(each: _Watched, mark: Mark | None = None) -> Placement:
    """Where a skin is, or was at a mark, in world axes."""
    body, placed = each.body, each.places.placement(mark)
    return Placement(body.to_world(placed.few), lambda: body.to_world(placed.whole()))


def _spacing(one: Skin, two: Skin) -> float:
    """Of the nodes of both, m."""
    return float(max(np.median(one.spacing), np.median(two.spacing)))


def _deepest(inner: Skin, inside: Array, outer: Skin, around: Array) -> list[Intrusion]:
    """How deep the inner skin, whose nodes are at (V, 3), m, is in the outer one, at (W, 3), m: at most one.

    Its nodes are looked at, and the middles of its triangles and their sides.
    """
    corners = inside[inner.triangles]
    middles = (corners + np.roll(corners, -1, axis=1)) / 2
    points = np.concatenate([inside, corners.mean(axis=1), middles.reshape(-1, 3)])
    covered = np.concatenate([inner.touched, inner.covered, np.repeat(inner.covered, 3)])
    spacing = _spacing(inner, outer)
    surfaces = (
        PlacedSurface(points, inner.triangles, np.arange(len(points))),
        PlacedSurface(around, outer.triangles, np.empty(0, dtype=int)),
    )
    found = soft_on_soft(*surfaces, 0.0)
    both = covered[found.first.nodes[:, 0]] & outer.touched[found.second.nodes].all(axis=1)
    deep = np.flatnonzero(found.gaps < -spacing * np.where(both, BETWEEN, BESIDE))
    best = list[Intrusion]()
    if len(deep):
        row = deep[found.gaps[deep].argmin()]
        here = found.second.nodes[row]
        there = found.second.arms[row], outer.part_at(here), outer.surface_at(here)
        best.append(Intrusion(-float(found.gaps[row]), *there))
    few = inside[inner.few_rows]
    gone = few[outer.contain(around, few)]  # also what is deeper than contact looks
    if len(gone) and (below := outer.below(around, gone)).depth > max(spacing, best[0].depth if best else 0.0):
        best = [below]
    return best
