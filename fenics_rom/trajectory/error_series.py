"""What a reduced run stated of its own error over time: a bound, and an estimate."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from numpy import ndarray as Array

from fenics_rom.trajectory.series import ReadingSeries

PREFIX, OF, READ = "error ", "of ", "read "  # of what is kept of an instant, and of an output and a reading in it


@dataclass(frozen=True)
class ErrorSeries:
    """A bound, or an estimate.

    Attributes:
        why: it is one, in words.
        norm: in the energy norm √(vᵀMv + xᵀKx), (S,), J^1/2; None where it is not known.
        outputs: of named outputs (S, points, 3), m: a bound of each component, or an estimate to be added.
        shape: in the mass norm √(xᵀMx), (S,), kg^1/2 m; None of a bound, or where it is not known.
        readings: of readings without their sensors, to be added: by a finer ROM beside.
    """

    why: str
    norm: Array | None
    outputs: Mapping[str, Array]
    shape: Array | None = None
    readings: Mapping[str, ReadingSeries] = field(default_factory=dict)


@dataclass(frozen=True)
class ErrorTolerance:
    """An error that a reduced run was to keep to, and where it did not.

    Attributes:
        value: what the estimate of any output's error is to be no larger than, m.
        times: at which it was, (x,), s: the first one; of a run to which directions are added each one.
        errors: how large it was then, (x,), m, of
        outputs: these, x names.
        orders: of the active contact mode before and after, (x, 2).
    """

    value: float
    times: Array
    errors: Array
    outputs: tuple[str, ...]
    orders: Array


def stated_numbers(stated: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """What is kept of an instant: norms, each output as "of NAME", and each reading as "read NAME"."""
    return {
        PREFIX + kind: ({} if error.norm is None else {"norm": error.norm})
        | ({} if error.shape is None else {"shape": error.shape})
        | {OF + name: error.output(name) for name in error.names}
        | {READ + name: error.reading(name) for name in error.sensed}
        for kind, error in stated.items()
    }


def error_series(
    why: Mapping[str, str], kept: dict[str, Any], readings: Mapping[str, ReadingSeries]
) -> dict[str, ErrorSeries]:
    """Takes what was kept of all instants out of other such things; `readings` are the run's."""
    found = {}
    for kind, words in why.items():
        values = kept.pop(PREFIX + kind)
        norm, shape = values.pop("norm", None), values.pop("shape", None)
        outputs = {name.removeprefix(OF): of for name, of in values.items() if name.startswith(OF)}
        misread = {
            name: replace(of, values=values[READ + name]) for name, of in readings.items() if READ + name in values
        }
        found[kind] = ErrorSeries(words, norm, outputs, shape, misread)
    return found
