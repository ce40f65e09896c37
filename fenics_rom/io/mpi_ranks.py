"""Which of several processes this is: by what mpirun says, known before MPI is loaded, and by MPI itself."""

import os
import sys

RANK_VARIABLES = ("OMPI_COMM_WORLD_RANK", "PMIX_RANK", "PMI_RANK")


def launched_rank() -> int | None:
    """Rank of this process, None where it was started alone."""
    ranks = (os.environ.get(name) for name in RANK_VARIABLES)
    return next((int(rank) for rank in ranks if rank is not None), None)


def is_root_process() -> bool:
    """Whether this process is the first that mpirun started, or the only one."""
    return not launched_rank()


def is_rank_0() -> bool:
    """Whether this process is the one that writes. Only a program that uses MPI has ranks; the runtime needs none."""
    mpi = sys.modules.get("mpi4py.MPI")
    return mpi is None or mpi.COMM_WORLD.rank == 0
