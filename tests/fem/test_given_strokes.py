"""Tendons of given length and chambers of given volume: closed forms, slack, the account."""

import copy
import pickle
import warnings

import gmsh
import numpy as np
import pytest
from bodies import acted_on, box_arrays, dense, scene_text, write_arrays

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning, SceneError, StepError
from fenics_rom.fem.simulator import FullOrderSimulator
from fenics_rom.scene.file import parse_scene

YOUNG, LENGTHS = 1e6, (1.0, 0.1, 0.2)
AREA = LENGTHS[1] * LENGTHS[2]
BAR = {
    "material": f"young = {YOUNG}\npoisson = 0.0\ndensity = 1000.0",
    "contacts": '[contacts.right]\nsurface = "right"',
    "outputs.right": 'surface = "right"',
}
MOVING = "inertia = {}\ndamping = { alpha = 1.0, beta = 1e-3 }\n"
ROPE = '[effects.tendon.rope]\npoints = [[0.0, 0.0, 0.0], [0.5, 0.1, 0.05], [1.0, 0.0, 0.0]]\ncontrol = "length"\n'
AIR = '[effects.pressure.air]\nsurface = "right"\ncontrol = "volume"\n'
FLOOR = '[effects.contact.obstacles.floor]\nshape = "half-space"\npoint = [0, 0, -0.0002]\nnormal = [0, 0, 1]\n'
FRICTION = "[effects.friction]\ncoefficient = 0.4\n"
BOTH = pytest.mark.parametrize("model", ["full", "reduced"])


@pytest.fixture(scope="module")
def bar(tmp_path_factory):
    return write_arrays(tmp_path_factory.mktemp("bar") / "bar.msh", *box_arrays(LENGTHS, (2, 1, 2)))


@pytest.fixture(scope="module")
def models(bar):
    """Of effects, the system and a ROM that has all that is there."""
    made = {}

    def of(effects):
        if effects not in made:
            system = fr.assemble(acted_on(bar, effects, **BAR))
            choices = {"order": system.size} if "inertia" in effects else {}
            choices |= {} if "damping" in effects or not choices else {"method": "modal"}
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", FenicsRomWarning)
                made[effects] = system, fr.reduce(system, **choices)
        return made[effects]

    return of


def body_of(models, effects, model, h):
    system, rom = models(effects)
    return FullOrderSimulator(system, h, system.scene.environment) if model == "full" else fr.Simulator(rom, h)


def take(body, strokes):
    """A step to strokes, at full order with nothing at the contact mode where that is an input."""
    follows = not isinstance(body, FullOrderSimulator) or body.environment.environment.switches_itself
    body.step(np.array([*([] if follows else [0.0] * 3), *strokes]))


def strokes_of(models, effects, body):
    """Bᵀ x of all actuators."""
    system, _ = models(effects)
    x = body.displacement().ravel()[system.body.free]
    return x @ np.hstack([system.units[name] * column for name, column in system.actuators.items()])


@BOTH
def test_six_cables_along_a_bar_pull_as_its_stiffness_says(bar, model):
    """Σ T = E A s/L, and the bar shortens evenly by s."""
    lines = [(y, z) for y in (0.0, 0.1) for z in (0.0, 0.1, 0.2)]
    cables = "".join(
        f'[effects.tendon.t{k}]\npoints = [[0.0, {y}, {z}], [1.0, {y}, {z}]]\ncontrol = "length"\n'
        for k, (y, z) in enumerate(lines)
    )
    loads = ", ".join(f'{{ actuator = "t{k}", force = [2e-3] }}' for k in range(6))
    system = fr.assemble(acted_on(bar, cables, run=f"dt = 0.1\nduration = 0.1\nload = [{loads}]", **BAR))
    run = fr.simulate(system if model == "full" else fr.reduce(system))
    assert sum(tension[-1] for tension in run.reactions.values()) == pytest.approx(YOUNG * AREA * 2e-3, rel=1e-11)
    np.testing.assert_allclose(run.outputs["right"][-1, 0], [-2e-3, 0, 0], atol=1e-13)
    assert run.balance_error <= 1e-13


