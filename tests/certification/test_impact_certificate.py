"""Rigid balls hit a soft pad; the certificate is checked, altered, and gone on with."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import fenics_rom as fr
from fenics_rom.certification import report
from fenics_rom.certification.certify import Strikes, certify
from fenics_rom.certification.impacts import QUANTITIES, Impact, check_end
from fenics_rom.certification.limits import read_limits
from fenics_rom.certification.models import models_of
from fenics_rom.certification.report import coverage_lines, write_report
from fenics_rom.certification.search import search
from fenics_rom.cli.main import main
from fenics_rom.errors import DataError, FileError, SceneError
from fenics_rom.io.progress import silent
from fenics_rom.scene.certificate_format import BodyRanges
from fenics_rom.scene.world_file import files_of_world

MESHES = Path(__file__).parents[2] / "meshes"
PAD = """
name = "pad"
mesh = { file = "MESH", degree = 1, scale = 2.0 }
material = { young = 5e5, poisson = 0.2, density = 1000.0 }
supports = { clamped = ["back"] }
contacts.face = { surface = "face" }
[effects]
inertia = {}
damping = { beta = 1e-3 }
[effects.contact.obstacles.wall]
shape = "half-space"
point = [0.0, 0.0, 1.0]
normal = [0.0, 0.0, -1.0]
[reduction]
order = 10
"""
WORLD = """
name = "drop"
[bodies.pad]
scene = "pad.toml"
[bodies.ball]
shape = "sphere"
radius = 0.02
mass = 0.1
position = [0.0, 0.0, 0.0402]
velocity = [0.0, 0.0, -0.1]
[certificate]
body = "pad"
by = ["ball"]
region = "hands and fingers"
tolerance = 0.3
[certificate.ranges.ball]
mass = [0.1, 0.2]
velocity = [[0.0, 0.0, -0.3], [0.0, 0.0, -0.1]]
[run]
dt = 5e-4
duration = 0.03
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("certificate")
    (folder / "pad.toml").write_text(PAD.replace("MESH", str(MESHES / "pad.msh")))
    (folder / "drop.toml").write_text(WORLD)
    return folder


@pytest.fixture(scope="module")
def certificate(folder):
    return certify(fr.read_world(folder / "drop.toml"))


@pytest.fixture
def written(certificate, tmp_path):
    return fr.write_certificate(tmp_path / "impact.json", certificate)[0]


def test_no_run_within_the_ranges_is_above_what_is_certified(certificate):
    strikes = Strikes(certificate.scene, certificate.roms, 5e-4)
    certified = np.array([each.certified for each in certificate.findings.values()])
    for point in np.random.default_rng(1).random((8, 2)):
        assert (strikes(point) < certified).all()
    assert (certificate.cover.values > 0).all()
    assert certificate.is_kept


def test_what_is_found_is_what_mechanics_says(certificate):
    """All the ball has goes into the pad and back: energies are at most ½ m v², forces are of a spring's size."""
    energy = certificate.findings["energy"]
    assert energy.at == (0.2, -0.3)
    assert 0.9 * 0.009 < energy.largest <= 0.009 * (1 + 1e-9)
    assert certificate.findings["force"].at == (0.2, -0.3)
    for found in certificate.findings.values():
        assert found.largest <= found.bound <= 1.3 * found.largest
        assert found.certified == found.bound + found.reduction + found.time_step
        assert 0 < found.time_step < 0.3 * found.largest


def test_a_certificate_is_read_and_its_runs_are_run_again(certificate, written):
    again = fr.check_certificate(written)
    assert again.findings == certificate.findings
    assert again.limits == certificate.limits
    assert {path.name for path in written.parent.iterdir()} == {"impact.json", "impact.pad.h5"}


def seal_again(file, change):
    from fenics_rom.certification.file import _sealed

    content = json.loads(file.read_text())
    del content["seal"]
    change(content)
    file.write_text(json.dumps(_sealed(content)))


def lower_all(content):
    for runs in content["runs"]["peaks"], content["runs"]["corners"]:
        for run in runs:
            run[0] *= 0.5


