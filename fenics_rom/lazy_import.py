"""Names that are loaded when they are used, with what to install where a package of theirs is missing."""

from importlib import import_module
from typing import Any

from fenics_rom.errors import MissingPackageError

FENICSX = (
    "dolfinx",
    "on Debian sudo apt-get install --no-install-recommends python3-dolfinx python3-gmsh libopenblas0, "
    "elsewhere conda install -c conda-forge fenics-dolfinx python-gmsh",
)
SCIPY = ("scipy", 'pip install "fenics-rom[offline]"')
PYDANTIC = ("pydantic", SCIPY[1])
FROM_PYPI = ("scipy", "pydantic", "tomlkit")  # whatever folder misses them
PACKAGE_OF_FOLDER = {
    "fem": FENICSX,
    "studies": FENICSX,
    "identification": FENICSX,
    "certification": PYDANTIC,
    "reduction": SCIPY,
    "system": SCIPY,
    "scene": PYDANTIC,
    "world_run": PYDANTIC,
}


def load(module: str, name: str) -> Any:
    """What a module of this package, such as "fem.assemble", has under a name.

    Raises:
        MissingPackageError: a package that the module needs is not installed.
    """
    needed, cure = PACKAGE_OF_FOLDER.get(module.split(".")[0], ("", ""))
    try:
        if needed == FENICSX[0]:
            import_module("h5py")  # first: PyPI's h5py, after dolfinx, would take dolfinx's HDF5 for its own
        return getattr(import_module(f"fenics_rom.{module}"), name)
    except ModuleNotFoundError as error:
        if not needed or (error.name or "").startswith("fenics_rom"):
            raise
        if error.name in FROM_PYPI:
            cure = SCIPY[1]
        raise MissingPackageError(f"fenics_rom.{name} needs {error.name}, which this Python lacks: {cure}") from error
