"""Rollers, planes of symmetry, points and pieces without a name: what they leave of a body's motions."""

import numpy as np
import pytest
from bodies import box_arrays, box_surfaces, dense, scene_text, write_arrays

import fenics_rom as fr
from fenics_rom.errors import FenicsRomError
from fenics_rom.fem.simulator import FullOrderSimulator
from fenics_rom.fem.supports import eliminate
from fenics_rom.scene.file import parse_scene

LENGTHS, BRICKS = (1.0, 0.4, 0.3), (4, 2, 2)
E_MODULUS, NU = 1.0e6, 0.3
AXES = np.eye(3)
TURN = np.array([[2.0, -2.0, 1.0], [1.0, 2.0, 2.0], [-2.0, -1.0, 2.0]]) / 3  # rows are axes, to round-off orthonormal


def turned_box(folder, turn):
    points, cells = box_arrays(LENGTHS, BRICKS, shake=0.2)
    return write_arrays(folder / "box.msh", points @ turn, cells, box_surfaces(points, cells))


def planes(turn):
    """The three faces at the origin as planes of symmetry."""
    faces = zip(("left", "front", "bottom"), turn, strict=True)
    return "\n".join(
        f'[[supports.held]]\nsurface = "{face}"\nnormal = {(3.0 * normal).tolist()}' for face, normal in faces
    )


def symmetric(folder, turn=AXES, **parts):
    """An eighth of a box, or a box turned."""
    text = scene_text(turned_box(folder, turn), supports=None, **parts)
    return fr.assemble(parse_scene(f"{planes(turn)}\n{text}"))


@pytest.mark.parametrize("turn", [AXES, TURN], ids=["along axes", "oblique"])
@pytest.mark.parametrize("degree", [1, 2])
def test_bar_between_planes_of_symmetry_is_in_uniaxial_tension(tmp_path, turn, degree):
    """Exactly: u = σ/E (x, -ν y, -ν z) is in the space of the elements."""
    system = symmetric(tmp_path, turn, degree=degree, **{"outputs.corner": f"points = [{(LENGTHS @ turn).tolist()}]"})
    K, f = dense(system.stiffness, system.size), system.contacts["right"] @ turn[0]
    x = np.linalg.solve(K, f)
    σ = 1.0 / (LENGTHS[1] * LENGTHS[2])
    expected = (system.body.nodes @ turn.T) * (σ / E_MODULUS * np.array([1.0, -NU, -NU])) @ turn
    shape = system.body.unknowns.expand(x).reshape(-1, 3)
    bound = 10 * np.linalg.cond(K) * np.finfo(float).eps * np.abs(expected).max()
    assert np.abs(shape - expected).max() <= bound
    assert (
        np.abs(system.outputs["corner"].T @ x - expected[np.linalg.norm(system.body.nodes, axis=1).argmax()]).max()
        <= bound
    )
    assert system.rigid.shape[1] == 0
    assert system.warnings == ()


def test_body_that_is_turned_with_its_planes_is_the_same_body(tmp_path):
    (tmp_path / "turned").mkdir()
    bodies = [symmetric(tmp_path), symmetric(tmp_path / "turned", TURN)]
    frequencies = []
    for body in bodies:
        M, K = dense(body.mass, body.size), dense(body.stiffness, body.size)
        assert np.array_equal(M, M.T)
        assert np.array_equal(K, K.T)
        L = np.linalg.cholesky(M)
        frequencies.append(np.sqrt(np.linalg.eigvalsh(np.linalg.solve(L, np.linalg.solve(L, K).T))))
    np.testing.assert_allclose(*frequencies, rtol=1e-10)  # n eps times the ratio of the squares
    assert bodies[1].body.unknowns.weights is not None
    assert bodies[0].body.unknowns.weights is None


