"""Work that only rank 0 does, with its result or its error brought to every rank."""

from collections.abc import Callable
from typing import Any, TypeVar, cast

T = TypeVar("T")


def run_on_rank_0(comm: Any, work: Callable[[], T]) -> T:
    """Result of `work`, done on rank 0, on every rank; what it raises is raised on every rank, so none waits."""
    outcome: Any = None
    if comm.rank == 0:
        try:
            outcome = work(), None
        except Exception as caught:
            outcome = None, caught
    result, error = comm.bcast(outcome, root=0)
    if error is not None:
        raise error
    return cast(T, result)
