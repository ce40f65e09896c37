"""What numba compiles, where it is installed: functions of arrays, in the folders named `compiled`."""

import os
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, wraps
from hashlib import sha256
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryFile
from threading import Timer
from time import monotonic
from types import FunctionType
from typing import Any, ParamSpec, TypeVar

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import FenicsRomWarning

VARIABLE = "FENICS_ROM_COMPILED"  # 0: NumPy alone, whatever is installed
OLDEST = (0, 57)  # of numba: the first one for Python 3.11
SHARED = tuple(  # what else than their own folders compiled functions use
    f"{name}.py"
    for name in (
        "compiled_arrays",
        "compiled_calls",
        "compiled_products",
        "mechanics/actuator_forces",
        "mechanics/base_fit",
        "mechanics/base_path",
        "mechanics/braking",
        "mechanics/complementarity/pivoting",
        "mechanics/contact_look",
        "mechanics/contact_pairs",
        "mechanics/contact_search",
        "mechanics/frame_contact",
        "mechanics/fibres",
        "mechanics/filling",
        "mechanics/frame_motion",
        "mechanics/gas",
        "mechanics/hyperelastic",
        "mechanics/largest_turn",
        "mechanics/rounded_surface",
        "mechanics/surface_pairs",
        "rom/block_rows",
        "runtime/steppers/convergence",
        "runtime/steppers/elastic/carried_strains",
        "runtime/steppers/frame_table",
        "runtime/steppers/inertia",
        "runtime/steppers/kept_newton",
        "world/drive_law",
        "world/normal_law",
        "world/rigid_answers",
        "world/tolerances",
        "world/turning",
    )
)
PATIENCE = 1.0  # s that compiling takes in all before a line says so
EXACT = frozenset({"contract"})  # what of the arithmetic may be other than as written: products that are added at once
_Function = TypeVar("_Function", bound=Callable[..., object])
_Given = ParamSpec("_Given")
_Result = TypeVar("_Result")


def compiled() -> bool:
    """Whether steps run compiled; if not, NumPy takes the same ones.

    They do where numba is installed and the environment variable FENICS_ROM_COMPILED is not 0.

    Example:
        >>> import fenics_rom as fr
        >>> print("compiled" if fr.compiled() else "NumPy")  # doctest: +SKIP
        compiled
    """
    return not (_alone or _failed) and can_compile()


@contextmanager
def numpy_alone() -> Iterator[None]:
    """What is made within takes its steps in NumPy, to be compared; in this thread and others."""
    global _alone
    before, _alone = _alone, True
    try:
        yield
    finally:
        _alone = before


_alone, _failed = False, False


@cache
def can_compile() -> bool:
    """Whether numba is there, works, and is not turned off; tells what is wrong with it."""
    if os.environ.get(VARIABLE) == "0" or find_spec("numba") is None:
        return False
    if find_spec("scipy") is None:  # and where products are kept compiled, they would end the program
        return _tell("numba multiplies matrices by SciPy, which is not installed")
    try:
        import numba
    except Exception as error:  # whatever a broken installation raises, as with another NumPy than it was built for
        return _tell(f"numba cannot be imported ({type(error).__name__}: {error})")
    version = tuple(int(part) for part in numba.__version__.split(".")[:2])
    if version < OLDEST:
        return _tell(f"numba {numba.__version__} is older than {'.'.join(map(str, OLDEST))}")
    try:
        _compile(_product)(np.eye(1), np.ones(1))
    except Exception as error:  # as above
        return _tell(f"numba {numba.__version__} does not compile ({type(error).__name__}: {_first_line(error)})")
    return True


def or_numpy(method: Callable[_Given, _Result | None]) -> Callable[_Given, _Result | None]:
    """Of what calls compiled functions, and gives None where NumPy is to do it: also where numba fails to compile them.

    This is told once, and NumPy does all from then on.
    """

    @wraps(method)
    def tried(*given: _Given.args, **named: _Given.kwargs) -> _Result | None:
        global _failed
        if _failed:
            return None
        try:
            return method(*given, **named)
        except Exception as error:
            if not type(error).__module__.startswith("numba."):
                raise
            _failed = True
            _tell(f"numba fails to compile what steps need ({type(error).__name__}: {_first_line(error)})")
            return None

    return tried


def _product(A: Array, x: Array) -> Array:
    return A.dot(x)


def _first_line(error: Exception) -> str:
    return next(iter(str(error).strip().splitlines()), "")


def _tell(problem: str) -> bool:
    _warn(f"{problem}: steps run in NumPy, with the same results, but slower; set {VARIABLE}=0 to silence this")
    return False


def _warn(message: str) -> None:
    warnings.warn(message, FenicsRomWarning, stacklevel=5)


def jit(function: _Function) -> _Function:
    """Compiles a function of arrays at its first call, and keeps the result on disk; as it is where nothing compiles.

    Other threads may run while it does.
    """
    return _compile(function) if can_compile() else function


