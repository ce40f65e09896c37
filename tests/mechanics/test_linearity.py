"""Rotation and strain of a surface against fields that are known, and the bounds against states that are worst."""

import math
from dataclasses import replace

import numpy as np
import pytest
from bodies import assembled, box_arrays, box_surfaces, write_box

from fenics_rom.mechanics.linearity import (
    MAX_TRIANGLES,
    ROTATION_LIMIT,
    STRAIN_LIMIT,
    SurfaceGauges,
    SurfaceStrainPeak,
    measure_peaks,
)
from fenics_rom.runtime.linearity_monitor import ReducedGauges, gauge_basis

X, CELLS = box_arrays((1.0, 0.4, 0.3), (4, 3, 3))
FACES = box_surfaces(X, CELLS)
OBLIQUE = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]  # no face stays parallel to an axis


@pytest.fixture
def rng():
    return np.random.default_rng(1)


def skew(ω):
    return np.cross(np.eye(3), ω)  # skew(ω) @ x = ω × x


def measured(u, nodes=X, triangles=None):
    triangles = np.concatenate(list(FACES.values())) if triangles is None else triangles
    return SurfaceGauges(nodes, triangles).components(u)


def in_space(rom, q, mode):
    """Displacement of all nodes, (N, 3)."""
    field = np.zeros(3 * len(rom.nodes))
    field[rom.free] = rom.basis @ (mode.coordinates @ q)
    return field.reshape(-1, 3)


def mode_gauge(rom, mode):
    return ReducedGauges(gauge_basis(rom) @ mode.coordinates, mode.eigenvalues)


@pytest.mark.parametrize("nodes", [X, X @ OBLIQUE, 1e-3 * X])
def test_small_rotation_is_itself_on_every_triangle(nodes):
    ω = np.array([0.03, -0.05, 0.02])
    components = measured(nodes @ skew(ω).T + [1.0, 2.0, -3.0], nodes)
    np.testing.assert_allclose(np.linalg.norm(components[:, :3], axis=1), np.linalg.norm(ω), rtol=1e-9)
    np.testing.assert_allclose(components[:, 3:], 0, atol=5e-11)


def test_components_are_along_the_first_side_across_it_and_normal():
    corners, ω = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [1.0, 3.0, 0.0]]), [0.03, -0.05, 0.02]
    A = skew(ω) + np.array([[0.1, 0.3, 0.0], [0.3, 0.2, 0.0], [0.0, 0.0, 0.4]])
    components = measured(corners @ A.T, corners, np.array([[0, 1, 2]]))
    np.testing.assert_allclose(components, [[*ω, 0.1, 0.2, 0.3 * math.sqrt(2)]], rtol=1e-12)


def test_translation_is_nothing():
    assert measure_peaks(measured(np.full_like(X, 7.0))) == pytest.approx((0.0, 0.0), abs=1e-12)


@pytest.mark.parametrize("turned", [np.eye(3), OBLIQUE])
def test_strain_is_that_in_the_planes_of_the_faces(turned):
    A = np.array([[0.02, 0.03, -0.01], [0.03, -0.05, 0.04], [-0.01, 0.04, 0.01]])
    for axis, names in enumerate((("left", "right"), ("front", "back"), ("bottom", "top"))):
        within = np.delete(np.delete(A, axis, 0), axis, 1)
        for triangles in (FACES[name] for name in names):
            # The body and its field turned together are still the same body.
            components = measured(X @ A @ turned, X @ turned, triangles)
            np.testing.assert_allclose(np.linalg.norm(components[:, 3:], axis=1), np.linalg.norm(within), rtol=1e-10)
            np.testing.assert_allclose(components[:, 2], 0, atol=1e-12)
            assert measure_peaks(components)[1] == pytest.approx(np.abs(np.linalg.eigvalsh(within)).max(), rel=1e-10)


@pytest.mark.parametrize("θ", [1e-3, ROTATION_LIMIT, 2.0])
@pytest.mark.parametrize("axis", range(3))
def test_what_a_linear_model_makes_of_a_rigid_rotation(θ, axis):
    a = np.eye(3)[axis]
    R = np.eye(3) + math.sin(θ) * skew(a) + (1 - math.cos(θ)) * skew(a) @ skew(a)
    rotation, strain = measure_peaks(measured(X @ (R - np.eye(3)).T))
    assert rotation == pytest.approx(math.sin(θ), rel=1e-12)
    assert strain == pytest.approx(1 - math.cos(θ), abs=2e-14)


def test_errors_at_the_limits_are_what_the_comments_say():
    assert 1 - math.cos(ROTATION_LIMIT) == pytest.approx(0.020, abs=5e-4)
    pull, push = ((λ - λ**-2) / 3 / (λ - 1) for λ in (1 + STRAIN_LIMIT, 1 - STRAIN_LIMIT))
    assert (pull, push) == pytest.approx((0.91, 1.12), abs=5e-3)


