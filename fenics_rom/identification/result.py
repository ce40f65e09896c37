"""The result of an identification: values with intervals, and every reason that is known to doubt them."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy import ndarray as Array

from fenics_rom.identification.experiment import Experiments
from fenics_rom.identification.parameters import Parameter
from fenics_rom.identification.uncertainty import CONFIDENCE, interval_half_widths
from fenics_rom.scene.scene import Scene

HIGH_CORRELATION = 0.95  # correlation from which intervals of single parameters say less than they seem to
MAX_NOISE_CORRELATION = 0.3  # correlation of neighbours in time that residuals without a system do not have
SIGNIFICANCE = 4.0  # standard errors that it has to be away from 0
POOR_FIT_SHARE = 0.2  # of what was measured, that residuals may be
MAX_SHIFT = 0.25  # of half an interval, that an approximation may move a parameter by
NEGLIGIBLE_SHARE = 1e-6  # of a parameter, that nobody would care for


@dataclass(frozen=True)
class Given:
    """A value that was held, and on which an estimate rests.

    Attributes:
        parameter: whose start value was held.
        step: by which it is changed to see that, in its unit.
        shift: what the estimate moves by then, in the estimate's unit.
    """

    parameter: Parameter
    step: float
    shift: float


@dataclass(frozen=True)
class Estimate:
    """One parameter.

    Attributes:
        parameter: with its start value.
        value: found, or the start value where it is held.
        low, high: 95 % interval, all others that were found free; None where it is held.
        held: why it could not be found; empty where it was.
        given: the held values on which value and interval rest: they are right where those are.
    """

    parameter: Parameter
    value: float
    low: float | None
    high: float | None
    held: str = ""
    given: tuple[Given, ...] = ()


@dataclass(frozen=True)
class Identification:
    """What was found.

    Attributes:
        scene: with the values found; its text is still the one it was read from.
        estimates: of all parameters that were sought.
        correlations: of the errors of those found, in their order, (p, p).
        noise: s, standard deviation of a single value, estimated from the residuals, m.
        experiment: what was measured.
        predicted: by the reduced model, (N,), m.
        full: by the full order, (N,), m.
        finer: by the reduced model with steps half as long, (N,), m.
        jacobian: of the predictions, with respect to the coordinates q of those found, (N, p), m.
        full_order_jacobian: whether it is of differences of full-order runs, as where a body deforms largely; otherwise
            it is exact, of the reduced model.
        order: displacements of the reduced model.
        bases: how many were made on the way.
        warnings: what the user should know.
        read_files: those of the scenes and of the data.

    Example:
        >>> result = fr.identify(scene, ["markers.csv"], parameters=["young"])
        >>> young = result.estimates[0]
        >>> young.low <= young.value <= young.high  # Pa
        True
    """

    scene: Scene
    estimates: tuple[Estimate, ...]
    correlations: Array
    noise: float
    experiment: Experiments
    predicted: Array
    full: Array
    finer: Array
    jacobian: Array
    full_order_jacobian: bool
    order: int
    bases: int
    warnings: tuple[str, ...] = ()
    read_files: tuple[Path, ...] = ()

    @property
    def values(self) -> dict[str, float]:
        """Those that the data tell, by name, in SI units."""
        return {estimate.parameter.name: estimate.value for estimate in self.found}

    @property
    def found(self) -> tuple[Estimate, ...]:
        """Those that the data tell."""
        return tuple(estimate for estimate in self.estimates if not estimate.held)

    @property
    def residual(self) -> float:
        """Root mean square of what the reduced model leaves, m."""
        return rms(self.experiment.measured - self.predicted)

    @property
    def full_residual(self) -> float:
        """Root mean square of what the full order leaves at the same values, m."""
        return rms(self.experiment.measured - self.full)

    @property
    def shifts(self) -> dict[str, Array]:
        """By how much an approximation moves each parameter found, (p,), as shares of half its interval.

        `reduction`: the full order instead of the reduced model; `time step`: steps that are infinitely short.
        """
        return {
            "reduction": self._shift(self.full - self.predicted),
            "time step": self._shift((self.finer - self.predicted) * 4 / 3),  # errors are of second order
        }

    def _shift(self, change: Array) -> Array:
        moved = np.abs(np.linalg.lstsq(self.jacobian, change, rcond=None)[0])
        half = interval_half_widths(self.experiment.measured - self.predicted, self.jacobian)
        return np.where(moved < NEGLIGIBLE_SHARE, 0.0, moved / half)


def rms(values: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def list_doubts(result: Identification) -> list[str]:
    """What of the fit the user should know."""
    messages = []
    names = [estimate.parameter.name for estimate in result.found]
    for i, j in zip(*np.triu_indices(len(names), 1), strict=True):
        if abs(result.correlations[i, j]) > HIGH_CORRELATION:
            messages.append(
                f"{names[i]} and {names[j]} are known together rather than each alone: their errors correlate by "
                f"{result.correlations[i, j]:.3f}"
            )
    measured = rms(result.experiment.measured)
    if result.residual > POOR_FIT_SHARE * measured:
        messages.append(
            f"the fit is poor: it leaves {result.residual / measured:.0%} of what was measured (root mean squares)"
        )
    correlation, pairs = successive_correlation(result)
    largest_of_noise = max(MAX_NOISE_CORRELATION, SIGNIFICANCE / np.sqrt(max(pairs, 1)))
    if correlation > largest_of_noise and result.residual > NEGLIGIBLE_SHARE * measured:
        messages.append(
            f"the residuals are not like noise: from one instant to the next they correlate by {correlation:.2f}. The "
            "model lacks something, and the intervals, which count noise alone, are too narrow"
        )
    cures = {"reduction": "this should not be: please report it", "time step": "a smaller run.dt is the cure"}
    for name, shift in result.shifts.items():
        k = int(np.argmax(shift))
        if shift[k] > MAX_SHIFT:
            messages.append(
                f"the {name} moves {names[k]} by {shift[k]:.2g} times half its {CONFIDENCE:.0%} interval; {cures[name]}"
            )
    return messages


def successive_correlation(result: Identification) -> tuple[float, int]:
    """Correlation of residuals of the same marker at instants that follow one another, and of how many pairs."""
    moving = len(result.experiment.times)
    residual = (result.experiment.measured - result.predicted)[:moving]
    where = [(file, column) for file, _, column in result.experiment.places[:moving]]
    products, pairs = 0.0, 0
    for series in dict.fromkeys(where):
        r = residual[[other == series for other in where]]  # in the order of the file, which is that of time
        products += float(r[1:] @ r[:-1])
        pairs += len(r) - 1
    total = float(residual @ residual)
    return (products / total if total > 0 else 0.0), pairs
