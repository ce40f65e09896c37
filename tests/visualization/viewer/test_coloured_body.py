"""Colours of a body are between its vertices', no picture lacks it, and the mouse does not meet what is behind it."""

import io
import time

import numpy as np
import pytest
import trimesh
from matplotlib import colormaps
from PIL import Image
from playwright.sync_api import sync_playwright

from fenics_rom.visualization.viewer.audience import PATIENCE_SECONDS, Audience
from fenics_rom.visualization.viewer.coloured_body import HIGHLIGHT_COLOUR, ColouredBody, NextPicture
from fenics_rom.visualization.viewer.colours import linear_light, shares_of, vertex_colours
from fenics_rom.visualization.viewer.drawing import set_camera_and_light
from fenics_rom.visualization.viewer.glb import Part, encode_mesh
from fenics_rom.visualization.viewer.server import Server
from fenics_rom.visualization.viewer.surface import Surface

CHROMIUM = "/usr/bin/chromium"
SOFTWARE_GL = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
SIZE = {"width": 760, "height": 300}
PATIENCE = 60.0  # s
COUNT, ACROSS = 17, 5  # nodes along and across the strip, which is as long as its x


def strip(z=0.0):
    """Nodes and triangles of [-1, 1] x [-0.2, 0.2]."""
    x, y = np.meshgrid(np.linspace(-1, 1, COUNT), np.linspace(-0.2, 0.2, ACROSS), indexing="ij")
    number = np.arange(x.size).reshape(x.shape)
    a, b, c, d = (each.ravel() for each in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
    nodes = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, z)])
    return nodes, np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])


def height_of(z):
    return np.array([0.0, 0.0, z])


def test_colours_are_viridis_in_linear_light():
    shares = shares_of(np.array([0.0, 0.5, 1.0, 2.0]), 1.0)
    assert np.array_equal(shares, [0, 0.5, 1, 1])
    assert not shares_of(np.array([0.0, 1.0]), 0.0).any()
    # Source: sRGB's own table: a half of what the screen is told is 21.4 % of its light.
    assert linear_light(np.array([0.0, 0.04045, 0.5, 1.0])) == pytest.approx([0, 0.0031308, 0.21404, 1], abs=1e-5)
    assert vertex_colours(shares)[-1] == pytest.approx(linear_light(np.array(colormaps["viridis"](1.0)[:3])))
    assert vertex_colours(np.linspace(0, 1, 256)).shape == (256, 3)
    assert len(np.unique(vertex_colours(np.linspace(0, 1, 256)), axis=0)) == 256


@pytest.mark.parametrize("opacity", [None, 0.6])
def test_another_reader_finds_the_mesh(opacity):
    places, faces = strip()
    colours = vertex_colours((places[:, 0] + 1) / 2)
    parts = [Part(faces[:100]), Part(faces[100:], (1.0, 0.25, 0.0))]
    found = trimesh.load(io.BytesIO(encode_mesh(places, colours, parts, opacity)), file_type="glb", process=False)
    plain, marked = found.geometry.values()
    for part, mesh in zip(parts, (plain, marked), strict=True):
        np.testing.assert_array_equal(mesh.vertices[mesh.faces], places.astype(np.float32)[part.faces])
    material = marked.visual.material
    assert material.doubleSided
    assert (material.metallicFactor, material.roughnessFactor) == (0, 1)
    assert material.alphaMode == ("OPAQUE" if opacity is None else "BLEND")
    factor = np.array([1.0, 0.25, 0.0, opacity or 1.0])
    np.testing.assert_allclose(np.asarray(material.baseColorFactor) / 255, factor, atol=0.5 / 255)


class Node:
    """Of a scene."""

    def __init__(self, data, visible):
        self.glb_data, self.visible = data, visible
        self.position, self.wxyz = np.zeros(3), np.array([1.0, 0, 0, 0])

    def on_drag(self, *_, **__):
        return lambda function: function


class Scene:
    """What viser's keeps of a body."""

    def __init__(self):
        self.nodes = []

    def add_glb(self, _name, data, visible, **_options):
        self.nodes.append(Node(data, visible))
        return self.nodes[-1]


