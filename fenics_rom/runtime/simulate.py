"""The reduced run of a load history."""

import time
import warnings
from collections.abc import Callable, Container, Iterator, Mapping
from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.arguments import check_flag, mapping_in
from fenics_rom.errors import FenicsRomWarning, SceneError
from fenics_rom.io.progress import Report, silent
from fenics_rom.mechanics.environment import Environment, HasEnvironment, given_environment
from fenics_rom.mechanics.load_history import LoadHistory
from fenics_rom.mechanics.signals import SignalLike
from fenics_rom.mechanics.time_step_monitor import TimeStepMonitor
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.error_tolerance import ADDED
from fenics_rom.runtime.exceedings import Enriches, Exceedings
from fenics_rom.runtime.initial_state import begin
from fenics_rom.runtime.simulator import Simulator
from fenics_rom.runtime.steppers.contact_interface import CONTACT, MOTION
from fenics_rom.runtime.steppers.midpoint import PAGES
from fenics_rom.trajectory.error_series import PREFIX
from fenics_rom.trajectory.trajectory import Trajectory, TrajectoryRecorder

UNTIMED = "what is no part of a step"


def simulate(
    rom: Rom,
    *,
    scene: HasEnvironment | None = None,
    dt: float | None = None,
    every: int | None = None,
    signals: Mapping[str, SignalLike] | None = None,
    profile: bool = False,
    rate: bool = False,
    stepper: str | None = None,
    step_error: float | None = None,
    errors: bool | None = None,
    error_tolerance: float | None = None,
    enrichment: Enriches | None = None,
    finer: Rom | None = None,
    report: Report = silent,
) -> Trajectory:
    """Runs a ROM through a load history from rest: `fenics_rom.simulate` of a ROM, where arguments and errors are."""
    check_flag("profile", profile, SceneError)
    check_flag("rate", rate, SceneError)
    signals, reason = mapping_in("signals", signals, SceneError), ""
    if step_error is not None:
        stepper, reason = _by_error(rom, scene, dt, every, signals, stepper, step_error)
    told: dict[str, Any] = {"errors": errors, "error_tolerance": error_tolerance, "finer": finer}
    environment, history, fresh = _prepared(rom, scene, dt, every, signals, stepper, told)
    body, lost = fresh()
    _check_tolerance(body, environment, errors, enrichment)
    recorder = TrajectoryRecorder(
        rom,
        environment,
        history.steps,
        history.dt,
        snapshots=environment.run.snapshots if environment.run else 1,
        every=history.every,
    )
    recorder.sample(0, body)
    monitor = TimeStepMonitor()
    exceedings = Exceedings(enrichment)
    if body.steps_in_blocks and not history.automatic and enrichment is None and body.beside is None:
        _run_in_blocks(body, history, recorder, monitor, report)
        exceedings.follow(body)
    else:
        body = _run_step_by_step(body, history, recorder, monitor, exceedings, report)
    said = *body.warnings, *exceedings.messages(body.error_tolerance), *filter(None, [monitor.message])
    run = recorder.record(
        name=rom.name,
        model="reduced",
        settings=body.settings | ({"seconds": _seconds(fresh()[0], history)} if rate else {}),
        warnings=tuple(dict.fromkeys((*rom.warnings, *lost, *history.warnings, *said))),
        tendons=rom.environment.tendons,
        profile=_profile(fresh()[0], history) if profile else None,
        stepping=f"{body.stepper}: {reason or body.stepping}" if rom.deformation is not None else "",
    )
    return replace(run, tolerance=exceedings.kept(body.error_tolerance))


def _check_tolerance(
    body: Simulator, environment: Environment, errors: bool | None, enrichment: Enriches | None
) -> None:
    """A SceneError where the scene asks for a tolerance that is not watched, or directions that nothing adds."""
    run = environment.run
    if run is not None and errors is not False and run.error_tolerance is not None and body.error_tolerance is None:
        raise SceneError(
            f"run.error_tolerance = {run.error_tolerance:g}: the ROM's runs do not tell their errors; use one "
            "of fr.reduce(system, errors=True), a finer one beside, or errors = False"
        )
    if run is not None and errors is not False and run.enrich and enrichment is None:
        raise SceneError(
            "run.enrich: adds directions by solves with the full system; use it with fr.simulate(rom, "
            "enrich=system), simulate --enrich --scene SCENE, or errors = False"
        )
    if enrichment is not None:
        if body.errors is None or body.error_tolerance is None:
            raise SceneError(
                "enrich: adds directions where an error that the ROM's runs state is beyond an error_tolerance; "
                "use it with both"
            )
        body.advice = ADDED


