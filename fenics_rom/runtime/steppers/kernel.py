"""What kernels have in common. A kernel is the arithmetic of a step; a stepper has one, or one of each contact mode."""

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.energy_ledger import EnergyLedger
from fenics_rom.mechanics.points_operator import Operator, delassus_of
from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.runtime.steppers.adjoint import NONE, StateAdjoint

if TYPE_CHECKING:
    from fenics_rom.mechanics.actuator_forces import ActuatorForces
    from fenics_rom.mechanics.contact import ContactSolution, ContactWork, ObstacleMotion
    from fenics_rom.mechanics.gas import Targets
    from fenics_rom.mechanics.points_held_back import PointsHeldBack
    from fenics_rom.mechanics.viscoelasticity import MaxwellBranches
    from fenics_rom.runtime.steppers.contact_interface import ContactInterface
    from fenics_rom.runtime.steppers.parted_adjoint import PartedAdjoint
    from fenics_rom.runtime.steppers.residual_motion import ResidualMotion

ContactWorks = tuple[Callable[[], "ContactWork"], ...]  # of each part of a step

BOOKED_TOGETHER = 64  # steps


class Kernel:
    """What every kernel has; for most of them the answers here are right.

    Attributes:
        h: time step, s; 0 before the first `set_time_step`.
        state: [e, r] (2m,), e = √γ q; ½|state|² is the stored energy of a linear model.
        contact: in the last step; None where nothing touched.
        reactions: (n,) forces that were found in the last step, of strokes that are given, then at guides, N or Pa.
        residual: how the contact points yield beyond the basis; None where that is not known.
        branches: how the material relaxes, of strains in energy coordinates √γ w; None where it is elastic.
        notes: of the run so far, to tell the user: numbers that a run begins at 0. A kernel writes those of its own.
        tangent: a matrix that steps carry along, made in an earlier one; empty where there is none.
        rows_first: whether `auxiliary` has what contact points yield before what the material carries, or after.
    """

    h: float = 0.0
    state: Any
    contact: "ContactSolution | None" = None
    reactions: Array = np.empty(0)
    notes: dict[str, float]
    residual: "ResidualMotion | None" = None
    branches: "MaxwellBranches | None" = None
    tangent: Array = NONE
    rows_first: bool = True
    _model: ContactModel
    holds_steps: bool = False  # since the buffer was reset: what `passed` tells
    answers_linearly: bool = False  # contact points within a step to forces: then it has `open`, `answer` and `close`

    @property
    def energy(self) -> float:
        """Stored, J."""
        return float(self.state.dot(self.state)) / 2

    @property
    def auxiliary(self) -> Array:
        """What a step carries along besides."""
        return np.empty(0)

    @property
    def messages(self) -> tuple[str, ...]:
        """What the user should know of the run so far."""
        return ()

    @property
    def beyond_training(self) -> bool:
        """Whether the body went further than its model was trained to follow."""
        return False

    def step(self, u: Array, obstacles: "ObstacleMotion | None" = None) -> float:
        """Takes a step under u (p,), N, and returns twice the stored energy, J, which need not be finite.

        Raises:
            ValueError: u has another shape; no step was taken.
            StepError: there are no contact forces, or no state; no step was taken.
        """
        raise NotImplementedError

    def open(self, u: Array) -> Array:
        """Begins a step under u (p,): mid-step velocities (P, 3) of the contact points without contact, m/s."""
        raise NotImplementedError

    def answer(self, some: Array) -> Array:
        """Velocities of some contact points (s,) per force on them in the step that is open, (3 s, 3 s), m/s/N.

        As long as that is the same it is the same array.
        """
        raise NotImplementedError

    def close(self, contact: "ContactSolution | None") -> float:
        """Takes the step that is open under contact forces, as `step`."""
        raise NotImplementedError

    def set_time_step(self, h: float) -> None:
        """Makes the coefficients for another time step, s."""
        raise NotImplementedError

    def rollback(self) -> None:
        """Takes the last step back."""
        raise NotImplementedError

    def flush(self) -> None:
        """Books what the steps so far supplied and dissipated."""
        raise NotImplementedError

    def reset_buffer(self) -> None:
        """Books, and begins anew: what follows is then the same to the bit, whatever came before."""
        self.flush()

    def passed(self) -> tuple[Array, Array, Array, Array]:
        """Since the buffer was reset: states (n + 1, 2m), inputs (n, p), and supplied and dissipated works (n,), J."""
        raise NotImplementedError

    def point_displacement(self) -> Array:
        """Of the contact points, (P, 3), m."""
        raise NotImplementedError

    def adjoint(self, u: Array) -> "PartedAdjoint":
        """The last step, under u (p,), to go back through."""
        raise NotImplementedError

    def start_pulled_back(self, q: Array, r: Array, after: StateAdjoint) -> tuple[Array, Array]:
        """Derivatives with q and r (m,) of a state that is put in, from those with all that a step begins with."""
        by_e, by_r = after.state.reshape(2, -1)
        return np.concatenate([after.rigid, (np.sqrt(self._model.eigenvalues) * by_e)[len(after.rigid) :]]), by_r

    def resume(self, auxiliary: Array) -> None:
        """Goes on from a state that was put in, with what was saved beside it (empty: nothing was)."""


