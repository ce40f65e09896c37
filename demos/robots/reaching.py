"""The trunk reaches three points, one after the other, by cables that are planned with exact gradients.

    python demos/robots/reaching.py            # some minutes
    python demos/robots/reaching.py --quick    # the first point, half a minute

Tensions of all eight cables are found by L-BFGS on the adjoint of the reduced model's steps, with large deformation;
then the full order is pulled by them, and judges. By what it misses the aims are corrected, as one would with an arm.
Everything is written to demos/robots/out/. The checks at the end fail if a claim does not hold.
"""

import argparse
import sys
import warnings
from dataclasses import replace
from pathlib import Path
from time import process_time
from typing import NamedTuple

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from scipy.optimize import minimize

sys.path.append(str(Path(__file__).parents[1] / "poke"))

from touching import check

import fenics_rom as fr
from fenics_rom.fem.simulator import FullOrderSimulator
from fenics_rom.mechanics.environment import AppliedLoad
from fenics_rom.mechanics.signals import Signal

HERE = Path(__file__).parent
TIP = np.array([0.0, 0.0, 0.195])  # at rest, m
TARGETS = np.array([[0.025, 0.015, 0.190], [-0.015, 0.03, 0.189], [-0.015, -0.025, 0.190]])  # m
DT, GO, REST = 0.01, 0.5, 0.3  # s: of a step; to go to a point; to rest there
EACH = 0.1  # s between tensions; linear in between
MOST = 0.5  # N
EASE = 1e-8  # m²/N² of each step's tensions, so that cables do not pull against each other
SCALE = 0.3  # m²: of what L-BFGS makes small; its first step, along the gradient, is then not too long
CORRECTIONS = 2  # of aims
ITERATIONS, FEWER = 50, 20
ORDER = 24
NEAR = 1e-3  # m: from a point counts as there

Array = np.ndarray


class Plan(NamedTuple):
    """What L-BFGS found."""

    knots: Array  # (knots, 8) of the tensions, as shares of the most
    tensions: Array  # (steps, 8), N
    path: Array  # (steps, 3) of the tip, reduced, m
    gradients: int
    seconds: float  # of processor time


def main() -> None:
    """Runs the demo; exits with 1 where a claim fails."""
    parser = argparse.ArgumentParser(description="The trunk reaches points.")
    parser.add_argument("--quick", action="store_true", help="the first point")
    quick = parser.parse_args().quick
    targets = TARGETS[: 1 if quick else len(TARGETS)]
    out = HERE / "out"
    out.mkdir(parents=True, exist_ok=True)
    system = fr.assemble(pulled_by_all(fr.read_scene(HERE / "trunk.toml")))
    file = out / "trunk-all-cables.h5"
    if not file.is_file():
        fr.write_rom(file, fr.reduce(system, order=ORDER, method="modal+derivatives"))
    rom, aims, plan, off = fr.read_rom(file), targets.copy(), None, []
    print("| plan | gradients | time (s) | their steps at full order (s) | off, reduced (mm) | off, full order (mm) |")
    print("|---|---|---|---|---|---|")
    for number in range(2 if quick else 1 + CORRECTIONS):
        plan = plan_tensions(rom, aims, plan, FEWER if quick else ITERATIONS)
        begin = process_time()
        judged = follow(FullOrderSimulator(system, DT, system.scene.environment), plan.tensions)
        seconds = process_time() - begin
        off.append([farthest(plan.path, aims), farthest(judged, targets)])
        reduced, full = 1e3 * np.array(off[-1])
        print(f"| {number + 1} | {plan.gradients} | {plan.seconds:.1f} | {seconds:.1f} | {reduced:.2f} | {full:.2f} |")
        aims += targets - np.array([judged[rests].mean(axis=0) for rests in resting(len(targets))])
    draw(out / "reaching.png", plan, judged, targets)
    check(
        {
            f"reduced, the tip rests within {1e3 * NEAR:g} mm of each point": off[0][0] < NEAR,
            f"the full order rests within {1e3 * NEAR:g} mm, when corrected": off[-1][1] < NEAR,
        }
    )


def farthest(path: Array, points: Array) -> float:
    """How far off the tip is at most while it is to rest, m."""
    apart = [
        np.linalg.norm(path[rests] - point, axis=1) for point, rests in zip(points, resting(len(points)), strict=True)
    ]
    return float(np.max(apart))


