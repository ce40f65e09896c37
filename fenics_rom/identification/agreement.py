"""Whether data have the scene's units and axes, by what it predicts at its start values, before anything is fitted.

Wrong start values change how large and how fast a motion is; a wrong unit changes it by far more, and a wrong axis or
sign changes its direction. Directions are compared at moduli up to 30 times off, each with a factor that is free, and
are refused only where other directions fit far better than those given.
"""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from itertools import permutations, product
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import DataError, SolverError
from fenics_rom.fem.ranks import run_on_rank_0
from fenics_rom.identification.experiment import Experiment
from fenics_rom.identification.fit import FitProblem
from fenics_rom.identification.marker_data import AXES, Marker
from fenics_rom.identification.parameters import FIRST_CLOCK, YOUNG, is_tilting
from fenics_rom.identification.recording import JointModel, Model
from fenics_rom.identification.reduced_model import ReducedModel

HONEST_FACTOR = 60.0  # that displacements may be off by: twice that of a modulus 30 times off, at rest
MODULI = 30.0 ** np.linspace(-1, 1, 27)  # times the start values: from one to the next a frequency moves by 14 %
LARGE = 0.1  # of the largest column that is predicted: what counts
ALIKE = 0.1  # share left of a column that is predicted but for a factor
WRONG = 0.4  # share left of data whose directions are wrong: 40 degrees from those predicted
WRONG_OF_TILTS = 0.8  # where gravity may be tilted: 63 degrees
RIGHT = 0.2  # share left where directions are right
FAR_BETTER = 5.0  # times less is left
SUSPECT, PLAIN = 0.15, 30.0  # so much left is wrong, too, where so many times less is left: 23 degrees, without noise
SIMPLER = 2.0  # times as much may be left of what needs fewer changes, and RIGHT / 10 more


class _Reading(NamedTuple):
    """A way to read a file: of which axis of the scene its values are, (n,), and with which sign, (n,)."""

    axis: Array
    sign: Array
    changes: int = 0
    description: str = ""

    def of(self, said: Array) -> Array:
        """What the file would hold (n,), of predictions along all axes (n, 3)."""
        values: Array = self.sign * said[np.arange(len(said)), self.axis]
        return values


def check_agreement(problem: FitProblem, model: JointModel) -> None:
    """Refuses (DataError) data of another unit, axis or sign than the scene predicts.

    Args:
        problem: whose start counts.
        model: made there.
    """
    tilting, late = is_tilting(problem.parameters), any(p.column >= FIRST_CLOCK for p in problem.parameters)

    def check() -> None:
        for experiment, own in zip(problem.experiment.parts, model.models, strict=True):
            _check_part(experiment, own, problem.start, tilting, late)

    run_on_rank_0(problem.comm, check)


def _check_part(experiment: Experiment, model: Model, θ: Array, tilting: bool, late: bool) -> None:
    files, _, columns = (np.array(each) for each in zip(*experiment.places, strict=True))
    axes = np.array([marker.axis for marker in experiment.markers])[experiment.marker]
    said, others = _along_all_axes(experiment, model, θ), list[Array]()
    for file in dict.fromkeys(files.tolist()):
        own = files == file
        measured, as_given = experiment.measured[own], _Reading(axes[own], np.ones(own.sum()))
        _check_units(file, columns[own], measured, as_given.of(said[own]))
        if _left(measured, as_given.of(said[own])) <= (WRONG_OF_TILTS if tilting else SUSPECT):
            continue
        others = others or [said, *_with_other_moduli(experiment, model, θ)]
        predicted = [each[own] for each in others]
        left = min(_left(measured, as_given.of(each)) for each in predicted)
        signed = not (late and own[: len(experiment.times)].any())  # half a period late, a motion has the other sign
        better = [
            (min(_left(measured, reading.of(each)) for each in predicted), reading)
            for reading in _readings(axes[own], columns[own], signed)
        ]
        least = min((each for each, _ in better), default=1.0)
        plain = not tilting and left > SUSPECT and PLAIN * least < left
        if plain or (left > (WRONG_OF_TILTS if tilting else WRONG) and least < RIGHT and FAR_BETTER * least < left):
            good = (reading for each, reading in better if each <= SIMPLER * least + RIGHT / 10)
            raise DataError(
                f"{file}: {min(good, key=lambda reading: reading.changes).description}: so read, all but "
                f"{least:.1%} of its squares is what the scene predicts with moduli near its start values, times a "
                f"common factor; as given {left:.0%} is not. Correct the sign or the axes of the file, or of the "
                "scene's loads"
            )


