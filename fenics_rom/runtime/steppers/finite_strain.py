"""The steps of a body that deforms as far as it likes: the midpoint rule with a potential Φ(q) in place of ½ qᵀKq.

    2/h (v̂ - r) + D v̂ + f̂ = G u,   f̂ᵀ (q⁺ - q) = Φ(q⁺) - Φ(q),   q⁺ = q + h v̂,   r⁺ = 2 v̂ - r

balances energy as the linear rule does. Both ways to f̂ take the strains' rates A = ∂E/∂q in the middle of the step:

    Newton              A at (q + q⁺)/2, found by iteration; ε is E(q) and f̂ = Aᵀ ω Ŝ(E, E⁺). For large steps.
    LinearlyImplicit    A at q + h/2 v̂ as it is expected: one linear system is left. The faster one.

The second carries strains ε as unknowns of their own, ε⁺ = ε + h A v̂, with ½ ε:C₀ε stored (C₀ of small strains), and
what a material stores besides as ½ s², s⁺ = s + h bᵀv̂ (a scalar auxiliary variable: Shen, Xu & Yang, 2018). That is
quadratic, so that the balance is exact at any step. As E sees no rotation, what is left for s is of third order in the
strain. ε drifts from E(q) by what the step is wrong. It is taken back as far as the energy for that was dissipated
before, and what remains is the mismatch that a run reports.
"""

import math
import warnings
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from fenics_rom.errors import FenicsRomWarning, StepError, unknown
from fenics_rom.mechanics.contact import ContactSolution
from fenics_rom.mechanics.energy_ledger import EnergyLedger
from fenics_rom.mechanics.hyperelastic import (
    VOIGT_SHEAR,
    discrete_gradient_stress,
    energy_density,
    linear_stress,
    moduli,
    strain,
    strain_rate,
    stress,
)
from fenics_rom.rom.deformation import ReducedDeformation, monomials
from fenics_rom.rom.rom import ContactModel, Rom
from fenics_rom.runtime.steppers.contact import ContactStepper, Touch, Work
from fenics_rom.scene.scene import STEPPERS

Array = np.ndarray

_NONE = np.empty(0)
BEYOND = 1.5  # times as far as a state that the model was trained on
SURPRISE = 0.05  # of v̂, by which a step may differ from what was expected before the tangent is made anew
STEEPEST = 10.0  # times the frequency of the stiffest mode
MISMATCH = 0.03  # of the largest strain, in the energy norm
CONVERGED = 1e-12  # of the largest force in a step
STALLED = 1e-8  # of it: from here on round-off may be what is left
ITERATIONS = 30
FAST = 0.1  # contraction up to which the tangent of an earlier iteration will do
PARTS = 64  # that a step which Newton's iteration does not solve is cut into, at most
FEW = 40  # steps in a period of the slowest mode, from which on the linearly implicit step pays


def chosen(rom: Rom, dt: float, stepper: str | None, quasi_static: bool) -> tuple[str, str]:
    """The stepper that was asked for or, where none was, that suits a time step (s), and why.

    Raises:
        StepError: there is none of that name, or not without inertia.
    """
    if quasi_static:
        if stepper is not None:
            raise StepError(f"stepper = {stepper!r}: a scene without inertia has but equilibria")
        return "equilibrium", "the scene has no inertia"
    if stepper is not None:
        if stepper not in STEPPERS:
            raise StepError(unknown("stepper", stepper, list(STEPPERS)))
        return stepper, "it was asked for"
    period = 2 * math.pi / math.sqrt(next(iter(rom.contact_models.values())).eigenvalues[0])
    steps = period / dt
    if steps >= FEW:
        return "linearly-implicit", f"{steps:.0f} steps in a period of the slowest mode, from {FEW} on it pays"
    return "newton", f"{steps:.1f} steps in a period of the slowest mode, below {FEW} iteration pays"


