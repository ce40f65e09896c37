"""Tables of soft bodies of a world, as compiled steps take them (`world.compiled.soft_bodies`)."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import in_plain
from fenics_rom.mechanics.contact import ContactSolution
from fenics_rom.mechanics.frame_motion import ZERO, rotation_matrix
from fenics_rom.mechanics.kept_rows import RowsOperator
from fenics_rom.mechanics.viscoelasticity import MaxwellBranches
from fenics_rom.runtime.compiled.arrays_at import table_of
from fenics_rom.runtime.compiled.contact_points import Points
from fenics_rom.runtime.compiled.frame_tables import ROWS as FRAME_ROWS
from fenics_rom.runtime.compiled.frames import LOOKED_AT, Body, Loads, Watch
from fenics_rom.runtime.steppers.bent_in_loops import BentInLoops
from fenics_rom.runtime.steppers.carried_frame import CarriedFrame
from fenics_rom.runtime.steppers.compilable_frame import CompilableFrame
from fenics_rom.runtime.steppers.compiled_frame import CompiledFrame
from fenics_rom.runtime.steppers.compiled_step import Relaxing
from fenics_rom.runtime.steppers.contact_midpoint import ContactMidpoint
from fenics_rom.runtime.steppers.frame_points import FramePoints
from fenics_rom.runtime.steppers.frame_state import FrameState
from fenics_rom.runtime.steppers.frame_table import ROWS
from fenics_rom.runtime.steppers.frame_touch import points_of
from fenics_rom.runtime.steppers.free_frame import FreeFrame
from fenics_rom.runtime.steppers.held import HeldBody
from fenics_rom.world.compiled.relaxing_bodies import Relaxed
from fenics_rom.world.compiled.soft_bodies import PULLED, RELAXED, TURNS, Step
from fenics_rom.world.compiled.soft_bodies import ROWS as WORLD_ROWS
from fenics_rom.world.handed_forces import Handed, handed_in
from fenics_rom.world.soft import Soft


class HeldBent(BentInLoops):
    """What a held body carries along that deforms largely: contact is told in its axes, and loops have the world's.

    Args:
        kernel: of the body.
        R: its axes (3, 3).
        others: as of BentInLoops.
    """

    def __init__(self, kernel: HeldBody, R: Array, *others: Any):
        self._kernel, self._R = kernel, R
        super().__init__(*others)

    def press(self, contact: ContactSolution | None) -> None:
        """As in BentInLoops."""
        self._contact, self.arrays.pressed[:] = contact, 0.0 if contact is None else contact.forces.dot(self._R.T)

    def tell_loops(self) -> None:
        """As in CompilableFrame."""
        self.begin(self._kernel.contact, None)

    def end_in_world(self, u: Array, square: float, within: float) -> None:
        """As in CompilableFrame."""
        self._kernel.end_in_world(u, self)

    def contact(self, forces: Array) -> Handed | None:
        """What forces (P, 3) in world axes are to the body."""
        return handed_in(forces.dot(self._R))


class HeldBeside:
    """What a held body of small strains has beside its shape.

    These are branches of its material, within its basis and beyond, and forces that are found in steps.

    Attributes:
        arrays: what `Relaxed` and `PulledHere` are made of, by their first row in the table.
    """

    def __init__(self, kernel: ContactMidpoint):
        self._kernel, self._relaxing, self.arrays = kernel, list[Relaxing](), dict[int, list[Array]]()
        self._reactions = np.zeros_like(kernel.reactions)
        if kernel.branches is not None:
            self._relax(kernel, kernel.branches)
        if n := len(self._reactions):
            of = kernel.pulled
            self.arrays[PULLED] = [*of.actuators, *of[1:], self._reactions, np.zeros(n), np.zeros(n)]

    def _relax(self, kernel: ContactMidpoint, branches: MaxwellBranches) -> None:
        N, (m, n), residual = len(branches.state), kernel.arrays[1].shape, kernel.residual
        within = Relaxing(branches, N, m)
        beyond = Relaxing(None if residual is None else residual.branches, N, 0 if residual is None else n)
        share, numbers = np.empty((0, 0)) if branches.share is None else in_plain(branches.share), branches.numbers
        self._relaxing = [within, beyond]
        of_both = within.rows, within.rows_before, beyond.rows, beyond.rows_before
        self.arrays[RELAXED] = [*Relaxed(numbers, share, *of_both)]

    def tell_loops(self) -> None:
        """As in CompilableFrame."""
        for each in self._relaxing:
            each.begin()
        self._reactions[:] = self._kernel.reactions

    def end_in_world(self, u: Array, square: float, within: float) -> None:
        """As in CompilableFrame."""
        for each in self._relaxing:
            each.end()
        if len(self._reactions):
            self._kernel.reactions = self._reactions.copy()


class SoftTable(NamedTuple):
    """A soft body as compiled steps take it."""

    kernel: CarriedFrame | FreeFrame | ContactMidpoint | HeldBody
    frame: CompiledFrame
    beside: CompilableFrame | HeldBent | HeldBeside | None  # what is told when compiled steps begin and end
    points: Points
    step: Step
    arrays: list[Array]  # all of them, which the table has the addresses of
    table: Array

    def keep_rows(self) -> None:
        """Keeps the rows of residual compliance that compiled steps ask for."""
        residual = self.kernel.residual
        R = None if residual is None else residual.part.operator
        if isinstance(R, RowsOperator):
            R.rows.keep_wanted()


def soft_table(body: Soft) -> SoftTable | None:
    """That of a body in steps of its length; None where there is more to it than compiled steps know."""
    kernel, interface = body.integrator.kernel, body.integrator.interface
    if interface is None or interface.environment.mark is not None:
        return None
    if isinstance(kernel, FreeFrame) or (isinstance(kernel, CarriedFrame) and body.carrier is not None):
        frame, rest, rows = kernel.take_by_loops(), kernel.points.rest, kernel.points.rows
    elif isinstance(kernel, ContactMidpoint) and body.carrier is None:
        frame, rest, rows = _held(body, kernel), interface.points.coordinates, kernel.arrays[1]
    elif isinstance(kernel, HeldBody):
        frame, rest, rows = _held_largely(body, kernel), interface.points.coordinates, kernel.of_points
    else:
        return None
    if frame is None:
        return None
    held = HeldBeside(kernel) if isinstance(kernel, ContactMidpoint) else None
    if held is None and kernel.residual is not None and kernel.residual.relaxes:
        return None
    of_body, loads = frame.parts
    m, P, p = len(of_body.ω), len(rest), loads.push.shape[0]
    points = points_of(FramePoints(rest, rows), kernel.residual)
    mount = np.concatenate(body.mount)
    rates = np.zeros(m), np.zeros(m), np.zeros(3 + m if isinstance(kernel, FreeFrame) else m)
    triangles = np.ascontiguousarray(body.contact_triangles, dtype=np.int64)
    assert body.surface.rounding is not None
    moving = np.zeros((P, 3)), np.zeros((P, 3)), np.zeros(5), triangles, *body.surface.rounding
    step = Step(np.zeros(p), mount, mount.copy(), np.zeros(TURNS), *rates, *moving)
    linear, bent = frame.arrays[:FRAME_ROWS], frame.arrays[FRAME_ROWS:]
    arrays, table = [*linear, *points, *step, *bent], np.zeros((WORLD_ROWS, 4), dtype=np.int64)
    table[: len(arrays)] = table_of(arrays)
    for first, more in held.arrays.items() if held is not None else ():
        arrays += more
        table[first : first + len(more)] = table_of(more)
    beside = kernel if isinstance(kernel, CompilableFrame) else frame.bent or (held if held and held.arrays else None)
    assert beside is None or isinstance(beside, CompilableFrame | HeldBent | HeldBeside)
    return SoftTable(kernel, frame, beside, points, step, arrays, table)


def _held(body: Soft, kernel: ContactMidpoint) -> CompiledFrame | None:
    """A linear body that nothing carries: its frame stands still."""
    if body.rom.rigid or kernel.has_gas:
        return None
    (A, _, halves, before), D, pushed = kernel.arrays, body.model.damping, body.model.inputs.T
    if len(kernel.reactions):
        pushed = pushed.copy()
        pushed[kernel.pulled.actuators.columns] = 0.0
    D, A = (np.ascontiguousarray(np.diag(each) if each.ndim == 1 else each) for each in (D, A))
    m = body.model.order
    return _still(body, pushed, D, np.zeros((10, m * m)), A, (halves, before), None)


def _held_largely(body: Soft, kernel: HeldBody) -> CompiledFrame | None:
    """The same of one that deforms largely."""
    m, R = body.model.order, rotation_matrix(body.mount.rotation)
    given = kernel.in_world()
    if given is None:
        return None
    products = np.zeros((10, m * m))
    products[9] = 2 / kernel.h * np.eye(m).ravel()
    held = HeldBent(kernel, R, *given)
    return _still(body, kernel.loads.dead.T, np.zeros((m, m)), products, np.zeros((m, m)), kernel.halves, held)


def _still(
    body: Soft, pushed: Array, D: Array, products: Array, inverse: Array, halves: tuple[Array, Array], bent: Any
) -> CompiledFrame:
    """A body in a frame that stands still; arguments as of `frames.Body`, but for forces (p, m) of its inputs."""
    model, (p, m) = body.model, pushed.shape
    push, by_rate, by_shape = np.zeros((p, m + 9)), np.zeros((m, 10 * m)), np.zeros((m, 9 * m))
    push[:, :m] = pushed
    ω, inverse_ω = np.sqrt(model.eigenvalues), 1 / model.safe_frequencies
    of_shape = ω, inverse_ω, D, products, by_rate, by_shape, inverse, np.zeros((ROWS, m)), np.zeros(9)
    loads = Loads(push, np.zeros((0, 0)), np.zeros(0, dtype=int), np.zeros((0, 3)), np.zeros((m, 0)))
    watch = Watch(0.0, math.inf, np.zeros((0, m)), np.zeros(LOOKED_AT + 1 + m))
    frame = CompiledFrame(
        Body(body.dt, 1.0, False, math.inf, 0.0, *of_shape), loads, watch, *halves, carried=True, bent=bent
    )
    position, rotation, *_ = body.mount
    frame.begin(FrameState(tuple(position.tolist()), tuple(rotation.tolist()), ZERO, ZERO), {})
    return frame
