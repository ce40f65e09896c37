"""A part that weighs next to nothing is not passed over in silence."""

import warnings
from pathlib import Path

import pytest

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning
from fenics_rom.reduction import validation

HEAVY, LIGHT = (1e5, 0.3, 1e5), (1e5, 0.3, 1e1)  # Pa, 1, kg/m3
CONTACTS = {
    "right": 'surface = "right"\nforce = "resultant"',
    "top": 'near = { point = [0.25, 0.05, 0.1], radius = 0.04 }\nforce = "resultant"',
    "root": 'near = { point = [0.05, 0.05, 0.1], radius = 0.04 }\nforce = "resultant"',
}


@pytest.fixture(scope="module")
def box():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(Path(__file__).parents[2] / "demos" / "hard_cases")
        import boxes

        yield boxes.box


def test_the_contact_modes_of_a_light_tip_are_named_and_others_are_not(box, monkeypatch):
    materials = {"root": (lambda p: p[:, 0] < 0.15, *HEAVY), "tip": (lambda p: p[:, 0] > 0.15, *LIGHT)}
    system = box((0.3, 0.1, 0.1), (4, 2, 2), materials=materials, contacts=CONTACTS)
    with pytest.warns(FenicsRomWarning, match=r"'(right|top)' \(and 1 more\) misses 0\.0\d+ .* by mass, but 0\.1"):
        rom = fr.reduce(system, order=30)
    assert len(rom.warnings) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fr.reduce(system, order=30, weighting="nodal")
        fr.reduce(system, order=30, method="modal")  # which knows no weighting
        fr.reduce(system, order=60)
        fr.reduce(box((0.3, 0.1, 0.1), (4, 2, 2), contacts=CONTACTS), order=2)
        monkeypatch.setattr(validation, "WARNING_ERROR", 0.01)
        fr.reduce(system, order=30, weighting="outputs")  # whoever asks for that knows
