"""Bodies, forces and energies on Matplotlib axes that the caller arranges. Needs no screen."""

from typing import Any

import numpy as np
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from numpy import ndarray as Array


def draw_body(axes: Any, nodes: Array, triangles: Array, displacement: Array, *, largest: float) -> Any:
    """Draws the surface as displaced, (N, 3), m, to scale, and returns the collection, to hang a colour bar on.

    Colours show the length of the displacement, the brightest `largest`, m.
    """
    moved = nodes + displacement
    length = np.linalg.norm(displacement, axis=1)[triangles].mean(axis=1)
    surface = Poly3DCollection(moved[triangles], cmap="viridis", edgecolor="black", linewidth=0.2)
    surface.set_array(length)
    surface.set_clim(0, largest)
    surface.set_clip_on(False)  # the square that Matplotlib gives three dimensions is mostly air
    axes.add_collection3d(surface)
    low, high = nodes.min(axis=0), nodes.max(axis=0)
    margin = 0.1 * (high - low).max()
    limits = np.stack([low - margin, high + margin], axis=1)
    axes.set(xlim=limits[0], ylim=limits[1], zlim=limits[2])
    axes.set_box_aspect(limits[:, 1] - limits[:, 0], zoom=1.6)
    axes.set_axis_off()
    return surface


def draw_force(axes: Any, point: Array, force: Array, length: float) -> None:
    """Draws a force as an arrow that ends at a point, `length` m long."""
    arrow = length * np.asarray(force) / np.linalg.norm(force)
    drawn = axes.quiver(*(np.asarray(point) - arrow), *arrow, color="crimson", linewidth=1.5, arrow_length_ratio=0.3)
    drawn.set_clip_on(False)


def draw_energy_over_work(axes: Any, times: Array, energy: Array, work: Array, label: str, style: str = "-") -> None:
    """Draws stored energy, (S,), J, as a share of the most work put in so far; a passive model stays below 1.

    `work` (S,), J, is the running sum of that of the inputs.
    """
    most = np.maximum.accumulate(work)
    begun = most > 0
    axes.semilogy(times[begun], energy[begun] / most[begun], linestyle=style, label=label, linewidth=1.5)
    axes.set(xlabel="time (s)", ylabel="stored energy / most work put in")
