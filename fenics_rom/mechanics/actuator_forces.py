"""Forces of actuators that are found in a step: by their stroke, and by the friction of cables at their guides.

The stroke s = Bᵀx is what the force z of an actuator does work along: by how much a tendon is shorter than at rest, m,
or a chamber larger, m³. A step with the mid-step velocity v̂ = free + A⁻¹ B z moves it at the rate Bᵀv̂ = Bᵀfree + W z,
W = Bᵀ A⁻¹ B. Where it is given, the forces are those for which that is

    c = 2/3 (s⁺ - s)/h + 1/3 Bᵀv,        without inertia c = (s⁺ - s)/h,

and they do the work h zᵀ Bᵀv̂ in the step, force times change of stroke, which is booked as supplied. With the whole of
(s⁺ - s)/h the stroke would be met in every step, but a change of speed would ring on for ever, as v⁺ = 2 v̂ - v. So a
constant speed is met to round-off, and what is missed when it changes falls to a third in two steps. A cable only
pulls, 0 <= z ⟂ Bᵀv̂ - c >= 0: it is slack where it is shorter than it has to be. The stroke of a bar is 0 at rest and
stays so, which has no speed to change: it gets c = (s⁺ - s)/h.

At a guide round which a cable turns by the angle α, the tension of the side that it slides from is e^(-μα) times that
of the side that it slides to, and where it sticks it is between (Euler's and Eytelwein's law of the capstan). With T on
the side that is pulled and T + z on that of the anchor, and s the stroke of the cable from the anchor to the guide,

    (e^(-μα) - 1) T <= z <= (e^(μα) - 1) T,    z at its least where ds/dt > 0, at its most where ds/dt < 0.

So -z ds/dt >= 0 is dissipated. What sticks is to move at c = Bᵀv/2, so that it stops within the step, and the signs
above are those of ds/dt - c; where z would do work then, c = 0 takes its place.

Contact acts in the same step: its forces are found for points that are held back, W_c - X W⁻¹ Xᵀ with X = S A⁻¹ B of
the forces within their bounds in place of W_c.
"""

from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError
from fenics_rom.mechanics.complementarity.pivoting import solve_by_pivots
from fenics_rom.mechanics.environment import RIGID
from fenics_rom.mechanics.gas import Found, Gas, GasStep, Targets, amount_at
from fenics_rom.mechanics.points_held_back import OfForces, PointsHeldBack, Touch
from fenics_rom.mechanics.points_operator import Operator

if TYPE_CHECKING:
    from fenics_rom.mechanics.environment import Guide

SHARE = 2 / 3  # of what is missing of a stroke that a step makes up for
TOGETHER = 4  # rounds in which all forces that are wrong change at once; then they are found by pivots
MAX_ROUNDS = 100
AT_A_BOUND = 0.95  # of it: what a force was at least that is looked for there
ROUND_OFF = 1e-20  # of the largest rate per force: of the square of what a guide's column has left by round-off
CREEP = 1e-9  # of a guide's own rate per force: what sticks gives way by it, so that as many may stick as there are
TOLERANCE = 1e-12  # of the largest rate, or force
PIVOTED = 1e-9  # the same, of what pivots say: of many guides W is as good as singular, and has round-off to show
SETTLED = 1e-9  # of the largest force: what contact was found with, and what it led to
LARGEST_MISS = 1e-6  # of the largest rate: what W leaves beyond is no round-off


