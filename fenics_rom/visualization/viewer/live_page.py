"""The page of a live body: widgets, pictures and the clock around a LiveBody.

viser calls back from threads of its own. They only put what is to be done in a queue; the loop of this page does it
between two pictures, and is the only one that touches the body.
"""

import queue
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import FenicsRomError
from fenics_rom.trajectory.elastic_part import elastic_part
from fenics_rom.trajectory.file import write_trajectory
from fenics_rom.trajectory.trajectory import Trajectory
from fenics_rom.visualization.contact_surface import divide_contact_triangles
from fenics_rom.visualization.viewer.colours import with_unit
from fenics_rom.visualization.viewer.drawing import (
    FRAMES_PER_SECOND,
    DrawnBody,
    ForceArrow,
    PickSurface,
    set_camera_and_light,
)
from fenics_rom.visualization.viewer.live_body import LiveBody, free_name
from fenics_rom.visualization.viewer.mouse_spring import closest_point
from fenics_rom.visualization.viewer.panel import ENERGY_SERIES, ColourScale, EnergyPlot, begin_panel
from fenics_rom.visualization.viewer.surface import (
    OFF_SURFACE,
    READING,
    UNITS,
    Surface,
    reading_fields,
    reading_words,
    surface_fields,
)

STEPPING_SHARE = 0.6  # of the time of a picture that steps may take; the rest is for drawing and for the browser
MAX_CATCH_UP_SECONDS = 0.1  # between two pictures that steps make up for
PANEL_INTERVAL_SECONDS = 0.25  # between two states of the panel
MIN_SPEED = 0.01
LARGEST_FORCE_SHARE = 1.0 - 1e-9


