"""What the offline stage costs of a cube, the body that hurts factors most, by factors and by iterations.

    python demos/scaling/cubes.py 28000 84000                      # unknowns, about; two ranks
    python demos/scaling/cubes.py 283000 1000000 2000000           # with the solver that "auto" takes
    python demos/scaling/cubes.py 84000 --solver direct iterative  # beside each other
    python demos/scaling/cubes.py --quick                          # small, to see that it works

The cube is clamped at one face and touched in two places. Each case runs by itself under mpirun, as the other half of
this script. It writes demos/scaling/out/cubes.md, with --quick to out/quick/: seconds of each stage, memory of all
ranks, what grows by unknown, and how far σ are from those of the first solver.
"""

import argparse
import json
import os
import subprocess
import sys
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).parent
MPIRUN = ("mpirun", "-x", "OMPI_MCA_mpi_yield_when_idle=1", "-n")
NODES = 0.66  # of a unit cube, times the cube of the size of its tetrahedra
ORDER = 20
SOLVERS = ("auto", "direct", "iterative")
QUICK = (3_000, ("direct", "iterative"))
ALIKE = 1e-7  # σ of iterations and of factors
SCENE = """
name = "cube"
[mesh]
file = "{file}"
[material]
young = 3.45e6      # Pa
poisson = 0.45
density = 1187.4    # kg/m3
[supports]
clamped = [{{ plane = {{ point = [0, 0, 0], normal = [0, 0, 1] }} }}]
[effects]
inertia = {{}}
damping = {{ alpha = 1.0, beta = 2e-3 }}   # 1/s, s
[contacts.top]
near = {{ point = [0.5, 0.5, 1.0], radius = 0.15 }}   # m
[contacts.side]
near = {{ point = [1.0, 0.5, 0.5], radius = 0.15 }}
"""


def main() -> None:
    """Runs the demo."""
    parser = argparse.ArgumentParser(description="Measures what the offline stage costs of a cube.")
    parser.add_argument("unknowns", type=int, nargs="*", default=[28_000, 84_000], help="about (default: 28000 84000)")
    parser.add_argument("--solver", nargs="+", choices=SOLVERS, default=["auto"], help="one or more (default: auto)")
    parser.add_argument("--ranks", type=int, default=2, help="of MPI (default: 2)")
    parser.add_argument("--quick", action="store_true", help="a small cube, by both solvers")
    options = parser.parse_args()
    out = HERE / "out" / "quick" if options.quick else HERE / "out"
    out.mkdir(parents=True, exist_ok=True)
    sizes, solvers = ([QUICK[0]], QUICK[1]) if options.quick else (options.unknowns, options.solver)
    cases = [{"solver": s} | case(mesh_of(size, out), s, options.ranks, out) for size in sizes for s in solvers]
    table = table_of(cases, options.ranks)
    (out / "cubes.md").write_text(table)
    print(table)
    worst = max((c["off"] for c in cases), default=0.0)
    print(f"  {'holds' if worst <= ALIKE else 'FAILS'}: σ of all solvers are alike to {worst:.1e}, at most {ALIKE:g}")
    if worst > ALIKE:
        sys.exit(1)


def mesh_of(unknowns: int, out: Path) -> Path:
    """A mesh of the unit cube with about so many unknowns."""
    import gmsh

    file = out / f"cube_{unknowns}.msh"
    if file.exists():
        return file
    gmsh.initialize([], readConfigFiles=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.model.occ.addBox(0, 0, 0, 1, 1, 1)
        gmsh.model.occ.synchronize()
        for name in ("Mesh.MeshSizeMin", "Mesh.MeshSizeMax"):
            gmsh.option.setNumber(name, float(np.cbrt(3 * NODES / unknowns)))
        gmsh.option.setNumber("Mesh.Algorithm3D", 10)  # HXT
        gmsh.option.setNumber("Mesh.Binary", 1)
        gmsh.model.addPhysicalGroup(3, [tag for _, tag in gmsh.model.getEntities(3)], 1)
        gmsh.model.mesh.generate(3)
        gmsh.write(str(file.with_suffix(".part.msh")))
        file.with_suffix(".part.msh").replace(file)
    finally:
        gmsh.finalize()
    return file


def case(mesh: Path, solver: str, ranks: int, out: Path) -> dict[str, Any]:
    """Runs a case under mpirun."""
    result = out / "cube.json"
    result.unlink(missing_ok=True)
    command = [*MPIRUN, str(ranks), sys.executable, __file__, "--measure", str(mesh), solver, str(result)]
    done = subprocess.run(command, capture_output=True, text=True, env={"OMP_NUM_THREADS": "1"} | os.environ)
    if done.returncode:
        sys.exit(f"{' '.join(command)}\n{done.stdout}{done.stderr}")
    measured: dict[str, Any] = json.loads(result.read_text())
    return measured


def measure(mesh: str, solver: str, result: str) -> None:
    """The case itself, on every rank."""
    from mpi4py import MPI

    import fenics_rom as fr
    from fenics_rom.errors import FenicsRomWarning
    from fenics_rom.io.stages import peak_memory
    from fenics_rom.scene.file import parse_scene

    warnings.simplefilter("ignore", FenicsRomWarning)
    start = time.perf_counter()
    text = SCENE.format(file=Path(mesh).name)
    system = fr.assemble(parse_scene(text, folder=Path(mesh).parent, source="cube"))
    rom = fr.reduce(system, order=ORDER, solver=solver)
    seconds, memory = time.perf_counter() - start, MPI.COMM_WORLD.allreduce(peak_memory())
    if MPI.COMM_WORLD.rank == 0:
        measured = {
            "unknowns": system.size,
            "seconds": seconds,
            "memory": memory,
            "stages": {stage.name: stage.seconds for stage in rom.stages},
            "said": list(rom.warnings),
            "transfer_error": max(v["transfer_error"] for v in rom.validation.values()),
            "singular_values": [m.hankel_singular_values[:ORDER].tolist() for m in rom.contact_models.values()],
        }
        Path(result).write_text(json.dumps(measured))


def table_of(cases: list[dict[str, Any]], ranks: int) -> str:
    """A row for each case; by unknown what is beside the first one's."""
    from fenics_rom.io.markdown import markdown

    stages = list(dict.fromkeys(name for c in cases for name in c["stages"]))
    first = cases[0]
    rows = []
    for c in cases:
        σ, of_first = (
            np.array(x["singular_values"]) for x in (c, next(o for o in cases if o["unknowns"] == c["unknowns"]))
        )
        c["off"] = float(np.abs(σ / of_first - 1).max())
        growth = [(c[key] / c["unknowns"]) / (first[key] / first["unknowns"]) for key in ("seconds", "memory")]
        shares = [f"{c['stages'].get(name, 0.0):.1f}" for name in stages]
        whole = [f"{c['seconds']:.1f}", f"{c['memory'] / 1e9:.2f}", *(f"{g:.2f}" for g in growth)]
        rows.append(
            (f"{c['unknowns']:,}", c["solver"], *shares, *whole, f"{c['transfer_error']:.1e}", f"{c['off']:.0e}")
        )
    heading = ["unknowns", "solver", *stages, "all, s", "GB, all ranks", "s by unknown", "GB by unknown"]
    said = "\n".join(f"{c['unknowns']:,}, {c['solver']}: {message}" for c in cases for message in c["said"])
    return f"{ranks} ranks\n\n{markdown([*heading, 'transfer error', 'σ off'], rows)}\n{said}\n"


if __name__ == "__main__":
    if sys.argv[1:2] == ["--measure"]:
        measure(*sys.argv[2:])
    else:
        main()
