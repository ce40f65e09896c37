"""What is kept of a run, the same for full and reduced models."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.active_environment import ActiveEnvironment
from fenics_rom.mechanics.body_facts import CellQuality
from fenics_rom.mechanics.energy_ledger import EnergyLedger
from fenics_rom.mechanics.environment import Environment
from fenics_rom.mechanics.nodal_contact import NodalContact
from fenics_rom.mechanics.obstacles import Obstacle
from fenics_rom.mechanics.readings import Reading
from fenics_rom.trajectory.bodies import BodyTrack
from fenics_rom.trajectory.contact_snapshots import ContactSnapshots
from fenics_rom.trajectory.error_series import ErrorSeries, ErrorTolerance, error_series, stated_numbers
from fenics_rom.trajectory.series import FRAME_SERIES, ReadingSeries, Series, input_series, reading_series

NOTHING = np.empty(0)
CONTACT_ACCOUNT = {
    "obstacles": "contact",
    "contact": "contact",
    "friction": "friction",
}  # sums, and effects they are of


@dataclass(frozen=True)
class Trajectory:
    """Times, outputs and the energy account of a run.

    Attributes:
        name: of the scene.
        model: "full" or "reduced".
        settings: numbers that belong beside any rate or error: dt, s; order, or n; seconds, the wall clock of the
            stepping, of a reduced run only where it was asked for; of linearly implicit steps with large deformation
            mismatch (of strains, as a share of the largest); first_frequency of the body, Hz, where it is known; every,
            where instants are kept after every so many steps alone; beyond_training, 1 where a model went further than
            it was trained to.
        times: (steps + 1,), s; fewer, as in the following, where instants are kept after every so many steps alone.
        contacts: names of the contact modes.
        contact: (steps + 1,) which of them was active.
        outputs: displacement of each named output, (steps + 1, points, 3), m.
        energy: (steps + 1,) stored, J.
        supplied, dissipated, lost_in_switching, numerical: (steps + 1,) running sums, J; the last is 0 with inertia.
        snapshot_times: (s,), s.
        snapshots: displacement of every node, (s, N, 3), m.
        nodes: (N, 3), m.
        triangles: (F, 3).
        node_mass: (N,), kg.
        warnings: what the user should know about this run.
        effects: names of those that acted.
        forces: of each obstacle on the body, (steps + 1, 3), N.
        contact_account: where the scene has contact, running sums (steps + 1,), J: what "obstacles" supplied, and what
            "contact" and (where it has that, too) "friction" dissipated; they are parts of `supplied` and `dissipated`.
        profile: seconds per step of each part of a reduced run, where they were measured.
        velocities: of every node beside its displacement in `snapshots`, (s, N, 3), m/s; None without inertia, and in
            files of earlier releases.
        obstacles: where the scene puts them, by name.
        obstacle_motion: how far each was from there at `snapshot_times`, (s, 3), m; of one with a motion with the unit
            quaternion w x y z by which it is turned about the origin of the scene before, (s, 7).
        tendons: points at rest that each leads through, from its anchor to where it is pulled, (K, 3), m.
        stepping: how a step was taken and why, where there was a choice.
        cells: of the mesh, how many there are, and how good; None where nobody knows.
        inputs: what acted: forces on contact modes, actuators, loads; those that were always 0 left out.
        readings: of the scene, by name.
        reactions: of each actuator whose stroke is given the force in the step before, (steps + 1,): of a tendon its
            tension, N, of a chamber its pressure, Pa.
        pose: of a moving frame, (steps + 1, 7): position of its origin, m, and rotation, a unit quaternion w x y z;
            None in a fixed frame, as are the next two.
        base_wrench: of a carried body, (steps + 1, 6): what the base exerted in the step before: force, N, and torque
            about the origin, N m, in world axes.
        touched: of each snapshot forces of contact on nodes, in the step that led to it; None where nothing can touch.
        bodies: of a world, by name; snapshots are then of the surfaces of all of them, one after another, nodes where
            these are at the start, and forces of pairs of bodies, FIRST-SECOND on the first.
        momentum: (steps + 1, 6): N s, and angular momentum about the frame's origin, N m s, in world axes.
        errors: of a reduced run that stated its own, "bound" and "estimate".
        tolerance: that it was to keep to, and where it did not; None where there was none.

    Example:
        >>> run = fr.read_trajectory("run.h5")
        >>> run.outputs["tip"].shape, run.balance_error < 1e-12
        ((301, 2, 3), True)
    """

    name: str
    model: str
    settings: Mapping[str, float]
    times: Array
    contacts: tuple[str, ...]
    contact: Array
    outputs: Mapping[str, Array]
    energy: Array
    supplied: Array
    dissipated: Array
    lost_in_switching: Array
    numerical: Array
    snapshot_times: Array
    snapshots: Array
    nodes: Array
    triangles: Array
    node_mass: Array
    warnings: tuple[str, ...] = ()
    effects: tuple[str, ...] = ()
    forces: Mapping[str, Array] = field(default_factory=dict)
    contact_account: Mapping[str, Array] = field(default_factory=dict)
    profile: Mapping[str, float] = field(default_factory=dict)
    velocities: Array | None = None
    obstacles: Mapping[str, Obstacle] = field(default_factory=dict)
    obstacle_motion: Mapping[str, Array] = field(default_factory=dict)
    tendons: Mapping[str, Array] = field(default_factory=dict)
    stepping: str = ""
    cells: CellQuality | None = None
    inputs: Mapping[str, Series] = field(default_factory=dict)
    readings: Mapping[str, ReadingSeries] = field(default_factory=dict)
    reactions: Mapping[str, Array] = field(default_factory=dict)
    pose: Array | None = None
    base_wrench: Array | None = None
    momentum: Array | None = None
    bodies: Mapping[str, BodyTrack] = field(default_factory=dict)
    touched: NodalContact | None = None
    errors: Mapping[str, ErrorSeries] = field(default_factory=dict)
    tolerance: ErrorTolerance | None = None

    @property
    def frame_series(self) -> dict[str, Series]:
        """Position, rotation, base force and torque, momentum and angular momentum, as far as they are kept."""
        series = {}
        for name, parts in FRAME_SERIES.items():
            values, first = getattr(self, name), 0
            for part, (unit, components) in {} if values is None else parts.items():
                series[part] = Series(values[:, first : first + len(components)], unit)
                first += len(components)
        return series

    @property
    def reaction_series(self) -> dict[str, Series]:
        """The reactions with their units."""
        moved = {*self.tendons, *(name for name, given in self.inputs.items() if given.unit == "m")}
        units = {name: "N" if name in moved else "Pa" for name in self.reactions}
        return {name: Series(force[:, None], units[name]) for name, force in self.reactions.items()}

    def __repr__(self) -> str:
        order, dt = (self.settings.get(name, math.nan) for name in ("order", "dt"))
        outputs = (f"{name} ({values.shape[1]} points)" for name, values in self.outputs.items())
        named = {
            "readings": self.readings,
            "inputs": self.inputs,
            "moving frame": self.frame_series,
            "effects": self.effects,
            "bodies": self.bodies,
        }
        parts = {"outputs": ", ".join(outputs)} | {kind: ", ".join(names) for kind, names in named.items()}
        snapshots = f"{len(self.snapshots)} snapshots of {len(self.nodes)} nodes"
        return (
            f"Trajectory {self.name!r}: {self.model} (order {order:g}), {self.steps} steps of {dt:g} s, "
            f"contact modes {', '.join(self.contacts)}\n"
            f"  {'; '.join([*(f'{kind}: {names}' for kind, names in parts.items() if names), snapshots])}"
        )

    @property
    def balance_error(self) -> float:
        """Largest |E - E₀ - supplied + all the other sums|, as a share of the largest energy or work."""
        gone = self.dissipated + self.lost_in_switching + self.numerical
        gap = self.energy - self.energy[0] - self.supplied + gone
        scale = max(np.abs(self.energy).max(), np.abs(self.supplied).max(), np.abs(self.dissipated).max())
        return float(np.abs(gap).max() / scale) if scale > 0 else 0.0

    @property
    def beyond_training(self) -> bool:
        """Whether a model went where it was not trained to go; a warning says how far."""
        return "beyond_training" in self.settings

    @property
    def steps(self) -> int:
        """Number of steps that were taken."""
        return round(self.times[-1] / self.settings["dt"]) if "every" in self.settings else len(self.times) - 1


class RunningBody(Protocol):
    """What is recorded of a run: a simulator, reduced or full order."""

    @property
    def contact(self) -> str:
        """The active contact mode."""

    @property
    def energy(self) -> float:
        """Stored, J."""

    @property
    def ledger(self) -> EnergyLedger | None:
        """The energy account, which must be kept."""

    @property
    def environment(self) -> ActiveEnvironment | None:
        """The loads and obstacles, if there are any."""

    def displacement(self, output: str | None = None) -> Array:
        """Of a named output (points, 3), or of all nodes (N, 3), m."""

    def velocity(self, output: str | None = None) -> Array:
        """The same of velocities, m/s."""

    def reading(self, name: str) -> Array:
        """A reading of the scene."""

    def obstacle_forces(self) -> Array:
        """Of the obstacles on the body, (O, 3), N."""

    @property
    def nodal_contact(self) -> NodalContact | None:
        """Forces of contact on nodes in the last step; None where nothing can touch the body."""

    @property
    def reactions(self) -> Mapping[str, float]:
        """Forces of the actuators whose strokes are given, N or Pa."""


class TrajectoryRecorder:
    """Fills the arrays of a trajectory, step by step.

    Args:
        model: a ROM or a system, with outputs and readings by name, contacts and actuators (columns, or how many), and
            what has nodes (N, 3), m, triangles (F, 3), node_mass (N,), kg, and cells: itself, or its body.
        environment: what acts; without contact nothing is kept of it.
        steps: number of steps of the run.
        dt: time step, s.
        snapshots: how many whole shapes to keep, evenly spread, the last step among them.
        every: instants are kept after every so many steps, and at the end.

    Attributes:
        snapshot_rows: of the steps after which a whole shape is kept, its place among them.
    """

    def __init__(self, model: Any, environment: Environment, steps: int, dt: float, *, snapshots: int, every: int = 1):
        self._body, self._effects = getattr(model, "body", model), tuple(environment.effects)
        self._contacts, self._input_columns = tuple(model.contacts), (_widths(model.contacts), _widths(model.actuators))
        self._outputs, self._units = list(model.outputs), environment.input_units
        self._readings: Mapping[str, Reading] = model.readings
        self._loads: Mapping[str, int] = {}
        self._inputs = NOTHING
        self._series: dict[str, dict[str, Array]] = {}
        self._why: dict[str, str] = {}  # errors are bounds or estimates
        self._dt, self._every, self._is_moving = dt, every, environment.is_moving
        self._kept = np.union1d(np.arange(0, steps + 1, every), steps)
        instants = len(self._kept)
        self._contact = np.zeros(instants, dtype=np.int64)
        self._account = np.zeros((5, instants))
        self._obstacles = {name: obstacle.shape for name, obstacle in environment.obstacles.items()}
        self._sums = [name for name, effect in CONTACT_ACCOUNT.items() if effect in self._effects]
        self._snapshot_steps = np.unique(np.round(np.linspace(0, steps, min(snapshots, steps) + 1)).astype(int))[1:]
        self.snapshot_rows = {step: row for row, step in enumerate(self._snapshot_steps.tolist())}
        self._snapshots = np.zeros((len(self._snapshot_steps), len(self._body.nodes), 3))
        self._touched = ContactSnapshots(len(self._snapshot_steps))
        is_moving = not self._effects or "inertia" in self._effects
        self._velocities = np.zeros_like(self._snapshots) if is_moving else None
        self._motion = {
            name: np.zeros((len(self._snapshot_steps), 3 if obstacle.motion is None else 7))
            for name, obstacle in environment.obstacles.items()
        }

    def sample(self, step: int, body: RunningBody, u: Array | None = None) -> None:
        """Keeps what is to be kept of one instant, to which a step with inputs u led; step 0 is the start."""
        row, between = divmod(step, self._every)
        if not between or step == self._kept[-1]:
            self._sample_numbers(row + bool(between), body, u)
        self.sample_shape(step, body)

    def sample_block(
        self, taken: int, contact: str, inputs: Array, account: Array, series: Mapping[str, Mapping[str, Array]]
    ) -> None:
        """Keeps what is to be kept of the steps after so many, in one contact mode, but for shapes.

        Args:
            taken: steps before them.
            contact: mode.
            inputs: (n, p) contact columns, actuators, loads.
            account: (5, n) stored, supplied, dissipated, lost in switching, numerical after each of them, J.
            series: by kind and name, (n, ...): "outputs", m, and what is stated of errors.
        """
        start, stop = np.searchsorted(self._kept, [taken + 1, taken + 1 + account.shape[1]])
        rows, steps = slice(start, stop), self._kept[start:stop] - taken - 1
        self._contact[rows] = self._contacts.index(contact)
        self._inputs[rows, self._inputs.shape[1] - inputs.shape[1] :] = inputs[steps]
        self._account[:, rows] = account[:, steps]
        for kind, named in series.items():
            for name, values in named.items():
                self._series[kind][name][rows] = values[steps]

    def sample_shape(self, step: int, body: RunningBody) -> None:
        """Keeps the whole shape of an instant, if it is one of those that are kept."""
        row = self.snapshot_rows.get(step)
        if row is not None:
            self._snapshots[row] = body.displacement()
            self._touched.sample(row, body.nodal_contact)
            if self._velocities is not None:
                self._velocities[row] = body.velocity()
            if self._obstacles and body.environment is not None:
                for values, offset in zip(self._motion.values(), body.environment.state.offsets, strict=True):
                    values[row] = offset[: values.shape[1]]

    def _sample_numbers(self, row: int, body: RunningBody, u: Array | None) -> None:
        """Keeps all of an instant but the shape."""
        ledger, environment = body.ledger, body.environment
        assert ledger is not None
        if row == 0:
            contacts, actuators = self._input_columns
            self._loads = {} if environment is None else environment.columns
            columns = max(contacts.values()) + sum(actuators.values()) + sum(self._loads.values())
            self._inputs = np.zeros((len(self._kept), columns))
        if u is not None:
            last = u if environment is None else np.concatenate([u, environment.loads])
            self._inputs[row, self._inputs.shape[1] - len(last) :] = last
        self._contact[row] = self._contacts.index(body.contact)
        self._account[:, row] = body.energy, *(total for total, _ in ledger.sums[:4])
        now: dict[str, Mapping[str, Any]] = {
            "outputs": {name: body.displacement(name) for name in self._outputs},
            "forces": dict(zip(self._obstacles, body.obstacle_forces(), strict=True)) if self._obstacles else {},
            "contact_account": {name: getattr(ledger, name) for name in self._sums},
            "readings": {name: body.reading(name) for name in self._readings},
            "reactions": body.reactions,
            "frame": {name: np.concatenate(parts[:2]) for name, parts in self._frame_of(body).items()},
        }
        stated = getattr(body, "stated_errors", {})
        now |= stated_numbers(stated)
        self._why = {kind: error.why for kind, error in stated.items()}
        for kind, named in now.items():
            if row == 0:
                zeros = {name: np.zeros((len(self._kept), *np.shape(value))) for name, value in named.items()}
                self._series[kind] = zeros
            for name, value in named.items():
                self._series[kind][name][row] = value

    def _frame_of(self, body: RunningBody) -> dict[str, tuple[Array, Array]]:
        """Pose, wrench and momenta of a moving frame, as far as the body has them."""
        parts = {name: getattr(body, name, None) for name in FRAME_SERIES} if self._is_moving else {}
        return {name: of for name, of in parts.items() if of is not None}

    def record(
        self,
        *,
        name: str,
        model: str,
        settings: Mapping[str, float],
        warnings: tuple[str, ...],
        tendons: Mapping[str, Array],
        profile: Mapping[str, float] | None = None,
        stepping: str = "",
    ) -> Trajectory:
        """The finished run."""
        energy, supplied, dissipated, lost, numerical = self._account
        series: dict[str, Any] = dict(self._series)
        readings = {name: reading_series(self._readings[name], of) for name, of in series.pop("readings").items()}
        frame = series.pop("frame")
        if self._every > 1:
            settings = {**settings, "every": self._every}
        return Trajectory(
            name=name,
            model=model,
            settings=settings,
            times=self._dt * self._kept,
            contacts=self._contacts,
            contact=self._contact,
            energy=energy,
            supplied=supplied,
            dissipated=dissipated,
            lost_in_switching=lost,
            numerical=numerical,
            snapshot_times=self._dt * self._snapshot_steps,
            snapshots=self._snapshots,
            nodes=self._body.nodes,
            triangles=self._body.triangles,
            node_mass=self._body.node_mass,
            cells=self._body.cells,
            warnings=warnings,
            effects=self._effects,
            profile=profile or {},
            velocities=self._velocities,
            obstacles=self._obstacles,
            obstacle_motion=self._motion,
            tendons=tendons,
            stepping=stepping,
            touched=self._touched.kept,
            inputs=input_series(self._contact, self._inputs, *self._input_columns, self._loads, self._units),
            readings=readings,
            errors=error_series(self._why, series, readings),
            **frame,
            **series,
        )


def _widths(columns: Mapping[str, Array | int]) -> dict[str, int]:
    """Numbers of columns, which a ROM has, or of the columns themselves, which a system has."""
    return {name: each.shape[1] if isinstance(each, np.ndarray) else each for name, each in columns.items()}
