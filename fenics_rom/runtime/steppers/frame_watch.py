"""What a body in a moving frame does beyond what its model follows, to tell the user."""

from collections.abc import Mapping

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.frame_motion import Vector, dot
from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.rom.rom import Rom

LARGEST_DEFLECTION = 0.05  # of the length of the body: small strains are off by some 15 % of the elastic motion there
UNSTIFFENED = 0.05  # of the first frequency: 18 times its square is what stiffening that is left out costs, some 5 %
QUASI_RIGID = 3e-3  # of it: what shapes do to inertia is 6 % of the elastic motion of a slender body there
BENT, TURNED = "deflection", "angular velocity"  # notes of a kernel


class FrameWatch:
    """Looks at the nodes where the stored energy would allow them to be too far from where they are at rest.

    Args:
        rom: of displacements that strain.
        model: of the contact mode.
        detail: of the moving frame.

    Attributes:
        farthest: the square of how far a node can be at most, per |e|², m²/J.
        limit: how far one may be, m.
        rows: displacements of the nodes of the surface (3 V, m), per e.
    """

    def __init__(self, rom: Rom, model: ContactModel, detail: str):
        self._first, self._detail = 2 * np.pi * rom.first_frequency, detail
        is_large = rom.deformation is not None  # its potential knows how stresses stiffen it
        self._is_stiffened = is_large or (rom.moving_frame is not None and rom.moving_frame.stiffening is not None)
        self._length = float(np.ptp(rom.nodes, axis=0).max()) if len(rom.nodes) else np.inf
        nodes = np.unique(rom.triangles)
        self.rows = rom.rows_of(nodes).reshape(-1, rom.basis.shape[1]) @ model.coordinates / model.safe_frequencies
        blocks = self.rows.reshape(-1, 3, model.order)
        farthest = np.linalg.eigvalsh(blocks @ blocks.transpose(0, 2, 1))[:, -1].max(initial=0.0) if len(nodes) else 0.0
        self.farthest, self.limit = float(farthest), (np.inf if is_large else LARGEST_DEFLECTION * self._length)
        slow = QUASI_RIGID if detail != "full" else np.inf if self._is_stiffened else UNSTIFFENED
        self._fastest = slow * self._first
        self._looked_at = np.zeros(model.order), 0.0  # last, and how far it was bent there

    @property
    def notes(self) -> dict[str, float]:
        """Of a run that begins."""
        return {BENT: 0.0, TURNED: 0.0}

    def look(self, e: Array, square: float, ω: Vector, notes: dict[str, float]) -> None:
        """Notes how far the state √γ q (m,) is bent, if it is too far, and how fast it turns, rad/s.

        |e|² is at most `square`.
        """
        if dot(ω, ω) > notes[TURNED] ** 2:
            notes[TURNED] = dot(ω, ω) ** 0.5
        most = max(self.limit, notes[BENT])
        if self.farthest * square > most**2:  # else it is no farther than it was
            there, bent = self._looked_at
            change = e - there
            if bent + (self.farthest * float(change.dot(change))) ** 0.5 > most:  # else it has not got so far since
                bent = float(np.sqrt(np.square(self.rows.dot(e).reshape(-1, 3)).sum(axis=1).max()))
                self._looked_at = e.copy(), bent
                notes[BENT] = max(notes[BENT], bent)

    def distrusts(self, e: Array, speed: Array) -> Array:
        """Which of bodies (B,) in states √γ q (B, m), that turn at a speed (B,), rad/s, go too far."""
        distrusted = speed > self._fastest
        looked_at = (self.farthest * np.square(e).sum(axis=1) > self.limit**2).nonzero()[0]
        for body in looked_at:
            distrusted[body] |= np.square(self.rows.dot(e[body]).reshape(-1, 3)).sum(axis=1).max() > self.limit**2
        return distrusted

    def went_too_far(self, bent: Array, speed: Array) -> Array:
        """Which of bodies (B,) did, that bent by so much at most, m, and turned at that speed, rad/s."""
        too_far: Array = (bent > LARGEST_DEFLECTION * self._length) | (speed > self._fastest)
        return too_far

    def messages(self, notes: Mapping[str, float]) -> tuple[str, ...]:
        """What the user should know."""
        told, share, speed = list[str](), notes[BENT] / self._length, notes[TURNED] / self._first
        if share > LARGEST_DEFLECTION:
            told.append(
                f"moving frame: the body bent by up to {notes[BENT]:.2g} m in its frame, {share:.0%} of its length; "
                f"beyond {LARGEST_DEFLECTION:.0%} small strains are off by more than some 15 % of the elastic motion"
            )
        turning = (
            f"moving frame: the body turned at up to {notes[TURNED]:.3g} rad/s, {speed:.2g} of its first frequency"
        )
        if self._detail != "full" and speed > QUASI_RIGID:
            told.append(
                f"{turning}, and detail = {self._detail!r} leaves out what shapes do to inertia: of slender bodies "
                f"that is some 6 % of the elastic motion at {QUASI_RIGID:g}; a stubby one bears more"
            )
        elif not self._is_stiffened and speed > UNSTIFFENED:
            told.append(
                f"{turning}, and the model does not know how its rotation stiffens it: in five periods the elastic "
                f"motion is off by some {18 * speed**2:.0%}"
            )
        return tuple(told)
