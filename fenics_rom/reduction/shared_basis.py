"""One shared basis for all contact modes: W_i = Q C_i, so that a file holds the joint span and not every basis."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fenics_rom.reduction.subspace import Subspace, damping_in, diagonalized, orthonormal_rest
from fenics_rom.rom import Mode, Rom, diagonalized_span
from fenics_rom.system import Array, Factor, System


@dataclass(frozen=True)
class Reduced:
    """One contact mode before the shared basis is known.

    Attributes:
        W: (rows here, m) M-orthonormal basis.
        σ: (r,) Hankel singular values.
        T: (rows here, m) what spans W, by falling importance: the balanced basis, or eigenvectors.
        left: (m, k) the oblique P T̄⁻¹ in the coordinates of `space`.
        space: where it was balanced.
    """

    W: Array
    σ: Array
    T: Array
    left: Array
    space: Subspace


def in_shared_basis(
    system: System,
    factor: Factor,
    reduced: Mapping[str, Reduced],
    *,
    switching: str,
    weighting: str,
    messages: list[str],
) -> Rom:
    """Puts all bases into one M-orthonormal Q that diagonalizes K, and diagonalizes each mode in its own span.

    Args:
        system: the full-order model.
        factor: of K, for the static errors.
        reduced: by contact mode.
        switching, weighting: what the ROM is reduced for.
        messages: its warnings.
    """
    algebra, scene = system.algebra, system.scene
    Q = np.empty((len(next(iter(reduced.values())).W), 0))
    for r in reduced.values():
        Q = np.hstack([Q, orthonormal_rest(system, r.W, Q)])
    joint = diagonalized(system, Q)
    Q, κ = joint.basis, joint.eigenvalues
    MQ = system.mass @ Q

    modes = {}
    for name, r in reduced.items():
        B = system.input_matrix(name)
        span, _ = np.linalg.qr(algebra.inner(MQ, r.W))
        γ, C = diagonalized_span(κ, span)
        W = Q @ C
        G = algebra.inner(W, B)
        T = algebra.inner(MQ @ C, r.T)  # in this mode's coordinates
        left = T @ r.left @ algebra.inner(r.space.basis, MQ) if switching == "oblique" else None
        statics = factor.solve(B)
        error = statics - W @ (G / γ[:, None])
        modes[name] = Mode(
            eigenvalues=γ,
            damping=damping_in(system, W, γ),
            inputs=G,
            coordinates=C,
            directions=np.linalg.qr(T / np.linalg.norm(T, axis=0))[0],
            hankel_singular_values=r.σ,
            left_inverse=left,
            static_error=_norm(system, error) / _norm(system, statics),
        )
    return Rom(
        name=scene.name if scene else "system",
        switching=switching,
        modes=modes,
        actuators={name: columns.shape[1] for name, columns in system.actuators.items()},
        basis=algebra.gather(Q),
        stiffness=κ,
        outputs={name: algebra.inner(C, Q) for name, C in system.outputs.items()},
        free=system.body.free,
        nodes=system.body.nodes,
        triangles=system.body.triangles,
        node_mass=system.body.node_mass,
        effects=scene.effects if scene else {},
        scene_text=scene.text if scene else "",
        tables=scene.tables if scene else {},
        warnings=tuple(messages),
        weighting=weighting,
    )


def _norm(system: System, block: Array) -> float:
    return float(np.sqrt(np.trace(system.algebra.inner(block, system.mass @ block))))
