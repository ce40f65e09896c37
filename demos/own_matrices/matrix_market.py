"""Matrices from files, reduced on the command line.

    python demos/own_matrices/matrix_market.py

Any program that writes Matrix Market files can hand over its matrices. Here SciPy writes those of a rope with a dashpot
in its middle, and the command that is printed makes the ROM; it may as well run under mpirun.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import scipy.io
import scipy.sparse as sp
from checks import energy_gap, round_off, transfer_error

import fenics_rom as fr

n = 120
K = 1000 * sp.diags([-np.ones(n - 1), 2 * np.ones(n), -np.ones(n - 1)], [-1, 0, 1])  # N/m
M = 0.01 * sp.identity(n)  # kg
dashpot = sp.coo_matrix(([0.3], ([n // 2], [n // 2])), shape=(n, n))  # N s/m
hand = np.exp(-(((np.arange(n) - n // 4) / 6) ** 2) / 2)
matrices = {"M": M, "D": 0.5 * M + 1e-4 * K + dashpot, "K": K}
columns = {"pull": hand[:, None] / hand.sum(), "middle": np.eye(n)[:, [n // 2]]}

COMMAND = """
fenics-rom reduce --mass M.mtx --damping D.mtx --stiffness K.mtx
    --contact pull=pull.mtx --observe middle=middle.mtx --order 30 -o rope.h5
"""

with tempfile.TemporaryDirectory() as place:
    folder = Path(place)
    for name, matrix in (matrices | columns).items():
        scipy.io.mmwrite(folder / f"{name}.mtx", matrix)
    print(COMMAND)
    program, *arguments = COMMAND.split()
    subprocess.run([sys.executable, "-m", "fenics_rom", *arguments], cwd=folder, check=True)

    rom = fr.read_rom(folder / "rope.h5")
    files = {"mass": "M", "damping": "D", "stiffness": "K"}
    system = fr.read_system(
        **{name: folder / f"{file}.mtx" for name, file in files.items()}, contacts={"pull": folder / "pull.mtx"}
    )

body = fr.Simulator(rom, dt=1e-3)
for _ in range(1000):
    body.step([1.0])  # N

error = transfer_error(system, rom, "pull", [0.0, 2.0, 5.0, 10.0, 20.0])
print(f"middle of the rope at {body.time:.1f} s: {body.displacement('middle')[0]:+.4f} m")
print(f"energy account closes to {energy_gap(body):.1e}, transfer functions to {error:.1e}")
assert energy_gap(body) <= round_off(body)
assert error <= 1e-4
