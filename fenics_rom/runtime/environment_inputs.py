"""What acts on a reduced body: its environment, as far as the ROM was made for it, and what that is in each step."""

import json
import warnings
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import FenicsRomWarning, SceneError, StepError
from fenics_rom.mechanics.active_environment import ActiveEnvironment
from fenics_rom.mechanics.base_path import BASE_PATH
from fenics_rom.mechanics.environment import PERMANENT_EFFECTS, Environment, HasEnvironment, given_environment
from fenics_rom.mechanics.signals import SignalLike
from fenics_rom.mechanics.step import StepInput
from fenics_rom.rom.rom import Rom
from fenics_rom.rom.truncate import without_rigid_motions
from fenics_rom.runtime.steppers.stepper import ReducedStepper

LONGEST_SHOWN = 60  # letters of what a scene says otherwise than a ROM


def fit_environment(
    rom: Rom, scene: HasEnvironment | None, signals: Mapping[str, SignalLike] | None
) -> tuple[Rom, ActiveEnvironment | None]:
    """The ROM without what a scene's environment does not name, and what acts; None where nothing but inputs does.

    Without a scene it is the environment that the ROM was made for.

    Raises:
        SceneError: no scene, or an effect that the ROM was not made with.
        StepError: as ActiveEnvironment.
    """
    made_for = rom.environment
    environment = None if scene is None else given_environment(scene)
    if not made_for.is_of_scene:
        if set(signals or ()) - {BASE_PATH} or (environment and set(environment.effects) - {"inertia", "damping"}):
            raise SceneError(f"ROM {rom.name!r} was made from matrices, so that it knows of no loads and obstacles")
        if made_for.is_moving:
            return _moving(rom, made_for), ActiveEnvironment(made_for, rom.loads, signals)
        return rom, None
    if environment is None:
        environment = made_for
    else:
        _check_built_in(rom, environment)
        environment = environment.with_bars(made_for.bars).with_chambers(made_for.chambers)
    if "damping" in made_for.effects and "damping" not in environment.effects:
        undamped = {name: replace(model, damping=np.zeros(model.order)) for name, model in rom.contact_models.items()}
        residual = rom.residual_compliance
        residual = None if residual is None else replace(residual, damping=0.0)
        frame = rom.moving_frame if rom.moving_frame is None else replace(rom.moving_frame, dashpots=None)
        rom = replace(rom, contact_models=undamped, residual_compliance=residual, moving_frame=frame, error_model=None)
    if "large_deformation" not in environment.effects:
        rom = replace(rom, deformation=None)
    active = ActiveEnvironment(environment, rom.loads, signals)
    environment.check_supports(rom.rigid)
    if environment.is_moving:
        rom = _moving(rom, environment)
    return rom, active if rom.loads or not environment.is_plain else None


def _moving(rom: Rom, environment: Environment) -> Rom:
    """The ROM of what moves in its frame."""
    if rom.moving_frame is None:
        raise SceneError(f"ROM {rom.name!r} has no moving frame; reduce {environment.source or 'its matrices'} anew")
    if not (environment.has_inertia or rom.moving_frame.carried):
        raise StepError("a body without inertia that nothing holds has no equilibrium; name effects.inertia")
    return without_rigid_motions(rom)


def _check_built_in(rom: Rom, environment: Environment) -> None:
    """What the ROM was not made for is refused, with how to make one that is."""
    made_for = rom.environment
    cure = f"to have it, make a ROM from this scene: fenics-rom reduce {environment.source} -o ROM.h5"
    if environment.frame != made_for.frame:
        raise SceneError(
            f"{environment.source}: frame = {environment.frame!r}, and ROM {rom.name!r} was made with "
            f"{made_for.frame!r}; {cure}"
        )
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
    if environment.contact_law is not None and environment.residual_compliance > made_for.residual_compliance:
        raise SceneError(
            f"{environment.source}: effects.contact.residual_compliance: ROM {rom.name!r} was made without it; {cure}"
        )
    if difference := _unlike(rom, environment):
        raise SceneError(f"{environment.source}: {difference}; {cure}")


