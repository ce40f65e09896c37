"""Forces of contact on nodes that are kept of a run, and how they are written.

In a file: `touched` (c,) nodes, and of each whole shape `contact_forces` (s, c, 3) and `contact_pressing` (s, c).
"""

from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import FileError
from fenics_rom.io.hdf5 import Entry
from fenics_rom.mechanics.nodal_contact import NodalContact

CONTACT = {
    "touched": Entry("1", ("c",), "i", optional=True),
    "contact_forces": Entry("N", ("s", "c", 3), optional=True),
    "contact_pressing": Entry("N", ("s", "c"), optional=True),
}


class ContactSnapshots:
    """Those of so many whole shapes, which are filled one after another."""

    def __init__(self, count: int):
        self._count = count
        self.kept: NodalContact | None = None  # what was sampled; None where nothing can touch the body

    def sample(self, row: int, contact: NodalContact | None) -> None:
        """Keeps that of a shape."""
        if contact is None:
            return
        if self.kept is None:
            c = len(contact.nodes)
            self.kept = NodalContact(contact.nodes, np.zeros((self._count, c, 3)), np.zeros((self._count, c)))
        self.kept.forces[row], self.kept.pressing[row] = contact.forces, contact.pressing


def contact_arrays(touched: NodalContact | None) -> dict[str, Array | None]:
    """As a file has them."""
    return dict(zip(CONTACT, (None,) * 3 if touched is None else touched, strict=True))


def take_contact(arrays: dict[str, Any], nodes: int) -> NodalContact | None:
    """Takes them out of the arrays of a file of so many nodes; FileError where one is missing or of other nodes."""
    given = [arrays.pop(name) for name in CONTACT]
    missing = [each is None for each in given]
    if all(missing):
        return None
    if any(missing):
        raise FileError(f"/{', /'.join(CONTACT)}: use all of them, or none")
    if len(given[0]) and not 0 <= given[0].min() <= given[0].max() < nodes:
        raise FileError(f"/touched names nodes beyond {nodes}")
    return NodalContact(*given)
