"""The table of effects, made from their records: what a scene says of each, and its part in the energy account."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, get_origin

from fenics_rom.scene.effects import Effects, Law
from fenics_rom.scene.places import PIECES
from fenics_rom.scene.values import Items, Number, keys_of, part_of, type_in, value_in


@dataclass(frozen=True)
class EffectEntry:
    """A row of the table of effects."""

    kind: type  # the record of the effect, or of each one where there can be several
    several: bool  # whether a scene names each, as in [effects.tendon.NAME]

    @property
    def law(self) -> Law:
        """What it does."""
        law: Law = self.kind.LAW  # type: ignore[attr-defined]
        return law

    @property
    def parameters(self) -> dict[str, Any]:
        """What the scene says of it, each with its annotation."""
        return keys_of(self.kind)

    @property
    def numbers(self) -> dict[str, tuple[str, int | None]]:
        """Unit and length (None: any) of each parameter of numbers, where there is one of it."""
        found = {}
        for key, annotation in () if self.several else self.parameters.items():
            value: Any = value_in(annotation)
            length: int | None = 1
            if isinstance(value, Items):
                length, value = value.length, value_in(part_of(annotation, 0))
            if isinstance(value, Number):
                found[key] = value.unit or "1", length
        return found


def _entry(annotation: Any) -> EffectEntry:
    several = get_origin(type_in(annotation)) is Mapping
    return EffectEntry(type_in(part_of(annotation, "NAME")) if several else type_in(annotation), several)


EFFECTS: Mapping[str, EffectEntry] = {name: _entry(annotation) for name, annotation in keys_of(Effects).items()}
LOADS = ("gravity", "base_motion", "prescribed", "temperature")  # forces with a signal of their own
ACTUATORS = ("pressure", "tendon", "driven_support")  # forces that are inputs


def numbers_of(effects: Effects) -> dict[str, dict[str, Any]]:
    """Of each effect that acts its parameters that are numbers, where it is one of its kind."""
    numbers = {}
    for name in effects.names:
        given = {key: getattr(getattr(effects, name), key) for key in EFFECTS[name].numbers}
        numbers[name] = {key: value for key, value in given.items() if value not in (None, ())}
    return numbers


def table_of_effects() -> list[tuple[str, str, str, str]]:
    """For each effect its name, its force, what a scene says of it, and its part in the energy account."""
    return [
        (
            f"`{name}.NAME`" if effect.several else f"`{name}`",
            effect.law.force,
            ", ".join(dict.fromkeys(_described(key, part) for key, part in effect.parameters.items())) or "-",
            "; ".join(
                f"{verb} {getattr(effect.law, verb)}"
                for verb in ("stores", "dissipates", "supplies")
                if getattr(effect.law, verb) != "nothing"
            ),
        )
        for name, effect in EFFECTS.items()
    ]


def _described(key: str, annotation: Any) -> str:
    """A parameter with its unit and its bounds; a place for all of its keys."""
    if key in PIECES:
        return "a place"
    value = value_in(annotation)
    if isinstance(value, Items):
        value = value_in(part_of(annotation, 0))
    if not isinstance(value, Number):
        return f"`{key}`"
    bounds = "".join(f" {sign.replace('>=', '≥').replace('<=', '≤')} {bound:g}" for sign, bound in value.bounds)
    return f"`{key}`{bounds}{f' {value.unit}' if value.unit else ''}"
