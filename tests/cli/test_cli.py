"""The command line, as its users meet it: what it does, and what it says when it cannot."""

import os
import re
import shutil
import subprocess
import sys
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bodies import PLATE
from petsc4py import PETSc
from ranks import run_ranks

import fenics_rom as fr
from fenics_rom.cli import display
from fenics_rom.cli.display import progress
from fenics_rom.cli.main import main
from fenics_rom.errors import SceneError
from fenics_rom.fem.direct import HAS_CHOLMOD
from fenics_rom.io.stages import Stage
from fenics_rom.reduction.reduce import BY_NAME
from fenics_rom.scene.scene import LYAPUNOV

DATA = Path(__file__).parents[1] / "data"
ROM, RUN = DATA / "rom-1.0.h5", DATA / "run-1.0.h5"
TEXT = PLATE.read_text().replace("../../meshes/plate.msh", str(PLATE.parents[2] / "meshes" / "plate.msh"))
COMMANDS = {
    "mesh": ["--size", "--glue", "--scale", "--output"],
    "reduce": [
        *("--order", "--tolerance", "--switching", "--weighting", "--lyapunov", "--share", "--output"),
        *("--method", "--solver", "--errors", "--resume"),
        *("--mass", "--stiffness", "--damping", "--rayleigh", "--contact", "--actuator", "--observe"),
        *("--nodes", "--frame", "--units"),
    ],
    "simulate": [
        "--scene",
        "--dt",
        "--every",
        "--order",
        "--profile",
        "--rate",
        "--stepper",
        "--step-error",
        "--errors",
        "--error-tolerance",
        "--enrich",
        "--enriched",
        "--finer",
        "--arc-length",
        "--output",
    ],
    "study": [
        "--tolerance",
        "--quick",
        "--without-reference",
        "--methods",
        "--orders",
        "--steps",
        "--mesh",
        "--resume",
        "--output",
    ],
    "certify": ["--output", "--json", "--resume"],
    "check": ["--runs"],
    "identify": ["--also", "--data", "--parameters", "--output"],
    "info": ["--surfaces", "--output"],
    "view": ["--port", "--no-browser", "--dt"],
    "compare": ["--finer"],
    "plot": ["--what", "--full", "--dark", "--output"],
    "export": [
        "--what",
        "--count",
        "--time",
        "--scale",
        "--colour",
        "--seconds",
        "--dark",
        "--dt",
        "--at",
        "--outputs",
        "--output",
    ],
    "compile": [],
    "zoo": [],
}


def process(*command, **options):
    """A process of its own; in the environment as it was before this one made itself an MPI rank."""
    options = {"env": dict(os.environ), "capture_output": "stdout" not in options, **options}
    return subprocess.run([str(part) for part in command], text=True, timeout=100, **options)


def fenics_rom(*arguments, **options):
    return process(Path(sys.executable).parent / "fenics-rom", *arguments, **options)


@pytest.fixture(scope="module")
def story(tmp_path_factory):
    """The plate from its scene to numbers, each command in its own process; what they printed."""
    folder = tmp_path_factory.mktemp("story")
    printed = {}
    for name, command, *arguments in (
        ("reduce", "reduce", PLATE, "-o", "rom.h5", "--order", "500"),
        ("full", "simulate", PLATE, "-o", "full.h5", "--dt", "0.01"),
        ("reduced", "simulate", "rom.h5", "-o", "run.h5", "--dt", "0.01", "--rate"),
        ("compare", "compare", "run.h5", "full.h5"),
    ):
        run = fenics_rom(command, *arguments, cwd=folder)
        assert run.returncode == 0, run.stderr
        assert "fenics" not in run.stderr  # what a machine's MPI says of the machine may be there
        printed[name] = run.stdout
    return folder, printed


@pytest.fixture
def inside(tmp_path, monkeypatch):
    """Works in an empty folder, in this process."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def say(capfd):
    """Runs a command in this process: its exit status and what it printed."""

    def run(*arguments):
        with pytest.raises(SystemExit) as end:
            main([str(argument) for argument in arguments])
        return end.value.code, *capfd.readouterr()

    return run


def contents(folder):
    return {file.name: (file.stat().st_mtime_ns, file.stat().st_size) for file in folder.iterdir()}


@pytest.fixture
def refused(inside, say):
    """What a command says that cannot be done: one line, and nothing is written or changed."""

    def run(*arguments):
        before = contents(inside)
        status, out, err = say(*arguments)
        assert (status, out) == (1, "")
        assert re.fullmatch(r"fenics-rom: error: [^\n]+\n", err)
        assert contents(inside) == before
        return err.removeprefix("fenics-rom: error: ").rstrip()

    return run


@pytest.fixture
def database():
    """PETSc's options, which live as long as the process."""
    before = set(PETSc.Options().getAll())
    yield lambda: {name: value for name, value in PETSc.Options().getAll().items() if name not in before}
    for name in set(PETSc.Options().getAll()) - before:
        PETSc.Options().delValue(name)


