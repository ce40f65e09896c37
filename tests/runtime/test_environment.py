"""Bodies among loads and obstacles at run time: the account, what is off, what is saved, what follows what."""

import copy
import pickle
import warnings
from dataclasses import replace

import numpy as np
import pytest
from bodies import acted_on, box_arrays, scene_text, write_arrays
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning, SceneError, StepError
from fenics_rom.fem.simulator import FullOrderSimulator
from fenics_rom.runtime.steppers.contact_midpoint import ContactMidpoint
from fenics_rom.runtime.steppers.equilibrium import Equilibrium
from fenics_rom.runtime.steppers.midpoint import FusedMidpoint
from fenics_rom.scene.file import parse_scene

CLOSES_TO = 1e-12  # of the largest energy or work seen
SOLVED_TO = 1e-9  # of the largest velocity: as well as contact forces are found
LENGTHS = (0.4, 0.2, 0.1)
PLAIN = "inertia = {}\ndamping = { alpha = 1.0, beta = 1e-3 }\n"
GRAVITY = "gravity = { acceleration = [0, 0, -9.81] }\n"
FLOOR = """
[effects.contact.obstacles.floor]
shape = "half-space"
point = [0, 0, -2e-3]
normal = [0, 0, 1]
"""
BALL = """
[effects.contact.obstacles.ball]
shape = "sphere"
center = [0.45, 0.1, 0.05]
radius = 0.045
"""
ROUGH = "[effects.friction]\ncoefficient = 0.2\n"
EVERYTHING = f"""
inertia = {{}}
{GRAVITY}
[effects.damping]
alpha = 0.5
beta = 1e-4
materials.soft = {{ alpha = 2.0, beta = 2e-3 }}
[effects.damping.dashpots.oil]
surface = "back"
coefficient = 0.3
[effects.springs.bed]
surface = "front"
stiffness = 20.0
[effects.base_motion.quake]
direction = [1, 0, 1]
[effects.prescribed.push]
surface = "top"
[effects.prescribed.poke]
point = [0.39, 0.17, 0.08]
force = [0.0, 0.2, -0.1]
[effects.pressure.wind]
surface = "top"
[effects.tendon.rope]
points = [[0.0, 0.05, 0.1], [0.2, 0.05, 0.1], [0.4, 0.15, 0.1]]
{FLOOR}{BALL}{ROUGH}
"""
CONTACTS = '[contacts.bottom]\nsurface = "bottom"\n[contacts.right]\nsurface = "right"'
TIP = {"outputs.tip": "points = [[0.4, 0.2, 0.1], [0.4, 0.0, 0.0]]", "contacts": CONTACTS}


# These bodies are thrown about, also where no contact points are.
pytestmark = pytest.mark.filterwarnings("ignore:the surface is", "ignore:contact. obstacle .* inside the body")


@pytest.fixture(scope="module")
def mesh(tmp_path_factory):
    """A box of two materials."""
    points, cells = box_arrays(LENGTHS, (3, 2, 2), shake=0.2)
    first = points[cells].mean(axis=1)[:, 0] < LENGTHS[0] / 2
    regions = {"front half": np.flatnonzero(first), "rear half": np.flatnonzero(~first)}
    return write_arrays(tmp_path_factory.mktemp("surrounded") / "box.msh", points, cells, None, regions)


def two(soft=(1e5, 1000.0), hard=(1e7, 2000.0)):
    """Tables of two materials."""
    said = {
        f"materials.{name}": f'cells = "{cells}"\nyoung = {young}\npoisson = 0.3\ndensity = {density}'
        for name, cells, (young, density) in (("soft", "rear half", soft), ("hard", "front half", hard))
    }
    return {"material": None} | said


def scene_of(mesh, effects, **parts):
    return acted_on(mesh, effects, **(TIP | parts))


def reduced(scene, order=None, **choices):
    """The ROM of all that is there."""
    system = fr.assemble(scene)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FenicsRomWarning)
        return fr.reduce(system, order=order or (system.size if scene.effects.inertia is not None else None), **choices)


class Models:
    """The full and the reduced model of a scene."""

    def __init__(self, scene):
        self.scene, self.system, self.rom = scene, fr.assemble(scene), reduced(scene)

    def __repr__(self):
        return "Models"


