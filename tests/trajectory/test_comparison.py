"""Differences of runs whose differences are known."""

import math
from dataclasses import replace

import numpy as np
import pytest

import fenics_rom as fr
from fenics_rom.cli.main import main
from fenics_rom.errors import CompareError
from fenics_rom.trajectory.series import ReadingSeries

NODES = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
MASS = np.array([1.0, 2.0, 5.0])
X = np.array([1.0, 0, 0])


def motion(times, scale=1.0):
    """Displacement of every node: along x, growing with time, (times, nodes, 3)."""
    return scale * times[:, None, None] * np.array([1.0, 2.0, 3.0])[:, None] * X


def record(dt=0.1, steps=20, scale=1.0, every=2, **changes):
    """A run of the motion, that keeps each second shape."""
    times = dt * np.arange(steps + 1)
    zeros = np.zeros(steps + 1)
    snapshot_times = times[every::every]
    return replace(
        fr.Trajectory(
            name="motion",
            model="full",
            settings={"dt": dt, "seconds": 1.0, "order": 9},
            times=times,
            contacts=("one",),
            contact=zeros.astype(int),
            outputs={"tip": motion(times, scale)[:, [2]]},
            energy=scale**2 * times**2,
            supplied=zeros,
            dissipated=zeros,
            lost_in_switching=zeros,
            numerical=zeros,
            snapshot_times=snapshot_times,
            snapshots=motion(snapshot_times, scale),
            nodes=NODES,
            triangles=np.array([[0, 1, 2]]),
            node_mass=MASS,
        ),
        **changes,
    )


def test_a_run_is_as_itself():
    for difference in fr.compare(record(), record()).values():
        assert (difference.relative, difference.largest) == (0.0, 0.0)


@pytest.mark.parametrize("ε", [1e-12, -0.25, 3.0])
def test_scaled_run_is_off_by_the_scale(ε):
    differences = fr.compare(record(scale=1 + ε), record())
    assert list(differences) == ["output tip", "shape", "energy"]
    for name, unit, length in (("output tip", 1, 6.0), ("shape", 1, 6.0), ("energy", 2, 4.0)):
        d = differences[name]
        share = abs((1 + ε) ** unit - 1)
        assert d.relative == pytest.approx(share, rel=1e-3)
        assert d.largest == pytest.approx(share * length, rel=1e-3)
        assert d.largest_reference == pytest.approx(length)  # of node 2 after 2 s; J after 2 s
    assert [d.instants for d in differences.values()] == [21, 10, 21]


def test_shapes_are_weighed_by_mass_and_outputs_are_not():
    """Node 1 stands still: of Σ m |u|², 1 + 2·4 + 5·9, 2·4 is missing, at all times alike."""
    still = record()
    still.snapshots[:, 1] = 0
    differences = fr.compare(still, record())
    assert differences["shape"].relative == pytest.approx(math.sqrt(8 / 54), rel=1e-12)
    assert differences["shape"].largest == pytest.approx(2 * 2.0)  # of any node, in m
    assert differences["output tip"].relative == 0


def test_one_instant_counts_by_its_share_of_the_whole_run():
    late = record()
    late.outputs["tip"][-1] += [0, 0.5, 0]
    times = np.arange(21) / 10
    d = fr.compare(late, record())["output tip"]
    assert d.relative == pytest.approx(0.5 / np.linalg.norm(3 * times), rel=1e-12)
    assert d.largest == pytest.approx(0.5)


@pytest.mark.parametrize(("dt", "steps", "instants"), [(0.1, 20, 21), (0.05, 40, 21), (0.2, 10, 11), (0.3, 6, 7)])
def test_runs_of_other_time_steps_are_compared_where_they_meet(dt, steps, instants):
    for run, reference in ((record(dt, steps), record()), (record(), record(dt, steps))):
        differences = fr.compare(run, reference)
        assert all(d.relative < 1e-12 for d in differences.values())
        assert differences["energy"].instants == instants


