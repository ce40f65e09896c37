"""Soft bodies with changing contacts, in real time.

Reads a scene, assembles it with FEniCSx, reduces it for each contact mode, and steps the reduced models with passive
midpoint integration. Importing this package loads nothing of NumPy or FEniCSx; a name is loaded when it is used.
"""

from pathlib import Path
from typing import Any

from fenics_rom import errors as errors
from fenics_rom.rom.linearizer import register_linearizer
from fenics_rom.system.backends import register_backend
from fenics_rom.version import VERSION

__version__ = VERSION
_STUB = Path(__file__).with_suffix(".pyi").read_text("utf-8")  # where the names stand once, as in SPEC 1
MODULE_OF = {
    line.split()[3]: line.split()[1].removeprefix("fenics_rom.")
    for line in _STUB.splitlines()
    if line.startswith("from fenics_rom.")
}
__all__ = ["errors", *MODULE_OF]
register_backend("petsc4py", "fenics_rom.fem.user_matrices")  # which stands above `system`
register_linearizer("fenics_rom.runtime.linearization")  # which stands above `rom`


def __getattr__(name: str) -> Any:
    if name not in MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from fenics_rom.lazy_import import load

    globals()[name] = found = load(MODULE_OF[name], name)  # motions ask for their states in every step
    return found


def __dir__() -> list[str]:
    return sorted([*__all__, *(name for name in globals() if name.startswith("__"))])
