"""What contacts of a step do to the contact points of a soft body."""

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.nodal_contact import Touch
from fenics_rom.mechanics.rubbing import PairPlaces, Rubbing, nothing_rubs, rubbing_at
from fenics_rom.world.collision.contacts import Contacts
from fenics_rom.world.contact_step import Found
from fenics_rom.world.meetings import Meeting


class Pushes(NamedTuple):
    """Of k contacts on a body."""

    nodes: Array  # (k, c) contact points that carry each
    weights: Array  # (k, c) of these
    normals: Array  # (k, 3) into the body
    forces: Array  # (k, 3) on it, in world axes, N
    velocities: Array  # (k, 3) relative to what pushes it, in the middle of the step, m/s
    friction: Array  # μ (k,)


def pushes_of(
    number: int, meetings: Sequence[Meeting], contacts: Iterable[tuple[int, Contacts]], found: Found
) -> Iterator[Pushes]:
    """On a body by its number, from what a step found for each pair, in the order of the contacts."""
    row = 0
    for met, of in contacts:
        meeting, own = meetings[met], slice(row, row := row + len(of.gaps))
        n, f, u, μ = of.normals, found.forces[own], found.velocities[own], np.full(len(of.gaps), meeting.law.friction)
        for end, sign, spots in ((meeting.first, 1.0, of.first), (meeting.second, -1.0, of.second)):
            if end == number:
                yield Pushes(spots.nodes, spots.weights, sign * n, sign * f, sign * u, μ)


def touch_of(pushes: Iterable[Pushes], count: int) -> Touch:
    """All of them on the contact points of the body, of which there are so many."""
    forces, pressing = np.zeros((count, 3)), np.zeros(count)
    for each in pushes:
        np.add.at(forces, each.nodes, each.weights[:, :, None] * each.forces[:, None])
        np.add.at(pressing, each.nodes, each.weights * (each.forces * each.normals).sum(axis=1)[:, None])
    return Touch(forces, pressing)


def rubbing_of(pushes: Iterable[Pushes], count: int) -> Rubbing:
    """What friction does there."""
    parts = []
    for nodes, weights, *of_pairs in pushes:
        parts.append(rubbing_at(count, [PairPlaces(nodes, weights, 1.0)], *of_pairs))
    return Rubbing(*(sum(arrays[1:], start=arrays[0]) for arrays in zip(nothing_rubs(count), *parts, strict=True)))
