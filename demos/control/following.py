"""Tensions that lead the tip along a path, planned with the exact gradient of a reduced model."""

import tracemalloc
from collections.abc import Callable
from time import process_time
from typing import NamedTuple, Protocol

import numpy as np
from scipy.optimize import minimize

import fenics_rom as fr
from fenics_rom.io.markdown import markdown

Array = np.ndarray
LIFT, THERE, BACK, DURATION = 4e-3, (0.02, 0.08), (0.15, 0.21), 0.3  # m; s: from rest to rest and back
MOST = 1.3  # N, beyond what holds the finger in the middle: so no tendon gets slack
EASE = 1e-9  # m²/N² of each tension's change from step to step: so that tensions are smooth


class Body(Protocol):
    """A simulator, at any order."""

    def step(self, u: Array) -> None:
        """Advances by one step."""

    def displacement(self, output: str) -> Array:
        """Of a named output, m."""


class Plan(NamedTuple):
    """Tensions (steps, 2) of both tendons, N, for a path (steps,) of the tip's height, m."""

    path: Array
    planned: Array
    at_rest: Array  # those that would hold the tip there
    iterations: int


class Following(NamedTuple):
    """How the tip of each body went, by the body's name and that of the tensions."""

    table: str
    heights: dict[str, Array]  # (steps,), m
    off: dict[str, float]  # at most, m


def follow(plan: Plan, bodies: dict[str, Callable[[], Body]]) -> Following:
    """Lets bodies take the tensions, each a new one."""
    heights = {
        f"{name}, {how}": _heights(body(), tensions)
        for how, tensions in (("as held at rest", plan.at_rest), ("planned", plan.planned))
        for name, body in bodies.items()
    }
    apart = {name: np.abs(height - plan.path) for name, height in heights.items()}
    rows = [(name, f"{1e3 * np.sqrt(np.mean(gap**2)):.4f}", f"{1e3 * gap.max():.4f}") for name, gap in apart.items()]
    table = markdown(("plant, tensions", "off, rms (mm)", "off, at most (mm)"), rows)
    return Following(table, heights, {name: float(gap.max()) for name, gap in apart.items()})


def plan_tensions(rom: fr.Rom, h: float) -> Plan:
    """Tensions of both tendons for every step, by L-BFGS on the exact gradient."""
    body, steps = fr.Simulator(rom, h), round(DURATION / h)
    t = h * np.arange(1, steps + 1)
    path = LIFT * (ramp(t, *THERE) - ramp(t, *BACK))
    at_rest = at_rest_tensions(rom, path)

    def miss(tensions: Array) -> tuple[float, Array]:
        u = np.hstack([np.zeros((steps, 1)), tensions.reshape(steps, 2)])
        apart = np.empty(0)

        def squares(outputs: dict[str, Array], energies: Array) -> tuple[float, dict[str, Array], None]:
            nonlocal apart
            apart = outputs["tip"][:, 0, 2] - path
            slope = np.zeros_like(outputs["tip"])
            slope[:, 0, 2] = 2 * apart
            return float(apart @ apart), {"tip": slope}, None

        gradient = fr.differentiate(body, u, squares, outputs=["tip"])
        changes = np.diff(u[:, 1:], axis=0, prepend=0.0, append=0.0)
        value = gradient.value + EASE * float((changes**2).sum())
        slope = gradient.inputs[:, 1:] - 2 * EASE * np.diff(changes, axis=0)
        return value / LIFT**2, slope.ravel() / LIFT**2

    limits = [(-MOST, MOST)] * (2 * steps)
    found = minimize(
        miss, at_rest.ravel(), jac=True, method="L-BFGS-B", bounds=limits, options={"maxiter": 300, "maxcor": 30}
    )
    return Plan(path, found.x.reshape(steps, 2), at_rest, found.nit)


def at_rest_tensions(rom: fr.Rom, path: Array) -> Array:
    """Those (steps, 2), N, that would hold the tip at each height of a path (steps,), m."""
    A, B, C, _ = rom.state_space("side", ["tip"])
    lift = (C @ np.linalg.solve(-A, B))[2, 1:]  # of the tip at rest by each tension, m/N
    tensions: Array = path[:, None] * lift / (lift @ lift)
    return tensions


class GradientCost(NamedTuple):
    """What a gradient takes."""

    steps: int
    times: float  # as long as its steps
    times_read: float  # as long as these with the tip read after each
    memory: float  # for a million steps, B; with `quick` by what few of them take


def gradient_cost(rom: fr.Rom, h: float, quick: bool) -> GradientCost:
    """By processor time, the best of some; by what Python allocates."""
    body, steps = fr.Simulator(rom, h), 2_000 if quick else 20_000
    u = 0.1 * np.random.default_rng(0).standard_normal((steps, body.inputs))

    def end(outputs: dict[str, Array], energies: Array) -> tuple[float, dict[str, Array], None]:
        slope = np.zeros_like(outputs["tip"])
        slope[-1] = 1.0
        return float(outputs["tip"][-1].sum()), {"tip": slope}, None

    def forwards(reads: bool) -> None:
        start = body.save()
        for row in u:
            body.step(row)
            if reads:
                body.displacement("tip")
        body.restore(start)

    def seconds(run: Callable[[], object]) -> float:
        begun = process_time()
        run()
        return process_time() - begun

    runs = (
        lambda: fr.differentiate(body, u, end, outputs=["tip"]),
        lambda: forwards(reads=False),
        lambda: forwards(reads=True),
    )
    back, there, read = np.array([[seconds(run) for run in runs] for _ in range(5)]).min(axis=0)
    long = np.tile(u, (1 if quick else 50, 1))
    tracemalloc.start()
    fr.differentiate(body, long, end, outputs=["tip"])
    memory = tracemalloc.get_traced_memory()[1] / len(long) * 1e6
    tracemalloc.stop()
    return GradientCost(steps, back / there, back / read, memory)


def ramp(t: Array, start: float, end: float) -> Array:
    """From 0 to 1, smooth to the third derivative."""
    s = np.clip((t - start) / (end - start), 0.0, 1.0)
    return s**4 * (35 - 84 * s + 70 * s**2 - 20 * s**3)


def _heights(body: Body, tensions: Array) -> Array:
    heights = []
    for pair in tensions:
        body.step(np.array([0.0, *pair]))
        heights.append(body.displacement("tip")[0, 2])
    return np.array(heights)