def _along_all_axes(experiment: Experiment, model: Model, θ: Array) -> Array:
    """What a model says of each value, were it of the x, y and z axis, (N, 3), m; NaN where it does not know."""
    said = np.full((len(experiment.measured), 3), np.nan)
    number = {marker: k for k, marker in enumerate(experiment.markers)}
    for axis in range(3):
        markers = tuple(Marker(marker.output, marker.point, axis) for marker in experiment.markers)
        if isinstance(model, ReducedModel):  # knows all rows of outputs
            said[:, axis] = model.predict(replace(experiment, markers=markers), θ)
        else:
            other = np.array([number.get(marker, -1) for marker in markers])[experiment.marker]
            predicted = model.predict(replace(experiment, marker=other), θ)
            said[other >= 0, axis] = predicted[other >= 0]
    return said


def _with_other_moduli(experiment: Experiment, model: Model, θ: Array) -> Iterator[Array]:
    for factor in MODULI:
        other = θ.copy()
        other[:-1, YOUNG] *= factor
        with suppress(SolverError):  # of large deformation there may be no such run
            yield _along_all_axes(experiment, model, other)


def _check_units(file: str, columns: Array, measured: Array, said: Array) -> None:
    """Refuses columns that are too much larger or smaller than predicted."""
    names, number = np.unique(columns, return_inverse=True)
    size, predicted = (np.sqrt(np.bincount(number, each**2)) for each in (measured, said))
    large = (predicted > LARGE * predicted.max()) & (size > 0)
    ratio = size / np.where(large, predicted, 1.0)
    # of what another axis moves nothing may be left: only what is alike is of another unit
    alike = np.array([_left(measured[number == k], said[number == k], signed=False) < ALIKE for k in range(len(names))])
    alike |= bool(large.any()) and ratio[large].max() < 1 / HONEST_FACTOR
    for off in (large & (ratio > HONEST_FACTOR), large & (ratio < 1 / HONEST_FACTOR) & alike):
        if off.any():
            factor = np.linalg.norm(size[off]) / np.linalg.norm(predicted[off])
            which = "its displacements" if off[large].all() else ", ".join(names[off])
            written, true = ("mm", "m") if factor > 1 else ("m", "mm")
            near = 1 / HONEST_FACTOR < factor / (1e3 if factor > 1 else 1e-3) < HONEST_FACTOR
            thousand = f", as where {written} are written under a heading in {true}" if near else ""
            raise DataError(
                f"{file}: along {_axes_of(names[off])}, {which} measure {factor:.2g} times what the scene predicts at "
                f"its start values{thousand}. Correct the unit in the heading, or the unit of a force; start values "
                f"may be off by as much as a factor of {HONEST_FACTOR:g}"
            )


def _axes_of(columns: Array) -> str:
    return ", ".join(sorted({column[-1] for column in columns.tolist()}))


def _left(measured: Array, said: Array, *, signed: bool = True) -> float:
    """Share of the squares of values that is left of them less the best multiple of predictions, positive if signed."""
    common, squares = float(measured @ said), float(said @ said) * float(measured @ measured)
    if not (np.isfinite(squares) and squares > 0) or (signed and common < 0):
        return 1.0
    return max(1 - common * common / squares, 0.0)


def _readings(axes: Array, columns: Array, signed: bool) -> Iterator[_Reading]:
    """Signs of axes or of one column turned, and axes interchanged."""
    seen, names = np.unique(axes), np.unique(columns)
    for order in permutations(range(3)):
        moved = [axis for axis in seen.tolist() if order[axis] != axis]
        taken = ", ".join(f"{AXES[axis]} is the scene's {AXES[order[axis]]}" for axis in moved)
        for turned in product((1.0, -1.0), repeat=len(seen)) if signed else [(1.0,) * len(seen)]:
            signs = np.ones(3)
            signs[seen] = turned
            flipped = [AXES[axis] for axis in seen.tolist() if signs[axis] < 0]
            if not (moved or flipped):
                continue
            said = [taken] if taken else []
            if flipped:
                said.append(f"the sign of {' and '.join(flipped)} is turned (a factor of -1)")
            yield _Reading(np.array(order)[axes], signs[axes], 2 * len(moved) + len(flipped), _seems(said))
    for name in names.tolist() if signed and len(names) > 1 else ():
        sign = np.where(columns == name, -1.0, 1.0)
        yield _Reading(axes, sign, 1, _seems([f"the sign of {name} is turned (a factor of -1)"]))


def _seems(changes: list[str]) -> str:
    return f"it seems that {' and '.join(changes)}"
