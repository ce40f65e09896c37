"""A beam that swings, by MuJoCo's flexes and by this project: what is left of it after ten periods, and what it costs.

The beam is clamped at one end and pushed at the other for 20 ms, so that it swings by about 1 % of its length: the
linear regime, which is all that this project does, and in which MuJoCo's Saint Venant-Kirchhoff material does the same.
Gravity and contact are off. The only damping is physical, D = β K.

Two errors are told apart, each of the tip's displacement over the whole run, in L2, as a share of the displacement:

- of time: to the same flex stepped by RK4 in the smallest steps, or to our model solved without steps;
- of everything: to finite elements of degree 2 on a fine mesh, solved without steps by their eigenvectors.

MuJoCo's M, D and K at rest are read from its forces by differences and reduced as well: the same matrices in both.
"""

import json
import statistics
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import gmsh
import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from environments import Found, PeerError, ask
from findings import Findings
from scipy.linalg import eigh
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import LinearOperator, eigsh, splu
from turns import ROUNDS, machine, medians

import fenics_rom as fr
from fenics_rom.scene.file import parse_scene

SIZE = (0.1, 0.03, 0.03)  # m
BETA = 5e-5  # s
FORCE = 0.35  # N, in z
PUSH, DURATION, SAMPLE = 0.02, 0.42, 2e-3  # s; half a period, and ten more
BEAM: dict[str, Any] = {
    "size": SIZE,
    "young": 3.45e6,  # Pa
    "poisson": 0.3,
    "density": 1187.4,  # kg/m3
    "damping": BETA,
    "force": FORCE,
    "push": PUSH,
    "duration": DURATION,
    "sample": SAMPLE,
}
LAST = round(0.08 / SAMPLE)  # samples of the last two periods
FINE, COARSER = 0.008, 0.014  # m, sizes of the elements of degree 2
MODES = 20  # of the fine elements that are solved for

STEPS = (2e-3, 1e-3, 5e-4, 2.5e-4, 2e-4, 1.25e-4, 1e-4, 5e-5, 2e-5)  # s
FINEST = STEPS[-1]
INTEGRATORS = {"Euler": ("CG",), "RK4": ("CG",), "discrete": ("CG", "Newton")}  # with the solvers that matter to them
ORDER = 20
BODIES = 1024
MUJOCO_BODIES = 64
GOALS = (1e-2, 1e-3)  # of the error of time
STEPPED = "step, energy account kept"

SCENE = """
name = "beam"
[mesh]
file = "{file}"
degree = {degree}
[material]
young = {young}
poisson = {poisson}
density = {density}
[supports]
clamped = ["clamped"]
[contacts.tip]
surface = "tip"
[effects]
inertia = {{}}
damping = {{ alpha = 0.0, beta = {damping} }}
"""

Array = np.ndarray


@dataclass(frozen=True)
class Flex:
    """One of MuJoCo's ways to make a beam: what moves are vertices of tetrahedra, or nodes of cells around them."""

    dof: str
    count: tuple[int, int, int]
    cells: tuple[int, int, int] | None = None

    @property
    def name(self) -> str:
        """What it is called in tables."""
        return f"{self.dof}, {' × '.join(map(str, self.cells or self.count))} {'cells' if self.cells else 'points'}"

    def given(self) -> dict[str, Any]:
        """For MuJoCo's worker."""
        return {"dof": self.dof, "count": self.count, "cells": self.cells}


FLEXES = (
    Flex("full", (9, 3, 3)),
    Flex("trilinear", (9, 3, 3), (8, 2, 2)),
    Flex("quadratic", (9, 3, 3), (1, 1, 1)),
    Flex("quadratic", (9, 3, 3), (2, 1, 1)),
)
LARGER = (Flex("quadratic", (9, 3, 3), (4, 2, 2)), Flex("full", (13, 4, 4)))
DRAWN = FLEXES[-1]


