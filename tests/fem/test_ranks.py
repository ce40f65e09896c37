"""The same files and the same errors on any number of ranks."""

import json
from pathlib import Path

import numpy as np
import pytest
from bodies import PLATE, box_arrays, scene_text, write_arrays
from bricks import msh, shaken_bricks, write_bricks
from ranks import run_ranks
from test_prisms import row

import fenics_rom as fr
from fenics_rom.reduction.krylov import SPACE_ACCURACY
from fenics_rom.reduction.reduce import DENSE_LIMIT

EFFECTS = """
[effects.gravity]
acceleration = [0, 0, -9.81]
[effects.springs.bed]
surface = "front"
stiffness = 50.0
[effects.prescribed.push]
surface = "right"
force = [0.0, 2.0, 0.0]
[effects.prescribed.poke]
point = [0.7, 0.1, 0.3]
force = [0.0, 0.0, -5.0]
[effects.pressure.air]
surface = "top"
[effects.tendon.rope]
points = [[0.0, 0.0, 0.3], [0.5, 0.2, 0.3], [1.0, 0.4, 0.3]]
[effects.contact.obstacles.floor]
shape = "half-space"
point = [0, 0, -1e-3]
normal = [0, 0, 1]
[effects.contact.obstacles.ball]
shape = "sphere"
center = [1.301, 0.4, 0.3]
radius = 0.3
table = "ball.csv"
"""
READINGS = {
    "readings.rope": 'quantity = "length"\nof = "rope"',
    "readings.sole": 'quantity = "contact_pressure"\nof = "bottom"',
    "readings.stress": 'quantity = "von_mises_stress"',
    "readings.strain": 'quantity = "strain"\nany = ["top", { box = { corners = [[0.5, 0, 0], [1, 1, 0.2]] } }]',
    "readings.held": 'quantity = "reaction"\nsurface = "left"',
    "readings.corner": 'quantity = "stress"\npoints = [[0.5, 0.2, 0.15], [0.4, 0.4, 0.3]]',
}
MOVING = """inertia = {}
[effects.damping]
alpha = 1.0
beta = 1e-3
materials.material = { alpha = 2.0, beta = 2e-3 }
[effects.damping.dashpots.oil]
surface = "right"
coefficient = 3.0
[effects.base_motion.quake]
direction = [0, 1, 0]
acceleration = 0.5
[effects.friction]
coefficient = 0.05
"""  # With 0.2, points between floor and ball have a step in which a whole line of forces fulfils Coulomb's law.
FALLING = """inertia = {}
gravity = { acceleration = [0, 0, -9.81] }
friction = { coefficient = 0.3 }
contact.obstacles.floor = { shape = "half-space", point = [0, 0, -0.02], normal = [0, 0, 1] }
"""
ROLLERS = """
[[supports.held]]
surface = "left"
normal = [3.0, 0.5, 1.0]
[[supports.held]]
surface = "back"
normal = [0, 1, 0]
[[supports.held]]
point = [0, 0, 0]
"""
ACTING = """dt = 0.005
duration = 0.2
snapshots = 10
load = [{ actuator = "air", force = [50.0] }, { actuator = "rope", start = 0.05, force = [3.0] }]"""
RUN = 'dt = 0.01\nduration = 0.25\nload = [{ contact = "middle", stop = 0.15, force = [0.0, 0.1, 0.5] }]'
TIP = {"outputs.tip": "points = [[0.9, 0.2, 0.1]]", "reduction": "order = 12"}
pytestmark = pytest.mark.ranks
FOUR = pytest.param(4, marks=pytest.mark.slow)
SHORT = ("plate", "plate-krylov", "beam", "free-krylov", "run", "effects", "effects-run", "landing-run")


def on_ranks(*names):
    """A test of these on two ranks, and of those that are short on four. What is not short needs --all, as four do."""
    two = [pytest.param(name, 2, marks=() if name in SHORT else pytest.mark.slow) for name in names]
    four = [pytest.param(name, 4, marks=pytest.mark.slow) for name in names if name in SHORT]
    return pytest.mark.parametrize(("name", "ranks"), two + four)


