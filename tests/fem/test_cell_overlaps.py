"""Parts of a body that overlap, or touch without sharing nodes, are told with numbers; gluing makes them one."""

import re

import gmsh
import numpy as np
import pytest
from bodies import assembled, box_arrays, box_surfaces, scene_text, write_arrays
from ranks import run_ranks
from scipy.spatial import ConvexHull, HalfspaceIntersection
from test_foreign_meshes import GROUPS, write_vtu
from test_mesh import in_order_of_place, write_gmsh

from fenics_rom.cli.main import main
from fenics_rom.errors import MeshError
from fenics_rom.fem.cell_overlaps import common_pieces, describe_overlaps, piece_volumes
from fenics_rom.fem.filling import fill_surface
from fenics_rom.fem.gluing import glue_mesh
from fenics_rom.fem.meeting_boxes import meeting_boxes
from fenics_rom.fem.mesh import oriented, read_mesh
from fenics_rom.fem.mesh_quality import check_filling, faces_of, signed_volumes
from fenics_rom.reduction.rigid_mode_deflation import first_frequency

HALF, BRICKS = (0.08, 0.016, 0.006), (8, 3, 2)  # m; the lower half of a beam
HANGING = {"material": "young = 3e5\npoisson = 0.4\ndensity = 1100"}


def together(*bodies):
    """Points and cells of bodies that share no nodes."""
    count = np.cumsum([0, *(len(points) for points, _ in bodies)])
    return np.vstack([p for p, _ in bodies]), np.vstack([c + n for (_, c), n in zip(bodies, count, strict=False)])


def moved(body, *step):
    return body[0] + np.array(step), body[1]


def told(points, cells):
    cells = oriented(points, cells)
    return [*describe_overlaps(points, cells, check_filling(points, cells, "body"), "body.msh")]


# Boxes that meet, and what tetrahedra have in common


def test_boxes_that_meet_are_those_that_every_pair_shows():
    random = np.random.default_rng(0)
    low = random.uniform(size=(300, 3)) * (1, 0.5, 0.1)
    high = low + 10.0 ** random.uniform(-4, -0.7, size=(300, 3))  # of very different sizes
    group, is_open = random.integers(3, size=300), random.random(300) < 0.3
    meets = (low[:, None] <= high[None]).all(axis=2) & (low[None] <= high[:, None]).all(axis=2)
    meets &= (group[:, None] != group) | (is_open[:, None] & is_open)
    expected = {(i, j) for i, j in zip(*np.nonzero(np.triu(meets, 1)), strict=True)}
    found = [tuple(sorted(pair)) for pair in meeting_boxes(low, high, group, is_open).tolist()]
    assert len(found) == len(set(found)) > 30
    assert set(found) == expected


def test_common_volume_of_tetrahedra_is_that_of_half_spaces():
    """As Qhull has it of random ones; of a corner moved along an axis it is (1 - t)³/6."""
    random = np.random.default_rng(1)
    corner = np.vstack([np.zeros(3), np.eye(3)])
    one = random.uniform(size=(40, 4, 3))
    one = np.where((np.linalg.det(one[:, 1:] - one[:, :1]) > 0)[:, None, None], one, one[:, [1, 0, 2, 3]])
    other = np.roll(one, 1, axis=0)
    pieces, pair = common_pieces(one, other)
    volumes = np.bincount(pair, weights=piece_volumes(pieces), minlength=len(one))
    hulls = [[ConvexHull(tetrahedron).equations for tetrahedron in both] for both in zip(one, other, strict=True)]
    meeting = 0
    for k, volume in enumerate(volumes):
        if volume < 1e-6:
            continue
        inside = pieces[pair == k][piece_volumes(pieces[pair == k]).argmax()].mean(axis=0)
        exact = ConvexHull(HalfspaceIntersection(np.vstack(hulls[k]), inside).intersections).volume
        assert volume == pytest.approx(exact, rel=1e-9)
        meeting += 1
    assert meeting > 10
    for t in (0.0, 0.3, 0.9, 1.5):
        pieces, _ = common_pieces(corner[None], corner[None] + [t, 0, 0])
        assert piece_volumes(pieces).sum() == pytest.approx(max(1 - t, 0.0) ** 3 / 6, abs=1e-15)


