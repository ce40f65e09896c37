"""What the demos of contact share: how close runs are, how deep they go, what is claimed of them, and pictures."""

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgb

import fenics_rom as fr
from fenics_rom.io.markdown import markdown
from fenics_rom.mechanics.active_environment import ActiveEnvironment
from fenics_rom.scene.scene import Scene

Array = np.ndarray

LIGHT = np.array([-0.35, -0.65, 0.68])  # where it comes from; of length 1
BODY = "#d9d4c7"  # silicone
OUTLINE = "0.25"


def error(run: fr.Trajectory, full: fr.Trajectory) -> float:
    """Largest distance of any node at any kept instant, as a share of the largest displacement."""
    shape = fr.compare(run, full)["shape"]
    return shape.largest / shape.largest_reference


def deepest(run: fr.Trajectory, scene: Scene, points: Array) -> tuple[float, float]:
    """How deep points (P,) are in an obstacle at most, m, and the most that one moves with or against it in a step, m.

    The run must have kept the shape of every step. The motion is that of the point and that of the obstacle, of points
    so close that they may touch.
    """
    around = ActiveEnvironment(scene.environment)
    places = run.nodes[points] + np.concatenate([np.zeros((1, len(points), 3)), run.snapshots[:, points]])
    moved = np.linalg.norm(np.diff(places, axis=0), axis=2)
    offsets = np.array([around.offsets_at(t) for t in run.times])
    depth, motion = 0.0, 0.0
    for o, obstacle in enumerate(around.obstacles.values()):
        gaps = np.array([obstacle.distance(at - offset)[0] for at, offset in zip(places, offsets[:, o], strict=True)])
        both = moved + np.linalg.norm(np.diff(offsets[:, o], axis=0), axis=1)[:, None]
        depth = max(depth, -float(gaps.min()))
        motion = max(motion, float(both[gaps[:-1] < both].max(initial=0.0)))
    return depth, motion


def within_linear(run: fr.Trajectory) -> bool:
    """Whether nothing turned or strained beyond what a linear model can follow."""
    return not any("linear model" in message for message in run.warnings)


def laws(run: fr.Trajectory, scene: Scene, points: Array) -> dict[str, bool]:
    """What holds of every run among obstacles, reduced or not."""
    depth, motion = deepest(run, scene, points)
    contact, friction = (run.contact_account[name] for name in ("contact", "friction"))
    rounding = 1e-12 * max(np.abs(run.supplied).max(), run.dissipated[-1])
    print(
        f"{run.model}: energy account closed to {run.balance_error:.1e}; impacts took {contact[-1]:.2e} J and friction "
        f"{friction[-1]:.2e} J of {run.supplied[-1]:.2e} J put in; deepest {depth:.1e} m, where a step is up to "
        f"{motion:.1e} m"
    )
    return {
        f"{run.model}: the energy account is closed to 1e-12": run.balance_error < 1e-12,
        f"{run.model}: contact never adds energy": bool(np.diff(contact).min() >= -rounding),
        f"{run.model}: friction never adds energy": bool(np.diff(friction).min() >= -rounding),
        f"{run.model}: no point is deeper in an obstacle than both move in a step": depth <= motion,
    }


def table_of_errors(
    runs: dict[int, fr.Trajectory], errors: dict[int, float], full: fr.Trajectory, size: int, file: Path
) -> None:
    """Errors and rates against the order."""
    rate = {order: run.steps / run.settings["seconds"] for order, run in runs.items()}
    full_rate = full.steps / full.settings["seconds"]
    rows = [("full order", size, "", f"{full_rate:,.0f}", "1")]
    rows += [
        ("reduced", order, f"{errors[order]:.1e}", f"{rate[order]:,.0f}", f"{rate[order] / full_rate:.0f}")
        for order in runs
    ]
    heading = ("model", "order", "largest error / largest displacement", "steps per second", "times full order")
    table = markdown(heading, rows)
    file.write_text(table)
    print(f"{full.steps} steps of {full.settings['dt'] * 1e3:g} ms with contact and friction, one thread\n\n{table}")


def table_of_parts(run: fr.Trajectory, file: Path) -> None:
    """What a step spends its time on."""
    total = sum(run.profile.values())
    rows = [(part, f"{1e6 * each:.0f}", f"{each / total:.0%}") for part, each in run.profile.items()]
    table = markdown(("part of a step", "microseconds", "share"), rows)
    file.write_text(table)
    print(f"Order {run.settings['order']}, {1e6 * total:.0f} microseconds per step\n\n{table}")


def check(claims: Mapping[str, bool]) -> None:
    """Prints what was claimed, and stops where it does not hold."""
    for claim, holds in claims.items():
        print(f"  {'holds' if holds else 'FAILS'}: {claim}")
    if not all(claims.values()):
        sys.exit(1)


def draw_from_side(
    axes: Any, nodes: Array, triangles: Array, *, coloured: Mapping[str, Array] | None = None, lift: float = 0.0
) -> None:
    """Draws a surface as it is seen along y, to scale, shaded; what is in front hides what is behind.

    Args:
        axes: two-dimensional axes for x and z.
        nodes: (N, 3) where they are, m.
        triangles: (F, 3) outward.
        coloured: nodes (P,) of patches that have a colour of their own, by colour.
        lift: what to add to z, m.
    """
    a, b, c = (nodes[triangles[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    colours = np.tile(to_rgb(BODY), (len(triangles), 1))
    for colour, points in (coloured or {}).items():
        colours[np.isin(triangles, points).all(axis=1)] = to_rgb(colour)
    shade = 0.62 + 0.38 * np.clip(normals @ LIGHT, 0, 1)
    front = np.flatnonzero(normals[:, 1] < 0)
    front = front[np.argsort(-(a + b + c)[front, 1])]
    seen = nodes[triangles[front]][:, :, [0, 2]] + [0.0, lift]
    faces = colours[front] * shade[front, None]
    axes.add_collection(PolyCollection(seen, facecolors=faces, edgecolors=faces, linewidths=0.3))


def true_to_scale(axes: Any, x: Sequence[float], z: Sequence[float]) -> None:
    """Bare axes on which a metre is as long both ways."""
    axes.set(xlim=x, ylim=z, aspect="equal")
    axes.set_axis_off()
