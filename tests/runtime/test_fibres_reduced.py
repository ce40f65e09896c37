"""Fibres in steps of a reduced body: the account, second order, batches, gradients and files."""

from dataclasses import replace

import numpy as np
import pytest
from gradient_checks import check_gradient
from soft_rom import in_frame, soft_rom, swing

import fenics_rom as fr
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
