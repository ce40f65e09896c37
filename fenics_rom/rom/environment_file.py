"""The environment in a ROM file: the group `environment`.

attributes contact_switching, has_inertia (yes or no), source; residual_compliance (no), absent where it is used;
                             touches_faces (yes), absent where obstacles touch contact points alone;
                             frame (moving), absent where it is fixed
base_path/                   times (T,) s, positions (T, 3) m, rotations (T, 4) w x y z; velocities (T, 3) m/s,
                             angular_velocities (T, 3) rad/s, both or none; absent where none is given
effects, built_in            groups whose attributes are names and texts, see mechanics.environment
chambers/NAME/               volume (1,) m³ at rest, of pressures whose surface encloses one; absent where none does
controls                     another one, absent where no stroke is given
gases/NAME/                  volume m³, exponent, ambient Pa, orifice m², temperature K (1,); absent without gas
guides/NAME/                 attribute tendon; friction (1,), angle (1,) rad; absent where no tendon rubs
loads/NAME/                  loads with signals of their own; columns (1,) and a signal, which may be absent:
    values (w,) or (T, w)    in the unit of the input
    times (T,) s             where values change
obstacles/NAME/              attribute `shape`; what describes it (point, normal, ..., vertices), and a signal, m
    rigid_motion/            origin (3,) m, and a group path as base_path, if it is known; absent where it has none
self_contact/                attributes NAME, yes, of contact modes; absent where the body does not touch itself
viscoelasticity/             ratios (b,), times (b,) s; absent where the material is elastic
contact_law/                 restitution, friction (1,); stiffness N/m, damping N s/m (1,); absent without contact
run/                         dt, duration (1,) s, snapshots (1,), every (1,), error_tolerance (1,) m, absent where
                             there is none; attributes detail, absent where it is full, errors and enrich (yes), absent
                             where not asked for; absent where the scene has none
    initial/                 equilibrium (1,), 0 or 1; the four motions (3,); absent where it is rest
        instant/             nodes, displacement, velocity (N, 3), of another run; may be absent
    loads/NUMBER/            attributes contact, actuator (one is empty); start, stop (1,) s; a signal
"""

from typing import TYPE_CHECKING, Any

import h5py
import numpy as np

from fenics_rom.errors import FileError, check_known
from fenics_rom.io.hdf5 import Entry, Table, check_names, get_group, get_record, get_text, put_arrays, put_text
from fenics_rom.mechanics.environment import (
    CONTACT_SWITCHINGS,
    DETAILS,
    FRAMES,
    RIGID,
    STROKE_UNITS,
    AppliedLoad,
    Environment,
    Guide,
    Load,
    MovingObstacle,
    RigidMotion,
    Run,
)
from fenics_rom.mechanics.signals import Signal

if TYPE_CHECKING:
    from fenics_rom.mechanics.base_path import BasePath
    from fenics_rom.mechanics.contact import ContactLaw
    from fenics_rom.mechanics.gas import Gas
    from fenics_rom.mechanics.initial_state import InitialState
    from fenics_rom.mechanics.viscoelasticity import PronySeries

INPUT_UNIT = "unit of the input"
YES, NO = "yes", "no"
LAW = {
    "restitution": Entry("1", (1,)),
    "friction": Entry("1", (1,)),
    "stiffness": Entry("N/m", (1,), optional=True),
    "damping": Entry("N s/m", (1,)),
}
RUN = {
    "dt": Entry("s", (1,)),
    "duration": Entry("s", (1,)),
    "snapshots": Entry("1", (1,), "i"),
    "every": Entry("1", (1,), "i", optional=True),
    "error_tolerance": Entry("m", (1,), optional=True),
}
INITIAL = {
    "equilibrium": Entry("1", (1,), "i"),
    "translation": Entry("m", (3,)),
    "rotation": Entry("rad", (3,)),
    "velocity": Entry("m/s", (3,)),
    "spin": Entry("rad/s", (3,)),
}
INSTANT = {"nodes": Entry("m", ("N", 3)), "displacement": Entry("m", ("N", 3)), "velocity": Entry("m/s", ("N", 3))}
PATH = {
    "times": Entry("s", ("T",)),
    "positions": Entry("m", ("T", 3)),
    "rotations": Entry("1", ("T", 4)),
    "velocities": Entry("m/s", ("T", 3), optional=True),
    "angular_velocities": Entry("rad/s", ("T", 3), optional=True),
}
ORIGIN = {"origin": Entry("m", (3,))}
SPAN = {"start": Entry("s", (1,)), "stop": Entry("s", (1,))}
GUIDE = {"friction": Entry("1", (1,)), "angle": Entry("rad", (1,))}
SERIES = {"ratios": Entry("1", ("b",)), "times": Entry("s", ("b",))}
GAS = {
    "volume": Entry("m3", (1,)),
    "exponent": Entry("1", (1,)),
    "ambient": Entry("Pa", (1,)),
    "orifice": Entry("m2", (1,)),
    "temperature": Entry("K", (1,)),
}
CHAMBER = {"volume": Entry("m3", (1,))}
GROUPS = (
    *("base_path", "effects", "built_in", "chambers", "controls", "gases", "guides", "loads", "obstacles"),
    *("viscoelasticity", "contact_law", "self_contact", "run"),
)
COLUMNS = {"columns": Entry("1", (1,), "i")}


