"""What a study says of errors, against closed forms and runs of their own; what it leaves, takes over and refuses."""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bodies import box_arrays, dense, scene_text, write_arrays, write_box
from ranks import run_ranks

import fenics_rom as fr
from fenics_rom.errors import FileError, SceneError, SolverError
from fenics_rom.scene.file import parse_scene
from fenics_rom.studies import method_configs
from fenics_rom.studies.benchmark import largest_order
from fenics_rom.studies.json_record import read_record
from fenics_rom.studies.method_configs import METHOD_CONFIGS, STUDIED_ORDERS, make_grid
from fenics_rom.studies.pareto import describe_choice
from fenics_rom.studies.report import csv_table, markdown_report, remarks, write_report
from fenics_rom.studies.study import study_for_tolerance
from fenics_rom.studies.study_results import PICTURES, StudyResults
from fenics_rom.trajectory.comparison import FORCE_MEASURES

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")

PUSH = """dt = 0.01
duration = 1.0
load = [{ contact = "right", stop = 0.48, force = [1.0, 2.0, 5.0] }]"""
TIP = {"outputs.tip": "points = [[1.0, 0.0, 0.3]]"}
FIRST = 0.48  # s with the force, of 1 s
FORCE = np.array([1.0, 2.0, 5.0])


def box_scene(mesh, run=PUSH, **parts):
    return parse_scene(scene_text(mesh, run=run, **(TIP | parts)), folder=Path(mesh).parent, source="box")


@pytest.fixture(scope="module")
def scene(box_file):
    return box_scene(box_file)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("study")


@pytest.fixture(scope="module")
def results(scene, folder):
    return fr.study(scene, folder, orders=[5, 20, 60], steps=[0.02, 0.01, 0.005])


def exact_shapes(system, times):
    """Displacements in all eigenvectors, each solved in closed form; damping below the critical one or above."""
    M, D, K = (dense(A, system.size) for A in (system.mass, system.damping, system.stiffness))
    L = np.linalg.cholesky(M)
    γ, U = np.linalg.eigh(np.linalg.solve(L, np.linalg.solve(L, K).T))
    V = np.linalg.solve(L.T, U)
    d, g = np.diag(V.T @ D @ V), V.T @ system.input_matrix("right") @ FORCE
    root = np.sqrt(d.astype(complex) ** 2 / 4 - γ)
    ends = -d / 2 + root, -d / 2 - root

    def free(q, r, t):
        a, b = (r - ends[1] * q) / (ends[0] - ends[1]), (ends[0] * q - r) / (ends[0] - ends[1])
        terms = a * np.exp(ends[0] * t), b * np.exp(ends[1] * t)
        return (terms[0] + terms[1]).real, (ends[0] * terms[0] + ends[1] * terms[1]).real

    held, shapes = g / γ, []
    last = [part + rest for part, rest in zip(free(-held, 0 * held, FIRST), (held, 0), strict=True)]
    for t in times:
        q = held + free(-held, 0 * held, t)[0] if t <= FIRST else free(*last, t - FIRST)[0]
        field = np.zeros(3 * len(system.body.nodes))
        field[system.body.free] = V @ q
        shapes.append(field.reshape(-1, 3))
    return np.array(shapes)


def off(shapes, reference, node_mass):
    weight = np.sqrt(node_mass)[:, None]
    return np.linalg.norm(weight * (shapes - reference)) / np.linalg.norm(weight * reference)


def test_reference_knows_its_own_error(scene, box_system, results, folder):
    reference = fr.read_trajectory(folder / "reference.h5")
    assert reference.settings["dt"] == results.reference_step == 0.005 / 4
    system = fr.assemble(scene)
    truth = exact_shapes(system, reference.snapshot_times)
    assert off(reference.snapshots, truth, reference.node_mass) == pytest.approx(results.reference_error, rel=0.05)


def test_errors_are_those_from_the_closed_form(scene, results):
    """Of the largest model at each step, whose error is the step's."""
    system = fr.assemble(scene)
    rom = fr.reduce(system, order=60)
    for row in results.of("balanced", 60):
        run = fr.simulate(rom, scene=scene, dt=row.dt)
        truth = exact_shapes(system, run.snapshot_times)
        assert off(run.snapshots, truth, run.node_mass) == pytest.approx(row.error, rel=0.1)
        assert row.error == pytest.approx(row.time_step, rel=0.1)


