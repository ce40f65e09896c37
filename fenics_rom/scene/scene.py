"""A scene: what is simulated, as a frozen record. No numerics."""

import hashlib
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np

from fenics_rom.errors import SceneError, check_known
from fenics_rom.mechanics.environment import SWITCHINGS, Environment, Run
from fenics_rom.mechanics.readings import READING_UNITS
from fenics_rom.mechanics.touch import TOUCH
from fenics_rom.scene.effects import Effects
from fenics_rom.scene.environment import as_text, environment_of
from fenics_rom.scene.fibres import FibreMaterial
from fenics_rom.scene.outputs import Output, OutputEntry
from fenics_rom.scene.places import PIECES, CellPlace, Held, Patch, Place, given_piece, only_name
from fenics_rom.scene.values import Items, Number, OneOrByName, Point, Text

WEIGHTINGS = ("mass", "nodal", "outputs")
LYAPUNOV = ("auto", "closed-form", "bartels-stewart", "krylov", "adi")
METHODS = (
    *("balanced", "eigenvector-selection", "modal", "modal+static", "pod", "static"),
    *("trained", "modal+derivatives"),  # of large deformation
)
INTEGRATIONS = ("full", "selective")
SOLVERS = ("auto", "direct", "iterative")
ORDER = Number(at_least=1, integer=True)
TOLERANCE = Number(above=0.0, below=1.0)
SHARE = Number(above=0.0, at_most=1.0)
CUBATURE = Number(at_least=1e-6, below=1.0)


@dataclass(frozen=True)
class Elasticity:
    """Isotropic linear elastic material, and fibres in it."""

    young: Annotated[float, Number(above=0.0, unit="Pa"), "Young's modulus"]
    poisson: Annotated[float, Number(above=-1.0, below=0.5), "Poisson's ratio"]
    density: Annotated[float, Number(above=0.0, unit="kg/m3"), "mass per volume at rest"]
    expansion: Annotated[
        float | None, Number(unit="1/K"), "strain per kelvin, with effects.temperature; unless given it has none"
    ] = None
    fibres: Annotated[FibreMaterial | None, "what it is reinforced by"] = None


@dataclass(frozen=True)
class Material(CellPlace, Elasticity):
    """Isotropic linear elastic material of some cells."""


@dataclass(frozen=True, kw_only=True)
class ReadingEntry(Place):
    """What is read beside outputs, at every instant that a run keeps; strain and stress of a place, or everywhere."""

    ONE_OF = ()
    AT_MOST_ONE: ClassVar = ("of", *PIECES)
    quantity: Annotated[
        str,
        Text(choices=tuple(name for name in READING_UNITS if name != TOUCH)),
        '"length" of a tendon, "volume" of a chamber, "contact_pressure" at the nodes of a contact mode, "strain" '
        '(xx, yy, zz, yz, xz, xy), "surface_stress" (the same six), "von_mises_stress", "principal_stress" (three, '
        'from the largest on), "pressure" or "energy_density" (by volume at rest) in the middle of each surface '
        'triangle (at degree 2 of each of its four parts), in the cell that adjoins it; "stress" at points: xx, yy, '
        "zz, yz, xz, xy, three principal ones from the largest on, von Mises stress, and how far the cells around "
        "differ; with large deformation Green's strain, and Cauchy's stress; stress is elastic: what damping, and "
        'branches of a material that relaxes, add is not in it; displacement of a "marker" off the surface, rigidly '
        'on the triangle that is nearest, however far that turns; or "reaction" of the supports that hold nodes of '
        "the place, or of all: force and couple on the body, in the mean over the last step",
    ]
    of: Annotated[
        str | None,
        Text(),
        "the tendon, the pressure or the contact mode; of strain and stress a named surface, as `surface` is",
    ] = None
    point: Annotated[
        Point | None,
        "of a marker: where its middle is at rest; of a reaction: about which its couple is, unless about the mean "
        "place of the nodes",
    ] = None
    points: Annotated[tuple[Point, ...] | None, Items(at_least=1), "of stress: material points of the body"] = None

    @property
    def place(self) -> Place | None:
        """Of strain, stress and reactions: the piece that is meant; None: all of it."""
        if given_piece(self) is not None:
            return self
        return None if self.of is None else Place(self.of)


@dataclass(frozen=True)
class Reduction:
    """How the scene wants to be reduced."""

    AT_MOST_ONE: ClassVar = ("order", "tolerance")
    method: Annotated[
        str | None,
        Text(choices=METHODS),
        'as `fr.reduce` takes it; where none is named, "balanced", without inertia "static", with large deformation '
        '"trained", of more than 33 contact points without an order or a tolerance "modal+static"',
    ] = None
    switching: Annotated[
        str,
        Text(choices=SWITCHINGS),
        'how a state is carried to another contact mode: "energy" (energy-orthogonal projection) or "oblique" (standard'
        " balanced truncation, which can create energy: for comparison only)",
    ] = "energy"
    order: Annotated[
        int | Mapping[str, int] | None,
        OneOrByName(ORDER),
        "number of reduced displacements, one for all contact modes or a table with one for each; instead of tolerance",
    ] = None
    tolerance: Annotated[float | None, TOLERANCE, "share of the sum of σ that may be left out"] = None
    weighting: Annotated[
        str, Text(choices=WEIGHTINGS), "what of the shape counts: the L² norm, all nodes alike, or the named outputs"
    ] = "mass"
    lyapunov: Annotated[str, Text(choices=LYAPUNOV), "route to the Gramians"] = "auto"
    share: Annotated[float, SHARE, 'of the trace of the covariance, for method = "eigenvector-selection"'] = 0.9999999
    cubature: Annotated[
        float, CUBATURE, "relative error of the forces of the points that are kept, for large deformation"
    ] = 0.01


