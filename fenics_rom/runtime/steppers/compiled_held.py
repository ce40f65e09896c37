"""Steps of a held body whose strains are carried along by one compiled function: what `HeldBody` tries first."""

from collections.abc import Sequence
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import in_plain, or_numpy
from fenics_rom.mechanics.compiled.contact_law import OTHERWISE
from fenics_rom.mechanics.compiled_contact import CompiledContact
from fenics_rom.mechanics.contact import ContactSolution, ObstacleMotion
from fenics_rom.mechanics.contact_solver import ContactSolver
from fenics_rom.mechanics.tendon import cable_length
from fenics_rom.rom.carried_strains import MonomialStrains
from fenics_rom.rom.deformation import ReducedDeformation, ReducedTendon
from fenics_rom.rom.strain_tables import StrainTables
from fenics_rom.runtime.compiled.arrays_at import table_of
from fenics_rom.runtime.compiled.carried_strains import (
    GAP,
    HAS_TANGENT,
    IS_AHEAD,
    MADE_TANGENT,
    NUMBERS,
    Law,
    Memory,
    strains_in,
)
from fenics_rom.runtime.compiled.following import Following
from fenics_rom.runtime.compiled.held_step import Among, Body, Step, Touch, motion_in, take_step
from fenics_rom.runtime.compiled.held_steps import Taken, take_steps
from fenics_rom.runtime.compiled.held_table import arrays_of, take_step_at
from fenics_rom.runtime.compiled.material_points import Points
from fenics_rom.runtime.compiled.strain_tables import folded, padded
from fenics_rom.runtime.compiled.strokes import Pull
from fenics_rom.runtime.compiled.touching import LOST
from fenics_rom.runtime.steppers.acts.following import FollowingLoads, Pressure
from fenics_rom.runtime.steppers.acts.found_forces import FoundForces
from fenics_rom.runtime.steppers.acts.shape_loads import ShapeLoads
from fenics_rom.runtime.steppers.adjoint import NONE
from fenics_rom.runtime.steppers.deformation_maps import E_OF_Q, Carried, Expected
from fenics_rom.runtime.steppers.elastic.carried_strains import StrainsCarried
from fenics_rom.runtime.steppers.held_contact import HeldContact
from fenics_rom.runtime.steppers.residual_motion import ResidualMotion

