"""Assembly against closed forms: constant strain, bars, beams, springs, weights."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from bodies import assembled, box_arrays, box_surfaces, dense, sparse, write_arrays
from scipy.sparse.linalg import eigsh

import fenics_rom as fr
from fenics_rom.errors import MeshError, SceneError, SolverError
from fenics_rom.fem.petsc_matrix import PetscMatrix, combination

LENGTHS = (1.0, 0.4, 0.3)
YOUNG, POISSON, DENSITY = 1.0e6, 0.3, 1000.0  # of bodies.scene_text
LAMBDA, MU = YOUNG * POISSON / ((1 + POISSON) * (1 - 2 * POISSON)), YOUNG / (2 * (1 + POISSON))
NORMALS = {"right": (0, 1), "front": (1, -1), "back": (1, 1), "bottom": (2, -1), "top": (2, 1)}
EVERY_FACE = "\n".join(f'[contacts.{name}]\nsurface = "{name}"' for name in NORMALS)


def material(young=YOUNG, poisson=POISSON, density=DENSITY, cells=None):
    chosen = f'\ncells = "{cells}"' if cells else ""
    return f"young = {young}\npoisson = {poisson}\ndensity = {density}{chosen}"


def field(system, of_point):
    """Free components of a displacement field."""
    return of_point(system.body.nodes).ravel()[system.body.free]


@pytest.fixture(scope="module", params=[1, 2], ids=["degree 1", "degree 2"])
def shaken(request, tmp_path_factory):
    """A box whose inner nodes are somewhere, with a force on each free face."""
    mesh = write_arrays(tmp_path_factory.mktemp("shaken") / "box.msh", *box_arrays(LENGTHS, (4, 3, 3), shake=0.25))
    return assembled(mesh, degree=request.param, contacts=EVERY_FACE)


@pytest.mark.parametrize("axis", [0, 1, 2], ids=["stretch", "shear y", "shear z"])
def test_patch_test_is_exact(shaken, axis):
    """u = x e_axis has constant stress σ (Hooke), and is held in balance by σ n on the faces alone: K u = Σ B A σ n."""
    strain = np.zeros((3, 3))
    strain[0, axis] += 0.5
    strain[axis, 0] += 0.5
    stress = LAMBDA * np.trace(strain) * np.eye(3) + 2 * MU * strain
    force = np.zeros(shaken.size)
    for name, (normal, sign) in NORMALS.items():
        area = np.prod(np.delete(LENGTHS, normal))
        force += shaken.contacts[name] @ (area * sign * stress[:, normal])
    u = field(shaken, lambda p: p[:, :1] * np.eye(3)[axis])
    K = dense(shaken.stiffness, shaken.size)
    assert np.abs(K @ u - force).max() <= 1e-11 * np.abs(force).max()
    assert np.abs(np.linalg.solve(K, force) - u).max() <= 1e-11 * np.abs(u).max()


def test_mass_of_a_field_is_its_integral(shaken):
    """∫ ρ u·u = ρ A L³/3 for u = x a, and ρ A L⁵/5 for u = x² a, which degree 2 can hold."""
    a, ρA = np.array([1.0, -2.0, 0.5]), DENSITY * LENGTHS[1] * LENGTHS[2]
    linear = field(shaken, lambda p: p[:, :1] * a)
    assert linear @ dense(shaken.mass, shaken.size) @ linear == pytest.approx(ρA / 3 * a @ a, rel=1e-13)
    if shaken.scene.degree == 2:
        quadratic = field(shaken, lambda p: p[:, :1] ** 2 * a)
        assert quadratic @ dense(shaken.mass, shaken.size) @ quadratic == pytest.approx(ρA / 5 * a @ a, rel=1e-13)


def test_matrices_are_symmetric_definite_and_damping_is_their_sum(shaken):
    M, D, K = (dense(matrix, shaken.size) for matrix in (shaken.mass, shaken.damping, shaken.stiffness))
    for matrix in (M, K):
        assert np.array_equal(matrix, matrix.T)  # to the last bit: the full run's energy account rests on it
        assert np.linalg.eigvalsh(matrix)[0] > 0
    assert np.abs(D - (1.0 * M + 1e-3 * K)).max() <= 2e-15 * np.abs(D).max()
    assert shaken.rayleigh == (1.0, 1e-3)


def test_undamped_body_has_no_damping(box_file):
    system = assembled(box_file, effects="inertia = {}")
    assert system.rayleigh == (0.0, 0.0)
    assert not (system.damping @ np.ones((system.size, 2))).any()


def test_nodes_weigh_what_the_body_weighs(shaken):
    mass = shaken.body.node_mass
    assert mass.sum() == pytest.approx(DENSITY * np.prod(LENGTHS), rel=1e-13)
    assert mass.min() > 0


def axial_frequency(mesh, degree):
    """Lowest ω of a box that may not move across its axis."""
    system = assembled(mesh, degree=degree)
    along = system.body.free % 3 == 0
    M, K = (sparse(matrix)[along][:, along] for matrix in (system.mass, system.stiffness))
    return np.sqrt(eigsh(K, 1, M, sigma=0.0)[0][0])


@pytest.mark.parametrize(("degree", "bricks"), [(1, (8, 16, 32)), (2, (4, 8, 16))])
def test_eigenfrequencies_converge_with_twice_the_degree(tmp_path, degree, bricks):
    """Waves along a box held at one end: ω = π/2L √((λ+2μ)/ρ) exactly; the error of eigenvalues is of order h^2k."""
    exact = np.pi / 2 * np.sqrt((LAMBDA + 2 * MU) / DENSITY)
    errors = []
    for n in bricks:
        mesh = write_arrays(tmp_path / f"{n}.msh", *box_arrays((1.0, 0.25, 0.25), (n, n // 4, n // 4)))
        errors.append(axial_frequency(mesh, degree) / exact - 1)
    order = np.log2(errors[-2] / errors[-1])
    assert 0.9 * 2 * degree <= order <= 1.1 * 2 * degree, errors
    assert all(finer < coarser for coarser, finer in pairwise(errors)), errors


def test_slender_beam_has_the_frequency_of_euler_and_bernoulli(tmp_path):
    length, side = 1.0, 0.02
    mesh = write_arrays(tmp_path / "beam.msh", *box_arrays((length, side, side), (25, 1, 1)))
    system = assembled(mesh, degree=2)
    γ, _ = system.algebra.eigenpairs(system.mass, system.stiffness, 2)
    exact = 1.8751040687**2 / length**2 * np.sqrt(YOUNG * side**2 / (12 * DENSITY))
    np.testing.assert_allclose(np.sqrt(γ), exact, rtol=0.01)


@pytest.fixture(scope="module")
def halves(tmp_path_factory):
    """A box with its halves, both of them, and a slice of both named."""
    points, cells = box_arrays(LENGTHS, (4, 2, 2))
    x = points[cells].mean(axis=1)[:, 0]
    regions = {"near": x < 0.5, "far": x > 0.5, "all": x > 0, "slice": abs(x - 0.5) < 0.25}
    rows = {name: np.flatnonzero(inside) for name, inside in regions.items()}
    path = tmp_path_factory.mktemp("halves") / "box.msh"
    return write_arrays(path, points, cells, box_surfaces(points, cells), rows)


def two_materials(halves, **second):
    near, far = material(poisson=0.0, cells="near"), material(5.0e6, 0.0, 3000.0, "far")
    return assembled(halves, **{"material": None, "materials.soft": near, "materials.stiff": far} | second)


def test_two_materials_are_springs_in_series(halves):
    """ν = 0: the end of a bar moves by F/A (L₁/E₁ + L₂/E₂), its middle by F/A L₁/E₁."""
    system = two_materials(halves)
    pull = system.contacts["right"][:, 0]
    u = np.linalg.solve(dense(system.stiffness, system.size), pull)
    x = field(system, lambda p: np.where([True, False, False], p[:, :1], 0.0))
    along = np.where(x <= 0.5, x / 1e6, 0.5 / 1e6 + (x - 0.5) / 5e6) / (LENGTHS[1] * LENGTHS[2])
    assert np.abs(u - along).max() <= 1e-12 * along.max()
    assert system.body.node_mass.sum() == pytest.approx((1000 + 3000) / 2 * np.prod(LENGTHS), rel=1e-13)


@pytest.mark.parametrize(
    ("cells", "error", "message"),
    [
        ("slice", SceneError, r"materials.stiff: \d+ of its cells already have a material"),
        ("near", SceneError, r"materials.stiff: \d+ of its cells already have a material"),
        ("fur", MeshError, "no region 'fur'; there is all, far, near, slice; did you mean 'far'?"),
        ("left", MeshError, "no region 'left'"),
    ],
)
def test_materials_that_do_not_fit_the_regions_are_refused(halves, cells, error, message):
    with pytest.raises(error, match=message.replace("?", r"\?")):
        two_materials(halves, **{"materials.stiff": material(cells=cells)})


def test_cells_without_material_are_counted(halves):
    with pytest.raises(SceneError, match="48 of 96 cells have no material"):
        assembled(halves, **{"material": None, "materials.soft": material(cells="near")})


def test_body_that_is_all_clamped_is_refused(tmp_path):
    mesh = write_arrays(tmp_path / "one.msh", *box_arrays(LENGTHS, (1, 1, 1)))
    with pytest.raises(SceneError, match="every node of the mesh is clamped"):
        assembled(mesh, supports='clamped = ["left", "right"]')


def test_numbers_beyond_floating_point_are_an_error_of_the_solver(box_file):
    system = assembled(box_file, material=material(poisson=0.49))
    stiff = PetscMatrix(combination((1e308, system.stiffness)))
    with pytest.raises(SolverError, match="not all of its numbers are finite"):
        fr.reduce(replace(system, stiffness=stiff), order=4)


@pytest.mark.parametrize(("degree", "poisson", "warns"), [(1, 0.49, True), (1, 0.4, False), (2, 0.49, False)])
def test_elements_that_lock_are_named(box_file, degree, poisson, warns):
    system = assembled(box_file, degree=degree, material=material(poisson=poisson))
    assert bool(system.warnings) is warns
    assert all("lock" in message for message in system.warnings)


def test_plate_of_the_paper_has_180_states(plate_system):
    assert plate_system.size == 180
    assert plate_system.body.node_mass.sum() == pytest.approx(2300 * 0.5 * 0.2 * 0.01, rel=1e-12)
