"""A clamp that a rope closes on itself, and a pin, smaller than its mesh, that rises and turns below it."""

import numpy as np
from forks import GAP, HIGH, ROPE, cleft, fork_text
from turning import csv_of, path_of

import fenics_rom as fr
from fenics_rom.mechanics.frame_motion import quaternion_of_vector
from fenics_rom.scene.file import parse_scene

R = 1e-3  # m, of the pin
LOW = -HIGH - GAP / 2 - R - 2e-4  # m, where its axis is at first
FACES = 'points = "faces"\nself_contact = ["inside"]\n'
PIN = f'shape = "capsule", start = [0.07, -0.004, {LOW}], end = [0.085, 0.003, {LOW}], radius = {R}'
MODES = '[contacts.inside]\nsurface = "inside"\n[contacts.below]\nsurface = "below"'
RUBS = {"effects.friction": "coefficient = 0.4"}
MIDDLE = [0.08, 0.0, 0.0]


def rises(time, rate=5.0):
    """3 mm in 60 ms, turned about z."""
    speed = [0.0, 0.0, 0.05 * (time < 0.06)]
    place = np.array([*MIDDLE[:2], 0.05 * min(time, 0.06)])
    return fr.BaseState(place, quaternion_of_vector([0.0, 0.0, rate * time]), np.array(speed), rate * np.eye(3)[2])


def clamp_text(folder, frame="fixed", contact=FACES, pin=PIN, **parts):
    """The text of a scene; `parts` as of `scene_text`."""
    (folder / "rises.csv").write_text(csv_of(path_of(rises, 0.12, rows=121)))
    motion = f'motion = {{ table = "rises.csv", origin = {MIDDLE} }}'
    contact = f"{contact}obstacles.pin = {{ {pin}, {motion} }}"
    return fork_text(folder, cleft((5, 2, 3), 1), frame, contact, contacts=MODES, **{**ROPE, **RUBS, **parts})


def clamp_scene(folder, *given, **parts):
    """The scene of `clamp_text`."""
    return parse_scene(clamp_text(folder, *given, **parts), folder=folder)


def left_of(body, start=0.0):
    """What of a body's energy its account does not tell, J."""
    gone = body.ledger
    lost = gone.dissipated + gone.lost_in_switching + gone.numerical
    return abs(body.energy - start - gone.supplied + lost)
