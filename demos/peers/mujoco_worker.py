"""MuJoCo's side of against_mujoco.py, in a Python of its own, which needs nothing of this project.

    PYTHON mujoco_worker.py SCENE.json RESULT.npz TASK

Makes the beam in SCENE of one of MuJoCo's flexes and pushes its tip. TASK is JSON; `flex` says what it is made of,
{"dof": "quadratic", "count": [9, 3, 3], "cells": [2, 1, 1]}, and a setting is [integrator, solver, time step]:

    {"what": "matrices", "flex": {...}}                                writes M, D, K at rest, B of the tip, the mesh
    {"what": "paths", "flex": {...}, "settings": [...]}                writes the tip's displacement over time
    {"what": "rates", "flex": {...}, "settings": [...], "bodies": 64}  writes steps per second, of one body and of many

Forces are spread over the nodes of the tip's face as the integral over it spreads them, and the tip's displacement is
the mean over the face. A setting that does not survive has an empty path.
"""

import json
import sys
import time

import mujoco
import numpy as np
from mujoco.batch import Batch

XML = """
<mujoco>
  <option gravity="0 0 0" timestep="{step}" integrator="{integrator}" solver="{solver}">
    <flag contact="disable" autoreset="disable"/>
  </option>
  <worldbody>
    <flexcomp name="beam" type="grid" dim="3" dof="{dof}" count="{count}" {cells} spacing="{spacing}" pos="{centre} 0 0"
              radius="0" mass="{mass}">
      <elasticity young="{young}" poisson="{poisson}" damping="{damping}"/>
      <contact selfcollide="none"/>
      <pin gridrange="0 0 0 0 {last}"/>
    </flexcomp>
  </worldbody>
</mujoco>
"""
DEGREES = {"full": 0, "trilinear": 1, "quadratic": 2}
WEIGHTS = {1: (1 / 2, 1 / 2), 2: (1 / 6, 4 / 6, 1 / 6)}  # of the nodes of an interval, of its length
LEAST = 500  # steps that a rate is measured over
SHARE = 1e-6  # of the length: differences that the matrices are found from


def beam(scene, flex, setting):
    """The model of a beam."""
    integrator, solver, step = setting
    degree, count, size = DEGREES[flex["dof"]], flex["count"], scene["size"]
    nodes = [degree * cells + 1 for cells in flex["cells"]] if degree else count
    return mujoco.MjModel.from_xml_string(
        XML.format(
            step=step,
            integrator=integrator,
            solver=solver,
            dof=flex["dof"],
            count=" ".join(map(str, count)),
            cells='cellcount="{} {} {}"'.format(*flex["cells"]) if degree else "",
            spacing=" ".join(repr(length / (points - 1)) for length, points in zip(size, count, strict=True)),
            centre=size[0] / 2,
            mass=scene["density"] * float(np.prod(size)),
            young=scene["young"],
            poisson=scene["poisson"],
            damping=scene["damping"],
            last=f"{nodes[1] - 1} {nodes[2] - 1}",
        )
    )


def tip_column(model, flex):
    """B (nv,): the integral over the tip's face, of the shape functions of its nodes, in z; the sum is 1."""
    degree = DEGREES[flex["dof"]]
    at, axis = model.body_pos[model.dof_bodyid], model.jnt_axis[model.dof_jntid]
    chosen = np.isclose(at[:, 0], at[:, 0].max()) & (axis[:, 2] > 0.5)
    B = np.zeros(model.nv)
    B[chosen] = 1
    for direction in (1, 2):
        places = np.unique(np.round(at[chosen, direction], 9))
        degree_here = degree or 1
        weight = np.zeros(len(places))
        for first in range(0, len(places) - 1, degree_here):
            weight[first : first + degree_here + 1] += WEIGHTS[degree_here]
        B[chosen] *= (weight / weight.sum())[np.searchsorted(places, at[chosen, direction] - 1e-9)]
    return B


