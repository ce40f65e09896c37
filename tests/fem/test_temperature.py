"""Bodies that are hot: closed forms, full order beside reduced, and what of temperatures is refused."""

import numpy as np
import pytest
from bodies import box_arrays, scene_text, write_arrays

import fenics_rom as fr
from fenics_rom.errors import FenicsRomError
from fenics_rom.fem.simulator import FullOrderSimulator
from fenics_rom.identification.experiment import make_experiment
from fenics_rom.scene.file import parse_scene

LENGTHS = (0.3, 0.04, 0.03)
YOUNG, EXPANSION = 1e6, 1e-4
MATERIAL = f"young = {YOUNG}\npoisson = 0.3\ndensity = 1000.0\nexpansion = {EXPANSION}"
FIBRES = "\nfibres = { directions = [[1, 1, 0]], modulus = 1e6 }"
HEAT = '[effects.temperature.heat]\nfield = "{}"\n'
MOVING = "inertia = {}\ndamping = { alpha = 1.0, beta = 1e-3 }\n"
POINT = [0.1, 0.02, 0.01]
READ = {
    "readings.point": f'quantity = "stress"\npoints = [{POINT}]',
    "readings.skin": 'quantity = "surface_stress"',
    "readings.energy": 'quantity = "energy_density"',
    "readings.strain": 'quantity = "strain"',
}
STRESSES = ("point", "skin")
MODELS = pytest.mark.parametrize("model", ["full", "reduced"])


def held(*sides):
    """Supports that slide on planes."""
    normals = {"left": [1, 0, 0], "right": [1, 0, 0], "front": [0, 1, 0], "bottom": [0, 0, 1]}
    return "\n".join(f'[[supports.held]]\nsurface = "{side}"\nnormal = {normals[side]}' for side in sides)


FREE = held("left", "front", "bottom")


@pytest.fixture(scope="module")
def bar(tmp_path_factory):
    mesh = box_arrays(LENGTHS, (4, 2, 2), shake=0.2)
    regions = {"body": np.arange(len(mesh[1])), "one": np.arange(0, len(mesh[1]), 2)}
    return write_arrays(tmp_path_factory.mktemp("bar") / "bar.msh", *mesh, regions=regions)


def scene_of(bar, effects, supports, frame="fixed", tables=None, **parts):
    parts = {"material": MATERIAL, "contacts": '[contacts.top]\nsurface = "top"'} | parts
    text = scene_text(bar, effects=effects, supports=None, **parts)
    return parse_scene('frame = "moving"\n' * (frame == "moving") + text + "\n" + supports, tables=tables)


def body_of(scene, model, tmp_path, h=1.0, **signals):
    system = fr.assemble(scene)
    if model == "full":
        return FullOrderSimulator(system, h, scene.environment, signals)
    fr.write_rom(tmp_path / "rom.h5", fr.reduce(system, order=4, method="static"))
    return fr.Simulator(fr.read_rom(tmp_path / "rom.h5"), h, signals=signals)


def step(body):
    reduced = isinstance(body, fr.Simulator)
    body.step(np.zeros(body.inputs if reduced else body.stepper.input_matrix.shape[1] - len(body.environment.loads)))


@MODELS
@pytest.mark.parametrize("material", [MATERIAL, MATERIAL + FIBRES], ids=["plain", "fibres"])
def test_a_body_that_may_expand_has_no_stress(bar, model, material, tmp_path):
    """An even temperature makes it larger by α T; one that is linear along x bends it; neither stresses it."""
    for degree, field, supports in ((1, "20", FREE), (2, "20 + 100 * x", f"[supports]\n{PINS}")):
        effects = HEAT.format(field) + "amplitude = 2.0\n"
        scene = scene_of(bar, effects, supports, degree=degree, material=material, **READ)
        body = body_of(scene, model, tmp_path)
        step(body)
        scale = YOUNG * EXPANSION * 40
        for name in STRESSES:
            assert np.abs(body.reading(name)).max() <= 1e-7 * scale
        assert np.abs(body.reading("energy")).max() <= 1e-12 * scale * EXPANSION * 40
        strain = body.reading("strain")
        assert np.abs(strain[:, 3:]).max() <= 1e-9 * EXPANSION * 40
        np.testing.assert_allclose(strain[:, :3].min(), 40 * EXPANSION, rtol=1e-7 if degree == 1 else 0.5)


