"""What a reduction method is given, and what it gives back: the interface for methods, ours and anyone's."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy import ndarray as Array

from fenics_rom.io.stages import Stages
from fenics_rom.reduction.common_basis import CommonBasis
from fenics_rom.system.protocols import Deformation, Factor
from fenics_rom.system.system import System


@dataclass(frozen=True)
class RankedBasis:
    """The directions of one contact mode, the most important first.

    Attributes:
        coordinates: (k, r) in the shared space; their lengths do not matter.
        singular_values: (s,), descending, one for each direction and for those left out; empty where there are none.
        hankel: whether the singular values are Hankel singular values.
        left_inverse: (r, k) oblique projection of the shared space onto them; only for switching = "oblique".
    """

    coordinates: Array
    singular_values: Array = field(default_factory=lambda: np.empty(0))
    hankel: bool = False
    left_inverse: Array | None = None


@dataclass(frozen=True)
class ReductionProblem:
    """A reduction to be done.

    A method is a function of a problem that yields the name and the directions of each contact mode in `contacts`:

        def static_shapes(problem):
            for name in problem.contacts:
                yield name, problem.directions(problem.factor.solve(problem.system.forces(name)))

        rom = fr.reduce(system, method=static_shapes, order=3)

    Columns are NumPy arrays (rows of this rank, any number). The bases of any method are switched passively.

    Attributes:
        system: the full-order model; of a body that is not wholly held its elastic rest, M-orthogonal to its rigid
            motions, with loads in balance.
        factor: of K; `factor.solve(block)` is K⁻¹ times a block of columns.
        space: the basis that the contact modes share.
        contacts: names of the contact modes to reduce.
        order: number of directions, one for all contact modes or by name; None where a tolerance decides.
        tolerance: share of the sum of singular values that may be left out.
        most: that number at most where a tolerance decides; None: any.
        switching, weighting, lyapunov, share: as in `reduce`.
        stages: times what is done: `with problem.stages("snapshots"): ...`.
        messages: what the user should know; append to it.
    """

    system: System
    factor: Factor
    space: CommonBasis
    contacts: tuple[str, ...]
    order: int | Mapping[str, int] | None
    tolerance: float
    switching: str
    weighting: str
    lyapunov: str
    share: float
    stages: Stages
    messages: list[str]
    most: int | None = None

    @property
    def deformation(self) -> Deformation:
        """Of a body that deforms largely."""
        assert self.system.deformation is not None
        return self.system.deformation

    def order_of(self, name: str) -> int | None:
        """The order asked for one contact mode."""
        return self.order[name] if isinstance(self.order, Mapping) else self.order

    def directions(self, columns: Array, singular_values: Array | None = None) -> RankedBasis:
        """A ranked basis from columns (rows here, r), the most important first."""
        coordinates = self.space.add(columns)
        return RankedBasis(coordinates) if singular_values is None else RankedBasis(coordinates, singular_values)


Method = Callable[[ReductionProblem], Iterator[tuple[str, RankedBasis]]]


def scale_inputs(system: System, factor: Factor) -> System:
    """The system with the columns of effects scaled, so that at rest each stores as much energy as a contact's.

    A pressure in a closed chamber, whose forces balance each other, moves a body much less than the same force in one
    place. What its column is made larger by, its unit is made smaller by: B stays as it is, and only `forces` changes.
    Those actuators and loads that have units are effects, and so are springs and dashpots; `factor` is of K.
    """
    frame = system.moving_frame
    ties = None if frame is None else frame.tie_forces
    if not system.units and ties is None:
        return system

    def stored(columns: Array) -> float:
        """Square root of the largest bᵀK⁻¹b."""
        return float(np.sqrt(np.diag(system.algebra.inner(columns, factor.solve(columns))).max()))

    reference = float(np.median([stored(B) for B in system.contacts.values()]))
    of_effects = {name: B for name, B in {**system.actuators, **system.loads}.items() if name in system.units}
    scales = {name: reference / size for name, B in of_effects.items() if (size := stored(B)) > 0}

    if frame is not None and ties is not None and (size := stored(ties)) > 0:
        frame = replace(frame, tie_forces=reference / size * ties)

    def scaled(columns: dict[str, Array]) -> dict[str, Array]:
        return {name: scales.get(name, 1.0) * B for name, B in columns.items()}

    return replace(
        system,
        actuators=scaled(dict(system.actuators)),
        loads=scaled(dict(system.loads)),
        units={name: unit / scales.get(name, 1.0) for name, unit in system.units.items()},
        moving_frame=frame,
    )
