"""A ROM of higher order beside: estimates for bodies whose errors no residual tells."""

import copy
import pickle
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from bodies import scene_text
from test_errors import run_command

import fenics_rom as fr
from fenics_rom.cli.main import main
from fenics_rom.errors import SceneError, StepError, ToleranceWarning
from fenics_rom.scene.file import parse_scene

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
INERTIA = "inertia = {}\ndamping = { alpha = 2.0, beta = 1e-3 }\n"
PUSH = '{ contact = "right", force = [0, 5.0, -8.0], stop = 0.06 }'
ROPE = 'tendon.rope = { points = [[0.0, 0.4, 0.3], [0.5, 0.4, 0.3], [1.0, 0.4, 0.3]], control = "length" }\n'
SCENES = {  # what comes before the scene, effects, loads
    "relaxes": ("", "viscoelasticity = { ratios = [0.5], times = [0.1] }", PUSH),
    "stroke": ("", ROPE, PUSH + ', { actuator = "rope", force = [0.002] }'),
    "large": ("", "large_deformation = {}", PUSH),
    "carried": ('frame = "moving"\n', "gravity = { acceleration = [0, 0, -9.81] }", PUSH),
}


def reduced(box_file, name):
    """The system of a scene, and its ROMs of orders 4 and 12."""
    head, effects, loads = SCENES[name]
    run = f"dt = 2e-3\nduration = 0.12\nload = [{loads}]"
    text = scene_text(box_file, effects=INERTIA + effects, run=run, **{"outputs.tip": "points = [[1.0, 0.4, 0.3]]"})
    system = fr.assemble(parse_scene(head + text))
    return system, *(fr.reduce(system, order=order) for order in (4, 12))


@pytest.fixture(
    scope="module",
    params=[pytest.param(name, marks=[pytest.mark.slow] * (name == "large")) for name in SCENES],  # 10 s
)
def case(request, box_file):
    return reduced(box_file, request.param)


def test_estimates_are_near(case):
    system, rom, finer = case
    off = fr.simulate(system).outputs["tip"]
    run = fr.simulate(rom, finer=finer)
    true, told = np.abs(off - run.outputs["tip"]).max(), np.abs(run.errors["estimate"].outputs["tip"]).max()
    assert 1 / 1.5 < told / true < 1.5, (true, told)  # as of other estimates
    assert list(run.errors) == ["estimate"]
    assert "a ROM of order 12 takes the same steps" in run.errors["estimate"].why
    assert (run.outputs["tip"] == fr.simulate(rom).outputs["tip"]).all()


def test_a_tolerance_is_told_at_once(case):
    _, rom, finer = case
    told = np.abs(fr.simulate(rom, finer=finer).errors["estimate"].outputs["tip"]).max(axis=(1, 2))
    tolerance = float(told.max() / 2)
    asks = replace(rom.environment, run=replace(rom.environment.run, error_tolerance=tolerance))
    for each, given in ((rom, {"error_tolerance": tolerance}), (replace(rom, environment=asks), {})):
        with pytest.warns(ToleranceWarning, match="'tip' is off by .* take a higher order$"):
            run = fr.simulate(each, finer=finer, **given)
        assert run.tolerance.times == pytest.approx([run.times[np.argmax(told > tolerance)]])


def test_files_and_commands_take_it(box_file, tmp_path, capsys):
    _, rom, finer = reduced(box_file, "relaxes")
    run = fr.simulate(rom, finer=finer)
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


def inputs_of(rom, steps):
    """Random inputs of steps, of the size of the case's push."""
    columns = fr.Simulator(rom, 2e-3).inputs
    scales = np.array([5.0] * rom.contacts["right"] + [2e-3] * (columns - rom.contacts["right"]))
    return scales * np.random.default_rng(0).standard_normal((steps, columns)).cumsum(axis=0) / 3


def off(*bodies):
    """The difference of two simulators that were stepped alike, without either knowing of the other."""
    return bodies[1].displacement("tip") - bodies[0].displacement("tip")


