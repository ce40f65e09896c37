"""The Delassus operator of some pairs, in the frames of their normals, and what of it is kept for later steps.

In a frame a vector of every pair is (3, C): along its normal, and along its two tangents; flattened, (3C,) has all
normal parts first. What is kept here follows from the operator alone, so that no result depends on what was solved
before; only where an operator nearly is one of before its searches may be guided by that one's inverse.
"""

from functools import cached_property

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.complementarity.solution import REGULAR_SHARE, largest
from fenics_rom.mechanics.points_operator import Operator, operator_of

_AXES, _ONES = np.eye(3), np.ones(3)
_ROUND_OFF = 4 * float(np.finfo(float).eps)  # of unit vectors
_LARGEST_CONDITION = 1e8  # of what counts as regular: Newton's steps correct what a solution lacks
_NEARLY = 1e-2  # of the least pivot: operators that differ by less guide each other's searches


class Frames:
    """Frames of pairs with unit normals (C, 3): of each its normal, and two tangents.

    Axes that last are those of the frame where all normals are alike, and elsewhere those of space: in them W stays the
    same from step to step, even where normals turn with the points.

    Attributes:
        normals: as given.
        are_alike: whether all of them are the same.
    """

    def __init__(self, normals: Array):
        self.normals, self._bytes = normals, normals.tobytes()
        self.are_alike = self._bytes == self._bytes[:24] * len(normals)
        self._picked: tuple[Array, Frames] | None = None

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Frames) and self._bytes == other._bytes

    def __hash__(self) -> int:
        return hash(self._bytes)

    @cached_property
    def axes(self) -> Array:
        """(C, 3, 3), whose columns these are; (1, 3, 3) where all normals are alike."""
        return axes_along(self.normals[:1] if self.are_alike else self.normals)

    @cached_property
    def _turn(self) -> Array:
        """(3, 3) from space to the frame of all, where normals are alike."""
        return self.axes[0].T

    @cached_property
    def lasting_normals(self) -> Array | None:
        """(3, C) in axes that last; None where they are the first of these."""
        return None if self.are_alike else np.ascontiguousarray(self.normals.T)

    def are(self, normals: Array) -> bool:
        """Whether other normals (C, 3) are these, to the last bit."""
        return normals.tobytes() == self._bytes

    def are_along(self, normals: Array) -> bool:
        """Whether other normals (C, 3) are these, to round-off."""
        if normals.shape != self.normals.shape or abs(normals.item(0) - self.normals.item(0)) > _ROUND_OFF:
            return False  # to see it of one number takes a tenth of the time
        if self.are(normals):  # six times as fast as to compare numbers
            return True
        return largest(np.abs(normals - self.normals)) <= _ROUND_OFF

    def of(self, pairs: Array) -> "Frames":
        """Of some pairs; the same as long as these are the same array."""
        if self.are_alike:
            return self
        if self._picked is None or self._picked[0] is not pairs:
            self._picked = pairs, Frames(self.normals[pairs])
        return self._picked[1]

    def along_normals(self, vectors: Array) -> Array:
        """n·v (C,) of vectors (C, 3) along the axes of space."""
        parts: Array = vectors.dot(self.normals[0]) if self.are_alike else (vectors * self.normals).dot(_ONES)
        return parts

    def turned(self, *vectors: Array) -> list[Array]:
        """Vectors (C, 3) along the axes of space as (3, C) each in the frames."""
        if self.are_alike:
            return [self._turn.dot(vector.T) for vector in vectors]
        return [np.einsum("cij,ci->jc", self.axes, vector, order="C") for vector in vectors]

    def in_space(self, vectors: Array) -> Array:
        """What is (3, C) in the frames, (C, 3) along the axes of space."""
        if self.are_alike:
            turned: Array = vectors.T.dot(self._turn)
            return turned
        return np.einsum("cij,jc->ci", self.axes, vectors, order="C")

    def to_lasting_axes(self, *vectors: Array) -> list[Array]:
        """Vectors (C, 3) along the axes of space as (3, C) each in axes that last."""
        return self.turned(*vectors) if self.are_alike else [vector.T.copy() for vector in vectors]

    def from_lasting_axes(self, vectors: Array) -> Array:
        """The other way."""
        return self.in_space(vectors) if self.are_alike else vectors.T.copy()


def axes_along(n: Array) -> Array:
    """Orthonormal (C, 3, 3) with first columns n, unit vectors: Householder's reflections that take ±x there."""
    sign = np.copysign(1.0, n[:, 0])
    w = n.copy()
    w[:, 0] += sign
    axes = w[:, :, None] * (w / w[:, :1])[:, None, :]
    axes -= sign[:, None, None] * _AXES
    axes[:, :, 0] = n  # to the last bit
    return axes


