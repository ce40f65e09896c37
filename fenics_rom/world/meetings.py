"""Which bodies of a world may touch, by which law, and where they do in a step.

Where they do is looked for as the bodies are expected in the middle of the step, so that what rolls is pushed where it
then touches. Rigid bodies that lie as they lay keep the contacts that they had.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from fenics_rom.errors import SceneError, StepError, check_known
from fenics_rom.mechanics.contact import ContactLaw
from fenics_rom.mechanics.own_surface import OwnSurface
from fenics_rom.mechanics.placed_surface import PlacedSurface
from fenics_rom.world.bodies import Body
from fenics_rom.world.collision.contacts import Contacts, Placed, PlacedShape
from fenics_rom.world.collision.find import find_contacts
from fenics_rom.world.collision.soft_surfaces import soft_on_itself
from fenics_rom.world.soft import Soft
from fenics_rom.world.tolerances import PENETRATION_TOLERANCE

STILL = 1e-10  # rad, and of the body's size: poses that differ by less are the same


@dataclass
class Meeting:
    """Two bodies that may touch, or one that may touch itself.

    Attributes:
        first, second: their numbers, of one body the same.
        names: theirs.
        law: how they meet.
        size: of the smaller, m.
        contacts: of the last look; None where they were far from one another.
        is_on: whether they touch; what is joined does not.
        own: of a body that may touch itself, its surface.
    """

    first: int
    second: int
    names: tuple[str, str]
    law: ContactLaw
    size: float
    contacts: Contacts | None = None
    is_on: bool = True
    own: OwnSurface | None = None
    _looked_at: tuple[Placed, Placed] | None = None

    def look(self, first: Placed, second: Placed, margin: float, anew: bool = False) -> None:
        """Finds the contacts that are nearer than a margin, m; `anew`: also where both are where they were."""
        if not self.is_on:
            self.contacts = self._looked_at = None
            return
        known = None if anew else self._looked_at
        if known is not None and first is known[0] and second is known[1]:
            return
        contacts = self._find(first, second, margin)
        self.contacts, self._looked_at = contacts if len(contacts.gaps) else None, (first, second)

    def _find(self, first: Placed, second: Placed, margin: float) -> Contacts:
        if self.own is None:
            return find_contacts(first, second, margin)
        assert isinstance(first, PlacedSurface)
        return soft_on_itself(first, self.own, margin)

    def overlap(self, bodies: Sequence[Body]) -> Contacts | None:
        """Where the two, among all bodies, are inside one another now by more than round-off; None: they are not."""
        first, second = bodies[self.first], bodies[self.second]
        for body in (first, second):
            body.begin(0.0)
        contacts = self._find(first.placed(), second.placed(), 0.0)
        is_inside = len(contacts.gaps) and contacts.gaps.min() < -PENETRATION_TOLERANCE * self.size
        return contacts if is_inside else None


def make_meetings(
    bodies: Mapping[str, Body],
    law: ContactLaw,
    pairs: Mapping[tuple[str, str], ContactLaw],
    apart: Sequence[Collection[str]],
) -> list[Meeting]:
    """Every two bodies that may touch.

    Args:
        bodies: by name.
        law: of all.
        pairs: other laws of two bodies, by their names; of a soft body with itself, which touches itself by this, or as
            its scene has self_contact.
        apart: groups of names of bodies that do not touch.

    Raises:
        SceneError: names that nobody has, two laws of a pair, or one of bodies that do not touch.
    """
    laws, separate = _laws(pairs, bodies), _pairs_apart(apart, bodies)
    for pair in laws:
        if len(pair) == 1 and bodies[min(pair)].touches:
            continue
        why = "as `apart` says" if pair in separate else "as the scene of one of them names no effects.contact"
        if pair in separate or not all(bodies[name].touches for name in pair):
            raise SceneError(f"pairs: {' and '.join(sorted(pair))}: have no contact, {why}: use one of both")
    meetings = []
    for (a, (first, one)), (b, (second, other)) in combinations(enumerate(bodies.items()), 2):
        both, size = frozenset((first, second)), min(one.size, other.size)
        touch = one.touches and other.touches and both not in separate
        if touch and not (one.is_driven and other.is_driven):
            meetings.append(Meeting(a, b, (first, second), laws.get(both, law), size))
    return meetings + [
        Meeting(k, k, (name, name), laws.get(frozenset([name]), law), body.size, own=_own_surface(name, body))
        for k, (name, body) in enumerate(bodies.items())
        if frozenset([name]) in laws or (len(bodies) > 1 and _scene_says_so(body))
    ]


def _scene_says_so(body: Body) -> bool:
    """Whether a body touches itself by its scene; alone it is a Simulator, and does it by itself."""
    return isinstance(body, Soft) and bool(body.rom.environment.self_contact)


def _own_surface(name: str, body: Body) -> OwnSurface:
    """Of a body that may touch itself."""
    if not isinstance(body, Soft) or not len(body.contact_triangles):
        why = "its contact points are no corners of triangles" if isinstance(body, Soft) else "it is rigid"
        raise SceneError(f"pairs: {name!r} with itself: {why}: use a soft body whose contact surfaces have areas")
    points, interface = body.contact_coordinates, body.integrator.interface
    assert interface is not None
    named = interface.points.own_surface(body.rom.environment.self_contact, body.rom.triangles)
    return named or OwnSurface(points, body.contact_triangles, np.arange(len(points)), [name] * len(points))


def _laws(pairs: Mapping[tuple[str, str], ContactLaw], bodies: Mapping[str, Body]) -> dict[frozenset[str], ContactLaw]:
    laws: dict[frozenset[str], ContactLaw] = {}
    for pair, law in pairs.items():
        for name in pair:
            check_known("body", name, bodies, SceneError, "pairs: ")
        if law.stiffness is not None:
            raise SceneError(f"pairs: {pair}: use a law without stiffness between bodies, 'complementarity'")
        if frozenset(pair) in laws:
            raise SceneError(f"pairs: {' and '.join(pair)}: are named twice: use one law of two bodies")
        if all(bodies[name].is_driven for name in pair) and len(set(pair)) == 2:
            raise SceneError(f"pairs: {' and '.join(pair)}: both move as they are told, and do not push one another")
        laws[frozenset(pair)] = law
    return laws


def _pairs_apart(apart: Sequence[Collection[str]], bodies: Collection[str]) -> set[frozenset[str]]:
    for group in apart:
        for name in group:
            check_known("body", name, bodies, SceneError, "apart: ")
    return {frozenset(pair) for group in apart for pair in combinations(group, 2)}


def is_still(now: Placed | None, then: Placed | None, size: float) -> bool:
    """Whether a rigid body of a size, m, lies as it lay."""
    if not (isinstance(now, PlacedShape) and isinstance(then, PlacedShape)):
        return False
    moved, turned = np.abs(now.position - then.position), np.abs(now.rotation - then.rotation)
    return bool(moved.max() <= STILL * size and turned.max() <= STILL)


def check_apart(bodies: Sequence[Body], meetings: Sequence[Meeting]) -> None:
    """A StepError where a body begins inside of another one."""
    for meeting in meetings:
        contacts = meeting.overlap(bodies) if meeting.is_on else None
        if contacts is not None:
            deepest, (first, second) = int(contacts.gaps.argmin()), meeting.names
            there = f"{-contacts.gaps[deepest]:.3g} m", f"at {contacts.first.arms[deepest].round(9).tolist()}"
            if meeting.own is not None:
                raise StepError(
                    f"use a surface that begins outside of itself, but that of {first!r} is through itself by "
                    f"{' '.join(there)}; begin with another shape, or leave out that it touches itself (`pairs`)"
                )
            raise StepError(
                f"use bodies that begin outside of one another, but {first!r} is {there[0]} inside {second!r} "
                f"{there[1]}; move one of them, or name both in `apart`"
            )
