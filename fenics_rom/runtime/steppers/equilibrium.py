"""Steps without inertia: each leads to the next equilibrium

    Φ'(q⁺) = G u + B z + Sᵀ f,

with the columns B of forces z of actuators that are found, of strokes that are given and of guides that rub, and
contact forces f. Of small strains that is one linear system; else Newton's method finds q⁺ from the equilibrium before,
under a load that grows in as many parts as it takes.

For contact it is a step of passive midpoint integration with A = h Φ'', from q with v̂ = (q⁺ - q)/h. On the way there
all forces change linearly: the loads supply ½ (F + F⁺)·(q⁺ - q), with F = Φ'(q) - Sᵀ f that held the body before, f of
the step before. A body of small strains stores that, but for what rubs; by how much another one stores less is
numerical, of second order in the step.
"""

import math
from collections.abc import Callable
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
from fenics_rom.runtime.steppers.adjoint import contact_adjoint
from fenics_rom.runtime.steppers.body_parts import BodyParts
from fenics_rom.runtime.steppers.convergence import MAX_ITERATIONS, MAX_PARTS, is_solved
from fenics_rom.runtime.steppers.definite import is_definite
from fenics_rom.runtime.steppers.elastic.at_rest import Potential, SmallStrains
from fenics_rom.runtime.steppers.kernel import ContactWorks, StepWork
from fenics_rom.runtime.steppers.parted_kernel import PartedKernel
from fenics_rom.runtime.steppers.taken_step import residual_taken

if TYPE_CHECKING:
    from fenics_rom.runtime.steppers.contact_interface import ContactInterface
    from fenics_rom.runtime.steppers.held_part import HeldPart
    from fenics_rom.runtime.steppers.parted_adjoint import PartedAdjoint, StepPart
    from fenics_rom.runtime.steppers.residual_motion import ResidualMotion


class Sought(NamedTuple):
    """What an equilibrium is sought under."""

    u: Array  # (p,) without what is found
    strokes: Array  # that are given, and of guides nothing (n,)
    obstacles: ObstacleMotion | None
    start: Array  # q of the equilibrium before (m,)


class Found(NamedTuple):
    """An equilibrium, and what was found in it."""

    q: Array
    contact: ContactSolution | None
    reactions: Array  # (n,)


