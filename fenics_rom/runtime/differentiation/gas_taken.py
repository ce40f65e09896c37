"""Back through what a step does with gas in chambers: what is let in before it, and what is stored after it."""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.filling import Filling
from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.runtime.simulator import Simulator
from fenics_rom.runtime.steppers.acts.following import follower


class GasBefore(NamedTuple):
    """What is let in before a step."""

    columns: Array  # of the g chambers in the input
    by_amount: Array  # what amounts change by with those before (g,),
    by_stroke: Array  # with strokes, of gas that is given 0,
    by_supply: Array  # and with the input, of gas that is given 1
    strokes: Array  # what strokes change by with q (g, m)

    @staticmethod
    def of(body: Simulator, filling: Filling, u: Array) -> "GasBefore":
        """Of a body that is to take a step under u (p,)."""
        each = [filling.let_in_slopes(name, u, body.dt) for name in filling.amounts]
        by_amount, by_stroke, by_supply = np.array(each).T
        columns = np.array(list(filling.columns.values())) + len(u)
        return GasBefore(columns, by_amount, by_stroke, by_supply, _stroke_slopes(body, filling))

    def pull_back(self, amounts_: Array) -> tuple[Array, Array, Array]:
        """What is owed to amounts before (g,), to inputs (g,) and to q (m,), of what is owed to amounts."""
        return self.by_amount * amounts_, self.by_supply * amounts_, (self.by_stroke * amounts_) @ self.strokes


class GasAfter(NamedTuple):
    """What gas stores after a step."""

    by_q: Array  # (m,)
    by_amount: Array  # (g,)

    @staticmethod
    def of(body: Simulator, filling: Filling) -> "GasAfter":
        """Of a body as it is."""
        by_stroke, by_amount = np.array([filling.energy_slopes(name) for name in filling.amounts]).T
        return GasAfter(by_stroke @ _stroke_slopes(body, filling), by_amount)


def _stroke_slopes(body: Simulator, filling: Filling) -> Array:
    """What strokes change by with q (g, m), of the model that steps are gone back through in."""
    model: ContactModel = body.integrator.adjoint_model
    if body.rom.deformation is None:
        at = model.inputs.shape[1] - sum(body.rom.loads.values())
        return model.inputs[:, [at + column for column in filling.columns.values()]].T
    return np.array([follower(body.rom.deformation, name).stroke_slope(body.state[0]) for name in filling.amounts])
