"""The linear models of a ROM as one C99 file and its header, which need nothing else.

Of elastic bodies with inertia, on which nothing acts but inputs and loads, they are the steps of a simulator, with
their energy account; of all others the steps of a state space.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from itertools import islice
from string import Template
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.deployment.identifiers import identifiers
from fenics_rom.deployment.linear_models import linear_models
from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.rom.midpoint_map import compliance
from fenics_rom.rom.rom import Rom
from fenics_rom.rom.state_space import StateSpace
from fenics_rom.version import VERSION

NUMBERS_IN_A_LINE = 4


@dataclass(frozen=True)
class CSource:
    """Code, and what its arrays are made of.

    Attributes:
        name: of its type, and what all its functions begin with.
        dt: time step, s.
        contact_modes: their names.
        inputs, outputs: unit of each, by name; inputs of each contact mode, then those that all share.
        start: what inputs begin with, by name, unless it is what loads of the scene are.
        has_account: whether steps keep the energy account, and may have any length.
        header, source: the two files.
    """

    name: str
    dt: float
    contact_modes: tuple[str, ...]
    inputs: Mapping[str, str]
    outputs: Mapping[str, str]
    start: Mapping[str, float]
    has_account: bool
    header: str
    source: str


def c_source(rom: Rom, name: str, outputs: Sequence[str] | None, dt: float, at: Any = None) -> CSource:
    """The code of a ROM in steps of dt, s, that reads these outputs; None: all. `at`: as of `Rom.state_space`.

    Raises:
        StepError, StructureError: as `Rom.state_space`.
        FileError: two contact modes, inputs or outputs would have one name in it.
    """
    plants = linear_models(rom, outputs, dt, at)
    inputs: dict[str, str] = {}
    for contact, plant in plants.items():
        inputs |= dict(islice(plant.inputs.items(), rom.contacts[contact]))
    inputs |= plant.inputs  # of which those that all share are new
    acting = rom.environment
    if rom.nonlinear_parts or acting.viscoelasticity is not None or not acting.has_inertia:
        return _state_space_source(rom, name, plants, inputs)
    order, modes = max(model.order for model in rom.contact_models.values()), identifiers("contact mode", plants)
    dense = any(model.damping.ndim == 2 for model in rom.contact_models.values())
    columns = max(len(plant.inputs) for plant in plants.values())
    words = {
        "title": re.sub(r"[^\w ,.'-]", "_", f"{rom.name!r}, {rom.method}, order {order}"),  # no end of the comment
        "name": name,
        "NAME": name.upper(),
        "version": VERSION,
        "dt": repr(dt),
        "order": order,
        "rigid": rom.rigid,
        "shared": len(plant.inputs) - rom.contacts[contact],
        "dense": int(dense),
        "work": order * (columns + 4 + (3 * order + 2 if dense else 4)) + 2,
        "last": modes[contact].upper(),
        "contact_modes": _enumerators(f"{name}_contact", modes),
        "inputs": _enumerators(f"{name}_u", identifiers("input", inputs), inputs),
        "outputs": _enumerators(f"{name}_y", identifiers("output", plant.outputs), plant.outputs),
        "tables": "".join(_table(key, array) for key, array in _tables(rom, outputs, dt, order, dense).items()),
    }
    header, source = (filled(file, words) for file in ("plant.h", "plant.c"))
    return CSource(name, dt, tuple(plants), inputs, plant.outputs, {}, True, header, source)


def _state_space_source(rom: Rom, name: str, plants: Mapping[str, StateSpace], inputs: Mapping[str, str]) -> CSource:
    """The code of state spaces by contact mode, with all inputs."""
    modes, places = identifiers("contact mode", plants), {label: k for k, label in enumerate(inputs)}
    (*_, plant), size = plants.values(), max(1, *(len(each.states) for each in plants.values()))
    tables: dict[str, list[Array]] = {key: [] for key in ("A", "B", "C", "STATE", "ACTING", "AFTER", "SHOWN")}
    for each in plants.values():
        s, columns = len(each.states), [places[label] for label in each.inputs]
        B, acting = np.zeros((len(inputs), size)), np.zeros(len(inputs))
        B[columns, :s] = each.B.T
        parts = {"A": _padded(each.A.T, size, size), "B": B, "C": _padded(each.C, len(each.C), size)}
        rest = {key: np.zeros(n) for key, n in (("STATE", size), ("AFTER", size), ("SHOWN", len(each.C)))}
        if each.about is not None:
            acting[columns] = each.about.input
            rest["STATE"][:s], rest["AFTER"][:s], rest["SHOWN"][:] = (
                each.about.state,
                each.about.after,
                each.about.output,
            )
        for key, part in (parts | rest | {"ACTING": acting}).items():
            tables[key].append(part)
    maps = [
        _padded(rom.switch_map(start, end), size, size) for start in plants for end in plants if start != end
    ]  # fmt: skip
    about = "" if plant.about is None else "It holds near one state alone, in which it begins."
    words = {
        "title": re.sub(r"[^\w ,.'-]", "_", f"{rom.name!r}, {rom.method}, {size} states"),
        "name": name,
        "NAME": name.upper(),
        "version": VERSION,
        "dt": repr(plant.dt),
        "states": size,
        "work": size * (size + len(inputs)),
        "about": about,
        "last": list(modes.values())[-1].upper(),
        "contact_modes": _enumerators(f"{name}_contact", modes),
        "inputs": _enumerators(f"{name}_u", identifiers("input", inputs), inputs),
        "outputs": _enumerators(f"{name}_y", identifiers("output", plant.outputs), plant.outputs),
        "tables": "".join(_table(key, np.array(each)) for key, each in {**tables, "SWITCH_MAP": maps}.items()),
    }
    header, source = (filled(file, words) for file in ("state_space.h", "state_space.c"))
    start: dict[str, float] = {}
    if plant.about is not None:
        start = dict(zip(plant.inputs, plant.about.input.tolist(), strict=True))
    return CSource(name, plant.dt, tuple(plants), inputs, plant.outputs, start, False, header, source)


def filled(template: str, words: Mapping[str, object]) -> str:
    """A file of the folder `templates` with these words in it."""
    return Template((files("fenics_rom.deployment") / "templates" / template).read_text("utf-8")).substitute(words)


def _enumerators(prefix: str, names: Mapping[str, str], units: Mapping[str, str] | None = None) -> str:
    """Lines of an enum, with units as comments."""
    return "\n".join(
        f"    {prefix}_{word}".upper() + f",{f' /* {units[name]} */' if units else ''}" for name, word in names.items()
    )


def _tables(rom: Rom, outputs: Sequence[str] | None, dt: float, order: int, dense: bool) -> dict[str, Array]:
    """The arrays of a step, a switch and the outputs by name, each of all contact modes."""
    models, counts = rom.contact_models, list(rom.contacts.values())
    each = [_step_tables(model, count, dt, order, dense) for model, count in zip(models.values(), counts, strict=True)]
    tables = {name: np.array([step[name] for step in each]) for name in each[0] if name != "INPUT"}
    maps: dict[str, list[Array]] = {"POTENTIAL_MAP": [], "KINETIC_MAP": []}
    for start in models:
        for end in models:
            if start != end:
                potential, kinetic = np.split(rom.switch_map(start, end), [models[end].order])
                maps["POTENTIAL_MAP"].append(_padded(potential[:, : models[start].order], order, order))
                maps["KINETIC_MAP"].append(_padded(kinetic[:, models[start].order :], order, order))
    rows = [rom.state_space(name, outputs, dt).C[:, : model.order] for name, model in models.items()]
    return {
        "FIRST_INPUT": np.cumsum([0, *counts[:-1]]),
        "INPUT_COUNT": np.array(counts),
        "INPUT": np.vstack([step["INPUT"] for step in each]),
        **tables,
        **{name: np.array(each) for name, each in maps.items()},
        "OUTPUT": np.array([_padded(C, len(C), order) for C in rows]),
    }


def _step_tables(model: ContactModel, count: int, h: float, order: int, dense: bool) -> dict[str, Array]:
    """The arrays of a step of one contact mode that has so many inputs of its own, filled up with zeros."""
    ω, inputs = np.sqrt(model.eigenvalues), _padded(model.inputs.T, model.inputs.shape[1], order)
    a, Ra = compliance(model, h)
    tables = {
        "INPUT": inputs[:count],
        "SHARED_INPUT": inputs[count:],
        "FREQUENCY": _padded(ω, order),
        "TRAVEL": _padded(h * np.where(ω == 0, 1.0, ω), order),
    }
    stiffness, D = h / 2 * model.eigenvalues, model.damping
    if not dense:
        parts = {"COMPLIANCE": a, "RESISTANCE": D + stiffness, "DAMPING": model.damping_root**2}
        return tables | {name: _padded(part, order) for name, part in parts.items()}
    a, Ra, D = (part if part.ndim == 2 else np.diag(part) for part in (a, Ra, D))
    parts = {"COMPLIANCE": a, "RESISTANCE": D + np.diag(stiffness), "HEAT": Ra.T}
    return tables | {name: _padded(part, order, order) for name, part in parts.items()}


def _padded(array: Array, *shape: int) -> Array:
    """An array with zeros behind."""
    return np.pad(array, [(0, size - there) for size, there in zip(shape, array.shape, strict=True)])


def _table(name: str, array: Array) -> str:
    """A constant array in C, which has no empty ones."""
    if not array.size:
        array = np.zeros([max(size, 1) for size in array.shape] if array.ndim > 1 else [1, 1, 1])
    dimensions = "".join(f"[{size}]" for size in array.shape)
    return f"static const {'int' if array.dtype.kind == 'i' else 'real'} {name}{dimensions} = {_braces(array)};\n"


def _braces(array: Array) -> str:
    if array.ndim > 1:
        return "{" + ",\n".join(map(_braces, array)) + "}"
    numbers = [repr(number) for number in array.tolist()]
    lines = (numbers[k : k + NUMBERS_IN_A_LINE] for k in range(0, len(numbers), NUMBERS_IN_A_LINE))
    return "{" + ",\n ".join(", ".join(line) for line in lines) + "}"
