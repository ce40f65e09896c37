"""Cells that fill a body once, told from cells that overlap; how good they are; and what a body is in plain numbers."""

import re

import numpy as np
import pytest
from bodies import assembled, box_arrays, box_surfaces, dense, scene_text, write_arrays
from ranks import run_ranks
from scipy.linalg import eigh

import fenics_rom as fr
from fenics_rom.errors import MeshError
from fenics_rom.fem.mesh import oriented, read_mesh
from fenics_rom.fem.mesh_quality import check_filling, faces_of, radius_ratios, signed_volumes, volume_within
from fenics_rom.mechanics.body_facts import NEAR_FLAT, quality_of
from fenics_rom.reduction.rigid_mode_deflation import first_frequency
from fenics_rom.scene.file import parse_scene

LENGTHS, BRICKS = (0.5, 0.1, 0.06), (10, 3, 3)
ROUND_OFF = 1e-13  # of sums of some hundred volumes
REGULAR = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
CORNER = np.vstack([np.zeros(3), np.eye(3)])
CORNER_RATIO = 3 * 1 / (3 + np.sqrt(3)) / (np.sqrt(3) / 2)  # 3 V/A = 1/(3 + √3), circumscribed to half the diagonal


def nearest(points, place):
    return int(np.linalg.norm(points - np.multiply(place, LENGTHS), axis=1).argmin())


@pytest.fixture(scope="module")
def box():
    points, cells = box_arrays(LENGTHS, BRICKS, shake=0.2)
    return points, oriented(points, cells)


@pytest.fixture
def broken(box):
    """One node inside moved by a fifth of the body; what is inverted then, as the cells were positive before."""
    points, cells = box[0].copy(), box[1]
    points[nearest(points, (0.5, 0.4, 0.4))] += [0.1, 0.05, 0.02]
    return points, cells, signed_volumes(points, cells) < 0


def shuffled(cells):
    """The same cells, their vertices in any order."""
    return np.random.default_rng(1).permuted(cells, axis=1)


