"""The full-order run of a scene, and what watches whether its model can follow."""

import time
import warnings
from collections.abc import Iterator, Mapping

from numpy import ndarray as Array

from fenics_rom.errors import FenicsRomWarning, SceneError
from fenics_rom.fem.assemble import assemble
from fenics_rom.fem.finite_strain.arc_length import ArcLength
from fenics_rom.fem.finite_strain.stepper import FiniteStrainStepper
from fenics_rom.fem.simulator import FullOrderSimulator
from fenics_rom.io.progress import Report, silent
from fenics_rom.mechanics.environment import Environment
from fenics_rom.mechanics.linearity import SurfaceGauges, SurfaceStrainPeak, measure_peaks
from fenics_rom.mechanics.load_history import LoadHistory
from fenics_rom.mechanics.signals import SignalLike
from fenics_rom.mechanics.slack import SlackWatch
from fenics_rom.scene.scene import Scene
from fenics_rom.system.system import System
from fenics_rom.trajectory.trajectory import Trajectory, TrajectoryRecorder

MONITOR_INTERVAL = 10  # steps; a look at the surface costs less than one


def simulate(
    scene: Scene | System,
    *,
    dt: float | None = None,
    every: int | None = None,
    signals: Mapping[str, SignalLike] | None = None,
    arc_length: bool = False,
    report: Report = silent,
) -> Trajectory:
    """Runs the full-order model through the load history from rest; every rank must call it.

    This is `fenics_rom.simulate` of a scene or a system, where arguments and errors are.
    """
    system = assemble(scene) if isinstance(scene, Scene) else scene
    environment, history = _run_of(system, dt, every)
    assert environment.run is not None
    if arc_length:
        check_arc_length(environment)
    body = FullOrderSimulator(system, history.dt, environment, signals)
    recorder = TrajectoryRecorder(
        system, environment, history.steps, history.dt, snapshots=environment.run.snapshots, every=history.every
    )
    body.switch(history.first_contact())
    lost = body.begin(environment.run.initial, history) if environment.run.initial else []
    path = ArcLength(1 / history.steps, report) if arc_length else None
    steps = _steps(body, history) if path is None else _steps_along(body, history, path)
    recorder.sample(0, body)
    monitor: SurfaceMonitor | InversionMonitor = SurfaceMonitor(system)
    if isinstance(body.stepper, FiniteStrainStepper):
        monitor, body.stepper.report = InversionMonitor(body.stepper), report
    slack = None if system.embedded is None else SlackWatch(system.embedded.pushes)
    seconds = 0.0
    for step, (u, spent) in enumerate(steps, start=1):
        seconds += spent
        if step % MONITOR_INTERVAL == 0:
            monitor.look(body.stepper.shape, body.time)
        if slack is not None and (step % MONITOR_INTERVAL == 0 or step == history.steps):
            slack.look(body.stepper.shape, body.time)
        if body.stepper.interface is not None:
            body.stepper.interface.look(step, body.time, body.displacement(), last=step == history.steps)
        recorder.sample(step, body, u)
        report("steps", step, history.steps)
    body.close()
    assert system.scene is not None
    return recorder.record(
        name=system.scene.name,
        model="full",
        settings={"dt": history.dt, "seconds": seconds, "order": system.size},
        tendons=system.scene.environment.tendons,
        warnings=(
            *system.warnings,
            *lost,
            *history.warnings,
            *filter(None, [monitor.summary]),
            *([] if slack is None else slack.messages()),
            *body.stepper.diagnostics(),
            *([] if path is None else path.diagnostics),
        ),
        stepping="" if path is None else "arc-length: it was asked for",
    )


def check_arc_length(environment: Environment) -> None:
    """A SceneError where a scene has no equilibrium path that loads could be put on along."""
    effects, run = environment.effects, environment.run
    wrong = {
        "no effects.large_deformation, without which a path is straight": "large_deformation" not in effects,
        "effects.inertia, so that it moves": environment.has_inertia,
        "effects.contact, which makes paths with kinks": environment.contact_law is not None,
        "actuators by stroke, tendons that rub or rigid surfaces, whose forces are found": environment.finds_forces,
        "no run.load that could grow": run is None or not run.loads,
    }
    has = next((what for what, is_so in wrong.items() if is_so), None)
    if has:
        raise SceneError(
            f"{environment.source}: arc_length: the scene has {has}; use equilibria of a body that deforms "
            "largely, under forces of [[run.load]] and what is always there"
        )