@dataclass(frozen=True)
class Run:
    """One model at one time step.

    Attributes:
        model: whose.
        way: integrator, or how it is stepped.
        unknowns: that are stepped.
        step: s.
        rate: steps per second of a body.
        kept: amplitude over the last two periods, of that which physical damping leaves.
        error_of_time: to the same model without time steps, or with the smallest.
        error: to the fine finite elements.
        path: the tip's displacement at every sample, m.
    """

    model: str
    way: str
    unknowns: int
    step: float
    rate: float
    kept: float
    error_of_time: float
    error: float
    path: Array

    @property
    def realtime(self) -> float:
        """Simulated seconds per second."""
        return self.rate * self.step

    def row(self) -> tuple[object, ...]:
        """For a table."""
        return (
            *(self.model, self.way, self.unknowns, f"{1e3 * self.step:g} ms", f"{self.rate:,.0f}"),
            *(f"{self.realtime:.3g}", f"{100 * self.kept:.4g} %", f"{self.error_of_time:.1e}", f"{self.error:.1e}"),
        )


def compare(
    interpreter: Path | PeerError,
    out: Path,
    findings: Findings,
    flexes: tuple[Flex, ...],
    sizes: tuple[float, float] = (FINE, COARSER),
    rounds: int = ROUNDS,
) -> None:
    """All of it, or what can be said without MuJoCo.

    Args:
        interpreter: of an environment with MuJoCo, or why there is none.
        out: where files go.
        findings: where tables, numbers and claims go.
        flexes: MuJoCo's.
        sizes: of the fine elements, and of those that tell how good they are, m.
        rounds: of the timings.
    """
    (out / "beam.json").write_text(json.dumps(BEAM))
    system = fine(sizes[0], out)
    reference = exact(*matrices(system))
    coarser = distance(exact(*matrices(fine(sizes[1], out))), reference)
    findings.at_most("finite elements of the reference and those of 1.75 times their size", coarser, 5e-2)
    roms = {f"fenics_rom, P2 elements reduced from {system.size:,}": fr.reduce(system, order=ORDER)}
    own = {next(iter(roms)): reference}
    runs: list[Run] = []
    rows: list[tuple[object, ...]] = []
    rates: dict[tuple[str, str, float], list[float]] = {}
    found: dict[Flex, Paths] = {}
    try:
        for flex in flexes:
            found[flex] = paths(interpreter, flex, out)
            roms[label := f"fenics_rom, of {flex.name}"] = fr.reduce(linear(found[flex].matrices), order=ORDER)
            own[label] = found[flex].reference
            check_matrices(flex, found[flex], out, findings)
    except PeerError as error:
        rows.append(("MuJoCo", str(error), *[""] * 7))
        found = {}
    ways = {name: loops(rom) for name, rom in roms.items()}
    for _ in range(rounds):
        for name, each in ways.items():
            for way, rate in medians(each, 1).items():
                rates.setdefault((name, way, 0.0), []).append(rate)
        for flex, its in found.items():
            its.measure(flex, interpreter, out, rates)
    middle = {key: statistics.median(each) for key, each in rates.items()}

    for flex, its in found.items():
        runs += its.runs(flex, middle, reference)
        rows += its.broken
    for name, rom in roms.items():
        for h in STEPS:
            path = rollout(rom, h)
            errors = (kept(path, own[name]), distance(path, own[name]), distance(path, reference))
            order = next(iter(rom.contact_models.values())).order
            runs += [Run(name, way, order, h, middle[name, way, 0.0], *errors, path) for way in ways[name]]
    setting = (
        f"{caption(next(iter(roms.values())), found, rounds)} Fine elements: {system.size:,} unknowns of degree 2, "
        f"without steps; those of 1.75 times their size are {100 * coarser:.1f} % away, and fenics_rom's P2 elements "
        "are the fine ones, reduced."
    )
    short_table(runs, rows, {name: frequency(rom) for name, rom in roms.items()}, setting, findings)
    long_table(runs, rows, setting, findings)
    claims(runs, list(roms), found, findings)
    picture(runs, list(roms), coarser, out / "mujoco.png")
    picture_of_paths(runs, list(roms), reference, out / "tip.png")


