"""Looks at the skins of the bodies of a batch, one body after the other."""

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.mechanics.frame_motion import world_displacement
from fenics_rom.mechanics.skin import MovedIntruder
from fenics_rom.mechanics.skin_path import CHECK_INTERVAL, QUICK, Instant, Placement, on_the_way, stride_of
from fenics_rom.mechanics.skin_watch import SkinWatch, displaced
from fenics_rom.runtime.skin_looks import arm_of

if TYPE_CHECKING:
    from fenics_rom.mechanics.obstacles import Obstacle

Batch = Any  # fenics_rom.runtime.batch's, which imports this file
BODY_STEPS = 8192  # that are taken for each look in turn, and for each that is due: one takes as long as 1,000 of them,
FEWEST_STEPS = 4  # and these of all bodies, as a look at one takes a twentieth of a step of a thousand
_TURN = math.pi / math.sqrt(2.0)  # the largest turn, rad, by how far apart the quaternions are


class BatchSkin:
    """Looks at the skins of a batch.

    Args:
        batch: whose bodies they are.
        watch: of a skin.
        obstacles: by name.
        are_quick: whether its steps are compiled: then looks in turn, and who moved far, are asked for more rarely, by
            QUICK.

    Attributes:
        depth: (size,) how deep an obstacle was in each body since its last reset, m; 0 where none was seen in it.
    """

    def __init__(self, batch: Batch, watch: SkinWatch, obstacles: "Mapping[str, Obstacle]", are_quick: bool = False):
        self._batch, self._watch, self._obstacles = batch, watch, obstacles
        rarely = QUICK if are_quick else 1
        self._check = rarely * CHECK_INTERVAL
        skin, rom = watch.skin, batch.rom
        self._nodes = skin.nodes[skin.few_rows]
        self._rows = rom.rows_of(self._nodes).reshape(3 * len(self._nodes), -1)
        self.depth = np.zeros(batch.size)
        self._every = max(FEWEST_STEPS, rarely * BODY_STEPS // batch.size)
        blocks = [
            self._rows.dot(model.coordinates).reshape(len(self._nodes), 3, -1) for model in rom.contact_models.values()
        ]
        self._bound = max(float(np.linalg.norm(each, ord=2, axis=(1, 2)).max()) for each in blocks)  # m per length of q
        self._stride = min(stride_of(skin, MovedIntruder(each, np.zeros(3))) for each in obstacles.values())
        self._room = np.full(batch.size, self._stride)  # how far each may move until a look is due, m
        self._since = self._now()  # at the last look at each
        self._is_new = np.ones(batch.size, dtype=bool)  # bodies that were put where they are: nothing was before
        self._are_new = True  # whether any are
        self._arm = 0.0 if rom.moving_frame is None else arm_of(skin, rom.moving_frame.origin)

    def begin(self, bodies: Array) -> None:
        """Bodies (any,) begin anew."""
        self.depth[bodies] = 0.0
        self.forget(bodies)

    def forget(self, bodies: Array) -> None:
        """Bodies (any,) were put elsewhere: what is between does not count."""
        self._is_new[bodies] = self._are_new = True

    def look_in_turn(self) -> None:
        """After a step: at the body whose turn it is, if it is one's, and at those that moved far."""
        if self._are_new:
            self._take_new()
        turn, left = divmod(self._batch.steps, self._every)
        body = turn % self._batch.size
        if not left and not self._batch.frozen[body]:
            self.look(body)
        if not self._batch.steps % self._check:
            most = max(1, CHECK_INTERVAL * self._batch.size // BODY_STEPS)
            for body in self._due()[-most:].tolist():
                self.look(body)

    def depths(self) -> Array:
        """The depth (size,) of all bodies, m, once those that moved far were looked at."""
        for body in self._due().tolist():
            self.look(body)
        return self.depth.copy()

    def look(self, body: int) -> None:
        """At one body, and at where it was since the last look."""
        skin, time = self._watch.skin, float(self._batch.time[body])
        before = None if self._is_new[body] else self._before(body)
        now = self._instant(body)
        self._take(np.array([body]))
        self._room[body] = np.inf
        for who, intruder in now.intruders.items():
            room = skin.room(intruder.distance(now.body.few)[0])
            self._room[body] = min(self._room[body], max(room, stride_of(skin, intruder)))
            for placed, there in on_the_way(skin, who, before, now):
                if skin.may_meet(placed.few, there.distance(placed.few)[0], there):
                    found = skin.intrusions(placed.whole(), there)
                    self.depth[body] = max([self.depth[body], *(each.depth for each in found)])
                    self._watch.note(who, time, found)

    def _now(self, bodies: Array | None = None) -> "_Whereabouts":
        """Of all bodies, or of some (any,)."""
        return _Whereabouts(*self._batch.whereabouts(np.arange(self._batch.size) if bodies is None else bodies))

    def _take(self, bodies: Array) -> None:
        """Keeps where bodies (any,) are."""
        for kept, part in zip(self._since, self._now(bodies), strict=True):
            kept[..., bodies] = part
        self._is_new[bodies] = False

    def _take_new(self) -> None:
        new = self._is_new.nonzero()[0]
        self._take(new)
        self._room[new], self._are_new = self._stride, False

    def _due(self) -> Array:
        """Those of the bodies that moved so far that a look is due, the farthest last."""
        if self._are_new:
            self._take_new()
        now, since = self._now(), self._since
        moved = self._bound * np.sqrt(np.square(now.q - since.q).sum(axis=0))
        moved += self._gone(now.offsets - since.offsets)
        if len(now.poses):
            gone = np.square(now.poses - since.poses)
            moved += np.sqrt(gone[:3].sum(axis=0)) + 2 * self._arm * np.sqrt(gone[3:].sum(axis=0))
        moved[now.mode != since.mode] = np.inf
        moved[self._batch.frozen] = 0.0
        due = (moved > self._room).nonzero()[0]
        return due if len(due) < 2 else due[(moved - self._room)[due].argsort()]

    def _gone(self, changes: Array) -> Array:
        """How far any obstacle of each body went at most, (size,), m, whose rows changed by (O, any, size)."""
        ways = np.sqrt(np.square(changes[:, :3]).sum(axis=1))
        if changes.shape[1] > 3:
            turned = _TURN * np.sqrt(np.square(changes[:, 3:]).sum(axis=1))
            extents = np.array([each.extent for each in self._obstacles.values()])
            ways += np.multiply(extents[:, None], turned, out=np.zeros(turned.shape), where=turned > 0)
        farthest: Array = ways.max(axis=0)
        return farthest

    def _instant(self, body: int) -> Instant:
        """Where a body and its obstacles are."""
        batch, skin = self._batch, self._watch.skin
        few = self._few(batch.shape_coordinates(body), self._now(np.array([body])).poses[:, 0])
        placed = Placement(few, lambda: skin.places(batch.shape(body)))
        return Instant(placed, displaced(self._obstacles, batch.offsets_of(body)))

    def _before(self, body: int) -> Instant:
        """Where they were at the last look, but for what contact points yield by themselves."""
        batch, skin, since = self._batch, self._watch.skin, self._since
        C = list(batch.rom.contact_models.values())[since.mode[body]].coordinates
        shape, pose = C @ since.q[: C.shape[1], body], since.poses[:, body].copy()

        def whole() -> Array:
            return skin.places(self._in_world(batch.rom.nodes, batch.rom.reconstruct(shape), pose))

        placed = Placement(self._few(shape, pose), whole)
        return Instant(placed, displaced(self._obstacles, batch.offsets_of(body, since.offsets)))

    def _few(self, shape: Array, pose: Array) -> Array:
        """Places of the nodes that are looked at first, m, of a body in this shape (k,) and pose (7,)."""
        rest = self._batch.rom.nodes[self._nodes]
        few: Array = rest + self._in_world(rest, (self._rows @ shape).reshape(-1, 3), pose)
        return few

    def _in_world(self, rest: Array, field: Array, pose: Array) -> Array:
        """Displacements (any, 3), of those in the frame."""
        if not len(pose):
            return field
        base = BaseState(pose[:3], pose[3:], np.zeros(3), np.zeros(3))
        return world_displacement(base, self._batch.rom.moving_frame.origin, rest, field)


class _Whereabouts(NamedTuple):
    """Where bodies and their obstacles are."""

    q: Array  # (m, size)
    mode: Array  # (size,) number of the contact mode
    offsets: Array  # of obstacles, (O, 3, size), m, or poses, (O, 7, size), in the axes of contact
    poses: Array  # position and quaternion of the frames (7, size), m; (0, size) where these do not move
