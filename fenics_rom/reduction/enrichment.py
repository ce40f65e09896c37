"""Directions that a ROM lacks, added while it runs: the static response of the residual.

Under inputs u a reduced body W q has the residual, with its acceleration a = G u - WᵀDW q̇ - diag(γ) q,

    ρ = B u - M W a - D W q̇ - K W q

The directions K⁻¹ρ and K⁻¹B (what other inputs would leave), and K⁻¹M times these (how their inertia yields), go into
the basis of the active contact mode. The new basis holds all of the old one, and so does the new finer model, which has
the next K⁻¹M of them besides. So shape, velocities and the error are carried over as they are: no energy is made or
lost. The error that there is dies away with the body's damping; directions are added anew when what came to it since is
beyond the tolerance.
"""

from contextlib import closing
from dataclasses import replace
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import SceneError, check_type
from fenics_rom.io.stages import Stages
from fenics_rom.mechanics.environment import Environment
from fenics_rom.reduction.common_basis import CommonBasis, orthonormalize_against, pad_rows
from fenics_rom.reduction.error_model import check_errors_known, finer_basis, ritz_vectors, with_error_model
from fenics_rom.reduction.problem import ReductionProblem
from fenics_rom.reduction.projection import RetainedBasis, assemble_rom
from fenics_rom.reduction.rigid_mode_deflation import elastic_part, with_rigid_modes
from fenics_rom.rom.contact_model import safe_frequencies
from fenics_rom.rom.rom import Rom, check_rom
from fenics_rom.runtime.error_tolerance import ADDED
from fenics_rom.runtime.simulator import Simulator
from fenics_rom.system.system import System

MOST_INPUTS = 8  # columns of a contact mode that get directions each; of more their combination in the last step does
ADDED_BLOCKS = 2  # of responses that go into the basis, and as many more into that of the finer model
OFF = 1e-6  # largest accepted error of the basis in the system's mass
ENRICHED = ", enriched"  # end of the method's name


class Enrichment:
    """Adds directions to a ROM while it runs.

    Args:
        rom: of small strains in a fixed frame, without obstacles.
        system: that it was reduced of; every rank must call this, and `enrich`.

    Attributes:
        rom: with what its runs need to know their errors; after `enrich` with the directions that were added.

    Raises:
        SceneError: something else was given, or errors of such a body cannot be known.
        SolverError: as `reduce`.

    Example:
        >>> adding = fr.Enrichment(rom, system)
        >>> run = fr.simulate(rom, error_tolerance=1e-5, enrich=adding)  # m
        >>> fr.write_rom("richer.h5", adding.rom)
    """

    def __init__(self, rom: Rom, system: System):
        check_type("Enrichment", rom, Rom, "fr.reduce(system)")
        check_type("Enrichment", system, System, "fr.assemble(scene)")
        check_errors_known(system)
        _check_environment(rom.environment)
        self._whole, self._elastic, self._mass = system, elastic_part(system), system.mass
        self._check_basis(rom)
        with closing(self._factor()) as factor:
            problem = self._problem(rom, factor)
            self._finer = finer_basis(problem, rom, system, rom.basis[system.algebra.rows()])
            self.rom = with_error_model(problem, rom, system, self._finer)

    def enrich(self, body: Simulator) -> Simulator:
        """The body with directions added to its active contact mode: same shape, velocities, error, time and account.

        Args:
            body: a simulator of `rom`, which is left as it is.

        Returns:
            A simulator of the `rom` that is there then; the body itself where there is nothing to add.

        Raises:
            SceneError: the body is of another ROM, is touched, or has taken no step in which its errors were kept.
        """
        check_type("enrich", body, Simulator, "fr.Simulator(rom, dt)")
        _, (given, *_) = body.__reduce__()
        if body.errors is None or body.errors.last_inputs is None or given.identity != self.rom.identity:
            raise SceneError("enrich: use a simulator of the Enrichment's rom, after a step, which keeps its errors")
        _check_environment(body.rom.environment)
        with closing(self._factor()) as factor:
            problem = self._problem(self.rom, factor)
            old, blocks = self._strained_basis(self.rom, body.contact), self._responses(problem, body)
            added, *_ = orthonormalize_against(self._elastic, np.hstack(blocks[:ADDED_BLOCKS]), old)
            if not added.shape[1]:
                return body
            rom = self._with_directions(problem, body.contact, added)
            E, _ = self._finer
            beyond = np.hstack([added, *blocks[ADDED_BLOCKS:]])
            new, *_ = orthonormalize_against(self._whole, beyond, E)
            rigid = rom.rigid
            finer = ritz_vectors(self._whole, E[:, :rigid], np.hstack([E[:, rigid:], new]))
            rom = check_rom(with_error_model(problem, rom, self._whole, finer))
        inner = self._whole.algebra.inner
        kept = inner(self._mass @ self._strained_basis(rom, body.contact), old)
        carried = _carried_over(body, rom, kept, inner(self._mass @ finer[0], E))
        self.rom, self._finer = rom, finer
        return carried

    def _factor(self) -> Any:
        return self._elastic.algebra.factor((1.0, self._elastic.stiffness))

    def _problem(self, rom: Rom, factor: Any) -> ReductionProblem:
        system = self._elastic
        return ReductionProblem(
            system=system,
            factor=factor,
            space=CommonBasis(system),
            contacts=tuple(rom.contact_models),
            order=None,
            tolerance=0.0,
            switching=rom.switching,
            weighting=rom.weighting,
            lyapunov="auto",
            share=1.0,
            stages=Stages(lambda value: float(system.algebra.maximum(value)), rom.stages),
            messages=list(rom.warnings),
        )

    def _check_basis(self, rom: Rom) -> None:
        """A SceneError where the ROM is not of the system."""
        system = self._whole
        mistake = ""
        if rom.switching != "energy" or system.body.unknowns.weights is not None:
            mistake = "has oblique switching, or nodes that follow others"
        elif rom.contacts != {name: B.shape[1] for name, B in system.contacts.items()}:
            mistake = "has other contact modes than the system"
        elif len(rom.basis) != system.size or rom.rigid != system.rigid.shape[1]:
            mistake = "is of another body than the system"
        else:
            Q = rom.basis[system.algebra.rows()]
            gap = system.algebra.inner(Q, system.mass @ Q) - np.eye(Q.shape[1])
            if np.abs(gap).max() > OFF:
                mistake = f"has a basis that is not orthonormal in the system's mass: off by {np.abs(gap).max():.1e}"
        if mistake:
            raise SceneError(f"enrich: ROM {rom.name!r} {mistake}; use one that was reduced of it")

    def _strained_basis(self, rom: Rom, contact: str) -> Array:
        """W (rows here, m) of a contact mode, without rigid motions."""
        model = rom.contact_models[contact]
        W: Array = rom.basis[self._whole.algebra.rows()] @ model.coordinates[:, model.rigid :]
        return W

    def _responses(self, problem: ReductionProblem, body: Simulator) -> list[Array]:
        """K⁻¹[B, ρ], and K⁻¹M times it once, twice, and so on: blocks (rows here, c)."""
        system, model, factor, contact = self._elastic, body.model, problem.factor, body.contact
        u: Any = body.errors and body.errors.last_inputs
        acting, rigid = body.rom.input_columns(contact), model.rigid
        columns = [np.full(count, name in acting) for name, count in self.rom.input_columns(contact).items()]
        B = system.input_matrix(contact)[:, np.concatenate(columns)]
        q, v = body.state
        damped = model.damping * v if model.damping.ndim == 1 else model.damping @ v
        a = model.inputs @ u - damped - model.eigenvalues * q
        shapes = self._strained_basis(self.rom, contact) @ np.column_stack([a, v, q])[rigid:]
        inertial, resisted, elastic = (shapes[:, [k]] for k in range(3))
        ρ = B @ u[:, None] - system.mass @ inertial - system.damping @ resisted - system.stiffness @ elastic
        blocks = [factor.solve(np.hstack([B if B.shape[1] <= MOST_INPUTS else B @ u[:, None], ρ]))]
        for _ in range(2 * ADDED_BLOCKS - 1):
            blocks.append(factor.solve(system.mass @ blocks[-1]))
        return blocks

    def _with_directions(self, problem: ReductionProblem, contact: str, added: Array) -> Rom:
        """The ROM with columns (rows here, c) in the basis of a contact mode."""
        rom, rigid, space = self.rom, self.rom.rigid, problem.space
        Q = space.add(rom.basis[self._whole.algebra.rows()][:, rigid:])
        new, retained = space.add(added), {}
        for name, model in rom.contact_models.items():
            span = pad_rows(Q @ model.coordinates[rigid:, rigid:], space.size)
            directions, σ = span @ model.directions[rigid:, rigid:], model.hankel_singular_values
            if name == contact:
                span, directions, σ = np.hstack([span, new]), np.hstack([directions, new]), np.empty(0)
            retained[name] = RetainedBasis(span, directions, σ)
        method = rom.method.removesuffix(ENRICHED) + ENRICHED
        richer = with_rigid_modes(assemble_rom(problem, retained, method=method), self._whole)
        return replace(richer, environment=rom.environment)