@BOTH
def test_chamber_at_the_end_of_a_bar_has_the_pressure_of_its_volume(bar, model):
    """p = E V/(A L), of either sign."""
    signal = 'load = [{ actuator = "air", force = [2e-5] }, { actuator = "air", force = [-6e-5], start = 0.1 }]'
    system = fr.assemble(acted_on(bar, AIR, degree=2, run=f"dt = 0.1\nduration = 0.2\n{signal}", **BAR))
    run = fr.simulate(system if model == "full" else fr.reduce(system))
    np.testing.assert_allclose(run.reactions["air"], YOUNG / AREA * np.array([0.0, 2e-5, -4e-5]), rtol=1e-10)
    np.testing.assert_allclose(run.outputs["right"][:, 0, 0] * AREA, [0.0, -2e-5, 4e-5], rtol=1e-10)
    assert run.balance_error <= 1e-13


def test_a_stroke_asks_for_the_force_that_gives_it(models, bar):
    """What the tension that is found does as an input: the same shape, so the same stroke."""
    system, rom = models(ROPE + AIR)
    by_stroke = fr.Simulator(rom, 1.0)
    by_stroke.step([1e-6, 3e-4])
    assert list(by_stroke.reactions) == list(system.actuators)
    by_force = fr.Simulator(rom, 1.0, scene=acted_on(bar, (ROPE + AIR).replace("control", "# control"), **BAR))
    by_force.step(list(by_stroke.reactions.values()))
    assert by_force.reactions == {}
    np.testing.assert_allclose(by_force.displacement(), by_stroke.displacement(), atol=1e-14)
    np.testing.assert_allclose(strokes_of(models, ROPE + AIR, by_stroke), [1e-6, 3e-4], rtol=1e-10)


@BOTH
@pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
@pytest.mark.parametrize("effects", [MOVING + ROPE, MOVING + ROPE + AIR + FLOOR + FRICTION], ids=["alone", "touching"])
@pytest.mark.parametrize("h", [1e-6, 1e-4, 1e-2, 1e-1])
def test_account_closes_whatever_the_strokes_do(models, effects, h, model):
    """Smooth, then with jumps; taut and slack; what is supplied is force times change of stroke."""
    # In 1e-6 s no stroke of a millimetre is small: how far it leads is no matter of the account.
    body, rng = body_of(models, effects, model, h), np.random.default_rng(0)
    count = len(models(effects)[0].actuators)
    scale, work, tensions, before = 0.0, 0.0, [], np.zeros(count)
    for step in range(40):
        strokes = np.array([4e-3, 1e-6][:count][::-1]) * np.sin(step / 5) * (1 if step < 25 else rng.random())
        take(body, strokes)
        reactions, after = np.array(list(body.reactions.values())), strokes_of(models, effects, body)
        work += reactions @ (after - before)
        before, ledger = after, body.ledger
        scale = max(scale, body.energy, abs(ledger.supplied), ledger.dissipated)
        assert abs(body.energy - ledger.supplied + ledger.dissipated + ledger.numerical) <= 1e-12 * scale
        assert abs(ledger.supplied - work) <= 1e-8 * scale  # of strokes that are differences of positions
        tensions.append(body.reactions["rope"])
    assert min(tensions) == 0.0 < max(tensions)


@BOTH
def test_a_cable_is_slack_where_it_is_shorter_than_it_has_to_be(models, model):
    """Pushed shorter than given it is slack, and holds what would make it longer."""
    body = body_of(models, ROPE, model, 1.0)
    take(body, [-1e-3])
    assert body.reactions == {"rope": 0.0}
    assert body.energy == 0.0
    take(body, [1e-3])
    assert body.reactions["rope"] > 0


