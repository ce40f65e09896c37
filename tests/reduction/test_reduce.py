"""System to ROM: all routes agree, all modes kept is the full model, and errors fall as σ say."""

import itertools
import warnings
from dataclasses import replace

import numpy as np
import pytest
from bodies import assembled, scene_text, write_box

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning, SceneError, SolverError
from fenics_rom.fem.linear_stepper import FullOrderStepper
from fenics_rom.reduction import reduce as reduction
from fenics_rom.reduction.balancing import balance
from fenics_rom.reduction.gramians import gramian_factors
from fenics_rom.reduction.reduce import DENSE_LIMIT
from fenics_rom.rom.rom import check_rom
from fenics_rom.scene.file import parse_scene

LOADED = "dt = 0.01\nduration = 1.0\nload = [{contact = 'right', stop = 0.3, force = [0.0, 0.0, 1.0]}]"


def transfer(rom, name, frequencies):
    """y = C x over u of one contact mode, for all outputs in shared coordinates."""
    mode = rom.contact_models[name]
    D = np.diag(mode.damping) if mode.damping.ndim == 1 else mode.damping
    values = []
    for ω in frequencies:
        dynamic = np.diag(mode.eigenvalues - ω**2).astype(complex) + 1j * ω * D
        values.append(rom.basis @ (mode.coordinates @ np.linalg.solve(dynamic, mode.inputs)))
    return np.array(values)


def full_transfer(system, name, frequencies):
    identity = np.eye(system.size)
    M, D, K = (A @ identity for A in (system.mass, system.damping, system.stiffness))
    B = system.input_matrix(name)
    return np.array([np.linalg.solve(-(ω**2) * M + 1j * ω * D + K, B) for ω in frequencies])


@pytest.fixture(scope="module")
def frequencies(box_system):
    ω = np.sqrt(box_system.algebra.eigenpairs(box_system.mass, box_system.stiffness, 12)[0])
    return np.concatenate([[0.0, ω[0] / 3], (ω[:-1] + ω[1:]) / 2, ω])


def with_damping(system, α, β):
    """The same body damped otherwise: D = α M + β K is all that changes."""

    class Damping:
        def __matmul__(self, block):
            return α * (system.mass @ block) + β * (system.stiffness @ block)

    return replace(system, damping=Damping(), rayleigh=(α, β))


DAMPINGS = {"heavy": (0.5, 1e-2), "light": (0.1, 1e-6), "alpha only": (1.0, 0.0), "beta only": (0.0, 1e-3)}


@pytest.mark.parametrize("damping", DAMPINGS.values(), ids=DAMPINGS)
@pytest.mark.parametrize("weighting", ["mass", "nodal", "outputs"])
def test_hankel_singular_values_agree_between_all_routes(box_system, damping, weighting):
    points = replace(box_system, outputs={"all": box_system.contacts["top"]})
    system = with_damping(points, *damping)
    σ = {
        route: fr.reduce(system, order=8, weighting=weighting, lyapunov=route)
        .contact_models["right"]
        .hankel_singular_values
        for route in ("closed-form", "bartels-stewart", "krylov")
    }
    np.testing.assert_allclose(σ["krylov"][:8], σ["closed-form"][:8], rtol=1e-6)
    np.testing.assert_allclose(σ["bartels-stewart"][:8], σ["closed-form"][:8], rtol=1e-6)


@pytest.mark.parametrize("route", ["closed-form", "krylov"])
def test_routes_give_the_same_transfer_function(box_system, frequencies, route):
    reference = transfer(fr.reduce(box_system, order=10, lyapunov="bartels-stewart"), "top", frequencies)
    other = transfer(fr.reduce(box_system, order=10, lyapunov=route), "top", frequencies)
    assert np.abs(other - reference).max() <= 1e-7 * np.abs(reference).max()


def test_error_falls_with_the_order_and_is_measured(box_system, frequencies):
    exact = full_transfer(box_system, "right", frequencies)
    errors, statics = [], []
    for order in (4, 8, 16, 32):
        rom = fr.reduce(box_system, order=order)
        gap = np.abs(transfer(rom, "right", frequencies) - exact)
        errors.append(gap.max() / np.abs(exact).max())
        statics.append(rom.validation["right"]["static_error"])
    assert errors[0] < 0.1
    assert all(later < earlier / 4 for earlier, later in itertools.pairwise(errors)), errors
    assert all(later < earlier / 4 for earlier, later in itertools.pairwise(statics)), statics