def plain_rate(system: System, dt: float, seconds: float = 0.02, windows: int = 25) -> float:
    """Steps per second of the scene's load history without the energy account; every rank must call it.

    The fastest of some `windows`, each of `seconds` by the clock: whatever else a machine does can only slow it down.
    """
    environment, history = _run_of(system, dt)
    body = FullOrderSimulator(system, history.dt, environment, ledger=False)
    rates = []
    spent, taken = 0.0, 0
    for step, (_, last) in enumerate(_steps(body, history)):
        if step == 0:  # it has the factorisation in it
            continue
        spent, taken = spent + float(system.algebra.maximum(last)), taken + 1
        if spent >= seconds or step == history.steps - 1:
            rates.append(taken / spent)
            spent, taken = 0.0, 0
        if len(rates) == windows:
            break
    body.close()
    return max(rates, default=0.0)


class SurfaceMonitor:
    """Watches whether the surface turns or strains more than a linear model can follow."""

    def __init__(self, system: System):
        self._gauges, self._peak = SurfaceGauges(system.body.nodes, system.body.triangles), SurfaceStrainPeak()

    def look(self, displacement: Array, time: float) -> None:
        """Notes displacements of all nodes (N, 3), m, at a time, s, and warns at the first that is too much."""
        now = SurfaceStrainPeak(*measure_peaks(self._gauges.components(displacement)), time)
        if now.beyond and not self._peak.beyond:
            warnings.warn(now.warning, FenicsRomWarning, stacklevel=3)
        self._peak = self._peak.joined(now)

    @property
    def summary(self) -> str:
        """What to say of the run; empty where there is nothing to say."""
        return self._peak.summary


class InversionMonitor:
    """Watches whether points of a body that deforms largely are turned inside out."""

    def __init__(self, stepper: FiniteStrainStepper):
        self._stepper, self._most, self._first = stepper, 0, 0.0

    def look(self, displacement: Array, time: float) -> None:
        """As in SurfaceMonitor."""
        count = self._stepper.inverted
        first = count > 0 and self._most == 0
        self._most = max(self._most, count)
        if first:
            self._first = time
            warnings.warn(self.summary, FenicsRomWarning, stacklevel=3)

    @property
    def summary(self) -> str:
        """As in SurfaceMonitor."""
        if not self._most:
            return ""
        return (
            f"up to {self._most} points of the body were turned inside out, from t = {self._first:.4g} s on: shapes "
            "and forces there are not to be trusted; a finer mesh or a smaller load may help"
        )


def _run_of(system: System, dt: float | None, every: int | None = None) -> tuple[Environment, LoadHistory]:
    """What acts in the scene of a system, and the inputs of every step."""
    environment = system.scene.environment if system.scene else Environment(source="a system of matrices")
    contacts, actuators = (
        {name: B.shape[1] for name, B in blocks.items()} for blocks in (system.contacts, system.actuators)
    )
    return environment, LoadHistory(environment, contacts, actuators, dt, every)


def _steps_along(body: FullOrderSimulator, history: LoadHistory, path: ArcLength) -> Iterator[tuple[Array, float]]:
    """Takes steps along the path of the loads at the end of a history; inputs and wall clock, s, of each.

    A path that ends sooner than the history is stayed at the end of.
    """
    contact, u = history.at((history.steps - 0.5) * history.dt, history.first_contact())
    body.switch(contact)
    for _ in range(history.steps):
        start = time.perf_counter()
        if not path.is_complete:
            body.step_along(path, u, history.steps * history.dt)
        yield path.factor * u, time.perf_counter() - start


def _steps(body: FullOrderSimulator, history: LoadHistory) -> Iterator[tuple[Array, float]]:
    """Takes the steps of a load history; input and wall clock, s, of each."""
    for contact, u in history:
        start = time.perf_counter()
        if not history.automatic:
            body.switch(contact)
        body.step(u)
        yield u, time.perf_counter() - start
