"""Bars of quadratic cells, and the rows of a table of published numbers."""

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "hard_cases"))
from boxes import brick_cells, hexahedra, msh, outer_triangles

import fenics_rom as fr
from fenics_rom.mechanics.step import StepInput
from fenics_rom.scene.file import parse_scene

Array = np.ndarray
LARGE = "large_deformation = {}\n"
MIDDLE = '\n[[supports.held]]\nsurface = "bottom"\nnormal = [0.0, 0.0, 1.0]'  # of a plate, thin in z
PLANE_STRAIN = MIDDLE + MIDDLE.replace("bottom", "top")


class Row(NamedTuple):
    """A number that is published, and what became of it."""

    case: str
    mesh: str
    what: str
    published: float  # or of a closed form
    found: float
    allowed: float  # relative
    iterations: int | None = None


def bar(bricks: tuple[int, int, int], place: Callable[[Array], Array], young: float, poisson: float, density: float,
        effects: str = LARGE, supports: str = "", clamped: str = '"left"',
        integration: str = "full", tables: str = "", run: str = "", nodes: int = 4, degree: int = 2,
        expansion: str = ""
) -> fr.System:  # fmt: skip
    """A bar of tetrahedra, six in a brick, or hexahedra: bricks of a unit cube that are put in place.

    Args:
        bricks: in each direction.
        place: of points (N, 3) of the unit cube, also of nodes on edges, so that these bend.
        young, poisson, density: Pa, 1, kg/m3.
        effects, supports, clamped, integration: of the scene; what is clamped is where x was 0.
        tables: further ones of the scene: what else is read.
        run: its table.
        nodes: 4 of a tetrahedron, 8, 20 or 27 of a hexahedron.
        degree: of displacements.
        expansion: 1/K, as a text; empty: none.
    """
    if nodes == 4:
        points, cells = brick_cells(bricks)
        outer = outer_triangles(cells)
        faces = {"left": (0, 0.0), "right": (0, 1.0), "bottom": (2, 0.0), "top": (2, 1.0), "front": (1, 0.0),
                 "back": (1, 1.0)}  # fmt: skip
        surfaces = {name: outer[(points[outer, axis] == end).all(axis=1)] for name, (axis, end) in faces.items()}
    else:
        points, cells, surfaces = hexahedra(bricks, nodes)
    with tempfile.TemporaryDirectory() as folder:
        mesh = Path(folder) / "bar.msh"
        mesh.write_text(msh(place(points), {2: surfaces, 3: {"body": cells}}))
        text = f"""
[mesh]
file = "{mesh}"
degree = {degree}
integration = "{integration}"
[material]
young = {young!r}
poisson = {poisson!r}
density = {density!r}
{f"expansion = {expansion}" if expansion else ""}
[supports]
clamped = [{clamped}]{supports}
[contacts.tip]
surface = "right"
force = "resultant"
[outputs.tip]
surface = "right"
{f"[run]{chr(10)}{run}" if run else ""}
{tables}
[effects]
{effects}"""
        return fr.assemble(parse_scene(text))


def mesh_of(system: fr.System, bricks: tuple[int, int, int]) -> str:
    """For the table."""
    return f"{' x '.join(map(str, bricks))} bricks, {system.size:,} unknowns"


def tip_under(system: fr.System, *load: float) -> tuple[Array, int]:
    """Where the middle of the tip comes to, m, under a load in one increment, and iterations."""
    body = system.deformation.stepper(1.0)
    body.equilibrium(StepInput(np.array(load)))
    tip, iterations = body.displacement("tip").mean(axis=0), body.newton
    assert body.finest == 1.0
    assert body.negative_pivots == 0
    body.close()
    return tip, iterations
