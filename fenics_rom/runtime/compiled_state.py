"""Many linear bodies of one ROM among obstacles, as they are in the arrays of a batch, and what can be read of them.

What a body is, is stacked, bodies first: a state for each contact mode, in arrays as `compiled.linear_step` has them.
One simulator has what all bodies share, and is put where a body is for what is read of one alone.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError, check_known
from fenics_rom.mechanics.active_environment import ActiveEnvironment
from fenics_rom.mechanics.compiled.gas import Filled
from fenics_rom.mechanics.contact import ContactSolution
from fenics_rom.mechanics.contact_search import ContactSearch
from fenics_rom.mechanics.step import StepperState
from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.batch_skin import BatchSkin
from fenics_rom.runtime.compiled.branches import RATIO
from fenics_rom.runtime.compiled.linear_bodies import Told
from fenics_rom.runtime.compiled.linear_step import State
from fenics_rom.runtime.compiled.touching import Begun
from fenics_rom.runtime.compiled_mode import Mode
from fenics_rom.runtime.filled_bodies import FilledBodies
from fenics_rom.runtime.simulator import Simulator
from fenics_rom.runtime.steppers.clearance import stretch_of
from fenics_rom.runtime.steppers.residual_maps import strained_back
from fenics_rom.runtime.steppers.stepper import ReducedStepper
from fenics_rom.runtime.tension_watch import pulled_columns

if TYPE_CHECKING:
    from fenics_rom.mechanics.compiled_contact import CompiledContact
    from fenics_rom.mechanics.rubbing import Rubbing
    from fenics_rom.runtime.batch_touch import BatchTouch
    from fenics_rom.runtime.steppers.contact_interface import ContactInterface

NO_SHAPES, NO_POINTS = np.zeros((0, 17)), np.zeros((0, 3))
LOST_IN_SWITCHING = 4  # a row of the account
ENTRIES = {
    "supplied": 0,
    "dissipated": 1,
    "supplied_by_obstacles": 2,
    "dissipated_in_contact": 3,
    "lost_in_switching": LOST_IN_SWITCHING,
}


class CompiledState(FilledBodies):
    """Linear bodies among obstacles as they are; properties and methods as of `Batch`, where arguments are checked.

    Args:
        single: has what all bodies share.
        size: number of bodies.
        ledger: whether to keep accounts.

    Attributes:
        frozen: (size,) bodies that began inside an obstacle.
    """

    input_limit, dtype, is_compiled = 1e75, np.dtype(float), True
    _touch: "BatchTouch | None" = None  # None where there is no sense of touch

    def __init__(self, single: Simulator, size: int, ledger: bool):
        self._single, self._dt, self.size, self.ledger = single, single.dt, size, ledger
        self._strokes, law = len(single.integrator.reactions), self.rom.environment.contact_law  # how many forces
        self._nothing_acts = None if single.environment else ActiveEnvironment(self.rom.environment, {})
        obstacles, P = len(self._shapes), len(self._points)
        self._mode, self._modes, self.steps = np.zeros(size, int), list[Mode](), 0
        self._widths, self._numbers = self.rom.contacts, {name: k for k, name in enumerate(self.rom.contact_models)}
        self._m = max(model.order for model in self._models)
        self._friction, self.frozen = np.full(size, 0.0 if law is None else float(law.friction)), np.zeros(size, bool)
        self._clearance = np.zeros((4, size))  # as in `touching.Clearance`; 0 where it is not known
        self._apart = np.zeros((size, obstacles * P))
        self._filled = Filled(np.zeros((size, self._strokes)), np.zeros((size, self._strokes)))
        self._began, self._taken = np.zeros(size), np.zeros(size, int)  # s, and steps since then
        sizes = (size, obstacles * P, 3), (size, obstacles * P)
        self._begun, self._after = (Begun(np.zeros(sizes[0]), np.zeros(sizes[1], int)) for _ in range(2))
        self._searches = dict[int, ContactSearch]()  # of bodies that took a step otherwise
        self._told, self._new = (Told(np.zeros(size, int), np.zeros((size, 5)), *self._nothing(size)) for _ in range(2))
        self._account = np.zeros((5, size))
        self._offsets = np.tile(self._environment.offsets_at(0.0), (size, 1, 1))
        self._placed = np.full(self._offsets.shape, np.nan)  # where obstacles were put; NaN: where the scene says
        self._velocities = np.zeros((size, *self._environment.state.velocities.shape))
        self._outputs: dict[tuple[int, str], tuple[Array, Array]] = {}
        self._pulled = pulled_columns(self.rom, max(self._widths.values()))
        self._least_tensions = np.zeros((len(self._pulled), size))
        self._make_modes()
        if single.sensed is not None:
            from fenics_rom.runtime.batch_touch import BatchTouch  # here, as few bodies have one

            self._touch = BatchTouch(self.rom, size, obstacles, self._felt)
        self._skin = None
        if self._interface is not None and self._interface.skin is not None:
            self._skin = BatchSkin(self, self._interface.skin, self._environment.obstacles, are_quick=True)

    def _nothing(self, count: int) -> tuple[Array, Array, Array]:
        """Contact of bodies that nothing touches, as in `Told`."""
        P = len(self._points)
        return np.zeros((count, P, 3)), np.zeros((count, len(self._shapes), 3)), np.zeros((count, P))

    def _make_modes(self) -> None:
        """What depends on the time step; states stay."""
        known = {mode.name: mode.states for mode in self._modes}
        self._modes, stepper = [], self._single.integrator
        for name, model in self.rom.contact_models.items():
            stepper.restore(name, self._at_rest(name), self._dt)
            loops = stepper.kernel.compiled_step  # type: ignore[attr-defined]
            n, m, k, body = loops.body.branches.shape[1], model.order, len(loops.body.R), loops.body
            sizes = ((2, m), (self.rom.rigid,), (4, k), (n, 2, m), (n, 2, k), (self._strokes,)) * 2
            states = known.get(name) or State(*(np.zeros((self.size, *shape)) for shape in sizes))
            self._modes.append(Mode(name, body, body, states, stretch_of(body.points), loops.keep_rows))

    def _at_rest(self, name: str) -> StepperState:
        rest = np.zeros(2 * self.rom.contact_models[name].order), np.zeros(self.rom.rigid), np.empty(0)
        return StepperState(*rest, None, self._first_search, {}, np.zeros(self._strokes))

    @property
    def rom(self) -> Rom:
        """Of what acts in its scene."""
        return self._single.rom

    @property
    def _environment(self) -> ActiveEnvironment:
        acts = self._single.environment or self._nothing_acts
        assert acts is not None
        return acts

    @property
    def _models(self) -> list[ContactModel]:
        return list(self.rom.contact_models.values())

    @property
    def _interface(self) -> "ContactInterface | None":
        return self._single.integrator.interface

    @property
    def _solver(self) -> "CompiledContact":
        assert self._interface is not None
        return self._interface.solver  # type: ignore[return-value]

    @property
    def _shapes(self) -> Array:
        """Of the obstacles, (O, 17)."""
        return NO_SHAPES if self._interface is None else self._solver.shapes

    @property
    def _points(self) -> Array:
        """That can be touched, at rest, (P, 3), m."""
        return NO_POINTS if self._interface is None else self._solver.points

    @property
    def _first_search(self) -> ContactSearch | None:
        return None if self._interface is None else self._solver.first_search

    def _enter(self, body: int) -> ReducedStepper:
        """The simulator's stepper where a body is."""
        mode, stepper = self._modes[self._mode[body]], self._single.integrator
        states, search = mode.states, self._search_of(body)
        relaxed = states.relaxed_beyond[body], states.relaxed[body, :, 0]
        auxiliary = np.concatenate([part.ravel() for part in (states.beyond[body], *relaxed)])
        now = states.halves[body].ravel(), states.rigid[body], auxiliary
        stepper.restore(mode.name, StepperState(*now, None, search, {}, states.reactions[body].copy()), self._dt)
        return stepper

    def _search_of(self, body: int) -> ContactSearch | None:
        """What the search of its next step begins with; None where nothing can touch."""
        search, swung = self._searches.get(body, self._first_search), self._begun.swung[body]
        if search is None:
            return None
        return search._replace(forces=self._begun.forces[body].copy(), swung=swung.copy() if swung.any() else None)

    def _contact_of(self, body: int) -> ContactSolution | None:
        """Contact in its last step, as far as forces of the points say."""
        forces, none = self._told.forces[body], np.empty((0, 3))
        if not forces.any():
            return None
        w = np.zeros((len(self._shapes), 3))
        return ContactSolution(forces.copy(), 0, np.empty(0, int), none, none, w, None)

    # --- what can be read --------------------------------------------------------------------------------------------

    @property
    def dt(self) -> float:
        """Time step, s."""
        return self._dt

    @dt.setter
    def dt(self, h: float) -> None:
        self._began, self._taken = self.time, np.zeros(self.size, int)
        self._dt = h
        self._make_modes()

    @property
    def contact(self) -> Array:
        """(size,)."""
        return np.array(list(self.rom.contact_models))[self._mode]

    @property
    def time(self) -> Array:
        """(size,), s."""
        time: Array = self._began + self._taken * self._dt
        return time

    @property
    def energy(self) -> Array:
        """(size,), J."""
        energy = np.empty(self.size)
        for bodies, mode in self._by_mode():
            halves, (g, y, ġ, ẏ) = mode.states.halves[bodies], mode.states.beyond[bodies].transpose(1, 0, 2)
            stored = np.einsum("bp,bp->b", g, y) + mode.body.τ**2 * np.einsum("bp,bp->b", ġ, ẏ)
            for relaxed in (mode.states.relaxed[bodies], mode.states.relaxed_beyond[bodies]):
                stored += np.einsum("n,bnk,bnk->b", mode.body.branches[RATIO], relaxed[:, :, 0], relaxed[:, :, 1])
            energy[bodies] = (np.einsum("bim,bim->b", halves, halves) + stored) / 2
        return energy + self._gas_energy(np.arange(self.size))

    def _by_mode(self, bodies: Array | None = None) -> list[tuple[Array, Mode]]:
        """Those of some bodies (n,), None: of all, that are in each contact mode."""
        modes = self._mode if bodies is None else self._mode[bodies]
        parts = [((modes == k).nonzero()[0], mode) for k, mode in enumerate(self._modes)]
        return [(part if bodies is None else bodies[part], mode) for part, mode in parts if len(part)]

    def account(self, entry: str) -> Array:
        """A sum of the energy account (size,), J, by its name in `Batch`."""
        return self._account[ENTRIES[entry]].copy() if entry in ENTRIES else np.zeros(self.size)

    @property
    def friction(self) -> Array:
        """(size,)."""
        return self._friction.copy()

    @friction.setter
    def friction(self, μ: Array) -> None:
        self._friction[:] = μ

    @property
    def inexact(self) -> Array:
        """(size,)."""
        return self._counted(lambda search: search.residual.steps)

    @property
    def held_back(self) -> Array:
        """(size,)."""
        return self._counted(lambda search: search.held.steps)

    def _counted(self, steps: Callable[[ContactSearch], int]) -> Array:
        """Steps (size,) that searches have counted."""
        counts = np.zeros(self.size, int)
        for body, search in self._searches.items():
            counts[body] = steps(search)
        return counts

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
        """(size,): of no linear body."""
        return np.zeros(self.size, bool)

    @property
    def mismatch(self) -> Array:
        """(size,): of no linear body."""
        return np.zeros(self.size)

    def contact_force(self, obstacle: str) -> Array:
        """(size, 3), N."""
        return self._told.resultants[:, self._number_of(obstacle)].copy()

    def _number_of(self, obstacle: str) -> int:
        names = list(self._environment.obstacles)
        check_known("obstacle", obstacle, names, StepError)
        return names.index(obstacle)

    @property
    def point_forces(self) -> Array:
        """(size, P, 3), N."""
        return self._told.forces.copy()

    def state(self, bodies: Array) -> tuple[Array, Array]:
        """(bodies, m) each."""
        q, r = np.zeros((2, len(bodies), self._m))
        for k in np.unique(self._mode[bodies]):
            at, states = (self._mode[bodies] == k).nonzero()[0], self._modes[k].states
            e, rates = states.halves[bodies[at]].transpose(1, 0, 2)
            q[at, : e.shape[1]], r[at, : e.shape[1]] = e / self._models[k].safe_frequencies, rates
            q[at, : self.rom.rigid] = states.rigid[bodies[at]]
        return q, r

    def displacement(self, output: str) -> Array:
        """(size, points, 3), m."""
        return self._read_output(0, output)

    def velocity(self, output: str) -> Array:
        """(size, points, 3), m/s."""
        return self._read_output(1, output)

    def _read_output(self, part: int, output: str) -> Array:
        """An output of displacements (0) or velocities (1)."""
        check_known("output", output, self.rom.outputs, StepError)
        state, field = self.state(np.arange(self.size))[part], np.zeros((self.size, len(self.rom.outputs[output])))
        for own, mode in self._by_mode():
            by_state, by_force = self._maps(self._numbers[mode.name], output)
            field[own] = state[own, : len(by_state)] @ by_state
            if not part and len(by_force):
                field[own] += mode.states.beyond[own, 0] @ by_force
        return field.reshape(self.size, -1, 3) if len(self.rom.nodes) else field

    def _maps(self, mode: int, output: str) -> tuple[Array, Array]:
        """What an output is of q (m, rows), and of what is carried beyond the basis (3P, rows)."""
        if (mode, output) not in self._outputs:
            rows, model = self.rom.outputs[output], self._models[mode]
            self._single.integrator.restore(self._modes[mode].name, self._at_rest(self._modes[mode].name), self._dt)
            residual, by_force = self._single.integrator.kernel.residual, np.empty((0, len(rows)))
            if residual is not None:
                elastic = slice(self.rom.rigid, None)
                by_force = strained_back(residual.part, (rows[:, elastic] / np.sqrt(self.rom.stiffness[elastic])).T)
            self._outputs[mode, output] = (rows @ model.coordinates).T, by_force
        return self._outputs[mode, output]

    def shape(self, body: int) -> Array:
        """(nodes, 3), m."""
        field, residual = self.rom.reconstruct(self.shape_coordinates(body)), self._enter(body).kernel.residual
        if residual is not None:
            assert self._interface is not None
            nodes = self._interface.points.nodes
            field[nodes] += residual.beyond_shared[: len(nodes)]
        return field

    def shape_coordinates(self, body: int) -> Array:
        """(k,)."""
        ((q,), _), elastic = self.state(np.array([body])), slice(self.rom.rigid, None)
        C, residual = self._models[self._mode[body]].coordinates, self._enter(body).kernel.residual
        shape: Array = C @ q[: C.shape[1]]
        if residual is not None:
            shape[elastic] += residual.strained / np.sqrt(self.rom.stiffness[elastic])
        return shape

    def reading(self, name: str) -> Array:
        """(size, ...)."""
        from fenics_rom.runtime.readings import named_reading  # here, as few bodies have readings

        named_reading(self.rom, name)
        if self._touch is not None:
            return self._touch.shown(name, self.time)
        return np.array([self._felt(body, name) for body in range(self.size)])

    def _felt(self, body: int, name: str) -> Array:
        """A reading of a body, without what a sensor adds."""
        from fenics_rom.runtime.readings import readable

        model, points = self._models[self._mode[body]], self._interface and self._interface.points
        contact, pressing, touched = self._modes[self._mode[body]].name, self._told.pressing[body], dict[str, Any]()
        own = self.state(np.array([body]))[0][0, : model.order], self.shape_coordinates(body)
        touched["amplitudes"] = lambda: self._environment.amplitudes_at(float(self.time[body]))
        if self._touch is not None:
            touched |= {"rubbing": lambda: self._rubbing(body), "places": lambda: self.rom.nodes + self.shape(body)}
            touched["forces"] = self._told.forces[body]
        return self.rom.readings[name].read(readable(self.rom, contact, *own, points, pressing, **touched))

    def _rubbing(self, body: int) -> "Rubbing":
        """What friction did in its last step."""
        assert self._touch is not None
        mode = self._modes[self._touch.mode[body]]
        states = State(*(part[body] for part in mode.states))
        given = mode.touch, mode.body.inverse_ω, states, self._shapes, self._begun.forces[body]
        return self._touch.rubbing(body, *given, float(self._friction[body]))

    def whereabouts(self, bodies: Array) -> tuple[Array, Array, Array, Array]:
        """q (m, B) of bodies (B,), numbers of the contact modes (B,), and rows of the obstacles (O, any, B).

        Then position and quaternion of frames that move (7, B), m; else (0, B).
        """
        q = self.state(bodies)[0].T
        return q, self._mode[bodies], self._offsets[bodies].transpose(1, 2, 0), np.zeros((0, len(bodies)))

    def offsets_of(self, body: int, offsets: Array | None = None) -> Array:
        """Rows of the obstacles of a body now, or of some kept (O, any, size), (O, any)."""
        own: Array = (self._offsets[body] if offsets is None else offsets[..., body]).copy()
        return own
