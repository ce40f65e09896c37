"""State spaces of all contact modes, and the maps between them, for NumPy (.npz) and MATLAB (.mat)."""

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fenics_rom.deployment.identifiers import identifiers
from fenics_rom.deployment.linear_models import linear_models
from fenics_rom.errors import MissingPackageError
from fenics_rom.io.atomic_write import write_whole
from fenics_rom.rom.rom import Rom


def write_matrices(place: Path, rom: Rom, outputs: Sequence[str] | None, dt: float | None, at: Any = None) -> None:
    """Writes A, B, C, D, the names and the units of every contact mode, and the maps to the others.

    Of a body that is not linear those about a state (`at`, as of `Rom.state_space`), and where that is: `about`.

    In a .npz file under names like `tip_left/A` and `tip_left/switch_to/middle`, in a .mat file as the struct `plant`
    with fields like `plant.tip_left.A`.

    Raises:
        StepError, StructureError: as `Rom.state_space`.
        FileError: the file cannot be written, or two contact modes would have one name in it.
        MissingPackageError: a .mat file, and SciPy is not installed.
    """
    plant: dict[str, dict[str, Any]] = {}
    models = linear_models(rom, outputs, dt, at)
    names = identifiers("contact mode", models)
    for contact, name in names.items():
        model = models[contact]
        plant[name] = dict(zip("ABCD", model, strict=True)) | {"dt": model.dt}
        for what in ("states", "inputs", "outputs"):
            labels = getattr(model, what)
            plant[name] |= {what: list(labels), f"{what[:-1]}_units": list(labels.values())}
        if model.about is not None:
            plant[name]["about"] = model.about._asdict()
            continue
        plant[name]["switch_to"] = {names[other]: rom.switch_map(contact, other) for other in names if other != contact}
    stream = io.BytesIO()
    if place.suffix == ".npz":
        np.savez(stream, **_flat(plant))
    else:
        try:
            from scipy.io import savemat
        except ModuleNotFoundError as error:
            cure = 'pip install "fenics-rom[offline]"'
            raise MissingPackageError(f"{place}: MATLAB's files need scipy, which this Python lacks: {cure}") from error
        savemat(stream, _cells({"plant": plant}), long_field_names=True, oned_as="column")
    write_whole(place, stream.getbuffer())


def _flat(nested: dict[str, Any]) -> dict[str, Any]:
    """Parts of parts as `part/part`."""
    flat: dict[str, Any] = {}
    for name, part in nested.items():
        parts = _flat(part) if isinstance(part, dict) else {"": part}
        flat |= {f"{name}/{key}" if key else name: value for key, value in parts.items()}
    return flat


def _cells(part: Any) -> Any:
    """Lists of texts as MATLAB's cell arrays, in all parts."""
    if isinstance(part, dict):
        return {name: _cells(each) for name, each in part.items()}
    return np.array(part, dtype=object) if isinstance(part, list) else part
