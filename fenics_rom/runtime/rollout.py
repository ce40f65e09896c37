"""Many steps under known inputs at once, as products of matrices.

L steps of one contact mode and step size are one affine map. With the state s = [e, r] at their start, the inputs
U = [u_1, ..., u_L] and the outputs Y,

    s⁺ = [Φᴸ Γ] z,    Y = O z,    supplied = zᵀ S z,    dissipated = zᵀ H z,    z = [s, U].

What comes of the inputs is found for all blocks at once, the state is carried from block to block, and then outputs and
account are read off for all blocks at once. The map of many steps is composed of the maps of few.
"""

import math
from collections.abc import Mapping, Sequence
from itertools import accumulate, pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.arguments import is_number, names_in
from fenics_rom.errors import StepError, check_known, shown
from fenics_rom.mechanics.signals import real_numbers
from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.rom.midpoint_map import checked_dt, matrices

if TYPE_CHECKING:
    from fenics_rom.mechanics.base_path import BaseState
    from fenics_rom.runtime.frame_rollout import FrameRollout
    from fenics_rom.runtime.stepped_rollout import SteppedRollout

Simulator = Any  # fenics_rom.runtime.simulator's, which imports this file

MAX_BLOCK_STEPS = 32  # longer blocks have fewer states to carry, but larger maps
BLOCKS_PER_PRODUCT = 128  # whose z are held at once: what fits the cache
MAX_KEPT_PROPAGATORS = 32  # step sizes that never come back must not pile up


class BlockPropagator(NamedTuple):
    """The map of L steps; S and H are None where no account is kept."""

    length: int  # L
    state: Array  # [Φᴸ Γ] (2m, 2m + p L)
    outputs: Array  # O (rows, 2m + p L), of every instant at which the outputs are read
    supplied: Array | None = None  # S (2m + p L, 2m + p L), J
    dissipated: Array | None = None  # H (2m + p L, 2m + p L), J


def build_step(model: ContactModel, h: float, rows: Array, ledger: bool) -> BlockPropagator:
    """The map of a step of h s; `rows` (R, m) of the outputs that are read after it act on e."""
    m, (state, account) = model.order, matrices(model, h)
    outputs = rows @ state[:m]
    if not ledger:
        return BlockPropagator(1, state, outputs)
    heat, work = account[:m], np.zeros((state.shape[1], state.shape[1]))
    work[2 * m :] = account[m:]
    return BlockPropagator(1, state, outputs, work, heat.T @ heat)


def compose(first: BlockPropagator, second: BlockPropagator, *, silent: bool = False) -> BlockPropagator:
    """The map of one block after the other; `silent`: without the outputs of the first."""
    size, added = first.state.shape[1], second.state.shape[1] - first.state.shape[0]
    lift = np.zeros((second.state.shape[1], size + added))  # of z to the second block's
    lift[: len(first.state), :size] = first.state
    lift[len(first.state) :, size:] = np.eye(added)
    outputs = second.outputs @ lift
    if not silent:
        outputs = np.vstack([np.pad(first.outputs, ((0, 0), (0, added))), outputs])

    def sum_works(of_first: Array | None, of_second: Array | None) -> Array | None:
        if of_first is None or of_second is None:
            return None
        return np.pad(of_first, (0, added)) + lift.T @ of_second @ lift

    return BlockPropagator(
        first.length + second.length,
        second.state @ lift,
        outputs,
        sum_works(first.supplied, second.supplied),
        sum_works(first.dissipated, second.dissipated),
    )


