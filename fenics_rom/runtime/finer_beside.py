"""A ROM of higher order that takes the same steps beside a body: the difference of their outputs is an estimate.

For whatever runs, also where no residual tells an error: large deformation, moving frames, strokes, friction of
tendons, materials that relax, equilibria. The finer body finds its own forces of contact and of strokes.
"""

from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import SceneError
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.error_tolerance import Exceeded, checked_tolerance, tell
from fenics_rom.runtime.error_watch import StatedError, check_output

Simulator = Any  # fenics_rom.runtime.simulator's, which knows of this file

WHY = "a ROM of order {} takes the same steps beside"


class FinerBeside:
    """Takes the steps that a body takes, both from the start of a run.

    Args:
        body: whose errors are asked for.
        finer: of the same scene, at the same start.
        tolerance: of outputs, m; None: whatever they are.

    Attributes:
        exceeded: where the estimate was first beyond the tolerance.
    """

    def __init__(self, body: Simulator, finer: Simulator, tolerance: float | None):
        self.tolerance = None if tolerance is None else checked_tolerance(tolerance)
        self.exceeded: Exceeded | None = None
        self._body, self._finer = body, finer
        self._why = WHY.format(max(model.order for model in finer.rom.contact_models.values()))

    def follow(self, u: Array, advice: str) -> None:
        """Takes the step that the body took under inputs (p,) as of `Simulator.step`, and tells what is beyond."""
        if not self._body.switches_itself:
            self._finer.switch(self._body.contact)
        self._finer.step(u)
        if self.tolerance is None or self.exceeded is not None:
            return
        largest = {name: float(np.abs(self._off(name)).max()) for name in self._body.rom.outputs}
        name = max(largest, key=largest.__getitem__)
        if largest[name] > self.tolerance:
            self.exceeded = Exceeded(self._body.time, largest[name], name)
            tell(self.exceeded.message(self.tolerance, advice))

    def stated(self) -> StatedError:
        """The estimate of outputs."""
        return StatedError("estimate", self._why, None, tuple(self._body.rom.outputs), self._off)

    def _off(self, name: str) -> Array:
        check_output(name, self._body.rom.outputs)
        return self._finer.displacement(name) - self._body.displacement(name)


def check_finer(rom: Rom, finer: Rom) -> None:
    """A SceneError where a ROM is not one of higher order of the same body, with outputs."""
    orders = [max(model.order for model in each.contact_models.values()) for each in (rom, finer)]
    mistake = ""
    if orders[1] <= orders[0]:
        mistake = f"is of order {orders[1]}, and the body of {orders[0]}; allowed is a higher one"
    elif finer.contacts != rom.contacts or finer.actuators != rom.actuators or finer.nodes.shape != rom.nodes.shape:
        mistake = "is of another body; allowed is one that was reduced of the same scene"
    elif not rom.outputs or finer.outputs.keys() != rom.outputs.keys():
        mistake = "is compared by outputs; allowed is a scene that has some, and the same ones"
    if mistake:
        raise SceneError(f"finer: ROM {finer.name!r} {mistake}")
