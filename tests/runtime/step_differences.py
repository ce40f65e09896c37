"""The derivative of a step by differences of steps from states and under inputs nearby, to judge what adjoints tell.

On both sides, at two distances; as steps are found to round-off, and are linear between their kinks or smooth, these
are right to some 1e-8. At a kink it is the derivative to the side towards which a number grows.
"""

from typing import Any, NamedTuple

import numpy as np

from fenics_rom.runtime.simulator import Simulator
from fenics_rom.runtime.step_derivative import StepDerivative, found_loads, lean_on
from fenics_rom.runtime.step_state import StepState

Array = np.ndarray

SMALL = 1e-4  # of the motion: by so much are states and inputs moved
LEAN = 1e-5  # enough to move points by a tenth of it; halved, what it does to points that slip slowly is taken out
REACH = 1e-4  # of the velocities that contact forces stop: by how much faster points are moved at most
LEAST_STRAIGHT = 1e-2  # of the forces of friction: their resultant, which obstacles move along
KINK, ROUND_OFF = 1e-5, 1e-10  # what differences on both sides may differ by: relative, and of what is usual


class Room(NamedTuple):
    """How far a contact point may be moved, and by how much faster, so that no pair does something else."""

    speed: float  # m/s; infinite where nothing touches, as is the next
    way: float  # m
    push: float = np.inf  # m/s: the same in the middle of a step, by what acts in it
    lean: float = 0.0  # of obstacles, of the velocities that contact forces stop

    @classmethod
    def of(cls, speed: float, gap: float, h: float, push: float, lean: float = 0.0) -> "Room":
        """With a margin of ten, of the least that a pair has to another law, in steps of h s."""
        return cls(speed / 10, max(speed * h, gap) / 10, push / 10, lean)


def room_of(state: StepState, u: Array, lean: float) -> Room:
    """Where obstacles lean on what rests."""
    found, interface = lean_on(state, u, lean), state.body.integrator.interface
    if found is None:
        return Room(np.inf, np.inf)
    touch, lean, approaches, slides, straight = found
    most, h = REACH * touch.speed, state.body.dt
    if interface.solver.law.stiffness is not None or touch.is_static:
        return Room.of(most, touch.gap, h, most)
    speed = lean * touch.speed
    push = max(straight, LEAST_STRAIGHT) * speed if slides else touch.sliding if lean else np.inf
    least = min(speed if approaches else touch.approach, push)
    used = lean if approaches or slides else 0.0
    return Room.of(min(least, most), touch.gap, h, min(push, most), used)


def differ_steps(state: StepState, u: Array, loads: Array) -> StepDerivative:
    """Of the step from a state under inputs (p,) and loads, N."""
    differences = Differences(state, u, loads)
    by_inputs, kinks = differences.by_inputs(room_of(state, u, 0.0))
    after, room = differences.after, room_of(state, u, LEAN)
    by_state, others = differences.by_state(room)
    if room.lean:
        half, _ = differences.by_state(room_of(state, u, room.lean / 2))
        by_state = 2 * half - by_state
    return StepDerivative(after, by_state, by_inputs, kinks + others)


class Differences:
    """Of steps from states, and under inputs, that are nearby; `after` is the state that the step leads to."""

    def __init__(self, state: StepState, u: Array, loads: Array):
        self._state, self._p, self._v, column = state, len(u), np.concatenate([u, loads]), len(u)
        self._columns: dict[int, tuple[str, int]] = {}  # of loads that act by themselves
        for name, width in state.body.rom.loads.items():
            if name not in found_loads(state.body):
                self._columns |= {column + k: (name, k) for k in range(width)}
            column += width
        self.after = self._step(state.x, self._v)

    def _step(self, x: Array, v: Array) -> Array:
        self._state.put(x)
        for name, _ in self._columns.values():
            values = [v[c] for c, (load, _) in self._columns.items() if load == name]
            self._state.body.set_signal(name, np.array(values))
        self._state.body.step(v[: self._p])
        return self._state.read()

    def by_state(self, room: Room) -> tuple[Array, list[str]]:
        """A, and what is at a kink."""
        x, after, kinks = self._state.x, self._step(self._state.x, self._v), list[str]()
        sizes, reach, _ = _reaches(self._state, after, self._columns, room)
        A = np.empty((len(after), len(after)))
        for k, name in enumerate(self._state.names):
            A[:, k], is_kink = _slope(lambda x: self._step(x, self._v), x, k, reach[k], after, sizes)
            kinks += [name] * is_kink
        return A, kinks

    def by_inputs(self, room: Room) -> tuple[Array, list[str]]:
        """B, and what is at a kink."""
        x, after, kinks = self._state.x, self._step(self._state.x, self._v), list[str]()
        sizes, _, reach = _reaches(self._state, after, self._columns, room)
        B = np.zeros((len(after), len(self._v)))
        for k, δ in reach.items():
            B[:, k], is_kink = _slope(lambda v: self._step(x, v), self._v, k, δ, after, sizes)
            kinks += [f"input {k}"] * is_kink
        return B, kinks


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
    state: StepState, after: Array, columns: dict[int, tuple[str, int]], room: Room
) -> tuple[Array, Array, dict[int, float]]:
    """How large numbers of the state are (s,), and by how much they, and inputs by their column, are moved."""
    body, places, h = state.body, state.places, state.body.dt
    kernel, rom, (slow, near, pushed, _) = body.integrator.kernel, body.rom, room
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
        fast = min(motion, pushed / farthest)
        inputs[k] = motion * push / ω1**2 if k in strokes else fast / (h * push)
    return size / SMALL, np.minimum(size, most), inputs


def _stroke_columns(body: Simulator) -> list[int]:
    """Columns of inputs that are strokes."""
    controls, starts = {} if body.environment is None else body.environment.environment.controls, body.input_slices()
    return [starts[name].start for name in body.rom.actuators if name in controls]
