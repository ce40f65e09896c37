"""Which bodies of a world may touch, and how they meet."""

from collections.abc import Collection, Mapping, Sequence
from itertools import combinations

from fenics_rom.errors import SceneError, check_known
from fenics_rom.mechanics.contact import ContactLaw
from fenics_rom.world.bodies import Body
from fenics_rom.world.meetings import Meeting


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
        pairs: other laws of two bodies, by their names.
        apart: groups of names of bodies that do not touch.

    Raises:
        SceneError: names that nobody has, two laws of a pair, or one of bodies that do not touch.
    """
    laws, separate, names = _laws(pairs, bodies), _pairs_apart(apart, bodies), list(bodies)
    for pair in laws:
        why = "as `apart` says" if pair in separate else "as the scene of one of them names no effects.contact"
        if pair in separate or not all(bodies[name].touches for name in pair):
            raise SceneError(f"pairs: {' and '.join(sorted(pair))}: have no contact, {why}: allowed is one of both")
    meetings = []
    for a, b in combinations(range(len(names)), 2):
        both, one, other = frozenset((names[a], names[b])), bodies[names[a]], bodies[names[b]]
        touch = one.touches and other.touches and both not in separate
        if touch and not (one.is_driven and other.is_driven):
            meetings.append(Meeting(a, b, laws.get(both, law), min(one.size, other.size)))
    return meetings


def _laws(pairs: Mapping[tuple[str, str], ContactLaw], bodies: Mapping[str, Body]) -> dict[frozenset[str], ContactLaw]:
    laws: dict[frozenset[str], ContactLaw] = {}
    for pair, law in pairs.items():
        for name in pair:
            check_known("body", name, bodies, SceneError, "pairs: ")
        if law.stiffness is not None:
            raise SceneError(f"pairs: {pair}: allowed between bodies is a law without stiffness, 'complementarity'")
        if frozenset(pair) in laws:
            raise SceneError(f"pairs: {' and '.join(pair)}: are named twice: allowed is one law of two bodies")
        if all(bodies[name].is_driven for name in pair):
            raise SceneError(f"pairs: {' and '.join(pair)}: both move as they are told, and do not push one another")
        laws[frozenset(pair)] = law
    return laws


def _pairs_apart(apart: Sequence[Collection[str]], bodies: Collection[str]) -> set[frozenset[str]]:
    for group in apart:
        for name in group:
            check_known("body", name, bodies, SceneError, "apart: ")
    return {frozenset(pair) for group in apart for pair in combinations(group, 2)}
