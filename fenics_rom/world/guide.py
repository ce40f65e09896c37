"""What guides the sweeps of a step: how pairs answer forces, with those of joints eliminated."""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.complementarity import Delassus, FramedDelassus, Frames, KeptLaw, response, solve
from fenics_rom.world.tolerances import PROXIMAL

MOST_SETS = 2  # of pairs, of which the law is kept as it was linearised: some take part in every step, but not at once
REDUNDANT = 1e-9  # of the largest singular value: what joints hold twice
_ONES = np.ones(3)  # to sum components by a product: a third of the time


class _Kept(NamedTuple):
    """Of a set of pairs that were active."""

    pairs: bytes  # which
    rows: Array  # theirs in W
    μ: float  # the largest friction
    share: Array | None  # of it that each of them has; None where they all have the same
    frames: Frames
    framed: FramedDelassus
    is_right: bool  # whether that is still the operator, but for frames
    laws: dict[int, KeptLaw | None]  # as it was linearised, by `_Asked.rounds`


class Guide:
    """W of pairs, by which sweeps are guided, and what is kept with it.

    Args:
        W: (3 (C + J), 3 (C + J)), symmetric but for what a step turns bodies by, and positive semidefinite.
        yields: of each of the C contacts whether a point of it yields by itself, so that W tells its forces apart.
        proximal: compliance that is added where it does not, in parts of each pair's own.

    Attributes:
        is_right: whether bodies lie as they did when W was found.
        soft, of_soft: the operators of bodies that yield, and their part of W.
    """

    def __init__(self, W: Array, yields: Array, proximal: float = PROXIMAL):
        self.W, self._C = W, 3 * len(yields)
        C = self._C
        if not yields.all():
            own = W.diagonal().reshape(-1, 3).mean(axis=1)
            added = np.maximum(own, 1e-12 * own.max(initial=0.0))[: len(yields)] * ~yields
            W.ravel()[: C * (len(W) + 1) : len(W) + 1] += proximal * np.repeat(added, 3)
        self.yields, self.is_right = yields, True
        self.soft, self.of_soft = list[Array](), np.empty((0, 0))
        self._kept = dict[bytes, _Kept]()  # of the last sets of pairs
        self._contacts = W
        if len(W) > C:
            self._eliminate()

    def _eliminate(self) -> None:
        """Has joints hold, whatever contacts do."""
        W, C = self.W, self._C
        self._joined = np.linalg.pinv(W[C:, C:], rcond=REDUNDANT)  # they may hold more than there is
        self._spread = self._joined.dot(W[C:, :C])  # forces of joints per force of contact, with the other sign
        self._contacts = W[:C, :C] - W[:C, C:].dot(self._spread)

    def fits(self, free: Array, forces: Array, z: Array) -> bool:
        """Whether drives are on the pieces of their laws where the forces of all pairs lead; else goes to others.

        Args:
            free: velocities (C + J, 3) without forces.
            forces, z: of `joined`, which gave these.
        """
        return True

    def begin_like(self, known: "Guide") -> None:
        """Begins with the law as another guide of the same pairs has linearised it."""
        self._kept = {pairs: kept._replace(is_right=False) for pairs, kept in known._kept.items()}

    def without_contact(self, u: Array) -> tuple[Array, Array]:
        """Forces (J, 3) that hold joints where contacts have none, and the velocities (C, 3) of contacts then."""
        C = self._C
        if len(self.W) == C:
            return u[:0], u
        u = u.reshape(-1)
        z = -self._joined.dot(u[C:])
        return z.reshape(-1, 3), (u[:C] + self.W[:C, C:].dot(z)).reshape(-1, 3)

    def joined(self, z: Array, f: Array) -> Array:
        """Forces of all pairs from those of contact (C, 3) and those of joints without (J, 3)."""
        return f if len(self.W) == self._C else np.concatenate([f, z - self._spread.dot(f.ravel()).reshape(-1, 3)])

    def moved(self, f: Array) -> Array:
        """Velocities of contacts (C, 3) per forces there, where joints hold."""
        moved: Array = self._contacts.dot(f.ravel()).reshape(-1, 3)
        return moved

    def solve(
        self, active: Array, q: Array, normals: Array, friction: Array, start: Array, rounds: int
    ) -> tuple[Array, Array]:
        """Forces (a, 3) of active contacts, and u - targets, from velocities less targets q (a, 3), in a round."""
        kept = self._kept_for(active, normals, friction)
        self._kept.pop(kept.pairs, None)
        self._kept[kept.pairs] = kept
        if len(self._kept) > MOST_SETS:
            del self._kept[next(iter(self._kept))]
        _, rows, μ, share, frames, framed, _, laws = kept
        q_in, f_in = frames.turned(q, start)
        if not (q_in if μ else q_in[0]).any():
            return np.zeros_like(q), q  # nothing to stop
        if share is not None:  # pairs with less friction: as if they all had μ
            q_in[1:] *= share
            f_in[1:] /= np.maximum(share, 1e-300)
            f_in[1:, share == 0] = 0.0
        solution = solve(framed, q_in, μ, f_in, laws.get(rounds))
        laws[rounds] = solution.kept
        f, u = solution.forces, solution.velocities
        if share is not None:
            f[1:] *= share
            moved = self._operator_of(rows).dot(frames.in_space(f).ravel()).reshape(-1, 3)
            return frames.in_space(f), moved + q
        return frames.in_space(f), frames.in_space(u)

    def response(
        self, active: Array, normals: Array, friction: Array, f: Array, u: Array, change: Array
    ) -> tuple[Array, Array]:
        """What forces of active contacts and u change by with targets (3, a), along tangents; see `Braking`."""
        _, rows, μ, share, frames, framed, *_ = self._kept_for(active, normals, friction)
        (f_in, *rates), scale = frames.turned(f, u, -change.T), np.ones((3, len(active)))
        scale[1:] = 1.0 if share is None else np.maximum(share, 1e-300)
        by_forces = response(framed, μ, f_in / scale, *(scale * rate for rate in rates))
        by_forces = frames.in_space(scale * by_forces)
        moved = self._operator_of(rows).dot(by_forces.ravel()).reshape(-1, 3) - change.T
        across = [part - (normals * part).dot(_ONES)[:, None] * normals for part in (by_forces, moved)]
        return across[0].T, across[1].T

    def _kept_for(self, active: Array, normals: Array, friction: Array) -> _Kept:
        """What is kept, of these contacts; of others nothing is."""
        pairs = active.tobytes()
        kept = self._kept.get(pairs)
        if kept is not None:
            frames = kept.frames if kept.frames.are(normals) else Frames(normals)
            if kept.is_right and frames is kept.frames:
                return kept
            if kept.is_right and kept.share is None:
                operator = kept.framed.operator
            else:
                operator = Delassus(_scaled(self._operator_of(kept.rows), normals, kept.share))
            framed = operator.framed(frames, known=kept.framed)
            return kept._replace(frames=frames, framed=framed, is_right=True)
        rows, μ, share = (3 * active[:, None] + np.arange(3)).ravel(), float(friction.max()), None
        if μ and (friction != μ).any():
            share = friction / μ
        frames = Frames(normals)
        framed = Delassus(_scaled(self._operator_of(rows), normals, share)).framed(frames)
        return _Kept(pairs, rows, μ, share, frames, framed, True, {})

    def _operator_of(self, rows: Array) -> Array:
        return self._contacts.take(rows, axis=0).take(rows, axis=1) if len(rows) < self._C else self._contacts


def _scaled(W: Array, normals: Array, share: Array | None) -> Array:
    """D W D with D = 1 along normals and a share across: |f_t| <= share μ λ is |f_t'| <= μ λ for f = D f'."""
    if share is None:
        return W
    D = share[:, None, None] * np.eye(3) + (1 - share)[:, None, None] * normals[:, :, None] * normals[:, None, :]
    k = len(share)
    for _ in range(2):
        W = np.matmul(D, W.T.reshape(k, 3, 3 * k)).reshape(3 * k, 3 * k)
    return W
