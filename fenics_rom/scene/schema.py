"""Tables that say what a value in a scene may be, and the one place that checks values against them."""

import math
import numbers
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from fenics_rom.errors import SceneError, shown, unknown
from fenics_rom.io.names import NAME, NAME_IN_WORDS

SMALLEST, GREATEST = 1e-50, 1e50  # size of a number that is not 0: what is made of some stays a number, too
REQUIRED: Any = object()  # a field without a default


@dataclass(frozen=True)
class Field:
    """What one key holds."""

    default: Any = REQUIRED

    def allowed(self) -> str:
        """What it holds, in words."""
        raise NotImplementedError

    def check(self, value: Any, where: str) -> Any:
        """Returns the value, as the program uses it.

        Raises:
            SceneError: it is not what the key holds.
        """
        raise NotImplementedError


def _refuse(where: str, value: Any, allowed: str) -> SceneError:
    return SceneError(f"{where} = {shown(value)}: allowed is {allowed}")


@dataclass(frozen=True)
class Number(Field):
    """A finite number with a unit and a range; bounds are allowed values unless they are open."""

    unit: str = ""
    at_least: float = -math.inf
    above: float = -math.inf
    below: float = math.inf
    at_most: float = math.inf
    integer: bool = False

    def allowed(self) -> str:
        """See Field."""
        bounds = [
            f"{word} {bound:g}"
            for word, bound in (
                (">=", self.at_least),
                (">", self.above),
                ("<", self.below),
                ("<=", self.at_most),
            )
            if math.isfinite(bound)
        ]
        kind = "a whole number" if self.integer else "a finite number"
        return " and ".join([kind, *bounds]) + (f", in {self.unit}" if self.unit else "")

    def check(self, value: Any, where: str) -> Any:
        """See Field."""
        kind: Any = numbers.Integral if self.integer else numbers.Real  # NumPy's numbers count, too
        if isinstance(value, bool) or not isinstance(value, kind):
            raise _refuse(where, value, self.allowed())
        try:
            finite = math.isfinite(value)
        except OverflowError:  # a whole number beyond 1e308
            finite = False
        if not (finite and self.at_least <= value <= self.at_most and self.above < value < self.below):
            raise _refuse(where, value, self.allowed())
        if value and not SMALLEST <= abs(value) <= GREATEST:
            raise _refuse(where, value, f"0 or a size from {SMALLEST:g} to {GREATEST:g}")
        return int(value) if self.integer else float(value)


@dataclass(frozen=True)
class Text(Field):
    """A non-empty string; one of `choices` where there are any."""

    choices: tuple[str, ...] = ()

    def allowed(self) -> str:
        """See Field."""
        return "a non-empty string"

    def check(self, value: Any, where: str) -> str:
        """See Field."""
        if not isinstance(value, str) or not value:
            raise _refuse(where, value, self.allowed())
        if self.choices and value not in self.choices:
            raise SceneError(f"{where}: {unknown('choice', value, list(self.choices))}")
        return value


@dataclass(frozen=True)
class Many(Field):
    """A list whose items are all of one kind, `length` of them where that is fixed."""

    item: Field = Number()
    length: int | None = None
    at_least: int = 0

    def allowed(self) -> str:
        """See Field."""
        if self.length is not None:
            return f"a list of {self.length}"
        return f"a list of at least {self.at_least}" if self.at_least else "a list"

    def check(self, value: Any, where: str) -> tuple[Any, ...]:
        """See Field."""
        if not isinstance(value, list):
            raise _refuse(where, value, f"{self.allowed()}, each {self.item.allowed()}")
        if len(value) < self.at_least or (self.length is not None and len(value) != self.length):
            raise SceneError(f"{where} is a list of {len(value)}: allowed is {self.allowed()}")
        return tuple(self.item.check(item, f"{where}[{k}]") for k, item in enumerate(value))


@dataclass(frozen=True)
class OneOf(Field):
    """A value that may be of several kinds; the first kind that takes it counts."""

    kinds: tuple[Field, ...] = ()

    def allowed(self) -> str:
        """See Field."""
        return ", or ".join(kind.allowed() for kind in self.kinds)

    def check(self, value: Any, where: str) -> Any:
        """See Field."""
        for kind in self.kinds:
            try:
                return kind.check(value, where)
            except SceneError:
                if isinstance(kind, Table) and isinstance(value, dict):
                    raise  # the right kind, and something wrong inside it
        raise _refuse(where, value, self.allowed())


@dataclass(frozen=True)
class Table(Field):
    """A table: with `fields`, those keys and no other; with `each`, any names, each holding such a value."""

    fields: Mapping[str, Field] | None = None
    each: Field | None = None

    def allowed(self) -> str:
        """See Field."""
        return "a table"

    def check(self, value: Any, where: str) -> dict[str, Any]:
        """See Field."""
        if not isinstance(value, dict):
            raise _refuse(where, value, self.allowed())
        if self.each is not None:
            for name in value:
                if not NAME.fullmatch(name):
                    raise SceneError(f"{where}: name {name!r}: allowed are {NAME_IN_WORDS}")
            return {name: self.each.check(item, f"{where}.{name}") for name, item in value.items()}
        fields = self.fields or {}
        for key in value:
            if key not in fields:
                raise SceneError(f"{where + ': ' if where else ''}{unknown('key', key, fields)}")
        checked = {}
        for key, field in fields.items():
            if key in value:
                checked[key] = field.check(value[key], f"{where}.{key}" if where else key)
            elif field.default is REQUIRED:
                raise SceneError(f"{where + ': ' if where else ''}{key} is missing")
            else:
                checked[key] = field.default
        return checked
