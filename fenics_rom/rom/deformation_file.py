"""Large deformation in a ROM file: the group `deformation`, described in rom_file."""

from typing import Any

import h5py
import numpy as np

from fenics_rom.io.hdf5 import Entry, Sizes, get_arrays, get_group, get_text, put_arrays, put_text
from fenics_rom.rom.deformation import ReducedDeformation, ReducedTendon, TrainingRange

Array = np.ndarray

BODY = {
    "gradients": Entry("kg^-1/2/m", (3, 3, "Q", "k")),
    "weights": Entry("m^3", ("Q",)),
    "first_lame": Entry("Pa", ("Q",)),
    "shear": Entry("Pa", ("Q",)),
    "viscosity": Entry("s", ("Q",)),
    "external_damping": Entry("1/s", ("k", "k")),
    "springs": Entry("1/s^2", ("k", "k")),
}
NUMBERS = {
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
    put_arrays(group, BODY, sizes, {name: getattr(body, name) for name in BODY})
    numbers = {name: getattr(body, name) for name in NUMBERS}
    put_arrays(group, NUMBERS, sizes, {name: n if n is None else np.array([n]) for name, n in numbers.items()})
    pressures, tendons = (group.create_group(name, track_order=True) for name in ("pressures", "tendons"))
    put_arrays(pressures, dict.fromkeys(body.pressures, PRESSURE), sizes, body.pressures)
    for name, tendon in body.tendons.items():
        put_arrays(tendons.create_group(name, track_order=True), TENDON, {"k": sizes["k"]}, vars(tendon))
    if body.trained is not None:
        trained = group.create_group("trained", track_order=True)
        numbers = {"strains": body.trained.strains, "smoothing_time": np.array([body.trained.smoothing_time])}
        put_arrays(trained, TRAINED, sizes, numbers)
        for kind, entry in TRAINED_LOADS.items():
            largest = {name: np.array([value]) for name, value in getattr(body.trained, kind).items()}
            put_arrays(trained.create_group(kind, track_order=True), dict.fromkeys(largest, entry), {}, largest)


def get_deformation(h5: h5py.File, sizes: Sizes) -> ReducedDeformation:
    """Reads the group."""
    group = get_group(h5, "deformation")
    sizes = {"k": sizes["k"]}
    arrays: Any = get_arrays(group, BODY | NUMBERS, sizes, ("pressures", "tendons", "trained"))
    pressures, tendons = get_group(group, "pressures"), get_group(group, "tendons")
    forces: Any = get_arrays(pressures, dict.fromkeys(pressures, PRESSURE), sizes)
    cables: Any = {name: get_arrays(get_group(tendons, name), TENDON, {"k": sizes["k"]}) for name in tendons}
    numbers: Any = {name: None if arrays[name] is None else arrays[name][0].item() for name in NUMBERS}
    return ReducedDeformation(
        law=get_text(group, "law"),
        **{name: arrays[name] for name in BODY},
        **numbers,
        pressures=forces,
        tendons={name: ReducedTendon(**cable) for name, cable in cables.items()},
        trained=_get_trained(get_group(group, "trained"), sizes) if "trained" in group else None,
    )


def _get_trained(group: h5py.Group, sizes: Sizes) -> TrainingRange:
    arrays: Any = get_arrays(group, TRAINED, sizes, tuple(TRAINED_LOADS))
    largest: Any = {
        kind: get_arrays(get_group(group, kind), dict.fromkeys(group[kind], entry), {})
        for kind, entry in TRAINED_LOADS.items()
    }
    numbers = {kind: {name: float(value[0]) for name, value in loads.items()} for kind, loads in largest.items()}
    return TrainingRange(**numbers, strains=arrays["strains"], smoothing_time=float(arrays["smoothing_time"][0]))