def fine(size: float, out: Path) -> fr.System:
    """Finite elements of degree 2 of a size, m; one input and one output, the tip's in z."""
    file = out / f"beam_{1e3 * size:g}mm.msh"
    gmsh.initialize([], readConfigFiles=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        box = gmsh.model.occ.addBox(0, -SIZE[1] / 2, -SIZE[2] / 2, *SIZE)
        gmsh.model.occ.synchronize()
        gmsh.model.setPhysicalName(3, gmsh.model.addPhysicalGroup(3, [box]), "beam")
        for _, face in gmsh.model.getEntities(2):
            x = gmsh.model.occ.getCenterOfMass(2, face)[0]
            if x < 1e-6 or x > SIZE[0] - 1e-6:
                group = gmsh.model.addPhysicalGroup(2, [face])
                gmsh.model.setPhysicalName(2, group, "clamped" if x < 1e-6 else "tip")
        gmsh.model.mesh.setSizeCallback(lambda dim, tag, x, y, z, *_: size * grading(x, y, z))
        gmsh.model.mesh.generate(3)
        gmsh.write(str(file))
    finally:
        gmsh.finalize()
    return assembled(file, degree=2)


def grading(x: float, y: float, z: float) -> float:
    """Size of the elements: finer where the clamp ends, since stresses are singular there."""
    within = min(SIZE[1] / 2 - abs(y), SIZE[2] / 2 - abs(z))
    return float(min(1.0, 0.2 + np.hypot(x, within) / SIZE[1]))


def assembled(file: Path, degree: int) -> fr.System:
    """The beam on a mesh, with one input and one output: the mean over the tip's face, in z."""
    text = SCENE.format(file=file.name, degree=degree, **BEAM)
    system = fr.assemble(parse_scene(text, folder=file.parent, source="beam"))
    B = system.input_matrix("tip")
    return replace(system, contacts={"tip": B[:, 2:]}, outputs={"tip": B})  # an output of a mesh has three components


def matrices(system: fr.System) -> tuple[csc_matrix, csc_matrix, Array]:
    """M, K and B in SciPy's formats."""
    M, K = (
        csc_matrix(operator.mat.getValuesCSR()[::-1], shape=(system.size, system.size))
        for operator in (system.mass, system.stiffness)
    )
    return M, K, system.input_matrix("tip")[:, 0]


def linear(found: Found) -> fr.System:
    """MuJoCo's matrices at rest, without the round-off of their differences."""
    K = (found["K"] + found["K"].T) / 2
    tip = {"tip": found["B"][:, None]}
    return fr.System(mass=np.diag(np.diag(found["M"])), rayleigh=(0.0, BETA), stiffness=K, contacts=tip, outputs=tip)


def exact(M: Any, K: Any, B: Array) -> Array:
    """The tip's displacement at every sample without time steps, m: by eigenvectors of K and M, where D = β K.

    Each answers to a force f from t = 0 on by f (b/ω)² (1 - e^(-ζωt) (cos ωᵈt + ζω/ωᵈ sin ωᵈt)), ζ = βω/2; the push is
    such a force less one from its end on. Those of a sparse M and K that are not solved for follow the force at once.
    """
    sparse = not isinstance(M, np.ndarray)
    solve = splu(K).solve if sparse else partial(np.linalg.solve, K)
    λ, V = eigsh(K, MODES, M, sigma=0.0, OPinv=LinearOperator(K.shape, solve)) if sparse else eigh(K, M)
    b = V.T @ B
    at_once = B @ solve(B) - (b**2 / λ).sum()
    ω = np.sqrt(λ)
    ζω = BETA * λ / 2
    ωd = np.sqrt((λ - ζω**2).astype(complex))  # those of large ω do not swing

    def answer(t: Array) -> Array:
        since = np.maximum(t, 0)[:, None]
        decay = np.exp((1j * ωd - ζω) * since), np.exp((-1j * ωd - ζω) * since)
        swing = (decay[0] + decay[1]) / 2 + ζω / ωd * (decay[0] - decay[1]) / 2j
        return ((1 - swing).real / ω**2) @ b**2 + np.where(t > 0, at_once, 0.0)

    t = SAMPLE * np.arange(1, samples() + 1)
    return FORCE * (answer(t) - answer(t - PUSH))


def samples() -> int:
    """Number of samples of a run."""
    return round(DURATION / SAMPLE)


def distance(path: Array, reference: Array) -> float:
    """Error in L2 as a share of the reference."""
    return float(np.linalg.norm(path - reference) / np.linalg.norm(reference))


def kept(path: Array, reference: Array) -> float:
    """Root mean square over the last two periods, as a share of the reference's."""
    return float(np.linalg.norm(path[-LAST:]) / np.linalg.norm(reference[-LAST:]))


def rollout(rom: fr.Rom, h: float) -> Array:
    """The tip's displacement at every sample in steps of h."""
    body = fr.Simulator(rom, dt=h, ledger=False)
    return body.rollout(forces(h), every=round(SAMPLE / h))["tip"].reshape(samples(), -1)[:, -1]


def forces(h: float) -> Array:
    """On the tip in every step, (steps, 1) N."""
    return np.where(np.arange(round(DURATION / h)) < round(PUSH / h), FORCE, 0.0)[:, None]


def loops(rom: fr.Rom) -> dict[str, Callable[[], int]]:
    """Ours: single steps, a rollout and many bodies at once, at a step of 0.1 ms; the tip is read at every sample."""
    h = 1e-4
    every, pushes = round(SAMPLE / h), forces(h)
    u = list(pushes)
    body = fr.Simulator(rom, dt=h)
    simulator = fr.Simulator(rom, dt=h, ledger=False)
    start = simulator.save()
    bodies = fr.Batch(rom, BODIES, h)
    same = np.full((BODIES, 1), FORCE)

    def step() -> int:
        for k, force in enumerate(u, 1):
            body.step(force)
            if k % every == 0:
                body.displacement("tip")
        return len(u)

    def rollout() -> int:
        simulator.restore(start)
        simulator.rollout(pushes, every=every)
        return len(pushes)

    def batch() -> int:
        for k in range(1, 201):
            bodies.step(same)
            if k % every == 0:
                bodies.displacement("tip")
        return 200 * BODIES

    return {STEPPED: step, "rollout": rollout, f"each of a Batch of {BODIES:,}": batch}


@dataclass(frozen=True)
class Paths:
    """What MuJoCo made of a flex.

    Attributes:
        matrices: M, D, K, B, and for vertices their points and tetrahedra.
        paths: the tip's by integrator and time step; only of those that survived.
        broken: rows for those that did not.
        reference: the path of the smallest steps.
        versions: MuJoCo's and NumPy's.
    """

    matrices: Found
    paths: dict[tuple[str, float], Array]
    broken: list[tuple[object, ...]]
    reference: Array
    versions: str

    def measure(
        self, flex: Flex, interpreter: Path | PeerError, out: Path, rates: dict[tuple[str, str, float], list[float]]
    ) -> None:
        """Adds a rate of the faster solver for each integrator and time step, alone and in MuJoCo's batch."""
        settings = [(way, solver, h) for way, h in self.paths for solver in INTEGRATORS[way]]
        found = mujoco(interpreter, out, "rates", flex, settings=settings, bodies=MUJOCO_BODIES)
        best: dict[tuple[str, str, float], float] = {}
        for k, (way, _, h) in enumerate(settings):
            fastest = max(float(found[f"rate_{k}"]), float(found[f"rate_batch_{k}"]))
            best[flex.name, way, h] = max(best.get((flex.name, way, h), 0.0), fastest)
        for key, rate in best.items():
            rates.setdefault(key, []).append(rate)

    def runs(self, flex: Flex, rates: dict[tuple[str, str, float], float], reference: Array) -> list[Run]:
        """One for each integrator and time step that survived."""
        return [
            Run(
                *(f"MuJoCo, {flex.name}", way, len(self.matrices["B"]), h, rates[flex.name, way, h]),
                *(kept(path, self.reference), distance(path, self.reference), distance(path, reference), path),
            )
            for (way, h), path in self.paths.items()
        ]


def mujoco(interpreter: Path | PeerError, out: Path, what: str, flex: Flex, **task: Any) -> Found:
    """What MuJoCo's worker finds.

    Raises:
        PeerError: there is none, or it failed.
    """
    if isinstance(interpreter, PeerError):
        raise interpreter
    given = {"what": what, "flex": flex.given()} | task
    return ask(interpreter, "mujoco_worker.py", out / "beam.json", out / "mujoco.npz", given)


def paths(interpreter: Path | PeerError, flex: Flex, out: Path) -> Paths:
    """All integrators and time steps of a flex.

    Raises:
        PeerError: there is no MuJoCo, or it failed.
    """
    settings = [(way, INTEGRATORS[way][0], h) for way, h in product(INTEGRATORS, STEPS)]
    found = mujoco(interpreter, out, "paths", flex, settings=settings)
    by_setting = {(way, h): found[f"path_{k}"] for k, (way, _, h) in enumerate(settings)}
    lost: list[tuple[object, ...]] = []
    for way in INTEGRATORS:
        steps = [f"{1e3 * h:g}" for h in STEPS if not by_setting[way, h].size]
        if steps:
            lost.append((f"MuJoCo, {flex.name}", way, "", f"{', '.join(steps)} ms", "unstable", *[""] * 4))
    return Paths(
        mujoco(interpreter, out, "matrices", flex),
        {key: path for key, path in by_setting.items() if path.size},
        lost,
        by_setting["RK4", FINEST],
        str(found["versions"]),
    )


def check_matrices(flex: Flex, found: Paths, out: Path, findings: Findings) -> None:
    """At rest MuJoCo's material is linear elasticity: its matrices do as it does, and are those of finite elements."""
    given = found.matrices
    K = (given["K"] + given["K"].T) / 2
    path = exact(np.diag(np.diag(given["M"])), K, given["B"])
    away = distance(path, found.reference)
    findings.at_most(f"MuJoCo's RK4 in its smallest steps and its own matrices at rest, {flex.name}", away, 2e-3)
    proportional = float(np.linalg.norm(given["D"] - BETA * K) / np.linalg.norm(given["D"]))
    findings.at_most(f"MuJoCo's damping and β K, {flex.name}", proportional, 1e-6)
    if flex.cells is None:
        system = assembled(tetrahedra(given, out / "flex.msh"), degree=1)
        ours, theirs = (np.linalg.eigvalsh(A) for A in (matrices(system)[1].toarray(), K))
        apart = float(np.abs(ours / theirs - 1).max())
        findings.at_most(f"eigenvalues of K, MuJoCo's and dolfinx's on its tetrahedra, {flex.name}", apart, 1e-6)


def tetrahedra(found: Found, file: Path) -> Path:
    """Writes MuJoCo's tetrahedra for Gmsh; the file."""
    points, cells = found["points"], found["tetrahedra"] + 1
    faces = np.unique(np.sort(np.vstack([np.delete(cells, k, axis=1) for k in range(4)]), axis=1), axis=0)
    elements = [f"4 2 3 1 {' '.join(map(str, cell))}" for cell in cells]
    for tag, x in ((1, 0.0), (2, SIZE[0])):
        chosen = faces[np.isclose(points[faces - 1, 0], x).all(axis=1)]
        elements += [f"2 2 {tag} {tag + 1} {' '.join(map(str, face))}" for face in chosen]
    nodes = [f"{k} {x!r} {y!r} {z!r}" for k, (x, y, z) in enumerate(points.tolist(), 1)]
    lines = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat", "$PhysicalNames", "3", '2 1 "clamped"', '2 2 "tip"']
    lines += ['3 3 "beam"', "$EndPhysicalNames", "$Nodes", str(len(nodes)), *nodes, "$EndNodes"]
    lines += ["$Elements", str(len(elements)), *(f"{k} {each}" for k, each in enumerate(elements, 1)), "$EndElements"]
    file.write_text("\n".join(lines) + "\n")
    return file


def caption(rom: fr.Rom, found: dict[Flex, Paths], rounds: int) -> str:
    """What all tables are about."""
    versions = "".join({f"{each.versions}; " for each in found.values()})
    return (
        f"A beam of {' × '.join(f'{1e3 * length:g}' for length in SIZE)} mm that swings at {frequency(rom):.1f} Hz, "
        f"clamped at one end, linear regime, D = β K; pushed for {1e3 * PUSH:g} ms, then free, {DURATION} s in all; "
        f"{versions}one thread each; {machine()}. Rates: medians of {rounds} rounds in which all took turns; MuJoCo's "
        "of `mj_step(m, d, nstep)` or of each body in its batch, whichever is more, with the faster of its solvers, "
        "contact off. Error of time: of the tip's displacement, in L2 over the run, as a share of it; of MuJoCo to the "
        f"same flex under RK4 in steps of {1e3 * FINEST:g} ms, of fenics_rom to the same model without steps."
    )


def frequency(rom: fr.Rom) -> float:
    """The lowest of a reduced beam, Hz."""
    return float(np.sqrt(rom.contact_models["tip"].eigenvalues.min()) / 2 / np.pi)


def short_table(
    runs: list[Run], rows: list[tuple[object, ...]], frequencies: dict[str, float], setting: str, findings: Findings
) -> None:
    """The longest steps that are good enough, and how good the model is without them."""
    best: list[tuple[object, ...]] = []
    for model, way in dict.fromkeys((run.model, run.way) for run in runs):
        mine = [run for run in runs if (run.model, run.way) == (model, way)]
        cells: list[str] = []
        for goal in GOALS:
            good = [run for run in mine if 0 < run.error_of_time <= goal]  # the reference itself has none
            fastest = max(good, key=lambda run: run.realtime, default=None)
            cells += ["-", "-"] if fastest is None else [f"{1e3 * fastest.step:g} ms", f"{fastest.realtime:.3g}"]
        swings = frequencies[model.replace("MuJoCo, ", "fenics_rom, of ")]
        best.append((model, way, mine[0].unknowns, *cells, f"{swings:.1f} Hz"))
    heading: tuple[str, ...] = ("model", "stepped by", "unknowns")
    for goal in GOALS:
        heading += (f"step for {100 * goal:g} %", "times real time")
    title = (
        f"## A beam, by MuJoCo's flexes\n\n{setting} The longest step of those tried whose error of time is small "
        "enough, and simulated seconds per second with it; last, at what frequency the model swings."
    )
    findings.table(title, (*heading, "frequency"), best + [row[:8] for row in rows if row[0] == "MuJoCo"])


def long_table(runs: list[Run], rows: list[tuple[object, ...]], setting: str, findings: Findings) -> None:
    """Everything."""
    title = (
        f"## The same, at all time steps\n\n{setting} Amplitude: root mean square over the last two periods, of what "
        "physical damping leaves."
    )
    heading = ("model", "stepped by", "unknowns", "step", "steps per second", "times real time", "amplitude kept")
    shown = [run.row() for run in runs if run.way == STEPPED or run.way in INTEGRATORS]
    findings.table(title, (*heading, "error of time", "error to fine elements"), [*shown, *rows])
    findings.numbers["beam"] = {f"{run.model}, {run.way}, {1e3 * run.step:g} ms": run.realtime for run in runs}


def claims(runs: list[Run], ours: list[str], found: dict[Flex, Paths], findings: Findings) -> None:
    """What is said about it."""

    def at(model: str, way: str, h: float) -> Run:
        return next(run for run in runs if (run.model, run.way, run.step) == (model, way, h))

    here = at(ours[0], "rollout", 1e-3)
    findings.at_most("|amplitude kept - 1| by fenics_rom at 1 ms", abs(here.kept - 1), 1e-2)
    findings.at_most("error of fenics_rom at 0.02 ms", at(ours[0], "rollout", FINEST).error, 1e-3)
    for flex in found:
        name = f"fenics_rom, of {flex.name}"
        findings.at_most(f"{name}: error of time at 0.02 ms", at(name, "rollout", FINEST).error_of_time, 2e-3)
        theirs = [run for run in runs if run.model == f"MuJoCo, {flex.name}"]
        discrete = next(run for run in theirs if (run.way, run.step) == ("discrete", 1e-3))
        findings.at_most(f"amplitude kept by MuJoCo's discrete at 1 ms, {flex.name}", discrete.kept, 0.1)
        for goal in GOALS:
            fastest = max((run.realtime for run in theirs if run.error_of_time <= goal), default=np.nan)
            mine = [run for run in runs if (run.model, run.way) == (name, STEPPED) and run.error_of_time <= goal]
            if mine and fastest > 0:
                times = max(run.realtime for run in mine) / fastest
                what = f"single steps for {100 * goal:g} % in the fastest of MuJoCo's, same matrices, {flex.name}"
                findings.at_least(what, times, 1, rate=True)


COLOURS = {"full": "C3", "trilinear": "C1", "quadratic": "C2"}
MARKERS = {"Euler": "o", "RK4": "^", "discrete": "s"}


def picture(runs: list[Run], ours: list[str], coarser: float, file: Path) -> None:
    """Errors of time and of everything against real time; `coarser` is how far coarser elements are away."""
    figure, axes = plt.subplots(1, 2, figsize=(12, 5.2), sharey=True, layout="constrained")
    lines = {STEPPED: "-", "rollout": "--", f"each of a Batch of {BODIES:,}": ":"}
    for plain, attribute in zip(axes, ("error_of_time", "error"), strict=True):
        for model, way in dict.fromkeys((run.model, run.way) for run in runs):
            mine = sorted((r for r in runs if (r.model, r.way) == (model, way)), key=lambda run: run.realtime)
            mine = [run for run in mine if getattr(run, attribute) > 0]  # the reference itself has none
            x, y = [run.realtime for run in mine], [getattr(run, attribute) for run in mine]
            if model == ours[0]:
                plain.loglog(x, y, lines[way], color="C0", marker=".", linewidth=2, label=f"fenics_rom, {way}")
            elif model not in ours:
                dof, detail = model.removeprefix("MuJoCo, ").split(", ")
                face = "white" if detail.startswith("1") else COLOURS[dof]
                style = {"color": COLOURS[dof], "marker": MARKERS[way], "markerfacecolor": face, "linewidth": 0.8}
                plain.loglog(x, y, label=f"{model}: {way}", markersize=5, **style)
        plain.axvline(1, color="0.6", linewidth=0.8, linestyle=":")
        plain.set_xlabel("simulated seconds per second, one thread")
        plain.grid(linewidth=0.4)
    axes[0].set(title="error of the time steps alone", ylabel="relative error of the tip's displacement over the run")
    axes[1].set_title("error to fine finite elements")
    axes[1].axhline(coarser, color="0.3", linewidth=0.8, linestyle="-.")
    axes[1].annotate(
        "elements of 1.75 times their size",
        (0.02, coarser),
        xytext=(4, 3),
        fontsize=8,
        xycoords=("axes fraction", "data"),
        textcoords="offset points",
    )
    axes[0].set_ylim(top=2)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, fontsize=8, handlelength=3)
    figure.savefig(file, dpi=130)
    plt.close(figure)


