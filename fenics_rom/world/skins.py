"""What goes through the skins of the soft bodies of a world, where contact does not keep it out."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.base_path import rotation_vectors
from fenics_rom.mechanics.frame_motion import quaternion_of, quaternion_of_vector, rotation_matrix
from fenics_rom.mechanics.skin import BESIDE, BETWEEN, Intrusion, Skin
from fenics_rom.mechanics.skin_path import CHECK_INTERVAL, MOST_PLACES, Instant, Placement, moved_between
from fenics_rom.mechanics.skin_watch import SkinWatch
from fenics_rom.runtime.skin_looks import Mark, SkinPlaces
from fenics_rom.runtime.steppers.contact_interface import skin_of
from fenics_rom.world.collision.contacts import PlacedShape, PlacedSurface
from fenics_rom.world.collision.round_shapes import distance_of
from fenics_rom.world.collision.soft_surfaces import soft_on_soft
from fenics_rom.world.driven import Driven
from fenics_rom.world.make_bodies import AnyBody
from fenics_rom.world.meetings import Meeting
from fenics_rom.world.rigid import Rigid
from fenics_rom.world.soft import Soft


class PlacedIntruder(NamedTuple):
    """A rigid body as it lies, as what may get into a soft one."""

    placed: PlacedShape

    def distance(self, points: Array) -> tuple[Array, Array]:
        """As of an Intruder."""
        return distance_of(self.placed, points)

    @property
    def core(self) -> tuple[float, Array]:
        """As of an Intruder."""
        radius, centres = self.placed.shape.core
        return radius, self.placed.position + centres.dot(self.placed.rotation.T)

    def after(self, before: "PlacedIntruder", share: float) -> "PlacedIntruder":
        """As of an Intruder."""
        (shape, position, R), (_, start, R_start) = self.placed, before.placed
        turn = rotation_vectors(quaternion_of(R @ R_start.T)[None])[0]
        there = start + share * (position - start), rotation_matrix(quaternion_of_vector(share * turn)) @ R_start
        return PlacedIntruder(PlacedShape(shape, *there))

    def moved(self, before: "PlacedIntruder") -> float:
        """As of an Intruder."""
        (shape, position, R), (_, start, R_start) = self.placed, before.placed
        gone, turned = position - start, (R - R_start).ravel()
        moved = math.sqrt(gone.dot(gone))
        if turned.any() and math.isfinite(shape.radius_around):
            moved += math.sqrt(turned.dot(turned)) * shape.radius_around
        return moved


class _Watched(NamedTuple):
    """A soft body, and who may get into it."""

    body: Soft
    watch: SkinWatch  # by rigid bodies and soft ones
    places: SkinPlaces
    rigid: Mapping[str, Rigid | Driven]  # that may get into it, by name
    soft: Sequence[str]


class _Since(NamedTuple):
    """Where bodies were at the last look."""

    soft: Mapping[str, Mark]
    rigid: Mapping[str, PlacedIntruder]  # those that may get into soft ones


class WorldSkins:
    """Looks at the skins of soft bodies every so many steps, sooner where bodies move fast.

    Args:
        bodies: all of them, by name, where they begin.
        meetings: those that may touch.
    """

    def __init__(self, bodies: Mapping[str, AnyBody], meetings: Sequence[Meeting]):
        names = list(bodies)
        self._meetings = {frozenset((names[each.first], names[each.second])): each for each in meetings}
        self._joined = {pair for pair, meeting in self._meetings.items() if not meeting.is_on}
        self._watched = dict[str, _Watched]()
        for name, body in bodies.items():
            if not isinstance(body, Soft) or not body.touches or not len(body.rom.triangles):
                continue
            met = {frozenset((names[meeting.first], names[meeting.second])) for meeting in meetings}
            others = [other for other in names if other != name and {name, other} in met]
            skin = skin_of(body.rom)
            rigid = {other: there for other in others if not isinstance(there := bodies[other], Soft)}
            soft = [other for other in others if other not in rigid]
            self._watched[name] = _Watched(body, SkinWatch(skin, f"body {name!r}"), SkinPlaces(body, skin), rigid, soft)
        self._next_look = min((each.watch.next_look for each in self._watched.values()), default=0)
        self._rigid = {name: body for each in self._watched.values() for name, body in each.rigid.items()}
        self._since = self._now()
        self._soft_room = 0.0  # how far soft bodies may move before they are looked at, m
        self._leave_out_carriers()
        self._check_start()

    @property
    def messages(self) -> tuple[str, ...]:
        """What to say of the run so far."""
        return tuple(message for each in self._watched.values() for message in each.watch.messages)

    def is_due(self, steps: int) -> bool:
        """Whether to look, when so many steps were taken: after enough of them, or as something may have gone in."""
        if not self._watched or (steps < self._next_look and steps % CHECK_INTERVAL):
            return False
        if steps >= self._next_look:
            return True
        went = {f"body {name!r}": _intruder(body).moved(self._since.rigid[name]) for name, body in self._rigid.items()}
        soft = {name: each.places.moved(self._since.soft[name]) for name, each in self._watched.items()}
        for name, each in self._watched.items():
            rigid = max((went[f"body {other!r}"] for other in each.rigid), default=0.0)
            others = max((soft[other] for other in each.soft if other in soft), default=-soft[name])
            if soft[name] + rigid > each.watch.room or soft[name] + others > self._soft_room:
                return True
        return False

    def look(self, steps: int, time: float) -> None:
        """Looks where bodies are when so many steps were taken, at a time, s."""
        before, self._since = self._since, self._now()
        self._soft_room = math.inf
        for name, each in self._watched.items():
            self._let_go(name, each)
            met = [other for other in each.rigid if self._meet(name, other)]
            then, now = (self._instant(each, since.soft[name], since.rigid, met) for since in (before, self._since))
            now = now._replace(body=_placement(each))
            each.watch.look(steps, time, now, then)
            self._next_look = each.watch.next_look
        for name, each in self._watched.items():
            for other in each.soft:
                if other in self._watched and name < other and self._meet(name, other):
                    self._look_at_soft(name, other, before.soft, time)

    def _now(self) -> _Since:
        marks = {name: each.places.mark() for name, each in self._watched.items()}
        return _Since(marks, {name: _intruder(body) for name, body in self._rigid.items()})

    def _instant(self, each: _Watched, mark: Mark, rigid: Mapping[str, PlacedIntruder], met: Sequence[str]) -> Instant:
        return Instant(_placement(each, mark), {f"body {other!r}": rigid[other] for other in met})

    def _meet(self, one: str, other: str) -> bool:
        """Whether they touch: what is joined does not, nor what was let go and is still in one another."""
        pair = frozenset((one, other))
        return self._meetings[pair].is_on and pair not in self._joined

    def _let_go(self, name: str, each: _Watched) -> None:
        """Takes note of who is joined to a body, and who of those let go has come out of it."""
        for other in (*each.rigid, *each.soft):
            pair = frozenset((name, other))
            if not self._meetings[pair].is_on:
                self._joined.add(pair)
            elif pair in self._joined and not self._is_in(name, other):
                self._joined.remove(pair)

    def _is_in(self, name: str, other: str) -> bool:
        each = self._watched[name]
        if other in each.rigid:
            return bool(each.watch.skin.intrusions(_placement(each).whole(), _intruder(each.rigid[other])))
        return other in self._watched and bool(self._found_in_each_other(name, other))

    def _look_at_soft(self, name: str, other: str, before: Mapping[str, Mark], time: float) -> None:
        """Looks at where two soft bodies are, and at where they were since the last look."""
        one, two = self._watched[name], self._watched[other]
        now, then = (_placement(one), _placement(two)), (_placement(one, before[name]), _placement(two, before[other]))
        stride = _spacing(one.watch.skin, two.watch.skin)
        self._soft_room = min(
            self._soft_room, max(stride, one.watch.skin.room_beside(two.watch.skin, *(each.few for each in now)))
        )
        went = sum(moved_between(Instant(start, {}), Instant(end, {})) for start, end in zip(then, now, strict=True))
        places = min(max(1, math.ceil(went / stride)), MOST_PLACES)
        for number in range(1, places + 1):
            a, b = (
                end.after(start, number / places) if number < places else end
                for start, end in zip(then, now, strict=True)
            )
            for into, who, found in _in_each_other((name, one, a), (other, two, b)):
                into.watch.note(f"body {who!r}", time, found)

    def _found_in_each_other(self, name: str, other: str) -> list[tuple[_Watched, str, list[Intrusion]]]:
        one, two = self._watched[name], self._watched[other]
        return _in_each_other((name, one, _placement(one)), (other, two, _placement(two)))

    def _leave_out_carriers(self) -> None:
        """What a body is mounted on may begin in it, where it is held."""
        for each in self._watched.values():
            for there in each.rigid.values():
                if each.body.carrier is there:
                    gaps, _ = _intruder(there).distance(_placement(each).whole())
                    each.watch.skin.leave_out(gaps)

    def _check_start(self) -> None:
        for name, each in self._watched.items():
            there = {f"body {other!r}": _intruder(of) for other, of in each.rigid.items() if self._meet(name, other)}
            each.watch.check_start(_placement(each).whole(), there)
            for other in each.soft:
                if other not in self._watched or name > other or not self._meet(name, other):
                    continue
                for into, who, found in self._found_in_each_other(name, other):
                    into.watch.refuse(f"body {who!r}", found)


def _intruder(body: Rigid | Driven) -> PlacedIntruder:
    pose, shape = body.pose, body.shape
    assert shape is not None
    return PlacedIntruder(PlacedShape(shape, pose.position, rotation_matrix(pose.rotation)))


def _placement(each: _Watched, mark: Mark | None = None) -> Placement:
    """Where a skin is, or was at a mark, in world axes."""
    body, placed = each.body, each.places.placement(mark)
    return Placement(body.to_world(placed.few), lambda: body.to_world(placed.whole()))


def _spacing(one: Skin, two: Skin) -> float:
    """Of the nodes of both, m."""
    return float(max(np.median(one.spacing), np.median(two.spacing)))


def _in_each_other(
    one: tuple[str, _Watched, Placement], two: tuple[str, _Watched, Placement]
) -> list[tuple[_Watched, str, list[Intrusion]]]:
    """Of two soft bodies the one that is in the other, which, and how deep; of both the deeper one."""
    (first, a, a_there), (second, b, b_there) = one, two
    places = a_there.whole(), b_there.whole()
    if (places[0].min(axis=0) > places[1].max(axis=0)).any() or (places[1].min(axis=0) > places[0].max(axis=0)).any():
        return []
    in_b = _deepest(a.watch.skin, places[0], b.watch.skin, places[1])
    in_a = _deepest(b.watch.skin, places[1], a.watch.skin, places[0])
    if max((each.depth for each in in_a), default=0.0) > max((each.depth for each in in_b), default=0.0):
        return [(a, second, in_a)]
    return [(b, first, in_b)] if in_b else []


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
