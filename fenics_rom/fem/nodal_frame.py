"""A full-order body as its moving frame sees it: momenta, inertia and energy, by the masses of its nodes.

Every node has a displacement q and its rate r in the frame; y = X + q, "a ×" is node by node, M commutes with it. Of a
free body q is M-orthogonal to rigid motions. With the velocity v of the origin and ω in the frame's axes

    P = Σ m (v + ω × y) + Σ M r,    L = I ω + Σ M y × r + Σ M y × v,    I_kl = Σ M (e_k × y)·(e_l × y) - qᵀ K_kl q

K_kl is the geometric stiffness of turning. The same as reduced, without a basis (nodal floating frame: Zwölfer &
Gerstmayr, 2021).
"""

from functools import partial
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError
from fenics_rom.fem.direct import PetscFactor
from fenics_rom.fem.frame_coupling import Coupling
from fenics_rom.fem.frame_ties import NodalTies
from fenics_rom.fem.full_order_body import FullOrderInterface
from fenics_rom.fem.moving_frame import centrifugal_stiffness
from fenics_rom.fem.nodal_motion import Motion, Rate
from fenics_rom.fem.petsc_matrix import ExtendedMatrix, PetscMatrix, combination
from fenics_rom.fem.springs import of_components, with_attached
from fenics_rom.mechanics.frame_geometry import TOO_FAR
from fenics_rom.mechanics.points_operator import Operator
from fenics_rom.mechanics.viscoelasticity import MaxwellBranches, PronySeries
from fenics_rom.mechanics.voigt import VOIGT_INDEX
from fenics_rom.system.system import System


