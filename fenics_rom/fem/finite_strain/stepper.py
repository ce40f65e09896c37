"""Steps of a full-order body that deforms largely: energy-consistent midpoint steps, or equilibria without inertia."""

from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import SolverError, StepError
from fenics_rom.fem.finite_strain import residuals
from fenics_rom.fem.finite_strain.account import book_equilibrium, book_motion
from fenics_rom.fem.finite_strain.arc_length import ArcLength, PathStart
from fenics_rom.fem.finite_strain.equilibria import FactoredTangent, solve_equilibrium, unstable_message
from fenics_rom.fem.finite_strain.follower_loads import FollowerLoad, TendonPull
from fenics_rom.fem.finite_strain.found_forces import ForcesInNewton, FoundForces, mean_forces
from fenics_rom.fem.finite_strain.gmres import Gmres
from fenics_rom.fem.finite_strain.held_equilibria import chambers_alone, solve_held
from fenics_rom.fem.finite_strain.kept_factor import KeptFactor
from fenics_rom.fem.finite_strain.model import ExternalForce, FiniteStrainModel, multiply
from fenics_rom.fem.finite_strain.newton import MAX_ITERATIONS, NewtonIterate, NotConvergedError, solve_step
from fenics_rom.fem.finite_strain.predictor import Predictor
from fenics_rom.fem.finite_strain.residuals import MidpointResidual, QuasiStaticResidual, StepResidual, StepStart
from fenics_rom.fem.finite_strain.step_parts import LoadParts, StepParts, parted_message
from fenics_rom.fem.finite_strain.stresses import IDENTITY, MidpointStresses
from fenics_rom.fem.finite_strain.tangent_matrix import TangentMatrix
from fenics_rom.fem.full_order_body import FullOrderBody
from fenics_rom.fem.points_of_step import PointsOfStep
from fenics_rom.io.progress import Report, silent
from fenics_rom.mechanics.active_environment import ActiveEnvironment
from fenics_rom.mechanics.contact import ObstacleMotion
from fenics_rom.mechanics.step import StepInput
from fenics_rom.mechanics.viscoelasticity import MaxwellBranches
from fenics_rom.system.system import System

SMALLEST_PART = 1 / 64  # share of a step below which none is tried
SMALLEST_LOAD = 1 / 1024  # the same of what the load of an equilibrium changes by


