"""Full-order steps of a linear body: passive midpoint integration, one factorisation per step size, paper (2)-(4)."""

from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError
from fenics_rom.fem.direct import PetscFactor
from fenics_rom.fem.full_order_body import FullOrderBody
from fenics_rom.fem.petsc_matrix import ExtendedMatrix, combination
from fenics_rom.fem.points_of_step import PointsOfStep
from fenics_rom.mechanics.active_environment import ActiveEnvironment
from fenics_rom.mechanics.contact import ContactSolution, ObstacleMotion, equilibrium_work
from fenics_rom.mechanics.energy_ledger import EnergyLedger
from fenics_rom.mechanics.points_held_back import PointsHeldBack
from fenics_rom.mechanics.points_operator import Operator
from fenics_rom.mechanics.step import StepInput
from fenics_rom.mechanics.viscoelasticity import MaxwellBranches
from fenics_rom.system.system import System


class FullOrderStepper(FullOrderBody):
    """Steps a linear body from rest, see mechanics.step; every rank must call every method.

    Arguments and attributes as in FullOrderBody; matrices are PETSc's. Without an account a step is one solve and two
    products.

    Raises:
        StepError: the body begins in an obstacle.
    """

    def __init__(self, system: System, dt: float, environment: ActiveEnvironment | None = None, *, ledger: bool = True):
        super().__init__(system, dt, environment, ledger)
        self.kind, self.reason = "midpoint", "the model is linear"
        self._momentum = np.zeros_like(self.x)  # M v
        self._elastic = np.zeros_like(self.x)  # K x
        self._stiffness = ExtendedMatrix(system.stiffness.mat)  # type: ignore[attr-defined]
        self._factored: tuple[float, PetscFactor] | None = None
        self._points: PointsOfStep | None = None  # in the step that is taken
        self._energy: float | None = 0.0
        self._before: tuple[Any, ...] = ()
        self._branches: MaxwellBranches | None = None
        series = None if environment is None else environment.environment.viscoelasticity
        if series is not None and self._has_inertia:  # an equilibrium is relaxed
            self._branches = MaxwellBranches(series, 2, len(self.x), system.algebra.total)
            self._branches.set_time_step(dt)
        self.check_start()

    @property
    def energy(self) -> float:
        """Stored energy ½ vᵀMv + ½ xᵀKx and that of branches, J."""
        if self._energy is None:
            self._renew_products()
            self._energy = self._dot(self.v, self._momentum) / 2 + self._dot(self.x, self._elastic) / 2
            if self._branches is not None:
                self._energy += self._branches.stored
        return self._energy

    def set_state(self, x: Array, v: Array) -> None:
        """Puts the body somewhere, moving, with relaxed branches.

        Args:
            x, v: local rows of displacement (m) and velocity (m/s), (rows here,) each.
        """
        if self._branches is not None:
            self._branches.resume(np.empty(0))
        self.x, self.v = x.reshape(-1, 1).copy(), v.reshape(-1, 1).copy()
        self._momentum = self.system.mass @ self.v
        self._elastic = self._stiffness @ self.x
        self._energy = None

    def step(self, inputs: StepInput) -> float:
        """See Stepper."""
        u = inputs.u
        if u.shape != (self.input_matrix.shape[1],):
            raise ValueError
        if self.actuators is None:
            return self.step_under(self._force(u), inputs.obstacles)
        u, given = self.actuators.split(u)
        return self.step_under(self._force(u), inputs.obstacles, (u, given))

    def _force(self, u: Array) -> Array:
        """Force (rows here,), N, of inputs (p,)."""
        force: Array = self.input_matrix @ u
        return force

    def step_under(
        self, force: Array, obstacles: ObstacleMotion | None = None, given: tuple[Array, Array] | None = None
    ) -> float:
        """Advances by dt under a force (rows here,), N; the energy is told where an account is kept, else NaN.

        Where forces of actuators are found in the step, `given` is the input (p,) without them, and what is given for
        them (n,).

        In K x large terms cancel (bending against stretching), so that in double precision the energy account of a
        thin body would close to 1e-10 only. Products with K in extended precision, one refinement of the solve, and
        M v and K x carried along by their increments close it to round-off. Without an account none of that is done.

        Raises:
            StepError: the step overflows, or there are no contact forces; no step was taken.
        """
        h = self.dt
        factor, self._points = self._factor(h), self._points_in(h)
        self._renew_products()
        force = force[:, None]
        right = force + 2 / h * self._momentum - self._elastic if self._has_inertia else force - self._elastic
        if self._branches is not None:
            right -= self._branches.pull[1][:, None]
        v = factor.solve(right)
        found, rubbed = self.reactions, None
        if given is None or self.actuators is None:
            contact = self._solve_contact(v, obstacles)
        else:
            found, contact = self._solve_actuators(v, obstacles, *given)
            by_strokes, rubbed = (part[:, None] for part in self.actuators.parts(self._columns, found))
            force, right = force + by_strokes, right + by_strokes + rubbed
        if contact is not None and self._points is not None:
            right = right + self._points.force(contact)
        if contact is not None or given is not None:
            v = factor.solve(right)
        if not np.isfinite(self._dot(v, v)):
            raise StepError("the input is so large that the step overflows; the state was left as it was")
        sums = None if self.ledger is None else self.ledger.sums
        self._before = (self.x, self.v, self._momentum, self._elastic, self.contact, self.reactions), sums
        Kv = None
        if self.ledger is not None:
            Mv, Kv = self._refined(factor, right, v)
            if not self._has_inertia:
                self._book_at_rest(self.ledger, force, rubbed, contact, obstacles, v)
            else:
                self.time_step_monitor.add(4 * self._dot(v - self.v, Mv - self._momentum), self._dot(v, Mv))
                drawn = self._damped(v, Mv, Kv) if rubbed is None else self._damped(v, Mv, Kv) - rubbed
                self.ledger.book(supplied=h * self._dot(force, v), dissipated=h * self._dot(v, drawn))
                if contact is not None and self._points is not None:
                    self.ledger.book_contact(*contact.work(self._points.velocities(v), h))
            self._momentum = 2 * Mv - self._momentum
            self._elastic = self._elastic + h * Kv
        if self._branches is not None:
            heat = self._branches.step(np.hstack([v, self._relaxing(v, self._stiffness @ v if Kv is None else Kv)]).T)
            if self.ledger is not None:
                self.ledger.book(dissipated=heat)
        self.contact, self.reactions = contact, found
        self.x = self.x + h * v
        if self._has_inertia:
            self.v = 2 * v - self.v
        self.time, self._energy = self.time + h, None
        return self.energy if self.ledger is not None else np.nan

    def rollback(self) -> None:
        """See Stepper."""
        state, sums = self._before
        self.x, self.v, self._momentum, self._elastic, self.contact, self.reactions = state
        self.time, self._energy = self.time - self.dt, None
        if self._branches is not None:
            self._branches.rollback()
        if self.ledger is not None:
            self.ledger.sums = sums

    def close(self) -> None:
        """Gives the factor's memory back."""
        if self._factored is not None:
            self._factored[1].close()
            self._factored = None

    def _points_in(self, h: float) -> PointsOfStep | None:
        """The contact points in a step of h, s; None where nothing can touch."""
        return None if self.interface is None else PointsOfStep(self.interface, self.x, self.v)

    def _solve_contact(
        self, free: Array, obstacles: ObstacleMotion | None, delassus: Operator | None = None
    ) -> ContactSolution | None:
        """Contact of a step, from its mid-step velocity without (rows here, 1) and the Delassus operator."""
        if self._points is None or obstacles is None:
            return None
        points = self._points.motion(free, self._points.velocities(free))
        operator = self._points.operator(self._delassus if delassus is None else delassus)
        return self._points.interface.solver.solve(points, operator, self.dt, obstacles, not self._has_inertia)

    def _solve_actuators(
        self, free: Array, obstacles: ObstacleMotion | None, u: Array, given: Array
    ) -> tuple[Array, ContactSolution | None]:
        """Forces (n,) of actuators that are found in a step, and contact; `free` as in `_solve_contact`."""
        assert self.actuators is not None
        strokes, rates, freely = self.system.algebra.inner(self._columns, np.hstack([self.x, self.v, free])).T
        if self._has_inertia:
            targets = self.actuators.targets(given, strokes, rates, self.dt)
        else:
            targets = self.actuators.resting_targets(given, strokes, self.dt)

        def touch(z: Array, holding: Array, *, gives: Array | None) -> tuple[ContactSolution | None, Array]:
            delassus = self._held_back.delassus(holding, gives)
            contact = self._solve_contact(free + self._spread @ z[:, None], obstacles, delassus)
            if contact is None or self._points is None:
                return contact, np.zeros(len(z))
            return contact, self._stroke_motion.T @ self._points.seen(contact.forces).ravel()

        return self.actuators.solve(
            u, freely, self._stroke_compliance, targets, self.reactions, None if self.interface is None else touch
        )

    def _book_at_rest(
        self,
        ledger: EnergyLedger,
        force: Array,
        rubbed: Array | None,
        contact: ContactSolution | None,
        obstacles: ObstacleMotion | None,
        v: Array,
    ) -> None:
        """Books a step between equilibria, before it is taken, as Equilibrium of runtime/steppers does."""
        h, held = self.dt, self._elastic
        if self._points is not None and obstacles is not None:
            held = held - self._points.force_before(self.contact)
            velocities, solver = self._points.velocities(v), self._points.interface.solver
            of_step = velocities, h, obstacles, solver.law, solver.speeds
            ledger.book_contact(*equilibrium_work(self.contact, contact, *of_step))
        if rubbed is not None and self.actuators is not None:
            rubbed_before = self.actuators.parts(self._columns, self.reactions)[1][:, None]
            held = held - rubbed_before
            lag = h / 2 * self._dot(rubbed - rubbed_before, v)
            ledger.book(dissipated=-h * self._dot(rubbed, v), numerical=lag)
        ledger.book(supplied=h / 2 * self._dot(held + force, v))

    def _renew_products(self) -> None:
        """M v and K x anew, where no account carries them along."""
        if self.ledger is None:
            self._momentum, self._elastic = self.system.mass @ self.v, self.system.stiffness @ self.x

    def _refined(self, factor: PetscFactor, right: Array, v: Array) -> tuple[Array, Array]:
        """Refines A v = right once, in place; M v and K v."""
        s = self.system
        Mv, Kv = s.mass @ v, self._stiffness @ v
        correction = factor.solve(right - self._resisted(v, Mv, Kv))
        v += correction
        return Mv + s.mass @ correction, Kv + s.stiffness @ correction

    def _resisted(self, v: Array, Mv: Array, Kv: Array) -> Array:
        """A v, A = 2/h M + D + h/2 K, with the stiffening time of branches beside h/2; without inertia A = h K."""
        h = self.dt
        if not self._has_inertia:
            return h * Kv
        return 2 / h * Mv + self._damped(v, Mv, Kv) + h / 2 * Kv + self._stiffening_time * self._relaxing(v, Kv)

    def _relaxing(self, v: Array, Kv: Array) -> Array:
        """What of K v the material does, and not springs to the ground."""
        springs = self.system.springs
        return Kv if springs is None else Kv - springs @ v

    @property
    def _stiffening_time(self) -> float:
        """Of branches in a step, s."""
        return 0.0 if self._branches is None else self._branches.stiffening_time

    def _damped(self, v: Array, Mv: Array, Kv: Array) -> Array:
        """D v."""
        if self.system.rayleigh is None:
            return self.system.damping @ v
        α, β = self.system.rayleigh
        return α * Mv + β * Kv

    def _dot(self, a: Array, b: Array) -> float:
        return float(self.system.algebra.inner(a, b)[0, 0])

    def _factor(self, h: float) -> PetscFactor:
        if self._factored is None or self._factored[0] != h:
            self.close()
            s = self.system
            if self._branches is not None:
                self._branches.set_time_step(h)
            elastic = h / 2 + self._stiffening_time
            terms: tuple[tuple[float, Any], ...] = ((h, s.stiffness),)
            if self._has_inertia and s.rayleigh is None:
                terms = (2 / h, s.mass), (1.0, s.damping), (elastic, s.stiffness)
            elif self._has_inertia and s.rayleigh is not None:
                α, β = s.rayleigh
                terms = (2 / h + α, s.mass), (elastic + β, s.stiffness)
            if s.springs is not None and self._branches is not None:
                terms += ((-self._stiffening_time, s.springs),)
            self._factored = h, PetscFactor(combination(*terms), one_by_one=True)
            if self.interface is not None:
                self._delassus = self.interface.operator(self._factored[1].solve)
            if self.actuators is not None:
                self._columns = self.input_matrix[:, self.actuators.columns]
                self._spread, inner = self._factored[1].solve(self._columns), self.system.algebra.inner
                self._stroke_compliance = W = self.actuators.compliance(inner(self._columns, self._spread))
                if self.interface is not None:
                    self._stroke_motion = inner(self.interface.Sᵀ, self._spread)
                    self._held_back = PointsHeldBack(self._delassus, self._stroke_motion, W)
        return self._factored[1]