class LargeDeformation(ContactStepper):
    """What both share: the loads that follow the body, and how far it has gone.

    Args:
        rom: the reduced model.
        ledger: the account to book in, if one is kept.
        touch: the obstacles, if there are any.

    Attributes:
        auxiliary: what is to be saved beside `state`.
        mismatch: between strains that are carried along and E(q), in the energy norm, as a share of the largest strain
            so far; None where there are none.
    """

    mismatch: float | None = None

    def __init__(self, rom: Rom, ledger: EnergyLedger | None, touch: Touch | None):
        assert rom.deformation is not None
        super().__init__(next(iter(rom.contact_models.values())), ledger, np.empty(0), touch)
        self._body: ReducedDeformation = rom.deformation
        self._shared = sum(rom.actuators.values()) + sum(rom.loads.values())
        self._followers = _followers(rom)
        self._far = BEYOND * self._body.training_radius
        self._furthest = 0.0
        self.auxiliary = np.empty(0)
        self.enter(self._mode)

    def enter(self, mode: ContactModel) -> None:
        """Makes another contact mode active: the basis is the same, the inputs are others."""
        self.flush()
        self._mode = mode
        first = mode.inputs.shape[1] - self._shared
        self._following = [(first + column, force) for column, force in self._followers]
        self._dead = mode.inputs.copy()  # of loads whose direction stays
        self._dead[:, [column for column, _ in self._following]] = 0.0

    def resume(self, auxiliary: Array = _NONE) -> None:
        """Goes on from the state that was put in, and what was saved beside it, if it was."""
        self._furthest = 0.0

    @property
    def messages(self) -> tuple[str, ...]:
        """What the user should know of the run so far."""
        return (self._too_far,) if self._furthest > self._far else ()

    @property
    def _too_far(self) -> str:
        return (
            f"the body went {self._furthest / self._body.training_radius:.2g} times as far as in any state that the "
            f"model was trained on; beyond {BEYOND:g} times it is not to be trusted: reduce with larger loads"
        )

    def _loads(self, u: Array, q: Array) -> Array:
        """Generalized forces (m,) of the inputs on the body at q."""
        force = self._dead.dot(u)
        for column, follower in self._following:
            if u[column]:
                force = force + u[column] * follower(q)
        return force

    def _look(self, q: Array) -> None:
        """Notes how far the body has gone, and warns where that is further than it was trained."""
        far = math.sqrt(q.dot(q))
        if far > self._furthest:
            before, self._furthest = self._furthest, far
            if before <= self._far < far < math.inf:
                warnings.warn(self._too_far, FenicsRomWarning, stacklevel=5)


