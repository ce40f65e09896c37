"""Anyone's PETSc matrices as parts of a system, measured as SciPy's are, by all ranks together.

What one rank finds wrong is raised on every rank, so none waits for another.
"""

from collections.abc import Callable, Mapping
from contextlib import closing
from functools import partial
from typing import Any

import numpy as np
import scipy.sparse
from mpi4py import MPI
from petsc4py import PETSc

from fenics_rom.errors import SolverError, StructureError
from fenics_rom.fem.direct import MemoryShortage, PetscFactor
from fenics_rom.fem.petsc_algebra import PetscAlgebra, require_real
from fenics_rom.fem.petsc_matrix import PetscMatrix, ZeroMatrix, combination, fix_dofs
from fenics_rom.fem.ranks import run_on_rank_0
from fenics_rom.system.body import Body
from fenics_rom.system.node_positions import body_of_matrices
from fenics_rom.system.rayleigh_damping import fitted_rayleigh
from fenics_rom.system.rigid_modes import (
    checked_rigid_columns,
    choose_fixed_dofs,
    found_motions,
    is_singular,
    motions_of_nodes,
    null_space_hint,
)
from fenics_rom.system.system import System
from fenics_rom.system.user_matrices import COLUMNS, MATRICES, SYMMETRY_TOLERANCE

DIFFERENT_PATTERN = PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN


def checked_fields(given: Mapping[str, Any]) -> dict[str, Any]:
    """As those of `fenics_rom.system.user_matrices`, by all ranks; the matrices that were given stay as they are."""
    require_real(PETSc.ScalarType)
    present = {name: given[name] for name in MATRICES if given[name] is not None}
    for name, matrix in present.items():
        if not isinstance(matrix, PETSc.Mat):
            kind = type(matrix).__name__
            raise StructureError(f"{name} is a {kind}, but others are PETSc matrices; use all of them or none")
    mass = present["mass"]
    comm = mass.comm.tompi4py()
    for name, matrix in present.items():
        _check_layout(name, matrix, mass)
    mats = {name: _symmetric_copy(name, matrix) for name, matrix in present.items()}
    warnings = [_check_definite("mass", mats["mass"].copy())]

    M, K = PetscMatrix(mats["mass"]), PetscMatrix(mats["stiffness"])
    algebra, rayleigh = PetscAlgebra(comm, mass.getOwnershipRange()), given["rayleigh"]
    body = body_of_matrices(given["nodes"], M, _diagonal(M), algebra)
    if given["rigid"] is not None:
        R = checked_rigid_columns(M, K, _checked_block(comm, given["rigid"], "rigid", M.local), algebra)
    else:
        R = motions_of_nodes(M, K, body, algebra) if len(body.nodes) else np.empty((M.local, 0))
    try:
        warnings.append(_check_stiffness(K, R, body, algebra))
    except StructureError:
        if given["rigid"] is not None or len(body.nodes):
            raise
        R = found_motions(M, K, lambda s: PetscMatrix(combination((1.0, K), (s, M))), algebra)
        if not R.shape[1]:
            raise
        warnings.append(_check_stiffness(K, R, body, algebra))
    D: PetscMatrix | ZeroMatrix
    if rayleigh is None:
        D = PetscMatrix(mats["damping"])
        rayleigh = fitted_rayleigh(M, D, K, algebra)
        if rayleigh is None or min(rayleigh) < 0:  # else it is semi-definite because M and K are
            warnings.append(_check_definite("damping", _shift_by_round_off(D.mat, M.mat)))
    else:
        α, β = rayleigh
        D = PetscMatrix(combination((α, M), (β, K))) if α or β else ZeroMatrix()
    return {
        **{"mass": M, "damping": D, "stiffness": K, "algebra": algebra, "body": body},
        **{kind: _checked_columns(comm, given[kind], kind, M.local) for kind in COLUMNS},
        **{"rayleigh": rayleigh, "rigid": R, "warnings": (*given["warnings"], *filter(None, warnings))},
    }


def refuse_together(comm: Any, complaint: str) -> None:
    """Raises on every rank what the first rank that complains has to say; empty complaints are none."""
    for rank, message in enumerate(comm.allgather(complaint)):
        if message:
            raise StructureError(f"{message} (rank {rank})" if comm.size > 1 else message)


