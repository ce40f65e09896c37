"""Scenes: what reads, and what every mistake is told."""

import re
from dataclasses import FrozenInstanceError

import numpy as np
import pytest
from bodies import PLATE
from hypothesis import given, settings
from hypothesis import strategies as st

import fenics_rom as fr
from fenics_rom.errors import SceneError
from fenics_rom.mechanics.environment import SWITCHINGS, AppliedLoad
from fenics_rom.mechanics.signals import Signal
from fenics_rom.scene.effects import Damping, Effects, Inertia
from fenics_rom.scene.file import LONGEST, parse_scene
from fenics_rom.scene.places import Near, Place
from fenics_rom.scene.scene import LYAPUNOV, METHODS, Material

TEXT = PLATE.read_text()
MATERIAL = TEXT[TEXT.index("[material]") : TEXT.index("[supports]")]
CONTACTS = TEXT[TEXT.index("[contacts.tip_left]") : TEXT.index("[outputs.tip]")]
TABLE = 'table = "force.csv"'
FORCE = "force = [0.0, 0.0, 0.5]"


def parse(text, **options):
    return parse_scene(text, folder=PLATE.parent, source="plate.toml", **options)


def changed(*changes):
    """The plate's scene with pieces of text replaced."""
    text = TEXT
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return text


def another_load(line):
    return TEXT + f"\n[[run.load]]\n{line}\nforce = [1.0, 0.0, 0.0]\n"


def test_plate_reads():
    scene = fr.read_scene(PLATE)
    assert scene.mesh_file.is_file()
    assert scene.degree == 1
    assert scene.materials == {"material": Material(young=1e6, poisson=0.49, density=2300.0)}
    assert scene.clamped == (Place("root"),)
    assert list(scene.contacts) == ["tip_left", "middle"]  # the order of the file
    assert scene.outputs["tip"].points == ((0.5, 0.2, 0.01), (0.5, 0.0, 0.01))
    assert scene.effects == Effects(inertia=Inertia(), damping=Damping(alpha=0.5, beta=1e-3))
    assert scene.reduction.order == {"tip_left": 52, "middle": 67}
    assert (scene.run.dt, scene.run.duration, scene.run.snapshots) == (1e-3, 3.0, 100)
    (load,) = scene.run.loads
    assert load == AppliedLoad("tip_left", None, 0.0, 0.5, Signal(np.array([0.0, 0.0, 0.5])))
    assert scene.text == TEXT


def test_scene_cannot_be_changed():
    with pytest.raises(FrozenInstanceError):
        fr.read_scene(PLATE).degree = 2


def test_what_is_not_named_is_absent():
    scene = parse(changed(("damping = { alpha = 0.5, beta = 1e-3 }", ""), (TEXT[TEXT.index("[run]") :], "")))
    assert scene.effects.names == ("inertia",)
    assert scene.run is None
    assert scene.tables == {}


@pytest.mark.parametrize(("key", "choices"), [("method", METHODS), ("lyapunov", LYAPUNOV), ("switching", SWITCHINGS)])
def test_every_choice_of_a_reduction_reads(key, choices):
    for choice in choices:
        reduction = parse(changed(("[reduction]", f'[reduction]\n{key} = "{choice}"'))).reduction
        assert getattr(reduction, key) == choice


def test_several_materials_ball_contacts_and_one_order_for_all_read():
    rubber = '[materials.rubber]\ncells = "core"\nyoung = 1\npoisson = 0\ndensity = 1\n'
    scene = parse(
        changed(
            (MATERIAL, rubber),
            ('surface = "middle"', "near = {point = [0, 0.1, 0], radius = 1}"),
            ("{ tip_left = 52, middle = 67 }", "7"),
        )
    )
    assert scene.materials == {"rubber": Material(young=1.0, poisson=0.0, density=1.0, cells="core")}
    assert scene.contacts["middle"].near == Near(point=(0.0, 0.1, 0.0), radius=1.0)
    assert scene.reduction.order == 7


