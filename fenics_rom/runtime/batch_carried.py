"""Bodies of a batch that rigid bases carry, each with a twist of its own, and where these bases are.

A step is one linear system for each body, or elementwise where shapes do nothing to inertia. Arrays have bodies first.
"""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError, check_known
from fenics_rom.mechanics.active_environment import ActiveEnvironment
from fenics_rom.mechanics.base_fit import NEGLIGIBLE
from fenics_rom.mechanics.base_path import CONJUGATE, BaseState, quaternion_product, rotation_vectors
from fenics_rom.mechanics.environment import DETAILS
from fenics_rom.mechanics.frame_motion import world_displacement
from fenics_rom.mechanics.largest_turn import LARGEST_TURN
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.batch_arrays import distinct
from fenics_rom.runtime.batch_carried_step import CarriedMode, CarriedStep, lengths, products_of, turned_by
from fenics_rom.runtime.steppers.moving_frame import quasi_rigid
from fenics_rom.runtime.world_axes import world_outputs, world_rates

if TYPE_CHECKING:
    from fenics_rom.runtime.batch_arrays import PaddedModels

TOGETHER = 256  # bodies that go through a step together, so that their arrays stay in the cache
STILL = BaseState(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.zeros(3))


class _Taken(NamedTuple):
    """A step of all bodies: where it began, and what drove it."""

    mode: Array  # (B,)
    q: Array  # (m, B)
    r: Array  # (m, B)
    u: Array  # (B, p)
    start: BaseState
    end: BaseState


