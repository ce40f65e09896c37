"""What a value of a scene may be: annotations of the fields of records, which check values and say so in words.

Scene files are checked by pydantic, which asks these annotations; what is given in Python is checked by `check` alone,
without pydantic, and told the same. A string among a field's annotations is the meaning of its key.
"""

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import MISSING, Field, dataclass, fields, is_dataclass
from types import NoneType, UnionType
from typing import Annotated, Any, Union, get_args, get_origin, get_type_hints

from fenics_rom.arguments import GREATEST, SMALLEST, is_number
from fenics_rom.errors import SceneError, shown, unknown
from fenics_rom.io.names import NAME, NAME_IN_WORDS
from fenics_rom.mechanics.base_path import BasePath
from fenics_rom.mechanics.signals import Signal
from fenics_rom.scene.surface_file import FileTriangles


class Refused(ValueError):
    """A value that is not allowed; the message continues the sentence that its place in the scene begins."""


def refused(value: Any, allowed: str) -> Refused:
    """The usual sentence: what was given, and what is allowed."""
    return Refused(f" = {shown(value)}: use {allowed}")


class Value:
    """What one value may be."""

    @property
    def allowed(self) -> str:
        """What it may be, in words."""
        raise NotImplementedError

    def checked(self, value: Any) -> Any:
        """Returns the value, as the program uses it; Refused where it is not allowed."""
        raise NotImplementedError

    def check(self, value: Any, where: str) -> Any:
        """Returns the value, as the program uses it; SceneError where it is not allowed."""
        try:
            return self.checked(value)
        except Refused as refusal:
            raise SceneError(f"{where}{refusal}") from None

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        from pydantic_core import core_schema  # here, as only what reads scene files needs it

        return core_schema.no_info_plain_validator_function(self.checked)


@dataclass(frozen=True)
class Number(Value):
    """A finite number with a unit and a range; bounds are allowed values unless they are open."""

    unit: str = ""
    at_least: float = -math.inf
    above: float = -math.inf
    below: float = math.inf
    at_most: float = math.inf
    integer: bool = False

    @property
    def bounds(self) -> list[tuple[str, float]]:
        """Signs and numbers of the range."""
        signs = ((">=", self.at_least), (">", self.above), ("<", self.below), ("<=", self.at_most))
        return [(sign, bound) for sign, bound in signs if math.isfinite(bound)]

    @property
    def allowed(self) -> str:
        """See Value."""
        kind = "a whole number" if self.integer else "a finite number"
        bounds = " and ".join(f"{sign} {bound:g}" for sign, bound in self.bounds)
        return f"{kind} {bounds}".rstrip() + (f", in {self.unit}" if self.unit else "")

    def checked(self, value: Any) -> Any:
        """See Value."""
        if not is_number(value, whole=self.integer):
            raise refused(value, self.allowed)
        if not (self.at_least <= value <= self.at_most and self.above < value < self.below):
            raise refused(value, self.allowed)
        if value and not SMALLEST <= abs(value) <= GREATEST:
            raise refused(value, f"0 or a size from {SMALLEST:g} to {GREATEST:g}")
        return int(value) if self.integer else float(value)


@dataclass(frozen=True)
class Text(Value):
    """A non-empty string; one of `choices` where there are any, else why a `missing` one is none of them."""

    choices: tuple[str, ...] = ()
    missing: tuple[tuple[str, str], ...] = ()  # names and reasons
    allowed = "a non-empty string"

    def checked(self, value: Any) -> str:
        """See Value."""
        if not isinstance(value, str) or not value:
            raise refused(value, self.allowed)
        if self.choices and value not in self.choices:
            if (reason := dict(self.missing).get(value)) is not None:
                raise refused(value, f"one of {', '.join(self.choices)}; {reason}")
            raise Refused(f": {unknown('choice', value, self.choices)}")
        return value


@dataclass(frozen=True)
class Flag(Value):
    """True or false."""

    allowed = "true or false"

    def checked(self, value: Any) -> bool:
        """See Value."""
        if not isinstance(value, bool):
            raise refused(value, self.allowed)
        return value


@dataclass(frozen=True)
class NameRule(Value):
    """A name that a scene gives."""

    def checked(self, value: Any) -> str:
        """See Value."""
        if not NAME.fullmatch(value):
            raise Refused(f": name {value!r}: use {NAME_IN_WORDS}")
        return str(value)


@dataclass(frozen=True)
class Items(Value):
    """A list, `length` items long where that is fixed; what each of them may be, the annotated tuple says."""

    length: int | None = None
    at_least: int = 0
    example: str = ""  # for who gives a single number

    @property
    def allowed(self) -> str:
        """See Value."""
        if self.length is not None:
            return f"a list of {self.length}"
        return f"a list of at least {self.at_least}" if self.at_least else "a list"

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        from pydantic_core import core_schema

        item = allowed_in(get_args(required(source))[0])

        def checked(value: Any) -> Any:
            if not isinstance(value, list):
                raise refused(value, f"{self.allowed}, each {item}{self.example and ', such as '}{self.example}")
            if len(value) < self.at_least or (self.length is not None and len(value) != self.length):
                raise Refused(f" is a list of {len(value)}: use {self.allowed}")
            return value

        return core_schema.no_info_before_validator_function(checked, handler(source))


