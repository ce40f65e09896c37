"""Large deformation by one linear system a step.

The step carries strains ε as unknowns of their own, ε⁺ = ε + h A v̂, with ½ ε:C₀ε stored (C₀ of small strains), and
what a material stores besides as ½ s², s⁺ = s + h bᵀv̂ (a scalar auxiliary variable: Shen, Xu & Yang, 2018). That is
quadratic, so that the balance is exact at any step. As E sees no rotation, what is left for s is of third order in the
strain. ε drifts from E(q) by what the step is wrong. It is taken back as far as the energy for that was dissipated
before, and what remains is the mismatch that a run reports.
"""

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.actuator_forces import ActuatorForces
from fenics_rom.mechanics.contact import ObstacleMotion
from fenics_rom.mechanics.energy_ledger import EnergyLedger
from fenics_rom.rom.carried_strains import MonomialsAround, MonomialShape, PointsAround, PointShape, carried_strains
from fenics_rom.rom.deformation import ReducedDeformation
from fenics_rom.rom.material_points import MaterialPoints
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.steppers.adjoint import NONE, StateAdjoint, contact_adjoint
from fenics_rom.runtime.steppers.deformation_maps import Carried, Expected, LinearlyImplicitMaps, Taken, s_of
from fenics_rom.runtime.steppers.finite_strain import FiniteStrainKernel, definite_inverse
from fenics_rom.runtime.steppers.kernel import StepWork, symmetric

if TYPE_CHECKING:
    from fenics_rom.mechanics.viscoelasticity import MaxwellBranches
    from fenics_rom.runtime.steppers.contact_interface import ContactInterface
    from fenics_rom.runtime.steppers.linearly_implicit_adjoint import LinearlyImplicitAdjoint
    from fenics_rom.runtime.steppers.residual_motion import ResidualMotion

NONE_HELD = np.empty(0, dtype=int)
TANGENT_RENEWAL = 0.05  # of v̂, by which a step may differ from what was expected before the tangent is made anew
STEEPEST_FREQUENCY = 10.0  # times that of the stiffest mode
MISMATCH_LIMIT = 0.03  # of the largest strain, in the energy norm
LARGE = 1e15  # J, N² or Pa²: up to there a step of strains of second degree is far from overflow


class Ahead(NamedTuple):
    """The shape that a step leads to, and the middle of the next one, if v̂ stays."""

    q: Array  # (m,)
    shape: MonomialShape | PointShape
    left: float  # energy of the shape that is not ½ E:C₀E, J
    middle: Array  # (m,)
    around: MonomialsAround | PointsAround  # the middle
    force: Array  # there, of what is strained and damped, but for what of branches is there before the step (m,)


