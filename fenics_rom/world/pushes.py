"""What contacts of a step do to the contact points of a soft body."""

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.nodal_contact import Touch
from fenics_rom.world.collision.contacts import Contacts
from fenics_rom.world.meetings import Meeting


class Pushes(NamedTuple):
    """Of k contacts on a body."""

    nodes: Array  # (k, c) contact points that carry each
    weights: Array  # (k, c) of these
    forces: Array  # (k, 3) on the body, in world axes, N
    pressing: Array  # (k,) along their normals, N


def pushes_of(
    number: int, meetings: Sequence[Meeting], contacts: Iterable[tuple[int, Contacts]], forces: Array
) -> Iterator[Pushes]:
    """On a body by its number, from forces on the first of each pair, (C, 3), N, in the order of the contacts."""
    row = 0
    for met, found in contacts:
        meeting, own = meetings[met], forces[row : row + len(found.gaps)]
        row += len(found.gaps)
        pressing = (own * found.normals).sum(axis=1)
        for end, sign, spots in ((meeting.first, 1.0, found.first), (meeting.second, -1.0, found.second)):
            if end == number:
                yield Pushes(spots.nodes, spots.weights, sign * own, pressing)


def touch_of(pushes: Iterable[Pushes], count: int) -> Touch:
    """All of them on the contact points of the body, of which there are so many."""
    forces, pressing = np.zeros((count, 3)), np.zeros(count)
    for each in pushes:
        np.add.at(forces, each.nodes, each.weights[:, :, None] * each.forces[:, None])
        np.add.at(pressing, each.nodes, each.weights * each.pressing[:, None])
    return Touch(forces, pressing)
