"""What a scene reads by name beside displacements, at full order: where, and by which operators.

All of it follows from the mesh, so every rank has the whole.
"""

from collections.abc import Callable, Mapping

import numpy as np
import scipy.sparse
from numpy import ndarray as Array

from fenics_rom.fem.cell_kinds import TETRAHEDRON, CellKind, points_of_rule
from fenics_rom.fem.cell_points import (
    cell_at,
    cell_volumes,
    dilation_points,
    gradients_at,
    quadrature_rule,
    strain_points,
)
from fenics_rom.fem.closed_chambers import enclosed_volume
from fenics_rom.fem.facets import contact_facets
from fenics_rom.fem.fibres import fibres_at
from fenics_rom.fem.full_order_body import FullOrderBody
from fenics_rom.fem.nodes import Nodes, facets_and_cells
from fenics_rom.fem.outputs import marker_reading
from fenics_rom.fem.places import patch_triangles
from fenics_rom.fem.taxels import touch_reading
from fenics_rom.fem.temperature import thermal_strains
from fenics_rom.mechanics.reactions import REACTION
from fenics_rom.mechanics.readable_body import LastStep, ReadableBody
from fenics_rom.mechanics.readings import (
    ContactPressure,
    Reading,
    StressReading,
    StrokeReading,
    SurfaceReading,
    swept_volume,
)
from fenics_rom.mechanics.rubbing import rubbing_of
from fenics_rom.mechanics.tendon import cable_length
from fenics_rom.scene.outputs import OutputEntry
from fenics_rom.scene.scene import ReadingEntry, Scene
from fenics_rom.system.body import Unknowns
from fenics_rom.system.system import System

ROUND_OFF = 1e-9  # of sizes and directions
GAUSS_OF_STRESS = 3  # degree of the rule of 2 x 2 x 2 points
WHOLE = np.full((1, 3), 1 / 3)
# Middles of the four parts that a triangle with six nodes is drawn in, in the order of `Nodes.drawn_triangles`.
PARTS = np.vstack([np.full((3, 3), 1 / 6) + np.eye(3) / 2, WHOLE])


def readings_of(scene: Scene, nodes: Nodes, material: Array, unknowns: Unknowns) -> dict[str, Reading]:
    """The readings of a scene but for reactions (`reactions.py`), with operators on the unknowns.

    Args:
        scene: what is read.
        nodes: of its mesh.
        material: λ, μ (Pa) and ρ of every cell, (C, 3).
        unknowns: what supports leave.

    Raises:
        MeshError, SceneError: a place that does not exist, or a surface that encloses no volume.
    """
    read = {name: entry for name, entry in scene.readings.items() if entry.quantity != REACTION}
    return {name: _reading(entry, scene, nodes, material, unknowns, name) for name, entry in read.items()}


def _reading(
    entry: "ReadingEntry | OutputEntry", scene: Scene, nodes: Nodes, material: Array, unknowns: Unknowns, name: str
) -> Reading:
    if isinstance(entry, OutputEntry):
        return touch_reading(entry, scene, nodes, unknowns, f"outputs.{name}")
    of, where = entry.of or "", f"readings.{name}"
    if entry.quantity == "length":
        return StrokeReading("length", of, cable_length(np.array(scene.effects.tendon[of].points)))
    if entry.quantity == "volume":
        triangles = patch_triangles(nodes, scene.effects.pressure[of], f"effects.pressure.{of}")
        return StrokeReading("volume", of, enclosed_volume(nodes, triangles, unknowns, where))
    if entry.quantity == "contact_pressure":
        triangles = patch_triangles(nodes, scene.contacts[of], f"contacts.{of}")
        carriers, areas = contact_facets(nodes, triangles)
        touched, facets = np.unique(carriers, return_inverse=True)
        return ContactPressure(of, touched, facets.reshape(carriers.shape), areas)
    if entry.point is not None:
        return marker_reading(nodes, np.array(entry.point), unknowns, f"{where}.point")
    if entry.points is not None:
        return _point_stresses(nodes, np.array(entry.points), material, scene, unknowns, f"{where}.points")
    place = entry.place
    facets = nodes.surface if place is None else patch_triangles(nodes, place, where)
    samples, operator, cells = surface_gradients(nodes, facets)
    (λ, μ, _), there = material[cells].T, nodes.coordinates[nodes.drawn_triangles()[samples]].mean(axis=1)
    beside = fibres_at(scene, nodes.mesh, cells, there), thermal_strains(scene, nodes.mesh, cells, there)
    return SurfaceReading(entry.quantity, of, samples, (operator @ unknowns.matrix).tocsr(), λ, μ, *beside)