def test_errors_add_up_to_no_more_than_their_parts(results):
    assert len(results.rows) == 5 * 3 * 3
    for row in results.rows:
        assert row.error <= (row.reduction + row.time_step) * (1 + 1e-9)
        assert row.error >= abs(row.reduction - row.time_step) * (1 - 1e-9)
        assert row.outputs.keys() == {"tip"}
        assert row.rate > 0
        assert row.offline > 0
    by_step = [row.time_step for row in results.of("balanced", 60)]
    assert by_step[0] / by_step[1] == pytest.approx(4, rel=0.3)
    assert by_step[1] / by_step[2] == pytest.approx(4, rel=0.3)


def test_reduction_is_measured_at_the_step_of_the_reference(scene, results, folder):
    reference = fr.read_trajectory(folder / "reference.h5")
    rom = fr.reduce(fr.assemble(scene), order=20, method="pod")
    run = fr.simulate(rom, scene=replace(scene, run=replace(scene.run, snapshots=50)), dt=results.reference_step)
    assert len(run.snapshot_times) == len(reference.snapshot_times)
    expected = off(run.snapshots, reference.snapshots, run.node_mass)
    rows = results.of("pod", 20)
    assert [row.reduction for row in rows] == pytest.approx([expected] * 3, rel=1e-6)


def test_reference_is_ten_times_closer_than_what_it_measures_or_it_says_so(results):
    assert results.reference_error < 0.1 * results.smallest_error
    assert not [said for said in remarks(results) if "reference" in said]
    poor = replace(results, reference_error=0.2 * results.smallest_error)
    assert "more than a tenth of the smallest error" in remarks(poor)[0]


def test_paper_selection_has_as_many_eigenvectors_as_asked_for(results):
    assert {row.order for row in results.rows if row.method == "selection"} == {5, 20, 60}