@pytest.fixture(scope="module")
def everything(mesh):
    """A body with all effects."""
    return Models(scene_of(mesh, EVERYTHING, **two()))


def shaken(seed):
    """Histories that leave nothing still; the ball and the floor move, too."""
    a, b, c = np.random.default_rng(seed).uniform(1, 30, 3)
    return {
        "quake": lambda t: 3 * np.sin(a * t),
        "push": lambda t: [np.sin(b * t), 0.3, -np.cos(c * t)],
        "ball": lambda t: [-0.05 * np.sin(a * t) ** 2, 0.02 * np.sin(b * t), 0.0],
        "floor": lambda t: [0.05 * np.sin(b * t), 0.0, 0.004 * np.sin(c * t) ** 2 - 0.004 * np.sin(c * t * 0.1) ** 2],
    }


class Reduced:
    """A reduced run."""

    def __init__(self, rom, scene=None, signals=None):
        self.body = fr.Simulator(rom, 1e-3, scene=scene, signals=signals)
        self.actuators = sum(rom.actuators.values())

    def step(self, dt, u):
        self.body.dt = dt
        self.body.step(u)


class Full:
    """A full-order run, as fr.simulate makes it, with any step sizes."""

    def __init__(self, system, signals=None):
        self.body = FullOrderSimulator(system, 1e-3, system.scene.environment, signals)
        self.actuators = sum(columns.shape[1] for columns in system.actuators.values())

    def step(self, dt, u):
        self.body.stepper.set_time_step(dt)
        if not self.body.environment.environment.switches_itself:
            u = np.concatenate([np.zeros(self.body.system.contacts[self.body.contact].shape[1]), u])
        self.body.step(u)


def ride(run, steps, seed, least=1e-5, most=5e-2, strength=1.0):
    """Largest gap of the account and its scale, after steps of random lengths under random actuation."""
    random = np.random.default_rng(seed)
    gap = scale = friction = contact = 0.0
    for _ in range(steps):
        run.step(np.exp(random.uniform(np.log(least), np.log(most))), strength * random.standard_normal(run.actuators))
        energy, account = run.body.energy, run.body.ledger
        gone = account.dissipated + account.lost_in_switching + account.numerical
        gap = max(gap, abs(energy - account.supplied + gone))
        scale = max(scale, energy, abs(account.supplied), account.dissipated)
        assert account.friction >= friction - SOLVED_TO * scale
        assert account.contact >= contact - SOLVED_TO * scale
        friction, contact = account.friction, account.contact
    assert scale > 0
    return gap / scale


# --- the energy account ----------------------------------------------------------------------------------------------

