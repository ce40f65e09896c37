"""The full-order model: M, D, K and the input matrices, whoever assembled them.

The reduction sees a system only through M @ X, D @ X, K @ X, solves, Xᵀ Y summed over the ranks, and eigenpairs.
"""

from collections.abc import Iterator, Mapping
from dataclasses import InitVar, dataclass, field
from itertools import islice
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.arguments import mapping_in
from fenics_rom.errors import StructureError, check_known
from fenics_rom.io.stages import Stage
from fenics_rom.mechanics.contact_points import ContactPoints
from fenics_rom.mechanics.environment import FRAMES
from fenics_rom.mechanics.readings import Reading
from fenics_rom.mechanics.skin import Skin
from fenics_rom.scene.scene import Scene
from fenics_rom.system.backends import backend_of
from fenics_rom.system.body import Body
from fenics_rom.system.moving_frame import FullOrderFrame, GeometricStiffness
from fenics_rom.system.node_positions import check_outputs, frame_of_matrices, with_surface
from fenics_rom.system.protocols import Algebra, Deformation, Embedded, Operator
from fenics_rom.system.rayleigh_damping import check_damping_choice

OPTIONAL_COLUMNS = ("actuators", "loads", "units", "contact_points", "outputs")
MOST_FORCES, FORCES_AT_ONCE = 960, 240  # columns of what can act in a contact mode; of more there are so many at once
ALL = slice(None)
NAMES_SHOWN = 4  # of each kind, when a system is printed
UNSET: Any = None  # not given; no field is left so