def picture_of_paths(runs: list[Run], ours: list[str], reference: Array, file: Path) -> None:
    """The tip over time, at steps of 1 ms or the longest stable ones."""
    figure, axes = plt.subplots(figsize=(9, 4), layout="constrained")
    t = SAMPLE * np.arange(1, samples() + 1)
    axes.plot(t, 1e3 * reference, color="0.7", linewidth=4, label="fine finite elements, without time steps")
    theirs = f"MuJoCo, {DRAWN.name}"
    for model, way, style in ((ours[0], "rollout", "C0-"), (theirs, "discrete", "C2--"), (theirs, "Euler", "C3:")):
        steps = [run for run in runs if (run.model, run.way) == (model, way) and run.step <= 1e-3]
        if steps:
            run = max(steps, key=lambda run: run.step)  # 1 ms, or the longest that is stable
            name = "fenics_rom" if model in ours else f"{model}, {way}"
            axes.plot(t, 1e3 * run.path, style, linewidth=1.4, label=f"{name}, steps of {1e3 * run.step:g} ms")
    axes.set(xlabel="time (s)", ylabel="tip (mm)", xlim=(0, DURATION))
    figure.legend(loc="outside lower center", ncols=2, frameon=False, fontsize=9)
    axes.grid(linewidth=0.4)
    figure.savefig(file, dpi=130)
    plt.close(figure)
