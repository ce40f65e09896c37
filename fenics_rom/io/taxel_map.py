"""Taxels of a sense of touch, as ROM files and run files have them.

grid (2,), areas (K,) m^2, centres (K, 3) m     rows and columns, and what each taxel covers; 0 off the surface
triangles (G,), seen, taxels, shares (h,)       which triangles show them: triangle `seen` shows so much of a taxel
"""

from collections.abc import Mapping

import numpy as np

from fenics_rom.errors import FileError
from fenics_rom.io.hdf5 import Entry

TAXELS = {
    "grid": Entry("1", (2,), "i"),
    "areas": Entry("m^2", ("K",)),
    "centres": Entry("m", ("K", 3)),
    "triangles": Entry("1", ("G",), "i"),
    "seen": Entry("1", ("h",), "i"),
    "taxels": Entry("1", ("h",), "i"),
    "shares": Entry("1", ("h",)),
}


def check_shares(where: str, taxels: Mapping[str, np.ndarray], triangles: int) -> None:
    """What a shape cannot say, of a body with so many triangles.

    Raises:
        FileError: a grid of another number of taxels, or indices that point nowhere.
    """
    count, grid = len(taxels["areas"]), taxels["grid"]
    if min(grid) < 0 or grid[0] * grid[1] != count:
        raise FileError(f"{where}/grid: {grid[0]} x {grid[1]} taxels, of which there are {count}")
    for name, below in (("triangles", triangles), ("seen", len(taxels["triangles"])), ("taxels", count)):
        numbers = taxels[name]
        if len(numbers) and not 0 <= numbers.min() <= numbers.max() < below:
            raise FileError(f"{where}/{name}: use numbers below {below}")
