"""The effect of large deformation, and what a scene says of the training for it."""

from dataclasses import dataclass
from typing import Annotated, ClassVar

from fenics_rom.mechanics.isochoric import LAWS, LAWS_WITH_CONSTANTS
from fenics_rom.scene.law import Law
from fenics_rom.scene.values import Items, Number, Text

Acceleration = Annotated[float, Number(at_least=0.0, unit="m/s2")]
AngularAcceleration = Annotated[float, Number(at_least=0.0, unit="rad/s2")]
Spin = Annotated[float, Number(at_least=0.0, unit="rad/s")]

NO_LAWS = (
    (
        "mullins",
        "the softening of rubber in its first pulls (Mullins) is not modelled: fit a law to tests of rubber that was "
        "pulled as far some times before",
    ),
)


@dataclass(frozen=True)
class FrameTraining:
    """How a frame moves while its body is trained, at least: of a free body spins alone, as nothing else strains it."""

    accelerations: Annotated[
        tuple[Acceleration, Acceleration, Acceleration],
        Items(3, example="[10.0, 10.0, 10.0]"),
        "of the base along its axes; weight comes on top",
    ] = (0.0, 0.0, 0.0)
    angular_accelerations: Annotated[
        tuple[AngularAcceleration, AngularAcceleration, AngularAcceleration],
        Items(3, example="[50.0, 0.0, 0.0]"),
        "of the base about its axes",
    ] = (0.0, 0.0, 0.0)
    spins: Annotated[tuple[Spin, Spin, Spin], Items(3, example="[0.0, 0.0, 5.0]"), "about the axes of the frame"] = (
        0.0,
        0.0,
        0.0,
    )


@dataclass(frozen=True)
class LargeDeformation:
    """Large displacements, rotations and strains."""

    LAW: ClassVar = Law(
        force="that of a hyperelastic material in place of K x; β acts on the rate of its Green strain",
        stores="∫ W in place of ½ xᵀ K x",
        changing=("training",),
    )
    material: Annotated[
        str,
        Text(choices=(*LAWS, *LAWS_WITH_CONSTANTS), missing=NO_LAWS),
        '"st_venant_kirchhoff" (moderate strains), "neo_hookean" (large ones), or a law with constants for rubber',
    ] = "st_venant_kirchhoff"
    constants: Annotated[
        tuple[Annotated[float, Number()], ...],
        Items(),
        "of rubber as they are printed: C10, C01 of mooney_rivlin; C10, C20, C30 of yeoh; μ1, α1, μ2, α2, ... of ogden "
        "(Σ μ/α (λ1^α + λ2^α + λ3^α - 3)), whose ratios count, in any unit; Jm of gent, the largest I1 - 3; λm of "
        "arruda_boyce, the stretch at which chains lock; the size is that of young and poisson",
    ] = ()
    training: Annotated[
        FrameTraining | None,
        'for frame = "moving": how far the frame moves in training, beside what effects.base_path says; where neither '
        "says, what puts 1 g on the body",
    ] = None

    @property
    def law(self) -> str:
        """As `hyperelastic` knows it: the material and its constants."""
        return " ".join([self.material, *map(repr, self.constants)])
