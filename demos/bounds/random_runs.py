"""A thousand random runs of linear bodies: is an error ever above its bound, and how good are estimates?

    python demos/bounds/random_runs.py                  # 1,000 runs, 3 min
    python demos/bounds/random_runs.py --runs 50        # the first of them

Chains, plates and fingers with tendons, a third of them with dashpots, of 60 to 200 unknowns; damping from strong to
hardly any; orders 5 to 60; inputs that are noise, steps, smooth or held; contact modes that change at every step, now
and then, or never; steps of 1e-5 to 1e-1 s. The full order takes the same steps. Exits with 1 where a claim fails.
"""

import argparse
import sys
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy import ndarray as Array
from scipy.linalg import eigh

import fenics_rom as fr
from fenics_rom.io.markdown import markdown

STEPS = 150  # of a run
ROUND_OFF = 1e-10  # of the largest energy norm: errors below it are of the arithmetic
OUTPUT_ROUND_OFF = 1e-8  # the same of outputs: K of a finger spans seven decades, so its softest shape is known to 1e-9
METHODS = "modal", "modal+static", "balanced"


class Errors(NamedTuple):
    """What a run is off, and what it states, at the end of each step."""

    true: Array  # (steps,) in the energy norm, J^1/2
    bound: Array
    estimate: Array
    largest: float  # energy norm of the full order
    outputs: float  # by how much an output's error is above its bound, of what it may be at the largest energy norm

    @property
    def effectivity(self) -> float:
        """The largest bound over the largest error."""
        return float(self.bound.max() / self.true.max())

    @property
    def ratio(self) -> float:
        """The largest estimate over the largest error."""
        return float(self.estimate.max() / self.true.max())

    @property
    def broken(self) -> float:
        """By how much the error is above the bound, of the largest energy norm; at most round-off."""
        return self.broken_by(1.0)

    def broken_by(self, share: float) -> float:
        """The same by a share of the bound."""
        return float((self.true - share * self.bound).max() / self.largest)

    @property
    def known(self) -> bool:
        """Whether there is an error beyond round-off."""
        return bool(self.true.max() > 100 * ROUND_OFF * self.largest)


def compare(system: fr.System, roms: list[fr.Rom], h: float, contacts: list[str], inputs: Array) -> list[Errors]:
    """Steps of h s at full order and of ROMs, in these contact modes (steps,) under inputs (steps, p)."""
    M, D, K = system.mass, system.damping, system.stiffness
    B = {name: system.input_matrix(name) for name in system.contacts}
    C = {name: np.asarray(columns) for name, columns in system.outputs.items()}
    x = v = np.zeros((system.size, 1))
    factor = system.algebra.factor((2 / h, M), (1.0, D), (h / 2, K))
    bodies = [fr.Simulator(rom, h) for rom in roms]
    W = [{name: rom.basis @ model.coordinates for name, model in rom.contact_models.items()} for rom in roms]
    told, largest = np.zeros((len(roms), 3, len(inputs))), 0.0
    above = [dict.fromkeys(C, -np.inf) for _ in roms]
    for step, (contact, u) in enumerate(zip(contacts, inputs, strict=True)):
        middle = factor.solve(B[contact] @ u[:, None] + 2 / h * (M @ v) - K @ x)
        x, v = x + h * middle, 2 * middle - v
        largest = max(largest, norm(M, K, x, v))
        for k, body in enumerate(bodies):
            body.switch(contact)
            body.step(u)
            (q, r), basis, bound = body.state, W[k][contact], body.error_bound
            e, ė = x - basis @ q[:, None], v - basis @ r[:, None]
            told[k, :, step] = norm(M, K, e, ė), bound.norm, body.error_estimate.norm
            for name, columns in C.items():
                over = np.abs(columns.T @ e).ravel() - bound.output(name).ravel()
                above[k][name] = max(above[k][name], over.max())
    reach = {name: largest * of.max() for name, of in roms[0].error_model.output_compliances.items()}
    shares = [max(of[name] / reach[name] for name in C) for of in above]
    return [Errors(*of, largest, float(share)) for of, share in zip(told, shares, strict=True)]


