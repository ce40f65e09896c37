"""What can be read of a batch of bodies, and given to it, in the words of their ROM."""

from typing import TYPE_CHECKING

import numpy as np
from numpy import ndarray as Array
from numpy.typing import ArrayLike

from fenics_rom.arguments import is_number
from fenics_rom.errors import StepError, shown
from fenics_rom.mechanics.signals import hides_numbers, real_numbers_or_nan
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.batch_arrays import BatchLayout, Bodies, PaddedModels, StepCoefficients, distinct

if TYPE_CHECKING:
    from fenics_rom.mechanics.active_environment import ActiveEnvironment
    from fenics_rom.mechanics.base_path import BaseState
    from fenics_rom.runtime.batch_carried import BatchCarried
    from fenics_rom.runtime.batch_contact import BatchContact
    from fenics_rom.runtime.batch_deformation import BatchDeformation
    from fenics_rom.runtime.batch_skin import BatchSkin

TIME, SUPPLIED, DISSIPATED, LOST, BY_OBSTACLES, BY_CONTACT = range(6)  # rows of the account


class BatchedBodies:
    """Bodies as they are in the arrays of a batch; `Batch` moves them."""

    rom: Rom
    size: int
    steps: int
    dtype: np.dtype
    _dt: float
    _models: PaddedModels
    _layout: BatchLayout
    _coefficients: StepCoefficients
    _contacts: "BatchContact | None"
    _skin: "BatchSkin | None"
    _deformation: "BatchDeformation | None"
    _carried: "BatchCarried | None"
    _stepper: "BatchCarried | BatchDeformation | None"  # of the two, that there is
    _environment: "ActiveEnvironment | None"
    _works: Array
    _ones: Array
    _input_limit: float
    _ledger: bool
    _account: Array

    def __repr__(self) -> str:
        orders = (f"{name} (order {model.order})" for name, model in self.rom.contact_models.items())
        return (
            f"Batch of {self.size} bodies of {self.rom.name!r}: dt = {self._dt:g} s, {self.steps} steps taken, "
            f"{self.dtype}\n  contact modes: {', '.join(orders)}"
        )

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
        """Work of inputs, loads and obstacles (size,) since each body's last reset, J.

        Raises:
            StepError: the batch keeps no account, here as in the following.
        """
        return self._read_account(SUPPLIED)

    @property
    def dissipated(self) -> Array:
        """What damping and contact took (size,), J; never negative."""
        return self._read_account(DISSIPATED)

    @property
    def supplied_by_obstacles(self) -> Array:
        """Of what was supplied: the work of moving obstacles (size,), J."""
        return self._read_account(BY_OBSTACLES)

    @property
    def dissipated_in_contact(self) -> Array:
        """Of what was dissipated: in impacts and by friction (size,), J; never negative."""
        return self._read_account(BY_CONTACT)

    @property
    def lost_in_switching(self) -> Array:
        """What projections took (size,), J; negative only for oblique switching."""
        return self._read_account(LOST)

    @property
    def friction(self) -> Array:
        """Coulomb's coefficient μ of each body (size,); may be set anew before any step.

        Raises:
            StepError: nothing can touch the bodies, here as in the following.
        """
        return self._with_contact().friction.copy()

    @friction.setter
    def friction(self, μ: ArrayLike) -> None:
        contacts, given = self._with_contact(), real_numbers_or_nan(μ)
        if given.shape not in ((), (self.size,)) or not (np.isfinite(given) & (given >= 0)).all():
            raise StepError(f"friction: allowed is a finite number >= 0, or one of each of {self.size} bodies")
        contacts.friction[:] = given

    @property
    def inexact(self) -> Array:
        """Number of steps (size,) since each body's last reset whose contact forces were left inexact."""
        return self._with_contact().inexact.copy()

    @property
    def frozen(self) -> Array:
        """Bodies (size,) that stand still, as they were put inside an obstacle; `reset` or `set_state` frees them."""
        return np.zeros(self.size, bool) if self._contacts is None else self._contacts.frozen.copy()

    @property
    def through_skin(self) -> Array:
        """How deep an obstacle was in each body since its last reset, where contact does not keep it out, (size,), m.

        0 where none was seen: a body is looked at once in some hundred steps, sooner where something moves fast, and a
        warning tells of it once.
        """
        self._with_contact()
        return np.zeros(self.size) if self._skin is None else self._skin.depths()

    @property
    def beyond_training(self) -> Array:
        """Bodies (size,) that since their last reset bent, or turned, further than their model is to be trusted.

        That is, with large deformation, 1.5 times as far as in training; in a moving frame as the warnings of a
        simulator have it.
        """
        return np.zeros(self.size, bool) if self._stepper is None else self._stepper.distrusted

    @property
    def mismatch(self) -> Array:
        """By how much strains that steps carry along missed those of the shape (size,), relative, since the last reset.

        Above some 0.03 the steps are too long. 0 without large deformation.
        """
        return np.zeros(self.size) if self._deformation is None else self._deformation.mismatch

    @property
    def base(self) -> "BaseState":
        """The base that carries each body, in world axes, of arrays (size, 3) and (size, 4).

        Raises:
            StepError: no base carries the bodies, here as in the following.
        """
        return self._with_base().base

    @property
    def base_wrench(self) -> tuple[Array, Array]:
        """Forces, N, and torques about the frames' origins, N m, of bases on bodies in the last step, (size, 3).

        In world axes; 0 of bodies that did not take it.
        """
        return self._with_base().wrench

    @property
    def base_misfit(self) -> Array:
        """By which share of its motion in a step each base went otherwise than its twists say (size,), at most.

        Since the last reset; above 0.1 it jumps, or twists and poses do not fit: forces are those of the twists.
        """
        return self._with_base().misfit.copy()

    def contact_force(self, obstacle: str) -> Array:
        """Resultant of the forces of an obstacle on every body in the last step, (size, 3), N.

        Raises:
            StepError: no such obstacle.
        """
        return self._with_contact().resultant(obstacle)

    @property
    def point_forces(self) -> Array:
        """Contact forces on the points of every body in the last step, (size, P, 3), N."""
        return self._with_contact().point_forces

    @property
    def layout(self) -> BatchLayout:
        """Where the states of the bodies are."""
        return self._layout

    def state(self, bodies: Bodies = None) -> tuple[Array, Array]:
        """Reduced displacements q and velocities r, (bodies, m) each; zero beyond the order of a body's contact mode.

        Raises:
            StepError: no such bodies.
        """
        x, r = self._layout.state[:, self._layout.row[self._layout.select(bodies)]].astype(float)
        return self._dt / 2 * x, r

    def displacement(self, output: str) -> Array:
        """Displacements of a named output, (size, points, 3), m, in world axes. Without a mesh: (size, rows).

        With what contact points yield, as of a simulator.

        Raises:
            StepError: no such output.
        """
        field = self._dt / 2 * self._read_output(0, output)
        if self._contacts is not None:
            field += (self._beyond(np.arange(self.size)) @ self.rom.outputs[output].T).reshape(field.shape)
        return field if self._carried is None else self._carried.world_displacement(output, field)

    def velocity(self, output: str) -> Array:
        """Velocities of a named output, (size, points, 3), m/s, in world axes. Without a mesh: (size, rows).

        Of the basis, as of a simulator.

        Raises:
            StepError: no such output.
        """
        field = self._read_output(1, output)
        if self._carried is None:
            return field
        return self._carried.world_velocity(output, self._dt / 2 * self._read_output(0, output), field)

    def shape(self, body: int) -> Array:
        """Displacement of every mesh node of one body, (nodes, 3), m. Without a mesh: all n displacements.

        Raises:
            StepError: no such body.
        """
        if not is_number(body, whole=True):
            raise StepError(f"body = {shown(body)}: allowed is the number of one body")
        (own,) = self._layout.select([body])
        field = self.rom.reconstruct(self.shape_coordinates(own))
        if self._contacts is not None:
            nodes = self._contacts.points.nodes
            field[nodes] += self._contacts.residual.beyond_shared(own, self._layout.mode[own])[: len(nodes)]
        return field if self._carried is None else self._carried.world_shape(body, field)

    def reading(self, name: str) -> Array:
        """A reading of every body, (size, ...), as `Simulator.reading` has it of one; bodies are read one by one.

        Raises:
            StepError: no such reading.
        """
        from fenics_rom.runtime.readings import named_reading, readable  # here, as few bodies have readings

        reading, contacts, read = named_reading(self.rom, name), self._contacts, []
        points, pressing = (None, None) if contacts is None else (contacts.points, contacts.normal_forces)
        for body, (contact, q) in enumerate(zip(self.contact, self.state()[0], strict=True)):
            own, order = pressing if pressing is None else pressing[:, body], self.rom.contact_models[contact].order
            read.append(reading.read(readable(self.rom, contact, q[:order], self.shape_coordinates(body), points, own)))
        return np.array(read)

    def _beyond(self, bodies: Array) -> Array:
        """What contact points of bodies (B,) yield beyond the contact mode, in the shared basis, (B, k)."""
        κ, rigid = self.rom.stiffness, self.rom.rigid
        beyond = np.zeros((len(bodies), len(κ)))
        if self._contacts is not None:
            beyond[:, rigid:] = self._contacts.residual.strained(self._layout.mode[bodies], bodies) / np.sqrt(κ[rigid:])
        return beyond

    def shape_coordinates(self, body: int) -> Array:
        """The displacement of a body in the shared basis, (k,)."""
        (q,), _ = self.state([body])
        C = list(self.rom.contact_models.values())[self._layout.mode[body]].coordinates
        shape: Array = C @ q[: C.shape[1]] + self._beyond(np.array([body]))[0]
        return shape

    def _read_account(self, entry: int) -> Array:
        if not self._ledger:
            raise StepError("this batch keeps no energy account: allowed is that of Batch(..., ledger=True)")
        return self._account[entry].copy()

    def _energy(self, rows: slice | Array) -> Array:
        x, r = self._layout.state[:, rows].astype(float)
        bodies = self._layout.body[rows]
        if self._stepper is not None:
            return self._stepper.energy(bodies, self._dt / 2 * x, r)
        modes = self._layout.mode[bodies]
        x *= self._dt / 2 * self._models.frequencies[modes]
        energy: Array = (np.einsum("bm,bm->b", x, x) + np.einsum("bm,bm->b", r, r)) / 2
        return energy if self._contacts is None else energy + self._contacts.residual.stored(bodies, modes)

    def _with_contact(self) -> "BatchContact":
        if self._contacts is None:
            raise StepError(f"nothing can touch bodies of ROM {self.rom.name!r}: allowed is a scene with contact")
        return self._contacts

    def _with_base(self) -> "BatchCarried":
        if self._carried is None:
            raise StepError(f"no base carries bodies of ROM {self.rom.name!r}: allowed is a scene with a moving frame")
        return self._carried

    def _read_output(self, part: int, output: str) -> Array:
        """An output of x (part 0) or r (part 1)."""
        maps, layout = self._models.output_maps(output), self._layout
        field = np.empty((self.size, maps[0].shape[1]), self.dtype)
        for chunk in layout.sort(self._coefficients.factors):
            for segment in chunk.segments:
                np.matmul(layout.state[part, segment.rows], maps[segment.mode], out=field[segment.rows])
        field = np.take(field, layout.row, axis=0)
        return field.reshape(self.size, -1, 3) if len(self.rom.nodes) else field

    def _loads(self, environment: "ActiveEnvironment") -> Array:
        """What acts by itself in the step of each body, in the middle of it, (size, loads)."""
        times, which = distinct(self._account[TIME] + self._dt / 2)
        loads = np.array([environment.loads_at(time) for time in times])
        bad = np.flatnonzero(~(np.abs(loads) <= self._input_limit).all(axis=1))
        if len(bad):
            raise StepError(
                f"loads at {times[bad[0]]:g} s: {loads[bad[0]].tolist()}: allowed are numbers within "
                f"{self._input_limit:.0e}; all bodies were left as they were"
            )
        return loads[which]

    def _check_input(self, u: ArrayLike, on_error: str) -> tuple[Array, Array]:
        """Inputs (size, p), and the bodies to hold still; theirs are zero then."""
        if type(u) is not Array and hides_numbers(u):
            raise StepError("input: allowed are numbers in N, given: an array that masks some of them")
        try:
            u = np.asarray(u)
        except ValueError:
            raise StepError(f"input: allowed are {self.inputs} numbers in N, given: rows of several lengths") from None
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
