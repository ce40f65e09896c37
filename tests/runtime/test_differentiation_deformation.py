"""Gradients through steps of large deformation, under pressure and tendon, against central differences."""

from dataclasses import replace

import numpy as np
import pytest
from soft_rom import soft_rom

import fenics_rom as fr

STEPS = 30
AGREES = 1e-6  # with central differences of 1e-4, relative
LAWS = ("st_venant_kirchhoff", "neo_hookean")


def points(rom):
    """With viscosities that differ, so that strains are those of points."""
    body = rom.deformation
    return replace(
        rom, deformation=replace(body, viscosity=body.viscosity * np.linspace(0.5, 1.5, len(body.viscosity)))
    )


def little_trained(rom):
    """With steps that are expected to go no further than the smallest states that it was trained on."""
    return replace(rom, deformation=replace(rom.deformation, training_radius=1e-4))


CASES = {  # law, what is asked of the box, time step
    "tables": (LAWS[0], {}, None, 1e-3),
    "neo-Hookean": (LAWS[1], {}, None, 1e-3),
    "undamped, long steps": (LAWS[0], {"alpha": 0.0, "beta": 0.0}, None, 4e-3),
    "neo-Hookean, undamped, long steps": (LAWS[1], {"alpha": 0.0, "beta": 0.0}, None, 4e-3),
    "points": (LAWS[0], {}, points, 1e-3),
    "neo-Hookean, points": (LAWS[1], {}, points, 1e-3),
    "little trained": (LAWS[0], {}, little_trained, 1e-3),
    "contact": (LAWS[0], {"contact": True}, None, 1e-3),
    "neo-Hookean, contact": (LAWS[1], {"contact": True}, None, 1e-3),
}
QUICK = ["tables", "neo-Hookean", "contact"]

pytestmark = pytest.mark.filterwarnings("ignore:the body went")


class Bent:
    """A slender box under forces, pressure and tendon, from a shape and a motion."""

    def __init__(self, law, asked, other, h):
        rom, random = soft_rom(law, **asked), np.random.default_rng(0)
        self.rom, self.h = rom if other is None else other(rom), h
        body = self.body(np.zeros(12), np.zeros(12))
        self.u = random.standard_normal((STEPS, body.inputs)) * [0.02, 0.02, 0.02, 60.0, 0.6]  # N, Pa, N
        self.u += [0.0, 0.0, -0.05, 300.0, 3.0]
        falling = 1 / np.arange(1, 13)
        self.start = 1e-3 * falling**2 * random.standard_normal(12), 1e-2 * falling * random.standard_normal(12)
        sizes = 0.1 * self.u.std(axis=0), *map(np.abs, self.start)
        self.directions = [
            size * random.standard_normal(part.shape) for size, part in zip(sizes, self.parts, strict=True)
        ]

    @property
    def parts(self):
        return (self.u, *self.start)

    def body(self, q, r):
        body = fr.Simulator(self.rom, self.h, stepper="linearly-implicit")
        body.state = q, r
        return body

    def value(self, ε, directions):
        """The objective, by steps, where inputs, q and r are moved by ε along directions."""
        u, q, r = (part + ε * δ for part, δ in zip(self.parts, directions, strict=True))
        body, read, energies = self.body(q, r), [], []
        for row in u:
            body.step(row)
            read.append(body.displacement("tip"))
            energies.append(body.energy)
        return squares({"tip": np.array(read)}, np.array(energies))[0]


def squares(outputs, energies):
    weights = 10 * np.linspace(1.0, 2.0, len(energies))
    return 100 * (outputs["tip"] ** 2).sum() + weights @ energies, {"tip": 200 * outputs["tip"]}, weights


@pytest.mark.parametrize("name", [*QUICK, *(pytest.param(n, marks=pytest.mark.slow) for n in CASES if n not in QUICK)])
def test_gradient_agrees_with_differences(name):
    bent, ε = Bent(*CASES[name]), 1e-4
    gradient = fr.differentiate(bent.body(*bent.start), bent.u, squares)
    slopes = (gradient.inputs, *gradient.state)
    assert gradient.value == pytest.approx(bent.value(0.0, bent.directions), rel=1e-12)
    for place, slope in enumerate(slopes):
        along = [δ * (number == place) for number, δ in enumerate(bent.directions)]
        difference = (bent.value(ε, along) - bent.value(-ε, along)) / (2 * ε)
        assert (slope * bent.directions[place]).sum() == pytest.approx(difference, rel=AGREES)
    along = sum((slope * δ).sum() for slope, δ in zip(slopes, bent.directions, strict=True))
    left = [abs(bent.value(ε, bent.directions) - gradient.value - ε * along) for ε in (1e-3, 5e-4)]
    assert 1.9 < np.log2(left[0] / left[1]) < 2.1
    assert gradient.eigenvalues == gradient.damping == {}


def test_a_tangent_that_is_kept_is_kept_where_a_run_is_taken_again(monkeypatch):
    bent = Bent(*CASES["tables"])
    whole = fr.differentiate(bent.body(*bent.start), bent.u, squares)
    monkeypatch.setattr("fenics_rom.runtime.differentiation.taken_steps.LEAST_BLOCK", 7)
    again = fr.differentiate(bent.body(*bent.start), bent.u, squares)
    assert again.value == whole.value
    assert np.array_equal(again.inputs, whole.inputs)
