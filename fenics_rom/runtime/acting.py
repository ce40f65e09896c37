"""What acts by itself in a reduced run: the effects that its scene names, out of those that the ROM was made with."""

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from fenics_rom.errors import SceneError, StepError, unknown
from fenics_rom.mechanics.active_environment import ActiveEnvironment, ContactPoints, SignalLike
from fenics_rom.mechanics.contact import Contact, ContactSolution
from fenics_rom.mechanics.energy_ledger import EnergyLedger
from fenics_rom.rom.rom import ContactModel, Rom
from fenics_rom.runtime.steppers.contact import ContactMidpoint, ContactStepper, Equilibrium, Touch
from fenics_rom.runtime.steppers.midpoint_forms import FusedMidpoint, StagedMidpoint, fastest
from fenics_rom.scene.effect_table import EFFECTS
from fenics_rom.scene.scene import Scene

Array = np.ndarray
Form = FusedMidpoint | StagedMidpoint | ContactStepper


class ContactState(NamedTuple):
    """What is left of the last step.

    Attributes:
        offsets: where the obstacles are, (O, 3), m.
        velocities: theirs, (O, 3), m/s.
        last: contact forces, which the next search begins with, N.
        touched: contact; None where nothing touched.
    """

    offsets: Array
    velocities: Array
    last: Array
    touched: ContactSolution | None


class Acting:
    """Loads and obstacles of a run, as a simulator needs them.

    Args:
        rom: the reduced model.
        surroundings: what acts.

    Attributes:
        surroundings: what acts.
        step_by_step: whether what happens in a step is not known before it is taken.

    Raises:
        StepError: the body begins in an obstacle.
    """

    def __init__(self, rom: Rom, surroundings: ActiveEnvironment):
        self.surroundings = surroundings
        self._chooses = surroundings.automatic and len(rom.contact_models) > 1
        self._actuators = sum(rom.actuators.values())
        self._touch: Touch | None = None
        if surroundings.law is not None:
            self._points = ContactPoints(
                {name: mode.contact_points for name, mode in rom.contact_models.items()}, rom.nodes
            )
            contact = Contact(self._points.places, list(surroundings.obstacles.values()), surroundings.law)
            components = (3 * self._points.nodes[:, None] + np.arange(3)).ravel()
            self._touch = Touch(contact, rom.basis[np.searchsorted(rom.free, components)], surroundings)
        self.step_by_step = surroundings.quasi_static or self._touch is not None
        self.check_start()

    def check_start(self) -> None:
        """Checks that at time 0 the body at rest is outside of all obstacles.

        Raises:
            StepError: it is not.
        """
        if self._touch is not None:
            around, rest = self.surroundings, np.zeros(self._points.places.shape)
            self._touch.contact.check_start(rest, around.offsets_at(0.0), list(around.obstacles))

    @property
    def touching(self) -> tuple[Touch | None, bool]:
        """What can touch, and whether there is no inertia."""
        return self._touch, self.surroundings.quasi_static

    def hand_over(self, left: Form, entered: Form) -> None:
        """Takes the last contact from one contact mode's form to another's."""
        if isinstance(left, ContactStepper) and isinstance(entered, ContactStepper):
            entered.touched = left.touched

    def form(self, mode: ContactModel, ledger: EnergyLedger | None, rigid_displacement: Array) -> Form:
        """How a contact mode is stepped; arguments as in _Form."""
        if self.surroundings.quasi_static:
            return Equilibrium(mode, ledger, rigid_displacement, self._touch)
        if self._touch is not None:
            return ContactMidpoint(mode, ledger, rigid_displacement, self._touch)
        return fastest(mode, ledger, rigid_displacement)

    def nearest(self, contact: str, form: Form) -> str:
        """The contact mode to be in, from the active one and its form."""
        around = self.surroundings
        if self._touch is None or not self._chooses or not isinstance(form, ContactStepper):
            return contact
        found = self._points.nearest(self._touch.contact.gaps(form.displacement(), around.offsets), contact)
        if around.lap is not None:
            around.lap("switching")
        return found

    def input(self, u: Array, width: int, time: float, dt: float) -> Array:
        """All inputs of the step that begins at a time, s, and notes where the obstacles will be at its end.

        Args:
            u: (width,), or the actuators' alone.
            width: number of contact columns and actuators' columns.
            time, dt: s.

        Raises:
            ValueError: u has another shape.
            StepError: a history gave something else than finite numbers.
        """
        if u.shape != (width,):
            if u.shape != (self._actuators,):
                raise ValueError
            u = np.concatenate([np.zeros(width - len(u)), u])
        around = self.surroundings
        loads = around.loads(time + dt if around.quasi_static else time + dt / 2)
        around.ahead = around.offsets_at(time + dt)
        return np.concatenate([u, loads])

    def forces(self, form: Form, obstacle: str | None) -> Array:
        """As Simulator.contact_forces."""
        if self._touch is None:
            raise StepError("there are no contact forces: the scene has no contact")
        names = list(self.surroundings.obstacles)
        if obstacle is not None and obstacle not in names:
            raise StepError(unknown("obstacle", obstacle, names))
        touched = getattr(form, "touched", None)
        if obstacle is None:
            return np.zeros(self._points.places.shape) if touched is None else touched.forces
        return np.zeros(3) if touched is None else touched.by_obstacle[names.index(obstacle)]

    @property
    def warning(self) -> str:
        """What to say of contact in the run so far; empty where there is nothing to say."""
        return "" if self._touch is None else self._touch.contact.loose.message

    @property
    def points(self) -> Array:
        """Nodes (P,) that obstacles can touch."""
        return np.empty(0, dtype=int) if self._touch is None else self._points.nodes

    def save(self, form: Form) -> ContactState:
        """All that has a past beside the state of a form."""
        last = np.empty(0) if self._touch is None else self._touch.contact.last
        return ContactState(
            self.surroundings.offsets, self.surroundings.velocities, last, getattr(form, "touched", None)
        )

    def restore(self, form: Form, past: ContactState) -> None:
        """Goes back to what was saved."""
        self.surroundings.offsets, self.surroundings.velocities = past.offsets, past.velocities
        if self._touch is not None:
            self._touch.contact.last = past.last
        if isinstance(form, ContactStepper):
            form.touched = past.touched

    def reset(self, form: Form) -> None:
        """Back to time 0."""
        last = np.empty(0) if self._touch is None else np.zeros_like(self._touch.contact.last)
        self.surroundings.begin()
        self.restore(form, ContactState(self.surroundings.offsets, self.surroundings.velocities, last, None))


