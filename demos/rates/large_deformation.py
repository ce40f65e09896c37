"""What a step of large deformation costs: one body and a thousand, on one thread, each beside its error.

    python demos/rates/large_deformation.py             # three minutes
    python demos/rates/large_deformation.py --quick     # a coarse mesh and short loops, to see that it works

An arm of rubber is pulled by its tendon and pushed at its tip, by pushes that are others every 40 ms. Of two materials
it is reduced to several orders, and

1. one body takes linearly implicit steps, in NumPy and compiled, and Newton's, in turns in one process; the best of
   several rounds counts;
2. a `Batch` steps 1,024 of them, each under pushes and a tension of its own;
3. errors stand beside: of either step, against Newton's at a sixteenth of it; of the batch, against single bodies; of
   the energy account; and of the model, against full order in the run of the scene.

Everything is written to demos/rates/out/large_deformation/, with --quick to out/large_deformation/quick/. The checks at
the end are on errors and on ratios of rates; --quick leaves out the latter.
"""

import argparse
import os
import sys
import warnings
from collections.abc import Callable
from itertools import cycle, islice
from pathlib import Path

import gmsh
import numpy as np
from findings import Findings, rates

import fenics_rom as fr
from fenics_rom.compilation import numpy_alone
from fenics_rom.errors import FenicsRomWarning
from fenics_rom.mechanics.step import FINITE_STRAIN_STEPPERS
from fenics_rom.rom.rom import Rom
from fenics_rom.scene.file import parse_scene

OUT = Path(__file__).parent / "out" / "large_deformation"
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}

SIZE = 0.1, 0.02, 0.02  # m
BRICKS, COARSE = (10, 2, 2), (5, 1, 1)
LAWS = {"st_venant_kirchhoff": 0.3, "neo_hookean": 0.45}  # with Poisson's ratios
ORDERS, COARSE_ORDERS = (10, 20, 30), (8,)
BODIES, FOLLOWED = 1024, 8  # of a batch, and of these beside single bodies
STEP, FINER = 2e-3, 16  # s
TENSION, PUSH, HELD = 2.0, 0.05, 20  # N, N and steps
STEPS, ROUNDS = 200, 15

SCENE = """
name = "arm"
[mesh]
file = "{file}"
degree = 2
[material]
young = 4.0e5       # Pa
poisson = {poisson}
density = 1070.0    # kg/m3
[supports]
clamped = ["root"]
[contacts.tip]
near = {{ point = [0.1, 0.01, 0.01], radius = 0.011 }}   # m
[outputs.tip]
points = [[0.1, 0.0, 0.0]]
[effects]
inertia = {{}}
damping = {{ alpha = 1.0, beta = 2e-3 }}   # 1/s, s
large_deformation = {{ material = "{law}" }}
[effects.tendon.flexor]
points = [[0.0, 0.01, 0.005], [0.03, 0.01, 0.005], [0.06, 0.01, 0.005], [0.1, 0.01, 0.005]]
[run]
dt = {step}
duration = 0.4      # s
[[run.load]]
actuator = "flexor"
force = [3.0]       # N
"""

Array = np.ndarray


def main() -> None:
    """Runs the demo."""
    parser = argparse.ArgumentParser(description="Measures what a step of large deformation costs.")
    parser.add_argument("--quick", action="store_true", help="a coarse mesh and short loops; rates are not judged")
    quick = parser.parse_args().quick
    if not ONE_THREAD.items() <= os.environ.items():  # read when NumPy is loaded, so it takes another start
        os.execve(sys.executable, [sys.executable, *sys.argv], os.environ | ONE_THREAD)
    out = OUT / "quick" if quick else OUT  # so that a test does not overwrite what took minutes
    out.mkdir(parents=True, exist_ok=True)
    warnings.simplefilter("ignore", FenicsRomWarning)  # small models are off where they were not trained: see the table
    file = out / "arm.msh"
    mesh(file, COARSE if quick else BRICKS)
    findings = Findings(judge_rates=not quick)
    rows: list[tuple[object, ...]] = []
    errors: list[tuple[object, ...]] = []
    for law, poisson in LAWS.items():
        text = SCENE.format(file=file.name, law=law, poisson=poisson, step=STEP)
        system = fr.assemble(parse_scene(text, folder=out, source="arm"))
        full = fr.simulate(system)
        rate = (len(full.times) - 1) / full.settings["seconds"]
        rows.append((law, f"full order, {system.size:,}", "", f"{rate:,.0f}", *[""] * 4))
        for order in COARSE_ORDERS if quick else ORDERS:
            case = f"{law}, order {order}"
            rom = fr.reduce(system, order=order)
            assert rom.deformation is not None
            newton, single, compiled, batch = rates_of(rom, 1 if quick else ROUNDS).values()
            numbers = (f"{each:,.0f}" for each in (newton, single, compiled, batch))
            rows.append((law, order, len(rom.deformation.weights), *numbers, f"{batch / single:.1f}"))
            findings.at_least(
                f"{case}: linearly implicit steps, times the rate of Newton's", single / newton, 2, rate=True
            )
            findings.at_least(f"{case}: a batch, times the rate of one body", batch / single, 2, rate=True)
            of_newton, of_implicit, of_batch, of_account = errors_of(rom)
            of_model = distance(fr.simulate(rom).outputs["tip"], full.outputs["tip"])
            sizes = of_model, of_newton, of_implicit, of_batch, of_account
            errors.append((law, order, *(f"{size:.0e}" for size in sizes)))
            findings.at_most(f"{case}: error of linearly implicit steps, in Newton's", of_implicit / of_newton, 1.5)
            findings.at_most(f"{case}: a batch beside single bodies", of_batch, 1e-10)
            findings.at_most(f"{case}: gap of the energy account, as a share of the work", of_account, 1e-11)
    one = "one body, Newton", "linearly implicit, NumPy", "compiled"
    columns = "material", "order", "points", *one, f"{BODIES:,} bodies", "beside one in NumPy"
    findings.table("## Steps of a body per second", columns, rows)
    columns = "material", "order", "model", "steps, Newton", "steps, linearly implicit", "batch", "account"
    findings.table("## Errors, relative", columns, errors)
    held = findings.verdict()
    (out / "large_deformation.md").write_text("\n".join(findings.tables))
    if not held:
        sys.exit(1)


