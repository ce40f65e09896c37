"""Rollouts of a body in a moving frame: steps in a row by compiled functions, and the others one by one."""

from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.base_path import base_in
from fenics_rom.mechanics.frame_motion import rotation_matrices
from fenics_rom.runtime.obstacle_path import ObstaclePath
from fenics_rom.runtime.stepped_rollout import output_maps
from fenics_rom.runtime.steppers.compiled_frame import FrameSteps

Simulator = Any  # fenics_rom.runtime.simulator's, which imports this file through rollout
LONGEST_BLOCK = 4096  # steps, whose shapes are held at once


class FrameRollout:
    """Takes steps of a body, and reads outputs after some of them."""

    def __init__(self, body: Simulator) -> None:
        self._body = body

    def take(self, u: Array, bases: Array | None, first: int, every: int, names: tuple[str, ...]) -> list[Array]:
        """Takes steps under inputs u (steps, p) with the loads; what is read, in rows (times, width).

        Args:
            u: as above.
            bases: at the end of each step, (steps, 13); None: as the environment says, or at rest.
            first: number of these steps in the rollout.
            every: the outputs of these names are read after every so many of its steps.
        """
        body, rows, taken = self._body, list[Array](), 0
        self._path = ObstaclePath(body)
        bends_among = body.rom.deformation is not None and body.integrator.interface is not None
        end = len(u) - 1 if bends_among else len(u)  # the last step is by itself: all that it leaves behind is its own
        while taken < len(u):
            block = slice(taken, min(taken + LONGEST_BLOCK, end))
            steps = self._roll(u[block], None if bases is None else bases[block]) if taken < end else None
            if steps is not None:
                if names:
                    due = slice(every - 1 - (first + taken) % every, None, every)
                    rows.append(self._read(steps, due, names))
                taken += len(steps.steps.q)
                continue
            body.step(u[taken][: body.inputs], base=None if bases is None else base_in(bases[taken]))
            taken += 1
            if names and (first + taken) % every == 0:
                rows.append(np.concatenate([body.displacement(name).ravel() for name in names])[None])
        return rows

    def _roll(self, u: Array, bases: Array | None) -> FrameSteps | None:
        """Takes steps by compiled functions; None where they take none.

        Where the contact mode follows the obstacles, steps are taken one by one.
        """
        body, kernel, environment, path = self._body, self._body.integrator.kernel, self._body.environment, None
        if body.integrator.interface is not None:
            ahead = self._path.ahead(u)
            if ahead is None:
                return None
            path, u, bases = ahead[0], u[: ahead[1]], None if bases is None else bases[: ahead[1]]
        if bases is None and body.is_carried:
            bases = environment.bases_at(body.time + body.dt * np.arange(1, len(u) + 1))
        taken: FrameSteps | None = kernel.roll(u, bases, path)
        if taken is None:
            return None
        count = len(taken.steps.q)
        if path is not None:
            self._path.go_on(count)
        time, body.steps = body.time, body.steps + count
        environment.loads = u[count - 1, u.shape[1] - len(environment.loads) :]
        e = taken.steps.q * body.model.safe_frequencies
        squares = np.einsum("nm,nm->n", e, e)
        highest = int(squares.argmax())
        body.watch(e[highest], squares[highest], time + highest * body.dt, count)
        body.look_at_skin()
        return taken

    def _read(self, taken: FrameSteps, due: slice, names: tuple[str, ...]) -> Array:
        """Displacements of outputs in world axes, (times, width)."""
        body = self._body
        by_q, by_force = output_maps(body, names)
        places = np.concatenate([body.rom.moving_frame.output_points[name] for name in names])
        q, poses = taken.steps.q[due], taken.steps.poses[due]
        moved = q @ by_q + taken.carried[due] @ by_force if taken.carried.shape[1] else q @ by_q
        seen = places - body.rom.moving_frame.origin + moved.reshape(len(q), -1, 3)
        moved = np.matmul(seen, rotation_matrices(poses[:, 3:]).transpose(0, 2, 1)) + poses[:, None, :3] - places
        read: Array = moved.reshape(len(q), -1)
        return read
