"""Contact forces in a step of a body in a moving frame, found in sweeps until nothing changes.

Points go by h S v̂ exactly, where S = [1, -a~ R*, R* V] depends on the step itself. At velocities x, near those of a
step, and forces f, a sweep corrects x' = x - J⁻¹ (ρ - Sᵀ f), ρ what the balance of the step lacks, asks for the forces
f' on points that would go by S x' - W f without them, and goes on from x' + J⁻¹ Sᵀ (f' - f). Where that ends balance
and law hold, whatever J and W are: W = S J⁻¹ Sᵀ, made symmetric. So contact does the work h Σ f·ŝ with the ŝ of its
law, and adds no energy.

Where more points touch than the body has freedoms, W is singular, and there are forces only for velocities that it can
have. So what the law wants of points is said with the S of the step, too: where they stick they go by S v/2, v the
body's velocities at the start, and not by half of what they do then, which no v̂ might fulfil; and W is of every sweep.
"""

import math
from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError
from fenics_rom.mechanics.actuator_forces import ActuatorForces
from fenics_rom.mechanics.complementarity.solution import LARGEST_RESIDUAL, NEGLIGIBLE_RESIDUAL
from fenics_rom.mechanics.contact import ContactSolution, ObstacleMotion, PointMotion
from fenics_rom.mechanics.contact_pairs import Settled
from fenics_rom.mechanics.contact_solver import ContactSolver
from fenics_rom.mechanics.frame_geometry import Geometry, Push
from fenics_rom.mechanics.frame_motion import Vector
from fenics_rom.mechanics.gas import Targets
from fenics_rom.mechanics.points_held_back import Touch
from fenics_rom.mechanics.points_operator import OfSome, Operator, moved_by

TOLERANCE = 1e-15  # of the velocities: what the next sweep may change
ROUND_OFF = 1e-14  # of them: a change that is none
SLOW, FEW_SWEEPS = 0.5, 5  # of a change to the one before, from which on slopes are found anew, after so many
STUCK = 0.9  # of a change to the one before: where a body turns far in a step sweeps that get there take a third off
MOST_SWEEPS = 200
PROXIMAL, SMALLEST_PROXIMAL = 1e-4, 1e-8  # of the mean compliance, beside W where that may be singular: it only guides
LESS = 0.1  # of it in each sweep, so that they end soon, but not less than what forces were found with
PATIENCE = 25  # sweeps that are stuck, or four times as many: forces then may lack what any contact's may


class Interface(Protocol):
    """The contact points of a body, and the obstacles."""

    @property
    def solver(self) -> ContactSolver:
        """Of the contact law."""

    @property
    def solve(self) -> Callable[..., ContactSolution | None]:
        """As the solver does."""


class ToFind(Protocol):
    """Forces z (n,) of actuators that a step finds, by strokes and at guides; see actuator_forces."""

    @property
    def actuators(self) -> ActuatorForces:
        """What finds them."""

    @property
    def inputs(self) -> Array:
        """(p,) without them."""

    @property
    def targets(self) -> Targets:
        """Of the strokes."""


class ActuatedBody(Protocol):
    """What a body has beside FrameBody where forces of its actuators are to be found.

    Attributes:
        reactions: these forces (n,) in the step before, that x is under at first.
    """

    reactions: Array

    @property
    def found(self) -> ToFind | None:
        """What is to be found in the step that is open."""

    def act(self, z: Array) -> None:
        """Has the forces z (n,) from now on."""

    def found_at(self, x: Array) -> tuple[Array, Array, Array, Array | None]:
        """Near x: rates (n,), by what they and x change per z, (n, n) and (any, n); angles (n,), unless at rest."""

    def moved(self, near: Array, turn: Geometry, arms: Array, change: Array) -> Array:
        """Mid-step velocities (3 s, n) of those contact points (s,), at arms (s, 3), by changes (any, n) of x.

        But for what z does to the origin.
        """


