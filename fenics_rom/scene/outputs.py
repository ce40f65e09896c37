"""Outputs as a scene file has them: displacements, or a sense of touch."""

from dataclasses import dataclass, fields
from typing import Annotated

from fenics_rom.errors import SceneError
from fenics_rom.mechanics.touch import TOUCH
from fenics_rom.scene.places import PIECES, Place
from fenics_rom.scene.values import Direction, Items, Number, Point, Text

DISPLACEMENT = "displacement"
MOST_TAXELS = 4096
SIDE = Number(at_least=1, at_most=256, integer=True)
NOISE = "standard deviation of noise "


@dataclass(frozen=True)
class Output(Place):
    """Displacements that are read often: of points or markers, or the mean over a piece of the surface."""

    ONE_OF = (("points", "markers", *PIECES),)
    points: Annotated[tuple[Point, ...] | None, Items(at_least=1), "material points of the body"] = None
    markers: Annotated[
        tuple[Point, ...] | None,
        Items(at_least=1),
        "middles of markers off the surface, each rigidly on the triangle that is nearest; for small turns",
    ] = None


@dataclass(frozen=True)
class Taxels:
    """A grid that is mapped onto the surface of a sense of touch."""

    rows: Annotated[int, SIDE, "along v: at right angles to u, or about the axis of a surface that goes around it"]
    columns: Annotated[int, SIDE, "along u, the longer principal axis of the surface"]
    along: Annotated[Direction | None, "of u, of any length but zero, instead of the longer principal axis"] = None


@dataclass(frozen=True)
class SensorTable:
    """What a real sensor adds to what it feels; it alters no model, but what is read."""

    rate: Annotated[float, Number(at_least=0.0, unit="Hz"), "how often it looks; 0: after every step"] = 0.0
    delay: Annotated[float, Number(at_least=0.0, unit="s"), "after which it shows what it saw"] = 0.0
    pressure_noise: Annotated[float, Number(at_least=0.0, unit="Pa"), NOISE + "of each taxel"] = 0.0
    force_noise: Annotated[float, Number(at_least=0.0, unit="N"), NOISE + "of each component of the force"] = 0.0
    torque_noise: Annotated[float, Number(at_least=0.0, unit="N m"), NOISE + "of each component of the torque"] = 0.0
    pressure_step: Annotated[float, Number(at_least=0.0, unit="Pa"), "to whose multiples taxels are rounded"] = 0.0
    force_step: Annotated[float, Number(at_least=0.0, unit="N"), "to whose multiples forces are rounded"] = 0.0
    torque_step: Annotated[float, Number(at_least=0.0, unit="N m"), "to whose multiples torques are rounded"] = 0.0
    seed: Annotated[int, Number(at_least=0, integer=True), "of the noise"] = 0


@dataclass(frozen=True)
class OutputEntry(Output):
    """What is read by name: displacements of points or markers, or the mean over a piece of the surface; or touch."""

    quantity: Annotated[
        str,
        Text(choices=(DISPLACEMENT, TOUCH)),
        '"displacement", or "touch" of a piece of the surface: forces and torque of all that touches it, centre of '
        "pressure, area of contact, pressures on taxels; slip velocity and margin to slip of each patch of contact",
    ] = DISPLACEMENT
    taxels: Annotated[Taxels | None, "of touch: where pressures are read"] = None
    point: Annotated[
        Point | None, "of touch: about which torques are, fixed to the surface; usually the middle of the surface"
    ] = None
    patches: Annotated[
        int, Number(at_least=1, at_most=64, integer=True), "of touch: how many patches of contact are told at most"
    ] = 4
    sensor: Annotated[SensorTable | None, "of touch: what a real sensor adds; usually nothing"] = None

    @property
    def displacement(self) -> Output:
        """What of it is an output of displacements."""
        return Output(**{field.name: getattr(self, field.name) for field in fields(Output)})


def check_output(entry: OutputEntry, where: str, *, has_contact: bool) -> None:
    """Checks what goes with displacements or touch alone; SceneError where something has no effect."""
    if entry.quantity == DISPLACEMENT:
        for key in ("taxels", "point", "sensor"):
            if getattr(entry, key) is not None:
                raise SceneError(f"{where}.{key}: goes with quantity = 'touch'")
        if entry.patches != OutputEntry.patches:
            raise SceneError(f"{where}.patches: goes with quantity = 'touch'")
        return
    for key in ("points", "markers"):
        if getattr(entry, key) is not None:
            raise SceneError(f"{where}.{key}: touch is of a piece of the surface; use one of {', '.join(PIECES)}")
    if not has_contact:
        raise SceneError(f"{where}: touch means nothing without contact; name effects.contact as well")
    taxels, sensor = entry.taxels, entry.sensor
    if taxels is not None:
        if taxels.rows * taxels.columns > MOST_TAXELS:
            raise SceneError(
                f"{where}.taxels: {taxels.rows} x {taxels.columns} are {taxels.rows * taxels.columns} taxels; use at "
                f"most {MOST_TAXELS}"
            )
        if taxels.along is not None and not any(taxels.along):
            raise SceneError(f"{where}.taxels.along: use any direction but zero")
    if sensor is not None:
        _check_sensor(sensor, f"{where}.sensor", has_taxels=taxels is not None)


def _check_sensor(sensor: SensorTable, where: str, *, has_taxels: bool) -> None:
    given = {name: value for name, value in vars(sensor).items() if value}
    if not given.keys() - {"seed"}:
        raise SceneError(
            f"{where}: adds nothing; give one of {', '.join(name for name in vars(sensor) if name != 'seed')}"
        )
    if sensor.seed and not any(name.endswith("noise") for name in given):
        raise SceneError(f"{where}.seed: goes with noise, of which there is none")
    for name in given:
        if name.startswith("pressure") and not has_taxels:
            raise SceneError(f"{where}.{name}: goes with taxels, of which there are none")
