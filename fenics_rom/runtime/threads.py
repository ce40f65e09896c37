"""Compiled loops over many bodies, dealt out to threads.

They are Python's own, as compiled loops leave its lock: numba's would want one of its layers, of which the one that is
always there ends the program where two threads ask it at once, and code of their own to compile.
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache

from numpy import ndarray as Array

from fenics_rom.compilation import thread_count

FEWEST, PARTS = 16, 4  # bodies that pay a call, and calls for each thread, as some bodies take longer than others


def deal_out(take: Callable[[Array], object], bodies: Array) -> None:
    """Calls `take` with parts of bodies (n,), in as many threads as numba would use (NUMBA_NUM_THREADS)."""
    threads = thread_count()
    size = max(FEWEST, -(-len(bodies) // (PARTS * threads)))
    parts = [bodies[first : first + size] for first in range(0, len(bodies), size)]
    if threads == 1 or len(parts) < 2:
        if len(bodies):
            take(bodies)
        return
    for _ in _workers().map(take, parts):
        pass


@cache
def _workers() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(thread_count(), "fenics_rom")


os.register_at_fork(after_in_child=_workers.cache_clear)  # which has none of these threads
