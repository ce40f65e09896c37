"""Chambers that hold gas: closed forms, the account, what leaks, what a valve lets in."""

import math

import numpy as np
import pytest
from bodies import acted_on, box_arrays, box_surfaces, hollow_box, scene_text, write_arrays
from scipy.integrate import quad
from scipy.optimize import brentq

import fenics_rom as fr
from fenics_rom.errors import SceneError, StepError
from fenics_rom.fem.simulator import FullOrderSimulator
from fenics_rom.mechanics.gas import ATMOSPHERE
from fenics_rom.scene.file import parse_scene
from fenics_rom.world.shapes import Box

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
BOTH = pytest.mark.parametrize("model", ["full", "reduced"])
EXPONENTS = pytest.mark.parametrize("exponent", [1.0, 1.4])
EDGES = (0.04, 0.02, 0.02)
AREA, VOLUME = EDGES[1] * EDGES[2], 2e-5
MASS = 1000.0 * AREA * EDGES[0]
GUIDED = "\n".join(
    f'[[supports.held]]\nsurface = "{side}"\nnormal = {normal}'
    for side, normal in (("front", [0, 1, 0]), ("back", [0, 1, 0]), ("bottom", [0, 0, 1]), ("top", [0, 0, 1]))
)


def piston(folder, exponent, effects="inertia = {}\n", **gas):
    """A block that slides between walls, with gas between it and a wall on its left."""
    mesh = write_arrays(folder / "block.msh", *box_arrays(EDGES, (2, 1, 1)))
    said = ", ".join(f"{key} = {value}" for key, value in {"exponent": exponent, "volume": VOLUME, **gas}.items())
    air = f'[effects.pressure.air]\nsurface = "left"\ncontrol = "gas"\ngas = {{ {said} }}\n'
    contacts, material = '[contacts.right]\nsurface = "right"', "young = 1e9\npoisson = 0.0\ndensity = 1000.0"
    text = scene_text(mesh, supports=None, effects=effects + air, contacts=contacts, material=material)
    return fr.assemble(parse_scene(f"{GUIDED}\n{text}"))


def body_of(system, model, h, **choices):
    if model == "full":
        return FullOrderSimulator(system, h, system.scene.environment)
    return fr.Simulator(fr.reduce(system, **choices), h)


def missed(body):
    """By how much the account misses, as a share."""
    ledger = body.ledger
    gone = ledger.dissipated + ledger.numerical + ledger.lost_in_switching
    return abs(body.energy - ledger.supplied + gone) / max(body.energy, abs(ledger.supplied), gone)


@BOTH
@EXPONENTS
def test_a_piston_swings_as_a_gas_spring(tmp_path, model, exponent):
    """f = √(γ p_a A²/(V₀ m))/2π, which a step of h shifts as the midpoint rule does; nothing is supplied or lost."""
    body = body_of(piston(tmp_path, exponent), model, 2e-4, order=8, method="modal")
    expected = math.sqrt(exponent * ATMOSPHERE * AREA**2 / (VOLUME * MASS))
    body.step(np.array([1e-3, 0.0, 0.0, 0.0]))
    pushed, places, times = body.ledger.supplied, [], []
    for _ in range(400):
        body.step(np.zeros(4))
        places.append(body.displacement()[:, 0].mean())
        times.append(body.time)
    x, t = np.array(places), np.array(times)
    up = np.flatnonzero((x[:-1] < 0) & (x[1:] >= 0))
    crossed = t[up] - x[up] * (t[1] - t[0]) / (x[up + 1] - x[up])
    ω = 2 * np.pi / np.diff(crossed).mean()
    assert len(up) >= 2
    assert 1e4 * np.tan(ω * 1e-4) == pytest.approx(expected, rel=1e-4)
    assert np.abs(x).max() < 1e-3 * VOLUME / AREA
    assert abs(body.ledger.supplied - pushed) <= 1e-13 * pushed
    assert missed(body) <= 1e-12