def test_rom_of_oblique_planes_keeps_them_and_is_the_full_order(tmp_path):
    text = '[run]\ndt = 1e-3\nduration = 0.05\n[[run.load]]\ncontact = "right"\nforce = [0.3, 0.2, -0.1]\n'
    system = symmetric(tmp_path, TURN)
    run = parse_scene(f"{planes(TURN)}\n{scene_text(tmp_path / 'box.msh', supports=None)}\n{text}")
    rom = fr.reduce(system, order=60)
    fr.write_rom(tmp_path / "box.h5", rom)
    full, reduced = fr.simulate(fr.assemble(run)), fr.simulate(fr.read_rom(tmp_path / "box.h5"), scene=run)
    assert fr.compare(reduced, full)["shape"].relative <= 1e-6
    on = np.isclose(rom.nodes @ TURN[0], 0.0, atol=1e-12)
    for run_ in (full, reduced):
        moved = run_.snapshots
        assert np.abs(moved[:, on] @ TURN[0]).max() <= 1e-14 * np.abs(moved).max()


@pytest.mark.parametrize("turn", [AXES, TURN], ids=["along axes", "oblique"])
def test_surfaces_that_slide_are_the_planes_that_they_lie_in(tmp_path, turn):
    """Three faces in one entry: nodes on their edges are held along both normals, in the corner along all three."""
    planar = symmetric(tmp_path, turn)
    faces = 'any = ["left", "front", "bottom"]\nsliding = true'
    text = scene_text(tmp_path / "box.msh", supports=None)
    sliding = fr.assemble(parse_scene(f"[[supports.held]]\n{faces}\n{text}"))
    Z, Y = (system.body.unknowns.matrix.toarray() for system in (planar, sliding))
    assert Y.shape == Z.shape
    assert np.linalg.norm(Y - Z @ np.linalg.lstsq(Z, Y, rcond=None)[0]) <= 1e-12 * np.linalg.norm(Y)


def test_a_tube_that_slides_in_a_rigid_sleeve_is_lames(tmp_path):
    """u_r (b) = 0 under a pressure inside, in plane strain; the error falls with the mesh size."""
    (a, b), ν, pressure = (0.05, 0.1), 0.3, 1e4
    G, λ = E_MODULUS / (2 + 2 * ν), E_MODULUS * ν / ((1 + ν) * (1 - 2 * ν))
    C = pressure / (2 * (λ + G) + 2 * G * b**2 / a**2)  # u = C (b²/r - r), σ_r(a) = -p
    faces = 'any = ["right", "front", "back", "bottom", "top"]\nsliding = true'
    inside = '[contacts.inside]\nsurface = "left"\nforce = "normal"'
    errors = []
    for fine in (1, 2):
        points, cells = box_arrays((b - a, np.pi / 2, 0.01), (4 * fine, 6 * fine, 1))
        surfaces, (r, θ, z) = box_surfaces(points, cells), points.T
        tube = np.stack([(a + r) * np.cos(θ), (a + r) * np.sin(θ), z], axis=1)
        mesh = write_arrays(tmp_path / f"{fine}.msh", tube, cells, surfaces)
        text = scene_text(mesh, supports=None, contacts=inside)
        system = fr.assemble(parse_scene(f"[[supports.held]]\n{faces}\n{text}"))
        force = pressure * a * np.pi / 2 * 0.01 * system.contacts["inside"]
        x = np.linalg.solve(dense(system.stiffness, system.size), force)[:, 0]
        shape, radius = system.body.unknowns.expand(x).reshape(-1, 3), np.hypot(*system.body.nodes[:, :2].T)
        outward = system.body.nodes * [1, 1, 0] / radius[:, None]
        errors.append(np.abs(shape - (C * (b**2 / radius - radius))[:, None] * outward).max() / (C * (b**2 / a - a)))
        assert np.abs((shape * outward).sum(axis=1)[np.isclose(radius, b)]).max() <= 1e-12 * C
    assert errors[1] <= min(0.04, errors[0] / 2.5)


@pytest.mark.parametrize(
    ("held", "left"),
    [
        ('surface = "left"\nnormal = [1, 0, 0]', 3),  # two translations and a turn in the plane
        ('surface = "left"\nnormal = [1, 2, 0]', 3),  # the plane turned: the face is not flat along it, but points are
        ("point = [0.0, 0.0, 0.0]", 3),  # turns about it
        ("near = { point = [0, 0, 0], radius = 0.2 }", 0),
    ],
)
def test_support_leaves_the_motions_that_it_should(tmp_path, held, left):
    system = symmetric_with(tmp_path, f"[[supports.held]]\n{held}")
    assert system.rigid.shape[1] == left
    R = system.rigid
    assert np.abs(system.stiffness @ R).max(initial=0.0) <= 1e-12 * np.abs(
        dense(system.stiffness, system.size)
    ).max() * (np.abs(R).max(initial=0.0))


