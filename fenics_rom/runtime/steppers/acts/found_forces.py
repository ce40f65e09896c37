"""Forces of actuators that are found in a step, with what they act along: strokes, and guides at which tendons rub."""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.actuator_forces import ActuatorForces
from fenics_rom.mechanics.gas import Targets
from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.rom.deformation import ReducedDeformation, ReducedTendon
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.steppers.acts.following import Follower, follower


class FoundForces:
    """Of one contact mode.

    Args:
        body: how it deforms largely; None: its strains are small.
        model: of the contact mode.
        actuators: what is found.

    Attributes:
        followers: what turns with the body, of each; none where strains are small.
        rubbing: cables that rub, by name; none where strains are small.
    """

    def __init__(self, body: ReducedDeformation | None, model: ContactModel, actuators: ActuatorForces):
        self.actuators = actuators
        self._columns = model.inputs[:, actuators.columns]
        self.followers, self.rubbing = list[Follower](), dict[str, ReducedTendon]()
        if body is not None:
            tendons = body.tendons
            self.followers = [follower(body, name) for name in actuators.names]
            self.followers += [tendons[name].up_to(guide) for name, guide in actuators.guides]
            self.rubbing = {name: tendons[name] for name, _ in actuators.guides}

    def columns(self, q: Array) -> Array:
        """Generalized forces (m, n) of forces of 1 on the body at q."""
        if not self.followers:
            return self._columns
        return np.array([follower.force(q) for follower in self.followers]).T

    def slope(self, z: Array, q: Array) -> Array:
        """What forces z (n,) do to the body at q changes by with q, (m, m)."""
        slope = np.zeros((len(q), len(q)))
        for force, follows in zip(z, self.followers, strict=False):  # of small strains none follows
            if force:
                slope += force * follows.slope(q)
        return slope

    def strokes(self, q: Array) -> Array:
        """(n,) at q, m or m³."""
        if not self.followers:
            return q.dot(self._columns)
        return np.array([follower.stroke(q) for follower in self.followers])

    def angles(self, q: Array) -> Array | None:
        """By which tendons turn at guides (n,), rad; None where those at rest will do."""
        if not self.followers:
            return None
        return np.concatenate(
            [np.zeros(len(self.actuators.names)), *(tendon.angles(q) for tendon in self.rubbing.values())]
        )

    def stroke_slopes(self, q: Array) -> Array:
        """What strokes change by with q, (n, m)."""
        if not self.followers:
            return self._columns.T
        return np.array([follower.stroke_slope(q) for follower in self.followers])

    def turned(self, q: Array, v: Array) -> Array:
        """∂(Bᵀv)/∂q (n, m) of the columns B at q, with v (m,) as it is."""
        if not self.followers:
            return np.zeros(self._columns.T.shape)
        return np.array([follower.slope(q).T.dot(v) for follower in self.followers])

    def angle_slopes(self, q: Array) -> Array:
        """What angles at guides change by with q, (n, m)."""
        slopes = np.zeros((len(self.actuators.columns), len(q)))
        if self.rubbing:
            turned = [tendon.angle_slopes(q) for tendon in self.rubbing.values()]
            slopes[len(self.actuators.names) :] = np.concatenate(turned)
        return slopes

    @staticmethod
    def loads(rom: Rom, actuators: ActuatorForces) -> list[tuple[int, Follower]]:
        """Bars, and what follows the body at guides, with the places of their forces among the shared inputs."""
        body = rom.deformation
        if body is None:
            return []
        shared = sum(rom.actuators.values()) + sum(rom.loads.values())
        followers: list[Follower] = [body.bars[name] for name in actuators.names if name in body.bars]
        followers += [body.tendons[name].up_to(guide) for name, guide in actuators.guides]
        places = (shared + actuators.columns[len(actuators.columns) - len(followers) :]).tolist()
        return list(zip(places, followers, strict=True))

    def begin(self, u: Array, q: Array, r: Array, h: float) -> "FoundInStep":
        """In a step of h s under u (p,), from q and r (m,)."""
        forces, given = self.actuators.split(u)
        targets = self.actuators.targets(given, self.strokes(q), r.dot(self.columns(q)), h)
        return FoundInStep(self, forces, targets)


class FoundInStep(NamedTuple):
    """What is to be found in a step."""

    body: FoundForces
    inputs: Array  # (p,) without what is found
    targets: Targets  # of the strokes

    @property
    def actuators(self) -> ActuatorForces:
        """What finds them."""
        return self.body.actuators

    def acting(self, z: Array) -> Array:
        """The input (p,) with the forces z (n,)."""
        acting = self.inputs.copy()
        acting[self.body.actuators.columns] = z
        return acting
