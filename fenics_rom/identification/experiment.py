"""What was measured, when and under which inputs: what any model of the scene has to answer to."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, compress, count, permutations

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import DataError, SceneError
from fenics_rom.fem.fibres import has_fibres
from fenics_rom.identification.marker_data import Data, Equilibria, Marker, Motion
from fenics_rom.identification.parameters import FIRST_CLOCK
from fenics_rom.mechanics.active_environment import ActiveEnvironment
from fenics_rom.mechanics.load_history import LoadHistory
from fenics_rom.mechanics.readings import MarkerReading
from fenics_rom.reduction.hyperreduction.training_loads import scene_history
from fenics_rom.scene.scene import Scene
from fenics_rom.system.system import System

INTERPOLATION_POINTS = 4  # steps between which a value is interpolated, by a cubic
RATE_SPAN = 1e-3  # steps, over which a cubic's difference is its rate


@dataclass(frozen=True)
class Start:
    """Where a run begins, if not at rest in the shape of the mesh."""

    equilibrium: Mapping[str, Array]  # input (1, p) of the contact mode whose equilibrium it is; empty: no equilibrium
    fields: Array  # (rows here, 2) displacement and velocity to add, m and m/s


@dataclass(frozen=True)
class Experiment:
    """All values measured on one scene, N_m of motion and then N_r at rest."""

    markers: tuple[Marker, ...]  # that are seen in any of them, (n,)
    dt: float  # of the run, s
    steps: int  # of the run; 0 steps where no motion was measured
    # of each contact mode in each step of the run, (steps, p), zero where another one is active
    inputs: Mapping[str, Array]
    rest_inputs: Mapping[str, Array]  # of each contact mode in each of the R equilibria, (R, p)
    start: Start | None  # of the run; None: at rest
    times: Array  # of values of motion, (N_m,), s
    motion: Array  # which of all files of motions they are from, (N_m,)
    relative: Array  # whether they count from where the run begins, (N_m,)
    rows: Array  # of values at rest, among the equilibria, (N_r,)
    marker: Array  # of each value, (N_m + N_r,)
    measured: Array  # (N_m + N_r,), m
    places: tuple[tuple[str, int, str], ...]  # file, line and column of each value
    unseen: int  # number of cells that were empty

    @property
    def equilibria(self) -> int:
        """Their number R."""
        return max((len(inputs) for inputs in self.rest_inputs.values()), default=0)

    def predictions(self, run: Array, rest: Array, θ: Array) -> Array:
        """What a model says of all values, (N, ...), from its markers at all step ends (steps + 1, n, ...) and at rest.

        The value at any time of the run is that of the cubic through the nearest four step ends; θ has the clocks.
        """
        return np.concatenate(
            [self._in_motion(run, self._run_times(θ)), rest[self.rows, self.marker[len(self.times) :]]]
        )

    def clock_slopes(self, run: Array, θ: Array, dθ: Array) -> Array:
        """How values change with the clocks alone in a direction of θ, (N,), of markers at step ends (steps + 1, n)."""
        slopes, late = np.zeros(len(self.measured)), dθ[-1, FIRST_CLOCK:]
        if late.any():
            times, span = self._run_times(θ), RATE_SPAN * self.dt
            rates = (self._in_motion(run, times + span / 2) - self._in_motion(run, times - span / 2)) / span
            slopes[: len(times)] = -late[self.motion] * rates
        return slopes

    def _run_times(self, θ: Array) -> Array:
        """Times of the run, s, at which values were measured, (N_m,): those of the files' clocks less their delay."""
        clocks = θ[-1, FIRST_CLOCK:]
        return self.times - clocks[self.motion] if clocks.any() else self.times

    def _in_motion(self, run: Array, times: Array) -> Array:
        """Values (N_m, ...) at times (N_m,): before the run those of its start, after it those of its end."""
        columns = self.marker[: len(times)]
        instants, weights = interpolate_instants(np.clip(times, 0.0, self.steps * self.dt), self.dt, self.steps)
        values = np.zeros((len(times), *run.shape[2:]))
        for k in range(instants.shape[1]):
            values += weights[:, k].reshape(-1, *[1] * (run.ndim - 2)) * run[instants[:, k], columns]
        values[self.relative] -= run[0, columns[self.relative]]
        return values

    def until(self, time: float) -> "Experiment":
        """The same without what was measured later than a time, s."""
        earlier = self.times <= time
        last = interpolate_instants(self.times[earlier], self.dt, self.steps)[0].max(initial=0)
        steps = min(int(last) + 1, self.steps)  # one more, as clocks may be late
        retained = np.concatenate([earlier, np.ones(len(self.rows), dtype=bool)])
        moving = {name: getattr(self, name)[earlier] for name in ("times", "motion", "relative")}
        both = {name: getattr(self, name)[retained] for name in ("marker", "measured")}
        inputs = {name: u[:steps] for name, u in self.inputs.items()}
        places = tuple(compress(self.places, retained))
        return replace(self, steps=steps, inputs=inputs, places=places, **moving, **both)

    def marker_columns(self, system: System) -> Array:
        """Those of a system's output columns that are measured, (rows here, n)."""
        columns = output_columns(system)
        return np.stack([columns[m.output][:, m.row] for m in self.markers], axis=1)


