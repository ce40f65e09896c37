"""Tensions that are planned anew a hundred times a second, each time a second ahead.

With tensions that are constant for 50 ms each, heights of the tip ahead are y = O z + F u of the observer's state z,
with maps that are found once: five F, as a plan may begin within such 50 ms. What is left of a plan is a quadratic
program of 42 numbers between bounds, begun with the plan before.
"""

from collections.abc import Callable
from time import perf_counter
from typing import NamedTuple

import numpy as np
from following import MOST, Body, at_rest_tensions, ramp
from scipy.linalg import solve_discrete_are

import fenics_rom as fr
from fenics_rom.io.markdown import markdown

Array = np.ndarray
HORIZON, GRID, SAMPLED, REPLANNED = 1.0, 0.05, 0.01, 0.01  # s: how far ahead, tensions, heights, and how often
EASE = 1e-8  # m²/N² of changes of tension, beside the squares of what 100 heights are off
STEPS_OF_PATH = ((3e-3, 0.1, 0.2), (-5e-3, 0.5, 0.6), (2e-3, 1.2, 1.3))  # m, from and to s: from rest to rest
FLICK, FLICKED, DURATION = 0.2, (0.9, 0.92), 1.7  # N, s; nobody tells the planner
NOISE = 1e-8  # m², of the tip's height
SOLVED = 1e-9  # of the gradient without tensions
ITERATIONS = 50


class Replanned(NamedTuple):
    """A run under tensions that were planned on the way."""

    height: Array  # of the tip, (steps,), m
    seconds: Array  # of each plan


class Replanning(NamedTuple):
    """How bodies went, by the name of the body and of the tensions."""

    table: str
    rate: str  # what to say of the plans' time
    heights: dict[str, Array]  # (steps,), m
    path: Array  # (steps,), m
    off: dict[str, float]  # before the flick, root mean square, m
    slowest: float  # of a hundred plans the slowest but one, s
    slope: float  # of a plan by the exact gradient through its steps, as a share of that without tensions


class Planner:
    """Plans of a model, of its tip's height and two tendons.

    Args:
        rom: the reduced model.
        h: step of its body, s.
    """

    def __init__(self, rom: fr.Rom, h: float):
        self.h, self.phases, self.moves = h, round(GRID / REPLANNED), round(HORIZON / GRID) + 1
        self.A, B, C, _ = rom.state_space("side", ["tip"], h)
        self.B, self.C, self.flick = B[:, 1:], C[[2]], B[:, :1]
        maps = [self._ahead(phase) for phase in range(self.phases)]
        self.O, self.F = maps[0][0], [F for _, F in maps]
        changes = np.eye(2 * self.moves) - np.eye(2 * self.moves, k=-2)
        self.H = [F.T @ F + EASE * changes.T @ changes for F in self.F]
        self.u = np.zeros(2 * self.moves)

    def _ahead(self, phase: int) -> tuple[Array, Array]:
        """Heights ahead by the state now and by the tensions, the first of which is to be held for less."""
        states, free, rows = np.zeros((len(self.A), 2 * self.moves)), np.eye(len(self.A)), []
        held, every = round(GRID / self.h), round(SAMPLED / self.h)
        for step in range(round(HORIZON / self.h)):
            states, free = self.A @ states, self.A @ free
            move = (step + phase * round(REPLANNED / self.h)) // held
            states[:, 2 * move : 2 * move + 2] += self.B
            if (step + 1) % every == 0:
                rows.append(np.hstack([self.C @ free, self.C @ states]))
        ahead = np.concatenate(rows)
        return ahead[:, : len(self.A)], ahead[:, len(self.A) :]

    def gain(self) -> Array:
        """Kalman's, of an observer of the height, with any input disturbed by 1 N or so."""
        B = np.hstack([self.flick, self.B])
        S = solve_discrete_are(self.A.T, self.C.T, B @ B.T, np.array([[NOISE]]))
        gain: Array = self.A @ S @ self.C.T / (self.C @ S @ self.C.T + NOISE)
        return gain[:, 0]

    def plan(self, count: int, z: Array, path: Array, pulled: Array) -> Array:
        """Tensions of the plan of this number, (moves, 2), N.

        Args:
            count: of plans before it.
            z: state now.
            path: heights to be at, (heights,), m.
            pulled: tensions until now, (2,), N.
        """
        phase = count % self.phases
        if not phase:
            self.u = np.concatenate([self.u[2:], self.u[-2:]])
        g = self.F[phase].T @ (self.O @ z - path)
        g[:2] -= EASE * pulled
        self.u = solve_between_bounds(self.H[phase], g, self.u)
        return self.u.reshape(-1, 2)


def solve_between_bounds(H: Array, g: Array, u: Array) -> Array:
    """The u with least ½ uᵀHu + gᵀu and |u| ≤ MOST, by Newton's method on those between the bounds (Bertsekas 1982)."""
    least = SOLVED * np.abs(g).max()
    for _ in range(ITERATIONS):
        slope = H @ u + g
        held = ((u >= MOST) & (slope < 0)) | ((u <= -MOST) & (slope > 0))
        if np.abs(slope[~held]).max(initial=0.0) <= least:
            break
        step = np.zeros_like(u)
        step[~held] = -np.linalg.solve(H[np.ix_(~held, ~held)], slope[~held])
        share, value = 1.0, u @ H @ u / 2 + g @ u
        while True:
            to = np.clip(u + share * step, -MOST, MOST)
            if to @ H @ to / 2 + g @ to <= value + 1e-4 * slope @ (to - u) or share < 1e-6:
                break
            share /= 2
        u = to
    return u


