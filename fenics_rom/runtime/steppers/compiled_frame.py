"""Steps of a body in a moving frame by compiled functions: what `FreeFrame` and `CarriedFrame` try first."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import in_plain, jit, or_numpy
from fenics_rom.mechanics.compiled.obstacle_motion import Moving
from fenics_rom.mechanics.contact import ContactSolution, ContactWork, ObstacleMotion
from fenics_rom.mechanics.frame_motion import Vector
from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.rom.moving_frame import MovingFrame
from fenics_rom.runtime.compiled.arrays_at import table_of
from fenics_rom.runtime.compiled.carried_step import (
    take_bent_carried_step,
    take_bent_carried_steps,
    take_carried_step,
    take_carried_steps,
)
from fenics_rom.runtime.compiled.frame_tables import arrays_of
from fenics_rom.runtime.compiled.frames import (
    INERTIA,
    LOOKED_AT,
    NUMBERS,
    REST,
    TAKEN,
    WRENCH,
    Body,
    Loads,
    State,
    Step,
    Taken,
    Watch,
)
from fenics_rom.runtime.compiled.free_balance import IS_PASSED, LENGTH, PASSED
from fenics_rom.runtime.compiled.free_step import (
    take_bent_free_step,
    take_bent_free_steps,
    take_free_step,
    take_free_steps,
)
from fenics_rom.runtime.compiled.pulled_frame import (
    take_pulled_bent_carried_step,
    take_pulled_bent_free_step,
    take_pulled_carried_step,
    take_pulled_free_step,
)
from fenics_rom.runtime.compiled.strokes import Pull
from fenics_rom.runtime.compiled.touched_carried import (
    take_touched_bent_carried_step,
    take_touched_bent_carried_steps,
    take_touched_carried_step,
    take_touched_carried_steps,
)
from fenics_rom.runtime.compiled.touched_frame import Touched, TouchedTaken
from fenics_rom.runtime.compiled.touched_free import (
    take_touched_bent_free_step,
    take_touched_bent_free_steps,
    take_touched_free_step,
    take_touched_free_steps,
)
from fenics_rom.runtime.steppers.bent_in_loops import BentInLoops
from fenics_rom.runtime.steppers.frame_loads import FrameLoads
from fenics_rom.runtime.steppers.frame_state import FrameState, Shape
from fenics_rom.runtime.steppers.frame_table import BENT as BENT_ROWS
from fenics_rom.runtime.steppers.frame_table import COUPLED, HALF_INERTIA1, MOMENTS, ROWS
from fenics_rom.runtime.steppers.frame_table import TURNED as TURNED_ROWS
from fenics_rom.runtime.steppers.frame_touch import FrameTouch
from fenics_rom.runtime.steppers.frame_watch import BENT, TURNED, FrameWatch

# What takes a step, and steps in a row, by whether a base carries the body and whether that deforms largely; and the
# same among obstacles.
STEPS: dict[tuple[bool, bool], tuple[Callable[..., Step], Callable[..., tuple[int, Step]]]] = {
    (False, False): (jit(take_free_step), take_free_steps),
    (True, False): (jit(take_carried_step), take_carried_steps),
    (False, True): (jit(take_bent_free_step), take_bent_free_steps),
    (True, True): (jit(take_bent_carried_step), take_bent_carried_steps),
}
PULLED: dict[tuple[bool, bool], Callable[..., Step]] = {  # where forces are found
    (False, False): jit(take_pulled_free_step),
    (True, False): jit(take_pulled_carried_step),
    (False, True): jit(take_pulled_bent_free_step),
    (True, True): jit(take_pulled_bent_carried_step),
}
TOUCHED: dict[tuple[bool, bool], Callable[..., Touched]] = {
    (False, False): jit(take_touched_free_step),
    (True, False): jit(take_touched_carried_step),
    (False, True): jit(take_touched_bent_free_step),
    (True, True): jit(take_touched_bent_carried_step),
}
TOUCHED_STEPS: dict[tuple[bool, bool], Callable[..., tuple[int, Touched]]] = {
    (False, False): take_touched_free_steps,
    (True, False): take_touched_carried_steps,
    (False, True): take_touched_bent_free_steps,
    (True, True): take_touched_bent_carried_steps,
}
NOTES = BENT, TURNED, "misfit", "misfit of turn"  # of a kernel, in the order of those of a watch


class FrameStep(NamedTuple):
    """A step that was taken, and contact in it."""

    step: Step
    contact: ContactSolution | None = None
    works: ContactWork = ContactWork(0.0, 0.0, 0.0)


class FrameSteps(NamedTuple):
    """Steps in a row."""

    steps: Taken
    carried: Array  # g (n, 3P) beyond the basis after each, N; (n, 0) where there is nothing
    works: Array  # of contact, J: (n, 3); (n, 0) where there is none
    by_obstacle: Array  # forces of the obstacles (n, O, 3), N; (n, 0, 3) where nobody asks
    last: FrameStep


class CompiledFrame:
    """Steps of one size.

    Args:
        body, loads, watch: what moves, what acts on it, and what looks at it.
        halves, halves_before: the state [e, r], (2, m), which steps change, and where they note it before.
        carried: by a base.
        bent: of a body that deforms largely; else None.

    Attributes:
        touch: how obstacles touch it; None: that is NumPy's, or they cannot.
        pull: what is found in its steps, with forces of the last one; None: nothing.
        arrays: all of them, in the order of `frame_tables`.
    """

    touch: FrameTouch | None = None
    pull: Pull | None = None

    def __init__(
        self,
        body: Body,
        loads: Loads,
        watch: Watch,
        halves: Array,
        halves_before: Array,
        carried: bool,
        bent: BentInLoops | None = None,
    ):
        m = len(body.ω)
        slopes = np.empty((2 * m, m) if carried else (3 + m, 3 + m))
        kept = np.zeros(REST + (9 if carried else 5 + m))
        self._state = State(halves, halves_before, np.zeros((2, NUMBERS)), body.table.copy(), kept, slopes)
        self._loads, self._watch, self._carried, self.bent = loads, watch, carried, bent
        self._wrench, self._noted_now = kept[WRENCH:REST], watch.notes[:LOOKED_AT]  # parts of these, which steps set
        self._take_on(body)
        self._frame: FrameState | None = None  # that the state is of
        self._notes: dict[str, float] | None = None  # that those of the watch are,
        self._noted: list[float] = []  # these

    def forget(self) -> None:
        """Forgets what is known of steps that led elsewhere."""
        self._state.kept[:WRENCH], self._frame, self._notes = 0.0, None, None
        if self.bent is not None:
            self.bent.forget()

    def set_body(self, body: Body, touch: FrameTouch | None, bent: BentInLoops | None) -> None:
        """Goes on with a body of another step size."""
        self.touch, self.bent = touch, bent
        self._take_on(body)
        self._state.kept[1 if self._carried else 2 : WRENCH] = 0.0  # but for how it moves, and did

    def _take_on(self, body: Body) -> None:
        """Has steps be of this body."""
        self._body, (self._step, self._steps) = body, STEPS[self._kind]
        self.arrays = arrays_of(
            body, self._loads, self._state, self._watch, None if self.bent is None else self.bent.arrays
        )
        self._table = table_of(self.arrays)

    @or_numpy
    def take(
        self, u: Array, base: Array, frame: FrameState | None, notes: dict[str, float], obstacles: ObstacleMotion | None
    ) -> FrameStep | None:
        """Takes a step under u (p,); None where it is to be taken otherwise, and nothing is changed.

        Args:
            u: (p,).
            base: at the end (13,), an array of its own; of a free body (0,).
            frame: at the start; None: where the last step led.
            notes: of the run so far.
            obstacles: that can touch it; None: there are none.
        """
        self.begin(frame, notes)
        given = (self._table, in_plain(u), base) if self._carried else (self._table, in_plain(u))
        try:
            if self.touch is not None and obstacles is not None:
                return self._take_touched(self.touch, given, obstacles)
            step = self._step(*given) if self.pull is None else PULLED[self._kind](*given, self.pull)
        except np.linalg.LinAlgError:
            self.forget()
            return None
        return FrameStep(step) if step.status == TAKEN else None

    def _take_touched(self, touch: FrameTouch, given: tuple[Any, ...], obstacles: ObstacleMotion) -> FrameStep | None:
        """The same among obstacles."""
        among = touch.among(obstacles)
        touched = TOUCHED[self._kind](*given, among)
        if touched.step.status != TAKEN:
            return None
        works = ContactWork(touched.by_obstacles, touched.lost, touched.friction)
        return FrameStep(touched.step, touch.keep(touched, among, among.found), works)

    @or_numpy
    def take_many(
        self,
        inputs: Array,
        bases: Array,
        frame: FrameState | None,
        notes: dict[str, float],
        path: ObstacleMotion | None,
    ) -> FrameSteps | None:
        """Takes steps under inputs (n, p) and bases (n, 13), as many as there are none to be taken otherwise.

        `path`: of the obstacles (`in_step`).
        """
        self.begin(frame, notes)
        n, m, on = len(inputs), len(self._body.ω), (in_plain(bases),) if self._carried else ()
        taken = Taken(
            np.empty((n, 2)), np.empty((n, m)), np.empty((n, 7)), np.empty((n, 0 if self.bent is None else 11))
        )
        given = self._table, in_plain(inputs), *on
        if self.touch is not None and path is not None:
            return self._take_many_touched(self.touch, given, path, taken)
        count, last = self._steps(*given, taken)
        nothing = np.empty((n, 0))
        return _first(count, TouchedTaken(taken, nothing, nothing, np.empty((n, 0, 3))), FrameStep(last))

    def _take_many_touched(
        self, touch: FrameTouch, given: tuple[Any, ...], path: ObstacleMotion, moved: Taken
    ) -> FrameSteps | None:
        """The same among obstacles."""
        n, (among, last) = len(moved.q), touch.for_many(touch.among(path.in_step(0)))
        asked = n, 0 if self.bent is None else len(among.shapes), 3
        taken = TouchedTaken(moved, np.empty((n, 3)), np.empty((n, among.points.beyond.shape[1])), np.empty(asked))
        count, touched = TOUCHED_STEPS[self._kind](*given, among, Moving(*path), last, taken)
        contact = touch.keep_last(touched, path.in_step(count - 1), among, last) if count else None
        if count and self.bent is not None:
            self.bent.press(contact)
        return _first(count, taken, FrameStep(touched.step, contact))

    @property
    def _kind(self) -> tuple[bool, bool]:
        """In `STEPS`."""
        return self._carried, self.bent is not None

    @property
    def h(self) -> float:
        """Of the steps, s."""
        return self._body.h

    @property
    def parts(self) -> tuple[Body, Loads]:
        """What compiled functions know of the body and of what acts on it."""
        return self._body, self._loads

    def begin(self, frame: FrameState | None, notes: dict[str, float]) -> None:
        """Takes over where the frame is, unless that is None, and notes of the run, as far as they are not known."""
        if frame is not None and frame is not self._frame:
            position, rotation, velocity, turning = frame
            self._state.now[0, :INERTIA], self._frame = (*position, *rotation, *velocity, *turning), frame
        if notes is not self._notes:
            self._noted, self._notes = [notes.get(name, 0.0) for name in NOTES], notes
            self._watch.notes[:LOOKED_AT] = self._noted

    def passed(self) -> tuple[float, Array] | None:
        """h and ω̂, r̂ (3 + m,) of a free body's last step; None: it is not known, or a base carries the body."""
        kept = self._state.kept
        if self._carried or not kept[IS_PASSED]:
            return None
        return kept.item(LENGTH), kept[PASSED:].copy()

    def pass_on(self, passed: tuple[float, Array] | None) -> None:
        """Has the next step of a free body begin by h and ω̂, r̂ (3 + m,) of another's, unless it knows its own."""
        kept = self._state.kept
        if passed is not None and not kept[IS_PASSED]:
            kept[IS_PASSED], kept[LENGTH], kept[PASSED:] = 1.0, *passed

    # What the last step led to.

    def frame(self) -> FrameState:
        """Where the frame is."""
        self._frame = frame_in(self._state.now[0])
        return self._frame

    def frame_before(self) -> FrameState:
        """Where it was before the step."""
        return frame_in(self._state.now[1])

    def notes(self, before: dict[str, float]) -> dict[str, float]:
        """Of the run; those before where nothing is new."""
        now = self._noted_now.tolist()
        if now != self._noted:
            self._noted = now
            before = before | {name: value for name, value in zip(NOTES, now, strict=True) if name in before}
        self._notes = before
        return before

    def motion(self, *, before: bool = False) -> tuple[Shape, list[float]]:
        """The inertia of the shape, and how the frame moves, (12,); or those before the step."""
        a, b, c, d, e, f, *rest = self._state.now[int(before), INERTIA:].tolist()
        u, v, w, x, y, z, i, j, k, *moving = rest
        return Shape((a, b, c, d, e, f), (u, v, w), (x, y, z), (i, j, k)), moving

    def wrench(self) -> Callable[[], tuple[Vector, Vector]]:
        """What tells the one of the base in the last step, in world axes."""
        return partial(two_vectors, self._wrench.copy())