class LinearlyImplicit(LargeDeformation):
    """One linear system a step. Arguments and attributes as in LargeDeformation."""

    mismatch: float

    def __init__(self, rom: Rom, ledger: EnergyLedger | None, touch: Touch | None):
        super().__init__(rom, ledger, touch)
        body = self._body
        self._λ, self._μ = body.weights * body.first_lame, body.weights * body.shear
        self._most = float(self._μ.sum())  # c where strains are of order 1
        self._linear = body.law == "st_venant_kirchhoff"
        points, m = len(body.weights), body.order
        self.auxiliary = np.zeros(6 * points + m + 3)
        self._auxiliary_before = self.auxiliary.copy()
        # ε; v̂ of the step before; the energy ½ s² - c, c, and the energy tank, J.
        self._ε = self.auxiliary[: 6 * points].reshape(6, points)
        self._previous_velocity, self._rest = self.auxiliary[6 * points : -3], self.auxiliary[-3:]
        self._largest, self.mismatch = 0.0, 0.0
        self._tangent_inverse: Array | None = None
        self.resume()

    def resume(self, auxiliary: Array = _NONE) -> None:
        """As in LargeDeformation."""
        super().resume()
        self._largest = self.mismatch = 0.0
        if len(auxiliary):
            self.auxiliary[:] = auxiliary
            return
        q = self._coordinates()
        self._ε[:] = self._body.strains(q)
        self._previous_velocity[:] = self._r
        self._rest[:] = 0.0
        if not self._linear:
            left = self._left(self._ε)
            self._rest[:2] = left, min(1e-4 * self._most + 4 * abs(left), self._most)

    @property
    def energy(self) -> float:
        """Stored, J."""
        return self._energy(self._coordinates())

    @property
    def messages(self) -> tuple[str, ...]:
        """As in LargeDeformation."""
        if self.mismatch <= MISMATCH:
            return super().messages
        return (
            *super().messages,
            f"strains that are carried along and those of the shape differ by {100 * self.mismatch:.2g} % (limit "
            f'{100 * MISMATCH:g} %): the steps are too long for what moves; take shorter ones or stepper = "newton"',
        )

    def rollback(self) -> None:
        """As in ContactStepper."""
        super().rollback()
        self.auxiliary[:] = self._auxiliary_before

    def set_time_step(self, h: float) -> None:
        """As in ContactStepper."""
        self.flush()
        weight = h / 2 + self._body.viscosity
        self._stiff = (2 * weight * self._μ / VOIGT_SHEAR)[:, :, None]
        self._bulk = (weight * self._λ)[:, None]
        self._fixed = 2 / h * np.eye(self._mode.order) + self._body.external_damping + h / 2 * self._body.springs
        self._tangent_inverse, self.h = None, h

    def reset_buffer(self) -> int:
        """Books, and forgets the tangent: what follows is then the same to the bit, whatever came before."""
        self._tangent_inverse = None
        return super().reset_buffer()

    def step(self, u: Array) -> float:
        """As in ContactStepper."""
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # the caller looks at what comes out
            try:
                return self._advance(u)
            except np.linalg.LinAlgError:
                return math.nan

    def _advance(self, u: Array) -> float:
        h, body = self.h, self._body
        q, r = self._coordinates().copy(), self._r
        expected = self._expected(u, q)
        middle = q + h / 2 * expected
        pushed = self._loads(u, middle)
        H = body.displacement_gradients(middle)
        matrix, A = self._strained_matrix(H)
        right = pushed + 2 / h * r - body.springs.dot(q) - linear_stress(self._ε, self._λ, self._μ).ravel().dot(A)
        b, s = None if self._linear else self._slope(strain(H), A), 0.0
        if b is not None:
            s = self._s
            matrix += np.outer(h / 2 * b, b)
            right -= s * b
        touched, v = None, np.linalg.solve(matrix, right)
        if self._touch is not None:
            spread = np.linalg.solve(matrix, self._Sᵀ)
            W = self._Sᵀ.T @ spread
            self._W = (W + W.T) / 2
            touched = self._touched(v, quasi_static=False)
            if touched is not None:
                v += spread.dot(touched.forces.ravel())
        missed = v - expected
        if missed.dot(missed) > SURPRISE**2 * v.dot(v):
            self._tangent_inverse = None

        rates = A.dot(v).reshape(6, -1)
        drawn = float(v.dot(body.external_damping.dot(v)))
        drawn += float((linear_stress(rates, body.viscosity * self._λ, body.viscosity * self._μ) * rates).sum())
        after = q + h * v
        self._auxiliary_before[:] = self.auxiliary
        self._previous_velocity[:] = v
        self._ε += h * rates
        if b is not None:
            grown = h * float(b.dot(v))
            self._rest[0] += grown * (s + grown / 2)
        taken_back = self._taken_back(after, h * drawn)
        self._keep(Work(h * float(pushed.dot(v)), h * drawn - taken_back, self._touches(v, touched, h)))
        np.multiply(after, self._ω, self._e)
        np.subtract(v + v, r, r)
        self.touched = touched
        self._look(after)
        return 2 * self._energy(after)

    def _expected(self, u: Array, q: Array) -> Array:
        """v̂ of this step, from that of the step before by one iteration of Newton's, with a tangent that may be older.

        Any A balances energy, but where stresses make a motion stiff, one that is not of this step would let it grow.
        """
        h, body, v = self.h, self._body, self._previous_velocity
        middle = q + h / 2 * v
        H = body.displacement_gradients(middle)
        rates = strain_rate(H + np.eye(3)[:, :, None], body.displacement_gradients(v))
        S = body.weights * stress(body.law, strain(H), body.first_lame, body.shear)
        S += linear_stress(rates, body.viscosity * self._λ, body.viscosity * self._μ)
        if self._tangent_inverse is None:
            matrix, _ = self._strained_matrix(H)
            self._tangent_inverse = _inverse(matrix + h / 2 * body.geometric(S), matrix)
        residual = (
            2 / h * (v - self._r) + body.external_damping.dot(v) + body.springs.dot(middle) + body.resultant(H, S)
        )
        residual -= self._loads(u, middle)
        if self.touched is not None:
            residual -= self._Sᵀ.dot(self.touched.forces.ravel())
        expected = v - self._tangent_inverse.dot(residual)
        far = h / 2 * math.sqrt(expected.dot(expected))
        if not math.isfinite(far):
            return np.zeros_like(q)
        return (
            expected if far <= body.training_radius else expected * (body.training_radius / far)
        )  # it can hardly go further

    def _strained_matrix(self, H: Array) -> tuple[Array, Array]:
        """2/h + D + h/2 K of the body deformed by H, but for its stresses, (m, m), and A (6 P, m)."""
        A = self._body.strain_rates(H)
        CA = self._stiff * A
        CA[:3] += self._bulk * A[:3].sum(axis=0)
        A = A.reshape(-1, self._mode.order)
        return self._fixed + A.T.dot(CA.reshape(A.shape)), A

    def _energy(self, q: Array) -> float:
        stored = float((linear_stress(self._ε, self._λ, self._μ) * self._ε).sum())
        kinetic, springs = float(self._r.dot(self._r)), float(q.dot(self._body.springs.dot(q)))
        return (stored + kinetic + springs) / 2 + float(self._rest[0])

    @property
    def _s(self) -> float:
        return math.sqrt(2 * max(self._rest[0] + self._rest[1], 0.0))

    def _left(self, E: Array) -> float:
        """Energy of strains E that is not ½ E:C₀E, J."""
        body = self._body
        W = energy_density(body.law, E, body.first_lame, body.shear)
        return float(body.weights.dot(W) - (linear_stress(E, self._λ, self._μ) * E).sum() / 2)

    def _slope(self, E: Array, A: Array) -> Array:
        """b = ∂√(2 (Ψ + c))/∂q (m,) of the energy Ψ that is left; c grows where Ψ comes near -c.

        Up to a bound, as what is in s and what is in ε must not grow against each other. Any b balances energy; one
        much steeper than the stiffest mode, as where a point is all but flat, would drown it in round-off.
        """
        body, left = self._body, self._left(E)
        if left + self._rest[1] < self._rest[1] / 2:
            self._rest[1] = min(self._rest[1] + 4 * abs(left), self._most)  # ½ s² - c stays what it was
        S = body.weights * stress(body.law, E, body.first_lame, body.shear) - linear_stress(E, self._λ, self._μ)
        b = S.ravel().dot(A) / math.sqrt(2 * max(left + self._rest[1], self._rest[1] / 4))
        steep = math.sqrt(b.dot(b))
        return b if steep <= STEEPEST * self._ω[-1] else b * (STEEPEST * self._ω[-1] / steep)

    def _taken_back(self, q: Array, dissipated: float) -> float:
        """Moves ε and s towards what the shape q has, and returns the energy that this added, J (< 0: it took some).

        At most what is in the tank, which holds what was dissipated in this and the steps before, up to what strains
        store (as in teleoperation: Franken et al., 2011): a step may give back, and the run never more than it got.
        """
        E, s = self._body.strains(q), self._s
        gap, gap_s = E - self._ε, 0.0
        if not self._linear:
            gap_s = math.sqrt(2 * max(self._left(E) + self._rest[1], 0.0)) - s
        stressed = linear_stress(gap, self._λ, self._μ)
        square = float((stressed * gap).sum()) + gap_s**2
        slope = float((stressed * self._ε).sum()) + gap_s * s
        strained = float((linear_stress(E, self._λ, self._μ) * E).sum())
        budget = float(self._rest[2]) + dissipated
        share = 1.0
        if slope + square / 2 > budget and square > 0:
            root = math.sqrt(max(slope**2 + 2 * square * budget, 0.0))
            share = min(2 * budget / (slope + root) if slope > 0 else (root - slope) / square, 1.0)
        added = share * slope + share**2 * square / 2
        self._ε += share * gap
        self._rest[0] += share * gap_s * (s + share * gap_s / 2)
        self._rest[2] = min(max(budget - added, 0.0), strained)
        self._largest = max(self._largest, strained)
        if self._largest > 0:
            self.mismatch = max(self.mismatch, (1 - share) * math.sqrt(square / self._largest))
        return added


