"""The reference of the scene file, made from its records: `python -m fenics_rom.scene.reference > README.md` here."""

import json
from collections.abc import Mapping
from dataclasses import MISSING, Field, fields, is_dataclass
from inspect import cleandoc
from pathlib import Path
from typing import Any, get_args, get_origin

from fenics_rom.io.markdown import markdown
from fenics_rom.scene.effect_table import table_of_effects
from fenics_rom.scene.file_format import SceneFile
from fenics_rom.scene.places import CellPlace, Place
from fenics_rom.scene.values import (
    Items,
    Number,
    PoseTable,
    SurfaceFile,
    Table,
    Text,
    Value,
    allowed_in,
    default_of,
    extras_in,
    keys_of,
    part_of,
    type_in,
    value_in,
)
from fenics_rom.scene.world_format import WorldFile

EXAMPLE = Path(__file__).with_name("example.toml")
INTRODUCTION = Path(__file__).with_name("introduction.txt")
WORLD_EXAMPLE = Path(__file__).with_name("world_example.toml")
FILES: dict[Any, str] = {SceneFile: "The file", WorldFile: "The world file"}
PLACES: dict[Any, str] = {Place: "A place", CellPlace: "A place of cells"}  # described once, whatever has their keys
WORLDS = """# Worlds: several bodies

A file with `[bodies.NAME]` is a world: rigid and soft bodies that touch one another. `fenics-rom simulate` runs it,
and `plot`, `view` and `export` show the run as they do that of one body. Soft bodies come from ROMs whose scenes have
`[effects.contact]`; what acts on such a body in its scene, but for obstacles, acts here, too.
"""


def reference() -> str:
    """The page, in Markdown."""
    effects = markdown(("effect", "force", "parameters", "energy"), table_of_effects())
    sections, worlds = ([_section(*each) for each in _records(file).items()] for file in FILES)
    example = f"## A complete example\n\n```toml\n{EXAMPLE.read_text().strip()}\n```\n"
    world = f"{WORLDS}\n```toml\n{WORLD_EXAMPLE.read_text().strip()}\n```\n"
    return "\n".join([INTRODUCTION.read_text(), f"## Effects\n\n{effects}", *sections, example, world, *worlds])


def _records(file: Any) -> dict[Any, list[str]]:
    """All records of a file, with the places in it where they are."""
    records: dict[Any, list[str]] = {file: [FILES[file]]}

    def collect(record: Any, path: str) -> None:
        place = _place_of(record)
        if place is not None and place not in records:
            records[place] = [PLACES[place]]
            collect(place, "")
        inherited = {} if place in (None, record) else keys_of(place)
        for key, annotation in keys_of(record).items():
            if key in inherited:
                continue
            name = f"{path}.{key}" if path else key
            form, brackets = _table_in(annotation), "[{}]"
            if get_origin(type_in(annotation)) is tuple:
                brackets = "[[{}]]"
            elif get_origin(type_in(annotation)) is Mapping:
                name += ".NAME"
            if form is not None and keys_of(form):
                of_place = f"`{key}` of {PLACES[record].lower()}" if record in PLACES else ""
                records.setdefault(form, []).append(of_place or f"`{brackets.format(name)}`")
                collect(form, name)

    collect(file, "")
    return records


def _place_of(record: Any) -> Any:
    """The kind of place whose keys a record has; None of others."""
    return next((place for place in PLACES if issubclass(record, place)), None)


def _table_in(annotation: Any) -> Any:
    """The record of a table, or of each table in a list or under a name; None of other values."""
    kind = type_in(annotation)
    if get_origin(kind) in (tuple, Mapping):
        return _table_in(get_args(kind)[-1 if get_origin(kind) is Mapping else 0])
    return kind if is_dataclass(kind) and value_in(annotation) is None else None


def _section(record: Any, places: list[str]) -> str:
    """What a record is, where it is, and its keys."""
    first, *others = places
    text = " ".join(cleandoc(record.__doc__).split("\n\n"))
    if others:
        text += f" The same: {', '.join(others)}."
    annotations, place = keys_of(record), _place_of(record)
    inherited = {} if place in (None, record) else keys_of(place)
    rows = [_row(field, annotations[field.name]) for field in fields(record) if field.name not in inherited]
    if inherited:
        anchor = PLACES[place].lower().replace(" ", "-")
        rows.insert(0, (f"keys of [{PLACES[place].lower()}](#{anchor})", "one of them", "-", "-", "where"))
    return f"## {first}\n\n{text}\n\n{markdown(('key', 'value', 'unit', 'default', 'meaning'), rows)}"


def _row(field: Field, annotation: Any) -> tuple[str, str, str, str, str]:
    default = default_of(field)
    shown = "required" if default is MISSING else "-"
    if isinstance(default, str | int | float):
        shown = f"`{json.dumps(default)}`"
    meanings = [extra for extra in extras_in(annotation) if isinstance(extra, str)]
    meaning = meanings[0] if meanings else _table_in(annotation).__doc__.split("\n")[0].rstrip(".")
    return f"`{field.name}`", _words(annotation), _unit(annotation), shown, meaning


def _words(annotation: Any) -> str:
    """What a key may hold, without its unit."""
    value = value_in(annotation)
    if value is None:
        if get_origin(type_in(annotation)) is not Mapping:
            return "a table"
        return f"for each name {_words(part_of(annotation, 'NAME'))}"
    if isinstance(value, Items):
        return f"{value.allowed}, each {_words(part_of(annotation, 0))}"
    return _scalar_words(value) or allowed_in(annotation)


def _scalar_words(value: Value) -> str:
    if isinstance(value, Number):
        return value.allowed.removesuffix(f", in {value.unit}")
    if isinstance(value, Table | PoseTable):
        return "path of a CSV file"
    if isinstance(value, SurfaceFile):
        return "path of a file"
    if isinstance(value, Text):
        return ", ".join(f'`"{choice}"`' for choice in value.choices) or "text"
    return ""


def _unit(annotation: Any) -> str:
    """The unit of a number, or of those in a list."""
    value = value_in(annotation)
    if isinstance(value, Items):
        return _unit(part_of(annotation, 0))
    return value.unit or "-" if isinstance(value, Number) else "-"


if __name__ == "__main__":
    print(reference(), end="")
