"""What a study has measured, as frozen records."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

from fenics_rom.trajectory.comparison import ForceErrors

RATE_RUNS = 5  # of which the fastest counts
PICTURES = ("speed", "orders", "parts")  # names of those that are drawn of a study


class Record:
    """What is kept in a file, which holds nothing else."""

    __pydantic_config__: ClassVar = {"extra": "forbid"}


class Timed(Record):
    """A row of a model at a time step `dt`, s, of which it makes a `rate` of steps per second."""

    dt: float
    rate: float

    @property
    def real_time(self) -> float:
        """Seconds simulated in a second."""
        return self.rate * self.dt


@dataclass(frozen=True)
class BenchmarkRow(Timed):
    """One reduced model at one time step. Errors are shares of the reference's size, L² in time, if not said otherwise.

    Of a study without a reference they are estimates, and as runs state them shares of their own size.

    Attributes:
        method: name of the method, as in STUDIED_METHODS.
        order: displacements of the contact mode that has most.
        dt: time step, s.
        error: of the whole shape in the mass norm, against the reference: all that reduction and time step do.
        largest: largest distance of any node at any instant, as a share of the largest displacement; None: not known.
        outputs: the same two numbers for each named output, of a moving frame also for the "elastic shape" (compare).
        energy: error of the stored energy; None: not known.
        forces: errors of each obstacle's force over the run, its peak and its impulse.
        reduction: error of the whole shape where the reduced model takes the reference's own step.
        time_step: distance of the whole shape from the same model at the reference's step.
        rate: steps per second, one by one, energy account kept, one thread.
        offline: seconds that its reduction took, without the assembly, with the validation.
        file_size: of the ROM, bytes.
        static_error, transfer_error: its validation, of the worst contact mode; None where there is none.
        neglected: share of the sum of σ left out, of the worst contact mode; None where the method has no σ.
        bound: of the reduction's error, in the energy norm; None: not known.
    """

    method: str
    order: int
    dt: float
    error: float
    largest: float | None
    outputs: Mapping[str, tuple[float, float]]
    energy: float | None
    reduction: float
    time_step: float
    rate: float
    offline: float
    file_size: int
    static_error: float | None
    transfer_error: float | None
    neglected: float | None
    forces: Mapping[str, ForceErrors] = field(default_factory=dict)
    bound: float | None = None


@dataclass(frozen=True)
class MeshRow(Record):
    """One mesh of the scene at full order.

    Attributes:
        file: its name.
        size: number of unknowns.
        outputs: distance of each named output from that of the finest mesh, as a share of its size, L² in time.
    """

    file: str
    size: int
    outputs: Mapping[str, float]


@dataclass(frozen=True)
class StudyResults(Record):
    """A study, finished or on its way.

    Attributes:
        name: of the scene.
        fingerprint: of the scene, its tables and its mesh, and of the reference's step.
        size: unknowns at full order.
        dt: the scene's time step, s.
        duration: of the runs, s.
        reference_step: s.
        reference_error: what the reference's own step does to its whole shape: its distance from the run at twice the
            step, divided by `divisor`, which is 3 where the midpoint rule converges with the square of the step, and 1
            with contact. Without a reference it is told by the largest reduced model of the first method.
        divisor: see there.
        reference_forces: the same of the forces of each obstacle: over the run, peak, impulse.
        rate_runs: runs of which the fastest tells the rate of a reduced model.
        full_rate: steps per second at full order: without an account, where all steps cost the same; with contact those
            of a whole run, with one. None: full order was not run, and errors are estimates.
        full_step: of these, s, where it matters; None: it does not.
        compared_with: order of the reduced model that stands in for full order; None: none does.
        tried: methods and orders that are done, as they were asked for.
        rows: reduced models at each step.
        meshes: the scene's mesh and finer ones, the finest last; empty where none was given.
        hankel: σ of each contact mode.
        notes: what the user should know.
    """

    name: str
    fingerprint: str
    size: int
    dt: float
    duration: float
    reference_step: float
    reference_error: float
    divisor: float
    full_rate: float | None
    full_step: float | None = None
    compared_with: int | None = None
    rate_runs: int = RATE_RUNS
    tried: tuple[tuple[str, int], ...] = ()
    rows: tuple[BenchmarkRow, ...] = ()
    meshes: tuple[MeshRow, ...] = ()
    reference_forces: Mapping[str, ForceErrors] = field(default_factory=dict)
    hankel: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @property
    def without_reference(self) -> bool:
        """Whether errors are estimates, as full order was not run."""
        return self.full_rate is None

    @property
    def error_name(self) -> str:
        """What errors are called."""
        return "estimated error" if self.without_reference else "error"

    @property
    def mesh_error(self) -> float | None:
        """Largest distance of an output from that of the finest mesh; None where no finer mesh was given."""
        return max(self.meshes[0].outputs.values()) if self.meshes else None

    @property
    def smallest_error(self) -> float | None:
        """The least error of a row; None where there is none."""
        return min((row.error for row in self.rows), default=None)

    def of(self, method: str, order: int) -> tuple[BenchmarkRow, ...]:
        """The rows of one reduced model."""
        return tuple(row for row in self.rows if (row.method, row.order) == (method, order))
