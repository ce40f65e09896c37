"""A thousand soft plates to learn on: a vector environment of Gymnasium, and what it costs.

    python demos/learning/learning.py
    python demos/learning/learning.py --quick    # fewer plates, to see that it works

Each environment is the plate of demos/plate, reduced to order 20: within a second, its tip is to be brought to a random
height by pushing up or down with at most 0.5 N, at a corner of the tip in some environments, in the middle in others.
All of them are stepped together by one Batch, each in the contact mode that it drew (environment.py). The script

1. measures how many steps a second that makes, of the environments and of the physics in them;
2. lets three policies play: one pushes at random, one not at all, and a hand-made one with what holds the target in the
   end, corrected by distance and speed. It clearly does best, so there is something to learn; and in the middle, from
   where the tip is hard to hold, there is something left to learn;
3. draws what they do.

Nothing is trained here: any learner that takes vector environments can do that, with environment.py and the reduced
model alone, where there is no FEniCSx. Everything is written to demos/learning/out/, the reduced model, too; with
--quick to out/quick/. The checks at the end fail if a claim does not hold; no check is on time.
"""

import argparse
import statistics
import sys
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from environment import FORCE, LENGTH, REACH, SKIP, STEP, PlateReach

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning
from fenics_rom.io.markdown import markdown

HERE = Path(__file__).parent
OUT = HERE / "out"

Policy = Callable[[np.ndarray], np.ndarray]

ORDER = 20
SIZES = (1, 16, 256, 1024, 4096)
PLAYERS = 1024  # environments in which the policies play
QUICK_SIZES = (1, 64)
QUICK_PLAYERS = 64
RUNS = 5  # of each size; the table has the median
SEED = 1

# By place: the push that holds a plate at height 1, and what is added for distance and for speed. In the middle that
# is little: the tip answers such a push the wrong way first, and more would excite the second bending mode.
GAINS = np.array([[0.26, 1.0, 1.0], [0.72, 0.4, 0.5]])
SETTLING = LENGTH // 2  # the second half of an episode is for holding


@dataclass(frozen=True)
class Play:
    """An episode of every environment.

    Attributes:
        observations: (LENGTH + 1, n, 4).
        returns: (n,), sums of rewards.
        lengths: (n,), numbers of actions after which the episodes ended; 0 where one did not.
        energy: (n,), stored at the end, J.
        in_space: whether all observations were finite and in the observation space.
    """

    observations: np.ndarray
    returns: np.ndarray
    lengths: np.ndarray
    energy: np.ndarray
    in_space: bool

    @property
    def place(self) -> np.ndarray:
        """Where each plate is pushed, (n,)."""
        return self.observations[0, :, 3].astype(int)

    @property
    def distance(self) -> np.ndarray:
        """Mean distance from the target in the second half of the episode, (n,), mm."""
        height, _, target, _ = np.moveaxis(self.observations[SETTLING:], 2, 0)
        return 1e3 * REACH * np.abs(height - target).mean(axis=0)


def main() -> None:
    """Runs the demo."""
    parser = argparse.ArgumentParser(description="Steps many soft plates as a vector environment of Gymnasium.")
    parser.add_argument("--quick", action="store_true", help="fewer plates")
    quick = parser.parse_args().quick
    out = OUT / "quick" if quick else OUT
    out.mkdir(parents=True, exist_ok=True)

    warnings.simplefilter("ignore", FenicsRomWarning)  # `fenics-rom info` lists them
    rom = fr.reduce(fr.assemble(fr.read_scene(HERE.parent / "plate" / "plate.toml")), order=ORDER)
    fr.write_rom(out / "plate.h5", rom)

    cost(rom, QUICK_SIZES if quick else SIZES, out)
    env = PlateReach(rom, QUICK_PLAYERS if quick else PLAYERS)
    env.action_space.seed(SEED)
    plays = {
        "random": play(env, lambda observation: env.action_space.sample()),
        "idle": play(env, lambda observation: np.zeros((env.num_envs, 1))),
        "hand-made": play(env, hand_made),
    }
    compare(plays, list(rom.contact_models), out)
    picture(plays, list(rom.contact_models), out)
    check(plays)


def hand_made(observation: np.ndarray) -> np.ndarray:
    """Pushes (n, 1) with what holds the target in the end, and corrects by distance and speed."""
    height, speed, target, place = observation.T
    hold, proportional, derivative = GAINS[place.astype(int)].T
    push = hold * target + proportional * (target - height) - derivative * speed
    return np.clip(push, -1, 1)[:, None]


def play(env: PlateReach, policy: Policy) -> Play:
    """One episode in every environment."""
    observation, _ = env.reset(seed=SEED)
    observations, returns, lengths = [observation], np.zeros(env.num_envs), np.zeros(env.num_envs, int)
    for action in range(1, LENGTH + 1):
        observation, reward, terminated, truncated, _ = env.step(policy(observation))
        observations.append(observation)
        returns += reward
        lengths[(lengths == 0) & (terminated | truncated)] = action
    in_space = all(np.isfinite(o).all() and o in env.observation_space for o in observations)
    return Play(np.array(observations), returns, lengths, env.batch.energy, in_space)