def pulled_by_all(scene: fr.Scene) -> fr.Scene:
    """The scene, whose model is to be trained with all cables."""
    assert scene.run is not None
    most = Signal(np.array([MOST]))
    loads = [AppliedLoad(None, name, 0.0, scene.run.duration, most) for name in scene.effects.tendon]
    return replace(scene, run=replace(scene.run, loads=tuple(loads)))


def resting(points: int) -> list[slice]:
    """The steps in which the tip is to be at each point."""
    go, rest = round(GO / DT), round(REST / DT)
    return [slice(k * (go + rest) + go, (k + 1) * (go + rest)) for k in range(points)]


def plan_tensions(rom: fr.Rom, targets: Array, known: Plan | None, iterations: int) -> Plan:
    """Tensions that lead the tip to each point in turn, and keep it there."""
    body = fr.Simulator(rom, DT, stepper="linearly-implicit")
    steps = resting(len(targets))[-1].stop
    knots = np.arange(0, steps * DT + EACH / 2, EACH)
    times = DT * (np.arange(steps) + 0.5)  # a step's input is that of its middle
    spread = np.array([np.interp(times, knots, unit) for unit in np.eye(len(knots))]).T  # (steps, knots)
    cables, path = body.inputs - 3, np.empty(0)  # the first three are forces on the tip

    def miss(unknowns: Array) -> tuple[float, Array]:
        tensions = MOST * spread @ unknowns.reshape(len(knots), cables)

        def squares(outputs: dict[str, Array], energies: Array) -> tuple[float, dict[str, Array], None]:
            nonlocal path
            path, slope, value = TIP + outputs["tip"][:, 0], np.zeros_like(outputs["tip"]), 0.0
            for target, rests in zip(targets, resting(len(targets)), strict=True):
                apart = path[rests] - target
                slope[rests, 0] = 2 * apart
                value += float((apart**2).sum())
            return value, {"tip": slope}, None

        u = np.hstack([np.zeros((steps, 3)), tensions])
        gradient = fr.differentiate(body, u, squares, outputs=["tip"])
        value = gradient.value + EASE * float((tensions**2).sum())
        slope = gradient.inputs[:, 3:] + 2 * EASE * tensions
        return value / SCALE, MOST * (spread.T @ slope).ravel() / SCALE

    begin = process_time()
    start = np.full(len(knots) * cables, 0.1) if known is None else known.knots.ravel()
    options = {"maxiter": iterations, "gtol": 1e-9}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", fr.FenicsRomWarning)  # of what is only tried
        found = minimize(miss, start, jac=True, method="L-BFGS-B", bounds=[(0.0, 1.0)] * len(start), options=options)
    seconds = process_time() - begin
    miss(found.x)
    shares = found.x.reshape(len(knots), cables)
    return Plan(shares, MOST * spread @ shares, path, found.nfev, seconds)


def follow(body: FullOrderSimulator, tensions: Array) -> Array:
    """Where the tip of a body goes, (steps, 3), m."""
    path = np.empty((len(tensions), 3))
    for row, tension in zip(path, tensions, strict=True):
        body.step(np.concatenate([np.zeros(3), tension]))
        row[:] = TIP + body.displacement("tip")[0]
    return path


def draw(file: Path, plan: Plan, judged: Array, targets: Array) -> None:
    """The tip's way from above, and the tensions."""
    figure, (above, pulled) = plt.subplots(1, 2, figsize=(9, 3.8), layout="constrained")
    for path, name, style in ((plan.path, "reduced", "-"), (judged, "full order", "--")):
        above.plot(*1e3 * np.vstack([TIP, path])[:, :2].T, style, label=name)
    above.plot(*1e3 * targets[:, :2].T, "kx", label="points to reach")
    above.set(xlabel="x, mm", ylabel="y, mm", title="The tip, from above", aspect="equal")
    above.legend()
    pulled.plot(DT * np.arange(1, len(plan.tensions) + 1), plan.tensions)
    pulled.set(xlabel="time, s", ylabel="tension, N", title="The eight cables")
    figure.savefig(file, dpi=120)
    plt.close(figure)


if __name__ == "__main__":
    main()
