"""What supports exert: the body's weight, the balance of its momentum, and the forces of supports that are driven."""

import warnings

import numpy as np
import pytest
from bodies import acted_on, box_arrays, dense, scene_text, write_arrays

import fenics_rom as fr
from fenics_rom.errors import FenicsRomError, FenicsRomWarning
from fenics_rom.fem.simulator import FullOrderSimulator
from fenics_rom.scene.file import parse_scene

LENGTHS = (0.3, 0.04, 0.03)
WEIGHT = 1000.0 * np.prod(LENGTHS) * 9.81
GRAVITY = "gravity = { acceleration = [0.0, 0.0, -9.81] }\n"
MOVING = "inertia = {}\ndamping = { alpha = 1.0, beta = 1e-3 }\n"
RELAXING = MOVING + "viscoelasticity = { ratios = [0.5], times = [0.01] }\n"
LARGE = 'large_deformation = { material = "neo_hookean" }\n'
PUSH = "[effects.prescribed.push]\npoint = [0.3, 0.0, 0.03]\nforce = [0.2, 0.1, 0.3]\n"
FLOOR = '[effects.contact.obstacles.floor]\nshape = "half-space"\npoint = [0, 0, -5e-4]\nnormal = [0, 0, 1]\n'
JAW = '[effects.driven_support.jaw]\nsurface = "{}"\ndirection = [2.0, 0.0, 1.0]\n'
ALONG = np.array([2.0, 0.0, 1.0]) / np.sqrt(5.0)
ALL = {"readings.all": 'quantity = "reaction"\npoint = [0.0, 0.0, 0.0]'}
SOFT, STIFF = (f"young = {E}\npoisson = 0.3\ndensity = 1000.0" for E in (1e5, 1e7))
STEP = 2e-3  # s
MODELS = pytest.mark.parametrize("model", ["full", "reduced"])


@pytest.fixture(scope="module")
def bar(tmp_path_factory):
    mesh = box_arrays(LENGTHS, (4, 2, 2), shake=0.2)
    return write_arrays(tmp_path_factory.mktemp("bar") / "bar.msh", *mesh)


@pytest.fixture(scope="module")
def body_of(bar, tmp_path_factory):
    """A body by the text of its effects, at full order, or reduced and read from a file; models are made once."""
    made = {}

    def make(model, effects, h=STEP, supports='clamped = ["left"]', **readings):
        parts = ALL | {"contacts": '[contacts.bottom]\nsurface = "bottom"'} | readings
        parts |= {"material": SOFT if LARGE in effects else STIFF}
        load = "\n[[run.load]]\nactuator = 'air'\nforce = [40.0]" if "pressure.air" in effects else ""
        parts |= {"supports": supports, "run": f"dt = {h}\nduration = {40 * h}{load}"}
        key = effects, h, *parts.items()
        if key not in made:
            scene = acted_on(bar, effects, **parts)
            system, rom = fr.assemble(scene), tmp_path_factory.mktemp("rom") / "rom.h5"
            made[key] = scene, system, rom
        scene, system, rom = made[key]
        if model == "full":
            return FullOrderSimulator(system, h, scene.environment)
        if not rom.exists():
            large = scene.effects.large_deformation is not None
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", FenicsRomWarning)  # of training, and of what nothing holds
                reduced = fr.reduce(
                    system,
                    **({"order": 14, "method": "modal+derivatives"} if large else {"order": 8, "method": "modal"}),
                )
            fr.write_rom(rom, reduced)
        return fr.Simulator(fr.read_rom(rom), h)

    return make


@pytest.fixture(scope="module")
def free(bar):
    """Nodes at rest, and M of the body that nothing holds."""
    system = fr.assemble(acted_on(bar, "inertia = {}\n", supports=None, material=SOFT))
    return system.body.nodes, dense(system.mass, system.size)


def step(body, stroke=None):
    """With nothing that pushes but effects, and a stroke."""
    width = (
        body.inputs
        if isinstance(body, fr.Simulator)
        else body.stepper.input_matrix.shape[1] - len(body.environment.loads)
    )
    follows = body.environment is not None and body.environment.environment.switches_itself
    u = np.zeros(0 if follows and isinstance(body, FullOrderSimulator) else width)
    if stroke is not None:
        u[-1] = stroke
    body.step(u)


def shape(body):
    """Of all nodes; reduced as the shared basis has it."""
    return body.displacement() if isinstance(body, FullOrderSimulator) else body.rom.reconstruct(body.shape_coordinates)


