"""The packages that draw, where they are installed, set up to work without a screen."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from ctypes import CDLL
from importlib import import_module
from importlib.util import find_spec
from typing import Any

from fenics_rom.errors import MissingPackageError

WINDOW_VARIABLE = "VTK_DEFAULT_OPENGL_WINDOW"  # where VTK reads which kind of window to open
EGL, EGL_WINDOW = "libEGL.so.1", "vtkEGLRenderWindow"
FOR_PICTURES = (
    "pictures of bodies and files for ParaView need {name}, which this Python lacks: pip install fenics-rom[view]"
)
FOR_THE_LIVE_VIEW = "the live view needs {name}, which this Python lacks: pip install fenics-rom[view]"


def load_package(module: str, message: str) -> Any:
    """A module of a package that need not be installed.

    Args:
        module: its full name.
        message: what to say where it is missing, with {name} for what is.

    Raises:
        MissingPackageError: it is not installed, or something that it needs.
    """
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        raise MissingPackageError(message.format(name=error.name)) from error


def pyvista_package() -> Any:
    """PyVista, which draws by VTK, and writes its files.

    On Linux VTK would ask for an X server first, and complain where there is none; EGL needs none, and no GPU either.
    dolfinx 0.5 makes its symbols global, VTK would take some for its own, and crash: it is told to look at home first.

    Raises:
        MissingPackageError: it is not installed.
    """
    if sys.platform == "linux":
        os.environ.setdefault(WINDOW_VARIABLE, EGL_WINDOW)
        os.environ.setdefault("MESA_SHADER_CACHE_DISABLE", "true")  # else Mesa writes into the home, or says it cannot
    with _preferring_own_symbols():
        return load_package("pyvista", FOR_PICTURES)


@contextmanager
def _preferring_own_symbols() -> Iterator[None]:
    """Libraries that are loaded meanwhile prefer their own symbols to those of the same name that are global."""
    if sys.platform != "linux":
        yield
        return
    flags = sys.getdlopenflags()
    sys.setdlopenflags(os.RTLD_NOW | os.RTLD_DEEPBIND)
    try:
        yield
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


def imageio_package() -> Any:
    """imageio, which writes films by an encoder that it brings.

    Raises:
        MissingPackageError: it, or its encoder, is not installed.
    """
    imageio = load_package("imageio.v2", FOR_PICTURES)
    if find_spec("imageio_ffmpeg") is None:
        raise MissingPackageError(FOR_PICTURES.format(name="imageio_ffmpeg"))
    return imageio


def pillow_package() -> Any:
    """Pillow's module for pictures; PyVista brings it.

    Raises:
        MissingPackageError: it is not installed.
    """
    return load_package("PIL.Image", FOR_PICTURES)


def trimesh_package() -> Any:
    """trimesh, which makes the surfaces of obstacles and finds points on that of a body; viser brings it.

    Raises:
        MissingPackageError: it is not installed.
    """
    load_package("trimesh.creation", FOR_PICTURES)
    return load_package("trimesh", FOR_PICTURES)


def viser_package() -> Any:
    """viser, the server of the live view; worth asking for before long work.

    Raises:
        MissingPackageError: it is not installed.
    """
    return load_package("viser", FOR_THE_LIVE_VIEW)
