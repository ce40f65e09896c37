"""Files of marker data: what is read, and what is refused, with file, line and column."""

import numpy as np
import pytest
from bodies import scene_text
from measuring import POINTS, RUN

from fenics_rom.errors import DataError
from fenics_rom.identification.marker_data import Equilibria, Marker, Motion, read_markers
from fenics_rom.scene.file import parse_scene

CONTACTS = """
[contacts.right]
surface = "right"
[contacts.air]
surface = "top"
force = "normal"
[contacts.skin]
surface = "top"
force = "nodal"
"""
SCENE = parse_scene(scene_text("none.msh", contacts=CONTACTS, run=RUN, **POINTS))
STILL = parse_scene(scene_text("none.msh", contacts=CONTACTS, **POINTS))


def read(tmp_path, text, scene=SCENE):
    file = tmp_path / "markers.csv"
    file.write_text(text)
    return read_markers(file, scene)


def test_a_motion_is_read_in_si_units(tmp_path):
    found = read(tmp_path, "time (ms),tip[1].z (mm), side.x (cm)\n\n10,1.5,\n 20 ,,2\n")
    assert isinstance(found, Motion)
    np.testing.assert_allclose(found.times, [0.01, 0.02], rtol=1e-15)
    np.testing.assert_allclose(found.measured, [[1.5e-3, np.nan], [np.nan, 0.02]], rtol=1e-15)
    assert found.markers == (Marker("tip", 1, 2), Marker("side", 0, 0))
    assert found.lines.tolist() == [3, 4]
    assert found.columns == ("tip[1].z", "side.x")


def test_equilibria_are_read_with_the_forces_of_each_contact_mode(tmp_path):
    found = read(
        tmp_path,
        "contact,force.z (N),force.x (N),force.normal (N),tip[0].y (m)\nright,3,,,0.1\nair,,,5,0.2\nright,1,2,,\n",
    )
    assert isinstance(found, Equilibria)
    assert found.contacts == ("right", "air", "right")
    assert [force.tolist() for force in found.forces] == [[0, 0, 3], [5], [2, 0, 1]]
    np.testing.assert_array_equal(found.measured, [[0.1], [0.2], [np.nan]])


TIMES = "time (s),side.x (m)\n"
FORCES = "contact,force.x (N),side.x (m)\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "at least one line of data"),
        (TIMES, "at least one line of data"),
        ("side.x (m),time (s)\n1,1\n", "line 1, column 'side.x (m)': the first column must be one of 'time (s)'"),
        ("times (s),side.x (m)\n1,1\n", "column 'times (s)': the first column must"),
        ("time,side.x (m)\n1,1\n", "column 'time': no unit; use a name and one of (s), (ms)"),
        ("time (h),side.x (m)\n1,1\n", "unit 'h'; use a name and one of (s), (ms)"),
        ("time (s),side.x (inch)\n0.1,1\n", "unit 'inch'; use a name and one of (m), (cm), (mm)"),
        ("time (s),side.x\n0.1,1\n", "column 'side.x': no unit"),
        ("time (s)\n0.1\n", "no marker was given"),
        ("time (s),side (m)\n0.1,1\n", "column 'side (m)': use 'NAME.x (m)'"),
        ("time (s),side.w (m)\n0.1,1\n", "use 'NAME.x (m)'"),
        ("time (s),sid.x (m)\n0.1,1\n", "no output 'sid'; there is side, tip; did you mean 'side'?"),
        ("time (s),tip.x (m)\n0.1,1\n", "output 'tip' has 2 points; use tip[0] to tip[1]"),
        ("time (s),tip[2].x (m)\n0.1,1\n", "output 'tip' has no point [2]; use [0] to [1]"),
        ("time (s),side.x (m),side.x (m)\n0.1,1,1\n", "line 1: column 'side.x (m)' is there twice"),
        ("time (s),side.x (m),side[0].x (mm)\n0.1,1,1\n", "is the same marker as 'side.x (m)'"),
        (TIMES + "0.1,1,1\n", "line 2: has 3 cells; use 2"),
        (TIMES + "0.1,1\n\n0.2,one\n", "line 4, column 'side.x (m)': 'one' was given; use a finite number, or"),
        (TIMES + "0.1,inf\n", "'inf' was given"),
        (TIMES + "0.1,nan\n", "'nan' was given"),
        (TIMES + ",1\n", "line 2, column 'time (s)': '' was given; use a finite number"),
        (TIMES + "-0.1,1\n", "has times before 0 alone"),
        (TIMES + "-0.1,\n0.1,1\n", "'side.x' was not seen before 0 s"),
        (TIMES + "0.7,1\n", "0.7 s was given; use up to the run's end, 0.6 s"),
        (TIMES + "0.2,1\n0.2,1\n", "line 3, column 'time (s)': 0.2 s follows 0.2 s; use times that increase"),
        ("contact,side.x (m)\nright,1\n", "line 1: no force was given"),
        ("contact,force.w (N),side.x (m)\nright,1,1\n", "column 'force.w (N)': use force.x, force.y"),
        ("contact,force.x (lb),side.x (m)\nright,1,1\n", "unit 'lb'; use a name and one of (N)"),
        (FORCES + "left,1,1\n", "line 2, column 'contact': no contact mode 'left'; there is"),
        (FORCES + "skin,1,1\n", "'skin' has a force at every node; use 'resultant' and 'normal'"),
        (FORCES + "right,,1\n", "column 'force.x (N)': no force was given; contact mode 'right' has force.x"),
        (FORCES + "air,1,1\n", "contact mode 'air' has force.normal; leave this cell empty"),
    ],
)
def test_what_cannot_be_used_is_refused_with_its_place(tmp_path, text, said):
    with pytest.raises(DataError) as error:
        read(tmp_path, text)
    assert said in str(error.value)
    assert str(error.value).startswith(str(tmp_path / "markers.csv"))


def test_a_file_that_is_not_there_or_not_text_is_refused(tmp_path):
    with pytest.raises(DataError, match=r"none\.csv: cannot be read: No such file"):
        read_markers(tmp_path / "none.csv", SCENE)
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(DataError, match=r"binary\.csv: is no text in UTF-8"):
        read_markers(tmp_path / "binary.csv", SCENE)


def test_times_without_a_run_are_refused(tmp_path):
    with pytest.raises(DataError, match=r"has times, but scene has no \[run\]"):
        read(tmp_path, TIMES + "0.1,1\n", STILL)
