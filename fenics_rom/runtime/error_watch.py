"""How far a reduced run is from the full order: a bound, and an estimate, kept up while it runs.

Let x solve the full order's step, E s the finer model's (rom.error_model) and W q the reduced one's, of the same size
under the same inputs. With the finer model's mid-step residual ρ its error e = x - E s obeys M Δė/h + D ė̂ + K ê = ρ,
and the energy of that, H = ½ėᵀMė + ½eᵀKe, changes by

    H⁺ - H = h ė̂ᵀρ - h ė̂ᵀDė̂ <= h/4 ρᵀD⁻¹ρ,        so that        2H(t) <= 2H(0) + h/2 Σ ρᵀD⁻¹ρ

for any h and any residual. E s - W q is known: an estimate of the error of W q. In the energy norm that error is at
most as large as both together: a bound. Of an output c it is |cᵀ(E s - W q)| + (cᵀK⁻¹c)^½ √2H.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError, check_known, shown, unknown
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.error_blocks import Coordinates, take_blocks
from fenics_rom.runtime.error_maps import ErrorMaps
from fenics_rom.runtime.error_tolerance import Exceeded, OutputErrors
from fenics_rom.trajectory.error_series import OF

if TYPE_CHECKING:
    from fenics_rom.mechanics.touch import TouchState

BOUND = "the body is linear and damped, so that the residual of a finer model bounds what the estimate misses"
ESTIMATE = "a finer model, of {} displacements, takes the same steps"
SAME_FORCES = " under the same contact forces"
FORCES_DIFFER = (
    "a bound of the error is not known where obstacles touch the body: contact forces of the full order are others, "
    "which no residual tells; use the estimate"
)
NO_READING = "errors of readings are differences to a finer ROM beside; use Simulator(rom, dt, finer=better)"
PUT_IN = "; the full order is taken to begin in the state that was put in"


@dataclass(frozen=True)
class StatedError:
    """The error of a reduced run at an instant, against the full order with the same steps.

    Attributes:
        kind: "bound" or "estimate".
        why: it is one, in words.
        norm: in the energy norm, √(vᵀMv + xᵀKx) of the error; J^1/2. Of a batch (size,). None where it is not known.
        names: of the outputs that it is told of.
        shape: in the mass norm, √(xᵀMx) of the error of displacements, kg^1/2 m; of a batch (size,). None of a bound,
            or where it is not known.
        sensed: readings that it is told of.
        read: tells that of one of these; None where no finer ROM is beside.
    """

    kind: str
    why: str
    norm: float | Array | None
    names: tuple[str, ...]
    outputs: Callable[[str], Array] = field(repr=False)
    shape: float | Array | None = None
    sensed: Mapping[str, Any] = field(default_factory=dict, repr=False)
    read: Callable[[str], Array] | None = field(default=None, repr=False)

    def output(self, name: str) -> Array:
        """Of the displacement of a named output, m; in the shape that `displacement(name)` has.

        A bound is what no component is further off than. An estimate is to be added: full order less reduced.

        Raises:
            StepError: no such output; or none can be told of it, and why.
        """
        return self.outputs(name)

    def reading(self, name: str) -> Array:
        """Of a reading without its sensor, in the shape that `reading(name)` has, to be added: finer less reduced.

        Raises:
            StepError: no such reading, or no finer ROM beside, which alone finds contact forces of its own.
        """
        read = self._read_of(name)
        check_known("reading", name, self.sensed, StepError)
        return read(name)

    def touch(self, name: str) -> "TouchState":
        """Of what a sense of touch feels: forces, centre, area and pressures, to be added.

        Patches are compared in their order, so that it says nothing of them where others touch in the finer model.

        Raises:
            StepError: as of `reading`, or there is none of that name.
        """
        from fenics_rom.mechanics.touch import touch_of  # here, as few bodies have one

        return touch_of(self.sensed, name, self._read_of(name))

    def _read_of(self, name: str) -> Callable[[str], Array]:
        if self.read is None:
            raise StepError(f"reading {shown(name)}: {NO_READING}")
        return self.read


class ErrorState(NamedTuple):
    """What a run needs to go on from."""

    square: float  # bound of 2H, J
    finer: Array  # [e, r] (2f,) of the finer model
    from_rest: bool  # or from a state that was put in
    exceeded: Exceeded | None = None  # the tolerance, if there is one
    apart: Array | None = None  # [e, r] (2f,) of an error that does not count, as it goes on by itself


class ErrorWatch:
    """Of one run, which begins at rest.

    Args:
        rom: with an error model.
        maps: that runs of this ROM may share.
        tolerance: of outputs, m; None: whatever they are.

    Attributes:
        exceeded: where the estimate was first beyond the tolerance.
        last_inputs: (p,) of the last step that was taken in; None before the first.
    """

    saved_as = ErrorState

    def __init__(self, rom: Rom, maps: ErrorMaps, tolerance: float | None = None):
        assert rom.error_model is not None
        self._rom, self.maps, self._model = rom, maps, rom.error_model
        self._ω = np.sqrt(self._model.eigenvalues)
        self.last_inputs: Array | None = None
        self._ahead: tuple[Coordinates, Array] | None = None  # y of the finer model, if it is not known otherwise
        self.tolerance, self._outputs = tolerance, None if tolerance is None else OutputErrors(rom)
        self.state = ErrorState(0.0, np.zeros(2 * len(self._ω)), True)

    @property
    def _finer(self) -> Array:
        """[e, r] (2f,) of the finer model, from its coordinates where blocks of steps left it in these."""
        if self._ahead is not None:
            at, y = self._ahead
            self._finer = at.back @ y.view(float)
        return self._at

    @_finer.setter
    def _finer(self, state: Array) -> None:
        self._at, self._ahead = state, None

    @property
    def state(self) -> ErrorState:
        """To go on from."""
        return ErrorState(self._square, self._finer.copy(), self._from_rest, self.exceeded, self._apart)

    @state.setter
    def state(self, state: ErrorState) -> None:
        self._square, self._finer, self._from_rest = state.square, state.finer.copy(), state.from_rest
        self.exceeded, self._apart = state.exceeded, state.apart

    def begin(self, contact: str, state: Array) -> None:
        """Begins anew at a state [e, r] (2m,) of a contact mode, which the full order is taken to begin at, too."""
        self.state = ErrorState(0.0, self._lifted(contact, state), not state.any())

    def note(self, contact: str, h: float, inputs: Array) -> None:
        """Takes in steps of h s in a contact mode under inputs (n, p), and contact forces where there may be some."""
        if not len(inputs):
            return
        self.last_inputs = inputs[-1].copy()
        taken = self._note_blocks(contact, h, inputs) if len(inputs) > 1 else 0
        for one in inputs[taken:]:
            self._note_one(contact, h, one)

    def _note_blocks(self, contact: str, h: float, inputs: Array) -> int:
        """The same in blocks; how many steps they took."""
        at, taken, heard, silent = self.maps.coordinates(contact, h), 0, 0.0, 0.0
        if at is None:
            return 0
        given = self._ahead[1] if self._ahead and self._ahead[0] is at else (at.into @ self._finer).view(complex)
        y, loops = given.copy(), self.maps.in_loops(len(inputs))
        for block in self.maps.blocks(contact, h, len(inputs), loops=loops):
            times = (len(inputs) - taken) // block.length
            if times:
                steps = times * block.length
                sums = take_blocks(block, at.heard, y, inputs[taken : taken + steps].reshape(times, -1), loops)
                heard += sums[0]
                silent += block.silent**2 * sums[1]
                taken += steps
        self._ahead = at, y
        self._square += h / 2 * (math.sqrt(heard) + math.sqrt(silent)) ** 2
        return taken

    def _note_one(self, contact: str, h: float, inputs: Array) -> None:
        """The same of one step, with as few products as it takes."""
        carry, push, F = self.maps.step(contact, h)
        state = self._finer
        self._finer = carry.dot(state) + inputs.dot(push)
        if len(F):
            ρ = F.dot(np.concatenate((state, inputs)))
            self._square += h / 2 * float(ρ.dot(ρ))
        if self._apart is not None:
            self._apart = carry.dot(self._apart)

    def after_each(
        self, before: ErrorState, contact: str, h: float, inputs: Array, states: Array
    ) -> dict[str, dict[str, Array]]:
        """What is stated after each of some steps of h s that were taken in, as `stated_numbers` has it of an instant.

        Args:
            before: the state that they began with.
            contact: mode that they were in.
            h: s.
            inputs: (n, p).
            states: [e, r] of the reduced model, which they begin with and lead to, (n + 1, 2m).
        """
        carry, push, F = self.maps.step(contact, h)
        finer = np.empty((len(inputs) + 1, before.finer.size))
        finer[0] = before.finer
        for start, after, pushed in zip(finer[:-1], finer[1:], inputs.dot(push), strict=True):
            carry.dot(start, after)
            np.add(after, pushed, after)
        ρ, f = np.hstack([finer[:-1], inputs]) @ F.T, len(self._ω)
        missed = np.sqrt(before.square + h / 2 * np.cumsum(np.einsum("ij,ij->i", ρ, ρ)))
        by_e, by_r = self.maps.lift(contact)
        off = finer[1:] - np.hstack([states[1:, : by_e.shape[1]] @ by_e.T, states[1:, by_e.shape[1] :] @ by_r.T])
        norm, displacements = np.linalg.norm(off, axis=1), off[:, :f] / np.where(self._ω > 0, self._ω, np.inf)
        bound, estimate = {"norm": norm + missed}, {"norm": norm}
        if not self._model.couples_rigid_motions:
            estimate["shape"] = np.linalg.norm(displacements, axis=1)
            for name, rows in self._model.outputs.items():
                near = displacements @ rows.T
                estimate[OF + name] = self._rom.by_point(near)
                compliances = self._model.output_compliances[name]
                bound[OF + name] = self._rom.by_point(np.abs(near) + missed[:, None] * compliances)
        return {"bound": bound, "estimate": estimate}

    def look(self, contact: str, state: Array, beyond: Array | None, time: float) -> Exceeded | None:
        """Compares the estimate with the tolerance, at a time, s; what to say, the first time that it is larger.

        Other arguments as in `estimate`.
        """
        if self._outputs is None or self.tolerance is None or self.exceeded is not None:
            return None
        error, name = self._outputs.largest(contact, self._finer, state, beyond)
        if error <= self.tolerance:
            return None
        if self._apart is not None:
            since, _ = self._outputs.largest(contact, self._finer - self._apart, state, beyond)
            if since <= self.tolerance:
                return None
        self.exceeded = Exceeded(time, error, name)
        return self.exceeded

    def set_apart(self, contact: str, state: Array) -> None:
        """From now on a tolerance is for what comes to the error that there is, which goes on without inputs."""
        self._apart, self.exceeded = self._finer - self._lifted(contact, state), None

    def bound(self, contact: str, state: Array) -> StatedError:
        """What the error of a state [e, r] (2m,) of a contact mode is no larger than.

        Raises:
            StepError: obstacles may touch the body.
        """
        if self.maps.touched:
            raise StepError(FORCES_DIFFER)
        estimate, missed = self.estimate(contact, state), math.sqrt(self._square)
        assert estimate.norm is not None

        def of_output(name: str) -> Array:
            near = estimate.output(name)
            return np.abs(near) + missed * self._model.output_compliances[name].reshape(near.shape)

        return StatedError("bound", BOUND + self._start, estimate.norm + missed, estimate.names, of_output)

    def estimate(self, contact: str, state: Array, beyond: Array | None = None) -> StatedError:
        """About what the error of a state [e, r] (2m,) of a contact mode is.

        `beyond` (k,) is what contact points yield beside it, in the shared basis.
        """
        error = self._finer - self._lifted(contact, state)
        if beyond is not None:
            error[: len(self._ω)] -= self._ω * (self._model.coordinates @ beyond)

        def of_output(name: str) -> Array:
            if self._model.couples_rigid_motions:
                raise StepError(
                    f"output {name!r}: dashpots couple how the body moves as a whole with how it strains, and an error "
                    "of the former takes no energy; use the energy norm"
                )
            check_output(name, self._rom.outputs)
            return self._rom.by_point(self._model.outputs[name] @ displacements)

        displacements = error[: len(self._ω)] / np.where(self._ω > 0, self._ω, np.inf)
        known = not self._model.couples_rigid_motions
        names, shape = (
            (tuple(self._model.outputs), math.sqrt(displacements.dot(displacements))) if known else ((), None)
        )
        why = ESTIMATE.format(len(self._ω)) + self.maps.touched * SAME_FORCES + self._start
        return StatedError("estimate", why, math.sqrt(error.dot(error)), names, of_output, shape)

    @property
    def _start(self) -> str:
        return "" if self._from_rest else PUT_IN

    def _lifted(self, contact: str, state: Array) -> Array:
        by_e, by_r = self.maps.lift(contact)
        m = by_e.shape[1]
        return np.concatenate([by_e @ state[:m], by_r @ state[m:]])


def check_output(name: str, outputs: Mapping[str, Array]) -> None:
    """A StepError where there is no such output."""
    if not isinstance(name, str) or name not in outputs:
        raise StepError(unknown("output", name, outputs))
