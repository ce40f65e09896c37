"""Abaqus' input files as programs write them: commas, gaps, sets, assemblies; and what is refused by name."""

import re

import numpy as np
import pytest

from fenics_rom.errors import MeshError
from fenics_rom.fem.abaqus_file import AbaqusFile
from fenics_rom.fem.mesh import read_mesh

CORNERS = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]]
MIDDLES = [[0.5, 0, 0], [0.5, 0.5, 0], [0, 0.5, 0], [0, 0, 0.5], [0.5, 0, 0.5], [0, 0.5, 0.5]]
MIDDLES += [[0.5, 0.5, 1], [1, 0.5, 0.5], [0.5, 1, 0.5]]
NODES = "*Node\n1, 0, 0, 0\n2, 1, 0, 0\n3, 0, 1, 0\n4, 0, 0, 1\n5, 1, 1, 1\n"
CELLS = "*Element, type=C3D4, elset=body\n1, 1, 2, 3, 4\n2, 2, 3, 4, 5\n"


def read(tmp_path, text):
    (tmp_path / "body.inp").write_text(text)
    return read_mesh(tmp_path / "body.inp", {})


@pytest.mark.parametrize(
    ("nodes", "cells"),
    [
        (NODES, CELLS),
        (NODES, CELLS.replace("4\n2", "4,\n2").replace("5\n", "5,\n")),  # CalculiX' own
        (NODES.replace("0\n", "0,\n"), CELLS),
        (NODES.replace("1, 0, 0, 0", "1").replace("2, 1, 0, 0", "2, 1.").replace("3, 0, 1, 0", "3, , 1,"), CELLS),
        (NODES.replace("1, 1, 1", "1.0D0, +1.E0 ,\t1d0, 9, 9, 9"), CELLS.replace("1, 1, 2, 3, 4", "1, 1,2,\n 3,\n4")),
        ("\n** by hand\n*NODE ,NSET = all,\n" + NODES[6:], "** more\n\n" + CELLS.replace("C3D4,", "c3d4,\n\n  ")),
        (NODES.replace("\n", "\r\n"), CELLS.replace("\n", "\r\n")),
        (NODES + "*Nset, nset=all, generate\n1, 5, 1,\n1, 5,\n", CELLS + "*Elset, elset=both, generate\n1, 2,\n"),
    ],
)
def test_layout_of_lines_does_not_matter(tmp_path, nodes, cells):
    mesh = read(tmp_path, nodes + cells)
    np.testing.assert_array_equal(mesh.points, CORNERS)
    np.testing.assert_array_equal(np.sort(mesh.cells, axis=1), [[0, 1, 2, 3], [1, 2, 3, 4]])
    np.testing.assert_array_equal(mesh.region("body"), [0, 1])
    assert mesh.notes == ()


def test_cells_of_ten_nodes_go_on_after_a_comma_and_may_end_with_one(tmp_path):
    places = "".join(f"{k}, {x}, {y}, {z}\n" for k, (x, y, z) in enumerate(CORNERS[:4] + MIDDLES[:6], 1))
    places += "".join(f"{k}, {x}, {y}, {z}\n" for k, (x, y, z) in enumerate([CORNERS[4], *MIDDLES[6:]], 11))
    cells = "1, 1, 2, 3, 4, 5, 6, 7, 8, 9,\n10,\n2, 2, 3, 4, 11, 6, 10, 9, 13, 14,\n12,\n"
    mesh = read(tmp_path, f"*NODE, NSET=ALL\n{places}*ELEMENT, TYPE=C3D10, ELSET=BODY\n{cells}")
    assert (len(mesh.points), len(mesh.cells)) == (14, 2)
    assert mesh.bend == 0
    assert mesh.notes == ()


def test_what_is_defined_twice_is_told_and_the_last_counts(tmp_path):
    mesh = read(tmp_path, NODES + "5, 2, 2, 2\n1, 0, 0, 0\n" + CELLS + "2, 2, 4, 3, 5\n")
    np.testing.assert_array_equal(mesh.points[4], [2, 2, 2])
    assert mesh.notes == (
        "1 nodes are defined twice, not alike, e.g. node 5: the last definition counts",
        "1 elements are defined twice, not alike, e.g. element 2: the last definition counts",
    )


def test_elements_of_no_body_are_told(tmp_path):
    mesh = read(tmp_path, NODES + CELLS + "*Element, type=T3D2\n7, 1, 2,\n8, 2, 3,\n*Element, type=MASS\n9, 1\n")
    assert mesh.notes == ("elements that are neither solids nor triangles were left out: 2 T3D2, 1 MASS",)


ASSEMBLY = (
    "*Part, name=P\n" + NODES + CELLS + "*End Part\n*Assembly, name=A\n*Instance, name=P-1, part=P\n*End Instance\n"
    "*Node\n1, 9, 9, 9\n*Nset, nset=reference\n1,\n*Nset, nset=low, instance=P-1\n1, 2, 3\n"
    "*Nset, nset=again\nP-1.1, p-1.2, low\n*Elset, elset=second, instance=P-1\n2,\n"
    "*Surface, type=ELEMENT, name=far\nsecond, S2\n*Surface, type=NODE, name=foot\nlow,\n*End Assembly\n"
)


