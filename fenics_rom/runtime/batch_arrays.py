"""The arrays of a batch: models of one shape, and bodies in rows sorted by contact mode, in chunks that fit the cache.

Models of lower order are filled with zeros. The coefficients of a step are written out for every row, so that
elementwise products need no gathering. A switch only says which contact mode a body is in; before the next step, the
few rows that are then in another mode's place change places.
"""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray as Array
from numpy.typing import ArrayLike

from fenics_rom.errors import StepError, check_known, shown
from fenics_rom.mechanics.base_path import UNIT_TOLERANCE, BaseState
from fenics_rom.mechanics.signals import hides_numbers, real_numbers
from fenics_rom.rom.midpoint_map import compliance
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.switching import Projections

Bodies = int | Sequence[int] | Sequence[bool] | Array | None

CHUNK_BYTES = 1 << 19  # that the six arrays of a chunk may fill: half of a usual second-level cache
KEPT_BYTES = 31 << 20  # as large as arrays of a step, or larger; glibc heeds less than 32 MB


def keep_freed_memory() -> None:
    """Has the C library keep memory that a step frees, and the next one asks for again.

    glibc returns it to the system, which clears its pages anew for every step, a quarter of the time of one; but not
    where so large an array was freed before.
    """
    np.empty(KEPT_BYTES, np.uint8)


def distinct(times: Array) -> tuple[Array, Array]:
    """The instants among times (size,), and which of them each is; mostly one, as of bodies that began together."""
    if times.min() == times.max():
        return times[:1], np.zeros(len(times), int)
    instants, which = np.unique(times, return_inverse=True)
    return instants, which


def select_bodies(bodies: Bodies, size: int) -> Array:
    """Indices of bodies; a StepError where they are not None (all), a mask or distinct indices."""
    if bodies is None:
        return np.arange(size)
    try:
        selected = np.atleast_1d(bodies)
    except ValueError:  # rows of several lengths
        selected = np.atleast_2d(np.nan)
    if selected.dtype == bool and selected.shape == (size,):
        return np.flatnonzero(selected)
    if selected.size == 0:
        return np.empty(0, dtype=int)
    is_distinct = selected.ndim == 1 and selected.dtype.kind in "iu" and len(np.unique(selected)) == len(selected)
    if not (is_distinct and selected.min() >= 0 and selected.max() < size):
        raise StepError(f"bodies: use None, a mask ({size},) or distinct indices below {size}")
    return selected


def checked_inputs(
    u: ArrayLike, shape: tuple[int, int], dtype: np.dtype, limit: float, step: int, on_error: str
) -> tuple[Array, Array]:
    """Inputs (size, p) within a limit of the step with a number, and the bodies to hold still; theirs are zero then.

    Raises:
        StepError: they are of another shape or no real numbers; or, if that is asked for, a body's are refused.
    """
    size, inputs = shape
    if type(u) is not Array and hides_numbers(u):
        raise StepError("input: use numbers in N (got an array that masks some of them)")
    try:
        u = np.asarray(u)
    except ValueError:
        raise StepError(f"input: use {inputs} numbers in N (got rows of several lengths)") from None
    if u.shape not in (shape, (inputs,)):
        raise StepError(
            f"input: use {inputs} numbers in N for each of {size} bodies, or for all (got an array of shape {u.shape})"
        )
    if u.dtype.kind not in "fiub":
        raise StepError(f"input: use real numbers in N (got an array of {u.dtype})")
    if u.dtype != dtype:
        with np.errstate(over="ignore"):
            u = u.astype(dtype)
    flat = u.ravel()
    u = np.broadcast_to(u, shape)
    if flat.dot(flat) <= limit**2:
        return u, np.empty(0, dtype=int)
    allowed = (np.abs(u) <= limit).all(axis=1)  # NaN is not, either
    held = np.flatnonzero(~allowed)
    if len(held) and on_error == "raise":
        raise StepError(
            f"step {step}, body {held[0]}: input {u[held[0]].tolist()}: use finite numbers within "
            f"{limit:.0e}, in N; all bodies were left as they were"
        )
    return np.where(allowed[:, None], u, 0), held


