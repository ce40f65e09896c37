"""Matplotlib, where it is installed; its figures need no screen."""

import io
from pathlib import Path
from typing import Any

from fenics_rom.io.atomic_write import write_whole
from fenics_rom.visualization.optional_dependencies import load_package


def figure_class() -> Any:
    """The class of figures; worth asking for before long work.

    Raises:
        MissingPackageError: there is no Matplotlib.
    """
    return load_package("matplotlib.figure", "pictures need Matplotlib: pip install fenics-rom[plot]").Figure


def write_figure(figure: Any, file: Path, dpi: int) -> None:
    """Writes a picture in the format of its name's ending, or nothing.

    Raises:
        FileError: it cannot be written.
    """
    picture = io.BytesIO()
    figure.savefig(picture, format=file.suffix[1:], dpi=dpi)
    write_whole(file, picture.getvalue())
