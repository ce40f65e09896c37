"""Saying when a run with large deformation goes beyond its model's training: shapes, inputs, strains and contact.

A body that an obstacle holds may be pulled much harder than in training without going any further.
"""

import math
import warnings
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import FenicsRomWarning
from fenics_rom.mechanics.contact import ContactSolution
from fenics_rom.mechanics.frame_motion import Vector
from fenics_rom.rom.deformation import TrainingRange, resultant
from fenics_rom.rom.material_points import MaterialPoints
from fenics_rom.rom.rom import Rom

if TYPE_CHECKING:
    from fenics_rom.runtime.steppers.contact_interface import ContactInterface

Notes = dict[str, float]

# Loads are known exactly: beyond a few per cent it is another load. Strains and contact are the model's own, whose
# shapes are wrong by 2 to 8 % where it was not trained (`validation_error`): what goes further is of another run.
TRUSTED_LOAD, TRUSTED_STRAIN = 1.05, 1.1  # times what training saw
TRUSTED_EXTENT = 1.5  # times as far as the states that the model was trained on
LOCAL_STRAIN = 0.5  # of the largest strain of training, up to which any point may go: obstacles press in places
MINOR_AXIS = 0.1  # of the largest of a frame's motions, up to which it may move along or about any axis
HARDLY = 1e-6  # m/s², rad/s² or rad/s: of a frame that stood still
LOOKED_AT_ONCE = 32  # shapes in a row
NEVER = 1e-100  # what stands for an input that was not there
STRAIN = "strain"  # of the kept point that went furthest beyond its own in training
TOUCHED = "touched"  # whether an obstacle pushed
DISTANCE = "distance"  # |q| at most


