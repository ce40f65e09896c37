"""The frozen reduced model: what the offline stage hands to the runtime."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.arguments import names_in
from fenics_rom.errors import StepError, StructureError, check_known, shown
from fenics_rom.io.stages import Stage
from fenics_rom.mechanics.body_facts import CellQuality
from fenics_rom.mechanics.contact_points import PointsBetween
from fenics_rom.mechanics.environment import Environment
from fenics_rom.mechanics.signals import real_numbers
from fenics_rom.rom.contact_model import ContactModel, neglected
from fenics_rom.rom.content import ByContent, digest_of
from fenics_rom.rom.linearizer import linearizer

if TYPE_CHECKING:
    from numpy.typing import ArrayLike  # which takes 4 ms to import

    from fenics_rom.mechanics.readings import Reading
    from fenics_rom.rom.deformation import ReducedDeformation
    from fenics_rom.rom.error_model import ErrorModel
    from fenics_rom.rom.moving_frame import MovingFrame
    from fenics_rom.rom.residual_compliance import ResidualCompliance
    from fenics_rom.rom.state_space import StateSpace


@dataclass(frozen=True)
class ForceValidation:
    """How far contact forces are off in the beginning of the scene's run, by obstacle, relative.

    Three numbers each: of the force over that time (2-norm of its means over steps), of its peak, and of the impulse.

    Attributes:
        dt, duration: of the run, from rest, s.
        reduction: against the full order at the same step; empty where nothing was touched in that time.
        time_step: of the full order against itself at half the step; empty where an earlier release measured that of
            the reduced model.
    """

    dt: float
    duration: float
    reduction: Mapping[str, tuple[float, float, float]]
    time_step: Mapping[str, tuple[float, float, float]]


@dataclass(frozen=True, eq=False)
class Rom(ByContent):
    """Reduced models of all contact modes of one body, in one shared basis.

    Its arrays are read-only; ROMs that hold the same are equal, and have one hash.

    Attributes:
        name: of the scene.
        switching: "energy" (any basis, energy-orthogonal) or "oblique".
        contact_models: of each contact mode.
        actuators: number of input columns of each actuator.
        basis: Q (n, k), QᵀMQ = I, on the components that can move, kg^-1/2.
        stiffness: κ (k,) with QᵀKQ = diag(κ), 1/s²; 0 for rigid motions, which come first.
        outputs: C Q of each named output, (3 points, k).
        readings: what else is read by name, with operators on the shared basis.
        free: (n,) which of the 3 N displacement components are free.
        nodes: (N, 3), m.
        triangles: (F, 3) outward surface triangles.
        node_mass: (N,), kg.
        environment: what acts in the runs of the scene that it was made for.
        contact_surfaces: nodes (any,) of the surface of each contact mode; none of a model without a mesh.
        points_between: that obstacles can touch beside nodes; None where none passed between these.
        scene_text: the scene file it was made from, for people.
        warnings: what the user should know about this model.
        weighting: of the shape in the Hankel singular values: "mass", "nodal" or "outputs".
        method: how the bases were found.
        stages: what the offline work spent its time on.
        loads: number of input columns of each load that acts by a history of its own.
        deformation: what large deformation adds; then all contact modes have the same basis. None: the model is linear.
        cells: of the mesh, how many there are, and how good; None where nobody knows.
        force_validation: how far contact forces are off; None where it was not measured.
        residual_compliance: what the contact points yield beyond the shared basis; None where that is not known.
        springs: what of the stiffness QᵀKQ is springs to the ground, which do not relax (k, k), 1/s²; None: nothing.
        moving_frame: of the shared basis' vectors that strain; None: the body turns but a little.
        surfaces: nodes (any,) of surfaces that have names, where there is contact.
        error_model: what runs need to know their errors; None where that was not asked for.

    Example:
        >>> rom = fr.read_rom("plate.h5")
        >>> rom.contact_models["middle"].order, rom.contacts
        (20, {'tip_left': 3, 'middle': 3})
    """

    name: str
    switching: str
    contact_models: Mapping[str, ContactModel]
    actuators: Mapping[str, int]
    basis: Array
    stiffness: Array
    outputs: Mapping[str, Array]
    free: Array
    nodes: Array
    triangles: Array
    node_mass: Array
    environment: Environment = field(default_factory=Environment)
    contact_surfaces: Mapping[str, Array] = field(default_factory=dict)
    points_between: PointsBetween | None = None
    scene_text: str = ""
    warnings: tuple[str, ...] = ()
    weighting: str = "mass"
    method: str = "balanced"
    stages: tuple[Stage, ...] = ()
    loads: Mapping[str, int] = field(default_factory=dict)
    deformation: "ReducedDeformation | None" = None
    readings: Mapping[str, "Reading"] = field(default_factory=dict)
    cells: CellQuality | None = None
    force_validation: ForceValidation | None = None
    residual_compliance: "ResidualCompliance | None" = None
    moving_frame: "MovingFrame | None" = None
    springs: Array | None = None
    surfaces: Mapping[str, Array] = field(default_factory=dict)
    error_model: "ErrorModel | None" = None

    def __repr__(self) -> str:
        models, columns = self.contact_models, self.contacts
        orders = (f"{name} (order {models[name].order}, {columns[name]} inputs)" for name in models)
        nodes = f" of {len(self.nodes)} nodes" if len(self.nodes) else ""
        actuators = [f"{name} in {self.environment.input_units.get(name, 'N')}" for name in self.actuators]
        others = {"actuators": actuators, "effects": self.environment.effects, "outputs": self.outputs}
        others |= {"readings": self.readings}
        return (
            f"Rom {self.name!r}: {self.method}, {self.switching} switching, {len(self.free)} displacements{nodes}\n"
            f"  contact modes: {', '.join(orders)}; inputs in N\n"
            f"  {'; '.join(f'{kind}: ' + ', '.join(names) for kind, names in others.items() if names)}"
        ).rstrip()

    @cached_property
    def identity(self) -> str:
        """Equal of ROMs that take the same steps, and of no others: a digest of all that these take from a ROM."""
        names = (
            "contact_models",
            "actuators",
            "loads",
            "deformation",
            "residual_compliance",
            "moving_frame",
            "springs",
        )
        return digest_of({name: getattr(self, name) for name in (*names, "switching")}).hex()

    def relaxing_share(self, contact: str) -> Array | None:
        """What of a contact mode's stiffness its material has, in energy coordinates ω q (m, m); None: all of it."""
        if self.springs is None:
            return None
        model = self.contact_models[contact]
        C = model.coordinates / model.safe_frequencies
        share: Array = np.eye(model.order) - C.T @ self.springs @ C
        return share

    @property
    def contacts(self) -> dict[str, int]:
        """Number of contact columns of each contact mode, actuators and loads not counted."""
        shared = sum(self.actuators.values()) + sum(self.loads.values())
        return {name: mode.inputs.shape[1] - shared for name, mode in self.contact_models.items()}

    def input_columns(self, contact: str) -> dict[str, int]:
        """Number of columns of each input of a contact mode: its own, the actuators', the loads'.

        The contact mode's are called contact-NAME, where an actuator or a load has its name. One that is made of others
        has theirs.
        """
        shared, columns = {**self.actuators, **self.loads}, self.contacts
        parts = self.environment.together.get(contact, (contact,))
        return {f"contact-{name}" if name in shared else name: columns[name] for name in parts} | shared

    def state_space(
        self,
        contact: str,
        outputs: Sequence[str] | None = None,
        dt: float | None = None,
        *,
        at: Any = None,
        u: "ArrayLike | None" = None,
    ) -> "StateSpace":
        """The linear model of a contact mode, for `control.ss(*plant, plant.dt)`, `scipy.signal.dlti(*plant, dt=dt)`.

        Bodies of small strains in a fixed frame on which only inputs and loads act are linear, also where their
        material relaxes or they have no inertia: of these it is exact everywhere. All others (contact, large
        deformation, moving frames, strokes, friction of tendons) are linearised about a state: what the step of a
        Simulator is nearby. Contact pairs then stay open, stick or slip as they do in the step from that state, as do
        guides of tendons; a free body's frame is among the states, a base that carries it stays given.

        Args:
            contact: the contact mode.
            outputs: names of outputs, displacements in m, and of readings that are linear: lengths and volumes, as
                what they are more than at rest, strains and markers; None: all outputs.
            dt: None for continuous time; else, s, the map of a step, the same as the simulator's. Linearised bodies
                have a step only; None is that of the state.
            at: the state: a Simulator, what its `save` gave, or a run of this ROM (its last shape); None: of a body
                that is not linear rest at the start, which is warned of.
            u: inputs (p,) without loads in the step from there, N; None: 0, and strokes as they are.

        Raises:
            StepError: there is no such contact mode or output, a reading is not linear, dt is not a positive finite
                number, or none where one is needed; or the state is none of this ROM, or has no step.
        """
        from fenics_rom.rom.linear_readings import ReadRows, reading_rows
        from fenics_rom.rom.midpoint_map import checked_dt
        from fenics_rom.rom.state_space import state_space

        check_known("contact mode", contact, self.contact_models, StepError)
        model, read = self.contact_models[contact], dict[str, ReadRows]()
        names = list(self.outputs if outputs is None else names_in("outputs", outputs, StepError))
        for name in names:
            check_known("output", name, [*self.outputs, *self.readings], StepError)
        h = None if dt is None else checked_dt(dt)
        if self.nonlinear_parts:
            plant: StateSpace = linearizer().linearized(self, contact, names, h, at, u)
            return plant
        for name in names:
            if name in self.readings:
                read[name] = reading_rows(name, self.readings[name], model, self.input_columns(contact))
            else:
                rows = self.outputs[name] @ model.coordinates
                read[name] = ReadRows(self.by_point(rows.T).shape[1:], rows, "m")
        columns = self.input_columns(contact).items()
        units, acting = self.environment.input_units, self.environment
        inputs = {name: (count, units.get(name, "N")) for name, count in columns}
        series = acting.viscoelasticity if acting.has_inertia else None  # equilibria are relaxed
        return state_space(model, h, inputs, read, series, acting.has_inertia)

    def switch_map(self, start: str, end: str) -> Array:
        """The map (s_end, s_start) of a state as in `state_space` from one contact mode to another.

        Raises:
            StepError: there is no such contact mode.
            StructureError: what the body does is not linear.
        """
        from fenics_rom.rom.switch_maps import switch_map

        for name in (start, end):
            check_known("contact mode", name, self.contact_models, StepError)
        if self.nonlinear_parts:
            raise StructureError(
                f"ROM {self.name!r} has {self.nonlinear_parts[0]}: its state spaces are linearised about a state of "
                "one contact mode each, which no map carries to another's"
            )
        acting, models = self.environment, (self.contact_models[start], self.contact_models[end])
        branches = 0 if acting.viscoelasticity is None else len(acting.viscoelasticity.times)
        return switch_map(self.stiffness, *models, self.switching, branches, acting.has_inertia)

    @property
    def nonlinear_parts(self) -> tuple[str, ...]:
        """What makes a body more than a linear map of its state and forces; none of one that is linear."""
        acting = self.environment
        parts = {
            "large deformation": self.deformation is not None,
            "a moving frame": acting.is_moving,
            "contact with obstacles": acting.contact_law is not None,
            "actuators that are given strokes": len(acting.controls) > len(acting.bars),
            "surfaces that are rigid": bool(acting.bars),
            "friction of tendons": bool(acting.guides),
        }
        return tuple(part for part, there in parts.items() if there)

    @property
    def rigid(self) -> int:
        """Number ρ of rigid motions, the first vectors of the shared basis and of all contact modes."""
        return int(np.count_nonzero(self.stiffness == 0))

    @property
    def first_frequency(self) -> float:
        """The lowest at which the body oscillates in the shared basis, Hz: at or above that of the full model."""
        return math.sqrt(self.stiffness[self.stiffness > 0].min()) / math.tau

    def by_point(self, rows: Array) -> Array:
        """Displacements of an output, (..., 3 points), by point, (..., points, 3); without a mesh as they are."""
        return rows.reshape(*rows.shape[:-1], rows.shape[-1] // 3, 3) if len(self.nodes) else rows

    def rows_of(self, nodes: Array) -> Array:
        """Displacements of nodes (any shape) in the shared basis, (..., 3, k); of components that are held 0."""
        row = np.full(3 * len(self.nodes), -1)
        row[self.free] = np.arange(len(self.free))
        row = row[3 * np.asarray(nodes)[..., None] + np.arange(3)]
        rows = self.basis[row]
        rows[row < 0] = 0.0
        return rows

    def reconstruct(self, coordinates: Array) -> Array:
        """The field of coordinates (k,) in the shared basis, on all nodes (N, 3); without a mesh (n,).

        Raises:
            StepError: coordinates are no k real numbers.
        """
        try:
            free = self.basis @ real_numbers(coordinates).reshape(self.stiffness.shape)
        except (TypeError, ValueError):
            k = len(self.stiffness)
            raise StepError(f"coordinates = {shown(coordinates)}: use {k} real numbers") from None
        if not len(self.nodes):
            return free
        field = np.zeros(3 * len(self.nodes))
        field[self.free] = free
        return field.reshape(-1, 3)

    @property
    def validation(self) -> dict[str, dict[str, float | None]]:
        """What is known of each contact mode's error; None where it is not.

        `static_error`, `transfer_error` (the largest sampled one) and `neglected`, the share of the σ left out, are of
        small motions; with large deformation `validation_error` is of a run that the model was not trained on.
        """
        large = {} if self.deformation is None else {"validation_error": self.deformation.validation_error}
        return {
            name: {
                "static_error": mode.static_error,
                "transfer_error": float(mode.transfer_errors.max()) if len(mode.transfer_errors) else None,
                "neglected": neglected(mode),
                **large,
            }
            for name, mode in self.contact_models.items()
        }


def diagonalized_span(κ: Array, span: Array) -> tuple[Array, Array]:
    """γ (m,), ascending, and C (k, m) with the span of given orthonormal columns, CᵀC = I and CᵀκC = diag(γ).

    The singular values of √κ C are √γ: accurate where an eigenproblem of CᵀκC would lose half the digits. Round-off is
    a share of the largest, so what is far softer, like a body on a weak spring, is looked at again without the stiffer.
    Where κ (k,) begins with zeros, the span holds the rigid motions that they are of, which become unit vectors.
    """
    m, rigid = span.shape[1], np.count_nonzero(κ == 0)
    root, rest, end = np.sqrt(κ)[:, None], span, m
    γ, C = np.zeros(m), np.eye(len(span), m)
    while end > rigid:
        _, ω, rotation = np.linalg.svd(root * rest, full_matrices=False)
        rest = (rest @ rotation.T)[:, : end - rigid]  # at first without the rigid motions, which come last
        rest[:rigid] = 0.0
        count = np.count_nonzero(ω[: end - rigid] >= SOFTER * ω[0])
        start = end - count
        γ[start:end], C[:, start:end] = ω[:count][::-1] ** 2, rest[:, :count][:, ::-1]
        kept, rest, end = C[:, start:end], rest[:, count:], start
        rest = rest - kept @ ((κ[:, None] * kept / γ[start : start + count]).T @ rest)
    return γ, C * np.where(C[np.abs(C).argmax(axis=0), np.arange(m)] < 0, -1.0, 1.0)


SOFTER = 1e-3  # share of the largest √γ, below which its round-off would leave less than 13 digits
ORTHONORMALITY = 1e-10  # largest accepted |CᵀC - I|, relative |CᵀκC - diag(γ)|, and |RᵀR - I| of the directions R


def check_rom(rom: Rom) -> Rom:
    """Measures the structure that passivity rests on, and returns the ROM.

    Raises:
        StructureError: with the measured number.
    """
    rigid = rom.rigid
    if rigid == len(rom.stiffness) or rom.stiffness[:rigid].any() or not (rom.stiffness[rigid:] > 0).all():
        raise StructureError(f"shared stiffness is not positive definite: least κ = {rom.stiffness.min():g}")
    with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is refused like any other gap
        for name, mode in rom.contact_models.items():
            _check_mode(f"contact mode {name!r}", rom.stiffness, mode, rigid)
            if rom.deformation is not None and not np.array_equal(mode.coordinates, np.eye(len(rom.stiffness))):
                raise StructureError(f"contact mode {name!r}: has not the one basis that large deformation takes")
        if rom.deformation is not None:
            from fenics_rom.rom.deformation import check_deformation  # here, as few bodies deform largely

            check_deformation(rom.deformation, len(rom.stiffness) - rigid, rom.actuators, rom.environment.bars)
        if rom.moving_frame is not None:
            from fenics_rom.rom.moving_frame import check_moving_frame

            check_moving_frame(rom.moving_frame, len(rom.stiffness) - rigid)
    return rom


def _check_mode(where: str, κ: Array, mode: ContactModel, rigid: int) -> None:
    if not (mode.eigenvalues[rigid:] > 0).all():
        raise StructureError(f"{where}: least eigenvalue {mode.eigenvalues[rigid:].min():g} is not positive")
    C = mode.coordinates
    if mode.eigenvalues[:rigid].any() or C[:rigid, rigid:].any() or (C[:, :rigid] != np.eye(len(C))[:, :rigid]).any():
        raise StructureError(f"{where}: does not begin with the {rigid} rigid motions of the shared basis")
    D = mode.damping
    if D.ndim == 2 and not np.array_equal(D, D.T):
        raise StructureError(f"{where}: damping is not symmetric")
    largest = np.abs(D).max()
    least = D.min() if D.ndim == 1 else largest * np.linalg.eigvalsh(D / (largest or 1.0))[0]  # else it may overflow
    if not least >= -1e-12 * largest:
        raise StructureError(f"{where}: damping is not positive semi-definite, least {least:g}")
    strained = (np.sqrt(κ)[:, None] * C / mode.safe_frequencies)[:, rigid:]
    for what, columns in (
        ("coordinates are not orthonormal in mass", mode.coordinates),
        ("coordinates are not orthonormal in stiffness", strained),
        ("directions are not orthonormal", mode.directions),
    ):
        gap = np.abs(columns.T @ columns - np.eye(columns.shape[1])).max()
        if not gap <= ORTHONORMALITY:
            raise StructureError(f"{where}: {what}: off by {gap:.1e}, at most {ORTHONORMALITY:g} is good")