def test_loads_are_put_in_order_of_start():
    last, middle = 'contact = "middle"\nstart = 1.0', 'contact = "tip_left"\nstart = 0.6\nstop = 0.9'
    scene = parse(another_load(last) + f"[[run.load]]\n{middle}\n{FORCE}\n")
    assert [load.start for load in scene.run.loads] == [0.0, 0.6, 1.0]
    assert scene.run.loads[-1].stop == 3.0  # to the end where it does not say


@pytest.mark.parametrize("beginning", ["\ufeff", "\r\n"], ids=["byte order mark", "Windows lines"])
def test_files_of_windows_editors_read(tmp_path, beginning):
    file = tmp_path / "scene.toml"
    file.write_bytes((beginning + TEXT.replace("\n", "\r\n")).encode())
    assert fr.read_scene(file).name == "plate"


# What stands in the plate's scene | what stands there instead (⏎ is a new line) | what the error says of it
MISTAKES = """
0.49 | 0.5 | material.poisson = 0.5: use a finite number > -1 and < 0.5
0.49 | 0.6 | material.poisson = 0.6: use a finite number > -1 and < 0.5
2300.0 | -2300.0 | material.density = -2300.0: use a finite number > 0, in kg/m3
1.0e6 | 0 | material.young = 0: use a finite number > 0, in Pa
1.0e6 | nan | material.young = nan: use a finite number > 0, in Pa
1.0e6 | inf | material.young = inf: use a finite number > 0, in Pa
1.0e6 | true | material.young = True: use a finite number > 0, in Pa
1.0e6 | "1 MPa" | material.young = '1 MPa': use a finite number > 0, in Pa
density = 2300.0 | | material: density is missing
[supports] | [materials]⏎[supports] | give either [material] or [materials.NAME]
[supports] | [suports] | no key 'suports'; there is actuators, contacts, effects, frame, material, materials, mesh,
[supports] | [suports] | did you mean 'supports'?
young | yuong | material: no key 'yuong'; there is density, expansion, fibres, poisson, young; did you mean 'young'?
surface = "middle" | surfac = "m" | contacts.middle: no key 'surfac'; there is all, along, any, box, facing, force
stop = 0.5 | end = 0.5 | run.load[0]: no key 'end'; there is actuator, contact, force, start, stop, table
alpha = 0.5 | alpa = 0.5 | effects.damping: no key 'alpa'; there is alpha, beta, dashpots, materials; did
inertia = {} | inertia = {}⏎wind = {} | effects: no key 'wind'; there is base_motion, base_path, cables, contact
inertia = {} | inertia = {mass = 1} | effects.inertia: no key 'mass'; there is none
inertia = {} | | effects.damping: means nothing without inertia; name effects.inertia as well
inertia = {} | inertia = true | effects.inertia = True: use a table
alpha = 0.5 | alpha = -0.5 | effects.damping.alpha = -0.5: use a finite number >= 0, in 1/s
[reduction] | [reduction]⏎share = 0.9 | reduction.share: goes with method = 'eigenvector-selection'
[reduction] | [reduction]⏎cubature = 0.1 | reduction.cubature: goes with effects.large_deformation
name = "plate" | name = {} | name = {}: use a non-empty string
name = "plate" | name = "" | name = '': use a non-empty string
[mesh]⏎file = "../../meshes/plate.msh" | | mesh is missing
file = "../../meshes/plate.msh" | | mesh: file is missing
[mesh] | [mesh]⏎degree = 3 | mesh.degree = 3: use a whole number >= 1 and <= 2
[mesh] | [mesh]⏎degree = 1.0 | mesh.degree = 1.0: use a whole number >= 1 and <= 2
surface = "middle" | | contacts.middle: give exactly one of surface, near
surface = "middle" | surface = "m"⏎near = {point = [0, 0, 0], radius = 1} | together (got surface, near)
surface = "middle" | near = {point = [0, 0, 0]} | contacts.middle.near: radius is missing
surface = "middle" | near = {point = [0, 0, 0], radius = 0} | contacts.middle.near.radius = 0: use
surface = "middle" | near = {point = [0, 0], radius = 1} | near.point is a list of 2: use a list of 3
surface = "middle"⏎force = "resultant" | force = "x" | force: no choice 'x'; there is nodal, normal, resultant, wrench
[contacts.middle] | [contacts."mid/dle"] | contacts: name 'mid/dle': use letters, digits, _ and -, at most 100
[outputs.tip] | [outputs.".."] | outputs: name '..': use letters, digits, _ and -, at most 100
points = [[0.5, 0.2, 0.01], [0.5, 0.0, 0.01]] | | outputs.tip: give exactly one of points, markers, surface
[[0.5, 0.2, 0.01], [0.5, 0.0, 0.01]] | [] | outputs.tip.points is a list of 0: use a list of at least 1
[[0.5, 0.2, 0.01], [0.5, 0.0, 0.01]] | [1] | points[0] = 1: use a list of 3, each a finite number, in m
[reduction] | [reduction]⏎tolerance = 1e-3 | reduction: give order or tolerance, not both
, middle = 67 | | reduction.order: contact mode 'middle' has no order
middle = 67 | midle = 67 | reduction.order: no contact mode 'midle'; there is middle, tip_left; did you mean 'middle'?
middle = 67 | middle = 0 | reduction.order.middle = 0: use a whole number >= 1
{ tip_left = 52, middle = 67 } | 2.5 | reduction.order = 2.5: use a whole number >= 1, or a table
order = { tip_left = 52, middle = 67 } | tolerance = 1 | reduction.tolerance = 1: use a finite number > 0
[reduction] | [reduction]⏎switching = "enrgy" | there is energy, oblique; did you mean 'energy'?
[reduction] | [reduction]⏎method = "podd" | no choice 'podd'; there is balanced, eigenvector-selection, modal,
[reduction] | [reduction]⏎lyapunov = "ad" | no choice 'ad'; there is adi, auto, bartels-stewart, closed-form, krylov
dt = 1e-3 | dt = 0 | run.dt = 0: use a finite number > 0, in s
dt = 1e-3 | dt = 4 | run.dt = 4: use at most the duration, 3 s
[run] | [run]⏎snapshots = 0 | run.snapshots = 0: use a whole number >= 1
[[run.load]] | [run.load] | run.load = {'contact': 'tip_left', 'start': 0.0, 'stop': 0.5,
[[run.load]] | [run.load] | use a list, each a table
start = 0.0 | start = 1.0 | run.load[0].stop = 0.5: use more than start, 1 s
start = 0.0⏎stop = 0.5 | start = 500 | run.load[0].start = 500: use less than the run's duration, 3 s
start = 0.0 | start = -1.0 | run.load[0].start = -1.0: use a finite number >= 0, in s
contact = "tip_left" | contact = "tip_lft" | run.load[0].contact: no contact mode 'tip_lft'; there is middle, tip_left;
contact = "tip_left" | actuator = "tendon" | run.load[0].actuator: no actuator 'tendon'; there is none
contact = "tip_left" | | run.load[0]: give exactly one of contact, actuator (got none)
force = [0.0, 0.0, 0.5] | | run.load[0]: give exactly one of force, table (got none)
stop = 0.5 | table = "force.csv" | run.load[0]: give exactly one of force, table (got force, table)
force = [0.0, 0.0, 0.5] | force = [] | run.load[0].force is a list of 0: use a list of at least 1
force = [0.0, 0.0, 0.5] | force = 1 | force = 1: use a list of at least 1, each a finite number, in N
force = [0.0, 0.0, 0.5] | force = [0, nan, 0] | run.load[0].force[1] = nan: use a finite number, in N
force = [0.0, 0.0, 0.5] | table = "force.csv" | force.csv: cannot be read: No such file or directory
[mesh] | [mesh | is not TOML: Expected ']' at the end of a table declaration (at line 4, column 6)
[reduction] | [effects.large_deformation]⏎material = "yeoh"⏎[reduction] | large_deformation.constants: yeoh has
poisson = 0.49 | young = 2 | is not TOML: Cannot overwrite a value (at line 9
"""


