"""A free body that spins, by Exudyn's floating frame and by the one here: the same M, K and node positions to both.

A steel shaft of 1 m carries 0.1 kg at an edge of its middle, and spins freely at 50 Hz about its axis, undeformed and
without vibration at first; the centrifugal force of the mass makes it bend and whirl. What is judged is how far it is
bowed, which is the same in every frame, against the same floating frame with nearly all modes in steps of 10 µs.

Exudyn has no stiffening by centrifugal forces, and of matrices alone there is none here, either. Its bases are its own:
free modes, and attachment modes of both end faces with inner modes. The one here is balanced, of forces on the mass.
"""

import statistics
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from itertools import permutations
from pathlib import Path

import numpy as np
from environments import PeerError, ask
from findings import Findings
from scipy.sparse import csr_matrix, diags
from turns import machine

import fenics_rom as fr
from fenics_rom.compilation import numpy_alone

LENGTH, SIDE, BRICKS = 1.0, 0.02, 28  # m
YOUNG, POISSON, DENSITY = 2.1e11, 0.3, 7850.0  # Pa, kg/m3
UNBALANCE = 0.1  # kg
BETA = 1e-9  # s, of damping: next to none
SPIN = (2 * np.pi * 50.0, 0.0, 0.0)  # rad/s
DURATION, EVERY = 0.1, 1e-3  # s; at multiples of the latter bows are compared
REFERENCE = (300, 1e-5)  # modes, and step, s
STEPS = (1e-4, 1e-5)  # s; the last one is that of the reference, so that errors are of the basis
MODES = (3, 9, 20)  # elastic
BASES = {"free modes": (9, 20), "attachment modes": (9, 20)}  # of Exudyn
SCHEME = (
    "trapezoidal"  # generalized alpha, with a spectral radius of 0.8, has the same rates and somewhat larger errors
)
ENDS = np.array([-1, 0, 1])  # and the middle, in halves of the length
AS_GOOD = 0.5  # of the error of its best basis, at 9 modes
AS_FAST = 2.5  # times the rate of its fastest basis that is as right as 9 modes here, or nearly
NEARLY = 1.5  # times the error

Array = np.ndarray


@dataclass(frozen=True)
class Shaft:
    """What is given to both.

    Attributes:
        X: (N, 3) node positions, m.
        M, K: kg, N/m.
        node: of the mass that is out of balance.
    """

    X: Array
    M: csr_matrix
    K: csr_matrix
    node: int

    def write(self, file: Path) -> None:
        """To a file that needs nothing but NumPy to be read."""
        parts = {f"{a}_{part}": getattr(getattr(self, a), part) for a in "MK" for part in ("data", "indices", "indptr")}
        np.savez(file, X=self.X, **parts)


def shaft() -> Shaft:
    """Linear tetrahedra, six in a brick."""
    shape = (BRICKS + 1, 2, 2)
    X = np.stack(np.meshgrid(*(np.linspace(-1, 1, n) / 2 for n in shape), indexing="ij"), axis=-1).reshape(-1, 3)
    X *= (LENGTH, SIDE, SIDE)
    corners = np.stack(np.meshgrid(*(np.arange(n - 1) for n in shape), indexing="ij"), axis=-1).reshape(-1, 3)
    cells = np.concatenate([walk(corners, axes, shape) for axes in permutations(range(3))])
    edges = X[cells[:, 1:]] - X[cells[:, :1]]
    volumes = np.abs(np.linalg.det(edges)) / 6
    gradients = np.linalg.inv(edges).swapaxes(1, 2)
    gradients = np.concatenate([-gradients.sum(axis=1, keepdims=True), gradients], axis=1)  # (cells, 4, 3)
    shear = YOUNG / (2 * (1 + POISSON))
    bulk = 2 * shear * POISSON / (1 - 2 * POISSON)
    products = np.einsum("cik,cjl->cijkl", gradients, gradients)
    stiffness = bulk * products + shear * products.swapaxes(3, 4)
    stiffness += shear * np.einsum("cijmm,kl->cijkl", products, np.eye(3))
    mass = np.einsum("ij,kl->ijkl", DENSITY / 20 * (np.ones((4, 4)) + np.eye(4)), np.eye(3))[None]
    rows = 3 * cells[:, :, None] + np.arange(3)
    K, M = (assembled(rows, volumes[:, None, None, None, None] * each, X.size) for each in (stiffness, mass))
    node = int(np.abs(X - [0, SIDE / 2, SIDE / 2]).sum(axis=1).argmin())
    return Shaft(X, (M + diags(np.repeat(UNBALANCE * (np.arange(len(X)) == node), 3))).tocsr(), K, node)


