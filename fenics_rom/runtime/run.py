"""The reduced run of a load history."""

import time
import warnings
from collections.abc import Callable
from itertools import islice

from fenics_rom.errors import FenicsRomWarning, SceneError
from fenics_rom.linear_limit import summary
from fenics_rom.load_history import LoadHistory
from fenics_rom.record import Record, Recorder
from fenics_rom.rom import Rom
from fenics_rom.runtime.simulator import Simulator
from fenics_rom.scene import Scene
from fenics_rom.scene_file import parse_scene

Report = Callable[[str, int, int], None]


def simulate(
    rom: Rom,
    *,
    scene: Scene | None = None,
    dt: float | None = None,
    report: Report = lambda stage, done, of: None,
) -> Record:
    """Runs a ROM through a load history from rest.

    Args:
        rom: the reduced model.
        scene: whose run to take instead of that of the scene in the ROM; only its loads and outputs' names count.
        dt: time step instead of the scene's, s.
        report: called with the stage, how much of it is done, and of how much.

    Raises:
        SceneError: there is no load history, or it does not fit the ROM.
    """
    if len(rom.nodes) == 0:
        raise SceneError(f"ROM {rom.name!r} has no mesh, so no scene goes with it; step it with Simulator")
    if scene is None:
        scene = parse_scene(rom.scene_text, tables=rom.tables, source=f"scene of ROM {rom.name!r}")
    history = LoadHistory(scene, rom.contacts, rom.actuators, dt)
    simulator = Simulator(rom, history.dt)
    simulator.switch(history.first_contact())
    points = {name: len(rows) // 3 for name, rows in rom.outputs.items()}
    shapes = scene.run.shapes if scene.run else 1
    recorder = Recorder(history.steps, history.dt, points, tuple(rom.modes), len(rom.nodes), shapes)

    def sample(step: int) -> None:
        assert simulator.ledger is not None
        recorder.sample(step, simulator.contact, simulator.energy, simulator.ledger, simulator.displacement)

    sample(0)
    for step, (contact, u) in enumerate(history, start=1):
        simulator.switch(contact)
        simulator.step(u)
        sample(step)
        report("steps", step, history.steps)
    return recorder.record(
        name=rom.name,
        model="reduced",
        settings={
            "dt": history.dt,
            "seconds": _seconds(rom, history),
            "order": max(mode.order for mode in rom.modes.values()),
        },
        nodes=rom.nodes,
        triangles=rom.triangles,
        node_mass=rom.node_mass,
        warnings=(*rom.warnings, *filter(None, [summary(simulator.excursion)])),
    )


def _seconds(rom: Rom, history: LoadHistory) -> float:
    """Wall clock of the steps alone, s, with the account kept; in a second run, as reading it after each costs more."""
    simulator, seconds, inputs = Simulator(rom, history.dt), 0.0, iter(history)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FenicsRomWarning)  # it was said
        while some := list(islice(inputs, 1000)):
            start = time.perf_counter()
            for contact, u in some:
                simulator.switch(contact)
                simulator.step(u)
            assert simulator.ledger is not None
            simulator.ledger.supplied  # noqa: B018, it is booked by this
            seconds += time.perf_counter() - start
    return seconds
