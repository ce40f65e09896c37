"""A controller stops a soft finger that swings, a plan moves its tip; and what a step costs in C.

    python demos/control/control.py             # a minute
    python demos/control/control.py --quick     # short loops; rates are not judged

A finger between two tendons is flicked from below and swings for most of a second. The script

1. makes the state space of a model of four displacements, and from it, by SciPy's Riccati solver, a state feedback
   that is to be ten times as fast as the swinging fades by itself, and an observer that sees nothing but how high the
   tip is, a thousand times a second;
2. lets both hold the tendons of the full order, 2,841 unknowns, and of the reduced model of order 40;
3. plans tensions that lead the tip up and back, by the exact gradient of a model of order 20, and lets the full order
   take them;
4. plans them anew a hundred times a second, a second ahead, and flicks the finger meanwhile;
5. exports models of order 20 and 40 to C, compiles them and steps them, beside Python and beside the one matrix product
   that a step in NumPy cannot do without.

Everything is written to demos/control/out/. The checks at the end fail if a claim does not hold.
"""

import argparse
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from following import LIFT, Body, Following, Plan, follow, gradient_cost, plan_tensions
from replanning import FLICKED as FLICKED_LATER
from replanning import REPLANNED, Replanning, follow_replanned
from scipy.linalg import solve_discrete_are
from stepping_in_c import PROCESSOR, compare_rates

import fenics_rom as fr
from fenics_rom.fem.simulator import FullOrderSimulator
from fenics_rom.io.markdown import markdown
from fenics_rom.visualization.figure import figure_class

HERE = Path(__file__).parent
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
ORDER = 4  # of the model that the controller knows
TIMES_FASTER = 10.0
PRESCRIBED = 8.0  # times the decay of the first bending, at which every controlled motion fades at least
NOISE = 1e-8  # m², of the tip's height: 0.1 mm
FLICK, FLICKED = 0.1, 0.1  # N, s
DURATION = 1.3  # s
SETTLED = 0.02  # of the largest deflection after the flick
AGREES_TO = {"C, double": 1e-12, "C, float": 1e-5}

Array = np.ndarray


class Controller(NamedTuple):
    """u = -K z and z⁺ = A z + B u + L (y - C z), z the observer's state."""

    A: Array
    B: Array
    C: Array
    K: Array
    L: Array


class Run(NamedTuple):
    """What was seen of a body."""

    height: Array  # of the tip, m
    tensions: Array  # (steps, 2), beyond those that hold the finger in the middle, N

    def settling_time(self, h: float) -> float:
        """When the tip is within SETTLED of its largest deflection for good, s after the flick."""
        after = np.abs(self.height[round(FLICKED / h) :])
        return h * float(np.flatnonzero(after > SETTLED * after.max())[-1] + 1)


