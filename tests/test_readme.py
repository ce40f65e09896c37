"""The README is run: its Python block, its commands, and the demo that its picture and its table come from."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from fenics_rom.effects import table_of_effects
from fenics_rom.report import markdown

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text()
DEMO = ROOT / "demos" / "plate"


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", README, flags=re.S)


def errors(table):
    """Error by model and order, from a Markdown table."""
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in table.splitlines() if line.startswith("|")]
    return {(row[0], row[1]): float(row[2]) for row in rows if re.fullmatch(r"\d.*e-\d+", "".join(row[2:3]))}


@pytest.fixture
def folder(tmp_path):
    """As if in the project's root, without writing into it."""
    (tmp_path / "demos").symlink_to(ROOT / "demos")
    return tmp_path


def test_python_and_commands_run_as_printed(folder):
    (plate, matrices, method, faster, touch), (commands,) = blocks("python"), blocks("sh")
    printing = (
        (plate, "supplied="),
        (matrices, ""),
        (method, "'static_error': "),
        (faster, "(256, 2, 3)"),
        (touch, "["),
    )
    for python, printed in printing:
        run = subprocess.run(
            [sys.executable, "-c", python], cwd=folder, capture_output=True, text=True, env=dict(os.environ)
        )
        assert run.returncode == 0, run.stderr
        assert printed in run.stdout
    for command in commands.strip().splitlines():
        program = command.replace("fenics-rom", f"{sys.executable} -m fenics_rom", 1).split("#")[0]
        run = subprocess.run(program.split(), cwd=folder, capture_output=True, text=True, env=dict(os.environ))
        assert run.returncode == 0, run.stderr
    assert {path.name for path in folder.glob("*.h5")} == {"plate.h5", "reduced.h5", "full.h5"}


def test_plate_demo_keeps_its_claims_and_the_readmes_table():
    run = subprocess.run([sys.executable, DEMO / "plate.py"], capture_output=True, text=True, env=dict(os.environ))
    assert run.returncode == 0, run.stdout + run.stderr
    assert "FAILS" not in run.stdout
    out = {path.name for path in (DEMO / "out").iterdir()}
    assert out >= {"plate.h5", "full.h5", "reduced.h5", "accuracy.md", "table_1.md", "energy.png", "shapes.png"}
    printed, measured = errors(README), errors((DEMO / "out" / "accuracy.md").read_text())
    assert printed.keys() == measured.keys()
    assert len(printed) == 8
    for model, error in printed.items():
        assert measured[model] == pytest.approx(error, rel=0.1)


def test_effects_are_those_of_the_table():
    assert markdown(("effect", "force", "parameters", "energy"), table_of_effects()) in README


def test_pictures_are_there():
    pictures = re.findall(r"!\[.*?\]\((.*?)\)", README)
    assert len(pictures) == 4
    for picture in pictures:
        assert (ROOT / picture).stat().st_size > 10_000