def put_environment(h5: h5py.File, environment: Environment) -> None:
    """Writes the group."""
    check_names([*environment.loads, *environment.obstacles])
    group = h5.create_group("environment", track_order=True)
    put_text(group, contact_switching=environment.contact_switching, source=environment.source)
    put_text(group, has_inertia=YES if environment.has_inertia else NO)
    if environment.is_moving:
        put_text(group, frame=environment.frame)
    if environment.base_path is not None:
        put_arrays(group.create_group("base_path"), PATH, {}, vars(environment.base_path))
    if not environment.residual_compliance:
        put_text(group, residual_compliance=NO)
    if environment.touches_faces:
        put_text(group, touches_faces=YES)
    for name, texts in (("effects", environment.effects), ("built_in", environment.built_in)):
        put_text(group.create_group(name, track_order=True), **texts)
    for name, guide in environment.guides.items():
        part = group.require_group("guides").create_group(name)
        put_text(part, tendon=guide.tendon)
        put_arrays(part, GUIDE, {}, vars(guide))
    if environment.controls:
        put_text(group.create_group("controls", track_order=True), **environment.controls)
    for name, gas in environment.gases.items():
        put_arrays(group.require_group("gases").create_group(name), GAS, {}, gas._asdict())
    for name, volume in environment.chambers.items():
        put_arrays(group.require_group("chambers").create_group(name), CHAMBER, {}, {"volume": volume})
    loads = group.create_group("loads", track_order=True)
    for name, load in environment.loads.items():
        _put(loads.create_group(name), COLUMNS, vars(load), load.signal, INPUT_UNIT)
    obstacles = group.create_group("obstacles", track_order=True)
    for name, obstacle in environment.obstacles.items():
        from fenics_rom.mechanics.obstacles import shape_of  # here, as few bodies meet obstacles

        part, shape = obstacles.create_group(name), shape_of(obstacle.shape)
        put_text(part, shape=shape)
        _put(part, _dimensions(shape), vars(obstacle.shape), obstacle.displacement, "m")
        if obstacle.motion is not None:
            motion = part.create_group("rigid_motion")
            put_arrays(motion, ORIGIN, {}, vars(obstacle.motion))
            if obstacle.motion.path is not None:
                put_arrays(motion.create_group("path"), PATH, {}, vars(obstacle.motion.path))
    if environment.viscoelasticity is not None:
        put_arrays(group.create_group("viscoelasticity"), SERIES, {}, vars(environment.viscoelasticity))
    law, run = environment.contact_law, environment.run
    if law is not None:
        put_arrays(group.create_group("contact_law"), LAW, {}, vars(law))
    if environment.self_contact:
        put_text(group.create_group("self_contact", track_order=True), **dict.fromkeys(environment.self_contact, YES))
    if run is not None:
        part = group.create_group("run")
        if run.detail != "full":
            put_text(part, detail=run.detail)
        if run.errors:
            put_text(part, errors=YES)
        if run.enrich:
            put_text(part, enrich=YES)
        put_arrays(part, RUN, {}, vars(run) | {"every": run.every if run.every > 1 else None})
        if run.initial is not None:
            start = part.create_group("initial")
            put_arrays(start, INITIAL, {}, vars(run.initial))
            if run.initial.instant is not None:
                put_arrays(start.create_group("instant"), INSTANT, {}, vars(run.initial.instant))
        loads = part.create_group("loads", track_order=True)
        for number, applied in enumerate(run.loads):
            span = loads.create_group(str(number))
            put_text(span, contact=applied.contact or "", actuator=applied.actuator or "")
            _put(span, SPAN, vars(applied), applied.signal, INPUT_UNIT)


