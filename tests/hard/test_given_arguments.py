"""Whatever is given to what is public is taken, or refused in the package's own words, in one line."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

import fenics_rom as fr
from fenics_rom.errors import FenicsRomError, StepError
from fenics_rom.world import joints, shapes

DATA = Path(__file__).parents[1] / "data"
RUN = fr.read_trajectory(DATA / "run-1.2.h5")
ROM, TOUCHED = fr.read_rom(DATA / "rom-1.0.h5"), fr.read_rom(DATA / "rom-1.2.h5")
CONTACT = next(iter(ROM.contact_models))
EYE = np.eye(6)
STILL = fr.BaseState(np.zeros(3), np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(3))
HIDDEN = np.ma.masked_array([1.0, 2.0, 3.0], [0, 1, 0])


class Odd:
    def __repr__(self):
        return "odd\nthing"


ANY = {
    **{repr(value): value for value in (None, True, 0, -1, 1.5, np.nan, np.inf, 1j, "3", "", "a\0b", "a\udc80", b"x")},
    **{"huge": 10**400, "long": 300 * "x" + ".h5", "list": [], "nested": [[]], "dict": {"a": 1}, "odd": Odd()},
    **{"1e300": 1e300, "2**63": 2**63, "digits": ["1", "2", "3"], "huge list": [10**400] * 3, "rows": [[1], [1, 2]]},
    **{"masked": HIDDEN, "masked rows": [HIDDEN] * 3, "complex": 1j * np.ones(3), "words": np.array(["a", "b"])},
    **{"bools": np.ones(3, dtype=bool), "empty": np.zeros((0, 3)), "cube": np.zeros((3, 3, 3)), "set": {1, 2}},
    **{"time": np.timedelta64(1, "s"), "dates": np.array(["2020-01-01"] * 3, dtype="M8[D]"), "type": int},
    **{"record": np.array([(1, 2.0)], dtype=[("a", int), ("b", float)]), "objects": np.array([None, 1, 2])},
    **{"Fraction": Fraction(1, 3), "root": Path("/"), "missing": Path("/nonexistent/x.h5"), "slice": slice(None)},
}
NO_NUMBERS = ("True", "'3'", "b'x'", "1j", "huge", "masked", "time", "nan", "inf")


def simulator():
    return fr.Simulator(ROM, 1e-3)


def batch():
    return fr.Batch(ROM, 2, 1e-3)


def squares(outputs, energies):
    return sum((y**2).sum() for y in outputs.values()), {name: 2 * y for name, y in outputs.items()}, None


def moved(**given):
    return fr.World({"box": fr.RigidBody(shapes.Box((0.1, 0.1, 0.1)), **({"density": 500.0} | given))}, 1e-3)


def world():
    """A box that a joint holds, and a hand."""
    bodies = {
        "box": fr.RigidBody(shapes.Box((0.1, 0.1, 0.1)), density=500.0),
        "hand": fr.RigidBody(shapes.Sphere(0.1), motion=lambda t: STILL),
    }
    return fr.World(bodies, 1e-3, joints=[joints.weld("box", "world", (0, 0, 0), name="hold")], apart=[("box", "hand")])


def joined(kind):
    return lambda **given: fr.World(
        {"box": fr.RigidBody(shapes.Box((0.1, 0.1, 0.1)), density=500.0)}, 1e-3, joints=[getattr(joints, kind)(**given)]
    )


CALLS = {  # what is called, and what it takes; each of that is once something else
    "Simulator": (lambda: fr.Simulator, {"rom": ROM, "dt": 1e-3, "ledger": True, "signals": None, "stepper": None}),
    "step": (lambda: simulator().step, {"u": [0.0] * 4}),
    "step by name": (lambda: simulator().step, {CONTACT: [0.0] * 3}),
    "switch": (lambda: simulator().switch, {"contact": CONTACT}),
    "set_signal": (lambda: fr.Simulator(TOUCHED, 1e-3).set_signal, {"name": "floor", "signal": [0.0] * 3}),
    "rollout": (lambda: simulator().rollout, {"inputs": np.zeros((2, 4)), "dt": None, "every": 1, "outputs": None}),
    "set_shape": (lambda: simulator().set_shape, {"displacement": 0 * ROM.nodes, "velocity": None}),
    "displacement": (lambda: simulator().displacement, {"output": next(iter(ROM.outputs))}),
    "state": (lambda: lambda v: setattr(simulator(), "state", v), {"v": simulator().state}),
    "dt": (lambda: lambda v: setattr(simulator(), "dt", v), {"v": 1e-3}),
    "restore": (lambda: simulator().restore, {"state": simulator().save()}),
    "Batch": (lambda: fr.Batch, {"rom": ROM, "size": 2, "dt": 1e-3, "dtype": float, "ledger": False, "signals": None}),
    "batch.step": (lambda: batch().step, {"u": np.zeros((2, 4)), "on_error": "raise"}),
    "batch.switch": (lambda: batch().switch, {"contact": CONTACT, "bodies": None}),
    "batch.reset": (lambda: batch().reset, {"bodies": None, "on_error": "raise"}),
    "batch.state": (lambda: batch().state, {"bodies": None}),
    "set_state": (lambda: batch().set_state, dict(zip(("q", "r"), batch().state(), strict=True)) | {"bodies": None}),
    "batch.shape": (lambda: batch().shape, {"body": 0}),
    "batch.displacement": (lambda: batch().displacement, {"output": next(iter(ROM.outputs))}),
    "place_obstacle": (
        lambda: fr.Batch(TOUCHED, 2, 1e-3).place_obstacle,
        {"name": "floor", "displacement": (0.0, 0, 0), "bodies": None},
    ),
    "contact_force": (lambda: fr.Batch(TOUCHED, 2, 1e-3).contact_force, {"obstacle": "floor"}),
    "contact_forces": (lambda: fr.Simulator(TOUCHED, 1e-3).contact_forces, {"obstacle": "floor"}),
    "velocity": (lambda: simulator().velocity, {"output": next(iter(ROM.outputs))}),
    "output_rows": (lambda: simulator().output_rows, {"output": next(iter(ROM.outputs))}),
    "reading": (lambda: simulator().reading, {"name": "none"}),
    "reconstruct": (lambda: ROM.reconstruct, {"coordinates": 0 * ROM.stiffness}),
    "switch_map": (lambda: ROM.switch_map, {"start": CONTACT, "end": CONTACT}),
    "realtime": (lambda: fr.run_realtime, {"simulator": simulator(), "control": lambda s: None, "duration": 1e-3}),
    "differentiate": (
        lambda: fr.differentiate,
        {"body": simulator(), "inputs": np.zeros((2, 4)), "objective": squares, "dt": None, "outputs": None},
    ),
    "objective": (
        lambda: lambda J, slopes, rates: fr.differentiate(simulator(), np.zeros((2, 4)), lambda *_: (J, slopes, rates)),
        {"J": 0.0, "slopes": {}, "rates": None},
    ),
    "truncate": (lambda: fr.truncate, {"rom": ROM, "order": 2}),
    "write_rom": (lambda: fr.write_rom, {"file": "a.h5", "rom": ROM, "force": False}),
    "read_rom": (lambda: fr.read_rom, {"file": DATA / "rom-1.0.h5"}),
    "write_trajectory": (lambda: fr.write_trajectory, {"file": "r.h5", "trajectory": RUN}),
    "compare": (lambda: fr.compare, {"run": RUN, "reference": RUN}),
    "simulate": (lambda: fr.simulate, {"model": ROM, "dt": None, "every": None, "signals": None, "rate": False}),
    "state_space": (lambda: ROM.state_space, {"contact": CONTACT, "outputs": None, "dt": None}),
    "export": (lambda: fr.export, {"model": ROM, "output": "a.c", "dt": 0.01, "outputs": None, "force": False}),
    "plot": (lambda: fr.plot, {"model": RUN, "output": "a", "what": ["none"], "dark": False, "full": None}),
    "read_scene": (lambda: fr.read_scene, {"file": "none.toml"}),
    "read_world": (lambda: fr.read_world, {"file": "none.toml"}),
    "World": (lambda: fr.World, {"bodies": {}, "dt": 1e-3, "joints": (), "gravity": (0, 0, -9.81)}),
    "world.step": (lambda: world().step, {"inputs": {"box": {"force": (0, 0, 1)}}}),
    "alone.step": (lambda: fr.World({"soft": fr.SoftBody(TOUCHED)}, 1e-3).step, {"inputs": None}),
    "world input": (lambda: lambda v: world().step({"box": {"torque": v}}), {"v": (0, 0, 1)}),
    "join": (lambda: world().join, {"joint": joints.ball("box", "world", (0, 0, 0))}),
    "release": (lambda: world().release, {"which": "hold"}),
    "joint_forces": (lambda: world().joint_forces, {"which": 0}),
    "force_between": (lambda: world().force_between, {"first": "box", "second": "hand"}),
    "drive": (lambda: world().drive, {"name": "hand", "motion": lambda t: STILL}),
    "world.dt": (lambda: lambda v: setattr(world(), "dt", v), {"v": 1e-3}),
    **{name: (lambda name=name: getattr(world(), name), {"name": "box"}) for name in ("pose", "velocity", "energy_of")},
    **{name: (lambda name=name: getattr(world(), name), {"name": "box"}) for name in ("account", "simulator")},
    "RigidBody": (lambda: moved, {"density": 500.0, "position": (0, 0, 0), "velocity": (0, 0, 0)}),
    "Sphere": (lambda: shapes.Sphere, {"radius": 0.1}),
    "Box": (lambda: shapes.Box, {"size": (0.1, 0.1, 0.1)}),
    "Hull": (lambda: shapes.Hull, {"points": EYE[:4, :3]}),
    "hinge": (lambda: joined("hinge"), {"first": "box", "second": "world", "point": (0, 0, 0), "axis": (0, 0, 1)}),
    "base": (
        lambda: lambda **path: moved(density=None, motion=fr.BasePath(**path)),
        {"times": [0.0, 1.0], "positions": np.zeros((2, 3)), "rotations": [[1.0, 0.0, 0.0, 0.0]] * 2},
    ),
    "System": (lambda: fr.System, {"mass": EYE, "damping": EYE, "stiffness": EYE, "contacts": {"tip": EYE[:, :1]}}),
    "reduce": (
        lambda: fr.reduce,
        {
            **{"system": fr.System(mass=EYE, rayleigh=(0.1, 0.1), stiffness=EYE, contacts={"tip": EYE[:, :1]})},
            **{"order": 1, "method": None, "checkpoint": None, "resume": False},
        },
    ),
}


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(("call", "name"), [(call, name) for call, (_, given) in CALLS.items() for name in given])
def test_any_argument_is_taken_or_refused_in_a_sentence(tmp_path, monkeypatch, call, name):
    monkeypatch.chdir(tmp_path)
    make, given = CALLS[call]
    wrong = {}
    for label, value in ANY.items():
        try:
            make()(**given | {name: value})
        except Exception as error:
            if not isinstance(error, FenicsRomError) or "\n" in str(error):
                wrong[label] = repr(error)
    assert wrong == {}


@pytest.mark.parametrize(
    "take",
    [
        lambda value: simulator().step({CONTACT: value}),
        lambda value: fr.Simulator(TOUCHED, 1e-3).set_signal("floor", value),
        lambda value: fr.Batch(ROM, 3, 1e-3).step(np.ma.stack([value] * 4, axis=1) if value is HIDDEN else [value] * 4),
        lambda value: moved(position=value),
        lambda value: shapes.Box(value),
    ],
)
@pytest.mark.parametrize("value", [HIDDEN, ["1", "2", "3"], [10**400] * 3, 1j * np.ones(3)])
def test_what_is_no_number_is_not_made_one(take, value):
    """Of which NumPy drops masks and imaginary parts, and reads texts."""
    with pytest.raises(FenicsRomError):
        take(value)


def test_a_time_step_is_a_number():
    for label in NO_NUMBERS:
        with pytest.raises(StepError, match=r"dt = .*: use a finite number > 0, in s"):
            fr.Simulator(ROM, ANY[label])
    with pytest.raises(StepError, match=r"size = \d+: use a whole number > 0 and at most 100,000,000"):
        fr.Batch(ROM, 2**63, 1e-3)
    with pytest.raises(StepError, match="differentiate: inputs of no step were given"):
        fr.differentiate(simulator(), np.zeros((0, 4)), squares)
