"""Exudyn's side of against_exudyn.py, in a Python of its own, which needs nothing of this project.

    PYTHON exudyn_worker.py BODY.npz RESULT.npz TASK

Lets the body in BODY (node positions, M and K) spin freely, by `ObjectFFRFreducedOrder`. TASK is JSON:

    {"kind": "free modes", "modes": 8, "beta": 1e-9, "dt": 1e-4, "duration": 0.1, "every": 1e-3,
     "spin": [314.0, 0.0, 0.0], "nodes": [5, 60, 113], "scheme": "trapezoidal"}

`kind` is "free modes" or "attachment modes" (Hurty, Craig and Bampton, of both end faces); `scheme` "trapezoidal" or
"generalized alpha" with the spectral radius 0.8. Places of the nodes, (instants, nodes, 3), are
written at multiples of `every`, s, from the start on.
"""

import json
import sys
import time

import exudyn as exu
import exudyn.utilities
import numpy as np
from exudyn.FEM import FEMinterface, HCBstaticModeSelection, ObjectFFRFreducedOrderInterface
from scipy.sparse import csr_matrix

SPECTRAL_RADIUS = 0.8


def body(given):
    """The body with its frame in the centre of mass, and that."""
    size = given["X"].size
    M, K = (csr_matrix((given[f"{a}_data"], given[f"{a}_indices"], given[f"{a}_indptr"]), (size, size)) for a in "MK")
    shares = M @ np.tile(np.eye(3), (size // 3, 1))
    centre = (shares.T @ given["X"].ravel()) / shares[::3, 0].sum()
    interface = FEMinterface()
    interface.nodes = {"Position": given["X"] - centre}
    interface.massMatrix, interface.stiffnessMatrix = M, K
    return interface, centre


def choose_modes(interface, kind, count):
    """Gives the body its basis."""
    if kind == "free modes":
        interface.ComputeEigenmodes(count, excludeRigidBodyModes=6, useSparseSolver=False)
        return
    along = interface.nodes["Position"][:, 0]
    ends = [np.flatnonzero(np.abs(along - end) < 1e-9).tolist() for end in (along.min(), along.max())]
    interface.ComputeHurtyCraigBamptonModes(ends, count - 6, computationMode=HCBstaticModeSelection.RBE2)


def main(given, result, task):
    """Runs Exudyn."""
    task = json.loads(task)
    with np.load(given) as file:
        interface, centre = body(dict(file))
    choose_modes(interface, task["kind"], task["modes"])
    container = exu.SystemContainer()
    system = container.AddSystem()
    added = ObjectFFRFreducedOrderInterface(interface).AddObjectFFRFreducedOrder(
        system,
        positionRef=centre.tolist(),
        initialAngularVelocity=task["spin"],
        stiffnessProportionalDamping=task["beta"],
    )
    sensors = [
        system.AddSensor(
            exu.utilities.SensorSuperElement(
                bodyNumber=added["oFFRFreducedOrder"],
                meshNodeNumber=node,
                storeInternal=True,
                outputVariableType=exu.OutputVariableType.Position,
            )
        )
        for node in task["nodes"]
    ]
    system.Assemble()
    settings = exu.SimulationSettings()
    steps = round(task["duration"] / task["dt"])
    settings.timeIntegration.numberOfSteps, settings.timeIntegration.endTime = steps, task["duration"]
    settings.timeIntegration.verboseMode = 0
    settings.timeIntegration.newton.useModifiedNewton = True
    settings.solution.file.write = False
    settings.solution.sensors.writePeriod = task["every"]
    settings.linearSolver.solverType = exu.LinearSolverType.EXUdense
    settings.timeIntegration.generalizedAlpha.spectralRadius = SPECTRAL_RADIUS
    schemes = {
        "trapezoidal": exu.DynamicSolverType.TrapezoidalIndex2,
        "generalized alpha": exu.DynamicSolverType.GeneralizedAlpha,
    }
    start = time.process_time()
    finished = system.SolveDynamic(settings, solverType=schemes[task["scheme"]])
    seconds = time.process_time() - start
    if not finished:
        sys.exit("the solver did not finish")
    places = np.stack([system.GetSensorStoredData(sensor)[:, 1:] for sensor in sensors], axis=1)
    np.savez(result, places=places, rate=steps / seconds, version=exu.config.Version())


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    main(*sys.argv[1:])