def lower_findings(content):
    content["findings"]["force"]["largest"] *= 0.5


def lower_all_as_follows(content):
    lower_all(content)
    for key in "largest", "bound", "reduction", "time_step", "certified":
        content["findings"]["force"][key] *= 0.5
    for run in (*content["errors"]["finer"], *content["errors"]["halved"]):
        run[0] *= 0.5


def shrink_step_error(content):
    peaks = content["runs"]["peaks"] + content["runs"]["corners"]
    content["errors"]["halved"] = [peaks[row] for row in np.unique([0, *np.argmax(peaks, axis=0)])]
    for finding in content["findings"].values():
        finding["certified"] -= finding["time_step"]
        finding["time_step"] = 0.0


def narrow(content):
    content["world"]["certificate"]["ranges"]["ball"]["mass"] = [0.05, 0.1]


def raise_limit(content):
    content["limits"]["of"]["force"] = 1e4


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lower_findings, "from its runs follows"),
        (lower_all, "from its runs follows"),
        (lower_all_as_follows, "the model gives a force"),
        (shrink_step_error, "the model gives"),
        (narrow, "from its runs follows|the model gives"),
        (raise_limit, "are not those of the table"),
        (lambda content: content["runs"]["points"].pop(), "altered"),
        (lambda content: content["runs"]["corners"].pop(), "altered"),
        (lambda content: [runs.pop() for runs in content["errors"].values()], "errors are not of the middle"),
        (lambda content: content["runs"].update(points=[]), "altered"),
        (lambda content: content["runs"]["points"][3].__setitem__(0, 0.3), "altered"),
    ],
)
def test_what_was_altered_is_refused(written, change, said):
    """With a new seal; the seal alone tells whoever does not make one."""
    seal_again(written, change)
    with pytest.raises(FileError, match=said):
        fr.check_certificate(written)


def test_what_was_altered_without_a_seal_and_other_models_are_refused(written, tmp_path):
    text = written.read_text()
    written.write_text(text.replace('"largest": ', '"largest": 1', 1))
    with pytest.raises(FileError, match="was altered: the seal does not fit"):
        fr.check_certificate(written)
    written.write_text(text)
    model = tmp_path / "impact.pad.h5"
    fr.write_rom(model, fr.truncate(fr.read_rom(model), 5), force=True)
    with pytest.raises(FileError, match=r"impact.pad.h5 is not the one that was certified"):
        fr.check_certificate(written)
    model.unlink()
    with pytest.raises(FileError, match="cannot be read: No such file"):
        fr.check_certificate(written)
    written.write_text("{}")
    with pytest.raises(FileError, match="is no certificate"):
        fr.check_certificate(written)


def test_interrupted_work_goes_on_and_changed_worlds_begin_anew(folder, certificate, tmp_path):
    runs = tmp_path / "runs"
    scene = fr.read_world(folder / "drop.toml")
    strikes = Strikes(scene, certificate.roms, 5e-4, runs)
    strikes(np.array([0.5, 0.5]))
    again = Strikes(scene, {}, 5e-4, runs)  # without models it can run nothing
    np.testing.assert_array_equal(again(np.array([0.5, 0.5])), certificate.cover.values[0])
    first, line = runs.read_text().splitlines()
    point, peaks, _ = json.loads(line)
    runs.write_text(f"{first}\n{json.dumps([point, peaks, ['strains of 7 %']])}\n")
    assert Strikes(scene, {}, 5e-4, runs).warnings == ("strains of 7 % (this or the like in 1 run)",)
    runs.write_text(f"{first}\n0\n")
    with pytest.raises(FileError, match="does not hold runs of a certificate"):
        Strikes(scene, {}, 5e-4, runs)
    runs.write_text("0" * 64 + "\n")
    with pytest.raises(FileError, match="holds runs of another world"):
        Strikes(scene, {}, 5e-4, runs)


