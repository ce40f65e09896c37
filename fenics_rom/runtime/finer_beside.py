"""A ROM of higher order that takes the same steps beside a body: the difference of what they show is an estimate.

For whatever runs, also where no residual tells an error: large deformation, moving frames, strokes, friction of
tendons, materials that relax, equilibria. The finer body finds its own forces of contact and of strokes.
"""

import math
import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import FenicsRomWarning, SceneError, StepError
from fenics_rom.mechanics.environment import Environment, given_environment
from fenics_rom.rom.given_rom import given_rom
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.error_tolerance import NO_MORE, NO_OUTPUTS, Exceeded, checked_tolerance, tell
from fenics_rom.runtime.error_watch import PUT_IN, StatedError, check_output
from fenics_rom.runtime.moving_body import BeforeStep
from fenics_rom.runtime.shape_projection import nearest_coordinates
from fenics_rom.runtime.simulated_body import BesideState

if TYPE_CHECKING:
    from fenics_rom.mechanics.base_path import BaseState

Simulator = Any  # fenics_rom.runtime.simulator's, which knows of this file

WHY = "a ROM of order {} takes the same steps beside"


class FinerBeside:
    """Takes the steps that a body takes, both from the start of a run.

    Args:
        body: whose errors are asked for, at rest.
        rom: the finer ROM, of the same scene, or the name of its file.
        tolerance: of outputs, m; None: as the scene's run says.
        acting: what acts on the body, as it was made: scene, signals, stepper, detail.

    Attributes:
        finer: the finer body.
        exceeded: where the estimate was first beyond the tolerance.

    Raises:
        SceneError: the ROM is not one of higher order of the same body, with outputs.
    """

    saved_as = BesideState

    def __init__(self, body: Simulator, rom: Any, tolerance: float | None, acting: dict[str, Any]):
        rom, environment = given_rom("finer", rom), _environment_of(body, acting["scene"])
        if body.errors is not None:
            raise SceneError("finer: the body states its own errors; use one that does not, or errors = False")
        check_finer(body.rom, rom)
        if tolerance is None and environment.run is not None:
            tolerance = environment.run.error_tolerance
        self.tolerance = None if tolerance is None else checked_tolerance(tolerance)
        if tolerance is not None and not rom.outputs:
            raise StepError(NO_OUTPUTS.format(rom.name))
        self.exceeded: Exceeded | None = None
        scene = None if environment.is_plain else environment
        with warnings.catch_warnings(action="ignore", category=FenicsRomWarning):  # the body tells them
            self.finer = type(body)(rom, body.dt, ledger=False, errors=False, **acting | {"scene": scene})
        self._body, self._rom, self._from_rest = body, rom, True
        self._before: BeforeStep | None = None
        self._why = WHY.format(max(model.order for model in self.finer.rom.contact_models.values()))
        body.advice = NO_MORE

    @property
    def state(self) -> BesideState:
        """To go on from."""
        return BesideState(self.finer.save(), self._from_rest, self.exceeded)

    @state.setter
    def state(self, state: BesideState) -> None:
        self.finer.restore(state.finer)
        self._from_rest, self.exceeded, self._before = state.from_rest, state.exceeded, None

    def begin(self) -> None:
        """Begins anew at the state that the body is in, which the full order is taken to begin at, too."""
        body, finer = self._body, self.finer
        finer.begin_anew()
        self._from_rest, self.exceeded, self._before = not body.energy_coordinates.any(), None, None
        finer.switch(body.contact)
        fields = [body.rom.reconstruct(body.model.coordinates @ part) for part in body.state]
        finer.state = tuple(nearest_coordinates(finer.rom, finer.contact, fields))
        if body.pose is not None:
            finer.place(body.pose)
        now = body.save()
        when = {"dt": now.dt, "steps": now.steps, "since": now.since, "obstacles": now.obstacles}
        finer.restore(replace(finer.save(), **when))

    def begin_with(self, contact: str, begin: Callable[[Simulator, Rom], object]) -> None:
        """Begins anew as a run does: `begin` puts the finer body, at rest in a contact mode, at the start by itself."""
        self.finer.begin_anew()
        self.finer.switch(contact)
        begin(self.finer, self._rom)
        self._from_rest = True

    def way_to_advance(self, advance: Callable[[Array], float]) -> Callable[[Array], float]:
        """What takes a step of both, and returns twice the energy of the body, which `advance` moves."""
        body = self._body

        def advance_both(u: Array) -> float:
            base, before = body.next_base, BeforeStep.of(body)
            self._before = None
            twice = advance(u)
            if math.isfinite(twice):
                try:
                    self._follow(u, base)
                except StepError as error:
                    body.steps += 1  # taken, but not counted so far
                    before.return_to()
                    raise StepError(f"the ROM beside, {self.finer.rom.name!r}: {error}") from None
            return twice

        return advance_both

    def _follow(self, u: Array, base: "BaseState | None") -> None:
        """Takes the step that the body took under inputs (p,) as of `Simulator.step`; then looks at the tolerance."""
        body, finer = self._body, self.finer
        if not body.switches_itself:
            finer.switch(body.contact)
        finer.dt = body.dt
        before = BeforeStep.of(finer)
        finer.step(u, base=base)
        self._before = before
        if self.tolerance is not None and self.exceeded is None:
            largest = {name: float(np.abs(self._off(name)).max()) for name in body.rom.outputs}
            name = max(largest, key=largest.__getitem__)
            if largest[name] > self.tolerance:
                self.exceeded = Exceeded(finer.time, largest[name], name)
                tell(body.whose + self.exceeded.message(self.tolerance, body.advice))

    def take_back(self) -> None:
        """Takes the last step back, if it was taken."""
        if self._before is not None:
            self._before.return_to()
            self._before = None

    def stated(self) -> StatedError:
        """The estimate of outputs and readings."""
        why, rom = self._why + ("" if self._from_rest else PUT_IN), self._body.rom
        sensed = {name: reading for name, reading in rom.readings.items() if name in self.finer.rom.readings}
        return StatedError("estimate", why, None, tuple(rom.outputs), self._off, sensed=sensed, read=self._misread)

    def _off(self, name: str) -> Array:
        check_output(name, self._body.rom.outputs)
        return self.finer.displacement(name) - self._body.displacement(name)

    def _misread(self, name: str) -> Array:
        difference: Array = self.finer.felt(name) - self._body.felt(name)
        return difference


def _environment_of(body: Simulator, scene: Any) -> Environment:
    """What acts on a body of a scene, or of what its ROM was made for."""
    if body.environment is not None:
        return body.environment.environment
    return body.rom.environment if scene is None else given_environment(scene)


def check_finer(rom: Rom, finer: Rom) -> None:
    """A SceneError where a ROM is not one of higher order of the same body, with outputs."""
    orders = [max(model.order for model in each.contact_models.values()) for each in (rom, finer)]
    mistake = ""
    if orders[1] <= orders[0]:
        mistake = f"is of order {orders[1]}, and the body of {orders[0]}; use a higher one"
    elif finer.contacts != rom.contacts or finer.actuators != rom.actuators or finer.nodes.shape != rom.nodes.shape:
        mistake = "is of another body; use one that was reduced of the same scene"
    elif not (rom.outputs or rom.readings) or finer.outputs.keys() != rom.outputs.keys():
        mistake = "is compared by outputs and readings; use a scene that has some, and the same ones"
    if mistake:
        raise SceneError(f"finer: ROM {finer.name!r} {mistake}")
