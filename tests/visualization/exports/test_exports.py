"""What other programs read of a ROM or a run, and what people see of it."""

import io
import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import imageio.v3 as imageio
import imageio_ffmpeg
import numpy as np
import pytest

import fenics_rom as fr
from fenics_rom.cli.main import main
from fenics_rom.errors import FileError, MissingPackageError, SceneError
from fenics_rom.mechanics.frame_motion import quaternion_of_vector, rotation_matrix
from fenics_rom.mechanics.nodal_contact import ContactSurface
from fenics_rom.mechanics.obstacles import Box, Capsule, HalfSpace, Sphere
from fenics_rom.visualization import optional_dependencies
from fenics_rom.visualization.contact_fields import traction_arrows
from fenics_rom.visualization.contact_surface import on_kept_surface
from fenics_rom.visualization.exports import mode_shapes
from fenics_rom.visualization.exports.body_renderer import DARK, BodyRenderer
from fenics_rom.visualization.exports.mode_shapes import SHAPE_KINDS, balanced_modes, eigenvectors, shapes_at_rest

pyvista = optional_dependencies.pyvista_package()
pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
DATA = Path(__file__).parents[2] / "data"
OBSTACLES = {
    "ball": Sphere((1.3, 0.2, 0.1), 0.1),
    "rod": Capsule((1.4, 0.0, 0.0), (1.4, 0.4, 0.0), 0.05),
    "block": Box((0.5, -0.3, 0.1), (0.2, 0.1, 0.1), (0.0, 0.3, 0.0)),
    "ground": HalfSpace((0.0, 0.0, -0.1), (0.0, 0.1, 2.0)),
}


@pytest.fixture(scope="session")
def touching():
    """A ROM with contact, on a box of 1.0 × 0.4 × 0.3 m."""
    return fr.read_rom(DATA / "rom-1.2.h5")


@pytest.fixture(scope="session")
def run(touching):
    """Its run, which keeps three shapes, with one obstacle of each kind; the ball moves."""
    made = fr.simulate(touching)
    shapes = np.concatenate([made.snapshots, 2 * made.snapshots[-1:]])
    still, moving = np.zeros((3, 3)), np.outer([0.0, 1.0, 2.0], [0.1, 0.0, 0.0])
    return replace(
        made,
        snapshots=shapes,
        velocities=np.concatenate([made.velocities, made.velocities[:1]]),
        snapshot_times=np.array([0.01, 0.02500001, 0.05]),
        touched=made.touched._replace(
            **{name: np.concatenate([values, 3 * values[-1:]]) for name, values in made.touched._asdict().items()}
            | {"nodes": made.touched.nodes}
        ),
        obstacles=OBSTACLES,
        obstacle_motion={name: moving if name == "ball" else still for name in OBSTACLES},
    )


def ink(picture, paper=(255, 255, 255)):
    """Share of pixels that are not paper."""
    return float((np.abs(picture[..., :3].astype(int) - paper).max(axis=-1) > 8).mean())


# --- ParaView --------------------------------------------------------------------------------------------------------


def test_series_holds_the_run_to_the_last_bit(run, tmp_path):
    assert fr.export(run, tmp_path / "run.pvd") == tmp_path / "run.pvd"
    assert {path.name for path in tmp_path.iterdir()} == {"run.pvd", "run"}
    reader = pyvista.get_reader(str(tmp_path / "run.pvd"))
    assert reader.time_values == run.snapshot_times.tolist()
    for row, instant in enumerate(run.snapshot_times):
        reader.set_active_time_value(instant)
        grid = reader.read()[0]
        np.testing.assert_array_equal(grid.points, run.nodes)
        np.testing.assert_array_equal(grid.cells.reshape(-1, 4)[:, 1:], run.triangles)
        np.testing.assert_array_equal(grid.point_data["displacement"], run.snapshots[row])
        np.testing.assert_array_equal(grid.point_data["velocity"], run.velocities[row])
        areas = ContactSurface(run.nodes, run.triangles, run.touched.nodes).areas
        pressing = run.touched.pressing[row].sum()
        assert areas @ grid.point_data["contact pressure"] == pytest.approx(pressing, rel=1e-13, abs=1e-300)
        force, scale = run.touched.forces[row].sum(axis=0), 1e-13 * np.abs(run.touched.forces[row]).sum()
        np.testing.assert_allclose(areas @ grid.point_data["contact traction"], force, rtol=0, atol=scale)
    assert pressing > 0
    fr.export(run, tmp_path / "run.pvd")  # replaces what it wrote


