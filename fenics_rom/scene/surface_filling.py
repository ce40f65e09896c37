"""A process of its own that fills a closed surface, or a STEP body, with tetrahedra; and how many there would be.

Gmsh keeps the surface, and takes none that is open or goes through itself. fTetWild (Hu, Schneider, Wang, Zorin &
Panozzo, ACM Trans. Graph. 39, 2020) takes any triangles: what they wind around is inside, and its surface is theirs to
within an `envelope`. It is started by `fem.filling`, as a script, as `foreign_process` is.
"""

import re
import sys
import tempfile
from os import chdir
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fenics_rom.scene import foreign_process
from fenics_rom.scene.surface_file import read_surface

GMSH, FTETWILD = "Gmsh", "fTetWild"
MOST_CELLS = 5_000_000
USUAL_CELLS = 20_000  # where no size is given
SHARE_OF_DIAGONAL, SHARE_OF_SIZE = 1e-3, 0.05  # by which fTetWild may move the surface: the larger of both
MOST_PASSES = 80  # of fTetWild over all cells; it ends earlier where they are good
# Cells of size a in a volume V with a surface A: 6 V/a³ + 2 A/a². Of a box Gmsh makes 4.5 to 6.3 V/a³, fTetWild 9.
PER_CUBE, PER_SQUARE = 6.0, 2.0
BASE_MEMORY = 2**31  # bytes of address space for any body
MEMORY_PER_CELL = {GMSH: 4_000, FTETWILD: 40_000}  # of which they take a fourth
FEATURE_ANGLE = np.radians(40.0)  # between triangles of a surface; beyond it an edge stays an edge


class Extent(NamedTuple):
    """How large a body is, in any unit of length."""

    volume: float
    area: float
    lengths: tuple[float, ...]  # of its box

    def cells(self, size: float) -> float:
        """About how many of a size fill it."""
        return PER_CUBE * self.volume / size**3 + PER_SQUARE * self.area / size**2

    def size_for(self, cells: float) -> float:
        """The size of about so many, rounded up to two digits."""
        low, high = 1e-6 * max(self.lengths), 2 * max(self.lengths)
        for _ in range(60):
            middle = np.sqrt(low * high)
            low, high = (low, middle) if self.cells(middle) < cells else (middle, high)
        digit = 10.0 ** (np.floor(np.log10(high)) - 1)
        return float(f"{np.ceil(high / digit - 1e-9) * digit:.2g}")

    def checked(self, size: float | None) -> float:
        """A size, or the usual one; ValueError where there would be too many cells, or one is larger than the body."""
        if size is None:
            return self.size_for(USUAL_CELLS)
        box = f"{' x '.join(f'{length:.4g}' for length in self.lengths)} m"
        if self.cells(size) > MOST_CELLS:
            raise ValueError(
                f"some {self.cells(size):.2g} cells of {size:g} m would fill the body, {box}; use a size of at least "
                f"{self.size_for(MOST_CELLS):g} m, of {MOST_CELLS:,} cells, or a scale of 1e-3 if the file has mm"
            )
        if size > max(self.lengths):
            raise ValueError(
                f"cells of {size:g} m are larger than the body, {box}; use a smaller size, or a larger scale"
            )
        return size


def main() -> None:
    """Fills the file that the command line names, or ends with a message.

    What follows the file: the program; the size, in the file's unit, of STEP m, 0 of the usual one; about how many
    cells there will be, 0 where it is for this process to tell; and whether to glue.
    """
    file, program, *words = sys.argv[1:]
    size, cells, glue = float(words[0]), float(words[1]), words[2:] == ["glue"]
    size_of_file = Path(file).stat().st_size
    limit = (
        BASE_MEMORY
        + foreign_process.MEMORY_PER_BYTE * size_of_file
        + MEMORY_PER_CELL[program] * int(cells or MOST_CELLS)
    )
    foreign_process.lower_limit("RLIMIT_AS", limit)
    if program == FTETWILD:
        foreign_process.answer(lambda: fill_by_ftetwild(file, size))
    else:
        foreign_process.answer(lambda: fill_by_gmsh(file, size or None, glue))


