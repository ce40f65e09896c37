"""Laws of fibres: derivatives, the discrete gradient, small strains, and what they are by other words."""

import numpy as np
import pytest

from fenics_rom.mechanics.fibres import FIBRE_LAWS, LARGEST_EXPONENT, Fibres, check_fibres, pushed_along, structure_of
from fenics_rom.mechanics.hyperelastic import strain
from fenics_rom.mechanics.point_material import PointMaterial
from fenics_rom.mechanics.rubber_tests import TESTS

P, K = 40, 30
POINTS = np.random.default_rng(0).permutation(P)[:K]
ALONG = np.random.default_rng(1).standard_normal((K, 3))
ALONG /= np.linalg.norm(ALONG, axis=1)[:, None]
CASES = [*((law, 0.0, 0.0) for law in FIBRE_LAWS), ("holzapfel", 2.0, 0.1)]


def material(law, s, κ, isotropic="st_venant_kirchhoff"):
    fibres = Fibres(law, POINTS, structure_of(ALONG, κ), np.full(K, 3.0), np.full(K, s))
    return PointMaterial(isotropic, np.full(P, 2.0), np.ones(P), (fibres,))


def gradients(size, seed=0):
    return size * np.random.default_rng(seed).standard_normal((3, 3, P))


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("size", [0.2, 1.5])
def test_stress_and_moduli_are_derivatives(case, size):
    """Also where an exponential has gone on as a parabola."""
    body, t = material(*case), 1e-6
    E, e = strain(gradients(size)), gradients(1.0, 1).reshape(9, P)[:6]
    family = body.fibres[0]
    assert (
        case[:2] != ("holzapfel", 2.0) or size < 1 or (case[1] * (2 * family.strains(E)) ** 2 > LARGEST_EXPONENT).any()
    )
    W = body.energy_density(E)
    slope = (body.energy_density(E + t * e) - body.energy_density(E - t * e)) / (2 * t)
    found, tolerance = body.stress(E), 1e-7 + 1e-9 * W
    assert (np.abs((found * e).sum(axis=0) - slope) <= tolerance + 1e-6 * np.abs(slope)).all()
    slope = (body.stress(E + t * e) - body.stress(E - t * e)) / (2 * t)
    change = np.einsum("cdp,dp->cp", body.moduli(E), e)
    assert (np.abs(change - slope) <= 1e-6 * np.abs(slope).max(axis=0) + 1e-7).all()
    np.testing.assert_allclose(body.stress_change(E, e), change, rtol=1e-9, atol=1e-9)
    H = gradients(size)
    F = H + np.eye(3)[:, :, None]
    S = found[np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2]])]
    energy, first = body.energy_and_piola(H.reshape(9, P))
    np.testing.assert_allclose(energy, W, rtol=1e-12)
    np.testing.assert_allclose(first, np.einsum("ijp,jkp->ikp", F, S).reshape(9, P), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("case", CASES)
def test_the_stress_between_two_strains_does_the_work_of_going_there(case):
    body = material(*case, "neo_hookean")
    E, after = strain(gradients(0.1)), strain(gradients(0.1) + gradients(0.1, 2))
    work = (body.discrete_gradient_stress(E, after) * (after - E)).sum(axis=0)
    gained = body.energy_density(after) - body.energy_density(E)
    assert np.abs(work - gained).max() <= 1e-10 * body.energy_density(after).max()
    t, e = 1e-6, gradients(1.0, 3).reshape(9, P)[:6]
    for slope, (before, end) in zip(body.discrete_gradient_slopes(E, after), ((0, t), (t, 0)), strict=True):
        moved = [body.discrete_gradient_stress(E + s * before * e, after + s * end * e) for s in (1, -1)]
        expected = (moved[0] - moved[1]) / (2 * t)
        assert np.abs(np.einsum("cdp,dp->cp", slope, e) - expected).max() <= 1e-5 * np.abs(expected).max()


def test_fibres_are_springs_in_the_stretch_or_pull_alone():
    F = np.eye(3) + 0.3 * np.random.default_rng(4).standard_normal((P, 3, 3))
    E = strain(F.transpose(1, 2, 0) - np.eye(3)[:, :, None])
    stretch = np.linalg.norm(np.einsum("kij,kj->ki", F[POINTS], ALONG), axis=1)
    isotropic = PointMaterial("st_venant_kirchhoff", np.full(P, 2.0), np.ones(P))
    own = (material("quadratic", 0.0, 0.0).energy_density(E) - isotropic.energy_density(E))[POINTS]
    np.testing.assert_allclose(own, 1.5 * (stretch - 1) ** 2, rtol=1e-9, atol=1e-12)
    C = np.einsum("pji,pjk->pik", F, F)[POINTS]
    e = 0.1 * (np.trace(C, axis1=1, axis2=2) - 3) + 0.7 * (stretch**2 - 1)
    own = (material("holzapfel", 2.0, 0.1).energy_density(E) - isotropic.energy_density(E))[POINTS]
    np.testing.assert_allclose(own, np.where(e > 0, 3 / 4 * np.expm1(2 * e**2), 0.0), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"law": "linear"}, "use quadratic, holzapfel, sheet"),
        ({"points": np.zeros(K, int)}, "not there, or twice"),
        ({"points": POINTS + P}, "not there, or twice"),
        ({"modulus": np.full(K, -1.0)}, "negative, or not finite"),
    ],
)
def test_fibres_that_are_none_are_refused(changed, says):
    family = Fibres(**(vars(material("quadratic", 0.0, 0.0).fibres[0]) | changed))
    with pytest.raises(ValueError, match=says):
        check_fibres((family,), P)