# What is told


@pytest.mark.parametrize("step", [(0, 0.008, 0), (0.001, 0.0075, 0.0005), (0, 0, 0)])
def test_overlap_is_told_with_the_volume_that_counts_twice(step):
    """Also where nodes lie on nodes, and of a volume that is there twice."""
    box = box_arrays((0.08, 0.016, 0.012), (8, 4, 3), shake=0.2)
    (said,) = told(*together(box, moved(box, *step)))
    numbers = re.match(
        r"2 parts of the body overlap between \[(.*)\] and \[(.*)\]: of the (\S+) m³ of all cells (\S+) m³", said
    )
    common = np.prod([0.08, 0.016, 0.012] - np.array(step))
    assert float(numbers[3]) == pytest.approx(2 * 0.08 * 0.016 * 0.012, rel=6e-4)
    assert float(numbers[4]) == pytest.approx(common, rel=6e-3)
    np.testing.assert_allclose(np.array(numbers[1].split(", "), dtype=float), step, atol=1e-6)
    np.testing.assert_allclose(np.array(numbers[2].split(", "), dtype=float), [0.08, 0.016, 0.012], atol=1e-6)


def test_mass_of_overlapping_boxes_counts_twice_what_is_told(tmp_path):
    box = box_arrays((0.08, 0.016, 0.012), (8, 4, 3))
    points, cells = together(box, moved(box, 0, 0.008, 0))
    system = assembled(write_arrays(tmp_path / "two.msh", points, cells), **HANGING)
    (said,) = system.warnings
    twice = float(re.search(r"all cells (\S+) m³ count twice", said)[1])
    assert system.body.node_mass.sum() - 1100 * twice == pytest.approx(
        1100 * 0.08 * 0.024 * 0.012, rel=2e-3
    )  # 0.0253 kg


def test_part_inside_another_is_told_and_in_its_cavity_not():
    outer = box_arrays((0.06, 0.06, 0.06), (6, 6, 6), shake=0.2)
    inner = box_arrays((0.004, 0.004, 0.004), (1, 1, 1))
    (said,) = told(*together(outer, moved(inner, 0.0283, 0.0284, 0.0285)))
    assert said.startswith("2 parts of the body overlap between [0.0283, 0.0284, 0.0285] and [0.0323, 0.0324, 0.0325]")
    assert "6.4e-08 m³ count twice" in said
    assert "nothing joins the " in said
    middle = np.abs(outer[0][outer[1]].mean(axis=1) - 0.03).max(axis=1) < 0.01
    assert told(*together((outer[0], outer[1][~middle]), moved(inner, 0.0283, 0.0284, 0.0285))) == []


def bent(turn):
    """A bar bent around a circle, of which the ends share no nodes."""
    points, cells = box_arrays((1.0, 0.1, 0.1), (24, 2, 2))
    angle, radius = turn * points[:, 0], 1 + points[:, 1]
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), points[:, 2]], axis=1), cells


def test_body_that_overlaps_or_touches_itself_is_told():
    assert told(*bent(2 * np.pi - 0.2)) == []
    (said,) = told(*bent(2 * np.pi))
    assert said.startswith(
        "18 nodes lie on cells that they do not belong to, 18 of them on other nodes, between [1.0, "
    )
    (said,) = told(*bent(2 * np.pi + 0.2))
    assert said.startswith("cells of the body overlap between")


@pytest.mark.parametrize(("gap", "is_told"), [(0.0, True), (1e-9, True), (1e-5, False)])
def test_parts_that_touch_are_told_and_a_gap_is_none_of_our_business(gap, is_told):
    box = box_arrays(HALF, BRICKS)
    said = told(*together(box, moved(box, 0, 0, 0.006 + gap)))
    assert len(said) == is_told
    if is_told:  # 9 x 4 of each
        assert said[0].startswith(
            "72 nodes lie on cells that they do not belong to, 72 of them on other nodes, between [0.0, "
        )
        assert said[0].endswith("fenics-rom mesh body.msh -o JOINED.msh --glue makes one of those in one place")


