"""A scene: what is simulated, as a frozen record. No numerics."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fenics_rom.errors import SceneError, unknown
from fenics_rom.scene.schema import Number


@dataclass(frozen=True)
class Material:
    """Isotropic linear elastic material of one cell group (of the whole body where `cells` is None)."""

    young: float  # Pa
    poisson: float
    density: float  # kg/m3
    cells: str | None = None


@dataclass(frozen=True)
class Near:
    """The surface triangles whose centroids lie in a ball."""

    point: tuple[float, float, float]  # m
    radius: float  # m


@dataclass(frozen=True)
class Patch:
    """A piece of the surface and the forces that can act on it: a contact mode or an actuator.

    `force` is "resultant" (3 columns: a force spread uniformly over the patch), "normal" (1 column: a uniform
    pressure along the inward normals, scaled so that 1 N is pressure times area) or "nodal" (3 columns a node).
    """

    surface: str | None
    near: Near | None
    force: str


@dataclass(frozen=True)
class Output:
    """Displacements that are read often: of points, or the mean over a named surface."""

    points: tuple[tuple[float, float, float], ...] | None  # m
    surface: str | None


@dataclass(frozen=True)
class Reduction:
    """How the scene wants to be reduced."""

    method: str | None = None  # "balanced", and "static" without inertia
    switching: str = "energy"
    order: int | Mapping[str, int] | None = None  # one for all contact modes, or by name
    tolerance: float | None = None  # share of the sum of σ that may be left out
    weighting: str = "mass"
    lyapunov: str = "auto"
    share: float = 0.9999999  # of the trace of the covariance, for switching = "modal"
    cubature: float = 0.01  # relative error of the forces of the points that are kept, for large deformation


@dataclass(frozen=True)
class Load:
    """A force on a contact mode or an actuator between two times."""

    contact: str | None
    actuator: str | None
    start: float  # s
    stop: float  # s
    force: tuple[float, ...] | None  # N, constant
    table: str | None  # name of a force table


@dataclass(frozen=True)
class Run:
    """A load history."""

    dt: float  # s
    duration: float  # s
    snapshots: int  # whole shapes kept of it, evenly spread
    loads: tuple[Load, ...]


@dataclass(frozen=True)
class Scene:
    """Everything that was asked for. Numbers are in SI units.

    Example:
        >>> scene = fr.read_scene("plate.toml")
        >>> list(scene.contacts), list(scene.outputs)
        (['tip_left', 'middle'], ['tip'])
    """

    name: str
    mesh_file: Path
    degree: int
    mesh_groups: Mapping[str, int]
    materials: Mapping[str, Material]
    clamped: tuple[str, ...]
    contacts: Mapping[str, Patch]
    actuators: Mapping[str, Patch]
    outputs: Mapping[str, Output]
    effects: Mapping[str, Mapping[str, Any]]  # with their parameters, as in EFFECTS
    reduction: Reduction
    run: Run | None
    text: str
    tables: Mapping[str, np.ndarray]  # force tables: (times, 1 + columns), s and N
    source: str  # for messages


WEIGHTINGS = ("mass", "nodal", "outputs")
LYAPUNOV = ("auto", "closed-form", "bartels-stewart", "krylov", "adi")
METHODS = ("balanced", "modal", "modal+static", "pod", "static", "trained", "modal+derivatives")
SOLVERS = ("auto", "direct", "iterative")
STEPPERS = ("newton", "linearly-implicit")  # of large deformation
ORDER = Number(at_least=1, integer=True)
TOLERANCE = Number(above=0.0, below=1.0)
SHARE = Number(above=0.0, at_most=1.0)
CUBATURE = Number(at_least=1e-6, below=1.0)


def check_order(order: int | Mapping[str, int] | None, contacts: Mapping[str, Any], where: str) -> None:
    """Checks an order, or that orders by name are given for every contact mode and for nothing else.

    Raises:
        SceneError: they are not.
    """
    if order is None:
        return
    if not isinstance(order, Mapping):
        ORDER.check(order, where)
        return
    for name, value in order.items():
        if name not in contacts:
            raise SceneError(f"{where}: {unknown('contact mode', name, contacts)}")
        ORDER.check(value, f"{where}.{name}")
    for name in contacts:
        if name not in order:
            raise SceneError(f"{where}: contact mode {name!r} has no order")
