"""How places of a soft body that is not free answer forces on one another: W of `operators`, as its frame sees it."""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_apart, jit_part
from fenics_rom.mechanics.frame_motion import Rotation
from fenics_rom.runtime.compiled.carried_step import inverse_of_carried
from fenics_rom.runtime.compiled.contact_points import WHOLE, Points, spread_some
from fenics_rom.runtime.compiled.frame_tables import body_at, state_at
from fenics_rom.runtime.compiled.frames import dot, vector
from fenics_rom.world.compiled.couples import Turning, map_of
from fenics_rom.world.compiled.pulled_bodies import hold_back_places, pulled_of
from fenics_rom.world.compiled.soft_bodies import is_pulled, points_at


class Places(NamedTuple):
    """Points of a body, or surfaces as they turn, s of them."""

    nodes: Array  # (s, c)
    weights: Array  # (s, c) of these
    couples: Array  # (s,) which surface; -1: a point
    arms_of_turning: Array  # of these, as of `Joined`


@jit_part
def operator_of(table: Array, places: Places, outward: Rotation, middle: Rotation) -> Array:
    """W (3s, 3s) as the frame sees velocities and forces, m/s/N: outward W middleᵀ in world axes.

    Args:
        table: of the body.
        places: of it.
        outward, middle: how the frame turns velocities and forces; surfaces turn in world axes.
    """
    body, state, points = body_at(table), state_at(table), points_at(table)
    nodes, weights, (s, wide), m = places.nodes, places.weights, places.weights.shape, len(body.ω)
    for i in range(s):
        for a in range(wide):
            if weights[i, a] != 0.0:
                points.pushed[nodes[i, a]] = 1.0
    spread_some(points, inverse_of_carried(body, state))
    rows, spread = np.zeros((3 * s, m)), np.zeros((m, 3 * s))
    for i in range(s):
        for a in range(wide):
            share, at = weights[i, a], 3 * nodes[i, a]
            if share != 0.0 and places.couples[i] < 0:
                for j in range(m):
                    for k in range(3):
                        rows[3 * i + k, j] += share * points.rows[j, at + k]
                        spread[j, 3 * i + k] += share * points.spread[j, at + k]
        if places.couples[i] >= 0:
            _set_rows_of_surface(points, places, outward, middle, i, rows, spread)
    W = np.dot(rows, spread)
    if len(points.R) and (places.couples >= 0).any():
        _add_yielding_of_surfaces(points, places, outward, middle, W)
    elif len(points.R):
        _add_yielding(points, places, W)
    if is_pulled(table):
        _hold_back(table, places, W)
    return W


@jit_apart
def _hold_back(table: Array, places: Places, W: Array) -> None:
    """Takes from W what strokes hold back."""
    hold_back_places(pulled_of(table), places.nodes, places.weights, W)


@jit_apart
def _set_rows_of_surface(
    points: Points, places: Places, outward: Rotation, middle: Rotation, i: int, rows: Array, spread: Array
) -> None:
    """Sets how the basis moves a surface, and is moved by a couple on it."""
    for a in range(places.weights.shape[1]):
        left, right = _map_of(places, i, a, outward), _map_of(places, i, a, middle)
        for j in range(len(spread)):
            for k in range(3):
                rows[3 * i + k, j] += dot(left[k], vector(points.rows[j], 3 * places.nodes[i, a]))
                spread[j, 3 * i + k] += dot(right[k], vector(points.spread[j], 3 * places.nodes[i, a]))


@jit_part
def _map_of(places: Places, i: int, a: int, turn: Rotation) -> Rotation:
    """By what the a-th node of a place moves it."""
    share = places.weights[i, a]
    if places.couples[i] < 0:
        return (share, 0.0, 0.0), (0.0, share, 0.0), (0.0, 0.0, share)
    of = Turning(places.nodes[i], places.weights[i], places.arms_of_turning[places.couples[i]])
    return map_of(of, a, turn)


@jit_part
def _add_yielding(points: Points, places: Places, W: Array) -> None:
    """Adds what points yield beyond the basis."""
    nodes, weights, (s, wide) = places.nodes, places.weights, places.weights.shape
    for i in range(s):
        for j in range(s):
            for a in range(wide):
                for b in range(wide):
                    share = weights[i, a] * weights[j, b] / points.times[WHOLE]
                    if share != 0.0:
                        rows, to = points.R[points.slots[nodes[i, a]]], 3 * nodes[j, b]
                        for k in range(3):
                            for n in range(3):
                                W[3 * i + k, 3 * j + n] += share * rows[k, to + n]


@jit_apart
def _add_yielding_of_surfaces(points: Points, places: Places, outward: Rotation, middle: Rotation, W: Array) -> None:
    """The same where some places are surfaces as they turn."""
    nodes, weights, (s, wide), whole = places.nodes, places.weights, places.weights.shape, points.times[WHOLE]
    for i in range(s):
        for a in range(wide):
            left = _map_of(places, i, a, outward)
            for j in range(s if weights[i, a] != 0.0 else 0):
                rows = points.R[points.slots[nodes[i, a]]]
                for b in range(wide):
                    right, to = _map_of(places, j, b, middle), 3 * nodes[j, b]
                    for n in range(3):
                        x = dot(right[n], vector(rows[0], to)) / whole
                        y = dot(right[n], vector(rows[1], to)) / whole
                        z = dot(right[n], vector(rows[2], to)) / whole
                        for k in range(3):
                            W[3 * i + k, 3 * j + n] += dot(left[k], (x, y, z))
