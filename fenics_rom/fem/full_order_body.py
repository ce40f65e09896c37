"""What the full-order steppers share: a state on many ranks, how it is read, and where it can be touched."""

from collections.abc import Callable

import numpy as np
import scipy.sparse
from numpy import ndarray as Array

from fenics_rom.fem.solved_rows import SolvedRows
from fenics_rom.mechanics.active_environment import ActiveEnvironment
from fenics_rom.mechanics.actuator_forces import ActuatorForces
from fenics_rom.mechanics.contact import ContactSolution
from fenics_rom.mechanics.energy_ledger import EnergyLedger
from fenics_rom.mechanics.kept_rows import RowsOperator
from fenics_rom.mechanics.make_contact_solver import make_contact_solver
from fenics_rom.mechanics.points_operator import Operator, components
from fenics_rom.mechanics.skin_path import Instant, Placement, moved_between
from fenics_rom.mechanics.skin_watch import SkinWatch, displaced
from fenics_rom.mechanics.surface_checks import check_apart
from fenics_rom.mechanics.time_step_monitor import TimeStepMonitor
from fenics_rom.system.system import System

MOST_WHOLE = 300  # points, of which W is made as a whole


class FullOrderInterface:
    """The contact points of a body and the obstacles; every rank must call every method.

    Attributes:
        points: that can be touched.
        solver, solve: of the contact law; its `solve`.
        touches_itself: whether the body may.
        Sᵀ: (rows here, 3P) unit forces on the points, sparse.
    """

    def __init__(self, system: System, environment: ActiveEnvironment):
        law = environment.environment.contact_law
        assert law is not None
        self._algebra = system.algebra
        self.points = system.points_of_contact()
        body, touching = system.body, environment.environment.self_contact
        own = self.points.own_surface(touching, body.triangles)
        check_apart(body.nodes, body.triangles, body.contact_surfaces, touching)
        self.touches_itself = own is not None
        obstacles = list(environment.obstacles.values())
        faces = self.points.faces(body.triangles) if environment.environment.touches_faces else None
        self.solver = make_contact_solver(self.points.coordinates, obstacles, law, own, faces)
        self.solve, self._environment = self.solver.solve, environment
        self._watch = SkinWatch(system.skin())
        self._seen: Instant | None = None
        of, nodes, weights = self.points.weights()
        shares = scipy.sparse.csr_matrix((weights, (of, nodes)), shape=(len(self.points.coordinates), len(body.nodes)))
        fields = body.unknowns.matrix[:, system.algebra.rows()]
        self.Sᵀ = scipy.sparse.csr_matrix((scipy.sparse.kron(shares, np.eye(3)) @ fields).T)

    def check_start(self, displacement: Array, field: Array) -> None:
        """A StepError where points moved by (P, 3), m, or a body displaced by a field (N, 3), m, are in an obstacle."""
        offsets, obstacles = self._environment.state.offsets, self._environment.obstacles
        self.solver.check_start(displacement, offsets, list(obstacles))
        there = displaced(obstacles, offsets)
        self._watch.check_start(places := self._watch.skin.places(field), there)
        self._seen = Instant(Placement(places[self._watch.skin.few_rows], lambda: places), there)

    def look(self, step: int, time: float, field: Array, last: bool = False) -> None:
        """Looks after a step, at a time, s, where obstacles are in a body displaced by a field (N, 3), m, if it is due.

        `last`: it is, whatever happened since the last look.
        """
        watch, there = self._watch, displaced(self._environment.obstacles, self._environment.state.offsets)
        places = watch.skin.places(field)
        now = Instant(Placement(places[watch.skin.few_rows], lambda: places), there)
        if last or step >= watch.next_look or self._seen is None or moved_between(self._seen, now) > watch.room:
            watch.look(step, time, now, self._seen, self.solver.law.stiffness is not None)
            self._seen = now

    @property
    def messages(self) -> tuple[str, ...]:
        """What went through the surface so far, and which obstacles jumped."""
        return (*self._watch.messages, *self._environment.messages)

    def at_points(self, x: Array) -> Array:
        """What a field (rows here, 1) is at the contact points, (P, 3)."""
        return self._algebra.inner(self.Sᵀ, x).reshape(-1, 3)

    def force(self, contact: ContactSolution | None) -> Array:
        """The contact force (rows here, 1), N."""
        if contact is None:
            return np.zeros((self.Sᵀ.shape[0], 1))
        force: Array = self.Sᵀ @ contact.forces.reshape(-1, 1)
        return force

    @property
    def has_many(self) -> bool:
        """Whether there are so many points that W is found where forces act."""
        return len(self.points.coordinates) > MOST_WHOLE

    def operator(self, solve: Callable[[Array], Array]) -> Operator:
        """W of the points, m/s/N, from what gives A⁻¹ times columns: of many points it is found where forces act."""
        if self.has_many:
            P = len(self.points.coordinates)
            return RowsOperator(SolvedRows(P, lambda some: self._algebra.inner(self.Sᵀ, solve(self.columns(some)))))
        return self.delassus(solve(self.Sᵀ.toarray()))

    def columns(self, some: Array) -> Array:
        """Sᵀ of some points (s,), (rows here, 3 s): unit forces."""
        columns: Array = self.Sᵀ[:, components(some)].toarray()
        return columns

    def delassus(self, solved: Array) -> Array:
        """W (3P, 3P), m/s/N, from A⁻¹ Sᵀ (rows here, 3P)."""
        W = self._algebra.inner(self.Sᵀ, solved)
        return (W + W.T) / 2