@MODELS
@pytest.mark.parametrize("effects", ["", LARGE], ids=["small", "large"])
def test_supports_bear_the_weight_and_what_pushes_the_end(body_of, free, model, effects):
    """Whatever the basis lacks: force is that of the load, and the couple that of its place, moved if that is large."""
    X, M = free
    body = body_of(model, effects + GRAVITY + PUSH, h=1.0)
    step(body)
    x, end, push = X + shape(body), np.flatnonzero((np.abs(X - [0.3, 0.0, 0.03]) < 1e-9).all(axis=1)), [0.2, 0.1, 0.3]
    if not effects:
        x = X
    weights = (M @ np.tile([0.0, 0.0, -9.81], len(X))).reshape(-1, 3)
    R = body.reading("all")
    np.testing.assert_allclose(R[:3], np.array([0.0, 0.0, WEIGHT]) - push, atol=1e-10 * WEIGHT)
    couple = np.cross(x, weights).sum(axis=0) + np.cross(x[end[0]], push)
    np.testing.assert_allclose(R[3:], -couple, atol=1e-10 * WEIGHT * LENGTHS[0])


@MODELS
@pytest.mark.parametrize("effects", [MOVING, RELAXING, LARGE + MOVING], ids=["small", "relaxing", "large"])
def test_momentum_changes_by_weight_contact_drag_and_supports(body_of, free, model, effects):
    """In every step of a bar that falls on a floor, to round-off; of large deformation angular momentum, too."""
    X, M = free
    body, α, largest, touched = body_of(model, effects + GRAVITY + FLOOR), 1.0, np.zeros(2), 0
    points = body.system.points_of_contact() if model == "full" else body.integrator.interface.points
    for _ in range(40):
        x, v = shape(body), body.velocity()
        step(body)
        x_end, v_end = shape(body), body.velocity()
        contact = body.stepper.contact if model == "full" else body.integrator.contact
        pushed = np.zeros_like(X) if contact is None else points.on_nodes(contact.forces, np.arange(len(X)))
        lacks = (
            M
            @ np.stack([(v_end - v) / STEP + α * (v_end + v) / 2, np.tile([0, 0, 9.81], (len(X), 1))]).reshape(2, -1).T
        )
        lacks = lacks.sum(axis=1).reshape(-1, 3) - pushed
        arms = X + (x + x_end) / 2 if LARGE in effects else X
        R, touched = body.reading("all"), touched + (contact is not None)
        largest = np.maximum(largest, [np.abs(R[:3]).max(), np.abs(R[3:]).max()])
        assert np.abs(R[:3] - lacks.sum(axis=0)).max() <= 1e-13 * largest[0]
        assert np.abs(R[3:] - np.cross(arms, lacks).sum(axis=0)).max() <= 1e-13 * largest[1]
    assert 0 < touched < 40


@MODELS
@pytest.mark.parametrize("effects", [MOVING, RELAXING, ""], ids=["small", "relaxing", "at rest"])
def test_a_driven_support_has_the_reaction_that_is_found(body_of, model, effects):
    """Whether it holds the body alone, or beside another support."""
    for side, supports in (("left", None), ("right", 'clamped = ["left"]')):
        if effects or supports:
            readings = {"readings.jaw": f'quantity = "reaction"\nsurface = "{side}"'}
            body, largest = body_of(model, effects + GRAVITY + JAW.format(side), supports=supports, **readings), 0.0
            for k in range(10):
                step(body, 1e-4 * np.sin(k))
                force = body.reading("jaw")[:3] @ ALONG
                largest = max(largest, abs(force))
                assert force == pytest.approx(body.reactions["jaw"], abs=1e-9 * largest)


@MODELS
@pytest.mark.parametrize("effects", ["", LARGE], ids=["small", "large"])
def test_supports_that_are_driven_bear_the_weight_together_with_others(body_of, model, effects):
    body = body_of(model, effects + GRAVITY + JAW.format("right"), supports='clamped = ["left"]')
    step(body, 2e-4)
    assert abs(body.reactions["jaw"]) > 0.1 * WEIGHT
    np.testing.assert_allclose(body.reading("all")[:3], [0.0, 0.0, WEIGHT], atol=1e-9 * abs(body.reactions["jaw"]))


def test_supports_share_a_load_as_at_full_order(body_of):
    """At rest to round-off on six modes; in motion as well as the model is."""
    sides = {f"readings.{side}": f'quantity = "reaction"\nsurface = "{side}"' for side in ("left", "right")}
    push = PUSH.replace("[0.3, 0.0, 0.03]", "[0.1, 0.02, 0.03]")
    for effects, accuracy in ((push, 1e-10), (MOVING + push, 0.05)):
        bodies = [
            body_of(model, effects, supports='clamped = ["left", "right"]', **sides) for model in ("full", "reduced")
        ]
        for _ in range(25):
            for body in bodies:
                step(body)
        full, reduced = ({side: body.reading(side) for side in ("left", "right", "all")} for body in bodies)
        for side, R in full.items():
            assert np.abs(reduced[side] - R).max() <= accuracy * np.abs(R).max()
        assert np.abs(full["left"] + full["right"] - full["all"])[:3].max() <= 1e-12 * np.abs(full["all"]).max()


