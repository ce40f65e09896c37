import subprocess
import sys
from pathlib import Path

import pytest

import fenics_rom as fr

PLATE = Path(__file__).parents[3] / "demos" / "plate" / "plate.toml"


@pytest.fixture(autouse=True)
def _without_dolfinx():
    if "dolfinx" in sys.modules:  # other tests of this process have loaded it: then nothing is drawn here
        pytest.skip("run by itself: pytest tests/visualization/exports, as tests/run.sh does")


@pytest.fixture(scope="session")
def plate_rom(tmp_path_factory):
    """The plate at order 20, made in another process."""
    file = tmp_path_factory.mktemp("plate") / "plate.h5"
    words = ["reduce", str(PLATE), "-o", str(file), "--order", "20"]
    subprocess.run([sys.executable, "-m", "fenics_rom", *words], check=True, capture_output=True)
    return fr.read_rom(file)
