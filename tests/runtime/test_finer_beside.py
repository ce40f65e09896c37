"""A ROM of higher order beside: estimates for bodies whose errors no residual tells."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from bodies import scene_text
from test_errors import run_command

import fenics_rom as fr
from fenics_rom.cli.main import main
from fenics_rom.errors import SceneError, ToleranceWarning
from fenics_rom.scene.file import parse_scene

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
INERTIA = "inertia = {}\ndamping = { alpha = 2.0, beta = 1e-3 }\n"
PUSH = '{ contact = "right", force = [0, 5.0, -8.0], stop = 0.06 }'
ROPE = 'tendon.rope = { points = [[0.0, 0.4, 0.3], [0.5, 0.4, 0.3], [1.0, 0.4, 0.3]], control = "length" }\n'
SCENES = {  # what comes before the scene, effects, loads
    "relaxes": ("", "viscoelasticity = { ratios = [0.5], times = [0.1] }", PUSH),
    "stroke": ("", ROPE, PUSH + ', { actuator = "rope", force = [0.002] }'),
    "carried": ('frame = "moving"\n', "gravity = { acceleration = [0, 0, -9.81] }", PUSH),
}


@pytest.fixture(scope="module", params=SCENES)
def case(request, box_file):
    head, effects, loads = SCENES[request.param]
    run = f"dt = 2e-3\nduration = 0.12\nload = [{loads}]"
    text = scene_text(box_file, effects=INERTIA + effects, run=run, **{"outputs.tip": "points = [[1.0, 0.4, 0.3]]"})
    system = fr.assemble(parse_scene(head + text))
    return system, *(fr.reduce(system, order=order) for order in (4, 12))


def test_estimates_are_near(case):
    system, rom, finer = case
    off = fr.simulate(system).outputs["tip"]
    run = fr.simulate(rom, finer=finer)
    true, told = np.abs(off - run.outputs["tip"]).max(), np.abs(run.errors["estimate"].outputs["tip"]).max()
    assert 1 / 1.5 < told / true < 1.5, (true, told)  # as of other estimates
    assert list(run.errors) == ["estimate"]
    assert "a ROM of order 12 takes the same steps" in run.errors["estimate"].why
    assert (run.outputs["tip"] == fr.simulate(rom).outputs["tip"]).all()


def test_a_tolerance_is_told_at_once_and_files_and_commands_take_it(case, tmp_path, capsys):
    _, rom, finer = case
    told = np.abs(fr.simulate(rom, finer=finer).errors["estimate"].outputs["tip"]).max(axis=(1, 2))
    tolerance = float(told.max() / 2)
    asks = replace(rom.environment, run=replace(rom.environment.run, error_tolerance=tolerance))
    for each, given in ((rom, {"error_tolerance": tolerance}), (replace(rom, environment=asks), {})):
        with pytest.warns(ToleranceWarning, match="'tip' is off by .* take a higher order$"):
            run = fr.simulate(each, finer=finer, **given)
        assert run.tolerance.times == pytest.approx([run.times[np.argmax(told > tolerance)]])
    for name, each in (("rom", rom), ("finer", finer)):
        fr.write_rom(tmp_path / f"{name}.h5", each)
    out = tmp_path / "run.h5"
    run_command("simulate", tmp_path / "rom.h5", "--finer", tmp_path / "finer.h5", "-o", out)
    assert "error of tip, estimate" in " ".join(capsys.readouterr().out.split())
    finer_file, refused = str(tmp_path / "finer.h5"), "is read by this command, so it cannot be its output"
    with pytest.raises(SystemExit):
        main(["simulate", str(tmp_path / "rom.h5"), "--finer", finer_file, "-o", finer_file, "--force"])
    with pytest.raises(SystemExit):
        main(["simulate", str(tmp_path / "rom.h5"), "--enriched", str(out), "-o", str(out)])
    assert re.search(f"{refused}.*is the file of -o, too", capsys.readouterr().err, re.DOTALL)
    again = fr.read_trajectory(out)
    assert again.errors["estimate"].norm is None
    np.testing.assert_array_equal(again.errors["estimate"].outputs["tip"], run.errors["estimate"].outputs["tip"])
    assert "error.png" not in {file.name for file in fr.plot(again, tmp_path / "plots")}


def test_what_is_refused(case, plate_system, plate_rom):
    _, rom, finer = case
    with pytest.raises(SceneError, match="is of order 4, and the body of 12; allowed is a higher one"):
        fr.simulate(finer, finer=rom)
    with pytest.raises(SceneError, match="is of another body"):
        fr.simulate(rom, finer=plate_rom)
    with pytest.raises(SceneError, match="an error that the ROM's runs state is beyond an error_tolerance"):
        fr.simulate(rom, finer=finer, error_tolerance=1e-4, enrich=SimpleNamespace(rom=rom))
    own = fr.reduce(plate_system, order=6, errors=True)
    with pytest.raises(SceneError, match="the body states its own errors"):
        fr.simulate(own, finer=plate_rom)
    with pytest.raises(SceneError, match="finer cannot be used with a System"):
        fr.simulate(plate_system, finer=plate_rom)