def test_a_picture_is_read_before_it_is_shown():
    scene, surface, next_picture = Scene(), Surface(*strip()), NextPicture()
    body = ColouredBody(scene, "/body", surface, next_picture, 1.0)
    first, second = scene.nodes
    values, at_rest = np.zeros(len(surface.node_of)), first.glb_data
    assert (first.visible, second.visible) == (True, False)
    box = Node(b"", True)
    for shown, hidden, height in ((first, second, 0.1), (second, first, 0.2), (first, second, 0.3)):
        before = shown.glb_data
        assert body.draw(surface.places + height_of(height), values, 1.0)
        next_picture.place(box, np.array([0, 0, height]))
        assert (shown.visible, hidden.visible, shown.glb_data) == (True, False, before)
        assert hidden.glb_data not in (before, at_rest)
        assert box.position[2] != height
        next_picture.show()
        assert (shown.visible, hidden.visible, box.position[2]) == (False, True, height)
    assert not body.draw(surface.places + height_of(0.3 + 1e-5), values + 1e-4, 1.0)
    next_picture.place(box, np.array([0, 0, 0.3 + 1e-5]))
    assert not next_picture  # nobody could see it
    assert body.draw(surface.places + height_of(0.3), values, 1.0, np.array([0, 1]))
    found = trimesh.load(io.BytesIO(first.glb_data), file_type="glb", process=False)
    plain, marked = found.geometry.values()
    assert (len(plain.faces), len(marked.faces)) == (len(surface.faces) - 2, 2)
    light = linear_light(np.array(HIGHLIGHT_COLOUR) / 255)
    np.testing.assert_allclose(np.asarray(marked.visual.material.baseColorFactor)[:3] / 255, light, atol=0.5 / 255)


class Client:
    """A browser that answers when it is let."""

    def __init__(self):
        self.local_storage, self.answers = self, []

    def get_item(self, _key):
        while not self.answers:
            time.sleep(1e-3)
        if self.answers.pop() == "gone":
            raise RuntimeError("disconnected")


def test_next_picture_waits_for_the_slowest_browser_but_not_for_one_that_sleeps(monkeypatch):
    from fenics_rom.visualization.viewer import audience as module

    clock = [0.0]
    monkeypatch.setattr(module.time, "perf_counter", lambda: clock[0])
    clients = {}
    server = type("Stub", (), {"get_clients": lambda _: clients, "flush": lambda _: None})()
    audience = Audience(server)
    assert not audience.is_ready()  # nobody sees it
    clients |= {0: Client(), 1: Client()}
    for answer in ("", "gone"):
        assert audience.is_ready()
        audience.ask()
        clients[0].answers.append("")
        audience.wait(PATIENCE)
        assert not audience.is_ready()
        clients[1].answers.append(answer)
        audience.wait(PATIENCE)
    assert audience.is_ready()
    audience.ask()
    clients[0].answers.append("")
    audience.wait(PATIENCE)
    clock[0] = 0.9 * PATIENCE_SECONDS
    assert not audience.is_ready()
    clock[0] = 1.1 * PATIENCE_SECONDS
    assert audience.is_ready()
    audience.ask()  # the one that sleeps is not asked again, and not waited for
    clients[0].answers.append("")
    audience.wait(PATIENCE)
    assert audience.is_ready()
    clients[1].answers.append("")
    audience.wait(PATIENCE)
    audience.ask()
    assert not audience.is_ready()
    for client in clients.values():
        client.answers.append("")


class Stage:
    """A strip on a page of its own, in a browser."""

    def __init__(self, server, page):
        self.viser, self.page = server.viser, page
        self.surface, self.next_picture, self.audience = Surface(*strip()), NextPicture(), Audience(server.viser)
        set_camera_and_light(self.viser, self.surface.places)
        self.viser.initial_camera.position = (0.0, -0.9, 1.1)
        self.viser.initial_camera.look_at = (0.0, 0.0, 0.0)
        self.viser.gui.main_panel.dock_right()
        self.body = ColouredBody(self.viser.scene, "/body", self.surface, self.next_picture, 1.0)
        page.goto(f"{server.address}?fixedDpr=1")
        page.locator(".mantine-Notification-closeButton").first.click()
        self.draw(0.0, np.zeros(len(self.surface.nodes)))
        self.until(lambda: (np.ptp(self.picture, axis=2) > 60).sum() > 3000, "no body")

    def until(self, condition, what):
        end = time.monotonic() + PATIENCE
        while not (found := condition()):
            assert time.monotonic() < end, what
            time.sleep(0.01)
        return found

    def draw(self, height, values):
        self.until(self.audience.is_ready, "the browser does not answer")
        with self.viser.atomic():
            self.next_picture.show()
            moved = self.surface.places + height_of(height)
            self.body.draw(moved, self.surface.of_nodes(values), 1.0)
        self.audience.ask()

    def show(self):
        self.until(self.audience.is_ready, "the browser does not answer")
        with self.viser.atomic():
            self.next_picture.show()
        self.audience.ask()

    @property
    def picture(self):
        """Pixels of the scene, (height, width, 3)."""
        box = self.page.locator("canvas").first.bounding_box()
        image = Image.open(io.BytesIO(self.page.screenshot(clip=box))).convert("RGB")
        return np.asarray(image).astype(int)


@pytest.fixture(scope="module")
def stage():
    server = Server(0)
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=SOFTWARE_GL)
        page = chromium.new_page(viewport=SIZE)
        yield Stage(server, page)
        chromium.close()
    server.stop()


