"""A sense of touch in a ROM file.

nodes (s,), facets (F, 3 or 6), areas (F,) m^2, places (s, 3) m     of its surface: facets are rows of nodes
origin (3,) m, patches (1,)                     about which torques are, and how many patches of contact are told
felt, taxels, shares (h,)                       which node has which share of its force in which taxel
map/                                            the taxels: see io.taxel_map
sensor/                                         numbers of mechanics.sensor.Sensor
"""

import h5py
import numpy as np

from fenics_rom.errors import FileError
from fenics_rom.io.hdf5 import Entry, get_group, get_record, put_arrays
from fenics_rom.io.taxel_map import TAXELS, check_shares
from fenics_rom.mechanics.sensor import Sensor
from fenics_rom.mechanics.touch import TaxelMap, TouchReading

FELT = {
    "nodes": Entry("1", ("s",), "i"),
    "facets": Entry("1", ("F", "A"), "i"),
    "areas": Entry("m^2", ("F",)),
    "places": Entry("m", ("s", 3)),
    "origin": Entry("m", (3,)),
    "patches": Entry("1", (1,), "i"),
    "felt": Entry("1", ("h",), "i"),
    "taxels": Entry("1", ("h",), "i"),
    "shares": Entry("1", ("h",)),
}
SENSOR = {
    "rate": Entry("Hz", (1,)),
    "delay": Entry("s", (1,)),
    **{
        f"{what}_{kind}": Entry(unit, (1,))
        for kind in ("noise", "step")
        for what, unit in (("pressure", "Pa"), ("force", "N"), ("torque", "N m"))
    },
    "seed": Entry("1", (1,), "i"),
}
ROUND_OFF = 1e-9  # of shares


def put_touch(group: h5py.Group, reading: TouchReading) -> None:
    """Writes its arrays, and the groups `map` and `sensor`; FileError where they do not fit."""
    put_arrays(group, FELT, {}, vars(reading))
    put_arrays(group.create_group("map", track_order=True), TAXELS, {}, reading.map._asdict())
    put_arrays(group.create_group("sensor", track_order=True), SENSOR, {}, vars(reading.sensor))


def take_touch(group: h5py.Group) -> TouchReading:
    """Reads it; FileError where something is missing or does not fit."""
    arrays = get_record(group, FELT, {}, ("map", "sensor"))
    arrays["origin"] = np.array(arrays["origin"])
    taxels, sensor = get_record(get_group(group, "map"), TAXELS), get_record(get_group(group, "sensor"), SENSOR)
    taxels["grid"] = np.array(taxels["grid"])
    return TouchReading(**arrays, map=TaxelMap(**taxels), sensor=Sensor(**sensor))


def check_touch(where: str, reading: TouchReading, nodes: int, triangles: int) -> None:
    """What a shape cannot say; FileError of indices that point nowhere, and of areas and numbers that cannot be."""
    check_indices(f"{where}/nodes", reading.nodes, nodes)
    check_indices(f"{where}/facets", reading.facets, len(reading.nodes))
    if reading.facets.shape[1] not in (3, 6) or not (reading.areas > 0).all():
        raise FileError(f"{where}: facets have 3 or 6 nodes and an area")
    if not np.isin(np.arange(len(reading.nodes)), reading.facets).all():
        raise FileError(f"{where}: a node has no facets")
    if reading.patches < 1:
        raise FileError(f"{where}/patches: use a number >= 1")
    taxels = len(reading.map.areas)
    check_shares(f"{where}/map", reading.map._asdict(), triangles)
    if taxels:
        check_indices(f"{where}/taxels", reading.taxels, taxels)
        check_indices(f"{where}/felt", reading.felt, len(reading.nodes))
        if np.abs(np.bincount(reading.felt, reading.shares, minlength=len(reading.nodes)) - 1).max() > ROUND_OFF:
            raise FileError(f"{where}/shares: those of a node have not the sum 1")
    if any(value < 0 for value in vars(reading.sensor).values()):
        raise FileError(f"{where}/sensor: use numbers >= 0")


def check_indices(where: str, indices: np.ndarray, count: int) -> None:
    """A FileError where there are none, or some are beyond a count."""
    if not indices.size or not 0 <= indices.min() <= indices.max() < count:
        raise FileError(f"{where}: use some numbers below {count}")
