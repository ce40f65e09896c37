"""The soft tasks of the learning demo: Gymnasium's customs, seeds, save and restore, and bodies that fail."""

import subprocess
import sys
import warnings
from dataclasses import replace
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.error import InvalidAction, ResetNeeded
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning, SceneError

FOLDER = Path(__file__).parents[2] / "demos" / "learning"
WITHOUT_FEM = """
import sys
for name in ("gmsh", "dolfinx", "pydantic", "scipy"):
    sys.modules[name] = None
import gymnasium, soft_tasks
gymnasium.make_vec("fenics_rom/ArmReach-v0", num_envs=2, rom=sys.argv[1]).reset(seed=1)
"""
TASKS = ("ArmFollow", "ArmReach", "ArmPegs", "ArmNest", pytest.param("FingerLift", marks=pytest.mark.slow))


@pytest.fixture(scope="module")
def make(tmp_path_factory):
    """Makes a task by its registered id; bodies are reduced once."""
    folder = tmp_path_factory.mktemp("bodies")
    with pytest.MonkeyPatch.context() as patch, warnings.catch_warnings():
        warnings.simplefilter("ignore", FenicsRomWarning)
        patch.syspath_prepend(FOLDER)
        import soft_bodies
        import soft_tasks

        def made(task, size, body=None, **choices):
            rom = soft_bodies.make(body or soft_tasks.TASKS[task][0], folder)
            return gymnasium.make_vec(f"fenics_rom/{task}-v0", num_envs=size, rom=str(rom), **choices)

        yield made
        for name in ("soft_bodies", "soft_tasks", "arms", "lifting", "vector", "environment", "picture"):
            sys.modules.pop(name, None)


def play(env, steps):
    """Observations, rewards and ends under random actions."""
    seen = []
    for _ in range(steps):
        observation, reward, terminated, truncated, _ = env.step(env.action_space.sample())
        assert observation in env.observation_space
        assert np.isfinite(observation).all()
        seen.append(np.column_stack([observation, reward, terminated, truncated]))
    return np.array(seen)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
def test_a_finger_with_a_sense_of_touch_observes_what_its_sensor_shows(make):
    env, again = (make("FingerLift", 2, body="feeling-finger", length=6) for _ in range(2))
    for one in (env, again):
        observation, _ = one.reset(seed=5)
        assert observation.shape == (2, 9 + 8 + 2)
        one.action_space.seed(1)
    seen = play(env, 5)
    np.testing.assert_array_equal(seen, play(again, 5))
    felt = env.unwrapped.batch.touch("skin")
    np.testing.assert_allclose(seen[-1, :, 9:17], felt.pressures.reshape(2, -1) / 1e4, rtol=1e-6)
    assert (felt.pressures[0] != felt.pressures[1]).any()  # each has noise of its own
    saved, ahead = env.save(), play(env, 2)
    env.restore(saved)
    env.action_space.seed(1)
    again.action_space.seed(1)
    assert ahead.shape == play(env, 2).shape == (2, 2, 9 + 8 + 2 + 3)


@pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
@pytest.mark.parametrize("task", TASKS)
def test_episodes_are_those_of_their_seed_and_go_on_from_where_they_were_saved(make, task):
    env, again = (make(task, 3, length=6) for _ in range(2))
    assert env.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    first = [one.reset(seed=5)[0] for one in (env, again)]
    np.testing.assert_array_equal(*first)
    for one in (env, again):
        one.action_space.seed(1)
    seen = play(env, 8)
    np.testing.assert_array_equal(seen, play(again, 8))
    ends = seen[..., -1]
    assert ends[5].all()
    assert not seen[6, :, -3:].any()  # the step that begins the next episode
    assert not np.allclose(seen[6, :, :-3], first[0])
    saved = env.save()
    env.action_space.seed(2)
    one = play(env, 6)
    np.testing.assert_array_equal(env.restore(saved), seen[-1, :, :-3].astype(np.float32))
    env.action_space.seed(2)
    np.testing.assert_array_equal(play(env, 6), one)


class Single(gymnasium.Env):
    """The only one of a vector environment, as Gymnasium's checker takes single ones alone."""

    def __init__(self, envs):
        self.envs, self.metadata, self.render_mode = envs, envs.metadata, envs.render_mode
        self.observation_space, self.action_space = envs.single_observation_space, envs.single_action_space

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        observation, info = self.envs.reset(seed=seed, options=options)
        return observation[0], info

    def step(self, action):
        (observation,), (reward,), (terminated,), (truncated,), info = self.envs.step(action[None])
        return observation, float(reward), bool(terminated), bool(truncated), info


@pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning", "ignore:.*(value is|spec):UserWarning")
@pytest.mark.parametrize("task", TASKS)
def test_gymnasiums_checker_takes_every_task(make, task):
    envs = make(task, 1)
    assert envs.spec.id == f"fenics_rom/{task}-v0"
    check_env(Single(envs), skip_render_check=True)
    with pytest.raises(ValueError, match="render_mode = 'human': use"):
        make(task, 1, render_mode="human")


def test_meshes_of_bodies_are_found_in_any_folder(make, tmp_path, monkeypatch):
    """Also in one that is named from where the process is."""
    import soft_bodies

    monkeypatch.chdir(tmp_path)
    Path("here").mkdir()
    assert soft_bodies.scene("pegs", Path("here")).mesh_file == tmp_path / "here" / "arm.msh"


@pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
def test_a_body_that_fails_ends_its_episode_alone(make):
    env, other = (make("ArmFollow", 3) for _ in range(2))
    for one in (env, other):
        one.reset(seed=3)
    q, r = env.batch.state()
    far = np.full_like(q[1], 5e70)
    env.batch.set_state(far, r[1], 1)
    actions = np.ones((3, 4), np.float32)
    observation, reward, terminated, _, _ = env.step(actions)
    expected = other.step(actions)
    assert terminated.tolist() == [False, True, False]
    assert reward[1] == -10
    np.testing.assert_array_equal(observation[[0, 2]], expected[0][[0, 2]])
    observation, reward, terminated, _, _ = env.step(actions)
    assert reward[1] == 0
    assert not terminated.any()
    assert not env.batch.state(1)[0].any()


@pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
def test_an_action_that_is_not_finite_ends_its_episode_alone(make):
    """Its observation stays finite, as learners take values of the last one, too."""
    env, other = (make("ArmPegs", 3) for _ in range(2))
    actions = np.full((3, 4), 0.5, np.float32)
    bad = actions.copy()
    bad[1, 2] = np.nan
    for one in (env, other):
        one.reset(seed=3)
    observation, reward, terminated, *_ = env.step(bad)
    expected = other.step(actions)
    assert np.isfinite(observation).all()
    assert terminated.tolist() == [False, True, False]
    assert reward[1] == -10
    np.testing.assert_array_equal(observation[[0, 2]], expected[0][[0, 2]])


@pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
@pytest.mark.parametrize("task", TASKS)
def test_what_cannot_be_stepped_is_a_clear_error_and_changes_nothing(make, task):
    env, other = (make(task, 3) for _ in range(2))
    actions = np.full(env.action_space.shape, 0.5, np.float32)
    for call in (lambda: env.step(actions), env.save):
        with pytest.raises(ResetNeeded, match=r"Cannot call env\.\w+\(\) before calling env\.reset\(\)"):
            call()
    for one in (env, other):
        one.reset(seed=3)
        for _ in range(7):  # the ball of ArmFollow would turn in the next
            one.step(actions)
    for given in (actions[:2], actions[0], actions[..., None], actions.repeat(2, axis=1), actions * 1j, None, [[0], 0]):
        with pytest.raises(InvalidAction, match="are given; use "):
            env.step(given)
    assert env.np_random.bit_generator.state == other.np_random.bit_generator.state
    np.testing.assert_array_equal(env.step(actions.tolist())[0], other.step(actions)[0])
    restored = make(task, 3)
    restored.restore(env.save())
    np.testing.assert_array_equal(restored.step(actions)[0], other.step(actions)[0])
    with pytest.raises(ValueError, match="length = 0: use"):
        make(task, 1, length=0)


ARM = "left1, right1, up1, down1, left2, right2, up2, down2"
PEGS = "first, second, third, fourth"


