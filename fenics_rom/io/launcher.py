"""What mpirun says to the processes it starts; known before MPI is."""

import os

RANK_VARIABLES = ("OMPI_COMM_WORLD_RANK", "PMIX_RANK", "PMI_RANK")


def launched_rank() -> int | None:
    """Rank of this process, None where it was started alone."""
    ranks = (os.environ.get(name) for name in RANK_VARIABLES)
    return next((int(rank) for rank in ranks if rank is not None), None)


def is_root_process() -> bool:
    """Whether this process is the first that mpirun started, or the only one."""
    return not launched_rank()
