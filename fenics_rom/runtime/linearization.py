"""A step of a body that is not linear, linearised about a state: the state space of what happens nearby.

What that is of is here; the derivative itself is in `step_derivative.py`.
"""

import warnings
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy import ndarray as Array
from numpy.typing import ArrayLike

from fenics_rom.errors import FenicsRomWarning, StepError, shown
from fenics_rom.mechanics.frame_motion import cross_matrix, rotation_matrix
from fenics_rom.mechanics.signals import real_numbers
from fenics_rom.mechanics.step import FINITE_STRAIN_STEPPERS
from fenics_rom.rom.linear_readings import ReadRows, reading_rows
from fenics_rom.rom.rom import Rom
from fenics_rom.rom.state_space import OperatingPoint, StateSpace, column_names, output_names
from fenics_rom.runtime.readings import readable
from fenics_rom.runtime.simulated_body import SimulatorState
from fenics_rom.runtime.simulator import Simulator
from fenics_rom.runtime.step_derivative import differentiate_step, found_loads
from fenics_rom.runtime.step_state import StepState
from fenics_rom.runtime.steppers.residual_maps import strained_back
from fenics_rom.trajectory.trajectory import Trajectory

PULLS = 1e-9, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3  # m: strokes by which a cable is taut


def linearized(
    rom: Rom, contact: str, outputs: Sequence[str], dt: float | None, at: Any, u: ArrayLike | None
) -> StateSpace:
    """As `Rom.state_space`, of a body that is not linear."""
    body = _body_at(rom, contact, at, dt)
    given = _inputs(body, u, at)
    loads = _held(body)
    touching = _touching(body, given)
    state, after = StepState(body, touching), None
    if touching.any():
        body.step(given)
        after = state.read()
    step = differentiate_step(state, given, loads)
    if step.kinks:
        warnings.warn(
            f"the state is at a kink, where {', '.join(step.kinks)} may go either way: the state space is that of one "
            "side; a state from which contact, sliding and taut cables last for some steps has none",
            FenicsRomWarning,
            stacklevel=4,
        )
    state.put(state.x)
    read = {name: _rows(body, state, name) for name in outputs}
    C = np.vstack([np.zeros((0, len(state.x))), *(rows.rows for rows in read.values())])
    shown_now = [body.displacement(name).ravel() if name in rom.outputs else read[name].rows @ state.x for name in read]
    columns = {name: n for name, n in body.rom.input_columns(contact).items() if name not in found_loads(body)}
    kept = np.concatenate([
        np.full(n, name in columns) for name, n in body.rom.input_columns(contact).items()
    ])  # fmt: skip
    units = rom.environment.input_units
    if at is None:
        _tell(rom, body, touching)
    return StateSpace(
        A=step.A,
        B=step.B[:, kept],
        C=C,
        D=np.zeros((len(C), int(kept.sum()))),
        dt=body.dt,
        states=state.names,
        inputs=column_names({name: (n, units.get(name, "N")) for name, n in columns.items()}),
        outputs=output_names(read),
        about=OperatingPoint(
            state.x,
            np.concatenate([given, loads])[kept],
            step.after if after is None else after,
            np.concatenate([np.empty(0), *shown_now]),
        ),
    )


def _tell(rom: Rom, body: Simulator, touching: Array) -> None:
    """That a body that is not linear was linearised at its start, and what is linear there."""
    count = int(touching.sum())
    words = {
        "contact with obstacles": f"contact is closed at {count} points" if count else "contact is open",
        "large deformation": "stiffness is that of the shape at rest",
        "a moving frame": "the base is where it begins"
        if body.base_wrench is not None
        else "the frame does not turn, and weight does not follow it",
        "actuators that are given strokes": "cables are taut",
        "surfaces that are rigid": "rigid surfaces turn but a little",
        "friction of tendons": "cables slide as the tension grows",
    }
    has = rom.nonlinear_parts
    warnings.warn(
        f"ROM {rom.name!r} has {', '.join(has)}: its state space is that of a step of {body.dt:g} s about the body at "
        f"rest at the start, where {'; '.join(words[part] for part in has)}. It holds near there alone; at = "
        "body.save() linearises about any other state",
        FenicsRomWarning,
        stacklevel=5,
    )


