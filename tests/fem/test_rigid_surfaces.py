"""Surfaces that move as rigid bodies do, and the six columns that push and turn them: against dense algebra."""

import numpy as np
import pytest
import scipy.linalg
from bodies import box_arrays, dense, scene_text, write_arrays

import fenics_rom as fr
from fenics_rom.scene.file import parse_scene

RIGID = 'clamped = ["left"]\nrigid = ["right"]'
WRENCH = '[contacts.right]\nsurface = "right"\nforce = "wrench"\n[contacts.top]\nsurface = "top"'


def text_of(folder, supports=RIGID, degree=1, **parts):
    mesh = write_arrays(folder / "box.msh", *box_arrays((1.0, 0.4, 0.3), (4, 2, 2), shake=0.2))
    return scene_text(mesh, supports=supports, degree=degree, **({"contacts": WRENCH} | parts))


def body(folder, *given, **parts):
    return fr.assemble(parse_scene(text_of(folder, *given, **parts)))


def rigid_motions(places, middle):
    """(3 s, 6) of nodes: translations, then rotations about the middle."""
    arms = places - middle
    turns = np.stack([np.cross(axis, arms) for axis in np.eye(3)], axis=2)
    return np.concatenate([np.broadcast_to(np.eye(3), turns.shape), turns], axis=2).reshape(-1, 6)