@BOTH
@EXPONENTS
def test_a_piston_on_a_spring_rests_where_pressures_say(tmp_path, model, exponent):
    """K x = p A + F with p of V₀ + A x; blown in, then pressed; body, spring and gas store what is supplied."""
    spring = '[effects.springs.back]\nsurface = "right"\nstiffness = 2e3\n'
    system = piston(tmp_path, exponent, spring)
    body = body_of(system, model, 1.0)
    for force, amount in ((0.0, 1e-5), (20.0, 1e-5), (-40.0, 3e-5), (0.0, 0.0)):
        inputs = [force, 0.0, 0.0, amount]
        body.step(np.array(inputs))

        def pressure(s, amount=amount):
            return ATMOSPHERE * (((VOLUME + amount) / (VOLUME + s)) ** exponent - 1)

        def lack(s, amount=amount, force=force):  # of the left end: what the spring yields, and the block itself
            return (pressure(s) * AREA + force) / 2e3 + pressure(s) * EDGES[0] / 1e9 - s / AREA

        moved = brentq(lack, -1e-5, 1e-4, xtol=1e-20, rtol=1e-15)
        assert body.reactions["air"] == pytest.approx(pressure(moved), rel=1e-9, abs=1e-6)
        assert body.gas == {"air": amount}
        assert missed(body) <= 1e-11 or not amount


SOFT = {
    "material": "young = 1e5\npoisson = 0.3\ndensity = 1000.0",
    "contacts": '[contacts.right]\nsurface = "right"',
    "readings.inside": 'quantity = "volume"\nof = "air"',
}
AIR = '[effects.pressure.air]\nsurface = "chamber"\ncontrol = "gas"\ngas = {{ exponent = {exponent} }}\n'
MOVING = "inertia = {}\ndamping = { beta = 1e-3 }\n"


@pytest.fixture(scope="module")
def box(tmp_path_factory):
    return hollow_box(tmp_path_factory.mktemp("hollow"))


@BOTH
@EXPONENTS
@pytest.mark.parametrize("h", [1e-5, 1e-3, 1e-1])
def test_a_sealed_chamber_in_a_soft_body_supplies_nothing(box, model, exponent, h):
    """After it was blown up; energy falls, at any step."""
    body = body_of(fr.assemble(acted_on(box, MOVING + AIR.format(exponent=exponent), **SOFT)), model, h, order=12)
    for amount in (1e-6, 3e-6):
        body.step(np.array([0.1, 0.0, 0.05, amount]))
        assert missed(body) <= 1e-12
    supplied, energies = body.ledger.supplied, [body.energy]
    for _ in range(20):
        body.step(np.array([0.0, 0.0, 0.0, 3e-6]))
        energies.append(body.energy)
        assert abs(body.ledger.supplied - supplied) <= 1e-12 * supplied
        assert missed(body) <= 1e-12
    assert np.diff(energies).max() <= 1e-13 * energies[0]


@BOTH
@EXPONENTS
def test_an_equilibrium_has_the_pressure_of_the_volume_that_is_read(box, model, exponent):
    body = body_of(fr.assemble(acted_on(box, AIR.format(exponent=exponent), **SOFT)), model, 1.0)
    for amount in (2e-6, -1e-6):
        body.step(np.array([0.1, 0.0, 0.0, amount]))
        held = (3e-6 + amount) / float(body.reading("inside"))
        assert body.reactions["air"] == pytest.approx(ATMOSPHERE * (held**exponent - 1), rel=1e-10)
        assert missed(body) <= 1e-12


@EXPONENTS
def test_small_amounts_in_a_body_that_deforms_largely_are_the_linear_bodys(box, exponent):
    """Moving, and from equilibrium to equilibrium."""
    for around, h in ((MOVING, 1e-3), ("", 1.0)):
        bodies = []
        for large in ("", 'large_deformation = { material = "neo_hookean" }\n'):
            system = fr.assemble(acted_on(box, around + large + AIR.format(exponent=exponent), **SOFT))
            bodies.append(FullOrderSimulator(system, h, system.scene.environment))
            for amount in (5e-10, 1e-9, 1e-9):
                bodies[-1].step(np.array([0.0, 0.0, 0.0, amount]))
            assert missed(bodies[-1]) <= 1e-9
        one, other = bodies
        assert one.reactions["air"] == pytest.approx(other.reactions["air"], rel=2e-4)
        assert one.energy == pytest.approx(other.energy, rel=1e-3)


