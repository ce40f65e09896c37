"""The four tasks of Elastica's benchmarks for learning with a soft arm, as far as an arm with tendons allows.

Naughton, Sun, Tekinalp, Parthasarathy, Chowdhary & Gazzola, "Elastica: a compliant mechanics environment for soft
robotic control", IEEE Robotics and Automation Letters 6 (2021). Actions change the pulls of pairs of tendons by at most
a fifth of the largest, as DisMech-RL changes curvatures (Choi & Tong, arXiv:2511.06667); there they are the control
points of a spline of torques. Only one tendon of a pair pulls at a time. Lengths are in m.
"""

import numpy as np
from picture import Ball, Rod
from soft_bodies import LENGTH, PEG_CIRCLE, PEG_RADIUS, PEGS, TENDONS, TENSION
from vector import SoftBodies

Array = np.ndarray
PAIRS = ((0, 1), (2, 3), (4, 5), (6, 7))  # tendons against each other: left and right, up and down; middle, then tip
RATE = 0.2  # of the largest pull, by which an action changes it at most


class Arm(SoftBodies):
    """Observation: eleven points of the arm, speed and direction of its tip, the four pulls, and what the task adds."""

    tension: float
    tendons, outputs = TENDONS, ("line", "tip")

    def __init__(self, rom, num_envs: int, *, further: int, dt: float, length: int, render_mode: str | None = None):
        super().__init__(
            rom, num_envs, observations=41 + further, actions=len(PAIRS), dt=dt, length=length, render_mode=render_mode
        )
        self.rest = np.linspace(0, LENGTH, 11)[1:, None] * [1.0, 0.0, 0.0]
        self.episode |= {"pull": np.zeros((num_envs, 4)), "target": np.zeros((num_envs, 3))}

    def inputs(self, actions: Array) -> Array:
        """The pulls that actions lead to, of those tendons of pairs that pull; 0 in an episode that begins."""
        pull = np.clip(self.episode["pull"] + RATE * actions, -1, 1)
        self.episode["pull"] = pull
        u = np.zeros((self.num_envs, self.batch.inputs))
        for k, (one, other) in enumerate(PAIRS):
            u[:, one - 8] = self.tension * np.maximum(pull[:, k], 0)
            u[:, other - 8] = self.tension * np.maximum(-pull[:, k], 0)
        return u

    def observe(self) -> Array:
        """See the class."""
        points = self.points
        speed, direction = length_and_direction(self.batch.velocity("tip")[:, 0])
        parts = [points.reshape(self.num_envs, -1), speed, direction, self.episode["pull"], *self.further()]
        return np.hstack(parts)

    @property
    def points(self) -> Array:
        """Of the arm, from its root to its tip, (num_envs, 11, 3)."""
        return np.concatenate([np.zeros((self.num_envs, 1, 3)), self.rest + self.batch.displacement("line")], axis=1)

    @property
    def distance(self) -> Array:
        """From the tip to the target, (num_envs,)."""
        return np.linalg.norm(self.points[:, -1] - self.episode["target"], axis=1)

    def further(self) -> list[Array]:
        """What the task adds to observations."""
        raise NotImplementedError

    def things(self, k: int):
        """The target."""
        return [Ball(self.episode["target"][k], 0.02)], []


class ArmFollow(Arm):
    """Elastica's first task: the tip is to follow a ball that moves at 0.5 m/s and turns at random every 0.7 s.

    It is reflected where it leaves REACH. Reward: -n² of the distance n, and 0.5 within 10 cm, 2 within 5 cm.
    """

    tension = TENSION["far"]
    REACH = np.array([[0.75, -0.35, -0.35], [0.97, 0.35, 0.35]])
    SPEED, TURNS = 0.5, 7  # m/s, and steps of 0.1 s

    def __init__(self, rom, num_envs: int, render_mode: str | None = None, length: int = 100):
        super().__init__(rom, num_envs, further=7, dt=1e-2, length=length, render_mode=render_mode)
        self.episode["heading"] = np.zeros((num_envs, 3))

    def begin(self, which: Array) -> None:
        """Draws where the ball is."""
        self.episode["target"][which] = self.draw(which, *self.REACH, 3)
        self.episode["pull"][which] = 0.0
        self._turn(which)

    def _turn(self, which: Array) -> None:
        heading = self.np_random.standard_normal((int(which.sum()), 3))
        self.episode["heading"][which] = self.SPEED * heading / np.linalg.norm(heading, axis=1)[:, None]

    def moves(self, part: int) -> None:
        """The ball goes on, before all else."""
        if part:
            return
        episode = self.episode
        turns = (episode["age"] % self.TURNS == 0) & (episode["age"] > 0)
        self._turn(turns)
        low, high = self.REACH
        ahead = episode["target"] + 0.1 * episode["heading"]
        episode["heading"] = np.where((ahead < low) | (ahead > high), -episode["heading"], episode["heading"])
        episode["target"] = episode["target"] + 0.1 * episode["heading"]

    def further(self) -> list[Array]:
        """Where the ball is, how fast it is, and where to."""
        return [self.episode["target"], *length_and_direction(self.episode["heading"])]

    def reward(self, actions: Array) -> tuple[Array, Array]:
        """As Elastica's."""
        n = self.distance
        return -(n**2) + 0.5 * ((n > 0.05) & (n < 0.1)) + 2.0 * (n <= 0.05), np.zeros(self.num_envs, bool)


