"""Residual compliance of a ROM's contact points, from the factor of K that is there; see rom.residual_compliance."""

from collections.abc import Mapping
from contextlib import closing
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.reduction.common_basis import significant_eigenpairs
from fenics_rom.reduction.problem import ReductionProblem
from fenics_rom.reduction.projection import RetainedBasis, joint_span
from fenics_rom.rom.midpoint_map import compliance
from fenics_rom.rom.residual_compliance import ResidualCompliance
from fenics_rom.rom.residual_part import residual_part, strained_points
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.steppers.residual_motion import relaxation
from fenics_rom.system.system import System

COLUMNS_AT_ONCE = 96  # of solves
KEPT = 1e-6  # of the largest eigenvalue of the residual compliance: smaller ones are raised to it
LEAST = 1e-12  # of the static compliance: a residual compliance that small is as good as none, and raised to it
UNSEEN = 1e-4  # of the displacements under forces on contact points, in mass: what the shared basis may lack
POINTS_COMPARED = 8  # of which the Delassus operator is compared with the full model's


def has_residual_compliance(problem: ReductionProblem) -> bool:
    """Whether contact points keep what the basis lacks: those of a scene with contact, unless it says otherwise."""
    scene = problem.system.scene
    if scene is None or not problem.system.contact_points or problem.switching == "oblique":
        return False
    return scene.environment.contact_law is not None and scene.environment.residual_compliance


def static_displacements(problem: ReductionProblem) -> Array:
    """K⁻¹Sᵀ (rows here, 3P), m/N: under unit forces on contact points; (rows here, 0) where they keep no compliance."""
    if not has_residual_compliance(problem):
        return np.empty((problem.system.local_size, 0))
    with problem.stages("residual compliance"):
        Sᵀ = problem.system.points_of_contact().columns(problem.system.at_nodes)
        displacements = np.empty(Sᵀ.shape)
        for columns in _blocks(Sᵀ):
            displacements[:, columns] = problem.factor.solve(Sᵀ[:, columns])
    return displacements


def contact_shapes(problem: ReductionProblem, retained: Mapping[str, RetainedBasis], static: Array) -> Array:
    """Coordinates (k, s) of the shapes with most mass in which contact points yield beyond what contact modes keep.

    The shared basis is to hold them, so that a run can tell how the body yields around its contact points.

    Args:
        problem: what is reduced.
        retained: of each contact mode.
        static: `static_displacements`.
    """
    if not static.shape[1]:
        return np.empty((problem.space.size, 0))
    system, space, inner = problem.system, problem.space, problem.system.algebra.inner
    with problem.stages("residual compliance"):
        kept = space.subspace(joint_span(problem, retained))
        W, Sᵀ = space.basis @ kept.coordinates, system.points_of_contact().columns(system.at_nodes)
        shapes = _Residual(static, W, inner(W, Sᵀ) / kept.eigenvalues[:, None])
        w, E = significant_eigenpairs(shapes.gram(system, system.mass))
        whole = sum(np.vdot(static[:, of], system.mass @ static[:, of]) for of in _blocks(static))
        whole = float(system.algebra.total(whole))
        missing = np.sqrt(np.append(np.cumsum(w[::-1])[::-1], 0.0) / whole)  # where so many are taken
        return space.add(shapes.of(E[:, : int(np.argmax(missing <= UNSEEN))]))


