"""The ROM file: one HDF5 file with everything the runtime needs.

Format 1.0. The first 512 bytes are a user block with the SHA-256 of the rest (see checked_file).
Root attributes (fixed-length UTF-8 text): format = "fenics-rom", format_version, content = "rom", software, name,
switching, weighting, scene (the scene file), warnings (one a line). Every dataset has an attribute `unit`.
Sizes: n free displacement components, k shared basis vectors, N nodes, F triangles; for each contact mode m order,
p input columns, r Hankel singular values; P points of an output.

    basis (n, k) kg^-1/2             Q, QᵀMQ = I
    stiffness (k,) 1/s^2             κ, QᵀKQ = diag(κ)
    free (n,)                        index of each free component among 3 N, or 0 to n - 1 where there is no mesh
    nodes (N, 3) m, triangles (F, 3), node_mass (N,) kg; empty where there is no mesh
    outputs/NAME (3P, k) kg^-1/2     C Q; any number of rows where there is no mesh
    actuators/NAME (1,)              number of input columns
    effects/NAME/PARAMETER (1,)
    tables/NUMBER (rows, columns)    force tables of the scene; attribute `file`
    modes/NAME/                      in the order of the scene
        eigenvalues (m,) 1/s^2       γ
        damping (m,) or (m, m) 1/s
        inputs (m, p) kg^-1/2        G = W_iᵀB_i; contact columns, then actuator columns
        coordinates (k, m)           C_i, W_i = Q C_i
        directions (m, m)            first columns span the models of lower order
        hankel_singular_values (r,)  s^2/kg^1/2 under mass weighting, else s^2/kg
        static_error (1,)            may be absent
        left_inverse (m, k)          only for switching = "oblique"
"""

from pathlib import Path
from typing import Any

import h5py
import numpy as np

from fenics_rom.checked_file import (
    Entry,
    Sizes,
    check_names,
    get_arrays,
    get_group,
    get_text,
    put_arrays,
    put_text,
    read_file,
    write_file,
)
from fenics_rom.effects import EFFECTS
from fenics_rom.errors import RomFileError
from fenics_rom.rom import Mode, Rom, check_rom
from fenics_rom.scene import SWITCHINGS
from fenics_rom.schema import unknown

BODY = {
    "basis": Entry("kg^-1/2", ("n", "k")),
    "stiffness": Entry("1/s^2", ("k",)),
    "free": Entry("1", ("n",), "i"),
    "nodes": Entry("m", ("N", 3)),
    "triangles": Entry("1", ("F", 3), "i"),
    "node_mass": Entry("kg", ("N",)),
}
HANKEL_UNIT = {"mass": "s^2/kg^1/2", "nodal": "s^2/kg", "outputs": "s^2/kg"}  # by weighting
MODE = {
    "eigenvalues": Entry("1/s^2", ("m",)),
    "inputs": Entry("kg^-1/2", ("m", "p")),
    "coordinates": Entry("1", ("k", "m")),
    "directions": Entry("1", ("m", "m")),
    "static_error": Entry("1", (1,), optional=True),
    "left_inverse": Entry("1", ("m", "k"), optional=True),
}
GROUPS = ("outputs", "actuators", "effects", "tables", "modes")


def write_rom(file: str | Path, rom: Rom) -> None:
    """Writes a ROM; an existing file is replaced only by a complete one.

    Raises:
        RomFileError: it cannot be written, or its parts do not fit each other.
        StructureError: the ROM lacks the structure that passivity rests on.
    """
    write_file(file, "rom", lambda h5: _fill(h5, rom))


def read_rom(file: str | Path) -> Rom:
    """Reads a ROM.

    Raises:
        RomFileError: the file is missing, damaged, of another format, or its model lacks structure.
    """
    return read_file(file, "rom", _take)


def _fill(h5: h5py.File, rom: Rom) -> None:
    for names in (rom.outputs, rom.actuators, rom.modes):
        check_names(names)
    put_text(h5, name=rom.name, switching=rom.switching, weighting=rom.weighting)
    put_text(h5, scene=rom.scene_text, warnings="\n".join(rom.warnings))
    sizes: Sizes = {}
    put_arrays(h5, BODY, sizes, {name: getattr(rom, name) for name in BODY})
    groups = {name: h5.create_group(name, track_order=True) for name in GROUPS}
    for name, rows in rom.outputs.items():
        put_arrays(groups["outputs"], {name: _output(name)}, sizes, {name: rows})
    for name, columns in rom.actuators.items():
        put_arrays(groups["actuators"], {name: Entry("1", (1,), "i")}, sizes, {name: np.array([columns])})
    for name, parameters in rom.effects.items():
        table = _effect(name)
        group = groups["effects"].create_group(name, track_order=True)
        put_arrays(group, table, sizes, {key: np.array([parameters[key]]) for key in table})
    for number, (name, rows) in enumerate(rom.tables.items()):
        put_arrays(groups["tables"], {str(number): _force_table(number)}, sizes, {str(number): rows})
        put_text(groups["tables"][str(number)], file=name)
    for name, mode in rom.modes.items():
        table = _mode_table(rom.weighting, dense=mode.damping.ndim == 2)
        arrays = {key: getattr(mode, key) for key in table}
        arrays["static_error"] = None if mode.static_error is None else np.array([mode.static_error])
        group = groups["modes"].create_group(name, track_order=True)
        put_arrays(group, table, _mode_sizes(sizes), arrays)
    _check_fit(rom)
    check_rom(rom)


