"""What a body costs whose whole skin may touch, and of which few points do; and how near to full order it is.

    python demos/contact_rates/whole_skin.py            # some minutes
    python demos/contact_rates/whole_skin.py --quick    # a coarse mesh, to see that it works

An ellipsoid falls on a floor with friction, in steps of 2 ms. The first table has its points that may touch and those
that push in the end, how long the reduction takes, the steps per second while it falls and lands and while it rocks to
rest, how many times as fast as the clock that is, and by how much the floor's force alternates from step to step then,
as a share of the weight. It is judged that this is less than 1e-3.

On which node it lands decides how it rocks, so one fall says little of a model. The second table has medians over falls
from several attitudes: what the shape and the force are off over the run against full order at the same step. It is
judged that the default order is nearer to full order than that is to itself at half the step.
"""

import sys
import tempfile
import time
import warnings
from pathlib import Path

import gmsh
import numpy as np
from numpy import ndarray as Array

import fenics_rom as fr
from fenics_rom.io.markdown import markdown
from fenics_rom.scene.file import parse_scene

ORDERS, FALLS = (20, 60, 100, 250), 7
STEP, HALF_AXES, GRAVITY = 2e-3, (0.08, 0.05, 0.03), 9.81  # s, m, m/s²
SCENE = """
name = "ellipsoid"
mesh = {{ file = "{file}" }}
material = {{ young = 1e5, poisson = 0.3, density = 1000.0 }}
contacts.skin = {{ near = {{ point = [0, 0, 0], radius = 1.0 }} }}
[effects]
inertia = {{}}
damping = {{ beta = 5e-3 }}
gravity = {{ acceleration = [0, 0, -9.81] }}
friction = {{ coefficient = 0.5 }}
contact = {{ obstacles = {{ floor = {{ shape = "half-space", point = [0, 0, -0.031], normal = [0, 0, 1] }} }} }}
[run]
dt = 2e-3
duration = 1.0
"""


def mesh(file: Path, size: float) -> None:
    """Writes the mesh of the ellipsoid, of elements of about this size, m."""
    gmsh.initialize([], readConfigFiles=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        ball = gmsh.model.occ.addSphere(0, 0, 0, 1.0)
        gmsh.model.occ.dilate([(3, ball)], 0, 0, 0, *HALF_AXES)
        gmsh.model.occ.synchronize()
        for bound in ("Min", "Max"):
            gmsh.option.setNumber(f"Mesh.MeshSize{bound}", size)
        gmsh.model.setPhysicalName(3, gmsh.model.addPhysicalGroup(3, [ball]), "body")
        gmsh.model.mesh.generate(3)
        gmsh.write(str(file))
    finally:
        gmsh.finalize()


def row_of(file: Path, size: float, steps: int) -> tuple[list[object], float]:
    """What the table says of elements of a size, m, and by how much forces alternate, of the weight."""
    mesh(file, size)
    system = fr.assemble(parse_scene(SCENE.format(file=file)))
    started = time.process_time()
    body = fr.Simulator(fr.reduce(system), STEP)
    reduced, rates, forces = time.process_time() - started, [], list[np.ndarray]()
    for _ in range(2):
        forces, started = [], time.process_time()
        for _ in range(steps):
            body.step()
            forces.append(body.contact_forces("floor"))
        rates.append(steps / (time.process_time() - started))
    pushing = np.count_nonzero(body.contact_forces().any(axis=1))
    weight = 1000.0 * 4 / 3 * np.pi * np.prod(HALF_AXES) * GRAVITY
    alternates = float(np.abs(np.diff(forces[-50:], n=2, axis=0)).max() / 4 / weight)  # of ±a that is 4 a
    numbers = len(body.contact_points), pushing, body.model.order, f"{reduced:.1f} s"
    return [*numbers, *(f"{rate:,.0f}" for rate in rates), f"{rates[1] * STEP:.1f}", f"{alternates:.0e}"], alternates


def errors_of_falls(file: Path, size: float, orders: tuple[int, ...], falls: int) -> dict[tuple[str, object], Array]:
    """Errors of shape and force over falls from several attitudes, (falls, 2) for each method and order."""
    mesh(file, size)
    text, random = SCENE.format(file=file).replace("duration = 1.0", "duration = 0.6"), np.random.default_rng(0)
    system = fr.assemble(parse_scene(text))
    roms = {
        (method, order): fr.reduce(system, method=method, order=order)
        for method in ("balanced", "modal+static")
        for order in orders
    }
    errors: dict[tuple[str, object], list[tuple[float, float]]] = {}
    for _ in range(falls):
        turned, spin = random.uniform(-0.02, 0.02, 3).tolist(), random.uniform(-0.5, 0.5, 3).tolist()
        start = f"[run.initial]\nrotation = {turned}\nspin = {spin}\ntranslation = [0, 0, 5e-4]\n"
        scene = parse_scene(text + start)
        system = fr.assemble(scene)
        full, half = fr.simulate(system), fr.simulate(system, dt=STEP / 2, every=2)
        runs = {case: fr.simulate(rom, scene=scene) for case, rom in roms.items()}
        mass = np.sqrt(full.node_mass)[:, None]
        for case, run in {("full order at half the step", ""): half, **runs}.items():
            off, force = (run.snapshots - full.snapshots) * mass, run.forces["floor"] - full.forces["floor"]
            shares = np.linalg.norm(off) / np.linalg.norm(full.snapshots * mass)
            errors.setdefault(case, []).append((shares, np.linalg.norm(force) / np.linalg.norm(full.forces["floor"])))
    return {case: np.array(found) for case, found in errors.items()}


def main() -> int:
    """Runs the demo."""
    is_quick = "--quick" in sys.argv[1:]
    with tempfile.TemporaryDirectory(prefix="fenics-rom-") as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore", fr.errors.FenicsRomWarning)
        file, sizes = Path(folder) / "skin.msh", [0.03] if is_quick else [0.02, 0.0125, 0.007, 0.0065]
        found = [row_of(file, size, 300) for size in sizes]
        errors = errors_of_falls(file, *(0.03, (20, 60), 2) if is_quick else (0.0125, ORDERS, FALLS))
    order = 60 if is_quick else 100
    heading = "may touch", "push", "order", "reduction", "steps/s, landing", "at rest", "times the clock", "alternates"
    print(markdown(heading, [row for row, _ in found]))
    holds = all(alternates < 1e-3 for _, alternates in found)
    print(f"  {'holds' if holds else 'FAILS'}: forces at rest alternate by less than 1e-3 of the weight")
    medians = {case: np.median(of_falls, axis=0) for case, of_falls in errors.items()}
    print(
        markdown(
            ("model", "order", "shape", "force"), [[*case, *map("{:.1e}".format, m)] for case, m in medians.items()]
        )
    )
    of_step, of_default = (medians[case] for case in (("full order at half the step", ""), ("modal+static", order)))
    is_near = is_quick or bool((of_default < of_step).all())
    print(f"  {'holds' if is_near else 'FAILS'}: order {order} is nearer to full order than half its step is")
    return 0 if holds and is_near else 1


if __name__ == "__main__":
    sys.exit(main())