@BOTH
def test_strokes_are_followed_to_second_order_and_without_ringing(models, model):
    """A smooth stroke; then one that stops within a step: an error falls to a third in two steps."""
    effects = MOVING + ROPE
    gaps = []
    for h in (8e-3, 4e-3):
        body = body_of(models, effects, model, h)
        for step in range(1, round(0.2 / h) + 1):
            take(body, [2.5e-3 * (1 - np.cos(10 * step * h))])
        gaps.append(abs(strokes_of(models, effects, body)[0] - 2.5e-3 * (1 - np.cos(2))))
    assert gaps[0] / gaps[1] >= 3.5
    body, h = body_of(models, effects, model, 1e-3), 1e-3
    for step in range(1, 41):
        take(body, [1e-2 * h * step])
    assert strokes_of(models, effects, body)[0] == pytest.approx(1e-2 * h * 40, rel=1e-10)
    missed = []
    for _ in range(24):
        take(body, [1e-2 * h * 40])
        missed.append(abs(strokes_of(models, effects, body)[0] - 1e-2 * h * 40))
    assert missed[12] <= 1.01 * missed[0] / 3**6
    assert missed[-1] <= 1e-12


def test_reduced_and_full_order_agree_among_obstacles(models):
    effects = MOVING + ROPE + AIR + FLOOR + FRICTION
    bodies = [body_of(models, effects, model, 2e-3) for model in ("full", "reduced")]
    touched = 0
    for step in range(60):
        for body in bodies:
            take(body, [1e-6 * np.sin(step / 9), 5e-3 * np.sin(step / 8)])
        touched += bodies[0].obstacle_forces().any()
    assert touched > 5
    one, other = (body.displacement() for body in bodies)
    assert np.abs(one - other).max() <= 1e-8 * np.abs(one).max()
    for name, force in bodies[0].reactions.items():
        assert bodies[1].reactions[name] == pytest.approx(force, rel=1e-6, abs=1e-6)


def test_saved_states_and_copies_go_on_to_the_bit(models):
    body = body_of(models, MOVING + ROPE + AIR, "reduced", 1e-3)
    for step in range(10):
        body.step([1e-7 * step, 1e-4 * step])
    saved, reactions = body.save(), body.reactions
    body.step([1e-6, 2e-3])
    after = body.displacement(), body.reactions
    body.restore(saved)
    assert body.reactions == reactions
    body.step([1e-6, 2e-3])
    np.testing.assert_array_equal(body.displacement(), after[0])
    assert body.reactions == after[1]
    for again in (copy.deepcopy(body), pickle.loads(pickle.dumps(body))):
        assert again.reactions == body.reactions
    body.reset()
    assert set(body.reactions.values()) == {0.0}


def test_strokes_that_depend_on_one_another_are_refused(bar):
    twice = ROPE + ROPE.replace("rope", "twin")
    rom = fr.reduce(fr.assemble(acted_on(bar, twice, **BAR)))
    with pytest.raises(StepError, match="strokes of rope, twin: they depend on one another"):
        fr.Simulator(rom, 0.1).step([1e-3, 2e-3])


def test_runs_and_roms_keep_what_is_given_and_found(models, bar, tmp_path):
    loads = '{ actuator = "rope", force = [1e-3] }, { actuator = "air", force = [1e-6] }'
    run = f"dt = 1e-3\nduration = 0.02\nload = [{loads}]"
    scene = acted_on(bar, MOVING + ROPE + AIR, run=run, **BAR)
    rom = fr.reduce(fr.assemble(scene), order=8)
    fr.write_rom(tmp_path / "bar.h5", rom)
    again = fr.read_rom(tmp_path / "bar.h5")
    assert again.environment == rom.environment
    assert dict(again.environment.controls) == {"air": "volume", "rope": "length"}
    assert "air in m3, rope in m" in repr(again)
    found = fr.simulate(again)
    assert list(found.reactions) == ["air", "rope"]
    assert found.reactions["rope"].shape == found.times.shape
    fr.write_trajectory(tmp_path / "run.h5", found)
    for name, force in fr.read_trajectory(tmp_path / "run.h5").reactions.items():
        np.testing.assert_array_equal(force, found.reactions[name])
    with pytest.raises(SceneError, match=r"effects.tendon.rope.control"):
        acted_on(bar, ROPE.replace('"length"', '"volume"'), **BAR)


