"""The full-order run: passive midpoint integration with one kept factorisation per step size, paper (2)-(4)."""

import time
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

from fenics_rom.errors import FenicsRomWarning, SceneError, StepError
from fenics_rom.fem.assemble import assemble
from fenics_rom.fem.direct import PetscFactor
from fenics_rom.fem.extended import ExtendedMatrix
from fenics_rom.fem.petsc_matrix import combination
from fenics_rom.ledger import Ledger
from fenics_rom.linear_limit import Excursion, SurfaceGauges, largest, summary, warning
from fenics_rom.load_history import LoadHistory
from fenics_rom.record import Record, Recorder
from fenics_rom.scene import Scene
from fenics_rom.system import Array, System

Report = Callable[[str, int, int], None]

LOOK_EVERY = 10  # steps; a look at the surface costs less than one


class FullSimulator:
    """Steps a full-order system from rest; every rank must call every method.

    Args:
        system: the full-order model, on PETSc matrices.
        dt: time step, s; may be set anew before any step.
    """

    def __init__(self, system: System, dt: float):
        self.system = system
        self.dt = dt
        self.time = 0.0
        self.ledger = Ledger()
        rows = system.algebra.rows()
        self.x = np.zeros((rows.stop - rows.start, 1))
        self.v = np.zeros_like(self.x)
        self._momentum = np.zeros_like(self.x)  # M v
        self._elastic = np.zeros_like(self.x)  # K x
        self._stiffness = ExtendedMatrix(system.stiffness.mat)  # type: ignore[attr-defined]
        self._factored: tuple[float, PetscFactor] | None = None

    @property
    def energy(self) -> float:
        """Stored energy ½ vᵀMv + ½ xᵀKx, J."""
        return self._dot(self.v, self._momentum) / 2 + self._dot(self.x, self._elastic) / 2

    def set_state(self, x: Array, v: Array) -> None:
        """Puts the body somewhere, moving: local rows of displacement (m) and velocity (m/s), (rows here,) each."""
        self.x, self.v = x.reshape(-1, 1).copy(), v.reshape(-1, 1).copy()
        self._momentum = self.system.mass @ self.v
        self._elastic = self._stiffness @ self.x

    def step(self, B: Array, u: Array) -> None:
        """Advances by dt under the force B u, (rows here, p) and (p,).

        In K x large terms cancel (bending against stretching), so that in double precision the energy account of a
        thin body would close to 1e-10 only. Products with K in extended precision, one refinement of the solve, and
        M v and K x carried along by their increments close it to round-off.
        """
        h, s = self.dt, self.system
        factor = self._factor(h)
        force = (B @ u)[:, None]
        right = force + 2 / h * self._momentum - self._elastic
        v = factor.solve(right)
        Mv, Kv = s.mass @ v, self._stiffness @ v
        correction = factor.solve(right - 2 / h * Mv - self._damped(v, Mv, Kv) - h / 2 * Kv)
        v += correction
        Mv += s.mass @ correction
        Kv += s.stiffness @ correction
        if not np.isfinite(self._dot(v, v)):
            raise StepError(f"input {u.tolist()} leads out of the finite numbers; the state was left as it was")
        self.ledger.book(supplied=h * self._dot(force, v), dissipated=h * self._dot(v, self._damped(v, Mv, Kv)))
        self.x += h * v
        self.v = 2 * v - self.v
        self._momentum = 2 * Mv - self._momentum
        self._elastic = self._elastic + h * Kv
        self.time += h

    def _damped(self, v: Array, Mv: Array, Kv: Array) -> Array:
        """D v."""
        if self.system.rayleigh is None:
            return self.system.damping @ v
        α, β = self.system.rayleigh
        return α * Mv + β * Kv

    def displacement(self, output: str | None = None) -> Array:
        """Displacement, m: of a named output (points, 3), or of every mesh node (nodes, 3)."""
        s = self.system
        if output is not None:
            return s.algebra.inner(s.outputs[output], self.x).reshape(-1, 3)
        field = np.zeros(3 * len(s.body.nodes))
        field[s.body.free] = s.algebra.gather(self.x)[:, 0]
        return field.reshape(-1, 3)

    def close(self) -> None:
        """Gives the factor's memory back."""
        if self._factored is not None:
            self._factored[1].close()
            self._factored = None

    def _dot(self, a: Array, b: Array) -> float:
        return float(self.system.algebra.inner(a, b)[0, 0])

    def _factor(self, h: float) -> PetscFactor:
        if self._factored is None or self._factored[0] != h:
            self.close()
            s = self.system
            α, β = s.rayleigh or (0.0, 0.0)
            matrix: Any = combination((2 / h + α, s.mass), (h / 2 + β, s.stiffness))
            self._factored = h, PetscFactor(matrix, one_by_one=True)
        return self._factored[1]


def solve(scene: Scene | System, *, dt: float | None = None, report: Report = lambda stage, done, of: None) -> Record:
    """Runs the full-order model through the scene's load history from rest; every rank must call it.

    Args:
        scene: the scene, or the system assembled from it.
        dt: time step instead of the scene's, s.
        report: called with the stage, how much of it is done, and of how much.

    Warns where the surface turns or strains more than a linear model can follow.

    Raises:
        SceneError, MeshError, SolverError: as `assemble`, or no load history.
    """
    system = assemble(scene) if isinstance(scene, Scene) else scene
    asked = system.scene
    if asked is None or asked.run is None:
        where = asked.source if asked else "a system of matrices"
        raise SceneError(f"{where}: has no [run], so there is no load history to simulate")
    shared = sum(columns.shape[1] for columns in system.actuators.values())
    inputs = {name: system.input_matrix(name) for name in system.contacts}
    history = LoadHistory(
        asked,
        {name: B.shape[1] - shared for name, B in inputs.items()},
        {name: columns.shape[1] for name, columns in system.actuators.items()},
        dt,
    )
    simulator = FullSimulator(system, history.dt)
    points = {name: rows.shape[1] // 3 for name, rows in system.outputs.items()}
    nodes = len(system.body.nodes)
    recorder = Recorder(history.steps, history.dt, points, tuple(inputs), nodes, asked.run.shapes)
    recorder.sample(0, history.first_contact(), simulator.energy, simulator.ledger, simulator.displacement)
    gauges, seen = SurfaceGauges(system.body.nodes, system.body.triangles), Excursion()
    seconds = 0.0
    for step, (contact, u) in enumerate(history, start=1):
        start = time.perf_counter()
        simulator.step(inputs[contact], u)
        seconds += time.perf_counter() - start
        if step % LOOK_EVERY == 0:
            now = Excursion(*largest(gauges.components(simulator.displacement())), simulator.time)
            if now.beyond and not seen.beyond:
                warnings.warn(warning(now), FenicsRomWarning, stacklevel=2)
            seen = seen.joined(now)
        recorder.sample(step, contact, simulator.energy, simulator.ledger, simulator.displacement)
        report("steps", step, history.steps)
    simulator.close()
    return recorder.record(
        name=asked.name,
        model="full",
        settings={"dt": history.dt, "seconds": seconds, "order": system.size},
        nodes=system.body.nodes,
        triangles=system.body.triangles,
        node_mass=system.body.node_mass,
        warnings=(*system.warnings, *filter(None, [summary(seen)])),
    )
