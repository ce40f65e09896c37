"""`fenics-rom view` in a real browser: a body that can be seen, pulled and shared, by those who have the address."""

import http.client
import io
import os
import re
import signal
import socket
import subprocess
import sys
import time
import types
from dataclasses import replace
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest
from bodies import PLATE, box_arrays, scene_text, write_arrays
from PIL import Image
from playwright.sync_api import sync_playwright
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

import fenics_rom as fr
from fenics_rom.errors import MissingPackageError, SceneError
from fenics_rom.scene.file import parse_scene
from fenics_rom.visualization import optional_dependencies
from fenics_rom.visualization.viewer import server

COMMAND = Path(sys.executable).parent / "fenics-rom"
CHROMIUM = "/usr/bin/chromium"
SOFTWARE_GL = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
QUIET = ["--disable-background-networking", "--disable-component-update", "--disable-sync", "--disable-quic"]
# Chromium's own remark on a listener of viser's page, at every press of a button.
REMARKS = ("Unable to preventDefault inside passive event listener invocation.",)
BAR = "young = 1e6\npoisson = 0.3\ndensity = 1000.0"
PATIENCE = 60.0  # s; a picture takes a second where other tests have the cores
SIZE = {"width": 760, "height": 460}
pytestmark = pytest.mark.alone


def until(condition, what):
    """Waits for something to become true, and returns it."""
    end = time.monotonic() + PATIENCE
    while not (found := condition()):
        assert time.monotonic() < end, what
        time.sleep(0.1)
    return found


class View:
    """A running `fenics-rom view`, and what it has printed."""

    def __init__(self, folder, *arguments):
        self.output = folder / f"view-{len(list(folder.iterdir()))}.txt"
        with self.output.open("w") as file:
            self.process = subprocess.Popen(
                [COMMAND, "view", *map(str, arguments), "--no-browser"],
                cwd=folder,
                stdout=file,
                stderr=subprocess.STDOUT,
                env=dict(os.environ),
            )
        self.address = until(lambda: re.search(r"http://\S+/", self.printed), "no address was printed")[0]

    @property
    def printed(self):
        return self.output.read_text()

    def interrupt(self):
        """Ctrl-C; gives the exit status."""
        self.process.send_signal(signal.SIGINT)
        return self.process.wait(timeout=PATIENCE)


class Window:
    """A page of a browser on a view."""

    def __init__(self, browser, address):
        self.page = browser.new_page()
        self.page.set_viewport_size(SIZE)
        self.errors = []
        self.page.on("console", lambda message: self._note(message.type == "error", message.text))
        self.page.on("pageerror", lambda error: self._note(True, str(error)))
        self.page.goto(f"{address}?fixedDpr=1")  # else a slow browser draws fewer pixels
        until(lambda: self.words, "no words")
        self.page.locator(".mantine-Notification-closeButton").first.click()  # "Software WebGL rendering detected"
        until(lambda: self.body.size > 1000, "no body")

    def _note(self, wrong, text):
        if wrong and text not in REMARKS:
            self.errors.append(text)

    @property
    def words(self):
        """What the panel says; empty before it does."""
        text = self.page.inner_text("body")
        return text if "t =" in text else ""

    @property
    def energies(self):
        """Stored, supplied, dissipated and lost, J."""
        sizes = {"p": 1e-12, "n": 1e-9, "µ": 1e-6, "m": 1e-3, "": 1.0}
        found = re.findall(r"(?:stored|supplied|dissipated|switching) ([\d.e+-]+) ([pnµm]?)J", self.words)
        return [float(value) * sizes[prefix] for value, prefix in found]

    @property
    def time(self):
        """Of the body, s."""
        return float(re.search(r"t = ([\d.]+) s", self.words)[1])

    @property
    def picture(self):
        """Pixels of the scene, (height, width, 3)."""
        box = self.page.locator("canvas").first.bounding_box()
        image = Image.open(io.BytesIO(self.page.screenshot(clip=box))).convert("RGB")
        return np.asarray(image).astype(int)[60:-60, 30:-30]  # without the cross of axes in a corner

    @property
    def body(self):
        """Rows and columns (2, count) of the pixels that are not background."""
        return np.argwhere(self.picture.min(axis=2) < 200).T

    @property
    def lit(self):
        """How many pixels are of a surface that is held."""
        red, _, blue = self.picture.transpose(2, 0, 1)
        return int(((red > 200) & (blue < 120)).sum())

    def drag(self, dx, dy):
        """Takes hold of the plate in its middle, where it can be touched, and moves the mouse."""
        box, (rows, columns) = self.page.locator("canvas").first.bounding_box(), self.body
        middle = (columns.min() + columns.max()) // 2
        x, y = box["x"] + 30.0 + float(middle), box["y"] + 60 + rows[columns == middle].mean()
        self.page.mouse.move(x, y)
        self.page.mouse.down()
        self.page.mouse.move(x + dx, y + dy, steps=4)

    def press(self, name):
        self.page.get_by_role("button", name=name, exact=True).first.click()