def test_runs_of_other_lengths_are_compared_where_they_meet():
    assert fr.compare(record(steps=12), record())["energy"].instants == 13
    assert fr.compare(record(), record(steps=12))["shape"].instants == 6


def test_runs_that_meet_only_at_rest_cannot_be_compared():
    """At the start any two runs agree, and an error of zero would be no news."""
    with pytest.raises(CompareError, match="no common times; run both with time steps of which one divides the other"):
        fr.compare(record(dt=0.1 * math.sqrt(2)), record())


def test_runs_without_a_common_shape_cannot_be_compared():
    shifted = record()
    with pytest.raises(CompareError, match="no common whole shapes"):
        fr.compare(replace(shifted, snapshot_times=shifted.snapshot_times + 0.05), record())


@pytest.mark.parametrize("nodes", [NODES[:2], NODES + 0.1])
def test_runs_of_other_meshes_cannot_be_compared(nodes):
    other = record(nodes=nodes, snapshots=np.zeros((10, len(nodes), 3)), node_mass=np.ones(len(nodes)))
    with pytest.raises(CompareError, match=f"the runs are of different meshes: {len(nodes)} and 3 nodes"):
        fr.compare(other, record())


def test_outputs_of_one_run_only_are_left_out():
    tip = record().outputs["tip"]
    one, other = record(outputs={"tip": tip, "a": tip}), record(outputs={"b": tip, "tip": tip})
    assert list(fr.compare(one, other)) == ["output tip", "shape", "energy"]
    assert list(fr.compare(one, record(outputs={"tip": np.repeat(tip, 2, axis=1)}))) == ["shape", "energy"]


def test_readings_are_compared_where_both_have_them_of_the_same_places():
    """A strain is as long as its tensor, whatever the axes: shears count twice."""
    pull, shear = np.arange(21.0), np.arange(21.0)[:, None, None] * np.array([0, 0, 0, 3.0, 0, 0])
    readings = {"pull": ReadingSeries("length", pull), "ε": ReadingSeries("strain", shear, triangles=np.arange(1))}
    scaled = {name: replace(reading, values=1.18 * reading.values) for name, reading in readings.items()}
    two = replace(readings["ε"], values=np.repeat(shear, 2, axis=1), triangles=np.arange(2))
    others = {"stress": readings["pull"], "two": two, "volume": readings["pull"]}
    other_reference = others | {"two": readings["ε"], "volume": replace(readings["pull"], quantity="volume")}
    differences = fr.compare(record(readings=scaled | others), record(readings=readings | other_reference))
    assert list(differences) == ["output tip", "shape", "energy", "reading pull", "reading ε", "reading stress"]
    for name, unit, size in (("pull", "m", 20), ("ε", "1", 60 * math.sqrt(2))):
        d = differences[f"reading {name}"]
        assert (d.relative, d.unit, d.instants) == (pytest.approx(0.18, rel=1e-12), unit, 21)
        assert d.largest_reference == pytest.approx(size, rel=1e-12)
        assert d.largest == pytest.approx(0.18 * size, rel=1e-12)


def test_a_body_at_rest_is_as_one_at_rest_and_infinitely_off_from_one_that_moves():
    for d in fr.compare(record(scale=0.0), record(scale=0.0)).values():
        assert d.relative == 0
    for d in fr.compare(record(), record(scale=0.0)).values():
        assert d.relative == math.inf
        assert d.largest > 0
    for d in fr.compare(record(scale=0.0), record()).values():
        assert d.relative == 1


def test_run_of_one_step_is_compared():
    assert fr.compare(record(steps=1, every=1), record(steps=1, every=1))["shape"].instants == 1


def pushed(forces, dt=0.1, **changes):
    """A run in which a stop pushes along z, with these means over the steps, N."""
    z = np.concatenate([[0.0], forces])
    return record(dt, len(forces), forces={"stop": z[:, None] * np.array([0.0, 0.0, 1.0])}, **changes)


PUSH = np.sin(np.linspace(0.1, 3.0, 20))


