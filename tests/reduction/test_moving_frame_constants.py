"""Constants of a moving frame: by their definition, node by node, from M and X."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg

from fenics_rom.errors import StructureError
from fenics_rom.mechanics.voigt import VOIGT_INDEX
from fenics_rom.reduction.moving_frame import inertia_constants
from fenics_rom.rom.moving_frame import check_moving_frame

NODES, ORDER = 9, 5


def body(carried, seed=0):
    """Nodes X, a mass matrix that couples them, and M-orthonormal vectors: of a free body orthogonal to rigid ones."""
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(NODES, 3))
    coupled = rng.normal(size=(NODES, NODES))
    M = np.kron(coupled @ coupled.T + NODES * np.eye(NODES), np.eye(3))
    V = rng.normal(size=(3 * NODES, ORDER))
    if carried:
        V[:9] = 0.0  # three nodes are held
    else:
        rigid = np.hstack([np.tile(np.eye(3), (NODES, 1)), *(np.cross(e, X).reshape(-1, 1) for e in np.eye(3))])
        V -= rigid @ np.linalg.solve(rigid.T @ M @ rigid, rigid.T @ M @ V)
    return X, M, V @ np.linalg.inv(np.linalg.cholesky(V.T @ M @ V)).T


@pytest.mark.parametrize("carried", [False, True])
def test_kinetic_energy_of_any_motion_is_that_of_the_nodes(carried):
    """T(v, ω, q, r) of the constants against ½ ẏᵀMẏ of ẏ = v + ω×y + V r; round-off of terms of about 1e3 J."""
    X, M, V = body(carried)
    frame = check_moving_frame(inertia_constants(X, M, V, carried=carried), ORDER)
    rng = np.random.default_rng(1)
    v, ω, q, r = rng.normal(size=3), rng.normal(size=3), rng.normal(size=ORDER), rng.normal(size=ORDER)
    arms = X - frame.origin + (V @ q).reshape(-1, 3)
    velocity = (v + np.cross(ω, arms) + (V @ r).reshape(-1, 3)).ravel()
    inertia = (frame.inertia0 + frame.inertia1 @ q + q @ (frame.inertia2 @ q).T)[VOIGT_INDEX]
    b = frame.coupling0 + frame.coupling @ q
    arm, drift = frame.first_moment + frame.moment_modes @ q, frame.moment_modes @ r
    energy = frame.mass * v @ v / 2 + v @ (np.cross(ω, arm) + drift) + ω @ inertia @ ω / 2 + ω @ b @ r + r @ r / 2
    assert energy == pytest.approx(velocity @ M @ velocity / 2, rel=1e-13)
    assert carried or not (frame.first_moment.any() or frame.moment_modes.any() or frame.coupling0.any())


def test_constants_of_a_mode_are_those_of_its_vectors():
    X, M, V = body(carried=True)
    Kg = np.random.default_rng(2).normal(size=(6, ORDER, ORDER))
    Kg = Kg + Kg.transpose(0, 2, 1)
    C = scipy.linalg.orth(np.random.default_rng(3).normal(size=(ORDER, 3)))
    mode = inertia_constants(X, M, V, carried=True, stiffening=Kg).of_mode(C)
    direct = inertia_constants(X, M, V @ C, carried=True, stiffening=C.T @ Kg @ C)
    check_moving_frame(mode, 3)
    for name in ("moment_modes", "inertia0", "inertia1", "inertia2", "coupling0", "coupling", "stiffening"):
        np.testing.assert_allclose(getattr(mode, name), getattr(direct, name), rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda f: {"mass": 0.0}, "mass is 0 kg; use one above 0"),
        (lambda f: {"inertia2": np.triu(f.inertia2)}, "inertia2 is not symmetric: off by "),
        (lambda f: {"coupling": np.abs(f.coupling)}, "coupling is not antisymmetric: off by "),
        (lambda f: {"coupling0": np.ones((3, ORDER))}, "coupling0 of a free body is up to 1.0e.00, not 0"),
        (lambda f: {"inertia0": -f.inertia0}, "the kinetic energy of motions as a whole is not positive definite"),
        (lambda f: {"inertia1": f.inertia1[:, :1]}, r"inertia1 has shape \(6, 1\); use \(6, 5\)"),
        (lambda f: {"origin": np.full(3, np.nan)}, "origin holds numbers that are not finite"),
    ],
)
def test_constants_without_structure_are_refused(change, message):
    frame = inertia_constants(*body(carried=False))
    with pytest.raises(StructureError, match=f"moving frame: {message}"):
        check_moving_frame(replace(frame, **change(frame)), ORDER)