def test_a_sealed_chamber_of_a_large_body_supplies_next_to_nothing(box):
    """What its volume changes by and what the middle of a step says differ to the third order; the account closes."""
    large = 'large_deformation = { material = "neo_hookean" }\n'
    system, left = fr.assemble(acted_on(box, MOVING + large + AIR.format(exponent=1.4), **SOFT)), []
    for h in (4e-3, 2e-3):
        body = FullOrderSimulator(system, h, system.scene.environment)
        for k in range(round(0.02 / h)):
            body.step(np.array([0.5 if k * h < 0.008 else 0.0, 0.0, 0.0, 5e-6]))
            if round((k + 1) * h, 9) == 0.008:
                supplied = body.ledger.supplied
        assert missed(body) <= 1e-11
        left.append(abs(body.ledger.supplied - supplied) / supplied)
    assert max(left) < 1e-4


def test_what_a_valve_lets_in_ends_at_the_supplys_pressure(box):
    """Choked at first, so that it comes evenly; a chamber that holds 3 times as much gas has twice p_a."""
    valve = '[effects.pressure.air]\nsurface = "chamber"\ncontrol = "valve"\nvalve = { area = 1e-7 }\n'
    stiff = SOFT | {"material": "young = 1e9\npoisson = 0.3\ndensity = 1000.0"}
    body, supply = body_of(fr.assemble(acted_on(box, MOVING + valve, **stiff)), "reduced", 1e-3, order=12), 2e5
    rest, amounts = float(body.reading("inside")), []
    for _ in range(400):
        body.step(air=supply)
        amounts.append(body.gas["air"])
        assert missed(body) <= 1e-12
    rate = 0.6e-7 * math.sqrt(287.05 * 293.15) * 0.68473 * (1 + supply / ATMOSPHERE)
    np.testing.assert_allclose(amounts[:4], rate * 1e-3 * np.arange(1, 5), rtol=1e-4)
    assert rest == pytest.approx(3e-6)
    assert body.reactions["air"] == pytest.approx(supply, rel=1e-6)
    assert amounts[-1] == pytest.approx(rest * supply / ATMOSPHERE, rel=2e-3)
    again = fr.Simulator(body.rom, 1e-3)
    again.restore(body.save())
    for each in (body, again):
        each.step(air=-5e4)
    assert again.gas == body.gas != {"air": amounts[-1]}
    assert again.energy == body.energy


def test_a_rom_made_by_pressure_is_run_with_gas(box, tmp_path):
    """Whose mesh says what its chamber holds."""
    effects = MOVING + AIR.format(exponent=1.4)
    plain = effects.replace('control = "gas"\ngas = { exponent = 1.4 }\n', "")
    roms = [fr.reduce(fr.assemble(acted_on(box, each, **SOFT)), order=10) for each in (plain, effects)]
    for number, rom in enumerate(roms):
        fr.write_rom(tmp_path / f"{number}.h5", rom)
    one = fr.Simulator(fr.read_rom(tmp_path / "0.h5"), 1e-3, scene=acted_on(box, effects, **SOFT))
    other = fr.Simulator(fr.read_rom(tmp_path / "1.h5"), 1e-3)
    for body in (one, other):
        body.step(air=2e-6)
    assert one.reactions == pytest.approx(other.reactions, rel=1e-10)
    assert other.rom.environment.gases["air"].volume == pytest.approx(3e-6)


@pytest.mark.parametrize(
    ("air", "message"),
    [
        (
            'surface = "part"\ncontrol = "gas"',
            r"effects.pressure.air: the surface has an opening whose rim moves, so that it encloses no volume: "
            r"\d open edges around \[.*\], about 0.0\d+ m across; use closed surfaces",
        ),
        ('surface = "chamber"\ngas = {}', r"air.gas: goes with control = 'gas' or 'valve' \(got 'pressure'\)"),
        ('surface = "chamber"\ncontrol = "gas"\nvalve = { area = 1e-6 }', r"air.valve: goes with control = 'valve'"),
        ('surface = "chamber"\ncontrol = "valve"', r"air.valve is missing: the orifice between the supply and"),
        (
            'surface = "chamber"\ncontrol = "valve"\nvalve = { area = 0.0 }',
            r"valve.area = 0.0: use a finite number > 0",
        ),
        (
            'surface = "chamber"\ncontrol = "gas"\ngas = { exponent = 0.9 }',
            r"gas.exponent = 0.9: use a finite number >= 1",
        ),
        ('surface = "chamber"\ncontrol = "gas"\ngas = { volume = 0.0 }', r"gas.volume = 0.0: use a finite number > 0"),
        (
            'surface = "chamber"\ncontrol = "valve"\nvalve = { area = 1e-6 }\ngas = { exponent = 1.4 }',
            r"gas.exponent = 1.4: what comes through a valve is as warm as its supply, and stays so; use 1",
        ),
    ],
)
def test_what_is_no_chamber_with_gas_is_told(box, air, message):
    with pytest.raises(SceneError, match=message):
        fr.assemble(acted_on(box, f"{MOVING}[effects.pressure.air]\n{air}\n", **SOFT))