def _body_at(rom: Rom, contact: str, at: Any, dt: float | None) -> Simulator:
    """A simulator in the state and in a contact mode, that does not follow obstacles to another one."""
    if not (at is None or isinstance(at, Simulator | SimulatorState | Trajectory)):
        raise StepError(f"at = {shown(at)}: use a Simulator, what its save() gave, or a run of this ROM")
    known = dt
    if known is None:
        known = at.dt if isinstance(at, SimulatorState | Simulator) else None
    if known is None and isinstance(at, Trajectory):
        known = float(at.settings["dt"])
    if known is None:
        raise StepError(
            f"ROM {rom.name!r} has {rom.nonlinear_parts[0]}: what is linearised is a step, as contact and cables begin "
            "to act at once, which has no continuous form; dt is missing, in s"
        )
    if isinstance(at, Simulator):
        state = at.save()
        if state.belongs is None or state.belongs.identity != rom.identity:
            raise StepError(f"at: the simulator is of another ROM than {rom.name!r}")
        body = _in_mode(at, state)
    elif isinstance(at, SimulatorState):
        body = _restored(rom, at)
    elif isinstance(at, Trajectory):
        body = _at_shape(rom, contact, at, known)
    else:
        body = Simulator(rom, known, ledger=False, scene=_alone(rom))
    body.dt = known
    body.switch(contact)
    return body


def _alone(rom: Rom) -> Any:
    """The environment of a ROM, where obstacles ask for no contact mode; None where it is of no scene."""
    acting = rom.environment
    return replace(acting, contact_switching="scene") if acting.is_of_scene else None


def _in_mode(body: Simulator, state: SimulatorState) -> Simulator:
    """A twin of a body that keeps its contact mode, and no errors."""
    revived, (rom, acts, _, signals, _) = body.__reduce__()
    acting = None if body.environment is None else body.environment.environment
    if acting is not None and acting.is_of_scene:
        acts = acts | {"scene": replace(acting, contact_switching="scene")}
    twin: Simulator = revived(rom, acts, {"errors": False}, signals, state)
    return twin


def _restored(rom: Rom, state: SimulatorState) -> Simulator:
    """A body in a saved state, by that stepper which it is of."""
    kinds = (None, *FINITE_STRAIN_STEPPERS) if rom.deformation is not None else (None,)
    ledger, failed = state.sums is not None, None
    for kind in kinds:
        try:
            body = Simulator(rom, state.dt, ledger=ledger, scene=_alone(rom), stepper=kind)
            body.restore(state)
            return body
        except StepError as error:
            failed = failed or error
    assert failed is not None
    raise failed


def _at_shape(rom: Rom, contact: str, run: Trajectory, dt: float) -> Simulator:
    """A body that has the last shape of a run, and its velocity."""
    body = Simulator(rom, dt, ledger=False, scene=_alone(rom))
    if not len(run.snapshots) or run.snapshots[-1].shape != rom.nodes.shape:
        raise StepError(f"at: the run {run.name!r} has no shape of the {len(rom.nodes)} nodes of ROM {rom.name!r}")
    for name, moved in run.obstacle_motion.items():
        assert body.environment is not None
        body.set_signal(name, body.environment.resting_signal(name, moved[-1]))
    if body.environment is not None and len(run.obstacle_motion):
        body.environment.reset()
    body.switch(contact)
    body.set_shape(run.snapshots[-1], None if run.velocities is None else run.velocities[-1])
    return body


def _inputs(body: Simulator, u: ArrayLike | None, at: Any) -> Array:
    """Inputs (p,) without loads: as given, or as at the end of a run; else strokes as they are, taut at rest, and 0."""
    if u is not None:
        try:
            given = real_numbers(u)
        except (TypeError, ValueError):
            given = np.empty((0, 0))
        if given.shape != (body.inputs,) or not np.isfinite(given).all():
            raise StepError(f"u: use {body.inputs} finite numbers, of inputs without loads (got {shown(u)})")
        return given.copy()
    u0, controls = np.zeros(body.inputs), {} if body.environment is None else body.environment.environment.controls
    if isinstance(at, Trajectory):
        for name, own in body.input_slices().items():
            if name in at.inputs:
                u0[own] = at.inputs[name].values[-1]
        return u0
    if not controls:
        return u0
    starts = body.input_slices()
    strokes = readable(body.rom, body.contact, body.state[0], body.shape_coordinates).stroke
    cables = [starts[name].start for name in body.rom.actuators if controls.get(name) == "length"]
    for name in set(controls) & set(body.rom.actuators):
        if controls[name] == "valve":
            raise StepError(
                f"state_space: chamber {name!r} gets gas through a valve, so that what it holds is a further state; "
                "use control = 'gas'"
            )
        u0[starts[name]] = body.gas.get(name, strokes(name))
    for pull in PULLS if at is None and cables else ():
        there = body.save()
        pulled = u0.copy()
        pulled[cables] += pull
        body.step(pulled)
        taut = [body.reactions[name] > 0 for name, control in controls.items() if control == "length"]
        body.restore(there)
        if all(taut):
            return pulled
    return u0


