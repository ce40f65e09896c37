"""Relative errors of one run against another."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import CompareError
from fenics_rom.io.given import object_or_file
from fenics_rom.mechanics.base_path import CONJUGATE, quaternion_product, rotation_vectors
from fenics_rom.trajectory.elastic_part import elastic_part
from fenics_rom.trajectory.file import RUN_FILE
from fenics_rom.trajectory.trajectory import Trajectory

SAME_TIME = 1e-9  # share of the run by which two instants may differ and be one
SMALLEST_TIME = 1e-300  # s, in place of zero
FORCE_MEASURES = ("force", "peak force", "impulse")  # of an obstacle
ForceErrors = tuple[float, float, float]


@dataclass(frozen=True)
class Difference:
    """How far one quantity of a run is from the reference.

    Attributes:
        relative: L² in time (and over the points, or in mass over the body), as a share of the reference's; inf where
            the reference is zero throughout and the run is not.
        largest: largest distance of any point at any instant, in the quantity's unit.
        largest_reference: largest length of the reference, to judge `largest` by.
        instants: number of common instants.
        unit: of the lengths.
    """

    relative: float
    largest: float
    largest_reference: float
    instants: int
    unit: str = "m"


def compare(
    run: Trajectory | str | PathLike[str], reference: Trajectory | str | PathLike[str]
) -> dict[str, Difference]:
    """Differences of outputs, readings, reactions, whole shape ("shape", weighted by mass), stored energy and contact.

    Of a moving frame there is also "elastic shape", each shape less its nearest rigid motion, and the pose, the wrench
    of the base and the momenta.

    Runs, or the files of them, with different time steps are compared at the instants they have in common. Of every
    obstacle there is "force" (means between these instants, in the 2-norm over the run), "peak force" (the largest of
    them) and "impulse" (what it has given the body at the last one). What the time step itself does is not seen where
    both have the same one: for that compare the reference with one at half its step.

    Raises:
        CompareError: no common instants, or different bodies.
        SceneError, FileError: something else than two runs was given.

    Example:
        >>> fr.compare(run, run)["output tip"].relative
        0.0
    """
    return _differences(object_or_file("compare", run, RUN_FILE), object_or_file("compare", reference, RUN_FILE))


def _differences(run: Trajectory, reference: Trajectory) -> dict[str, Difference]:
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
    shapes = run.snapshots[of_run], reference.snapshots[of_reference]
    differences["shape"] = _difference(*shapes, weight)
    if run.pose is not None or reference.pose is not None:
        of_one, of_other = (elastic_part(of, reference.nodes, reference.node_mass) for of in shapes)
        differences["elastic shape"] = _difference(of_one, of_other, weight)
    differences["energy"] = _difference(run.energy[first, None], reference.energy[second, None], unit="J")
    for name, reading in run.readings.items():
        values, quantity = reading.by_point[first], reading.quantity
        other = reference.readings.get(name)
        if other is not None and other.quantity == quantity and other.values.shape[1:] == reading.values.shape[1:]:
            differences[f"reading {name}"] = _difference(values, other.by_point[second], unit=reading.unit)
    for name, series in run.reaction_series.items():
        if name in reference.reactions:
            of_reference = reference.reaction_series[name].values[second]
            differences[f"reaction {name}"] = _difference(series.values[first], of_reference, unit=series.unit)
    for name, series in run.frame_series.items():
        if name in reference.frame_series:
            values, expected = series.values[first], reference.frame_series[name].values[second]
            if name == "rotation":  # the turn from the one to the other, beside how far the reference has turned
                error = rotation_vectors(quaternion_product(values, expected * CONJUGATE))
                expected = rotation_vectors(expected)
                values = expected + error
            differences[name] = _difference(values, expected, unit="rad" if name == "rotation" else series.unit)
    for name in run.forces:
        if name in reference.forces:
            differences |= _force_differences(name, run, reference, first, second)
    return differences


def _force_differences(
    name: str, run: Trajectory, reference: Trajectory, first: Array, second: Array
) -> dict[str, Difference]:
    """Of what an obstacle does to the body, by impulses: a force in a run is the mean over the step that ends there."""
    moving = second > 0
    given, expected = (
        np.cumsum(each.forces[name][1:] * np.diff(each.times)[:, None], axis=0)[at[moving] - 1]
        for each, at in ((run, first), (reference, second))
    )
    durations = np.diff(reference.times[second[moving]], prepend=reference.times[0])[:, None]
    mean, expected_mean = (np.diff(impulse, axis=0, prepend=0.0) / durations for impulse in (given, expected))
    peak, expected_peak = (np.linalg.norm(force, axis=1).max(keepdims=True)[None] for force in (mean, expected_mean))
    return {
        f"force of {name}": _difference(mean, expected_mean, np.sqrt(durations), "N"),
        f"peak force of {name}": _difference(peak, expected_peak, unit="N"),
        f"impulse of {name}": _difference(given[-1:], expected[-1:], unit="N s"),
    }


def force_errors(differences: Mapping[str, Difference]) -> dict[str, ForceErrors]:
    """Relative errors of contact forces by obstacle: of the force over the run, its peak, and the impulse."""
    names = [name.removeprefix("impulse of ") for name in differences if name.startswith("impulse of ")]
    return {
        name: tuple(differences[f"{what} of {name}"].relative for what in FORCE_MEASURES)  # type: ignore[misc]
        for name in names
    }


def common_instants(times: Array, reference: Array, what: str) -> tuple[Array, Array]:
    """Indices of the instants that two runs have in common, in each of them.

    Args:
        times, reference: ascending, s.
        what: they are instants of, for the message.

    Raises:
        CompareError: there is none after the start.
    """
    nearest = np.searchsorted((reference[1:] + reference[:-1]) / 2, times)
    close = np.abs(reference[nearest] - times) <= SAME_TIME * max(np.abs(reference).max(), SMALLEST_TIME)
    if not (close & (times > 0)).any():  # at the start every run is at rest, and that says nothing
        raise CompareError(f"the runs have no common {what}; run both with time steps of which one divides the other")
    return np.flatnonzero(close), nearest[close]


def _difference(values: Array, reference: Array, weight: Array | float = 1.0, unit: str = "m") -> Difference:
    difference, size = values - reference, np.linalg.norm(weight * reference)
    distance = np.linalg.norm(difference, axis=-1)
    error = np.linalg.norm(weight * difference)
    return Difference(
        relative=float(error / size) if size > 0 else math.inf if error > 0 else 0.0,
        largest=float(distance.max()),
        largest_reference=float(np.linalg.norm(reference, axis=-1).max()),
        instants=len(values),
        unit=unit,
    )
