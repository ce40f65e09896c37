"""World files: what they may say, and that what they may not is told in one sentence."""

import numpy as np
import pytest
from bodies import PLATE

import fenics_rom as fr
from fenics_rom.errors import SceneError
from fenics_rom.run import is_world_file
from fenics_rom.scene.reference import WORLD_EXAMPLE

GIVEN = (
    WORLD_EXAMPLE.read_text()
    + """
[bodies.palm]
shape = "box"
size = [0.1, 0.1, 0.02]
path = "palm.csv"

[bodies.finger]
rom = "finger.h5"
on = "palm"

[[joints]]
kind = "hinge"
first = "lower"
point = [0, 0, 0]
axis = [0, 0, 1]

[[run.input]]
body = "finger"
actuator = "flexor"
table = "pull.csv"
"""
)
DOUBLE = '[[pairs]]\nbodies = ["{}", "{}"]\nfriction = 0.7\n[run]'
JOINED = '\n[[joints]]\nkind = "ball"\nfirst = "ground"\nsecond = "upper"\npoint = [0, 0, 0]\n[run]'
NAMED = '[[joints]]\nname = "hold"\nkind = "weld"\nfirst = "upper"\npoint = [0, 0, 0]\n'
PALM = "time (s), position.x, position.y, position.z, rotation.w, rotation.x, rotation.y, rotation.z\n"


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "palm.csv").write_text(PALM + "0,0,0,1,1,0,0,0\n1,0,0,2,1,0,0,0\n")
    (tmp_path / "pull.csv").write_text("time (s), tension (N)\n0, 0\n1, 5\n")
    return tmp_path


def read(folder, text):
    (folder / "world.toml").write_text(text)
    return fr.read_world(folder / "world.toml")


def test_bodies_joints_and_tables_are_read(folder):
    world = read(folder, GIVEN)
    file = world.file
    assert list(file.bodies) == ["ground", "lower", "upper", "palm", "finger"]
    np.testing.assert_allclose(file.bodies["palm"].path(0.5).position, [0, 0, 1.5])
    assert file.run.input[0].signal(0.5) == 2.5
    assert file.joints[0].second == "world"
    assert is_world_file(folder / "world.toml")
    assert not is_world_file(folder / "palm.csv")
    assert not is_world_file(folder / "nothing.toml")


