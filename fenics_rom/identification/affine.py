"""How M, D, K and the inputs depend on the values θ of a scene, exactly.

With the moduli λ, μ of each material, M = Σ ρ_i M_i + M_f of what is fixed to the body, K = Σ (λ_i Λ_i + μ_i G_i) + K_s
of springs to ground, and D = Σ (α_i ρ_i M_i + β_i (λ_i Λ_i + μ_i G_i)) + α M_f + β_s K_s + D_d of dashpots. Gravity and
base motions push with inputs Σ ρ_i B_i, and those of M_f; gravity is turned by its tilt. The parts are differences of
what `assemble` makes of the scene at a few simple values.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.fem.assemble import assemble
from fenics_rom.identification.experiment import output_columns
from fenics_rom.identification.parameters import ALPHA, BETA, DENSITY, POISSON, TILTS, YOUNG
from fenics_rom.identification.tilt import tilted, tilted_slope
from fenics_rom.scene.effects import Damping
from fenics_rom.scene.scene import Scene
from fenics_rom.system.system import System


def lame_parameters(θ: Array) -> tuple[Array, Array]:
    """λ and μ (m,) of all materials, Pa."""
    E, ν = θ[:-1, YOUNG], θ[:-1, POISSON]
    return E * ν / ((1 + ν) * (1 - 2 * ν)), E / (2 * (1 + ν))


def lame_derivatives(θ: Array, dθ: Array) -> tuple[Array, Array]:
    """Derivatives of λ and μ (m,) in a direction of θ."""
    λ, μ = lame_parameters(θ)
    E, ν, dE, dν = θ[:-1, YOUNG], θ[:-1, POISSON], dθ[:-1, YOUNG], dθ[:-1, POISSON]
    dλ = λ / E * dE + E * (1 + 2 * ν**2) / ((1 + ν) * (1 - 2 * ν)) ** 2 * dν
    return dλ, μ / E * dE - μ / (1 + ν) * dν


@dataclass(frozen=True)
class Matrices:
    """M, D and K, or their derivatives, (k, k) each."""

    mass: Array
    damping: Array
    stiffness: Array


@dataclass(frozen=True)
class GravityParts:
    """What gravity pushes a basis Q (k columns) with, of M = Σ ρ_i M_i + M_f."""

    materials: Array  # QᵀM_i times unit translations, of each material, (m, k, 3)
    fixed: Array  # QᵀM_f times those, (k, 3)
    acceleration: Array  # of the scene, (3,), m/s²
    column: int  # of gravity among the inputs, from behind

    def column_at(self, θ: Array) -> Array:
        """Qᵀ M g, (k,), N."""
        return self._weight(θ) @ tilted(self.acceleration, θ[-1, TILTS])

    def column_along(self, θ: Array, dθ: Array) -> Array:
        """Its derivative in a direction of θ, (k,)."""
        g, dg = self.acceleration, tilted_slope(self.acceleration, θ[-1, TILTS], dθ[-1, TILTS])
        heavier = np.tensordot(dθ[:-1, DENSITY], self.materials, 1) @ tilted(g, θ[-1, TILTS])
        turned: Array = heavier + self._weight(θ) @ dg
        return turned

    def _weight(self, θ: Array) -> Array:
        weight: Array = np.tensordot(θ[:-1, DENSITY], self.materials, 1) + self.fixed
        return weight


@dataclass(frozen=True)
class AffineDecomposition:
    """The parts on a basis Q (k columns)."""

    mass: Array  # QᵀM_iQ of each material, (m, k, k)
    fixed_mass: Array  # QᵀM_fQ, (k, k)
    dilation: Array  # QᵀΛ_iQ of each material, (m, k, k)
    shear: Array  # QᵀG_iQ of each material, (m, k, k)
    springs: Array  # QᵀK_sQ, (k, k)
    dashpots: Array  # QᵀD_dQ, (k, k)
    # QᵀB of each contact mode that does not depend on θ, (k, p): contact columns, actuators, loads but for gravity
    inputs: dict[str, Array]
    weights: dict[str, Array]  # QᵀB_i of each contact mode, (m, k, p)
    gravity: GravityParts | None
    outputs: dict[str, Array]  # CᵀQ of each output, (3 points, k)

    def at(self, θ: Array) -> Matrices:
        """The matrices at θ."""
        λ, μ = lame_parameters(θ)
        β = θ[:-1, BETA]
        return Matrices(
            mass=self.mass_at(θ),
            damping=self.external_damping(θ) + self._strain(β * λ, β * μ),
            stiffness=self._strain(λ, μ) + self.springs,
        )

    def mass_at(self, θ: Array) -> Array:
        """M."""
        return _combine(θ[:-1, DENSITY], self.mass) + self.fixed_mass

    def external_damping(self, θ: Array) -> Array:
        """Of D what does not strain the body."""
        of_masses = _combine(θ[:-1, ALPHA] * θ[:-1, DENSITY], self.mass) + θ[-1, ALPHA] * self.fixed_mass
        return of_masses + θ[-1, BETA] * self.springs + self.dashpots

    def along(self, θ: Array, dθ: Array) -> Matrices:
        """Their derivatives in a direction of θ."""
        (λ, μ), (dλ, dμ) = lame_parameters(θ), lame_derivatives(θ, dθ)
        ρ, α, β = (θ[:-1, column] for column in (DENSITY, ALPHA, BETA))
        dρ, dα, dβ = (dθ[:-1, column] for column in (DENSITY, ALPHA, BETA))
        damping = _combine(dα * ρ + α * dρ, self.mass) + dθ[-1, ALPHA] * self.fixed_mass + dθ[-1, BETA] * self.springs
        return Matrices(
            mass=_combine(dρ, self.mass),
            damping=damping + self._strain(dβ * λ + β * dλ, dβ * μ + β * dμ),
            stiffness=self._strain(dλ, dμ),
        )

    def input_matrix(self, contact: str, θ: Array) -> Array:
        """QᵀB of a contact mode, (k, p)."""
        B = self.inputs[contact] + _combine(θ[:-1, DENSITY], self.weights[contact])
        if self.gravity is not None:
            B[:, self.gravity.column] = self.gravity.column_at(θ)
        return B

    def forces(self, inputs: Mapping[str, Array], count: int, θ: Array) -> Array:
        """Qᵀ of what pushes, (count, k), under inputs (count, p) of contact modes."""
        pushed = (u @ self.input_matrix(name, θ).T for name, u in inputs.items())
        return sum(pushed, np.zeros((count, len(self.springs))))

    def forces_along(self, inputs: Mapping[str, Array], count: int, θ: Array, dθ: Array) -> Array:
        """Their derivatives in a direction of θ, (count, k)."""
        along = np.zeros((count, len(self.springs)))
        for name, u in inputs.items():
            dB = _combine(dθ[:-1, DENSITY], self.weights[name])
            if self.gravity is not None:
                dB[:, self.gravity.column] = self.gravity.column_along(θ, dθ)
            along += u @ dB.T
        return along

    def _strain(self, λ: Array, μ: Array) -> Array:
        return _combine(λ, self.dilation) + _combine(μ, self.shear)


def _combine(weights: Array, matrices: Array) -> Array:
    """Weighted sum over the first axis."""
    return np.tensordot(weights, matrices, 1)


class AffineSystem:
    """A scene assembled at a few simple values; every rank must make it, and ask it for parts.

    At ν = 0, λ = 0; at ν = 1/4, λ = μ. So with E = 2 and ρ = 1 everywhere μ = ρ = 1 (`plain`, which has no springs and
    no dashpots), and where one material has E = 5/2, ν = 1/4 and ρ = 2, its λ and its ρ are 1 more.
    """

    def __init__(self, scene: Scene):
        self._scene, self._names = scene, tuple(scene.materials)
        self._carries = bool(scene.effects.point_masses or scene.effects.rigid_parts)
        bare = replace(scene, effects=replace(scene.effects, damping=None, springs={}, large_deformation=None))
        self.plain = assemble(self._sample(bare))
        self._dilated = [
            assemble(self._sample(bare, name, young=2.5, poisson=0.25, density=2.0)) for name in self._names
        ]
        self._sheared = [assemble(self._sample(bare, name, young=4.0)) for name in self._names[1:]]
        springs, dashpots = scene.effects.springs, scene.effects.damped.dashpots
        self._grounded = None
        if springs or dashpots:
            damping = Damping(dashpots=dashpots) if dashpots else None
            grounded = replace(bare, effects=replace(bare.effects, springs=springs, damping=damping))
            self._grounded = assemble(self._sample(grounded))

    def _sample(self, scene: Scene, of: str = "", **values: Any) -> Scene:
        materials = {name: replace(m, young=2.0, poisson=0.0, density=1.0) for name, m in scene.materials.items()}
        if of:
            materials[of] = replace(materials[of], **values)
        return replace(scene, materials=materials)

    @cached_property
    def points(self) -> tuple[Array, Array, Array]:
        """Of all points (P here,) of a body that deforms largely: number of the material, shares of λ and of μ there.

        At ν = 1/4 and E = 5/2, 5, ... of the materials, λ = μ = 1, 2, ...
        """
        numbered = {
            name: replace(m, young=2.5 * k, poisson=0.25)
            for k, (name, m) in enumerate(self._scene.materials.items(), start=1)
        }
        body = assemble(replace(self._scene, materials=numbered)).deformation
        assert body is not None
        number = np.round(np.maximum(body.first_lame, body.shear)).astype(int)
        return number - 1, np.round(body.first_lame / number), np.round(body.shear / number)

    def parts(self, basis: Array) -> AffineDecomposition:
        """The parts on a basis, of which this rank has its rows, (rows here, k)."""
        inner, plain, grounded = self.plain.algebra.inner, self.plain, self._grounded

        def projected(matrix: Any) -> Array:
            return inner(basis, matrix @ basis)

        column = -sum(B.shape[1] for B in plain.loads.values()) if "gravity" in plain.loads else None

        def inputs_of(system: System, contact: str) -> Array:
            B = inner(basis, system.input_matrix(contact))
            if column is not None:
                B[:, column] = 0.0
            return B

        weighed, strained = projected(plain.mass), projected(plain.stiffness)
        others = [projected(s.stiffness) - strained for s in self._sheared]
        nothing = np.zeros_like(strained)
        inputs, weights = {}, {}
        for name in plain.contacts:
            B = inputs_of(plain, name)
            weights[name] = np.array([inputs_of(s, name) - B for s in self._dilated])
            inputs[name] = B - weights[name].sum(axis=0)
        mass = np.array([projected(s.mass) - weighed for s in self._dilated])
        gravity = self._scene.effects.gravity
        return AffineDecomposition(
            mass=mass,
            fixed_mass=weighed - mass.sum(axis=0) if self._carries else nothing,
            dilation=np.array([projected(s.stiffness) - strained for s in self._dilated]),
            shear=np.array([strained - sum(others, nothing), *others]),
            springs=nothing if grounded is None else projected(grounded.stiffness) - strained,
            dashpots=nothing if grounded is None else projected(grounded.damping),
            inputs=inputs,
            weights=weights,
            gravity=None if gravity is None or column is None else self._gravity(basis, gravity.acceleration, column),
            outputs={name: inner(C, basis) for name, C in output_columns(plain).items()},
        )

    def strained(self, material: int, columns: Array) -> tuple[Array, Array]:
        """Λ_i and G_i of a material times columns (rows here, k)."""
        plain = self.plain.stiffness @ columns
        dilated = self._dilated[material].stiffness @ columns - plain
        if material:
            return dilated, self._sheared[material - 1].stiffness @ columns - plain
        return dilated, plain - sum(s.stiffness @ columns - plain for s in self._sheared)

    def _gravity(self, basis: Array, acceleration: Sequence[float], column: int) -> GravityParts:
        """Of an acceleration, m/s², among the inputs in a column, from behind."""
        weighed, *heavier = (self.plain.algebra.inner(basis, weight_columns(s)) for s in (self.plain, *self._dilated))
        materials = np.array([each - weighed for each in heavier])
        return GravityParts(materials, weighed - materials.sum(axis=0), np.array(acceleration), column)


def weight_columns(system: System) -> Array:
    """M of a system of a scene times unit translations, but with the whole weight of threads, (rows here, 3), kg."""
    body = system.body
    assert body.weight is not None
    return body.unknowns.restrict(np.kron(body.weight[:, None], np.eye(3)))[system.algebra.rows()]
