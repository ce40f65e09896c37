"""What a caller gives: an object, or the name of a file that holds one."""

from collections.abc import Callable
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

from fenics_rom.errors import SceneError

INSTEAD = {  # what makes what is wanted of what is often given, by the name of its type
    "Scene": "fr.reduce(fr.assemble(scene)) makes a Rom of a Scene, and fr.simulate(scene) a Trajectory",
    "System": "fr.reduce(system) makes a Rom of a System, and fr.simulate(system) a Trajectory",
    "Simulator": "its ROM is simulator.rom",
    "Environment": "it is a part of a Rom, rom.environment",
}


class Kind(NamedTuple):
    """Objects of one type: what a file of one is called, and what reads it."""

    type: type
    content: str
    read: Callable[[Path], Any]


def object_or_file(where: str, given: Any, *kinds: Kind) -> Any:
    """An object of one of these kinds as it is, or the one in the file of that name.

    Args:
        where: it was given, for the message.
        given: by the caller.
        kinds: what is allowed.

    Raises:
        SceneError: it is neither such an object nor a name.
        FileError: the file cannot be read, or holds something else.
    """
    if isinstance(given, tuple(kind.type for kind in kinds)):
        return given
    if isinstance(given, str | PathLike):
        from fenics_rom.io.hdf5 import content_of  # here, as few programs read files

        content = content_of(Path(given))
        kind = next((kind for kind in kinds if kind.content == content), kinds[0])  # which refuses what it is not
        return kind.read(Path(given))
    kind_given, names = type(given).__name__, " or ".join(f"a {kind.type.__name__}" for kind in kinds)
    hint = f"; {INSTEAD[kind_given]}" if kind_given in INSTEAD else ""
    raise SceneError(
        f"{where}: something of type {kind_given} was given; use {names}, or the name of a file of one{hint}"
    )