def write_scenes(folder):
    """The plate; a box and a beam of degree 2, the beam too large for dense routes; curved cells of all shapes."""
    (folder / "row.msh").write_text(msh(*row("serendipity")))
    write_bricks(folder / "bricks.msh", *shaken_bricks((1.0, 0.4, 0.3), (3, 2, 2), 20))
    plate = PLATE.read_text().replace("../../meshes", str(PLATE.parent.parent.parent / "meshes"))
    (folder / "plate.toml").write_text(plate[: plate.index("[run]")] + "[run]\n" + RUN)
    for name, bricks in {"box": (3, 1, 1), "beam": (7, 2, 2)}.items():
        mesh = write_arrays(folder / f"{name}.msh", *box_arrays((1.0, 0.4, 0.3), bricks, shake=0.2))
        (folder / f"{name}.toml").write_text(scene_text(mesh, degree=2, **TIP))
    patches = [f"[contacts.c{k}]\nnear = {{point = [{k / 10}, 0.2, 0.3], radius = 0.15}}" for k in range(1, 11)]
    (folder / "many.toml").write_text(scene_text(folder / "beam.msh", degree=2, contacts="\n".join(patches), **TIP))
    spun = "dt = 0.01\nduration = 0.2\nsnapshots = 2\ninitial = { spin = [1.0, 2.0, 3.0] }"
    free = scene_text(folder / "box.msh", degree=2, supports=None, run=spun, **TIP)
    (folder / "free.toml").write_text('frame = "moving"\n' + free)
    bottom = {"contacts": '[contacts.bottom]\nsurface = "bottom"\n[contacts.right]\nsurface = "right"'}
    fallen = scene_text(folder / "box.msh", supports=None, effects=FALLING, run=spun, **bottom, **TIP)
    (folder / "landing.toml").write_text('frame = "moving"\n' + fallen)
    slow = free.replace("[1.0, 2.0, 3.0]", "[0.1, 0.2, 0.3]")  # by small angles, as a fixed frame allows
    (folder / "floating.toml").write_text(slow)
    for name, effects in {"effects": MOVING + EFFECTS, "still": EFFECTS}.items():
        parts = {"effects": effects, "run": ACTING, "outputs.tip": TIP["outputs.tip"]} | READINGS
        parts |= {"supports": 'clamped = ["left"]' + ('\nrigid = ["right"]' if name == "effects" else "")}
        (folder / f"{name}.toml").write_text(scene_text(folder / "box.msh", **bottom, **parts))
    parts |= {"effects": MOVING + EFFECTS, "supports": None}
    (folder / "rolling.toml").write_text(ROLLERS + scene_text(folder / "box.msh", **bottom, **parts))
    (folder / "ball.csv").write_text("time,x,y,z\n0,0,0,0\n0.12,-0.02,0.0,0.0\n0.2,0.01,0.0,0.0\n")
    (folder / "missing.toml").write_text(scene_text(folder / "none.msh"))


@pytest.fixture(scope="module")
def results(request, tmp_path_factory):
    """Folder of what 1, 2 and, with --all, 4 ranks made of the same scenes; 4, or without it, some of it."""
    folder, slow = tmp_path_factory.mktemp("ranks"), request.config.getoption("--all")
    write_scenes(folder)
    for ranks in (1, 2, 4) if slow else (1, 2):
        made = folder / str(ranks)
        made.mkdir()
        script, names = Path(__file__).with_name("on_ranks.py"), () if slow and ranks < 4 else SHORT
        done = run_ranks(ranks, script, folder, made, *names, path=script.parents[1])
        assert done.returncode == 0, done.stdout + done.stderr
    return folder


def checks(results, ranks):
    return json.loads((results / str(ranks) / "checks.json").read_text())


def transfer(rom, name, ω):
    """C W (-ω² + iω d + γ)⁻¹ G over all nodes."""
    mode = rom.contact_models[name]
    response = mode.inputs / (-(ω**2) + 1j * ω * mode.damping + mode.eigenvalues)[:, None]
    return rom.basis @ (mode.coordinates @ response)


