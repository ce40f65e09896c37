"""A soft plate to learn on, many of it at once: a vector environment of Gymnasium. Needs no FEniCSx."""

import numpy as np
from gymnasium.error import InvalidAction, ResetNeeded
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from fenics_rom import Batch, Rom, read_rom
from fenics_rom.errors import SceneError

STEP = 2e-3  # s, of the physics
SKIP = 10  # steps of the physics under one action
LENGTH = 50  # actions of an episode: 1 s
FORCE = 0.5  # N, the largest push; no pushes up to it turn the plate by 0.2 rad, more than a linear model can follow
REACH = 5e-3  # m, the highest target; the unit of heights
SPEED = 0.05  # m/s, the unit of speeds
EFFORT = 0.01  # what the largest push costs


class PlateReach(VectorEnv):
    """Bring the tip of a plate to a height and keep it there, by pushing the plate up or down at one place.

    Observation (4,): height and speed of the tip, height of the target, and where the plate is pushed: at its first
    contact mode (0) or its second (1). Action (1,): the push, as a share of FORCE. Reward: minus the distance from the
    target, minus a little for the effort. Target and place are new in every episode, which begins at rest and is
    truncated after LENGTH actions. The step after that ignores its action and returns the first observation of the
    next episode, as is Gymnasium's custom.

    Args:
        rom: of a plate with two contact modes and the output "tip", or the name of its file.
        num_envs: how many plates.

    Raises:
        SceneError: that is another body.
    """

    metadata = {"autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012, as Gymnasium has it

    def __init__(self, rom: Rom | str, num_envs: int):
        rom = rom if isinstance(rom, Rom) else read_rom(rom)
        if len(rom.contact_models) != 2 or "tip" not in rom.outputs:
            given = f"contact modes {', '.join(rom.contact_models)}; outputs {', '.join(rom.outputs) or 'none'}"
            raise SceneError(f"PlateReach: a plate has two contact modes and the output tip; {rom.name!r} has {given}")
        self.num_envs, self.has_begun = num_envs, False
        self.single_observation_space = Box(np.float32([-np.inf, -np.inf, -1, 0]), np.float32([np.inf, np.inf, 1, 1]))
        self.single_action_space = Box(-1, 1, (1,))
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.batch = Batch(rom, num_envs, STEP, dtype=np.float32)
        self.contacts = np.array(list(rom.contact_models))
        self.target, self.place, self.age = np.zeros(num_envs), np.zeros(num_envs, int), np.zeros(num_envs, int)

    def reset(self, *, seed=None, options=None):
        """Begins an episode in every environment; from the same seed, the same episodes."""
        super().reset(seed=seed)
        self.has_begun = True
        self._begin(np.full(self.num_envs, True))
        return self._observation(), {}

    def step(self, actions):
        """Pushes every plate for SKIP * STEP seconds; ResetNeeded before the first reset, InvalidAction: see below."""
        actions = checked(self, actions)
        if not np.isfinite(actions).all():
            which = np.flatnonzero(~np.isfinite(actions).all(axis=1))
            raise InvalidAction(f"actions: those of environments {which.tolist()} are not finite")
        over = self.age == LENGTH
        push = np.clip(actions[:, 0], -1, 1)
        force = FORCE * push[:, None] * [0, 0, 1]
        for _ in range(SKIP):
            self.batch.step(force)
        self.age += 1
        if over.any():
            self._begin(over)
        observation = self._observation()
        height, _, target, _ = observation.T
        reward = np.where(over, 0, -np.abs(height - target) - EFFORT * push**2)
        return observation, reward, np.zeros(self.num_envs, bool), self.age == LENGTH, {}

    def _begin(self, which):
        target, place = self.np_random.random((which.sum(), 2)).T
        self.target[which], self.place[which], self.age[which] = 2 * target - 1, place * len(self.contacts), 0
        self.batch.reset(which)
        self.batch.switch(self.contacts[self.place[which]], which)

    def _observation(self):
        height = self.batch.displacement("tip")[..., 2].mean(axis=1) / REACH
        speed = self.batch.velocity("tip")[..., 2].mean(axis=1) / SPEED
        return np.stack([height, speed, self.target, self.place], axis=1).astype(np.float32)


def checked(env, actions):
    """Actions as numbers (num_envs, ..), for an environment whose episodes have begun; nothing has happened otherwise.

    Raises:
        ResetNeeded: they have not.
        InvalidAction: these are not numbers of that shape.
    """
    if not env.has_begun:
        raise ResetNeeded("Cannot call env.step() before calling env.reset()")
    try:
        given = np.asarray(actions)
    except ValueError:
        raise InvalidAction(
            f"actions: rows of different lengths are given; use numbers of shape {env.action_space.shape}"
        ) from None
    if given.shape != env.action_space.shape or given.dtype.kind not in "fiu":
        what = f"{given.dtype} of shape {given.shape}"
        raise InvalidAction(f"actions: {what} are given; use real numbers of shape {env.action_space.shape}")
    return given
