"""Every claim of the demo of hard cases holds, on its coarser meshes and in its shorter runs."""

import importlib
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "demos" / "hard_cases"
KINDS = ("material", "shape", "damping", "support", "contact", "order", "steps", "precision")

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")  # what matters is in a row


@pytest.fixture(autouse=True)
def _demo(monkeypatch):
    monkeypatch.syspath_prepend(FOLDER)


@pytest.mark.parametrize(
    "kind",
    [
        pytest.param(kind, marks=pytest.mark.slow if kind in ("material", "shape", "steps", "precision") else ())
        for kind in KINDS
    ],
)
def test_every_claim_holds(kind):
    rows = list(importlib.import_module(f"cases_{kind}").rows(quick=True))
    assert [" | ".join(row.cells) for row in rows if not row.holds] == []
    assert len(rows) >= 14


def test_every_kind_is_in_the_table():
    modules = {path.stem.removeprefix("cases_") for path in FOLDER.glob("cases_*.py")}
    assert modules == set(KINDS) == {kind.__name__.removeprefix("cases_") for kind in demo().KINDS.values()}


def test_what_is_not_a_number_or_beyond_its_bound_fails():
    Row = importlib.import_module("rows").Row
    at_most, at_least = ({"case": "", "hard": "", "measured": "", "bound": 1.0, "at_least": side} for side in (0, 1))
    assert [Row(value=value, **at_most).holds for value in (0.5, 1.0, 2.0, float("nan"))] == [True, True, False, False]
    assert [Row(value=value, **at_least).holds for value in (0.5, 1.0, 2.0, float("nan"))] == [False, True, True, False]
    assert Row(value=2.0, **at_most).cells[-1] == "FAILS"


def test_the_demo_writes_its_table_and_fails_with_a_claim(monkeypatch, tmp_path, capsys):
    Row = importlib.import_module("rows").Row
    hard_cases = demo()
    monkeypatch.setattr(hard_cases, "OUT", tmp_path)
    monkeypatch.setattr(sys, "argv", ["hard_cases.py", "--quick"])
    for value, code in ((0.5, 0), (2.0, 1)):
        kind = type("kind", (), {"rows": staticmethod(lambda quick, value=value: [Row("a", "b", "c", value, 1.0)])})
        monkeypatch.setattr(hard_cases, "KINDS", {"Kind": kind})
        with pytest.raises(SystemExit) as stopped:
            hard_cases.main()
        assert stopped.value.code == code
        assert ("FAILS" in (tmp_path / "quick" / "hard_cases.md").read_text()) == bool(code)
    assert "0 of 1 claims hold" in capsys.readouterr().out


def demo():
    return importlib.import_module("hard_cases")
