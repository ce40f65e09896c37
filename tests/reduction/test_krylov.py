"""Krylov spaces: σ against dense Gramians for every kind of damping and input, many contact modes, hard chains."""

import warnings
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse
from bodies import assembled, box_arrays, sparse, write_arrays
from test_own_matrices import triple_chain

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning
from fenics_rom.fem import petsc_algebra
from fenics_rom.fem.iterative import IterativeFactor
from fenics_rom.reduction import krylov, validation
from fenics_rom.reduction.balancing import balance
from fenics_rom.reduction.frequency_response import response
from fenics_rom.reduction.gramians import gramian_factors
from fenics_rom.reduction.krylov_augmentation import low_rank_damping
from fenics_rom.system.protocols import EXACT
from fenics_rom.system.scipy_backend import MatrixAlgebra

DATA = Path(__file__).parents[1] / "data"
PROPORTIONAL = {"heavy": (0.5, 1e-2), "light": (0.1, 1e-6), "alpha only": (1.0, 0.0), "beta only": (0.0, 1e-3)}


class Plate:
    """A thin plate: M, K, all its eigenvectors, and nodal forces on a patch and at a corner."""

    def __init__(self, folder, bricks):
        points, cells = box_arrays((0.5, 0.2, 0.01), bricks)
        patches = "[contacts.tip]\nnear = {point = [0.5, 0.1, 0.005], radius = 0.04}\n"
        patches += '[contacts.middle]\nnear = {point = [0.25, 0.1, 0.01], radius = 0.07}\nforce = "nodal"'
        system = assembled(write_arrays(folder / "plate.msh", points, cells), contacts=patches)
        self.M, self.K, self.size = sparse(system.mass), sparse(system.stiffness), system.size
        self.tip, self.middle = system.input_matrix("tip"), system.input_matrix("middle")
        self.γ, self.V = scipy.linalg.eigh(self.K.toarray(), self.M.toarray())
        corner = np.flatnonzero(np.isclose(system.body.nodes, [0.5, 0.2, 0.01]).all(axis=1))[0]
        self.corner = np.isin(system.body.free, 3 * corner + np.arange(3))
        left = points[cells].mean(axis=1)[:, 0] < 0.25
        half = {"left half": np.flatnonzero(left), "right half": np.flatnonzero(~left)}
        regions = "[materials.left]\nyoung = {}\npoisson = 0.3\ndensity = 1000.0\ncells = 'left half'\n"
        regions += "[materials.right]\nyoung = {}\npoisson = 0.3\ndensity = 1000.0\ncells = 'right half'\n"
        mesh = write_arrays(folder / "halves.msh", points, cells, regions=half)
        soft = assembled(mesh, contacts=regions.format(1e6, 2e6) + patches, material=None)
        self.right = sparse(soft.stiffness) - self.K  # the stiffness of the right half alone

    def damped(self, D, **contacts):
        return fr.System(mass=self.M, damping=D, stiffness=self.K, contacts=contacts)

    def rayleigh(self, α, β):
        return α * self.M + β * self.K

    def dashpots(self, c):
        return scipy.sparse.diags(c * self.corner)

    def sigma(self, D, B):
        """By all eigenvectors; for dense damping by one Schur form of the whole state."""
        d = self.V.T @ (D @ self.V)
        diagonal = np.abs(d - np.diag(np.diag(d))).max() <= 1e-9 * np.abs(d).max()
        d = np.diag(d).copy() if diagonal else (d + d.T) / 2
        return balance(*gramian_factors(self.γ, d, self.V.T @ B, np.eye(self.size))).singular_values


@pytest.fixture(scope="module")
def plate(tmp_path_factory):
    """n = 588."""
    return Plate(tmp_path_factory.mktemp("plate"), (14, 6, 1))


@pytest.fixture(scope="module")
def small_plate(tmp_path_factory):
    """n = 240, for dense damping."""
    return Plate(tmp_path_factory.mktemp("small"), (10, 3, 1))


