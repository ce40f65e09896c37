"""What acts on the bodies of a world in compiled steps, set in their arrays."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.arguments import is_number
from fenics_rom.errors import StepError
from fenics_rom.mechanics.base_path import FLOAT, BasePath, CheckedMotion
from fenics_rom.mechanics.signals import real_numbers
from fenics_rom.world.driven import Driven
from fenics_rom.world.handed_forces import handed_in
from fenics_rom.world.rigid import Rigid
from fenics_rom.world.soft import Soft
from fenics_rom.world.soft_tables import HeldBent, SoftTable
from fenics_rom.world.step_count import next_time
from fenics_rom.world.world_arrays import BOOKED_TOGETHER


class SoftOne:
    """A soft body, and its arrays in steps."""

    def __init__(self, number: int, name: str, body: Soft, table: SoftTable):
        self.number, self.name, self.body, self.kernel, step = number, name, body, table.kernel, table.step
        tell = table.beside.contact if isinstance(table.beside, HeldBent) else handed_in
        self.u, self.told, self.contact = step.u, step.told, partial(tell, table.points.forces)
        self.order, self.beside = len(step.modal), table.beside
        assert body.environment is not None
        self.environment = body.environment


class StepInputs:
    """Of bodies in steps of h s.

    Args:
        soft, rigid, driven: these bodies; rigid ones by their row and name.
        motors: by the names of their joints, which drive each is.
        given: of rigid bodies, `Freedoms.given`.
        targets: of drives, (Q,).
        h: s.

    Attributes:
        ends: (n, D, 13) where bodies that are driven are when each of n steps to be taken ends.
    """

    def __init__(
        self,
        soft: Sequence[SoftOne],
        rigid: Sequence[tuple[int, str, Rigid]],
        driven: Sequence[Driven],
        motors: Mapping[str, int],
        given: Array,
        targets: Array,
        h: float,
    ):
        self._soft, self._rigid, self._given, self._h = soft, rigid, given, h
        self._moved = [(d, body) for d, body in enumerate(driven) if body.shape is not None]  # others stand still
        self._known = {*(each.name for each in soft), *(name for _, name, _ in rigid)}
        self._motors, self._targets = {name: q for name, q in motors.items() if name not in self._known}, targets
        self.ends = np.zeros((BOOKED_TOGETHER, len(driven), 13))

    def set(self, inputs: Mapping[str, Mapping[str, Any]], time: float) -> bool:
        """Sets what acts in steps from a time, s; whether it is what bodies can take."""
        for name in inputs:
            if name not in self._known and name not in self._motors:
                return False
        for each in self._soft:
            u, environment = each.u, each.environment
            if each.beside is not None:
                each.beside.tell_loops()
            u.fill(0.0)
            given = inputs.get(each.name)
            if given and not _fill(u, each.body.input_slices(), given):
                return False
            loads = environment.loads_at(time + self._h / 2)
            if len(loads):
                u[len(u) - len(loads) :] = environment.loads = loads
            each.body.tensions.note(u)
        self._targets.fill(0.0)
        for name, q in self._motors.items() if inputs else ():
            if name in inputs:
                given = inputs[name]
                if not (isinstance(given, Mapping) and set(given) <= {"target"} and is_number(given.get("target", 0))):
                    return False
                self._targets[q] = given.get("target", 0.0)
        self._given.fill(0.0)
        for b, name, rigid in self._rigid if inputs else ():
            if name in inputs:
                try:
                    rigid.take(inputs[name])
                except (AttributeError, StepError):
                    return False
                self._given[b] = rigid.given
        return True

    def set_ends(self, most: int) -> int:
        """Sets where driven bodies are when each of the next steps ends: in how many steps, so many at most.

        One where loads change with time. Fewer where a motion raises an error, or gives what are no arrays.
        """
        if most > 1 and not all(each.environment.has_constant_loads for each in self._soft):
            most = 1
        for d, body in self._moved:
            motion = body.motion.unchecked if isinstance(body.motion, CheckedMotion) else body.motion
            if most > 1 and isinstance(motion, BasePath):
                times = np.array([next_time(body.time, self._h, k + 1) for k in range(most)])
                self.ends[:most, d] = np.hstack(motion.along(times))
                continue
            end = body.time
            for k, row in enumerate(self.ends[:most, d]):
                end += self._h
                try:
                    state = motion(end)
                except Exception:
                    if k == 0:
                        raise
                    state = None  # it is raised again by the step that it is in
                if not _set_state(row, state):
                    most = k
                    break
        return most


def _set_state(row: Array, state: Any) -> bool:
    """Sets a row (13,) to the state of a base; whether it is one of arrays."""
    try:
        p, q, v, ω = state
        are_floats = p.dtype is q.dtype is v.dtype is ω.dtype is FLOAT
        if not (are_floats and p.shape == v.shape == ω.shape == (3,) and q.shape == (4,)):
            return False
    except (AttributeError, TypeError, ValueError):
        return False
    row[:3], row[3:7], row[7:10], row[10:] = state
    return True


def _fill(u: Array, starts: Mapping[str, slice], given: Mapping[str, Any]) -> bool:
    """Sets inputs by name; whether they are what is there."""
    try:
        for name, value in given.items():
            place, numbers = starts[name], real_numbers(value).reshape(-1)
            if len(numbers) != place.stop - place.start:
                return False
            u[place] = numbers
    except (AttributeError, KeyError, TypeError, ValueError):
        return False
    return True
