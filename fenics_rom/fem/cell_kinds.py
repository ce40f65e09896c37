"""The kinds of cells: corners, edges and faces as basix numbers them, their shape functions and quadrature.

A quadrilateral face is two triangles that meet along the diagonal at the least of its vertices, for both of its cells.
At degree 2 the node in its middle is on this diagonal, so that surfaces are triangles of three or six nodes, of
hexahedra, too. A middle node belongs to two vertices: the ends of its edge, of the diagonal of its face, or of the
diagonal of its cell from the least vertex.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import basix
import numpy as np
from numpy import ndarray as Array


@dataclass(frozen=True, eq=False)
class CellKind:
    """One kind of cells.

    Attributes:
        name: of it, and of basix' cell type.
        corners: (V, 3) in the reference cell.
        edges: (E, 2) corners.
        faces: (K, 3) or (K, 4) corners around each, outward.
        from_vtk: (V,) which corner of VTK, Gmsh and Abaqus each is.
        mirror: (V,) order of the corners of a cell that is turned inside out.
        rules: degrees of polynomials that quadrature is exact for, of displacements of degree 1 and 2: of stiffness, of
            mass, and of changes of volume alone, if these are integrated selectively.
    """

    name: str
    corners: Array
    edges: Array
    faces: Array
    from_vtk: Array
    mirror: Array
    rules: tuple[tuple[int, int, int], tuple[int, int, int]]

    def __reduce__(self) -> tuple[Callable[[str], "CellKind"], tuple[str]]:
        """There is one of each on every rank."""
        return kind_named, (self.name,)

    @property
    def facet(self) -> str:
        """Name of the cell type of its faces."""
        return "triangle" if self.faces.shape[1] == 3 else "quadrilateral"

    def middles(self, cells: Array) -> Array:
        """The two vertices (C, M, 2), ascending, that each middle node of cells (C, V) belongs to, in basix' order."""
        pairs = [cells[:, self.edges]]
        if self.facet == "quadrilateral":
            around = from_least(cells[:, self.faces])
            least = cells.argmin(axis=1)
            opposite = np.take_along_axis(cells, (len(self.corners) - 1 - least)[:, None], axis=1)[:, 0]
            pairs += [around[..., [0, 2]], np.stack([cells.min(axis=1), opposite], axis=1)[:, None]]
        return np.sort(np.concatenate(pairs, axis=1), axis=2)

    @property
    def middle_corners(self) -> Array:
        """(M, 3) where the middles are in the reference cell."""
        places: Array = _element(self.name, 2).points[len(self.corners) :]
        return places

    @property
    def serendipity(self) -> Array:
        """What the middles of faces and of the cell (M - E, E) move by, as those of edges do.

        Of a face half the sum of its four edges' moves, of a cell a quarter of that of all twelve.
        """
        of_faces = np.array([np.isin(self.edges, face).all(axis=1) for face in self.faces]) / 2
        return np.vstack([of_faces, np.full(len(self.edges), 1 / 4)])

    def triangles(self, cells: Array) -> tuple[Array, Array]:
        """The faces of cells (C, V) as outward triangles (H, C K, 3), H of each face, and the cells (C K,) they are of.

        Of a face of four vertices the first half has those that come first around it.
        """
        around = cells[:, self.faces].reshape(-1, self.faces.shape[1])
        return halves(around), np.repeat(np.arange(len(cells)), len(self.faces))

    def tetrahedra(self, cells: Array) -> Array:
        """Tetrahedra (S C, 4) that cells (C, V) are divided into, those of a cell one after the other.

        Those of neighbours share the triangles of their common face. See `tetrahedra_from_least`.
        """
        return tetrahedra_from_least(cells, self.faces)[0] if self.facet == "quadrilateral" else cells

    def shapes(self, degree: int, ξ: Array) -> tuple[Array, Array]:
        """Shape functions (P, A) and their gradients (P, A, 3) at places (P, 3) of the reference cell."""
        element = _element(self.name, degree)
        if not len(ξ):  # which ends basix
            return np.empty((0, element.dim)), np.empty((0, element.dim, 3))
        table = element.tabulate(1, np.ascontiguousarray(ξ, dtype=float).reshape(-1, 3))[..., 0]
        return table[0], table[1:].transpose(1, 2, 0)

    def rule(self, degree: int) -> tuple[int, int, int]:
        """Quadrature degrees of stiffness, of mass, and of changes of volume, for displacements of a degree."""
        return self.rules[degree - 1]