def spread(
    read: Callable[[], tuple[dict[str, Any], dict[str, dict[str, Any]]]], together: int = 1
) -> tuple[dict[str, Any], ...]:
    """SciPy matrices by name and NumPy columns by kind and name, which rank 0 reads, with their rows spread.

    So many rows stay `together`, where their number is a multiple of it.
    """
    comm, parts = MPI.COMM_WORLD, []
    run_on_rank_0(comm, lambda: parts.append(read()))  # what was read stays on rank 0
    square, tall = parts[0] if parts else ({}, {})
    matrices = {name: _spread_matrix(comm, square.get(name), together) for name in comm.bcast(list(square), root=0)}

    def share(rank: int) -> dict[str, dict[str, np.ndarray]]:
        return {
            kind: {name: block[_rows_of(rank, comm.size, len(block), together)] for name, block in given.items()}
            for kind, given in tall.items()
        }

    return matrices, comm.scatter([share(rank) for rank in range(comm.size)], root=0)


def spread_system(read: Any, read_body: Callable[[], tuple[Any, Any]], **choices: Any) -> System:
    """The system of what rank 0 reads, as in `spread`, and of its nodes and their triangles, if there are some."""
    nodes, triangles = run_on_rank_0(MPI.COMM_WORLD, read_body)
    matrices, columns = spread(read, together=1 if nodes is None else 3)
    system = System(**matrices, **columns, nodes=nodes, triangles=triangles, **choices)
    for matrix in matrices.values():  # the system has copies, and PETSc forgets nothing by itself
        matrix.destroy()
    return system


def _rows_of(rank: int, ranks: int, size: int, together: int) -> np.ndarray:
    """Which of so many rows a rank has."""
    rows = np.arange(size, dtype=PETSc.IntType).reshape(-1, together if size % together == 0 else 1)
    return np.array_split(rows, ranks)[rank].ravel()


def _spread_matrix(comm: Any, matrix: Any, together: int) -> PETSc.Mat:
    """A SciPy matrix that rank 0 has and the others do not (None), its rows spread evenly over the ranks."""
    whole = scipy.sparse.csr_matrix((0, 0) if matrix is None else matrix, dtype=float)
    whole.sort_indices()
    shape = comm.bcast(whole.shape, root=0)
    csr = (whole.indptr.astype(PETSc.IntType), whole.indices.astype(PETSc.IntType), whole.data)
    gathered = PETSc.Mat().createAIJ(tuple(zip(whole.shape, shape, strict=True)), csr=csr, comm=comm)
    local_rows = [_rows_of(comm.rank, comm.size, size, together) for size in shape]
    index_sets = [PETSc.IS().createGeneral(indices, comm=comm) for indices in local_rows]
    result = gathered.createSubMatrix(*index_sets)
    for part in (gathered, *index_sets):
        part.destroy()
    return result


def _check_stiffness(K: PetscMatrix, R: np.ndarray, body: Body, algebra: PetscAlgebra) -> str:
    """As `_check_definite`, of K beside its rigid motions."""
    fixed = choose_fixed_dofs(R, algebra)
    singular = partial(is_singular, K, _diagonal(K)[algebra.rows()], algebra=algebra, fixed=fixed)
    hint = null_space_hint(R, nodes=len(body.nodes) > 0)
    return _check_definite("stiffness", fix_dofs(K.mat.copy(), fixed), hint, singular)


def _diagonal(matrix: PetscMatrix) -> np.ndarray:
    """(n,) on every rank."""
    diagonal = matrix.mat.getDiagonal()
    parts = matrix.mat.comm.tompi4py().allgather(diagonal.array.copy())
    diagonal.destroy()
    return np.concatenate(parts)


def _check_layout(name: str, matrix: PETSc.Mat, mass: PETSc.Mat) -> None:
    """Refuses what is not square, of the size of M, with its rows on the same ranks, and assembled."""
    if MPI.Comm.Compare(matrix.comm.tompi4py(), mass.comm.tompi4py()) not in (MPI.IDENT, MPI.CONGRUENT):
        raise StructureError(f"{name} is on another communicator than mass")
    shape, size = matrix.getSize(), mass.getSize()[0]
    if shape != (size, size) or size == 0:
        raise StructureError(f"{name} has shape {shape}; use {(size, size) if matrix is not mass else 'square'}")
    rows, mass_rows = matrix.getOwnershipRange(), mass.getOwnershipRange()
    columns = matrix.getOwnershipRangeColumn()
    differs = rows != mass_rows or columns != mass_rows
    refuse_together(
        mass.comm.tompi4py(),
        f"{name} has rows {rows[0]} to {rows[1]} and columns {columns[0]} to {columns[1]} here, but mass has rows "
        f"{mass_rows[0]} to {mass_rows[1]}; use the same"
        if differs
        else "",
    )
    if not matrix.assembled:
        raise StructureError(f"{name} is not assembled; call its assemble()")