class BatchCarried:
    """How bodies of a ROM move that bases carry.

    Args:
        rom: of displacements that strain, without contact.
        environment: that acts.
        models: of the batch.
        modes: (B,) numbers of the contact modes that bodies are in, which the batch changes.
        detail: "full" or "quasi-rigid"; None: as the scene says.

    Attributes:
        base: now, of arrays (B, 3) and (B, 4).
        misfit: (B,) share that a base went otherwise in a step than its twists say, at most.
        distrusted: (B,) bodies that bent or turned too far.

    Raises:
        StepError: there is no such level of detail.
    """

    refuses = f"its base turns by more than {LARGEST_TURN:g} rad in the step, or its state after it is not finite"

    def __init__(
        self, rom: Rom, environment: ActiveEnvironment, models: "PaddedModels", modes: Array, detail: str | None
    ):
        frame, run, size = rom.moving_frame, environment.environment.run, len(modes)
        assert frame is not None
        detail = detail or (run.detail if run else "full")
        check_known("detail", detail, DETAILS, StepError)
        whole = frame if detail == "full" else quasi_rigid(frame)
        self._modes = [
            CarriedMode(rom, name, whole, environment, detail, models.contact_columns) for name in rom.contact_models
        ]
        self._environment, self._frame, self._mode, self._nodes = environment, frame, modes, rom.nodes
        self._extent = float(frame.inertia0[:3].sum() / 2 / frame.mass) ** 0.5
        self.base = self._ends = BaseState(*(np.tile(part, (size, 1)) for part in STILL))
        self.misfit, self.distrusted = np.zeros(size), np.zeros(size, bool)
        self._misfit, self._goes = np.zeros(size), np.zeros(size, bool)  # of the last step, and who took it
        self._taken = self._pending = _Taken(*(np.empty(0),) * 4, self.base, self.base)
        self.reset(np.arange(size))

    def set_time_step(self, h: float) -> None:
        """Of all bodies, s."""
        self._h = h
        self._goes[:] = False
        for mode in self._modes:
            mode.set_time_step(h)

    def begin(self, bodies: Array, q: Array, r: Array) -> None:
        """Bodies (B,) are put to q and r (B, m); their bases stay."""
        self.misfit[bodies], self.distrusted[bodies], self._goes[bodies] = 0.0, False, False

    def reset(self, bodies: Array) -> None:
        """Puts bases where they begin."""
        base = self._environment.base_at(0.0) or STILL._replace(position=self._frame.origin)
        self.place(BaseState(*(np.tile(part, (len(bodies), 1)) for part in base)), bodies)

    def place(self, base: BaseState, bodies: Array) -> None:
        """Puts the bases of bodies (B,) somewhere."""
        parts = tuple(part.copy() for part in self.base)  # those of the last step stay as they are
        for part, given in zip(parts, _with_unit_rotations(base), strict=True):
            part[bodies] = given
        self.base = BaseState(*parts)
        self._goes[bodies] = False

    def move_base(self, base: BaseState | None, times: Array, held: Array) -> None:
        """Notes where bases are at the end of a step that begins at times (B,), s; those of held bodies stay."""
        if base is not None:
            ends = _with_unit_rotations(base)
        else:
            instants, which = distinct(times)
            bases = [self._environment.base_at(time + self._h) for time in instants]
            known = [state for state in bases if state is not None]
            still = np.zeros_like(self.base.velocity)
            ends = (
                BaseState(*(np.stack(parts)[which] for parts in zip(*known, strict=True)))
                if len(known) == len(bases)
                else self.base._replace(velocity=still, angular_velocity=still)
            )
        parts = [np.array(part) for part in ends]
        for part, now in zip(parts, self.base, strict=True):
            part[held] = now[held]
        self._ends = BaseState(*parts)

    def energy(self, bodies: Array, q: Array, r: Array) -> Array:
        """Stored (B,), of bodies at q and r (B, m), J."""
        energy, modes = np.empty(len(bodies)), self._mode[bodies]
        for k, own in _parts(modes):
            m = len(self._modes[k].γ)
            base = BaseState(*(part[bodies[own]] for part in self.base))
            energy[own] = self._modes[k].energy(base, q[own, :m], r[own, :m])
        return energy

    def step(self, mode: Array, q: Array, r: Array, u: Array) -> tuple[Array, Array]:
        """Mid-step velocities (m, B) from q and r (m, B) under u (B, p), not finite where lost; works (2, B), J."""
        v, works = np.zeros_like(q), np.empty((2, len(mode)))
        self._pending = _Taken(mode.copy(), q, r, u, self.base, self._ends)
        with np.errstate(over="ignore", invalid="ignore"):
            for k, own in _parts(mode):
                step, _, _ = self._step_of(self._pending, k, own)
                v[: step.r̂.shape[1], own], works[:, own] = step.r̂.T, self._modes[k].works(self._h, step)
                self._misfit[own] = self._misfits(step, own)
        return v, works

    def accept(self, held: Array, q: Array) -> None:
        """The step is taken, to q (m, B), but for bodies that are held."""
        before, self._taken, self._goes[:] = self.base, self._pending, True
        self._goes[held] = False
        self.base = BaseState(
            *(np.where(self._goes[:, None], end, now) for end, now in zip(self._ends, before, strict=True))
        )
        np.maximum(self.misfit, np.where(self._goes, self._misfit, 0.0), out=self.misfit)
        speed = np.sqrt(products_of(self.base.angular_velocity, self.base.angular_velocity))
        for k, own in _parts(self._mode):
            mode = self._modes[k]
            self.distrusted[own] |= mode.watch.distrusts(np.sqrt(mode.γ) * q[: len(mode.γ), own].T, speed[own])

    @property
    def wrench(self) -> tuple[Array, Array]:
        """Of the bases on the bodies in the last step: forces, N, and torques, N m, (B, 3) in world axes."""
        force, torque = np.zeros((2, *self.base.velocity.shape))
        if self._goes.any():  # the step is taken again, as few ask
            for k, own in _parts(np.where(self._goes, self._taken.mode, -1)):
                if k >= 0:
                    step, q, u = self._step_of(self._taken, k, own)
                    force[own], torque[own] = self._modes[k].wrench(self._h, step, q, u)
        return force, torque

    def world_displacement(self, output: str, field: Array) -> Array:
        """Of points of an output that moved by (B, P, 3) in their frames, the same shape, m."""
        return world_outputs(self._frame, self.base, output, field)

    def world_velocity(self, output: str, field: Array, rate: Array) -> Array:
        """Of the same points that move with (B, P, 3) in their frames, m/s."""
        return world_rates(self._frame, self.base, output, field, rate)

    def world_shape(self, body: int, field: Array) -> Array:
        """Displacements (nodes, 3) of one body that has (nodes, 3) in its frame, m."""
        base = BaseState(*(part[body] for part in self.base))
        return world_displacement(base, self._frame.origin, self._nodes, field)

    def _step_of(self, taken: _Taken, k: int, own: Array) -> tuple[CarriedStep, Array, Array]:
        """The step of bodies in a contact mode; with q (B, m) and u (B, p)."""
        mode, (_, q, r, u, *bases) = self._modes[k], taken
        m = len(mode.γ)
        start, end = (BaseState(*(part[own] for part in state)) for state in bases)
        q_own, r_own, u_own = q[:m, own].T, r[:m, own].T, u[np.ix_(own, mode.columns)]
        return mode.step(self._h, (start, end), q_own, r_own, u_own), q_own, u_own

    def _misfits(self, step: CarriedStep, own: Array) -> Array:
        """By which share of it the motion of bases is not what their twists say."""
        h, (start, end) = self._h, (BaseState(*(part[own] for part in state)) for state in (self.base, self._ends))
        moved, said = end.position - start.position, h * turned_by(step.middle, step.v̂)
        half = np.hstack([np.ones((len(own), 1)), h / 2 * step.ω̂])
        led = quaternion_product(start.rotation, half / np.sqrt(products_of(half, half))[:, None])
        apart, turned = (
            rotation_vectors(quaternion_product(end.rotation, from_ * CONJUGATE)) for from_ in (led, start.rotation)
        )
        misfit = np.zeros(len(own))
        for off, largest, least in (
            (moved - said, (moved, said), NEGLIGIBLE * self._extent),
            (apart, (turned, h * step.ω̂), NEGLIGIBLE),
        ):
            size, of = lengths(off), np.maximum(*map(lengths, largest))
            np.maximum(misfit, np.where(size > least, size / np.where(of > 0, of, np.inf), 0.0), out=misfit)
        return misfit


def _with_unit_rotations(base: BaseState) -> BaseState:
    """Bases (B, ...) whose quaternions, which are of length 1 to a tolerance, are so to round-off."""
    length = np.sqrt(products_of(base.rotation, base.rotation))
    return base._replace(rotation=base.rotation / np.where(length > 0, length, 1.0)[:, None])


def _parts(mode: Array) -> list[tuple[int, Array]]:
    """The bodies of each contact mode, some at a time."""
    parts = []
    for k in np.unique(mode).tolist():
        own = (mode == k).nonzero()[0]
        parts += [(k, own[first : first + TOGETHER]) for first in range(0, len(own), TOGETHER)]
    return parts