# Three corners hold a body as it likes to be: a point, a line and a plane.
PINS = """held = [
    { point = [0, 0, 0] }, { point = [0.3, 0, 0], normal = [0, 1, 0] }, { point = [0.3, 0, 0], normal = [0, 0, 1] },
    { point = [0, 0.04, 0], normal = [0, 0, 1] },
]"""


@MODELS
def test_walls_hold_a_hot_bar_back(bar, model, tmp_path):
    """σ = -E α T between them, which they press with; of several temperatures together, at any amplitude."""
    effects = HEAT.format("10 + where(x < 1, 5, 0)")
    effects += '[effects.temperature.more]\nfield = "10"\ncells = "body"\namplitude = 0.5\n'
    readings = READ | {"readings.walls": 'quantity = "reaction"\nsurface = "right"'}
    body = body_of(scene_of(bar, effects, f"{FREE}\n{held('right')}", **readings), model, tmp_path, heat=2.0)
    step(body)
    σ = -YOUNG * EXPANSION * 35
    np.testing.assert_allclose(body.reading("point")[0, :6], [σ, 0, 0, 0, 0, 0], atol=1e-9 * abs(σ))
    assert np.abs(body.reading("skin") - [σ, 0, 0, 0, 0, 0]).max() <= 1e-9 * abs(σ)
    np.testing.assert_allclose(body.reading("energy"), σ**2 / YOUNG / 2, rtol=1e-9)
    assert body.reading("walls")[0] == pytest.approx(σ * LENGTHS[1] * LENGTHS[2], rel=1e-9)


def test_what_is_hot_in_a_part_alone_is_stressed_there(bar):
    """Cells of a group against those around; nothing holds their whole, so forces on it add up to nothing."""
    scene = scene_of(bar, HEAT.format("20") + 'cells = "one"\namplitude = 1.0\n', FREE, **READ)
    system = fr.assemble(scene)
    assert np.abs(system.algebra.inner(np.ones((system.size, 1)), system.loads["heat"])).max() > 0
    body = FullOrderSimulator(system, 1.0, scene.environment)
    step(body)
    assert np.abs(body.reading("skin")).max() > 0.1 * YOUNG * EXPANSION * 20


@pytest.mark.parametrize("frame", ["fixed", "moving"])
def test_a_body_heats_up_reduced_as_at_full_order(bar, frame, tmp_path):
    """By a table over time, in steps, a rollout and a batch; the account closes; stress is that of its time."""
    table = {"warm.csv": np.array([[0.0, 0.0], [0.05, 1.0], [0.1, -0.5]])}
    effects = MOVING + HEAT.format("100 * z / 0.03") + 'table = "warm.csv"\n'
    tip = {"outputs.tip": "points = [[0.3, 0.02, 0.03]]", "run": "dt = 2e-3\nduration = 0.1"}
    scene = scene_of(bar, effects, '[supports]\nclamped = ["left"]', frame, table, **tip, **READ)
    system = fr.assemble(scene)
    rom = fr.reduce(system, order=10, method="modal+static")
    fr.write_rom(tmp_path / "rom.h5", rom)
    full, reduced = fr.simulate(system), fr.simulate(fr.read_rom(tmp_path / "rom.h5"))
    for one in (full, reduced):
        assert one.balance_error <= 1e-11
    np.testing.assert_allclose(full.inputs["heat"].values, reduced.inputs["heat"].values, atol=1e-12)
    assert full.inputs["heat"].unit == "1"
    assert np.abs(reduced.outputs["tip"] - full.outputs["tip"]).max() <= 3e-3 * np.abs(full.outputs["tip"]).max()
    a, b = (each.readings["point"].values[:, :, :6] for each in (full, reduced))
    assert np.abs(a - b).max() <= 0.15 * YOUNG * EXPANSION * 100
    stepped, rolled, batch = fr.Simulator(rom, 2e-3), fr.Simulator(rom, 2e-3), fr.Batch(rom, 2, 2e-3)
    for _ in range(20):
        step(stepped)
        batch.step(np.zeros((2, stepped.inputs)))
    rolled.rollout(np.zeros((20, stepped.inputs)))
    for name in (*STRESSES, "strain"):
        there = stepped.reading(name)
        for other in (rolled.reading(name), *batch.reading(name)):
            assert np.abs(other - there).max() <= 1e-9 * np.abs(there).max()
    if frame == "fixed":
        with pytest.raises(fr.errors.StepError, match="stress is of temperatures, too, which are inputs"):
            rom.state_space("top", ["skin"])
        assert "heat" in rom.state_space("top", ["strain"]).inputs


