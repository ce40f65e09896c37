"""Bases that are orthonormal in mass and in stiffness to round-off, however much softer some of their vectors are."""

import numpy as np
import pytest

from fenics_rom.rom import rom


def gap(rigid, size):
    """Largest |CᵀC - I| and relative |CᵀκC - diag(γ)| of a span of soft vectors and of others, mixed by a rotation."""
    random = np.random.default_rng(0)
    κ = np.concatenate([np.zeros(rigid), np.geomspace(1.0, 1e20, size)])  # 1/s²
    soft = rigid + size // 4
    span = np.eye(len(κ), rigid + size // 2)
    span[soft:, soft:] = np.linalg.qr(random.standard_normal((len(κ) - soft, span.shape[1] - soft)))[0]
    span[:, rigid:] = span[:, rigid:] @ np.linalg.qr(random.standard_normal((size // 2, size // 2)))[0]
    γ, C = rom.diagonalized_span(κ, span)
    strained = (np.sqrt(κ)[:, None] * C)[:, rigid:] / np.sqrt(γ[rigid:])
    assert (γ[:rigid] == 0).all()
    assert (np.diff(γ) >= 0).all()
    return max(np.abs(A.T @ A - np.eye(A.shape[1])).max() for A in (C, strained))


@pytest.mark.parametrize("rigid", [0, 6])
@pytest.mark.parametrize("size", [8, 44, 200])
def test_soft_vectors_are_orthonormal_as_stiff_ones(rigid, size):
    assert gap(rigid, size) <= 2e-12  # ten times a thousand times round-off


def test_without_a_second_look_they_are_not(monkeypatch):
    monkeypatch.setattr(rom, "SOFTER", 0.0)
    assert gap(0, 44) > 1e-10
