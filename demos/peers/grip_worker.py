"""MuJoCo's side of against_mujoco_grip.py, in a Python of its own, which needs nothing of this project.

    PYTHON grip_worker.py SCENE.json RESULT.npz TASK

Two jaws press on a free box with given forces. In place of the jaws gravity is shaken, which is the same and suits
MuJoCo better. TASK is JSON; settings are [time step, cone, impratio, noslip iterations]:

    {"what": "shaken", "settings": [...], "seconds": 60}     writes where the box was in each period, on average
    {"what": "loosened", "settings": [...], "a": 9.81}       writes 2 mu N/(m (g + a)) where it begins to slip
"""

import json
import sys
import time

import mujoco
import numpy as np

JAW = """<body pos="{at} 0 0"><joint name="jaw{side}" type="slide" axis="{side} 0 0"/>
  <geom type="box" size="0.005 0.01 0.01" mass="0.1" friction="{friction}" condim="3"/></body>"""
XML = """
<mujoco>
  <option gravity="0 0 0" timestep="{step}" cone="{cone}" impratio="{impratio}" noslip_iterations="{noslip}"/>
  <worldbody>
    <body><freejoint/>
      <geom type="box" size="{half} {half} {half}" mass="{mass}" friction="{friction}" condim="3"/></body>
    {jaws}
  </worldbody>
  <actuator><motor joint="jaw1"/><motor joint="jaw-1"/></actuator>
</mujoco>
"""
LOST = 0.02  # m


def gripper(scene, setting):
    """The model, closed."""
    step, cone, impratio, noslip = setting
    half, friction = scene["edge"] / 2, scene["friction"]
    jaws = "".join(JAW.format(side=side, at=-side * (half + 0.005), friction=friction) for side in (1, -1))
    given = {"half": half, "mass": scene["mass"], "friction": friction, "jaws": jaws}
    options = {"step": step, "cone": cone, "impratio": impratio, "noslip": noslip}
    return mujoco.MjModel.from_xml_string(XML.format(**given, **options))


def rise(t, begin, end):
    """From 0 to 1, smoothly."""
    s = min(max((t - begin) / (end - begin), 0.0), 1.0)
    return s**3 * (10 - 15 * s + 6 * s**2)


def shaken(scene, setting, task):
    """Where the box was in each period until it was lost, and steps per second."""
    model = gripper(scene, setting)
    data, h = mujoco.MjData(model), setting[0]
    rate, places, begin = 2 * np.pi * scene["frequency"], [], time.process_time()
    needed = scene["mass"] * (scene["gravity"] + scene["shaking"]) / (2 * scene["friction"])
    data.ctrl[:] = scene["margin"] * needed
    for k in range(round((scene["shaken"] + task["seconds"]) / h)):
        t = (k + 0.5) * h
        a = scene["shaking"] * np.sin(rate * t) * rise(t, 0.5, scene["shaken"])
        model.opt.gravity[2] = -(scene["gravity"] * rise(t, 0.1, 0.5) + a)
        mujoco.mj_step(model, data)
        if data.time > scene["shaken"] + 1e-9:
            places.append(data.qpos[2])
        if not abs(data.qpos[2]) < LOST:
            break
    period = round(1 / scene["frequency"] / h)
    whole = len(places) // period * period
    speed = (k + 1) / (time.process_time() - begin)
    return np.array([speed, *np.reshape(places[:whole], (-1, period)).mean(axis=1)])


def loosened(scene, setting, task):
    """What part of the weight friction could carry when the box begins to slip."""
    model = gripper(scene, setting)
    data, h, weight = mujoco.MjData(model), setting[0], scene["mass"] * (scene["gravity"] + task["a"])
    share = scene["margin"]
    for k in range(round(8.0 / h)):
        t = (k + 0.5) * h
        share = scene["margin"] - 0.05 * max(t - 0.9, 0.0)
        model.opt.gravity[2] = -weight / scene["mass"] * rise(t, 0.1, 0.5)
        data.ctrl[:] = share * weight / (2 * scene["friction"])
        mujoco.mj_step(model, data)
        if t > 0.9 and abs(data.qvel[2]) > scene["slips"]:
            break
    return np.array(share)


def main(scene, result, task):
    """Runs MuJoCo."""
    task = json.loads(task)
    with open(scene) as file:  # noqa: PTH123
        given = json.load(file)
    run = {"shaken": shaken, "loosened": loosened}[task["what"]]
    np.savez(result, **{f"found_{k}": run(given, setting, task) for k, setting in enumerate(task["settings"])})


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    main(*sys.argv[1:])