def reduced(system, order=20, **choices):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return fr.reduce(system, order=order, lyapunov="krylov", **choices)


def test_iterations_change_models_by_less_than_they_were_allowed(tmp_path, monkeypatch):
    """Of n = 1,512: what solves leave adds up to no more than their accuracy, though late blocks leave much more.

    σ change by its square alone, and by as much as the last block of a space changes them.
    """
    asked = []

    class Watched(IterativeFactor):
        def solve(self, block, accuracy=EXACT):
            asked.append(accuracy)
            return super().solve(block, accuracy)

    system = assembled(write_arrays(tmp_path / "box.msh", *box_arrays((1.0, 0.8, 0.7), (7, 7, 8), shake=0.2)))
    monkeypatch.setattr(petsc_algebra, "IterativeFactor", Watched)
    direct = reduced(system, solver="direct")

    def change():
        rom, most, of_σ = fr.reduce(system, order=20, lyapunov="krylov", solver="iterative"), 0.0, 0.0
        for name, mode in rom.contact_models.items():
            σ, of_direct = mode.hankel_singular_values[:20], direct.contact_models[name]
            of_σ = max(of_σ, np.abs(σ / of_direct.hankel_singular_values[:20] - 1).max())
            ω = np.sqrt(of_direct.eigenvalues[:11])
            H, H_direct = ([shapes(of, name, w) for w in (ω[1:] + ω[:-1]) / 2] for of in (rom, direct))
            sizes = [np.linalg.norm(of_one) for of_one in H_direct]
            most = max(most, max(map(np.linalg.norm, np.subtract(H, H_direct))) / max(sizes))
        return most, of_σ

    def shapes(rom, name, ω):
        mode = rom.contact_models[name]
        return rom.basis @ (mode.coordinates @ response(mode.eigenvalues, mode.damping, mode.inputs, ω))

    with pytest.warns(FenicsRomWarning, match="conjugate gradients"):
        most, of_σ = change()
    assert most <= krylov.SPACE_ACCURACY
    assert of_σ <= 0.1 * krylov.CONVERGENCE_TOLERANCE
    assert {krylov.SPACE_ACCURACY, krylov.LEAST_ACCURACY, validation.SOLVE_ACCURACY} < set(asked)
    monkeypatch.setattr(krylov, "SPACE_ACCURACY", 1e-2)
    monkeypatch.setattr(krylov, "LEAST_ACCURACY", 1e-2)
    with pytest.warns(FenicsRomWarning, match="conjugate gradients"):
        most, of_σ = change()
    assert most > 1e-6
    assert of_σ > krylov.CONVERGENCE_TOLERANCE


def gap(rom, name, exact, count=20, floor=1e-8):
    """Largest relative error of the first σ that are above a share of the largest."""
    σ = rom.contact_models[name].hankel_singular_values
    exact = exact[:count][exact[:count] > floor * exact[0]]
    return np.abs(σ[: len(exact)] / exact - 1).max()


@pytest.mark.parametrize("columns", [1, pytest.param(3, marks=pytest.mark.slow), 30])
@pytest.mark.parametrize("damping", PROPORTIONAL.values(), ids=PROPORTIONAL)
def test_proportional_damping(plate, damping, columns):
    B = plate.middle[:, :columns] if columns > 3 else plate.tip[:, 3 - columns :]
    D = plate.rayleigh(*damping)
    order = 12 if columns == 1 and damping == PROPORTIONAL["heavy"] else 20  # as many as there are
    rom = reduced(plate.damped(D, c=B), order)
    assert gap(rom, "c", plate.sigma(D, B), order) <= 1e-6


