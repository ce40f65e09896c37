"""The spring between the mouse and a point of a contact surface, and what its force does in the columns of a mode."""

import math
from dataclasses import dataclass

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.frame_motion import cross_matrix, rotation_matrix
from fenics_rom.mechanics.linearity import SurfaceStrainPeak
from fenics_rom.rom.midpoint_map import compliance
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.linearity_monitor import ReducedGauges, gauge_basis
from fenics_rom.runtime.simulator import Simulator

RELATIVE_STIFFNESS = 2.0  # of the spring, as a multiple of the body's at rest: the body follows two thirds of the way
RANK_TOLERANCE = 1e-8  # relative singular value below which two columns do the same to the shape at rest
OVERSHOOT = 2.0  # a force that begins at once leads this much further than at rest
FINITE_STRAIN_REACH = 10.0  # times as far as a linear model can follow, a body of large deformation may be pulled


@dataclass(frozen=True)
class MouseSpring:
    """A spring that is attached to one point in one contact mode. A force f there enters as the input u = S f.

    The spring acts on y = Pᵀ q, P = G S, the point's displacement as the contact mode's columns know it. What it does
    to the body is then what the body does to it, and a step that takes both together adds no energy to the two.

    Attributes:
        contact: the contact mode.
        place: of the point at rest, (3,), m.
        rows: W_p (3, m) of the point in the contact mode's basis.
        spread: S (p, 3), the columns' forces that come closest to f in what they do to the shape at rest.
        columns: P (m, 3).
        stiffness: k of the spring, N/m.
        largest: force that leads the surface to the limit of a linear model when it begins at once, N.
    """

    contact: str
    place: Array
    rows: Array
    spread: Array
    columns: Array
    stiffness: float
    largest: float

    def moved(self, q: Array) -> Array:
        """Where the point is, (3,), m, at a reduced displacement q (m,)."""
        return self.place + self.rows @ q

    def force(self, y: Array, flexibility: Array, target: Array) -> Array:
        """What it pulls with, (3,), N: f = k (target - place - y - flexibility f), but not more than `largest`.

        At the moment that counts y (3,), m, is the displacement without f, and flexibility (3, 3) f what f adds to it.
        """
        f = np.linalg.solve(np.eye(3) / self.stiffness + flexibility, target - self.place - y)
        length = float(np.linalg.norm(f))
        return f if length <= self.largest else f * (self.largest / length)


def attach_spring(rom: Rom, contact: str, nodes: Array, weights: Array) -> MouseSpring | None:
    """A spring at the mean of nodes (c,) with weights (c,), in sum 1; None where the mode has no column that moves it.

    S minimizes |K⁻½ (B S - e_p)|, the distance of the shapes at rest in energy; of a resultant it is near to the
    identity, of a pressure the share along the normal, of nodal forces those of the nearest nodes. Of a body in a
    moving frame, where B pushes as a whole what B can, the resultants of B S are first of all those of the force.
    """
    mode, columns = rom.contact_models[contact], rom.contacts[contact]
    G = mode.inputs[:, :columns]
    rows = np.einsum("c,cik->ik", weights, rom.rows_of(nodes)) @ mode.coordinates
    soft = 1 / mode.safe_frequencies  # K⁻½; rigid motions have no shape at rest
    S, chosen = np.zeros((columns, 3)), np.eye(columns)
    if rom.moving_frame is not None:
        U, s, Vᵀ = np.linalg.svd(rom.moving_frame.wrenches[contact][:3, :columns])
        rank = int((s > RANK_TOLERANCE * s[0]).sum())
        S, chosen = (Vᵀ[:rank].T / s[:rank]) @ U[:, :rank].T, Vᵀ[rank:].T
    left = soft[:, None] * (rows.T - G @ S)
    S = S + chosen @ np.linalg.lstsq(soft[:, None] * G @ chosen, left, rcond=RANK_TOLERANCE)[0]
    P = G @ S
    shapes = soft[:, None] ** 2 * P
    λ, directions = np.linalg.eigh(P.T @ shapes)
    if not λ[-1] > 0:
        return None
    return MouseSpring(
        contact=contact,
        place=weights @ rom.nodes[nodes],
        rows=rows,
        spread=S,
        columns=P,
        stiffness=RELATIVE_STIFFNESS / λ[-1],
        largest=_multiple_to_limit(rom, contact, shapes @ directions[:, -1]) / OVERSHOOT,
    )


