"""Many soft bodies of one ROM, stepped together: each with its own contact mode, state, input and time.

The midpoint rule in x = 2 q / h and r, with w = 2 v̂ and a = (4/h) (2/h + D + h/2 γ)⁻¹, which no h makes large:

    w = a (h/2 G u + r - h²/4 γ x),   x⁺ = x + w,   r⁺ = w - r.

Where the damping is diagonal, so is a, and a step is a handful of elementwise operations on arrays of bodies × reduced
displacements. What this costs is memory traffic: bodies go through the step in chunks that stay in the cache, with the
coefficients written out for every body. The rows of all arrays are bodies sorted by contact mode, so that a force is
one product for each mode of a chunk. A switch projects the state where it is; before the next step, the few rows that
are then in another mode's place change places. Modes of lower order are filled up with zeros.
"""

from collections.abc import Mapping, Sequence
from copy import deepcopy
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, DTypeLike

from fenics_rom.errors import StepError, unknown
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.steppers.midpoint import checked_dt, compliance
from fenics_rom.runtime.switching import Projections

if TYPE_CHECKING:
    from fenics_rom.mechanics.active_environment import ActiveEnvironment, SignalLike

Array = np.ndarray
Bodies = int | Sequence[int] | Sequence[bool] | Array | None

CACHE = 1 << 19  # bytes that the six arrays of a chunk may fill: half of a usual second-level cache
TIME, SUPPLIED, DISSIPATED, LOST = range(4)


class _Part(NamedTuple):
    """The bodies of a chunk that are in the same contact mode; arrays are views."""

    mode: int
    rows: slice
    u: Array
    w: Array
    spare: Array


class _Chunk(NamedTuple):
    """Rows that go through the step together; arrays are views, (rows, m)."""

    x: Array
    r: Array
    elastic: Array
    inertial: Array
    w: Array
    spare: Array
    parts: list[_Part]


