"""Gmsh reads in a process of its own: what it finds is the same, and what it does there harms nobody."""

import os
from pathlib import Path
from types import SimpleNamespace

import gmsh
import mutated_meshes
import numpy as np
import pytest
from bodies import box_arrays, write_arrays

from fenics_rom.errors import MeshError
from fenics_rom.fem.mesh import read_mesh
from fenics_rom.scene import foreign_file, foreign_process

in_another_process = foreign_file.read_arrays  # the other tests read in their own


@pytest.fixture(autouse=True)
def _another_process(monkeypatch):
    monkeypatch.setattr(foreign_file, "read_arrays", in_another_process)


@pytest.fixture(scope="module")
def mesh(tmp_path_factory):
    return write_arrays(tmp_path_factory.mktemp("mesh") / "box.msh", *box_arrays((1.0, 0.4, 0.3), (2, 1, 1)))


def test_what_it_finds_is_what_gmsh_finds(tmp_path):
    arrays = box_arrays((1.0, 0.4, 0.3), (3, 2, 1), shake=0.2)
    for version, binary in mutated_meshes.FORMATS:
        file = write_arrays(tmp_path / "named ä.msh", *arrays, version=version, binary=bool(binary))
        here = foreign_process.read_arrays(str(file))
        gmsh.finalize()
        there = in_another_process(file)
        assert here.keys() == there.keys()
        assert list(there["names"]) == ["left", "right", "front", "back", "bottom", "top", "body"]
        for name, array in here.items():
            assert array.dtype == there[name].dtype
            np.testing.assert_array_equal(array, there[name])


def test_it_is_no_rank_and_has_no_home(monkeypatch, tmp_path, mesh):
    """Of mpirun it knows nothing, or it would wait for the others."""
    for name in ("OMPI_COMM_WORLD_RANK", "PMIX_RANK", "PRTE_LAUNCHED", "PMI_RANK"):
        monkeypatch.setenv(name, "1")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    there = instead(monkeypatch, tmp_path, "sys.exit(' '.join([*os.environ, os.environ['HOME'], *sys.path]))", mesh)
    assert not any(word.startswith(foreign_file.LAUNCHER_VARIABLES) for word in there.split())
    assert os.devnull in there.split()
    assert str(tmp_path) not in there.removeprefix(f"mesh file {mesh}").split()


def instead(monkeypatch, tmp_path, does, mesh):
    """What is told of a process that does something else."""
    script = tmp_path / "script.py"
    script.write_text(f"import os, signal, sys, time\n{does}\n")
    monkeypatch.setattr(foreign_file, "foreign_process", SimpleNamespace(__file__=str(script)))
    with pytest.raises(MeshError) as caught:
        read_mesh(mesh, {})
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize(
    ("does", "told"),
    [
        ("os.kill(os.getpid(), signal.SIGSEGV)", r"Gmsh could not read it (signal 11: Segmentation fault)"),
        ("os.abort()", r"Gmsh could not read it (signal 6: Aborted)"),
        ("time.sleep(60)", r"Gmsh could not read it (it went on for 1 s)"),
        ("sys.exit('this is no mesh')", r"Gmsh cannot read it: this is no mesh"),
        ("sys.exit(1)", r"Gmsh cannot read it: it does not say why"),
    ],
)
def test_its_bad_end_is_told_in_one_line(monkeypatch, tmp_path, mesh, does, told):
    monkeypatch.setattr(foreign_file, "BASE_TIMEOUT", 1.0 if "sleep" in does else 60.0)
    assert instead(monkeypatch, tmp_path, does, mesh) == f"mesh file {mesh}: {told}"


@pytest.mark.parametrize("number", [12, 215, 359])
def test_files_that_crash_gmsh_or_fill_the_memory_do_no_harm(tmp_path, number):
    """Of Gmsh 4.8: the first has it take 2 GiB, the others end it with signal 11."""
    mutated_meshes.prepare(tmp_path)
    file = tmp_path / "mutated.msh"
    file.write_bytes(mutated_meshes.mutated(np.random.default_rng([0, number]))[1])
    with pytest.raises(MeshError, match="Gmsh"):
        foreign_file.read_arrays(file)


def test_what_is_printed_there_is_no_part_of_the_mesh(monkeypatch, tmp_path, mesh):
    script = tmp_path / "chatters.py"
    script.write_text(
        f"import os, sys\nsys.path.insert(0, {str(Path(foreign_process.__file__).parent)!r})\nimport foreign_process\n"
        "found = foreign_process.read_arrays\n"
        "def chatters(file):\n    os.write(1, b'Info    : Reading ...')\n    return found(file)\n"
        "foreign_process.read_arrays = chatters\nforeign_process.main()\n"
    )
    whole = read_mesh(mesh, {})
    monkeypatch.setattr(foreign_file, "foreign_process", SimpleNamespace(__file__=str(script)))
    np.testing.assert_array_equal(read_mesh(mesh, {}).cells, whole.cells)


def test_its_memory_is_limited(monkeypatch, tmp_path, mesh):
    """By what 2 GiB of a file of some kilobytes would break."""
    folder = str(Path(foreign_process.__file__).parent)
    hogs = f"sys.path.insert(0, {folder!r})\nimport foreign_process, numpy\n"
    hogs += "foreign_process.read_arrays = lambda file: {'much': numpy.empty(2**28)}\nforeign_process.main()"
    assert "Gmsh cannot read it: Unable to allocate" in instead(monkeypatch, tmp_path, hogs, mesh)