class LinearlyImplicit(FiniteStrainKernel):
    """One linear system a step. Arguments and attributes as in FiniteStrainKernel."""

    NOTES = ("distance", "strained", "mismatch")  # strained: energy of the strains at most, J
    _next: Ahead | None = None  # None: not known
    _next_before: Ahead | None = None
    _is_small: bool = False  # whether the state is known to be such that no number of a step can overflow

    @staticmethod
    def strain_count(body: ReducedDeformation) -> int:
        """As in FiniteStrainKernel, of the strains that are carried along."""
        return carried_strains(body).size

    def __init__(
        self,
        rom: Rom,
        ledger: EnergyLedger | None,
        interface: "ContactInterface | None",
        actuators: ActuatorForces | None = None,
        residual: "ResidualMotion | None" = None,
        branches: "MaxwellBranches | None" = None,
    ):
        super().__init__(rom, ledger, interface, actuators, residual, branches)
        body = self._body
        self._springs = body.springs if body.springs.any() else None
        self._points = None if body.law == "st_venant_kirchhoff" else MaterialPoints(body)
        self._strains = carried_strains(body)
        self._is_polynomial = self._points is None and actuators is None
        self.resume(np.empty(0))
        self._carried_before = self._carried

    @property
    def auxiliary(self) -> Array:
        """As in Kernel."""
        return np.concatenate([self._carried.in_one(self._strains.size), super().auxiliary])

    def resume(self, auxiliary: Array) -> None:
        """As in Kernel."""
        own = 2 * self._strains.size + self._body.order + 4
        super().resume(auxiliary[own:])
        self._next, self._is_small = None, False
        if len(auxiliary):
            self._carried = Carried.of(auxiliary[:own], self._strains.size)
            return
        q, left, c = self._coordinates(), 0.0, 0.0
        energy = self._strains.around(q).elastic[0]
        if self._points is not None:
            left = float(self._points.energies_and_forces(q)[0][0]) - energy
            c = min(1e-4 * self._points.most + 4 * abs(left), self._points.most)
        self._carried = Carried(self._r.copy(), None, left, c, 0.0, energy)

    @property
    def energy(self) -> float:
        """Stored, J."""
        return self._energy(self._coordinates())

    @property
    def messages(self) -> tuple[str, ...]:
        """As in Kernel."""
        mismatch = self.notes["mismatch"]
        if mismatch <= MISMATCH_LIMIT:
            return super().messages
        return (
            *super().messages,
            f"the linearly implicit stepper's strains went {100 * mismatch:.2g} % off those of the shape (limit "
            f"{100 * MISMATCH_LIMIT:g} %): its steps are too long for this motion; take a smaller dt or "
            'stepper = "newton"',
        )

    def rollback(self) -> None:
        """As in Kernel."""
        super().rollback()
        self._carried, self._next = self._carried_before, self._next_before

    def set_time_step(self, h: float) -> None:
        """As in Kernel."""
        super().set_time_step(h)
        self._fixed = 2 / h * np.eye(self._model.order) + self._body.external_damping + h / 2 * self._body.springs
        self.tangent, self._next, self._is_small = NONE, None, False

    def reset_buffer(self) -> None:
        """As in Kernel: forgets the tangent, and what was found of the next step."""
        self.tangent, self._next = NONE, None
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
        h, body, was = self.h, self._body, self._carried
        now = self._next or self._looked_ahead(self._e * self._inverse_ω, was.velocity)
        u, given = (u, None) if self._actuators is None else self._actuators.split(u)
        q, r, dead = now.q, self._r, self._dead_loads.dot(u)
        start = 2 / h * r if self._springs is None else 2 / h * r - self._springs.dot(q)
        expected = self._expected(dead, u, now, start)
        middle = q + h / 2 * expected.value
        pushed = self._loads_with(dead, u, middle)
        around, pulled = now.shape.around(middle)
        matrix = around.stiffness(h / 2 + self._stiffening_time)
        matrix += self._fixed
        if was.strained is not None:
            pulled = around.pulled(was.strained[1])
        if self.branches is not None:
            pulled += around.pulled(self.branches.pull[1])
        right = start + pushed - pulled
        left, c, s, b = was.left, was.c, 0.0, None
        if self._points is not None:
            b, c = self._slope(self._points, around, middle, c)
            s = s_of(left + c)
            matrix += np.multiply.outer(h / 2 * b, b)
            right -= s * b
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
        missed = v - expected.value
        if missed.dot(missed) > TANGENT_RENEWAL**2 * v.dot(v):
            self.tangent = NONE

        held = NONE_HELD if self._actuators is None else self._actuators.held(reactions)
        self._taken = Taken(expected, matrix, reactions, held)

        square, viscous = around.squares(v)
        heat = h * (float(v.dot(body.external_damping.dot(v))) + viscous)
        if self.branches is not None:
            heat += self.branches.step(self._with_stress(around.rates(v)))
        if b is not None:
            grown = h * float(b.dot(v))
            left += grown * (s + grown / 2)
        e = (q + h * v) * self._ω
        after = e * self._inverse_ω  # as the next step, or one that goes on from a saved state, will have it
        strained_more = h * (float(v.dot(pulled)) + h / 2 * square)
        self._next_before, self._next = self._next, self._looked_ahead(after, v)
        taken_back, gap = self._taken_back(self._next, left, c, strained_more, heat, (q, after, around, v))
        dissipated = heat - taken_back - (0.0 if given is None else h * float(rubbed.dot(v)))
        residual, heat_of_residual = self._step_residual(contact)
        contacts = self._contacts(v, contact, h, residual)
        self._leave(StepWork(h * float(pushed.dot(v)), dissipated + heat_of_residual, contacts))
        self._e[:] = e
        np.subtract(v + v, r, r)
        self.contact, self.reactions = contact, reactions
        self._note(after, None, self._acting(u))
        self._note_mismatch(2 * self._next.shape.energy, gap)
        energy = self._energy(after)
        self._is_small = self._is_polynomial and energy < LARGE
        return 2 * energy

    def adjoint(self, u: Array) -> "LinearlyImplicitAdjoint":
        """As in Kernel."""
        from fenics_rom.runtime.steppers.linearly_implicit_adjoint import LinearlyImplicitAdjoint

        contact, is_kink = contact_adjoint(self._interface)
        residual = None if self.residual is None else self.residual.state.reshape(4, -1).copy()
        before, after = (self._state_before, self._carried_before), (self.state, self._carried)
        states = [part for each in (before, after) for part in (each[0].copy(), self._with_strains(*each))]
        u = u if self._actuators is None else self._actuators.split(u)[0]
        return LinearlyImplicitAdjoint(self._maps, u, self._taken, states, residual, contact, is_kink)

    def start_pulled_back(self, q: Array, r: Array, after: StateAdjoint) -> tuple[Array, Array]:
        """As in Kernel."""
        from fenics_rom.runtime.steppers.linearly_implicit_adjoint import start_pulled_back

        return start_pulled_back(self._maps, q, after)

    def _with_strains(self, state: Array, carried: Carried) -> Array:
        """What is carried beside a state, with ε and C₀ε wherever ε is E(q)."""
        if carried.strained is None:
            ε = self._strains.at(state[: self._model.order] * self._inverse_ω)
            carried = carried._replace(strained=self._with_stress(ε))
        return carried.in_one(self._strains.size)

    @property
    def _maps(self) -> LinearlyImplicitMaps:
        return LinearlyImplicitMaps(
            self._body,
            self._strains,
            self.h,
            self._fixed,
            self._Sᵀ,
            self._ω,
            self._dead_loads,
            self._active_followers,
            self._found,
            self._stroke_places,
            None if self.residual is None else self.residual.maps,
            self._points is None,
            0.0 if self._points is None else self._points.most,
            STEEPEST_FREQUENCY * float(self._ω[-1]),
        )

    def _expected(self, dead: Array, u: Array, now: Ahead, start: Array) -> Expected:
        """v̂ of this step, from that of the step before by one iteration of Newton's, with a tangent that may be older.

        Any A balances energy, but where stresses make a motion stiff, one that is not of this step would let it grow.
        `start` is 2/h r less the springs' pull at q.
        """
        h, body, v = self.h, self._body, self._carried.velocity
        middle, around = now.middle, now.around
        residual = self._fixed.dot(v) - start + now.force
        if self.branches is not None:
            residual += around.pulled(self.branches.pull[1])
        is_new = not len(self.tangent)
        if is_new:
            matrix = self._fixed + around.stiffness(h / 2 + self._stiffening_time)
            σ = self._strains.stressed(around.damped(v, self._stiffening_time, self._points is None))
            geometric = self._strains.geometric(σ if self.branches is None else σ + self.branches.pull[1])
            if self._points is not None:
                geometric = body.geometric(self._points.stress(self._points.strains(middle)[1])) + geometric
            self.tangent = definite_inverse(matrix + h / 2 * geometric, matrix)
        residual -= self._loads_with(dead, u, middle)
        if self._actuators is not None:
            residual -= self._stroke_columns(middle).dot(self.reactions)
        if self.contact is not None:
            residual -= self._pushed(self.contact)
        whole = v - self.tangent.dot(residual)
        far = h / 2 * math.sqrt(whole.dot(whole))
        if not math.isfinite(far):
            value = np.zeros_like(v)
        else:  # it can hardly go further than it was trained
            value = whole if far <= body.training_radius else whole * (body.training_radius / far)
        return Expected(v, self.reactions, middle, residual, self.tangent, is_new, whole, value)

    def _looked_ahead(self, q: Array, v: Array) -> Ahead:
        """From q, to which a step with v̂ led: what both need is found together."""
        points, middle = self._points, q + self.h / 2 * v
        shape, around, force = self._strains.with_next(q, middle, v, self._stiffening_time, points is None)
        if points is None:
            return Ahead(q, shape, 0.0, middle, around, force)
        stored, forces = points.energies_and_forces(np.array([q, middle]).T)
        return Ahead(q, shape, float(stored[0]) - shape.energy, middle, around, force + forces[:, 1])

    def _energy(self, q: Array) -> float:
        twice = 2 * self._carried.energy + float(self._r.dot(self._r))
        if self._springs is not None:
            twice += float(q.dot(self._springs.dot(q)))
        return self._with_carried_energy(twice / 2 + self._carried.left)

    @property
    def _stiffening_time(self) -> float:
        """Of branches, s."""
        return 0.0 if self.branches is None else self.branches.stiffening_time

    def _with_stress(self, strains: Array) -> Array:
        """(2, size): some strains, and C₀ times them."""
        return np.stack([strains, self._strains.stressed(strains)])

    def _slope(
        self, points: MaterialPoints, around: MonomialsAround | PointsAround, q: Array, c: float
    ) -> tuple[Array, float]:
        """b = ∂√(2 (Ψ + c))/∂q (m,) of the energy Ψ that is left at q, and c, which grows where Ψ comes near -c.

        Up to a bound, as what is in s and what is in ε must not grow against each other. Any b balances energy; one
        much steeper than the stiffest mode, as where a point is all but flat, would drown it in round-off.
        """
        (stored,), forces = points.energies_and_forces(q)
        of_strains, force = around.elastic
        left, steepest = float(stored) - of_strains, STEEPEST_FREQUENCY * float(self._ω[-1])
        if left + c < c / 2:
            c = min(c + 4 * abs(left), points.most)  # ½ s² - c stays what it was
        b: Array = (forces[:, 0] - force) / math.sqrt(2 * max(left + c, c / 4))
        steep = math.sqrt(b.dot(b))
        return b if steep <= steepest else b * (steepest / steep), c

    def _taken_back(
        self,
        there: Ahead,
        left: float,
        c: float,
        strained_more: float,
        dissipated: float,
        moved: tuple[Array, Array, MonomialsAround | PointsAround, Array],
    ) -> tuple[float, float]:
        """Moves strains, also of branches, and s to those of the shape there; by A v̂ they `went`, and stored more.

        Energies, J: added (< 0: taken), of the gap. `left` and c are what v̂ has made of them.

        At most what is in the tank, which holds what was dissipated in this and the steps before, up to what strains
        store (as in teleoperation: Franken et al., 2011): a step may give back, and the run never more than it got.
        """
        was, (q, after, around, v) = self._carried, moved
        s, gap_s, share, gap_square, budget = 0.0, 0.0, 1.0, 0.0, was.tank + dissipated
        if self._points is not None:
            s = s_of(left + c)
            gap_s = s_of(there.left + c) - s
        energy, strained = there.shape.energy, None
        added = energy - was.energy - strained_more + gap_s * (s + gap_s / 2)
        if self.branches is not None or added > budget:
            aimed = self._strains.at(after)
            went = (self._strains.at(q) if was.strained is None else was.strained[0]) + self.h * around.rates(v)
            went, gap = self._with_stress(went), self._with_stress(aimed - went)
            square = gap_square = float(gap[1].dot(gap[0])) + gap_s * gap_s
            slope = float(gap[1].dot(went[0])) + gap_s * s
            if self.branches is not None:
                of_branches = self.branches.growth(gap)
                slope, square = slope + of_branches[0], square + of_branches[1]
            if slope + square / 2 > budget and square > 0:
                root = math.sqrt(max(slope * slope + 2 * square * budget, 0.0))
                share = min(2 * budget / (slope + root) if slope > 0 else (root - slope) / square, 1.0)
            added = share * slope + share**2 * square / 2
            if share < 1:
                strained = went + share * gap
                energy = float(strained[1].dot(strained[0])) / 2
            if self.branches is not None:
                self.branches.move(share * gap)
        left += share * gap_s * (s + share * gap_s / 2)
        tank = min(max(budget - added, 0.0), 2 * there.shape.energy)
        self._carried_before, self._carried = was, Carried(v, strained, left, c, tank, energy)
        return added, (1 - share) ** 2 * gap_square

    def _note_mismatch(self, strained: float, gap: float) -> None:
        """Notes the energies of strains, and of what those that are carried along lack of them, J."""
        self.notes["strained"] = most = max(self.notes["strained"], strained)
        if gap and most > 0:
            self.notes["mismatch"] = max(self.notes["mismatch"], math.sqrt(gap / most))
