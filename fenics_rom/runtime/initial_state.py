"""The state in which a reduced run begins: shapes and velocities projected on the basis, and what that loses."""

import warnings
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from fenics_rom.errors import FenicsRomWarning, SceneError, StepError, shown
from fenics_rom.mechanics.environment import Environment
from fenics_rom.mechanics.initial_state import lost_messages, missing_share
from fenics_rom.mechanics.load_history import LoadHistory
from fenics_rom.rom.rom import Rom

if TYPE_CHECKING:
    from fenics_rom.runtime.simulator import Simulator

Array = np.ndarray


def begin(body: "Simulator", rom: Rom, environment: Environment, history: LoadHistory) -> list[str]:
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
    initial.check_supports(rom.rigid)
    if initial.equilibrium:
        _settle(body, rom, environment, history)
    displacement, velocity = initial.fields(rom.nodes, rom.node_mass)
    fields = {name: field for name, field in (("displacement", displacement), ("velocity", velocity)) if field.any()}
    return lost_messages(add_fields(body, fields), f"ROM {rom.name!r}")


def _settle(body: "Simulator", rom: Rom, environment: Environment, history: LoadHistory) -> None:
    """Puts a body in equilibrium under what acts at time 0."""
    still, signals = replace(environment, has_inertia=False), None
    if body.environment is not None:
        still, signals = body.environment.frozen_at(0.0)
    contact, u = history.at(0.0, body.contact)
    settled = type(body)(rom, body.dt, scene=still, signals=signals)
    settled.switch(contact)
    settled.step(u)
    body.switch(settled.contact)
    body.state = settled.state[0], np.zeros_like(settled.state[1])


def add_fields(body: "Simulator", fields: dict[str, Array]) -> dict[str, float]:
    """Adds a displacement, a velocity or both, (N, 3), to the state of a body; the share of each that was lost.

    Raises:
        StepError: the fields do not fit, or the body would be in an obstacle; the state is as it was.
    """
    before = body.save()
    coordinates, lost = project_fields(body.rom, body.contact, fields)
    q, r = body.state
    body.state = q + coordinates.get("displacement", 0.0), r + coordinates.get("velocity", 0.0)
    try:
        body.check_outside_obstacles()
    except StepError:
        body.restore(before)
        raise
    return lost


def set_shape(body: "Simulator", displacement: Array, velocity: Array | None) -> dict[str, float]:
    """See Simulator.set_shape."""
    fields = {"displacement": np.asarray(displacement, dtype=float)}
    if velocity is not None:
        fields["velocity"] = np.asarray(velocity, dtype=float)
    before, zero = body.save(), np.zeros(len(body.state[0]))
    body.state = zero, zero
    try:
        lost = add_fields(body, fields)
        messages = lost_messages(lost, f"ROM {body.rom.name!r}")
    except (StepError, SceneError):
        body.restore(before)
        raise
    for message in messages:
        warnings.warn(message, FenicsRomWarning, stacklevel=3)
    return lost


def project_fields(rom: Rom, contact: str, fields: dict[str, Array]) -> tuple[dict[str, Array], dict[str, float]]:
    """Coordinates (m,) of fields (N, 3) in the basis of a contact mode, nearest in the mass norm.

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
    if not fields:
        return {}, {}
    W = rom.basis @ rom.contact_models[contact].coordinates
    weighted = W * rom.node_mass[rom.free // 3, None]
    given = np.stack([field.ravel()[rom.free] for field in fields.values()], axis=1)
    coordinates = dict(zip(fields, np.linalg.solve(weighted.T @ W, weighted.T @ given).T, strict=True))
    C = rom.contact_models[contact].coordinates
    taken = {name: rom.reconstruct(C @ column) for name, column in coordinates.items()}
    return coordinates, {name: missing_share(fields[name], taken[name], rom.node_mass) for name in fields}
