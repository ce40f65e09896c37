"""Ranges of a pose take along what is joined; what cannot be certified is said."""

import re

import numpy as np
import pytest

import fenics_rom as fr
from fenics_rom.certification.ranges import file_at, parameters_of
from fenics_rom.errors import SceneError
from fenics_rom.mechanics.frame_motion import quaternion_of_vector, rotation_matrix

GROUP = """
[bodies.tool]
shape = "box"
size = [0.1, 0.1, 0.1]
mass = 1.0
position = [0.0, 0.0, 0.5]
[bodies.handle]
shape = "box"
size = [0.1, 0.1, 0.1]
mass = 2.0
position = [0.2, 0.0, 0.5]
[bodies.hand]
scene = "hand.toml"
[[joints]]
kind = "weld"
first = "tool"
second = "handle"
point = [0.1, 0.0, 0.5]
[certificate]
body = "hand"
by = ["tool"]
[certificate.ranges.tool]
position = [[0.0, 0.0, 0.5], [0.0, 0.0, 0.7]]
rotation = [[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
velocity = [[0.0, 0.0, -1.0], [0.0, 0.0, -1.0]]
spin = [[0.0, 0.0, 2.0], [0.0, 0.0, 2.0]]
[run]
dt = 1e-3
duration = 0.1
"""


def read(tmp_path, text):
    (tmp_path / "world.toml").write_text(text)
    return fr.read_world(tmp_path / "world.toml")


def test_what_is_joined_moves_as_one(tmp_path):
    scene = read(tmp_path, GROUP)
    assert [each.name for each in parameters_of(scene.file.certificate.ranges)] == [
        "tool.position.z",
        "tool.rotation.z",
    ]
    file = file_at(scene.file, np.array([0.5, 1.0]))
    tool, handle = file.bodies["tool"], file.bodies["handle"]
    assert tool.position == pytest.approx((0, 0, 0.6))
    assert handle.position == pytest.approx((0.2 * np.cos(1), 0.2 * np.sin(1), 0.6))
    assert file.joints[0].point == pytest.approx((0.1 * np.cos(1), 0.1 * np.sin(1), 0.6))
    turned = rotation_matrix(quaternion_of_vector(handle.rotation))
    np.testing.assert_allclose(turned @ [1, 0, 0], [np.cos(1), np.sin(1), 0], atol=1e-15)
    assert tool.velocity == (0, 0, -1)
    assert handle.velocity == pytest.approx((-0.4 * np.sin(1), 0.4 * np.cos(1), -1))
    assert handle.spin == (0, 0, 2)
    assert file.bodies["hand"] == scene.file.bodies["hand"]


def test_what_the_world_holds_turns_about_its_joint(tmp_path):
    hinge = '[[joints]]\nkind = "hinge"\nfirst = "handle"\npoint = [1.0, 0.0, 0.5]\naxis = [0.0, 0.0, 1.0]\n'
    text = GROUP.replace("[certificate]", hinge + "[certificate]")
    text = re.sub(r"(position|velocity) = \[\[.*\n", "", text)
    file = file_at(read(tmp_path, text).file, np.array([1.0]))
    assert file.bodies["tool"].position == pytest.approx((1 - np.cos(1), -np.sin(1), 0.5))
    assert file.bodies["tool"].velocity == pytest.approx((2 * np.sin(1), -2 * np.cos(1), 0))
    assert file.joints[1].point == pytest.approx((1, 0, 0.5))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('body = "hand"', 'body = "hans"', "certificate.body: no body 'hans'"),
        ('by = ["tool"]', 'by = ["hand"]', "is joined to 'hand', or is it"),
        ('by = ["tool"]', 'by = ["tool"]\nlimits = "mine.csv"', "has no effect without the region"),
        ("velocity = [[0.0, 0.0, -1.0]", "velocity = [[0.0, 0.0, 1.0]", "from 1 to -1: put the lower one first"),
        ("[certificate.ranges.tool]", "[certificate.ranges.tool]\npace = [1, 2]", "give it to a body with a path"),
        ("[run]\ndt = 1e-3\nduration = 0.1\n", "", "its runs are as long as"),
        ("[run]", "[certificate.ranges.handle]\nspin = [[0,0,0],[0,0,1]]\n[run]", "is joined to"),
        ("[certificate.ranges.tool]", "[certificate.ranges.toll]", "no body 'toll'; .* did you mean 'tool'"),
        ("[run]", "[certificate.ranges.hand]\nmass = [1, 2]\n[run]", "hand.mass: give it to a rigid body"),
        ('scene = "hand.toml"', 'shape = "sphere"\nradius = 0.1', "'tool' and 'hand' are rigid: their force grows"),
    ],
)
def test_what_cannot_be_certified_is_said(tmp_path, old, new, said):
    with pytest.raises(SceneError, match=said):
        read(tmp_path, GROUP.replace(old, new))