class ArmReach(Arm):
    """Elastica's second task: the tip is to reach a place, and to point in a direction there.

    The arm does not twist itself, so that a direction stands for Elastica's quaternion. Places and directions are of
    the arm under random pulls, so that it can get there. Reward: -n² - (1 - d·t)/2 of the distance n and of the
    directions of tip and target, and 0.5 within 10 cm, 2 within 5 cm, where it points there to 20 degrees.
    """

    tension = TENSION["far"]

    def __init__(self, rom, num_envs: int, render_mode: str | None = None, length: int = 50):
        super().__init__(rom, num_envs, further=9, dt=1e-2, length=length, render_mode=render_mode)
        self.episode["towards"] = np.zeros((num_envs, 3))

    def begin(self, which: Array) -> None:
        """Draws the target: a bend of both halves, each of a constant curvature."""
        κ, φ = self.draw(which, -0.8, 0.8, 2).T[:, :, None], self.draw(which, -np.pi, np.pi, 1)
        across = np.hstack([np.zeros_like(φ), np.cos(φ), np.sin(φ)])
        half = LENGTH / 2
        angles = κ[0] * half / 2, κ[0] * half + κ[1] * half / 2, (κ[0] + κ[1]) * half
        along = np.array([1.0, 0.0, 0.0])
        place = half * sum(np.cos(angle) * along + np.sin(angle) * across for angle in angles[:2])
        self.episode["target"][which] = place
        self.episode["towards"][which] = np.cos(angles[2]) * along + np.sin(angles[2]) * across
        self.episode["pull"][which] = 0.0

    def further(self) -> list[Array]:
        """Where the tip points, and where it is to be and to point."""
        return [self.pointing, self.episode["target"], self.episode["towards"]]

    def things(self, k: int):
        """The target, and the direction to point in."""
        target, towards = self.episode["target"][k], self.episode["towards"][k]
        return [*super().things(k)[0], Rod(target, target + 0.15 * towards, 0.006)], []

    @property
    def pointing(self) -> Array:
        """Direction of the tip, (num_envs, 3)."""
        tip, before = self.batch.displacement("tip").transpose(1, 0, 2)
        return length_and_direction(tip - before + [0.05, 0.0, 0.0])[1]

    def reward(self, actions: Array) -> tuple[Array, Array]:
        """See the class."""
        n, aligned = self.distance, (self.pointing * self.episode["towards"]).sum(axis=1)
        points_there = aligned > np.cos(np.radians(20))
        bonus = 0.5 * ((n > 0.05) & (n < 0.1)) + 2.0 * (n <= 0.05)
        return -(n**2) - (1 - aligned) / 2 + bonus * points_there, np.zeros(self.num_envs, bool)


class ArmPegs(Arm):
    """Elastica's third task: the tip is to get to a place between obstacles, here four pegs along the end of the arm.

    A batch has no contact with large deformation, so that this arm is linear, and all is a tenth of Elastica's size:
    the place is 9 cm aside, between two pegs, and the arm has to bend past them. Lengths of the reward are in 0.1 m:
    -n², and 0.5 within 2 cm, 2 within 1 cm.
    """

    tension, obstacles = TENSION["pegs"], tuple(PEGS)
    ASIDE, SHIFT = 0.09, 0.0  # m; how far pegs are from where the scene has them, at most

    def __init__(self, rom, num_envs: int, render_mode: str | None = None, length: int = 30):
        super().__init__(rom, num_envs, further=3 + 2 * len(PEGS), dt=5e-3, length=length, render_mode=render_mode)
        self.episode["pegs"] = np.zeros((num_envs, len(PEGS), 2))

    def begin(self, which: Array) -> None:
        """Draws which two pegs the place is between, and where the pegs are."""
        count = int(which.sum())
        angle = np.pi / 2 * self.np_random.integers(0, 4, count)
        self.episode["target"][which] = LENGTH * np.array([1.0, 0.0, 0.0]) + self.ASIDE * np.stack(
            [0 * angle, np.cos(angle), np.sin(angle)], axis=1
        )
        shift = self.draw(which, 0.0, 1.0, 2 * len(PEGS)).reshape(count, -1, 2)
        self.episode["pull"][which] = 0.0
        for k, (name, at_rest) in enumerate(PEGS.items()):
            outwards = np.array(at_rest) / PEG_CIRCLE
            sideways = np.array([-outwards[1], outwards[0]])
            moved = self.SHIFT * (shift[:, k, :1] * outwards + (2 * shift[:, k, 1:] - 1) / 2 * sideways)
            self.episode["pegs"][which, k] = at_rest + moved
            self.batch.place_obstacle(name, np.hstack([np.zeros((count, 1)), moved]), which)

    def further(self) -> list[Array]:
        """Where the place and the pegs are."""
        return [self.episode["target"], self.episode["pegs"].reshape(self.num_envs, -1)]

    def reward(self, actions: Array) -> tuple[Array, Array]:
        """See the class."""
        n = self.distance / 0.1
        return -(n**2) + 0.5 * ((n > 0.1) & (n < 0.2)) + 2.0 * (n <= 0.1), np.zeros(self.num_envs, bool)

    def things(self, k: int):
        """The target, and the pegs."""
        pegs = [Rod(np.array([0.85, *peg]), np.array([1.1, *peg]), PEG_RADIUS) for peg in self.episode["pegs"][k]]
        return super().things(k)[0], pegs


class ArmNest(ArmPegs):
    """Elastica's fourth task: the same with the pegs elsewhere in every episode."""

    SHIFT = 0.05


def length_and_direction(vectors: Array) -> tuple[Array, Array]:
    """(n, 1) and (n, 3) of (n, 3); nothing has no direction."""
    length = np.linalg.norm(vectors, axis=1)[:, None]
    return length, vectors / np.where(length > 0, length, 1.0)
