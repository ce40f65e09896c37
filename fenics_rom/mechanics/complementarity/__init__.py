"""Frictional contact forces of many pairs at once: a complementarity problem with Coulomb's cones, solved to round-off.

Each pair has a force f = λ n + f_t and a velocity u = (W f + q) of its own. W, the Delassus operator, tells the
velocities that forces cause; it is symmetric and positive semidefinite, and q is the free velocity, less its target:

    0 <= λ ⟂ n·u >= 0,    |f_t| <= μ λ,    f_t = -μ λ u_t/|u_t| where u_t is not 0.

W is singular wherever more points touch than the body has freedoms; each system is solved for the change of the forces
with a small compliance added (the proximal point method), which leaves what is solved for unchanged and what W does not
determine near where it was.
"""

from numpy import ndarray as Array

from fenics_rom.mechanics.complementarity.delassus import Delassus
from fenics_rom.mechanics.complementarity.frictional import FrictionalProblem
from fenics_rom.mechanics.complementarity.frictionless import FrictionlessProblem
from fenics_rom.mechanics.complementarity.solution import NEGLIGIBLE_RESIDUAL, Solution

__all__ = ["NEGLIGIBLE_RESIDUAL", "Delassus", "Solution", "solve"]


def solve(operator: Delassus, q: Array, normals: Array, friction: float, start: Array) -> Solution:
    """The contact forces of C pairs.

    Args:
        operator: W of the pairs.
        q: (C, 3) velocities without contact, less the targets, m/s.
        normals: (C, 3) unit vectors from the obstacle to the body.
        friction: μ >= 0.
        start: (C, 3) forces to begin with, N: the better, the sooner it is solved.

    Raises:
        StepError: no method came to a solution.
    """
    if friction == 0:
        return FrictionlessProblem(operator, q, normals).solve(start)
    return FrictionalProblem(operator, q, normals, friction).solve(start)
