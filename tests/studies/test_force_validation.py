"""What a ROM says of its contact forces, against runs of their own, and what becomes of that in files."""

import warnings
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from bodies import scene_text, write_box

import fenics_rom as fr
from fenics_rom.cli.display import print_rom
from fenics_rom.errors import FenicsRomWarning, RomFileError
from fenics_rom.scene.file import parse_scene
from fenics_rom.studies import force_validation
from fenics_rom.trajectory.comparison import force_errors

STOP = """inertia = {}
gravity = { acceleration = [0.0, 0.0, -9.81] }
damping = { alpha = 1.0, beta = 1e-3 }
contact = { obstacles = { stop = { shape = "half-space", point = [0, 0, DEPTH], normal = [0, 0, 1] } } }"""
CONTACTS = '[contacts.bottom]\nsurface = "bottom"'


def falling(mesh, depth):
    """A held beam that falls on a floor at some depth below it, m."""
    text = scene_text(
        mesh, effects=STOP.replace("DEPTH", repr(-depth)), run="dt = 2e-3\nduration = 0.1", contacts=CONTACTS
    )
    return parse_scene(text, folder=mesh.parent, source="beam")


@pytest.fixture(scope="module")
def mesh(tmp_path_factory):
    return write_box(tmp_path_factory.mktemp("beam") / "beam.msh", (0.4, 0.06, 0.04), (6, 2, 1))


@pytest.fixture(scope="module")
def system(mesh):
    return fr.assemble(falling(mesh, 1e-3))


@pytest.fixture(scope="module")
def rom(system):
    return fr.reduce(system, order=3)


@pytest.fixture(scope="module")
def validated(system, rom):
    with pytest.warns(FenicsRomWarning, match="contact forces of stop are off the full order's at the same step"):
        return fr.validate_forces(system, rom)


def test_forces_are_measured_against_the_full_order_and_the_step_apart(system, rom, validated):
    found = validated.force_validation
    assert (found.dt, found.duration) == (2e-3, 0.1)
    full, reduced, finer = fr.simulate(system), fr.simulate(rom), fr.simulate(system, dt=1e-3)
    assert found.reduction["stop"] == pytest.approx(force_errors(fr.compare(reduced, full))["stop"], rel=1e-9)
    assert found.time_step["stop"] == pytest.approx(force_errors(fr.compare(full, finer))["stop"], rel=1e-9)
    assert validated.stages[-1].name == "validation of contact forces"  # what it cost
    assert any("stop" in message for message in validated.warnings)


def test_more_displacements_bring_forces_closer(system, validated):
    finer = fr.validate_forces(system, fr.reduce(system, order=system.size))
    assert max(finer.force_validation.reduction["stop"]) < 1e-6
    assert min(validated.force_validation.reduction["stop"]) > 1e-5


@pytest.mark.parametrize("deformation", [None, "largely"])
def test_work_is_bounded_whatever_the_size(deformation):
    whole = force_validation.Run(dt=1e-3, duration=100.0)
    work = force_validation.WORK if deformation is None else force_validation.LARGE_WORK / force_validation.NEWTON
    for size in (100, 4000, 100_000, 10**7):
        kind = SimpleNamespace(size=size, deformation=deformation)
        steps = round(force_validation._affordable(whole, kind).duration / whole.dt)
        assert steps == 1 or 3 * steps * (size + force_validation.OVERHEAD) <= work


def test_what_is_covered_is_from_rest_until_as_long_after_the_first_touch(mesh, monkeypatch):
    """A run that is much longer costs no more."""
    monkeypatch.setattr(force_validation, "STEPS_AFTER", 5)
    scene = falling(mesh, 1e-3)
    system = replace(fr.assemble(scene), scene=replace(scene, run=replace(scene.run, duration=0.4)))
    rom = fr.reduce(system, order=6)
    found = fr.validate_forces(system, rom).force_validation
    force = fr.simulate(rom).forces["stop"]
    first = np.flatnonzero(force.any(axis=1))[0]
    assert found.duration == pytest.approx(2 * first * 2e-3)
    assert 5 < first < 50


def test_large_deformation_is_validated_too(mesh):
    """Against the full order that deforms largely; both its own step and the reduction are told."""
    effects = STOP.replace("DEPTH", "-1e-3").replace("{ obstacles", '{ switching = "scene", obstacles')
    effects += "\nlarge_deformation = {}"
    pushed = 'dt = 4e-3\nduration = 0.06\nload = [{ contact = "bottom", force = [0.0, 0.0, -1.0] }]'
    text = scene_text(mesh, effects=effects, run=pushed, contacts=CONTACTS)
    system = fr.assemble(parse_scene(text, folder=mesh.parent, source="beam"))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FenicsRomWarning)
        rom = fr.reduce(system, order=6, method="modal+derivatives")
        found = fr.validate_forces(system, rom).force_validation
        full, finer, reduced = fr.simulate(system), fr.simulate(system, dt=2e-3), fr.simulate(rom)
        stiff = fr.simulate(rom, scene=replace(rom.environment, residual_compliance=False))
    assert found.duration == 0.06
    assert found.reduction["stop"] == pytest.approx(force_errors(fr.compare(reduced, full))["stop"], rel=1e-6)
    own = force_errors(fr.compare(full, finer))["stop"]
    assert found.time_step["stop"] == pytest.approx(own, rel=1e-6)
    assert max(own) > 0
    history, peak, _ = force_errors(fr.compare(stiff, full))["stop"]  # without residual compliance
    assert found.reduction["stop"][0] < 0.8 * history
    assert found.reduction["stop"][1] < 0.5 * peak


def test_it_is_in_the_file_and_printed_but_not_of_a_lower_order(validated, tmp_path, capsys):
    fr.write_rom(tmp_path / "rom.h5", validated)
    again = fr.read_rom(tmp_path / "rom.h5")
    assert again.force_validation == validated.force_validation
    assert fr.truncate(again, 2).force_validation is None
    print_rom(again, "rom.h5")
    said = capsys.readouterr().out
    assert "contact forces, the first 0.1 s of the run, steps of 0.002 s: how far they are off" in said
    assert "full order, same step" in said
    assert "full order at half the step, itself" in said
    alone = replace(validated.force_validation, time_step={})  # as of a file of an earlier release
    fr.write_rom(tmp_path / "alone.h5", replace(validated, force_validation=alone))
    assert fr.read_rom(tmp_path / "alone.h5").force_validation == alone
    wrong = replace(validated.force_validation, dt=-1.0)
    fr.write_rom(tmp_path / "wrong.h5", replace(validated, force_validation=wrong))
    with pytest.raises(RomFileError, match="a time is not positive"):
        fr.read_rom(tmp_path / "wrong.h5")


def test_what_is_not_touched_is_not_validated_and_that_is_said(mesh, rom, tmp_path, capsys):
    system = fr.assemble(falling(mesh, 0.3))
    found = fr.validate_forces(system, fr.reduce(system, order=20))
    assert found.force_validation.reduction == {}
    fr.write_rom(tmp_path / "rom.h5", found)
    print_rom(fr.read_rom(tmp_path / "rom.h5"), "rom.h5")
    assert (
        "contact forces: not validated, as nothing is touched in the first 0.1 s of the run" in capsys.readouterr().out
    )


def test_without_obstacles_nothing_is_done(plate_system, plate_rom):
    assert fr.validate_forces(plate_system, plate_rom) is plate_rom
