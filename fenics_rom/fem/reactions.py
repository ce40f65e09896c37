"""What supports exert, at full order: rows and tables of what is read of the last step (`mechanics/reactions.py`)."""

from collections.abc import Callable, Mapping
from contextlib import closing
from functools import partial
from typing import Any

import numpy as np
import scipy.sparse
from numpy import ndarray as Array

from fenics_rom.errors import SceneError
from fenics_rom.fem.body_matrices import BodyMatrices
from fenics_rom.fem.finite_strain.follower_loads import PressureLoad
from fenics_rom.fem.loads import contact_columns
from fenics_rom.fem.nodes import Nodes
from fenics_rom.fem.petsc_algebra import PetscAlgebra
from fenics_rom.fem.petsc_matrix import PetscMatrix
from fenics_rom.fem.places import held_nodes, patch_triangles
from fenics_rom.fem.supports import supported_nodes
from fenics_rom.mechanics.reactions import REACTION, PressedRim, ReactionReading, Turning
from fenics_rom.scene.scene import ReadingEntry, Scene
from fenics_rom.system.body import Unknowns
from fenics_rom.system.system import System, components_of

AXES = np.eye(3)
Whole = tuple[BodyMatrices, Mapping[str, Array]]  # matrices of all components, and columns (3 N, any) of what acts


def asks_for_reactions(scene: Scene) -> bool:
    """Whether a scene reads any."""
    return any(entry.quantity == REACTION for entry in scene.readings.values())


def reactions_of(
    scene: Scene, nodes: Nodes, unknowns: Unknowns, system: System, whole: Whole
) -> dict[str, ReactionReading]:
    """The reactions that a scene reads, by name.

    Args:
        scene: what is read.
        nodes: of its mesh.
        unknowns: what supports leave, of which the system is.
        system: without these readings.
        whole: the same of all components, held or not.

    Raises:
        MeshError, SceneError: a place that does not exist, or what no reaction is known of.
    """
    supported, found = supported_nodes(scene, nodes), dict[str, ReactionReading]()
    for name, entry in scene.readings.items():
        if isinstance(entry, ReadingEntry) and entry.quantity == REACTION:
            of = _Support(scene, nodes, unknowns, supported, entry, f"readings.{name}")
            found[name] = of.reading(system, whole)
    return found


