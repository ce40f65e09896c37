"""Supports that are moved: what they do to a body, what that costs, and which there cannot be."""

import numpy as np
import pytest
from bodies import acted_on, box_arrays, box_surfaces, dense, scene_text, write_arrays
from gradient_checks import check_gradient

import fenics_rom as fr
from fenics_rom.errors import FenicsRomError
from fenics_rom.fem.simulator import FullOrderSimulator
from fenics_rom.scene.file import parse_scene

LENGTHS = (0.3, 0.04, 0.03)
MOVING = "inertia = {}\ndamping = { alpha = 1.0, beta = 1e-3 }\n"
LARGE = 'large_deformation = { material = "neo_hookean" }\n'
JAW = '[effects.driven_support.jaw]\nsurface = "right"\ndirection = [2.0, 0.0, 1.0]\n'
ALONG = np.array([2.0, 0.0, 1.0]) / np.sqrt(5.0)
SLIDES = "sliding = true\n"
BALL = '[effects.contact.obstacles.ball]\nshape = "sphere"\ncenter = [0.15, 0.02, -0.0505]\nradius = 0.05\n'
RUN = "dt = 1e-3\nduration = 0.05\n[[run.load]]\nactuator = 'jaw'\nforce = [4e-3]\n"
PARTS = {"contacts": '[contacts.bottom]\nsurface = "bottom"', "outputs.tip": 'surface = "right"'}
SHORT = 1e-3  # s


@pytest.fixture(scope="module")
def bar(tmp_path_factory):
    mesh = box_arrays(LENGTHS, (4, 2, 2), shake=0.2)
    return write_arrays(tmp_path_factory.mktemp("bar") / "bar.msh", *mesh)


@pytest.fixture(scope="module")
def models(bar):
    """Systems, and reduced models in all their modes, or of order 14 where the body deforms largely."""
    made = {}

    def make(effects):
        if effects not in made:
            large = LARGE in effects
            system = fr.assemble(acted_on(bar, effects, **PARTS, run=RUN if large else None))
            rom = fr.reduce(system, order=14 if large else system.size, method=f"modal{'+derivatives' * large}")
            made[effects] = system, rom
        return made[effects]

    return make


def drive(body, strokes, h=SHORT):
    """What is seen after each stroke: places of nodes, mid-step velocities, forces; and the account, J."""
    seen, (x, v), largest = [], (body.displacement(), 0.0), 0.0
    follows = body.environment is not None and body.environment.environment.switches_itself
    for stroke in strokes:
        body.step(np.array([*([] if follows else [0.0] * 3), stroke]))
        after = body.displacement()
        seen.append((x, (after - x) / h, v, body.reactions["jaw"]))
        x, v = after, 2 * seen[-1][1] - v
        ledger = body.ledger
        left = body.energy - ledger.supplied + ledger.dissipated + ledger.numerical
        largest = max(largest, body.energy, abs(ledger.supplied))
        assert abs(left) <= 1e-11 * largest
    return seen


def shaken(steps):
    return 2e-3 * (1 - np.cos(np.arange(1, steps + 1) / 6))