@pytest.mark.parametrize(
    ("task", "other", "said"),
    [
        ("ArmFollow", "finger", f"the tendons of its body are {ARM}; those of 'lifting finger' are flexor, extensor"),
        ("ArmReach", "pegs", f"the obstacles of its body are none; those of 'arm' are {PEGS}"),
        ("ArmNest", "far", f"the obstacles of its body are {PEGS}; those of 'arm' are none"),
        ("FingerLift", "far", f"the tendons of its body are flexor, extensor; those of 'arm' are {ARM}"),
        (
            "PlateReach",
            "far",
            "a plate has two contact modes and the output tip; 'arm' has contact modes end; outputs li",
        ),
    ],
)
def test_the_file_of_another_body_is_refused(make, task, other, said):
    with pytest.raises(SceneError, match=f"{task}: {said}"):
        make(task, 2, body=other)


def test_the_body_has_to_have_what_is_observed(make):
    from arms import ArmReach

    rom = make("ArmReach", 1).rom
    with pytest.raises(SceneError, match="the outputs of its body are line, tip; those of 'arm' are line"):
        ArmReach(replace(rom, outputs={"line": rom.outputs["line"]}), 2)


def test_the_plate_is_made_by_its_id_from_a_file(make, plate_rom, tmp_path):
    fr.write_rom(tmp_path / "plate.h5", plate_rom)
    env = gymnasium.make_vec("fenics_rom/PlateReach-v0", num_envs=3, rom=str(tmp_path / "plate.h5"))
    from environment import PlateReach

    np.testing.assert_array_equal(env.reset(seed=4)[0], PlateReach(plate_rom, 3).reset(seed=4)[0])


def test_tasks_are_made_where_there_is_neither_gmsh_nor_what_reads_scenes(make, tmp_path):
    """From the file of the body, with NumPy, h5py and Gymnasium alone."""
    rom = make("ArmReach", 1).rom
    fr.write_rom(tmp_path / "far.h5", rom)
    told = subprocess.run([sys.executable, "-c", WITHOUT_FEM, tmp_path / "far.h5"], cwd=FOLDER, capture_output=True)
    assert told.returncode == 0, told.stderr.decode()


@pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
def test_arms_bend_towards_what_pulls_and_pegs_hold_them(make):
    """The left tendons bend the arm to its left; a peg in the way pushes back."""
    env = make("ArmReach", 1)
    env.reset(seed=0)
    for _ in range(20):
        env.step(np.array([[1.0, 0.0, 1.0, 0.0]], np.float32))
    assert env.points[0, -1, 1] > 0.1
    assert env.pointing[0, 1] > 0.2
    pegs = make("ArmPegs", 1)
    pegs.reset(seed=0)
    for _ in range(20):
        pegs.step(np.array([[1.0, 1.0, 1.0, 1.0]], np.float32))
    assert pegs.batch.contact_force("first")[0, 1:].max() < 0
    assert 0.01 < pegs.points[0, -1, 1] < 0.06


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
@pytest.mark.parametrize("task", ["ArmFollow", "ArmReach", "ArmNest", "FingerLift"])
def test_pictures_are_drawn_without_a_screen(make, task, capfd):
    """With what is to be reached in red; VTK has nothing to complain of."""
    env = make(task, 2, render_mode="rgb_array")
    env.reset(seed=0)
    pictures = env.render()
    assert [image.shape for image in pictures] == [(240, 320, 3)] * 2
    for image in pictures:
        red, green, blue = np.moveaxis(image.astype(int), 2, 0)
        assert 20 < np.count_nonzero((red > 150) & (green < 140) & (blue < 140)) < 5000
    assert make(task, 1).render() is None
    assert capfd.readouterr() == ("", "")


def test_there_is_a_file_of_every_body_and_no_other(make, tmp_path):
    import soft_bodies
    import soft_tasks

    for body in {body for body, _ in soft_tasks.TASKS.values()}:
        assert soft_bodies.scene(body, tmp_path).name in ("arm", "lifting finger", "plate")
    with pytest.raises(
        SceneError, match="no body 'fingre'; there is far, feeling-finger, finger, pegs, plate; did you mean 'finger'"
    ):
        soft_bodies.make("fingre", tmp_path)


def test_training_without_pytorch_is_a_clear_error():
    code = "import runpy, sys; sys.modules['torch'] = None; runpy.run_path('train.py', run_name='__main__')"
    told = subprocess.run([sys.executable, "-c", code], cwd=FOLDER, capture_output=True, text=True)
    assert told.returncode == 1
    assert told.stderr.endswith(
        "which this Python lacks: .venv/bin/pip install -r demos/learning/requirements-training.txt\n"
    )
    assert told.stderr.startswith("error: training needs torch")
