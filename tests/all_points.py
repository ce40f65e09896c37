"""Reduction without cubature: a body keeps all points of its material, with the weights that they have."""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from fenics_rom.reduction.hyperreduction import reduce as hyperreduction
from fenics_rom.reduction.hyperreduction.cubature import Cubature


@contextmanager
def all_points() -> Iterator[None]:
    """Within, bodies that deform largely are reduced so; in all modes, that also saves most of the time."""

    def every_point(body, *_):
        return Cubature(np.arange(len(body.weights)), np.ones(len(body.weights)), 0.0)

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(hyperreduction, "fit_cubature", every_point)
        yield
