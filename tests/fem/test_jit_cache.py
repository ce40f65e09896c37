"""Where compiled forms are kept, also where no home can be used, as in containers."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from bodies import PLATE

from fenics_rom.fem.jit_cache import provide_jit_cache


@pytest.fixture
def own(tmp_path, monkeypatch):
    """The temporary folder of this user."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    return tmp_path / f"fenics-rom-{os.getuid()}"


def cache():
    """As dolfinx finds it."""
    return os.getenv("XDG_CACHE_HOME", default=Path.home().joinpath(".cache")) / Path("fenics")


def test_cache_is_in_the_home_where_it_can_be(own, tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    provide_jit_cache()
    assert cache() == tmp_path / ".cache" / "fenics"
    assert not own.exists()


@pytest.mark.parametrize(
    ("variable", "place"), [("HOME", "/dev/null"), ("HOME", "/proc"), ("XDG_CACHE_HOME", "/dev/null")]
)
def test_cache_that_cannot_be_written_is_elsewhere_and_the_same_again(own, tmp_path, monkeypatch, variable, place):
    """/dev/null is no folder, and in /proc root cannot write either."""
    monkeypatch.setenv("HOME", str(tmp_path))
    for _ in range(2):
        monkeypatch.setenv(variable, place)
        provide_jit_cache()
        assert cache().is_relative_to(own)
        cache().mkdir(parents=True, exist_ok=True)
        (Path.home() / ".config").exists()  # asked by dolfinx, which a home that is no folder would end
    assert own.stat().st_mode & 0o777 == 0o700


def test_folder_that_others_can_write_is_not_trusted(own, monkeypatch):
    """Compiled forms are executed."""
    own.mkdir()
    own.chmod(0o777)
    monkeypatch.setenv("HOME", "/proc")
    provide_jit_cache()
    assert not cache().is_relative_to(own)
    assert cache().parent.stat().st_mode & 0o777 == 0o700


@pytest.mark.slow  # it compiles
def test_scene_is_assembled_without_a_home(own, tmp_path):
    code = f"import fenics_rom as fr; fr.assemble(fr.read_scene({str(PLATE)!r}))"
    environment = dict(os.environ) | {"HOME": "/dev/null", "TMPDIR": str(tmp_path)}
    run = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    assert list(own.rglob("libffcx_forms_*.so"))