def test_tables_of_strokes_have_units_of_their_own(bar, tmp_path):
    (tmp_path / "pull.csv").write_text("time (ms),length (mm)\n0,0\n10,2\n")
    (tmp_path / "x.csv").write_text("time (ms), x (mm)\n0, 0\n10, 2\n")
    (tmp_path / "pump.csv").write_text("time (s),volume (ml)\n0,0\n0.01,3\n")
    (tmp_path / "force.csv").write_text("time (s),tension (N)\n0,0\n0.01,3\n")
    for table, allowed in (("pull.csv", True), ("x.csv", True), ("force.csv", False)):
        loads = f'{{ actuator = "rope", table = "{table}" }}, {{ actuator = "air", table = "pump.csv" }}'
        text = scene_text(bar, effects=ROPE + AIR, run=f"dt = 1e-3\nduration = 0.01\nload = [{loads}]", **BAR)
        if allowed:
            rope, air = (load.signal(0.005)[0] for load in parse_scene(text, folder=tmp_path).run.loads)
            assert (rope, air) == (pytest.approx(1e-3), pytest.approx(1.5e-6))
        else:
            with pytest.raises(SceneError, match=r"unit 'N'; use a name and one of \(m\)"):
                parse_scene(text, folder=tmp_path)


def test_sphere_with_a_chamber_has_lames_pressure(tmp_path):
    """p = E V (b³ - a³)/(4π a⁶ ((1 - 2ν) + (1 + ν) b³/(2 a³))) of a free sphere that has come to rest.

    a and b are those of round surfaces around as much as the flat triangles are around.
    """
    ν, V = 0.3, 1e-3
    gmsh.initialize([], readConfigFiles=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.3)
        occ = gmsh.model.occ
        occ.cut([(3, occ.addSphere(0, 0, 0, 1.0))], [(3, occ.addSphere(0, 0, 0, 0.5))])
        occ.synchronize()
        for _, tag in gmsh.model.getEntities(2):
            xmin = gmsh.model.getBoundingBox(2, tag)[0]
            gmsh.model.setPhysicalName(2, gmsh.model.addPhysicalGroup(2, [tag]), "outside" if xmin < -0.9 else "inside")
        gmsh.model.setPhysicalName(3, gmsh.model.addPhysicalGroup(3, [1]), "body")
        gmsh.model.mesh.generate(3)
        gmsh.write(str(tmp_path / "sphere.msh"))
    finally:
        gmsh.finalize()
    scene = acted_on(
        tmp_path / "sphere.msh",
        "inertia = {}\ndamping = { alpha = 20.0, beta = 0.05 }\n" + AIR.replace("right", "inside"),
        degree=2,
        supports=None,
        contacts='[contacts.outside]\nsurface = "outside"',
    )
    system = fr.assemble(scene)
    body = fr.Simulator(fr.reduce(system, order=12), 0.05)
    for _ in range(200):
        body.step([V])
    pushed = np.zeros(system.body.nodes.size)
    pushed[system.body.free] = system.input_matrix("outside")[:, -1]
    chamber = pushed @ system.body.nodes.ravel() / 3
    a, b = np.cbrt(3 / (4 * np.pi) * np.array([chamber, chamber + system.body.node_mass.sum() / 1000]))
    lame = YOUNG * V * (b**3 - a**3) / (4 * np.pi * a**6 * ((1 - 2 * ν) + (1 + ν) * b**3 / (2 * a**3)))
    assert body.reactions["air"] == pytest.approx(lame, rel=0.03)


# --- friction of tendons at their guides -----------------------------------------------------------------------------