def spring_step(body: Simulator, rom: Rom, spring: MouseSpring, nodes: Array, weights: Array) -> "MouseSpringStep":
    """A spring of a ROM at the mean of nodes (c,) with weights (c,), in steps of its body in the spring's mode."""
    kind = MovingMouseSpringStep if rom.environment.is_moving else MouseSpringStep
    return kind(body, rom, spring, nodes, weights)


class MouseSpringStep:
    """A spring in steps of one length, at the mean of nodes (c,) with weights (c,).

    In a step of passive midpoint integration the spring is that of the middle, ŷ = y + h/2 Pᵀ v̂, without inertia
    that of the end. Its own part in v̂ is solved for, which keeps it stable at any step; those of actuators and loads
    are known, and that of obstacles is left out.
    """

    def __init__(self, body: Simulator, rom: Rom, spring: MouseSpring, nodes: Array, weights: Array):
        h, P = body.dt, spring.columns
        mode, first = rom.contact_models[spring.contact], rom.contacts[spring.contact]
        self.spring, self.nodes, self.weights = spring, nodes, weights
        self._mode, self._h = mode, h
        self._others = mode.inputs[:, first:]
        self._moves = rom.environment.has_inertia
        series = rom.environment.viscoelasticity
        branches = 0.0 if series is None else series.stiffening_time(h)
        self._inverse = compliance(mode, h, branches)[0] if self._moves else 1 / mode.safe_frequencies**2  # A⁻¹, or K⁻¹
        self._spread = self._times_inverse(P)
        self._flexibility = (h / 2 if self._moves else 1.0) * P.T @ self._spread

    def _times_inverse(self, columns: Array) -> Array:
        return (self._inverse * columns.T).T if self._inverse.ndim == 1 else self._inverse @ columns

    def place(self, body: Simulator) -> Array:
        """Where the point is, (3,), m."""
        return self.spring.moved(body.state[0])

    def force(self, body: Simulator, actuators: Array, target: Array) -> tuple[Array, Array]:
        """What the spring pulls with in the next step, (3,), N, and the input of the contact mode that does so."""
        around, (q, r) = body.environment, body.state
        loads = np.empty(0) if around is None else around.loads_at(body.time + self._h / 2)
        pushed = self._others @ np.concatenate([actuators, loads])
        if self._moves:
            travel = self._spread.T @ (pushed + 2 / self._h * r - self._mode.eigenvalues * q) * (self._h / 2)
            f = self.spring.force(self.spring.columns.T @ q + travel, self._flexibility, target)
        else:
            f = self.spring.force(self._spread.T @ pushed, self._flexibility, target)
        return f, self.spring.spread @ f


