"""Trains a policy for one of the soft tasks by proximal policy optimisation, on the processor.

    .venv/bin/pip install -r demos/learning/requirements-training.txt
    .venv/bin/python demos/learning/train.py                              # follows a ball, and gets past pegs
    .venv/bin/python demos/learning/train.py ArmReach --steps 500000

Schulman et al., "Proximal policy optimization algorithms" (arXiv:1707.06347), with a network each for policy and value,
generalised advantages, and observations and returns scaled by what was seen of them. It needs PyTorch, and the bodies
of soft_bodies.py, which it makes where they are not there. Curves and their table go to demos/learning/out/.
"""

import argparse
import sys
import time
import warnings
from dataclasses import dataclass, field
from pathlib import Path

import gymnasium
import matplotlib as mpl
import numpy as np
import soft_bodies
import soft_tasks

from fenics_rom.errors import FenicsRomWarning
from fenics_rom.io.markdown import markdown

try:
    import torch
    from torch import nn
except ModuleNotFoundError as error:
    why = f"training needs {error.name}, which this Python lacks"
    sys.exit(f"error: {why}: .venv/bin/pip install -r demos/learning/requirements-training.txt")

mpl.use("Agg")

import matplotlib.pyplot as plt

TRAINED = {"ArmFollow": 400_000, "ArmPegs": 300_000}  # steps of the environment, without arguments
ENVIRONMENTS, ROLLOUT = 256, 25
EPOCHS, MINIBATCHES = 6, 8
DISCOUNT, TRACE, CLIP, RATE = 0.97, 0.95, 0.2, 1e-3
WIDTH, LARGEST_GRADIENT = 64, 0.5
SEED = 1


class Scale:
    """Mean and variance of what was seen, to scale by."""

    def __init__(self, width: int):
        self.mean, self.variance, self.count = np.zeros(width), np.ones(width), 1e-4

    def see(self, given: np.ndarray) -> None:
        """Adds rows (n, width)."""
        n, mean, variance = len(given), given.mean(axis=0), given.var(axis=0)
        whole, off = self.count + n, mean - self.mean
        spread = self.variance * self.count + variance * n + off**2 * self.count * n / whole
        self.mean, self.variance, self.count = self.mean + off * n / whole, spread / whole, whole

    def __call__(self, given: np.ndarray) -> torch.Tensor:
        """Scaled rows, cut at ten."""
        scaled = (given - self.mean) / np.sqrt(self.variance + 1e-8)
        return torch.as_tensor(np.clip(scaled, -10, 10), dtype=torch.float32)


class Policy(nn.Module):
    """Normally distributed actions, and the value of what was observed."""

    def __init__(self, observations: int, actions: int):
        super().__init__()
        self.mean = network(observations, actions, 0.01)
        self.value = network(observations, 1, 1.0)
        self.spread = nn.Parameter(-0.5 * torch.ones(actions))

    def actions(self, observations: torch.Tensor) -> torch.distributions.Normal:
        """The distribution of actions."""
        return torch.distributions.Normal(self.mean(observations), self.spread.exp())


def network(inputs: int, outputs: int, last: float) -> nn.Sequential:
    """Two hidden layers, with orthogonal weights to begin with."""
    layers = [nn.Linear(inputs, WIDTH), nn.Linear(WIDTH, WIDTH), nn.Linear(WIDTH, outputs)]
    for layer, gain in zip(layers, (2**0.5, 2**0.5, last), strict=True):
        nn.init.orthogonal_(layer.weight, gain)
        nn.init.zeros_(layer.bias)
    return nn.Sequential(layers[0], nn.Tanh(), layers[1], nn.Tanh(), layers[2])


@dataclass
class Run:
    """What a training has seen."""

    task: str
    count: int = 0  # of steps of the environment
    steps: list[int] = field(default_factory=list)  # how many there were when episodes ended
    returns: list[float] = field(default_factory=list)  # of these, their mean
    seconds: list[float] = field(default_factory=list)  # of environment, and of all else
    untrained: float = 0.0
    trained: float = 0.0


def main() -> None:
    """Trains, tables and draws."""
    parser = argparse.ArgumentParser(description="Trains policies for soft tasks.")
    parser.add_argument("tasks", nargs="*", help=f"of {', '.join(soft_tasks.TASKS)}; none: ArmFollow and ArmPegs")
    parser.add_argument("--steps", type=int, help="of the environment, rounded up to whole updates of the policy")
    given = parser.parse_args()
    if unknown := [task for task in given.tasks if task not in soft_tasks.TASKS]:
        parser.error(f"no task {', '.join(unknown)}; there is {', '.join(soft_tasks.TASKS)}")
    if given.steps is not None and given.steps < 1:
        parser.error(f"--steps {given.steps}: use whole numbers > 0")
    torch.set_num_threads(1)
    warnings.simplefilter("ignore", FenicsRomWarning)
    soft_tasks.OUT.mkdir(exist_ok=True)
    runs = [train(task, given.steps or TRAINED.get(task, 300_000)) for task in given.tasks or TRAINED]
    heading = ("task", "steps", "return before", "after", "steps a second", "of the environment alone")
    rows = []
    for run in runs:
        inside, outside = run.seconds
        rates = f"{run.count / (inside + outside):,.0f}", f"{run.count / inside:,.0f}"
        rows.append((run.task, f"{run.count:,}", f"{run.untrained:.1f}", f"{run.trained:.1f}", *rates))
    table = markdown(heading, rows)
    (soft_tasks.OUT / "training.md").write_text(table)
    print(table)
    draw(runs, soft_tasks.OUT / "training.png")


