"""Widgets that both pages have: the colour scale, and the plot of the energy account."""

from collections import deque
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.io.units import prefixed
from fenics_rom.visualization.viewer.colours import bar_colours, round_up, with_unit

ENERGY_SERIES = {
    "stored": "#1f77b4",
    "supplied": "#2ca02c",
    "dissipated": "#d62728",
    "lost in switching": "#9467bd",
    "numerical": "#7f7f7f",
}
MAX_SAMPLES = 200  # in the plot


def begin_panel(gui: Any, name: str) -> None:
    """Puts the panel beside the picture; no button that would share it with the world."""
    gui.configure_theme(show_logo=False, show_share_button=False)
    gui.set_panel_label(f"fenics_rom · {name}")
    gui.main_panel.dock_right()


class ColourScale:
    """The colour bar, whose end grows with what is shown, in round steps."""

    def __init__(self, gui: Any):
        self._bar = gui.add_html("")
        self._shown: tuple[float, str] | None = None
        self.largest = 0.0

    def clear(self) -> None:
        """Begins anew."""
        self.largest = 0.0

    def cover(self, largest: float, unit: str) -> float:
        """Takes a value in, and returns the end of the scale."""
        self.largest = max(self.largest, round_up(largest))
        if self._shown != (self.largest, unit):
            self._shown = self.largest, unit
            stops = ", ".join("rgb({}, {}, {})".format(*colour) for colour in bar_colours())
            end = with_unit(self.largest, unit) if self.largest else f"0 {unit}"
            self._bar.content = (
                '<div style="margin: 0 1em 0.6em; height: 0.8em; '
                f'background: linear-gradient(to right, {stops})"></div>'
                '<div style="margin: -0.4em 1em 0.6em; font-size: 0.8em; '
                'display: flex; justify-content: space-between">'
                f"<span>0</span><span>{end}</span></div>"
            )
        return self.largest


class EnergyPlot:
    """Stored, supplied, dissipated and lost energy over the time of the run."""

    def __init__(self, viser: Any, gui: Any):
        self._rows: deque[tuple[float, ...]] = deque(maxlen=MAX_SAMPLES)
        self._unit = ""
        lines = (viser.uplot.Series(label=name, stroke=colour, width=2) for name, colour in ENERGY_SERIES.items())
        self._plot = gui.add_uplot(
            data=tuple(np.zeros(1) for _ in range(len(ENERGY_SERIES) + 1)),
            series=(viser.uplot.Series(label="t (s)"), *lines),
            scales={"x": viser.uplot.Scale(time=False, auto=True), "y": viser.uplot.Scale(auto=True)},
            axes=(viser.uplot.Axis(label="t (s)"), viser.uplot.Axis(size=50)),
            legend=viser.uplot.Legend(show=False),
            aspect=1.6,
        )
        # Another axis would be another chart, so the unit stands below it.
        self._legend = gui.add_html("")

    def clear(self) -> None:
        """Takes all samples away."""
        self._rows.clear()

    def add(self, time: float, energies: tuple[float, ...]) -> None:
        """Adds a sample: s, and J in the order of ENERGY_SERIES; one at an earlier time begins anew."""
        if self._rows and time < self._rows[-1][0]:
            self._rows.clear()
        self._rows.append((time, *energies))
        self._draw(np.array(self._rows))

    def show(self, times: Array, energies: Array) -> None:
        """Shows a whole run: (S,), s, and (5, S), J."""
        every = max(1, len(times) // MAX_SAMPLES)
        self._draw(np.column_stack([times, energies.T])[::every])

    def _draw(self, rows: Array) -> None:
        factor, unit = prefixed("J", float(np.abs(rows[:, 1:]).max(initial=0.0)))
        if unit != self._unit:
            self._unit = unit
            names = " · ".join(f'<span style="color: {colour}">{name}</span>' for name, colour in ENERGY_SERIES.items())
            self._legend.content = f'<div style="margin: 0 1em; font-size: 0.75em">{unit}: {names}</div>'
        self._plot.data = (rows[:, 0].copy(), *(factor * rows[:, 1:].T))
