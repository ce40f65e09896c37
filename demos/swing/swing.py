"""An arm swings a soft finger through a quarter turn in 0.3 s, and stops: what the finger does, and what the arm feels.

    python demos/swing/swing.py             # about a minute
    python demos/swing/swing.py --quick     # the swing alone, at one order

The finger's root is clamped to a base whose poses and twists are given; a tendon has bent it before. It swings in a
horizontal plane, so that its weight does nothing. The script

1. writes path.csv, which the scene names;
2. runs it at full order in the moving frame, and reduced at several orders;
3. leaves out what can be left out: all terms but the inertia of the rigid shape ("quasi-rigid"), geometric stiffening,
   and the finger's elasticity, as if it were rigid but for the tendon;
4. tables errors, and draws where the tip goes, how it rings, and the torque that the arm feels.

Everything else is written to demos/swing/out/. The checks at the end fail if a claim does not hold.
"""

import argparse
import sys
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from time import process_time

import numpy as np

import fenics_rom as fr
from fenics_rom.compilation import numpy_alone
from fenics_rom.io.markdown import markdown
from fenics_rom.mechanics.frame_motion import rotation_matrix
from fenics_rom.visualization.figure import figure_class

HERE = Path(__file__).parent
ARM = 0.05  # m, from the shoulder to the finger's root
START, SWING, TURN = 0.4, 0.3, np.pi / 2  # s, s, rad
ROWS = 5e-3  # s, between poses
ORDERS, BOUNDS = (5, 10, 20), (0.1, 0.02, 0.01)  # and the error of the tip's motion in the frame that each may have
DRAWN = (0.4, 0.48, 0.55, 0.62, 0.72)  # s

Array = np.ndarray


def main() -> None:
    """Runs the demo; exits with 1 where a claim fails."""
    parser = argparse.ArgumentParser(description="An arm swings a soft finger.")
    parser.add_argument("--quick", action="store_true", help="the swing alone, at one order")
    quick = parser.parse_args().quick
    out = HERE / "out" / "quick" if quick else HERE / "out"
    out.mkdir(parents=True, exist_ok=True)
    write_path()
    scene = fr.read_scene(HERE / "swing.toml")
    assert scene.run is not None
    if quick:
        scene = replace(scene, run=replace(scene.run, duration=START + SWING + 0.05, snapshots=150))
    system = fr.assemble(scene)
    print(f"{system.size} unknowns at full order")
    full = fr.simulate(system)
    orders = list(zip(ORDERS, BOUNDS, strict=True))[-1 if quick else 0 :]
    roms = {order: fr.reduce(system, order=order) for order, _ in orders}
    best = roms[ORDERS[-1]]
    assert best.moving_frame is not None
    runs = {f"order {order}": fr.simulate(rom) for order, rom in roms.items()}
    runs["without stiffening"] = fr.simulate(replace(best, moving_frame=replace(best.moving_frame, stiffening=None)))
    runs["quasi-rigid"] = fr.simulate(best, scene=replace(scene, run=replace(scene.run, detail="quasi-rigid")))

    rows = [row(name, run, full) for name, run in runs.items()]
    carried = np.broadcast_to(bent(full)[np.searchsorted(full.times, START) - 1], bent(full).shape)
    rows.append(("carried as if rigid", f"{apart(carried, bent(full)):.1e}", "", "", ""))
    heading = ("model", "tip in the frame", "base force", "base torque", "account")
    (out / "swing.md").write_text(markdown(heading, rows))
    print(markdown(heading, rows))
    if not quick:
        for detail in ("full", "quasi-rigid"):
            found, off = rates(best, scene, detail)
            words = " and ".join(f"{rate:,.0f} {way}" for way, rate in found.items())
            print(f"{detail}: {words} steps per second, {off:.0e} apart")
    draw(out / "swing.png", full, runs)
    fr.export(runs[f"order {ORDERS[-1]}"], out / "swing.gif", seconds=2.0, scale=4.0)
    claims = [
        (
            f"order {order}: error of the tip in the frame at most {bound:g}",
            error(runs[f"order {order}"], full) <= bound,
        )
        for order, bound in orders
    ]
    accounts = {"full order": (full, 1e-9)} | {name: (run, 1e-12) for name, run in runs.items()}
    claims += [
        (f"{name}: account closes to {gap:g}", run.balance_error <= gap) for name, (run, gap) in accounts.items()
    ]
    claims += [
        (
            "the base is where the path says, to round-off",
            np.abs(full.pose[-1] - runs["quasi-rigid"].pose[-1]).max() < 1e-12,
        ),
        ("the finger lags by more than a millimetre", np.abs(lag(full)).max() > 1e-3),
    ]
    for claim, holds in claims:
        print(f"  {'holds' if holds else 'FAILS'}: {claim}")
    sys.exit(0 if all(holds for _, holds in claims) else 1)


def row(name: str, run: fr.Trajectory, full: fr.Trajectory) -> tuple[str, ...]:
    """Errors of a run."""
    differences = fr.compare(run, full)
    wrench = (f"{differences[what].relative:.1e}" for what in ("base force", "base torque"))
    return name, f"{error(run, full):.1e}", *wrench, f"{run.balance_error:.0e}"


