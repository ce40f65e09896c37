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
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError
from fenics_rom.mechanics.contact import ContactSolution, ObstacleMotion
from fenics_rom.mechanics.energy_ledger import EnergyLedger
from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.steppers.acts.shape_loads import ShapeLoads
from fenics_rom.runtime.steppers.adjoint import NONE
from fenics_rom.runtime.steppers.body_parts import BodyParts
from fenics_rom.runtime.steppers.definite import is_definite
from fenics_rom.runtime.steppers.deformation_maps import Expected
from fenics_rom.runtime.steppers.elastic.carried_strains import StrainsCarried
from fenics_rom.runtime.steppers.elastic.law import ElasticLaw
from fenics_rom.runtime.steppers.held_adjoint import HeldAdjoint, Part
from fenics_rom.runtime.steppers.kernel import ContactWorks, StepWork, symmetric

if TYPE_CHECKING:
    from fenics_rom.runtime.steppers.acts.found_forces import FoundInStep
    from fenics_rom.runtime.steppers.contact_interface import ContactInterface
    from fenics_rom.runtime.steppers.residual_motion import ResidualMotion

CONVERGENCE_TOLERANCE = 1e-12  # of the largest force in a step
STAGNATION_TOLERANCE = 1e-8  # of it: from here on round-off may be what is left
MAX_ITERATIONS = 30
MAX_PARTS = 64  # that a step which Newton's iteration does not solve is cut into
FAST_CONTRACTION = 0.1  # up to which the tangent of an earlier iteration will do


class Solved(NamedTuple):
    """Where a step, or a part of one, goes to, and what was found in it."""

    v: Array  # v̂ (m,)
    supplied: Array  # forces of inputs and strokes (m,)
    rubbed: Array  # those at guides
    contact: ContactSolution | None
    reactions: Array  # (n,)


class Solution(NamedTuple):
    """Where a step leads to, and what it came of."""

    e: Array  # (m,)
    r: Array
    contact: ContactSolution | None
    reactions: Array
    work: StepWork
    taken: tuple[Part, ...]


