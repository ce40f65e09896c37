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
_Contact = TypeVar("_Contact", bound=ContactSolver)


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
    if faces is not None and obstacles:
        from fenics_rom.mechanics.face_contact import FaceAndSelfContact, FaceContact  # here, as few scenes have these

        if own is None:
            return _kind(FaceContact, law)(*given, faces)
        return _kind(FaceAndSelfContact, law)(*given, faces, own)
    if own is not None:
        if compiled() and all(each.is_convex for each in obstacles):
            from fenics_rom.mechanics.compiled_self_contact import CompiledSelfContact  # here, as below

            return _held(CompiledSelfContact, law)(*given, own)
        from fenics_rom.mechanics.self_contact import SelfContact  # here, as few bodies touch themselves

        return _kind(SelfContact, law)(*given, own)
    if not all(each.is_convex for each in obstacles):
        from fenics_rom.mechanics.mesh_contact import MeshContact  # here, as few scenes have meshes

        return _kind(MeshContact, law)(*given)
    if compiled():
        from fenics_rom.mechanics.compiled.shapes import shape_rows  # here, as numba takes time to import
        from fenics_rom.mechanics.compiled_contact import CompiledContact

        shapes = shape_rows(obstacles)
        if shapes is not None:
            return _held(CompiledContact, law)(*given, shapes)
    return _held(ContactSolver, law)(*given)


def _held(kind: type[_Contact], law: ContactLaw) -> type[_Contact]:
    """The same, whose springs let nothing through, if the law has any."""
    if law.stiffness is None:
        return kind
    from fenics_rom.mechanics.held_springs import with_springs  # here, as few laws have springs

    return with_springs(kind)


def _kind(numpy: "type[_Mesh]", law: ContactLaw) -> "type[_Mesh]":
    """The same, whose forces compiled loops find where there are any."""
    if not compiled():
        return _held(numpy, law)
    from fenics_rom.mechanics.compiled_pairs import by_loops  # here, as numba takes time to import

    return _held(by_loops(numpy), law)