@pytest.mark.parametrize(
    ("corners", "ratio"), [(REGULAR, 1.0), (CORNER, CORNER_RATIO), (CORNER * [[1], [1], [1], [0]] + [0, 0, 1e-12], 0.0)]
)
def test_radius_ratio_of_known_tetrahedra(corners, ratio):
    turn = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))[0]
    cells = np.array([[0, 1, 2, 3], [2, 0, 3, 1]])
    np.testing.assert_allclose(radius_ratios(corners, cells), ratio, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(radius_ratios(1e-3 * corners @ turn + 7e-3, cells), ratio, rtol=1e-10, atol=1e-12)


def test_whole_mesh_fills_what_its_surface_encloses(box):
    points, cells = box
    faces = faces_of(points, cells)
    assert (faces.sides == 1).all()
    assert faces.crowded == 0
    volume = np.prod(LENGTHS)
    assert abs(volume_within(points[faces.outside]) / volume - 1) <= ROUND_OFF
    assert abs(signed_volumes(points, cells).sum() / volume - 1) <= ROUND_OFF
    check_filling(points, cells, "box")


def test_inverted_cells_are_found_in_whatever_order_their_vertices_are(broken):
    points, cells, inverted = broken
    assert 3 < inverted.sum() < len(cells) / 4
    faces = faces_of(points, oriented(points, shuffled(cells)))
    np.testing.assert_array_equal(faces.sides < 0, inverted)
    assert abs(volume_within(points[faces.outside]) / np.prod(LENGTHS) - 1) <= ROUND_OFF


def test_each_part_of_a_body_has_its_own_sides(box, broken):
    """A whole box, and a broken one beside it."""
    points, cells, inverted = broken
    both = np.concatenate([box[0] + [0, 1, 0], points]), np.concatenate([box[1], cells + len(points)])
    sides = faces_of(both[0], oriented(*both)).sides
    np.testing.assert_array_equal(sides < 0, np.concatenate([np.zeros(len(cells), dtype=bool), inverted]))


def test_node_of_the_surface_that_is_moved_through_the_body_is_found(box):
    points, cells = box[0].copy(), box[1]
    points[nearest(points, (0.5, 0.0, 0.0))] += [0, 0.05, 0]
    cells = oriented(points, cells)
    with pytest.raises(MeshError, match="cells overlap"):
        check_filling(points, cells, "box")


def test_mesh_whose_cells_overlap_is_refused_with_its_volumes(broken, tmp_path):
    points, cells, inverted = broken
    volume, flat = np.abs(signed_volumes(points, cells)).sum(), (radius_ratios(points, cells) < NEAR_FLAT).sum()
    file = write_arrays(tmp_path / "broken.msh", points, shuffled(cells), box_surfaces(*box_arrays(LENGTHS, BRICKS)))
    said = (
        rf"cells overlap: their volumes add up to {volume:.6g} m³, and the surface encloses {np.prod(LENGTHS):.6g} m³; "
        rf"{inverted.sum()} of {len(cells)} cells are inverted, e.g. the one around \[.*\], {flat} are near-flat"
    )
    with pytest.raises(MeshError, match=said):
        read_mesh(file, {})
    with pytest.raises(MeshError, match="cells overlap"):
        assembled(file)


def test_cell_on_a_face_that_two_have_is_refused(box):
    points, cells = box
    apex = points[cells[40]].mean(axis=0)
    more = oriented(np.vstack([points, apex]), np.vstack([cells, [*cells[40][:3], len(points)]]))
    with pytest.raises(MeshError, match="1 faces belong to more than two cells"):
        check_filling(np.vstack([points, apex]), more, "box")


@pytest.mark.ranks
def test_two_ranks_say_once_that_cells_overlap(broken, tmp_path):
    points, cells, _ = broken
    file = write_arrays(tmp_path / "broken.msh", points, cells, box_surfaces(*box_arrays(LENGTHS, BRICKS)))
    (tmp_path / "scene.toml").write_text(scene_text(file))
    run = run_ranks(2, "-m", "fenics_rom", "reduce", "scene.toml", "-o", "rom.h5", cwd=tmp_path)
    assert run.returncode == 1
    assert run.stderr.count("cells overlap") == 1


# What a body is


@pytest.fixture(scope="module")
def file(box, tmp_path_factory):
    return write_arrays(tmp_path_factory.mktemp("box") / "box.msh", *box)


@pytest.fixture(scope="module")
def system(file):
    return assembled(file)


@pytest.fixture(scope="module")
def rom(system):
    return fr.reduce(system, order=6, method="modal")


def test_first_frequency_is_that_of_the_lowest_eigenvalue(system, rom, box):
    M, K = (dense(matrix, system.size) for matrix in (system.mass, system.stiffness))
    hertz = np.sqrt(eigh(K, M, eigvals_only=True, subset_by_index=[0, 0])[0]) / (2 * np.pi)
    assert first_frequency(system) == pytest.approx(hertz, rel=1e-8)
    assert rom.first_frequency == pytest.approx(hertz, rel=1e-8)


def test_first_frequency_of_a_free_body_is_above_its_rigid_motions(file):
    system = assembled(file, supports=None)
    M, K = (dense(matrix, system.size) for matrix in (system.mass, system.stiffness))
    hertz = np.sqrt(eigh(K, M, eigvals_only=True, subset_by_index=[0, 6])[6]) / (2 * np.pi)
    assert first_frequency(system) == pytest.approx(hertz, rel=1e-7)


def test_file_keeps_how_many_cells_there_are_and_how_good(rom, box, tmp_path):
    ratios = radius_ratios(*box)
    fr.write_rom(tmp_path / "rom.h5", rom)
    cells = fr.read_rom(tmp_path / "rom.h5").cells
    assert cells == rom.cells
    assert cells.count == len(ratios)
    assert (cells.least, cells.mean) == pytest.approx((ratios.min(), ratios.mean()), rel=1e-14)


def test_near_flat_cells_are_counted(box):
    points, cells = box
    flat = np.vstack([points, points[cells[0][:3]].mean(axis=0) + 1e-6 * np.ones(3)])
    a, b, c, d = cells[0]
    apex = len(points)
    split = np.vstack([cells[1:], [[a, b, c, apex], [a, b, d, apex], [b, c, d, apex], [a, c, d, apex]]])
    split = oriented(flat, split)
    quality = quality_of(radius_ratios(flat, split))
    assert (quality.count, quality.near_flat) == (len(cells) + 3, 1)
    assert f"{len(cells) + 3}, 1 of them near-flat (below {NEAR_FLAT:g})" in str(quality)


def test_mesh_in_millimetres_is_the_same_body(system, box, tmp_path):
    file = write_arrays(tmp_path / "millimetres.msh", 1e3 * box[0], box[1])
    scaled = fr.assemble(parse_scene(scene_text(file).replace("degree = 1", "degree = 1\nscale = 1e-3")))
    for one, other in ((scaled.mass, system.mass), (scaled.stiffness, system.stiffness)):
        A, B = dense(one, system.size), dense(other, system.size)
        assert np.abs(A - B).max() <= 1e-12 * np.abs(B).max()
    assert "500 m long: coordinates are in metres" in assembled(file).warnings[0]


@pytest.mark.parametrize(
    ("choices", "said"),
    [
        ({"material": "young = 0.5\npoisson = 0.3\ndensity = 1000.0"}, "material.young = 0.5 Pa: .* 100 to 2e[+]12 Pa"),
        ({"material": "young = 1e6\npoisson = 0.3\ndensity = 1e-9"}, "the body weighs 3e-12 kg, less than 1e-06 kg"),
    ],
)
def test_units_that_look_like_a_mistake_are_told(file, choices, said):
    (warning,) = assembled(file, **choices).warnings
    assert re.search(said, warning)


def test_plausible_bodies_are_not_talked_about(system):
    assert system.warnings == ()