def walk(corners: Array, axes: tuple[int, ...], shape: tuple[int, int, int]) -> Array:
    """The tetrahedron of each brick that goes from its first corner to its last along the axes in that order."""
    steps = np.cumsum([np.zeros(3, dtype=int), *np.eye(3, dtype=int)[list(axes)]], axis=0)
    return np.stack([np.ravel_multi_index(tuple((corners + step).T), shape) for step in steps], axis=1)


def assembled(rows: Array, blocks: Array, size: int) -> csr_matrix:
    """A matrix of blocks (cells, 4, 4, 3, 3) for rows (cells, 4, 3)."""
    i, j = np.broadcast_arrays(rows[:, :, None, :, None], rows[:, None, :, None, :])
    return csr_matrix((np.broadcast_to(blocks, i.shape).ravel(), (i.ravel(), j.ravel())), shape=(size, size))


def system(of: Shaft) -> fr.System:
    """The free body, pushed where the mass is."""
    column = np.zeros((of.X.size, 3))
    column[3 * of.node + np.arange(3), np.arange(3)] = 1.0
    own = {"mass": of.M, "rayleigh": (0.0, BETA), "stiffness": of.K}
    return fr.System(**own, contacts={"mass": column}, nodes=of.X, frame="moving")


def spinning(rom: fr.Rom, dt: float) -> fr.Simulator:
    """The body as it is thrown."""
    body = fr.Simulator(rom, dt)
    body.place(body.pose._replace(angular_velocity=np.array(SPIN)))
    return body


def ways() -> dict[str, Callable[[], AbstractContextManager[None]]]:
    """What is made within takes such steps: NumPy's, and compiled ones where there are any."""
    return {"NumPy": numpy_alone, "compiled": nullcontext} if fr.compiled() else {"NumPy": numpy_alone}


def spin(rom: fr.Rom, dt: float, nodes: Array) -> tuple[Array, float, float]:
    """The bow at multiples of EVERY, (instants,), m; steps per second; and by how much energy grew, as a share."""
    body, places, seconds = spinning(rom, dt), [], 0.0
    u, steps, energy = np.zeros(body.inputs), round(EVERY / dt), body.energy
    for _ in range(round(DURATION / EVERY)):
        start = time.process_time()
        for _ in range(steps):
            body.step(u)
        seconds += time.process_time() - start
        places.append(rom.nodes[nodes] + body.displacement()[nodes])
    gained = abs(body.energy + body.ledger.dissipated - energy) / energy
    return bow_of(np.array(places)), len(places) * steps / seconds, gained


def bow_of(places: Array) -> Array:
    """Distance of the middle from halfway between the ends, (instants,), m: the same in every frame."""
    start, middle, end = places.swapaxes(0, 1)
    return np.linalg.norm(middle - (start + end) / 2, axis=1)