_SPACE = Frames(_AXES[:1])
_SPACE.axes = _AXES[None]


class Delassus:
    """Velocities per force of C pairs, m/s/N, along the axes of space.

    Args:
        matrix: W (3C, 3C), symmetric but for what a step turns bodies by, and positive semidefinite, pair after pair;
            not to be changed.
    """

    def __init__(self, matrix: Array):
        self.matrix = matrix
        self._framed: FramedDelassus | None = None

    @property
    def is_regular(self) -> bool:
        """Whether W tells all forces apart."""
        return bool(self.least_pivot)

    @cached_property
    def least_pivot(self) -> float:
        """Of a regular W, m/s/N, else 0; by its Cholesky factor, which takes a fifth of an inverse's time."""
        try:
            roots = np.linalg.cholesky((self.matrix + self.matrix.T) / 2).diagonal()
        except np.linalg.LinAlgError:
            return 0.0
        least, most = float(roots.min()) ** 2, float(roots.max()) ** 2
        return least if least * _LARGEST_CONDITION > most else 0.0

    @cached_property
    def inverse(self) -> Array:
        """W⁻¹ (3C, 3C), N s/m, of a regular W."""
        return np.linalg.inv(self.matrix)

    def framed(
        self, frames: Frames, compliance: float = 0.0, are_kept: bool = False, known: "FramedDelassus | None" = None
    ) -> "FramedDelassus":
        """The same in frames, with a compliance along each normal, m/s/N; kept as long as they are given again.

        `are_kept`, `known`: see FramedDelassus.
        """
        if self._framed is None or self._framed.frames is not frames or self._framed.added != compliance:
            self._framed = FramedDelassus(self, frames, compliance, known)
        self._framed.are_kept = are_kept or frames.are_alike
        return self._framed

    @cached_property
    def compliance(self) -> Array:
        """Of each pair by itself, (C,), m/s/N, > 0."""
        mean: Array = self.matrix.diagonal().reshape(-1, 3).sum(axis=1) / 3
        return mean if mean.min(initial=1.0) > 0 else np.maximum(mean, 1e-12 * mean.max() or 1.0)

    @cached_property
    def stiffness(self) -> Array:
        """One by it, N s/m."""
        return 1 / self.compliance

    def lasting(self, frames: Frames, compliance: float = 0.0) -> "FramedDelassus":
        """The same in axes that last (see Frames); where these are those of space, without the compliance."""
        return self.framed(frames, compliance) if frames.are_alike else self._in_space

    @cached_property
    def _in_space(self) -> "FramedDelassus":
        framed, C = FramedDelassus(self, _SPACE, 0.0), len(self.matrix) // 3
        framed.matrix = self.matrix.reshape(C, 3, C, 3).transpose(1, 0, 3, 2).reshape(3 * C, 3 * C)
        return framed