def test_paths_in_a_series_are_relative_and_escaped(run, tmp_path):
    fr.export(run, tmp_path / "a & b.pvd")
    files = [entry.get("file") for entry in ET.parse(tmp_path / "a & b.pvd").iter("DataSet")]
    assert files == [f"a & b/a & b_000{k}.vtu" for k in range(3)]
    assert all((tmp_path / file).is_file() for file in files)


def test_a_folder_with_other_things_is_not_replaced(run, tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "thesis.tex").write_text("dear")
    with pytest.raises(FileError, match=r"holds other things, such as 'thesis\.tex'"):
        fr.export(run, tmp_path / "run.pvd")
    assert [path.name for path in tmp_path.rglob("*")] == ["run", "thesis.tex"]


def test_one_instant_is_the_nearest(run, tmp_path):
    for asked, row in ((None, 2), (0.0, 0), (0.02, 1), (0.05, 2)):
        grid = pyvista.read(fr.export(run, tmp_path / "one.vtu", time=asked))
        np.testing.assert_array_equal(grid.point_data["displacement"], run.snapshots[row])
        assert grid.field_data["TimeValue"] == run.snapshot_times[row]


def test_a_run_of_an_earlier_release_has_no_velocities(tmp_path):
    grid = pyvista.read(fr.export(fr.read_trajectory(DATA / "run-1.0.h5"), tmp_path / "old.vtu"))
    assert grid.point_data.keys() == ["displacement"]


@pytest.mark.parametrize("kind", SHAPE_KINDS)
def test_shapes_of_a_rom_are_those_of_the_model(plate_rom, tmp_path, kind):
    grid = pyvista.read(fr.export(plate_rom, tmp_path / "rom.vtu", what=kind, count=3))
    assert grid.point_data.keys() == [f"{name}.{kind}.{k}" for name in plate_rom.contact_models for k in (1, 2, 3)]
    for name, mode in plate_rom.contact_models.items():
        for field in SHAPE_KINDS[kind](plate_rom, mode)[:3]:
            np.testing.assert_array_equal(grid.point_data[f"{name}.{kind}.{field.number}"], field.displacement)
        if kind == "modes":
            np.testing.assert_array_equal(grid.field_data[f"{name}.sigma"], mode.hankel_singular_values[:3])


# --- shapes ----------------------------------------------------------------------------------------------------------


def test_rigid_motions_are_no_modes(touching):
    mode = touching.contact_models["bottom"]
    assert mode.rigid == 6
    assert [len(kind(touching, mode)) for kind in (balanced_modes, eigenvectors)] == [mode.order - 6] * 2
    assert balanced_modes(touching, mode)[0].σ == mode.hankel_singular_values[0]
    assert all(np.isfinite(field.displacement).all() for field in shapes_at_rest(touching, mode))


def test_patches_are_where_contact_modes_are_touched(touching, plate_rom):
    z = touching.nodes[touching.triangles[on_kept_surface(touching, "bottom")]][..., 2]
    assert len(z)
    assert not z.any()
    assert on_kept_surface(plate_rom, "middle").any()  # a group of the mesh, whose nodes the ROM keeps
    centroids = plate_rom.nodes[plate_rom.triangles].mean(axis=1)
    nodes = np.unique(plate_rom.triangles[np.linalg.norm(centroids - [0.25, 0.1, 0.01], axis=1) <= 0.08])
    patch = plate_rom.triangles[on_kept_surface(replace(plate_rom, contact_surfaces={"middle": nodes}), "middle")]
    assert len(patch)
    np.testing.assert_array_equal(np.unique(patch), nodes)


