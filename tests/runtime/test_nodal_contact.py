"""Contact on nodes as pressure and traction: times the areas of nodes they are the forces, and 0 elsewhere."""

import warnings

import numpy as np
import pytest
from forks import CLAMPED, ROPE, cleft, fork_scene
from pads import RUBS, UP, L, pad_scene, shape

import fenics_rom as fr
from fenics_rom.errors import StepError
from fenics_rom.fem.simulator import FullOrderSimulator
from fenics_rom.mechanics.nodal_contact import ContactSurface, facets_of

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
BALL = shape("ball", 1.3 * L, 1.55 * L, 1e-4 * L)
ROUND_OFF = 1e-13  # of sums of some 100 numbers, of their sizes
FACETS = np.array([[0, 1, 2], [0, 2, 3]])
EDGES = np.array([[4, 5, 6], [6, 7, 8]])  # middles of 01, 12, 20 and of 02, 23, 30
SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)


def system_of(*given, **parts):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return fr.assemble(pad_scene(*given, **parts))


def parts_of_four(facets, edges):
    """Triangles through all nodes of facets of six, as they are drawn."""
    (a, b, c), (ab, bc, ca) = facets.T, edges.T
    return np.concatenate([np.stack(t, axis=1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])


def test_facets_of_six_nodes_are_found_in_their_parts():
    np.testing.assert_array_equal(facets_of(parts_of_four(FACETS, EDGES)), np.hstack([FACETS, EDGES]))
    np.testing.assert_array_equal(facets_of(FACETS), FACETS)
    others = np.random.default_rng(1).permutation(24).reshape(8, 3)  # as many as parts, and none
    np.testing.assert_array_equal(facets_of(others), others)


@pytest.mark.parametrize("degree", [1, 2])
def test_a_uniform_pressure_is_found_at_every_node(degree):
    """On a square of two facets, whose middles of degree 2 have a third of each facet and corners nothing."""
    middles = [SQUARE[[a, b]].mean(axis=0) for a, b in ((0, 1), (1, 2), (2, 0), (2, 3), (3, 0))]
    if degree == 1:
        nodes, triangles, forces = SQUARE, FACETS, np.array([2, 1, 2, 1]) / 6
    else:
        nodes, triangles = np.vstack([SQUARE, middles]), parts_of_four(FACETS, EDGES)
        forces = np.array([0, 0, 0, 0, 1, 1, 2, 1, 1]) / 6
    surface = ContactSurface(nodes, triangles, np.arange(len(nodes)))
    np.testing.assert_allclose(surface.density(7.0 * forces), 7.0, rtol=1e-14)
    assert surface.areas.sum() == pytest.approx(1.0, rel=1e-14)


def test_nodes_that_are_touched_alone_stand_for_the_triangles_around_them():
    surface = ContactSurface(SQUARE, FACETS, np.array([0, 1]))
    np.testing.assert_allclose(surface.density(np.array([1.0, 1.0])), [3.0, 6.0, 0.0, 0.0], rtol=1e-14)


@pytest.mark.parametrize("points", ["nodes", "surface", "faces"])
@pytest.mark.parametrize("degree", [1, 2])
def test_pressures_and_tractions_are_the_forces_of_an_obstacle(tmp_path, points, degree):
    """Of a ball that a pad is pressed on with friction, at nodes and between them."""
    x, y, radius = {"nodes": (1.9, 2.05, 20.0), "surface": (1.3, 1.55, 0.5), "faces": (1.3, 1.55, 0.05)}[points]
    at = [x * L, y * L, (1.0001 + radius) * L]
    ball = f'obstacles.pin = {{ shape = "sphere", center = {at}, radius = {radius * L} }}'
    system = system_of(tmp_path, ball, points=points, **UP, **RUBS, degree=degree)
    top = np.isclose(system.body.nodes[:, 2], L)
    signals = {"pin": lambda t: [0.0, 0.0, -2 * L * t]}
    full = FullOrderSimulator(system, 1e-3, system.scene.environment, signals)
    bodies = full, fr.Simulator(fr.reduce(system, order=10), 1e-3, signals=signals)
    for body in bodies:
        pressed = 0.0
        for _ in range(60):
            body.step(np.zeros(0))
            contact = (body.stepper if body is bodies[0] else body.integrator).contact
            if contact is None:
                continue
            pressure, traction = body.contact_pressure(), body.contact_traction()
            areas, pressing = body.contact_surface.areas, contact.normal_forces.sum()
            assert areas @ pressure == pytest.approx(pressing, rel=ROUND_OFF)
            np.testing.assert_allclose(areas @ traction, body.obstacle_forces()[0], atol=ROUND_OFF * pressing)
            assert not pressure[~top].any()
            assert not traction[~top].any()
            pressed = max(pressed, pressing)
        assert pressed > 1e-3


def test_a_free_body_has_them_in_world_axes(tmp_path):
    """One that is turned by gravity about a ball."""
    system = system_of(tmp_path, BALL, None, "moving", supports=None, **UP, **RUBS)
    body = fr.Simulator(fr.reduce(system, order=6), 1e-3)
    touched = 0
    for _ in range(60):
        body.step()
        force = body.contact_forces("pin")
        areas = body.contact_surface.areas
        size = np.abs(body.nodal_contact.forces).max()
        touched += size > 0
        np.testing.assert_allclose(areas @ body.contact_traction(), force, atol=ROUND_OFF * size)
    assert touched > 5
    assert abs(body.pose.rotation[0]) < 0.999


def test_forces_of_a_body_on_itself_add_up_to_nothing_and_press_both_sides(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        scene = fork_scene(
            tmp_path, cleft((3, 1, 3), 1), "fixed", 'self_contact = ["inside"]', **CLAMPED, **ROPE, **RUBS
        )
        rom = fr.reduce(fr.assemble(scene), order=6)
    body, pressed = fr.Simulator(rom, 1e-3), 0.0
    for _ in range(60):
        body.step(rope=2.0)
        contact, areas = body.integrator.contact, body.contact_surface.areas
        if contact is None:
            continue
        pressure, size = body.contact_pressure(), np.abs(contact.forces).max()
        np.testing.assert_allclose(areas @ body.contact_traction(), 0.0, atol=ROUND_OFF * max(size, 1.0))
        upper, lower = ((areas * pressure)[side].sum() for side in (rom.nodes[:, 2] > 0, rom.nodes[:, 2] < 0))
        assert upper == pytest.approx(lower, rel=1e-12)
        pressed = max(pressed, upper)
    assert pressed > 1e-3


def test_what_cannot_be_touched_has_none(tmp_path):
    system = system_of(tmp_path, "", points="nodes", **{"effects.contact": None})
    body = fr.Simulator(fr.reduce(system, order=4), 1e-3)
    assert body.nodal_contact is None
    with pytest.raises(StepError, match="no contact forces"):
        body.contact_pressure()


def test_runs_keep_them_with_each_shape(tmp_path):
    """To the last bit in files; at full order and reduced."""
    system = system_of(tmp_path, BALL, run="dt = 1e-3\nduration = 0.02\nsnapshots = 5", **UP, **RUBS)
    for k, model in enumerate((system, fr.reduce(system, order=10))):
        run = fr.simulate(model)
        fr.write_trajectory(tmp_path / f"{k}.h5", run)
        read = fr.read_trajectory(tmp_path / f"{k}.h5")
        for one, other in zip(run.touched, read.touched, strict=True):
            np.testing.assert_array_equal(one, other)
        assert run.touched.forces.shape == (5, len(run.touched.nodes), 3)
        sums = run.touched.forces.sum(axis=1)
        expected = run.forces["pin"][np.searchsorted(run.times, run.snapshot_times - 1e-9)]
        np.testing.assert_allclose(sums, expected, atol=ROUND_OFF * np.abs(expected).max())