def surface_gradients(nodes: Nodes, facets: Array) -> tuple[Array, scipy.sparse.csr_matrix, Array]:
    """∇u in the middle of surface triangles as they are drawn, in the cell that adjoins each.

    Args:
        nodes: all nodes.
        facets: (F, 3) of `nodes.surface`.

    Returns:
        Which of the drawn triangles, (P,); the operator from displacements of all nodes (3 N,) to H (3, 3, P), as
        (9 P, 3 N), 1/m; and the cells (P,).
    """
    row, cell = facets_and_cells(nodes, facets)
    parts = PARTS if len(nodes.edges) else WHOLE
    corner = nodes.surface[row][:, :, None] == nodes.cells[cell][:, None, :]
    ξ = np.einsum("pk,fkv,vi->pfi", parts, corner, nodes.kind.corners).reshape(-1, 3)
    triangles = (np.arange(len(parts))[:, None] * len(nodes.surface) + row).ravel()
    cell = np.tile(cell, len(parts))
    return triangles, _gradient_operator(nodes, cell, gradients_at(nodes, cell, ξ)), cell


def _gradient_operator(nodes: Nodes, cells: Array, gradients: Array) -> scipy.sparse.csr_matrix:
    """From displacements of all nodes (3 N,) to H (3, 3, P), 1/m, by ∂N_a/∂X_j (P, A, 3) in cells (P,)."""
    P, A = gradients.shape[:2]
    i, j, p, a = np.meshgrid(range(3), range(3), range(P), range(A), indexing="ij")
    rows, columns = (3 * i + j) * P + p, 3 * nodes.cell_nodes[cells][p, a] + i
    entries = gradients[p, a, j].ravel(), (rows.ravel(), columns.ravel())
    return scipy.sparse.coo_matrix(entries, shape=(9 * P, 3 * len(nodes.coordinates))).tocsr()