# --- pictures --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dark", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_still_shows_the_body_its_obstacles_and_words(run, tmp_path, dark):
    picture = imageio.imread(fr.export(run, tmp_path / "run.png", dark=dark))
    bare = imageio.imread(fr.export(replace(run, obstacles={}, obstacle_motion={}), tmp_path / "bare.png", dark=dark))
    paper = picture[-1, 0, :3].tolist() if not dark else [int(DARK.paper[k : k + 2], 16) for k in (1, 3, 5)]
    assert 0.2 < ink(bare, paper) < 0.8
    assert picture.shape[1] == 1000
    assert len(np.unique(bare[..., :3] @ [1, 256, 65536])) > 200  # shades, a colour bar
    assert not np.array_equal(picture.shape, bare.shape) or ink(picture, paper) != ink(bare, paper)


def test_contact_pressure_is_seen_through_obstacles_with_arrows(run, tmp_path):
    """In the colours of its largest, as it is pushed by a ground that nothing else hides."""
    ground = {"ground": HalfSpace((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))}
    on_ground = replace(run, obstacles=ground, obstacle_motion={"ground": np.zeros((3, 3))})
    pressed = imageio.imread(fr.export(on_ground, tmp_path / "pressed.png", colour="contact_pressure"))
    untouched = replace(on_ground, touched=run.touched._replace(forces=0 * run.touched.forces))
    without = imageio.imread(fr.export(untouched, tmp_path / "without.png", colour="contact_pressure"))
    assert apart(pressed[..., :3], without[..., :3]) > 1e-3  # arrows
    shown = imageio.imread(fr.export(on_ground, tmp_path / "shown.png"))
    assert apart(pressed[..., :3], shown[..., :3]) > 0.1
    with pytest.raises(SystemExit, match="0"):
        main(
            ["export", str(written(on_ground, tmp_path)), "--colour", "contact_pressure", "-o", str(tmp_path / "a.png")]
        )
    np.testing.assert_array_equal(imageio.imread(tmp_path / "a.png"), pressed)


def written(run, folder):
    """Its file."""
    fr.write_trajectory(folder / "kept.h5", run)
    return folder / "kept.h5"


def test_arrows_of_tractions_end_where_they_act():
    places, traction = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]), np.array([[0.0, 0, 4], [0, 0, 1e-3], [2, 0, 0]])
    arrows = traction_arrows(places, traction, 4.0, 10.0)
    np.testing.assert_allclose(arrows, [[[0, 0, -1.2], [0, 0, 0]], [[1.4, 0, 0], [2, 0, 0]]], rtol=1e-15)
    assert not len(traction_arrows(places, 0 * traction, 0.0, 10.0))


def test_colours_that_cannot_be_shown_are_refused(run, touching, tmp_path):
    for given, file, colour, words in (
        (run, "a.png", "speed", "no colour 'speed'; there is contact_pressure, displacement"),
        (run, "a.pvd", "contact_pressure", "holds all fields; --colour is for .png, .gif, .mp4"),
        (replace(run, touched=None), "a.gif", "contact_pressure", "keeps no contact"),
        (touching, "a.png", "contact_pressure", "--colour is for runs"),
    ):
        with pytest.raises(FileError, match=re.escape(words)):
            fr.export(given, tmp_path / file, colour=colour)


@pytest.mark.slow
def test_every_obstacle_is_where_it_is(run):
    """Only what is drawn of the obstacle differs, and it moves with it."""
    for name in OBSTACLES:
        one = {name: OBSTACLES[name]}
        moved = np.array([[[0.0, 0.0, 0.0]], [[0.0, 0.0, -0.2]]])
        renderer = BodyRenderer(run.nodes, run.triangles, [run.snapshots[0]], obstacles=one, offsets=moved, width=300)
        there, lower = (renderer.render(run.snapshots[0], offset) for offset in moved)
        renderer.close()
        assert there.shape == lower.shape
        assert (there != lower).any(axis=-1).mean() > 0.003


