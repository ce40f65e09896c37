"""Programs on ranks of their own; of one that hangs, where every rank was."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

# A rank that waits gives way, or Open MPI 5 is ten times slower where ranks are more than cores. A process that is
# alone is not to: it would lose its core at each look for messages, of which MUMPS has thousands.
MPIRUN = ("mpirun", "-x", "OMPI_MCA_mpi_yield_when_idle=1", "-n")
PATIENCE = 900  # s; many times what any of them takes, for machines that do other work as well
_SIMULATE = """import sys
from fenics_rom.cli.main import main
for name in sys.argv[2:]:
    try:
        main(["simulate", name + ".toml", "-o", f"{name}-{sys.argv[1]}.h5"])
    except SystemExit as end:
        if end.code:
            raise
"""


def children(launcher: int) -> list[int]:
    """Processes that a process has started."""
    return [int(pid) for pid in Path(f"/proc/{launcher}/task/{launcher}/children").read_text().split()]


def run_ranks(ranks, *words, cwd=None, path=None, patience=PATIENCE):
    """`python WORD ...` on so many ranks, to its end; in the environment as it was before this process made itself one.

    One rank needs no launcher. Ranks that do not end are sent SIGABRT, at which each prints its traceback.
    """
    environment = os.environ | {"PYTHONFAULTHANDLER": "1"} | ({} if path is None else {"PYTHONPATH": str(path)})
    command = [*((*MPIRUN, str(ranks)) if ranks > 1 else ()), sys.executable, *map(str, words)]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, cwd=cwd, env=environment, text=True, stdout=pipe, stderr=pipe) as run:
        try:
            out, err = run.communicate(timeout=patience)
        except subprocess.TimeoutExpired:
            for rank in children(run.pid) or [run.pid]:
                os.kill(rank, signal.SIGABRT)
            out, err = run.communicate(timeout=PATIENCE)
            pytest.fail(f"{' '.join(command)}: not at its end after {patience} s\n{out}{err}")
        return subprocess.CompletedProcess(command, run.returncode, out, err)


def simulate_on_ranks(folder, *names):
    """Runs the scenes NAME.toml of a folder on one rank and on two: NAME-1.h5 and NAME-2.h5."""
    for ranks in (1, 2):
        done = run_ranks(ranks, "-c", _SIMULATE, ranks, *names, cwd=folder)
        assert done.returncode == 0, done.stdout + done.stderr
