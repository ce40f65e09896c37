"""Soft bodies that touch themselves: as mirrored ones do a wall, with momenta and accounts to round-off."""

import warnings

import numpy as np
import pytest
from bodies import scene_text, write_arrays
from forks import CLAMPED, LONG, ROPE, cleft, pressed, prongs
from test_soft_motion import LIES, momenta

import fenics_rom as fr
from fenics_rom.errors import SceneError, StepError
from fenics_rom.mechanics.contact import ContactLaw
from fenics_rom.mechanics.own_surface import OwnSurface
from fenics_rom.scene.file import parse_scene
from fenics_rom.world.shapes import Box, HalfSpace

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
FAR = 'shape = "half-space"\npoint = [0.0, 0.0, -10.0]\nnormal = [0.0, 0.0, 1.0]'
ITSELF = ("fork", "fork")


def rom_of(folder, mesh, frame="fixed", order=None, **parts):
    """Of a body whose inner faces may touch, in all modes, or of an order."""
    file = write_arrays(folder / "fork.msh", *mesh)
    material = "young = 1e6\npoisson = 0.3\ndensity = 1000.0"
    text = scene_text(
        file,
        material=material,
        damping="beta = 1e-3",
        contacts='[contacts.inside]\nsurface = "inside"',
        **{"effects.contact": "", "effects.contact.obstacles.far": FAR, **parts},
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        system = fr.assemble(parse_scene(f'frame = "{frame}"\n{text}'))
        if order is None:
            return fr.reduce(system, order=system.elastic_size, method="modal")
        return fr.reduce(system, order=order)


def test_mirrored_prongs_meet_as_one_meets_a_wall(tmp_path):
    """In the mean of both; together they sway by a hundredth, as faces tilt and each pair is on one of them."""
    whole = rom_of(tmp_path, prongs((8, 1, 1)), **CLAMPED, **pressed("above", "below"))
    half = rom_of(tmp_path, prongs((8, 1, 1), upper_alone=True), **CLAMPED, **pressed("above"))
    fork = fr.World({"fork": fr.SoftBody(whole)}, 2e-4, pairs={ITSELF: ContactLaw()})
    prong = fr.World({"wall": fr.RigidBody(HalfSpace()), "prong": fr.SoftBody(half)}, 2e-4)
    touched, off, swayed, most = [0, 0], 0.0, 0.0, 0.0
    for _ in range(100):
        fork.step({"fork": {"above": 3000.0, "below": 3000.0}})
        prong.step({"prong": {"above": 3000.0}})
        touched = [max(pair) for pair in zip(touched, (fork.touching, prong.touching), strict=True)]
        both, one = fork.simulator("fork").displacement(), prong.simulator("prong").displacement()
        upper, lower = both[: len(one)], both[len(one) :] * [1, 1, -1]
        off = max(off, np.abs((upper + lower) / 2 - one).max())
        swayed = max(swayed, np.abs(upper - lower).max())
        most = max(most, np.abs(one).max())
    assert off <= 1e-4 * most
    assert swayed <= 0.02 * most
    assert touched[1] >= 10
    assert touched[0] == touched[1]  # one pair of two points that touch one another
    assert fork.energy == pytest.approx(2 * prong.energy, rel=1e-3)


def pull(world):
    """Pulls a fork's prongs together by its rope: they touch, and the account closes."""
    start, touched, scale = world.energy, 0, 0.0
    for _ in range(100):
        world.step({"fork": {"rope": 2.0}})
        gone, touched, scale = world.ledger, max(touched, world.touching), max(scale, world.energy)
        left = world.energy - start - gone.supplied + gone.dissipated + gone.lost_in_switching
        assert abs(left) <= 1e-13 * scale  # 100 steps of some 10 eps each
    assert touched >= 2


@pytest.mark.parametrize("strains", ["small", "large"])
def test_a_free_one_keeps_its_momenta_and_the_account(tmp_path, strains):
    """Its prongs are pulled together by a rope while it spins."""
    parts = ROPE | {"supports": None}
    if strains == "large":
        parts |= {
            "effects.large_deformation": 'material = "st_venant_kirchhoff"',
            "run": "dt = 1e-3\nduration = 0.01",
            "[run.load]": 'actuator = "rope"\nforce = [2.0]',
        }
    rom = rom_of(tmp_path, cleft((3, 1, 3), 1), "moving", order=6, **parts)
    body = fr.SoftBody(rom, angular_velocity=(3.0, -5.0, 8.0))
    world = fr.World({"fork": body}, 1e-3, pairs={ITSELF: ContactLaw(friction=0.4)})
    begun = momenta(world)
    pull(world)
    P, L = momenta(world)
    mass = world.simulator("fork").rom.moving_frame.mass
    np.testing.assert_allclose(P, begun[0], rtol=0, atol=1e-13 * mass * 8.0 * LONG)
    np.testing.assert_allclose(L, begun[1], rtol=0, atol=1e-13 * np.abs(begun[1]).max())


def test_a_carried_one_closes_its_account(tmp_path):
    """Its prongs are pulled together by a rope while the palm that carries it turns."""
    parts = ROPE | CLAMPED | {"effects.base_path": "origin = [0.0, 0.0, 0.0]"}
    rom = rom_of(tmp_path, cleft((3, 1, 3), 1), "moving", order=6, **parts)

    def palm(time):
        angle = 4.0 * time
        turned = np.array([np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)])
        return LIES._replace(rotation=turned, angular_velocity=np.array([0.0, 0.0, 4.0]))

    bodies = {"palm": fr.RigidBody(Box((0.05, 0.05, 0.05)), motion=palm), "fork": fr.SoftBody(rom, on="palm")}
    world = fr.World(bodies, 1e-3, pairs={ITSELF: ContactLaw(friction=0.4)}, apart=[("palm", "fork")])
    pull(world)