@pytest.mark.parametrize("slides", ["", SLIDES], ids=["clamp", "plate"])
@pytest.mark.parametrize("model", ["full", "reduced"])
def test_the_force_that_is_found_is_what_the_body_without_the_support_lacks(models, bar, slides, model):
    """Of the body that is not held there: 2/h M (v̂ - v) + D v̂ + K (x + h/2 v̂) is that force, on those nodes alone."""
    system, rom = models(MOVING + JAW + slides)
    h = SHORT
    body = fr.Simulator(rom, h) if model == "reduced" else FullOrderSimulator(system, h, system.scene.environment)
    free = fr.assemble(acted_on(bar, MOVING, **PARTS))
    M, D, K = (dense(A, free.size) for A in (free.mass, free.damping, free.stiffness))
    on, Z = np.isclose(system.body.nodes[:, 0], LENGTHS[0]), free.body.unknowns
    largest, work = 0.0, 0.0
    for x, mid, v, force in drive(body, shaken(60)):
        x, mid, v = (part.ravel()[Z.free] if np.ndim(part) else np.zeros(free.size) for part in (x, mid, v))
        lacks = np.zeros(Z.components)
        lacks[Z.free] = 2 / h * M @ (mid - v) + D @ mid + K @ (x + h / 2 * mid)
        lacks = lacks.reshape(-1, 3)
        largest = max(largest, np.abs(lacks).max())
        assert np.abs(lacks[~on]).max() <= 1e-8 * largest
        assert lacks[on].sum(axis=0) @ ALONG == pytest.approx(force, abs=1e-8 * largest)
        if slides:
            assert np.abs(np.cross(lacks[on], ALONG)).max() <= 1e-8 * largest
        moved = Z.expand(mid).reshape(-1, 3)[on]
        assert np.ptp(moved @ ALONG) <= 1e-11 * np.abs(moved).max()
        assert slides or np.abs(np.cross(moved, ALONG)).max() <= 1e-11 * np.abs(moved).max()
        work += h * force * (moved @ ALONG).mean()
    assert body.ledger.supplied == pytest.approx(work, rel=1e-9)


@pytest.mark.parametrize(
    "effects", [MOVING, LARGE + MOVING, LARGE, ""], ids=["small", "large", "large, rests", "rests"]
)
@pytest.mark.parametrize("slides", ["", SLIDES], ids=["clamp", "plate"])
def test_reduced_bodies_are_driven_as_those_of_full_order(models, effects, slides):
    """Strokes are met, to round-off at rest; forces are the full order's; rollouts, batches and copies do the same."""
    system, rom = models(effects + JAW + slides)
    strokes = shaken(40)
    bodies = FullOrderSimulator(system, SHORT, system.scene.environment), fr.Simulator(rom, SHORT)
    seen = [drive(body, strokes) for body in bodies]
    forces = np.array([[each[-1] for each in of_body] for of_body in seen])
    ends = [body.displacement("tip").ravel() @ ALONG for body in bodies]
    exact = LARGE not in effects
    assert np.abs(forces[1] - forces[0]).max() <= (1e-8 if exact else 0.1) * np.abs(forces).max()
    follows = 2e-2 if "inertia" in effects else 1e-9
    np.testing.assert_allclose(ends, strokes[-1], atol=follows * strokes.max())
    inputs = np.column_stack([np.zeros((len(strokes), 3)), strokes])
    rolled = fr.Simulator(rom, SHORT).rollout(inputs)
    np.testing.assert_allclose(rolled["tip"][-1], bodies[1].displacement("tip"), rtol=1e-9)
    batch = fr.Batch(rom, 2, SHORT)
    for u in inputs:
        batch.step(np.array([u, u]))
    np.testing.assert_allclose(batch.displacement("tip")[0], bodies[1].displacement("tip"), rtol=1e-9)


@pytest.mark.parametrize("effects", [MOVING, LARGE + MOVING, LARGE], ids=["small", "large", "large, rests"])
def test_gradients_go_through_a_support_that_is_driven(models, effects):
    """Of displacements and energies, with respect to how it is driven, to pushes and to the start."""
    rom, random, steps = models(effects + JAW)[1], np.random.default_rng(0), 12

    def at(q, r):
        body = fr.Simulator(rom, SHORT)
        body.state = q, r
        return body

    u = np.column_stack([0.1 * random.standard_normal((steps, 3)), shaken(steps)])
    ω = fr.Simulator(rom, SHORT).model.safe_frequencies
    start = [1e-4 * random.standard_normal(len(ω)) / scale for scale in (ω, 1.0)]
    check_gradient(at, u, start, [np.abs(part) * random.standard_normal(part.shape) for part in (u, *start)])


