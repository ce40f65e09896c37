"""Where runs begin: in equilibrium, where another run was, displaced and thrown; reduced and at full order."""

import numpy as np
import pytest
from bodies import box_arrays, scene_text, write_arrays

import fenics_rom as fr
from fenics_rom.errors import FenicsRomError, FenicsRomWarning, StepError
from fenics_rom.scene.file import parse_scene

LENGTHS = (1.0, 0.4, 0.3)
GRAVITY = "inertia = {}\ndamping = { alpha = 1.0, beta = 1e-3 }\ngravity = { acceleration = [0, 0, -9.81] }"
PULL = '[[run.load]]\ncontact = "right"\nforce = [0.0, 5.0, 0.0]\n'
NO_PULL = PULL.replace("5.0", "0.0")
BETA = "inertia = {}\ndamping = { beta = 1e-3 }"
EPS = np.finfo(float).eps


@pytest.fixture(scope="module")
def mesh(tmp_path_factory):
    return write_arrays(tmp_path_factory.mktemp("box") / "box.msh", *box_arrays(LENGTHS, (4, 2, 2), shake=0.2))


def scene(mesh, initial, run="dt = 1e-3\nduration = 0.02\nsnapshots = 20", load="", **parts):
    body = f"{run}\n{load}[run.initial]\n{initial}\n"
    return parse_scene(scene_text(mesh, run=body, **parts), folder=mesh.parent)


def runs(asked, order=60):
    """At full order, and of a ROM that went through a file."""
    system = fr.assemble(asked)
    file = asked.mesh_file.with_name("rom.h5")
    fr.write_rom(file, fr.reduce(system, order=order))
    return fr.simulate(system), fr.simulate(fr.read_rom(file))


def test_body_that_begins_in_equilibrium_stays_there(mesh):
    for run in runs(scene(mesh, 'shape = "equilibrium"', load=PULL, effects=GRAVITY)):
        sag = np.abs(run.snapshots[0]).max()
        assert sag > 1e-4
        # the start is solved for with a condition of K of 1e5, and moves by what that leaves
        assert np.abs(run.snapshots - run.snapshots[0]).max() <= 1e-9 * sag
        assert run.energy[0] > 0
        assert run.balance_error <= 1e-11


def test_body_that_lies_on_something_in_equilibrium_stays_there(mesh):
    """With what its contact points yield beyond the basis, without which they would begin in the floor."""
    stands = '[effects.contact.obstacles.floor]\nshape = "half-space"\npoint = [0, 0, -1e-5]\nnormal = [0, 0, 1]\n'
    parts = {"effects": f"{GRAVITY}\n{stands}", "contacts": '[contacts.bottom]\nsurface = "bottom"\n'}
    full, reduced = runs(scene(mesh, 'shape = "equilibrium"', **parts), order=12)
    for run in (full, reduced):
        force = run.forces["floor"][1:]
        assert np.abs(force - force[0]).max() <= 1e-9 * np.abs(force[0]).max()
        assert np.abs(run.snapshots - run.snapshots[0]).max() <= 1e-9 * np.abs(run.snapshots[0]).max()
        assert run.balance_error <= 1e-11
    assert reduced.forces["floor"][1, 2] == pytest.approx(full.forces["floor"][1, 2], rel=0.02)


@pytest.mark.parametrize("stepper", ["newton", "linearly-implicit"])
def test_large_equilibrium_stays_too(mesh, stepper):
    effects = GRAVITY + "\nlarge_deformation = {}"
    system = fr.assemble(scene(mesh, 'shape = "equilibrium"', load=PULL.replace("5.0", "60.0"), effects=effects))
    rom = fr.reduce(system, order=6, method="modal+derivatives")
    for run in (fr.simulate(system), fr.simulate(rom, stepper=stepper)):
        sag = np.abs(run.snapshots[0]).max()
        assert sag > 0.05
        assert np.abs(run.snapshots - run.snapshots[0]).max() <= 1e-6 * sag  # to Newton's tolerance


def test_run_goes_on_where_another_one_was(mesh):
    whole, _ = runs(scene(mesh, 'shape = "rest"', run="dt = 1e-3\nduration = 0.04\nsnapshots = 40", load=PULL))
    fr.write_trajectory(mesh.with_name("first.h5"), whole)
    full, reduced = runs(scene(mesh, 'trajectory = "first.h5"\ntime = 0.02', load=PULL))
    size = np.abs(whole.snapshots).max()
    assert np.abs(full.snapshots - whole.snapshots[20:]).max() <= 1e4 * EPS * size
    assert fr.compare(reduced, full)["shape"].relative <= 1e-5  # of order 60


@pytest.mark.parametrize("spin", [(0.0, 0.0, 0.0), (0.0, 0.2, 0.1)])
def test_free_body_flies_and_turns_as_it_was_thrown(mesh, spin):
    """Nothing acts: p(t) = p(0) + v t, to round-off of the steps."""
    initial = f"translation = [0.0, 0.0, 0.5]\nvelocity = [1.0, 0.0, 0.0]\nspin = {list(spin)}"
    asked = scene(mesh, initial, supports=None, effects=BETA, load=NO_PULL)
    for run in runs(asked, order=12):
        centre = run.node_mass @ run.nodes / run.node_mass.sum()
        speed = np.array([1.0, 0.0, 0.0]) + np.cross(spin, run.nodes - centre)
        expected = np.array([0.0, 0.0, 0.5]) + run.snapshot_times[:, None, None] * speed
        assert np.abs(run.snapshots - expected).max() <= 1e-12
        assert run.energy[0] == pytest.approx(0.5 * run.node_mass @ np.square(speed).sum(axis=1), rel=1e-2)
        assert np.ptp(run.energy) <= 1e-12 * run.energy[0]


