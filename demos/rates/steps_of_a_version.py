"""One version of the package reduces a scene, or reads its model, and steps it in short turns: see beside_commit.py.

It runs with every version that is compared, so that it names only what all of them have. What it is told is JSON, its
one argument. It answers with the order of its model, and every line of its input with the seconds that a turn took.
"""

import json
import sys
import time
import warnings
from copy import copy
from pathlib import Path
from typing import Any

import numpy as np

import fenics_rom as fr
from fenics_rom.errors import FenicsRomError
from fenics_rom.world.records import RigidBody, SoftBody
from fenics_rom.world.shapes import Box
from fenics_rom.world.world import World

Array = np.ndarray


class Turns:
    """A body, or a batch, that begins every turn where it has settled, under the same inputs (.., p), one a step."""

    def __init__(self, body: Any, inputs: Array, settle: int):
        for u in inputs[:settle]:
            body.step(u)
        self.body, self.inputs, self.is_batch = body, list(inputs[settle:]), isinstance(body, fr.Batch)
        self.start = copy(body) if self.is_batch else body.save()

    def begin(self) -> None:
        """Goes back to where it has settled."""
        if self.is_batch:
            self.body = copy(self.start)
        else:
            self.body.restore(self.start)

    def path(self) -> Array:
        """Displacements (steps, nodes, 3) on the way, of the body, or of the first of the batch, m."""
        self.begin()
        shapes = []
        for u in self.inputs:
            self.body.step(u)
            shapes.append(self.body.shape(0) if self.is_batch else self.body.displacement())
        return np.array(shapes)

    def seconds(self) -> float:
        """Processor time of a turn, with the energy account that a single body keeps."""
        self.begin()
        started = time.process_time()
        for u in self.inputs:
            self.body.step(u)
        if not self.is_batch:
            self.body.ledger.supplied  # noqa: B018, it is booked by this
        return time.process_time() - started


class Rollouts(Turns):
    """The same, all steps of a turn at once."""

    def seconds(self) -> float:
        """As in Turns."""
        self.begin()
        started = time.process_time()
        self.body.rollout(np.array(self.inputs))
        self.body.ledger.supplied  # noqa: B018
        return time.process_time() - started


class Holding:
    """Two fingers that hold a box between them, without weight; a turn goes on from the one before."""

    def __init__(self, rom: Any, dt: float, settle: int, steps: int, tension: float):
        edge, aside, height = 0.03, 0.0251, 0.108  # m: of the box, and where the fingers' roots are
        bodies: dict[str, Any] = {"box": RigidBody(Box((edge,) * 3), density=400.0, position=(0, 0, edge / 2))}
        hanging = {"left": (0.0, 0.5**0.5, 0.0, -(0.5**0.5)), "right": (0.5**0.5, 0.0, 0.5**0.5, 0.0)}
        for (name, turned), sign in zip(hanging.items(), (-1.0, 1.0), strict=True):
            bodies[name] = SoftBody(rom, position=(sign * aside, 0, height), rotation=turned)
        self.world, self.steps = World(bodies, dt, friction=0.8, apart=[["left", "right"]]), steps
        self.pull = {name: {"flexor": [tension]} for name in ("left", "right")}
        for _ in range(settle):
            self.world.step(self.pull)

    def path(self) -> Array:
        """Where the box is on the way, m."""
        places = []
        for _ in range(self.steps):
            self.world.step(self.pull)
            places.append(self.world.pose("box").position)
        return np.array(places)

    def seconds(self) -> float:
        """Processor time of a turn."""
        started = time.process_time()
        for _ in range(self.steps):
            self.world.step(self.pull)
        return time.process_time() - started


def pushed(rom: Any, dt: float, settle: int, steps: int, largest: float, at_once: bool) -> Turns:
    """A body that is pushed at random, up to the largest, N; a rollout, where steps are taken at once."""
    body = fr.Simulator(rom, dt)
    pushes = np.random.default_rng(0).uniform(-largest, largest, (settle + steps, body.inputs))
    return (Rollouts if at_once else Turns)(body, pushes, settle)


def moving(rom: Any, dt: float, settle: int, steps: int, spin: list[float] | None) -> Turns:
    """A body that its base moves, or that flies and begins to turn, rad/s."""
    body = fr.Simulator(rom, dt)
    if spin is not None:
        body.place(body.pose._replace(angular_velocity=np.array(spin)))
    return Turns(body, np.zeros((settle + steps, body.inputs)), settle)


def pad(rom: Any, dt: float, settle: int, steps: int) -> Turns:
    """A pad under the loads of its scene."""
    return Turns(fr.Simulator(rom, dt), np.empty((settle + steps, 0)), settle)


def pad_under_random_loads(rom: Any, dt: float, settle: int, steps: int, loads: dict[str, Any]) -> Turns:
    """The same, then under loads that are others in every step: of each their mean (3) and amplitude (3), N."""
    turns, drawn = pad(rom, dt, settle, steps), np.random.default_rng(0).uniform(-1, 1, (settle + steps + 1, 3))
    for name, (mean, amplitude) in loads.items():
        values = mean + amplitude * drawn
        turns.body.set_signal(name, lambda t, values=values: values[round(t / dt)])
    return turns


def batch(rom: Any, dt: float, settle: int, steps: int, size: int, every: int, largest: float) -> Turns:
    """Bodies that are each pushed at random, up to the largest, N, anew every so many steps."""
    bodies = fr.Batch(rom, size, dt)
    pushes = np.random.default_rng(0).uniform(-largest, largest, (settle + steps, size, bodies.inputs))
    return Turns(bodies, pushes[::every].repeat(every, axis=0)[: settle + steps], settle)


def pulled(rom: Any, dt: float, settle: int, steps: int, pulls: dict[str, float], push: float) -> Turns:
    """A body that bends far: pulls that come and go, by actuator, and pushes at random that are held for 20 steps."""
    body, times = fr.Simulator(rom, dt, stepper="linearly-implicit"), np.arange(settle + steps)[:, None] * dt
    largest = np.array([pulls[name] for name in rom.actuators])
    pushes = push * np.random.default_rng(0).standard_normal((len(times), body.inputs - len(largest)))
    inputs = pushes[::20].repeat(20, axis=0)[: len(times)], largest * np.sin(1.1 * np.pi * times) ** 2
    return Turns(body, np.hstack(inputs), settle)


DRIVES = {drive.__name__: drive for drive in (pad, pad_under_random_loads, batch, pulled, pushed, moving, Holding)}


def model(scene: str, file: Path, order: int, own: int | None) -> Any:
    """Read from the file if there is one, this version can read it, and is not to make its own; else reduced here."""
    if file.exists() and own is None:
        try:
            return fr.read_rom(file)
        except FenicsRomError as problem:
            print(f"it reduces the scene itself, as {problem}", file=sys.stderr)
    rom = fr.reduce(fr.assemble(fr.read_scene(scene)), order=own or order)
    if not file.exists():
        fr.write_rom(file, rom)
    return rom


def main() -> None:
    """See above."""
    told = json.loads(sys.argv[1])
    warnings.simplefilter("ignore")  # an older version warns of other things
    assert Path(fr.__file__).is_relative_to(told["package"]), fr.__file__
    rom = model(told["scene"], Path(told["rom"]), told["order"], told["own"])
    turns = DRIVES[told["drive"]](rom, **told["given"])
    np.save(told["path"], turns.path())
    print(max(contact.inputs.shape[0] for contact in rom.contact_models.values()), flush=True)
    for _ in sys.stdin:
        print(turns.seconds(), flush=True)


if __name__ == "__main__":
    main()
