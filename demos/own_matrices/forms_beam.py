"""A beam of rubber and silicone on a damped foot, from variational forms in dolfinx.

    python demos/own_matrices/forms_beam.py
    mpirun -n 2 python demos/own_matrices/forms_beam.py

Each half of the beam has a density, a stiffness and damping coefficients of its own, and its free end stands in a
viscous bed: dashpots over a face. That is more than a scene file can say, and no more than a few lines of UFL.
"""

import numpy as np
import ufl
from checks import energy_gap, round_off, transfer_error
from dolfinx import fem, mesh
from mpi4py import MPI
from ufl import conditional, grad, inner, lt, sym, tr

import fenics_rom as fr

LENGTH, WIDTH = 0.4, 0.05  # m
ROOT, TIP = 1, 2

domain = mesh.create_box(MPI.COMM_WORLD, [np.zeros(3), np.array([LENGTH, WIDTH, WIDTH])], [4, 1, 1])
if hasattr(fem, "functionspace"):
    space = fem.functionspace(domain, ("Lagrange", 2, (3,)))
else:  # dolfinx 0.5 and 0.6
    space = fem.VectorFunctionSpace(domain, ("Lagrange", 2))

root = mesh.locate_entities_boundary(domain, 2, lambda x: np.isclose(x[0], 0))
tip = mesh.locate_entities_boundary(domain, 2, lambda x: np.isclose(x[0], LENGTH))
tags = mesh.meshtags(domain, 2, np.sort(tip), np.full(len(tip), TIP, dtype=np.int32))
at_tip = ufl.Measure("ds", domain=domain, subdomain_data=tags)(TIP)
dx = ufl.Measure("dx", domain=domain, metadata={"quadrature_degree": 4})


def by_half(rubber: float, silicone: float):  # type: ignore[no-untyped-def]
    """A number of each material."""
    return conditional(lt(ufl.SpatialCoordinate(domain)[0], LENGTH / 2), rubber, silicone)


u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
young, poisson = by_half(2e6, 3e5), 0.4  # Pa
shear = young / (2 * (1 + poisson))
strain = sym(grad(u))
stress = 2 * shear * (strain + poisson / (1 - 2 * poisson) * tr(strain) * ufl.Identity(3))
inertia = by_half(1100.0, 1000.0) * inner(u, v)
elasticity = inner(stress, sym(grad(v)))

push = [v[k] / WIDTH**2 * at_tip for k in range(3)]  # a force of 1 N spread over the tip; also the tip's displacement
system = fr.assemble_forms(
    mass=inertia * dx,
    damping=by_half(2.0, 1.0) * inertia * dx + by_half(1e-4, 2e-3) * elasticity * dx + 50.0 * inner(u, v) * at_tip,
    stiffness=elasticity * dx,
    contacts={"tip": push},
    outputs={"tip": push},
    bcs=[fem.dirichletbc(np.zeros(3), fem.locate_dofs_topological(space, 2, root), space)],
)
rom = fr.reduce(system, order=40)

body = fr.Simulator(rom, dt=1e-3)
for step in range(1000):
    body.step([0.0, 0.0, 0.05 if step < 500 else 0.0])  # N

error = transfer_error(system, rom, "tip", [0.0, 10.0, 20.0, 50.0])
if domain.comm.rank == 0:
    print(f"{system.size} displacements at {len(rom.nodes)} nodes on {domain.comm.size} ranks")
    print(f"lowest frequency {rom.contact_models['tip'].eigenvalues[0] ** 0.5 / (2 * np.pi):.2f} Hz")
    print(f"energy account closes to {energy_gap(body):.1e}, transfer functions to {error:.1e}")
assert body.displacement().shape == (9 * 3 * 3, 3), "every node of the mesh can be drawn"
assert energy_gap(body) <= round_off(body)
assert error <= 1e-4
