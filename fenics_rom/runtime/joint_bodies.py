"""Many soft bodies of one ROM, stepped together as arrays.

The midpoint rule in x = 2 q / h and r, with w = 2 v̂ and a = (4/h) (2/h + D + h/2 γ)⁻¹, which no h makes large:

    w = a (h/2 G u + r - h²/4 γ x),   x⁺ = x + w,   r⁺ = w - r.

Where the damping is diagonal, so is a, and a step is a handful of elementwise operations on arrays of bodies × reduced
displacements. What this costs is memory traffic: bodies go through the step in chunks that stay in the cache. The rows
of all arrays are bodies sorted by contact mode, so that a force is one product for each mode of a chunk. A switch
projects the state where it is.

Bodies that an obstacle may be within reach of take their step again, with contact (`batch_contact.py`). Those that
bend far (`batch_deformation.py`) or that a base carries (`batch_carried.py`) take one of another kind.
"""

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError, shown
from fenics_rom.mechanics.body_axis import in_one_piece
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.batch_arrays import BatchLayout, PaddedModels, Segment, keep_freed_memory, stacked_state
from fenics_rom.runtime.environment_inputs import fit_environment
from fenics_rom.runtime.joint_state import BY_CONTACT, BY_OBSTACLES, DISSIPATED, LOST, SUPPLIED, TIME, JointState
from fenics_rom.runtime.tension_watch import pulled_columns

if TYPE_CHECKING:
    from collections.abc import Mapping

    from fenics_rom.mechanics.active_environment import SignalLike
    from fenics_rom.mechanics.base_path import BaseState
    from fenics_rom.runtime.batch_carried import BatchCarried
    from fenics_rom.runtime.batch_contact import BatchContact
    from fenics_rom.runtime.batch_deformation import BatchDeformation

MOST_TOGETHER = 1024  # bodies whose contact is found together: what their arrays take is bounded


