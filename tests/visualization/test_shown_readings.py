"""Inputs and readings in plots, in files for ParaView and in the viewer: the numbers of the run, where they belong."""

import re
import warnings
from dataclasses import replace

import numpy as np
import pytest
from bodies import acted_on
from matplotlib.figure import Figure
from rom_files import put, refusal, same, tampered, without

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning
from fenics_rom.mechanics.signals import Signal
from fenics_rom.visualization import optional_dependencies
from fenics_rom.visualization.exports.export import _fields
from fenics_rom.visualization.plots.runs import run_panels
from fenics_rom.visualization.viewer.colours import with_unit
from fenics_rom.visualization.viewer.live_body import LiveBody
from fenics_rom.visualization.viewer.live_page import LivePage
from fenics_rom.visualization.viewer.run_page import RunPage
from fenics_rom.visualization.viewer.surface import Surface, reading_fields

EFFECTS = """
inertia = {}
damping = { beta = 1e-3 }
gravity = { acceleration = [0.0, 0.0, -2.0] }
[effects.tendon.cable]
points = [[0.0, 0.2, 0.1], [1.0, 0.2, 0.1]]
[effects.contact.obstacles.floor]
shape = "half-space"
point = [0, 0, -1e-4]
normal = [0, 0, 1]
"""
READINGS = {
    "readings.cable": 'quantity = "length"\nof = "cable"',
    "readings.sole": 'quantity = "contact_pressure"\nof = "sole"',
    "readings.stress": 'quantity = "von_mises_stress"',
    "readings.strain": 'quantity = "strain"\nof = "back"',
    "readings.corner": 'quantity = "stress"\npoints = [[0.5, 0.2, 0.1], [0.7, 0.4, 0.3]]',
    "readings.ball": 'quantity = "marker"\npoint = [1.0, 0.2, 0.4]',
    "outputs.skin": 'quantity = "touch"\nsurface = "bottom"\ntaxels = { rows = 2, columns = 4 }',
}
RUN = 'dt = 0.01\nduration = 0.1\nsnapshots = 2\nload = [{ actuator = "cable", start = 0.05, force = [50.0] }]'


@pytest.fixture(scope="module")
def rom(box_file):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FenicsRomWarning)
        scene = acted_on(box_file, EFFECTS, contacts='[contacts.sole]\nsurface = "bottom"', run=RUN, **READINGS)
        return fr.reduce(fr.assemble(scene), order=20)


@pytest.fixture(scope="module")
def run(rom):
    return fr.simulate(rom)


def lines(panel):
    """Axes, and ordinates of what is drawn in a panel."""
    figure = Figure()
    panel(figure)
    (axes,) = figure.axes
    return axes, [line.get_ydata() for line in axes.get_lines() if len(line.get_ydata())]


def test_inputs_that_change_and_all_readings_have_panels(run):
    panels = run_panels({"run": run})
    assert list(panels) == [
        *("energy", "forces", "pressure", "pressure_map", "input_cable"),
        *(f"reading_{name}" for name in ("cable", "sole", "stress", "strain", "corner", "ball", "skin")),
        *("taxels_skin", "slip_skin"),
    ]
    axes, (values,) = lines(panels["input_cable"])
    assert axes.get_ylabel() == "input (N)"
    np.testing.assert_allclose(values, run.inputs["cable"].values[:, 0])
    axes, (values,) = lines(panels["reading_cable"])
    assert axes.get_ylabel() == "length (m)"
    np.testing.assert_allclose(values, run.readings["cable"].values)
    axes, (values,) = lines(panels["reading_stress"])
    assert axes.get_ylabel() in ("von Mises stress (Pa)", "von Mises stress (kPa)")
    stress = run.readings["stress"].values
    np.testing.assert_allclose(values / values.max(), stress.mean(axis=1) / stress.mean(axis=1).max())
    assert "mean and range of 80 points" in axes.get_title(loc="left") + axes.get_title()
    axes, _ = lines(panels["reading_strain"])
    assert axes.get_ylabel() == "largest principal strain"
    axes, drawn = lines(panels["reading_corner"])
    assert re.match(r"stress \(.?Pa\)", axes.get_ylabel())
    means = run.readings["corner"].values[:, :, :6].mean(axis=1)
    np.testing.assert_allclose(np.transpose(drawn) / np.abs(drawn).max(), means / np.abs(means).max(), atol=1e-12)
    axes, drawn = lines(panels["reading_ball"])
    assert axes.get_ylabel() == "displacement of a marker (µm)"
    np.testing.assert_allclose(np.transpose(drawn), 1e6 * run.readings["ball"].values)
    touch = run.readings["skin"].touch
    _, drawn = lines(panels["reading_skin"])
    np.testing.assert_allclose(np.transpose(drawn) / np.abs(drawn).max(), touch.force / np.abs(touch.force).max())
    _, drawn = lines(panels["slip_skin"])
    pressed = touch.normal_force > 0
    np.testing.assert_array_equal(np.isnan(drawn[0]), ~pressed)
    np.testing.assert_array_equal(drawn[0][pressed], touch.patches.margin[pressed, 0])
    figure = Figure()
    panels["taxels_skin"](figure)
    shown, peak = np.asarray(figure.axes[0].images[0].get_array()), touch.pressures[touch.normal_force.argmax()]
    np.testing.assert_allclose(shown / shown.max(), peak / peak.max())