@pytest.fixture(scope="module")
def folder(tmp_path_factory, plate_rom):
    folder = tmp_path_factory.mktemp("view")
    fr.write_rom(folder / "plate.h5", plate_rom)
    return folder


@pytest.fixture(scope="module")
def browser():
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(
            executable_path=CHROMIUM, args=["--no-sandbox", "--no-first-run", *SOFTWARE_GL, *QUIET]
        )
        yield chromium
        chromium.close()


@pytest.fixture(scope="module")
def views(folder):
    """Starts views, and ends them."""
    begun = []
    yield lambda *arguments: begun.append(View(folder, *arguments)) or begun[-1]
    for one in begun:
        one.process.kill()
        one.process.wait()


@pytest.fixture(scope="module")
def view(views):
    return views("plate.h5", "--port", 0)


@pytest.fixture(scope="module")
def window(view, browser):
    return Window(browser, view.address)


def test_body_is_seen_pulled_and_reset(window):
    at_rest = window.picture
    assert not any(window.energies)
    window.drag(0, -70)
    until(lambda: window.energies[1] > 1e-4, "no work was supplied")
    until(lambda: "middle" in window.words, "the contact mode is not the one that was pulled at")
    pulled = window.picture
    assert window.lit > 500
    assert (np.abs(pulled - at_rest).max(axis=2) > 40).sum() > 2000
    window.page.mouse.up()
    window.page.mouse.move(5, 5)  # the surface under the mouse has a bright outline
    until(lambda: not window.lit, "does not let go")
    until(lambda: window.energies[2] > 1e-5, "nothing was dissipated")
    stored, supplied, dissipated, lost = window.energies
    assert stored == pytest.approx(supplied - dissipated - lost, abs=0.02 * supplied)  # three digits each
    window.press("reset")
    until(lambda: not any(window.energies), "the account is not empty")
    assert window.time < 30
    until(lambda: (np.abs(window.picture - at_rest).max(axis=2) > 40).sum() < 50, "the body did not go back")
    assert window.errors == []


@pytest.mark.slow
def test_second_viewer_sees_the_same_and_may_go_away(window, view, browser):
    window.drag(0, -60)
    until(lambda: window.energies[0] > 1e-4, "nothing moved")
    window.page.get_by_role("button", name="pause", exact=True).first.dispatch_event("click")  # the mouse holds
    until(lambda: "paused" in window.words, "does not pause")
    away = browser.new_context()
    other = Window(away, view.address)
    until(lambda: other.energies == window.energies, "other numbers")
    assert other.time == window.time
    until(lambda: (np.abs(other.picture - window.picture).max(axis=2) > 60).mean() < 0.02, "another picture")
    window.page.mouse.up()
    other.press("pause")
    until(lambda: "paused" not in window.words, "does not go on")
    assert other.errors == []
    other.drag(0, -40)  # a browser that goes away lets go, and the body goes on
    begin = window.time
    away.close()
    until(lambda: window.time > begin + 1.0, "the body stands still")
    assert view.process.poll() is None


def test_recording_is_a_run(window, view, folder, plate_rom):
    window.press("record")
    until(lambda: "recording" in window.words, "does not record")
    time.sleep(0.5)
    window.press("record")
    until(lambda: "recorded: " in view.printed, "nothing was recorded")
    assert "Traceback" not in view.printed
    run = fr.read_trajectory(folder / "plate-view-1.h5")
    assert run.steps > 100
    assert run.balance_error < 1e-10
    assert fr.compare(run, run)["shape"].relative == 0
    window.press("reset")  # a body at rest is not drawn again: the cores are for the tests that follow


@pytest.fixture(scope="module")
def bar_rom(tmp_path_factory):
    """A stiff bar that nothing holds and nothing damps, and that may be touched everywhere."""
    mesh = write_arrays(tmp_path_factory.mktemp("bar") / "bar.msh", *box_arrays((0.4, 0.1, 0.06), (4, 1, 1)))
    skin = "[contacts.skin]\nnear = { point = [0.2, 0.05, 0.03], radius = 1.0 }"
    parts = {"supports": None, "effects": "inertia = {}", "contacts": skin}
    scene = parse_scene('frame = "moving"\n' + scene_text(mesh, material=BAR, **parts))
    return fr.reduce(fr.assemble(scene), method="modal", order=6)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
