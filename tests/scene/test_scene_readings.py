"""Readings in a scene: what is asked for is there, and what cannot be is told."""

import pytest
from bodies import acted_on

from fenics_rom.errors import SceneError
from fenics_rom.scene.places import Near, Place

EFFECTS = """
[effects.tendon.cable]
points = [[0.0, 0.2, 0.1], [1.0, 0.2, 0.1]]
[effects.pressure.air]
surface = "top"
"""
NEAR = "near = { point = [0.5, 0.2, 0.3], radius = 0.2 }"


def scene_of(reading, effects=EFFECTS):
    return acted_on("box.msh", effects, **{"readings.one": reading})


def test_a_reading_is_of_a_name_or_of_a_place():
    assert scene_of('quantity = "length"\nof = "cable"').readings["one"].of == "cable"
    assert scene_of(f'quantity = "strain"\n{NEAR}').readings["one"].place.near == Near((0.5, 0.2, 0.3), 0.2)
    assert scene_of('quantity = "strain"\nof = "top"').readings["one"].place == Place("top")
    assert scene_of('quantity = "strain"').readings["one"].place is None


CONTACT = '[effects.contact.obstacles.floor]\nshape = "half-space"\npoint = [0, 0, -1]\nnormal = [0, 0, 1]'
TOUCH = 'quantity = "touch"\nsurface = "top"\n'


def touch_of(touch, effects=CONTACT, **others):
    return acted_on("box.msh", effects, **{"outputs.skin": touch}, **others)


def test_touch_is_an_output_of_the_file_and_a_reading_of_the_scene():
    taxels, sensor = "taxels = { rows = 3, columns = 2 }\n", "sensor = { rate = 100.0, pressure_noise = 5.0 }"
    scene = touch_of(TOUCH + taxels + sensor)
    entry = scene.readings["skin"]
    assert (entry.surface, entry.taxels.rows, entry.taxels.columns, entry.patches) == ("top", 3, 2, 4)
    assert (entry.sensor.rate, entry.sensor.pressure_noise, entry.sensor.delay) == (100.0, 5.0, 0.0)
    assert "skin" not in scene.outputs
    assert '"sensor"' in scene.environment.built_in["outputs"]


UNFELT = {
    "points = [[0, 0, 0]]\npatches = 2": r"outputs.skin.patches: goes with quantity = 'touch'",
    'surface = "top"\ntaxels = { rows = 2, columns = 2 }': r"outputs.skin.taxels: goes with quantity = 'touch'",
    'quantity = "touch"\npoints = [[0, 0, 0]]': r"outputs.skin.points: touch is of a piece of the surface; use",
    'quantity = "tuch"\nsurface = "top"': r"outputs.skin.quantity: no choice 'tuch'.* did you mean 'touch'",
    TOUCH + "taxels = { rows = 2 }": r"outputs.skin.taxels: columns is missing",
    TOUCH + "taxels = { rows = 100, columns = 100 }": r"taxels: 100 x 100 are 10000 taxels; use at most 4096",
    TOUCH
    + "taxels = { rows = 2, columns = 2, along = [0, 0, 0] }": r"outputs.skin.taxels.along: use any direction but zero",
    TOUCH + "sensor = {}": r"outputs.skin.sensor: adds nothing; give one of rate, delay, pressure_noise",
    TOUCH + "sensor = { delay = 1.0, seed = 2 }": r"outputs.skin.sensor.seed: goes with noise, of which there is none",
    TOUCH + "sensor = { pressure_step = 1.0 }": r"outputs.skin.sensor.pressure_step: goes with taxels",
    TOUCH + '[readings.skin]\nquantity = "strain"': r"outputs.skin: the name is taken by readings.skin",
}


@pytest.mark.parametrize(("touch", "message"), UNFELT.items(), ids=UNFELT.values())
def test_what_cannot_be_felt_is_told(touch, message):
    with pytest.raises(SceneError, match=message):
        touch_of(touch)


def test_touch_means_nothing_without_contact():
    with pytest.raises(SceneError, match=r"outputs.skin: touch means nothing without contact; name effects.contact"):
        touch_of(TOUCH, effects=EFFECTS)


MISTAKES = {
    'quantity = "lenght"\nof = "cable"': r"readings.one.quantity: no choice 'lenght'.* did you mean 'length'",
    'of = "cable"': r"readings.one: quantity is missing",
    'quantity = "length"': r"readings.one.of is missing: the tendon whose length is read",
    'quantity = "length"\nof = "cabel"': r"readings.one.of: no tendon 'cabel'; there is cable; did you mean 'cable'",
    'quantity = "volume"\nof = "cable"': r"readings.one.of: no pressure 'cable'; there is air",
    f'quantity = "volume"\n{NEAR}': r"readings.one.near: goes with strain and stress; a volume is that of a pressure",
    'quantity = "contact_pressure"\nof = "top"': r"readings.one: means nothing without contact; name effects.contact",
    'quantity = "contact_pressure"\nof = "sole"': r"readings.one.of: no contact mode 'sole'; there is right, top",
    'quantity = "marker"': r"readings.one.point is missing: where the middle of the marker is at rest",
    'quantity = "marker"\nof = "top"\npoint = [0, 0, 0]': r"readings.one.of: a marker is on the triangle",
    'quantity = "stress"': r"readings.one.points is missing: the material points whose stress is read",
    'quantity = "stress"\nof = "top"\npoints = [[0, 0, 0]]': r"readings.one.of: goes with strain, von_mises_stress",
    'quantity = "strain"\npoints = [[0, 0, 0]]': r"readings.one.points: goes with stress; strain has none",
    'quantity = "strain"\nof = "top"\ninner = true': r"readings.one: give of or inner, not both",
    'quantity = "strain"\npoint = [0, 0, 0]': r"readings.one.point: goes with a marker and a reaction; strain has none",
    'quantity = "marker"\npoint = [0, 0, 0]\n[outputs.far]\nmarkers = [[0, 0, 1]]\n[effects.large_deformation]': (
        r"outputs.far.markers: are for small turns; use readings"
    ),
    f'quantity = "strain"\nof = "top"\n{NEAR}': r"readings.one: give of or near, not both",
}


@pytest.mark.parametrize(("reading", "message"), MISTAKES.items(), ids=MISTAKES.values())
def test_what_cannot_be_read_is_told(reading, message):
    with pytest.raises(SceneError, match=message):
        scene_of(reading)
