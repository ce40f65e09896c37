"""What numba compiles, where it is installed: functions of arrays, in the folders named `compiled`."""

import os
import warnings
from collections.abc import Callable
from functools import cache
from hashlib import sha256
from importlib.util import find_spec
from pathlib import Path
from typing import TypeVar

from fenics_rom.errors import FenicsRomWarning

VARIABLE = "FENICS_ROM_COMPILED"  # 0: NumPy alone, whatever is installed
OLDEST = (0, 57)  # of numba: the first one for Python 3.11
_Function = TypeVar("_Function", bound=Callable[..., object])


@cache
def compiled() -> bool:
    """Whether steps run compiled; if not, NumPy takes the same ones.

    They do where numba is installed and the environment variable FENICS_ROM_COMPILED is not 0.

    Example:
        >>> import fenics_rom as fr
        >>> print("compiled" if fr.compiled() else "NumPy")  # doctest: +SKIP
        compiled
    """
    if os.environ.get(VARIABLE) == "0" or find_spec("numba") is None:
        return False
    try:
        import numba
    except Exception as error:  # whatever a broken installation raises, as with another NumPy than it was built for
        return _tell(f"numba cannot be imported ({type(error).__name__}: {error})")
    version = tuple(int(part) for part in numba.__version__.split(".")[:2])
    if version < OLDEST:
        return _tell(f"numba {numba.__version__} is older than {'.'.join(map(str, OLDEST))}")
    return True


def _tell(problem: str) -> bool:
    warnings.warn(
        f"{problem}: steps run in NumPy, with the same results, but slower; set {VARIABLE}=0 to silence this",
        FenicsRomWarning,
        stacklevel=4,
    )
    return False


def jit(function: _Function) -> _Function:
    """Compiles a function of arrays at its first call, and keeps the result on disk; as it is where nothing compiles.

    Other threads may run while it does.
    """
    if not compiled():
        return function
    from numba import config, njit

    before, config.CACHE_DIR = config.CACHE_DIR, _cache_folder()
    try:
        made: _Function = njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})(function)
    finally:
        config.CACHE_DIR = before
    return made


@cache
def _cache_folder() -> str:
    """Where compiled functions are kept: one folder for each state of all their sources.

    numba looks at the file of a function alone, and not at those that it calls.
    """
    sources = sorted(Path(__file__).parent.rglob("compiled/*.py"))
    state = sha256(b"".join(source.read_bytes() for source in sources)).hexdigest()[:16]
    home = os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return str(Path(home) / "fenics_rom" / state)
