"""The bodies that a world is made of, as records."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Union

import numpy as np
from numpy import ndarray as Array

from fenics_rom.arguments import is_number
from fenics_rom.errors import SceneError, shown
from fenics_rom.mechanics.base_path import BaseState, checked_base
from fenics_rom.mechanics.frame_motion import rotation_matrix
from fenics_rom.mechanics.signals import real_numbers_or_nan
from fenics_rom.world.shapes import Shape

if TYPE_CHECKING:
    from os import PathLike

    from fenics_rom.mechanics.signals import SignalLike
    from fenics_rom.rom.rom import Rom

Vector = Sequence[float] | Array
Motion = Union[BaseState, Callable[[float], BaseState]]  # noqa: UP007 (a `|` would ask BaseState, a tuple's type)
UPRIGHT = (1.0, 0.0, 0.0, 0.0)
STILL = (0.0, 0.0, 0.0)
DEFINITE = 1e-12  # of its trace: the least that an inertia may have about an axis


@dataclass(frozen=True)
class RigidBody:
    """A rigid body. Without density, mass and motion it stands still.

    Args:
        shape: in axes about its centre of mass; None: nothing touches it.
        density: of one that moves freely, kg/m³; or
        mass: kg, with
        inertia: (3, 3) about the centre of mass, in its axes, kg m²; None: that of the shape, with this mass.
        position: of the centre of mass, m.
        rotation: of its axes, a unit quaternion w x y z.
        velocity: m/s.
        angular_velocity: in world axes, rad/s.
        motion: in place of all that but the shape, beside which it is refused: where it is and how it moves, for ever
            or as a function of time, s.
        shape_position: of a body of a mass and an inertia, where the middle of its shape is from its centre of mass, m,
        shape_rotation: and how that is turned, a unit quaternion w x y z; both in its axes.

    Example:
        >>> from fenics_rom.world.shapes import Box
        >>> box = fr.RigidBody(Box((0.1, 0.1, 0.2)), density=500, position=(0, 0, 0.1))
        >>> round(box.mass_and_inertia()[0], 9)  # kg
        1.0
    """

    shape: Shape | None
    density: float | None = None
    mass: float | None = None
    inertia: Sequence[Sequence[float]] | Array | None = None
    position: Vector = STILL
    rotation: Vector = UPRIGHT
    velocity: Vector = STILL
    angular_velocity: Vector = STILL
    motion: Motion | None = None
    shape_position: Vector = STILL
    shape_rotation: Vector = UPRIGHT

    @property
    def is_driven(self) -> bool:
        """Whether it moves as its motion says, or stands still."""
        return self.motion is not None or all(each is None for each in (self.density, self.mass, self.inertia))

    def pose(self, where: str) -> BaseState:
        """Where it begins; StepError where that is none."""
        state = self.position, self.rotation, self.velocity, self.angular_velocity
        return checked_base(state, where)

    def surface(self) -> tuple[Array, Array]:
        """Vertices (V, 3), m, in its axes from its centre of mass, and triangles (T, 3); of no shape none."""
        if self.shape is None:
            return np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64)
        vertices, triangles = self.shape.surface()
        R = rotation_matrix(np.array(self.shape_rotation, dtype=float))
        return np.array(self.shape_position, dtype=float) + vertices.dot(R.T), triangles.astype(np.int64)

    def mass_and_inertia(self) -> tuple[float, Array]:
        """Mass, kg, and inertia about the centre of mass, (3, 3), kg m².

        Raises:
            SceneError: neither density nor mass, or both, or an inertia that no body has.
        """
        given = f"density = {shown(self.density)}, mass = {shown(self.mass)}"
        known = [number for number in (self.density, self.mass) if number is not None]
        if len(known) != 1 or not (is_number(known[0]) and known[0] > 0):
            raise SceneError(
                f"{given}: use one of both, finite and > 0; or neither, and no inertia, of one that "
                "stands still or has a motion"
            )
        if self.inertia is None or self.mass is None:
            if self.shape is None or tuple(self.shape_position) != STILL or tuple(self.shape_rotation) != UPRIGHT:
                raise SceneError("mass and inertia: use both, of a body without shape, or whose shape lies off")
            mass, inertia = self.shape.inertia(1.0 if self.density is None else self.density)
            if self.mass is not None:
                inertia, mass = inertia * (self.mass / mass), float(self.mass)
        else:
            mass = float(self.mass)
        if self.inertia is not None:
            inertia = real_numbers_or_nan(self.inertia)
            if inertia.shape != (3, 3) or not np.isfinite(inertia).all() or not np.allclose(inertia, inertia.T):
                raise SceneError("inertia: use a symmetric (3, 3) of finite numbers, in kg m2")
            moments = np.linalg.eigvalsh(inertia)
            if moments[0] <= DEFINITE * moments.sum() or moments[2] > (moments[0] + moments[1]) * (1 + 1e-9):
                raise SceneError(
                    f"inertia: principal moments {moments.tolist()}: use moments > 0, none larger than the sum "
                    "of the others, in kg m2"
                )
        return mass, inertia


@dataclass(frozen=True)
class SoftBody:
    """A soft body, held, carried or free as its scene says.

    Args:
        rom: the reduced model, or the name of its file.
        position: where the axes of a held body are put; of a free one its centre of mass; of a carried one the axes of
            its mesh, or the origin of its base_path, counted from the carrier's centre of mass, not its surface, along
            the carrier's axes; m.
        rotation: of its axes, a unit quaternion w x y z; of a carried body from those of the carrier.
        velocity, angular_velocity: of a free one, m/s and rad/s.
        on: name of the rigid body that carries it, one with a motion.
        signals: as of a Simulator: of loads by name.

    Example:
        >>> fr.SoftBody("plate.h5", position=(0, 0, 0.2)).on is None
        True
    """

    rom: "Rom | str | PathLike[str]"
    position: Vector = STILL
    rotation: Vector = UPRIGHT
    velocity: Vector = STILL
    angular_velocity: Vector = STILL
    on: str | None = None
    signals: "Mapping[str, SignalLike] | None" = None

    def pose(self, where: str) -> BaseState:
        """Where it begins; StepError where that is none."""
        return checked_base((self.position, self.rotation, self.velocity, self.angular_velocity), where)
