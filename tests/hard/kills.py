"""Ends commands at random instants, and looks at what they leave.

python tests/hard/kills.py --count 50 --seed 0 [--commands reduce study ...]

Each command runs in a folder that holds its inputs, and in every second case the complete output of an earlier run. It,
or one of its two ranks, gets SIGKILL, SIGINT or SIGTERM somewhere between its first instant and the time that it takes.
Then every file of its output must be a whole one, old or new; and the command, run again (with --resume where it has
that), must succeed and leave nothing but its output.
"""

import argparse
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import fenics_rom as fr
from fenics_rom.errors import FenicsRomError
from fenics_rom.io.hdf5 import content_of
from fenics_rom.studies.json_record import read_record
from fenics_rom.studies.study_results import StudyResults

sys.path.append(str(Path(__file__).parents[1]))
from bodies import box_arrays, scene_text, write_arrays
from ranks import MPIRUN, children

PROGRAM = [sys.executable, "-m", "fenics_rom"]
PATIENCE = 100.0  # s for a command, or for ranks to follow one that was killed
ENVIRONMENT = dict(os.environ)  # without what MPI sets for this process
SIGNALS = (signal.SIGKILL, signal.SIGINT, signal.SIGTERM)
PLACES = 8


@dataclass(frozen=True)
class Command:
    """A command line, and the file or folder it writes."""

    words: tuple[str, ...]
    output: str
    resumes: bool = False
    ranks: int = 1

    def line(self, *more: str) -> list[str]:
        """All words of it."""
        return [*((*MPIRUN, str(self.ranks)) if self.ranks > 1 else ()), *PROGRAM, *self.words, *more]


COMMANDS = {
    "reduce": Command(("reduce", "box.toml", "-o", "new.h5"), "new.h5", resumes=True),
    "simulate-full": Command(("simulate", "box.toml", "-o", "new.h5"), "new.h5"),
    "simulate": Command(("simulate", "rom.h5", "-o", "new.h5"), "new.h5"),
    "study": Command(
        ("study", "box.toml", "-o", "studied", "--methods", "balanced", "--orders", "2", "4", "--steps", "1e-2"),
        "studied",
        resumes=True,
    ),
    "identify": Command(("identify", "box.toml", "--data", "rest.csv", "-o", "found"), "found"),
    "reduce-2": Command(("reduce", "box.toml", "-o", "new.h5"), "new.h5", resumes=True, ranks=2),
    "simulate-full-2": Command(("simulate", "box.toml", "-o", "new.h5"), "new.h5", ranks=2),
}


def prepare(folder: Path) -> None:
    """Inputs of all commands: a scene of a box that can be touched at eight places, its ROM, markers at rest."""
    write_arrays(folder / "box.msh", *box_arrays((1.0, 0.4, 0.3), (5, 2, 2)))
    contacts = "\n".join(
        f"[contacts.place{k}]\nnear = {{ point = [{(k + 1.5) / 9:.4f}, 0.2, 0.3], radius = 0.2 }}"
        for k in range(PLACES)
    )
    run = 'dt = 1e-2\nduration = 0.4\nload = [{ contact = "place7", stop = 0.2, force = [0.0, 0.0, 1.0] }]'
    parts = {"outputs.tip": "points = [[1.0, 0.4, 0.3]]", "run": run, "reduction": "order = 6"}
    (folder / "box.toml").write_text(scene_text(Path("box.msh"), contacts=contacts, **parts))
    subprocess.run([*PROGRAM, "reduce", "box.toml", "-o", "rom.h5"], cwd=folder, check=True, stdout=subprocess.DEVNULL)
    system = fr.assemble(fr.read_scene(folder / "box.toml"))
    K = system.stiffness @ np.eye(system.size)
    C = next(iter(system.outputs.values()))
    tip = C.T @ np.linalg.solve(K, system.contacts["place7"])
    rows = [f"place7,{f},0,0,{','.join(map(repr, (tip @ [f, 0, 0]).tolist()))}" for f in (1.0, 2.0, 3.0)]
    rows += [f"place7,0,0,{f},{','.join(map(repr, (tip @ [0, 0, f]).tolist()))}" for f in (0.1, 0.2, 0.3)]
    heading = "contact,force.x (N),force.y (N),force.z (N),tip.x (m),tip.y (m),tip.z (m)"
    (folder / "rest.csv").write_text("\n".join([heading, *rows]) + "\n")


def run(command: Command, folder: Path, *more: str) -> subprocess.CompletedProcess[str]:
    """The command to its end."""
    return subprocess.run(
        command.line(*more), cwd=folder, capture_output=True, text=True, timeout=PATIENCE, env=ENVIRONMENT
    )


def end(command: Command, folder: Path, after: float, sent: signal.Signals, rank: int = 0) -> tuple[int, str]:
    """Starts a command, sends a signal to it, or to one of its ranks as soon as it is there, after so many seconds.

    Returns:
        Its status and last words.

    Raises:
        subprocess.TimeoutExpired: it, or what is left of its ranks, went on.
    """
    with tempfile.TemporaryFile("w+") as errors:
        started = subprocess.Popen(
            command.line(),
            cwd=folder,
            stdout=subprocess.DEVNULL,
            stderr=errors,
            start_new_session=True,
            env=ENVIRONMENT,
        )
        try:
            time.sleep(after)
            while started.poll() is None:
                with_pid = started.pid if command.ranks == 1 else _rank(started.pid, rank)
                if with_pid is not None:
                    os.kill(with_pid, sent)
                    break
                time.sleep(0.01)
            status = started.wait(PATIENCE)
        finally:
            if started.poll() is None:
                os.killpg(started.pid, signal.SIGKILL)
        errors.seek(0)
        return status, errors.read()


