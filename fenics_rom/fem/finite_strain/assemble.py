"""Large deformation of an assembled system, as the reduction and `simulate` see it."""

from dataclasses import dataclass
from functools import cached_property
from operator import attrgetter

import numpy as np
import scipy.sparse
from numpy import ndarray as Array

from fenics_rom.fem.cell_points import shape_functions
from fenics_rom.fem.fibres import point_material, quadrature_points
from fenics_rom.fem.finite_strain.carried_stepper import CarriedFiniteStrainStepper
from fenics_rom.fem.finite_strain.follower_loads import FollowerLoad, PressureLoad, RigidBar, SupportPush, TendonPull
from fenics_rom.fem.finite_strain.free_stepper import FreeFiniteStrainStepper
from fenics_rom.fem.finite_strain.model import FiniteStrainModel
from fenics_rom.fem.finite_strain.stepper import FiniteStrainStepper
from fenics_rom.fem.finite_strain.stresses import EquilibriumStresses, HyperelasticMaterial
from fenics_rom.fem.nodes import Nodes
from fenics_rom.fem.petsc_matrix import PetscMatrix
from fenics_rom.fem.places import patch_triangles
from fenics_rom.fem.rigid_surfaces import bars_of
from fenics_rom.fem.supports import support_column
from fenics_rom.mechanics.active_environment import ActiveEnvironment
from fenics_rom.scene.scene import Scene
from fenics_rom.system.system import System


@dataclass(frozen=True)
class FullOrderDeformation:
    """A `system.Deformation` of PETSc matrices and the points of a mesh."""

    system: System
    model: FiniteStrainModel

    # As in `system.Deformation`.
    law = property(attrgetter("model.material.law"))
    weights = property(attrgetter("model.points.weights"))
    first_lame = property(attrgetter("model.material.first_lame"))
    shear = property(attrgetter("model.material.shear"))
    material = property(attrgetter("model.material"))
    viscosity = property(attrgetter("model.material.viscosity"))
    spring = property(lambda self: self.model.spring if self.system.moving_frame is None else None)
    external_damping = property(
        lambda self: self.model.external_damping if self.system.moving_frame is None else self.model.inner_damping
    )

    def gradients(self, columns: Array) -> Array:
        """As in `system.Deformation`."""
        fields = self.model.unknowns.expand(self.model.algebra.gather(columns))
        return self.model.points.gradients(fields.reshape(-1, 3, columns.shape[1]))

    def force(self, x: Array) -> Array:
        """As in `system.Deformation`."""
        H = self.model.points.gradients(self.model.nodal_field(x.reshape(-1, 1)))
        return self.model.internal_force(EquilibriumStresses(self.model.material, H).P)[:, 0]

    def stepper(
        self,
        dt: float,
        environment: ActiveEnvironment | None = None,
        *,
        ledger: bool = True,
        system: System | None = None,
    ) -> FiniteStrainStepper:
        """As in `system.Deformation`."""
        return FiniteStrainStepper(system or self.system, self.model, dt, environment, ledger=ledger)

    def stepper_in_frame(
        self, dt: float, environment: ActiveEnvironment, *, ledger: bool = True, system: System | None = None
    ) -> FreeFiniteStrainStepper | CarriedFiniteStrainStepper:
        """As in `system.Deformation`."""
        system = system or self.system
        assert system.moving_frame is not None
        of_kind = CarriedFiniteStrainStepper if system.moving_frame.carried else FreeFiniteStrainStepper
        return of_kind(system, self.model, dt, environment, ledger=ledger)

    def follower(self, x: Array) -> dict[str, Array]:
        """As in `system.Deformation`."""
        u = self.model.nodal_field(x.reshape(-1, 1))
        return {name: self.model.local_rows(follower.force(u)) for name, follower in self.model.followers.items()}

    @cached_property
    def tendons(self) -> dict[str, tuple[Array, Array]]:
        """As in `system.Deformation`."""
        return self._lines(TendonPull)

    @cached_property
    def bars(self) -> dict[str, tuple[Array, Array]]:
        """As in `system.Deformation`."""
        return self._lines(RigidBar)

    def _lines(self, kind: type[TendonPull] | type[RigidBar]) -> dict[str, tuple[Array, Array]]:
        """Points at rest of each of a kind, and what rows here do there."""
        return {
            name: (follower.points, self._rows_at(follower.shapes))
            for name, follower in self.model.followers.items()
            if isinstance(follower, kind)
        }

    def _rows_at(self, shapes: scipy.sparse.csr_matrix) -> Array:
        """Displacements (rows here, 3K) of points of shape functions (K, N), of unknowns of 1."""
        everywhere = np.kron(shapes.toarray().T, np.eye(3))
        return self.model.unknowns.restrict(everywhere)[self.model.algebra.rows()]

    @cached_property
    def rims(self) -> dict[str, tuple[Array, Array, Array, Array]]:
        """As in `system.Deformation`."""
        rest, found = self.system.body.nodes, {}
        for name, follower in self.model.followers.items():
            if isinstance(follower, PressureLoad):
                of_edge = follower.rim()
                shapes = (self._rows_at(matrix) for matrix in of_edge)
                found[name] = (*(matrix @ rest for matrix in of_edge), *shapes)
        return found


def assemble_deformation(
    system: System,
    nodes: Nodes,
    moduli: Array,
    viscosity: Array,
    external_damping: PetscMatrix | None,
    spring: PetscMatrix | None,
    inner_damping: PetscMatrix | None,
) -> FullOrderDeformation:
    """The deformation of a system whose scene names it.

    λ and μ (C, 2), Pa, and β (C,), s, are of the cells of the mesh file; D_c (N s/m) and K_s (N/m) of the body.
    """
    scene = system.scene
    assert scene is not None
    assert scene.effects.large_deformation is not None
    points = quadrature_points(scene, nodes, system.algebra.comm)  # type: ignore[attr-defined]
    β = points.of_cells(viscosity[points.cells])
    material = HyperelasticMaterial(**vars(point_material(scene, nodes, points, moduli)), viscosity=β)
    mass: PetscMatrix = system.mass  # type: ignore[assignment]
    matrices, followers = (mass, external_damping, spring), _follower_loads(scene, nodes)
    body = system.body.unknowns, system.algebra
    model = FiniteStrainModel(*matrices, points, material, followers, *body, inner_damping=inner_damping)
    return FullOrderDeformation(system, model)


def _follower_loads(scene: Scene, nodes: Nodes) -> dict[str, FollowerLoad]:
    """Pressures, tendons, driven supports and rigid bars of a scene."""
    followers: dict[str, FollowerLoad] = {}
    for name, pressure in scene.effects.pressure.items():
        followers[name] = PressureLoad(nodes, patch_triangles(nodes, pressure, f"effects.pressure.{name}"))
    for name, tendon in scene.effects.tendon.items():
        points = np.array(tendon.points)
        shapes = [shape_functions(nodes, point, f"effects.tendon.{name}.points") for point in points]
        followers[name] = TendonPull(points, np.array(shapes))
    for name, support in scene.effects.driven_support.items():
        push = support_column(nodes, support, f"effects.driven_support.{name}")
        followers[name] = SupportPush(push.reshape(-1, 3))
    for name, ends in bars_of(scene, nodes).items():
        followers[name] = RigidBar(nodes.coordinates[ends], ends, len(nodes.coordinates))
    return followers
