"""A world whose joints are made, driven and let go."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.arguments import is_number
from fenics_rom.errors import StepError, check_known, shown
from fenics_rom.world.contact_step import Found, Pairs
from fenics_rom.world.drives import Motor, State
from fenics_rom.world.fast_motion import CutWorld
from fenics_rom.world.guide import Guide
from fenics_rom.world.joints import AnyJoint
from fenics_rom.world.soft import Soft

MOVES = 1e-6  # m/s: slower parts are joined as if they moved alike


class JoinedWorld(CutWorld):
    """A world with joints."""

    def _begin(self, inputs: Mapping[str, Mapping[str, Any]]) -> tuple[Pairs, Array, Guide | None]:
        """Opens a step of all bodies; its pairs, forces to begin with, and what may guide."""
        raise NotImplementedError

    def _go_on_with_joints(self, made: Sequence[str]) -> None:
        """Goes on with the joints that hold now, some of which were made now, and stops what moves there."""
        self._leave_loops()
        self._step_pairs.join(self._joints.points)
        pairs, forces, _ = self._begin({})
        self._found = Found(forces.copy(), np.zeros(forces.shape), self._found.sweeps, 0.0)
        for name in made:
            points = self._joints.points[name]
            speed = float(np.abs(self._step_pairs.of_joint(points, pairs.before)).max())
            both = [self._bodies[self._names[number]] for number in (points.first, points.second)]
            swings = [body.name for body in both if isinstance(body, Soft) and body.has_inertia > body.takes_impulses]
            if speed > MOVES and swings:
                self._joints.warnings.append(
                    f"{name}: what it joins moved at {speed:.2g} m/s relative to one another, and {swings[0]} takes no "
                    "impulse: it swings by that until damping takes it; join what moves alike"
                )
        self._met.book(dissipated=self._step_pairs.stop_joints())
        self._make_loops()

    def join(self, joint: AnyJoint) -> str:
        """Makes a joint where the bodies are now, between two steps; its name.

        Its points stay together from now on. Where they move relative to one another, an impulse stops that, which
        keeps momenta; what energy it takes is booked as dissipated. Some soft bodies take no impulse: what moves there
        swings until damping takes it, and the world says so in its warnings.

        Raises:
            SceneError: the joint cannot be closed, as at a point where a soft body has no surface.
            StepError: a world of one soft body alone, or a joint with a start of its own.
        """
        if self._lone is not None:
            raise StepError("a soft body by itself has no joints: give its world one to begin with, or another body")
        if not isinstance(joint, AnyJoint):
            raise StepError(f"join: {shown(joint)} was given; use a joint: ball, hinge, weld or SurfaceJoint")
        if joint.start:
            raise StepError(f"join: start = {joint.start:g} s: use a joint without, as it is made now")
        if joint.stop is not None and joint.stop <= self._time:
            raise StepError(f"join: stop = {joint.stop:g} s: use a time after {self._time:g} s, which is now")
        name = self._joints.make(joint)
        self._go_on_with_joints([name])
        return name

    def release(self, which: str | int) -> None:
        """Lets go of a joint, between two steps; `which`: as in `joint_forces`.

        Nothing is lost: bodies go on as they move, and what is strained springs back. What was joined can touch again,
        as soon as the bodies are not inside one another.

        Raises:
            StepError: there is no such joint, or it does not hold.
        """
        try:
            name = self._joints.name_of(which)
        except StepError as error:
            if not self._soft:
                raise
            raise StepError(
                f"{error}. Supports of a scene are part of its model, and cannot be let go of: make the body free, "
                'with frame = "moving" and without the support, and weld its surface to "world"'
            ) from error
        self._joints.end(name)
        self._go_on_with_joints([])

    @property
    def motors(self) -> dict[str, Motor]:
        """Of joints that hold now, by name: what pushes them towards the target that a step is given."""
        held = self._joints.points
        return {name: joint.drive.motor for name, joint in held.items() if joint.drive and joint.drive.motor}

    @property
    def _motors(self) -> dict[str, State]:
        """Joints with a motor that hold now, and how they are."""
        held = self._joints.points
        return {name: joint.state for name, joint in held.items() if joint.drive and joint.drive.motor is not None}

    def _take_targets(self, inputs: Mapping[str, Mapping[str, Any]]) -> Mapping[str, Mapping[str, Any]]:
        """Gives motors their targets; inputs of bodies that are left."""
        rows = self._step_pairs.rows
        if rows is None or not rows.is_driven:
            return inputs
        targets, left = dict[str, float](), {name: dict(given) for name, given in inputs.items()}
        for name in self._motors:
            given = left.get(name, {})
            if name in left and name not in self.bodies:
                for key in given:
                    check_known("input", key, ("target",), StepError, f"joint {name!r}: ")
            if "target" in given:
                target = given.pop("target")
                if not is_number(target):
                    raise StepError(f"joint {name!r}: target = {shown(target)}: use a finite number")
                targets[name] = float(target)
        rows.take_targets(targets)
        return left

    def joint_state(self, which: str | int) -> State:
        """Position, speed, and force along the motion of a joint with a drive: after the last step, and in it.

        `which`: as in `joint_forces`.

        Raises:
            StepError: it has no drive, or does not hold now.
        """
        name = self._joints.name_of(which)
        joint = self._joints.points.get(name)
        if joint is None or joint.drive is None:
            raise StepError(f"joint {name!r} has no drive, or does not hold now: use a hinge or slider with one")
        if self._loops is not None and self._loops.is_ahead:
            self._loops.tell_drives()
        return joint.state