def distance(values: Array, reference: Array) -> float:
    """Largest distance at any instant, as a share of the largest that the reference gets to."""
    return float(np.abs(values - reference).max() / np.abs(reference).max())


def mesh(file: Path, bricks: tuple[int, int, int]) -> None:
    """Writes the mesh of the arm: so many bricks of tetrahedra, with the surface "root"."""
    gmsh.initialize([], readConfigFiles=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        geo, (lx, ly, lz), (nx, ny, nz) = gmsh.model.geo, SIZE, bricks
        corners = [geo.addPoint(0, y, z) for y, z in ((0, 0), (ly, 0), (ly, lz), (0, lz))]
        lines = [geo.addLine(corners[k], corners[(k + 1) % 4]) for k in range(4)]
        for line, count in zip(lines, (ny, nz, ny, nz), strict=True):
            geo.mesh.setTransfiniteCurve(line, count + 1)
        root = geo.addPlaneSurface([geo.addCurveLoop(lines)])
        geo.mesh.setTransfiniteSurface(root)
        _, (_, body), *_ = geo.extrude([(2, root)], lx, 0, 0, numElements=[nx])
        geo.synchronize()
        for dimension, tag, name in ((2, root, "root"), (3, body, "body")):
            gmsh.model.setPhysicalName(dimension, gmsh.model.addPhysicalGroup(dimension, [tag]), name)
        gmsh.model.mesh.generate(3)
        gmsh.write(str(file))
    finally:
        gmsh.finalize()


def inputs(steps: int, bodies: int) -> Array:
    """Of each step and body: a push on the tip, N, held for some steps, and a tension that comes and goes, N."""
    random, times = np.random.default_rng(0), np.arange(steps)[:, None] * STEP
    frequency, phase = random.uniform(0.5, 2, bodies), random.uniform(0, 6, bodies)
    tension = TENSION * np.sin(np.pi * frequency * times + phase) ** 2
    push = PUSH * random.standard_normal((-(-steps // HELD), bodies, 3)).repeat(HELD, axis=0)[:steps]
    return np.concatenate([push, tension[:, :, None]], axis=2)


def rates_of(rom: Rom, rounds: int) -> dict[str, float]:
    """Steps of a body per second: Newton's, linearly implicit ones in NumPy and compiled, and those of a batch."""
    given, many = inputs(STEPS, BODIES), fr.Batch(rom, BODIES, STEP, ledger=True)
    all_turns = cycle(given)

    def of_one(stepper: str, steps: int) -> Callable[[], int]:
        body, turns = fr.Simulator(rom, STEP, stepper=stepper), cycle(given[:, 0])

        def loop() -> int:
            for u in islice(turns, steps):
                body.step(u)
            return steps

        return loop

    def of_all() -> int:
        for u in islice(all_turns, 2):
            many.step(u)
        return 2 * BODIES

    newton, implicit = FINITE_STRAIN_STEPPERS
    with numpy_alone():
        in_numpy = of_one(implicit, 100)
    loops = {newton: of_one(newton, 20), implicit: in_numpy, "compiled": of_one(implicit, 100), "batch": of_all}
    return rates(loops, rounds)


def errors_of(rom: Rom) -> tuple[float, float, float, float]:
    """Errors of tips over a run, as a share of the largest: of Newton's steps, of linearly implicit ones, of a batch.

    The former two against Newton's at a sixteenth of the step, a batch against single bodies. And that of the energy
    account, as a share of the work.
    """
    given = inputs(STEPS, FOLLOWED)
    newton, implicit = FINITE_STRAIN_STEPPERS
    exact = tips(fr.Simulator(rom, STEP / FINER, stepper=newton), given[:, 0], FINER)
    of_newton, of_implicit = (tips(fr.Simulator(rom, STEP, stepper=each), given[:, 0]) for each in (newton, implicit))
    batch, gap = fr.Batch(rom, FOLLOWED, STEP, ledger=True), 0.0
    together = []
    for u in given:
        batch.step(u)
        together.append(batch.displacement("tip")[:, 0])
        gap = max(gap, float(np.abs(batch.energy - batch.supplied + batch.dissipated).max()))
    alone = [tips(fr.Simulator(rom, STEP, stepper=implicit), given[:, body]) for body in range(FOLLOWED)]
    largest = float(np.abs(exact).max())
    return (
        float(np.abs(of_newton - exact).max()) / largest,
        float(np.abs(of_implicit - exact).max()) / largest,
        float(np.abs(np.array(together) - np.stack(alone, axis=1)).max()) / largest,
        gap / float(batch.supplied.max()),
    )


def tips(body: fr.Simulator, given: Array, parts: int = 1) -> Array:
    """Displacements (steps, 3) of its tip, m, after each of some inputs, which are held for so many steps."""
    found = []
    for u in given:
        for _ in range(parts):
            body.step(u)
        found.append(body.displacement("tip")[0])
    return np.array(found)


if __name__ == "__main__":
    main()