def rates(rom: fr.Rom, scene: fr.Scene, detail: str) -> tuple[dict[str, float], float]:
    """Steps per second of the swinging finger, with its account, in NumPy and compiled where numba is.

    The best of some in turns, by processor time; and how far the two are apart in the end, as a share of how far the
    finger is bent.
    """
    dt, path = 2e-3, scene.effects.base_path
    assert path is not None
    assert path.table is not None
    given = replace(scene, effects=replace(scene.effects, base_path=None))
    bodies, places = {}, []
    for way, made in (("NumPy", numpy_alone()), *((("compiled", nullcontext()),) if fr.compiled() else ())):
        with made:
            bodies[way] = fr.Simulator(rom, dt, scene=given, detail=detail)
    best = dict.fromkeys(bodies, 0.0)
    bases = [path.table(START + k * dt) for k in range(1, 201)]
    for _ in range(20):
        for way, body in bodies.items():
            body.reset()
            u, start = np.zeros(body.inputs), process_time()
            for base in bases:
                body.step(u, base=base)
            best[way] = max(best[way], len(bases) / (process_time() - start))
            places.append(body.displacement())
    return best, float(np.abs(places[-1] - places[-len(bodies)]).max() / np.abs(places[-1]).max())


def bent(run: fr.Trajectory) -> Array:
    """Where the tip is in the frame beside where it is at rest, (S, 3), m."""
    rest = np.array([0.1, 0.0, 0.0])
    moved = rest + run.outputs["tip"][:, 0]
    return np.array([(x - p[:3]) @ rotation_matrix(p[3:]) for x, p in zip(moved, run.pose, strict=True)]) - rest


def lag(run: fr.Trajectory) -> Array:
    """Across the finger, beyond what the tendon does, m."""
    across = bent(run)[:, 2]
    return across - across[np.searchsorted(run.times, START) - 1]


def apart(one: Array, other: Array) -> float:
    """How far two motions of the tip are apart, as a share of the second."""
    return float(np.linalg.norm(one - other) / np.linalg.norm(other))


def error(run: fr.Trajectory, full: fr.Trajectory) -> float:
    """Of the tip's motion in the frame."""
    return apart(bent(run), bent(full))


def angle(t: Array) -> tuple[Array, Array]:
    """Of the arm, rad, and its rate, rad/s: from rest to rest, with a continuous acceleration."""
    s = np.clip((t - START) / SWING, 0, 1)
    return TURN * (10 * s**3 - 15 * s**4 + 6 * s**5), TURN / SWING * 30 * s**2 * (1 - s) ** 2


def write_path() -> None:
    """Poses and twists of the finger's root: about y, from along x to along z."""
    t = START + np.arange(0, SWING + ROWS / 2, ROWS)
    φ, ω = angle(t)
    zero = np.zeros_like(t)
    columns = {
        "time": t,
        "position.x": ARM * (np.cos(φ) - 1),
        "position.y": zero,
        "position.z": ARM * np.sin(φ),
        "rotation.w": np.cos(φ / 2),
        "rotation.x": zero,
        "rotation.y": -np.sin(φ / 2),
        "rotation.z": zero,
        "velocity.x": -ARM * ω * np.sin(φ),
        "velocity.y": zero,
        "velocity.z": ARM * ω * np.cos(φ),
        "angular_velocity.x": zero,
        "angular_velocity.y": -ω,
        "angular_velocity.z": zero,
    }
    rows = [",".join(f"{value + 0.0:.9g}" for value in row) for row in zip(*columns.values(), strict=True)]
    (HERE / "path.csv").write_text("\n".join([",".join(columns), *rows, ""]))


def draw(file: Path, full: fr.Trajectory, runs: dict[str, fr.Trajectory]) -> None:
    """The finger as it is swung, how far the tip is behind, and what the arm feels."""
    figure = figure_class()(figsize=(15, 3.8), layout="constrained")
    plan, tip, errors, torque = figure.subplots(1, 4)
    for k, time in enumerate(DRAWN):
        moved = full.nodes + full.snapshots[np.abs(full.snapshot_times - time).argmin()]
        shade = {"color": f"{0.75 - 0.15 * k:.2f}", "linewidth": 0.4}
        plan.triplot(1e3 * moved[:, 0], 1e3 * moved[:, 2], full.triangles, **shade)
        plan.annotate(f"{time:g} s", 1e3 * moved[np.argmax(full.nodes[:, 0])][[0, 2]], fontsize=7)
    path = full.outputs["tip"][:, 0] + [0.1, 0, 0]
    plan.plot(1e3 * path[:, 0], 1e3 * path[:, 2], color="C1", linewidth=1)
    plan.set(xlabel="x (mm)", ylabel="z (mm)", title="full order, from above; the way of the tip", aspect="equal")
    shown = {"full order": full} | {name: runs[name] for name in (f"order {ORDERS[-1]}", "quasi-rigid")}
    styles = ({"linewidth": 4, "alpha": 0.35}, {}, {"linestyle": "--"})
    for (name, run), style in zip(shown.items(), styles, strict=True):
        tip.plot(run.times, 1e3 * lag(run), label=name, **style)
        torque.plot(run.times, 1e3 * run.base_wrench[:, 4], label=name, **style)
    for name, colour in ((f"order {ORDERS[-1]}", "C1"), ("quasi-rigid", "C2"), ("without stiffening", "C3")):
        distance = np.linalg.norm(bent(runs[name]) - bent(full), axis=1)
        errors.semilogy(full.times, 1e3 * np.maximum(distance, 1e-10), color=colour, label=name)
    for axes, words, title in (
        (tip, "across the finger (mm)", "the tip in the turning frame"),
        (errors, "mm", "its distance from full order"),
        (torque, "torque about y (mN m)", "what the arm puts on the finger's root"),
    ):
        axes.axvspan(START, START + SWING, color="0.92", zorder=0)
        axes.set(xlabel="time (s)", ylabel=words, title=title, xlim=(START - 0.1, full.times[-1]))
        axes.legend(fontsize="small", loc="lower right" if axes is errors else "upper right")
    figure.savefig(file, dpi=150)


if __name__ == "__main__":
    main()
