"""Ranks that hang are ended, and say where."""

import pytest
from ranks import run_ranks

HANGS = """
from mpi4py import MPI
import time
def waits():
    MPI.COMM_WORLD.barrier()
def sleeps():
    time.sleep(1000)
waits() if MPI.COMM_WORLD.rank == 0 else sleeps()
"""


@pytest.mark.alone
@pytest.mark.slow
def test_ranks_that_hang_say_where():
    with pytest.raises(pytest.fail.Exception, match=r"not at its end after 10 s\n(.|\n)*in (waits|sleeps)"):
        run_ranks(2, "-c", HANGS, patience=10)
