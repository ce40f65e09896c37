"""The text of a scene with other numbers in it, comments and order kept."""

import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import tomlkit

from fenics_rom.identification.result import Identification

Keys = tuple[str | int, ...]


def identified_text(result: Identification, folder: Path) -> str:
    """The scene file with the values that were found, for a file in `folder`: paths in it are relative to that."""
    document = tomlkit.parse(result.scene.text)
    for estimate in result.found:
        replace_value(document, estimate.parameter.path, tomlkit.value(f"{estimate.value:.8g}"))
    for path, file in ((("mesh", "file"), document["mesh"]["file"]), *_tables(document)):
        if not Path(file).is_absolute():
            moved = os.path.relpath(Path(result.scene.source).parent / file, folder)
            replace_value(document, path, Path(moved).as_posix())
    return tomlkit.dumps(document)


def replace_value(document: Any, path: Keys, value: Any) -> None:
    """Gives a document another value, wherever it is written."""
    *tables, key = path
    for table in tables:
        document = document[table]
    document[key] = value


def _tables(scene: Mapping[str, Any]) -> Iterator[tuple[Keys, str]]:
    """Keys that name tables, and their names."""
    for k, load in enumerate(scene.get("run", {}).get("load", [])):
        if "table" in load:
            yield ("run", "load", k, "table"), load["table"]
    for kind in ("prescribed", "base_motion"):
        for name, effect in scene["effects"].get(kind, {}).items():
            if "table" in effect:
                yield ("effects", kind, name, "table"), effect["table"]
