"""Bodies that turn as far as they like: exact laws, order of accuracy, a rigid top, a base that carries them."""

import warnings

import numpy as np
import pytest
from bodies import box_arrays, scene_text, write_arrays

import fenics_rom as fr
from fenics_rom.scene.file import parse_scene

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
UNTURNED = np.array([1.0, 0.0, 0.0, 0.0])
GRAVITY = {"effects.gravity": "acceleration = [0.0, 0.0, -9.81]"}
FORCE = {"effects.prescribed.pull": 'surface = "right"\nvalues = [0.01, -0.02, 0.03]'}


def reduced(folder, *, frame="moving", young="5e5", size=(0.3, 0.03, 0.02), order=10, supports=None, **parts):
    """A ROM of a box, free or held at its left end by a base."""
    mesh = write_arrays(folder / "box.msh", *box_arrays(size, (6, 1, 1)))
    material = f"young = {young}\npoisson = 0.4\ndensity = 1100.0"
    text = scene_text(mesh, supports=supports, material=material, damping="alpha = 0.5, beta = 2e-4", **parts)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return fr.reduce(fr.assemble(parse_scene(f'frame = "{frame}"\n{text}')), order=order)


@pytest.fixture(scope="module")
def free(tmp_path_factory):
    """A free beam that nothing acts on."""
    return reduced(tmp_path_factory.mktemp("free"))


@pytest.fixture(scope="module")
def pulled(tmp_path_factory):
    """A free beam that falls, and is pulled at one end."""
    return reduced(tmp_path_factory.mktemp("pulled"), **GRAVITY, **FORCE)


CLAMPED = {"supports": 'clamped = ["left"]'}


@pytest.fixture(scope="module")
def carried(tmp_path_factory):
    """The same, held by a base."""
    return reduced(tmp_path_factory.mktemp("carried"), **CLAMPED, **GRAVITY, **FORCE)


def undamped(rom):
    """What acts without damping."""
    return fr.Environment(**{**vars(rom.environment), "effects": {"inertia": ""}})


def thrown(body, spin, velocity=(0.1, 0.2, 0.3), seed=0, amplitude=1e-3):
    """A body that turns, flies and oscillates."""
    random = np.random.default_rng(seed)
    m = len(body.state[0])
    ω = np.sqrt(body.rom.contact_models[body.contact].eigenvalues)
    body.state = amplitude * random.standard_normal(m) / ω, amplitude * random.standard_normal(m)
    body.place(body.pose._replace(velocity=np.array(velocity), angular_velocity=np.array(spin)))
    return body


def ride(body, steps, seed=0, shortest=-4.0, longest=-1.0, u=None):
    """Steps of random length; the largest gaps of the account, of both momenta, and the largest energy or work."""
    random = np.random.default_rng(seed)
    start, (P, L) = body.energy, body.momentum
    gaps, scale = np.zeros(3), start
    for _ in range(steps):
        body.dt = 10 ** random.uniform(shortest, longest)
        body.step(np.zeros(body.inputs) if u is None else u(random))
        account = body.ledger
        energy = body.energy - start - account.supplied + account.dissipated + account.lost_in_switching
        now = [abs(energy), *(np.abs(a - b).max() for a, b in zip(body.momentum, (P, L), strict=True))]
        gaps = np.maximum(gaps, now)
        scale = max(scale, body.energy, abs(account.supplied), account.dissipated)
    return gaps, scale


@pytest.mark.parametrize("steps", [1000, pytest.param(100_000, marks=pytest.mark.slow)])
def test_free_body_keeps_energy_and_both_momenta(free, steps):
    body = thrown(fr.Simulator(free, 1e-3, scene=undamped(free)), (3.0, -4.0, 2.0))
    (P, L), (energy, linear, angular) = body.momentum, ride(body, steps)[0]
    assert energy <= 1e-12 * body.energy
    assert linear <= 1e-13 * np.linalg.norm(P)
    assert angular <= 1e-13 * np.linalg.norm(L)
