"""The constants of a moving frame in a basis, from X, M and K alone; see rom.moving_frame."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.voigt import VOIGT_PAIRS
from fenics_rom.reduction.problem import ReductionProblem
from fenics_rom.rom.moving_frame import MovingFrame
from fenics_rom.rom.rom import Rom
from fenics_rom.system.moving_frame import FullOrderFrame
from fenics_rom.system.system import System

STRESS_UNKNOWN = (
    "moving frame: the stress of the body is not known, so turning does not stiffen it: good to 5 % of the first "
    "frequency; give geometric_stiffness"
)
CROSS = np.zeros((3, 3, 3))  # ε_ikj: (e_k×a)_i = ε_ikj a_j
for i, k, j in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
    CROSS[i, k, j], CROSS[j, k, i] = 1.0, -1.0


def with_moving_frame(problem: ReductionProblem, rom: Rom, whole: System) -> Rom:
    """The ROM (of the elastic part) with the constants of its moving frame, where its system, `whole`, has one."""
    frame, system = whole.moving_frame, problem.system
    if frame is None:
        return rom
    with problem.stages("moving frame"):
        nodal = system if frame.whole is None else frame.whole.system
        algebra, Q = nodal.algebra, frame.expand(np.ascontiguousarray(rom.basis[system.algebra.rows()]))
        stiffening, large = None, system.deformation is not None  # the potential of large deformation has it
        if frame.geometric_stiffness is not None and not large:
            loads = frame.restrict(frame.centrifugal_loads())
            responses = frame.expand(problem.factor.solve(loads))  # of a free body with its inertia relief
            Kg = [algebra.inner(Q, frame.geometric_stiffness(responses[:, [n]]) @ Q) for n in range(6)]
            stiffening = np.array([(A + A.T) / 2 for A in Kg])
        products = frame.moments, frame.mass_times, Q, nodal.mass @ Q
        constants = frame_of(frame.carried, frame.origin, *products, algebra.inner, stiffening)
        of_nodes = whole if frame.whole is None else frame.whole.system
        torques = {name: _wrenches(of_nodes, frame, name, Q) for name in rom.contact_models}
        constants = replace(
            constants,
            wrenches={name: wrenches for name, (wrenches, _) in torques.items()},
            torque_modes={name: modes for name, (_, modes) in torques.items()},
            output_points=frame.output_points,
            springs=_sums_of_ties(frame.springs, frame.origin, rom, whole),
            dashpots=_sums_of_ties(frame.dashpots, frame.origin, rom, whole),
        )
    if stiffening is None and not large:
        problem.messages.append(STRESS_UNKNOWN)
    return replace(rom, moving_frame=constants, warnings=tuple(problem.messages))


def _sums_of_ties(S: Any, origin: Array, rom: Rom, system: System) -> Array | None:
    """Of S (N, N) over 1, X and the basis of a ROM whose rows are unknowns, as in MovingFrame; None of none."""
    if S is None:
        return None
    X = system.body.nodes - origin
    Q = system.body.unknowns.expand(rom.basis).reshape(len(X), -1)
    fields = np.hstack([np.ones((len(X), 1)), X, Q])
    sums = fields.T @ (S @ fields)
    return (sums + sums.T) / 2


def _wrenches(system: System, frame: FullOrderFrame, contact: str, Q: Array) -> tuple[Array, Array]:
    """Force and torque about the origin (6, p) of the inputs of a contact mode, and (p, 3, k) torques of the shape."""
    B, inner, X = system.input_matrix(contact), system.algebra.inner, frame.arms
    (p, k), by_node = (B.shape[1], Q.shape[1]), np.ascontiguousarray(B).reshape(len(X), -1)
    force = inner(np.ones((len(X), 1)), by_node).reshape(3, p)
    held = frame.forces_on_held(contact, p)
    force += held.sum(axis=0)
    torque = np.einsum("ijl,jlp->ip", CROSS, inner(X, by_node).reshape(3, 3, p))
    torque += np.cross(frame.held_arms[:, :, None], held, axis=1).sum(axis=0)
    turning = np.zeros(p, dtype=bool)
    turning[: system.contacts[contact].shape[1]] = True
    column = system.contacts[contact].shape[1]
    for name, columns in system.actuators.items():  # tendons and pressures have units: they act within the body
        turning[column : column + columns.shape[1]] = name not in system.units
        column += columns.shape[1]
    products = inner(Q.reshape(-1, 3 * k), by_node).reshape(3, k, 3, p) * turning
    return np.concatenate([force, torque]), np.einsum("ijl,jalp->pia", CROSS, products)


def inertia_constants(
    X: Array, M: Any, Qe: Array, *, carried: bool = False, origin: Array | None = None, stiffening: Array | None = None
) -> MovingFrame:
    """The moving frame of a body whose matrices are all here.

    Args:
        X: nodes at rest in world axes, (N, 3), m; also those that a base holds.
        M: mass of all their components, (3N, 3N), kg, the same for the three of a node.
        Qe: strained vectors (3N, k), QᵀMQ = I; 0 where a base holds the body, else M-orthogonal to rigid motions.
        carried: by a base, at `origin` (3,), m; else the frame is at the centre of mass.
        stiffening: Kg (6, k, k).
    """
    if origin is None:
        total = (M @ np.ones((3 * len(X), 1))).reshape(-1, 3)[:, 0]
        origin = total @ X / total.sum()
    X = X - origin
    fields = np.concatenate([np.ones((len(X), 1)), X], axis=1)
    mass_times = (M @ np.repeat(fields, 3, axis=0)).reshape(-1, 3, 4)[:, 0]
    moments = fields.T @ mass_times
    return frame_of(carried, origin, moments, mass_times, Qe, M @ Qe, lambda left, right: left.T @ right, stiffening)


def frame_of(
    carried: bool,
    origin: Array,
    moments: Array,
    mass_times: Array,
    V: Array,
    MV: Array,
    inner: Callable[[Array, Array], Array],
    stiffening: Array | None = None,
) -> MovingFrame:
    """The same from products with M, of the nodes that move and are here.

    Args:
        moments: (4, 4) sums of m over 1, x, y, z of all nodes with each other, from the origin, kg, kg m, kg m².
        mass_times: (nodes here, 4), M times 1, x, y, z.
        V, MV: strained vectors and M times them, (3 nodes here, k).
        inner: leftᵀ right, summed over ranks.
    """
    k = V.shape[1]
    A = inner(V.reshape(-1, 3 * k), MV.reshape(-1, 3 * k)).reshape(3, k, 3, k).transpose(0, 2, 1, 3)  # V_iᵀ m V_j
    A = (A + A.transpose(1, 0, 3, 2)) / 2
    B = inner(mass_times, V.reshape(-1, 3 * k)).reshape(4, 3, k)
    c, B = B[0], B[1:]  # Σ m V_j, Σ m X_i V_j
    free = 0.0 if not carried else 1.0
    return MovingFrame(
        carried=carried,
        origin=origin,
        mass=float(moments[0, 0]),
        first_moment=free * moments[0, 1:],
        moment_modes=free * c,
        inertia0=_inertia(moments[1:, 1:]),
        inertia1=2 * _inertia(B),
        inertia2=_inertia(A),
        coupling0=free * np.einsum("ikj,jia->ka", CROSS, B),
        coupling=np.einsum("ikj,ijab->kab", CROSS, A),
        stiffening=stiffening,
    )


def _inertia(products: Array) -> Array:
    """Six entries Σ m (δ_kl a·b - ½ (a_k b_l + a_l b_k)) of products Σ m a_i b_j (3, 3, ...)."""
    trace = products[0, 0] + products[1, 1] + products[2, 2]
    return np.array([(trace if i == j else 0.0) - (products[i, j] + products[j, i]) / 2 for i, j in VOIGT_PAIRS])