@pytest.mark.parametrize(
    ("c", "β"),
    [(0.5, 1e-3), (50.0, 1e-6), *(pytest.param(c, β, marks=pytest.mark.slow) for c, β in [(0.5, 1e-6), (50.0, 1e-3)])],
)
def test_dashpots_at_a_corner(small_plate, c, β):
    D = small_plate.rayleigh(0.5, β) + small_plate.dashpots(c)
    system = small_plate.damped(D, c=small_plate.tip)
    assert low_rank_damping(system).shape == (small_plate.size, 3)
    assert gap(reduced(system), "c", small_plate.sigma(D, small_plate.tip)) <= 1e-6


@pytest.mark.slow
def test_dashpots_need_no_space_of_their_size(plate):
    """50 N s/m on a body of 588 unknowns: a tenth of them would not do for zero shifts from B alone."""
    D = plate.rayleigh(0.5, 1e-3) + plate.dashpots(50.0)
    rom = reduced(plate.damped(D, c=plate.tip))
    assert len(rom.contact_models["c"].hankel_singular_values) <= 120
    assert gap(rom, "c", plate.sigma(D, plate.tip)) <= 1e-6


@pytest.mark.slow
@pytest.mark.parametrize(("left", "right"), [(1e-3, 1e-4), (1e-2, 1e-4), (1e-4, 1e-6)])
def test_damping_of_each_material_asks_for_positive_shifts(small_plate, left, right, monkeypatch):
    factored = []
    factor = MatrixAlgebra.factor

    def counted(self, *terms, **choices):
        factored.append(terms)
        return factor(self, *terms, **choices)

    monkeypatch.setattr(MatrixAlgebra, "factor", counted)
    D = 0.5 * small_plate.M + left * (small_plate.K - small_plate.right) + right * small_plate.right
    system = small_plate.damped(D, c=small_plate.tip)
    assert low_rank_damping(system) is None
    rom = reduced(system)
    shifts = [s for (_, _), (s, _), _ in factored[1:]]
    assert shifts
    assert min(shifts) > 0
    assert gap(rom, "c", small_plate.sigma(D, small_plate.tip)) <= 1e-6


def test_proportional_damping_needs_one_factorisation(plate, monkeypatch):
    factored = []
    factor = MatrixAlgebra.factor
    monkeypatch.setattr(MatrixAlgebra, "factor", lambda *a, **k: factored.append(a) or factor(*a, **k))
    system = plate.damped(plate.rayleigh(1.0, 1e-3), tip=plate.tip, middle=plate.middle[:, :6])
    reduced(system)
    assert len(factored) == 1


def test_dependent_columns_change_nothing(plate):
    D = plate.rayleigh(0.5, 1e-3)
    mixed = plate.tip @ np.linalg.qr(np.random.default_rng(0).standard_normal((7, 3)))[0].T
    rom = reduced(plate.damped(D, three=plate.tip, seven=mixed))
    three, seven = (rom.contact_models[name].hankel_singular_values[:20] for name in ("three", "seven"))
    np.testing.assert_allclose(seven, three, rtol=1e-6)


def test_identical_and_nested_contact_modes_share_their_basis(plate):
    D = plate.rayleigh(0.5, 1e-3)
    alone = {name: reduced(plate.damped(D, c=B)) for name, B in (("all", plate.tip), ("one", plate.tip[:, :1]))}
    rom = reduced(plate.damped(D, all=plate.tip, same=plate.tip, one=plate.tip[:, :1]))
    for name, of in (("all", "all"), ("same", "all"), ("one", "one")):
        expected = alone[of].contact_models["c"].hankel_singular_values[:15]
        np.testing.assert_allclose(rom.contact_models[name].hankel_singular_values[:15], expected, rtol=1e-6)
    assert np.abs(rom.contact_models["all"].coordinates - rom.contact_models["same"].coordinates).max() <= 1e-5
    assert rom.basis.shape[1] <= alone["all"].basis.shape[1] + alone["one"].basis.shape[1]


