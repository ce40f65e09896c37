"""Bodies that nothing holds, or not wholly: which motions strain nothing, in scenes and forms."""

import numpy as np
import pytest
from bodies import assembled, box_arrays, box_surfaces, dense, scene_text, write_arrays
from dolfinx import fem
from forms_on_ranks import RHO, Box

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning
from fenics_rom.fem.linear_stepper import FullOrderStepper
from fenics_rom.fem.mesh import read_mesh
from fenics_rom.fem.nodes import canonical_nodes
from fenics_rom.fem.rigid_modes import rigid_motions
from fenics_rom.scene.file import parse_scene
from fenics_rom.system.body import Unknowns
from fenics_rom.system.rigid_modes import mass_orthonormal, without_energy

LENGTHS, BRICKS = (1.0, 0.4, 0.3), (3, 2, 2)
TIP = {"outputs.tip": "points = [[1.0, 0.4, 0.3]]"}


def box(folder, degree=1, **parts):
    """A box that nothing holds."""
    points, cells = box_arrays(LENGTHS, BRICKS, shake=0.2)
    mesh = write_arrays(folder / "box.msh", points, cells)
    return assembled(mesh, degree=degree, supports=None, **TIP, **parts)


def held_at(system, nodes):
    """The same body with some of its nodes held, as its rows and columns say; its rigid motions by the definition."""
    canonical = canonical_nodes(read_mesh(system.scene.mesh_file, {}), system.scene.degree)
    moves = np.ones((len(system.body.nodes), 3), dtype=bool)
    moves[nodes] = False
    motions = rigid_motions(canonical, system.body.node_mass, Unknowns(moves.size, np.flatnonzero(moves)))
    left = moves.ravel()
    M, K = (dense(A, system.size)[np.ix_(left, left)] for A in (system.mass, system.stiffness))
    return M, K, motions


def energy_share(K, motions):
    """Largest strain energy of unit motions, as a share of that of any unit vector."""
    return np.abs(np.diag(motions.T @ K @ motions)).max() / np.trace(K) * len(K)


@pytest.mark.parametrize("degree", [1, 2])
def test_free_box_has_six_motions_that_strain_nothing(tmp_path, degree):
    system = box(tmp_path, degree=degree)
    R, K = system.rigid, system.stiffness
    assert R.shape == (system.size, 6)
    assert system.warnings == ()
    assert np.abs(R.T @ (system.mass @ R) - np.eye(6)).max() <= 1e-14
    assert np.abs(K @ R).max() <= 1e-13 * np.abs(dense(K, system.size)).max() * np.abs(R).max()
    λ = np.linalg.eigvalsh(dense(K, system.size))
    assert λ[6] > 1e6 * np.abs(λ[:6]).max()  # and there are no others
    shift = np.tile([1.0, -2.0, 0.5], len(system.body.nodes))[:, None]
    spin = np.cross([0.3, 0.1, -0.2], system.body.nodes).reshape(-1, 1)
    for motion in (shift, spin):  # all of them are among them
        rest = motion - R @ (R.T @ (system.mass @ motion))
        assert np.abs(rest).max() <= 1e-13 * np.abs(motion).max()


@pytest.mark.parametrize(("nodes", "count"), [([], 6), ([0], 3), ([0, 8], 1), ([0, 1, 2], 1), ([0, 2, 6], 0)])
def test_clamped_nodes_leave_what_turns_about_them(tmp_path, nodes, count):
    """A point leaves three rotations; two, or three in a line, leave one; three that are not, none."""
    M, K, motions = held_at(box(tmp_path), nodes)
    assert motions.shape == (len(M), count)
    λ = np.linalg.eigvalsh(K)
    assert (λ > 1e-10 * λ[-1]).sum() == len(K) - count
    if count:
        assert energy_share(K, motions / np.linalg.norm(motions, axis=0)) <= 1e-14


def test_part_that_is_not_held_moves_beside_one_that_is(tmp_path):
    points, cells = box_arrays(LENGTHS, (2, 1, 1))
    both = np.concatenate([points, points + np.array([0, 2, 0])]), np.concatenate([cells, cells + len(points)])
    mesh = write_arrays(tmp_path / "island.msh", *both, box_surfaces(points, cells))
    for degree in (1, 2):
        system = assembled(mesh, degree=degree)
        assert system.rigid.shape[1] == 6
        assert system.warnings == ("supports leave 6 rigid motions: the body, or a part of it, is not wholly held",)
        motions = np.zeros((3 * len(system.body.nodes), 6))
        motions[system.body.free] = system.rigid
        moving = np.abs(motions.reshape(-1, 18)).max(axis=1) > 0
        np.testing.assert_array_equal(moving, system.body.nodes[:, 1] > 1)
    free = assembled(mesh, supports=None)
    assert free.rigid.shape[1] == 12
    with pytest.warns(FenicsRomWarning, match="6 rigid motions"):
        rom = fr.reduce(system, order=8)
    assert {mode.order for mode in rom.contact_models.values()} == {14}
    assert {mode.rigid for mode in fr.reduce(free, order=8).contact_models.values()} == {12}


