"""How contact forces of a step change with what they were found from: the law's derivative, transposed.

Pairs that took part keep what they do: open, stuck or slipping, a pair's law is smooth (implicit function theorem).
With frames Q of the pairs, forces F = Q f on the body, and relative velocities of their points, v in the middle of the
step without forces and a at its start, the law is solved by u = Qᵀ (W Q f + v) - c, and as it stands changes by

    δf = N (Qᵀ (δv + W (δθ x F) - δθ x v̂) - δc),    δF = Q δf + δθ x F,    δθ = n x δn,

where δn is the distance's second derivative times the point's δx, c its targets and v̂ = W F + v. The adjoint φ of F
passes Ψ = Q Nᵀ Qᵀ φ to v, and so on. W is that of the step, and of an iteration that ended there with another one the
derivative of what it came to (`through`), which need not be symmetric.

There is no derivative at a kink: where a pair that hardly presses also hardly leaves, or hardly slips at the border of
its cone; where a pair hardly takes part, or does not; where it begins to approach. What a step found is then one of the
sides. How near a step is to one is told.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.complementarity import Delassus
from fenics_rom.mechanics.complementarity.linearised import Linearisation, least_solution
from fenics_rom.mechanics.contact import ContactLaw, PointMotion, rigid_law
from fenics_rom.mechanics.contact_pairs import Pairs, SolvedPairs, target_slopes
from fenics_rom.mechanics.contact_solver import ContactSolver
from fenics_rom.mechanics.obstacle_poses import curvature_from
from fenics_rom.mechanics.points_operator import moved_by, whole_of
from fenics_rom.mechanics.turning_adjoint import Owed, TurningPairs

_NEXT, _LAST = np.array([1, 2, 0]), np.array([2, 0, 1])  # of x, y, z
KINK = 1e-9  # of the velocities that forces have to stop: nearer than this to another law, a step is at a kink


def is_at_kink(law: ContactLaw, pairs: Pairs | None, found: SolvedPairs | None) -> bool:
    """Whether a step has no derivative, or was solved but for a residual; of what its solver considered and solved."""
    μ = law.friction
    if pairs is None:
        return False
    speed = np.abs(pairs.free if found is None else found.problem.q).max()
    near = KINK * float(speed)
    if (np.abs(pairs.free[0] - pairs.level) <= near).any():  # a pair hardly takes part, or hardly does not
        return True
    if found is None or found.is_loose:
        return found is not None
    f, u, ρ = found.forces, found.velocities, found.problem.operator.stiffness
    hardly_closed = np.abs(f[0] - ρ * u[0]) <= ρ * near
    slip = np.hypot(f[1], f[2]) + ρ * np.hypot(u[1], u[2]) - μ * f[0]
    hardly_slips = (f[0] > 0) & (np.abs(slip) <= ρ * near) if μ else False
    return bool((hardly_closed | hardly_slips).any())


class _AtShare(NamedTuple):
    """What the share that swinging pairs are asked for passes back; see Braking."""

    velocities: Array  # derivatives with v (C, 3)
    normals: Array  # derivatives with the normals n (C, 3)


class _Bent(NamedTuple):
    """Of a body that touches itself, whose forces move the places by which their own pairs move with its points."""

    share: Array  # forces at the points by those that pairs have with the places as they are (3P, 3P)
    moved: Array  # velocities of pairs per force at the points (3C, 3P), m/s/N
    told: Array  # the same at the start


class ContactAdjoint(NamedTuple):
    """Contact of a step, to go back through."""

    law: ContactLaw
    found: SolvedPairs
    curvature: Array | None  # of the normals of pairs that took part, (C, 3, 3), 1/m; None: their obstacles are flat
    turning: TurningPairs | None  # these pairs, where an obstacle turns
    operator: Array  # W of the points (3P, 3P), m/s/N,
    moved: Array  # and of these pairs (3C, 3C)
    asked: Delassus  # the same less what the targets change by with forces
    bent: _Bent | None = None

    @staticmethod
    def of(solver: ContactSolver, found: SolvedPairs | None) -> "ContactAdjoint | None":
        """Of a step as its solver found it; None where nothing touched."""
        if found is None:
            return None
        obstacle, point = np.divmod(found.active, len(solver.points))
        places, turning = solver.points[point] + found.points.displacement[point], None
        shapes = solver.obstacles if found.rows is None else solver.obstacles[: found.rows.obstacles]
        if found.look is None or found.look.turning is None:
            curvature = np.zeros((len(point), 3, 3))
            for number, shape in enumerate(shapes):
                of_this = obstacle == number
                curvature[of_this] = curvature_from(shape, places[of_this], found.obstacles.start[number])
        else:
            pairs, motion = (found.active, obstacle, found.pushed[found.active]), found.points.velocity[point]
            of_step = shapes, found.obstacles, found.look, pairs, places, motion, found.dt
            turning = TurningPairs.of(*of_step)
            curvature = turning.curvature
        operator = whole_of(found.operator)
        moved, bends = _of_pairs(found, operator), curvature if curvature.any() else None
        law = solver.law if found.pairs.compliance else rigid_law(solver.law)  # of springs that were held, too
        return ContactAdjoint(law, found, bends, turning, operator, moved, Delassus(moved))

    def through(
        self, operator: Array, by_start: Array | None = None, by_middle: Array | None = None
    ) -> "ContactAdjoint":
        """The same of points that another Delassus operator (3P, 3P) moves than the one that forces were found with.

        `by_start`, `by_middle`: what forces do to the velocities that the points have at the start, as the law is told,
        and to where they are in the middle of the step, (3P, 3P); the latter matters to a body that touches itself.
        """
        rows, bent, told = self.found.rows, None, None
        if rows is None or by_start is None or by_middle is None:
            moved, told = _of_pairs(self.found, operator), None if by_start is None else _of_pairs(self.found, by_start)
        else:
            points, F = self.found.points, self.found.problem.frames.in_space(self.found.forces)
            velocity = points.free_velocity + _of_shape(moved_by(self.found.operator, rows.at_points(F)))
            M, by_places = rows.matrix, rows.by_middle(velocity)
            bent = _Bent(
                np.linalg.inv(np.eye(M.shape[1]) - rows.at_points_by_middle(F).dot(by_middle)),
                M.dot(operator) + by_places.dot(by_middle),
                M.dot(by_start) + rows.by_middle(points.velocity).dot(by_middle),
            )
            moved, told = (each.dot(bent.share).dot(M.T) for each in (bent.moved, bent.told))
        asked = moved
        if told is not None:
            _, by_approach, by_slide = self._target_slopes()
            n = np.broadcast_to(self.found.problem.frames.axes[:, :, 0], (len(self.found.active), 3))
            along_start = n if self.turning is None else self.turning.told_along(n)
            along = by_approach[:, None, None] * n[:, :, None] * along_start[:, None]
            along += by_slide[:, None, None] * (np.eye(3) - n[:, :, None] * n[:, None])
            asked = moved - (along @ told.reshape(len(n), 3, -1)).reshape(moved.shape)
        return self._replace(operator=operator, moved=moved, asked=Delassus(asked), bent=bent)

    def pull_back(self, φ: Array) -> PointMotion:
        """Derivatives with what the points do, (P, 3) each, from those with the forces on them, φ (P, 3), 1/N."""
        frames, rows, of_points, bent = self.found.problem.frames, self.found.rows, φ, self.bent
        if bent is not None:
            φ = _of_shape(bent.share.T.dot(φ.ravel()))
        φ, at_share = self._through_share(self._of_points(φ))
        ψ = self._law_pulled_back(frames.turned(φ)[0])
        by_gap, by_approach, by_slide = self._target_slopes()
        c = ψ * np.stack([by_approach, by_slide, by_slide])
        n, Ψ, by_start = np.broadcast_to(frames.axes[:, :, 0], ψ.T.shape), frames.in_space(ψ), -frames.in_space(c)
        turning, whole = self.turning, Ψ if at_share is None else Ψ + at_share.velocities
        x, normal_ = -(by_gap * ψ[0])[:, None] * (n if turning is None else turning.first), np.zeros(n.shape)
        told = Owed(x, 0.0, by_start, by_start, frames.in_space(self._relative))
        if turning is not None:
            told = turning.pull_back(told, whole, n)
            x = told.place
        if self.curvature is not None or rows is not None:
            normal_ = _cross(self._turned_back(φ, Ψ) + _cross(told.rotated, told.relative), n) + told.normal
            if at_share is not None:
                normal_ += at_share.normals
        if self.curvature is not None:
            x += (self.curvature @ normal_[:, :, None])[:, :, 0]
        if rows is not None:
            x[rows.within] = 0.0
        owed = PointMotion(*(self._at_points(values) for values in (x, told.start, whole)))
        if rows is None:
            return owed
        F, points = frames.in_space(self.found.forces), self.found.points
        moved = _of_shape(moved_by(self.found.operator, rows.at_points(F)))
        if bent is None:
            forces_ = of_points + _of_shape(self.operator.T.dot(owed.free_velocity.ravel()))
        else:
            by_pairs = bent.moved.T.dot(whole.ravel()) + bent.told.T.dot(told.start.ravel())
            forces_ = _of_shape(bent.share.T.dot(of_points.ravel() + by_pairs))
        products = [(whole, points.free_velocity + moved), (told.start, points.velocity), (F, forces_)]
        start_, middle_ = rows.pull_back(-by_gap * ψ[0], normal_, products)
        if points.middle is None:
            return owed._replace(displacement=owed.displacement + start_ + middle_)
        return owed._replace(displacement=owed.displacement + start_, middle=middle_)

    def _through_share(self, φ: Array) -> "tuple[Array, _AtShare | None]":
        """Derivatives with forces (C, 3) at a share σ that stays, and what else the share depends on.

        Friction does no work at it: G = Σ f_t·v̂_t = 0 changes by γ·δF + .., with γ = v̂_t + W f_t, and forces with σ
        by -N ∂c/∂σ. So φ + κ γ is in place of φ, κ = -(Nᵀφ)·∂c/∂σ / (Nᵀγ)·∂c/∂σ.
        """
        (problem, active), braking = (self.found.problem, self.found.active), self.found.pairs.braking
        if braking is None or braking.by_share is None or problem.sliding is None:
            return φ, None
        frames, (f, u) = problem.frames, (self.found.forces.copy(), self.found.velocities.copy())
        pressure, closing = f[0].copy(), u[0] + problem.target - self.found.pairs.compliance * f[0]
        f[0] = u[0] = 0.0
        u[1:] += problem.sliding
        F, v̂ = frames.in_space(f), frames.in_space(u)
        γ = v̂ + _transposed(self.moved, F)
        by_share = braking.by_share.take(active, axis=1)
        own, of_work = (float((self._law_pulled_back(frames.turned(part)[0])[1:] * by_share).sum()) for part in (φ, γ))
        κ = -own / of_work
        return φ + κ * γ, _AtShare(κ * F, -κ * (closing[:, None] * F + pressure[:, None] * v̂))

    def _of_points(self, values: Array) -> Array:
        """Of values of the points (P, 3), those of pairs that took part, (C, 3)."""
        rows = self.found.rows
        return values[self.found.active % len(values)] if rows is None else rows.of_pairs(values)

    def _at_points(self, values: Array) -> Array:
        """Of pairs that took part (C, 3), together at the points (P, 3)."""
        if self.found.rows is not None:
            return self.found.rows.at_points(values)
        of_pairs = np.zeros((len(self.found.gaps), 3))
        of_pairs[self.found.active] = values
        together: Array = of_pairs.reshape(-1, len(self.found.points.displacement), 3).sum(axis=0)
        return together

    @property
    def _relative(self) -> Array:
        """Velocities at the start, as they are told of pairs that took part, (3, C) in the frames, m/s."""
        relative: Array = self.found.pairs.relative.take(self.found.active, axis=1)
        return relative

    def _turned_back(self, φ: Array, Ψ: Array) -> Array:
        """Derivatives with rotations θ of the frames (C, 3), but for what turns of velocities at the start."""
        found, problem, frames = self.found, self.found.problem, self.found.problem.frames
        v̂ = found.velocities.copy()
        v̂[0] += problem.target - found.pairs.compliance * found.forces[0]
        v̂[1:] += 0.0 if problem.sliding is None else problem.sliding
        WΨ = _transposed(self.asked.matrix, Ψ)
        F, v̂ = frames.in_space(found.forces), frames.in_space(v̂)
        turned: Array = _cross(F, φ + WΨ) - _cross(v̂, Ψ)
        return turned

    def _law_pulled_back(self, φ: Array) -> Array:
        """Nᵀ φ (3, C), in the frames."""
        found, μ = self.found, self.law.friction
        f, u, operator = found.forces, found.velocities, self.asked.framed(found.problem.frames, found.pairs.compliance)
        ρ = operator.stiffness
        z = f - ρ * u
        if μ:
            length, cone = np.hypot(z[1], z[2]), μ * np.maximum(z[0], 0.0)
            law = Linearisation(operator.matrix, μ, operator.compliance, z, length, cone)
            return law.pull_back(φ, operator.is_regular)
        ψ, closed = np.zeros(φ.shape), np.flatnonzero(z[0] > 0)
        ψ[0, closed] = -least_solution(operator.matrix[closed, closed[:, None]], φ[0, closed])
        return ψ

    def _target_slopes(self) -> tuple[Array, Array, Array]:
        """What the targets change by with gaps, 1/s, and with velocities at the start along normals and tangents."""
        pairs, active = self.found.pairs, self.found.active
        gaps, target, approach = (part.take(active) for part in (self.found.gaps, pairs.target, pairs.relative[0]))
        by_gap, by_approach = target_slopes(self.law, gaps, target, approach, self.found.dt, self.found.quasi_static)
        if pairs.braking is None:
            return by_gap, by_approach, np.zeros(len(active))
        return by_gap, by_approach, pairs.braking.slopes.take(active)


def _of_pairs(found: SolvedPairs, operator: Array) -> Array:
    """Of an operator (3P, 3P) of the points, that of pairs that took part, (3C, 3C)."""
    if found.rows is not None:
        return found.rows.operator(operator)
    rows = (3 * (found.active % (len(operator) // 3))[:, None] + np.arange(3)).ravel()
    of_pairs: Array = operator[rows[:, None], rows]
    return of_pairs


def _of_shape(values: Array) -> Array:
    """Of points (3P,), (P, 3)."""
    return values.reshape(-1, 3)


def _transposed(operator: Array, forces: Array) -> Array:
    """Of forces (C, 3) by an operator (3C, 3C) transposed, (C, 3)."""
    moved: Array = operator.T @ forces.ravel()
    return moved.reshape(-1, 3)


def _cross(a: Array, b: Array) -> Array:
    """a x b of vectors (C, 3), in a third of the time of NumPy's."""
    product: Array = a[:, _NEXT] * b[:, _LAST] - a[:, _LAST] * b[:, _NEXT]
    return product
