"""Single drops of the study of random ones."""

import importlib
import sys
from pathlib import Path

import pytest

DEMO = Path(__file__).parents[2] / "demos" / "feed"


@pytest.mark.parametrize("number", [3011, 4288], ids=["two sets of forces took turns", "sweeps end late"])
def test_a_drop_ends_outside_and_gains_nothing(number):
    pytest.importorskip("gmsh")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(DEMO)
        drops = importlib.import_module("drops")
        sys.modules.pop("drops", None)
    (drop,) = drops.drops_of([number], 0)
    assert not drop.refused
    assert drop.touched > 1
    assert drop.depth < drops.DEEPEST
    assert not drop.passed
    assert drop.gain < 1e-12
