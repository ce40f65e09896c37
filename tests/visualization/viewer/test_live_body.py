"""A body that somebody pulls at: mouse, switching, account and recordings, without a page."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from bodies import acted_on, scene_text

import fenics_rom as fr
from fenics_rom.errors import SceneError
from fenics_rom.mechanics.environment import AppliedLoad, Run
from fenics_rom.mechanics.signals import Signal
from fenics_rom.scene.file import parse_scene
from fenics_rom.visualization.contact_surface import divide_contact_triangles
from fenics_rom.visualization.viewer.drawing import FRAMES_PER_SECOND
from fenics_rom.visualization.viewer.live_body import LiveBody, free_name
from fenics_rom.visualization.viewer.live_loop import FEWEST_FRAMES_PER_SECOND, LiveLoop, next_frame
from fenics_rom.visualization.viewer.live_page import error_words
from fenics_rom.visualization.viewer.mouse_spring import attach_spring, closest_point

BALL = 'shape = "sphere"\ncenter = [0.75, 0.2, 0.41]\nradius = 0.1'


@pytest.fixture(scope="module")
def box_rom(box_file):
    """A box with a contact of resultant forces, one of nodal forces, and an actuator."""
    text = scene_text(box_file, **{"actuators.pull": 'surface = "back"\nforce = "normal"'})
    text = text.replace('[contacts.top]\nsurface = "top"', '[contacts.top]\nsurface = "top"\nforce = "nodal"')
    return fr.reduce(fr.assemble(parse_scene(text)), order=40)


@pytest.fixture(scope="module")
def touched_rom(box_file):
    """A box with a ball above its right end, which makes the contact mode by itself."""
    text = scene_text(box_file, **{"effects.contact.obstacles.ball": BALL})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the ball fits in between nodes
        return fr.reduce(fr.assemble(parse_scene(text)), order=30)


def corner(rom, contact):
    """The first triangle of a contact surface, to take hold of in its middle."""
    return rom.triangles[divide_contact_triangles(rom)[contact][0]], np.ones(3) / 3


def pulled(body, contact, way, steps):
    assert body.grab(contact, *corner(body.rom, contact))
    body.mouse = body.held_at + way
    for _ in range(steps):
        body.step()


def gap(account):
    return account.stored - account.supplied + account.dissipated + account.lost


@pytest.mark.parametrize("contact", ["tip_left", "middle"])
def test_contact_surface_is_found_again(plate_rom, plate_system, contact):
    loaded = np.zeros(3 * len(plate_rom.nodes), dtype=bool)
    loaded[plate_rom.free] = np.abs(plate_system.input_matrix(contact)).max(axis=1) > 0
    truth = np.flatnonzero(loaded.reshape(-1, 3).any(axis=1))
    found = np.unique(plate_rom.triangles[divide_contact_triangles(plate_rom)[contact]])
    middle, size = plate_rom.nodes[truth].mean(axis=0), np.ptp(plate_rom.nodes[:, 0])
    assert np.linalg.norm(plate_rom.nodes[found].mean(axis=0) - middle) < 0.1 * size
    assert np.isin(truth, found).mean() > 0.6


def test_contact_surfaces_that_a_rom_keeps_are_exact_and_disjoint(touched_rom):
    found = divide_contact_triangles(touched_rom)
    assert not np.intersect1d(found["right"], found["top"]).size
    for contact, axis, end in (("right", 0, 1.0), ("top", 2, 0.3)):
        corners = touched_rom.nodes[touched_rom.triangles]
        on_it = np.isclose(corners[:, :, axis], end).all(axis=1)
        assert np.array_equal(found[contact], np.flatnonzero(on_it))


def test_of_overlapping_contact_surfaces_the_smallest_has_a_triangle(box_file):
    spot = "[contacts.spot]\nnear = { point = [0.75, 0.2, 0.3], radius = 0.13 }"
    contacts = f'[contacts.top]\nsurface = "top"\n{spot}'
    rom = fr.reduce(fr.assemble(parse_scene(scene_text(box_file, contacts=contacts))), order=12)
    found = divide_contact_triangles(rom)
    centroids = rom.nodes[rom.triangles].mean(axis=1)
    assert np.array_equal(found["spot"], np.flatnonzero(np.linalg.norm(centroids - [0.75, 0.2, 0.3], axis=1) <= 0.13))
    assert len(found["spot"])
    assert not np.intersect1d(found["top"], found["spot"]).size


def test_point_of_a_surface_is_found_in_its_triangle(box_rom):
    corners, weights = box_rom.nodes[box_rom.triangles], np.array([0.2, 0.5, 0.3])
    for triangle in (0, 17, len(corners) - 1):
        found, at = closest_point(corners, weights @ corners[triangle])
        assert at @ corners[found] == pytest.approx(weights @ corners[triangle], abs=1e-12)
    beyond, at = closest_point(corners, np.array([2.0, 0.2, 0.15]))
    assert (at @ corners[beyond])[0] == pytest.approx(1.0)


def test_pull_at_nodal_forces_is_the_pull_itself(box_rom):
    mode = box_rom.contact_models["top"]
    (on_top, *_) = np.flatnonzero((box_rom.nodes[box_rom.triangles][:, :, 2] == 0.3).all(axis=1))
    spring = attach_spring(box_rom, "top", box_rom.triangles[on_top], np.ones(3) / 3)
    G = mode.inputs[:, : box_rom.contacts["top"]]
    assert G @ spring.spread == pytest.approx(spring.rows.T, abs=1e-9 * np.abs(spring.rows).max())


def test_pull_at_a_resultant_is_nearest_in_energy(box_rom):
    mode = box_rom.contact_models["right"]
    spring = attach_spring(box_rom, "right", *corner(box_rom, "right"))
    G = mode.inputs[:, : box_rom.contacts["right"]] / np.sqrt(mode.eigenvalues)[:, None]
    left = G.T @ (G @ spring.spread - spring.rows.T / np.sqrt(mode.eigenvalues)[:, None])
    assert np.abs(left).max() < 1e-12 * np.abs(G.T @ G).max()
    assert spring.spread == pytest.approx(np.eye(3), abs=0.4)


def test_pulled_body_comes_to_rest_where_spring_and_body_agree(box_rom):
    body = LiveBody(box_rom, dt=5e-3)
    pulled(body, "right", [0.0, 0.0, 1e-3], 15000)
    spring, force = body.spring, body.force
    mode = box_rom.contact_models["right"]
    u = np.concatenate([spring.spread @ force, [0.0]])
    q = (mode.inputs @ u) / mode.eigenvalues
    assert body.held_at == pytest.approx(spring.moved(q), abs=1e-9)
    assert force == pytest.approx(spring.stiffness * (body.mouse - body.held_at), rel=1e-6)
    assert 0.4e-3 < (body.held_at - spring.place)[2] < 0.8e-3  # two thirds of the way, but for the other directions
    assert abs(gap(body.account)) < 2e-12 * body.account.supplied


def test_mouse_is_never_stronger_than_a_linear_model_can_follow(box_rom):
    body = LiveBody(box_rom, dt=1e-2)
    pulled(body, "right", [0.0, 0.0, 10.0], 2000)
    assert np.linalg.norm(body.force) == pytest.approx(body.spring.largest)
    assert 0.1 < body.simulator.surface_peak.severity < 1


@pytest.mark.parametrize("dt", [1e-4, 1e-2, 1.0])
def test_mouse_and_body_together_gain_no_energy(box_rom, dt):
    body = LiveBody(box_rom, dt=dt)
    assert body.grab("right", *corner(box_rom, "right"))
    body.mouse = body.held_at + np.array([2e-4, 1e-3, 1e-3])
    together = []
    for _ in range(200):
        stretched = body.mouse - body.spring.place - body.spring.columns.T @ body.simulator.state[0]
        together.append(body.account.stored + body.spring.stiffness * stretched @ stretched / 2)
        body.step()
    assert np.linalg.norm(body.force) < body.spring.largest
    assert np.diff(together).max() < 1e-13 * together[0]
    lost = together[0] - together[-1]
    assert lost == pytest.approx(body.account.dissipated, rel=1e-2)  # but for the last step


@pytest.mark.parametrize("dt", [1e-5, 1e-3, 0.1, 100.0])
def test_mouse_is_stable_at_any_step(box_rom, dt):
    body = LiveBody(box_rom, dt=dt)
    pulled(body, "right", [0.0, 0.0, 1e-3], 300)
    highest = body.account.supplied
    pulled(body, "right", [0.0, 0.0, 0.0], 300)
    assert np.abs(body.held_at - body.spring.place).max() < 2e-3
    assert body.account.stored <= 2 * highest


def test_quasi_static_body_follows_the_mouse(box_file):
    system = fr.assemble(acted_on(box_file, "gravity = { acceleration = [0.0, 0.0, -1.0] }"))
    body = LiveBody(fr.reduce(system, order=4), dt=0.1)
    pulled(body, "right", [0.0, 0.0, 1e-3], 100)
    moved = (body.held_at - body.spring.place)[2]
    for _ in range(10):
        body.step()
    assert (body.held_at - body.spring.place)[2] == pytest.approx(moved, rel=1e-6)
    u = np.concatenate([body.spring.spread @ body.force, [1.0]])
    mode = body.rom.contact_models["right"]
    assert moved == pytest.approx(((body.spring.rows / mode.eigenvalues) @ (mode.inputs @ u))[2], rel=1e-6)
    y = body.spring.columns.T @ body.simulator.state[0]
    assert body.force == pytest.approx(body.spring.stiffness * (body.mouse - body.spring.place - y), rel=1e-9)


def test_held_contact_mode_is_not_switched_by_an_obstacle(touched_rom):
    body = LiveBody(touched_rom, dt=1e-3)
    for _ in range(10):
        body.step()
    assert body.simulator.contact == "top"  # the ball is above it
    pulled(body, "right", [0.0, 0.0, 1e-4], 50)
    assert body.simulator.contact == "right"
    assert body.account.supplied > 0
    energy = body.account.stored
    body.release()
    assert body.account.stored == energy
    body.step()
    assert body.simulator.contact == "top"
    assert not body.force.any()
    assert abs(gap(body.account)) < 2e-12 * body.account.supplied


def test_actuators_have_units_and_ranges_and_act(box_rom):
    body = LiveBody(box_rom)
    (actuator,) = body.actuators
    assert (actuator.name, actuator.unit, actuator.least) == ("pull", "N", -actuator.largest)
    body.values[0] = 0.4 * actuator.largest
    for _ in range(3000):
        body.step()
    assert 0.4 < body.simulator.surface_peak.severity < 1  # at most twice as far as at rest


@pytest.mark.parametrize("applied", [1e-3, -1e4, 1e4])
def test_a_slider_reaches_what_the_scene_applies(box_rom, applied):
    (usual,) = LiveBody(box_rom).actuators
    table = Signal(np.array([[0.0], [applied], [0.0]]), np.array([0.0, 0.1, 0.2]))
    run = Run(0.01, 0.3, loads=(AppliedLoad(None, "pull", 0.0, 0.3, table), AppliedLoad("top", None, 0.0, 0.3, table)))
    (actuator,) = LiveBody(replace(box_rom, environment=replace(box_rom.environment, run=run))).actuators
    assert actuator.least == min(usual.least, applied)
    assert actuator.largest == max(usual.largest, applied)
    assert 1e-3 < usual.largest < 1e4


@pytest.mark.parametrize("name", ["box_rom", "touched_rom"])
def test_recording_is_the_run_to_the_bit(name, request, tmp_path):
    rom = request.getfixturevalue(name)
    body = LiveBody(rom, dt=1e-3)
    pulled(body, "right", [0.0, 0.0, 1e-4], 30)
    body.record()
    pulled(body, "top", [0.0, 1e-4, 0.0], 40)
    body.release()
    before = body.account
    for _ in range(60):
        body.step()
    run = body.finish()()
    assert not body.records
    assert run.steps == 100
    assert run.energy[-1] == body.account.stored
    assert np.array_equal(run.snapshots[-1], body.simulator.displacement())
    assert run.balance_error < 1e-12
    assert before.supplied > 0
    fr.write_trajectory(tmp_path / "run.h5", run)
    assert fr.compare(fr.read_trajectory(tmp_path / "run.h5"), run)["shape"].relative == 0


def test_what_ends_a_recording(box_rom):
    body = LiveBody(box_rom)
    body.record()
    assert body.finish() is None  # no step was taken
    for change in (body.reset, lambda: setattr(body, "dt", 0.5), lambda: setattr(body, "order", 5)):
        body.record()
        body.step()
        change()
        assert not body.records


def test_reset_is_rest(box_rom):
    body = LiveBody(box_rom)
    body.values[0] = 1.0
    pulled(body, "right", [0.0, 0.0, 1e-3], 50)
    body.reset()
    assert (body.simulator.time, body.spring) == (0.0, None)
    assert not body.simulator.displacement().any()
    assert not body.values.any()
    assert not any(body.account)


def test_order_begins_anew_and_can_go_back(box_rom):
    body = LiveBody(box_rom)
    pulled(body, "right", [0.0, 0.0, 1e-3], 50)
    body.order = 4
    assert (body.order, body.largest_order, body.spring) == (4, 40, None)
    body.step()
    body.order = 40
    pulled(body, "right", [0.0, 0.0, 1e-3], 50)
    assert body.account.stored > 0


def test_order_of_an_oblique_rom_is_fixed(box_system):
    assert LiveBody(fr.reduce(box_system, order=6, switching="oblique")).largest_order is None


def test_advance_keeps_time_and_patience(box_rom):
    body = LiveBody(box_rom, dt=1e-3)
    taken = []
    left = body.advance(0.0105, 10.0, lambda: taken.append(body.steps))
    assert (body.steps, left, taken) == (11, pytest.approx(-0.0005), [10])  # before the last of them
    ticks = iter(range(100))
    left = body.advance(1.0, 3.0, lambda: taken.append(body.steps), clock=lambda: next(ticks))
    assert (body.steps, left, taken) == (13, pytest.approx(0.998), [10])


def test_scene_without_a_run_has_a_step_from_the_lowest_frequency(box_rom):
    ω = min(mode.eigenvalues[0] for mode in box_rom.contact_models.values()) ** 0.5
    assert LiveBody(box_rom).dt == pytest.approx(2 * np.pi / ω / 100)
    ratio, frequency = LiveBody(box_rom).damping_ratio
    assert frequency * 2 * np.pi == pytest.approx(box_rom.contact_models["right"].eigenvalues[0] ** 0.5)
    assert ratio == pytest.approx((1.0 / (frequency * 2 * np.pi) + 1e-3 * frequency * 2 * np.pi) / 2)


def test_rom_without_a_surface_is_refused(box_rom):
    with pytest.raises(SceneError, match="has no surface triangles"):
        LiveBody(replace(box_rom, triangles=np.empty((0, 3), dtype=int)))


def test_free_name_is_free(tmp_path):
    assert free_name(tmp_path, "plate").name == "plate-view-1.h5"
    (tmp_path / "plate-view-1.h5").touch()
    assert free_name(tmp_path, "plate").name == "plate-view-2.h5"


def test_pictures_become_fewer_where_steps_do_not_keep_up_and_many_again():
    frame, slow = 1 / FRAMES_PER_SECOND, 1 / FEWEST_FRAMES_PER_SECOND
    assert next_frame(frame, keeps_up=True) == frame
    for _ in range(20):
        frame = next_frame(frame, keeps_up=False)
    assert frame == slow
    for _ in range(20):
        frame = next_frame(frame, keeps_up=True)
    assert frame == 1 / FRAMES_PER_SECOND


class Counting(LiveBody):
    """It counts its steps in place of taking them."""

    def _take_step(self):
        self.moved += 1
        return 0.0


@pytest.mark.parametrize("speed", [1.0, 0.03])
@pytest.mark.parametrize("dt", [2e-3, 0.04])
def test_pictures_show_what_moves_where_it_is_by_the_clock(box_rom, dt, speed):
    """Also where a picture lasts for 8.3 steps, or a step for two pictures."""
    live = Counting(box_rom, dt=dt)
    live.moved = 0
    loop = LiveLoop.__new__(Page)
    loop._live, loop._speed, loop._frame, loop._behind, loop._before = live, speed, 1 / FRAMES_PER_SECOND, 0.0, None
    loop._error = ""
    clock = 0.0
    for k in range(200):
        passed = (1.0 + 0.2 * np.sin(k)) / FRAMES_PER_SECOND
        clock += speed * passed
        loop._step(passed)
        (place,) = loop._seen().values()
        assert place == pytest.approx(clock, abs=1e-11)  # of 200 sums of round-off
    assert live.moved == int(np.ceil(clock / dt))


class Page(LiveLoop):
    """Of one number."""

    def _shapes(self):
        return {"": np.array(self._live.dt * self._live.moved)}

    def _draw(self, shapes):
        pass

    def _words(self):
        return []


def test_what_it_says_of_its_error(plate_system):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        plain, rom = (fr.reduce(plate_system, order=6, errors=errors) for errors in (False, True))
    body = LiveBody(rom)
    pulled(body, "middle", [0.0, 0.0, 0.01], 50)
    stated = body.simulator.stated_errors
    assert stated["bound"].norm >= stated["estimate"].norm > 0
    bound, estimate = error_words(stated)
    assert bound.startswith(f"error, bound: {stated['bound'].norm:.2g} J^½ · tip ")
    assert estimate.startswith("error, estimate: ")
    assert not error_words(LiveBody(plain).simulator.stated_errors)
