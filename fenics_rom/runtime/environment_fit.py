"""What acts on a reduced body: an environment, as far as the ROM was made for it."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from fenics_rom.errors import SceneError, StepError
from fenics_rom.mechanics.active_environment import ActiveEnvironment
from fenics_rom.mechanics.environment import PERMANENT_EFFECTS, Environment
from fenics_rom.mechanics.signals import SignalLike
from fenics_rom.rom.rom import Rom


def fit_environment(
    rom: Rom, environment: Environment | None, signals: Mapping[str, SignalLike] | None
) -> tuple[Rom, ActiveEnvironment | None]:
    """The ROM without what the environment does not name, and what acts on it; None where nothing but inputs does.

    Args:
        rom: the reduced model.
        environment: of the run; None: the one that the ROM was made for.
        signals: as in ActiveEnvironment.

    Raises:
        SceneError: an effect that the ROM was not made with.
        StepError: as ActiveEnvironment.
    """
    made_for = rom.environment
    if not made_for.is_of_scene:
        if signals or (environment is not None and set(environment.effects) - {"inertia", "damping"}):
            raise SceneError(f"ROM {rom.name!r} was made from matrices, so that it knows of no loads and obstacles")
        return rom, None
    if environment is None:
        environment = made_for
    else:
        _check_built_in(rom, environment)
    if "damping" in made_for.effects and "damping" not in environment.effects:
        undamped = {name: replace(model, damping=np.zeros(model.order)) for name, model in rom.contact_models.items()}
        rom = replace(rom, contact_models=undamped)
    if "large_deformation" not in environment.effects:
        rom = replace(rom, deformation=None)
    active = ActiveEnvironment(environment, rom.loads, signals)
    environment.check_supports(rom.rigid)
    return rom, active if rom.loads or not environment.is_plain else None


def fit_loads(rom: Rom, signals: Mapping[str, SignalLike] | None) -> tuple[Rom, ActiveEnvironment | None]:
    """The same for many bodies at once, on which nothing but inputs and loads may act.

    Raises:
        StepError: more than that acts; or as fit_environment.
    """
    if rom.environment.is_plain and not signals:
        return rom, None
    rom, active = fit_environment(rom, None, signals)
    if not rom.environment.has_inertia or rom.environment.contact_law is not None:
        raise StepError(
            f"ROM {rom.name!r} has contact or no inertia in its scene: allowed are forces that are known before a "
            "step; Simulator steps such bodies, one by one"
        )
    return rom, active


def _check_built_in(rom: Rom, environment: Environment) -> None:
    """What the ROM was not made for is refused, with how to make one that is."""
    made_for = rom.environment
    cure = f"to have it, make a ROM from this scene: fenics-rom reduce {environment.source} -o ROM.h5"
    for name in environment.effects:
        if name not in made_for.effects:
            raise SceneError(f"{environment.source}: effects.{name}: ROM {rom.name!r} was made without it; {cure}")
    for name in PERMANENT_EFFECTS:
        if name in made_for.effects and name not in environment.effects:
            raise SceneError(
                f"{environment.source}: effects.{name} is part of ROM {rom.name!r}, but not of the scene; {cure}"
            )
    for place, text in environment.built_in.items():
        if place.startswith("effects.") and made_for.built_in.get(place, text) != text:
            raise SceneError(f"{environment.source}: {place} is not what ROM {rom.name!r} was made with; {cure}")