class FramedDelassus:
    """Velocities per force of C pairs, m/s/N, in frames of their normals.

    Args:
        operator: the same along the axes of space.
        frames: these.
        added: a compliance of each pair along its normal, m/s/N.
        known: of before: where that nearly is this one it guides.

    Attributes:
        guide: what is near enough to guide searches: this one, or what guided the one of before.
        compliance: (C,) of each pair by itself in the guide, m/s/N, > 0.
        stiffness: (C,) one by it, N s/m.
        are_kept: whether the frames are those of the step before, so that it pays to have W in them.
    """

    guide: "FramedDelassus"
    compliance: Array
    stiffness: Array
    _scaled: dict[float, tuple[Array, Array]]
    _law_arrays: tuple[float, tuple[Array, Array, Array, Array, Array]] | None = None

    def __init__(self, operator: Delassus, frames: Frames, added: float, known: "FramedDelassus | None" = None):
        self.operator, self.frames, self.added, self.are_kept = operator, frames, added, frames.are_alike
        if known is not None and self._is_nearly(known.guide):
            self.guide = known.guide
            self._scaled, self.compliance, self.stiffness = known._scaled, known.compliance, known.stiffness
            return
        self.guide, self._scaled = self, {}
        self.compliance, self.stiffness = operator.compliance, operator.stiffness
        if added:
            self.compliance = self.compliance + added / 3
            self.stiffness = 1 / self.compliance

    @cached_property
    def matrix(self) -> Array:
        """W (3C, 3C)."""
        W = self._turned(self.operator.matrix)
        C = len(W) // 3
        W.ravel()[: C * (3 * C + 1) : 3 * C + 1] += self.added
        return W

    def _is_nearly(self, other: "FramedDelassus") -> bool:
        W, axes, other_W, other_axes = self.operator.matrix, self.frames.axes, other.operator.matrix, other.frames.axes
        if W.shape != other_W.shape or axes.shape != other_axes.shape or self.added != other.added:
            return False
        turned = float(np.abs(axes - other_axes).max()) * float(other.compliance.max())
        return float(np.abs(W - other_W).max()) + turned < _NEARLY * other.operator.least_pivot

    @property
    def is_regular(self) -> bool:
        """Whether W, or what guides in its place, tells all forces apart."""
        return self.guide.operator.is_regular

    @property
    def inverse(self) -> Array:
        """W⁻¹ (3C, 3C), N s/m, of a regular W, or of what guides in its place."""
        return self.guide._inverse

    @cached_property
    def _inverse(self) -> Array:
        keeps_matrix = self.added or self.frames.are_alike  # elsewhere W⁻¹ along the axes of space is kept
        return np.linalg.inv(self.matrix) if keeps_matrix else self._turned(self.operator.inverse)

    def _turned(self, matrix: Array) -> Array:
        """A symmetric matrix (3C, 3C) along the axes of space, in the frames."""
        C, turn = len(matrix) // 3, self.frames.axes.transpose(0, 2, 1)
        for _ in range(2):  # rows, then columns, which are put in order of components
            matrix = np.matmul(turn, matrix.T.reshape(C, 3, 3 * C)).transpose(1, 0, 2).reshape(3 * C, 3 * C)
        return matrix

    def in_lasting_axes(self, matrix: Array) -> Array:
        """A matrix (3C, 3C) in the frames, in axes that last."""
        if self.frames.are_alike:
            return matrix
        C = len(matrix) // 3
        for _ in range(2):  # rows, then columns
            parts = np.matmul(self.frames.axes, matrix.T.reshape(3, C, 3 * C).transpose(1, 0, 2))
            matrix = parts.transpose(1, 0, 2).reshape(3 * C, 3 * C)
        return matrix

    def scaled(self, share: float) -> tuple[Array, Array]:
        """ρ (C,), a share of the stiffness of each pair, N s/m, and 1/ρ."""
        if share not in self._scaled:
            self._scaled[share] = share * self.stiffness, self.compliance / share
        return self._scaled[share]

    def law_arrays(self, friction: float) -> tuple[Array, Array, Array, Array, Array]:
        """By what a kept law is looked at: W (3C, 3C), ρ and 1/ρ (3, C), μ and 0 (C,), as numbers would take longer.

        They are kept for the friction coefficient that was given last.
        """
        if self._law_arrays is None or self._law_arrays[0] != friction:
            ρ, compliance = (np.tile(each, (3, 1)) for each in self.scaled(REGULAR_SHARE))
            arrays = self.matrix, ρ, compliance, np.full(ρ.shape[1], friction), np.zeros(ρ.shape[1])
            self._law_arrays = friction, arrays
        return self._law_arrays[1]

    def moved(self, forces: Array) -> Array:
        """W f (3, C) of forces (3, C); where normals are others in every step, without W in their frames if need be."""
        if self.are_kept or "matrix" in self.__dict__:
            moved: Array = self.matrix.dot(forces.ravel())
            return moved.reshape(forces.shape)
        (moved,) = self.frames.turned(self.operator.matrix.dot(self.frames.in_space(forces).ravel()).reshape(-1, 3))
        if self.added:
            moved[0] += self.added * forces[0]
        return moved


def operator_among(W: Operator, points: Array) -> tuple[Array, Array]:
    """Of an operator (3P, 3P) the part (3s, 3s) of the points that some numbers are, and which of these each is."""
    some, at = np.unique(points, return_inverse=True)
    return operator_of(W, some), at.reshape(points.shape)


def operator_between(W: Array, at: Array, maps: Array) -> Array:
    """How pairs move by forces of one another, (3C, 3C), m/s/N, where each moves with several points.

    Args:
        W: of s points (3s, 3s), m/s/N.
        at: (C, m) which of them each pair moves with.
        maps: (C, m, 3, 3) its velocity per theirs.
    """
    each, S = np.arange(len(at)), np.zeros((len(at), 3, len(W) // 3, 3))
    for k in range(at.shape[1]):
        S[each, :, at[:, k]] += maps[:, k]
    S = S.reshape(3 * len(at), -1)
    moved: Array = S.dot(W).dot(S.T)
    return moved
