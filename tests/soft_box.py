"""A box of linear tetrahedra that deforms largely, in NumPy and SciPy alone: an independent full order to reduce."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy.sparse
import scipy.sparse.linalg
from bodies import box_arrays, box_surfaces

import fenics_rom as fr
from fenics_rom.errors import SolverError
from fenics_rom.mechanics.hyperelastic import moduli, strain, stress
from fenics_rom.mechanics.point_material import PointMaterial
from fenics_rom.mechanics.step import StepInput
from fenics_rom.mechanics.voigt import VOIGT_INDEX, VOIGT_PAIRS, VOIGT_SHEAR
from fenics_rom.scene.file import parse_scene
from fenics_rom.system.body import Body, Unknowns

Array = np.ndarray


@dataclass
class SoftDeformation:
    """What a system has in `deformation`, of points (N, 3) and cells (P, 4); nodes at x = 0 are held.

    `pressed` are outward triangles under pressure, `cable` nodes that a tendon runs through, `inputs` the columns of
    each contact mode, or names of what follows.
    """

    points: Array
    cells: Array
    law: str
    first_lame: Array
    shear: Array
    viscosity: Array
    mass: scipy.sparse.spmatrix
    external_damping: scipy.sparse.spmatrix
    spring = None
    pressed: Array
    cable: Array
    inputs: dict[str, list[Array | str]] = field(default_factory=dict)

    @property
    def material(self) -> PointMaterial:
        return PointMaterial(self.law, self.first_lame, self.shear)

    def viscous(self, twice: Array, change: Array) -> Array:
        """2μ ΔE + λ (C⁻¹:ΔE) C⁻¹ (6, P), with 1 in place of C⁻¹ of St. Venant-Kirchhoff's; `twice`: C - 1."""
        inverse = np.repeat([[1.0], [1], [1], [0], [0], [0]], len(self.cells), axis=1)
        if self.law != "st_venant_kirchhoff":
            C = np.eye(3) + (twice / VOIGT_SHEAR)[VOIGT_INDEX].transpose(2, 0, 1)
            inverse = np.linalg.inv(C)[:, VOIGT_PAIRS[:, 0], VOIGT_PAIRS[:, 1]].T
        return 2 * self.shear * change / VOIGT_SHEAR + self.first_lame * (inverse * change).sum(axis=0) * inverse

    @cached_property
    def free(self) -> Array:
        return np.flatnonzero(np.repeat(self.points[:, 0] > 0, 3))

    @cached_property
    def _shapes(self) -> tuple[Array, Array]:
        """∂N_a/∂X_j (P, 4, 3) and volumes."""
        edges = self.points[self.cells[:, 1:]] - self.points[self.cells[:, :1]]
        inner = np.linalg.inv(edges).transpose(0, 2, 1)
        volumes = np.abs(np.linalg.det(edges)) / 6
        return np.concatenate([-inner.sum(axis=1, keepdims=True), inner], axis=1), volumes

    @property
    def weights(self) -> Array:
        return self._shapes[1]

    @cached_property
    def operator(self) -> scipy.sparse.csr_matrix:
        """∇ of the free displacements: rows (i, j, p)."""
        P, N = len(self.cells), len(self.points)
        dN = self._shapes[0]
        i, j, p, a = np.meshgrid(range(3), range(3), range(P), range(4), indexing="ij")
        rows, columns = (i * 3 + j) * P + p, 3 * self.cells[p, a] + i
        matrix = scipy.sparse.coo_matrix((dN[p, a, j].ravel(), (rows.ravel(), columns.ravel())), (9 * P, 3 * N))
        return matrix.tocsc()[:, self.free].tocsr()

    @cached_property
    def _cell_matrices(self) -> tuple[Array, Array, tuple[Array, Array]]:
        """∇ of a cell's displacements (P, 9, 12); which entries (P, 12, 12) are free, and where they belong."""
        B = np.einsum("ik,paj->pijak", np.eye(3), self._shapes[0]).reshape(-1, 9, 12)
        number = np.full(3 * len(self.points), -1)
        number[self.free] = np.arange(len(self.free))
        number = number[3 * self.cells[:, :, None] + np.arange(3)].reshape(-1, 12)
        row, column = np.broadcast_arrays(number[:, :, None], number[:, None, :])
        kept = (row >= 0) & (column >= 0)
        return B, kept, (row[kept], column[kept])

    def gradients(self, columns: Array) -> Array:
        return (self.operator @ columns).reshape(3, 3, len(self.cells), -1)

    def resultants(self, stresses: Array) -> Array:
        """∫ P : ∇δ (n, k) of first Piola-Kirchhoff stresses (3, 3, P, k)."""
        weighted = self.weights[:, None] * stresses
        return self.operator.T @ weighted.reshape(9 * len(self.cells), -1)

    def tangent(self, before: Array, after: Array, D: Array, S: Array) -> scipy.sparse.spmatrix:
        """∫ (before ∇δ) : D : (after ∇v) + S : ∇δᵀ∇v for deformation gradients (3, 3, P), D (6, 6, P), S (6, P)."""
        C = np.einsum("ajblp,kbp->pajkl", D[VOIGT_INDEX][:, :, VOIGT_INDEX], after)
        C = np.einsum("iap,pajkl->pijkl", before, C) + np.einsum("ik,jlp->pijkl", np.eye(3), S[VOIGT_INDEX])
        B, kept, places = self._cell_matrices
        blocks = B.transpose(0, 2, 1) @ (self.weights[:, None, None] * C.reshape(-1, 9, 9)) @ B
        return scipy.sparse.coo_matrix((blocks[kept], places), shape=(len(self.free),) * 2).tocsc()

    def stiffness(self) -> scipy.sparse.csc_matrix:
        """K at rest."""
        P, F = len(self.cells), np.repeat(np.eye(3)[:, :, None], len(self.cells), axis=2)
        D = moduli(self.law, np.zeros((6, P)), self.first_lame, self.shear)
        K = self.tangent(F, F, D, np.zeros((6, P)))
        return (K + K.T) / 2

    def force(self, x: Array) -> Array:
        """Elastic force (n,)."""
        H = self.gradients(x[:, None])[..., 0]
        S = stress(self.law, strain(H), self.first_lame, self.shear)
        first = np.einsum("ikp,kjp->ijp", H + np.eye(3)[:, :, None], S[VOIGT_INDEX])
        return self.resultants(first[..., None])[:, 0]

    def places(self, x: Array) -> Array:
        moved = self.points.copy().ravel()
        moved[self.free] += x
        return moved.reshape(-1, 3)

    def follower(self, x: Array) -> dict[str, Array]:
        places = self.places(x)
        a, b, c = places[self.pressed].transpose(1, 0, 2)
        pushed, pulled = np.zeros_like(places), np.zeros_like(places)
        np.add.at(pushed, self.pressed, -np.cross(b - a, c - a)[:, None] / 6)
        pieces = np.diff(places[self.cable], axis=0)
        directions = pieces / np.linalg.norm(pieces, axis=1)[:, None]
        np.add.at(pulled, self.cable[:-1], directions)
        np.add.at(pulled, self.cable[1:], -directions)
        return {name: f.ravel()[self.free, None] for name, f in (("air", pushed), ("cable", pulled))}

    @property
    def tendons(self) -> dict[str, tuple[Array, Array]]:
        full = np.zeros((3 * len(self.points), 3 * len(self.cable)))
        full[(3 * self.cable[:, None] + np.arange(3)).ravel(), np.arange(3 * len(self.cable))] = 1.0
        return {"cable": (self.points[self.cable], full[self.free])}

    def stepper(
        self, dt: float, environment: None = None, *, ledger: bool = True, system: None = None
    ) -> "SoftStepper":
        return SoftStepper(self, dt)


