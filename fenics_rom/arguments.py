"""What callers give, looked at before it is used: whatever it is not is told in one sentence."""

import math
import numbers
from collections.abc import Iterable, Mapping
from os import PathLike
from pathlib import Path
from typing import Any

from fenics_rom.errors import FenicsRomError, FileError, shown

SMALLEST, GREATEST = 1e-50, 1e50  # size of a number that is not 0: what is made of some stays a number, too


def is_number(value: Any, *, whole: bool = False) -> bool:
    """Whether something is a finite real (or whole) number that a float can be; True and False are none."""
    kind: Any = numbers.Integral if whole else numbers.Real  # NumPy's numbers count, too
    try:
        return isinstance(value, kind) and not isinstance(value, bool) and math.isfinite(value)
    except (OverflowError, TypeError):  # beyond 1e308, or a time of NumPy
        return False


def check_flag(where: str, given: Any, error: type[FenicsRomError]) -> bool:
    """True or False; the error of all else."""
    if not (isinstance(given, bool) or type(given).__name__ in ("bool_", "bool")):
        raise error(f"{where} = {shown(given)}: use True or False")
    return bool(given)


def names_in(where: str, given: Any, error: type[FenicsRomError]) -> tuple[str, ...]:
    """Several names; the error of anything else than a list of them, as of a single name."""
    several = isinstance(given, Iterable) and not isinstance(given, str | bytes)
    names = tuple(given) if several else ()
    if not (several and all(isinstance(name, str) for name in names)):
        raise error(f"{where} = {shown(given)}: use a list of names")
    return names


def mapping_in(where: str, given: Any, error: type[FenicsRomError]) -> dict[str, Any]:
    """Something by names; the error of anything else. None is nothing."""
    if given is None:
        return {}
    if not isinstance(given, Mapping) or not all(isinstance(name, str) for name in given):
        raise error(f"{where} = {shown(given)}: use a dict by names")
    return dict(given)


def check_function(where: str, given: Any, error: type[FenicsRomError], allowed: str) -> None:
    """The error of what is no function."""
    if not callable(given) or isinstance(given, type):
        raise error(f"{where}: {shown(given)} was given; use a function {allowed}")


def path_in(where: str, given: Any, error: type[FenicsRomError] = FileError) -> Path:
    """The path of a file or folder; the error of what is none."""
    name = given.__fspath__() if isinstance(given, PathLike) else given
    if not isinstance(name, str):
        raise error(f"{where}: {shown(given)} was given; use the name of a file or folder")
    if "\0" in name:
        raise error(f"{where}: {shown(name)} cannot be read: use a name without NUL")
    return Path(name)
