"""Residual compliance in a ROM file: the group `residual_compliance`, described in rom.file."""

import h5py
import numpy as np

from fenics_rom.errors import FileError
from fenics_rom.io.hdf5 import Entry, check_names, get_each, get_group, get_record, put_arrays, put_each
from fenics_rom.rom.block_matrix import BlockMatrix
from fenics_rom.rom.residual_compliance import ResidualCompliance
from fenics_rom.rom.rom import Rom

ARRAYS = {
    "factor": Entry("m^1/2/N^1/2", ("3P", "r"), optional=True),
    "time_constants": Entry("s", ("r",), optional=True),
    "floor": Entry("m/N", (1,)),
    "damping": Entry("s", (1,)),
    "dt": Entry("s", (1,)),
}
BLOCKS = {"order": Entry("1", ("P",), "i"), "blocks": Entry("1", ("b", 5), "i"), "values": Entry("m/N", ("v",))}
ERRORS = Entry("1", (2,))


def put_residual_compliance(h5: h5py.File, residual: ResidualCompliance) -> None:
    """Writes the group."""
    check_names(residual.errors)
    group = h5.create_group("residual_compliance", track_order=True)
    put_arrays(group, ARRAYS, {}, {name: getattr(residual, name) for name in ARRAYS})
    put_each(group, "errors", ERRORS, residual.errors)
    if residual.static is not None:
        put_arrays(group.create_group("static", track_order=True), BLOCKS, {}, vars(residual.static))


def take_residual_compliance(h5: h5py.File) -> ResidualCompliance:
    """Reads the group."""
    group = get_group(h5, "residual_compliance")
    errors = get_each(get_group(group, "errors"), ERRORS)
    record, static = get_record(group, ARRAYS, {}, ("errors", "inertia", "static")), None
    if "static" in group:
        static = BlockMatrix(**get_record(get_group(group, "static"), BLOCKS))
    if record["time_constants"] is None:
        record["time_constants"] = np.zeros(0 if record["factor"] is None else record["factor"].shape[1])
    return ResidualCompliance(**record, errors=errors, static=static)


def check_residual_compliance(rom: Rom) -> None:
    """What a shape cannot say."""
    residual = rom.residual_compliance
    assert residual is not None
    nodes = np.unique(np.concatenate([mode.contact_points for mode in rom.contact_models.values()]))
    between = 0 if rom.points_between is None else len(rom.points_between.nodes)
    points = len(nodes) + between
    if residual.static is not None and residual.factor is None:
        name, given = "static", float(len(residual.static.order))
        if mistake := residual.static.mistake():
            raise FileError(f"/residual_compliance/static: {mistake}")
    elif residual.factor is not None and residual.static is None:
        name, given = "factor", len(residual.factor) / 3
    else:
        raise FileError("/residual_compliance: factor or static is missing, or there are both")
    if given != points:
        raise FileError(f"/residual_compliance/{name} is of {given:g} points, and {points} can be touched")
    if residual.floor <= 0 or min(residual.time_constants.min(initial=0.0), residual.damping, residual.dt) < 0:
        raise FileError(
            "/residual_compliance: floor must be positive, time_constants, damping and dt must not be negative"
        )
    if any(name not in rom.contact_models or min(pair) < 0 for name, pair in residual.errors.items()):
        raise FileError("/residual_compliance/errors are negative, or of a contact mode that is not there")
