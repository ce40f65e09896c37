"""A ROM is what it holds: equal to what holds the same, with one hash, and not to be written to."""

import copy
import pickle
from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest
from soft_rom import soft_rom

import fenics_rom as fr
from fenics_rom.mechanics.contact_points import PointsBetween
from fenics_rom.mechanics.environment import Load
from fenics_rom.mechanics.initial_state import InitialState, Instant
from fenics_rom.mechanics.readings import ContactPressure, SurfaceReading
from fenics_rom.mechanics.signals import Signal

COPIES = (copy.copy, copy.deepcopy, lambda rom: pickle.loads(pickle.dumps(rom)), replace)


@pytest.fixture(scope="module", params=["linear", "large deformation"])
def rom(request, plate_rom):
    return plate_rom if request.param == "linear" else soft_rom()


def arrays_of(value):
    """All there are in a record, in the records, mappings and tuples that it holds, and so on."""
    if isinstance(value, np.ndarray):
        return [value]
    parts = [getattr(value, each.name) for each in fields(value)] if is_dataclass(value) else value
    parts = parts.values() if isinstance(parts, dict) else parts if isinstance(parts, list | tuple) else ()
    return [array for part in parts for array in arrays_of(part)]


def with_everything(rom):
    """A ROM that has what few have: readings, points between nodes, signals of tables, a start from another run."""
    ones, start = np.ones((2, 3)), InitialState(instant=Instant(*np.ones((3, 2, 3))))
    gust = Load(3, Signal(ones, np.array([0.0, 1.0])))
    environment = replace(rom.environment, loads={"gust": gust}, run=replace(rom.environment.run, initial=start))
    readings = {
        "sole": ContactPressure("tip_left", np.arange(3), np.arange(3)[None], np.ones(1)),
        "stress": SurfaceReading("von_mises_stress", "", np.arange(1), np.ones((9, 4)), np.ones(1), np.ones(1)),
    }
    return replace(rom, environment=environment, readings=readings, points_between=PointsBetween(ones, ones, 1.0))


@pytest.mark.parametrize("copied", COPIES)
def test_copies_are_equal_and_read_only(rom, copied):
    rom = with_everything(rom)
    other = copied(rom)
    assert other == rom
    assert hash(other) == hash(rom)
    assert len({rom, other}) == 1
    arrays = arrays_of(other)
    assert len(arrays) >= len(arrays_of(rom)) >= 25
    for array in arrays:
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0.0


def test_what_a_file_gives_back_is_what_was_written(rom, tmp_path):
    fr.write_rom(tmp_path / "rom.h5", rom)
    assert fr.read_rom(tmp_path / "rom.h5") == rom


def test_another_number_or_name_makes_another_rom(rom):
    contact, model = next(iter(rom.contact_models.items()))
    inputs = model.inputs.copy()
    inputs[0, 0] = np.nextafter(inputs[0, 0], 1.0)
    others = [
        replace(rom, contact_models=rom.contact_models | {contact: replace(model, inputs=inputs)}),
        replace(rom, name="another"),
        replace(rom, outputs={f"other {name}": rows for name, rows in rom.outputs.items()}),
        replace(rom, environment=replace(rom.environment, run=None)),
    ]
    assert all(other != rom for other in others)
    assert len({rom, *others}) == 5
    assert rom != rom.contact_models
    assert model == replace(model, inputs=model.inputs.copy())


def test_whoever_made_the_arrays_may_go_on_writing(rom):
    nodes = rom.nodes.copy()
    replace(rom, nodes=nodes)
    nodes[0] = 1.0
