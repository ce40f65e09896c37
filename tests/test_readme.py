"""The README is run: its Python blocks, its commands, its demo, and a short form of the study its tables are of."""

import math
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import fenics_rom as fr
from fenics_rom.io.markdown import markdown
from fenics_rom.scene.effect_table import table_of_effects
from fenics_rom.studies.method_configs import METHOD_CONFIGS, STUDIED_METHODS

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text()
DEMO = ROOT / "demos" / "plate"


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", README, flags=re.S)


def tables(text):
    """Markdown tables by their first columns' names: rows as dictionaries."""
    found = []
    for block in re.findall(r"(?:^\|.*\n)+", text, flags=re.M):
        heading, _, *rows = ([cell.strip() for cell in line.strip("|").split("|")] for line in block.splitlines())
        found.append([dict(zip(heading, row, strict=True)) for row in rows])
    return found


def seconds(step):
    value, unit = step.split()
    return float(value) * {"ms": 1e-3, "µs": 1e-6}[unit]


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


def test_plate_demo_keeps_its_claims():
    run = subprocess.run([sys.executable, DEMO / "plate.py"], capture_output=True, text=True, env=dict(os.environ))
    assert run.returncode == 0, run.stdout + run.stderr
    assert "FAILS" not in run.stdout
    out = {path.name for path in (DEMO / "out").iterdir()}
    assert out >= {
        "plate.h5",
        "full.h5",
        "reduced.h5",
        "study.md",
        "speed.png",
        "table_1.md",
        "energy.png",
        "shapes.png",
    }


@pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
def test_what_accuracy_costs_is_what_a_short_study_finds(tmp_path):
    (costs,) = (table for table in tables(README) if {"for", "method", "order", "step", "error"} <= table[0].keys())
    (reduction,) = (table for table in tables(README) if {"order", "balanced", "POD"} <= table[0].keys())
    method_of = {config.label: name for name, config in METHOD_CONFIGS.items()}
    costs = [row for row in costs if seconds(row["step"]) >= 1e-3]  # the rest takes longer
    assert len(costs) >= 3
    orders = {int(row["order"]) for row in costs} | {28}
    steps = {seconds(row["step"]) for row in costs}
    scene = fr.read_scene(DEMO / "plate.toml")
    found = fr.study(scene, tmp_path, methods=STUDIED_METHODS, orders=sorted(orders), steps=sorted(steps)).rows
    for row in costs:
        key, dt = (method_of[row["method"]], int(row["order"])), seconds(row["step"])
        (measured,) = (r for r in found if (r.method, r.order) == key and math.isclose(r.dt, dt))
        assert float(row["error"]) == pytest.approx(measured.error, rel=0.1)
        assert measured.error <= float(row["for"])
    for row in reduction:
        if int(row["order"]) in orders:
            for label, name in method_of.items():
                if label in row:
                    (measured, *_) = (r for r in found if (r.method, r.order) == (name, int(row["order"])))
                    assert float(row[label]) == pytest.approx(measured.reduction, rel=0.1)


def test_effects_are_those_of_the_table():
    assert markdown(("effect", "force", "parameters", "energy"), table_of_effects()) in README


def test_pictures_are_there():
    pictures = re.findall(r"!\[.*?\]\((.*?)\)", README)
    assert len(pictures) == 13
    for picture in pictures:
        assert (ROOT / picture).stat().st_size > 10_000