def told(text):
    """What is said of a scene's mistake; in any case in one line of a terminal's size, after the file's name."""
    with pytest.raises(SceneError) as caught:
        parse(text)
    message = str(caught.value)
    assert message.startswith("plate.toml: ")
    assert "\n" not in message
    assert len(message) < 300
    return message


@pytest.mark.parametrize(
    ("there", "instead", "said"), [[part.strip() for part in line.split("|")] for line in MISTAKES.split("\n")[1:-1]]
)
def test_mistake_is_told_with_what_is_allowed(there, instead, said):
    assert said in told(changed((there.replace("⏎", "\n"), instead.replace("⏎", "\n"))))


@pytest.mark.parametrize(
    ("there", "instead", "said"),
    [
        (MATERIAL, "", "give either [material] or [materials.NAME]"),
        (MATERIAL, "[materials]\n", "materials: at least one [materials.NAME] is needed"),
        (CONTACTS, "[contacts]\n", "contacts: at least one contact mode is needed"),
        ("[outputs.tip]", f"[outputs.{101 * 'x'}]", "use letters, digits, _ and -, at most 100"),
        ('name = "plate"', f"name = {10_000 * '['}", "nested too deeply"),
        ("1.0e6", "1" + 400 * "0", "...: use a finite number"),  # more than floating point can hold
        ("1.0e6", "1" + 5000 * "0", "is not TOML"),  # more than Python reads
        ("1.0e6", "0x1" + 9999 * "0", "a number with thousands of digits: use"),  # more than Python prints
        ("[run]", "[run]\nsnapshots = 1" + 400 * "0", "...: use a whole number >= 1"),
        ("[mesh]", f"#{LONGEST * 'x'}\n[mesh]", "use at most 60000 bytes; long force histories belong in tables"),
    ],
    ids=[
        "no material",
        "no materials",
        "no contacts",
        "name",
        "nesting",
        "1e400",
        "1e5000",
        "16**9999",
        "shapes",
        "text",
    ],
)
def test_what_is_empty_or_beyond_measure_is_told(there, instead, said):
    assert said in told(changed((there, instead)))


