"""Balanced truncation: the identities that define it, and how far it goes."""

import numpy as np
import pytest

from fenics_rom.reduction.balancing import balance, balance_as_printed, choose_order, orthonormal_span
from fenics_rom.reduction.gramians import square_root


def gramians(size=12, decades=4, seed=0):
    random = np.random.default_rng(seed)
    roots = [random.standard_normal((size, size)) * np.logspace(0, -decades, size) for _ in range(2)]
    return [root @ root.T for root in roots]


def balance_by_roots(Wc, Wo):
    return balance(square_root(Wc), square_root(Wo))


@pytest.mark.parametrize("method", [balance_by_roots, balance_as_printed])
def test_both_gramians_become_the_same_diagonal(method):
    Wc, Wo = gramians(size=6, decades=1)
    b = method(Wc, Wo)
    σ, T, left = b.singular_values, b.transformation, b.left_inverse
    np.testing.assert_allclose(T.T @ Wo @ T, np.diag(σ), atol=1e-9 * σ[0])
    np.testing.assert_allclose(left @ Wc @ left.T, np.diag(σ), atol=1e-9 * σ[0])
    np.testing.assert_allclose(left @ T, np.eye(len(σ)), atol=1e-8)
    np.testing.assert_allclose(σ**2, np.sort(np.linalg.eigvals(Wc @ Wo).real)[::-1], rtol=1e-8)


def test_only_what_is_numerically_there_is_returned():
    root = np.random.default_rng(0).standard_normal((30, 4))
    assert len(balance(square_root(root @ root.T), np.eye(30)).singular_values) == 4


def test_order_of_a_tolerance_is_the_smallest_that_keeps_it():
    σ = np.array([8.0, 1.0, 0.9, 0.1])
    assert [choose_order(σ, None, t) for t in (0.5, 0.2, 0.11, 0.01, 0.009, 1e-9)] == [1, 1, 2, 3, 4, 4]
    assert choose_order(σ, 2, 1e-9) == 2


def test_dependent_directions_end_the_span():
    T = np.eye(5)[:, [0, 1, 1, 2]] * [1.0, 1e-6, 1.0, 1.0]
    assert orthonormal_span(T, 4).shape == (5, 2)
    assert orthonormal_span(T, 1).shape == (5, 1)