def test_results_hold_what_was_found(results, tmp_path):
    write_report(tmp_path, results, "fenics-rom study box.toml -o out")
    with (tmp_path / "study.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(results.rows)
    for row, found in zip(rows, results.rows, strict=True):
        assert (row["method"], int(row["order"]), float(row["step (s)"])) == (found.method, found.order, found.dt)
        assert float(row["error of shape"]) == pytest.approx(found.error, rel=1e-3)
        assert float(row["largest error of tip"]) == pytest.approx(found.outputs["tip"][1], rel=1e-3)
        assert float(row["times real time"]) == pytest.approx(found.rate * found.dt, rel=1e-3)
    assert 1 <= sum(row["on the Pareto front"] == "yes" for row in rows) < len(rows)
    text = (tmp_path / "study.md").read_text()
    assert "`fenics-rom study box.toml -o out`" in text
    assert all(
        METHOD_CONFIGS[method].label in text for method in ("balanced", "selection", "modal", "modal+static", "pod")
    )
    for name in PICTURES:
        assert (tmp_path / f"{name}.png").stat().st_size > 20_000
        assert (tmp_path / f"{name}.pdf").stat().st_size > 5_000


def test_interrupted_study_goes_on(scene, tmp_path):
    choices = {"methods": ["balanced", "modal"], "orders": [5, 10], "steps": [0.02]}

    def stop(stage, done, of):
        if (stage, done) == ("reduced models", 3):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fr.study(scene, tmp_path, **choices, report=stop)
    begun = (tmp_path / "reference.h5").stat().st_mtime_ns
    seen = []
    found = fr.study(scene, tmp_path, **choices, resume=True, report=lambda stage, done, of: seen.append(stage))
    assert (tmp_path / "reference.h5").stat().st_mtime_ns == begun
    assert "full order" not in seen
    assert [(row.method, row.order) for row in found.rows] == [
        ("balanced", 5),
        ("modal", 5),
        ("balanced", 10),
        ("modal", 10),
    ]
    again = fr.study(scene, tmp_path, **choices, resume=True)
    assert again == found  # rates and all: nothing was measured anew
    with pytest.raises(FileError, match="of another scene, mesh, smallest step or length; start without resume"):
        fr.study(scene, tmp_path, steps=[0.01], resume=True)
    (tmp_path / "study.json").write_text("{}")
    with pytest.raises(FileError, match="does not hold a study"):
        fr.study(scene, tmp_path, **choices, resume=True)


def test_study_killed_between_its_files_leaves_none_to_resume_wrongly(scene, box_file, tmp_path, monkeypatch):
    """The first study is not resumed against the reference of the second, which was stopped before its record."""
    choices = {"methods": ["modal"], "steps": [0.02]}
    fr.study(scene, tmp_path, orders=[5], **choices)
    other = box_scene(box_file, run=PUSH.replace("[1.0, 2.0, 5.0]", "[5.0, 0.0, 0.0]"))

    def stop(file, record):
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr("fenics_rom.studies.study.write_record", stop)
        with pytest.raises(KeyboardInterrupt):
            fr.study(other, tmp_path, orders=[5], **choices)
    resumed = fr.study(scene, tmp_path, orders=[5, 10], resume=True, **choices)
    unbroken = fr.study(scene, tmp_path / "unbroken", orders=[5, 10], **choices)
    assert [row.error for row in resumed.rows] == pytest.approx([row.error for row in unbroken.rows], rel=1e-9)


@pytest.mark.ranks
@pytest.mark.slow
def test_two_ranks_find_the_same(box_file, tmp_path):
    file = tmp_path / "box.toml"
    file.write_text(scene_text(box_file, run=PUSH, **TIP))
    rows = {}
    for ranks in (1, 2):
        out = tmp_path / str(ranks)
        choices = ("--methods", "balanced", "selection", "--orders", "10", "--steps", "0.02", "0.01")
        run = run_ranks(ranks, "-m", "fenics_rom", "study", file, "-o", out, *choices)
        assert run.returncode == 0, run.stderr
        assert run.stdout.count("what each decimal costs") == 1
        with (out / "study.csv").open(newline="") as table:
            rows[ranks] = list(csv.DictReader(table))
    assert len(rows[1]) == len(rows[2]) == 4
    for one, two in zip(rows[1], rows[2], strict=True):
        for column in ("error of shape", "error of reduction alone", "error of energy", "largest error of tip"):
            assert float(one[column]) == pytest.approx(float(two[column]), rel=1e-3)


@pytest.mark.slow
class TestForATolerance:
    def test_model_keeps_it_and_a_smaller_one_would_not(self, scene, tmp_path):
        tolerance = 1e-3
        results, row, rom = study_for_tolerance(scene, tmp_path, tolerance)
        system = fr.assemble(scene)
        run = fr.simulate(rom, dt=row.dt)
        assert off(run.snapshots, exact_shapes(system, run.snapshot_times), run.node_mass) < 1.02 * tolerance
        tried = sorted({other.order for other in results.rows})
        assert tried == list(STUDIED_ORDERS[: len(tried)])
        assert row.order == tried[-1]
        assert all(other.error > tolerance for other in results.rows if other.order < row.order)
        assert study_for_tolerance(scene, tmp_path, tolerance, resume=True)[0] == results  # nothing was measured anew
        looser = study_for_tolerance(scene, tmp_path, 10 * tolerance, resume=True)[1]  # at another step: begun anew
        assert looser.dt > row.dt

    def test_resumed_model_of_a_body_that_nothing_holds_has_the_order_of_its_row(self, box_file, tmp_path):
        push = "dt = 0.01\nduration = 0.1\nload = [{ contact = 'right', force = [1.0, 2.0, 5.0] }]"
        free = box_scene(box_file, run=push, supports=None)
        _, row, rom = study_for_tolerance(free, tmp_path, 0.05)
        _, resumed_row, resumed = study_for_tolerance(free, tmp_path, 0.05, resume=True)
        assert resumed_row == row
        assert largest_order(resumed) == largest_order(rom) == row.order
        assert rom.rigid == 6

    def test_that_no_step_reaches(self, box_file, tmp_path):
        short = box_scene(
            box_file, 'dt = 0.01\nduration = 0.2\nload = [{ contact = "right", force = [0.0, 0.0, 5.0] }]'
        )
        said = r"tolerance 1e-12: not reached, as the time step alone leaves an error of .*e-0\d at .* µs"
        with pytest.raises(SolverError, match=said):
            study_for_tolerance(short, tmp_path, 1e-12)

    @pytest.mark.slow
    def test_that_no_order_reaches(self, scene, tmp_path, monkeypatch):
        monkeypatch.setattr("fenics_rom.studies.method_configs.STUDIED_ORDERS", (4, 6))
        said = r"not reached; the least error of the whole shape was .*, of which the reduction \(order 6\) alone makes"
        with pytest.raises(SolverError, match=said):
            study_for_tolerance(scene, tmp_path, 1e-4)
        assert (tmp_path / "study.json").exists()  # what was found is not lost

    @pytest.mark.parametrize("tolerance", [0.0, 1.0, -1e-3, np.nan])
    def test_that_means_nothing(self, scene, tmp_path, tolerance):
        with pytest.raises(SceneError, match="tolerance"):
            study_for_tolerance(scene, tmp_path, tolerance)


class TestMeshes:
    @pytest.mark.slow
    def test_are_compared_at_outputs_with_the_finest(self, box_file, tmp_path):
        finer = [write_box(tmp_path / f"{n}.msh", (1.0, 0.4, 0.3), (4 * n, 2 * n, 2 * n)) for n in (3, 2)]
        scene = box_scene(box_file)
        found = fr.study(scene, tmp_path / "out", meshes=finer, orders=[5], methods=["balanced"], steps=[0.02])
        assert [mesh.file for mesh in found.meshes] == ["box.msh", "2.msh", "3.msh"]
        runs = [fr.simulate(replace(scene, mesh_file=file)).outputs["tip"] for file in (box_file, finer[1], finer[0])]
        errors = [np.linalg.norm(run - runs[-1]) / np.linalg.norm(runs[-1]) for run in runs]
        assert [mesh.outputs["tip"] for mesh in found.meshes] == pytest.approx(errors, rel=1e-9)
        assert errors[0] > errors[1] > errors[2] == 0
        assert any(said.startswith("the mesh is ") for said in remarks(found))
        write_report(tmp_path / "out", found, "study")
        assert "## Error of the mesh" in (tmp_path / "out" / "study.md").read_text()

    def test_that_are_no_finer_are_refused(self, box_file, tmp_path):
        coarse = write_box(tmp_path / "coarse.msh", (1.0, 0.4, 0.3), (2, 1, 1))
        with pytest.raises(SceneError, match=r"box.msh has 108 unknowns; use meshes that are finer"):
            fr.study(box_scene(box_file), tmp_path, meshes=[coarse], quick=True)

    def test_need_outputs(self, box_file, tmp_path):
        bare = box_scene(box_file, **{"outputs.tip": None})
        with pytest.raises(SceneError, match=r"compared at outputs, and the scene names none; add \[outputs.NAME\]"):
            fr.study(bare, tmp_path, meshes=[box_file], quick=True)


def test_statics_and_contact_can_be_studied(box_file, tmp_path):
    quiet = box_scene(box_file, effects="")
    static = fr.study(quiet, tmp_path / "static", quick=True)
    assert {row.method for row in static.rows} == {"static"}
    assert static.smallest_error < 1e-9  # K⁻¹B is all that an equilibrium has
    floor = '[effects.contact.obstacles.floor]\nshape = "half-space"\npoint = [0, 0, -1e-4]\nnormal = [0, 0, 1]'
    pressed = box_scene(
        box_file,
        PUSH.replace("5.0]", "-5.0]"),
        effects="inertia = {}\ndamping = { alpha = 1.0, beta = 1e-3 }\n"
        + '[effects.contact]\nswitching = "scene"\n'
        + floor,
    )
    touched = fr.study(pressed, tmp_path / "contact", methods=["balanced"], orders=[60], steps=[0.01])
    assert touched.divisor == 1.0
    assert touched.rows[0].reduction < 1e-2
    assert touched.reference_error < touched.rows[0].error
    part = replace(pressed, run=replace(pressed.run, duration=touched.duration))
    reduced = fr.simulate(fr.reduce(fr.assemble(pressed), order=60, method="balanced"), scene=part, dt=0.01)
    reference = fr.read_trajectory(tmp_path / "contact" / "reference.h5")
    errors = [fr.compare(reduced, reference)[f"{what} of floor"].relative for what in FORCE_MEASURES]
    assert touched.rows[0].forces == {"floor": pytest.approx(errors, rel=1e-6)}
    assert all(0 < error < 0.5 for error in touched.reference_forces["floor"])
    assert read_record(tmp_path / "contact" / "study.json", StudyResults, "a study") == touched
    assert "| floor    | full order, by its step |       | 2.5 ms |" in markdown_report(touched, "study")
    assert static.full_step is None
    assert touched.full_step == 5e-3  # steps cost what happens in them: no rate of those before it touches
    assert "order 60, step 10 ms; " in (said := describe_choice(touched, 0.1, touched.rows[0]))
    assert said.endswith("as fast as full order at steps of 5 ms.")
    assert "full order, at steps of 5 ms in the whole run, makes" in markdown_report(touched, "study")
    (row,) = csv.DictReader(csv_table(touched).splitlines())
    assert float(row["error of peak force of floor"]) == pytest.approx(errors[1], rel=1e-3)
    worse = replace(touched, rows=(replace(touched.rows[0], forces={"floor": (0.01, 0.18, 0.01)}),))
    assert any("the peak force of floor is off by 18%" in message for message in remarks(worse))


class TestQuick:
    """A first look, in a work at full order that is known beforehand."""

    @pytest.mark.parametrize("size", [180, 4200, 100_000])
    def test_work_at_full_order_is_bounded(self, scene, size):
        long = replace(scene.run, dt=1e-3, duration=1.0)
        grid = make_grid(scene, long, size, quick=True)
        duration = grid.duration(long.duration, size)
        steps = duration / grid.reference_step * 1.5
        assert size * steps <= max(method_configs.QUICK_WORK, size * 1.5 * 2 * method_configs.QUICK_STEPS) * (1 + 1e-9)
        assert duration == long.duration if size == 180 else duration < long.duration
        assert grid.duration(0.05, size) <= 0.05

    def test_takes_the_beginning_reduces_once_and_says_so(self, scene, tmp_path, monkeypatch):
        monkeypatch.setattr(method_configs, "QUICK_WORK", 108 * 150.0)  # a third of it, of 108 unknowns
        found = fr.study(scene, tmp_path, quick=True)
        assert found.duration == 0.48  # of half a second, what steps of 40 ms divide
        assert found.reference_step == 0.005
        assert "rates are of one run, of the 1 s of the run the first 0.48 s" in found.notes[0]
        assert {row.method for row in found.rows} == {"balanced", "modal"}
        run = replace(scene.run, duration=found.duration, snapshots=4)
        short, rom = replace(scene, run=run), fr.reduce(fr.assemble(scene), order=5, method="balanced")
        full, reduced = fr.simulate(short, dt=0.005), fr.simulate(rom, scene=short, dt=0.005)
        alone = found.of("balanced", 5)[0].reduction
        assert alone == pytest.approx(fr.compare(reduced, full)["shape"].relative, rel=0.1)  # at other instants

    def test_nothing_that_moves_in_the_beginning_is_refused(self, box_file, tmp_path, monkeypatch):
        monkeypatch.setattr(method_configs, "QUICK_WORK", 1.0)
        late = box_scene(box_file, PUSH.replace("stop = 0.48", "start = 0.5"))
        with pytest.raises(SceneError, match=r"nothing moves in the first 0\.\d+ s of its run"):
            fr.study(late, tmp_path, quick=True)

    def test_tells_how_far_it_is_again_and_again(self, scene, tmp_path):
        said = []
        fr.study(scene, tmp_path, quick=True, orders=[5], report=lambda *told: said.append(told))
        assert said.count(("full order", 150, 300)) == 1
        assert said.count(("reduced models", 1, 2)) > 100  # of 2 models, the second one: at each of its steps


@pytest.mark.parametrize(
    ("run", "said"),
    [
        (None, r"has no \[run\], so there is nothing to measure"),
        ("dt = 0.01\nduration = 1.0", "nothing acts in its run, so there is nothing to measure; add"),
        (PUSH.replace("[1.0, 2.0, 5.0]", "[0, 0, 0]"), "nothing moves in its run, so there is nothing to measure"),
    ],
)
def test_scene_without_anything_to_measure_is_refused(box_file, tmp_path, run, said):
    with pytest.raises(SceneError, match=said):
        fr.study(box_scene(box_file, run), tmp_path, quick=True)


@pytest.mark.parametrize(
    ("choice", "said"),
    [
        ({"methods": ["balancd"]}, "no method 'balancd'; there is .* did you mean 'balanced'"),
        ({"orders": [0]}, "order = 0"),
        ({"orders": []}, "nothing to study"),
        ({"steps": [-1.0]}, "step = -1.0"),
        ({"steps": [0.01, 0.007]}, "steps: 0.01 s is no whole multiple of the smallest, 0.007 s"),
        ({"steps": [0.7]}, "steps: 0.7 s is too long for a run of 1 s"),
    ],
)
def test_choice_that_does_not_exist_is_refused(scene, tmp_path, choice, said):
    with pytest.raises(SceneError, match=said):
        fr.study(scene, tmp_path, **choice)


def test_step_too_long_for_a_load_is_left_out_and_said(box_file, tmp_path):
    tap = PUSH.replace("stop = 0.48", "start = 0.01, stop = 0.02")
    found = fr.study(box_scene(box_file, tap), tmp_path, methods=["modal"], orders=[5], steps=[0.08, 0.01])
    assert [row.dt for row in found.rows] == [0.01]
    (note,) = found.notes
    assert note.startswith("lowest modes, order 5, step 80 ms: ")
    assert "acts in the middle of no step" in note


def test_body_that_no_method_can_reduce_is_refused(box_file, tmp_path):
    undamped = box_scene(box_file, effects="inertia = {}")
    with pytest.raises(SolverError, match=r"no reduced model could be measured: balanced, order 5: .*damping"):
        fr.study(undamped, tmp_path, methods=["balanced"], orders=[5], steps=[0.02])


def test_folder_that_cannot_be_made_is_refused(scene, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(FileError, match="cannot be made"):
        fr.study(scene, tmp_path / "file" / "out", quick=True)


MOVING = {
    "thrown": {
        "supports": None,
        "effects": "inertia = {}\ndamping.beta = 1e-2",
        "run": "dt = 0.01\nduration = 0.1\ninitial = { velocity = [1.0, 0, 2.0], spin = [0.5, 6.0, 0.1] }",
    },
    "carried": {
        "effects": "inertia = {}\ndamping.beta = 1e-2\nbase_path.table = 'path.csv'",
        "run": "dt = 0.01\nduration = 0.2",
    },
    "touching": {
        "effects": """inertia = {}
damping.beta = 1e-2
base_path.table = 'path.csv'
contact.obstacles.wall = { shape = "half-space", point = [0.0, 0.0, -0.04], normal = [0.0, 0.0, 1.0] }""",
        "run": "dt = 0.01\nduration = 0.2",
    },
}


@pytest.mark.slow
@pytest.mark.parametrize("name", MOVING)
def test_bodies_whose_frames_move_are_studied(tmp_path, name):
    """Errors of where the body is and of what strains it, against full order in the same frame."""
    mesh = write_arrays(tmp_path / "box.msh", *box_arrays((0.4, 0.1, 0.06), (4, 1, 1)))
    swing = np.array([[0.0, 0, 0, 0, 1, 0, 0, 0], [0.2, 0, 0, 0.05, 0.995, 0, np.sqrt(1 - 0.995**2), 0]])
    parts = MOVING[name] | {"contacts": '[contacts.end]\nsurface = "right"', "outputs.tip": "points = [[0.4, 0.1, 0]]"}
    text = 'frame = "moving"\n' + scene_text(mesh, **parts)
    scene = parse_scene(text, folder=tmp_path, source=name, tables={"path.csv": swing})
    results = fr.study(scene, tmp_path / "studied", methods=["modal"], orders=[2, 12], steps=[0.01, 0.005])
    long, short = ({row.order: row for row in results.rows if row.dt == dt} for dt in (0.01, 0.005))
    coarse, fine = short[min(short)], short[max(short)]
    assert fine.reduction < coarse.reduction / 2
    assert fine.error < 1e-2
    touches = name == "touching"  # where forces jump, and an error goes with the step
    assert fine.time_step < long[fine.order].time_step / (1.5 if touches else 2)
    assert set(fine.forces) == ({"wall"} if touches else set())
    assert set(fine.outputs) == {"tip", "elastic shape"}
    reference = fr.read_trajectory(tmp_path / "studied" / "reference.h5")
    assert reference.pose is not None
    assert (reference.base_wrench is None) == (name == "thrown")