def drawn(run, shape, offset=None, **how):
    """A picture of a shape without captions, of a camera that sees nothing besides."""
    offsets = None if offset is None else offset[None]
    renderer = BodyRenderer(run.nodes, run.triangles, [shape], offsets=offsets, captions=False, width=300, **how)
    picture = renderer.render(shape, offset)
    renderer.close()
    return picture


def apart(first, second):
    """Share of pixels that differ by more than their rounding."""
    return (np.abs(first.astype(int) - second).max(axis=-1) > 8).mean()


def test_an_obstacle_that_has_moved_is_seen_as_one_that_was_there(run):
    away, shape = np.array([0.0, -0.4, 0.0]), run.snapshots[0]
    ball, block = OBSTACLES["ball"], OBSTACLES["block"]
    there = replace(block, center=tuple(block.center + away))
    moved = drawn(run, shape, np.array([np.zeros(3), away]), obstacles={"ball": ball, "block": block})
    still = drawn(run, shape, np.zeros((2, 3)), obstacles={"ball": ball, "block": there})
    assert apart(moved, still) == 0
    home = drawn(run, shape, np.zeros((2, 3)), obstacles={"ball": ball, "block": block})
    assert home.shape != moved.shape or apart(moved, home) > 0.01


def test_an_obstacle_that_has_turned_is_seen_as_one_that_was_turned(run):
    """About a point of its own, as a run has it: X is at p + R X."""
    turn, shape, block = np.array([0.2, 0.1, 0.7]), run.snapshots[0], OBSTACLES["block"]
    rotation = quaternion_of_vector(turn)
    centre = np.array(block.center)
    pose = np.concatenate([centre - rotation_matrix(rotation) @ centre, rotation])
    posed = drawn(run, shape, pose[None], obstacles={"block": replace(block, rotation=(0.0, 0.0, 0.0))})
    there = drawn(run, shape, np.zeros((1, 3)), obstacles={"block": replace(block, rotation=tuple(turn))})
    assert posed.shape == there.shape
    assert apart(posed, there) < 1e-3
    home = drawn(run, shape, np.zeros((1, 3)), obstacles={"block": replace(block, rotation=(0.0, 0.0, 0.0))})
    assert home.shape != posed.shape or apart(posed, home) > 0.003


def test_scale_shows_body_and_tendons_as_those_of_larger_displacements(run):
    shape, scale = run.snapshots[2], 0.3 / np.abs(run.snapshots[2]).max()
    how = {"tendons": {"cable": np.array([[0.1, 0.2, 0.15], [0.9, 0.2, 0.15]])}}
    enlarged, larger = drawn(run, shape, scale=scale, **how), drawn(run, scale * shape, **how)
    assert enlarged.shape == larger.shape
    assert apart(enlarged, larger) < 1e-4  # colours of both are of their largest
    small = drawn(run, shape, **how)
    assert small.shape != larger.shape or apart(small, larger) > 0.05


def test_scale_enlarges_what_is_seen_and_not_what_it_says(run):
    renderers = [BodyRenderer(run.nodes, run.triangles, run.snapshots, scale=scale, width=300) for scale in (1.0, 50.0)]
    assert len({(renderer._largest, renderer._unit) for renderer in renderers}) == 1


def frames(film, height, width):
    """All pictures of an .mp4 file, by the encoder's own program."""
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", "-i", film, "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    raw = subprocess.run(command, capture_output=True, check=True, stdin=subprocess.DEVNULL).stdout
    return np.frombuffer(raw, np.uint8).reshape(-1, height, width, 3)


