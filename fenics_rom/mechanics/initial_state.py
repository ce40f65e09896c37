"""Where a run begins, if not at rest: in equilibrium, where another run was, turned, thrown."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import SceneError
from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.mechanics.frame_motion import quaternion_of_vector

Vector = tuple[float, float, float]
ZERO: Vector = (0.0, 0.0, 0.0)
TOLD_LOSS = 0.01  # share of a field, from which on its loss is told: twice what models of usual orders lose
SMALL_ROTATION = 0.1  # rad: the square of it, 1 %, is what a linear model stretches a body by


@dataclass(frozen=True)
class Instant:
    """A shape and its velocities, of the nodes of a mesh."""

    nodes: Array  # (N, 3), m
    displacement: Array  # (N, 3), m
    velocity: Array  # (N, 3), m/s


@dataclass(frozen=True)
class InitialState:
    """Displacement and velocity at time 0; the parts add up."""

    equilibrium: bool = False  # under the loads at time 0
    instant: Instant | None = None
    translation: Vector = ZERO  # m
    rotation: Vector = ZERO  # rotation vector about the centre of mass, rad
    velocity: Vector = ZERO  # m/s
    spin: Vector = ZERO  # about the centre of mass, rad/s

    def check_supports(self, rigid: int) -> None:
        """Checks that a body with so many rigid motions can begin so.

        Raises:
            SceneError: it cannot.
        """
        if self.equilibrium and rigid:
            raise SceneError("run.initial.shape = 'equilibrium': use a body that supports or springs hold")
        for name in ("translation", "rotation"):
            if any(getattr(self, name)) and not rigid:
                raise SceneError(f"run.initial.{name}: use a body that nothing holds")

    def pose(self, origin: Array) -> BaseState:
        """Where a free body in a moving frame begins; `origin` (3,) is its centre of mass at rest, m.

        Raises:
            SceneError: a shape other than that at rest.
        """
        if self.equilibrium or self.instant is not None:
            raise SceneError("run.initial: a body in a moving frame begins in its shape at rest; use no other")
        position, rotation = origin + np.array(self.translation), quaternion_of_vector(self.rotation)
        return BaseState(position, rotation, np.array(self.velocity), np.array(self.spin))

    def check_carried(self) -> None:
        """Refuses (SceneError) what a rigid base has the say of: a body that it carries begins at rest in it."""
        if self != InitialState():
            raise SceneError("run.initial: of a body that a rigid base carries, effects.base_path says how it begins")

    def fields(self, nodes: Array, node_mass: Array) -> tuple[Array, Array]:
        """Displacement (m) and velocity (m/s) of nodes, (N, 3) each; the equilibrium is not in them.

        Raises:
            SceneError: the instant is of another mesh.
        """
        arms = nodes - node_mass @ nodes / node_mass.sum()
        displacement = np.array(self.translation) + np.cross(self.rotation, arms)
        velocity = np.array(self.velocity) + np.cross(self.spin, arms)
        if self.instant is not None:
            if self.instant.nodes.shape != nodes.shape or not np.allclose(self.instant.nodes, nodes):
                raise SceneError(
                    f"run.initial.trajectory: is of a mesh of {len(self.instant.nodes)} nodes, and the body has "
                    f"another one, of {len(nodes)}; use a run of the same mesh"
                )
            displacement, velocity = displacement + self.instant.displacement, velocity + self.instant.velocity
        return displacement, velocity


def missing_share(field: Array, taken: Array, node_mass: Array) -> float:
    """What a model cannot take on of a field (N, 3), in the mass norm, as a share of it."""
    whole = float(np.sqrt(node_mass @ np.square(field).sum(axis=1)))
    return float(np.sqrt(node_mass @ np.square(field - taken).sum(axis=1))) / whole if whole > 0 else 0.0


def lost_messages(lost: Mapping[str, float], model: str) -> list[str]:
    """What is to be said of the shares of fields that a model has not taken on.

    Raises:
        SceneError: it has taken on less than a half of one.
    """
    for name, share in lost.items():
        if share > 0.5:
            raise SceneError(
                f"initial {name}: {share:.0%} of it (mass norm) is not in {model}; use what supports let move, "
                "and a basis can follow"
            )
    return [
        f"initial {name}: {share:.2g} of it (mass norm) is not in {model}, and was left out"
        for name, share in lost.items()
        if share > TOLD_LOSS
    ]
