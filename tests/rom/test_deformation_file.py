from dataclasses import fields, replace

import h5py
import numpy as np
import pytest
from soft_rom import soft_rom, swing

import fenics_rom as fr
from fenics_rom.errors import FileError, StructureError
from fenics_rom.io.hdf5 import write_file
from fenics_rom.rom.rom import check_rom


@pytest.fixture(scope="module")
def rom():
    return soft_rom("neo_hookean")


def test_what_is_written_is_read_to_the_last_bit(tmp_path, rom):
    fr.write_rom(tmp_path / "rom.h5", rom)
    again = fr.read_rom(tmp_path / "rom.h5")
    for field in fields(rom.deformation):
        one, other = getattr(rom.deformation, field.name), getattr(again.deformation, field.name)
        if field.name == "tendons":
            one, other = vars(one["cable"]), vars(other["cable"])
        if isinstance(one, dict):
            assert one.keys() == other.keys()
            for name in one:
                np.testing.assert_array_equal(one[name], other[name])
        else:
            np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(swing(rom, 4e-3, None).state, swing(again, 4e-3, None).state)


def test_a_run_says_how_its_steps_were_taken(tmp_path, rom):
    run = fr.simulate(rom, stepper="linearly-implicit")
    fr.write_trajectory(tmp_path / "run.h5", run)
    again = fr.read_trajectory(tmp_path / "run.h5")
    assert again.stepping == run.stepping == "linearly-implicit: it was asked for"
    assert again.settings["mismatch"] == run.settings["mismatch"]
    assert fr.simulate(replace(rom, deformation=None)).stepping == ""


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda body: {"law": "rubber"}, "material"),
        (lambda body: {"weights": -body.weights}, "weights are not positive"),
        (lambda body: {"shear": -body.shear}, "shear moduli"),
        (lambda body: {"first_lame": -body.shear}, "bulk moduli"),
        (lambda body: {"viscosity": body.viscosity - 1}, "viscosities"),
        (
            lambda body: {"external_damping": body.external_damping + np.triu(np.ones_like(body.external_damping), 1)},
            "external_damping is not symmetric",
        ),
        (lambda body: {"springs": -np.eye(body.order)}, "springs is not positive semi-definite"),
        (lambda body: {"gradients": body.gradients[..., :-1]}, "displacements|shape"),
        (lambda body: {"weights": body.weights[:-1]}, "shape"),
        (lambda body: {"points_of": 3}, "points"),
        (lambda body: {"pressures": {"air": body.pressures["air"][:, :-1]}}, "pressure|shape"),
        (lambda body: {"pressures": {"wind": body.pressures["air"]}}, "actuator"),
        (lambda body: {"tendons": {"rope": body.tendons["cable"]}}, "actuator"),
        (lambda body: {"cubature_error": float("nan")}, "finite"),
    ],
)
def test_what_does_not_fit_is_not_written(tmp_path, rom, change, says):
    body = rom.deformation
    bad = replace(rom, deformation=replace(body, **change(body)))
    with pytest.raises((FileError, StructureError), match=says):
        fr.write_rom(tmp_path / "rom.h5", bad)
    assert not (tmp_path / "rom.h5").exists()


@pytest.mark.parametrize("part", ["gradients", "training_radius", "pressures", "tendons/cable/shapes", None])
def test_what_lacks_a_part_is_not_read(tmp_path, rom, part):
    file = tmp_path / "rom.h5"
    fr.write_rom(file, rom)

    def without(h5):
        with h5py.File(file) as whole:
            h5.attrs.update(whole.attrs)
            for name in whole:
                whole.copy(name, h5)
        del h5[f"deformation/{part}" if part else "deformation"]

    write_file(tmp_path / "less.h5", "rom", without)
    with pytest.raises(FileError, match=r"missing|go together"):
        fr.read_rom(tmp_path / "less.h5")


def test_contact_modes_of_their_own_bases_are_refused(rom):
    mode = replace(rom.contact_models["tip"], coordinates=-np.eye(rom.contact_models["tip"].order))
    with pytest.raises(StructureError, match="one basis"):
        check_rom(replace(rom, contact_models={**rom.contact_models, "tip": mode}))