def compare(interpreter: Path | PeerError, out: Path, findings: Findings, rounds: int, quick: bool = False) -> None:
    """All of it, or what can be said without Exudyn.

    Args:
        interpreter: of an environment with Exudyn, or why there is none.
        out: where files go.
        findings: where the table, numbers and claims go.
        rounds: of the timings.
        quick: few modes and one step.
    """
    body, given = shaft(), out / "shaft.npz"
    body.write(given)
    nodes = np.array([np.abs(body.X - [x, SIDE / 2, SIDE / 2]).sum(axis=1).argmin() for x in LENGTH / 2 * ENDS])
    full = system(body)
    most, least_step = (40, STEPS[0] / 2) if quick else REFERENCE
    reference, *_ = spin(fr.reduce(full, order=most, method="modal"), least_step, nodes)
    rows: list[tuple[object, ...]] = []
    errors: dict[tuple[str, float], float] = {}
    rates: dict[tuple[str, float], float] = {}

    def add(model: str, modes: int, dt: float, runs: list[tuple[Array, float]]) -> None:
        error = float(np.linalg.norm(runs[0][0] - reference) / np.linalg.norm(reference))
        rate = statistics.median(each for _, each in runs)
        errors[f"{model}, {modes}", dt], rates[f"{model}, {modes}", dt] = error, rate
        rows.append((model, modes, f"{1e6 * dt:g} µs", f"{error:.1e}", f"{rate:,.0f}", f"{1e3 / (rate * dt):,.0f}"))

    gains = []
    for dt in STEPS[: 1 if quick else None]:
        for way, made in ways().items():
            for modes in MODES:
                with made():
                    runs = [spin(fr.reduce(full, order=modes), dt, nodes) for _ in range(rounds)]
                gains += [gained for *_, gained in runs]
                add(f"fenics_rom, {way}", modes, dt, [(bow, rate) for bow, rate, _ in runs])
        for kind, choices in BASES.items():
            for modes in choices:
                task = {"kind": kind, "modes": modes, "dt": dt, "scheme": SCHEME, "beta": BETA, "spin": SPIN}
                task |= {"duration": DURATION, "every": EVERY, "nodes": nodes.tolist()}
                try:
                    if isinstance(interpreter, PeerError):
                        raise interpreter
                    worker = interpreter, "exudyn_worker.py", given, out / "exudyn.npz", task
                    found = [ask(*worker) for _ in range(rounds)]
                except PeerError as why:
                    rows.append((f"Exudyn, {kind}", modes, f"{1e6 * dt:g} µs", str(why), "", ""))
                    continue
                runs_there = [(bow_of(each["places"])[1:], float(each["rate"])) for each in found]
                add(f"Exudyn, {kind}", modes, dt, runs_there)
    title = (
        f"## A free body that spins, by Exudyn\n\n{body.X.size} unknowns, {SPIN[0] / (2 * np.pi):g} Hz, "
        f"{DURATION:g} s; one thread each; {machine()}; rates: by processor time, medians of {rounds}. Errors: of the "
        f"bow, 2-norm over the run, against "
        f"{most} modes in steps of {1e6 * least_step:g} µs. The last column is how many ms a second of the body takes."
    )
    findings.table(title, ("model", "modes", "step", "error", "steps per second", "ms per s"), rows)
    findings.numbers["Exudyn, errors"] = {f"{name} at {dt:g} s": error for (name, dt), error in errors.items()}
    findings.at_most("energy gained in a run, as a share", max(gains), 1e-11)
    here, dt = f"fenics_rom, {list(ways())[-1]}, 9", STEPS[-1]
    theirs = {name: error for (name, step), error in errors.items() if name.startswith("Exudyn") and step == dt}
    if theirs:
        best = min(error for name, error in theirs.items() if name.endswith(", 9"))
        findings.at_most("error at 9 modes, in that of Exudyn's best basis", errors[here, dt] / best, AS_GOOD)
        right = [rates[name, dt] for name, error in theirs.items() if error <= NEARLY * errors[here, dt]]
        if right:
            ratio = rates[here, dt] / max(right)
            findings.at_least("steps per second at 9 modes, in Exudyn's at that error", ratio, AS_FAST, rate=True)
