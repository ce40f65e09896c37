"""Inputs and readings in a run file: the groups `inputs` and `readings`, described in trajectory.file."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import h5py

from fenics_rom.errors import FileError, check_known
from fenics_rom.io.hdf5 import Entry, Sizes, check_names, get_arrays, get_group, get_text, put_arrays, put_text
from fenics_rom.io.taxel_map import TAXELS, check_shares
from fenics_rom.mechanics.reactions import REACTION
from fenics_rom.mechanics.readings import READING_UNITS, STRESS_PARTS
from fenics_rom.mechanics.touch import HEAD, OF_PATCH, TOUCH, TaxelMap
from fenics_rom.trajectory.series import ReadingSeries, Series
from fenics_rom.trajectory.trajectory import Trajectory

INPUT_UNITS = ("N", "Pa", "m/s2", "1", "m", "m3")
SHAPES: dict[str, tuple[str | int, ...]] = {
    "length": (),
    "volume": (),
    "contact_pressure": ("n",),
    "strain": ("G", 6),
    "von_mises_stress": ("G",),
    "surface_stress": ("G", 6),
    "principal_stress": ("G", 3),
    "pressure": ("G",),
    "energy_density": ("G",),
    "stress": ("p", len(STRESS_PARTS)),
    "marker": (3,),
    REACTION: (6,),
    TOUCH: ("V",),
}
PLACES = {
    "n": {"nodes": Entry("1", ("n",), "i")},
    "G": {"triangles": Entry("1", ("G",), "i")},
    "p": {"points": Entry("m", ("p", 3))},
}


def put_series(h5: h5py.File, run: Trajectory, sizes: Sizes) -> None:
    """Writes the groups, where there is something in them.

    Raises:
        FileError: names, units or arrays that do not fit.
    """
    check_names([*run.inputs, *run.readings])
    if run.inputs:
        inputs = h5.create_group("inputs", track_order=True)
        for name, series in run.inputs.items():
            put_arrays(inputs, {name: _input_entry(series.unit)}, {"S": sizes["S"]}, {name: series.values})
    if run.readings:
        readings = h5.create_group("readings", track_order=True)
        for name, reading in run.readings.items():
            group = readings.create_group(name, track_order=True)
            put_text(group, quantity=reading.quantity)
            put_arrays(group, _reading_table(reading.quantity), {"S": sizes["S"]}, vars(reading))
            if reading.taxels is not None:
                put_arrays(group.create_group("taxels", track_order=True), TAXELS, {}, reading.taxels._asdict())


def take_series(h5: h5py.File, sizes: Sizes) -> tuple[dict[str, Series], dict[str, ReadingSeries]]:
    """Reads inputs and readings.

    Raises:
        FileError: something is missing or does not fit.
    """
    inputs, readings = (get_group(h5, kind) if kind in h5 else {} for kind in ("inputs", "readings"))
    input_series: dict[str, Series] = {}
    reading_series: dict[str, ReadingSeries] = {}
    for name in inputs:
        unit = get_text(inputs[name], "unit")
        arrays: Any = get_arrays(inputs, {name: _input_entry(unit)}, {"S": sizes["S"]}, tuple(inputs))
        input_series[name] = Series(arrays[name], unit)
    for name in readings:
        quantity = get_text(group := get_group(readings, name), "quantity")
        further = ("taxels",) if quantity == TOUCH else ()
        arrays = get_arrays(group, _reading_table(quantity), {"S": sizes["S"]}, further)
        if further:
            taxels: Any = get_arrays(get_group(group, "taxels"), TAXELS, {})
            arrays["taxels"] = TaxelMap(**taxels)
        reading_series[name] = ReadingSeries(quantity, **arrays)
    return input_series, reading_series


def put_misread(group: h5py.Group, misread: Mapping[str, ReadingSeries], sizes: Sizes) -> None:
    """Writes errors of readings into a group `readings`, if there are some."""
    if misread:
        part = group.create_group("readings", track_order=True)
        for name, of in misread.items():
            put_arrays(part, {name: _reading_table(of.quantity)["values"]}, {"S": sizes["S"]}, {name: of.values})


def take_misread(group: h5py.Group, readings: Mapping[str, ReadingSeries], sizes: Sizes) -> dict[str, ReadingSeries]:
    """Reads errors of readings of the run.

    Raises:
        FileError: of another reading, or an array that does not fit.
    """
    part: Any = get_group(group, "readings") if "readings" in group else {}
    found: dict[str, ReadingSeries] = {}
    for name in part:
        check_known("reading", name, readings, FileError, f"{group.name}: ")
        entry = _reading_table(readings[name].quantity)["values"]
        arrays: Any = get_arrays(part, {name: entry}, {"S": sizes["S"]}, tuple(part))
        if arrays[name].shape != readings[name].values.shape:
            raise FileError(f"{part.name}/{name}: of shape {arrays[name].shape}, and the reading of another")
        found[name] = replace(readings[name], values=arrays[name])
    return found


def _input_entry(unit: str) -> Entry:
    check_known("unit", unit, INPUT_UNITS, FileError, "an input has ")
    return Entry(unit, ("S", "w"))


def _reading_table(quantity: str) -> dict[str, Entry]:
    check_known("quantity", quantity, READING_UNITS, FileError, "a reading has ")
    shape = SHAPES[quantity]
    places = PLACES.get(str(shape[0]), {}) if shape else {}
    return {"values": Entry(READING_UNITS[quantity], ("S", *shape)), **places}


def check_series(run: Trajectory) -> None:
    """What a shape cannot say.

    Raises:
        FileError: a reading is nowhere on the body.
    """
    for name, reading in run.readings.items():
        for what, count in (("nodes", len(run.nodes)), ("triangles", len(run.triangles))):
            numbers = getattr(reading, what)
            if numbers.size and not 0 <= numbers.min() <= numbers.max() < count:
                raise FileError(f"/readings/{name}/{what}: use numbers below {count}")
        if reading.taxels is not None:
            check_shares(f"/readings/{name}/taxels", reading.taxels._asdict(), len(run.triangles))
            length, taxels = reading.values.shape[1], len(reading.taxels.areas)
            if length < taxels + HEAD + OF_PATCH or (length - taxels - HEAD) % OF_PATCH:
                raise FileError(f"/readings/{name}/values: {length} numbers are none of touch with {taxels} taxels")
