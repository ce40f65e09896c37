"""Forces of actuators that are found in a step: by their stroke, and by the friction of cables at their guides.

The stroke s = Bᵀx is what the force z of an actuator does work along: by how much a tendon is shorter than at rest, m,
or a chamber larger, m³. A step with the mid-step velocity v̂ = free + A⁻¹ B z moves it at the rate Bᵀv̂ = Bᵀfree + W z,
W = Bᵀ A⁻¹ B. Where it is given, the forces are those for which that is

    c = 2/3 (s⁺ - s)/h + 1/3 Bᵀv,        without inertia c = (s⁺ - s)/h,

and they do the work h zᵀ Bᵀv̂ in the step, force times change of stroke, which is booked as supplied. With the whole of
(s⁺ - s)/h the stroke would be met in every step, but a change of speed would ring on for ever, as v⁺ = 2 v̂ - v. So a
constant speed is met to round-off, and what is missed when it changes falls to a third in two steps. A cable only
pulls, 0 <= z ⟂ Bᵀv̂ - c >= 0: it is slack where it is shorter than it has to be.

At a guide round which a cable turns by the angle α, the tension of the side that it slides from is e^(-μα) times that
of the side that it slides to, and where it sticks it is between (Euler's and Eytelwein's law of the capstan). With T on
the side that is pulled and T + z on that of the anchor, and s the stroke of the cable from the anchor to the guide,

    (e^(-μα) - 1) T <= z <= (e^(μα) - 1) T,    z at its least where ds/dt > 0, at its most where ds/dt < 0.

So -z ds/dt >= 0 is dissipated. What sticks is to move at c = Bᵀv/2, so that it stops within the step, and the signs
above are those of ds/dt - c; where z would do work then, c = 0 takes its place.

Contact acts in the same step: its forces are found for points that are held back, W_c - X W⁻¹ Xᵀ with X = S A⁻¹ B of
the forces within their bounds in place of W_c.
"""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError

if TYPE_CHECKING:
    from fenics_rom.mechanics.contact import ContactSolution
    from fenics_rom.mechanics.environment import Guide

Touch = Callable[[Array, Array], "tuple[ContactSolution | None, Array]"]

SHARE = 2 / 3  # of what is missing of a stroke that a step makes up for
TOGETHER = 10  # rounds in which all forces that are wrong change at once; then one by one, which does not cycle
MAX_ROUNDS = 100
ROUND_OFF = 1e-20  # of the largest rate per force: of the square of what a guide's column has left by round-off
CREEP = 1e-9  # of a guide's own rate per force: what sticks gives way by it, so that as many may stick as there are
TOLERANCE = 1e-12  # of the largest rate, or force
SETTLED = 1e-9  # of the largest force: what contact was found with, and what it led to
LARGEST_MISS = 1e-6  # of the largest rate: what W leaves beyond is no round-off


