"""Large deformation in a ROM file: the group `deformation`, described in rom_file."""

from typing import Any

import h5py

from fenics_rom.io.hdf5 import Entry, Sizes, get_each, get_group, get_record, get_text, put_arrays, put_each, put_text
from fenics_rom.rom.deformation import ReducedDeformation, ReducedTendon, TrainingRange

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
TRAINED = {"strains": Entry("1", ("Q",)), "smoothing_time": Entry("s", (1,))}
TRAINED_LOADS = {"inputs": Entry("unit of the input", (1,)), "pushes": Entry("N", (1,))}
TENDON = {"points": Entry("m", ("K", 3)), "shapes": Entry("kg^-1/2", ("3K", "k"))}


def put_deformation(h5: h5py.File, body: ReducedDeformation, sizes: Sizes) -> None:
    """Writes the group."""
    group = h5.create_group("deformation", track_order=True)
    put_text(group, law=body.law)
    sizes = {"k": sizes["k"]}
    put_arrays(group, BODY, sizes, vars(body))
    put_each(group, "pressures", PRESSURE, body.pressures, sizes)
    tendons = group.create_group("tendons", track_order=True)
    for name, tendon in body.tendons.items():
        put_arrays(tendons.create_group(name, track_order=True), TENDON, {"k": sizes["k"]}, vars(tendon))
    if body.trained is not None:
        trained = group.create_group("trained", track_order=True)
        put_arrays(trained, TRAINED, sizes, vars(body.trained))
        for kind, entry in TRAINED_LOADS.items():
            put_each(trained, kind, entry, getattr(body.trained, kind))


def get_deformation(h5: h5py.File, sizes: Sizes) -> ReducedDeformation:
    """Reads the group."""
    group = get_group(h5, "deformation")
    sizes = {"k": sizes["k"]}
    body = get_record(group, BODY, sizes, ("pressures", "tendons", "trained"))
    tendons = get_group(group, "tendons")
    cables = {name: get_record(get_group(tendons, name), TENDON, {"k": sizes["k"]}) for name in tendons}
    return ReducedDeformation(
        law=get_text(group, "law"),
        **body,
        pressures=get_each(get_group(group, "pressures"), PRESSURE, sizes),
        tendons={name: ReducedTendon(**cable) for name, cable in cables.items()},
        trained=_get_trained(get_group(group, "trained"), sizes) if "trained" in group else None,
    )


def _get_trained(group: h5py.Group, sizes: Sizes) -> TrainingRange:
    largest: Any = {kind: get_each(get_group(group, kind), entry) for kind, entry in TRAINED_LOADS.items()}
    return TrainingRange(**largest, **get_record(group, TRAINED, sizes, tuple(TRAINED_LOADS)))
