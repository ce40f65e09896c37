"""A soft body hangs under a plate, which presses it onto another one and then drags it aside: squeeze and ironing."""

import time
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from numpy import ndarray as Array

import fenics_rom as fr
from fenics_rom.world.shapes import Box

Vector = tuple[float, float, float]
STEP, PLATE = 1e-3, 4e-3  # s, m: thickness of the plate


@dataclass(frozen=True)
class Way:
    """The way of the plate: down, then aside, smoothly."""

    size: Vector  # of the upper body, m
    begins: Vector  # where its corner is then, m
    pressed: float  # m
    down: float  # s, until it is pressed
    speed: float  # m/s aside
    rise: float  # s, until it has that speed

    def __call__(self, time: float) -> fr.BaseState:
        """Where the plate is."""
        s, aside = min(time / self.down, 1.0), max(0.0, time - self.down)
        down, sinking = self.pressed * s * s * (3 - 2 * s), self.pressed * 6 * s * (1 - s) / self.down
        gone = self.speed * (aside**2 / (2 * self.rise) if aside < self.rise else aside - self.rise / 2)
        place = np.array(self.begins) + np.array(self.size) * [0.5, 0.5, 1.0] + [gone, 0.0, PLATE / 2 - down]
        velocity = np.array([self.speed * min(aside / self.rise, 1.0), 0.0, -sinking])
        return fr.BaseState(place, np.array([1.0, 0, 0, 0]), velocity, np.zeros(3))


class Dragged(NamedTuple):
    """Two bodies, "low" and "upper", at the end of the way."""

    roms: list[fr.Rom]  # of both
    world: fr.World
    force: Array  # on the lower one after each step (n, 3), N
    balance: float  # what the energy account misses, of what was supplied
    rate: float  # steps per second of processor time

    @property
    def name(self) -> str:
        """Their orders."""
        return " and ".join(dict.fromkeys(str(rom.contact_models["face"].order) for rom in self.roms))


def drag(roms: list[fr.Rom], way: Way, friction: float, steps: int) -> Dragged:
    """Presses the second body onto the first, and drags it, for some steps."""
    low, upper = roms
    bodies = {
        "plate": fr.RigidBody(Box((*way.size[:2], PLATE)), motion=way),
        "low": fr.SoftBody(low),
        "upper": fr.SoftBody(upper, on="plate", position=tuple(-way(0.0).position)),
    }
    world = fr.World(bodies, STEP, friction=friction, apart=[["plate", "low"]])
    world.step()  # compiles what steps need
    begun, force = time.process_time(), np.zeros((steps, 3))
    for step in range(steps):
        world.step()
        force[step] = world.force_between("low", "upper")
    rate, gone = steps / (time.process_time() - begun), world.ledger
    left = world.energy - gone.supplied + gone.dissipated + gone.numerical + gone.lost_in_switching
    return Dragged(roms, world, force, abs(left) / gone.supplied, rate)


def off(found: Array, expected: Array) -> float:
    """Relative error in the 2-norm."""
    return float(np.linalg.norm(found - expected) / np.linalg.norm(expected))


def draw_front(axes: Axes, dragged: Dragged) -> None:
    """Both bodies from the side, at the end."""
    for rom, name, colour in zip(dragged.roms, ("low", "upper"), ("#9ecae1", "#fdae6b"), strict=True):
        front = np.isclose(rom.nodes[rom.triangles, 1], rom.nodes[:, 1].min()).all(axis=1)
        corners = 1e3 * dragged.world.simulator(name).node_places()[rom.triangles[front]][..., [0, 2]]
        axes.add_collection(PolyCollection(corners, facecolor=colour, edgecolor="#444444", linewidth=0.4, alpha=0.8))
    axes.autoscale_view()
    axes.set(title="from the front, at the end", xlabel="x (mm)", ylabel="z (mm)", aspect="equal")