def test_numbers_of_an_assembly_are_not_those_of_the_part(tmp_path):
    """Abaqus/CAE numbers reference points from 1, as it does the nodes of the part."""
    mesh = read(tmp_path, ASSEMBLY)
    np.testing.assert_array_equal(mesh.points, CORNERS)
    assert {name: len(triangles) for name, triangles in mesh.surfaces.items()} == {
        "low": 1,
        "again": 1,
        "foot": 1,
        "far": 1,
    }
    assert "reference" in AbaqusFile(tmp_path / "body.inp").node_sets
    np.testing.assert_array_equal(mesh.region("second"), [1])
    assert mesh.notes == ()


def test_set_of_the_nodes_of_elements(tmp_path):
    mesh = read(tmp_path, NODES + CELLS + "*Elset, elset=one\n1\n*Nset, nset=around, elset=ONE\n")
    np.testing.assert_array_equal(np.unique(mesh.surface("around")), [0, 1, 2, 3])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("*Ngen, nset=a\n1, 5\n", r"line 1: .*\*Ngen is not read; write the nodes out"),
        ("*NFILL\n", r"\*Nfill is not read"),
        ("*Elgen, elset=a\n", r"\*Elgen is not read; write the elements out"),
        ("*SYSTEM\n0, 0, 0\n", r"\*System is not read; write coordinates in the global system"),
        ("*Node, system=C\n1, 1, 90, 0\n", r"\*Node, system=C is not read; write coordinates in the global"),
        ("*Include, input=other.inp\n", r"\*Include is not read; put all into one file"),
        ("*Node, input=nodes.txt\n", r"\*Node, input=nodes.txt is not read; put all into one file"),
        ("*Instance, name=a\n*End Instance\n*Instance, name=b\n", "line 3: .*several instances"),
        ("*Element, elset=a\n1, 2\n", r"\*Element has no type="),
        ("*Elset\n1, 2\n", r"\*Elset has no elset="),
        ("*Elset, elset=a\nnone\n", "line 2: .*no set 'none'; there is none"),
        ("*Elset, elset=a, generate\n5\n", r"line 2: .*first, last and perhaps a step > 0"),
        ("*Elset, elset=a, generate\n1, 5, 0\n", r"line 2: .*first, last and perhaps a step > 0"),
        ("*Nset, nset=a, generate\n1, 1000000000\n", "1000000000 numbers are generated; use at most 10000000"),
        (
            NODES + "*Element, type=C3D4\n1, 1, 2,\n*Nset, nset=a\n1\n",
            "line 8: .*element 1 has 2 nodes, and none follow",
        ),
        (NODES + "*Element, type=C3D4\n1, 1, 2,\n", "line 8: .*element 1 has 2 nodes, and none follow"),
        (NODES + "*Element, type=C3D4\n1, 1, 2, 3, 4, 5\n", "element 1 of type C3D4 has 5 nodes; it must have 4"),
        ("*Node\n1 0. 0. 0.\n", "line 2: .*'1 0. 0. 0.' is no whole number; numbers are apart by commas"),
        (NODES + CELLS.replace("4, 5", "4, 7"), "names nodes .*: 1 of 2 elements do, e.g. element 2 names node 7"),
        (NODES + CELLS + "*Surface, name=s\nbody, SPOS\n", "surface 's' is of face 'SPOS'; use one of S1, S2, S3, S4"),
        (NODES + CELLS + "*Surface, name=s\nbody,\n", "line 11: .*values are missing"),
    ],
)
def test_what_is_not_read_is_refused_by_name(tmp_path, text, said):
    with pytest.raises(MeshError, match=said) as caught:
        read(tmp_path, text)
    assert "\n" not in str(caught.value)


WHOLE = NODES + "*Nset, nset=low\n1, 2, 3\n" + CELLS
PART = f"*Part, name=P\n{WHOLE}*Elset, elset=end\n2,\n*Surface, name=top\n2, S2\n*End Part\n"
STEP = "*Step\n*Static\n*End Step\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (WHOLE, None),
        (WHOLE[:-1], None),  # a last line without an end is whole
        (PART + STEP, None),
        (ASSEMBLY + STEP, None),
        (PART.partition("2, 2, 3")[0], r"\*Part has no \*End Part: the body is of the 5 nodes and 1 tetrahedra"),
        (PART + STEP[:-10], r"\*Step has no \*End Step"),
        (PART.replace("2, 2, 3, 4, 5\n", ""), "sets name 1 elements that are not there, e.g. element 2 in 'top'"),
        (WHOLE.replace("1, 2, 3\n", "1, 2, 3, 6, 7\n"), "sets name 2 nodes that are not there, e.g. node 6 in 'low'"),
        (CELLS + NODES[:-4], r"its last line, '5, 1, 1', has no end and fewer values than the one before"),
    ],
)
def test_a_file_that_is_cut_is_told_where_it_shows(tmp_path, text, said):
    (tmp_path / "body.inp").write_text(text)
    (note,) = AbaqusFile(tmp_path / "body.inp").notes or ("",)
    assert re.search(said, note) if said else not note
