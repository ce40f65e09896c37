"""Viscosity of bodies that hardly change their volume, beside closed forms: a block whose strain is the same all over.

It is stretched by s along x, so that rubber becomes 1/√s as wide. Of its rates Ė:Ė is ṡ² (s² + 1/(2 s⁴)).
"""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
import scipy.optimize
from gradient_checks import check_gradient
from soft_rom import soft_rom

import fenics_rom as fr
from fenics_rom.compilation import numpy_alone
from fenics_rom.rom.contact_model import ContactModel

SHEAR, VOLUME, BETA = 1e5, 1e-3, 4e-3  # Pa, m³, s


class Block:
    """Its modes are the stretches along x, y and z; those along y and z have so much of the first one's mass, 1 kg."""

    def __init__(self, poisson, light=1e-2):
        rom, unit = soft_rom("neo_hookean", order=3, alpha=0.0, beta=BETA), np.eye(3)
        self.first_lame, self.masses = SHEAR * 2 * poisson / (1 - 2 * poisson), np.array([1.0, light, light])
        K = VOLUME * (self.first_lame + 2 * SHEAR * unit)
        γ, self.W = scipy.linalg.eigh(K, np.diag(self.masses))
        deformation = replace(
            rom.deformation,
            gradients=np.einsum("ij,ik->ijk", unit, self.W)[:, :, None],
            weights=np.array([VOLUME]),
            first_lame=np.array([self.first_lame]),
            shear=np.array([SHEAR]),
            viscosity=np.array([BETA]),
            external_damping=np.zeros((3, 3)),
            training_radius=10.0,
            pressures={},
            tendons={},
        )
        mode = ContactModel(γ, BETA * γ, self.W[:1].T, unit, unit, np.empty(0))
        self.rom = replace(rom, contact_models={"tip": mode}, actuators={}, stiffness=γ, deformation=deformation)

    def at_rest(self, force):
        """q under a force along x."""
        deformation, push = self.rom.deformation, self.W[0] * force
        s = scipy.optimize.brentq(lambda s: s - 1 / s**2 - force / (VOLUME * SHEAR), 0.3, 3.0)
        q = np.linalg.solve(self.W, [s - 1, s**-0.5 - 1, s**-0.5 - 1])
        for _ in range(8):
            q = q - np.linalg.solve(deformation.tangent(q), deformation.force(q) - push)
        return q

    def stretches(self, q):
        return 1 + self.W @ q

    def simulator(self, h, stepper, q):
        with numpy_alone():
            body = fr.Simulator(self.rom, h, stepper=stepper)
        body.state = q, np.zeros(3)
        return body


def decrement(s):
    """Logarithm of how much smaller one swing is than that before, from its turning points, of swings about 0."""
    inner = (s[1:-1] - s[:-2]) * (s[2:] - s[1:-1]) < 0
    a, b, c = s[:-2][inner], s[1:-1][inner], s[2:][inner]
    turns = b - (c - a) ** 2 / (8 * (a - 2 * b + c))  # of the parabola through three
    return -2 * np.polyfit(np.arange(len(turns)), np.log(np.abs(turns)), 1)[0]