def _symmetric_copy(name: str, matrix: PETSc.Mat) -> PETSc.Mat:
    """(A + Aᵀ)/2 in the AIJ format, where A is symmetric up to round-off."""
    try:
        A = matrix.convert("aij", PETSc.Mat())  # a copy in any case
    except PETSc.Error as error:
        raise StructureError(f"{name} is of type {matrix.getType()}, which PETSc cannot convert to AIJ") from error
    scale = A.norm()
    if not np.isfinite(scale):
        raise StructureError(f"{name} holds numbers that are not finite")
    transposed = A.transpose(PETSc.Mat())
    skew = A.copy()
    skew.axpy(-1.0, transposed, structure=DIFFERENT_PATTERN)
    asymmetry = skew.norm()
    if asymmetry > SYMMETRY_TOLERANCE * scale:
        raise StructureError(f"{name} is not symmetric: |A - Aᵀ| = {asymmetry:.1e}, |A| = {scale:.1e}")
    A.axpy(1.0, transposed, structure=DIFFERENT_PATTERN)
    A.scale(0.5)
    near = matrix.getNearNullSpace()  # for multigrid
    if near:
        A.setNearNullSpace(near)
    for part in (transposed, skew, near):
        part.destroy()
    return A


def _check_definite(
    name: str, matrix: PETSc.Mat, hint: str = "", singular: Callable[[PetscFactor], bool] = lambda _: False
) -> str:
    """Refuses by the pivots of a factor, which uses the matrix up, or as singular, as round-off makes zeros positive;
    returns what to warn of where there is no room for a factor."""
    kind = "semi-definite" if name == "damping" else "definite"
    try:
        with closing(PetscFactor(matrix)) as factor:
            lack = ", but singular to round-off" if singular(factor) else ""
    except MemoryShortage as error:
        return f"{name}: whether it is positive {kind} was not checked: {error.shortage}"
    except SolverError as error:
        raise StructureError(f"{name} is not positive {kind}: {error}{hint}") from error
    if lack:
        raise StructureError(f"{name} is not positive {kind}{lack}{hint}")
    return ""


def _shift_by_round_off(damping: PETSc.Mat, mass: PETSc.Mat) -> PETSc.Mat:
    """D + ε I, where ε is what counts as round-off: D may be singular."""
    result = mass.copy()  # has a whole diagonal
    result.zeroEntries()
    result.shift(SYMMETRY_TOLERANCE * damping.norm())
    result.axpy(1.0, damping, structure=DIFFERENT_PATTERN)
    return result


def _checked_columns(comm: Any, columns: Mapping[str, Any], kind: str, local: int) -> dict[str, np.ndarray]:
    """Local rows of columns by name, (rows here, columns)."""
    columns_by_rank = comm.allgather([(name, isinstance(value, PETSc.Mat)) for name, value in columns.items()])
    if any(others != columns_by_rank[0] for others in columns_by_rank):
        raise StructureError(f"{kind}: the ranks give different names, or only some of them a PETSc matrix")
    return {name: _checked_block(comm, value, f"{kind}[{name!r}]", local) for name, value in columns.items()}


def _checked_block(comm: Any, value: Any, where: str, local: int) -> np.ndarray:
    complaint, block = "", np.empty((0, 0))
    try:
        block = _local_rows(value)
    except (TypeError, ValueError, PETSc.Error) as error:
        complaint = f"{where} cannot be read as columns: {error}"
    if not complaint and (block.ndim != 2 or block.shape[0] != local or block.shape[1] == 0):
        complaint = f"{where} has shape {block.shape}; use ({local}, columns), the rows of this rank"
    elif not np.isfinite(block).all():
        complaint = f"{where} holds numbers that are not finite"
    refuse_together(comm, complaint)
    widths = comm.allgather(block.shape[1])
    if len(set(widths)) > 1:
        raise StructureError(f"{where}: the ranks give different numbers of columns, {widths}")
    return block


def _local_rows(value: Any) -> np.ndarray:
    """The rows of this rank of a PETSc matrix, of PETSc vectors or of an array."""
    if isinstance(value, PETSc.Mat):
        dense = value.convert("dense", PETSc.Mat())
        block = dense.getDenseArray().copy()
        dense.destroy()
        return block
    if isinstance(value, PETSc.Vec):
        return value.array_r[:, None].copy()
    if isinstance(value, list | tuple) and any(isinstance(column, PETSc.Vec) for column in value):
        return np.stack([column.array_r for column in value], axis=1)
    block = value.toarray() if scipy.sparse.issparse(value) else np.array(value, dtype=float)
    return block[:, None] if block.ndim == 1 else block
