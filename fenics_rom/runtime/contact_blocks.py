"""Blocks of steps of a linear body among obstacles in which all contact pairs do what they did, for rollouts.

A step is taken by itself until the same pairs have done the same for some steps. Then a block of steps is, at once
(`kept_contact`), and what of it fulfils the law stays. The step after it is taken by itself: it finds what the block
could not, and keeps what a search begins with. Blocks grow while they hold; where one does not, it takes twice as many
steps until the next one, so that contact that is another in every step costs nothing more.
"""

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.complementarity import Frames, KeptLaw
from fenics_rom.mechanics.points_operator import moved_by
from fenics_rom.runtime.kept_contact import SAME_NORMALS, KeptContactMap, KeptPairs, KeptSteps, Meeting, leading

if TYPE_CHECKING:
    from fenics_rom.runtime.steppers.contact_interface import ContactInterface

Simulator = Any  # fenics_rom.runtime.simulator's, which imports this file through rollout

FIRST_BLOCK, LONGEST_BLOCK = 8, 64  # steps
FIRST_WAIT, LONGEST_WAIT = 4, 512  # steps in which pairs do the same, before the next block
MOST_KEPT_MAPS = 4  # of those pairs that were followed last
LARGEST_STATE = 800  # numbers; the maps of larger ones take longer to make than they save