def jit_part(function: _Function) -> _Function:
    """Has a function compiled as a part of those that call it; Python takes it as it is.

    Nothing of it is kept by itself, nor made to be called from Python, which would take a tenth of all compiling.
    """
    return _part(function, EXACT) if can_compile() else function


def jit_apart(function: _Function, *, ahead: bool = False) -> _Function:
    """Has a function compiled by itself, once for all compiled ones that call it; Python takes it as it is.

    Its arguments are given by position. `jit` makes of it what Python calls. What gives a number or nothing is compiled
    when it is called first, unless `ahead`: then with the first function that calls it.
    """
    if can_compile():
        from fenics_rom.compiled_calls import at_address

        at_address(function, _compile(function), ahead)
    return function


def jit_ahead(function: _Function) -> _Function:
    """The same, ahead of its first call: what a step needs as soon as something touches."""
    return jit_apart(function, ahead=True)


def jit_sums(function: _Function) -> _Function:
    """The same, of long sums, whose terms may be added in any order, several at once."""
    return _part(function, EXACT | {"reassoc", "nsz"}) if can_compile() else function


@cache
def jit_shared(function: _Function) -> _Function:
    """The same of a function that NumPy's steps take, too, with those that it calls.

    Its file is to be one of SHARED.
    """
    if can_compile():
        known = function.__globals__
        for name in function.__code__.co_names:
            if isinstance(known.get(name), FunctionType):
                jit_shared(known[name])
        _part(function, EXACT)
    return function


@cache
def _compile(function: _Function) -> _Function:
    from numba import config, njit

    before, config.CACHE_DIR = config.CACHE_DIR, str(cache_folder())
    try:
        made: _Function = njit(cache=_keeps(), **_how(EXACT))(function)
    finally:
        config.CACHE_DIR = before
    return made


def _part(function: _Function, fastmath: frozenset[str]) -> _Function:
    from numba.extending import register_jitable

    from fenics_rom.compiled_calls import PartCompiler

    made: _Function = register_jitable(pipeline_class=PartCompiler, **_how(fastmath))(function)
    return made


def _how(fastmath: frozenset[str]) -> dict[str, Any]:
    return {"nogil": True, "error_model": "numpy", "fastmath": set(fastmath)}


def in_plain(array: Array) -> Array:
    """The same in one piece, and such that it may be written to: of other kinds all would be compiled again."""
    return array if array.flags.c_contiguous and array.flags.writeable else array.copy()


@cache
def thread_count() -> int:
    """In how many threads compiled loops run: as many as numba's would, one for each core, or NUMBA_NUM_THREADS."""
    from numba import config

    return int(config.NUMBA_NUM_THREADS)


@cache
def cache_folder() -> Path:
    """Where compiled functions are kept: one folder for each state of all their sources.

    numba looks at the file of a function alone, and not at those that it calls.
    """
    package = Path(__file__).parent
    sources = sorted((*package.rglob("compiled/*.py"), *map(package.joinpath, SHARED)))
    state = sha256(b"".join(source.read_bytes() for source in sources)).hexdigest()[:16]
    home = os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(home) / "fenics_rom" / state


@cache
def _keeps() -> bool:
    """Whether what is compiled can be kept. Tells it where it cannot; and from here on, that compiling takes time."""
    folder = cache_folder()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=folder):
            kept = True
    except OSError as error:
        kept = False
        _warn(f"what numba compiles cannot be kept ({error}): every start compiles again; set NUMBA_CACHE_DIR")
    _watch_compiling("once on this machine, `fenics-rom compile` does so beforehand" if kept else "at every start")
    return kept


def _watch_compiling(when: str) -> None:
    """Has a line written when compiling has taken long."""
    from numba.core import event

    @cache
    def say() -> None:
        print(f"fenics_rom: compiles what steps need (up to a minute, {when})", file=sys.stderr, flush=True)

    class Watch(event.Listener):
        """Of compiling, which numba does in one thread at a time; functions that others call are compiled within."""

        depth, spent, begun = 0, 0.0, 0.0
        timer: Timer | None = None

        def on_start(self, event: Any) -> None:
            self.depth += 1
            if self.depth == 1 and self.spent < PATIENCE:
                self.begun, self.timer = monotonic(), Timer(PATIENCE - self.spent, say)
                self.timer.daemon = True
                self.timer.start()

        def on_end(self, event: Any) -> None:
            self.depth -= 1
            if self.depth == 0 and self.timer is not None:
                self.timer.cancel()
                self.timer.join()  # if it says something, until it has
                self.timer, self.spent = None, self.spent + monotonic() - self.begun
                if self.spent >= PATIENCE:  # what compiles may not let the timer run when it is due
                    say()

    event.register("numba:compile", Watch())
