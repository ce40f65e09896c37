"""What can be read of a body that is simulated, and what it can be saved as."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError, shown, unknown
from fenics_rom.mechanics.linearity import SurfaceStrainPeak
from fenics_rom.mechanics.signals import real_numbers
from fenics_rom.mechanics.step import StepperState
from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.runtime.filled_body import FilledBody
from fenics_rom.runtime.linearity_monitor import LinearityMonitor
from fenics_rom.runtime.steppers.stepper import ReducedStepper
from fenics_rom.runtime.switching import SwitchLoss
from fenics_rom.runtime.tension_watch import TensionWatch, push_messages

if TYPE_CHECKING:
    from fenics_rom.mechanics.active_environment import ObstacleState
    from fenics_rom.mechanics.skin_watch import Told
    from fenics_rom.runtime.environment_inputs import EnvironmentInputs
    from fenics_rom.runtime.error_tolerance import Exceeded
    from fenics_rom.runtime.error_watch import ErrorState
    from fenics_rom.runtime.skin_looks import SkinLooks


class Belongs(NamedTuple):
    """What a state is of, and among: a state of something else may well have as many numbers."""

    rom: str  # its name
    identity: str  # and what tells it from others
    obstacles: tuple[str, ...]

    def check(self, state: Any) -> None:
        """A StepError where something was not saved by a simulator of this ROM among these obstacles."""
        if not isinstance(state, SimulatorState):
            raise StepError(f"restore: {shown(state)} was given; use what save() gave")
        given = state.belongs or Belongs("unknown", "", ())
        if given.identity != self.identity:
            raise StepError(f"the snapshot is of another ROM, {given.rom!r}, than this simulator's, {self.rom!r}")
        if given.obstacles != self.obstacles:
            there, here = (", ".join(of.obstacles) or "none" for of in (given, self))
            raise StepError(f"the snapshot is of a body among other obstacles, {there}, than this simulator's, {here}")


@dataclass(frozen=True)
class SimulatorState:
    """All that a simulator does not take from its ROM, exact to the bit."""

    contact: str
    dt: float  # s
    steps: int  # taken
    since: tuple[float, int]  # time, s, and number of steps at which dt was last changed
    stepper: StepperState
    sums: tuple[tuple[float, float], ...] | None  # of the energy account, J, and what they were rounded by
    surface_peak: SurfaceStrainPeak
    loss: SwitchLoss  # the largest
    obstacles: "ObstacleState | None" = None  # None where nothing acts by itself
    told: "tuple[Told, ...]" = ()  # what went through the skin
    belongs: "Belongs | None" = None  # what it is a state of
    errors: "ErrorState | BesideState | None" = None  # None where none are kept
    sensed: tuple[Any, ...] = ()  # what sensors remember
    rubbed: tuple[Any, ...] | None = None  # what friction did in the last step
    last: Any = None  # step that was taken, where reactions are read
    gas: Mapping[str, float] = field(default_factory=dict)  # blown into chambers so far, m³


class BesideState(NamedTuple):
    """What a body of a finer ROM that takes the same steps needs to go on from."""

    finer: SimulatorState
    from_rest: bool  # or from a state that was put in
    exceeded: "Exceeded | None"


class SimulatedBody(FilledBody):
    """A body as its stepper has it, in the words of its ROM; `Simulator` moves it."""

    steps: int
    loss: SwitchLoss
    _dt: float
    _since: tuple[float, int]  # time, s, and number of steps at which dt was last changed
    _origin: tuple[Any, ...]  # what it was made of, a ROM first
    _source: "EnvironmentInputs | None"
    _monitor: LinearityMonitor
    _output_rows: dict[tuple[str, str], Array]
    _order: int
    _width: int
    _safe_frequencies: Array
    _slices: tuple[str, dict[str, slice]] | None = None  # where inputs are, of a contact mode
    _skin: "SkinLooks | None" = None  # None where no obstacle can come through it
    tensions: TensionWatch

    def __repr__(self) -> str:
        model, steps = self._stepper.model, f"{self.steps} step{'' if self.steps == 1 else 's'}"
        columns = {"the contact in N": self.rom.contacts[self.contact]}
        units = self.rom.environment.input_units
        columns |= {f"{name} in {units.get(name, 'N')}": count for name, count in self.rom.actuators.items()}
        return (
            f"Simulator of {self.rom.name!r}: contact mode {self.contact} (order {model.order}), dt = {self._dt:g} s, "
            f"{steps} taken, {self.stepper}\n"
            f"  input: {', '.join(f'{count} of {name}' for name, count in columns.items())}"
        )

    @cached_property
    def _belongs(self) -> Belongs:
        """What a state of this is a state of."""
        obstacles = () if self.environment is None else tuple(self.environment.obstacles)
        return Belongs(self._origin[0].name, self._origin[0].identity, obstacles)

    @property
    def time(self) -> float:
        """Simulated time, s."""
        start, steps = self._since
        return start + (self.steps - steps) * self._dt

    def times_ahead(self, count: int) -> list[float]:
        """When so many steps begin, and the last of them ends, s."""
        start, steps = self._since
        return [start + (self.steps + k - steps) * self._dt for k in range(count + 1)]

    @property
    def contact(self) -> str:
        """The active contact mode."""
        return self._stepper.contact_mode

    @property
    def model(self) -> ContactModel:
        """Of the active contact mode; in a moving frame of what strains, with what the last switch carried along."""
        return self._stepper.model

    @property
    def inputs(self) -> int:
        """Length of the input: the contact mode's columns, then the actuators'."""
        return self._width

    @property
    def nearest_contact(self) -> str:
        """The contact mode that the next step is in: the active one, unless obstacles ask for another."""
        return self.contact if self._source is None else self._source.nearest(self._stepper)

    @property
    def needs_each_step(self) -> bool:
        """Whether what happens in a step is not known before it is taken."""
        return self._source is not None and self._source.needs_each_step

    @property
    def needs_single_steps(self) -> bool:
        """Whether a step is more than a linear map with contact, so that `rollout` takes each by itself."""
        return self.rom.deformation is not None or (self._source is not None and self._source.needs_single_steps)

    @property
    def takes_actuators_alone(self) -> bool:
        """Whether an input may leave the contact mode's columns out."""
        return self._source is not None

    @property
    def switches_itself(self) -> bool:
        """Whether the contact mode follows the obstacles."""
        return self._source is not None and self._source.switches

    @property
    def integrator(self) -> ReducedStepper:
        """What takes the steps; see mechanics.step."""
        return self._stepper

    @property
    def stepper(self) -> str:
        """How a step is taken: "midpoint", or one of those of large deformation."""
        return self._stepper.kind

    @property
    def stepping(self) -> str:
        """Why it is taken in that way."""
        return self._stepper.reason

    @property
    def energy(self) -> float:
        """Stored energy ½ vᵀMv + ½ xᵀKx, with large deformation ½ vᵀMv + Φ(x), and that of gas in chambers, J."""
        return self._stepper.energy + (0.0 if self.filling is None else self.filling.energy)

    @property
    def energy_coordinates(self) -> Array:
        """[√γ q, r] (2m,) of the active contact mode, which a later step overwrites; rigid motions have r only."""
        return self._stepper.state

    @property
    def relaxes(self) -> bool:
        """Whether the material does, by branches that have strains of their own."""
        return self._stepper.kernel.branches is not None

    @property
    def steps_in_blocks(self) -> bool:
        """Whether `step_in_block` can tell all that there is to read after each step."""
        return self._stepper.kernel.holds_steps and not self.rom.rigid and not self.rom.readings

    @property
    def mismatch(self) -> float | None:
        """Of the strains that linearly implicit steps carry along and those of the shape; None where there are none."""
        return self._stepper.kernel.notes.get("mismatch")

    @property
    def settings(self) -> dict[str, float]:
        """Of the run so far, what belongs beside its rate and error; see Trajectory."""
        return {
            "dt": self._dt,
            "order": max(model.order for model in self.rom.contact_models.values()),
            "first_frequency": self.rom.first_frequency,
            **({} if self.mismatch is None else {"mismatch": self.mismatch}),
            **({"beyond_training": 1.0} if self._stepper.kernel.beyond_training else {}),
        }

    @property
    def surface_peak(self) -> SurfaceStrainPeak:
        """How far the surface turned and strained, where the stored energy was high enough for a look at it."""
        return self._monitor.peak

    def _by_name(self, given: Any, named: Mapping[str, Any]) -> Array:
        """An input (p,) of a mapping, or of arguments with names."""
        if not isinstance(given, Mapping):
            if np.size(given):
                raise StepError(f"step {self.steps}: inputs were given by position and by name; use one of both")
            given = {}
        u, starts = np.zeros(self._width), self.input_slices()
        for name, value in {**given, **named}.items():
            if name not in starts:
                hint = "; switch to that contact mode first" if name in self.rom.contact_models else ""
                raise StepError(f"step {self.steps}: {unknown('input', name, starts)}{hint}")
            try:
                numbers = real_numbers(value).reshape(-1)
            except (TypeError, ValueError):
                numbers = np.empty(0)
            if numbers.shape != u[starts[name]].shape:
                allowed = f"{len(u[starts[name]])} real numbers"
                raise StepError(f"step {self.steps}: input {name!r} = {shown(value)}: use {allowed}")
            u[starts[name]] = numbers
        return u

    def input_slices(self) -> dict[str, slice]:
        """Where each input but loads is, in the active contact mode."""
        if self._slices is None or self._slices[0] != self.contact:
            starts, column = dict[str, slice](), 0
            for name, columns in self.rom.input_columns(self.contact).items():
                if name not in self.rom.loads:
                    starts[name] = slice(column, column + columns)
                column += columns
            self._slices = self.contact, starts
        return self._slices[1]

    def displacement(self, output: str | None = None) -> Array:
        """Displacement, m: of a named output (points, 3), or of every mesh node (nodes, 3).

        Without a mesh: the rows of the output, or all n displacements. Nodes that can be touched are where obstacles
        find them, with all that they yield; outputs have what of it lies in the shared basis.

        Raises:
            StepError: no such output.
        """
        field = self._field(self._q, output, self.beyond_shared)
        residual, interface = self._stepper.kernel.residual, self._stepper.interface
        if output is None and residual is not None and interface is not None:
            nodes = interface.points.nodes
            field[nodes] += residual.beyond_shared[: len(nodes)]
        return field

    def velocity(self, output: str | None = None) -> Array:
        """Velocity, m/s: of a named output (points, 3), or of every mesh node (nodes, 3).

        Of the basis: without the rate of what contact points yield beyond it, which has next to no mass.

        Raises:
            StepError: no such output.
        """
        return self._field(self._stepper.state[self._order :], output)

    def felt(self, name: str) -> Array:
        """As in ContactReadings."""
        from fenics_rom.runtime.readings import named_reading, readable  # here, as few bodies have readings

        reading, state = named_reading(self.rom, name), (self.contact, self._q, self.shape_coordinates)
        points, pushed = self._touch() or (None, None)
        of: dict[str, Any] = {"model": self.model, **self._acting_on(name)}
        if pushed is not None:
            of |= {"pressing": pushed.pressing, "forces": pushed.forces, "rubbing": self._rubbing}
            of["places"] = self.node_places
        return reading.read(readable(self.rom, *state, points, **of))

    def node_places(self) -> Array:
        """Of all nodes now, (N, 3) in world axes, m."""
        return self.rom.nodes + self.displacement()

    def output_rows(self, output: str) -> Array:
        """Rows of a named output, (rows, m), in the active contact mode's basis.

        Raises:
            StepError: no such output.
        """
        if not isinstance(output, str) or output not in self.rom.outputs:
            is_reading = isinstance(output, str) and output in self.rom.readings
            hint = "; it is a reading: Simulator.reading gives it" if is_reading else ""
            raise StepError(unknown("output", output, self.rom.outputs) + hint)
        key, model = (self.contact, output), self._stepper.model
        if model is not self.rom.contact_models[self.contact]:  # until the next switch
            return self.rom.outputs[output] @ model.coordinates
        if key not in self._output_rows:
            self._output_rows[key] = self.rom.outputs[output] @ model.coordinates
        return self._output_rows[key]

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the user should know of the run so far.

        A surface that went too far, a switch that lost much, contact that was not solved, obstacles in the body or
        that jumped.
        """
        through: tuple[str, ...] = ()
        if self._skin is not None:
            self._skin.look()
            through = self._skin.watch.messages
        pushed = push_messages(self.least_tensions)
        moved = () if self.environment is None else self.environment.messages
        own = self.surface_peak.summary, self.loss.message, *self._stepper.diagnostics(), *through, *pushed, *moved
        return tuple(filter(None, own))

    @property
    def least_tensions(self) -> dict[str, float]:
        """Least tensions, N, that tendons were given in the run so far, of those that were told to push."""
        self._stepper.flush()
        return self.tensions.least

    @property
    def _q(self) -> Array:
        q = self._stepper.state[: self._order] / self._safe_frequencies
        rigid = self._rigid_displacement()
        q[: len(rigid)] = rigid
        return q

    @property
    def beyond_shared(self) -> Array | None:
        """What contact points yield beyond the contact mode, in the shared basis, (k,); None where they do not."""
        residual = self._stepper.kernel.residual
        if residual is None:
            return None
        beyond = np.zeros(len(self.rom.stiffness))
        beyond[self.rom.rigid :] = residual.strained / np.sqrt(self.rom.stiffness[self.rom.rigid :])
        return beyond

    @property
    def shape_coordinates(self) -> Array:
        """The displacement in the shared basis, (k,); in a moving frame within it."""
        shape: Array = self._stepper.model.coordinates @ self._q
        return shape if self.beyond_shared is None else shape + self.beyond_shared

    def _field(self, coordinates: Array, output: str | None, beyond: Array | None = None) -> Array:
        """Of coordinates (m,) in the contact mode, and (k,) beside them in the shared basis."""
        if output is None:
            shape = self._stepper.model.coordinates @ coordinates
            return self.rom.reconstruct(shape if beyond is None else shape + beyond)
        rows = self.output_rows(output) @ coordinates
        return self.rom.by_point(rows if beyond is None else rows + self.rom.outputs[output] @ beyond)

    def _rigid_displacement(self) -> Array:
        """Along the rigid motions (ρ,), up to date."""
        if len(self._stepper.rigid_displacement) and self._stepper.kernel.holds_steps:  # others add to it in each step
            self._stepper.flush()
        return self._stepper.rigid_displacement