def test_runs_know_how_far_a_support_went_and_its_force(bar, tmp_path):
    table = {"jaw.csv": np.array([[0.0, 0.0], [0.02, 3e-3], [0.04, 1e-3]])}
    text = RUN.replace("force = [4e-3]", 'table = "jaw.csv"')
    text = scene_text(bar, effects=MOVING + JAW + SLIDES, run=text, **PARTS)
    run = fr.simulate(fr.reduce(fr.assemble(parse_scene(text, tables=table)), order=20))
    fr.write_trajectory(tmp_path / "run.h5", run)
    back = fr.read_trajectory(tmp_path / "run.h5")
    assert (back.inputs["jaw"].unit, back.reaction_series["jaw"].unit) == ("m", "N")
    assert np.abs(back.inputs["jaw"].values - (back.outputs["tip"] @ ALONG)).max() <= 3e-4
    assert np.ptp(back.reactions["jaw"]) > 0
    assert back.balance_error <= 1e-12


def test_a_driven_clamp_presses_a_body_on_a_ball(models):
    """At full order and reduced the ball's and the clamp's forces are the same; the account closes."""
    down = JAW.replace("[2.0, 0.0, 1.0]", "[0.0, 0.0, -1.0]")
    system, rom = models(MOVING + down + BALL)
    bodies = FullOrderSimulator(system, SHORT, system.scene.environment), fr.Simulator(rom, SHORT)
    seen = [np.array([each[-1] for each in drive(body, shaken(30))]) for body in bodies]
    pushed = [body.obstacle_forces()[:, 2].sum() for body in bodies]
    assert pushed[0] > 0.1 * seen[0].max() > 0
    assert pushed[1] == pytest.approx(pushed[0], rel=1e-6)
    assert np.abs(seen[1] - seen[0]).max() <= 1e-6 * np.abs(seen[0]).max()


@pytest.mark.parametrize("control", ["displacement", "force"])
@pytest.mark.parametrize(
    "turn", [np.eye(3), np.array([[2, -2, 1], [1, 2, 2], [-2, -1, 2]]) / 3], ids=["along", "turned"]
)
def test_a_cube_that_is_pulled_both_ways_is_in_biaxial_tension(tmp_path, turn, control):
    """Large strains of St. Venant-Kirchhoff material between planes of symmetry; two plates share the nodes of an edge.

    E11 = E22 = E, S33 = 0: S11 = Y/(1 - ν) E, and the force on a plate is λ S11 times the area at rest.
    """
    points, cells = box_arrays((0.1, 0.1, 0.1), (2, 2, 2), shake=0.2)
    mesh = write_arrays(tmp_path / "cube.msh", points @ turn, cells, box_surfaces(points, cells))
    plates = "".join(
        f'[effects.driven_support.{face}]\nsurface = "{face}"\ndirection = {turn[k].tolist()}\nsliding = true\n'
        f'control = "{control}"\n'
        for k, face in enumerate(("right", "back"))
    )
    held = 'supports.held = [{ any = ["left", "front", "bottom"], sliding = true }]\n'
    effects = 'large_deformation = { material = "st_venant_kirchhoff" }\n' + plates
    system = fr.assemble(
        parse_scene(held + scene_text(mesh, supports=None, effects=effects, contacts=PARTS["contacts"]))
    )
    body, u, λ = FullOrderSimulator(system, 1.0, system.scene.environment), 0.02, 1.2
    force = λ * 1e6 / 0.7 * (λ**2 - 1) / 2 * 0.01
    for share in (0.5, 1.0):
        body.step(np.array([0, 0, 0, *[share * (u if control == "displacement" else force)] * 2]))
    moved = body.displacement() @ turn.T
    if control == "displacement":
        assert list(body.reactions.values()) == pytest.approx([force] * 2, rel=1e-8)
        assert np.abs(moved[:, :2] - 0.2 * points[:, :2]).max() <= 1e-9 * u
    else:
        assert np.abs(moved[:, :2] - (moved[-1, 0] / 0.1) * points[:, :2]).max() <= 1e-7 * u


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("[2.0, 0.0, 1.0]", "[0, 0, 0]"), r"driven_support.jaw.direction: use any direction but zero"),
        (('"right"', '"left"'), r"driven_support.jaw: node at \[0.0, .*\] is clamped by supports; use"),
        (
            ('surface = "right"', "along = { points = [[0.31, 0, 0], [0.31, 0.04, 0]] }"),
            r"the nearest is 0\.01 m away, at",
        ),
        ((JAW, JAW + JAW.replace("jaw", "other")), "driven_support.jaw: .* is held by another support along where it"),
        (
            ('surface = "right"', 'any = ["right", "top"]\nsliding = true'),
            r"driven_support\.jaw: sliding = true is of a plate, and its nodes are up to 0\.0\d+ m off a plane",
        ),
        (
            (JAW, JAW + "[run]\n" + RUN.replace("4e-3", "0.4")),
            r"run.load\[0\]: .* 'jaw' moves by 0.4 m within a step, at 0 s, more than the size .* 0.304 m",
        ),
    ],
)
def test_supports_that_cannot_be_driven_so_are_refused(bar, change, message):
    text = scene_text(bar, effects=MOVING + JAW.replace(*change))
    with pytest.raises(FenicsRomError, match=message):
        fr.assemble(parse_scene(text))


