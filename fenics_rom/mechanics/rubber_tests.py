"""What tests of rubber measure, by a law with constants, of rubber that keeps its volume.

Principal stretches λᵢ = e^aᵢ follow one stretch λ, the third of them such that Σ aᵢ = 0:

    uniaxial       λ, λ^-½, λ^-½      a strip is pulled
    planar         λ, 1, 1/λ          a wide strip is pulled (pure shear)
    equibiaxial    λ, λ, λ⁻²          a sheet is pulled on all sides, or a balloon inflated

The nominal stress, force over the area at rest, is dW/dλ, shared by the sides that are pulled. A law is stable where
small changes of strain take work in all directions: where ∂²W/∂a² of (a₁, a₂) is positive definite (Hill, 1957).
"""

from collections.abc import Iterable

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.isochoric import IsochoricTerm, isochoric_terms

TESTS = {"uniaxial": (1.0, -0.5, -0.5), "planar": (1.0, 0.0, -1.0), "equibiaxial": (1.0, 1.0, -2.0)}
PULLED = {"uniaxial": 1, "planar": 1, "equibiaxial": 2}  # sides
STEPS = 400  # of a range of stretches, in which a law is looked at


def nominal_stress(terms: Iterable[IsochoricTerm], test: str, stretch: Array) -> Array:
    """Of stretches (P,), over μ, (P,)."""
    a = np.multiply.outer(np.log(stretch), TESTS[test])
    slope = np.sum([_slope(term, a) for term in terms], axis=0)
    stress: Array = slope @ TESTS[test] / (PULLED[test] * stretch)
    return stress


def stable_stretches(law: str, test: str, least: float, largest: float) -> tuple[float, float]:
    """From where to where a law is stable in a test, around 1, as far as all principal stretches are within limits."""
    return _end(law, -np.array(TESTS[test]), least, largest)[0], _end(law, np.array(TESTS[test]), least, largest)[0]


def check_stable(law: str, least: float, largest: float) -> None:
    """Refuses a law that is not stable wherever a body is stretched between these limits, least < 1 < largest.

    Raises:
        ValueError: with the test, and the stretch from where on it is not.
    """
    for test, path in TESTS.items():
        for side in (-1, 1):
            stretch, is_stable = _end(law, side * np.array(path), least, largest)
            if not is_stable:
                raise ValueError(
                    f"in a {test} test it is not stable beyond a stretch of {stretch:.3g}, and the body's stretches "
                    f"go from {least:.3g} to {largest:.3g}: use constants that are stable there, or less load"
                )


def _end(law: str, path: Array, least: float, largest: float) -> tuple[float, bool]:
    """The stretch up to which a law is stable along a path a (3,), and whether that is the end of the limits."""
    far = min(np.log(largest) / path.max(), np.log(least) / path.min())
    a = np.multiply.outer(np.linspace(0, far, STEPS), path)
    stable = np.append(_is_stable(law, a), False)
    last = int(stable.argmin()) - 1
    return float(np.exp(a[last, 0])), last == STEPS - 1


def _powers(term: IsochoricTerm, a: Array) -> tuple[Array, Array]:
    """C̄ᵢ^β (..., 3), and x (...)."""
    return np.exp(2 * term.β * a), np.expm1(2 * term.β * a).sum(axis=-1)


def _slope(term: IsochoricTerm, a: Array) -> Array:
    """∂W/∂aᵢ (..., 3)."""
    powers, x = _powers(term, a)
    slope: Array = 2 * term.β * term.k * term.slope(x)[..., None] * powers
    return slope


def _is_stable(law: str, a: Array) -> Array:
    """At each of some states (P, 3); at rest all laws are."""
    curvature = np.zeros((len(a), 3, 3))
    for term in isochoric_terms(law):
        powers, x = _powers(term, a)
        along, bend = 2 * term.β * powers, (2 * term.β) ** 2 * powers
        curvature += term.k * term.slope(x)[:, None, None] * bend[:, :, None] * np.eye(3)
        curvature += term.k * term.curvature(x)[:, None, None] * along[:, :, None] * along[:, None, :]
    free = np.array([[1.0, 0.0, -1.0], [0.0, 1.0, -1.0]])  # of a₁ and a₂
    stable: Array = np.linalg.eigvalsh(free @ curvature @ free.T)[:, 0] > 0
    return stable
