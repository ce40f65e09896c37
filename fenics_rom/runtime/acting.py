"""What of a scene acts in a reduced run: the effects that it names, out of those that the ROM was made with."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from fenics_rom.effects import EFFECTS
from fenics_rom.errors import SceneError
from fenics_rom.rom import Rom
from fenics_rom.scene import Scene
from fenics_rom.surroundings import History, Surroundings


def surrounded(
    rom: Rom, scene: Scene | None, histories: Mapping[str, History] | None
) -> tuple[Rom, Surroundings | None]:
    """The ROM without what the scene does not name, and what acts on it by itself; None where that is nothing.

    Args:
        rom: the reduced model.
        scene: of the run; None: the scene that the ROM was made from.
        histories: as in Surroundings.

    Raises:
        SceneError: an effect that the ROM was not made with.
        StepError: as Surroundings.
    """
    if scene is None and not histories and not _more_than_inputs(rom):
        return rom, None
    from fenics_rom.scene_file import parse_scene  # what needs no scene should not wait for its reader

    if not rom.scene_text:
        if histories or (scene is not None and set(scene.effects) - {"inertia", "damping"}):
            raise SceneError(f"ROM {rom.name!r} was made from matrices, so that it knows of no loads and obstacles")
        return rom, None
    own = parse_scene(rom.scene_text, tables=rom.tables, source=f"scene of ROM {rom.name!r}")
    if scene is None:
        scene = own
    _check(rom, own, scene)
    if "damping" in rom.effects and "damping" not in scene.effects:
        undamped = {name: replace(mode, damping=np.zeros(mode.order)) for name, mode in rom.modes.items()}
        rom = replace(rom, modes=undamped)
    around = Surroundings(scene, rom.loads, histories)
    if around.quasi_static and rom.rigid:
        raise SceneError(
            f"{scene.source}: effects: inertia is missing, and a body that nothing holds has no equilibrium"
        )
    acts = around.law is not None or around.quasi_static or rom.loads
    return rom, around if acts else None


def _more_than_inputs(rom: Rom) -> bool:
    """Whether the scene that a ROM was made from has more to it than a body and inputs."""
    return bool(rom.loads or "contact" in rom.effects or (rom.effects and "inertia" not in rom.effects))


def _check(rom: Rom, own: Scene, scene: Scene) -> None:
    """What the ROM was not made for is refused, with how to make one that is."""
    cure = f"to have it, make a ROM from this scene: fenics-rom reduce {scene.source} -o ROM.h5"
    for name in scene.effects:
        if name not in rom.effects:
            raise SceneError(f"{scene.source}: effects.{name}: ROM {rom.name!r} was made without it; {cure}")
    for name, effect in EFFECTS.items():
        if name in rom.effects and name not in scene.effects and not effect.online:
            raise SceneError(
                f"{scene.source}: effects.{name} is part of ROM {rom.name!r}, but not of the scene; {cure}"
            )
        if name in scene.effects and _fixed(name, scene) != _fixed(name, own):
            raise SceneError(f"{scene.source}: effects.{name} is not what ROM {rom.name!r} was made with; {cure}")


def _fixed(name: str, scene: Scene) -> dict[str, Any]:
    """What a scene says of an effect that a ROM has built in."""
    effect, said = EFFECTS[name], scene.effects[name]
    changing = effect.changing

    def kept(one: Mapping[str, Any]) -> dict[str, Any]:
        return {key: value for key, value in one.items() if key not in changing}

    return {key: kept(one) for key, one in said.items()} if effect.several else kept(said)
