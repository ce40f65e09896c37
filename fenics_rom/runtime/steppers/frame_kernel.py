"""What the steps of a body in a moving frame share: its inertia at a shape, and the points that forces act on.

Node i is at p + R y_i, y = X + V q, with the velocity p' + R (ω × y + V r), V of a contact mode (`rom.moving_frame`):

    I(q) = I0 + (½ I1 + S) q,    S(q) = ½ I1 + I2 q,    b(q) = g + G q,    L = I ω + b r,    s = r + bᵀω
    I⁺ - I = 2 h S(q + h/2 r̂) r̂,    b⁺r⁺ + b r = 2 T r̂,    T = b + h/2 G r

Forces in world axes act on points of the body, at a = (R y + R⁺ y⁺)/2 from the origin, as Sᵀ f with the velocities
ŝ = S v̂ = p'^ + (R* ω̂) × a + R* V r̂, which are exactly how far the points go: h ŝ. Others turn with the frame;
(R + R⁺)/2 turns them into the world.

Every balance is a sum of few vectors, the rows of one table, whose factors are numbers that ω̂ gives: the product of the
factors with the table is what the coordinates balance, and the products of its rows with a rate make up the momenta.
"""

import math
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import compiled
from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.mechanics.contact import ContactSolution
from fenics_rom.mechanics.energy_ledger import EnergyLedger
from fenics_rom.mechanics.frame_geometry import Geometry, Push, arms_of, vector
from fenics_rom.mechanics.frame_motion import ZERO, Rotation, Vector, added, rotation_matrix, rotation_of
from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.rom.moving_frame import MovingFrame
from fenics_rom.runtime.steppers.body_parts import PLAIN, BodyParts
from fenics_rom.runtime.steppers.compilable_frame import CompilableFrame
from fenics_rom.runtime.steppers.frame_loads import FrameForces, FrameLoads
from fenics_rom.runtime.steppers.frame_points import FramePoints
from fenics_rom.runtime.steppers.frame_state import FrameState, Shape
from fenics_rom.runtime.steppers.frame_table import (
    BENT,
    BENT_BY_RATE,
    COUPLED,
    GIVEN,
    HALF_INERTIA1,
    MOMENTS,
    ROWS,
    TURNED,
)
from fenics_rom.runtime.steppers.frame_watch import FrameWatch
from fenics_rom.runtime.steppers.ground_ties import GroundTies
from fenics_rom.runtime.steppers.kept_newton import KeptNewton
from fenics_rom.runtime.steppers.kernel import ContactWorks, StepWork

if TYPE_CHECKING:
    from fenics_rom.runtime.steppers.bent_in_loops import BentInLoops
    from fenics_rom.runtime.steppers.compiled_frame import CompiledFrame
    from fenics_rom.runtime.steppers.contact_interface import ContactInterface
    from fenics_rom.runtime.steppers.frame_touch import FrameTouch
    from fenics_rom.runtime.steppers.residual_motion import ResidualMotion


