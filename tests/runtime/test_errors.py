"""Runs that know their errors: no error is above its bound, estimates are near, and who does not ask pays nothing."""

import copy
import sys
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.sparse as sp
from bodies import acted_on, dense, scene_text
from matplotlib.figure import Figure

import fenics_rom as fr
from fenics_rom.cli.main import main
from fenics_rom.errors import RomFileError, SceneError, StepError
from fenics_rom.reduction import error_model
from fenics_rom.rom.midpoint_map import matrices
from fenics_rom.runtime import error_blocks, error_maps
from fenics_rom.runtime.compiled import error_parts
from fenics_rom.runtime.error_maps import ErrorMaps, residual_map
from fenics_rom.runtime.error_watch import ErrorWatch
from fenics_rom.scene.file import parse_scene
from fenics_rom.visualization.plots.runs import run_panels

sys.path.append(str(Path(__file__).parents[2] / "demos" / "bounds"))
from random_runs import OUTPUT_ROUND_OFF, ROUND_OFF, chain_of, compare, random_run, ranking

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
H = 2e-3


def chain(size=60, seed=0, **given):
    """A chain held at its ends, with two contact modes."""
    random = np.random.default_rng(seed)
    K = 1e3 * sp.diags([-np.ones(size - 1), 2 * np.ones(size), -np.ones(size - 1)], [-1, 0, 1])
    unit = np.eye(size)
    contacts = {"one": unit[:, :2], "two": unit[:, [size // 2, size // 3]]}
    M = sp.diags(1e-2 * random.uniform(0.5, 2.0, size))
    given = {"rayleigh": (1.0, 1e-3)} | given
    return fr.System(mass=M, stiffness=K, contacts=contacts, outputs={"far": unit[:, [size - 9]]}, **given)


def dashpots(size=60):
    """A damping matrix that is not proportional."""
    return sp.diags(0.01 + np.random.default_rng(5).random(size))


@pytest.fixture(scope="module")
def rom():
    return fr.reduce(chain(), order=12, errors=True)


def stepped(rom, steps=200, seed=1, **given):
    """A simulator after random steps, of which it switched a few times."""
    body, random = fr.Simulator(rom, H, **given), np.random.default_rng(seed)
    for step in range(steps):
        body.switch(("one", "two")[step // 30 % 2])
        body.step(random.standard_normal(2))
    return body


@pytest.fixture(scope="module")
def random_runs():
    runs = [random_run(seed) for seed in range(50)]
    known = [run for run in runs if run.known]
    assert len(known) > 40
    return known


class TestRandomRuns:
    def test_no_error_is_above_its_bound(self, random_runs):
        assert max(run.broken for run in random_runs) <= ROUND_OFF
        assert max(run.outputs for run in random_runs) <= OUTPUT_ROUND_OFF

    def test_bounds_are_of_use(self, random_runs):
        """They are 1.5 times the error in the median, and 17 times at 95 %."""
        assert np.median([run.effectivity for run in random_runs]) < 2
        assert np.percentile([run.effectivity for run in random_runs], 95) < 35

    def test_bounds_that_are_five_percent_too_small_are_caught(self, random_runs):
        assert sum(run.broken_by(0.95) > ROUND_OFF for run in random_runs) > 0.1 * len(random_runs)

    def test_estimates_are_near(self, random_runs):
        assert np.mean([1 / 1.5 < run.ratio < 1.5 for run in random_runs]) >= 0.9

    def test_estimates_rank_orders(self):
        ranks = [ranking(seed) for seed in range(20)]
        assert np.mean([(np.argsort(true) == np.argsort(told)).all() for true, told in ranks]) >= 0.95


def worst_case(monkeypatch):
    """Bound over error in the end of a run whose input drives the error as hard as a residual can: ρ = 2 D ė̂.

    The finer model is made to have no directions of its own: else it would be all of the body.
    """
    shared = lambda problem, rom, whole, Q: (Q, rom.stiffness)  # noqa: E731
    monkeypatch.setattr(error_model, "finer_basis", shared)
    M, K, D = np.eye(2), np.diag([1.0, 100.0]), np.diag([1.0, 4.0])
    system = fr.System(mass=M, stiffness=K, damping=D, contacts={"one": np.eye(2)})
    rom = fr.reduce(system, order=1, method="modal", errors=True)
    h, x, v, d, γ = 1e-3, 0.0, 0.0, 4.0, 100.0
    body, a = fr.Simulator(rom, h), 1 / (2 / h + d + h / 2 * γ)
    for step in range(3000):
        middle = a * (2 / h * v - γ * x) / (1 - 2 * a * d) if step else a
        body.step([0.0, 2 * d * middle if step else 1.0])
        x, v = x + h * middle, 2 * middle - v
    return body.error_bound.norm / np.sqrt(v * v + γ * x * x)


def test_the_bound_is_attained_so_that_a_smaller_one_would_be_wrong(monkeypatch):
    assert 1 <= worst_case(monkeypatch) < 1.01


def test_a_bound_that_is_five_percent_too_small_is_caught(monkeypatch):
    monkeypatch.setattr(error_maps, "residual_map", lambda *given: 0.95 * residual_map(*given))
    assert worst_case(monkeypatch) < 0.97


@pytest.mark.parametrize("given", [{}, {"damping": dashpots(), "rayleigh": None}, {"rayleigh": (0.0, 2e-3)}])
def test_the_residual_is_that_of_the_full_order(given, monkeypatch):
    """Of each step of the finer model, ρᵀD⁻¹ρ by dense matrices."""
    system, found, whole = chain(**given), [], error_model.finer_basis
    monkeypatch.setattr(error_model, "finer_basis", lambda *of: found.append(whole(*of)) or found[0])
    rom, h, random = fr.reduce(system, order=7, errors=True), 3e-3, np.random.default_rng(0)
    M, D, K = (dense(getattr(system, name), system.size) for name in ("mass", "damping", "stiffness"))
    errors, B = rom.error_model, system.input_matrix("one")
    model, F, step = (
        errors.finer_model("one"),
        residual_map(errors, "one", h),
        matrices(errors.finer_model("one"), h)[0],
    )
    E = found[0][0]
    state, f = random.standard_normal(2 * model.order), model.order
    for _ in range(20):
        z = np.concatenate([state, random.standard_normal(2)])
        state = step @ z
        (s, r), (s2, r2) = ((part[:f] / np.sqrt(model.eigenvalues), part[f:]) for part in (z[: 2 * f], state))
        ρ = B @ z[2 * f :] - M @ E @ (r2 - r) / h - D @ E @ (r + r2) / 2 - K @ E @ (s + s2) / 2
        assert np.linalg.norm(F @ z) == pytest.approx(np.sqrt(ρ @ np.linalg.solve(D, ρ)), rel=1e-7)


def test_small_residuals_keep_their_digits():
    """Of a basis that is nearly all of the body residuals are 1e-7 of their parts; Gram matrices would lose them."""
    K, M = map(sp.csc_matrix, chain_of(np.random.default_rng(1)))
    unit = np.eye(K.shape[0])
    system = fr.System(
        mass=M, stiffness=K, rayleigh=(0.1, 1e-3), contacts={"one": unit[:, [3, 9]]}, outputs={"far": unit[:, [-3]]}
    )
    rom = fr.reduce(system, order=50, errors=True)
    u = np.sin(0.01 * np.arange(100))[:, None] * np.ones(2)
    run = compare(system, [rom], 1e-3, ["one"] * 100, u)[0]
    assert run.true.max() < 1e-5 * run.largest
    assert run.broken <= ROUND_OFF
    assert run.effectivity < 10


def test_a_switch_is_off_by_what_its_projection_drops():
    system = chain()
    rom, random = fr.reduce(system, order=6, errors=True), np.random.default_rng(0)
    M, K = (dense(A, system.size) for A in (system.mass, system.stiffness))
    body = fr.Simulator(rom, H)
    body.state = random.standard_normal((2, 6)).tolist()
    q, r = body.state
    x, v = (rom.basis @ body.model.coordinates @ part for part in (q, r))
    body.switch("two")
    e, ė = (given - rom.basis @ body.model.coordinates @ part for given, part in zip((x, v), body.state, strict=True))
    dropped = np.sqrt(e @ K @ e + ė @ M @ ė)
    assert dropped > 0.01 * np.sqrt(x @ K @ x + v @ M @ v)
    assert body.error_bound.norm == pytest.approx(dropped, rel=1e-9)
    assert body.error_estimate.norm == pytest.approx(dropped, rel=1e-9)


CRITICAL = {"damping": sp.diags(np.r_[4.0, np.full(59, 0.3)]), "stiffness": sp.diags(np.r_[4.0, np.arange(5.0, 64.0)])}


@pytest.mark.parametrize("loops", [False, True])
@pytest.mark.parametrize("silent", [error_blocks.SILENT, 0.1])
@pytest.mark.parametrize("given", [{}, {"damping": dashpots(), "rayleigh": None}, {"rayleigh": (1.0, 0.1)}, CRITICAL])
def test_blocks_of_steps_bound_what_steps_do(given, silent, loops, monkeypatch):
    """Also where they leave out the residual of directions that have much of it: then the bound is larger."""
    if given is CRITICAL:  # of a direction that is damped critically a step has one eigenvector
        unit = np.eye(60)
        given = given | {"mass": sp.identity(60), "contacts": {"one": unit[:, :2]}, "outputs": {"far": unit[:, [9]]}}
        system = fr.System(**given)
    else:
        system = chain(**given)
    monkeypatch.setattr(error_blocks, "SILENT", silent)
    if loops:
        monkeypatch.setattr(error_maps, "MANY", 0)
    rom, u = (
        fr.reduce(system, order=8, method="modal", errors=True),
        np.random.default_rng(0).standard_normal((1111, 2)),
    )
    maps, one, several = (ErrorMaps(rom), *(ErrorWatch(rom, ErrorMaps(rom)) for _ in range(2)))
    h, before = 3e-3, np.zeros(2 * rom.contact_models["one"].order)
    for row in u:
        one.note("one", h, row[None])
    several.note("one", h, u[:1000])
    several.note("one", h, u[1000:])
    assert bool(maps.blocks("one", h, 64)) == (given.get("stiffness") is None)
    np.testing.assert_allclose(several.state.finer, one.state.finer, rtol=0, atol=1e-12 * np.abs(one.state.finer).max())
    larger = several.bound("one", before).norm / one.bound("one", before).norm
    assert 1 - 1e-12 <= larger < (1 + 1e-6 if silent < 0.1 else 20)


@pytest.mark.parametrize(("f", "heard", "parts"), [(2, 1, 9), (3, 3, 1), (9, 6, 30), (21, 7, 257)])
def test_parts_go_on_in_loops_as_in_numpy(f, heard, parts):
    """Fewer coordinates than instructions of vectors take, and more; the first and the last hold two real ones."""
    random = np.random.default_rng(f)
    λ = np.tile(0.99 * np.exp(1j * random.uniform(0, np.pi, f)), (2, 1))
    for k in (0, f - 1):
        λ[:, k] = random.uniform(-1, 1, 2)
    powers = λ ** np.arange(1, error_blocks.RUN + 1)[:, None, None]
    powers, apart = powers.mean(axis=1), (powers[:, 0] - powers[:, 1]).real / 2
    pushed, inputs = random.standard_normal((parts, 2 * f)), random.standard_normal((parts, 5))
    begin, found = random.standard_normal(f) + 1j * random.standard_normal(f), []
    for way in (error_blocks.go_on, error_parts.take_parts):
        y, z = begin.copy(), np.full((parts, 5 + 2 * heard), np.nan)
        squares = way(powers, apart, (1, f - 1), y, pushed.copy(), inputs, z)
        expected, total = begin.copy(), 0.0
        for k in range(parts):
            assert np.allclose(z[k], np.r_[inputs[k], expected[:heard].view(float)], rtol=0, atol=1e-12)
            total += np.vdot(expected, expected).real
            after = [λ[0].real * expected.real - λ[0].imag * expected.imag]
            after += [λ[1].real * expected.imag + λ[1].imag * expected.real]
            expected = after[0] + 1j * after[1] + pushed[k].view(complex)
        assert np.allclose(y, expected, rtol=0, atol=1e-12)
        assert squares >= total * (1 - 1e-12)
        found.append(squares / total)
    assert max(found) < 10


@pytest.mark.parametrize("dense_damping", [False, True])
def test_a_free_body_has_bound_and_estimate(dense_damping):
    size, random = 40, np.random.default_rng(0)
    K = 1e3 * sp.diags([-np.ones(size - 1), np.r_[1, 2 * np.ones(size - 2), 1], -np.ones(size - 1)], [-1, 0, 1])
    given = {"damping": sp.csr_matrix(1e-3 * K)} if dense_damping else {"rayleigh": (0.0, 1e-3)}
    unit = np.eye(size)
    system = fr.System(
        mass=1e-2 * sp.identity(size), stiffness=K, contacts={"one": unit[:, :2], "two": unit[:, 5:7]},
        outputs={"far": unit[:, [30]]}, **given,
    )  # fmt: skip
    rom = fr.reduce(system, order=8, errors=True)
    M, K, h, x, v = 1e-2 * np.eye(size), K.toarray(), 1e-3, np.zeros(size), np.zeros(size)
    body, A = fr.Simulator(rom, h), 2 / h * M + 1e-3 * K + h / 2 * K
    for _ in range(300):
        u = random.standard_normal(2)
        body.step(u)
        middle = np.linalg.solve(A, unit[:, :2] @ u + 2 / h * M @ v - K @ x)
        x, v = x + h * middle, 2 * middle - v
        q, r = body.state
        W = rom.basis @ body.model.coordinates
        e, ė = x - W @ q, v - W @ r
        error = np.sqrt(e @ K @ e + ė @ M @ ė)
        assert error <= body.error_bound.norm * (1 + 1e-9)
    assert body.error_estimate.norm == pytest.approx(error, rel=0.3)
    assert body.error_estimate.output("far")[0] == pytest.approx(e[30], rel=0.1)
    assert abs(e[30]) <= body.error_bound.output("far")[0]


class TestAnyWayToStep:
    def test_rollouts(self, rom):
        one, other, u = fr.Simulator(rom, H), fr.Simulator(rom, H), np.random.default_rng(0).standard_normal((333, 2))
        contact = [("one", "two")[k // 50 % 2] for k in range(333)]
        dt = [(1e-3, 2e-3, 5e-4)[k // 71 % 3] for k in range(333)]
        for row, name, h in zip(u, contact, dt, strict=True):
            one.switch(name)
            one.dt = h
            one.step(row)
        other.rollout(u, contact=contact, dt=dt, every=7)
        for kind in ("error_bound", "error_estimate"):
            there, here = getattr(one, kind), getattr(other, kind)
            assert here.norm == pytest.approx(there.norm, rel=1e-9)
            np.testing.assert_allclose(here.output("far"), there.output("far"), rtol=1e-6)

    @pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy])
    def test_saved_copied_and_gone_on_from(self, rom, copied):
        body = stepped(rom)
        saved, twin = body.save(), copied(body)
        told = []
        for each in (body, twin, body):
            if told:
                body.restore(saved)
            each.rollout(np.ones((90, 2)))
            told.append((each.error_bound.norm, each.error_estimate.norm))
        assert told[0] == told[1] == told[2]
        body.reset()
        assert (body.error_bound.norm, body.error_estimate.norm) == (0, 0)

    def test_batches(self, rom):
        bodies, random = fr.Batch(rom, 3, H), np.random.default_rng(1)
        alone = [fr.Simulator(rom, H) for _ in range(3)]
        for step in range(40):
            u, names = random.standard_normal((3, 2)), [("one", "two")[(step // 7 + k) % 2] for k in range(3)]
            bodies.switch(names)
            bodies.step(u)
            for body, name, row in zip(alone, names, u, strict=True):
                body.switch(name)
                body.step(row)
        for kind in ("error_bound", "error_estimate"):
            told, expected = getattr(bodies, kind), [getattr(body, kind) for body in alone]
            assert told.norm.tolist() == [each.norm for each in expected]
            assert told.output("far").tolist() == [each.output("far").tolist() for each in expected]
        assert copy.copy(bodies).error_bound.norm.tolist() == bodies.error_bound.norm.tolist()
        assert bodies.stepping == "one after another, as of errors"

    def test_a_state_that_is_put_in_is_said_to_be(self, rom):
        body = stepped(rom)
        body.state = body.state
        assert body.error_bound.norm == 0
        assert body.error_estimate.norm < 1e-12
        assert "state that was put in" in body.error_bound.why
        assert "put in" not in stepped(rom).error_bound.why

    def test_truncated(self, rom):
        low, high = (stepped(each) for each in (fr.truncate(rom, 4), rom))
        assert low.error_estimate.norm > high.error_estimate.norm
        assert low.error_bound.norm > high.error_bound.norm

    def test_without_an_account(self, rom):
        assert stepped(rom, ledger=False).error_bound.norm == stepped(rom).error_bound.norm


def test_who_does_not_ask_has_the_same_to_the_bit_and_stores_nothing(rom, tmp_path):
    plain = fr.reduce(chain(), order=12)
    assert plain.error_model is None
    states = [stepped(*given).energy_coordinates.tolist() for given in ((rom,), (plain,))]
    assert states[0] == states[1] == stepped(rom, errors=False).energy_coordinates.tolist()
    fr.write_rom(tmp_path / "plain.h5", plain)
    with h5py.File(tmp_path / "plain.h5") as h5:
        assert "error_model" not in h5


def test_files_keep_it(rom, tmp_path):
    fr.write_rom(tmp_path / "rom.h5", rom)
    again = fr.read_rom(tmp_path / "rom.h5")
    assert again == rom
    assert stepped(again).error_bound.norm == stepped(rom).error_bound.norm
    broken = replace(rom, error_model=replace(rom.error_model, eigenvalues=rom.error_model.eigenvalues[1:]))
    with pytest.raises(RomFileError, match="/error_model: coordinates of shape"):
        fr.write_rom(tmp_path / "broken.h5", broken)


class TestRefused:
    def test_without_damping(self):
        for given in ({"rayleigh": (0.0, 0.0)}, {"damping": sp.diags(np.eye(60)[3]), "rayleigh": None}):
            with pytest.raises(SceneError, match="no damping, no bound"):
                fr.reduce(chain(**given), order=5, method="modal", errors=True)

    @pytest.mark.parametrize(
        ("effects", "reason"),
        [
            ("gravity = { acceleration = [0, 0, -9.81] }", "no inertia"),
            ('inertia = {}\ndamping = { alpha = 1.0, beta = 1e-3 }\nlarge_deformation = {}', "large deformation"),
            (
                "inertia = {}\ndamping = { alpha = 1.0, beta = 1e-3 }\n"
                "viscoelasticity = { ratios = [0.5], times = [0.1] }",
                "a material that relaxes",
            ),
        ],
    )  # fmt: skip
    def test_what_is_not_known(self, box_file, effects, reason):
        with pytest.raises(SceneError, match=f"a run with {reason} does not know its error"):
            fr.reduce(fr.assemble(acted_on(box_file, effects)), order=5, errors=True)

    def test_a_rom_that_was_not_made_for_it(self):
        plain = fr.reduce(chain(), order=5)
        with pytest.raises(StepError, match=r"errors = True: ROM 'system' was not made by fr.reduce\(system, errors"):
            fr.Simulator(plain, H, errors=True)
        for body in (fr.Simulator(plain, H), fr.Batch(plain, 2, H)):
            with pytest.raises(StepError, match=r"errors are not known: .*fr.reduce\(system, errors=True\)"):
                body.error_bound  # noqa: B018

    def test_a_scene_without_its_damping(self, box_file):
        scenes = [acted_on(box_file, f"inertia = {{}}\n{more}") for more in ("damping = { beta = 1e-3 }", "")]
        rom = fr.reduce(fr.assemble(scenes[0]), order=5, errors=True)
        with pytest.raises(StepError, match="errors are not known: a run with no damping does not know its error"):
            fr.Simulator(rom, H, scene=scenes[1]).error_bound  # noqa: B018
        with pytest.raises(StepError, match="errors = True: a run with no damping"):
            fr.Simulator(rom, H, scene=scenes[1], errors=True)

    def test_names_and_kinds(self, rom):
        with pytest.raises(StepError, match="errors are not known: errors = False was given"):
            stepped(rom, errors=False).error_estimate  # noqa: B018
        with pytest.raises(StepError, match="no output 'tip'; there is far"):
            stepped(rom).error_bound.output("tip")
        with pytest.raises(SceneError, match="errors = 'yes'"):
            fr.reduce(chain(), order=5, errors="yes")


def run_command(*words):
    """A command, to its end."""
    with pytest.raises(SystemExit) as end:
        main([str(word) for word in words])
    assert not end.value.code


@pytest.fixture(scope="module")
def scene_runs(box_file, tmp_path_factory):
    """Folder, reduced run and full order of a scene that asks for errors, on the command line."""
    folder = tmp_path_factory.mktemp("errors")
    effects = "inertia = {}\ndamping = { alpha = 2.0, beta = 1e-3 }\ngravity = { acceleration = [0, 0, -9.81] }"
    run = 'dt = 1e-3\nduration = 0.1\nerrors = true\nload = [{ contact = "right", force = [0, 5.0, 0], stop = 0.05 }]'
    text = scene_text(box_file, effects=effects, run=run, **{"outputs.tip": "points = [[1.0, 0.4, 0.3]]"})
    (folder / "box.toml").write_text(text)
    for words in (
        ("reduce", folder / "box.toml", "-o", folder / "box.h5", "--order", "6"),
        ("simulate", folder / "box.h5", "-o", folder / "reduced.h5", "--errors"),
        ("simulate", folder / "box.toml", "-o", folder / "full.h5"),
    ):
        run_command(*words)
    return folder, *(fr.read_trajectory(folder / name) for name in ("reduced.h5", "full.h5"))


class TestScenes:
    def test_runs_state_their_errors(self, scene_runs):
        _, reduced, full = scene_runs
        off = full.outputs["tip"] - reduced.outputs["tip"]
        bound, estimate = reduced.errors["bound"], reduced.errors["estimate"]
        assert (np.abs(off) <= bound.outputs["tip"] + 1e-12 * np.abs(full.outputs["tip"]).max()).all()
        assert np.linalg.norm(off - estimate.outputs["tip"]) < 0.3 * np.linalg.norm(off)
        assert np.abs(off).max() > 1e-7
        assert bound.norm.shape == full.times.shape
        assert (bound.norm >= estimate.norm).all()
        assert not full.errors

    def test_they_are_the_same_read_in_blocks_and_after_each_step(self, scene_runs, monkeypatch):
        rom = fr.read_rom(scene_runs[0] / "box.h5")
        monkeypatch.setattr(fr.Simulator, "steps_in_blocks", property(lambda body: False))
        stepped = fr.simulate(rom)
        for kind, stated in scene_runs[1].errors.items():
            expected = stepped.errors[kind]
            assert stated.why == expected.why
            for found, of_step in (
                (stated.norm, expected.norm),
                (stated.outputs["tip"], expected.outputs["tip"]),
                (stated.shape, expected.shape),
            ):
                if of_step is not None:
                    np.testing.assert_allclose(found, of_step, rtol=0, atol=1e-10 * np.abs(of_step).max())

    def test_they_are_printed_and_drawn(self, scene_runs, capsys):
        folder, reduced, _ = scene_runs
        run_command("simulate", folder / "box.h5", "-o", folder / "again.h5")
        said = " ".join(capsys.readouterr().out.split())
        assert "error, bound" in said
        assert "the body is linear and damped" in said
        assert "error of tip, estimate" in said
        run_command("info", folder / "box.h5")
        assert "told by runs, by a finer model of" in " ".join(capsys.readouterr().out.split())
        panels = fr.plot(reduced, folder / "plots")
        assert "error.png" in {file.name for file in panels}
        run_panels({"run": reduced})["output_tip"](figure := Figure())
        axes, k = figure.axes[0], int(np.abs(reduced.errors["bound"].outputs["tip"]).max(axis=(1, 2)).argmax())
        assert {"± bound", "± estimate"} <= set(axes.get_legend_handles_labels()[1])
        scale = axes.lines[1].get_ydata()[k] / reduced.outputs["tip"][k, 0, 1]  # of the unit that is drawn
        widths = {kind: scale * np.abs(reduced.errors[kind].outputs["tip"][k, 0, 1]) for kind in reduced.errors}
        for kind, width in widths.items():  # of y: there is a band around its line, as wide as what is stated
            edges = [band.get_paths()[0].vertices for band in axes.collections if band.get_paths()]
            heights = [np.ptp(of[np.isclose(of[:, 0], axes.lines[1].get_xdata()[k]), 1]) for of in edges if len(of) > 9]
            assert any(np.isclose(height, 2 * width) for height in heights), kind

    def test_a_run_at_full_order_has_none_to_state(self, scene_runs, capsys):
        folder = scene_runs[0]
        with pytest.raises(SystemExit):
            main(["simulate", str(folder / "box.toml"), "-o", str(folder / "none.h5"), "--errors"])
        assert "--errors" in capsys.readouterr().err
        scene = parse_scene((folder / "box.toml").read_text())
        with pytest.raises(SceneError, match="errors cannot be used with a Scene"):
            fr.simulate(scene, errors=True)

    def test_errors_can_be_left_out(self, scene_runs):
        run = fr.simulate(fr.read_rom(scene_runs[0] / "box.h5"), errors=False)
        assert not run.errors
        assert (run.outputs["tip"] == scene_runs[1].outputs["tip"]).all()
