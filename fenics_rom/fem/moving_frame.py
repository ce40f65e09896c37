"""A scene's body in a frame that moves with it: where its mass is, and how stress stiffens it."""

from collections.abc import Mapping
from contextlib import closing
from functools import cached_property

import numpy as np
import scipy.sparse
from mpi4py import MPI
from petsc4py import PETSc

from fenics_rom.fem.fibres import point_material, quadrature_points
from fenics_rom.fem.finite_strain.quadrature import QuadraturePoints
from fenics_rom.fem.loads import contact_columns
from fenics_rom.fem.nodes import Nodes
from fenics_rom.fem.outputs import output_rows
from fenics_rom.mechanics.hyperelastic import small_strain
from fenics_rom.mechanics.point_material import PointMaterial
from fenics_rom.mechanics.voigt import VOIGT_INDEX
from fenics_rom.scene.scene import Scene
from fenics_rom.system.body import Unknowns
from fenics_rom.system.moving_frame import FullOrderFrame, NodeMatrix
from fenics_rom.system.protocols import Algebra, Operator
from fenics_rom.system.rigid_modes import choose_fixed_dofs, free_rows
from fenics_rom.system.system import System, components_of


def frame_origin(scene: Scene, nodes: Nodes, node_mass: np.ndarray) -> np.ndarray:
    """Of a free body the centre of mass; of a carried one what the scene says, or the origin of its coordinates."""
    if not (scene.clamped or scene.held):
        return node_mass @ nodes.coordinates / node_mass.sum()
    return np.array(scene.environment.details("effects.base_path").get("origin", np.zeros(3)))


def mass_times(mass: PETSc.Mat, fields: np.ndarray, dolfinx_number: np.ndarray) -> np.ndarray:
    """M times a field of all nodes (N, 3), with all degrees of freedom in dolfinx's numbering, (N, 3) on every rank."""
    x, product = mass.createVecs()
    start, stop = mass.getOwnershipRange()
    x.array[:] = fields[np.argsort(dolfinx_number)[start // 3 : stop // 3]].ravel()
    mass.mult(x, product)
    parts = mass.comm.tompi4py().allgather(product.array.reshape(-1, 3))
    for vector in (x, product):
        vector.destroy()
    return np.concatenate(parts)[dolfinx_number]


def assemble_frame(
    scene: Scene,
    nodes: Nodes,
    unknowns: Unknowns,
    whole: Unknowns,
    moduli: np.ndarray,
    masses: tuple[np.ndarray, ...],
    shared: Mapping[str, np.ndarray],
    algebra: Algebra,
) -> FullOrderFrame:
    """The frame of a scene's body.

    Args:
        unknowns: that supports leave.
        whole: all of the nodes that move, or that others follow.
        moduli: λ and μ of each cell, (C, 2), Pa.
        masses: of all nodes m times 1 (N,), and times their distance from the origin (N, 3); and that origin (3,).
        shared: columns (3 N, any) of actuators and loads, in the units of the inputs.
    """
    translated, mass_times_arms, origin = masses
    arms = nodes.coordinates - origin
    fields = np.concatenate([np.ones((len(arms), 1)), arms], axis=1)
    products = np.concatenate([translated[:, None], mass_times_arms], axis=1)
    moving, shares = whole.free[::3] // 3, whole.node_shares
    rows = algebra.rows()
    of_here = slice(rows.start // 3, rows.stop // 3)
    here = moving[of_here]
    held = np.setdiff1d(np.arange(len(arms)), whole.moving // 3)
    assert shares is not None
    return FullOrderFrame(
        carried=bool(scene.clamped or scene.held),
        origin=origin,
        arms=arms[here],
        mass_times=np.ascontiguousarray((shares.T @ products)[of_here]),
        moments=fields.T @ products,
        output_points=_output_points(scene, nodes),
        held_arms=arms[held],
        held_forces=_forces_on(held, scene, nodes, unknowns, shared),
        geometric_stiffness=_GeometricStiffness(scene, nodes, moving, here, moduli, algebra),
    )


def _forces_on(
    held: np.ndarray, scene: Scene, nodes: Nodes, unknowns: Unknowns, shared: Mapping[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Of the inputs of each contact mode on nodes that a base holds, (H, 3, p): the base bears them, nothing else."""
    components, found = components_of(held), {}
    for name in scene.contacts:
        parts = contact_columns(scene, nodes, unknowns, name), *shared.values()
        columns = np.hstack([part[components] for part in parts])
        found[name] = columns.reshape(len(held), 3, columns.shape[1])
    return found


def _output_points(scene: Scene, nodes: Nodes) -> dict[str, np.ndarray]:
    """Where outputs are at rest, (points, 3) each, m."""
    count = nodes.coordinates.size
    whole, found = Unknowns(count, np.arange(count)), {}
    for name, output in scene.outputs.items():
        if output.markers is not None:
            found[name] = np.array(output.markers)
        else:
            C = output_rows(nodes, output, whole, f"outputs.{name}")
            found[name] = (C.T @ nodes.coordinates.ravel()).reshape(-1, 3)
    return found


def centrifugal_stiffness(system: System) -> list[Operator]:
    """The six matrices by which turning stiffens a body, N s²/m; none where its stress is not known."""
    frame, algebra, R = system.moving_frame, system.algebra, system.rigid
    assert frame is not None
    if frame.geometric_stiffness is None:
        return []
    loads = frame.restrict(frame.centrifugal_loads())
    loads = loads - system.mass @ (R @ algebra.inner(R, loads))  # with the inertia relief of a free body
    with closing(algebra.factor((1.0, system.stiffness), fixed_dofs=choose_fixed_dofs(R, algebra))) as factor:
        responses = frame.expand(factor.solve(loads * free_rows(algebra, choose_fixed_dofs(R, algebra))))
    return [frame.geometric_stiffness(responses[:, [n]]) for n in range(6)]


class _GeometricStiffness:
    """K_g[σ(u)] of a displacement u: ∫ ∇δ σ : ∇v, by the quadrature of large deformation; every rank does all of it."""

    def __init__(
        self, scene: Scene, nodes: Nodes, moving: np.ndarray, here: np.ndarray, moduli: np.ndarray, algebra: Algebra
    ):
        self._nodes, self._scene = nodes, scene
        self._moving, self._here, self._moduli, self._algebra = moving, here, moduli, algebra

    def __call__(self, u: np.ndarray) -> NodeMatrix:
        """See FullOrderFrame."""
        points = self._points
        field = np.zeros((len(self._nodes.coordinates), 3))
        field[self._moving] = self._algebra.gather(u).reshape(-1, 3)
        tension = points.weights * self._material.linear_stress(small_strain(points.gradients(field)))
        gradient = points.gradient_matrix[:, self._moving]
        rows = points.gradient_matrix[:, self._here].T.tocsr()
        blocks = [[scipy.sparse.diags(tension[c]) for c in row] for row in VOIGT_INDEX]
        return NodeMatrix((rows @ scipy.sparse.bmat(blocks, format="csr") @ gradient).tocsr(), self._algebra)

    @cached_property
    def _points(self) -> QuadraturePoints:
        return quadrature_points(self._scene, self._nodes, MPI.COMM_SELF)

    @cached_property
    def _material(self) -> PointMaterial:
        return point_material(self._scene, self._nodes, self._points, self._moduli)
