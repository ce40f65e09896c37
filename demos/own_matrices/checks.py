"""What the examples beside this file check of a reduced model: its energy account, and its transfer functions."""

import numpy as np

import fenics_rom as fr


def energy_gap(body: fr.Simulator) -> float:
    """What the account misses: stored against supplied less dissipated and lost, as a share of the largest of them."""
    account = body.ledger
    stored = account.supplied - account.dissipated - account.lost_in_switching
    return abs(body.energy - stored) / max(body.energy, account.supplied)


def round_off(body: fr.Simulator) -> float:
    """What the account may miss: some eps in every step, all of one sign, as what rounds its matrix stays the same."""
    return float(20 * body.steps * np.finfo(float).eps)


def transfer_error(system: fr.System, rom: fr.Rom, contact: str, frequencies: list[float]) -> float:
    """Largest relative error of the displacements that unit inputs cause, over all degrees of freedom.

    The full order is solved densely, so this is for small examples; every rank must call it.

    Args:
        system: the full-order model.
        rom: its reduced models.
        contact: which of them.
        frequencies: angular, 1/s.
    """
    identity = np.eye(system.size)[system.algebra.rows()]
    M, D, K = (system.algebra.gather(A @ identity) for A in (system.mass, system.damping, system.stiffness))
    B, mode = system.algebra.gather(system.input_matrix(contact)), rom.contact_models[contact]
    damping = np.diag(mode.damping) if mode.damping.ndim == 1 else mode.damping
    errors = []
    for ω in frequencies:
        full = np.linalg.solve(-(ω**2) * M + 1j * ω * D + K, B)
        dynamic = np.diag(mode.eigenvalues - ω**2) + 1j * ω * damping
        reduced = rom.basis @ (mode.coordinates @ np.linalg.solve(dynamic, mode.inputs))
        errors.append(np.linalg.norm(reduced - full) / np.linalg.norm(full))
    return float(max(errors))
