"""The full-order run: passive midpoint integration with one kept factorisation per step size, paper (2)-(4)."""

import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from fenics_rom.errors import FenicsRomWarning, SceneError, StepError
from fenics_rom.fem.assemble import assemble
from fenics_rom.fem.direct import PetscFactor
from fenics_rom.fem.extended_precision import ExtendedMatrix
from fenics_rom.fem.finite_strain.stepper import LargeDeformationSimulator
from fenics_rom.fem.petsc_matrix import combination
from fenics_rom.mechanics.active_environment import ActiveEnvironment, ContactPoints, SignalLike
from fenics_rom.mechanics.contact import Contact, ContactSolution
from fenics_rom.mechanics.energy_ledger import EnergyLedger
from fenics_rom.mechanics.linearity import SurfaceGauges, SurfaceStrainPeak, largest, summary, warning
from fenics_rom.mechanics.load_history import LoadHistory
from fenics_rom.mechanics.time_step_monitor import TimeStepMonitor
from fenics_rom.scene.scene import Scene
from fenics_rom.system.system import Array, System
from fenics_rom.trajectory.trajectory import Trajectory, TrajectoryRecorder

Report = Callable[[str, int, int], None]

LOOK_EVERY = 10  # steps; a look at the surface costs less than one


class FullSimulator:
    """Steps a full-order system from rest; every rank must call every method.

    Args:
        system: the full-order model, on PETSc matrices.
        dt: time step, s; may be set anew before any step.
        surroundings: obstacles, and whether there is inertia; None: no obstacles, and inertia.
        ledger: whether the energy account is kept; without it a step is one solve and two products.

    Attributes:
        touched: contact in the last step; None where nothing touched.
        ledger: the energy account, or None.
        gauge: of the length of the steps, where an account is kept.
    """

    def __init__(
        self, system: System, dt: float, surroundings: ActiveEnvironment | None = None, *, ledger: bool = True
    ):
        self.system, self.surroundings = system, surroundings
        self.touched: ContactSolution | None = None
        self._quasi_static = surroundings is not None and surroundings.quasi_static
        self._contact: Contact | None = None
        if surroundings is not None and surroundings.law is not None:
            self.points = ContactPoints(system.contact_points, system.body.nodes)
            self._contact = Contact(self.points.places, list(surroundings.obstacles.values()), surroundings.law)
            self._contact.check_start(
                np.zeros(self.points.places.shape), surroundings.offsets, list(surroundings.obstacles)
            )
            self._Sᵀ = system.at_nodes(self.points.nodes)
        self.dt = dt
        self.time = 0.0
        self.ledger = EnergyLedger() if ledger else None
        self.gauge = TimeStepMonitor()
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
        self._renew_products()
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
        M v and K x carried along by their increments close it to round-off. Without an account none of that is done.
        """
        h = self.dt
        factor = self._factor(h)
        self._renew_products()
        force = (B @ u)[:, None]
        right = force - self._elastic if self._quasi_static else force + 2 / h * self._momentum - self._elastic
        v = factor.solve(right)
        touched = self._touched(v)
        if touched is not None:
            right = right + self._Sᵀ @ touched.forces.reshape(-1, 1)
            v = factor.solve(right)
        if not np.isfinite(self._dot(v, v)):
            raise StepError(f"input {u.tolist()} leads out of the finite numbers; the state was left as it was")
        if self.ledger is not None:
            Mv, Kv = self._refined(factor, right, v)
            if not self._quasi_static:
                self.gauge.add(4 * self._dot(v - self.v, Mv - self._momentum), self._dot(v, Mv))
            drawn = h / 2 * Kv if self._quasi_static else self._damped(v, Mv, Kv)
            self.ledger.book(supplied=h * self._dot(force, v), dissipated=h * self._dot(v, drawn))
            if touched is not None:
                self.ledger.book_contact(*touched.account(self._at_points(v), h))
            self._momentum = 2 * Mv - self._momentum
            self._elastic = self._elastic + h * Kv
        self.touched = touched
        self.x += h * v
        if not self._quasi_static:
            self.v = 2 * v - self.v
        self.time += h

    def nearest(self, active: str) -> str:
        """The contact mode that an obstacle is nearest to, if one is near; else the active one."""
        assert self._contact is not None
        assert self.surroundings is not None
        gaps = self._contact.gaps(self._at_points(self.x), self.surroundings.offsets)
        return self.points.nearest(gaps, active)

    @property
    def messages(self) -> tuple[str, ...]:
        """What the user should know of the run so far."""
        loose = "" if self._contact is None else self._contact.loose.message
        return tuple(filter(None, [loose, self.gauge.message]))

    def _touched(self, free: Array) -> ContactSolution | None:
        """Contact forces of a step, from the mid-step velocity without contact (rows here, 1)."""
        if self._contact is None or self.surroundings is None:
            return None
        return self._contact.resolve(
            self._at_points(self.x),
            self._at_points(self.v),
            self._at_points(free),
            self._W,
            self.dt,
            self.surroundings.offsets,
            self.surroundings.ahead,
            self._quasi_static,
            self.surroundings.velocities,
        )

    def _at_points(self, x: Array) -> Array:
        """What a field (rows here, 1) is at the contact points, (P, 3)."""
        return self.system.algebra.inner(self._Sᵀ, x).reshape(-1, 3)

    def _renew_products(self) -> None:
        """M v and K x anew, where no account carries them along."""
        if self.ledger is None:
            self._momentum, self._elastic = self.system.mass @ self.v, self.system.stiffness @ self.x

    def _refined(self, factor: PetscFactor, right: Array, v: Array) -> tuple[Array, Array]:
        """Refines A v = right once, in place; M v and K v."""
        s = self.system
        Mv, Kv = s.mass @ v, self._stiffness @ v
        correction = factor.solve(right - self._resisted(v, Mv, Kv))
        v += correction
        return Mv + s.mass @ correction, Kv + s.stiffness @ correction

    def _resisted(self, v: Array, Mv: Array, Kv: Array) -> Array:
        """A v, A = 2/h M + D + h/2 K; without inertia A = h K."""
        h = self.dt
        return h * Kv if self._quasi_static else 2 / h * Mv + self._damped(v, Mv, Kv) + h / 2 * Kv

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
        return self._on_nodes(self.x)

    def velocity(self) -> Array:
        """Velocity of every mesh node (nodes, 3), m/s."""
        return self._on_nodes(self.v)

    def close(self) -> None:
        """Gives the factor's memory back."""
        if self._factored is not None:
            self._factored[1].close()
            self._factored = None

    def _on_nodes(self, x: Array) -> Array:
        """A field (rows here, 1) on all nodes (nodes, 3), the same on every rank."""
        field = np.zeros(3 * len(self.system.body.nodes))
        field[self.system.body.free] = self.system.algebra.gather(x)[:, 0]
        return field.reshape(-1, 3)

    def _dot(self, a: Array, b: Array) -> float:
        return float(self.system.algebra.inner(a, b)[0, 0])

    def _factor(self, h: float) -> PetscFactor:
        if self._factored is None or self._factored[0] != h:
            self.close()
            s = self.system
            if self._quasi_static:
                matrix: Any = combination((h, s.stiffness))
            elif s.rayleigh is None:
                matrix = combination((2 / h, s.mass), (1.0, s.damping), (h / 2, s.stiffness))
            else:
                α, β = s.rayleigh
                matrix = combination((2 / h + α, s.mass), (h / 2 + β, s.stiffness))
            self._factored = h, PetscFactor(matrix, one_by_one=True)
            if self._contact is not None:
                W = s.algebra.inner(self._Sᵀ, self._factored[1].solve(self._Sᵀ))
                self._W = (W + W.T) / 2
        return self._factored[1]