def main() -> None:
    """Runs the demo; exits with 1 where a claim fails."""
    parser = argparse.ArgumentParser(description="A controller stops a soft finger that swings.")
    parser.add_argument("--quick", action="store_true", help="short loops; rates are not judged")
    quick = parser.parse_args().quick
    if not ONE_THREAD.items() <= os.environ.items():  # read when NumPy is loaded, so it takes another start
        os.execve(sys.executable, [sys.executable, *sys.argv], os.environ | ONE_THREAD)
    out = HERE / "out" / "quick" if quick else HERE / "out"
    out.mkdir(parents=True, exist_ok=True)

    scene = fr.read_scene(HERE / "control.toml")
    assert scene.run is not None
    h, system = scene.run.dt, fr.assemble(scene)
    roms = {order: fr.reduce(system, order=order) for order in (20, 40)}
    decay = float(roms[40].contact_models["side"].damping[0]) / 2  # 1/s, of the first bending
    controller = design(fr.truncate(roms[40], ORDER), PRESCRIBED * decay, h)
    bending = bending_pole(controller, roms[40], h)

    def bodies() -> dict[str, Body]:
        return {"full order": FullOrderSimulator(system, h, scene.environment), "order 40": fr.Simulator(roms[40], h)}

    free = {name: run(body, h, None) for name, body in bodies().items()}
    held = {name: run(body, h, controller) for name, body in bodies().items()}
    judge = "full order"
    times = {name: (free[name].settling_time(h), held[name].settling_time(h)) for name in free}
    heading = ("plant", "settles by itself (s)", "controlled (s)", "times faster", "tension at most (N)")
    rows = [
        (name, f"{alone:.3f}", f"{with_it:.3f}", f"{alone / with_it:.1f}", f"{np.abs(held[name].tensions).max():.2f}")
        for name, (alone, with_it) in times.items()
    ]
    print(f"First bending: {-decay:.2f} 1/s by itself, {bending:.2f} 1/s controlled\n")
    print(markdown(heading, rows))
    plan = plan_tensions(roms[20], h)
    plants: dict[str, Callable[[], Body]] = {
        "full order": lambda: FullOrderSimulator(system, h, scene.environment),
        "order 20": lambda: fr.Simulator(roms[20], h),
    }
    following = follow(plan, plants)
    print(f"Tensions planned in {plan.iterations} iterations\n\n{following.table}")
    cost = gradient_cost(roms[20], h, quick)
    told = (
        f"The gradient of {cost.steps:,} steps takes {cost.times:.1f} times as long as the steps alone, "
        f"{cost.times_read:.1f} times as long as with the tip read after each; of a million {cost.memory / 1e6:.0f} MB"
    )
    print(f"{told}\n")
    replanning = follow_replanned(roms[20], h, plants)
    print(f"{replanning.rate}, {PROCESSOR}, one thread\n\n{replanning.table}")
    rates = compare_rates(roms, out, quick)
    print(f"{PROCESSOR}, one thread\n\n{rates.table}")
    tables = (
        markdown(heading, rows),
        following.table,
        told,
        f"{replanning.rate}\n",
        replanning.table,
        f"{PROCESSOR}, one thread\n",
        rates.table,
    )
    (out / "control.md").write_text("\n".join(tables))
    draw(out / "control.png", free[judge], held, h)
    draw_following(out / "following.png", plan, following, h)
    draw_replanned(out / "replanning.png", replanning, h)

    gap = np.abs(held[judge].height - held["order 40"].height).max() / np.abs(held[judge].height).max()
    claims = [
        ("the first bending fades ten times faster with the controller", bending <= -TIMES_FASTER * decay),
        ("the full order settles ten times faster", times[judge][0] >= TIMES_FASTER * times[judge][1]),
        ("the controlled reduced model moves as the full order, to 1e-3", gap <= 1e-3),
        ("the planned tip stays within 1 % of its path", following.off["full order, planned"] <= 0.01 * LIFT),
        ("replanned tensions are off by half at most of those at rest",
         2 * replanning.off["full order, replanned"] <= replanning.off["full order, as held at rest"]),
        ("a plan is where the exact gradient through its steps vanishes, to 1e-7", replanning.slope <= 1e-7),
        *((f"order {order}: {form} is within {bound:g} of Python", rates.errors[order, form] <= bound)
          for order in roms for form, bound in AGREES_TO.items()),
    ]  # fmt: skip
    if not quick:
        claims += [
            ("a gradient costs at most three forward runs that read the tip", cost.times_read <= 3),
            ("a million steps are differentiated in 1 GB", cost.memory <= 1e9),
            ("99 of 100 plans are made a hundred times a second", replanning.slowest <= REPLANNED),
        ]
        claims += [(f"order {order}: C steps faster than Python", rates.gain[order] > 1) for order in roms]
    for claim, holds in claims:
        print(f"  {'holds' if holds else 'FAILS'}: {claim}")
    sys.exit(0 if all(holds for _, holds in claims) else 1)


def design(rom: fr.Rom, rate: float, h: float) -> Controller:
    """A feedback of little tension, with which all fades at least at a rate, 1/s; a Kalman filter of the tip's height.

    What is stable with A and B times exp(h rate) has that rate (Anderson & Moore: a prescribed degree of stability).
    """
    A, B, C, _ = rom.state_space("side", ["tip"], h)
    tendons, height, unit = B[:, 1:], C[[2]], np.eye(len(A))
    faster, tension_weight = np.exp(h * rate), np.eye(2)
    P = solve_discrete_are(faster * A, faster * tendons, 1e-6 * unit, tension_weight)
    pull = faster**2 * tendons.T @ P
    K = np.linalg.solve(tension_weight + pull @ tendons, pull @ A)
    S = solve_discrete_are(A.T, height.T, B @ B.T, np.array([[NOISE]]))  # any input may be disturbed by 1 N or so
    L = A @ S @ height.T / (height @ S @ height.T + NOISE)
    return Controller(A, tendons, height, K, L)


