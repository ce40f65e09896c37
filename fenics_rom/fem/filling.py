"""A surface, or a STEP body, filled with tetrahedra by Gmsh, or by fTetWild where it is open or intersects itself."""

from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import MeshError, SceneError
from fenics_rom.fem.mesh import SURFACES, Mesh, checked_mesh, oriented
from fenics_rom.fem.mesh_arrays import MeshArrays
from fenics_rom.fem.mesh_quality import faces_of, signed_volumes
from fenics_rom.fem.msh_writer import write_msh
from fenics_rom.io.progress import Report, silent
from fenics_rom.mechanics.box_tree import BoxTree
from fenics_rom.mechanics.skin import solid_angle
from fenics_rom.mechanics.surface_checks import crossings
from fenics_rom.mechanics.triangle_surface import TriangleSurface
from fenics_rom.mechanics.triangles import nearest_on_triangles
from fenics_rom.scene import surface_filling
from fenics_rom.scene.foreign_file import arrays_of
from fenics_rom.scene.surface_file import read_surface
from fenics_rom.scene.surface_filling import FTETWILD, GMSH, Extent, envelope

REGION = "body"  # name of all cells in the file
TIMEOUT = 3600.0  # s that filling a body may take
LOOKED_AT = 2000  # triangles of a surface that are looked for in the body
CRUMB = 0.01  # of the largest part's volume, below which parts that touch nothing are left out
LONG = 3.0  # m: a body is rarely longer, and a file often has mm


def fill_surface(
    file: Path, output: Path, size: float | None = None, scale: float = 1.0, glue: bool = False, report: Report = silent
) -> Mesh:
    """Fills a surface, writes a `.msh` file and returns the mesh, in m; its notes say what fTetWild had to do.

    Args:
        file: `.stl`, or `.step` or `.stp`, which say their unit.
        output: `.msh` file, of coordinates in m.
        size: length of the cells' edges, m; None: that of some 20,000 cells.
        scale: metres that a unit of an `.stl` file is worth.
        glue: let solids of a `.step` file that touch share their nodes there; what two have in common is filled once.
        report: is told how far it is.

    Raises:
        MeshError: it cannot be read or filled; there would be more than 5 million cells, or one larger than the body.
        FileError: the output cannot be written.
    """
    if file.suffix.lower() not in SURFACES:
        raise MeshError(f"mesh file {file}: use a file that ends in {', '.join(SURFACES)}")
    try:
        is_there = file.is_file()
    except OSError as error:  # as of a name that is too long
        raise MeshError(f"mesh file {file}: cannot be read: {error.strerror}") from error
    if not is_there:
        raise MeshError(f"mesh file {file}: not found")
    if file.suffix.lower() == ".stl":
        mesh = _filled_triangles(file, size, scale, report)
    elif scale != 1.0:
        raise MeshError(f"mesh file {file}: says its unit; a scale is for .stl")
    else:
        mesh = _mesh(file, *_filled(GMSH, file, size or 0.0, 0.0, 1.0, report, *["glue"] * glue))
    longest = float(np.ptp(mesh.points[mesh.cells].reshape(-1, 3), axis=0).max())
    if scale == 1.0 and longest > LONG:
        note = f"the body is {longest:.3g} m long; if the file has mm, use a scale of 1e-3"
        mesh = replace(mesh, notes=(note, *mesh.notes))
    write_msh(output, mesh)
    return mesh


def _filled(
    program: str, file: Path, size: float, cells: float, scale: float, report: Report, *words: str
) -> tuple[Array, Array]:
    """Points (N, 3), m, and cells (C, 4) that a program fills a file with; arguments as of `surface_filling`, in m."""

    def listen(said: bytes) -> None:
        if (progress := surface_filling.progress_of(said, cells or surface_filling.USUAL_CELLS)) is not None:
            stage, done, of = progress
            report(f"{program}: {stage}", done, of)

    arrays = arrays_of(
        surface_filling.__file__,
        file,
        *(program, str(size / scale), str(cells), *words),
        program=program,
        does="fill",
        timeout=TIMEOUT,
        listen=listen,
    )
    if not arrays["cells"].size:
        raise MeshError(f"mesh file {file}: {program} found nothing inside of its surface")
    return scale * arrays["points"].reshape(-1, 3), arrays["cells"].reshape(-1, 4)


def _mesh(file: Path, points: Array, cells: Array, notes: tuple[str, ...] = ()) -> Mesh:
    return checked_mesh(MeshArrays(points, cells, {}, {REGION: np.arange(len(cells))}, notes=notes), file)


def _filled_triangles(file: Path, size: float | None, scale: float, report: Report) -> Mesh:
    """What Gmsh or, where that cannot, fTetWild makes of an STL file."""
    try:
        vertices, triangles = read_surface(file).joined(scale)
    except SceneError as error:
        raise MeshError(f"mesh file {error}") from error
    triangles = triangles[(triangles != np.roll(triangles, 1, axis=1)).all(axis=1)]  # those that are more than an edge
    if not len(triangles) or not np.isfinite(vertices).all():
        raise MeshError(f"mesh file {file}: use triangles with three corners, of finite numbers")
    extent = _extent(vertices, triangles)
    try:
        size = extent.checked(size)
    except ValueError as error:
        raise MeshError(f"mesh file {file}: {error}") from None
    arguments = file, size, extent.cells(size), scale, report
    reason = _reason_against_gmsh(vertices, triangles)
    if not reason:
        try:
            points, cells = _filled(GMSH, *arguments)
            return _mesh(file, *_without_crumbs(points, cells))
        except MeshError as error:
            reason = str(error).removeprefix(f"mesh file {file}: ")
    if find_spec("pytetwild") is None:
        raise MeshError(f'mesh file {file}: {reason}; {FTETWILD} fills such files: pip install "fenics-rom[surfaces]"')
    points, cells = _filled(FTETWILD, *arguments)
    try:
        moved = _check_filled(vertices, triangles, points, cells, 2 * envelope(vertices, size))
    except ValueError as error:
        raise MeshError(f"mesh file {file}: {reason}; {error}") from None
    note = f"{reason}: {FTETWILD} filled it; its surface is up to {moved:.3g} m from the file's, farthest in holes"
    mesh = _mesh(file, *_without_crumbs(points, cells))
    return replace(mesh, notes=(note, *mesh.notes))