def test_what_is_pressed_on_itself_stays_outside(tmp_path):
    """Under a rope that goes on pulling."""
    rom = rom_of(tmp_path, cleft((6, 1, 3), 1), order=12, **CLAMPED, **ROPE)
    world = fr.World({"fork": fr.SoftBody(rom)}, 1e-3, pairs={ITSELF: ContactLaw(friction=0.4)})
    body, deepest = world.simulator("fork"), 0.0
    points = body.contact_coordinates
    own = OwnSurface(points, body.contact_triangles, np.arange(len(points)), ["fork"] * len(points))
    for step in range(200):
        world.step({"fork": {"rope": min(20.0, 0.2 * step)}})
        body.begin(0.0)
        deepest = min(deepest, own.near(body.placed().points, 0.0).gaps.min(initial=0.0))
    assert world.touching >= 4
    places, forces = world.contact_forces("fork", "fork")
    assert np.count_nonzero(forces.any(axis=1)) == world.touching
    assert (places[forces.any(axis=1), 0] > 0.5 * LONG).all()  # where the rope is
    assert deepest >= -1e-3 * LONG  # 1e-4: points whose opposite one has the pair are as deep as faces tilt


def test_what_cannot_be_is_refused(tmp_path):
    rom = rom_of(tmp_path, cleft((3, 1, 3), 1), order=6, **CLAMPED, **ROPE)
    bodies = {"fork": fr.SoftBody(rom), "wall": fr.RigidBody(HalfSpace(), motion=LIES)}
    for pair, says in ((("wall", "wall"), "'wall' with itself: it is rigid"), (("fork", "none"), "none")):
        with pytest.raises(SceneError, match=says):
            fr.World(bodies, 1e-3, pairs={pair: ContactLaw()})
    world = fr.World({"fork": fr.SoftBody(rom)}, 1e-3, pairs={ITSELF: ContactLaw()})
    with pytest.raises(StepError, match="'fork' on itself add up to 0: use two bodies; `contact_forces`"):
        world.force_between("fork", "fork")


def test_a_world_file_names_it_twice(tmp_path):
    fr.write_rom(tmp_path / "fork.h5", rom_of(tmp_path, cleft((3, 1, 3), 1), order=6, **CLAMPED, **ROPE))
    text = """
[bodies.fork]
rom = "fork.h5"
[bodies.ball]
shape = "sphere"
radius = 0.01
position = [0.0, 0.0, 0.5]
[[pairs]]
bodies = ["fork", "fork"]
friction = 0.4
[run]
dt = 1e-3
duration = 0.2
[[run.input]]
body = "fork"
actuator = "rope"
value = 4.0
"""
    (tmp_path / "world.toml").write_text(text)
    run = fr.simulate(str(tmp_path / "world.toml"))
    assert run.contact_account["friction"][-1] > 0
    (tmp_path / "world.toml").write_text(text.replace('["fork", "fork"]', '["ball", "ball"]'))
    with pytest.raises(SceneError, match="ball: is rigid: use two bodies, or a soft one twice"):
        fr.simulate(str(tmp_path / "world.toml"))