class NodalFrame:
    """What the balances of a body are made of; every rank must make every call.

    Args:
        system: the full-order model.
        series: how its material relaxes; None: it does not, or something else has what resists its shape.

    Attributes:
        frame: of the system.
        mass: kg.
        size: radius of gyration of the body at rest about its origin, m.
        mass_of_nodes, mass_times_arms: M 1 (n, 1) and M X (n, 3) of the nodes here.
        ties: springs and dashpots to the ground; None where there are none.
        coupling: of turning and bending, which steps keep here as long as it serves; None: there is none.
        branches: of a material that relaxes; None: it does not.
        system: of all components of the nodes here.
    """

    def __init__(self, system: System, series: PronySeries | None = None):
        assert system.moving_frame is not None
        self.frame, self._of_unknowns = system.moving_frame, system
        self.system = self._system = system if self.frame.whole is None else self.frame.whole.system
        self.mass, self._first = float(self.frame.moments[0, 0]), self.frame.moments[0, 1:]
        self.size = float(np.sqrt(np.trace(self.frame.moments[1:, 1:]) / self.mass))
        self.mass_of_nodes, self.mass_times_arms = self.frame.mass_times[:, :1], self.frame.mass_times[:, 1:]
        K: Any = self._system.stiffness
        self._resisting = (ExtendedMatrix(K.mat), *centrifugal_stiffness(system))
        self._MR = self._system.mass @ self._system.rigid
        self._factored: tuple[float, PetscFactor, Array] | None = None
        self._compliance: tuple[float, Operator] | None = None
        self.coupling: Coupling | None = None
        self.ties = None if self.frame.tie_forces is None else NodalTies(self._system)
        self.branches: MaxwellBranches | None = None
        if series is not None:
            self.branches = MaxwellBranches(series, 2, self.frame.arms.size, system.algebra.total)

    def at_rest(self) -> Motion:
        """Where the frame is the world's."""
        still = np.zeros_like(self.frame.arms)
        resisted = np.stack([still] * len(self._resisting))
        return Motion(still, still, still, still, resisted, np.eye(3), self.frame.origin, np.zeros(3), np.zeros(3))

    def nodal(self, x: Array) -> Array:
        """A field (n, 3) of the unknowns that supports leave, (rows here, 1)."""
        field: Array = self.frame.expand(x.reshape(-1, 1)).reshape(-1, 3)
        return field

    def on_unknowns(self, force: Array) -> Array:
        """A force (n, 3) on these, (rows here, 1)."""
        return self.frame.restrict(np.ascontiguousarray(force).reshape(-1, 1))

    def with_shape(self, motion: Motion, q: Array, r: Array) -> Motion:
        """The same with displacement and rate of the unknowns, (rows here,)."""
        q, r = (self._strained(self.nodal(column).reshape(-1, 1)).reshape(-1, 3) for column in (q, r))
        return motion._replace(r=r, Mr=self.inert(r), q=q, Mq=self.inert(q), Kq=self._resisted(q))

    def rate(self, r: Array) -> Rate:
        """Of a mid-step rate (n, 3)."""
        return Rate(r, self.inert(r), self._resisted(r), _times(self._system.damping, r))

    def set_time_step(self, h: float) -> None:
        """Has steps of h s from now on."""
        if self.branches is not None:
            self.branches.set_time_step(h)

    def relaxing(self, rate: Rate) -> Array | float:
        """Of branches, what they pull with in a step of that rate (n, 3), N."""
        if self.branches is None:
            return 0.0
        pull: Array = self.branches.pull[1].reshape(-1, 3) + self.branches.stiffening_time * rate.Kr[0]
        return pull

    def drawn(self, rate: Rate, h: float) -> float:
        """What a step of h s at a rate dissipates in the body, J; branches take it."""
        heat = h * self.dot(rate.r, rate.Dr)
        if self.branches is not None:
            heat += self.branches.step(np.stack([rate.r.ravel(), rate.Kr[0].ravel()]))
        return heat

    def inert(self, field: Array) -> Array:
        """M times a field (n, 3)."""
        return _times(self._system.mass, field)

    def energy(self, motion: Motion) -> float:
        """Stored, J: of the motion in world axes, and elastic."""
        P, L = self.momenta(motion)
        carried = P @ motion.v + L @ motion.ω + self.sum(motion.r, self.mass_of_nodes) @ motion.v
        turned = self.turned(motion) @ motion.ω
        tied = 0.0 if self.ties is None else self.ties.pull(motion)[1]
        tied += 0.0 if self.branches is None else self.branches.stored
        return float(carried + turned + self.dot(motion.r, motion.Mr) + self.dot(motion.q, motion.Kq[0])) / 2 + tied

    def momenta(self, motion: Motion) -> tuple[Array, Array]:
        """P and L about the origin, in the frame's axes."""
        moment, drift = self.moment(motion), self.sum(motion.r, self.mass_of_nodes)
        P = self.mass * motion.v + np.cross(motion.ω, moment) + drift
        return P, self.inertia(motion) @ motion.ω + self.turned(motion) + np.cross(moment, motion.v)

    def turning_momentum(self, motion: Motion) -> Array:
        """L (3,) of a free body about its centre of mass."""
        return self.inertia(motion) @ motion.ω + self.turned(motion)

    def moment(self, motion: Motion) -> Array:
        """Σ m y (3,)."""
        return self._first + self.sum(motion.q, self.mass_of_nodes)

    def turned(self, motion: Motion) -> Array:
        """Σ M y × r (3,): the angular momentum of the rate."""
        return self.sum(np.cross(self.mass_times_arms + motion.Mq, motion.r))

    def inertia(self, motion: Motion) -> Array:
        """I (3, 3)."""
        inner, q, mX = self._system.algebra.inner, motion.q, self.mass_times_arms
        half, bent = inner(np.hstack([mX, motion.Mq]), q).reshape(2, 3, 3)
        products = self.frame.moments[1:, 1:] + half + half.T + (bent + bent.T) / 2
        inertia = np.trace(products) * np.eye(3) - products
        if len(motion.Kq) > 1:
            inertia -= np.array([self.dot(q, K) for K in motion.Kq[1:]])[VOIGT_INDEX]
        return inertia

    def check_definite(self, motion: Motion) -> None:
        """A StepError where the kinetic energy of a free body is not positive definite.

        It is where turning is heavier than what of it the displacements do by themselves, which are without rigid
        motions: I - Σ (e_k × M y)·(e_l × y), of which the rigid motions R stay, less qᵀ K_kl q.
        """
        My = self.mass_times_arms + motion.Mq
        turning = np.stack([np.cross(e, My).ravel() for e in np.identity(3)], axis=1)
        rigid = self.inner(self._system.rigid, turning)
        stiffened = np.zeros((3, 3))
        if len(motion.Kq) > 1:
            stiffened = np.array([self.dot(motion.q, K) for K in motion.Kq[1:]])[VOIGT_INDEX]
        if not np.linalg.eigvalsh(rigid.T @ rigid - stiffened)[0] > 0:
            raise StepError(TOO_FAR)

    def speed(self, motion: Motion) -> float:
        """√(2 J) of what is stored, but for translation."""
        stored = self.dot(motion.r, motion.Mr) + self.dot(motion.q, motion.Kq[0])
        return float(np.sqrt(abs(stored + motion.ω @ self.inertia(motion) @ motion.ω)))

    def sum(self, field: Array, weights: Array | None = None) -> Array:
        """Over all nodes of a field (n, any), (any,)."""
        weights = np.ones((len(field), 1)) if weights is None else weights
        return self._system.algebra.inner(weights, np.ascontiguousarray(field))[0]

    def inner(self, a: Array, b: Array) -> Array:
        """aᵀb of columns (rows here, any)."""
        return self._system.algebra.inner(a, np.ascontiguousarray(b))

    def dot(self, a: Array, b: Array) -> float:
        """Of two fields."""
        return float(self._system.algebra.inner(a.reshape(-1, 1), b.reshape(-1, 1))[0, 0])

    def inverted(self, ρ: Array, h: float) -> Array:
        """A⁻¹ρ (rows here, k) of A = 2/h M + D + (h/2 + t) K and ties, among displacements without rigid motions."""
        s, inner = self._of_unknowns, self._system.algebra.inner
        if self._factored is None or self._factored[0] != h:
            self.close()
            elastic = h / 2 if self.branches is None else h / 2 + self.branches.stiffening_time
            A = combination((2 / h, s.mass), (1.0, s.damping), (elastic, s.stiffness))
            if self.ties is not None:
                A = with_attached(PetscMatrix(A), of_components(self.ties.resistance(h)), s.body.unknowns).mat
            factor, MR = PetscFactor(A, one_by_one=True), self.frame.restrict(self._MR)
            self._factored = h, factor, self.frame.expand(factor.solve(MR)) if MR.shape[1] else self._MR
        _, factor, reactions = self._factored
        x = self.frame.expand(factor.solve(self.frame.restrict(ρ)))
        if reactions.shape[1]:
            x = x - reactions @ np.linalg.solve(inner(self._MR, reactions), inner(self._MR, x))
        return self._strained(x)

    def compliance(self, h: float, interface: FullOrderInterface) -> Operator:
        """S A⁻¹ Sᵀ of the contact points, m/s/N."""
        if self._compliance is None or self._compliance[0] != h:
            self._compliance = h, interface.operator(partial(self.inverted, h=h))
        return self._compliance[1]

    def close(self) -> None:
        """Gives the factor's memory back."""
        if self._factored is not None:
            self._factored[1].close()
            self._factored = None

    def _resisted(self, field: Array) -> Array:
        """(7, n, 3), or (1, n, 3) where stress does not stiffen."""
        return np.stack([_times(K, field) for K in self._resisting])

    def _strained(self, columns: Array) -> Array:
        """Columns (rows here, k) less their rigid motions."""
        strained: Array = columns - self._system.rigid @ self._system.algebra.inner(self._MR, columns)
        return strained


def _times(operator: Any, field: Array) -> Array:
    """Of a field (n, 3)."""
    product: Array = (operator @ field.reshape(-1, 1)).reshape(-1, 3)
    return product