@pytest.mark.parametrize("method", ["eigenvector-selection", "balanced"])
def test_all_modes_kept_is_the_full_model(box_file, method):
    """Nodal forces on half of the nodes reach every motion, so that nothing is left out."""
    contacts = '[contacts.right]\nsurface = "right"\n[contacts.top]\nsurface = "top"\nforce = "nodal"'
    scene = parse_scene(scene_text(box_file, contacts=contacts, run=LOADED))
    system = fr.assemble(scene)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FenicsRomWarning)
        rom = fr.reduce(system, order=system.size, method=method, share=1.0 if "selection" in method else None)
    assert rom.contact_models["top"].order == system.size
    random = np.random.default_rng(0)
    reduced, full = fr.Simulator(rom, dt=0.01), FullOrderStepper(system, 0.01)
    reduced.switch("top")
    B = system.input_matrix("top")
    gap = size = 0.0
    for _ in range(200):
        u = random.standard_normal(B.shape[1])
        reduced.step(u)
        full.step_under(B @ u)
        gap = max(gap, np.abs(reduced.displacement() - full.displacement()).max())
        size = max(size, np.abs(full.displacement()).max())
    full.close()
    assert gap <= 1e-9 * size
    assert reduced.energy == pytest.approx(full.energy, rel=1e-9)


@pytest.mark.slow
def test_krylov_and_modal_selection_on_a_body_too_large_to_be_dense(tmp_path):
    mesh = write_box(tmp_path / "beam.msh", (1.0, 0.1, 0.1), (24, 3, 3))
    system = fr.assemble(parse_scene(scene_text(mesh)))
    assert system.size > DENSE_LIMIT
    krylov = fr.reduce(system, order=12)
    dense = fr.reduce(system, order=12, lyapunov="closed-form")
    for name, mode in krylov.contact_models.items():
        σ = dense.contact_models[name].hankel_singular_values[:12]
        np.testing.assert_allclose(mode.hankel_singular_values[:12], σ, rtol=1e-6)
    modal, reference = (
        fr.reduce(system, order=12, method="eigenvector-selection", share=0.9999, lyapunov=route)
        for route in ("krylov", "closed-form")
    )
    for name, mode in modal.contact_models.items():
        np.testing.assert_allclose(mode.eigenvalues, reference.contact_models[name].eigenvalues, rtol=1e-7)


def test_selection_grows_until_the_share_is_held(box_system):
    """From a Krylov space and 60 eigenvectors to begin with, the same selection as from all of them."""
    grown, whole = (
        fr.reduce(box_system, order=10, method="eigenvector-selection", share=1 - 1e-9, lyapunov=route)
        for route in ("krylov", "closed-form")
    )
    for name, mode in grown.contact_models.items():
        assert mode.order > 60
        np.testing.assert_allclose(mode.eigenvalues, whole.contact_models[name].eigenvalues, rtol=1e-9)


def test_selection_shares_its_eigenvectors_with_many_inputs(box_file):
    """More than 24 columns begin with 100 eigenvectors, a selection with 60."""
    system = assembled(box_file, contacts='[contacts.right]\nsurface = "right"\nforce = "nodal"')
    assert system.input_matrix("right").shape[1] > 24
    grown, whole = (
        fr.reduce(system, order=10, method="eigenvector-selection", share=0.999, lyapunov=route)
        for route in ("krylov", "closed-form")
    )
    γ = whole.contact_models["right"].eigenvalues
    np.testing.assert_allclose(grown.contact_models["right"].eigenvalues, γ, rtol=1e-8)


def test_eigenvectors_hold_the_share_of_the_trace_that_was_asked_for(box_system):
    """C = VᵀMT Σ (VᵀMT)ᵀ (12)-(13): the trace without V is that with all of V, and no smaller selection is enough."""
    order, share = 10, 0.9999
    balanced = fr.reduce(box_system, order=order)
    selected = fr.reduce(box_system, order=order, method="eigenvector-selection", share=share)
    γ, V = box_system.algebra.eigenpairs(box_system.mass, box_system.stiffness, box_system.size)
    for name, mode in selected.contact_models.items():
        d = 1.0 + 1e-3 * γ
        b = balance(*gramian_factors(γ, d, V.T @ box_system.input_matrix(name), np.eye(len(γ))))
        T, σ = b.transformation[:, :order], b.singular_values[:order]
        C = np.sort(np.diag(T @ np.diag(σ) @ T.T))[::-1]
        assert C[: mode.order].sum() >= share * C.sum() > C[: mode.order - 1].sum()
        np.testing.assert_allclose(balanced.contact_models[name].hankel_singular_values[:order], σ, rtol=1e-9)


def test_bases_are_orthonormal_in_mass_and_stiffness(box_system):
    rom = fr.reduce(box_system, order=15)
    check_rom(rom)
    Q = rom.basis
    np.testing.assert_allclose(Q.T @ (box_system.mass @ Q), np.eye(Q.shape[1]), atol=1e-12)
    strained = Q / np.sqrt(rom.stiffness)
    np.testing.assert_allclose(strained.T @ (box_system.stiffness @ strained), np.eye(Q.shape[1]), atol=1e-9)
    for name, mode in rom.contact_models.items():
        W = Q @ mode.coordinates
        np.testing.assert_allclose(mode.inputs, W.T @ box_system.input_matrix(name), atol=1e-12)
        np.testing.assert_allclose(mode.damping, 1.0 + 1e-3 * mode.eigenvalues)