@dataclass(frozen=True)
class OneOrByName(Value):
    """A number for all, or a table with one for each name, which the annotated mapping says."""

    number: Number

    @property
    def allowed(self) -> str:
        """See Value."""
        return f"{self.number.allowed}, or a table"

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        from pydantic_core import core_schema

        def checked(value: Any, by_name: Any) -> Any:
            if isinstance(value, dict):
                return by_name(value)
            try:
                return self.number.checked(value)
            except Refused:
                raise refused(value, self.allowed) from None

        mapping = handler.generate_schema(Mapping[Name, Annotated[int, self.number]])
        return core_schema.no_info_wrap_validator_function(checked, mapping)


@contextmanager
def _told_by_its_key() -> Iterator[None]:
    """What is wrong with a table, as a refusal, so that it is told behind the key that names the table."""
    try:
        yield
    except SceneError as error:
        raise Refused(f": {error}") from error


@dataclass(frozen=True)
class NameOrTable(Value):
    """A table, as the annotated record has it, or a name alone, which is that of one key of it."""

    key: str
    allowed = "a name, or a table"

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        from pydantic_core import core_schema

        def checked(value: Any, table: Any) -> Any:
            if isinstance(value, str):
                return source(**{self.key: Text().checked(value)})
            if not isinstance(value, dict):
                raise refused(value, self.allowed)
            return table(value)

        return core_schema.no_info_wrap_validator_function(checked, handler(source))


@dataclass(frozen=True)
class Table(Text):
    """The name of a CSV file with a signal; read as pydantic's context does it, by name, `columns` and `unit`."""

    columns: int | None = None
    unit: str = ""  # of the numbers; of a load of a run, what it acts on says it

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        from pydantic_core import core_schema

        def read(value: Any, info: Any) -> Signal:
            with _told_by_its_key():
                signal: Signal = info.context.signal(self.checked(value), self.columns, self.unit)
            return signal

        return core_schema.with_info_plain_validator_function(read)


@dataclass(frozen=True)
class PoseTable(Text):
    """The name of a CSV file with the path of a rigid base; read as a Table is."""

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        from pydantic_core import core_schema

        def read(value: Any, info: Any) -> BasePath:
            with _told_by_its_key():
                path: BasePath = info.context.path(self.checked(value))
            return path

        return core_schema.with_info_plain_validator_function(read)


@dataclass(frozen=True)
class SurfaceFile(Text):
    """The name of a file with a surface of triangles; read as a Table is."""

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        from pydantic_core import core_schema

        def read(value: Any, info: Any) -> FileTriangles:
            with _told_by_its_key():
                triangles: FileTriangles = info.context.triangles(self.checked(value))
            return triangles

        return core_schema.with_info_plain_validator_function(read)


Name = Annotated[str, NameRule()]
Metres = Annotated[float, Number(unit="m")]
Point = Annotated[tuple[Metres, Metres, Metres], Items(3)]
Pure = Annotated[float, Number()]
Direction = Annotated[tuple[Pure, Pure, Pure], Items(3)]


def keys_of(record: type) -> dict[str, Any]:
    """The annotations of a record's fields by name: what a table of a scene file may hold."""
    hints = get_type_hints(record, include_extras=True)
    return {field.name: hints[field.name] for field in fields(record)}


def required(annotation: Any) -> Any:
    """An annotation without None."""
    if get_origin(annotation) in (Union, UnionType):
        kinds = [kind for kind in get_args(annotation) if kind is not NoneType]
        return kinds[0] if len(kinds) == 1 else annotation
    return annotation


def extras_in(annotation: Any) -> tuple[Any, ...]:
    """All that is annotated, the outermost first."""
    annotation = required(annotation)
    if get_origin(annotation) is not Annotated:
        return ()
    inner, *extras = get_args(annotation)
    return (*extras, *extras_in(inner))


def value_in(annotation: Any) -> Value | None:
    """What an annotation says of a value; None of tables."""
    return next((extra for extra in extras_in(annotation) if isinstance(extra, Value)), None)


def type_in(annotation: Any) -> Any:
    """The type that is annotated."""
    annotation = required(annotation)
    return type_in(get_args(annotation)[0]) if get_origin(annotation) is Annotated else annotation


def part_of(annotation: Any, key: str | int) -> Any:
    """The annotation of what a table or a list holds under a key."""
    kind = type_in(annotation)
    if is_dataclass(kind):
        return keys_of(kind)[str(key)]  # type: ignore[arg-type]
    arguments = get_args(kind)
    return arguments[-1] if isinstance(key, str) else arguments[0]


def allowed_in(annotation: Any) -> str:
    """What an annotation allows, in words."""
    value = value_in(annotation)
    if value is None:
        return "a table"
    if isinstance(value, Items):
        return f"{value.allowed}, each {allowed_in(part_of(annotation, 0))}"
    return value.allowed


def default_of(field: Field) -> Any:
    """What a field is where nothing is said; MISSING where something must be."""
    return field.default if field.default_factory is MISSING else field.default_factory()