@pytest.mark.parametrize(
    ("stepper", "poisson", "pull"),
    [
        ("newton", 0.499, 0.0),
        ("newton", 0.499, 100.0),
        ("newton", 0.49, -100.0),
        ("linearly-implicit", 0.49, 30.0),
        ("linearly-implicit", 0.3, 100.0),
    ],
)
def test_a_rod_that_is_pulled_swings_as_the_closed_form_says(stepper, poisson, pull):
    """About s = 1, 1.47, 0.75 and 1.12, as damped as 2μ Ė:Ė + λ (J'/J)² makes it there."""
    block = Block(poisson)
    q, s = block.at_rest(pull), block.stretches(block.at_rest(pull))
    C = VOLUME * BETA * (2 * SHEAR * np.diag(s**2) + block.first_lame * np.outer(1 / s, 1 / s))
    K = np.linalg.inv(block.W).T @ block.rom.deformation.tangent(q) @ np.linalg.inv(block.W)
    M = np.diag(block.masses)
    rates = np.linalg.eigvals(
        np.block([[np.zeros((3, 3)), np.eye(3)], [-np.linalg.solve(M, K), -np.linalg.solve(M, C)]])
    )
    slowest = rates[rates.imag > 0][np.argmin(rates[rates.imag > 0].imag)]
    body, found = block.simulator(2e-3, stepper, block.at_rest(pull + 0.03)), []
    for _ in range(400):
        body.step([pull])
        found.append(block.W[0] @ (body.state[0] - q))
    expected = -2 * np.pi * slowest.real / slowest.imag
    assert decrement(np.array(found)) == pytest.approx(expected, rel=2e-3)
    # And of rubber whose volume stays, with k = μ (1 + 2/s³) for the force that stretches it further.
    k, mass = VOLUME * SHEAR * (1 + 2 / s[0] ** 3), 1 + 2 * block.masses[1] / (4 * s[0] ** 3)
    c = 2 * VOLUME * SHEAR * BETA * (s[0] ** 2 + 1 / (2 * s[0] ** 4))
    damped = np.sqrt(k / mass - (c / (2 * mass)) ** 2)
    assert expected == pytest.approx(np.pi * c / mass / damped, rel=3 * SHEAR / block.first_lame)
    trace = VOLUME * block.first_lame * BETA * (s[0] - 1 / s[0] ** 2) ** 2  # what tr Ė would add
    assert pull == 0 or trace > 0.3 * c


def test_a_large_swing_loses_what_shear_takes():
    """From s = 1.8 on: the power of each step is that of 2μ Ė:Ė, and never negative."""
    block = Block(0.499)
    body, h = block.simulator(1e-3, "newton", block.at_rest(150.0)), 1e-3
    start, ledgers, s = body.energy, [0.0], [block.W[0] @ body.state[0] + 1]
    for _ in range(400):
        body.step([0.0])
        ledgers.append(body.ledger.dissipated)
        s.append(block.W[0] @ body.state[0] + 1)
        assert abs(body.energy - start + body.ledger.dissipated) <= 1e-11 * start  # as Newton's steps are solved
    s, rate = (np.array(s[:-1]) + s[1:]) / 2, np.diff(s) / h
    power = 2 * SHEAR * VOLUME * BETA * rate**2 * (s**2 + 1 / (2 * s**4))
    assert s.max() > 1.7
    assert s.min() < 0.9
    assert min(np.diff(ledgers)) >= -1e-14 * start
    assert ledgers[-1] == pytest.approx(h * power.sum(), rel=0.01)
    assert np.abs(np.diff(ledgers) / h - power).max() <= 0.02 * power.max()


@pytest.mark.parametrize("stepper", ["linearly-implicit", "newton"])
def test_steps_of_large_swings_are_of_second_order(stepper):
    block, ends = Block(0.45, light=0.3), []
    for steps in (40, 80, 320):
        body = block.simulator(0.16 / steps, "newton" if steps == 320 else stepper, block.at_rest(50.0))
        for _ in range(steps):
            body.step([0.0])
        ends.append(block.stretches(body.state[0]))
    errors = [np.abs(end - ends[2]).max() for end in ends[:2]]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.3)


def test_gradients_are_those_of_differences():
    block, rng = Block(0.45, light=0.3), np.random.default_rng(5)

    def at(q, r):
        body = block.simulator(8e-3, "linearly-implicit", q)
        body.state = q, r
        return body

    u, start = 40 * rng.standard_normal((8, 1)), (block.at_rest(40.0), 0.3 * rng.standard_normal(3))
    directions = [10 * rng.standard_normal(u.shape), *(0.03 * rng.standard_normal((2, 3)))]
    check_gradient(at, u, start, directions)
