"""Anyone's SciPy and NumPy matrices as parts of a system, measured; each process has all of them."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import scipy.sparse
from numpy import ndarray as Array

from fenics_rom.errors import SolverError, StructureError, shown
from fenics_rom.mechanics.signals import real_numbers
from fenics_rom.system.backends import belongs_to
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
from fenics_rom.system.scipy_backend import MatrixAlgebra, MatrixFactor, with_fixed_dofs

MATRICES = ("mass", "damping", "stiffness")
COLUMNS = ("contacts", "actuators", "outputs")
SYMMETRY_TOLERANCE = 1e-10  # largest accepted |A - Aᵀ| as a share of |A|


def checked_fields(given: Mapping[str, Any]) -> dict[str, Any]:
    """Fields of a system; refuses matrices or columns that do not fit or lack structure, with the measured number."""
    _refuse_petsc_and_complex(given)
    M = checked_matrix(given["mass"], "mass", None, definite=True)
    size = M.shape[0]
    algebra, rayleigh = MatrixAlgebra(size), given["rayleigh"]
    K = checked_matrix(given["stiffness"], "stiffness", size, definite=None)
    body = body_of_matrices(given["nodes"], M, M.diagonal(), algebra)
    if given["rigid"] is not None:
        R = checked_rigid_columns(M, K, checked_block(given["rigid"], "rigid", size), algebra)
    else:
        R = motions_of_nodes(M, K, body, algebra) if len(body.nodes) else np.empty((size, 0))
    lack = _lack_of_definiteness(K, R, algebra)
    if lack is not None and given["rigid"] is None and not len(body.nodes):
        R = found_motions(M, K, lambda s: K + s * M, algebra)
        lack = _lack_of_definiteness(K, R, algebra)
    if lack is not None:
        raise StructureError(f"stiffness is not positive definite{lack}{null_space_hint(R, nodes=len(body.nodes) > 0)}")
    damping = given["damping"] if rayleigh is None else rayleigh[0] * M + rayleigh[1] * K
    D = checked_matrix(damping, "damping", size, definite=False)
    return {
        **{"mass": M, "damping": D, "stiffness": K, "algebra": algebra, "body": body},
        **{
            kind: {name: checked_block(block, f"{kind}[{name!r}]", size) for name, block in given[kind].items()}
            for kind in COLUMNS
        },
        "rayleigh": rayleigh or fitted_rayleigh(M, D, K, algebra),
        "rigid": R,
    }


def _lack_of_definiteness(K: Any, R: Array, algebra: MatrixAlgebra) -> str | None:
    """What keeps K from being positive definite beside R; None where it is."""
    fixed = choose_fixed_dofs(R, algebra)
    try:
        factor = MatrixFactor(with_fixed_dofs(K, fixed))
    except SolverError:
        return ""
    return ", but singular to round-off" if is_singular(K, K.diagonal(), factor, algebra, fixed) else None


def _refuse_petsc_and_complex(given: Mapping[str, Any]) -> None:
    """NumPy would drop imaginary parts, and take a PETSc vector for something else."""
    columns = {f"{kind}[{name!r}]": value for kind in COLUMNS for name, value in given[kind].items()}
    for name, value in ({name: given[name] for name in (*MATRICES, "rigid")} | columns).items():
        if any(belongs_to(v, "petsc4py") for v in (value if isinstance(value, list | tuple) else [value])):
            raise StructureError(f"{name} is of PETSc, but the matrices are not")
        if np.iscomplexobj(_array(value, name)):
            raise StructureError(f"{name} is complex; use real numbers")


def _array(given: Any, name: str) -> Any:
    """What is given, as an array unless it is one, or a sparse matrix."""
    if hasattr(given, "dtype"):
        return given
    try:
        return np.asarray(given)
    except ValueError as error:
        raise StructureError(f"{name} = {shown(given)}: use rows of one length") from error


def checked_matrix(matrix: Any, name: str, size: int | None, definite: bool | None) -> Any:
    """A float matrix with its structure measured, definiteness but where None; sparse ones become CSR."""
    sparse = scipy.sparse.issparse(matrix)
    A = scipy.sparse.csr_matrix(matrix, dtype=float) if sparse else _numbers(matrix, name)
    if A.ndim != 2 or A.shape[0] != A.shape[1] or A.shape[0] != (size or A.shape[0]) or A.shape[0] == 0:
        raise StructureError(f"{name} has shape {A.shape}; use {(size, size) if size else 'square'}")
    entries: Any = A.data if sparse else A
    if not np.isfinite(entries).all():
        raise StructureError(f"{name} holds numbers that are not finite")
    scale = np.abs(entries).max(initial=0.0)
    lack = abs(A - A.T).max()
    if lack > SYMMETRY_TOLERANCE * scale:
        raise StructureError(f"{name} is not symmetric: |A - Aᵀ| = {lack:.1e}, |A| = {scale:.1e}")
    if definite is not None and (definite or scale > 0):
        shift = 0.0 if definite else SYMMETRY_TOLERANCE * scale
        unit = scipy.sparse.identity(A.shape[0], format="csr") if sparse else np.eye(A.shape[0])
        try:
            MatrixFactor(A + shift * unit)
        except SolverError as error:
            raise StructureError(f"{name} is not positive {'definite' if definite else 'semi-definite'}") from error
    return A


def _numbers(given: Any, name: str) -> Array:
    """An array of floats of its own."""
    try:
        return real_numbers(given)
    except (TypeError, ValueError) as error:
        raise StructureError(f"{name} = {shown(given)}: use real numbers: {error}") from error


def checked_block(block: Any, where: str, size: int) -> Array:
    """Float columns (size, any number), finite and at least one; one may be a vector."""
    dense = block.toarray() if scipy.sparse.issparse(block) else _numbers(block, where)
    dense = dense[:, None] if dense.ndim == 1 else dense
    if dense.ndim != 2 or dense.shape[0] != size or dense.shape[1] == 0:
        raise StructureError(f"{where} has shape {dense.shape}; use ({size}, columns)")
    if not np.isfinite(dense).all():
        raise StructureError(f"{where} holds numbers that are not finite")
    return dense