class SoftStepper:
    """Steps it by the energy-consistent midpoint rule."""

    def __init__(self, body: SoftDeformation, dt: float):
        self.body, self.dt, self.time = body, dt, 0.0
        self.contact_mode, self.actuators = "tip", None
        self.x, self.v = np.zeros((2, len(body.free), 1))

    def set_state(self, x: Array, v: Array) -> None:
        self.x, self.v = x.reshape(-1, 1).copy(), v.reshape(-1, 1).copy()

    def close(self) -> None:
        pass

    def switch(self, contact: str) -> float:
        self.contact_mode = contact
        return 0.0

    def set_time_step(self, dt: float) -> None:
        self.dt = dt

    def _force(self, u: Array, x: Array) -> Array:
        follower = self.body.follower(x)
        blocks = [follower[b] if isinstance(b, str) else b for b in self.body.inputs[self.contact_mode]]
        return np.hstack(blocks) @ u

    def step(self, inputs: StepInput) -> None:
        """By halves where Newton's iteration does not solve the whole."""
        parts = 1
        while not self._in_parts(inputs.u, parts):
            parts *= 2
            if parts > 16:
                raise SolverError("Newton did not converge")

    def _in_parts(self, u: Array, parts: int) -> bool:
        before, h = (self.x, self.v, self.time), self.dt
        self.dt = h / parts
        solved = all(self._solved(u) for _ in range(parts))
        self.dt = h
        if not solved:
            self.x, self.v, self.time = before
        return solved

    def _solved(self, u: Array) -> bool:
        body, h, x, v = self.body, self.dt, self.x[:, 0], self.v[:, 0]
        λ, μ, β = body.first_lame, body.shear, body.viscosity
        unit, K0 = np.eye(3)[:, :, None], moduli("st_venant_kirchhoff", np.zeros((6, len(λ))), λ, μ)
        H = body.gradients(x[:, None])[..., 0]
        E, mid = strain(H), v.copy()
        constant = (2 / h * body.mass + body.external_damping).tocsc()
        for _ in range(15):
            H_next = body.gradients((x + h * mid)[:, None])[..., 0]
            E_next, F_mid = strain(H_next), unit + (H + H_next) / 2
            S = body.material.discrete_gradient_stress(E, E_next) + β / h * body.viscous(E + E_next, E_next - E)
            inner = body.resultants(np.einsum("ikp,kjp->ijp", F_mid, S[VOIGT_INDEX])[..., None])[:, 0]
            outer = self._force(u, x + h / 2 * mid)
            residual = body.mass @ (2 / h * (mid - v)) + body.external_damping @ mid + inner - outer
            scale = sum(map(np.linalg.norm, (outer, inner, 2 / h * (body.mass @ v))))
            if np.linalg.norm(residual) <= 1e-9 * scale:
                break
            D = moduli(body.law, (E + E_next) / 2, λ, μ) / 2 + β / h * K0
            slope = h * body.tangent(F_mid, unit + H_next, D, S / 2) + constant
            mid = mid - scipy.sparse.linalg.splu(slope).solve(residual)
        else:
            return False
        self.x = self.x + h * mid[:, None]
        self.v = 2 * mid[:, None] - self.v
        self.time += h
        return True

    def equilibrium(self, inputs: StepInput) -> None:
        u = inputs.u
        body, x = self.body, self.x[:, 0]
        for _ in range(50):
            H = body.gradients(x[:, None])[..., 0]
            E, F = strain(H), np.eye(3)[:, :, None] + H
            S = stress(body.law, E, body.first_lame, body.shear)
            outer = self._force(u, x)
            residual = body.force(x) - outer
            if np.linalg.norm(residual) <= 1e-9 * np.linalg.norm(outer) + 1e-30:
                break
            slope = body.tangent(F, F, moduli(body.law, E, body.first_lame, body.shear), S)
            x = x - scipy.sparse.linalg.splu(slope.tocsc()).solve(residual)
        else:
            raise SolverError("Newton did not converge")
        self.x, self.v = x[:, None], 0 * self.v


