"""Gradients of many steps against central differences and by their Taylor remainder."""

from collections.abc import Callable

import numpy as np
import pytest

import fenics_rom as fr

AGREES = 1e-6  # with central differences, relative to the largest part
Array = np.ndarray


def squares(outputs, energies):
    """An objective of all that can be read, with its derivatives."""
    weights = 10 * np.linspace(1.0, 2.0, len(energies))
    return 100 * (outputs["tip"] ** 2).sum() + weights @ energies, {"tip": 200 * outputs["tip"]}, weights


def check_gradient(
    at: Callable[..., fr.Simulator], u: Array, start: tuple[Array, ...], directions: list[Array], ε=1e-4
) -> fr.RolloutGradient:
    """That of `squares` with inputs u (steps, p) and the start: q and r, and of free bodies what moves their pose.

    Of a body that `at` puts there, along directions of each.
    """
    parts = (u, *start)

    def value(ε, directions):
        u, *start = (part + ε * δ for part, δ in zip(parts, directions, strict=True))
        body, read, energies = at(*start), [], []
        for row in u:
            body.step(row)
            read.append(body.displacement("tip"))
            energies.append(body.energy)
        return squares({"tip": np.array(read)}, np.array(energies))[0]

    gradient = fr.differentiate(at(*start), u, squares)
    assert gradient.kinks == ()
    assert gradient.value == pytest.approx(value(0.0, directions), rel=1e-12)
    slopes = (gradient.inputs, *gradient.state, *gradient.pose.values())[: len(parts)]  # bases are given
    owed = [(slope * δ).sum() for slope, δ in zip(slopes, directions, strict=True)]
    for place, slope in enumerate(owed):
        along = [δ * (number == place) for number, δ in enumerate(directions)]
        difference = (value(ε, along) - value(-ε, along)) / (2 * ε)
        assert slope == pytest.approx(difference, rel=AGREES, abs=AGREES * max(map(abs, owed)))
    slopes = []
    for ε in (1e-3, 2e-4, 5e-5):  # across a kink of contact the first are none; round-off may take the last
        left = [abs(value(step, directions) - gradient.value - step * sum(owed)) for step in (ε, ε / 2)]
        slopes.append(np.log2(left[0] / left[1]))
    assert any(1.9 < slope < 2.1 for slope in slopes), slopes
    return gradient