def test_free_body_is_thrown_with_the_mouse(folder, views, browser, bar_rom):
    """It follows the mouse, flies on when it is let go, with the energy that the mouse gave, and comes back."""
    fr.write_rom(folder / "bar.h5", bar_rom)
    window = Window(browser, views("bar.h5", "--port", 0).address)
    at_rest, middle = window.picture, window.body.mean(axis=1)
    window.drag(0, -40)
    until(lambda: window.energies[1] > 1e-6, "no work was supplied")
    window.page.mouse.up()
    window.page.mouse.move(5, 5)
    until(lambda: not window.lit, "does not let go")
    thrown = window.energies

    def has_flown():
        body = window.body
        return body.size < 1000 or np.abs(body.mean(axis=1) - middle).max() > 40

    until(has_flown, "it does not fly")
    stored, supplied, dissipated, lost = window.energies
    assert (stored, supplied, dissipated, lost) == (pytest.approx(supplied, rel=0.01), thrown[1], 0.0, 0.0)
    window.press("reset")
    until(lambda: not any(window.energies), "the account is not empty")
    until(lambda: (np.abs(window.picture - at_rest).max(axis=2) > 40).sum() < 50, "the body did not come back")
    assert window.errors == []
    window.page.close()


WORLD = """
gravity = [0.0, 0.0, -9.81]
[bodies.ground]
shape = "half-space"
[bodies.box]
shape = "box"
size = [0.1, 0.1, 0.1]
mass = 0.5
position = [0.0, 0.0, 0.05]
[contact]
friction = 0.5
[run]
dt = 5e-3
duration = 1.0
"""


@pytest.mark.slow
def test_box_of_a_world_is_tipped_with_the_mouse(folder, views, browser):
    """Pulled up at a face it stands on an edge, and the ground carries less; it falls back when it is let go."""
    (folder / "world.toml").write_text(WORLD)
    window = Window(browser, views("world.toml", "--port", 0).address)
    at_rest = window.picture
    assert "ground - box: 4.9" in window.words  # 4.905 N
    window.drag(0, -70)
    until(lambda: "held: box" in window.words, "the box is not held")
    until(lambda: "2 points push" in window.words, "the box does not tip")
    assert (np.abs(window.picture - at_rest).max(axis=2) > 40).sum() > 2000
    window.page.mouse.up()
    window.page.mouse.move(5, 5)
    until(lambda: "4 points push" in window.words, "the box does not fall")
    stored, supplied, dissipated, _ = window.energies
    assert stored == pytest.approx(supplied - dissipated, abs=0.02 * supplied)
    window.press("reset")
    until(lambda: (np.abs(window.picture - at_rest).max(axis=2) > 40).sum() < 50, "the box did not go back")
    assert window.errors == []
    window.page.close()


@pytest.mark.parametrize("token", ["", "wrong", "wrong/", "../"])
def test_who_has_not_the_token_is_refused(view, token):
    place = urlsplit(view.address)
    request = http.client.HTTPConnection(place.hostname, place.port, timeout=PATIENCE)
    request.request("GET", f"/{token}")
    answer = request.getresponse()
    assert (answer.status, b"token" in answer.read()) == (403, True)
    with pytest.raises(InvalidStatus, match="403"):
        connect(f"ws://{place.netloc}/{token}", subprotocols=["viser-v1"])


def test_only_this_machine_is_served(view):
    with socket.socket() as probe, pytest.raises(OSError, match="refused"):
        probe.connect(("127.0.0.2", urlsplit(view.address).port))


def test_port_that_is_taken_and_interruption(view, views):
    port = urlsplit(view.address).port
    other = views("plate.h5", "--port", port)
    taken = urlsplit(other.address).port
    assert taken > port
    assert f"port {port} is taken: {taken} is used" in other.printed
    assert other.interrupt() == 0
    assert other.printed.endswith("ended\n")
    assert "Traceback" not in other.printed


@pytest.mark.slow
def test_runs_side_by_side(views, folder, browser, plate_rom):
    scene = fr.read_scene(PLATE)
    run = fr.simulate(plate_rom, scene=replace(scene, run=replace(scene.run, snapshots=30)))
    fr.write_trajectory(folder / "a.h5", run)
    fr.write_trajectory(folder / "b.h5", replace(run, snapshots=0.9 * run.snapshots))
    view = views("a.h5", "b.h5", "--port", 0)
    window = Window(browser, view.address)
    assert "1.11e-01 of the shape" in window.words
    rows, _ = window.body
    window.press("Play")
    until(lambda: "t = 3.000 s" not in window.words, "does not play")
    assert len(rows) > 3000
    assert window.errors == []
    window.page.close()
    assert view.interrupt() == 0