def output_columns(system: System) -> dict[str, Array]:
    """C of all outputs, and of readings that are markers off the surface while these turn little, (rows here, any)."""
    readings = {name: reading for name, reading in system.readings.items() if isinstance(reading, MarkerReading)}
    turning = {
        name: (reading.operator.T @ reading.small_motion.T)[system.algebra.rows()] for name, reading in readings.items()
    }
    return {**system.outputs, **turning}


def make_experiment(scene: Scene, data: Sequence[Data], system: System, first: int = 0) -> Experiment:
    """Everything that was measured on a scene, with the inputs of its system; its motions are numbered from `first` on.

    Raises:
        DataError: nothing was measured.
        SceneError: the scene has a load whose value at rest cannot be told, or none in its run, or no such start.
    """
    (system.scene or scene).environment.check_forces_given("an identification")
    if has_fibres(scene):
        raise SceneError(f"{scene.source}: an identification needs materials without fibres, membranes and cables")
    if scene.effects.viscoelasticity is not None:
        raise SceneError(f"{scene.source}: effects.viscoelasticity: an identification needs an elastic material")
    if scene.effects.temperature:
        raise SceneError(
            f"{scene.source}: effects.temperature: what it does grows with the stiffness that is sought; use a scene "
            "without"
        )
    markers = tuple(dict.fromkeys(marker for part in data for marker in part.markers))
    motions = [part for part in data if isinstance(part, Motion)]
    at_rest = [part for part in data if isinstance(part, Equilibria)]
    whole: list[Data] = [*motions, *at_rest]
    seen = [(part, int(row), int(column)) for part in whole for row, column in np.argwhere(np.isfinite(part.measured))]
    if not seen:
        raise DataError("no marker was seen: every cell is empty")
    first_row = dict(zip(map(id, at_rest), np.cumsum([0, *(len(part.contacts) for part in at_rest)]), strict=False))
    number = dict(zip(map(id, motions), count(first), strict=False))
    moving = [(part, row) for part, row, _ in seen if isinstance(part, Motion)]
    dt, steps, inputs = _run_inputs(scene, system) if motions else (1.0, 0, {})
    return Experiment(
        markers=markers,
        dt=dt,
        steps=steps,
        inputs=inputs,
        rest_inputs=_rest_inputs(scene, at_rest, system),
        start=_start_of(scene, system) if motions else None,
        times=np.array([part.times[row] for part, row in moving]),
        motion=np.array([number[id(part)] for part, _ in moving], dtype=int),
        relative=np.array([part.relative for part, _ in moving], dtype=bool),
        rows=np.array([first_row[id(part)] + row for part, row, _ in seen[len(moving) :]], dtype=int),
        marker=np.array([markers.index(part.markers[column]) for part, _, column in seen]),
        measured=np.array([part.measured[row, column] for part, row, column in seen]),
        unseen=sum(part.measured.size for part in whole) - len(seen),
        places=tuple((part.file, int(part.lines[row]), part.columns[column]) for part, row, column in seen),
    )


def run_experiment(scene: Scene, system: System, markers: Sequence[Marker]) -> Experiment:
    """The scene's run, of which nothing was measured."""
    dt, steps, inputs = _run_inputs(scene, system)
    nothing, none = np.empty(0), np.empty(0, dtype=int)
    return Experiment(
        markers=tuple(markers),
        dt=dt,
        steps=steps,
        inputs=inputs,
        rest_inputs={},
        start=None,
        times=nothing,
        motion=none,
        relative=none.astype(bool),
        rows=none,
        marker=none,
        measured=nothing,
        places=(),
        unseen=0,
    )


