import sys

import pytest


@pytest.fixture(autouse=True)
def _without_dolfinx():
    if "dolfinx" in sys.modules:  # other tests of this process have loaded it: then nothing is drawn here
        pytest.skip("run by itself: pytest tests/exports, as tests/run.sh does")
