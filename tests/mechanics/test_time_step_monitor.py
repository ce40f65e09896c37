"""A run says when its steps are too long for what moves."""

import math
from itertools import pairwise

import numpy as np
import pytest
import scipy.sparse as sp
from bodies import scene_text

import fenics_rom as fr
from fenics_rom.mechanics.time_step_monitor import TimeStepMonitor
from fenics_rom.scene.file import parse_scene

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")


@pytest.mark.parametrize("ωh", [0.01, 0.6, 3.0, 100.0])
def test_oscillation_of_one_eigenvector_takes_what_it_takes(ωh):
    """The midpoint rule turns (ω q, r) by 2 atan(ωh/2) in a step; the true steps_per_oscillation takes 2π/ωh steps."""
    turn, gauge = 2 * math.atan(ωh / 2), TimeStepMonitor()
    velocity = np.cos(turn * np.arange(20_001) + 0.3)
    for v, after in pairwise(velocity):
        gauge.add((after - v) ** 2, ((after + v) / 2) ** 2)
    assert gauge.steps_per_oscillation == pytest.approx(math.tau / ωh, rel=1e-2)
    assert bool(gauge.message) == (ωh > math.tau / 10)


def test_nothing_that_moves_is_nothing_to_say():
    assert TimeStepMonitor().steps_per_oscillation == math.inf
    assert TimeStepMonitor().message == ""


def test_runs_say_so_full_and_reduced_alike(box_file):
    run = 'duration = 4.0\ndt = {}\nload = [{{ contact = "right", stop = 0.8, force = [0.0, 0.0, 1.0] }}]'
    said = {}
    for dt in (0.01, 0.08):
        scene = parse_scene(scene_text(box_file, run=run.format(dt)))
        system = fr.assemble(scene)
        full, reduced = fr.simulate(system), fr.simulate(fr.reduce(system, order=60))
        assert full.warnings == reduced.warnings
        said[dt] = full.warnings
    assert said[0.01] == ()
    assert len(said[0.08]) == 1
    assert "the time step is long for what moves: " in said[0.08][0]


def test_equilibria_have_no_steps_that_are_too_long(box_file):
    run = 'duration = 1.0\ndt = 0.5\nload = [{ contact = "right", force = [0.0, 0.0, 1.0] }]'
    system = fr.assemble(parse_scene(scene_text(box_file, run=run, effects="")))
    assert fr.simulate(system).warnings == fr.simulate(fr.reduce(system)).warnings == ()


class TestSwitchesThatLose:
    def body(self, order):
        chain = sp.diags([-np.ones(29), 2 * np.ones(30), -np.ones(29)], [-1, 0, 1])
        ends = {"left": np.eye(30)[0], "right": np.eye(30)[-1]}
        rom = fr.reduce(
            fr.System(mass=sp.identity(30), damping=0.1 * chain, stiffness=chain, contacts=ends), order=order
        )
        return fr.Simulator(rom, dt=0.1)

    def test_much_are_told_with_what_they_lost(self):
        body = self.body(8)
        for _ in range(20):
            body.step([1.0])
        before = body.energy
        body.switch("right")
        lost = before - body.energy
        assert lost > 0.1 * before
        (said,) = body.warnings
        assert said.startswith(
            f"switching from 'left' to 'right' at t = 2 s lost {100 * lost / before:.2g} % of the stored"
        )
        assert f"({lost:.2g} J)" in said
        assert body.loss.energy == pytest.approx(lost)
        assert body.ledger.lost_in_switching == pytest.approx(lost)

    def test_the_worst_is_told_and_kept_with_the_state(self):
        body = self.body(8)
        for _ in range(20):
            body.step([1.0])
        start = body.save()
        body.switch("right")
        worst = body.loss
        body.switch("left")
        assert body.loss == worst  # the way back loses less
        after = body.save()
        body.restore(start)
        assert body.warnings == ()
        body.restore(after)
        assert body.loss == worst
        body.reset()
        assert body.warnings == ()

    def test_little_are_not(self):
        body = self.body(30)
        for _ in range(20):
            body.step([1.0])
        body.switch("right")
        assert body.loss.share < 1e-9
        assert body.warnings == ()

    def test_are_in_the_record_of_a_run(self, box_file):
        contacts = '[contacts.right]\nsurface = "right"\nforce = "nodal"\n[contacts.top]\nsurface = "top"'
        pinch = [0.0] * 24 + [50.0, 0.0, 0.0]
        run = f"""dt = 0.01
duration = 0.4
load = [{{ contact = "right", stop = 0.2, force = {pinch} }},
        {{ contact = "top", start = 0.2, force = [0.0, 0.0, 0.0] }}]"""
        system = fr.assemble(parse_scene(scene_text(box_file, run=run, contacts=contacts)))
        run = fr.simulate(fr.reduce(system, order=12))
        assert any("switching from 'right' to 'top' at t = 0.2 s lost" in said for said in run.warnings)
        assert run.lost_in_switching[-1] > 0.01 * run.energy.max()


def test_warnings_stay_in_the_file(box_file, tmp_path):
    run = 'duration = 1.6\ndt = 0.16\nload = [{ contact = "right", force = [0.0, 0.0, 1.0] }]'
    scene = parse_scene(scene_text(box_file, run=run))
    record = fr.simulate(scene)
    fr.write_trajectory(tmp_path / "run.h5", record)
    assert fr.read_trajectory(tmp_path / "run.h5").warnings == record.warnings != ()