class FrameBody(Protocol):
    """A body in a moving frame, within a step.

    Attributes:
        h: of the step, s.
        tells_apart: whether W is regular, so that forces that differ move points differently.
    """

    h: float

    @property
    def tells_apart(self) -> bool:
        """See the class."""

    def geometry(self, x: Array) -> Geometry:
        """How the frame turns at the velocities x."""

    def yielding(self, turn: Geometry, contact: ContactSolution | None) -> Array | None:
        """Mid-step velocity (P, 3) in the frame of the points in the residual part; None where there is none."""

    def arms(self, turn: Geometry, rate: Array, yielding: Array | None) -> Array:
        """Of the contact points from the origin in the middle of a step, (P, 3), m."""

    def rates(self, x: Array) -> tuple[Array, Array]:
        """ω̂ (3,) in the frame's axes and r̂, of all coordinates."""

    def push(self, forces: Array, turn: Geometry, arms: Array) -> Push:
        """What forces (P, 3) on the contact points do, N in world axes."""

    def corrected(self, x: Array, push: Push | None) -> Array:
        """Velocities nearer to those of the step, under contact forces that push."""

    def renew(self, x: Array) -> None:
        """Finds anew, at the velocities x, the slopes that they are corrected by, if these are kept from elsewhere."""

    def velocities(self, turn: Geometry, arms: Array, x: Array, yielding: Array | None) -> Array:
        """Mid-step velocities (P, 3) of the contact points in world axes, less that of the origin, m/s."""

    def translation(self, turn: Geometry, contact: Vector, x: Array) -> Array:
        """Mid-step velocity (3,) of the origin under a contact force, at velocities x near those of the turn."""

    def delassus(self, near: Array, turn: Geometry, arms: Array) -> Array:
        """Mid-step velocities (3 s, 3 s) of those points (s,), at arms (s, 3), per force, m/s/N."""

    def spread(self, change: Push) -> Array:
        """What x changes by, where contact forces change by so much."""

    def kept_velocities(self, turn: Geometry, arms: Array) -> Array:
        """Velocities (P, 3) of the contact points in world axes, m/s, by those of the body at the start of the step."""

    def point_displacement(self) -> Array:
        """Of the contact points, (P, 3), m."""

    def size(self, change: Array) -> float:
        """Of velocities x, as √(2 J)."""

    def no_progress(self, scale: float) -> float:
        """A change that is round-off beside velocities of a scale, where changes shrink no more, √(2 J).

        The law's forces are no nearer to its solution.
        """

    def scale(self, x: Array) -> float:
        """Of the velocities of the step at its start and at x, with that of the origin without contact: what rests
        under its weight is stopped from falling."""


