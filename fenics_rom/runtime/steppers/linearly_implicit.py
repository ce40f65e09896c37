"""Large deformation of a held body by one linear system a step, with strains that are carried along.

What resists is `elastic/carried_strains.py`. Here are inertia, loads, strokes and contact:

    matrix v̂ = 2/h r - pull + G u + B z + Sᵀ f,    2/h of the inertia in the matrix

where the middle of the step is expected by one iteration of Newton's method from v̂ of the step before, under the forces
that were found then, with a tangent that may be older.
"""

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.actuator_forces import ActuatorForces
from fenics_rom.mechanics.contact import ObstacleMotion
from fenics_rom.mechanics.energy_ledger import EnergyLedger
from fenics_rom.rom.deformation import ReducedDeformation
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.steppers.adjoint import NONE, StateAdjoint, check_is_differentiated, contact_adjoint
from fenics_rom.runtime.steppers.deformation_maps import Expected, LinearlyImplicitMaps, Taken
from fenics_rom.runtime.steppers.elastic.carried_strains import StrainsCarried
from fenics_rom.runtime.steppers.finite_strain import FiniteStrainKernel
from fenics_rom.runtime.steppers.kernel import StepWork, symmetric

if TYPE_CHECKING:
    from fenics_rom.mechanics.viscoelasticity import MaxwellBranches
    from fenics_rom.runtime.steppers.contact_interface import ContactInterface
    from fenics_rom.runtime.steppers.linearly_implicit_adjoint import LinearlyImplicitAdjoint
    from fenics_rom.runtime.steppers.residual_motion import ResidualMotion

NONE_HELD = np.empty(0, dtype=int)
LARGE = 1e15  # J, N² or Pa²: up to there a step of strains of second degree is far from overflow


