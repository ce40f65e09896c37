"""The page of a recorded run, or of two beside each other with their difference as colour."""

import threading
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import SceneError
from fenics_rom.mechanics.obstacle_poses import placed
from fenics_rom.mechanics.obstacles import HalfSpace, Obstacle
from fenics_rom.trajectory.comparison import common_instants, compare
from fenics_rom.trajectory.elastic_part import deformation
from fenics_rom.trajectory.trajectory import Trajectory
from fenics_rom.visualization.contact_fields import ContactFields
from fenics_rom.visualization.obstacle_meshes import obstacle_mesh
from fenics_rom.visualization.viewer.audience import Audience
from fenics_rom.visualization.viewer.coloured_body import ORIGIN, NextPicture
from fenics_rom.visualization.viewer.colours import with_unit
from fenics_rom.visualization.viewer.drawing import FRAMES_PER_SECOND, DrawnBody, set_camera_and_light
from fenics_rom.visualization.viewer.panel import ColourScale, EnergyPlot, begin_panel
from fenics_rom.visualization.viewer.surface import (
    CONTACT_PRESSURE,
    READING,
    UNITS,
    Surface,
    reading_fields,
    reading_words,
    surface_fields,
)

SPACING = 1.3  # of the body's width, between two runs side by side
PLAYING_SECONDS = 4.0, 30.0  # s that a run is played in, if it is shorter or longer
DIFFERENCE = "difference"
MAX_TIME_ERROR = 1e-9  # of the duration: round-off of instants that are the same


