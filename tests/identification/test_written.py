"""What the command leaves in its folder, on one rank and on two."""

import csv
import re
import tomllib
from dataclasses import astuple
from pathlib import Path

import numpy as np
import pytest
import tomlkit
from measuring import START, TRUTH, box_mesh, film, text_of, weigh
from ranks import run_ranks

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning, FileError
from fenics_rom.identification.write import replace_value
from fenics_rom.io.atomic_write import check_folder

PUSHES = [("right", (0.0, 0.0, 2.0)), ("top", (1.0, 0.5, 0.0))]
TABLE = 'dt = 0.01\nduration = 0.6\n[[run.load]]\ncontact = "right"\ntable = "tables/push.csv"'


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A scene with a table of forces, and noisy data of it."""
    folder = tmp_path_factory.mktemp("identify")
    box_mesh(folder)
    (folder / "tables").mkdir()
    (folder / "tables" / "push.csv").write_text("time,x,y,z\n0,0,0,3\n0.2,1,2,3\n0.3,0,0,0\n0.6,0,0,0\n")
    (folder / "truth.toml").write_text(text_of(Path("box.msh"), TRUTH, run=TABLE))
    (folder / "start.toml").write_text(
        text_of(Path("box.msh"), START, run=TABLE).replace("]\nyoung", "]  # guessed\nyoung")
    )
    truth = fr.read_scene(folder / "truth.toml")
    film(folder / "motion.csv", truth, noise=1e-5)
    weigh(folder / "rest.csv", truth, PUSHES)
    return folder


def command(folder, *words, ranks=1):
    return run_ranks(ranks, "-m", "fenics_rom", "identify", *words, cwd=folder)


DATA = ("start.toml", "--data", "motion.csv", "--data", "rest.csv")


@pytest.fixture(scope="module")
def one(folder):
    done = command(folder, *DATA, "-o", "found")
    assert done.returncode == 0, done.stderr
    return done


def test_the_scene_found_runs_and_has_what_was_found(folder, one):
    text = (folder / "found" / "identified.toml").read_text()
    assert "# guessed" in text
    scene = fr.read_scene(folder / "found" / "identified.toml")
    found = scene.materials["material"]
    for name in ("young", "poisson", "density"):
        assert getattr(found, name) == pytest.approx(TRUTH[name], rel=0.05)
    assert scene.effects.damping.beta == pytest.approx(TRUTH["beta"], rel=0.05)
    before, after = (tomllib.loads((folder / file).read_text()) for file in ("start.toml", "found/identified.toml"))
    assert after["mesh"]["file"] == "../box.msh"
    assert after["run"]["load"][0]["table"] == "../tables/push.csv"
    assert {key: value for key, value in after.items() if key in ("contacts", "outputs", "supports")} == {
        key: value for key, value in before.items() if key in ("contacts", "outputs", "supports")
    }
    assert fr.simulate(scene).steps == 60


def test_report_residuals_and_pictures_are_written(folder, one):
    assert "identification of scene: found" in one.stdout
    report = (folder / "found" / "identification.md").read_text()
    assert report.count("\n| young ") == 2  # found, correlations
    assert "- residual, full order: " in report
    with (folder / "found" / "residuals.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == 30 * 9 + 2 * 6
    assert rows[0]["file"] == "motion.csv"
    assert rows[0]["line"] == "2"
    assert rows[0]["marker"] == "tip[0].x"
    assert rows[-1]["time (s)"] == ""
    left = np.array([float(row["residual (m)"]) for row in rows])
    measured, model = (np.array([float(row[key]) for row in rows]) for key in ("measured (m)", "model (m)"))
    np.testing.assert_allclose(left, measured - model, rtol=0, atol=1e-10)
    assert (folder / "found" / "fit.png").stat().st_size > 10_000
    assert (folder / "found" / "fit.pdf").stat().st_size > 10_000


def test_a_start_value_is_not_written_as_if_it_were_known(folder, tmp_path):
    scene = fr.read_scene(folder / "start.toml")
    with pytest.warns(FenicsRomWarning, match="do not depend on density"):
        result = fr.identify(scene, [folder / "rest.csv"], parameters=["young", "density"])
    fr.write_identification(tmp_path / "found", result)
    first = (tmp_path / "found" / "identified.toml").read_text().splitlines()[0]
    assert first == "# The data do not determine density: left at the start value."
    report = (tmp_path / "found" / "identification.md").read_text()
    assert "poisson = 0.2 (+0.01: " in report.split("\n| young ")[1].split("\n")[0]


@pytest.mark.ranks
@pytest.mark.slow
def test_two_ranks_find_the_same(folder, one):
    done = command(folder, *DATA, "-o", "two", ranks=2)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("identification of scene") == 1
    first, second = (fr.read_scene(folder / name / "identified.toml") for name in ("found", "two"))
    for name in ("young", "poisson", "density"):
        value = getattr(first.materials["material"], name)
        assert getattr(second.materials["material"], name) == pytest.approx(value, rel=1e-6)
    assert astuple(second.effects.damping)[:2] == pytest.approx(astuple(first.effects.damping)[:2], rel=1e-6)


@pytest.mark.slow
@pytest.mark.ranks
def test_wrong_data_end_with_one_line_and_no_folder(folder):
    (folder / "wrong.csv").write_text("time (s),tip[0].z (mm)\n0.1,much\n")
    for ranks in (1, 2):
        done = command(folder, "start.toml", "--data", "wrong.csv", "-o", "none", ranks=ranks)
        assert done.returncode == 1
        assert "fenics-rom: error: wrong.csv, line 2, column 'tip[0].z (mm)': 'much' was given" in done.stderr
    assert not (folder / "none").exists()
    done = command(folder, "start.toml", "--data", "motion.csv", "-o", "rest.csv")
    assert "rest.csv: is a file; use a folder" in done.stderr


def test_a_folder_that_cannot_be_is_refused(tmp_path):
    with pytest.raises(FileError, match=r"cannot be made: folder .* does not exist"):
        check_folder(tmp_path / "none" / "found")
    check_folder(tmp_path)
    check_folder(tmp_path / "new")


@pytest.mark.parametrize(
    ("text", "path"),
    [
        ("[material]\nyoung = 1.0e6 # Pa\n", ("material", "young")),
        ("young = 3\nmaterial.young = +1_000.5\n", ("material", "young")),
        ("material = { note = 'young = 1', \"young\" = 1e6 }\n", ("material", "young")),
        ("[a]\nbeta = 1\n[b]\nbeta=1 # beta = 1\n", ("b", "beta")),
        ("[[run.load]]\ntable = \"a\"\n[[run.load]]\ntable = 'a'\n", ("run", "load", 1, "table")),
        ("[a.x]\nbeta = 1\n[b]\nc = 1\n[a.y]\nbeta = 2 # a comes again\n", ("a", "y", "beta")),
        ('[material]\n"\\u0079oung" = 1\n', ("material", "young")),
        ("[a]\nb.c.beta = 1 # dotted\nb.c.d = 2\n", ("a", "b", "c", "beta")),
    ],
)
def test_a_value_is_changed_wherever_it_is_written(text, path):
    document = tomlkit.parse(text)
    replace_value(document, path, "b" if path[-1] == "table" else 2.5)
    changed = tomlkit.dumps(document)
    assert re.findall("#.*", changed) == re.findall("#.*", text)
    holder, other = tomllib.loads(changed), tomllib.loads(text)
    for key in path[:-1]:
        holder, other = holder[key], other[key]
    assert holder.pop(path[-1]) == ("b" if path[-1] == "table" else 2.5)
    other.pop(path[-1])
    assert holder == other
    assert len(changed.splitlines()) == len(text.splitlines())