def test_the_commands(folder, tmp_path, capsys):
    for name in "pad.toml", "drop.toml":
        shutil.copy(folder / name, tmp_path)
    out, numbers = tmp_path / "impact.pdf", tmp_path / "impact.json"
    with pytest.raises(SystemExit) as ended:
        main(["certify", str(tmp_path / "drop.toml"), "-o", str(out), "--json", str(numbers)])
    assert ended.value.code == 0
    printed = capsys.readouterr().out
    assert "largest run" in printed
    assert re.search(r"force \(N\).*kept", printed)
    assert out.read_bytes().startswith(b"%PDF")
    assert not out.with_name("impact.pdf.runs").exists()
    with pytest.raises(SystemExit) as ended:
        main(["check", str(numbers)])
    assert ended.value.code == 0
    assert "holds" in capsys.readouterr().out
    for words, said in {
        ("-o", str(out), "--resume"): "nothing to go on from",
        ("-o", str(tmp_path / "impact.txt")): "impact.txt: use a file that ends in .pdf, .svg, .png",
        ("-o", str(out), "--json", str(out)): "is the file of -o, too; give another name",
    }.items():
        with pytest.raises(SystemExit):
            main(["certify", str(tmp_path / "drop.toml"), *words])
        assert said in capsys.readouterr().err


def test_limits_that_are_exceeded_are_an_exit_status(certificate, tmp_path, monkeypatch, capsys):
    mine = tmp_path / "mine.csv"
    mine.write_text("region,force_N,pressure_N_per_cm2,energy_J,source\nhands and fingers,1,,,me\n")
    scene = certificate.scene
    table = replace(scene.file.certificate, limits=str(mine))
    raw = {**scene.raw, "certificate": {**scene.raw["certificate"], "limits": str(mine)}}
    scene = replace(scene, raw=raw, file=replace(scene.file, certificate=table))
    exceeded = replace(certificate, scene=scene, limits=read_limits("hands and fingers", mine))
    monkeypatch.setattr("fenics_rom.certification.certify.certify", lambda *_, runs_file, **__: exceeded)
    numbers, page = tmp_path / "impact.json", tmp_path / "impact.png"
    page.with_name("impact.png.runs").write_text("")
    words = ["certify", str(certificate.scene.source), "-o", str(page), "--json", str(numbers), "--resume"]
    for command in words, ["check", str(numbers), "--runs", "0"]:
        with pytest.raises(SystemExit) as ended:
            main(command)
        assert ended.value.code == 3
        assert "EXCEEDED" in capsys.readouterr().out


def test_what_of_many_ranges_is_run_and_drawn_is_said(certificate, tmp_path, monkeypatch):
    drawn, draw = [], report._draw_parameter
    monkeypatch.setattr(report, "_draw_parameter", lambda *each: (drawn.append(each[-1]), draw(*each)))
    write_report(tmp_path / "two.png", certificate)
    assert drawn == [0, 1]
    assert f"all {len(certificate.corners)} corners" in " ".join(coverage_lines(certificate))
    ranges = {"ball": BodyRanges(mass=(0.1, 0.2), position=((0.0,) * 3, (1.0,) * 3), spin=((0.0,) * 3, (1.0,) * 3))}
    table = replace(certificate.scene.file.certificate, ranges=ranges)
    scene = replace(certificate.scene, file=replace(certificate.scene.file, certificate=table))
    steep = np.array([1.0, 7.0, 2.0, 6.0, 3.0, 5.0, 4.0])
    cover = search(lambda point: np.full(3, 9.0 + steep @ point), 7, 10.0, 100)
    many = replace(certificate, scene=scene, cover=cover, corners=np.empty((0, 3)))
    assert "none of the 128 corners, as of more than 6" in " ".join(coverage_lines(many))
    drawn.clear()
    monkeypatch.setattr(report, "_draw_time", lambda *_: None)
    write_report(tmp_path / "seven.png", many)
    assert drawn == [1, 3, 5, 6]