@on_ranks("plate", "plate-krylov", "plate-adi", "box", "beam", "beam-modal", "beam-static", "many")
def test_roms_do_not_depend_on_the_number_of_ranks(results, name, ranks):
    one, other = (fr.read_rom(results / str(n) / f"{name}.h5") for n in (1, ranks))
    assert (len(one.free) > DENSE_LIMIT) is name.startswith(("beam", "many"))
    for field in ("nodes", "triangles", "free"):
        np.testing.assert_array_equal(getattr(one, field), getattr(other, field))
    np.testing.assert_allclose(one.node_mass, other.node_mass, rtol=1e-12)
    for contact, mode in one.contact_models.items():
        σ, σ_other = mode.hankel_singular_values, other.contact_models[contact].hankel_singular_values
        count = min(len(σ), mode.order, 12)
        np.testing.assert_allclose(σ_other[:count], σ[:count], rtol=1e-8)
        assert other.contact_models[contact].order == mode.order
        own = np.sqrt(mode.eigenvalues[:6])
        # at a resonance H multiplies the round-off in γ, which is eps times the condition of K, by the quality factor
        for ω in (0.0, *(own[:-1] + own[1:]) / 2):
            H = transfer(one, contact, ω)
            assert np.abs(transfer(other, contact, ω) - H).max() <= 2e-8 * np.abs(H).max(), (contact, ω)


