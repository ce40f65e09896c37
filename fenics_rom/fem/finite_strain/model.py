"""What a body that deforms largely consists of at full order."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.sparse
from numpy import ndarray as Array

from fenics_rom.fem.finite_strain.follower_loads import FollowerLoad, TendonPull
from fenics_rom.fem.finite_strain.quadrature import QuadraturePoints
from fenics_rom.fem.finite_strain.stresses import HyperelasticMaterial
from fenics_rom.fem.petsc_matrix import PetscMatrix
from fenics_rom.system.body import Unknowns
from fenics_rom.system.protocols import Algebra


@dataclass(frozen=True)
class FiniteStrainModel:
    """M, D_c and K_s, the points that strain, and what follows the body.

    Attributes:
        mass: M, kg.
        external_damping: D_c = α M and dashpots to ground, N s/m; None: nothing.
        spring: K_s of springs to ground, N/m; None: nothing.
        points: where strains are taken, of the cells of this rank.
        material: theirs.
        followers: forces that follow the body, by name of their actuator.
        unknowns: which of the 3 N displacements are rows, and which follow these.
        algebra: what the ranks do together.
        inner_damping: of a body in a moving frame, what of D_c is of its motion within: α M, N s/m; None: nothing.
    """

    mass: PetscMatrix
    external_damping: PetscMatrix | None
    spring: PetscMatrix | None
    points: QuadraturePoints
    material: HyperelasticMaterial
    followers: Mapping[str, FollowerLoad]
    unknowns: Unknowns
    algebra: Algebra
    inner_damping: PetscMatrix | None = None

    def nodal_field(self, x: Array) -> Array:
        """Displacements (N, 3) of all nodes from local rows (rows here, 1)."""
        return self.unknowns.expand(self.algebra.gather(x)).reshape(-1, 3)

    def local_rows(self, forces: Array) -> Array:
        """Local rows (rows here, k) of forces on all nodes (N, 3), or k of them (N, 3, k)."""
        return self.unknowns.restrict(forces.reshape(self.unknowns.components, -1))[self.algebra.rows()]

    @cached_property
    def components(self) -> Array:
        """(rows here,) which of the 3 N displacements each row is."""
        return self.unknowns.free[self.algebra.rows()]

    def internal_force(self, P: Array) -> Array:
        """∫ P : ∇δ (rows here, 1), N, of first Piola-Kirchhoff stresses (3, 3, P here), Pa."""
        return self.local_rows(self.points.internal_force(P))

    def dot(self, left: Array, right: Array) -> float:
        """leftᵀ right of columns (rows here, 1)."""
        return float(self.algebra.inner(left, right)[0, 0])

    def inverted(self, H: Array) -> int:
        """Number of points that displacement gradients (3, 3, P here) turn inside out, det F <= 0."""
        J = np.linalg.det((np.eye(3)[:, :, None] + H).transpose(2, 0, 1))
        return int(self.points.sum_over_ranks(np.array([np.count_nonzero(J <= 0.0)]))[0])

    def elastic_energy(self, E: Array) -> float:
        """∫ W, J, of Green strains (6, P here)."""
        return self.points.integrate(self.material.energy_density(E))


@dataclass(frozen=True)
class ExternalForce:
    """What pushes in a step.

    Attributes:
        dead: force (rows here, 1), N.
        following: the body, with their values.
        found: of which values are found in the step (n,), of strokes that are given, then at guides.
        rubbing: tendons that have these guides.
    """

    dead: Array
    following: tuple[tuple[float, FollowerLoad], ...]
    found: tuple[FollowerLoad, ...] = ()
    rubbing: tuple[TendonPull, ...] = ()

    def ramped(self, before: tuple[tuple[float, FollowerLoad], ...], share: float) -> "ExternalForce":
        """With what follows the body on its way from values before to its own, of which a share is done."""
        first, last = ({load: value for value, load in following} for following in (before, self.following))
        values = {load: (1 - share) * first.get(load, 0.0) + share * last.get(load, 0.0) for load in {**first, **last}}
        return replace(self, following=tuple((value, load) for load, value in values.items() if value))

    def with_found(self, values: Array) -> "ExternalForce":
        """All of it, with values (n,) of what is found in the step."""
        return replace(self, following=(*self.following, *zip(map(float, values), self.found, strict=True)), found=())

    def columns(self, model: FiniteStrainModel, u: Array) -> Array:
        """Unit forces (rows here, n) of what is found, at displacements of all nodes (N, 3)."""
        forces = np.stack([load.force(u) for load in self.found], axis=-1) if self.found else np.empty((*u.shape, 0))
        return model.local_rows(forces)

    def strokes(self, u: Array) -> Array:
        """What they do work along, (n,), m or m³."""
        return np.array([load.stroke(u) for load in self.found])

    @property
    def guides(self) -> int:
        """How many there are, the last of what is found."""
        return sum(len(tendon.points) - 2 for tendon in self.rubbing)

    def angles(self, u: Array) -> Array:
        """By which tendons turn at guides, (n,), rad, 0 of strokes."""
        angles = np.concatenate([np.empty(0), *(tendon.angles(u) for tendon in self.rubbing)])
        return np.concatenate([np.zeros(len(self.found) - len(angles)), angles])

    def at(self, model: FiniteStrainModel, u: Array) -> Array:
        """(rows here, 1), N, at displacements of all nodes (N, 3)."""
        forces = (value * follower.force(u) for value, follower in self.following)
        return self.dead + model.local_rows(sum(forces, np.zeros_like(u)))

    def stiffness(self, u: Array) -> scipy.sparse.csr_matrix:
        """The symmetric part of -∂force/∂u (3N, 3N), N/m, at displacements of all nodes (N, 3)."""
        zero = scipy.sparse.csr_matrix((u.size, u.size))
        return sum((value * follower.stiffness(u) for value, follower in self.following), zero)

    def jvp(self, model: FiniteStrainModel, u: Array, du: Array) -> Array:
        """Change (rows here, 1) of the force with that of displacements of all nodes (N, 3)."""
        changes = (value * follower.jvp(u, du) for value, follower in self.following)
        return model.local_rows(sum(changes, np.zeros_like(u)))


def multiply(matrix: PetscMatrix | None, column: Array) -> Array:
    """Product (rows here, 1) with a matrix that may be absent, which stands for zero."""
    return np.zeros_like(column) if matrix is None else matrix @ column
