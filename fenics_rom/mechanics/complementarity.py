"""Frictional contact forces of many pairs at once: a complementarity problem with Coulomb's cones, solved to round-off.

Each pair has a force f = λ n + f_t and a velocity u = (W f + q) of its own, W symmetric and positive semidefinite:

    0 <= λ ⟂ n·u >= 0,    |f_t| <= μ λ,    f_t = -μ λ u_t/|u_t| where u_t is not 0.

With z = f - ρ u for any ρ > 0 this is f = P(z), P(z) = z_n⁺ n + z_t min(1, μ z_n⁺/|z_t|) (Alart & Curnier, CMAME 92,
1991), which tells for each pair whether it is open, sticks or slips. Newton's method on it is an active-set method with
three unknowns for a pair that sticks and two for one that slips. W is singular wherever more points touch than the body
has freedoms; each system is solved for the change of the forces with a small compliance added (the proximal point
method), which leaves what is solved for unchanged and what W does not determine near where it was.
"""

from contextlib import suppress
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from fenics_rom.errors import StepError

Array = np.ndarray

_ONES, _XYZ, _NEXT, _LAST = np.ones(3), np.arange(3), np.array([1, 2, 0]), np.array([2, 0, 1])
_OPEN, _STICK, _SLIP = np.int8(0), np.int8(1), np.int8(2)
_SOLVED = 1e-12  # of the velocities that the forces have to stop: near what round-off leaves
GOOD = 1e-9  # what is as good as solved
_NEAR = 1e-6  # from where on the slowest method is not worth its time
_FAIR = 1e-3  # what is accepted, and told, where no method gets further: there may be no solution at all
_PROXIMAL = 1e-9  # compliance added to a system, in parts of each pair's own
_SOFT = 1e-4  # the same to begin with: where W hardly tells forces apart, Newton's method would cycle between them
_NEWTON = 12  # iterations; where they suffice they are rarely more than five
_FIRST = 8  # of them with the larger compliance
_INTERIOR = 40  # iterations of the interior-point method; where it gets there they are rarely more than fifteen
_LIMIT = 1e-14  # of what it can do
_PATHS = ((0.3, 10), (0.6, 30))  # of shrinking compliance: the factor, and Gauss-Seidel sweeps where Newton cycles


class Solution(NamedTuple):
    """Contact forces.

    Attributes:
        forces: (C, 3), N, exactly in their cones.
        velocities: u (C, 3), m/s, to round-off.
        iterations: of all methods together.
        residual: what is left to solve, as a share of the velocities that the forces have to stop.
    """

    forces: Array
    velocities: Array
    iterations: int
    residual: float = 0.0


def solve(W: Array, q: Array, normals: Array, friction: float, start: Array) -> Solution:
    """The contact forces of C pairs.

    Args:
        W: (3C, 3C) velocities per force, m/s/N; symmetric positive semidefinite.
        q: (C, 3) velocities without contact, less the targets, m/s.
        normals: (C, 3) unit vectors from the obstacle to the body.
        friction: μ >= 0.
        start: (C, 3) forces to begin with, N: the better, the sooner it is solved.

    Raises:
        StepError: no method came to a solution.
    """
    size = W.diagonal().reshape(-1, 3).dot(_ONES) / 3
    if not size.min() > 0:
        size = np.maximum(size, 1e-12 * size.max() or 1.0)
    if friction == 0:
        return _Frictionless(W, q, normals, size).solve(start)
    return _Frictional(W, q, normals, friction, size).solve(start)


