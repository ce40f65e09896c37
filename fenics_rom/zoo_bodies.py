"""The zoo: bodies that are reduced already, in a distribution of their own, `fenics-rom-zoo`."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path

from fenics_rom.errors import FileError, MissingPackageError, check_known
from fenics_rom.rom.file import read_rom
from fenics_rom.rom.rom import Rom

PACKAGE, CATALOGUE = "fenics_rom_zoo", "catalogue.json"
PREFIX = "zoo:"  # of a word on the command line that stands for a body's file


@dataclass(frozen=True, kw_only=True)
class ZooBody:
    """A body of the zoo.

    Attributes:
        title, use: what it is, and what it is good for.
        source: where its geometry and its numbers are from.
        licence: of its files.
        unknowns: of the full order that the ROM is of.
        order: of the ROM, that of its largest contact model.
        run: the load history of the scene, in words, over which errors were measured.
        errors: against full order on the same mesh with the same steps, as shares of it. `static`: shapes at rest under
            each input, in the mass norm, of linear bodies. Over the run: `shape`, the whole shape in the mass norm;
            `outputs`, the worst of them; `force`, the worst of the obstacles' forces.
        rom, scene: their files; the scene runs at full order where FEniCSx is.
        world: the file of a world with the body, if it has one.

    Example:
        >>> body = fr.zoo()["plate"]
        >>> isinstance(body, fr.ZooBody), body.unknowns, body.errors["shape"] < 1e-4
        (True, 180, True)
    """

    title: str
    use: str
    source: str
    licence: str
    unknowns: int
    order: int
    run: str
    errors: Mapping[str, float] = field(repr=False)
    rom: Path
    scene: Path
    world: Path | None = None


def zoo() -> dict[str, ZooBody]:
    """The bodies of the zoo by name, with what is known of each.

    Raises:
        MissingPackageError: the zoo is not installed.
        FileError: its catalogue cannot be read.

    Example:
        >>> fr.zoo()["plate"].order
        20
    """
    try:
        package = import_module(PACKAGE)
    except ModuleNotFoundError as error:
        raise MissingPackageError(
            "the zoo is a package of its own, which this Python lacks: pip install fenics-rom-zoo"
        ) from error
    folder = Path(str(package.__file__)).parent
    try:
        catalogue = json.loads((folder / CATALOGUE).read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise FileError(f"{folder / CATALOGUE}: cannot be read: {error}") from error
    return {name: _body(folder, told) for name, told in catalogue.items()}


def load(name: str) -> Rom:
    """The ROM of a body of the zoo, which needs `pip install fenics-rom-zoo`, and no FEniCSx.

    Args:
        name: of the body; `fr.zoo()` tells of all.

    Raises:
        FileError: there is no such body.
        MissingPackageError: the zoo is not installed.

    Example:
        >>> fr.load("plate").name
        'plate'
    """
    return read_rom(_found(name).rom)


def rom_file(word: str) -> str:
    """The file that a word of the command line means: the ROM of a body of the zoo, or the word as it is."""
    return str(_found(word.removeprefix(PREFIX)).rom) if word.startswith(PREFIX) else word


def model_file(word: str) -> str:
    """As `rom_file`, but the world of a body that has one."""
    if not word.startswith(PREFIX):
        return word
    body = _found(word.removeprefix(PREFIX))
    return str(body.world or body.rom)


def _found(name: str) -> ZooBody:
    bodies = zoo()
    check_known("body of the zoo", name, bodies, FileError)
    return bodies[name]


def _body(folder: Path, told: Mapping[str, object]) -> ZooBody:
    files = {key: folder / str(told[key]) for key in ("rom", "scene", "world") if key in told}
    return ZooBody(**{**told, **files})  # type: ignore[arg-type]
