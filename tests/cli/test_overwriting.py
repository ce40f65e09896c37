"""What a command reads is not written over, by whatever name; nor is a file of another kind, unless that is forced."""

import os
import shutil
from pathlib import Path

import pytest
from bodies import box_arrays, scene_text, write_arrays

import fenics_rom as fr
from fenics_rom.cli.main import main
from fenics_rom.errors import FileError, RomFileError, TrajectoryFileError

BASE = "time (s),position.x,position.y,position.z,rotation.w,rotation.x,rotation.y,rotation.z\n"
WORLD = """
gravity = [0.0, 0.0, -9.81]
[bodies.ground]
shape = "half-space"
[bodies.palm]
shape = "box"
size = [0.1, 0.1, 0.02]
path = "palm.csv"
[bodies.soft]
rom = "link.h5"
position = [0, 0, 5]
[bodies.other]
scene = "other/other.toml"
position = [0, 9, 5]
[run]
dt = 1e-2
duration = 0.1
input = []
"""
READ = "is read by this command, so it cannot be its output"


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    """A scene with a mesh and a table in folders of their own, its ROM and a run, and a world that names them."""
    folder = tmp_path_factory.mktemp("inputs")
    for name in ("parts", "other"):
        (folder / name).mkdir()
    points, cells = box_arrays((1.0, 0.4, 0.3), (2, 1, 1))
    for mesh in (folder / "parts" / "box.msh", folder / "other" / "box.msh"):
        write_arrays(mesh, points, cells)
    (folder / "parts" / "force.csv").write_text("time (s),x,y,z\n0,0,0,1\n1,0,0,0\n")
    load = 'dt = 1e-2\nduration = 0.1\nload = [{ contact = "right", table = "parts/force.csv" }]'
    start = load + '\n[run.initial]\ntrajectory = "run.h5"'
    for name, mesh, run in (
        ("box.toml", "parts/box.msh", load),
        ("again.toml", "parts/box.msh", start),
        ("other/other.toml", "box.msh", ""),
    ):
        parts = {"outputs.tip": "points = [[1.0, 0.4, 0.3]]", **({"run": run} if run else {})}
        (folder / name).write_text(scene_text(Path(mesh), **parts, reduction="order = 2"))
    rom = fr.reduce(fr.assemble(fr.read_scene(folder / "box.toml")))
    fr.write_rom(folder / "rom.h5", rom)
    fr.write_trajectory(folder / "run.h5", fr.simulate(rom))
    (folder / "link.h5").symlink_to("rom.h5")
    os.link(folder / "parts" / "box.msh", folder / "same.msh")
    (folder / "palm.csv").write_text(BASE + "0,0,0,9,1,0,0,0\n1,0,0,9,1,0,0,0\n")
    (folder / "world.toml").write_text(WORLD)
    return folder


@pytest.fixture
def inside(inputs, tmp_path, monkeypatch):
    monkeypatch.chdir(shutil.copytree(inputs, tmp_path / "work", symlinks=True))
    Path("same.msh").unlink()
    os.link("parts/box.msh", "same.msh")  # which copying would make a file of its own
    return Path.cwd()


def contents():
    return {str(file): file.read_bytes() for file in Path().rglob("*") if file.is_file()}


def say(capfd, *words):
    with pytest.raises(SystemExit) as end:
        main(list(words))
    return end.value.code, capfd.readouterr().err


@pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")  # the box locks
@pytest.mark.parametrize("force", [(), ("--force",)])
@pytest.mark.parametrize(
    "words",
    [
        ("reduce", "box.toml", "-o", "parts/box.msh"),
        ("reduce", "box.toml", "-o", "other/../same.msh"),
        ("reduce", "box.toml", "-o", "parts/force.csv"),
        ("reduce", "again.toml", "-o", "run.h5"),
        ("simulate", "box.toml", "-o", "parts/box.msh"),
        ("simulate", "again.toml", "-o", "./run.h5"),
        ("simulate", "rom.h5", "--scene", "again.toml", "-o", "parts/force.csv"),
        ("simulate", "world.toml", "-o", "rom.h5"),
        ("simulate", "world.toml", "-o", "palm.csv"),
        ("simulate", "world.toml", "-o", "other/box.msh"),
        ("simulate", "world.toml", "-o", "other/other.toml"),
        ("identify", "identified.toml", "--data", "d.csv", "-o", "."),
        ("identify", "box.toml", "--data", "residuals.csv", "-o", "."),
        ("identify", "box.toml", "--data", "d.csv", "--also", "identified.toml", "residuals.csv", "-o", "."),
        ("study", "study.toml", "-o", "."),
        ("export", "rom.h5", "-o", "sheet.png"),
        ("plot", "run.h5", "-o", "plots.pdf"),
        ("info", "box.toml", "--surfaces", "-o", "mesh.png"),
    ],
)
def test_what_a_command_reads_is_not_its_output(inside, capfd, words, force):
    shutil.copy("box.toml", "identified.toml")
    Path("study.toml").write_text(Path("box.toml").read_text().replace("parts/force.csv", "study.csv"))
    shutil.copy("parts/force.csv", "study.csv")
    for name in ("d.csv", "residuals.csv"):
        Path(name).write_text("time (s),tip.x (m)\n0.1,0\n")
    Path("sheet.png").symlink_to("rom.h5")
    Path("plots.pdf").symlink_to("run.h5")
    Path("mesh.png").symlink_to("parts/box.msh")
    before = contents()
    status, said = say(capfd, *words, *force)
    assert (status, READ in said, len(said.splitlines())) == (1, True, 1), said
    assert contents() == before


@pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
@pytest.mark.parametrize(
    ("words", "found", "wanted"),
    [
        (("reduce", "box.toml", "-o", "run.h5"), "a run", "a ROM"),
        (("reduce", "box.toml", "-o", "other/box.msh"), "a .msh file", "a ROM"),
        (("simulate", "rom.h5", "-o", "palm.csv"), "a .csv file", "a run"),
        (("simulate", "world.toml", "-o", "box.toml"), "a .toml file", "a run"),
        (("plot", "run.h5", "-o", "energy.png"), "a ROM", "a .png file"),
        (("info", "box.toml", "--surfaces", "-o", "energy.png"), "a ROM", "a .png file"),
        (("plot", "run.h5", "-o", "plots", "--what", "energy"), "something else than its ending says", "a .pdf file"),
        (("export", "rom.h5", "-o", "plant.npz"), "something else than its ending says", "a .npz file"),
        (("export", "rom.h5", "-o", "plant.c", "--dt", "0.1"), "a PDF", "a .h file"),
    ],
)
def test_file_of_another_kind_is_replaced_only_by_force(inside, capfd, words, found, wanted):
    shutil.copy("rom.h5", "energy.png")
    Path("plots").mkdir()
    for name in ("plots/energy.pdf", "plant.npz"):
        Path(name).write_text("my notes")
    Path("plant.h").write_bytes(b"%PDF-1.4")
    before = contents()
    status, said = say(capfd, *words)
    assert (status, len(said.splitlines())) == (1, 1)
    assert f"is {found}, and would be replaced by {wanted}; give another name, or allow it by --force" in said
    assert contents() == before
    if words[0] != "simulate" or words[1] == "rom.h5":
        assert say(capfd, *words, "--force")[0] == 0
        assert say(capfd, *words)[0] == 0  # now it is of the same kind


@pytest.mark.parametrize(
    ("words", "what"),
    [(("reduce", "box.toml"), "ROM"), (("simulate", "rom.h5"), "run"), (("simulate", "world.toml"), "run")],
)
def test_a_file_gets_no_ending_of_another_kind(inside, capfd, words, what):
    for ending in (".csv", ".txt", ".pdf"):
        status, said = say(capfd, *words, "-o", f"new{ending}")
        assert (status, len(said.splitlines())) == (1, 1)
        assert (
            f"new{ending}: a {what} is an HDF5 file, and would look like a {ending} file; end its name in .h5" in said
        )
        assert not Path(f"new{ending}").exists()
    if words[1] == "rom.h5":
        assert say(capfd, *words, "-o", "new.csv", "--force")[0] == 0


def test_python_replaces_files_of_another_kind_only_by_force(inside):
    rom, run = fr.read_rom("rom.h5"), fr.read_trajectory("run.h5")
    with pytest.raises(
        RomFileError, match=r"parts/box.msh: is a .msh file, and would be replaced by a ROM; .* force=True"
    ):
        fr.write_rom("parts/box.msh", rom)
    with pytest.raises(TrajectoryFileError, match=r"link.h5: is a ROM, and would be replaced by a run"):
        fr.write_trajectory("link.h5", run)
    Path("damaged.h5").write_bytes(Path("run.h5").read_bytes()[:-1])
    with pytest.raises(TrajectoryFileError, match="damaged"):
        fr.write_trajectory("damaged.h5", run)
    Path("own.h5").write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(500))
    with pytest.raises(RomFileError, match=r"own.h5: is an HDF5 file of another program, and would"):
        fr.write_rom("own.h5", rom)
    fr.write_rom("own.h5", rom, force=True)
    fr.write_rom("own.h5", fr.truncate(rom, 1))
    assert fr.read_rom("own.h5") == fr.truncate(rom, 1)
    Path("empty.h5").touch()  # as programs make whose names must be theirs
    fr.write_trajectory("empty.h5", run)
    with pytest.raises(FileError, match=READ):
        fr.export("rom.h5", Path("plant.mat").resolve() if Path("plant.mat").symlink_to("rom.h5") else "plant.mat")


def test_arrays_of_an_xdmf_mesh_count_as_read(tmp_path):
    (tmp_path / "box.xdmf").write_text('<Xdmf><DataItem Format="HDF">data/box.h5:/Mesh/x</DataItem></Xdmf>')
    (tmp_path / "box.toml").write_text(scene_text(Path("box.xdmf")))
    files = fr.read_scene(tmp_path / "box.toml").files
    assert files == tuple(tmp_path / name for name in ("box.toml", "box.xdmf", "data/box.h5"))
