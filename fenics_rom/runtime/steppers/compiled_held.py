"""Steps of a held body that deforms largely by one compiled function: what `HeldBody` tries first."""

import math
from typing import Any, NamedTuple, cast

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import in_plain, jit, or_numpy
from fenics_rom.mechanics.compiled.contact_law import OTHERWISE
from fenics_rom.mechanics.compiled.obstacle_motion import Moving
from fenics_rom.mechanics.compiled_contact import CompiledContact
from fenics_rom.mechanics.compiled_self_contact import CompiledSelfContact
from fenics_rom.mechanics.contact import ContactSolution, ObstacleMotion
from fenics_rom.mechanics.contact_solver import ContactSolver
from fenics_rom.rom.deformation import ReducedDeformation
from fenics_rom.runtime.compiled import held_step
from fenics_rom.runtime.compiled.arrays_at import table_of
from fenics_rom.runtime.compiled.carried_strains import AHEAD, GAP, HAS_TANGENT, MADE_TANGENT, strains_in
from fenics_rom.runtime.compiled.held_bodies import set_strokes_of
from fenics_rom.runtime.compiled.held_step import Step
from fenics_rom.runtime.compiled.held_steps import Taken, take_steps
from fenics_rom.runtime.compiled.held_table import Noted, arrays_of, take_step_at
from fenics_rom.runtime.compiled.held_touch import Among, Body, Touch, motion_in
from fenics_rom.runtime.compiled.strokes import Pull
from fenics_rom.runtime.compiled.touching import LOST
from fenics_rom.runtime.steppers.acts.found_forces import FoundForces
from fenics_rom.runtime.steppers.acts.shape_loads import ShapeLoads
from fenics_rom.runtime.steppers.adjoint import NONE
from fenics_rom.runtime.steppers.compiled_deformation import (
    Known,
    branches_of,
    following_of,
    handed_on,
    is_known,
    law_of,
    memory_of,
    sampled_of,
    take_on,
)
from fenics_rom.runtime.steppers.deformation_maps import Expected
from fenics_rom.runtime.steppers.elastic.carried_strains import StrainsCarried
from fenics_rom.runtime.steppers.elastic.law import ElasticLaw
from fenics_rom.runtime.steppers.elastic.sampled import SampledPoints
from fenics_rom.runtime.steppers.found_in_loops import pull_of
from fenics_rom.runtime.steppers.held_contact import HeldContact
from fenics_rom.runtime.steppers.held_self_contact import HeldSelfContact
from fenics_rom.runtime.steppers.residual_motion import ResidualMotion

take_step = jit(held_step.take_step)


class Beginning(NamedTuple):
    """What a step begins with."""

    halves: Array  # e and r (2, m)
    tangent: Array  # T (m, m), or empty
    obstacles: ObstacleMotion | None
    touched: ContactSolution | None  # contact,
    reactions: Array  # and forces of strokes (n,), in the step before


class HeldStepsTaken(NamedTuple):
    """Steps in a row."""

    steps: Taken
    last: Step
    contact: ContactSolution | None  # in the last one


