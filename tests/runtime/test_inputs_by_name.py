"""Inputs by name or by position, ROMs or their files, and a clear word on anything else."""

import numpy as np
import pytest
from bodies import scene_text

import fenics_rom as fr
from fenics_rom.scene.file import parse_scene

PULL = {"actuators.pull": 'surface = "back"\nforce = "normal"', "actuators.push": 'surface = "front"'}


@pytest.fixture(scope="module")
def rom(box_file):
    return fr.reduce(fr.assemble(parse_scene(scene_text(box_file, **PULL))), order=8)


def stepped(rom, *u, **named):
    body = fr.Simulator(rom, 1e-3)
    body.step(*u, **named)
    return np.concatenate(body.state)


@pytest.mark.parametrize(
    ("by_position", "by_name"),
    [
        ([1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0], {"right": [1, 2, 3], "pull": 4, "push": [5, 6, 7]}),
        ([0.0, 0.0, 0.0, 4.0, 0.0, 0.0, 0.0], {"pull": [4.0]}),
        ([0.0, 0.0, 0.5, 0.0, 0.0, 0.0, 0.0], {"right": np.array([0, 0, 0.5])}),
        ([0.0] * 7, {}),
    ],
)
def test_a_name_is_a_place(rom, by_position, by_name):
    expected = stepped(rom, by_position)
    np.testing.assert_array_equal(stepped(rom, by_name), expected)
    if by_name:
        np.testing.assert_array_equal(stepped(rom, **by_name), expected)


def test_bodies_of_a_batch_are_told_by_name(rom):
    pulls, forces = np.array([1.0, 2.0, 3.0]), np.arange(9.0).reshape(3, 3)
    batch, expected = fr.Batch(rom, size=3, dt=1e-3), fr.Batch(rom, size=3, dt=1e-3)
    for each in (batch, expected):
        each.switch("top", [1])
    u = np.zeros((3, 7))
    u[:, :3], u[:, 3], u[:, 4:] = forces, pulls, [0, 0, 1]
    u[1, :3] = 0.5
    batch.step({"right": forces, "top": [0.5, 0.5, 0.5], "pull": pulls, "push": [0, 0, 1]})
    expected.step(u)
    np.testing.assert_array_equal(batch.energy, expected.energy)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"pul": 1.0}, "no input 'pul'; there is .*did you mean 'pull'"),
        ({"top": [0, 0, 1]}, "no body is in that contact mode"),
        ({"pull": np.zeros((3, 2))}, r"use 1 real numbers, or \(3, 1\)"),
        ({"push": 1j}, "use 3 real numbers"),
        ({"push": 1.0}, "use 3 real numbers"),
    ],
)
def test_what_is_no_input_of_a_batch_is_refused(rom, given, message):
    with pytest.raises(fr.StepError, match=message):
        fr.Batch(rom, size=3, dt=1e-3).step(given)


@pytest.mark.parametrize(
    ("u", "named", "message"),
    [
        ((), {"pul": 1.0}, "no input 'pul'; there is pull, push, right; did you mean 'pull'"),
        ((), {"top": [0, 0, 1]}, "no input 'top'.*switch to that contact mode first"),
        ((), {"pull": [1, 2]}, r"input 'pull' = \[1, 2\]: use 1 real numbers"),
        ((), {"pull": 1j}, "input 'pull' = 1j: use 1 real numbers"),
        ((), {"right": None}, "input 'right' = None"),
        (([0.0] * 7,), {"pull": 1.0}, "by position and by name"),
        (([0.0] * 6 + [1j],), {}, "use 7 numbers"),
        ((np.full(7, 1 + 1j),), {}, "use 7 numbers"),
        ((np.zeros(7, complex),), {}, "use 7 numbers"),
    ],
)
def test_what_is_no_input_is_refused(rom, u, named, message):
    body = fr.Simulator(rom, 1e-3)
    with pytest.raises(fr.StepError, match=message):
        body.step(*u, **named)
    assert (body.steps, body.energy) == (0, 0.0)


def test_complex_numbers_are_refused_everywhere(rom):
    body, bodies = fr.Simulator(rom, 1e-3), fr.Batch(rom, 2, 1e-3)
    for take in (lambda: body.rollout(np.zeros((3, 7), complex)), lambda: bodies.step(np.zeros((2, 7), complex))):
        with pytest.raises(fr.StepError, match="real numbers"):
            take()
    assert body.steps == bodies.steps == 0


@pytest.mark.parametrize("dtype", [int, np.float32, bool, ">f8"])
def test_other_real_numbers_are_taken(rom, dtype):
    u = np.array([1, 0, 1, 0, 0, 1, 1])
    np.testing.assert_array_equal(stepped(rom, u.astype(dtype)), stepped(rom, u.astype(float)))


def test_the_name_of_a_file_stands_for_its_rom(rom, tmp_path):
    file = tmp_path / "rom.h5"
    fr.write_rom(file, rom)
    for given in (file, str(file)):
        assert fr.Simulator(given, 1e-3).rom == fr.Batch(given, 2, 1e-3).rom == rom


def test_runs_are_made_of_files(plate_rom, tmp_path):
    fr.write_rom(tmp_path / "plate.h5", plate_rom)
    run = fr.simulate(str(tmp_path / "plate.h5"), dt=0.01)
    np.testing.assert_array_equal(run.energy, fr.simulate(plate_rom, dt=0.01).energy)


@pytest.mark.parametrize("make", [lambda rom: fr.Simulator(rom, 1e-3), lambda rom: fr.Batch(rom, 2, 1e-3)])
@pytest.mark.parametrize("given", [None, 3.0, np.zeros(3), {}])
def test_what_is_no_rom_is_told_what_to_give(make, given):
    with pytest.raises(fr.SceneError, match="was given; use a Rom, or the name of a file of one"):
        make(given)


def test_exceptions_are_in_the_package():
    errors = [
        name for name, value in vars(fr.errors).items() if getattr(value, "__module__", "") == "fenics_rom.errors"
    ]
    errors = [name for name in errors if isinstance(getattr(fr.errors, name), type)]
    assert "StepError" in errors
    assert all(getattr(fr, name) is getattr(fr.errors, name) and name in fr.__all__ for name in errors)