class LivePage:
    """Shows a live body on a viser server, steps it with the clock, and hands it what the mouse does.

    Recordings are written into a folder, by names that begin with a stem; `notify` is told of them, for the terminal.
    """

    def __init__(self, viser: Any, server: Any, body: LiveBody, folder: Path, stem: str, notify: Callable[[str], None]):
        self._server, self.body, self._folder, self._stem, self._notify = server, body, folder, stem, notify
        self._todo: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._paused, self._speed, self._behind = False, 1.0, 0.0
        self._holder: int | None = None
        self._held_contact: str | None = None
        self._error = ""
        self._writing: list[threading.Thread] = []
        self._panel_due, self._panel_since, self._steps_since, self._time_since = 0.0, time.perf_counter(), 0, 0.0

        rom = body.rom
        self._surface = Surface(rom.nodes, rom.triangles)
        self._fields = surface_fields(self._surface, body.rom.environment)
        self._readings = reading_fields(self._surface, {name: body.reading(name) for name in rom.readings})
        self._size = float(np.ptp(self._surface.places, axis=0).max())
        self._scale = 1 / self._size
        self._triangles = divide_contact_triangles(rom)
        set_camera_and_light(server, self._scale * self._surface.places)
        around = body.simulator.environment
        obstacles = around.obstacles if around else {}
        tendons = rom.environment.tendons
        self._picture = DrawnBody(server.scene, "/body", rom.nodes, self._surface, tendons, obstacles, self._scale)
        self._pick_surfaces = {
            name: self._add_pick_surface(name, triangles)
            for name, triangles in self._triangles.items()
            if len(triangles)
        }
        self._arrow = ForceArrow(server.scene, self._scale)
        self._add_widgets(viser, server.gui)

    def _add_pick_surface(self, contact: str, triangles: Array) -> PickSurface:
        pick_surface = PickSurface(self._server.scene, f"/contact/{contact}", self._surface, triangles, self._scale)

        @pick_surface.mesh.on_click
        async def _(_: Any) -> None:
            self._todo.put(lambda: self.body.simulator.switch(contact))

        @pick_surface.mesh.on_drag
        async def _(event: Any) -> None:  # async: viser calls these in order, in one thread
            start, end = (np.array(place) / self._scale for place in (event.start_position, event.end_position))
            if event.phase == "start":
                self._todo.put(lambda: self._grab(event.client_id, contact, start))
            elif event.phase == "update":
                self._todo.put(lambda: self._drag(event.client_id, end - start))
            else:
                self._todo.put(lambda: self._let_go(event.client_id))

        return pick_surface

    def _grab(self, client: int, contact: str, place: Array) -> None:
        """Takes hold of the point of a contact surface that is nearest to a place; the last who grabs pulls."""
        triangles = self._pick_surfaces[contact].triangles
        nearest, weights = closest_point(self._moved()[triangles], place)
        if self.body.grab(contact, self._surface.nodes[triangles[nearest]], weights):
            self._holder, self._held_contact, self._grabbed_at = client, contact, self.body.held_at

    def _drag(self, client: int, displacement: Array) -> None:
        if client == self._holder:
            self.body.mouse = self._grabbed_at + displacement

    def _let_go(self, client: int) -> None:
        if client == self._holder:
            self.body.release()
            self._holder = self._held_contact = None

    def _add_widgets(self, viser: Any, gui: Any) -> None:
        body = self.body
        begin_panel(gui, body.rom.name)
        self._status = gui.add_markdown("")
        actions = {"pause": self._toggle_pause, "reset": self._reset, "record": self._toggle_record}
        buttons = gui.add_button_group("", tuple(actions))
        buttons.on_click(lambda event: self._todo.put(actions[event.target.value]))
        names = (*self._fields, *self._readings)
        self._field = gui.add_dropdown("colour", names, initial_value=names[0])
        self._colours = ColourScale(gui)
        self._field.on_update(lambda _: self._todo.put(self._colours.clear))
        self._sliders = []
        if body.actuators:
            with gui.add_folder("Actuators"):
                for k, actuator in enumerate(body.actuators):
                    label, step = f"{actuator.name} ({actuator.unit})", (actuator.largest - actuator.least) / 100
                    bounds = actuator.least, actuator.largest, step, 0.0
                    self._sliders.append(self._slider(gui, label, *bounds, partial(self._actuate, k)))
        with gui.add_folder("Energy"):
            self._account = gui.add_markdown("")
            self._plot = EnergyPlot(viser, gui)
        with gui.add_folder("Settings"):
            hint = "1 is real time, 0.1 ten times slower"
            self._slider(gui, "speed", MIN_SPEED, 1.0, 0.01, 1.0, self._set_speed, hint)
            dt = 1e3 * body.dt
            self._slider(gui, "step (ms)", dt / 10, 10 * dt, dt / 10, dt, self._set_dt, "the time step")
            if body.largest_order is not None and body.largest_order > 1:
                hint = "displacements of each contact mode; another order begins anew"
                self._slider(gui, "order", 1, body.largest_order, 1, body.order, self._set_order, hint)

    def _slider(
        self,
        gui: Any,
        label: str,
        least: float,
        most: float,
        step: float,
        value: float,
        action: Callable[[float], None],
        hint: str | None = None,
    ) -> Any:
        slider = gui.add_slider(label, min=least, max=most, step=step, initial_value=value, hint=hint)

        @slider.on_update
        def _(event: Any) -> None:
            if event.client_id is not None:  # by hand, not by a reset
                self._todo.put(lambda: action(slider.value))

        return slider

    def _toggle_pause(self) -> None:
        self._paused, self._error = not self._paused, ""

    def _reset(self) -> None:
        self._end_recording()
        self.body.reset()
        self._begin()
        for slider in self._sliders:
            slider.value = 0.0

    def _begin(self) -> None:
        """What a body at rest and at time 0 needs."""
        self._holder = self._held_contact = None
        self._behind, self._error, self._time_since = 0.0, "", 0.0
        self._colours.clear()
        self._plot.clear()
        self._panel_due = 0.0

    def _set_speed(self, speed: float) -> None:
        self._speed = speed

    def _set_dt(self, milliseconds: float) -> None:
        self._end_recording()
        self.body.dt = milliseconds / 1e3

    def _set_order(self, order: float) -> None:
        if order != self.body.order:
            self._end_recording()
            self.body.order = int(order)
            self._begin()

    def _actuate(self, k: int, value: float) -> None:
        self.body.values[k] = value * self.body.actuators[k].scale

    def _toggle_record(self) -> None:
        if self.body.records:
            self._end_recording()
        else:
            self.body.record()

    def _end_recording(self) -> None:
        """Makes the run and writes it, beside the live body."""
        if not self.body.records:
            return
        make = self.body.finish()
        if make is None:
            return
        file = free_name(self._folder, self._stem)
        file.touch()  # the name is taken
        writer = threading.Thread(target=self._write, args=(make, file))
        self._writing.append(writer)
        writer.start()

    def _write(self, make: Callable[[], Trajectory], file: Path) -> None:
        try:
            write_trajectory(file, make())
            message = f"recorded: {file}"
        except (FenicsRomError, OSError) as error:
            file.unlink(missing_ok=True)
            message = f"not recorded: {error}"
        self._notify(message)
        for client in self._server.get_clients().values():
            client.add_notification("Recording", message, with_close_button=True)

    def run(self, ended: threading.Event) -> None:
        """Steps and draws until it is ended or interrupted; then what was being recorded is written."""
        due = self._clock = time.perf_counter()
        try:
            while not ended.is_set():
                self._run_frame()
                now = time.perf_counter()
                due = max(due + 1 / FRAMES_PER_SECOND, now)
                ended.wait(due - now)
        finally:
            self._end_recording()
            for writer in self._writing:
                writer.join()

    def _run_frame(self) -> None:
        with suppress(queue.Empty):
            while True:
                self._attempt(self._todo.get_nowait())
        now = time.perf_counter()
        passed, self._clock = now - self._clock, now
        if not self._paused:
            self._step(passed)
        if self._server.get_clients():
            with self._server.atomic():
                self._draw()
                self._update_panel()

    def _attempt(self, action: Callable[[], object]) -> bool:
        """Does something, and tells what was wrong with it; gives whether it was done."""
        try:
            action()
        except FenicsRomError as error:
            self._error = str(error)
            return False
        return True

    def _step(self, passed: float) -> None:
        """The steps of the time that has passed. What the machine cannot keep up with is dropped."""
        due = self._speed * min(passed, MAX_CATCH_UP_SECONDS) + self._behind
        self._behind = 0.0
        if not self._attempt(lambda: self._advance(due)):
            self._paused = True

    def _advance(self, due: float) -> None:
        self._behind = min(self.body.advance(due, STEPPING_SHARE / FRAMES_PER_SECOND), self._speed / FRAMES_PER_SECOND)

    def _moved(self) -> Array:
        return self._surface.places + self.body.simulator.displacement()[self._surface.nodes]

    def _straining(self, whole: Array) -> Array:
        """What colours show of the displacement of all nodes: of a moving frame what strains the body."""
        rom = self.body.rom
        strained = elastic_part(whole, rom.nodes, rom.node_mass) if rom.environment.is_moving else whole
        return strained[self._surface.nodes]

    def _draw(self) -> None:
        simulator, name = self.body.simulator, self._field.value
        whole, around = simulator.displacement(), simulator.environment
        displacement = whole[self._surface.nodes]
        velocity = simulator.velocity()[self._surface.nodes] if name == "speed" else displacement
        moved = self._surface.places + displacement
        if name in self._readings:
            field = self._readings[name]
            values, unit = field(self.body.reading(name.removeprefix(READING)).sizes[0]), field.unit
        else:
            values, unit = self._fields[name](self._straining(whole), velocity), UNITS[name]
        largest = self._colours.cover(float(values.max()), unit)
        motion = dict(zip(around.obstacles, around.state.offsets, strict=True)) if around else {}
        held = self._triangles[self._held_contact] if self._held_contact else None
        self._picture.draw(whole, values, largest, motion, held)
        for pick_surface in self._pick_surfaces.values():
            pick_surface.draw(moved)
        if self.body.spring is None:
            self._arrow.hide()
        else:
            force = float(np.linalg.norm(self.body.force))
            most = " (most)" if force > LARGEST_FORCE_SHARE * self.body.spring.largest else ""
            self._arrow.draw(self.body.held_at, self.body.mouse, with_unit(force, "N") + most)

    def _update_panel(self) -> None:
        """The words and the plot, a few times a second."""
        now = time.perf_counter()
        if now < self._panel_due:
            return
        body = self.body
        wall, steps, simulated = now - self._panel_since, body.steps - self._steps_since, body.simulator.time
        factor = max(simulated - self._time_since, 0.0) / wall
        self._panel_due, self._panel_since = now + PANEL_INTERVAL_SECONDS, now
        self._steps_since, self._time_since = body.steps, simulated
        could = body.steps / body.seconds if body.seconds else 0.0
        ratio, frequency = body.damping_ratio
        lines = [
            f"t = {simulated:.2f} s · {factor:.2f} × real time",
            f"{steps / wall:,.0f} steps/s (could make {could:,.0f})",
            f"contact mode: **{body.simulator.contact}** · order {body.order}",
            f"damping: {100 * ratio:.2g} % of critical at {frequency:.3g} Hz",
        ]
        numbers = [name for name, reading in body.rom.readings.items() if reading.quantity in OFF_SURFACE]
        lines += reading_words({name: body.reading(name) for name in numbers}, 0)
        units = body.rom.environment.force_units
        lines += [
            f"{name}: {with_unit(force, units.get(name, 'N'))}" for name, force in body.simulator.reactions.items()
        ]
        state = ["paused"] * self._paused + ["recording"] * body.records
        lines += [f"**{', '.join(state)}**"] if state else []
        lines += [f"**{self._error}**"] if self._error else []
        lines += [f"*{warning}*" for warning in body.simulator.warnings]
        self._status.content = "  \n".join(lines)
        sums = zip(ENERGY_SERIES, body.account, strict=True)
        self._account.content = " · ".join(f"{name} {with_unit(energy, 'J')}" for name, energy in sums)
        self._plot.add(simulated, body.account)
