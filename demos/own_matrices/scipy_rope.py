"""A rope of 120 masses between springs, from SciPy matrices.

    python demos/own_matrices/scipy_rope.py

The rope is fixed at both ends. A dashpot to the ground holds its middle back, so that its damping is not proportional
to M and K. It is pulled with a hand at a quarter of its length, then shaken near its right end.
"""

import numpy as np
import scipy.sparse as sp
from checks import energy_gap, round_off, transfer_error

import fenics_rom as fr

n = 120
M = 0.01 * sp.identity(n, format="csr")  # kg
K = 1000 * sp.diags([-np.ones(n - 1), 2 * np.ones(n), -np.ones(n - 1)], [-1, 0, 1], format="csr")  # N/m
middle = sp.csr_matrix(([1.0], ([n // 2], [n // 2])), shape=(n, n))
D = 0.5 * M + 1e-4 * K + 0.3 * middle  # N s/m


def hand(at: int) -> np.ndarray:
    """A force of 1 N, over some masses to both sides."""
    grip = np.exp(-(((np.arange(n) - at) / 6) ** 2) / 2)
    return grip / grip.sum()


system = fr.System(
    mass=M,
    damping=D,
    stiffness=K,
    contacts={"pull": hand(n // 4), "shake": hand(n - 20)},
    outputs={"middle": np.eye(n)[n // 2]},
)
rom = fr.reduce(system, order=30)

body = fr.Simulator(rom, dt=1e-3)
for step in range(3000):
    body.switch("pull" if step < 1000 else "shake")
    body.step([1.0 if step < 1000 else np.sin(8.0 * body.time)])  # N

error = max(transfer_error(system, rom, name, [0.0, 2.0, 5.0, 10.0, 20.0]) for name in system.contacts)
print(f"{system.size} masses, {rom.contact_models['pull'].order} balanced displacements")
print(f"middle of the rope at {body.time:.1f} s: {body.displacement('middle')[0]:+.4f} m")
print(f"energy account closes to {energy_gap(body):.1e}, transfer functions to {error:.1e}")
assert system.rayleigh is None, "a dashpot in one place is not proportional damping"
assert energy_gap(body) <= round_off(body)
assert error <= 1e-4