@pytest.mark.alone
def test_colours_between_vertices_are_those_of_the_bar(stage):
    """As viser's own meshes of one colour beside it, in the same light."""
    shares = np.linspace(0.05, 0.95, 10)
    half = 0.04
    for k, share in enumerate(shares):
        x, (red, green, blue, _) = 2 * share - 1, colormaps["viridis"](share)
        corners = np.array([[x - half, 0.3, 0], [x + half, 0.3, 0], [x + half, 0.5, 0], [x - half, 0.5, 0]])
        colour = (round(255 * red), round(255 * green), round(255 * blue))
        faces = np.array([[0, 1, 2], [0, 2, 3]])
        stage.viser.scene.add_mesh_simple(
            f"/patch_{k}", corners, faces, color=colour, cast_shadow=False, receive_shadow=False
        )
    stage.draw(0.0, (stage.surface.places[:, 0] + 1) / 2)
    stage.show()

    def lines():
        """Colours along the strip, and those of the patches."""
        seen = np.ptp(stage.picture, axis=2) > 40
        rows = np.flatnonzero(seen.sum(axis=1) > 60)
        gap = np.flatnonzero(np.diff(rows) > 1)
        if len(gap) != 1:
            return None
        patches, along = rows[gap[0]] // 2 + rows[0] // 2, (rows[gap[0] + 1] + rows[-1]) // 2
        picture, columns = stage.picture, [np.flatnonzero(seen[row]) for row in (along, patches)]
        strip_ = picture[along, columns[0][0] : columns[0][-1] + 1]
        first, last = columns[1][[0, -1]]
        middles = first + (shares - shares[0] + half / 2) / (shares[-1] - shares[0] + half) * (last + 1 - first)
        return strip_, picture[patches, middles.astype(int)]

    def differ():
        if (found := lines()) is None:
            return np.inf
        strip_, patches = found
        return np.abs(strip_[(shares * len(strip_)).astype(int)] - patches).max()

    # The steepest of viridis in this light is 3 of 255 a pixel; a place is known to two.
    stage.until(lambda: differ() < 8, "colours are others than those of the bar")
    along = lines()[0][2:-2]  # its ends are mixed with what is beside it
    assert len(np.unique(along, axis=0)) > 100
    assert np.abs(np.diff(along, axis=0)).max() < 12
    for k in range(len(shares)):
        stage.viser.scene.remove_by_name(f"/patch_{k}")


PROBE = """() => {
  const meshes = (node) => { let count = 0; node?.traverse((one) => { count += one.isMesh ? 1 : 0; }); return count; };
  const { scene, nodeRefFromName } = window.__viserMutable;
  window.seen = [];
  scene.onBeforeRender = () => {
    const shown = ["/body/0", "/body/1"].map((name) => nodeRefFromName[name]).filter((node) => node?.visible);
    window.seen.push(shown.map(meshes));
  };
}"""
MEMORY = "() => window.__viserTestpoints.rendererInfo.memory.geometries"


@pytest.mark.alone
def test_no_picture_is_without_the_body_and_none_is_kept(stage):
    stage.page.evaluate(PROBE)
    before, values = stage.page.evaluate(MEMORY), np.abs(stage.surface.places[:, 0])
    pictures = 40
    for k in range(pictures):
        stage.draw(0.1 * np.sin(k), values)
        if k == pictures // 2:
            time.sleep(0.5)  # as where something else has the machine
    stage.show()
    seen = stage.until(lambda: stage.audience.is_ready() and stage.page.evaluate("() => window.seen"), "no pictures")
    assert len(seen) >= pictures  # every one was drawn
    assert [shown for shown in seen if shown != [1]] == []
    assert stage.page.evaluate(MEMORY) <= before + 1


@pytest.mark.alone
def test_mouse_does_not_meet_what_is_behind_the_body(stage):
    """Whichever of the two meshes is shown."""
    met = []
    nodes, faces = strip(-0.05)
    behind = stage.viser.scene.add_mesh_simple("/behind", nodes * [0.9, 4.0, 1], faces, opacity=0.0)
    behind.on_click(lambda event: met.append(event))
    box = stage.page.locator("canvas").first.bounding_box()

    def click(x, y):
        stage.page.mouse.move(x, y)
        stage.page.wait_for_timeout(500)
        stage.page.mouse.down()
        stage.page.wait_for_timeout(100)
        stage.page.mouse.up()

    for k in range(2):
        stage.draw(0.01 * k, np.ones(len(stage.surface.nodes)))
        stage.show()
        stage.page.wait_for_timeout(500)
        rows, columns = np.nonzero(np.ptp(stage.picture, axis=2)[:-60] > 60)  # without the cross of axes
        x = box["x"] + float(np.median(columns))
        click(x, box["y"] + float(np.median(rows)))
    click(x, box["y"] + float(rows.min()) - 12)  # beside the body
    stage.until(lambda: met, "what is not behind the body is not met")
    assert len(met) == 1
    behind.remove()