def test_files_for_paraview_hold_inputs_and_readings(run, tmp_path):
    pyvista = optional_dependencies.pyvista_package()
    fr.export(run, tmp_path / "run.pvd")
    reader = pyvista.get_reader(str(tmp_path / "run.pvd"))
    for instant, row in zip(run.snapshot_times, (5, 10), strict=True):
        reader.set_active_time_value(instant)
        grid = reader.read()[0]
        assert grid.field_data["TimeValue"] == instant
        assert grid.field_data["reading.TimeValue"] == run.times[row]
        np.testing.assert_array_equal(grid.field_data["input.cable"], run.inputs["cable"].values[row])
        np.testing.assert_array_equal(grid.field_data["reading.cable"], run.readings["cable"].values[[row]])
        np.testing.assert_array_equal(grid.cell_data["reading.stress"], run.readings["stress"].values[row])
        np.testing.assert_array_equal(grid.field_data["reading.corner"], run.readings["corner"].values[row])
        np.testing.assert_array_equal(grid.field_data["reading.ball"], run.readings["ball"].values[row])
        skin, touch = run.readings["skin"], run.readings["skin"].touch
        np.testing.assert_array_equal(grid.field_data["reading.skin.force"], touch.force[row])
        np.testing.assert_array_equal(grid.field_data["reading.skin.patches.margin"], touch.patches.margin[row])
        pressures = grid.cell_data["reading.skin"]
        assert np.isnan(pressures).sum() == len(run.triangles) - len(skin.taxels.triangles)
        np.testing.assert_array_equal(pressures[skin.taxels.triangles], skin.taxels.on_triangles(touch.pressures[row]))
        sole, back = run.readings["sole"], run.readings["strain"]
        pressure = grid.point_data["reading.sole"]
        np.testing.assert_array_equal(pressure[sole.nodes], sole.values[row])
        assert np.isnan(pressure).sum() == len(run.nodes) - len(sole.nodes)
        xx, yy, zz, xy, yz, xz = grid.cell_data["reading.strain"][back.triangles].T  # VTK's order
        np.testing.assert_array_equal(np.stack([xx, yy, zz, yz, xz, xy], axis=1), back.values[row])
        assert np.isnan(grid.cell_data["reading.strain"]).any(axis=1).sum() == len(run.triangles) - len(back.triangles)


def test_colours_are_the_readings_where_they_are_read(run):
    surface = Surface(run.nodes, run.triangles)
    fields = reading_fields(surface, run.readings)
    assert {name: field.unit for name, field in fields.items()} == {
        "reading sole": "Pa",
        "reading stress": "Pa",
        "reading strain": "%",
        "reading skin": "Pa",
    }
    skin, felt = run.readings["skin"].at(10), run.readings["skin"].touch.pressures[10]
    triangles = np.zeros(len(run.triangles))
    triangles[skin.taxels.triangles] = skin.taxels.on_triangles(felt)
    np.testing.assert_allclose(fields["reading skin"](skin.on_surface[0]), surface.of_triangles(triangles))
    stress = run.readings["stress"].at(10).sizes[0]
    np.testing.assert_allclose(fields["reading stress"](stress), surface.of_triangles(stress), rtol=1e-15)
    strain = run.readings["strain"].at(10)
    values = fields["reading strain"](strain.sizes[0])
    of_triangles = np.zeros(len(run.triangles))
    of_triangles[strain.triangles] = 100 * strain.sizes[0]
    np.testing.assert_allclose(values, surface.of_triangles(of_triangles))
    others = np.setdiff1d(np.arange(len(run.triangles)), strain.triangles)
    assert not values[np.setdiff1d(surface.faces[others], surface.faces[strain.triangles])].any()
    even = np.ones(len(run.readings["sole"].nodes))
    touched = np.isin(run.triangles, run.readings["sole"].nodes).all(axis=1)
    np.testing.assert_allclose(fields["reading sole"](even)[surface.faces[touched]], 1.0)


def test_touch_is_kept_in_runs_and_is_what_obstacles_do(run, tmp_path):
    fr.write_trajectory(tmp_path / "run.h5", run)
    read = fr.read_trajectory(tmp_path / "run.h5").readings["skin"]
    assert same(read, run.readings["skin"])
    force = run.forces["floor"]
    np.testing.assert_allclose(read.touch.force, force, atol=1e-13 * np.abs(force).max())
    for message, lie in {
        "/readings/skin/taxels/taxels: use numbers below 8": put("readings/skin/taxels/taxels", _more),
        "/readings/skin/values: 59 numbers are none of touch with 8 taxels": put(
            "readings/skin/values", lambda there: there[:, 1:]
        ),
        "/readings/skin/taxels is missing": without("readings/skin/taxels"),
    }.items():
        fr.write_trajectory(tmp_path / "run.h5", run)
        assert message in refusal(fr.read_trajectory, tampered(tmp_path / "run.h5", lie))