# --- what it does ----------------------------------------------------------------------------------------------------


def test_reduce_says_what_was_kept_of_an_order_that_is_not_there(story):
    kept = re.findall(
        r"mode '(\w+)': order 500 was asked for, (\d+) are numerically there and were kept", story[1]["reduce"]
    )
    modes = fr.read_rom(story[0] / "rom.h5").contact_models
    assert kept == [(name, str(mode.order)) for name, mode in modes.items()]
    assert len(kept) == 2
    assert "180 displacements, 66 nodes" in story[1]["reduce"]


def test_reduced_run_of_all_that_is_there_is_the_full_run(story):
    rows = dict(re.findall(r"^  (output tip|shape|energy) +(\S+)", story[1]["compare"], flags=re.M))
    assert rows.keys() == {"output tip", "shape", "energy"}
    assert all(float(error) < 1e-6 for error in rows.values())
    differences = fr.compare(*(fr.read_trajectory(story[0] / name) for name in ("run.h5", "full.h5")))
    assert f"{differences['shape'].relative:.2e}" == rows["shape"]


@pytest.mark.slow
def test_study_says_what_each_decimal_costs_and_leaves_tables_and_pictures(inside, say):
    grid = ("--methods", "balanced", "modal", "--orders", "5", "20", "--steps", "0.002", "0.004")
    status, out, err = say("study", PLATE, "-o", "out", *grid)
    assert (status, re.sub(r"\d+ s: .*\n", "", err)) == (0, "")  # it may have taken so long that it told how far it is
    assert re.search(r"1e-3 +\w.* 4 ms +6\.\de-04 ", out)
    assert "For 1e-2 of the whole shape: " in out
    assert " times faster than real time and " in out
    pictures = {f"{name}.{ending}" for name in ("speed", "orders", "parts") for ending in ("png", "pdf")}
    assert {path.name for path in Path("out").iterdir()} == pictures | {
        *("study.csv", "study.md", "study.json", "reference.h5")
    }
    command = f"`fenics-rom study {PLATE} -o out {' '.join(grid)}`"
    assert command in Path("out/study.md").read_text()


@pytest.mark.slow
def test_study_for_a_tolerance_writes_the_model(inside, say):
    status, out, err = say("study", PLATE, "-o", "out", "--tolerance", "1e-2")
    assert (status, err) == (0, "")
    sentence, written, *_ = out.splitlines()
    chosen = re.fullmatch(r"For 1e-2 of the whole shape: balanced, order (\d+), step (\d) ms; .*", sentence)
    assert chosen
    assert f"--dt 0.00{chosen[2]}:" in written
    assert max(mode.order for mode in fr.read_rom("out/rom.h5").contact_models.values()) == int(chosen[1])


