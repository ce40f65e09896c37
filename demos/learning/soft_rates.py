"""How many steps of 0.1 s the soft tasks make a second under random actions, in NumPy and compiled.

    .venv/bin/python demos/learning/soft_rates.py               # 3 min
    .venv/bin/python demos/learning/soft_rates.py FingerLift    # of some tasks

Seconds are of processor time, so that other programs hardly matter. Compiled batches run on all cores: they take as
many seconds for a step, of all cores together.
"""

import argparse
import time
import warnings

import gymnasium
import soft_bodies
import soft_tasks

import fenics_rom as fr
from fenics_rom.compilation import numpy_alone
from fenics_rom.errors import FenicsRomWarning
from fenics_rom.io.markdown import markdown

ENVIRONMENTS, WARM_UP, STEPS, ROUNDS = 1024, 5, 10, 3
TASKS = "ArmFollow", "ArmReach", "ArmPegs", "ArmNest", "FingerLift"
HEADING = ("task", "steps a second, NumPy", "compiled", "ratio", "compiled batches")


def main() -> None:
    """Measures and tables."""
    parser = argparse.ArgumentParser(description="Measures the soft tasks under random actions.")
    parser.add_argument("tasks", nargs="*", default=TASKS, help=f"of {', '.join(TASKS)}; default: all")
    warnings.simplefilter("ignore", FenicsRomWarning)
    soft_tasks.OUT.mkdir(exist_ok=True)
    rows = []
    for task in parser.parse_args().tasks:
        soft_bodies.make(soft_tasks.TASKS[task][0], soft_tasks.OUT)
        with numpy_alone():
            envs = [begun(task)]
        envs.append(begun(task))
        numpy, compiled = rates(envs)
        is_compiled = "yes" if fr.compiled() and envs[1].unwrapped.batch.stepping == "compiled" else "no"
        rows.append((task, f"{numpy:,.0f}", f"{compiled:,.0f}", f"{compiled / numpy:.1f}", is_compiled))
        print(rows[-1])
    table = markdown(HEADING, rows)
    (soft_tasks.OUT / "soft_rates.md").write_text(table)
    print(table)


def begun(task: str) -> gymnasium.vector.VectorEnv:
    """Environments after some steps, in which what is to be compiled is."""
    env = gymnasium.make_vec(f"fenics_rom/{task}-v0", num_envs=ENVIRONMENTS)
    env.reset(seed=1)
    env.action_space.seed(1)
    for _ in range(WARM_UP):
        env.step(env.action_space.sample())
    return env


def rates(envs: list[gymnasium.vector.VectorEnv]) -> list[float]:
    """Steps a second of each, in turns: the best of some rounds."""
    best = [0.0] * len(envs)
    for _ in range(ROUNDS):
        for k, env in enumerate(envs):
            actions = [env.action_space.sample() for _ in range(STEPS)]
            start = time.process_time()
            for action in actions:
                env.step(action)
            best[k] = max(best[k], ENVIRONMENTS * STEPS / (time.process_time() - start))
    return best


if __name__ == "__main__":
    main()
