"""What the vector environments of soft bodies have in common: episodes, seeds, failures, save and restore, pictures."""

from copy import copy, deepcopy
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from environment import checked
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from fenics_rom import Batch, Rom, read_rom
from fenics_rom.errors import SceneError

if TYPE_CHECKING:
    from picture import Thing

Array = np.ndarray
PRESSURE = 1e4  # Pa, the unit of taxels
FAILURE = -10.0  # reward of an action that no step could be found for
LARGEST = 100.0  # m kg^1/2, of a coordinate: some 30 m of an arm, which no pull of its tendons leads to


class Saved(NamedTuple):
    """All that a vector environment goes on from."""

    batch: Batch
    episode: dict[str, Array]
    random: Any


class SoftBodies(VectorEnv):
    """Many soft bodies of one ROM under the actions of a learner, whose steps are 0.1 s long.

    As is Gymnasium's custom (NEXT_STEP), the step after the last one of an episode ignores its action and returns the
    first observation of the next. A body that no step can be found for, or whose action is not finite, ends its episode
    (terminated, with the reward FAILURE); the others go on. `episode` holds what an environment knows beside the body,
    arrays of (num_envs, ..).

    Of a body with a sense of touch observations end with what that shows: pressures of taxels in PRESSURE, margin to
    slip and sliding share of the patch that presses most.

    A task says: `begin` (which episodes begin), `inputs` of an action, `observe`, `reward`, and what `moves`.

    Args:
        rom: the body, or the name of its file.
        num_envs: how many.
        observations, actions: numbers in an observation and in an action, which are within -1 and 1.
        dt: time step of the physics, s; 0.1 s is a multiple.
        length: actions in an episode.
        render_mode: "rgb_array" or None.

    Raises:
        SceneError: that is another body than the task is for.
    """

    tendons: tuple[str, ...]  # of the body, in this order
    obstacles: tuple[str, ...] = ()
    outputs: tuple[str, ...]  # and maybe more

    metadata = {  # noqa: RUF012, as Gymnasium has it
        "autoreset_mode": AutoresetMode.NEXT_STEP,
        "render_modes": ["rgb_array"],
        "render_fps": 10,
    }

    def __init__(
        self,
        rom: Rom | str,
        num_envs: int,
        *,
        observations: int,
        actions: int,
        dt: float,
        length: int,
        render_mode: str | None = None,
    ):
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ValueError(f'render_mode = {render_mode!r}: use "rgb_array" or None')
        if length < 1:
            raise ValueError(f"length = {length!r}: use a number of actions > 0")
        self.rom = rom if isinstance(rom, Rom) else read_rom(rom)
        self._check_body()
        self.has_begun = False
        self.num_envs, self.render_mode, self.length, self.skip = num_envs, render_mode, length, round(0.1 / dt)
        self._senses = {name: sense for name, sense in self.rom.readings.items() if sense.quantity == "touch"}
        observations += sum(len(sense.map.areas) + 2 for sense in self._senses.values())
        self.single_observation_space = Box(-np.inf, np.inf, (observations,))
        self.single_action_space = Box(-1, 1, (actions,))
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.batch = Batch(self.rom, num_envs, dt)
        self.episode: dict[str, Array] = {"age": np.zeros(num_envs, int), "over": np.zeros(num_envs, bool)}

    def reset(self, *, seed=None, options=None):
        """Begins an episode in every environment; from the same seed, the same episodes."""
        super().reset(seed=seed)
        self.has_begun = True
        self._begin(np.full(self.num_envs, True))
        return self._seen(), {}

    def step(self, actions):
        """What 0.1 s under the actions lead to; ResetNeeded and InvalidAction: see `checked`."""
        actions = np.clip(checked(self, actions), -1, 1).astype(float)
        episode, over = self.episode, self.episode["over"].copy()
        failed = ~np.isfinite(actions).all(axis=1)
        u = self.inputs(np.where(failed[:, None], 0.0, actions))
        for part in range(self.skip):
            self.moves(part)
            failed[self.batch.step(u, on_error="reset")] = True
        lost = np.abs(self.batch.state()[0]).max(axis=1) > LARGEST
        self.batch.reset(lost, on_error="hold")
        failed |= lost
        episode["age"] += 1
        if over.any():
            self._begin(over)
        reward, terminated = self.reward(actions)
        reward = np.where(over, 0.0, np.where(failed, FAILURE, reward))
        terminated = (terminated | failed) & ~over
        truncated = ~over & ~terminated & (episode["age"] == self.length)
        episode["over"] = terminated | truncated
        return self._seen(), reward, terminated, truncated, {}

    def _seen(self) -> Array:
        """Observations, with what is felt."""
        parts = [self.observe()]
        for name in self._senses:
            felt = self.batch.touch(name)
            shares = felt.patches.margin[:, :1], felt.patches.sliding[:, :1]
            parts += [felt.pressures.reshape(self.num_envs, -1) / PRESSURE, *shares]
        return np.hstack(parts).astype(np.float32)

    def save(self) -> Saved:
        """All of it: `restore` goes on from there to the bit. ResetNeeded: there is nothing to go on with yet."""
        if not self.has_begun:
            raise ResetNeeded("Cannot call env.save() before calling env.reset()")
        return Saved(copy(self.batch), deepcopy(self.episode), deepcopy(self.np_random.bit_generator.state))

    def restore(self, saved: Saved) -> Array:
        """Goes on from where it was saved; its observations."""
        self.batch, self.episode, self.has_begun = copy(saved.batch), deepcopy(saved.episode), True
        self.np_random.bit_generator.state = deepcopy(saved.random)
        return self._seen()

    def render(self):
        """Pictures (240, 320, 3) of all environments, drawn where there need not be a screen; None without a mode."""
        if self.render_mode is None:
            return None
        from picture import picture  # here, as drawing takes PyVista

        return tuple(picture(self.rom, self.batch.shape(k), *self.things(k)) for k in range(self.num_envs))

    def draw(self, which: Array, low: float | Array, high: float | Array, width: int) -> Array:
        """Random numbers (.., width) for the environments that begin, alike for the same seed."""
        return self.np_random.uniform(low, high, (int(which.sum()), width))

    def moves(self, part: int) -> None:
        """What moves by itself in the physics' step of that number."""

    def things(self, k: int) -> tuple[list["Thing"], list["Thing"]]:
        """What a body is to reach, and what is in its way, to draw them."""
        return [], []

    def begin(self, which: Array) -> None:
        """What is drawn for episodes that begin, before the bodies are reset."""
        raise NotImplementedError

    def inputs(self, actions: Array) -> Array:
        """Inputs (num_envs, p) of the batch."""
        raise NotImplementedError

    def observe(self) -> Array:
        """Observations (num_envs, ..)."""
        raise NotImplementedError

    def reward(self, actions: Array) -> tuple[Array, Array]:
        """Rewards, and where the episode is over as there is nothing left to do."""
        raise NotImplementedError

    def _check_body(self) -> None:
        body = self.rom
        actuators, obstacles = tuple(body.actuators), tuple(body.environment.obstacles)
        outputs = tuple(name for name in self.outputs if name in body.outputs)
        for part, needed, given, all_given in (
            ("tendons", self.tendons, actuators, actuators),
            ("obstacles", self.obstacles, obstacles, obstacles),
            ("outputs", self.outputs, outputs, tuple(body.outputs)),
        ):
            if given != needed:
                names, others = (", ".join(each) or "none" for each in (needed, all_given))
                raise SceneError(
                    f"{type(self).__name__}: the {part} of its body are {names}; those of {body.name!r} are {others}"
                )

    def _begin(self, which: Array) -> None:
        self.episode["age"][which], self.episode["over"][which] = 0, False
        self.begin(which)
        self.batch.reset(which, on_error="hold")
