"""Readings in a ROM file: the group `readings`, described in rom_file."""

import h5py
import numpy as np

from fenics_rom.errors import FileError, check_known
from fenics_rom.io.hdf5 import (
    Entry,
    check_names,
    get_each,
    get_group,
    get_record,
    get_text,
    put_arrays,
    put_each,
    put_text,
)
from fenics_rom.mechanics.fibres import check_fibres
from fenics_rom.mechanics.reactions import REACTION, ReactionReading
from fenics_rom.mechanics.readings import (
    READING_UNITS,
    ContactPressure,
    MarkerReading,
    Reading,
    StressReading,
    StrokeReading,
    SurfaceReading,
)
from fenics_rom.mechanics.touch import TOUCH, TouchReading
from fenics_rom.rom.fibres_file import get_fibres, put_fibres
from fenics_rom.rom.reactions_file import check_reaction, put_reaction, take_reaction
from fenics_rom.rom.rom import Rom
from fenics_rom.rom.touch_file import check_indices, check_touch, put_touch, take_touch

ROUND_OFF = 1e-9  # of unit vectors
CONTACT = {"nodes": Entry("1", ("s",), "i"), "facets": Entry("1", ("F", "A"), "i"), "areas": Entry("m^2", ("F",))}
SURFACE = {
    "triangles": Entry("1", ("P",), "i"),
    "operator": Entry("kg^-1/2/m", (3, 3, "P", "k")),
    "first_lame": Entry("Pa", ("P",)),
    "shear": Entry("Pa", ("P",)),
}
STRESS = {
    "points": Entry("m", ("G", 3)),
    "corner_points": Entry("1", ("K",), "i"),
    "corner_weights": Entry("1", ("K",)),
    "value_corners": Entry("1", ("T",), "i"),
    "value_shares": Entry("1", ("T",)),
    "place_weights": Entry("1", ("T", "R"), optional=True),  # 1 of one place each where it is absent
    "operator": SURFACE["operator"],
    "first_lame": SURFACE["first_lame"],
    "shear": SURFACE["shear"],
}
EXPANSION = Entry("1", ("P",))
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
        if isinstance(reading, SurfaceReading | StressReading):
            operator = reading.operator.reshape(3, 3, len(reading.shear), -1)
            table, arrays = SURFACE, arrays | {"operator": operator}
            if isinstance(reading, StressReading):
                table, several = STRESS, reading.place_weights.shape[1] > 1
                arrays["place_weights"] = reading.place_weights if several else None
            put_arrays(part, table, sizes, arrays)
            put_fibres(part, reading.fibres)
            if reading.expansions:
                put_each(part, "expansions", EXPANSION, reading.expansions, {"P": len(reading.shear)})
        elif isinstance(reading, MarkerReading):
            foot, gradients = np.split(reading.operator, [3])
            put_arrays(part, MARKER, sizes, arrays | {"foot": foot, "gradients": gradients.reshape(2, 3, -1)})
        elif isinstance(reading, ContactPressure):
            put_arrays(part, CONTACT, sizes, arrays)
        elif isinstance(reading, ReactionReading):
            put_reaction(part, reading, sizes)
        elif isinstance(reading, TouchReading):
            put_touch(part, reading)
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
    if quantity == TOUCH:
        return take_touch(group)
    if quantity == REACTION:
        return take_reaction(group, sizes)
    tables = {"contact_pressure": CONTACT, "stress": STRESS}
    arrays = get_record(group, tables.get(quantity, SURFACE), sizes, ("fibres", "expansions"))
    if quantity == "contact_pressure":
        return ContactPressure(of, **arrays)
    arrays["operator"] = arrays["operator"].reshape(-1, sizes["k"])
    arrays["fibres"] = get_fibres(group)
    if "expansions" in group:
        of_points = {"P": len(arrays["shear"])}
        arrays["expansions"] = get_each(get_group(group, "expansions"), EXPANSION, of_points)
    if quantity == "stress":
        if arrays.get("place_weights") is None:
            arrays["place_weights"] = np.ones((len(arrays["value_shares"]), 1))
        return StressReading(**arrays)
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
        if isinstance(reading, SurfaceReading | StressReading):
            try:
                check_fibres(reading.fibres, len(reading.shear))
            except ValueError as error:
                raise FileError(f"{where}: {error}") from error
        if isinstance(reading, SurfaceReading):
            check_indices(f"{where}/triangles", reading.triangles, len(rom.triangles))
            if not ((reading.shear > 0) & (3 * reading.first_lame + 2 * reading.shear > 0)).all():
                raise FileError(f"{where}: moduli are not positive")
        elif isinstance(reading, StressReading):
            _check_stress(where, reading)
        elif isinstance(reading, ReactionReading):
            check_reaction(where, reading, rom)
        elif isinstance(reading, TouchReading):
            check_touch(where, reading, len(rom.nodes), len(rom.triangles))
        elif isinstance(reading, ContactPressure):
            check_indices(f"{where}/nodes", reading.nodes, len(rom.nodes))
            check_indices(f"{where}/facets", reading.facets, len(reading.nodes))
            check_known("contact mode", reading.of, rom.contact_models, FileError, f"{where}: ")
            if reading.facets.shape[1] not in (3, 4, 6, 9) or not (reading.areas > 0).all():
                raise FileError(f"{where}: facets have 3, 4, 6 or 9 nodes and an area")
            if not np.isin(np.arange(len(reading.nodes)), reading.facets).all():
                raise FileError(f"{where}: a node has no facets")
        elif isinstance(reading, MarkerReading):
            if np.abs(reading.tangents @ reading.tangents.T - np.eye(2)).max() > ROUND_OFF:
                raise FileError(f"{where}/tangents: are not orthonormal")
        elif rom.actuators.get(reading.of) != 1 or not reading.rest > 0:
            raise FileError(f"{where}: {reading.of!r} is no actuator of one column, or nothing is left of it at rest")


def _check_stress(where: str, reading: StressReading) -> None:
    """Points have corners, corners have values, and both have weights whose sum is 1."""
    for name, indices, weights, count in (
        ("corner_points", reading.corner_points, reading.corner_weights, len(reading.points)),
        ("value_corners", reading.value_corners, reading.value_shares, len(reading.corner_points)),
    ):
        check_indices(f"{where}/{name}", indices, count)
        if (np.diff(indices) < 0).any() or not np.isin(np.arange(count), indices).all():
            raise FileError(f"{where}/{name}: use all numbers below {count}, ascending")
        if not (weights > 0).all() or np.abs(np.bincount(indices, weights) - 1).max() > ROUND_OFF:
            raise FileError(f"{where}/{name}: weights are not positive with the sum 1")
    if np.abs(reading.place_weights.sum(axis=1) - 1).max() > ROUND_OFF:
        raise FileError(f"{where}/place_weights: their sums are not 1")
    samples, values = len(reading.shear), reading.place_weights.size
    if (
        samples not in (values, 2 * values)
        or not ((reading.shear >= 0) & (reading.first_lame + reading.shear > 0)).all()
    ):
        raise FileError(f"{where}: moduli are not positive, or not of {values} values")