def norm(M: sp.spmatrix, K: sp.spmatrix, x: Array, v: Array) -> float:
    """√(vᵀMv + xᵀKx)."""
    return float(np.sqrt(np.vdot(v, M @ v) + np.vdot(x, K @ x)))


def random_system(random: np.random.Generator) -> fr.System:
    """A chain, a plate or a finger with any damping, down to hardly any; two contact modes."""
    body, actuators = (chain_of, plate_of, finger_of)[random.integers(3)], {}
    K, M = body(random)
    n = len(K)
    unit, ω = np.eye(n), float(np.sqrt(eigh(K, M, eigvals_only=True, subset_by_index=[0, 0])[0]))
    α, β = 10 ** random.uniform(-5, 0) * ω, 10 ** random.uniform(-6, -1) / ω
    nodes = random.choice(n, 5, replace=False)
    if body is finger_of:
        nodes = 2 * (nodes // 2)  # displacements, not rotations
        actuators = {"flexor": unit[:, [n - 1]], "extensor": unit[:, [n // 4 * 2 + 1]]}  # moments
    given = {"rayleigh": (α, β)}
    if random.random() < 0.3:
        dashpots = np.zeros(n)
        dashpots[nodes[:2]] = 10 ** random.uniform(-2, 0) * M[nodes[0], nodes[0]] * ω
        given = {"damping": sp.csc_matrix(α * M + β * K + np.diag(dashpots))}
    contacts = {"one": unit[:, nodes[:2]], "two": unit[:, nodes[2:4]]}
    outputs = {"far": unit[:, nodes[4:]]}
    matrices = {"mass": sp.csc_matrix(M), "stiffness": sp.csc_matrix(K)}
    return fr.System(**matrices, contacts=contacts, actuators=actuators, outputs=outputs, **given)


def chain_of(random: np.random.Generator) -> tuple[Array, Array]:
    """K and M of masses between springs."""
    n = int(random.integers(60, 200))
    springs = 1e3 * np.exp(random.uniform(-1, 1, n + 1))
    K = np.diag(springs[:-1] + springs[1:]) - np.diag(springs[1:-1], 1) - np.diag(springs[1:-1], -1)
    return K, np.diag(1e-2 * np.exp(random.uniform(-0.5, 0.5, n)))


def plate_of(random: np.random.Generator) -> tuple[Array, Array]:
    """The same of a plate, as finite differences have it."""
    long, wide = (int(size) for size in random.integers(8, 15, 2))
    line, across = (2 * np.eye(size) - np.eye(size, k=1) - np.eye(size, k=-1) for size in (long, wide))
    bent = np.kron(line, np.eye(wide)) + np.kron(np.eye(long), across)
    return 50.0 * (bent @ bent), 1e-2 * np.eye(long * wide)


def finger_of(random: np.random.Generator) -> tuple[Array, Array]:
    """The same of a beam that is held at one end and tapers: of nodes displacements, and rotations times a cell."""
    n = int(random.integers(30, 50))
    bending = np.exp(random.uniform(-0.2, 0.2, n)) * np.linspace(1, random.uniform(0.1, 0.5), n)
    weight = 1e-2 * np.linspace(1, random.uniform(0.3, 0.8), n)
    k = 50.0 * np.array([[12, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4]])
    m = np.array([[156, 22, 54, -13], [22, 4, 13, -3], [54, 13, 156, -22], [-13, -3, -22, 4]]) / 420
    K, M = np.zeros((2, 2 * n + 2, 2 * n + 2))
    for cell in range(n):
        at = slice(2 * cell, 2 * cell + 4)
        K[at, at] += bending[cell] * k
        M[at, at] += weight[cell] * m
    return K[2:, 2:], M[2:, 2:]


def random_history(random: np.random.Generator, ω: float, p: int) -> tuple[float, list[str], Array]:
    """Step size, s, contact mode of each step, and inputs (STEPS, p); ω is the lowest frequency, rad/s."""
    h, kind = 10 ** random.uniform(-5, -1), random.integers(4)
    inputs = random.standard_normal((STEPS, p))
    if kind == 1:
        inputs = np.repeat(inputs[: STEPS // 30], 30, axis=0)
    elif kind == 2:
        inputs = np.sin(np.outer(np.arange(STEPS) * h * ω * random.uniform(0.1, 5), np.linspace(1.0, 0.7, p)))
    elif kind == 3:
        inputs = np.ones((STEPS, p))
    every = [1, 40, STEPS][random.integers(3)]
    return h, [("one", "two")[step // every % 2] for step in range(STEPS)], inputs


def random_run(seed: int) -> Errors:
    """One of the runs."""
    random = np.random.default_rng(seed)
    system, order = random_system(random), int(random.integers(5, 61))
    rom = fr.reduce(system, order=min(order, system.size // 2), method=str(random.choice(METHODS)), errors=True)
    return compare(system, [rom], *random_history(random, np.sqrt(rom.stiffness[0]), _inputs(rom)))[0]


def _inputs(rom: fr.Rom) -> int:
    """How many a contact mode has."""
    return rom.contact_models["one"].inputs.shape[1]


def ranking(seed: int) -> tuple[Array, Array]:
    """The largest errors of orders 10, 20 and 40 in a run, and the largest estimates."""
    random = np.random.default_rng(seed)
    system = random_system(random)
    rom = fr.reduce(system, order=40, method=str(random.choice(METHODS)), errors=True)
    roms = [fr.truncate(rom, order) for order in (10, 20, 40)]
    runs = compare(system, roms, *random_history(random, np.sqrt(rom.stiffness[0]), _inputs(rom)))
    return np.array([run.true.max() for run in runs]), np.array([run.estimate.max() for run in runs])


def main() -> None:
    """Takes the runs, prints what came of them, and exits with 1 where a claim fails."""
    parser = argparse.ArgumentParser(description="Random runs, with bounds and estimates of their errors.")
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0, help="seed")
    given = parser.parse_args()
    seeds = range(given.first, given.first + given.runs)
    runs = [run for run in map(random_run, seeds) if run.known]
    ranks = [ranking(10_000 + seed) for seed in seeds[: max(1, given.runs // 5)]]
    effectivity, ratio = np.array([run.effectivity for run in runs]), np.array([run.ratio for run in runs])
    near = float(((ratio > 1 / 1.5) & (ratio < 1.5)).mean())
    same = float(np.mean([(np.argsort(true) == np.argsort(told)).all() for true, told in ranks]))
    caught = sum(run.broken_by(0.95) > ROUND_OFF for run in runs)
    shares = np.percentile(effectivity, [5, 50, 95, 100])
    print(f"{len(runs)} of {given.runs} runs have errors beyond round-off; {len(ranks)} are ranked\n")
    rows = [("bound over error", *(f"{share:.3g}" for share in shares))]
    rows.append(("estimate over error", *(f"{share:.3g}" for share in np.percentile(ratio, [5, 50, 95, 100]))))
    print(markdown(("largest in a run", "5 %", "median", "95 %", "most"), rows))
    claims = [
        ("no error is above its bound, beyond round-off", max(run.broken for run in runs) <= ROUND_OFF),
        ("no error of an output is above its bound", max(run.outputs for run in runs) <= OUTPUT_ROUND_OFF),
        (f"0.95 of the bound is below the error in some runs ({caught} of them)", caught > 0),
        ("the bound is below 4 times the error in half of the runs", shares[1] < 4),
        ("and below 60 times in 95 %", shares[2] < 60),
        (f"the estimate is within a factor of 1.5 in 90 % of the runs ({near:.1%})", near >= 0.9),
        (f"it ranks orders 10, 20 and 40 as the errors do in 95 % ({same:.1%})", same >= 0.95),
    ]
    for claim, holds in claims:
        print(f"  {'holds' if holds else 'FAILS'}: {claim}")
    sys.exit(0 if all(holds for _, holds in claims) else 1)


if __name__ == "__main__":
    main()