def symmetric_with(folder, held, **parts):
    return fr.assemble(parse_scene(f"{held}\n{scene_text(turned_box(folder, AXES), supports=None, **parts)}"))


@pytest.mark.parametrize(
    ("held", "message"),
    [
        ("point = [0.01, 0.0, 0.0]", r"supports.held\[0\].point = .*no node of the mesh is there; the nearest is at"),
        ("normal = [1, 0, 0]", r"supports.held\[0\]: give exactly one of surface, .*, point \(got none\)"),
        ('surface = "left"\nnormal = [0, 0, 0]', r"supports.held\[0\].normal: use any direction but zero"),
        ('surface = "lift"', "lift"),
        (
            'surface = "left"\nsliding = true\nnormal = [1, 0, 0]',
            "sliding: is along a surface's own normals; leave normal",
        ),
        ('surface = "left"\nnormal = "x"', r"supports.held\[0\].normal = 'x'"),
    ],
)
def test_support_that_cannot_be_is_refused(tmp_path, held, message):
    with pytest.raises(FenicsRomError, match=message):
        symmetric_with(tmp_path, f"[[supports.held]]\n{held}")


def test_large_deformation_between_oblique_planes_is_that_between_planes_along_axes(tmp_path):
    """A body that is turned with its planes and its load moves alike; it turns far where it slides along them."""
    moved = []
    for turn in (AXES, TURN):
        folder = tmp_path / str(len(moved))
        folder.mkdir()
        system = symmetric(folder, turn, effects='inertia = {}\nlarge_deformation = { material = "neo_hookean" }')
        body = FullOrderSimulator(system, 2e-3, system.scene.environment)
        for _ in range(20):
            body.step(np.array([2e4, 1e4, -3e4]) @ turn)
        moved.append(body.displacement() @ turn.T)
    assert np.abs(moved[0]).max() > 0.05 * max(LENGTHS)
    assert np.abs(moved[1] - moved[0]).max() <= 1e-9 * np.abs(moved[0]).max()


def test_large_deformation_between_planes_follows_the_closed_form(tmp_path):
    """Uniaxial stretch of St. Venant-Kirchhoff material: first Piola-Kirchhoff stress P = E λ (λ² - 1)/2."""
    force, area = 5e3, LENGTHS[1] * LENGTHS[2]
    effects = 'large_deformation = { material = "st_venant_kirchhoff" }'
    run = '[run]\ndt = 1.0\nduration = 2.0\n[[run.load]]\ncontact = "right"\nforce = [5e3, 0, 0]'
    system = symmetric(tmp_path, effects=effects, **{"outputs.end": 'surface = "right"'}, run=run.partition("\n")[2])
    end = fr.simulate(system).outputs["end"][-1, 0, 0]
    λ = 1 + end / LENGTHS[0]
    assert E_MODULUS * λ * (λ**2 - 1) / 2 == pytest.approx(force / area, rel=1e-6)


@pytest.mark.parametrize("seed", range(20))
def test_elimination_solves_for_what_normals_hold(seed):
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(rng.integers(1, 3), 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    normals = np.vstack([normals, normals[:1]])  # said twice
    fixed, weights, _, _ = eliminate(normals, np.empty((len(normals), 0)))
    rest = [j for j in range(3) if j not in fixed]
    x = np.zeros(3)
    x[rest] = rng.normal(size=len(rest))
    for i, row in zip(fixed, weights, strict=True):
        x[i] = sum(w * x[j] for j, w in row.items())
    assert len(fixed) == len(normals) - 1
    bound = 100 * np.finfo(float).eps / np.linalg.svd(normals[:-1])[1].min()
    assert np.abs(normals @ x).max() <= bound * np.abs(x).max()
