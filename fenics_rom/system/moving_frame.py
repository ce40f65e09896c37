"""What a full-order body needs beside M and K to move and turn as far as it likes: where its mass is.

M = m ⊗ I₃ is the same for the three components of a node, and the rows of a rank are those of whole nodes. So M times
e_k×X, "e_k×" node by node, is e_k× times M X, of all nodes: a base that carries the body holds some of them.

Springs to ground are S ⊗ I₃, too, and so are dashpots: they pull with -S (x - x0) at the true places x of all nodes,
however far the body is from where it was at rest, x0.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StructureError
from fenics_rom.mechanics.voigt import VOIGT_PAIRS
from fenics_rom.system.body import Unknowns
from fenics_rom.system.protocols import Algebra, Operator

GeometricStiffness = Callable[[Array], Operator]


@dataclass(frozen=True)
class WholeNodes:
    """Where supports hold or tie but some components of nodes that move: the same body without these.

    Fields of all components of such nodes are what a frame turns; x = Z z has those z that supports leave.

    Attributes:
        system: of all of these components, whose rows on a rank are those of whole nodes; its rigid motions are those
            that supports leave.
        algebra: of z.
        shares: Z (rows of the system here, n), sparse.
    """

    system: Any
    algebra: Algebra
    shares: Any

    def expand(self, z: Array) -> Array:
        """x (rows of the system here, k) of z (rows here, k)."""
        expanded: Array = self.shares @ self.algebra.gather(np.ascontiguousarray(z))
        return expanded

    def restrict(self, forces: Array) -> Array:
        """Zᵀf (rows here, k) of forces on x (rows of the system here, k)."""
        return self.algebra.inner(self.shares, forces)[self.algebra.rows()]


@dataclass(frozen=True)
class FullOrderFrame:
    """A frame that moves with a body, and the mass of the body in it.

    Attributes:
        carried: by a rigid base, which holds the nodes that no unknown moves; else the body is free.
        origin: at rest in world axes, (3,), m; of a free body its centre of mass.
        arms: X (nodes here, 3) of the nodes that move, from the origin, m.
        mass_times: m times 1 and the three components of X, of all nodes, (nodes here, 4), kg, kg m.
        moments: (4, 4) sums of m over 1 and the components of X with each other, of all nodes, kg, kg m, kg m².
        output_points: of each output at rest in world axes, (points, 3), m.
        held_arms: X (H, 3) of nodes that the base holds and inputs act on, from the origin, m.
        held_forces: of the inputs of each contact mode on these, (H, 3, p), N per unit.
        geometric_stiffness: of a displacement (rows here, 1), m: the operator K_g[σ] of its linear stress σ, N/m. None:
            the stress is not known.
        springs, dashpots: S (N, N) of all nodes, sparse, the same on every rank, N/m and N s/m; None where none.
        tie_forces: (rows here, any), N, that these put on a body which moves and turns without straining: what its
            basis has to know of them.
        whole: whose nodes those here are; None where the rows of the body's own system are those of whole nodes.
    """

    carried: bool
    origin: Array
    arms: Array
    mass_times: Array
    moments: Array
    output_points: Mapping[str, Array]
    held_arms: Array = field(default_factory=lambda: np.empty((0, 3)))
    held_forces: Mapping[str, Array] = field(default_factory=dict)
    geometric_stiffness: GeometricStiffness | None = None
    springs: Any = None
    dashpots: Any = None
    tie_forces: Array | None = None
    whole: WholeNodes | None = None

    def expand(self, x: Array) -> Array:
        """Fields of the nodes here (3 nodes here, k) of the system's unknowns (rows here, k)."""
        return x if self.whole is None else self.whole.expand(x)

    def restrict(self, forces: Array) -> Array:
        """Forces on the system's unknowns (rows here, k) of those on the nodes here (3 nodes here, k)."""
        return forces if self.whole is None else self.whole.restrict(forces)

    def forces_on_held(self, contact: str, inputs: int) -> Array:
        """What the inputs of a contact mode put on nodes that the base holds, (H, 3, inputs), N per unit."""
        return self.held_forces.get(contact, np.zeros((len(self.held_arms), 3, inputs)))

    def centrifugal_loads(self) -> Array:
        """-½M[e_k×(e_l×X) + e_l×(e_k×X)] for the six pairs k, l, in the order of Voigt, (rows here, 6), N s²."""
        mass_times_arms, unit = self.mass_times[:, 1:], np.eye(3)
        loads = [
            (mass_times_arms if k == j else 0.0)
            - (mass_times_arms[:, [k]] * unit[j] + mass_times_arms[:, [j]] * unit[k]) / 2
            for k, j in VOIGT_PAIRS
        ]
        return np.stack([load.ravel() for load in loads], axis=1)


def with_ties(
    frame: FullOrderFrame, springs: Any, dashpots: Any, nodes: Array, unknowns: Unknowns, algebra: Algebra
) -> FullOrderFrame:
    """The same with springs and dashpots to ground, as in FullOrderFrame, of nodes (N, 3), m."""
    ties = [S for S in (springs, dashpots) if S is not None]
    if not ties:
        return frame
    arms, rows = nodes - frame.origin, algebra.rows()
    fields = np.hstack([np.ones((len(arms), 1)), arms / np.linalg.norm(arms, axis=1).max()])
    pulls = np.hstack([S @ fields for S in ties])  # by x - x0 = u + (R - 1) X, each component of u and R by itself
    columns = (pulls[:, None, :, None] * np.eye(3)[:, None]).reshape(unknowns.components, -1)
    forces = unknowns.restrict(columns)[rows]
    return replace(frame, springs=springs, dashpots=dashpots, tie_forces=np.ascontiguousarray(forces))


class NodeMatrix:
    """A symmetric operator that is the same for the three components of a node: a ⊗ I₃.

    Args:
        rows: a (nodes here, nodes that move), of whole nodes of this rank.
        algebra: of the vectors.
    """

    def __init__(self, rows: Array, algebra: Algebra):
        self._rows, self._algebra = rows, algebra

    def __matmul__(self, block: Array) -> Array:
        """Product with a block, (rows here, k) to (rows here, k)."""
        whole = self._algebra.gather(np.ascontiguousarray(block))
        product: Array = self._rows @ whole.reshape(-1, 3 * block.shape[1])
        return product.reshape(block.shape)


def check_motions(rigid: int, carried: bool, where: str = "") -> None:
    """Refuses (StructureError) a body that is neither free nor wholly held, by the number of its rigid motions."""
    if rigid != (0 if carried else 6):
        kind = "is carried" if carried else "is free"
        allowed = "supports that hold all of it" if carried else "one piece, with six, that nothing holds"
        raise StructureError(f"{where}a body that {kind} has {rigid} rigid motions; use {allowed}")