def _more(numbers):
    return numbers + 8


def test_page_of_a_run_colours_by_readings_and_tells_lengths(run, viser_server):
    viser = optional_dependencies.viser_package()
    page = RunPage(viser, [run, run], ["one", "other"]).show_on(viser_server)
    page._field.value = "reading stress"
    page._draw(1)
    assert "reading stress up to" in page._status.content
    assert f"cable: {1e3 * run.readings['cable'].values[10]:.5g} mm" in page._status.content
    assert re.search(r"skin: \S+ .?N on \S+ mm², margin to slip 0 %", page._status.content)


def test_readings_of_another_instant_than_the_shape_are_told(run, viser_server):
    """Where not every instant is kept, the nearest one is shown."""
    between = replace(run, snapshot_times=np.array([0.043, 0.1]))
    page = RunPage(optional_dependencies.viser_package(), [between], ["one"]).show_on(viser_server)
    for row, instant in ((0, 4), (1, 10)):
        page._draw(row)
        assert ("readings of t = 0.04 s" in page._status.content) is (row == 0)
        assert f"cable: {with_unit(run.readings['cable'].values[instant], 'm', digits=5)}" in page._status.content


def test_live_page_colours_by_readings_and_tells_lengths(rom, viser_server, tmp_path):
    viser = optional_dependencies.viser_package()
    body = LiveBody(rom)
    page = LivePage(viser, viser_server, body, tmp_path, "box", print)
    body.values[0] = 50.0
    for _ in range(5):
        body.step()
    for name in page._readings:
        page._field.value = name
        page._draw(page._seen())
    page._panel_due = 0.0
    page._update_panel()
    assert "cable: " in page._status.content
    np.testing.assert_array_equal(body.reading("stress").values[0], body.simulator.reading("stress"))


# --- given strokes ---------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def by_length(rom):
    """The same with a cable that the scene makes 2 mm shorter."""
    loads = tuple(replace(load, signal=Signal(np.array([2e-3]))) for load in rom.environment.run.loads)
    environment = replace(rom.environment, controls={"cable": "length"}, run=replace(rom.environment.run, loads=loads))
    return replace(rom, environment=environment)


def test_a_slider_moves_a_stroke_and_the_panel_has_the_tension(by_length, viser_server, tmp_path):
    body = LiveBody(by_length)
    page = LivePage(optional_dependencies.viser_package(), viser_server, body, tmp_path, "box", print)
    (actuator,) = body.actuators
    assert actuator[:4] == ("cable", "mm", 0.0, 2.0)
    page._actuate(0, 1.5)
    assert body.values[0] == pytest.approx(1.5e-3)
    for _ in range(200):
        body.step()
    cable = body.rom.environment.tendons["cable"]
    length = body.reading("cable").values[0]
    assert np.linalg.norm(np.diff(cable, axis=0)) - length == pytest.approx(1.5e-3, rel=1e-3)
    tension = body.simulator.reactions["cable"]
    assert tension > 0
    page._panel_due = 0.0
    page._update_panel()
    assert f"cable: {with_unit(tension, 'N')}" in page._status.content
    body.grab("sole", body.rom.contact_models["sole"].contact_points[:1], np.ones(1))
    body.mouse = body.held_at + np.array([0.0, 0.0, 1e-5])
    body.step()
    body.release()
    body.reset()
    assert body.values[0] == 0.0


def test_reactions_are_drawn_compared_and_written(by_length, tmp_path):
    run = fr.simulate(by_length)
    series = run.reaction_series["cable"]
    assert series.unit == "N"
    np.testing.assert_array_equal(series.values[:, 0], run.reactions["cable"])
    figure = Figure()
    run_panels({"run": run})["reaction_cable"](figure)
    (axes,) = figure.axes
    drawn = axes.get_lines()[0].get_ydata()
    np.testing.assert_allclose(drawn / drawn.max(), run.reactions["cable"] / run.reactions["cable"].max())
    assert axes.get_ylabel().startswith("tension (")
    assert fr.compare(run, run)["reaction cable"].relative == 0.0
    more = replace(run, reactions={"cable": 1.5 * run.reactions["cable"]})
    assert fr.compare(more, run)["reaction cable"].relative == pytest.approx(0.5)
    assert fr.compare(more, run)["reaction cable"].unit == "N"
    row = len(run.snapshots) - 1
    at = int(np.abs(run.times - run.snapshot_times[row]).argmin())
    np.testing.assert_array_equal(_fields(run, row).whole["reaction.cable"], run.reactions["cable"][[at]])
