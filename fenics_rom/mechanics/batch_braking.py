"""What friction stops of many bodies at once: the law of `braking`, with arrays that hold bodies along their last axis.

Bodies that are asked for a share have it in arrays of all bodies of the step, which are made for the first of them.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.body_axis import put, taken
from fenics_rom.mechanics.braking import AIMED, LEAST_SHARE, NEARLY_NONE, SWINGS, swung_with
from fenics_rom.mechanics.complementarity.normals import along, subtract_along
from fenics_rom.mechanics.complementarity.problems import Problems

MOST_LOOKS = 12  # at shares between 0 and 1, whose slopes are told from the last two
HELPING = 1e-9  # of that of velocities to be stopped: work of friction on a body that is looked at; less is let pass


class _Look(NamedTuple):
    """What friction does on S bodies."""

    friction: Array  # (3, P, S), N
    slip: Array  # u_t (3, P, S), m/s
    targets: Array  # c_t (3, P, S), m/s
    power: Array  # (S,), W
    negligible: Array  # (S,) power that is none, W
    among: Array  # (S,) how many points take part


class BatchBraking:
    """What sticks is asked for in one step.

    Args:
        swung: (P, B) in how many steps in a row, before this one, points were not stopped.
        targets: c_t (3, P, B) that are asked for at first, m/s.
    """

    def __init__(self, swung: Array, targets: Array):
        self._swung, self._targets = swung, targets
        self._helped: Array | None = None  # (P, B) points that are not stopped in this one
        self._shares: _Shares | None = None

    @property
    def swung(self) -> Array | None:
        """The same with this step (P, B); None: in none."""
        return None if self._helped is None else swung_with(self._helped, self._swung)

    def ask_anew(self, bodies: Array, problems: Problems, targets: Array, which: Array) -> None:
        """Forgets what was decided of some (S,) of the bodies (T,), as more pairs take part; see `asks_less`.

        The power of friction is that of all of them.
        """
        if self._helped is None:
            return
        which = which[taken(self._helped, bodies[which]).any(axis=0)]
        if not len(which):
            return
        own = bodies[which]
        first = taken(self._targets, own)
        put(problems.q, which, taken(problems.q, which) + taken(targets, which) - first)
        put(targets, which, first)
        put(self._helped, own, np.zeros((len(self._helped), len(own)), bool))
        if self._shares is not None:
            self._shares.forget(own)

    def asks_less(
        self, bodies: Array, problems: Problems, targets: Array, forces: Array, u: Array, settled: Array
    ) -> Array:
        """Bodies (T,) that are asked for something else than before, as friction helps, or may stop more.

        Args:
            bodies: (T,) which of all they are.
            problems: theirs, of which q is changed.
            targets: c_t (3, P, T), m/s; changed.
            forces, u: (3, P, T), N, and m/s less the targets.
            settled: (T,) those that are asked.
        """
        again = np.zeros(len(bodies), bool)
        negligible = HELPING * np.abs(np.einsum("apb,apb->b", forces, problems.q))
        suspected = np.einsum("apb,apb->b", forces, targets) > negligible
        if self._shares is not None:
            suspected |= self._shares.swinging[bodies]
        suspects = (suspected & settled).nonzero()[0]
        if not len(suspects):
            return again
        normals = None if problems.normals is None else taken(problems.normals, suspects)
        friction, slip, c = (taken(part, suspects) for part in (forces, u, targets))
        subtract_along(friction, along(friction, normals), normals)
        work = np.einsum("apb,apb->pb", friction, slip + c)
        power, among, negligible = work.sum(axis=0), bodies[suspects], negligible[suspects]
        share = np.ones(len(among)) if self._shares is None else self._shares.share[among]
        helps = (work > negligible) & c.any(axis=0) & (power > negligible) & ((share == 0) | (share == 1))
        change = -c * helps
        taken_out = helps.any(axis=0)
        if taken_out.any():
            if self._helped is None:
                self._helped, self._targets = np.zeros(self._swung.shape, bool), self._targets.copy()
            put(self._helped, among, taken(self._helped, among) | helps)
        swings = helps & (taken(self._swung, among) >= SWINGS)
        if self._shares is None and swings.any():
            self._shares = _Shares(*self._swung.shape)
        changed = taken_out
        if self._shares is not None:
            look = _Look(friction, slip, c, power, negligible, taken(problems.due, suspects).sum(axis=0))
            self._shares.take_out(among, taken_out, -change * swings, look)
            change += self._shares.change(among, taken_out, look)
            changed = change.any(axis=(0, 1))
        again[suspects] = changed
        put(problems.q, suspects, taken(problems.q, suspects) - change)
        put(targets, suspects, c + change)
        return again


class _Shares:
    """Of B bodies with P points.

    Attributes:
        share: σ (B,).
        swinging: (B,) whether a body is asked for one.
    """

    def __init__(self, points: int, bodies: int):
        self.share, self.swinging = np.ones(bodies), np.zeros(bodies, bool)
        self._below, self._above, self._left = np.zeros(bodies), np.ones(bodies), np.full(bodies, MOST_LOOKS)
        self._last, self._count = np.full(bodies, np.nan), np.zeros(bodies)
        self._knows, self._slopes = np.zeros(bodies, bool), np.zeros((2, 3, points, bodies))
        self._looked, self._whole = np.zeros((2, 3, points, bodies)), np.zeros((3, points, bodies))

    def forget(self, bodies: Array) -> None:
        """Begins anew with bodies (S,)."""
        self.share[bodies], self.swinging[bodies], self._knows[bodies] = 1.0, False, False
        self._below[bodies], self._above[bodies], self._left[bodies] = 0.0, 1.0, MOST_LOOKS
        self._last[bodies], self._count[bodies] = np.nan, 0.0
        put(self._whole, bodies, np.zeros((*self._whole.shape[:2], len(bodies))))

    def take_out(self, bodies: Array, are_taken: Array, whole: Array, look: _Look) -> None:
        """Points of bodies (S,) are asked for nothing; `whole` (3, P, S) is what those that swing were asked for."""
        self.swinging[bodies] |= whole.any(axis=(0, 1))
        put(self._whole, bodies, taken(self._whole, bodies) + whole)
        first = (are_taken & (self.share[bodies] == 1)).nonzero()[0]
        if len(first):
            self._note(bodies[first], 1.0, look, first)
        self.share[bodies[are_taken]] = 0.0

    def _note(self, bodies: Array, share: "float | Array", look: _Look, which: Array) -> None:
        self._last[bodies], self._count[bodies] = share, look.among[which]
        put(self._looked, bodies, np.stack([look.friction, look.slip]).take(which, axis=-1))

    def change(self, bodies: Array, are_taken: Array, look: _Look) -> Array:
        """What targets (3, P, S) are to change by so that friction does no work, where no points are taken out."""
        goes = self.swinging[bodies] & ~are_taken
        change, which = np.zeros(look.targets.shape), goes.nonzero()[0]
        if len(which):
            own = bodies[which]
            before = self.share[own]
            part = _Look(*(part.take(which, axis=-1) for part in look))
            self.share[own] = self._next(own, part)
            change[..., which] = (self.share[own] - before) * taken(self._whole, own)
        return change

    def _next(self, bodies: Array, look: _Look) -> Array:
        """The shares (S,) that are to be looked at next; see `Braking`."""
        share, last, whole = self.share[bodies], self._last[bodies], taken(self._whole, bodies)
        friction, slip, targets, power, negligible, count = look
        others = self._count[bodies] != count
        begins = others & (share > 0) & ~np.isnan(last)
        last[others] = np.nan
        self._below[bodies[others]], self._above[bodies[others]], self._knows[bodies[others]] = 0.0, 1.0, False
        helps = power > negligible
        self._above[bodies[helps]], self._below[bodies[~helps]] = share[helps], share[~helps]
        below, above = self._below[bodies], self._above[bodies]
        enough = np.maximum(negligible, NEARLY_NONE * np.abs(friction * whole).sum(axis=(0, 1)))
        is_over = self._left[bodies] == 0
        stays = ~helps & (is_over | ((share > 0) & (power >= -enough)))
        self._left[bodies[~(stays | is_over | begins)]] -= 1
        with np.errstate(all="ignore"):
            far = np.abs(last - share) > LEAST_SHARE
            before, now = taken(self._looked, bodies), np.stack([friction, slip])
            learnt = (far & ~begins).nonzero()[0]
            if len(learnt):
                put(self._slopes, bodies[learnt], ((now - before) / (share - last))[..., learnt])
                self._knows[bodies[learnt]] = True
            of_friction, of_slip = taken(self._slopes, bodies) * self._knows[bodies]
            by_share = of_slip + whole
            a = np.einsum("apb,apb->b", of_friction, by_share)
            b = np.einsum("apb,apb->b", friction, by_share)
            b += np.einsum("apb,apb->b", of_friction, slip + targets)
            beyond = power + np.minimum(enough / 2, AIMED * negligible)
            root = np.sqrt(b * b - 4 * a * beyond)
            step = np.where(b > 0, -2 * beyond / (b + root), (root - b) / (2 * a))
            found = share + step
        fits = (found > below + LEAST_SHARE) & (found < above)
        none = (share == 0) & (power >= -negligible) & (b >= 0)
        following = np.where(fits, found, np.where(none, 0.0, (below + above) / 2))
        following = np.where(is_over, np.where(below < share, below, 0.0), following)
        following = np.where(stays, share, np.where(begins, 0.0, following))
        self._note(bodies, np.where(begins, np.nan, share), look, np.arange(len(bodies)))
        return following