class FullOrderBody:
    """A full-order body at rest; every rank must call every method.

    Args:
        system: the full-order model.
        dt: time step, s; may be set anew before any step.
        environment: obstacles, and whether there is inertia; None: no obstacles, and inertia.
        ledger: whether the energy account is kept.

    Attributes:
        time: s.
        x, v: displacement and velocity (rows here, 1), m and m/s.
        contact: in the last step; None where nothing touched.
        contact_mode: the active one, in whose order the inputs are.
        ledger: the energy account, or None.
        interface: the contact points; None where nothing can touch.
        actuators: those whose forces are found in the step; None where there are none.
        reactions: (n,) their forces in the last step, of strokes that are given, then at guides, N or Pa.
        time_step_monitor: of the length of the steps, where an account is kept.

    """

    def __init__(self, system: System, dt: float, environment: ActiveEnvironment | None, ledger: bool):
        self.system, self.dt, self.time = system, dt, 0.0
        self.contact: ContactSolution | None = None
        self.contact_mode = next(iter(system.contacts))
        self.interface: FullOrderInterface | None = None
        if environment is not None and environment.environment.contact_law is not None:
            self.interface = FullOrderInterface(system, environment)
        self.actuators: ActuatorForces | None = None
        self.reactions = np.empty(0)
        if environment is not None and environment.environment.finds_forces:
            acting = environment.environment
            self.actuators = ActuatorForces(acting.controls, acting.guides, system.widths, acting.gases)
            self.reactions = np.zeros(len(self.actuators.columns))
        self.ledger = EnergyLedger() if ledger else None
        self.time_step_monitor = TimeStepMonitor()
        rows = system.algebra.rows()
        self.x = np.zeros((rows.stop - rows.start, 1))
        self.v = np.zeros_like(self.x)
        self._has_inertia = environment is None or environment.environment.has_inertia
        self._input_matrices: dict[str, Array] = {}

    @property
    def input_matrix(self) -> Array:
        """B (rows here, p) of the active contact mode."""
        if self.contact_mode not in self._input_matrices:
            self._input_matrices[self.contact_mode] = self.system.input_matrix(self.contact_mode)
        return self._input_matrices[self.contact_mode]

    def switch(self, contact: str) -> float:
        """See Stepper; the state stays as it is, and nothing is lost."""
        self.contact_mode = contact
        return 0.0

    def set_time_step(self, dt: float) -> None:
        """See Stepper."""
        self.dt = dt

    def flush(self) -> None:
        """See Stepper; every step books by itself."""

    def point_displacement(self) -> Array:
        """See Stepper."""
        assert self.interface is not None
        return self.interface.at_points(self.x)

    def check_start(self) -> None:
        """A StepError where the body is in an obstacle."""
        if self.interface is not None:
            self.interface.check_start(self.point_displacement(), self.displacement())

    def diagnostics(self) -> tuple[str, ...]:
        """See Stepper."""
        of_contact = () if self.interface is None else self.interface.solver.search.messages
        through = () if self.interface is None else self.interface.messages
        return tuple(filter(None, [*of_contact, self.time_step_monitor.message, *through]))

    def displacement(self, output: str | None = None) -> Array:
        """Displacement, m: of a named output (points, 3), or of every mesh node (nodes, 3)."""
        return self._field(self.x, output)

    def velocity(self, output: str | None = None) -> Array:
        """Velocity, m/s, as displacement."""
        return self._field(self.v, output)

    @property
    def shape(self) -> Array:
        """Displacement of every mesh node in the frame of the body, (nodes, 3), m."""
        return self._field(self.x, None)

    def _field(self, x: Array, output: str | None) -> Array:
        """A field (rows here, 1) at an output, or on all nodes, the same on every rank."""
        s = self.system
        if output is not None:
            return s.algebra.inner(s.outputs[output], x).reshape(-1, 3)
        return s.body.unknowns.expand(s.algebra.gather(x)).reshape(-1, 3)
