"""What a scene says of fibres: in a material, on a surface, and along a line."""

from dataclasses import dataclass
from typing import Annotated, ClassVar

from fenics_rom.scene.law import Law
from fenics_rom.scene.places import PIECES, Place
from fenics_rom.scene.values import Direction, Flag, Items, Number, Point, Text

QUADRATIC, HOLZAPFEL = "quadratic", "holzapfel"
HALF_TURN = 1.5707963268  # beyond, angles repeat


@dataclass(frozen=True, kw_only=True)
class Helix:
    """Directions that wind about an axis."""

    axis: Annotated[Direction, "of any length but zero"]
    point: Annotated[Point, "on the axis"] = (0.0, 0.0, 0.0)
    angle: Annotated[
        float,
        Number(at_least=-HALF_TURN, at_most=HALF_TURN, unit="rad"),
        "from circles about the axis towards the axis: 0 is around it, 1.5708 along it; > 0 is a right-handed screw",
    ]
    both: Annotated[bool, Flag(), "whether a second family winds the other way, by -angle"] = False


@dataclass(frozen=True, kw_only=True)
class Directions:
    """One or two families of directions: exactly one of these keys."""

    directions: Annotated[
        tuple[Direction, ...] | None, Items(at_least=1, example="[[1, 0, 0]]"), "of each family, of any length but zero"
    ] = None
    helix: Annotated[Helix | None, "about an axis"] = None


@dataclass(frozen=True, kw_only=True)
class FibreMaterial(Directions):
    """Fibres of a material, which add to its law; every family has them all."""

    ONE_OF: ClassVar = (("directions", "helix", "data"),)
    data: Annotated[
        tuple[Annotated[str, Text()], ...] | None,
        Items(at_least=1, example='["fibre"]'),
        "of each family, the name of vectors in the cell data of a .vtk, .vtu or .xdmf mesh file; of any length",
    ] = None
    law: Annotated[
        str,
        Text(choices=(QUADRATIC, HOLZAPFEL)),
        '"quadratic", k/2 (stretch - 1)², which pulls and pushes; "holzapfel" (with large deformation), '
        "k/2s (exp(s e²) - 1) where e = 3 κ (I1/3 - 1) + (1 - 3 κ) (stretch² - 1) is positive: it only pulls",
    ] = QUADRATIC
    modulus: Annotated[
        float, Number(above=0.0, unit="Pa"), "k, of the body's volume: of threads their modulus times their share of it"
    ]
    stiffening: Annotated[float, Number(at_least=0.0), "s of holzapfel, how fast it stiffens (k2)"] = 0.0
    dispersion: Annotated[
        float, Number(at_least=0.0, at_most=1 / 3), "κ of holzapfel: 0, all along the direction, to 1/3, all around"
    ] = 0.0


@dataclass(frozen=True, kw_only=True)
class Membrane(Place, Directions):
    """A membrane that is embedded in a surface: threads that are wound on it, or a sheet; without bending or mass."""

    LAW: ClassVar = Law(
        force="that of threads or of a sheet in a surface, by its strain; damped by β as the cells behind it",
        stores="∫ k/2 (stretch - 1)² dA of threads, ½ ∫ E:C:E dA of a sheet in plane stress",
        online=False,
    )
    ONE_OF: ClassVar = (PIECES, ("poisson", "directions", "helix"))
    stiffness: Annotated[
        float,
        Number(above=0.0, unit="N/m"),
        "modulus times thickness of a sheet; of threads force per width and stretch, of each family",
    ]
    poisson: Annotated[
        float | None, Number(above=-1.0, below=1.0), "of a sheet that is the same in all directions; else threads"
    ] = None


@dataclass(frozen=True, kw_only=True)
class Cable:
    """A cable that is embedded in the body along a line, and moves with it; without bending or mass."""

    LAW: ClassVar = Law(
        force="that of a cable in the body, by its stretch; damped by β as the cells that it goes through",
        stores="∫ k/2 (stretch - 1)² dℓ",
        online=False,
    )
    points: Annotated[tuple[Point, ...], Items(at_least=2), "of the line, from one end to the other, at any place"]
    stiffness: Annotated[float, Number(above=0.0, unit="N"), "modulus times section, force per stretch"]