def _run_step_by_step(
    body: Simulator,
    history: LoadHistory,
    recorder: TrajectoryRecorder,
    monitor: TimeStepMonitor,
    exceedings: Exceedings,
    report: Report,
) -> Simulator:
    """Takes all steps, and keeps what is to be kept after each; the body that took the last."""
    has_inertia = body.environment is None or body.environment.environment.has_inertia
    for step, (contact, u) in enumerate(history, start=1):
        if not history.automatic:
            body.switch(contact)
        if has_inertia:
            mode_before, before = body.contact, body.state[1]
            body.step(u)
            if body.contact == mode_before:  # velocities of two models are not of one basis
                after = body.state[1]
                monitor.add(np.square(after - before).sum(), np.square(after + before).sum() / 4)
        else:
            body.step(u)
        recorder.sample(step, body, u)
        body = exceedings.follow(body)
        report("steps", step, history.steps)
    return body


def _run_in_blocks(
    body: Simulator, history: LoadHistory, recorder: TrajectoryRecorder, monitor: TimeStepMonitor, report: Report
) -> None:
    """The same of a body whose kernel holds the last steps: what is to be kept is read off many at once."""
    outputs, ledger, taken = list(body.rom.outputs), body.ledger, 0
    assert ledger is not None
    for contact, inputs in _blocks(history, recorder.snapshot_rows):
        body.switch(contact)
        sums = np.array([total for total, _ in ledger.sums[:4]])
        told, before = body.errors, None if body.errors is None else body.errors.state
        states, acted, *works = body.step_in_block(inputs)
        m = states.shape[1] // 2
        start, end = states[:-1, m:], states[1:, m:]
        changed, doubled = end - start, end + start
        monitor.add(float(np.vdot(changed, changed)), float(np.vdot(doubled, doubled)) / 4)
        account = np.empty((5, len(inputs)))
        account[0] = np.einsum("ij,ij->i", states[1:], states[1:]) / 2
        account[1:3] = sums[:2, None] + np.cumsum(works, axis=1)
        account[3:] = sums[2:, None]
        q = states[1:, :m] / body.rom.contact_models[contact].safe_frequencies
        displacements = {name: (q @ body.output_rows(name).T).reshape(len(q), -1, 3) for name in outputs}
        series: dict[str, Mapping[str, Array]] = {"outputs": displacements}
        if told is not None and before is not None:
            stated = told.after_each(before, contact, body.dt, acted, states)
            series |= {PREFIX + kind: of for kind, of in stated.items()}
        recorder.sample_block(taken, contact, acted, account, series)
        taken += len(inputs)
        recorder.sample_shape(taken, body)
        report("steps", taken, history.steps)


def _blocks(history: LoadHistory, ends: Container[int]) -> Iterator[tuple[str, list[Array]]]:
    """Inputs of steps in one contact mode, no more than fit a block, none of which goes on beyond some steps."""
    mode, inputs = "", list[Array]()
    for step, (contact, u) in enumerate(history, start=1):
        if inputs and (contact != mode or len(inputs) == PAGES):
            yield mode, inputs
            inputs = []
        mode = contact
        inputs.append(u)
        if step in ends:
            yield mode, inputs
            inputs = []
    if inputs:
        yield mode, inputs


def rate(
    rom: Rom, *, scene: HasEnvironment | None = None, dt: float | None = None, stepper: str | None = None, runs: int = 5
) -> float:
    """Steps per second of single steps with the account kept, of the fastest of some runs; arguments as `simulate`.

    The fastest, as whatever else a machine does can only slow a run down.
    """
    _, history, fresh = _prepared(rom, scene, dt, None, None, stepper)
    return history.steps / min(_seconds(fresh()[0], history) for _ in range(runs))