def test_springs_to_the_ground_take_motions(tmp_path):
    """Springs at two nodes of an edge of the box, in all directions, leave the rotation about it."""
    system = box(tmp_path)
    K = dense(system.stiffness, system.size)
    spring = 1e-3 * K.max()
    for node in (0, 2):
        K[3 * node : 3 * node + 3, 3 * node : 3 * node + 3] += spring * np.eye(3)
    left = without_energy(system.mass, K, system.rigid, system.algebra)
    assert left.shape[1] == 1
    assert np.abs(K @ left).max() <= 1e-13 * K.max() * np.abs(left).max()
    axis = system.body.nodes[2] - system.body.nodes[0]
    about = np.cross(axis, system.body.nodes - system.body.nodes[0]).reshape(-1, 1)
    turn = mass_orthonormal(system.mass, about, system.algebra)
    assert abs((turn.T @ (system.mass @ left)).item()) == pytest.approx(1.0, abs=1e-12)
    K += 1e-6 * K.max() * np.eye(len(K))
    assert without_energy(system.mass, K, system.rigid, system.algebra).shape[1] == 0


def test_held_box_has_none(box_system):
    assert box_system.rigid.shape == (box_system.size, 0)
    assert box_system.elastic_size == box_system.size


def test_forms_of_a_free_box_give_the_same_model(tmp_path):
    mesh = write_arrays(tmp_path / "box.msh", *box_arrays(LENGTHS, BRICKS))
    forms = Box(mesh, 1).system(bcs=[], rayleigh=(0.0, 1e-3))
    scene = fr.assemble(parse_scene(scene_text(mesh, supports=None, damping="beta = 1e-3")))
    assert forms.rigid.shape == scene.rigid.shape
    shared = forms.rigid.T @ (scene.mass @ scene.rigid)
    np.testing.assert_allclose(shared @ shared.T, np.eye(6), atol=1e-12)
    one, other = (fr.reduce(system, order=10) for system in (forms, scene))
    for name in one.contact_models:
        np.testing.assert_allclose(
            one.contact_models[name].eigenvalues, other.contact_models[name].eigenvalues, rtol=1e-8
        )
        np.testing.assert_allclose(
            one.contact_models[name].hankel_singular_values[:10],
            other.contact_models[name].hankel_singular_values[:10],
            rtol=1e-8,
        )


@pytest.mark.parametrize("degree", [1, 2])
def test_forms_of_a_body_on_a_hinge(tmp_path, degree):
    """Held along an edge, it turns about it under a force, as an angular momentum says, and no further."""
    box = Box(write_arrays(tmp_path / "box.msh", *box_arrays(LENGTHS, BRICKS)), degree)
    edge = fem.locate_dofs_geometrical(box.space, lambda x: np.isclose(x[0], 0) & np.isclose(x[2], 0))
    system = box.system(bcs=[fem.dirichletbc(np.zeros(3), edge, box.space)], rayleigh=(0.0, 1e-3))
    assert system.rigid.shape[1] == 1
    about = np.cross([0.0, 1.0, 0.0], system.body.nodes).ravel()[system.body.free, None]
    inertia = (about.T @ (system.mass @ about)).item()
    assert inertia == pytest.approx(RHO * np.prod(LENGTHS) * (LENGTHS[0] ** 2 + LENGTHS[2] ** 2) / 3, rel=1e-12)
    assert np.abs(np.sqrt(inertia) * np.abs(system.rigid) - np.abs(about)).max() <= 1e-12
    body = fr.Simulator(fr.reduce(system, order=10), dt=1e-3)
    for _ in range(100):
        body.step([0.0, 0.0, 1e-3])
    assert abs(body.state[1][0]) == pytest.approx(1e-3 * LENGTHS[0] * 0.1 / np.sqrt(inertia), rel=1e-10)


def test_full_order_runs_fall_and_spin(tmp_path):
    """Under its weight the body follows the parabola; its momenta stay as they are without a force."""
    system = box(tmp_path, damping="beta = 1e-3")
    down = np.tile([0.0, 0.0, -9.81], len(system.body.nodes))[:, None]
    full, weight = FullOrderStepper(system, 0.01), system.mass @ down
    for _ in range(100):
        full.step_under(weight @ np.ones(1))
    fallen = full.displacement()
    assert np.abs(fallen - [0.0, 0.0, -9.81 / 2]).max() <= 2e-11
    full.close()
    random = np.random.default_rng(0).standard_normal((2, system.size))
    full = FullOrderStepper(system, 1e-3)
    full.set_state(*random)
    momenta = system.rigid.T @ (system.mass @ full.v)
    for _ in range(100):
        full.step_under(weight @ np.zeros(1))
    assert np.abs(system.rigid.T @ (system.mass @ full.v) - momenta).max() <= 1e-10 * np.abs(momenta).max()
    account = full.ledger
    start = (random[1] @ (system.mass @ random[1:].T) + random[0] @ (system.stiffness @ random[:1].T)).item() / 2
    assert abs(full.energy - start + account.dissipated) <= 1e-12 * start
    full.close()


def test_scene_of_a_free_body_runs_reduced_as_at_full_order(tmp_path):
    """Pushed, and then free to go; also from what a killed reduction left."""
    run = "dt = 0.002\nduration = 0.4\nload = [{ contact = 'top', stop = 0.1, force = [0.5, 0.0, -1.0] }]"
    system = box(tmp_path, run=run, damping="alpha = 0.1, beta = 1e-3")
    whole = fr.reduce(system, order=80, checkpoint=tmp_path / "kept")
    rom = fr.reduce(system, order=80, checkpoint=tmp_path / "kept", resume=True)
    np.testing.assert_allclose(rom.stiffness, whole.stiffness, rtol=1e-12)
    reduced, full = fr.simulate(rom), fr.simulate(system)
    differences = fr.compare(reduced, full)
    assert max(difference.relative for difference in differences.values()) <= 1e-6
    assert max(reduced.balance_error, full.balance_error) <= 1e-12
    assert np.abs(full.outputs["tip"][-1]).max() > 1e-5
