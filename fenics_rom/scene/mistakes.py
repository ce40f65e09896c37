"""What pydantic finds wrong with a scene file, in one sentence for whoever wrote it."""

from pydantic import ValidationError

from fenics_rom.errors import unknown
from fenics_rom.scene.file_format import SceneFile
from fenics_rom.scene.values import Refused, keys_of, part_of, refused, type_in

UNKNOWN_KEY, MISSING_KEY = "unexpected_keyword_argument", "missing"


def mistake_of(error: ValidationError) -> str:
    """The first mistake; a key that does not exist comes first, as it may be why another one is missing."""
    details = error.errors(include_url=False)
    detail = next((detail for detail in details if detail["type"] == UNKNOWN_KEY), details[0])
    *table, key = detail["loc"]
    if detail["type"] == UNKNOWN_KEY:
        record = SceneFile
        for part in table:
            record = part_of(record, part)
        return f"{_begun(table)}{unknown('key', str(key), keys_of(type_in(record)))}"
    if detail["type"] == MISSING_KEY:
        return f"{_begun(table)}{key} is missing"
    refusal = detail.get("ctx", {}).get("error")
    if not isinstance(refusal, Refused):  # all that pydantic checks by itself is whether something is a table
        refusal = refused(detail["input"], "a table")
    return f"{_path(table[:-1] if key == '[key]' else detail['loc'])}{refusal}"


def _begun(table: list[int | str]) -> str:
    """The beginning of a sentence about a table; none of the whole file."""
    return f"{_path(table)}: " if table else ""


def _path(keys: list[int | str] | tuple[int | str, ...]) -> str:
    """Keys as TOML writes them, with numbers of list items in brackets."""
    return "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in keys)[1:]
