"""Points of tendons go with the nodes around them."""

import numpy as np
import pytest
from bodies import box_arrays, scene_text

import fenics_rom as fr
from fenics_rom.scene.file import parse_scene
from fenics_rom.visualization.tendon_routing import NEAREST, TendonRouting

CABLE = [[0.05, 0.13, 0.11], [0.5, 0.25, 0.21], [0.97, 0.3, 0.07]]


@pytest.fixture(scope="module")
def cabled(box_file):
    """A box with a tendon, which is pulled; its points are outputs, too."""
    text = scene_text(box_file, **{"effects.tendon.cable": f"points = {CABLE}"})
    text += f"\n[outputs.cable]\npoints = {CABLE}\n"
    text += '\n[run]\ndt = 0.01\nduration = 0.3\nload = [{ actuator = "cable", stop = 0.2, force = [2.0] }]\n'
    return fr.assemble(parse_scene(text))


def test_affine_motion_is_followed_exactly():
    """Of 16 nodes the fit is of condition some 1e6 where one of them is near: 1e-12 of the motion is round-off."""
    rng = np.random.default_rng(0)
    nodes, _ = box_arrays((1.0, 0.4, 0.3), (8, 4, 3))
    points = np.concatenate([CABLE, nodes[[5]], nodes[[7]] + 1e-9, [[1.01, 0.2, 0.1]]])
    A, b = rng.standard_normal((3, 3)), rng.standard_normal(3)
    moved = TendonRouting(nodes, points).moved(nodes @ A.T + b)
    np.testing.assert_allclose(moved, points + points @ A.T + b, atol=1e-11)
    np.testing.assert_allclose(
        TendonRouting(nodes, points).moved(nodes @ A.T, 0.5), points + points @ A.T / 2, atol=1e-11
    )


def test_nodes_in_a_plane_and_few_nodes_are_followed_too():
    nodes = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.0]])
    assert len(nodes) < NEAREST
    moved = TendonRouting(nodes, np.array([[0.3, 0.4, 0.0]])).moved(nodes[:, [1, 0, 0]])
    np.testing.assert_allclose(moved, [[0.7, 0.7, 0.3]], atol=1e-12)


def test_tendons_are_kept_by_roms_and_runs_and_follow_the_body(cabled, tmp_path):
    rom = fr.reduce(cabled, order=20)
    full = fr.simulate(cabled)
    assert np.array_equal(rom.environment.tendons["cable"], CABLE)
    for run in (full, fr.simulate(rom)):
        fr.write_trajectory(tmp_path / "run.h5", run)
        run = fr.read_trajectory(tmp_path / "run.h5")
        assert np.array_equal(run.tendons["cable"], CABLE)
        routing, largest = TendonRouting(run.nodes, run.tendons["cable"]), np.abs(run.outputs["cable"]).max()
        for row, instant in enumerate(run.snapshot_times):
            exact = CABLE + run.outputs["cable"][np.abs(run.times - instant).argmin()]
            assert np.abs(routing.moved(run.snapshots[row]) - exact).max() < 0.15 * largest  # a mesh of 4 x 2 x 2


def test_runs_of_bodies_without_tendons_have_none(plate_rom):
    assert fr.simulate(plate_rom, dt=0.01).tendons == {}
