"""Runs of bodies that turn as far as they like: kept whole, compared by rigid and elastic motion, drawn and told."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import box_arrays, box_surfaces

import fenics_rom as fr
from fenics_rom.cli.main import main
from fenics_rom.mechanics.base_path import CONJUGATE, quaternion_product
from fenics_rom.trajectory.elastic_part import elastic_part
from fenics_rom.visualization.optional_dependencies import pyvista_package

pyvista = pyvista_package()  # before dolfinx
AXIS = np.array([1.0, 2.0, -2.0]) / 3
SPIN = 4.0  # rad/s: a turn and a quarter in 2 s
TIMES = np.linspace(0.0, 2.0, 21)
NODES, CELLS = box_arrays((1.0, 0.4, 0.3), (3, 2, 2))
NODES = NODES - NODES.mean(axis=0)
MASS = np.ones(len(NODES))  # alike, so that stretching a box turns nothing
STRETCH = NODES * [1e-3, -4e-4, 0.0]


def turned(vectors, angle):
    """Vectors (N, 3) turned about the axis: Rodrigues."""
    along = (vectors @ AXIS)[:, None] * AXIS
    return along + np.cos(angle) * (vectors - along) + np.sin(angle) * np.cross(AXIS, vectors)


def thrown(lead=0.0, stretch=1.0):
    """A body that flies, turns and is stretched to and fro; `lead` is an angle by which it is ahead."""
    angles = SPIN * TIMES + lead
    amplitudes = stretch * np.sin(7 * TIMES)
    flown = TIMES[:, None] * [0.5, 0.0, 1.0]
    shapes = [turned(NODES + a * STRETCH, φ) + p - NODES for a, φ, p in zip(amplitudes, angles, flown, strict=True)]
    rotation = np.column_stack([np.cos(angles / 2), np.sin(angles / 2)[:, None] * AXIS])
    zeros = np.zeros(len(TIMES))
    return fr.Trajectory(
        name="thrown",
        model="full",
        settings={"dt": 0.1, "order": 9},
        times=TIMES,
        contacts=("one",),
        contact=zeros.astype(int),
        outputs={},
        **dict.fromkeys(("supplied", "dissipated", "lost_in_switching", "numerical"), zeros),
        energy=zeros + 1,
        snapshot_times=TIMES[1:],
        snapshots=np.array(shapes[1:]),
        nodes=NODES,
        triangles=np.concatenate(list(box_surfaces(NODES, CELLS).values())),
        node_mass=MASS,
        pose=np.hstack([flown, rotation * np.where(angles > 3, -1, 1)[:, None]]),  # either sign is the same rotation
        base_wrench=np.hstack([flown, 2 * flown]),
        momentum=np.tile([5.0, 0, 10, *(3 * AXIS)], (len(TIMES), 1)),
    )


def test_elastic_part_is_what_strains():
    run = thrown()
    expected = np.sin(7 * TIMES[1:])[:, None, None] * STRETCH
    np.testing.assert_allclose(elastic_part(run.snapshots, NODES, MASS), expected, atol=1e-15 * 20)
    flat = NODES * [1, 1, 0]  # a plane has two best fits, of which one is a mirror image
    np.testing.assert_allclose(elastic_part(turned(flat, 2.0) - flat, flat, MASS), 0, atol=1e-15 * 20)


def test_moving_runs_are_compared_by_pose_and_shape():
    differences = fr.compare(thrown(lead=1e-3, stretch=1.01), thrown())
    assert differences["rotation"].largest == pytest.approx(1e-3, rel=1e-9)
    assert differences["rotation"].unit == "rad"
    assert differences["elastic shape"].relative == pytest.approx(0.01, rel=1e-9)
    assert differences["position"].relative == differences["momentum"].relative == 0
    for name, unit in (("base force", "N"), ("base torque", "N m"), ("angular momentum", "N m s")):
        assert (differences[name].relative, differences[name].unit) == (0, unit)
    fixed = replace(thrown(), pose=None, base_wrench=None, momentum=None)
    assert "rotation" not in fr.compare(fixed, thrown())
    assert fr.compare(fixed, thrown())["elastic shape"].relative == 0
    assert list(fr.compare(fixed, fixed)) == ["shape", "energy"]


def test_moving_run_is_read_to_the_last_bit_and_told(tmp_path, capsys):
    run = thrown()
    for kept in (run, replace(run, base_wrench=None), replace(run, pose=None, base_wrench=None, momentum=None)):
        fr.write_trajectory(tmp_path / "run.h5", kept)
        back = fr.read_trajectory(tmp_path / "run.h5")
        for name in ("pose", "base_wrench", "momentum"):
            np.testing.assert_array_equal(getattr(back, name), getattr(kept, name))
        assert ("moving frame: position, rotation" in repr(back)) == (kept.pose is not None)
    fr.write_trajectory(tmp_path / "run.h5", run)
    with pytest.raises(SystemExit):
        main(["info", str(tmp_path / "run.h5")])
    said = capsys.readouterr().out
    assert f"largest base torque       {2 * np.sqrt(5):.4g} N m" in said
    assert "largest angular momentum" in said
    assert "position" not in said


def test_pose_wrench_and_momenta_are_drawn_and_exported(tmp_path):
    panels = ["rotation", "base_torque", "angular_momentum"]
    files = fr.plot({"full": thrown(), "reduced": thrown(lead=0.1)}, tmp_path / "run.svg", what=panels)
    text = files[0].read_text()
    for words in ("base torque (N m)", "angular momentum (N m s)", "rotation in world axes"):
        assert words in text
    fr.export(thrown(), tmp_path / "run.png", scale=50.0)
    fr.export(thrown(), tmp_path / "run.vtu", time=1.0)
    grid = pyvista.read(tmp_path / "run.vtu")
    moved = thrown().snapshots[9]
    np.testing.assert_array_equal(grid["displacement"], moved)
    np.testing.assert_array_equal(grid.field_data["position"].ravel(), [0.5, 0, 1.0])
    rotation = grid.field_data["rotation"].ravel()
    back = quaternion_product(rotation, thrown().pose[10, 3:] * CONJUGATE)
    np.testing.assert_allclose(np.abs(back), [1, 0, 0, 0], atol=1e-15)
