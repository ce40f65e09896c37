"""Many soft bodies of one ROM, stepped together: each with its own contact mode, state, input and time.

The midpoint rule in x = 2 q / h and r, with w = 2 v̂ and a = (4/h) (2/h + D + h/2 γ)⁻¹, which no h makes large:

    w = a (h/2 G u + r - h²/4 γ x),   x⁺ = x + w,   r⁺ = w - r.

Where the damping is diagonal, so is a, and a step is a handful of elementwise operations on arrays of bodies × reduced
displacements. What this costs is memory traffic: bodies go through the step in chunks that stay in the cache. The rows
of all arrays are bodies sorted by contact mode, so that a force is one product for each mode of a chunk. A switch
projects the state where it is.
"""

from collections.abc import Mapping, Sequence
from copy import deepcopy
from typing import TYPE_CHECKING

import numpy as np
from numpy import ndarray as Array
from numpy.typing import ArrayLike, DTypeLike

from fenics_rom.errors import StepError, check_known
from fenics_rom.mechanics.signals import real_numbers
from fenics_rom.rom.given_rom import given_rom
from fenics_rom.rom.midpoint_map import checked_dt
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.batch_arrays import BatchLayout, Bodies, PaddedModels, Segment
from fenics_rom.runtime.environment_inputs import fit_loads

if TYPE_CHECKING:
    from os import PathLike

    from fenics_rom.mechanics.active_environment import SignalLike

TIME, SUPPLIED, DISSIPATED, LOST = range(4)


