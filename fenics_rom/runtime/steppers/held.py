"""The step of a held body that deforms largely, whatever resists its shape and acts on it.

    2/h (v̂ - r) + f̂ = G u + B z + Sᵀ f,   q⁺ = q + h v̂,   r⁺ = 2 v̂ - r

balances energy as the linear rule does, as f̂ of an elastic law has f̂·(q⁺ - q) = ΔΦ + heat. Loads turn with the body in
the middle of the step; B has the columns of forces z that are found. A law that is exact in one linear system is told
where the step is expected: one iteration of Newton's method from v̂ of the step before, under the forces that were found
then, with a tangent that may be older. Of other laws Newton's method finds v̂; what touches and what holds strokes is
found in every iteration. A step that it does not solve is cut into parts.
"""

import math
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import compiled
from fenics_rom.errors import StepError
from fenics_rom.mechanics.contact import ContactSolution, ObstacleMotion
from fenics_rom.mechanics.energy_ledger import EnergyLedger
from fenics_rom.mechanics.points_operator import operator_of
from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.steppers.acts.shape_loads import ShapeLoads
from fenics_rom.runtime.steppers.adjoint import NONE
from fenics_rom.runtime.steppers.body_parts import BodyParts
from fenics_rom.runtime.steppers.convergence import FAST_CONTRACTION, MAX_ITERATIONS, MAX_PARTS, is_solved
from fenics_rom.runtime.steppers.definite import is_definite
from fenics_rom.runtime.steppers.deformation_maps import Expected
from fenics_rom.runtime.steppers.elastic.carried_strains import StrainsCarried
from fenics_rom.runtime.steppers.elastic.law import ElasticLaw
from fenics_rom.runtime.steppers.held_adjoint import Part
from fenics_rom.runtime.steppers.held_loops import HeldByLoops
from fenics_rom.runtime.steppers.held_solution import Solution, Start, Touched
from fenics_rom.runtime.steppers.kernel import StepWork, symmetric

if TYPE_CHECKING:
    from fenics_rom.runtime.steppers.acts.found_forces import FoundInStep
    from fenics_rom.runtime.steppers.contact_interface import ContactInterface
    from fenics_rom.runtime.steppers.residual_motion import ResidualMotion

LARGE = 1e15  # J, N² or Pa²: up to there a step of strains of second degree is far from overflow