class Newton(LargeDeformation):
    """Newton's iteration in every step. Arguments and attributes as in LargeDeformation.

    Attributes:
        cut: number of steps that had to be cut into parts.
    """

    def __init__(self, rom: Rom, ledger: EnergyLedger | None, touch: Touch | None):
        super().__init__(rom, ledger, touch)
        self._inverse: Array | None = None  # of the last tangent
        self._W_of: Array | None = None  # which W belongs to
        self.cut = 0

    @property
    def energy(self) -> float:
        """Stored, J."""
        return float(self._r.dot(self._r)) / 2 + self._body.energy(self._coordinates())

    @property
    def messages(self) -> tuple[str, ...]:
        """As in LargeDeformation."""
        if not self.cut:
            return super().messages
        return *super().messages, f"{self.cut} steps were cut into parts, as Newton's iteration did not solve the whole"

    def resume(self, auxiliary: Array = _NONE) -> None:
        """As in LargeDeformation."""
        super().resume()
        self._inverse = None  # so that what follows does not depend on what was before
        self.cut = 0

    def set_time_step(self, h: float) -> None:
        """As in ContactStepper."""
        self.flush()
        self._inverse, self.h = None, h

    def reset_buffer(self) -> int:
        """Books, and forgets the tangent: what follows is then the same to the bit, whatever came before."""
        self._inverse = None
        return super().reset_buffer()

    def step(self, u: Array) -> float:
        """As in ContactStepper.

        Raises:
            StepError: also where the iteration does not converge, however small the parts of the step.
        """
        parts = 1
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            while parts <= PARTS:
                solved = self._in_parts(u, parts)
                if solved is not None:
                    break
                parts *= 2
            else:
                raise StepError(
                    f"input {u.tolist()}: Newton's iteration does not converge, even in {PARTS} parts of a step of "
                    f"{self.h:g} s; lower dt or the load"
                )
            q, r, touched, work = solved
            self._keep(work)
            np.multiply(q, self._ω, self._e)
            self._r[:] = r
            self.touched = touched
            self.cut += parts > 1
            self._look(q)
            return float(r.dot(r)) + 2 * self._body.energy(q)

    def _in_parts(self, u: Array, parts: int) -> tuple[Array, Array, ContactSolution | None, Work] | None:
        """The state after a step in so many parts, the last contact, and the work; None where one was not solved."""
        q, r, h = self._coordinates().copy(), self._r.copy(), self.h / parts
        supplied = dissipated = 0.0
        touched: ContactSolution | None = None
        touches: tuple[Any, ...] = ()
        for part in range(parts):
            found = self._solved(u, q, r, h, part / parts)
            if found is None:
                self._inverse = None  # it is of another length
                return None
            v, force, heat, touched = found
            supplied, dissipated = supplied + h * float(force.dot(v)), dissipated + heat
            touches += self._touches(v, touched, h)
            q, r = q + h * v, 2 * v - r
        if parts > 1:
            self._inverse = None
        return q, r, touched, Work(supplied, dissipated, touches)

    def _solved(
        self, u: Array, q: Array, r: Array, h: float, begins: float
    ) -> tuple[Array, Array, float, ContactSolution | None] | None:
        """One step by iteration: v̂, the force of the inputs, what was dissipated (J), and contact.

        Args:
            u: inputs.
            q, r: the state at its beginning, (m,) each.
            h: its length, s.
            begins: when it does, as a share of the whole step.
        """
        body, ω = self._body, self._body.weights
        E = body.strains(q)
        v, before, fresh = r.copy(), math.inf, False
        for _ in range(ITERATIONS):
            middle = q + h / 2 * v
            H, after = body.displacement_gradients(middle), body.strains(q + h * v)
            rates = (after - E) / h
            viscous = linear_stress(rates, body.viscosity * body.first_lame, body.viscosity * body.shear)
            S = ω * (discrete_gradient_stress(body.law, E, after, body.first_lame, body.shear) + viscous)
            elastic, force = body.resultant(H, S) + body.springs.dot(middle), self._loads(u, middle)
            drawn = body.external_damping.dot(v)
            residual = 2 / h * (v - r) + drawn + elastic - force
            scale = max(np.abs(part).max() for part in (2 / h * r, 2 / h * v, drawn, elastic, force))
            if not math.isfinite(scale):
                return None
            if self._inverse is None:
                self._inverse, fresh = self._tangent_inverse(H, (E + after) / 2, S, h), True
            touched, pushed = self._contact_of(q, r, v - self._inverse.dot(residual), h, begins)
            residual -= pushed
            error = np.abs(residual).max()
            if error <= CONVERGED * scale or (error <= STALLED * scale and error > before / 2):
                heat = h * (float(v.dot(drawn)) + float(ω.dot((viscous * rates).sum(axis=0))))
                return v, force, heat, touched
            if error > FAST * before and not fresh:
                self._inverse, fresh = self._tangent_inverse(H, (E + after) / 2, S, h), True
            else:
                fresh = False
            before = error
            v = v - self._inverse.dot(residual)
        return None

    def _tangent_inverse(self, H: Array, E: Array, S: Array, h: float) -> Array:
        """Of 2/h + D + h/2 ∂f̂/∂q (m, m), symmetric; without the stresses' part where that makes it indefinite."""
        body, m = self._body, self._mode.order
        A = body.strain_rates(H)
        viscous = body.viscosity * moduli("st_venant_kirchhoff", E, body.first_lame, body.shear)
        D = body.weights * (h / 2 * moduli(body.law, E, body.first_lame, body.shear) + viscous)
        DA = np.einsum("cdp,dpk->cpk", D, A).reshape(-1, m)
        matrix = 2 / h * np.eye(m) + body.external_damping + h / 2 * body.springs + A.reshape(-1, m).T.dot(DA)
        return _inverse(matrix + h / 2 * body.geometric(S), matrix)

    def _contact_of(
        self, q: Array, r: Array, free: Array, h: float, begins: float
    ) -> tuple[ContactSolution | None, Array]:
        """Contact of a step from its mid-step velocity without it, and the generalized forces (m,)."""
        if self._touch is None:
            return None, np.zeros_like(q)
        assert self._inverse is not None
        around = self._touch.surroundings
        if self._W_of is not self._inverse:
            W = self._Sᵀ.T @ self._inverse @ self._Sᵀ
            self._W, self._W_of = (W + W.T) / 2, self._inverse
        start = around.offsets + begins * (around.ahead - around.offsets)
        end = start + h / self.h * (around.ahead - around.offsets)
        displacement, velocity, loose = (np.stack([q, r, free]) @ self._Sᵀ).reshape(3, -1, 3)
        touched = self._touch.contact.resolve(
            displacement, velocity, loose, self._W, h, start, end, False, around.velocities
        )
        if touched is None:
            return None, np.zeros_like(q)
        return touched, self._Sᵀ.dot(touched.forces.ravel())


