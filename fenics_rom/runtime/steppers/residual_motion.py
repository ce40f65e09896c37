"""How contact points yield beyond the basis of the active contact mode: elastic, damped, with an inertia of its own.

The part of the displacement outside of the basis is (I - P_i) K⁻¹ Sᵀ g, with the force g (3P,) that it carries. It
moves the points by y = R g and stores ½ gᵀ R g. Its damping is β times its stiffness, and its inertia, of all shapes
together, τ² times that: under contact forces f (3P,) τ² g̈ + β ġ + g = f, so that in a step

    ġ̂ = (f - g + 2τ²/h ġ)/a,    a = 2τ²/h + β + h θ,    g⁺ = g + h ġ̂,    ġ⁺ = 2 ġ̂ - ġ.

The points' mid-step velocity is R ġ̂ beside that of the basis: contact sees the Delassus operator W + R/a, and
(2τ²/h R ġ - y)/a beside the free velocity. θ = ½ is passive midpoint integration. Where steps are longer than 2 β it
would let the fastest of these motions alternate without end, so there θ = 1 - β/h. In both cases

    ½ gᵀ R g + ½ τ² ġᵀ R ġ    grows by    h fᵀ R ġ̂ - h (β + (θ - ½) h) ġ̂ᵀ R ġ̂.

Without inertia every step is an equilibrium: τ = β = 0, θ = 1 and g⁺ = f. The branches of a material that relaxes
(mechanics/viscoelasticity.py) are beside g, too: f is less by Σ g_k w/(1 + θ h/τ_k), a more by their stiffening time.
"""

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.contact import ContactSolution, is_zero
from fenics_rom.mechanics.points_operator import Operator, moved_by, operator_of
from fenics_rom.rom.residual_part import ResidualPart, residual_part, strained_points
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.steppers.residual_maps import ResidualMaps

if TYPE_CHECKING:
    from fenics_rom.mechanics.viscoelasticity import MaxwellBranches
    from fenics_rom.runtime.steppers.contact_interface import ContactInterface

FORGOTTEN = 1e-200  # J: what is stored no more, before its numbers become too small to be fast
NEGLIGIBLE = 1e-30  # of the energy of the basis: what is stored no more, as 1e-15 of displacements is round-off


class Relaxation(NamedTuple):
    """The coefficients of a step of h s."""

    inertia: float  # 2τ²/h, s
    whole: float  # a, s
    heat: float  # β + (θ - ½) h, s


def relaxation(h: float, τ: float, β: float, stiffening_time: float = 0.0) -> Relaxation:
    """Of a step of h s with the time constants of inertia and damping, and that of branches in it, s."""
    inertia, elastic = 2 * τ**2 / h, max(h / 2, h - β)
    return Relaxation(inertia, inertia + β + elastic + stiffening_time, β + elastic - h / 2)


