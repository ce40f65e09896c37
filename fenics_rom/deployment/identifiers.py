"""Names of a scene as names in code."""

import re
from collections.abc import Iterable

from fenics_rom.errors import FileError


def identifiers(kind: str, names: Iterable[str]) -> dict[str, str]:
    """What each is called in code: letters, digits and _, beginning with a letter.

    Raises:
        FileError: two would be the same.
    """
    found: dict[str, str] = {}
    for name in names:
        word = re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_")
        word = word if word[:1].isalpha() else f"{kind.split()[-1]}_{word}"
        for other, taken in found.items():
            if word.lower() == taken.lower():
                raise FileError(
                    f"{kind}s {other!r} and {name!r} would both be called {word} in code: rename one of them"
                )
        found[name] = word
    return found


def check_identifier(name: str, where: str) -> None:
    """Checks that a name can be one in C; FileError where it cannot, which begins with `where`."""
    if not re.fullmatch("[A-Za-z][A-Za-z0-9_]*", name):
        raise FileError(
            f"{where}: {name!r} becomes a name in C: use letters, digits and _, and a letter at the beginning"
        )
