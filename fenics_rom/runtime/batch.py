"""Many soft bodies of one ROM, stepped together: each with its own contact mode, state, input and time.

The midpoint rule in x = 2 q / h and r, with w = 2 v̂ and a = (4/h) (2/h + D + h/2 γ)⁻¹, which no h makes large:

    w = a (h/2 G u + r - h²/4 γ x),   x⁺ = x + w,   r⁺ = w - r.

Where the damping is diagonal, so is a, and a step is a handful of elementwise operations on arrays of bodies × reduced
displacements. What this costs is memory traffic: bodies go through the step in chunks that stay in the cache. The rows
of all arrays are bodies sorted by contact mode, so that a force is one product for each mode of a chunk. A switch
projects the state where it is.

Bodies that an obstacle may be within reach of take their step again, with contact (`batch_contact.py`). Those that
bend far (`batch_deformation.py`) or that a base carries (`batch_carried.py`) take one of another kind.
"""

from collections.abc import Mapping, Sequence
from copy import deepcopy
from typing import TYPE_CHECKING

import numpy as np
from numpy import ndarray as Array
from numpy.typing import ArrayLike, DTypeLike

from fenics_rom.arguments import check_flag, is_number, mapping_in, names_in
from fenics_rom.errors import StepError, check_known, shown
from fenics_rom.mechanics.signals import real_numbers_or_nan
from fenics_rom.rom.given_rom import given_rom
from fenics_rom.rom.midpoint_map import checked_dt
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.batch_arrays import BatchLayout, Bodies, PaddedModels, keep_freed_memory
from fenics_rom.runtime.batch_step import SteppedBodies
from fenics_rom.runtime.batched_bodies import LOST, TIME
from fenics_rom.runtime.environment_inputs import fit_batch

if TYPE_CHECKING:
    from os import PathLike

    from fenics_rom.mechanics.active_environment import SignalLike
    from fenics_rom.mechanics.base_path import BaseState

ON_ERROR = "raise", "hold", "reset"
MOST_BODIES = 10**8  # of which even the smallest take some ten GB