class Equilibrium(LargeDeformation):
    """A step of a quasi-static run: Φ'(q⁺) = G u, from the step before by Newton's iteration under a growing load.

    Arguments and attributes as in LargeDeformation; the velocity stays zero.
    """

    @property
    def energy(self) -> float:
        """Stored, J."""
        return self._body.energy(self._coordinates())

    def set_time_step(self, h: float) -> None:
        """As in ContactStepper."""
        self.flush()
        self.h = h

    def step(self, u: Array) -> float:
        """As in Newton."""
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            start = self._coordinates().copy()
            unbalanced = self._body.force(start) - self._loads(u, start)
            q, share, growth = start, 0.0, 1.0
            touched: ContactSolution | None = None
            while share < 1:
                found = self._balanced(u, start, q, (1 - min(share + growth, 1.0)) * unbalanced)
                if found is None:
                    growth /= 2
                    if growth < 1 / PARTS:
                        raise StepError(
                            f"input {u.tolist()}: no equilibrium was found beyond {100 * share:.0f} % of the change of "
                            "the load in this step; take shorter steps or lower the load"
                        )
                else:
                    (q, touched), share = found, min(share + growth, 1.0)
            moved, force = q - start, self._loads(u, q)
            if touched is not None:
                force = force + self._Sᵀ.dot(touched.forces.ravel())
            stored = self._body.energy(q)
            # What contact takes is booked by itself; the rest of what is lost goes into heat on the way.
            heat = float(force.dot(moved)) - (stored - self._body.energy(start))
            supplied = float(self._loads(u, q).dot(moved))
            self._keep(Work(supplied, heat, self._touches(moved / self.h, touched, self.h)))
            np.multiply(q, self._ω, self._e)
            self.touched = touched
            self._look(q)
            return 2 * stored

    def _balanced(
        self, u: Array, start: Array, q: Array, unbalanced: Array
    ) -> tuple[Array, ContactSolution | None] | None:
        """A shape near q whose forces are balanced but for a part that is given, and contact; None if there is none."""
        body = self._body
        before = math.inf
        for _ in range(ITERATIONS):
            elastic, force = body.force(q), self._loads(u, q)
            residual = elastic - force - unbalanced
            scale = max(np.abs(elastic).max(), np.abs(force).max(), np.abs(unbalanced).max(), 1e-300)
            if not math.isfinite(scale):
                return None
            try:
                np.linalg.cholesky(tangent := body.tangent(q))
            except np.linalg.LinAlgError:
                return None
            inverse = np.linalg.inv(tangent)
            touched, pushed = self._pushed(start, q - inverse.dot(residual), inverse)
            residual -= pushed
            error = np.abs(residual).max()
            if error <= CONVERGED * scale or (error <= STALLED * scale and error > before / 2):
                return q, touched
            if error > 10 * before:
                return None
            before = error
            q = q - inverse.dot(residual)
        return None

    def _pushed(self, start: Array, free: Array, inverse: Array) -> tuple[ContactSolution | None, Array]:
        """Contact of a step from the shape without it, and the generalized forces (m,)."""
        if self._touch is None:
            return None, np.zeros_like(start)
        contact, _, around = self._touch
        W = self._Sᵀ.T @ inverse @ self._Sᵀ / self.h
        displacement, loose = (np.stack([start, (free - start) / self.h]) @ self._Sᵀ).reshape(2, -1, 3)
        touched = contact.resolve(
            displacement, np.zeros_like(displacement), loose, (W + W.T) / 2, self.h, around.offsets, around.ahead, True
        )
        if touched is None:
            return None, np.zeros_like(start)
        return touched, self._Sᵀ.dot(touched.forces.ravel())


