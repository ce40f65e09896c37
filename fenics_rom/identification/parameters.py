"""What can be identified in a scene, each parameter in a coordinate q that suits a fit and is 0 at the start.

The values that a model depends on are one array θ (m + 1, 7 + c): a row for each material (E, ν, ρ, α, β), and one for
what is of no material, of which β counts (of springs to ground), α (of masses fixed to the body), in two more columns
the angles by which gravity is tilted, and in c more by how much the clock of each file of a motion is late.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import SceneError, unknown
from fenics_rom.identification.tilt import tilt_axes, tilted
from fenics_rom.scene.effects import Gravity, RayleighDamping
from fenics_rom.scene.places import given_piece
from fenics_rom.scene.scene import Scene

YOUNG, POISSON, DENSITY, ALPHA, BETA = range(5)  # columns of θ
TILTS = [5, 6]  # and these in the last row
FIRST_CLOCK = 7  # and those behind it
NAMES = ("young", "poisson", "density", "alpha", "beta")
UNITS = ("Pa", "1", "kg/m3", "1/s", "s", "deg", "deg", "s")
LOWEST_POISSON, HIGHEST_POISSON = -1.0, 0.5
HELD_STEP = 0.01  # of a value (of Poisson's ratio as such), to see what rests on it where it is held
CLOCK, TILT = "clock", "tilt"  # name all of them
TILT_SPAN = 30.0  # degrees
MIN_DAMPING_SHARE = 1e-6  # share of its start value that damping keeps


@dataclass(frozen=True)
class Parameter:
    """One number of the scene.

    E and ρ are sought as ln(E / E_start), so that they stay positive; ν as a logit that keeps it between -1 and 0.5;
    α and β, which may well be next to 0, as (α - α_start) / α_start > -1; how late a clock is, and a tilt, as a share
    of `span`.
    """

    name: str  # as in the scene, after the material's where there are several
    column: int  # of θ
    rows: tuple[int, ...]  # of θ, which hold it
    start: float  # its value in the scene
    path: tuple[str, ...]  # keys that lead to it in the scene file; none of clocks and tilts
    span: float = 0.0  # of what starts at 0: about what it may be, of a clock s, of a tilt degrees

    @property
    def unit(self) -> str:
        """Of its value."""
        return UNITS[min(self.column, FIRST_CLOCK)]

    @property
    def proportional(self) -> bool:
        """Whether q is a logarithm, so that steps of q are ratios of the value."""
        return self.column in (YOUNG, DENSITY)

    @property
    def lowest(self) -> float:
        """Least allowed q: some damping is left, without which there are no Gramians."""
        return MIN_DAMPING_SHARE - 1.0 if self.column in (ALPHA, BETA) else -np.inf

    @property
    def step(self) -> float:
        """What its start value is changed by to see what rests on it."""
        return HELD_STEP * (1.0 if self.column == POISSON else self.span or self.start)

    def value(self, q: float) -> float:
        """The parameter at q."""
        if self.proportional:
            return float(self.start * np.exp(q))
        if self.column == POISSON:
            share = 1 / (1 + (1 / _share(self.start) - 1) * np.exp(-q))
            return float(LOWEST_POISSON + (HIGHEST_POISSON - LOWEST_POISSON) * share)
        return float(self.start + q * (self.span or self.start))

    def slope(self, q: float) -> float:
        """Derivative of the value with respect to q."""
        if self.proportional:
            return self.value(q)
        if self.column == POISSON:
            share = _share(self.value(q))
            return (HIGHEST_POISSON - LOWEST_POISSON) * share * (1 - share)
        return self.span or self.start


def _share(poisson: float) -> float:
    """How far ν is from its least to its largest value."""
    return (poisson - LOWEST_POISSON) / (HIGHEST_POISSON - LOWEST_POISSON)


def values_of(scene: Scene, clocks: int = 0) -> Array:
    """θ (m + 1, 7 + clocks) of a scene; 0 where it has no damping, and of tilts and clocks."""
    rows, shared = [], scene.effects.damped
    for name, m in scene.materials.items():
        rayleigh = shared.materials.get(name, shared)
        rows.append((m.young, m.poisson, m.density, rayleigh.alpha, rayleigh.beta))
    α = 0.0 if shared.materials else shared.alpha  # as `assemble` has it of masses fixed to the body
    θ = np.array([*rows, (0.0, 0.0, 0.0, α, shared.beta)])
    return np.hstack([θ, np.zeros((len(θ), FIRST_CLOCK - θ.shape[1] + clocks))])


def parameters_of(scene: Scene) -> dict[str, Parameter]:
    """All that a scene gives a value to, by name; damping that it says is 0 is not looked for."""
    θ, found = values_of(scene), []
    for row, (material, m) in enumerate(scene.materials.items()):
        prefix, path = ("", ("material",)) if given_piece(m) is None else (f"{material}.", ("materials", material))
        for column, key in enumerate(NAMES[:ALPHA]):
            found.append(Parameter(prefix + key, column, (row,), float(θ[row, column]), (*path, key)))
    if (damping := scene.effects.damping) is not None:
        shared = tuple(row for row, name in enumerate(scene.materials) if name not in damping.materials)
        for column, key in ((ALPHA, "alpha"), (BETA, "beta")):
            rows = (*shared, len(scene.materials)) if column == BETA or not damping.materials else shared
            if (start := getattr(damping, key)) > 0:
                found.append(Parameter(key, column, rows, start, ("effects", "damping", key)))
            for row, name in enumerate(scene.materials):
                if name in damping.materials and θ[row, column] > 0:
                    own = ("effects", "damping", "materials", name, key)
                    found.append(Parameter(f"{name}.{key}", column, (row,), float(θ[row, column]), own))
    return {parameter.name: parameter for parameter in found}


def select_parameters(
    scene: Scene, names: Sequence[str] | None, *, moving: bool, clocks: Sequence[tuple[str, float]] = ()
) -> tuple[Parameter, ...]:
    """The parameters that are to be identified; without names all that data of this kind can depend on.

    Without a motion that is neither damping nor, but for gravity, density. Clocks, by name and what
    each may well be late by, s, are sought where "clock" is among the names, and gravity's tilt about two axes where
    "tilt" is, or "tilt.x".

    Raises:
        SceneError: a name that does not exist, or is given twice, or none.
    """
    available = parameters_of(scene)
    if names is None:
        seen = range(5) if moving else [YOUNG, POISSON, *([DENSITY] if scene.effects.gravity is not None else [])]
        return tuple(parameter for parameter in available.values() if parameter.column in seen)
    late = [
        Parameter(f"clock of {file}", FIRST_CLOCK + k, (len(scene.materials),), 0.0, (), span)
        for k, (file, span) in enumerate(clocks)
    ]
    axes = [] if scene.effects.gravity is None else tilt_axes(np.array(scene.effects.gravity.acceleration))
    tilts = [
        Parameter(f"{TILT}.{'xyz'[axis]}", column, (len(scene.materials),), 0.0, (), TILT_SPAN)
        for axis, column in zip(axes, TILTS, strict=False)
    ]
    choices = {name: [parameter] for name, parameter in available.items()} | {one.name: [one] for one in tilts}
    choices |= {name: group for name, group in ((CLOCK, late), (TILT, tilts)) if group}
    for name in names:
        if name not in choices:
            raise SceneError(
                f"{scene.source}: {unknown('parameter', name, choices)} (damping that is to be identified needs a "
                "start value above 0 in effects.damping, tilt needs effects.gravity)"
            )
    chosen = tuple(chain.from_iterable(choices[name] for name in names))
    if not chosen or len(set(chosen)) < len(chosen):
        raise SceneError(f"parameters = {', '.join(names) or 'none'}: use each name once, and at least one")
    return chosen


def is_tilting(parameters: Sequence[Parameter]) -> bool:
    """Whether gravity's direction is among them."""
    return any(parameter.column in TILTS for parameter in parameters)