def _by_error(
    rom: Rom,
    scene: HasEnvironment | None,
    dt: float | None,
    every: int | None,
    signals: Mapping[str, SignalLike],
    stepper: str | None,
    error: float,
) -> tuple[str, str]:
    """The stepper whose steps have at most that error in the run, and what was measured; see step_error.py."""
    from fenics_rom.runtime.step_error import check_step_error, stepper_by_error

    error, environment = check_step_error(error), rom.environment if scene is None else given_environment(scene)
    if rom.deformation is None or not environment.has_inertia or environment.is_moving or stepper is not None:
        raise SceneError(
            f"step_error = {error:g}: chooses the stepper of a body with large deformation and inertia in a frame that "
            f"stays; {f'stepper = {stepper!r} is given' if stepper is not None else 'this is none'}"
        )
    _, history, _ = _prepared(rom, scene, dt, every, signals, None)

    def path(kind: str, parts: int) -> Array:
        _, finer, fresh = _prepared(rom, scene, history.dt / parts, 1, signals, kind)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FenicsRomWarning)  # the run itself tells them
            body, _ = fresh()
            shapes = []
            for step, (contact, u) in enumerate(finer, start=1):
                if not finer.automatic:
                    body.switch(contact)
                body.step(u)
                if step % parts == 0:
                    shapes.append(body.state[0])
        return np.array(shapes)

    return stepper_by_error(error, history.dt, path)


def _prepared(
    rom: Rom,
    scene: HasEnvironment | None,
    dt: float | None,
    every: int | None,
    signals: Mapping[str, SignalLike] | None,
    stepper: str | None,
    told: Mapping[str, Any] | None = None,
) -> tuple[Environment, LoadHistory, Callable[[], tuple[Simulator, list[str]]]]:
    """What acts in the run, the inputs of its steps, and what makes a simulator at its start, and says what it lost."""
    if len(rom.nodes) == 0:
        raise SceneError(f"ROM {rom.name!r} has no mesh, so no scene goes with it; step it with Simulator")
    environment = rom.environment if scene is None else given_environment(scene)
    history = LoadHistory(environment, rom.contacts, rom.actuators, dt, every)

    def fresh() -> tuple[Simulator, list[str]]:
        simulator = Simulator(rom, history.dt, scene=scene, signals=signals, stepper=stepper, **(told or {}))
        simulator.switch(history.first_contact())
        lost = begin(simulator, rom, environment, history)
        if simulator.beside is not None:
            simulator.beside.begin_with(
                history.first_contact(), lambda finer, own: begin(finer, own, environment, history)
            )
        return simulator, lost

    return environment, history, fresh


def _seconds(simulator: Simulator, history: LoadHistory) -> float:
    """Wall clock of the steps alone, s, with the account kept; in a second run, as reading it after each costs more."""
    seconds, inputs = 0.0, iter(history)
    with warnings.catch_warnings(action="ignore", category=FenicsRomWarning):  # it was said
        while some := list(islice(inputs, 1000)):
            start = time.perf_counter()
            for contact, u in some:
                if not history.automatic:
                    simulator.switch(contact)
                simulator.step(u)
            assert simulator.ledger is not None
            simulator.ledger.supplied  # noqa: B018, it is booked by this
            seconds += time.perf_counter() - start
    return seconds


def _profile(simulator: Simulator, history: LoadHistory) -> dict[str, float]:
    """Seconds per step of each part, in a run whose clock is read between them; what loops take at once is one part."""
    spent: dict[str, float] = {}
    last, contact_marked = time.perf_counter(), False
    touches = simulator.environment is not None and simulator.environment.environment.contact_law is not None

    def mark(part: str) -> None:
        nonlocal last, contact_marked
        contact_marked = contact_marked or part == CONTACT
        now = time.perf_counter()
        spent[part] = spent.get(part, 0.0) + now - last
        last = time.perf_counter()

    if simulator.environment is not None:
        simulator.environment.mark = mark
    with warnings.catch_warnings(action="ignore", category=FenicsRomWarning):
        for contact, u in history:
            mark(UNTIMED)
            if not history.automatic:
                simulator.switch(contact)
                mark("switching")
            contact_marked = False
            simulator.step(u)
            mark(MOTION if contact_marked or not touches else f"{CONTACT}, {MOTION}")
    del spent[UNTIMED]
    return {part: seconds / history.steps for part, seconds in spent.items()}
