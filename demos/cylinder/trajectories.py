"""What cylinder.py runs: the cylinder at full order and reduced, step by step, their errors, and their rates."""

import statistics
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path

import gmsh
import numpy as np

import fenics_rom as fr
from fenics_rom.fem.linear_stepper import FullOrderStepper
from fenics_rom.mechanics.load_history import LoadHistory
from fenics_rom.rom.rom import Rom
from fenics_rom.scene.scene import Scene

Array = np.ndarray

GEOMETRY = Path(__file__).parents[2] / "meshes" / "cylinder.geo"
MARKERS = "markers"
EVERY = 10  # steps from one kept shape to the next
ALL_AFTER = 200  # steps of which every shape is kept after the contact has moved: most of the error is in the first few


@dataclass(frozen=True)
class Instants:
    """The steps after which whole shapes are kept.

    Attributes:
        steps: (S,), counted from 1.
        share: (S,) how many steps each stands for.
    """

    steps: Array
    share: Array

    def of(self, step: int) -> int:
        """Place of a step among those that are kept."""
        place = int(np.searchsorted(self.steps, step))
        assert self.steps[place] == step
        return place


@dataclass(frozen=True)
class Trajectory:
    """A run of the scene.

    Attributes:
        markers: displacement of the markers at the start and after every step, (steps + 1, markers, 3), m.
        snapshots: displacement at the kept instants, (n, S), m.
        warnings: what the simulator had to say.
        balance_error: gap of the energy account at the end, as a share of the work put in; 0 where none was kept.
    """

    markers: Array
    snapshots: Array
    warnings: tuple[str, ...] = ()
    balance_error: float = 0.0