def inputs_by_name(given: Mapping[str, Any], rom: Rom, contact: Array) -> Array:
    """Inputs (size, p) of a mapping, of bodies in contact modes (size,).

    Raises:
        StepError: a name that is none, or of a contact mode that no body is in; or numbers of another shape.
    """
    size, end = len(contact), max(rom.contacts.values())
    places = {f"contact-{name}" if name in rom.actuators else name: (0, n, name) for name, n in rom.contacts.items()}
    for name, columns in rom.actuators.items():
        places[name], end = (end, columns, ""), end + columns
    u = np.zeros((size, end))
    for name, value in given.items():
        check_known("input", name, places, StepError)
        start, columns, mode = places[name]
        rows = contact == mode if mode else np.ones(size, dtype=bool)
        if not rows.any():
            raise StepError(f"input {name!r}: no body is in that contact mode; switch some to it first")
        try:
            numbers = real_numbers(value)
            numbers = numbers[:, None] if columns == 1 and numbers.shape == (size,) else numbers
            numbers = np.broadcast_to(numbers, (size, columns)) if numbers.ndim else np.full((size, 1), numbers)
        except (TypeError, ValueError):
            numbers = np.empty(0)
        if numbers.shape != (size, columns):
            raise StepError(f"input {name!r}: use {columns} real numbers, or ({size}, {columns}) (got {shown(value)})")
        u[rows, start : start + columns] = numbers[rows]
    return u


def checked_bases(base: object, count: int, where: str) -> tuple[BaseState, Array]:
    """Bases of so many bodies, as arrays of all, and which of these no base can have.

    Raises:
        StepError: arrays of other shapes.
    """
    try:
        parts = [real_numbers(part) for part in base]  # type: ignore[attr-defined]
    except (TypeError, ValueError):
        parts = []
    widths = 3, 4, 3, 3
    if len(parts) != 4 or any(
        part.shape not in ((width,), (count, width)) for part, width in zip(parts, widths, strict=True)
    ):
        raise StepError(
            f"{where}: use a BaseState of position, m, rotation, w x y z, velocity, m/s, and angular "
            f"velocity, rad/s, with arrays of shapes ({count}, 3) and ({count}, 4), or those of one base for all"
        )
    position, rotation, velocity, turning = (
        np.broadcast_to(part, (count, width)) for part, width in zip(parts, widths, strict=True)
    )
    length = np.sqrt(np.einsum("bi,bi->b", rotation, rotation))
    sound = np.abs(length - 1) <= UNIT_TOLERANCE  # NaN is not, either
    sound &= np.isfinite(np.hstack([position, velocity, turning])).all(axis=1)
    return BaseState(position, rotation, velocity, turning), (~sound).nonzero()[0]


def stacked_state(q: Array, r: Array, shape: tuple[int, int]) -> Array:
    """(2, bodies, m) of what was given as the state of bodies; a StepError where that has another shape."""
    if any(part.shape not in (shape, shape[1:]) for part in (q, r)):
        raise StepError(f"state: use two arrays of shape {shape} (got {[q.shape, r.shape]})")
    return np.stack([np.broadcast_to(part, shape) for part in (q, r)])


class StepCoefficients(NamedTuple):
    """What a step of one length multiplies with, for each of c contact models."""

    factors: Array  # (2, c, m) of x and of r: -a h²/4 γ and a, or without a where that is dense
    push: Array  # (c, p, m) a h/2 G
    coupling: list[tuple[Array, Array] | None]  # where the damping is dense, aᵀ (m, m) and (R a)ᵀ (m, m)


