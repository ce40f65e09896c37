"""Whether steps run compiled: what numba is there, and what the user is told."""

import ast
import os
import subprocess
import sys
import types
from pathlib import Path

import numpy as np
import pytest
from landing_box import DT, landing_mesh, landing_roms

import fenics_rom as fr
from fenics_rom import compilation
from fenics_rom.compilation import VARIABLE, can_compile, compiled, numpy_alone
from fenics_rom.errors import FenicsRomWarning


@pytest.fixture
def asked_anew(monkeypatch):
    """The question is answered anew, for this test alone."""
    monkeypatch.delenv(VARIABLE, raising=False)
    can_compile.cache_clear()
    yield monkeypatch
    can_compile.cache_clear()


def test_a_numba_too_old_is_told_once(asked_anew):
    asked_anew.setitem(sys.modules, "numba", types.SimpleNamespace(__version__="0.55.2"))
    asked_anew.setattr(compilation, "find_spec", lambda name: name)
    with pytest.warns(FenicsRomWarning, match=r"numba 0.55.2 is older than 0.57: steps run in NumPy"):
        assert not compiled()
    assert not compiled()


def test_a_numba_that_cannot_be_imported_is_told(asked_anew, tmp_path):
    (tmp_path / "numba.py").write_text("raise ImportError('Numba needs NumPy 2.4 or less')")
    asked_anew.delitem(sys.modules, "numba", raising=False)
    asked_anew.syspath_prepend(tmp_path)
    with pytest.warns(FenicsRomWarning, match=r"cannot be imported \(ImportError: Numba needs NumPy 2.4 or less\)"):
        assert not compiled()


def test_a_numba_without_scipy_is_told(asked_anew):
    asked_anew.setattr(compilation, "find_spec", lambda name: None if name == "scipy" else name)
    with pytest.warns(
        FenicsRomWarning, match="numba multiplies matrices by SciPy, which is not installed: steps run in"
    ):
        assert not compiled()


def test_a_numba_that_does_not_compile_is_told(asked_anew):
    pytest.importorskip("numba")

    def fails(function):
        raise ImportError("SciPy 1.0+ is required\nby numba")

    asked_anew.setattr(compilation, "_compile", fails)
    with pytest.warns(
        FenicsRomWarning, match=r"does not compile \(ImportError: SciPy 1.0\+ is required\): steps run in"
    ):
        assert not compiled()


def test_functions_are_as_they_are_where_nothing_compiles(asked_anew):
    asked_anew.setenv(VARIABLE, "0")

    def double(x):
        return 2 * x

    assert compilation.jit(double) is double
    assert not compiled()


def test_numpy_alone_lasts_as_long_as_its_block(asked_anew):
    asked_anew.setattr(compilation, "can_compile", lambda: True)
    with numpy_alone():
        with numpy_alone():
            assert not compiled()
        assert not compiled()
    assert compiled()


def test_constants_that_compiled_functions_have_are_of_files_that_their_cache_knows():
    """What is compiled has the numbers that these had then."""
    package, unknown = Path(compilation.__file__).parent, set()
    for source in package.rglob("compiled/*.py"):
        for node in ast.walk(ast.parse(source.read_text())):
            if isinstance(node, ast.ImportFrom) and any(alias.name.isupper() for alias in node.names):
                file = node.module.removeprefix("fenics_rom.").replace(".", "/") + ".py"
                known = file in compilation.SHARED or "compiled/" in file or not (package / file).exists()
                unknown |= set() if known else {file}
    assert not unknown


def test_without_contact_numba_is_not_imported():
    code = "import sys, fenics_rom as fr; fr.Simulator, fr.Batch; sys.exit('numba' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


SOLVE = """
import numpy as np
from fenics_rom.compilation import jit

def solved(A):
    return np.linalg.solve(A, A).sum() + np.linalg.eigh(A)[0].sum()

print(jit(solved)(np.eye(2)))
"""


