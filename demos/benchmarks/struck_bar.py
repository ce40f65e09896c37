"""A rigid mass strikes the end of an elastic bar that is clamped at its other end (Saint-Venant; Timoshenko & Goodier).

With Z = ρ c A, c = √(E/ρ), T = 2 L / c, and f(t) what the struck end sends into the bar as a velocity,

    f(t) = V(t) + f(t - T),    F(t) = Z (V(t) + 2 f(t - T)),    M V' = -F,    until F = 0

F jumps as the front comes back. A mesh makes a ramp of the jump, with ripples beside it, so that the largest force is
told as the mean over T/20, of both. The bar does not widen (Poisson's ratio 0), and is reduced to its lowest modes,
beside which its contact points yield as they do at rest.
"""

from collections.abc import Iterator

import numpy as np
from solids import Row, bar, mesh_of

import fenics_rom as fr
from fenics_rom.world.shapes import Box

Array = np.ndarray
LENGTH, SIDE, YOUNG, DENSITY = 1.0, 0.02, 1e7, 1000.0  # m, Pa, kg/m3: waves go at 100 m/s
SPEED, RATIO = 0.1, 0.5  # m/s; mass of the bar over that which strikes it
MEAN = 1 / 20  # of T, over which the largest force is told
GAP = 1e-6  # m, at first
EFFECTS = """inertia = {}
damping = { beta = 3e-8 }
[effects.contact.obstacles.wall]
shape = "half-space"
point = [2.0, 0.0, 0.0]
normal = [-1.0, 0.0, 0.0]
"""
SLIDES = '\n[[supports.held]]\nsurface = "{}"\nnormal = {}'
ALLOWED = 0.01


def wave_theory(parts: int = 4000) -> tuple[Array, float]:
    """Forces, N, at the ends of steps of T / parts, s, until the mass leaves; and that step."""
    mass, impedance = DENSITY * LENGTH * SIDE**2 / RATIO, np.sqrt(YOUNG * DENSITY) * SIDE**2
    h = 2 * LENGTH / np.sqrt(YOUNG / DENSITY) / parts
    sent, forces, V, back = list[float](), list[float](), SPEED, 0.0
    decay = np.exp(-impedance * h / mass)
    while not forces or forces[-1] > 0:
        sent.append(V + back)
        forces.append(impedance * (V + 2 * back))
        late = sent[len(sent) - parts] if len(sent) >= parts else 0.0
        mean = late if len(sent) == parts else (back + late) / 2  # as the front comes back it has jumped
        V, back = V * decay - 2 * mean * (1 - decay), late
    return np.array(forces), h


def struck_bar(quick: bool) -> Iterator[Row]:
    """Largest force, and how long they touch."""
    bricks, order, dt, allowed = ((60, 1, 1), 60, 2e-5, 3 * ALLOWED) if quick else ((300, 1, 1), 300, 5e-6, ALLOWED)
    slides = SLIDES.format("front", [0, 1, 0]) + SLIDES.format("bottom", [0, 0, 1])
    system = bar(bricks, lambda p: p * [LENGTH, SIDE, SIDE], YOUNG, 0.0, DENSITY, EFFECTS, slides)
    rom = fr.reduce(system, order=order, method="modal")
    theory, h = wave_theory()
    mass = fr.RigidBody(
        Box((SIDE, 2 * SIDE, 2 * SIDE)),
        mass=DENSITY * LENGTH * SIDE**2 / RATIO,
        position=(LENGTH + SIDE / 2 + GAP, SIDE / 2, SIDE / 2),
        velocity=(-SPEED, 0.0, 0.0),
    )
    world = fr.World({"bar": fr.SoftBody(rom), "mass": mass}, dt)
    forces = []
    for _ in range(round(1.2 * len(theory) * h / dt)):
        world.step()
        forces.append(-world.force_between("bar", "mass")[0])
    touched = np.flatnonzero(np.array(forces) > 0)
    case, mesh = "mass that strikes a bar", f"{mesh_of(system, bricks)}, order {order}"
    window = MEAN * 2 * LENGTH / np.sqrt(YOUNG / DENSITY)
    peaks = (_largest_mean(theory, window / h), _largest_mean(np.array(forces), window / dt))
    yield Row(case, mesh, "largest force, N", *peaks, allowed)
    yield Row(case, mesh, "touches for, s", len(theory) * h, float(touched[-1] + 1 - touched[0]) * dt, allowed)


def _largest_mean(values: Array, count: float) -> float:
    """Of so many values that follow one another."""
    return float(np.convolve(values, np.full(round(count), 1 / round(count))).max())
