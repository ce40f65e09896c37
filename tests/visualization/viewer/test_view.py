"""`fr.view` in Python: of objects and files, beside the program, as in a notebook."""

import http.client
import re
import subprocess
import sys
import time
from contextlib import closing
from dataclasses import replace
from urllib.parse import urlsplit

import numpy as np
import pytest

import fenics_rom as fr
from fenics_rom.errors import CompareError, SceneError, StepError
from fenics_rom.mechanics.obstacles import HalfSpace, Sphere
from fenics_rom.visualization.viewer import view

BESIDE = {"port": 0, "browser": False, "wait": False}


@pytest.fixture(scope="module")
def run(plate_rom):
    return fr.simulate(plate_rom, dt=0.01)


@pytest.fixture(scope="module")
def files(tmp_path_factory, plate_rom, run):
    folder = tmp_path_factory.mktemp("view")
    fr.write_rom(folder / "plate.h5", plate_rom)
    fr.write_trajectory(folder / "run.h5", run)
    return folder


def status(address):
    """What a browser is answered."""
    url = urlsplit(address)
    with closing(http.client.HTTPConnection(url.hostname, url.port, timeout=10)) as connection:
        connection.request("GET", url.path)
        with connection.getresponse() as answer:
            answer.read()
            return answer.status


def until(condition):
    """Waits for something to become true."""
    end = time.monotonic() + 30
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_what_is_compiled_is_compiled_before_there_is_a_page(plate_rom, monkeypatch):
    """The body is then where it begins."""
    done, serve, step = [], view.Server, view.LiveBody._take_step
    monkeypatch.setattr(view, "compiled", lambda: True)
    monkeypatch.setattr(view.LiveBody, "_take_step", lambda body: (done.append("step"), step(body))[1])
    monkeypatch.setattr(view.LivePage, "run", lambda page, ended: None)
    monkeypatch.setattr(view, "Server", lambda port: (done.append("page"), serve(port))[1])
    with fr.view(plate_rom, **BESIDE) as page:
        assert done == ["step", "step", "page"]
        body = page._page.body
        assert (body.time, body.steps, body.account.supplied) == (0.0, 0, 0.0)
        assert not body.simulator.displacement().any()


def test_a_rom_is_stepped_beside_the_program_until_it_is_closed(plate_rom):
    with fr.view(plate_rom, **BESIDE) as page:
        assert status(page.address) == 200
        until(lambda: page._page.body.steps >= 5)
        assert repr(page) == f"View at {page.address}; close() ends it"
        assert f'src="{page.address}"' in page._repr_html_()
    steps = page._page.body.steps
    with pytest.raises(ConnectionRefusedError):
        status(page.address)
    assert page._page.body.steps == steps
    assert repr(page).endswith("closed")
    page.close()  # once more is no harm


