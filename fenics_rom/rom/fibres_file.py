"""Fibres in a ROM file: a group `fibres` of what has points, with a group for each family, described in rom_file."""

import h5py

from fenics_rom.io.hdf5 import Entry, get_group, get_record, get_text, put_arrays, put_text
from fenics_rom.mechanics.fibres import Fibres

FAMILY = {
    "points": Entry("1", ("F",), "i"),
    "structure": Entry("1", (6, "F")),
    "modulus": Entry("Pa", ("F",)),
    "stiffening": Entry("1", ("F",)),
}


def put_fibres(group: h5py.Group, fibres: tuple[Fibres, ...]) -> None:
    """Writes the group, if there are any."""
    if not fibres:
        return
    families = group.create_group("fibres", track_order=True)
    for k, family in enumerate(fibres):
        part = families.create_group(f"family_{k}", track_order=True)
        put_text(part, law=family.law)
        put_arrays(part, FAMILY, {}, vars(family))


def get_fibres(group: h5py.Group) -> tuple[Fibres, ...]:
    """Reads the group; none where there is none."""
    families = get_group(group, "fibres") if "fibres" in group else {}
    return tuple(_family(get_group(families, name)) for name in families)


def _family(group: h5py.Group) -> Fibres:
    return Fibres(get_text(group, "law"), **get_record(group, FAMILY, {}))
