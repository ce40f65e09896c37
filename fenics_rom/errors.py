"""The errors a caller can meet. Each says what was wrong, where, what was given and what is allowed."""

from collections.abc import Iterable
from typing import Any


class FenicsRomError(Exception):
    """Base of everything that this package raises on purpose."""


class SceneError(FenicsRomError):
    """A scene file, or a choice made in it, cannot be used."""


class MeshError(FenicsRomError):
    """A mesh cannot be read, or lacks what the scene names."""


class SolverError(FenicsRomError):
    """A factorisation, eigensolver or Lyapunov solver did not deliver."""


class StructureError(FenicsRomError):
    """Matrices or reduced models lack the structure the mathematics needs (symmetry, definiteness, shape)."""


class FileError(FenicsRomError):
    """A file or folder cannot be read or written, or is not what it says."""


class RomFileError(FileError):
    """A ROM file is missing, damaged, of another format, or its parts do not fit each other."""


class TrajectoryFileError(FileError):
    """A run file is missing, damaged, of another format, or its parts do not fit each other."""


class DataError(FenicsRomError):
    """A file of measurements, or a cell of it, cannot be used."""


class StepError(FenicsRomError):
    """A step or a switch was asked for that cannot be taken; the state is as it was."""


class CompareError(FenicsRomError):
    """Two runs have nothing in common that could be compared."""


class MissingPackageError(FenicsRomError):
    """A package that this task needs is not installed; the message says how to get it."""


class FenicsRomWarning(UserWarning):
    """The result is usable, but not quite what was asked for; the message says what was done instead."""


class ToleranceWarning(FenicsRomWarning):
    """A run is further off than it was allowed to be: told at that moment, also by commands."""


def unknown(kind: str, given: str, allowed: Iterable[str]) -> str:
    """Sentence about a name that does not exist: what was given, what there is, the nearest."""
    names = sorted(allowed)
    return f"no {kind} {shown(given)}; there is {', '.join(names) if names else 'none'}{did_you_mean(given, names)}"


def check_known(kind: str, given: str, allowed: Iterable[str], error: type[FenicsRomError], where: str = "") -> None:
    """Raises an error, in which what is `where` stands first, of a name that does not exist."""
    names = list(allowed)
    if not isinstance(given, str) or given not in names:
        raise error(f"{where}{unknown(kind, given, names)}")


def check_type(where: str, given: Any, allowed: type, made_by: str) -> None:
    """Raises SceneError of something else than one allows `where` it was given, with what makes one."""
    if not isinstance(given, allowed):
        raise SceneError(
            f"{where}: something of type {type(given).__name__} was given; use a {allowed.__name__}, as of {made_by}"
        )


def did_you_mean(given: str, names: Iterable[str]) -> str:
    """The end of a sentence about a name that does not exist: the nearest that does."""
    import difflib  # here, as of no use to a program that makes no mistake: every import delays the runtime's start

    near = difflib.get_close_matches(str(given), list(names), n=1)
    return f"; did you mean {near[0]!r}?" if near else ""


def exactly(number: float) -> str:
    """A number in six digits where these say it, else in all that it has."""
    return f"{number:g}" if float(f"{number:g}") == number else repr(float(number))


def shown(value: Any) -> str:
    """A value as a short text in one line."""
    try:
        text = " ".join(repr(value).split())
    except ValueError:  # Python does not print whole numbers of thousands of digits
        text = "a number with thousands of digits"
    return text if len(text) <= 80 else f"{text[:76]} ..."