class LinearlyImplicit(FiniteStrainKernel):
    """One linear system a step. Arguments and attributes as in FiniteStrainKernel."""

    NOTES = StrainsCarried.NOTES
    _taken: Taken
    _is_small: bool = False  # whether the state is known to be such that no number of a step can overflow

    @staticmethod
    def strain_count(body: ReducedDeformation) -> int:
        """As in FiniteStrainKernel, of the strains that are carried along."""
        return StrainsCarried.strain_count(body)

    def __init__(
        self,
        rom: Rom,
        ledger: EnergyLedger | None,
        interface: "ContactInterface | None",
        actuators: ActuatorForces | None = None,
        residual: "ResidualMotion | None" = None,
        branches: "MaxwellBranches | None" = None,
    ):
        super().__init__(rom, ledger, interface, actuators, residual)
        self._law = StrainsCarried(self._body, float(self._ω[-1]), branches, has_inertia=True)
        self.branches = branches
        self._is_polynomial = self._body.law == "st_venant_kirchhoff" and actuators is None
        self.resume(np.empty(0))

    @property
    def auxiliary(self) -> Array:
        """As in Kernel."""
        return np.concatenate([self._law.auxiliary, super().auxiliary])

    def resume(self, auxiliary: Array) -> None:
        """As in Kernel."""
        own = len(self._law.auxiliary)
        super().resume(auxiliary[own:])
        self._is_small = False
        self._law.resume(self._coordinates(), self._r, auxiliary[:own])

    @property
    def energy(self) -> float:
        """Stored, J."""
        return self._energy()

    @property
    def messages(self) -> tuple[str, ...]:
        """As in Kernel."""
        return *super().messages, *self._law.messages(self.notes)

    def rollback(self) -> None:
        """As in Kernel."""
        super().rollback()
        self._law.rollback()

    def set_time_step(self, h: float) -> None:
        """As in Kernel."""
        super().set_time_step(h)
        self._law.set_time_step(h)
        self.tangent, self._is_small = NONE, False

    def reset_buffer(self) -> None:
        """As in Kernel: forgets the tangent, and what was found of the next step."""
        self.tangent = NONE
        self._law.reset_buffer()
        super().reset_buffer()

    def step(self, u: Array, obstacles: ObstacleMotion | None = None) -> float:
        """As in Kernel."""
        try:
            if self._is_small and obstacles is None and u.dot(u) < LARGE:  # looking after overflow costs 5 µs
                return self._stepped(u, None)
            with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # the caller looks at what comes out
                return self._stepped(u, obstacles)
        except np.linalg.LinAlgError:
            return math.nan

    def _stepped(self, u: Array, obstacles: ObstacleMotion | None) -> float:
        h, law, r, q = self.h, self._law, self._r, self._e * self._inverse_ω
        law.open(q, r)
        u, given = (u, None) if self._actuators is None else self._actuators.split(u)
        dead, start = self._dead_loads.dot(u), 2 / h * r
        expected = self._expected(dead, u, q, start)
        middle = q + h / 2 * expected.value
        pushed = self._loads_with(dead, u, middle)
        matrix, right = law.matrix, start - law.pull + pushed
        contact, reactions, v = None, self.reactions, np.linalg.solve(matrix, right)
        if self._interface is not None:
            spread = np.linalg.solve(matrix, self._Sᵀ)
            self._delassus = self._with_residual(symmetric(self._Sᵀ.T @ spread))
            if given is None:
                contact = self._solve_contact(q, r, v, h, obstacles)
        if given is not None and self._actuators is not None:
            columns = self._stroke_columns(middle)
            by_strokes = np.linalg.solve(matrix, columns)
            targets = self._actuators.rates(given, self._strokes_at(q), r.dot(self._stroke_columns(q)), h)
            motion, angles = (q, r, v, h, obstacles), self._angles(middle)
            reactions, contact = self._solve_actuators(u, columns, by_strokes, targets, *motion, angles=angles)
            of_strokes, rubbed = self._actuators.parts(columns, reactions)
            pushed = pushed + of_strokes
            v += by_strokes.dot(reactions)
        if contact is not None:
            v += spread.dot(contact.forces.ravel())

        held = NONE_HELD if self._actuators is None else self._actuators.held(reactions)
        self._taken = Taken(expected, matrix, reactions, held)
        e = (q + h * v) * self._ω
        after = e * self._inverse_ω  # as the next step, or one that goes on from a saved state, will have it
        heat = law.close(v, after) - (0.0 if given is None else h * float(rubbed.dot(v)))
        if not law.went_as_expected:
            self.tangent = NONE
        residual, heat_of_residual = self._step_residual(contact)
        contacts = self._contacts(v, contact, h, residual)
        self._leave(StepWork(h * float(pushed.dot(v)), heat + heat_of_residual, contacts))
        self._e[:] = e
        np.subtract(v + v, r, r)
        self.contact, self.reactions = contact, reactions
        self._note(after, None, self._acting(u))
        law.note(self.notes)
        energy = self._energy()
        self._is_small = self._is_polynomial and energy < LARGE
        return 2 * energy

    def _expected(self, dead: Array, u: Array, q: Array, start: Array) -> Expected:
        """v̂ of this step, from that of the step before by one iteration of Newton's, with a tangent that may be older.

        Any A balances energy, but where stresses make a motion stiff, one that is not of this step would let it grow.
        `start` is 2/h r.
        """
        law, v = self._law, self._law.velocity
        middle = q + self.h / 2 * v
        residual = law.ahead - start - self._loads_with(dead, u, middle)
        is_new = not len(self.tangent)
        if is_new:
            inverse = np.linalg.inv(law.matrix)
            self.tangent = (inverse + inverse.T) / 2
        if self._actuators is not None:
            residual -= self._stroke_columns(middle).dot(self.reactions)
        if self.contact is not None:
            residual -= self._pushed(self.contact)
        whole = v - self.tangent.dot(residual)
        law.expect(whole)
        return Expected(v, self.reactions, middle, residual, self.tangent, is_new, whole, law.expected)

    def check_differentiable(self) -> None:
        """As in Kernel."""
        check_is_differentiated(self._actuators, self.branches)

    def adjoint(self, u: Array) -> "LinearlyImplicitAdjoint":
        """As in Kernel."""
        from fenics_rom.runtime.steppers.linearly_implicit_adjoint import LinearlyImplicitAdjoint

        contact, is_kink = contact_adjoint(self._interface)
        residual = None if self.residual is None else self.residual.state.reshape(4, -1).copy()
        before, after = self._state_before.copy(), self.state.copy()
        shapes = (state[: self._model.order] * self._inverse_ω for state in (before, after))
        carried_before, carried_after = self._law.carried_with_strains(*shapes)
        states = [before, carried_before, after, carried_after]
        u = u if self._actuators is None else self._actuators.split(u)[0]
        return LinearlyImplicitAdjoint(self._maps, u, self._taken, states, residual, contact, is_kink)

    def start_pulled_back(self, q: Array, r: Array, after: StateAdjoint) -> tuple[Array, Array]:
        """As in Kernel."""
        from fenics_rom.runtime.steppers.linearly_implicit_adjoint import start_pulled_back

        return start_pulled_back(self._maps, q, after)

    @property
    def _maps(self) -> LinearlyImplicitMaps:
        law, body = self._law, self._body
        return LinearlyImplicitMaps(
            body,
            law.strains,
            self.h,
            law.steady,
            self._Sᵀ,
            self._ω,
            self._dead_loads,
            self._active_followers,
            self._found,
            self._stroke_places,
            None if self.residual is None else self.residual.maps,
            law.points is None,
            0.0 if law.points is None else law.points.most,
            law.steepest,
        )

    def _energy(self) -> float:
        return self._with_carried_energy(float(self._r.dot(self._r)) / 2 + self._law.stored)