def test_drop_hits_the_ground_when_newton_says(mesh):
    """Thrown down with 1 m/s from a height of 0.05 m: (√(v² + 2 g h) - v)/g."""
    asked = scene(
        mesh,
        "translation = [0.0, 0.0, 0.05]\nvelocity = [0.0, 0.0, -1.0]",
        run="dt = 1e-4\nduration = 0.06",
        supports=None,
        contacts='[contacts.bottom]\nsurface = "bottom"',
        effects="inertia = {}\ndamping = { beta = 1e-3 }\ngravity = { acceleration = [0, 0, -9.81] }",
        **{"effects.contact.obstacles.ground": 'shape = "half-space"\npoint = [0, 0, 0]\nnormal = [0, 0, 1]'},
    )
    due = (np.sqrt(1.0 + 2 * 9.81 * 0.05) - 1.0) / 9.81
    for run in runs(asked, order=20):
        touched = run.times[np.flatnonzero(run.forces["ground"][:, 2] > 0)[0]]
        assert abs(touched - due) <= 1.5e-4
        assert run.balance_error <= 1e-12


@pytest.mark.parametrize(
    ("initial", "message"),
    [
        ("velocity = [1, 0]", r"run.initial.velocity is a list of 2"),
        ("rotation = [0, 0, 0.5]", r"run.initial.rotation\[2\] = 0.5: use .*0.1"),
        ("time = 0.1", "run.initial.time: goes with run.initial.trajectory"),
        ('trajectory = "none.h5"', "run.initial.trajectory: .*none.h5"),
        ('trajectory = "none.h5"\nshape = "equilibrium"', "run.initial: give shape or trajectory, not both"),
        ('shape = "sagging"', "no choice 'sagging'"),
    ],
)
def test_start_that_cannot_be_is_refused(mesh, initial, message):
    with pytest.raises(FenicsRomError, match=message):
        scene(mesh, initial)


def test_instant_that_is_no_snapshot_and_other_meshes_are_refused(mesh, tmp_path):
    run, _ = runs(scene(mesh, 'shape = "rest"', load=PULL))
    fr.write_trajectory(mesh.with_name("run.h5"), run)
    with pytest.raises(FenicsRomError, match=r"run.initial.time = 0.0105: .* the nearest is at 0.01"):
        scene(mesh, 'trajectory = "run.h5"\ntime = 0.0105')
    fr.write_trajectory(tmp_path / "run.h5", run)
    other = write_arrays(tmp_path / "box.msh", *box_arrays(LENGTHS, (3, 2, 2)))
    with pytest.raises(FenicsRomError, match=r"is of a mesh of .* nodes, and the body has another one"):
        fr.simulate(scene(other, 'trajectory = "run.h5"', load=PULL))


def test_equilibrium_of_a_free_body_and_a_throw_of_a_held_one_are_told(mesh):
    free = scene(mesh, 'shape = "equilibrium"', supports=None, load=PULL)
    system = fr.assemble(free)
    for model in (system, fr.reduce(system, order=4)):
        with pytest.raises(FenicsRomError, match="use a body that supports or springs hold"):
            fr.simulate(model)
    full, reduced = runs(scene(mesh, "velocity = [1e-3, 0.0, 0.0]", load=PULL))
    for run in (full, reduced):
        assert any("initial velocity: 0." in message for message in run.warnings)
    held = fr.assemble(scene(mesh, "translation = [0.0, 0.0, 1e-3]", load=PULL))
    for model in (held, fr.reduce(held, order=4)):
        with pytest.raises(FenicsRomError, match=r"run.initial.translation: use a body that nothing holds"):
            fr.simulate(model)


def test_shape_is_set_by_projection_and_told_what_is_lost(mesh):
    rom = fr.reduce(fr.assemble(scene(mesh, 'shape = "rest"', load=PULL)), order=10)
    body, other = fr.Simulator(rom, 1e-3), fr.Simulator(rom, 1e-3)
    for _ in range(20):
        body.step([0.0, 5.0, 0.0])
    lost = other.set_shape(body.displacement(), body.velocity())
    assert set(lost) == {"displacement", "velocity"}
    assert max(lost.values()) <= 1e-12  # it is in the basis
    for mine, its in zip(other.state, body.state, strict=True):
        np.testing.assert_allclose(mine, its, atol=1e-11 * np.abs(its).max())
    assert other.energy == pytest.approx(body.energy, rel=1e-9)
    noise = np.random.default_rng(0).normal(size=rom.nodes.shape) * np.abs(body.displacement()).max()
    with pytest.warns(FenicsRomWarning, match="initial displacement: 0.[0-9]+ of it"):
        assert other.set_shape(5 * body.displacement() + 0.3 * noise)["displacement"] > 0.01
    assert not other.state[1].any()
    kept = other.state
    with pytest.raises(FenicsRomError, match="% of it"):
        other.set_shape(noise)
    with pytest.raises(StepError, match="displacement: use a finite array of shape"):
        other.set_shape(noise[:3])
    for mine, its in zip(other.state, kept, strict=True):
        np.testing.assert_array_equal(mine, its)