def test_any_way_to_step(case):
    """Steps, rollouts, batches, copies, saved and reset bodies: all state the difference of two that step apart."""
    _, rom, finer = case
    u, apart = inputs_of(rom, 12), [fr.Simulator(each, 2e-3) for each in (rom, finer)]
    body, rolled, bodies = (
        make(rom, *given, finer=finer)
        for make, given in ((fr.Simulator, (2e-3,)), (fr.Simulator, (2e-3,)), (fr.Batch, (2, 2e-3)))
    )
    for row in u:
        for each in (*apart, body):
            each.step(row)
        bodies.step(np.stack([row, 0 * row]))
    true, told = off(*apart), lambda body: body.error_estimate.output("tip")
    assert np.abs(true).max() > 1e-6
    assert (told(body) == true).all()
    rolled.rollout(u)
    np.testing.assert_array_equal(told(rolled), true)
    np.testing.assert_array_equal(told(bodies)[0], true)
    assert bodies.error_estimate.norm is None
    saved = body.save()
    twins = [copy.copy(body), pickle.loads(pickle.dumps(body)), copy.copy(bodies)]
    for each in (*apart, body, *twins):
        each.dt = 1e-3
        each.step(u[0])
    for each in (body, *twins[:2]):
        assert (told(each) == off(*apart)).all()
    assert (told(twins[2])[0] == off(*apart)).all()
    body.restore(saved)
    assert (told(body) == true).all()
    body.reset()  # dt stays
    assert (told(body) == 0).all()
    for row in u:
        body.step(row)
    assert (told(body) == true).all()


def test_a_step_that_one_of_both_cannot_take_is_taken_by_none(case, monkeypatch):
    _, rom, finer = case
    body, bodies = fr.Simulator(rom, 2e-3, finer=finer), fr.Batch(rom, 2, 2e-3, finer=finer)
    u = inputs_of(rom, 3)
    for row in u:
        body.step(row)
        bodies.step(row)
    before, told = body.energy_coordinates.tolist(), body.error_estimate.output("tip")
    with pytest.raises(StepError):
        body.step(np.full(len(u[0]), np.nan))
    monkeypatch.setattr(body.beside.finer, "step", refuse)
    monkeypatch.setattr(bodies._bodies.bodies[1].beside.finer, "step", refuse)
    with pytest.raises(StepError, match=r"the ROM beside, '.*': no"):
        body.step(u[0])
    with pytest.raises(StepError, match=r"body 1: the ROM beside, .* all bodies were left as they were"):
        bodies.step(u[0])
    assert body.energy_coordinates.tolist() == before
    assert (body.steps, body.time) == (3, pytest.approx(6e-3))
    assert (body.error_estimate.output("tip") == told).all()
    assert (bodies.error_estimate.output("tip") == told).all()


def refuse(*_, **__):
    """A step that cannot be taken."""
    raise StepError("no")


def test_a_state_that_is_put_in_is_that_of_both(case):
    _, rom, finer = case
    body = fr.Simulator(rom, 2e-3, finer=finer)
    q = 1e-3 * np.random.default_rng(0).standard_normal(body.model.order)
    body.state = q, 10 * q
    assert "in the state that was put in" in body.error_estimate.why
    size = np.abs(body.displacement("tip")).max()
    assert np.abs(body.error_estimate.output("tip")).max() < 1e-2 * size
    assert (
        np.abs(body.beside.finer.velocity("tip") - body.velocity("tip")).max()
        < 1e-2 * np.abs(body.velocity("tip")).max()
    )


def test_what_is_refused(case, plate_system, plate_rom):
    _, rom, finer = case
    with pytest.raises(SceneError, match="is of order 4, and the body of 12; use a higher one"):
        fr.simulate(finer, finer=rom)
    with pytest.raises(StepError, match="a ROM beside gives an estimate alone"):
        fr.Simulator(rom, 1e-3, finer=finer).error_bound  # noqa: B018
    with pytest.raises(SceneError, match="is of another body"):
        fr.simulate(rom, finer=plate_rom)
    with pytest.raises(SceneError, match="an error that the ROM's runs state is beyond an error_tolerance"):
        fr.simulate(rom, finer=finer, error_tolerance=1e-4, enrich=SimpleNamespace(rom=rom))
    own = fr.reduce(plate_system, order=6, errors=True)
    with pytest.raises(SceneError, match="the body states its own errors"):
        fr.simulate(own, finer=plate_rom)
    with pytest.raises(SceneError, match="finer cannot be used with a System"):
        fr.simulate(plate_system, finer=plate_rom)
