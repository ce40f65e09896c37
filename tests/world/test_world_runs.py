"""Runs of worlds from their files: written, read, drawn, and told of what is wrong."""

import numpy as np
import pytest

import fenics_rom as fr
from fenics_rom.cli.main import main
from fenics_rom.errors import FenicsRomError, SceneError
from fenics_rom.scene.reference import WORLD_EXAMPLE
from fenics_rom.trajectory.elastic_part import deformation

WORLD = WORLD_EXAMPLE.read_text().replace("duration = 1.0", "duration = 0.2\nevery = 3\nsnapshots = 10")


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    file = tmp_path_factory.mktemp("world") / "world.toml"
    file.write_text(WORLD)
    return fr.simulate(str(file), rate=True)


def test_a_run_keeps_poses_forces_and_accounts(run):
    assert list(run.bodies) == ["ground", "lower", "upper"]
    assert run.steps == 100
    assert len(run.times) == 35  # every third, and the last
    assert run.balance_error < 1e-12
    weight = 9.81 * np.array([0.5 + 0.2, 0.2])
    np.testing.assert_allclose(run.forces["ground-lower"][-1], [0, 0, -weight[0]], atol=1e-9)
    np.testing.assert_allclose(run.forces["lower-upper"][-1], [0, 0, -weight[1]], atol=1e-9)
    lower = run.bodies["lower"]
    assert np.abs(lower.pose - lower.pose[0]).max() < 1e-12
    assert (run.nodes + run.snapshots[-1])[lower.nodes, 2].min() == pytest.approx(0, abs=1e-12)
    assert not deformation(run, run.snapshots).any()  # of rigid bodies
    gain = lower.energy - lower.energy[0] - lower.supplied - lower.exchanged + lower.dissipated
    assert np.abs(gain).max() < 1e-12


def test_a_run_is_written_and_read(run, tmp_path):
    fr.write_trajectory(tmp_path / "run.h5", run)
    again = fr.read_trajectory(tmp_path / "run.h5")
    assert list(again.bodies) == list(run.bodies)
    for name, body in run.bodies.items():
        for key, value in vars(body).items():
            np.testing.assert_array_equal(getattr(again.bodies[name], key), value)
    np.testing.assert_array_equal(again.snapshots, run.snapshots)
    assert "bodies: ground, lower, upper" in repr(again)


def test_a_step_of_its_own_and_what_a_world_has_not(tmp_path):
    file = tmp_path / "world.toml"
    file.write_text(WORLD)
    assert fr.simulate(file, dt=0.01, every=1).steps == 20
    with pytest.raises(SceneError, match="stepper cannot be used with a WorldScene"):
        fr.simulate(file, stepper="newton")


@pytest.mark.parametrize(
    ("there", "instead", "said"),
    [
        ("position = [0, 0, 0.14]", "position = [0, 0, 0.1]", "upper"),  # begins inside the lower one
        ("[run]\ndt = 2e-3\nduration = 0.2\nevery = 3\nsnapshots = 10", "", r"has no \[run\]"),
        ("[bodies.upper]", "[bodies.up-per]", "names without a hyphen"),
    ],
)
def test_what_cannot_begin_is_told(tmp_path, there, instead, said):
    assert there in WORLD
    text = WORLD.replace(there, instead)
    (tmp_path / "world.toml").write_text(text.replace('"upper"', '"up-per"') if "-" in instead[9:] else text)
    with pytest.raises(FenicsRomError, match=said):
        fr.simulate(tmp_path / "world.toml")


def test_the_command_line_runs_a_world_and_tells_of_it(tmp_path, capsys):
    (tmp_path / "world.toml").write_text(WORLD)
    command = ["simulate", str(tmp_path / "world.toml"), "-o", str(tmp_path / "run.h5")]
    with pytest.raises(SystemExit) as ended:
        main(command)
    assert not ended.value.code
    said = capsys.readouterr().out
    assert "largest force of lower-upper" in said
    assert "supplied by obstacles" in said
    with pytest.raises(SystemExit) as ended:
        main([*command, "--stepper", "newton"])
    assert ended.value.code