def test_nothing_drives_a_support_of_a_free_body(bar):
    with pytest.raises(
        FenicsRomError, match=r"driven_support\.jaw: moves nodes relative to what is clamped, and nothing"
    ):
        parse_scene('frame = "moving"\n' + scene_text(bar, effects=MOVING + JAW, supports=None))


def swung(time):
    """A base that goes and swings about an oblique axis, from rest."""
    angle, rate = 0.1 * (1 - np.cos(12 * time)), 1.2 * np.sin(12 * time)
    rotation = np.array([np.cos(angle / 2), *(np.sin(angle / 2) * np.array([0.0, 0.8, 0.6]))])
    return fr.BaseState(
        np.array([0.5 * time**2, 0, 0]), rotation, np.array([time, 0, 0]), rate * np.array([0, 0.8, 0.6])
    )


@pytest.mark.filterwarnings("ignore:training. the scene does not say how the base moves")
@pytest.mark.parametrize(
    ("effects", "slides", "differ"),
    [(MOVING, "", 1e-10), (MOVING, SLIDES, 1e-10), ("", "", 1e-10), (LARGE + MOVING, "", 0.02), (LARGE, SLIDES, 0.05)],
    ids=["small, clamp", "small, plate", "small, at rest", "large, clamp", "large, plate at rest"],
)
def test_a_base_carries_what_drives_a_support(bar, effects, slides, differ):
    """As it stands, the body is the held one, and the base bears nothing in the end; as it swings, all orders agree."""
    text = scene_text(bar, effects=effects + JAW + slides, run=RUN, **PARTS)
    held, carried = (fr.assemble(parse_scene(frame + text)) for frame in ("", 'frame = "moving"\n'))
    large = LARGE in effects
    rom = fr.reduce(carried, order=14 if large else carried.size, method=f"modal{'+derivatives' * large}")
    bodies = [FullOrderSimulator(system, 1e-2, system.scene.environment) for system in (held, carried)]
    for stroke in np.minimum(1.0, np.arange(1, 51) / 10) * 2e-3:
        for body in bodies:
            body.step(np.array([0.0, 0.0, 0.0, stroke]))
    one, other = bodies
    assert np.abs(other.displacement() - one.displacement()).max() <= 1e-9 * 2e-3
    assert other.reactions["jaw"] == pytest.approx(one.reactions["jaw"], rel=1e-8)
    assert np.linalg.norm(other.base_wrench[0]) <= 0.1 * one.reactions["jaw"]  # as some of it rings on
    moved = [
        FullOrderSimulator(carried, SHORT, carried.scene.environment, {"base_path": swung}),
        fr.Simulator(rom, SHORT, signals={"base_path": swung}),
    ]
    seen = [np.array([each[-1] for each in drive(body, shaken(15))]) for body in moved]
    assert np.abs(seen[1] - seen[0]).max() <= differ * np.abs(seen[0]).max()
    wrench = np.abs(moved[0].base_wrench).max()
    assert np.abs(moved[1].base_wrench - moved[0].base_wrench).max() <= max(differ * wrench, 1e-9)