class Batch(SteppedBodies):
    """Steps many bodies of one ROM from rest, beginning in its first contact mode.

    `bodies` in the methods are None (all), a mask (size,) or distinct indices; arrays are in the order 0 .. size - 1.

    Args:
        rom: the reduced model, or the name of its file; it is only read, and copies of a batch share it.
        size: number of bodies.
        dt: time step of all bodies, s; may be set anew before any step.
        dtype: of the states and the arithmetic, float64 or float32; energies, work and time are float64 always.
        ledger: whether to keep the energy account of each body.
        signals: of loads and obstacles by name, instead of the scene's: numbers, or functions of each body's time; as
            in Simulator.
        detail: of a moving frame, as in Simulator.

    Attributes:
        steps: number of steps the batch has taken.

    Raises:
        StepError: size is not a whole number > 0, dt not a positive finite number, or dtype another one, or not float64
            where there is contact, large deformation or a moving frame; or the scene has what `Simulator` steps alone:
            no inertia, strokes, contact in a moving frame, with large deformation, by springs or without residual
            compliance, or free bodies that turn; or the body begins in an obstacle.

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
        detail: str | None = None,
    ):
        rom = given_rom("Batch", rom)
        if not (is_number(size, whole=True) and 0 < size <= MOST_BODIES):
            raise StepError(f"size = {shown(size)}: allowed is a whole number > 0 and at most {MOST_BODIES:,}")
        if not _is_dtype(dtype):
            raise StepError(f"dtype = {shown(dtype)}: allowed are float64 and float32")
        signals, ledger = mapping_in("signals", signals, StepError), check_flag("ledger", ledger, StepError)
        keep_freed_memory()
        rom, self._environment = fit_batch(rom, signals)
        self.rom, self.size, self.dtype = rom, int(size), np.dtype(dtype)
        self._models = PaddedModels(rom, self.dtype)
        modes, p, m = self._models.inputs.shape
        try:
            self._layout = BatchLayout(self.size, modes, m, p, self.dtype)
        except MemoryError as error:
            raise StepError(f"size = {size}: allowed are as many bodies as the memory holds: {error}") from error
        self._number_limit = float(np.finfo(self._layout.state.dtype).max) ** 0.25
        self._ledger = ledger
        self._account = np.zeros((6, self.size))
        self._works = np.empty((2, self.size), self.dtype)
        self._ones = np.ones(m, self.dtype)
        self._contacts = self._deformation = self._carried = self._skin = None
        touches = self._environment is not None and self._environment.environment.contact_law is not None
        if (touches or rom.deformation is not None or rom.environment.is_moving) and self.dtype != np.float64:
            raise StepError("dtype = float32: allowed with contact, large deformation or a moving frame is float64")
        if detail is not None and not rom.environment.is_moving:
            raise StepError(f"detail = {shown(detail)}: allowed is a ROM of a body in a moving frame")
        if rom.environment.is_moving:  # imports are here, as few scenes have such things
            from fenics_rom.runtime.batch_carried import BatchCarried

            assert self._environment is not None
            self._carried = BatchCarried(rom, self._environment, self._models, self._layout.mode, detail)
        elif rom.deformation is not None:
            from fenics_rom.runtime.batch_deformation import BatchDeformation

            self._deformation = BatchDeformation(rom, self._models.inputs, self._models.contact_columns, self.size)
        if self._environment is not None and touches:
            from fenics_rom.runtime.batch_contact import BatchContact

            self._contacts = BatchContact(rom, self._environment, m, self.size)
        self._stepper = self._carried or self._deformation
        self.steps = 0
        self._dt = 1.0
        self.dt = dt
        if self._contacts is not None and self._environment is not None and self._contacts.skin is not None:
            from fenics_rom.runtime.batch_skin import BatchSkin

            self._skin = BatchSkin(self, self._contacts, self._contacts.skin, self._environment.obstacles)

    def __copy__(self) -> "Batch":
        return deepcopy(self)

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
        if self._contacts is not None:
            self._contacts.set_time_step(h)
        if self._stepper is not None:
            self._stepper.set_time_step(h)

    def set_state(self, q: ArrayLike, r: ArrayLike, bodies: Bodies = None, *, on_error: str = "raise") -> None:
        """Puts bodies into states; contact modes, times, accounts and obstacles stay.

        Args:
            q, r: (bodies, m) as `state` gives them, or (m,) for all of them.
            bodies: which.
            on_error: what becomes of bodies that are inside an obstacle: "raise" an error, "hold" them still in all
                steps until they are put elsewhere (`frozen` tells which), or "reset" them, as `reset` does.

        Raises:
            StepError: no such bodies, another shape, numbers that are not finite or absurdly large, or not zero beyond
                the order of a body's contact mode, or a body inside an obstacle; all are as they were.
        """
        check_known("choice of on_error", on_error, ON_ERROR, StepError)
        selected = self._layout.select(bodies)
        ω, modes = self._models.frequencies, self._layout.mode[selected]
        shape = (len(selected), ω.shape[1])
        parts = [real_numbers_or_nan(part) for part in (q, r)]
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
        if self._contacts is not None:
            inside = self._contacts.inside(selected, modes, self._dt / 2 * state[0])
            self._contacts.begin(selected, self._allowed_inside(selected, inside, on_error))
        self._layout.state[:, self._layout.row[selected]] = state
        if self._stepper is not None:
            self._stepper.begin(selected, self._dt / 2 * state[0], state[1])
        if self._skin is not None:
            self._skin.forget(selected)
        if self._contacts is not None and on_error == "reset":
            self.reset(selected[inside], on_error="hold")

    def reset(self, bodies: Bodies = None, *, on_error: str = "raise") -> None:
        """Puts bodies at rest in the first contact mode, at time 0 and with an empty account.

        Args:
            bodies: which.
            on_error: what becomes of bodies that an obstacle was placed in: "raise" or "hold", as in `set_state`.

        Raises:
            StepError: no such bodies, or one inside an obstacle; all are as they were.
        """
        selected = self._layout.select(bodies)
        check_known("choice of on_error", on_error, ON_ERROR[:2], StepError)
        if self._contacts is not None:
            inside = self._contacts.inside_at_rest(selected)
            self._contacts.reset(selected, self._allowed_inside(selected, inside, on_error))
        self._layout.reset(selected)
        self._account[:, selected] = 0
        if self._stepper is not None:
            self._stepper.begin(selected, *np.zeros((2, len(selected), self._models.frequencies.shape[1])))
            self._stepper.reset(selected)
        if self._skin is not None:
            self._skin.begin(selected)

    def place_obstacle(self, name: str, displacement: ArrayLike, bodies: Bodies = None) -> None:
        """Has an obstacle of each body be elsewhere than the scene says, from the end of the next step on.

        It moves there within that step; bodies that are reset begin with it there, at rest.

        Args:
            name: of the obstacle.
            displacement: from where the scene has it at rest, (bodies, 3) or (3,) for all of them, m.
            bodies: which.

        Raises:
            StepError: no such obstacle or bodies, or not so many finite numbers.
        """
        selected = self._layout.select(bodies)
        self._with_contact().place(name, displacement, selected)

    def place(self, base: "BaseState", bodies: Bodies = None) -> None:
        """Puts bases that carry bodies somewhere, with the shapes that the bodies have.

        Args:
            base: of arrays (bodies, 3) and (bodies, 4), or one for all.
            bodies: which.

        Raises:
            StepError: no base carries the bodies, no such bodies, or a base that is none; all are as they were.
        """
        selected, carried = self._layout.select(bodies), self._with_base()
        given, refused = carried.given(base, selected, "base")
        if len(refused):
            raise StepError(
                f"base of body {selected[refused[0]]}: allowed are finite numbers and a unit quaternion; all bodies "
                "were left as they were"
            )
        carried.place(given, selected)

    def switch(self, contact: str | Sequence[str] | Array, bodies: Bodies = None) -> None:
        """Makes other contact modes active; states are projected, and never gain energy by it.

        Args:
            contact: one name, or one for each of the bodies.
            bodies: which.

        Raises:
            StepError: no such contact mode or bodies, or another number of names, or a body that a base carries is
                strained; all states are as they were.
        """
        selected = self._layout.select(bodies)
        names = [contact] if isinstance(contact, str) else list(names_in("contact", contact, StepError))
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
        if self._carried is not None and state[:, rows].any():
            raise StepError(
                "contact modes of bodies that a base carries: allowed in a batch is a switch of bodies that are not "
                "strained and do not oscillate; Simulator switches others, one by one"
            )
        before = self._energy(rows) if self._ledger else 0.0
        pairs = start * len(numbers) + end
        for pair in np.unique(pairs) if self._stepper is None else ():  # else they share a basis, or are at rest
            moved, (first, second) = rows[pairs == pair], divmod(int(pair), len(numbers))
            strained = self._dt / 2 * state[0, moved] * self._models.frequencies[first]
            state[:, moved] = state[:, moved] @ self._models.switch_map(first, second)
            if self._contacts is not None:
                elastic = slice(self.rom.rigid, self._models.orders[second])
                e = self._contacts.residual.carry_over(first, second, selected[pairs == pair], strained)
                state[0, moved, elastic] = 2 / self._dt * e / self._models.frequencies[second, elastic]
        self._layout.enter(selected, end)
        if self._stepper is not None:
            self._stepper.entered(selected)
        if self._ledger:
            self._account[LOST, selected] += before - self._energy(rows)

    def step(self, u: ArrayLike, *, base: "BaseState | None" = None, on_error: str = "raise") -> Array:
        """Advances all bodies by dt, each under its constant input.

        Args:
            u: (size, p) N, or (p,) for all: contact columns, filled up to the contact mode that has most, then the
                actuators'. Columns that a body's contact mode lacks do nothing, but must hold finite numbers, too.
            base: that carries each body, at the end of the step, of arrays (size, 3) and (size, 4), or of one base for
                all; None: as the environment says, or at rest.
            on_error: what becomes of bodies whose input, base, or state after the step, is not finite or absurdly
                large, or whose base turns too far: "raise" an error, "hold" them still for this step, with state, time
                and account as they were, or "reset" them, as `reset` does, while the others go on.

        Returns:
            Indices of the bodies that did not take the step, also as they began inside an obstacle; mostly (0,).

        Raises:
            StepError: u has another shape, or a body's input is refused; the body and the step are named, all are as
                they were.
        """
        check_known("choice of on_error", on_error, ON_ERROR, StepError)
        u, held = self._check_input(u, on_error)
        if self._environment is not None:
            u = np.hstack([u, self._loads(self._environment)])
        contacts = self._contacts
        if contacts is not None:
            held = np.union1d(held, contacts.frozen.nonzero()[0])
            contacts.begin_step(self._account[TIME], held)
            self._follow_obstacles(contacts)
        if self._carried is not None:
            held = np.union1d(held, self._carried.move_base(base, self._account[TIME], f"step {self.steps}", on_error))
        elif base is not None:
            raise StepError(f"step {self.steps}: base: allowed is a body in a moving frame that a rigid base carries")
        if self._stepper is None:
            self._step_linear(u, held)
        else:
            held = self._step_otherwise(self._stepper, u, held, on_error)
        if self._skin is not None:
            self._skin.look_in_turn()
        if on_error == "reset" and len(held):
            self.reset(held, on_error="hold")
        return held

    def _allowed_inside(self, bodies: Array, inside: Array, on_error: str) -> Array:
        """Which of the bodies to hold still, of those that are inside an obstacle."""
        check_known("choice of on_error", on_error, ON_ERROR, StepError)
        if inside.any() and on_error == "raise":
            raise StepError(
                f"body {bodies[inside.argmax()]} is inside an obstacle: allowed is a start outside of all of them, or "
                'on_error="hold"; all bodies were left as they were'
            )
        return inside


def _is_dtype(given: DTypeLike) -> bool:
    """Whether it names one of the types that a batch may have."""
    try:
        return given is not None and np.dtype(given) in (np.float64, np.float32)
    except (TypeError, ValueError, UnicodeError):
        return False
