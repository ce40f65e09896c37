"""One case of scaling.py in processes of its own, so that its memory is its own; started by it, under mpirun.

    mpirun -n RANKS python demos/scaling/measure.py MESH CONTACTS ORDER RUNS RESULT

Assembles the cylinder once, reduces it RUNS times and writes what that took, and how good it is, as JSON.
"""

import json
import sys
import time
import warnings
from pathlib import Path

from cylinder import places, scene
from mpi4py import MPI

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning

warnings.simplefilter("ignore", FenicsRomWarning)  # these tetrahedra lock, which is no matter here
mesh, contacts, order, runs, result = sys.argv[1:]

start = time.perf_counter()
system = fr.assemble(scene(Path(mesh), places(int(contacts))))
MPI.COMM_WORLD.Barrier()
assembly = time.perf_counter() - start

stages = []
for _ in range(int(runs)):
    rom = fr.reduce(system, order=int(order))
    stages.append({stage.name: stage.seconds for stage in rom.stages if stage not in system.stages})

if MPI.COMM_WORLD.rank == 0:
    validations = rom.validation.values()
    measured = {
        "unknowns": system.size,
        "assembly": assembly,
        "stages": stages,
        "memory": max(stage.peak_memory for stage in rom.stages),  # of the largest rank, bytes
        "transfer_error": max(validation["transfer_error"] for validation in validations),
        "static_error": max(validation["static_error"] for validation in validations),
        "singular_values": [mode.hankel_singular_values[: int(order)].tolist() for mode in rom.contact_models.values()],
    }
    Path(result).write_text(json.dumps(measured))