def test_films_have_a_picture_for_each_shape(run, tmp_path):
    gif = fr.export(run, tmp_path / "run.gif")
    pictures = imageio.imread(gif)
    assert len(pictures) == 3
    assert imageio.immeta(gif)["duration"] == 50
    assert imageio.immeta(gif)["loop"] == 0
    again = frames(fr.export(run, tmp_path / "run.mp4"), *pictures.shape[1:3])
    assert len(again) == 3
    for some in (pictures, again):
        assert all(0.2 < ink(picture) < 0.9 for picture in some)
        assert len({picture.tobytes() for picture in some}) == 3
    assert np.abs(pictures[..., :3].astype(int) - again).mean() < 3  # of 255


def test_tendons_are_seen_through_the_body(run, tmp_path):
    inside = np.array([[0.1, 0.2, 0.15], [0.9, 0.2, 0.15]])
    alone = replace(run, obstacles={}, obstacle_motion={}, tendons={"cable": inside})
    picture = imageio.imread(fr.export(alone, tmp_path / "inside.png"))[..., :3].astype(int)
    seen = np.argwhere(np.abs(picture - (0xD5, 0x5E, 0x00)).max(axis=2) < 30)
    wide, across = np.ptp(seen[:, 1]), np.ptp(np.argwhere(picture[100:-100].min(axis=2) < 200)[:, 1])
    assert 0.5 < wide / across < 0.9  # 0.8 of the body's length, seen from its front
    assert len(seen) > 3 * wide  # a line of four pixels


@pytest.mark.slow
def test_length_of_a_film(run, tmp_path):
    assert imageio.immeta(fr.export(run, tmp_path / "slow.gif", seconds=3.0))["duration"] == 1000
    assert len(list(imageio.imiter(fr.export(run, tmp_path / "short.gif", seconds=0.1)))) == 2


def test_sheet_has_a_row_for_each_contact_mode(plate_rom, tmp_path, monkeypatch):
    figures = []
    write = mode_shapes.write_figure

    def write_and_keep(figure, file, dpi):
        figures.append(figure)
        write(figure, file, dpi)

    monkeypatch.setattr(mode_shapes, "write_figure", write_and_keep)
    picture = imageio.imread(fr.export(plate_rom, tmp_path / "modes.png", count=3))
    panels = figures[0].axes
    assert len(panels) == 6
    assert all(0.05 < ink(np.asarray(axes.images[0].get_array())) < 0.7 for axes in panels)
    titles = [axes.get_title(loc="left") for axes in panels]
    for name, words in zip(plate_rom.contact_models, (titles[:3], titles[3:]), strict=True):
        mode = plate_rom.contact_models[name]
        σ, f = mode.hankel_singular_values[1], balanced_modes(plate_rom, mode)[1].frequency
        assert words[1] == f"2: σ = {σ:.1e}, {f:.3g} Hz"
    assert [axes.get_ylabel() for axes in panels[::3]] == ["tip left", "middle"]
    assert "s²/√kg" in figures[0]._suptitle.get_text()
    assert 0.03 < ink(picture) < 0.5


@pytest.mark.parametrize(("kind", "ending"), [("eigenvectors", "pdf"), ("rest", "svg")])
def test_other_sheets_and_formats(touching, tmp_path, kind, ending):
    content = fr.export(touching, tmp_path / f"sheet.{ending}", what=kind, count=1, dark=True).read_bytes()
    assert content.startswith({"pdf": b"%PDF", "svg": b"<?xml"}[ending])


def test_modes_of_a_method_without_singular_values_have_none(plate_rom, tmp_path):
    without = {
        name: replace(mode, hankel_singular_values=np.empty(0)) for name, mode in plate_rom.contact_models.items()
    }
    grid = pyvista.read(fr.export(replace(plate_rom, contact_models=without, method="modal"), tmp_path / "rom.vtu"))
    assert sorted(grid.field_data.keys()) == ["middle.frequency", "tip_left.frequency"]