@pytest.mark.parametrize(
    "load", ['contact = "middle"\nstart = 0.4', 'contact = "middle"', 'contact = "middle"\nstart = 0.1\nstop = 0.2']
)
def test_two_contact_modes_at_a_time_are_refused(load):
    with pytest.raises(SceneError, match="one contact mode acts at a time; make one of them: "):
        parse(another_load(load))


def test_overlap_hidden_behind_a_short_force_is_found():
    """The long force on the tip still acts when the middle is pushed, though the one before it has ended."""
    text = changed(("stop = 0.5", "stop = 2.0"))
    for contact, start in (("tip_left", 0.1), ("middle", 1.0)):
        text += f'\n[[run.load]]\ncontact = "{contact}"\nstart = {start}\nstop = {start + 0.1}\nforce = [1, 0, 0]\n'
    with pytest.raises(SceneError, match="at 1 s 'tip_left' and 'middle' are pushed at the same time"):
        parse(text)


@pytest.mark.parametrize("load", ['contact = "middle"\nstart = 0.5', 'contact = "tip_left"\nstart = 0.2'])
def test_loads_that_follow_or_share_a_contact_mode_are_allowed(load):
    assert len(parse(another_load(load)).run.loads) == 2


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "use a line that names the columns and at least one line of data"),
        (b"0,0,0,0\n1,0,0,1\n", "line 1: column '0' is there twice"),
        (
            b"0,1,2,3\n1,0,0,1\n",
            "line 1, column '0': its first row must name the columns, time first, such as: time (s)",
        ),
        (b"x,y,z,time\n0,0,0,0\n1,0,0,1\n", "line 1, column 'x': its first row must name the columns, time first"),
        (b"time,x,y,z\n", "use a line that names the columns and at least one line of data"),
        (b"time,x,y,z\n0,0,0,0\n", "use two or more rows"),
        (b"time\n0\n1\n", "use two or more rows, of a time and one number or more"),
        (b"time,x,y,z\n0,0,0,0\n1,0,0\n", "line 3: has 3 cells; use 4, as in line 1"),
        (b"time,x,y,z\n0,0,0,0\n1,0,zero,0\n", "line 3, column 'y': 'zero' was given; use a finite number"),
        (b"time;x;y;z\n0;0;0;0\n1;0;0;0\n", "line 1, column 'time;x;y;z': its first row must name the columns"),
        (b"time,x,y,z\n0,0,0,0\n1,0,nan,0\n", "line 3, column 'y': 'nan' was given; use a finite number"),
        (b"time,x,y,z\n1,0,0,0\n0,0,0,0\n", "strictly increasing times"),
        (b"time,x,y,z\n0,0,0,0\n0,0,0,0\n", "strictly increasing times"),
        (b"time,x,y,z\n\xff\xfe,0,0,0\n", "is no text in UTF-8, at byte"),
        (b'time,x,y,z\n"' + 200_000 * b"x", "cannot be read: field larger"),
        (b"time,x,y,x\n0,0,0,0\n1,0,0,0\n", "line 1: column 'x' is there twice"),
        (b"time,y,x,z\n0,0,0,0\n1,0,0,0\n", "line 1, column 'y': use x, y and z in this order"),
        (b"time,x,y,w\n0,0,0,0\n1,0,0,0\n", "line 1, column 'w': use x, y and z in this order"),
        (b"time,x (mm),y,z\n0,0,0,0\n1,0,0,0\n", "unit 'mm'; use a name and one of (N), (mN), (kN)"),
        (b"time (min),x,y,z\n0,0,0,0\n1,0,0,0\n", "unit 'min'; use a name and one of (s), (ms)"),
        (b"time,displacement.x,y,z\n0,0,0,0\n1,0,0,0\n", "is a displacement; use numbers in N"),
    ],
)
def test_bad_force_table_is_told(tmp_path, content, message):
    (tmp_path / "force.csv").write_bytes(content)
    file = tmp_path / "scene.toml"
    file.write_text(changed((FORCE, TABLE)))
    with pytest.raises(SceneError, match=re.escape(message)) as caught:
        fr.read_scene(file)
    assert str(caught.value).startswith(f"{file}: run.load[0].table: table ")
    assert "force.csv" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("heading", "factors"),
    [
        ("time (ms), x (mN), y (kN), z (N)", (1e-3, 1e-3, 1e3, 1.0)),
        ("Time, Fx, force.y (mN), f_z", (1.0, 1.0, 1e-3, 1.0)),
        ("t(s),x(mN),y(mN),z(mN)", (1.0, 1e-3, 1e-3, 1e-3)),
    ],
)
def test_units_of_a_table_are_obeyed_and_travel_as_si(tmp_path, heading, factors):
    (tmp_path / "force.csv").write_text(f"{heading}\n0,1,2,3\n7,4,5,6\n")
    (tmp_path / "scene.toml").write_text(changed((FORCE, TABLE)))
    scene = fr.read_scene(tmp_path / "scene.toml")
    table = np.array([[0, 1, 2, 3], [7, 4, 5, 6]]) * factors
    np.testing.assert_array_equal(scene.tables["force.csv"], table)
    np.testing.assert_array_equal(scene.run.loads[0].signal.values, table[:, 1:])
    again = parse_scene(scene.text, folder=tmp_path, tables=scene.tables)
    assert again.run.loads == scene.run.loads