class _Frictional:
    """Newton's method; where it cycles, along a path of shrinking compliance, with Gauss-Seidel sweeps to help."""

    def __init__(self, W: Array, q: Array, normals: Array, friction: float, size: Array):
        self.W, self.q, self.n, self.μ, self.size = W, q, normals, friction, size[:, None]
        self.ρ = 1 / self.size
        self.speed = float(np.abs(q).max())
        self.best, self.velocities, self.error, self.iterations = q, q, np.inf, 0

    def solve(self, start: Array) -> Solution:
        if not self.newton(start, _SOFT, _FIRST) and not self.newton(self.best):
            with np.errstate(all="ignore"):  # what diverges ends
                arrived = self.through_interior()
                if not arrived and not self.error <= _NEAR * self.speed:
                    with suppress(np.linalg.LinAlgError):  # of compliances whose squares overflow
                        arrived = any(self.follow(*path) for path in _PATHS)
            if not arrived:
                _accept(self.error / self.speed, len(self.q), self.iterations)
        return Solution(self.best, self.velocities, self.iterations, self.error / self.speed)

    def newton(self, f: Array, proximal: float = _PROXIMAL, most: int = _NEWTON, tolerance: float = _SOLVED) -> bool:
        """Whether Newton's method arrives from f within so many iterations; the best forces are kept."""
        q, n, allowed = self.q, self.n, tolerance * self.speed
        self.proximal = proximal
        for _ in range(most):
            u = self.W.dot(f.ravel()).reshape(f.shape)
            u += q
            z = f - self.ρ * u
            zn = (z * n).dot(_ONES)
            zt = z - zn[:, None] * n
            length = np.sqrt((zt * zt).dot(_ONES))
            pressure = np.maximum(zn, 0.0)
            cone = self.μ * pressure
            ratio = cone / (np.maximum(length, cone) + 1e-300)
            projected = pressure[:, None] * n + ratio[:, None] * zt
            error, before = float(np.abs((f - projected) * self.size).max()), self.error
            if error < before:
                self.best, self.velocities, self.error = projected, u, error
            if error <= allowed or before / 2 < self.error <= GOOD / 100 * self.speed:  # done, or what round-off leaves
                return True
            status = np.where(length > cone, _SLIP, _STICK)
            status[zn <= 0] = _OPEN
            self.iterations += 1
            try:
                f = self.linearised(f, status, zt, length, cone)
            except np.linalg.LinAlgError:
                return False
        return False

    def linearised(self, f: Array, status: Array, zt: Array, length: Array, cone: Array) -> Array:
        """The forces that solve the equations linearised at f with the given statuses.

        A pair that sticks keeps f as its unknowns and u = 0 as equations. For one that slips to d = z_t/|z_t|, with
        p = n x d, f = λ (n + μ d) + θ p; n·u = 0 and p·u + (|z_t|/(μ z_n) - 1)/ρ θ = 0.
        """
        form = _layout(status.tobytes())
        if not form.unknowns:
            return np.zeros_like(f)
        if 3 * len(f) == form.unknowns:  # everything sticks: E = T = I
            G = self.W.copy()
            G.ravel()[:: len(G) + 1] += self.proximal * self.size[form.pairs, 0]
            return f - np.linalg.solve(G, self.W.dot(f.ravel()) + self.q.ravel()).reshape(f.shape)
        E = np.zeros((f.size, form.unknowns))
        E.ravel()[form.stick_entries] = 1.0
        compliance = self.proximal * self.size[form.pairs, 0]
        slip = form.slip
        if len(slip):
            T = E.copy()
            n, training_radius, size = self.n[slip], length[slip], self.size[slip, 0]
            d = zt[slip] / training_radius[:, None]
            basis = np.empty((len(slip), 3, 2))
            basis[:, :, 0] = n
            basis[:, :, 1] = n[:, _NEXT] * d[:, _LAST] - n[:, _LAST] * d[:, _NEXT]
            T.ravel()[form.slip_entries] = basis
            start = T.T.dot(f.ravel())
            basis[:, :, 0] += self.μ * d
            E.ravel()[form.slip_entries] = basis
            weak = (training_radius / cone[slip] - 1) * size
        else:
            T, start = E, E.T.dot(f.ravel())
        WE = self.W.dot(E)
        wanted = T.T.dot(WE.dot(start) + self.q.ravel())
        if len(slip):
            aside = form.aside
            compliance[aside] += weak
            wanted[aside] += weak * start[aside]
        G = T.T.dot(WE)
        G.ravel()[:: form.unknowns + 1] += compliance
        return E.dot(start - np.linalg.solve(G, wanted)).reshape(f.shape)

    def through_interior(self) -> bool:
        """Whether Newton's method arrives from an approximation by an interior-point method.

        With y = (λ, f_t/μ) and z = (u_n + μ|u_t|, μ u_t), both in Lorentz's cone, and y·z = 0, the problem is a
        second-order cone program but for the term |z_t|, which the linearisation includes (Acary, Armand, Nguyen &
        Shpakovych, Optim. Methods Softw. 37, 2022). The directions are those of Nesterov & Todd with Mehrotra's
        corrector. What W does not determine ends far from the borders of the cones, where the next step finds it good.
        """
        C = len(self.q)
        Q = _frames(self.n) / np.sqrt(self.size)[:, :, None]  # f = Q y: every pair alike, whatever its mass
        Q[:, :, 1:] *= self.μ
        Qᵀ = Q.transpose(0, 2, 1)
        half = np.matmul(Qᵀ, self.W.reshape(C, 3, 3 * C)).reshape(3 * C, C, 3).transpose(1, 0, 2)
        M = np.matmul(half, Q).transpose(1, 0, 2).reshape(C, 3, 3 * C)
        p = _times(Qᵀ, self.q)
        scale = float(np.abs(p).max())
        p /= scale
        y, z, each = np.zeros((C, 3)), np.zeros((C, 3)), np.arange(C)
        y[:, 0] = z[:, 0] = 1.0
        due, error = 1e-3, np.inf
        for _ in range(_INTERIOR):
            self.iterations += 1
            τ = float(y.ravel().dot(z.ravel())) / C
            v = np.matmul(M, y.ravel()) + p
            speed = np.sqrt(v[:, 1] ** 2 + v[:, 2] ** 2 + min(0.1 * τ, 1.0) ** 2)
            lack = v - z
            lack[:, 0] += speed
            error = max(float(np.abs(lack).max()), τ)
            if not (_LIMIT < error < 1 / _LIMIT and min(_determinant(y).min(), _determinant(z).min()) > 0):
                break
            if error < due:
                due = error / 100
                if self.newton(scale * _times(Q, y)):
                    return True
            B = M.copy()  # Δz = B Δy + lack
            B[:, 0] += (v[:, 1] / speed)[:, None] * M[:, 1] + (v[:, 2] / speed)[:, None] * M[:, 2]
            H, inverse, square = _scaling(y, z)
            G = B.reshape(C, 3, C, 3).copy()
            G[each, :, each] += square
            middle = _times(H, y)
            arrow = _arrow(middle)
            aim = -_product(middle, middle)
            try:
                for corrected in (False, True):
                    step = _times(H, np.linalg.solve(arrow, aim[:, :, None])[:, :, 0])
                    Δy = np.linalg.solve(G.reshape(3 * C, 3 * C), (step - lack).ravel()).reshape(C, 3)
                    Δz = np.matmul(B, Δy.ravel()) + lack
                    α = min(_reach(y, Δy), _reach(z, Δz))
                    if not corrected:
                        aim -= _product(_times(H, Δy), _times(inverse, Δz))
                        aim[:, 0] += max((1 - α) ** 3, 0.1) * τ
            except np.linalg.LinAlgError:
                break
            y, z = y + 0.9 * α * Δy, z + 0.9 * α * Δz
        if not (error <= GOOD / 10 and np.isfinite(y).all()):
            return False
        self.best, self.error = scale * _times(Q, y), error * self.speed
        self.velocities = self.W.dot(self.best.ravel()).reshape(C, 3) + self.q
        return True

    def follow(self, factor: float, sweeps: int) -> bool:
        """Whether Newton's method arrives along solutions of problems with a compliance that shrinks by the factor."""
        f, compliance = np.zeros_like(self.q), 10.0
        while compliance > _PROXIMAL:
            W = self.W.copy()
            W.ravel()[:: len(W) + 1] += compliance * np.repeat(self.size, 3)
            softer = _Frictional(W, self.q, self.n, self.μ, self.size[:, 0])
            if not softer.newton(f, tolerance=1e-6):
                softer.newton(softer.sweep(softer.best, sweeps), tolerance=1e-6)
            self.iterations += softer.iterations
            f = softer.best
            if compliance < 0.01 and self.newton(f):
                return True
            compliance *= factor
        return False

    def sweep(self, f: Array, sweeps: int) -> Array:
        """Block Gauss-Seidel: one pair after the other, normal before tangent (Jean, CMAME 177, 1999)."""
        f, C = f.copy(), len(f)
        blocks = self.W.reshape(C, 3, C, 3)[np.arange(C), :, np.arange(C)]
        floor = 1e-12 * self.size[:, 0]
        normal = np.maximum(((blocks @ self.n[:, :, None])[:, :, 0] * self.n).dot(_ONES), floor)
        across = np.eye(3) - self.n[:, :, None] * self.n[:, None, :]
        tangent = np.maximum(np.linalg.eigvalsh(across @ blocks @ across)[:, -1], floor)
        for _ in range(sweeps):
            self.iterations += 1
            before = f.copy()
            for i in range(C):
                n, rows = self.n[i], self.W[3 * i : 3 * i + 3]
                λ = n.dot(f[i])
                λ_new = max(0.0, λ - n.dot(rows.dot(f.ravel()) + self.q[i]) / normal[i])
                f[i] += (λ_new - λ) * n
                t = f[i] - λ_new * n - across[i].dot(rows.dot(f.ravel()) + self.q[i]) / tangent[i]
                length = np.sqrt(t.dot(t))
                f[i] = λ_new * n + t * min(1.0, self.μ * λ_new / max(length, 1e-300))
            if np.abs(f - before).max() <= 1e-15 * np.abs(f).max():
                break
        return f


