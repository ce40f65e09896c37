"""Objects where objects are given, files where their names are, and a clear word on anything else."""

import numpy as np
import pytest
from bodies import PLATE

import fenics_rom as fr
from fenics_rom.errors import FileError, SceneError


@pytest.fixture(scope="module")
def run(plate_rom):
    return fr.simulate(plate_rom, dt=0.01)


@pytest.fixture(scope="module")
def files(tmp_path_factory, plate_rom, run):
    folder = tmp_path_factory.mktemp("given")
    fr.write_rom(folder / "plate.h5", plate_rom)
    fr.write_trajectory(folder / "run.h5", run)
    return folder


def test_runs_are_compared_by_their_files(files, run):
    assert fr.compare(files / "run.h5", run) == fr.compare(run, str(files / "run.h5")) == fr.compare(run, run)


def test_roms_are_cut_and_written_from_their_files(files, plate_rom, tmp_path):
    assert fr.truncate(str(files / "plate.h5"), 2) == fr.truncate(plate_rom, 2)
    fr.write_rom(tmp_path / "again.h5", files / "plate.h5")
    assert fr.read_rom(tmp_path / "again.h5") == plate_rom


@pytest.mark.slow
def test_plots_of_files_are_those_of_objects(files, run, plate_rom, tmp_path):
    for name, given, model, what in (
        ("run", files / "run.h5", run, None),
        ("runs", {"a": str(files / "run.h5"), "b": run}, {"a": run, "b": run}, ["energy"]),
        ("rom", str(files / "plate.h5"), plate_rom, ["sigma"]),
    ):
        pictures = [
            fr.plot(each, tmp_path / f"{name}-{k}.png", what=what)[0].read_bytes()
            for k, each in enumerate((given, model))
        ]
        assert pictures[0] == pictures[1]


def test_files_are_exported(files, tmp_path):
    for name in ("run", "plate"):
        assert fr.export(files / f"{name}.h5", tmp_path / f"{name}.vtu").stat().st_size > 1000


@pytest.mark.parametrize(
    ("give", "says"),
    [
        (lambda out: fr.compare(1.0, 2.0), "compare: something of type float was given; use a Trajectory, or"),
        (lambda out: fr.plot(fr.read_scene(PLATE), out), r"fr\.reduce\(fr\.assemble\(scene\)\) makes a Rom of a Scene"),
        (lambda out: fr.plot({"a": np.ones(3)}, out), "something of type ndarray was given"),
        (lambda out: fr.truncate(fr.read_scene(PLATE), 2), r"truncate: something of type Scene .* makes a Rom"),
        (lambda out: fr.write_rom(out, 1.0), "write_rom: something of type float was given; use a Rom, or"),
        (lambda out: fr.export(None, out), "a Rom or a Trajectory, or the name of a file of one"),
        (lambda out: fr.view(fr.read_scene(PLATE), wait=False), r"view: something of type Scene .* makes a Rom"),
    ],
)
def test_what_is_neither_is_told_what_to_do(give, says, tmp_path):
    with pytest.raises(SceneError, match=says):
        give(tmp_path / "x.pdf")


@pytest.mark.parametrize(
    ("give", "says"),
    [
        (lambda rom: fr.assemble("plate.toml"), "assemble: .* type str .* a Scene, as of fr.read_scene"),
        (fr.reduce, "reduce: something of type Rom was given; use a System, as of fr.assemble"),
        (lambda rom: fr.make_world(fr.read_scene(PLATE)), "make_world: .* Scene .* a WorldScene, as of fr.read_world"),
        (lambda rom: fr.Simulator(rom, 1e-3, scene="plate.toml"), "scene: .* type str .* a Scene, as of fr.read_scene"),
        (lambda rom: fr.simulate(rom, scene=rom.name), "scene: something of type str"),
        (lambda rom: fr.differentiate(rom, np.zeros((3, 3)), len), "differentiate: .* Rom .* as of fr.Simulator"),
        (lambda rom: fr.differentiate_scene("plate.toml", len), "differentiate_scene: .* type str .* a Scene"),
        (lambda rom: fr.identify("plate.toml", []), "identify: .* type str .* a Scene"),
    ],
)
def test_what_stands_for_another_thing_is_told_what_makes_that(give, says, plate_rom):
    with pytest.raises(SceneError, match=says):
        give(plate_rom)


def test_a_file_of_something_else_is_told(files):
    with pytest.raises(FileError, match=r"plate\.h5: is a ROM; use a run"):
        fr.compare(files / "plate.h5", files / "run.h5")
    with pytest.raises(FileError, match="is not a fenics-rom file; of a scene `reduce` makes a ROM"):
        fr.view(PLATE, wait=False)