def two_vectors(numbers: Array) -> tuple[Vector, Vector]:
    """Of six numbers."""
    x, y, z, a, b, c = numbers.tolist()
    return (x, y, z), (a, b, c)


def frame_in(now: Array) -> FrameState:
    """Where a frame is, of the numbers of a state."""
    x, y, z, w, i, j, k, u, v, s, a, b, c = now[:INERTIA].tolist()
    return FrameState((x, y, z), (w, i, j, k), (u, v, s), (a, b, c))


def _first(count: int, taken: TouchedTaken, last: FrameStep) -> FrameSteps | None:
    """The first of some steps; None where there are none."""
    moved = Taken(*(rows[:count] for rows in taken.moved))
    of_contact = taken.contact[:count], taken.by_obstacle[:count]
    return FrameSteps(moved, taken.carried[:count], *of_contact, last) if count else None


def body_of(
    model: ContactModel, h: float, frame: MovingFrame, products: Array, couples: bool, is_definite: float, bends: bool
) -> Body:
    """A body as compiled steps of h s take it.

    Args:
        model: of a contact mode.
        h: s.
        frame: with I2 as it is stiffened.
        products: h/2 I2, G and 2/h + h/2 γ + D, (10, m, m).
        couples, is_definite: as in `Body`.
        bends: whether it deforms largely, so that a law says how its shape resists and is damped.
    """
    m, D, ω = model.order, model.damping, np.sqrt(model.eigenvalues)
    if bends:
        D, products = np.zeros(m), np.concatenate([products[:9], 2 / h * np.eye(m)[None]])
    by_rate = products.transpose(2, 0, 1).reshape(m, 10 * m)
    by_shape = np.concatenate([frame.inertia2, frame.coupling]).transpose(2, 0, 1).reshape(m, 9 * m)
    table = np.zeros((ROWS, m))
    table[HALF_INERTIA1], table[BENT_ROWS], table[MOMENTS] = frame.inertia1 / 2, frame.inertia1 / 2, frame.moment_modes
    table[COUPLED], table[TURNED_ROWS] = frame.coupling0, frame.coupling0
    size = (frame.inertia0[:3].sum() / 2 / frame.mass) ** 0.5
    of_shape = np.diag(D) if D.ndim == 1 else D, products.reshape(10, m * m), by_rate, by_shape
    arrays = ω, 1 / model.safe_frequencies, *of_shape, np.linalg.inv(products[9]), table
    rigid = np.concatenate([frame.inertia0, frame.first_moment])
    return Body(h, frame.mass, couples, is_definite, float(size), *map(_of_one_type, (*arrays, rigid)))


def loads_of(loads: FrameLoads) -> Loads:
    """What acts on a body, as compiled steps take it."""
    p, rows = loads.width, len(loads.push)
    push, by_shape = np.zeros((p, rows + 3)), np.zeros((0, 0))
    push[loads.turning, :rows], push[loads.pulling, rows:] = loads.push.T, loads.fields
    if loads.by_shape is not None:
        by_shape = np.zeros((p, 3 * loads.by_shape.shape[1]))
        by_shape[loads.turning] = loads.by_shape.reshape(by_shape.shape[1], -1).T
    return Loads(push, by_shape, loads.columns, *map(_of_one_type, loads.points))


def watch_of(watch: FrameWatch) -> Watch:
    """What looks at a body, as compiled steps take it."""
    return Watch(watch.farthest, watch.limit, _of_one_type(watch.rows), np.zeros(LOOKED_AT + 1 + watch.rows.shape[1]))


def _of_one_type(array: Array) -> Array:
    """A copy for which nothing is compiled anew: with rows one after the other, and not read-only."""
    return np.array(array, order="C")
