"""Contact points that yield beyond the basis: the static law, the energy account, switches that move no point."""

import copy
import warnings
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.linalg
from bodies import acted_on, box_arrays, write_arrays

import fenics_rom as fr
from fenics_rom.cli.main import main
from fenics_rom.errors import FenicsRomWarning, SceneError
from fenics_rom.reduction import leading_inputs, validation
from fenics_rom.reduction import reduce as reduction
from fenics_rom.reduction import residual_compliance as offline
from fenics_rom.rom.residual_part import inverse_of_lower, residual_part, strained_points
from fenics_rom.runtime.batch_residual import BatchResidual
from fenics_rom.runtime.environment_inputs import fit_environment
from fenics_rom.runtime.steppers import residual_motion
from fenics_rom.system import system as full_order

LENGTHS, ORDER = (0.4, 0.2, 0.1), 8
CLOSES_TO = 1e-12  # of the largest energy or work seen
FLOOR = """
[effects.contact.obstacles.floor]
shape = "half-space"
point = [0, 0, -2e-3]
normal = [0, 0, 1]
"""
BALLS = """
[effects.contact.obstacles.ball]
shape = "sphere"
center = [0.45, 0.1, 0.05]
radius = 0.045
[effects.contact.obstacles.other]
shape = "sphere"
center = [0.2, 0.1, -0.05]
radius = 0.045
"""
SPRINGS = "[effects.contact]\nmethod = 'penalty'\nstiffness = 2e3\n"
ROUGH = "[effects.friction]\ncoefficient = 0.3\n"
MOVING = "inertia = {}\ndamping = { alpha = 0.5, beta = 1e-3 }\n"
PUSH = "[effects.prescribed.push]\nsurface = 'top'\n"
PARTS = {
    "outputs.tip": "points = [[0.4, 0.2, 0.1]]",
    "contacts": '[contacts.bottom]\nsurface = "bottom"\n[contacts.right]\nsurface = "right"',
}

pytestmark = pytest.mark.filterwarnings("ignore:the surface is", "ignore:switching", "ignore:.*contact points leave")


@pytest.fixture(scope="module")
def mesh(tmp_path_factory):
    return write_arrays(tmp_path_factory.mktemp("yielding") / "box.msh", *box_arrays(LENGTHS, (4, 2, 2), shake=0.2))


class Models:
    """The full and the reduced model of a scene."""

    def __init__(self, mesh, effects, order=ORDER, **parts):
        self.scene = acted_on(mesh, effects, **(PARTS | parts))
        self.system = fr.assemble(self.scene)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FenicsRomWarning)
            self.rom = fr.reduce(self.system, order=order)

    @property
    def without(self):
        """What acts, but for the residual compliance."""
        return replace(self.rom.environment, residual_compliance=False)

    @property
    def rows(self):
        """S (3P, n) of the contact points."""
        return self.system.points_of_contact().columns(self.system.at_nodes).T

    def part(self, contact, rom=None):
        """What a contact mode lacks."""
        rom = rom or self.rom
        H = strained_points(rom.stiffness, self.rows @ rom.basis)
        return residual_part(rom.stiffness, rom.contact_models[contact], H, rom.residual_compliance)


@pytest.fixture(scope="module")
def held(mesh):
    return Models(mesh, MOVING + PUSH + FLOOR + BALLS + ROUGH)


@pytest.fixture(scope="module")
def free(mesh):
    return Models(mesh, MOVING + PUSH + FLOOR + ROUGH, supports=None)


@pytest.fixture(scope="module", params=["held", "free"])
def models(request):
    return request.getfixturevalue(request.param)


# --- offline ---------------------------------------------------------------------------------------------------------


def matrices(models):
    return [
        matrix @ np.eye(models.system.size)
        for matrix in (models.system.mass, models.system.damping, models.system.stiffness)
    ]


def shapes_lacking(models, rom, contact):
    """X = K⁺ Sᵀ - W diag(1/γ) Wᵀ Sᵀ of dense matrices, M-orthogonal to rigid motions."""
    (M, _, K), R = matrices(models), models.system.rigid
    P = np.eye(len(M)) - R @ R.T @ M
    inverse = P @ np.linalg.solve(K + np.abs(K).max() / np.abs(M).max() * M @ R @ R.T @ M, P.T)
    model = rom.contact_models[contact]
    W = (rom.basis @ model.coordinates)[:, model.rigid :]
    return (inverse - W / model.eigenvalues[model.rigid :] @ W.T) @ models.rows.T


