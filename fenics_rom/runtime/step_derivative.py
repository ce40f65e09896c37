"""The derivative of a body's step with the state that it begins with, and with its inputs.

By the adjoint of the step, where its kernel has one (`steppers/adjoint.py`): a row of [A B] is what one number of the
state after the step owes to all that went into it. Else by differences of the steps themselves, on both sides; as steps
are found to round-off, and are linear between their kinks or smooth, these are right to some 1e-8.

A kink, where a contact pair is about to touch or to slip, or a cable to get slack, has a derivative to each side: that
which the adjoint's step found, or towards which the number grows.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StructureError
from fenics_rom.runtime.simulator import Simulator
from fenics_rom.runtime.step_state import StepState
from fenics_rom.runtime.steppers.adjoint import Reads, StateAdjoint

SMALL = 1e-4  # of the motion: by so much are states and inputs moved for differences
LEAST_MARGIN = 1e-4  # of the velocities that contact forces stop: round-off is less
RESTS, LEANS = 1e-3, 1e-2  # of the velocities that contact forces stop: what rests, and how fast it is approached
KINK, ROUND_OFF = 1e-5, 1e-10  # what differences on both sides may differ by: relative, and of what is usual


class StepDerivative(NamedTuple):
    """A step, linearised."""

    after: Array  # (s,)
    A: Array
    B: Array  # (s, p) with columns of all loads
    kinks: list[str]  # what is about to change


class _Room(NamedTuple):
    """How far a contact point may be moved, and by how much faster, so that no pair does something else."""

    speed: float  # m/s; infinite where nothing touches, as is the next
    way: float  # m

    @classmethod
    def of(cls, speed: float, gap: float, h: float) -> "_Room":
        """With a margin of ten, of the least that a pair has to another law, in steps of h s."""
        return cls(speed / 10, max(speed * h, gap) / 10)


def differentiate_step(state: StepState, u: Array, loads: Array) -> StepDerivative:
    """Of the step from a state under inputs (p,) and loads, N."""
    room = _lean(state.body, state, u)
    return _by_adjoint(state, u, loads) or _by_differences(state, u, loads, room)


def guides_of(body: Simulator) -> Sequence[str]:
    """Loads that are found in a step."""
    return () if body.environment is None else tuple(body.environment.environment.guides)


def _lean(body: Simulator, state: StepState, u: Array) -> _Room:
    """Lets obstacles approach pairs that rest, so slowly that nothing else changes.

    A pair is to have -e times its approach, if it approaches, and is let go, if it leaves: at rest the law has a kink
    between; and another, where friction that would do work asks for less. With obstacles that approach, and move as
    friction pushes, all pairs have the derivative of those that stay as they are.
    """
    interface = body.integrator.interface
    if interface is None or body.environment is None:
        return _Room(np.inf, np.inf)
    state.put(state.x)
    body.step(u)
    solved, environment, law = interface.solver.last_step()[1], body.environment, interface.solver.law
    contact = body.integrator.contact
    state.put(state.x)
    if solved is None or contact is None:
        return _Room(np.inf, np.inf)
    speed, gap = float(np.abs(solved.problem.q).max()), float(np.abs(solved.gaps[solved.active]).min())
    if law.stiffness is not None or solved.quasi_static:
        return _Room.of(LEANS * speed, gap, body.dt)
    slowest = float(np.abs(solved.pairs.relative[0][solved.active]).min())
    if slowest > RESTS * speed or law.restitution == 1.0:
        return _Room.of(min(slowest, LEANS * speed), gap, body.dt)
    pressing = np.einsum("ca,ca->c", contact.pair_forces, contact.normals)[:, None] * contact.normals
    rubbing, margin = contact.pair_forces - pressing, LEANS * speed
    for k, (name, offset) in enumerate(zip(environment.obstacles, environment.state.offsets, strict=True)):
        of_this, moved = contact.pairs // len(contact.forces) == k, np.zeros(3)
        for forces in (pressing[of_this], rubbing[of_this]):
            whole = forces.sum(axis=0)
            if (size := float(np.linalg.norm(whole))) > 0:
                moved += LEANS * speed * body.dt / size * whole
        body.set_signal(name, offset + moved)
    if (rubs := float(np.linalg.norm(rubbing, axis=1).sum())) > 0:
        margin *= float(np.linalg.norm(rubbing.sum(axis=0))) / rubs
    return _Room.of(max(margin, LEAST_MARGIN * speed), gap, body.dt)


def _by_adjoint(state: StepState, u: Array, loads: Array) -> StepDerivative | None:
    """By the adjoint of the step; None where there is none."""
    body = state.body
    try:
        body.integrator.kernel.check_differentiable()
    except StructureError:
        return None
    state.put(state.x)
    q, r = body.state
    body.step(u)
    kernel, after = body.integrator.kernel, state.read()
    taken = kernel.adjoint(np.concatenate([u, loads]))
    nothing = Reads(np.zeros(len(q)), np.zeros(len(body.rom.stiffness) - body.rom.rigid), 0.0)
    rows_of = 0 if kernel.residual is None else kernel.residual.state.size
    A, B = np.empty((len(after), len(after))), np.empty((len(after), len(u) + len(loads)))
    for k, unit in enumerate(np.eye(len(after))):
        seed, rows, rigid = state.spread(unit)
        auxiliary = np.zeros(len(kernel.auxiliary))
        auxiliary[len(auxiliary) - rows_of :] = rows.ravel()
        before, by_inputs, _, _ = taken.pull_back(StateAdjoint(seed, rigid, auxiliary), nothing)
        by_rows = before.auxiliary[len(before.auxiliary) - rows_of :].reshape(4, -1) if rows_of else np.empty((4, 0))
        A[k] = state.gather(*kernel.start_pulled_back(q, r, before), by_rows)
        B[k] = by_inputs
    return StepDerivative(after, A, B, ["a contact point"] if taken.is_kink else [])


def _by_differences(state: StepState, u: Array, loads: Array, room: _Room) -> StepDerivative:
    """By steps from states, and under inputs, that are nearby."""
    body, p, columns = state.body, len(u), dict[int, tuple[str, int]]()
    column = p
    for name, width in body.rom.loads.items():
        columns |= {column + k: (name, k) for k in range(width) if name not in guides_of(body)}
        column += width

    def step(x: Array, v: Array) -> Array:
        state.put(x)
        for name, _ in columns.values():
            values = [v[c] for c, (load, _) in columns.items() if load == name]
            body.set_signal(name, np.array(values))
        body.step(v[:p])
        return state.read()

    v0 = np.concatenate([u, loads])
    after, kinks = step(state.x, v0), list[str]()
    sizes, by_state, by_input = _reaches(state, after, columns, room)
    A, B = np.empty((len(after), len(after))), np.zeros((len(after), len(v0)))
    names = list(state.names)
    for k, δ in enumerate(by_state):
        A[:, k], is_kink = _slope(lambda x: step(x, v0), state.x, k, δ, after, sizes)
        kinks += [names[k]] * is_kink
    for k, δ in by_input.items():
        B[:, k], is_kink = _slope(lambda v: step(state.x, v), v0, k, δ, after, sizes)
        kinks += [f"input {k}"] * is_kink
    return StepDerivative(after, A, B, kinks)


def _slope(f: Any, at: Array, k: int, δ: float, there: Array, sizes: Array) -> tuple[Array, bool]:
    """The derivative of f with one of its numbers, and whether that is another one to each side."""

    def moved(share: float) -> Array:
        near = at.copy()
        near[k] += share * δ
        value: Array = f(near)
        return value - there

    whole, half, back, back_half = moved(1.0), moved(0.5), moved(-1.0), moved(-0.5)
    forward, backward = (4 * half - whole) / δ, (back - 4 * back_half) / δ
    apart, size = np.abs(forward - backward), max(np.abs(forward).max(), np.abs(backward).max())
    if ((apart > KINK * size) & (δ * apart > ROUND_OFF * sizes)).any():
        return forward, True
    return (8 * (half - back_half) - (whole - back)) / (6 * δ), False


def _reaches(
    state: StepState, after: Array, columns: dict[int, tuple[str, int]], room: _Room
) -> tuple[Array, Array, dict[int, float]]:
    """How large numbers of the state are (s,), and by how much they, and inputs by their column, are moved."""
    body, places, h = state.body, state.places, state.body.dt
    kernel, rom, (slow, near) = body.integrator.kernel, body.rom, room
    moving = np.concatenate([state.x[places[part]] for part in ("e", "r") if part in places])
    gone = np.concatenate([(after - state.x)[places[part]] for part in ("e", "r") if part in places])
    mass, length = float(rom.node_mass.sum()) or 1.0, float(np.ptp(rom.nodes, axis=0).max()) if len(rom.nodes) else 1.0
    ω1 = 2 * np.pi * rom.first_frequency
    least = 1e-6 * ω1 * length * np.sqrt(mass)
    motion = SMALL * max(float(np.linalg.norm(moving)), float(np.linalg.norm(gone)), least)
    size, most, farthest = np.full(len(state.x), motion), np.full(len(state.x), np.inf), 1.0
    if body.integrator.interface is not None:
        rows = body.integrator.interface.rows @ body.model.coordinates
        farthest = float(np.linalg.norm(rows.reshape(-1, 3, rows.shape[1]), axis=(1, 2)).max()) or 1.0
    ω = body.model.safe_frequencies
    most[places["e"]] = near * ω / farthest
    if "r" in places:
        most[places["r"]] = slow / farthest
    if kernel.residual is not None and len(state.x[places["g"]]):
        yields = float(np.abs(kernel.residual.part.compliance).max())
        contact = body.integrator.contact
        forces = [np.abs(state.x[places["g"]]).max(), 0.0 if contact is None else np.abs(contact.forces).max()]
        force = SMALL * float(max(*forces, 1e-9))
        for part in ("g", "g branches"):
            if part in places:
                size[places[part]], most[places[part]] = force, near / yields
        if "g rate" in places:
            size[places["g rate"]], most[places["g rate"]] = force / h, slow / yields
    if "b" in places and rom.deformation is not None:
        size[places["b"]] = SMALL * max(float(np.abs(state.x[places["b"]]).max()), 1e-3)
    if "pose" in places:
        v_most, ω_most = np.abs(state.x[places["pose"]].reshape(4, 3)[2:]).max(axis=1)
        speed = motion / np.sqrt(mass)
        sizes = [SMALL * length, SMALL, max(speed, SMALL * v_most), max(speed / length, SMALL * ω_most)]
        size[places["pose"]] = np.repeat(sizes, 3)
        most[places["pose"]] = np.repeat([near, near / length, slow, slow / length], 3)
    pushes, inputs = np.linalg.norm(body.model.inputs, axis=0), dict[int, float]()
    strokes = _stroke_columns(body)
    for k in [*range(body.inputs), *columns]:
        push = float(pushes[k]) or 1.0
        fast = min(motion, slow / farthest)
        inputs[k] = motion * push / ω1**2 if k in strokes else fast / (h * push)
    return size / SMALL, np.minimum(size, most), inputs


def _stroke_columns(body: Simulator) -> list[int]:
    """Columns of inputs that are strokes."""
    controls, starts = {} if body.environment is None else body.environment.environment.controls, body.input_slices()
    return [starts[name].start for name in body.rom.actuators if name in controls]
