"""The joints of a world by name: which of them hold now, and which are to be made or let go at a time."""

import math
from collections.abc import Mapping, Sequence

from fenics_rom.arguments import is_number
from fenics_rom.errors import SceneError, StepError, check_known, shown
from fenics_rom.world.bodies import Body
from fenics_rom.world.joints import AnyJoint, JointPoints
from fenics_rom.world.meetings import Meeting


class JointPlan:
    """All joints of a world, in the order in which they were named.

    What is joined does not touch; nor does what was let go inside one another, until it has come out.

    Args:
        joints: as the world begins; those without a name get one, "joint0" if they come first.
        bodies: by name.
        meetings: those that may touch.

    Attributes:
        points: of the joints that hold now, by name.
        next_change: when a joint is to be made or let go next, s; at once while something is to come out.
        warnings: of what was let go.

    Raises:
        SceneError: two joints have one name, or one cannot be closed.
    """

    def __init__(self, joints: Sequence[AnyJoint], bodies: Mapping[str, Body], meetings: Sequence[Meeting]):
        self.points, self.next_change, self.warnings = dict[str, JointPoints](), math.inf, list[str]()
        self._bodies, self._meetings, self._inside = bodies, meetings, list[Meeting]()
        self._all, self._due = dict[str, AnyJoint](), list[str]()
        for joint in joints:
            self._due.append(self._named(joint))

    def _named(self, joint: AnyJoint) -> str:
        name = f"joint{len(self._all)}" if joint.name is None else joint.name
        if name in self._all:
            raise SceneError(f"joint {name!r}: there are two of this name; use a name of its own")
        self._all[name] = joint
        return name

    def name_of(self, which: str | int) -> str:
        """The name of a joint, given by that or by its number in the order in which they were named."""
        names = list(self._all)
        if isinstance(which, str):
            check_known("joint", which, names, StepError)
            return which
        if not (is_number(which, whole=True) and -len(names) <= which < len(names)):
            raise StepError(f"joint {shown(which)}: use a number below {len(names)}, or a name: {', '.join(names)}")
        return names[which]

    def make(self, joint: AnyJoint) -> str:
        """Makes a joint where the bodies are now; its name."""
        name = self._named(joint)
        try:
            self._hold(name)
        except BaseException:
            del self._all[name]
            raise
        self._take_note()
        return name

    def end(self, name: str) -> None:
        """Lets go of a joint that holds.

        Raises:
            StepError: it does not hold.
        """
        if name not in self.points:
            raise StepError(f"joint {name!r} does not hold now; those that do: {', '.join(self.points) or 'none'}")
        del self.points[name]
        self._let_go(self._all[name])
        self._take_note()

    def change(self, middle: float) -> list[str]:
        """Makes and ends joints as they say, before a step with its middle at a time, s; names of those made."""
        self._inside = [meeting for meeting in self._inside if self._depth(meeting)]
        for name in [name for name in self.points if not self._holds(name, middle)]:
            self.end(name)
        due = [name for name in self._due if self._all[name].start <= middle]
        self._due = [name for name in self._due if name not in due]
        made = [name for name in due if self._holds(name, middle)]
        for name in made:
            self._hold(name)
        self._take_note()
        return made

    def _hold(self, name: str) -> None:
        """Makes a joint where the bodies are now."""
        self.points[name] = points = JointPoints(self._all[name], self._bodies)
        if points.warning:
            self.warnings.append(f"{name}: {points.warning}")

    def _holds(self, name: str, middle: float) -> bool:
        stop = self._all[name].stop
        return stop is None or middle < stop

    def _take_note(self) -> None:
        """Of when the next change is, and of who touches."""
        stops = [stop for name in self.points if (stop := self._all[name].stop) is not None]
        self.next_change = min([*stops, *(self._all[name].start for name in self._due)], default=math.inf)
        if self._inside:
            self.next_change = -math.inf
        joined = [{self._all[name].first, self._all[name].second} for name in self.points]
        for meeting in self._meetings:
            meeting.is_on = set(meeting.names) not in joined and not any(meeting is inside for inside in self._inside)

    def _let_go(self, joint: AnyJoint) -> None:
        """Takes note where bodies that were joined are inside one another."""
        for meeting in self._meetings:
            if set(meeting.names) == {joint.first, joint.second} and (depth := self._depth(meeting)):
                self._inside.append(meeting)
                self.warnings.append(
                    f"{joint.first} and {joint.second} were {depth:.2g} m inside one another when their joint was let "
                    "go, and do not touch before they are apart"
                )

    def _depth(self, meeting: Meeting) -> float:
        """How deep two bodies are inside one another now, m; 0 where they are not."""
        contacts = meeting.overlap(list(self._bodies.values()))
        return 0.0 if contacts is None else -float(contacts.gaps.min())
