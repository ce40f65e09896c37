"""Gradients through steps of large deformation, under pressure and tendon, and through equilibria and strokes."""

from dataclasses import replace

import numpy as np
import pytest
from gradient_checks import check_gradient, squares
from soft_rom import linear, refuse_few_parts, soft_rom

import fenics_rom as fr
from fenics_rom.mechanics.gas import Gas

STEPS, FEW = 30, 5  # of steps that are found by iteration few
LAWS = ("st_venant_kirchhoff", "neo_hookean")
LINEAR, REST = "linear", {"inertia": False}
RESTING_LOAD = 0.2  # of that of a motion: what there are equilibria for
STROKES = {"cable": "length", "air": "volume"}


def points(rom):
    """With viscosities that differ, so that strains are those of points."""
    body = rom.deformation
    return replace(
        rom, deformation=replace(body, viscosity=body.viscosity * np.linspace(0.5, 1.5, len(body.viscosity)))
    )


def little_trained(rom):
    """With steps that are expected to go no further than the smallest states that it was trained on."""
    return replace(rom, deformation=replace(rom.deformation, training_radius=1e-4))


def without_strain(rom):
    """Of small strains."""
    effects = {name: effect for name, effect in rom.environment.effects.items() if name != "large_deformation"}
    return linear(replace(rom, environment=replace(rom.environment, effects=effects)))


def by_strokes(*names):
    """With actuators by their strokes."""
    controls = {name: STROKES[name] for name in names}
    return lambda rom: replace(rom, environment=replace(rom.environment, controls=controls))


def filled(control, **gas):
    """With gas in a chamber, that is given or comes through a valve, beside a cable by its stroke."""

    def changed(rom):
        given = {"controls": {"cable": "length", "air": control}, "gases": {"air": Gas(1e-5, **gas)}}
        return replace(rom, environment=replace(rom.environment, **given))

    return changed


def both(*changes):
    """One change after the other."""

    def changed(rom):
        for change in changes:
            rom = change(rom)
        return rom

    return changed


NEWTON, SHORT = ("newton", 5e-3), ("linearly-implicit", 1e-3)
UNDAMPED = {"alpha": 0.0, "beta": 0.0}
TOUCHED = {"contact": True}
RESTING = (None, 5e-3)
SMALL = (None, 2e-3)
CASES = {  # law, what is asked of the box, what is changed of it, stepper and time step
    "tables": (LAWS[0], {}, None, SHORT),
    "neo-Hookean": (LAWS[1], {}, None, SHORT),
    "undamped, long steps": (LAWS[0], UNDAMPED, None, ("linearly-implicit", 4e-3)),
    "neo-Hookean, undamped, long steps": (LAWS[1], UNDAMPED, None, ("linearly-implicit", 4e-3)),
    "points": (LAWS[0], {}, points, SHORT),
    "neo-Hookean, points": (LAWS[1], {}, points, SHORT),
    "little trained": (LAWS[0], {}, little_trained, SHORT),
    "contact": (LAWS[0], TOUCHED, None, SHORT),
    "neo-Hookean, contact": (LAWS[1], TOUCHED, None, SHORT),
    "strokes": (LAWS[0], {}, by_strokes("cable", "air"), SHORT),
    "neo-Hookean, a stroke, contact": (LAWS[1], TOUCHED, by_strokes("cable"), SHORT),
    "gas": (LAWS[0], {}, filled("gas", exponent=1.4), SHORT),
    "iterated, gas": (LAWS[1], {}, filled("gas", exponent=1.4), NEWTON),
    "iterated, valve": (LAWS[0], {}, filled("valve", orifice=1e-6), NEWTON),
    "equilibria, gas": (LAWS[0], REST, filled("gas"), RESTING),
    "linear, gas, contact": (LAWS[0], TOUCHED, both(without_strain, filled("gas")), SMALL),
    "linear, valve": (LAWS[0], {}, both(without_strain, filled("valve", orifice=1e-6)), SMALL),
    "linear equilibria, gas": (LAWS[0], REST, both(without_strain, filled("gas", exponent=1.4)), SMALL),
    "iterated": (LAWS[0], {}, None, NEWTON),
    "iterated, neo-Hookean, contact": (LAWS[1], TOUCHED, None, NEWTON),
    "iterated, strokes": (LAWS[0], {}, by_strokes("cable", "air"), NEWTON),
    "iterated, neo-Hookean, a stroke, contact": (LAWS[1], TOUCHED, by_strokes("cable"), NEWTON),
    "equilibria": (LAWS[1], REST, None, RESTING),
    "equilibria, contact": (LAWS[1], REST | TOUCHED, None, RESTING),
    "equilibria, strokes": (LAWS[0], REST, by_strokes("cable", "air"), RESTING),
    "equilibria, a stroke, contact": (LAWS[0], REST | TOUCHED, by_strokes("cable"), RESTING),
    "linear, strokes": (LAWS[0], {}, both(without_strain, by_strokes("cable", "air")), SMALL),
    "linear, a stroke, contact": (LAWS[0], TOUCHED, both(without_strain, by_strokes("cable")), SMALL),
    "linear equilibria": (LAWS[0], REST, without_strain, SMALL),
    "linear equilibria, contact": (LAWS[0], REST | TOUCHED, without_strain, SMALL),
    "linear equilibria, strokes": (LAWS[0], REST, both(without_strain, by_strokes("cable", "air")), SMALL),
}
QUICK = ["tables", "contact", "strokes", "iterated, neo-Hookean, a stroke, contact"]
QUICK += ["linear, valve", "equilibria, a stroke, contact", "linear, a stroke, contact", "linear equilibria, contact"]

