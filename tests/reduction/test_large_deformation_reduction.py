"""Large deformation reduced: the basis, the points and weights, what follows, and what is said of it."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize
from bodies import assembled, box_arrays, write_arrays
from soft_box import SoftStepper, soft_box
from soft_rom import soft_rom

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning, FileError, SceneError, SolverError, StepError
from fenics_rom.io.stages import Stages
from fenics_rom.mechanics.fibres import Fibres
from fenics_rom.mechanics.hyperelastic import linear_stress
from fenics_rom.mechanics.isochoric import LAWS
from fenics_rom.mechanics.step import StepInput
from fenics_rom.reduction.common_basis import CommonBasis
from fenics_rom.reduction.hyperreduction.cubature import STIFFNESS_SHARE, fit_cubature, sparse_weights, spread_states
from fenics_rom.reduction.hyperreduction.modal_derivatives import second_order, static_derivatives
from fenics_rom.reduction.hyperreduction.reduce import check_law, validation_error
from fenics_rom.reduction.hyperreduction.training import plan_runs
from fenics_rom.reduction.hyperreduction.training_loads import load_extremes, slowest_period, training_targets
from fenics_rom.reduction.problem import ReductionProblem
from fenics_rom.rom.deformation import ReducedDeformation, monomials
from fenics_rom.runtime.steppers.equilibrium import Equilibrium
from fenics_rom.scene.file import parse_scene

RUN = """
dt = 0.02
duration = 1.0
load = [
  { contact = "tip", stop = 0.5, force = [0.0, 0.2, -0.25] },
  { actuator = "cable", start = 0.2, stop = 0.8, force = [1.75] },
  { actuator = "air", start = 0.4, force = [75.0] },
]"""
SIZE, BRICKS = (0.3, 0.02, 0.02), (10, 1, 1)
METHODS = ("trained", "modal+derivatives")
RESTING = {"effects": "", "run": 'dt = 0.1\nduration = 1.0\nload = [{ contact = "tip", force = [0.0, 0.05, -0.15] }]'}


def box(**choices):
    return soft_box(SIZE, BRICKS, choices.pop("run", RUN), **{"beta": 5e-3} | choices)


def problem_of(system, **choices):
    return ReductionProblem(
        **{
            "system": system,
            "factor": system.algebra.factor((1.0, system.stiffness)),
            "space": CommonBasis(system),
            "contacts": tuple(system.contacts),
            "order": 8,
            "tolerance": 1e-4,
            "switching": "energy",
            "weighting": "mass",
            "lyapunov": "krylov",
            "share": 0.999,
            "stages": Stages(),
            "messages": [],
        }
        | choices
    )


@pytest.fixture(scope="module")
def system():
    return box()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("checkpoints") / "trained"


@pytest.fixture(scope="module")
def roms(system, folder):
    found = {}
    for method in METHODS:
        found[method] = fr.reduce(system, order=16, method=method, checkpoint=folder if method == "trained" else None)
    return found


@pytest.fixture(params=METHODS)
def rom(roms, request):
    return roms[request.param]


def whole_body(system, rom):
    """The reduced model with all points."""
    body = system.deformation
    return replace(
        rom.deformation,
        gradients=body.gradients(rom.basis),
        weights=body.weights,
        first_lame=body.first_lame,
        shear=body.shear,
        viscosity=body.viscosity,
        points_of=len(body.weights),
    )


def size(body: ReducedDeformation, share: float) -> np.ndarray:
    """A random state, as large as a share of those that were trained on."""
    q = np.random.default_rng(1).standard_normal(body.order) / np.arange(1, body.order + 1) ** 2
    return share * body.training_radius * q / np.linalg.norm(q)


def test_nonnegative_least_squares_are_those_of_scipy():
    random = np.random.default_rng(0)
    for rows, columns in ((30, 20), (40, 200), (100, 90)):
        A, b = random.standard_normal((rows, columns)), random.standard_normal(rows)
        np.testing.assert_allclose(sparse_weights(A, b, 0.0), scipy.optimize.nnls(A, b)[0], atol=1e-12)


def test_weights_stop_at_the_tolerance_and_are_few():
    random = np.random.default_rng(0)
    A = random.standard_normal((60, 8)) @ random.random((8, 500)) + 0.01 * random.random((60, 500))
    b = A.sum(axis=1)
    counts = []
    for tolerance in (1e-1, 1e-2, 1e-3):
        x = sparse_weights(A, b, tolerance)
        assert (x >= 0).all()
        assert np.linalg.norm(A @ x - b) <= tolerance * np.linalg.norm(b)
        counts.append(np.count_nonzero(x))
    assert counts == sorted(counts)
    assert counts[-1] <= 60


def test_what_is_out_of_reach_is_approached():
    A, b = np.array([[1.0, 2.0], [0.0, 0.0]]), np.array([1.0, -1.0])
    x = sparse_weights(A, b, 1e-3)
    np.testing.assert_allclose(A @ x, [1.0, 0.0])
    assert not sparse_weights(-A, b, 1e-3).any()


def test_states_are_spread_from_the_largest_on():
    states = np.array([[1.0, 1.1, 5.0, 5.1, 0.0], [0.0, 0.0, 0.0, 0.0, 1.0]])
    np.testing.assert_array_equal(spread_states(states, 2), states[:, [3, 4]])
    np.testing.assert_array_equal(spread_states(states, 9), states)


def test_all_contact_modes_have_one_basis(system, rom):
    W, γ = rom.basis, rom.stiffness
    np.testing.assert_allclose(W.T @ (system.mass @ W), np.eye(16), atol=1e-10)
    np.testing.assert_allclose(W.T @ (system.stiffness @ W), np.diag(γ), atol=1e-9 * γ[-1])
    for name, mode in rom.contact_models.items():
        np.testing.assert_array_equal(mode.coordinates, np.eye(16))
        np.testing.assert_array_equal(mode.eigenvalues, γ)
        np.testing.assert_allclose(mode.damping, 1.0 + 5e-3 * γ)
        np.testing.assert_allclose(mode.inputs, W.T @ system.input_matrix(name), atol=1e-12 * np.abs(mode.inputs).max())


def test_reduced_force_is_the_gradient_of_the_reduced_energy(rom):
    body = rom.deformation
    q, ε = size(body, 1.0), 1e-5 * body.training_radius
    slopes = [(body.energy(q + ε * e) - body.energy(q - ε * e)) / (2 * ε) for e in np.eye(body.order)]
    np.testing.assert_allclose(slopes, body.force(q), atol=1e-7 * np.abs(body.force(q)).max())


def test_all_points_give_the_projected_force(system, rom):
    body, W = whole_body(system, rom), rom.basis
    q = size(body, 1.0)
    exact = W.T @ system.deformation.force(W @ q)
    np.testing.assert_allclose(body.force(q), exact, atol=1e-10 * np.abs(exact).max())


def test_kept_points_are_few_and_give_its_forces_to_the_tolerance(system, rom):
    body, every = rom.deformation, whole_body(system, rom)
    assert 0 < body.cubature_error <= 0.01
    assert len(body.weights) < len(every.weights) == body.points_of
    assert (body.weights > 0).all()
    root = np.sqrt(rom.stiffness)
    stiffness = body.tangent(np.zeros(16)) / np.outer(root, root)
    assert np.linalg.norm(stiffness - np.eye(16)) / 4 <= 0.01 * np.hypot(1, STIFFNESS_SHARE) / STIFFNESS_SHARE
    body_of_rom = system.deformation
    sim = body_of_rom.stepper(0.02)
    for _ in range(12):  # a load that no run had
        sim.switch("tip")
        sim.step(StepInput(np.array([0.05, -0.1, 0.2, 25.0, 0.5])))
    q = rom.basis.T @ (system.mass @ sim.x[:, 0])
    exact = every.force(q) / root
    gap = np.linalg.norm(body.force(q) / root - exact)
    assert gap <= 0.15 * np.linalg.norm(exact)  # 0.03 to 0.07: round-off chooses between points that are as good


def test_errors_of_forces_count_by_how_stiff_the_bent_body_is(system, rom):
    """Of each state by the energy of the motion that they cause there, √(fᵀK⁻¹f), K = AᵀC₀A."""
    every, random = whole_body(system, rom), np.random.default_rng(0)
    states = [size(every, 1.0) * random.choice([-1, 1], 16) for _ in range(6)]
    points, weights, _ = vars(
        fit_cubature(system.deformation, system.algebra, every.gradients, rom.stiffness, np.column_stack(states), 0.01)
    ).values()
    few = replace(
        every,
        gradients=every.gradients[:, :, points],
        weights=weights * every.weights[points],
        first_lame=every.first_lame[points],
        shear=every.shear[points],
    )
    squares = []
    for q in states:
        A = every.strain_rates(every.displacement_gradients(q))
        stressed = every.weights * linear_stress(A.transpose(0, 2, 1), every.first_lame, every.shear)
        K = np.einsum("cpm,ckp->mk", A, stressed)
        f, gap = every.force(q), few.force(q) - every.force(q)
        squares.append(gap @ np.linalg.solve(K, gap) / (f @ np.linalg.solve(K, f)))
    assert len(points) < 0.8 * len(every.weights)
    assert np.sqrt(np.mean(squares)) <= 0.01 * np.hypot(1, STIFFNESS_SHARE) * (1 + 1e-9)  # |G ω - G 1| <= 0.01 |G 1|


def test_a_smaller_tolerance_keeps_more_points(system, roms):
    finer = fr.reduce(system, order=16, method="modal+derivatives", cubature=1e-3).deformation
    assert finer.cubature_error <= 1e-3
    assert len(finer.weights) > len(roms["modal+derivatives"].deformation.weights)


def test_trained_model_follows_runs_that_it_has_not_seen(roms):
    assert roms["trained"].deformation.validation_error <= 0.02
    assert roms["modal+derivatives"].deformation.validation_error is None


@pytest.mark.parametrize("method", METHODS)
def test_both_methods_follow_a_load_history_that_linear_models_do_not(system, roms, method):
    """The held-out run of the scene itself, against an independent full order."""
    run = plan_runs(problem_of(system))[2][-1]
    assert run.title == "the scene's own load history"
    sim, shapes = system.deformation.stepper(run.dt), []
    for contact, u in run.steps:
        sim.switch(contact)
        sim.step(StepInput(u))
        shapes.append(sim.x[:, 0].copy())
    shapes = np.column_stack(shapes)[:, run.snapshot_steps()]
    assert np.abs(system.outputs["tip"].T @ shapes).max() > 0.07  # m, of 0.3 m
    assert validation_error(roms[method], system, run, shapes, []) <= 0.03
    soft = replace(roms[method].deformation, weights=0.9 * roms[method].deformation.weights)
    assert validation_error(replace(roms[method], deformation=soft), system, run, shapes, []) > 0.03


def test_how_far_training_went_is_kept_with_the_model(system, roms):
    """Inputs as the scene says; strains as the shapes of an independent full order, projected, have them."""
    rom, body = roms["trained"], roms["trained"].deformation
    assert body.trained.inputs == {"air": 75.0, "cable": 1.75}
    problem = problem_of(system)
    loads, training, held_out = plan_runs(problem)
    assert body.trained.pushes == {name: pytest.approx(np.linalg.norm(push)) for name, push in loads.pushes.items()}
    assert body.trained.smoothing_time == pytest.approx(slowest_period(problem) / 4)
    projection, strains = rom.basis.T @ system.mass, []
    for run in (training[0], held_out[-1]):
        sim = system.deformation.stepper(run.dt)
        for step, (contact, u) in enumerate(run.steps):
            sim.switch(contact)
            sim.step(StepInput(u))
            if step in run.snapshot_steps():
                E = body.strains(projection @ sim.x[:, 0])
                strains.append(np.sqrt((E[:3] ** 2).sum(axis=0) + (E[3:] ** 2).sum(axis=0) / 2))
    assert (np.max(strains, axis=0) <= (1 + 1e-9) * body.trained.strains).all()  # of the same steps, but for round-off
    assert (np.max(strains, axis=0) > 0.5 * body.trained.strains).mean() > 0.5  # two runs of a dozen


@pytest.mark.parametrize("method", METHODS)
def test_the_load_history_that_it_was_made_for_is_not_beyond_training(roms, method):
    assert not fr.simulate(roms[method]).beyond_training


@pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
@pytest.mark.parametrize("method", METHODS)
def test_a_cable_pulled_six_times_as_hard_is_beyond_training(system, roms, method):
    stronger = parse_scene(system.scene.text.replace("force = [1.75]", "force = [10.5]")).environment
    run = fr.simulate(roms[method], scene=stronger, dt=5e-3)
    assert run.beyond_training
    assert any("input 'cable' reached 10.5 N, 6 times the 1.75 N of training" in text for text in run.warnings)


def test_small_loads_move_it_like_the_linear_model(rom):
    body, γ = rom.deformation, rom.stiffness
    for mode in rom.contact_models.values():
        linear = mode.inputs / γ[:, None]
        kept = np.linalg.solve(body.tangent(np.zeros(16)), mode.inputs)
        assert (np.linalg.norm(kept - linear, axis=0) <= 0.03 * np.linalg.norm(linear, axis=0)).all()


def test_pressure_is_exactly_a_polynomial(system, rom):
    q = size(rom.deformation, 1.0)
    exact = rom.basis.T @ system.deformation.follower(rom.basis @ q)["air"][:, 0]
    found = rom.deformation.pressures["air"] @ monomials(q)
    np.testing.assert_allclose(found, exact, atol=1e-12 * np.abs(exact).max())


def test_tendon_is_exact(system, rom):
    q = size(rom.deformation, 1.0)
    exact = rom.basis.T @ system.deformation.follower(rom.basis @ q)["cable"][:, 0]
    np.testing.assert_allclose(rom.deformation.tendons["cable"].force(q), exact, atol=1e-12 * np.abs(exact).max())


@pytest.mark.parametrize("law", LAWS)
def test_derivatives_are_those_of_the_tangent(law):
    system = box(law=law)
    problem, body = problem_of(system), system.deformation
    V = system.algebra.eigenpairs(system.mass, system.stiffness, 3)[1] * 1e-3
    (θ,) = static_derivatives(problem, V, [(0, 2)]).T
    ε = 1e-3

    def tangent_times(direction, along):
        """K_t(along) direction, by central differences of the force."""
        return (body.force(along + ε * direction) - body.force(along - ε * direction)) / (2 * ε)

    change = (tangent_times(V[:, 0], ε * V[:, 2]) - tangent_times(V[:, 0], -ε * V[:, 2])) / (2 * ε)
    exact = -problem.factor.solve(change[:, None])[:, 0]
    np.testing.assert_allclose(θ, exact, atol=1e-5 * np.abs(exact).max())
    np.testing.assert_allclose(static_derivatives(problem, V, [(1, 1)]), 2 * second_order(problem, V[:, [1]]))


def test_targets_come_from_the_scene(system):
    problem = problem_of(system)
    loads = load_extremes(problem, slowest_period(problem))
    first, *alone = [next(wanted) for wanted in [training_targets(loads)] for _ in range(4)]
    assert first[0] == "tip"
    assert loads.extremes[1] == pytest.approx([75.0, 1.75], rel=1e-6)
    np.testing.assert_allclose(loads.pushes["tip"], [0.0, 0.2, -0.25])
    assert loads.pushes["middle"].any()  # what undoes there what the others do
    assert [np.count_nonzero(u) for _, u in alone] == [1, 1, 2]


def test_training_goes_on_where_it_was_stopped(system, folder, roms):
    files = sorted(file.name for file in folder.glob("run-*.h5"))
    assert len(files) == sum(map(len, plan_runs(problem_of(system))[1:]))
    (folder / files[-1]).unlink()
    reported = []
    rom = fr.reduce(system, order=16, checkpoint=folder, resume=True, report=lambda *of: reported.append(of))
    runs = len(files)
    assert [of for of in reported if of[0] == "training runs"] == [("training runs", k, runs) for k in (runs - 1, runs)]
    np.testing.assert_allclose(rom.stiffness, roms["trained"].stiffness, rtol=1e-8)
    assert rom.deformation.validation_error == pytest.approx(roms["trained"].deformation.validation_error, rel=1e-6)
    other = box(run=RUN.replace("75.0", "75.001"))
    with pytest.raises(FileError, match="was made from another system or with other choices"):
        fr.reduce(other, order=16, checkpoint=folder, resume=True)


@pytest.mark.parametrize("method", METHODS)
def test_without_inertia_equilibria_are_what_is_seen(method):
    system = box(**RESTING)
    rom = fr.reduce(system, order=12, method=method)
    if method == "trained":  # its held-out runs have the whole load in one step, too
        assert rom.deformation.validation_error <= 0.02
    u = np.array([0.0, 0.05, -0.15, 0.0, 0.0])
    full, body = system.deformation.stepper(1.0), rom.deformation
    full.switch("tip")
    full.equilibrium(StepInput(u))
    q = np.zeros(12)
    for _ in range(30):
        q = q - np.linalg.solve(body.tangent(q), body.force(q) - rom.contact_models["tip"].inputs @ u)
    moved = system.outputs["tip"].T @ full.x[:, 0]
    assert np.linalg.norm(moved) > 0.03
    np.testing.assert_allclose(rom.outputs["tip"] @ q, moved, atol=0.03 * np.linalg.norm(moved))


def test_a_rom_on_file_is_the_same(roms, tmp_path):
    fr.write_rom(tmp_path / "rom.h5", roms["trained"])
    body = fr.read_rom(tmp_path / "rom.h5").deformation
    q = size(body, 1.0)
    np.testing.assert_array_equal(body.force(q), roms["trained"].deformation.force(q))


@pytest.mark.slow
def test_order_beyond_what_was_seen_is_told():
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        rom = fr.reduce(box(), order=500, method="modal+derivatives")
    assert len(rom.stiffness) < 500
    assert any("order 500 was asked for" in str(one.message) for one in told)


def test_loads_beyond_what_can_be_followed_say_which_and_what_to_lower(monkeypatch):
    solved = SoftStepper._solved
    monkeypatch.setattr(SoftStepper, "_solved", lambda body, *load: body.time < 0.03 and solved(body, *load))
    message = r"training run 1 of \d+ \(tip\[1\] 0.2, tip\[2\] -0.25, .* does not converge in step 3 of .*lower those"
    with pytest.raises(SolverError, match=message):
        fr.reduce(box(), order=8)


def test_loads_that_the_body_cannot_follow_are_lowered_and_told(monkeypatch, tmp_path):
    """The model knows how far it was trained, also where training is resumed."""
    followed, most = SoftStepper.equilibrium, 0.12

    def equilibrium(body, inputs):
        if body.contact_mode == "tip" and np.linalg.norm(inputs.u[:3]) > most:
            raise SolverError("too much")
        followed(body, inputs)

    monkeypatch.setattr(SoftStepper, "equilibrium", equilibrium)
    for resume in (False, True):
        with pytest.warns(FenicsRomWarning, match="lowered") as told:
            rom = fr.reduce(box(**RESTING), order=12, checkpoint=tmp_path / "runs", resume=resume)
        assert any("(tip[1] 0.05, tip[2] -0.15) was lowered to 0.7 of its loads" in str(one.message) for one in told)
        assert {str(one.message) for one in told} <= set(rom.warnings)
        assert 0.1 < rom.deformation.trained.pushes["tip"] <= 0.12
        assert rom.deformation.validation_error <= 0.02
        most = 0.0  # nothing is run again


def test_a_reduced_model_that_stops_has_an_error_that_is_a_number(monkeypatch):
    stepped, steps = Equilibrium.step, []

    def step(kernel, *inputs):
        steps.append(inputs)
        if len(steps) > 4:
            raise StepError("not followed")
        return stepped(kernel, *inputs)

    monkeypatch.setattr(Equilibrium, "step", step)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        rom = fr.reduce(box(**RESTING), order=12)
    messages = [str(one.message) for one in told]
    assert 0.05 < rom.deformation.validation_error <= 1.0
    assert any("stops at step 5 of 10" in text and "not followed" in text for text in messages)
    assert any("shapes are off by up to" in text for text in messages)
    assert set(messages) <= set(rom.warnings)


@pytest.mark.parametrize(
    ("choices", "message"),
    [
        ({"method": "balanced"}, "'trained' and 'modal\\+derivatives' go with effects.large_deformation"),
        ({"switching": "oblique"}, "switching = 'oblique' goes with method = 'balanced'"),
        ({"cubature": 0.0}, "cubature"),
    ],
)
def test_choices_that_do_not_fit_are_refused(system, choices, message):
    with pytest.raises(SceneError, match=message):
        fr.reduce(system, order=8, **choices)


def test_trained_goes_with_the_effect_alone(box_file):
    with pytest.raises(SceneError, match="method = 'trained'"):
        fr.reduce(assembled(box_file), order=8, method="trained")


@pytest.mark.parametrize("method", METHODS)
def test_a_body_that_gravity_alone_bends_is_trained_with_gravity(tmp_path, method):
    """It comes as the run begins, so the body swings: from nothing to twice what it does at rest."""
    mesh = write_arrays(tmp_path / "bar.msh", *box_arrays((0.3, 0.02, 0.02), (4, 1, 1)))
    effects = "inertia = {}\ngravity = { acceleration = [0, 0, -3] }\nlarge_deformation = {}"
    parts = {"run": "dt = 0.02\nduration = 0.6", "outputs.tip": "points = [[0.3, 0.02, 0.02]]"}
    system = assembled(mesh, effects=f"{effects}\ndamping = {{ alpha = 0.5, beta = 5e-3 }}", **parts)
    rom = fr.reduce(system, order=8, method=method)
    whole, reduced = (fr.simulate(model).outputs["tip"] for model in (system, rom))
    assert rom.deformation.trained.inputs == {"gravity": pytest.approx(1.0)}
    assert np.abs(reduced - whole).max() < 0.05 * np.abs(whole).max()


def test_a_scene_must_say_how_far_to_train():
    with pytest.raises(SceneError, match="nothing acts"):
        fr.reduce(box(run="dt = 0.01\nduration = 0.1"), order=8)
    system = box()
    with pytest.raises(SceneError, match=r"has no \[run\]"):
        fr.reduce(replace(system, scene=replace(system.scene, run=None)), order=8)


PULLED = "fibres with law = 'holzapfel' are pulled to a stretch of"
FOLDING = "fibres with law = 'quadratic' are pressed to a stretch of 0"
WIND = {"quadratic": FOLDING, "holzapfel": PULLED}


@pytest.mark.parametrize(
    ("law", "says"),
    [
        ("yeoh 1.0 -0.05", "constants: yeoh 1.0 -0.05 in a uniaxial test it is not stable beyond a stretch"),
        ("yeoh 1.0 0.05", ""),
        ("mooney_rivlin 1.0 -0.3", "constants: mooney_rivlin 1.0 -0.3 in a uniaxial test it is not stable beyond"),
        (LAWS[1], ""),
        ("ogden 1.0 2.0 -0.1 4.0", "constants: ogden 1.0 2.0 -0.1 4.0 in a uniaxial test it is not stable beyond"),
        ("gent 2.0", "gent 2.0: in training chains are stretched out: at a stretch of"),
        ("gent 1e4", ""),
        ("arruda_boyce 3.0", ""),
        ("quadratic", FOLDING),
        ("holzapfel", PULLED),
    ],
)
def test_a_law_that_gives_way_at_stretches_of_the_training_is_refused(law, says):
    rom = soft_rom("neo_hookean")
    body, points = rom.deformation, np.arange(len(rom.deformation.weights))
    if law in WIND:
        structure = np.repeat(np.eye(6)[:, :1], len(points), axis=1)
        fibres = Fibres(law, points, structure, 2.0 * body.shear, np.full(len(points), 10.0 * (law == "holzapfel")))
        body = replace(body, fibres=(fibres,))
    else:
        body = replace(body, law=law)
    q = np.random.default_rng(0).standard_normal((body.order, 20))  # so many that signs of the basis do not matter
    q /= [np.abs(body.displacement_gradients(each)).max() for each in q.T]
    check_law(body, 0.1 * q)
    far = np.concatenate([q, 2 * q, 4 * q], axis=1)
    if not says:
        check_law(body, far)
        return
    with pytest.raises(SceneError, match=says):
        check_law(body, far)