def test_info_lists_and_draws_the_places_of_a_scene(say, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    place = "[outputs.edge]\nall = ['tip', { box = { corners = [[0, 0, 0], [1, 1, 0.001]] } }]\n"
    Path("scene.toml").write_text(f"{TEXT}\n{place}")
    status, out, err = say("info", "scene.toml", "--surfaces", "-o", "places.png")
    assert status == 1  # as no triangle of the tip is that low
    assert re.search(r"^ +supports.clamped\[0\] +nodes +\d+ +\d+ +- +0, 0, 0 +0, 0.2, 0.01$", out, flags=re.M)
    assert re.search(r"^ +contacts.middle +triangles +\d+ +\d+ +0.\d+ m² ", out, flags=re.M)
    assert out.splitlines()[-1] == "places.png"
    assert Path("places.png").read_bytes().startswith(b"\x89PNG")
    assert re.fullmatch(
        r".* outputs.edge.all: no surface triangle is in all of its places, which pick 8, 40 of 128\n", err
    )
    assert say("info", "scene.toml", "--surfaces", "-o", "places.pdf")[2].endswith("a file that ends in .png\n")
    assert say("info", ROM, "--surfaces")[0] == 1


def test_info_is_what_the_commands_printed(story, say, monkeypatch):
    monkeypatch.chdir(story[0])
    for name, file in (("reduce", "rom.h5"), ("full", "full.h5"), ("reduced", "run.h5")):
        assert say("info", file) == (0, story[1][name], "")
    assert "full run plate: full.h5" in story[1]["full"]
    assert "reduced run plate: run.h5" in story[1]["reduced"]
    for name in ("full", "reduced"):
        assert "steps                     300 of 0.01 s" in story[1][name]
        assert re.search(r"^  body +0.5 x 0.2 x 0.01 m, 2.3 kg, first frequency \d", story[1][name], flags=re.M)
        assert re.search(r"^  cells +120; radius ratio 3 r/R from 0.22, mean 0.23$", story[1][name], flags=re.M)
        assert re.search(r"^  rate +[\d,]+ steps/s, \S+ times real time$", story[1][name], flags=re.M)


def test_simulate_takes_another_load_history_and_a_lower_order(story, inside, say):
    (inside / "other.toml").write_text(TEXT.replace('contact = "tip_left"', 'contact = "middle"'))
    status, out, err = say(
        "simulate", story[0] / "rom.h5", "-o", "run.h5", "--scene", "other.toml", "--order", "5", "--dt", "0.01"
    )
    assert (status, err) == (0, "")
    assert re.search(r"order +5\n", out)
    assert "rate" not in out
    assert fr.read_trajectory("run.h5").contact.tolist() == 301 * [1]


@pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")  # the plate locks
@pytest.mark.parametrize(
    "choices",
    [
        {"tolerance": 0.01, "method": "eigenvector-selection", "share": 0.9},
        {"order": 3, "weighting": "nodal", "lyapunov": "bartels-stewart"},
    ],
)
def test_choices_on_the_command_line_come_before_those_of_the_scene(inside, say, plate_system, choices):
    options = [part for key, value in choices.items() for part in (f"--{key}", value)]
    assert say("reduce", PLATE, "-o", "rom.h5", *options)[0] == 0
    made, expected = fr.read_rom("rom.h5"), fr.reduce(plate_system, **choices)
    assert made.switching == expected.switching
    for name, mode in expected.contact_models.items():
        np.testing.assert_allclose(made.contact_models[name].eigenvalues, mode.eigenvalues, rtol=1e-6)
        np.testing.assert_allclose(
            made.contact_models[name].hankel_singular_values[:3], mode.hankel_singular_values[:3]
        )


def test_reduce_says_what_it_cost_and_how_good_the_models_are(story):
    rom, printed = fr.read_rom(story[0] / "rom.h5"), story[1]["reduce"]
    table = printed[printed.index("offline work\n") :]
    rows = re.findall(r"^  (\S.*?) +([\d.,]+) +([\d.]+) % +([\d,]+) MB$", table, flags=re.M)
    assert [row[0] for row in rows] == [*(stage.name for stage in rom.stages), "total"]
    assert rows[0][0] == "assembly"
    for (_, seconds, _, memory), stage in zip(rows, rom.stages, strict=False):
        assert seconds == f"{stage.seconds:,.2f}"
        assert memory == f"{stage.peak_memory / 1e6:,.0f}"
    total = sum(stage.seconds for stage in rom.stages)
    assert rows[-1][1:] == (f"{total:.2f}", "100.0", rows[-2][3])
    assert abs(sum(float(row[2]) for row in rows[:-1]) - 100) < 0.1 * len(rows)
    for name, mode in rom.contact_models.items():
        last = re.search(rf"^  {name} .* (\S+) +(\S+) +(\d+) frequencies$", printed, flags=re.M).groups()
        assert last == (f"{mode.static_error:.1e}", f"{mode.transfer_errors.max():.1e}", str(len(mode.frequencies)))
    assert re.search(r"^  method +balanced$", printed, flags=re.M)


def test_what_a_file_does_not_say_is_not_made_up(say):
    out = say("info", ROM)[1]
    assert len(re.findall(r"^  (?:right|corner) .* [\d.e-]+ +- +-$", out, flags=re.M)) == 2
    assert "offline" not in out
    assert re.search(r"^  body +\S+ x \S+ x \S+ m, \S+ kg, first frequency \S+ Hz$", out, flags=re.M)
    assert "cells" not in out
    out = say("info", DATA / "rom-1.1.h5")[1]
    errors = r"\S+e-\d+ +\S+e-\d+ +4 frequencies"
    assert len(re.findall(rf"^  (?:right|corner) .* Hz +- +- +{errors}$", out, flags=re.M)) == 2
    assert re.search(r"^  method +modal\+static$", out, flags=re.M)
    assert "\noffline work\n" in out


@pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")  # the plate locks
@pytest.mark.parametrize("choices", [("--method", m) for m in BY_NAME] + [("--lyapunov", r) for r in LYAPUNOV])
def test_every_method_and_route_makes_a_rom(inside, say, choices):
    status, _, err = say("reduce", PLATE, "-o", "rom.h5", "--order", "3", *choices)
    assert (status, err) == (0, "")
    assert fr.read_rom("rom.h5").method == dict([choices]).get("--method", "balanced")
    assert [file.name for file in inside.iterdir()] == ["rom.h5"]


def test_iterative_solver_says_so_then_and_later(inside, say):
    status, out, _ = say("reduce", PLATE, "-o", "rom.h5", "--order", "3", "--solver", "iterative")
    assert status == 0
    assert out.count("  warning: conjugate gradients with algebraic multigrid, as asked for") == 1
    assert say("info", "rom.h5")[1] == out


def test_terminal_shows_bars_with_time_and_memory(inside):
    ours, theirs = os.openpty()
    command = [Path(sys.executable).parent / "fenics-rom", "reduce", PLATE, "-o", "rom.h5", "--order", "3"]
    environment = {**os.environ, "TERM": "xterm", "COLUMNS": "120", "LINES": "40"}
    shown = b""
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=theirs) as run:
        os.close(theirs)
        with suppress(OSError):  # the end
            while part := os.read(ours, 1000):
                shown += part
        assert run.stdout.read().startswith(b"ROM plate: ")
    os.close(ours)
    assert run.returncode == 0
    plain = re.sub(r"\x1b\[[\d;?]*[A-Za-z]", "", shown.decode())
    remaining, elapsed = r"(?:-:--:--|\d:\d\d:\d\d)", r"\d:\d\d:\d\d"
    for stage in ("assembly", "contact modes", "validation"):
        assert re.search(rf"{stage} +\S+ +\d+% {remaining} {elapsed} [1-9]\d\d MB", plain)