def _without_crumbs(points: Array, cells: Array) -> tuple[Array, Array, tuple[str, ...]]:
    """Points, and the cells (C, 4) of the parts of a body that are no crumbs, with what to say of its parts."""
    count, part = faces_of(points, cells).parts()
    volumes = np.bincount(part, weights=np.abs(signed_volumes(points, cells)))
    is_crumb = volumes < CRUMB * volumes.max()
    notes, count = [], count - int(is_crumb.sum())
    if is_crumb.any():
        left = points[cells[is_crumb[part]]].reshape(-1, 3)
        crumbs = int(is_crumb.sum())
        notes.append(
            f"left out: {crumbs} small part{'s' * (crumbs > 1)} that nothing joins to the rest, "
            f"{volumes[is_crumb].sum():.3g} of {volumes.sum():.3g} m³, between {_place(left.min(axis=0))} and "
            f"{_place(left.max(axis=0))} m"
        )
    if count > 1:
        notes.append(f"the body is {count} parts that are not joined; supports must hold each of them")
    used, cells = np.unique(cells[~is_crumb[part]], return_inverse=True)
    return points[used], cells.reshape(-1, 4), tuple(notes)


def _extent(vertices: Array, triangles: Array) -> Extent:
    """Of a surface; the volume is that of its box where it is open, or its triangles are not turned alike."""
    corners, sides = vertices[triangles], np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2).reshape(-1, 2)
    _, count = np.unique(sides, axis=0, return_counts=True)
    lengths = np.ptp(vertices[triangles].reshape(-1, 3), axis=0)
    a, b, c = (corners - corners.mean(axis=(0, 1))).transpose(1, 0, 2)
    volume = abs(float((a * np.cross(b, c)).sum())) / 6
    if (count > 1).any() or len(_loose_edges(triangles)[0]):
        volume = float(lengths.prod())
    area = float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()) / 2
    return Extent(volume, area, tuple(lengths.tolist()))


def _loose_edges(triangles: Array) -> tuple[Array, int]:
    """Edges (e, 2) of triangles (T, 3) that are not between two of them, and how many edges there are."""
    sides = np.sort(triangles[:, [[0, 1], [1, 2], [0, 2]]].reshape(-1, 2), axis=1)
    edges, count = np.unique(sides, axis=0, return_counts=True)
    return edges[count != 2], len(edges)


def _reason_against_gmsh(vertices: Array, triangles: Array) -> str:
    """Why Gmsh cannot fill a surface; empty: it may."""
    loose, count = _loose_edges(triangles)
    if len(loose):
        return (
            f"its surface is not closed: {len(loose)} of {count} edges are not between two triangles, e.g. one at "
            f"{_place(vertices[loose[0, 0]])} m"
        )
    a, b, c = vertices[triangles].transpose(1, 0, 2)
    is_flat = not np.cross(b - a, c - a).any(axis=1).all()  # some triangle has no area, so no normal: Gmsh may try
    crossed = None if is_flat else crossings(TriangleSurface(vertices, triangles))
    if crossed is None:
        return ""
    return f"its surface goes through itself at {crossed.places} places, e.g. at {_place(crossed.place)} m"


def _check_filled(vertices: Array, triangles: Array, points: Array, cells: Array, reach: float) -> float:
    """How far the surface of a body is from that of a file at most, m.

    ValueError where some of the file's triangles are outside of the body, farther than a reach, m.
    """
    outside = faces_of(points, oriented(points, cells)).outside
    moved = _distances(points[np.unique(outside)], vertices[triangles])
    few = np.linspace(0, len(triangles) - 1, min(len(triangles), LOOKED_AT)).astype(int)
    middles, faces = vertices[triangles[few]].mean(axis=1), points[outside]
    far = _distances(middles, faces)
    lost = [k for k in np.flatnonzero(far > reach) if solid_angle(faces - middles[k]) < 2 * np.pi]
    if lost:
        worst = lost[int(far[lost].argmax())]
        raise ValueError(
            f"{FTETWILD} left out {len(lost) / len(few):.2g} of its triangles, by up to {far[worst]:.3g} m at "
            f"{_place(middles[worst])} m; use parts whose triangles are turned outward"
        )
    return float(moved.max())


def _distances(points: Array, corners: Array) -> Array:
    """From points (P, 3) to the nearest of triangles (T, 3, 3), m."""
    feet = nearest_on_triangles(points, corners[BoxTree(corners).nearest(points)])[1]
    return np.asarray(np.linalg.norm(points - feet, axis=1))


def _place(x: Array) -> list[float]:
    return [float(f"{value:.4g}") for value in x.tolist()]
