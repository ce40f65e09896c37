"""Linear bodies, held, acted on and free, and how they are moved: what is made of a ROM does as its simulator."""

import numpy as np
from bodies import acted_on

import fenics_rom as fr
from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.rom.rom import check_rom, diagonalized_span

EFFECTS = """
inertia = {}
gravity = { acceleration = [0, 0, -9.81] }
[effects.damping]
alpha = 0.5
beta = 1e-3
[effects.damping.dashpots.oil]
surface = "front"
coefficient = 30.0
[effects.base_motion.quake]
direction = [1, 0, 1]
[effects.pressure.air]
surface = "top"
[effects.tendon.rope]
points = [[0.0, 0.1, 0.3], [1.0, 0.1, 0.3]]
"""
PARTS = {"outputs.tip": "points = [[1.0, 0.4, 0.3], [1.0, 0.0, 0.0]]", "outputs.end": 'surface = "right"'}
LOAD_VALUES = {"gravity": 0.01, "quake": 0.03}
LINEAR_BODIES = ["held", "acted on", "free", "free, dense"]


def linear_rom(kind, request):
    """One of these bodies."""
    if kind == "held":
        return request.getfixturevalue("plate_rom")
    if kind == "acted on":
        return fr.reduce(fr.assemble(acted_on(request.getfixturevalue("box_file"), EFFECTS, **PARTS)), order=12)
    return random_free(3, (8, 11, 5), dense=kind == "free, dense")


def ride(rom, h, steps):
    """Steps a simulator under random inputs, in another contact mode after every seventh.

    Yields:
        After each step the simulator, its inputs with the loads, and all that its outputs read.
    """
    random, names = np.random.default_rng(0), list(rom.contact_models)
    body = fr.Simulator(rom, h, signals=LOAD_VALUES if rom.loads else None)
    for step in range(steps):
        body.switch(names[step // 7 % len(names)])
        u = 0.1 * random.standard_normal(body.inputs)
        body.step(u)
        read = np.concatenate([body.displacement(name).ravel() for name in rom.outputs])
        yield body, np.array([*u, *(LOAD_VALUES[name] for name in rom.loads)]), read


def random_free(seed, sizes, dense, rigid=6, k=40):
    """A ROM of random bases beside rigid motions, with any damping, which couples both where it is dense."""
    random = np.random.default_rng(seed)
    κ = np.concatenate([np.zeros(rigid), np.sort(10 ** random.uniform(0, 6, k))])
    modes = {}
    for number, size in enumerate(sizes):
        elastic = np.linalg.qr(random.standard_normal((k, size)))[0]
        span = np.block([[np.eye(rigid), np.zeros((rigid, size))], [np.zeros((k, rigid)), elastic]])
        mixed = span @ np.linalg.qr(random.standard_normal((rigid + size, rigid + size)))[0]
        γ, C = diagonalized_span(κ, mixed)
        root = random.standard_normal((rigid + size, random.integers(0, rigid + size + 1)))
        D = root @ root.T if dense else 0.1 * (number > 0) + 1e-3 * γ
        modes[f"mode{number}"] = ContactModel(
            γ, D, random.standard_normal((rigid + size, 2)), C, np.eye(rigid + size), np.empty(0)
        )
    return check_rom(
        fr.Rom(
            name="random",
            switching="energy",
            contact_models=modes,
            actuators={},
            basis=np.eye(rigid + k),
            stiffness=κ,
            outputs={"all": np.eye(rigid + k)},
            free=np.arange(rigid + k),
            nodes=np.empty((0, 3)),
            triangles=np.empty((0, 3), dtype=int),
            node_mass=np.empty(0),
        )
    )
