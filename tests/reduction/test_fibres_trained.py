"""Bodies with fibres, membranes and cables are trained as others are."""

import numpy as np
import pytest
from bodies import acted_on, box_arrays, box_surfaces, write_arrays

import fenics_rom as fr
from fenics_rom.errors import SceneError

MATERIAL = (
    "young = 1e5\npoisson = 0.4\ndensity = 1000.0\nfibres = {{ law = {law}, directions = [[1, 1, 0], [1, -1, 0]] }}"
)
HOLZAPFEL = '"holzapfel", modulus = 3e4, stiffening = 2.0, dispersion = 0.05'
RUN = "dt = 0.01\nduration = 0.2\nsnapshots = 10"
LOAD = "[[run.load]]\ncontact = 'right'\nforce = [0, 0, {}]\nstop = 0.12\n"
PARTS = {
    "contacts": '[contacts.right]\nsurface = "right"',
    "outputs.tip": 'surface = "right"',
    "readings.core": 'quantity = "stress"\npoints = [[0.05, 0.01, 0.01]]',
}


@pytest.fixture(scope="module")
def beam(tmp_path_factory):
    points, cells = box_arrays((0.1, 0.02, 0.02), (4, 1, 1))
    return write_arrays(tmp_path_factory.mktemp("beam") / "beam.msh", points, cells, box_surfaces(points, cells))


def scene_of(mesh, law, force, **added):
    effects = 'inertia = {}\ndamping = { alpha = 2.0, beta = 2e-3 }\nlarge_deformation = { material = "mooney_rivlin", '
    effects += "constants = [2, 1] }\n"
    material, run = MATERIAL.format(law=law), f"{RUN}\n{LOAD.format(force)}"
    return acted_on(mesh, effects, material=material, run=run, **PARTS, **added)


@pytest.mark.parametrize(
    ("method", "law", "within"),
    [
        ("modal+derivatives", '"quadratic", modulus = 3e4', 0.08),
        pytest.param("trained", HOLZAPFEL, 0.02, marks=pytest.mark.slow),
    ],
)
@pytest.mark.filterwarnings("ignore:effects.*go slack:fenics_rom.errors.FenicsRomWarning")
def test_a_reduced_model_follows_fibres_threads_and_a_cable(beam, method, law, within):
    added = {
        "effects.membranes.wound": 'surface = "top"\nstiffness = 100.0\ndirections = [[1, 0, 0]]',
        "effects.cables.wire": "points = [[0, 0.01, 0.015], [0.1, 0.01, 0.015]]\nstiffness = 5.0",
    }
    scene = scene_of(beam, law, -0.2, **added)
    rom = fr.reduce(fr.assemble(scene), order=10, method=method)
    assert "quadratic" in {family.law for family in rom.deformation.fibres}
    whole, *others = fr.simulate(scene), fr.simulate(rom), fr.simulate(rom, stepper="newton")
    tip = whole.outputs["tip"]
    assert np.abs(tip).max() > 0.008
    assert whole.balance_error < 1e-10
    for run in others:
        assert run.balance_error < 1e-10
        assert np.abs(run.outputs["tip"] - tip).max() < within * np.abs(tip).max()
        found, expected = (each.readings["core"].values.reshape(-1, 11)[:, :6] for each in (run, whole))
        assert np.abs(found - expected).max() < 10 * within * np.abs(expected).max()


def test_training_refuses_fibres_that_would_fold(beam):
    scene = scene_of(beam, '"quadratic", modulus = 1e6', -2.0)
    with pytest.raises(SceneError, match=r"in training .* pressed to a stretch of 0\.\d+: .*fold above 1; use law"):
        fr.reduce(fr.assemble(scene), order=8, method="modal+derivatives")