class _Support:
    """The nodes of a support, and the couple's point."""

    def __init__(
        self, scene: Scene, nodes: Nodes, unknowns: Unknowns, supported: Array, entry: ReadingEntry, where: str
    ):
        self._scene, self._nodes, self._unknowns = scene, nodes, unknowns
        self._where = f"{scene.source}: {where}"
        picked = supported
        if entry.place is not None:
            picked = np.intersect1d(held_nodes(nodes, entry.place, where), supported)
            if not len(picked):
                raise SceneError(f"{self._where}: its place has none of the {len(supported)} nodes that supports hold")
        self._picked, self._is_all = picked, len(picked) == len(supported)
        X = nodes.coordinates
        self._point = X[picked].mean(axis=0) if entry.point is None else np.array(entry.point)
        turned = np.stack([np.cross(axis, X - self._point) for axis in AXES], axis=2)
        moved = np.broadcast_to(AXES, (len(X), 3, 3))
        self._motions = np.concatenate([moved, turned], axis=2).reshape(-1, 6)  # of the whole body

    def reading(self, system: System, whole: Whole) -> ReactionReading:
        """What is read."""
        scene, (matrices, shared) = self._scene, whole
        is_large = scene.effects.large_deformation is not None
        if is_large:
            self._check_large()
        algebra = PetscAlgebra(system.algebra.comm, matrices.mass.mat.getOwnershipRange())  # type: ignore[attr-defined]

        def product(A: Any, fields: Array) -> Array:
            return algebra.gather(A @ np.ascontiguousarray(fields[algebra.rows()]))

        Φ = self._motions if self._is_all else self._static(system, partial(product, matrices.stiffness))
        D: Any = matrices.external[0] if is_large else matrices.damping
        K: Any = matrices.external[1] if is_large else matrices.stiffness
        if self._is_all and not scene.effects.springs:
            K = None  # elastic forces leave nothing of a motion of the whole
        M, none = product(matrices.mass, Φ), np.zeros_like(Φ)
        strained = none if K is None else product(K, Φ)
        if is_large or system.rayleigh is None:
            damped = none if D is None else product(D, Φ)
        else:
            damped = system.rayleigh[0] * M + system.rayleigh[1] * strained
        inertia, damping, stiffness = (self._unknowns.restrict(part).T for part in (M, damped, strained))
        pushes = {name: contact_columns(scene, self._nodes, self._unknowns, name) for name in scene.contacts}
        acting = np.hstack([np.empty((len(Φ), 0)), *(self._outside(name, shared[name]) for name in shared)])
        borne = np.hstack([np.empty((6, 0)), *(self._borne(name, shared[name]) for name in shared)])
        contacts, touched = {name: -Φ.T @ columns for name, columns in pushes.items()}, np.empty(0, dtype=int)
        if system.contact_points:
            touched = np.unique(system.points_of_contact().weights()[1])
        turning = None
        if is_large:
            at_nodes = self._unknowns.matrix[components_of(touched)]
            by_motion, by_rate, by_shape = (
                self._turned_by(None if A is None else _gathered(A) @ self._unknowns.matrix)
                for A in (matrices.mass, D, K)
            )
            of_contacts = {name: self._turned_by(-columns) for name, columns in pushes.items()}
            of_inputs, rims = self._turned_by(-acting), self._rims(shared)
            turning = Turning(by_motion, by_rate, by_shape, of_contacts, of_inputs, at_nodes, rims)
        at_points, inputs = Φ[components_of(touched)], borne - Φ.T @ acting
        rows = inertia, damping, stiffness
        return ReactionReading(self._point, *rows, contacts, inputs, touched, at_points, turning)

    def _static(self, system: System, stiffness: Callable[[Array], Array]) -> Array:
        """Φ (3 N, 6): rigid on the support, and at rest elsewhere; still there, if some motion is free."""
        effects, held = self._scene.effects, np.zeros_like(self._motions)
        if effects.viscoelasticity is not None and (effects.springs or system.rigid.shape[1]):
            raise SceneError(
                f"{self._where}: beside effects.viscoelasticity and springs, or where supports leave the body free to "
                "move, branches of the material act on a part of the supports by forces that are not read; use "
                "a reaction of all supports"
            )
        held[components_of(self._picked)] = self._motions[components_of(self._picked)]
        if system.rigid.shape[1]:
            return held
        rows = system.algebra.rows()
        pulled = self._unknowns.restrict(stiffness(held))[rows]
        with closing(system.algebra.factor((1.0, system.stiffness))) as factor:
            led = system.algebra.gather(factor.solve(-pulled))
        return held + self._unknowns.expand(led)

    def _outside(self, name: str, columns: Array) -> Array:
        """What an actuator or a load does to the body from outside, (3 N, any), N."""
        effects = self._scene.effects
        if effects.large_deformation is None:
            return columns
        within = name in effects.driven_support or name in effects.tendon or name in self._scene.environment.found_loads
        return np.zeros_like(columns) if within or name in effects.pressure else columns

    def _borne(self, name: str, columns: Array) -> Array:
        """Force and couple (6, any) of a support that is driven, as far as it is meant: it is one itself."""
        effects, at = self._scene.effects, components_of(self._picked)
        if effects.large_deformation is not None or name not in effects.driven_support:
            return np.zeros((6, columns.shape[1]))
        borne: Array = self._motions[at].T @ columns[at]
        return borne

    def _check_large(self) -> None:
        """Refuses (SceneError) what a body that deforms largely has no reaction of."""
        if not self._is_all:
            raise SceneError(
                f"{self._where}: with effects.large_deformation a reaction is that of all supports together, as the "
                "momentum of the body tells it; use one without a place, or whose place has all that is held"
            )

    def _rims(self, shared: Mapping[str, Array]) -> tuple[PressedRim, ...]:
        """Of pressures on surfaces with an opening."""
        rims, column, X, Z = list[PressedRim](), 0, self._nodes.coordinates, self._unknowns.matrix
        for name, columns in shared.items():
            if (pressure := self._scene.effects.pressure.get(name)) is not None:
                triangles = patch_triangles(self._nodes, pressure, f"effects.pressure.{name}")
                edge = PressureLoad(self._nodes, triangles).rim()
                if edge[0].shape[0]:
                    shapes = (scipy.sparse.kron(part, np.eye(3), format="csr") @ Z for part in edge)
                    rims.append(PressedRim(column, *(part @ X for part in edge), *shapes))
            column += columns.shape[1]
        return tuple(rims)

    def _turned_by(self, forces: Any) -> tuple[Any, Any, Any]:
        """Zᵀ E_iᵀ F of forces F (3 N, any), which are linear in something: couples by displacements x̂ about each axis.

        E_i u = e_i × u.
        """
        Z = self._unknowns.matrix
        if forces is None:
            forces = scipy.sparse.csr_array(Z.shape)
        crosses = (scipy.sparse.csr_array(np.cross(axis, AXES).T) for axis in AXES)
        nodes = scipy.sparse.identity(len(self._nodes.coordinates), format="csr")
        one, two, three = (Z.T @ (scipy.sparse.kron(nodes, cross, format="csr").T @ forces) for cross in crosses)
        return one, two, three


def _gathered(A: PetscMatrix) -> Any:
    """A matrix of all ranks, (3 N, 3 N), on every rank."""
    start, columns, values = A.mat.getValuesCSR()
    shape = (A.mat.getLocalSize()[0], A.mat.getSize()[1])
    own = scipy.sparse.csr_array((values, columns, start), shape=shape)
    return scipy.sparse.vstack(A.mat.comm.tompi4py().allgather(own), format="csr")