def _inverse(*matrices: Array) -> Array:
    """Of the first of some symmetric matrices (m, m) that is definite; not numbers where none is."""
    for matrix in matrices:
        try:
            np.linalg.cholesky(matrix)
        except np.linalg.LinAlgError:
            continue
        inverse = np.linalg.inv(matrix)
        return (inverse + inverse.T) / 2
    return np.full_like(matrices[0], math.nan)


def _followers(rom: Rom) -> list[tuple[int, Callable[[Array], Array]]]:
    """The inputs whose forces turn with the body: columns, counted from behind the contact's, and forces of 1."""
    assert rom.deformation is not None
    found: list[tuple[int, Callable[[Array], Array]]] = []
    column = 0
    for name, columns in rom.actuators.items():
        if name in rom.deformation.pressures:
            found.append((column, partial(_pressed, rom.deformation.pressures[name])))
        elif name in rom.deformation.tendons:
            found.append((column, rom.deformation.tendons[name].force))
        column += columns
    return found


def _pressed(polynomial: Array, q: Array) -> Array:
    return polynomial @ monomials(q)


BY_NAME: dict[str, type[LargeDeformation]] = {
    "newton": Newton,
    "linearly-implicit": LinearlyImplicit,
    "equilibrium": Equilibrium,
}
