"""Rollouts of what is stepped: by compiled loops, in blocks of the same contact, and one by one."""

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.runtime.contact_blocks import LONGEST_BLOCK, ContactBlocks
from fenics_rom.runtime.obstacle_path import ObstaclePath
from fenics_rom.runtime.steppers.residual_maps import strained_back

if TYPE_CHECKING:
    from fenics_rom.runtime.steppers.compiled_held import HeldStepsTaken
    from fenics_rom.runtime.steppers.compiled_step import StepsTaken

Simulator = Any  # fenics_rom.runtime.simulator's, which imports this file through rollout
LONGEST_LOOP = 1024  # steps of a body that deforms largely, whose shapes are held at once


class SteppedRollout:
    """Takes steps of a body, and reads outputs after some of them.

    It is linear and compiled or among obstacles, or deforms largely. Of the latter the last step is always taken by
    itself: so all that a step leaves behind is that of the last one.
    """

    def __init__(self, body: Simulator) -> None:
        self._body, self._is_linear = body, body.rom.deformation is None
        has_blocks = self._is_linear and body.needs_each_step and not body.needs_single_steps
        self._blocks = ContactBlocks(body) if has_blocks else None
        self._maps: dict[tuple[str, tuple[str, ...]], tuple[Array, Array]] = {}

    def take(self, u: Array, first: int, every: int, names: tuple[str, ...]) -> list[Array]:
        """Takes steps under inputs u (steps, p) with the loads, N; what is read, in rows (times, width).

        Args:
            u: as above.
            first: number of these steps in the rollout.
            every: the outputs of these names are read after every so many of its steps.
        """
        body, blocks, rows, taken = self._body, self._blocks, list[Array](), 0
        self._path = ObstaclePath(body)
        longest, end = (LONGEST_BLOCK, len(u)) if self._is_linear else (LONGEST_LOOP, len(u) - 1)
        if blocks is not None:
            blocks.begin()
        while taken < len(u):
            some = due(every, first + taken)
            if (rolled := self._roll(u[taken : min(taken + longest, end)])) is not None:
                steps, by_q, by_force = rolled.steps, *self._output_maps(names)
                if names:
                    read = steps.q[some] @ by_q
                    rows.append(read + steps.carried[some] @ by_force if steps.carried.shape[1] else read)
                taken += len(steps.q)
                continue
            block = None if blocks is None else blocks.take(u[taken:-1])  # the last step is taken by itself
            if blocks is not None and block is not None:
                kept_map, kept = block
                if names:
                    rows.append(kept.states[1:][some] @ blocks.columns(kept_map, *self._output_maps(names)))
                taken += len(kept.inputs)
                continue
            body.step(u[taken][: body.inputs])
            taken += 1
            if blocks is not None:
                blocks.count()
            if names and (first + taken) % every == 0:
                rows.append(np.concatenate([body.displacement(name).ravel() for name in names])[None])
        return rows

    def _roll(self, u: Array) -> "StepsTaken | HeldStepsTaken | None":
        """Takes steps by compiled loops; None where they take none.

        Where the contact mode follows the obstacles, steps are taken one by one.
        """
        body, environment, path = self._body, self._body.environment, None
        kernel = body.integrator.kernel
        if not (len(u) and kernel.is_compiled) or (environment is not None and environment.mark is not None):
            return None
        if body.integrator.interface is not None:
            ahead = self._path.ahead(u)
            if ahead is None:
                return None
            path, u = ahead[0], u[: ahead[1]]
        names, filling, amounts = body.stroke_names, body.filling, np.zeros(len(body.integrator.reactions))
        if filling is not None:
            amounts = filling.in_order(names, len(amounts))
        taken: StepsTaken | HeldStepsTaken | None = kernel.roll(u, path, amounts)
        if taken is not None:
            if filling is not None:
                filling.resume(dict(zip(names, amounts.tolist(), strict=False)))
            if path is not None:
                self._path.go_on(len(taken.steps.q))
            body.steps += len(taken.steps.q)
            if self._is_linear:
                body.watch(kernel.state[: body.model.order], 2 * kernel.energy, body.time, len(taken.steps.q))
            body.look_at_skin()
        return taken

    def _output_maps(self, names: tuple[str, ...]) -> tuple[Array, Array]:
        """As `output_maps`."""
        asked = self._body.contact, names
        if asked not in self._maps:
            self._maps[asked] = output_maps(self._body, names)
        return self._maps[asked]


def output_maps(body: Simulator, names: tuple[str, ...]) -> tuple[Array, Array]:
    """Displacements of outputs from q (m, width), and from what is carried beyond the basis (3P, width), m/N."""
    rom, residual = body.rom, body.integrator.kernel.residual
    rows = np.concatenate([np.empty((0, rom.basis.shape[1])), *(rom.outputs[name] for name in names)])
    by_force = np.empty((0, len(rows)))
    if residual is not None:
        by_force = strained_back(residual.part, (rows[:, rom.rigid :] / np.sqrt(rom.stiffness[rom.rigid :])).T)
    return (rows @ body.model.coordinates).T, by_force


def due(every: int, taken: int) -> slice:
    """Which of the steps after so many are read, one in every so many."""
    return slice(every - 1 - taken % every, None, every)
