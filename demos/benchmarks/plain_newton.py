"""Newton's method as one writes it in dolfinx: whole steps, a tangent from the form, and MUMPS."""

import time

import numpy as np
import ufl
from boxes import brick_cells
from dolfinx import fem
from dolfinx.fem.petsc import assemble_matrix, assemble_vector
from dolfinx.mesh import locate_entities_boundary
from mpi4py import MPI
from petsc4py import PETSc
from solids import tip_under

import fenics_rom as fr
from fenics_rom.fem.dolfinx_compat import create_cells, vector_space

Array = np.ndarray
TOLERANCE = 1e-6  # of the residual, as a share of the load: round-off leaves a tenth of it


def time_beside_plain_newton(
    system: fr.System, bricks: tuple[int, int, int], size: Array, young: float, poisson: float, force: float
) -> tuple[float, float, int]:
    """Processor time (s) of an equilibrium here and there, the best of two each, and how many iterations were there."""
    points, cells = brick_cells(bricks)
    domain = create_cells(MPI.COMM_WORLD, cells, points * size)
    space = vector_space(domain, 2)
    held = locate_entities_boundary(domain, 2, lambda x: np.isclose(x[0], 0))
    held = fem.dirichletbc(np.zeros(3), fem.locate_dofs_topological(space, 2, held), space)
    u, δ, du = fem.Function(space), ufl.TestFunction(space), ufl.TrialFunction(space)
    λ, μ = young * poisson / ((1 + poisson) * (1 - 2 * poisson)), young / (2 * (1 + poisson))
    F = ufl.Identity(3) + ufl.grad(u)
    E = (F.T * F - ufl.Identity(3)) / 2
    load = force / (size[1] * size[2]) * np.array([0.0, -1.0, 1.0]) / np.sqrt(2)
    x = ufl.SpatialCoordinate(domain)
    on_tip = ufl.conditional(ufl.gt(x[0], size[0] * (1 - 1e-9)), 1.0, 0.0)
    dx = ufl.dx(metadata={"quadrature_degree": 2})
    elastic = ufl.derivative((λ / 2 * ufl.tr(E) ** 2 + μ * ufl.inner(E, E)) * dx, u, δ)
    push = fem.form(on_tip * ufl.inner(ufl.as_vector(load), δ) * ufl.ds)
    residual, tangent = fem.form(elastic), fem.form(ufl.derivative(elastic, u, du))
    rows = held.dof_indices()[0]

    def plain() -> tuple[float, int]:
        u.x.array[:] = 0.0
        begun = time.process_time()
        pushed = assemble_vector(push)
        size_of_load = pushed.norm()
        for iteration in range(1, 51):
            J = assemble_matrix(tangent, bcs=[held])
            J.assemble()
            r = assemble_vector(residual)
            r.aypx(-1.0, pushed)
            r.array[rows] = 0.0
            if r.norm() < TOLERANCE * size_of_load:
                return time.process_time() - begun, iteration - 1
            ksp = PETSc.KSP().create(domain.comm)
            ksp.setOperators(J)
            ksp.setType("preonly")
            ksp.getPC().setType("lu")
            ksp.getPC().setFactorSolverType("mumps")
            step = r.duplicate()
            ksp.solve(r, step)
            u.x.array[: len(step.array)] += step.array
            for part in (ksp.reset(), ksp, J, r, step):
                if part is not None:
                    part.destroy()
        raise AssertionError("plain Newton does not converge")

    def here() -> float:
        begun = time.process_time()
        tip_under(system, 0.0, -force / np.sqrt(2), force / np.sqrt(2))
        return time.process_time() - begun

    runs = [(here(), *plain()) for _ in range(2)]
    return min(run[0] for run in runs), min(run[1] for run in runs), runs[0][2]
