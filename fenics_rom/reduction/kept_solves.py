"""Solutions with K that took long, each in a file, so that a killed reduction goes on after the last of them.

They are found again by what was solved for, not by when: a solve that is not there is done.
"""

import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.io.hdf5 import Entry, get_record, put_arrays, read_file
from fenics_rom.io.mpi_ranks import is_rank_0
from fenics_rom.io.overwriting import write_over
from fenics_rom.system.columns import apply_to_complex, probe_columns
from fenics_rom.system.protocols import EXACT, Algebra, Factor

SECONDS = 2.0  # that a solve takes, from which on it is kept
MOST_BYTES = 3e8  # of a solution that is kept: it is gathered, and packed in memory
PROBES = 2
SAME = 1e-9  # largest difference of right-hand sides that are the same, as a share of the largest of a column's probes
CONTENT = "solve"
TABLE = {
    "probe": Entry("1", ("probes",)),
    "right": Entry("1", (PROBES, "c")),
    "accuracy": Entry("1", (1,)),
    "solution": Entry("1", ("n", "c")),
}


class KeptSolves:
    """A factor whose long solves are kept in a folder, and not done again where they are there.

    Args:
        factor: of K.
        algebra: of the ranks.
        folder: for the files solve-N.h5.
        probe: numbers of the system, which files of another one have not.
        resume: whether to look for what is there.

    Attributes:
        found: how many solutions were there.
    """

    def __init__(self, factor: Factor, algebra: Algebra, folder: Path, probe: Array, resume: bool):
        self._factor, self._algebra, self._folder, self._probe = factor, algebra, folder, probe
        self.notice, self._kept, self._written = factor.notice, list[tuple[Path, Array, float]](), 0
        while resume and (file := self._file(self._written)).exists():
            right, accuracy, is_same = read_file(file, CONTENT, self._heading)
            if is_same:
                self._kept.append((file, right, accuracy))
            self._written += 1
        self.found = len(self._kept)

    def solve(self, block: Array, accuracy: float = EXACT) -> Array:
        """As of the factor."""
        if np.iscomplexobj(block):
            return apply_to_complex(lambda columns: self.solve(columns, accuracy), block)
        right = self._algebra.inner(probe_columns(self._algebra, PROBES), block)
        for file, of_file, of_accuracy in self._kept:
            if of_accuracy <= accuracy and of_file.shape == right.shape and _is_same(of_file, right):
                whole: Array = read_file(file, CONTENT, lambda h5: get_record(h5, TABLE)["solution"])
                return np.ascontiguousarray(whole[self._algebra.rows()])
        start = time.monotonic()
        solution = self._factor.solve(block, accuracy)
        took = float(self._algebra.maximum(time.monotonic() - start))
        bytes_of_all = float(self._algebra.total(solution.nbytes))
        if took >= SECONDS and bytes_of_all <= MOST_BYTES:
            self._write(right, accuracy, self._algebra.gather(solution))
        return solution

    def apply(self, right: Any, solution: Any) -> None:
        """As of the factor: one vector of those that eigenpairs take one after another, of which nothing is kept."""
        one_by_one: Any = self._factor  # of the ranks' library, whose vectors these are
        one_by_one.apply(right, solution)

    def forget(self) -> None:
        """Removes what is kept, as what it was for is finished."""
        for number in range(self._written if is_rank_0() else 0):
            self._file(number).unlink(missing_ok=True)
        self._kept, self._written = [], 0

    def close(self) -> None:
        """Frees the factor."""
        self._factor.close()

    def _file(self, number: int) -> Path:
        return self._folder / f"solve-{number}.h5"

    def _heading(self, h5: Any) -> tuple[Array, float, bool]:
        a = get_record(h5, TABLE)
        same = a["probe"].shape == self._probe.shape and np.allclose(a["probe"], self._probe, rtol=SAME, atol=0)
        return a["right"], float(a["accuracy"]), bool(same)

    def _write(self, right: Array, accuracy: float, solution: Array) -> None:
        arrays = {"probe": self._probe, "right": right, "accuracy": accuracy, "solution": solution}
        write_over(self._file(self._written), CONTENT, lambda h5: put_arrays(h5, TABLE, {}, arrays))
        self._written += 1  # not to be looked for in this run, as other ranks may be ahead of the one that writes


def _is_same(one: Array, other: Array) -> bool:
    return bool((np.abs(one - other) <= SAME * np.abs(one).max(axis=0, initial=0.0)).all())
