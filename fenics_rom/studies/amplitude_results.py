"""What a study of amplitudes has measured, as frozen records."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fenics_rom.io.json_record import read_record


@dataclass(frozen=True)
class AmplitudeRow:
    """A model at one load.

    Attributes:
        share: of the scene's loads.
        displacement: largest of any node at any instant, in the reference, m.
        model: "linear" or "nonlinear", "full order" or "reduced", and of the nonlinear reduced one the stepper.
        order: displacements.
        dt: s.
        error: of the whole shape, L² in time and mass, as a share of the reference's size; of the reference itself an
            estimate.
        rate: steps per second.
    """

    share: float
    displacement: float
    model: str
    order: int
    dt: float
    error: float
    rate: float

    @property
    def real_time(self) -> float:
        """Seconds simulated in a second."""
        return self.rate * self.dt


@dataclass(frozen=True)
class AmplitudeResults:
    """What a study of amplitudes has measured.

    Attributes:
        name: of the scene.
        fingerprint: of what it was measured for.
        unknowns: at full order.
        offline: seconds that the reductions took, by ROM.
        validation: error of the nonlinear ROM on a run that it was not trained on; None where it was not measured.
        rows: by load, the smallest first.
        notes: what the user should know.
    """

    name: str
    fingerprint: str
    unknowns: int
    offline: Mapping[str, float]
    validation: float | None
    rows: tuple[AmplitudeRow, ...] = ()
    notes: tuple[str, ...] = ()


def read_amplitude_results(file: Path) -> AmplitudeResults:
    """Reads the results of a study of amplitudes.

    Raises:
        FileError: there is no such file, or it holds something else.
    """
    return read_record(file, "a study of amplitudes", _build)


def _build(fields: dict[str, Any]) -> AmplitudeResults:
    rows = tuple(AmplitudeRow(**row) for row in fields.pop("rows"))
    return AmplitudeResults(rows=rows, notes=tuple(fields.pop("notes")), **fields)