def _held(body: Simulator) -> Array:
    """Values of loads in the step, as which they and the obstacles stay."""
    environment = body.environment
    if environment is None:
        return np.empty(0)
    halfway = body.dt / 2 if environment.environment.has_inertia else body.dt
    loads, column, offsets = environment.loads_at(body.time + halfway), 0, environment.state.offsets.copy()
    found = found_loads(body)
    for name, width in body.rom.loads.items():
        if name not in found:
            body.set_signal(name, loads[column : column + width])
        column += width
    for name, offset in zip(environment.obstacles, offsets, strict=True):
        body.set_signal(name, environment.resting_signal(name, offset))
    return loads


def _touching(body: Simulator, u: Array) -> Array:
    """Contact points (P,) that carry a force before the step or in it."""
    carrying, residual = np.zeros(len(body.contact_coordinates), bool), body.integrator.kernel.residual
    if residual is not None:
        for row in residual.state.reshape(4, -1)[::2]:
            carrying |= row.reshape(-1, 3).any(axis=1)
    if len(carrying):
        there = body.save()
        body.step(u)
        carrying |= body.contact_forces().any(axis=1)
        body.restore(there)
    return carrying


def _rows(body: Simulator, state: StepState, name: str) -> ReadRows:
    """What an output, or a reading that is linear, shows of x: in a moving frame as it is now."""
    rom, model, kernel = body.rom, body.model, body.integrator.kernel
    travel = model.safe_frequencies.copy()
    travel[: len(body.integrator.rigid_displacement)] = 1.0
    beyond = np.zeros((len(rom.stiffness), 0))
    points = np.empty(0, dtype=int)
    if kernel.residual is not None:
        part, ρ = kernel.residual.part, rom.rigid
        points = np.flatnonzero(state.points_of(_ones(state, "g"), "g"))
        rows = np.array([strained_back(part, row) for row in np.eye(len(rom.stiffness) - ρ)])[:, points]
        beyond = np.zeros((len(rom.stiffness), len(points)))
        beyond[ρ:] = rows / np.sqrt(rom.stiffness[ρ:, None])
    if name in rom.readings:
        if body.pose is not None or rom.deformation is not None:
            raise StepError(f"reading {name!r}: of a body that moves or deforms far it is not linear; use outputs")
        columns = rom.input_columns(body.contact)
        read = reading_rows(name, rom.readings[name], model, columns)
        if not len(points):
            of_points = read.rows[:, :0]
        else:
            further = replace(
                model,
                eigenvalues=np.ones(len(points)),
                coordinates=beyond,
                inputs=0 * model.inputs[:1].repeat(len(points), 0),
            )
            of_points = reading_rows(name, rom.readings[name], further, columns).rows
        shape, unit, of_q = read.shape, read.unit, read.rows
    else:
        of_q, of_points, unit = rom.outputs[name] @ model.coordinates, rom.outputs[name] @ beyond, "m"
        shape = rom.by_point(of_q.T).shape[1:]
    C = np.zeros((len(of_q), len(state.x)))
    C[:, state.places["e"]], C[:, state.places["g"]] = of_q / travel, of_points
    if body.pose is not None and rom.moving_frame is not None:
        R = rotation_matrix(body.pose.rotation)
        C = np.einsum("ab,pbs->pas", R, C.reshape(-1, 3, C.shape[1])).reshape(C.shape)
        if "pose" in state.places:
            rest = np.asarray(rom.moving_frame.output_points[name])
            arms = rest + body.displacement(name) - body.pose.position
            turned = np.concatenate([-cross_matrix(arm) for arm in arms])
            C[:, state.places["pose"]][:, :6] = np.hstack([np.tile(np.eye(3), (len(arms), 1)), turned])
    return ReadRows(shape, C, unit)


def _ones(state: StepState, part: str) -> Array:
    x = np.zeros(len(state.x))
    x[state.places[part]] = 1.0
    return x
