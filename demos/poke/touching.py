"""What the demos of contact share: how close runs are, how deep they go, what is claimed of them, and pictures."""

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import gmsh
import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgb

import fenics_rom as fr
from fenics_rom.io.markdown import markdown
from fenics_rom.mechanics.active_environment import ActiveEnvironment
from fenics_rom.scene.scene import Scene

Array = np.ndarray
Move = Callable[[Array], Array]  # of nodes (N, 3), m

DEGREE = np.radians(1.0)  # by which meshes are turned
FINER = {2: "full order at half the step", 4: "full order at a quarter of it"}  # by parts of a step
LIGHT = np.array([-0.35, -0.65, 0.68])  # where it comes from; of length 1
BODY = "#d9d4c7"  # silicone
OUTLINE = "0.25"


@dataclass(frozen=True)
class Errors:
    """How far a run is from another one, at the instants that they have in common.

    Attributes:
        shape: in mass over the body, 2-norm over the run, relative.
        node: largest distance of any node at any instant, as a share of the largest displacement.
        forces: of each obstacle, 2-norm over the run, relative.
    """

    shape: float
    node: float
    forces: dict[str, float]

    @property
    def cells(self) -> list[str]:
        """For a table."""
        return [f"{value:.1e}" for value in (self.shape, self.node, *self.forces.values())]


def errors(run: fr.Trajectory, reference: fr.Trajectory) -> Errors:
    """Errors of a run against another one."""
    differences = fr.compare(run, reference)
    shape = differences["shape"]
    forces = {name: differences[f"force of {name}"].relative for name in reference.forces}
    return Errors(shape.relative, shape.largest / shape.largest_reference, forces)


@dataclass(frozen=True)
class Comparison:
    """A scene at full order and reduced.

    Attributes:
        full: the reference, at the step of the reduced runs.
        sensitive: what else full order says of the scene, by how it was asked: at smaller steps, or on a mesh that says
            the same of the body, with the shapes on the nodes of `full`. A reduced error below that is no accuracy that
            one could use.
        reduced, without: by order; the same, or of another basis, without residual compliance.
        others: of other bases, by what is to be said of them and by order.
    """

    full: fr.Trajectory
    sensitive: dict[str, fr.Trajectory]
    reduced: dict[int, fr.Trajectory]
    without: dict[int, fr.Trajectory]
    others: dict[str, dict[int, fr.Trajectory]] = field(default_factory=dict)

    @property
    def stiff(self) -> str:
        """What is said of runs without residual compliance."""
        return "without residual compliance" + (" too" if self.others else "")

    @property
    def step(self) -> Errors | None:
        """What the step itself makes; None where it was not asked for."""
        finer = self.sensitive.get(FINER[2])
        return None if finer is None else errors(finer, self.full)

    @property
    def rows(self) -> list[tuple[str, int, fr.Trajectory]]:
        """All that is told apart from full order: what it is, its order, the run."""
        groups = {"reduced": self.reduced, **self.others, self.stiff: self.without}
        of_full = [(name, self.full.settings["order"], run) for name, run in self.sensitive.items()]
        return of_full + [(name, order, run) for name, runs in groups.items() for order, run in runs.items()]

    def table(self, file: Path) -> None:
        """Prints and writes errors and rates."""
        full_rate = rate(self.full)
        blank = ("", "", *("" for _ in self.full.forces))
        rows = [("full order", self.full.settings["order"], *blank, f"{full_rate:,.0f}", "1")]
        for name, order, run in self.rows:
            timed = name == "reduced"
            speed = (f"{rate(run):,.0f}", f"{rate(run) / full_rate:.1f}") if timed else ("", "")
            rows.append((name, order, *errors(run, self.full).cells, *speed))
        heading = ("model", "order", "shape", "any node", *(f"force of {name}" for name in self.full.forces))
        table = markdown((*heading, "steps per second", "times full order"), rows)
        file.write_text(table)
        dt = f"{1e3 * self.full.settings['dt']:g} ms"
        print(f"""{self.full.steps} steps of {dt} with contact and friction, one thread

Errors against full order at the same step: of the shape in mass and of forces in the 2-norm over the run, and the
largest of any node at any instant. Those of smaller steps, at the same instants, say what {dt} make by themselves.

{table}""")


