"""Gradients by the adjoint: against central differences, in time and memory, and what is refused."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from linear_roms import LINEAR_BODIES, LOAD_VALUES, linear_rom

import fenics_rom as fr
from fenics_rom.errors import StepError

H, STEPS = 2e-3, 40
AGREES = 1e-8  # with central differences, relative: what they are good for


@pytest.fixture(scope="module", params=LINEAR_BODIES)
def rom(request):
    return linear_rom(request.param, request)


def started(rom):
    """A body that is somewhere, and goes somewhere."""
    body, random = fr.Simulator(rom, H, signals=LOAD_VALUES if rom.loads else None), np.random.default_rng(1)
    order = body.state[0].shape
    ω = np.sqrt(np.maximum(rom.contact_models[body.contact].eigenvalues, 1.0))
    body.state = 1e-2 * random.standard_normal(order) / ω, 1e-2 * random.standard_normal(order)
    return body


def plan(rom):
    """Inputs, contact modes and step sizes of each step."""
    body, names = fr.Simulator(rom, H, signals=LOAD_VALUES if rom.loads else None), list(rom.contact_models)
    inputs = 0.1 * np.random.default_rng(0).standard_normal((STEPS, body.inputs))
    return inputs, [names[step // 7 % len(names)] for step in range(STEPS)], H * (1 + np.arange(STEPS) // 15)


def squares(outputs, energies):
    """A sum of squares, and energies at some instants."""
    weights = np.linspace(1.0, 2.0, len(energies))
    value = sum((rows**2).sum() for rows in outputs.values()) * 1e3 + weights @ energies
    return value, {name: 2e3 * rows for name, rows in outputs.items()}, weights


def value_of(body, inputs, contact, dt):
    """The same by rollouts of one step each."""
    read, energies = {name: [] for name in body.rom.outputs}, []
    for u, name, h in zip(inputs, contact, dt, strict=True):
        for output, rows in body.rollout([u], contact=name, dt=h).items():
            read[output].append(rows[0])
        energies.append(body.energy)
    return squares({name: np.array(rows) for name, rows in read.items()}, np.array(energies))[0]


def test_value_is_that_of_the_steps(rom):
    inputs, contact, dt = plan(rom)
    gradient = fr.differentiate(started(rom), inputs, squares, contact=contact, dt=dt)
    assert gradient.value == pytest.approx(value_of(started(rom), inputs, contact, dt), rel=1e-11)


def test_gradient_agrees_with_differences(rom):
    inputs, contact, dt = plan(rom)
    random, start = np.random.default_rng(2), started(rom)
    gradient = fr.differentiate(start, inputs, squares, contact=contact, dt=dt)
    q, r = start.state
    exact = {"u": gradient.inputs, "q": gradient.state[0], "r": gradient.state[1]}
    given = {"u": inputs, "q": q, "r": r}
    for name, slope in exact.items():
        δ = random.standard_normal(slope.shape) * (np.abs(q) if name == "q" else 1e-2)

        def moved(ε, name=name, δ=δ):
            to, body = given | {name: given[name] + ε * δ}, started(rom)
            body.state = to["q"], to["r"]
            return fr.differentiate(body, to["u"], squares, contact=contact, dt=dt).value

        # J is quadratic: central differences are exact, but for round-off
        assert (moved(1.0) - moved(-1.0)) / 2 == pytest.approx(float((δ * slope).sum()), rel=AGREES), name


def varied(rom, contact, **parts):
    """The ROM with other numbers of one contact mode."""
    models = dict(rom.contact_models)
    models[contact] = replace(models[contact], **parts)
    return replace(rom, contact_models=models)


def test_gradient_with_the_numbers_of_a_model_agrees_with_differences(rom):
    contact, random, ε = list(rom.contact_models)[-1], np.random.default_rng(3), 1e-4
    inputs, model = plan(rom)[0], rom.contact_models[contact]

    def of(rom):
        body = started(rom)
        body.switch(contact)
        body.state = state
        return fr.differentiate(body, inputs, squares)

    state = (1e-4 * random.standard_normal(model.order), 1e-2 * random.standard_normal(model.order))
    gradient, γ, D = of(rom), model.eigenvalues, model.damping
    δ = random.standard_normal(γ.shape) * γ
    differences = [of(varied(rom, contact, eigenvalues=γ + s * ε * δ)).value for s in (-2, -1, 1, 2)]
    assert fourth_order(differences, ε) == pytest.approx(gradient.eigenvalues[contact] @ δ, rel=AGREES)
    if D.ndim == 1:
        δ = (0.1 + D) * random.uniform(0.5, 1.5, D.shape)
    else:
        symmetric = random.standard_normal(D.shape)
        δ = D @ (symmetric + symmetric.T) @ D / np.abs(D).max() / len(D)  # D may be singular, and stays >= 0
    differences = [of(varied(rom, contact, damping=D + s * ε * δ)).value for s in (-2, -1, 1, 2)]
    assert fourth_order(differences, ε) == pytest.approx((gradient.damping[contact] * δ).sum(), rel=AGREES)


def fourth_order(values, ε):
    """The derivative from values at -2, -1, 1 and 2 ε."""
    return (values[0] - 8 * values[1] + 8 * values[2] - values[3]) / (12 * ε)


def test_stiffness_of_the_whole_body_goes_through_switches(plate_rom):
    inputs, contact, dt = plan(plate_rom)
    start, ε = started(plate_rom).state, 1e-4

    def of(scale):
        models = {n: replace(m, eigenvalues=scale * m.eigenvalues) for n, m in plate_rom.contact_models.items()}
        rom = replace(plate_rom, contact_models=models, stiffness=scale * plate_rom.stiffness)
        body = fr.Simulator(rom, H)
        body.state = start
        return fr.differentiate(body, inputs, squares, contact=contact, dt=dt)

    gradient = of(1.0)
    slope = sum(gradient.eigenvalues[n] @ m.eigenvalues for n, m in plate_rom.contact_models.items())
    assert fourth_order([of(1 + s * ε).value for s in (-2, -1, 1, 2)], ε) == pytest.approx(slope, rel=AGREES)


def test_states_are_kept_of_few_steps(plate_rom):
    body, steps = fr.Simulator(plate_rom, H), 20_000
    last = np.zeros((steps, 1))
    last[-1] = 1.0
    tracemalloc.start()
    fr.differentiate(body, np.ones((steps, 3)), lambda outputs, energies: (energies[-1], {}, last[:, 0]), outputs=[])
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    everything = steps * 2 * 20 * 8
    assert peak < everything / 2  # of it are inputs, their derivatives, energies: a sixth


def test_a_gradient_says_in_a_line_what_it_is(plate_rom):
    gradient = fr.differentiate(fr.Simulator(plate_rom, H), np.zeros((5, 3)), squares)
    order = len(gradient.state[0])
    assert repr(gradient) == (
        f"RolloutGradient: J = 0, with 3 inputs of 5 steps, the start of order {order}, γ and D of "
        f"{', '.join(plate_rom.contact_models)}; 0 kinks"
    )


def test_what_cannot_be_differentiated_is_refused(plate_rom):
    body, inputs = fr.Simulator(plate_rom, H), np.zeros((5, 3))
    with pytest.raises(StepError, match="no output 'top'"):
        fr.differentiate(body, inputs, squares, outputs=["top"])
    for slopes, energies in (({"tip": np.zeros(3)}, None), ({}, np.full(5, np.nan)), ({"top": 0.0}, None)):
        with pytest.raises(StepError, match=r"derivatives with|no output 'top'"):
            fr.differentiate(body, inputs, lambda *_, given=(slopes, energies): (0.0, *given))
    for returned in (1.0, (1.0, {}), (np.nan, {}, None), (np.ones(3), {}, None), (1.0, None, None), ("a", {}, None)):
        with pytest.raises(StepError, match="objective: use a finite J"):
            fr.differentiate(body, inputs, lambda *_, given=returned: given)