class JointBodies(JointState):
    """Bodies that are stepped together; arguments, properties and methods as of `Batch`, where they are checked.

    States and obstacles are checked here; `bodies` are indices.
    """

    def __init__(
        self,
        rom: Rom,
        size: int,
        dt: float,
        dtype: np.dtype,
        ledger: bool,
        signals: "Mapping[str, SignalLike]",
        detail: str | None,
    ):
        keep_freed_memory()
        self._environment = None
        if not rom.environment.is_plain or signals:
            rom, self._environment = fit_environment(rom, None, signals)
        touches = rom.environment.contact_law is not None
        if touches or rom.deformation is not None or rom.environment.is_moving:
            dtype = np.dtype(float)
        self.rom, self.size, self.dtype = rom, size, dtype
        self._models = PaddedModels(rom, self.dtype)
        modes, p, m = self._models.inputs.shape
        try:
            self._layout = BatchLayout(self.size, modes, m, p, self.dtype)
        except MemoryError as error:
            raise StepError(f"size = {size}: use as many bodies as the memory holds: {error}") from error
        self._number_limit = float(np.finfo(self._layout.state.dtype).max) ** 0.25
        self.ledger = ledger
        self._account = np.zeros((6, self.size))
        self._works = np.empty((2, self.size), self.dtype)
        self._ones = np.ones(m, self.dtype)
        self._contacts = self._deformation = self._carried = self._skin = None
        if detail is not None and not rom.environment.is_moving:
            raise StepError(f"detail = {shown(detail)}: use a ROM of a body in a moving frame")
        if rom.environment.is_moving:  # imports are here, as few scenes have such things
            from fenics_rom.runtime.batch_carried import BatchCarried

            assert self._environment is not None
            self._carried = BatchCarried(rom, self._environment, self._models, self._layout.mode, detail)
        elif rom.deformation is not None:
            from fenics_rom.runtime.batch_deformation import BatchDeformation

            self._deformation = BatchDeformation(rom, self._models.inputs, self._models.contact_columns, self.size)
        if touches:
            from fenics_rom.runtime.batch_contact import BatchContact

            assert self._environment is not None
            self._contacts = BatchContact(rom, self._environment, m, self.size)
        self._pulled = pulled_columns(rom, self._models.contact_columns)
        self._least_tensions = np.zeros((len(self._pulled), self.size))
        self._stepper = self._carried or self._deformation
        self.steps = 0
        self._dt = 1.0
        self.dt = dt
        if self._contacts is not None and self._environment is not None and self._contacts.skin is not None:
            from fenics_rom.runtime.batch_skin import BatchSkin

            self._skin = BatchSkin(self, self._contacts.skin, self._environment.obstacles)

    @property
    def dt(self) -> float:
        """Time step, s."""
        return self._dt

    @dt.setter
    def dt(self, h: float) -> None:
        limit, ω, rigid = self._number_limit**2, self._models.frequencies, self.rom.rigid
        with np.errstate(over="ignore", invalid="ignore"):
            x = self._layout.state[0] * (self._dt / h)
            angles = h / 2 * ω
        if not (angles[:, rigid:].min() >= 1 / limit and angles.max() <= limit and np.abs(x).max() <= limit):
            raise StepError(f"dt = {h!r}: too far from the model's periods for {self.dtype}")
        self._layout.state[0] = x
        self._layout.discard_coefficients()
        self._dt, self._coefficients = h, self._models.step_coefficients(h)
        # A step is passive: it adds at most h |G u| to the length of (ω q, r), and x is at most 2/(h ω) times that, or
        # along rigid motions twice that in each step.
        # So what bounds the inputs bounds the states, and nothing else needs to be looked at in a step: below this
        # limit no number overflows in the first `_number_limit` steps from rest, 4e9 of them in float32.
        gain = np.abs(self._models.inputs).sum(axis=(1, 2)) * np.maximum(h, 2 / ω[:, rigid:].min(axis=1))
        self.input_limit = self._number_limit / max(1.0, gain.max())
        if self._contacts is not None:
            self._contacts.set_time_step(h)
        if self._stepper is not None:
            self._stepper.set_time_step(h)

    def set_state(self, q: Array, r: Array, bodies: Array, on_error: str) -> None:
        """As of `Batch`."""
        ω, modes = self._models.frequencies, self._layout.mode[bodies]
        shape = (len(bodies), ω.shape[1])
        state = stacked_state(q, r, shape)
        with np.errstate(over="ignore"):
            state[0] *= 2 / self._dt
            size = np.abs(state) * np.maximum(1.0, [self._dt / 2 * ω[modes], np.ones(shape)])
        if not (size <= self._number_limit).all():  # NaN is not, either
            raise StepError(f"state: use finite numbers, within {self._number_limit:.0e} in 2 q / dt, √γ q and r")
        if state[:, np.arange(shape[1]) >= self._models.orders[modes, None]].any():
            raise StepError("state: beyond the order of a body's contact mode only zeros are allowed")
        if self._contacts is not None:
            inside = self._contacts.inside(bodies, modes, self._dt / 2 * state[0])
            self._contacts.begin(bodies, self._allowed_inside(bodies, inside, on_error))
        self._layout.state[:, self._layout.row[bodies]] = state
        if self._stepper is not None:
            self._stepper.begin(bodies, self._dt / 2 * state[0], state[1])
        if self._skin is not None:
            self._skin.forget(bodies)
        if self._contacts is not None and on_error == "reset":
            self.reset(bodies[inside], "hold")

    def reset(self, bodies: Array, on_error: str) -> None:
        """As of `Batch`."""
        if self._contacts is not None:
            inside = self._contacts.inside_at_rest(bodies)
            self._contacts.reset(bodies, self._allowed_inside(bodies, inside, on_error))
        self._layout.reset(bodies)
        self._account[:, bodies] = self._least_tensions[:, bodies] = 0
        if self._stepper is not None:
            self._stepper.begin(bodies, *np.zeros((2, len(bodies), self._models.frequencies.shape[1])))
        if self._carried is not None:
            self._carried.reset(bodies)
        if self._skin is not None:
            self._skin.begin(bodies)

    def place_obstacle(self, name: str, displacement: Array, bodies: Array) -> None:
        """As of `Batch`."""
        self._touching.place(name, displacement, bodies)

    def place(self, base: "BaseState", bodies: Array) -> None:
        """As of `Batch`."""
        self._on_bases.place(base, bodies)

    def can_switch(self, modes: Array, bodies: Array) -> bool:
        """Whether bodies can get to contact modes, by their numbers: all but strained ones that a base carries.

        What the next contact mode of these cannot hold becomes further modes, for which arrays have no room.
        """
        moving = bodies[self._layout.mode[bodies] != modes]
        return self._carried is None or not self._layout.state[:, self._layout.row[moving]].any()

    def switch(self, modes: Array, bodies: Array) -> None:
        """Makes contact modes active, by their numbers (B,), of bodies (B,)."""
        moves, count = self._layout.mode[bodies] != modes, len(self._models.names)
        bodies, end = bodies[moves], modes[moves]
        start = self._layout.mode[bodies]
        state, rows = self._layout.state, self._layout.row[bodies]
        before = self._energy(rows) if self.ledger else 0.0
        pairs = start * count + end
        for pair in np.unique(pairs) if self._stepper is None else ():  # else they share a basis, or are at rest
            moved, (first, second) = rows[pairs == pair], divmod(int(pair), count)
            strained = self._dt / 2 * state[0, moved] * self._models.frequencies[first]
            state[:, moved] = state[:, moved] @ self._models.switch_map(first, second)
            if self._contacts is not None:
                elastic = slice(self.rom.rigid, self._models.orders[second])
                e = self._contacts.residual.carry_over(first, second, bodies[pairs == pair], strained)
                state[0, moved, elastic] = 2 / self._dt * e / self._models.frequencies[second, elastic]
        self._layout.enter(bodies, end)
        if self._deformation is not None:
            self._deformation.entered(bodies)
        if self.ledger:
            self._account[LOST, bodies] += before - self._energy(rows)

    def step(self, u: Array, base: "BaseState | None", held: Array, on_error: str) -> Array:
        """As of `Batch`, but for "reset", under inputs and bases that are fine but for those of bodies held."""
        if base is not None and self._carried is None:
            raise StepError(f"step {self.steps}: base: use a body in a moving frame that a rigid base carries")
        if self._environment is not None:
            u = np.hstack([u, self._loads(self._environment)])
        contacts = self._contacts
        if contacts is not None:
            held = np.union1d(held, contacts.frozen.nonzero()[0])
            contacts.begin_step(self._account[TIME], held)
            self._follow_obstacles(contacts)
        if self._carried is not None:
            self._carried.move_base(base, self._account[TIME], held)
        if self._stepper is None:
            self._step_linear(u, held)
        else:
            held = self._step_otherwise(self._stepper, u, held, on_error)
        for column, least in zip(self._pulled.values(), self._least_tensions, strict=True):
            np.minimum(least, u[:, column], out=least)
        if self._skin is not None:
            self._skin.look_in_turn()
        return held

    def _step_linear(self, u: Array, held: Array) -> None:
        """The step of linear bodies under inputs and loads (size, p), but for those held."""
        contacts, near = self._contacts, []
        layout, (factors, push, couplings) = self._layout, self._coefficients
        chunks = layout.sort(factors)
        if len(held):
            before = layout.state[:, layout.row[held]], self._account[:, held]
        np.take(u, layout.body, axis=0, out=layout.inputs, mode="clip")  # the other modes of take go through a buffer
        for x, r, elastic, inertial, w, spare, segments in chunks:
            for segment in segments:
                np.matmul(segment.u, push[segment.mode], out=segment.w)
            np.multiply(elastic, x, out=spare)
            np.add(w, spare, out=w)
            np.multiply(inertial, r, out=spare)
            np.add(w, spare, out=w)
            driven = w if contacts is None or not any(couplings) else w.copy()
            for segment in segments:
                self._respond(segment, couplings[segment.mode], self._works[:, segment.rows])
            if contacts is not None:
                first, last = segments[0].rows.start, segments[-1].rows.stop
                found = contacts.look(layout.body[first:last], w, r).nonzero()[0]
                near.append((first + found, *(np.take(part, found, axis=0) for part in (x, r, driven))))
            np.add(x, w, out=x)
            np.subtract(w, r, out=r)
        self._account[TIME] += self._dt
        if contacts is not None:
            self._meet_obstacles(contacts, *(np.concatenate(parts) for parts in zip(*near, strict=True)))
            contacts.end_step()
        if self.ledger:
            self._account[SUPPLIED : DISSIPATED + 1] += self._dt / 2 * np.take(self._works, layout.row, axis=1)
        self.steps += 1
        if len(held):
            layout.state[:, layout.row[held]], self._account[:, held] = before

    def _step_otherwise(
        self, stepper: "BatchCarried | BatchDeformation", u: Array, held: Array, on_error: str
    ) -> Array:
        """The step that a stepper takes; the bodies that did not."""
        layout = self._layout
        x, r = layout.state[:, layout.row].transpose(0, 2, 1)
        v, works = stepper.step(layout.mode, self._dt / 2 * x, r, u)
        lost = ~(np.isfinite(v).all(axis=0) & np.isfinite(works).all(axis=0))
        if lost.any():
            lost[held] = False
            if lost.any() and on_error == "raise":
                raise StepError(
                    f"step {self.steps}, body {lost.argmax()}: {stepper.refuses}; all bodies were left as they were"
                )
            held = np.union1d(held, lost.nonzero()[0])
        goes = np.ones(self.size, bool)
        goes[held] = False
        x, r = np.where(goes, x + 2 * v, x), np.where(goes, 2 * v - r, r)
        layout.state[:, layout.row] = x.T, r.T
        stepper.accept(held, self._dt / 2 * x)
        self._account[TIME] += self._dt * goes
        if self.ledger:
            self._account[SUPPLIED : DISSIPATED + 1] += np.where(goes, works, 0.0)
        self.steps += 1
        return held

    def _respond(self, segment: Segment, coupling: tuple[Array, Array] | None, works: Array) -> None:
        """Makes w = 2 v̂ of what drives the bodies, and notes works (2, rows) of inputs and damping, in 2/h J."""
        if self.ledger:
            drawn = segment.w if coupling is None else np.matmul(segment.w, coupling[1], out=segment.spare)
            np.multiply(drawn, drawn, out=segment.spare)
            np.matmul(segment.spare, self._models.dissipation[segment.mode], out=works[1])
        if coupling is not None:
            segment.w[:] = np.matmul(segment.w, coupling[0], out=segment.spare)
        if self.ledger:
            force = np.matmul(segment.u, self._models.inputs[segment.mode], out=segment.spare)
            np.multiply(force, segment.w, out=force)
            np.matmul(force, self._ones, out=works[0])

    def _follow_obstacles(self, contacts: "BatchContact") -> None:
        """Makes the contact modes active that obstacles are nearest to, of the bodies that are near one."""
        bodies = contacts.watched()
        if len(bodies):
            nearest = contacts.nearest_modes(self._layout.mode[bodies], self.state(bodies)[0], bodies)
            self.switch(nearest, bodies)

    def _meet_obstacles(self, contacts: "BatchContact", rows: Array, x: Array, r: Array, driven: Array) -> None:
        """Takes the step of rows (B,) again, with contact.

        Args:
            contacts: of all bodies.
            rows: which.
            x, r: (B, m) where they were.
            driven: (B, m) what drives them without contact, as `StepCoefficients.push` has it; made another.
        """
        layout, couplings = self._layout, self._coefficients.coupling
        modes = layout.mode[layout.body[rows]]
        for mode in np.unique(modes).tolist():
            inside = (modes == mode).nonzero()[0]
            for part in np.array_split(inside, math.ceil(len(inside) / MOST_TOGETHER)):
                within, own = in_one_piece(part), in_one_piece(rows[part])
                x_own, r_own, w, coupling = x[within], r[within], driven[within], couplings[mode]
                u, bodies, works = layout.inputs[own], layout.body[own], np.zeros((2, len(x_own)))
                free = w if coupling is None else w @ coupling[0]
                touched, pushed, done = contacts.step(mode, bodies, x_own, r_own, free)
                w[in_one_piece(touched)] += pushed
                self._respond(Segment(mode, slice(0), u, w, np.empty_like(w)), coupling, works)
                layout.state[0, own], layout.state[1, own] = x_own + w, w - r_own
                if self.ledger:
                    self._works[:, own] = works
                    self._account[BY_OBSTACLES : BY_CONTACT + 1, bodies] += done[:2]
                    self._account[SUPPLIED : DISSIPATED + 1, bodies] += done[0], done[1] + done[2]

    def _allowed_inside(self, bodies: Array, inside: Array, on_error: str) -> Array:
        """Which of the bodies to hold still, of those that are inside an obstacle."""
        if inside.any() and on_error == "raise":
            raise StepError(
                f"body {bodies[inside.argmax()]} is inside an obstacle: use a start outside of all of them, or "
                'on_error="hold"; all bodies were left as they were'
            )
        return inside
