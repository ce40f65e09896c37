"""What a simulator keeps: the table of the runtime's page, cell by cell and field by field."""

import copy
import dataclasses
import pickle
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from bodies import acted_on
from soft_rom import soft_rom

import fenics_rom as fr
from fenics_rom.errors import StepError
from fenics_rom.fem.simulator import FullOrderSimulator
from fenics_rom.mechanics.contact import ContactResidual
from fenics_rom.mechanics.step import StepperState
from fenics_rom.runtime.simulated_body import SimulatorState

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")  # they are what is kept

PAGE = Path(fr.__file__).parent / "runtime" / "README.md"
TABLE = PAGE.read_text().partition("| of a simulator |")[2].partition("\n\n")[0].splitlines()[2:]
ROWS = {cells[1].strip(): [cell.strip() for cell in cells[2:5]] for cells in (line.split("|") for line in TABLE)}


def searched(body):
    """What the next search for contact forces begins with."""
    return body.save().stepper.search or ()


CARRIED = "what a step with contact or large deformation carries along"
# Of each row: how it is read, and which fields of a saved state it is.
READ = {
    "contact mode": (lambda b: b.contact, "contact"),
    "displacement and velocity": (
        lambda b: (b.state, b.energy, b.energy_coordinates, b.pose),
        "stepper stepper.state stepper.rigid_displacement stepper.frame",
    ),
    CARRIED: (lambda b: (b.save().stepper.auxiliary, b.save().gas), "stepper.auxiliary gas"),
    "forces of contact and of strokes, and those that the next search begins with": (
        lambda b: (b.obstacle_forces(), b.reactions, searched(b)[:1], searched(b)[2:]),
        "stepper.contact stepper.search stepper.reactions",
    ),
    "places and velocities of obstacles": (lambda b: b.environment and b.environment.state, "obstacles"),
    "time and number of steps": (lambda b: (b.time, b.steps, b.save().since), "steps since"),
    "sums of the energy account": (lambda b: b.ledger.sums, "sums"),
    "surface's peak, and largest loss in a switch": (lambda b: (b.surface_peak, b.loss), "surface_peak loss"),
    "bound and estimate of the error": (lambda b: [told.norm for told in b.stated_errors.values()], "errors"),
    "what sensors remember, and the last step if reactions are read": (
        lambda b: (b.save().sensed, b.save().rubbed, b.save().last),
        "sensed rubbed last",
    ),
    "warnings of contact and of large deformation": (
        lambda b: (b.warnings, b.mismatch, searched(b)[1:2], b.save().stepper.notes),
        "stepper.notes told",
    ),
    "time step": (lambda b: b.dt, "dt"),
    "signals that were set": (lambda b: b.environment and dict(b.environment.signals), ""),
}
OF_LINEAR = {row for row in READ if row.startswith(("forces", "places", "signals", "surface", "bound", "what sensors"))}
OUTPUTS = {
    "outputs.tip": "points = [[1.0, 0.4, 0.3]]",
    "readings.held": 'quantity = "reaction"',
    "outputs.feel": 'surface = "bottom"\nquantity = "touch"\nsensor = { force_noise = 1.0, delay = 2e-3 }',
}
PLACE = [0.0, 0.0, -1e-3]


@cache
def linear_rom(mesh):
    """A box between a floor that moves and a ball, whose contact mode follows them."""
    effects = """
inertia = {}
damping = { beta = 1e-4 }
gravity = { acceleration = [0, 0, -9.81] }
friction = { coefficient = 0.5 }
contact.obstacles.floor = { shape = "half-space", point = [0, 0, -2e-3], normal = [0, 0, 1] }
contact.obstacles.ball = { shape = "sphere", center = [1.06, 0.2, 0.15], radius = 0.05 }
"""
    contacts = '[contacts.right]\nsurface = "right"\n[contacts.bottom]\nsurface = "bottom"'
    scene = acted_on(mesh, effects, contacts=contacts, **OUTPUTS)
    return fr.reduce(fr.assemble(scene), order=20, errors=True)


def stir(body, seed):
    """Steps after which nothing of a linear body is as it began."""
    random = np.random.default_rng(seed)
    body.set_signal("floor", PLACE)
    body.set_signal("ball", lambda t: [-0.03 * np.sin(90 * t) ** 2, 0.0, 0.0])
    for _ in range(60):
        body.dt = float(random.choice([1e-3, 2e-3]))
        body.step(20.0 * random.standard_normal(body.inputs))
    while not body.obstacle_forces().any():  # until it touches again
        body.step(20.0 * random.standard_normal(body.inputs))
    # As after steps whose forces were found to 1e-5: which bodies need such steps, only luck would tell.
    solver = body._stepper.interface.solver
    solver.search = solver.search._replace(residual=ContactResidual(seed + 1, 1e-5))


