"""A box that lands on obstacles, is pushed until it slides, stops, is lifted off and lands again."""

import numpy as np
from bodies import acted_on, box_arrays, write_arrays

import fenics_rom as fr

LENGTHS, ORDER, DT, WEIGHT = (0.3, 0.2, 0.1), 8, 1e-3, 58.86  # m, -, s, N
FLOOR = '[effects.contact.obstacles.floor]\nshape = "half-space"\npoint = [0, 0, -1e-4]\nnormal = [0, 0, 1]\n'
BALL = '[effects.contact.obstacles.ball]\nshape = "sphere"\ncenter = [0.15, 0.1, -5.0001]\nradius = 5.0\n'
WALL = '[effects.contact.obstacles.wall]\nshape = "half-space"\npoint = [-1.0, 0, 0]\nnormal = [1, 0, 0]\n'
BODY = "inertia = {}\ndamping = { alpha = 5.0, beta = 2e-3 }\ngravity = { acceleration = [0, 0, -9.81] }\n"
ROUGH = "[effects.friction]\ncoefficient = 0.4\n"
RELAXING = "[effects.viscoelasticity]\nratios = [0.5, 0.3]\ntimes = [2e-3, 0.1]\n"
SPRINGS = '[effects.springs.bed]\nsurface = "top"\nstiffness = 100.0\n'
PARTS = {
    "contacts": '[contacts.bottom]\nsurface = "bottom"\n',
    "supports": None,
    "outputs.corner": "points = [[0.3, 0.2, 0.0], [0.3, 0.2, 0.1]]",
}
CASES = {
    "floor": "[effects.contact]\n" + FLOOR + ROUGH,
    "thrown back": "[effects.contact]\nrestitution = 0.5\n" + FLOOR + ROUGH,
    "smooth": "[effects.contact]\n" + FLOOR,
    "ball": "[effects.contact]\n" + BALL + ROUGH,
    "springs": "[effects.contact]\nmethod = 'penalty'\nstiffness = 1e5\ndamping = 10.0\n" + FLOOR + ROUGH,
    "two": "[effects.contact]\n" + FLOOR + WALL + ROUGH,
    "relaxing": "[effects.contact]\n" + FLOOR + ROUGH + RELAXING,
    "relaxing, on springs": "[effects.contact]\n" + FLOOR + ROUGH + RELAXING + SPRINGS,
}


def landing_mesh(folder):
    """Its mesh file."""
    return write_arrays(folder / "box.msh", *box_arrays(LENGTHS, (3, 2, 1), shake=0.2))


def landing_roms(mesh):
    """By what the box meets."""
    return {
        name: fr.reduce(fr.assemble(acted_on(mesh, BODY + effects, **PARTS)), order=ORDER)
        for name, effects in CASES.items()
    }


def history(seed, roughness=0.0):
    """Forces (steps, 3): the box lands, is pushed until it slides, stops, is lifted off and lands again; some noise."""
    rng = np.random.default_rng(seed)
    aside, up = rng.uniform(0.55, 0.8) * np.array([np.cos(seed), np.sin(seed)]), 1.6
    knots = [0, 150, 180, 260, 300, 380, 430, 520, 560, 580, 700]
    push = np.interp(np.arange(700), knots, [0, 0, 0.3, 0.3, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    lift = np.interp(np.arange(700), knots, [0, 0, 0, 0, 0, 0, 0, 0, up, 0, 0])
    return WEIGHT * (np.stack([push * aside[0], push * aside[1], lift], axis=1) + roughness * rng.normal(size=(700, 3)))


def stepped(rom, forces, every=1):
    """The body after these steps, what outputs were after some, and statuses of the points after each."""
    body, read, statuses = fr.Simulator(rom, DT), [], []
    for k, u in enumerate(forces, start=1):
        body.step(u)
        if k % every == 0:
            read.append(body.displacement("corner"))
        f = body.contact_forces()
        slides = np.hypot(f[:, 0], f[:, 1]) > (0.4 - 1e-9) * f[:, 2]
        statuses.append(((f[:, 2] > 0).astype(int) + (slides & (f[:, 2] > 0))).tobytes())
    return body, np.array(read), statuses
