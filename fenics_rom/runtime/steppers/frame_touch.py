"""Contact of linear bodies in moving frames, as their compiled steps are told of it, and tell of it."""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import in_plain
from fenics_rom.mechanics.compiled.obstacle_motion import Moving
from fenics_rom.mechanics.compiled_contact import CompiledContact
from fenics_rom.mechanics.contact import ContactSolution, ObstacleMotion
from fenics_rom.mechanics.kept_rows import RowsOperator
from fenics_rom.rom.block_rows import BlockRows
from fenics_rom.runtime.compiled.contact_points import Points
from fenics_rom.runtime.compiled.touched_frame import Among, Touched
from fenics_rom.runtime.compiled.touching import Last, StepContact
from fenics_rom.runtime.steppers.contact_in_loops import ContactInLoops
from fenics_rom.runtime.steppers.frame_points import FramePoints
from fenics_rom.runtime.steppers.residual_motion import ResidualMotion


def points_of(points: FramePoints, residual: ResidualMotion | None) -> Points:
    """Contact points of a body as compiled steps take them."""
    rest, rows = in_plain(points.rest), in_plain(points.rows)
    P, m = len(rest), len(rows)
    R, times, beyond, slots = np.empty((0, 0, 0)), np.zeros(4), (np.zeros((4, 0)), np.zeros((4, 0))), np.arange(P)
    if residual is not None:
        (R, slots), times, beyond = _rows_of(residual.part.operator), np.array(residual.times), residual.states
    moved: list[Array] = [np.zeros((P, 3)) for _ in range(5)]
    moved += [np.zeros(P), np.zeros((m, 3 * P)), np.zeros(P), slots]
    return Points(rest, rows, R, times, *beyond, *moved)


def _rows_of(R: Array | RowsOperator[BlockRows]) -> tuple[Array, Array]:
    """Rows of R of points that are kept, (slots, 3, 3P), and where those of each are, (P,): of an array all are."""
    if isinstance(R, RowsOperator):
        return R.rows.rows, R.rows.slots
    P = len(R) // 3
    return in_plain(R).reshape(P, 3, 3 * P), np.arange(P)


class FrameTouch(ContactInLoops):
    """Arguments as in ContactInLoops.

    Args:
        points: where a body can be touched.

    Attributes:
        points: as above.
        at_rest: places of these in world axes (P, 3), m.
    """

    def __init__(self, solver: CompiledContact, points: Points, h: float):
        super().__init__(solver, h)
        self.points, self.at_rest = points, in_plain(solver.points)

    @property
    def touched(self) -> Array:
        """Mid-step velocities (P, 3) of the points in world axes in the last step, m/s."""
        return self._rates.reshape(-1, 3)

    def among(self, obstacles: ObstacleMotion) -> Among:
        """What a step is told, and where it tells what it found."""
        W = np.empty((self.at_rest.size, self.at_rest.size))  # another one each time, as the solver keeps parts of it
        law, shapes, begun, found = self._law, self._solver.shapes, self._begun(), self._for_found()
        return Among(law, shapes, Moving(*obstacles), begun, self.points, self.at_rest, found, W)

    def for_many(self, among: Among) -> tuple[Among, Last]:
        """The same for steps in a row, which change what they begin with; and where the last one is kept."""
        begun, last = self._for_many()
        return among._replace(begun=begun), last

    def keep(self, touched: Touched, among: Among, found: StepContact) -> ContactSolution | None:
        """Contact of a step that was taken, and found this; the next search begins with it."""
        return self._keep(
            found, among.W, ObstacleMotion(*among.moving), touched.contact.sweeps, touched.contact.normal_power
        )

    def keep_last(
        self, touched: Touched, obstacles: ObstacleMotion, among: Among, last: Last
    ) -> ContactSolution | None:
        """The same of steps in a row, the last of them among obstacles that move so."""
        self._begin_last(last.begun)
        return self.keep(touched, among._replace(moving=Moving(*obstacles)), last.found)