def fill_by_gmsh(file: str, size: float | None, glue: bool) -> dict[str, Any]:
    """Points (3 N,) and cells (4 C,) of tetrahedra that fill a closed surface, or what a STEP file holds.

    Solids that are to be glued are divided where they meet.
    """
    gmsh = foreign_process.gmsh_package()
    gmsh.option.setNumber("General.Terminal", 1)  # it says how far it is
    gmsh.option.setString("Geometry.OCCTargetUnit", "M")
    mesh = gmsh.model.mesh
    if file.lower().endswith(".stl"):
        gmsh.merge(file)
        mesh.classifySurfaces(FEATURE_ANGLE, True, True, np.pi)
        mesh.createGeometry()
        loop = gmsh.model.geo.addSurfaceLoop([tag for _, tag in gmsh.model.getEntities(2)])
        gmsh.model.geo.addVolume([loop])
        gmsh.model.geo.synchronize()
    else:
        gmsh.model.occ.importShapes(file)
        solids = gmsh.model.occ.getEntities(3)
        if glue and len(solids) > 1:
            gmsh.model.occ.fragment(solids[:1], solids[1:])
        gmsh.model.occ.synchronize()
    if not gmsh.model.getEntities(3):
        raise ValueError("it holds no solid, only surfaces")
    if not file.lower().endswith(".stl"):
        size = _extent_of_solids(gmsh).checked(size)
    for option in ("Mesh.MeshSizeMin", "Mesh.MeshSizeMax"):
        gmsh.option.setNumber(option, size)
    try:
        mesh.generate(3)
    except Exception as error:  # Gmsh's own
        if "intersect" not in str(error):
            raise
        raise ValueError(f"its surface intersects itself ({error})") from error
    tags, points, _ = mesh.getNodes()
    order = np.argsort(tags)
    cells = np.searchsorted(tags[order], mesh.getElementsByType(4)[1])
    return {"points": points.reshape(-1, 3)[order].ravel(), "cells": cells}


def _extent_of_solids(gmsh: Any) -> Extent:
    volume, area = (
        sum(gmsh.model.occ.getMass(*each) for each in gmsh.model.getEntities(dimension)) for dimension in (3, 2)
    )
    box = np.array(gmsh.model.getBoundingBox(-1, -1))
    return Extent(volume, area, tuple((box[3:] - box[:3]).tolist()))


def fill_by_ftetwild(file: str, size: float) -> dict[str, Any]:
    """Points (3 N,) and cells (4 C,) of tetrahedra that fill what the triangles of an STL file wind around."""
    import pytetwild

    vertices, triangles = read_surface(Path(file)).joined()
    with tempfile.TemporaryDirectory() as folder:
        chdir(folder)  # it leaves files where it works
        points, cells = pytetwild.tetrahedralize(
            vertices,
            triangles.astype(np.int32),
            edge_length_abs=size,
            epsilon=envelope(vertices, size) / float(np.linalg.norm(np.ptp(vertices, axis=0))),
            num_threads=1,  # with several no run is like another
            num_opt_iter=MOST_PASSES,
            quiet=False,  # it says how far it is
            loglevel=2,
        )
        chdir("/")
    return {"points": points.ravel(), "cells": cells.astype(np.int64).ravel()}


def envelope(vertices: np.ndarray, size: float) -> float:
    """How far fTetWild may move a surface with vertices (V, 3), in the unit of these and of the size."""
    return max(SHARE_OF_DIAGONAL * float(np.linalg.norm(np.ptp(vertices, axis=0))), SHARE_OF_SIZE * size)


def progress_of(said: bytes, cells: float) -> tuple[str, int, int] | None:
    """The stage, how much is done, and of how much, after what a program has said; None: it does not tell."""
    if passes := re.findall(rb"/// pass (\d+) ///", said):
        return "better cells", int(passes[-1]) + 1, MOST_PASSES
    if nodes := re.findall(rb"It\. \d+ - (\d+) nodes created", said):
        return "fill", min(int(PER_CUBE * int(nodes[-1])), int(cells)), int(cells)
    return None


if __name__ == "__main__":
    main()
