"""Which contact mode and which input act in every step of a run."""

import re
from dataclasses import replace

import numpy as np
import pytest

from fenics_rom.errors import SceneError
from fenics_rom.mechanics.load_history import MOST_STEPS, LoadHistory
from fenics_rom.scene.file import parse_scene

CONTACTS = {"tip": 3, "top": 1}
ACTUATORS = {"tendon": 1, "muscle": 2}
TABLE = np.array([[0.0, 0.0, 0.0, 0.0], [0.2, 2.0, 0.0, -4.0], [0.4, 2.0, 8.0, -4.0]])
SCENE = """
[mesh]
file = "none.msh"
[material]
young = 1
poisson = 0
density = 1
[contacts]
tip = { surface = "tip" }
top = { surface = "top", force = "normal" }
[actuators]
tendon = { surface = "left", force = "normal" }
muscle = { surface = "right" }
[effects]
inertia = {}
"""


def scene(*loads, run="dt = 0.1\nduration = 1.0"):
    run = f"[run]\n{run}\n" if run else ""
    return parse_scene(
        SCENE + run + "".join(f"[[run.load]]\n{load}\n" for load in loads), tables={"f.csv": TABLE}, source="s.toml"
    )


def history(*loads, dt=None, contacts=CONTACTS, actuators=ACTUATORS, **options):
    return LoadHistory(scene(*loads, **options).environment, contacts, actuators, dt)


def inputs(*loads, **options):
    """Contact mode of each step, and column by column the input."""
    contacts, u = zip(*history(*loads, **options), strict=True)
    return list(contacts), np.array(u).T if len(set(contacts)) == 1 else u


TIP = 'contact = "tip"\nforce = [1, 2, 3]\n'
TOP = 'contact = "top"\nforce = [7]\n'
TENDON = 'actuator = "tendon"\nforce = [5]\n'
MUSCLE = 'actuator = "muscle"\nforce = [-1, -2]\n'


def test_force_acts_on_the_steps_whose_middle_it_covers():
    contacts, u = inputs(TIP + "start = 0.14\nstop = 0.35")
    assert contacts == 10 * ["tip"]
    np.testing.assert_array_equal(u[:3], np.outer([1, 2, 3], [0, 1, 1, 0, 0, 0, 0, 0, 0, 0]))  # middles 0.15, 0.25
    assert not u[3:].any()


def test_table_is_interpolated_at_the_middle_of_each_step_and_held_beyond_its_ends():
    _, u = inputs('contact = "tip"\ntable = "f.csv"\nstop = 0.8')
    np.testing.assert_allclose(u[0], [0.5, 1.5, 2, 2, 2, 2, 2, 2, 0, 0], atol=1e-12)
    np.testing.assert_allclose(u[1], [0, 0, 2, 6, 8, 8, 8, 8, 0, 0], atol=1e-12)
    np.testing.assert_allclose(u[2], [-1, -3, -4, -4, -4, -4, -4, -4, 0, 0], atol=1e-12)


def test_times_of_a_table_are_those_of_the_run():
    _, u = inputs('contact = "tip"\ntable = "f.csv"\nstart = 0.3')
    np.testing.assert_allclose(u[1], [0, 0, 0, 6, 8, 8, 8, 8, 8, 8], atol=1e-12)


def test_loads_at_the_same_time_add_up():
    _, u = inputs(TIP, TIP + "start = 0.5", TENDON + "stop = 0.5", TENDON, MUSCLE + "start = 0.9")
    np.testing.assert_array_equal(u[2], 3 * np.array([1, 1, 1, 1, 1, 2, 2, 2, 2, 2]))
    np.testing.assert_array_equal(u[3], 5 * np.array([2, 2, 2, 2, 2, 1, 1, 1, 1, 1]))
    np.testing.assert_array_equal(u[4:, -2:], [[0, -1], [0, -2]])  # after the tendon, in the order of the actuators


def test_a_contact_mode_stays_until_another_one_is_pushed():
    contacts, u = inputs(TOP + "start = 0.2\nstop = 0.4", TIP + "start = 0.6\nstop = 0.8", MUSCLE)
    assert contacts == 6 * ["top"] + 4 * ["tip"]  # it begins in the first one pushed
    assert [len(one) for one in u] == 6 * [1 + 3] + 4 * [3 + 3]
    for step, one in enumerate(u):
        np.testing.assert_array_equal(one[-3:], [0, -1, -2])  # the actuators are there in any contact mode
        assert one[:-3].any() == (step in (2, 3, 6, 7))