class Batch:
    """Steps many bodies of one ROM from rest, beginning in its first contact mode.

    `bodies` in the methods are None (all), a mask (size,) or distinct indices; arrays are in the order 0 .. size - 1.

    Args:
        rom: the reduced model; it is only read, and copies of a batch share it.
        size: number of bodies.
        dt: time step of all bodies, s; may be set anew before any step.
        dtype: of the states and the arithmetic, float64 or float32; energies, work and time are float64 always.
        ledger: whether to keep the energy account of each body.
        signals: of loads by name, instead of the scene's: numbers, or functions of each body's time; as in Simulator.

    Attributes:
        steps: number of steps the batch has taken.

    Raises:
        StepError: size is not a whole number > 0, dt not a positive finite number, or dtype another one; or the scene
            has contact or no inertia, which `Simulator` steps.

    Example:
        >>> bodies = fr.Batch(rom, size=4, dt=1e-3)
        >>> bodies.switch("middle", [0, 2])
        >>> bodies.step(np.full((4, 3), 0.5))  # N; the bodies that could not take it
        array([], dtype=int64)
        >>> bodies.displacement("tip").shape
        (4, 2, 3)
    """

    def __init__(
        self,
        rom: Rom,
        size: int,
        dt: float,
        *,
        dtype: DTypeLike = float,
        ledger: bool = False,
        signals: "Mapping[str, SignalLike] | None" = None,
    ):
        if not (isinstance(size, int | np.integer) and size > 0):
            raise StepError(f"size = {size!r}: allowed is a whole number > 0")
        if np.dtype(dtype) not in (np.float64, np.float32):
            raise StepError(f"dtype = {dtype!r}: allowed are float64 and float32")
        self._surroundings: ActiveEnvironment | None = None
        if rom.surrounded or signals:
            from fenics_rom.runtime import acting  # here, so that bodies on which nothing acts start without it

            rom, self._surroundings = acting.surrounded(rom, None, signals)
        if self._surroundings is not None and (self._surroundings.quasi_static or self._surroundings.law is not None):
            raise StepError(
                f"ROM {rom.name!r} has contact or no inertia in its scene: allowed are forces that are known before a "
                "step; Simulator steps such bodies, one by one"
            )
        if rom.deformation is not None:
            raise StepError(
                f"ROM {rom.name!r} has large deformation in its scene: Simulator steps such bodies, one by one"
            )
        self.rom, self.size, self.dtype = rom, int(size), np.dtype(dtype)
        self._names = list(rom.contact_models)
        self._widest = max(rom.contacts.values())
        self._orders = np.array([mode.order for mode in rom.contact_models.values()])
        m, p = self._orders.max(), self.inputs + sum(rom.loads.values())
        self._ω = np.ones((len(self._names), m))  # where a mode has less, x = 0
        self._G = np.zeros((len(self._names), p, m), self.dtype)
        for ω, G, mode, contact in zip(
            self._ω, self._G, rom.contact_models.values(), rom.contacts.values(), strict=True
        ):
            ω[: mode.order] = np.sqrt(mode.eigenvalues)
            G[:contact, : mode.order] = mode.inputs[:, :contact].T
            G[self._widest :, : mode.order] = mode.inputs[:, contact:].T
        self._ledger = ledger
        self._ones = np.ones(m, self.dtype)
        self._drags = [  # wᵀDw/2, where D is diagonal, is what these make of the squares of w
            _filled(mode.damping / 2, (m,)).astype(self.dtype) if mode.damping.ndim == 1 else self._ones / 2
            for mode in rom.contact_models.values()
        ]
        self._projections = Projections(rom)
        self._maps: dict[tuple[int, int], Array] = {}
        self._readers: dict[str, list[Array]] = {}

        self._mode = np.zeros(self.size, dtype=int)  # of each body
        self._row = np.arange(self.size)  # of each body
        self._body = np.arange(self.size)  # of each row
        self._written = np.full(self.size, -1)  # the mode whose coefficients are in each row
        self._plan: list[_Chunk] | None = None  # None: rows are not sorted, or coefficients not written
        self._state = np.zeros((2, self.size, m), self.dtype)  # x and r
        self._huge = float(np.finfo(self._state.dtype).max) ** 0.25
        self._coefficients = np.empty((2, self.size, m), self.dtype)
        self._u = np.empty((self.size, p), self.dtype)
        chunks = -(-6 * self.size * m * self.dtype.itemsize // CACHE)
        self._buffers = np.empty((2, -(-self.size // chunks), m), self.dtype)
        self._account = np.zeros((4, self.size))
        self._works = np.empty((2, self.size), self.dtype)
        self.steps = 0
        self._dt = 1.0
        self.dt = dt

    def __getstate__(self) -> dict[str, Any]:
        return vars(self) | {"_plan": None}  # its views would be copies of their own

    def __copy__(self) -> "Batch":
        return deepcopy(self)

    def __deepcopy__(self, memo: dict[int, Any]) -> "Batch":
        memo[id(self.rom)] = self.rom
        copied = object.__new__(type(self))
        vars(copied).update(deepcopy(self.__getstate__(), memo))
        return copied

    def __repr__(self) -> str:
        orders = (f"{name} (order {model.order})" for name, model in self.rom.contact_models.items())
        return (
            f"Batch of {self.size} bodies of {self.rom.name!r}: dt = {self.dt:g} s, {self.steps} steps taken, "
            f"{self.dtype}\n  contact modes: {', '.join(orders)}"
        )

    @property
    def dt(self) -> float:
        """Time step, s."""
        return self._dt

    @dt.setter
    def dt(self, dt: float) -> None:
        h = checked_dt(dt)
        most = self._huge**2
        with np.errstate(over="ignore", invalid="ignore"):
            x = self._state[0] * (self._dt / h)
            angles = h / 2 * self._ω
        rigid = self.rom.rigid
        if not (angles[:, rigid:].min() >= 1 / most and angles.max() <= most and np.abs(x).max() <= most):
            raise StepError(f"dt = {dt!r}: too far from the model's periods for {self.dtype}")
        self._state[0] = x
        self._dt = h
        self._table = np.zeros((2, *self._ω.shape), self.dtype)
        self._push = np.empty(self._G.shape, self.dtype)
        self._coupling: list[tuple[Array, Array] | None] = []  # where D is dense: to w, and to R w
        for k, mode in enumerate(self.rom.contact_models.values()):
            a, Ra = (4 / h * part for part in compliance(mode, h))
            dense = a.ndim == 2
            diagonal = _filled(np.ones(mode.order) if dense else a, angles[k].shape)
            self._table[:, k] = -diagonal * angles[k] ** 2, diagonal
            self._push[k] = diagonal * (h / 2 * self._G[k])
            square = (len(diagonal),) * 2
            maps = [_filled(part.T, square).astype(self.dtype) for part in (a, Ra)] if dense else None
            self._coupling.append(None if maps is None else (maps[0], maps[1]))
        # A step is passive: it adds at most h |G u| to the length of (ω q, r), and x is at most 2/(h ω) times that, or
        # along rigid motions twice that in each step.
        # So what bounds the inputs bounds the states, and nothing else needs to be looked at in a step: below this
        # limit no number overflows in the first `_huge` steps from rest, 4e9 of them in float32.
        longest = np.abs(self._G).sum(axis=(1, 2)) * np.maximum(h, 2 / self._ω[:, rigid:].min(axis=1))
        self._limit = self._huge / max(1.0, longest.max())
        self._written[:] = -1
        self._plan = None

    @property
    def inputs(self) -> int:
        """Columns p of the input: those of the contact mode that has most, then the actuators'."""
        return self._widest + sum(self.rom.actuators.values())

    @property
    def contact(self) -> Array:
        """Names (size,) of the active contact modes."""
        return np.array(self._names)[self._mode]

    @property
    def time(self) -> Array:
        """Time (size,) since each body's last reset, s."""
        return self._account[TIME].copy()

    @property
    def energy(self) -> Array:
        """Stored energies ½ vᵀMv + ½ xᵀKx (size,), J."""
        energy = np.empty(self.size)
        energy[self._body] = self._energy(slice(None))
        return energy

    @property
    def supplied(self) -> Array:
        """Work of the inputs (size,) since each body's last reset, J.

        Raises:
            StepError: the batch keeps no account, here as in the following.
        """
        return self._booked(SUPPLIED)

    @property
    def dissipated(self) -> Array:
        """What damping took (size,), J; never negative."""
        return self._booked(DISSIPATED)

    @property
    def lost_in_switching(self) -> Array:
        """What projections took (size,), J; negative only for oblique switching."""
        return self._booked(LOST)

    def state(self, bodies: Bodies = None) -> tuple[Array, Array]:
        """Reduced displacements q and velocities r, (bodies, m) each; zero beyond the order of a body's contact mode.

        Raises:
            StepError: no such bodies.
        """
        x, r = self._state[:, self._row[self._chosen(bodies)]].astype(float)
        return self._dt / 2 * x, r

    def set_state(self, q: ArrayLike, r: ArrayLike, bodies: Bodies = None) -> None:
        """Puts bodies into states; contact modes, times and accounts stay.

        Args:
            q, r: (bodies, m) as `state` gives them, or (m,) for all of them.
            bodies: which.

        Raises:
            StepError: no such bodies, another shape, numbers that are not finite or absurdly large, or not zero beyond
                the order of a body's contact mode.
        """
        chosen = self._chosen(bodies)
        shape = (len(chosen), self._ω.shape[1])
        given = [np.asarray(part, dtype=float) for part in (q, r)]
        if any(part.shape not in (shape, shape[1:]) for part in given):
            raise StepError(f"state: allowed are two arrays of shape {shape}, given: {[part.shape for part in given]}")
        state = np.stack([np.broadcast_to(part, shape) for part in given])
        with np.errstate(over="ignore"):
            state[0] *= 2 / self._dt
            size = np.abs(state) * np.maximum(1.0, [self._dt / 2 * self._ω[self._mode[chosen]], np.ones(shape)])
        if not (size <= self._huge).all():  # NaN is not, either
            raise StepError(f"state: allowed are finite numbers, within {self._huge:.0e} in 2 q / dt, √γ q and r")
        if state[:, np.arange(shape[1]) >= self._orders[self._mode[chosen], None]].any():
            raise StepError("state: beyond the order of a body's contact mode only zeros are allowed")
        self._state[:, self._row[chosen]] = state

    def reset(self, bodies: Bodies = None) -> None:
        """Puts bodies at rest in the first contact mode, at time 0 and with an empty account.

        Raises:
            StepError: no such bodies.
        """
        chosen = self._chosen(bodies)
        self._state[:, self._row[chosen]] = 0
        self._account[:, chosen] = 0
        self._enter(chosen, np.zeros(len(chosen), dtype=int))

    def switch(self, contact: str | Sequence[str] | Array, bodies: Bodies = None) -> None:
        """Makes other contact modes active; states are projected, and never gain energy by it.

        Args:
            contact: one name, or one for each of the bodies.
            bodies: which.

        Raises:
            StepError: no such contact mode or bodies, or another number of names; all states are as they were.
        """
        chosen = self._chosen(bodies)
        names = [contact] if isinstance(contact, str) else list(contact)
        if not isinstance(contact, str) and len(names) != len(chosen):
            raise StepError(f"contact modes of {len(chosen)} bodies: one name or {len(chosen)}, given: {len(names)}")
        numbers = {name: k for k, name in enumerate(self._names)}
        for name in names:
            if name not in numbers:
                raise StepError(unknown("contact mode", str(name), self.rom.contact_models))
        end = np.broadcast_to([numbers[name] for name in names], chosen.shape)
        moves = end != self._mode[chosen]
        chosen, end = chosen[moves], end[moves]
        rows = self._row[chosen]
        before = self._energy(rows) if self._ledger else 0.0
        pairs = self._mode[chosen] * len(self._names) + end
        for pair in np.unique(pairs):
            those = rows[pairs == pair]
            self._state[:, those] = self._state[:, those] @ self._map(*divmod(int(pair), len(self._names)))
        self._enter(chosen, end)
        if self._ledger:
            self._account[LOST, chosen] += before - self._energy(rows)

    def step(self, u: ArrayLike, *, on_error: str = "raise") -> Array:
        """Advances all bodies by dt, each under its constant input.

        Args:
            u: (size, p) N, or (p,) for all: contact columns, filled up to the contact mode that has most, then the
                actuators'. Columns that a body's contact mode lacks do nothing, but must hold finite numbers, too.
            on_error: what becomes of bodies whose input is not finite or absurdly large: "raise" an error, or "hold"
                them still for this step, with state, time and account as they were, while the others go on.

        Returns:
            Indices of the bodies that were held still; mostly (0,).

        Raises:
            StepError: u has another shape, or a body's input is refused; the body and the step are named, all are as
                they were.
        """
        if on_error not in ("raise", "hold"):
            raise StepError(unknown("choice of on_error", on_error, ["raise", "hold"]))
        u, held = self._checked(u, on_error)
        chunks = self._chunks()
        if len(held):
            kept = self._state[:, self._row[held]], self._account[:, held]
        if self._surroundings is not None:
            u = np.hstack([u, self._loads(self._surroundings)])
        np.take(u, self._body, axis=0, out=self._u, mode="clip")  # the other modes of take go through a buffer
        for x, r, elastic, inertial, w, spare, parts in chunks:
            for part in parts:
                np.matmul(part.u, self._push[part.mode], out=part.w)
            np.multiply(elastic, x, out=spare)
            np.add(w, spare, out=w)
            np.multiply(inertial, r, out=spare)
            np.add(w, spare, out=w)
            for part in parts:
                coupling = self._coupling[part.mode]
                if self._ledger:
                    self._dissipation(part, coupling)
                if coupling is not None:
                    part.w[:] = np.matmul(part.w, coupling[0], out=part.spare)
                if self._ledger:
                    self._supply(part)
            np.add(x, w, out=x)
            np.subtract(w, r, out=r)
        self._account[TIME] += self._dt
        if self._ledger:
            self._account[SUPPLIED : DISSIPATED + 1] += self._dt / 2 * np.take(self._works, self._row, axis=1)
        self.steps += 1
        if len(held):
            self._state[:, self._row[held]], self._account[:, held] = kept
        return held

    def displacement(self, output: str) -> Array:
        """Displacements of a named output, (size, points, 3), m. Without a mesh: (size, rows).

        Raises:
            StepError: no such output.
        """
        return self._dt / 2 * self._read(0, output)

    def velocity(self, output: str) -> Array:
        """Velocities of a named output, (size, points, 3), m/s. Without a mesh: (size, rows).

        Raises:
            StepError: no such output.
        """
        return self._read(1, output)

    def shape(self, body: int) -> Array:
        """Displacement of every mesh node of one body, (nodes, 3), m. Without a mesh: all n displacements.

        Raises:
            StepError: no such body.
        """
        q, _ = self.state(body)
        coordinates = list(self.rom.contact_models.values())[self._mode[body]].coordinates
        return self.rom.reconstruct(coordinates @ q[0, : coordinates.shape[1]])

    def _chosen(self, bodies: Bodies) -> Array:
        """Indices of bodies."""
        if bodies is None:
            return np.arange(self.size)
        chosen = np.atleast_1d(bodies)
        if chosen.dtype == bool and chosen.shape == (self.size,):
            return np.flatnonzero(chosen)
        if chosen.size == 0:
            return np.empty(0, dtype=int)
        distinct = chosen.ndim == 1 and chosen.dtype.kind in "iu" and len(np.unique(chosen)) == len(chosen)
        if not (distinct and chosen.min() >= 0 and chosen.max() < self.size):
            raise StepError(f"bodies: allowed are None, a mask ({self.size},) or distinct indices below {self.size}")
        return chosen

    def _checked(self, u: ArrayLike, on_error: str) -> tuple[Array, Array]:
        """Inputs (size, p), and the bodies to hold still; theirs are zero then."""
        u = np.asarray(u)
        if u.shape not in ((self.size, self.inputs), (self.inputs,)):
            raise StepError(
                f"input: allowed are {self.inputs} numbers in N for each of {self.size} bodies, or for all; "
                f"given: an array of shape {u.shape}"
            )
        if u.dtype != self.dtype:
            with np.errstate(over="ignore"):
                u = u.astype(self.dtype)
        flat = u.ravel()
        u = np.broadcast_to(u, (self.size, self.inputs))
        if flat.dot(flat) <= self._limit**2:
            return u, np.empty(0, dtype=int)
        fine = (np.abs(u) <= self._limit).all(axis=1)  # NaN is not, either
        held = np.flatnonzero(~fine)
        if len(held) and on_error == "raise":
            raise StepError(
                f"step {self.steps}, body {held[0]}: input {u[held[0]].tolist()}: allowed are finite numbers within "
                f"{self._limit:.0e}, in N; all bodies were left as they were"
            )
        return np.where(fine[:, None], u, 0), held

    def _loads(self, surroundings: "ActiveEnvironment") -> Array:
        """Values of the loads that act by themselves in the middle of each body's step, (size, columns)."""
        times, which = np.unique(self._account[TIME], return_inverse=True)
        return np.array([surroundings.loads(time + self._dt / 2) for time in times])[which]

    def _enter(self, chosen: Array, modes: Array) -> None:
        if (self._mode[chosen] != modes).any():
            self._mode[chosen] = modes
            self._plan = None

    def _chunks(self) -> list[_Chunk]:
        """Rows as the step takes them: sorted by contact mode, moving as few as may be, coefficients written."""
        if self._plan is not None:
            return self._plan
        counts = np.bincount(self._mode, minlength=len(self._names))
        modes = np.repeat(np.arange(len(self._names)), counts)
        now = self._mode[self._body]
        places = np.flatnonzero(now != modes)
        sources = places[np.argsort(now[places], kind="stable")]
        self._state[:, places] = self._state[:, sources]
        self._body[places] = self._body[sources]
        self._row[self._body[places]] = places
        places = np.flatnonzero(self._written != modes)
        self._coefficients[:, places] = self._table[:, modes[places]]
        self._written = modes

        n = self._buffers.shape[1]
        cuts = np.union1d(np.arange(0, self.size, n), np.cumsum(counts)).tolist()
        self._plan = []
        for first in range(0, self.size, n):
            rows = slice(first, min(first + n, self.size))
            (x, r), (elastic, inertial) = self._state[:, rows], self._coefficients[:, rows]
            w, spare = self._buffers[:, : rows.stop - first]
            parts = []
            for a, b in pairwise(cut for cut in cuts if rows.start <= cut <= rows.stop):
                within = slice(a - first, b - first)
                parts.append(_Part(int(modes[a]), slice(a, b), self._u[a:b], w[within], spare[within]))
            self._plan.append(_Chunk(x, r, elastic, inertial, w, spare, parts))
        return self._plan

    def _dissipation(self, part: _Part, coupling: tuple[Array, Array] | None) -> None:
        """What a step dissipates, by the rows, with w = 2 v̂ in hand or what dense damping makes it of."""
        drawn = part.w if coupling is None else np.matmul(part.w, coupling[1], out=part.spare)
        np.multiply(drawn, drawn, out=part.spare)
        np.matmul(part.spare, self._drags[part.mode], out=self._works[1, part.rows])

    def _supply(self, part: _Part) -> None:
        """What the inputs supply in a step, by the rows, with w = 2 v̂ in hand."""
        force = np.matmul(part.u, self._G[part.mode], out=part.spare)
        np.multiply(force, part.w, out=force)
        np.matmul(force, self._ones, out=self._works[0, part.rows])

    def _booked(self, entry: int) -> Array:
        if not self._ledger:
            raise StepError("this batch keeps no energy account: allowed is that of Batch(..., ledger=True)")
        return self._account[entry].copy()

    def _energy(self, rows: slice | Array) -> Array:
        x, r = self._state[:, rows].astype(float)
        x *= self._dt / 2 * self._ω[self._mode[self._body[rows]]]
        return (np.einsum("bm,bm->b", x, x) + np.einsum("bm,bm->b", r, r)) / 2

    def _map(self, start: int, end: int) -> Array:
        """What takes the rows x and r of one contact mode to another's, (2, m, m)."""
        if (start, end) not in self._maps:
            e, r = self._projections.between(self._names[start], self._names[end])
            m = self._ω.shape[1]
            both = _filled(np.stack([e.T, r.T]), (2, m, m))
            rigid = self.rom.rigid
            both[0] *= self._ω[start][:, None] / np.where(self._ω[end] > 0, self._ω[end], np.inf)
            both[0, :rigid, :rigid] = np.eye(rigid)
            self._maps[start, end] = both.astype(self.dtype)
        return self._maps[start, end]

    def _read(self, part: int, output: str) -> Array:
        """An output of x (part 0) or r (part 1)."""
        if output not in self.rom.outputs:
            raise StepError(unknown("output", output, self.rom.outputs))
        chunks, m = self._chunks(), self._ω.shape[1]
        if output not in self._readers:
            maps = [(self.rom.outputs[output] @ mode.coordinates).T for mode in self.rom.contact_models.values()]
            self._readers[output] = [_filled(map, (m, map.shape[1])).astype(self.dtype) for map in maps]
        field = np.empty((self.size, len(self.rom.outputs[output])), self.dtype)
        for segment in (segment for chunk in chunks for segment in chunk.parts):
            np.matmul(self._state[part, segment.rows], self._readers[output][segment.mode], out=field[segment.rows])
        field = np.take(field, self._row, axis=0)
        return field.reshape(self.size, -1, 3) if len(self.rom.nodes) else field


def _filled(part: Array, shape: tuple[int, ...]) -> Array:
    """An array of that shape, zero beyond the part."""
    whole = np.zeros(shape)
    whole[tuple(slice(n) for n in part.shape)] = part
    return whole
