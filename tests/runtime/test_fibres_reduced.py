"""Fibres in steps of a reduced body: the account, second order, batches, gradients and files."""

from dataclasses import replace

import numpy as np
import pytest
from gradient_checks import check_gradient
from soft_rom import in_frame, soft_rom, swing

import fenics_rom as fr
from fenics_rom.compilation import compiled, numpy_alone
from fenics_rom.mechanics.fibres import Fibres, structure_of

CONSTANTS = {"quadratic": (2e5, 0.0, 0.0), "holzapfel": (1e5, 4.0, 0.1), "sheet": (2e5, 0.0, 0.0)}  # Pa, 1 and 1


def reinforced(law, *families, **choices):
    """The soft box with fibres that wind about its axis, in every other point."""
    rom = soft_rom(law, **choices)
    body = rom.deformation
    rng = np.random.default_rng(3)
    fibres = []
    for family in families:
        points = np.arange(len(fibres) % 2, len(body.weights), 2)
        along = rng.standard_normal((len(points), 3)) + np.array([2.0, 0, 0])
        along /= np.linalg.norm(along, axis=1)[:, None]
        k, s, κ = CONSTANTS[family]
        sizes = np.full(len(points), k), np.full(len(points), s)
        fibres.append(Fibres(family, points, structure_of(along, κ), *sizes))
    return replace(rom, deformation=replace(body, fibres=tuple(fibres)))


def imbalance(simulator):
    ledger = simulator.ledger
    return abs(simulator.energy - ledger.supplied + ledger.dissipated + ledger.numerical) / ledger.supplied


@pytest.fixture(scope="module")
def roms():
    return {
        "pull and push": reinforced("st_venant_kirchhoff", "quadratic"),
        "pull": reinforced("neo_hookean", "holzapfel", "holzapfel"),
        "sheet": reinforced("st_venant_kirchhoff", "sheet"),
        "both": reinforced("neo_hookean", "quadratic", "sheet"),
    }


@pytest.mark.parametrize("name", ["pull and push", "pull", "sheet"])
@pytest.mark.parametrize("stepper", ["newton", "linearly-implicit"])
def test_steps_with_fibres_balance_and_converge(roms, name, stepper):
    rom = roms[name]
    for h in (1e-4, 2e-3, 2e-2):
        assert imbalance(swing(rom, h, stepper, duration=16 * h if h < 1e-3 else 0.32)) < 1e-10
    assert imbalance(swing(in_frame(rom), 2e-3, stepper, duration=0.1)) < 1e-10
    exact = swing(rom, 2.5e-4, "newton", force=0.1, duration=0.16)
    apart = [
        np.linalg.norm(swing(rom, h, stepper, force=0.1, duration=0.16).state[0] - exact.state[0]) for h in (4e-3, 2e-3)
    ]
    assert 3.0 < apart[0] / apart[1] < 5.0
    plain = swing(
        replace(rom, deformation=replace(rom.deformation, fibres=())), 2e-3, stepper, force=0.1, duration=0.16
    )
    assert np.linalg.norm(plain.state[0] - exact.state[0]) > 20 * apart[1]


@pytest.mark.parametrize("name", ["pull and push", "pull", "sheet"])
def test_bodies_with_fibres_are_the_same_in_a_batch_and_after_a_file(roms, name, tmp_path):
    rom, h = roms[name], 2e-3
    fr.write_rom(tmp_path / "body.h5", rom)
    again = fr.read_rom(tmp_path / "body.h5")
    assert again.deformation == rom.deformation
    batch = fr.Batch(again, 3, h)
    single = [fr.Simulator(rom, h, stepper="linearly-implicit") for _ in range(3)]
    for step in range(20):
        u = np.outer([0.5, 1.0, 1.5], [0.0, 0.0, 0.2 * (step < 10), 0.0, 0.0])
        batch.step(u)
        for body, pushed in zip(single, u, strict=True):
            body.step(pushed)
    np.testing.assert_allclose(batch.state()[0], [body.state[0] for body in single], rtol=1e-9, atol=1e-12)


@pytest.mark.skipif(not compiled(), reason="numba is not installed, or turned off")
@pytest.mark.parametrize("name", ["pull and push", "pull", "sheet", "both"])
@pytest.mark.parametrize("kind", ["newton", "linearly-implicit", "carried"])
def test_compiled_steps_with_fibres_are_those_of_numpy(roms, name, kind):
    """From the same state every eighth step on; rollouts and bodies of a batch are single steps to the bit."""
    rom, h, t = roms[name], 4e-3, np.arange(60)
    rom, stepper = (rom, kind) if kind != "carried" else (in_frame(rom), "linearly-implicit")
    one, alone, rolled = (fr.Simulator(rom, h, stepper=stepper) for _ in range(3))
    with numpy_alone():
        other = fr.Simulator(rom, h, stepper=stepper)
    assert all(each.takes_compiled_steps if kind == "carried" else each.steps_in_loops for each in (one, rolled))
    batch = None if kind == "newton" else fr.Batch(rom, 2, h, ledger=True)
    u, moved, apart = np.zeros((len(t), one.inputs)), 0.0, []
    u[:, 2], u[:, -2], u[:, -1] = 0.3 * np.sin(t / 6), 100 * np.sin(t / 9), 2.0
    for k, row in enumerate(u):
        if k % 8 == 0:
            other.restore(one.save())
        for body in (one, other, alone):
            body.step(row)
        states = [np.concatenate(body.state) for body in (one, other)]
        moved = max(moved, np.abs(states[1]).max())
        apart.append(np.abs(states[0] - states[1]).max())
        if batch is not None:
            batch.step(np.tile(row, (2, 1)))
    assert max(apart) <= (1e-9 if kind == "newton" else 1e-12) * moved
    assert one.energy == pytest.approx(other.energy, rel=1e-9)
    assert imbalance(one) <= 1e-10
    rolled.rollout(u, outputs=[])
    np.testing.assert_array_equal(np.concatenate(rolled.state), np.concatenate(alone.state))
    if batch is not None:
        assert batch.stepping == "compiled"
        np.testing.assert_array_equal(np.concatenate([part[1] for part in batch.state()]), np.concatenate(alone.state))
        np.testing.assert_allclose(batch.energy, alone.energy, rtol=1e-12)


@pytest.mark.parametrize(
    ("name", "stepper"), [("pull", "newton"), ("pull", "linearly-implicit"), ("sheet", "linearly-implicit")]
)
def test_gradients_go_back_through_fibres(roms, name, stepper):
    rom, rng = roms[name], np.random.default_rng(0)
    u = rng.standard_normal((8, 5)) * [0.02, 0.02, 0.02, 60.0, 0.6] + [0.0, 0.0, -0.05, 300.0, 3.0]
    falling = 1 / np.arange(1, 13)
    start = 1e-3 * falling**2 * rng.standard_normal(12), 1e-2 * falling * rng.standard_normal(12)

    def body(q, r):
        body = fr.Simulator(rom, 2e-3, stepper=stepper)
        body.state = q, r
        return body

    sizes = 0.1 * u.std(axis=0), *map(np.abs, start)
    directions = [size * rng.standard_normal(part.shape) for size, part in zip(sizes, (u, *start), strict=True)]
    check_gradient(body, u, start, directions)
