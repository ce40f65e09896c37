"""What was measured, when and under which inputs: what any model of the scene has to answer to."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import compress, permutations

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import DataError, SceneError
from fenics_rom.identification.marker_data import Data, Equilibria, Marker, Motion
from fenics_rom.reduction.hyperreduction.training_loads import scene_history
from fenics_rom.scene.scene import Scene
from fenics_rom.system.system import System

INTERPOLATION_POINTS = 4  # steps between which a value is interpolated, by a cubic


@dataclass(frozen=True)
class Experiment:
    """All measured values, N_m of motion and then N_r at rest."""

    markers: tuple[Marker, ...]  # that are seen in any of them, (n,)
    dt: float  # of the run, s
    steps: int  # of the run; 0 steps where no motion was measured
    # of each contact mode in each step of the run, (steps, p), zero where another one is active
    inputs: Mapping[str, Array]
    rest_inputs: Mapping[str, Array]  # of each contact mode in each of the R equilibria, (R, p)
    times: Array  # of values of motion, (N_m,), s
    instants: Array  # the step ends that these are interpolated between, (N_m, 4)
    weights: Array  # and by what, (N_m, 4)
    rows: Array  # of values at rest, among the equilibria, (N_r,)
    marker: Array  # of each value, (N_m + N_r,)
    measured: Array  # (N_m + N_r,), m
    places: tuple[tuple[str, int, str], ...]  # file, line and column of each value

    @property
    def equilibria(self) -> int:
        """Their number R."""
        return max((len(inputs) for inputs in self.rest_inputs.values()), default=0)

    def predictions(self, run: Array, rest: Array) -> Array:
        """What a model says of all values, (N, ...), from its markers at all step ends (steps + 1, n, ...) and at rest.

        The value at any time is that of the cubic through the nearest four step ends.
        """
        moving = len(self.times)
        columns = self.marker[:moving]
        in_motion = np.zeros((moving, *run.shape[2:]))
        for k in range(self.instants.shape[1]):
            weight = self.weights[:, k].reshape(-1, *[1] * (run.ndim - 2))
            in_motion += weight * run[self.instants[:, k], columns]
        return np.concatenate([in_motion, rest[self.rows, self.marker[moving:]]])

    def until(self, time: float) -> "Experiment":
        """The same without what was measured later than a time, s."""
        earlier = self.times <= time
        steps = int(self.instants[earlier].max(initial=0))
        retained = np.concatenate([earlier, np.ones(len(self.rows), dtype=bool)])
        moving = {name: getattr(self, name)[earlier] for name in ("times", "instants", "weights")}
        both = {name: getattr(self, name)[retained] for name in ("marker", "measured")}
        inputs = {name: u[:steps] for name, u in self.inputs.items()}
        places = tuple(compress(self.places, retained))
        return replace(self, steps=steps, inputs=inputs, places=places, **moving, **both)

    def marker_columns(self, system: System) -> Array:
        """Those of a system's output columns that are measured, (rows here, n)."""
        return np.stack([system.outputs[m.output][:, m.row] for m in self.markers], axis=1)


def make_experiment(scene: Scene, data: Sequence[Data], system: System) -> Experiment:
    """Everything that was measured on a scene, with the inputs of its system.

    Raises:
        DataError: nothing was measured.
        SceneError: the scene has a load whose value at rest cannot be told, or none in its run.
    """
    scene.environment.check_forces_given("an identification")
    if scene.effects.viscoelasticity is not None:
        raise SceneError(f"{scene.source}: effects.viscoelasticity: an identification needs an elastic material")
    markers = tuple(dict.fromkeys(marker for part in data for marker in part.markers))
    motions = [part for part in data if isinstance(part, Motion)]
    at_rest = [part for part in data if isinstance(part, Equilibria)]
    whole: list[Data] = [*motions, *at_rest]
    seen = [(part, int(row), int(column)) for part in whole for row, column in np.argwhere(np.isfinite(part.measured))]
    if not seen:
        raise DataError("no marker was seen: every cell is empty")
    first = dict(zip(map(id, at_rest), np.cumsum([0, *(len(part.contacts) for part in at_rest)]), strict=False))
    times = np.array([part.times[row] for part, row, _ in seen if isinstance(part, Motion)])
    dt, steps, inputs = _run_inputs(scene, system) if motions else (1.0, 0, {})
    instants, weights = interpolate_instants(times, dt, steps)
    return Experiment(
        markers=markers,
        dt=dt,
        steps=steps,
        inputs=inputs,
        rest_inputs=_rest_inputs(scene, at_rest, system),
        times=times,
        instants=instants,
        weights=weights,
        rows=np.array([first[id(part)] + row for part, row, _ in seen[len(times) :]], dtype=int),
        marker=np.array([markers.index(part.markers[column]) for part, _, column in seen]),
        measured=np.array([part.measured[row, column] for part, row, column in seen]),
        places=tuple((part.file, int(part.lines[row]), part.columns[column]) for part, row, column in seen),
    )


def run_experiment(scene: Scene, system: System, markers: Sequence[Marker]) -> Experiment:
    """The scene's run, of which nothing was measured."""
    dt, steps, inputs = _run_inputs(scene, system)
    none = np.empty(0, dtype=int)
    instants, weights = np.empty((0, INTERPOLATION_POINTS), dtype=int), np.empty((0, INTERPOLATION_POINTS))
    nothing = np.empty(0), instants, weights, none, none, np.empty(0), ()
    return Experiment(tuple(markers), dt, steps, inputs, {}, *nothing)


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
                    "equilibrium; allowed beside data at rest is a constant force"
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