def test_nodes_on_faces_of_others_cannot_be_glued():
    (said,) = told(*together(box_arrays(HALF, (8, 3, 2)), moved(box_arrays(HALF, (5, 2, 2)), 0, 0, 0.006)))
    assert said.startswith("54 nodes lie on cells that they do not belong to, 8 of them on other nodes")
    assert "BooleanFragments" in said


def test_parts_that_share_nodes_alone_are_told():
    points, cells = box_arrays((0.02, 0.02, 0.01), (2, 2, 1))
    corner = points[cells].mean(axis=1)
    apart = cells[(corner[:, 0] < 0.01) == (corner[:, 1] < 0.01)]
    (said,) = told(points, apart)
    assert said.startswith(
        "2 parts of the body have 2 nodes in common, between [0.01, 0.01, 0.0] and [0.01, 0.01, 0.01]"
    )


@pytest.mark.ranks
def test_two_ranks_say_what_one_says(tmp_path):
    box = box_arrays(HALF, BRICKS)
    file = write_arrays(tmp_path / "two.msh", *together(box, moved(box, 0, 0.008, 0.003)))
    (said,) = assembled(file).warnings
    (tmp_path / "scene.toml").write_text(scene_text(file, reduction="order = 4"))
    run = run_ranks(2, "-m", "fenics_rom", "reduce", "scene.toml", "-o", "rom.h5", cwd=tmp_path)
    assert run.stdout.count(said) == 1, run.stderr


# Gluing


@pytest.fixture(scope="module")
def halves():
    """Two boxes of the same bricks on one another."""
    box = box_arrays(HALF, BRICKS)
    return together(box, moved(box, 0, 0, HALF[2] + 1e-9))


def groups_of(points, cells):
    upper = points[cells].mean(axis=1)[:, 2] > HALF[2]
    middle = moved(box_arrays(HALF, BRICKS), 0, 0, 0)
    interface = {"between": box_surfaces(*middle)["top"]}
    return box_surfaces(points, cells) | interface, {"lower": np.flatnonzero(~upper), "upper": np.flatnonzero(upper)}


def test_glued_halves_are_the_whole_beam(halves, tmp_path, monkeypatch, capsys):
    """To round-off of the places, which are 1e-9 m apart."""
    monkeypatch.chdir(tmp_path)
    surfaces, regions = groups_of(*halves)
    write_arrays(tmp_path / "halves.msh", *halves, surfaces, regions)
    with pytest.raises(SystemExit) as ended:
        main(["mesh", "halves.msh", "-o", "beam.msh", "--glue"])
    assert ended.value.code == 0
    printed = capsys.readouterr().out
    assert "36 of 216 merged with others; 48 triangles of 'between' are inside the body now" in printed
    assert "warning" not in printed
    beam = read_mesh(tmp_path / "beam.msh", {})
    assert beam.notes == ()
    assert {name: len(rows) for name, rows in beam.regions.items()} == {"lower": 288, "upper": 288}
    assert {name: len(rows) for name, rows in beam.surfaces.items()} == {
        name: len(rows) for name, rows in surfaces.items()
    }
    whole = write_arrays(tmp_path / "whole.msh", *box_arrays((*HALF[:2], 2 * HALF[2]), (*BRICKS[:2], 2 * BRICKS[2])))
    one, other = assembled(tmp_path / "beam.msh", **HANGING), assembled(whole, **HANGING)
    for mine, its in zip(in_order_of_place(one), in_order_of_place(other), strict=True):
        assert np.abs(mine - its).max() <= 1e-5 * np.abs(its).max()
    assert first_frequency(one) == pytest.approx(first_frequency(other), rel=1e-5)
    apart = assembled(tmp_path / "halves.msh", **HANGING | {"supports": 'clamped = ["left"]'})
    assert first_frequency(apart) < 0.8 * first_frequency(other)
    assert "--glue" in apart.warnings[0]