def kind_named(name: str) -> CellKind:
    """The kind of that name."""
    return KINDS[name]


def from_least(around: Array) -> Array:
    """Vertices around faces (..., k), from the least one on, in the same sense."""
    count = around.shape[-1]
    order = (around.argmin(axis=-1)[..., None] + np.arange(count)) % count
    return np.take_along_axis(around, order, axis=-1)


def halves(around: Array) -> Array:
    """Triangles (H, F, 3) of faces (F, 3), which they are, or (F, 4), of which each is two."""
    if around.shape[1] == 3:
        return around[None]
    first = from_least(around)
    return np.stack([first[:, [0, 1, 2]], first[:, [2, 3, 0]]])  # as `nodal_contact.facets_of` knows them


def tetrahedra_from_least(cells: Array, faces: Sequence[Array] | Array) -> tuple[Array, Array]:
    """Tetrahedra (T, 4) between the least vertex of cells (C, V) and the halves of the faces that do not have it.

    Those of a cell come one after the other, positive where corners around faces are outward; and the cells (T,) of
    each.
    """
    least, parts, of = cells.argmin(axis=1), [cells[:0, :4]], [np.empty(0, int)]
    for corner in range(cells.shape[1]):
        rows = np.flatnonzero(least == corner)
        for face in faces:
            if corner not in face:
                for half in halves(cells[rows][:, face]):
                    parts.append(np.column_stack([half[:, [0, 2, 1]], cells[rows, corner]]))
                    of.append(rows)
    origin = np.concatenate(of)
    order = np.argsort(origin, kind="stable")
    return np.concatenate(parts)[order], origin[order]


@cache
def _element(cell: str, degree: int):  # type: ignore[no-untyped-def]  # basix has no types
    shape = getattr(basix.CellType, cell)
    return basix.create_element(basix.ElementFamily.P, shape, degree, basix.LagrangeVariant.equispaced)


@cache
def _rule(cell: str, degree: int) -> tuple[Array, Array]:
    points, weights = basix.make_quadrature(getattr(basix.CellType, cell), degree)
    return points, weights


def points_of_rule(cell: str, quadrature_degree: int) -> Array:
    """(Q, d) in the reference cell."""
    return _rule(cell, quadrature_degree)[0]


def tabulate(cell: str, degree: int, quadrature_degree: int) -> tuple[Array, Array, Array]:
    """Shape functions of a reference cell at the points of a rule that is exact for a degree.

    Args:
        cell: of basix' cell types; a triangle has its mid-side nodes opposite to vertex 0, 1, 2.
        degree: of the Lagrange element.
        quadrature_degree: of polynomials that the rule integrates exactly (Xiao & Gimbutas, 2010; Gauss).

    Returns:
        Values (Q, A), gradients (Q, A, d), and weights (Q,) whose sum is the volume of the reference cell.
    """
    points, weights = _rule(cell, quadrature_degree)
    table = _element(cell, degree).tabulate(1, points)[..., 0]
    return table[0], table[1:].transpose(1, 2, 0), weights


TETRAHEDRON = CellKind(
    "tetrahedron",
    np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], dtype=float),
    np.array([(2, 3), (1, 3), (1, 2), (0, 3), (0, 2), (0, 1)]),
    np.array([(1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1)]),  # face f is opposite to vertex f
    np.arange(4),
    np.array([1, 0, 2, 3]),
    ((0, 2, 1), (2, 4, 1)),
)
HEXAHEDRON = CellKind(
    "hexahedron",
    np.array([(i, j, k) for k in range(2) for j in range(2) for i in range(2)], dtype=float),
    np.array([(0, 1), (0, 2), (0, 4), (1, 3), (1, 5), (2, 3), (2, 6), (3, 7), (4, 5), (4, 6), (5, 7), (6, 7)]),
    np.array([(0, 2, 3, 1), (0, 1, 5, 4), (0, 4, 6, 2), (1, 3, 7, 5), (2, 6, 7, 3), (4, 5, 7, 6)]),
    np.array([0, 1, 3, 2, 4, 5, 7, 6]),
    np.array([4, 5, 6, 7, 0, 1, 2, 3]),
    ((3, 5, 1), (5, 7, 3)),  # 2, 3 and 1 points of Gauss along each axis, and 3, 4 and 2
)
CURVED_TETRAHEDRA = 4, 7, 1  # in place of the second rule: the Jacobian's determinant has degree 3
KINDS = {kind.name: kind for kind in (TETRAHEDRON, HEXAHEDRON)}