def _rank(launcher: int, rank: int) -> int | None:
    """Process of a rank that a launcher started; None where it has not."""
    python = [pid for pid in children(launcher) if _is_python(pid)]
    return python[rank] if rank < len(python) else None


def _is_python(pid: int) -> bool:
    try:
        return b"fenics_rom" in Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return False


def flaws(command: Command, folder: Path) -> list[str]:
    """What of the output is there and not whole."""
    place = folder / command.output
    files = [place] if place.is_file() else sorted(place.iterdir()) if place.is_dir() else []
    return [f"{file.name} is not whole" for file in files if not file.name.endswith(".part") and not whole(file)]


def whole(file: Path) -> bool:
    """Whether a file is all that a command writes under its name."""
    try:
        match file.suffix:
            case ".h5":
                (fr.read_rom if content_of(file) == "rom" else fr.read_trajectory)(file)
            case ".json":
                read_record(file, StudyResults, "a study")
            case ".toml":
                return "[run]" in file.read_text() and bool(fr.read_scene(file).contacts)
            case ".png":
                return file.read_bytes()[-8:-4] == b"IEND"
            case ".pdf":
                return file.read_bytes().rstrip().endswith(b"%%EOF")
            case _:
                return file.read_bytes().endswith(b"\n")
    except FenicsRomError:
        return False
    return True


def strays(command: Command, folder: Path, inputs: set[str]) -> list[str]:
    """Files beside inputs and output."""
    found = {str(file.relative_to(folder)) for file in folder.rglob("*") if file.is_file()} - inputs
    return sorted(
        name
        for name in found
        if name.endswith(".part") or not (name == command.output or name.startswith(f"{command.output}/"))
    )


def case(
    command: Command, inputs: Path, complete: Path, after: float, sent: signal.Signals, old: bool, rank: int
) -> tuple[list[str], list[str]]:
    """Outcomes of one case, and what is wrong."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(shutil.copytree(inputs, Path(name) / "run"))
        known = {str(file.relative_to(folder)) for file in folder.rglob("*")}
        if old:
            copy = shutil.copytree if complete.is_dir() else shutil.copy
            copy(complete, folder / command.output)
        before = _bytes(folder / command.output)
        try:
            status, said = end(command, folder, after, sent, rank)
        except subprocess.TimeoutExpired:
            return [], [f"goes on for {PATIENCE:g} s after {sent.name}"]
        wrong = flaws(command, folder)
        left = strays(command, folder, known)
        there = (folder / command.output).exists()
        outcomes = ["ended in time" if status == 0 else sent.name]
        if status and sent == signal.SIGINT and "Traceback" in said:
            outcomes.append("SIGINT with a traceback")
        if status and command.ranks > 1 and not there and old:
            wrong.append("the old output is gone")
        if status == 0 and not there:
            wrong.append("it says that it is done, and there is no output")
        if old and not there:
            wrong.append("the old output is gone")
        changed = _bytes(folder / command.output) != before
        outcomes.append("new output" if changed and there else "old output" if there else "no output")
        if any(stray.endswith(".part") for stray in left):
            outcomes.append("a .part is left")
        again = run(command, folder, *(["--resume"] if command.resumes else []))
        if again.returncode:
            wrong.append(f"again: {again.stderr.strip()[-300:]}")
        wrong += [f"again: {flaw}" for flaw in flaws(command, folder)]
        left = [stray for stray in strays(command, folder, known) if not stray.endswith(".part")]
        wrong += [f"again: leaves {stray}" for stray in left]
        return outcomes, wrong


def _bytes(place: Path) -> dict[str, bytes]:
    files = [place] if place.is_file() else place.rglob("*") if place.is_dir() else []
    return {str(file): file.read_bytes() for file in files if file.is_file()}


def campaign(name: str, inputs: Path, count: int, seed: int) -> tuple[Counter[str], list[str]]:
    """A command at many instants: how often each outcome came, and what was wrong."""
    command, random = COMMANDS[name], np.random.default_rng([seed, *name.encode()])
    outcomes: Counter[str] = Counter()
    wrong: list[str] = []
    with tempfile.TemporaryDirectory() as work:
        folder = Path(shutil.copytree(inputs, Path(work) / "whole"))
        times = []
        for _ in range(2):  # the shorter time: what is slow only once would put the end behind the command's
            start = time.monotonic()
            done = run(command, folder)
            times.append(time.monotonic() - start)
            assert done.returncode == 0, done.stderr
        for number in range(count):
            share = random.uniform(0.2, 1.0) if random.random() < 0.7 else random.uniform(0, 1.1)
            sent = SIGNALS[random.choice(len(SIGNALS), p=[0.6, 0.25, 0.15])]
            old, rank = bool(number % 2), int(random.integers(command.ranks))
            came, flawed = case(command, inputs, folder / command.output, share * min(times), sent, old, rank)
            outcomes.update(came)
            wrong += [f"{name} {number} ({sent.name} after {share * min(times):.2f} s): {flaw}" for flaw in flawed]
    return outcomes, wrong


def main() -> None:
    """See above."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--commands", nargs="+", choices=COMMANDS, default=list(COMMANDS))
    choice = parser.parse_args()
    failed = False
    with tempfile.TemporaryDirectory() as name:
        inputs = Path(name) / "inputs"
        inputs.mkdir()
        prepare(inputs)
        for command in choice.commands:
            outcomes, wrong = campaign(command, inputs, choice.count, choice.seed)
            print(f"{command}: {', '.join(f'{count} {outcome}' for outcome, count in outcomes.most_common())}")
            print(*wrong, sep="\n", flush=True)
            failed = failed or bool(wrong)
    sys.exit(failed)


if __name__ == "__main__":
    main()
