"""Surfaces that are rigid however far they turn: of their shape and size to round-off, passive, and linear if slow."""

import numpy as np
import pytest
from bodies import box_arrays, box_surfaces, scene_text, write_arrays
from ranks import run_ranks

import fenics_rom as fr
from fenics_rom.errors import SceneError
from fenics_rom.fem.finite_strain.follower_loads import RigidBar
from fenics_rom.fem.rigid_surfaces import affine_ties, leaders
from fenics_rom.fem.simulator import FullOrderSimulator
from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.scene.file import parse_scene

SOFT = "young = 1e6\npoisson = 0.35\ndensity = 1000.0"
MOVING = "inertia = {}\ndamping = { alpha = 0.5, beta = 2e-3 }\n"
PUSH = '[contacts.right]\nsurface = "right"\nforce = "resultant"'
FLOOR = 'gravity = { acceleration = [0, 0, -30] }\n[effects.contact.obstacles.floor]\nshape = "half-space"\n'
FLOOR += "point = [0, 0, -0.03]\nnormal = [0, 0, 1]\n"
TOOL = '[effects.rigid_parts.tool]\nsurface = "right"\nmass = 0.1\ninertia = [2e-4, 1e-4, 2e-4]\n'
TOOL += "center = [0.52, 0.025, 0.025]\n"
FLAT, BENT = 'rigid = ["right"]', 'rigid = ["hand"]'
RIGID = 1e-12  # of its size: a hundred times what is left
ACCOUNT = 1e-11  # of the largest of what is stored, supplied and dissipated: ten times what is left
STEPS_ON_RANKS = """import sys
import numpy as np
from mpi4py import MPI
import fenics_rom as fr
from fenics_rom.fem.simulator import FullOrderSimulator
system = fr.assemble(fr.read_scene("scene.toml"))
body = FullOrderSimulator(system, 5e-3, system.scene.environment)
for _ in range(10):
    body.step(np.empty(0))
moved = body.displacement()  # of all ranks together
if MPI.COMM_WORLD.rank == 0:
    np.save(sys.argv[1], moved)
"""


@pytest.fixture(scope="module")
def beam(tmp_path_factory):
    """A beam whose end is a surface that is flat, and part of one, a hand, that is not."""
    points, cells = box_arrays((0.5, 0.05, 0.05), (6, 1, 1), shake=0.2)
    surfaces = box_surfaces(points, cells)
    top = surfaces["top"]
    surfaces["hand"] = np.concatenate([surfaces["right"], top[points[top][:, :, 0].min(axis=1) > 0.34]])
    return write_arrays(tmp_path_factory.mktemp("hand") / "beam.msh", points, cells, surfaces)


def body_of(
    mesh, rigid, effects="", h=5e-3, law="neo_hookean", kind=MOVING, head="", clamped='clamped = ["left"]', **parts
):
    large = f'large_deformation = {{ material = "{law}" }}\n' if law else ""
    parts = {"supports": f"{clamped}\n{rigid}", "material": SOFT, "contacts": PUSH} | parts
    text = head + scene_text(mesh, effects=kind + large + effects, **parts)
    system = fr.assemble(parse_scene(text))
    return FullOrderSimulator(system, h, system.scene.environment)


def places_of(body):
    """At rest and now, of the nodes of the rigid surface, (s, 3) each."""
    nodes, x_least = body.system.body.nodes, 0.5
    if any(name.endswith("bar-4") for name in body.system.scene.bars):
        x_least = 0.34
    on = (nodes[:, 0] > x_least - 1e-9) & ((nodes[:, 0] > 0.5 - 1e-9) | (nodes[:, 2] > 0.05 - 1e-9))
    return nodes[on], (nodes + body.displacement())[on]


def stretch_and_turn(body):
    """Largest change of a distance on the rigid surface, as a share of its size, and how far it is turned, degrees."""
    rest, moved = places_of(body)
    before, after = (np.linalg.norm(x[:, None] - x, axis=2) for x in (rest, moved))
    U, _, Vᵀ = np.linalg.svd((rest - rest.mean(axis=0)).T @ (moved - moved.mean(axis=0)))
    R = U @ np.diag([1, 1, np.sign(np.linalg.det(U @ Vᵀ))]) @ Vᵀ
    return np.abs(after - before).max() / before.max(), np.degrees(np.arccos(np.clip((np.trace(R) - 1) / 2, -1, 1)))


