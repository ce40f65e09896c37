"""What guides sweeps where joints are rows: those that are held are eliminated, and go with their directions."""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.world.guide import REDUNDANT, Guide
from fenics_rom.world.joint_rows import JointRows, scaled_pinv
from fenics_rom.world.tolerances import PROXIMAL


class RowGuide(Guide):
    """As a Guide; `rows`: the joints."""

    def __init__(self, W: Array, yields: Array, rows: JointRows, proximal: float = PROXIMAL):
        self.rows = rows
        super().__init__(W, yields, proximal)

    def _eliminate(self) -> None:
        W, C, rows = self.W, self._C, self.rows
        self._of = rows.held.nonzero()[0]
        self._D, self._joined = rows.D[self._of], np.zeros((len(self._of), len(self._of)))
        for island in rows.islands:
            some = np.flatnonzero(np.isin(self._of, island.rows))
            D = self._D[np.ix_(some, island.columns)]
            own = D.dot(W[C:, C:][np.ix_(island.columns, island.columns)]).dot(D.T)
            own += np.diag(rows.compliance[self._of[some]])
            self._joined[np.ix_(some, some)] = scaled_pinv(own, REDUNDANT)
        self._across = W[:C, C:].dot(self._D.T)
        self._spread = self._joined.dot(self._D.dot(W[C:, :C]))
        self._contacts = W[:C, :C] - self._across.dot(self._spread)

    def begin_like(self, known: Guide) -> None:
        """As in Guide, but that the law is that of other pieces, maybe."""

    def turn(self) -> None:
        """Goes on with the directions of now."""
        self._eliminate()
        self._kept.clear()

    def without_contact(self, u: Array) -> tuple[Array, Array]:
        """As in Guide: forces (m,) of rows that are held."""
        C, rows = self._C, self.rows
        moving = u.ravel() + self.W[:, C:].dot(rows.forces(rows.known).ravel())
        z = rows.known.copy()
        z[self._of] = self._joined.dot(rows.speed[self._of] - self._D.dot(moving[C:]))
        return z, (moving[:C] + self._across.dot(z[self._of])).reshape(-1, 3)

    def joined(self, z: Array, f: Array) -> Array:
        """As in Guide."""
        return np.concatenate([f, self.rows.forces(self._with(z, f))])

    def _with(self, z: Array, f: Array) -> Array:
        whole = z.copy()
        whole[self._of] -= self._spread.dot(f.ravel())
        return whole

    def fits(self, free: Array, forces: Array, z: Array) -> bool:
        """As in Guide."""
        C = self._C
        u = free.ravel()[C:] + self.W[C:].dot(forces.ravel())
        if self.rows.settle(u.reshape(-1, 3), self._with(z, forces[: C // 3])):
            return True
        self.turn()
        return False