class _Frictionless:
    """A linear complementarity problem: a primal-dual active set, and an interior-point method where it cycles."""

    def __init__(self, W: Array, q: Array, normals: Array, size: Array):
        C = len(q)
        N = np.zeros((C, C, 3))
        N[np.arange(C), np.arange(C)] = normals
        N = N.reshape(C, 3 * C)
        self.W, self.q, self.n, self.M, self.r = W, q, normals, N.dot(W).dot(N.T), (q * normals).dot(_ONES)
        self.size = np.maximum(self.M.diagonal(), 1e-12 * size)
        self.speed = float(np.abs(self.r).max())
        self.best, self.error, self.iterations = self.r, np.inf, 0

    def solve(self, start: Array) -> Solution:
        if not self.newton((start * self.n).dot(_ONES)):
            with np.errstate(all="ignore"):  # what diverges ends
                arrived = self.through_interior()
            if not arrived:
                _accept(self.error / self.speed, len(self.q), self.iterations)
        f = self.best[:, None] * self.n
        u = self.W.dot(f.ravel()).reshape(f.shape) + self.q
        return Solution(f, u, self.iterations, self.error / self.speed)

    def newton(self, λ: Array) -> bool:
        """Whether the active set settles, beginning with that of λ (Hintermüller, Ito & Kunisch, 2002)."""
        for _ in range(_NEWTON):
            z = λ - (self.M.dot(λ) + self.r) / self.size
            projected = np.maximum(z, 0.0)
            error, before = float(np.abs((λ - projected) * self.size).max()), self.error
            if error < before:
                self.best, self.error = projected, error
            if error <= _SOLVED * self.speed or before / 2 < self.error <= GOOD / 100 * self.speed:
                return True
            self.iterations += 1
            closed = np.flatnonzero(z > 0)
            M = self.M[closed[:, None], closed]
            wanted = M.dot(λ[closed]) + self.r[closed]
            M.ravel()[:: len(closed) + 1] += _PROXIMAL * self.size[closed]
            λ, previous = np.zeros_like(λ), λ
            λ[closed] = previous[closed] - np.linalg.solve(M, wanted)
        return False

    def through_interior(self) -> bool:
        """Whether the active set settles from an approximation by Mehrotra's predictor-corrector method (1992)."""
        root = np.sqrt(self.size)
        M, p = self.M / (root * root[:, None]), self.r / root
        scale = float(np.abs(p).max())
        p /= scale
        y, z = np.ones_like(p), np.ones_like(p)
        due, error = 1e-3, np.inf
        for _ in range(_INTERIOR):
            self.iterations += 1
            τ = float(y.dot(z)) / len(y)
            lack = M.dot(y) + p - z
            error = max(float(np.abs(lack).max()), τ)
            if not _LIMIT < error < 1 / _LIMIT:
                break
            if error < due:
                due = error / 100
                if self.newton(scale * y / root):
                    return True
            G = M.copy()
            G.ravel()[:: len(y) + 1] += z / y
            aim = -y * z
            for corrected in (False, True):
                Δy = np.linalg.solve(G, aim / y - lack)
                Δz = M.dot(Δy) + lack
                α = min(_stays(y, Δy), _stays(z, Δz))
                if not corrected:
                    aim += max((1 - α) ** 3, 0.1) * τ - Δy * Δz
            y, z = y + 0.9 * α * Δy, z + 0.9 * α * Δz
        if not (error <= GOOD / 10 and np.isfinite(y).all()):
            return False
        self.best, self.error = scale * y / root, error * self.speed
        return True


