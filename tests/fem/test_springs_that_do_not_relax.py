"""Springs to the ground beside a material that relaxes: they do not, as in a frame that a base holds still."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import box_arrays, scene_text, write_arrays
from gradient_checks import check_gradient, squares

import fenics_rom as fr
from fenics_rom.scene.file import parse_scene

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")

EFFECTS = {
    "effects.viscoelasticity": "ratios = [0.6, 0.3]\ntimes = [5e-3, 0.05]",
    "effects.springs.bed": 'surface = "bottom"\nstiffness = 40.0',
    "outputs.tip": "points = [[0.3, 0.03, 0.02]]",
}
RUN = "dt = 2e-3\nduration = 0.1\nload = [{ contact = 'right', stop = 0.05, force = [0.01, 0.0, 0.03] }]"
HELD, LOOSE = 'clamped = ["left"]', None


@pytest.fixture(scope="module")
def mesh(tmp_path_factory):
    return write_arrays(tmp_path_factory.mktemp("beam") / "beam.msh", *box_arrays((0.3, 0.03, 0.02), (4, 1, 1)))


def system_of(mesh, frame="fixed", supports=HELD, **changed):
    parts = {
        "material": "young = 5e5\npoisson = 0.3\ndensity = 1100.0",
        "damping": "alpha = 0.5, beta = 2e-4",
        "run": RUN,
        "supports": supports,
        **EFFECTS,
        **changed,
    }
    return fr.assemble(parse_scene(f'frame = "{frame}"\n{scene_text(mesh, **parts)}'))


def test_fixed_frame_is_that_of_a_base_that_stands(mesh):
    """There springs are no part of K, so that nothing could relax them."""
    fixed, carried = (fr.simulate(system_of(mesh, frame)) for frame in ("fixed", "moving"))
    scale = np.abs(carried.snapshots).max()
    assert scale > 1e-4
    np.testing.assert_allclose(fixed.snapshots, carried.snapshots, rtol=0, atol=1e-9 * scale)
    assert fixed.balance_error < 1e-12
    relaxed = fr.simulate(system_of(mesh, **{"effects.springs.bed": None}))
    assert np.abs(fixed.snapshots - relaxed.snapshots).max() > 0.1 * scale


@pytest.mark.parametrize("supports", [HELD, LOOSE], ids=["held", "loose"])
def test_reduced_body_in_all_modes_does_what_full_order_does(mesh, supports, tmp_path):
    system = system_of(mesh, supports=supports)
    full, rom = fr.simulate(system), fr.reduce(system, order=system.size, method="modal")
    fr.write_rom(tmp_path / "beam.h5", rom)
    run = fr.simulate(fr.read_rom(tmp_path / "beam.h5"))
    assert fr.compare(run, full)["shape"].relative < 1e-9
    assert run.balance_error < 1e-12


def test_what_is_pressed_down_for_long_rests_on_the_springs(mesh):
    """A body that nothing else holds, after all branches have relaxed: its material is as stiff as without them."""
    changed = {"run": RUN.replace("duration = 0.1", "duration = 6.0").replace("stop = 0.05", "stop = 6.0")}
    ends = []
    for relaxes in (True, False):
        lasting = changed | ({} if relaxes else {"effects.viscoelasticity": None})
        damped = lasting | {"damping": "alpha = 40.0, beta = 2e-4"}
        ends.append(fr.simulate(system_of(mesh, **damped)).outputs["tip"][-1])
    np.testing.assert_allclose(*ends, rtol=1e-4, atol=1e-9)


def test_switches_never_add_energy(mesh):
    """At low orders, of a body on springs alone, in steps of any length."""
    rom = fr.reduce(system_of(mesh, supports=LOOSE), order=5)
    body, rng = fr.Simulator(rom, 1e-3, ledger=True), np.random.default_rng(3)
    turnover = 0.0
    for _ in range(300):
        body.dt = 10 ** rng.uniform(-5, -1.5)
        before = body.energy
        body.switch(rng.choice(list(rom.contact_models)))
        assert body.energy <= before * (1 + 1e-12)
        body.step(0.05 * rng.standard_normal(body.inputs))
        turnover = max(turnover, body.energy, abs(body.ledger.supplied), body.ledger.dissipated)
    ledger = body.ledger
    assert body.energy == pytest.approx(
        ledger.supplied - ledger.dissipated - ledger.lost_in_switching, abs=1e-12 * turnover
    )


def test_gradients_know_what_relaxes(mesh):
    """Against differences: of inputs and the state, and of frequencies, with which springs do not change."""
    rom = fr.reduce(system_of(mesh, supports=LOOSE), order=8)
    rng = np.random.default_rng(0)
    u, start = 0.05 * rng.standard_normal((12, 3)), tuple(1e-3 * rng.standard_normal((2, 8)))
    directions = [rng.standard_normal(part.shape) for part in (u, *start)]

    def at(q, r, rom=rom):
        body = fr.Simulator(rom, 4e-3)
        body.state = q, r
        return body

    gradient = check_gradient(at, u, start, directions)
    δ = rng.uniform(0.5, 1.5, 8)

    def value(ε):
        models = rom.contact_models
        stiffer = models["right"].eigenvalues * (1 + ε * δ)
        changed = models | {"right": replace(models["right"], eigenvalues=stiffer)}
        return fr.differentiate(at(*start, replace(rom, contact_models=changed)), u, squares).value

    slope = (gradient.eigenvalues["right"] * rom.contact_models["right"].eigenvalues) @ δ
    assert slope == pytest.approx((value(1e-5) - value(-1e-5)) / 2e-5, rel=1e-6)