def run(body, inputs, steps):
    """Steps under inputs; the largest change of size, the largest turn, and what the account lacks, as shares."""
    at_start = body.energy
    stretched = turned = lacking = scale = 0.0
    for _ in range(steps):
        body.step(np.array(inputs, dtype=float))
        stretch, turn = stretch_and_turn(body)
        ledger = body.ledger
        lack = body.energy - at_start - ledger.supplied + ledger.dissipated + ledger.numerical
        scale = max(scale, body.energy, abs(ledger.supplied), ledger.dissipated)
        stretched, turned, lacking = max(stretched, stretch), max(turned, turn), max(lacking, abs(lack))
    return stretched, turned, lacking / scale


@pytest.mark.parametrize("rigid", [FLAT, BENT], ids=["flat", "bent"])
@pytest.mark.parametrize("tool", ["", TOOL], ids=["", "with a tool"])
def test_a_surface_that_turns_far_stays_as_it_is(beam, rigid, tool):
    body = body_of(beam, rigid, tool)
    assert len(body.system.scene.bars) == (3 if rigid == FLAT else 6)
    stretched, turned, lacking = run(body, [0, 0, 40], 40)
    assert turned > 65
    assert stretched <= RIGID
    assert lacking <= ACCOUNT


def test_without_it_the_surface_bends(beam):
    """What the bound above is beside."""
    assert run(body_of(beam, ""), [0, 0, 40], 20)[0] > 1e9 * RIGID


@pytest.mark.parametrize("rigid", [FLAT, BENT], ids=["flat", "bent"])
def test_equilibria_turn_it_as_far(beam, rigid):
    body = body_of(beam, rigid, kind="", h=1.0)
    for force in (10.0, 20.0, 40.0):
        body.step(np.array([0, 0, force]))
    stretched, turned = stretch_and_turn(body)
    assert turned > 45
    assert stretched <= RIGID


@pytest.mark.parametrize("kind", [MOVING, ""], ids=["moving", "resting"])
@pytest.mark.parametrize("rigid", [FLAT, BENT], ids=["flat", "bent"])
def test_small_loads_move_it_as_the_linear_body(beam, kind, rigid):
    """To the first order: a tenth of the load leaves a tenth of the difference, relative to what it moves."""
    differences = []
    for load in (1e-2, 1e-3):
        bodies = [body_of(beam, rigid, kind=kind, h=5e-3 if kind else 1.0, law=law) for law in ("neo_hookean", None)]
        for _ in range(10 if kind else 1):
            for body in bodies:
                body.step(load * np.array([4.0, 1.0, 12.0]))
        large, small = (body.displacement() for body in bodies)
        differences.append(np.abs(large - small).max() / np.abs(small).max())
    assert differences[1] <= 5e-4
    assert 9 < differences[0] / differences[1] < 11


def test_contact_on_it_adds_no_energy(beam):
    """It lands with its rigid surface, rubs, and swings."""
    body = body_of(beam, 'rigid = ["right"]', "friction = { coefficient = 0.3 }\n" + FLOOR)
    touched, at_start = 0, body.energy
    scale = lacking = stretched = 0.0
    for _ in range(40):
        body.step(np.empty(0))
        touched += body.obstacle_forces().any()
        ledger = body.ledger
        scale = max(scale, body.energy, abs(ledger.supplied), ledger.dissipated)
        lacking = max(lacking, abs(body.energy - at_start - ledger.supplied + ledger.dissipated + ledger.numerical))
        stretched = max(stretched, stretch_and_turn(body)[0])
    assert touched > 5
    assert lacking <= 1e-9 * scale  # with forces of contact that are found to 1e-11 in every step
    assert stretched <= 1e-10