class FiniteStrainStepper(FullOrderBody):
    """Steps a body that deforms largely from rest, see mechanics.step; every rank must call every method.

    Args:
        system, dt, environment, ledger: as in FullOrderBody.
        model: what deforms in the system.

    Attributes, beside those of FullOrderBody:
        newton: iterations of Newton's method in the last step.
        products: products with tangents in the last step.
        factors: how often a matrix was factored so far.
        parted: steps that were taken in parts, as Newton's method did not soon solve them whole.
        finest: smallest share of a step that was taken.
        negative_pivots: of the tangent at the last equilibrium, none where it is stable; without contact and strokes.
        report: told of the iterations that find an equilibrium.
    """

    def __init__(
        self,
        system: System,
        model: FiniteStrainModel,
        dt: float,
        environment: ActiveEnvironment | None = None,
        *,
        ledger: bool = True,
    ):
        super().__init__(system, dt, environment, ledger)
        self.kind, self.reason, self._model = "newton", "the body deforms largely", model
        self.newton = self.products = self.factors = self.parted = 0
        self.finest = 1.0
        self.report: Report = silent
        self.negative_pivots, self._unstable, self._is_patient = 0, "", True
        self._following: tuple[tuple[float, FollowerLoad], ...] = ()  # the body, at the last equilibrium
        self._forces_in_newton: ForcesInNewton | None = None
        if self.interface is not None or self.actuators is not None:
            self._forces_in_newton = ForcesInNewton(self.interface, self.actuators)
        self._branches: MaxwellBranches | None = None
        series = None if environment is None else environment.environment.viscoelasticity
        if series is not None and self._has_inertia:  # an equilibrium is relaxed
            self._branches = MaxwellBranches(series, 2, 6 * len(model.points.weights), system.algebra.total)
        self._found: tuple[FollowerLoad, ...] = ()
        self._rubbing: tuple[TendonPull, ...] = ()
        if self.actuators is not None:
            tendons = {name: load for name, load in model.followers.items() if isinstance(load, TendonPull)}
            self._found = tuple(model.followers[name] for name in self.actuators.names)
            self._found += tuple(tendons[name].up_to(guide) for name, guide in self.actuators.guides)
            self._rubbing = tuple(tendons[name] for name in dict.fromkeys(name for name, _ in self.actuators.guides))
        self._before: tuple[Any, ...] = ()
        self._frame_terms = residuals.InFrame()
        self._trial = list[residuals.TrialStep]()  # that the last part of a step came to
        self._points: PointsOfStep | None = None  # in that part
        terms = model.mass, model.external_damping, model.spring
        self._matrix = TangentMatrix(model.points, model.material, model.unknowns, system.algebra.rows(), terms)
        self._krylov = Gmres(len(self.x), system.size, model.mass.mat.comm)
        self._predictor = Predictor(model.dot)
        self._parts = StepParts(SMALLEST_PART if self._has_inertia else SMALLEST_LOAD)
        self._kept: KeptFactor | None = None
        self._chambers = chambers_alone(self.interface, self.actuators, environment)
        tangent = FactoredTangent(self._matrix, self._krylov)
        self._tangent = tangent if self._chambers or not self._forces_in_newton else None
        self.set_state(self.x, self.v)
        self.check_start()

    @property
    def energy(self) -> float:
        """Stored energy ½ vᵀMv + ½ xᵀK_s x + ∫W and that of branches, J."""
        m, x, v = self._model, self.x, self.v
        energy = (m.dot(v, m.mass @ v) + m.dot(x, multiply(m.spring, x))) / 2 + m.points.integrate(self._start.W)
        return energy if self._branches is None else energy + self._branches.stored

    inverted = property(lambda self: self._model.inverted(self._start.H), doc="Points turned inside out, det F <= 0.")

    def diagnostics(self) -> tuple[str, ...]:
        """See Stepper."""
        parted = parted_message(self.parted, self.finest) if self.parted else ""
        return (*filter(None, [self._unstable, parted]), *super().diagnostics())

    def set_state(self, x: Array, v: Array) -> None:
        """Puts the body somewhere, moving, with relaxed branches.

        Args:
            x, v: local rows of displacement (m) and velocity (m/s), (rows here,) each.
        """
        if self._branches is not None:
            self._branches.resume(np.empty(0))
        self._arrive(x.reshape(-1, 1).copy(), v.reshape(-1, 1).copy())
        self._predictor.forget()
        self._parts.forget()
        self.negative_pivots, self._following = 0, ()

    def step(self, inputs: StepInput) -> float:
        """See Stepper; inputs are in the order of `System.input_matrix`.

        Raises:
            StepError: an input is not finite.
            SolverError: Newton's method did not converge, not even for the smallest part of a step.
        """
        self._before = self._state()
        self._advance(inputs, not self._has_inertia)
        self.time += self.dt
        return self.energy if self.ledger is not None else np.nan

    def equilibrium(self, inputs: StepInput) -> None:
        """Brings the body to rest, under inputs put on in as many parts as it takes."""
        self._predictor.forget()
        self._parts.forget()
        self._advance(inputs, quasi_static=True)

    def step_along(self, path: ArcLength, inputs_at: Callable[[float], StepInput]) -> None:
        """Goes on along the equilibrium path of inputs, which are given by load factor, as far as a step of it goes.

        Raises:
            StepError: an input is not finite.
            SolverError: as ArcLength.step.
        """
        assert self._tangent is not None

        def load(factor: float) -> ExternalForce:
            return self._load(inputs_at(factor).u)[0]

        equation, solution = path.step(PathStart(self._model, self._start, load, self.dt, self._tangent))
        book_equilibrium(self, equation, solution, None, None)
        self.newton, self.negative_pivots = solution.iterations, self._tangent.negative_pivots
        self._following = equation.external.following
        x, v = self.x + self.dt * solution.trial.v, np.zeros_like(self.x)
        self._arrive(x, v, solution.trial.stresses.F_end - IDENTITY)
        self.time += self.dt

    def rollback(self) -> None:
        """See Stepper."""
        self._restore(self._before)
        self._predictor.forget()
        self.time -= self.dt

    def _state(self) -> tuple[Any, ...]:
        sums = None if self.ledger is None else self.ledger.sums
        stability = self.negative_pivots, self._unstable
        relaxing = None if self._branches is None else self._branches.state
        return self._start, self.contact, self.reactions, self._following, stability, sums, relaxing

    def _restore(self, state: tuple[Any, ...]) -> None:
        self._start, self.contact, self.reactions, self._following, stability, sums, relaxing = state
        self.negative_pivots, self._unstable = stability
        self.x, self.v = self._start.x, self._start.v
        if self.ledger is not None:
            self.ledger.sums = sums
        if self._branches is not None:
            self._branches.state = relaxing

    def close(self) -> None:
        """Gives the memory back."""
        self._krylov.close()
        self._matrix.close()
        self._forget()
        if self._tangent is not None:
            self._tangent.close()

    def _forget(self) -> None:
        """Gives the factor back."""
        if self._kept is not None:
            self._kept.close()
            self._kept = None

    def _arrive(self, x: Array, v: Array, H: Array | None = None) -> None:
        """Makes x and v (rows here, 1) the state, whose displacement gradients (3, 3, P here) may be known."""
        self.x, self.v, self._start = x, v, StepStart.at(self._model, x, v, H)

    def _load(self, u: Array) -> tuple[ExternalForce, Array, Array]:
        """The force of inputs u in the active contact mode, inputs without what is found, and strokes (n,)."""
        s, followers, contact = self.system, self._model.followers, self.contact_mode
        width = self.input_matrix.shape[1]
        if u.shape != (width,) or not np.isfinite(u).all():
            raise StepError(f"input {u.tolist()}: use {width} finite numbers in contact mode {contact!r}")
        u, given = (u, np.empty(0)) if self.actuators is None else self.actuators.split(u)
        dead, following, at = u.copy(), [], s.contacts[contact].shape[1]
        for name, columns in s.actuators.items():
            if name in followers:
                if u[at]:
                    following.append((float(u[at]), followers[name]))
                dead[at] = 0.0
            at += columns.shape[1]
        return ExternalForce(self._dead_force(dead), tuple(following), self._found, self._rubbing), u, given

    def _dead_force(self, u: Array) -> Array:
        """Force (rows here, 1), N, of inputs (p,) that do not follow the body."""
        return self.input_matrix @ u[:, None]

    def _advance(self, inputs: StepInput, quasi_static: bool) -> None:
        """Takes a step, in parts where Newton's method does not soon solve it; if none is, nothing has changed."""
        (load, u, given), state = self._load(inputs.u), self._state()
        strokes, before = load.strokes(self._start.u), self.reactions if quasi_static else None
        self.newton, products = 0, self._krylov.products
        missing = self._unbalanced(load.ramped(self._following, 0.0)) if quasi_static else None
        parts, found = self._parts_of(quasi_static), list[tuple[float, FoundForces]]()
        while (done := sum(share for share, _ in found)) < 1.0:
            parts.begin(done)
            while True:
                share = parts.share
                try:
                    goal = self.actuators.towards(given, strokes, before, done + share) if self.actuators else given
                    self._is_patient = parts.is_patient
                    iterations = self._part(done, share, load, u, goal, inputs.obstacles, missing)
                    break
                except (NotConvergedError, StepError):
                    if self._tangent is not None:
                        self._tangent.close()  # it is of a shape that led nowhere
                    if parts.cut():
                        continue
                    failure = self._failure(inputs.u, load, quasi_static, done)
                    self._restore(state)
                    raise SolverError(failure) from None
            parts.solved(iterations)
            found.append((share, FoundForces(self.contact, self.reactions)))
        self._following = load.following if quasi_static else ()
        self.products = self._krylov.products - products
        if len(found) > 1:
            self.parted, self.finest = self.parted + 1, min(self.finest, *(share for share, _ in found))
            if not quasi_static:  # equilibria have the forces of their end
                self.contact, self.reactions = mean_forces(found)

    def _parts_of(self, quasi_static: bool) -> StepParts:
        """What chooses the parts of a step: of loads that are put on at rest, others than of steps of a run."""
        if quasi_static and self._tangent is not None:
            return LoadParts(SMALLEST_LOAD)
        return StepParts(SMALLEST_LOAD) if quasi_static and self._has_inertia else self._parts

    def _failure(self, u: Array, load: ExternalForce, quasi_static: bool, done: float) -> str:
        """Why a step could not be taken, and what to do; a part of it was `done`."""
        smallest, lower, reached = f"1/{round(1 / SMALLEST_PART)} of a step of {self.dt:g} s", "the load or dt", ""
        if quasi_static:
            smallest, lower = f"1/{round(1 / SMALLEST_LOAD)} of its load", "the load"
            reached = f" more than the {done:.3g} of it that were put on"
            if self._tangent is not None and self._chambers is None:
                zero, load = np.zeros_like(self.x), load.ramped(self._following, done)
                here = QuasiStaticResidual(self._model, self._start, load, self.dt, zero).evaluate(zero)
                reached += self._tangent.limit_point(here, self._model, self.system.body.nodes)
        return (
            f"Newton's method did not converge at t = {self.time:.6g} s in contact mode {self.contact_mode!r} "
            f"under the inputs [{', '.join(f'{value:.6g}' for value in u)}], not even for {smallest}{reached}: lower "
            f"{lower}, or the body is pushed beyond what this mesh and material can follow"
        )

    def _unbalanced(self, load: ExternalForce) -> Array:
        """Force (rows here, 1), N, that a load, what was found and elasticity leave at the start of a step."""
        zero = np.zeros_like(self.x)
        rest = QuasiStaticResidual(self._model, self._start, load, self.dt, zero).evaluate(zero, self.reactions)
        points = self._points_in(self.dt, at_rest=True)
        return rest.residual if points is None else rest.residual + points.force_before(self.contact)

    def _points_in(self, h: float, at_rest: bool) -> PointsOfStep | None:
        """The contact points in a part of h, s, of motion or of equilibria; None where nothing can touch."""
        return None if self.interface is None else PointsOfStep(self.interface, self.x, self.v, h)

    def _part(
        self,
        done: float,
        share: float,
        load: ExternalForce,
        u: Array,
        given: Array,
        obstacles: ObstacleMotion | None,
        missing: Array | None,
    ) -> int:
        """Takes the part of a step that begins when `done` of it is taken, to given strokes (n,); its iterations."""
        h, start = share * self.dt, self._start
        equation: StepResidual
        if missing is None:
            if self._branches is not None:
                self._branches.set_time_step(h)
            equation = MidpointResidual(self._model, start, load, h, self._matrix, self._branches, self._frame_terms)
        else:
            load = load.ramped(self._following, done + share)
            equation = QuasiStaticResidual(self._model, start, load, h, (1 - done - share) * missing)
        motion = None if obstacles is None else obstacles.part(done, share, self.dt)
        self._points = self._points_in(h, missing is not None)
        if self._forces_in_newton is not None:
            self._forces_in_newton.begin(equation, self._points, motion, u, given, self._is_patient)
        solution = self._solution(equation, done + share, given)
        if missing is not None and self._tangent is not None:
            self._note_stability(self._tangent.negative_pivots, done, share)
        self.newton += solution.iterations
        trial, heat = solution.trial, 0.0
        self._trial = [trial]
        if self._branches is not None and isinstance(trial.stresses, MidpointStresses):
            Ė, σ = trial.stresses.rate
            heat = self._branches.step(np.stack([self._model.points.weights * Ė, σ]).reshape(2, -1))
        if isinstance(equation, QuasiStaticResidual):
            book_equilibrium(self, equation, solution, self._points, motion)
        else:
            book_motion(self, equation, solution, self._points, heat)
        x = self.x + h * trial.v
        v = np.zeros_like(x) if missing is not None else 2 * trial.v - self.v
        self._predictor.note(trial.v, h)
        self.contact, self.reactions = solution.found
        self._arrive(x, v, trial.stresses.F_end - IDENTITY)
        return solution.iterations

    def _note_stability(self, negative_pivots: int, done: float, share: float) -> None:
        """Refuses parts of a step that lead to an equilibrium that is less stable, but for the smallest: told then."""
        if negative_pivots > self.negative_pivots:
            if share > SMALLEST_PART:
                raise NotConvergedError
            self._unstable = self._unstable or unstable_message(self.time, done, share, negative_pivots)
        self.negative_pivots = negative_pivots

    def _solution(self, equation: StepResidual, load: float, given: Array) -> NewtonIterate:
        """Solves the equations to a share of a step's load, with a kept factor if that is good enough."""
        if isinstance(equation, QuasiStaticResidual) and self._tangent is not None:

            def tell(iteration: int, residual: float) -> None:
                what = f"equilibrium: load {load:.3g}, residual {residual:.0e}, iteration"
                self.report(what, iteration, MAX_ITERATIONS)

            if self._chambers is not None:
                return solve_held(equation, self._tangent, self._chambers, given, self.reactions, tell)
            of = FoundForces(self.contact, self.reactions), self._model.dot, tell
            return solve_equilibrium(equation, self._tangent, *of)
        guesses, products = self._guesses(equation), self._krylov.products
        if self._kept is not None and self._kept.serves(equation):
            with suppress(NotConvergedError):
                solution = self._tried(equation, guesses)
                if not self._kept.is_worth_keeping(solution.iterations + self._krylov.products - products):
                    self._forget()
                return solution
        with suppress(NotConvergedError, SolverError):
            self._factor(equation, stressed=True)
            return self._tried(equation, guesses)
        if self._predictor.is_smooth:
            self._predictor.is_smooth = False
            self._forget()
            return self._solution(equation, load, given)
        if self._kept is not None and not self._is_patient:
            raise NotConvergedError
        self._factor(equation, stressed=False)
        return self._tried(equation, guesses, by_secants=False)

    def _tried(self, equation: StepResidual, guesses: list[Array], by_secants: bool = True) -> NewtonIterate:
        kept, forces, last = self._kept, self._forces_in_newton, FoundForces(self.contact, self.reactions)
        assert kept is not None
        is_dear = forces is not None and forces.depend_on(kept.factor)
        if kept.turn(equation, guesses[-1], is_dear) and forces is not None:
            forces.use(kept.factor)
        try:
            how = kept.factor, kept.secants, self._krylov, forces, self._model.dot, last, by_secants, self._is_patient
            return solve_step(equation, guesses, *how)
        except NotConvergedError:
            if forces is not None:
                forces.rollback()
            raise

    def _factor(self, equation: StepResidual, stressed: bool) -> None:
        """Makes a factor, soon if with stresses; SolverError if these make its matrix indefinite."""
        self._forget()
        self._kept = KeptFactor(self._matrix, equation, self.reactions, stressed, self._predictor.is_smooth)
        self.factors += 1

    def _guesses(self, equation: StepResidual) -> list[Array]:
        """Mid-step velocities to begin the search with."""
        if isinstance(equation, QuasiStaticResidual):
            return [np.zeros_like(self.x), *self._predictor.last]
        return self._predictor.guesses(self.v)
