"""Which module measures the matrices that someone gives: the one for the package whose objects they are.

A backend is a module with a function `checked_fields(given)`, from the arguments of `System` to its fields. SciPy's is
in this folder. Modules above it, which must not be imported here, are registered by name and loaded when needed.
"""

from collections.abc import Iterable
from importlib import import_module
from typing import Any

SCIPY_BACKEND = "fenics_rom.system.user_matrices"
_registered: dict[str, str] = {}


def register_backend(package: str, module: str) -> None:
    """Lets a module check matrices that are objects of a package."""
    _registered[package] = module


def backend_of(matrices: Iterable[Any]) -> Any:
    """The registered module for the first of the matrices that has one; SciPy's where none has."""
    matrices = list(matrices)
    for package, module in _registered.items():
        if any(belongs_to(matrix, package) for matrix in matrices):
            return import_module(module)
    return import_module(SCIPY_BACKEND)


def belongs_to(value: Any, package: str) -> bool:
    """Whether it is an object of a package, which need not be installed for this."""
    return any(kind.__module__.partition(".")[0] == package for kind in type(value).__mro__)
