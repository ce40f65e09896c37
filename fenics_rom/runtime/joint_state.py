"""The bodies of a batch that are stepped together, as they are in its arrays, and what can be given to them."""

from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.batch_arrays import BatchLayout, PaddedModels, StepCoefficients, distinct

if TYPE_CHECKING:
    from fenics_rom.mechanics.active_environment import ActiveEnvironment
    from fenics_rom.mechanics.base_path import BaseState
    from fenics_rom.runtime.batch_carried import BatchCarried
    from fenics_rom.runtime.batch_contact import BatchContact
    from fenics_rom.runtime.batch_deformation import BatchDeformation
    from fenics_rom.runtime.batch_skin import BatchSkin

TIME, SUPPLIED, DISSIPATED, LOST, BY_OBSTACLES, BY_CONTACT = range(6)  # rows of the account
ENTRIES = {
    "supplied": SUPPLIED,
    "dissipated": DISSIPATED,
    "lost_in_switching": LOST,
    "supplied_by_obstacles": BY_OBSTACLES,
    "dissipated_in_contact": BY_CONTACT,
}


class JointState:
    """Bodies as they are in the arrays of a batch; properties and methods as of `Batch`."""

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
    _pulled: dict[str, int]  # column of each tendon whose tension is given
    _least_tensions: Array  # (n, size), N
    _deformation: "BatchDeformation | None"
    _carried: "BatchCarried | None"
    _stepper: "BatchCarried | BatchDeformation | None"  # of the two, that there is
    _environment: "ActiveEnvironment | None"
    _works: Array
    _ones: Array
    input_limit: float  # N, of all columns
    ledger: bool
    _account: Array

    @property
    def dt(self) -> float:
        """Time step, s."""
        return self._dt

    @property
    def contact(self) -> Array:
        """(size,)."""
        return np.array(self._models.names)[self._layout.mode]

    @property
    def time(self) -> Array:
        """(size,), s."""
        return self._account[TIME].copy()

    @property
    def energy(self) -> Array:
        """(size,), J."""
        energy = np.empty(self.size)
        energy[self._layout.body] = self._energy(slice(None))
        return energy

    def account(self, entry: str) -> Array:
        """A sum of the energy account (size,), J, by its name in `Batch`."""
        return self._account[ENTRIES[entry]].copy() if entry in ENTRIES else np.zeros(self.size)

    @property
    def friction(self) -> Array:
        """(size,)."""
        return self._touching.friction.copy()

    @friction.setter
    def friction(self, μ: Array) -> None:
        self._touching.friction[:] = μ

    @property
    def inexact(self) -> Array:
        """(size,)."""
        return self._touching.inexact.copy()

    @property
    def held_back(self) -> Array:
        """(size,)."""
        return self._touching.held_back.copy()

    @property
    def frozen(self) -> Array:
        """(size,)."""
        return np.zeros(self.size, bool) if self._contacts is None else self._contacts.frozen.copy()

    @property
    def through_skin(self) -> Array:
        """(size,), m."""
        return np.zeros(self.size) if self._skin is None else self._skin.depths()

    @property
    def least_tensions(self) -> dict[str, Array]:
        """(size,), N, by name."""
        return {name: row.copy() for name, row in zip(self._pulled, self._least_tensions, strict=True)}

    @property
    def beyond_training(self) -> Array:
        """(size,)."""
        return np.zeros(self.size, bool) if self._stepper is None else self._stepper.distrusted

    @property
    def mismatch(self) -> Array:
        """(size,)."""
        return np.zeros(self.size) if self._deformation is None else self._deformation.mismatch

    @property
    def base(self) -> "BaseState":
        """Of arrays (size, 3) and (size, 4)."""
        return self._on_bases.base

    @property
    def base_wrench(self) -> tuple[Array, Array]:
        """(size, 3), N and N m."""
        return self._on_bases.wrench

    @property
    def base_misfit(self) -> Array:
        """(size,)."""
        return self._on_bases.misfit.copy()

    @property
    def reactions(self) -> dict[str, Array]:
        """None: forces of actuators are given."""
        return {}

    def contact_force(self, obstacle: str) -> Array:
        """(size, 3), N."""
        return self._touching.resultant(obstacle)

    @property
    def point_forces(self) -> Array:
        """(size, P, 3), N."""
        return self._touching.point_forces

    def whereabouts(self, bodies: Array) -> tuple[Array, Array, Array, Array]:
        """As in CompiledState; displacements of the obstacles are in the axes of contact."""
        layout = self._layout
        q = layout.state[0, layout.row[bodies]].T * (self._dt / 2)
        return q, layout.mode[bodies], self._touching.offsets[..., bodies], np.zeros((0, len(bodies)))

    def offsets_of(self, body: int, offsets: Array | None = None) -> Array:
        """Displacements of the obstacles of a body now, or of some kept ones, (O, 3), m."""
        return self._touching.offsets_of(body, offsets)

    def state(self, bodies: Array) -> tuple[Array, Array]:
        """(bodies, m) each."""
        x, r = self._layout.state[:, self._layout.row[bodies]].astype(float)
        return self._dt / 2 * x, r

    def displacement(self, output: str) -> Array:
        """(size, points, 3), m."""
        field = self._dt / 2 * self._read_output(0, output)
        if self._contacts is not None:
            field += (self._beyond(np.arange(self.size)) @ self.rom.outputs[output].T).reshape(field.shape)
        return field if self._carried is None else self._carried.world_displacement(output, field)

    def velocity(self, output: str) -> Array:
        """(size, points, 3), m/s."""
        field = self._read_output(1, output)
        if self._carried is None:
            return field
        return self._carried.world_velocity(output, self._dt / 2 * self._read_output(0, output), field)

    def shape(self, body: int) -> Array:
        """(nodes, 3), m."""
        field = self.rom.reconstruct(self.shape_coordinates(body))
        if self._contacts is not None:
            nodes = self._contacts.points.nodes
            field[nodes] += self._contacts.residual.beyond_shared(body, self._layout.mode[body])[: len(nodes)]
        return field if self._carried is None else self._carried.world_shape(body, field)

    def shape_coordinates(self, body: int) -> Array:
        """(k,)."""
        ((q,), _), bodies = self.state(np.array([body])), np.array([body])
        C = list(self.rom.contact_models.values())[self._layout.mode[body]].coordinates
        shape: Array = C @ q[: C.shape[1]] + self._beyond(bodies)[0]
        return shape

    def reading(self, name: str) -> Array:
        """(size, ...)."""
        from fenics_rom.runtime.readings import named_reading, readable  # here, as few bodies have readings

        reading, contacts, read = named_reading(self.rom, name), self._contacts, []
        points, pressing = (None, None) if contacts is None else (contacts.points, contacts.normal_forces)
        for body, (contact, q) in enumerate(zip(self.contact, self.state(np.arange(self.size))[0], strict=True)):
            own, order = pressing if pressing is None else pressing[:, body], self.rom.contact_models[contact].order
            there = q[:order], self.shape_coordinates(body), points, own
            amplitudes = partial(self._amplitudes, float(self.time[body]))
            read.append(reading.read(readable(self.rom, contact, *there, amplitudes=amplitudes)))
        return np.array(read)

    def _amplitudes(self, time: float) -> dict[str, float]:
        """Of temperatures at a time, s, by name."""
        return {} if self._environment is None else self._environment.amplitudes_at(time)

    def _beyond(self, bodies: Array) -> Array:
        """What contact points of bodies (B,) yield beyond the contact mode, in the shared basis, (B, k)."""
        κ, rigid = self.rom.stiffness, self.rom.rigid
        beyond = np.zeros((len(bodies), len(κ)))
        if self._contacts is not None:
            beyond[:, rigid:] = self._contacts.residual.strained(self._layout.mode[bodies], bodies) / np.sqrt(κ[rigid:])
        return beyond

    def _energy(self, rows: slice | Array) -> Array:
        x, r = self._layout.state[:, rows].astype(float)
        bodies = self._layout.body[rows]
        if self._stepper is not None:
            return self._stepper.energy(bodies, self._dt / 2 * x, r)
        modes = self._layout.mode[bodies]
        x *= self._dt / 2 * self._models.frequencies[modes]
        energy: Array = (np.einsum("bm,bm->b", x, x) + np.einsum("bm,bm->b", r, r)) / 2
        return energy if self._contacts is None else energy + self._contacts.residual.stored(bodies, modes)

    @property
    def _touching(self) -> "BatchContact":
        assert self._contacts is not None
        return self._contacts

    @property
    def _on_bases(self) -> "BatchCarried":
        assert self._carried is not None
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
        bad = np.flatnonzero(~(np.abs(loads) <= self.input_limit).all(axis=1))
        if len(bad):
            raise StepError(
                f"loads at {times[bad[0]]:g} s: {loads[bad[0]].tolist()}: use numbers within "
                f"{self.input_limit:.0e}; all bodies were left as they were"
            )
        return loads[which]
