"""Bodies and scenes that the tests are made of."""

from itertools import permutations
from pathlib import Path

import gmsh
import numpy as np
import scipy.sparse

import fenics_rom as fr
from fenics_rom.scene.file import parse_scene

PLATE = Path(__file__).parent.parent / "demos" / "plate" / "plate.toml"


def write_box(path: Path, lengths: tuple[float, float, float], cells: tuple[int, int, int]) -> Path:
    """A box of tetrahedra with faces left/right (x), front/back (y), bottom/top (z) and volume "body" named."""
    gmsh.initialize([], readConfigFiles=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("Mesh.MshFileVersion", 4.1)
        geo, (lx, ly, lz), (nx, ny, nz) = gmsh.model.geo, lengths, cells
        corners = [geo.addPoint(x, y, 0) for x, y in ((0, 0), (lx, 0), (lx, ly), (0, ly))]
        lines = [geo.addLine(corners[k], corners[(k + 1) % 4]) for k in range(4)]
        for line, count in zip(lines, (nx, ny, nx, ny), strict=True):
            geo.mesh.setTransfiniteCurve(line, count + 1)
        bottom = geo.addPlaneSurface([geo.addCurveLoop(lines)])
        geo.mesh.setTransfiniteSurface(bottom)
        extruded = geo.extrude([(2, bottom)], 0, 0, lz, numElements=[nz])
        geo.synchronize()
        (_, top), (_, volume), *sides = extruded
        names = ("front", "right", "back", "left")
        faces = {"bottom": bottom, "top": top} | {name: tag for name, (_, tag) in zip(names, sides, strict=True)}
        for name, tag in faces.items():
            gmsh.model.setPhysicalName(2, gmsh.model.addPhysicalGroup(2, [tag]), name)
        gmsh.model.setPhysicalName(3, gmsh.model.addPhysicalGroup(3, [volume]), "body")
        gmsh.model.mesh.generate(3)
        gmsh.write(str(path))
    finally:
        gmsh.finalize()
    return path


def box_arrays(
    lengths: tuple[float, float, float], bricks: tuple[int, int, int], shake: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Points and tetrahedra of a box, six in each brick; inner points are shaken by that share of a brick."""
    count = np.array(bricks)
    grid = np.stack(np.meshgrid(*(np.arange(n + 1) for n in bricks), indexing="ij"), axis=-1).reshape(-1, 3)
    inner = ((grid > 0) & (grid < count)).all(axis=1)
    moved = grid + inner[:, None] * np.random.default_rng(0).uniform(-shake, shake, grid.shape)
    along = np.array([(count[1] + 1) * (count[2] + 1), count[2] + 1, 1])
    first = np.flatnonzero((grid < count).all(axis=1))
    steps = [np.cumsum([0, *along[list(order)]]) for order in permutations(range(3))]
    return moved * np.array(lengths) / count, np.concatenate([first[:, None] + step for step in steps])


def skin_of(cells: np.ndarray) -> np.ndarray:
    """Triangles of tetrahedra that no other has, with ascending corners."""
    every = np.sort(cells[:, [(1, 2, 3), (0, 2, 3), (0, 1, 3), (0, 1, 2)]].reshape(-1, 3), axis=1)
    faces, count = np.unique(every, axis=0, return_counts=True)
    skin: np.ndarray = faces[count == 1]
    return skin


def box_surfaces(points: np.ndarray, cells: np.ndarray) -> dict[str, np.ndarray]:
    """Triangles of the six faces of a box."""
    outer, on = skin_of(cells), {}
    for axis, names in enumerate((("left", "right"), ("front", "back"), ("bottom", "top"))):
        for name, end in zip(names, (points[:, axis].min(), points[:, axis].max()), strict=True):
            on[name] = outer[np.isclose(points[outer, axis], end).all(axis=1)]
    return on


def write_arrays(
    path: Path,
    points: np.ndarray,
    cells: np.ndarray,
    surfaces: dict[str, np.ndarray] | None = None,
    regions: dict[str, np.ndarray] | None = None,
    version: float = 4.1,
    binary: bool = False,
) -> Path:
    """Any mesh as Gmsh's .msh: groups of triangles (those of a box where None) and of cells may overlap."""
    surfaces = box_surfaces(points, cells) if surfaces is None else surfaces
    regions = {"body": np.arange(len(cells))} if regions is None else regions
    triangles, row = np.unique(np.sort(np.concatenate(list(surfaces.values())), axis=1), axis=0, return_inverse=True)
    parts = np.split(row.ravel(), np.cumsum([len(s) for s in surfaces.values()])[:-1])
    gmsh.initialize([], readConfigFiles=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("Mesh.MshFileVersion", version)
        gmsh.option.setNumber("Mesh.Binary", binary)
        rows_of = dict(zip(surfaces, parts, strict=True))
        for dimension, kind, elements, groups in ((3, 4, cells, regions), (2, 2, triangles, rows_of)):
            member = np.array([np.isin(np.arange(len(elements)), rows) for rows in groups.values()]).T
            members, entity = np.unique(member, axis=0, return_inverse=True)  # an entity is what has the same groups
            for tag in range(1, len(members) + 1):
                gmsh.model.addDiscreteEntity(dimension, tag)
                if (dimension, tag) == (3, 1):
                    gmsh.model.mesh.addNodes(3, 1, np.arange(1, len(points) + 1), points.ravel())
                gmsh.model.mesh.addElementsByType(tag, kind, [], elements[entity.ravel() == tag - 1].ravel() + 1)
            for name, inside in zip(groups, members.T, strict=True):
                group = gmsh.model.addPhysicalGroup(dimension, list(np.flatnonzero(inside) + 1))
                gmsh.model.setPhysicalName(dimension, group, name)
        gmsh.write(str(path))
    finally:
        gmsh.finalize()
    return path


def hollow_box(folder: Path) -> Path:
    """A box of 50 x 30 x 30 mm with a chamber of 3 cm³ in its middle, whose walls are the surface "chamber"."""
    lengths, bricks = (0.05, 0.03, 0.03), (5, 3, 3)
    points, cells = box_arrays(lengths, bricks)
    middles = points[cells].mean(axis=1)
    cells = cells[~((middles > 0.01) & (middles < [0.04, 0.02, 0.02])).all(axis=1)]
    used, cells = np.unique(cells, return_inverse=True)
    points, cells = points[used], cells.reshape(-1, 4)
    skin = skin_of(cells)
    inner = ((points[skin].mean(axis=1) > 0.005) & (points[skin].mean(axis=1) < [0.045, 0.025, 0.025])).all(axis=1)
    surfaces = box_surfaces(points, cells) | {"chamber": skin[inner], "part": skin[inner][:-2]}
    return write_arrays(folder / "hollow.msh", points, cells, surfaces)


def scene_text(
    mesh: Path,
    *,
    degree: int = 1,
    integration: str = "full",
    contacts: str | None = None,
    damping: str = "alpha = 1.0, beta = 1e-3",
    **parts: str | None,
) -> str:
    """A scene of a box held on its left; `parts` are further tables by heading, or replace these (None: remove)."""
    tables = {
        "mesh": f'file = "{mesh}"\ndegree = {degree}\nintegration = "{integration}"',
        "material": "young = 1.0e6\npoisson = 0.3\ndensity = 1000.0",
        "supports": 'clamped = ["left"]',
        "effects": f"inertia = {{}}\ndamping = {{ {damping} }}",
    } | parts
    contacts = contacts or '[contacts.right]\nsurface = "right"\n[contacts.top]\nsurface = "top"'
    given = [f"[{heading}]\n{body}" for heading, body in tables.items() if body is not None]
    return "\n".join([*given, contacts])


def assembled(mesh: Path, **choices: str | int | None) -> fr.System:
    """The system of such a scene."""
    return fr.assemble(parse_scene(scene_text(mesh, **choices)))


def acted_on(mesh: Path, effects: str, **choices: str | int | None) -> fr.Scene:
    """Such a scene with other effects; `effects` is the text of their table."""
    return parse_scene(scene_text(mesh, effects=effects, **choices))


def dense(matrix, size: int) -> np.ndarray:
    """All numbers of an operator."""
    return matrix @ np.eye(size)


def sparse(matrix) -> scipy.sparse.csc_matrix:
    """An operator on one rank as a SciPy matrix."""
    start, columns, values = matrix.mat.getValuesCSR()
    return scipy.sparse.csr_matrix((values, columns, start)).tocsc()