def take_environment(h5: h5py.File) -> Environment:
    """Reads the group."""
    group = get_group(h5, "environment")
    if strange := [name for name in group if name not in GROUPS]:
        raise FileError(f"{group.name} has {strange[0]!r}, which acts and which this release does not know: update it")
    has_inertia = get_text(group, "has_inertia")
    if has_inertia not in (YES, NO):
        raise FileError(f"attribute 'has_inertia' of {group.name} is {has_inertia!r}, neither {YES} nor {NO}")
    switching = get_text(group, "contact_switching")
    check_known("contact_switching", switching, CONTACT_SWITCHINGS, FileError, f"{group.name}: ")
    texts = {name: get_group(group, name) for name in ("effects", "built_in")}
    loads, obstacles = get_group(group, "loads"), get_group(group, "obstacles")
    return Environment(
        effects={name: get_text(texts["effects"], name) for name in texts["effects"].attrs},
        frame=_word(group, "frame", FRAMES),
        base_path=_path(get_group(group, "base_path")) if "base_path" in group else None,
        has_inertia=has_inertia == YES,
        viscoelasticity=_series(get_group(group, "viscoelasticity")) if "viscoelasticity" in group else None,
        loads={name: _load(get_group(loads, name)) for name in loads},
        obstacles={name: _obstacle(get_group(obstacles, name)) for name in obstacles},
        contact_law=_law(get_group(group, "contact_law")) if "contact_law" in group else None,
        self_contact=tuple(get_group(group, "self_contact").attrs) if "self_contact" in group else (),
        touches_faces="touches_faces" in group.attrs,
        residual_compliance="residual_compliance" not in group.attrs,
        contact_switching=switching,
        guides=_guides(get_group(group, "guides")) if "guides" in group else {},
        controls=_controls(get_group(group, "controls")) if "controls" in group else {},
        gases=_gases(get_group(group, "gases")) if "gases" in group else {},
        chambers=_chambers(get_group(group, "chambers")) if "chambers" in group else {},
        built_in={name: get_text(texts["built_in"], name) for name in texts["built_in"].attrs},
        run=_run(get_group(group, "run")) if "run" in group else None,
        source=get_text(group, "source"),
    )


def _word(group: h5py.Group, key: str, choices: tuple[str, ...]) -> str:
    """An attribute that is absent where it is the first of the choices."""
    word = get_text(group, key) if key in group.attrs else choices[0]
    check_known(key, word, choices, FileError, f"{group.name}: ")
    return word


def _law(group: h5py.Group) -> "ContactLaw":
    from fenics_rom.mechanics.contact import ContactLaw  # here, as few bodies touch

    return ContactLaw(**{key: value for key, value in get_record(group, LAW).items() if value is not None})


def _path(group: h5py.Group) -> "BasePath":
    from fenics_rom.mechanics.base_path import BasePath  # here, as few bodies move so far

    arrays = get_record(group, PATH)
    path = BasePath(**arrays)
    if mistake := path.mistake():
        raise FileError(f"{group.name}: {mistake}")
    return path


def _series(group: h5py.Group) -> "PronySeries":
    from fenics_rom.mechanics.viscoelasticity import PronySeries  # here, as few bodies have it

    arrays = get_record(group, SERIES)
    if not all((values > 0).all() for values in arrays.values()):
        raise FileError(f"{group.name}: ratios and times must be positive")
    return PronySeries(**{name: tuple(values.tolist()) for name, values in arrays.items()})


def _guides(group: h5py.Group) -> dict[str, Guide]:
    parts = {name: get_group(group, name) for name in group}
    return {name: Guide(get_text(part, "tendon"), **get_record(part, GUIDE)) for name, part in parts.items()}


def _controls(group: h5py.Group) -> dict[str, str]:
    controls = {name: get_text(group, name) for name in group.attrs}
    for control in controls.values():
        check_known("control", control, [*STROKE_UNITS, RIGID], FileError, f"{group.name}: ")
    return controls