def _point_stresses(
    nodes: Nodes, points: Array, material: Array, scene: Scene, unknowns: Unknowns, where: str
) -> StressReading:
    """Stress at points (G, 3), from the cells around the corners of theirs.

    Those of hexahedra are extrapolated from 2 x 2 x 2 points of Gauss, where they are best (Barlow, 1976). With
    selective integration a cell has its change of volume, and so λ, where this is integrated.

    Raises:
        SceneError: a point is outside the body.
    """
    volumes = cell_volumes(nodes)
    corners, cells, at, shares = [], [], [], []
    for k, point in enumerate(points):
        home, ξ = cell_at(nodes, point, where)
        λ = nodes.kind.shapes(1, ξ)[0][0]  # of the corners
        λ = np.where(λ > ROUND_OFF, λ, 0.0)
        for vertex, weight in zip(nodes.cells[home][λ > 0], (λ / λ.sum())[λ > 0], strict=True):
            is_there = nodes.cells == vertex
            around = np.flatnonzero(is_there.any(axis=1) & (material[:, :2] == material[home, :2]).all(axis=1))
            corners.append((k, weight))
            cells.append(around)
            at.append(is_there[around].argmax(axis=1))
            shares.append(volumes[around] / volumes[around].sum())
    of_point, weights = zip(*corners, strict=True)
    places, from_places = _sampled_in(nodes.kind, np.concatenate(at))
    cell = np.repeat(np.concatenate(cells), places.shape[1])
    places = places.reshape(-1, 3)
    λ, μ, _ = material[cell].T
    gradients = gradients_at(nodes, cell, places)
    shapes, _ = nodes.kind.shapes(nodes.degree, places)
    there = np.einsum("pa,pai->pi", shapes, nodes.coordinates[nodes.cell_nodes[cell]])
    fibres, expansions = fibres_at(scene, nodes.mesh, cell, there), thermal_strains(scene, nodes.mesh, cell, there)
    if scene.integration == "selective":
        none, of_dilation = np.zeros(len(cell)), points_of_rule(nodes.kind.name, quadrature_rule(nodes)[2])
        nearest = np.linalg.norm(places[:, None] - of_dilation, axis=2).argmin(axis=1)
        dilations, _ = dilation_points(nodes, *strain_points(nodes, cell))
        gradients = np.concatenate([gradients, dilations[np.arange(len(cell)), nearest]])
        cell, λ, μ = np.tile(cell, 2), np.concatenate([none, λ]), np.concatenate([μ, none])
    operator = (_gradient_operator(nodes, cell, gradients) @ unknowns.matrix).tocsr()
    of_corner = np.repeat(np.arange(len(cells)), [len(around) for around in cells])
    of_values = of_corner, np.concatenate(shares), from_places
    return StressReading(points, np.array(of_point), np.array(weights), *of_values, operator, λ, μ, fibres, expansions)


def _sampled_in(kind: CellKind, corner: Array) -> tuple[Array, Array]:
    """Places (T, R, 3) in the reference cell from which stresses at corners (T,) of it come, and weights (T, R)."""
    if kind is TETRAHEDRON:
        return kind.corners[corner][:, None], np.ones((len(corner), 1))
    points = points_of_rule(kind.name, GAUSS_OF_STRESS)
    of_corners = np.linalg.inv(kind.shapes(1, points)[0])
    return np.tile(points, (len(corner), 1, 1)), of_corners[corner]


def readable(
    system: System,
    body: FullOrderBody,
    touched: Array,
    last: Callable[[], LastStep | None] = lambda: None,
    amplitudes: Callable[[], Mapping[str, float]] | None = None,
) -> ReadableBody:
    """A body at full order, as readings ask for it, by its unknowns (n,); every rank must make every call.

    Args:
        system: the full-order model.
        body: its state.
        touched: velocities (P, 3) of the contact points in the middle of the last step, m/s.
        last: that step, by all unknowns.
        amplitudes: of temperatures now, by name; None: there are none.
    """
    deformation, algebra, interface = system.deformation, system.algebra, body.interface

    def coordinates() -> Array:
        return algebra.gather(body.x)[:, 0]

    def stroke(actuator: str) -> float:
        if deformation is None:
            return float(algebra.inner(system.unit_forces(actuator), body.x)[0, 0])
        if actuator in deformation.tendons:
            points, shapes = deformation.tendons[actuator]
            return cable_length(points) - cable_length(points + algebra.inner(shapes, body.x).reshape(-1, 3))
        return swept_volume(
            lambda x: algebra.gather(deformation.follower(x[algebra.rows()])[actuator])[:, 0], coordinates()
        )

    law, contact = None if deformation is None else deformation.law, body.contact
    if interface is None or contact is None:
        points = None if interface is None else interface.points
        return ReadableBody(law, coordinates, stroke, points, last=last(), amplitudes=amplitudes)
    return ReadableBody(
        law,
        coordinates,
        stroke,
        interface.points,
        contact.normal_forces,
        contact.forces,
        lambda: rubbing_of(contact, touched, interface.solver.law.friction),
        lambda: system.body.nodes + body.displacement(),
        last(),
        amplitudes,
    )