def test_names_are_printed_as_they_are(inside, say):
    """Also where they look like markup to what draws the tables."""
    stages = (Stage("[red]K⁻¹[/red] :smile:", 1.0, 1e6),)
    rom = replace(fr.read_rom(ROM), name="[bold]a[/x] :smile: Prüfling", stages=stages)
    fr.write_rom("a[1] :b:.h5", rom)
    status, out, _ = say("info", "a[1] :b:.h5")
    assert status == 0
    assert "\n  [red]K⁻¹[/red] :smile:      1.00   100.0 %" in out
    assert out.startswith("ROM [bold]a[/x] :smile: Prüfling: a[1] :b:.h5\n")


def test_long_names_are_not_cut(inside, say):
    rom = fr.read_rom(ROM)
    fr.write_rom(
        "rom.h5",
        replace(rom, contact_models={100 * "x": rom.contact_models["right"], 100 * "y": rom.contact_models["corner"]}),
    )
    out = say("info", "rom.h5")[1]
    assert 100 * "x" in out
    assert 100 * "y" in out


def test_run_whose_clock_stood_still_is_printed(inside, say):
    run = fr.read_trajectory(RUN)
    fr.write_trajectory("run.h5", replace(run, settings={**run.settings, "seconds": 0.0}))
    assert "rate                      not measured" in say("info", "run.h5")[1]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([PLATE, "--order", "0", "--rate"], f"--order, --rate: for a ROM; {PLATE} is a scene, run at full order"),
        ([PLATE, "--scene", PLATE], f"--scene: for a ROM; {PLATE} is a scene, run at full order"),
        ([PLATE, "--step-error", "1e-3"], f"--step-error: for a ROM; {PLATE} is a scene, run at full order"),
        ([PLATE, "--stepper", "newton"], f"--stepper: for a ROM; {PLATE} is a scene, run at full order"),
        (["copy", "-fenics_rom_eps_ncv", "40"], "-fenics_rom_eps_ncv is for a scene; copy is a ROM"),
    ],
)
def test_options_of_the_other_kind_of_model_are_refused(inside, say, database, arguments, message):
    shutil.copy(ROM, "copy")  # a ROM, whatever it is called
    status, out, err = say("simulate", *arguments, "-o", "run.h5")
    assert (status, out) == (2, "")
    assert err.endswith(f"fenics-rom simulate: error: {message}\n")
    assert not Path("run.h5").exists()