def values_at(start: Array, parameters: Sequence[Parameter], q: Array) -> Array:
    """θ at coordinates q (p,) of the parameters; the others are as in `start`."""
    θ = start.copy()
    for parameter, coordinate in zip(parameters, q, strict=True):
        θ[list(parameter.rows), parameter.column] = parameter.value(coordinate)
    return θ


def directions_at(start: Array, parameters: Sequence[Parameter], q: Array) -> list[Array]:
    """dθ/dq of each parameter, as θ each."""
    directions = []
    for parameter, coordinate in zip(parameters, q, strict=True):
        dθ = np.zeros_like(start)
        dθ[list(parameter.rows), parameter.column] = parameter.slope(coordinate)
        directions.append(dθ)
    return directions


def scene_with(scene: Scene, θ: Array) -> Scene:
    """The scene with other values, its gravity tilted; its text stays."""
    materials = {
        name: replace(m, young=row[YOUNG], poisson=row[POISSON], density=row[DENSITY])
        for (name, m), row in zip(scene.materials.items(), θ.tolist(), strict=False)
    }
    damping = scene.effects.damping
    if damping is not None:
        row_of = dict(zip(scene.materials, θ.tolist(), strict=False))
        shared = [row for name, row in row_of.items() if name not in damping.materials]
        damping = replace(
            damping,
            alpha=shared[0][ALPHA] if shared else damping.alpha,
            beta=float(θ[-1, BETA]),
            materials={
                name: RayleighDamping(row_of[name][ALPHA], row_of[name][BETA]) if name in row_of else rayleigh
                for name, rayleigh in damping.materials.items()
            },
        )
    gravity = scene.effects.gravity
    if gravity is not None and θ[-1, TILTS].any():
        gravity = Gravity(tuple(tilted(np.array(gravity.acceleration), θ[-1, TILTS]).tolist()))
    effects = replace(scene.effects, damping=damping, gravity=gravity)
    return replace(scene, materials=materials, effects=effects)
