"""Matplotlib, where it is installed; its figures need no screen."""

from typing import Any

from fenics_rom.errors import MissingPackageError


def figure_class() -> Any:
    """The class of figures; worth asking for before long work.

    Raises:
        MissingPackageError: there is no Matplotlib.
    """
    try:
        from matplotlib.figure import Figure
    except ModuleNotFoundError as error:
        raise MissingPackageError("pictures need Matplotlib: pip install fenics-rom[plot]") from error
    return Figure
