"""What PETSc offers and petsc4py does not (3.18 to 3.22), called in PETSc's own library."""

import ctypes

from petsc4py import PETSc

_library = ctypes.CDLL(PETSc.__file__)  # finds what petsc4py is linked to
_library.MatCholeskyFactorSymbolic.argtypes = [ctypes.c_void_p] * 4
_library.MatCholeskyFactorNumeric.argtypes = [ctypes.c_void_p] * 3
_library.MatSetOptionsPrefixFactor.argtypes = [ctypes.c_void_p, ctypes.c_char_p]
_library.PetscOptionsUsed.argtypes = [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p]
_FACTOR_INFO = 64  # reals, zero for "default": more than PETSc's MatFactorInfo has


def set_factor_prefix(mat: PETSc.Mat, prefix: str) -> None:
    """Prefix of the options that the factors of a matrix will read."""
    _library.MatSetOptionsPrefixFactor(mat.handle, prefix.encode())


def cholesky_symbolic(factor: PETSc.Mat, mat: PETSc.Mat) -> int:
    """Analysis of the pattern, which tells what the factor will need; PETSc's error code, 0 for none."""
    info = (ctypes.c_double * _FACTOR_INFO)()
    return int(_library.MatCholeskyFactorSymbolic(factor.handle, mat.handle, None, info))


def cholesky_numeric(factor: PETSc.Mat, mat: PETSc.Mat) -> int:
    """Factorisation after its analysis; PETSc's error code, 0 for none."""
    info = (ctypes.c_double * _FACTOR_INFO)()
    return int(_library.MatCholeskyFactorNumeric(factor.handle, mat.handle, info))


def option_was_read(name: str) -> bool:
    """Whether anything has asked for an option of the options database."""
    used = ctypes.c_int(0)  # no narrower than any release's PetscBool
    _library.PetscOptionsUsed(None, name.encode(), ctypes.byref(used))
    return bool(used.value)