@pytest.mark.parametrize("order", [ORDER, 3])
def test_compliance_and_inertia_are_those_of_dense_matrices(models, order):
    """To what is left out by definition; of truncated models, too. Inertia to what it shares with the basis, 10 %."""
    rom = fr.truncate(models.rom, order) if order < ORDER else models.rom
    for contact in rom.contact_models:
        X, part = shapes_lacking(models, rom, contact), models.part(contact, rom)
        R = models.rows @ X
        assert np.abs(part.compliance - R).max() <= 3 * models.rom.residual_compliance.floor
        assert np.linalg.eigvalsh(part.compliance)[0] > 0
        τ2 = np.trace(np.linalg.solve(part.compliance, X.T @ matrices(models)[0] @ X)) / len(R)
        assert part.time_constant**2 == pytest.approx(τ2, rel=0.1)


def static_inverse(models):
    """K⁺ (n, n) of dense matrices, M-orthogonal to rigid motions."""
    (M, _, K), R = matrices(models), models.system.rigid
    P = np.eye(len(M)) - R @ R.T @ M
    return P @ np.linalg.solve(K + np.abs(K).max() / np.abs(M).max() * M @ R @ R.T @ M, P.T)


def test_of_many_points_the_largest_shapes_are_held_and_the_rest_is_exact(models, monkeypatch):
    """Forces know all shapes, outputs are exact at rest, and no 12 other shapes would hold much more mass."""
    monkeypatch.setattr(offline, "MOST_SHAPES", 12)
    monkeypatch.setattr(offline, "OVERSAMPLING", 8)
    with warnings.catch_warnings(action="ignore", category=FenicsRomWarning):
        rom = fr.reduce(models.system, order=ORDER)
    (M, _, K), inverse, S, residual = matrices(models), static_inverse(models), models.rows, rom.residual_compliance
    κ, Q = rom.stiffness[rom.rigid :], rom.basis[:, rom.rigid :]
    assert Q.shape[1] <= 2 * ORDER + 12 + 3 < len(S)
    told = [text for text in rom.warnings if "the shared basis holds the 12 largest" in text]
    assert len(told) == 1
    assert f"{len(S) // 3} contact points" in told[0]

    X = (inverse - Q / κ @ Q.T) @ S.T
    τ2 = residual.time_constants**2
    for told_of, exact in (
        (residual.factor @ residual.factor.T, S @ X),
        (residual.factor * τ2 @ residual.factor.T, X.T @ M @ X),
    ):
        assert np.abs(told_of - exact).max() <= 1e-5 * np.abs(exact).max()
    for contact in rom.contact_models:
        R = S @ shapes_lacking(models, rom, contact)
        assert np.abs(models.part(contact, rom).compliance - R).max() <= 3 * residual.floor

    C = rom.outputs["tip"][:, rom.rigid :]
    exact = models.system.outputs["tip"].T @ inverse @ S.T
    assert np.abs(C / κ @ (S @ Q).T - exact).max() <= 1e-9 * np.abs(exact).max()

    W = np.hstack([rom.basis @ model.coordinates[:, model.rigid :] for model in rom.contact_models.values()])
    beyond = (inverse - W @ np.linalg.lstsq(W.T @ K @ W, W.T, rcond=1e-12)[0]) @ S.T
    best = np.linalg.svd(scipy.linalg.cholesky(M) @ beyond, compute_uv=False)[12:]
    assert np.trace(X.T @ M @ X) <= 1.5 * np.sum(best**2)


def test_points_between_nodes_are_of_these_as_where_columns_are_made_of_them(mesh):
    """S, sparse, is what a matrix of all columns has, and Sᵀ of forces, too; to the last bit."""
    points = '[effects.contact]\npoints = "surface"\n'
    system = fr.assemble(acted_on(mesh, MOVING + points + BALLS, **PARTS))
    assert system.body.points_between is not None
    columns, rows = system.points_of_contact().columns(system.at_nodes), offline.PointRows(system)
    np.testing.assert_allclose(rows.at(np.eye(system.size)), columns.T, rtol=0, atol=1e-15)
    np.testing.assert_allclose(rows.forces(np.eye(rows.count)), columns, rtol=0, atol=1e-15)
    np.testing.assert_allclose(rows.columns(slice(3, 9)), columns[:, 3:9], rtol=0, atol=1e-15)
    assert np.array_equal(rows.untouched, ~columns.any(axis=1))


