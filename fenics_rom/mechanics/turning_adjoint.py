"""How what the contact law looks at beside obstacles that turn changes with where points are; see `contact_look`.

With the way h y = Δp + (ΔR - 1)(x - p) of an obstacle's material, G = (ΔR - 1)/h, and curvatures H₀ and H₁ of distances
g₀ and g₁ at the start and at the end, whose normals are n₀ and n₁,

    w = y + s n,  n = n₁,  s = (g₀ - g₁)/h - n·y,    δw = G δx + ((n₀ - n)/h·δx - n·G δx - y·δn) n + s δn,  δn = H₁ δx,

and where the obstacle passes the point w = y, n = ΔR n₀ and δn = ΔR H₀ δx. A pair that pushed before is told how fast
its point nears the material, r = v - v̄ - ω̄ × (x - p): along n₀, and across n.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.contact import ObstacleMotion
from fenics_rom.mechanics.contact_look import SAME_SIDE, Look
from fenics_rom.mechanics.frame_motion import rotation_matrices
from fenics_rom.mechanics.obstacle_poses import curvature_from, distance_from, mean_twists, rotations_between
from fenics_rom.mechanics.obstacles import Obstacle

_ONES = np.ones(3)


class TurningPairs(NamedTuple):
    """C pairs of a point and an obstacle, of which some turn."""

    curvature: Array  # of the normals, (C, 3, 3), 1/m
    first: Array  # n₀ (C, 3)
    first_curvature: Array  # H₀ (C, 3, 3), 1/m
    by_place: Array  # G (C, 3, 3), 1/s
    way: Array  # y (C, 3), m/s, this and the next two 0 where an obstacle passes its point
    along: Array  # s (C,), m/s
    closing: Array  # (n₀ - n)/h - Gᵀn (C, 3), 1/s
    has_pushed: Array  # (C,)
    spin: Array  # ω̄ (C, 3), rad/s
    nearing: Array  # r (C, 3), m/s

    @staticmethod
    def of(
        obstacles: Sequence[Obstacle],
        motion: ObstacleMotion,
        look: Look,
        pairs: tuple[Array, Array, Array],
        places: Array,
        velocities: Array,
        dt: float,
    ) -> "TurningPairs":
        """Of a step of dt, s.

        Args:
            obstacles: their shapes.
            motion: how they move.
            look: what the law saw of all pairs.
            pairs: which of all pairs took part, their obstacles, and whether they pushed before, (C,) each.
            places, velocities: of their points when the step begins, (C, 3), m and m/s.
            dt: s.
        """
        (active, owner, has_pushed), seen = pairs, look.turning
        assert seen is not None
        ΔR = rotation_matrices(rotations_between(motion.start, motion.end))[owner]
        first, normals = seen.first[active], look.normals[active]
        arms = places - motion.start[owner, :3]
        way = ((motion.end - motion.start)[owner, :3] + (ΔR @ arms[:, :, None])[:, :, 0] - arms) / dt
        at_start, curvature = np.zeros((2, len(active), 3, 3))
        passes = np.zeros(len(active), dtype=bool)
        for number, shape in enumerate(obstacles):
            of_this = (owner == number).nonzero()[0]
            if len(of_this):
                there = places[of_this]
                at_start[of_this] = curvature_from(shape, there, motion.start[number])
                curvature[of_this] = curvature_from(shape, there, motion.end[number])
                last = distance_from(shape, there, motion.end[number])[1]
                turned = (ΔR[of_this] @ first[of_this][:, :, None])[:, :, 0]
                is_turned = np.abs(turned - normals[of_this]).max(axis=1) < np.abs(last - normals[of_this]).max(axis=1)
                passes[of_this] = is_turned & ((turned * last).dot(_ONES) < SAME_SIDE)
        by_place = (ΔR - np.eye(3)) / dt
        closing = (first - normals) / dt - np.einsum("cij,ci->cj", by_place, normals)
        along = ((look.w[active] - way) * normals).dot(_ONES)
        curvature[passes] = (ΔR @ at_start)[passes]
        for part in (way, along, closing):
            part[passes] = 0.0
        twists = (mean_twists(motion.start, motion.end, dt) + motion.velocities_before) / 2
        of_way = by_place, way, along, closing
        return TurningPairs(
            curvature, first, at_start, *of_way, has_pushed, twists[owner, 3:], velocities - seen.now[active]
        )

    def told_along(self, normals: Array) -> Array:
        """Along what the approach of pairs is told, (C, 3), of which these are the normals."""
        return np.where(self.has_pushed[:, None], self.first, normals)

    def pull_back(self, told: "Owed", by_velocity: Array, n: Array) -> "Owed":
        """What is owed in all.

        Args:
            told: of the gaps alone, and by velocities at the start as if obstacles rested.
            by_velocity: owed to velocities in the middle of the step (C, 3).
            n: normals (C, 3).
        """
        pressed, has = (told.start * n).dot(_ONES)[:, None], self.has_pushed[:, None]
        across, told_along = told.start - pressed * n, self.told_along(n)
        velocity = pressed * told_along + across
        at_start = np.cross(self.spin, velocity)
        at_start += (self.first_curvature @ (pressed * self.nearing)[:, :, None])[:, :, 0]
        w_ = -by_velocity - np.where(has, 0.0, told.start)
        by_normal = (w_ * n).dot(_ONES)[:, None]
        place = told.place + np.where(has, at_start, 0.0) + by_normal * self.closing
        place += np.einsum("cij,ci->cj", self.by_place, w_)
        rotated, relative = np.where(has, across, told.rotated), np.where(has, self.nearing, told.relative)
        return Owed(place, self.along[:, None] * w_ - by_normal * self.way, velocity, rotated, relative)


class Owed(NamedTuple):
    """What is owed by contact of C pairs, (C, 3) each."""

    place: Array  # to where points are
    normal: Array | float  # to normals, but for what turns with frames
    start: Array  # to velocities at the start
    rotated: Array  # that of it which turns with frames,
    relative: Array  # and velocities of which that is