@pytest.mark.parametrize("degree", [1, 2])
def test_a_rigid_surface_is_six_unknowns(tmp_path, degree):
    """Frequencies, and the answer to forces and moments, are those of a basis that has the six motions as columns."""
    held, rigid = body(tmp_path, 'clamped = ["left"]', degree), body(tmp_path, degree=degree)
    nodes, free = held.body.nodes, held.body.free
    face = np.flatnonzero(nodes[:, 0] > 1 - 1e-9)
    on_face = np.isin(free // 3, face)
    middle = np.array([1.0, 0.2, 0.15])
    Z = np.zeros((len(free), rigid.size))
    Z[np.flatnonzero(~on_face), np.arange(rigid.size - 6)] = 1.0
    Z[on_face, -6:] = rigid_motions(nodes[face], middle)
    assert rigid.size == held.size - 3 * len(face) + 6
    K, M = (Z.T @ dense(A, held.size) @ Z for A in (held.stiffness, held.mass))
    K_given, M_given = (dense(A, rigid.size) for A in (rigid.stiffness, rigid.mass))
    λ, λ_given = (scipy.linalg.eigh(*pair, eigvals_only=True) for pair in ((K, M), (K_given, M_given)))
    np.testing.assert_allclose(λ_given, λ, rtol=0, atol=1e-13 * λ[-1])
    B = rigid.contacts["right"]
    np.testing.assert_allclose(
        B.T @ np.linalg.solve(K_given, B),
        np.linalg.inv(K)[-6:, -6:],
        rtol=0,
        atol=1e-10 * np.linalg.inv(K)[-6:, -6:].max(),
    )
    moves = rigid.body.unknowns.expand(np.linalg.solve(K_given, B)).reshape(-1, 3, 6)[face].reshape(-1, 6)
    motion = np.linalg.lstsq(rigid_motions(nodes[face], middle), moves, rcond=None)[0]
    np.testing.assert_allclose(rigid_motions(nodes[face], middle) @ motion, moves, atol=1e-13 * np.abs(moves).max())


@pytest.mark.parametrize("degree", [1, 2])
def test_a_wrench_has_the_forces_and_moments_that_it_is_called_by(tmp_path, degree):
    """On a surface that bends, too."""
    system = body(tmp_path, 'clamped = ["left"]', degree)
    columns, nodes = system.contacts["right"], system.body.nodes
    forces = np.zeros((3 * len(nodes), 6))
    forces[system.body.free] = columns
    about = rigid_motions(nodes, np.array([1.0, 0.2, 0.15]))
    np.testing.assert_allclose(about.T @ forces, np.eye(6), atol=1e-13)


@pytest.mark.parametrize(
    ("parts", "said"),
    [
        ({"supports": 'clamped = ["left"]\nrigid = ["top"]'}, r"supports.rigid\[0\] has nodes that are held"),
        ({"supports": 'clamped = ["left"]\nrigid = ["right", "right"]'}, "or on another rigid surface"),
        ({"supports": 'clamped = ["left"]\nrigid = ["rihgt"]'}, "no surface 'rihgt'.*did you mean 'right'"),
    ],
)
def test_rigid_surfaces_that_cannot_be_are_refused(tmp_path, parts, said):
    with pytest.raises(fr.FenicsRomError, match=said):
        body(tmp_path, **parts)


def test_a_model_knows_its_rigid_surfaces(tmp_path):
    """No run of one that has them is taken for a run of one that has not."""
    rom = fr.reduce(body(tmp_path), order=8)
    assert rom.contacts == {"right": 6, "top": 3}
    assert '"rigid": ["right"]' in rom.environment.built_in["supports"]
    assert "rigid" not in fr.reduce(body(tmp_path, 'clamped = ["left"]'), order=8).environment.built_in["supports"]
    sim = fr.Simulator(rom, 1e-3)
    sim.switch("right")
    for _ in range(20):
        sim.step([0, 0, 1.0, 0, 0.1, 0])
    face = rom.nodes[:, 0] > 1 - 1e-9
    moved = sim.displacement()[face].ravel()
    motions = rigid_motions(rom.nodes[face], np.zeros(3))
    assert np.abs(moved - motions @ np.linalg.lstsq(motions, moved, rcond=None)[0]).max() < 1e-13 * np.abs(moved).max()


ENDS = '[contacts.left]\nsurface = "left"\nforce = "wrench"\n[contacts.right]\nsurface = "right"\nforce = "wrench"'


@pytest.fixture(scope="module", params=["stout", "slender"])
def link(request, tmp_path_factory):
    """A body that nothing holds, whose two ends are rigid: the interfaces of a flexible link."""
    lengths = (1.0, 0.4, 0.3) if request.param == "stout" else (1.0, 0.02, 0.01)
    mesh = write_arrays(tmp_path_factory.mktemp("link") / "box.msh", *box_arrays(lengths, (6, 2, 2)))
    supports = 'rigid = ["left", "right"]'
    return fr.assemble(parse_scene(scene_text(mesh, supports=supports, contacts=ENDS, damping="beta = 1e-4")))


def test_a_free_body_with_rigid_ends_has_six_rigid_motions(link):
    """That strain nothing, and are all motions that do not."""
    K, R = dense(link.stiffness, link.size), link.rigid
    assert R.shape == (link.size, 6)
    assert link.elastic_size == link.size - 6
    λ = np.linalg.eigvalsh(K)
    assert np.abs(K @ R).max() <= 1e-12 * λ[-1] * np.abs(R).max()
    assert λ[6] > 1e3 * np.abs(λ[:6]).max()
    moved = link.body.unknowns.expand(R)
    turns = rigid_motions(link.body.nodes, link.body.nodes.mean(axis=0))
    rest = moved - turns @ np.linalg.lstsq(turns, moved, rcond=None)[0]
    assert np.abs(rest).max() <= 1e-12 * np.abs(moved).max()


def test_frequencies_and_static_shapes_of_a_link_are_those_of_dense_algebra(link):
    """The first by eigenvectors alone; what wrenches in balance do at rest, Bᵀ P K⁺ Pᵀ B, by Craig-Bampton's shapes."""
    K, M, R = dense(link.stiffness, link.size), dense(link.mass, link.size), link.rigid
    λ = scipy.linalg.eigh(K, M, eigvals_only=True)[6:]
    for model in fr.reduce(link, order=12, method="modal").contact_models.values():
        assert model.rigid == 6
        np.testing.assert_allclose(model.eigenvalues[6:18], λ[:12], rtol=1e-8)
    for name, model in fr.reduce(link, order=12, method="modal+static").contact_models.items():
        balanced = link.contacts[name] - M @ R @ (R.T @ link.contacts[name])
        shapes = np.linalg.lstsq(
            np.vstack([K, K.max() * (M @ R).T]), np.vstack([balanced, np.zeros((6, 6))]), rcond=None
        )
        at_rest, G = balanced.T @ shapes[0], model.inputs[6:]
        given = (G / model.eigenvalues[6:, None]).T @ G
        sizes = np.sqrt(np.diag(at_rest))  # of forces and moments, in m/N and rad/N m
        np.testing.assert_allclose(given / sizes / sizes[:, None], at_rest / sizes / sizes[:, None], rtol=0, atol=1e-8)
        assert model.eigenvalues[6] == pytest.approx(λ[0], rel=0.02)


def test_a_link_is_reduced_by_balancing(link):
    """The model of all unknowns is the body."""
    λ = scipy.linalg.eigh(dense(link.stiffness, link.size), dense(link.mass, link.size), eigvals_only=True)[6:]
    for model in fr.reduce(link, order=24).contact_models.values():
        assert model.rigid == 6
        np.testing.assert_allclose(model.eigenvalues[6:9], λ[:3], rtol=1e-4)