class PaddedModels:
    """The c contact models of a ROM, with the largest of their orders m and of their contact columns."""

    def __init__(self, rom: Rom, dtype: np.dtype):
        self._rom, self._dtype = rom, dtype
        models = rom.contact_models.values()
        self.names = list(rom.contact_models)
        self.contact_columns = max(rom.contacts.values())
        self.orders = np.array([model.order for model in models])
        m = self.orders.max()
        p = self.contact_columns + sum(rom.actuators.values()) + sum(rom.loads.values())
        self.frequencies = np.ones((len(self.names), m))  # ω = √γ, rad/s; 1 where a model has less, as there x = 0
        self.inputs = np.zeros((len(self.names), p, m), dtype)  # G
        for ω, G, model, contact in zip(self.frequencies, self.inputs, models, rom.contacts.values(), strict=True):
            ω[: model.order] = np.sqrt(model.eigenvalues)
            G[:contact, : model.order] = model.inputs[:, :contact].T
            G[self.contact_columns :, : model.order] = model.inputs[:, contact:].T
        # What makes wᵀDw/2 of the squares of w, or of those of R w where D is dense.
        self.dissipation = [
            (_pad(model.damping / 2, (m,)) if model.damping.ndim == 1 else np.ones(m) / 2).astype(dtype)
            for model in models
        ]
        self._projections = Projections(rom)
        self._switch_maps: dict[tuple[int, int], Array] = {}
        self._output_maps: dict[str, list[Array]] = {}

    def step_coefficients(self, h: float) -> StepCoefficients:
        """Those of steps of length h, s."""
        factors, push = np.zeros((2, *self.frequencies.shape), self._dtype), np.empty(self.inputs.shape, self._dtype)
        coupling: list[tuple[Array, Array] | None] = []
        for k, model in enumerate(self._rom.contact_models.values()):
            a, Ra = (4 / h * part for part in compliance(model, h))
            dense = a.ndim == 2
            angles = h / 2 * self.frequencies[k]
            diagonal = _pad(np.ones(model.order) if dense else a, angles.shape)
            factors[:, k] = -diagonal * angles**2, diagonal
            push[k] = diagonal * (h / 2 * self.inputs[k])
            square = (len(diagonal),) * 2
            maps = [_pad(part.T, square).astype(self._dtype) for part in (a, Ra)] if dense else None
            coupling.append(None if maps is None else (maps[0], maps[1]))
        return StepCoefficients(factors, push, coupling)

    def switch_map(self, start: int, end: int) -> Array:
        """What takes the rows x and r of one contact mode to another's, (2, m, m)."""
        if (start, end) not in self._switch_maps:
            potential, kinetic = self._projections.between(self.names[start], self.names[end])
            m, rigid = self.frequencies.shape[1], self._rom.rigid
            maps = _pad(np.stack([potential.T, kinetic.T]), (2, m, m))
            ω = self.frequencies[end]
            maps[0] *= self.frequencies[start][:, None] / np.where(ω > 0, ω, np.inf)
            maps[0, :rigid, :rigid] = np.eye(rigid)
            self._switch_maps[start, end] = maps.astype(self._dtype)
        return self._switch_maps[start, end]

    def output_maps(self, output: str) -> list[Array]:
        """What takes rows of each contact mode to a named output, (m, rows); a StepError where there is none."""
        check_known("output", output, self._rom.outputs, StepError)
        if output not in self._output_maps:
            rows, m = self._rom.outputs[output], self.frequencies.shape[1]
            maps = [(rows @ model.coordinates).T for model in self._rom.contact_models.values()]
            self._output_maps[output] = [_pad(map, (m, map.shape[1])).astype(self._dtype) for map in maps]
        return self._output_maps[output]


def _pad(part: Array, shape: tuple[int, ...]) -> Array:
    """An array of that shape, zero beyond the part."""
    whole = np.zeros(shape)
    whole[tuple(slice(n) for n in part.shape)] = part
    return whole


class Segment(NamedTuple):
    """The bodies of a chunk that are in the same contact mode; arrays are views."""

    mode: int
    rows: slice
    u: Array
    w: Array
    spare: Array