def repeat(block: BlockPropagator, times: int) -> BlockPropagator:
    """The map of a block taken some times, with the outputs of the last one only."""
    if times == 1:
        return block
    half = repeat(block, times // 2)
    whole = compose(half, half, silent=True)
    return compose(whole, block, silent=True) if times % 2 else whole


def build_doubling_blocks(block: BlockPropagator) -> list[BlockPropagator]:
    """A block, twice it, four times it, and so on to the longest one worth having; the longest first."""
    blocks = [block]
    while 2 * blocks[0].length <= MAX_BLOCK_STEPS:
        blocks.insert(0, compose(blocks[0], blocks[0]))
    return blocks


def run_blocks(block: BlockPropagator, state: Array, inputs: Array) -> tuple[Array, Array, float, float]:
    """Takes a block's steps under inputs (times, p L), N, from a state (2m,), overwritten by that at the end.

    Returns:
        The outputs (times, rows), the states at each start (times, 2m), and what was supplied and dissipated, J.
    """
    times, size = len(inputs), len(state)
    propagate, forcing = np.ascontiguousarray(block.state[:, :size]).dot, block.state[:, size:].T
    outputs, states = np.empty((times, len(block.outputs))), np.empty((times + 1, size))
    states[0] = state
    supplied = dissipated = 0.0
    for first in range(0, times, BLOCKS_PER_PRODUCT):
        u = inputs[first : first + BLOCKS_PER_PRODUCT]
        bounds = states[first : first + len(u) + 1]
        for before, after, push in zip(bounds[:-1], bounds[1:], u @ forcing, strict=True):
            propagate(before, after)
            np.add(after, push, after)
        z = np.hstack([bounds[:-1], u])
        np.dot(z, block.outputs.T, out=outputs[first : first + BLOCKS_PER_PRODUCT])
        if block.supplied is not None and block.dissipated is not None:
            supplied += float(np.vdot(z @ block.supplied, z))
            dissipated += float(np.vdot(z @ block.dissipated, z))
    state[:] = states[-1]
    return outputs, states[:-1], supplied, dissipated


class ConstantInterval(NamedTuple):
    """Steps `start` to `stop` in one contact mode, of one size dt, s."""

    start: int
    stop: int
    contact: str
    dt: float


def find_constant_intervals(
    steps: int, contact: str | Sequence[str], dt: float | Sequence[float] | Array
) -> list[ConstantInterval]:
    """The steps between changes of contact mode or step size.

    Raises:
        StepError: one of them is neither one for all steps nor one for each.
    """
    columns = []
    for name, values in (("contact", contact), ("dt", dt)):
        column = np.asarray(values, dtype=object)
        if column.shape not in ((), (steps,)):
            raise StepError(f"{name}: use one for all {steps} steps, or one for each (got {column.shape})")
        columns.append(np.broadcast_to(column, (steps,)))
    if not steps:
        return []
    names, sizes = columns
    changes = np.flatnonzero((names[1:] != names[:-1]) | (sizes[1:] != sizes[:-1])) + 1
    bounds = [0, *map(int, changes), steps]
    return [ConstantInterval(start, stop, names[start], checked_dt(sizes[start])) for start, stop in pairwise(bounds)]


def plan_steps(
    body: Simulator,
    inputs: Sequence[Sequence[float]] | Array | Mapping[str, Any],
    contact: str | Sequence[str] | None,
    dt: float | Sequence[float] | Array | None,
) -> tuple[Array, list[ConstantInterval]]:
    """What was asked for, checked: all inputs (steps, p) of each step, and the intervals of one contact mode and dt.

    Raises:
        StepError: wrong shapes, unknown names, numbers not finite, or a contact mode where obstacles say which.
    """
    rom = body.rom
    if contact is not None and body.switches_itself:
        raise StepError(
            "contact: obstacles say which contact mode is active; use None, or "
            "effects.contact.switching = 'scene' in the scene"
        )
    if isinstance(inputs, Mapping):
        inputs = _by_name(body, inputs, contact)
    try:
        u = real_numbers(inputs)
    except (TypeError, ValueError):
        raise StepError(f"inputs: use (steps, {body.inputs}) real numbers in N") from None
    if u.ndim != 2:
        raise StepError(f"inputs: use (steps, {body.inputs}) numbers in N (got shape {u.shape})")
    if body.takes_actuators_alone and u.shape[1] == sum(rom.actuators.values()):
        u = np.hstack([np.zeros((len(u), body.inputs - u.shape[1])), u])
    bad = np.flatnonzero(~np.isfinite(u).all(axis=1))
    if len(bad):
        raise StepError(f"step {body.steps + bad[0]}: input {u[bad[0]].tolist()} is not finite")
    plan = find_constant_intervals(len(u), body.contact if contact is None else contact, body.dt if dt is None else dt)
    load_columns = sum(rom.loads.values())
    for interval in plan:
        checked_dt(interval.dt)
        check_known("contact mode", interval.contact, rom.contact_models, StepError)
        columns = rom.contact_models[interval.contact].inputs.shape[1] - load_columns
        if u.shape[1] != columns:
            raise StepError(
                f"step {body.steps + interval.start}: inputs of contact mode {interval.contact!r}: use "
                f"(steps, {columns}) numbers in N (got shape {u.shape})"
            )
    environment = body.environment
    if environment is not None:
        steps = np.array([interval.dt for interval in plan for _ in range(interval.start, interval.stop)])
        middles = body.time + np.cumsum(steps) - steps / 2
        u = np.hstack([u, np.array([environment.loads_at(t) for t in middles]).reshape(len(u), load_columns)])
    return u, plan


def check_bases(base: "Sequence[BaseState] | BaseState | None", steps: int) -> None:
    """A StepError where bases are given, but not one of each step."""
    if base is not None and (given := len(getattr(base, "position", base))) != steps:
        raise StepError(f"base: use one for each of {steps} steps (got {given})")


def _by_name(body: Simulator, inputs: Mapping[str, Any], contact: str | Sequence[str] | None) -> Array:
    """Inputs (steps, p) of a mapping by name; what it does not name is 0."""
    mode = contact if isinstance(contact, str) and contact in body.rom.contact_models else body.contact
    columns = {name: n for name, n in body.rom.input_columns(mode).items() if name not in body.rom.loads}
    parts: dict[str, Array] = {}
    for name, values in inputs.items():
        check_known("input", name, columns, StepError)
        try:
            part = real_numbers(values)
        except (TypeError, ValueError):
            part = np.empty(())
        part = part[:, None] if part.ndim == 1 and columns[name] == 1 else part
        if part.ndim != 2 or part.shape[1] != columns[name] or len(part) != len(next(iter(parts.values()), part)):
            raise StepError(
                f"inputs of {name!r}: use (steps, {columns[name]}) real numbers, of as many steps as the others"
            )
        parts[name] = part
    steps = len(next(iter(parts.values()), np.empty(0)))
    return np.hstack([parts.get(name, np.zeros((steps, n))) for name, n in columns.items()])


class Rollout:
    """Takes the steps of `Simulator.rollout` of a body, and keeps the propagators that it made for them."""

    def __init__(self, body: Simulator) -> None:
        self._body = body
        self._propagators: dict[tuple[Any, ...], list[BlockPropagator]] = {}
        self._in_a_frame: FrameRollout | None = None
        self._stepped: SteppedRollout | None = None

    def take(
        self,
        inputs: Sequence[Sequence[float]] | Array | Mapping[str, Any],
        base: "Sequence[BaseState] | BaseState | None",
        contact: str | Sequence[str] | None,
        dt: float | Sequence[float] | Array | None,
        every: int,
        outputs: Sequence[str] | None,
    ) -> dict[str, Array]:
        """As Simulator.rollout."""
        body = self._body
        if not (is_number(every, whole=True) and every >= 1):
            raise StepError(f"every = {shown(every)}: use a whole number of steps, at least 1")
        u, plan = plan_steps(body, inputs, contact, dt)
        check_bases(base, len(u))
        bases = None
        if base is not None:
            from fenics_rom.mechanics.base_path import checked_bases  # here, as few bodies have a base

            bases = checked_bases(base, body.steps)
        names = tuple(body.rom.outputs) if outputs is None else names_in("outputs", outputs, StepError)
        widths = [len(body.output_rows(name)) for name in names]
        start, rows = body.save(), [np.empty((0, sum(widths)))]
        try:
            for interval in plan:
                body.dt = interval.dt
                if contact is not None:
                    body.switch(interval.contact)
                steps = slice(interval.start, interval.stop)
                on, due = None if bases is None else bases[steps], every if names else 1
                if body.reads_reactions:  # of the last step, which is taken by itself
                    rows += self._read(u[steps][:-1], None, interval.start, due, names)
                    rows += self._step_each(u[steps][-1:], None, interval.stop - 1, due, names)
                else:
                    rows += self._read(u[steps], on, interval.start, due, names)
                body.tensions.note_all(u[steps])
        except BaseException:
            body.restore(start)
            raise
        parts = np.split(np.concatenate(rows), list(accumulate(widths))[:-1], axis=1) if names else []
        return {name: body.rom.by_point(values) for name, values in zip(names, parts, strict=True)}

    def _read(self, u: Array, bases: Array | None, taken: int, every: int, names: tuple[str, ...]) -> list[Array]:
        """Takes the steps of one interval, `taken` steps after the rollout began; what is read, in rows.

        bases: (steps, 13), or None where none are given.
        """
        body = self._body
        if body.remembers_touch or body.beside is not None:
            return self._step_each(u, bases, taken, every, names)
        if body.takes_compiled_steps and (bases is None or body.is_carried):
            if self._in_a_frame is None:
                from fenics_rom.runtime.frame_rollout import FrameRollout  # here, as few bodies move in a frame

                self._in_a_frame = FrameRollout(body)
            return self._in_a_frame.take(u, bases, taken, every, names)
        is_known = bases is None and not body.notes_each_step
        is_found = body.needs_each_step and not body.needs_single_steps  # by contact forces alone
        if is_known and (body.steps_in_loops or is_found):
            return self._step_or_roll(u, taken, every, names)
        is_map = is_known and not (body.needs_single_steps or body.relaxes)
        if not is_map or body.rom.rigid:  # there is more than energy coordinates hold
            return self._step_each(u, bases, taken, every, names)
        with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is told as a StepError
            return self._read_known(u, taken, every, names)

    def _step_or_roll(self, u: Array, taken: int, every: int, names: tuple[str, ...]) -> list[Array]:
        """The same of a body that has to be stepped: by loops, in blocks or one by one."""
        if self._stepped is None:
            from fenics_rom.runtime.stepped_rollout import SteppedRollout  # here, as few bodies need it

            self._stepped = SteppedRollout(self._body)
        return self._stepped.take(u, taken, every, names)

    def _read_known(self, u: Array, taken: int, every: int, names: tuple[str, ...]) -> list[Array]:
        """The same where nothing touches the body."""
        rows = list[Array]()
        while len(u):
            due = every - taken % every  # steps until the outputs are due
            if due == every <= min(MAX_BLOCK_STEPS, len(u)):
                steps = len(u) - len(u) % every
                rows += self._blocks(u[:steps], every, names)
            else:
                steps = min(due, len(u))
                self._blocks(u[:steps], 1, ())
                if steps == due:
                    rows.append(self._outputs(names))
            u, taken = u[steps:], taken + steps
        return rows

    def _step_each(self, u: Array, bases: Array | None, taken: int, every: int, names: tuple[str, ...]) -> list[Array]:
        """The same by `step`."""
        from fenics_rom.mechanics.base_path import base_in  # here, as few bodies have a base

        body, rows = self._body, list[Array]()
        for k, row in enumerate(u):  # its loads act by themselves
            body.step(row[: body.inputs], base=None if bases is None else base_in(bases[k]))
            if names and (taken + k + 1) % every == 0:
                rows.append(self._outputs(names))
        return rows

    def _outputs(self, names: tuple[str, ...]) -> Array:
        """What outputs show now, (1, rows)."""
        return np.concatenate([self._body.displacement(name).ravel() for name in names])[None]

    def _blocks(self, u: Array, every: int, names: tuple[str, ...]) -> list[Array]:
        """Takes steps in the longest blocks that fit; what is read, a row for each instant."""
        body, propagators = self._body, self._propagators_of(every, names)
        rows, state = [], body.energy_coordinates
        width, order = len(propagators[-1].outputs), len(state) // 2
        for block in propagators:
            times = len(u) // block.length
            steps = times * block.length
            if times:
                outputs, starts, *work = run_blocks(block, state, u[:steps].reshape(times, -1))
                if not math.isfinite(state.dot(state)):
                    raise StepError(f"steps from {body.steps} on: the inputs are so large that the steps overflow")
                if body.ledger is not None:
                    body.ledger.book(supplied=work[0], dissipated=work[1])
                squares = np.einsum("bs,bs->b", starts, starts)
                highest = int(squares.argmax())
                body.watch(starts[highest, :order], squares[highest], body.time + highest * block.length * body.dt)
                body.steps += steps
                if body.errors is not None:
                    body.errors.note(body.contact, body.dt, u[:steps])
                rows.append(outputs.reshape(steps // every, width))
                u = u[steps:]
        return rows

    def _propagators_of(self, every: int, names: tuple[str, ...]) -> list[BlockPropagator]:
        body = self._body
        key = body.contact, body.dt, every, names
        if key not in self._propagators:
            if len(self._propagators) >= MAX_KEPT_PROPAGATORS:
                self._propagators.clear()
            model = body.rom.contact_models[body.contact]
            ω = np.sqrt(model.eigenvalues)
            rows = np.concatenate([np.empty((0, model.order)), *(body.output_rows(name) / ω for name in names)])
            single = build_step(model, body.dt, rows, body.ledger is not None)
            self._propagators[key] = build_doubling_blocks(repeat(single, every))
        return self._propagators[key]
