"""What supports exert on a body, as its balance of momentum in the last step says.

    R = Φᵀ [M (v⁺ - v)/h + D v̂ + K x̂ - B u - Sᵀ f]    with x̂ and v̂ in the middle of the step,
    R = Φᵀ [K x⁺ - B u - Sᵀ f]                         at rest,

of all components of displacement, held or not. Φ is a virtual motion, one for each component of the force and of the
couple: rigid on the nodes of the support, zero on those of other supports, and elsewhere what the body does at rest
then, Φᵀ K = 0. Where all supports are meant Φ is a motion of the whole body. Either way elastic forces are not in R,
so that of a reduced body at rest it is the full order's. Shapes that are missing enter by their inertia alone.

With large deformation Φ turns what has moved, so that a couple has arms X + x̂ in place of X: tables of x̂ and of what
acts. It is of all supports, as elastic forces leave nothing of that motion alone.
"""

from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.readable_body import ReadableBody

REACTION = "reaction"
CHANNELS = ("inertia", "damping", "stiffness")


class PressedRim(NamedTuple):
    """The edge of a surface with an opening, by which its pressure pushes the whole (see `rom.deformation.ReducedRim`).

    -∫ n dA = -½ ∮ y × dy,  -∫ y × n dA = ½ ∮ |y|² dy  with y along the edge, of which there are G points.
    """

    column: int  # of the pressure among the inputs that all contact modes share
    points: Array  # at rest, (G, 3), m
    pieces: Array  # dy there, (G, 3), m
    shapes: Any  # displacements (3 G, c) of the points
    piece_shapes: Any  # and of the pieces

    def wrench(self, x: Array, about: Array) -> Array:
        """Force, N, and couple about a point (3,), N m, of 1 Pa at displacements (c,), (6,)."""
        y = self.points - about + np.asarray(self.shapes @ x).reshape(-1, 3)
        dy = self.pieces + np.asarray(self.piece_shapes @ x).reshape(-1, 3)
        return np.concatenate([-np.cross(y, dy).sum(axis=0), (y * y).sum(axis=1) @ dy]) / 2


class Turning(NamedTuple):
    """What displacements x̂ add to couples of what is linear in c: for each axis (c, columns), x̂ᵀ T c, N m."""

    inertia: tuple[Any, Any, Any]
    damping: tuple[Any, Any, Any]
    stiffness: tuple[Any, Any, Any]
    contacts: dict[str, tuple[Any, Any, Any]]
    inputs: tuple[Any, Any, Any]
    nodes: Any  # displacements (3 s, c) of the nodes that can be touched
    rims: tuple[PressedRim, ...] = ()

    def projected(self, basis: Array) -> "Turning":
        """Of a body whose displacement is basis (n, k) times its coordinates."""

        def both(tables: tuple[Any, ...]) -> Any:
            return tuple(np.asarray(basis.T @ (table @ basis)) for table in tables)

        def one(tables: tuple[Any, ...]) -> Any:
            return tuple(np.asarray(basis.T @ table) for table in tables)

        contacts = {name: one(tables) for name, tables in self.contacts.items()}
        acting = both(self.inertia), both(self.damping), both(self.stiffness), contacts, one(self.inputs)
        rims = tuple(
            rim._replace(shapes=rim.shapes @ basis, piece_shapes=rim.piece_shapes @ basis) for rim in self.rims
        )
        return Turning(*acting, np.asarray(self.nodes @ basis), rims)


@dataclass(frozen=True)
class ReactionReading:
    """Force, N, and couple about a point, N m, of supports on the body, in the mean over the last step, (6,).

    Attributes:
        point: about which the couple is, (3,), m.
        inertia, damping, stiffness: of accelerations, velocities and displacements of the body's coordinates, (6, c).
        contacts: of the columns of each contact mode, (6, columns).
        inputs: of actuators, then loads, (6, p).
        nodes: (s,) that can be touched.
        motions: Φ there, (3 s, 6).
        turning: with large deformation; None: a linear body.
    """

    quantity: ClassVar = REACTION
    of: ClassVar = ""
    point: Array
    inertia: Any
    damping: Any
    stiffness: Any
    contacts: dict[str, Array]
    inputs: Array
    nodes: Array
    motions: Array
    turning: Turning | None = None

    def read(self, body: ReadableBody) -> Array:
        """Its value; 0 where no step was taken yet."""
        last = body.last
        if last is None:
            return np.zeros(6)
        a, v, x = last.motion
        pushed, shared = np.split(last.inputs, [len(last.inputs) - self.inputs.shape[1]])
        acting = [(self.contacts[last.contact], pushed), (self.inputs, shared)]
        R = self.inertia @ a + self.damping @ v + self.stiffness @ x + sum(rows @ u for rows, u in acting)
        forces = np.zeros((len(self.nodes), 3))
        if body.points is not None and body.forces is not None:
            forces = body.points.on_nodes(body.forces, self.nodes)
            R = R - self.motions.T @ forces.ravel()
        if self.turning is None:
            return np.asarray(R)
        T = self.turning
        turned = (
            (T.inertia, a),
            (T.damping, v),
            (T.stiffness, x),
            (T.contacts[last.contact], pushed),
            (T.inputs, shared),
        )
        R[3:] += sum(np.array([x @ (table @ c) for table in tables]) for tables, c in turned)
        R[3:] -= np.cross((T.nodes @ x).reshape(-1, 3), forces).sum(axis=0)
        for rim in T.rims:
            R -= shared[rim.column] * rim.wrench(x, self.point)
        return np.asarray(R)

    def projected(self, basis: Array) -> "ReactionReading":
        """Of a body whose displacement is basis (n, k) times its coordinates."""
        rows: dict[str, Any] = {name: np.asarray(getattr(self, name) @ basis) for name in CHANNELS}
        return replace(self, **rows, turning=None if self.turning is None else self.turning.projected(basis))