def write_mesh(file: Path, factor: float) -> None:
    """Writes a mesh of the cylinder of another size factor than meshes/cylinder.msh."""
    gmsh.initialize([], readConfigFiles=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.open(str(GEOMETRY))
        gmsh.option.setNumber("Mesh.MeshSizeFactor", factor)
        gmsh.model.mesh.generate(3)
        gmsh.write(str(file))
    finally:
        gmsh.finalize()


def history(scene: Scene) -> list[tuple[str, Array]]:
    """Contact mode and force (3,) N of each step."""
    return list(LoadHistory(scene.environment, dict.fromkeys(scene.contacts, 3), {}))


def instants(scene: Scene) -> Instants:
    """Every tenth step, and each of the first ones after the contact has moved."""
    contacts = [contact for contact, _ in history(scene)]
    moved = np.array([k for k in range(1, len(contacts)) if contacts[k] != contacts[k - 1]], dtype=int)
    dense = np.unique((moved[:, None] + np.arange(1, ALL_AFTER + 1)).ravel())
    steps = np.union1d(np.arange(EVERY, len(contacts) + 1, EVERY), dense[dense <= len(contacts)])
    return Instants(steps, np.where(np.isin(steps, dense), 1, EVERY))


def at_full_order(system: fr.System, scene: Scene, kept: Instants) -> Trajectory:
    """The full order, without an energy account: one solve and two products a step."""
    assert scene.run is not None
    body = FullOrderStepper(system, scene.run.dt, ledger=False)
    columns = {name: system.input_matrix(name) for name in system.contacts}
    markers, shapes, wanted = [body.displacement(MARKERS)], [], set(kept.steps.tolist())
    for step, (contact, u) in enumerate(history(scene), start=1):
        body.step_under(columns[contact] @ u)
        markers.append(body.displacement(MARKERS))
        if step in wanted:
            shapes.append(body.x[:, 0].copy())
    body.close()
    return Trajectory(np.array(markers), np.stack(shapes, axis=1))


def reduced(rom: Rom, scene: Scene, kept: Instants) -> Trajectory:
    """A reduced model."""
    assert scene.run is not None
    body = fr.Simulator(rom, scene.run.dt)
    bases = {name: rom.basis @ mode.coordinates for name, mode in rom.contact_models.items()}
    markers, coordinates, wanted = [body.displacement(MARKERS)], [], set(kept.steps.tolist())
    for step, (contact, u) in enumerate(history(scene), start=1):
        body.switch(contact)
        body.step(u)
        markers.append(body.displacement(MARKERS))
        if step in wanted:
            coordinates.append((contact, body.state[0]))
    shapes = np.empty((len(rom.basis), len(coordinates)))
    for name, basis in bases.items():
        there = [k for k, (contact, _) in enumerate(coordinates) if contact == name]
        shapes[:, there] = basis @ np.array([coordinates[k][1] for k in there]).reshape(-1, basis.shape[1]).T
    account = body.ledger
    assert account is not None
    gap = body.energy - account.supplied + account.dissipated + account.lost_in_switching
    return Trajectory(np.array(markers), shapes, body.warnings, abs(gap) / account.supplied)


def gaps(system: fr.System, run: Trajectory, full: Trajectory) -> tuple[Array, Array]:
    """Of the whole shape, in the mass norm, and the size of the reference: (S,) each, kg^1/2 m."""
    found = []
    for X in (run.snapshots - full.snapshots, full.snapshots):
        found.append(np.sqrt(np.einsum("ns,ns->s", X, system.mass @ X)))
    return found[0], found[1]


def relative(gap: Array, size: Array, kept: Instants) -> float:
    """Relative L² error in time of what `gaps` gives."""
    return float(np.sqrt(kept.share @ gap**2 / (kept.share @ size**2)))


def marker_errors(run: Trajectory, full: Trajectory) -> tuple[Array, Array]:
    """RMS over time, and largest, of how far each marker is off, (markers,) cm."""
    off = 100 * np.linalg.norm(run.markers - full.markers, axis=2)
    return np.sqrt(np.mean(off**2, axis=0)), off.max(axis=0)


def on_nodes(system: fr.System, x: Array) -> Array:
    """Displacement of all nodes (N, 3) from that of the free ones (n,), m."""
    field = np.zeros(system.body.nodes.size)
    field[system.body.free] = x
    return field.reshape(-1, 3)


def rates(loops: Mapping[str, Callable[[], int]], rounds: int) -> dict[str, float]:
    """Steps per second, the median of some rounds in which the loops take turns, after one that is not counted.

    Args:
        loops: each returns how many steps it has taken.
        rounds: how many.
    """
    found: dict[str, list[float]] = {name: [] for name in loops}
    for _ in range(rounds + 1):
        for name, loop in loops.items():
            start = time.perf_counter()
            steps = loop()
            found[name].append(steps / (time.perf_counter() - start))
    return {name: statistics.median(each[1:]) for name, each in found.items()}


def full_steps(system: fr.System, scene: Scene, steps: int) -> Callable[[], int]:
    """A loop over steps of the full order around the middle of the scene, without an energy account."""
    assert scene.run is not None
    body = FullOrderStepper(system, scene.run.dt, ledger=False)
    parts = by_contact(middle(history(scene), steps))
    columns = {name: system.input_matrix(name) for name in parts}

    def loop() -> int:
        for contact, forces in parts.items():
            for u in forces:
                body.step_under(columns[contact] @ u)
        return steps

    return loop


def reduced_steps(rom: Rom, scene: Scene, steps: int) -> Callable[[], int]:
    """A loop over as many steps of a reduced model."""
    assert scene.run is not None
    body = fr.Simulator(rom, scene.run.dt, ledger=False)
    parts = by_contact(middle(history(scene), steps))

    def loop() -> int:
        for contact, forces in parts.items():
            body.switch(contact)
            for u in forces:
                body.step(u)
        return steps

    return loop


def reduced_rollout(rom: Rom, scene: Scene, times: int) -> Callable[[], int]:
    """A loop over rollouts of the scene, one for each contact mode; the markers are read after every step."""
    assert scene.run is not None
    body, whole = fr.Simulator(rom, scene.run.dt, ledger=False), history(scene)
    parts = {contact: np.array(forces) for contact, forces in by_contact(whole).items()}

    def loop() -> int:
        for _ in range(times):
            for contact, forces in parts.items():
                body.rollout(forces, contact=contact, outputs=[MARKERS])
        return times * len(whole)

    return loop


def by_contact(whole: list[tuple[str, Array]]) -> dict[str, list[Array]]:
    """The forces of each contact mode, of a history in which the contact moves on and does not come back."""
    return {contact: [u for _, u in part] for contact, part in groupby(whole, lambda step: step[0])}


def middle(whole: list[tuple[str, Array]], steps: int) -> list[tuple[str, Array]]:
    """That many steps around the middle of a history."""
    first = max(0, (len(whole) - steps) // 2)
    return whole[first : first + steps]


def with_run(scene: Scene, **changed: object) -> Scene:
    """The scene with something else in its [run]."""
    assert scene.run is not None
    return replace(scene, run=replace(scene.run, **changed))  # type: ignore[arg-type]
