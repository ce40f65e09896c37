"""Readings in a ROM file: the group `readings`, described in rom_file."""

import h5py
import numpy as np

from fenics_rom.errors import FileError, check_known
from fenics_rom.io.hdf5 import Entry, check_names, get_group, get_record, get_text, put_arrays, put_text
from fenics_rom.mechanics.readings import (
    READING_UNITS,
    ContactPressure,
    MarkerReading,
    Reading,
    StrokeReading,
    SurfaceReading,
)
from fenics_rom.rom.rom import Rom

ROUND_OFF = 1e-9  # of unit vectors
CONTACT = {"nodes": Entry("1", ("s",), "i"), "facets": Entry("1", ("F", "A"), "i"), "areas": Entry("m^2", ("F",))}
SURFACE = {
    "triangles": Entry("1", ("P",), "i"),
    "operator": Entry("kg^-1/2/m", (3, 3, "P", "k")),
    "first_lame": Entry("Pa", ("P",)),
    "shear": Entry("Pa", ("P",)),
}
MARKER = {
    "foot": Entry("kg^-1/2", (3, "k")),
    "gradients": Entry("kg^-1/2/m", (2, 3, "k")),
    "tangents": Entry("1", (2, 3)),
    "offset": Entry("m", (3,)),
}


def put_readings(h5: h5py.File, rom: Rom) -> None:
    """Writes the group.

    Raises:
        FileError: names or arrays that do not fit.
    """
    check_names(rom.readings)
    group = h5.create_group("readings", track_order=True)
    for name, reading in rom.readings.items():
        part = group.create_group(name, track_order=True)
        put_text(part, quantity=reading.quantity, of=reading.of)
        arrays, sizes = vars(reading), {"k": len(rom.stiffness)}
        if isinstance(reading, SurfaceReading):
            operator = reading.operator.reshape(3, 3, len(reading.triangles), -1)
            put_arrays(part, SURFACE, sizes, arrays | {"operator": operator})
        elif isinstance(reading, MarkerReading):
            foot, gradients = np.split(reading.operator, [3])
            put_arrays(part, MARKER, sizes, arrays | {"foot": foot, "gradients": gradients.reshape(2, 3, -1)})
        elif isinstance(reading, ContactPressure):
            put_arrays(part, CONTACT, sizes, arrays)
        else:
            put_arrays(part, _rest(reading.quantity), sizes, arrays)


def take_readings(h5: h5py.File, order: int) -> dict[str, Reading]:
    """Reads the group, of a ROM of k = order vectors.

    Raises:
        FileError: something is missing or does not fit.
    """
    group = get_group(h5, "readings")
    return {name: _take(get_group(group, name), {"k": order}) for name in group}


def _take(group: h5py.Group, sizes: dict[str, int]) -> Reading:
    quantity, of = get_text(group, "quantity"), get_text(group, "of")
    check_known("quantity", quantity, READING_UNITS, FileError, f"{group.name}: ")
    if quantity in ("length", "volume"):
        return StrokeReading(quantity, of, **get_record(group, _rest(quantity), sizes))
    if quantity == "marker":
        arrays = get_record(group, MARKER, sizes)
        operator = np.concatenate([arrays["foot"], arrays["gradients"].reshape(6, -1)])
        return MarkerReading(operator, arrays["tangents"], np.array(arrays["offset"]))
    arrays = get_record(group, CONTACT if quantity == "contact_pressure" else SURFACE, sizes)
    if quantity == "contact_pressure":
        return ContactPressure(of, **arrays)
    arrays["operator"] = arrays["operator"].reshape(-1, sizes["k"])
    return SurfaceReading(quantity, of, **arrays)


def _rest(quantity: str) -> dict[str, Entry]:
    return {"rest": Entry(READING_UNITS[quantity], (1,))}


def check_readings(rom: Rom) -> None:
    """What a shape cannot say.

    Raises:
        FileError: indices that point nowhere, or areas and moduli that cannot be.
    """
    for name, reading in rom.readings.items():
        where = f"/readings/{name}"
        if isinstance(reading, SurfaceReading):
            _check_indices(f"{where}/triangles", reading.triangles, len(rom.triangles))
            if not ((reading.shear > 0) & (3 * reading.first_lame + 2 * reading.shear > 0)).all():
                raise FileError(f"{where}: moduli are not positive")
        elif isinstance(reading, ContactPressure):
            _check_indices(f"{where}/nodes", reading.nodes, len(rom.nodes))
            _check_indices(f"{where}/facets", reading.facets, len(reading.nodes))
            check_known("contact mode", reading.of, rom.contact_models, FileError, f"{where}: ")
            if reading.facets.shape[1] not in (3, 6) or not (reading.areas > 0).all():
                raise FileError(f"{where}: facets have 3 or 6 nodes and an area")
            if not np.isin(np.arange(len(reading.nodes)), reading.facets).all():
                raise FileError(f"{where}: a node has no facets")
        elif isinstance(reading, MarkerReading):
            if np.abs(reading.tangents @ reading.tangents.T - np.eye(2)).max() > ROUND_OFF:
                raise FileError(f"{where}/tangents: are not orthonormal")
        elif rom.actuators.get(reading.of) != 1 or not reading.rest > 0:
            raise FileError(f"{where}: {reading.of!r} is no actuator of one column, or nothing is left of it at rest")


def _check_indices(where: str, indices: np.ndarray, count: int) -> None:
    if not indices.size or not 0 <= indices.min() <= indices.max() < count:
        raise FileError(f"{where}: allowed are some numbers below {count}")