QUIETLY = settings(
    max_examples=8, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@given(seed=st.integers(0, 10**6))
@settings(QUIETLY)
def test_account_closes_with_all_effects_on(everything, seed):
    """Steps from 1e-5 to 5e-2 s, in random order; impacts and friction only take."""
    run = Reduced(everything.rom, signals=shaken(seed))
    assert isinstance(run.body._stepper.kernel, ContactMidpoint)
    assert ride(run, 150, seed) <= CLOSES_TO
    account = run.body.ledger
    assert min(account.contact, account.friction) > 0
    assert account.obstacles != 0


@given(seed=st.integers(0, 10**6))
@settings(QUIETLY, max_examples=4)
def test_account_of_the_full_model_closes_with_all_effects_on(everything, seed):
    run = Full(everything.system, signals=shaken(seed))
    assert ride(run, 60, seed) <= CLOSES_TO
    assert run.body.ledger.contact > 0
    run.body.close()


@pytest.mark.parametrize("obstacles", ["", FLOOR])
def test_account_closes_without_inertia(mesh, obstacles):
    still = Models(scene_of(mesh, f"{GRAVITY}[effects.prescribed.push]\nsurface = 'right'{obstacles}"))
    moved = {"push": shaken(3)["push"]} | ({"floor": shaken(3)["floor"]} if obstacles else {})
    run = Reduced(still.rom, signals=moved)
    assert isinstance(run.body._stepper.kernel, Equilibrium)
    assert ride(run, 100, 5) <= CLOSES_TO
    full = Full(still.system, moved)
    assert ride(full, 30, 5) <= CLOSES_TO
    full.body.close()


STRONG = {"soft": (1e4, 100.0), "hard": (1e10, 1e8)}  # a million times as stiff, and as heavy


@given(seed=st.integers(0, 10**6))
@settings(QUIETLY)
def test_energy_is_bounded_by_the_work_for_any_ratio_of_stiffness_and_mass(extreme, seed):
    """Stored and dissipated together never exceed what was supplied."""
    run, random = Reduced(extreme.rom, signals=shaken(seed)), np.random.default_rng(seed)
    for _ in range(150):
        run.step(np.exp(random.uniform(np.log(1e-5), np.log(5e-2))), 100 * random.standard_normal(2))
        account = run.body.ledger
        supplied, lost = account.supplied, account.dissipated
        assert run.body.energy + lost <= supplied + 1e-11 * max(abs(supplied), lost)
        assert np.isfinite(run.body.displacement()).all()


@pytest.fixture(scope="module")
def extreme(mesh):
    """The body with all effects, of materials that differ as much as two can."""
    return Models(scene_of(mesh, EVERYTHING, **two(**STRONG)))


# --- what is off -----------------------------------------------------------------------------------------------------


def stripped(rom, scene, **changes):
    """The ROM as it were if it had been made from another scene, in the same bases."""
    modes = {name: replace(mode, contact_points=np.empty(0, dtype=int)) for name, mode in rom.contact_models.items()}
    return replace(rom, contact_models=modes, environment=scene.environment, scene_text=scene.text, **changes)


def test_contact_that_a_scene_does_not_name_changes_no_bit(mesh):
    """The ROM has it; a run without it takes the steps of one that never had it, in the same form."""
    plain = scene_of(mesh, PLAIN)
    rom = reduced(scene_of(mesh, PLAIN + FLOOR + ROUGH), order=16)
    runs = [fr.Simulator(rom, 1e-3, scene=plain), fr.Simulator(stripped(rom, plain), 1e-3)]
    assert all(type(run._stepper.kernel) is FusedMidpoint and run.environment is None for run in runs)
    assert all(len(run.contact_points) == 0 for run in runs)
    random = np.random.default_rng(0)
    for step in range(300):
        u = random.standard_normal(3)
        for run in runs:
            run.switch(("bottom", "right")[step // 40 % 2])
            run.step(u)
    for part in (0, 1):
        np.testing.assert_array_equal(runs[0].state[part], runs[1].state[part])
    assert runs[0].ledger.sums == runs[1].ledger.sums
    with pytest.raises(StepError, match="there are no contact forces: nothing acts but inputs"):
        runs[0].contact_forces()


def test_weight_that_acts_by_itself_is_the_one_that_is_pushed_by_hand(mesh):
    """To the last bit; and one that the scene does not name is a weight of zero."""
    heavy, plain = scene_of(mesh, PLAIN + GRAVITY), scene_of(mesh, PLAIN)
    rom = reduced(heavy, order=16)
    assert rom.loads == {"gravity": 1}
    by_hand = fr.Simulator(stripped(rom, plain, actuators={"gravity": 1}, loads={}), 1e-3)
    by_itself, without = fr.Simulator(rom, 1e-3), fr.Simulator(rom, 1e-3, scene=plain)
    assert {type(run._stepper.kernel) for run in (by_hand, by_itself, without)} == {FusedMidpoint}
    random = np.random.default_rng(1)
    forces = random.standard_normal((200, 3))
    for u in forces:
        by_hand.step([*u, 1.0])
        by_itself.step(u)
        without.step(u)
    np.testing.assert_array_equal(by_itself.state[0], by_hand.state[0])
    assert by_itself.ledger.sums == by_hand.ledger.sums
    by_hand.reset()
    for u in forces:
        by_hand.step([*u, 0.0])
    np.testing.assert_array_equal(without.state[0], by_hand.state[0])


def test_damping_that_a_scene_does_not_name_is_off(mesh):
    rom = reduced(scene_of(mesh, PLAIN))
    body = fr.Simulator(rom, 1e-3, scene=scene_of(mesh, "inertia = {}"))
    body.step([1.0, 2.0, 3.0])
    start = body.energy
    for _ in range(1000):
        body.step(np.zeros(3))
    assert body.energy == pytest.approx(start, rel=1e-12)
    assert body.ledger.dissipated == 0.0


def test_scene_that_moves_slowly_makes_an_equilibrium_of_any_rom(mesh):
    """A ROM with inertia runs a scene without it."""
    rom = reduced(scene_of(mesh, PLAIN + GRAVITY))
    body = fr.Simulator(rom, 0.1, scene=scene_of(mesh, GRAVITY))
    body.step()
    mode = rom.contact_models["bottom"]
    np.testing.assert_allclose(body.state[0], mode.inputs[:, -1] / mode.eigenvalues, rtol=1e-12)
    assert not body.state[1].any()


# --- what is saved ---------------------------------------------------------------------------------------------------

TABLES = {
    "quake.csv": np.array([[0.0, 0.0], [0.05, 3.0], [0.1, -2.0], [0.2, 0.0]]),
    "push.csv": np.array([[0.0, 0.0, 0.0, 0.0], [0.1, 1.0, 0.0, -3.0], [0.2, 0.0, 2.0, 0.0]]),
    "ball.csv": np.array([[0.0, 0.0, 0.0, 0.0], [0.1, -0.03, 0.01, 0.0], [0.2, 0.0, 0.0, 0.0]]),
}


@pytest.fixture(scope="module")
def tabled(mesh):
    """The ROM with all effects, whose signals are tables."""
    text = EVERYTHING.replace("direction = [1, 0, 1]", 'direction = [1, 0, 1]\ntable = "quake.csv"')
    text = text.replace("[effects.prescribed.push]", '[effects.prescribed.push]\ntable = "push.csv"')
    text = text.replace("radius = 0.045", 'radius = 0.045\ntable = "ball.csv"')
    scene = parse_scene(scene_text(mesh, effects=text, **TIP, **two()), tables=TABLES)
    return reduced(scene)


def bits(body):
    """All that can be read of a body, to compare to the bit."""
    q, r = body.state
    return [
        *map(repr, (q.tolist(), r.tolist(), body.contact, body.time, body.steps, body.ledger.sums)),
        body.displacement("tip").tolist(),
    ]


def run_on(body, steps, seed=0):
    random = np.random.default_rng(seed)
    for step in range(steps):
        if step % 7 == 0:
            body.dt = float(random.choice([5e-4, 1e-3, 2e-3]))
        body.step(random.standard_normal(2))
    return bits(body)


def test_saved_bodies_go_on_to_the_bit(tabled, tmp_path):
    """Saved amid contact, copied, pickled, in a file's ROM; and from the start again."""
    body = fr.Simulator(tabled, 1e-3)
    first = run_on(body, 60)
    assert body.contact_forces("ball").any() or body.contact_forces("floor").any()
    there, pressed = body.save(), body.contact_forces()
    second = run_on(body, 60, seed=1)
    body.restore(there)
    assert bits(body) == first
    others = [copy.copy(body), copy.deepcopy(body), pickle.loads(pickle.dumps(body))]
    fr.write_rom(tmp_path / "rom.h5", tabled)
    elsewhere = fr.Simulator(fr.read_rom(tmp_path / "rom.h5"), 5e-4)
    elsewhere.restore(there)
    acting = tabled.environment
    less = replace(acting, obstacles={name: acting.obstacles[name] for name in acting.obstacles if name != "ball"})
    with pytest.raises(StepError, match=r"a body among other obstacles, .*ball.*, than this simulator's, \w+"):
        fr.Simulator(tabled, 1e-3, scene=less).restore(there)
    for one in (body, *others, elsewhere):
        assert bits(one) == first
        assert run_on(one, 60, seed=1) == second
    body.dt = 1e-3
    body.reset()
    assert body.time == 0.0
    assert run_on(body, 60) == first
    np.testing.assert_array_equal(body.contact_forces(), pressed)


def test_copies_keep_what_they_are_driven_by(tabled):
    body = fr.Simulator(tabled, 1e-3)
    body.set_signal("push", [0.5, 0.0, -1.0])
    body.set_signal("ball", [-0.004, 0.0, 0.0])
    run_on(body, 30)
    other = pickle.loads(pickle.dumps(body))
    assert run_on(other, 30, 1) == run_on(body, 30, 1)


def test_copies_of_bodies_that_are_pressed_in_can_be_made(tabled):
    """The obstacle is where the body was before it gave way."""
    body = fr.Simulator(tabled, 1e-3)
    for depth in np.linspace(0, 0.02, 40):
        body.set_signal("ball", [-depth, 0.0, 0.0])
        body.step([0.0, 0.0])
    other = copy.copy(body)
    assert run_on(other, 30, 1) == run_on(body, 30, 1)


def test_forces_that_were_saved_are_read_again(tabled):
    body = fr.Simulator(tabled, 1e-3)
    run_on(body, 60)
    there, pressed = body.save(), body.contact_forces()
    assert pressed.any()
    run_on(body, 20, seed=1)
    body.restore(there)
    np.testing.assert_array_equal(body.contact_forces(), pressed)
    np.testing.assert_array_equal(copy.copy(body).contact_forces(), pressed)
    body.switch("right" if body.contact == "bottom" else "bottom")
    np.testing.assert_array_equal(body.contact_forces(), pressed)
    body.reset()
    assert not body.contact_forces().any()


def test_functions_and_tables_give_the_same(tabled):
    def of(name):
        table = TABLES[f"{name}.csv"]
        return lambda t: [np.interp(t, table[:, 0], column) for column in table[:, 1:].T]

    said, told = fr.Simulator(tabled, 1e-3), fr.Simulator(tabled, 1e-3, signals={n: of(n) for n in ("push", "ball")})
    driven = fr.Simulator(tabled, 1e-3)
    for name in ("quake", "push", "ball"):
        driven.set_signal(name, of(name))
    assert run_on(said, 60) == run_on(told, 60) == run_on(driven, 60)


def test_drive_acts_from_the_next_step_on(mesh):
    """A constant force on a free mass: its momentum is the sum of force times time."""
    load = PLAIN + '[effects.prescribed.push]\nsurface = "right"\nforce = [0.0, 0.0, 0.0]\n'
    rom = reduced(scene_of(mesh, load.replace("alpha = 1.0, ", ""), supports=None))
    body, mass = fr.Simulator(rom, 1e-2), rom.node_mass.sum()
    momentum = np.zeros(3)
    for force in np.random.default_rng(0).standard_normal((20, 3)):
        body.set_signal("push", force)
        body.step()
        momentum += 1e-2 * force
    carried = body.state[1][:3]  # the first rigid motions are the translations
    assert np.linalg.norm(carried) * np.sqrt(mass) == pytest.approx(np.linalg.norm(momentum), rel=1e-10)


# --- what is refused, and leaves everything as it was ----------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("push", [1.0, 2.0], r"push = \[1.0, 2.0\]: use 3 finite numbers, or a function of time that gives it"),
        ("push", [1.0, np.nan, 0.0], "push = .*: use 3 finite numbers"),
        ("quake", [1.0, 2.0], "quake = .*: use a finite number, or a function of time that gives it"),
        ("gravity", "much", "gravity = 'much': use a finite number"),
        ("ball", np.inf, "ball = inf: use 3 finite numbers"),
        ("bal", [0.0, 0.0, 0.0], "no load or obstacle 'bal'; there is ball, floor, .*; did you mean 'ball'"),
        ("rope", 1.0, "no load or obstacle 'rope'"),
    ],
)
def test_bad_drive_is_refused(tabled, name, value, message):
    body = fr.Simulator(tabled, 1e-3)
    first = run_on(body, 20)
    with pytest.raises(StepError, match=message):
        body.set_signal(name, value)
    assert bits(body) == first


@pytest.mark.parametrize("name", ["push", "quake", "ball"])
@pytest.mark.parametrize("value", [np.nan, [1.0, 2.0], None, "x", [1e308, 1e308, -1e308]])
def test_function_that_gives_nonsense_leaves_the_state_as_it_was(tabled, name, value):
    if name == "quake" and not np.isscalar(value):
        value = [np.inf]
    body = fr.Simulator(tabled, 1e-3)
    first = run_on(body, 60)
    assert body.contact_forces().any()
    there = body.save()
    body.set_signal(name, lambda t: value)
    with pytest.raises(StepError), np.errstate(all="ignore"):
        body.step()
    assert bits(body) == first
    again = body.save()
    for kept, now in zip(there.obstacles, again.obstacles, strict=True):
        np.testing.assert_array_equal(kept, now)


def test_wrong_inputs_leave_the_state_as_it_was(tabled):
    body = fr.Simulator(tabled, 1e-3)
    first = run_on(body, 40)
    for u in ([1.0], [1.0, 2.0, 3.0], [np.nan, 0.0], [[1.0, 2.0]], "ab", [1.0, None]):
        with pytest.raises(StepError):
            body.step(u)
        assert bits(body) == first
    with pytest.raises(StepError, match=rf"use {body.inputs} numbers in N, or the \d+ of actuators \(got \[1\.0\]\)"):
        body.step([1.0])
    with pytest.raises(StepError, match="inputs of contact mode"):
        body.rollout(np.zeros((3, 3)))
    assert bits(body) == first


def test_body_that_begins_in_an_obstacle_is_refused(everything):
    inside = {"floor": [0.0, 0.0, 0.01]} | {name: shaken(0)[name] for name in ("quake", "push")}
    with pytest.raises(StepError, match=r"a start outside of all obstacles, but 0\.008 m inside 'floor' is"):
        fr.Simulator(everything.rom, 1e-3, signals=inside)
    with pytest.raises(StepError, match=r"a start outside of all obstacles, but 0\.008 m inside 'floor' is"):
        Full(everything.system, inside)


def test_load_without_a_history_is_refused(everything):
    with pytest.raises(SceneError, match=r"'quake' has neither a value nor a table; .*signals = \{'quake': lambda t"):
        fr.Simulator(everything.rom, 1e-3)
    with pytest.raises(SceneError, match="no load or obstacle 'wind'"):
        fr.Simulator(everything.rom, 1e-3, signals=shaken(0) | {"wind": 1.0})
    with pytest.raises(StepError, match="no obstacle 'bal'; there is ball, floor"):
        fr.Simulator(everything.rom, 1e-3, signals=shaken(0)).contact_forces("bal")


@pytest.mark.parametrize(
    ("made", "asked", "message"),
    [
        (PLAIN, PLAIN + GRAVITY, "effects.gravity: ROM 'scene' was made without it; to have it, make a ROM from this"),
        (PLAIN, PLAIN + FLOOR, "effects.contact: ROM 'scene' was made without it"),
        (PLAIN + FLOOR, PLAIN + FLOOR + ROUGH, "effects.friction: ROM 'scene' was made without it"),
        (GRAVITY, PLAIN + GRAVITY, "ROM 'scene' was made without it; .*fenics-rom reduce scene -o ROM.h5"),
        (PLAIN, PLAIN.replace("1.0", "2.0"), "effects.damping is not what ROM 'scene' was made with"),
        (PLAIN + GRAVITY, PLAIN + GRAVITY.replace("9.81", "1.62"), "effects.gravity is not what ROM 'scene' was made"),
        (
            PLAIN + "[effects.springs.bed]\nsurface = 'front'\nstiffness = 2.0",
            PLAIN,
            "effects.springs is part of ROM 'scene', but not of the scene",
        ),
        (
            PLAIN + "[effects.tendon.rope]\npoints = [[0.0, 0.0, 0.0], [0.4, 0.0, 0.0]]",
            PLAIN + "[effects.tendon.rope]\npoints = [[0.0, 0.0, 0.0], [0.4, 0.2, 0.0]]",
            "effects.tendon is not what ROM 'scene' was made with",
        ),
    ],
)
def test_scene_that_the_rom_was_not_made_for_is_refused(mesh, made, asked, message):
    rom = reduced(scene_of(mesh, made), order=4)
    with pytest.raises(SceneError, match=message):
        fr.Simulator(rom, 1e-3, scene=scene_of(mesh, asked))


def test_what_may_change_at_run_time_changes(mesh):
    """Obstacles, laws and signals; the ROM stays."""
    load = "[effects.prescribed.push]\nsurface = 'right'\nforce = [0.0, 0.0, -1.0]\n"
    rom = reduced(scene_of(mesh, PLAIN + load + FLOOR + ROUGH))
    changed = PLAIN + load.replace("-1.0", "-3.0") + BALL + ROUGH.replace("0.2", "0.1")
    changed += "[effects.contact]\nrestitution = 0.5\n"
    body = fr.Simulator(rom, 1e-3, scene=scene_of(mesh, changed))
    assert list(body.environment.obstacles) == ["ball"]
    law = body.environment.environment.contact_law
    assert (law.friction, law.restitution) == (0.1, 0.5)
    np.testing.assert_array_equal(body.environment.loads_at(0.0), [0.0, 0.0, -3.0])


def test_free_body_has_no_equilibrium(mesh):
    free = scene_of(mesh, GRAVITY, supports=None)
    rom = reduced(scene_of(mesh, PLAIN.replace("alpha = 1.0, ", "") + GRAVITY, supports=None), order=10)
    message = "effects: inertia is missing, and a body that nothing holds has no equilibrium"
    with pytest.raises(SceneError, match=message):
        fr.Simulator(rom, 1e-3, scene=free)
    with pytest.raises(SceneError, match=message):
        fr.simulate(scene_of(mesh, GRAVITY, supports=None, run="dt = 0.1\nduration = 1"))


def test_bodies_of_a_batch_are_under_the_same_loads(mesh):
    load = PLAIN + GRAVITY + '[effects.prescribed.push]\nsurface = "right"\n'
    rom = reduced(scene_of(mesh, load), order=16)
    push = {"push": shaken(1)["push"]}
    batch, body = fr.Batch(rom, 3, 1e-3, signals=push), fr.Simulator(rom, 1e-3, signals=push)
    for u in np.random.default_rng(0).standard_normal((100, 3)):
        batch.step(np.tile(u, (3, 1)))
        body.step(u)
    shape = body.displacement("tip")
    assert np.abs(batch.displacement("tip") - shape).max() <= 1e-11 * np.abs(shape).max()


# --- switching -------------------------------------------------------------------------------------------------------

PRESSED = {
    "low": [(0.0, 0, 0, 0), (0.1, 0, 0, 0.01), (0.2, 0, 0, 0.0), (0.4, 0, 0, 0)],
    "ball": [(0.0, 0, 0, 0), (0.2, 0, 0, 0), (0.3, -0.012, 0, 0), (0.4, 0, 0, 0)],
}
LOW = """
[effects.contact.obstacles.low]
shape = "sphere"
center = [0.267, 0.1, -0.051]
radius = 0.05
table = "low.csv"
"""


def test_contact_mode_follows_the_obstacle_that_is_near(mesh):
    """Pushed from below, then from the side; the full model goes through the same modes."""
    tables = {f"{name}.csv": np.array(rows, dtype=float) for name, rows in PRESSED.items()}
    effects = PLAIN + LOW + BALL.replace("0.045", '0.045\ntable = "ball.csv"')
    scene = parse_scene(
        scene_text(mesh, effects=effects, **TIP, run="dt = 1e-3\nduration = 0.4", **two(hard=(1e5, 1000.0))),
        tables=tables,
    )
    models = Models(scene)
    full, run = fr.simulate(models.system), fr.simulate(models.rom)
    assert run.contacts == ("bottom", "right")
    np.testing.assert_array_equal(run.contact, full.contact)
    assert run.contact[50] == 0
    assert run.contact[300] == 1
    scale = np.abs(full.outputs["tip"]).max()
    assert scale > 1e-3
    assert np.abs(run.outputs["tip"] - full.outputs["tip"]).max() <= 1e-8 * scale
    for name in ("low", "ball"):
        force = np.abs(full.forces[name]).max()
        assert force > 0
        assert np.abs(run.forces[name] - full.forces[name]).max() <= 1e-6 * force
    assert max(full.balance_error, run.balance_error) <= CLOSES_TO

    body = fr.Simulator(models.rom, 1e-3)
    for _ in range(np.flatnonzero(run.contact)[0] - 1):
        body.step()
    before = bits(body)
    with pytest.raises(StepError, match="input of contact mode"):
        body.step([1.0])  # refused after the switch, which is taken back
    assert bits(body) == before
    body.step()
    assert body.contact == "right"
