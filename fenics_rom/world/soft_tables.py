"""Tables of linear soft bodies of a world, as compiled steps take them (`world.compiled.soft_bodies`)."""

import math
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.frame_motion import ZERO
from fenics_rom.runtime.compiled.arrays_at import table_of
from fenics_rom.runtime.compiled.contact_points import Points
from fenics_rom.runtime.compiled.frames import LOOKED_AT, Body, Loads, Watch
from fenics_rom.runtime.steppers.carried_frame import CarriedFrame
from fenics_rom.runtime.steppers.compiled_frame import CompiledFrame
from fenics_rom.runtime.steppers.contact_midpoint import ContactMidpoint
from fenics_rom.runtime.steppers.frame_points import FramePoints
from fenics_rom.runtime.steppers.frame_state import FrameState
from fenics_rom.runtime.steppers.frame_table import ROWS
from fenics_rom.runtime.steppers.frame_touch import points_of
from fenics_rom.runtime.steppers.free_frame import FreeFrame
from fenics_rom.world.compiled.soft_bodies import TURNS, Step
from fenics_rom.world.soft import Soft


class SoftTable(NamedTuple):
    """A soft body as compiled steps take it."""

    kernel: CarriedFrame | FreeFrame | ContactMidpoint
    frame: CompiledFrame
    points: Points
    step: Step
    arrays: list[Array]  # all of them, which the table has the addresses of
    table: Array


def soft_table(body: Soft) -> SoftTable | None:
    """That of a body in steps of its length; None where there is more to it than compiled steps know."""
    kernel, interface = body.integrator.kernel, body.integrator.interface
    if interface is None or interface.environment.mark is not None:
        return None
    if isinstance(kernel, FreeFrame) or (isinstance(kernel, CarriedFrame) and body.carrier is not None):
        frame, rest, rows = kernel.take_by_loops(), kernel.points.rest, kernel.points.rows
    elif isinstance(kernel, ContactMidpoint) and body.carrier is None:
        frame, rest, rows = _held(body, kernel), interface.points.coordinates, kernel.arrays[1]
    else:
        return None
    if frame is None or (kernel.residual is not None and kernel.residual.relaxes):
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
    arrays = [*frame.arrays, *points, *step]
    return SoftTable(kernel, frame, points, step, arrays, table_of(arrays))


def _held(body: Soft, kernel: ContactMidpoint) -> CompiledFrame | None:
    """A body that nothing carries: its frame stands still."""
    if not kernel.answers_linearly or kernel.branches is not None or body.rom.rigid:
        return None
    (A, _, halves, before), model = kernel.arrays, body.model
    m, p = model.order, model.inputs.shape[1]
    push, D = np.zeros((p, m + 9)), model.damping
    push[:, :m] = model.inputs.T
    shapes = (10, m * m), (m, 10 * m), (m, 9 * m)
    products, by_rate, by_shape = (np.zeros(shape) for shape in shapes)
    ω, inverse_ω = np.sqrt(model.eigenvalues), 1 / model.safe_frequencies
    D = np.ascontiguousarray(np.diag(D) if D.ndim == 1 else D)
    inverse = np.ascontiguousarray(np.diag(A) if A.ndim == 1 else A)
    of_shape = ω, inverse_ω, D, products, by_rate, by_shape, inverse, np.zeros((ROWS, m)), np.zeros(9)
    loads = Loads(push, np.zeros((0, 0)), np.zeros(0, dtype=int), np.zeros((0, 3)), np.zeros((m, 0)))
    watch = Watch(0.0, math.inf, np.zeros((0, m)), np.zeros(LOOKED_AT + 1 + m))
    frame = CompiledFrame(
        Body(kernel.h, 1.0, False, math.inf, 0.0, *of_shape), loads, watch, halves, before, carried=True
    )
    position, rotation, *_ = body.mount
    frame.begin(FrameState(tuple(position.tolist()), tuple(rotation.tolist()), ZERO, ZERO), {})
    return frame
