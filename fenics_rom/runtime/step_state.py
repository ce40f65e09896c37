"""The state that a step begins with, as numbers: what it leads to can be asked for from any state nearby.

Of large deformation a step that begins with q and r alone, as where they are put in: strains that it carries along are
those of the shape. Of what contact points yield beyond the basis it is the forces g and their rates of those points
that carry one; of a free body also where its frame is, turned by a vector (rad) from where it was.
"""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.mechanics.frame_motion import composed, quaternion_of_vector
from fenics_rom.runtime.simulator import Simulator

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

    def spread(self, x: Array) -> tuple[Array, Array, Array]:
        """Of numbers x (s,): [e, r] (2m,), rows (4, 3P) of the residual part and displacement of rigid motions (ρ,).

        As derivatives are: with rigid motions beside e, and none of what follows from others.
        """
        m, ρ = self.places["e"].stop, len(self.body.integrator.rigid_displacement)
        state, rows = np.zeros(2 * m), np.zeros((4, len(self._points)))
        state[:m] = x[self.places["e"]]
        rigid = state[:ρ].copy()
        state[:ρ] = 0.0
        rows[0, self._points] = x[self.places["g"]]
        if self.has_inertia:
            state[m:] = x[self.places["r"]]
            rows[2, self._points] = x[self.places["g rate"]]
        return state, rows, rigid

    def gather(self, q: Array, r: Array, rows: Array) -> Array:
        """Derivatives with x (s,) from those with q and r (m,) and with rows (4, 3P) of the residual part."""
        x, body = np.zeros(len(self.names)), self.body
        ω = body.model.safe_frequencies.copy()
        ω[: len(body.integrator.rigid_displacement)] = 1.0
        x[self.places["e"]] = q / ω
        if self.has_inertia:
            x[self.places["r"]] = r
        residual = body.integrator.kernel.residual
        if residual is not None:
            R = residual.part.compliance
            x[self.places["g"]] = (rows[0] + R @ rows[1])[self._points]
            if self.has_inertia:
                x[self.places["g rate"]] = (rows[2] + R @ rows[3])[self._points]
        return x
