"""The text of a scene with other numbers in it, comments and order kept."""

import json
import os
import re
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from fenics_rom.errors import SceneError
from fenics_rom.identification.result import Identification

NUMBER = r"[+-]?[\d_.]+(?:[eE][+-]?\d+)?"
STRING = r"\"(?:[^\"\\\n]|\\.)*\"|'[^'\n]*'"

Keys = tuple[Any, ...]


def identified_text(result: Identification, folder: Path) -> str:
    """The scene file with the values that were found, for a file in `folder`: paths in it are relative to that.

    Raises:
        SceneError: the text does not hold a value in a way that can be changed.
    """
    scene, text = result.scene, result.scene.text
    for one in result.found:
        text = _with(text, one.parameter.path, f"{one.value:.8g}", NUMBER, scene.source)
    raw = tomllib.loads(text)
    for path, file in ((("mesh", "file"), raw["mesh"]["file"]), *_tables(raw)):
        if not Path(file).is_absolute():
            text = _with(text, path, _relative(Path(scene.source).parent / file, folder), STRING, scene.source)
    return text


def _relative(file: Path, folder: Path) -> str:
    """A path from a folder, as TOML writes it."""
    return json.dumps(Path(os.path.relpath(file, folder)).as_posix(), ensure_ascii=False)


def _tables(scene: Mapping[str, Any]) -> Iterator[tuple[Keys, str]]:
    """Keys that name tables, and their names."""
    for k, load in enumerate(scene.get("run", {}).get("load", [])):
        if "table" in load:
            yield ("run", "load", k, "table"), load["table"]
    for kind in ("prescribed", "base_motion"):
        for name, one in scene["effects"].get(kind, {}).items():
            if "table" in one:
                yield ("effects", kind, name, "table"), one["table"]


def _with(text: str, path: Keys, new: str, kind: str, source: str) -> str:
    """The text with another value, which may be anywhere that TOML allows: tried at every place that looks like it."""
    wanted = tomllib.loads(text)
    holder = wanted
    for key in path[:-1]:
        holder = holder[key]
    holder[path[-1]] = tomllib.loads(f"value = {new}")["value"]
    for place in re.finditer(rf"(?<![\w-])([\"']?){re.escape(path[-1])}\1\s*=\s*(?P<value>{kind})", text):
        attempt = text[: place.start("value")] + new + text[place.end("value") :]
        try:
            if tomllib.loads(attempt) == wanted:
                return attempt
        except tomllib.TOMLDecodeError:
            continue
    raise SceneError(f"{source}: {'.'.join(map(str, path))} is written in a way that could not be changed")
