"""Steps of a linear body among obstacles by one compiled function: what `ContactMidpoint` tries first."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import in_plain, jit, or_numpy
from fenics_rom.mechanics.actuator_forces import PointsHeldBack
from fenics_rom.mechanics.compiled.contact_law import FOUND, OTHERWISE, Law
from fenics_rom.mechanics.compiled.obstacle_motion import Moving
from fenics_rom.mechanics.compiled_contact import CompiledContact, Known, Told
from fenics_rom.mechanics.contact import ContactSolution, ObstacleMotion, PointMotion
from fenics_rom.mechanics.contact_pairs import Pairs as AskedPairs
from fenics_rom.mechanics.contact_pairs import SolvedPairs
from fenics_rom.mechanics.contact_search import ContactSearch
from fenics_rom.mechanics.gas import Gas, pressure_at
from fenics_rom.mechanics.kept_rows import RowsOperator
from fenics_rom.mechanics.points_operator import Operator
from fenics_rom.rom.block_rows import BlockRows
from fenics_rom.runtime.compiled import linear_actuators
from fenics_rom.runtime.compiled.arrays_at import table_of
from fenics_rom.runtime.compiled.block_products import Blocks
from fenics_rom.runtime.compiled.linear_step import Body, State, Step
from fenics_rom.runtime.compiled.linear_table import (
    OF_A_STEP,
    Record,
    Taken,
    after_in_record,
    arrays_of,
    numbers_of,
    record_in,
    size_of_record,
    take_step_at,
    take_steps_at,
)
from fenics_rom.runtime.compiled.near_points import Yielding
from fenics_rom.runtime.compiled.touching import NO_LAW, StepContact

if TYPE_CHECKING:
    from fenics_rom.mechanics.viscoelasticity import MaxwellBranches

set_strokes = jit(linear_actuators.set_strokes)
NO_OBSTACLES, NO_SHAPES = ObstacleMotion(*np.zeros((3, 0, 3))), np.zeros((0, 17))
NOTHING_BEGUN = np.zeros((0, 3)), np.zeros(0, dtype=np.int64)
LARGEST_CONDITION, MOST_ROWS = 1e8, 300  # of Delassus operators whose inverses are kept


def inverse_of(W: Array) -> Array:
    """Of a symmetric matrix (n, n); (0, 0) where it is large, or hardly tells forces apart."""
    if 0 < len(W) <= MOST_ROWS and np.isfinite(W).all():
        values, vectors = np.linalg.eigh(W)
        if values[0] * LARGEST_CONDITION > values[-1]:
            root = vectors / np.sqrt(values)
            return np.ascontiguousarray(root @ root.T)
    return np.empty((0, 0))


_NONE, _NOWHERE = np.empty(0), np.empty(0, int)
YIELDS_AS_A_WHOLE = Yielding(
    Blocks(_NOWHERE, np.empty((0, 6), int), _NONE), np.empty((0, 0)), _NOWHERE, np.empty((0, 3, 0)), _NOWHERE, 0.0, 0.0
)


def yielding_of(R: RowsOperator[BlockRows], roots: Array) -> Yielding:
    """Residual compliance as loops take it; roots: T (3P, m) of `near_points`."""
    kept, given = R.rows, R.rows.blocks
    table = np.column_stack([given.blocks, given.starts])
    values, base = given.values, given.values.base
    if isinstance(base, np.ndarray) and base.shape == values.shape:
        values = base  # of which it is a read-only view: loops but read it
    blocks = Blocks(*map(in_plain, (given.order, table, values)))
    farthest = float(np.linalg.norm(roots.reshape(len(kept.slots), -1), axis=1).max())
    return Yielding(blocks, roots, kept.slots, kept.rows, np.zeros_like(kept.slots), farthest, kept.floor)


class StepTaken:
    """A step that loops have taken; what contact did in it is told if someone asks.

    Args:
        record: of it.
        read: gives its parts.
        law: of contact.
        solver: that found it.
        search: with which it began.
        obstacles: how they moved.

    Attributes:
        did: what it did.
        touches: whether a pair took part.
    """

    __slots__ = ("_given", "did", "touches")

    def __init__(
        self,
        record: Array,
        read: Callable[[Array], Record],
        law: Law,
        solver: CompiledContact | None,
        search: ContactSearch | None,
        obstacles: ObstacleMotion,
    ):
        self.did = Step(*record[1:OF_A_STEP].tolist())
        self.touches = self.did.status == FOUND
        self._given = record, read, law, solver, search, obstacles

    def contact(self) -> ContactSolution:
        """What it did, where a pair took part."""
        _, _, law, solver, _, obstacles = self._given
        assert solver is not None
        seen = solver.seen(self._points().displacement, obstacles, law.h)
        return self._told().solution(obstacles.velocities(law.h), seen)

    def beyond(self) -> Array:
        """Velocities (P, 3) of the contact points beyond the basis, m/s."""
        return self._found.motion[3].reshape(-1, 3)

    def known(self, delassus: Callable[[], Operator]) -> Known:
        """As `ContactSolver.last_step`; `delassus` tells the operator of the points."""

        def known() -> tuple[AskedPairs | None, SolvedPairs | None]:
            if self._found.pairs.level[0] == -np.inf:  # out of reach, so that nobody asked
                return None, None
            _, _, law, solver, search, obstacles = self._given
            assert solver is not None
            assert search is not None
            return self._told().known(solver, search.forces, self._points, delassus(), law.h, obstacles)()

        return known

    @property
    def _found(self) -> StepContact:
        record, read, *_ = self._given
        return read(record).found

    def _told(self) -> Told:
        _, _, law, _, search, _ = self._given
        assert search is not None
        found, power, sweeps = self._found, self.did.normal_power if law.friction > 0 else None, int(self.did.sweeps)
        return Told(law, found.pairs, found.gaps, found.forces.reshape(-1, 3), sweeps, power, search.swung)

    def _points(self) -> PointMotion:
        return PointMotion(*self._found.motion[:3].reshape(3, -1, 3))


class StepsTaken(NamedTuple):
    """Steps in a row."""

    steps: Taken
    last: StepTaken


class Relaxing:
    """Strains of the branches of a material as loops have them.

    Args:
        branches: whose strains they are; None: there are none.
        count: N of them.
        size: of the strain of each.

    Attributes:
        rows, rows_before: of each its strain and the force of that (N, 2, size), now and before the last step.
    """

    def __init__(self, branches: "MaxwellBranches | None", count: int, size: int):
        self._branches = branches
        self.rows, self.rows_before = np.zeros((2, count, 2, size))

    def begin(self) -> None:
        """Has the loops go on from where the branches are."""
        if self._branches is not None:
            self.rows[:, : self._branches.state.shape[1]] = self._branches.state

    def end(self) -> None:
        """Has the branches be where the loops went."""
        if self._branches is not None:
            kept = self._branches.state.shape[1]
            for rows in (self.rows_before, self.rows):
                self._branches.took(rows[:, :kept].copy())


class CompiledStep:
    """Steps of h s of a body.

    Args:
        body: what moves.
        operator: the Delassus operator of its points.
        state: what steps change, and where they note it before.
        solver: finds contact forces; None: nothing can touch.
        h: s.
        relaxing: branches of its material, whose strains are in the state.

    Attributes:
        body, state: as given.
    """

    def __init__(
        self,
        body: Body,
        operator: Operator,
        state: State,
        solver: CompiledContact | None,
        h: float,
        relaxing: Sequence[Relaxing],
    ):
        self.body, self.state, self._solver, self._h, self._relaxing = body, state, solver, h, relaxing
        self._operator, self._rows = operator, operator.rows if isinstance(operator, RowsOperator) else None
        shapes, self._points = NO_SHAPES if solver is None else solver.shapes, len(body.places)
        self._pairs, self._nothing = len(shapes) * self._points, NO_LAW._replace(h=h)
        self._size, self._after = size_of_record(self._pairs, self._points), after_in_record(self._pairs, self._points)
        self._friction = np.empty(self._pairs)
        self._arrays = arrays_of(body, state, shapes, self._friction)  # kept, as the table has but addresses
        self._table, self._law = table_of(self._arrays), self._law_now
        self._know_law()

    @property
    def _law_now(self) -> Law:
        return self._nothing if self._solver is None else self._solver.law_in_steps(self._h)

    def _know_law(self) -> None:
        """Has the numbers and the friction of the table be those of the law."""
        self._numbers = numbers_of(self._law, self.body)
        self._friction[:] = self._law.friction

    def _begin(self, reactions: Array) -> tuple[Array, Array]:
        """What steps begin with by the law as it is: forces, and how often pairs swung; `reactions` as in `take`."""
        law = self._law_now
        if law is not self._law:
            self._law = law
            self._know_law()
        for each in self._relaxing:
            each.begin()
        if len(self.state.reactions):
            self.state.reactions[:] = reactions
        solver = self._solver
        return NOTHING_BEGUN if solver is None else (solver.search.forces, solver.swung(solver.search))

    @or_numpy
    def take(self, u: Array, obstacles: ObstacleMotion | None, reactions: Array) -> StepTaken | None:
        """Takes a step under u (p,); None where the loops do not find its forces, and nothing is changed.

        `reactions` are forces (n,) that the step before has found.
        """
        begun, record, moving = self._begin(reactions), np.empty(self._size), obstacles or NO_OBSTACLES
        take_step_at(self._table, self._numbers, in_plain(u), *moving, *begun, record)
        search = None if self._solver is None else self._solver.search
        return None if record.item(1) == OTHERWISE else self._note(record, search, moving, u)

    @or_numpy
    def take_many(
        self, inputs: Array, path: ObstacleMotion | None, reactions: Array, amounts: Array
    ) -> StepsTaken | None:
        """Takes steps under inputs (n, p) among obstacles on a path (`in_step`), as many as loops find; None: none.

        `amounts`: of gas (n,), changed, and what gas stores more is among what is supplied.
        """
        inputs = inputs.copy() if len(self.body.pulled.actuators.gases) else in_plain(inputs)
        begun, solver, records, n = self._begin(reactions), self._solver, np.empty((3, self._size)), len(inputs)
        path = path or ObstacleMotion(*(part[None] for part in NO_OBSTACLES))
        first = self._in(records[2]).after
        first.forces[:], first.swung[:] = begun
        taken = Taken(np.empty((n, 5)), np.empty((n, len(self.body.ω))), np.empty((n, len(self.body.R))))
        count = take_steps_at(self._table, self._numbers, inputs, Moving(*path), records, amounts, taken)
        if not count:
            return None
        forces, swung = self._in(records[(count + 1) % 3]).after
        search = None
        if solver is not None:
            solver.search = search = solver.search._replace(forces=forces, swung=swung if swung.any() else None)
        last = self._note(records[(count + 2) % 3], search, path.in_step(count - 1), inputs[count - 1])
        return StepsTaken(Taken(*(rows[:count] for rows in taken)), last)

    @property
    def strokes(self) -> Array:
        """Of what forces are found (n,), m or m³, where the body is."""
        found = np.empty(len(self.body.pulled.W))
        set_strokes(self.body.pulled, self.state.halves[0], self.state.rigid, self.body.inverse_ω, found)
        return found

    def _delassus(self, holding: int, gives: Array | None) -> Operator:
        """The operator of the contact points with which contact was found: see `Step.holding`, and `_gives`."""
        if not holding:
            return self._operator
        pulled = self.body.pulled
        holds = np.array([bool(holding & 1 << k) for k in range(len(pulled.W))])
        return PointsHeldBack(self._operator, pulled.X.T, pulled.W).delassus(holds, gives)

    def _gives(self, u: Array) -> Array | None:
        """What gas gives way by (n,) in the last step, under u (p,), m³/s/Pa; None where there is none."""
        pulled, state = self.body.pulled, self.state
        gases = pulled.actuators.gases
        if not len(gases):
            return None
        gives, ends, ρ = np.zeros(len(pulled.W)), np.empty((2, len(pulled.W))), len(state.rigid)
        for strokes, (e, _), rigid in zip(
            ends, (state.halves_before, state.halves), (state.rigid_before, state.rigid), strict=True
        ):
            q = e * self.body.inverse_ω
            q[:ρ] = rigid
            strokes[:] = pulled.lines.dot(q)
        for place, *of in gases.tolist():
            k = int(place)
            amount, (start, end) = u.item(pulled.actuators.columns[k]), ends[:, k].tolist()
            gives[k] = -1 / (self._h * pressure_at(Gas(*of), amount, start, end, False)[1])
        return gives

    def _in(self, record: Array) -> Record:
        return record_in(record, self._pairs, self._points, self._friction)

    def _note(self, record: Array, search: ContactSearch | None, obstacles: ObstacleMotion, u: Array) -> StepTaken:
        """A step under u (p,) that began with a search; the next one begins with what it found."""
        solver, after = self._solver, self._after
        for each in self._relaxing:
            each.end()
        step = StepTaken(record, self._in, self._law, solver, search, obstacles)
        if solver is None or search is None:
            return step
        forces, swung = search.forces, None
        if step.touches:
            forces = record[after[0]].reshape(-1, 3)
            swung = record[after[1]].view(np.int64) if record.item(OF_A_STEP) else None
        delassus = partial(self._delassus, int(step.did.holding), self._gives(u) if step.touches else None)
        solver.note(step.known(delassus), step.touches, forces, swung)
        self.keep_rows()
        return step

    def keep_rows(self) -> None:
        """Keeps rows of R of points that touched, and of which there were none, for the steps that follow."""
        if self._rows is not None and (missing := self.body.yielding.missing).any():
            self._rows.keep(missing.nonzero()[0])
            missing[:] = 0