def compare_orders(
    system: fr.System,
    roms: Mapping[int, fr.Rom],
    *,
    sensitivity: Mapping[str, Move] | None,
    others: Mapping[str, Mapping[int, fr.Rom]] | None = None,
) -> Comparison:
    """Runs the scene of ROMs, by order, at full order and reduced.

    Args:
        system: the full-order model.
        roms: those that are compared; without residual compliance are the last of the others, if there are any.
        sensitivity: how nodes are moved to a mesh that says the same of the body, by what is to be said of it: on that
            full order is run, too, and at half and at a quarter of the step; None: it is not.
        others: of other bases, by what is to be said of them.
    """
    full, sensitive = fr.simulate(system), {}
    if sensitivity is not None:
        assert system.scene is not None
        sensitive = {name: fr.simulate(system, dt=full.settings["dt"] / n) for n, name in FINER.items()}
        sensitive |= {name: run_moved(system.scene, full, move) for name, move in sensitivity.items()}
    reduced = {order: fr.simulate(rom, profile=True, rate=True) for order, rom in roms.items()}
    beside = {name: {order: fr.simulate(rom) for order, rom in each.items()} for name, each in (others or {}).items()}
    stiff = list((others or {"": roms}).values())[-1]
    without = {
        order: fr.simulate(rom, scene=replace(rom.environment, residual_compliance=False))
        for order, rom in stiff.items()
    }
    return Comparison(full, sensitive, reduced, without, beside)


def run_moved(scene: Scene, full: fr.Trajectory, move: Move) -> fr.Trajectory:
    """The same at full order with every node moved, which makes an obstacle find other ones.

    Shapes are told on the nodes of `full`, by number: that places a little beside are compared changes the errors that
    the demos table by less than a tenth.
    """
    with TemporaryDirectory() as folder:
        file = Path(folder) / "moved.msh"
        write_moved(scene.mesh_file, move, file)
        run = fr.simulate(fr.assemble(replace(scene, mesh_file=file)))
    moved, way = (np.linalg.norm(nodes - full.nodes, axis=1).max() for nodes in (run.nodes, move(full.nodes)))
    assert moved <= (1 + 1e-9) * way, "nodes have other numbers"
    return replace(run, nodes=full.nodes, node_mass=full.node_mass)


def write_moved(mesh: Path, move: Move, file: Path) -> None:
    """Writes a mesh whose nodes are moved."""
    gmsh.initialize([], readConfigFiles=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.open(str(mesh))
        tags, nodes, _ = gmsh.model.mesh.getNodes()
        for tag, node in zip(tags, move(nodes.reshape(-1, 3)), strict=True):
            gmsh.model.mesh.setNode(tag, node, [])
        gmsh.write(str(file))
    finally:
        gmsh.finalize()


def turned(nodes: Array, *, axis: int, centre: Sequence[float] = (0.0, 0.0, 0.0)) -> Array:
    """Nodes (N, 3), m, that are turned by a degree about an axis of space through a point."""
    turn, j, k = np.eye(3), (axis + 1) % 3, (axis + 2) % 3
    turn[j, j] = turn[k, k] = np.cos(DEGREE)
    turn[k, j] = np.sin(DEGREE)
    turn[j, k] = -turn[k, j]
    return (nodes - centre) @ turn.T + centre


def slid(nodes: Array, *, axis: int, ends: tuple[float, float], way: float) -> Array:
    """Nodes (N, 3), m, that are moved some way along an axis, less and less towards two planes and not beyond them.

    Planes of constant x, y or z outside, at the ends and across stay what they are, and so does a body of such faces.
    """
    first, last = ends
    ramp = (last - first) / 10
    moved = nodes.copy()
    moved[:, axis] += way * np.interp(nodes[:, axis], (first, first + ramp, last - ramp, last), (0.0, 1.0, 1.0, 0.0))
    return moved


def rate(run: fr.Trajectory) -> float:
    """Steps per second."""
    return float(run.steps / run.settings["seconds"])


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
