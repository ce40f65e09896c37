"""What a law says of the beam with a weight: where it comes to rest, and how it gets there."""

from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray as Array
from recordings import MARKERS, Ringing

import fenics_rom as fr
from fenics_rom.mechanics.signals import Signal

RINGING_FROM = 0.25  # s, to the end of the run


@dataclass(frozen=True)
class Prediction:
    """Of one law and one weight."""

    rest: Array  # displacements of the markers from the straight beam, (3, 3), m
    level: float  # by which the tip was held below that, m
    run: fr.Trajectory

    @property
    def falls(self) -> Array:
        """Of each marker, from where it was held to rest, (3,), m."""
        return -self.rest[:, 2] - self.level

    @property
    def sag(self) -> float:
        """Their mean, m."""
        return float(self.falls.mean())

    @property
    def heights(self) -> Array:
        """Mean of the markers beside that of the straight beam, at each instant of the run, m."""
        return np.mean([self.run.readings[name].values[:, 2] for name in MARKERS], axis=0)

    @property
    def ringing(self) -> Ringing:
        """Of the run."""
        return Ringing.of(self.run.times, self.heights, RINGING_FROM, float(self.run.times[-1]))


def predict(scene: fr.Scene, young_at_rest: float, level: float) -> Prediction:
    """The scene's run, and its equilibrium with a modulus (Pa), where the tip was held below level (m)."""
    return Prediction(at_rest(elastic(scene, young_at_rest, 0.0)), level, fr.simulate(scene))


def elastic(scene: fr.Scene, young: float, beta: float) -> fr.Scene:
    """A scene of an elastic material, with a modulus (Pa) and viscosity (s)."""
    effects = scene.effects
    assert effects.damping is not None
    return replace(
        scene,
        materials={"material": replace(scene.materials["material"], young=young)},
        effects=replace(effects, damping=replace(effects.damping, beta=beta), viscoelasticity=None),
    )


def with_weight(scene: fr.Scene, times: float) -> fr.Scene:
    """A scene of another weight, as so many times its own, and the hand that carries it; 0: of none."""
    weights = scene.effects.point_masses if times else {}
    others = {name: replace(one, mass=times * one.mass) for name, one in weights.items()}
    assert scene.run is not None
    hand, *support = scene.run.loads
    loads = (replace(hand, signal=Signal(times * hand.signal(0.0))), *support)
    return replace(scene, effects=replace(scene.effects, point_masses=others), run=replace(scene.run, loads=loads))


def at_rest(scene: fr.Scene) -> Array:
    """Displacements of the markers in equilibrium, (3 markers, 3), m."""
    assert scene.run is not None
    still = replace(
        scene,
        effects=replace(scene.effects, inertia=None, damping=None),
        run=replace(scene.run, dt=1.0, duration=1.0, loads=(), initial=None),
    )
    run = fr.simulate(still)
    return np.array([run.readings[name].values[-1] for name in MARKERS])


def sag_at_rest(scene: fr.Scene) -> float:
    """Mean of the markers, m."""
    return -float(at_rest(scene)[:, 2].mean())
