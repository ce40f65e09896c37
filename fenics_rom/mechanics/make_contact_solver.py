"""What finds contact forces: compiled loops where there are any, else NumPy."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from numpy import ndarray as Array

from fenics_rom.compilation import compiled
from fenics_rom.mechanics.contact import ContactLaw
from fenics_rom.mechanics.contact_solver import ContactSolver
from fenics_rom.mechanics.obstacles import Obstacle

if TYPE_CHECKING:
    from fenics_rom.mechanics.body_faces import BodyFaces
    from fenics_rom.mechanics.own_surface import OwnSurface


def make_contact_solver(
    points: Array,
    obstacles: Sequence[Obstacle],
    law: ContactLaw,
    own: "OwnSurface | None" = None,
    faces: "BodyFaces | None" = None,
) -> ContactSolver:
    """Of points (P, 3), m, and obstacles that meet by a law; compiled if all are.

    `own`: the surface of the body, if that touches itself; `faces`: of the body, if obstacles meet these, too.
    """
    if faces is not None:
        from fenics_rom.mechanics.face_contact import FaceAndSelfContact, FaceContact  # here, as few scenes have these

        if own is not None:
            return FaceAndSelfContact(points, obstacles, law, faces, own)
        return FaceContact(points, obstacles, law, faces)
    if own is not None:
        if compiled() and all(each.is_convex for each in obstacles):
            from fenics_rom.mechanics.compiled_self_contact import CompiledSelfContact  # here, as below

            return CompiledSelfContact(points, obstacles, law, own)
        from fenics_rom.mechanics.self_contact import SelfContact  # here, as few bodies touch themselves

        return SelfContact(points, obstacles, law, own)
    if not all(each.is_convex for each in obstacles):
        from fenics_rom.mechanics.mesh_contact import MeshContact  # here, as few scenes have meshes

        return MeshContact(points, obstacles, law)
    if compiled():
        from fenics_rom.mechanics.compiled.shapes import shape_rows  # here, as numba takes time to import
        from fenics_rom.mechanics.compiled_contact import CompiledContact

        shapes = shape_rows(obstacles)
        if shapes is not None:
            return CompiledContact(points, obstacles, law, shapes)
    return ContactSolver(points, obstacles, law)
