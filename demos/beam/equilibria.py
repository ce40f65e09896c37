"""The beam with a weight: its scene with other numbers, and where it comes to rest."""

from dataclasses import replace

import numpy as np
from numpy import ndarray as Array
from recordings import MARKERS

import fenics_rom as fr


def with_material(scene: fr.Scene, young: float, beta: float) -> fr.Scene:
    """A scene of another modulus (Pa) and viscosity (s)."""
    effects = scene.effects
    assert effects.damping is not None
    return replace(
        scene,
        materials={"material": replace(scene.materials["material"], young=young)},
        effects=replace(effects, damping=replace(effects.damping, beta=beta)),
    )


def with_weight(scene: fr.Scene, times: float) -> fr.Scene:
    """A scene of another weight, as so many times its own; 0: of none."""
    weights = scene.effects.point_masses if times else {}
    others = {name: replace(one, mass=times * one.mass) for name, one in weights.items()}
    return replace(scene, effects=replace(scene.effects, point_masses=others))


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