class _Layout(NamedTuple):
    """Where the unknowns of all pairs are: three of each that sticks, then two of each that slips.

    Attributes:
        unknowns: their number m.
        pairs: (m,) whose each is.
        slip: (b,) pairs that slip.
        aside: (b,) their second unknowns.
        stick_entries: of the ones in a matrix (3C, m), flattened.
        slip_entries: (b, 3, 2) of the directions of what slips.
    """

    unknowns: int
    pairs: Array
    slip: Array
    aside: Array
    stick_entries: Array
    slip_entries: Array


@lru_cache(maxsize=256)
def _layout(statuses: bytes) -> _Layout:
    status = np.frombuffer(statuses, np.int8)
    stick, slip = np.flatnonzero(status == _STICK), np.flatnonzero(status == _SLIP)
    a, b = 3 * len(stick), 2 * len(slip)
    columns = a + np.arange(b).reshape(-1, 1, 2)
    return _Layout(
        unknowns=a + b,
        pairs=np.concatenate([np.repeat(stick, 3), np.repeat(slip, 2)]),
        slip=slip,
        aside=a + np.arange(1, b, 2),
        stick_entries=(3 * stick[:, None] + _XYZ).ravel() * (a + b) + np.arange(a),
        slip_entries=(3 * slip[:, None, None] + _XYZ[:, None]) * (a + b) + columns,
    )


