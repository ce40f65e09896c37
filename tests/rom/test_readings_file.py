"""Readings in ROM files: what is written is read to the last bit, and what does not fit is refused with the reason."""

import re
import warnings

import numpy as np
import pytest
from bodies import acted_on
from rom_files import put, refusal, same, says, tampered, without

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning

EFFECTS = """
[effects.tendon.cable]
points = [[0.0, 0.2, 0.1], [1.0, 0.2, 0.1]]
[effects.contact.obstacles.floor]
shape = "half-space"
point = [0, 0, -1e-3]
normal = [0, 0, 1]
"""
READINGS = {
    "readings.cable": 'quantity = "length"\nof = "cable"',
    "readings.sole": 'quantity = "contact_pressure"\nof = "sole"',
    "readings.stress": 'quantity = "von_mises_stress"\nof = "top"',
    "readings.corner": 'quantity = "stress"\npoints = [[0.5, 0.2, 0.1], [0.7, 0.4, 0.3]]',
    "readings.ball": 'quantity = "marker"\npoint = [0.5, 0.2, 0.32]',
    "readings.gauge": 'quantity = "strain"\nnear = { point = [0.5, 0.2, 0.3], radius = 0.2 }',
    "readings.held": 'quantity = "reaction"',
    "outputs.skin": 'quantity = "touch"\nsurface = "bottom"\ntaxels = { rows = 2, columns = 3 }\n'
    "sensor = { rate = 50.0, force_noise = 0.1, seed = 4 }",
}


@pytest.fixture(scope="module")
def rom(box_file):
    """A box with readings of all kinds but a volume, which is written as a length is."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FenicsRomWarning)
        scene = acted_on(box_file, EFFECTS, contacts='[contacts.sole]\nsurface = "bottom"', **READINGS)
        return fr.reduce(fr.assemble(scene), order=12)


@pytest.fixture
def rom_file(tmp_path, rom):
    fr.write_rom(tmp_path / "rom.h5", rom)
    return tmp_path / "rom.h5"


def test_readings_are_read_to_the_last_bit(rom, rom_file):
    again = fr.read_rom(rom_file)
    assert list(again.readings) == ["cable", "sole", "stress", "corner", "ball", "gauge", "held", "skin"]
    assert same(again, rom)
    bodies = [fr.Simulator(each, dt=0.01) for each in (rom, again)]
    for body in bodies:
        body.step([3.0])
    for name in rom.readings:
        assert np.array_equal(bodies[0].reading(name), bodies[1].reading(name))


LIES = {
    "/readings/cable: no quantity 'lenght'": lambda h5: says(quantity="lenght")(h5["readings/cable"]),
    "/readings/cable/rest is missing": without("readings/cable/rest"),
    "/readings/cable: 'rope' is no actuator of one column": lambda h5: says(of="rope")(h5["readings/cable"]),
    "'cable' is no actuator of one column, or nothing is left of it at rest": put("readings/cable/rest", [0.0]),
    "/readings/stress/operator has unit '1', not 'kg^-1/2/m'": put(
        "readings/stress/operator", lambda there: there, unit="1"
    ),
    "/readings/stress/triangles: use some numbers below 80": put("readings/stress/triangles", lambda there: there + 80),
    "/readings/stress: moduli are not positive": put("readings/stress/shear", lambda there: -there),
    "/readings/corner/corner_points: weights are not positive with the sum 1": put(
        "readings/corner/corner_weights", lambda there: 2 * there
    ),
    "/readings/corner/value_corners: use all numbers below": put(
        "readings/corner/value_corners", lambda there: there[::-1]
    ),
    "/readings/held/inputs: of 2 columns, and the ROM has 1": put(
        "readings/held/inputs", lambda there: there.repeat(2, 1)
    ),
    "/readings/held/contacts: of other contact modes": without("readings/held/contacts/sole"),
    "/readings/corner: moduli are not positive": put("readings/corner/shear", lambda there: -there),
    "/readings/sole: facets have 3, 4, 6 or 9 nodes and an area": put("readings/sole/areas", lambda there: -there),
    "/readings/sole/facets: use some numbers below 15": put("readings/sole/facets", lambda there: there + 1),
    "/readings/sole: a node has no facets": put("readings/sole/facets", lambda there: 0 * there),
    "/readings/ball/tangents: are not orthonormal": put("readings/ball/tangents", lambda there: 2 * there),
    "/readings/skin/nodes: use some numbers below": put("readings/skin/nodes", lambda there: there + 10**6),
    "/readings/skin: facets have 3 or 6 nodes and an area": put("readings/skin/areas", lambda there: -there),
    "/readings/skin/shares: those of a node have not the sum 1": put("readings/skin/shares", lambda there: 2 * there),
    "/readings/skin/map/grid: 2 x 2 taxels, of which there are 6": put("readings/skin/map/grid", [2, 2]),
    "/readings/skin/map/triangles: use numbers below 80": put("readings/skin/map/triangles", lambda there: there + 80),
    "/readings/skin/sensor/rate is missing": without("readings/skin/sensor/rate"),
    "/readings/skin/sensor: use numbers >= 0": put("readings/skin/sensor/rate", [-1.0]),
    "/readings/sole: no contact mode 'soul'": lambda h5: says(of="soul")(h5["readings/sole"]),
}


@pytest.mark.parametrize(("message", "lie"), LIES.items(), ids=LIES)
def test_readings_that_are_not_what_they_say_are_refused_with_the_reason(rom_file, message, lie):
    assert re.search(re.escape(message), refusal(fr.read_rom, tampered(rom_file, lie)))