def test_fields_at_once_are_fields_one_by_one(rng):
    u = rng.normal(size=(len(X), 3, 5))
    together = measured(u)
    for k in range(5):
        np.testing.assert_allclose(together[:, :, k], measured(u[:, :, k]), rtol=1e-12, atol=1e-12)


def test_many_triangles_are_thinned_evenly():
    points, cells = box_arrays((1.0, 1.0, 1.0), (10, 10, 10))
    triangles = np.concatenate(list(box_surfaces(points, cells).values()))
    seen = SurfaceGauges(points, triangles).triangles
    np.testing.assert_array_equal(seen, triangles[::3])  # of 1200
    assert MAX_TRIANGLES / 2 < len(seen) <= MAX_TRIANGLES
    few = triangles[:MAX_TRIANGLES]
    np.testing.assert_array_equal(SurfaceGauges(points, few).triangles, few)


@pytest.mark.filterwarnings("error")
def test_triangles_without_area_are_left_out():
    nodes = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0], [0, 1e-11, 0]])
    gauges = SurfaceGauges(nodes, np.array([[0, 1, 2], [0, 1, 1], [3, 3, 3], [0, 1, 4], [0, 1, 3]]))
    np.testing.assert_array_equal(gauges.triangles, [[0, 1, 3]])
    assert measure_peaks(gauges.components(nodes)) == (0.0, 1.0)


@pytest.mark.filterwarnings("error")
def test_of_no_triangles_everything_is_zero(plate_rom):
    gauges = SurfaceGauges(np.empty((0, 3)), np.empty((0, 3), dtype=int))
    assert measure_peaks(gauges.components(np.empty((0, 3)))) == (0.0, 0.0)
    without = replace(plate_rom, nodes=np.empty((0, 3)), triangles=np.empty((0, 3), dtype=int))
    for mode in plate_rom.contact_models.values():
        gauge = mode_gauge(without, mode)
        assert gauge.safe_energy == math.inf
        assert gauge.largest_change(np.ones(mode.order), np.empty(0)) == 0.0
        assert gauge.read(np.ones(mode.order)) == (0.0, 0.0)


@pytest.mark.filterwarnings("error")
def test_a_surface_that_cannot_move_is_always_safe():
    assert ReducedGauges(np.zeros((12, 3)), np.ones(3)).safe_energy == math.inf


def test_state_is_read_like_the_displacement_it_stands_for(plate_rom, rng):
    gauges = SurfaceGauges(plate_rom.nodes, plate_rom.triangles)
    for mode in plate_rom.contact_models.values():
        q = rng.normal(size=mode.order) / np.sqrt(mode.eigenvalues)
        expected = measure_peaks(gauges.components(in_space(plate_rom, q, mode)))
        assert mode_gauge(plate_rom, mode).read(q) == pytest.approx(expected, rel=1e-9)


def test_free_components_may_come_in_any_order(plate_rom, rng):
    order = rng.permutation(len(plate_rom.free))
    mixed = replace(plate_rom, free=plate_rom.free[order], basis=plate_rom.basis[order])
    np.testing.assert_array_equal(gauge_basis(mixed), gauge_basis(plate_rom))


def worst_states(rom, mode):
    """√γ q (2g, m) of length one, by which each triangle turns most and is strained most."""
    rows = gauge_basis(rom) @ mode.coordinates / np.sqrt(mode.eigenvalues)
    return np.linalg.svd(rows.reshape(-1, 3, mode.order), full_matrices=False)[2][:, 0]


def severities(gauge, states):
    return np.array([SurfaceStrainPeak(*gauge.read(q)).severity for q in states])


def test_below_the_safe_energy_nothing_is_beyond(plate_rom, rng):
    """Random states, the static ones, and the worst of each triangle, all brought to the safe energy."""
    for mode in plate_rom.contact_models.values():
        gauge, γ = mode_gauge(plate_rom, mode), mode.eigenvalues
        y = np.concatenate(
            [rng.normal(size=(100, mode.order)), mode.inputs.T / np.sqrt(γ), worst_states(plate_rom, mode)]
        )
        y *= math.sqrt(2 * gauge.safe_energy) / np.linalg.norm(y, axis=1, keepdims=True)
        severity = severities(gauge, y / np.sqrt(γ))
        assert severity.max() <= 1 + 1e-12
        assert severity.max() >= 0.999  # here turning is what counts, and the bound on it is sharp


def test_bound_on_strain_is_sharp_to_root_two(rng):
    """Of a body that is strained far more than turned."""
    γ = np.array([2.0, 5.0, 7.0, 11.0])
    rows = rng.normal(size=(30, 6, 4))
    rows[:, :3] *= 1e-3
    gauge = ReducedGauges(rows.reshape(-1, 4), γ)
    worst = np.linalg.svd(rows[:, 3:] / np.sqrt(γ))[2][:, 0]
    severity = severities(gauge, math.sqrt(2 * gauge.safe_energy) * worst / np.sqrt(γ)).max()
    assert 1 / math.sqrt(2) - 1e-12 <= severity <= 1 + 1e-12