def cost(rom: fr.Rom, sizes: tuple[int, ...], out: Path) -> None:
    """Tables steps per second of environments under random actions."""
    rows = []
    for size in sizes:
        env = PlateReach(rom, size)
        seconds, physics = zip(*(two_episodes(env) for _ in range(RUNS)), strict=True)
        whole = statistics.median(seconds)
        rows.append(
            (
                f"{size:,}",
                f"{2 * LENGTH * size / whole:,.0f}",
                f"{2 * (LENGTH + 1) * SKIP * size / whole:,.0f}",
                f"{statistics.median(physics) / whole:.0%}",
            )
        )
    heading = ("environments", "their steps per second", "steps of a plate per second", "time in Batch.step")
    table = markdown(heading, rows)
    (out / "cost.md").write_text(table)
    print(f"Steps under random actions, {SKIP} of the physics in one of an environment; float32, one thread\n")
    print(table)


def two_episodes(env: PlateReach) -> tuple[float, float]:
    """Seconds of two episodes, choosing the actions not included, and how many of them Batch.step took."""
    env.reset(seed=SEED)
    step, physics = env.batch.step, 0.0

    def timed(u: np.ndarray) -> np.ndarray:
        nonlocal physics
        start = time.perf_counter()
        held = step(u)
        physics += time.perf_counter() - start
        return held

    env.batch.step = timed  # type: ignore[method-assign]
    actions = [env.action_space.sample() for _ in range(2 * (LENGTH + 1))]  # two of them only begin an episode
    start = time.perf_counter()
    for action in actions:
        env.step(action)
    seconds = time.perf_counter() - start
    del env.batch.step
    return seconds, physics


def compare(plays: dict[str, Play], contacts: list[str], out: Path) -> None:
    """Tables what the policies reach."""
    rows = []
    for name, p in plays.items():
        for place, contact in enumerate(contacts):
            here = p.place == place
            rows.append((name, contact, here.sum(), f"{p.returns[here].mean():.1f}", f"{p.distance[here].mean():.2f}"))
        rows.append((name, "both", len(here), f"{p.returns.mean():.1f}", f"{p.distance.mean():.2f}"))
    heading = ("policy", "pushes at", "environments", "mean return", "distance in the second half (mm)")
    table = markdown(heading, rows)
    (out / "policies.md").write_text(table)
    print(f"What a policy reaches in an episode of {LENGTH * SKIP * STEP:g} s; targets are within {REACH * 1e3:g} mm\n")
    print(table)


def picture(plays: dict[str, Play], contacts: list[str], out: Path) -> None:
    """Tip heights of a few environments against their targets, and the returns of all."""
    figure = plt.figure(figsize=(11, 5.5), layout="constrained")
    grid = figure.subplot_mosaic([["00", "01", "returns"], ["10", "11", "returns"]], width_ratios=(1, 1, 0.9))
    times = np.arange(LENGTH + 1) * SKIP * STEP
    for row, name in enumerate(("random", "hand-made")):
        p = plays[name]
        for column, contact in enumerate(contacts):
            axes = grid[f"{row}{column}"]
            for k, colour in zip(spread(p, column), ("tab:blue", "tab:green", "tab:red"), strict=True):
                height, _, target, _ = 1e3 * REACH * p.observations[:, k].T
                axes.plot(times, height, color=colour)
                axes.plot(times, target, color=colour, linestyle=":", linewidth=1.2)
            axes.set(xlim=(0, times[-1]), ylim=(-15, 15))
            axes.set_title(f"{name}, pushed at {contact}", fontsize=10, loc="left")
            if column == 0:
                axes.set_ylabel("height of the tip (mm)")
            if row == 1:
                axes.set_xlabel("time (s)")
    axes = grid["returns"]
    least = min(p.returns.min() for p in plays.values())
    for (name, p), colour in zip(plays.items(), ("tab:gray", "tab:cyan", "tab:orange"), strict=True):
        label = f"{name}: {p.returns.mean():.1f} on average"
        axes.hist(p.returns, bins=np.linspace(least, 0, 41), color=colour, histtype="step", linewidth=2, label=label)
    axes.set(xlabel="return of the episode", ylabel="environments", xlim=(least, 0))
    axes.set_title(f"{len(p.returns)} environments", fontsize=10, loc="left")
    axes.legend(loc="upper left", fontsize=9)
    figure.suptitle(f"Three plates each (lines) and their targets (dots); pushes of at most {FORCE:g} N", fontsize=11)
    figure.savefig(out / "learning.png", dpi=110)
    plt.close(figure)


def spread(p: Play, place: int) -> list[int]:
    """Three environments pushed there, with targets from low to high."""
    here = np.flatnonzero(p.place == place)
    ranked = here[p.observations[0, here, 2].argsort()]
    return [int(ranked[len(ranked) * share // 8]) for share in (1, 3, 7)]


def check(plays: dict[str, Play]) -> None:
    """The claims of this page, measured."""
    everything, made = list(plays.values()), plays["hand-made"]
    better = (made.returns > plays["random"].returns).mean()
    claims = {
        "every observation is finite and in the space": all(p.in_space for p in everything),
        "every episode ends after a second": all((p.lengths == LENGTH).all() for p in everything),
        "every energy is finite": all(np.isfinite(p.energy).all() for p in everything),
        "all policies had the same targets and places": len({p.observations[0].tobytes() for p in everything}) == 1,
        f"the hand-made policy does better than chance in {better:.1%} of the environments": better >= 0.95,
        "on average, it loses less than half of what others lose": made.returns.mean()
        > max(plays[other].returns.mean() for other in ("random", "idle")) / 2,
    }
    for claim, holds in claims.items():
        print(f"  {'holds' if holds else 'FAILS'}: {claim}")
    if not all(claims.values()):
        sys.exit(1)


if __name__ == "__main__":
    main()
