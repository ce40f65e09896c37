"""Compiled steps of a body that touches itself: forces and motion are NumPy's."""

import numpy as np
import pytest
from forks import CLAMPED, LONG, ROPE, cleft
from test_self_contact import RUBS, rom_of

import fenics_rom as fr
from fenics_rom.compilation import compiled, numpy_alone

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")


@pytest.mark.skipif(not compiled(), reason="numba is not installed")
@pytest.mark.parametrize("law", ["", "restitution = 0.5", 'method = "penalty"\nstiffness = 1e3\ndamping = 0.1'])
def test_compiled_steps_are_those_of_numpy(tmp_path, law):
    """Pushed from where the other one is, step after step."""
    contact = f'self_contact = ["inside"]\n{law}'
    rom = rom_of(tmp_path, cleft((6, 1, 3), 1), order=12, contact=contact, **CLAMPED, **ROPE, **RUBS)
    body = fr.Simulator(rom, 1e-3)
    with numpy_alone():
        other = fr.Simulator(rom, 1e-3)
    assert type(body.integrator.interface.solver) is not type(other.integrator.interface.solver)
    largest, touched = 1e-3, 0
    for _ in range(60):
        body.step(rope=3.0)
        with numpy_alone():
            other.step(rope=3.0)
        largest = max(largest, np.abs(other.contact_forces()).max())
        np.testing.assert_allclose(body.contact_forces(), other.contact_forces(), rtol=0, atol=1e-8 * largest)
        touched += other.integrator.contact is not None
    assert touched >= 30
    np.testing.assert_allclose(body.displacement(), other.displacement(), rtol=0, atol=1e-9 * LONG)
