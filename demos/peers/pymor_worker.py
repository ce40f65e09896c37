"""pyMOR's side of against_pymor.py, in a Python of its own, which needs nothing of this project.

    PYTHON pymor_worker.py MATRICES.npz RESULT.npz TASK

Reduces the second-order system in MATRICES for each of its input matrices, or steps it. TASK is JSON:

    {"what": "bases", "order": 40, "settings": {...}, "projection": "sr"}    times SOBTfvReductor; writes its directions
    {"what": "variants", "order": 20, "orders": [10, ...], "settings": {...}} writes the models of all its reductors,
                                                                              and how stable they are at some orders
    {"what": "steps", "dt": 1e-3, "steps": 2000, "input": [1, 0, 0]}         times its stepper on dense M, D, K, B, C

`settings` are those of pyMOR's low-rank Lyapunov solver by kind of Gramian. The observability Gramians do not depend on
the inputs, and are computed once for all of them.
"""

import json
import sys
import time

import numpy as np
import pymor
import scipy
from pymor.algorithms.timestepping import ImplicitMidpointTimeStepper
from pymor.core.defaults import set_defaults
from pymor.core.logger import set_log_levels
from pymor.models.iosys import LTIModel, SecondOrderModel
from pymor.reductors import sobt
from scipy.sparse import csc_matrix

ADI = "pymor.solvers.matrix_equations.adi.ADILyapunovSolver"
VARIANTS = ("SOBTfv", "SOBTp", "SOBTv", "SOBTpv", "SOBTvp", "SOBT")
PROJECTIONS = ("bfsr", "sr", "biorth")


def keep_gramians(settings):
    """Gives each kind of Gramian its settings, and all models the observability Gramians of the first."""
    compute, kept = SecondOrderModel.gramian, {}

    def gramian(self, typ, mu=None):
        key = typ if typ in ("po_lr", "vo_lr") else (typ, id(self))
        if key not in kept:
            set_defaults({f"{ADI}.{name}": value for name, value in settings.get(typ, {}).items()})
            kept[key] = compute(self, typ, mu)
        return kept[key]

    SecondOrderModel.gramian = gramian


def models(given):
    """The full-order model by input matrix."""
    size = len(given["C"])
    M, D, K = (
        csc_matrix((given[f"{a}_data"], given[f"{a}_indices"], given[f"{a}_indptr"]), (size, size)) for a in "MDK"
    )
    return {
        name: SecondOrderModel.from_matrices(M, D, K, given[name], given["C"].T)
        for name in given
        if name.startswith("B_")
    }


def columns(vectors, size):
    """An array of vectors as a matrix, a column each."""
    V = vectors.to_numpy()
    return V if len(V) == size else V.T


def dense(A, size):
    """A matrix of a reduced model, which may be left out where it is the identity."""
    return np.eye(size) if A is None else A.toarray() if hasattr(A, "toarray") else np.asarray(A)


def stability(rom, order):
    """The largest real part of an eigenvalue of a reduced model, 1/s."""
    M, D, K = (dense(A, order) for A in rom.to_matrices()[:3])
    zero, unit = np.zeros_like(M), np.eye(order)
    return np.linalg.eigvals(np.block([[zero, unit], [-np.linalg.solve(M, K), -np.linalg.solve(M, D)]])).real.max()


def bases(given, task):
    """Directions of SOBTfvReductor by input matrix, the most important first, and the times."""
    found = {}
    for name, fom in models(given).items():
        start = time.perf_counter()
        found[f"columns_pc_{name}"] = len(fom.gramian("pc_lr"))
        middle = time.perf_counter()
        found["columns_po"] = len(fom.gramian("po_lr"))
        end = time.perf_counter()
        reductor = sobt.SOBTfvReductor(fom)
        reductor.reduce(task["order"], projection=task["projection"])
        found[f"seconds_reduction_{name}"] = time.perf_counter() - end
        found[f"seconds_pc_{name}"], found[f"seconds_po_{name}"] = middle - start, end - middle
        found[f"basis_{name}"] = columns(reductor.V, fom.order)
    return found


def variants(given, task):
    """Models of every reductor and projection by input matrix, with both bases where there are two; or what it said."""
    found, foms, order = {}, models(given), task["order"]
    for name, fom in foms.items():
        for kind in ("pc_lr", "po_lr", "vc_lr", "vo_lr"):
            fom.gramian(kind)
        for variant in VARIANTS:
            for projection in PROJECTIONS:
                key = f"{variant}_{projection}_{name}"
                reductor, start = getattr(sobt, f"{variant}Reductor")(fom), time.perf_counter()
                try:
                    rom = reductor.reduce(order, projection=projection)
                except Exception as error:
                    found[f"failed_{key}"] = f"{type(error).__name__}: {error}"
                    continue
                found[f"seconds_{key}"] = time.perf_counter() - start
                for symbol, A in zip("MDKBC", rom.to_matrices(), strict=False):
                    found[f"{symbol}_{key}"] = dense(A, order)
                if variant != "SOBT":  # which has two pairs
                    found |= {f"{a}_{key}": columns(getattr(reductor, a), fom.order) for a in "VW"}
            for each in task["orders"]:
                rom = getattr(sobt, f"{variant}Reductor")(fom).reduce(each, projection="sr")
                found[f"stability_{variant}_{each}_{name}"] = stability(rom, each)
    return found


def steps(given, task):
    """Outputs of the reduced model in MATRICES under a constant input, and steps per second.

    By pyMOR's stepper, of the model as `to_lti` makes it under an input that is given as a function, as it comes; and
    of the same system from dense matrices under an input that is given as constant, which it steps the fastest.
    """
    h, count, u = task["dt"], task["steps"], np.array(task["input"], dtype=float)
    lti = SecondOrderModel.from_matrices(*(given[symbol] for symbol in "MDKBC")).to_lti()
    A, B, C, _, E = lti.to_matrices()
    plain = LTIModel.from_matrices(*(dense(X, lti.order) for X in (A, B, C)), E=dense(E, lti.order))
    stepper, found = ImplicitMidpointTimeStepper(count), {}
    for label, model, given_input in (("as_it_comes", lti, str(u.tolist())), ("fastest", plain, u)):
        timed = model.with_(T=count * h, time_stepper=stepper)
        start = time.perf_counter()
        found[f"outputs_{label}"] = timed.output(input=given_input)
        found[f"rate_{label}"] = count / (time.perf_counter() - start)
    return found


def main(matrices, result, task):
    """Runs pyMOR."""
    set_log_levels({"pymor": "ERROR"})
    task = json.loads(task)
    keep_gramians(task.get("settings", {}))
    with np.load(matrices) as file:
        given = dict(file)
    found = {"bases": bases, "variants": variants, "steps": steps}[task["what"]](given, task)
    found["versions"] = f"pyMOR {pymor.__version__}, NumPy {np.__version__}, SciPy {scipy.__version__}"
    np.savez(result, **found)


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    main(*sys.argv[1:])
