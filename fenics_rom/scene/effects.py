"""The table of effects: everything that can act on a body, with what it does to the energy.

A scene names the effects it calls for. One that is not named costs nothing and changes no bit.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import isfinite

from fenics_rom.scene.schema import Field, Many, Number, Table, Text

POINT = Many(item=Number(unit="m"), length=3)
NEAR = Table(default=None, fields={"point": POINT, "radius": Number(above=0.0, unit="m")})
ANY_SURFACE = {"surface": Text(default=None), "near": NEAR}  # one of them
ALPHA = Number(default=0.0, at_least=0.0, unit="1/s")
BETA = Number(default=0.0, at_least=0.0, unit="s")
HISTORY = Text(default=None)  # a table in a CSV file: time, values


@dataclass(frozen=True)
class Effect:
    """One effect: its force in the equation of motion and its part in the energy account.

    Attributes:
        force: in the equation of motion.
        stores, dissipates, supplies: its part in the energy account.
        parameters: what the scene says of it; of each one where there can be several.
        several: whether a scene names each, as in [effects.tendon.NAME].
        needs: effects without which it means nothing.
        online: whether a reduced run can do without what the ROM was made with.
        changing: parameters that a reduced run may have different from those that the ROM was made with.
    """

    force: str
    stores: str = "nothing"
    dissipates: str = "nothing"
    supplies: str = "nothing"
    parameters: Mapping[str, Field] = field(default_factory=dict)
    several: bool = False
    needs: tuple[str, ...] = ()
    online: bool = True
    changing: tuple[str, ...] = ()

    @property
    def field(self) -> Table:
        """What a scene may hold under the effect's name."""
        one = Table(default=None, fields=self.parameters)
        return Table(default=None, each=one) if self.several else one

    @property
    def numbers(self) -> dict[str, tuple[str, int]]:
        """Unit and length of each parameter that is a number or a list of numbers, where there is one of it."""
        found = {}
        for key, parameter in () if self.several else self.parameters.items():
            one = parameter.item if isinstance(parameter, Many) else parameter
            if isinstance(one, Number):
                found[key] = one.unit or "1", getattr(parameter, "length", None) or 1
        return found


OBSTACLE = Table(
    fields={
        "shape": Text(choices=("half-space", "sphere", "capsule", "box")),
        "point": Many(default=None, item=Number(unit="m"), length=3),
        "normal": Many(default=None, item=Number(), length=3),
        "center": Many(default=None, item=Number(unit="m"), length=3),
        "start": Many(default=None, item=Number(unit="m"), length=3),
        "end": Many(default=None, item=Number(unit="m"), length=3),
        "radius": Number(default=None, above=0.0, unit="m"),
        "size": Many(default=None, item=Number(above=0.0, unit="m"), length=3),
        "rotation": Many(default=None, item=Number(unit="rad"), length=3),
        "table": HISTORY,  # its displacement: time, x, y, z
    }
)