class TrainingWatch:
    """Compares shapes, inputs, strains of the kept points and forces of contact with training, in every step.

    Args:
        rom: the reduced model.
        interface: the contact points, if there are any.

    Attributes:
        body: what it looks at.
        notes: names of what it keeps of a run, numbers that begin at 0: what went beyond, how far, in its unit.
    """

    def __init__(self, rom: Rom, interface: "ContactInterface | None"):
        assert rom.deformation is not None
        self.body = body = rom.deformation
        self._points = MaterialPoints(body)
        self._radius, trained = body.training_radius, body.trained or _unknown_range(rom)
        widths, units = {**rom.actuators, **rom.loads}, rom.environment.input_units
        acting = rom.environment
        found = dict.fromkeys((*acting.guides, *acting.controls), math.inf)  # as large as they must be: strains tell
        inputs = {**trained.inputs, **found}
        self._pushed = trained.pushes
        self._pushers: list[str] = []
        if interface is not None:
            self._pushers = [f"obstacle {name!r}" for name in interface.environment.obstacles]
            if not (self._pushers or interface.environment.environment.self_contact):  # then it is in a world
                self._pushers = ["other bodies"]
        most = max(trained.pushes.values(), default=0.0)
        self._ranges = {f"input {name!r}": (inputs.get(name, 0.0), units.get(name, "N")) for name in widths}
        ends = np.cumsum([0, *widths.values()]).tolist()
        self._inputs = dict(zip(self._ranges, map(slice, ends, ends[1:]), strict=True))  # of those after the pushes
        self._ranges |= {f"the push on {name!r}": (trained.pushes.get(name, 0.0), "N") for name in rom.contact_models}
        self._ranges |= {f"the force of {name}": (most, "N") for name in self._pushers}
        self._of_frame = [_of_axes(*of) for of in _frame_ranges(trained)] if acting.is_moving else []
        for names, largest, unit in self._of_frame:
            self._ranges |= {name: (limit, unit) for name, limit in zip(names, largest, strict=True)}
        limits = [max(self._ranges[name][0], NEVER) for name in self._inputs]
        self._limits = np.repeat(limits, list(widths.values()))
        self._whose = np.repeat(1 + np.arange(len(widths)), list(widths.values()))
        strains = np.maximum(trained.strains, LOCAL_STRAIN * trained.strains.max(initial=NEVER))
        self._inverse_squares, self._stretched = strains**-2.0, np.sqrt(1 + 2 * TRUSTED_STRAIN * strains)
        # |ΔH| <= |y| / reach of each point (P,), with y_k = scale_k Δq_k, scale_k the largest |∇W_k| (m,).
        self._scale = np.sqrt(np.square(body.gradients).sum(axis=(0, 1)).max(axis=0))
        blocks = (body.gradients / self._scale.clip(NEVER)).reshape(9, len(strains), -1).swapaxes(0, 1)
        self._reach = 1 / np.sqrt(np.linalg.eigvalsh(blocks @ blocks.swapaxes(1, 2))[:, -1].clip(NEVER))
        # |y| up to which, from the shape that was looked at, no point's strain is beyond training.
        self._looked_at, self._clear = np.zeros(body.order), -1.0
        self._means = [f"mean force of {name}, {axis}" for name in self._pushers for axis in "xyz"]
        self._smoothing_time = trained.smoothing_time
        self.notes = (DISTANCE, *self._ranges, STRAIN, TOUCHED, *self._means)

    def enter(self, contact: str, width: int) -> None:
        """Watches a contact mode of so many inputs, of which its pushes are the first."""
        self._contact = contact
        self._columns = columns = width - len(self._limits)
        push = max(self._pushed.get(contact, 0.0), NEVER) / math.sqrt(max(columns / 3, 1.0))  # of each column
        self._inverse_limits = 1 / np.concatenate([np.full(columns, push), self._limits])
        whose = np.concatenate([np.zeros(columns, int), self._whose])  # 0: the push
        self._of_each = np.equal.outer(np.arange(1 + len(self._inputs)), whose).astype(float)

    def messages(self, notes: Mapping[str, float]) -> tuple[str, ...]:
        """What is to be said of a run that went beyond training."""
        far = notes[DISTANCE]
        too_far = self._too_far(far) if far > TRUSTED_EXTENT * self._radius else ""
        return tuple(filter(None, [too_far, self._beyond(notes)]))

    def _too_far(self, far: float) -> str:
        return (
            f"the body went {far / self._radius:.2g} times as far as in any state that the model was trained on; "
            f"beyond {TRUSTED_EXTENT:g} times it is not to be trusted: reduce with larger loads"
        )

    def _beyond(self, notes: Mapping[str, float]) -> str:
        """What to say but of how far it went; empty where nothing was beyond training."""
        excess = []
        for what, (limit, unit) in self._ranges.items():
            if value := notes[what]:
                share = f"{value / limit:.3g} times the {limit:.3g} {unit} of" if limit else "and was not there in"
                excess.append(f"{what} reached {value:.3g} {unit}, {share} training")
        if notes[STRAIN]:
            excess.append(f"the strain of a kept point reached {notes[STRAIN]:.3g} times that of training")
        gone = "; ".join(excess)
        return (
            gone
            and f"beyond what the model was trained on: {gone}; it is not to be trusted there: reduce with such loads"
        )

    def look(self, notes: Notes, u: Array, q: Array, contact: ContactSolution | None, h: float) -> None:
        """Notes a step of h s under u (p,), N, that led to q; warns of the first one beyond training."""
        shares = u * self._inverse_limits
        if shares.dot(shares) > TRUSTED_LOAD**2:  # else none of them is beyond
            self._look_at_shares(notes, u, shares)
        self._look_at_shape(notes, q)
        if len(self._pushers) and (contact is not None or notes[TOUCHED]):
            forces = np.zeros((len(self._pushers), 3)) if contact is None else contact.by_obstacle
            self._look_at_contact(notes, forces[None], h)
        self._look_at_distance(notes, math.sqrt(q.dot(q)))

    @property
    def watched(self) -> tuple[Array, Array, Array]:
        """What says whether there is anything to `look` at: 1 over limits of inputs (p,), scales (m,), a shape (m,)."""
        return self._inverse_limits, self._scale, self._looked_at

    def limits(self, notes: Notes) -> tuple[float, float, float]:
        """Where |u / limits|², |scale (q - shape)| and |q| are not beyond these, there is nothing."""
        return TRUSTED_LOAD**2, self._clear, notes[DISTANCE]

    def look_along(self, notes: Notes, u: Array, q: Array, forces: Array, h: float) -> None:
        """The same of n steps in a row, under u (n, p), to q (n, m), with forces of the obstacles (n, O, 3), N."""
        shares = u * self._inverse_limits
        for step in (np.einsum("np,np->n", shares, shares) > TRUSTED_LOAD**2).nonzero()[0]:
            self._look_at_shares(notes, u[step], shares[step])
        rest = q
        while len(rest):
            y = self._scale * (rest[:LOOKED_AT_ONCE] - self._looked_at)
            near = np.sqrt(np.einsum("nm,nm->n", y, y)) <= self._clear
            if near.all():
                rest = rest[LOOKED_AT_ONCE:]
                continue
            first = int(near.argmin())
            self._look_at_shape(notes, rest[first])
            rest = rest[first + 1 :]
        touched = forces.any(axis=(1, 2))
        if notes[TOUCHED] or touched.any():
            self._look_at_contact(notes, forces if notes[TOUCHED] else forces[touched.argmax() :], h)
        self._look_at_distance(notes, math.sqrt(np.einsum("nm,nm->n", q, q).max()))

    def _look_at_distance(self, notes: Notes, far: float) -> None:
        before, limit = notes[DISTANCE], TRUSTED_EXTENT * self._radius
        if far > before:
            notes[DISTANCE] = far
            if before <= limit < far < math.inf:
                warnings.warn(self._too_far(far), FenicsRomWarning, stacklevel=6)

    def look_at_frame(self, notes: Notes, *motion: Vector | None) -> None:
        """Notes how a frame moved in a step: its acceleration less gravity's, its angular acceleration, its spin.

        Each along or about the axes of the frame; None of what is not looked at.
        """
        for (names, largest, _), moved in zip(self._of_frame, motion, strict=False):
            for name, limit, value in zip(names, largest, moved or (), strict=False):
                if abs(value) > TRUSTED_LOAD * limit:
                    self._note(notes, name, abs(value))

    def _look_at_shape(self, notes: Notes, q: Array) -> None:
        """Looks at the strains of a shape, unless one that was looked at is so near that none can be beyond training.

        |E + ΔE| <= |E| + |F| |ΔH| + ½ |ΔH|², |F|² <= 1 + 2 |E|.
        """
        y = self._scale * (q - self._looked_at)
        if math.sqrt(y.dot(y)) <= self._clear:
            return
        squares = self._points.strain_squares(q)
        share = float((squares * self._inverse_squares).max())
        if share > TRUSTED_STRAIN**2:
            self._note(notes, STRAIN, math.sqrt(share))
        self._looked_at[:], strains = q, np.sqrt(squares)
        self._clear = float(((self._stretched - np.sqrt(1 + 2 * strains)) * self._reach).min())

    def _look_at_shares(self, notes: Notes, u: Array, shares: Array) -> None:
        """Notes what of u is beyond training, with the shares that its columns have of that."""
        if not (self._of_each.dot(shares * shares) <= TRUSTED_LOAD**2).all():
            self._look_at_loads(notes, u)

    def _look_at_loads(self, notes: Notes, u: Array) -> None:
        shared = u[self._columns :]
        values = {name: math.sqrt(shared[part].dot(shared[part])) for name, part in self._inputs.items()}
        if self._columns:
            values[f"the push on {self._contact!r}"] = resultant(u[: self._columns])
        for what, value in values.items():
            if value > TRUSTED_LOAD * self._ranges[what][0]:
                self._note(notes, what, value)

    def _look_at_contact(self, notes: Notes, forces: Array, h: float) -> None:
        """Forces of obstacles in steps (n, O, 3), averaged: what pushes for less time moves the body by less."""
        mean, means = np.array([notes[name] for name in self._means]).reshape(-1, 3), np.empty(forces.shape)
        share = h / (h + self._smoothing_time)
        for step, pushing in enumerate(forces):
            mean = mean + share * (pushing - mean)
            means[step] = mean
        notes.update(zip(self._means, mean.ravel().tolist(), strict=True))
        notes[TOUCHED] = 1.0
        largest = np.sqrt((means**2).sum(axis=2).max(axis=0))
        for name, size in zip(self._pushers, largest.tolist(), strict=True):
            what = f"the force of {name}"
            if size > TRUSTED_STRAIN * self._ranges[what][0]:
                self._note(notes, what, size)

    def _note(self, notes: Notes, what: str, value: float) -> None:
        before = notes[what]
        if not before < value < math.inf:
            return
        notes[what] = value
        if not before:
            warnings.warn(self._beyond(notes), FenicsRomWarning, stacklevel=7)