class RunPage:
    """Plays a run, or a run and the reference that it is measured against.

    Raises:
        SceneError: a run without a surface.
        CompareError: two runs of different bodies, or without common instants.
    """

    def __init__(self, viser: Any, runs: Sequence[Trajectory], names: Sequence[str]):
        for run, name in zip(runs, names, strict=True):
            if not len(run.triangles):
                raise SceneError(f"{name}: has no surface triangles, so there is nothing to draw")
        self._viser, self._runs, self._names = viser, runs, names
        first = runs[0]
        self._surface = Surface(first.nodes, first.triangles)
        if len(runs) == 1:
            self._rows = [np.arange(len(first.snapshot_times))]
            self._comparison = ""
        else:
            difference = compare(*runs)["shape"]
            self._comparison = (
                f"{names[0]} against {names[1]}: {difference.relative:.2e} of the shape (in mass and time), "
                f"at most {with_unit(difference.largest, 'm')} of {with_unit(difference.largest_reference, 'm')}"
            )
            self._rows = list(common_instants(first.snapshot_times, runs[1].snapshot_times, "whole shapes"))
        self._times = first.snapshot_times[self._rows[0]]
        self._changed = threading.Event()
        self._changed.set()

    def show_on(self, server: Any) -> "RunPage":
        """Puts bodies and widgets on a viser server."""
        places, first = self._surface.places, self._runs[0]
        size = float(np.ptp(places, axis=0).max())
        reach = np.concatenate([_reach(run, places) for run in self._runs])
        aside = np.zeros(3)
        axis = int(np.ptp(places, axis=0).argsort()[1])
        aside[axis] = SPACING * max(float(np.ptp(reach[:, axis])), 0.2 * size)
        offsets = [k * aside for k in range(len(self._runs))]
        set_camera_and_light(server, np.concatenate([reach + offset for offset in offsets]) / size)
        self._server, self._bodies = server, []
        self._next_picture, self._audience = NextPicture(), Audience(server)
        for k, (run, offset) in enumerate(zip(self._runs, offsets, strict=True)):
            obstacles = {name: one for name, one in run.obstacles.items() if not _covers(first, name, one, offset)}
            self._bodies.append(
                DrawnBody(
                    server.scene,
                    f"/run_{k}",
                    run.nodes,
                    self._surface,
                    run.tendons,
                    obstacles,
                    self._next_picture,
                    1 / size,
                    offset,
                )
            )
        if len(self._runs) == 2:
            above = np.array([*(places.mean(axis=0)[:2]), places[:, 2].max() + 0.1 * size])
            for k, (name, offset) in enumerate(zip(self._names, offsets, strict=True)):
                server.scene.add_label(f"/name_{k}", name, position=tuple((above + offset) / size))
        self._add_widgets(server.gui)
        return self

    def _add_widgets(self, gui: Any) -> None:
        run = self._runs[0]
        begin_panel(gui, run.name)
        self._status = gui.add_markdown("")
        last = len(self._times) - 1
        self._play = gui.add_button("Play", disabled=last == 0)
        start, end = float(self._times[0]), float(self._times[-1])
        step = float(np.diff(self._times).min()) if last else end
        self._at = gui.add_slider(
            "time (s)", min=start if last else 0.0, max=end, step=step, initial_value=end, disabled=last == 0
        )
        took = float(np.clip(end, *PLAYING_SECONDS))
        self._played = gui.add_slider("plays in (s)", min=1.0, max=60.0, step=0.5, initial_value=round(took))
        self._fields = surface_fields(self._surface, None, moves=False)  # a run does not keep its materials
        self._readings = reading_fields(self._surface, run.readings)
        shared = set.intersection(*(set(run.readings) for run in self._runs))
        common = [name for name in self._readings if name.removeprefix(READING) in shared]
        self._touched = [ContactFields(run) for run in self._runs if run.touched is not None]
        touched = [CONTACT_PRESSURE] if len(self._touched) == len(self._runs) else []
        names = ([DIFFERENCE] if len(self._runs) == 2 else []) + [*self._fields, *touched, *common]
        self._field = gui.add_dropdown("colour", tuple(names), initial_value=names[0])
        self._colours = ColourScale(gui)
        with gui.add_folder("Energy"):
            plot = EnergyPlot(self._viser, gui)
            sums = run.energy, run.supplied, run.dissipated, run.lost_in_switching, run.numerical
            plot.show(run.times, np.array(sums))
        self._playing = False

        @self._play.on_click
        def _(_: Any) -> None:
            self._moment = 0.0 if self._row() == last else self._at.value
            self._playing = not self._playing
            self._play.label = "Pause" if self._playing else "Play"

        @self._at.on_update
        def _(_: Any) -> None:
            self._changed.set()

        @self._field.on_update
        def _(_: Any) -> None:
            self._colours.clear()
            self._changed.set()

    def _row(self) -> int:
        """The shape that is nearest to the time that is set."""
        return int(np.abs(self._times - self._at.value).argmin())

    def _instants(self, row: int) -> list[int]:
        """Of all instants of each run that at which it has this shape."""
        return [int(np.abs(run.times - self._times[row]).argmin()) for run in self._runs]

    def _reading_time(self, row: int) -> str:
        """When readings are of another instant than the shape, as not every one is kept; else empty."""
        times = [
            run.times[instant] for run, instant in zip(self._runs, self._instants(row), strict=True) if run.readings
        ]
        if np.allclose(times, self._times[row], rtol=0, atol=MAX_TIME_ERROR * self._times[-1]):
            return ""
        return f"readings of t = {' and '.join(f'{t:.6g}' for t in times)} s"

    def _move(self, share: float) -> None:
        """Goes on by a share of the run."""
        last = float(self._times[-1])
        self._moment += share * last
        if self._moment >= last:
            self._playing, self._play.label = False, "Play"
        self._at.value = float(np.clip(self._moment, self._times[0], last))
        self._changed.set()

    def run(self, ended: threading.Event) -> None:
        """Draws until it is ended or interrupted."""
        clock = time.perf_counter()
        while not ended.is_set():
            begin = time.perf_counter()
            if self._playing:
                self._move((begin - clock) / self._played.value)
            clock = begin
            if (self._changed.is_set() or self._next_picture) and self._audience.is_ready():
                with self._server.atomic():
                    self._next_picture.show()
                    if self._changed.is_set():
                        self._changed.clear()
                        self._draw(self._row())
                self._audience.ask()
            ended.wait(max(0.0, begin + 1 / FRAMES_PER_SECOND - time.perf_counter()))

    def _straining(self, run: Trajectory, whole: Array) -> Array:
        """What colours show of a displacement of all nodes: of a moving frame what strains the body."""
        return deformation(run, whole[None])[0][self._surface.nodes]

    def _draw(self, row: int) -> None:
        name = self._field.value
        wholes = [run.snapshots[rows[row]] for run, rows in zip(self._runs, self._rows, strict=True)]
        shapes = [whole[self._surface.nodes] for whole in wholes]
        tractions: list[Array | None] = [None] * len(self._runs)
        values = list[Array]()
        if name == CONTACT_PRESSURE:
            rows = [of_run[row] for of_run in self._rows]
            tractions = [of_run.traction(k) for of_run, k in zip(self._touched, rows, strict=True)]
            for of_run, k in zip(self._touched, rows, strict=True):
                values.append(self._surface.of_nodes(of_run.pressure(k)[self._surface.nodes], of_run.touchable))
        elif name == DIFFERENCE:
            values = [self._surface.of_nodes(np.linalg.norm(shapes[0] - shapes[1], axis=1))] * 2
        elif name in self._readings:
            kept = [run.readings[name.removeprefix(READING)] for run in self._runs]
            sizes = [reading.at(k).on_surface[0] for reading, k in zip(kept, self._instants(row), strict=True)]
            values = [self._readings[name](of_run) for of_run in sizes]
        else:
            values = [self._fields[name](shape, shape) for shape in map(self._straining, self._runs, wholes)]
        unit = self._readings[name].unit if name in self._readings else UNITS.get(name, "m")
        most = max(float(of_run.max()) for of_run in values)
        largest = self._colours.cover(most, unit)
        for k, run in enumerate(self._runs):
            instant = self._rows[k][row]
            motion = {name: moved[instant] for name, moved in run.obstacle_motion.items()}
            self._bodies[k].draw(run.snapshots[instant], values[k], largest, motion, traction=tractions[k])
        lines = [
            f"t = {self._times[row]:.3f} s, {name} up to {with_unit(most, unit)}",
            f"shape {row + 1} of {len(self._times)}",
            self._comparison,
            self._reading_time(row),
            *reading_words(run.readings, self._instants(row)[0]),
        ]
        self._status.content = "  \n".join(lines)


def _reach(run: Trajectory, places: Array) -> Array:
    """Points around all that is shown of a run, (any, 3), m, but half-spaces, which go on for ever."""
    points = [places]
    if run.pose is not None or run.bodies:
        moved = (run.nodes + run.snapshots).reshape(-1, 3)
        points += [moved.min(axis=0)[None], moved.max(axis=0)[None]]
    for name, obstacle in run.obstacles.items():
        if not isinstance(obstacle, HalfSpace):
            vertices, motion = obstacle_mesh(obstacle, ORIGIN, 0.0)[0], run.obstacle_motion[name]
            moved = np.concatenate([placed(vertices, row) for row in np.unique(motion, axis=0)])
            points += [moved.min(axis=0)[None], moved.max(axis=0)[None]]
    return np.concatenate(points)


def _covers(first: Trajectory, name: str, obstacle: Obstacle, offset: Array) -> bool:
    """Whether an obstacle that is drawn at an offset from the first run's is the same half-space."""
    if not (offset.any() and isinstance(obstacle, HalfSpace) and first.obstacles.get(name) == obstacle):
        return False
    return bool(np.isclose(np.dot(obstacle.normal, offset), 0.0))