def test_after_a_look_severity_changes_by_no_more_than_is_said(plate_rom):
    mode = plate_rom.contact_models["tip_left"]
    gauge, γ = mode_gauge(plate_rom, mode), mode.eigenvalues
    q = mode.inputs[:, 2] / γ
    q *= 0.6 / SurfaceStrainPeak(*gauge.read(q)).severity
    y = worst_states(plate_rom, mode)
    δ = 0.4 * math.sqrt(2 * gauge.safe_energy) * np.concatenate([y, -y])
    assert gauge.largest_change(δ[0], np.empty(0)) == pytest.approx(0.4, rel=1e-12)
    assert 0.9 < severities(gauge, q + δ / np.sqrt(γ)).max() <= 1 + 1e-12


def static(system, contact, force):
    """Displacement of all nodes, (N, 3)."""
    field = np.zeros(3 * len(system.body.nodes))
    B = system.contacts[contact]
    field[system.body.free] = system.algebra.gather(
        system.algebra.factor((1.0, system.stiffness)).solve(B @ np.reshape(force, (-1, 1)))
    )[:, 0]
    return field.reshape(-1, 3)


def test_cantilever_turns_and_strains_as_beam_theory_says(tmp_path):
    """E I w'' = F (L - x): slope F L²/2EI at the tip, strain F L h/2EI at the root."""
    L, b, h, E, F = 1.0, 0.1, 0.08, 1e6, 0.5
    mesh = write_box(tmp_path / "beam.msh", (L, b, h), (16, 2, 2))
    system = assembled(mesh, degree=2, contacts='[contacts.right]\nsurface = "right"\nforce = "resultant"')
    u = static(system, "right", [0.0, 0.0, F])
    gauges = SurfaceGauges(system.body.nodes, system.body.triangles)
    components = gauges.components(u)
    EI = E * b * h**3 / 12
    assert measure_peaks(components)[0] == pytest.approx(F * L**2 / (2 * EI), rel=0.02)
    assert measure_peaks(components)[1] == pytest.approx(F * L * h / (2 * EI), rel=0.1)
    x = system.body.nodes[gauges.triangles, 0].mean(axis=1)
    inner = (x > 0.2) & (x < 0.8)  # slope along the whole beam
    turned = np.linalg.norm(components[inner, :3], axis=1)
    np.testing.assert_allclose(turned, F * (L * x - x**2 / 2)[inner] / EI, rtol=0.05)


def test_plate_turns_as_its_nodes_say(plate_system):
    """Slope of the tip from the two last rows of nodes of the upper face."""
    u, nodes = static(plate_system, "tip_left", [0.0, 0.0, 0.5]), plate_system.body.nodes
    x = np.unique(nodes[:, 0].round(9))[-2:]
    rows = [np.flatnonzero(np.isclose(nodes[:, 0], at) & np.isclose(nodes[:, 2], nodes[:, 2].max())) for at in x]
    slope = (u[rows[1], 2].mean() - u[rows[0], 2].mean()) / (x[1] - x[0])
    rotation, _ = measure_peaks(measured(u, nodes, plate_system.body.triangles))
    assert rotation == pytest.approx(slope, rel=0.2)


def test_within_the_limits_there_is_nothing_to_say():
    seen = SurfaceStrainPeak(rotation=ROTATION_LIMIT, strain=STRAIN_LIMIT, time=1.0)
    assert (seen.severity, seen.beyond, seen.warning, seen.summary) == (1.0, False, "", "")


@pytest.mark.parametrize(
    ("rotation", "strain", "is_at", "good_to"),
    [
        (0.31, 0.02, "turned by 0.31 rad (17.8°)", "0.2 rad (11°)"),
        (0.01, 0.123, "strained by 12.3 %", "10 %"),
        (0.31, 0.123, "turned by 0.31 rad (17.8°) and strained by 12.3 %", "0.2 rad (11°) and 10 %"),
    ],
)
def test_warning_says_how_much_when_and_what_is_allowed(rotation, strain, is_at, good_to):
    seen = SurfaceStrainPeak(rotation, strain, time=0.42)
    assert seen.beyond
    assert seen.warning == (
        f"the surface is {is_at} at t = 0.42 s, and a linear model is good to about {good_to}: "
        "shapes and forces from here on are not to be trusted; "
        "effects.large_deformation follows bodies further"
    )
    assert seen.summary == (
        f"the surface was {is_at.replace('by ', 'by up to ')}, and a linear model is good to about {good_to}: "
        "shapes and forces from t = 0.42 s on are not to be trusted; "
        "effects.large_deformation follows bodies further"
    )


def test_joined_keeps_the_largest_and_the_first_time_beyond():
    run = SurfaceStrainPeak()
    for step, (rotation, strain) in enumerate([(0.1, 0.05), (0.25, 0.01), (0.5, 0.02), (0.1, 0.3)]):
        run = run.joined(SurfaceStrainPeak(rotation, strain, float(step)))
    assert run == SurfaceStrainPeak(rotation=0.5, strain=0.3, time=1.0)