@pytest.mark.parametrize(
    ("heading", "expected"),
    [
        ("time,pressure", 5.0),
        ("time,pressure (kPa)", 5e3),
        ("time,p (bar)", 5e5),
        ("time,pressure (N)", "unit 'N'; use a name and one of (Pa), (kPa), (MPa), (bar)"),
        ("time,force", "is a force; use numbers in Pa"),
        ("time,volume", "is a volume; use numbers in Pa"),
    ],
)
def test_table_of_a_pressure_is_in_units_of_pressure(tmp_path, heading, expected):
    (tmp_path / "air.csv").write_text(f"{heading}\n0,5\n1,5\n")
    load = '\n[[run.load]]\nactuator = "air"\ntable = "air.csv"\n'
    text = changed(("[reduction]", '[effects.pressure.air]\nsurface = "middle"\n[reduction]')) + load
    (tmp_path / "scene.toml").write_text(text)
    if isinstance(expected, str):
        with pytest.raises(SceneError, match=re.escape(expected)):
            fr.read_scene(tmp_path / "scene.toml")
    else:
        (air,) = (load for load in fr.read_scene(tmp_path / "scene.toml").run.loads if load.actuator)
        assert air.signal(0.5) == [expected]


def test_force_table_reads_from_beside_the_scene(tmp_path):
    (tmp_path / "force.csv").write_bytes(b"\xef\xbb\xbftime,x,y,z\r\n0,1,2,3\r\n\r\n1.5,4,5,6\r\n")
    (tmp_path / "scene.toml").write_text(changed((FORCE, TABLE)))
    scene = fr.read_scene(tmp_path / "scene.toml")
    np.testing.assert_array_equal(scene.tables["force.csv"], [[0, 1, 2, 3], [1.5, 4, 5, 6]])


