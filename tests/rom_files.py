"""Files of ROMs that are changed behind their seal, what is said of them, and what ROMs answer."""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass

import h5py
import numpy as np
import pytest

from fenics_rom.errors import FileError
from fenics_rom.io.hdf5 import sealed

FREQUENCIES = 2j * np.pi * np.array([0.0, 1.0, 10.0, 100.0])


def tampered(file, change):
    """Changes the content of a file behind its seal, and seals it anew."""
    with h5py.File(file, "r+") as h5:
        change(h5)
    content = file.read_bytes()
    file.write_bytes(sealed(content) + content[512:])
    return file


def put(path, array, unit=None):
    """A change that puts an array, or a function of the array that is there, into a file."""

    def change(h5):
        kept = h5[path].attrs["unit"] if path in h5 else b"1"
        new = array(h5[path][()]) if callable(array) else array
        h5.pop(path, None)
        h5[path] = new
        h5[path].attrs["unit"] = np.bytes_(unit or kept)

    return change


def refusal(read, file):
    """What is said of a file that is none; in one line, after its name."""
    with pytest.raises(FileError) as caught:
        read(file)
    message = str(caught.value)
    assert message.startswith(f"{file}: ")
    assert "\n" not in message
    return message.removeprefix(f"{file}: ")


def transfer(rom, name):
    """Displacement of the outputs per unit of input, at some frequencies."""
    mode, seen = rom.contact_models[name], np.vstack(list(rom.outputs.values())) @ rom.contact_models[name].coordinates
    D = np.diag(mode.damping) if mode.damping.ndim == 1 else mode.damping
    matrices = [s * s * np.eye(mode.order) + s * D + np.diag(mode.eigenvalues) for s in FREQUENCIES]
    return np.array([seen @ np.linalg.solve(matrix, mode.inputs) for matrix in matrices])


def same(one, other):
    """Whether two records are the same to the last bit, in the same order."""
    if is_dataclass(one):
        return all(same(getattr(one, f.name), getattr(other, f.name)) for f in fields(one))
    if isinstance(one, Mapping):
        return list(one) == list(other) and all(same(one[key], other[key]) for key in one)
    if isinstance(one, tuple) and len(one) == len(other):
        return all(map(same, one, other))
    if isinstance(one, np.ndarray):
        return one.dtype == other.dtype and np.array_equal(one, other)
    return one == other


def says(**texts):
    """A change of what a file says of itself."""
    return lambda h5: h5.attrs.update({name: np.bytes_(text) for name, text in texts.items()})


def without(path):
    return lambda h5: h5.pop(path)
