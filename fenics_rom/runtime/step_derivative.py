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
from fenics_rom.runtime.steppers.adjoint import Reads

SMALL = 1e-4  # of the motion: by so much are states and inputs moved for differences
# How fast what rests is approached, of the velocities that contact forces stop: for adjoints more than round-off, for
# differences enough to move points by a tenth of it; halved, what it does to points that slip slowly is taken out.
LEAN_OF_ADJOINTS, LEAN_OF_DIFFERENCES, LEAST_LEAN = 1e-9, 1e-5, 1e-9
REACH = 1e-4  # of them: by how much faster points are moved at most
LEAST_STRAIGHT = 1e-2  # of the forces of friction: their resultant, which obstacles move along
SLIPS = 1e-9  # of the cone: what is nearer to its border slips
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
    push: float = np.inf  # m/s: the same in the middle of a step, by what acts in it
    lean: float = 0.0  # of obstacles, of the velocities that contact forces stop

    @classmethod
    def of(cls, speed: float, gap: float, h: float, push: float, lean: float = 0.0) -> "_Room":
        """With a margin of ten, of the least that a pair has to another law, in steps of h s."""
        return cls(speed / 10, max(speed * h, gap) / 10, push / 10, lean)


def differentiate_step(state: StepState, u: Array, loads: Array) -> StepDerivative:
    """Of the step from a state under inputs (p,) and loads, N."""
    body = state.body
    try:
        body.integrator.kernel.check_differentiable()
    except StructureError:
        return differ_steps(state, u, loads)
    _lean(body, state, u, LEAN_OF_ADJOINTS)
    return _by_adjoint(state, u, loads)


def differ_steps(state: StepState, u: Array, loads: Array) -> StepDerivative:
    """The same by steps from states nearby alone."""
    differences = _Differences(state, u, loads)
    by_inputs, kinks = differences.by_inputs(_lean(state.body, state, u, 0.0))
    after, room = differences.after, _lean(state.body, state, u, LEAN_OF_DIFFERENCES)
    by_state, others = differences.by_state(room)
    if room.lean:
        half, _ = differences.by_state(_lean(state.body, state, u, room.lean / 2))
        by_state = 2 * half - by_state
    return StepDerivative(after, by_state, by_inputs, kinks + others)


def guides_of(body: Simulator) -> Sequence[str]:
    """Loads that are found in a step."""
    return () if body.environment is None else tuple(body.environment.environment.guides)


def _lean(body: Simulator, state: StepState, u: Array, lean: float) -> _Room:
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
    found, contact = _Touch.of(body), body.integrator.contact
    if found is None or contact is None:
        return _Room(np.inf, np.inf)
    environment, law = body.environment, interface.solver.law
    pressing = np.einsum("ca,ca->c", contact.pair_forces, contact.normals)[:, None] * contact.normals
    rubbing, offsets = contact.pair_forces - pressing, environment.state.offsets.copy()
    rubs = float(np.linalg.norm(rubbing, axis=1).sum())
    straight = float(np.linalg.norm(rubbing.sum(axis=0))) / rubs if rubs else 1.0
    state.put(state.x)
    while True:
        speed = lean * found.speed
        if law.stiffness is not None or found.is_static:
            return _Room.of(REACH * found.speed, found.gap, body.dt, REACH * found.speed)
        approaches = found.approach < speed and law.restitution < 1
        slides = found.sliding < speed
        for k, (name, offset) in enumerate(zip(environment.obstacles, offsets, strict=True)):
            of_this, moved = contact.pairs // len(contact.forces) == k, offset.copy()
            for forces, leans in ((pressing[of_this], approaches), (rubbing[of_this], slides)):
                size = float(np.linalg.norm(whole := forces.sum(axis=0)))
                if leans and size > 0:
                    moved += speed * body.dt / size * whole
            body.set_signal(name, moved)
        body.step(u)
        same = found.does_as(_Touch.of(body))
        state.put(state.x)
        if same or lean <= LEAST_LEAN:
            break
        lean /= 10
    push = max(straight, LEAST_STRAIGHT) * speed if slides else found.sliding if lean else np.inf
    least, most = min(speed if approaches else found.approach, push), REACH * found.speed
    used = lean if approaches or slides else 0.0
    return _Room.of(min(least, most), found.gap, body.dt, min(push, most), used)


