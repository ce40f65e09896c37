"""How pairs of a body with itself change with where their points are: gaps, normals, and by what points move them.

A pair has a point and the corners of the triangle that it touches, and one that is opposite to another one these of
both. The place on the triangle stays within it, on an edge or at a corner. What is asked for is a derivative along one
coordinate of these points at a time: by a step along i, which leaves it exact to round-off (Squire & Trapp 1998).
In a moving frame places on triangles are those of the start of a step, and their turn is that of its middle.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.complementarity.delassus import operator_between
from fenics_rom.mechanics.own_surface import OwnSurface, corner_maps
from fenics_rom.mechanics.surface_pairs import unit_normals

_STEP = 1e-30  # along i, m
_FLAT = 1e-9  # normals that differ by less are those of the triangle


class Met(NamedTuple):
    """What k points meet of the surface."""

    row: Array  # of the points (k,)
    nodes: Array  # corners of triangles (k, 3)
    weights: Array  # of these (k, 3) in the place that is met
    is_flat: Array  # (k,) whether the normal is the triangle's

    @staticmethod
    def of(row: Array, nodes: Array, weights: Array, normals: Array, places: Array) -> "Met":
        """With normals (k, 3), of points that are at places (P, 3), m."""
        off = np.abs(unit_normals(places[nodes]) - normals).max(axis=1, initial=0.0)
        return Met(row, nodes, weights, (off < _FLAT) | (weights > 0).all(axis=1))

    def take(self, some: Array) -> "Met":
        """Those of some of the points."""
        return Met(*(part[some] for part in self))

    @property
    def points(self) -> Array:
        """The point and the corners (k, 4)."""
        return np.concatenate([self.row[:, None], self.nodes], axis=1)

    def weights_at(self, x: Array) -> Array:
        """Weights (k, 3) where points and corners are at x (k, 4, 3), m."""
        inside, edge = (self.weights > 0).all(axis=1), (self.weights > 0).sum(axis=1) == 2
        p, a = x[:, 0], x[:, 1]
        u, v, w = x[:, 2] - a, x[:, 3] - a, p - a
        uu, uv, vv, uw, vw = _dot(u, u), _dot(u, v), _dot(v, v), _dot(u, w), _dot(v, w)
        area = uu * vv - uv * uv
        second, third = (vv * uw - uv * vw) / area, (uu * vw - uv * uw) / area
        weights = np.where(inside[:, None], np.stack([1 - second - third, second, third], axis=1), self.weights)
        if edge.any():
            at, ends = edge.nonzero()[0], np.argsort(self.weights[edge] == 0, axis=1, kind="stable")[:, :2]
            start, end = (x[at, 1 + ends[:, k]] for k in range(2))
            share = _dot(p[at] - start, end - start) / _dot(end - start, end - start)
            weights[at, ends[:, 0]], weights[at, ends[:, 1]] = 1 - share, share
        return weights

    def seen_at(self, x: Array) -> tuple[Array, Array, Array]:
        """Gaps (k,), normals (k, 3) and weights (k, 3) there, with the sign of gaps as it is."""
        weights = self.weights_at(x)
        off = x[:, 0] - (weights[:, :, None] * x[:, 1:]).sum(axis=1)
        n = np.cross(x[:, 2] - x[:, 1], x[:, 3] - x[:, 1])
        n = n / np.sqrt(_dot(n, n))[:, None]
        above, away = _dot(off, n), np.sqrt(_dot(off, off))
        away = np.where(self.is_flat, 1.0, np.where(above.real < 0, -away, away))
        return np.where(self.is_flat, above, away), np.where(self.is_flat[:, None], n, off / away[:, None]), weights


class OwnPairs(NamedTuple):
    """Pairs of a body with itself, (k,), in a step."""

    met: Met
    twins: Met  # of the pairs that are opposite to another one, what that meets
    twinned: Array  # which these are (t,)
    places: Array  # of all points of the body (P, 3), m
    there: Array  # points and corners (k, 4, 3) in the middle of the step, m
    maps_by_middle: Array  # what maps of corners (k, 3, 3, 3) change by with these, (k, 3, 3, 3, 4, 3)

    @staticmethod
    def of(surface: OwnSurface, some: Array, places: Array, middle: Array | None) -> "OwnPairs":
        """Some (k,) of those that a surface found last, where points are at places (P, 3), m.

        `middle`: of them in the middle of the step, as of `PointMotion`.
        """
        found, plain, twin, kept = surface.last
        pairs = kept[some]
        twinned = (twin[pairs] >= 0).nonzero()[0]
        met, twins = (
            Met.of(found.row[at], found.nodes[at], found.weights[at], plain[at], places)
            for at in (pairs, twin[pairs[twinned]])
        )
        there = (places if middle is None else middle)[met.points]
        x, slopes = there.astype(complex), np.empty((len(there), 3, 3, 3, 4, 3))
        for corner in range(4):
            for axis in range(3):
                x[:, corner, axis] += 1j * _STEP
                slopes[..., corner, axis] = corner_maps(x[:, 0], x[:, 1:], met.weights).imag / _STEP
                x[:, corner, axis] -= 1j * _STEP
        return OwnPairs(met, twins, twinned, places, there, slopes)

    def pull_back(self, gap_: Array, normal_: Array, maps_: Array) -> Array:
        """What is owed to places of all points (P, 3), m, when the step begins.

        By gaps (k,), normals (k, 3) and, as the places that are met move, maps of corners (k, 3, 3, 3).
        """
        own, there = self.met.points, self.there
        x, owed = self.places[own].astype(complex), np.zeros(self.places.shape)
        twin, all_twins = self.twins.points, self.places[self.twins.points].astype(complex)
        (_, plain, _), (_, others, _) = self.met.seen_at(x), self.twins.seen_at(all_twins)
        for corner in range(4):
            for axis in range(3):
                x[:, corner, axis] += 1j * _STEP
                gaps, normals, weights = self.met.seen_at(x)
                maps = corner_maps(there[:, 0], there[:, 1:], weights)
                slopes = gap_ * gaps.imag + np.einsum("kcij,kcij->k", maps_, maps.imag)
                slopes += _dot(normal_, self._merged(normals, others).imag)
                np.add.at(owed[:, axis], own[:, corner], slopes / _STEP)
                x[:, corner, axis] -= 1j * _STEP
                if len(twin):
                    moved = all_twins.copy()
                    moved[:, corner, axis] += 1j * _STEP
                    slopes = _dot(normal_, self._merged(plain, self.twins.seen_at(moved)[1]).imag)[self.twinned]
                    np.add.at(owed[:, axis], twin[:, corner], slopes / _STEP)
        return owed

    def _merged(self, normals: Array, others: Array) -> Array:
        """Normals (k, 3), of those that are opposite to another one in the mean with its own (t, 3)."""
        normals = normals.copy()
        both = normals[self.twinned] - others
        normals[self.twinned] = both / np.sqrt(_dot(both, both))[:, None]
        return normals


def _dot(a: Array, b: Array) -> Array:
    return np.einsum("ki,ki->k", a, b)


class PairRows(NamedTuple):
    """How C pairs move with points of the body, of which some are pairs with itself."""

    nodes: Array  # (C, 4)
    maps: Array  # (C, 4, 3, 3)
    own: OwnPairs
    within: Array  # (k,) which pairs these are
    obstacles: int  # how many come before the body itself

    def of_pairs(self, values: Array) -> Array:
        """Of values of the points (P, 3), those of pairs, (C, 3)."""
        return np.einsum("cnij,cnj->ci", self.maps, values[self.nodes])

    def at_points(self, values: Array) -> Array:
        """Of values of pairs (C, 3), what comes of them at the points, (P, 3)."""
        together = np.zeros(self.own.places.shape)
        np.add.at(together, self.nodes, np.einsum("cnij,ci->cnj", self.maps, values))
        return together

    def operator(self, W: Array) -> Array:
        """Of one of the points (3P, 3P), that of pairs (3C, 3C)."""
        return operator_between(W, self.nodes, self.maps)

    @property
    def matrix(self) -> Array:
        """The same as one (3C, 3P)."""
        of_pairs = np.zeros((len(self.nodes), 3, len(self.own.places), 3))
        for k in range(4):
            np.add.at(of_pairs.transpose(0, 2, 1, 3), (np.arange(len(of_pairs)), self.nodes[:, k]), self.maps[:, k])
        return of_pairs.reshape(3 * len(of_pairs), -1)

    def by_middle(self, values: Array) -> Array:
        """What `of_pairs` of values changes by with where points are in the middle of the step, (3C, 3P)."""
        slopes = np.zeros((len(self.nodes), 3, *self.own.places.shape))
        moved = -np.einsum("kcijna,kcj->kina", self.own.maps_by_middle, values[self.nodes[self.within, 1:]])
        for n in range(4):
            at = self.within[:, None], np.arange(3), self.own.met.points[:, n, None]
            np.add.at(slopes, at, moved[:, :, n])
        return slopes.reshape(3 * len(self.nodes), -1)

    def at_points_by_middle(self, values: Array) -> Array:
        """What `at_points` of values changes by with where points are in the middle of the step, (3P, 3P)."""
        P = len(self.own.places)
        slopes, met = np.zeros((P, P, 3, 3)), self.own.met
        moved = -np.einsum("kcijna,ki->kcnja", self.own.maps_by_middle, values[self.within])
        np.add.at(slopes, (met.nodes[:, :, None], met.points[:, None, :]), moved)
        return slopes.transpose(0, 2, 1, 3).reshape(3 * P, 3 * P)

    def pull_back(self, gap_: Array, normal_: Array, products: list[tuple[Array, Array]]) -> tuple[Array, Array]:
        """What is owed to places of the points at the start and in the middle of the step (P, 3).

        By gaps (C,), normals (C, 3), and by maps: to these it is the sum of products of numbers of pairs (C, 3) and of
        points (P, 3).
        """
        own, nodes = self.own, self.nodes[self.within, 1:]
        maps_ = -np.asarray(sum(np.einsum("ci,cnj->cnij", of[self.within], at[nodes]) for of, at in products))
        middle_ = np.zeros(own.places.shape)
        np.add.at(middle_, own.met.points, np.einsum("kcij,kcijna->kna", maps_, own.maps_by_middle))
        return own.pull_back(gap_[self.within], normal_[self.within], maps_), middle_
