"""Where two bodies touch, or are about to."""

from fenics_rom.world.collision.contacts import Contacts, Placed, PlacedShape, no_contacts
from fenics_rom.world.collision.flat_ground import contacts_on_ground
from fenics_rom.world.collision.meshes import mesh_contacts
from fenics_rom.world.collision.polytopes import as_polytope, polytope_contacts
from fenics_rom.world.collision.round_shapes import round_contacts
from fenics_rom.world.collision.soft_surfaces import soft_on_rigid, soft_on_soft
from fenics_rom.world.shapes import Capsule, HalfSpace, Mesh, Sphere


def find_contacts(first: Placed, second: Placed, margin: float) -> Contacts:
    """Pairs of points of two bodies that are nearer than a margin, m, those that are in one another included.

    Exact but for what is said here: a cylinder meets boxes, hulls and cylinders as a prism of 48 sides.
    """
    if isinstance(first, PlacedShape):
        if isinstance(second, PlacedShape):
            return _rigid_contacts(first, second, margin)
        return soft_on_rigid(second, first, margin).mirrored
    if isinstance(second, PlacedShape):
        return soft_on_rigid(first, second, margin)
    return soft_on_soft(first, second, margin)


def _rigid_contacts(first: PlacedShape, second: PlacedShape, margin: float) -> Contacts:
    between = first.position - second.position
    reach = first.shape.radius_around + second.shape.radius_around + margin
    if between.dot(between) > reach * reach:
        return no_contacts()
    a, b = first.shape, second.shape
    if isinstance(b, Mesh):
        return mesh_contacts(first, second, margin)
    if isinstance(a, Mesh):
        return mesh_contacts(second, first, margin).mirrored
    if isinstance(b, HalfSpace):
        return contacts_on_ground(first, second, margin)
    if isinstance(a, HalfSpace):
        return contacts_on_ground(second, first, margin).mirrored
    if isinstance(a, Sphere | Capsule) and not isinstance(b, Sphere):
        return round_contacts(first, second, margin)
    if isinstance(b, Sphere | Capsule):
        return round_contacts(second, first, margin).mirrored
    return polytope_contacts(as_polytope(first), as_polytope(second), margin)