MU = 0.3
GUIDED = [[0.0, 0.05, 0.0], [0.25, 0.05, 0.15], [0.5, 0.05, 0.0], [0.75, 0.05, 0.15], [1.0, 0.05, 0.0]]
WORM = f"[effects.tendon.rope]\npoints = {GUIDED}\n"
RUBS = f"[effects.tendon_friction]\ncoefficient = {MU}\n"


def pieces(system):
    """Columns (n, 4) of 1 N in each piece of the cable."""
    columns = [system.actuators["rope"], *(system.loads[f"rope-guide-{k}"] for k in (3, 2, 1))]
    return -np.diff(np.hstack([*columns, 0 * columns[0]]), axis=1)[:, ::-1]


def turning():
    """By how much it turns at each guide, rad."""
    e = np.diff(GUIDED, axis=0)
    e /= np.linalg.norm(e, axis=1)[:, None]
    return np.arccos((e[1:] * e[:-1]).sum(axis=1))


@BOTH
@pytest.mark.parametrize("control", ["tension", "length"])
def test_tension_falls_at_each_guide_as_the_capstan_says(models, model, control):
    """Pulled from rest by T the pieces have T exp(-μ Σα) each, counted from where it is pulled; let go, they stick."""
    effects = RUBS + WORM + f'control = "{control}"\n'
    system, _ = models(effects)
    body = body_of(models, effects, model, 1.0)
    take(body, [30.0 if control == "tension" else 1e-3])
    T = body.reactions["rope"] if control == "length" else 30.0
    tensions = T * np.exp(-MU * np.cumsum([0.0, *turning()[::-1]]))[::-1]
    expected = np.linalg.solve(dense(system.stiffness, system.size), pieces(system) @ tensions)
    x = body.displacement().ravel()[system.body.free]
    assert np.abs(x - expected).max() <= 1e-10 * np.abs(expected).max()
    if control == "length":
        assert system.actuators["rope"][:, 0] @ x == pytest.approx(1e-3, rel=1e-10)
    else:
        take(body, [29.9])  # less than it needs to slide back: where it is pulled it sticks, behind that it gives way
        moved = body.displacement().ravel()[system.body.free] - x
        slid = np.array([system.loads[f"rope-guide-{k}"][:, 0] @ moved for k in (1, 2, 3)])
        assert slid.min() >= -1e-8 * np.abs(x).max()
        assert abs(slid[2]) <= 1e-8 * np.abs(x).max()
        take(body, [0.0])
        assert np.abs(body.displacement()).max() <= 1e-12 * np.abs(x).max()


@BOTH
@pytest.mark.parametrize("moves", [True, False], ids=["moving", "resting"])
def test_what_sticks_at_a_guide_stops_there(models, model, moves):
    """Its rate is zero at the end of the step, or in its middle where stopping it took a force that does work."""
    effects, h = "inertia = {}\n" * moves + RUBS + WORM, 1e-3
    system, _ = models(effects)
    body, guides = body_of(models, effects, model, h), np.hstack([system.loads[f"rope-guide-{k}"] for k in (3, 2, 1)])
    at, rates, fastest, stopped = np.zeros(3), np.zeros(3), 0.0, 0
    for step in range(1, 61):
        T = 20.0 * (1 - np.cos(step / 4)) if step < 40 else 5.0
        take(body, [T])
        z = (body.stepper if model == "full" else body.save().stepper).reactions[::-1]
        before, at = at, guides.T @ body.displacement().ravel()[system.body.free]
        mean, started, rates = (at - before) / h, rates, guides.T @ body.velocity().ravel()[system.body.free]
        fastest = max(fastest, np.abs(mean).max())
        tensions, bends = T + np.cumsum([0.0, *z])[:-1], MU * turning()[::-1]
        inside = (z > (np.expm1(-bends) + 1e-6) * tensions) & (z < (np.expm1(bends) - 1e-6) * tensions)
        missed = np.minimum(np.abs(mean), np.abs(mean - started / 2)) if moves else np.abs(mean)
        assert missed[inside].max(initial=0.0) <= 1e-7 * fastest
        stopped += np.count_nonzero(inside & (np.abs(started) > 1e-3 * fastest) & (np.abs(rates) <= 1e-6 * fastest))
    assert stopped > 3 or not moves