@on_ranks("free", "free-krylov", "free-iterative")
def test_free_bodies_do_not_depend_on_the_number_of_ranks(results, name, ranks):
    # what frames have of shapes is of first order in the error of their space, unlike σ
    alike, moved = (100 * SPACE_ACCURACY, 1e-6) if name == "free-iterative" else (1e-8, 1e-10)
    one, other = (fr.read_rom(results / str(n) / f"{name}.h5") for n in (1, ranks))
    np.testing.assert_allclose(np.abs(other.basis[:, :6]), np.abs(one.basis[:, :6]), rtol=0, atol=1e-12)
    frames = [rom.moving_frame for rom in (one, other)]
    for name in ("origin", "mass", "inertia0"):
        np.testing.assert_allclose(*(getattr(frame, name) for frame in frames), rtol=1e-12, atol=1e-13)
    for name in ("inertia2", "coupling", "stiffening"):  # of vectors that have signs
        ours, others = (np.sort(np.linalg.norm(getattr(frame, name), axis=(1, 2))) for frame in frames)
        np.testing.assert_allclose(others, ours, rtol=alike)
    bodies = [fr.Simulator(rom, dt=1e-3) for rom in (one, other)]
    for body in bodies:
        for step in range(100):
            body.switch(("right", "top")[step // 10 % 2])
            body.step([1e-3, 2e-3, -1e-3])
    shapes = [body.displacement() for body in bodies]
    places = 10 * np.finfo(float).eps * np.abs(one.nodes).max()  # whose round-off displacements in the world have
    assert np.abs(shapes[1] - shapes[0]).max() <= moved * np.abs(shapes[0]).max() + places


@pytest.mark.slow
def test_free_bodies_of_a_fixed_frame_do_not_depend_on_the_number_of_ranks(results):
    """Rigid motions and all: ROMs step alike, and as their full order runs."""
    one, other = (fr.read_rom(results / str(n) / "floating.h5") for n in (1, 2))
    assert one.rigid == other.rigid == 6
    runs = [fr.simulate(rom) for rom in (one, other)]
    scale = np.abs(runs[0].snapshots).max()
    assert np.abs(runs[1].snapshots - runs[0].snapshots).max() <= 1e-10 * scale
    full = fr.read_trajectory(results / "2" / "floating-run.h5")
    assert np.abs(full.snapshots - runs[0].snapshots).max() <= 1e-3 * scale


@on_ranks("run", "free-run", "landing-run", "floating-run")
def test_full_runs_do_not_depend_on_the_number_of_ranks(results, ranks, name):
    one, other = (fr.read_trajectory(results / str(n) / f"{name}.h5") for n in (1, ranks))
    scale = np.abs(one.snapshots).max()
    assert scale > 1e-3
    assert np.abs(other.snapshots - one.snapshots).max() <= 2e-9 * scale
    assert np.abs(other.outputs["tip"] - one.outputs["tip"]).max() <= 2e-9 * scale
    assert np.abs(other.energy - one.energy).max() <= 1e-9 * one.energy.max()
    assert max(one.balance_error, other.balance_error) <= 1e-12


@on_ranks("effects", "still", "rolling")
def test_effects_do_not_depend_on_the_number_of_ranks(results, name, ranks):
    """Full runs and runs of ROMs among obstacles, under all loads; with inertia and without."""
    full = [fr.read_trajectory(results / str(n) / f"{name}-run.h5") for n in (1, ranks)]
    roms = [fr.read_rom(results / str(n) / f"{name}.h5") for n in (1, ranks)]
    one, other = (rom.residual_compliance for rom in roms)
    change = other.factor @ other.factor.T - one.factor @ one.factor.T
    assert np.abs(change).max() <= 2 * one.floor == pytest.approx(2 * other.floor, rel=1e-6)
    # Where the shared basis holds all shapes what is left is round-off: of no time that any step of 1e-5 s could see.
    longest = [rom.time_constants.max(initial=0.0) for rom in (one, other)]
    np.testing.assert_allclose(*longest, rtol=1e-6, atol=1e-7)
    for one, other in (full, [fr.simulate(rom) for rom in roms]):
        scale = np.abs(one.snapshots).max()
        assert scale > 1e-3
        assert np.abs(other.snapshots - one.snapshots).max() <= 1e-9 * scale
        assert np.abs(other.energy - one.energy).max() <= 1e-9 * one.energy.max()
        np.testing.assert_array_equal(other.contact, one.contact)
        assert list(one.forces) == ["floor", "ball"]
        for obstacle, force in one.forces.items():
            assert np.abs(force).max() > 0.1
            assert np.abs(other.forces[obstacle] - force).max() <= 1e-7 * np.abs(force).max()
        for reading, kept in one.readings.items():
            moved = np.abs(kept.values - kept.values[0]).max()
            assert moved > 0
            assert np.abs(other.readings[reading].values - kept.values).max() <= 1e-7 * moved, reading
        assert max(one.balance_error, other.balance_error) <= 1e-12


@pytest.mark.parametrize("ranks", [1, 2, FOUR])
def test_canonical_nodes_are_where_dolfinx_has_them(results, ranks):
    for rank in checks(results, ranks):
        assert max(rank["nodes"]) <= 1e-14


@pytest.mark.parametrize("ranks", [1, 2, FOUR])
def test_matrices_and_eigenvectors_hold_on_all_ranks(results, ranks):
    reference = checks(results, 1)[0]["eigenvalues"]
    for rank in checks(results, ranks):
        assert rank["symmetric"]
        assert rank["orthonormality"] <= 1e-11
        assert rank["residual"] <= 1e-9
        np.testing.assert_allclose(rank["eigenvalues"], reference, rtol=1e-9)


@pytest.mark.parametrize("ranks", [1, 2, FOUR])
@pytest.mark.parametrize("failure", ["indefinite", "singular", "shifted"])
def test_factor_that_fails_fails_on_every_rank(results, ranks, failure):
    for rank in checks(results, ranks):
        kind, message = rank[failure]
        assert kind == "SolverError"
        assert "is it symmetric positive definite" in message


@pytest.mark.parametrize("ranks", [1, 2, FOUR])
def test_error_of_rank_0_is_raised_on_every_rank(results, ranks):
    seen = [rank["missing"] for rank in checks(results, ranks)]
    assert len(seen) == ranks
    assert all(one == ["MeshError", seen[0][1]] for one in seen)
    assert "none.msh: not found" in seen[0][1]