def test_where_nothing_is_named_a_body_that_is_touched_all_over_gets_eigenvectors(held, mesh, monkeypatch):
    """Told, and only there: with an order, a tolerance, or without residual compliance directions are balanced."""
    monkeypatch.setattr(reduction, "DEFAULT_MOST", 20)
    with warnings.catch_warnings(action="ignore", category=FenicsRomWarning):
        rom = fr.reduce(held.system)
        scene = acted_on(mesh, MOVING + FLOOR + "[effects.contact]\nresidual_compliance = false\n", **PARTS)
        others = fr.reduce(held.system, order=20), fr.reduce(held.system, tolerance=1e-2), fr.reduce(fr.assemble(scene))
    assert rom.method == "modal+static"
    assert [other.method for other in others] == ["balanced"] * 3
    points = max(map(len, held.system.contact_points.values()))
    assert sum(f"touched at {points} points in one contact mode the 20 lowest" in text for text in rom.warnings) == 1
    assert not any("lowest eigenvectors" in text for other in others for text in other.warnings)
    M, _, K = matrices(held)
    γ = scipy.linalg.eigh(K, M, eigvals_only=True)
    pushed = 1 + 3  # static shapes of what acts beside contact come first
    for model in rom.contact_models.values():
        assert model.order == 20
        np.testing.assert_allclose(model.eigenvalues[: 20 - pushed], γ[: 20 - pushed], rtol=1e-8)


def test_of_many_inputs_the_combinations_that_move_most_suffice(free, monkeypatch):
    """Balanced directions are those of all inputs to a part of what the order leaves out, and it is told."""
    with warnings.catch_warnings(action="ignore", category=FenicsRomWarning):
        whole = fr.reduce(free.system, order=5, lyapunov="krylov")
        monkeypatch.setattr(leading_inputs, "FEWEST", 20)
        monkeypatch.setattr(leading_inputs, "OVERSAMPLING", 5)
        few = fr.reduce(free.system, order=5, lyapunov="krylov")
    told = [text for text in few.warnings if "inputs the 20 combinations that move the body most" in text]
    assert len(told) == len(few.contact_models)
    assert not any("combinations that move" in text for text in whole.warnings)
    M = matrices(free)[0]
    for name, model in few.contact_models.items():
        others = whole.contact_models[name]
        np.testing.assert_allclose(model.hankel_singular_values[:5], others.hankel_singular_values[:5], rtol=0.01)
        W, V = (rom.basis @ rom.contact_models[name].coordinates for rom in (few, whole))
        assert np.linalg.svd(W.T @ M @ V, compute_uv=False)[-1] > 0.99
        assert model.static_error == pytest.approx(others.static_error, rel=0.01)


def test_triangular_matrices_are_inverted_by_halves():
    """To round-off of a matrix whose condition is small."""
    L = np.tril(np.random.default_rng(0).normal(size=(600, 600))) / 600 + np.eye(600)
    inverse = inverse_of_lower(L)
    assert np.array_equal(inverse, np.tril(inverse))
    np.testing.assert_allclose(inverse @ L, np.eye(600), rtol=0, atol=1e-13)


def test_columns_are_solved_for_in_blocks_of_any_size(held, monkeypatch):
    """To what the floor leaves open, and round-off of a sum."""
    monkeypatch.setattr(offline, "COLUMNS_AT_ONCE", 10)
    with warnings.catch_warnings(action="ignore", category=FenicsRomWarning):
        blocks, whole = fr.reduce(held.system, order=ORDER).residual_compliance, held.rom.residual_compliance
    assert len(whole.factor) > 3 * 10
    change = blocks.factor @ blocks.factor.T - whole.factor @ whole.factor.T
    assert np.abs(change).max() <= 2 * whole.floor
    assert blocks.time_constants[0] == pytest.approx(whole.time_constants[0], rel=1e-9)


