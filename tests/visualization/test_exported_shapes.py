"""The shapes and velocities that exports show, against the full-order model."""

from dataclasses import replace

import numpy as np
from bodies import PLATE

import fenics_rom as fr
from fenics_rom.scene.file import parse_scene
from fenics_rom.visualization.contact_surface import on_kept_surface
from fenics_rom.visualization.exports.mode_shapes import balanced_modes, eigenvectors, shapes_at_rest


def free(rom, field):
    return field.displacement.ravel()[rom.free]


def test_modes_are_orthonormal_and_have_their_own_frequencies(plate_rom, plate_system):
    M, K = plate_system.mass, plate_system.stiffness
    for name, mode in plate_rom.contact_models.items():
        modes = balanced_modes(plate_rom, mode)
        X = np.column_stack([free(plate_rom, field) for field in modes])
        np.testing.assert_allclose(X.T @ (M @ X), np.eye(len(modes)), atol=1e-10)
        rayleigh = np.sqrt(np.diag(X.T @ (K @ X))) / (2 * np.pi)
        np.testing.assert_allclose([field.frequency for field in modes], rayleigh, rtol=1e-8)
        assert [field.σ for field in modes] == list(mode.hankel_singular_values[: mode.order])
        lower = balanced_modes(fr.truncate(plate_rom, 5), fr.truncate(plate_rom, 5).contact_models[name])
        np.testing.assert_allclose(  # the first five span the model of order five
            X[:, :5].T @ (M @ np.column_stack([free(plate_rom, field) for field in lower])) @ np.ones(5),
            (X.T @ (M @ np.column_stack([free(plate_rom, field) for field in lower])) @ np.ones(5))[:5],
        )


def test_eigenvectors_and_shapes_at_rest_are_those_of_the_full_model(plate_rom, plate_system):
    K, mode = plate_system.stiffness, plate_rom.contact_models["tip_left"]
    first = eigenvectors(plate_rom, mode)[0]
    x = free(plate_rom, first)
    residual = K @ x[:, None] - (2 * np.pi * first.frequency) ** 2 * (plate_system.mass @ x[:, None])
    assert np.linalg.norm(residual) < 1e-3 * np.linalg.norm(K @ x[:, None])
    rest = np.column_stack([free(plate_rom, field) for field in shapes_at_rest(plate_rom, mode)])
    b = plate_system.contacts["tip_left"]
    np.testing.assert_allclose(
        rest.T @ b, b.T @ plate_system.algebra.factor((1.0, K)).solve(b), rtol=1e-4, atol=1e-5 * 0.033
    )


def test_full_order_keeps_the_same_velocities(plate_system, plate_rom):
    scene = replace(plate_system.scene, run=replace(plate_system.scene.run, duration=0.05, snapshots=5))
    system = replace(plate_system, scene=scene)
    full, reduced = fr.simulate(system), fr.simulate(plate_rom, scene=scene)
    assert np.abs(full.velocities - reduced.velocities).max() < 5e-3 * np.abs(full.velocities).max()


def test_patch_near_a_point_has_the_triangles_that_are_near(plate_rom):
    point = [0.25, 0.1, 0.01]
    near = plate_rom.scene_text.replace('surface = "middle"', f"near = {{ point = {point}, radius = 0.08 }}")
    surfaces = fr.assemble(parse_scene(near, folder=PLATE.parent)).body.contact_surfaces
    patch = plate_rom.triangles[on_kept_surface(replace(plate_rom, contact_surfaces=surfaces), "middle")]
    centroids = plate_rom.nodes[plate_rom.triangles].mean(axis=1)
    expected = plate_rom.triangles[np.linalg.norm(centroids - point, axis=1) <= 0.08]
    assert len(expected)
    assert {tuple(corners) for corners in expected} <= {tuple(corners) for corners in patch}
    assert set(patch.ravel()) == set(expected.ravel())