def test_gas_that_is_not_there_is_told_with_the_time(box):
    body = body_of(fr.assemble(acted_on(box, MOVING + AIR.format(exponent=1.0), **SOFT)), "reduced", 1e-3, order=10)
    body.step(air=1e-6)
    with pytest.raises(StepError, match=r"t = 0.001 s: chamber 'air': -5e-06 m³ of gas are given; use more"):
        body.step(air=-5e-6)
    assert body.gas == {"air": 1e-6}


def test_batches_rollouts_and_worlds_are_steps(box):
    """Of two chambers' gas, that is blown in and that comes through a valve; the account of the world closes."""
    run = 'dt = 1e-3\nduration = 0.01\nload = [{ actuator = "air", force = [2e-6] }]'
    for control in ('control = "gas"', 'control = "valve"\nvalve = { area = 1e-6 }'):
        air, size = AIR.format(exponent=1.0).replace('control = "gas"', control), 1e11 if "valve" in control else 1.0
        system = fr.assemble(acted_on(box, MOVING + air, **SOFT, run=run.replace("2e-6", str(2e-6 * size))))
        rom = fr.reduce(system, order=10)
        single, rolled, batch = fr.Simulator(rom, 1e-3), fr.Simulator(rom, 1e-3), fr.Batch(rom, 2, 1e-3)
        u = np.zeros((10, single.inputs))
        u[:, -1] = 2e-6 * size
        for row in u:
            single.step(row)
            batch.step(np.array([row, 0 * row]))
        rolled.rollout(u)
        assert batch.reactions["air"][0] == rolled.reactions["air"] == single.reactions["air"]
        assert batch.energy[0] == rolled.energy == single.energy
        assert batch.reactions["air"][1] == 0.0
        full, reduced = fr.simulate(system), fr.simulate(rom)
        for trajectory in (full, reduced):
            assert trajectory.balance_error <= 1e-12
            assert trajectory.reactions["air"][-1] == pytest.approx(single.reactions["air"], rel=5e-3)
        cube = fr.RigidBody(Box((0.02, 0.02, 0.02)), mass=0.01, position=(0.2, 0.0, 0.0))
        world = fr.World({"soft": fr.SoftBody(rom), "cube": cube}, 1e-3)
        for row in u:
            world.step({"soft": {"air": row[-1]}})
        assert world.energy == pytest.approx(single.energy, rel=1e-6)
        assert world.energy == pytest.approx(world.ledger.supplied - world.ledger.dissipated, rel=1e-12)


def balloon(folder, control, angle=0.05, run=None):
    """A sector of a thick sphere of rubber between four planes through its centre, and what its chamber holds, m³.

    `run`: whose loads train a reduced model, in a function of that volume.
    """
    share, tangents = 1.1, np.tan(angle)
    points, cells = box_arrays((1.0, 1.0, 1.0), (3, 1, 1))
    surfaces = box_surfaces(points, cells)
    along = np.column_stack([np.ones(len(points)), tangents * points[:, 1], tangents * points[:, 2]])
    radii = INNER * (1 + (share - 1) * points[:, 0])
    points = radii[:, None] * along / np.linalg.norm(along, axis=1)[:, None]
    volume = abs(np.linalg.det(points[surfaces["left"]])).sum() / 6
    s, c = float(np.sin(angle)), float(np.cos(angle))
    planes = {"front": [0.0, 1.0, 0.0], "bottom": [0.0, 0.0, 1.0], "back": [-s, c, 0.0], "top": [-s, 0.0, c]}
    held = "".join(f'[[supports.held]]\nsurface = "{name}"\nnormal = {normal}\n' for name, normal in planes.items())
    effects = f'large_deformation = {{ material = "mooney_rivlin", constants = [{C10}, {C01}] }}\n'
    effects += f'[effects.pressure.air]\nsurface = "left"\ncontrol = "{control}"\n'
    effects += f"gas = {{ volume = {volume} }}\n" * (control == "gas")
    poisson = 0.4999
    material = f"young = {4 * (C10 + C01) * (1 + poisson)}\npoisson = {poisson}\ndensity = 1000.0"
    contacts, mesh = '[contacts.right]\nsurface = "right"', write_arrays(folder / "sector.msh", points, cells, surfaces)
    parts = {} if run is None else {"run": run(volume)}
    text = scene_text(mesh, supports=None, effects=effects, degree=2, material=material, contacts=contacts, **parts)
    return fr.assemble(parse_scene(held + text)), volume, share


