"""How many steps of 0.1 s the soft tasks make a second under random actions, in one process and in two.

    .venv/bin/python demos/learning/soft_rates.py

A vector environment of its own runs in each process, as threads gain little: most of a step is in small NumPy calls.
"""

import argparse
import multiprocessing
import time
import warnings

import gymnasium
import soft_bodies
import soft_tasks

from fenics_rom.errors import FenicsRomWarning
from fenics_rom.io.markdown import markdown

ENVIRONMENTS, WARM_UP, STEPS = 512, 5, 30
TASKS = "ArmFollow", "ArmReach", "ArmPegs", "ArmNest", "FingerLift"


def main() -> None:
    """Measures and tables."""
    argparse.ArgumentParser(description="Measures the soft tasks under random actions; takes two minutes.").parse_args()
    warnings.simplefilter("ignore", FenicsRomWarning)
    soft_tasks.OUT.mkdir(exist_ok=True)
    rows = []
    for task in TASKS:
        soft_bodies.make(soft_tasks.TASKS[task][0], soft_tasks.OUT)
        rows.append((task, *(f"{rate(task, processes):,.0f}" for processes in (1, 2))))
    table = markdown(("task", "steps a second, one process", "two"), rows)
    (soft_tasks.OUT / "soft_rates.md").write_text(table)
    print(table)


def rate(task: str, processes: int) -> float:
    """Steps a second of all processes together."""
    with multiprocessing.Pool(processes) as pool:
        return sum(pool.map(run, [task] * processes, chunksize=1))


def run(task: str) -> float:
    """Steps a second of one."""
    env = gymnasium.make_vec(f"fenics_rom/{task}-v0", num_envs=ENVIRONMENTS)
    env.reset(seed=1)
    env.action_space.seed(1)
    actions = [env.action_space.sample() for _ in range(WARM_UP + STEPS)]
    for action in actions[:WARM_UP]:
        env.step(action)
    start = time.perf_counter()
    for action in actions[WARM_UP:]:
        env.step(action)
    return ENVIRONMENTS * STEPS / (time.perf_counter() - start)


if __name__ == "__main__":
    main()
