"""What a body costs whose whole skin may touch, and of which few points do.

    python demos/contact_rates/whole_skin.py            # some minutes
    python demos/contact_rates/whole_skin.py --quick    # a coarse mesh, to see that it works

An ellipsoid falls on a floor with friction, in steps of 2 ms. The table has its points that may touch and those that
push in the end, how long the reduction takes, the steps per second while it falls and lands and while it rocks to
rest, how many times as fast as the clock that is, and by how much the floor's force alternates from step to step then,
as a share of the weight. It is judged that this is less than 1e-3.
"""

import sys
import tempfile
import time
import warnings
from pathlib import Path

import gmsh
import numpy as np

import fenics_rom as fr
from fenics_rom.io.markdown import markdown
from fenics_rom.scene.file import parse_scene

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
    started = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", fr.errors.FenicsRomWarning)  # that the order is bounded
        body = fr.Simulator(fr.reduce(system), STEP)
    reduced, rates, forces = time.perf_counter() - started, [], list[np.ndarray]()
    for _ in range(2):
        forces, started = [], time.perf_counter()
        for _ in range(steps):
            body.step()
            forces.append(body.contact_forces("floor"))
        rates.append(steps / (time.perf_counter() - started))
    pushing = np.count_nonzero(body.contact_forces().any(axis=1))
    weight = 1000.0 * 4 / 3 * np.pi * np.prod(HALF_AXES) * GRAVITY
    alternates = float(np.abs(np.diff(forces[-50:], n=2, axis=0)).max() / 4 / weight)  # of ±a that is 4 a
    numbers = len(body.contact_points), pushing, body.model.order, f"{reduced:.1f} s"
    return [*numbers, *(f"{rate:,.0f}" for rate in rates), f"{rates[1] * STEP:.1f}", f"{alternates:.0e}"], alternates


def main() -> int:
    """Runs the demo."""
    is_quick = "--quick" in sys.argv[1:]
    with tempfile.TemporaryDirectory(prefix="fenics-rom-") as folder:
        found = [row_of(Path(folder) / "skin.msh", size, 300) for size in ([0.03] if is_quick else [0.02, 0.0125])]
    heading = "may touch", "push", "order", "reduction", "steps/s, landing", "at rest", "times the clock", "alternates"
    print(markdown(heading, [row for row, _ in found]))
    holds = all(alternates < 1e-3 for _, alternates in found)
    print(f"  {'holds' if holds else 'FAILS'}: forces at rest alternate by less than 1e-3 of the weight")
    return 0 if holds else 1


if __name__ == "__main__":
    sys.exit(main())
