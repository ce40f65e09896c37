"""What a ROM has built in, and a run cannot change: mesh, materials, supports, contacts, actuators, outputs, names."""

import json
import shutil
from dataclasses import replace

import h5py
import numpy as np
import pytest
from bodies import PLATE

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning, SceneError
from fenics_rom.io.hdf5 import write_file
from fenics_rom.scene.file import parse_scene

MESH = PLATE.parents[2] / "meshes" / "plate.msh"
ORDER = "order = { tip_left = 52, middle = 67 }   # the paper's Table I"
TEXT = PLATE.read_text().replace("../../meshes/plate.msh", str(MESH)).replace(ORDER, "order = 4")
OTHERS = {  # what a scene says instead, and what is said of it
    "material": (
        "young = 1.0e6",
        "young = 1.0e4",
        "materials.material.young is 10000.0, and ROM 'plate' was made with",
    ),
    "a support more": ('["root"]', '["root", "middle"]', "supports.clamped"),
    "a support held along a normal": (
        "[contacts.tip_left]",
        '[[supports.held]]\nsurface = "middle"\nnormal = [0.0, 0.0, 1.0]\n[contacts.tip_left]',
        "supports.held",
    ),
    "a contact surface": (
        'surface = "middle"',
        'surface = "tip_left"',
        'contacts.middle.surface is "tip_left", and ROM',
    ),
    "the columns of a contact": (
        'surface = "middle"\nforce = "resultant"',
        'surface = "middle"\nforce = "normal"',
        "contacts.middle.force",
    ),
    "a name of a contact": ("[contacts.middle]", "[contacts.centre]", "contacts"),
    "a contact more": ("[outputs.tip]", '[contacts.more]\nsurface = "middle"\n[outputs.tip]', "contacts.more"),
    "an actuator": ("[outputs.tip]", '[actuators.air]\nsurface = "middle"\n[outputs.tip]', "actuators.air"),
    "an output elsewhere": ("[0.5, 0.2, 0.01]", "[0.25, 0.2, 0.01]", "outputs.tip.points"),
    "an output more": ("[effects]", "[outputs.more]\npoints = [[0.5, 0.0, 0.01]]\n[effects]", "outputs.more is"),
    "a name of an output": ("[outputs.tip]", "[outputs.corner]", "outputs"),
    "the degree of the mesh": (
        "[material]",
        "degree = 2\n[material]",
        "mesh.degree is 2, and ROM 'plate' was made with 1",
    ),
    "the scale of the mesh": ("[material]", "scale = 1e-3\n[material]", "mesh.scale is 0.001"),
    "a mesh that is not there": (
        str(MESH),
        "nowhere.msh",
        "mesh.file = 'nowhere.msh' is not there, and ROM 'plate' was",
    ),
}


@pytest.fixture(scope="module")
def rom(plate_rom):
    return fr.truncate(plate_rom, 4)


def changed(words, instead):
    assert words in TEXT
    text = TEXT.replace(words, instead)
    if instead == "[contacts.centre]":
        text = text.replace('contact = "middle"', 'contact = "centre"')
    return parse_scene(text, source="S.toml")


@pytest.mark.parametrize(("words", "instead", "says"), OTHERS.values(), ids=OTHERS)
def test_another_scene_is_refused_by_the_place_that_differs(rom, words, instead, says):
    for run in (fr.simulate, lambda rom, scene: fr.Simulator(rom, 1e-3, scene=scene)):
        with pytest.raises(SceneError) as caught:
            run(rom, scene=changed(words, instead))
        text = str(caught.value)
        assert text.startswith("S.toml: ")
        assert says in text
        assert text.endswith("to have it, make a ROM from this scene: fenics-rom reduce S.toml -o ROM.h5")
        assert "\n" not in text


def test_a_mesh_of_another_content_is_refused_and_a_copy_is_not(rom, tmp_path):
    copy = shutil.copy(MESH, tmp_path / "copy.msh")
    same = parse_scene(TEXT.replace(str(MESH), str(copy)))
    np.testing.assert_array_equal(fr.simulate(rom, scene=same).energy, fr.simulate(rom).energy)
    moved = (tmp_path / "copy.msh").read_text()
    (tmp_path / "copy.msh").write_text(moved + "\n")
    other = parse_scene(TEXT.replace(str(MESH), str(copy)))
    with pytest.raises(
        SceneError, match=r"mesh\.file = 'copy\.msh' has another content, and ROM 'plate' was made with"
    ):
        fr.simulate(rom, scene=other)


def test_what_runs_may_change_is_not_built_in(rom):
    """Load history, name, how to reduce; the order in which surfaces are named; whole numbers for real ones."""
    for words, instead in (
        ("duration = 3.0", "duration = 0.6"),
        ('name = "plate"', 'name = "another"'),
        ("order = 4", "tolerance = 1e-3"),
        ("density = 2300.0", "density = 2300"),
        ('surface = "middle"\nforce = "resultant"', 'surface = "middle"'),
    ):
        fr.Simulator(rom, 1e-3, scene=changed(words, instead))


def test_a_file_keeps_what_was_built_in(rom, tmp_path):
    fr.write_rom(tmp_path / "rom.h5", rom)
    words, instead, _ = OTHERS["a contact surface"]
    with pytest.raises(SceneError, match=r"contacts\.middle\.surface"):
        fr.simulate(fr.read_rom(tmp_path / "rom.h5"), scene=changed(words, instead))
    assert "content" in json.loads(rom.environment.built_in["mesh"])


def test_a_rom_of_an_earlier_release_says_that_it_could_not_be_checked(rom, tmp_path):
    fr.write_rom(tmp_path / "rom.h5", rom)

    def without(h5):
        with h5py.File(tmp_path / "rom.h5") as whole:
            h5.attrs.update(whole.attrs)
            for name in whole:
                whole.copy(name, h5)
        for place in ("mesh", "supports", "contacts", "actuators", "outputs"):
            del h5["environment/built_in"].attrs[place]

    write_file(tmp_path / "old.h5", "rom", without)
    old = fr.read_rom(tmp_path / "old.h5")
    fr.simulate(old, scene=replace(old.environment, effects=dict(old.environment.effects)))  # its own: nothing to check
    with pytest.warns(FenicsRomWarning, match="whether those of S.toml are the same could not be checked"):
        fr.Simulator(old, 1e-3, scene=changed("young = 1.0e6", "young = 1.0e4"))


def test_matrices_know_of_no_scene():
    chain = fr.System(
        mass=np.eye(4), rayleigh=(0.0, 0.01), stiffness=np.diag([1.0, 2, 3, 4]), contacts={"a": np.eye(4)[0]}
    )
    rom = fr.reduce(chain, order=1, method="static")
    assert rom.environment.built_in == {}
    fr.Simulator(rom, 1e-3, scene=parse_scene(TEXT)).step([1.0])
