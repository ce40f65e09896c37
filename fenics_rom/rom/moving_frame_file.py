"""A moving frame in a ROM file: the group `moving_frame`, described in rom.file."""

from typing import Any

import h5py

from fenics_rom.errors import FileError
from fenics_rom.io.hdf5 import Entry, get_arrays, get_each, get_group, put_arrays, put_each
from fenics_rom.rom.moving_frame import MovingFrame

ARRAYS = {
    "carried": Entry("1", (1,), "i"),
    "origin": Entry("m", (3,)),
    "mass": Entry("kg", (1,)),
    "first_moment": Entry("kg m", (3,)),
    "moment_modes": Entry("kg^1/2", (3, "K")),
    "inertia0": Entry("kg m^2", (6,)),
    "inertia1": Entry("kg^1/2 m", (6, "K")),
    "inertia2": Entry("1", (6, "K", "K")),
    "coupling0": Entry("kg^1/2 m", (3, "K")),
    "coupling": Entry("1", (3, "K", "K")),
    "stiffening": Entry("1", (6, "K", "K"), optional=True),
    "springs": Entry("N/m and per m, kg^-1/2", ("4 + 3 K", "4 + 3 K"), optional=True),
    "dashpots": Entry("N s/m and per m, kg^-1/2", ("4 + 3 K", "4 + 3 K"), optional=True),
}
BY_NAME = {
    "wrenches": Entry("N and N m per input", (6, "p")),
    "torque_modes": Entry("N/kg^1/2 per input", ("p", 3, "K")),
    "output_points": Entry("m", ("points", 3)),
}


def put_moving_frame(h5: h5py.File, frame: MovingFrame) -> None:
    """Writes the group."""
    group = h5.create_group("moving_frame", track_order=True)
    put_arrays(group, ARRAYS, {}, vars(frame))
    for kind, entry in BY_NAME.items():
        put_each(group, kind, entry, getattr(frame, kind))


def take_moving_frame(h5: h5py.File) -> MovingFrame:
    """Reads the group."""
    group = get_group(h5, "moving_frame")
    arrays: Any = get_arrays(group, ARRAYS, {}, tuple(BY_NAME))
    carried, mass = arrays["carried"].item(), arrays["mass"].item()
    if carried not in (0, 1):
        raise FileError(f"{group.name}/carried is {carried}; use 0 or 1")
    by_name = {kind: get_each(get_group(group, kind), entry) for kind, entry in BY_NAME.items()}
    return MovingFrame(**arrays | by_name | {"carried": bool(carried), "mass": mass})