def test_a_free_body_keeps_its_momenta(beam):
    body = body_of(beam, BENT, TOOL, head='frame = "moving"\n', clamped="")
    assert body.system.rigid.shape[1] == 6
    run(body, [0.6, 1.0, 4.0], 20)
    before = np.concatenate(body.momentum)
    stretched, turned, _ = run(body, [0, 0, 0], 70)
    assert turned > 60
    assert stretched <= RIGID
    assert np.abs(np.concatenate(body.momentum) - before).max() <= 1e-10 * np.abs(before).max()


@pytest.mark.parametrize("ties", ["", '[effects.springs.bed]\nsurface = "top"\nstiffness = 20.0\n'], ids=["", "tied"])
def test_a_base_that_stands_still_is_a_clamp(beam, ties):
    moving = body_of(beam, BENT, ties, head='frame = "moving"\n')
    held = body_of(beam, BENT, ties)
    for body in (moving, held):
        run(body, [0, 0, 14], 20)
    moved = held.displacement()
    assert np.abs(moving.displacement() - moved).max() <= 1e-9 * np.abs(moved).max()


def test_a_base_carries_it_round(beam):
    """It begins at rest, so that all that moves is supplied."""

    def base(t):
        angle, spin = 6 * t**2, 12 * t
        return BaseState(
            np.zeros(3), np.array([np.cos(angle / 2), 0, np.sin(angle / 2), 0]), np.zeros(3), np.array([0, spin, 0])
        )

    scene = body_of(beam, BENT, head='frame = "moving"\n').system
    body = FullOrderSimulator(scene, 5e-3, scene.scene.environment, signals={"base_path": base})
    stretched, turned, lacking = run(body, [0, 0, 0], 100)
    assert turned > 60
    assert stretched <= RIGID
    assert lacking <= ACCOUNT


def test_a_bar_is_what_its_stroke_changes_by(beam):
    """Its slope is that of the force, and the force in the middle of a step says exactly what s changes by."""
    random = np.random.default_rng(0)
    rest, u, du = random.standard_normal((3, 4, 3))
    bar = RigidBar(rest[[3, 1]], [3, 1], 4)
    assert bar.stroke(0 * u) == 0.0
    assert bar.stroke(u + du) - bar.stroke(u) == pytest.approx((bar.force(u + du / 2) * du).sum(), rel=1e-12)
    np.testing.assert_allclose(bar.jvp(u, du), bar.force(u + du) - bar.force(u), atol=1e-12)
    np.testing.assert_allclose(-bar.stiffness(u) @ du.ravel(), bar.jvp(u, du).ravel(), atol=1e-12)


def test_affine_ties_carry_affine_motions():
    random = np.random.default_rng(1)
    for depth, count in ((1.0, 4), (0.01, 4), (0.0, 3)):
        places = random.standard_normal((9, 3)) * [1, 1, depth] + 5.0
        leading = leaders(places, "here")
        components, leads, weights = affine_ties(places, leading)
        assert len(leading) == count
        moved = places @ random.standard_normal((3, 3)) + random.standard_normal(3)
        np.testing.assert_allclose(weights @ moved.ravel()[leads], moved.ravel()[components], atol=1e-10)


def test_a_surface_that_is_hardly_curved_is_refused():
    places = np.random.default_rng(2).standard_normal((9, 3)) * [1, 1, 1e-4]
    with pytest.raises(SceneError, match=r"here: the surface is flat but for .*mirror image.*use"):
        leaders(places, "here")


@pytest.mark.slow
@pytest.mark.ranks
def test_ranks_agree(beam, tmp_path):
    """On an obstacle, too."""
    large = 'large_deformation = { material = "neo_hookean" }\n'
    text = scene_text(
        beam, supports=f'clamped = ["left"]\n{BENT}', effects=MOVING + large + FLOOR, contacts=PUSH, material=SOFT
    )
    (tmp_path / "scene.toml").write_text(text)
    (tmp_path / "steps.py").write_text(STEPS_ON_RANKS)
    moved = []
    for ranks in (1, 2):
        done = run_ranks(ranks, "steps.py", f"{ranks}.npy", cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        moved.append(np.load(tmp_path / f"{ranks}.npy"))
    assert np.abs(moved[1] - moved[0]).max() <= 1e-10 * np.abs(moved[0]).max()