class ResidualMotion:
    """The residual part of the displacement, in one contact mode.

    Args:
        part: what the contact mode lacks.
        β: time constant of damping, s.
        has_inertia: whether steps are dynamic.
        branches: how the material relaxes, in strains w and R w; None: it does not.

    Attributes:
        state: [g, y, ġ, ẏ] (12P,), N, m, N/s, m/s.
    """

    _maps: "ResidualMaps | None" = None

    def __init__(self, part: ResidualPart, β: float, has_inertia: bool, branches: "MaxwellBranches | None" = None):
        self._branches = branches
        self._part, self._R = part, part.operator
        self._τ, self._β = (part.time_constant, β) if has_inertia else (0.0, 0.0)
        self.stand_in(np.zeros((6, len(part.points))), np.zeros((3, 4)))
        self._before = self.state.copy()

    def stand_in(self, rows: Array, added: Array) -> None:
        """Has the state from now on in the first of these rows (6, 3P), and what `points` are of these in (3, 4).

        After the state come f and R f of a step, so that all is one product with these rows. What is added follows the
        time step, also where that is cut into parts.
        """
        self._added = added
        self._rows, self.state = rows, rows[:4].reshape(-1)
        self._g, self._y, self._ġ, self._ẏ, self._f, self._Rf = rows

    def set_time_step(self, h: float) -> None:
        """Makes the coefficients for a time step, s."""
        self._h, self._maps = h, None
        stiffening_time = 0.0
        if self._branches is not None:
            self._branches.set_time_step(h)
            stiffening_time = self._branches.stiffening_time
        self._relaxation = inertia, a, _ = relaxation(h, self._τ, self._β, stiffening_time)
        g, y, ġ, ẏ, f, Rf = np.eye(6)
        ġ_mid, ẏ_mid = (inertia * ġ - g + f) / a, (inertia * ẏ - y + Rf) / a
        self._step = np.array([g + h * ġ_mid, y + h * ẏ_mid, 2 * ġ_mid - ġ, 2 * ẏ_mid - ẏ, ġ_mid, ẏ_mid])
        self._added[:] = np.array([y, ẏ, (inertia * ẏ - y) / a])[:, :4]

    @property
    def states(self) -> tuple[Array, Array]:
        """[g, y, ġ, ẏ] (4, 3P) now, and before the last step."""
        return self.state.reshape(4, -1), self._before.reshape(4, -1)

    @property
    def times(self) -> tuple[float, float, float, float]:
        """2τ²/h, a, β + (θ - ½) h and τ, s."""
        return *self._relaxation, self._τ

    @property
    def is_whole(self) -> bool:
        """Whether R is an array, and not asked for what few points do."""
        return isinstance(self._R, np.ndarray)

    @property
    def branches(self) -> "MaxwellBranches | None":
        """How the material relaxes."""
        return self._branches

    @property
    def relaxes(self) -> bool:
        """Whether branches of the material are beside it."""
        return self._branches is not None

    @property
    def part(self) -> ResidualPart:
        """What the contact mode lacks."""
        return self._part

    @property
    def maps(self) -> "ResidualMaps":
        """What steps of this length do."""
        if self._maps is None:
            self._maps = self._made_maps()
        return self._maps

    def _made_maps(self) -> "ResidualMaps":
        pull, decay, gain, ratios = np.zeros((4, 0))
        if self._branches is not None:
            (pull, decay, gain), ratios = self._branches.coefficients
        n = 4 + 2 * len(pull)
        every, rates = np.eye(n + 2), np.zeros((2, n + 2))
        rates[:, [0, 1, 2, 3, -2, -1]] = self._step[4:]
        for row, rate in enumerate(rates):
            rate[4 + row : n : 2] = -pull / self._relaxation.whole
        step = np.zeros((n + 2, n + 2))
        step[:2], step[2:4] = every[:2] + self._h * rates, 2 * rates - every[2:4]
        for k, (lasts, gains) in enumerate(zip(decay, gain, strict=True)):
            places = slice(4 + 2 * k, 6 + 2 * k)
            step[places] = lasts * every[places] + gains * rates
        step[-2:], added = rates, np.zeros((3, n))
        added[:, :4], added[2, 4:] = self._added, rates[1, 4:n]
        return ResidualMaps(step, added, self._part, self._τ, self.heat, ratios)

    @property
    def carried_now(self) -> Array:
        """What is carried (n, 3P), a copy."""
        return self.carried.reshape(-1, len(self._g)).copy()

    @property
    def carried_before(self) -> Array:
        """What was carried before the last step, (n, 3P)."""
        carried = (
            self._before if self._branches is None else np.concatenate([self._before, self._branches.before.ravel()])
        )
        return carried.reshape(-1, len(self._g))

    @property
    def delassus(self) -> Operator:
        """R/a (3P, 3P), m/s/N."""
        a = self._relaxation.whole
        return self._R / a if isinstance(self._R, np.ndarray) else self._R.divided(a)

    def delassus_of(self, some: Array) -> Array:
        """The same of some points (s,), (3 s, 3 s)."""
        return operator_of(self._R, some) / self._relaxation.whole

    @property
    def is_at_rest(self) -> bool:
        """Whether it has nothing to add as long as nothing touches, as where nothing has touched for long."""
        return not self.carried.any()

    @property
    def carried(self) -> Array:
        """The state, and that of branches."""
        return self.state if self._branches is None else np.concatenate([self.state, self._branches.state.ravel()])

    def resume(self, carried: Array) -> None:
        """Goes on from what was saved of it; from rest, where there is nothing."""
        self.state[:] = carried[: len(self.state)] if len(carried) else 0.0
        if self._branches is not None:
            self._branches.resume(carried[len(self.state) :])

    @property
    def stored(self) -> float:
        """½ gᵀ R g + ½ τ² ġᵀ R ġ, and what branches store, J."""
        stored = float(self._g.dot(self._y) + self._τ**2 * self._ġ.dot(self._ẏ)) / 2
        return stored if self._branches is None else stored + self._branches.stored

    @property
    def _strain_energy(self) -> float:
        return float(self._g.dot(self._y)) / 2

    @property
    def _kinetic_energy(self) -> float:
        return self._τ**2 * float(self._ġ.dot(self._ẏ)) / 2

    @property
    def points(self) -> Array:
        """What it adds to the points' displacement, velocity and free mid-step velocity, (3, P, 3)."""
        added: Array = self._added.dot(self._rows[:4]).reshape(3, -1, 3)
        self.relax(added[2])
        return added

    def relax(self, free: Array) -> None:
        """Adds to the free mid-step velocity (P, 3) what the branches do."""
        if self._branches is not None:
            free -= (self._branches.pull[1] / self._relaxation.whole).reshape(-1, 3)

    @property
    def displacement(self) -> Array:
        """What it adds to the points' displacement, (P, 3), m."""
        return self._y.reshape(-1, 3)

    @property
    def strained(self) -> Array:
        """What of it lies in the shared basis, in K-orthonormal coordinates of that, (k - rigid,) J^1/2."""
        return self._part.strained(self._g)

    @property
    def beyond_shared(self) -> Array:
        """What of the points' displacement no shape of the shared basis has, (P, 3), m."""
        strained = self.strained
        beyond: Array = self._y - self._part.points.dot(strained)
        return beyond.reshape(-1, 3)

    def velocity(self, contact: ContactSolution | None) -> Array:
        """Mid-step velocity (P, 3), m/s, that it adds to the points' under contact forces."""
        return self._after(contact)[5].reshape(-1, 3)

    def step(self, contact: ContactSolution | None, energy: float) -> tuple[Array, float]:
        """Takes a step under contact forces: the mid-step velocity (P, 3), m/s, that it adds, and what is lost, J.

        Where next to nothing is stored any more beside the energy of the basis, J, all is forgotten.
        """
        after = self._after(contact)
        self.remember()
        if contact is None and self.stored < max(FORGOTTEN, NEGLIGIBLE * energy):
            self.resume(np.empty(0))
            return after[5].reshape(-1, 3), 0.0
        self._rows[:4] = after[:4]
        heat = self._h * self._relaxation.heat * float(after[4].dot(after[5]))
        return after[5].reshape(-1, 3), heat if self._branches is None else heat + self._branches.step(after[4:])

    def move(self, pushed: Array) -> Array:
        """Takes a step under f and R f, as `step` without branches: ġ̂ and R ġ̂, which lose `heat`; (2, 3P) each."""
        self._before[:] = self.state
        self._rows[4:] = pushed
        after: Array = self._step.dot(self._rows)
        self._rows[:4] = after[:4]
        return after[4:]

    @property
    def heat(self) -> float:
        """What a step dissipates of ġ̂ᵀ R ġ̂, s²."""
        return self._h * self._relaxation.heat

    def _after(self, contact: ContactSolution | None) -> Array:
        """The state after a step under contact forces, then the rates of g and y in it, (6, 3P)."""
        self._rows[4:] = 0.0
        if contact is not None:
            self._push(contact)
        if self._branches is not None:
            self._rows[4:] -= self._branches.pull
        after: Array = self._step.dot(self._rows)
        return after

    def _push(self, contact: ContactSolution) -> None:
        """Sets f and R f."""
        self._f[:], self._Rf[:] = contact.forces.ravel(), moved_by(self._R, contact.forces)

    def work_of_start(self, before: ContactSolution | None, velocity: Array) -> float:
        """Work, J, in the last step, between equilibria, of what held it at its start besides contact forces before.

        There is nothing where the step before led there; after a switch there may be.

        Args:
            before: contact then.
            velocity: (P, 3), m/s, that it added.
        """
        held = self._before[: len(self._g)]
        held = held if before is None else held - before.forces.ravel()
        return self._h / 2 * float(held.dot(velocity.ravel()))

    def remember(self) -> None:
        """Notes the state before a step."""
        self._before[:] = self.state
        if self._branches is not None:
            self._branches.remember()

    @contextmanager
    def in_parts(self, parts: int) -> Iterator[None]:
        """Steps in here are parts of a time step, which `rollback`, and an error, take back as one."""
        h, before, branches = self._h, self.carried.copy(), self._branches
        state_of_branches = None if branches is None else branches.state
        self.set_time_step(h / parts)
        try:
            yield
        except BaseException:
            self.resume(before)
            raise
        finally:
            self.set_time_step(h)
            self._before[:] = before[: len(self._before)]
            if branches is not None and state_of_branches is not None:
                branches.before = state_of_branches

    def rollback(self) -> None:
        """Takes the last step back."""
        self.state[:] = self._before
        if self._branches is not None:
            self._branches.rollback()

    def carry_over(self, e: Array, start: "ResidualMotion", e_start: Array) -> None:
        """Goes on where another contact mode's residual part was, with the whole displacement.

        That is projected K-orthogonally onto what this mode and its residual part hold, so that no energy is added and
        no contact point moves. The points keep the residual part's velocity, but for what would be more kinetic energy.

        Args:
            e: (m - rigid,) energy coordinates √γ q of this mode, which are set.
            start: of the mode before.
            e_start: its energy coordinates.
        """
        self._g[:], self._y[:] = self._projected(e, start, e_start, start._g, start._y)
        self._keep_rate(start)

    def carry_branches(self, b: Array, start: "ResidualMotion", b_start: Array) -> None:
        """The same of the strains of branches, in energy coordinates (N, m - rigid) each, of which b are set."""
        if self._branches is not None and start._branches is not None:
            parts = self._branches.state, start._branches.state
            for own, here, there, own_start in zip(b, *parts, b_start, strict=True):
                here[:] = self._projected(own, start, own_start, *there)

    def _projected(self, e: Array, start: "ResidualMotion", e_start: Array, g: Array, y: Array) -> tuple[Array, Array]:
        """Sets e of a displacement that was e_start and, in the residual part of before, g and y; those here (3P,)."""
        here, there = self._part, start._part
        e[:] = here.basis.T.dot(there.basis.dot(e_start) + there.strained(g))
        strained = float(e_start.dot(e_start)) + float(g.dot(y))
        y = there.basis_points.dot(e_start) + y - here.basis_points.dot(e)
        return self._carried(y, strained - float(e.dot(e)))

    def take_over(self, start: "ResidualMotion") -> None:
        """Goes on where another contact mode's residual part was, with no more energy than that had."""
        self._g[:], self._y[:] = self._carried(start._y, 2 * start._strain_energy)
        self._keep_rate(start)
        if self._branches is not None and start._branches is not None:
            for here, (g, y) in zip(self._branches.state, start._branches.state, strict=True):
                here[:] = self._carried(y, float(g.dot(y)))

    def _keep_rate(self, start: "ResidualMotion") -> None:
        self._ġ[:], self._ẏ[:] = self._carried(start._ẏ, 2 * start._kinetic_energy / self._τ**2 if self._τ else 0.0)

    def _carried(self, y: Array, most: float) -> tuple[Array, Array]:
        """g and R g = y (3P,), made smaller where gᵀ R g would be more than `most`."""
        if is_zero(y):
            return y, y
        g = self._part.inverse_root.dot(y).dot(self._part.inverse_root)
        y = moved_by(self._R, g.reshape(-1, 3))
        stored = float(g.dot(y))  # not |C⁻¹ y|², which round-off may make less where R is nearly singular
        share = math.sqrt(max(most, 0.0) / stored) if stored > most else 1.0
        return share * g, share * y


def residual_motions(
    rom: Rom, interface: "ContactInterface | None", has_inertia: bool
) -> Callable[[str], ResidualMotion | None]:
    """What makes the residual part of a contact mode, by its name; of None where there is none."""
    residual = rom.residual_compliance
    if interface is None or residual is None or not interface.environment.environment.residual_compliance:
        return lambda contact: None
    H, κ, series = strained_points(rom.stiffness, interface.rows), rom.stiffness, None
    if has_inertia:
        series = interface.environment.environment.viscoelasticity

    def motion(contact: str) -> ResidualMotion:
        part = residual_part(κ, rom.contact_models[contact], H, residual)
        branches = None
        if series is not None:
            from fenics_rom.mechanics.viscoelasticity import MaxwellBranches  # here, as few bodies have them

            branches = MaxwellBranches(series, 2, len(part.points))
        return ResidualMotion(part, residual.damping, has_inertia, branches)

    return motion
