"""The tables of a world file that say over which ranges its impacts are searched, and for what they are judged."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

from fenics_rom.scene.contact import Angle
from fenics_rom.scene.file_format import AngularVelocity, Speed
from fenics_rom.scene.values import Items, Name, Number, Point, Text

Mass = Annotated[float, Number(above=0.0, unit="kg")]
Pace = Annotated[float, Number(above=0.0)]
Rotation = Annotated[tuple[Angle, Angle, Angle], Items(3)]
Velocity = Annotated[tuple[Speed, Speed, Speed], Items(3)]
Spin = Annotated[tuple[AngularVelocity, AngularVelocity, AngularVelocity], Items(3)]
OF_POSE = {"position", "rotation", "velocity", "spin"}  # of all that is joined, which moves as one


@dataclass(frozen=True, kw_only=True)
class BodyRanges:
    """From where to where numbers of a body go, each component by itself; they take the place of the body's own."""

    mass: Annotated[tuple[Mass, Mass] | None, Items(2), "of a rigid body that has a mass"] = None
    position: Annotated[tuple[Point, Point] | None, Items(2), "as of the body"] = None
    rotation: Annotated[tuple[Rotation, Rotation] | None, Items(2), "as of the body"] = None
    velocity: Annotated[tuple[Velocity, Velocity] | None, Items(2), "as of the body"] = None
    spin: Annotated[tuple[Spin, Spin] | None, Items(2), "as of the body"] = None
    pace: Annotated[tuple[Pace, Pace] | None, Items(2), "of a body with a path: how many times as fast it goes"] = None


@dataclass(frozen=True, kw_only=True)
class CertificateTable:
    """What a certificate of impact is about: who is hit, over which ranges, and what it may feel."""

    body: Annotated[str, Text(), "that is hit"]
    by: Annotated[
        tuple[Annotated[str, Text()], ...], Items(at_least=1), "bodies that hit it, whose forces are added up"
    ]
    region: Annotated[str | None, Text(), "of a human body, a row of the table of limits; else it is not judged"] = None
    limits: Annotated[
        str | None, Text(), "a table of limits of your own (CSV: region, force_N, pressure_N_per_cm2, energy_J, source)"
    ] = None
    tolerance: Annotated[
        float,
        Number(above=0.0),
        "the search ends where no run of the ranges can be worse than the worst that was found by more than this share",
    ] = 0.1
    runs: Annotated[int, Number(at_least=1, integer=True), "or after about so many runs"] = 1000
    ranges: Annotated[Mapping[Name, BodyRanges], "by the name of the body"]