class HeldBody(HeldAdjoint):
    """Of all contact modes, which share a basis.

    Args:
        rom: the reduced models.
        contact: the contact mode to begin in.
        ledger, interface, residual: as in BookedKernel.
        parts: what the body is made of.
    """

    _slope: Array | None = None  # of f̂, that steps are found with now

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
        self._rom, self._body = rom, rom.deformation
        self._actuators = None if self._found is None else self._found.actuators
        self._unit, self._nothing = np.eye(self._model.order), np.zeros(self._model.order)
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
        self._slope = None  # so that what follows does not depend on what was before

    def set_time_step(self, h: float) -> None:
        """As in Kernel."""
        super().set_time_step(h)
        if self.elastic is not None:
            self.elastic.set_time_step(h)
        self._slope, self.tangent = None, NONE

    def reset_buffer(self) -> None:
        """As in Kernel: forgets tangents, and what was found of the next step."""
        self._slope, self.tangent = None, NONE
        super().reset_buffer()

    def step(self, u: Array, obstacles: ObstacleMotion | None = None) -> float:
        """As in Kernel; a StepError also where Newton's method finds no step, however small its parts."""
        assert self.elastic is not None
        try:
            with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # the caller looks at what comes out
                if self.elastic.is_exact:
                    return self._end(u, self._in_parts(u, obstacles, 1), False)
                return self._end(u, *self._in_few_parts(u, obstacles))
        except np.linalg.LinAlgError:
            return math.nan

    def _end(self, u: Array, solution: "Solution", is_cut: bool) -> float:
        """Takes the step under u; twice the stored energy, J."""
        elastic, extent = self.elastic, self._extent
        assert elastic is not None
        assert extent is not None
        self._leave(solution.work)
        self._e[:], self._r[:] = solution.e, solution.r
        self.contact, self.reactions, self.taken = solution.contact, solution.reactions, solution.taken
        if not elastic.went_as_expected:
            self.tangent = NONE
        if is_cut:
            self.notes["cut"] += 1
        elastic.note(self.notes)
        extent.look(
            self.notes, self.loads.with_found(u, self.reactions), self._e * self._inverse_ω, None, self.contact, self.h
        )
        return 2 * self.energy

    def _in_few_parts(self, u: Array, obstacles: ObstacleMotion | None) -> "tuple[Solution, bool]":
        """A step in as few parts as can be solved, and whether it is cut.

        Raises:
            StepError: as in `step`; the residual part and the law are where they were.
        """
        parts, carried = 1, [part for part in (self.residual, self.elastic) if part is not None]
        while True:
            try:
                with ExitStack() as taken_back:
                    for part in carried:
                        taken_back.enter_context(part.in_parts(parts))
                    return self._in_parts(u, obstacles, parts), parts > 1
            except StepError:  # where the iteration led, no forces of strokes or contact may be found, either
                if parts == MAX_PARTS:
                    raise
            parts *= 2

    def _in_parts(self, u: Array, obstacles: ObstacleMotion | None, parts: int) -> "Solution":
        """A step in so many parts."""
        law, h, q, e, r = self.elastic, self.h / parts, self._coordinates().copy(), self._e, self._r.copy()
        assert law is not None
        strokes = None if self._found is None else self._found.strokes(q)
        supplied, dissipated, reactions, taken = 0.0, 0.0, self.reactions, list[Part]()
        contact: ContactSolution | None = None
        contacts: ContactWorks = ()
        for part in range(parts):
            goal, motion = u, obstacles
            if parts > 1:
                goal = self._towards(u, strokes, (part + 1) / parts)
                motion = None if obstacles is None else obstacles.part(part / parts, 1 / parts, self.h)
            v, force, rubbed, contact, reactions = self._solved(goal, q, r, h, motion, reactions)
            maps = None if self.residual is None else self.residual.maps
            taken.append(Part(h, q, r, v, reactions, self._contact_step, maps))
            e = (q + h * v) * self._ω
            q, r = e * self._inverse_ω, v + v - r  # q as the next step, or one from a saved state, will have it
            residual, of_residual = self._step_residual(contact)
            dissipated += law.close(v, q) - h * float(rubbed.dot(v)) + of_residual
            supplied += h * float(force.dot(v))
            contacts += self._contacts(v, contact, h, residual)
        return Solution(e, r, contact, reactions, StepWork(supplied, dissipated, contacts), tuple(taken))

    def _towards(self, u: Array, strokes: Array | None, share: float) -> Array:
        """An input (p,) with strokes that have gone a share of the way from where they were (n,)."""
        if strokes is None or self._actuators is None:
            return u
        towards, columns = u.copy(), self._actuators.columns
        towards[columns] = strokes + share * (u[columns] - strokes)
        return towards

    def _solved(
        self, u: Array, q: Array, r: Array, h: float, obstacles: ObstacleMotion | None, reactions: Array
    ) -> Solved:
        """A step of h s from q and r (m,) under u (p,); the search for forces begins with those before (n,)."""
        law, found, before, is_fresh, motion = self.elastic, None, math.inf, False, (q, r, h, obstacles)
        assert law is not None
        law.open(q, r)
        if self._found is not None:
            found = self._found.begin(u, q, r, h)
            u = found.inputs
        v = self._expected(law, u, q, r) if isinstance(law, StrainsCarried) else law.velocity
        for _ in range(MAX_ITERATIONS):
            middle = q + h / 2 * v
            force, resisting = self.loads.force(u, middle), law.pull + law.matrix.dot(v)
            lack = 2 / h * (v - r) + resisting - force
            if law.matrix is not self._slope:
                self._take_slope(law, h, u, middle, reactions)
                is_fresh = True
            if not law.is_exact:
                scale = max(np.abs(part).max() for part in (2 / h * r, 2 / h * v, resisting, force))
                if not math.isfinite(scale):
                    break
            after = v - self._solve(lack)
            contact, reactions, held, rubbed = self._touch(found, after, middle, motion, reactions)
            pushed = held + rubbed if contact is None else held + rubbed + self._pushed(contact)
            if contact is not None or found is not None:
                lack, after = lack - pushed, after + self._solve(pushed)
            if law.is_exact:
                return Solved(after, force + held, rubbed, contact, reactions)
            error = np.abs(lack).max()
            if is_solved(error, before, scale):
                return Solved(v, force + held, rubbed, contact, reactions)
            if error > FAST_CONTRACTION * before and not is_fresh:
                law.renew(v)
                self._take_slope(law, h, u, middle, reactions)
                after, is_fresh = v - self._solve(lack), True
            else:
                is_fresh = False
            v, before = after, error
            law.at(v)
        raise StepError(
            f"input {u.tolist()}: Newton's iteration does not converge, even in {MAX_PARTS} parts of a step of "
            f"{self.h:g} s; lower dt or the load"
        )

    def _take_slope(self, law: ElasticLaw, h: float, u: Array, middle: Array, reactions: Array) -> None:
        """Has the slope of what is out of balance from now on; of loads that follow, too, where steps iterate."""
        self._slope, matrix = law.matrix, 2 / h * self._unit + law.matrix
        if law.is_exact:
            self._solve: Callable[[Array], Array] = partial(np.linalg.solve, matrix)
        else:
            followed = matrix - h / 2 * self.loads.slope(u, reactions, middle)
            matrix = followed if is_definite((followed + followed.T) / 2) else matrix
            self._solve = np.linalg.inv(matrix).dot
        self._matrix = matrix
        if self._interface is not None:
            self._delassus = self._with_residual(symmetric(self._Sᵀ.T @ self._solve(self._Sᵀ)))

    def _touch(
        self,
        found: "FoundInStep | None",
        free: Array,
        middle: Array,
        motion: "tuple[Array, Array, float, ObstacleMotion | None]",
        reactions: Array,
    ) -> "tuple[ContactSolution | None, Array, Array, Array]":
        """Contact, reactions (n,), and forces of strokes and at guides (m,), where v̂ without them is `free` (m,).

        Args:
            found: what is to be found.
            free, middle: v̂, and q in the middle of the step, (m,).
            motion: q, r, the step in s, and how obstacles move.
            reactions: with which the search begins (n,).
        """
        q, r, h, obstacles = motion
        if found is None or self._found is None:
            return self._solve_contact(q, r, free, h, obstacles), reactions, self._nothing, self._nothing
        columns, angles = self._found.columns(middle), self._found.angles(middle)
        z, contact = self._solve_actuators(
            found.inputs,
            columns,
            self._solve(columns),
            found.targets,
            *(q, r, free, h, obstacles),
            angles=angles,
            before=reactions,
        )
        return contact, z, *found.actuators.parts(columns, z)

    def _expected(self, law: StrainsCarried, u: Array, q: Array, r: Array) -> Array:
        """v̂ of this step, from that of the step before by one iteration of Newton's, with a tangent that may be older.

        Any strain rates balance energy, but where stresses make a motion stiff, those that are not of this step would
        let it grow.
        """
        v, h = law.velocity, self.h
        middle = q + h / 2 * v
        residual = law.ahead + 2 / h * (v - r) - self.loads.force(u, middle)
        is_new = not len(self.tangent)
        if is_new:
            inverse = np.linalg.inv(2 / h * self._unit + law.matrix)
            self.tangent = symmetric(inverse)
        if self._found is not None:
            residual -= self._found.columns(middle).dot(self.reactions)
        if self.contact is not None:
            residual -= self._pushed(self.contact)
        whole = v - self.tangent.dot(residual)
        law.expect(whole)
        self._expectation = Expected(v, self.reactions, middle, residual, self.tangent, is_new, whole, law.expected)
        return law.expected


def is_solved(error: float, before: float, scale: float) -> bool:
    """Whether forces out of balance, here and an iteration before, are nothing or round-off beside the largest one."""
    return error <= CONVERGENCE_TOLERANCE * scale or (error <= STAGNATION_TOLERANCE * scale and error > before / 2)