def strain(body, seed):
    """Steps after which nothing of a body with large deformation is as it began, obstacles apart."""
    random = np.random.default_rng(seed)
    for _ in range(10):
        body.dt = float(random.choice([5e-3, 1e-2]))
        body.switch(str(random.choice(list(body.rom.contact_models))))
        body.step(random.standard_normal(body.inputs) * [800.0, 800.0, 800.0, 1e3, 1.0])
    body.switch("middle" if seed == 0 else "tip")


@pytest.fixture(params=["linear", "linearly-implicit", "newton"])
def kind(request, box_file):
    """A maker of new bodies of one kind, and what moves them."""
    if request.param == "linear":
        return lambda: fr.Simulator(linear_rom(box_file), 1e-3), stir
    return lambda: fr.Simulator(soft_rom(), 5e-3, stepper=request.param), strain


def readings(body):
    return {row: copy.deepcopy(read(body)) for row, (read, _) in READ.items()}


def equal(one, other):
    try:
        np.testing.assert_equal(one, other)
    except AssertionError:
        return False
    return True


def check(column, body, cases):
    """Compares a body with what each word of a column of the table stands for."""
    now = readings(body)
    for row, words in ROWS.items():
        assert equal(now[row], cases[words[column]][row]), (row, words[column])


def test_the_table_has_every_field():
    assert list(ROWS) == list(READ)
    fields = {field.name for field in dataclasses.fields(SimulatorState)} - {"belongs"}  # which is no state
    fields |= {f"stepper.{name}" for name in StepperState._fields}
    assert sorted(" ".join(names for _, names in READ.values()).split()) == sorted(fields)


def test_runs_leave_their_mark_on_every_field(kind):
    """Or the tests below compare nothing."""
    make, move = kind
    new, body = readings(make()), make()
    move(body, 0)
    now = readings(body)
    untouched = {"midpoint": set(), "linearly-implicit": OF_LINEAR, "newton": OF_LINEAR | {CARRIED}}[body.stepper]
    assert {row for row in READ if equal(now[row], new[row])} == untouched
    assert body.warnings


def test_reset(kind):
    make, move = kind
    body, new = make(), make()
    move(body, 0)
    kept = readings(body)
    body.reset()
    assert body.warnings == new.warnings  # of the scene alone
    new.dt = body.dt
    if move is stir:
        for name, signal in kept["signals that were set"].items():
            new.set_signal(name, signal)
        new.reset()  # obstacles are where the signals put them
    check(0, body, {"new": readings(new), "kept": kept})


@pytest.mark.parametrize("elsewhere", [False, True])
def test_restore(kind, elsewhere):
    make, move = kind
    body = make()
    move(body, 0)
    saved, state = readings(body), body.save()
    if elsewhere:
        body = make()
    move(body, 1)
    kept = readings(body)
    body.restore(state)
    check(1, body, {"saved": saved, "kept": kept})


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, lambda body: pickle.loads(pickle.dumps(body))])
def test_copy_and_pickle(kind, copied):
    make, move = kind
    body = make()
    move(body, 0)
    if move is stir:
        body.set_signal("ball", [0.0, 0.0, 0.0])  # a function of a test cannot be pickled
    kept = readings(body)
    check(2, copied(body), {"kept": kept})


@pytest.mark.filterwarnings("ignore:(overflow|invalid value)")
@pytest.mark.parametrize("strength", [1e200, np.nan])
def test_a_step_that_fails(kind, strength):
    make, move = kind
    body = make()
    move(body, 0)
    before = readings(body)
    with pytest.raises(StepError):
        body.step(np.full(body.inputs, strength))
    assert equal(readings(body), before)


def test_a_full_order_step_that_fails_leaves_the_contact_mode(box_file):
    contacts = '[contacts.right]\nsurface = "right"\n[contacts.bottom]\nsurface = "bottom"'
    ball = 'contact.obstacles.ball = { shape = "sphere", center = [0.5, 0.2, -0.051], radius = 0.05 }'
    system = fr.assemble(acted_on(box_file, f"inertia = {{}}\n{ball}", contacts=contacts))
    body = FullOrderSimulator(system, 1e-3, system.scene.environment)
    with pytest.raises(ValueError):  # noqa: PT011, one input too many
        body.step(np.ones(1))
    assert (body.contact, body.time, body.energy) == ("right", 0.0, 0.0)
    body.step(np.empty(0))
    assert body.contact == "bottom"
    body.close()
