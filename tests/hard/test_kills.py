"""Commands that are ended, or find no room, leave an old output, a new one or none; kills.py does it at any instant."""

import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import kills
import pytest

import fenics_rom as fr

DATA = Path(__file__).parents[1] / "data"
HALFWAY = """
import io, os, pathlib, signal, sys
from fenics_rom.io import hdf5
from fenics_rom.cli.main import main
place, sent = sys.argv.pop(1), signal.Signals[sys.argv.pop(1)]
def end():
    if hdf5.is_rank_0():
        os.kill(os.getpid(), sent)
class Half(io.FileIO):
    def write(self, data):
        super().write(data[: len(data) // 2])
        end()
        return super().write(data[len(data) // 2 :])
def before_and_after(replace):
    def instead(path, target):
        if str(target).endswith("new.h5") and place == "before": end()
        replace(path, target)
        if str(target).endswith("new.h5") and place == "after": end()
        return path
    return instead
pathlib.Path.replace = before_and_after(pathlib.Path.replace)
if place == "half":
    os.fdopen = lambda handle, mode: Half(handle, "wb")
main()
"""


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("inputs")
    kills.prepare(folder)
    return folder


@pytest.fixture
def inside(inputs, tmp_path):
    return Path(shutil.copytree(inputs, tmp_path / "work"))


def run(line, folder):
    return subprocess.run(line, cwd=folder, env=kills.ENVIRONMENT, capture_output=True, text=True, timeout=100)


@pytest.mark.parametrize(
    ("name", "sent", "place", "old"),
    [
        ("simulate", "SIGKILL", "half", True),
        ("simulate", "SIGKILL", "before", False),
        ("simulate", "SIGKILL", "after", True),
        ("simulate", "SIGINT", "half", True),
        *(
            pytest.param(*choice, marks=pytest.mark.slow)
            for choice in (
                ("simulate", "SIGKILL", "half", False),
                ("simulate", "SIGKILL", "before", True),
                ("simulate", "SIGKILL", "after", False),
                ("simulate", "SIGTERM", "half", True),
                ("reduce", "SIGKILL", "before", True),
                ("reduce", "SIGKILL", "after", False),
            )
        ),
    ],
)
def test_end_while_the_output_is_written(inside, name, sent, place, old):
    command = kills.COMMANDS[name]
    before = DATA / ("rom-1.2.h5" if name == "reduce" else "run-1.2.h5")
    if old:
        shutil.copy(before, inside / "new.h5")
    words = [sys.executable, "-c", HALFWAY, place, sent, *command.words]
    ended = run(words, inside)
    assert ended.returncode == (1 if sent == "SIGINT" else -signal.Signals[sent])
    assert ended.stderr == ("fenics-rom: error: interrupted\n" if sent == "SIGINT" else "")
    part = list(inside.glob(".new.h5.*.part"))
    assert len(part) == (sent != "SIGINT" and place != "after")
    if place == "after":
        assert kills.whole(inside / "new.h5")
    elif old:
        assert (inside / "new.h5").read_bytes() == before.read_bytes()
    else:
        assert not (inside / "new.h5").exists()
    again = run(command.line(*(["--resume"] if command.resumes else [])), inside)
    assert (again.returncode, again.stderr) == (0, "")
    assert kills.whole(inside / "new.h5")
    assert not (inside / "new.h5.partial").exists()


@pytest.mark.slow
@pytest.mark.parametrize(("name", "count"), [("reduce", 2), ("study", 1)])
def test_end_at_some_instants(inputs, name, count):
    outcomes, wrong = kills.campaign(name, inputs, count, seed=0)
    assert wrong == []
    assert sum(came for outcome, came in outcomes.items() if outcome.endswith(" output")) == count


@pytest.mark.alone
@pytest.mark.parametrize("rank", [0, 1])
def test_rank_that_is_killed_alone_ends_the_other(inside, rank):
    command = kills.COMMANDS["simulate-full-2"]
    status, _ = kills.end(command, inside, 0.7, signal.SIGKILL, rank)
    assert status != 0
    assert kills.flaws(command, inside) == []