def test_of_thousands_of_points_no_block_of_all_columns_is_needed(held, monkeypatch):
    """The same ROM, but for shapes that are not M-orthogonal: their mean τ² is that of orthogonal ones to 1 %."""
    monkeypatch.setattr(leading_inputs, "FEWEST", 10)
    roms = []
    for most_columns, most_rows in ((10**6, 10**6), (10, 0)):
        for module in (full_order, validation):
            monkeypatch.setattr(module, "MOST_FORCES", most_columns)
        monkeypatch.setattr(full_order, "FORCES_AT_ONCE", 7)
        monkeypatch.setattr(offline, "MOST_ROWS", most_rows)
        with warnings.catch_warnings(action="ignore", category=FenicsRomWarning):
            roms.append(fr.reduce(held.system, order=ORDER))
    assert len(list(held.system.force_blocks("bottom"))) > 3
    whole, blocks = roms
    for contact, model in whole.contact_models.items():
        assert blocks.contact_models[contact].static_error == pytest.approx(model.static_error, rel=1e-8)
        for error in ("transfer_errors", "eigenvalues"):
            values = getattr(model, error)
            np.testing.assert_allclose(getattr(blocks.contact_models[contact], error), values, rtol=1e-6)
        one, other = (held.part(contact, rom) for rom in roms)
        np.testing.assert_allclose(other.compliance, one.compliance, atol=1e-8 * np.abs(one.compliance).max())
        assert other.time_constant == pytest.approx(one.time_constant, rel=1e-2)


def test_delassus_operator_is_nearer_that_of_the_full_model(mesh):
    """At steps that resolve what the basis lacks, and that do not; the errors told are those of some columns."""
    models = Models(mesh, MOVING + FLOOR, run="dt = 2e-3\nduration = 0.1")
    M, D, K = matrices(models)
    model, S = models.rom.contact_models["bottom"], models.rows
    part, W = models.part("bottom"), S @ models.rom.basis @ model.coordinates
    for h in (1e-5, 1e-4, 2e-3, 2e-2):
        full = S @ np.linalg.solve(2 / h * M + D + h / 2 * K, S.T)
        reduced = W / (2 / h + model.damping + h / 2 * model.eigenvalues) @ W.T
        a = residual_motion.relaxation(h, part.time_constant, models.rom.residual_compliance.damping).whole
        without, beside = (
            np.linalg.norm(W - full) / np.linalg.norm(full) for W in (reduced, reduced + part.compliance / a)
        )
        assert beside < (0.5 if h > 1e-4 else 1.0) * without
        if h == models.rom.residual_compliance.dt:
            assert models.rom.residual_compliance.errors["bottom"] == pytest.approx((without, beside), rel=0.3)


RELAXING = "[effects.viscoelasticity]\nratios = [0.5, 0.3]\ntimes = [2e-3, 0.1]\n"


@pytest.mark.parametrize("moving", [MOVING, MOVING + RELAXING, ""], ids=["moving", "relaxing", "equilibria"])
def test_errors_that_are_told_are_those_of_dense_matrices(mesh, moving, monkeypatch):
    """Of all columns; between equilibria nothing is off but for the floor."""
    monkeypatch.setattr(offline, "POINTS_COMPARED", 1000)
    h, models = 2e-3, Models(mesh, moving + FLOOR, run="dt = 2e-3\nduration = 0.1")
    (M, D, K), S, rom, series = matrices(models), models.rows, models.rom, models.rom.environment.viscoelasticity
    stiffening = 0.0 if series is None else series.stiffening_time(h)
    full = S @ np.linalg.solve(2 / h * M + D + (h / 2 + stiffening) * K if moving else h * K, S.T)
    assert list(rom.residual_compliance.errors) == list(rom.contact_models)
    for contact, (without, beside) in rom.residual_compliance.errors.items():
        model, part = rom.contact_models[contact], models.part(contact)
        W, γ, β = S @ rom.basis @ model.coordinates, model.eigenvalues, rom.residual_compliance.damping
        reduced = W / (2 / h + model.damping + (h / 2 + stiffening) * γ if moving else h * γ) @ W.T
        a = residual_motion.relaxation(h, part.time_constant, β, stiffening).whole if moving else h
        off, off_beside = (
            np.linalg.norm(W - full) / np.linalg.norm(full) for W in (reduced, reduced + part.compliance / a)
        )
        assert without == pytest.approx(off, rel=1e-6)
        assert beside == pytest.approx(off_beside, rel=1e-6, abs=1e-9)
        assert moving or beside < 1e-5 < 1e-2 < without


