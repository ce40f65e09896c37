"""The state in which a reduced run begins."""

from dataclasses import replace

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.environment import Environment
from fenics_rom.mechanics.initial_state import lost_messages
from fenics_rom.mechanics.load_history import LoadHistory
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.shape_projection import project_fields
from fenics_rom.runtime.simulator import Simulator


def begin(body: Simulator, rom: Rom, environment: Environment, history: LoadHistory) -> list[str]:
    """Puts a simulator that is at rest at the start of the run of an environment.

    Returns:
        What the user should know: what the basis has not of a field.

    Raises:
        SceneError: a field that the model has next to nothing of, or an equilibrium of a body that nothing holds.
        StepError: no equilibrium was found, or the body begins in an obstacle.
    """
    initial = environment.run.initial if environment.run else None
    if initial is None:
        return []
    if body.pose is not None and rom.moving_frame is not None:
        if rom.moving_frame.carried:
            initial.check_carried()
        else:
            body.place(initial.pose(rom.moving_frame.origin))
        return []
    initial.check_supports(rom.rigid)
    yielded = _settle(body, rom, environment, history) if initial.equilibrium else None
    displacement, velocity = initial.fields(rom.nodes, rom.node_mass)
    displacement += rom.reconstruct(body.model.coordinates @ body.state[0])
    fields = {"displacement": displacement, "velocity": velocity}
    coordinates, lost = project_fields(rom, body.contact, fields)
    messages = lost_messages(lost, f"ROM {rom.name!r}")
    body.state = coordinates["displacement"], coordinates["velocity"]
    residual = body.integrator.kernel.residual
    if residual is not None and yielded is not None:
        residual.state[:] = yielded
    body.check_outside_obstacles()
    return messages


def _settle(body: Simulator, rom: Rom, environment: Environment, history: LoadHistory) -> Array | None:
    """Puts a body in equilibrium under what acts at time 0; what contact points yield beyond the basis, if they do."""
    still, signals = replace(environment, has_inertia=False), None
    if body.environment is not None:
        still, signals = body.environment.frozen_at(0.0)
    contact, u = history.at(0.0, body.contact)
    settled = Simulator(rom, body.dt, scene=still, signals=signals)
    settled.switch(contact)
    settled.step(u)
    body.switch(settled.contact)
    body.state = settled.state[0], np.zeros_like(settled.state[1])
    residual = settled.integrator.kernel.residual
    return None if residual is None else residual.state * np.repeat([1.0, 1.0, 0.0, 0.0], residual.state.size // 4)