class ActuatorForces:
    """The forces of a body's actuators that are found: of strokes that are given, then at guides.

    Args:
        controls: "length" or "volume" of each actuator whose stroke is given, and "rigid" of each bar, by name.
        guides: by the names of their loads, of each tendon from the anchor on.
        widths: number of input columns of all actuators, then of all loads, by name, in the order of the input.
        gases: in those of the chambers by name that have "gas" or "valve" for their control.

    Attributes:
        gases: which of the forces they are, with their names.
        names: of the k actuators whose strokes are given, in the order of the input.
        guides: names of all guides' tendons, and how many from its anchor each is.
        columns: (n,) of all forces in the input, counted from its end, so that they hold in every contact mode.
        chains: of each tendon with guides: which stroke it is (or none), its column, and its guides from where it is
            pulled.
        friction: μ at guides (n,), 0 of strokes.
        pulls: (n,) whether forces are bounded: of cables, and at guides.
        share: (n,) of what is missing of a stroke, that a step makes up for; of the speed of a guide, that it stops.
    """

    def __init__(
        self,
        controls: Mapping[str, str],
        guides: "Mapping[str, Guide]",
        widths: Mapping[str, int],
        gases: Mapping[str, Gas] | None = None,
    ):
        starts = dict(zip(widths, np.cumsum([0, *widths.values()]) - sum(widths.values()), strict=False))
        self.names = tuple(name for name in widths if name in controls)
        self.columns = np.array([starts[name] for name in [*self.names, *guides]], dtype=int)
        shares = [1.0 if controls[name] == RIGID else SHARE for name in self.names]
        self.share = np.array([*shares, *(1 / 2 for _ in guides)])
        self._guides, unbounded = tuple(guides), np.full(len(self.names), np.inf)
        pulling = np.array([controls[name] == "length" for name in self.names], dtype=bool)
        self._least = np.concatenate([np.where(pulling, 0.0, -unbounded), np.zeros(len(guides))])
        self._most = np.concatenate([unbounded, np.zeros(len(guides))])
        self.pulls = np.isfinite(self._least)
        self.friction = np.array([*(0.0 for _ in self.names), *(guide.friction for guide in guides.values())])
        self._angles = np.array([*(0.0 for _ in self.names), *(guide.angle for guide in guides.values())])
        tendons = [guide.tendon for guide in guides.values()]
        self.guides = tuple((tendon, tendons[:i].count(tendon) + 1) for i, tendon in enumerate(tendons))
        self.chains: list[tuple[int | None, int, Array]] = [
            (
                self.names.index(tendon) if tendon in self.names else None,
                starts[tendon],
                len(self.names) + np.flatnonzero([each == tendon for each in tendons])[::-1],
            )
            for tendon in dict.fromkeys(tendons)
        ]
        self._is_guide = np.arange(len(self.columns)) >= len(self.names)
        self.gases = {self.names.index(name): (name, gas) for name, gas in (gases or {}).items() if name in self.names}

    def split(self, u: Array) -> tuple[Array, Array]:
        """An input (p,) without what is found, and what is given for it (n,): strokes, then of guides nothing."""
        forces = u.copy()
        forces[self.columns] = 0.0
        return forces, u[self.columns]

    def rates(self, given: Array, strokes: Array, rates: Array, h: float) -> Array:
        """The rates c (n,) of a step of h, s, to given strokes, from strokes that move at some rates (n,)."""
        missing = np.where(self._is_guide, 0.0, given - strokes)
        return self.share / h * missing + (1 - self.share) * rates

    def resting_rates(self, given: Array, strokes: Array, h: float) -> Array:
        """The same without inertia."""
        k = len(self.names)
        return np.concatenate([(given - strokes)[:k] / h, np.zeros(len(given) - k)])

    def targets(self, given: Array, strokes: Array, rates: Array, h: float) -> Targets:
        """What a step of h, s, leads strokes to: `rates`, and gas as it is given."""
        return Targets(self.rates(given, strokes, rates, h), self._gas(given, strokes, h, at_rest=False))

    def resting_targets(self, given: Array, strokes: Array, h: float) -> Targets:
        """The same without inertia."""
        return Targets(self.resting_rates(given, strokes, h), self._gas(given, strokes, h, at_rest=True))

    def _gas(self, given: Array, strokes: Array, h: float, *, at_rest: bool) -> GasStep | None:
        if not self.gases:
            return None
        places, (names, gases) = np.array(list(self.gases)), zip(*self.gases.values(), strict=True)
        return GasStep(places, names, gases, given[places], strokes[places], h, at_rest)

    def towards(self, given: Array, strokes: Array, z: Array | None, share: float) -> Array:
        """What is given (n,) up to a share of a step from strokes (n,); gas from what had z (n,); None: all at once."""
        start = strokes.copy()
        for place, (_, gas) in self.gases.items():
            start[place] = given[place] if z is None else amount_at(gas, strokes[place], z[place])
        return start + share * (given - start)

    @staticmethod
    def holding(delassus: Operator, X: Array, W: Array) -> "PointsHeldBack":
        """What holds contact points back: their operator, what forces here do there, and `compliance`."""
        return PointsHeldBack(delassus, X, W)

    def compliance(self, W: Array) -> Array:
        """Bᵀ A⁻¹ B (n, n) made symmetric, and definite unless strokes depend on one another."""
        W = (W + W.T) / 2
        W.ravel()[:: len(W) + 1] += CREEP * W.diagonal() * (np.arange(len(W)) >= len(self.names))
        return W

    def solve(
        self,
        u: Array,
        rates: Array,
        W: Array,
        targets: Targets,
        before: Array,
        touch: Touch | None,
        angles: Array | None = None,
    ) -> Found:
        """The forces z (n,), N or Pa, and contact, of a step.

        The search begins with what guides did under forces before: which of them slide, and where to. All that are
        wrong change at once, which mostly ends soon. Of many guides, which smooth motions all but tie to one another,
        it may cycle; then pivots find them, by turns with contact, where something is touched.

        Args:
            u: the input (p,), whose tensions the guides of other tendons are under.
            rates: (n,) of the strokes, without these forces and without contact, per s.
            W: (n, n) rates per force, as `compliance` makes it.
            targets: of the strokes.
            before: z (n,) of an earlier step or iteration; 0: not known.
            touch: what contact does; None: nothing can touch.
            angles: (n,) by which tendons turn at guides, rad, 0 of strokes; those at rest unless given.

        Raises:
            StepError: there are none, as strokes depend on one another, or none were found.
        """

        def solve(W: Array, targets: Array, before: Array, gives: Array | None) -> Found:
            of_forces = None if touch is None else partial(touch, gives=gives)
            return self._solve(u, rates, W, targets, before, of_forces, angles)

        if targets.gas is None:
            return solve(W, targets.rates, before, None)
        return targets.gas.find(rates, W, targets.rates, before, solve)

    def _solve(
        self,
        u: Array,
        rates: Array,
        W: Array,
        targets: Array,
        before: Array,
        touch: OfForces | None,
        angles: Array | None,
    ) -> Found:
        """As `solve`, of strokes that go at their targets (n,), per s."""
        if not self._guides and (len(rates) == 1 or not np.isfinite(self._least).any()):
            found_at_once = self._all_held(rates, W, targets, touch)
            if found_at_once is not None:
                return found_at_once
        is_guide, diagonal = self._is_guide, W.diagonal()
        idle = is_guide & (diagonal <= ROUND_OFF * diagonal.max())  # the cable before such a guide moves nothing
        bends = self.bends(angles)
        sides, targets = np.where(idle, -1, self._sides(u, before, bends)), targets.copy()
        beyond = np.zeros_like(rates)  # what is at a bound, as contact was last found with it
        contact, added = None, np.zeros_like(rates)
        by_turns, tried, kept = False, sides, beyond  # contact under what is at guides, and that under contact
        try:
            for found in range(1, MAX_ROUNDS + 1):
                holding = (sides == 0) & ~(by_turns & is_guide)
                if touch is not None:
                    contact, added = touch(completed(W, targets - rates, beyond, holding), holding)
                if by_turns:
                    sides = self._pivoted(u, rates + added - targets, W, bends, idle)
                within = np.flatnonzero(sides == 0)
                E, z, _ = self._chained(u, sides, within, bends)
                z += E.dot(np.linalg.solve(W[within].dot(E), (targets - rates - added - W.dot(z))[within]))
                missed = rates + W.dot(z) + added - targets
                scale, most = max(np.abs(part).max() for part in (rates, targets, added)), np.abs(z).max()
                if not np.abs(missed[within]).max(initial=0.0) <= LARGEST_MISS * scale:
                    break
                lower, upper = self._bounds(u, z, bends)
                tolerance = PIVOTED if found > TOGETHER else TOLERANCE
                least = np.where(is_guide, tolerance * most, 0.0)
                escapes, sticks = (z < lower - least) | (z > upper + least), sides * missed > tolerance * scale
                wrong = np.where(sides == 0, escapes, sticks & (lower < upper))
                last, beyond = beyond, np.where(holding, 0.0, np.clip(z, lower, upper))
                if not wrong.any():
                    helps = is_guide & (targets != 0) & (z * (missed + targets) > TOLERANCE * most * scale)
                    if not helps.any() and (touch is None or np.abs(beyond - last).max() <= SETTLED * most):
                        return z, contact
                    targets[helps] = 0.0
                    if by_turns and not np.array_equal(sides, tried):  # turns are slow, so that these sides are tried
                        by_turns, tried, kept = False, sides, beyond
                        beyond = np.where(sides == 0, 0.0, beyond)
                elif found < TOGETHER:
                    sides = np.where(wrong, np.where(sides == 0, np.where(z < lower, -1, 1), 0), sides)
                    beyond = np.where(sides == 0, 0.0, np.clip(z, lower, upper))
                    kept = np.where(is_guide, np.clip(z, lower, upper), beyond)
                elif not by_turns:
                    by_turns, beyond = True, kept
            else:
                raise self._not_found(f"in {MAX_ROUNDS} rounds")
        except np.linalg.LinAlgError:
            pass
        if (diagonal[~is_guide] < 0).any():  # of a tangent that is not definite
            raise StepError(
                f"no forces found that give the strokes of {', '.join(self.names)}: where the step has led so far the "
                "body is not stable against them; a smaller dt is the cure"
            )
        raise StepError(
            f"no forces found that give the strokes of {', '.join(self.names)}: they depend on one another, or on what "
            "holds the body; give one of them as a force, or its strokes otherwise"
        )

    def _not_found(self, where: str) -> StepError:
        names = ", ".join([*self.names, *self._guides])
        return StepError(f"no forces found of {names}: not {where}; a smaller dt or less friction may help")

    def _all_held(self, rates: Array, W: Array, targets: Array, touch: OfForces | None) -> Found | None:
        """As `solve`, where all strokes hold; None where one does not, as of a slack cable, or W is singular."""
        missing, contact = targets - rates, None
        try:
            z = np.linalg.solve(W, missing)
            if touch is not None:
                contact, added = touch(z, np.ones(len(z), dtype=bool))
                missing = missing - added
                z = np.linalg.solve(W, missing)
        except np.linalg.LinAlgError:
            return None
        scale = max(np.abs(part).max() for part in (rates, targets, missing))
        is_met = np.abs(W.dot(z) - missing).max() <= LARGEST_MISS * scale
        return (z, contact) if is_met and (z >= self._least).all() else None

    def held(self, z: Array) -> Array:
        """Which of the strokes that are given, (h,), forces z (n,) hold: not those of cables that are slack."""
        k = len(self.names)
        return np.flatnonzero((self._least[:k] < 0) | (z[:k] > 0))

    def within(self, u: Array, z: Array, angles: Array | None = None) -> Array:
        """Which of the forces (h,) are within their bounds, so that strokes go as they are to; see `solve`."""
        return np.flatnonzero(self._sides(u, z, self.bends(angles)) == 0)

    def parts(self, columns: Array, z: Array) -> tuple[Array, Array]:
        """Generalized forces (m,) of the strokes that are given, and of guides, of columns (m, n) and forces (n,)."""
        k = len(self.names)
        return columns[:, :k].dot(z[:k]), columns[:, k:].dot(z[k:])

    def bends(self, angles: Array | None) -> Array:
        """μα at guides (n,), of angles (n,), rad; None: those at rest."""
        bends: Array = self.friction * (self._angles if angles is None else angles)
        return bends

    def tensions(self, u: Array, z: Array) -> Array:
        """Of cables ahead of their guides (n,), N, under forces z (n,); 0 of strokes."""
        tensions = np.zeros_like(z)
        for stroke, column, guides in self.chains:
            changes = z[guides].cumsum()
            changes -= z[guides]
            tensions[guides] = np.maximum(max(u[column] if stroke is None else z[stroke], 0.0) + changes, 0.0)
        return tensions

    def _bounds(self, u: Array, z: Array, bends: Array) -> tuple[Array, Array]:
        """The least and the most (n,) that forces can be, with the tensions that z (n,) leads to."""
        tensions = self.tensions(u, z)
        return self._least + tensions * np.expm1(-bends), self._most + tensions * np.expm1(bends)

    def _sides(self, u: Array, z: Array, bends: Array) -> Array:
        """At which bound forces z (n,) are, or nearly: -1 or 1, or 0; where none are known, of cables that slide."""
        if not z.any():
            return -1 * self._is_guide
        lower, upper = (AT_A_BOUND * bound for bound in self._bounds(u, z, bends))
        return np.where(self._is_guide, np.where(z <= lower, -1, 1 * (z >= upper)), 0)

    def _chained(self, u: Array, sides: Array, unknown: Array, bends: Array) -> "Chained":
        """What forces follow from some of them, where others slide to their sides, -1 or 1."""
        turned = np.where(self._is_guide, sides * bends, 0.0)
        share, column = np.expm1(turned), np.full(len(sides), -1)
        column[unknown] = np.arange(len(unknown))
        E, e = np.zeros((len(sides), len(unknown))), np.zeros(len(sides))
        for stroke, at, guides in self.chains:
            left = np.exp(turned[guides].cumsum())  # of the tension, behind each guide
            ahead = left * np.exp(-turned[guides])
            added = np.flatnonzero(column[guides] >= 0)
            E[guides[:, None], column[guides[added]]] = np.tril(np.multiply.outer(ahead, 1 / left), -1)[:, added]
            if stroke is None:
                e[guides] = max(u[at], 0.0) * ahead
            elif column[stroke] >= 0:
                E[guides, column[stroke]] = ahead
        tensions = E.copy()
        E *= share[:, None]
        E[unknown, np.arange(len(unknown))] += 1.0
        return Chained(E, share * e, (tensions, e))

    def _pivoted(self, u: Array, missed: Array, W: Array, bends: Array, idle: Array) -> Array:
        """At which bounds (n,) forces are that fulfil all conditions.

        With a what is at guides above the least that can be there, and the tensions of cables by strokes, it is the
        complementarity problem of a, of what is left to the most, and of how far cables slide either way.

        Args:
            u, W, bends: as elsewhere.
            missed: rates less their targets (n,), under no forces.
            idle: which guides (n,) move nothing.

        Raises:
            StepError: there are none, or none were found.
        """
        guides, bounded = np.flatnonzero(self._is_guide & ~idle), np.flatnonzero(~idle)
        E, e, (tensions, known) = self._chained(u, -1 * self._is_guide, bounded, bends)
        A, b, is_free = W[bounded].dot(E), (missed + W.dot(e))[bounded], ~np.isfinite(self._least[bounded])
        kept = np.flatnonzero(~is_free)
        if is_free.any():  # volumes, whose forces may be of either sign, are eliminated
            whole = np.linalg.solve(
                A[np.ix_(is_free, is_free)], np.column_stack([A[np.ix_(is_free, kept)], b[is_free]])
            )
            A, b = np.split(
                np.column_stack([A[kept][:, kept], b[kept]]) - A[np.ix_(kept, is_free)].dot(whole), [-1], axis=1
            )
            b = b[:, 0]
        size, k, n = W.diagonal().max(), len(kept), len(guides)
        largest = max(np.abs(b).max() / size, np.abs(known).max())  # N
        slides = np.zeros((k, n))
        slides[k - n + np.arange(n), np.arange(n)] = 1.0
        wide = (np.expm1(bends) - np.expm1(-bends))[guides]
        M = np.block(
            [[A / size, slides], [wide[:, None] * tensions[np.ix_(guides, kept)] - slides.T, np.zeros((n, n))]]
        )
        found = solve_by_pivots(M, np.concatenate([b / size, wide * known[guides]]) / largest)
        if found is None:
            raise self._not_found("by pivots")
        sides = -1 * idle
        sides[bounded[kept]] = np.where(found[:k] > 0, 0, -1)
        sides[guides] = np.where(found[k:] > 0, 1, sides[guides])
        return sides


def completed(W: Array, rates: Array, z: Array, holding: Array) -> Array:
    """Forces (n,) with which strokes that are held (n,) move at some rates (n,), and that are as in z elsewhere."""
    z, within = np.where(holding, 0.0, z), np.flatnonzero(holding)
    z[within] = np.linalg.solve(W[np.ix_(within, within)], (rates - W.dot(z))[within])
    return z


class Chained(NamedTuple):
    """Forces at guides that follow from some of them (w,): z = E ζ + e."""

    by_unknown: Array  # E (n, w)
    known: Array  # e (n,)
    tensions: tuple[Array, Array]  # of cables ahead of their guides, likewise