@pytest.fixture(scope="module")
def bad_files(folder, plate_rom):
    run = fr.simulate(plate_rom)
    fr.write_trajectory(folder / "c.h5", run)
    fr.write_trajectory(folder / "d.h5", replace(run, nodes=run.nodes + 1.0))
    fr.write_trajectory(folder / "bare.h5", replace(run, triangles=np.empty((0, 3), dtype=int)))
    identity = np.eye(9)
    chain = fr.System(mass=identity, damping=0.1 * identity, stiffness=identity, contacts={"end": identity[0]})
    fr.write_rom(folder / "chain.h5", fr.reduce(chain, order=1))
    return folder


@pytest.mark.parametrize(
    ("files", "what"),
    [
        (["plate.h5", "plate.h5"], "plate.h5: is a ROM, and is viewed alone"),
        (["missing.h5"], "missing.h5: not found"),
        (["c.h5", "d.h5"], "the runs are of different meshes"),
        (["bare.h5"], "has no surface triangles"),
        (["chain.h5"], "has no surface triangles"),
        (["c.h5", "--dt", "1"], "--dt is the time step of a ROM"),
        (["plate.h5", "--dt", "-1"], "dt = -1.0: use a finite number > 0"),
    ],
)
def test_what_cannot_be_viewed(files, what, bad_files, capsys, monkeypatch):
    from fenics_rom.cli.main import main

    monkeypatch.chdir(bad_files)
    with pytest.raises(SystemExit) as ended:
        main(["view", *files])
    said = capsys.readouterr().err
    assert ended.value.code == 1
    assert what in said
    assert said.count("\n") == 1


@pytest.mark.parametrize("arguments", [["a", "b", "c"], ["a", "--port", "70000"], ["a", "--port", "x"], []])
def test_wrong_usage(arguments, capsys):
    from fenics_rom.cli.main import main

    with pytest.raises(SystemExit) as ended:
        main(["view", *arguments])
    assert ended.value.code == 2
    said = capsys.readouterr().err
    assert said.startswith("fenics-rom view: error: ")
    assert said.count("\n") == 1


def test_missing_package_says_how_to_get_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(MissingPackageError, match=r'needs viser, .*: pip install "fenics-rom\[live\]"'):
        optional_dependencies.viser_package()


def test_a_viser_that_cannot_be_guarded_is_stopped(monkeypatch):
    """It starts its server without asking its module for websockets."""
    stopped, infra = [], types.ModuleType("other_infra")
    infra.websockets = sentinel = object()
    monkeypatch.setitem(sys.modules, infra.__name__, infra)
    started = types.SimpleNamespace(stop=lambda: stopped.append(True))
    other = types.SimpleNamespace(
        __version__="9.0",
        infra=types.SimpleNamespace(WebsockServer=type("WebsockServer", (), {"__module__": infra.__name__})),
        ViserServer=lambda **options: started,
    )
    monkeypatch.setattr(server, "viser_package", lambda: other)
    with pytest.raises(MissingPackageError, match=r"cannot refuse strangers with viser 9\.0: pip install viser=="):
        server.Server(0)
    assert stopped == [True]
    assert infra.websockets is sentinel


def test_guard_is_seen_by_viser_alone(monkeypatch):
    import viser
    import websockets.asyncio.server as library

    serve = library.serve
    with server._guarded_start(viser, "token"):
        assert library.serve is serve
    assert viser.infra._infra.websockets is sys.modules["websockets"]


def test_no_free_port(monkeypatch):
    monkeypatch.setattr(server, "MAX_PORTS", 1)
    with socket.socket() as taken:
        taken.bind((server.HOST, 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(SceneError, match=f"--port {port}: neither this port nor one of the 1 after it"):
            server.Server(port)


def test_browser_is_not_told_the_token_where_others_can_read_it(monkeypatch, capsys):
    from fenics_rom.visualization.viewer import view as view_module

    opened = []
    monkeypatch.setattr(view_module.webbrowser, "open", lambda address: opened.append(address) or True)
    monkeypatch.setenv("DISPLAY", ":0")
    page = view_module._open("http://127.0.0.1:8080/secret/")
    assert opened == [page.as_uri()]
    assert "secret" not in opened[0]
    assert "http://127.0.0.1:8080/secret/" in page.read_text()
    assert page.stat().st_mode & 0o077 == 0
    page.unlink()
    monkeypatch.delenv("DISPLAY")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert view_module._open("http://127.0.0.1:8080/secret/") is None
    assert "there is no display" in capsys.readouterr().out
