"""Large deformation in a ROM file: the group `deformation`, described in rom_file."""

from typing import Any

import h5py

from fenics_rom.io.hdf5 import Entry, Sizes, get_each, get_group, get_record, get_text, put_arrays, put_each, put_text
from fenics_rom.rom.deformation import ReducedBar, ReducedDeformation, ReducedRim, ReducedTendon, TrainingRange
from fenics_rom.rom.fibres_file import get_fibres, put_fibres

BODY = {
    "gradients": Entry("kg^-1/2/m", (3, 3, "Q", "k")),
    "weights": Entry("m^3", ("Q",)),
    "first_lame": Entry("Pa", ("Q",)),
    "shear": Entry("Pa", ("Q",)),
    "viscosity": Entry("s", ("Q",)),
    "external_damping": Entry("1/s", ("k", "k")),
    "springs": Entry("1/s^2", ("k", "k")),
    "training_radius": Entry("m kg^1/2", (1,)),
    "points_of": Entry("1", (1,), "i"),
    "cubature_error": Entry("1", (1,)),
    "validation_error": Entry("1", (1,), optional=True),
}
PRESSURE = Entry("m^2/kg^1/2", ("k", "monomials"))
AXES: Sizes = {"axes": 3}
TRAINED = {
    "strains": Entry("1", ("Q",)),
    "smoothing_time": Entry("s", (1,)),
    "accelerations": Entry("m/s^2", ("axes",), optional=True),
    "angular_accelerations": Entry("rad/s^2", ("axes",), optional=True),
    "spins": Entry("rad/s", ("axes",), optional=True),
}
TRAINED_LOADS = {"inputs": Entry("unit of the input", (1,)), "pushes": Entry("N", (1,))}
TENDON = {"points": Entry("m", ("K", 3)), "shapes": Entry("kg^-1/2", ("3K", "k"))}
BAR = {"points": Entry("m", (2, 3)), "shapes": Entry("kg^-1/2", (6, "k"))}
RIM = {
    "points": Entry("m", ("G", 3)),
    "pieces": Entry("m", ("G", 3)),
    "shapes": Entry("kg^-1/2", ("3G", "k")),
    "piece_shapes": Entry("kg^-1/2", ("3G", "k")),
}


def put_deformation(h5: h5py.File, body: ReducedDeformation) -> None:
    """Writes the group."""
    group = h5.create_group("deformation", track_order=True)
    put_text(group, law=body.law)
    sizes: Sizes = {"k": body.order}
    put_arrays(group, BODY, sizes, vars(body))
    put_each(group, "pressures", PRESSURE, body.pressures, sizes)
    for kind, table in (("tendons", TENDON), ("bars", BAR), ("rims", RIM)):
        if kind == "tendons" or getattr(body, kind):
            parts = group.create_group(kind, track_order=True)
            for name, part in getattr(body, kind).items():
                put_arrays(parts.create_group(name, track_order=True), table, {"k": body.order}, vars(part))
    put_fibres(group, body.fibres)
    if body.trained is not None:
        trained = group.create_group("trained", track_order=True)
        put_arrays(trained, TRAINED, sizes | AXES, vars(body.trained))
        for kind, entry in TRAINED_LOADS.items():
            put_each(trained, kind, entry, getattr(body.trained, kind))


def get_deformation(h5: h5py.File, order: int) -> ReducedDeformation:
    """Reads the group, of so many vectors that strain."""
    group = get_group(h5, "deformation")
    sizes: Sizes = {"k": order}
    body = get_record(group, BODY, sizes, ("pressures", "tendons", "bars", "rims", "trained", "fibres"))

    def parts(kind: str, table: dict[str, Entry]) -> dict[str, Any]:
        each = get_group(group, kind) if kind == "tendons" or kind in group else {}
        return {name: get_record(get_group(each, name), table, {"k": order}) for name in each}

    return ReducedDeformation(
        law=get_text(group, "law"),
        **body,
        pressures=get_each(get_group(group, "pressures"), PRESSURE, sizes),
        tendons={name: ReducedTendon(**cable) for name, cable in parts("tendons", TENDON).items()},
        bars={name: ReducedBar(**bar) for name, bar in parts("bars", BAR).items()},
        rims={name: ReducedRim(**rim) for name, rim in parts("rims", RIM).items()},
        trained=_get_trained(get_group(group, "trained"), sizes) if "trained" in group else None,
        fibres=get_fibres(group),
    )


def _get_trained(group: h5py.Group, sizes: Sizes) -> TrainingRange:
    largest: Any = {kind: get_each(get_group(group, kind), entry) for kind, entry in TRAINED_LOADS.items()}
    return TrainingRange(**largest, **get_record(group, TRAINED, sizes | AXES, tuple(TRAINED_LOADS)))
