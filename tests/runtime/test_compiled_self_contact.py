"""Compiled steps of a body that touches itself, held or in a moving frame: forces and motion are NumPy's."""

import numpy as np
import pytest
from forks import CLAMPED, LONG, ROPE, cleft
from test_self_contact import CARRIED, RUBS, rom_of, turning

import fenics_rom as fr
from fenics_rom.compilation import compiled, numpy_alone

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")


@pytest.mark.skipif(not compiled(), reason="numba is not installed")
@pytest.mark.parametrize(
    ("law", "frame", "parts"),
    [
        ("", "fixed", CLAMPED),
        ("restitution = 0.5", "fixed", CLAMPED),
        ('method = "penalty"\nstiffness = 1e3\ndamping = 0.1', "fixed", CLAMPED),
        ("", "moving", {"supports": None}),
        ("", "moving", CARRIED),
    ],
    ids=["held", "bounces", "springs", "free", "carried"],
)
def test_compiled_steps_are_those_of_numpy(tmp_path, monkeypatch, law, frame, parts):
    """Pushed from where the other one is, step after step; of a moving frame in each of its sweeps."""
    contact = f'self_contact = ["inside"]\n{law}'
    rom = rom_of(tmp_path, cleft((6, 1, 3), 1), frame, order=12, contact=contact, **parts, **ROPE, **RUBS)
    given = {"signals": {"base_path": turning}} if parts is CARRIED else {}
    body = fr.Simulator(rom, 1e-3, **given)
    with numpy_alone():
        other = fr.Simulator(rom, 1e-3, **given)
    assert type(body.integrator.interface.solver) is not type(other.integrator.interface.solver)
    from fenics_rom.mechanics.compiled_self_contact import CompiledSelfContact  # here, as it needs numba

    found, find = [], CompiledSelfContact._find
    monkeypatch.setattr(CompiledSelfContact, "_find", lambda *given: found.append(find(*given)) or found[-1])
    largest, touched = 1e-3, 0
    for _ in range(60 if frame == "fixed" else 30):
        body.step(rope=3.0)
        with numpy_alone():
            other.step(rope=3.0)
        largest = max(largest, np.abs(other.contact_forces()).max())
        np.testing.assert_allclose(body.contact_forces(), other.contact_forces(), rtol=0, atol=1e-8 * largest)
        touched += other.integrator.contact is not None
    assert touched >= (30 if frame == "fixed" else 8)
    assert None not in found  # else NumPy took a step
    np.testing.assert_allclose(body.displacement(), other.displacement(), rtol=0, atol=1e-9 * LONG)