@pytest.mark.parametrize(
    ("there", "instead", "said"),
    [
        (
            'shape = "sphere"',
            'shape = "spere"',
            r"bodies.upper.shape: no choice 'spere'; there is box, .*; did you mean 'sphere'",
        ),
        ("radius = 0.04", "", r"bodies.upper.radius: is missing; dimensions of a sphere: radius"),
        ("radius = 0.04", "radius = -1", r"bodies.upper.radius = -1: use a finite number > 0, in m"),
        ("radius = 0.04", "radius = 1\nsize = [1, 1, 1]", r"bodies.upper.size: a sphere has none"),
        ("density = 500", "densty = 500", r"bodies.lower: no key 'densty'; there is .*; did you mean 'density'"),
        ("mass = 0.2", "mass = 0.2\ndensity = 3", r"bodies.upper: give density or mass, not both"),
        ("mass = 0.2", "velocity = [1, 0, 0]", r"bodies.upper: stands still or follows its path"),
        (
            'shape = "half-space"',
            'shape = "half-space"\nmass = 1',
            r"bodies.ground.mass: means nothing of a half-space",
        ),
        ('on = "palm"', 'on = "plam"', r"bodies.finger.on: no body 'plam'; there is .*; did you mean 'palm'"),
        ('on = "palm"', 'on = "finger"', r"bodies.finger.on: finger is on finger: use a chain without a circle"),
        ('on = "palm"', 'on = "lower"', r"bodies.finger.on = 'lower': use a rigid body that stands still"),
        ('on = "palm"', "mass = 1", r"bodies.finger.mass: is of a rigid body, and this is a soft one"),
        ('rom = "finger.h5"', "", r"bodies.finger: give exactly one of rom, scene, shape, robot \(got none\)"),
        ('bodies = ["lower", "upper"]', 'bodies = ["lower", "uper"]', r"pairs\[0\].bodies: no body 'uper'"),
        ('bodies = ["lower", "upper"]', 'bodies = ["lower"]', r"pairs\[0\].bodies is a list of 1"),
        ('bodies = ["lower", "upper"]', 'bodies = ["lower", "lower"]', r"lower: is rigid: use two bodies"),
        ("axis = [0, 0, 1]", "axis = [0, 0, 1]\nstart = 0.5\nstop = 0.5", r"joints\[0\].stop = 0.5: use one after its"),
        (
            "axis = [0, 0, 1]",
            "axis = [0, 0, 1]\nstart = 1",
            r"joints\[0\].start = 1: use one before the end of the run",
        ),
        ("[[joints]]", NAMED + "[[joints]]\nname = 'hold'", r"joints\[1\].name = 'hold': is that of another one"),
        ("axis = [0, 0, 1]", "", r"joints\[0\].axis: a hinge has one, and no other joint"),
        ("axis = [0, 0, 1]", "axis = [0, 0, 0]", r"joints\[0\].axis: use any direction but zero"),
        ("point = [0, 0, 0]", "", r"joints\[0\]: give exactly one of point, surface \(got none\)"),
        ("point = [0, 0, 0]", 'surface = "tip"', r"joints\[0\].surface = 'tip': use .* soft body.*'lower'"),
        ('kind = "hinge"', 'kind = "slider"', r"joints\[0\].kind: no choice 'slider'"),
        ('body = "finger"', 'body = "lower"', r"run.input\[0\].body: no soft body 'lower'"),
        ('"pull.csv"', '"push.csv"', r"table .*push.csv: cannot be read"),
        ('"palm.csv"', '"pull.csv"', r"table .*pull.csv"),
        (
            'path = "palm.csv"',
            'path = "palm.csv"\ndensity = 1',
            r"bodies.palm.density: means nothing of a body that is",
        ),
        (
            'path = "palm.csv"',
            'path = "palm.csv"\nposition = [0, 0, 1]',
            r"bodies.palm.position: has no effect beside a path",
        ),
        ("dt = 2e-3", "dt = 3e-3", r"a duration of 1 s is no whole number of .* 0.003 s: 333 end at 0.999 s"),
        ("[run]", DOUBLE.format("upper", "lower"), r"pairs\[1\].bodies: upper and lower: are named in pairs\[0\], too"),
        ("[run]", DOUBLE.format("ground", "palm"), r"pairs\[1\].bodies: .* both stand still or follow a path"),
        (
            "[run]",
            DOUBLE.format("upper", "ground").replace("[run]", JOINED),
            r"pairs\[1\].bodies: .* joined by joints\[0\]",
        ),
        ("[bodies.ground]", 'apart = [["upper", "ground", "lower"]]\n[bodies.ground]', r"as apart\[0\] says"),
        ("dt = 2e-3", "dt = 2", r"run.dt = 2: use at most the duration, 1 s"),
        ("[bodies.ground]", "[bodies.world]", r"bodies.world: use any other name"),
        ("mass = 0.2", "mass = 0.2\nrotation = [0, 0, 90]", r"rotation\[2\] = 90: use .* in rad, not degrees"),
        ("gravity = [0, 0, -9.81]", "gravity = 9.81", r"gravity = 9.81: use a list of 3"),
    ],
)
def test_mistake_is_told_with_what_is_allowed(folder, there, instead, said):
    assert there in GIVEN
    with pytest.raises(SceneError, match=said):
        read(folder, GIVEN.replace(there, instead, 1))


def test_circles_of_carriers_are_told(folder):
    with pytest.raises(SceneError, match=r"finger is on other is on finger: use a chain without a circle"):
        read(folder, GIVEN.replace('on = "palm"', 'on = "other"') + '[bodies.other]\nrom = "a.h5"\non = "finger"\n')


def test_what_is_no_toml_or_no_world_is_told(folder):
    with pytest.raises(SceneError, match=r"world\.toml: is not TOML"):
        read(folder, "[bodies")
    with pytest.raises(SceneError, match="bodies: at least one is needed"):
        read(folder, "bodies = {}")
    with pytest.raises(SceneError, match=r"world\.toml: bodies is missing"):
        read(folder, "")
    with pytest.raises(SceneError, match=r"world\.toml: is a scene, .* which fr.read_scene reads"):
        read(folder, PLATE.read_text())
    read(folder, GIVEN)
    with pytest.raises(SceneError, match=r"world\.toml: is a world, .* which fr.read_world reads"):
        fr.read_scene(folder / "world.toml")
