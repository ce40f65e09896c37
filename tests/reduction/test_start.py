"""What no run of a scene could begin with is told by `reduce`, not only after its work is done."""

import pytest
from bodies import scene_text

import fenics_rom as fr
from fenics_rom.errors import SceneError
from fenics_rom.scene.file import parse_scene

FLOOR = """
[effects.contact.obstacles.floor]
shape = "half-space"
point = [0.0, 0.0, {height}]
normal = [0.0, 0.0, 1.0]
"""


@pytest.fixture(scope="module")
def text(box_file):
    """A box of 1 m by 0.4 m by 0.3 m, touched from below and pushed on its right."""
    contacts = '[contacts.bottom]\nsurface = "bottom"\n[contacts.right]\nsurface = "right"'
    return scene_text(box_file, contacts=contacts, effects="inertia = {}\ndamping = { alpha = 1.0 }")


def no_work(stage, done, of):
    raise AssertionError(f"{stage} was begun")


def refused(text, folder=None):
    scene = parse_scene(text, source="S.toml", **({} if folder is None else {"folder": folder}))
    with pytest.raises(SceneError) as caught:
        fr.reduce(fr.assemble(scene), order=4, report=no_work)
    return str(caught.value)


def test_an_obstacle_that_begins_inside_is_refused_before_any_work(text):
    said = refused(text + FLOOR.format(height=0.05))
    assert said.startswith("S.toml: contact: use a start outside of all obstacles, but 0.05 m inside 'floor' is")


def test_an_obstacle_that_moves_begins_where_its_table_says(text, tmp_path):
    (tmp_path / "down.csv").write_text("time,x,y,z\n0,0,0,-0.1\n1,0,0,-0.2\n")
    (tmp_path / "up.csv").write_text("time,x,y,z\n0,0,0,0.1\n1,0,0,0\n")
    inside, outside = FLOOR.format(height=0.05), FLOOR.format(height=-0.05)
    assert "0.05 m inside 'floor'" in refused(text + outside + 'table = "up.csv"\n', tmp_path)
    moved = parse_scene(text + inside + 'table = "down.csv"\n', folder=tmp_path)
    assert fr.reduce(fr.assemble(moved), order=4).contacts == {"bottom": 3, "right": 3}


@pytest.mark.parametrize("load", ["force = [1.0]", 'table = "one.csv"'])
def test_one_number_for_a_contact_of_three_columns_is_refused_before_any_work(text, tmp_path, load):
    (tmp_path / "one.csv").write_text("time,force\n0,0\n1,1\n")
    run = f'\n[run]\ndt = 1e-3\nduration = 0.1\n[[run.load]]\ncontact = "right"\n{load}\n'
    assert refused(text + run, tmp_path) == "S.toml: run.load: 'right': use 3 numbers in its force (got 1)"
    three = run.replace("[1.0]", "[1.0, 0.0, 0.0]").replace("one.csv", "three.csv")
    (tmp_path / "three.csv").write_text("time,x,y,z\n0,0,0,0\n1,1,0,0\n")
    fr.reduce(fr.assemble(parse_scene(text + three, folder=tmp_path)), order=4)