def test_python_refuses_options_of_a_rom_by_name(plate_system):
    with pytest.raises(SceneError, match="profile, stepper cannot be used with a System, which is run at full order"):
        fr.simulate(plate_system, profile=True, stepper="newton")
    with pytest.raises(SceneError, match=r"3 was given; use a Scene, a WorldScene, a System, a Rom, or a file's name$"):
        fr.simulate(3)


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_every_command_names_its_options(say, command):
    status, out, err = say(command, "--help")
    assert (status, err) == (0, "")
    assert out.startswith(f"usage: fenics-rom {command}")
    forced = ["--force"] if "--output" in COMMANDS[command] else []
    assert set(re.findall(r"--[a-z-]+", out)) == {"--help", *COMMANDS[command], *forced}


def test_help_lists_every_command(say):
    status, out, _ = say("--help")
    assert status == 0
    assert [line.split()[0] for line in out.splitlines() if re.match(r"    \w", line)] == list(COMMANDS)


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["redce"],
        ["reduce"],
        ["reduce", "scene.toml"],
        ["reduce", "scene.toml", "-o", "rom.h5", "--order", "many"],
        ["reduce", "scene.toml", "-o", "rom.h5", "--order", "2", "--tolerance", "0.1"],
        ["reduce", "scene.toml", "-o", "rom.h5", "--switching", "none"],
        ["simulate", "rom.h5", "-o", "run.h5", "--dt", "fast"],
        ["compare", "run.h5"],
        ["info", "rom.h5", "more"],
        ["info", "rom.h5", "-fenics_rom_eps_ncv"],
        ["info", "rom.h5", "-o", "places.png"],
        ["simulate", "rom.h5", "-o", "run.h5", "-fenics_rom_eps_ncv", "40"],
        ["reduce", "scene.toml", "-o", "rom.h5", "-mat_mumps_icntl_14", "40"],
        ["reduce", "scene.toml", "-o", "rom.h5", "--fenics_rom_eps_ncv", "40"],
        ["reduce", "-o", "rom.h5", "-fenics_rom_eps_monitor", "scene.toml"],
        ["reduce", "scene.toml", "-o", "rom.h5", "--method", "podd"],
        ["reduce", "scene.toml", "-o", "rom.h5", "--solver", "none"],
        ["simulate", "scene.toml", "-o", "run.h5", "--resume"],
        ["study", "scene.toml"],
        ["study", "scene.toml", "-o", "out", "--methods", "best"],
        ["study", "scene.toml", "-o", "out", "--tolerance", "1e-3", "--quick"],
        ["study", "scene.toml", "-o", "out", "--tolerance", "1e-3", "--mesh", "fine.msh"],
        ["study", "scene.toml", "-o", "out", "--without-reference", "--mesh", "fine.msh"],
    ],
)
def test_wrong_usage_ends_with_status_2(inside, say, database, arguments):
    status, out, err = say(*arguments)
    assert (status, out) == (2, "")
    assert re.fullmatch(r"fenics-rom( \w+)?: error: [^\n]+\n", err)
    assert not any(inside.iterdir())


# --- options of PETSc and SLEPc --------------------------------------------------------------------------------------

EIGENVECTORS = ("reduce", PLATE, "-o", "rom.h5", "--method", "modal", "--order", "5")


@pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")  # the plate locks
class TestOptions:
    @pytest.mark.parametrize("at", [1, 2, 3, 8])
    def test_reach_petsc_from_anywhere_on_the_line(self, inside, say, database, at):
        words = ["-fenics_rom_eps_ncv", "40", "-fenics_rom_factor_mat_mumps_cntl_4", "-1.0"]
        status, out, err = say(*EIGENVECTORS[:at], *words, *EIGENVECTORS[at:])
        assert (status, err) == (0, "")
        assert database() == {"fenics_rom_eps_ncv": "40", "fenics_rom_factor_mat_mumps_cntl_4": "-1.0"}
        assert "nothing has read it" not in out

    def test_without_a_value_take_no_option_of_ours_for_one(self, inside, say, database):
        words = ["-fenics_rom_eps_one", "--switching", "energy", "-fenics_rom_eps_two"]
        assert say(*EIGENVECTORS, *words)[0] == 0
        assert [name for name, value in database().items() if not value] == ["fenics_rom_eps_one", "fenics_rom_eps_two"]

    @pytest.mark.skipif(not HAS_CHOLMOD, reason="this PETSc has no CHOLMOD")
    def test_reach_the_factor_of_a_time_step(self, inside, say, database):
        words = ["-fenics_rom_factor_mat_cholmod_factor", "SUPERNODAL", "-fenics_rom_factor_mat_cholmod_fctor", "x"]
        status, out, _ = say("simulate", PLATE, "-o", "run.h5", "--dt", "0.1", *words)
        assert status == 0
        assert re.findall("option (.*) was given", out) == ["-fenics_rom_factor_mat_cholmod_fctor"]

    def test_that_nothing_reads_are_told_at_the_end(self, inside, say, database):
        out = say(*EIGENVECTORS, "-fenics_rom_eps_nvc", "40", "-fenics_rom_eps_ncv", "40")[1]
        assert out.endswith("\n  warning: option -fenics_rom_eps_nvc was given, but nothing has read it\n")
        assert out.count("nothing has read it") == 1

    def test_of_nothing_here_are_refused_before_the_work(self, refused, database):
        for command in ("reduce", "simulate"):
            said = refused(command, "none.toml", "-o", "out.h5", "-fenics_rom_ncv", "40")
            assert said.startswith("option '-fenics_rom_ncv': use those that begin with -fenics_rom_factor_")
        assert database() == {}

    @pytest.mark.parametrize(
        ("option", "said"),
        [
            (("-fenics_rom_eps_type", "none"), "PETSc: error code 86 .*Unknown EPS type given: none"),
            (("-fenics_rom_factor_mat_mumps_icntl_14", "much"), "mumps could not factor"),
        ],
    )
    def test_with_values_that_do_not_exist_are_an_error_of_one_line(self, refused, database, option, said):
        assert re.match(said, refused(*EIGENVECTORS, *option))


