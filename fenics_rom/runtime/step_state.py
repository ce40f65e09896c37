"""The state that a step begins with, as numbers: what it leads to can be asked for from any state nearby.

Of large deformation a step that begins with q and r alone, as where they are put in: strains that it carries along are
those of the shape. Of what contact points yield beyond the basis it is the forces g and their rates of those points
that carry one; of a free body also where its frame is, turned by a vector (rad) from where it was.
"""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.mechanics.frame_motion import composed, cross_matrix, quaternion_of_vector, rotation_matrix
from fenics_rom.runtime.simulator import Simulator
from fenics_rom.runtime.steppers.adjoint import NONE, StateAdjoint, pose_pulled_back

POSE = {"position": "m", "rotation": "rad", "velocity": "m/s", "angular_velocity": "rad/s"}
Names = dict[str, str]


class StepState:
    """The state of a body, as numbers x (s,), and its step.

    Args:
        body: where it is the state x that it is linearised about; it is moved from there and back.
        carrying: (P,) which contact points carry a force.

    Attributes:
        names: unit of each number, by name.
        places: of the parts of x, by name: e, r, g, "g rate", branches, pose.
    """

    def __init__(self, body: Simulator, carrying: Array):
        self.body, self._start, kernel = body, body.save(), body.integrator.kernel
        m, ρ = body.model.order, len(body.integrator.rigid_displacement)
        self.has_inertia = body.environment is None or body.environment.environment.has_inertia
        residual, branches = kernel.residual, kernel.branches
        self._points = np.repeat(carrying, 3) if residual is not None else np.zeros(0, bool)
        points = [f"{point},{axis}" for point in np.flatnonzero(carrying) for axis in range(3)] if residual else []
        parts: dict[str, Names] = {"e": {f"e[{k}]": "m kg^0.5" if k < ρ else "J^0.5" for k in range(m)}}
        if self.has_inertia:
            parts["r"] = {f"r[{k}]": "J^0.5" for k in range(m)}
        parts["g"] = {f"g[{point}]": "N" for point in points}
        if self.has_inertia:
            parts["g rate"] = {f"g rate[{point}]": "N/s" for point in points}
        if residual is not None and len(residual.carried) > residual.state.size:
            count = (len(residual.carried) - residual.state.size) // (residual.state.size // 2)
            parts["g branches"] = {f"g{branch}[{point}]": "N" for branch in range(count) for point in points}
        if branches is not None:
            parts["b"] = {f"b{place}": "1" for place in map(str, np.ndindex(branches.state.shape))}
        if self._is_free:
            parts["pose"] = {f"{name}[{axis}]": unit for name, unit in POSE.items() for axis in range(3)}
        self.names: Names = {}
        self.places: dict[str, slice] = {}
        for part, names in parts.items():
            self.places[part] = slice(len(self.names), len(self.names) + len(names))
            self.names |= names
        self._at_start = None if body.pose is None else body.pose
        self.x = self.read()

    @property
    def _is_free(self) -> bool:
        return self.body.pose is not None and self.body.base_wrench is None

    def read(self) -> Array:
        """x (s,) of the body now."""
        body, x = self.body, np.zeros(len(self.names))
        integrator = body.integrator
        kernel, (e, r) = integrator.kernel, integrator.state.reshape(2, -1)
        x[self.places["e"]] = e
        integrator.flush()
        x[: len(integrator.rigid_displacement)] = integrator.rigid_displacement
        if self.has_inertia:
            x[self.places["r"]] = r
        if kernel.residual is not None:
            g, _, ġ, _ = kernel.residual.state.reshape(4, -1)
            x[self.places["g"]] = g[self._points]
            if self.has_inertia:
                x[self.places["g rate"]] = ġ[self._points]
            if "g branches" in self.places:
                strains = kernel.residual.carried[4 * len(g) :].reshape(-1, 2, len(g))
                x[self.places["g branches"]] = strains[:, 0, self._points].ravel()
        if kernel.branches is not None:
            x[self.places["b"]] = kernel.branches.state.ravel()
        if self._is_free and self._at_start is not None and body.pose is not None:
            pose, back = body.pose, self._at_start.rotation * np.array([1.0, -1.0, -1.0, -1.0])
            w, *vector = composed(tuple(pose.rotation.tolist()), tuple(back.tolist()))
            half = float(np.linalg.norm(vector))
            turn = 2 * np.arctan2(half, w)
            turned = np.array(vector) * ((turn - 2 * np.pi * (turn > np.pi)) / half if half else 2.0)
            x[self.places["pose"]] = np.concatenate([pose.position, turned, pose.velocity, pose.angular_velocity])
        return x

    def put(self, x: Array) -> None:
        """Puts the body where its state is x (s,), and all else as it was at the start."""
        body = self.body
        body.restore(self._start)
        integrator = body.integrator
        kernel, rigid = integrator.kernel, integrator.rigid_displacement
        e, r = integrator.state.reshape(2, -1)
        e[:], rigid[:] = x[self.places["e"]], x[: len(rigid)]
        e[: len(rigid)] = 0.0
        if self.has_inertia:
            r[:] = x[self.places["r"]]
        kernel.resume(np.empty(0))
        if kernel.residual is not None:
            kernel.residual.resume(self._residual_rows(x))
        if kernel.branches is not None:
            kernel.branches.resume(x[self.places["b"]])
        if self._is_free and self._at_start is not None:
            position, turn, velocity, turning = x[self.places["pose"]].reshape(4, 3)
            start = tuple(self._at_start.rotation.tolist())
            rotation = composed(tuple(quaternion_of_vector(turn).tolist()), start)
            integrator.place(BaseState(position, np.array(rotation), velocity, turning))  # type: ignore[attr-defined]

    def _residual_rows(self, x: Array) -> Array:
        """What a residual part carries along."""
        residual = self.body.integrator.kernel.residual
        assert residual is not None
        R = residual.part.compliance
        g, ġ = np.zeros((2, len(R)))
        g[self._points] = x[self.places["g"]]
        if self.has_inertia:
            ġ[self._points] = x[self.places["g rate"]]
        rows = [g, R @ g, ġ, R @ ġ]
        if "g branches" in self.places:
            count = (len(residual.carried) - residual.state.size) // (residual.state.size // 2)
            for strains in x[self.places["g branches"]].reshape(count, -1):
                w = np.zeros(len(R))
                w[self._points] = strains
                rows += [w, R @ w]
        return np.concatenate(rows)

    @property
    def _rows(self) -> slice:
        """Where `Kernel.auxiliary` has the rows of the residual part."""
        kernel = self.body.integrator.kernel
        if kernel.residual is None:
            return slice(0, 0)
        start = 0 if kernel.rows_first else len(kernel.auxiliary) - len(kernel.residual.carried)
        return slice(start, start + kernel.residual.state.size)

    @property
    def _branches(self) -> slice:
        """Where it has the branches of the material: the last numbers of what is not the residual part's."""
        kernel = self.body.integrator.kernel
        size, whole = self.places["b"].stop - self.places["b"].start, len(kernel.auxiliary)
        end = whole if kernel.rows_first or kernel.residual is None else whole - len(kernel.residual.carried)
        return slice(end - size, end)

    def owed(self, x: Array) -> StateAdjoint:
        """Derivatives with all that a step leads to, where the body is now, from those with the numbers x (s,)."""
        body, m = self.body, self.places["e"].stop
        kernel, ρ = body.integrator.kernel, len(body.integrator.rigid_displacement)
        state, auxiliary, frame = np.zeros(2 * m), np.zeros(len(kernel.auxiliary)), NONE
        state[:m] = x[self.places["e"]]
        rigid = state[:ρ].copy()
        state[:ρ] = 0.0
        if self.has_inertia:
            state[m:] = x[self.places["r"]]
        if kernel.residual is not None:
            rows = auxiliary[self._rows].reshape(4, -1)
            rows[0] = self.points_of(x, "g")
            if self.has_inertia:
                rows[2] = self.points_of(x, "g rate")
        if "b" in self.places:
            auxiliary[self._branches] = x[self.places["b"]]
        if self._is_free and body.pose is not None:
            frame = _frame_owed(body.pose, self.read()[self.places["pose"]][3:6], x[self.places["pose"]])
        return StateAdjoint(state, rigid, auxiliary, frame=frame)

    def points_of(self, x: Array, part: str) -> Array:
        """Of the residual part that part of x, 0 where no force is carried, (3P,)."""
        row = np.zeros(len(self._points))
        row[self._points] = x[self.places[part]]
        return row

    def gather(self, q: Array, r: Array, before: StateAdjoint) -> Array:
        """Derivatives with x (s,) from those with q and r (m,), and with what else a step begins with."""
        x, body = np.zeros(len(self.names)), self.body
        ω = body.model.safe_frequencies.copy()
        ω[: len(body.integrator.rigid_displacement)] = 1.0
        x[self.places["e"]] = q / ω
        if self.has_inertia:
            x[self.places["r"]] = r
        kernel = body.integrator.kernel
        if kernel.residual is not None:
            R, rows = kernel.residual.part.compliance, before.auxiliary[self._rows].reshape(4, -1)
            x[self.places["g"]] = (rows[0] + R @ rows[1])[self._points]
            if self.has_inertia:
                x[self.places["g rate"]] = (rows[2] + R @ rows[3])[self._points]
        if "b" in self.places:
            x[self.places["b"]] = before.auxiliary[self._branches]
        if len(before.frame) and self._at_start is not None:
            x[self.places["pose"]] = np.concatenate(list(pose_pulled_back(self._at_start, before.frame).values()))
        return x


def _frame_owed(pose: BaseState, turn: Array, x: Array) -> Array:
    """`StateAdjoint.frame` at a pose, turned by a vector from where it was, from derivatives with its numbers (12,)."""
    p_, turn_, v_, spin_ = x.reshape(4, 3)
    R, angle, turned = rotation_matrix(pose.rotation), float(np.linalg.norm(turn)), cross_matrix(turn)
    bent = 1 / 12 + angle**2 / 720
    if angle > 1e-2:
        bent = (1 - angle / 2 / np.tan(angle / 2)) / angle**2
    by_turn = np.eye(3) - turned / 2 + bent * turned @ turned  # of the vector, by a further turn along axes of space
    ω_ = R.T @ spin_
    return np.concatenate(
        [p_, R.T @ by_turn.T @ turn_ + np.cross(R.T @ pose.angular_velocity, ω_), v_, ω_, np.zeros(3)]
    )