def test_what_is_recorded_is_written_when_the_view_is_closed(plate_rom, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with fr.view(plate_rom, **BESIDE) as page:
        page._page.body.record()
        before = page._page.body.steps
        until(lambda: page._page.body.steps >= before + 5)
    assert fr.read_trajectory(tmp_path / "plate-view-1.h5").steps >= 5


@pytest.mark.parametrize("given", [("plate.h5",), ("run.h5",), ("run.h5", "run.h5")])
def test_files_are_shown(files, given):
    with fr.view(*(files / name for name in given), **BESIDE) as page:
        assert status(page.address) == 200


def test_runs_are_shown_beside_each_other(run, files):
    with fr.view(run, str(files / "run.h5"), **BESIDE) as page:
        assert "0.00e+00 of the shape" in page._page._comparison


def test_a_world_is_stepped_anew_beside_the_program(tmp_path):
    """From Python, as it was read, and by the name of its file; the one that was given stays where it is."""
    file = tmp_path / "ball.toml"
    file.write_text('[bodies.ball]\nshape = "sphere"\nradius = 0.1\nmass = 1.0\n[run]\ndt = 5e-3\nduration = 1.0\n')
    scene = fr.read_world(file)
    world = fr.make_world(scene)
    for given in (world, scene, file):
        with fr.view(given, dt=1e-3, **BESIDE) as page:
            assert status(page.address) == 200
            until(lambda: page._page.live.steps >= 5)
            assert page._page.live.dt == 1e-3
    assert world.steps == 0
    with pytest.raises(SceneError, match=r"ball.toml: is a world, and is viewed alone"):
        fr.view(file, file, **BESIDE)


@pytest.mark.parametrize(
    ("given", "options", "error", "says"),
    [
        (("rom", "run"), {}, SceneError, "plate: is a ROM, and is viewed alone"),
        (("rom",), {"dt": -1.0}, StepError, "dt = -1.0: use a finite number > 0"),
        (("run",), {"dt": 1.0}, SceneError, "dt is the time step of a ROM"),
        (("run", "other"), {}, CompareError, "the runs are of different meshes"),
    ],
)
def test_what_cannot_be_shown(given, options, error, says, plate_rom, run):
    things = {"rom": plate_rom, "run": run, "other": replace(run, nodes=run.nodes + 1.0)}
    with pytest.raises(error, match=says):
        fr.view(*(things[name] for name in given), **BESIDE, **options)


def scene_nodes(page, pattern):
    """What a viser scene holds, by name."""
    handles = page._server.viser.scene._handle_from_node_name
    return {name: handle for name, handle in handles.items() if re.search(pattern, name)}


def test_runs_beside_each_other_have_their_own_obstacles_and_tendons(run):
    """Which move with them; a half-space goes on for ever, and is drawn once if both lie on it."""
    steps = np.zeros((len(run.snapshots), 3))
    ball, floor = Sphere((0.3, 0.1, 0.2), 0.05), HalfSpace((0.0, 0.0, -0.5), (0.0, 0.0, 1.0))
    one = replace(
        run,
        obstacles={"ball": ball, "floor": floor},
        obstacle_motion={"ball": steps + np.array([0.0, 0.0, 0.1]), "floor": steps},
        tendons={"cable": np.array([[0.1, 0.1, 0.005], [0.4, 0.1, 0.005]])},
    )
    other = replace(
        one, obstacle_motion={"ball": steps - np.array([0.0, 0.0, 0.1]), "floor": steps}, snapshots=0 * run.snapshots
    )
    with fr.view(one, other, **BESIDE) as page:
        page._page._draw(len(run.snapshots) - 1)  # there is no browser, so that nothing else draws
        page._page._next_picture.show()
        obstacles, tendons = scene_nodes(page, "/obstacles/"), scene_nodes(page, "/tendons/")
    assert list(obstacles) == ["/run_0/obstacles/ball", "/run_0/obstacles/floor", "/run_1/obstacles/ball"]
    apart = np.subtract(*(obstacles[f"/run_{k}/obstacles/ball"].position for k in (1, 0)))
    size = 0.5  # m, of the plate
    np.testing.assert_allclose(apart[[0, 2]], [0.0, -0.2 / size], atol=1e-6)
    assert apart[1] > 0.2 / size
    np.testing.assert_allclose(tendons["/run_1/tendons/0"].points[0] * size, one.tendons["cable"], atol=1e-6)
    moved = tendons["/run_0/tendons/0"].points[0] * size - one.tendons["cable"]
    nearest = [np.linalg.norm(run.nodes - point, axis=1).argmin() for point in one.tendons["cable"]]
    np.testing.assert_allclose(moved, run.snapshots[-1][nearest], atol=0.3 * np.abs(run.snapshots[-1]).max())
    assert np.abs(moved).max() > 0


INTERACTIVE = """
import sys, threading
import fenics_rom as fr
page = fr.view(sys.argv[1], port=0, browser=False)
print(page, threading.current_thread() is threading.main_thread())
"""


def test_an_interactive_session_goes_on(files):
    """And its end is that of the view, too."""
    words = [sys.executable, "-i", "-c", INTERACTIVE, str(files / "plate.h5")]
    session = subprocess.run(words, input="print(repr(page))\n", capture_output=True, text=True, timeout=60)
    first, second = session.stdout.splitlines()
    assert first.startswith("View at http://127.0.0.1:")
    assert second == first.removesuffix(" True")
    assert session.returncode == 0
