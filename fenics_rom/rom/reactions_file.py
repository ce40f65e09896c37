"""A reaction of supports in a ROM file. Units are those of force; of couples they are with m.

point (3,) m                                        about which couples are
inertia (6, k) kg^1/2                               of accelerations in the shared basis
damping (6, k) kg^1/2/s, stiffness (6, k) kg^1/2/s^2    of velocities and displacements
inputs (6, p)                                       of actuators, then loads
contacts/NAME (6, c)                                of the columns of each contact mode
nodes (s,), motions (3, s, 6)                       that can be touched, and the virtual motions there
turning/                                            with large deformation: what displacements add to couples
    inertia, damping, stiffness (3, k, k), inputs (3, k, p), contacts/NAME (3, k, c), nodes (3, s, k)
    rims/rim_N/ column (1,), points, pieces (G, 3) m, shapes, piece_shapes (G, 3, k): edges of pressed surfaces
"""

from typing import Any

import h5py
import numpy as np

from fenics_rom.errors import FileError
from fenics_rom.io.hdf5 import Entry, get_each, get_group, get_record, put_arrays, put_each
from fenics_rom.mechanics.reactions import CHANNELS, PressedRim, ReactionReading, Turning
from fenics_rom.rom.rom import Rom
from fenics_rom.rom.touch_file import check_indices

UNITS = ("kg^1/2", "kg^1/2/s", "kg^1/2/s^2")
ROWS = {
    "point": Entry("m", (3,)),
    **{name: Entry(unit, (6, "k")) for name, unit in zip(CHANNELS, UNITS, strict=True)},
    "inputs": Entry("1", (6, "p")),
    "nodes": Entry("1", ("s",), "i"),
    "motions": Entry("1", (3, "s", 6)),
}
TABLES = {
    **{name: Entry(unit, (3, "k", "k")) for name, unit in zip(CHANNELS, ("1", "1/s", "1/s^2"), strict=True)},
    "inputs": Entry("kg^-1/2", (3, "k", "p")),
    "nodes": Entry("kg^-1/2", (3, "s", "k")),
}
RIM = {
    "column": Entry("1", (1,), "i"),
    **dict.fromkeys(("points", "pieces"), Entry("m", ("G", 3))),
    **dict.fromkeys(("shapes", "piece_shapes"), Entry("kg^-1/2", ("G", 3, "k"))),
}
SHAPES = ("shapes", "piece_shapes")
OF_CONTACT, TURNED = Entry("1", (6, "c")), Entry("kg^-1/2", (3, "k", "c"))


def put_reaction(group: h5py.Group, reading: ReactionReading, sizes: dict[str, int]) -> None:
    """Writes its arrays; FileError where they do not fit."""
    motions = reading.motions.reshape(len(reading.nodes), 3, 6).swapaxes(0, 1)
    put_arrays(group, ROWS, sizes, vars(reading) | {"motions": motions})
    put_each(group, "contacts", OF_CONTACT, reading.contacts)
    if (turning := reading.turning) is not None:
        part = group.create_group("turning", track_order=True)
        at_nodes = turning.nodes.reshape(len(reading.nodes), 3, sizes["k"])
        arrays = {name: np.array(of) for name, of in turning._asdict().items() if name in TABLES}
        put_arrays(part, TABLES, sizes, arrays | {"nodes": at_nodes.swapaxes(0, 1)})
        put_each(part, "contacts", TURNED, {name: np.array(of) for name, of in turning.contacts.items()})
        rims = part.create_group("rims", track_order=True)
        for k, rim in enumerate(turning.rims):
            by_point = {name: getattr(rim, name).reshape(len(rim.points), 3, sizes["k"]) for name in SHAPES}
            put_arrays(rims.create_group(f"rim_{k}", track_order=True), RIM, dict(sizes), rim._asdict() | by_point)


def take_reaction(group: h5py.Group, sizes: dict[str, int]) -> ReactionReading:
    """Reads it; FileError where something is missing or does not fit."""
    arrays: dict[str, Any] = get_record(group, ROWS, sizes, ("contacts", "turning"))
    arrays["point"] = np.array(arrays["point"])
    arrays["motions"] = arrays["motions"].swapaxes(0, 1).reshape(-1, 6)
    arrays["contacts"] = get_each(get_group(group, "contacts"), OF_CONTACT)
    if "turning" not in group:
        return ReactionReading(**arrays)
    part = get_group(group, "turning")
    tables: dict[str, Any] = get_record(part, TABLES, sizes, ("contacts", "rims"))
    at_nodes = tables.pop("nodes").swapaxes(0, 1).reshape(-1, sizes["k"])
    contacts = {name: tuple(of) for name, of in get_each(get_group(part, "contacts"), TURNED, sizes).items()}
    axes = {name: tuple(of) for name, of in tables.items()}
    of_edges, rims = get_group(part, "rims"), list[PressedRim]()
    for name in of_edges:
        rim: dict[str, Any] = get_record(get_group(of_edges, name), RIM, {"k": sizes["k"]})
        rims.append(PressedRim(**rim | {key: rim[key].reshape(-1, sizes["k"]) for key in SHAPES}))
    return ReactionReading(**arrays, turning=Turning(**axes, contacts=contacts, nodes=at_nodes, rims=tuple(rims)))


def check_reaction(where: str, reading: ReactionReading, rom: Rom) -> None:
    """What a shape cannot say; FileError where it is of other inputs or nodes than the ROM."""
    if len(reading.nodes):
        check_indices(f"{where}/nodes", reading.nodes, len(rom.nodes))
    shared = sum(rom.actuators.values()) + sum(rom.loads.values())
    if reading.inputs.shape[1] != shared:
        raise FileError(f"{where}/inputs: of {reading.inputs.shape[1]} columns, and the ROM has {shared}")
    if {name: of.shape[1] for name, of in reading.contacts.items()} != dict(rom.contacts):
        raise FileError(f"{where}/contacts: of other contact modes or columns than the ROM has")
    for k, rim in enumerate(() if reading.turning is None else reading.turning.rims):
        if not 0 <= rim.column < shared:
            raise FileError(f"{where}/turning/rims/rim_{k}/column: use numbers below {shared}")
