"""The vector environment keeps Gymnasium's customs and the simulator's numbers; its demo keeps its claims."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gymnasium.error import InvalidAction, ResetNeeded
from gymnasium.utils import passive_env_checker as checker
from gymnasium.utils.performance import benchmark_vector_step
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from gymnasium.wrappers.vector import RecordEpisodeStatistics

import fenics_rom as fr
from fenics_rom.errors import SceneError

FOLDER = Path(__file__).parents[2] / "demos" / "learning"


@pytest.fixture(scope="module")
def environment():
    """The module of the environment."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(FOLDER)
        import environment

        yield environment


@pytest.fixture
def make(environment, plate_rom):
    return lambda size: environment.PlateReach(plate_rom, size)


def rollout(env, seed, actions):
    """Observations (steps + 1, n, 4), rewards and truncations (steps, n); `actions` may be for more environments."""
    observations, rewards, ends = [env.reset(seed=seed)[0]], [], []
    for action in actions:
        observation, reward, terminated, truncated, info = env.step(action[: env.num_envs])
        assert not terminated.any()
        assert info == {}
        observations.append(observation)
        rewards.append(reward)
        ends.append(truncated)
    return np.array(observations), np.array(rewards), np.array(ends)


def random_actions(steps, size):
    return np.random.default_rng(0).uniform(-1, 1, (steps, size, 1)).astype(np.float32)


def test_spaces_are_as_gymnasium_wants_them(make):
    env = make(5)
    checker.check_space(env.single_observation_space, "observation", checker.check_observation_space)
    checker.check_space(env.single_action_space, "action", checker.check_action_space)
    assert env.observation_space == batch_space(env.single_observation_space, 5)
    assert env.action_space == batch_space(env.single_action_space, 5)
    observation, info = env.reset(seed=0)
    assert info == {}
    assert observation in env.observation_space
    for actions in (env.action_space.sample() for _ in range(60)):
        observation, reward, *ends, _ = env.step(actions)
        checker.check_obs(observation, env.observation_space, "step")
        assert observation in env.observation_space
        assert [part.shape for part in (reward, *ends)] == [(5,)] * 3
        assert [part.dtype for part in ends] == [bool] * 2


def test_gymnasiums_own_tools_take_it(make, environment):
    assert benchmark_vector_step(make(3), target_duration=0, seed=1) > 0
    env = RecordEpisodeStatistics(make(3))
    env.reset(seed=1)
    actions, total = random_actions(environment.LENGTH, 3), 0
    for action in actions:
        _, reward, _, _, info = env.step(action)
        total = total + reward
    np.testing.assert_allclose(info["episode"]["r"], total, rtol=1e-5)
    np.testing.assert_array_equal(info["episode"]["l"], environment.LENGTH)


def test_next_episode_begins_at_rest_in_the_step_after_the_last(make, environment):
    """Gymnasium's NEXT_STEP: the last observation of an episode is seen, and the action after it is ignored."""
    env, length = make(64), environment.LENGTH
    assert env.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    observations, rewards, ends = rollout(env, 1, random_actions(2 * length + 2, 64))
    assert np.flatnonzero(ends.any(axis=1)).tolist() == np.flatnonzero(ends.all(axis=1)).tolist()
    assert np.flatnonzero(ends.all(axis=1)).tolist() == [length - 1, 2 * length]
    heights, speeds, targets, places = np.moveaxis(observations, 2, 0)
    assert heights[length].all()
    for first in (0, length + 1, 2 * length + 2):
        assert not heights[first].any()
        assert not speeds[first].any()
        assert 20 < places[first].sum() < 44  # of 64
        assert 0.8 < np.ptp(targets[first]) / 2 <= 1
    assert not rewards[length].any()
    assert (rewards[:length] < 0).all()
    assert (targets[0] == targets[length]).all()
    assert (targets[0] != targets[length + 1]).all()
    assert (places[0] != places[length + 1]).any()


def test_environments_may_be_at_different_ages(make, environment):
    """Each begins anew by itself; the others go on as if nothing had happened."""
    actions = random_actions(30, 4)
    undisturbed, *_ = rollout(make(4), 1, actions)
    env = make(4)
    env.reset(seed=1)
    env.age[2] = environment.LENGTH - 10
    ends = []
    for k, action in enumerate(actions):
        observation, reward, _, truncated, _ = env.step(action)
        ends.append(truncated)
        others = [0, 1, 3]
        np.testing.assert_allclose(observation[others], undisturbed[k + 1, others], rtol=1e-4, atol=1e-5)
        assert (reward[2] == 0) == (k == 10)
    assert np.argwhere(ends).tolist() == [[9, 2]]


def test_same_seed_same_episodes_to_the_bit(make, environment):
    actions = random_actions(environment.LENGTH + 5, 16)
    one, again, other = (rollout(make(16), seed, actions) for seed in (1, 1, 2))
    used = make(16)
    rollout(used, 3, actions[:7])
    for part, repeated, reused in zip(one, again, rollout(used, 1, actions), strict=True):
        np.testing.assert_array_equal(part, repeated)
        np.testing.assert_array_equal(part, reused)
    assert (one[0][0, :, 2] != other[0][0, :, 2]).all()


