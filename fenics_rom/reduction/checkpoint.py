"""What a reduction has finished, contact mode by contact mode, in a folder, so that a killed run can go on.

Each finished contact mode is a file of its own: what it added to the shared space, and what it keeps of it. So is each
training run of a body that deforms largely, and, until a contact mode is finished, each solve with K that takes long.
The files do not depend on the number of ranks.
"""

import re
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import FileError
from fenics_rom.io.atomic_write import check_folder
from fenics_rom.io.hdf5 import (
    Entry,
    Table,
    get_record,
    get_text,
    is_sealed,
    put_arrays,
    put_text,
    read_file,
    sealed_content,
)
from fenics_rom.io.mpi_ranks import is_rank_0
from fenics_rom.io.overwriting import write_over
from fenics_rom.reduction.kept_solves import CONTENT as SOLVE_CONTENT
from fenics_rom.reduction.kept_solves import KeptSolves
from fenics_rom.reduction.problem import ReductionProblem
from fenics_rom.reduction.projection import RetainedBasis
from fenics_rom.system.columns import probe_columns

PROBE_TOLERANCE = 1e-9  # largest relative difference between probes of the same system
PART_FILE = re.compile(r"((run|solve)-)?\d+\.h5|\.((run|solve)-)?\d+\.h5\..*\.part")
PART_CONTENT, RUN_CONTENT = "part", "training run"
PART_CONTENTS = (PART_CONTENT, RUN_CONTENT, SOLVE_CONTENT)
PART = {
    "probe": Entry("1", ("probes",)),
    "eigenvectors": Entry("1", (1,), "i"),
    "basis": Entry("kg^-1/2", ("n", "new")),
    "span": Entry("1", ("k", "m")),
    "directions": Entry("1", ("k", "directions")),
    "hankel_singular_values": Entry("1", ("r",)),
    "left_inverse": Entry("1", ("m", "k"), optional=True),
}
RUN = {
    "probe": Entry("1", ("probes",)),
    "share": Entry("1", (1,)),
    "loads": Entry("1", ("l",)),
    "shapes": Entry("m", ("n", "s")),
    "seen": Entry("rad/s, then N or Pa", ("seen",), optional=True),
}


