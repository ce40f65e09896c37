"""Whether steps run compiled: what numba is there, and what the user is told."""

import subprocess
import sys
import types

import pytest

from fenics_rom import compilation
from fenics_rom.compilation import VARIABLE, compiled
from fenics_rom.errors import FenicsRomWarning


@pytest.fixture
def asked_anew(monkeypatch):
    """The question is answered anew, for this test alone."""
    monkeypatch.delenv(VARIABLE, raising=False)
    compiled.cache_clear()
    yield monkeypatch
    compiled.cache_clear()


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


def test_functions_are_as_they_are_where_nothing_compiles(asked_anew):
    asked_anew.setenv(VARIABLE, "0")

    def double(x):
        return 2 * x

    assert compilation.jit(double) is double
    assert not compiled()


def test_without_contact_numba_is_not_imported():
    code = "import sys, fenics_rom as fr; fr.Simulator, fr.Batch; sys.exit('numba' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0