def touch(
    body: FrameBody,
    interface: Interface | None,
    x: Array,
    obstacles: ObstacleMotion | None,
    actuated: ActuatedBody | None = None,
) -> tuple[Array, ContactSolution | None]:
    """Velocities and contact of a step that would go by x without it, under the forces of actuators that it needs.

    Args:
        body: within a step.
        interface, obstacles: that touch it; None: nothing can.
        x: velocities.
        actuated: the body where forces of its actuators are to be found, too.

    Raises:
        StepError: no forces were found.
    """
    if interface is None or obstacles is None:
        return (x if actuated is None else hold(body, x, actuated, actuated.reactions)), None
    solver, h, z = interface.solver, body.h, np.empty(0) if actuated is None else actuated.reactions
    search_before, settled = solver.search, Settled()
    steady = np.array_equal(obstacles.velocities(h), obstacles.velocities_before)
    displacement = body.point_displacement()
    near, contact, proximal, least = np.empty(0, dtype=int), None, PROXIMAL, SMALLEST_PROXIMAL
    is_near = np.zeros(len(displacement), dtype=bool)
    forces, size_before, scale = np.zeros_like(displacement), 0.0, body.scale(x)
    found_all, left = False, 0.0  # from when on the balance alone is solved, and what forces then lacked

    def solved(free: Array, operator: Operator) -> ContactSolution | None:
        # What touched in the step before is what obstacles push that accelerate.
        told = search_before.residual, search_before.held
        if steady:
            solver.search = solver.search._replace(residual=told[0], held=told[1])
        elif sweep < PATIENCE:
            solver.search = search_before
        else:  # two sets of forces may take turns for ever, where each is found from those of the step before
            last, pushed = solver.search.forces, search_before.pushed
            solver.search = search_before._replace(forces=last, known_to_push=pushed)
        motion = PointMotion(displacement, velocity, free, arms)
        return interface.solve(motion, operator, h, obstacles, settled=settled)

    for sweep in range(MOST_SWEEPS):
        settled.begin_sweep()
        turn = body.geometry(x)
        yielding = body.yielding(turn, contact)
        arms = body.arms(turn, body.rates(x)[1], yielding)
        push = body.push(forces, turn, arms)
        corrected = x if sweep == 0 else body.corrected(x, push)
        moving = body.velocities(turn, arms, corrected, yielding) + body.translation(turn, push.force, corrected)
        velocity = body.kept_velocities(turn, arms)
        if sweep == 0:
            near = solver.within_reach(PointMotion(displacement, velocity, moving), h, obstacles)
            if not len(near):
                return (x if actuated is None else hold(body, x, actuated, z)), None
            is_near[near] = True
        found, before, z_before, by_actuators = forces, contact, z, 0.0
        if not found_all:
            W = _operator(body, turn, arms, near, proximal)
            free = moving - moved_by(W, forces).reshape(forces.shape)
            if actuated is None:
                contact = solved(free, W)
            else:
                held = Held.of(actuated, corrected, z)
                moved = np.zeros((forces.size, len(z)))
                rows = (3 * near[:, None] + np.arange(3)).ravel()
                moved[rows] = actuated.moved(near, turn, arms[near], held.spread)
                z, contact = held.solve_with(moved, W, free, forces, z, solved)
            if contact is not None and len(near) < len(forces) and not is_near[contact.touched_points].all():
                is_near[contact.touched_points] = True  # others are reached, too
                near, solver.search, contact, z = is_near.nonzero()[0], search_before, before, z_before
                continue
            if solver.search.residual != search_before.residual:
                least = min(proximal / LESS**2, PROXIMAL)
            proximal = max(LESS * proximal, least)
            if contact is None and sweep == 0 and actuated is None:
                return x, None
            found = np.zeros_like(forces) if contact is None else contact.forces
            if actuated is not None:
                by_actuators = held.spread.dot(z - z_before)
                actuated.act(z)
        change = corrected - x + by_actuators + body.spread(body.push(found - forces, turn, arms))
        x, forces, size = x + change, found, body.size(change)
        scale = max(scale, body.scale(x))
        converged = size <= ROUND_OFF * scale or (size < size_before and size * size / size_before <= TOLERANCE * scale)
        if converged or (size <= body.no_progress(scale) and size > size_before / 2 > 0):
            if left and contact is not None:
                solver.search = solver.search._replace(residual=search_before.residual.with_step(left))
                contact = _passive(contact, moving)
            if solver.search.known_to_push is not None:
                solver.search = solver.search._replace(known_to_push=None)
            return x, contact
        is_slow = size > size_before / 2 > 0
        patience = PATIENCE if size > STUCK * size_before > 0 else 4 * PATIENCE
        if not found_all and sweep >= patience and size <= LARGEST_RESIDUAL * scale:
            found_all, left = True, size / scale
        found_all = found_all or (size <= NEGLIGIBLE_RESIDUAL * scale and is_slow)
        if sweep >= FEW_SWEEPS and size > SLOW * size_before:
            body.renew(x)
        size_before = size
    solver.search = search_before
    raise StepError(f"contact of a turning body: {_left('forces', size / scale)}")


def hold(
    body: FrameBody, x: Array, actuated: ActuatedBody, z: Array, push_at: Callable[[Array], Push] | None = None
) -> Array:
    """Velocities of a step that goes by x under the forces z (n,) of actuators, under those that it needs.

    `push_at`: what other forces do at such velocities; None: nothing.
    """
    size_before, scale = 0.0, body.scale(x)
    for sweep in range(MOST_SWEEPS):
        push = None if push_at is None else push_at(x)
        corrected, z_before = x if sweep == 0 else body.corrected(x, push), z
        held = Held.of(actuated, corrected, z)
        z = held.solve(z)
        actuated.act(z)
        change = corrected - x + held.spread.dot(z - z_before)
        x, size = x + change, body.size(change)
        scale = max(scale, body.scale(x))
        if size <= ROUND_OFF * scale or (size < size_before and size * size / size_before <= TOLERANCE * scale):
            return x
        if size <= body.no_progress(scale) and size > size_before / 2 > 0:
            return x
        if sweep >= FEW_SWEEPS and size > SLOW * size_before:
            body.renew(x)
        size_before = size
    raise StepError(f"forces of actuators of a turning body: {_left('velocities', size / scale)}")