# --- the record that this rests on -----------------------------------------------------------------------------------


def test_velocities_are_the_rates_of_the_shapes(plate_rom):
    """The midpoint rule: the mean of two velocities is the rate of the displacement between them."""
    run = replace(plate_rom.environment.run, duration=0.05, snapshots=50)
    every = fr.simulate(plate_rom, scene=replace(plate_rom.environment, run=run))
    assert every.velocities.shape == every.snapshots.shape == (50, len(plate_rom.nodes), 3)
    rates, means = np.diff(every.snapshots, axis=0) / 1e-3, (every.velocities[1:] + every.velocities[:-1]) / 2
    np.testing.assert_allclose(rates, means, atol=1e-9 * np.abs(means).max())


def test_obstacles_are_written_and_read(run, tmp_path):
    fr.write_trajectory(tmp_path / "run.h5", run)
    read = fr.read_trajectory(tmp_path / "run.h5")
    assert read.obstacles == OBSTACLES
    assert list(read.obstacles) == list(OBSTACLES)
    for name, motion in run.obstacle_motion.items():
        np.testing.assert_array_equal(read.obstacle_motion[name], motion)
    np.testing.assert_array_equal(read.velocities, run.velocities)


# --- bad input -------------------------------------------------------------------------------------------------------


def said(capsys, *words):
    """What the command line says where it cannot."""
    with pytest.raises(SystemExit) as ended:
        main([str(word) for word in words])
    assert ended.value.code == 1
    text = capsys.readouterr().err
    assert text.count("\n") == 1
    return text


@pytest.mark.parametrize(
    ("file", "arguments", "words"),
    [
        ("run-1.2.h5", ["-o", "x.jpg"], r"a run becomes a file that ends in .pvd, .vtu, .png, .gif, .mp4"),
        ("rom-1.2.h5", ["-o", "x.gif"], r"a ROM becomes a file that ends in .vtu, .png, .pdf, .svg"),
        ("rom-1.2.h5", ["-o", "x"], r"a ROM becomes a file that ends in"),
        ("run-1.2.h5", ["-o", "x.png", "--time", "0.1"], r"--time 0.1: use 0 to 0.05 s, which the run lasts"),
        ("run-1.2.h5", ["-o", "x.png", "--time", "nan"], r"--time nan: use 0 to 0.05 s"),
        ("run-1.2.h5", ["-o", "x.pvd", "--time", "0.01"], r"shows all instants; --time is for .vtu and .png"),
        ("run-1.2.h5", ["-o", "x.png", "--what", "modes"], r"has no modes; --what and --count are for ROMs"),
        ("run-1.2.h5", ["-o", "x.png", "--scale", "0"], r"--scale 0: use finite numbers > 0"),
        ("run-1.2.h5", ["-o", "x.gif", "--seconds", "-1"], r"--seconds -1: use more than 0 and at most 3600"),
        ("rom-1.2.h5", ["-o", "x.png", "--time", "0.1"], r"has no instants; --time is for runs"),
        ("rom-1.2.h5", ["-o", "x.png", "--count", "0"], r"--count 0: use whole numbers from 1"),
        ("rom-1.2.h5", ["-o", "nowhere/x.png"], r"folder .*nowhere does not exist"),
        ("triple-chain-1501.csv", ["-o", "x.png"], r"is not a fenics-rom file"),
        ("not there.h5", ["-o", "x.png"], r"not found"),
        ("run-1.2.h5", ["-o", "/proc/x.png"], r"/proc/x.png: cannot be written: No such file or directory"),
        ("run-1.2.h5", ["-o", "/proc/x.pvd"], r"/proc/x: cannot be written: No such file or directory"),
    ],
)
def test_what_cannot_be_done_is_one_line(capsys, tmp_path, file, arguments, words):
    output = tmp_path / arguments[1]
    text = said(capsys, "export", DATA / file, "-o", output, *arguments[2:])
    assert words.replace("\\", "").split(".*")[-1] in text
    assert not any(tmp_path.iterdir())