class Checkpoint:
    """Keeps finished contact modes in a folder; None keeps nothing.

    Whoever asked for it removes it (`remove_checkpoint`), when the ROM is safe. To `resume` is to go on from what is
    there, instead of removing it.
    """

    def __init__(self, folder: str | Path | None, problem: ReductionProblem, method: str, resume: bool):
        self._keeps, self._resume = folder is not None, resume
        self._solves: KeptSolves | None = None
        self._written_files = 0
        self._written_columns = 0  # of the shared space
        self._written_messages = len(problem.messages)  # with those that every run has
        if folder is None:
            return
        self._folder, self._probe = Path(folder), _probe(problem)
        p = problem
        choices = (method, p.order, p.tolerance, p.switching, p.weighting, p.lyapunov, p.share)
        self._choices = repr((*choices, p.system.size, p.contacts))
        if is_rank_0():
            check_folder(self._folder)
            if not resume:
                _remove_parts(self._folder)
                others = [file.name for file in self._folder.glob("*.h5") if PART_FILE.fullmatch(file.name)]
                if others:
                    raise FileError(
                        f"{self._folder}: holds {others[0]!r}, which no reduction left; give another folder"
                    )
            try:
                self._folder.mkdir(exist_ok=True)
            except OSError as error:
                raise FileError(f"{self._folder}: cannot be written: {error.strerror}") from error

    def with_kept_solves(self, problem: ReductionProblem) -> ReductionProblem:
        """The problem with a factor whose long solves are kept until a contact mode is finished."""
        if not self._keeps:
            return problem
        given = problem.factor, problem.system.algebra, self._folder, self._probe, self._resume
        self._solves = KeptSolves(*given)
        if self._solves.found:
            problem.stages.report("solves that took long", self._solves.found, self._solves.found)
        return replace(problem, factor=self._solves)

    def restored(self, problem: ReductionProblem) -> dict[str, RetainedBasis]:
        """Contact modes that are finished; the shared space is filled with what they are in.

        Raises:
            FileError: they belong to another system or other choices, or are damaged.
        """
        retained: dict[str, RetainedBasis] = {}
        while self._is_there(file := f"{self._written_files}.h5"):
            name, basis, eigenvectors, part, messages = read_file(self._folder / file, PART_CONTENT, self._read_part)
            problem.messages.extend(messages)
            problem.space.append(basis[problem.system.algebra.rows()])
            problem.space.eigenvectors = eigenvectors
            retained[name] = part
            self._written_files += 1
        self._written_columns, self._written_messages = problem.space.size, len(problem.messages)
        return retained

    def keep(self, problem: ReductionProblem, name: str, retained: RetainedBasis) -> None:
        """Writes a contact mode that is finished."""
        if not self._keeps:
            return
        new = problem.system.algebra.gather(np.ascontiguousarray(problem.space.basis[:, self._written_columns :]))
        arrays = {"probe": self._probe, "eigenvectors": problem.space.eigenvectors, "basis": new} | vars(retained)
        texts = {"name": name, "messages": "\n".join(problem.messages[self._written_messages :])}
        self._write(f"{self._written_files}.h5", PART_CONTENT, PART, arrays, choices=self._choices, **texts)
        if self._solves is not None:
            self._solves.forget()
        self._written_files += 1
        self._written_columns, self._written_messages = problem.space.size, len(problem.messages)

    def restored_run(self, number: int, title: str, loads: Array, rows: slice) -> tuple[float, Array, Array] | None:
        """Of a training run under such loads (l,) the share that was put on, shapes (rows here, s), and what was seen.

        None where it is not finished.

        Raises:
            FileError: it is of another system or of other loads, or damaged.
        """
        if not self._is_there(file := f"run-{number}.h5"):
            return None
        tolerance = PROBE_TOLERANCE * np.abs(loads).max()

        def read_shapes(h5: Any) -> tuple[float, Array, Array]:
            a = get_record(h5, RUN)
            same = get_text(h5, "title") == title and len(a["loads"]) == len(loads)
            same = same and np.allclose(a["loads"], loads, rtol=0, atol=tolerance)
            self._check_same(a["probe"], same)
            return a["share"], np.asarray(a["shapes"]), np.zeros(3) if a["seen"] is None else a["seen"]

        share, shapes, seen = read_file(self._folder / file, RUN_CONTENT, read_shapes)
        return share, shapes[rows], seen

    def keep_run(self, number: int, title: str, loads: Array, share: float, shapes: Array, seen: Array) -> None:
        """Writes a training run that is finished: the share of its loads, shapes on all rows (n, s), what was seen."""
        if self._keeps:
            arrays = {"probe": self._probe, "share": share, "loads": loads, "shapes": shapes}
            arrays["seen"] = seen if seen.any() else None
            self._write(f"run-{number}.h5", RUN_CONTENT, RUN, arrays, title=title)

    def _is_there(self, file: str) -> bool:
        return self._keeps and self._resume and (self._folder / file).exists()

    def _write(self, file: str, content: str, table: Table, arrays: Mapping[str, Any], **texts: str) -> None:
        def fill(h5: Any) -> None:
            put_text(h5, **texts)
            put_arrays(h5, table, {}, arrays)

        if is_rank_0():
            with suppress(OSError):  # another run of the same output removes the folder when it is done
                self._folder.mkdir(exist_ok=True)
        write_over(self._folder / file, content, fill)

    def _check_same(self, probe: Array, same_choices: bool) -> None:
        same_length = len(probe) == len(self._probe)
        if not (same_length and same_choices and np.allclose(probe, self._probe, rtol=PROBE_TOLERANCE, atol=0)):
            raise FileError("was made from another system or with other choices; start without resume")

    def _read_part(self, h5: Any) -> tuple[str, Array, int, RetainedBasis, list[str]]:
        a = get_record(h5, PART)
        self._check_same(a["probe"], get_text(h5, "choices") == self._choices)
        retained = RetainedBasis(**{name: a[name] for name in RetainedBasis.__dataclass_fields__})
        messages = list(filter(None, get_text(h5, "messages").split("\n")))
        return get_text(h5, "name"), a["basis"], a["eigenvectors"], retained, messages


def remove_checkpoint(folder: Path) -> None:
    """Removes what a checkpoint wrote, half-written files included, and the folder where it holds nothing else."""
    if is_rank_0() and folder.is_dir():
        _remove_parts(folder)
        with suppress(OSError):  # it holds something else, or another run was faster
            folder.rmdir()


def _remove_parts(folder: Path) -> None:
    for file in list(folder.glob("*")) if folder.is_dir() else ():
        if PART_FILE.fullmatch(file.name) and _is_ours(file):
            file.unlink(missing_ok=True)


def _is_ours(file: Path) -> bool:
    """Whether a file of such a name is a checkpoint's, perhaps a damaged one, and no run or ROM of somebody's."""
    try:
        return file.suffix == ".part" or (is_sealed(file) and sealed_content(file) in PART_CONTENTS)
    except FileError:
        return True


def _probe(problem: ReductionProblem) -> Array:
    """Numbers that two systems share only when they are the same."""
    system = problem.system
    z = probe_columns(system.algebra, 1)
    inner = system.algebra.inner

    def size(blocks: Iterable[Array]) -> float:
        return float(sum(np.abs(inner(z, block)).sum() for block in blocks))

    of_forces = [size(system.forces(name, some) for some in system.force_blocks(name)) for name in problem.contacts]
    forms = [inner(z, A @ z)[0, 0] for A in (system.mass, system.damping, system.stiffness)]
    return np.array([*forms, *of_forces, *(size([block]) for block in system.outputs.values())])
