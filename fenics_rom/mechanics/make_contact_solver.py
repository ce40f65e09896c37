"""What finds contact forces: compiled loops where there are any, else NumPy."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, TypeVar

from numpy import ndarray as Array

from fenics_rom.compilation import compiled
from fenics_rom.mechanics.contact import ContactLaw
from fenics_rom.mechanics.contact_solver import ContactSolver
from fenics_rom.mechanics.obstacles import Obstacle

if TYPE_CHECKING:
    from fenics_rom.mechanics.body_faces import BodyFaces
    from fenics_rom.mechanics.mesh_contact import MeshContact
    from fenics_rom.mechanics.own_surface import OwnSurface

_Mesh = TypeVar("_Mesh", bound="MeshContact")


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
    given = points, obstacles, law
    if faces is not None:
        from fenics_rom.mechanics.face_contact import FaceAndSelfContact, FaceContact  # here, as few scenes have these

        return _kind(FaceContact)(*given, faces) if own is None else _kind(FaceAndSelfContact)(*given, faces, own)
    if own is not None:
        if compiled() and all(each.is_convex for each in obstacles):
            from fenics_rom.mechanics.compiled_self_contact import CompiledSelfContact  # here, as below

            return CompiledSelfContact(*given, own)
        from fenics_rom.mechanics.self_contact import SelfContact  # here, as few bodies touch themselves

        return _kind(SelfContact)(*given, own)
    if not all(each.is_convex for each in obstacles):
        from fenics_rom.mechanics.mesh_contact import MeshContact  # here, as few scenes have meshes

        return _kind(MeshContact)(*given)
    if compiled():
        from fenics_rom.mechanics.compiled.shapes import shape_rows  # here, as numba takes time to import
        from fenics_rom.mechanics.compiled_contact import CompiledContact

        shapes = shape_rows(obstacles)
        if shapes is not None:
            return CompiledContact(*given, shapes)
    return ContactSolver(*given)


def _kind(numpy: "type[_Mesh]") -> "type[_Mesh]":
    """The same, whose forces compiled loops find where there are any."""
    if not compiled():
        return numpy
    from fenics_rom.mechanics.compiled_pairs import by_loops  # here, as numba takes time to import

    return by_loops(numpy)