INNER, C10, C01 = 0.01, 4.5e4, 4.5e3  # m, Pa


STRETCHES = np.linspace(1.05, 3.0, 14)  # of the inner radius


def largest_pressures(share):
    """p = ∫ W'(λ)/(λ³ - 1) dλ from the outer to the inner stretch of an incompressible sphere; largest at 1.53."""

    def slope(λ):
        return (C10 * (4 * λ - 4 * λ**-5) + C01 * (4 * λ**3 - 4 * λ**-3)) / (λ**3 - 1)

    outer = np.cbrt(1 + (STRETCHES**3 - 1) / share**3)
    return np.array([quad(slope, *ends, epsabs=0, epsrel=1e-10)[0] for ends in zip(outer, STRETCHES, strict=True)])


def blown_in(control, volume, pressures):
    """What a chamber is to be larger by, or gas, m³."""
    return volume * (STRETCHES**3 * (1 + pressures / ATMOSPHERE if control == "gas" else 1.0) - 1)


@pytest.mark.parametrize("control", ["gas", "volume"])
def test_a_balloon_is_blown_up_beyond_its_limit_point(tmp_path, control):
    system, volume, share = balloon(tmp_path, control)
    body, expected = FullOrderSimulator(system, 1.0, system.scene.environment), largest_pressures(share)
    for λ, pressure, given in zip(STRETCHES, expected, blown_in(control, volume, expected), strict=True):
        body.step(np.array([0.0, 0.0, 0.0, given]))
        assert body.reactions["air"] == pytest.approx(pressure, rel=2e-3)
        inner = system.body.nodes[:, 0] < INNER * 1.001
        places = (system.body.nodes + body.displacement())[inner]
        np.testing.assert_allclose(np.linalg.norm(places, axis=1), INNER * λ, rtol=1e-3)
    assert np.argmax(expected) == 3
    assert body.stepper.negative_pivots == 0


def blown_up(volume):
    """A load history to the last of the stretches, and next to nothing that pushes from outside."""
    reached = STRETCHES[1::3]
    steps = [
        f'{{ actuator = "air", force = [{volume * (λ**3 - 1)}], start = {k}.0, stop = {k + 1}.0 }}'
        for k, λ in enumerate(reached)
    ]
    steps.append('{ contact = "right", force = [1e-6, 0.0, 0.0] }')
    return f"dt = 1.0\nduration = {len(reached)}.0\nload = [{', '.join(steps)}]"


def test_a_reduced_balloon_goes_beyond_its_limit_point(tmp_path):
    """Trained by volumes, as no pressure leads there; by volumes, by gas and, up to there, by pressures."""
    trained, volume, share = balloon(tmp_path, "volume", run=blown_up)
    rom, expected = fr.reduce(trained, order=6, method="trained"), largest_pressures(share)
    for control in ("volume", "gas"):
        system, *_ = balloon(tmp_path, control)
        full = FullOrderSimulator(system, 1.0, system.scene.environment)
        body = fr.Simulator(rom, 1.0, scene=system.scene)
        found = []
        for given in blown_in(control, volume, expected):
            for each in (full, body):
                each.step(np.array([0.0, 0.0, 0.0, given]))
            found.append([each.reactions["air"] for each in (body, full)])
        reduced, whole = np.array(found).T
        np.testing.assert_allclose(reduced, whole, rtol=1e-3)
        np.testing.assert_allclose(reduced, expected, rtol=2e-3)
        assert np.argmax(reduced) == 3
        assert not body.warnings
    system, *_ = balloon(tmp_path, "pressure")
    body = fr.Simulator(rom, 1.0, scene=system.scene)
    for λ, pressure in ((STRETCHES[1], expected[1]), (STRETCHES[2], expected[2])):
        body.step(air=pressure)
        inner = system.body.nodes[:, 0] < INNER * 1.001
        places = (system.body.nodes + body.displacement())[inner]
        np.testing.assert_allclose(np.linalg.norm(places, axis=1), INNER * λ, rtol=3e-3)
