"""Virtual environments for the peers, each its own, and what runs in them."""

import json
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).parent
PYTHON = "/usr/bin/python3"
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}

Task = dict[str, Any]
Found = dict[str, Any]


class PeerError(Exception):
    """A peer cannot be installed, or its worker failed; the message is one line for a table."""


def environment(name: str, folder: Path, python: str = PYTHON) -> Path:
    """The interpreter of a virtual environment with what requirements-NAME.txt pins, made if it is not there.

    Args:
        name: of the peer.
        folder: where environments are kept.
        python: whose `venv` makes it.

    Raises:
        PeerError: it cannot be made.
    """
    requirements = HERE / f"requirements-{name}.txt"
    place = folder / f"env-{name}"
    made_from, interpreter = place / "made-from", place / "bin" / "python"
    wanted = f"{python}\n{requirements.read_text()}"
    if made_from.is_file() and made_from.read_text() == wanted:
        return interpreter
    shutil.rmtree(place, ignore_errors=True)
    _run([python, "-m", "venv", str(place)], f"{name} cannot be installed")
    install = [str(interpreter), "-m", "pip", "install", "-q", "--disable-pip-version-check", "-r", str(requirements)]
    _run(install, f"{name} cannot be installed")
    made_from.write_text(wanted)  # last: an environment without it is half-made, and made again
    return interpreter


def ask(interpreter: Path, worker: str, given: Path, result: Path, task: Task) -> Found:
    """What a worker finds: arrays by name.

    Args:
        interpreter: of the peer's environment.
        worker: name of its script.
        given: file with what it works on.
        result: file that it writes.
        task: what it is to do, handed over as JSON.

    Raises:
        PeerError: it failed.
    """
    command = [str(interpreter), str(HERE / worker), str(given.resolve()), str(result.resolve()), json.dumps(task)]
    _run(command, f"{worker} failed", cwd=given.parent)  # where MuJoCo may write its log
    with np.load(result) as found:
        return dict(found)


def _run(command: list[str], what: str, cwd: Path | None = None) -> None:
    """Runs a command; what it says last is the reason if it fails."""
    try:
        done = subprocess.run(command, env=os.environ | ONE_THREAD, capture_output=True, text=True, cwd=cwd)
    except OSError as error:
        raise PeerError(f"{what}: {error}") from error
    if done.returncode:
        said = [line.strip() for line in (done.stderr + done.stdout).splitlines() if line.strip()]
        raise PeerError(f"{what}: {(said or ['without a word'])[-1]}")