@BOTH
@pytest.mark.parametrize("control", ["tension", "length"])
@pytest.mark.parametrize("h", [1e-5, 1e-3, 1e-1, 1.0])
def test_guides_only_take_energy(models, model, control, h):
    """Pulled and let go, of a body without damping: what is dissipated is the guides', and never given back.

    In the longest step without inertia.
    """
    effects = ("inertia = {}\n" if h < 1 else "") + RUBS + WORM + f'control = "{control}"\n'
    body, scale, dissipated = body_of(models, effects, model, h), 0.0, [0.0]
    for step in range(60):
        pulled = 1 - np.cos(step / 4) if step < 40 else 0.5
        take(body, [20.0 * pulled if control == "tension" else 2e-4 * min(1.0, h * 1e3) * pulled])
        ledger = body.ledger
        scale = max(scale, body.energy, abs(ledger.supplied), ledger.dissipated)
        assert abs(body.energy - ledger.supplied + ledger.dissipated + ledger.numerical) <= 1e-12 * scale
        dissipated.append(ledger.dissipated)
    assert np.diff(dissipated).min() >= -1e-13 * scale
    assert dissipated[-1] > 0.01 * scale


@pytest.mark.parametrize("guides", [0, 13])
def test_bodies_rub_beside_obstacles_alike_at_any_order(models, guides):
    rope = ROPE
    if guides:  # along the body, zigzag: as many guides as all but tie one another
        points = [[x, 0.05, 0.03 + 0.01 * (-1) ** i] for i, x in enumerate(np.linspace(0, 1, guides + 2).tolist())]
        rope = ROPE.replace(ROPE[ROPE.index("[[") : ROPE.index("]]") + 2], str(points))
    effects = MOVING + RUBS + rope + AIR + FLOOR + FRICTION
    bodies = [body_of(models, effects, model, 2e-3) for model in ("full", "reduced")]
    touched = 0
    for step in range(60):
        for body in bodies:
            take(body, [1e-6 * np.sin(step / 9), 5e-3 * np.sin(step / 8)])
            assert abs(body.energy - body.ledger.supplied + body.ledger.dissipated) <= 1e-11 * body.ledger.dissipated
        touched += bodies[0].obstacle_forces().any()
    assert touched > 5
    one, other = (body.displacement() for body in bodies)
    assert np.abs(one - other).max() <= 1e-7 * np.abs(one).max()


def test_friction_of_tendons_belongs_to_the_run(models, bar, tmp_path):
    """A ROM keeps it; another coefficient, or none, needs no other ROM; without the effect it has no columns."""
    effects = "inertia = {}\n" + RUBS + WORM
    system, rom = models(effects)
    fr.write_rom(tmp_path / "worm.h5", rom)
    assert fr.read_rom(tmp_path / "worm.h5").environment == rom.environment
    guides = rom.environment.guides.values()
    np.testing.assert_allclose([guide.angle for guide in guides], turning(), rtol=1e-12)
    assert {guide.friction for guide in guides} == {MU}
    plain = models("inertia = {}\n" + WORM)
    assert plain[0].loads == {} == dict(plain[1].environment.guides)
    np.testing.assert_array_equal(plain[0].actuators["rope"], system.actuators["rope"])
    shapes = []
    for given in (None, effects.replace("0.3", "1e-9"), "inertia = {}\n" + WORM):
        body = fr.Simulator(rom, 1e-3, scene=None if given is None else acted_on(bar, given, **BAR))
        for _ in range(20):
            body.step([10.0])
        shapes.append(body.displacement())
    apart = [np.abs(shape - shapes[2]).max() / np.abs(shapes[2]).max() for shape in shapes]
    assert apart[0] > 0.1
    assert apart[1] < 1e-6
    with pytest.raises(SceneError, match="tendon_friction: means nothing without tendon"):
        acted_on(bar, RUBS, **BAR)