def _gases(group: h5py.Group) -> "dict[str, Gas]":
    from fenics_rom.mechanics.gas import Gas  # here, as few chambers hold gas

    return {name: Gas(**get_record(get_group(group, name), GAS)) for name in group}


def _chambers(group: h5py.Group) -> dict[str, float]:
    return {name: get_record(get_group(group, name), CHAMBER)["volume"] for name in group}


def _load(group: h5py.Group) -> Load:
    numbers, signal = _take(group, COLUMNS, INPUT_UNIT)
    if signal is not None and signal.width != numbers["columns"]:
        raise FileError(f"{group.name}: its signal has {signal.width} numbers, not {numbers['columns']}")
    return Load(numbers["columns"], signal)


def _obstacle(group: h5py.Group) -> MovingObstacle:
    from fenics_rom.mechanics.obstacles import SHAPES

    shape = get_text(group, "shape")
    check_known("shape", shape, SHAPES, FileError, f"{group.name}: ")
    numbers, signal = _take(group, _dimensions(shape), "m", others=("rigid_motion",))
    if signal is None or signal.width != 3:
        raise FileError(f"{group.name}: its displacement has not three numbers")
    motion = _motion(get_group(group, "rigid_motion")) if "rigid_motion" in group else None
    return MovingObstacle(SHAPES[shape](**numbers), signal, motion)


def _motion(group: h5py.Group) -> RigidMotion:
    origin = get_record(group, ORIGIN, others=("path",))["origin"]
    return RigidMotion(_path(get_group(group, "path")) if "path" in group else None, origin)


def _run(group: h5py.Group) -> Run:
    numbers = get_record(group, RUN, others=("loads", "initial"))
    loads, applied = get_group(group, "loads"), []
    for name in loads:
        part = get_group(loads, name)
        span, signal = _take(part, SPAN, INPUT_UNIT)
        if signal is None:
            raise FileError(f"{part.name}: has no signal")
        contact, actuator = get_text(part, "contact") or None, get_text(part, "actuator") or None
        applied.append(AppliedLoad(contact, actuator, **span, signal=signal))
    initial = _initial(get_group(group, "initial")) if "initial" in group else None
    numbers["every"] = numbers["every"] or 1
    said: dict[str, Any] = {name: name in group.attrs for name in ("errors", "enrich")}
    said["detail"] = _word(group, "detail", DETAILS)
    return Run(**numbers, loads=tuple(applied), initial=initial, **said)


def _initial(group: h5py.Group) -> "InitialState":
    from fenics_rom.mechanics.initial_state import InitialState, Instant  # here, as few runs have one

    numbers = get_record(group, INITIAL, others=("instant",))
    instant = Instant(**get_record(get_group(group, "instant"), INSTANT)) if "instant" in group else None
    return InitialState(**numbers | {"equilibrium": numbers["equilibrium"] == 1}, instant=instant)


def _put(group: h5py.Group, table: Table, numbers: dict[str, Any], signal: Signal | None, unit: str) -> None:
    """Writes numbers, and a signal in a unit if there is one."""
    put_arrays(group, table, {}, numbers)
    if signal is not None:
        put_arrays(group, _signal_table(unit, signal.times is not None), {}, vars(signal))


def _take(
    group: h5py.Group, table: dict[str, Entry], unit: str, others: tuple[str, ...] = ()
) -> tuple[dict[str, Any], Signal | None]:
    """Reads numbers, and the signal in a unit if there is one, beside groups of other names."""
    if "values" not in group:
        return get_record(group, table, others=others), None
    numbers = get_record(group, table | _signal_table(unit, "times" in group), others=others)
    values, times = numbers.pop("values"), numbers.pop("times", None)
    if times is not None and (len(times) < 2 or (np.diff(times) <= 0).any()):
        raise FileError(f"{group.name}/times does not increase")
    return numbers, Signal(values, times)


def _signal_table(unit: str, changes: bool) -> dict[str, Entry]:
    if not changes:
        return {"values": Entry(unit, ("w",))}
    return {"values": Entry(unit, ("T", "w")), "times": Entry("s", ("T",))}


def _dimensions(shape: str) -> dict[str, Entry]:
    """What describes an obstacle of a shape."""
    from fenics_rom.mechanics.obstacles import dimensions_of

    return {name: Entry(*of) for name, of in dimensions_of(shape).items()}
