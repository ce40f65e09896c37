import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fenics_rom.mechanics.hyperelastic import (
    energy_and_piola,
    energy_density,
    linear_stress,
    moduli,
    strain,
    strain_of_excess_damping,
    strain_rate,
    stress,
)
from fenics_rom.mechanics.isochoric import LAWS, isochoric_terms
from fenics_rom.mechanics.point_material import PointMaterial
from fenics_rom.mechanics.voigt import VOIGT_INDEX
from fenics_rom.rom.deformation import ReducedDeformation

P = 40
RUBBER = ("mooney_rivlin 2 1", "yeoh 1 0.3 -0.01", "ogden 1 4 -0.2 -3", "gent 30", "arruda_boyce 2.5")
ALL_LAWS = (*LAWS, *RUBBER)
λ, μ = np.full(P, 2.0), np.full(P, 1.0)  # Pa


def gradients(size: float, seed: int = 0) -> np.ndarray:
    return size * np.random.default_rng(seed).standard_normal((3, 3, P))


def rotation(seed: int) -> np.ndarray:
    return np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))[0]


@pytest.mark.parametrize("law", ALL_LAWS)
def test_stress_and_moduli_are_derivatives(law):
    E, e, t = strain(gradients(0.2)), gradients(1.0, 1).reshape(9, P)[:6], 1e-6
    slope = (energy_density(law, E + t * e, λ, μ) - energy_density(law, E - t * e, λ, μ)) / (2 * t)
    np.testing.assert_allclose((stress(law, E, λ, μ) * e).sum(axis=0), slope, rtol=1e-7, atol=1e-8)
    slope = (stress(law, E + t * e, λ, μ) - stress(law, E - t * e, λ, μ)) / (2 * t)
    np.testing.assert_allclose(np.einsum("cdp,dp->cp", moduli(law, E, λ, μ), e), slope, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("law", ALL_LAWS[1:])
def test_what_is_beyond_linear_elasticity_is_of_third_order(law):
    E = strain(gradients(0.1))
    larger, smaller = (
        energy_density(law, size * E, λ, μ) - size**2 * (linear_stress(E, λ, μ) * E).sum(axis=0) / 2
        for size in (0.02, 0.01)
    )
    assert np.abs(8 * smaller - larger).max() <= 0.05 * np.abs(larger).max()


@pytest.mark.parametrize("law", ALL_LAWS)
@pytest.mark.parametrize("size", [1e-3, 0.2, 2.0])
def test_the_first_piola_kirchhoff_stress_is_that_of_the_second(law, size):
    H = gradients(size)
    E, F = strain(H), H + np.eye(3)[:, :, None]
    assert size < 1 or (np.linalg.det(F.transpose(2, 0, 1)) < 0).any()  # and there it has numbers, too
    W, P = energy_and_piola(law, H.reshape(9, -1), λ, μ)
    S = stress(law, E, λ, μ)
    expected = np.einsum("ijp,jkp->ikp", F, S[VOIGT_INDEX]).reshape(9, -1)
    bounds = 1e-9 * np.abs(expected).max(axis=0)  # det C loses digits where a point is all but flat
    assert (np.abs(P - expected) <= bounds).all()
    energy = energy_density(law, E, λ, μ)
    assert (np.abs(W - energy) <= 1e-10 * (np.abs(energy) + μ * np.sqrt((E**2).sum(axis=0)))).all()


def test_stress_of_the_smallest_strains_keeps_its_digits():
    E = 1e-12 * strain(gradients(1.0))
    found, linear = stress("neo_hookean", E, λ, μ), linear_stress(E, λ, μ)
    assert np.abs(found - linear).max() <= 1e-10 * np.abs(linear).max()


@pytest.mark.parametrize("poisson", [0.48, 0.499])
def test_branches_take_more_power_of_a_body_that_keeps_its_volume(poisson):
    """By the share that is said, to the next order of the strain."""
    ε, ratio = strain_of_excess_damping(poisson), np.array([2 * poisson / (1 - 2 * poisson)])
    rate = np.array([np.exp(2 * ε), *[-np.exp(-ε) / 2] * 2, 0, 0, 0])[:, None]  # of (e^2ε - 1)/2 and (e^-ε - 1)/2
    power = [float((linear_stress(rate, λ, np.ones(1)) * rate).sum()) for λ in (ratio, np.zeros(1))]
    assert power[0] / power[1] - 1 == pytest.approx(0.1, rel=3 * ε)
    assert strain_of_excess_damping(0.2) == np.inf


@pytest.mark.parametrize("law", ["neo_hookean", "yeoh 7"])
def test_viscosity_takes_what_the_rate_of_the_shape_and_that_of_the_volume_take(law):
    """2μ Ė:Ė + λ (J'/J)² of stretches s with rates ṡ; of a volume that stays no more than shear takes."""
    s = np.array([[1.4, 0.8], [1.4**-0.5, 1.1], [1.4**-0.5, 0.9]])
    rates, shear = s * [[1.0, 0.3], [-0.5, -0.2], [-0.5, 0.4]], np.array([1e6, 2e5])
    E, Ė = (np.vstack([part, np.zeros((3, 2))]) for part in ((s**2 - 1) / 2, s * rates))
    for dilates, first_lame in ((True, np.array([5e8, 3e5])), (False, -shear / 3)):
        material = PointMaterial(law, first_lame, shear)
        power = (material.viscous_stress(E, Ė, material.linear_stress(Ė)) * Ė).sum(axis=0)
        of_volume = (rates / s if dilates else Ė).sum(axis=0) ** 2
        round_off = 1e-15 * (np.abs(first_lame) * np.abs(Ė).sum(axis=0) ** 2)
        assert (np.abs(power - 2 * shear * (Ė**2).sum(axis=0) - first_lame * of_volume) <= round_off).all()
    linear = PointMaterial("st_venant_kirchhoff", first_lame, shear)
    assert linear.viscous_stress(E, Ė, E) is E


def test_slopes_of_viscosity_are_those_of_differences():
    E, rng, d = strain(gradients(0.1)), np.random.default_rng(7), 1e-6
    material = PointMaterial("neo_hookean", λ, μ)
    Ė, dE = rng.standard_normal((2, *E.shape))

    def viscous(E, Ė):
        return material.viscous_stress(E, Ė, material.linear_stress(Ė))

    by_rates, by_strain = material.viscous_slopes(E, Ė)
    for slopes, ahead, behind in (
        (by_rates, viscous(E, Ė + d * dE), viscous(E, Ė - d * dE)),
        (by_strain, viscous(E + d * dE, Ė), viscous(E - d * dE, Ė)),
    ):
        found = np.einsum("cdp,dp->cp", slopes, dE)
        assert np.abs(found - (ahead - behind) / (2 * d)).max() <= 1e-7 * np.abs(found).max()


def test_neo_hookean_is_what_textbooks_print():
    H = gradients(0.1)
    F = np.moveaxis(H, 2, 0) + np.eye(3)
    J, C = np.linalg.det(F), np.swapaxes(F, 1, 2) @ F
    W = μ / 2 * (np.trace(C, axis1=1, axis2=2) - 3 - 2 * np.log(J)) + λ / 2 * np.log(J) ** 2
    np.testing.assert_allclose(energy_density("neo_hookean", strain(H), λ, μ), W, rtol=1e-12)
    S = μ[:, None, None] * (np.eye(3) - np.linalg.inv(C)) + (λ * np.log(J))[:, None, None] * np.linalg.inv(C)
    np.testing.assert_allclose(stress("neo_hookean", strain(H), λ, μ)[3], S[:, 1, 2], rtol=1e-10, atol=1e-13)
    np.testing.assert_allclose(stress("neo_hookean", strain(H), λ, μ)[0], S[:, 0, 0], rtol=1e-10, atol=1e-13)


@pytest.mark.parametrize(
    ("given", "same"),
    [
        ("ogden 3 2 -1 -2", "mooney_rivlin 1.5 0.5"),
        ("yeoh 7", "mooney_rivlin 2 0"),
        ("yeoh 7 0.7 0", "yeoh 70 7"),
        ("ogden 5 2", "yeoh 1"),
    ],
)
def test_laws_with_constants_are_one_another(given, same):
    """Of constants the ratios count, and tr C̄ - 3 is Ogden's sum with α = 2, tr C̄⁻¹ - 3 that with α = -2."""
    E = strain(gradients(0.2))
    for of in (energy_density, stress, moduli):
        np.testing.assert_allclose(of(given, E, λ, μ), of(same, E, λ, μ), rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize(
    ("law", "says"),
    [
        ("rubber", "rubber has the constants"),
        ("neo_hookean 1", "use none"),
        ("mooney_rivlin 1", "two, C10 and C01"),
        ("yeoh", "one to three"),
        ("ogden 1 0", "α, which is not 0"),
        ("yeoh -1", "-2 as its shear modulus: use > 0"),
    ],
)
def test_constants_that_are_no_law_are_refused(law, says):
    with pytest.raises(ValueError, match=says):
        isochoric_terms(law)


@pytest.mark.parametrize("law", ALL_LAWS)
@given(before=st.floats(1e-9, 0.15), change=st.floats(1e-9, 0.15), seed=st.integers(0, 100))
def test_the_stress_between_two_strains_does_the_work_of_going_there(law, before, change, seed):
    E = strain(gradients(before, seed))
    after = strain(gradients(before, seed) + gradients(change, seed + 1))
    work = (PointMaterial(law, λ, μ).discrete_gradient_stress(E, after) * (after - E)).sum(axis=0)
    gained = energy_density(law, after, λ, μ) - energy_density(law, E, λ, μ)
    size = energy_density(law, E, λ, μ) + energy_density(law, after, λ, μ)
    rounded = 300 * np.finfo(float).eps * np.sqrt(size)  # as an energy of E² is of 1 + E, in the logarithm of J
    assert (np.abs(work - gained) <= 1e-11 * size + rounded + 1e-18).all()


@pytest.mark.parametrize("law", ALL_LAWS)
def test_it_is_of_second_order(law):
    E, e = strain(gradients(0.1)), gradients(1.0, 1).reshape(9, P)[:6]
    gaps = [
        np.abs(PointMaterial(law, λ, μ).discrete_gradient_stress(E - t * e, E + t * e) - stress(law, E, λ, μ)).max()
        for t in (2e-3, 1e-3)
    ]
    assert gaps[0] < 1e-12 or 3.9 < gaps[0] / gaps[1] < 4.1


@pytest.mark.parametrize("law", ALL_LAWS)
@pytest.mark.parametrize("seed", range(4))
def test_a_rotation_stores_nothing_and_changes_nothing(law, seed):
    R, unit = rotation(seed), np.eye(3)
    turned = np.repeat((R - unit)[:, :, None], P, axis=2)
    assert np.abs(energy_density(law, strain(turned), λ, μ)).max() < 1e-12
    H = gradients(0.2)
    after = np.einsum("ij,jkp->ikp", R, H + unit[:, :, None]) - unit[:, :, None]
    np.testing.assert_allclose(strain(after), strain(H), atol=1e-13)


def test_the_strain_rate_is_the_change_of_the_strain():
    H, dH, t = gradients(0.3), gradients(1.0, 1), 1e-6
    slope = (strain(H + t * dH) - strain(H - t * dH)) / (2 * t)
    np.testing.assert_allclose(strain_rate(H + np.eye(3)[:, :, None], dH), slope, rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize("law", ALL_LAWS)
def test_small_strains_are_linear(law):
    E = strain(gradients(1e-7))
    np.testing.assert_allclose(stress(law, E, λ, μ), linear_stress(E, λ, μ), rtol=1e-5, atol=1e-12)
    np.testing.assert_allclose(
        moduli(law, np.zeros((6, P)), λ, μ), moduli("st_venant_kirchhoff", np.zeros((6, P)), λ, μ), atol=1e-14
    )


@pytest.mark.parametrize("law", ALL_LAWS)
def test_a_point_that_is_inside_out_has_numbers(law):
    H = np.repeat(np.diag([-2.1, 0.0, 0.1])[:, :, None], P, axis=2)
    E = strain(H)
    for values in (energy_density(law, E, λ, μ), stress(law, E, λ, μ), moduli(law, E, λ, μ)):
        assert np.isfinite(values).all()


@pytest.mark.parametrize("law", ALL_LAWS)
def test_a_reduced_body_that_turns_by_a_right_angle_stores_nothing(law):
    """Its basis are the nine gradients that are the same everywhere, so that it can turn."""
    body = ReducedDeformation(
        law=law,
        gradients=np.repeat(np.eye(9).reshape(3, 3, 1, 9), P, axis=2),
        weights=np.full(P, 1 / P),
        first_lame=λ,
        shear=μ,
        viscosity=np.zeros(P),
        external_damping=np.zeros((9, 9)),
        springs=np.zeros((9, 9)),
        training_radius=1.0,
        points_of=P,
        cubature_error=0.0,
    )
    turned = (np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]]) - np.eye(3)).ravel()
    assert abs(body.energy(turned)) < 1e-12
    assert np.abs(body.force(turned)).max() < 1e-12
    q, e, t = turned + 0.1 * np.random.default_rng(0).standard_normal(9), np.eye(9), 1e-6
    slope = [(body.energy(q + t * d) - body.energy(q - t * d)) / (2 * t) for d in e]
    np.testing.assert_allclose(body.force(q), slope, rtol=1e-7, atol=1e-8)
    slope = np.array([(body.force(q + t * d) - body.force(q - t * d)) / (2 * t) for d in e])
    np.testing.assert_allclose(body.tangent(q), slope, rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(body.tangent(q), body.tangent(q).T, atol=1e-13)
