"""What can be read of a batch of bodies, in the words of their ROM."""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy import ndarray as Array
from numpy.typing import ArrayLike

from fenics_rom.arguments import is_number
from fenics_rom.errors import StepError, shown
from fenics_rom.mechanics.signals import real_numbers_or_nan
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.batch_arrays import Bodies, select_bodies

if TYPE_CHECKING:
    from fenics_rom.mechanics.base_path import BaseState
    from fenics_rom.mechanics.touch import TouchState
    from fenics_rom.runtime.compiled_bodies import CompiledBodies
    from fenics_rom.runtime.error_watch import StatedError
    from fenics_rom.runtime.joint_bodies import JointBodies
    from fenics_rom.runtime.separate_bodies import SeparateBodies


class BatchedBodies:
    """Bodies of a batch, in one of its forms; `Batch` moves them."""

    rom: Rom
    size: int
    dtype: np.dtype
    _bodies: "CompiledBodies | JointBodies | SeparateBodies"
    _ledger: bool
    _why: str  # they are stepped one after another; empty where together

    def __repr__(self) -> str:
        orders = (f"{name} (order {model.order})" for name, model in self.rom.contact_models.items())
        how = f"; stepped {self.stepping}" if self._why else ""
        return (
            f"Batch of {self.size} bodies of {self.rom.name!r}: dt = {self._bodies.dt:g} s, {self.steps} steps taken, "
            f"{self.dtype}\n  contact modes: {', '.join(orders)}{how}"
        )

    @property
    def stepping(self) -> str:
        """How steps are taken: "compiled", "together", or "one after another", and why."""
        if self._why:
            return f"one after another, as of {self._why}"
        return "compiled" if getattr(self._bodies, "is_compiled", False) else "together"

    @property
    def steps(self) -> int:
        """Number of steps the batch has taken."""
        return self._bodies.steps

    @property
    def error_bound(self) -> "StatedError":
        """As of a simulator, of all bodies: `norm` (size,), and of outputs (size, ...).

        Raises:
            StepError: it is not known.
        """
        return self._stated("error_bound")

    @property
    def error_estimate(self) -> "StatedError":
        """As of a simulator, of all bodies: `norm` (size,), and of outputs (size, ...).

        Raises:
            StepError: it is not known.
        """
        return self._stated("error_estimate")

    @property
    def exceeded(self) -> Array:
        """Times (size,) at which an estimate was first larger than the tolerance, s; NaN where none was."""
        found = [body.exceeded for body in getattr(self._bodies, "bodies", [])]
        return np.array([np.nan if one is None else one.time for one in found] or [np.nan] * self.size)

    def _stated(self, what: str) -> "StatedError":
        bodies = getattr(self._bodies, "bodies", None)
        if bodies is None:
            raise StepError(
                f"errors are not known: ROM {self.rom.name!r} was not made by fr.reduce(system, errors=True), or "
                "errors = False was given"
            )
        stated = [getattr(body, what) for body in bodies]

        def of_output(name: str) -> Array:
            return np.array([each.output(name) for each in stated])

        def read(name: str) -> Array:
            return np.array([each.reading(name) for each in stated])

        def of_all(name: str) -> Array | None:
            values = [getattr(each, name) for each in stated]
            return None if values[0] is None else np.array(values)

        known = {"norm": of_all("norm"), "shape": of_all("shape"), "read": stated[0].read and read}
        return replace(stated[0], outputs=of_output, **known)

    @property
    def inputs(self) -> int:
        """Columns p of the input: those of the contact mode that has most, then the actuators'."""
        return max(self.rom.contacts.values()) + sum(self.rom.actuators.values())

    @property
    def contact(self) -> Array:
        """Names (size,) of the active contact modes."""
        return self._bodies.contact

    @property
    def time(self) -> Array:
        """Time (size,) since each body's last reset, s."""
        return self._bodies.time

    @property
    def energy(self) -> Array:
        """Stored energies ½ vᵀMv + ½ xᵀKx (size,), J; with large deformation ½ vᵀMv + Φ(x)."""
        return self._bodies.energy

    @property
    def supplied(self) -> Array:
        """Work of inputs, loads and obstacles (size,) since each body's last reset, J.

        Raises:
            StepError: the batch keeps no account, here as in the following.
        """
        return self._account("supplied")

    @property
    def dissipated(self) -> Array:
        """What damping and contact took (size,), J; never negative."""
        return self._account("dissipated")

    @property
    def supplied_by_obstacles(self) -> Array:
        """Of what was supplied: the work of moving obstacles (size,), J."""
        return self._account("supplied_by_obstacles")

    @property
    def dissipated_in_contact(self) -> Array:
        """Of what was dissipated: in impacts and by friction (size,), J."""
        return self._account("dissipated_in_contact")

    @property
    def lost_in_switching(self) -> Array:
        """What projections took (size,), J; negative only for oblique switching."""
        return self._account("lost_in_switching")

    @property
    def numerical(self) -> Array:
        """Of steps without inertia: what they miss of the work on the way (size,), J; else 0."""
        return self._account("numerical")

    def _account(self, entry: str) -> Array:
        if not self._ledger:
            raise StepError("this batch keeps no energy account: use that of Batch(..., ledger=True)")
        return self._bodies.account(entry)

    @property
    def friction(self) -> Array:
        """Coulomb's coefficient μ of each body (size,); may be set anew before any step.

        Raises:
            StepError: nothing can touch the bodies, here as in the following.
        """
        self._check_contact()
        return self._bodies.friction

    @friction.setter
    def friction(self, μ: ArrayLike) -> None:
        self._check_contact()
        given = real_numbers_or_nan(μ)
        if given.shape not in ((), (self.size,)) or not (np.isfinite(given) & (given >= 0)).all():
            raise StepError(f"friction: use a finite number >= 0, or one of each of {self.size} bodies")
        self._bodies.friction = np.broadcast_to(given, self.size)

    @property
    def inexact(self) -> Array:
        """Number of steps (size,) since each body's last reset whose contact forces were left inexact."""
        self._check_contact()
        return self._bodies.inexact

    @property
    def held_back(self) -> Array:
        """Number of steps (size,) since each body's last reset in which points were held before a thin obstacle."""
        self._check_contact()
        return self._bodies.held_back

    @property
    def frozen(self) -> Array:
        """Bodies (size,) that stand still, as they were put inside an obstacle; `reset` or `set_state` frees them."""
        return self._bodies.frozen

    @property
    def through_skin(self) -> Array:
        """How deep an obstacle was in each body since its last reset, where contact does not keep it out, (size,), m.

        0 where none was seen: a body is looked at once in some (hundred) steps, sooner where something moves fast, and
        a warning tells of it once.
        """
        self._check_contact()
        return self._bodies.through_skin

    @property
    def least_tensions(self) -> dict[str, Array]:
        """Least tension (size,), N, that each body's tendons were given since its last reset, by name; 0 of none below.

        Of tendons whose tension is given; below 0 they push, which no cable does.
        """
        return self._bodies.least_tensions

    def _check_contact(self) -> None:
        if self.rom.environment.contact_law is None:
            raise StepError(f"nothing can touch bodies of ROM {self.rom.name!r}: use a scene with contact")

    @property
    def beyond_training(self) -> Array:
        """Bodies (size,) that since their last reset bent, or turned, further than their model is to be trusted.

        That is, with large deformation, 1.5 times as far as in training; in a moving frame as the warnings of a
        simulator have it.
        """
        return self._bodies.beyond_training

    @property
    def mismatch(self) -> Array:
        """By how much strains that steps carry along missed those of the shape (size,), relative, since the last reset.

        Above some 0.03 the steps are too long. 0 where steps carry none.
        """
        return self._bodies.mismatch

    @property
    def base(self) -> "BaseState":
        """The frame of each body, in world axes, of arrays (size, 3) and (size, 4): of its base, or of a free body.

        Raises:
            StepError: frames of bodies do not move, here as in the following.
        """
        return self._in_frames.base

    @property
    def base_wrench(self) -> tuple[Array, Array]:
        """Forces, N, and torques about the frames' origins, N m, of bases on bodies in the last step, (size, 3).

        In world axes; 0 of bodies that did not take it, and of free bodies.
        """
        return self._in_frames.base_wrench

    @property
    def base_misfit(self) -> Array:
        """By which share of its motion in a step each base went otherwise than its twists say (size,), at most.

        Since the last reset; above 0.1 it jumps, or twists and poses do not fit: forces are those of the twists.
        """
        return self._in_frames.base_misfit

    @property
    def _in_frames(self) -> "JointBodies | SeparateBodies":
        if not self.rom.environment.is_moving:
            raise StepError(f"no base carries bodies of ROM {self.rom.name!r}: use a scene with a moving frame")
        return self._bodies  # type: ignore[return-value]  # loops are of held bodies

    @property
    def reactions(self) -> dict[str, Array]:
        """Forces (size,) of actuators whose strokes are given, in the last step: tensions in N, pressures in Pa."""
        return self._bodies.reactions

    def contact_force(self, obstacle: str) -> Array:
        """Resultant of the forces of an obstacle on every body in the last step, (size, 3), N.

        Raises:
            StepError: no such obstacle.
        """
        self._check_contact()
        return self._bodies.contact_force(obstacle)

    @property
    def point_forces(self) -> Array:
        """Contact forces on the points of every body in the last step, (size, P, 3), N."""
        self._check_contact()
        return self._bodies.point_forces

    def state(self, bodies: Bodies = None) -> tuple[Array, Array]:
        """Reduced displacements q and velocities r, (bodies, m) each; zero beyond the order of a body's contact mode.

        Raises:
            StepError: no such bodies.
        """
        return self._bodies.state(select_bodies(bodies, self.size))

    def displacement(self, output: str) -> Array:
        """Displacements of a named output, (size, points, 3), m, in world axes. Without a mesh: (size, rows).

        With what contact points yield, as of a simulator.

        Raises:
            StepError: no such output.
        """
        return self._bodies.displacement(output).astype(self.dtype, copy=False)

    def velocity(self, output: str) -> Array:
        """Velocities of a named output, (size, points, 3), m/s, in world axes. Without a mesh: (size, rows).

        Of the basis, as of a simulator.

        Raises:
            StepError: no such output.
        """
        return self._bodies.velocity(output).astype(self.dtype, copy=False)

    def shape(self, body: int) -> Array:
        """Displacement of every mesh node of one body, (nodes, 3), m. Without a mesh: all n displacements.

        Raises:
            StepError: no such body.
        """
        return self._bodies.shape(self._one(body))

    def shape_coordinates(self, body: int) -> Array:
        """The displacement of a body in the shared basis, (k,).

        Raises:
            StepError: no such body.
        """
        return self._bodies.shape_coordinates(self._one(body))

    def _one(self, body: int) -> int:
        if not is_number(body, whole=True):
            raise StepError(f"body = {shown(body)}: use the number of one body")
        (own,) = select_bodies([body], self.size)
        return int(own)

    def reading(self, name: str) -> Array:
        """A reading of every body, (size, ...), as `Simulator.reading` has it of one; bodies are read one by one.

        Raises:
            StepError: no such reading.
        """
        return self._bodies.reading(name)

    def touch(self, name: str) -> "TouchState":
        """What a sense of touch of every body shows, as `Simulator.touch`: arrays (size, ...).

        Raises:
            StepError: there is none of that name.
        """
        from fenics_rom.mechanics.touch import touch_of  # here, as few bodies have one

        return touch_of(self.rom.readings, name, self._bodies.reading)