def _check_environment(acting: Environment) -> None:
    """A SceneError where obstacles may touch the body."""
    if acting.contact_law is not None:
        raise SceneError("enrich: obstacles may touch the body; use one that inputs and loads alone act on")


def _carried_over(body: Simulator, rom: Rom, kept: Array, finer: Array) -> Simulator:
    """The body in a richer ROM: `kept` (m', m) of what strains, and `finer` (f', f), map coordinates."""
    _, (_, acting, _, as_last_said, saved) = body.__reduce__()
    watched: dict[str, Any] = {"errors": True, "error_tolerance": body.error_tolerance}
    richer, rigid = Simulator(rom, body.dt, ledger=body.ledger is not None, **acting, **watched), rom.rigid
    for name, signal in as_last_said.items():
        richer.set_signal(name, signal)
    richer.switch(body.contact)
    (q, v), ω, old = body.state, richer.model.safe_frequencies[rigid:], body.model.safe_frequencies[rigid:]
    strained = isometry(ω[:, None] * kept / old) @ (old * q[rigid:]) / ω
    richer.state = np.concatenate([q[:rigid], strained]), np.concatenate([v[:rigid], isometry(kept) @ v[rigid:]])
    state, errors = richer.save(), saved.errors
    before, after = (of.error_model.eigenvalues if of.error_model else np.empty(0) for of in (body.rom, rom))
    e, r = np.split(errors.finer, 2)
    e = np.sqrt(after) * (finer @ (e / safe_frequencies(before)))
    errors = errors._replace(finer=np.concatenate([e, finer @ r]))
    richer.restore(replace(saved, stepper=state.stepper, belongs=state.belongs, errors=errors))
    assert richer.errors is not None
    richer.errors.set_apart(richer.contact, richer.energy_coordinates)
    richer.whose, richer.advice = body.whose, ADDED
    return richer


def isometry(A: Array) -> Array:
    """The nearest matrix with orthonormal columns to one (m', m) that has them but for round-off."""
    U, _, V = np.linalg.svd(A, full_matrices=False)
    product: Array = U @ V
    return product
