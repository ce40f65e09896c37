"""What tests/fem/test_ranks.py runs under mpirun: `python on_ranks.py SCENES RESULTS [NAME ...]`.

Writes ROMs and runs, all or those named, and checks.json with what every rank saw.
"""

import contextlib
import json
import sys
from pathlib import Path

import numpy as np
import stand_ins
from gmsh_here import arrays_found_here
from mpi4py import MPI
from petsc4py import PETSc

import fenics_rom as fr
from fenics_rom.cli.main import main
from fenics_rom.errors import FenicsRomError
from fenics_rom.fem.body_matrices import displacement_space, dolfinx_nodes
from fenics_rom.fem.mesh import read_mesh
from fenics_rom.fem.nodes import canonical_nodes
from fenics_rom.fem.petsc_algebra import PetscFactor
from fenics_rom.scene import foreign_file

COMM = MPI.COMM_WORLD
COMMANDS = {
    "plate.h5": ("reduce", "plate.toml"),
    "plate-krylov.h5": ("reduce", "plate.toml", "--lyapunov", "krylov", "--order", "20"),
    "plate-adi.h5": ("reduce", "plate.toml", "--lyapunov", "adi", "--order", "12"),
    "many.h5": ("reduce", "many.toml"),
    "beam-static.h5": ("reduce", "beam.toml", "--method", "modal+static"),
    "box.h5": ("reduce", "box.toml", "--lyapunov", "closed-form"),
    "beam.h5": ("reduce", "beam.toml"),
    "beam-modal.h5": ("reduce", "beam.toml", "--method", "eigenvector-selection", "--share", "0.9999"),
    "free.h5": ("reduce", "free.toml"),
    "free-krylov.h5": ("reduce", "free.toml", "--lyapunov", "krylov"),
    "free-iterative.h5": ("reduce", "free.toml", "--lyapunov", "krylov", "--solver", "iterative"),
    "floating.h5": ("reduce", "floating.toml"),
    "run.h5": ("simulate", "plate.toml"),
    "free-run.h5": ("simulate", "free.toml"),
    "landing-run.h5": ("simulate", "landing.toml"),
    "floating-run.h5": ("simulate", "floating.toml"),
    "effects.h5": ("reduce", "effects.toml", "--lyapunov", "closed-form", "--order", "60"),
    "effects-run.h5": ("simulate", "effects.toml"),
    "rolling.h5": ("reduce", "rolling.toml", "--lyapunov", "closed-form", "--order", "60"),
    "rolling-run.h5": ("simulate", "rolling.toml"),
    "still.h5": ("reduce", "still.toml"),
    "still-run.h5": ("simulate", "still.toml"),
}


def error_of(work):
    """Kind and text of the error that `work` raises here."""
    try:
        work()
    except FenicsRomError as error:
        return [type(error).__name__, str(error)]
    return ["none", ""]


def error_of_diagonal(middle):
    """What comes of factoring a diagonal matrix of ones but for one number."""
    matrix = PETSc.Mat().createAIJ((6, 6), comm=COMM)
    matrix.setUp()
    for row in range(*matrix.getOwnershipRange()):
        matrix.setValue(row, row, middle if row == 3 else 1.0)
    matrix.assemble()
    return error_of(lambda: PetscFactor(matrix).close())


def misplaced(mesh_file, degree):
    """Largest distance between a canonical node and the place that dolfinx has for it, m."""
    mesh = read_mesh(mesh_file, {})
    nodes = canonical_nodes(mesh, degree)
    space = displacement_space(COMM, nodes)
    owned = space.tabulate_dof_coordinates()[: space.dofmap.index_map.size_local]
    there = np.concatenate(COMM.allgather(owned))
    return float(np.abs(there[dolfinx_nodes(space, nodes)] - nodes.coordinates).max())


def symmetric(matrix):
    transposed = matrix.transpose(PETSc.Mat())
    return bool(transposed.equal(matrix))


stand_ins.replace(foreign_file, "read_arrays", arrays_found_here)
folder, results = (Path(argument) for argument in sys.argv[1:3])
names = [f"{name}.h5" for name in sys.argv[3:]] or COMMANDS
for name in names:
    command, scene, *options = COMMANDS[name]
    with contextlib.suppress(SystemExit):
        main([command, str(folder / scene), "-o", str(results / name), *options])

system = fr.assemble(fr.read_scene(folder / "beam.toml"))
γ, V = system.algebra.eigenpairs(system.mass, system.stiffness, 20)
lack = np.abs(system.algebra.inner(V, system.mass @ V) - np.eye(20)).max()
residual = system.stiffness @ V - γ * (system.mass @ V)
size = np.sqrt(np.diag(system.algebra.inner(residual, residual)))
checks = {
    "nodes": [misplaced(folder / f"{name}.msh", degree) for name in ("beam", "bricks", "row") for degree in (1, 2)],
    "eigenvalues": γ.tolist(),
    "orthonormality": float(lack),
    "residual": float((size / γ).max()),
    "symmetric": symmetric(system.mass.mat) and symmetric(system.stiffness.mat),
    "indefinite": error_of_diagonal(-1.0),
    "singular": error_of_diagonal(0.0),
    "shifted": error_of(lambda: system.algebra.factor((1.0, system.stiffness), (-1.01 * γ[0], system.mass))),
    "missing": error_of(lambda: fr.assemble(fr.read_scene(folder / "missing.toml"))),
}
everyone = COMM.gather(checks, root=0)
if COMM.rank == 0:
    (results / "checks.json").write_text(json.dumps(everyone))