def test_actuators_are_in_every_mode(box_system):
    rom = fr.reduce(box_system, order=6)
    assert rom.actuators == {"pull": 1}
    assert rom.contacts == {"right": 3, "top": 3}
    assert all(mode.inputs.shape[1] == 4 for mode in rom.contact_models.values())


def test_order_beyond_what_is_there_warns_and_says_what_was_kept(box_system):
    with pytest.warns(FenicsRomWarning, match=r"order 500 was asked for, \d+ are numerically there and were kept"):
        rom = fr.reduce(box_system, order=500)
    assert all(mode.order <= box_system.size for mode in rom.contact_models.values())
    assert len(rom.warnings) == len(rom.contact_models)


def test_an_order_that_was_not_given_is_bounded_and_told(box_system, monkeypatch):
    """A whole skin that may touch asks for all directions there are; who names a tolerance gets what it asks for."""
    monkeypatch.setattr(reduction, "DEFAULT_MOST", 4)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FenicsRomWarning)
        bounded, asked = fr.reduce(box_system), fr.reduce(box_system, tolerance=1e-6)
    for name, model in bounded.contact_models.items():
        assert model.order == 4
        many = asked.contact_models[name].order
        assert many > 4
        assert any(f"{name!r}: order 4 is kept" in text and f"it would be {many};" in text for text in bounded.warnings)
    assert not any("is kept, as none was given" in text for text in asked.warnings)


def test_tolerance_chooses_the_order(box_system):
    for tolerance in (1e-2, 1e-4, 1e-6):
        for mode in fr.reduce(box_system, tolerance=tolerance).contact_models.values():
            σ, m = mode.hankel_singular_values, mode.order
            assert σ[m:].sum() <= tolerance * σ.sum() < σ[m - 1 :].sum()


def test_krylov_space_that_does_not_settle_says_so(box_system, monkeypatch):
    monkeypatch.setattr("fenics_rom.reduction.krylov.MAX_VECTORS", 6)
    with pytest.warns(
        FenicsRomWarning, match=r"or frequency responses are known to \de[-+]\d+ only, as the largest Krylov space"
    ):
        fr.reduce(box_system, order=6, lyapunov="krylov")


def test_orders_by_name(box_system):
    rom = fr.reduce(box_system, order={"right": np.int64(5), "top": 9})
    assert {name: mode.order for name, mode in rom.contact_models.items()} == {"right": 5, "top": 9}


@pytest.mark.parametrize(
    ("choice", "message"),
    [
        ({"order": {"right": 5}}, "'top' has no order"),
        ({"order": {"right": 5, "tap": 5}}, "did you mean 'top'"),
        ({"switching": "enrgy"}, "did you mean 'energy'"),
        ({"weighting": "outputs"}, "names no outputs"),
        ({"lyapunov": "magic"}, "no choice 'magic'"),
        ({"order": 0}, "order = 0: use a whole number >= 1"),
        ({"order": 2.5}, "order = 2.5: use a whole number >= 1"),
        ({"order": {"right": 5, "top": -1}}, "order.top = -1"),
        ({"tolerance": -1.0}, "tolerance = -1.0: use"),
        ({"method": "eigenvector-selection", "share": 2.0}, "share = 2.0: use"),
        ({"share": 0.9}, "share = 0.9: goes with method = 'eigenvector-selection', not with 'balanced'"),
        ({"cubature": 0.1}, "cubature = 0.1: goes with effects.large_deformation, which the body has not"),
    ],
)
def test_choices_that_do_not_fit_are_refused(box_system, choice, message):
    with pytest.raises(SceneError, match=message):
        fr.reduce(box_system, **choice)


def test_what_is_no_system_is_refused(box_system):
    with pytest.raises(SceneError, match=r"type Scene was given; use a System, as of fr.assemble\(scene\)"):
        fr.reduce(box_system.scene)


def test_undamped_motion_has_no_gramian_and_the_error_says_what_to_do(box_system):
    with pytest.raises(SolverError, match=r"needs damping.*alpha or beta above 0"):
        fr.reduce(with_damping(box_system, 0.0, 0.0), order=4)


@pytest.mark.parametrize("columns", ["identical", "nested", "dependent"])
def test_contact_modes_may_share_everything(box_system, columns):
    right = box_system.contacts["right"]
    other = {"identical": right, "nested": right[:, :1], "dependent": np.hstack([right, right[:, :2] * 2])}[columns]
    rom = fr.reduce(replace(box_system, contacts={"one": right, "two": other}), order=6)
    simulator = fr.Simulator(rom, dt=0.01)
    for _ in range(20):
        simulator.step([0.1, 0.2, 0.3, 0.0])
    before = simulator.displacement()
    simulator.switch("two")
    if columns == "identical":
        np.testing.assert_allclose(simulator.displacement(), before, atol=1e-9 * np.abs(before).max())
    assert simulator.ledger.lost_in_switching >= -1e-14 * simulator.ledger.supplied
