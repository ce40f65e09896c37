"""Forces that are found in a step, as compiled functions have them."""

import numpy as np

from fenics_rom.mechanics.compiled.searched_forces import Actuators
from fenics_rom.rom.deformation import ReducedTendon
from fenics_rom.runtime.compiled.strokes import Pull, rooms_for_pull
from fenics_rom.runtime.steppers.acts.following import Pressure
from fenics_rom.runtime.steppers.acts.found_forces import FoundForces
from fenics_rom.runtime.steppers.compiled_deformation import polynomials_of, segments_of


def pull_of(found: FoundForces, m: int, p: int) -> Pull | None:
    """Of p inputs, as arrays; None where more is found than forces of cables and chambers, as of bars."""
    followers, actuators = found.followers, found.actuators
    if not followers or not all(isinstance(each, ReducedTendon | Pressure) for each in followers):
        return None
    n, k = len(followers), len(actuators.names)
    after, last = np.full(n, -1), dict[str, int]()
    for guide, (tendon, _) in enumerate(actuators.guides, start=k):
        after[guide], last[tendon] = last.get(tendon, -1), guide
    for stroke, name in enumerate(actuators.names):
        after[stroke] = last.get(name, -1)
    chambers = [each.polynomial for each in followers if isinstance(each, Pressure)]
    is_chamber = np.array([isinstance(each, Pressure) for each in followers])
    numbers = np.where(is_chamber, is_chamber.cumsum() - 1, -1)
    none, lengths, counts = (np.empty((0, 3)), np.empty((0, 3, m)), np.zeros(0)), np.zeros(n), np.zeros(n, dtype=int)
    parts = [none]
    for number, each in enumerate(followers):
        if isinstance(each, ReducedTendon):
            own = segments_of([each], m)
            begin = len(own[0]) - 1 if after[number] >= 0 else 0
            parts.append((own[0][begin:], own[1][begin:], own[2]))
            lengths[number], counts[number] = own[2][0], len(own[0]) - begin
    starts, beyond = np.cumsum([0, *counts]), np.zeros(n, dtype=np.int64)
    for guide, before in enumerate(after[k:].tolist(), start=k):
        if before >= 0:
            beyond[before] = starts[guide]
    for number, (name, guide) in enumerate(last.items()):  # from which the last segment leads to where it is pulled
        at_rest, shapes, length = segments_of([found.rubbing[name]], m)
        parts.append((at_rest[-1:], shapes[-1:], length))
        beyond[guide] = starts[-1] + number
    at_rest, shapes, _ = map(np.concatenate, zip(*parts, strict=True))
    polynomials = polynomials_of(chambers, m)
    given = Actuators.of(actuators, p), actuators.friction, numbers, after, starts, beyond, at_rest, shapes, lengths
    return Pull(*given, polynomials, np.zeros(polynomials.shape[2]), np.zeros(n), *rooms_for_pull(n, m))


def linear_pull(found: FoundForces, m: int, p: int) -> Pull:
    """The same of small strains: what forces do stays."""
    actuators, n = found.actuators, len(found.actuators.columns)
    given = Actuators.of(actuators, p)
    of_cables = np.full(n, -1), np.full(n, -1), np.zeros(n + 1, dtype=np.int64), np.zeros(n, dtype=np.int64)
    shapes = np.empty((0, 3)), np.empty((0, 3, m)), np.zeros(n)
    polynomials = polynomials_of([], m)
    fixed = given, actuators.friction, *of_cables, *shapes, polynomials, np.zeros(polynomials.shape[2]), np.zeros(n)
    pull = Pull(*fixed, *rooms_for_pull(n, m))
    pull.lines[:], pull.bends[:] = found.columns(np.zeros(m)).T, actuators.bends(None)
    return pull
