"""The derivative of a body's step with the state that it begins with, and with its inputs.

By the adjoint of the step (`steppers/adjoint.py`): a row of [A B] is what one number of the state after it owes to all
that went into it. A kink, where a contact pair is about to touch or to slip, or a cable to get slack, has a derivative
to each side: that which the step found.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError
from fenics_rom.runtime.simulator import Simulator
from fenics_rom.runtime.step_state import StepState
from fenics_rom.runtime.steppers.adjoint import Reads

# How fast what rests is approached, of the velocities that contact forces stop: by more than round-off.
LEAN, LEAST_LEAN = 1e-9, 1e-9
SLIPS = 1e-9  # of the cone: what is nearer to its border slips


class StepDerivative(NamedTuple):
    """A step, linearised."""

    after: Array  # (s,)
    A: Array
    B: Array  # (s, p) with columns of all loads
    kinks: list[str]  # what is about to change


def differentiate_step(state: StepState, u: Array, loads: Array) -> StepDerivative:
    """Of the step from a state under inputs (p,) and loads, N."""
    body = state.body
    lean_on(state, u, LEAN)
    state.put(state.x)
    q, r = body.state
    body.step(u)
    kernel, after = body.integrator.kernel, state.read()
    taken = kernel.adjoint(np.concatenate([u, loads]))
    beyond, free = np.zeros(len(body.rom.stiffness) - body.rom.rigid), np.zeros(6)
    nothing = Reads(np.zeros(len(q)), beyond, 0.0, free)
    A, B = np.empty((len(after), len(after))), np.empty((len(after), len(u) + len(loads)))
    for k, unit in enumerate(np.eye(len(after))):
        before, by_inputs, *_ = taken.pull_back(state.owed(unit), nothing)
        A[k], B[k] = state.gather(*kernel.start_pulled_back(q, r, before), before), by_inputs
    return StepDerivative(after, A, B, ["a contact point"] if taken.is_kink else [])


def found_loads(body: Simulator) -> Sequence[str]:
    """Loads that are found in a step."""
    return () if body.environment is None else body.environment.environment.found_loads


class Lean(NamedTuple):
    """How obstacles approach the pairs of a step."""

    touch: "Touch"
    lean: float  # of the velocities that contact forces stop
    approaches: bool  # whether they do so against the pressure of pairs that rest
    slides: bool  # and along friction that does no work
    straight: float  # resultant of friction, of the sum of its forces


def lean_on(state: StepState, u: Array, lean: float) -> Lean | None:
    """Lets obstacles approach pairs that rest, so slowly that nothing else changes; None where nothing touches.

    A pair is to have -e times its approach, if it approaches, and is let go, if it leaves: at rest the law has a kink
    between; and another, where friction that would do work asks for less. With obstacles that approach, and move as
    friction pushes, all pairs have the derivative of those that stay as they are.
    """
    body = state.body
    interface = body.integrator.interface
    if interface is None or body.environment is None:
        return None
    state.put(state.x)
    body.step(u)
    found, contact = Touch.of(body), body.integrator.contact
    if found is None or contact is None:
        return None
    if contact.carriers is not None:
        from fenics_rom.mechanics.met_faces import NO_DERIVATIVE  # here, as few scenes have it

        raise StepError(NO_DERIVATIVE)
    if contact.opposite is not None:
        raise StepError(
            "effects.contact.self_contact: steps in which a body that may touch itself touches something have no state "
            "space: use those where nothing touches, or a scene without; `fr.differentiate` goes through them"
        )
    environment, law = body.environment, interface.solver.law
    pressing = np.einsum("ca,ca->c", contact.pair_forces, contact.normals)[:, None] * contact.normals
    rubbing, offsets = contact.pair_forces - pressing, environment.state.offsets.copy()
    rubs = float(np.linalg.norm(rubbing, axis=1).sum())
    straight = float(np.linalg.norm(rubbing.sum(axis=0))) / rubs if rubs else 1.0
    state.put(state.x)
    if law.stiffness is not None or found.is_static:
        return Lean(found, 0.0, False, False, straight)
    while True:
        speed = lean * found.speed
        approaches = found.approach < speed and law.restitution < 1
        slides = found.sliding < speed
        for k, (name, offset) in enumerate(zip(environment.obstacles, offsets, strict=True)):
            of_this, moved = contact.pairs // len(contact.forces) == k, offset.copy()
            for forces, leans in ((pressing[of_this], approaches), (rubbing[of_this], slides)):
                size = float(np.linalg.norm(whole := forces.sum(axis=0)))
                if leans and size > 0:
                    moved[:3] += speed * body.dt / size * whole
            body.set_signal(name, environment.resting_signal(name, moved))
        body.step(u)
        same = found.does_as(Touch.of(body))
        state.put(state.x)
        if same or lean <= LEAST_LEAN:
            return Lean(found, lean, approaches, slides, straight)
        lean /= 10


class Touch(NamedTuple):
    """What contact pairs do in a step."""

    does: tuple[bytes, bytes]  # which take part, and which of them slip
    speed: float  # that their forces stop, m/s
    approach: float  # of the slowest of them, m/s
    sliding: float  # power of friction, per force, m/s; infinite where it is asked to do none
    gap: float  # the least, m
    is_static: bool

    @classmethod
    def of(cls, body: Simulator) -> "Touch | None":
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

    def does_as(self, other: "Touch | None") -> bool:
        """Whether pairs do the same in another step."""
        return other is not None and self.does == other.does