def solve(
    scene: Scene | System,
    *,
    dt: float | None = None,
    signals: Mapping[str, SignalLike] | None = None,
    report: Report = lambda stage, done, of: None,
) -> Trajectory:
    """Runs the full-order model through the scene's load history from rest; every rank must call it.

    Args:
        scene: the scene, or the system assembled from it.
        dt: time step instead of the scene's, s.
        signals: of loads and obstacles by name, instead of the scene's: numbers, or functions of time; as in
            Simulator.
        report: called with the stage, how much of it is done, and of how much.

    Warns where the surface turns or strains more than a linear model can follow.

    Raises:
        SceneError, MeshError, SolverError: as `assemble`, or no load history.
    """
    system = assemble(scene) if isinstance(scene, Scene) else scene
    asked, surroundings, history = _asked(system, dt, signals)
    assert asked.run is not None
    simulator = _simulator(system, history.dt, surroundings)
    points = {name: rows.shape[1] // 3 for name, rows in system.outputs.items()}
    nodes, contact = len(system.body.nodes), history.first_contact()
    kept = points, tuple(system.contacts), nodes, asked.run.snapshots, tuple(asked.effects), surroundings.obstacles
    recorder = TrajectoryRecorder(history.steps, history.dt, *kept)

    def sample(step: int, contact: str) -> None:
        assert simulator.ledger is not None
        forces = None if simulator.touched is None else simulator.touched.by_obstacle
        account = contact, simulator.energy, simulator.ledger, simulator.displacement, simulator.velocity
        recorder.sample(step, *account, forces, surroundings.offsets)

    sample(0, contact)
    watch = LinearLimit(system) if isinstance(simulator, FullSimulator) else TurnedInsideOut(simulator)
    seconds = 0.0
    for step, (contact, spent) in enumerate(_steps(simulator, history), start=1):
        seconds += spent
        if step % LOOK_EVERY == 0:
            watch.look(simulator.displacement(), simulator.time)
        sample(step, contact)
        report("steps", step, history.steps)
    simulator.close()
    return recorder.record(
        name=asked.name,
        model="full",
        settings={"dt": history.dt, "seconds": seconds, "order": system.size},
        nodes=system.body.nodes,
        triangles=system.body.triangles,
        node_mass=system.body.node_mass,
        warnings=(*system.warnings, *filter(None, [watch.summary]), *simulator.messages),
    )


class LinearLimit:
    """Watches whether the surface turns or strains more than a linear model can follow."""

    def __init__(self, system: System):
        self._gauges, self._seen = SurfaceGauges(system.body.nodes, system.body.triangles), SurfaceStrainPeak()

    def look(self, displacement: Array, time: float) -> None:
        """Notes displacements of all nodes (N, 3), m, at a time, s, and warns at the first that is too much."""
        now = SurfaceStrainPeak(*largest(self._gauges.components(displacement)), time)
        if now.beyond and not self._seen.beyond:
            warnings.warn(warning(now), FenicsRomWarning, stacklevel=3)
        self._seen = self._seen.joined(now)

    @property
    def summary(self) -> str:
        """What to say of the run; empty where there is nothing to say."""
        return summary(self._seen)


class TurnedInsideOut:
    """Watches whether points of a body that deforms largely are turned inside out."""

    def __init__(self, simulator: LargeDeformationSimulator):
        self._simulator, self._most, self._first = simulator, 0, 0.0

    def look(self, displacement: Array, time: float) -> None:
        """As in LinearLimit."""
        count = self._simulator.inverted
        first = count > 0 and self._most == 0
        self._most = max(self._most, count)
        if first:
            self._first = time
            warnings.warn(self.summary, FenicsRomWarning, stacklevel=3)

    @property
    def summary(self) -> str:
        """As in LinearLimit."""
        if not self._most:
            return ""
        return (
            f"up to {self._most} points of the body were turned inside out, from t = {self._first:.4g} s on: shapes "
            "and forces there are not to be trusted; a finer mesh or a smaller load may help"
        )


def plain_rate(system: System, dt: float, seconds: float = 0.02, windows: int = 25) -> float:
    """Steps per second of the scene's load history without the energy account; every rank must call it.

    Args:
        system: with a scene.
        dt: time step, s.
        seconds: wall clock of a window.
        windows: how many there are, of which the fastest counts: whatever else a machine does can only slow it down.
    """
    _, surroundings, history = _asked(system, dt, None)
    simulator = _simulator(system, history.dt, surroundings, ledger=False)
    rates = []
    spent, taken = 0.0, 0
    for step, (_, last) in enumerate(_steps(simulator, history)):
        if step == 0:  # it has the factorisation in it
            continue
        spent, taken = spent + float(system.algebra.maximum(last)), taken + 1
        if spent >= seconds or step == history.steps - 1:
            rates.append(taken / spent)
            spent, taken = 0.0, 0
        if len(rates) == windows:
            break
    simulator.close()
    return max(rates, default=0.0)


def _asked(
    system: System, dt: float | None, signals: Mapping[str, SignalLike] | None
) -> tuple[Scene, ActiveEnvironment, LoadHistory]:
    """The scene of a system, what acts in it, and the inputs of every step."""
    asked = system.scene
    if asked is None or asked.run is None:
        where = asked.source if asked else "a system of matrices"
        raise SceneError(f"{where}: has no [run], so there is no load history to simulate")
    surroundings = ActiveEnvironment(asked, signals=signals)
    if surroundings.quasi_static and system.rigid.shape[1]:
        raise SceneError(
            f"{asked.source}: effects: inertia is missing, and a body that nothing holds has no equilibrium"
        )
    contacts, actuators = (
        {name: B.shape[1] for name, B in blocks.items()} for blocks in (system.contacts, system.actuators)
    )
    return asked, surroundings, LoadHistory(asked, contacts, actuators, dt)


def _simulator(
    system: System, dt: float, surroundings: ActiveEnvironment, ledger: bool = True
) -> FullSimulator | LargeDeformationSimulator:
    """What steps a system: linear, unless its scene names large deformation."""
    if system.deformation is None:
        return FullSimulator(system, dt, surroundings, ledger=ledger)
    made: LargeDeformationSimulator = system.deformation.simulator(dt, surroundings, ledger=ledger)
    return made


def _steps(simulator: FullSimulator | LargeDeformationSimulator, history: LoadHistory) -> Iterator[tuple[str, float]]:
    """Takes the steps of a load history; contact mode and wall clock (s) of each."""
    system, surroundings = simulator.system, simulator.surroundings
    assert surroundings is not None
    inputs = {name: system.input_matrix(name) for name in system.contacts}
    contact = history.first_contact()
    for pushed, u in history:
        start = time.perf_counter()
        if history.automatic:
            contact = simulator.nearest(contact)
            u = np.concatenate([np.zeros(system.contacts[contact].shape[1]), u])
        else:
            contact = pushed
        middle, end = simulator.time + history.dt / 2, simulator.time + history.dt
        surroundings.ahead = surroundings.offsets_at(end)
        loads = surroundings.loads(end if surroundings.quasi_static else middle)
        u = np.concatenate([u, loads])
        if isinstance(simulator, FullSimulator):
            simulator.step(inputs[contact], u)
        else:
            simulator.step(contact, u)
        surroundings.arrive(history.dt)
        yield contact, time.perf_counter() - start