def matrices(scene, task):
    """M, D and K at rest, by central differences of the forces; and B."""
    model = beam(scene, task["flex"], ("Euler", "CG", 1e-3))
    data, n = mujoco.MjData(model), model.nv

    def force(q, v):
        data.qpos[:], data.qvel[:] = q, v
        mujoco.mj_forward(model, data)
        return data.qfrc_passive.copy()

    rest, ε = np.zeros(n), SHARE * scene["size"][0]
    M, D, K = np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n))
    force(rest, rest)
    for k, unit in enumerate(np.eye(n)):
        mujoco.mj_mulM(model, data, M[k], unit)
    for k, unit in enumerate(np.eye(n)):
        K[:, k] = (force(-ε * unit, rest) - force(ε * unit, rest)) / (2 * ε)
        D[:, k] = (force(rest, -unit) - force(rest, unit)) / 2
    force(rest, rest)
    found = {"M": M, "D": D, "K": K, "B": tip_column(model, task["flex"])}
    return found | {"points": data.flexvert_xpos.copy(), "tetrahedra": model.flex_elem.reshape(-1, 4)}


def paths(scene, task):
    """Displacement of the tip at every sample; empty where MuJoCo warns of what is not finite or huge."""
    found = {}
    for k, setting in enumerate(task["settings"]):
        model = beam(scene, task["flex"], setting)
        data, B = mujoco.MjData(model), tip_column(model, task["flex"])
        every, path = round(scene["sample"] / setting[2]), []
        for sample in range(round(scene["duration"] / scene["sample"])):
            pushed = sample * scene["sample"] < scene["push"] - 1e-9
            data.qfrc_applied[:] = scene["force"] * B if pushed else 0.0
            mujoco.mj_step(model, data, every)
            path.append(B @ data.qpos)
            if broken(data) or not abs(path[-1]) < scene["size"][0]:
                path = []
                break
        found[f"path_{k}"] = np.array(path)
    return found


def broken(data):
    """Whether MuJoCo has warned of a state or an acceleration that is not finite, or huge."""
    kinds = (mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL, mujoco.mjtWarning.mjWARN_BADQACC)
    return any(data.warning[int(kind)].number for kind in kinds)


def rates(scene, task):
    """Steps per second of one body within `mj_step(m, d, nstep)`, and of each of many in MuJoCo's batch; one thread."""
    found = {}
    for k, setting in enumerate(task["settings"]):
        model = beam(scene, task["flex"], setting)
        data, B = mujoco.MjData(model), tip_column(model, task["flex"])
        pushed = round(scene["push"] / setting[2])
        data.qfrc_applied[:] = scene["force"] * B
        mujoco.mj_step(model, data, pushed)
        data.qfrc_applied[:] = 0
        every = round(scene["sample"] / setting[2])
        steps, start = 0, time.perf_counter()
        while steps < LEAST:
            mujoco.mj_step(model, data, every)
            B @ data.qpos
            steps += every
        found[f"rate_{k}"] = steps / (time.perf_counter() - start)
        batch = Batch(model, nsim=task["bodies"], nthread=1)
        batch.bind("qfrc_applied")[:] = scene["force"] * B
        batch.step()
        calls, start = 0, time.perf_counter()
        while calls * task["bodies"] < LEAST:
            batch.step()
            calls += 1
        found[f"rate_batch_{k}"] = calls * task["bodies"] / (time.perf_counter() - start)
    return found


def main(scene, result, task):
    """Runs MuJoCo."""
    task = json.loads(task)
    with open(scene) as file:  # noqa: PTH123
        given = json.load(file)
    found = {"matrices": matrices, "paths": paths, "rates": rates}[task["what"]](given, task)
    found["versions"] = f"MuJoCo {mujoco.__version__}, NumPy {np.__version__}"
    np.savez(result, **found)


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    main(*sys.argv[1:])