class Batch:
    """Steps many bodies of one ROM from rest, beginning in its first contact mode.

    `bodies` in the methods are None (all), a mask (size,) or distinct indices; arrays are in the order 0 .. size - 1.

    Args:
        rom: the reduced model, or the name of its file; it is only read, and copies of a batch share it.
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
        rom: "Rom | str | PathLike[str]",
        size: int,
        dt: float,
        *,
        dtype: DTypeLike = float,
        ledger: bool = False,
        signals: "Mapping[str, SignalLike] | None" = None,
    ):
        rom = given_rom("Batch", rom)
        if not (isinstance(size, int | np.integer) and size > 0):
            raise StepError(f"size = {size!r}: allowed is a whole number > 0")
        if np.dtype(dtype) not in (np.float64, np.float32):
            raise StepError(f"dtype = {dtype!r}: allowed are float64 and float32")
        rom, self._environment = fit_loads(rom, signals)
        if rom.deformation is not None:
            raise StepError(f"ROM {rom.name!r} has large deformation in its scene, which Simulator steps, one by one")
        self.rom, self.size, self.dtype = rom, int(size), np.dtype(dtype)
        self._models = PaddedModels(rom, self.dtype)
        modes, p, m = self._models.inputs.shape
        self._layout = BatchLayout(self.size, modes, m, p, self.dtype)
        self._number_limit = float(np.finfo(self._layout.state.dtype).max) ** 0.25
        self._ledger = ledger
        self._account = np.zeros((4, self.size))
        self._works = np.empty((2, self.size), self.dtype)
        self._ones = np.ones(m, self.dtype)
        self.steps = 0
        self._dt = 1.0
        self.dt = dt

    def __copy__(self) -> "Batch":
        return deepcopy(self)

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
        limit, ω, rigid = self._number_limit**2, self._models.frequencies, self.rom.rigid
        with np.errstate(over="ignore", invalid="ignore"):
            x = self._layout.state[0] * (self._dt / h)
            angles = h / 2 * ω
        if not (angles[:, rigid:].min() >= 1 / limit and angles.max() <= limit and np.abs(x).max() <= limit):
            raise StepError(f"dt = {dt!r}: too far from the model's periods for {self.dtype}")
        self._layout.state[0] = x
        self._layout.discard_coefficients()
        self._dt, self._coefficients = h, self._models.step_coefficients(h)
        # A step is passive: it adds at most h |G u| to the length of (ω q, r), and x is at most 2/(h ω) times that, or
        # along rigid motions twice that in each step.
        # So what bounds the inputs bounds the states, and nothing else needs to be looked at in a step: below this
        # limit no number overflows in the first `_number_limit` steps from rest, 4e9 of them in float32.
        gain = np.abs(self._models.inputs).sum(axis=(1, 2)) * np.maximum(h, 2 / ω[:, rigid:].min(axis=1))
        self._input_limit = self._number_limit / max(1.0, gain.max())

    @property
    def inputs(self) -> int:
        """Columns p of the input: those of the contact mode that has most, then the actuators'."""
        return self._models.contact_columns + sum(self.rom.actuators.values())

    @property
    def contact(self) -> Array:
        """Names (size,) of the active contact modes."""
        return np.array(self._models.names)[self._layout.mode]

    @property
    def time(self) -> Array:
        """Time (size,) since each body's last reset, s."""
        return self._account[TIME].copy()

    @property
    def energy(self) -> Array:
        """Stored energies ½ vᵀMv + ½ xᵀKx (size,), J."""
        energy = np.empty(self.size)
        energy[self._layout.body] = self._energy(slice(None))
        return energy

    @property
    def supplied(self) -> Array:
        """Work of the inputs (size,) since each body's last reset, J.

        Raises:
            StepError: the batch keeps no account, here as in the following.
        """
        return self._read_account(SUPPLIED)

    @property
    def dissipated(self) -> Array:
        """What damping took (size,), J; never negative."""
        return self._read_account(DISSIPATED)

    @property
    def lost_in_switching(self) -> Array:
        """What projections took (size,), J; negative only for oblique switching."""
        return self._read_account(LOST)

    def state(self, bodies: Bodies = None) -> tuple[Array, Array]:
        """Reduced displacements q and velocities r, (bodies, m) each; zero beyond the order of a body's contact mode.

        Raises:
            StepError: no such bodies.
        """
        x, r = self._layout.state[:, self._layout.row[self._layout.select(bodies)]].astype(float)
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
        selected = self._layout.select(bodies)
        ω, modes = self._models.frequencies, self._layout.mode[selected]
        shape = (len(selected), ω.shape[1])
        parts = [real_numbers(part) for part in (q, r)]
        if any(part.shape not in (shape, shape[1:]) for part in parts):
            raise StepError(f"state: allowed are two arrays of shape {shape}, given: {[part.shape for part in parts]}")
        state = np.stack([np.broadcast_to(part, shape) for part in parts])
        with np.errstate(over="ignore"):
            state[0] *= 2 / self._dt
            size = np.abs(state) * np.maximum(1.0, [self._dt / 2 * ω[modes], np.ones(shape)])
        if not (size <= self._number_limit).all():  # NaN is not, either
            raise StepError(
                f"state: allowed are finite numbers, within {self._number_limit:.0e} in 2 q / dt, √γ q and r"
            )
        if state[:, np.arange(shape[1]) >= self._models.orders[modes, None]].any():
            raise StepError("state: beyond the order of a body's contact mode only zeros are allowed")
        self._layout.state[:, self._layout.row[selected]] = state

    def reset(self, bodies: Bodies = None) -> None:
        """Puts bodies at rest in the first contact mode, at time 0 and with an empty account.

        Raises:
            StepError: no such bodies.
        """
        selected = self._layout.select(bodies)
        self._layout.reset(selected)
        self._account[:, selected] = 0

    def switch(self, contact: str | Sequence[str] | Array, bodies: Bodies = None) -> None:
        """Makes other contact modes active; states are projected, and never gain energy by it.

        Args:
            contact: one name, or one for each of the bodies.
            bodies: which.

        Raises:
            StepError: no such contact mode or bodies, or another number of names; all states are as they were.
        """
        selected = self._layout.select(bodies)
        names = [contact] if isinstance(contact, str) else list(contact)
        if not isinstance(contact, str) and len(names) != len(selected):
            raise StepError(
                f"contact modes of {len(selected)} bodies: one name or {len(selected)}, given: {len(names)}"
            )
        numbers = {name: k for k, name in enumerate(self._models.names)}
        for name in names:
            check_known("contact mode", str(name), numbers, StepError)
        start, end = self._layout.mode[selected], np.broadcast_to([numbers[name] for name in names], selected.shape)
        moves = end != start
        selected, start, end = selected[moves], start[moves], end[moves]
        state, rows = self._layout.state, self._layout.row[selected]
        before = self._energy(rows) if self._ledger else 0.0
        pairs = start * len(numbers) + end
        for pair in np.unique(pairs):
            moved = rows[pairs == pair]
            state[:, moved] = state[:, moved] @ self._models.switch_map(*divmod(int(pair), len(numbers)))
        self._layout.enter(selected, end)
        if self._ledger:
            self._account[LOST, selected] += before - self._energy(rows)

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
        check_known("choice of on_error", on_error, ("raise", "hold"), StepError)
        u, held = self._check_input(u, on_error)
        layout, (factors, push, couplings) = self._layout, self._coefficients
        chunks = layout.sort(factors)
        if len(held):
            before = layout.state[:, layout.row[held]], self._account[:, held]
        if self._environment is not None:
            times, which = np.unique(self._account[TIME], return_inverse=True)
            loads = np.array([self._environment.loads_at(time + self._dt / 2) for time in times])
            u = np.hstack([u, loads[which]])
        np.take(u, layout.body, axis=0, out=layout.inputs, mode="clip")  # the other modes of take go through a buffer
        for x, r, elastic, inertial, w, spare, segments in chunks:
            for segment in segments:
                np.matmul(segment.u, push[segment.mode], out=segment.w)
            np.multiply(elastic, x, out=spare)
            np.add(w, spare, out=w)
            np.multiply(inertial, r, out=spare)
            np.add(w, spare, out=w)
            for segment in segments:
                coupling = couplings[segment.mode]
                if self._ledger:
                    self._measure_dissipation(segment, coupling)
                if coupling is not None:
                    segment.w[:] = np.matmul(segment.w, coupling[0], out=segment.spare)
                if self._ledger:
                    self._measure_supply(segment)
            np.add(x, w, out=x)
            np.subtract(w, r, out=r)
        self._account[TIME] += self._dt
        if self._ledger:
            self._account[SUPPLIED : DISSIPATED + 1] += self._dt / 2 * np.take(self._works, layout.row, axis=1)
        self.steps += 1
        if len(held):
            layout.state[:, layout.row[held]], self._account[:, held] = before
        return held

    def displacement(self, output: str) -> Array:
        """Displacements of a named output, (size, points, 3), m. Without a mesh: (size, rows).

        Raises:
            StepError: no such output.
        """
        return self._dt / 2 * self._read_output(0, output)

    def velocity(self, output: str) -> Array:
        """Velocities of a named output, (size, points, 3), m/s. Without a mesh: (size, rows).

        Raises:
            StepError: no such output.
        """
        return self._read_output(1, output)

    def shape(self, body: int) -> Array:
        """Displacement of every mesh node of one body, (nodes, 3), m. Without a mesh: all n displacements.

        Raises:
            StepError: no such body.
        """
        q, _ = self.state(body)
        coordinates = list(self.rom.contact_models.values())[self._layout.mode[body]].coordinates
        return self.rom.reconstruct(coordinates @ q[0, : coordinates.shape[1]])

    def reading(self, name: str) -> Array:
        """A reading of every body, (size, ...), as `Simulator.reading` has it of one; bodies are read one by one.

        Raises:
            StepError: no such reading.
        """
        from fenics_rom.runtime.readings import read_each  # here, as few bodies have readings

        return read_each(self.rom, name, self.contact, self.state()[0])

    def _check_input(self, u: ArrayLike, on_error: str) -> tuple[Array, Array]:
        """Inputs (size, p), and the bodies to hold still; theirs are zero then."""
        u = np.asarray(u)
        if u.shape not in ((self.size, self.inputs), (self.inputs,)):
            raise StepError(
                f"input: allowed are {self.inputs} numbers in N for each of {self.size} bodies, or for all; "
                f"given: an array of shape {u.shape}"
            )
        if u.dtype.kind not in "fiub":
            raise StepError(f"input: allowed are real numbers in N, given: an array of {u.dtype}")
        if u.dtype != self.dtype:
            with np.errstate(over="ignore"):
                u = u.astype(self.dtype)
        flat = u.ravel()
        u = np.broadcast_to(u, (self.size, self.inputs))
        if flat.dot(flat) <= self._input_limit**2:
            return u, np.empty(0, dtype=int)
        allowed = (np.abs(u) <= self._input_limit).all(axis=1)  # NaN is not, either
        held = np.flatnonzero(~allowed)
        if len(held) and on_error == "raise":
            raise StepError(
                f"step {self.steps}, body {held[0]}: input {u[held[0]].tolist()}: allowed are finite numbers within "
                f"{self._input_limit:.0e}, in N; all bodies were left as they were"
            )
        return np.where(allowed[:, None], u, 0), held

    def _measure_dissipation(self, segment: Segment, coupling: tuple[Array, Array] | None) -> None:
        """What a step dissipates, by the rows, with w = 2 v̂ in hand or what dense damping makes it of."""
        drawn = segment.w if coupling is None else np.matmul(segment.w, coupling[1], out=segment.spare)
        np.multiply(drawn, drawn, out=segment.spare)
        np.matmul(segment.spare, self._models.dissipation[segment.mode], out=self._works[1, segment.rows])

    def _measure_supply(self, segment: Segment) -> None:
        """What the inputs supply in a step, by the rows, with w = 2 v̂ in hand."""
        force = np.matmul(segment.u, self._models.inputs[segment.mode], out=segment.spare)
        np.multiply(force, segment.w, out=force)
        np.matmul(force, self._ones, out=self._works[0, segment.rows])

    def _read_account(self, entry: int) -> Array:
        if not self._ledger:
            raise StepError("this batch keeps no energy account: allowed is that of Batch(..., ledger=True)")
        return self._account[entry].copy()

    def _energy(self, rows: slice | Array) -> Array:
        x, r = self._layout.state[:, rows].astype(float)
        x *= self._dt / 2 * self._models.frequencies[self._layout.mode[self._layout.body[rows]]]
        return (np.einsum("bm,bm->b", x, x) + np.einsum("bm,bm->b", r, r)) / 2

    def _read_output(self, part: int, output: str) -> Array:
        """An output of x (part 0) or r (part 1)."""
        maps, layout = self._models.output_maps(output), self._layout
        field = np.empty((self.size, maps[0].shape[1]), self.dtype)
        for chunk in layout.sort(self._coefficients.factors):
            for segment in chunk.segments:
                np.matmul(layout.state[part, segment.rows], maps[segment.mode], out=field[segment.rows])
        field = np.take(field, layout.row, axis=0)
        return field.reshape(self.size, -1, 3) if len(self.rom.nodes) else field