# --- what it refuses -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("there", "instead", "said"),
    [
        ("poisson = 0.49", "poisson = 0.5", "material.poisson = 0.5: use a finite number > -1 and < 0.5"),
        ("density = 2300.0", "density = -1", "material.density = -1: use a finite number > 0, in kg/m3"),
        ("[supports]", "[suports]", "did you mean 'supports'?"),
        (
            "inertia = {}",
            "inertia = {}\nwind = {}",
            "effects: no key 'wind'; there is base_motion, base_path, cables, contact, damping",
        ),
        ('clamped = ["root"]', 'clamped = ["rot"]', "no surface 'rot'; there is middle, root,"),
        ('surface = "middle"', 'surface = "midle"', "no surface 'midle'; there is"),
        ('surface = "middle"', 'surface = "root"', "contacts.middle: the whole patch is clamped"),
        ("plate.msh", "none.msh", "none.msh: not found"),
        ('clamped = ["root"]', 'clamped = "root"', "supports.clamped = 'root': use a list, each a name, or a table"),
        ("[0.5, 0.2, 0.01]", "[9.0, 0.2, 0.01]", "outputs.tip: point [9.0, 0.2, 0.01] is"),
        ("dt = 1e-3", "dt = nan", "run.dt = nan: use a finite number > 0, in s"),
        ("name", "[name", "is not TOML"),
    ],
)
def test_bad_scene_is_refused(inside, refused, there, instead, said):
    (inside / "plate.toml").write_text(TEXT.replace(there, instead, 1))
    for command in ("reduce", "simulate"):
        assert said in refused(command, "plate.toml", "-o", "out.h5")


def test_empty_mesh_group_is_refused(inside, refused):
    mesh = (PLATE.parents[2] / "meshes" / "plate.msh").read_text()
    count, names = re.search(r"\$PhysicalNames\n(\d+)\n((?:.*\n)*?)\$End", mesh).groups()
    mesh = mesh.replace(f"{count}\n{names}", f'{int(count) + 1}\n2 99 "bare"\n{names}', 1)
    (inside / "plate.msh").write_text(mesh)
    (inside / "plate.toml").write_text(PLATE.read_text().replace("../../meshes/", "").replace('"middle"', '"bare"', 1))
    assert "surface 'bare'" in refused("reduce", "plate.toml", "-o", "rom.h5")


@pytest.mark.parametrize(
    ("force", "said"),
    [
        ("[1.0, 2.0]", "contact mode 'tip_left': use 3 numbers in its force (got 2)"),
        ("[0.0, nan, 0.0]", "run.load[0].force[1] = nan: use a finite number, in N"),
    ],
)
def test_force_that_does_not_fit_is_refused(inside, refused, force, said):
    (inside / "plate.toml").write_text(TEXT.replace("[0.0, 0.0, 0.5]   #", f"{force} #"))
    shutil.copy(ROM, inside / "rom.h5")
    assert said in refused("simulate", "plate.toml", "-o", "run.h5")


