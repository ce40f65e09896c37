"""Where a reduced body can be touched, and what finds the forces there."""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.active_environment import ActiveEnvironment
from fenics_rom.mechanics.contact import ContactSolution, ContactWork, ObstacleMotion, PointMotion, equilibrium_work
from fenics_rom.mechanics.contact_pairs import Settled
from fenics_rom.mechanics.contact_points import ContactPoints
from fenics_rom.mechanics.contact_solver import ContactSolver
from fenics_rom.mechanics.make_contact_solver import make_contact_solver
from fenics_rom.mechanics.obstacles import smallest_radius
from fenics_rom.mechanics.points_operator import Operator
from fenics_rom.mechanics.skin import Skin
from fenics_rom.mechanics.skin_watch import SkinWatch, displaced
from fenics_rom.rom.rom import Rom

MOTION = "inertia, damping, elasticity"  # what of a step is not loads and contact
CONTACT = "contact, friction"


class ContactInterface(NamedTuple):
    """All contact points of a body, whatever contact mode is active, and the obstacles."""

    points: ContactPoints
    solver: ContactSolver  # of the contact law
    rows: Array  # (3P, k) of the points in the shared basis
    environment: ActiveEnvironment  # of the run, which may measure what the parts of a step cost
    passing: str  # what to say of obstacles that pass between the points
    skin: SkinWatch | None  # what tells of those that come through elsewhere; None where there is nothing to look at

    def solve(
        self,
        points: PointMotion,
        delassus: Operator,
        dt: float,
        obstacles: ObstacleMotion,
        quasi_static: bool = False,
        settled: Settled | None = None,
    ) -> ContactSolution | None:
        """Forces on the points of a body that would do this without them; see ContactSolver.solve."""
        mark = self.environment.mark
        if mark is not None:
            mark(MOTION)
        contact = self.solver.solve(points, delassus, dt, obstacles, quasi_static, settled)
        if mark is not None:
            mark(CONTACT)
        return contact

    def solve_moved(
        self, motion: Array, delassus: Operator, dt: float, obstacles: ObstacleMotion, quasi_static: bool
    ) -> ContactSolution | None:
        """The same from motion (3, P, 3): displacement, velocity and free velocity, as in PointMotion."""
        return self.solve(PointMotion(*motion), delassus, dt, obstacles, quasi_static)

    def work_at_rest(
        self,
        before: ContactSolution | None,
        after: ContactSolution | None,
        velocity: Array,
        dt: float,
        obstacles: ObstacleMotion,
    ) -> ContactWork:
        """Where the work of a step between equilibria went; see equilibrium_work."""
        return equilibrium_work(before, after, velocity, dt, obstacles, self.solver.law, self.solver.speeds)

    def check_start(self) -> None:
        """A StepError where at time 0 the body at rest is not outside of all obstacles."""
        places = None if self.skin is None else self.skin.skin.coordinates
        self.check_outside(np.zeros(self.points.coordinates.shape), places, self.environment.offsets_at(0.0))

    def check_outside(self, displacement: Array, places: Array | None, offsets: Array) -> None:
        """A StepError where the body is not outside of all obstacles.

        Args:
            displacement: of the contact points, (P, 3), m.
            places: of the nodes of the skin, (V, 3), m; None where it is not looked at.
            offsets: of the obstacles, (O, 3), m.
        """
        self.solver.check_start(displacement, offsets, list(self.environment.obstacles))
        if self.skin is not None and places is not None:
            self.skin.check_start(places, displaced(self.environment.obstacles, offsets))


def contact_interface(
    rom: Rom, environment: ActiveEnvironment, solver_of: type[ContactSolver] | None = None
) -> ContactInterface | None:
    """The interface of a reduced body in an environment; None where nothing can touch it.

    `solver_of`: what finds forces; None: what make_contact_solver makes.
    """
    law = environment.environment.contact_law
    if law is None:
        return None
    nodes = {name: model.contact_points for name, model in rom.contact_models.items()}
    points = ContactPoints(nodes, rom.contact_surfaces, rom.nodes, rom.points_between)
    given = points.coordinates, list(environment.obstacles.values()), law
    if solver_of is None:
        own = points.own_surface(environment.environment.self_contact, rom.triangles)
        faces = points.faces(rom.triangles) if environment.environment.touches_faces else None
        solver = make_contact_solver(*given, own, faces)
    else:
        solver = solver_of(*given)
    rows = points.columns(lambda nodes: rom.rows_of(nodes).reshape(-1, rom.basis.shape[1]).T).T
    passes = {} if environment.environment.touches_faces else environment.obstacles
    radii = {name: smallest_radius(obstacle) for name, obstacle in passes.items()}
    passing = points.describe_passing(radii, rom.triangles, rom.nodes)
    skin = SkinWatch(skin_of(rom)) if environment.obstacles and len(rom.triangles) else None
    return ContactInterface(points, solver, rows, environment, passing, skin)


def skin_of(rom: Rom) -> Skin:
    """The surface of a reduced body."""
    surfaces = {
        name: np.union1d(rom.contact_surfaces.get(name, model.contact_points), model.contact_points)
        for name, model in rom.contact_models.items()
    }
    movable = np.zeros(3 * len(rom.nodes), dtype=bool)
    movable[rom.free] = True
    return Skin(rom.nodes, rom.triangles, surfaces, movable.reshape(-1, 3).any(axis=1), rom.surfaces)
