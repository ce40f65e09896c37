"""The error model in a ROM file: the group `error_model`, absent where errors were not asked for.

eigenvalues (f,) 1/s^2, damping (f,) or (f, f) 1/s, coordinates (f, k) 1
inputs/NAME (f, p), outputs/NAME (R, f), point_inputs (f, 3P) kg^-1/2, of forces on contact points
output_compliances/NAME (R,) m/J^1/2
residual_inputs/NAME (s, p) W^1/2 per unit of the input; none where there is no bound, as then s = 0
residual_damping, residual_stiffness (s, f) s^-1/2, s^-3/2
"""

from collections.abc import Mapping
from typing import Any

import h5py
import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import FileError
from fenics_rom.io.hdf5 import Entry, Sizes, get_each, get_group, get_record, put_arrays, put_each
from fenics_rom.rom.error_model import ErrorModel
from fenics_rom.rom.rom import Rom

ARRAYS = {
    "eigenvalues": Entry("1/s^2", ("f",)),
    "coordinates": Entry("1", ("f", "k")),
    "residual_damping": Entry("s^-1/2", ("s", "f")),
    "residual_stiffness": Entry("s^-3/2", ("s", "f")),
    "point_inputs": Entry("kg^-1/2", ("f", "3P"), optional=True),
}
GROUPS = {
    "inputs": Entry("kg^-1/2", ("f", "p")),
    "residual_inputs": Entry("W^1/2 per unit of the input", ("s", "p")),
    "outputs": Entry("kg^-1/2", ("R", "f")),
    "output_compliances": Entry("m/J^1/2", ("R",)),
}
ORTHONORMALITY = 1e-8  # largest accepted |SᵀS - I|


def put_error_model(h5: h5py.File, rom: Rom) -> None:
    """Writes the group; FileError where it does not fit the ROM."""
    model = rom.error_model
    assert model is not None
    _check_fit(rom, model)
    group, sizes = h5.create_group("error_model", track_order=True), Sizes()
    put_arrays(group, _table(model.damping.ndim == 2), sizes, vars(model))
    for kind, entry in GROUPS.items():
        put_each(group, kind, entry, getattr(model, kind), sizes)


def take_error_model(h5: h5py.File, rom: Rom) -> ErrorModel:
    """Reads the group; FileError where it does not fit the ROM."""
    group, sizes = get_group(h5, "error_model"), Sizes()
    damping = group.get("damping")
    arrays = get_record(group, _table(getattr(damping, "ndim", 1) == 2), sizes, tuple(GROUPS))
    named: dict[str, Any] = {kind: get_each(get_group(group, kind), entry, sizes) for kind, entry in GROUPS.items()}
    model = ErrorModel(**arrays, **named)
    _check_fit(rom, model)
    return model


def _check_fit(rom: Rom, model: ErrorModel) -> None:
    if mistake := _mistake(rom, model):
        raise FileError(f"/error_model: {mistake}")


def _mistake(rom: Rom, model: ErrorModel) -> str:
    """What does not fit a ROM; empty where all does."""
    k, s, f, γ = len(rom.stiffness), len(model.residual_damping), len(model.eigenvalues), model.eigenvalues
    bounded = model.has_bound
    widths = {name: mode.inputs.shape[1] for name, mode in rom.contact_models.items()}
    rows = {name: len(of) for name, of in rom.outputs.items()}
    shapes: list[tuple[str, Any, Any]] = [
        ("coordinates", model.coordinates.shape, (f, k)),
        ("residual_damping", model.residual_damping.shape, (s, f)),
        ("residual_stiffness", model.residual_stiffness.shape, (s, f)),
        ("inputs", _shapes(model.inputs), {name: (f, p) for name, p in widths.items()}),
        ("residual_inputs", _shapes(model.residual_inputs), {name: (s, p) for name, p in widths.items() if bounded}),
        ("outputs", _shapes(model.outputs), {name: (count, f) for name, count in rows.items()}),
        ("output_compliances", _shapes(model.output_compliances), {name: (count,) for name, count in rows.items()}),
    ]
    for name, given, allowed in shapes:
        if given != allowed:
            return f"{name} of shape {given}: use {allowed}"
    if (γ < 0).any() or np.count_nonzero(γ == 0) != rom.rigid or γ[: rom.rigid].any():
        return f"eigenvalues do not begin with those of {rom.rigid} rigid motions alone"
    gap = np.abs(model.coordinates.T @ model.coordinates - np.eye(k)).max()
    return "" if gap <= ORTHONORMALITY else f"coordinates are not orthonormal: off by {gap:.1e}"


def _shapes(arrays: Mapping[str, Array]) -> dict[str, tuple[int, ...]]:
    return {name: part.shape for name, part in arrays.items()}


def _table(dense: bool) -> dict[str, Entry]:
    return {**ARRAYS, "damping": Entry("1/s", ("f", "f") if dense else ("f",))}