def scalar_mass(points: Array, cells: Array, density: float) -> scipy.sparse.csr_matrix:
    """Consistent mass of all nodes, one component."""
    edges = points[cells[:, 1:]] - points[cells[:, :1]]
    volumes = np.abs(np.linalg.det(edges)) / 6
    blocks = density * volumes[:, None, None] / 20 * (np.ones((4, 4)) + np.eye(4))
    rows, columns = np.repeat(cells, 4, axis=1), np.tile(cells, (1, 4))
    return scipy.sparse.coo_matrix((blocks.ravel(), (rows.ravel(), columns.ravel())), (len(points),) * 2).tocsr()


def soft_box(
    lengths: tuple[float, float, float],
    bricks: tuple[int, int, int],
    run: str,
    *,
    law: str = "st_venant_kirchhoff",
    young: float = 5e5,
    poisson: float = 0.4,
    density: float = 1100.0,
    alpha: float = 1.0,
    beta: float = 2e-3,
    effects: str = "inertia = {}",
) -> fr.System:
    """A box held at x = 0: contact modes "tip" and "middle", a tendon "cable" below, and "air" on its top.

    Args:
        lengths, bricks: m, and how many along each axis.
        run: text of the table [run].
        effects: those of the scene's effects that the box does not have by itself.
    """
    points, cells = box_arrays(lengths, bricks)
    surfaces = box_surfaces(points, cells)
    λ, μ = young * poisson / (1 + poisson) / (1 - 2 * poisson), young / 2 / (1 + poisson)
    number = np.ones(len(cells))
    scalar = scalar_mass(points, cells, density)
    free = np.flatnonzero(np.repeat(points[:, 0] > 0, 3))
    M = scipy.sparse.kron(scalar, np.eye(3)).tocsr()[free][:, free]
    below = np.flatnonzero(np.isclose(points[:, 1], (bricks[1] // 2) * lengths[1] / bricks[1]) & (points[:, 2] == 0))
    body = SoftDeformation(
        points,
        cells,
        law,
        λ * number,
        μ * number,
        beta * number,
        M,
        alpha * M,
        pressed=_outward(points, surfaces["top"]),
        cable=below[np.argsort(points[below, 0])],
    )

    def patch(near: Array) -> Array:
        """1 N along each axis, spread over nodes."""
        return np.kron(near[:, None] / near.sum(), np.eye(3))[free]

    contacts = {
        "tip": patch(np.isclose(points[:, 0], lengths[0])),
        "middle": patch(np.isclose(points[:, 2], lengths[2]) & (np.abs(points[:, 0] / lengths[0] - 0.5) <= 0.1)),
    }
    actuators = body.follower(np.zeros(len(free)))
    text = f'[mesh]\nfile = "{__file__}"\n[material]\nyoung = {young}\npoisson = {poisson}\ndensity = {density}\n'
    text += '[supports]\nclamped = ["left"]\n[contacts.tip]\nsurface = "right"\n[contacts.middle]\nsurface = "top"\n'
    text += f'[effects]\n{effects}\nlarge_deformation = {{ material = "{law}" }}\n'
    text += f"damping = {{ alpha = {alpha}, beta = {beta} }}\n" if "inertia" in effects else ""
    text += '[effects.pressure.air]\nsurface = "top"\n'
    text += "[effects.tendon.cable]\npoints = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]\n"
    scene = parse_scene(text + f"[run]\n{run}\n")
    K = body.stiffness()
    node_mass = np.asarray(scalar.sum(axis=1)).ravel()
    system = fr.System(
        mass=M,
        stiffness=K,
        rayleigh=(alpha, beta),
        contacts=contacts,
        actuators=actuators,
        body=Body(points, np.concatenate(list(surfaces.values())), Unknowns(3 * len(points), free), node_mass),
        scene=scene,
        outputs={"tip": contacts["tip"]},
        units={"air": 1.0, "cable": 1.0},
        deformation=body,
    )
    body.inputs = {name: [B, "air", "cable"] for name, B in contacts.items()}
    return system


def _outward(points: Array, triangles: Array) -> Array:
    """The same triangles of the top, with normals upwards."""
    a, b, c = points[triangles].transpose(1, 0, 2)
    down = np.cross(b - a, c - a)[:, 2] < 0
    return np.where(down[:, None], triangles[:, ::-1], triangles)