def test_what_is_no_rom_or_run_is_refused(inside, refused):
    whole = ROM.read_bytes()
    (inside / "short.h5").write_bytes(whole[:5000])
    (inside / "text.h5").write_text("no HDF5")
    damaged = "is damaged: its content is not what was written (the checksum differs)"
    for file, what in (("short.h5", damaged), ("text.h5", "is not a fenics-rom file"), ("none.h5", "not found")):
        for arguments in (
            ("simulate", file, "-o", "run.h5"),
            ("info", file),
            ("compare", file, RUN),
            ("compare", RUN, file),
        ):
            assert refused(*arguments) == f"{file}: {what}"
    assert refused("simulate", RUN, "-o", "run.h5") == f"{RUN}: is a run; use a ROM"
    assert refused("compare", ROM, RUN) == f"{ROM}: is a ROM; use a run"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["reduce", "plate.toml", "--order", "0"], "--order 0: use whole numbers from 1"),
        (["reduce", "plate.toml", "--tolerance", "2"], "--tolerance 2: use more than 0 and less than 1"),
        (["reduce", "plate.toml", "--tolerance", "nan"], "--tolerance nan: use more than 0 and less than 1"),
        (["reduce", "plate.toml", "--share", "0"], "--share 0: use more than 0 and at most 1"),
        (
            ["reduce", "plate.toml", "--share", "0.9"],
            "share = 0.9: goes with method = 'eigenvector-selection', not with",
        ),
        (
            ["reduce", "plate.toml", "--method", "pod", "--switching", "oblique"],
            "switching = 'oblique' goes with method",
        ),
        (["reduce", "eigenvectors.toml"], "have no singular values for a tolerance to leave out; give an order"),
        (["reduce", "none.toml"], "none.toml: cannot be read: No such file or directory"),
        (["reduce", "two\nlines.toml"], "two lines.toml: cannot be read: No such file or directory"),
        (["simulate", "plate.toml", "--dt", "-1"], "dt = -1.0: use more than 0 and at most the duration, 3 s"),
        (["simulate", ROM, "--dt", "nan"], "dt = nan: use more than 0 and at most the duration, 0.4 s"),
        (["simulate", ROM, "--dt", "1e-12"], "dt = 1e-12: a run of 4e+11 steps; use at most 10,000,000"),
        (["simulate", ROM, "--order", "5"], "order 5: use 1 to 4, the largest order in the ROM"),
        (
            ["simulate", ROM, "--scene", "plate.toml"],
            "plate.toml: run.load: the model has no contact mode 'tip_left'; there",
        ),
    ],
)
def test_choice_that_does_not_exist_is_refused(inside, refused, arguments, said):
    (inside / "plate.toml").write_text(TEXT)
    (inside / "eigenvectors.toml").write_text(re.sub("^order = .*$", 'method = "modal"', TEXT, flags=re.M))
    assert said in refused(*arguments, "-o", "out.h5")


def test_scene_without_a_run_is_refused_where_one_is_needed(inside, refused):
    (inside / "plate.toml").write_text(TEXT[: TEXT.index("[run]")])
    for command in (("simulate", ROM, "--scene", "plate.toml"), ("simulate", "plate.toml")):
        assert "[run], so there is no load history" in refused(*command, "-o", "run.h5")


@pytest.mark.parametrize("command", [["reduce", "plate.toml"], ["simulate", "plate.toml"], ["simulate", "rom.h5"]])
def test_place_that_cannot_be_written_to_is_refused_before_the_work(inside, refused, command):
    """Before: none of these inputs exists yet, and the place is what is told."""
    os.mkfifo("pipe")
    assert refused(*command, "-o", "none/out.h5") == "none/out.h5: cannot be written: folder none does not exist"
    assert refused(*command, "-o", ".") == ".: cannot be written: it is a folder or a device"
    assert refused(*command, "-o", "pipe") == "pipe: cannot be written: it is a folder or a device"
    Path(command[1]).touch()
    Path("link").symlink_to(command[1])
    for output in (command[1], f"./{command[1]}", "link"):
        assert "is read by this command, so it cannot be its output" in refused(*command, "-o", output)


def test_a_finer_run_has_shorter_steps(story, refused):
    files = [story[0] / name for name in ("run.h5", "full.h5")]
    assert "took steps of 0.01 s; use shorter ones than the 0.01 s of" in refused(
        "compare", *files, "--finer", files[1]
    )


def test_runs_of_different_bodies_are_not_compared(story, refused):
    assert refused("compare", RUN, story[0] / "run.h5").startswith("the runs are of different meshes: 12 and 66 nodes")


# --- as a process ----------------------------------------------------------------------------------------------------


def test_program_and_module_are_the_same_and_show_no_traceback(inside):
    (inside / "bad.toml").write_text("name = 3\n")
    arguments = ("reduce", "bad.toml", "-o", "rom.h5")
    for run in (fenics_rom(*arguments), process(sys.executable, "-m", "fenics_rom", *arguments)):
        assert (run.returncode, run.stdout) == (1, "")
        assert run.stderr == "fenics-rom: error: bad.toml: name = 3: use a non-empty string\n"
    assert fenics_rom("--version").stdout == f"fenics-rom {fr.__version__}\n"


