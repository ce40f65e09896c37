"""A body that touches itself in a scene of its own: as prongs do a wall, with momenta and accounts to round-off."""

import copy
import warnings

import numpy as np
import pytest
from forks import CLAMPED, GAP, LONG, ROPE, cleft, fork_scene, pressed, prongs

import fenics_rom as fr
from fenics_rom.errors import SceneError, StepError
from fenics_rom.world.shapes import Sphere

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
WALL = 'obstacles.wall = { shape = "half-space", point = [0.0, 0.0, 0.0], normal = [0.0, 0.0, 1.0] }'
RUBS = {"effects.friction": "coefficient = 0.4"}
LARGE = {
    "effects.large_deformation": 'material = "st_venant_kirchhoff"',
    "run": "dt = 1e-3\nduration = 0.01",
    "[run.load]": 'actuator = "rope"\nforce = [2.0]',
}
CARRIED = CLAMPED | {"effects.base_path": "origin = [0.0, 0.0, 0.0]"}
READ = {"outputs.tip": 'surface = "above"', "readings.pressure": 'quantity = "contact_pressure"\nof = "inside"'}
STROKE = {name: f'{text}\ncontrol = "length"' for name, text in ROPE.items()}


def rom_of(folder, mesh, frame="fixed", order=6, contact='self_contact = ["inside"]', **parts):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        system = fr.assemble(fork_scene(folder, mesh, frame, contact, **parts))
        if order is None:
            return fr.reduce(system, order=system.elastic_size, method="modal")
        return fr.reduce(system, order=order)


def turning(time):
    angle = 4.0 * time
    turned = np.array([np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)])
    return fr.BaseState(np.zeros(3), turned, np.zeros(3), np.array([0.0, 0.0, 4.0]))


@pytest.fixture(scope="module")
def clamp(tmp_path_factory):
    """Two prongs that a rope pulls together."""
    return rom_of(tmp_path_factory.mktemp("clamp"), cleft((3, 1, 3), 1), **CLAMPED, **ROPE, **RUBS, **READ)


def test_mirrored_prongs_meet_as_one_meets_a_wall(tmp_path):
    """In the mean of both; together they sway by a hundredth, as faces tilt and each pair is on one of them."""
    whole = rom_of(tmp_path, prongs((8, 1, 1)), order=None, **CLAMPED, **pressed("above", "below"))
    half = rom_of(
        tmp_path, prongs((8, 1, 1), upper_alone=True), order=None, contact=WALL, **CLAMPED, **pressed("above")
    )
    fork, prong = fr.Simulator(whole, 2e-4), fr.Simulator(half, 2e-4)
    off = swayed = most = 0.0
    for _ in range(100):
        fork.step(above=3000.0, below=3000.0)
        prong.step(above=3000.0)
        both, one = fork.displacement(), prong.displacement()
        upper, lower = both[: len(one)], both[len(one) :] * [1, 1, -1]
        off = max(off, np.abs((upper + lower) / 2 - one).max())
        swayed = max(swayed, np.abs(upper - lower).max())
        most = max(most, np.abs(one).max())
    assert off <= 2e-3 * most
    assert swayed <= 0.02 * most
    assert np.abs(fork.contact_forces()[:, 2]).sum() / 2 == pytest.approx(prong.contact_forces("wall")[2], rel=1e-2)
    assert fork.energy == pytest.approx(2 * prong.energy, rel=1e-3)