def surrounded(
    rom: Rom, scene: Scene | None, signals: Mapping[str, SignalLike] | None
) -> tuple[Rom, ActiveEnvironment | None]:
    """The ROM without what the scene does not name, and what acts on it by itself; None where that is nothing.

    Args:
        rom: the reduced model.
        scene: of the run; None: the scene that the ROM was made from.
        signals: as in ActiveEnvironment.

    Raises:
        SceneError: an effect that the ROM was not made with.
        StepError: as ActiveEnvironment.
    """
    if not rom.scene_text:
        if signals or (scene is not None and set(scene.effects.names) - {"inertia", "damping"}):
            raise SceneError(f"ROM {rom.name!r} was made from matrices, so that it knows of no loads and obstacles")
        return rom, None
    from fenics_rom.scene.file import parse_scene

    own = parse_scene(rom.scene_text, tables=rom.tables, source=f"scene of ROM {rom.name!r}")
    if scene is None:
        scene = own
    _check(rom, own, scene)
    if "damping" in rom.effects and scene.effects.damping is None:
        undamped = {name: replace(mode, damping=np.zeros(mode.order)) for name, mode in rom.contact_models.items()}
        rom = replace(rom, contact_models=undamped)
    if scene.effects.large_deformation is None:
        rom = replace(rom, deformation=None)
    around = ActiveEnvironment(scene, rom.loads, signals)
    if around.quasi_static and rom.rigid:
        raise SceneError(
            f"{scene.source}: effects: inertia is missing, and a body that nothing holds has no equilibrium"
        )
    acts = around.law is not None or around.quasi_static or rom.loads
    return rom, around if acts else None


def _check(rom: Rom, own: Scene, scene: Scene) -> None:
    """What the ROM was not made for is refused, with how to make one that is."""
    cure = f"to have it, make a ROM from this scene: fenics-rom reduce {scene.source} -o ROM.h5"
    asked, made = scene.environment.built_in, own.environment.built_in
    for name in scene.effects.names:
        if name not in rom.effects:
            raise SceneError(f"{scene.source}: effects.{name}: ROM {rom.name!r} was made without it; {cure}")
    for name, effect in EFFECTS.items():
        if name in rom.effects and name not in scene.effects.names and not effect.law.online:
            raise SceneError(
                f"{scene.source}: effects.{name} is part of ROM {rom.name!r}, but not of the scene; {cure}"
            )
        if asked.get(f"effects.{name}") not in (None, made.get(f"effects.{name}")):
            raise SceneError(f"{scene.source}: effects.{name} is not what ROM {rom.name!r} was made with; {cure}")
