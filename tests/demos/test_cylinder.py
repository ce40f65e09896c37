"""The demo of the paper's cylinder runs, on a coarse mesh: errors and pictures are looked at, and times are not."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

import fenics_rom as fr
from fenics_rom.fem.mesh import read_mesh

FOLDER = Path(__file__).parents[2] / "demos" / "cylinder"
OUT = FOLDER / "out" / "quick"
TABLES = ("first.csv", "second.csv")


@pytest.fixture(scope="module")
def pulls():
    """The tables of forces as they were before the demo wrote them."""
    return {name: (FOLDER / name).read_text() for name in TABLES}


@pytest.fixture(scope="module")
def run(pulls):
    done = subprocess.run([sys.executable, FOLDER / "cylinder.py", "--quick"], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def rows(file):
    """Cells of a table, by the first ones that are no number."""
    table = [[cell.strip() for cell in line.strip("|").split("|")] for line in (OUT / file).read_text().splitlines()]
    return {tuple(row[: 2 if file == "accuracy.md" else 1]): row for row in table[2:]}


@pytest.mark.slow
def test_all_claims_hold(run):
    assert run.count("  holds: ") == 8
    assert "FAILS" not in run


@pytest.mark.slow
def test_push_and_release_is_as_close_as_on_finer_meshes(run):
    table = rows("accuracy.md")
    assert len(table) == 12
    for (model, order), (*_, first, second, earlier, _ratio) in table.items():
        largest, usual = max(float(first), float(second)), float(earlier)
        assert 0 < largest < 4 * usual, (model, order)
        if (model, order) != ("balanced, energy-orthogonal", "80"):  # all round-off
            assert min(float(first), float(second)) > usual / 4, (model, order)


@pytest.mark.slow
def test_a_move_of_the_contact_costs_accuracy_only_for_a_moment(run):
    table = rows("moved.md")
    assert len(table) == 7
    whole, before, one, ten, hundred, lost = map(float, table[("balanced, order 40",)][2:])
    assert before < 1e-7 < whole < 5e-6
    assert hundred < 1e-6 < ten < one < 1e-4
    assert 1e-3 < lost < 0.1
    holding = table[("balanced, order 40, after the other contact's shapes at rest",)]
    assert holding[1] == "43"
    assert float(holding[-1]) < 1e-5


@pytest.mark.slow
def test_tables_of_the_paper_stand_beside_ours(run):
    states = {what: row[1:3] for (what,), row in rows("table_2.md").items()}
    assert states["full order, paper"] == ["11,526", "11,526"]
    assert states["reduced, paper"] == ["164", "181"]
    assert states["balanced, energy-orthogonal, `step`"] == ["40", "40"]
    errors = {what: list(map(float, row[1:])) for (what,), row in rows("table_3.md").items()}
    assert errors["paper: what reduction adds"] == [0.04, 0.03, 0.04, 0.02]
    for how in ("RMS", "largest"):
        assert 0 < max(errors[f"balanced, order 40, {how}"]) < 1e-4  # cm


@pytest.mark.slow
def test_pictures_are_written(run):
    for name in ("markers.png", "shapes.png"):
        assert (OUT / name).stat().st_size > 30_000


@pytest.mark.slow
def test_the_forces_beside_the_scene_are_those_that_the_demo_writes(run, pulls):
    assert {name: (FOLDER / name).read_text() for name in TABLES} == pulls


def test_the_mesh_is_the_papers_to_four_percent():
    scene = fr.read_scene(FOLDER / "cylinder.toml")
    mesh = read_mesh(scene.mesh_file, scene.mesh_groups)
    assert len(mesh.points) == pytest.approx(3842, rel=0.005)
    assert len(mesh.cells) == pytest.approx(13_985, rel=0.04)
    stated = re.search(r"([\d,]+) nodes and ([\d,]+) tetrahedra", scene.text)
    assert stated is not None
    assert [int(number.replace(",", "")) for number in stated.groups()] == [len(mesh.points), len(mesh.cells)]