def _take(h5: h5py.File) -> Rom:
    sizes: Sizes = {}
    body: Any = get_arrays(h5, BODY, sizes, GROUPS)
    groups = {name: get_group(h5, name) for name in GROUPS}
    outputs: Any = get_arrays(groups["outputs"], {name: _output(name) for name in groups["outputs"]}, sizes)
    columns: Any = get_arrays(groups["actuators"], {name: Entry("1", (1,), "i") for name in groups["actuators"]}, sizes)
    actuators = {name: int(value[0]) for name, value in columns.items()}
    tables: Any = get_arrays(groups["tables"], {str(k): _force_table(k) for k in range(len(groups["tables"]))}, sizes)
    weighting = get_text(h5, "weighting")
    modes = {name: _take_mode(get_group(groups["modes"], name), weighting, sizes) for name in groups["modes"]}
    rom = Rom(
        name=get_text(h5, "name"),
        switching=get_text(h5, "switching"),
        modes=modes,
        actuators=actuators,
        outputs=outputs,
        effects={name: _take_effect(get_group(groups["effects"], name)) for name in groups["effects"]},
        scene_text=get_text(h5, "scene"),
        tables={get_text(groups["tables"][number], "file"): rows for number, rows in tables.items()},
        warnings=tuple(filter(None, get_text(h5, "warnings").split("\n"))),
        weighting=weighting,
        **body,
    )
    _check_fit(rom)
    return check_rom(rom)


def _mode_table(weighting: str, dense: bool) -> dict[str, Entry]:
    if weighting not in HANKEL_UNIT:
        raise RomFileError(unknown("weighting", weighting, HANKEL_UNIT))
    damping = Entry("1/s", ("m", "m") if dense else ("m",))
    return {**MODE, "damping": damping, "hankel_singular_values": Entry(HANKEL_UNIT[weighting], ("r",))}


def _take_mode(group: h5py.Group, weighting: str, sizes: Sizes) -> Mode:
    damping = group.get("damping")
    dense = isinstance(damping, h5py.Dataset) and damping.ndim == 2
    arrays: Any = get_arrays(group, _mode_table(weighting, dense), _mode_sizes(sizes))
    static = arrays.pop("static_error")
    return Mode(**arrays, static_error=None if static is None else float(static[0]))


def _take_effect(group: h5py.Group) -> dict[str, float]:
    arrays: Any = get_arrays(group, _effect(group.name.split("/")[-1]), {})
    return {key: float(value[0]) for key, value in arrays.items()}


def _effect(name: str) -> dict[str, Entry]:
    if name not in EFFECTS:
        raise RomFileError(unknown("effect", name, EFFECTS))
    return {key: Entry(number.unit or "1", (1,)) for key, number in EFFECTS[name].parameters.items()}


def _check_fit(rom: Rom) -> None:
    """What a shape cannot say: indices that point somewhere, inputs that fit, a switching that exists."""
    if rom.switching not in SWITCHINGS:
        raise RomFileError(unknown("switching", rom.switching, list(SWITCHINGS)))
    if not rom.modes or not len(rom.stiffness) or any(mode.order == 0 for mode in rom.modes.values()):
        raise RomFileError("holds no contact modes, or an empty one")
    meshed = len(rom.nodes) > 0
    if any(len(rows) == 0 or (meshed and len(rows) % 3) for rows in rom.outputs.values()):
        raise RomFileError("an output does not have three rows a point")
    components = 3 * len(rom.nodes) if meshed else len(rom.free)
    if len(rom.free) and (rom.free[0] < 0 or rom.free[-1] >= components or (np.diff(rom.free) <= 0).any()):
        raise RomFileError(f"/free does not name components among {components}, in ascending order")
    if rom.triangles.size and not 0 <= rom.triangles.min() <= rom.triangles.max() < len(rom.nodes):
        raise RomFileError(f"/triangles name nodes beyond {len(rom.nodes)}")
    if (rom.node_mass < 0).any():
        raise RomFileError("/node_mass has negative masses")
    if any(columns < 0 for columns in rom.actuators.values()):
        raise RomFileError("an actuator has a negative number of columns")
    for name, mode in rom.modes.items():
        if rom.contacts[name] < 0:
            raise RomFileError(f"contact mode {name!r} has fewer input columns than the actuators")
        if (mode.left_inverse is None) == (rom.switching == "oblique"):
            raise RomFileError(f"contact mode {name!r}: left_inverse goes with oblique switching, and only with it")
        if len(mode.hankel_singular_values) == 0 or (mode.hankel_singular_values <= 0).any():
            raise RomFileError(f"contact mode {name!r}: Hankel singular values must be positive")


def _mode_sizes(sizes: Sizes) -> Sizes:
    return {"k": sizes["k"]}


def _output(name: str) -> Entry:
    return Entry("kg^-1/2", (f"3P of {name}", "k"))


def _force_table(number: int) -> Entry:
    return Entry("s, N", (f"rows of table {number}", f"columns of table {number}"))
