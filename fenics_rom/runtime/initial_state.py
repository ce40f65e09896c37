"""The state in which a reduced run begins; shapes and velocities are projected on the basis, and what is lost is told."""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from fenics_rom.errors import SceneError, StepError, shown
from fenics_rom.mechanics.environment import Environment
from fenics_rom.mechanics.initial_state import missing_share
from fenics_rom.mechanics.load_history import LoadHistory
from fenics_rom.rom.rom import Rom

if TYPE_CHECKING:
    from fenics_rom.runtime.simulator import Simulator

Array = np.ndarray


def begin(body: "Simulator", rom: Rom, environment: Environment, history: LoadHistory) -> None:
    """Puts a simulator at rest at the start of the run of an environment.

    Raises:
        SceneError: a field that the model has next to nothing of, or an equilibrium of a body that nothing holds.
        StepError: no equilibrium was found, or the body begins in an obstacle.
    """
    initial = environment.run.initial if environment.run else None
    if initial is None:
        return
    if initial.equilibrium:
        _settle(body, rom, environment, history)
    displacement, velocity = initial.fields(rom.nodes, rom.node_mass)
    if displacement.any() or velocity.any():
        body.set_shape(body.displacement() + displacement, velocity)


def _settle(body: "Simulator", rom: Rom, environment: Environment, history: LoadHistory) -> None:
    """Puts a body in equilibrium under what acts at time 0."""
    if rom.rigid:
        raise SceneError("run.initial.shape = 'equilibrium': allowed is a body that supports or springs hold")
    still, signals = replace(environment, has_inertia=False), None
    if body.environment is not None:
        still, signals = body.environment.frozen_at(0.0)
    contact, u = history.at(0.0, body.contact)
    settled = type(body)(rom, body.dt, scene=still, signals=signals)
    settled.switch(contact)
    settled.step(u)
    body.switch(settled.contact)
    body.state = settled.state[0], np.zeros_like(settled.state[1])


def project_fields(rom: Rom, contact: str, fields: dict[str, Array]) -> tuple[Array, dict[str, float]]:
    """Coordinates (m, fields) of fields (N, 3) in the basis of a contact mode, nearest in the mass norm.

    The masses are those of the nodes, so that what is in the basis comes back to round-off, and all else nearly.

    Returns:
        The coordinates, and the share of each field that the basis has not.

    Raises:
        StepError: fields of other nodes, or not finite.
    """
    if not len(rom.nodes):
        raise StepError(f"ROM {rom.name!r} has no mesh, so that it has no shapes of nodes; set its `state`")
    for name, field in fields.items():
        if field.shape != rom.nodes.shape or not np.isfinite(field).all():
            raise StepError(f"{name}: allowed is a finite array of shape {rom.nodes.shape}, given: {shown(field)}")
    W = rom.basis @ rom.contact_models[contact].coordinates
    weighted = W * rom.node_mass[rom.free // 3, None]
    given = np.stack([field.ravel()[rom.free] for field in fields.values()], axis=1)
    coordinates = np.linalg.solve(weighted.T @ W, weighted.T @ given)
    model, lost = rom.contact_models[contact], {}
    for (name, field), column in zip(fields.items(), coordinates.T, strict=True):
        lost[name] = missing_share(field, rom.reconstruct(model.coordinates @ column), rom.node_mass)
    return coordinates, lost

