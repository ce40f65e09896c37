"""Many steps under inputs that are known beforehand, taken as products of matrices."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from fenics_rom.errors import StepError, unknown
from fenics_rom.runtime.rollout import (
    MAX_BLOCK_STEPS,
    BlockPropagator,
    ConstantInterval,
    build_doubling_blocks,
    build_step,
    find_constant_intervals,
    repeat,
    run_blocks,
)
from fenics_rom.runtime.steppers.midpoint import checked_dt

Array = np.ndarray
Simulator = Any  # fenics_rom.runtime.simulator's, which imports this file

MAX_KEPT_PROPAGATORS = 32  # step sizes that never come back must not pile up


class KnownInputs:
    """Takes the steps of `Simulator.rollout`, and keeps the propagators that it made for them."""

    def __init__(self) -> None:
        self._propagators: dict[tuple[Any, ...], list[BlockPropagator]] = {}

    def rollout(
        self,
        body: Simulator,
        inputs: Sequence[Sequence[float]] | Array,
        contact: str | Sequence[str] | None,
        dt: float | Sequence[float] | Array | None,
        every: int,
        outputs: Sequence[str] | None,
    ) -> dict[str, Array]:
        """As Simulator.rollout."""
        if body.rom.deformation is not None:
            raise StepError("rollout: is for linear models; with large deformation take each step by itself")
        if body.needs_each_step:
            raise StepError("rollout: is for known forces; among obstacles or without inertia take each step by itself")
        if not (isinstance(every, int | np.integer) and every >= 1):
            raise StepError(f"every = {every!r}: allowed is a whole number of steps, at least 1")
        u, plan = self._plan(body, inputs, contact, dt)
        names = tuple(body.rom.outputs if outputs is None else outputs)
        widths = [len(body.reading(name)) for name in names]
        start, rows = body.save(), [np.empty((0, sum(widths)))]
        try:
            with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is told as a StepError
                for interval in plan:
                    body.dt = interval.dt
                    body.switch(interval.contact)
                    interval_inputs = u[interval.start : interval.stop]
                    self._take(body, interval_inputs, interval.start, every if names else 1, names, rows)
        except BaseException:
            body.restore(start)
            raise
        parts = np.split(np.concatenate(rows), np.cumsum(widths)[:-1], axis=1) if names else []
        return {name: body.rom.by_point(values) for name, values in zip(names, parts, strict=True)}

    def _plan(
        self,
        body: Simulator,
        inputs: Sequence[Sequence[float]] | Array,
        contact: str | Sequence[str] | None,
        dt: float | Sequence[float] | Array | None,
    ) -> tuple[Array, list[ConstantInterval]]:
        """What was asked for, checked: all inputs of each step, and the intervals of one contact mode and dt."""
        rom, u = body.rom, np.asarray(inputs, dtype=float)
        if u.ndim != 2:
            raise StepError(f"inputs: allowed are (steps, {body.inputs}) numbers in N, given: shape {u.shape}")
        bad = np.flatnonzero(~np.isfinite(u).all(axis=1))
        if len(bad):
            raise StepError(f"step {body.steps + bad[0]}: input {u[bad[0]].tolist()} is not finite")
        plan = find_constant_intervals(
            len(u), body.contact if contact is None else contact, body.dt if dt is None else dt
        )
        load_columns = sum(rom.loads.values())
        for interval in plan:
            checked_dt(interval.dt)
            if interval.contact not in rom.contact_models:
                raise StepError(unknown("contact mode", interval.contact, rom.contact_models))
            columns = rom.contact_models[interval.contact].inputs.shape[1] - load_columns
            if u.shape[1] != columns:
                raise StepError(
                    f"step {body.steps + interval.start}: inputs of contact mode {interval.contact!r}: allowed are "
                    f"(steps, {columns}) numbers in N, given: shape {u.shape}"
                )
        environment = body.environment
        if environment is not None:
            steps = np.concatenate([np.full(interval.stop - interval.start, interval.dt) for interval in plan])
            middles = body.time + np.cumsum(steps) - steps / 2
            u = np.hstack([u, np.array([environment.loads_at(t) for t in middles]).reshape(len(u), load_columns)])
        return u, plan

    def _take(
        self, body: Simulator, u: Array, taken: int, every: int, names: tuple[str, ...], rows: list[Array]
    ) -> None:
        """Takes the steps of one interval, `taken` steps after the rollout began, and adds what is read to `rows`."""

        def read() -> Array:
            q = body.state[0]
            return np.concatenate([body.reading(name) @ q for name in names])[None]

        if body.rom.rigid:  # outputs follow what energy coordinates do not hold
            for count, row in enumerate(u, start=taken + 1):
                body.step(row[: body.inputs])  # its loads act by themselves
                if names and count % every == 0:
                    rows.append(read())
            return
        while len(u):
            due = every - taken % every  # steps until the outputs are due
            if due == every <= min(MAX_BLOCK_STEPS, len(u)):
                steps = len(u) - len(u) % every
                rows += self._blocks(body, u[:steps], every, names)
            else:
                steps = min(due, len(u))
                self._blocks(body, u[:steps], 1, ())
                if steps == due:
                    rows.append(read())
            u, taken = u[steps:], taken + steps

    def _blocks(self, body: Simulator, u: Array, every: int, names: tuple[str, ...]) -> list[Array]:
        """Takes steps in the longest blocks that fit; what is read, a row for each instant."""
        propagators = self._propagators_of(body, every, names)
        rows, state = [], body.energy_coordinates
        width, order = len(propagators[-1].outputs), len(state) // 2
        for block in propagators:
            times = len(u) // block.length
            steps = times * block.length
            if times:
                outputs, starts, *work = run_blocks(block, state, u[:steps].reshape(times, -1))
                if not math.isfinite(state.dot(state)):
                    raise StepError(f"steps from {body.steps} on: the inputs lead out of the finite numbers")
                if body.ledger is not None:
                    body.ledger.book(supplied=work[0], dissipated=work[1])
                squares = np.einsum("bs,bs->b", starts, starts)
                highest = int(squares.argmax())
                body.watch(starts[highest, :order], squares[highest], body.time + highest * block.length * body.dt)
                body.steps += steps
                rows.append(outputs.reshape(steps // every, width))
                u = u[steps:]
        return rows

    def _propagators_of(self, body: Simulator, every: int, names: tuple[str, ...]) -> list[BlockPropagator]:
        key = body.contact, body.dt, every, names
        if key not in self._propagators:
            if len(self._propagators) >= MAX_KEPT_PROPAGATORS:
                self._propagators.clear()
            model = body.rom.contact_models[body.contact]
            ω = np.sqrt(model.eigenvalues)
            rows = np.concatenate([np.empty((0, model.order)), *(body.reading(name) / ω for name in names)])
            single = build_step(model, body.dt, rows, body.ledger is not None)
            self._propagators[key] = build_doubling_blocks(repeat(single, every))
        return self._propagators[key]