def bending_pole(controller: Controller, rom: fr.Rom, h: float) -> float:
    """At what rate the slowest controlled motion fades, 1/s: of the loop with a plant of higher order.

    Motions that tendons hardly reach, or the tip hardly shows, are left out: sideways, and those that fade in a step.
    """
    A, B, C, _ = rom.state_space("side", ["tip"], h)
    tendons, height = B[:, 1:], C[[2]]
    observer = controller.A - controller.B @ controller.K - controller.L @ controller.C
    loop = np.block([[A, -tendons @ controller.K], [controller.L @ height, observer]])
    poles, modes = np.linalg.eig(loop)
    read = np.abs(np.hstack([height, np.zeros((1, len(observer)))]) @ modes)[0]
    reached = np.abs(np.linalg.solve(modes, np.vstack([tendons, 0 * controller.B]))).max(axis=1)
    matters = read * reached > 1e-2 * (read * reached).max()
    return float((np.log(np.abs(poles[matters])) / h).max())


def run(body: Body, h: float, controller: Controller | None) -> Run:
    """Flicks a body, and lets the controller, which knows nothing of the flick, hold the tendons from then on."""
    z, height, tensions = np.zeros(2 * ORDER), [], []
    for step in range(round(DURATION / h)):
        y, u, flick = body.displacement("tip")[0, 2], np.zeros(2), 0.0
        if step * h < FLICKED:
            flick = FLICK * np.sin(np.pi * step * h / FLICKED)
        elif controller is not None:
            u = -controller.K @ z
            z = controller.A @ z + controller.B @ u + controller.L[:, 0] * (y - (controller.C @ z)[0])
        body.step(np.array([flick, *u]))
        height.append(y)
        tensions.append(u)
    return Run(np.array(height), np.array(tensions))


def draw(file: Path, free: Run, held: dict[str, Run], h: float) -> None:
    """The tip's height, alone and controlled, and the tensions."""
    figure = figure_class()(figsize=(11, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    times, full = h * np.arange(len(free.height)), held["full order"]
    left.plot(times, 1e3 * free.height, color="0.6", label="by itself")
    left.plot(times, 1e3 * full.height, label="controlled, full order", linewidth=3, alpha=0.5)
    left.plot(times, 1e3 * held["order 40"].height, "--", color="C0", label="controlled, order 40")
    left.set(xlabel="time (s)", ylabel="height of the tip (mm)")
    left.legend(fontsize="small")
    for name, tension in zip(("flexor", "extensor"), full.tensions.T, strict=True):
        right.plot(times, tension, label=name)
    right.set(xlabel="time (s)", ylabel="change of tension (N)", xlim=(0.0, 0.4))
    right.legend(fontsize="small")
    figure.savefig(file, dpi=150)


def draw_following(file: Path, plan: Plan, following: Following, h: float) -> None:
    """The tip's height by both tensions, and the tensions."""
    figure = figure_class()(figsize=(11, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    times = h * np.arange(1, len(plan.path) + 1)
    left.plot(times, 1e3 * following.heights["full order, as held at rest"], color="0.6", label="tensions as at rest")
    left.plot(times, 1e3 * following.heights["full order, planned"], linewidth=3, alpha=0.5, label="planned tensions")
    left.plot(times, 1e3 * plan.path, "k--", linewidth=1, label="the path asked for")
    left.set(xlabel="time (s)", ylabel="height of the tip, full order (mm)")
    left.legend(fontsize="small")
    for name, planned, at_rest in zip(("flexor", "extensor"), plan.planned.T, plan.at_rest.T, strict=True):
        (line,) = right.plot(times, planned, label=f"{name}, planned")
        right.plot(times, at_rest, ":", color=line.get_color(), label=f"{name}, as at rest")
    right.set(xlabel="time (s)", ylabel="change of tension (N)")
    right.legend(fontsize="small")
    figure.savefig(file, dpi=150)


def draw_replanned(file: Path, replanning: Replanning, h: float) -> None:
    """The tip's height by both kinds of tensions."""
    figure = figure_class()(figsize=(11, 3.6), layout="constrained")
    axes = figure.subplots()
    times, heights = h * np.arange(1, len(replanning.path) + 1), replanning.heights
    axes.axvspan(*FLICKED_LATER, color="C3", alpha=0.3, label="flicked")
    axes.plot(times, 1e3 * heights["full order, as held at rest"], color="0.6", label="tensions as at rest")
    axes.plot(times, 1e3 * heights["full order, replanned"], linewidth=3, alpha=0.5, label="replanned tensions")
    axes.plot(times, 1e3 * replanning.path, "k--", linewidth=1, label="the path asked for")
    axes.set(xlabel="time (s)", ylabel="height of the tip, full order (mm)")
    axes.legend(fontsize="small")
    figure.savefig(file, dpi=150)


if __name__ == "__main__":
    main()
