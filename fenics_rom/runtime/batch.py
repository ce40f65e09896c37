"""Many soft bodies of one ROM: each with its own contact mode, state, input and time.

Where steps are compiled, loops take them (`compiled_bodies.py`). Where they can be written as operations on arrays of
all bodies, they are taken together (`joint_bodies.py`); else one after another, each by a simulator
(`separate_bodies.py`). All do the same, at rates that differ.
"""

from collections.abc import Mapping, Sequence
from copy import deepcopy
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy import ndarray as Array
from numpy.typing import ArrayLike, DTypeLike

from fenics_rom.arguments import check_flag, is_number, mapping_in, names_in
from fenics_rom.compilation import compiled
from fenics_rom.errors import StepError, check_known, shown
from fenics_rom.mechanics.signals import real_numbers_or_nan
from fenics_rom.rom.given_rom import given_rom
from fenics_rom.rom.midpoint_map import checked_dt
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.batch_arrays import Bodies, checked_bases, checked_inputs, inputs_by_name, select_bodies
from fenics_rom.runtime.batched_bodies import BatchedBodies

if TYPE_CHECKING:
    from os import PathLike

    from fenics_rom.mechanics.active_environment import SignalLike
    from fenics_rom.mechanics.base_path import BaseState
    from fenics_rom.runtime.compiled_bodies import CompiledBodies
    from fenics_rom.runtime.joint_bodies import JointBodies
    from fenics_rom.runtime.separate_bodies import SeparateBodies

ON_ERROR = "raise", "hold", "reset"
ALLOWED_BASES = "use finite numbers and a unit quaternion; all bodies were left as they were"
MOST_BODIES = 10**8  # of which even the smallest take some ten GB