class Equilibrium(PartedKernel):
    """A step to the next equilibrium; the velocity stays zero.

    Args:
        rom: the reduced models.
        model: of the contact mode; bodies that deform largely may `enter` others, which share its basis.
        ledger, interface, residual, parts: as in PartedKernel, with no elastic law.

    Attributes:
        loads: what acts on the shape.
        potential: what resists it.
    """

    potential: Potential

    def __init__(
        self,
        rom: Rom,
        model: ContactModel,
        ledger: EnergyLedger | None,
        interface: "ContactInterface | None",
        residual: "ResidualMotion | None",
        parts: BodyParts,
    ):
        super().__init__(model, ledger, interface, residual, parts)
        self._rom, self.notes = rom, self._notes_of_parts
        self._actuators = None if self._found is None else self._found.actuators
        self._is_linear, self.loads = rom.deformation is None, ShapeLoads(rom, model, self._found)
        self.potential = SmallStrains(model.eigenvalues) if rom.deformation is None else rom.deformation

    def enter(self, model: ContactModel) -> None:
        """Makes another contact mode active: the basis is the same, the inputs are others."""
        self.flush()
        self._model, self.loads = model, ShapeLoads(self._rom, model, self._found)
        assert self._extent is not None
        names = {id(each): name for name, each in self._rom.contact_models.items()}
        self._extent.enter(names[id(model)], model.inputs.shape[1])

    @property
    def energy(self) -> float:
        """Stored, J."""
        return self._with_carried_energy(self.potential.energy(self._coordinates()))

    def set_time_step(self, h: float) -> None:
        """As in Kernel."""
        super().set_time_step(h)
        if isinstance(self.potential, SmallStrains):
            self._answer_by(self._r, self.potential.solve)
        elif self._is_linear:
            self._answer_by(self._r, np.linalg.inv(self.potential.tangent(self._r)).dot)

    def _answer_by(self, q: Array, solve: Callable[[Array], Array]) -> None:
        """Displacements follow forces (m,) or columns so from now on, near q (m,); those of contact points, too."""
        self._solve = solve
        if self._interface is not None:
            self._delassus = self._operator_by(solve(self._Sᵀ), self.h)
        if self._found is not None:
            self._columns = self._found.columns(q)
            self._spread = solve(self._columns) / self.h

    def step(self, u: Array, obstacles: ObstacleMotion | None = None) -> float:
        """As in Kernel; a StepError also where a load can grow no further."""
        if self._is_linear:
            return self._step(u, obstacles)
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # the caller looks at what comes out
            return self._step(u, obstacles)

    def _step(self, u: Array, obstacles: ObstacleMotion | None) -> float:
        Φ, found, start, strokes = self.potential, self._found, self._coordinates().copy(), self.reactions
        if found is not None:
            u, strokes = found.actuators.split(u)
            strokes_before, rubbed_before = found.actuators.parts(found.columns(start), self.reactions)
        elastic, pushed = Φ.force(start), self.loads.force(u, start)
        lack, held = elastic - pushed, elastic if found is None else elastic - rubbed_before
        if self.contact is not None and self._interface is not None:
            held = held - self._pushed(self.contact)
        sought = Sought(u, strokes, obstacles, start)
        if self._is_linear:
            q, contact, reactions = self._linear(sought, lack)
        else:
            unbalanced = elastic - self.loads.force(0 * u, start)
            if found is not None:
                unbalanced = unbalanced - strokes_before - rubbed_before
            q, contact, reactions = self._followed(sought, unbalanced)
            pushed = self.loads.force(u, q)
        moved, of_friction, numerical, stored = q - start, 0.0, 0.0, Φ.energy(q)
        if found is not None:
            by_strokes, rubbed = found.actuators.parts(found.columns(q), reactions)
            pushed = pushed + by_strokes
            of_friction, numerical = float(rubbed.dot(moved)), float((rubbed - rubbed_before).dot(moved)) / 2
        supplied = float((held + pushed).dot(moved)) / 2
        if not self._is_linear:
            balanced = pushed if found is None else pushed + rubbed
            if contact is not None:
                balanced = balanced + self._pushed(contact)
            numerical += float((elastic + balanced).dot(moved)) / 2 - (stored - Φ.energy(start))
        residual, of_residual = self._step_residual_at_rest(contact)
        contacts = self._contacts_at_rest(moved, contact, obstacles, residual)
        self._leave(StepWork(supplied + of_residual, -of_friction, contacts, numerical))
        np.multiply(q, self._ω, self._e)
        self.contact, self.reactions = contact, reactions
        if self._extent is not None:
            self._extent.look(self.notes, self.loads.with_found(u, reactions), q, contact, self.h)
        return 2 * self._with_carried_energy(stored)

    def _linear(self, sought: Sought, lack: Array) -> Found:
        """The equilibrium of small strains, by forces (m,) that the start lacks but for contact and what is found."""
        q = sought.start - self._solve(lack)
        if self._found is None and (self._interface is None or sought.obstacles is None):
            return Found(q, None, self.reactions)
        pushed, contact, reactions = self._touch(sought, sought.start, q, self.reactions)
        return Found(q + self._solve(pushed), contact, reactions)

    def _touch(
        self, sought: Sought, q: Array, away: Array, reactions: Array
    ) -> tuple[Array, ContactSolution | None, Array]:
        """What contact and what is found push with (m,), near q (m,), from where the body would be without it, (m,)."""
        start, h, found = sought.start, self.h, self._found
        motion = start, self._r, (away - start) / h, h, sought.obstacles, True
        if found is None:
            contact, pushed = self._solve_contact(*motion), 0 * q
        else:
            columns, angles = self._columns, found.angles(q)
            gone = found.strokes(q) - (q - start).dot(columns)
            targets = found.actuators.resting_targets(sought.strokes, gone, h)
            reactions, contact = self._solve_actuators(
                sought.u, columns, self._spread, targets, *motion, angles=angles, before=reactions
            )
            pushed = columns.dot(reactions)
        return pushed if contact is None else pushed + self._pushed(contact), contact, reactions

    def _followed(self, sought: Sought, unbalanced: Array) -> Found:
        """The equilibrium that a load which grows from nothing leads to, as forces (m,) that hold the start give way.

        Raises:
            StepError: there is none beyond some share of the load.
        """
        share, growth, found = 0.0, 1.0, Found(sought.start, None, self.reactions)
        strokes = np.empty(0) if self._found is None else self._found.strokes(sought.start)
        while share < 1:
            part = min(share + growth, 1.0)
            given = sought.strokes
            if self._found is not None:
                given = self._found.actuators.towards(given, strokes, self.reactions, part)
            towards = sought._replace(u=part * sought.u, strokes=given)
            balance = self._balanced(towards, found.q, (1 - part) * unbalanced)
            if balance is None:
                growth /= 2
                if growth < 1 / MAX_PARTS:
                    raise StepError(
                        f"input {sought.u.tolist()}: no equilibrium was found beyond {100 * share:.0f} % of the change "
                        "of the load in this step; take shorter steps or lower the load"
                    )
            else:
                found, share = balance, part
        return found

    def _balanced(self, sought: Sought, q: Array, unbalanced: Array) -> Found | None:
        """The equilibrium near q (m,), of forces but for a part (m,); None if there is none."""
        Φ, before, reactions, deformation = self.potential, math.inf, self.reactions, self._rom.deformation
        found = self._found
        whole_steps = self._interface is None and (found is None or not found.actuators.pulls.any())
        assert deformation is not None
        round_off = deformation.round_off.max()
        for _ in range(MAX_ITERATIONS):
            elastic, force, tangent = Φ.force(q), self.loads.force(sought.u, q), Φ.tangent(q)
            if whole_steps:  # near a largest pressure loads that follow decide what is stable
                tangent = tangent - self.loads.slope(sought.u, reactions, q)
            elif not is_definite(tangent):
                return None
            scale = max(np.abs(part).max() for part in (elastic, force, unbalanced))
            if not math.isfinite(scale):
                return None
            try:
                self._answer_by(q, np.linalg.inv(tangent).dot)
            except np.linalg.LinAlgError:
                return None
            lack = elastic - force - unbalanced
            try:
                pushed, contact, reactions = self._touch(sought, q, q - self._solve(lack), reactions)
            except StepError:  # of a shape that whole steps of Newton's method went astray to
                if whole_steps:
                    return None
                raise
            lack = lack - pushed
            error = np.abs(lack).max()
            if is_solved(error, before, scale, round_off):
                return Found(q, contact, reactions) if self._is_stable(sought, tangent, reactions) else None
            if error > 10 * before and not whole_steps:
                return None
            before = error
            q = q - self._solve(lack)
        return None

    def _is_stable(self, sought: Sought, tangent: Array, reactions: Array) -> bool:
        """Whether an equilibrium that was found is stable, with what its strokes hold (Haynsworth, 1968)."""
        found = self._found
        if found is None or self._interface is not None or found.actuators.pulls.any():
            return is_definite((tangent + tangent.T) / 2)
        assert self._stroke_operators is not None
        W, gas = self._stroke_operators[1], found.actuators.resting_targets(sought.strokes, sought.strokes, self.h).gas
        gives = np.zeros(len(reactions)) if gas is None else gas.compliances(reactions)
        held = int((np.linalg.eigvalsh(W + np.diag(gives)) < 0).sum())
        return int((np.linalg.eigvalsh((tangent + tangent.T) / 2) < 0).sum()) == held

    def _step_residual_at_rest(self, contact: ContactSolution | None) -> tuple[Array | None, float]:
        """Takes the residual part's step; the points' velocity (P, 3), and what held it at the start supplies, J."""
        velocity, _ = self._step_residual(contact)
        if velocity is None or self.residual is None:
            return None, 0.0
        return velocity, self.residual.work_of_start(self.contact, velocity)

    def _contacts_at_rest(
        self,
        moved: Array,
        contact: ContactSolution | None,
        obstacles: ObstacleMotion | None,
        residual: Array | None = None,
    ) -> ContactWorks:
        """What StepWork holds of contact where the body moved by (m,), points beyond the basis at velocities (P, 3)."""
        if self._interface is None or obstacles is None or (contact is None and self.contact is None):
            return ()
        self._at_touch = moved / self.h, residual
        velocities = self._at_points(moved / self.h, residual)
        return (partial(self._interface.work_at_rest, self.contact, contact, velocities, self.h, obstacles),)

    @property
    def passed_rate(self) -> Array:
        """As in PartedKernel."""
        rate: Array = (self._e - self._state_before[: len(self._e)]) * self._inverse_ω / self.h
        return rate

    def adjoint(self, u: Array) -> "PartedAdjoint":
        """As in Kernel."""
        from fenics_rom.runtime.steppers.acts.found_slopes import FoundIn
        from fenics_rom.runtime.steppers.elastic.at_rest import RestingAdjoint
        from fenics_rom.runtime.steppers.held_part import HeldPart
        from fenics_rom.runtime.steppers.parted_adjoint import Ends, PartedAdjoint

        h, z, q, after = (
            self.h,
            self.reactions,
            self._state_before[: len(self._e)] * self._inverse_ω,
            self._coordinates(),
        )
        at_rest, after, found, given = 0 * q, after.copy(), None, None
        if self._found is not None:
            of_input = self._found.actuators.split(u)
            found = FoundIn(self._found, *of_input, z, h, q, at_rest, (after - q) / h, after).resting_slopes()
            given = self._found.stroke_slopes(q).T
        u = self.loads.without_found(u)
        (residual, rows), (contact, is_kink) = residual_taken(self.residual), contact_adjoint(self._interface)
        Φ = self.potential
        law = RestingAdjoint(Φ.tangent(after), h, Φ.force(after), after, self._model if self._is_linear else None)
        columns, turned = self.loads.all_columns(after), self.loads.slope(u, z, after)
        acting = columns, turned, h, found, self._Sᵀ, contact, residual
        part = self._part_of(HeldPart(h, 0.0, law, *acting, at_rest), u, q, after)
        return PartedAdjoint((part,), Ends(self._model.safe_frequencies, q, after, rows), is_kink, given)

    def _part_of(self, held: "HeldPart", u: Array, q: Array, after: Array) -> "StepPart":
        """The last step between two q (m,), under u (p,) without what was found, of one in the axes of the shape."""
        return held
