"""No test replaces a part of ours by something that takes what the part would refuse."""

import ast
from pathlib import Path

import pytest

from fenics_rom.runtime import batch_arrays
from fenics_rom.visualization.viewer import view as view_module

TESTS = Path(__file__).parent


def test_a_stand_in_is_called_as_the_part_is(monkeypatch):
    monkeypatch.setattr(view_module, "view", lambda *given, **more: given)
    assert view_module.view("plate.h5", wait=True) == ("plate.h5",)
    with pytest.raises(TypeError, match="unexpected keyword argument 'colour'"):
        view_module.view("plate.h5", colour=1)
    monkeypatch.setattr("fenics_rom.visualization.viewer.view.view", lambda *given, **more: 1)  # and so is the next
    with pytest.raises(TypeError, match="missing a required argument: 'model'"):
        view_module.view()


def test_a_stand_in_of_a_method_is_called_as_the_method_is(monkeypatch):
    monkeypatch.setattr(view_module.View, "close", lambda self, *more: more)
    shown = object.__new__(view_module.View)
    assert shown.close() == ()
    with pytest.raises(TypeError, match="too many positional arguments"):
        shown.close(1)


@pytest.mark.parametrize(
    ("name", "stand_in", "says"),
    [
        ("view", 1, "which is called"),
        ("View", type("Other", (), {}), "is not derived from it"),
        ("FRAME_PIXELS", "600", "which is of type int"),
    ],
)
def test_a_stand_in_of_another_kind_is_refused(monkeypatch, name, stand_in, says):
    with pytest.raises(TypeError, match=says):
        monkeypatch.setattr(view_module, name, stand_in)


def test_what_is_not_ours_is_not_watched(monkeypatch):
    monkeypatch.setattr(view_module.webbrowser, "open", lambda *given, **more: True)
    assert view_module.webbrowser.open(1, 2, 3, 4, 5, six=6)
    monkeypatch.setattr(batch_arrays, "surely_not_there", 1, raising=False)


@pytest.mark.parametrize("file", sorted(TESTS.rglob("*.py")), ids=lambda file: str(file.relative_to(TESTS)))
def test_nothing_is_replaced_but_by_monkeypatch(file):
    """Which is watched; `unittest.mock` is not, nor is an assignment to a module."""
    tree = ast.parse(file.read_text())
    modules = {
        alias.asname or alias.name
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("fenics_rom")
        for alias in node.names
        if (TESTS.parent / node.module.replace(".", "/") / f"{alias.name}.py").is_file()
    } | {"fr"}
    for node in ast.walk(tree):
        assert not (isinstance(node, ast.ImportFrom) and node.module in ("unittest", "unittest.mock", "mock")), (
            node.lineno
        )
        for target in getattr(node, "targets", ()):
            assert not (
                isinstance(target, ast.Attribute) and isinstance(target.value, ast.Name) and target.value.id in modules
            ), node.lineno
