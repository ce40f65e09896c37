"""A run that is further off than it may be says so at that moment; with the full system at hand it gets better."""

import copy
import warnings

import numpy as np
import pytest
from bodies import assembled, scene_text
from test_contact_errors import scene_of
from test_errors import H, chain, run_command

import fenics_rom as fr
from fenics_rom.cli.main import main
from fenics_rom.errors import SceneError, StepError, ToleranceWarning
from fenics_rom.scene.file import parse_scene

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
ROUND_OFF = 1e-12  # of the largest energy or work: that of 3,000 steps with an account


@pytest.fixture(scope="module")
def rom():
    return fr.reduce(chain(), order=6, errors=True)


def errors_of(rom, steps=60):
    """The largest estimate of an output after each step under a held push, m."""
    body, told = fr.Simulator(rom, H), []
    for _ in range(steps):
        body.step([1.0, 0.5])
        told.append(np.abs(body.error_estimate.output("far")).max())
    return np.array(told)


def run_all(body, inputs):
    """Takes steps."""
    for u in inputs:
        body.step(u)


class TestItSaysSo:
    def test_once_at_the_first_step_that_is_beyond(self, rom):
        told = errors_of(rom)
        tolerance = np.sort(told)[30] * (1 + 1e-9)
        first = int(np.argmax(told > tolerance))
        body = fr.Simulator(rom, H, error_tolerance=tolerance)
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always", ToleranceWarning)
            for step in range(60):
                body.step([1.0, 0.5])
                assert len(said) == (step >= first)
        message = str(said[0].message)
        for words in (f"{tolerance:g} m", f"at {H * (first + 1):.6g} s", "'far'", f"{told[first]:.3g} m", "estimate"):
            assert words in message
        assert body.exceeded == (pytest.approx(H * (first + 1)), pytest.approx(told[first], rel=1e-6), "far")
        assert body.warnings == (message,)

    def test_however_it_is_stepped(self, rom):
        tolerance, u = np.median(errors_of(rom)), np.tile([1.0, 0.5], (60, 1))
        one, other = (fr.Simulator(rom, H, error_tolerance=tolerance) for _ in range(2))
        for row in u:
            one.step(row)
        other.rollout(u, every=7)
        bodies = fr.Batch(rom, 2, H, error_tolerance=tolerance)
        with pytest.warns(ToleranceWarning, match=r"^body 1: error_tolerance"):
            run_all(bodies, [[0 * row, row] for row in u])
        assert one.exceeded == other.exceeded
        assert np.isnan(bodies.exceeded[0])
        assert bodies.exceeded[1] == one.exceeded.time
        assert np.isnan(fr.Batch(chain_rom_without(rom), 2, H).exceeded).all()

    def test_kept_errors_are_those_of_a_run_without(self, rom):
        plain, watched = fr.Simulator(rom, H), fr.Simulator(rom, H, error_tolerance=1.0)
        for k in range(200):
            for body in (plain, watched):
                body.switch(("one", "two")[k // 70 % 2])
                body.step([np.sin(k), 0.5])
        assert watched.exceeded is None
        assert plain.energy_coordinates.tolist() == watched.energy_coordinates.tolist()
        assert watched.error_estimate.norm == pytest.approx(plain.error_estimate.norm, rel=1e-9)
        assert 1 - 1e-12 < plain.error_bound.norm / watched.error_bound.norm < 1 + 1e-7  # in blocks it is none less

    def test_saved_copied_and_begun_anew(self, rom):
        body = fr.Simulator(rom, H, error_tolerance=np.median(errors_of(rom)))
        before = body.save()
        body.rollout(np.ones((100, 2)))
        assert copy.copy(body).exceeded == body.exceeded is not None
        after = body.save()
        body.restore(before)
        assert body.exceeded is None
        body.restore(after)
        assert body.exceeded is not None
        body.reset()
        assert body.exceeded is None

    def test_a_step_that_is_taken_back_is_not_told(self, rom):
        bodies = fr.Batch(rom, 2, H, error_tolerance=1e-12, ledger=True)
        with pytest.raises(StepError):
            bodies.step([[1.0, 0.5], [1e200, 0.0]])
        assert np.isnan(bodies.exceeded).all()

    def test_among_obstacles(self, box_file):
        system = fr.assemble(scene_of("no friction", box_file))
        rom = fr.reduce(system, order=6, errors=True)
        body = fr.Simulator(rom, 1e-3, error_tolerance=1e-9)
        with pytest.warns(ToleranceWarning, match="'tip' is off by .* take a higher order$"):
            run_all(body, [[0, 0, -50.0]] * 40)
        assert np.isfinite(body.exceeded.error)
        with pytest.raises(SceneError, match="obstacles may touch the body"):
            fr.Enrichment(rom, system)


def chain_rom_without(rom):
    """The same without what it takes to know errors."""
    return fr.reduce(chain(), order=6)


class TestRefused:
    def test_of_bodies(self, rom):
        with pytest.raises(StepError, match=r"error_tolerance = -1\.0: use a number > 0, m"):
            fr.Simulator(rom, H, error_tolerance=-1.0)
        for error in ({"rom": chain_rom_without(rom)}, {"rom": rom, "errors": False}):
            with pytest.raises(StepError, match=r"error_tolerance = 1: errors are not known"):
                fr.Simulator(dt=H, error_tolerance=1.0, **error)
        bare = fr.reduce(chain(), order=6, errors=True)
        silent = fr.System(**{**vars_of(chain()), "outputs": {}})
        with pytest.raises(StepError, match="error_tolerance: is of the errors of outputs"):
            fr.Simulator(fr.reduce(silent, order=6, errors=True), H, error_tolerance=1.0)
        assert fr.Simulator(bare, H).error_tolerance is None

    def test_of_scenes(self, box_file):
        effects, tip = (
            "inertia = {}\ndamping = { alpha = 2.0, beta = 1e-3 }",
            {"outputs.tip": "points = [[1.0, 0.4, 0.3]]"},
        )
        effects += "\n[effects.contact.obstacles.floor]\nshape = 'half-space'\npoint = [0, 0, -1]\nnormal = [0, 0, 1]"
        touch = {"outputs.felt": "quantity = 'touch'\nsurface = 'right'"}
        for run, more, message in (
            ("error_tolerance = 1e-4", tip, "use it with run.errors = true"),
            ("error_tolerance = 1e-4\nerrors = true", {}, r"use it with \[outputs\] of displacements"),
            ("error_tolerance = 1e-4\nerrors = true", touch, r"use it with \[outputs\] of displacements"),
            ("enrich = true\nerrors = true", tip, "run.enrich: adds directions beyond run.error_tolerance"),
            ("error_tolerance = 0\nerrors = true", tip, "run.error_tolerance = 0"),
        ):
            text = scene_text(box_file, effects=effects, run=f"dt = 1e-3\nduration = 0.1\n{run}", **more)
            with pytest.raises(SceneError, match=message):
                parse_scene(text)

    def test_enriching(self, rom, box_file):
        other = fr.reduce(chain(size=50), order=6)
        with pytest.raises(SceneError, match="is of another body than the system"):
            fr.Enrichment(other, chain())
        heavier = fr.System(**{**vars_of(chain()), "mass": 2 * chain().mass})
        with pytest.raises(SceneError, match="not orthonormal in the system's mass"):
            fr.Enrichment(rom, heavier)
        with pytest.raises(SceneError, match="use a simulator of the Enrichment's rom"):
            fr.Enrichment(rom, chain()).enrich(fr.Simulator(rom, H))
        with pytest.raises(SceneError, match="enrich cannot be used with a System"):
            fr.simulate(assembled(box_file), enrich=chain())


def vars_of(system):
    """What a system of matrices was made of."""
    return {name: getattr(system, name) for name in ("mass", "stiffness", "contacts", "outputs", "rayleigh")}


class TestEnriched:
    """A plate with a basis of 6 directions, pushed at its tip: the full order says what is right."""

    TOLERANCE = 1e-5  # m; the plate bends by 36 mm

    @pytest.fixture(scope="class")
    @staticmethod
    def runs(plate_system):
        adding = fr.Enrichment(fr.reduce(plate_system, order=6), plate_system)
        poor = fr.simulate(adding.rom, error_tolerance=TestEnriched.TOLERANCE)
        rich = fr.simulate(adding.rom, error_tolerance=TestEnriched.TOLERANCE, enrich=adding)
        return poor, rich, fr.simulate(plate_system), adding.rom

    def test_the_error_falls_below_the_tolerance(self, runs):
        poor, rich, full, _ = runs
        off = [np.abs(run.outputs["tip"] - full.outputs["tip"]).max(axis=(1, 2)) for run in (poor, rich)]
        at = rich.tolerance.times[0]
        pushed = (full.times > at + 0.2) & (full.times <= 0.5)
        assert poor.tolerance.times.tolist() == [at]
        assert off[0][pushed].max() > 2 * self.TOLERANCE
        assert off[1][pushed].max() < self.TOLERANCE
        stated = np.abs(rich.errors["estimate"].outputs["tip"]).max(axis=(1, 2))
        large = off[1] > 0.1 * self.TOLERANCE
        np.testing.assert_allclose(stated[large], off[1][large], rtol=0.2)
        bound = rich.errors["bound"].outputs["tip"].max(axis=(1, 2))
        assert (off[1] <= bound + 1e-9 * np.abs(full.outputs["tip"]).max()).all()

    def test_no_energy_is_made_or_lost(self, runs):
        _, rich, _, _ = runs
        assert rich.balance_error < ROUND_OFF
        assert not rich.lost_in_switching.any()
        assert (rich.tolerance.orders[:, 1] > rich.tolerance.orders[:, 0]).all()
        assert rich.settings["order"] == rich.tolerance.orders[-1, 1]

    def test_files_hold_both_models(self, runs, tmp_path):
        _, rich, _, rom = runs
        fr.write_trajectory(tmp_path / "run.h5", rich)
        again = fr.read_trajectory(tmp_path / "run.h5").tolerance
        for name in ("times", "errors", "orders"):
            assert getattr(again, name).tolist() == getattr(rich.tolerance, name).tolist()
        assert (again.value, again.outputs) == (self.TOLERANCE, ("tip",))
        fr.write_rom(tmp_path / "rich.h5", rom)
        better = fr.simulate(fr.read_rom(tmp_path / "rich.h5"), error_tolerance=self.TOLERANCE)
        assert better.settings["order"] == rich.settings["order"]
        assert not better.tolerance.times.size
        assert rom.method == "balanced, enriched"

    def test_a_body_goes_on_where_it_is(self, plate_system):
        """Shape, velocities, energy, time, account and errors, to round-off."""
        adding = fr.Enrichment(fr.reduce(plate_system, order=6), plate_system)
        body = fr.Simulator(adding.rom, 1e-3, error_tolerance=1e-6)
        for k in range(90):
            body.switch(("tip_left", "middle")[k // 40 % 2])
            body.step([0.1, 0.2, np.sin(0.1 * k)])
        richer = adding.enrich(body)
        assert (richer.time, richer.contact, richer.steps) == (body.time, body.contact, body.steps)
        assert richer.energy == pytest.approx(body.energy, rel=1e-13)
        for read in (
            lambda of: of.displacement(),
            lambda of: of.velocity(),
            lambda of: of.error_estimate.output("tip"),
        ):
            np.testing.assert_allclose(read(richer), read(body), rtol=0, atol=1e-9 * np.abs(read(body)).max())
        for kind in ("error_bound", "error_estimate"):
            assert getattr(richer, kind).norm == pytest.approx(getattr(body, kind).norm, rel=1e-9)
        assert richer.ledger.sums == body.ledger.sums
        assert body.model.order < richer.model.order
        assert richer.exceeded is None

    @pytest.mark.parametrize("dense_damping", [False, True])
    def test_bodies_that_nothing_holds(self, dense_damping):
        import scipy.sparse as sp

        K = 1e3 * sp.diags([-np.ones(39), np.r_[1, 2 * np.ones(38), 1], -np.ones(39)], [-1, 0, 1])
        given = {"damping": sp.csr_matrix(1e-3 * K)} if dense_damping else {"rayleigh": (0.0, 1e-3)}
        unit = np.eye(40)
        system = fr.System(
            mass=1e-2 * sp.identity(40), stiffness=K, contacts={"one": unit[:, :2]}, outputs={"far": unit[:, [30]]},
            **given,
        )  # fmt: skip
        adding = fr.Enrichment(fr.reduce(system, order=3), system)
        body = fr.Simulator(adding.rom, 1e-3, error_tolerance=1e-12)
        for _ in range(30):
            body.step([1.0, -0.5])
        richer = adding.enrich(body)
        np.testing.assert_allclose(
            richer.displacement(), body.displacement(), atol=1e-10 * np.abs(body.displacement()).max()
        )
        assert richer.energy == pytest.approx(body.energy, rel=1e-12)
        assert richer.model.order > body.model.order


class TestCommands:
    def test_a_scene_with_a_tolerance(self, box_file, tmp_path, capsys):
        effects = "inertia = {}\ndamping = { alpha = 2.0, beta = 1e-3 }\ngravity = { acceleration = [0, 0, -9.81] }"
        run = (
            "dt = 1e-3\nduration = 0.1\nerrors = true\nerror_tolerance = 1e-7\nenrich = true\n"
            'load = [{ contact = "right", force = [0, 5.0, 0], stop = 0.05 }]'
        )
        text = scene_text(box_file, effects=effects, run=run, **{"outputs.tip": "points = [[1.0, 0.4, 0.3]]"})
        scene, rom = tmp_path / "box.toml", tmp_path / "box.h5"
        scene.write_text(text)
        run_command("reduce", scene, "-o", rom, "--order", "4")
        assert fr.read_rom(rom).environment.run.enrich
        with pytest.raises(SceneError, match=r"run\.enrich: adds directions by solves with the full system"):
            fr.simulate(fr.read_rom(rom))
        run_command("simulate", rom, "--scene", scene, "-o", tmp_path / "run.h5", "--enriched", tmp_path / "rich.h5")
        said = capsys.readouterr()
        assert "fenics-rom: error_tolerance = 1e-07 m: at" in said.err
        assert "exceeded at" in " ".join(said.out.split())
        found = fr.read_trajectory(tmp_path / "run.h5").tolerance
        assert len(found.times)
        order = max(model.order for model in fr.read_rom(tmp_path / "rich.h5").contact_models.values())
        assert order == found.orders[-1, 1]
        panels = fr.plot(fr.read_trajectory(tmp_path / "run.h5"), tmp_path / "plots")
        assert "output_tip.png" in {file.name for file in panels}
        with pytest.raises(SystemExit) as end:
            main(["simulate", str(rom), "-o", str(tmp_path / "run.h5"), "--enrich"])
        assert end.value.code == 2