SPHERE = np.random.default_rng(7).standard_normal((2000, 3))
SPHERE /= np.linalg.norm(SPHERE, axis=1)[:, None]
PAIR = np.array([[np.cos(0.5), np.sin(0.5), 0.0], [np.cos(0.5), -np.sin(0.5), 0.0]])


def deformations():
    """F of tests of materials, that keep the volume: strips and sheets that are pulled and pressed, and sheared."""
    for path in TESTS.values():
        for stretch in np.linspace(0.6, 1.6, 21):
            yield np.diag(stretch ** np.array(path))
    for shear in np.linspace(-1.0, 1.0, 21):
        yield np.eye(3) + shear * np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])


def least_of_acoustic_tensor(body, F, along):
    """Of m·Q(N)·m over unit m and N, with Q(N) = (N·S·N) 1 + F (N·D·N) Fᵀ; N on a sphere, and as given."""
    E, index = strain((F - np.eye(3))[:, :, None]), np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2]])
    S, D = body.stress(E)[:, 0][index], body.moduli(E)[:, :, 0][np.ix_(index.ravel(), index.ravel())]
    N = np.vstack([SPHERE, along])
    Q = np.einsum("iA,AJBL,kB,nJ,nL->nik", F, D.reshape(3, 3, 3, 3), F, N, N, optimize=True)
    Q += np.einsum("nJ,JL,nL->n", N, S, N)[:, None, None] * np.eye(3)
    return np.linalg.eigvalsh((Q + Q.transpose(0, 2, 1)) / 2)[:, 0].min()


@pytest.mark.parametrize("case", [("quadratic", 0.0, 0.0), ("holzapfel", 2.0, 0.0), ("holzapfel", 2.0, 0.2)])
def test_fibres_fold_where_they_push_by_the_shear_modulus(case):
    """Strong ellipticity of two families in neo-Hookean rubber (μ = 1), in tests; of such as only pull always."""
    law, s, κ = case
    one, folds = np.ones(1), []
    fibres = [Fibres(law, np.zeros(1, int), structure_of(a[None], κ), 4 * one, s * one) for a in PAIR]
    body = PointMaterial("neo_hookean", 100 * one, one, tuple(fibres))
    for F in deformations():
        E = strain((F - np.eye(3))[:, :, None])
        push, stretch = pushed_along(body.fibres, E)
        least = least_of_acoustic_tensor(body, F, [[1, 0, 0], [0, 1, 0], *PAIR])
        folds.append(push[0] > 1)
        if abs(push[0] - 1) > 0.05:
            assert (least < 0) == folds[-1]
        if folds[-1]:
            assert stretch[0] < 1
    assert 0 < sum(folds) < len(folds) if law == "quadratic" else not any(folds)