def test_two_that_write_one_file_do_not_mix(inside):
    """Again and again, while a third reads: it finds one of both, whole."""
    script = """
import sys, fenics_rom as fr
from dataclasses import replace
rom = replace(fr.read_rom("rom.h5"), name=sys.argv[1])
for _ in range(10):
    fr.write_rom("new.h5", rom)
"""
    writers = [
        subprocess.Popen([sys.executable, "-c", script, name], cwd=inside, env=kills.ENVIRONMENT)
        for name in ("one", "other")
    ]
    seen = set()
    while any(writer.poll() is None for writer in writers):
        if (inside / "new.h5").exists():
            seen.add(fr.read_rom(inside / "new.h5").name)
        time.sleep(1e-3)
    assert [writer.returncode for writer in writers] == [0, 0]
    assert seen <= {"one", "other"}
    assert seen
    assert not list(inside.glob(".new.h5*"))


def test_two_runs_of_one_command_at_a_time_leave_one_of_both(inside):
    """With other forces: the result is that of one of them."""
    orders = ("2", "3")
    line = kills.COMMANDS["reduce"].line("--order")
    started = [
        subprocess.Popen(
            [*line, order], cwd=inside, env=kills.ENVIRONMENT, stderr=subprocess.PIPE, stdout=subprocess.PIPE
        )
        for order in orders
    ]
    said = [one.communicate()[1].decode() for one in started]
    assert any(one.returncode == 0 for one in started), said
    rom = fr.read_rom(inside / "new.h5")
    assert len({mode.order for mode in rom.contact_models.values()}) == 1
    for one, words in zip(started, said, strict=True):
        assert one.returncode == 0 or words.count("\n") == 1, words


MOUNTED = ("unshare", "-m", "sh", "-c")


def may_mount():
    return bool(shutil.which("unshare")) and subprocess.run([*MOUNTED, "true"], capture_output=True).returncode == 0


@pytest.mark.skipif(not may_mount(), reason="takes root")
@pytest.mark.parametrize(
    "name",
    [
        "reduce",
        "simulate",
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("simulate-full", "study", "identify")),
    ],
)
@pytest.mark.parametrize(
    ("options", "reasons"),
    [("size=32k", ("No space left on device",)), ("ro", ("Read-only file system", "no permission to write in"))],
    ids=["full", "read-only"],
)
def test_disk_that_is_full_or_read_only_is_told_in_one_line(inside, name, options, reasons):
    """Mounted for this process alone; what is left there is listed before it goes."""
    command = kills.COMMANDS[name]
    place = inside / "place"
    place.mkdir()
    words = [f"place/{word}" if word == command.output else word for word in command.words]
    script = f'mount -t tmpfs -o {options} none place && "$@"; status=$?; ls -A1s place >&3; exit $status'
    listed = inside / "listed"
    ended = run([*MOUNTED, f"exec 3>{listed}; {script}", "sh", *kills.PROGRAM, *words], inside)
    assert ended.returncode == 1, ended.stderr
    assert ended.stderr.count("\n") == 1, ended.stderr
    assert ended.stderr.startswith("fenics-rom: error: ")
    assert any(reason in ended.stderr for reason in reasons)
    left = [line.split()[-1] for line in listed.read_text().splitlines()[1:]]
    if name in ("reduce", "simulate-full", "simulate"):
        assert [file for file in left if file != "new.h5.partial"] == []


def test_outcomes_of_the_campaign_are_seen(inside):
    """Half a file of each kind is found."""
    command = kills.COMMANDS["study"]
    (inside / "studied").mkdir()
    for name, content in {
        "reference.h5": (DATA / "run-1.2.h5").read_bytes()[:9000],
        "study.json": b'{"rows": [',
        "study.md": b"# half",
        "speed.png": b"\x89PNG\r\n",
        "speed.pdf": b"%PDF-1.4\n",
    }.items():
        (inside / "studied" / name).write_bytes(content)
    assert len(kills.flaws(command, inside)) == 5
    (inside / "studied" / "study.md").write_text("# whole\n")
    assert len(kills.flaws(command, inside)) == 4
    (inside / "stray").touch()
    known = {str(file.relative_to(inside)) for file in inside.rglob("*")} - {"stray"}
    assert kills.strays(command, inside, known) == ["stray"]