def _frames(n: Array) -> Array:
    """Orthonormal (C, 3, 3), whose first columns are the unit vectors n."""
    t = np.cross(n, np.eye(3)[np.abs(n).argmin(axis=1)])
    t /= np.sqrt((t * t).dot(_ONES))[:, None]
    return np.stack([n, t, np.cross(n, t)], axis=2)


def _times(A: Array, x: Array) -> Array:
    """The products of matrices (C, 3, 3) and vectors (C, 3)."""
    return np.matmul(A, x[:, :, None])[:, :, 0]


def _arrow(y: Array) -> Array:
    """The matrices (C, 3, 3) with y o z = arrow(y) z."""
    arrow = y[:, :1, None] * np.eye(3)
    arrow[:, 0] = arrow[:, :, 0] = y
    return arrow


def _product(y: Array, z: Array) -> Array:
    """Jordan's product y o z = (y·z, y₀ z_t + z₀ y_t)."""
    product = y[:, :1] * z + z[:, :1] * y
    product[:, 0] = (y * z).dot(_ONES)
    return product


def _determinant(y: Array) -> Array:
    """y₀² - |y_t|², without cancellation near the border of the cone."""
    length = np.hypot(y[:, 1], y[:, 2])
    return (y[:, 0] - length) * (y[:, 0] + length)


def _scaling(y: Array, z: Array) -> tuple[Array, Array, Array]:
    """Nesterov and Todd's H (C, 3, 3), symmetric with H y = H⁻¹ z, its inverse and its square."""
    flip = np.array([1.0, -1.0, -1.0])
    det_y, det_z = _determinant(y), _determinant(z)
    y, z = y / np.sqrt(det_y)[:, None], z / np.sqrt(det_z)[:, None]
    w = (z + flip * y) / np.sqrt(2 + 2 * (y * z).dot(_ONES))[:, None]
    η = np.sqrt(np.sqrt(det_z / det_y))[:, None, None]
    H = np.empty((len(y), 3, 3))
    H[:, 0] = H[:, :, 0] = w
    H[:, 1:, 1:] = np.eye(2) + w[:, 1:, None] * w[:, None, 1:] / (1 + w[:, :1, None])
    return η * H, H * (flip[:, None] * flip) / η, η**2 * (2 * w[:, :, None] * w[:, None, :] - np.diag(flip))


def _reach(y: Array, Δy: Array) -> float:
    """The largest α <= 1 with y + α Δy in the cones."""
    a, c = Δy[:, 0] ** 2 - Δy[:, 1] ** 2 - Δy[:, 2] ** 2, _determinant(y)
    b = y[:, 0] * Δy[:, 0] - y[:, 1] * Δy[:, 1] - y[:, 2] * Δy[:, 2]
    root = b**2 - a * c  # a α² + 2 b α + c = 0
    below = np.sqrt(np.maximum(root, 0.0)) - b
    leaves = (root >= 0) & (below > 0)
    return min(1.0, float((c[leaves] / below[leaves]).min(initial=1.0)))


def _stays(y: Array, Δy: Array) -> float:
    """The largest α <= 1 with y + α Δy >= 0."""
    falls = Δy < 0
    return min(1.0, float((y[falls] / -Δy[falls]).min(initial=1.0)))


def _accept(relative: float, pairs: int, iterations: int) -> None:
    """Raises StepError if what is left of the residual is too much."""
    if not relative <= _FAIR:
        raise StepError(
            f"contact of {pairs} pairs: no forces found that stop them: after {iterations} iterations the residual is "
            f"{relative:.1e} of the velocities, allowed is {_FAIR:.0e}; a smaller dt, less friction or the penalty "
            f"variant (stiffness) may help"
        )
