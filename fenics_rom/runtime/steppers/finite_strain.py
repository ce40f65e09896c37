"""The steps of a body that deforms as far as it likes: the midpoint rule with a potential Φ(q) in place of ½ qᵀKq.

    2/h (v̂ - r) + D v̂ + f̂ = G u,   f̂ᵀ (q⁺ - q) = Φ(q⁺) - Φ(q),   q⁺ = q + h v̂,   r⁺ = 2 v̂ - r

balances energy as the linear rule does. Both ways to f̂ take the strains' rates A = ∂E/∂q in the middle of the step:

    newton.py               A at (q + q⁺)/2, found by iteration; ε is E(q) and f̂ = Aᵀ ω Ŝ(E, E⁺). For large steps.
    linearly_implicit.py    A at q + h/2 v̂ as it is expected: one linear system is left. The faster one.
    equilibrium.py          without inertia: Φ'(q⁺) = G u.
"""

from typing import TYPE_CHECKING

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.actuator_forces import ActuatorForces
from fenics_rom.mechanics.energy_ledger import EnergyLedger
from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.rom.deformation import ReducedDeformation
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.steppers.acts.followers import Follower, follower_loads
from fenics_rom.runtime.steppers.acts.found_forces import FoundForces
from fenics_rom.runtime.steppers.adjoint import check_is_differentiated
from fenics_rom.runtime.steppers.deformation_watch import DeformationWatch
from fenics_rom.runtime.steppers.kernel import BookedKernel

if TYPE_CHECKING:
    from fenics_rom.mechanics.viscoelasticity import MaxwellBranches
    from fenics_rom.runtime.steppers.adjoint import ContactStep
    from fenics_rom.runtime.steppers.balance_adjoint import BalanceAdjoint, BalancedPart
    from fenics_rom.runtime.steppers.contact_interface import ContactInterface
    from fenics_rom.runtime.steppers.residual_motion import ResidualMotion


