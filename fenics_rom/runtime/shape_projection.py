"""Fields of nodes in the coordinates of a contact mode, and what its basis has not of them."""

import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import FenicsRomWarning, StepError, shown
from fenics_rom.mechanics.initial_state import lost_messages, missing_share
from fenics_rom.mechanics.signals import real_numbers_or_nan
from fenics_rom.rom.rom import Rom

Simulator = Any  # fenics_rom.runtime.simulator's, which imports this file


def put_into_shape(body: Simulator, displacement: Array, velocity: Array | None) -> dict[str, float]:
    """As Simulator.set_shape."""
    given = {"displacement": displacement, "velocity": velocity}
    fields = {name: real_numbers_or_nan(field) for name, field in given.items() if field is not None}
    coordinates, lost = project_fields(body.rom, body.contact, fields)
    messages = lost_messages(lost, f"ROM {body.rom.name!r}")
    before, at_rest = body.save(), np.zeros_like(coordinates["displacement"])
    body.state = coordinates["displacement"], coordinates.get("velocity", at_rest)
    try:
        body.check_outside_obstacles()
    except StepError:
        body.restore(before)
        raise
    for message in messages:
        warnings.warn(message, FenicsRomWarning, stacklevel=3)
    return lost


def project_fields(rom: Rom, contact: str, fields: Mapping[str, Array]) -> tuple[dict[str, Array], dict[str, float]]:
    """Coordinates (m,) of fields (N, 3) in the basis of a contact mode, nearest in the mass norm.

    The masses are those of the nodes, so that what is in the basis comes back to round-off, and all else nearly.

    Returns:
        The coordinates, and the share of each field that the basis has not.

    Raises:
        StepError: fields of other nodes, or not finite.
    """
    if rom.environment.is_moving:
        raise StepError("shapes of nodes are of a body in a fixed frame: use `state` and `place`")
    if not len(rom.nodes):
        raise StepError(f"ROM {rom.name!r} has no mesh, so that it has no shapes of nodes; set its `state`")
    if "displacement" not in fields:
        raise StepError(f"displacement: use a finite array of shape {rom.nodes.shape} (got None)")
    for name, field in fields.items():
        if field.shape != rom.nodes.shape or not np.isfinite(field).all():
            raise StepError(f"{name}: use a finite array of shape {rom.nodes.shape} (got {shown(field)})")
    C = rom.contact_models[contact].coordinates
    coordinates = dict(zip(fields, nearest_coordinates(rom, contact, list(fields.values())), strict=True))
    taken = {name: rom.reconstruct(C @ column) for name, column in coordinates.items()}
    return coordinates, {name: missing_share(fields[name], taken[name], rom.node_mass) for name in fields}


def nearest_coordinates(rom: Rom, contact: str, fields: Sequence[Array]) -> Array:
    """Coordinates (fields, m) in the basis of a contact mode of fields (N, 3), or without a mesh (n,)."""
    W = rom.basis @ rom.contact_models[contact].coordinates
    weighted = W * rom.node_mass[rom.free // 3, None] if len(rom.nodes) else W
    given = np.stack([field.ravel()[rom.free] if len(rom.nodes) else field for field in fields], axis=1)
    coordinates: Array = np.linalg.solve(weighted.T @ W, weighted.T @ given).T
    return coordinates