def path_at(t: Array) -> Array:
    """Where the tip is to be at times, s, m."""
    return sum(height * ramp(t, *when) for height, *when in STEPS_OF_PATH)


def flick_at(t: Array) -> Array:
    """What nobody tells the planner of, at times, s, N."""
    start, end = FLICKED
    return np.where((t >= start) & (t < end), FLICK * np.sin(np.pi * (t - start) / (end - start)), 0.0)


def replan(planner: Planner, body: Body) -> Replanned:
    """Lets a body follow the path under tensions that are planned on the way, and flicks it."""
    h, z, L = planner.h, np.zeros(len(planner.A)), planner.gain()
    steps, every = round(DURATION / h), round(REPLANNED / h)
    ahead = SAMPLED * np.arange(1, round(HORIZON / SAMPLED) + 1)
    height, seconds, u = np.empty(steps), [], np.zeros(2)
    flick = flick_at(h * np.arange(steps))
    for step in range(steps):
        if step % every == 0:
            path = path_at(step * h + ahead)
            begun = perf_counter()
            u = planner.plan(step // every, z, path, u)[0].copy()
            seconds.append(perf_counter() - begun)
        y = body.displacement("tip")[0, 2]
        z = planner.A @ z + planner.B @ u + L * (y - (planner.C @ z)[0])
        body.step(np.array([flick[step], *u]))
        height[step] = body.displacement("tip")[0, 2]
    return Replanned(height, np.array(seconds))


def follow_replanned(rom: fr.Rom, h: float, bodies: dict[str, Callable[[], Body]]) -> Replanning:
    """Lets bodies, each a new one, follow the path with tensions as held at rest, and with replanned ones."""
    times = h * np.arange(round(DURATION / h))
    path, flick, heights, seconds = path_at(times + h), flick_at(times), dict[str, Array](), list[Array]()
    for name, make in bodies.items():
        body, height = make(), []
        for push, tensions in zip(flick, at_rest_tensions(rom, path), strict=True):
            body.step(np.array([push, *tensions]))
            height.append(body.displacement("tip")[0, 2])
        heights[f"{name}, as held at rest"] = np.array(height)
        run = replan(Planner(rom, h), make())
        heights[f"{name}, replanned"] = run.height
        seconds.append(run.seconds)
    before, after = times < FLICKED[0], times >= FLICKED[1] + 0.1
    apart = {name: np.abs(height - path) for name, height in heights.items()}
    off = {name: _rms(gap[before]) for name, gap in apart.items()}
    rows = [
        (name, f"{1e3 * off[name]:.3f}", f"{1e3 * gap[before].max():.3f}", f"{1e3 * _rms(gap[after]):.3f}")
        for name, gap in apart.items()
    ]
    heading = "plant, tensions", "off before the flick, rms (mm)", "at most (mm)", "from 0.1 s after it, rms (mm)"
    spent, moves = np.concatenate(seconds), 2 * Planner(rom, h).moves
    slowest = float(np.percentile(spent, 99))
    rate = (
        f"{len(spent)} plans of {moves} tensions, {HORIZON:g} s ahead, order 20: {1e3 * np.median(spent):.2f} ms "
        f"(median), {1e3 * slowest:.2f} ms (99 %)"
    )
    return Replanning(markdown(heading, rows), rate, heights, path, off, slowest, slope_of_plan(rom, h))


def slope_of_plan(rom: fr.Rom, h: float) -> float:
    """The exact gradient through a plan's steps, of tensions between the bounds: a share of that without tensions."""
    planner, body, (every, held) = Planner(rom, h), fr.Simulator(rom, h), (round(SAMPLED / h), round(GRID / h))
    path = path_at(SAMPLED * np.arange(1, round(HORIZON / SAMPLED) + 1))

    def squares(outputs: dict[str, Array], energies: Array) -> tuple[float, dict[str, Array], None]:
        apart, slope = outputs["tip"][every - 1 :: every, 0, 2] - path, np.zeros_like(outputs["tip"])
        slope[every - 1 :: every, 0, 2] = apart
        return float(apart @ apart) / 2, {"tip": slope}, None

    def gradient(u: Array) -> Array:
        each = np.repeat(u[: len(u) - 1], held, axis=0)
        inputs = np.hstack([np.zeros((len(each), 1)), each])
        by_step = fr.differentiate(body, inputs, squares, outputs=["tip"]).inputs[:, 1:]
        changes = np.diff(u, axis=0, prepend=0.0)
        eased = EASE * (changes - np.vstack([changes[1:], np.zeros((1, 2))]))
        return np.vstack([by_step.reshape(-1, held, 2).sum(axis=1), np.zeros((1, 2))]) + eased

    u = planner.plan(0, np.zeros(len(planner.A)), path, np.zeros(2))
    slope, free = gradient(u), np.abs(u) < MOST
    return float(np.abs(slope[free]).max() / np.abs(gradient(0 * u)).max())


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
