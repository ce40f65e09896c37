"""A ROM is what it holds: equal to what holds the same, with one hash, and not to be written to."""

import copy
import pickle
from dataclasses import replace

import numpy as np
import pytest
from soft_rom import soft_rom

import fenics_rom as fr

COPIES = (copy.copy, copy.deepcopy, lambda rom: pickle.loads(pickle.dumps(rom)), replace)


@pytest.fixture(scope="module", params=["linear", "large deformation"])
def rom(request, plate_rom):
    return plate_rom if request.param == "linear" else soft_rom()


def arrays_of(rom):
    found = [rom.basis, rom.stiffness, rom.nodes, rom.node_mass, *rom.outputs.values()]
    for model in rom.contact_models.values():
        found += [model.eigenvalues, model.damping, model.inputs, model.coordinates]
    if rom.deformation is not None:
        found += [rom.deformation.gradients, rom.deformation.weights, *rom.deformation.pressures.values()]
    return found


@pytest.mark.parametrize("copied", COPIES)
def test_copies_are_equal_and_read_only(rom, copied):
    other = copied(rom)
    assert other == rom
    assert hash(other) == hash(rom)
    assert len({rom, other}) == 1
    for array in arrays_of(other):
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