class Chunk(NamedTuple):
    """Rows that go through the step together; arrays are views, (rows, m)."""

    x: Array
    r: Array
    elastic: Array
    inertial: Array
    w: Array
    spare: Array
    segments: list[Segment]


class BatchLayout:
    """The rows of all bodies, which begin in the first contact mode.

    `mode` and `row` (size,) are of each body, `body` (size,) of each row; `state` (2, size, m), which is x and r, and
    `inputs` (size, p), N, are in the order of the rows.
    """

    def __init__(self, size: int, modes: int, order: int, inputs: int, dtype: np.dtype):
        self.mode, self.row, self.body = np.zeros(size, dtype=int), np.arange(size), np.arange(size)
        self.state = np.zeros((2, size, order), dtype)
        self.inputs = np.empty((size, inputs), dtype)
        self._modes = modes
        self._coefficients = np.empty((2, size, order), dtype)
        self._written = np.full(size, -1)  # the mode whose coefficients are in each row
        self._chunks: list[Chunk] | None = None  # None: rows are not sorted, or coefficients not written
        chunks = -(-6 * size * order * dtype.itemsize // CHUNK_BYTES)
        self._buffers = np.empty((2, -(-size // chunks), order), dtype)

    def __getstate__(self) -> dict[str, Any]:
        return vars(self) | {"_chunks": None}  # its views would be copies of their own

    def enter(self, bodies: Array, modes: Array) -> None:
        """Says which contact modes bodies are in from now on."""
        if (self.mode[bodies] != modes).any():
            self.mode[bodies] = modes
            self._chunks = None

    def reset(self, bodies: Array) -> None:
        """Puts bodies at rest in the first contact mode; all of them go on as those of a new batch, to the bit."""
        self.state[:, self.row[bodies]] = 0
        self.enter(bodies, np.zeros(len(bodies), dtype=int))
        if len(bodies) == len(self.body):  # products round by the place of a row
            self.row[:] = self.body[:] = np.arange(len(bodies))
            self._chunks = None

    def discard_coefficients(self) -> None:
        """Has the coefficients written anew before the next step."""
        self._written[:] = -1
        self._chunks = None

    def sort(self, factors: Array) -> list[Chunk]:
        """The chunks of the next step, by its factors (2, modes, m); as few rows as may be change places."""
        if self._chunks is not None:
            return self._chunks
        counts = np.bincount(self.mode, minlength=self._modes)
        modes = np.repeat(np.arange(self._modes), counts)
        now = self.mode[self.body]
        places = np.flatnonzero(now != modes)
        sources = places[np.argsort(now[places], kind="stable")]
        self.state[:, places] = self.state[:, sources]
        self.body[places] = self.body[sources]
        self.row[self.body[places]] = places
        places = np.flatnonzero(self._written != modes)
        self._coefficients[:, places] = factors[:, modes[places]]
        self._written = modes
        self._chunks = self._cut(modes, counts)
        return self._chunks

    def _cut(self, modes: Array, counts: Array) -> list[Chunk]:
        """Chunks of sorted rows, whose contact modes are given, (size,), and how many rows each has."""
        size, length = len(modes), self._buffers.shape[1]
        bounds = np.union1d(np.arange(0, size, length), np.cumsum(counts)).tolist()
        chunks = []
        for first in range(0, size, length):
            rows = slice(first, min(first + length, size))
            (x, r), (elastic, inertial) = self.state[:, rows], self._coefficients[:, rows]
            w, spare = self._buffers[:, : rows.stop - first]
            segments = []
            for start, stop in pairwise(bound for bound in bounds if rows.start <= bound <= rows.stop):
                within = slice(start - first, stop - first)
                mode = int(modes[start])
                segments.append(Segment(mode, slice(start, stop), self.inputs[start:stop], w[within], spare[within]))
            chunks.append(Chunk(x, r, elastic, inertial, w, spare, segments))
        return chunks
