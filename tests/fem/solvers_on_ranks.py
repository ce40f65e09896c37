"""What tests/fem/test_solvers_on_ranks.py runs under mpirun: `python solvers_on_ranks.py MESH RESULTS`.

Writes RESULTS, what every rank saw of the solvers.
"""

import json
import sys
from contextlib import closing
from pathlib import Path

import numpy as np
import stand_ins
from bodies import assembled
from mpi4py import MPI

from fenics_rom.errors import FenicsRomError
from fenics_rom.fem import iterative as iterative_solver
from fenics_rom.fem import memory
from fenics_rom.fem.options import set_options

COMM = MPI.COMM_WORLD
mesh, results = (Path(argument) for argument in sys.argv[1:])
system = assembled(mesh)
algebra, M, D, K = system.algebra, system.mass, system.damping, system.stiffness
rows = algebra.rows()
B = np.random.default_rng(0).standard_normal((system.size, 150))[rows]


def norm(x):
    return float(np.sqrt(np.trace(algebra.inner(x.real, x.real) + algebra.inner(x.imag, x.imag))))


def error_of(work):
    """Text of the error that `work` raises here."""
    try:
        work()
    except FenicsRomError as error:
        return str(error)
    return "none"


def without_memory_on_rank_1(work):
    """What `work` gives where one rank alone finds no memory."""
    enough = memory.free_bytes
    if COMM.rank == COMM.size - 1:
        stand_ins.replace(memory, "free_bytes", lambda: 1e6)
    result = work()
    stand_ins.replace(memory, "free_bytes", enough)
    return result


checks = {"rows": [rows.start, rows.stop], "blocks": K.mat.getBlockSize()}
s = complex(-2.0, 150.0)
with (
    closing(algebra.factor((1.0, K))) as direct,
    closing(algebra.factor((1.0, K), solver="iterative")) as iterative,
    closing(algebra.factor((s**2, M), (s, D), (1.0, K))) as dynamic,
):
    x, y = direct.solve(B), iterative.solve(B[:, :3])
    checks["direct"] = norm(K @ x - B) / norm(B)
    checks["iterative"] = norm(y - x[:, :3]) / norm(x[:, :3])
    z = dynamic.solve(B + 1j * B[:, ::-1])
    checks["complex"] = norm(s**2 * (M @ z) + s * (D @ z) + K @ z - B - 1j * B[:, ::-1]) / norm(B)
    checks["eigenvalues"] = algebra.eigenpairs(M, K, 20, direct)[0].tolist()
checks["refused"] = without_memory_on_rank_1(lambda: error_of(lambda: algebra.factor((1.0, K), solver="direct")))
stand_ins.replace(iterative_solver, "BYTES_PER_ENTRY", 0)
stand_ins.replace(iterative_solver, "BYTES_PER_UNKNOWN", 0)
with closing(without_memory_on_rank_1(lambda: algebra.factor((1.0, K)))) as factor:
    checks["notice"] = factor.notice
    checks["replaced"] = norm(factor.solve(B[:, :1]) - x[:, :1]) / norm(x[:, :1])
set_options(["-fenics_rom_factor_ksp_max_it", "2"])
with closing(algebra.factor((1.0, K), solver="iterative")) as factor:
    checks["unconverged"] = error_of(lambda: factor.solve(B[:, :1]))
checks["singular"] = error_of(lambda: algebra.factor((0.0, K)))
everyone = COMM.gather(checks, root=0)
if COMM.rank == 0:
    results.write_text(json.dumps(everyone))