@dataclass(frozen=True, kw_only=True, repr=False)
class System:
    """M v̇ + D v + K x = B_i u_i, dx/dt = v, y = Cᵀ x.

    `assemble` makes one from a scene, `assemble_forms` from variational forms, `read_system` from files. Anyone's
    SciPy, NumPy or PETSc matrices make one, too:

        System(mass=M, damping=D, stiffness=K, contacts={"tip": B}, outputs={"tip": C})
        System(mass=M, rayleigh=(α, β), stiffness=K, contacts={"tip": B})  # D = α M + β K

    With SciPy or NumPy matrices B and C are arrays or sparse matrices (n, columns), or vectors (n,). With PETSc
    matrices they are such blocks of the rows of this rank, PETSc matrices with the same rows, or lists of PETSc
    vectors; then all ranks of the matrices' communicator make the system together.

    A body that moves freely has a singular K, whose null space is found; or `rigid` are columns that span it, given
    like those of a contact mode. With `nodes`, (N, 3) in m, the matrices have three rows for each, in their order, and
    the motions of all nodes as a whole are what is looked for; with `triangles`, (F, 3) outward between them, the body
    is drawn. Then it may turn as far as it likes:

        System(..., nodes=X, frame="moving", geometric_stiffness=of)

    where `of(u)`, which may be missing, is the geometric stiffness (as an operator, N/m) of the linear stress of a
    displacement u (n, 1). Without rigid motions such a body is carried by a base at the origin of coordinates, and
    the mass of nodes that the base holds, which are not in the matrices, counts as the base's.

    Attributes:
        mass, damping, stiffness: symmetric; M positive definite, D positive semi-definite, K positive definite but for
            the rigid motions. kg, N s/m, N/m.
        contacts: contact columns of each contact mode, (rows here, columns).
        actuators: columns of each actuator, which every contact mode has after its own, (rows here, columns).
        loads: columns of each load that acts by a history of its own, after the actuators', (rows here, columns).
        units: for those actuators and loads that are effects, what their columns are to be multiplied by for an input
            of 1 (Pa, N, ...): the columns may have any length, which says how much of them a basis is to know.
        contact_points: nodes of each contact mode at which obstacles can touch it, (P,) each; the contact modes that
            have some are reduced for forces at each of them, too.
        outputs: C of each named output, (rows here, 3 points); any number of columns where there is no mesh.
        readings: what else is read by name, with operators on all n free displacements, the same on every rank.
        algebra: solves, sums and eigenpairs for these matrices.
        rayleigh: (α, β) where D = α M + β K, else None. 1/s, s.
        springs: what of K is springs to the ground, which do not relax with a material that does, N/m; None: nothing.
        rigid: R (rows here, ρ), RᵀMR = I, what spans the null space of K; no columns where the body is held. kg^-1/2.
        body: nodes and surface; without nodes where there is no mesh.
        scene: the scene it was assembled from, if it was.
        deformation: of a body that deforms largely, beyond what these matrices say; None: linear.
        moving_frame: of a body that moves and turns as far as it likes; None: it turns but a little.
        embedded: its membranes and cables, which a run looks at; None: there are none.
        warnings: what the user should know about this model.
        stages: what making it spent its time on.

    Example:
        >>> import scipy.sparse as sp
        >>> K = sp.diags([-np.ones(99), 2 * np.ones(100), -np.ones(99)], [-1, 0, 1])
        >>> chain = fr.System(mass=sp.identity(100), damping=0.01 * K, stiffness=K, contacts={"left": np.eye(100)[0]})
        >>> fr.reduce(chain, order=20).contact_models["left"].order
        20
    """

    mass: Operator
    damping: Operator = UNSET
    stiffness: Operator
    contacts: Mapping[str, Array]
    actuators: Mapping[str, Array] = UNSET
    loads: Mapping[str, Array] = UNSET
    units: Mapping[str, float] = UNSET
    contact_points: Mapping[str, Array] = UNSET
    outputs: Mapping[str, Array] = UNSET
    readings: Mapping[str, Reading] = field(default_factory=dict)
    algebra: Algebra = UNSET
    rayleigh: tuple[float, float] | None = None
    springs: Operator | None = None
    rigid: Array = UNSET
    body: Body = UNSET
    scene: Scene | None = None
    deformation: Deformation | None = None
    moving_frame: FullOrderFrame | None = None
    embedded: Embedded | None = None
    warnings: tuple[str, ...] = ()
    stages: tuple[Stage, ...] = ()
    nodes: InitVar[Any] = None
    triangles: InitVar[Any] = None
    frame: InitVar[str] = "fixed"
    geometric_stiffness: InitVar[GeometricStiffness | None] = None

    def __post_init__(
        self, nodes: Any, triangles: Any, frame: str, geometric_stiffness: GeometricStiffness | None
    ) -> None:
        """Fills in what was not given: with an `algebra` the matrices are a backend's own, any others are measured.

        Raises:
            StructureError: matrices or columns that do not fit or lack structure, with the measured number.
        """
        for name in ("contacts", "actuators", "outputs"):
            if (given := getattr(self, name)) is not UNSET:
                mapping_in(name, given, StructureError)
        if not self.contacts:
            raise StructureError("contacts: at least one contact mode is needed")
        filled: dict[str, Any] = {name: {} for name in OPTIONAL_COLUMNS if getattr(self, name) is UNSET}
        if self.algebra is UNSET:
            check_damping_choice(self.damping, self.rayleigh)
            backend = backend_of((self.mass, self.damping, self.stiffness))
            filled |= backend.checked_fields(vars(self) | filled | {"nodes": nodes})
            filled["body"] = self.body or with_surface(filled["body"], triangles)
            if nodes is not None:
                check_outputs(filled["outputs"])
            check_known("frame", frame, FRAMES, StructureError)
            if frame == "moving":
                of = filled["body"], filled["mass"], filled["rigid"].shape[1], filled["algebra"], filled["outputs"]
                filled["moving_frame"] = frame_of_matrices(*of, geometric_stiffness)
        elif self.rigid is UNSET:
            filled["rigid"] = np.empty((self.local_size, 0))
        for name, value in filled.items():
            object.__setattr__(self, name, value)

    def __repr__(self) -> str:
        """What a person asks first: size, inputs and outputs, damping, supports, mesh."""
        inputs = {"contacts": self.contacts, "actuators": self.actuators, "loads": self.loads, "outputs": self.outputs}
        counts = [f"{kind} {_names_and_widths(columns)}" for kind, columns in inputs.items() if columns]
        damping = "D not proportional"
        if self.rayleigh is not None:
            damping = "D = {:.3g} M + {:.3g} K".format(*self.rayleigh)
        supports = f"{self.rigid.shape[1]} rigid motions" if self.rigid.shape[1] else "no rigid motions"
        mesh = f"{len(self.body.nodes)} nodes, {len(self.body.triangles)} surface triangles"
        return (
            f"System {self.scene.name if self.scene else 'of matrices'}: {self.size} unknowns, {damping}, {supports}, "
            f"{mesh if len(self.body.nodes) else 'no mesh'}\n  {'; '.join(counts)} (columns)"
        )

    @property
    def size(self) -> int:
        """Number n of free displacement degrees of freedom."""
        return len(self.body.free)

    @property
    def local_size(self) -> int:
        """Number of rows on this rank."""
        rows = self.algebra.rows()
        return rows.stop - rows.start

    @property
    def widths(self) -> dict[str, int]:
        """Number of columns of each actuator and load, which every contact mode has after its own."""
        return {name: columns.shape[1] for name, columns in {**self.actuators, **self.loads}.items()}

    def unit_forces(self, actuator: str) -> Array:
        """Forces of 1 of an actuator's unit (rows here, columns), N, on the body at rest."""
        return self.units.get(actuator, 1.0) * self.actuators[actuator]

    def input_matrix(self, contact: str) -> Array:
        """B_i: the contact columns, then those of actuators and loads, (rows here, p_i), in the units of the inputs."""
        units = [self.units.get(name, 1.0) for name in (*self.actuators, *self.loads)]
        shared = [unit * B for unit, B in zip(units, (*self.actuators.values(), *self.loads.values()), strict=True)]
        return np.hstack([self.contacts[contact], *shared])

    def forces(self, contact: str, some: slice = ALL) -> Array:
        """All that can act in a contact mode, (rows here, any), or some columns of it: what its basis has to know.

        The contact columns, actuators and loads, where obstacles can touch it a force on each component of a node, and
        what springs and dashpots put on a body in a moving frame.
        """
        given = [self.contacts[contact], *self.actuators.values(), *self.loads.values()]
        touched, tied = self._touched(contact), self._tie_forces()
        parts, begun = list[Array](), 0
        first, last, _ = some.indices(self.count_forces(contact))
        for part in (*given, touched, *tied):
            width = part.shape[-1]
            own = part[..., max(first - begun, 0) : max(last - begun, 0)]
            parts.append(self._at_components(own) if part is touched else own)
            begun += width
        return np.hstack(parts)

    def count_forces(self, contact: str) -> int:
        """How many columns `forces` has."""
        given = [self.contacts[contact], *self.actuators.values(), *self.loads.values(), *self._tie_forces()]
        return sum(part.shape[1] for part in given) + len(self._touched(contact))

    def force_blocks(self, contact: str) -> Iterator[slice]:
        """Columns of `forces` that there may be at once, one after another: of a whole skin there are thousands."""
        count = self.count_forces(contact)
        if count <= MOST_FORCES:
            return iter([slice(0, count)])
        return (slice(first, min(first + FORCES_AT_ONCE, count)) for first in range(0, count, FORCES_AT_ONCE))

    def _touched(self, contact: str) -> Array:
        """Components (any,) of nodes that obstacles can touch in a contact mode, and that can move."""
        touched = components_of(self.contact_points.get(contact, np.empty(0, dtype=int)))
        return touched[np.isin(touched, self.body.unknowns.moving)]

    def _tie_forces(self) -> list[Array]:
        """What springs and dashpots put on a body in a moving frame."""
        tied = None if self.moving_frame is None else self.moving_frame.tie_forces
        return [] if tied is None else [tied]

    def points_of_contact(self) -> ContactPoints:
        """All points that obstacles can touch."""
        body = self.body
        return ContactPoints(self.contact_points, body.contact_surfaces, body.nodes, body.points_between)

    def skin(self) -> Skin:
        """The surface of the body, and where it has contact points."""
        body, movable = self.body, np.zeros(self.body.unknowns.components, dtype=bool)
        movable[body.unknowns.moving] = True
        can_move = movable.reshape(-1, 3).any(axis=1)
        return Skin(body.nodes, body.triangles, body.contact_surfaces, can_move, body.surfaces)

    def at_nodes(self, nodes: Array) -> Array:
        """Unit forces on the components of nodes (P,), a column each, (rows here, 3 P); zero on what is held."""
        return self._at_components(components_of(nodes))

    def _at_components(self, components: Array) -> Array:
        Z = self.body.unknowns.matrix[components][:, self.algebra.rows()]
        return np.ascontiguousarray(Z.toarray().T)

    @property
    def elastic_size(self) -> int:
        """Number of displacements that strain: n less the rigid motions."""
        return self.size - self.rigid.shape[1]


def components_of(nodes: Array) -> Array:
    """The displacement components (3 P,) of nodes (P,)."""
    return (3 * nodes[:, None] + np.arange(3)).ravel()


def _names_and_widths(columns: Mapping[str, Array]) -> str:
    """The first few names, each with its number of columns."""
    shown = [f"{name} ({block.shape[1]})" for name, block in islice(columns.items(), NAMES_SHOWN)]
    return ", ".join(shown) + (f" and {len(columns) - NAMES_SHOWN} more" if len(columns) > NAMES_SHOWN else "")