def test_a_bent_bar_swings_on_its_support_as_at_full_order(body_of):
    bodies = [body_of(model, LARGE + MOVING + GRAVITY) for model in ("full", "reduced")]
    kept = []
    for _ in range(60):
        for body in bodies:
            step(body)
        kept.append([body.reading("all") for body in bodies])
    full, reduced = np.array(kept).swapaxes(0, 1)
    assert np.ptp(bodies[0].displacement(), axis=0)[2] > 0.05  # it bends by a fifth of its length
    for part in (slice(0, 3), slice(3, 6)):
        assert np.abs(reduced - full)[:, part].max() <= 0.06 * np.abs(full[:, part]).max()


@pytest.mark.parametrize(
    "effects", [MOVING, MOVING + GRAVITY, MOVING + GRAVITY + FLOOR, LARGE + MOVING + GRAVITY], ids=range(4)
)
def test_rollouts_batches_and_copies_read_the_last_step(body_of, effects):
    rom = body_of("reduced", effects).rom
    stepped, rolled, batch = fr.Simulator(rom, STEP), fr.Simulator(rom, STEP), fr.Batch(rom, 2, STEP)
    assert not stepped.reading("all").any()
    pushes = (
        np.zeros((12, stepped.inputs))
        if FLOOR in effects
        else np.random.default_rng(0).normal(size=(12, stepped.inputs))
    )
    for u in pushes:
        stepped.step(u)
        batch.step(np.stack([u, u]))
    rolled.rollout(pushes)
    R = stepped.reading("all")
    assert R.any()
    np.testing.assert_allclose(rolled.reading("all"), R, atol=1e-9 * np.abs(R).max())
    np.testing.assert_allclose(batch.reading("all"), [R, R], atol=1e-9 * np.abs(R).max())
    saved = stepped.save()
    stepped.step(np.zeros(stepped.inputs))
    assert np.abs(stepped.reading("all") - R).max() > 0
    stepped.restore(saved)
    assert np.array_equal(stepped.reading("all"), R)


def test_a_run_keeps_reactions(body_of, tmp_path):
    rom = body_of("reduced", MOVING + GRAVITY).rom
    run = fr.simulate(rom)
    fr.write_trajectory(tmp_path / "run.h5", run)
    kept = fr.read_trajectory(tmp_path / "run.h5").readings["all"]
    assert kept.values.shape == (41, 6)
    assert np.array_equal(kept.sizes, np.linalg.norm(kept.values[:, :3], axis=1))
    assert kept.unit == "N"
    with pytest.raises(fr.errors.StepError, match="reaction of supports is not linear in displacements"):
        rom.state_space("bottom", ["all"])


@MODELS
def test_pressure_on_an_open_surface_pushes_the_whole_as_it_turned(body_of, free, model):
    """With large deformation: by its rim, as its forces on all nodes do."""
    X, M = free
    effects = LARGE + MOVING + '[effects.pressure.air]\nsurface = "top"\n'
    follower = body_of("full", effects).system.deformation.model.followers["air"]
    body, largest = body_of(model, effects), np.zeros(2)
    for k in range(10):
        x, v, pressure = shape(body), body.velocity(), 40.0 * np.sin(k)
        step(body, pressure)
        x, v_end = (x + shape(body)) / 2, body.velocity()
        lacks = (M @ ((v_end - v) / STEP + (v_end + v) / 2).ravel()).reshape(-1, 3) - pressure * follower.force(x)
        R = body.reading("all")
        largest = np.maximum(largest, [np.abs(R[:3]).max(), np.abs(R[3:]).max()])
        assert np.abs(R[:3] - lacks.sum(axis=0)).max() <= 1e-12 * largest[0]
        assert np.abs(R[3:] - np.cross(X + x, lacks).sum(axis=0)).max() <= 1e-12 * largest[1]


MISTAKES = {
    ("inertia = {}", "free"): r"readings.all: nothing is held; use it with supports, or effects.driven_support",
    ("inertia = {}", "moving"): r"readings.all: with frame = 'moving' a base bears the body; use its base_wrench",
    ("inertia = {}", "top"): None,
    ("inertia = {}", "right"): r"readings.all: its place has none of the 9 nodes that supports hold",
    (LARGE, "top"): r"readings.all: with effects.large_deformation a reaction is that of all supports together",
    (RELAXING + '[effects.springs.bed]\nsurface = "right"\nstiffness = 1.0', "top"): (
        r"readings.all: beside effects.viscoelasticity and springs, or where supports leave the body free"
    ),
}


@pytest.mark.parametrize(("given", "said"), MISTAKES.items(), ids=range(len(MISTAKES)))
def test_what_no_reaction_is_known_of_is_told(bar, given, said):
    effects, place = given
    reading = ALL["readings.all"] + ("" if place in ("free", "moving") else f'\nsurface = "{place}"')
    parts = {"readings.all": reading, "contacts": '[contacts.bottom]\nsurface = "bottom"'}
    parts["supports"] = None if place == "free" else 'clamped = ["left"]'
    if said is None:
        fr.assemble(acted_on(bar, effects, **parts))
        return
    text = 'frame = "moving"\n' * (place == "moving") + scene_text(bar, effects=effects, **parts)
    with pytest.raises(FenicsRomError, match=said):
        fr.assemble(parse_scene(text))