def _left(what: str, share: float) -> str:
    """What sweeps that did not end leave, as a share of the velocities, and what to do."""
    found = f"after {MOST_SWEEPS} sweeps {what} still change by {share:.1e} of the velocities"
    return f"{found if math.isfinite(share) else 'sweeps diverge'}; a smaller dt, or less force, is the cure"


class Held(NamedTuple):
    """Actuators whose forces z (n,) are to be found, near velocities x that are those under some z."""

    actuators: ToFind
    spread: Array  # what x changes by per z (any, n)
    compliance: Array  # rates per z (n, n), as `ActuatorForces.compliance` makes it
    rates: Array  # (n,) without z
    angles: Array | None  # (n,) by which tendons turn at guides; None: those at rest

    @classmethod
    def of(cls, actuated: ActuatedBody, x: Array, z: Array) -> "Held":
        """Near x, under z."""
        actuators = actuated.found
        assert actuators is not None
        rates, by_z, spread, angles = actuated.found_at(x)
        guide = (by_z + by_z.T) / 2  # so that strokes go as they are to where sweeps end, also of bodies that turn
        return cls(actuators, spread, actuators.actuators.compliance(by_z), rates - guide.dot(z), angles)

    def solve(self, before: Array) -> Array:
        """z where nothing touches, from those before."""
        z, _ = self._solve(before, None, self.rates)
        return z

    def solve_with(
        self,
        moved: Array,
        delassus: Operator,
        free: Array,
        forces: Array,
        z: Array,
        solve_contact: Callable[[Array, Operator], ContactSolution | None],
    ) -> tuple[Array, ContactSolution | None]:
        """z and contact.

        Args:
            moved: velocities (3P, n) of contact points per z.
            delassus: W of the points where z stays.
            free: velocities of the points without contact, (P, 3), m/s, under z.
            forces, z: that x is under.
            solve_contact: with the velocities of points without contact, (P, 3), and an operator.
        """
        held = self.actuators.actuators.holding(delassus, moved, self.compliance)

        def touch(tried: Array, holding: Array, *, gives: Array | None) -> tuple[ContactSolution | None, Array]:
            by_z = moved.dot(tried - z).reshape(-1, 3)
            contact = solve_contact(free + by_z, held.delassus(holding, gives))
            return contact, np.zeros(len(z)) if contact is None else moved.T.dot(contact.forces.ravel())

        return self._solve(z, touch, self.rates - moved.T.dot(forces.ravel()))

    def _solve(self, before: Array, touch: Touch | None, rates: Array) -> tuple[Array, ContactSolution | None]:
        found = self.actuators
        return found.actuators.solve(found.inputs, rates, self.compliance, found.targets, before, touch, self.angles)


def _passive(contact: ContactSolution, velocities: Array) -> ContactSolution:
    """Forces that do not fit their law to round-off, with what they do at the points' velocities (P, 3), m/s.

    Raises:
        StepError: they would do work on the body.
    """
    whole = float((contact.forces * velocities).sum()) - contact.power_of_obstacles
    if whole > 0:
        raise StepError("contact of a turning body: no forces were found that add no energy; a smaller dt is the cure")
    if contact.normal_power is None:
        return contact
    pressures, speeds = (
        (part * contact.normals).sum(axis=1) for part in (contact.pair_forces, contact.relative(velocities))
    )
    return contact._replace(normal_power=min(max(whole, float(pressures.dot(speeds))), 0.0))


def _operator(body: FrameBody, turn: Geometry, arms: Array, near: Array, proximal: float) -> Operator:
    """W of the points that are near (s,); of others what serves to tell that they are reached."""
    W = body.delassus(near, turn, arms[near])
    W = (W + W.T) / 2
    if not body.tells_apart:  # so that sweeps do not exchange forces for ever
        W.ravel()[:: len(W) + 1] += proximal * W.trace() / len(W)
    return W if len(near) == len(arms) else OfSome(W, near, len(arms), W.trace() / len(W))