class ActuatorForces:
    """The forces of a body's actuators that are found: of strokes that are given, then at guides.

    Args:
        controls: "length" or "volume" of each actuator whose stroke is given, by name.
        guides: by the names of their loads, of each tendon from the anchor on.
        widths: number of input columns of all actuators, then of all loads, by name, in the order of the input.

    Attributes:
        names: of the k actuators whose strokes are given, in the order of the input.
        guides: names of all guides' tendons, and how many from its anchor each is.
        columns: (n,) of all forces in the input, counted from its end, so that they hold in every contact mode.
    """

    def __init__(self, controls: Mapping[str, str], guides: "Mapping[str, Guide]", widths: Mapping[str, int]):
        starts = dict(zip(widths, np.cumsum([0, *widths.values()]) - sum(widths.values()), strict=False))
        self.names = tuple(name for name in widths if name in controls)
        self.columns = np.array([starts[name] for name in [*self.names, *guides]], dtype=int)
        self._guides, unbounded = tuple(guides), np.full(len(self.names), np.inf)
        pulling = np.array([controls[name] == "length" for name in self.names], dtype=bool)
        self._least = np.concatenate([np.where(pulling, 0.0, -unbounded), np.zeros(len(guides))])
        self._most = np.concatenate([unbounded, np.zeros(len(guides))])
        self._friction = np.array([*(0.0 for _ in self.names), *(guide.friction for guide in guides.values())])
        self._angles = np.array([*(0.0 for _ in self.names), *(guide.angle for guide in guides.values())])
        tendons = [guide.tendon for guide in guides.values()]
        self.guides = tuple((tendon, tendons[:i].count(tendon) + 1) for i, tendon in enumerate(tendons))
        # Of each tendon with guides: which stroke it is (or none), its column, and its guides from where it is pulled.
        self._chains: list[tuple[int | None, int, list[int]]] = [
            (
                self.names.index(tendon) if tendon in self.names else None,
                starts[tendon],
                [len(self.names) + i for i, guide in enumerate(guides.values()) if guide.tendon == tendon][::-1],
            )
            for tendon in dict.fromkeys(tendons)
        ]

    def split(self, u: Array) -> tuple[Array, Array]:
        """An input (p,) without what is found, and what is given for it (n,): strokes, then of guides nothing."""
        forces = u.copy()
        forces[self.columns] = 0.0
        return forces, u[self.columns]

    def rates(self, given: Array, strokes: Array, rates: Array, h: float) -> Array:
        """The rates c (n,) of a step of h, s, to given strokes, from strokes that move at some rates (n,)."""
        k = len(self.names)
        towards = SHARE / h * (given - strokes) + (1 - SHARE) * rates
        return np.concatenate([towards[:k], rates[k:] / 2])

    def resting_rates(self, given: Array, strokes: Array, h: float) -> Array:
        """The same without inertia."""
        k = len(self.names)
        return np.concatenate([(given - strokes)[:k] / h, np.zeros(len(given) - k)])

    @staticmethod
    def holding(delassus: Array, X: Array, W: Array) -> "PointsHeldBack":
        """What holds contact points back: their operator, what forces here do there, and `compliance`."""
        return PointsHeldBack(delassus, X, W)

    def compliance(self, W: Array) -> Array:
        """Bᵀ A⁻¹ B (n, n) made symmetric, and definite unless strokes depend on one another."""
        W = (W + W.T) / 2
        W.ravel()[:: len(W) + 1] += CREEP * W.diagonal() * (np.arange(len(W)) >= len(self.names))
        return W

    def solve(
        self, u: Array, rates: Array, W: Array, targets: Array, touch: Touch, angles: Array | None = None
    ) -> "tuple[Array, ContactSolution | None]":
        """The forces z (n,), N or Pa, and contact, of a step.

        Args:
            u: the input (p,), whose tensions the guides of other tendons are under.
            rates: (n,) of the strokes, without these forces and without contact, per s.
            W: (n, n) rates per force, as `compliance` makes it.
            targets: c (n,), per s.
            touch: of forces z (n,) and which of them (n,) are within their bounds, what contact does, and the rates
                (n,) that it adds where they stay as they are.
            angles: (n,) by which tendons turn at guides, rad, 0 of strokes; those at rest unless given.

        Raises:
            StepError: there are none, as strokes depend on one another, or none were found.
        """
        if len(rates) == 1 and not self._guides:
            found_at_once = self._only(rates, W, targets, touch)
            if found_at_once is not None:
                return found_at_once
        is_guide, diagonal = np.arange(len(rates)) >= len(self.names), W.diagonal()
        idle = is_guide & (diagonal <= ROUND_OFF * diagonal.max())  # the cable before such a guide moves nothing
        bends = self._friction * (self._angles if angles is None else angles)
        sides, targets = -1 * idle, targets.copy()  # -1 and 1 are at one of their bounds
        beyond = np.zeros_like(rates)  # what is at a bound, as contact was last found with it
        for found in range(MAX_ROUNDS):
            within = np.flatnonzero(sides == 0)
            start, (E, z) = beyond.copy(), self._chained(u, sides, within, bends)
            try:
                start[within] = np.linalg.solve(W[np.ix_(within, within)], (targets - rates - W.dot(beyond))[within])
                contact, added = touch(start, sides == 0)
                z += E.dot(np.linalg.solve(W[within].dot(E), (targets - rates - added - W.dot(z))[within]))
            except np.linalg.LinAlgError:
                break
            missed = rates + W.dot(z) + added - targets
            scale, most = max(np.abs(part).max() for part in (rates, targets, added)), np.abs(z).max()
            if not np.abs(missed[within]).max(initial=0.0) <= LARGEST_MISS * scale:
                break
            lower, upper = self._bounds(u, z, bends)
            least = np.where(is_guide, TOLERANCE * most, 0.0)
            escapes, sticks = (z < lower - least) | (z > upper + least), sides * missed > TOLERANCE * scale
            wrong = np.where(sides == 0, escapes, sticks & (lower < upper))
            if found >= TOGETHER:
                wrong[np.flatnonzero(wrong)[1:]] = False
            sides = np.where(wrong, np.where(sides == 0, np.where(z < lower, -1, 1), 0), sides)
            helps = is_guide & (targets != 0) & (z * (missed + targets) > TOLERANCE * most * scale)
            targets[helps] = 0.0
            before, beyond = beyond, np.where(sides == 0, 0.0, np.clip(z, lower, upper))
            settled = contact is None or np.abs(beyond - before).max() <= SETTLED * most
            if settled and not wrong.any() and not helps.any():
                return z, contact
        else:
            raise StepError(
                f"no forces found of {', '.join([*self.names, *self._guides])}: not in {MAX_ROUNDS} rounds; a smaller "
                "dt or less friction may help"
            )
        raise StepError(
            f"no forces found that give the strokes of {', '.join(self.names)}: they depend on one another, or on what "
            "holds the body; give one of them as a force, or its strokes otherwise"
        )

    def _only(
        self, rates: Array, W: Array, targets: Array, touch: Touch
    ) -> "tuple[Array, ContactSolution | None] | None":
        """As `solve`, where one stroke is given; None where it does not hold, as of a slack cable."""
        missing, compliance = targets - rates, W[0]
        if not compliance[0] > 0:
            return None
        contact, added = touch(missing / compliance, np.ones(1, dtype=bool))
        z = (missing - added) / compliance
        return (z, contact) if z[0] >= self._least[0] else None

    def held(self, z: Array) -> Array:
        """Which of the strokes that are given, (h,), forces z (n,) hold: not those of cables that are slack."""
        k = len(self.names)
        return np.flatnonzero((self._least[:k] < 0) | (z[:k] > 0))

    def parts(self, columns: Array, z: Array) -> tuple[Array, Array]:
        """Generalized forces (m,) of the strokes that are given, and of guides, of columns (m, n) and forces (n,)."""
        k = len(self.names)
        return columns[:, :k].dot(z[:k]), columns[:, k:].dot(z[k:])

    def _chained(self, u: Array, sides: Array, within: Array, bends: Array) -> tuple[Array, Array]:
        """E (n, w) and e (n,): z = E ζ + e of the forces ζ (w,) within bounds, and what follows of them at guides."""
        E, e = np.zeros((len(sides), len(within))), np.zeros(len(sides))
        E[within, np.arange(len(within))] = 1.0
        for stroke, column, guides in self._chains:
            slope, tension = (np.zeros(len(within)), max(u[column], 0.0)) if stroke is None else (E[stroke], e[stroke])
            for i in guides:
                if sides[i]:
                    share = np.expm1(sides[i] * bends[i])
                    E[i], e[i] = share * slope, share * tension
                slope, tension = slope + E[i], tension + e[i]
        return E, e

    def _bounds(self, u: Array, z: Array, bends: Array) -> tuple[Array, Array]:
        """The least and the most (n,) that forces can be, with the tensions that z (n,) leads to."""
        lower, upper = self._least.copy(), self._most.copy()
        for stroke, column, guides in self._chains:
            tension = max(u[column] if stroke is None else z[stroke], 0.0)
            for i in guides:
                lower[i], upper[i] = tension * np.expm1(-bends[i]), tension * np.expm1(bends[i])
                tension = max(tension + z[i], 0.0)
        return lower, upper


class PointsHeldBack:
    """Delassus operators (3P, 3P) of points that strokes hold back, of one without, X (3P, n) and W (n, n).

    They are kept, as the solver of contact keeps parts of one that it is given again.
    """

    def __init__(self, delassus: Array, X: Array, W: Array):
        self._free, self._X, self._W, self._kept = delassus, X, W, dict[bytes, Array]()

    def delassus(self, holding: Array) -> Array:
        """Where some (n,) of the forces are within their bounds."""
        held, key = np.flatnonzero(holding), holding.tobytes()
        if not len(held):
            return self._free
        if key not in self._kept:
            root = np.linalg.solve(np.linalg.cholesky(self._W[np.ix_(held, held)]), self._X[:, held].T)
            self._kept[key] = self._free - root.T.dot(root)
        return self._kept[key]