@dataclass(frozen=True)
class Experiments:
    """All values measured on all scenes, those in motion first; otherwise as one experiment."""

    parts: tuple[Experiment, ...]

    @property
    def times(self) -> Array:
        """Of all values of motion, (N_m,), s."""
        return np.concatenate([part.times for part in self.parts])

    @property
    def measured(self) -> Array:
        """(N,), m."""
        return self.joined([part.measured for part in self.parts])

    @property
    def places(self) -> tuple[tuple[str, int, str], ...]:
        """File, line and column of each value."""
        moving = chain.from_iterable(part.places[: len(part.times)] for part in self.parts)
        at_rest = chain.from_iterable(part.places[len(part.times) :] for part in self.parts)
        return (*moving, *at_rest)

    @property
    def unseen(self) -> int:
        """Number of cells that were empty."""
        return sum(part.unseen for part in self.parts)

    def joined(self, values: Sequence[Array]) -> Array:
        """Values (N_k, ...) of each experiment as values (N, ...) of all."""
        pairs = list(zip(self.parts, values, strict=True))
        return np.concatenate([*(v[: len(e.times)] for e, v in pairs), *(v[len(e.times) :] for e, v in pairs)])

    def until(self, time: float) -> "Experiments":
        """The same without what was measured later than a time, s."""
        return Experiments(tuple(part.until(time) for part in self.parts))


def interpolate_instants(times: Array, dt: float, steps: int) -> tuple[Array, Array]:
    """Step ends (T, 4) nearest to times (T,), and the weights of Lagrange's cubic through them."""
    count = min(INTERPOLATION_POINTS, steps + 1)
    place = times / dt
    first = np.clip(np.floor(place).astype(int) - (count // 2 - 1), 0, steps + 1 - count)
    nodes = first[:, None] + np.arange(count)
    weights = np.ones(nodes.shape)
    for k, other in permutations(range(count), 2):
        weights[:, k] *= (place - nodes[:, other]) / (k - other)
    return nodes, weights


def _run_inputs(scene: Scene, system: System) -> tuple[float, int, dict[str, Array]]:
    """dt, steps, and the inputs of each contact mode in the scene's run."""
    acting, inputs = list(scene_history(system, scene)), dict[str, Array]()
    assert scene.run is not None
    for n, (contact, u) in enumerate(acting):
        inputs.setdefault(contact, np.zeros((len(acting), len(u))))[n] = u
    return scene.run.dt, len(acting), inputs


def _start_of(scene: Scene, system: System) -> Start | None:
    """Where the scene's run begins."""
    initial = scene.run.initial if scene.run else None
    if initial is None:
        return None
    initial.check_supports(system.rigid.shape[1])
    body, rows = system.body, system.algebra.rows()
    fields = [field.ravel()[body.free][rows] for field in initial.fields(body.nodes, body.node_mass)]
    equilibrium = {}
    if initial.equilibrium:
        columns, actuators = (
            {name: B.shape[1] for name, B in blocks.items()} for blocks in (system.contacts, system.actuators)
        )
        history = LoadHistory(scene.environment, columns, actuators)
        contact, u = history.at(0.0, history.first_contact())
        loads = ActiveEnvironment(scene.environment).loads_at(0.0)
        equilibrium[contact] = np.concatenate([u, loads])[None]
    return Start(equilibrium, np.stack(fields, axis=1))


def _rest_inputs(scene: Scene, data: Sequence[Equilibria], system: System) -> dict[str, Array]:
    """Inputs of each contact mode in each equilibrium: its force, gravity, and prescribed forces that are constant."""
    if not data:
        return {}
    loads = [np.empty(0)]
    for name, load in scene.environment.loads.items():
        value = np.zeros(load.columns)  # of a base motion: it is at rest
        if name == "gravity":
            value = np.ones(1)
        elif name in scene.effects.prescribed:
            constant = scene.effects.prescribed[name].force
            if constant is None:
                raise SceneError(
                    f"{scene.source}: effects.prescribed.{name}: changes with time, so it has no value in an "
                    "equilibrium; use a constant force beside data at rest"
                )
            value = np.array(constant)
        loads.append(value)
    actuators = sum(columns.shape[1] for columns in system.actuators.values())
    rows = [(name, force) for part in data for name, force in zip(part.contacts, part.forces, strict=True)]
    inputs: dict[str, Array] = {}
    for n, (name, force) in enumerate(rows):
        u = np.concatenate([force, np.zeros(actuators), *loads])
        inputs.setdefault(name, np.zeros((len(rows), len(u))))[n] = u
    return inputs