def run(*arguments, cache):
    environment = os.environ | {VARIABLE: "1", "NUMBA_CACHE_DIR": str(cache)}
    done = subprocess.run([sys.executable, *map(str, arguments)], capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr
    return done


def test_long_compiling_is_told_once_and_its_result_kept(tmp_path):
    pytest.importorskip("numba")
    (tmp_path / "solve.py").write_text(SOLVE)
    first, again = (run(tmp_path / "solve.py", cache=tmp_path / "cache") for _ in range(2))
    assert first.stdout == again.stdout == "4.0\n"
    assert first.stderr.count("fenics_rom: compiles what steps need (up to a minute, once on this machine") == 1
    assert again.stderr == ""


def test_a_folder_that_keeps_nothing_is_told(tmp_path):
    pytest.importorskip("numba")
    (tmp_path / "cache").write_text("a file")
    (tmp_path / "solve.py").write_text(SOLVE)
    done = run(tmp_path / "solve.py", cache=tmp_path / "cache")
    assert done.stdout == "4.0\n"
    assert "what numba compiles cannot be kept" in done.stderr
    assert "every start compiles again" in done.stderr


CALLS = """
import numpy as np
from numba.core import event
from typing import NamedTuple
from fenics_rom.compilation import jit, jit_apart, jit_part

class Pair(NamedTuple):
    numbers: np.ndarray
    scale: float

@jit_part
def product(pair, x):
    return pair.scale * pair.numbers.dot(x)

@jit_apart
def inner(pair, x, most):
    if product(pair, x) > most:
        raise ValueError("too large")
    return product(pair, x), pair.numbers[1:]

@jit
def outer(pair, x, most):
    first, rest = inner(pair, x, 100)
    second, _ = inner(Pair(rest, pair.scale), rest, most)
    return first + second

@jit_apart
def first(x) -> float:
    return x[0] + 0.5

@jit
def first_of(x, asked):
    return first(x) if asked else 0.0

if __name__ == "__main__":
    import calls
    for asked in (False, True):
        with event.install_recorder("numba:compile") as compiling:
            print(calls.first_of(np.ones(3), asked))
        print(sum(each.data["dispatcher"].py_func is calls.first for _, each in compiling.buffer if each.is_start))
    with event.install_recorder("numba:compile") as compiling:
        pair, ones = calls.Pair(np.arange(3.0), 2.0), np.ones(3)
        print(calls.outer(pair, ones, 20), calls.outer(pair, ones, 20), jit(calls.inner)(pair, ones, 20)[0])
        try:
            calls.outer(pair, ones, 5)
        except ValueError as error:
            print(error)
    print(sum(each.data["dispatcher"].py_func is calls.inner for _, each in compiling.buffer if each.is_start))
"""


def test_what_is_called_by_its_address_is_compiled_once_and_read_when_it_is_called(tmp_path):
    """Results and errors are those of plain calls: 2 (1 + 2) + 2 (1 + 4), and what is too large is told.

    What says that it gives a number is compiled when it is called.
    """
    pytest.importorskip("numba")
    (tmp_path / "calls.py").write_text(CALLS)
    first, again = (run(tmp_path / "calls.py", cache=tmp_path / "cache").stdout for _ in range(2))
    assert first == "0.0\n0\n1.5\n1\n16.0 16.0 6.0\ntoo large\n1\n"
    assert again == "0.0\n0\n1.5\n0\n16.0 16.0 6.0\ntoo large\n0\n"


@pytest.mark.slow
def test_compile_leaves_nothing_to_compile_at_the_first_run(tmp_path):
    pytest.importorskip("numba")
    rom = landing_roms(landing_mesh(tmp_path))["floor"]
    fr.write_rom(tmp_path / "box.h5", rom)
    first = run("-m", "fenics_rom", "compile", tmp_path / "box.h5", cache=tmp_path / "cache")
    assert "box.h5: " in first.stdout
    assert first.stderr.count("compiles what steps need") == 1
    code = f"""
import numpy as np, fenics_rom as fr
from numba.core import event
with event.install_recorder("numba:compile") as compiling:
    body = fr.Simulator({str(tmp_path / "box.h5")!r}, 1e-3)
    body.step(np.zeros(body.inputs))
    body.rollout(np.zeros((3, body.inputs)))
    fr.Batch(body.rom, 2, 1e-3).step(np.zeros((2, body.inputs)))
print(len(compiling.buffer))
"""
    assert run("-c", code, cache=tmp_path / "cache").stdout == "0\n"


@pytest.mark.skipif(not compiled(), reason="numba is not installed, or turned off")
def test_where_numba_fails_to_compile_a_step_numpy_takes_it(tmp_path, asked_anew):
    from numba.core.errors import TypingError

    from fenics_rom.mechanics import compiled_contact
    from fenics_rom.runtime import compiled_bodies
    from fenics_rom.runtime.steppers import compiled_step

    def push(pushed, u):
        for _ in range(20):
            pushed.step(u)

    def fails(*_):
        raise TypingError("no such function\nin this numba")

    rom = landing_roms(landing_mesh(tmp_path))["floor"]
    with numpy_alone():
        reference = fr.Simulator(rom, DT)
    body, bodies = fr.Simulator(rom, DT), fr.Batch(rom, 2, DT, ledger=True)
    assert bodies.stepping == "compiled"
    for file, name in (
        (compiled_step, "take_step_at"),
        (compiled_contact, "measure"),
        (compiled_bodies, "step_bodies"),
    ):
        asked_anew.setattr(file, name, fails)
    asked_anew.setattr(compilation, "_failed", False)
    with pytest.warns(FenicsRomWarning, match=r"fails to compile what steps need \(TypingError: .*no such") as told:
        push(body, [1.0, 0.0, 0.0])
    assert len(told) == 1
    push(reference, [1.0, 0.0, 0.0])
    assert np.array_equal(body.displacement(), reference.displacement())
    assert not compiled()
    push(bodies, np.tile([1.0, 0.0, 0.0], (2, 1)))
    np.testing.assert_allclose(bodies.displacement("corner")[1], reference.displacement("corner"), rtol=0, atol=1e-12)
