"""The clock of a live page, and what all of them have beside the picture.

viser calls back from threads of its own. They only put what is to be done in a queue; the loop of this page does it
between two pictures, and is the only one that touches what is live.
"""

import queue
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import FenicsRomError
from fenics_rom.visualization.viewer.audience import Audience
from fenics_rom.visualization.viewer.coloured_body import NextPicture
from fenics_rom.visualization.viewer.colours import with_unit
from fenics_rom.visualization.viewer.drawing import FRAMES_PER_SECOND, ForceArrow
from fenics_rom.visualization.viewer.live import Live
from fenics_rom.visualization.viewer.panel import ENERGY_SERIES, ColourScale, EnergyPlot, begin_panel

STEPPING_SHARE = 0.6  # of the time that steps may take; the rest is for drawing and for the browser
FEWEST_FRAMES_PER_SECOND = 10.0  # where the machine does not keep up: drawing, here and in a browser, takes from steps
PACE = 1.25  # by which the time between pictures changes from one to the next
PANEL_INTERVAL_SECONDS = 0.25  # between two states of the panel
MIN_SPEED = 0.01


class LiveLoop(ABC):
    """Steps what is live with the clock, draws it on a viser server, and hands it what the mouse does.

    Args:
        server: viser's.
        live: what is stepped.
        scale: of what is drawn, 1/m.

    Attributes:
        scale: as given.
        next_picture: what is shown with it, put off when it is drawn.
    """

    def __init__(self, server: Any, live: Live, scale: float):
        self._server, self._live, self.scale = server, live, scale
        self.next_picture, self._audience = NextPicture(), Audience(server)
        self._todo: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._paused, self._speed, self._behind = False, 1.0, 0.0
        self._before: Mapping[str, Array] | None = None
        self._frame = 1 / FRAMES_PER_SECOND  # s, from one picture to the next
        self._holder: int | None = None
        self._error = ""
        self._panel_due, self._panel_since, self._steps_since, self._time_since = 0.0, time.perf_counter(), 0, 0.0
        self._arrow = ForceArrow(server.scene, scale)

    @abstractmethod
    def _shapes(self) -> Mapping[str, Array]:
        """All that moves, by name, as it is after the last step."""

    @abstractmethod
    def _draw(self, shapes: Mapping[str, Array]) -> None:
        """Draws what is live in these shapes."""

    @abstractmethod
    def _words(self) -> list[str]:
        """What is said of it beside the time."""

    def _states(self) -> list[str]:
        return ["paused"] * self._paused

    def _end(self) -> None:
        """Lets go, when the page is closed."""
        self._live.release()

    def _add_widgets(
        self, viser: Any, gui: Any, name: str, actions: Mapping[str, Callable[[], None]], fields: Sequence[str]
    ) -> None:
        """The panel, with these buttons beside pause and reset, and these fields as colours."""
        begin_panel(gui, name)
        self._status = gui.add_markdown("")
        actions = {"pause": self._toggle_pause, "reset": self._reset, **actions}
        buttons = gui.add_button_group("", tuple(actions))
        buttons.on_click(lambda event: self._todo.put(actions[event.target.value]))
        if fields:
            self._field = gui.add_dropdown("colour", tuple(fields), initial_value=fields[0])
        self._colours = colours = ColourScale(gui)
        if fields:
            self._field.on_update(lambda _: self._todo.put(colours.clear))
        self._sliders: list[Any] = []
        if self._live.actuators:
            with gui.add_folder("Actuators"):
                for k, actuator in enumerate(self._live.actuators):
                    label, step = f"{actuator.name} ({actuator.unit})", (actuator.largest - actuator.least) / 100
                    bounds = actuator.least, actuator.largest, step, 0.0
                    self._sliders.append(self._slider(gui, label, *bounds, partial(self._actuate, k)))
        with gui.add_folder("Energy"):
            self._account = gui.add_markdown("")
            self._plot = EnergyPlot(viser, gui)
        with gui.add_folder("Settings") as self._settings:
            hint = "1 is real time, 0.1 ten times slower"
            self._slider(gui, "speed", MIN_SPEED, 1.0, 0.01, 1.0, self._set_speed, hint)
            dt = 1e3 * self._live.dt
            self._slider(gui, "step (ms)", dt / 10, 10 * dt, dt / 10, dt, self._set_dt, "the time step")

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

    def let_drag(self, mesh: Any, grab: Callable[[Array], bool]) -> None:
        """What a mouse that is pressed on a mesh does: it grabs at a place (3,), m, and gives whether that holds."""

        @mesh.on_drag
        async def _(event: Any) -> None:  # async: viser calls these in order, in one thread
            start, end = (np.array(place) / self.scale for place in (event.start_position, event.end_position))
            if event.phase == "start":
                self._todo.put(lambda: self._grab(event.client_id, grab, start))
            elif event.phase == "update":
                self._todo.put(lambda: self._drag(event.client_id, end - start))
            else:
                self._todo.put(lambda: self._let_go(event.client_id))

    def _grab(self, client: int, grab: Callable[[Array], bool], place: Array) -> None:
        """The last who grabs pulls."""
        if grab(place):
            self._holder, self._grabbed_at = client, self._live.mouse

    def _drag(self, client: int, displacement: Array) -> None:
        if client == self._holder:
            self._live.mouse = self._grabbed_at + displacement

    def _let_go(self, client: int) -> None:
        if client == self._holder:
            self._live.release()
            self._holder = None

    def _toggle_pause(self) -> None:
        self._paused, self._error = not self._paused, ""

    def _reset(self) -> None:
        self._live.reset()
        self._begin()
        for slider in self._sliders:
            slider.value = 0.0

    def _begin(self) -> None:
        """What a start at time 0 needs."""
        self._holder = None
        self._behind, self._error, self._time_since = 0.0, "", 0.0
        self._before = None
        self._colours.clear()
        self._plot.clear()
        self._panel_due = 0.0

    def _set_speed(self, speed: float) -> None:
        self._speed = speed

    def _set_dt(self, milliseconds: float) -> None:
        self._live.dt = milliseconds / 1e3

    def _actuate(self, k: int, value: float) -> None:
        self._live.values[k] = value * self._live.actuators[k].scale

    def run(self, ended: threading.Event) -> None:
        """Steps and draws until it is ended or interrupted; then what is left to do is done."""
        due = self._clock = time.perf_counter()
        try:
            while not ended.is_set():
                self._run_frame()
                if self._audience.is_ready():
                    self._draw_picture()
                    now = time.perf_counter()
                    due = max(due + self._frame, now)
                    ended.wait(due - now)
                else:
                    self._audience.wait(self._frame)
        finally:
            self._end()

    def _run_frame(self) -> None:
        with suppress(queue.Empty):
            while True:
                self._attempt(self._todo.get_nowait())
        now = time.perf_counter()
        passed, self._clock = now - self._clock, now
        if not self._paused:
            self._step(passed)

    def _draw_picture(self) -> None:
        is_new = bool(self.next_picture)
        with self._server.atomic():
            self.next_picture.show()
            self._draw(self._seen())
            self._draw_pull()
            self._update_panel()
        if is_new or self.next_picture:
            self._audience.ask()

    def _seen(self) -> Mapping[str, Array]:
        """All that moves where it is by the clock, which is within the last step: else pictures would show now one
        step more and now one less."""
        now, ahead = self._shapes(), max(-self._behind, 0.0) / self._live.dt
        if self._before is None or not ahead:
            return now
        return {name: shape + ahead * (self._before[name] - shape) for name, shape in now.items()}

    def _note_shapes(self) -> None:
        self._before = self._shapes()

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
        passed = min(passed, 1 / FEWEST_FRAMES_PER_SECOND)
        due = self._speed * passed + self._behind
        self._behind = 0.0
        if not self._attempt(lambda: self._advance(due, STEPPING_SHARE * passed)):
            self._paused = True

    def _advance(self, due: float, patience: float) -> None:
        left = self._live.advance(due, patience, self._note_shapes)
        self._behind = min(left, self._speed * self._frame)
        self._frame = next_frame(self._frame, keeps_up=left <= 0)

    def _draw_pull(self) -> None:
        live = self._live
        if (start := live.held_at) is None:
            self._arrow.hide()
            return
        most = " (most)" if live.pulls_its_most else ""
        self._arrow.draw(start, live.mouse, with_unit(float(np.linalg.norm(live.force)), "N") + most)

    def _update_panel(self) -> None:
        """The words and the plot, a few times a second."""
        now = time.perf_counter()
        if now < self._panel_due:
            return
        live = self._live
        wall, steps, simulated = now - self._panel_since, live.steps - self._steps_since, live.time
        factor = max(simulated - self._time_since, 0.0) / wall
        self._panel_due, self._panel_since = now + PANEL_INTERVAL_SECONDS, now
        self._steps_since, self._time_since = live.steps, simulated
        could = live.steps / live.seconds if live.seconds else 0.0
        lines = [
            f"t = {simulated:.2f} s · {factor:.2f} × real time",
            f"{steps / wall:,.0f} steps/s (could make {could:,.0f})",
            *self._words(),
        ]
        if states := self._states():
            lines.append(f"**{', '.join(states)}**")
        lines += [f"**{self._error}**"] if self._error else []
        lines += [f"*{warning}*" for warning in live.warnings]
        self._status.content = "  \n".join(lines)
        sums = zip(ENERGY_SERIES, live.account, strict=True)
        self._account.content = " · ".join(f"{name} {with_unit(energy, 'J')}" for name, energy in sums)
        self._plot.add(simulated, live.account)


def next_frame(frame: float, *, keeps_up: bool) -> float:
    """How long the next picture stays, s, after one that stayed so long: longer where steps do not keep up."""
    longer = frame / PACE if keeps_up else frame * PACE
    return min(max(longer, 1 / FRAMES_PER_SECOND), 1 / FEWEST_FRAMES_PER_SECOND)
