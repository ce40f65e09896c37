"""Membranes and cables that are pressed: runs and trainings tell which, how hard and where."""

import re

import pytest
from bodies import acted_on, box_arrays, box_surfaces, write_arrays

import fenics_rom as fr

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
EDGES = (0.2, 0.02, 0.02)
MATERIAL = "young = 1e5\npoisson = 0.0\ndensity = 1000.0"
STRAINS = {"small": "", "large": 'large_deformation = { material = "neo_hookean" }\n'}
WIRE = {"effects.cables.wire": "points = [[0.0, 0.01, 0.01], [0.2, 0.01, 0.01]]\nstiffness = 60.0"}
THREADS = {"effects.membranes.cloth": 'surface = "top"\ndirections = [[1, 0, 0]]\nstiffness = 500.0'}
SHEET = {"effects.membranes.cloth": 'surface = "top"\npoisson = 0.3\nstiffness = 500.0'}
TOLD = re.compile(r"effects\.(\S+): (\S+) % of its (area|length) push by up to (\S+) (N/m|N) \(near \[(.*)\], (.*)\):")


@pytest.fixture(scope="module")
def bar(tmp_path_factory):
    points, cells = box_arrays(EDGES, (8, 2, 2))
    return write_arrays(tmp_path_factory.mktemp("bar") / "bar.msh", points, cells, box_surfaces(points, cells))


def system_of(bar, strains, force, embedded):
    """Equilibria under a force at the free end, N."""
    load = f'[[run.load]]\ncontact = "right"\nforce = {force}'
    parts = {"contacts": '[contacts.right]\nsurface = "right"', "material": MATERIAL, "degree": 2}
    return fr.assemble(acted_on(bar, STRAINS[strains], run=f"dt = 0.5\nduration = 1.0\n{load}", **parts, **embedded))


def told(warnings):
    return [TOLD.match(text).groups() for text in warnings if TOLD.match(text)]


@pytest.mark.parametrize("strains", STRAINS)
@pytest.mark.parametrize("sign", [-1, 1])
def test_a_wire_that_is_pressed_is_told(bar, strains, sign):
    """A bar of E A = 40 N shares a force F with its wire of k = 60 N: this has F k/(E A + k), pulled it is not told."""
    run = fr.simulate(system_of(bar, strains, [sign * 0.02, 0, 0], WIRE))
    if sign > 0:
        assert not told(run.warnings)
        return
    ((name, share, of, force, unit, place, when),) = told(run.warnings)
    assert (name, share, of, unit, when) == ("cables.wire", "100", "length", "N", "at t = 1 s")
    assert float(force) == pytest.approx(0.02 * 60 / 100, rel=5e-3)
    assert 0 < float(place.split(",")[0]) < EDGES[0]


@pytest.mark.parametrize("strains", STRAINS)
@pytest.mark.parametrize("cloth", [THREADS, SHEET], ids=["threads", "sheet"])
def test_a_beam_that_bends_up_presses_its_upper_cloth(bar, strains, cloth):
    """By k κ c near its end, κ = F L/EI of beam and cloth and c from their neutral axis; down it pulls it."""
    up, down = (fr.simulate(system_of(bar, strains, [0, 0, force], cloth)) for force in (2e-3, -2e-3))
    ((name, share, of, force, unit, place, _),) = told(up.warnings)
    assert (name, share, of, unit) == ("membranes.cloth", "100", "area", "N/m")
    assert float(place.split(",")[0]) < 0.05
    b, h, k = EDGES[1], EDGES[2], 500.0 * EDGES[1]
    axis = (1e5 * b * h * h / 2 + k * h) / (1e5 * b * h + k)
    bending = 1e5 * b * (h**3 / 12 + h * (h / 2 - axis) ** 2) + k * (h - axis) ** 2
    assert float(force) == pytest.approx(500.0 * 2e-3 * EDGES[0] / bending * (h - axis), rel=0.1)
    assert not told(down.warnings)


def test_training_tells_it_too(tmp_path):
    points, cells = box_arrays(EDGES, (2, 1, 1))
    bar = write_arrays(tmp_path / "bar.msh", points, cells, box_surfaces(points, cells))
    rom = fr.reduce(system_of(bar, "large", [-0.02, 0, 0], WIRE), order=2, method="trained")
    ((name, _, _, force, *_, when),) = told(rom.warnings)
    assert (name, when) == ("cables.wire", "in training")
    assert float(force) > 0.01
