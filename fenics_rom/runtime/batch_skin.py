"""Looks at the skins of the bodies of a batch, one body after the other."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.skin_watch import SkinWatch, displaced

if TYPE_CHECKING:
    from fenics_rom.mechanics.obstacles import Obstacle
    from fenics_rom.runtime.batch_contact import BatchContact

Batch = Any  # fenics_rom.runtime.batch's, which imports this file
BODY_STEPS = 512  # that are taken for each look, so that it costs next to nothing; no more than one body a step


class BatchSkin:
    """Looks at the skins of a batch.

    Args:
        batch: whose bodies they are.
        contacts: of the batch.
        watch: of a skin.
        obstacles: by name.

    Attributes:
        depth: (size,) how deep an obstacle was in each body since its last reset, m; 0 where none was seen in it.
    """

    def __init__(self, batch: Batch, contacts: "BatchContact", watch: SkinWatch, obstacles: "Mapping[str, Obstacle]"):
        self._batch, self._contacts, self._watch, self._obstacles = batch, contacts, watch, obstacles
        skin = watch.skin
        self._nodes = skin.nodes[skin.few_rows]
        self._rows = batch.rom.rows_of(self._nodes).reshape(3 * len(self._nodes), -1)
        self.depth = np.zeros(batch.size)
        self._every = max(1, BODY_STEPS // batch.size)

    def begin(self, bodies: Array) -> None:
        """Bodies (any,) begin anew."""
        self.depth[bodies] = 0.0

    def look_in_turn(self) -> None:
        """After a step: at the body whose turn it is, if it is one's."""
        turn, left = divmod(self._batch.steps, self._every)
        body = turn % self._batch.size
        if not left and not self._batch.frozen[body]:
            self.look(body)

    def look(self, body: int) -> None:
        """At one body."""
        batch, skin = self._batch, self._watch.skin
        there = displaced(self._obstacles, self._contacts.offsets_of(body))
        few = batch.rom.nodes[self._nodes] + (self._rows @ batch.shape_coordinates(body)).reshape(-1, 3)
        near = {who: each for who, each in there.items() if skin.may_meet(few, each.distance(few)[0], each)}
        if not near:
            return
        places, time = skin.places(batch.shape(body)), float(batch.time[body])
        for who, intruder in near.items():
            found = skin.intrusions(places, intruder)
            self.depth[body] = max([self.depth[body], *(each.depth for each in found)])
            self._watch.note(who, time, found)