def _unlike(rom: Rom, environment: Environment) -> str:
    """What of a scene's mesh, materials, supports, contacts, actuators, outputs and readings a ROM has not built in."""
    made_for = rom.environment
    if environment.built_in == made_for.built_in or "mesh" not in environment.built_in:
        return ""
    if "mesh" not in made_for.built_in:
        warnings.warn(
            f"ROM {rom.name!r} is of an earlier release and does not say what mesh, materials, supports, contacts and "
            f"outputs it was made with: whether those of {environment.source} are the same could not be checked",
            FenicsRomWarning,
            stacklevel=5,
        )
        return ""
    built, asked = (
        {place: known.details(place) for place in known.built_in if not place.startswith("effects.")}
        for known in (made_for, environment)
    )
    meshes = built["mesh"], asked["mesh"]
    contents, files = ([mesh.pop(key) for mesh in meshes] for key in ("content", "file"))
    if contents[0] != contents[1] or (contents[0] is None and files[0] != files[1]):
        how = "is not there" if contents[1] is None else "has another content"
        return f"mesh.file = {files[1]!r} {how}, and ROM {rom.name!r} was made with {files[0]!r}"
    place, (was, is_now) = _difference(built, asked)
    return place and f"{place} is {is_now}, and ROM {rom.name!r} was made with {was}"


def _difference(built: dict[str, Any], asked: dict[str, Any]) -> tuple[str, tuple[str, str]]:
    """The first place at which two nested tables differ, and what they say there; nowhere where they are equal."""
    for key in dict.fromkeys((*built, *asked)):
        was, is_now = built.get(key), asked.get(key)
        if was == is_now:
            continue
        if isinstance(was, dict) and isinstance(is_now, dict):
            place, values = _difference(was, is_now)
            return f"{key}.{place}", values
        return key, (_shown(was), _shown(is_now))
    return "", ("", "")


def _shown(value: Any) -> str:
    text = "not there" if value is None else json.dumps(value)
    return text if len(text) <= LONGEST_SHOWN else f"{text[:LONGEST_SHOWN]}..."


class EnvironmentInputs:
    """The inputs of each step where loads and obstacles act by themselves, and the contact mode that they ask for.

    Attributes:
        needs_each_step: whether what happens in a step is not known before it is taken.
        needs_single_steps: whether steps are more than linear maps with contact.
        switches: whether the contact mode follows the obstacles.
    """

    def __init__(self, rom: Rom, environment: ActiveEnvironment):
        self.environment = environment
        acting = environment.environment
        self.needs_single_steps = not acting.has_inertia or acting.is_moving or acting.finds_forces
        self.needs_each_step = self.needs_single_steps or acting.contact_law is not None
        self.switches = acting.switches_itself and len(rom.contact_models) > 1
        self._no_input = np.empty(0)  # zeros, the same array as long as nothing is put in
        self._actuator_columns = sum(rom.actuators.values())

    def nearest(self, stepper: ReducedStepper) -> str:
        """The contact mode to be in."""
        interface = stepper.interface
        if not self.switches or interface is None:
            return stepper.contact_mode
        gaps = interface.solver.gaps(stepper.point_displacement(), self.environment.state.offsets)
        nearest = interface.points.nearest(gaps, stepper.contact_mode)
        if self.environment.mark is not None:
            self.environment.mark("switching")
        return nearest

    def step_input(self, u: Array, width: int, time: float, dt: float) -> StepInput:
        """All that acts in the step of dt, s, that begins at a time, s; u is (width,), or the actuators' alone.

        Raises:
            ValueError: u has another shape.
            StepError: a signal gave something else than finite numbers.
        """
        return self.environment.step_input(self.full_input(u, width), time, dt)

    def full_input(self, u: Array, width: int) -> Array:
        """u (width,), or with zeros before the actuators' alone.

        Raises:
            ValueError: u has another shape.
        """
        if u.shape == (width,):
            return u
        if u.shape != (self._actuator_columns,):
            raise ValueError
        if not len(u) and len(self._no_input) == width:
            return self._no_input
        full = np.zeros(width)
        full[width - len(u) :] = u
        if not len(u):
            full.setflags(write=False)
            self._no_input = full
        return full
