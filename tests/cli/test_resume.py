"""Reductions that were killed, and what goes on from what they left."""

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from bodies import box_arrays, scene_text, write_arrays
from ranks import run_ranks
from rom_files import transfer

import fenics_rom as fr
from fenics_rom.cli.main import main
from fenics_rom.reduction.checkpoint import Checkpoint

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
PLACES = 8
COMMAND = ("reduce", "box.toml", "-o", "rom.h5")
RESUMED = re.compile(r"^  resumed: (\d+) of 8 contact modes were taken over$", flags=re.M)
KILLS_ITSELF = """
import os, signal
from fenics_rom.io.mpi_ranks import is_rank_0
from fenics_rom.cli.main import main
from fenics_rom.reduction.checkpoint import Checkpoint
keep = Checkpoint.keep
def keep_and_die(*arguments):
    keep(*arguments)
    if is_rank_0():
        os.kill(os.getpid(), signal.SIGKILL)
Checkpoint.keep = keep_and_die
main()
"""


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """A folder with the scene of a box that can be touched at eight places."""
    folder = tmp_path_factory.mktemp("scene")
    write_arrays(folder / "box.msh", *box_arrays((1.0, 0.4, 0.3), (9, 4, 3)))
    contacts = "\n".join(
        f"[contacts.place{k}]\nnear = {{ point = [{(k + 1.5) / 9:.4f}, 0.2, 0.3], radius = 0.15 }}"
        for k in range(PLACES)
    )
    reduction = 'lyapunov = "krylov"\norder = 10'
    outputs = {"outputs.tip": "points = [[1.0, 0.4, 0.3]]"}
    (folder / "box.toml").write_text(scene_text("box.msh", contacts=contacts, reduction=reduction, **outputs))
    return folder


@pytest.fixture(scope="module")
def expected(scene):
    """The ROM without any interruption."""
    return fr.reduce(fr.assemble(fr.read_scene(scene / "box.toml")))


@pytest.fixture(scope="module")
def killed(scene, tmp_path_factory):
    """What is left of a run that was killed as soon as something of it was finished."""
    folder = copied(scene, tmp_path_factory.mktemp("killed"))
    program = [Path(sys.executable).parent / "fenics-rom", *COMMAND]
    with subprocess.Popen(program, cwd=folder, env=dict(os.environ), stdout=subprocess.PIPE) as run:
        while run.poll() is None and not (folder / "rom.h5.partial" / "0.h5").exists():
            time.sleep(1e-3)
        run.send_signal(signal.SIGKILL)
    assert run.returncode == -signal.SIGKILL
    assert not (folder / "rom.h5").exists()
    return folder


def copied(source, target):
    return Path(shutil.copytree(source, target, dirs_exist_ok=True))


@pytest.fixture
def inside(killed, tmp_path, monkeypatch):
    """Works in a copy of what is left of the killed run."""
    monkeypatch.chdir(copied(killed, tmp_path))
    return tmp_path


@pytest.fixture
def say(capfd):
    """Runs a command in this process: its exit status and what it printed."""

    def run(*arguments):
        with pytest.raises(SystemExit) as end:
            main([*COMMAND, *arguments])
        return end.value.code, *capfd.readouterr()

    return run


def left():
    return {file.name: file.read_bytes() for file in Path("rom.h5.partial").iterdir() if file.suffix == ".h5"}


def same(rom, expected):
    assert list(rom.contact_models) == list(expected.contact_models)
    for name, mode in expected.contact_models.items():
        σ = mode.hankel_singular_values
        np.testing.assert_allclose(rom.contact_models[name].hankel_singular_values, σ, rtol=0, atol=1e-10 * σ[0])
        H = transfer(expected, name)
        np.testing.assert_allclose(transfer(rom, name), H, rtol=0, atol=1e-10 * np.abs(H).max())


def goes_on(say, expected):
    """Resumes with what is left, all of it, to the ROM that was expected."""
    finished = len(left())
    assert 1 <= finished <= PLACES
    status, out, err = say("--resume")
    assert (status, err) == (0, "")
    assert RESUMED.findall(out) == [str(finished)]
    same(fr.read_rom("rom.h5"), expected)


def test_killed_run_goes_on_to_the_same_rom(inside, say, expected):
    goes_on(say, expected)
    assert not Path("rom.h5.partial").exists()


@pytest.mark.ranks
def test_one_rank_goes_on_with_what_two_left(scene, tmp_path, monkeypatch, say, expected):
    monkeypatch.chdir(copied(scene, tmp_path))
    assert run_ranks(2, "-c", KILLS_ITSELF, *COMMAND).returncode != 0
    goes_on(say, expected)


def test_leftover_is_replaced_where_nobody_asks_for_it(inside, say):
    """It is of another order, so that reading it would be an error."""
    assert left()
    status, out, err = say("--order", "9")
    assert (status, err) == (0, "")
    assert "resumed" not in out
    assert {mode.order for mode in fr.read_rom("rom.h5").contact_models.values()} == {9}
    assert not Path("rom.h5.partial").exists()


@pytest.mark.parametrize(
    ("there", "instead", "options"),
    [
        ("", "", ("--order", "9")),
        ("", "", ("--weighting", "nodal")),
        ("young = 1.0e6", "young = 1.1e6", ()),
        ("place7", "last", ()),
    ],
)
def test_what_was_finished_of_something_else_is_refused_and_kept(inside, say, there, instead, options):
    before = left()
    (inside / "box.toml").write_text((inside / "box.toml").read_text().replace(there, instead))
    status, out, err = say("--resume", *options)
    assert (status, out) == (1, "")
    assert err == (
        "fenics-rom: error: rom.h5.partial/0.h5: was made from another system or with other choices; "
        "start without resume\n"
    )
    assert left() == before
    assert not (inside / "rom.h5").exists()


