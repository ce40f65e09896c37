"""Files of matrices to a system: on one process with SciPy, under mpirun with PETSc and the rows spread."""

from collections.abc import Mapping
from functools import cache
from inspect import signature
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io
import scipy.sparse
from numpy import ndarray as Array

from fenics_rom.errors import StructureError
from fenics_rom.fem.abaqus_matrices import AbaqusBody, read_abaqus_body
from fenics_rom.io.mpi_ranks import launched_rank
from fenics_rom.io.tables import read_table
from fenics_rom.io.units import UNITS
from fenics_rom.system.rayleigh_damping import check_damping_choice
from fenics_rom.system.system import System

File = str | PathLike[str]
# Sparse matrices, where SciPy's releases from 1.20 on give sparse arrays unless told; those before 1.15 are not told.
AS_MATRIX = {"spmatrix": True} if "spmatrix" in signature(scipy.io.mmread).parameters else {}


def read_system(
    *,
    mass: File,
    stiffness: File,
    contacts: Mapping[str, File],
    damping: File | None = None,
    rayleigh: tuple[float, float] | None = None,
    actuators: Mapping[str, File] | None = None,
    outputs: Mapping[str, File] | None = None,
    nodes: File | None = None,
    frame: str = "fixed",
    units: str | None = None,
) -> System:
    """A system of matrices in files (.mtx), Matrix Market's or Abaqus'; under mpirun every rank must call it.

    Args:
        mass, stiffness: files of M and K, (n, n), symmetric and positive definite; K but for the rigid motions of a
            body that moves freely, which are found.
        contacts: file of the columns of each contact mode, (n, columns).
        damping: file of D, (n, n), symmetric and positive semi-definite.
        rayleigh: instead of `damping`: (α, β) of D = α M + β K, 1/s and s.
        actuators: file of the columns of each actuator.
        outputs: file of C of each output, (n, columns).
        nodes: table (.csv) with columns x, y and z, in m or as in "x (mm)": of each node, three rows of the matrices.
            Or Abaqus' input file (.inp) that it has written the matrices of: then the body has a surface, and contacts,
            actuators and outputs may be names of its sets of nodes, for evenly spread forces and mean displacements.
        frame: "moving": the body turns as far as it likes, free or carried; that needs nodes. See System.
        units: of Abaqus' files, "m-kg-s" (N/m; without it) or "mm-t-s" (N/mm).

    Raises:
        MeshError: an input file that cannot be read.
        StructureError: a file that cannot be read, or whose content cannot be used, with its name.

    Example:
        >>> system = fr.read_system(mass="M.mtx", rayleigh=(0.5, 1e-3), stiffness="K.mtx", contacts={"tip": "B.mtx"})
        >>> system.size
        180
    """
    check_damping_choice(damping, rayleigh)
    matrices = {"mass": mass, "stiffness": stiffness} | ({} if damping is None else {"damping": damping})
    columns = {"contacts": contacts, "actuators": actuators or {}, "outputs": outputs or {}}
    files: dict[str, File] = matrices | ({} if nodes is None else {"nodes": nodes})
    files |= {f"{kind}[{name!r}]": file for kind, given in columns.items() for name, file in given.items()}

    @cache
    def abaqus() -> AbaqusBody | None:
        if nodes is None or Path(nodes).suffix.lower() != ".inp":
            return None
        return read_abaqus_body(Path(nodes), matrices, units or "m-kg-s")

    def read() -> tuple[dict[str, Any], dict[str, Any]]:
        body = abaqus()
        if units is not None and body is None:
            raise StructureError(f"units = {units!r}: use it with nodes of Abaqus' input file (.inp)")
        of_files = {name: scipy.sparse.csr_matrix(_read(file)) for name, file in matrices.items()} if not body else {}
        square = dict(body.matrices) if body else of_files
        rows = square["mass"].shape[0]
        return square, {
            kind: {name: _columns(file, rows, body, f"{kind}[{name!r}]") for name, file in given.items()}
            for kind, given in columns.items()
        }

    def read_body() -> tuple[Array | None, Array | None]:
        body = abaqus()
        return (body.nodes, body.triangles) if body else (_read_nodes(nodes), None)

    try:
        if launched_rank() is not None:  # the rows of this rank
            from fenics_rom.fem.user_matrices import spread_system

            return spread_system(read, read_body, rayleigh=rayleigh, frame=frame)
        square, tall = read()
        X, triangles = read_body()
        return System(**square, **tall, rayleigh=rayleigh, nodes=X, triangles=triangles, frame=frame)
    except StructureError as error:
        file = next((file for subject, file in files.items() if str(error).startswith(f"{subject} ")), None)
        if file is None:
            raise
        raise StructureError(f"{file}: {error}") from error


def _read_nodes(file: File | None) -> np.ndarray | None:
    """Positions (N, 3) of nodes, m."""
    if file is None:
        return None
    table = read_table(Path(file), StructureError)
    columns = {}
    for column in table.heading:
        axis, factor = table.unit(column, UNITS["m"], bare=True)
        columns[axis] = table.numbers(column, factor)
    if sorted(columns) != ["x", "y", "z"]:
        raise StructureError(f"{file}, line 1: has columns {', '.join(table.heading)}; use x, y and z")
    return np.stack([columns[axis] for axis in "xyz"], axis=1)


def _read(file: File) -> Any:
    """A real matrix, sparse or dense as it is in the file."""
    try:
        with Path(file).open(encoding="latin-1") as stream:
            banner = stream.readline(1000).lower().split()
        if banner[:1] != ["%%matrixmarket"]:
            raise StructureError(f"{file}: is not a Matrix Market file: its first line must start with %%MatrixMarket")
        if not {"real", "integer", "double"} & set(banner):
            raise StructureError(f"{file}: holds {' '.join(banner[3:4]) or 'no'} numbers; use real ones")
        return scipy.io.mmread(file, **AS_MATRIX)
    except StructureError:
        raise
    except OSError as error:
        raise StructureError(f"{file}: cannot be read: {error.strerror or error}") from error
    except Exception as error:  # SciPy's readers raise what they come across, each release its own
        raise StructureError(f"{file}: cannot be read as a Matrix Market file: {error}") from error


def _columns(given: File, rows: int, body: AbaqusBody | None, where: str) -> Array:
    """Columns (rows, any number) of a file, or of a set of nodes."""
    if body is not None and Path(given).suffix.lower() != ".mtx":
        return body.columns_of(str(given), where)
    matrix = _read(given)
    if matrix.shape[0] != rows:
        raise StructureError(f"{given}: has shape {matrix.shape}; the mass matrix asks for ({rows}, columns)")
    return matrix.toarray() if scipy.sparse.issparse(matrix) else matrix