def test_interrupted_while_it_starts_it_says_so_in_one_line():
    code = """
import sys
class Interrupt:
    def find_spec(self, name, path=None, target=None):
        if name == "fenics_rom.cli.main":
            raise KeyboardInterrupt
sys.meta_path.insert(0, Interrupt())
from fenics_rom.__main__ import main
main()
"""
    run = process(sys.executable, "-c", code)
    assert (run.returncode, run.stdout, run.stderr) == (1, "", "fenics-rom: error: interrupted\n")


def test_reader_that_has_seen_enough_is_no_error():
    reading, writing = os.pipe()
    os.close(reading)
    run = fenics_rom("info", ROM, stdout=writing, stderr=subprocess.PIPE)
    os.close(writing)
    assert (run.returncode, run.stderr) == (0, "")


@pytest.mark.parametrize("closed", [">&-", "2>&-", "<&- >&- 2>&-"])
def test_stream_that_is_closed_is_no_error(closed):
    """Left closed, the first file that is opened would be standard output."""
    program = Path(sys.executable).parent / "fenics-rom"
    run = process("bash", "-c", f"{program} info {ROM} {closed}")
    assert (run.returncode, run.stderr) == (0, "")


def test_file_is_not_written_into_where_output_is_closed(inside):
    program = Path(sys.executable).parent / "fenics-rom"
    assert process("bash", "-c", f"{program} simulate {ROM} -o run.h5 >&-").returncode == 0
    assert fr.read_trajectory("run.h5").steps == 40


def test_output_that_has_no_room_is_an_error_of_one_line():
    with Path("/dev/full").open("w") as full:
        run = fenics_rom("info", ROM, stdout=full, stderr=subprocess.PIPE)
    assert run.returncode == 1
    assert run.stderr == "fenics-rom: error: [Errno 28] No space left on device\n"


def test_terminal_without_greek_letters_gets_the_rest():
    run = fenics_rom("info", ROM, env={**os.environ, "PYTHONIOENCODING": "ascii"})
    assert (run.returncode, run.stderr) == (0, "")
    assert "?_1" in run.stdout
    assert "24 displacements" in run.stdout


@pytest.mark.parametrize(
    ("there", "instead", "said"), [("name", "nam", "no key 'nam'"), (".msh", ".none", "not found")]
)
@pytest.mark.ranks
def test_two_ranks_say_once_what_is_wrong_and_end(inside, there, instead, said):
    """Both before and after MPI is at work."""
    (inside / "plate.toml").write_text(TEXT.replace(there, instead, 1))
    run = run_ranks(2, "-m", "fenics_rom", "reduce", "plate.toml", "-o", "rom.h5")
    assert run.returncode == 1
    (line,) = (line for line in run.stderr.splitlines() if "fenics-rom: error:" in line)
    assert said in line
    assert "Traceback" not in run.stderr
    assert [file.name for file in inside.iterdir()] == ["plate.toml"]


@pytest.mark.ranks
def test_two_ranks_write_one_rom_and_one_summary(inside, plate_rom):
    run = run_ranks(
        2, "-m", "fenics_rom", "reduce", PLATE, "-o", "rom.h5", "--order", "20", "-fenics_rom_eps_nvc", "40"
    )
    assert run.returncode == 0, run.stderr
    assert run.stdout.count("ROM plate: rom.h5") == 1
    assert run.stdout.count("fenics_rom_eps_nvc") == 1  # PETSc on its own would name it, too
    assert [file.name for file in inside.iterdir()] == ["rom.h5"]
    for name, mode in fr.read_rom("rom.h5").contact_models.items():
        σ = plate_rom.contact_models[name].hankel_singular_values[:20]
        np.testing.assert_allclose(mode.hankel_singular_values[:20], σ, rtol=1e-8)


def test_progress_is_told_without_a_terminal_too(monkeypatch, capsys):
    with progress() as report:
        report("full order", 2, 12)
    assert capsys.readouterr().err == ""  # what is done in ten seconds needs no word
    monkeypatch.setattr(display, "LINE_INTERVAL", 0.0)
    with progress() as report:
        report("full order", 3, 12)
        report("reduced models", 1000, 4000)
    assert capsys.readouterr().err == "0 s: full order, 3 of 12\n0 s: reduced models, 1,000 of 4,000\n"