def test_beside_eigenvectors_it_moves_by_itself(mesh):
    """Then static shapes are of loads alone, and no mass couples eigenvectors to it: W is nearer that of full order.

    Other bases share mass with what contact points yield beyond them, which is neglected.
    """
    order = 24
    models = Models(mesh, MOVING + PUSH + FLOOR, order, run="dt = 2e-3\nduration = 0.1")
    with warnings.catch_warnings(action="ignore", category=FenicsRomWarning):
        rom = fr.reduce(models.system, method="modal+static", order=order)
    M, _, K = matrices(models)
    static = np.linalg.solve(K, models.system.loads["push"])
    Φ = scipy.linalg.eigh(K, M)[1][:, : order - static.shape[1]]
    for model in rom.contact_models.values():
        W = rom.basis @ model.coordinates
        for expected in (static, Φ):
            lacking = expected - W @ (W.T @ M @ expected)
            assert np.linalg.norm(lacking) < 1e-9 * np.linalg.norm(expected)
    beside = rom.residual_compliance.errors["bottom"][1]
    assert beside < 0.75 * models.rom.residual_compliance.errors["bottom"][1]

    def shared(of):
        """Of mass of the basis' own motions and the residual shapes, relative."""
        X = shapes_lacking(models, of, "bottom")
        return np.linalg.norm(Φ.T @ M @ X) / np.sqrt(np.trace(X.T @ M @ X))

    assert shared(rom) < 1e-9 < 1e-2 < shared(models.rom)


def test_damping_of_other_kinds_dissipates_alike(mesh):
    """Of all residual shapes together; here a dashpot adds to β."""
    oil = '[effects.damping.dashpots.oil]\nsurface = "bottom"\ncoefficient = 3.0\n'
    damped = Models(mesh, "inertia = {}\n[effects.damping]\nalpha = 0.5\nbeta = 1e-3\n" + oil + FLOOR)
    assert Models(mesh, MOVING + FLOOR).rom.residual_compliance.damping == 1e-3
    assert damped.rom.residual_compliance.damping > 1e-3
    none = acted_on(mesh, "inertia = {}\n" + FLOOR, **PARTS)
    assert fit_environment(damped.rom, none.environment, None)[0].residual_compliance.damping == 0


def test_a_scene_that_wants_none_gets_none(mesh, held, tmp_path):
    off = FLOOR.replace("[effects.contact.obs", "[effects.contact]\nresidual_compliance = false\n[effects.contact.obs")
    models = Models(mesh, MOVING + off)
    assert models.rom.residual_compliance is None
    fr.write_rom(tmp_path / "rom.h5", models.rom)
    assert fr.read_rom(tmp_path / "rom.h5") == models.rom
    with pytest.raises(SceneError, match="residual_compliance: ROM 'scene' was made without it; to have it, make"):
        fr.Simulator(models.rom, 1e-3, scene=acted_on(mesh, MOVING + FLOOR, **PARTS))


def test_without_it_no_bit_changes(held):
    """Switched off in the scene, or not there: the same run."""
    runs = [Reduced(held.rom, scene=held.without), Reduced(replace(held.rom, residual_compliance=None))]
    for run in runs:
        run.shake(120, seed=3)
    np.testing.assert_array_equal(*(run.body.displacement() for run in runs))
    assert runs[0].body.ledger.sums == runs[1].body.ledger.sums


# --- the step --------------------------------------------------------------------------------------------------------