LAWS = "st_venant_kirchhoff", "neo_hookean"  # that are compiled


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
        contact: how obstacles touch it; None: they cannot.
        pull: cables and chambers whose strokes are given; None: there are none.
        ω: (m,), 1/s.
        inverse_ω: (m,), s.
        h: s.

    Attributes:
        body: what is held, as arrays.
        motion: of the last step.
        tangent: T (m, m) that the next step is expected with; empty: it is to be made.
    """

    def __init__(
        self,
        body: ReducedDeformation,
        law: StrainsCarried,
        loads: ShapeLoads,
        contact: HeldContact | None,
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
            _following(loads.following, m, [] if pull is None else pull.columns.tolist()),
            _law(body, law, h),
        )
        self._memory = _memory(m)
        self._of_motion = np.zeros((8, m)), np.zeros((m, m))
        self.motion, self._strains = motion_in(*self._of_motion), strains_in(self._memory)
        self.tangent, self._carried = NONE, law.carried
        self._met, self._pull = contact, pull
        given = arrays_of(self.body, self._memory, self._of_motion, self._pushed)
        self._in_table = tuple(map(in_plain, given))  # kept, as the table has but their addresses
        self._table, self._numbers = table_of(self._in_table), np.array(self.body.law[:5], dtype=float)
        self.forget()

    @staticmethod
    def of(
        body: ReducedDeformation,
        law: StrainsCarried,
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
        knows = body.law in LAWS and law.branches is None and isinstance(law.strains, MonomialStrains)
        if not (knows and (solver is None or isinstance(solver, CompiledContact))):
            return None
        pull = None if found is None else _pull(found, *loads.dead.shape)
        if found is not None and pull is None:
            return None
        contact = None if solver is None else HeldContact(solver, points, residual, others[-1])
        return CompiledHeld(body, law, loads, contact, pull, *others)

    def forget(self) -> None:
        """What is known ahead, so that what follows is the same to the bit, whatever came before."""
        self._is_known = False
        if self._met is not None:
            self._met.forget()

    @or_numpy
    def take(self, u: Array, start: Beginning) -> tuple[Step, ContactSolution | None] | None:
        """Takes a step under u (p,), with contact in it; None where it is to be taken otherwise."""
        among = self._begin(start)
        if among is None and self._met is not None:
            return None
        if among is None and self._pull is None:
            step = take_step_at(self._table, self._numbers, in_plain(u), in_plain(start.halves))
        else:
            given = self._pushed, self._memory, *self._of_motion, among, self._pull
            step = take_step(self.body, in_plain(u), in_plain(start.halves), *given)
        if step.status >= OTHERWISE:
            self.forget()
            return None
        self._hand_on(step)
        return step, None if self._met is None or among is None else self._met.keep(step, among)

    @or_numpy
    def take_many(self, inputs: Array, start: Beginning) -> HeldStepsTaken | None:
        """Takes steps under inputs (n, p) among obstacles that stand still, as many as loops find; None: none.

        e and r are changed.
        """
        among, last, n, met, halves = self._begin(start), None, len(inputs), self._met, start.halves
        if among is None and met is not None:
            return None
        widths = (0, 0) if among is None else (among.beyond.shape[1], len(among.shapes))
        shapes = (n, 5), (n, len(self._pushed)), (n, 2), (n, widths[0]), (n, widths[1], 3), (n, len(start.reactions))
        taken = Taken(*map(np.empty, shapes))
        before = halves.copy(), None if among is None else among.beyond.copy()
        if met is not None and among is not None:
            among, last = met.for_many(among)
        given = self._pushed, self._memory, *self._of_motion, among, self._pull, last, taken
        count, step = take_steps(self.body, in_plain(inputs), halves, *given)
        if step.status == LOST:
            halves[:] = before[0]
            if among is not None:
                among.beyond[:] = before[1]
            self.forget()
        if step.status >= OTHERWISE:
            return None
        self._hand_on(step)
        contact = None
        if met is not None and among is not None and last is not None:
            contact = met.keep_last(step, among, last)
        return HeldStepsTaken(Taken(*(rows[:count] for rows in taken)), step, contact)

    def _begin(self, start: Beginning) -> Among | None:
        """Has loops go on from what is carried; what a step is among, None: it is not known, or there is nothing."""
        if not (self._is_known and self._elastic.carried is self._carried and start.tangent is self.tangent):
            self._load(self._elastic.carried, start.tangent)
        if self._pull is not None:
            self._pull.forces[:] = start.reactions
        if self._met is None or start.obstacles is None:
            return None
        self._met.set_pushed(self._pushed, start.touched)
        return self._met.among(start.obstacles)

    def _hand_on(self, step: Step) -> None:
        """Has the law know what the last step that was taken carries along."""
        self._is_known, numbers = True, self._strains.numbers
        left, c, tank, energy, is_carried, ahead, *_ = numbers.tolist()
        strained = self._strains.carried.copy() if is_carried else E_OF_Q
        self._carried = Carried(self._strains.velocity.copy(), strained, left, c, tank, energy)
        if not numbers.item(HAS_TANGENT):
            self.tangent = NONE
        elif numbers.item(MADE_TANGENT) or not len(self.tangent):
            self.tangent = self._strains.tangent.copy()
        noted = 2 * ahead, numbers.item(GAP)
        self._elastic.took(self.motion.e * self.body.inverse_ω, self._carried, noted, step.went_as_expected)

    @property
    def reactions(self) -> Array | None:
        """Forces (n,) of strokes in the last step, N; None: none are given."""
        return None if self._pull is None else self._pull.forces.copy()

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

    def _load(self, carried: Carried, tangent: Array) -> None:
        """Goes on from what another step carried along."""
        strains, numbers = self._strains, self._strains.numbers
        strains.velocity[:] = carried.velocity
        numbers[:5] = *carried[2:], len(carried.strained) > 0
        if len(carried.strained):
            strains.carried[:] = carried.strained
        numbers[IS_AHEAD], numbers[HAS_TANGENT], self.tangent = 0.0, len(tangent) > 0, tangent
        if len(tangent):
            strains.tangent[:] = tangent

    def expectation(self, reactions: Array, touched: bool) -> Expected:
        """What the last step was expected to be, under reactions and contact as they were; the law is told, too."""
        strains, motion, law = self._strains, self.motion, self._elastic
        of_T = strains.tangent.copy(), bool(strains.numbers[MADE_TANGENT])
        before, expected = law.velocity_before, strains.expected.copy()
        law.tell(expected, strains.matrix.copy())
        middle = motion.q + self._h / 2 * before
        return Expected(
            before, reactions, touched, middle, motion.residual.copy(), *of_T, motion.whole.copy(), expected
        )


def _memory(m: int) -> Memory:
    n = (m + 1) * (m + 2) // 2
    sizes = (9, m), (m, m), (2, n - 1), (NUMBERS,), (2, padded(n)), (3, m, m), (4, padded(n))
    return Memory(*map(np.zeros, sizes))


def _tables_of(body: ReducedDeformation, tables: StrainTables) -> tuple[Array, Array]:
    """Folded stiffness and gram of a body, made once."""
    if body not in _folded:
        _folded[body] = folded(tables.stiffness / tables.half), folded(tables.gram, first=1)
    return _folded[body]


_folded: WeakKeyDictionary[ReducedDeformation, tuple[Array, Array]] = WeakKeyDictionary()


def _law(body: ReducedDeformation, law: StrainsCarried, h: float) -> Law:
    assert isinstance(law.strains, MonomialStrains)
    most, P = 0.0, 0
    if law.points is not None:
        most, P = law.points.most, len(body.weights)
    gradients = body.gradients[:, :, :P].reshape(-1, body.order).T.copy()
    points = Points(gradients, np.stack([body.weights * body.first_lame, body.weights * body.shear])[:, :P].copy())
    return Law(
        h,
        law.strains.viscosity,
        body.training_radius,
        most,
        law.steepest,
        body.external_damping.copy(),
        body.springs.copy(),
        law.steady.copy(),
        *_tables_of(body, law.strains.tables),
        points,
    )


def _pull(found: FoundForces, m: int, p: int) -> Pull | None:
    """Of p inputs, as arrays; None where more is found than forces of cables that do not rub, and of chambers."""
    followers, columns = found.followers, found.actuators.columns % p
    tendons = [each for each in followers if isinstance(each, ReducedTendon)]
    chambers = [each.polynomial for each in followers if isinstance(each, Pressure)]
    if found.actuators.guides or len(tendons) + len(chambers) < max(len(followers), 1):
        return None
    is_chamber = np.array([isinstance(each, Pressure) for each in followers])
    counts = [len(each.points) - 1 if isinstance(each, ReducedTendon) else 0 for each in followers]
    (at_rest, shapes, of_cables), polynomials = _segments(tendons, m), _polynomials(chambers, m)
    n, starts, lengths = len(followers), np.cumsum([0, *counts]), np.zeros(len(followers))
    lengths[~is_chamber] = of_cables
    numbers = np.where(is_chamber, is_chamber.cumsum() - 1, -1)
    sizes = (polynomials.shape[2],), (n,), (n,), (n,), (n, m), (n, m), (n, n)
    return Pull(columns, numbers, starts, at_rest, shapes, lengths, polynomials, *map(np.zeros, sizes))


def _polynomials(pressures: Sequence[Array], m: int) -> Array:
    """Of forces of pressures (c, m, N), of products of which squares have the half."""
    n = (m + 1) * (m + 2) // 2
    polynomials = np.array(pressures).reshape(len(pressures), m, n)
    polynomials[:, :, np.cumsum([0, *range(m + 1, 1, -1)])] *= 2
    return polynomials


def _segments(tendons: Sequence[ReducedTendon], m: int) -> tuple[Array, Array, Array]:
    """Of cables: segments at rest (s, 3), m, what they are with q (s, 3, m), and lengths of the cables at rest, m."""
    at_rest = [np.diff(each.points, axis=0) for each in tendons]
    shapes = [np.diff(each.shapes.reshape(-1, 3, m), axis=0) for each in tendons]
    lengths = np.array([cable_length(each.points) for each in tendons])
    return np.concatenate([np.empty((0, 3)), *at_rest]), np.concatenate([np.empty((0, 3, m)), *shapes]), lengths


def _following(loads: FollowingLoads | None, m: int, found: Sequence[int]) -> Following:
    """As arrays, but for what acts in some columns."""
    followers = [] if loads is None else [each for each in loads.followers if each[0] not in found]
    pressures = [(column, each.polynomial) for column, each in followers if isinstance(each, Pressure)]
    tendons = [(column, each) for column, each in followers if isinstance(each, ReducedTendon)]
    columns = [np.full(len(each.points) - 1, column) for column, each in tendons]
    return Following(
        np.array([column for column, _ in pressures], dtype=np.int64),
        _polynomials([each for _, each in pressures], m),
        np.concatenate([np.empty(0, dtype=np.int64), *columns]),
        *_segments([each for _, each in tendons], m)[:2],
    )