@pytest.mark.slow
@pytest.mark.parametrize("damping", [(0.5, 1e-3), (0.1, 1e-6)], ids=["heavy", "light"])
def test_many_contact_modes_share_eigenvectors(plate, damping):
    D = plate.rayleigh(*damping)
    patches = {f"c{k}": plate.middle[:, k : k + 3] for k in range(0, 45, 3)}
    system = plate.damped(D, **patches)
    rom = reduced(system)
    assert "eigenvectors" in {stage.name for stage in rom.stages}
    for name, B in patches.items():
        assert gap(rom, name, plate.sigma(D, B)) <= 1e-6
        assert rom.validation[name]["transfer_error"] <= 0.01


def test_many_contact_modes_and_a_tolerance(plate):
    D = plate.rayleigh(0.5, 1e-3)
    patches = {f"c{k}": plate.middle[:, k : k + 3] for k in range(0, 45, 3)}
    rom = fr.reduce(plate.damped(D, **patches), tolerance=1e-3, lyapunov="krylov")
    for name, B in patches.items():
        σ = plate.sigma(D, B)
        m = rom.contact_models[name].order
        assert σ[m:].sum() <= 1.001e-3 * σ.sum() <= 1.01 * σ[m - 1 :].sum()
        assert gap(rom, name, σ, m) <= 1e-6


@pytest.mark.slow
def test_many_contact_modes_of_two_materials(small_plate):
    """Shared eigenvectors, and shifts as well."""
    D = 0.5 * small_plate.M + 1e-3 * (small_plate.K - small_plate.right) + 1e-4 * small_plate.right
    patches = {f"c{k}": small_plate.middle[:, k : k + 3] for k in range(0, 27, 3)}
    rom = reduced(small_plate.damped(D, **patches), 10)
    for name, B in list(patches.items())[::4]:
        assert gap(rom, name, small_plate.sigma(D, B), 10) <= 1e-6


def chain(length, α):
    M, D, K, B = triple_chain(length, α, α, 5.0)
    return fr.System(mass=M, damping=D, stiffness=K, contacts={"all": B})


@pytest.mark.slow
def test_triple_chain_of_181_unknowns():
    system = chain(60, 0.01)
    γ, V = scipy.linalg.eigh(system.stiffness.toarray(), system.mass.toarray())
    D = V.T @ (system.damping @ V)
    B = system.contacts["all"]
    exact = balance(*gramian_factors(γ, (D + D.T) / 2, V.T @ B, np.eye(system.size))).singular_values
    assert gap(reduced(system), "all", exact) <= 1e-6


@pytest.mark.slow
def test_triple_chain_of_1501_unknowns():
    """Its dense solution takes minutes (gramian_factors in all eigenvectors, as above), so it is kept."""
    exact = np.loadtxt(DATA / "triple-chain-1501.csv")
    assert gap(reduced(chain(500, 0.002)), "all", exact) <= 1e-6


def test_local_damping_is_told_from_the_rest(small_plate):
    here = small_plate
    local = here.damped(here.rayleigh(0.5, 1e-3) + here.dashpots(1.0), c=here.tip)
    F = low_rank_damping(local)
    assert np.linalg.matrix_rank(np.hstack([F, np.eye(here.size)[:, here.corner]])) == 3
    assert low_rank_damping(here.damped(here.rayleigh(0.5, 1e-3), c=here.tip)).shape == (here.size, 0)
    assert low_rank_damping(here.damped(here.rayleigh(0.5, 1e-3) + 1e-3 * here.right, c=here.tip)) is None
    assert low_rank_damping(here.damped(here.dashpots(1.0), c=here.tip)).shape == (here.size, 3)


def test_a_space_that_may_not_grow_says_what_is_missing(plate, monkeypatch):
    monkeypatch.setattr("fenics_rom.reduction.krylov.MAX_VECTORS", 12)
    system = plate.damped(plate.rayleigh(0.5, 1e-3), c=plate.tip)
    with pytest.warns(
        fr.errors.FenicsRomWarning, match=r"'c': .* known to \de-\d+ only, as the largest Krylov space, of 12"
    ):
        fr.reduce(system, order=8, lyapunov="krylov")