class MovingMouseSpringStep(MouseSpringStep):
    """The same of a body in a moving frame, which somebody may throw.

    What is pulled at goes with the columns, as they are what the force acts by: from where they act on, x in the frame,
    to p + R (x + Pᵀ q). A spring to the point that was grabbed would feed a body that turns about another one. In the
    middle of the step that is at y + h/2 (ẏ + R Pᵀ ŵ) + R F Rᵀ f: it goes on as it moves in the world, ŵ is how elastic
    forces and actuators change that, and F is the compliance of the body at rest, free or on its base.
    """

    def __init__(self, body: Simulator, rom: Rom, spring: MouseSpring, nodes: Array, weights: Array):
        super().__init__(body, rom, spring, nodes, weights)  # whose compliance has the motions as a whole, too
        model, first = body.model, rom.contacts[spring.contact]
        self._mode, self._inverse = model, compliance(model, body.dt)[0]
        self._columns = model.inputs[:, :first] @ spring.spread
        self._others = model.inputs[:, first : first + sum(rom.actuators.values())]
        self._arm = _acts_on(rom, spring)
        self._apart = self.place(body) - self._pulled(body)[0]

    def place(self, body: Simulator) -> Array:
        """Where the point is, (3,), m."""
        return self.weights @ (body.rom.nodes[self.nodes] + body.displacement()[self.nodes])

    def force(self, body: Simulator, actuators: Array, target: Array) -> tuple[Array, Array]:
        """As of a MouseSpringStep, in world axes."""
        assert body.pose is not None
        R, h, (q, r) = rotation_matrix(body.pose.rotation), self._h, body.state
        drive = self._others @ actuators + 2 / h * r - self._mode.eigenvalues * q
        changed = self._times_inverse(drive) - r
        y, velocity = self._pulled(body)
        y = self._apart + y + h / 2 * (velocity + R @ (changed @ self._columns))
        f = self.spring.force(y - self.spring.place, R @ self._flexibility @ R.T, target)
        return f, self.spring.spread @ (R.T @ f)

    def _pulled(self, body: Simulator) -> tuple[Array, Array]:
        """Where what is pulled at is, (3,), m, and its velocity, m/s."""
        assert body.pose is not None
        pose, (q, r), P = body.pose, body.state, self._columns
        R = rotation_matrix(pose.rotation)
        arm = R @ (self._arm + q @ P)
        return pose.position + arm, pose.velocity + np.cross(pose.angular_velocity, arm) + R @ (r @ P)


def _acts_on(rom: Rom, spring: MouseSpring) -> Array:
    """Where from the frame's origin forces of a spring act at rest, (3,), m: what torques they have, nearly."""
    frame = rom.moving_frame
    assert frame is not None
    forces, torques = np.split(frame.wrenches[spring.contact][:, : len(spring.spread)] @ spring.spread, 2)
    arm = spring.place - frame.origin
    turns = -np.concatenate([cross_matrix(force) for force in forces.T])  # x × f = -f~ x
    arm += np.linalg.lstsq(turns, torques.T.ravel() - turns @ arm, rcond=RANK_TOLERANCE)[0]
    return arm


def largest_input(rom: Rom, contact: str, column: int) -> float:
    """The input of one column at which the surface at rest is at the limit of a linear model, in the input's unit."""
    mode = rom.contact_models[contact]
    multiple = _multiple_to_limit(rom, contact, mode.inputs[:, column] / mode.safe_frequencies**2)
    return multiple if math.isfinite(multiple) else 1.0


def _multiple_to_limit(rom: Rom, contact: str, q: Array) -> float:
    """What to multiply a shape q (m,) by, so that it goes as far as it may."""
    mode = rom.contact_models[contact]
    gauge = ReducedGauges(gauge_basis(rom) @ mode.coordinates, mode.eigenvalues)
    severity = SurfaceStrainPeak(*gauge.read(q)).severity
    reach = 1.0 if rom.deformation is None else FINITE_STRAIN_REACH
    return reach / severity if severity > 0 else math.inf


def closest_point(corners: Array, place: Array) -> tuple[int, Array]:
    """The triangle that a point of a surface lies in, and its barycentric coordinates (3,) there.

    Not by trimesh's `closest_point`: that compares products of four lengths with an absolute tolerance, so that on
    triangles of 0.3 mm it misses the point by as much as they are long.
    """
    origin, a, b = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    sides = np.stack([a, b], axis=2)
    coordinates = (np.linalg.pinv(sides) @ (place - origin)[:, :, None])[:, :, 0]
    weights = np.maximum(np.column_stack([1 - coordinates.sum(axis=1), coordinates]), 0.0)
    weights /= weights.sum(axis=1, keepdims=True)
    nearest = int(np.linalg.norm(np.einsum("fc,fcx->fx", weights, corners) - place, axis=1).argmin())
    return nearest, weights[nearest]
