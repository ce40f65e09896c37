"""Steps of a full-order body that deforms largely and that nothing holds, as its moving frame has them.

The body is stepped in world axes, where its potential turns with it by itself. Its frame is that in which it has no
linear and no angular momentum of its own to first order (Buckens' frame): at the centre of mass p, turned by R with

    Σ M X × Rᵀ(x - p) = 0,    so that (Σ M X (x - p)ᵀ) R is symmetric: R is a polar factor

Loads of its frame turn with R of the middle of the step, as the start of the step foretells it.
"""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.fem.finite_strain.model import FiniteStrainModel
from fenics_rom.fem.finite_strain.residuals import InFrame, InnerDrag
from fenics_rom.fem.finite_strain.stepper import FiniteStrainStepper
from fenics_rom.fem.frame_loads import FrameLoads
from fenics_rom.mechanics.active_environment import ActiveEnvironment
from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.mechanics.frame_motion import cross_matrix, quaternion_of, rotation_matrix
from fenics_rom.mechanics.step import MOVING_FRAME, StepInput
from fenics_rom.system.system import System


class FreeFiniteStrainStepper(FiniteStrainStepper):
    """Arguments and attributes as in FiniteStrainStepper; x and v are in world axes.

    Attributes:
        wrench: None, as no base puts one on the body.
    """

    wrench = None

    def __init__(
        self,
        system: System,
        model: FiniteStrainModel,
        dt: float,
        environment: ActiveEnvironment,
        *,
        ledger: bool = True,
    ):
        self._middle = np.eye(3)  # R there
        super().__init__(system, model, dt, environment, ledger=ledger)
        self.kind, self.reason = MOVING_FRAME, "nothing holds the body, which deforms largely"
        self._environment = environment
        frame = system.moving_frame
        assert frame is not None
        self._frame, self._mass = frame, float(frame.moments[0, 0])
        self._of_nodes, self._arms = frame.mass_times[:, :1], frame.mass_times[:, 1:]  # M 1 and M X of the nodes here

    @property
    def pose(self) -> BaseState:
        """Where the frame is and how it moves, in world axes."""
        R, p, v, ω = self._motion()
        return BaseState(p, quaternion_of(R), v, R @ ω)

    @property
    def momentum(self) -> tuple[Array, Array]:
        """Linear, N s, and angular about the centre of mass, N m s, in world axes."""
        Mv = (self._model.mass @ self.v).reshape(-1, 3)
        arms = self._frame.arms + self.x.reshape(-1, 3)
        P, L = self._sum(np.hstack([Mv, np.cross(arms, Mv)])).reshape(2, 3)
        return P, L - np.cross(self._displaced(), P)

    @property
    def strained(self) -> Array:
        """Displacement (rows here, 1) in the frame, m."""
        return self._in_frame()[0].reshape(-1, 1)

    @property
    def shape(self) -> Array:
        """As in FullOrderBody."""
        return self._field(self.strained, None)

    def place(self, pose: BaseState) -> None:
        """Puts the frame, with the shape that the body has."""
        q, r = self._in_frame()
        self._put(pose, q, r)

    def set_shape(self, q: Array, r: Array) -> None:
        """Local rows of displacement (m) and its rate (m/s) in the frame, (rows here,) each, which stays."""
        self._put(self.pose, q.reshape(-1, 3), r.reshape(-1, 3))

    def step(self, inputs: StepInput) -> float:
        """As in FiniteStrainStepper."""
        self._middle, S = self._attitude(self.x + self.dt / 2 * self.v)
        if (damping := self._model.inner_damping) is not None:
            drag = InnerDrag(damping, self._rigid, self._shares(self._middle, S), self._model.algebra)
            self._frame_terms = InFrame(drag)
        return super().step(inputs)

    def _dead_force(self, u: Array) -> Array:
        """As in FiniteStrainStepper, of loads that turn with the frame, and others."""
        loads = FrameLoads.of(self.system, self.contact_mode, self.input_matrix, u, self._environment)
        force = loads.turning @ self._middle.T + loads.world + self._of_nodes * loads.acceleration
        return np.ascontiguousarray(force).reshape(-1, 1)

    def _put(self, pose: BaseState, q: Array, r: Array) -> None:
        R, X = rotation_matrix(pose.rotation), self._frame.arms
        arms = (X + q) @ R.T
        x = pose.position - self._frame.origin + arms - X
        v = pose.velocity + np.cross(pose.angular_velocity, arms) + r @ R.T
        self.set_state(np.ascontiguousarray(x).ravel(), np.ascontiguousarray(v).ravel())

    def _in_frame(self) -> tuple[Array, Array]:
        """Displacement and its rate in the frame, (n, 3) each."""
        R, p, v, ω = self._motion()
        y = (self._frame.arms + self.x.reshape(-1, 3) + self._frame.origin - p) @ R
        return y - self._frame.arms, (self.v.reshape(-1, 3) - v) @ R - np.cross(ω, y)

    def _motion(self) -> tuple[Array, Array, Array, Array]:
        """R, p and its velocity in world axes, and the angular velocity in those of the frame."""
        R, S = self._attitude(self.x)
        v = self.v.reshape(-1, 3)
        turning = self._products(self._arms, v) @ R
        spin = np.array([turning[1, 2] - turning[2, 1], turning[2, 0] - turning[0, 2], turning[0, 1] - turning[1, 0]])
        mean = self._sum(self._of_nodes * v) / self._mass
        return R, self._frame.origin + self._displaced(), mean, np.linalg.solve(np.trace(S) * np.eye(3) - S, spin)

    def _displaced(self) -> Array:
        """Of the centre of mass, (3,), m."""
        return self._sum(self._of_nodes * self.x.reshape(-1, 3)) / self._mass

    def _attitude(self, x: Array) -> tuple[Array, Array]:
        """R (3, 3) at displacements (rows here, 1) in world axes, and the symmetric Σ M X (x - p)ᵀ R."""
        products = self._frame.moments[1:, 1:] + self._products(self._arms, x.reshape(-1, 3))
        U, _, Vᵀ = np.linalg.svd(products)
        R = (Vᵀ.T * [1.0, 1.0, np.sign(np.linalg.det(Vᵀ.T @ U.T))]) @ U.T
        return R, products @ R

    def _rigid(self, x: Array) -> Array:
        """Velocities (rows here, 6) of the body as a whole at displacements (rows here, 1)."""
        moved, unit = x.reshape(-1, 3), np.eye(3)
        arms = self._frame.arms + moved - self._sum(self._of_nodes * moved) / self._mass
        turning = np.stack([np.cross(axis, arms) for axis in unit], axis=2)
        return np.concatenate([np.broadcast_to(unit, turning.shape), turning], axis=2).reshape(-1, 6)

    def _shares(self, R: Array, S: Array) -> Array:
        """What tells how much of each of these is in a velocity, (rows here, 6), where the frame is turned by R."""
        turns = R @ np.linalg.inv(np.trace(S) * np.eye(3) - S)
        crossed = np.array([cross_matrix(arm) for arm in self._arms]).reshape(-1, 3, 3)
        along = self._of_nodes[:, :, None] / self._mass * np.eye(3)
        shares = np.concatenate([along, (turns @ crossed @ R.T).transpose(0, 2, 1)], axis=2)
        return np.ascontiguousarray(shares).reshape(-1, 6)

    def _products(self, left: Array, right: Array) -> Array:
        """Σ left rightᵀ (3, 3) over all nodes."""
        return self._model.algebra.inner(np.ascontiguousarray(left), np.ascontiguousarray(right))

    def _sum(self, field: Array) -> Array:
        """Over all nodes of a field (n, any), (any,)."""
        ones = np.ones((len(field), 1))
        return self._model.algebra.inner(ones, np.ascontiguousarray(field))[0]
