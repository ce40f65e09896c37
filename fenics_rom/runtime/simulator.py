"""A soft body in real time: the reduced model of the active contact mode, stepped, switched and accounted for."""

import math
from collections.abc import Sequence

import numpy as np

from fenics_rom.errors import StepError
from fenics_rom.ledger import Ledger
from fenics_rom.rom import Mode, Rom
from fenics_rom.runtime.midpoint import Midpoint
from fenics_rom.runtime.switching import energy_orthogonal, oblique
from fenics_rom.schema import unknown

Array = np.ndarray


class Simulator:
    """Steps a ROM from rest, beginning in its first contact mode.

    Args:
        rom: the reduced model; it is only read.
        dt: time step, s; may be set anew before any step.
        ledger: whether to keep the energy account.

    Raises:
        StepError: dt is not a positive finite number.
    """

    def __init__(self, rom: Rom, dt: float, *, ledger: bool = True):
        self.rom = rom
        self.time = 0.0
        self.ledger = Ledger() if ledger else None
        self._steppers: dict[str, Midpoint] = {}
        self._maps: dict[tuple[str, str], tuple[Array, Array]] = {}
        self.dt = dt
        self._enter(next(iter(rom.modes)))
        self._q = np.zeros(self._mode.order)
        self._r = np.zeros(self._mode.order)

    @property
    def dt(self) -> float:
        """Time step, s."""
        return self._dt

    @dt.setter
    def dt(self, dt: float) -> None:
        if not (isinstance(dt, int | float | np.number) and math.isfinite(dt) and dt > 0):
            raise StepError(f"dt = {dt!r}: allowed is a finite number > 0, in s")
        self._dt = float(dt)
        self._steppers.clear()

    @property
    def contact(self) -> str:
        """The active contact mode."""
        return self._contact

    @property
    def inputs(self) -> int:
        """Length of the input: the contact mode's columns, then the actuators'."""
        return int(self._mode.inputs.shape[1])

    @property
    def state(self) -> tuple[Array, Array]:
        """Copies of the reduced displacement q and velocity r of the active contact mode, (m,) each."""
        return self._q.copy(), self._r.copy()

    @state.setter
    def state(self, state: tuple[Sequence[float] | Array, Sequence[float] | Array]) -> None:
        given = [np.array(part, dtype=float) for part in state]
        shape = (self._mode.order,)
        if len(given) != 2 or any(part.shape != shape or not np.isfinite(part).all() for part in given):
            raise StepError(f"state: allowed are two finite arrays of shape {shape}, given: {[p.shape for p in given]}")
        self._q, self._r = given

    @property
    def energy(self) -> float:
        """Stored energy ½ vᵀMv + ½ xᵀKx, J."""
        return _energy(self._mode, self._q, self._r)

    def displacement(self, output: str | None = None) -> Array:
        """Displacement, m: of a named output (points, 3), or of every mesh node (nodes, 3).

        Without a mesh: the rows of the output, or all n displacements.

        Raises:
            StepError: no such output.
        """
        return self._field(self._q, output)

    def velocity(self, output: str | None = None) -> Array:
        """Velocity, m/s: of a named output (points, 3), or of every mesh node (nodes, 3).

        Raises:
            StepError: no such output.
        """
        return self._field(self._r, output)

    def switch(self, contact: str) -> None:
        """Makes another contact mode active; the state is projected, and never gains energy by it.

        Raises:
            StepError: no such contact mode.
        """
        if contact not in self.rom.modes:
            raise StepError(unknown("contact mode", contact, self.rom.modes))
        if contact == self._contact:
            return
        before = self.energy if self.ledger is not None else 0.0
        displacement, velocity = self._switch_maps(self._contact, contact)
        self._q, self._r = displacement @ self._q, velocity @ self._r
        self._enter(contact)
        if self.ledger is not None:
            self.ledger.lost_in_switching += before - self.energy

    def step(self, u: Sequence[float] | Array) -> None:
        """Advances by dt under a constant input.

        Args:
            u: (p,) N; the contact mode's columns, then the actuators'.

        Raises:
            StepError: wrong length, or not finite; the state is as it was.
        """
        u = np.asarray(u, dtype=float)
        if u.shape != (self.inputs,):
            raise StepError(
                f"input of contact mode {self._contact!r}: allowed are {self.inputs} numbers in N, "
                f"given: an array of shape {u.shape}"
            )
        stepper = self._stepper()
        h = self._dt
        np.dot(self._mode.inputs, u, out=self._force)
        v = stepper.representative_velocity(self._q, self._r, self._force)
        if not math.isfinite(v.dot(v)):
            raise StepError(f"input {u.tolist()} leads out of the finite numbers; the state was left as it was")
        if self.ledger is not None:
            self.ledger.supplied += h * float(self._force.dot(v))
            self.ledger.dissipated += h * stepper.dissipation(v)
        np.multiply(2.0, v, out=self._force)  # its work is booked; the step allocates nothing
        np.subtract(self._force, self._r, out=self._r)
        v *= h
        self._q += v
        self.time += h

    def _enter(self, contact: str) -> None:
        self._contact = contact
        self._mode = self.rom.modes[contact]
        self._force = np.empty(self._mode.order)

    def _stepper(self) -> Midpoint:
        if self._contact not in self._steppers:
            self._steppers[self._contact] = Midpoint(self._mode, self._dt)
        return self._steppers[self._contact]

    def _switch_maps(self, start: str, end: str) -> tuple[Array, Array]:
        if (start, end) not in self._maps:
            one, other = self.rom.modes[start], self.rom.modes[end]
            self._maps[start, end] = (
                oblique(one, other) if self.rom.switching == "oblique" else energy_orthogonal(self.rom, one, other)
            )
        return self._maps[start, end]

    def _field(self, coordinates: Array, output: str | None) -> Array:
        shared = self._mode.coordinates @ coordinates
        if output is not None:
            if output not in self.rom.outputs:
                raise StepError(unknown("output", output, self.rom.outputs))
            read = self.rom.outputs[output] @ shared
            return read.reshape(-1, 3) if len(self.rom.nodes) else read
        if not len(self.rom.nodes):
            return self.rom.basis @ shared
        field = np.zeros(3 * len(self.rom.nodes))
        field[self.rom.free] = self.rom.basis @ shared
        return field.reshape(-1, 3)


def _energy(mode: Mode, q: Array, r: Array) -> float:
    return float(r.dot(r) + q.dot(mode.eigenvalues * q)) / 2
