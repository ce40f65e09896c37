"""The packages that draw, where they are installed, set up to work without a screen."""

import os
import sys
from ctypes import CDLL
from functools import cache
from importlib import import_module
from typing import Any

from fenics_rom.errors import FenicsRomError, MissingPackageError

WINDOW_VARIABLE = "VTK_DEFAULT_OPENGL_WINDOW"  # where VTK reads which kind of window to open
EGL, EGL_WINDOW = "libEGL.so.1", "vtkEGLRenderWindow"
FOR_PICTURES = (
    'pictures of bodies and files for ParaView need {name}, which this Python lacks: pip install "fenics-rom[view]"'
)
FOR_THE_LIVE_VIEW = 'the live view needs {name}, which this Python lacks: pip install "fenics-rom[live]"'


def load_package(module: str, message: str = FOR_PICTURES) -> Any:
    """A module of a package that need not be installed.

    Args:
        module: its full name.
        message: what to say where it is missing, with {name} for what is.

    Raises:
        MissingPackageError: it is not installed, or something that it needs, or cannot be loaded.
    """
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        raise MissingPackageError(message.format(name=error.name)) from error
    except ValueError as error:  # Matplotlib, of a backend that there is not
        raise MissingPackageError(f"{module} cannot be loaded: {error}; does MPLBACKEND say what there is?") from error


@cache
def pyvista_package() -> Any:
    """PyVista, which draws by VTK, and writes its files.

    On Linux VTK would ask for an X server first, and complain where there is none; EGL needs none, and no GPU either.
    dolfinx makes its symbols global, VTK would take some for its own, and abort: it is told to look at home first.

    Raises:
        MissingPackageError: it is not installed.
        FenicsRomError: somebody else has imported it after dolfinx, so that VTK would abort.
    """
    loaded = list(sys.modules)
    if {"dolfinx", "vtkmodules"} <= set(loaded) and loaded.index("dolfinx") < loaded.index("vtkmodules"):
        raise FenicsRomError(
            "PyVista was imported after dolfinx, whose symbols it takes for its own, and would end this program: "
            "import it before dolfinx, or after the first picture of fenics_rom"
        )
    if sys.platform != "linux":
        return load_package("pyvista")
    os.environ.setdefault(WINDOW_VARIABLE, EGL_WINDOW)
    os.environ.setdefault("MESA_SHADER_CACHE_DISABLE", "true")  # else Mesa writes into the home, or says it cannot
    flags = sys.getdlopenflags()
    sys.setdlopenflags(os.RTLD_NOW | os.RTLD_DEEPBIND)
    try:
        return load_package("pyvista")
    finally:
        sys.setdlopenflags(flags)


def check_window() -> None:
    """Checks that there is what VTK draws with; it would crash where there is not.

    Raises:
        MissingPackageError: there is no EGL.
    """
    if os.environ.get(WINDOW_VARIABLE) != EGL_WINDOW:
        return
    try:
        CDLL(EGL)
    except OSError as error:
        raise MissingPackageError(
            f"pictures of bodies need {EGL}, which this system lacks: sudo apt-get install libegl1"
        ) from error


def trimesh_package() -> Any:
    """trimesh, which makes the surfaces of obstacles; viser brings it."""
    load_package("trimesh.creation")
    return load_package("trimesh")


def viser_package() -> Any:
    """viser, the server of the live view; worth asking for before long work. Raises MissingPackageError."""
    return load_package("viser", FOR_THE_LIVE_VIEW)
