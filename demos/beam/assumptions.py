"""What each assumption does to the sag that is foretold, with the modulus that leaves the sag without a weight."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from predictions import elastic, sag_at_rest, with_weight

import fenics_rom as fr
from fenics_rom.io.markdown import markdown
from fenics_rom.scene.effects import PointMass, Spring

TILT = np.radians(6.6)  # between the axes of the cameras and those of the clamp
MARKER_MASS = 1e-3  # kg
CLAMP_STIFFNESS = 2e5  # N/m
FEET = ((0.1, 0.0, 0.015), (0.1, -0.015, 0.009), (0.1, 0.015, -0.009))  # of the markers, m

Change = Callable[[fr.Scene], fr.Scene]


def weigh_assumptions(scene: fr.Scene, young: float) -> str:
    """A table of the sag (mm) with the scene's weight, at a modulus (Pa), under each assumption."""
    scene = elastic(scene, young, 0.0)
    light, base = sag_at_rest(with_weight(scene, 0.0)), sag_at_rest(scene)
    rows = [("as foretold", f"{1e3 * base:.2f}", "")]
    for name, change in CHANGES.items():
        free = sag_at_rest(change(with_weight(scene, 0.0)))
        refitted = elastic(scene, young * free / light, 0.0)
        sag = sag_at_rest(change(refitted))
        rows.append((name, f"{1e3 * sag:.2f}", f"{1e3 * (sag - base):+.2f}"))
    return markdown(("assumption", "sag from level (mm)", "difference"), rows)


def tied_at(height: float) -> Change:
    """The weight is tied at a height (m) of the tip's face."""

    def change(scene: fr.Scene) -> fr.Scene:
        weights = scene.effects.point_masses
        lower = {name: replace(one, point=(*one.point[:2], height)) for name, one in weights.items() if one.point}
        return replace(scene, effects=replace(scene.effects, point_masses=lower))

    return change


def tilted(angle: float) -> Change:
    """The clamp points downwards by an angle (rad)."""

    def change(scene: fr.Scene) -> fr.Scene:
        effects = scene.effects
        assert effects.gravity is not None
        down = np.array([np.sin(angle), 0.0, -np.cos(angle)])
        g = float(np.linalg.norm(effects.gravity.acceleration))
        gravity = replace(effects.gravity, acceleration=tuple(g * down))
        weights = {name: replace(one, direction=tuple(-down)) for name, one in effects.point_masses.items()}
        return replace(scene, effects=replace(effects, gravity=gravity, point_masses=weights))

    return change


def yielding(scene: fr.Scene) -> fr.Scene:
    """The clamp yields as a bed of springs does, so that the beam sags by 6 % more."""
    bed = {"clamp": Spring(surface="root", stiffness=CLAMP_STIFFNESS)}
    return replace(scene, clamped=(), effects=replace(scene.effects, springs=bed))


def with_markers(scene: fr.Scene) -> fr.Scene:
    """The markers have a mass."""
    balls = {f"ball_{k}": PointMass(mass=MARKER_MASS, point=foot) for k, foot in enumerate(FEET)}
    return replace(scene, effects=replace(scene.effects, point_masses={**scene.effects.point_masses, **balls}))


def of_material(**changes: float) -> Change:
    """Another number of the material."""
    return lambda scene: replace(scene, materials={"material": replace(scene.materials["material"], **changes)})


def of_law(law: str) -> Change:
    """Another law of large deformation."""

    def change(scene: fr.Scene) -> fr.Scene:
        large = scene.effects.large_deformation
        assert large is not None
        return replace(scene, effects=replace(scene.effects, large_deformation=replace(large, material=law)))

    return change


def heavier(share: float) -> Change:
    """The weight is heavier by a share."""
    return lambda scene: with_weight(scene, 1 + share)


CHANGES: dict[str, Change] = {
    "tied in the middle of the tip's face, not at its upper edge": tied_at(0.0),
    "gravity 6.6° from z, along the beam to its tip": tilted(TILT),
    "gravity 6.6° from z, towards the clamp": tilted(-TILT),
    "a clamp that yields, by 6 % of the sag": yielding,
    "markers of 1 g each": with_markers,
    "density 1 % higher": of_material(density=1080.7),
    "weight 1 % heavier": heavier(0.01),
    "Poisson's ratio 0.49": of_material(poisson=0.49),
    "neo-Hookean": of_law("neo_hookean"),
}