class FrameKernel(CompilableFrame):
    """A step in a moving frame.

    Args:
        model: the reduced model of a contact mode, of displacements that strain.
        frame: its moving frame.
        loads: what acts on it besides contact.
        watch: of what the model does not follow.
        ledger, interface, residual: as in BookedKernel.
        parts: what else it is made of.

    Attributes:
        frame: where the frame is; set it, then `resume`.
        base: that carries the body, at the end of the next step; None: it stands still, or there is none.
        ties: springs and dashpots to the ground; None where there are none.
        newton: solves what steps balance, where that is no linear system.
    """

    def __init__(
        self,
        model: ContactModel,
        frame: MovingFrame,
        loads: FrameLoads,
        watch: FrameWatch,
        ledger: EnergyLedger | None,
        interface: "ContactInterface | None",
        residual: "ResidualMotion | None" = None,
        parts: BodyParts = PLAIN,
    ):
        super().__init__(model, ledger, interface, residual, parts)
        self._constants, self._loads, self._mass, self._watch = frame, loads, frame.mass, watch
        self.notes = watch.notes | self._notes_of_parts
        m = model.order
        self._second = frame.inertia2 if frame.stiffening is None else frame.inertia2 - frame.stiffening
        self._couples = bool(self._second.any() or frame.coupling.any() or frame.inertia1.any())
        self._products = np.empty((10, m, m))  # h/2 I2, G, 2/h + h/2 γ + D
        self._flat_products = self._products.reshape(10, m * m)
        self._by_rate: Any = self._products.reshape(10 * m, m).dot
        self._by_shape: Any = np.concatenate([self._second, frame.coupling]).reshape(9 * m, m).dot
        self._by_turning: Any = frame.coupling.reshape(3 * m, m).dot
        self._table = np.zeros((ROWS, m))
        self._table[HALF_INERTIA1], self._table[MOMENTS] = frame.inertia1 / 2, frame.moment_modes
        self._table[BENT], self._table[COUPLED] = frame.inertia1 / 2, frame.coupling0
        self._table[TURNED] = frame.coupling0
        self._bent, self._coupled, self._turned, self._bent_by_rate, self._shaped, self._rated = (
            self._table[rows].reshape(-1)
            for rows in (BENT, COUPLED, TURNED, BENT_BY_RATE, slice(BENT.start, COUPLED.stop), slice(22, ROWS))
        )
        self._unshaped = self._shaped.copy()
        self._at_q, self._at_r = self._table[: BENT.stop], self._table[MOMENTS.start : COUPLED.stop]
        alone = not (self._couples or frame.coupling0.any() or frame.moment_modes.any())
        self._same_shape = Shape(tuple(frame.inertia0.tolist()), ZERO, ZERO, ZERO) if alone else None
        tied = frame.springs is not None or frame.dashpots is not None
        self.ties = GroundTies(frame) if tied else None
        self._inertia0, self._first_moment = frame.inertia0.tolist(), frame.first_moment.tolist()
        x, y, z = frame.origin.tolist()
        self.base: BaseState | None = None
        self._square = 0.0  # of the state
        self._surely_definite = math.inf  # up to which |e|² its kinetic energy is for sure, of a free body
        self.frame = self._frame_before = self._at_rest = FrameState((x, y, z), (1.0, 0.0, 0.0, 0.0), ZERO, ZERO)
        self._is_dense = self.elastic is not None or model.damping.ndim == 2
        self._terms = np.empty((2, m))
        self._eliminated = 0 if frame.carried else 3  # v̂, which contact has to do with, but x has not
        self.newton = KeptNewton(self._eliminated)
        # Of an expected step what it was found of, and the inverse slopes that go with that.
        self._ahead: tuple[Array, ...] | None = None
        self._forces = loads.at(np.zeros(loads.width))  # of the step
        self._turned_to = self.frame.rotation, np.eye(3)
        self._places = None  # of the contact points in this state
        if interface is not None:
            self.points = FramePoints(interface.points.coordinates - frame.origin, self._Sᵀ)

    def set_time_step(self, h: float) -> None:
        """As in Kernel."""
        super().set_time_step(h)
        γ, d = self._model.eigenvalues, self._model.damping
        self._diagonal = 2 / h + h / 2 * γ if self._is_dense else 2 / h + h / 2 * γ + d
        self._products[:6], self._products[6:9] = h / 2 * self._second, self._constants.coupling
        if self.elastic is not None:
            self.elastic.set_time_step(h)
            self._inert = 2 / h * np.eye(len(γ))
        else:
            self._products[9] = np.diag(self._diagonal) + d if self._is_dense else np.diag(self._diagonal)
        self._travel = h * self._ω
        if self.ties is not None:
            self.ties.set_time_step(h)
        self.newton.inverse = self._ahead = None
        self._elastic_and_inertial = np.stack([self._ω, np.full(len(γ), -2 / h)])
        if self._compiled is not None or compiled():
            self._make_loops()

    def take_by_loops(self) -> "CompiledFrame | None":
        """As in CompilableFrame."""
        made = self._make_loops()
        return None if made is None or made.pull is not None else made

    def _make_loops(self) -> "CompiledFrame | None":
        """What takes single steps, also those in which forces are found; None where there is more to them."""
        bent = pull = None
        if self.ties is not None or (self._found is not None and self._interface is not None):
            return None
        if self._compiled is not None and self._compiled.h == self.h:
            return self._compiled
        if self.elastic is not None:
            bent = self._bent_by_loops()
            if bent is None:
                return None
        from fenics_rom.runtime.steppers import compiled_frame, found_in_loops  # here, as numba takes time to import

        if self._found is not None:
            of_kind = found_in_loops.linear_pull if bent is None else found_in_loops.pull_of
            pull = of_kind(self._found, self._model.order, self._loads.width)
            if pull is None:
                return None

        frame, of_shape = (
            replace(self._constants, inertia2=self._second, stiffening=None),
            (self._products, self._couples),
        )
        body = compiled_frame.body_of(self._model, self.h, frame, *of_shape, self._surely_definite, bent is not None)
        touch = self._touch_by_loops()
        if self._compiled is not None:
            self._compiled.set_body(body, touch, bent)
            return self._compiled
        acting = compiled_frame.loads_of(self._loads), compiled_frame.watch_of(self._watch)
        halves = self._halves, self._state_before.reshape(2, -1)
        self._compiled = compiled_frame.CompiledFrame(body, *acting, *halves, frame.carried, bent)
        self._compiled.touch, self._compiled.pull = touch, pull
        return self._compiled

    def _bent_by_loops(self) -> "BentInLoops | None":
        """What resists the shape, as compiled functions have it; None where they do not know it."""
        from fenics_rom.runtime.steppers.bent_in_loops import BentInLoops  # here, as the file above
        from fenics_rom.runtime.steppers.compiled_deformation import is_known
        from fenics_rom.runtime.steppers.elastic.carried_strains import StrainsCarried

        extent, law, points = self._extent, self.elastic, 0 if self._interface is None else len(self.points.rest)
        if extent is None or not (is_known(law, extent.body) and isinstance(law, StrainsCarried)):
            return None
        frame = self._constants
        return BentInLoops(extent.body, law, self._following, frame.origin, points, frame.carried, self.h)

    def _touch_by_loops(self) -> "FrameTouch | None":
        """How obstacles touch the body; None where compiled functions do not know it, or nothing can.

        Rigid contact of points that a basis alone moves hardly tells forces apart.
        """
        residual, solver = self.residual, None if self._interface is None else self._interface.solver
        from fenics_rom.mechanics.compiled_contact import CompiledContact  # here, as the file below
        from fenics_rom.runtime.steppers import frame_touch

        if not isinstance(solver, CompiledContact) or (residual is None and solver.law.stiffness is None):
            return None
        if residual is not None and (residual.relaxes or not residual.is_whole):
            return None  # loops have the operators of all points as a whole
        return frame_touch.FrameTouch(solver, frame_touch.points_of(self.points, residual), self.h)

    def reset_buffer(self) -> None:
        """As in Kernel."""
        super().reset_buffer()
        self.forget()

    def rollback(self) -> None:
        """As in Kernel."""
        super().rollback()
        self.frame, self._now, self._places = self._frame_before, self._now_before, None
        if self.ties is not None:
            self.ties.rollback()
        self.forget()

    def forget(self) -> Shape:
        """Forgets what was kept of steps that led elsewhere; the shape that the body has."""
        if self._compiled is not None:
            self._compiled.forget()
        self.newton.inverse = self._ahead = None
        self._square = self._twice_within()
        return self._shape_at(self._coordinates(), self._r)

    def _with_carried_energy(self, energy: float) -> float:
        """As in BookedKernel; with what springs to the ground store."""
        energy = super()._with_carried_energy(energy)
        return energy if self.ties is None else energy + self.ties.placed.stored

    def begin(self) -> None:
        """Puts the frame where it is at rest."""
        self.place(self._at_rest)

    def place(self, frame: FrameState) -> None:
        """Puts the frame where it is to be; `turning` is its angular velocity in world axes, rad/s."""
        raise NotImplementedError

    def point_displacement(self) -> Array:
        """As in Kernel."""
        assert self._interface is not None
        return self.point_places() - self._interface.points.coordinates

    def point_places(self) -> Array:
        """As in BookedKernel."""
        places: Array = self.places().dot(self._rotation.T)
        places += np.array(self.frame.position)
        return places

    @property
    def _rotation(self) -> Array:
        """R (3, 3), kept as long as the frame does not turn."""
        if self._turned_to[0] != self.frame.rotation:
            self._turned_to = self.frame.rotation, rotation_matrix(self.frame.rotation)
        return self._turned_to[1]

    def places(self) -> Array:
        """Of the contact points in the frame, (P, 3), m; not to be changed."""
        if self._places is None:
            places = self.points.rest + self.points.moved(self._coordinates())
            self._places = places if self.residual is None else places + self.residual.displacement
        return self._places

    def resume(self, auxiliary: Array) -> None:
        """As in Kernel."""
        self._places = None
        super().resume(auxiliary)
        self.move_on()
        if self.ties is not None:
            self.ties.place(self.frame.position, rotation_of(*self.frame.rotation), self._coordinates().copy())

    def move_on(self) -> None:
        """Takes note of rates r and a frame that were set; what resists the shape goes on as it was."""
        q, shape, R = self._coordinates().copy(), self.forget(), rotation_of(*self.frame.rotation)
        self._now = self._now_before = self._motion_from(q, shape, R)

    def _motion_from(self, q: Array, shape: Shape, R: Rotation) -> Any:
        """How the body moves from here, of its coordinates q (m,)."""
        raise NotImplementedError

    @property
    def _motion_felt(self) -> tuple[Vector | None, Vector | None, Vector]:
        """Acceleration less gravity's, angular acceleration and spin in the last step; None of what strains nothing."""
        return None, None, self.angular_velocity

    @property
    def angular_velocity(self) -> Vector:
        """In the frame's axes, rad/s."""
        raise NotImplementedError

    def _begun(self, u: Array) -> FrameForces:
        """Begins a step under u (p,); what acts in the frame."""
        self._begin(u)
        return self._loads.at(self._acting) if self.elastic is None else self._forces_as_expected()

    def _forces_as_expected(self) -> FrameForces:
        """What acts in the frame, with pressures on open surfaces where the shape is if it moves on as it did."""
        elastic = self.elastic
        return self._forces_at(self._start if elastic is None else self._start + self.h / 2 * elastic.velocity)

    def _forces_at(self, expected: Array) -> FrameForces:
        """The same where the shape is expected there (m,)."""
        forces, following = self._loads.at(self._acting), self._following
        if following is None or not following.rims:
            return forces
        wrench = following.wrench(self._acting, expected, self._constants.origin)
        force, torque = vector(wrench[:3]), vector(wrench[3:])
        return forces._replace(force=added(forces.force, 1.0, force), torque=added(forces.torque, 1.0, torque))

    def _shape_at(self, q: Array, r: Array) -> Shape:
        """The inertia there, which the table is of from now on."""
        if self._same_shape is not None:
            return self._same_shape
        if self._couples:
            self._by_shape(q, self._shaped)
            np.add(self._shaped, self._unshaped, self._shaped)
        a1, b1, c1, d1, e1, f1, u, v, w, a2, b2, c2, d2, e2, f2 = self._at_q.dot(q).tolist()
        cx, cy, cz, _, _, _, _, _, _, bx, by, bz = self._at_r.dot(r).tolist()
        (a0, b0, c0, d0, e0, f0), (x, y, z) = self._inertia0, self._first_moment
        return Shape(
            (a0 + a1 + a2, b0 + b1 + b2, c0 + c1 + c2, d0 + d1 + d2, e0 + e1 + e2, f0 + f1 + f2),
            (bx, by, bz),
            (x + u, y + v, z + w),
            (cx, cy, cz),
        )

    def _give(self, modal: Array) -> None:
        """The rows of the table that do not change within a step, under forces (m,) on the coordinates."""
        given = self._table[GIVEN]
        if self.elastic is None:
            np.multiply(self._elastic_and_inertial, self._halves, self._terms)
            np.add(self._terms[0], self._terms[1], given)
        else:
            np.multiply(self._elastic_and_inertial[1], self._r, given)
        np.subtract(given, modal, given)
        if self._couples:
            self._by_turning(self.h / 2 * self._r, self._turned)
            np.add(self._turned, self._coupled, self._turned)

    def _move(self, rate: Array) -> None:
        """The rows of the table that depend on a mid-step rate (m,)."""
        self._by_rate(rate, self._rated)
        np.add(self._bent_by_rate, self._bent, self._bent_by_rate)

    def _prescribed(self, forces: FrameForces, turn: Geometry, q: Array, rate: Array, h: float) -> Push | None:
        """What prescribed forces do in a step of h s from q at a mid-step rate (m,)."""
        if forces.at_points is None:
            return None
        points = self._loads.points
        start = points.rest + points.moved(q)
        return points.push(forces.at_points, turn, arms_of(turn, start, start + h * points.moved(rate)))

    @property
    def distrusted(self) -> bool:
        """Whether the body bent or turned further than its model is to be trusted."""
        return bool(self._watch.messages(self.notes))

    @property
    def watch(self) -> FrameWatch:
        """Of what the model does not follow."""
        return self._watch

    @property
    def messages(self) -> tuple[str, ...]:
        """As in Kernel."""
        return *self._watch.messages(self.notes), *super().messages

    def _finish(self, contact: ContactSolution | None, power: float, supplied: float, dissipated: float) -> None:
        """The end of a step but for the state: what is to be booked; contact forces had a power, W."""
        contacts: ContactWorks = () if contact is None else (partial(contact.work_at, power, self.h),)
        self._leave(StepWork(supplied, dissipated, contacts))
        self.contact, self._frame_before = contact, self.frame
        if self.found is not None:
            self.reactions = self.reactions_found

    def _arrive(self, e: Array, r: Array) -> float:
        """Where a step led, but for the frame; twice the stored energy, J."""
        if self._compiled is not None:
            self._compiled.forget()
        self._e[:], self._r[:], self._places = e, r, None
        self._square = self._twice_within()
        if self.elastic is not None:
            self.elastic.note(self.notes)
        self._watch.look(e, self._square, self.angular_velocity, self.notes)
        if self._extent is not None:
            self._extent.look(self.notes, self._acting, e * self._inverse_ω, self.contact, self.h)
            self._extent.look_at_frame(self.notes, *self._motion_felt)
        return 2 * self.energy