def test_a_model_without_a_mesh_has_nothing_to_show(tmp_path):
    chain = 2 * np.eye(7) - np.eye(7, k=1) - np.eye(7, k=-1)
    system = fr.System(mass=np.eye(7), damping=chain / 9, stiffness=chain, contacts={"end": np.eye(7)[:, :1]})
    with pytest.raises(SceneError, match="has no surface to draw: it is of matrices"):
        fr.export(fr.reduce(system, order=3), tmp_path / "x.png")


def test_a_run_without_shapes_has_nothing_to_show(run, tmp_path):
    for nothing in (replace(run, triangles=run.triangles[:0]), replace(run, snapshots=run.snapshots[:0])):
        with pytest.raises(FileError, match="has no surface to draw"):
            fr.export(nothing, tmp_path / "x.png")


def test_missing_packages_are_named(tmp_path):
    code = """
import sys
class Refuse:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] == "pyvista":
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Refuse())
from fenics_rom.cli.main import main
main()
"""
    words = ("export", DATA / "run-1.2.h5", "-o", tmp_path / "x.vtu")
    run = subprocess.run([sys.executable, "-c", code, *map(str, words)], capture_output=True, text=True)
    assert run.returncode == 1
    assert run.stderr == (
        "fenics-rom: error: pictures of bodies and files for ParaView need pyvista, which this Python lacks: "
        'pip install "fenics-rom[view]"\n'
    )


@pytest.mark.slow
def test_pictures_are_drawn_beside_fenicsx(tmp_path):
    """Which is loaded first: dolfinx 0.5 makes the symbols of what comes later global, and VTK crashed."""
    code = """
import sys, dolfinx, fenics_rom as fr
run, rom = fr.read_trajectory(sys.argv[1]), fr.read_rom(sys.argv[2])
fr.export(run, sys.argv[3] + "/x.png", dark=True)
fr.export(rom, sys.argv[3] + "/modes.png", count=2)
try:
    fr.export(run, sys.argv[3] + "/x.png", time=1e9)
except fr.errors.FenicsRomError as error:
    print(error)
"""
    words = (DATA / "run-1.2.h5", DATA / "rom-1.2.h5", tmp_path)
    run = subprocess.run([sys.executable, "-c", code, *map(str, words)], capture_output=True, text=True)
    assert (run.returncode, run.stderr) == (0, "")
    assert "--time 1e+09: use 0 to" in run.stdout
    assert sorted(file.name for file in tmp_path.iterdir()) == ["modes.png", "x.png"]


def test_where_drawing_would_end_the_program_it_is_refused():
    code = "import dolfinx, pyvista; from fenics_rom.visualization.optional_dependencies import *; pyvista_package()"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert "PyVista was imported after dolfinx" in run.stderr.splitlines()[-1]


def test_without_egl_pictures_are_refused_and_files_for_paraview_are_not(run, tmp_path, monkeypatch):
    monkeypatch.setattr(optional_dependencies, "EGL", "libEGL.so.none")
    with pytest.raises(MissingPackageError, match="which this system lacks: sudo apt-get install libegl1"):
        fr.export(run, tmp_path / "x.gif")
    assert not any(tmp_path.iterdir())
    fr.export(run, tmp_path / "x.vtu")


@pytest.mark.slow
def test_nothing_is_said_of_a_screen_that_is_not_there(tmp_path):
    words = ("export", DATA / "run-1.2.h5", "-o", tmp_path / "x.png")
    run = subprocess.run(
        [sys.executable, "-m", "fenics_rom", *map(str, words)], capture_output=True, text=True, env={"PATH": "/usr/bin"}
    )
    assert (run.returncode, run.stderr, run.stdout) == (0, "", f"{tmp_path / 'x.png'}\n")
    assert ink(imageio.imread(io.BytesIO((tmp_path / "x.png").read_bytes()))) > 0.1
