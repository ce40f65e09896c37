"""The basis that identification works on: of the scene at some values, for what pushes it and what is seen of it.

What the markers see counts like a force on them: with K⁻¹C of the outputs in the basis, what a reduced model says is
right to second order, and so is how that changes with the parameters.
"""

import warnings
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fenics_rom.errors import FenicsRomWarning
from fenics_rom.identification.experiment import Experiment
from fenics_rom.identification.marker_data import Marker
from fenics_rom.reduction.reduce import reduce
from fenics_rom.system.system import System

Array = np.ndarray

BALANCED_TOLERANCE = 1e-4  # share of the sum of σ that is left out
STATIC_TOLERANCE = 1e-14  # and of compliance: nothing
MARKER_CONTACT = "the markers"  # as a contact mode
RANK_TOLERANCE = 1e-10  # share of a unit column that must be new for it to count as a direction


def make_basis(system: System, experiment: Experiment) -> Array:
    """Q (rows here, k), QᵀQ = I; every rank must call it.

    Args:
        system: the full-order model at the values that the basis is to be best at.
        experiment: what it has to answer.

    Raises:
        SolverError: as `reduce`.
    """
    marker_columns = _columns(system, experiment.markers)
    bases = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FenicsRomWarning)  # the final check says what holds of the full model
        for method, inputs, tolerance in (
            ("balanced", experiment.inputs, BALANCED_TOLERANCE),
            ("static", experiment.rest_inputs, STATIC_TOLERANCE),
        ):
            if inputs:
                contacts = {name: system.contacts[name] for name in inputs} | {MARKER_CONTACT: marker_columns}
                acting = replace(system, contacts=contacts, contact_points={})
                bases.append(reduce(acting, method=method, tolerance=tolerance, switching="energy").basis)
    columns = np.hstack(bases)
    U, s, _ = np.linalg.svd(columns / np.linalg.norm(columns, axis=0), full_matrices=False)
    return U[:, s > RANK_TOLERANCE * s[0]][system.algebra.rows()]


def _columns(system: System, markers: Sequence[Marker]) -> Array:
    """Those of the outputs' columns that are measured, (rows here, n)."""
    return np.stack([system.outputs[m.output][:, m.row] for m in markers], axis=1)
