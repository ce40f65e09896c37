"""The zoo: files that are what its catalogue says; found by name, from Python and on the command line."""

import re
import runpy
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import fenics_rom as fr
from fenics_rom.cli.main import main
from fenics_rom.errors import FileError, MissingPackageError

ROOT = Path(__file__).parent.parent
ZOO = ROOT / "zoo"
BUILD = runpy.run_path(str(ZOO / "build.py"))
BODIES = BUILD["BODIES"]
LOCKS = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")  # the plate does


@pytest.fixture
def say(capfd):
    """Runs a command: its exit status, and what it printed."""

    def run(*words):
        with pytest.raises(SystemExit) as end:
            main([*map(str, words)])
        return end.value.code, *capfd.readouterr()

    return run


@LOCKS
def test_errors_of_the_catalogue_are_those_of_its_files(small_zoo):
    body, rom = fr.zoo()["plate"], fr.load("plate")
    assert body.rom.parent == body.scene.parent == small_zoo / "plate"
    found = fr.compare(fr.simulate(rom), fr.simulate(fr.read_scene(body.scene)))
    assert body.errors["shape"] == pytest.approx(found["shape"].relative, rel=1e-3)  # of 5e-6: round-off of whole runs
    assert body.errors["outputs"] == pytest.approx(found["output tip"].relative, rel=1e-3)
    assert body.errors["static"] == max(mode.static_error for mode in rom.contact_models.values())
    assert (body.order, body.unknowns, body.world) == (20, len(rom.free), None)


@LOCKS
def test_a_build_tells_of_errors_beyond_their_bounds(tmp_path, monkeypatch):
    monkeypatch.setitem(BODIES["plate"], "bounds", {"static": 1.0, "shape": 0.0})
    assert BUILD["make"](["plate"], tmp_path / "package") == ["plate, shape", "plate, outputs"]


@pytest.mark.parametrize("name", BODIES)
def test_scenes_stand_alone_in_the_zoo(name, tmp_path):
    """Nothing that they read is outside their folder, so that they run at full order wherever they are installed."""
    body = BODIES[name]
    scene = fr.read_scene(BUILD["copied"](ZOO / body["scene"], tmp_path / f"{name}.toml"))
    read = [*scene.files]
    if "world" in body:
        world = fr.read_world(BUILD["copied"](ZOO / body["world"], tmp_path / body["world"]))
        used = {each.rom for each in world.file.bodies.values()} - {None}
        assert used == {f"{name}.h5"}
    assert {file.resolve().parent for file in read} == {tmp_path}
    assert scene.mesh_file.is_file()
    assert scene.run is not None
    assert body["bounds"].keys() >= {"static", "shape"}


def test_a_zoo_that_is_not_there_says_how_to_get_it(monkeypatch, tmp_path, say):
    monkeypatch.setitem(sys.modules, "fenics_rom_zoo", None)
    with pytest.raises(MissingPackageError, match="pip install fenics-rom-zoo"):
        fr.load("finger")
    status, _, told = say("zoo")
    assert (status, told.count("\n")) == (1, 1)
    assert "pip install fenics-rom-zoo" in told
    (tmp_path / "fenics_rom_zoo").mkdir()
    (tmp_path / "fenics_rom_zoo" / "__init__.py").touch()
    monkeypatch.delitem(sys.modules, "fenics_rom_zoo")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(FileError, match=r"catalogue\.json: cannot be read: .*No such file"):
        fr.zoo()
    sys.modules.pop("fenics_rom_zoo")


@pytest.mark.parametrize("given", ["plat", "", "zoo:plate", None, 3])
def test_an_unknown_body_is_told_what_there_is(given, small_zoo):
    with pytest.raises(FileError, match=r"no body of the zoo .*; there is plate") as told:
        fr.load(given)
    assert ("did you mean 'plate'?" in str(told.value)) == (given in ("plat", "zoo:plate"))


def test_commands_take_bodies_by_name(small_zoo, tmp_path, monkeypatch, say):
    monkeypatch.chdir(tmp_path)
    status, told, _ = say("zoo")
    assert status == 0
    row = next(line for line in told.splitlines() if line.strip().startswith("plate "))
    assert re.search(r" 180 +20 +\d\.\de-05 ", row)
    assert row.rstrip().endswith("MIT")
    status, told, _ = say("info", "zoo:plate")
    assert (status, "180 displacements, 66 nodes" in told) == (0, True)
    status, told, _ = say("simulate", "zoo:plate", "-o", "run.h5", "--dt", "0.01")
    assert (status, fr.read_trajectory("run.h5").name) == (0, "plate")
    assert say("export", "zoo:plate", "-o", "plate.npz")[0] == 0
    for words in (["info"], ["view", "--no-browser"], ["simulate", "-o", "x.h5"], ["export", "-o", "x.npz"]):
        status, _, told = say(words[0], "zoo:plat", *words[1:])
        assert (status, told.count("\n")) == (1, 1)
        assert "did you mean 'plate'?" in told


def test_a_world_stands_for_the_body_where_worlds_are_taken(small_zoo, monkeypatch):
    from fenics_rom import zoo_bodies

    body = fr.zoo()["plate"]
    pair = fr.ZooBody(**{**vars(body), "world": body.scene.with_name("pair.toml")})
    monkeypatch.setattr(zoo_bodies, "zoo", lambda: {"pair": pair})
    assert zoo_bodies.model_file("zoo:pair") == str(pair.world)
    assert zoo_bodies.rom_file("zoo:pair") == str(pair.rom)
    assert zoo_bodies.model_file("./zoo:pair") == "./zoo:pair"


def test_a_rom_is_viewed_without_pydantic():
    """Which worlds ask for when they are read."""
    code = """
import sys
sys.modules["pydantic"] = None
from fenics_rom.visualization.viewer import view
import fenics_rom as fr
try:
    fr.make_world
except fr.errors.MissingPackageError as error:
    print(error)
"""
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    assert run.stdout.endswith('needs pydantic, which this Python lacks: pip install "fenics-rom[offline]"\n')


def test_both_distributions_have_the_same_number():
    project = tomllib.loads((ZOO / "pyproject.toml").read_text())["project"]
    assert project["version"] == fr.__version__
    assert (ZOO / "LICENSE").read_text() == (ROOT / "LICENSE").read_text()