def _unknown_range(rom: Rom) -> TrainingRange:
    """What files that do not tell how far training went are compared with: nothing is beyond it."""
    assert rom.deformation is not None
    named = (*rom.actuators, *rom.loads), tuple(rom.contact_models)
    inputs, pushes = (dict.fromkeys(names, math.inf) for names in named)
    return TrainingRange(inputs, pushes, np.full(len(rom.deformation.weights), math.inf), 0.0)


def _frame_ranges(trained: TrainingRange) -> list[tuple[str, Array | None, str]]:
    """What of a moving frame's motion is looked at, how far training went (3,), and its unit."""
    return [
        ("the acceleration of the base, less gravity's, along", trained.accelerations, "m/s2"),
        ("the angular acceleration of the base about", trained.angular_accelerations, "rad/s2"),
        ("the spin of the frame about", trained.spins, "rad/s"),
    ]


def _of_axes(what: str, largest: Array | None, unit: str) -> tuple[list[str], list[float], str]:
    """Names of a motion along or about each axis, and how far it may go; none where it was not looked at."""
    if largest is None:
        return [], [], unit
    least = max(MINOR_AXIS * float(largest.max()), HARDLY)
    return [f"{what} {axis}" for axis in "xyz"], np.maximum(largest, least).tolist(), unit