class CompiledHeld:
    """Steps of h s.

    Args:
        body: its points.
        law: what resists its shape.
        loads: what acts on it.
        pull: cables and chambers whose strokes are given; None: there are none.
        ω: (m,), 1/s.
        inverse_ω: (m,), s.
        h: s.

    Attributes:
        body: what is held, as arrays.
        motion: of the last step.
        pull: cables and chambers whose strokes are given; None: there are none.
        tangent: T (m, m) that the next step is expected with; empty: it is to be made.
    """

    def __init__(
        self,
        body: ReducedDeformation,
        law: Known,
        loads: ShapeLoads,
        pull: Pull | None,
        ω: Array,
        inverse_ω: Array,
        h: float,
    ):
        m = body.order
        self._h, self._elastic, self._pushed = h, law, np.zeros(m)
        self.body = Body(
            ω,
            inverse_ω,
            loads.dead,
            following_of(loads.following, m, [] if pull is None else pull.actuators.columns.tolist()),
            law_of(body, law, h),
            sampled_of(body, law),
        )
        self._memory = memory_of(m, branches_of(law))
        self._of_motion = np.zeros((8, m)), np.zeros((m, m))
        self.motion, self._strains = motion_in(*self._of_motion), strains_in(self._memory)
        self.tangent, self._carried = NONE, cast(Any, law.carried)
        self._met: HeldContact | None = None  # what can touch the body
        self.pull = pull
        self._table, self._numbers = np.empty((0, 4), dtype=np.int64), np.array(self.body.law[:6], dtype=float)
        self._is_ahead = False  # whether loops took steps that the law does not know of
        self.forget()

    @property
    def is_alone(self) -> bool:
        """Whether nothing touches the body, or pulls it by strokes, and its strains are carried along."""
        return self._met is None and self.pull is None and self.body.sampled is None

    def note_in(self, halves: Array, watched: tuple[Array, Array, Array]) -> None:
        """Has `take_alone` keep what was before a step, e and r in an array (2, m), and look at what is watched."""
        strains = self._strains
        own = strains.velocity, strains.carried, strains.numbers, strains.relaxed
        v, carried, numbers, relaxed = map(np.empty_like, own)
        self._noted = Noted(halves, v, carried, numbers, relaxed, *watched, np.zeros(4))
        given = arrays_of(self.body, self._memory, self._of_motion, self._pushed, self._noted)
        self._in_table = tuple(map(in_plain, given))  # kept, as the table has but their addresses
        self._table = table_of(self._in_table)

    def watch(self, *limits: float) -> None:
        """Has steps beyond limits be new: see `held_table.Noted`."""
        self._noted.limits[:] = limits

    @staticmethod
    def of(
        body: ReducedDeformation,
        law: ElasticLaw,
        loads: ShapeLoads,
        solver: ContactSolver | None,
        points: Array,
        residual: ResidualMotion | None,
        found: FoundForces | None,
        *others: Any,
    ) -> "CompiledHeld | None":
        """Of such arguments; None where loops do not know how it deforms, or what touches.

        `solver`: what finds contact forces, if anything can touch; `points` and `residual` as in `HeldContact`;
        `found`: what finds forces of strokes, if any are given.
        """
        if not is_known(law, body):
            return None
        if residual is not None and not residual.is_whole:
            return None  # loops have the operators of all points as a whole
        pull = None if found is None else pull_of(found, *loads.dead.shape)
        if found is not None and pull is None:
            return None
        made = CompiledHeld(body, law, loads, pull, *others)
        return made if solver is None or made._meets(solver, points, residual) else None

    def _meets(self, solver: ContactSolver, points: Array, residual: ResidualMotion | None) -> bool:
        """Has steps find contact as of such arguments; whether loops know what touches."""
        given, knows = (points, residual, self._h), self.pull is None and self._elastic.is_exact
        if isinstance(solver, CompiledContact):
            self._met = HeldContact(solver, *given)
        elif isinstance(solver, CompiledSelfContact) and solver.is_alone and knows:
            self._met = HeldSelfContact(solver, *given, self._of_motion[1])
        return self._met is not None

    def forget(self) -> None:
        """What is known ahead, so that what follows is the same to the bit, whatever came before."""
        self.settle()
        self._is_known = False
        if self._met is not None:
            self._met.forget()

    @or_numpy
    def take(self, u: Array, start: Beginning) -> tuple[Step, ContactSolution | None] | None:
        """Takes a step under u (p,), with contact in it; None where it is to be taken otherwise."""
        among = self._begin(start)
        if among is None and self._met is not None:
            return None
        given = self._pushed, self._memory, *self._of_motion, among, self.pull
        step = take_step(self.body, in_plain(u), in_plain(start.halves), *given)
        if step.status >= OTHERWISE:
            self.forget()
            return None
        self._follow_tangent()
        self._hand_on()
        return step, None if self._met is None or among is None else self._met.keep(step, among)

    @or_numpy
    def take_alone(self, u: Array, halves: Array, tangent: Array) -> tuple[float, float, float, bool] | None:
        """Has e and r (2, m) be those after a step under u (p,) of a body that `is_alone`; None: NumPy is to take it.

        Twice the energy stored, supplied and dissipated, J, and whether the step `is_new`: see `held_table`.
        """
        if u.shape != (self.body.dead.shape[1],):
            raise ValueError(f"use {self.body.dead.shape[1]} numbers (got {u.shape})")
        if not (self._is_known and self._elastic.carried is self._carried and tangent is self.tangent):
            self._load(tangent)
        step = take_step_at(self._table, self._numbers, in_plain(u), halves)
        self._is_known = self._is_ahead = True
        if math.isnan(step[0]):
            self.forget()
            return None
        if step[3]:
            self._follow_tangent()
        return step

    @or_numpy
    def take_many(self, inputs: Array, start: Beginning, amounts: Array) -> HeldStepsTaken | None:
        """Takes steps under inputs (n, p) among obstacles on a path (`in_step`), as many as loops find; None: none.

        e and r are changed, and amounts of gas (n,). What that stores more is among what is supplied.
        """
        has_gas = self.pull is not None and len(self.pull.actuators.gases) > 0
        inputs = inputs.copy() if has_gas else in_plain(inputs)
        path, last, n, met, halves = start.obstacles, None, len(inputs), self._met, start.halves
        among = self._begin(start._replace(obstacles=None if path is None else path.in_step(0)))
        if among is None and met is not None:
            return None
        widths = (0, 0) if among is None else (among.beyond.shape[1], len(among.shapes))
        shapes = (n, 5), (n, len(self._pushed)), (n, 2), (n, widths[0]), (n, widths[1], 3), (n, len(start.reactions))
        taken = Taken(*map(np.empty, shapes))
        before = halves.copy(), None if among is None else among.beyond.copy()
        if met is not None and among is not None:
            among, last = met.for_many(among)
        along = None if among is None or path is None else Moving(*path)
        given = self._pushed, self._memory, *self._of_motion, among, self.pull, along, last, amounts, taken
        count, step = take_steps(self.body, inputs, halves, *given)
        if step.status == LOST:
            halves[:] = before[0]
            if among is not None:
                among.beyond[:] = before[1]
            self.forget()
        if step.status >= OTHERWISE:
            return None
        self._follow_tangent()
        self._hand_on()
        contact = None
        if met is not None and among is not None and path is not None and last is not None:
            contact = met.keep_last(step, among._replace(moving=Moving(*path.in_step(count - 1))), last)
        return HeldStepsTaken(Taken(*(rows[:count] for rows in taken)), step, contact)

    def _begin(self, start: Beginning) -> Among | None:
        """Has loops go on from what is carried; what a step is among, None: it is not known, or there is nothing."""
        if not (self._is_known and self._elastic.carried is self._carried and start.tangent is self.tangent):
            self._load(start.tangent)
        if self.pull is not None:
            self.pull.forces[:] = start.reactions
        if self._met is None or start.obstacles is None:
            return None
        self._met.set_pushed(self._pushed, start.touched)
        return self._met.among(start.obstacles)

    def _hand_on(self) -> None:
        """Has the law know what the last step that was taken carries along."""
        self._is_known, strains = True, self._strains
        if isinstance(self._elastic, SampledPoints):
            self._elastic.took(self.motion.e * self.body.inverse_ω, strains.velocity, strains.relaxed)
            self._carried = self._elastic.carried
            return
        self._carried = handed_on(strains.velocity, strains.carried, strains.numbers)
        self._elastic.took(self.motion.e * self.body.inverse_ω, self._carried, strains.relaxed, *self.noted)

    def settle(self) -> None:
        """Has the law know what steps that were taken alone carry along, the last one and that before it."""
        if not self._is_ahead:
            return
        assert isinstance(self._elastic, StrainsCarried)
        self._is_ahead, before = False, self._noted
        carried = handed_on(before.velocity, before.carried, before.numbers)
        self._elastic.took(before.halves[0] * self.body.inverse_ω, carried, before.relaxed, *self.noted)
        self._hand_on()

    @property
    def noted(self) -> tuple[tuple[float, float], bool]:
        """Of the last step: twice the energy of strains and the square of what is lacking, J; if it was as expected."""
        numbers = self._strains.numbers
        return (2 * numbers.item(AHEAD), numbers.item(GAP)), bool(numbers.item(HAS_TANGENT))

    def _follow_tangent(self) -> None:
        """Has T be what it is after the last step."""
        numbers = self._strains.numbers
        if not numbers.item(HAS_TANGENT):
            self.tangent = NONE
        elif numbers.item(MADE_TANGENT) or not len(self.tangent):
            self.tangent = self._strains.tangent.copy()

    @property
    def reactions(self) -> Array | None:
        """Forces (n,) of strokes in the last step, N; None: none are given."""
        return None if self.pull is None else self.pull.forces.copy()

    def pushed_by(self, touched: ContactSolution | None) -> Array:
        """Generalized forces (m,) of contact in the last step."""
        if self._met is not None:
            self._met.set_pushed(self._pushed, touched)
        return self._pushed

    def go_on(self, pushed: Array, touched: ContactSolution | None) -> None:
        """Has these forces (m,) be those of contact in the last step, to the bit."""
        if self._met is not None:
            self._met.know(touched)
            self._pushed[:] = pushed

    @property
    def touch(self) -> Touch | None:
        """Where obstacles can touch the body, as arrays; None: nowhere."""
        return None if self._met is None else self._met.touch

    @property
    def beyond(self) -> Array | None:
        """Velocities (P, 3) of the contact points beyond the basis in the last step, m/s; None where they have none."""
        return None if self._met is None else self._met.beyond

    def strokes_at(self, halves: Array) -> Array:
        """Of chambers, (n,), m³, where e and r are so (2, m)."""
        assert self.pull is not None
        strokes = np.empty((1, len(self.pull.forces)))
        set_strokes_of(self.pull, halves[None], self.body.inverse_ω, strokes)
        return strokes[0]

    def _load(self, tangent: Array) -> None:
        """Goes on from what another step carried along."""
        take_on(self._strains, self._elastic, tangent)
        self._carried, self.tangent = self._elastic.carried, tangent

    def expectation(self, reactions: Array, touched: bool) -> Expected:
        """What the last step was expected to be, under reactions and contact as they were; the law is told, too."""
        self.settle()
        strains, motion, law = self._strains, self.motion, self._elastic
        assert isinstance(law, StrainsCarried)
        of_T = strains.tangent.copy(), bool(strains.numbers[MADE_TANGENT])
        before, expected = law.velocity_before, strains.expected.copy()
        law.tell(expected, strains.matrix.copy())
        middle = motion.q + self._h / 2 * before
        return Expected(
            before, reactions, touched, middle, motion.residual.copy(), *of_T, motion.whole.copy(), expected
        )