def test_numbers_of_groups_without_names_are_kept(halves, tmp_path):
    """So that what a scene calls them stays right."""
    surfaces, regions = groups_of(*halves)
    kept = {"left": surfaces["left"], "right": surfaces["right"]}, {"soft": regions["lower"], "hard": regions["upper"]}
    write_vtu(tmp_path / "halves.vtu", *halves, *kept)
    glued = glue_mesh(tmp_path / "halves.vtu", tmp_path / "beam.msh", tolerance=1e-8, scale=2.0)
    assert (glued.merged, glued.nodes, glued.unmatched, glued.inside) == (36, 216, 0, {})
    beam = read_mesh(tmp_path / "beam.msh", GROUPS)
    np.testing.assert_array_equal(np.ptp(beam.points, axis=0)[:2], [0.16, 0.032])
    for name, rows in (kept[0] | kept[1]).items():
        assert len((beam.surfaces | beam.regions)[name]) == len(rows)
    assert signed_volumes(beam.points, beam.cells)[beam.region("hard")].sum() == pytest.approx(
        8 * np.prod(HALF), rel=1e-6
    )


def test_what_gluing_cannot_do_is_told(halves, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    file, output = write_arrays(tmp_path / "halves.msh", *halves), tmp_path / "beam.msh"
    with pytest.raises(
        MeshError, match=r"0.01 m merges the ends of edges of cells, the shortest of which is 0.003 m long"
    ):
        glue_mesh(file, output, tolerance=0.01)
    assert glue_mesh(file, output, tolerance=0.0).merged == 0
    low = box_arrays(HALF, BRICKS)
    mirrored = low[0] * [1, -1, 1] + [0, HALF[1], HALF[2]], low[1]  # diagonals cross those below
    write_arrays(file, *together(low, mirrored))
    glued = glue_mesh(file, output)
    assert (glued.merged, glued.unmatched) == (36, 96)
    assert glued.mesh.notes[-1].startswith("2 parts of the body have 36 nodes in common")
    for words, said in (
        (
            ["halves.msh", "--size", "1", "--glue"],
            "--size is of what is filled; the cells of a mesh stay as they are: leave it out",
        ),
        (["halves.msh"], "what is filled ends in .stl, .step, .stp; a mesh is taken with --glue"),
        (["part.step", "--size", "1", "--glue", "1e-3"], "use --glue without a number"),
        (["--glue", "halves.msh"], "'halves.msh': use a finite number >= 0, or none where --glue stands last"),
        (["halves.msh", "--glue", "-1"], "'-1': use a finite number >= 0"),
    ):
        with pytest.raises(SystemExit) as ended:
            main(["mesh", *words, "-o", "out.msh"])
        assert ended.value.code == 2
        assert said in capsys.readouterr().err


def test_solids_of_step_files_share_nodes_where_they_are_glued(tmp_path):
    def solids():
        for z in (0, 6):
            gmsh.model.occ.addBox(0, 0, z, 20, 16, 6)  # mm
        gmsh.model.occ.addBox(10, 4, 4, 20, 8, 4)  # into both
        gmsh.model.occ.synchronize()

    write_gmsh(tmp_path / "part.step", solids)
    apart = fill_surface(tmp_path / "part.step", tmp_path / "part.msh", 5e-3)
    assert apart.notes[0].startswith("3 parts of the body overlap")
    glued = fill_surface(tmp_path / "part.step", tmp_path / "part.msh", 5e-3, glue=True)
    assert glued.notes == ()
    assert faces_of(glued.points, glued.cells).parts()[0] == 1
    assert signed_volumes(glued.points, glued.cells).sum() == pytest.approx(20 * 16 * 12e-9 + 10 * 8 * 4e-9, rel=1e-9)
