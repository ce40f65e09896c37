"""Edges of a surface, its strain, colours and obstacles."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import box_arrays, box_surfaces

from fenics_rom.mechanics.obstacles import Box, Capsule, HalfSpace, Sphere
from fenics_rom.visualization.obstacle_meshes import obstacle_mesh
from fenics_rom.visualization.viewer.colours import bar_colours, round_up, with_unit
from fenics_rom.visualization.viewer.surface import Surface, SurfaceStrain, surface_fields


@pytest.fixture(scope="module")
def box():
    """Nodes and surface triangles of a box that is not straight in its inside."""
    points, cells = box_arrays((1.0, 0.4, 0.3), (4, 3, 2))
    return points, np.concatenate(list(box_surfaces(points, cells).values()))


def test_a_box_is_smooth_but_for_its_edges(box):
    nodes, triangles = box
    corners = nodes[triangles]
    outwards = corners.mean(axis=1) - nodes.mean(axis=0)
    inside_out = (np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) * outwards).sum(axis=1) < 0
    surface = Surface(nodes, np.where(inside_out[:, None], triangles[:, ::-1], triangles))
    assert len(surface.nodes) < len(surface.node_of) < 3 * len(surface.triangles)
    assert np.array_equal(surface.node_of[surface.faces], surface.triangles)
    corners = surface.places[surface.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    sides = len(np.unique(normals.round(9), axis=0))
    assert sides == 6
    for vertex in range(len(surface.node_of)):
        assert len(np.unique(normals[(surface.faces == vertex).any(axis=1)].round(9), axis=0)) == 1
    of_sides = np.unique(normals.round(9), axis=0, return_inverse=True)[1].ravel().astype(float)
    of_corners = surface.of_triangles(of_sides)[surface.faces]
    np.testing.assert_allclose(of_corners, np.repeat(of_sides[:, None], 3, axis=1), rtol=1e-14)


def test_what_is_round_has_one_vertex_at_each_node():
    ball = obstacle_mesh(Sphere((0.0, 0.0, 0.0), 1.0), np.zeros(3), 1.0)
    surface = Surface(*ball)
    assert len(surface.node_of) == len(surface.nodes)
    ones = np.ones(len(surface.triangles))
    assert surface.of_triangles(ones) == pytest.approx(1.0, abs=1e-14)
    assert np.array_equal(surface.of_nodes(np.arange(len(surface.nodes)))[surface.faces], surface.triangles)


def test_bar_under_tension_has_its_energy_density_on_every_side(box):
    E, ν, ε = 2e6, 0.3, 1e-3
    places, triangles = box
    displacement = places * (ε * np.array([1, -ν, -ν]))
    strain = SurfaceStrain(places, triangles)
    along = np.ptp(places[triangles][:, :, 0], axis=1) > 0  # not the two ends, which are pulled at
    assert strain.energy_density(displacement, E, ν)[along] == pytest.approx(E * ε**2 / 2, rel=1e-12)
    assert strain.largest(displacement)[along] == pytest.approx(ε, rel=1e-12)


def test_sheared_plate_has_its_energy_density(box):
    E, ν, γ = 2e6, 0.3, 1e-3
    places, triangles = box
    flat = np.ptp(places[triangles][:, :, 2], axis=1) == 0
    strain = SurfaceStrain(places, triangles[flat])
    density = strain.energy_density(np.outer(γ * places[:, 1], [1, 0, 0]), E, ν)
    assert density == pytest.approx(E / (2 * (1 + ν)) * γ**2 / 2, rel=1e-12)
    assert strain.largest(np.outer(γ * places[:, 1], [1, 0, 0])) == pytest.approx(γ / 2, rel=1e-12)


def test_rigid_motion_does_not_strain(box):
    places, triangles = box
    motion = np.cross([0.1, -0.2, 0.3], places) + np.array([1.0, 2.0, 3.0])
    assert np.abs(SurfaceStrain(places, triangles).components(motion)).max() < 5e-14  # eps of 3 m, over an edge


def test_triangle_without_area_has_no_strain():
    places = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0]])
    strain = SurfaceStrain(places, np.array([[0, 1, 2], [0, 1, 3], [1, 1, 1]]))
    assert np.array_equal(strain.largest(places) > 0, [False, True, False])


def test_energy_density_is_offered_for_one_material_only(box, plate_rom):
    surface, environment = Surface(*box), plate_rom.environment
    assert set(surface_fields(surface, environment)) == {"displacement", "speed", "strain", "energy density"}
    assert set(surface_fields(surface, None, moves=False)) == {"displacement", "strain"}
    (material,) = (text for place, text in environment.built_in.items() if place.startswith("materials."))
    both = replace(environment, built_in={"materials.rubber": material, "materials.steel": material})
    assert "energy density" not in surface_fields(surface, both)


def test_bar_is_viridis():
    assert (bar_colours()[0], bar_colours()[-1]) == ((68, 1, 84), (253, 231, 37))


@pytest.mark.parametrize(
    ("value", "end"), [(0, 0), (1, 1), (1.01, 2), (3e-5, 5e-5), (7e3, 1e4), (0.2, 0.2), (np.nan, 0), (1e-300, 1e-300)]
)
def test_scale_ends_at_a_round_number(value, end):
    assert round_up(value) == pytest.approx(end, rel=1e-12)


def test_numbers_have_prefixes_where_the_unit_takes_them():
    assert [with_unit(0.00123, "J"), with_unit(0.0, "J"), with_unit(12.3456, "%"), with_unit(1e4, "J/m³")] == [
        "1.23 mJ",
        "0 J",
        "12.3 %",
        "1e+04 J/m³",
    ]


@pytest.mark.parametrize(
    "obstacle",
    [
        Sphere((1.0, 2.0, 3.0), 0.5),
        Capsule((0.0, 1.0, 0.0), (1.0, 2.0, -1.0), 0.2),
        Box((1.0, 0.0, 0.0), (1.0, 2.0, 3.0), (0.3, -0.2, 0.5)),
        HalfSpace((0.0, 0.0, 1.0), (0.3, 0.1, 1.0)),
    ],
)
def test_meshes_of_obstacles_lie_on_them(obstacle):
    vertices, faces = obstacle_mesh(obstacle, np.array([0.5, 1.0, 0.0]), 1.5)
    gap, _ = obstacle.distance(vertices)
    assert np.abs(gap).max() < 1e-7  # what trimesh rounds to
    assert faces.max() == len(vertices) - 1