@pytest.mark.parametrize(
    ("frame", "held", "parts", "bound"),
    [
        ("fixed", CLAMPED, ROPE, 1e-13),
        ("fixed", CLAMPED, STROKE, 1e-13),
        ("fixed", CLAMPED, ROPE | {"effects.viscoelasticity": "ratios = [0.5]\ntimes = [0.05]"}, 1e-13),
        ("fixed", CLAMPED, ROPE | LARGE, 1e-13),
        ("fixed", CLAMPED, ROPE | {"effects": "", "effects.damping": None}, 1e-13),
        ("moving", {"supports": None}, ROPE, 1e-12),
        pytest.param("moving", {"supports": None}, ROPE | LARGE, 1e-12, marks=pytest.mark.slow),
        ("moving", CARRIED, ROPE, 1e-13),
        pytest.param("moving", CARRIED, ROPE | LARGE, 1e-13, marks=pytest.mark.slow),
        ("moving", CARRIED, ROPE | {"effects": "", "effects.damping": None}, 1e-13),
    ],
    ids=["held", "stroke", "relaxing", "large", "at rest", "free", "free large", "carried", "carried large", "on base"],
)
def test_accounts_close_and_momenta_stay(tmp_path, frame, held, parts, bound):
    """With friction, pulled together by a rope, while a free body spins, and a base turns one that it carries."""
    rom = rom_of(tmp_path, cleft((3, 1, 3), 1), frame, **held, **RUBS, **parts)
    body = fr.Simulator(rom, 1e-3, signals={"base_path": turning} if held is CARRIED else None)
    if is_free := frame == "moving" and held is not CARRIED:
        body.place(body.pose._replace(angular_velocity=np.array([3.0, -5.0, 8.0])))
    start, begun, touched, scale, left = body.energy, body.momentum, 0, 0.0, 0.0
    for step in range(60):
        body.step(rope=min(4e-3, 1e-4 * step) if parts is STROKE else 2.0)
        gone, contact = body.ledger, body.integrator.contact
        touched, scale = max(touched, 0 if contact is None else contact.touching), max(scale, body.energy)
        lost = gone.dissipated + gone.lost_in_switching + gone.numerical
        left = max(left, abs(body.energy - start - gone.supplied + lost))
    assert left <= bound * scale
    assert touched >= 2
    assert body.ledger.contact >= 0
    assert body.ledger.friction >= -1e-11 * scale  # round-off where all pairs stick: 8e-13 is seen
    if is_free:
        (P, L), (P_begun, L_begun) = body.momentum, begun
        np.testing.assert_allclose(P, P_begun, rtol=0, atol=1e-12 * rom.moving_frame.mass * 8.0 * LONG)
        np.testing.assert_allclose(L, L_begun, rtol=0, atol=1e-12 * np.abs(L_begun).max())


