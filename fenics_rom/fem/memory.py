"""How much memory there is."""

import math
from pathlib import Path
from typing import Any

from mpi4py import MPI

CGROUPS = Path("/sys/fs/cgroup")
# limit, usage and reclaimable file cache of a control group, version 2 and version 1
CGROUP_FILES = (
    ("memory.max", "memory.current", "inactive_file"),
    ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"),
)


def free_bytes() -> float:
    """Memory of this machine that may still be taken, within the limits of containers; infinite if nobody knows."""
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
        groups = Path("/proc/self/cgroup").read_text().splitlines()
    except OSError:  # not Linux
        return math.inf
    available = next((int(line.split()[1]) * 1024 for line in lines if line.startswith("MemAvailable:")), math.inf)
    return min([available, *(group_free_bytes(CGROUPS, line) for line in groups)])


def group_free_bytes(root: Path, group: str) -> float:
    """What a control group and those above it leave; `group` is a line of /proc/self/cgroup, as "0::/user.slice"."""
    _, controllers, path = group.split(":", 2)
    if "memory" in controllers.split(","):
        root = root / "memory"
    elif controllers:
        return math.inf
    innermost = root / path.lstrip("/")
    return min(_folder_free_bytes(folder) for folder in (innermost, *innermost.parents) if folder.is_relative_to(root))


def _folder_free_bytes(folder: Path) -> float:
    for limit, usage, cache in CGROUP_FILES:
        try:
            allowed = (folder / limit).read_text().strip()
            used = int((folder / usage).read_text())
            statistics = dict(line.split() for line in (folder / "memory.stat").read_text().splitlines())
        except OSError:  # no such group from where this process stands, or it has no limits
            continue
        return math.inf if allowed == "max" else int(allowed) - used + int(statistics.get(cache, 0))
    return math.inf


def needed_and_free_bytes(comm: Any, needed: float) -> tuple[float, float]:
    """Bytes `needed` by the ranks and free on the machine where they are tightest; every rank must call it."""
    machine = comm.Split_type(MPI.COMM_TYPE_SHARED)
    total, free = machine.allreduce(needed), free_bytes()
    machine.Free()
    _, total, free = comm.allreduce((total - free, total, free), MPI.MAX)
    return total, free