def train(task: str, steps: int) -> Run:
    """One task, for so many steps of the environment; processor time is measured."""
    torch.manual_seed(SEED)
    body, _ = soft_tasks.TASKS[task]
    env = gymnasium.make_vec(
        f"fenics_rom/{task}-v0", num_envs=ENVIRONMENTS, rom=str(soft_bodies.make(body, soft_tasks.OUT))
    )
    policy = Policy(env.single_observation_space.shape[0], env.single_action_space.shape[0])
    adam = torch.optim.Adam(policy.parameters(), lr=RATE, eps=1e-5)
    seen, gains = Scale(env.single_observation_space.shape[0]), Scale(1)
    run, inside, started = Run(task), 0.0, time.process_time()
    observation, _ = env.reset(seed=SEED)
    over, returns, gain, finished = np.zeros(ENVIRONMENTS, bool), *np.zeros((2, ENVIRONMENTS)), list[float]()
    updates = -(-steps // (ENVIRONMENTS * ROLLOUT))
    total = updates * ENVIRONMENTS * ROLLOUT
    for update in range(updates):
        adam.param_groups[0]["lr"] = RATE * (1 - update / updates)
        kept = []
        for _ in range(ROLLOUT):
            seen.see(observation)
            x = seen(observation)
            with torch.no_grad():
                chosen = policy.actions(x)
                action = chosen.sample()
                known = action, chosen.log_prob(action).sum(1), policy.value(x)[:, 0]
            begun = time.process_time()
            observation, reward, terminated, truncated, _ = env.step(action.numpy())
            inside += time.process_time() - begun
            gain = DISCOUNT * gain * ~over + reward
            gains.see(gain[:, None])
            returns += reward
            ended = terminated | truncated
            finished += returns[ended].tolist()
            returns[ended] = 0
            scaled = torch.as_tensor(reward / np.sqrt(gains.variance[0] + 1e-8), dtype=torch.float32)
            kept.append((x, *known, scaled, torch.as_tensor(~over), torch.as_tensor(~ended)))
            over = ended
        with torch.no_grad():
            last = policy.value(seen(observation))[:, 0]
        improve(policy, adam, [torch.stack(part) for part in zip(*kept, strict=True)], last)
        run.count += ENVIRONMENTS * ROLLOUT
        if finished:
            run.steps.append(run.count)
            run.returns.append(float(np.mean(finished)))
            print(f"{task}: {run.count:,} of {total:,} steps, return {run.returns[-1]:.1f}", file=sys.stderr)
            finished.clear()
    run.seconds = [inside, time.process_time() - started - inside]
    run.untrained, run.trained = (play(env, chooser) for chooser in (None, lambda o: policy.mean(seen(o))))
    return run


def improve(policy: Policy, adam: torch.optim.Optimizer, kept: list[torch.Tensor], last: torch.Tensor) -> None:
    """A few epochs on what a rollout has seen; steps that only begin an episode do not count."""
    x, action, logarithm, value, reward, counts, goes_on = kept
    advantage, following = torch.zeros_like(reward), torch.zeros_like(last)
    for t in reversed(range(ROLLOUT)):
        after = last if t == ROLLOUT - 1 else value[t + 1]
        off = reward[t] + DISCOUNT * after * goes_on[t] - value[t]
        following = off + DISCOUNT * TRACE * goes_on[t] * following
        advantage[t] = following
    aim, flat = advantage + value, counts.reshape(-1).nonzero()[:, 0]
    x, action, logarithm, advantage, aim = (
        part.reshape(-1, *part.shape[2:])[flat] for part in (x, action, logarithm, advantage, aim)
    )
    for _ in range(EPOCHS):
        for some in torch.randperm(len(flat)).chunk(MINIBATCHES):
            chosen = policy.actions(x[some])
            ratio = (chosen.log_prob(action[some]).sum(1) - logarithm[some]).exp()
            gain = (advantage[some] - advantage[some].mean()) / (advantage[some].std() + 1e-8)
            loss = -torch.minimum(ratio * gain, ratio.clamp(1 - CLIP, 1 + CLIP) * gain).mean()
            loss = loss + 0.5 * (policy.value(x[some])[:, 0] - aim[some]).square().mean()
            adam.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(policy.parameters(), LARGEST_GRADIENT)
            adam.step()


def play(env: gymnasium.vector.VectorEnv, chooser) -> float:
    """Mean return of an episode in every environment, of new seeds; without a chooser under random actions."""
    observation, _ = env.reset(seed=SEED + 1)
    env.action_space.seed(SEED)
    total, runs = np.zeros(env.num_envs), np.ones(env.num_envs, bool)
    while runs.any():
        with torch.no_grad():
            action = env.action_space.sample() if chooser is None else chooser(observation).numpy()
        observation, reward, terminated, truncated, _ = env.step(action)
        total += reward * runs
        runs &= ~(terminated | truncated)
    return float(total.mean())


def draw(runs: list[Run], file: Path) -> None:
    """Mean returns of the episodes that ended, against steps of the environment."""
    figure, axes = plt.subplots(1, len(runs), figsize=(5.5 * len(runs), 3.6), layout="constrained", squeeze=False)
    for one, run in zip(axes[0], runs, strict=True):
        one.plot(np.array(run.steps) / 1e3, run.returns, color="tab:blue", label="while it learns")
        one.axhline(run.untrained, color="tab:gray", linestyle=":", label="random actions")
        one.axhline(run.trained, color="tab:orange", linestyle="--", label="what was learned, new targets")
        one.set(xlabel="steps of the environment, in thousands", ylabel="mean return of an episode")
        one.set_title(run.task, fontsize=10, loc="left")
        one.legend(fontsize=8)
    figure.savefig(file, dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    main()