@pytest.mark.parametrize(("law", "turns"), [("springs", False), ("springs", True), ("rigid", True)])
def test_springs_and_obstacles_beside_it_close_the_account(tmp_path, law, turns):
    """A ground comes up against a fork whose prongs touch; it may turn as it does."""
    ground = 'obstacles.ground = { shape = "half-space", point = [0.0, 0.0, -0.03], normal = [0.0, 0.0, 1.0] }'
    ground = ground.replace(" }", ", motion = { origin = [0.0, 0.0, -0.03] } }") if turns else ground
    springs = 'self_contact = ["inside"]\n'
    if law == "springs":
        springs += 'method = "penalty"\nstiffness = 1e3\ndamping = 0.1\n'
    modes = '[contacts.inside]\nsurface = "inside"\n[contacts.below]\nsurface = "below"'
    rom = rom_of(tmp_path, cleft((3, 1, 3), 1), contact=springs + ground, contacts=modes, **CLAMPED, **ROPE, **RUBS)

    def rises(time):
        shift = np.array([0.0, 0.0, min(0.3 * time, 0.021)])
        if not turns:
            return shift
        turned = np.array([np.cos(time), 0.0, 0.0, np.sin(time)])
        speed = np.array([0.0, 0.0, 0.3 * (time < 0.07)])
        return fr.BaseState(shift - [0.0, 0.0, 0.03], turned, speed, np.array([0.0, 0.0, 2.0]))

    body = fr.Simulator(rom, 1e-3, signals={"ground": rises})
    scale = 0.0
    for _ in range(100):
        body.step(rope=2.0)
        gone, scale = body.ledger, max(scale, body.energy)
        assert abs(body.energy - gone.supplied + gone.dissipated + gone.lost_in_switching) <= 1e-13 * scale
    contact, solver = body.integrator.contact, body.integrator.interface.solver
    assert set(contact.pairs // len(solver.points)) == {0, 1}  # the ground, and itself
    assert body.contact_forces("ground")[2] > 0
    np.testing.assert_allclose(body.contact_forces().sum(axis=0), body.contact_forces("ground"), atol=1e-12)


def test_what_is_pressed_on_itself_stays_outside_and_reads_its_pressure(tmp_path, clamp):
    rom = rom_of(tmp_path, cleft((6, 1, 3), 1), order=12, **CLAMPED, **ROPE, **RUBS)
    body, deepest = fr.Simulator(rom, 1e-3), 0.0
    own = body.integrator.interface.solver.surface
    for step in range(200):
        body.step(rope=min(20.0, 0.2 * step))
        deepest = min(
            deepest,
            own.near(body.contact_coordinates + body.integrator.point_displacement(), 0.0).gaps.min(initial=0.0),
        )
    assert np.count_nonzero(body.contact_forces().any(axis=1)) >= 8
    assert deepest >= -1e-3 * LONG  # 1e-4: points whose opposite one has the pair are as deep as faces tilt
    body = fr.Simulator(clamp, 1e-3)
    for _ in range(60):
        body.step(rope=2.0)
    pressure, forces = body.reading("pressure"), np.abs(body.contact_forces()[:, 2])
    reading = clamp.readings["pressure"]
    areas = np.bincount(reading.facets.ravel(), np.repeat(reading.areas / 3, 3))
    assert pressure @ areas == pytest.approx(forces.sum(), rel=0.01)  # normals tilt a little


def test_batches_rollouts_and_copies_go_as_steps_do(clamp):
    body, other = fr.Simulator(clamp, 1e-3), fr.Simulator(clamp, 1e-3)
    batch = fr.Batch(clamp, 2, 1e-3, ledger=True)
    assert "contact of a body with itself" in batch.stepping
    for _ in range(60):
        body.step(rope=2.0)
        batch.step(np.array([[0.0, 0.0, 0.0, 2.0], [0.0, 0.0, 0.0, 1.0]]))
    read = other.rollout({"rope": np.full((60, 1), 2.0)}, outputs=["tip"])
    assert body.integrator.contact.touching >= 2
    np.testing.assert_array_equal(read["tip"][-1], body.displacement("tip"))
    np.testing.assert_array_equal(batch.displacement("tip")[0], body.displacement("tip"))
    twin, there = copy.copy(body), body.save()
    for _ in range(20):
        body.step(rope=2.0)
        twin.step(rope=2.0)
    assert twin.energy == body.energy
    body.restore(there)
    assert body.energy != twin.energy
    for _ in range(20):
        body.step(rope=2.0)
    assert twin.energy == body.energy


def test_a_file_keeps_what_touches_itself_and_other_scenes_may_say_it(tmp_path, clamp):
    fr.write_rom(tmp_path / "clamp.h5", clamp)
    rom = fr.read_rom(tmp_path / "clamp.h5")
    assert rom.environment.self_contact == ("inside",)
    far = WALL.replace("0.0, 0.0, 0.0", "0.0, 0.0, -1.0")
    scene = fork_scene(tmp_path, cleft((3, 1, 3), 1), contact=far, **CLAMPED, **ROPE, **RUBS, **READ)
    apart = fr.Simulator(rom, 1e-3, scene=scene)
    solvers = [type(each.integrator.interface.solver).__name__ for each in (fr.Simulator(rom, 1e-3), apart)]
    assert ["SelfContact" in name for name in solvers] == [True, False]  # also where it is compiled
    for _ in range(60):
        apart.step(rope=2.0)


def test_a_world_does_what_the_scene_says(clamp):
    """Nearly: it looks for pairs where the body is in the middle of a step."""
    ball = fr.RigidBody(Sphere(0.01), position=(0.0, 0.0, 1.0))
    body = fr.Simulator(clamp, 1e-3)
    world = fr.World({"clamp": fr.SoftBody(clamp), "ball": ball}, 1e-3, friction=0.4, gravity=(0.0, 0.0, 0.0))
    for _ in range(60):
        body.step(rope=2.0)
        world.step({"clamp": {"rope": 2.0}})
    assert world.touching >= 2
    np.testing.assert_allclose(world.simulator("clamp").displacement(), body.displacement(), atol=1e-2 * GAP)


def test_steps_that_touch_have_no_state_space(clamp):
    body = fr.Simulator(clamp, 1e-3)
    for _ in range(60):
        body.step(rope=2.0)
    with pytest.raises(StepError, match="a body that may touch itself touches something have no state space"):
        clamp.state_space("inside", at=body)


def test_what_cannot_be_is_refused(tmp_path, clamp):
    mesh = cleft((3, 1, 3), 1)
    with pytest.raises(SceneError, match=r"effects.contact.self_contact: no contact mode 'none'; there is inside"):
        fork_scene(tmp_path, mesh, contact='self_contact = ["none"]', **CLAMPED)
    points, cells, faces = prongs((3, 1, 1))
    points[len(points) // 2 :, 2] += 1.5 * GAP
    points[len(points) // 2 :, 0] += 0.3 * LONG
    with pytest.raises(SceneError, match=r"self_contact: .*surface.* begins 0.00\d+ m inside .*surface.*, at"):
        rom_of(tmp_path, (points, cells, faces), **CLAMPED)
    body = fr.Simulator(clamp, 1e-3)
    shut = np.zeros_like(clamp.nodes)
    shut[:, 2] = -np.sign(clamp.nodes[:, 2]) * 0.8 * GAP * (clamp.nodes[:, 0] / LONG) ** 2
    with pytest.raises(StepError, match=r"but 'inside' is 0.00\d+ m inside 'inside' at"):
        body.set_shape(shut)
    assert not body.displacement().any()