class Reduced:
    """A body that is pushed about over obstacles that move."""

    def __init__(self, rom, scene=None, seed=0):
        a, b, c = np.random.default_rng(seed).uniform(1, 30, 3)
        signals = {
            "push": lambda t: [20 * np.sin(b * t), 5.0, -40 * np.cos(c * t)],
            "ball": lambda t: [-0.02 * np.sin(a * t) ** 2, 0.02 * np.sin(b * t), 0.0],
            "other": lambda t: [0.05 * np.sin(b * t), 0.0, 0.006 * np.sin(c * t) ** 2],
            "floor": lambda t: [0.05 * np.sin(b * t), 0.0, 0.004 * np.sin(c * t) ** 2],
        }
        known = {*rom.loads, *rom.environment.obstacles}
        self.rom = rom
        self.body = fr.Simulator(rom, 1e-3, scene=scene, signals={k: s for k, s in signals.items() if k in known})
        self.modes = list(rom.contact_models)

    def shake(self, steps, seed, switch=True, least=1e-6, most=1e-1):
        """Largest gap of the account, and of energy gained in switches, as shares of the scale; steps of any length."""
        random, body = np.random.default_rng(seed), self.body
        gap = scale = gained = jump = friction = contact = 0.0
        is_rigid = self.rom.environment.contact_law.stiffness is None  # springs give back
        for step in range(steps):
            body.dt = np.exp(random.uniform(np.log(least), np.log(most)))
            body.step()
            account = body.ledger
            if switch:
                before, points = body.energy, body._stepper.point_displacement()
                body.switch(self.modes[step % len(self.modes)])
                gained = max(gained, body.energy - before)
                jump = max(jump, np.abs(body._stepper.point_displacement() - points).max() / np.abs(points).max())
            spent = account.dissipated + account.lost_in_switching + account.numerical
            gap = max(gap, abs(body.energy - account.supplied + spent))
            scale = max(scale, body.energy, abs(account.supplied), account.dissipated)
            assert account.friction >= friction - 1e-9 * scale
            assert not is_rigid or account.contact >= contact - 1e-9 * scale
            friction, contact = account.friction, account.contact
        assert friction > 0
        return gap / scale, gained / scale, jump


@pytest.mark.parametrize("seed", range(4))
def test_account_closes_and_switches_neither_add_energy_nor_move_points(models, seed):
    """Steps from 1e-6 to 0.1 s, a switch at every step; impacts and friction only take."""
    run = Reduced(models.rom, seed=seed)
    gap, gained, jump = run.shake(150, seed)
    assert run.body.ledger.contact > 0
    assert gap <= CLOSES_TO
    assert gained <= CLOSES_TO
    assert jump <= 1e-9  # C⁻¹ of R = C Cᵀ has round-off times the root of its condition, some 1e4


def test_switches_add_no_energy_where_a_shared_basis_lacks_nothing(tmp_path):
    """One by one and in batches. Clamped points then yield 1e-12 as much as others, of which round-off is 1e-4."""
    box = write_arrays(tmp_path / "box.msh", *box_arrays(LENGTHS, (3, 2, 1)))
    contacts = "\n".join(f'[contacts.{face}]\nsurface = "{face}"' for face in ("bottom", "right", "top"))
    models, random = Models(box, MOVING + FLOOR, order=3, contacts=contacts), np.random.default_rng(0)
    model, parts = models.rom.contact_models["right"], [models.part(contact) for contact in ("right", "top")]
    stiffest, *_, softest = np.linalg.eigvalsh(R := parts[0].compliance)
    assert 1e13 * stiffest > softest > 1e10 * stiffest
    start, end = (residual_motion.ResidualMotion(part, 0.0, True) for part in parts)
    many = BatchResidual([SimpleNamespace(part=part, model=model, S=R) for part in parts], 0, np.eye(3), 20)
    e_start, e = 1e-3 * random.standard_normal((20, 3)), np.zeros((20, 3))
    g, rate = random.standard_normal((20, len(R))), 1e3 * random.standard_normal((20, len(R)))
    many.state[:] = np.stack([g, g @ R, rate, rate @ R]).swapaxes(1, 2)
    before, after = many.stored(np.arange(20), np.zeros(20, int)), np.zeros(20)
    for k, state in enumerate(many.state.transpose(2, 0, 1)):
        start.resume(state.ravel())
        end.carry_over(e[k], start, e_start[k])
        after[k] = end.stored
    e_many = many.carry_over(0, 1, np.arange(20), e_start)
    before += np.square(e_start).sum(axis=1) / 2
    for strained, residual in ((e, after), (e_many, many.stored(np.arange(20), np.ones(20, int)))):
        assert (residual + np.square(strained).sum(axis=1) / 2 - before).max() <= CLOSES_TO * before.max()


@pytest.mark.parametrize("law", ["rigid", "springs"])
@pytest.mark.parametrize("moving", [MOVING, ""], ids=["inertia", "equilibria"])
def test_account_closes_with_springs_and_without_inertia(mesh, moving, law):
    """The same, of a body that two obstacles touch on other patches than the floor's."""
    obstacles = FLOOR + BALLS if law == "rigid" else (FLOOR + BALLS).replace("[effects", SPRINGS + "[effects", 1)
    run = Reduced(Models(mesh, moving + PUSH + obstacles + ROUGH).rom)
    gap, gained, jump = run.shake(150, seed=0)
    assert gap <= CLOSES_TO
    assert gained <= CLOSES_TO
    assert jump <= 1e-9


