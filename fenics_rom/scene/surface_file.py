"""Surfaces of triangles in files: STL by NumPy, VTK and STEP by a process of their own (`foreign_file`)."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import FenicsRomError, SceneError
from fenics_rom.scene.foreign_file import read_surface_arrays

_HEADER, _RECORD = 84, np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
ENDINGS = (".stl", ".vtk", ".vtp", ".vtu", ".step", ".stp")


@dataclass(frozen=True, eq=False)
class FileTriangles:
    """What a file of a surface holds.

    Attributes:
        corners: (T, 3 corners, 3), in units of the file; of STEP, m.
    """

    corners: Array

    def __eq__(self, other: object) -> bool:
        return isinstance(other, FileTriangles) and np.array_equal(self.corners, other.corners)

    def joined(self, scale: float = 1.0) -> tuple[Array, Array]:
        """Vertices (V, 3), each once, times a scale, and triangles (T, 3) between them."""
        vertices, rows = np.unique(self.corners.reshape(-1, 3) + 0.0, axis=0, return_inverse=True)
        return scale * vertices, rows.reshape(-1, 3)


def read_surface(file: Path) -> FileTriangles:
    """The triangles of a file.

    Args:
        file: `.stl`, text or binary; `.vtk`, `.vtp` or `.vtu`, of cells of volume their surface; `.step` or `.stp`,
            whose round faces get 48 triangles around.

    Raises:
        SceneError: there is no such file, it cannot be read, or holds no triangles.
    """
    ending = file.suffix.lower()
    if ending not in ENDINGS:
        raise SceneError(f"{file}: use a file that ends in {', '.join(ENDINGS)}")
    try:
        if ending == ".stl":
            corners = _stl(file.read_bytes())
        else:
            if not file.is_file():
                raise FileNotFoundError(2, "No such file or directory")
            arrays = read_surface_arrays(file)
            corners = arrays["points"].reshape(-1, 3)[arrays["triangles"].reshape(-1, 3)]
    except OSError as error:
        raise SceneError(f"{file}: cannot be read: {error.strerror}") from error
    except (ValueError, FenicsRomError) as error:
        raise SceneError(f"{file}: {error}") from error
    if not len(corners):
        raise SceneError(f"{file}: holds no triangles")
    return FileTriangles(corners)


def _stl(content: bytes) -> Array:
    """Corners (T, 3, 3) of an STL file; ValueError of none."""
    if len(content) >= _HEADER:
        count = int.from_bytes(content[_HEADER - 4 : _HEADER], "little")
        if len(content) == _HEADER + count * _RECORD.itemsize:
            return np.frombuffer(content, _RECORD, offset=_HEADER)["corners"].astype(float)
    words = content.split()
    if words[:1] != [b"solid"]:
        raise ValueError("is no STL file, or was cut: use text, or as many triangles as its header says")
    starts = [k for k, word in enumerate(words) if word == b"vertex"]
    if len(starts) % 3 or words[-1 - len(_after_end(words)) :][:1] != [b"endsolid"]:
        raise ValueError("was cut: its text does not end with endsolid")
    try:
        return np.array([[float(word) for word in words[k + 1 : k + 4]] for k in starts]).reshape(-1, 3, 3)
    except ValueError as error:
        raise ValueError(f"has vertices that are no three numbers ({error})") from error


def _after_end(words: list[bytes]) -> list[bytes]:
    """What comes after the last endsolid: a name."""
    return [] if b"endsolid" not in words else words[len(words) - words[::-1].index(b"endsolid") :]
