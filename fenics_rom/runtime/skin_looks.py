"""Looks at the skin of a body among obstacles, as its simulator has it."""

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.frame_motion import world_displacement
from fenics_rom.mechanics.obstacle_poses import farthest_moved
from fenics_rom.mechanics.skin import MovedIntruder, Skin
from fenics_rom.mechanics.skin_path import CHECK_INTERVAL, Instant, Placement, stride_of
from fenics_rom.mechanics.skin_watch import SkinWatch, displaced
from fenics_rom.rom.contact_model import ContactModel

if TYPE_CHECKING:
    from fenics_rom.mechanics.base_path import BaseState
    from fenics_rom.runtime.steppers.contact_interface import ContactInterface

Simulator = Any  # fenics_rom.runtime.simulator's, which imports this file


class Mark(NamedTuple):
    """Where a body was."""

    model: ContactModel
    e: Array  # (m,) of its energy coordinates
    rigid: Array  # (ρ,) along its rigid motions
    pose: "BaseState | None"
    beyond: Array | None  # (k,) what contact points yield beyond the contact mode


class SkinPlaces:
    """Where the skin of a body is.

    Args:
        body: the simulator.
        skin: of it.
    """

    def __init__(self, body: Simulator, skin: Skin):
        self._body, self._skin = body, skin
        self._nodes = skin.nodes[skin.few_rows]
        self._rows = body.rom.rows_of(self._nodes).reshape(3 * len(self._nodes), -1)
        self._bounds: dict[int, tuple[ContactModel, float, float]] = {}
        if body.rom.moving_frame is not None:
            self._arm = arm_of(skin, body.rom.moving_frame.origin)

    def mark(self) -> Mark:
        """Where the body is."""
        body = self._body
        stepper, frame = body.integrator, body.pose if body.rom.moving_frame is not None else None
        e, rigid = stepper.state[: stepper.model.order].copy(), stepper.rigid_displacement.copy()
        return Mark(stepper.model, e, rigid, frame, body.beyond_shared)

    def moved(self, since: Mark) -> float:
        """No node that is looked at first is farther from where it was at a mark, m; infinite where nobody knows."""
        whole, beside = self.way(since)
        return math.sqrt(whole.dot(whole)) + beside

    def way(self, since: Mark) -> tuple[Array, float]:
        """How the frame went since a mark, (3,), and how far, at most, a node beside that, as of `moved`; m."""
        body, stepper, whole = self._body, self._body.integrator, np.zeros(3)
        if stepper.model is not since.model:
            return whole, math.inf
        by_strain, by_motion = self._bound(since.model)
        Δ = stepper.state[: len(since.e)] - since.e
        moved = by_strain * math.sqrt(Δ.dot(Δ))
        if len(since.rigid):
            Δ = stepper.rigid_displacement - since.rigid
            moved += by_motion * math.sqrt(Δ.dot(Δ))
        if since.pose is not None:
            pose = body.pose
            whole = pose.position - since.pose.position
            turn = pose.rotation - since.pose.rotation  # twice as long as the turn by which nodes move, at most
            moved += 2 * math.sqrt(turn.dot(turn)) * self._arm
        return whole, moved

    def placement(self, mark: Mark | None = None) -> Placement:
        """Where the skin is, or was at a mark; of few nodes but for what contact points yield by themselves."""
        body = self._body
        model, e, rigid, pose, beyond = self.mark() if mark is None else mark
        q = e / model.safe_frequencies
        q[: len(rigid)] = rigid
        shape = model.coordinates @ q if beyond is None else model.coordinates @ q + beyond
        rest = body.rom.nodes[self._nodes]
        few = self._placed(rest, (self._rows @ shape).reshape(rest.shape), pose)
        if mark is None:
            return Placement(few, lambda: self._skin.places(body.displacement()))
        nodes = self._skin.nodes
        return Placement(few, lambda: self._placed(self._skin.coordinates, body.rom.reconstruct(shape)[nodes], pose))

    def _placed(self, rest: Array, field: Array, pose: "BaseState | None") -> Array:
        if pose is not None:
            field = world_displacement(pose, self._body.rom.moving_frame.origin, rest, field)
        places: Array = rest + field
        return places

    def _bound(self, model: ContactModel) -> tuple[float, float]:
        """How far a node goes at most, per length of the energy coordinates and of the rigid motions."""
        if id(model) not in self._bounds:
            blocks = self._rows.dot(model.coordinates).reshape(len(self._nodes), 3, -1)
            ρ = len(self._body.integrator.rigid_displacement)
            parts = blocks[..., ρ:] / model.safe_frequencies[ρ:], blocks[..., :ρ]
            strain, motion = (
                float(np.linalg.norm(part, ord=2, axis=(1, 2)).max()) if part.size else 0.0 for part in parts
            )
            if len(self._bounds) > len(self._body.rom.contact_models):  # those of moving frames are made in a switch
                self._bounds.clear()
            self._bounds[id(model)] = model, strain, motion
        return self._bounds[id(model)][1:]


def arm_of(skin: Skin, origin: Array) -> float:
    """How far nodes are from the origin (3,) of a frame, at most, m: as far again as the farthest one at rest."""
    arms = skin.coordinates - origin
    return 2 * math.sqrt(float(np.square(arms).sum(axis=1).max(initial=0.0)))


class SkinLooks:
    """Looks at the skin of a simulator.

    Args:
        body: the simulator.
        interface: its contact points and obstacles.
        watch: of its skin.

    Attributes:
        next_check: at which step to ask next whether to look.
    """

    def __init__(self, body: Simulator, interface: "ContactInterface", watch: SkinWatch):
        self._body, self.watch, self.places = body, watch, SkinPlaces(body, watch.skin)
        self._springs = interface.solver.law.stiffness is not None
        shapes = body.environment.obstacles.values()
        self._stride = min(stride_of(watch.skin, MovedIntruder(shape, np.zeros(3))) for shape in shapes)
        self.forget()

    def forget(self) -> None:
        """The body was put elsewhere: what is between does not count."""
        self._since: Mark | None = None
        self._offsets = np.empty(0)
        self.next_check = 0

    @property
    def is_new(self) -> bool:
        """Whether nothing is known of before: what happens from here on shows from the end of the next step on."""
        return self._since is None

    def check(self) -> None:
        """Looks, if enough steps were taken, or something may have gone in since the last look."""
        steps = self._body.steps
        self.next_check = steps + CHECK_INTERVAL
        if self._since is None:
            self._since, self._offsets = self.places.mark(), self._body.environment.state.offsets
            self.watch.room = self._stride
        elif steps >= self.watch.next_look or self._moved(self._since) > self.watch.room:
            self.look()

    def _moved(self, since: Mark) -> float:
        """How far the body and an obstacle went since the last look, together, at most, m."""
        moved, offsets = self.places.moved(since), self._body.environment.state.offsets
        if offsets is not self._offsets:
            shapes = self._body.environment.obstacles.values()
            moved += max(map(farthest_moved, shapes, self._offsets, offsets), default=0.0)
        return moved

    def look(self) -> None:
        """At where the body and the obstacles are, and at where they were since the last look."""
        body, places, since, before = self._body, self.places, self._since, None
        obstacles, offsets = body.environment.obstacles, body.environment.state.offsets
        if since is not None and self._moved(since) > self._stride:
            before = Instant(places.placement(since), displaced(obstacles, self._offsets))
        now = Instant(places.placement(), displaced(obstacles, offsets))
        self._since, self._offsets = places.mark(), offsets
        self.watch.look(body.steps, body.time, now, before, self._springs)