class HeldBody(HeldByLoops):
    """Of all contact modes, which share a basis.

    Args:
        rom: the reduced models.
        contact: the contact mode to begin in.
        ledger, interface, residual: as in BookedKernel.
        parts: what the body is made of.
    """

    _slope: Array | None = None  # of f̂, that steps are found with now
    _is_small: bool = False  # whether the state is known to be such that no number of a step can overflow

    def __init__(
        self,
        rom: Rom,
        contact: str,
        ledger: EnergyLedger | None,
        interface: "ContactInterface | None",
        residual: "ResidualMotion | None",
        parts: BodyParts,
    ):
        assert rom.deformation is not None
        super().__init__(rom.contact_models[contact], ledger, interface, residual, parts)
        self._rom, self._body, self._has_loops = rom, rom.deformation, compiled()
        self._actuators = None if self._found is None else self._found.actuators
        self._unit = np.eye(self._model.order)
        self._is_polynomial = (
            isinstance(self.elastic, StrainsCarried) and self.elastic.points is None and self._found is None
        )
        self._names = {id(model): name for name, model in rom.contact_models.items()}
        self.notes = self._notes_of_parts
        if self.elastic is not None and not self.elastic.is_exact:
            self.notes["cut"] = 0.0  # how many steps were
        self.enter(self._model)

    def enter(self, model: ContactModel) -> None:
        """Makes another contact mode active: the basis is the same, the inputs are others."""
        self.flush()
        self._model, self.loads = model, ShapeLoads(self._rom, model, self._found)
        assert self._extent is not None
        self._extent.enter(self._names[id(model)], model.inputs.shape[1])
        self._compiled = self._compiled_step()

    @property
    def energy(self) -> float:
        """Stored, J."""
        return self._with_carried_energy(self._twice_within() / 2)

    @property
    def messages(self) -> tuple[str, ...]:
        """As in Kernel."""
        cut = self.notes.get("cut")
        if not cut:
            return super().messages
        said = f"{cut:.0f} steps were cut into parts, as Newton's iteration did not solve the whole"
        return *super().messages, said

    def resume(self, auxiliary: Array) -> None:
        """As in Kernel."""
        super().resume(auxiliary)
        self._slope, self.tangent, self._is_small = None, NONE, False  # so that what follows depends on nothing before

    def set_time_step(self, h: float) -> None:
        """As in Kernel."""
        super().set_time_step(h)
        if self.elastic is not None:
            self.elastic.set_time_step(h)
        self._inert = 2 / h * self._unit
        self._slope, self.tangent, self._is_small = None, NONE, False
        self._compiled = self._compiled_step()

    def reset_buffer(self) -> None:
        """As in Kernel: forgets tangents, and what was found of the next step."""
        self._slope, self.tangent = None, NONE
        if self._compiled is not None:
            self._compiled.forget()
        super().reset_buffer()

    def step(self, u: Array, obstacles: ObstacleMotion | None = None) -> float:
        """As in Kernel; a StepError also where Newton's method finds no step, however small its parts."""
        self._tangent_before = self.tangent
        if self._compiled is not None and self._compiled.is_alone:
            twice = self._step_alone(u)
            if twice is not None:
                return twice
        law = self.elastic
        assert law is not None
        if self._compiled is not None and not self._compiled.is_alone:
            taken = self._compiled.take(u, self._beginning(obstacles))
            if taken is not None:
                return self._end_compiled(u, law, *taken)
            if not law.is_exact:  # a slope that is kept would make bits depend on who took the step before
                law.reset_buffer()
        try:
            if self._is_small and obstacles is None and u.dot(u) < LARGE:  # looking after overflow costs 5 µs
                return self._end(u, law, self._at_once(u, None))
            with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # the caller looks at what comes out
                return self._end(u, law, (self._at_once if law.is_exact else self._in_few_parts)(u, obstacles))
        except np.linalg.LinAlgError:
            return math.nan

    def _end(self, u: Array, law: ElasticLaw, solution: Solution) -> float:
        """Takes the step under u; twice the stored energy, J."""
        self._take_over(u, law, solution)
        energy = self.energy
        self._is_small = self._is_polynomial and energy < LARGE
        return 2 * energy

    def _take_over(self, u: Array, law: ElasticLaw, solution: Solution) -> None:
        """Takes the step under u."""
        extent = self._extent
        assert extent is not None
        self._leave(solution.work)
        self._e[:], self._r[:] = solution.e, solution.r
        self.contact, self.reactions, self.taken = solution.contact, solution.reactions, solution.taken
        if len(self.taken) > 1:
            self.notes["cut"] += 1
        if not law.went_as_expected:
            self.tangent = NONE
        law.note(self.notes)
        acting = u if self._found is None else self.loads.with_found(u, self.reactions)
        extent.look(self.notes, acting, self._e * self._inverse_ω, self.contact, self.h)

    def _at_once(self, u: Array, obstacles: ObstacleMotion | None) -> Solution:
        """A step by a law that is exact once it knows where the step is expected."""
        h, q, r, found = self.h, self._coordinates().copy(), self._r, None
        if self._found is not None:
            found = self._found.begin(u, q, r, h)
            u = found.inputs
        law, middle, force, v = self._begun(u, q)
        if found is None and self._interface is None:
            e = (q + h * v) * self._ω
            work = StepWork(h * float(force.dot(v)), law.close(v, e * self._inverse_ω), ())
            return Solution(e, v + v - r, None, self.reactions, work, ())
        self._answer_by(partial(np.linalg.solve, self._matrix))
        touched = self._touch(found, v, middle, Start(q, r, h, obstacles, self.reactions))
        return self._ended(law, q, v, force, touched)

    def _begun(self, u: Array, q: Array) -> tuple[StrainsCarried, Array, Array, Array]:
        """The law, where the middle is expected, forces and v̂ (m,) of a step from q (m,) without what touches."""
        law, momentum, dead = self.elastic, 2 / self.h * self._r, self.loads.dead.dot(u)
        assert isinstance(law, StrainsCarried)
        law.open(q, self._r)
        middle = q + self.h / 2 * self._expected(law, dead, u, q, momentum)
        force = self.loads.with_followers(dead, u, middle)
        self._matrix = self._inert + law.matrix
        return law, middle, force, np.linalg.solve(self._matrix, momentum - law.pull + force)

    def _ended(self, law: ElasticLaw, q: Array, v: Array, force: Array, touched: Touched) -> Solution:
        """Where a step from q leads under forces by what touches, where v̂ without these was v; all (m,)."""
        if touched.pushed is not None:
            v = v + self._solve(touched.pushed)
        e, _, work = self._taken(law, q, self.h, v, force, touched)
        return Solution(e, v + v - self._r, touched.contact, touched.reactions, work, ())

    @property
    def answers_linearly(self) -> bool:  # type: ignore[override]
        """As in Kernel."""
        return self._found is None and self._interface is not None and isinstance(self.elastic, StrainsCarried)

    def open(self, u: Array) -> Array:
        """As in Kernel."""
        self._tangent_before, q = self.tangent, self._coordinates().copy()
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # as in a step
            law, _, force, v = self._begun(u, q)
            self._answer_by(partial(np.linalg.solve, self._matrix))
        self._opened = u, law, q, v, force
        free: Array = v.dot(self._Sᵀ).reshape(-1, 3)
        return free if self.residual is None else free + self.residual.points[2]

    def answer(self, some: Array) -> Array:
        """As in Kernel."""
        return operator_of(self._delassus, some)

    def close(self, contact: ContactSolution | None) -> float:
        """As in Kernel."""
        u, law, q, v, force = self._opened
        pushed = None if contact is None else self._pushed(contact)
        return self._end(u, law, self._ended(law, q, v, force, Touched(contact, self.reactions, None, None, pushed)))

    def _taken(
        self, law: ElasticLaw, q: Array, h: float, v: Array, force: Array, touched: Touched
    ) -> tuple[Array, Array, StepWork]:
        """Takes a step of h s, or a part of one, from q (m,): e, and q as the next one will have it, and its work.

        By v̂ (m,), under a force of inputs (m,).
        """
        contact, _, held, rubbed, _ = touched
        force = force if held is None else force + held
        e = (q + h * v) * self._ω
        after = e * self._inverse_ω
        heat = law.close(v, after) - (0.0 if rubbed is None else h * float(rubbed.dot(v)))
        residual, of_residual = self._step_residual(contact)
        contacts = self._contacts(v, contact, h, residual)
        return e, after, StepWork(h * float(force.dot(v)), heat + of_residual, contacts)

    def _in_few_parts(self, u: Array, obstacles: ObstacleMotion | None) -> Solution:
        """A step by Newton's method in as few parts as can be solved.

        Raises:
            StepError: as in `step`; the residual part and the law are where they were.
        """
        parts, carried = 1, [part for part in (self.residual, self.elastic) if part is not None]
        while True:
            try:
                with ExitStack() as taken_back:
                    for part in carried:
                        taken_back.enter_context(part.in_parts(parts))
                    return self._in_parts(u, obstacles, parts)
            except StepError:  # where the iteration led, no forces of strokes or contact may be found, either
                if parts == MAX_PARTS:
                    raise
            parts *= 2

    def _in_parts(self, u: Array, obstacles: ObstacleMotion | None, parts: int) -> Solution:
        """A step in so many parts."""
        law, h, e, q, r = self.elastic, self.h / parts, self._e, self._coordinates().copy(), self._r.copy()
        assert law is not None
        strokes = None if self._found is None else self._found.strokes(q)
        start, taken, works = Start(q, r, h, obstacles, self.reactions), list[Part](), list[StepWork]()
        for part in range(parts):
            goal = u if parts == 1 else self._towards(u, strokes, (part + 1) / parts)
            if obstacles is not None and parts > 1:
                start = start._replace(obstacles=obstacles.part(part / parts, 1 / parts, self.h))
            v, force, touched = self._iterated(law, goal, start)
            maps = None if self.residual is None else self.residual.maps
            e, q, work = self._taken(law, start.q, h, v, force, touched)
            branches = None if self.branches is None else self.branches.adjoint()
            taken.append(Part(h, start.q, start.r, v, touched.reactions, self._contact_step, maps, branches))
            works.append(work)
            start = start._replace(q=q, r=v + v - start.r, reactions=touched.reactions)
        work = StepWork(
            sum(work.supplied for work in works),
            sum(work.dissipated for work in works),
            sum((work.contacts for work in works), ()),
        )
        return Solution(e, start.r, touched.contact, touched.reactions, work, tuple(taken))

    def _towards(self, u: Array, strokes: Array | None, share: float) -> Array:
        """An input (p,) with strokes that have gone a share of the way from where they were (n,)."""
        if strokes is None or self._actuators is None:
            return u
        towards, columns = u.copy(), self._actuators.columns
        towards[columns] = self._actuators.towards(u[columns], strokes, None, share)
        return towards

    def _iterated(self, law: ElasticLaw, u: Array, start: Start) -> tuple[Array, Array, Touched]:
        """v̂ (m,) of a step under u (p,) by Newton's method, the force of inputs (m,) and what was found in it.

        Raises:
            StepError: it does not converge, or no forces were found on the way.
        """
        (q, r, h, _, reactions), found, before, is_fresh = start, None, math.inf, False
        law.open(q, r)
        v = law.velocity
        if self._found is not None:
            found = self._found.begin(u, q, r, h)
            u = found.inputs
        for _ in range(MAX_ITERATIONS):
            middle = q + h / 2 * v
            force, resisting = self.loads.force(u, middle), law.pull + law.matrix.dot(v)
            lack = 2 / h * (v - r) + resisting - force
            scale = max(np.abs(part).max() for part in (2 / h * r, 2 / h * v, resisting, force))
            if not math.isfinite(scale):
                break
            if law.matrix is not self._slope:
                self._take_slope(law, h, self.loads.slope(u, reactions, middle))
                is_fresh = True
            touched = self._touch(found, v - self._solve(lack), middle, start._replace(reactions=reactions))
            reactions = touched.reactions
            if touched.pushed is not None:
                lack -= touched.pushed
            error = np.abs(lack).max()
            if is_solved(error, before, scale, np.max(law.round_off)):
                return v, force, touched
            is_slow = error > FAST_CONTRACTION * before and not is_fresh
            if is_slow:
                law.renew(v)
                self._take_slope(law, h, self.loads.slope(u, reactions, middle))
            is_fresh, before = is_slow, error
            v = v - self._solve(lack)
            law.at(v)
        raise StepError(
            f"input {u.tolist()}: Newton's iteration does not converge, even in {MAX_PARTS} parts of a step of "
            f"{self.h:g} s; lower dt or the load"
        )

    def _take_slope(self, law: ElasticLaw, h: float, of_loads: Array) -> None:
        """Has the slope of what is out of balance from now on, of the loads (m, m), too, unless that is indefinite.

        It is symmetric where forces are found by operators that have to be: else they were not those of their motion.
        """
        self._slope, matrix = law.matrix, 2 / h * self._unit + law.matrix
        followed = symmetric(matrix - h / 2 * of_loads)
        if not is_definite(followed):
            followed, of_loads = symmetric(matrix), 0 * of_loads
        if self._interface is not None or (self._found is not None and len(self.reactions) > 1):
            inverse = symmetric(np.linalg.inv(followed))
        else:
            inverse = np.linalg.inv(matrix - h / 2 * of_loads)
        self._answer_by(inverse.dot)

    def _answer_by(self, solve: Callable[[Array], Array]) -> None:
        """Velocities follow forces (m,) or columns so from now on, those of contact points, too."""
        self._solve = solve
        if self._interface is not None:
            self._delassus = self._operator_by(solve(self._Sᵀ))

    def _touch(self, found: "FoundInStep | None", free: Array, middle: Array, start: Start) -> Touched:
        """What touches and what is found, where v̂ without them is `free` and the middle of the step is there, (m,)."""
        q, r, h, obstacles, reactions = start
        if found is None or self._found is None:
            contact = self._solve_contact(q, r, free, h, obstacles)
            return Touched(contact, reactions, None, None, None if contact is None else self._pushed(contact))
        columns, angles = self._found.columns(middle), self._found.angles(middle)
        motion = found.targets, q, r, free, h, obstacles
        spread = self._solve(columns)
        z, contact = self._solve_actuators(found.inputs, columns, spread, *motion, angles=angles, before=reactions)
        held, rubbed = found.actuators.parts(columns, z)
        pushed = held + rubbed if contact is None else held + rubbed + self._pushed(contact)
        return Touched(contact, z, held, rubbed, pushed)

    def _expected(self, law: StrainsCarried, dead: Array, u: Array, q: Array, momentum: Array) -> Array:
        """v̂ of this step, from that of the step before by one iteration of Newton's, with a tangent that may be older.

        Any strain rates balance energy, but where stresses make a motion stiff, those that are not of this step would
        let it grow. `dead` are forces of u whose direction stays, `momentum` is 2/h r, (m,) each.
        """
        v, h = law.velocity, self.h
        middle = q + h / 2 * v
        residual = law.ahead + 2 / h * v - momentum - self.loads.with_followers(dead, u, middle)
        is_new = not len(self.tangent)
        if is_new:
            self.tangent = symmetric(np.linalg.inv(self._inert + law.matrix))
        if self._found is not None:
            residual -= self._found.columns(middle).dot(self.reactions)
        if self.contact is not None:
            residual -= self._pushed(self.contact)
        whole = v - self.tangent.dot(residual)
        law.expect(whole)
        of_contact, of_T = self.contact is not None, (self.tangent, is_new)
        self._expectation = Expected(v, self.reactions, of_contact, middle, residual, *of_T, whole, law.expected)
        return law.expected