class FiniteStrainKernel(BookedKernel):
    """What the kernels of large deformation share: the loads that follow the body, and how far it has gone.

    Arguments and attributes as in BookedKernel, but for the whole ROM, whose contact models share a basis.
    """

    NOTES: tuple[str, ...] = ()

    @staticmethod
    def strain_count(body: ReducedDeformation) -> int:
        """How many strains branches have: those of the points."""
        return 6 * len(body.weights)

    def __init__(
        self,
        rom: Rom,
        ledger: EnergyLedger | None,
        interface: "ContactInterface | None",
        actuators: ActuatorForces | None = None,
        residual: "ResidualMotion | None" = None,
        branches: "MaxwellBranches | None" = None,
    ):
        assert rom.deformation is not None
        model = next(iter(rom.contact_models.values()))
        super().__init__(model, ledger, np.empty(0), interface, actuators, residual, branches)
        self._found_forces = None if actuators is None else FoundForces(rom, model, actuators)
        self._found = [] if self._found_forces is None else self._found_forces.followers
        self._body: ReducedDeformation = rom.deformation
        self._shared = sum(rom.actuators.values()) + sum(rom.loads.values())
        self._follower_columns = follower_loads(rom)
        self._watch = DeformationWatch(rom, interface)
        self._names = {id(model): name for name, model in rom.contact_models.items()}
        self.notes = dict.fromkeys((*self.NOTES, *self._watch.notes), 0.0)
        self.enter(self._model)

    def enter(self, model: ContactModel) -> None:
        """Makes another contact mode active: the basis is the same, the inputs are others."""
        self.flush()
        self._model = model
        first = model.inputs.shape[1] - self._shared
        self._active_followers = [(first + column, follower) for column, follower in self._follower_columns]
        self._dead_loads = model.inputs.copy()  # of loads whose direction stays
        self._dead_loads[:, [column for column, _ in self._active_followers]] = 0.0
        self._watch.enter(self._names[id(model)], model.inputs.shape[1])

    @property
    def beyond_training(self) -> bool:
        """As in Kernel."""
        return bool(self._watch.messages(self.notes))

    @property
    def messages(self) -> tuple[str, ...]:
        """As in Kernel."""
        return self._watch.messages(self.notes)

    def _loads(self, u: Array, q: Array) -> Array:
        """Generalized forces (m,) of the inputs on the body at q."""
        return self._loads_with(self._dead_loads.dot(u), u, q)

    def _loads_with(self, dead: Array, u: Array, q: Array) -> Array:
        """The same, where those of loads whose direction stays (m,) are known."""
        force = dead
        for column, follower in self._active_followers:
            if size := u.item(column):
                force = force + size * follower.force(q)
        return force

    def _input_columns(self, q: Array) -> Array:
        """Those forces (m, p) of inputs of 1."""
        columns = self._dead_loads.copy()
        for column, follower in self._active_followers:
            columns[:, column] = follower.force(q)
        return columns

    def _load_slopes(self, u: Array, reactions: Array, q: Array) -> Array:
        """∂/∂q (m, m) of the forces of the inputs, and of what is found in the step, (n,)."""
        slopes = np.zeros((len(q), len(q)))
        for column, follower in self._active_followers:
            if u[column]:
                slopes += u[column] * follower.slope(q)
        for reaction, follower in zip(reactions, self._found, strict=True):
            if reaction:
                slopes += reaction * follower.slope(q)
        return slopes

    def _strokes_at(self, q: Array) -> Array:
        """Strokes (n,) of what is found in the step, m or m³, at q."""
        return np.array([follower.stroke(q) for follower in self._found])

    def _stroke_columns(self, q: Array) -> Array:
        """Their forces of 1, (m, n)."""
        return np.array([follower.force(q) for follower in self._found]).reshape(-1, len(q)).T

    def _stroke_slopes(self, q: Array) -> Array:
        """What strokes change by with q, (m, n)."""
        return np.array([follower.stroke_slope(q) for follower in self._found]).reshape(-1, len(q)).T

    def _held_strokes(self, reactions: Array) -> "tuple[Array, list[Follower]]":
        """Which of the strokes that are given (n,) forces hold, and what they are of."""
        held = np.empty(0, dtype=int) if self._actuators is None else self._actuators.held(reactions)
        return held, [self._found[stroke] for stroke in held]

    @property
    def _stroke_places(self) -> Array:
        """Of strokes that are given in the input (k,)."""
        if self._actuators is None:
            return np.empty(0, dtype=int)
        return self._model.inputs.shape[1] + self._actuators.columns

    def _angles(self, q: Array) -> Array | None:
        """By which tendons turn at guides, (n,), rad, where forces of actuators are found."""
        assert self._found_forces is not None
        return self._found_forces.angles(q)

    def _acting(self, u: Array) -> Array:
        """An input with the forces that were found in place of strokes."""
        if self._actuators is None:
            return u
        forces, _ = self._actuators.split(u)
        forces[self._actuators.columns] = self.reactions
        return forces

    def check_differentiable(self) -> None:
        """As in Kernel."""
        check_is_differentiated(self._actuators, self.branches)

    def _balance_adjoint(
        self, parts: "list[BalancedPart]", reactions: list[Array], q: Array, is_kink: bool
    ) -> "BalanceAdjoint":
        """Of the last step, from q (m,), in parts under what was found, (n,) each; the last one first."""
        from fenics_rom.runtime.steppers.balance_adjoint import BalanceAdjoint, StrokesGiven

        q_after = self._coordinates().copy()
        return BalanceAdjoint(
            parts,
            [self._held_strokes(found)[0] for found in reactions],
            StrokesGiven(self._stroke_places, self._stroke_slopes(q)),
            self._ω,
            self._body.force(q_after),
            q,
            q_after,
            self._r.copy(),
            None if self.residual is None else self.residual.state.reshape(4, -1).copy(),
            is_kink,
            False,
        )

    @property
    def _contact_step(self) -> "ContactStep | None":
        """Tells how contact was solved last; None where nothing can touch."""
        return None if self._interface is None else self._interface.solver.last_step

    def _note(self, q: Array, E: Array | None, u: Array) -> None:
        """Notes how far a step under u has led, to q and strains E if known, and warns where it is beyond training."""
        self._watch.look(self.notes, u, q, E, self.contact, self.h)
