"""A soft finger lifts a plate from its posts and holds it: an obstacle that moves as the finger pushes it."""

import numpy as np
from picture import Block
from soft_bodies import LOAD_HEIGHT, LOAD_SIZE
from vector import SoftBodies

Array = np.ndarray
MASS, GRAVITY = 0.02, 9.81  # kg of the plate, and m/s²
TENSION = 6.0  # N, the largest of a tendon
LOWEST, HIGHEST = 2e-3, 6e-3  # m, that the plate is to be lifted by
UNIT, SPEED = 5e-3, 0.05  # m and m/s, of observations


class FingerLift(SoftBodies):
    """Lift a plate from its posts to a height, and hold it there, by a tendon on the finger's upper or lower side.

    The plate is an obstacle for the finger. It moves up and down under its weight and what pushed it in the step of the
    physics before; it rests on its posts. Observation (9): heights of three points of the finger and the speed of the
    last, the force on the plate in parts of its weight, height and speed of the plate, the height to reach, the pull.
    Action (1): change of the pull, as a share of a fifth of TENSION. Reward: minus the distance in UNIT, and 1 within
    half a millimetre.
    """

    tendons, obstacles, outputs = ("flexor", "extensor"), ("load",), ("line",)

    def __init__(self, rom, num_envs: int, render_mode: str | None = None, length: int = 30):
        super().__init__(rom, num_envs, observations=9, actions=1, dt=5e-3, length=length, render_mode=render_mode)
        self.episode |= {name: np.zeros(num_envs) for name in ("height", "speed", "goal", "pull", "force")}

    def begin(self, which: Array) -> None:
        """Draws the height; the plate lies on its posts."""
        self.episode["goal"][which] = self.draw(which, LOWEST, HIGHEST, 1)[:, 0]
        for name in ("height", "speed", "pull", "force"):
            self.episode[name][which] = 0.0
        self.batch.place_obstacle("load", np.zeros(3), which)

    def inputs(self, actions: Array) -> Array:
        """The upper tendon pulls up, the lower one down."""
        pull = np.clip(self.episode["pull"] + 0.2 * actions[:, 0], -1, 1)
        self.episode["pull"] = pull
        u = np.zeros((self.num_envs, self.batch.inputs))
        u[:, -2:] = TENSION * np.maximum(np.stack([-pull, pull], axis=1), 0)
        return u

    def moves(self, part: int) -> None:
        """The plate falls, or goes where it is pushed."""
        h, episode = self.batch.dt, self.episode
        episode["force"] = -self.batch.contact_force("load")[:, 2]
        speed = episode["speed"] + h * (episode["force"] / MASS - GRAVITY)
        height = np.maximum(episode["height"] + h * speed, 0.0)
        episode["speed"], episode["height"] = (height - episode["height"]) / h, height
        self.batch.place_obstacle("load", height[:, None] * [0.0, 0.0, 1.0])

    def observe(self) -> Array:
        """See the class."""
        e, finger = self.episode, self.batch.displacement("line")[:, 2:, 2] / UNIT
        speed = self.batch.velocity("line")[:, -1, 2] / SPEED
        others = [speed, e["force"] / (MASS * GRAVITY), e["height"] / UNIT, e["speed"] / SPEED, e["goal"] / UNIT]
        return np.column_stack([finger, *others, e["pull"]])

    def reward(self, actions: Array) -> tuple[Array, Array]:
        """See the class."""
        off = np.abs(self.episode["height"] - self.episode["goal"])
        return -off / UNIT + (off < 5e-4), np.zeros(self.num_envs, bool)

    def things(self, k: int):
        """The plate, and the underside that it is to have."""
        centre, size = np.array([0.09, 0.0, LOAD_HEIGHT]), np.array(LOAD_SIZE)
        rise = np.array([0.0, 0.0, 1.0])
        goal = centre + (self.episode["goal"][k] - size[2] / 2) * rise
        return [Block(goal, size * [1.0, 1.0, 0.05])], [Block(centre + self.episode["height"][k] * rise, size)]