class _Touch(NamedTuple):
    """What contact pairs do in a step."""

    does: tuple[bytes, bytes]  # which take part, and which of them slip
    speed: float  # that their forces stop, m/s
    approach: float  # of the slowest of them, m/s
    sliding: float  # power of friction, per force, m/s; infinite where it is asked to do none
    gap: float  # the least, m
    is_static: bool

    @classmethod
    def of(cls, body: Simulator) -> "_Touch | None":
        """Of the last step; None where nothing touched."""
        interface = body.integrator.interface
        found = None if interface is None else interface.solver.last_step()[1]
        if interface is None or found is None:
            return None
        μ, f, problem = interface.solver.law.friction, found.forces, found.problem
        rubs, power, slips = np.hypot(f[1], f[2]), np.inf, np.zeros(0, bool)
        if μ and rubs.any():
            slips = rubs > (1 - SLIPS) * μ * f[0]
            sliding = found.velocities[1:] + (0.0 if problem.sliding is None else problem.sliding)
            braking = found.pairs.braking
            if braking is not None and braking.by_share is None:
                power = abs(float((f[1:] * sliding).sum())) / float(rubs.sum())
        approach = float(np.abs(found.pairs.relative[0][found.active]).min())
        gap = float(np.abs(found.gaps[found.active]).min())
        does = found.active.tobytes(), slips.tobytes()
        return cls(does, float(np.abs(problem.q).max()), approach, power, gap, found.quasi_static)

    def does_as(self, other: "_Touch | None") -> bool:
        """Whether pairs do the same in another step."""
        return other is not None and self.does == other.does


def _by_adjoint(state: StepState, u: Array, loads: Array) -> StepDerivative:
    """By the adjoint of the step."""
    body = state.body
    state.put(state.x)
    q, r = body.state
    body.step(u)
    kernel, after = body.integrator.kernel, state.read()
    taken = kernel.adjoint(np.concatenate([u, loads]))
    beyond, free = np.zeros(len(body.rom.stiffness) - body.rom.rigid), np.zeros(6)
    nothing = Reads(np.zeros(len(q)), beyond, 0.0, free)
    A, B = np.empty((len(after), len(after))), np.empty((len(after), len(u) + len(loads)))
    for k, unit in enumerate(np.eye(len(after))):
        before, by_inputs, _, _ = taken.pull_back(state.owed(unit), nothing)
        A[k], B[k] = state.gather(*kernel.start_pulled_back(q, r, before), before), by_inputs
    return StepDerivative(after, A, B, ["a contact point"] if taken.is_kink else [])


class _Differences:
    """Of steps from states, and under inputs, that are nearby; `after` is the state that the step leads to."""

    def __init__(self, state: StepState, u: Array, loads: Array):
        self._state, self._p, self._v, column = state, len(u), np.concatenate([u, loads]), len(u)
        self._columns: dict[int, tuple[str, int]] = {}  # of loads that act by themselves
        for name, width in state.body.rom.loads.items():
            if name not in guides_of(state.body):
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

    def by_state(self, room: _Room) -> tuple[Array, list[str]]:
        """A, and what is at a kink."""
        x, after, kinks = self._state.x, self._step(self._state.x, self._v), list[str]()
        sizes, reach, _ = _reaches(self._state, after, self._columns, room)
        A = np.empty((len(after), len(after)))
        for k, name in enumerate(self._state.names):
            A[:, k], is_kink = _slope(lambda x: self._step(x, self._v), x, k, reach[k], after, sizes)
            kinks += [name] * is_kink
        return A, kinks

    def by_inputs(self, room: _Room) -> tuple[Array, list[str]]:
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
    state: StepState, after: Array, columns: dict[int, tuple[str, int]], room: _Room
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