def with_residual_compliance(problem: ReductionProblem, rom: Rom, static: Array) -> Rom:
    """The ROM (of the elastic part) with the residual compliance of its contact points, where its scene wants it."""
    if not static.shape[1]:
        return rom
    system = problem.system
    with problem.stages("residual compliance"):
        algebra, κ = system.algebra, rom.stiffness
        Q = rom.basis[algebra.rows()]
        Sᵀ = system.points_of_contact().columns(system.at_nodes)
        SQ, whole = algebra.inner(Sᵀ, Q), algebra.inner(Sᵀ, static)
        shapes, lacking = _Residual(static, Q, (SQ / κ).T), whole - (SQ / κ) @ SQ.T
        λ, U = np.linalg.eigh((lacking + lacking.T) / 2)
        floor = max(KEPT * float(λ[-1]), LEAST * float(np.diag(whole).max()))
        kept = λ > floor
        if system.rayleigh is not None:
            β = system.rayleigh[1]
        else:  # D is not β K in the residual shapes: what dissipates as much in all of them together
            heat = np.trace(shapes.gram(system, system.damping))
            β = heat / (float(np.trace(lacking)) + floor * len(λ))
        forces = U[:, kept] / np.sqrt(λ[kept])  # that make K-orthonormal shapes
        τ2, V = np.linalg.eigh(forces.T @ shapes.gram(system, system.mass) @ forces)
        factor, τ = (U[:, kept] * np.sqrt(λ[kept]) @ V)[:, ::-1], np.sqrt(np.maximum(τ2, 0.0))[::-1]
        residual = ResidualCompliance(factor, τ, floor=floor, damping=max(float(β), 0.0))
        return replace(rom, residual_compliance=_compared(problem, rom, residual, Sᵀ, SQ, whole))


class _Residual(NamedTuple):
    """Shapes X = K⁻¹Sᵀ - W C, (rows here, 3P), of which there are never more than some at once."""

    static: Array  # K⁻¹Sᵀ
    W: Array  # (rows here, k)
    C: Array  # (k, 3P)

    def of(self, forces: Array) -> Array:
        """X f of forces (3P, s)."""
        shapes: Array = self.static @ forces - self.W @ (self.C @ forces)
        return shapes

    def gram(self, system: System, matrix: Any) -> Array:
        """XᵀAX (3P, 3P) of M or D."""
        inner, gram = system.algebra.inner, np.empty((self.static.shape[1],) * 2)
        for columns in _blocks(gram):
            product = matrix @ (self.static[:, columns] - self.W @ self.C[:, columns])
            gram[:, columns] = inner(self.static, product) - self.C.T @ inner(self.W, product)
        return gram


def _blocks(columns: Array) -> list[slice]:
    """Some columns at once."""
    return [slice(first, first + COLUMNS_AT_ONCE) for first in range(0, columns.shape[1], COLUMNS_AT_ONCE)]


def _compared(
    problem: ReductionProblem, rom: Rom, residual: ResidualCompliance, Sᵀ: Array, SQ: Array, static: Array
) -> ResidualCompliance:
    """The same with the errors of the Delassus operators W = S A⁻¹ Sᵀ at the time step of the scene's run."""
    run, system, points = rom.environment.run, problem.system, Sᵀ.shape[1] // 3
    if run is None:
        return residual
    h, has_inertia, series = run.dt, rom.environment.has_inertia, rom.environment.viscoelasticity
    branches = 0.0 if series is None else series.stiffening_time(h)
    compared = np.unique(np.linspace(0, points - 1, POINTS_COMPARED).astype(int))
    columns = (3 * compared[:, None] + np.arange(3)).ravel()
    if has_inertia:
        elastic: tuple[complex, Any] = h / 2 + branches, system.stiffness
        terms: list[tuple[complex, Any]] = [(2 / h, system.mass), (1.0, system.damping), elastic]
        with closing(system.algebra.factor(*terms)) as factor:
            full = system.algebra.inner(Sᵀ, factor.solve(Sᵀ[:, columns]))
    else:
        full = static[:, columns] / h
    errors, H = {}, strained_points(rom.stiffness, SQ, residual)
    for name, model in rom.contact_models.items():
        S = SQ @ model.coordinates
        A = compliance(model, h, branches)[0] if has_inertia else 1 / (h * model.eigenvalues)
        reduced = S @ (A @ S[columns].T if A.ndim == 2 else A[:, None] * S[columns].T)
        part = residual_part(rom.stiffness, model, H, residual)
        a = relaxation(h, part.time_constant, residual.damping, branches).whole if has_inertia else h
        both = reduced + part.compliance[:, columns] / a
        without, beside = (np.linalg.norm(W - full) / np.linalg.norm(full) for W in (reduced, both))
        errors[name] = float(without), float(beside)
    return replace(residual, dt=h, errors=errors)
