"""Residual compliance in a ROM file: the group `residual_compliance`, described in rom.file."""

import h5py
import numpy as np

from fenics_rom.errors import FileError
from fenics_rom.io.hdf5 import Entry, check_names, get_each, get_group, get_record, put_arrays, put_each
from fenics_rom.rom.residual_compliance import ResidualCompliance
from fenics_rom.rom.rom import Rom

ARRAYS = {
    "factor": Entry("m^1/2/N^1/2", ("3P", "r")),
    "time_constants": Entry("s", ("r",), optional=True),
    "floor": Entry("m/N", (1,)),
    "damping": Entry("s", (1,)),
    "dt": Entry("s", (1,)),
}
ERRORS = Entry("1", (2,))


def put_residual_compliance(h5: h5py.File, residual: ResidualCompliance) -> None:
    """Writes the group."""
    check_names(residual.errors)
    group = h5.create_group("residual_compliance", track_order=True)
    put_arrays(group, ARRAYS, {}, {name: np.atleast_1d(getattr(residual, name)) for name in ARRAYS})
    put_each(group, "errors", ERRORS, residual.errors)


def take_residual_compliance(h5: h5py.File) -> ResidualCompliance:
    """Reads the group."""
    group = get_group(h5, "residual_compliance")
    errors = get_each(get_group(group, "errors"), ERRORS)
    record = get_record(group, ARRAYS, {}, ("errors", "inertia"))
    if record["time_constants"] is None:
        record["time_constants"] = np.zeros(record["factor"].shape[1])
    return ResidualCompliance(**record, errors=errors)


def check_residual_compliance(rom: Rom) -> None:
    """What a shape cannot say."""
    residual = rom.residual_compliance
    assert residual is not None
    nodes = np.unique(np.concatenate([mode.contact_points for mode in rom.contact_models.values()]))
    between = 0 if rom.points_between is None else len(rom.points_between.nodes)
    points = len(nodes) + between
    if len(residual.factor) != 3 * points:
        given = f"{len(residual.factor) / 3:g}"
        raise FileError(f"/residual_compliance/factor is of {given} points, and {points} can be touched")
    if residual.floor <= 0 or min(residual.time_constants.min(initial=0.0), residual.damping, residual.dt) < 0:
        raise FileError(
            "/residual_compliance: floor must be positive, time_constants, damping and dt must not be negative"
        )
    if any(name not in rom.contact_models or min(pair) < 0 for name, pair in residual.errors.items()):
        raise FileError("/residual_compliance/errors are negative, or of a contact mode that is not there")