def test_contact_forces_are_compared_by_obstacle():
    differences = fr.compare(pushed(1.18 * PUSH), pushed(PUSH))
    assert list(differences)[-3:] == ["force of stop", "peak force of stop", "impulse of stop"]
    for name, unit, size in (
        ("force", "N", PUSH.max()),
        ("peak force", "N", PUSH.max()),
        ("impulse", "N s", PUSH.sum() / 10),
    ):
        d = differences[f"{name} of stop"]
        assert (d.relative, d.unit) == (pytest.approx(0.18, rel=1e-12), unit)
        assert d.largest_reference == pytest.approx(size, rel=1e-12)
        assert d.largest == pytest.approx(0.18 * size, rel=1e-12)


def test_a_peak_is_seen_where_the_impulse_is_right():
    sharp, round_ = np.zeros(20), np.zeros(20)
    sharp[5:9], round_[5:9] = (0.2, 0.4, 1.0, 0.2), (0.2, 0.55, 0.85, 0.2)
    differences = fr.compare(pushed(sharp), pushed(round_))
    assert differences["impulse of stop"].relative < 1e-15
    assert differences["peak force of stop"].relative == pytest.approx(0.15 / 0.85, rel=1e-12)
    share = math.sqrt(2 * 0.15**2) / math.sqrt(0.2**2 + 0.55**2 + 0.85**2 + 0.2**2)
    assert differences["force of stop"].relative == pytest.approx(share, rel=1e-12)


@pytest.mark.parametrize("swapped", [False, True])
def test_forces_of_other_steps_are_compared_by_what_they_gave_in_between(swapped):
    """A step of 0.2 s has the mean of two of 0.1 s, and then nothing is off."""
    runs = [pushed(PUSH.reshape(-1, 2).mean(axis=1), 0.2, every=1), pushed(PUSH)]
    differences = fr.compare(*(runs[::-1] if swapped else runs))
    for what in ("force", "peak force", "impulse"):
        assert differences[f"{what} of stop"].relative < 1e-14  # sums of 20 numbers


def test_obstacles_of_one_run_only_are_left_out():
    assert "force of stop" not in fr.compare(pushed(PUSH), record())
    assert "force of stop" not in fr.compare(record(), pushed(PUSH))


def test_the_command_prints_forces_and_names_a_step_that_both_have(tmp_path, capsys):
    for name, run in {
        "a": pushed(PUSH),
        "b": pushed(2 * PUSH),
        "c": pushed(PUSH.reshape(-1, 2).mean(axis=1), 0.2),
    }.items():
        fr.write_trajectory(
            tmp_path / f"{name}.h5", replace(run, warnings=("the body turned by 0.3 rad", f"{name} alone"))
        )
    for other, same in (("b", True), ("c", False)):
        with pytest.raises(SystemExit) as ended:
            main(["compare", str(tmp_path / f"{other}.h5"), str(tmp_path / "a.h5")])
        assert not ended.value.code
        said = capsys.readouterr().out
        assert ("both took steps of 0.1 s, so that step's own error is in both" in said) == same
        assert "peak force of stop" in said
        assert " N s" in said
        files = f"{tmp_path / f'{other}.h5'}, {tmp_path / 'a.h5'}"
        assert said.count("the body turned by 0.3 rad") == said.count(f"  warning: {files}: the body turned") == 1
        assert f"  warning: {tmp_path / f'{other}.h5'}: {other} alone" in said
    with pytest.raises(SystemExit):
        main(["compare", *(str(tmp_path / name) for name in ("b.h5", "c.h5")), "--finer", str(tmp_path / "a.h5")])
    said = capsys.readouterr().out
    apart, step = (
        fr.compare(fr.read_trajectory(tmp_path / f"{one}.h5"), fr.read_trajectory(tmp_path / f"{other}.h5"))
        for one, other in ("bc", "ca")
    )
    for name in ("force of stop", "impulse of stop"):
        (row,) = (line for line in said.splitlines() if line.strip().startswith(name))
        assert row.removeprefix(f"  {name}").split()[:2] == [f"{d[name].relative:.2e}" for d in (apart, step)]