def test_springs_in_place_of_the_rigid_law_see_it_too(mesh):
    """Penalty contact under a push that comes and goes: the account, and forces nearer the full model's."""
    models = Models(mesh, MOVING + PUSH + SPRINGS + FLOOR + ROUGH, run="dt = 2e-3\nduration = 0.2\nsnapshots = 20")
    signals = {"push": lambda t: [0.0, 0.0, -200 * np.sin(15 * t) ** 2]}
    full = fr.simulate(models.system, signals=signals)
    runs = [fr.simulate(models.rom, scene=scene, signals=signals) for scene in (None, models.without)]
    off, off_without = (np.linalg.norm(run.forces["floor"] - full.forces["floor"]) for run in runs)
    assert off < 0.5 * off_without
    assert all(run.balance_error <= CLOSES_TO for run in (full, *runs))


def broken_sign(monkeypatch):
    good = residual_motion.residual_part

    def of(*given):
        part = good(*given)
        object.__setattr__(part, "operator", -part.operator)
        return part

    monkeypatch.setattr(residual_motion, "residual_part", of)


def broken_switch(monkeypatch):
    def carry_over(self, e, start, e_start):
        e[:] = 0.0
        e[: min(len(e), len(e_start))] = e_start[: min(len(e), len(e_start))]
        self.state[:] = start.state

    monkeypatch.setattr(residual_motion.ResidualMotion, "carry_over", carry_over)


@pytest.mark.parametrize("broken", [broken_sign, broken_switch])
def test_laws_notice_what_is_broken(held, monkeypatch, broken):
    broken(monkeypatch)
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        try:
            gap, gained, jump = Reduced(held.rom).shake(100, 0)
        except (AssertionError, fr.FenicsRomError):
            return
    assert gap > CLOSES_TO or gained > CLOSES_TO or jump > 1e-9


def test_without_inertia_contact_is_that_of_the_full_model_at_any_order(mesh):
    """At rest the residual compliance is all that the basis lacks; but for the floor, a share of 1e-6."""
    models = Models(mesh, FLOOR + ROUGH, order=3, run="dt = 0.1\nduration = 0.5\nsnapshots = 5")
    rises = {"floor": lambda t: [0.002 * t, 0.0, 0.02 * t]}
    full = fr.simulate(models.system, signals=rises)
    runs = [fr.simulate(models.rom, scene=scene, signals=rises) for scene in (None, models.without)]
    off, off_without = (np.abs(run.forces["floor"] - full.forces["floor"]).max() for run in runs)
    assert off <= 1e-5 * np.abs(full.forces["floor"]).max() <= 1e-3 * off_without
    moved = full.snapshots[:, models.system.points_of_contact().nodes]
    off, off_without = (np.abs(run.snapshots[:, models.system.points_of_contact().nodes] - moved).max() for run in runs)
    assert off <= 1e-5 * np.abs(moved).max() <= 1e-3 * off_without
    off, off_without = (np.abs(run.snapshots - full.snapshots).max() for run in runs)  # of all nodes
    assert off <= 10 * offline.UNSEEN * np.abs(full.snapshots).max() <= 0.1 * off_without


def test_without_inertia_loads_are_those_of_the_full_model_at_an_order_of_as_many(mesh):
    """Forces on nodes that obstacles can touch bend the body more, and took the places of the shapes of loads."""
    weight = "[effects.gravity]\nacceleration = [0.0, 0.0, -9.81]\n"
    models = Models(mesh, PUSH + weight + FLOOR + ROUGH, order=4, run="dt = 0.1\nduration = 0.5\nsnapshots = 5")
    signals = {"push": lambda t: [10 * t, 5 * t, -30 * t]}
    full, reduced = (fr.simulate(model, signals=signals) for model in (models.system, models.rom))
    forces, points = full.forces["floor"], models.system.points_of_contact().nodes
    assert np.abs(reduced.forces["floor"] - forces).max() <= 1e-5 * np.abs(forces).max()
    moved = full.snapshots[:, points]
    assert np.abs(reduced.snapshots[:, points] - moved).max() <= 1e-5 * np.abs(moved).max()