@dataclass(frozen=True)
class Scene:
    """Everything that was asked for. Numbers are in SI units.

    Attributes:
        integration: of changes of volume, "full" or "selective": in the middle of cells.
        frame: "fixed", or "moving": the body turns as far as it likes.
        clamped: places that do not move.
        held: places that do not move, or do not move along a normal.
        rigid: surfaces that move as rigid bodies do.
        outputs: displacements that are read by name.
        readings: what else is, a sense of touch among them (`scene.outputs.OutputEntry`).
        text: of the file.
        tables: by the names of their files: time in s and what it is a signal of, (times, 1 + columns).
        source: for messages.
        read_files: the file of the scene itself, and those of tables and of a run, which it was read from.
        bars: names of those that keep surfaces rigid which turn far; its mesh has them, once it is assembled.
        chambers: volumes at rest behind pressures that enclose one, m³, by name; likewise, None until then.

    Example:
        >>> scene = fr.read_scene("plate.toml")
        >>> list(scene.contacts), list(scene.outputs)
        (['tip_left', 'middle'], ['tip'])
    """

    name: str
    mesh_file: Path
    degree: int
    integration: str
    mesh_groups: Mapping[str, int]
    mesh_scale: float
    materials: Mapping[str, Material]
    frame: str
    clamped: tuple[Place, ...]
    held: tuple[Held, ...]
    rigid: tuple[Place, ...]
    contacts: Mapping[str, Patch]
    actuators: Mapping[str, Patch]
    outputs: Mapping[str, Output]
    readings: Mapping[str, ReadingEntry | OutputEntry]
    effects: Effects
    reduction: Reduction
    run: Run | None
    text: str
    tables: Mapping[str, np.ndarray]
    source: str
    read_files: tuple[Path, ...] = ()
    bars: tuple[str, ...] = ()
    chambers: Mapping[str, float] | None = None

    @property
    def files(self) -> tuple[Path, ...]:
        """All files that it is read from, with its mesh, and what an XDMF file of that has its arrays in."""
        return (*self.read_files, self.mesh_file, *_array_files(self.mesh_file))

    @cached_property
    def environment(self) -> Environment:
        """What acts on the body in a run, and what a model of it has built in, which runs cannot change."""
        environment = environment_of(self.effects, self.frame, self.run, self.source)
        records: dict[str, Any] = {f"materials.{name}": material for name, material in self.materials.items()}
        records |= {f"readings.{name}": entry for name, entry in self.read["readings"].items()}
        records |= {"contacts": self.contacts, "actuators": self.actuators, "outputs": self.read["outputs"]}
        clamped, rigid = (sorted(map(only_name, places), key=as_text) for places in (self.clamped, self.rigid))
        records["supports"] = {"clamped": clamped, "held": self.held} | ({"rigid": rigid} if rigid else {})
        built_in = {place: as_text(record) for place, record in records.items()}
        built_in["mesh"] = as_text(self._mesh)
        environment = replace(environment, built_in={**environment.built_in, **built_in}).with_bars(self.bars)
        return environment if self.chambers is None else environment.with_chambers(self.chambers)

    @property
    def read(self) -> dict[str, dict[str, Any]]:
        """Outputs and readings by name, where the file has them: a sense of touch is an output there."""
        touch = {name: entry for name, entry in self.readings.items() if entry.quantity == TOUCH}
        others = {name: entry for name, entry in self.readings.items() if name not in touch}
        return {"outputs": {**self.outputs, **touch}, "readings": others}

    @property
    def _mesh(self) -> dict[str, Any]:
        """What a model has built in of the mesh; its content is None where it is not there."""
        content = None
        with suppress(OSError), self.mesh_file.open("rb") as stream:
            content = hashlib.file_digest(stream, "sha256").hexdigest()
        of_file: dict[str, Any] = {"degree": self.degree, "groups": self.mesh_groups, "scale": self.mesh_scale}
        if self.integration != "full":
            of_file["integration"] = self.integration
        return {"file": self.mesh_file.name, "content": content} | of_file

    def __repr__(self) -> str:
        named = {"contact modes": self.contacts, "actuators": self.actuators, "outputs": self.outputs}
        named |= {"readings": self.readings}
        run = "no run" if self.run is None else f"run of {self.run.duration:g} s at dt {self.run.dt:g} s"
        return "\n  ".join(
            [
                f"Scene {self.name!r} of {self.source}: {self.mesh_file.name} in degree {self.degree}",
                "; ".join(f"{kind} {', '.join(names)}" for kind, names in named.items() if names),
                f"effects {', '.join(self.effects.names) or 'none'}; {run}",
            ]
        )


def _array_files(mesh_file: Path) -> set[Path]:
    """Files that an XDMF file names as those of its arrays."""
    if mesh_file.suffix.lower() != ".xdmf":
        return set()
    with suppress(OSError):
        text = mesh_file.read_text(errors="replace")
        return {mesh_file.parent / name for name in re.findall(r">\s*([^<>:]+):/", text)}
    return set()


def check_order(order: int | Mapping[str, int] | None, contacts: Mapping[str, Any], where: str) -> None:
    """Checks an order, or orders by name, which are for every contact mode and for nothing else; else SceneError."""
    if order is None:
        return
    if not isinstance(order, Mapping):
        ORDER.check(order, where)
        return
    for name, value in order.items():
        check_known("contact mode", name, contacts, SceneError, f"{where}: ")
        ORDER.check(value, f"{where}.{name}")
    for name in contacts:
        if name not in order:
            raise SceneError(f"{where}: contact mode {name!r} has no order")