def test_a_free_body_expands_about_its_centre(bar):
    effects = "inertia = {}\ndamping = { beta = 1e-2 }\n" + HEAT.format("50") + "amplitude = 1.0\n"
    scene = scene_of(bar, effects, "", "moving")
    system = fr.assemble(scene)
    rom = fr.reduce(system, order=12, method="modal+static")
    for body in (FullOrderSimulator(system, 0.05, scene.environment), fr.Simulator(rom, 0.05)):
        for _ in range(80):
            step(body)
        x = body.displacement()
        expected = EXPANSION * 50 * (system.body.nodes - np.array(LENGTHS) / 2)
        assert np.abs(x - expected).max() <= 2e-3 * np.abs(expected).max()


MISTAKES = {
    "temperature.heat = { field = 'x +' }": r"effects.temperature.heat.field = 'x \+': invalid syntax",
    "temperature.heat = { field = 'open(x)' }": r"'open\(x\)' is no part of it; use a text of",
    "temperature.heat = { field = 'x.real' }": r"'x.real' is no part of it",
    "temperature.heat = { field = 'sqrt(x, y)' }": r"sqrt takes 1 argument \(got 2\)",
    "temperature.heat = { field = 20.0 }": r"field = 20.0: use a text of numbers, x, y, z",
    "temperature.heat = { field = '1 / x', amplitude = 1.0 }": None,
    "temperature.heat = { field = 'log(x - 1)', amplitude = 1.0 }": r"field = 'log\(x - 1\)': is no number at \[",
    "temperature.heat = { field = '0 * x', amplitude = 1.0 }": r"temperature.heat: strains nothing: its field is 0",
    "temperature.heat = { field = '1', cells = 'two' }": r"no cell group 'two'|'two'",
    "temperature.heat = { field = '1', amplitude = 1.0 }\nlarge_deformation = {}": r"effects.large_deformation strains",
    f"{MOVING}temperature.heat = {{ field = '1' }}\nviscoelasticity = {{ ratios = [1.0], times = [1.0] }}": (
        r"with effects.viscoelasticity branches would resist expansion"
    ),
    "inertia = {}": r"material.expansion: has no effect; use another than 0, with effects.temperature",
}


@pytest.mark.parametrize(("effects", "said"), MISTAKES.items(), ids=range(len(MISTAKES)))
def test_temperatures_that_cannot_be_are_told(bar, effects, said):
    if said is None:
        fr.assemble(scene_of(bar, effects, FREE))
        return
    with pytest.raises(FenicsRomError, match=said):
        fr.assemble(scene_of(bar, effects, FREE))


def test_parameters_that_heat_depends_on_are_not_differentiated_or_fitted(bar):
    scene = scene_of(bar, MOVING + HEAT.format("1") + "amplitude = 1.0\n", FREE, run="dt = 0.1\nduration = 0.2")
    with pytest.raises(FenicsRomError, match=r"effects.temperature: what it does grows with the stiffness; use"):
        fr.differentiate_scene(scene, lambda outputs, energies: (0.0, {}, None))
    with pytest.raises(
        FenicsRomError, match=r"effects.temperature: what it does grows with the stiffness that is sought"
    ):
        make_experiment(scene, [], fr.assemble(scene))


def test_a_temperature_wants_a_material_that_expands_and_a_signal(bar):
    plain = MATERIAL.partition("\nexpansion")[0]
    with pytest.raises(
        FenicsRomError, match=r"effects.temperature.heat: means nothing where no material expands; give"
    ):
        scene_of(bar, HEAT.format("1"), FREE, material=plain)
    with pytest.raises(FenicsRomError, match=r"with mesh.integration = 'selective' it is not computed"):
        scene_of(bar, HEAT.format("1"), FREE, degree=2, integration="selective")
    system = fr.assemble(scene_of(bar, HEAT.format("1"), FREE))
    with pytest.raises(
        FenicsRomError, match=r"'heat' has neither a value nor a table; give a function of time in Python"
    ):
        FullOrderSimulator(system, 1.0, system.scene.environment)
