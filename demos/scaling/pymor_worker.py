"""pyMOR's side of against_pymor.py, in a Python of its own, which needs nothing of this project.

    PYTHON pymor_worker.py MATRICES.npz RESULT.npz ORDERS SETTINGS

Reduces the second-order system in MATRICES for each input matrix by SOBTfvReductor, pyMOR's one-sided truncation by the
position Gramians, and writes the bases and the times. The observability Gramian does not depend on the inputs, and is
computed once.
"""

import json
import sys
import time

import numpy as np
import pymor
import scipy
from pymor.core.defaults import set_defaults
from pymor.core.logger import set_log_levels
from pymor.models.iosys import SecondOrderModel
from pymor.reductors.sobt import SOBTfvReductor
from scipy.sparse import csc_matrix

ADI = "pymor.solvers.matrix_equations.adi.ADILyapunovSolver"


def keep_gramians(settings: dict[str, dict[str, float]]) -> None:
    """Gives each kind of Gramian its settings, and all models the observability Gramian of the first."""
    compute, kept = SecondOrderModel.gramian, {}

    def gramian(self, typ, mu=None):
        key = typ if typ == "po_lr" else (typ, id(self))
        if key not in kept:
            set_defaults({f"{ADI}.{name}": value for name, value in settings.get(typ, {}).items()})
            kept[key] = compute(self, typ, mu)
        return kept[key]

    SecondOrderModel.gramian = gramian


def main(matrices: str, result: str, orders: str, settings: str) -> None:
    """Runs pyMOR."""
    set_log_levels({"pymor": "WARNING"})
    keep_gramians(json.loads(settings))
    given = np.load(matrices)
    size = len(given["C"])
    M, D, K = (
        csc_matrix((given[f"{a}_data"], given[f"{a}_indices"], given[f"{a}_indptr"]), (size, size)) for a in "MDK"
    )
    models = []
    found = {"versions": f"pyMOR {pymor.__version__}, NumPy {np.__version__}, SciPy {scipy.__version__}"}
    for name in (key for key in given if key.startswith("B_")):
        start = time.perf_counter()
        fom = SecondOrderModel.from_matrices(M, D, K, given[name], given["C"].T)
        models.append(fom)  # so that no two have the same id
        gramian = fom.gramian("pc_lr")
        found[f"seconds_pc_{name}"], middle = time.perf_counter() - start, time.perf_counter()
        found["columns_po"] = len(fom.gramian("po_lr"))
        found[f"seconds_po_{name}"], found[f"columns_pc_{name}"] = time.perf_counter() - middle, len(gramian)
        start = time.perf_counter()
        for order in map(int, orders.split(",")):
            reductor = SOBTfvReductor(fom)
            reductor.reduce(order)
            basis = reductor.V.to_numpy()
            found[f"basis_{order}_{name}"] = basis if len(basis) == size else basis.T
        found[f"seconds_rest_{name}"] = (time.perf_counter() - start) / len(orders.split(","))
    np.savez(result, **found)


main(*sys.argv[1:])