EFFECTS: Mapping[str, Effect] = {
    "inertia": Effect(force="M dv/dt", stores="½ vᵀ M v"),
    "damping": Effect(
        force="D v, D = α M + β K (Rayleigh), for each material, and dashpots to ground",
        dissipates="vᵀ D v per second",
        needs=("inertia",),
        parameters={
            "alpha": ALPHA,
            "beta": BETA,
            "materials": Table(default=None, each=Table(fields={"alpha": ALPHA, "beta": BETA})),
            "dashpots": Table(
                default=None,
                each=Table(fields={**ANY_SURFACE, "coefficient": Number(above=0.0, unit="N s/m")}),
            ),
        },
    ),
    "springs": Effect(
        force="K_s x, a spring to ground spread evenly over a surface",
        stores="½ xᵀ K_s x",
        several=True,
        online=False,
        parameters={**ANY_SURFACE, "stiffness": Number(above=0.0, unit="N/m")},
    ),
    "gravity": Effect(
        force="M g",
        supplies="its work",
        parameters={"acceleration": Many(item=Number(unit="m/s2"), length=3)},
    ),
    "base_motion": Effect(
        force="-M a of a support that is shaken; displacements are relative to it",
        supplies="its work",
        several=True,
        needs=("inertia",),
        changing=("acceleration", "table"),
        parameters={
            "direction": Many(item=Number(), length=3),
            "acceleration": Number(default=None, unit="m/s2"),
            "table": HISTORY,
        },
    ),
    "prescribed": Effect(
        force="a force on a surface, evenly, or at a point",
        supplies="its work",
        several=True,
        changing=("force", "table"),
        parameters={
            **ANY_SURFACE,
            "point": Many(default=None, item=Number(unit="m"), length=3),
            "force": Many(default=None, item=Number(unit="N"), length=3),
            "table": HISTORY,
        },
    ),
    "pressure": Effect(
        force="p along the inward normals of a surface; the input is p in Pa",
        supplies="its work",
        several=True,
        parameters=ANY_SURFACE,
    ),
    "tendon": Effect(
        force="a cable through points from its anchor on, without friction; the input is its tension in N",
        supplies="its work",
        several=True,
        parameters={"points": Many(item=POINT, at_least=2)},
    ),
    "large_deformation": Effect(
        force="that of a hyperelastic material in place of K x; β acts on the rate of its Green strain",
        stores="∫ W in place of ½ xᵀ K x",
        parameters={"material": Text(default="st_venant_kirchhoff", choices=("st_venant_kirchhoff", "neo_hookean"))},
    ),
    "contact": Effect(
        force="λ ≥ 0 along the normals of rigid obstacles, with λ = 0 or a gap that does not close",
        dissipates="what restitution below 1 takes in an impact",
        supplies="the work of moving obstacles",
        changing=("restitution", "method", "stiffness", "damping", "switching", "obstacles"),
        parameters={
            "restitution": Number(default=0.0, at_least=0.0, at_most=1.0),
            "method": Text(default="complementarity", choices=("complementarity", "penalty")),
            "stiffness": Number(default=None, above=0.0, unit="N/m"),
            "damping": Number(default=None, at_least=0.0, unit="N s/m"),
            "switching": Text(default="automatic", choices=("automatic", "scene")),
            "obstacles": Table(each=OBSTACLE),
        },
    ),
    "friction": Effect(
        force="Coulomb's, at most μ λ, against sliding",
        dissipates="μ λ times what is slid",
        needs=("contact",),
        changing=("coefficient",),
        parameters={"coefficient": Number(at_least=0.0)},
    ),
}
LOADS = ("gravity", "base_motion", "prescribed")  # forces with a history of their own
ACTUATORS = ("pressure", "tendon")  # forces that are inputs


def table_of_effects() -> list[tuple[str, str, str, str]]:
    """For each effect its name, its force, what a scene says of it, and its part in the energy account."""
    return [
        (
            f"`{name}.NAME`" if effect.several else f"`{name}`",
            effect.force,
            ", ".join(_described(key, parameter) for key, parameter in effect.parameters.items()) or "-",
            "; ".join(
                f"{verb} {what}"
                for verb, what in (
                    ("stores", effect.stores),
                    ("dissipates", effect.dissipates),
                    ("supplies", effect.supplies),
                )
                if what != "nothing"
            ),
        )
        for name, effect in EFFECTS.items()
    ]


def _described(key: str, parameter: Field) -> str:
    """A parameter with its unit and its bounds."""
    one = parameter.item if isinstance(parameter, Many) else parameter
    if not isinstance(one, Number):
        return f"`{key}`"
    signs = ((one.at_least, "≥"), (one.above, ">"), (one.at_most, "≤"), (one.below, "<"))
    bounds = "".join(f" {sign} {bound:g}" for bound, sign in signs if isfinite(bound))
    return f"`{key}`{bounds}{f' {one.unit}' if one.unit else ''}"
