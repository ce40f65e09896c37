"""Errors of a reduced run: against the reference, or without one as far as runs state them.

Let r be the error of the reduction at the reference's step, and t the distance of the run from the same model there,
both of the whole shape. The error against the reference is between |r - t| and r + t. Without a reference r is what the
run states of itself, t is known, and the error is taken to be √(r² + t²): what a basis lacks are fast shapes, what a
step gets wrong is when the slow ones come.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError
from fenics_rom.trajectory.comparison import Difference, common_instants, compare, force_errors
from fenics_rom.trajectory.trajectory import Trajectory

RowErrors = Callable[[Trajectory], dict[str, Any]]  # of a run, by fields of BenchmarkRow


def against_reference(at_reference_step: Trajectory, reference: Trajectory) -> RowErrors:
    """Errors of runs of a model against the full order; its run at the same step has that of the reduction alone."""
    reduction = compare(at_reference_step, reference)["shape"].relative

    def errors_of(run: Trajectory) -> dict[str, Any]:
        differences = compare(run, reference)
        shape = differences["shape"]
        return {
            "error": shape.relative,
            "largest": shape.largest / shape.largest_reference,
            "outputs": {
                name.removeprefix("output "): (d.relative, _largest(d))
                for name, d in differences.items()
                if name.startswith("output ") or name == "elastic shape"
            },
            "energy": differences["energy"].relative,
            "reduction": reduction,
            "time_step": compare(run, at_reference_step)["shape"].relative,
            "forces": force_errors(differences),
        }

    return errors_of


def without_reference(at_reference_step: Trajectory) -> RowErrors:
    """Errors of runs of a model, of which one stated its own; what only the full order tells is None.

    Raises:
        StepError: the run does not state the error of its shape.
    """
    run, stated = at_reference_step, at_reference_step.errors
    estimate = stated.get("estimate")
    if estimate is None or estimate.shape is None:
        reason = "it states none" if estimate is None else "dashpots couple how it moves as a whole with how it strains"
        raise StepError(f"without a reference the error of the shape is not known: {reason}")
    rows, _ = common_instants(run.times, run.snapshot_times, "whole shapes")
    weight = np.sqrt(run.node_mass)[:, None]
    reduction = _share(estimate.shape[rows], weight * run.snapshots)
    norm = stated["bound"].norm if "bound" in stated else None
    bound = None if norm is None else _share(norm[rows], np.sqrt(2 * run.energy[rows]))
    of_outputs = {
        name: (
            _share(off, run.outputs[name]),
            _share(*(_lengths(of).max(keepdims=True) for of in (off, run.outputs[name]))),
        )
        for name, off in estimate.outputs.items()
    }

    def errors_of(other: Trajectory) -> dict[str, Any]:
        differences = compare(other, run)
        time_step = differences["shape"].relative
        return {
            "error": math.hypot(reduction, time_step),
            "largest": None,
            "outputs": {
                name: (math.hypot(relative, d.relative), math.hypot(largest, _largest(d)))
                for name, (relative, largest) in of_outputs.items()
                for d in (differences[f"output {name}"],)
            },
            "energy": None,
            "reduction": reduction,
            "time_step": time_step,
            "bound": bound,
        }

    return errors_of


def _largest(difference: Difference) -> float:
    """The largest distance as a share of the largest length."""
    return difference.largest / difference.largest_reference if difference.largest else 0.0


def _lengths(points: Array) -> Array:
    return np.linalg.norm(points, axis=-1)


def _share(error: Array, whole: Array) -> float:
    """Of 2-norms."""
    size, off = (float(np.linalg.norm(of)) for of in (whole, error))
    return off / size if size > 0 else math.inf if off > 0 else 0.0