def test_force_table_that_did_not_come_with_the_rom_is_told():
    with pytest.raises(SceneError, match=r"table force.csv: did not come with the scene"):
        parse(changed((FORCE, TABLE)), tables={})


@pytest.mark.parametrize("name", ["nothing.toml", ".", "plate.toml/no", "nul\0"])
def test_file_that_cannot_be_read_is_told(tmp_path, name):
    with pytest.raises(SceneError, match="cannot be read: "):
        fr.read_scene(tmp_path / name)


def test_file_that_is_not_utf_8_is_told(tmp_path):
    file = tmp_path / "scene.toml"
    file.write_bytes(TEXT.replace("silicone", "Prüfling").encode("latin-1"))
    with pytest.raises(SceneError, match="is no text in UTF-8, at byte"):
        fr.read_scene(file)


VALUES = ["nan", "-1", "0", "1e999", "true", '""', "[]", "[[]]", "{}", "1979-05-27", "0x" + 5000 * "f", '"\\u0000"']
LINES = [f"\n{key} = {value}\n" for key in ("near", "order", "table", "load", "points", "share") for value in VALUES]
EDITS = st.lists(
    st.tuples(
        st.floats(0, 1),  # where
        st.sampled_from([0, 0, 1, 2, 10, 100]),  # how much goes
        st.one_of(st.text(max_size=3), st.sampled_from([*VALUES, *LINES, "[", "]", "="])),
    ),
    min_size=1,
    max_size=3,
)


def reads_or_is_told(read, source):
    """Reads a scene that may be broken; anything but a Scene or a SceneError that names it goes through."""
    try:
        read()
    except SceneError as error:
        return str(error).startswith(f"{source}: ")
    return True


@settings(max_examples=200, deadline=None, derandomize=True)
@given(EDITS)
def test_any_text_reads_or_is_told(edits):
    text = TEXT
    for where, gone, new in edits:
        at = int(where * len(text))
        text = text[:at] + new + text[at + gone :]
    assert reads_or_is_told(lambda: parse(text), "plate.toml")


@pytest.mark.parametrize("value", VALUES)
@pytest.mark.parametrize("there", re.findall(r"(?<== ).+", TEXT))
def test_any_value_anywhere_reads_or_is_told(there, value):
    assert reads_or_is_told(lambda: parse(TEXT.replace(f"= {there}", f"= {value}", 1)), "plate.toml")


@settings(max_examples=100, deadline=None, derandomize=True)
@given(st.lists(st.tuples(st.integers(0, len(TEXT.encode()) - 1), st.integers(0, 255)), min_size=1, max_size=4))
def test_any_bytes_read_or_are_told(tmp_path_factory, flips):
    data = bytearray(TEXT.encode())
    for at, byte in flips:
        data[at] = byte
    file = tmp_path_factory.getbasetemp() / "fuzzed.toml"
    file.write_bytes(data)
    assert reads_or_is_told(lambda: fr.read_scene(file), file)