class ContactBlocks:
    """Takes blocks of steps of a linear body among obstacles."""

    def __init__(self, body: Simulator) -> None:
        self._body, interface = body, body.integrator.interface
        assert interface is not None
        self._interface: ContactInterface = interface
        self._maps: dict[tuple[Any, ...], KeptContactMap] = {}
        self._last: tuple[Any, ...] = ()
        self._frames: Frames | None = None
        self._same, self._wait, self._length = 0, FIRST_WAIT, FIRST_BLOCK

    def begin(self) -> None:
        """Forgets what was before a rollout: whatever was in between."""
        self._last, self._same = (), 0

    def count(self) -> None:
        """Takes note of what all pairs did in the last step."""
        kept = self._kept()
        self._same = self._same + 1 if kept == self._last and kept else 0
        self._last = kept

    def _kept(self) -> tuple[Any, ...]:
        """That tells it: contact mode, step size, where the obstacle is, which pairs took part, and what they did.

        Empty where the next steps cannot be taken as a block.
        """
        body, solver = self._body, self._interface.solver
        environment, kernel = body.environment, body.integrator.kernel
        known = body.contact, body.dt, environment.state.offsets.tobytes()
        if not environment.stands_still or environment.mark is not None or kernel.branches is not None:
            return ()
        acting = environment.environment
        if len(solver.obstacles) > 1 or solver.law.stiffness is not None or acting.self_contact or acting.touches_faces:
            return ()
        if kernel.contact is None:
            return (*known, bytes(len(solver.points)), b"")
        if not solver.follows:
            return ()
        chosen, law = solver.search.laws[0]
        if law.inverse is None or not self._keeps_normals(np.frombuffer(chosen, dtype=bool)):
            return ()
        return (*known, chosen, law.statuses)

    def _keeps_normals(self, chosen: Array) -> bool:
        """Whether pairs (P,) have the normals of the step before; those that slip on what is round do not."""
        before, self._frames = self._frames, self._interface.solver.search.frames
        if before is None or self._frames is None or before is self._frames:
            return before is self._frames
        return bool(np.abs((before.normals - self._frames.normals)[chosen]).max() <= SAME_NORMALS)

    def take(self, u: Array) -> tuple[KeptContactMap, KeptSteps] | None:
        """Takes some of the steps under inputs u at once; None where none was."""
        steps = min(self._length, 1 << len(u).bit_length() >> 1)
        if self._same < self._wait or steps < FIRST_BLOCK:
            return None
        body, law = self._body, None
        if body.integrator.kernel.contact is not None:
            law = self._interface.solver.search.laws[0][1]
        kept_map = self._map(law)
        found = None
        if kept_map is not None:
            φ = kept_map.guess(*((law.forces, law.q) if law is not None else np.empty((2, 0))))
            found = kept_map.take(self._state(kept_map.carried), u[:steps], φ)
        count = 0 if found is None else self._in_mode(found)
        if count == steps:
            self._same, self._wait, self._length = self._wait, FIRST_WAIT, min(2 * self._length, LONGEST_BLOCK)
        else:
            self._same, self._length = 0, FIRST_BLOCK
            self._wait = FIRST_WAIT if count >= FIRST_BLOCK else min(2 * self._wait, LONGEST_WAIT)
        is_old = kept_map is not None and law is not None and kept_map.pairs.inverse is not law.inverse
        if not count or (count < steps and is_old):
            self._maps.pop(self._last, None)  # the next one is of the law as it is then
        if not count or found is None or kept_map is None:
            return None
        found = found.first(count)
        self._commit(kept_map, found, law)
        return kept_map, found

    def _map(self, law: KeptLaw | None) -> KeptContactMap | None:
        """The map of steps like the last one; None where it would be too large."""
        kernel, interface = self._body.integrator.kernel, self._interface
        chosen = np.frombuffer(self._last[3], dtype=bool)
        carried = chosen.copy()
        if kernel.residual is not None:
            g, _, ġ, _ = kernel.residual.state.reshape(4, len(chosen), 3)
            carried |= g.any(axis=1) | ġ.any(axis=1)
        carried = carried.nonzero()[0] if kernel.residual is not None else np.empty(0, dtype=int)
        known = self._maps.get(self._last)
        if known is not None and np.array_equal(known.carried, carried):
            return known
        model = self._body.model
        if 2 * model.order + 6 * len(carried) > LARGEST_STATE:
            return None
        points = interface.solver.points - self._body.environment.state.offsets[0]
        meeting = Meeting(
            interface.solver.law, interface.solver.obstacles[0], points, interface.rows @ model.coordinates
        )
        active, frames = chosen.nonzero()[0], interface.solver.search.frames
        if law is None or law.inverse is None or frames is None:
            pairs = KeptPairs(chosen, None, np.empty((0, 0)))
        else:
            frames = Frames(frames.normals[active])
            pairs = KeptPairs(chosen, frames, law.inverse)
        residual = None if kernel.residual is None else kernel.residual.maps
        made = KeptContactMap(model, self._body.dt, residual, carried, meeting, pairs)
        self._maps.pop(self._last, None)
        self._maps = dict(list(self._maps.items())[1 - MOST_KEPT_MAPS :]) | {self._last: made}
        return made

    def _state(self, carried: Array) -> Array:
        """x (n,) of the body now."""
        stepper, kernel = self._body.integrator, self._body.integrator.kernel
        rows = np.empty((0, 0)) if kernel.residual is None else kernel.residual.state.reshape(4, -1, 3)[::2, carried]
        x = np.concatenate([kernel.state, rows.ravel()])
        x[: len(stepper.rigid_displacement)] = stepper.rigid_displacement
        return x

    def _in_mode(self, steps: KeptSteps) -> int:
        """How many of them begin in the contact mode that obstacles ask for."""
        body = self._body
        if not body.switches_itself:
            return len(steps.inputs)
        modes, points = list(body.rom.contact_models), self._interface.points
        active = np.full(len(steps.inputs), modes.index(body.contact))
        return leading(points.nearest_modes(steps.gaps.T, active) == active)

    def _commit(self, kept_map: KeptContactMap, steps: KeptSteps, law: KeptLaw | None) -> None:
        """The body, its account and the next search go on from the end of these steps."""
        body, solver = self._body, self._interface.solver
        stepper, kernel, m = body.integrator, body.integrator.kernel, body.model.order
        e, r, g, ġ = kept_map.split(steps.states[-1])
        if body.ledger is not None:
            works = kept_map.works(steps)
            body.ledger.book(supplied=works.supplied, dissipated=works.dissipated)
            body.ledger.book_contact(0.0, works.contact, works.friction, 0.0)
        rigid = len(stepper.rigid_displacement)
        stepper.rigid_displacement[:] = e[:rigid]
        kernel.state[:m], kernel.state[m:] = e, r
        kernel.state[:rigid] = 0.0
        if kernel.residual is not None:
            R, rows = kernel.residual.part.operator, np.zeros((4, *solver.points.shape))
            rows[0, kept_map.carried], rows[2, kept_map.carried] = g.reshape(-1, 3), ġ.reshape(-1, 3)
            rows[1], rows[3] = (moved_by(R, row).reshape(-1, 3) for row in rows[::2])
            kernel.resume(rows.ravel())
        if law is not None:
            (key, _), *others = solver.search.laws
            q, forces = (kept_map.in_lasting_axes(values[-1]) for values in (steps.q, steps.forces))
            last = law._replace(q=q, forces=forces, lacking=0.0)
            solver.search = solver.search._replace(laws=((key, last), *others))
        body.steps += len(steps.inputs)
        body.watch(kernel.state[:m], 2 * body.energy, body.time, len(steps.inputs))
        body.look_at_skin()

    def columns(self, kept_map: KeptContactMap, by_q: Array, by_force: Array) -> Array:
        """Displacements of outputs from states x, (n, width), by their maps; see `stepped_rollout.output_maps`."""
        columns = [kept_map.by_state[:, None] * by_q, np.zeros_like(by_q)]
        if self._body.integrator.kernel.residual is not None:
            carried = by_force.reshape(-1, 3, by_force.shape[1])[kept_map.carried].reshape(-1, by_force.shape[1])
            columns += [carried, np.zeros_like(carried)]
        return np.vstack(columns)
