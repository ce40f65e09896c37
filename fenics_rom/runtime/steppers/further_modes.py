"""A contact mode in the whole shared basis, and its model with further modes, which hold what it lacks of a state.

Further modes feel contact, gravity, actuators and loads, but not the input of the contact mode. All that they have
follows by projection from what the contact mode is in the shared basis; so its steps there, in the span that was
chosen, are those of the model with further modes, and tell how these depend on the span.
"""

from dataclasses import replace

import numpy as np
from numpy import ndarray as Array

from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.rom.rom import Rom, diagonalized_span

NOTHING_LEFT = 1e-14  # of a shape: what the next contact mode need not be given


def whole_model(rom: Rom, contact: str) -> ContactModel:
    """A contact mode in all k coordinates of the shared basis, without rigid motions.

    Inputs that all contact modes share are what their models together say; its own acts on its own shapes.
    """
    κ, models, own = rom.stiffness, list(rom.contact_models.values()), rom.contact_models[contact]
    shared, C = sum(rom.actuators.values()) + sum(rom.loads.values()), own.coordinates
    inputs = C @ own.inputs
    if shared:
        rows, pushed = (
            np.concatenate(each)
            for each in ([m.coordinates.T for m in models], [m.inputs[:, -shared:] for m in models])
        )
        inputs[:, -shared:] = np.linalg.lstsq(rows, pushed, rcond=None)[0]
    k = len(κ)
    return ContactModel(κ, _damping(κ, models, own), inputs, np.eye(k), np.eye(k), np.empty(0))


def _damping(κ: Array, models: list[ContactModel], own: ContactModel) -> Array:
    """Of all coordinates: α + β κ, as nearly as that of the models is; if it is not, on its own shapes their own."""
    γ = np.concatenate([m.eigenvalues for m in models])
    D = np.concatenate([m.damping if m.damping.ndim == 1 else np.diag(m.damping) for m in models])
    rates = np.stack([np.ones_like(γ), γ], axis=1) / γ[:, None]
    α, β = np.maximum(np.linalg.lstsq(rates, D / γ, rcond=None)[0], 0.0)
    whole: Array = α + β * κ
    if own.damping.ndim == 1 and np.allclose(D, α + β * γ, rtol=1e-9, atol=0.0):
        return whole
    C = own.coordinates
    others, D = np.eye(len(κ)) - C @ C.T, np.diag(own.damping) if own.damping.ndim == 1 else own.damping
    dense = C @ D @ C.T + others * whole @ others
    return (dense + dense.T) / 2


def holding(end: ContactModel, whole: ContactModel, fields: Array) -> ContactModel | None:
    """The model of a contact mode that holds fields (k, any) in the shared basis, too; None where it does by itself.

    `whole`: the contact mode in the shared basis.
    """
    C = end.coordinates
    further = np.empty((len(C), 0))
    for column in fields.T:
        size = float(np.linalg.norm(column))
        if size == 0:
            continue
        column, left = column / size, 1.0
        for _ in range(3):  # what a Gram-Schmidt step rounds, the next one takes away
            column = column - C @ (C.T @ column) - further @ (further.T @ column)
            size = float(np.linalg.norm(column))
            left *= size
            if not left > NOTHING_LEFT:
                break
            column = column / size
        if left > NOTHING_LEFT:
            further = np.hstack([further, column[:, None]])
    if not further.shape[1]:
        return None
    γ, coordinates = diagonalized_span(whole.eigenvalues, np.hstack([C, further]))
    D = coordinates.T @ whole.damping @ coordinates if whole.damping.ndim == 2 else whole.damping @ coordinates**2
    return replace(
        end,
        eigenvalues=γ,
        damping=(D + D.T) / 2,
        inputs=coordinates.T @ whole.inputs,
        coordinates=coordinates,
        directions=np.eye(len(γ)),
        left_inverse=None,
    )