def test_damaged_part_is_told(inside, say):
    part = inside / "rom.h5.partial" / "0.h5"
    part.write_bytes(part.read_bytes()[:-9])
    status, out, err = say("--resume")
    assert (status, out) == (1, "")
    assert err == (
        "fenics-rom: error: rom.h5.partial/0.h5: is damaged: its content is not what was written "
        "(the checksum differs)\n"
    )


def test_what_is_finished_outlives_an_error(scene, tmp_path, monkeypatch, say, expected):
    """Such as too little memory for the validation."""
    monkeypatch.chdir(copied(scene, tmp_path))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("fenics_rom.reduction.reduce.assemble_rom", lambda *_, **__: np.empty(10**15))
        status, _, err = say()
    assert status == 1
    assert err.startswith("fenics-rom: error: not enough memory: ")
    assert len(left()) == PLACES
    status, out, _ = say("--resume")
    assert RESUMED.findall(out) == ["8"]
    same(fr.read_rom("rom.h5"), expected)


def test_error_before_anything_is_finished_leaves_nothing(scene, tmp_path, monkeypatch, say):
    monkeypatch.chdir(copied(scene, tmp_path))
    before = sorted(tmp_path.iterdir())
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Checkpoint, "restored", lambda *_: np.empty(10**15))
        assert say()[0] == 1
    assert sorted(tmp_path.iterdir()) == before


def test_nothing_to_go_on_from_is_a_beginning(scene, tmp_path, monkeypatch, say):
    monkeypatch.chdir(copied(scene, tmp_path))
    status, out, _ = say("--resume", "--order", "2", "--lyapunov", "auto")
    assert (status, RESUMED.findall(out)) == (0, ["0"])


def test_second_run_of_one_output_is_refused_while_the_first_lives(scene, tmp_path, monkeypatch, say):
    """However the first ends, it leaves nothing locked behind."""
    monkeypatch.chdir(copied(scene, tmp_path))
    program = [Path(sys.executable).parent / "fenics-rom", *COMMAND]
    with subprocess.Popen(program, env=dict(os.environ)) as first:
        while not Path("rom.h5.partial").exists():
            time.sleep(1e-3)
        time.sleep(0.1)  # from the folder to its lock
        first.send_signal(signal.SIGSTOP)
        status, out, err = say()
        first.send_signal(signal.SIGKILL)
    assert (status, out) == (1, "")
    assert err == "fenics-rom: error: rom.h5: another process is writing it; wait, or give another file\n"
    assert Path("rom.h5.partial").exists()
    assert say("--order", "2", "--lyapunov", "auto")[0] == 0
    assert not Path("rom.h5.partial").exists()


def test_file_in_the_place_of_the_folder_is_told_before_the_work(scene, tmp_path, monkeypatch, say):
    monkeypatch.chdir(copied(scene, tmp_path))
    (tmp_path / "box.toml").unlink()
    (tmp_path / "rom.h5.partial").write_text("mine")
    status, out, err = say()
    assert (status, out) == (1, "")
    assert err == "fenics-rom: error: rom.h5.partial: is needed for what is finished, but it is not a folder\n"
    assert (tmp_path / "rom.h5.partial").read_text() == "mine"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "kept", "said"), [("trained", 4, "4 of 11 training runs were"), ("modal+derivatives", 0, "nothing was")]
)
def test_large_deformation_with_contact_goes_on_and_says_with_what(tmp_path, monkeypatch, capfd, method, kept, said):
    """Without inertia, whose runs are equilibria; stopped as soon as so many of them are kept, or never begun."""
    write_arrays(tmp_path / "box.msh", *box_arrays((1.0, 0.2, 0.2), (3, 1, 1)))
    effects = {
        "effects": "gravity = { acceleration = [0.0, 0.0, -1e-3] }\nlarge_deformation = {}",
        "effects.contact": 'switching = "scene"',
        "effects.contact.obstacles.floor": 'shape = "half-space"\npoint = [0.0, 0.0, -0.01]\nnormal = [0.0, 0.0, 1.0]',
    }
    run = 'dt = 0.5\nduration = 1.0\nload = [{ contact = "right", force = [0.0, 0.0, 0.05] }]'
    text = scene_text(
        "box.msh", contacts='[contacts.right]\nsurface = "right"', run=run, reduction="order = 3", **effects
    )
    (tmp_path / "box.toml").write_text(text)
    monkeypatch.chdir(tmp_path)
    words = [*COMMAND, "--method", method]

    def reduced(*more):
        with pytest.raises(SystemExit) as end:
            main([*words, *more])
        said = capfd.readouterr()
        return end.value.code, said.out or said.err

    status, out = reduced()
    assert status == 0, out
    unbroken = fr.read_rom("rom.h5")
    with monkeypatch.context() as patch:
        keep = Checkpoint.keep_run

        def keep_and_stop(self, number, *rest):
            keep(self, number, *rest)
            if number + 1 == kept:
                raise KeyboardInterrupt

        patch.setattr(Checkpoint, "keep_run", keep_and_stop)
        if kept:
            assert reduced()[0] == 1
            assert len(left()) == kept
    status, out = reduced("--resume")
    assert status == 0
    assert out.endswith(f"  resumed: {said} taken over\n")
    rom = fr.read_rom("rom.h5")
    np.testing.assert_allclose(rom.stiffness, unbroken.stiffness, rtol=1e-8)
    np.testing.assert_allclose(rom.deformation.weights.sum(), unbroken.deformation.weights.sum(), rtol=1e-6)
    assert not Path("rom.h5.partial").exists()