def test_models_of_many_modes_are_not_made(folder, certificate, monkeypatch):
    assert not certificate.warnings
    monkeypatch.setattr("fenics_rom.certification.models.MOST_MODES", 15)
    reduced, finer, notes = models_of(fr.read_world(folder / "drop.toml"), silent)
    orders = [{mode.order for mode in roms["pad"].contact_models.values()} for roms in (reduced, finer)]
    assert orders == [{10}, {20}]
    assert "the reduction of 'pad' is an estimate, by twice its order (10): of its " in notes[0]
    assert "more than 15 are too many" in notes[0]


def test_limits(tmp_path):
    limits = read_limits("hands and fingers")
    assert limits.of == {"force": 280.0, "pressure": 3.8e6, "energy": 0.52}
    with pytest.raises(DataError, match=r"no region 'hand'; there is abdomen"):
        read_limits("hand")
    (tmp_path / "mine.csv").write_text("region,force_N,pressure_N_per_cm2,energy_J,source\nnose,50,,-1,me\n")
    with pytest.raises(DataError, match=r"column 'energy_J': use a number > 0"):
        read_limits("nose", tmp_path / "mine.csv")
    (tmp_path / "mine.csv").write_text("region,force_N,pressure_N_per_cm2,energy_J,source\nnose,50,,,me\n")
    assert read_limits("nose", tmp_path / "mine.csv").of == {"force": 50.0}
    (tmp_path / "mine.csv").write_text("region,force_N\nnose,50\n")
    with pytest.raises(DataError, match="column 'pressure_N_per_cm2' is missing"):
        read_limits("nose", tmp_path / "mine.csv")


def test_a_table_of_limits_is_among_the_files_of_a_world(folder):
    scene = fr.read_world(folder / "drop.toml")
    table = replace(scene.file.certificate, limits="mine.csv")
    assert folder / "mine.csv" in files_of_world(replace(scene, file=replace(scene.file, certificate=table)))


@pytest.mark.slow
def test_bodies_that_deform_largely_are_compared_with_twice_the_order(tmp_path):
    trained = "[run]\ndt = 1e-3\nduration = 0.02\nload = [{ contact = 'face', force = [0.0, 0.0, -20.0] }]\n"
    pad = PAD.replace("MESH", str(MESHES / "pad.msh")).replace("order = 10", "order = 8") + trained
    pad = pad.replace("inertia = {}", "inertia = {}\nlarge_deformation = {}")
    pad = pad.replace("[effects.contact.obs", "[effects.contact]\nswitching = 'scene'\n[effects.contact.obs")
    (tmp_path / "pad.toml").write_text(pad)
    (tmp_path / "drop.toml").write_text(WORLD.replace("tolerance = 0.3", "tolerance = 2.0"))
    found = certify(fr.read_world(tmp_path / "drop.toml")).findings["force"]
    assert 0 < found.reduction < 0.1 * found.largest


@pytest.mark.parametrize(("row", "grows"), [(0, "force"), (1, "pressure"), (2, "energy")])
def test_a_run_that_ends_while_something_grows_is_refused(row, grows):
    felt = np.ones((4, 3)) * [[0], [2], [1], [1]]
    check_end(Impact(np.arange(4.0), felt, ()))
    felt[3, row] = 2 * (1 + 1e-12)
    with pytest.raises(SceneError, match=f"the {grows} still grows when the run ends, at 3 s"):
        check_end(Impact(np.arange(4.0), felt, ()))
    felt[2, row] = 2.0
    check_end(Impact(np.arange(4.0), felt, ()))


def test_nothing_that_is_hit_and_runs_that_end_too_early(folder, tmp_path):
    scene = fr.read_world(folder / "drop.toml")
    run = replace(scene.file.run, duration=5e-3)
    with pytest.raises(SceneError, match="the energy still grows when the run ends"):
        certify(replace(scene, file=replace(scene.file, run=run)))
    away = replace(scene.file.bodies["ball"], position=(0.0, 0.0, 1.0))
    bodies = {**scene.file.bodies, "ball": away}
    with pytest.raises(SceneError, match=r"runs nothing hits 'pad'"):
        certify(replace(scene, file=replace(scene.file, bodies=bodies)))
    assert set(QUANTITIES) == {"force", "pressure", "energy"}
