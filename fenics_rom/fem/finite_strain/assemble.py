"""Large deformation of an assembled system, as the reduction and `simulate` see it."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fenics_rom.fem.finite_strain.follower_loads import Follower, Pressure, Tendon
from fenics_rom.fem.finite_strain.model import Model
from fenics_rom.fem.finite_strain.quadrature import Points
from fenics_rom.fem.finite_strain.stepper import LargeDeformationSimulator
from fenics_rom.fem.finite_strain.stresses import Material, StressesAtRest
from fenics_rom.fem.loads import patch_of
from fenics_rom.fem.nodes import Nodes, patch_triangles, shape_functions
from fenics_rom.fem.petsc_matrix import PetscMatrix
from fenics_rom.mechanics.active_environment import ActiveEnvironment
from fenics_rom.scene.scene import Scene
from fenics_rom.system.system import Array, System


@dataclass(frozen=True)
class LargeDeformation:
    """A `system.Deformation` of PETSc matrices and the points of a mesh."""

    system: System
    model: Model

    @property
    def law(self) -> str:
        """Of the material."""
        return self.model.material.law

    @property
    def weights(self) -> Array:
        """Volumes (P here,) that the points stand for, m³."""
        return self.model.points.weights

    @property
    def first_lame(self) -> Array:
        """λ (P here,), Pa."""
        return self.model.material.first_lame

    @property
    def shear(self) -> Array:
        """μ (P here,), Pa."""
        return self.model.material.shear

    @property
    def viscosity(self) -> Array:
        """β (P here,), s."""
        return self.model.material.viscosity

    @property
    def spring(self) -> PetscMatrix | None:
        """K_s, N/m; None: no springs."""
        return self.model.spring

    @property
    def external_damping(self) -> PetscMatrix | None:
        """D_c, N s/m; None: no damping but the material's."""
        return self.model.external_damping

    def gradients(self, columns: Array) -> Array:
        """As in `system.Deformation`."""
        fields = np.zeros((3 * self.model.points.count, columns.shape[1]))
        fields[self.model.free] = self.model.algebra.gather(columns)
        return self.model.points.gradients_of(fields.reshape(-1, 3, columns.shape[1]))

    def force(self, x: Array) -> Array:
        """As in `system.Deformation`."""
        H = self.model.points.gradients(self.model.everywhere(x.reshape(-1, 1)))
        return self.model.here(self.model.points.forces(StressesAtRest(self.model.material, H).first))[:, 0]

    def simulator(
        self, dt: float, surroundings: ActiveEnvironment | None = None, *, ledger: bool = True
    ) -> LargeDeformationSimulator:
        """As in `system.Deformation`."""
        return LargeDeformationSimulator(self.system, self.model, dt, surroundings, ledger=ledger)

    def follower(self, x: Array) -> dict[str, Array]:
        """As in `system.Deformation`."""
        u = self.model.everywhere(x.reshape(-1, 1))
        return {name: self.model.here(one.force(u)) for name, one in self.model.followers.items()}

    @cached_property
    def tendons(self) -> dict[str, tuple[Array, Array]]:
        """As in `system.Deformation`."""
        here = self.model.free[self.model.algebra.rows()]
        cables = {name: one for name, one in self.model.followers.items() if isinstance(one, Tendon)}
        return {name: (one.points, np.kron(one.shapes.T, np.eye(3))[here]) for name, one in cables.items()}


def large_deformation_of(
    system: System,
    nodes: Nodes,
    of_cells: Callable[[Array], tuple[Array, Array, Array]],
    external_damping: PetscMatrix | None,
    spring: PetscMatrix | None,
) -> LargeDeformation:
    """The deformation of an assembled system.

    Args:
        system: assembled from a scene that names the effect.
        nodes: of its mesh.
        of_cells: λ, μ (Pa) and β (s) of cells of the mesh file.
        external_damping: D_c, N s/m.
        spring: K_s, N/m.
    """
    scene = system.scene
    assert scene is not None
    points = Points(nodes, scene.degree, system.algebra.comm)  # type: ignore[attr-defined]
    each = points.shape_gradients.shape[1]
    moduli = (np.repeat(values, each) for values in of_cells(points.cells))
    material = Material(scene.effects["large_deformation"]["material"], *moduli)
    mass: PetscMatrix = system.mass  # type: ignore[assignment]
    model = Model(
        mass, external_damping, spring, points, material, _followers(scene, nodes), system.body.free, system.algebra
    )
    return LargeDeformation(system, model)


def _followers(scene: Scene, nodes: Nodes) -> dict[str, Follower]:
    """Pressures and tendons of a scene."""
    found: dict[str, Follower] = {}
    for name, one in scene.effects.get("pressure", {}).items():
        found[name] = Pressure(nodes, patch_triangles(nodes, patch_of(one, "normal"), f"effects.pressure.{name}"))
    for name, one in scene.effects.get("tendon", {}).items():
        points = np.array(one["points"])
        shapes = [shape_functions(nodes, point, f"effects.tendon.{name}.points") for point in points]
        found[name] = Tendon(points, np.array(shapes))
    return found
