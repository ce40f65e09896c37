"""A body that deforms largely, from a scene to a ROM, on one rank and on two."""

import numpy as np
import pytest
from bodies import box_arrays, scene_text, write_arrays
from ranks import run_ranks

import fenics_rom as fr
from fenics_rom.rom.deformation import monomials

RUN = """
dt = 0.1
duration = 1.0
load = [
  { contact = "right", stop = 0.6, force = [0.0, 300.0, -500.0] },
  { actuator = "air", start = 0.3, force = [1e4] },
  { actuator = "rope", start = 0.3, force = [1000.0] },
]"""
PARTS = {
    "effects": "",  # no inertia
    "effects.large_deformation": 'material = "neo_hookean"',
    "effects.springs.bed": 'surface = "right"\nstiffness = 5.0',
    "effects.gravity": "acceleration = [0.0, 0.0, -1.0]",
    "effects.pressure.air": 'surface = "top"',
    "effects.tendon.rope": "points = [[0.0, 0.2, 0.3], [0.5, 0.2, 0.3], [1.0, 0.2, 0.3]]",
    "outputs.tip": "points = [[1.0, 0.4, 0.3]]",
    "reduction": 'method = "modal+derivatives"\norder = 8',  # few solves: two ranks wait long where a machine is busy
    "run": RUN,
}
pytestmark = pytest.mark.ranks
SAME = 1e-9


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("large")
    mesh = write_arrays(folder / "box.msh", *box_arrays((1.0, 0.4, 0.3), (4, 1, 1), shake=0.2))
    (folder / "box.toml").write_text(scene_text(mesh, **PARTS, contacts='[contacts.right]\nsurface = "right"'))
    return folder


@pytest.fixture(scope="module")
def roms(folder):
    for ranks in (1, 2):
        done = run_ranks(ranks, "-m", "fenics_rom", "reduce", folder / "box.toml", "-o", folder / f"{ranks}.h5")
        assert done.returncode == 0, done.stderr
    return [fr.read_rom(folder / f"{ranks}.h5") for ranks in (1, 2)]


def test_two_ranks_make_the_same_model(roms):
    """A hundred times what round-off leaves; vectors may have either sign, and what is drawn at random has none."""
    one, two = roms
    signs = np.sign((one.outputs["tip"] * two.outputs["tip"]).sum(axis=0))
    np.testing.assert_allclose(two.stiffness, one.stiffness, rtol=SAME)
    bodies = [rom.deformation for rom in roms]
    assert bodies[0].points_of == bodies[1].points_of == 24
    assert len(bodies[0].weights) == len(bodies[1].weights) < 24
    assert bodies[1].training_radius == pytest.approx(bodies[0].training_radius, rel=SAME)
    for q in 0.5 * bodies[0].training_radius * np.eye(8):
        assert bodies[1].energy(signs * q) == pytest.approx(bodies[0].energy(q), rel=SAME)
        force = bodies[0].force(q)
        assert np.abs(signs * bodies[1].force(signs * q) - force).max() <= SAME * np.abs(force).max()


def test_all_points_and_what_follows_are_those_of_the_full_order(folder, roms):
    system, rom = fr.assemble(fr.read_scene(folder / "box.toml")), roms[0]
    full, body, W = system.deformation, rom.deformation, rom.basis
    q = 0.5 * body.training_radius * np.eye(8)[0]
    follower = full.follower(W @ q)
    for name, found in (("air", body.pressures["air"] @ monomials(q)), ("rope", body.tendons["rope"].force(q))):
        exact = W.T @ follower[name][:, 0]
        np.testing.assert_allclose(found, exact, atol=1e-10 * np.abs(exact).max())
    exact = full.force(W @ q) @ W
    gap = (body.force(q) - body.springs @ q - exact) / np.sqrt(rom.stiffness)
    assert np.linalg.norm(gap) <= 0.05 * np.linalg.norm(exact / np.sqrt(rom.stiffness))
    ε = 1e-6 * body.training_radius
    linear = full.force(ε * W[:, 0]) @ W[:, 0] / ε
    assert linear + body.springs[0, 0] == pytest.approx(rom.stiffness[0], rel=1e-4)


@pytest.mark.slow
def test_training_by_the_full_order(folder):
    rom = fr.reduce(fr.assemble(fr.read_scene(folder / "box.toml")), method="trained")
    assert rom.deformation.validation_error <= 0.02