class Batch(BatchedBodies):
    """Steps many bodies of one ROM from rest, beginning in its first contact mode.

    Takes what `Simulator` takes. Bodies are stepped together where that can be done: held bodies of small strains, by
    the rigid law of contact with residual compliance or without contact; held bodies of large deformation, and bodies
    that a base carries, without contact. All others are stepped one after another, each at the rate of a simulator,
    with the same results to the bit: without inertia, with strokes, friction of tendons, a material that relaxes,
    springs in place of the rigid law, errors that are kept, touch, free bodies in moving frames, and what else
    `stepping` tells. Where numba is installed, held bodies of small strains among obstacles, those of large
    deformation, also with strokes, and bodies in moving frames step compiled on several threads, by any law of contact,
    if a single one does, and each as that to the bit. Of these that have a sense of touch the first alone do.

    `bodies` in the methods are None (all), a mask (size,) or distinct indices; arrays are in the order 0 .. size - 1.

    Args:
        rom: the reduced model, or the name of its file; it is only read, and copies of a batch share it.
        size: number of bodies.
        dt: time step of all bodies, s; may be set anew before any step.
        dtype: of the states and the arithmetic, float64 or float32; energies, work and time are float64 always. With
            contact, large deformation or a moving frame, and one after another, bodies are kept and stepped in float64
            also where this is float32: then that is the type of displacements and velocities that are read.
        ledger: whether to keep the energy account of each body.
        signals: of loads and obstacles by name, instead of the scene's: numbers, or functions of each body's time; as
            in Simulator.
        detail: of a moving frame, as in Simulator.
        errors: whether to keep bound and estimate of each body's error, as in Simulator.
        error_tolerance: of each body, m, as in Simulator; `exceeded` tells when.
        finer: a ROM of higher order beside each body, as in Simulator.

    Attributes:
        rom: the reduced model, of what acts in its scene.
        size: number of bodies.
        dtype: as above.

    Raises:
        SceneError: as of Simulator.
        StepError: size is not a whole number > 0, dt not a positive finite number, or dtype another one; or the body
            begins in an obstacle.

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
        errors: bool | None = None,
        error_tolerance: float | None = None,
        finer: "Rom | str | PathLike[str] | None" = None,
    ):
        rom = given_rom("Batch", rom)
        if not (is_number(size, whole=True) and 0 < size <= MOST_BODIES):
            raise StepError(f"size = {shown(size)}: use a whole number > 0 and at most {MOST_BODIES:,}")
        if not _is_dtype(dtype):
            raise StepError(f"dtype = {shown(dtype)}: use float64 or float32")
        signals, ledger = mapping_in("signals", signals, StepError), check_flag("ledger", ledger, StepError)
        errors = errors if errors is None else check_flag("errors", errors, StepError)
        self._told: dict[str, Any] = {"errors": errors, "error_tolerance": error_tolerance, "finer": finer}
        told = (
            bool(errors)
            or finer is not None
            or error_tolerance is not None
            or (errors is None and rom.error_model is not None)
        )
        self._feels = any(reading.quantity == "touch" for reading in rom.readings.values())
        reacts = any(reading.quantity == "reaction" for reading in rom.readings.values())
        keeps = "errors" if told else "reactions of supports" if reacts else "a sense of touch" * self._feels
        self.size, self.dtype, self._why = int(size), np.dtype(dtype), keeps or _why_one_by_one(rom)
        self._given, self._ledger, self._signals, self._detail = rom, ledger, signals, detail
        h = checked_dt(dt)
        self._bodies = (None if told or reacts else self._compiled(h)) or (
            self._one_by_one(h) if self._why else self._together(h)
        )
        self.rom = self._bodies.rom
        self._shape = self.size, self.inputs

    def _compiled(self, dt: float) -> "CompiledBodies | None":
        bends, acting = self._given.deformation is not None, self._given.environment
        in_steps = acting.contact_law or acting.is_moving or acting.finds_forces or acting.viscoelasticity
        if not compiled() or not (bends or in_steps):  # others start sooner
            return None
        from fenics_rom.runtime.compiled_bending import CompiledBending
        from fenics_rom.runtime.compiled_bodies import CompiledBodies
        from fenics_rom.runtime.compiled_frames import CompiledFrames

        others, held = (self._ledger, self._signals, self._detail), CompiledBending if bends else CompiledBodies
        form = CompiledFrames if acting.is_moving else held
        if self._feels and form is not CompiledBodies:
            return None
        bodies = form.made(self._given, self.size, dt, *others)
        self._why = self._why if bodies is None else ""
        return bodies

    def _together(self, dt: float) -> "JointBodies":
        from fenics_rom.runtime.joint_bodies import JointBodies

        others = self._ledger, self._signals, self._detail
        return JointBodies(self._given, self.size, dt, self.dtype, *others)

    def _one_by_one(self, dt: float) -> "SeparateBodies":
        from fenics_rom.runtime.separate_bodies import SeparateBodies  # here, as few scenes need it

        others = self._ledger, self._signals, self._detail
        return SeparateBodies(self._given, self.size, dt, *others, self._told)

    def __copy__(self) -> "Batch":
        return deepcopy(self)

    @property
    def dt(self) -> float:
        """Time step, s."""
        return self._bodies.dt

    @dt.setter
    def dt(self, dt: float) -> None:
        self._bodies.dt = checked_dt(dt)

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
        self._bodies.set_state(real_numbers_or_nan(q), real_numbers_or_nan(r), self._select(bodies), on_error)

    def reset(self, bodies: Bodies = None, *, on_error: str = "raise") -> None:
        """Puts bodies at rest in the first contact mode, at time 0 and with an empty account.

        Args:
            bodies: which.
            on_error: what becomes of bodies that an obstacle was placed in: "raise" or "hold", as in `set_state`.

        Raises:
            StepError: no such bodies, or one inside an obstacle; all are as they were.
        """
        selected = self._select(bodies)
        check_known("choice of on_error", on_error, ON_ERROR[:2], StepError)
        self._bodies.reset(selected, on_error)

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
        selected = self._select(bodies)
        self._check_contact()
        self._bodies.place_obstacle(name, real_numbers_or_nan(displacement), selected)

    def place(self, base: "BaseState", bodies: Bodies = None) -> None:
        """Puts bases that carry bodies, or free bodies, somewhere, with the shapes that the bodies have.

        Args:
            base: of arrays (bodies, 3) and (bodies, 4), or one for all; of a free body as in `Simulator.place`.
            bodies: which.

        Raises:
            StepError: frames of bodies do not move, no such bodies, a base that is none, or a body that would be in an
                obstacle; all are as they were.
        """
        selected = self._select(bodies)
        in_frames = self._in_frames
        given, refused = checked_bases(base, len(selected), "base")
        if len(refused):
            raise StepError(f"base of body {selected[refused[0]]}: {ALLOWED_BASES}")
        in_frames.place(given, selected)

    def switch(self, contact: str | Sequence[str] | Array, bodies: Bodies = None) -> None:
        """Makes other contact modes active; states are projected, and never gain energy by it.

        Args:
            contact: one name, or one for each of the bodies.
            bodies: which.

        Raises:
            StepError: no such contact mode or bodies, or another number of names; all states are as they were.
        """
        selected = self._select(bodies)
        names = [contact] if isinstance(contact, str) else list(names_in("contact", contact, StepError))
        if not isinstance(contact, str) and len(names) != len(selected):
            raise StepError(
                f"contact modes of {len(selected)} bodies: use one name or {len(selected)} (got {len(names)})"
            )
        numbers = {name: k for k, name in enumerate(self.rom.contact_models)}
        for name in names:
            check_known("contact mode", str(name), numbers, StepError)
        modes = np.broadcast_to([numbers[name] for name in names], selected.shape)
        if not self._bodies.can_switch(modes, selected):  # then shapes go on beyond what arrays of one order hold
            there, self._why = self._bodies, "contact modes that were switched while their bodies were strained"
            self._bodies = self._one_by_one(there.dt)
            self._bodies.take_over(there)  # type: ignore[arg-type]  # others can always
        self._bodies.switch(modes, selected)

    def step(
        self, u: ArrayLike | Mapping[str, Any], *, base: "BaseState | None" = None, on_error: str = "raise"
    ) -> Array:
        """Advances all bodies by dt, each under its constant input.

        Args:
            u: (size, p) N, or (p,) for all: contact columns, filled up to the contact mode that has most, then the
                actuators' (as of `Simulator.step`). Columns that a body's contact mode lacks do nothing, but must hold
                finite numbers, too. Or a mapping by name, of (size, columns) or (columns,) each; what it does not name
                is 0, and forces of a contact mode are on the bodies that are in it.
            base: that carries each body, at the end of the step, of arrays (size, 3) and (size, 4), or of one base for
                all; None: as the environment says, or at rest.
            on_error: what becomes of bodies whose input, base, or state after the step, is not finite or absurdly
                large, whose base turns too far, or that no forces are found of: "raise" an error, "hold" them still for
                this step, with state, time and account as they were, or "reset" them, as `reset` does, while the others
                go on.

        Returns:
            Indices of the bodies that did not take the step, also as they began inside an obstacle; mostly (0,).

        Raises:
            StepError: u has another shape, or a body's input is refused; the body and the step are named, all are as
                they were.
        """
        check_known("choice of on_error", on_error, ON_ERROR, StepError)
        bodies = self._bodies
        if isinstance(u, Mapping):
            u = inputs_by_name(u, self.rom, bodies.contact)
        u, held = checked_inputs(u, self._shape, bodies.dtype, bodies.input_limit, bodies.steps, on_error)
        if base is not None:
            where = f"step {self.steps}"
            base, refused = checked_bases(base, self.size, f"{where}: base")
            if len(refused) and on_error == "raise":
                raise StepError(f"{where}, body {refused[0]}: base: {ALLOWED_BASES}")
            held = np.union1d(held, refused)
        held = bodies.step(u, base, held, on_error)
        if on_error == "reset" and len(held):
            self._bodies.reset(held, "hold")
        return held

    def _select(self, bodies: Bodies) -> Array:
        return select_bodies(bodies, self.size)


def _why_one_by_one(rom: Rom) -> str:
    """What of a ROM has no form in which all bodies are stepped together; empty where there is one."""
    acting, law, body = rom.environment, rom.environment.contact_law, rom.deformation
    carried = rom.moving_frame is not None and rom.moving_frame.carried
    residual = rom.residual_compliance if acting.residual_compliance else None
    by_blocks = residual is not None and residual.static is not None
    reasons = {
        "no inertia": not acting.has_inertia,
        "actuators that are given strokes": len(acting.controls) > len(acting.bars),
        "surfaces that are rigid": bool(acting.bars),
        "friction of tendons": bool(acting.guides),
        "a material that relaxes": acting.viscoelasticity is not None,
        "a free body in a moving frame": acting.is_moving and not carried,
        "contact in a moving frame": acting.is_moving and law is not None,
        "large deformation in a moving frame": acting.is_moving and body is not None,
        "contact with large deformation": law is not None and body is not None,
        "materials of large deformation with several damping ratios": body is not None and np.ptp(body.viscosity) > 0,
        "an obstacle that is not convex": not all(each.shape.is_convex for each in acting.obstacles.values()),
        "contact of a body with itself": bool(acting.self_contact),
        "an obstacle that turns": acting.turns_obstacles,
        "contact with the faces of a body": acting.touches_faces,
        "contact by springs": law is not None and law.stiffness is not None,
        "contact without residual compliance": law is not None and residual is None,
        "contact points of which residual compliance is kept by blocks": law is not None and by_blocks,
    }
    return next((reason for reason, there in reasons.items() if there), "")


def _is_dtype(given: DTypeLike) -> bool:
    """Whether it names one of the types that a batch may have."""
    try:
        return given is not None and np.dtype(given) in (np.float64, np.float32)
    except (TypeError, ValueError, UnicodeError):
        return False