class StepWork(NamedTuple):
    """What a step is to be booked for."""

    supplied: float  # but for contact, J
    dissipated: float  # but for contact, J
    contacts: ContactWorks
    numerical: float = 0.0  # but for contact, J


class BookedKernel(Kernel):
    """What kernels share whose steps are booked one by one: the state, the one before it, and contact.

    Args:
        model: the reduced model of a contact mode.
        ledger: the account to book in, if one is kept.
        rigid_displacement: along the rigid motions (ρ,), which energy coordinates lack; steps add to it.
        interface: the contact points, if there are any.
        actuators: those whose forces are found, if there are any.
        residual, branches: how contact points yield beyond the basis, if that is known, and a material relaxes.
    """

    _at_touch: tuple[Array | None, Array | Callable[[], Array] | None]  # v̂ (m,) in the last contact, and beyond (P, 3)
    _contact: "ContactSolution | Callable[[], ContactSolution | None] | None" = None  # or how it is told, as few ask

    def __init__(
        self,
        model: ContactModel,
        ledger: EnergyLedger | None,
        rigid_displacement: Array,
        interface: "ContactInterface | None",
        actuators: "ActuatorForces | None" = None,
        residual: "ResidualMotion | None" = None,
        branches: "MaxwellBranches | None" = None,
    ):
        self._model, self._ledger, self._interface, self._actuators = model, ledger, interface, actuators
        self.reactions = self._reactions_before = np.zeros(0 if actuators is None else len(actuators.columns))
        self.residual, self.branches, self._owned = residual, branches, branches  # a law owns its branches itself
        self._rigid_displacement, self._rigid_before = rigid_displacement, rigid_displacement.copy()
        self._contact_before: ContactSolution | Callable[[], ContactSolution | None] | None = None
        self._owed = list[Any]()  # StepWork of the last steps, or what that is worked out from
        self.notes, self._notes_before = {}, dict[str, float]()
        self._ω, self._inverse_ω = np.sqrt(model.eigenvalues), 1 / model.safe_frequencies
        self.state, self._state_before = np.zeros(2 * model.order), np.zeros(2 * model.order)
        self._e, self._r = self._halves = self.state.reshape(2, -1)
        self._delassus: Operator = np.empty((0, 0))  # W (3P, 3P)
        self._stroke_operators: tuple[Array, Array, Array, PointsHeldBack] | None = None  # of the last spread
        rows = np.empty((0, len(model.coordinates))) if interface is None else interface.rows
        self._Sᵀ = self._of_points = np.ascontiguousarray((rows @ model.coordinates).T)
        if residual is not None:  # what the points do is one product with what they do in and beyond the basis
            self._of_points = np.vstack([self._Sᵀ, np.zeros((6, self._Sᵀ.shape[1]))])
            self._Sᵀ = self._of_points[: model.order]
        self._motion = np.zeros((3, len(self._of_points)))
        self._motions = self._motion[:, : model.order]  # q, r and v̂
        if residual is not None:
            residual.stand_in(self._of_points[model.order :], self._motion[:, -6:-2])

    @property
    def contact(self) -> "ContactSolution | None":
        """As in Kernel."""
        if callable(self._contact):
            self._contact = self._contact()
        return self._contact

    @contact.setter
    def contact(self, contact: "ContactSolution | Callable[[], ContactSolution | None] | None") -> None:
        self._contact = contact

    @property
    def energy(self) -> float:
        """Stored, J."""
        return self._with_carried_energy(super().energy)

    @property
    def auxiliary(self) -> Array:
        """As in Kernel."""
        of_residual = super().auxiliary if self.residual is None else self.residual.carried
        return of_residual if self._owned is None else np.concatenate([of_residual, self._owned.state.ravel()])

    def set_time_step(self, h: float) -> None:
        """As in Kernel."""
        self.flush()
        self.h = h
        if self.residual is not None:
            self.residual.set_time_step(h)
        if self._owned is not None:
            self._owned.set_time_step(h)

    def point_displacement(self) -> Array:
        """As in Kernel."""
        moved = self._coordinates().dot(self._Sᵀ).reshape(-1, 3)
        return moved if self.residual is None else moved + self.residual.displacement

    def point_places(self) -> Array:
        """Of the contact points now, (P, 3), m."""
        assert self._interface is not None
        places: Array = self._interface.points.coordinates + self.point_displacement()
        return places

    @property
    def touched(self) -> Array:
        """Mid-step velocities (P, 3) of the contact points, m/s, in the last step under contact forces."""
        v, beyond = self._at_touch
        v = (self._r + self._state_before[len(self._r) :]) / 2 if v is None else v
        return self._at_points(v, beyond() if callable(beyond) else beyond)

    def start_velocities(self) -> Array:
        """Velocities (P, 3) of the contact points, m/s."""
        velocities = self._r.dot(self._Sᵀ).reshape(-1, 3)
        return velocities if self.residual is None else velocities + self.residual.points[1]

    def resume(self, auxiliary: Array) -> None:
        """As in Kernel."""
        if self._owned is not None:
            own = self._owned.state.size
            self._owned.resume(auxiliary[len(auxiliary) - own :] if len(auxiliary) else auxiliary)
            auxiliary = auxiliary[: len(auxiliary) - own]
        if self.residual is not None:
            self.residual.resume(auxiliary)

    def rollback(self) -> None:
        """As in Kernel."""
        self.state[:] = self._state_before
        if self.residual is not None:
            self.residual.rollback()
        if self._owned is not None:
            self._owned.rollback()
        self._rigid_displacement[:] = self._rigid_before
        del self._owed[-1:]
        self.contact, self.reactions = self._contact_before, self._reactions_before
        self.notes = self._notes_before

    def flush(self) -> None:
        """As in Kernel."""
        owed, self._owed = self._owed, []
        if owed and self._ledger is not None:
            self._ledger.book_steps(owed)

    def _coordinates(self) -> Array:
        """q (m,), which a later call overwrites."""
        q = self._motions[0]
        np.multiply(self._e, self._inverse_ω, q)
        if len(self._rigid_displacement):
            q[: len(self._rigid_displacement)] = self._rigid_displacement
        return q

    def _solve_contact(
        self,
        q: Array,
        r: Array,
        free: Array,
        h: float,
        obstacles: "ObstacleMotion | None",
        quasi_static: bool = False,
        delassus: Operator | None = None,
    ) -> "ContactSolution | None":
        """Contact of a step of h s from q and r, by its mid-step velocity without it and the Delassus operator.

        `delassus` where actuators hold the points back.
        """
        if self._interface is None or obstacles is None:
            return None
        self._motions[0], self._motions[1], self._motions[2] = q, r, free
        motion = self._motion.dot(self._of_points).reshape(3, -1, 3)
        if self.residual is not None:
            self.residual.relax(motion[2])
        W = self._delassus if delassus is None else delassus
        return self._interface.solve_moved(motion, W, h, obstacles, quasi_static)

    def _solve_actuators(
        self,
        u: Array,
        columns: Array,
        spread: Array,
        targets: "Targets",
        q: Array,
        r: Array,
        free: Array,
        h: float,
        obstacles: "ObstacleMotion | None",
        quasi_static: bool = False,
        angles: Array | None = None,
        before: Array | None = None,
    ) -> "tuple[Array, ContactSolution | None]":
        """Forces (n,) of actuators that are found in a step, and contact.

        Args:
            u: the input (p,).
            columns: B (m, n) of the actuators.
            spread: A⁻¹ B (m, n).
            targets: of their strokes.
            q, r, free, h, obstacles, quasi_static: as in `_solve_contact`; `free` is without these forces, too.
            angles, before: (n,) turns at guides, rad, unless those at rest; last forces, unless of the step before.
        """
        assert self._actuators is not None
        if self._stroke_operators is None or self._stroke_operators[0] is not spread:  # of linear bodies it is the same
            W = self._actuators.compliance(columns.T.dot(spread))
            X = np.empty((0, len(W))) if self._interface is None else self._Sᵀ.T.dot(spread)
            self._stroke_operators = spread, W, X, self._actuators.holding(self._delassus, X, W)
        _, W, X, held = self._stroke_operators

        def touch(z: Array, holding: Array, *, gives: "Array | None") -> "tuple[ContactSolution | None, Array]":
            delassus = held.delassus(holding, gives)
            contact = self._solve_contact(q, r, free + spread.dot(z), h, obstacles, quasi_static, delassus)
            return contact, np.zeros(len(z)) if contact is None else X.T.dot(contact.forces.ravel())

        rates, before = columns.T.dot(free), self.reactions if before is None else before
        return self._actuators.solve(u, rates, W, targets, before, None if obstacles is None else touch, angles)

    def _with_carried_energy(self, energy: float) -> float:
        """An energy with what is stored in the residual part and in branches, too, J."""
        energy = energy if self.residual is None else energy + self.residual.stored
        return energy if self._owned is None else energy + self._owned.stored

    def _operator_by(self, spread: Array, by: float = 1.0) -> Operator:
        """The Delassus operator of the points, which yield beyond the basis, too, from A⁻¹ Sᵀ times a number."""
        return delassus_of(self._Sᵀ, spread, by, None if self.residual is None else self.residual.delassus)

    def _step_residual(self, contact: "ContactSolution | None") -> tuple[Array | None, float]:
        """Takes the residual part's step; the points' mid-step velocity (P, 3) in it, and what it dissipates, J."""
        if self.residual is None:
            return None, 0.0
        if contact is None and self.residual.is_at_rest:
            self.residual.remember()
            return None, 0.0
        return self.residual.step(contact, float(self.state.dot(self.state)) / 2)

    def _pushed(self, contact: "ContactSolution") -> Array:
        """Generalized forces of contact (m,)."""
        pushed: Array = self._Sᵀ.dot(contact.forces.ravel())
        return pushed

    def _contacts(
        self, v: Array, contact: "ContactSolution | None", h: float, residual: Array | None = None
    ) -> ContactWorks:
        """What StepWork holds of contact at v̂ (m,) of the body and velocities (P, 3) in the residual part, in h s."""
        if contact is not None:
            self._at_touch = v, residual
        return () if contact is None else (partial(contact.work, self.touched, h),)

    def _at_points(self, v: Array, residual: Array | None) -> Array:
        """Velocity of the points (P, 3), m/s, from that of the body (m,) and of the residual part (P, 3)."""
        velocity: Array = v.dot(self._Sᵀ).reshape(-1, 3)
        return velocity if residual is None else velocity + residual

    def _leave(self, work: Any) -> None:
        """Notes what is there before a step, and what is to be booked after it."""
        if len(self._owed) == BOOKED_TOGETHER:
            self.flush()
        self._remember()
        self._owed.append(work)

    def _remember(self) -> None:
        """Notes what is there before a step."""
        self._state_before[:] = self.state
        if len(self._rigid_displacement):
            self._rigid_before[:] = self._rigid_displacement
        self._contact_before, self._reactions_before, self._notes_before = self._contact, self.reactions, {**self.notes}


def symmetric(matrix: Array) -> Array:
    """(A + Aᵀ)/2."""
    return (matrix + matrix.T) / 2
