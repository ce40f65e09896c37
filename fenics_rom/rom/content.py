"""Records that are compared, and hashed, by what they hold, and whose arrays are read-only."""

import hashlib
from collections.abc import Iterator, Mapping
from copy import copy
from dataclasses import fields, is_dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from typing import Self


class ByContent:
    """A frozen dataclass (`eq=False`) that equals whatever holds the same numbers, names and texts.

    Equal is equal to the bit, but for the width of numbers: what a file gives back is what was written.
    """

    def __post_init__(self) -> None:
        for each in fields(self):  # type: ignore[arg-type]
            object.__setattr__(self, each.name, _read_only(getattr(self, each.name)))

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update({name: _read_only(value) for name, value in state.items()})  # a pickle forgets it

    def __deepcopy__(self, memo: object) -> "Self":
        return self  # nothing in it can change

    @cached_property
    def _digest(self) -> bytes:
        return digest_of({each.name: getattr(self, each.name) for each in fields(self)})  # type: ignore[arg-type]

    def __eq__(self, other: object) -> bool:
        if self is other:
            return True
        return self._digest == other._digest if type(other) is type(self) else NotImplemented

    def __hash__(self) -> int:
        return hash(self._digest)


def digest_of(content: Mapping[str, Any]) -> bytes:
    """The same 32 bytes for the same numbers, names and texts, also of records."""
    sha = hashlib.sha256()
    for part in _parts(content):
        sha.update(part)
    return sha.digest()


def _read_only(value: Any) -> Any:
    """The same with arrays, also within other records, that refuse to be written to; whoever made them may go on."""
    if isinstance(value, np.ndarray) and value.flags.writeable:
        value = value.view()
        value.setflags(write=False)
    elif type(value) is dict:
        return {name: _read_only(part) for name, part in value.items()}
    elif type(value) is tuple:
        return tuple(map(_read_only, value))
    elif is_dataclass(value) and not isinstance(value, ByContent):
        value = copy(value)
        for each in fields(value):
            object.__setattr__(value, each.name, _read_only(getattr(value, each.name)))
    return value


def _parts(value: Any) -> Iterator[bytes]:
    """Bytes that are the same for what is equal; each kind begins with a letter of its own, and says its size."""
    if isinstance(value, ByContent):
        yield b"r" + value._digest
    elif isinstance(value, np.ndarray | np.generic | float | int):
        array = np.asarray(value)
        array = array.astype(float if array.dtype.kind == "f" else np.int64)
        yield f"n{array.shape}{array.dtype.kind}".encode()
        yield array.tobytes()
    elif isinstance(value, Mapping):
        yield f"m{len(value)}".encode()
        for name, part in value.items():
            yield from _parts(name)
            yield from _parts(part)
    elif isinstance(value, tuple | list):
        yield f"t{len(value)}".encode()
        for part in value:
            yield from _parts(part)
    elif is_dataclass(value):
        yield f"d{type(value).__name__}".encode()
        yield from _parts({each.name: getattr(value, each.name) for each in fields(value)})
    else:
        text = repr(value).encode()  # a text, or None
        yield f"s{len(text)}".encode() + text
