"""Frictional contact forces of many pairs at once: a complementarity problem with Coulomb's cones, solved to round-off.

Each pair has a force f = λ n + f_t and a velocity u = (W f + q) of its own. W, the Delassus operator, tells the
velocities that forces cause; it is symmetric and positive semidefinite, and q is the free velocity, less its target:

    0 <= λ ⟂ n·u >= 0,    |f_t| <= μ λ,    f_t = -μ λ u_t/|u_t| where u_t is not 0.

All of them are (3, C) in `Frames` of the pairs: first along the normals, then the tangents.
W is singular wherever more points touch than the body has freedoms; each system is solved for the change of the forces
with a small compliance added (the proximal point method), which leaves what is solved for unchanged and what W does not
determine near where it was.
"""

from numpy import ndarray as Array

from fenics_rom.mechanics.complementarity.delassus import Delassus, FramedDelassus, Frames
from fenics_rom.mechanics.complementarity.following import FollowedLaw, follow
from fenics_rom.mechanics.complementarity.frictional import FrictionalProblem, response
from fenics_rom.mechanics.complementarity.frictionless import FrictionlessProblem
from fenics_rom.mechanics.complementarity.solution import NEGLIGIBLE_RESIDUAL, KeptLaw, Solution

__all__ = [
    "NEGLIGIBLE_RESIDUAL",
    "Delassus",
    "FollowedLaw",
    "FramedDelassus",
    "Frames",
    "KeptLaw",
    "Solution",
    "follow",
    "response",
    "solve",
]


def solve(
    operator: FramedDelassus,
    q: Array,
    friction: float,
    start: Array,
    kept: KeptLaw | None = None,
    may_follow: bool = True,
    is_steady: bool = False,
    is_patient: bool = True,
) -> Solution:
    """The contact forces of C pairs.

    Args:
        operator: W of the pairs.
        q: (3, C) velocities without contact, less the targets, m/s.
        friction: μ >= 0.
        start: (3, C) forces to begin with, N: the better, the sooner it is solved.
        kept: of the step before, if the same pairs took part.
        may_follow: whether to try that first (`follow`), as has not been done yet.
        is_steady: whether the step before took no search: then the next may need none, too.
        is_patient: whether slower methods are to be tried, with friction, where Newton's comes to no solution.

    Raises:
        StepError: no method came to a solution.
    """
    if not q[0].any():  # there is nothing to stop, nor perhaps a speed to measure by
        return Solution(q, q, 0, 0.0, None)
    frames = operator.frames
    if may_follow and kept is not None and (frames.are_alike or not operator.added):
        (lasting,) = frames.to_lasting_axes(frames.in_space(q))
        axes, normals = operator.operator.lasting(frames, operator.added), frames.lasting_normals
        law = FollowedLaw(operator if normals is None else axes, lasting, friction, normals)
        followed = follow(law, kept)
        if followed is not None:
            forces, velocities = frames.turned(*map(frames.from_lasting_axes, followed[:2]))
            return followed._replace(forces=forces, velocities=velocities)
    if friction == 0:
        return FrictionlessProblem(operator, q).solve(start, kept)
    return FrictionalProblem(operator, q, friction).solve(start, kept, is_steady, is_patient)
