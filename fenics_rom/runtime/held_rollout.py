"""Rollouts of a held body that deforms largely: steps in a row by compiled functions, and the others one by one."""

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.runtime.contact_rollout import due, output_maps

if TYPE_CHECKING:
    from fenics_rom.runtime.steppers.compiled_held import HeldStepsTaken

Simulator = Any  # fenics_rom.runtime.simulator's, which imports this file through rollout
LONGEST_BLOCK = 1024  # steps, whose shapes are held at once


class HeldRollout:
    """Takes steps of a body, and reads outputs after some of them. The last one is always taken by itself.

    So all that a step leaves behind is that of the last one.
    """

    def __init__(self, body: Simulator) -> None:
        self._body = body
        self._outputs: dict[tuple[str, tuple[str, ...]], tuple[Array, Array]] = {}

    def take(self, u: Array, first: int, every: int, names: tuple[str, ...]) -> list[Array]:
        """Takes steps under inputs u (steps, p) with the loads; what is read, in rows (times, width).

        Args:
            u: as above.
            first: number of these steps in the rollout.
            every: the outputs of these names are read after every so many of its steps.
        """
        body, rows, taken = self._body, list[Array](), 0
        while taken < len(u):
            rolled = self._roll(u[taken : min(taken + LONGEST_BLOCK, len(u) - 1)])
            if rolled is not None:
                if names:
                    rows.append(self._read(rolled, due(every, first + taken), names))
                taken += len(rolled.steps.q)
                continue
            body.step(u[taken][: body.inputs])
            taken += 1
            if names and (first + taken) % every == 0:
                rows.append(np.concatenate([body.displacement(name).ravel() for name in names])[None])
        return rows

    def _roll(self, u: Array) -> "HeldStepsTaken | None":
        """Takes steps by compiled functions; None where they take none.

        Where the contact mode follows the obstacles, steps are taken one by one.
        """
        body, environment, obstacles = self._body, self._body.environment, None
        if not len(u) or (environment is not None and environment.mark is not None):
            return None
        if body.integrator.interface is not None:
            if environment is None or not environment.stands_still or body.switches_itself:
                return None
            obstacles = environment.step_input(u[0][: body.inputs], body.time, body.dt).obstacles
        taken: HeldStepsTaken | None = body.integrator.kernel.roll(u, obstacles)
        if taken is not None:
            body.steps += len(taken.steps.q)
            body.look_at_skin()
        return taken

    def _read(self, taken: "HeldStepsTaken", some: slice, names: tuple[str, ...]) -> Array:
        """Displacements of outputs after some of the steps, (times, width)."""
        asked = self._body.contact, names
        if asked not in self._outputs:
            self._outputs[asked] = output_maps(self._body, names)
        (by_q, by_force), carried = self._outputs[asked], taken.steps.carried[some]
        read: Array = taken.steps.q[some] @ by_q
        return read + carried @ by_force if carried.shape[1] else read