def test_an_episode_does_not_depend_on_the_company(make, environment):
    actions = random_actions(environment.LENGTH, 300)
    for few, many in zip(rollout(make(3), 1, actions), rollout(make(300), 1, actions), strict=True):
        np.testing.assert_allclose(few, many[:, :3], rtol=1e-4, atol=1e-5)


def test_every_environment_is_a_plate_of_its_own(make, environment, plate_rom):
    """Against a Simulator for each, from the units of the docstring, in float64."""
    actions = random_actions(environment.LENGTH, 8)
    observations, rewards, _ = rollout(make(8), 1, actions)
    assert set(observations[0, :, 3]) == {0, 1}
    for k, (_, _, target, place) in enumerate(observations[0].tolist()):
        body = fr.Simulator(plate_rom, dt=environment.STEP)
        body.switch(("tip_left", "middle")[int(place)])
        for step, push in enumerate(actions[:, k, 0].tolist()):
            for _ in range(environment.SKIP):
                body.step([0.0, 0.0, 0.5 * push])
            height, speed = (read("tip")[:, 2].mean() for read in (body.displacement, body.velocity))
            expected = [height / 5e-3, speed / 0.05, target, place]
            np.testing.assert_allclose(observations[step + 1, k], expected, rtol=1e-3, atol=1e-4)
            assert rewards[step, k] == pytest.approx(-abs(expected[0] - target) - 0.01 * push**2, abs=1e-3)
        assert body.time == pytest.approx(1.0)


def test_pushes_beyond_the_largest_are_the_largest(make):
    three = [np.full((5, 2, 1), push, np.float32) for push in (1.0, 7.0, -7.0)]
    largest, more, less = (rollout(make(2), 1, actions) for actions in three)
    for part, same in zip(largest, more, strict=True):
        np.testing.assert_array_equal(part, same)
    np.testing.assert_array_equal(less[0][..., :2], -largest[0][..., :2])


def test_what_cannot_be_stepped_is_a_clear_error_and_changes_nothing(make):
    env, other = make(3), make(3)
    actions = np.full((3, 1), 0.5, np.float32)
    with pytest.raises(ResetNeeded, match=r"Cannot call env\.step\(\) before calling env\.reset\(\)"):
        env.step(actions)
    for one in (env, other):
        one.reset(seed=1)
    bad = actions.copy()
    bad[1] = np.nan
    for given, said in (
        (actions[:2], r"float32 of shape \(2, 1\) are given; use real numbers of shape \(3, 1\)"),
        (actions[:, 0], r"float32 of shape \(3,\)"),
        (np.zeros((3, 2)), r"float64 of shape \(3, 2\)"),
        (actions.astype(complex), "complex128 of shape"),
        (None, r"object of shape \(\)"),
        ([[0.0], [0.0, 1.0], [0.0]], r"rows of different lengths are given; use numbers of shape \(3, 1\)"),
        (bad, r"those of environments \[1\] are not finite"),
    ):
        with pytest.raises(InvalidAction, match=f"actions: {said}"):
            env.step(given)
    np.testing.assert_array_equal(env.step(actions.tolist())[0], other.step(actions)[0])


def test_a_plate_has_two_contact_modes_and_a_tip(environment, plate_rom):
    one = replace(plate_rom, contact_models={"middle": plate_rom.contact_models["middle"]})
    for other, given in (
        (one, "contact modes middle; outputs tip"),
        (replace(plate_rom, outputs={}), "contact modes tip_left, middle; outputs none"),
    ):
        with pytest.raises(SceneError, match=f"two contact modes and the output tip; 'plate' has {given}"):
            environment.PlateReach(other, 2)


@pytest.mark.parametrize("contact", ["tip_left", "middle"])
def test_no_policy_drives_the_plate_beyond_what_a_linear_model_can_follow(environment, plate_rom, contact):
    """What moves the tip furthest in an episode: pushes that follow the sign of its response to one, backwards."""

    def heights(pushes):
        body = fr.Simulator(plate_rom, dt=environment.STEP)  # a warning of it fails the test
        body.switch(contact)
        for push in pushes:
            for _ in range(environment.SKIP):
                body.step([0.0, 0.0, environment.FORCE * push])
            yield body.displacement("tip")[:, 2].mean()

    answer = np.array(list(heights([1.0] + [0.0] * (environment.LENGTH - 1))))
    *_, furthest = heights(np.sign(answer)[::-1])
    assert furthest == pytest.approx(np.abs(answer).sum())
    assert furthest > 5 * environment.REACH


@pytest.mark.slow
def test_demo_keeps_its_claims():
    run = subprocess.run(
        [sys.executable, FOLDER / "learning.py", "--quick"], capture_output=True, text=True, env=dict(os.environ)
    )
    assert run.returncode == 0, run.stdout + run.stderr
    assert run.stdout.count("holds: ") == 6
    out = FOLDER / "out" / "quick"
    rows = [line.split("|")[1:-1] for line in (out / "policies.md").read_text().splitlines()[2:]]
    returns = {row[0].strip(): float(row[3]) for row in rows if row[1].strip() == "both"}
    assert returns["hand-made"] > 0.5 * returns["idle"] > 0.5 * returns["random"]
    assert (out / "cost.md").read_text().count("\n") == 4
    assert (out / "learning.png").stat().st_size > 10_000
    assert fr.read_rom(out / "plate.h5").contact_models["middle"].order == 20
