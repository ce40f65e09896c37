"""The reference of the scene file is that of the records, and its example reads."""

from pathlib import Path

import numpy as np

import fenics_rom.scene
from fenics_rom.scene.effect_table import EFFECTS
from fenics_rom.scene.file import parse_scene
from fenics_rom.scene.places import given_piece
from fenics_rom.scene.reference import EXAMPLE, INTRODUCTION, WORLD_EXAMPLE, reference
from fenics_rom.scene.world_file import read_world

README = Path(fenics_rom.scene.__file__).with_name("README.md")


def test_reference_is_that_of_the_records():
    assert README.read_text() == reference(), "python -m fenics_rom.scene.reference > fenics_rom/scene/README.md"


def test_example_reads_and_names_every_effect():
    tables = {"quake.csv": 1, "ball.csv": 3, "pump.csv": 1}
    given = {name: np.column_stack([np.arange(2.0), np.ones((2, columns))]) for name, columns in tables.items()}
    scene = parse_scene(EXAMPLE.read_text(), tables=given)
    others = ("tendon_friction", "base_path", "viscoelasticity", "temperature")  # not with large_deformation or springs
    assert scene.effects.names == tuple(name for name in EFFECTS if name not in others)
    assert set(scene.tables) == set(tables)
    assert len(repr(scene).splitlines()) == 3
    assert set(scene.environment.loads) == {"gravity", "quake", "wire"}


def test_example_of_places_reads():
    example, touch = (part.partition("```")[0] for part in INTRODUCTION.read_text().split("```toml\n")[1:])
    others = "[mesh]\nfile = 'a.msh'\n[contacts.all]\ninner = false\n[effects]\ninertia = {}\n[materials.rest]\n"
    scene = parse_scene(f"{others}cells = 'rest'\nyoung = 1\npoisson = 0\ndensity = 1\n{example}")
    assert [given_piece(place) for place in (*scene.clamped, *scene.held)] == ["surface", "box", "along"]
    assert given_piece(scene.effects.pressure["air"]) == "all"
    assert given_piece(scene.materials["skin"]) == "none"
    floor = "[effects.contact.obstacles.floor]\nshape = 'half-space'\npoint = [0, 0, -1]\nnormal = [0, 0, 1]\n"
    solid = "[material]\nyoung = 1\npoisson = 0\ndensity = 1\n"
    felt = parse_scene(f"{others.partition('[materials')[0]}{floor}{solid}{touch}").readings["pad"]
    assert (felt.taxels.columns, felt.sensor.pressure_step) == (6, 20.0)


def test_example_of_a_world_reads():
    world = read_world(WORLD_EXAMPLE)
    assert repr(world) == "WorldScene 'stack': bodies ground, lower, upper; run of 1 s with dt = 0.002 s"
    assert world.file.pairs[0].restitution == 0.3
