"""What is drawn is what was measured: lines against arrays, full responses against solves, files against formats."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure

import fenics_rom as fr
from fenics_rom.cli.main import main
from fenics_rom.errors import FileError, SceneError, StructureError
from fenics_rom.io.units import prefixed, readable
from fenics_rom.mechanics.environment import Environment
from fenics_rom.mechanics.nodal_contact import NodalContact
from fenics_rom.reduction.frequency_response import full_responses
from fenics_rom.visualization.figure import DARK, LIGHT
from fenics_rom.visualization.plots.plot import plot
from fenics_rom.visualization.plots.reduced import (
    FULL_PEAK_OFFSETS,
    FULL_POINTS,
    has_frequencies,
    plotted_frequencies,
    reduced_panels,
    reduced_response,
    response_scale,
)
from fenics_rom.visualization.plots.runs import run_panels

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
DATA = Path(__file__).parents[2] / "data"


@pytest.fixture(scope="session")
def touching():
    """A run with an obstacle and friction."""
    return fr.read_trajectory(DATA / "run-1.2.h5")


def drawn(panel):
    """A panel in a figure of its own."""
    figure = Figure(layout="constrained")
    panel(figure)
    figure.canvas.draw()
    return figure


def lines(axes):
    """(x, y) of every line that has points."""
    return [np.array(line.get_data()) for line in axes.get_lines() if len(line.get_xdata()) > 2]


# --- runs ------------------------------------------------------------------------------------------------------------


def test_energy_account_is_the_run_s_in_readable_units(touching):
    axes = drawn(run_panels({"run": touching})["energy"]).axes[0]
    assert axes.get_xlabel() == "time (ms)"
    assert axes.get_ylabel() == "energy (J)"
    sums = [touching.energy, touching.supplied, touching.dissipated, touching.lost_in_switching]
    sums += touching.contact_account.values()
    assert len(lines(axes)) == len(sums) == 7
    still = drawn(run_panels({"run": replace(touching, numerical=touching.energy)})["energy"]).axes[0]
    assert len(lines(still)) == 8
    for (t, values), expected in zip(lines(axes), sums, strict=True):
        np.testing.assert_allclose(t, 1e3 * touching.times)
        np.testing.assert_allclose(values, expected, rtol=1e-14)


def test_pressure_is_that_of_the_shapes_that_a_run_keeps():
    """Two triangles of 5,000 mm²: a corner that both have stands for 1/3 of them, and another one for 1/6."""
    nodes, triangles = (
        np.array([[0.0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0], [0, 0.1, 0]]),
        np.array([[0, 1, 2], [0, 2, 3]]),
    )
    touched = NodalContact(np.arange(4), np.zeros((3, 4, 3)), np.array([[0.0, 0, 0, 0], [2, 0, 1, 0], [3, 1, 0, 0]]))
    run = fr.read_trajectory(DATA / "run-1.2.h5")
    kept = {"snapshots": np.zeros((3, 4, 3)), "snapshot_times": np.array([0.0, 1e-3, 2e-3])}
    run = replace(run, nodes=nodes, triangles=triangles, touched=touched, velocities=None, obstacle_motion={}, **kept)
    panels = run_panels({"run": run})
    above, area, below = drawn(panels["pressure"]).axes
    assert [axes.get_title() for axes in (above, area, below)] == [
        "largest pressure (Pa)",
        "area of pushed nodes (mm²)",
        "normal force (N)",
    ]
    for axes, expected in ((above, [0, 600, 900]), (area, [0, 1e4 * 2 / 3, 1e4 / 2]), (below, [0, 3, 4])):
        t, values = lines(axes)[0]
        np.testing.assert_allclose(t, [0, 1, 2])
        np.testing.assert_allclose(values, expected, rtol=1e-12)
    shown = drawn(panels["pressure_map"]).axes[0]
    assert shown.get_title() == "pressure at 2 ms, along z"
    assert (shown.get_xlabel(), shown.get_ylabel()) == ("x (mm)", "y (mm)")
    np.testing.assert_allclose(shown.collections[0].get_array(), [900, 600, 0, 0])
    tracks = {name: SimpleNamespace(kind="soft", nodes=slice(k, k + 4)) for name, k in (("low", 0), ("up", 4))}
    touched = NodalContact(np.arange(8), np.zeros((3, 8, 3)), np.hstack([touched.pressing, 2 * touched.pressing]))
    both = {"nodes": np.tile(nodes, (2, 1)), "triangles": np.concatenate([triangles, triangles + 4])}
    world = replace(run, **both, bodies=tracks, touched=touched, snapshots=np.zeros((3, 8, 3)))
    panels = run_panels({"run": world})
    low, up = lines(drawn(panels["pressure"]).axes[2])
    np.testing.assert_allclose([low[1], up[1]], [[0, 3, 4], [0, 6, 8]])
    assert drawn(panels["pressure_map"]).axes[0].get_title() == "pressure on up at 2 ms, along z"
    untouched = replace(run, touched=touched._replace(pressing=0 * touched.pressing))
    assert not {"pressure", "pressure_map"} & set(run_panels({"run": untouched}))


def test_output_shows_the_mean_and_range_of_its_points(touching):
    two = np.concatenate([touching.outputs["tip"], 3 * touching.outputs["tip"]], axis=1)
    run = replace(touching, outputs={"tip": two})
    axes = drawn(run_panels({"run": run})["output_tip"]).axes[0]
    scale, unit = prefixed("m", np.abs(two).max())
    assert axes.get_ylabel() == f"displacement ({unit})"
    assert "2 points" in axes.get_title(loc="center") + axes.get_title(loc="left")
    for k, (_, values) in enumerate(lines(axes)):
        np.testing.assert_allclose(values, 2 * scale * touching.outputs["tip"][:, 0, k], rtol=1e-12)
    assert len(axes.collections) == 3
    assert len(drawn(run_panels({"run": touching})["output_tip"]).axes[0].collections) == 0


def test_forces_are_lengths(touching):
    axes = drawn(run_panels({"run": touching})["forces"]).axes[0]
    ((_, values),) = lines(axes)
    np.testing.assert_allclose(values, 1e-3 * np.linalg.norm(touching.forces["floor"], axis=1))
    assert axes.get_ylabel() == "force (kN)"


def test_runs_are_drawn_over_one_another(touching):
    other = replace(touching, outputs={}, forces={}, contact_account={})
    panels = run_panels({"full": touching, "reduced": other})
    assert list(panels) == ["energy", "output_tip", "forces"]
    figure = drawn(panels["energy"])
    assert len(lines(figure.axes[0])) == 7 + 4
    words = [text.get_text() for text in figure.legends[0].get_texts()]
    assert {"stored", "dissipated by friction", "full", "reduced"} <= set(words)
    assert len(lines(drawn(panels["forces"]).axes[0])) == 1


def test_switches_are_marked_where_there_are_few(touching):
    contact = touching.contact.copy()
    contact[20:30] = 1
    run = replace(touching, contacts=("a", "b"), contact=contact)
    marks = [
        line.get_xdata()[0]
        for line in drawn(run_panels({"run": run})["energy"]).axes[0].get_lines()
        if len(line.get_xdata()) == 2
    ]
    np.testing.assert_allclose(marks, 1e3 * run.times[[20, 30]])
    every = replace(run, contact=np.arange(len(run.times)) % 2)
    found = drawn(run_panels({"run": every})["energy"]).axes[0].get_lines()
    assert not [line for line in found if len(line.get_xdata()) == 2]


@pytest.mark.parametrize(
    ("largest", "factor", "unit"),
    [(1.0, 1, "m"), (0.999, 1e3, "mm"), (2e-7, 1e9, "nm"), (5e3, 1e-3, "km"), (0.0, 1, "m"), (1e-30, 1e12, "pm")],
)
def test_prefixes(largest, factor, unit):
    scale, found = prefixed("m", largest)
    assert (scale, found) == (pytest.approx(factor), unit)


def test_units_are_readable():
    assert readable("s^2/kg^1/2") == "s²/√kg"
    assert readable("s^2/kg") == "s²/kg"


# --- ROMs ------------------------------------------------------------------------------------------------------------


def test_hankel_singular_values_are_filled_up_to_the_order(plate_rom):
    figure = drawn(reduced_panels(plate_rom, LIGHT, None)["sigma"])
    axes = figure.axes[0]
    assert axes.get_ylabel() == "σ$_k$ (s²/√kg)"
    for name, (joined, kept, left) in zip(
        plate_rom.contact_models, np.array(axes.get_lines()).reshape(2, 3), strict=True
    ):
        σ = plate_rom.contact_models[name].hankel_singular_values
        np.testing.assert_array_equal(joined.get_ydata(), σ)
        np.testing.assert_array_equal(kept.get_ydata(), σ[:20])
        np.testing.assert_array_equal(left.get_ydata(), σ[20:])
        assert left.get_fillstyle() == "none"


@pytest.mark.parametrize("dense", [False, True])
def test_reduced_response_is_that_of_the_model(plate_rom, dense):
    mode = plate_rom.contact_models["middle"]
    if dense:
        random = np.random.default_rng(3).standard_normal((20, 20))
        mode = replace(mode, damping=np.diag(mode.damping) + random @ random.T)
    ω = np.array([1.0, 6.36, 80.0])
    rom = replace(plate_rom, contact_models={"middle": mode})
    D = np.diag(mode.damping) if mode.damping.ndim == 1 else mode.damping
    for row, found in zip(ω, reduced_response(rom, "middle", ω), strict=True):
        Z = np.diag(mode.eigenvalues) + 1j * row * D - row**2 * np.eye(20)
        assert found == pytest.approx(np.linalg.norm(np.linalg.solve(Z, mode.inputs)), rel=1e-12)


def test_peaks_are_not_missed(plate_rom):
    ω = plotted_frequencies(plate_rom, FULL_POINTS, FULL_PEAK_OFFSETS)
    assert (np.diff(ω) > 0).all()
    assert len(ω) < 120
    mode = plate_rom.contact_models["tip_left"]
    own = np.sqrt(mode.eigenvalues)
    for peak in own[own < ω[-1]]:
        assert np.abs(ω - peak).min() < 1e-12 * peak or np.abs(own - peak).min() < 0.25 * mode.damping.max()


def test_full_responses_are_those_of_dense_solves(plate_system, plate_rom):
    ω = np.array([2.0, 6.3, 40.0])
    found = full_responses(plate_system, plate_rom, ω)
    M, K, D = (matrix @ np.eye(180) for matrix in (plate_system.mass, plate_system.stiffness, plate_system.damping))
    for name, mode in plate_rom.contact_models.items():
        B = plate_system.contacts[name]
        for k, row in enumerate(ω):
            H = np.linalg.solve(K + 1j * row * D - row**2 * M, B)
            reduced = plate_rom.basis @ (
                mode.coordinates @ (mode.inputs / (mode.eigenvalues + 1j * row * mode.damping - row**2)[:, None])
            )
            for columns, expected in ((H, found[name].sizes[k]), (H - reduced, found[name].errors[k])):
                norm = np.sqrt(np.trace(columns.conj().T @ M @ columns).real)
                assert expected == pytest.approx(norm, rel=1e-4)


def test_the_validation_is_what_full_solves_find(plate_system, plate_rom):
    """Its samples are of the same norm, to ten percent."""
    for name, mode in plate_rom.contact_models.items():
        found = full_responses(plate_system, plate_rom, mode.frequencies)[name]
        np.testing.assert_allclose(found.errors / found.sizes.max(), mode.transfer_errors, rtol=0.1)


def test_a_free_body_has_no_rigid_motions_in_its_response(box_file):
    from bodies import scene_text

    from fenics_rom.scene.file import parse_scene

    free = scene_text(box_file).replace('[supports]\nclamped = ["left"]', "")
    system = fr.assemble(parse_scene(free))
    rom = fr.reduce(system, order=12)
    assert rom.rigid == 6
    ω = np.sqrt(rom.contact_models["right"].eigenvalues[6]) * np.array([1e-3, 0.5, 0.9])
    found = full_responses(system, rom, ω)["right"]
    assert found.sizes[0] < 2 * found.sizes[1]  # no 1/ω²
    np.testing.assert_allclose(reduced_response(rom, "right", ω), found.sizes, rtol=1e-3)
    assert (found.errors < 0.05 * found.sizes).all()


def test_response_panel_shows_full_reduced_and_validation(plate_system, plate_rom):
    ω = np.array([1.0, 6.0, 9.0])
    full = {name: (ω, one.sizes, one.errors) for name, one in full_responses(plate_system, plate_rom, ω).items()}
    above, below = drawn(reduced_panels(plate_rom, LIGHT, full)["response"]).axes
    scale, _ = response_scale(plate_rom)
    assert scale == pytest.approx(plate_rom.node_mass.sum() ** -0.5)
    assert above.get_ylabel() == "RMS displacement (m/N)"
    assert below.get_xlabel() == "frequency (Hz)"
    f, H = lines(above)[0]
    np.testing.assert_allclose(f, ω / (2 * np.pi))
    np.testing.assert_allclose(H, scale * full["tip_left"][1])
    samples = [line for line in below.get_lines() if line.get_marker() == "o"]
    np.testing.assert_allclose(samples[0].get_ydata(), plate_rom.contact_models["tip_left"].transfer_errors)


def test_response_without_full_model_and_without_mesh():
    chain = 2 * np.eye(9) - np.eye(9, k=1) - np.eye(9, k=-1)
    ends = {f"place_{k}": np.eye(9)[:, k : k + 1] for k in range(9)}  # more than there are colours
    rom = fr.reduce(fr.System(mass=np.eye(9), damping=chain / 9, stiffness=chain, contacts=ends), order=3)
    figure = drawn(reduced_panels(rom, DARK, None)["response"])
    assert figure.axes[0].get_ylabel() == "|H|"
    assert len(lines(figure.axes[0])) == 9
    assert (
        len(
            {
                line.get_color() if isinstance(line.get_color(), str) else tuple(line.get_color())
                for line in figure.axes[0].get_lines()
                if len(line.get_xdata()) > 2
            }
        )
        == 9
    )


def test_without_inertia_there_are_no_frequencies(plate_rom):
    at_rest = replace(plate_rom, environment=Environment(effects={"gravity": ""}, has_inertia=False))
    assert not has_frequencies(at_rest)
    assert list(reduced_panels(at_rest, LIGHT, None)) == ["sigma"]


# --- files -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("ending", "begins"), [pytest.param("pdf", b"%PDF", marks=pytest.mark.slow), ("svg", b"<?xml"), ("png", b"\x89PNG")]
)
def test_one_file_has_all_panels(plate_rom, tmp_path, ending, begins):
    (file,) = plot(plate_rom, tmp_path / f"rom.{ending}", dark=ending == "svg")
    content = file.read_bytes()
    assert content.startswith(begins)
    if ending == "svg":
        for words in (b"Hankel singular values", b"frequency (Hz)", b"validation", DARK.paper.encode()):
            assert words in content


def test_a_folder_has_a_file_for_each_panel(touching, tmp_path):
    files = plot(touching, tmp_path / "plots")
    assert files == tuple(
        tmp_path / "plots" / f"{name}.{ending}"
        for name in ("energy", "output_tip", "forces")
        for ending in ("pdf", "png")
    )
    assert all(file.stat().st_size > 3000 for file in files)
    assert sorted(files) == sorted((tmp_path / "plots").iterdir())
    assert plot(touching, tmp_path / "plots", what=["energy"]) == files[:2]


def test_command_draws_runs_and_the_full_response(tmp_path, capsys):
    plate = Path(__file__).parents[3] / "demos" / "plate" / "plate.toml"
    run = DATA / "run-1.2.h5"
    for words in (
        ("reduce", plate, "-o", tmp_path / "rom.h5", "--order", 6),
        ("plot", run, run, "-o", tmp_path / "runs.svg"),
        ("plot", tmp_path / "rom.h5", "-o", tmp_path / "rom.svg", "--full", plate, "--what", "response"),
    ):
        with pytest.raises(SystemExit) as ended:
            main([str(word) for word in words])
        assert ended.value.code == 0
    assert capsys.readouterr().out.endswith(f"{tmp_path / 'runs.svg'}\n{tmp_path / 'rom.svg'}\n")
    assert b"full solves" in (tmp_path / "rom.svg").read_bytes()
    assert b"Hankel" not in (tmp_path / "rom.svg").read_bytes()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["run-1.2.h5", "-o", "x.jpg"], "use a folder, or a file that ends in .pdf, .svg, .png"),
        (["run-1.2.h5", "-o", "x.pdf", "--what", "sigma"], "no plot 'sigma'; there is energy, forces, output_tip"),
        (["rom-1.2.h5", "run-1.2.h5", "-o", "x.pdf"], "plots are of one ROM, or of any number of runs"),
        (["run-1.2.h5", "-o", "x.pdf", "--full", "x.toml"], "--full is for a ROM"),
        (["triple-chain-1501.csv", "-o", "x.pdf"], "is not a fenics-rom file"),
        (["run-1.2.h5", "-o", "nowhere/x.pdf"], "nowhere does not exist"),
        (["run-1.2.h5", "-o", "nowhere/x"], "nowhere does not exist"),
        (["run-1.2.h5", "-o", "/proc/x"], "/proc/x: cannot be made: No such file or directory"),
    ],
)
def test_what_cannot_be_drawn_is_one_line(capsys, tmp_path, words, message):
    given = [str(DATA / word) if (DATA / word).exists() else word for word in words]
    given[given.index("-o") + 1] = str(tmp_path / given[given.index("-o") + 1])
    with pytest.raises(SystemExit) as ended:
        main(["plot", *given])
    assert ended.value.code == 1
    text = capsys.readouterr().err
    assert text.count("\n") == 1
    assert message in text
    assert not any(tmp_path.iterdir())


def test_another_scene_s_full_model_is_refused(plate_rom, box_system, tmp_path):
    with pytest.raises(StructureError, match="of 180 displacements, and the scene has another one, of 108"):
        plot(plate_rom, tmp_path / "rom.pdf", full=box_system)
    assert not any(tmp_path.iterdir())


def test_a_model_of_which_nothing_is_known_has_nothing_to_draw(plate_rom, tmp_path):
    nothing = replace(
        plate_rom,
        environment=Environment(effects={"gravity": ""}, has_inertia=False),
        contact_models={
            name: replace(mode, hankel_singular_values=np.empty(0)) for name, mode in plate_rom.contact_models.items()
        },
    )
    with pytest.raises(SceneError, match="there is nothing to draw"):
        plot(nothing, tmp_path / "rom.pdf")


def test_a_file_in_the_place_of_a_folder(touching, tmp_path):
    (tmp_path / "plots").write_text("")
    with pytest.raises(FileError, match="is a file; use a folder"):
        plot(touching, tmp_path / "plots")


def test_matplotlib_is_named_where_it_is_missing(tmp_path):
    code = """
import sys
class Refuse:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] == "matplotlib":
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Refuse())
from fenics_rom.cli.main import main
main()
"""
    words = ("plot", DATA / "run-1.2.h5", "-o", tmp_path / "x.pdf")
    run = subprocess.run([sys.executable, "-c", code, *map(str, words)], capture_output=True, text=True)
    assert (run.returncode, run.stderr) == (
        1,
        'fenics-rom: error: pictures need Matplotlib: pip install "fenics-rom[plot]"\n',
    )


def test_the_look_of_other_figures_stays(touching, tmp_path):
    import matplotlib

    before = dict(matplotlib.rcParams)
    plot(touching, tmp_path / "x.pdf", dark=True)
    assert dict(matplotlib.rcParams) == before