pytestmark = pytest.mark.filterwarnings("ignore:the body went", "ignore:the surface is")


def directed(rom):
    """Signs of coordinates that make the same shapes of them on every machine, whatever signs its eigenvectors have."""
    somewhere = np.random.default_rng(5).standard_normal(rom.nodes.shape)
    columns = next(iter(rom.contact_models.values())).coordinates.T
    return np.sign([(somewhere * rom.reconstruct(column)).sum() for column in columns])


class Bent:
    """A slender box under forces, pressure and tendon, from a shape and a motion."""

    def __init__(self, law, asked, change, step):
        rom, random = soft_rom(law, **asked), np.random.default_rng(0)
        self.rom = rom if change is None else change(rom)
        self.stepper, self.h = step
        still = not self.rom.environment.has_inertia
        steps = FEW if self.rom.deformation is not None and self.stepper != "linearly-implicit" else STEPS
        self.u = random.standard_normal((steps, 5)) * [0.02, 0.02, 0.02, 60.0, 0.6]  # N, Pa, N
        self.u += [0.0, 0.0, -0.05, 300.0, 3.0]
        self.u *= RESTING_LOAD if still else 1.0
        time = np.arange(steps)
        if "cable" in self.rom.environment.controls:
            self.u[:, 4] = 1e-3 + 2e-4 * np.sin(time / 3)  # m
        if "air" in self.rom.environment.controls:
            self.u[:, 3] = 2e-7 + 4e-8 * np.cos(time / 4)  # m³
            if self.rom.environment.controls["air"] == "valve":
                self.u[:, 3] *= 1e10  # Pa
        falling = 1 / np.arange(1, 13)
        self.start = 1e-3 * falling**2 * random.standard_normal(12), 1e-2 * falling * random.standard_normal(12)
        self.start[1][:] *= not still
        signs = directed(self.rom)
        self.start = self.start[0] * signs, self.start[1] * signs
        sizes = 0.1 * self.u.std(axis=0), *map(np.abs, self.start)
        self.directions = [
            size * random.standard_normal(part.shape) for size, part in zip(sizes, (self.u, *self.start), strict=True)
        ]
        self.directions[1:] = [part * signs for part in self.directions[1:]]

    def body(self, q, r):
        body = fr.Simulator(self.rom, self.h, stepper=self.stepper)
        body.state = q, r
        return body


@pytest.mark.parametrize("name", [*QUICK, *(pytest.param(n, marks=pytest.mark.slow) for n in CASES if n not in QUICK)])
def test_gradient_agrees_with_differences(name):
    bent = Bent(*CASES[name])
    gradient = check_gradient(bent.body, bent.u, bent.start, bent.directions)
    if bent.rom.deformation is not None:
        assert gradient.eigenvalues == gradient.damping == {}


def test_steps_in_parts_are_gone_back_through(monkeypatch):
    refuse_few_parts(monkeypatch, 2)
    bent = Bent(LAWS[1], TOUCHED, by_strokes("cable"), ("newton", 0.02))
    check_gradient(bent.body, bent.u, bent.start, bent.directions)
    body = bent.body(*bent.start)
    for row in bent.u:
        body.step(row)
    assert body._stepper.kernel.notes["cut"] > 0


@pytest.mark.parametrize("change", [without_strain, both(without_strain, by_strokes("cable", "air"))])
def test_stiffness_of_equilibria_and_of_bodies_by_strokes(change):
    bent = Bent(LAWS[0], REST, change, SMALL)
    δ, models = np.random.default_rng(1).uniform(0.5, 1.5, 12), bent.rom.contact_models

    def value(ε):
        stiffer = {name: replace(model, eigenvalues=model.eigenvalues * (1 + ε * δ)) for name, model in models.items()}
        body = fr.Simulator(replace(bent.rom, contact_models=stiffer), bent.h)
        body.state = bent.start
        return fr.differentiate(body, bent.u, squares).value

    body = bent.body(*bent.start)
    gradient = fr.differentiate(body, bent.u, squares)
    slope = sum((gradient.eigenvalues[name] * model.eigenvalues) @ δ for name, model in models.items())
    assert slope == pytest.approx((value(1e-5) - value(-1e-5)) / 2e-5, rel=1e-6)


def test_switches_of_a_shared_basis_change_inputs_alone():
    bent = Bent(LAWS[0], {}, None, SHORT)
    modes = ["tip" if step % 20 < 10 else "middle" for step in range(STEPS)]

    def gradient(ε):
        return fr.differentiate(bent.body(*bent.start), bent.u + ε * bent.directions[0], squares, contact=modes)

    slope = (gradient(0.0).inputs * bent.directions[0]).sum()
    assert slope == pytest.approx((gradient(1e-4).value - gradient(-1e-4).value) / 2e-4, rel=1e-6)


def test_a_tangent_that_is_kept_is_kept_where_a_run_is_taken_again(monkeypatch):
    bent = Bent(*CASES["tables"])
    whole = fr.differentiate(bent.body(*bent.start), bent.u, squares)
    monkeypatch.setattr("fenics_rom.runtime.differentiation.taken_steps.MEMORY", 1e4)
    again = fr.differentiate(bent.body(*bent.start), bent.u, squares)
    assert again.value == whole.value
    assert np.array_equal(again.inputs, whole.inputs)
