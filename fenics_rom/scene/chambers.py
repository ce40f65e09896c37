"""What fills a chamber, as a scene file has it: its gas, and the valve that this comes through."""

from dataclasses import dataclass
from typing import Annotated

from fenics_rom.errors import SceneError, exactly
from fenics_rom.mechanics.gas import AIR, ATMOSPHERE, GAS_CONTROLS
from fenics_rom.scene.values import Number


@dataclass(frozen=True)
class ChamberGas:
    """The gas in a chamber, which is at ambient pressure at rest."""

    exponent: Annotated[float, Number(at_least=1.0), "γ: 1 is isothermal, 1.4 air that keeps its heat"] = 1.0
    ambient: Annotated[float, Number(above=0.0, unit="Pa"), "pressure outside"] = ATMOSPHERE
    volume: Annotated[
        float | None,
        Number(above=0.0, unit="m3"),
        "of the chamber at rest; unless given what the surface encloses. Given, the surface may be open: what else is "
        "around the chamber stays where it is",
    ] = None


@dataclass(frozen=True, kw_only=True)
class Valve:
    """An orifice between a supply of air and a chamber, through which air flows both ways."""

    area: Annotated[float, Number(above=0.0, unit="m2"), "of the orifice"]
    discharge: Annotated[float, Number(above=0.0), "share of the area that the jet has"] = 0.6
    temperature: Annotated[float, Number(above=0.0, unit="K"), "of the supply"] = AIR


def check_filling(control: str, gas: ChamberGas | None, valve: Valve | None, where: str) -> None:
    """A SceneError where a chamber has gas or a valve and nothing comes of it, or lacks them."""
    if gas is not None and control not in GAS_CONTROLS:
        raise SceneError(f"{where}.gas: goes with control = 'gas' or 'valve' (got {control!r})")
    if valve is not None and control != "valve":
        raise SceneError(f"{where}.valve: goes with control = 'valve' (got {control!r})")
    if control == "valve":
        if valve is None:
            raise SceneError(f"{where}.valve is missing: the orifice between the supply and the chamber")
        if gas is not None and gas.exponent != 1:
            raise SceneError(
                f"{where}.gas.exponent = {exactly(gas.exponent)}: what comes through a valve is as warm as its supply, "
                "and stays so; use 1"
            )
