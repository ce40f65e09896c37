"""Work that only rank 0 does, with its result or its error brought to every rank."""

from collections.abc import Callable
from typing import Any, TypeVar

T = TypeVar("T")


def run_on_rank_0(comm: Any, work: Callable[[], T]) -> T:
    """Result of `work`, done on rank 0, on every rank; what it raises is raised on every rank, so none waits."""
    result: T | None = None
    error: Exception | None = None
    if comm.rank == 0:
        try:
            result = work()
        except Exception as caught:
            error = caught
    error = comm.bcast(error, root=0)
    if error is not None:
        raise error
    shared: T = comm.bcast(result, root=0)
    return shared