def test_shapes_have_the_points_where_obstacles_find_them(models, monkeypatch):
    """Also after switches, which move no point; nodes that nothing can touch are in the shared basis."""
    monkeypatch.setattr(offline, "UNSEEN", 1.0)  # so that it lacks more than round-off
    with warnings.catch_warnings(action="ignore", category=FenicsRomWarning):
        rom = fr.reduce(models.system, order=ORDER)
    run = Reduced(rom)
    run.shake(60, seed=5)
    body, nodes = run.body, run.body.contact_points
    there = body._stepper.point_displacement()[: len(nodes)]
    np.testing.assert_allclose(body.displacement()[nodes], there, rtol=0, atol=1e-12 * np.abs(there).max())
    others = np.setdiff1d(np.arange(len(rom.nodes)), nodes)
    shape = rom.reconstruct(body.shape_coordinates)
    np.testing.assert_array_equal(body.displacement()[others], shape[others])
    assert np.abs(shape[nodes] - there).max() > 1e-9 * np.abs(there).max()


def test_forces_and_shape_of_several_patches_are_nearer_the_full_model(mesh):
    """Two balls on two patches, and a third on no patch's centre, pushed in at once."""
    third = '[effects.contact.obstacles.third]\nshape = "sphere"\ncenter = [0.3, 0.0, -0.05]\nradius = 0.045\n'
    effects = MOVING + BALLS + third + ROUGH
    models = Models(mesh, effects, run="dt = 2e-3\nduration = 0.3\nsnapshots = 30")
    signals = {
        name: (lambda t, d=d: [d[0] * min(t / 0.2, 1.0), 0.0, d[1] * min(t / 0.2, 1.0)])
        for name, d in (("ball", (-0.012, 0.0)), ("other", (0.0, 0.012)), ("third", (0.0, 0.012)))
    }
    full = fr.simulate(models.system, signals=signals)
    runs = [fr.simulate(models.rom, signals=signals), fr.simulate(models.rom, scene=models.without, signals=signals)]
    yielding, stiff = (
        [np.linalg.norm(run.forces[o] - full.forces[o]) / np.linalg.norm(full.forces[o]) for o in full.forces]
        for run in runs
    )
    shapes = [np.linalg.norm(run.snapshots - full.snapshots) / np.linalg.norm(full.snapshots) for run in runs]
    assert max(yielding) < 0.1 * max(stiff)
    assert shapes[0] < 0.5 * shapes[1]


# --- saved -----------------------------------------------------------------------------------------------------------


def test_it_is_saved_reset_and_copied(held, tmp_path):
    run = Reduced(held.rom)
    run.shake(60, seed=1)
    there, shape = run.body.save(), run.body.displacement()
    run.shake(20, seed=2)
    run.body.restore(there)
    np.testing.assert_array_equal(run.body.displacement(), shape)
    other = copy.copy(run.body)
    fr.write_rom(tmp_path / "rom.h5", held.rom)
    read = fr.read_rom(tmp_path / "rom.h5")
    assert read == held.rom
    for body in (run.body, other):
        body.dt = 1e-3
        for _ in range(20):
            body.step()
    np.testing.assert_array_equal(run.body.displacement(), other.displacement())
    run.body.reset()
    assert run.body.energy == 0.0
    assert not run.body._stepper.point_displacement().any()


def test_info_says_what_is_kept_and_what_is_left_out(held, tmp_path, capsys):
    residual = held.rom.residual_compliance
    less = replace(residual, factor=residual.factor[:, :-4], time_constants=residual.time_constants[:-4])
    measured = replace(residual, dt=1e-3, errors={"right": (0.4, 0.05)})
    points, kept = residual.factor.shape
    for known, said in (
        (residual, f"{kept} of {points} directions are stored"),
        (less, f"each of the others yields less than {residual.floor:.1e} m/N"),
        (measured, "off full order's by 5.0e-02 in a step of 0.001 s (4.0e-01 without them"),
        (
            fr.truncate(replace(held.rom, residual_compliance=measured), 3).residual_compliance,
            "or the ROM was truncated",
        ),
    ):
        fr.write_rom(tmp_path / "rom.h5", replace(held.rom, residual_compliance=known))
        with pytest.raises(SystemExit, match="0"):
            main(["info", str(tmp_path / "rom.h5")])
        assert said in " ".join(capsys.readouterr().out.split())
