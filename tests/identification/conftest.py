"""What tests of identification share."""

from pathlib import Path

import pytest
from measuring import box_mesh


@pytest.fixture(scope="session")
def mesh(tmp_path_factory) -> Path:
    """A box with markers."""
    return box_mesh(tmp_path_factory.mktemp("mesh"))