def test_a_run_of_actuators_alone_is_in_the_first_contact_mode():
    contacts, u = inputs(TENDON)
    assert contacts == 10 * ["tip"]
    np.testing.assert_array_equal(u[3], 5)


def test_a_run_without_loads_is_at_rest():
    assert not inputs()[1].any()


def test_time_step_can_be_another():
    assert history(dt=0.05).steps == 20
    _, u = inputs(TIP + "start = 0.14\nstop = 0.35", dt=0.01)
    np.testing.assert_array_equal(np.flatnonzero(u[0]), range(14, 35))


@pytest.mark.parametrize(("dt", "steps"), [(0.1, 10), (1 / 3, 3), (0.3, 3), (1.0, 1), (0.7, 1)])
def test_whole_steps_come_nearest_to_the_duration(dt, steps):
    assert len(list(history(dt=dt))) == history(dt=dt).steps == steps


@pytest.mark.parametrize("dt", [0, -0.1, float("nan"), float("inf"), 1.1])
def test_time_step_that_is_none_is_refused(dt):
    with pytest.raises(SceneError, match=r"dt = .*: use more than 0 and at most the duration, 1 s"):
        history(dt=dt)


@pytest.mark.parametrize("dt", [0.9 / MOST_STEPS, 1e-300])
def test_run_that_no_memory_could_hold_is_refused(dt):
    with pytest.raises(SceneError, match=r"a run of .* steps; use at most 10,000,000"):
        history(dt=dt)


@pytest.mark.parametrize(
    ("load", "message"),
    [
        ('contact = "tip"\nforce = [1, 2]', "contact mode 'tip': use 3 numbers in its force (got 2)"),
        ('contact = "top"\nforce = [1, 2, 3]', "contact mode 'top': use 1 number in its force (got 3)"),
        ('contact = "top"\ntable = "f.csv"', "contact mode 'top': use 1 number in its force (got 3)"),
        ('actuator = "muscle"\nforce = [1, 2, 3]', "actuator 'muscle': use 2 numbers in its force (got 3)"),
    ],
)
def test_force_of_the_wrong_length_is_told(load, message):
    with pytest.raises(SceneError, match=re.escape(f"s.toml: run.load: {message}")):
        history(load)


def test_force_that_no_step_would_see_is_told():
    with pytest.raises(SceneError, match=r"the force from 0.31 to 0.34 s acts in the middle of no step of 0.1 s"):
        history(TIP + "start = 0.31\nstop = 0.34")
    with pytest.raises(SceneError, match=r"the force from 0.95 to 2 s acts in the middle of no step"):
        history(TIP + "start = 0.95\nstop = 2", dt=0.3)  # three steps end at 0.9 s


@pytest.mark.parametrize(
    ("load", "there", "message"),
    [
        (TOP, {"contacts": {"tip": 3, "topp": 1}}, "the model has no contact mode 'top'; there is tip, topp; did you"),
        (TENDON, {"actuators": {}}, "the model has no actuator 'tendon'; there is none"),
    ],
)
def test_load_history_of_another_scene_must_fit_the_model(load, there, message):
    with pytest.raises(SceneError, match=re.escape(f"s.toml: run.load: {message}")):
        history(load, **there)


def test_scene_without_a_run_is_told():
    with pytest.raises(SceneError, match=r"s.toml: has no \[run\], so there is no load history to simulate"):
        history(run="")


ROPE = "[effects.tendon.rope]\npoints = [[0, 0, 0], [1, 0, 0]]\n"


@pytest.mark.parametrize("pull", ["force = [-5]", 'table = "pull.csv"'])
def test_a_cable_that_pushes_is_refused(pull):
    """In a file, and of loads made in Python; a stroke, or a force of another actuator, may be negative."""
    tables = {"pull.csv": np.array([[0.0, 1.0], [0.5, -5.0]])}
    load = f"[run]\ndt = 0.1\nduration = 1.0\n[[run.load]]\nactuator = 'rope'\n{pull}\n"
    said = r"run.load.*: actuator 'rope': a tension of -5 N: a cable pulls and cannot push; use at least 0"
    with pytest.raises(SceneError, match=said):
        parse_scene(SCENE + ROPE + load, tables=tables)
    by_length = parse_scene(SCENE + ROPE + "control = 'length'\n" + load, tables=tables).environment
    LoadHistory(by_length, CONTACTS, {**ACTUATORS, "rope": 1})
    with pytest.raises(SceneError, match=said):
        LoadHistory(replace(by_length, controls={}), CONTACTS, {**ACTUATORS, "rope": 1})
