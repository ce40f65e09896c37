"""Relative errors of one run against another."""

import math
from dataclasses import dataclass

import numpy as np

from fenics_rom.errors import CompareError
from fenics_rom.trajectory.trajectory import Trajectory

Array = np.ndarray

SAME_TIME = 1e-9  # share of the run by which two instants may differ and be one
SMALLEST_TIME = 1e-300  # s, in place of zero


@dataclass(frozen=True)
class Difference:
    """How far one quantity of a run is from the reference.

    Attributes:
        relative: L² in time (and over the points, or in mass over the body), as a share of the reference's; inf where
            the reference is zero throughout and the run is not.
        largest: largest distance of any point at any instant, in the quantity's unit.
        largest_reference: largest length of the reference, to judge `largest` by.
        instants: number of common instants.
    """

    relative: float
    largest: float
    largest_reference: float
    instants: int


def compare(run: Trajectory, reference: Trajectory) -> dict[str, Difference]:
    """Differences per named output, of the whole shape ("shape", weighted by mass) and of the stored energy.

    Runs with different time steps are compared at the instants they have in common.

    Raises:
        CompareError: no common instants, or different bodies.

    Example:
        >>> fr.compare(run, run)["output tip"].relative
        0.0
    """
    first, second = common_instants(run.times, reference.times, "times")
    differences = {
        f"output {name}": _difference(values[first], reference.outputs[name][second])
        for name, values in run.outputs.items()
        if name in reference.outputs and values.shape[1] == reference.outputs[name].shape[1]
    }
    if run.snapshots.shape[1:] != reference.snapshots.shape[1:] or not np.allclose(run.nodes, reference.nodes):
        raise CompareError(
            f"the runs are of different meshes: {len(run.nodes)} and {len(reference.nodes)} nodes; "
            "outputs can be compared only of the same mesh"
        )
    of_run, of_reference = common_instants(run.snapshot_times, reference.snapshot_times, "whole shapes")
    weight = np.sqrt(reference.node_mass)[:, None]
    differences["shape"] = _difference(run.snapshots[of_run], reference.snapshots[of_reference], weight)
    differences["energy"] = _difference(run.energy[first, None], reference.energy[second, None])
    return differences


def common_instants(times: Array, reference: Array, what: str) -> tuple[Array, Array]:
    """Indices of the instants that two runs have in common, in each of them.

    Args:
        times, reference: ascending, s.
        what: they are instants of, for the message.

    Raises:
        CompareError: there is none after the start.
    """
    after = np.clip(np.searchsorted(reference, times), 1, max(len(reference) - 1, 1)) if len(reference) > 1 else 0
    nearest = np.zeros(len(times), dtype=int) + after
    if len(reference) > 1:
        nearest -= np.abs(reference[nearest - 1] - times) < np.abs(reference[nearest] - times)
    close = np.abs(reference[nearest] - times) <= SAME_TIME * max(np.abs(reference).max(), SMALLEST_TIME)
    if not (close & (times > 0)).any():  # at the start every run is at rest, and that says nothing
        raise CompareError(f"the runs have no common {what}; run both with time steps of which one divides the other")
    return np.flatnonzero(close), nearest[close]


def _difference(values: Array, reference: Array, weight: Array | float = 1.0) -> Difference:
    difference, size = values - reference, np.linalg.norm(weight * reference)
    distance = np.linalg.norm(difference, axis=-1)
    error = np.linalg.norm(weight * difference)
    return Difference(
        relative=float(error / size) if size > 0 else math.inf if error > 0 else 0.0,
        largest=float(distance.max()),
        largest_reference=float(np.linalg.norm(reference, axis=-1).max()),
        instants=len(values),
    )
