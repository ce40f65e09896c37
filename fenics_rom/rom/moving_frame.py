"""What a body needs to move and turn as far as it likes: constants of its inertia in a frame that moves with it.

Node i is at p + R y_i, y = X + Q_e q, with X from the frame's origin and Q_e the strained vectors of a basis, QᵀMQ = I.
With M = m ⊗ I₃, "e_k×" node by node and r = dq/dt (nodal floating frame: Zwölfer & Gerstmayr, 2021),

    I(q)_kl = (e_k×y)ᵀM(e_l×y) = I0 + I1 q + qᵀI2 q,  G_k = Q_eᵀM(e_k×Q_e),  b(q)_k = g_k + G_k q,  g_k = Q_eᵀM(e_k×X)
    T = ½ mass |v|² + v·(ω×(x̄ + c q)) + v·c r + ½ ω·I ω + ω·b r + ½ |r|²,     x̄ = Σ m X,  c = Σ m Q_e

for velocity v of the origin and angular velocity ω in body axes. Geometric stiffening takes from I2 the matrices
Kg_kl = Q_eᵀ K_g[σ(u_kl)] Q_e of the linear stress σ in the static response u_kl to the centrifugal load
-½M[e_k×(e_l×X) + e_l×(e_k×X)]. As y is linear in q, the rest holds however far the body deforms; then its potential
knows how stress stiffens it, and there are no Kg.

Springs to ground pull with -S (x - x0), S ⊗ I₃ of all nodes. A node goes by D φ, φ = [1, X, V_x, V_y, V_z] of the node,
D = [u, R - 1, R ⊗ q] with the displacement u of the origin, so that all they do is in the sums Σ S_ij φ_i φ_jᵀ; and all
that dashpots do in theirs.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StructureError
from fenics_rom.mechanics.voigt import VOIGT_INDEX
from fenics_rom.rom.content import ByContent

ROUND_OFF = 1e-12  # of the largest eigenvalue of sums that are positive semi-definite, or below 0 by this


@dataclass(frozen=True, eq=False)
class MovingFrame(ByContent):
    """Of k strained vectors, those of the shared basis or of a contact mode.

    Attributes:
        carried: by a rigid base whose motion is given; else the body is free.
        origin: of the frame at rest in world axes, (3,), m; of a free body its centre of mass.
        mass: of the body, kg.
        first_moment: x̄ (3,), kg m; of a free body 0.
        moment_modes: c (3, k), kg^1/2; of a free body 0.
        inertia0: I0 (6,), kg m²; the entries xx, yy, zz, yz, xz, xy of a symmetric matrix.
        inertia1: I1 (6, k), kg^1/2 m.
        inertia2: I2 (6, k, k), each symmetric.
        coupling0: g (3, k), kg^1/2 m; of a free body 0.
        coupling: G (3, k, k), each antisymmetric.
        stiffening: Kg (6, k, k), each symmetric, to be taken from I2; None where it is not known, or the body deforms
            largely.
        wrenches: force and torque about the origin, (6, p), of each contact mode's input columns, with the shape at
            rest, N and N m per unit of the input. Forces within the body, of tendons and chambers, have none; what the
            pressure on an open surface has besides, as it deforms largely, its rim tells (`rom.deformation`).
        torque_modes: (p, 3, k) what the shape adds to these torques; nothing of actuators, whose forces are internal.
        output_points: (points, 3) of each output, at rest in world axes, m.
        springs, dashpots: (4 + 3k, 4 + 3k) sums of what ties nodes to the ground over 1, the components of X, and those
            of Q_e (x of all vectors, then y, then z), symmetric, N/m and N s/m per square of these; None where none.
    """

    carried: bool
    origin: Array
    mass: float
    first_moment: Array
    moment_modes: Array
    inertia0: Array
    inertia1: Array
    inertia2: Array
    coupling0: Array
    coupling: Array
    stiffening: Array | None = None
    wrenches: Mapping[str, Array] = field(default_factory=dict)
    torque_modes: Mapping[str, Array] = field(default_factory=dict)
    output_points: Mapping[str, Array] = field(default_factory=dict)
    springs: Array | None = None
    dashpots: Array | None = None

    @property
    def order(self) -> int:
        """Number k of vectors that strain."""
        return self.inertia1.shape[1]

    def of_mode(self, coordinates: Array) -> "MovingFrame":
        """The same of vectors Q_e C with CᵀC = I; `coordinates` C (k, m), those of a contact mode that strain."""
        C = coordinates
        return replace(
            self,
            moment_modes=self.moment_modes @ C,
            inertia1=self.inertia1 @ C,
            inertia2=_projected(C, self.inertia2),
            coupling0=self.coupling0 @ C,
            coupling=_projected(C, self.coupling),
            stiffening=None if self.stiffening is None else _projected(C, self.stiffening),
            springs=_projected_sums(C, self.springs),
            dashpots=_projected_sums(C, self.dashpots),
        )


def _projected(C: Array, matrices: Array) -> Array:
    """CᵀAC of matrices (any, k, k), symmetric or antisymmetric to the last bit where they are."""
    projected = C.T @ matrices @ C
    transposed = matrices.transpose(0, 2, 1)
    sign = -1.0 if np.array_equal(matrices, -transposed) else 1.0
    return (projected + sign * projected.transpose(0, 2, 1)) / 2


def _projected_sums(C: Array, sums: Array | None) -> Array | None:
    """Sums over 1, X and Q_e as those over 1, X and Q_e C; None of none."""
    if sums is None:
        return None
    by_component = sums[:, 4:].reshape(len(sums), 3, -1) @ C
    half = np.hstack([sums[:, :4], by_component.reshape(len(sums), -1)])
    below = C.T @ half[4:].reshape(3, -1, half.shape[1])
    projected = np.vstack([half[:4], below.reshape(-1, half.shape[1])])
    return (projected + projected.T) / 2


def check_moving_frame(frame: MovingFrame, order: int) -> MovingFrame:
    """Measures what its balances of energy and momentum rest on, and returns it; of `order` vectors that strain.

    Raises:
        StructureError: with the measured number.
    """
    k = order
    shapes = {"origin": (3,), "first_moment": (3,), "moment_modes": (3, k), "inertia0": (6,), "inertia1": (6, k)}
    shapes |= {"inertia2": (6, k, k), "coupling0": (3, k), "coupling": (3, k, k)}
    shapes |= {} if frame.stiffening is None else {"stiffening": (6, k, k)}
    ties = [name for name in ("springs", "dashpots") if getattr(frame, name) is not None]
    shapes |= dict.fromkeys(ties, (4 + 3 * k,) * 2)
    for name, shape in shapes.items():
        array = getattr(frame, name)
        if array.shape != shape:
            raise StructureError(f"moving frame: {name} has shape {array.shape}; use {shape}")
        if not np.isfinite(array).all():
            raise StructureError(f"moving frame: {name} holds numbers that are not finite")
    if not 0 < frame.mass < np.inf:
        raise StructureError(f"moving frame: mass is {frame.mass:g} kg; use one above 0")
    for name, sign in (("inertia2", 1.0), ("stiffening", 1.0), ("coupling", -1.0)):
        A = getattr(frame, name)
        if A is not None and (lack := np.abs(A - sign * A.transpose(0, 2, 1)).max(initial=0.0)):
            raise StructureError(f"moving frame: {name} is not {'anti' * (sign < 0)}symmetric: off by {lack:.1e}")
    for name in ties:
        sums = getattr(frame, name)
        if lack := np.abs(sums - sums.T).max():
            raise StructureError(f"moving frame: {name} is not symmetric: off by {lack:.1e}")
        least, most = np.linalg.eigvalsh(sums)[[0, -1]]
        if least < -ROUND_OFF * most or most <= 0:
            raise StructureError(
                f"moving frame: {name} could give energy to the ground or the body: eigenvalues are {least:.1e} to "
                f"{most:.1e}; they must be >= 0"
            )
    for name in () if frame.carried else ("first_moment", "moment_modes", "coupling0"):
        if (lack := np.abs(getattr(frame, name)).max(initial=0.0)) > 0:
            raise StructureError(f"moving frame: {name} of a free body is up to {lack:.1e}, not 0")
    # Kinetic energy at rest, of v, ω and r: what r = -cᵀv - gᵀω leaves of it.
    x = frame.first_moment
    turned = np.array([[0.0, x[2], -x[1]], [-x[2], 0.0, x[0]], [x[1], -x[0], 0.0]])  # v·(ω×x̄)
    rigid = np.block([[frame.mass * np.eye(3), turned], [turned.T, frame.inertia0[VOIGT_INDEX]]])
    followed = np.vstack([frame.moment_modes, frame.coupling0])
    scale = np.sqrt(np.where(np.diag(rigid) > 0, np.diag(rigid), 1.0))
    least = np.linalg.eigvalsh((rigid - followed @ followed.T) / scale[:, None] / scale)[0]
    if not least > 0:
        raise StructureError(
            f"moving frame: the kinetic energy of motions as a whole is not positive definite, least {least:.1e} of 1"
        )
    return frame
